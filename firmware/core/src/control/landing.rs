//! Landing: the last counts of a motor whose path has ended, to its target against friction and backlash.

use super::model::{Aim, Model};

/// Time without motion after which a motor counts as standing, s. Half of it pushes a motor that creeps by a count in
/// 40 ms; twice of it makes each step of one that sticks 50 ms longer.
const STANDS_S: f32 = 0.05;
/// Acceleration of the added duty of a standing motor, 1/s²: 0.1 of duty after 0.45 s, and 0.4 after 0.9 s.
const PUSH_PER_S2: f32 = 1.0;
/// Rate of the added duty of a motor that has passed its target before, 1/s: behind a backlash it moves long before it
/// shows. At twice the rate the simulated bench hits the far side of a backlash of 2 deg so fast that it passes the
/// target again.
const PUSH_AGAIN_PER_S: f32 = 0.2;
/// Maximum number of times that the rate is halved.
const MOST_TURNS: u8 = 5;
/// Least share of the friction duty that a returning motor gets at once.
const LEAST_THRESHOLD: f32 = 0.75;

/// History of a motor near its target since its path ended.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Landing {
    /// Position of its last movement, rad or m, and time for which it has stood there, s.
    stood_at: f64,
    stood_s: f32,
    /// Number of times that it has passed its target, and the sign of the last distance to it.
    turns: u8,
    side: f32,
    /// Duty added to break away.
    pushed: f32,
}

impl Landing {
    /// Restarts the history at `position`.
    pub(super) fn begin(&mut self, position: f64) {
        *self = Self { stood_at: position, ..Self::default() };
    }

    /// Takes one period at `position`, with `distance` to the target, which is reached where `near`; a displacement of
    /// `least` or more counts as motion.
    pub(super) fn step(
        &mut self,
        position: f64,
        distance: f32,
        near: bool,
        least: f32,
        period_s: f32,
        model: &mut Model,
    ) {
        if (position - self.stood_at).abs() >= f64::from(least) {
            if self.pushed > 0.0 && self.turns == 0 {
                model.broke_away(self.pushed);
            }
            (self.stood_at, self.stood_s) = (position, 0.0);
        } else {
            self.stood_s += period_s;
        }
        if !near && distance * self.side <= 0.0 {
            if self.side != 0.0 {
                self.turns = (self.turns + 1).min(MOST_TURNS);
            }
            self.side = distance.signum();
        }
        let since_s = self.stood_s - STANDS_S;
        self.pushed = if near || since_s < 0.0 {
            0.0
        } else if self.turns == 0 {
            model.stiction() + 0.5 * PUSH_PER_S2 * since_s * since_s
        } else {
            self.share() * (model.stiction() + PUSH_AGAIN_PER_S * since_s)
        };
    }

    /// Drive share: halved each time that the motor has passed its target.
    fn share(&self) -> f32 {
        1.0 / f32::from(1u8 << self.turns)
    }

    /// Returns the aim towards the sign of `sign`.
    pub(super) fn aim(&self, sign: f32, near: bool) -> Aim {
        let share = self.share();
        let threshold = LEAST_THRESHOLD + (1.0 - LEAST_THRESHOLD) * share;
        Aim { sign, rests: near, pushed: self.pushed, share, threshold }
    }
}
