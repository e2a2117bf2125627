//! Index pulse of an encoder, once per turn of its disc: counts that were lost show in the count at which it comes.

/// What is known of an encoder's index pulses.
#[derive(Clone, Copy, Debug)]
pub struct Index {
    /// Counts from one to the next.
    every: i32,
    /// Count of one of them.
    known: Option<i32>,
}

/// Counts by which a pulse may be off: a line. Edges are lost in whole lines where a timer counts, and a pulse as wide as a line comes
/// so much earlier from its other side.
const TOLERANCE_COUNTS: f32 = 4.0;

/// A counter is latched at most this long after a pulse begins, by an interrupt behind all others of its priority, s.
const LATCH_S: f32 = 20e-6;

impl Index {
    /// Pulses every so many counts; `None` for an encoder without.
    #[must_use]
    pub fn new(counts_per_index: u32) -> Option<Self> {
        Some(Self { every: i32::try_from(counts_per_index).ok().filter(|every| *every > 0)?, known: None })
    }

    /// Takes the count at a pulse, at a speed in counts/s: whether counts were lost or made up since the first. From then on this
    /// pulse is the known one.
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
        // A line more or less, and what a counter moves on until it is latched.
        for (off, counts_per_s, lost) in
            [(4, 0.0, false), (-4, 0.0, false), (14, 500_000.0, false), (-14, -500_000.0, false), (15, 500_000.0, true)]
        {
            let mut index = index;
            assert_eq!(index.update(77 + off, counts_per_s), lost, "{off}");
        }
    }

    /// Once for each loss: from then on that pulse is the known one.
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
