//! Index pulse of an encoder, once per turn of its disc: lost counts show in the count at which it comes.

/// Reference of an encoder's index pulses.
#[derive(Clone, Copy, Debug)]
pub struct Index {
    /// Counts from one pulse to the next.
    every: i32,
    /// Count at the reference pulse; `None` before the first.
    known: Option<i32>,
}

/// Tolerance of a pulse's count: one line. Timers lose edges in whole lines, and a pulse as wide as a line comes a line
/// earlier from its other side.
const TOLERANCE_COUNTS: f32 = 4.0;

/// Longest delay from a pulse to the latched count, s: the interrupt runs after all others of its priority.
const LATCH_S: f32 = 20e-6;

impl Index {
    /// Creates the check for a pulse every `counts_per_index` counts; `None` for 0, an encoder without an index.
    #[must_use]
    pub fn new(counts_per_index: u32) -> Option<Self> {
        Some(Self { every: i32::try_from(counts_per_index).ok().filter(|every| *every > 0)?, known: None })
    }

    /// Takes the count at a pulse and the speed, counts/s; returns true if counts were lost or added since the
    /// reference pulse. In that case this pulse becomes the reference.
    pub fn update(&mut self, at: i32, counts_per_s: f32) -> bool {
        let Some(known) = self.known else {
            self.known = Some(at);
            return false;
        };
        let off = at.wrapping_sub(known).rem_euclid(self.every);
        let off = off.min(self.every - off);
        let lost = off as f32 > TOLERANCE_COUNTS + counts_per_s.abs() * LATCH_S;
        if lost {
            self.known = Some(at);
        }
        lost
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pulse_is_a_multiple_of_counts_from_the_first() {
        let mut index = Index::new(2400).expect("it has one");
        for at in [77, 77 + 2400, 77 - 7 * 2400, 77, i32::MAX / 2400 * 2400 + 77 - 2400] {
            assert!(!index.update(at, 0.0), "{at}");
        }
        // One line more or less, plus the travel of the counter until it is latched.
        for (off, counts_per_s, lost) in
            [(4, 0.0, false), (-4, 0.0, false), (14, 500_000.0, false), (-14, -500_000.0, false), (15, 500_000.0, true)]
        {
            let mut index = index;
            assert_eq!(index.update(77 + off, counts_per_s), lost, "{off}");
        }
    }

    /// Each loss is reported once: from then on that pulse is the reference.
    #[test]
    fn a_loss_is_told_once() {
        for off in [5, -5, 1200] {
            let mut index = Index::new(2400).expect("it has one");
            let seen = [0, off, off + 2400, off].map(|at| index.update(at, 0.0));
            assert_eq!(seen, [false, true, false, false], "{off}");
        }
        assert!(Index::new(0).is_none());
    }
}
