//! Stream of set points at a high rate and of the motors' answers, with one short message in each direction per cycle.

use std::{
    collections::VecDeque,
    pin::pin,
    sync::Mutex,
    task::{Context, Poll, Waker},
};

use futures::future::{Either, select};
use r4_protocol::{
    Causes, ChannelId, ChannelInfo, Cycle, CycleChannel, CycleMotor, CycleOutcome, CycleState, Mode, Range, Refusal,
    Request, SafetyState, Setpoint, ToDevice,
    cycle::{CYCLE_CHANNELS, DUTY_SCALE, NOTHING, steps},
};

use crate::{Board, Clock, Error, board::Wire, connection::State, streams::lock};

/// Time after which a cycle without an answer counts as lost, µs.
const LOST_AFTER_US: u64 = 500_000;
/// Largest number of cycles on the way; further ones wait. The 8-bit `seq` distinguishes 256.
const WINDOW: usize = 128;
/// Capacity for unread answers; the oldest are dropped beyond it.
const ANSWERS: usize = 4096;

/// Counters of a stream's cycles.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CycleCounters {
    /// Cycles sent to the board.
    pub sent: u64,
    /// Cycles that the board answered.
    pub answered: u64,
    /// Cycles sent without an answer, although a later one was answered or 0.5 s have passed.
    pub lost: u64,
    /// Cycles that were never sent, because newer set points replaced them.
    pub replaced: u64,
    /// Answers dropped because the caller did not read them.
    pub dropped: u64,
}

/// Answer of the board to a cycle.
#[derive(Clone, Debug, PartialEq)]
pub struct CycleReport {
    /// Number of the cycle in its stream, from 0; replaced cycles count too.
    pub number: u64,
    /// Outcome at the board. A cycle that it did not take changes none of the set points.
    pub outcome: CycleOutcome,
    /// Board's clock at the answer, µs.
    pub device_us: u64,
    /// Time from sending to the answer on the host's clock, µs.
    pub round_trip_us: u64,
    /// Safety state of the board.
    pub state: SafetyState,
    /// Causes latched by a trip.
    pub causes: Causes,
    /// Motion of each channel, in the order of the stream.
    pub motors: Vec<CycleMotion>,
}

/// Motion of one channel of a cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CycleMotion {
    /// Position in counts of [`ChannelInfo::resolution`].
    pub counts: i32,
    /// Position, rad or m; NaN without a position sensor.
    pub position: f64,
    /// Speed, rad/s or m/s; NaN without a sensor and beyond twice the channel's range.
    pub speed: f64,
    /// Duty as a share of the supply voltage.
    pub duty: f64,
    /// The motor rests at its position.
    pub settled: bool,
}

/// Set points for the transmitter, and the answers that arrived for them.
#[derive(Default)]
pub(crate) struct CycleQueue {
    /// A stream is open; a board has only one.
    open: bool,
    next_seq: u8,
    next_number: u64,
    /// Newest set points, which leave with the next message.
    slot: Option<Planned>,
    under_way: VecDeque<UnderWay>,
    answers: VecDeque<Answer>,
    counters: CycleCounters,
    transmitter: Option<Waker>,
    user: Option<Waker>,
}

struct Planned {
    number: u64,
    /// Date of the set points, on the board's clock, µs.
    device_us: u64,
    set: [i16; CYCLE_CHANNELS],
}

struct UnderWay {
    seq: u8,
    number: u64,
    sent_us: u64,
}

struct Answer {
    number: u64,
    device_us: u64,
    round_trip_us: u64,
    told: CycleState,
}

impl CycleQueue {
    /// Returns the next message to send; pending while there is none or the window is full.
    pub(crate) fn poll_send(&mut self, context: &mut Context<'_>, now_us: u64) -> Poll<ToDevice> {
        while self.under_way.front().is_some_and(|oldest| now_us.saturating_sub(oldest.sent_us) > LOST_AFTER_US) {
            self.under_way.pop_front();
            self.counters.lost += 1;
        }
        let planned = if self.under_way.len() < WINDOW { self.slot.take() } else { None };
        let Some(Planned { number, device_us, set }) = planned else {
            self.transmitter = Some(context.waker().clone());
            return Poll::Pending;
        };
        let seq = self.next_seq;
        self.next_seq = seq.wrapping_add(1);
        self.under_way.push_back(UnderWay { seq, number, sent_us: now_us });
        self.counters.sent += 1;
        self.wake_user();
        Poll::Ready(ToDevice::Cycle(Cycle::new(seq, None, Some(device_us), set)))
    }

    /// Stores an answer and counts the cycles before it as lost. `near_us` is an estimate of the board's clock, which
    /// completes the short time in the answer.
    pub(crate) fn answered(&mut self, told: CycleState, now_us: u64, near_us: u64) {
        // The answer belongs to an earlier stream, or came after its cycle was given up.
        let Some(place) = self.under_way.iter().position(|sent| sent.seq == told.seq) else { return };
        // A link keeps the order, so the cycles before this one will not be answered.
        self.counters.lost += place as u64;
        let Some(UnderWay { number, sent_us, .. }) = self.under_way.drain(..=place).next_back() else { return };
        self.counters.answered += 1;
        if self.answers.len() == ANSWERS {
            self.answers.pop_front();
            self.counters.dropped += 1;
        }
        let round_trip_us = now_us.saturating_sub(sent_us);
        self.answers.push_back(Answer { number, device_us: told.device_us(near_us), round_trip_us, told });
        self.wake_user();
        self.wake_transmitter();
    }

    pub(crate) fn wake_user(&mut self) {
        if let Some(user) = self.user.take() {
            user.wake();
        }
    }

    fn wake_transmitter(&mut self) {
        if let Some(transmitter) = self.transmitter.take() {
            transmitter.wake();
        }
    }

    /// Opens a stream with all counters at 0.
    ///
    /// # Errors
    /// [`Error::StreamOpen`] while another stream is open.
    fn open(&mut self) -> Result<(), Error> {
        if self.open {
            return Err(Error::StreamOpen);
        }
        self.open = true;
        self.next_number = 0;
        self.counters = CycleCounters::default();
        Ok(())
    }

    fn close(&mut self) {
        self.open = false;
        self.slot = None;
        self.under_way.clear();
        self.answers.clear();
    }
}

/// Stream of set points for up to four motors, steppers or brushless drives, made by [`Board::stream`]; dropping it
/// ends the stream.
///
/// The newest set points replace those that have not left yet. The board answers each cycle with the motion of the
/// motors. Without new cycles, the motors stop after the stream's time to live.
pub struct Cycles<'b, C: Clock> {
    wire: &'b Wire<C>,
    channels: Vec<Bound>,
}

struct Bound {
    asked: CycleChannel,
    scale: f32,
    range: Range,
    resolution: f64,
}

impl Bound {
    /// Makes the scales for a mode and a channel. 32 767 steps cover the range of the set points, and twice the range
    /// of the speeds, because measured speeds may overshoot.
    fn new(info: &ChannelInfo, mode: Mode) -> Result<Self, Error> {
        const STEPS: f32 = 32_767.0;
        let wrong_mode = Refusal::WrongMode { channel: info.id, mode };
        let largest = |mode| {
            let Range { min, max } = info.mode(mode)?.range;
            let largest = min.abs().max(max.abs());
            (largest > 0.0 && largest.is_finite()).then_some(largest)
        };
        let asked = CycleChannel {
            channel: info.id,
            mode,
            position_scale: largest(Mode::Position).map_or(1.0, |largest| largest / STEPS),
            speed_scale: largest(Mode::Speed).map_or(1.0, |largest| largest / STEPS * 2.0),
        };
        let range = info.mode(mode).ok_or(wrong_mode)?.range;
        let scale = asked.scale(mode).ok_or(wrong_mode)?;
        Ok(Self { asked, scale, range, resolution: info.resolution.into() })
    }

    /// Rounds `value` to the nearest step that the channel accepts.
    fn steps(&self, value: f64) -> Result<i16, Refusal> {
        let (channel, range, asked) = (self.asked.channel, self.range, value as f32);
        if !value.is_finite() {
            return Err(Refusal::NotFinite { channel });
        }
        let nearest = steps(asked, self.scale).filter(|_| range.contains(asked));
        let takes = |steps: &i16| *steps != NOTHING && range.contains(f32::from(*steps) * self.scale);
        // Rounding may leave the range by one step at its ends.
        let near = nearest.map(|steps| [steps, steps.saturating_sub(1), steps.saturating_add(1)]);
        near.into_iter().flatten().find(takes).ok_or(Refusal::OutOfRange { channel, asked, range })
    }

    fn motion(&self, told: CycleMotor) -> CycleMotion {
        let real =
            |steps: i16, scale: f32| if steps == NOTHING { f64::NAN } else { f64::from(steps) * f64::from(scale) };
        CycleMotion {
            counts: told.position,
            position: if self.resolution > 0.0 { f64::from(told.position) * self.resolution } else { f64::NAN },
            speed: real(told.speed, self.asked.speed_scale),
            duty: real(told.duty, DUTY_SCALE),
            settled: told.settled,
        }
    }
}

/// Decodes the set points in a cycle with the channels and scales that it is bound to.
pub(crate) fn setpoints(cycle: &Cycle, bound: &[CycleChannel]) -> Vec<(ChannelId, Setpoint)> {
    let of_channel = |(channel, steps): (&CycleChannel, i16)| {
        let mode = cycle.mode().ok()?.unwrap_or(channel.mode);
        let value = f32::from(steps) * channel.scale(mode)?;
        (steps != NOTHING).then_some((channel.channel, Setpoint { mode, value }))
    };
    bound.iter().zip(cycle.set()).filter_map(of_channel).collect()
}

impl<C: Clock> Board<C> {
    /// Opens a stream of set points for one to four `channels`, each with its mode: position, speed or duty. The board
    /// drops set points older than `ttl_ms`, on arrival and later: the motors stop.
    ///
    /// A position is sent in 32 767 steps of its range, a speed in 16 384: with a range of 1000 rad, a position is
    /// rounded to 0.03 rad. [`Board::set`] sends the number itself.
    ///
    /// ```
    /// # mod bench { include!(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/all/simulated/mod.rs")); }
    /// # bench::simulated(async |board| {
    /// use r4_protocol::Mode;
    ///
    /// let (motor, rod) = ("osmc0".parse().unwrap(), "actuator1".parse().unwrap());
    /// board.arm().await?;
    /// let mut cycles = board.stream(&[(motor, Mode::Speed), (rod, Mode::Position)], 100).await?;
    /// let mut turned = 0.0;
    /// while turned < 1.0 {
    ///     let report = cycles.cycle(&[2.0, 0.02]).await?;
    ///     turned = report.motors[0].position;
    ///     board.sleep_s(0.01).await;
    /// }
    /// assert_eq!(cycles.counters().lost, 0);
    /// drop(cycles);
    /// board.disarm().await
    /// # }).unwrap();
    /// ```
    ///
    /// # Errors
    /// [`Error::StreamOpen`] while another stream is open, [`Error::CycleLength`], [`Refusal::WrongMode`], besides the
    /// errors of any request.
    pub async fn stream(&self, channels: &[(ChannelId, Mode)], ttl_ms: u16) -> Result<Cycles<'_, C>, Error> {
        if channels.is_empty() || channels.len() > CYCLE_CHANNELS {
            return Err(Error::CycleLength { asked: channels.len(), expected: CYCLE_CHANNELS });
        }
        let bound = |(channel, mode): &(ChannelId, Mode)| Bound::new(self.channel(*channel)?, *mode);
        let channels = channels.iter().map(bound).collect::<Result<Vec<_>, _>>()?;
        let asked = channels.iter().map(|channel| channel.asked).collect();
        lock(&self.wire.state).cycles.open()?;
        // `Cycles` exists before the request, so that dropping it closes the stream when the request fails.
        let cycles = Cycles { wire: &self.wire, channels };
        self.wire.done("bind", Request::Bind { channels: asked, ttl_ms }).await?;
        Ok(cycles)
    }
}

impl<C: Clock> Cycles<'_, C> {
    /// Sends `values`, one per channel in rad, m, rad/s, m/s or share of the supply voltage, as soon as the link
    /// accepts them. They replace earlier ones that have not left yet. [`Cycles::next`] returns the answers.
    ///
    /// # Errors
    /// [`Refusal::OutOfRange`], [`Refusal::NotFinite`] or [`Error::CycleLength`]: no set point is sent, and the
    /// channels are stopped. The error that ended the link.
    pub fn set(&mut self, values: &[f64]) -> Result<(), Error> {
        let set = self.steps(values)?;
        self.plan(set).map(|_| ())
    }

    /// Sends `values` as [`Cycles::set`] does, but waits until the earlier ones have left, so that it replaces none.
    ///
    /// # Errors
    /// Those of [`Cycles::set`].
    pub async fn send(&mut self, values: &[f64]) -> Result<(), Error> {
        let set = self.steps(values)?;
        self.wait(|queue| queue.slot.is_none().then_some(())).await?;
        self.plan(set).map(|_| ())
    }

    /// Sends `values` as [`Cycles::set`] does and waits for their answer. Skips answers to earlier cycles.
    ///
    /// # Errors
    /// Those of [`Cycles::set`]; [`Error::TimedOut`] when cycle or answer was lost: the board may have followed the set
    /// points or not.
    pub async fn cycle(&mut self, values: &[f64]) -> Result<CycleReport, Error> {
        let set = self.steps(values)?;
        self.turn(set).await
    }

    /// Requests the motion of the motors as [`Cycles::cycle`] does, without set points: the motors stop as if no cycle
    /// had been sent.
    ///
    /// # Errors
    /// Those of [`Cycles::cycle`].
    pub async fn ask(&mut self) -> Result<CycleReport, Error> {
        self.turn([NOTHING; CYCLE_CHANNELS]).await
    }

    /// Waits for the next unread answer, indefinitely when no cycle is on its way.
    ///
    /// # Errors
    /// The error that ended the link.
    pub async fn next(&mut self) -> Result<CycleReport, Error> {
        let answer = self.wait(|queue| queue.answers.pop_front()).await?;
        self.report(answer)
    }

    /// Returns the counters of the stream's cycles so far.
    #[must_use]
    pub fn counters(&self) -> CycleCounters {
        lock(&self.wire.state).cycles.counters
    }

    async fn turn(&mut self, set: [i16; CYCLE_CHANNELS]) -> Result<CycleReport, Error> {
        let number = self.plan(set)?;
        let begin_us = self.wire.clock.now_us();
        let timed_out = |after_us: u64| Error::TimedOut { request: "cycle", after_ms: (after_us / 1000) as u32 };
        let own = pin!(self.wait(|queue| {
            while queue.answers.front().is_some_and(|answer| answer.number < number) {
                queue.answers.pop_front();
            }
            queue.answers.pop_front()
        }));
        match select(own, pin!(self.wire.clock.sleep_until(begin_us + LOST_AFTER_US))).await {
            Either::Left((answer, _)) => match answer? {
                answer if answer.number == number => self.report(answer),
                // A later cycle was answered, so this one is lost.
                _ => Err(timed_out(self.wire.clock.now_us() - begin_us)),
            },
            Either::Right(((), _)) => Err(timed_out(LOST_AFTER_US)),
        }
    }

    fn steps(&self, values: &[f64]) -> Result<[i16; CYCLE_CHANNELS], Error> {
        let steps = self.rounded(values);
        if steps.is_err() {
            self.withdraw();
        }
        steps
    }

    /// Stops the channels of the stream after invalid set points: the previous ones no longer hold, and the new ones
    /// cannot be sent.
    fn withdraw(&self) {
        {
            let queue = &mut lock(&self.wire.state).cycles;
            queue.counters.replaced += u64::from(queue.slot.take().is_some());
        }
        for Bound { asked: CycleChannel { channel, mode, .. }, .. } in &self.channels {
            let mode = if *mode == Mode::Duty { Mode::Duty } else { Mode::Speed };
            self.wire.tell(self.wire.set(*channel, Setpoint { mode, value: 0.0 }));
        }
    }

    fn rounded(&self, values: &[f64]) -> Result<[i16; CYCLE_CHANNELS], Error> {
        if values.len() != self.channels.len() {
            return Err(Error::CycleLength { asked: values.len(), expected: self.channels.len() });
        }
        let mut set = [NOTHING; CYCLE_CHANNELS];
        for ((steps, channel), value) in set.iter_mut().zip(&self.channels).zip(values) {
            *steps = channel.steps(*value)?;
        }
        Ok(set)
    }

    fn plan(&self, set: [i16; CYCLE_CHANNELS]) -> Result<u64, Error> {
        let state = &mut *lock(&self.wire.state);
        if let Some(end) = &state.end {
            return Err(end.clone());
        }
        let device_us = state.date_us(self.wire.clock.now_us());
        let queue = &mut state.cycles;
        let number = queue.next_number;
        queue.next_number += 1;
        if queue.slot.replace(Planned { number, device_us, set }).is_some() {
            queue.counters.replaced += 1;
        }
        queue.wake_transmitter();
        Ok(number)
    }

    async fn wait<T>(&self, mut ready: impl FnMut(&mut CycleQueue) -> Option<T>) -> Result<T, Error> {
        let state: &Mutex<State> = &self.wire.state;
        std::future::poll_fn(|context| {
            let state = &mut *lock(state);
            if let Some(done) = ready(&mut state.cycles) {
                return Poll::Ready(Ok(done));
            }
            if let Some(end) = &state.end {
                return Poll::Ready(Err(end.clone()));
            }
            state.cycles.user = Some(context.waker().clone());
            Poll::Pending
        })
        .await
    }

    fn report(&self, answer: Answer) -> Result<CycleReport, Error> {
        let Answer { number, device_us, round_trip_us, told } = answer;
        let state = told.state().map_err(|_| Error::WrongReply { request: "cycle" })?;
        let motors = self.channels.iter().zip(told.motors()).map(|(channel, motor)| channel.motion(motor)).collect();
        let (outcome, causes) = (told.outcome(), told.causes());
        Ok(CycleReport { number, outcome, device_us, round_trip_us, state, causes, motors })
    }
}

impl<C: Clock> Drop for Cycles<'_, C> {
    fn drop(&mut self) {
        lock(&self.wire.state).cycles.close();
        // The answer is not needed: without it the motors stop after their time to live.
        self.wire.tell(Request::Bind { channels: [].into_iter().collect(), ttl_ms: 0 });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use r4_protocol::{ChannelKind, ModeInfo, Unit};

    fn bound(mode: Mode, range: Range) -> Bound {
        let info = ChannelInfo {
            id: ChannelId::new(ChannelKind::Osmc, 0),
            unit: Unit::Rad,
            range,
            rate_hz: 1000.0,
            resolution: 0.5,
            modes: [ModeInfo { mode, unit: Unit::Rad, range }].into_iter().collect(),
        };
        Bound::new(&info, mode).unwrap()
    }

    /// Checks that each value in a channel's range is rounded to a step inside that range, at most half a step away
    /// except at its ends.
    #[test]
    fn steps_are_in_the_range_of_the_channel() {
        let ranges = [(-62.83186, 62.83186), (0.01, 0.09), (0.0, 1.0), (-0.902, 0.902), (-1e-3, 5e6), (-7.3, -0.1)];
        for mode in [Mode::Position, Mode::Speed, Mode::Duty] {
            for (min, max) in ranges.into_iter().filter(|(_, max)| mode != Mode::Duty || *max <= 1.0) {
                let bound = bound(mode, Range::new(min, max));
                for share in 0..=1000 {
                    let value = f64::from(min) + (f64::from(max) - f64::from(min)) * f64::from(share) / 1000.0;
                    let value = value.clamp(min.into(), max.into());
                    if mode == Mode::Duty && value < -1.0 {
                        continue;
                    }
                    let sent = f32::from(bound.steps(value).unwrap()) * bound.scale;
                    assert!(bound.range.contains(sent), "{mode} {value} became {sent}");
                    let at_end = share == 0 || share == 1000;
                    let allowed = f64::from(bound.scale) * if at_end { 1.01 } else { 0.51 } + f64::from(max) * 1e-6;
                    assert!((f64::from(sent) - value).abs() <= allowed, "{mode} {value} became {sent}");
                }
                for beyond in [f64::from(max) + f64::from(max.abs()) * 0.001 + 1e-6, f64::from(min) - 1e-3, f64::MAX] {
                    assert!(matches!(bound.steps(beyond), Err(Refusal::OutOfRange { .. })), "{beyond}");
                }
                for no_number in [f64::NAN, f64::INFINITY] {
                    assert!(matches!(bound.steps(no_number), Err(Refusal::NotFinite { .. })));
                }
            }
        }
    }

    fn send(queue: &mut CycleQueue, now_us: u64) -> Option<u8> {
        let mut context = Context::from_waker(Waker::noop());
        match queue.poll_send(&mut context, now_us) {
            Poll::Ready(ToDevice::Cycle(cycle)) => Some(cycle.seq),
            Poll::Ready(_) | Poll::Pending => None,
        }
    }

    fn plan(queue: &mut CycleQueue) {
        queue.slot = Some(Planned { number: queue.next_number, device_us: 0, set: [0; 4] });
        queue.next_number += 1;
    }

    fn answer(seq: u8) -> CycleState {
        CycleState::new(seq, CycleOutcome::Taken, 7, (SafetyState::Armed, Causes::NONE), [CycleMotor::NONE; 4])
    }

    #[test]
    fn what_is_passed_over_is_lost_and_counted_once() {
        let mut queue = CycleQueue::default();
        for seq in 0..5 {
            plan(&mut queue);
            assert_eq!(send(&mut queue, 0), Some(seq));
        }
        queue.answered(answer(2), 100, 0);
        queue.answered(answer(1), 110, 0);
        queue.answered(answer(2), 120, 0);
        let expected = CycleCounters { sent: 5, answered: 1, lost: 2, replaced: 0, dropped: 0 };
        assert_eq!(queue.counters, expected);
        assert_eq!(queue.answers.iter().map(|answer| answer.number).collect::<Vec<_>>(), [2]);
        // The two others count as lost after their time.
        assert_eq!(send(&mut queue, LOST_AFTER_US + 1), None);
        assert_eq!(queue.counters, CycleCounters { lost: 4, ..expected });
    }

    #[test]
    fn numbers_on_the_wire_wrap_and_no_two_under_way_are_alike() {
        let mut queue = CycleQueue::default();
        for turn in 0..1000_u64 {
            plan(&mut queue);
            let seq = send(&mut queue, turn).unwrap();
            assert_eq!(u64::from(seq), turn % 256);
            queue.answered(answer(seq), turn, 0);
        }
        assert_eq!((queue.counters.answered, queue.counters.lost), (1000, 0));
        for _ in 0..WINDOW {
            plan(&mut queue);
            assert!(send(&mut queue, 1000).is_some());
        }
        plan(&mut queue);
        assert_eq!(send(&mut queue, 1000), None, "a board that does not answer is not told more");
        queue.answered(answer(1000_u16 as u8), 1001, 0);
        assert!(send(&mut queue, 1001).is_some());
        assert_eq!(queue.answers.len(), 1001);
    }
}
