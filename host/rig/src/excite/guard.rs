//! Protection of an excited motor from stalling.

use super::Limits;

/// Share of the time to a stall's trip after which a motor that does not move gets no duty, at first.
const FIRST_SHARE: f64 = 0.6;
/// Factor of that share after a stall.
const SHRINK: f64 = 0.5;
/// Largest number of attempts.
const ATTEMPTS: usize = 4;

/// How long a motor may stand at a duty that counts as a stall. Shrinks with each stall.
#[derive(Clone, Copy, Debug)]
pub struct Patience {
    share: f64,
    attempts: usize,
}

impl Default for Patience {
    fn default() -> Self {
        Self { share: FIRST_SHARE, attempts: 0 }
    }
}

impl Patience {
    /// Counts an attempt that did not stall; its patience remains.
    pub fn succeeded(&mut self) {
        self.attempts += 1;
    }

    /// Halves the time after a stall. Returns whether another attempt is worth it.
    pub fn stalled(&mut self) -> bool {
        self.attempts += 1;
        self.share *= SHRINK;
        self.attempts < ATTEMPTS
    }
}

/// Detects a motor that does not move, before the board trips because of a stall.
pub(super) struct Guard {
    stall_duty: f64,
    travel: f64,
    patience_s: f64,
    /// Position and time of the last motion.
    moved: Option<(f64, f64)>,
    /// The part of the plan in which the motor does not move.
    stuck_in: Option<usize>,
}

impl Guard {
    pub(super) fn new(limits: &Limits, patience: &Patience) -> Self {
        Self {
            stall_duty: limits.stall_duty,
            travel: limits.stall_travel,
            patience_s: patience.share * limits.stall_s,
            moved: None,
            stuck_in: None,
        }
    }

    /// Whether the motor gets no duty for the rest of this part of the plan.
    pub(super) fn is_stuck(&mut self, now_s: f64, part: usize, position: f64, duty: f64) -> bool {
        let (from, since_s) = *self.moved.get_or_insert((position, now_s));
        if duty.abs() < self.stall_duty || (position - from).abs() >= self.travel {
            self.moved = Some((position, now_s));
        } else if now_s - since_s > self.patience_s {
            self.stuck_in = Some(part);
        }
        self.stuck_in == Some(part)
    }
}
