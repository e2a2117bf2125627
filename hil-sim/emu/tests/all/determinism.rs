//! The same image, world and host give the same run, instruction for instruction: whatever is asked in between, how fast
//! virtual time goes, and what ran before in the same process.

use crate::emulated::{
    Setup,
    harness::{LINEAR, ROTARY},
};
use r4_protocol::{Mode, Telemetry};
use r4_sim::Pace;

/// What must be the same.
#[derive(Debug, PartialEq)]
struct Run {
    /// Of all exceptions taken and left: their moments, program counters and numbers.
    trace: u64,
    exceptions: u64,
    instructions: u64,
    now_ns: u64,
    telemetry: Vec<Telemetry>,
    /// True, of the motors, in bits.
    positions: [u64; 2],
}

/// 0.6 s of both motors on their way, with telemetry of both.
fn run(seed: u64, pace: Pace) -> Run {
    let setup = Setup::osmc_bench().with_seed(seed).prepared(|board| board.machine().start_trace());
    let (run, misuse) = setup.paced_bench(pace, async |emu| {
        let mut stream = emu.host.telemetry();
        for channel in [ROTARY, LINEAR] {
            emu.host.subscribe(channel, 10).await.expect("there is room");
        }
        emu.host.arm().await.expect("nothing is wrong");
        emu.set(ROTARY, Mode::Speed, 2.0).await.expect("armed");
        emu.set(LINEAR, Mode::Position, 0.01).await.expect("armed");
        emu.sleep_ms(600).await;
        let telemetry = std::iter::from_fn(|| stream.try_next()).collect();
        let machine = emu.emulated.machine();
        let trace = machine.trace().expect("it was started");
        Run {
            trace: trace.hash(),
            exceptions: trace.exceptions(),
            instructions: machine.instructions(),
            now_ns: machine.now_ns(),
            telemetry,
            positions: {
                drop(machine);
                [ROTARY, LINEAR].map(|channel| emu.position(channel).to_bits())
            },
        }
    });
    assert_eq!(misuse, Vec::<String>::new());
    run
}

#[test]
fn two_runs_are_the_same_and_another_seed_is_another() {
    let first = run(1, Pace::Free);
    // The control loop alone is woken 600 times, each by a timer and by its transfers.
    // Telemetry comes every 10 ms, both motors in one frame.
    let frames = first.telemetry.len();
    assert!(first.exceptions > 2000 && frames > 50, "{} exceptions, {frames} frames", first.exceptions);
    assert_eq!(run(1, Pace::Free), first);
    // Other noise at the converter.
    assert_ne!(run(2, Pace::Free).telemetry, first.telemetry);
}

#[test]
fn the_pace_changes_nothing() {
    // 20 times real time: the run's 0.7 s must take 35 ms of real time at least, and the emulator has to keep pace.
    let begin = std::time::Instant::now();
    let paced = run(1, Pace::RealTime(20.0));
    let took_s = begin.elapsed().as_secs_f64();
    assert!(took_s >= paced.now_ns as f64 * 1e-9 / 20.0, "{took_s} s: the pace was not kept");
    assert_eq!(paced, run(1, Pace::Free));
}
