//! A simulated bench with a connected host, for tests of the firmware on the board's chips.
#![allow(dead_code, reason = "each test file uses its part")]

pub(crate) mod trip;

use std::{
    cell::RefCell,
    future::{pending, poll_fn},
    pin::pin,
    rc::Rc,
    task::Poll,
};

use embedded_io_async::{Read, Write};
use r4_boards::Robot;
use r4_driver::{Board, Clock, with_board};
use r4_plants::{Effect, Plant, PlantSpec};
use r4_protocol::{
    Causes, ChannelId, ChannelKind, DeviceInfo, FrameDecoder, Mode, Refusal, Reply, Request, SCHEMA_HASH, SafetyState,
    Setpoint, ToDevice, ToHost, VERSION,
    config::{BoardConfig, BridgeConfig, BridgeLines, ControlConfig, PwmConfig},
    encode_frame,
    frame::MAX_FRAME,
};
use r4_sim::{
    Pace, SimBoard, Simulation, VirtualBoard,
    i2c::{Disturbance, Injection, Span, WireRecord},
    link::Port,
};

pub(crate) const ROTARY: ChannelId = ChannelId::new(ChannelKind::Osmc, 0);
pub(crate) const LINEAR: ChannelId = ChannelId::new(ChannelKind::Actuator, 1);
pub(crate) const SUPPLY_24: ChannelId = ChannelId::new(ChannelKind::Supply, 0);
pub(crate) const SUPPLY_12: ChannelId = ChannelId::new(ChannelKind::Supply, 1);

pub(crate) const US: u64 = 1_000;
pub(crate) const MS: u64 = 1_000_000;

/// Data of a write that turns all outputs of a PCA9685 off: ALL_LED_OFF_H, full OFF (datasheet 7.3.4).
pub(crate) const ALL_OFF: [u8; 2] = [0xFD, 0x10];

/// Control configuration of a motor with feedback.
pub(crate) fn control_of(config: &mut BoardConfig, motor: usize) -> &mut ControlConfig {
    config.motors[motor].control.as_mut().expect("a measured motor")
}

/// Lines of the first motor's bridge.
pub(crate) fn lines_of(config: &mut BoardConfig) -> &mut BridgeLines {
    let BridgeConfig::Osmc(lines) = &mut config.motors[0].bridge else { panic!("an OSMC") };
    lines
}

/// Configuration of the OSMC bridges' PWM chip.
pub(crate) fn pwm_of(config: &mut BoardConfig) -> &mut PwmConfig {
    config.osmc_pwm.as_mut().expect("the bench has it")
}

/// Clock of the simulation, as the driver's trait requires it.
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

/// A connected host, with the board and its world.
pub(crate) struct Bench<'b> {
    pub(crate) host: &'b Board<HostClock>,
    pub(crate) board: Rc<dyn VirtualBoard>,
    pub(crate) clock: r4_sim::Clock,
}

impl Bench<'_> {
    pub(crate) async fn sleep_ms(&self, ms: u64) {
        self.clock.sleep(ms * MS).await;
    }

    pub(crate) async fn set(&self, channel: ChannelId, mode: Mode, value: f32) -> Result<(), r4_driver::Error> {
        self.host.set(channel, Setpoint { mode, value }).await
    }

    /// State of the supervisor and its causes, from a new heartbeat.
    pub(crate) async fn safety(&self) -> (SafetyState, Causes) {
        // two heartbeat periods, so that the newest one is younger than the call
        self.sleep_ms(110).await;
        self.host.safety()
    }

    /// True position of a channel, rad or m.
    pub(crate) fn position(&self, channel: ChannelId) -> f64 {
        self.board.world().position(channel).expect("the bench has the channel")
    }

    /// True if every transistor of a motor's bridge is off.
    pub(crate) fn is_off(&self, channel: ChannelId) -> bool {
        self.device().is_off(channel)
    }

    /// The board without its host.
    pub(crate) fn device(&self) -> Device {
        Device { board: self.board.clone(), clock: self.clock.clone() }
    }

    /// Arms, and turns the rotary motor until it runs, for at least `ns`.
    pub(crate) async fn run_rotary(&self, ns: u64) {
        self.host.arm().await.expect("nothing is wrong yet");
        self.set(ROTARY, Mode::Duty, 0.8).await.expect("armed");
        self.clock.sleep(300 * MS + ns).await;
        let speed = self.board.world().speed(ROTARY).expect("the bench has the channel");
        assert!(speed > 0.5, "the motor must run before it can be stopped: {speed} rad/s");
    }
}

/// The board and the world, for inspection and faults.
#[derive(Clone)]
pub(crate) struct Device {
    pub(crate) board: Rc<dyn VirtualBoard>,
    pub(crate) clock: r4_sim::Clock,
}

impl Device {
    /// True if every transistor of a motor's bridge is off.
    pub(crate) fn is_off(&self, channel: ChannelId) -> bool {
        self.board.world().drive(channel).expect("the bench has the channel").coast == 1.0
    }

    /// Signed share of the supply at a motor, -1 to 1.
    pub(crate) fn duty(&self, channel: ChannelId) -> f64 {
        self.board.world().drive(channel).expect("the bench has the channel").duty
    }

    /// Waits until `done`, polled every 10 µs of virtual time, at most until `limit_ns` after `since_ns`; returns the
    /// time after `since_ns`, ns.
    pub(crate) async fn wait_until(&self, since_ns: u64, limit_ns: u64, mut done: impl FnMut() -> bool) -> Option<u64> {
        loop {
            let after_ns = self.clock.now_ns() - since_ns;
            if done() {
                return Some(after_ns);
            }
            if after_ns > limit_ns {
                return None;
            }
            self.clock.sleep(10 * US).await;
        }
    }

    /// Waits until both bridges of the bench are off; returns the time, ns.
    pub(crate) async fn wait_off(&self, since_ns: u64, limit_ns: u64) -> Option<u64> {
        self.wait_until(since_ns, limit_ns, || self.is_off(ROTARY) && self.is_off(LINEAR)).await
    }

    /// Waits until all outputs of the chip are written off, to the STOP of the transfer; returns the time, ns.
    pub(crate) async fn wait_all_off_written(&self, since_ns: u64, limit_ns: u64) -> Option<u64> {
        let written = || self.wire_since(since_ns).find(|record| record.fault.is_none() && record.written == ALL_OFF);
        self.wait_until(since_ns, limit_ns, || written().is_some()).await?;
        written().map(|record| record.end_ns - since_ns)
    }

    /// Records the bus traffic from now on.
    pub(crate) fn record_wire(&self) {
        self.board.world().bus.set_trace(100_000);
    }

    /// Transfers that started at `since_ns` or later, oldest first.
    pub(crate) fn wire_since(&self, since_ns: u64) -> impl Iterator<Item = WireRecord> + use<> {
        let records: Vec<_> =
            self.board.world().bus.trace().filter(|record| record.start_ns >= since_ns).cloned().collect();
        records.into_iter()
    }

    /// Disturbs the bus from now on, until [`Device::free_bus`].
    pub(crate) fn disturb(&self, disturbance: Disturbance) {
        self.inject(disturbance, Span::Time { from_ns: self.clock.now_ns(), until_ns: u64::MAX });
    }

    pub(crate) fn inject(&self, disturbance: Disturbance, span: Span) {
        self.board.world().bus.inject(Injection { disturbance, span, address: None });
    }

    pub(crate) fn free_bus(&self) {
        self.board.world().bus.clear_injections();
    }

    /// Adds an effect to a motor's physics, at rest at its present position.
    pub(crate) fn add_effect(&self, robot: &Robot, channel: ChannelId, effect: Effect) {
        self.board.world().set_plant(channel, Plant::new(&plant_with(robot, channel, effect), 1));
    }

    /// Restores the physics of the robot's file for a motor.
    pub(crate) fn repair(&self, robot: &Robot, channel: ChannelId) {
        self.board.world().set_plant(channel, Plant::new(&plant(robot, channel), 1));
    }
}

/// Physics of a motor in the robot's file.
pub(crate) fn plant(robot: &Robot, channel: ChannelId) -> PlantSpec {
    let motor =
        robot.simulation.motors.iter().find(|motor| motor.channel == channel).expect("the bench has the channel");
    PlantSpec::from_toml(&motor.plant.name, &motor.plant.text).expect("built in")
}

pub(crate) fn plant_with(robot: &Robot, channel: ChannelId, effect: Effect) -> PlantSpec {
    let mut spec = plant(robot, channel);
    spec.push_effect(effect).expect("the motor can have the effect");
    spec
}

/// The built-in bench, configured to switch off at once by every stop: `braking.rs` tests stops that brake first.
pub(crate) fn osmc_bench() -> Robot {
    let mut robot = r4_boards::load("osmc-bench").expect("built in");
    robot.config.motors.iter_mut().for_each(|motor| motor.stop_brake_ms = 0);
    robot
}

/// Constructor of a board: the tests can run on one with another processor.
pub(crate) type PowerUp<'p> = &'p dyn Fn(&mut Simulation, &Robot) -> Rc<dyn VirtualBoard>;

/// Powers up the board that runs the firmware's own tasks.
pub(crate) fn power_up(simulation: &mut Simulation, robot: &Robot) -> Rc<dyn VirtualBoard> {
    Rc::new(SimBoard::start(simulation, robot, 1).expect("the robot has a world"))
}

/// Powers up `robot`, connects a host, runs `work`; panics if there was any misuse.
pub(crate) fn bench<T>(robot: &Robot, work: impl AsyncFnOnce(&Bench<'_>) -> T) -> T {
    let (result, misuse) = bench_with_misuse(robot, work);
    assert_eq!(misuse, Vec::<String>::new(), "what a chip would have suffered or ignored in silence");
    result
}

/// As [`bench`], for tests that cause misuse, which is returned.
pub(crate) fn bench_with_misuse<T>(robot: &Robot, work: impl AsyncFnOnce(&Bench<'_>) -> T) -> (T, Vec<String>) {
    bench_of(&power_up, Simulation::new(Pace::Free), robot, work)
}

/// As [`bench_with_misuse`], for any board in any simulation.
pub(crate) fn bench_of<T>(
    power_up: PowerUp<'_>,
    mut simulation: Simulation,
    robot: &Robot,
    work: impl AsyncFnOnce(&Bench<'_>) -> T,
) -> (T, Vec<String>) {
    let board = power_up(&mut simulation, robot);
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

/// As [`bench`], but after `work` the host disappears without a goodbye, and `alone` continues with the board.
pub(crate) fn bench_left_alone<A, T>(
    robot: &Robot,
    work: impl AsyncFnOnce(&Bench<'_>) -> A,
    alone: impl AsyncFnOnce(&Device, A) -> T,
) -> T {
    left_alone_of(&power_up, robot, work, alone)
}

/// As [`bench_left_alone`], for any board.
pub(crate) fn left_alone_of<A, T>(
    power_up: PowerUp<'_>,
    robot: &Robot,
    work: impl AsyncFnOnce(&Bench<'_>) -> A,
    alone: impl AsyncFnOnce(&Device, A) -> T,
) -> T {
    let mut simulation = Simulation::new(Pace::Free);
    let board = power_up(&mut simulation, robot);
    let port = board.connect().expect("nobody is connected yet");
    let device = Device { board, clock: simulation.clock() };
    let left = RefCell::new(None);
    let mut session = Box::pin(with_board(port.rx, port.tx, HostClock(simulation.clock()), async |host| {
        let bench = Bench { host, board: device.board.clone(), clock: device.clock.clone() };
        *left.borrow_mut() = Some(work(&bench).await);
        pending::<()>().await;
    }));
    let work = poll_fn(|context| {
        // the session ends only by an error
        let ended = session.as_mut().poll(context).is_ready();
        assert!(!ended, "no session");
        left.borrow_mut().take().map_or(Poll::Pending, Poll::Ready)
    });
    let result = simulation.block_on(work).expect("time goes on");
    drop(session);
    let result = simulation.block_on(alone(&device, result)).expect("time goes on");
    assert_eq!(device.board.world().misuse(), [], "what a chip would have suffered or ignored in silence");
    result
}

/// Output of `future`, or `None` if it takes longer than `ns`.
pub(crate) async fn within<T>(clock: &r4_sim::Clock, ns: u64, future: impl Future<Output = T>) -> Option<T> {
    let (mut future, mut sleep) = (pin!(future), pin!(clock.sleep(ns)));
    poll_fn(|context| match future.as_mut().poll(context) {
        Poll::Ready(value) => Poll::Ready(Some(value)),
        Poll::Pending => sleep.as_mut().poll(context).map(|()| None),
    })
    .await
}

/// Outputs of both futures, run concurrently.
pub(crate) async fn both<A, B>(a: impl Future<Output = A>, b: impl Future<Output = B>) -> (A, B) {
    let (mut a, mut b) = (pin!(a), pin!(b));
    let (mut of_a, mut of_b) = (None, None);
    poll_fn(|context| {
        if of_a.is_none()
            && let Poll::Ready(value) = a.as_mut().poll(context)
        {
            of_a = Some(value);
        }
        if of_b.is_none()
            && let Poll::Ready(value) = b.as_mut().poll(context)
        {
            of_b = Some(value);
        }
        if of_a.is_some() && of_b.is_some() { Poll::Ready(()) } else { Poll::Pending }
    })
    .await;
    // both outputs exist, otherwise the future would not be ready
    (of_a.expect("ready"), of_b.expect("ready"))
}

/// A host that sends and receives bytes, without driver and heartbeat.
pub(crate) struct RawHost {
    port: Port,
    clock: r4_sim::Clock,
    decoder: FrameDecoder,
    heard: Vec<ToHost>,
    next_seq: u16,
    /// Number of damaged frames received; must be 0 at the end, unless a test resets it.
    pub(crate) bad_frames: usize,
}

impl RawHost {
    pub(crate) async fn send_bytes(&mut self, bytes: &[u8]) {
        let Ok(()) = self.port.tx.write_all(bytes).await;
    }

    pub(crate) async fn send(&mut self, message: &ToDevice) {
        self.send_bytes(&frame(message)).await;
    }

    /// Number of bytes that arrive in the next `ms`.
    pub(crate) async fn bytes(&mut self, ms: u64) -> usize {
        let mut buffer = [0; 256];
        let mut count = 0;
        let until_ns = self.clock.now_ns() + ms * MS;
        while let Some(left_ns @ 1..) = until_ns.checked_sub(self.clock.now_ns()) {
            let Some(Ok(len)) = within(&self.clock, left_ns, self.port.rx.read(&mut buffer)).await else { continue };
            count += len;
        }
        count
    }

    /// All messages that arrive in the next `ms`.
    pub(crate) async fn listen(&mut self, ms: u64) -> Vec<ToHost> {
        let until_ns = self.clock.now_ns() + ms * MS;
        while let Some(left_ns @ 1..) = until_ns.checked_sub(self.clock.now_ns()) {
            self.receive(left_ns).await;
        }
        std::mem::take(&mut self.heard)
    }

    /// Answer to `request`; panics if there is none.
    pub(crate) async fn ask(&mut self, request: Request) -> Result<Reply, Refusal> {
        let seq = self.next_seq;
        self.next_seq = seq.wrapping_add(1);
        self.send(&ToDevice::Request { seq, request: request.clone() }).await;
        let until_ns = self.clock.now_ns() + 50 * MS;
        while let Some(left_ns @ 1..) = until_ns.checked_sub(self.clock.now_ns()) {
            let own = |message: &ToHost| matches!(message, ToHost::Response { seq: of, .. } if *of == seq);
            if let Some(place) = self.heard.iter().position(own) {
                let ToHost::Response { result, .. } = self.heard.remove(place) else { unreachable!() };
                return result;
            }
            self.receive(left_ns).await;
        }
        panic!("no answer to {request:?}");
    }

    /// Opens a session by a hello.
    pub(crate) async fn hello(&mut self) -> DeviceInfo {
        let hello = Request::Hello { version: VERSION, schema: SCHEMA_HASH };
        match self.ask(hello).await {
            Ok(Reply::Hello(info)) => info,
            other => panic!("{other:?} to a hello"),
        }
    }

    pub(crate) async fn stats(&mut self) -> r4_protocol::DeviceStats {
        match self.ask(Request::Stats).await {
            Ok(Reply::Stats(stats)) => stats,
            other => panic!("{other:?} when asked for statistics"),
        }
    }

    async fn receive(&mut self, ns: u64) {
        let mut buffer = [0; 256];
        let Some(Ok(len)) = within(&self.clock, ns, self.port.rx.read(&mut buffer)).await else { return };
        for byte in &buffer[..len] {
            if let Some(message) = self.decoder.push(*byte) {
                match message {
                    Ok(message) => self.heard.push(message),
                    Err(_) => self.bad_frames += 1,
                }
            }
        }
    }
}

/// Encoded bytes of a message.
pub(crate) fn frame(message: &ToDevice) -> Vec<u8> {
    encode_frame(message, &mut [0; MAX_FRAME]).expect("every message fits").to_vec()
}

/// Powers up `robot` and runs `work` with a host that sends bytes.
pub(crate) fn raw_bench<T>(robot: &Robot, work: impl AsyncFnOnce(&mut RawHost, &Device) -> T) -> T {
    raw_bench_of(&power_up, robot, work)
}

/// As [`raw_bench`], for any board.
pub(crate) fn raw_bench_of<T>(
    power_up: PowerUp<'_>,
    robot: &Robot,
    work: impl AsyncFnOnce(&mut RawHost, &Device) -> T,
) -> T {
    let mut simulation = Simulation::new(Pace::Free);
    let board = power_up(&mut simulation, robot);
    let port = board.connect().expect("nobody is connected yet");
    let clock = simulation.clock();
    let device = Device { board, clock: clock.clone() };
    let mut host = RawHost { port, clock, decoder: FrameDecoder::new(), heard: Vec::new(), next_seq: 0, bad_frames: 0 };
    let result = simulation.block_on(work(&mut host, &device)).expect("time goes on");
    assert_eq!(host.bad_frames, 0, "the board sends whole frames");
    result
}
