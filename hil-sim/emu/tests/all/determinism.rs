//! Determinism: the same image, world and host give the same run, instruction for instruction, whatever is requested in
//! between, at any pace of virtual time, and whatever ran before in the same process.

use crate::emulated::{
    Setup,
    harness::{LINEAR, ROTARY},
};
use r4_protocol::{Mode, Telemetry};
use r4_sim::Pace;

/// Results of a run that must not differ.
#[derive(Debug, PartialEq)]
struct Run {
    /// Digest of all exception entries and returns: their times, program counters and numbers.
    trace: u64,
    exceptions: u64,
    instructions: u64,
    now_ns: u64,
    telemetry: Vec<Telemetry>,
    /// True positions of the motors, as bits.
    positions: [u64; 2],
}

/// Runs both motors for 0.6 s, with telemetry of both.
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
    // The control loop alone is woken 600 times, each time by a timer and by its transfers.
    let frames = first.telemetry.len();
    assert!(first.exceptions > 2000 && frames > 50, "{} exceptions, {frames} frames", first.exceptions);
    assert_eq!(run(1, Pace::Free), first);
    // Another seed changes the noise at the converter.
    assert_ne!(run(2, Pace::Free).telemetry, first.telemetry);
}

#[test]
fn the_pace_changes_nothing() {
    // At 20 times real time the run's 0.7 s take at least 35 ms of real time; the emulator has to keep up.
    let begin = std::time::Instant::now();
    let paced = run(1, Pace::RealTime(20.0));
    let took_s = begin.elapsed().as_secs_f64();
    assert!(took_s >= paced.now_ns as f64 * 1e-9 / 20.0, "{took_s} s: the pace was not kept");
    assert_eq!(paced, run(1, Pace::Free));
}
