//! Board with the firmware's image, for debugging tests.

#![allow(dead_code, reason = "each test file uses a part")]

use r4_emu::{EmuBoard, Image};
use r4_mcu::Settings;
use r4_sim::{Clock, Simulation, VirtualBoard as _};
use r4_thumb::ThumbCore;

/// Robot whose image the tests debug.
const ROBOT: &str = "osmc-bench";

/// Board in a simulation of its own.
pub(crate) struct Debugged {
    pub(crate) simulation: Simulation,
    pub(crate) clock: Clock,
    pub(crate) board: EmuBoard<ThumbCore>,
    pub(crate) image: Image,
}

impl Debugged {
    /// Powers up the board.
    pub(crate) fn start() -> Self {
        let image = Image::find(ROBOT).unwrap_or_else(|error| panic!("{error}"));
        let mut simulation = Simulation::default();
        let robot = r4_boards::load(ROBOT).expect("it is built in");
        let core = ThumbCore::new();
        let settings = Settings::default();
        let board = EmuBoard::start(&mut simulation, &robot, 1, &image, core, None, settings).expect("it starts");
        Self { clock: simulation.clock(), simulation, board, image }
    }

    /// Runs to the virtual time `at_ns`.
    pub(crate) fn run_to_ns(&mut self, at_ns: u64) {
        let clock = self.clock.clone();
        self.simulation.block_on(clock.sleep_until(at_ns)).expect("the clock does not stand still");
        assert_eq!(self.board.failure(), None);
    }
}
