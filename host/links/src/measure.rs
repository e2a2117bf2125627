//! Measurement of a link in real time: bytes of a cycle, round trips, cycles in flight, and the times that answers carry.

use std::{
    cell::{Cell, RefCell},
    pin::pin,
    rc::Rc,
    time::{Duration, Instant},
};

use embedded_io_async::{ErrorType, Read, Write};
use futures::future::{Either, FutureExt as _, LocalBoxFuture, select};
use r4_driver::{Board, Clock as _, CycleReport, Cycles, Error as DriverError, with_board};
use r4_protocol::{
    ChannelId, CycleOutcome, FrameDecoder, Mode, ToDevice, ToHost,
    cycle::CYCLE_CHANNELS,
    frame::{MAX_FRAME, Message},
};

use crate::{Link, RealClock};

/// Warm-up: the clock mapping needs some heartbeats, and caches are cold.
const WARM_UP: Duration = Duration::from_millis(500);
/// Round trips whose bytes are counted.
const COUNTED: usize = 256;
/// Time to live of the stream's set points, ms.
const TTL_MS: u16 = 100;
/// Time after the last cycle was sent, until which answers are awaited; later ones count as lost.
const PATIENCE: Duration = Duration::from_secs(1);

/// Settings of a measurement.
pub struct Settings<'s> {
    /// Duration of the round trips, and then again of the cycles in flight.
    pub span: Duration,
    /// Number of cycles sent before the first of them is answered; with 0 no cycles are sent in flight.
    pub window: usize,
    /// True to arm the board, with its motors at rest; otherwise it refuses the set points, and answers all the same.
    pub arm: bool,
    /// Ends the measurement as soon as it returns true.
    pub is_interrupted: &'s dyn Fn() -> bool,
}

/// Error of a measurement.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The board has no motor whose set point 0 means rest.
    #[error("this board has no motor to send cycles to")]
    NoMotor,
    /// The board does not open a session.
    #[error("no session with the board")]
    Connect(#[source] DriverError),
    /// The board cannot be armed.
    #[error("cannot arm")]
    Arm(#[source] DriverError),
    /// The board cannot be disarmed.
    #[error("cannot disarm; the board stops when its session ends")]
    Disarm(#[source] DriverError),
    /// The stream of cycles ended.
    #[error("the stream of cycles ended")]
    Cycles(#[from] DriverError),
    /// The caller ended it: [`Settings::is_interrupted`] returned true.
    #[error("interrupted")]
    Interrupted,
}

/// Time of an answer.
#[derive(Clone, Copy, Debug)]
pub struct Stamp {
    /// On the board's clock, µs.
    pub device_us: u64,
    /// Mapped to the host's clock when the answer came, µs.
    pub host_us: u64,
}

/// What a link carried, and how late, as [`measure`] found it.
#[derive(Clone, Debug, Default)]
pub struct Measured {
    /// Most bytes of a cycle on the wire, both frames together.
    pub cycle_bytes: usize,
    /// Times of the round trips, one after the other, µs.
    pub round_trips: Vec<f64>,
    /// Times of all answers.
    pub stamps: Vec<Stamp>,
    /// Cycles answered with [`Settings::window`] in flight.
    pub cycles: u64,
    /// Time that these took, s.
    pub seconds: f64,
    /// Lost cycles, of both parts.
    pub lost: u64,
    /// True if the board was armed.
    pub armed: bool,
    /// Answers that report a set point as not followed.
    pub not_followed: u64,
    /// Largest uncertainty of the clock mapping that the driver reported, µs.
    pub clock_uncertainty_us: f64,
}

/// Measures a link to a board.
///
/// # Errors
/// [`Error`]; an armed board stops also then, at the latest with its session.
pub fn measure<'a>(link: Link, settings: &'a Settings<'_>) -> LocalBoxFuture<'a, Result<Measured, Error>> {
    // Boxed here: an `async fn` would be compiled again in each crate that awaits it, as that crate is optimised.
    async move {
        let (down, up) = (Rc::<Scale>::default(), Rc::<Scale>::default());
        let rx = Weighed { link: link.rx, scale: up.clone() };
        let tx = Weighed { link: link.tx, scale: down.clone() };
        let connected = with_board(rx, tx, RealClock, async |board| {
            if settings.arm {
                board.arm().await.map_err(Error::Arm)?;
            }
            let measured = on_board(board, settings, [&down, &up]).await;
            if !settings.arm {
                return measured;
            }
            let disarmed = board.disarm().await;
            let measured = measured?;
            disarmed.map_err(Error::Disarm)?;
            Ok(measured)
        });
        connected.await.map_err(Error::Connect)?
    }
    .boxed_local()
}

/// Up to four motors, each with a mode in which 0 means rest.
fn motors(board: &Board<RealClock>) -> Vec<(ChannelId, Mode)> {
    let resting = |mode: Mode, info: &r4_protocol::ChannelInfo| {
        info.mode(mode).filter(|taken| taken.range.contains(0.0)).map(|_| (info.id, mode))
    };
    let channels = board.channels().iter();
    let motors = channels.filter_map(|info| resting(Mode::Duty, info).or_else(|| resting(Mode::Speed, info)));
    motors.take(CYCLE_CHANNELS).collect()
}

async fn on_board(board: &Board<RealClock>, settings: &Settings<'_>, scales: [&Scale; 2]) -> Result<Measured, Error> {
    let motors = motors(board);
    if motors.is_empty() {
        return Err(Error::NoMotor);
    }
    let rest = vec![0.0; motors.len()];
    let mut cycles = board.stream(&motors, TTL_MS).await?;
    let mut measured = Measured { armed: settings.arm, ..Measured::default() };

    for scale in scales {
        scale.on.set(true);
    }
    for _ in 0..COUNTED {
        measured.one_cycle(board, &mut cycles, &rest, settings).await?;
    }
    for scale in scales {
        scale.on.set(false);
    }
    measured.cycle_bytes = scales.into_iter().map(|scale| scale.longest.get()).sum();

    let span = settings.span;
    // The first round warms up; the second one replaces its measurements.
    for span in [WARM_UP.min(span), span] {
        (measured.round_trips, measured.stamps) = (Vec::new(), Vec::new());
        let begin = Instant::now();
        while begin.elapsed() < span {
            measured.one_cycle(board, &mut cycles, &rest, settings).await?;
        }
    }
    // The counters also contain the cycles of the round trips.
    let before = cycles.counters();
    let clock = RealClock;
    let patience_us = u64::try_from(span.saturating_add(PATIENCE).as_micros()).unwrap_or(u64::MAX);
    let end_us = clock.now_us().saturating_add(patience_us);
    let outcome = {
        let sustained = pin!(measured.sustain(board, &mut cycles, &rest, span, settings));
        match select(sustained, pin!(clock.sleep_until(end_us))).await {
            Either::Left((result, _)) => Some(result),
            Either::Right(_) => None,
        }
    };
    outcome.transpose()?;
    let after = cycles.counters();
    // All answers have been awaited or timed out.
    measured.lost += (after.sent - before.sent) - (after.answered - before.answered) + (after.dropped - before.dropped);
    Ok(measured)
}

impl Measured {
    async fn one_cycle(
        &mut self,
        board: &Board<RealClock>,
        cycles: &mut Cycles<'_, RealClock>,
        rest: &[f64],
        settings: &Settings<'_>,
    ) -> Result<(), Error> {
        if (settings.is_interrupted)() {
            return Err(Error::Interrupted);
        }
        let begin = Instant::now();
        match cycles.cycle(rest).await {
            Ok(report) => {
                self.round_trips.push(begin.elapsed().as_nanos() as f64 * 1e-3);
                self.taken(board, &report);
                Ok(())
            }
            Err(DriverError::TimedOut { .. }) => {
                self.lost += 1;
                Ok(())
            }
            Err(error) => Err(error.into()),
        }
    }

    /// Sends cycles continuously for `span`, with `window` in flight.
    async fn sustain(
        &mut self,
        board: &Board<RealClock>,
        cycles: &mut Cycles<'_, RealClock>,
        rest: &[f64],
        span: Duration,
        settings: &Settings<'_>,
    ) -> Result<(), Error> {
        let counters = cycles.counters();
        // Continue the driver's numbering.
        let mut planned = counters.sent + counters.replaced;
        let mut answered = planned;
        let begin = Instant::now();
        loop {
            let more = begin.elapsed() < span;
            while more && planned - answered < settings.window as u64 {
                cycles.send(rest).await?;
                planned += 1;
            }
            if answered == planned {
                return Ok(());
            }
            let report = cycles.next().await?;
            // The driver counts skipped answers as lost.
            answered = report.number + 1;
            self.cycles += 1;
            self.seconds = begin.elapsed().as_secs_f64();
            self.taken(board, &report);
            if (settings.is_interrupted)() {
                return Err(Error::Interrupted);
            }
        }
    }

    fn taken(&mut self, board: &Board<RealClock>, report: &CycleReport) {
        self.not_followed += u64::from(report.outcome != CycleOutcome::Taken);
        self.clock_uncertainty_us = self.clock_uncertainty_us.max(board.clock_uncertainty_us());
        self.stamps.push(Stamp { device_us: report.device_us, host_us: board.host_us(report.device_us) });
    }
}

/// Lengths of passing frames in one direction.
#[derive(Default)]
struct Scale {
    on: Cell<bool>,
    frame: RefCell<Vec<u8>>,
    /// Longest frame that carried a cycle, bytes.
    longest: Cell<usize>,
}

impl Scale {
    fn weigh<T: Message>(&self, bytes: &[u8], is_cycle: fn(&T) -> bool) {
        if !self.on.get() {
            return;
        }
        let mut frame = self.frame.borrow_mut();
        for byte in bytes {
            frame.push(*byte);
            if *byte != 0 {
                // Limit the buffer: bytes without an end are no frame.
                frame.truncate(2 * MAX_FRAME);
                continue;
            }
            let mut decoder = FrameDecoder::new();
            let message = frame.iter().find_map(|byte| decoder.push::<T>(*byte));
            if message.is_some_and(|message| message.is_ok_and(|message| is_cycle(&message))) {
                self.longest.set(self.longest.get().max(frame.len()));
            }
            frame.clear();
        }
    }
}

/// Link whose frame lengths are measured.
struct Weighed<L> {
    link: L,
    scale: Rc<Scale>,
}

impl<L: ErrorType> ErrorType for Weighed<L> {
    type Error = L::Error;
}

impl<L: Read> Read for Weighed<L> {
    async fn read(&mut self, buffer: &mut [u8]) -> Result<usize, L::Error> {
        let len = self.link.read(buffer).await?;
        self.scale.weigh(&buffer[..len], |message| matches!(message, ToHost::Cycle(_)));
        Ok(len)
    }
}

impl<L: Write> Write for Weighed<L> {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, L::Error> {
        let len = self.link.write(bytes).await?;
        self.scale.weigh(&bytes[..len], |message| matches!(message, ToDevice::Cycle(_)));
        Ok(len)
    }

    async fn flush(&mut self) -> Result<(), L::Error> {
        self.link.flush().await
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Frames are measured with their delimiters, also when they arrive in parts; other messages are not counted.
    #[test]
    fn frames_of_cycles_are_weighed() {
        let mut buffer = [0; MAX_FRAME];
        let cycle = ToDevice::Cycle(r4_protocol::Cycle::new(1, None, Some(2), [0; CYCLE_CHANNELS]));
        let frame = r4_protocol::encode_frame(&cycle, &mut buffer).unwrap().to_vec();
        let heartbeat = ToDevice::Heartbeat { session: u16::MAX, host_us: u64::MAX };
        let other = r4_protocol::encode_frame(&heartbeat, &mut buffer).unwrap().to_vec();
        let scale = Scale::default();
        let weigh = |bytes: &[u8]| scale.weigh(bytes, |message| matches!(message, ToDevice::Cycle(_)));
        weigh(&frame);
        assert_eq!(scale.longest.get(), 0, "it is not switched on");
        scale.on.set(true);
        weigh(&other);
        assert_eq!(scale.longest.get(), 0);
        weigh(&frame[..5]);
        weigh(&frame[5..]);
        weigh(&other);
        assert_eq!((scale.longest.get(), frame.len()), (21, 21));
    }
}
