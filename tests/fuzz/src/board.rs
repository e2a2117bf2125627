//! Targets at the board's end of a link.

use std::sync::OnceLock;

use embedded_io_async::{Read, Write};
use futures::future::{Either, select};
use r4_boards::Robot;
use r4_protocol::{ChannelId, FrameDecoder, Request, ToDevice, ToHost};
use r4_sim::{Clock, Pace, SimBoard, Simulation, link::Receiver};

use crate::script::{Step, frame, steps};

const MS: u64 = 1_000_000;
/// Time until a board takes its first message, ns.
const STARTED_NS: u64 = 5 * MS;
/// Margin beyond the time that a board may take to notice that its host has gone, ns.
const MARGIN_NS: u64 = 100 * MS;
/// Time for pending transfers, a few control ticks, and the start of a board whose chips take their time, ns.
const QUIET_NS: u64 = 50 * MS;

/// Returns a robot with a motor and an actuator.
pub(crate) fn osmc_bench() -> &'static Robot {
    static ROBOT: OnceLock<Robot> = OnceLock::new();
    ROBOT.get_or_init(|| r4_boards::load("osmc-bench").expect("built in"))
}

/// Returns a robot with a channel of each kind.
fn every_interface() -> &'static Robot {
    static ROBOT: OnceLock<Robot> = OnceLock::new();
    ROBOT.get_or_init(|| r4_boards::load("every-interface").expect("built in"))
}

/// Target: sends bytes unchanged into the link of a board with a motor and an actuator.
///
/// # Panics
/// In the same cases as [`dispatcher`].
pub fn link(bytes: &[u8]) -> bool {
    // In pieces, so that the board has time to answer in between.
    let steps = bytes.chunks(64).map(|piece| Step::Frame(piece.to_vec()));
    run(osmc_bench(), steps)
}

/// Target: sends a script of valid frames ([`crate::script`]) into the link of a board with a channel of each kind.
///
/// # Panics
/// The board panics, sends something that is no message, moves without having been armed, or drives an output after its
/// host has gone.
pub fn dispatcher(script: &[u8]) -> bool {
    run(every_interface(), steps(script, |_, message| frame::<ToDevice>(message)))
}

/// Runs the steps on a board, and returns whether it took anything.
fn run(robot: &Robot, steps: impl Iterator<Item = Step>) -> bool {
    let mut simulation = Simulation::new(Pace::Free);
    let board = SimBoard::start(&mut simulation, robot, 1).expect("the robot has a world");
    let mut port = board.connect().expect("nobody is connected yet");
    let clock = simulation.clock();
    let places = |board: &SimBoard| -> Vec<_> {
        let mut world = board.world();
        channels(robot).map(|channel| (channel, world.position(channel))).collect()
    };
    let before = places(&board);
    // A drive that reverses by its voltage rests in the middle of its range, not at 0 V.
    let throttles = |board: &SimBoard| -> Vec<_> {
        let mut world = board.world();
        channels(robot).map(|channel| world.throttle_v(channel).unwrap_or(0.0)).collect()
    };
    let at_rest = throttles(&board);
    let (mut decoder, mut asked_to_arm) = (FrameDecoder::new(), false);
    let mut heard = Heard::default();
    let work = async {
        clock.sleep(STARTED_NS).await;
        for step in steps {
            match step {
                Step::Wait(ms) => heard.listen(&mut port.rx, &clock, ms * MS).await,
                Step::Frame(bytes) => {
                    for byte in &bytes {
                        let said = decoder.push::<ToDevice>(*byte);
                        asked_to_arm |= matches!(said, Some(Ok(ToDevice::Request { request: Request::Arm, .. })));
                    }
                    let Ok(()) = port.tx.write_all(&bytes).await;
                    heard.listen(&mut port.rx, &clock, MS).await;
                }
            }
        }
        heard.listen(&mut port.rx, &clock, if asked_to_arm { gone_ns(robot) } else { QUIET_NS }).await;
    };
    simulation.block_on(work).expect("time goes on");
    if !asked_to_arm {
        assert_eq!(places(&board), before, "something moved though nobody armed the board");
    }
    for (channel, (throttle_v, rest_v)) in channels(robot).zip(throttles(&board).into_iter().zip(at_rest)) {
        let mut world = board.world();
        let duty = world.drive(channel).map_or(0.0, |drive| drive.duty);
        let is_driven = duty != 0.0 || (throttle_v - rest_v).abs() > 0.01 || world.relay_closed(channel) == Some(true);
        assert!(!is_driven, "{channel} is driven without a host: duty {duty}, {throttle_v} V");
    }
    heard.messages > 0
}

/// Returns the longest time that a board moves after its host has gone, ns: until it notices, and until its motors'
/// brakes let go.
fn gone_ns(robot: &Robot) -> u64 {
    u64::from(robot.config.link_timeout_ms + robot.config.stop_brake_ms()) * MS + MARGIN_NS
}

/// Iterates over the channels that set points can move.
fn channels(robot: &Robot) -> impl Iterator<Item = ChannelId> {
    let config = &robot.config;
    let motors = config.motors.iter().map(|motor| motor.id);
    let others = (0..16).flat_map(|number| {
        use r4_protocol::ChannelKind::{Bldc, Relay, Servo, Stepper};
        [Bldc, Servo, Stepper, Relay].map(|kind| ChannelId::new(kind, number))
    });
    motors.chain(others)
}

/// Messages that the board sent.
#[derive(Default)]
struct Heard {
    decoder: FrameDecoder,
    messages: u32,
}

impl Heard {
    async fn listen(&mut self, rx: &mut Receiver, clock: &Clock, ns: u64) {
        let until_ns = clock.now_ns() + ns;
        let mut buffer = [0; 256];
        while clock.now_ns() < until_ns {
            let len = {
                let sleep = std::pin::pin!(clock.sleep_until(until_ns));
                let read = std::pin::pin!(rx.read(&mut buffer));
                let Either::Left((Ok(len), _)) = select(read, sleep).await else { return };
                len
            };
            for byte in &buffer[..len] {
                match self.decoder.push::<ToHost>(*byte) {
                    Some(Ok(_)) => self.messages += 1,
                    Some(Err(error)) => panic!("the board says what is no message: {error:?}"),
                    None => {}
                }
            }
        }
    }
}
