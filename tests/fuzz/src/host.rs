//! Targets at the host's end of a link.

use std::{collections::VecDeque, convert::Infallible, io::Cursor};

use embedded_io_async::{ErrorType, Read, Write};
use r4_driver::with_board;
use r4_log::{About, Log, Tap, Wall, Warning};
use r4_protocol::{Mode, Setpoint, ToDevice, ToHost};
use r4_sim::{Clock, Pace, Simulation};

use crate::script::{Step, frame, steps};

const MS: u64 = 1_000_000;

#[derive(Clone)]
struct VirtualClock(Clock);

impl r4_driver::Clock for VirtualClock {
    fn now_us(&self) -> u64 {
        self.0.now_ns() / 1000
    }

    fn sleep_until(&self, at_us: u64) -> impl Future<Output = ()> {
        self.0.sleep_until(at_us * 1000)
    }
}

/// Board that sends the messages of a script, one each millisecond, and then closes the link.
struct Scripted {
    steps: VecDeque<Step>,
    clock: Clock,
}

impl ErrorType for Scripted {
    type Error = Infallible;
}

impl Read for Scripted {
    async fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
        loop {
            match self.steps.pop_front() {
                None => return Ok(0),
                Some(Step::Wait(ms)) => self.clock.sleep(ms * MS).await,
                Some(Step::Frame(bytes)) => {
                    self.clock.sleep(MS).await;
                    // Fits: the driver reads 512 bytes at a time, more than a frame.
                    buffer[..bytes.len()].copy_from_slice(&bytes);
                    return Ok(bytes.len());
                }
            }
        }
    }
}

/// Writer that accepts everything and drops it.
struct Nowhere;

impl ErrorType for Nowhere {
    type Error = Infallible;
}

impl Write for Nowhere {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        Ok(bytes.len())
    }

    async fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

/// Target: sends a script ([`crate::script`]) as a board's messages to the driver, which opens a session and uses
/// everything that the board claims to have. Whatever the messages are, each call ends, with a value or a typed error.
///
/// # Panics
/// A call does not end.
pub fn driver(script: &[u8]) -> bool {
    let mut simulation = Simulation::new(Pace::Free);
    let clock = simulation.clock();
    let board =
        Scripted { steps: steps(script, |_, message| frame::<ToHost>(message)).collect(), clock: clock.clone() };
    let session = with_board(board, Nowhere, VirtualClock(clock), async |board| {
        let channels: Vec<_> = board.channels().iter().take(4).cloned().collect();
        let _ = board.arm().await;
        let _ = board.stats().await;
        let _ = board.parameters().await;
        let _ = board.faults().await;
        let mut telemetry = board.telemetry();
        for channel in &channels {
            let _ = board.set(channel.id, Setpoint { mode: Mode::Duty, value: 0.5 }).await;
            if let Ok(mut samples) = board.samples(channel.id, 10).await
                && let Ok(sample) = samples.next().await
            {
                let _ = sample.position(channel);
            }
            let mode = channel.modes.first().map_or(Mode::Duty, |info| info.mode);
            if let Ok(mut cycles) = board.stream(&[(channel.id, mode)], 100).await {
                let _ = cycles.cycle(&[0.0]).await;
            }
        }
        while telemetry.try_next().is_some() {}
        let _ = (board.safety(), board.device_us(), board.host_us(board.device_us()), board.clock_uncertainty_us());
    });
    let ended = simulation.block_on(session).expect("the driver waits for nothing that never comes");
    ended.is_ok()
}

/// Target: sends a script over a link that is recorded, as messages of the host and of the board by turns. The
/// recording can be read.
///
/// # Panics
/// The recording cannot be read.
pub fn tap(script: &[u8]) -> bool {
    let mut tap = Tap::new(
        Cursor::new(Vec::new()),
        About {
            board: "sim:osmc-bench".into(),
            seed: Some(1),
            program: "a test".into(),
            command: "record".into(),
            wall: Wall::Began { unix_ns: 0 },
        },
    );
    let mut now_us = 0;
    let framed = |number, message: &[u8]| {
        if number % 2 == 0 { frame::<ToDevice>(message) } else { frame::<ToHost>(message) }
    };
    for (number, step) in steps(script, framed).enumerate() {
        match step {
            Step::Wait(ms) => now_us += ms * 1000,
            Step::Frame(bytes) if number % 2 == 0 => tap.sent(now_us, &bytes),
            Step::Frame(bytes) => tap.received(now_us, &bytes),
        }
        now_us += 500;
    }
    let Ok(Some(file)) = tap.finish() else { return false };
    let log = Log::from_bytes(&file.into_inner()).expect("what was recorded is read");
    // Samples that contradict the description of their channel are counted as unreadable; no other warning is expected.
    let sound = log.warnings.iter().all(|warning| matches!(warning, Warning::Unreadable { .. }));
    assert!(sound, "{:?}", log.warnings);
    true
}
