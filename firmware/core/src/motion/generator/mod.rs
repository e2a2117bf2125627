//! From events to what a PWM timer is told: the part of a step generator that is not registers.
//!
//! Each axis has a timer that runs through for ever. One of its *periods* begins with a pulse, or is blank; its length and
//! kind are preloaded, so that they change at its end and never in it. All axes share a free-running 32-bit counter of the
//! same ticks, the *clock*. A timer goes on with the period it has until it is told another, so that several like periods, a
//! *stretch*, need one interrupt, in the last of them, which loads the stretch that follows. As every stretch begins where
//! the one before ended, the clock alone tells which period a timer is in, and so how many pulses it has begun; the
//! timer's own interrupts, counters and flags are not used.
//!
//! - Nothing to do is blank periods of [`IDLE`] ticks without end, and without interrupts.
//! - A pulse that is more than [`LONGEST`] ticks away is waited for in blank periods, of which the last is as long as it
//!   takes. Such pulses are exact, as is the first after the direction line turned.
//! - Pulses closer than that and of one direction are made in stretches of equal spacing: as many, up to [`MOST`], as one
//!   whole spacing keeps within [`ERROR`] ticks of their events. The spacing is rounded down and the next stretch is
//!   reckoned from where this one ends, so that no error adds up, the last of a stretch is never late (the direction line
//!   may turn after it), and no spacing is shorter than the shortest between the events of the stretch.
//!
//! # How late an interrupt may be
//! It has from [`AFTER`] ticks after the beginning of the last period of a stretch to [`BEFORE`] ticks before its end. If
//! it comes later, the timer has made the period once more. A pulse that was made so stands for the next event if that is a
//! pulse, which was due about then. If it is not, a pulse too many was made: it is counted, and what is queued is dropped, so
//! that whoever compares what was made with what was told sees it. If no interrupt ever comes, pulses go on at the last
//! spacing: a watchdog must end that.

use heapless::Deque;

use crate::platform::{StepAction, StepEvent};

mod stretch;
#[cfg(test)]
mod tests;

use stretch::{blank, pulses};

/// Most that a pulse is made before or after the tick of its event, if events are told [`LEAD`] ticks before.
pub const ERROR: u32 = 8;
/// Shortest period. Events closer than this are made this far apart.
pub const SHORTEST: u32 = 100;
/// Longest period.
pub const LONGEST: u32 = 1024;
/// A blank period when nothing is to be done, and the least after a pulse without a near successor.
pub const IDLE: u32 = 256;
/// Most periods in a stretch of pulses: bounds how long the interrupt takes.
pub const MOST: u32 = 16;
/// By how much events must be told ahead to be made in time: the rest of a period after [`Generator::stop`], an idle one,
/// and the wait for the pulse.
pub const LEAD: u32 = LONGEST + IDLE + SHORTEST + BEFORE;
/// The timer is written at least this long after a period's beginning: it may begin this much later than the clock says,
/// for timers and clock are started one after the other.
pub const AFTER: u32 = 8;
/// And at least this long before its end: the time from reading the clock to having written.
pub const BEFORE: u32 = 12;

/// A generator asks to be served at least this often, so that no difference of ticks overflows.
const SELDOM: u32 = 1 << 30;
const ENDLESS: u32 = u32::MAX;

/// The registers behind one generator.
pub trait StepTimer {
    /// The clock.
    fn now(&mut self) -> u32;
    /// Writes the length of the periods from the next on, and whether they begin with a pulse.
    fn preload(&mut self, ticks: u32, pulse: bool);
    /// Turns the direction line: `true` for positive.
    fn turn(&mut self, positive: bool);
}

/// Like periods of a timer.
#[derive(Clone, Copy, Debug)]
struct Stretch {
    start: u32,
    period: u32,
    count: u32,
    /// What each counts for: 1 or -1 for a pulse, 0 if blank.
    step: i32,
}

impl Stretch {
    const fn idle(start: u32) -> Self {
        Self { start, period: IDLE, count: ENDLESS, step: 0 }
    }

    const fn is_endless(&self) -> bool {
        self.count == ENDLESS
    }

    /// The period in which `now` is, from 0; also beyond the last.
    const fn index(&self, now: u32) -> u32 {
        now.wrapping_sub(self.start) / self.period
    }

    const fn end(&self) -> u32 {
        self.start.wrapping_add(self.period.wrapping_mul(self.count))
    }

    /// From when on the stretch behind this one may be loaded.
    const fn window(&self) -> u32 {
        self.end().wrapping_sub(self.period).wrapping_add(AFTER)
    }

    /// Pulses begun.
    fn begun(&self, now: u32) -> u32 {
        if self.step == 0 { 0 } else { self.count.min(self.index(now) + 1) }
    }
}

/// A stretch to be loaded, and what it does to the queue.
struct Plan {
    stretch: Stretch,
    /// Events that it carries out.
    events: usize,
    turn: Option<(u32, bool)>,
}

/// What is left until `tick`, negative when it is over.
const fn until(tick: u32, now: u32) -> i32 {
    tick.wrapping_sub(now).cast_signed()
}

/// The step generator of one axis, with room for `ROOM` events.
///
/// Its methods must not interrupt each other, nor be interrupted by more than [`BEFORE`] allows.
#[derive(Debug)]
pub struct Generator<const ROOM: usize> {
    queue: Deque<StepEvent, ROOM>,
    current: Stretch,
    /// What the timer is loaded with.
    next: Option<Stretch>,
    /// When the direction line is to turn, and to what.
    turn: Option<(u32, bool)>,
    /// What the direction line is.
    line: bool,
    /// What it is when everything loaded has been made.
    positive: bool,
    /// Pulses of the stretches before the current.
    position: i32,
}

impl<const ROOM: usize> Generator<ROOM> {
    /// For a timer whose first blank period of [`IDLE`] ticks, loaded for good, began at `start`, which is over, and a direction line
    /// that is positive.
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

    /// Appends events that are in order; returns how many found room. [`Generator::serve`] must follow.
    pub fn queue(&mut self, events: &[StepEvent]) -> usize {
        let room = events.len().min(ROOM - self.queue.len());
        for event in &events[..room] {
            let _ = self.queue.push_back(*event);
        }
        room
    }

    /// Events that are not begun at `now`.
    pub fn pending(&mut self, now: u32) -> u32 {
        self.advance(now);
        let waiting = self.queue.len() as u32 + u32::from(self.turn.is_some());
        let loaded = self.next.filter(|next| next.step != 0).map_or(0, |next| next.count);
        let coming = if self.current.step == 0 { 0 } else { self.current.count - self.current.begun(now) };
        waiting + loaded + coming
    }

    /// Pulses begun up to `now`, those of negative direction taken off.
    pub fn position(&mut self, now: u32) -> i32 {
        self.advance(now);
        self.position.wrapping_add(self.current.step.wrapping_mul(self.current.begun(now).cast_signed()))
    }

    /// Drops what is queued. A pulse that has begun is completed. Waits for up to `AFTER + BEFORE` ticks.
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
            // Near a boundary it cannot be told whether the timer has passed it.
            if until(now, begin) >= AFTER.cast_signed() && until(end, now) > BEFORE.cast_signed() {
                timer.preload(IDLE, false);
                self.current.count = index + 1;
                self.next = Some(Stretch::idle(end));
                return;
            }
        }
    }

    /// Does what is due. If that was to be loaded by now, waits for up to `AFTER + BEFORE` ticks until it can be again. Returns
    /// the tick at which to call again, which may be over already.
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
        // Idle periods that are loaded give way to something to do.
        if open && self.next.is_none_or(|next| next.is_endless() && !self.queue.is_empty()) {
            self.load(timer);
        }
        self.due(now)
    }

    /// Lets the clock go on to `now`: the current stretch may be over. Returns whether it is made longer because nothing was
    /// loaded in time.
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

    /// The last period, with a pulse, is made once more than was planned.
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

    /// When to serve next.
    fn due(&self, now: u32) -> u32 {
        let stretch = match self.next {
            // Time to look at it again when it has begun.
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

    /// What to do from `start` on.
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
