//! Firmware image on an emulated board with a connected host.
//!
//! `cargo xtask firmware --robot <robot> [--image hosted]` builds the images. A test whose image is missing fails with
//! that message. Times are virtual.
#![allow(dead_code, unused_imports, reason = "each test file uses its part")]

#[path = "../../../../board/tests/all/harness/mod.rs"]
pub(crate) mod harness;

use std::{cell::RefCell, ops::Deref, path::Path, rc::Rc};

use harness::{Bench, Device, MS, RawHost, bench_of, left_alone_of, raw_bench_of};
use r4_boards::Robot;
use r4_emu::{EmuBoard, Image};
use r4_mcu::{Chip, Settings, soc::Soc};
use r4_sim::{Pace, Simulation, VirtualBoard, flash::Flash};
use r4_thumb::ThumbCore;

/// Emulated board under test.
pub(crate) type Board = EmuBoard<ThumbCore>;

/// Upper limit of the time from power-on until the supervisor runs, ms: clocks, and the set-up of the expander and PWM
/// chips.
pub(crate) const BOOT_MS: u64 = 100;

/// Power-up conditions of a board.
pub(crate) struct Setup {
    robot: Robot,
    image: Image,
    kept: RefCell<Option<Flash>>,
    seed: u64,
    prepare: Box<dyn Fn(&Board)>,
    board: Rc<RefCell<Option<Rc<Board>>>>,
}

/// Returns the image built for `robot`; `kind` is `bare` or `hosted`.
pub(crate) fn image(robot: &str, kind: &str) -> Image {
    if kind == "bare" {
        return Image::find(robot).unwrap_or_else(|error| panic!("{error}"));
    }
    let bare = Image::find(robot).unwrap_or_else(|error| panic!("{error}"));
    let path = bare.path().with_file_name(format!("{robot}-{kind}.elf"));
    Image::read(&path)
        .unwrap_or_else(|error| panic!("{error}: build it with `cargo xtask firmware --robot {robot} --image {kind}`"))
}

impl Setup {
    /// Set-up of a built-in robot with its bare image and empty flash storage.
    pub(crate) fn new(robot: &str) -> Self {
        Self::of(r4_boards::load(robot).expect("built in"), image(robot, "bare"))
    }

    /// Set-up of the robot `osmc-bench`.
    pub(crate) fn osmc_bench() -> Self {
        Self::new("osmc-bench")
    }

    pub(crate) fn of(robot: Robot, image: Image) -> Self {
        Self { robot, image, kept: RefCell::default(), seed: 1, prepare: Box::new(|_| {}), board: Rc::default() }
    }

    /// Changes the robot, and so the world around the same firmware.
    pub(crate) fn with_robot(mut self, change: impl FnOnce(&mut Robot)) -> Self {
        change(&mut self.robot);
        self
    }

    /// Starts with the flash storage of another board.
    pub(crate) fn with_flash(self, flash: Flash) -> Self {
        self.kept.replace(Some(flash));
        self
    }

    pub(crate) fn with_seed(self, seed: u64) -> Self {
        Self { seed, ..self }
    }

    /// Calls `prepare` with the board before its first instruction.
    pub(crate) fn prepared(self, prepare: impl Fn(&Board) + 'static) -> Self {
        Self { prepare: Box::new(prepare), ..self }
    }

    /// Returns the robot of the set-up.
    pub(crate) fn robot(&self) -> &Robot {
        &self.robot
    }

    pub(crate) fn image(&self) -> &Image {
        &self.image
    }

    /// Powers up the board for [`harness::PowerUp`].
    pub(crate) fn power_up(&self, simulation: &mut Simulation, robot: &Robot) -> Rc<dyn VirtualBoard> {
        let core = ThumbCore::new();
        let kept = self.kept.borrow_mut().take();
        let started = EmuBoard::start(simulation, robot, self.seed, &self.image, core, kept, Settings::default());
        let board = Rc::new(started.unwrap_or_else(|error| panic!("{error}")));
        (self.prepare)(&board);
        self.board.replace(Some(board.clone()));
        board
    }

    /// Runs `work` with a connected host; fails if the run has misused a chip against its manual or datasheet.
    pub(crate) fn bench<T>(&self, work: impl AsyncFnOnce(&Emu<'_>) -> T) -> T {
        let (result, misuse) = self.bench_with_misuse(work);
        assert_eq!(misuse, Vec::<String>::new(), "what a chip would have suffered or ignored in silence");
        result
    }

    /// Runs `work` with a connected host; returns the misuse as well, of the board's chips, then of the processor, for
    /// tests that break something.
    pub(crate) fn bench_with_misuse<T>(&self, work: impl AsyncFnOnce(&Emu<'_>) -> T) -> (T, Vec<String>) {
        self.paced_bench(Pace::Free, work)
    }

    pub(crate) fn paced_bench<T>(&self, pace: Pace, work: impl AsyncFnOnce(&Emu<'_>) -> T) -> (T, Vec<String>) {
        let _told = TellFailure(self.board.clone());
        let (result, mut misuse) = bench_of(
            &|simulation, robot| self.power_up(simulation, robot),
            Simulation::new(pace),
            &self.robot,
            async |bench| {
                let board = self.board.borrow().clone().expect("it is powered up");
                work(&Emu { bench, emulated: board }).await
            },
        );
        misuse.extend(self.misuse_of_the_chip());
        (result, misuse)
    }

    /// Runs `work` with a host that sends raw bytes, once the board has booted.
    pub(crate) fn raw<T>(&self, work: impl AsyncFnOnce(&mut RawHost, &Device, &Board) -> T) -> (T, Vec<String>) {
        let _told = TellFailure(self.board.clone());
        let power_up = |simulation: &mut Simulation, robot: &Robot| self.power_up(simulation, robot);
        let result = raw_bench_of(&power_up, &self.robot, async |host, device| {
            let board = self.board.borrow().clone().expect("it is powered up");
            device.clock.sleep(BOOT_MS * MS).await;
            work(host, device, &board).await
        });
        let world: Vec<_> =
            self.last().world().misuse().iter().map(ToString::to_string).chain(self.misuse_of_the_chip()).collect();
        (result, world)
    }

    /// Runs `work` as [`Setup::bench`] does; then the host vanishes without a bye, and `alone` continues with the
    /// board.
    pub(crate) fn left_alone<A, T>(
        &self,
        work: impl AsyncFnOnce(&Bench<'_>) -> A,
        alone: impl AsyncFnOnce(&Device, A) -> T,
    ) -> T {
        let _told = TellFailure(self.board.clone());
        let power_up = |simulation: &mut Simulation, robot: &Robot| self.power_up(simulation, robot);
        let result = left_alone_of(&power_up, &self.robot, work, alone);
        assert_eq!(self.misuse_of_the_chip(), Vec::<String>::new());
        result
    }

    /// Returns the board that was powered up last.
    pub(crate) fn last(&self) -> Rc<Board> {
        self.board.borrow().clone().expect("one was powered up")
    }

    fn misuse_of_the_chip(&self) -> Vec<String> {
        self.last().machine().chip.misuse().iter().map(|misuse| format!("{misuse:?}")).collect()
    }
}

/// Prints the reason for which the processor stopped, if a test fails because of it.
struct TellFailure(Rc<RefCell<Option<Rc<Board>>>>);

impl Drop for TellFailure {
    fn drop(&mut self) {
        if std::thread::panicking()
            && let Some(board) = &*self.0.borrow()
            && let Some(failure) = board.failure()
        {
            eprintln!("the processor stopped: {failure}");
        }
    }
}

/// Connected host, the world, and the processor.
pub(crate) struct Emu<'b> {
    bench: &'b Bench<'b>,
    pub(crate) emulated: Rc<Board>,
}

impl<'b> Deref for Emu<'b> {
    type Target = Bench<'b>;

    fn deref(&self) -> &Bench<'b> {
        self.bench
    }
}

/// Returns the file name of an image's path.
pub(crate) fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}
