//! A simulated bench with a host connected to it, for tests of the firmware on the board's chips.
#![allow(dead_code, reason = "each test file uses its part")]

use std::rc::Rc;

use r4_boards::Robot;
use r4_driver::{Board, Clock, with_board};
use r4_protocol::{Causes, ChannelId, ChannelKind, Mode, SafetyState, Setpoint};
use r4_sim::{Pace, SimBoard, Simulation};

pub(crate) const ROTARY: ChannelId = ChannelId::new(ChannelKind::Osmc, 0);
pub(crate) const LINEAR: ChannelId = ChannelId::new(ChannelKind::Actuator, 1);
pub(crate) const SUPPLY_24: ChannelId = ChannelId::new(ChannelKind::Supply, 0);
pub(crate) const SUPPLY_12: ChannelId = ChannelId::new(ChannelKind::Supply, 1);

pub(crate) const MS: u64 = 1_000_000;

/// The simulation's clock, as the driver wants it.
#[derive(Clone)]
pub(crate) struct HostClock(pub(crate) r4_sim::Clock);

impl Clock for HostClock {
    fn now_us(&self) -> u64 {
        self.0.now_ns() / 1000
    }

    fn sleep_until(&self, at_us: u64) -> impl Future<Output = ()> {
        self.0.sleep_until(at_us * 1000)
    }
}

/// A connected host and the world on the other side.
pub(crate) struct Bench<'b> {
    pub(crate) host: &'b Board<HostClock>,
    pub(crate) board: Rc<SimBoard>,
    pub(crate) clock: r4_sim::Clock,
}

impl Bench<'_> {
    pub(crate) async fn sleep_ms(&self, ms: u64) {
        self.clock.sleep(ms * MS).await;
    }

    pub(crate) async fn set(&self, channel: ChannelId, mode: Mode, value: f32) -> Result<(), r4_driver::Error> {
        self.host.set(channel, Setpoint { mode, value }).await
    }

    /// Where the supervisor stands now, asked afresh.
    pub(crate) async fn safety(&self) -> (SafetyState, Causes) {
        // Two heartbeat periods: what the host heard last is younger than that.
        self.sleep_ms(110).await;
        self.host.safety()
    }

    /// True position, rad or m.
    pub(crate) fn position(&self, channel: ChannelId) -> f64 {
        self.board.world().position(channel).expect("the bench has the channel")
    }

    /// Whether a bridge does nothing to its motor: every transistor off.
    pub(crate) fn is_off(&self, channel: ChannelId) -> bool {
        self.board.world().drive(channel).expect("the bench has the channel").coast == 1.0
    }
}

/// The built-in bench.
pub(crate) fn osmc_bench() -> Robot {
    r4_boards::load("osmc-bench").expect("built in")
}

/// Powers up `robot`, connects a host, runs `work`; at the end nothing may have been done against a datasheet.
pub(crate) fn bench<T>(robot: &Robot, work: impl AsyncFnOnce(&Bench<'_>) -> T) -> T {
    let (result, misuse) = bench_with_misuse(robot, work);
    assert_eq!(misuse, Vec::<String>::new(), "what a chip would have suffered or ignored in silence");
    result
}

/// The same for tests that break something, and so expect misuse.
pub(crate) fn bench_with_misuse<T>(robot: &Robot, work: impl AsyncFnOnce(&Bench<'_>) -> T) -> (T, Vec<String>) {
    let mut simulation = Simulation::new(Pace::Free);
    let board = Rc::new(SimBoard::start(&mut simulation, robot, 1).expect("the robot has a world"));
    let port = board.connect().expect("nobody is connected yet");
    let clock = simulation.clock();
    let host_clock = HostClock(clock.clone());
    let of_bench = board.clone();
    let session = with_board(port.rx, port.tx, host_clock, async |host| {
        work(&Bench { host, board: of_bench, clock: clock.clone() }).await
    });
    let result = simulation.block_on(session).expect("time goes on").expect("a session");
    let misuse = board.world().misuse().iter().map(ToString::to_string).collect();
    (result, misuse)
}
