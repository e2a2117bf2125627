//! Step generator without its registers: converts events into the settings of a PWM timer.
//!
//! Each axis has a timer that runs without end. Each of its *periods* begins with a pulse, or is blank; length and kind
//! are preloaded, so that they change at its end and never within. All axes share a free-running 32-bit counter of the
//! same ticks, the *clock*. A timer repeats its period until it is loaded with another, so that several equal periods,
//! a *stretch*, need one interrupt, in the last of them, which loads the following stretch. As every stretch begins
//! where the one before ended, the clock alone shows in which period a timer is, and so how many pulses it has begun;
//! the timer's own interrupts, counters and flags are not used.
//!
//! - Without events there are blank periods of [`IDLE`] ticks without end, and without interrupts.
//! - A pulse more than [`LONGEST`] ticks away is preceded by blank periods, the last of which is adjusted. Such pulses
//!   are exact, as is the first after the direction line turned.
//! - Closer pulses of one direction are made in stretches of equal spacing: as many, up to [`MOST`], as one whole
//!   spacing keeps within [`ERROR`] ticks of their events. The spacing is rounded down and the next stretch is planned
//!   from where this one ends, so that no error adds up, the last of a stretch is never late (the direction line may
//!   turn after it), and no spacing is shorter than the shortest between the events of the stretch.
//!
//! # Permitted interrupt latency
//! The interrupt has from [`AFTER`] ticks after the beginning of the last period of a stretch to [`BEFORE`] ticks
//! before its end. If it comes later, the timer has made the period once more. A repeated pulse takes the place of the
//! next event if that is a pulse, which was due about then. If it is not, there is one pulse too many: it is counted,
//! and the queue is dropped, so that a comparison of pulses made with pulses queued shows it. If no interrupt ever
//! comes, pulses continue at the last spacing: a watchdog must end that.

use heapless::Deque;

use crate::platform::{StepAction, StepEvent};

mod stretch;
#[cfg(test)]
mod tests;

pub use stretch::{ERROR, IDLE, LONGEST, MOST, SHORTEST};
use stretch::{blank, pulses, until};

/// Ticks by which events must be queued ahead to be made in time: the rest of a period after [`Generator::stop`], an
/// idle one, and the wait for the pulse.
pub const LEAD: u32 = LONGEST + IDLE + SHORTEST + BEFORE;
/// Shortest time from a period's beginning to a write to the timer, ticks: the period may begin this much later than
/// the clock shows, as timers and clock are started one after the other.
pub const AFTER: u32 = 8;
/// Shortest time from a write to the period's end, ticks: covers reading the clock and writing.
pub const BEFORE: u32 = 12;

/// Longest interval between two services of a generator, ticks, so that no difference of ticks overflows.
const SELDOM: u32 = 1 << 30;
const ENDLESS: u32 = u32::MAX;

/// Registers behind one generator.
pub trait StepTimer {
    /// Value of the shared clock, ticks.
    fn now(&mut self) -> u32;
    /// Preloads the length of the following periods, and whether they begin with a pulse.
    fn preload(&mut self, ticks: u32, pulse: bool);
    /// Turns the direction line: `true` for positive.
    fn turn(&mut self, positive: bool);
}

/// Equal periods of a timer.
#[derive(Clone, Copy, Debug)]
struct Stretch {
    start: u32,
    period: u32,
    count: u32,
    /// Position change of each period: 1 or -1 for a pulse, 0 if blank.
    step: i32,
}

impl Stretch {
    const fn idle(start: u32) -> Self {
        Self { start, period: IDLE, count: ENDLESS, step: 0 }
    }

    const fn is_endless(&self) -> bool {
        self.count == ENDLESS
    }

    /// Index of the period that contains `now`, from 0; also beyond the last.
    const fn index(&self, now: u32) -> u32 {
        now.wrapping_sub(self.start) / self.period
    }

    const fn end(&self) -> u32 {
        self.start.wrapping_add(self.period.wrapping_mul(self.count))
    }

    /// Tick from which on the next stretch may be loaded.
    const fn window(&self) -> u32 {
        self.end().wrapping_sub(self.period).wrapping_add(AFTER)
    }

    /// Number of pulses begun at `now`.
    fn begun(&self, now: u32) -> u32 {
        if self.step == 0 { 0 } else { self.count.min(self.index(now) + 1) }
    }
}

/// Stretch to be loaded, and its effect on the queue.
struct Plan {
    stretch: Stretch,
    /// Number of events that it carries out.
    events: usize,
    turn: Option<(u32, bool)>,
}

/// Step generator of one axis, with room for `ROOM` events.
///
/// Its methods must not interrupt each other, nor be interrupted for longer than [`BEFORE`] allows.
#[derive(Debug)]
pub struct Generator<const ROOM: usize> {
    queue: Deque<StepEvent, ROOM>,
    current: Stretch,
    /// Stretch that is preloaded in the timer.
    next: Option<Stretch>,
    /// Next change of the direction line: its tick, and its new level.
    turn: Option<(u32, bool)>,
    /// Present level of the direction line.
    line: bool,
    /// Level of the direction line when everything loaded has been made.
    positive: bool,
    /// Pulses of the stretches before the current one.
    position: i32,
}

impl<const ROOM: usize> Generator<ROOM> {
    /// Creates a generator for a timer whose blank periods of [`IDLE`] ticks began at `start`, in the past, and whose
    /// direction line is positive.
    #[must_use]
    pub const fn new(start: u32) -> Self {
        Self {
            queue: Deque::new(),
            current: Stretch::idle(start),
            next: None,
            turn: None,
            line: true,
            positive: true,
            position: 0,
        }
    }

    /// Appends events, which are in order; returns how many found room. [`Generator::serve`] must follow.
    pub fn queue(&mut self, events: &[StepEvent]) -> usize {
        let room = events.len().min(ROOM - self.queue.len());
        for event in &events[..room] {
            let _ = self.queue.push_back(*event);
        }
        room
    }

    /// Number of events that have not begun at `now`.
    pub fn pending(&mut self, now: u32) -> u32 {
        self.advance(now);
        let waiting = self.queue.len() as u32 + u32::from(self.turn.is_some());
        let loaded = self.next.filter(|next| next.step != 0).map_or(0, |next| next.count);
        let coming = if self.current.step == 0 { 0 } else { self.current.count - self.current.begun(now) };
        waiting + loaded + coming
    }

    /// Number of pulses begun up to `now`, those of negative direction subtracted.
    pub fn position(&mut self, now: u32) -> i32 {
        self.advance(now);
        self.position.wrapping_add(self.current.step.wrapping_mul(self.current.begun(now).cast_signed()))
    }

    /// Drops the queue. A pulse that has begun is completed. Waits for up to `AFTER + BEFORE` ticks.
    pub fn stop(&mut self, timer: &mut impl StepTimer) {
        self.queue.clear();
        self.turn = None;
        self.positive = self.line;
        loop {
            let now = timer.now();
            self.advance(now);
            if self.current.is_endless() {
                return;
            }
            let index = self.current.index(now);
            let begin = self.current.start.wrapping_add(index * self.current.period);
            let end = begin.wrapping_add(self.current.period);
            // Near a boundary it is uncertain whether the timer has passed it.
            if until(now, begin) >= AFTER.cast_signed() && until(end, now) > BEFORE.cast_signed() {
                timer.preload(IDLE, false);
                self.current.count = index + 1;
                self.next = Some(Stretch::idle(end));
                return;
            }
        }
    }

    /// Carries out what is due. If a load is overdue, waits for up to `AFTER + BEFORE` ticks until it is possible
    /// again. Returns the tick at which to call again, which may already be over.
    pub fn serve(&mut self, timer: &mut impl StepTimer) -> u32 {
        let mut now = timer.now();
        let late = self.advance(now);
        if let Some((_, positive)) = self.turn.take_if(|(tick, _)| until(*tick, now) <= 0) {
            timer.turn(positive);
            self.line = positive;
        }
        if !self.queue.is_empty() && self.current.is_endless() {
            self.current.count = 1;
            self.advance(now);
        }
        // Too late, but about to be in time again: an interrupt that is always as late would miss that too.
        while late && until(self.current.window(), now) > 0 {
            now = timer.now();
            self.advance(now);
        }
        let open = !self.current.is_endless() && until(self.current.window(), now) <= 0;
        // Preloaded idle periods are replaced when there are events.
        if open && self.next.is_none_or(|next| next.is_endless() && !self.queue.is_empty()) {
            self.load(timer);
        }
        self.due(now)
    }

    /// Advances to `now`, at which the current stretch may be over. Returns true if it was prolonged because nothing
    /// was loaded in time.
    fn advance(&mut self, now: u32) -> bool {
        if until(self.current.end(), now) <= 0
            && !self.current.is_endless()
            && let Some(next) = self.next.take()
        {
            let made = self.current.step.wrapping_mul(self.current.count.cast_signed());
            self.position = self.position.wrapping_add(made);
            self.current = next;
        }
        if self.current.is_endless() {
            let over = self.current.index(now) * self.current.period;
            self.current.start = self.current.start.wrapping_add(over);
            return false;
        }
        let in_time = self.current.index(now.wrapping_add(BEFORE)) + 1;
        if self.next.is_some() || self.current.count >= in_time {
            return false;
        }
        if self.current.step != 0 {
            (self.current.count..in_time).for_each(|_| self.stand_in());
        }
        self.current.count = in_time;
        true
    }

    /// Accounts for the last period, with a pulse, being made once more than planned.
    fn stand_in(&mut self) {
        match self.queue.front() {
            Some(StepEvent { action: StepAction::Pulse, .. }) => {
                self.queue.pop_front();
            }
            _ => self.queue.clear(),
        }
    }

    fn load(&mut self, timer: &mut impl StepTimer) {
        let end = self.current.end();
        let plan = self.plan(end);
        if until(end, timer.now()) <= BEFORE.cast_signed() {
            return;
        }
        timer.preload(plan.stretch.period, plan.stretch.step != 0);
        for _ in 0..plan.events {
            self.queue.pop_front();
        }
        if let Some((_, positive)) = plan.turn {
            self.turn = plan.turn;
            self.positive = positive;
        }
        self.next = Some(plan.stretch);
    }

    /// Tick of the next service.
    fn due(&self, now: u32) -> u32 {
        let stretch = match self.next {
            // Checked again when it has begun.
            Some(next) if next.is_endless() && !self.queue.is_empty() => next.start.wrapping_add(AFTER),
            Some(next) if next.is_endless() => now.wrapping_add(SELDOM),
            Some(next) => next.window(),
            None if self.current.is_endless() => now.wrapping_add(SELDOM),
            None => self.current.window(),
        };
        match self.turn {
            Some((tick, _)) if until(tick, stretch) < 0 => tick,
            _ => stretch,
        }
    }

    /// Plans the stretch that begins at `start`.
    fn plan(&self, start: u32) -> Plan {
        let mut events = self.queue.iter();
        let (mut directions, mut turn) = (0, None);
        let first = loop {
            match events.next() {
                Some(StepEvent { at, action: StepAction::Direction(positive) }) => {
                    turn = Some((*at, *positive));
                    directions += 1;
                }
                Some(StepEvent { at, action: StepAction::Pulse }) => break *at,
                None => return Plan { stretch: Stretch::idle(start), events: directions, turn },
            }
        };
        let wait = until(first, start);
        if wait > ERROR.cast_signed() {
            let (count, period) = blank(wait.cast_unsigned());
            return Plan { stretch: Stretch { start, period, count, step: 0 }, events: directions, turn };
        }
        let positive = turn.map_or(self.positive, |(_, positive)| positive);
        let (count, period) = pulses(start, events);
        let stretch = Stretch { start, period, count, step: if positive { 1 } else { -1 } };
        Plan { stretch, events: directions + count as usize, turn }
    }
}
