//! The drive acts a fixed time after it was commanded.
//!
//! No other input effect depends on absolute time, so a delay gives the same result before or after it. A plant adds up
//! all its delays in front of the other input effects: there the drive changes only by command, not by ramps.

use std::collections::VecDeque;

use crate::{
    drive::Drive,
    parameter::{Parameter, fitted},
};

fitted! {
    /// The drive acts a fixed time after its command: bus cycles, PWM periods, a slow bridge.
    ///
    /// Exact for steps of any length. Only changes closer together than 1/1024 of the delay are merged, and act at the
    /// time of the earlier one.
    pub struct InputDelay {
        /// Time from command to action, s.
        pub delay_s: Parameter::new("delay_s", "s").within(0.0, 1.0).typical(0.01);
    }
}

/// Largest number of pending changes: the queue is allocated once.
const CAPACITY: usize = 1024;

/// Tolerance, s, within which two instants are the same: far below any step, far above the rounding of a day in
/// seconds.
const SAME_S: f64 = 1e-11;

/// Pending drives, each with the instant from which it acts.
#[derive(Clone, Debug)]
pub(crate) struct DelayLine {
    delay_s: f64,
    acting: Drive,
    newest: Drive,
    newest_from_s: f64,
    under_way: VecDeque<(f64, Drive)>,
}

impl DelayLine {
    /// A line without pending changes; `delay_s` from command to action.
    pub(crate) fn new(delay_s: f64) -> Self {
        Self {
            delay_s,
            acting: Drive::COAST,
            newest: Drive::COAST,
            newest_from_s: f64::NEG_INFINITY,
            under_way: VecDeque::with_capacity(CAPACITY + 2),
        }
    }

    /// Time of the next change of the acting drive under a constant command, s; infinite if nothing is pending.
    pub(crate) fn next_change_s(&self) -> f64 {
        self.under_way.front().map_or(f64::INFINITY, |(from_s, _)| *from_s)
    }

    /// Drive that acts at `now_s` while `drive` is commanded.
    pub(crate) fn apply(&mut self, drive: Drive, now_s: f64) -> Drive {
        if drive != self.newest {
            self.newest = drive;
            let from_s = now_s + self.delay_s;
            let spacing_s = self.delay_s / CAPACITY as f64;
            match self.under_way.back_mut() {
                Some((_, last)) if from_s < self.newest_from_s + spacing_s => *last = drive,
                _ => {
                    self.newest_from_s = from_s;
                    self.under_way.push_back((from_s, drive));
                }
            }
        }
        while let Some((from_s, due)) = self.under_way.front().copied() {
            if from_s > now_s + SAME_S {
                break;
            }
            self.acting = due;
            self.under_way.pop_front();
        }
        self.acting
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(delay_s: f64) -> DelayLine {
        DelayLine::new(delay_s)
    }

    #[test]
    fn a_change_acts_exactly_after_the_delay() {
        let mut line = line(0.010);
        let [slow, fast] = [Drive::with_brake(0.2), Drive::with_brake(0.8)];
        assert_eq!(line.apply(slow, 1.000), Drive::COAST);
        assert_eq!(line.apply(fast, 1.004), Drive::COAST);
        assert_eq!(line.next_change_s(), 1.010);
        assert_eq!(line.apply(fast, 1.0099), Drive::COAST);
        assert_eq!(line.apply(fast, 1.010), slow);
        assert_eq!(line.apply(fast, 1.013), slow);
        assert_eq!(line.apply(fast, 1.014), fast);
        assert_eq!(line.next_change_s(), f64::INFINITY);
    }

    #[test]
    fn the_queue_never_grows() {
        let mut line = line(0.1);
        let capacity = line.under_way.capacity();
        for step in 0..100_000 {
            // 1 us apart: a hundred times closer than the queue can hold one by one
            line.apply(Drive::with_brake(f64::from(step % 97) / 100.0), f64::from(step) * 1e-6);
        }
        assert_eq!(line.under_way.capacity(), capacity);
        assert!(line.under_way.len() <= CAPACITY + 1);
    }

    #[test]
    fn no_delay_is_no_effect() {
        let mut line = line(0.0);
        for step in 0..10 {
            let drive = Drive::with_brake(f64::from(step) / 10.0);
            assert_eq!(line.apply(drive, f64::from(step)), drive);
        }
    }
}
