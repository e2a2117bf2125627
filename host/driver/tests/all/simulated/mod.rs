// Simulated board in this process for the tests, and for the examples in the documentation, which include this file.

/// Adapter from the simulation's clock to the driver's.
#[derive(Clone)]
pub(crate) struct VirtualClock(pub(crate) r4_sim::Clock);

impl r4_driver::Clock for VirtualClock {
    fn now_us(&self) -> u64 {
        self.0.now_ns() / 1000
    }

    fn sleep_until(&self, at_us: u64) -> impl Future<Output = ()> {
        self.0.sleep_until(at_us * 1000)
    }
}

/// Runs `work` with both halves of the link to a simulated board with a motor and an actuator.
#[allow(dead_code, reason = "each example uses one of the two")]
pub(crate) fn simulated_link(
    work: impl AsyncFnOnce(r4_sim::link::Receiver, r4_sim::link::Sender, VirtualClock) -> Result<(), r4_driver::Error>,
) -> Result<(), r4_driver::Error> {
    let mut simulation = r4_sim::Simulation::new(r4_sim::Pace::Free);
    let robot = r4_boards::load("osmc-bench").expect("built in");
    let board = r4_sim::SimBoard::start(&mut simulation, &robot, 1).expect("the robot has a world");
    let port = board.connect().expect("nobody is connected yet");
    let clock = VirtualClock(simulation.clock());
    simulation.block_on(work(port.rx, port.tx, clock)).expect("time goes on")
}

/// Runs `work` with an open session on that board.
#[allow(dead_code, reason = "each example uses one of the two")]
pub(crate) fn simulated(
    work: impl AsyncFnOnce(&r4_driver::Board<VirtualClock>) -> Result<(), r4_driver::Error>,
) -> Result<(), r4_driver::Error> {
    simulated_link(async |rx, tx, clock| r4_driver::with_board(rx, tx, clock, work).await?)
}
