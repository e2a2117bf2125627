//! Meaning of key presses over time: pure functions, with the time as an argument.

/// Longest time between two repeats of a held key, s.
///
/// Terminals report presses and repeats of a key, never its release.
pub(super) const HELD_S: f64 = 0.3;
/// Longest time until the first repeat, s: 0.66 with the defaults of X11 (xset r rate), less elsewhere.
pub(super) const FIRST_REPEAT_S: f64 = 0.7;

/// Input of a driver. Positive is forwards and to the left.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Hand {
    /// Share of the highest speed, -1 to 1.
    pub(super) forwards: f64,
    /// Share of the highest turn rate, -1 to 1.
    pub(super) turn: f64,
    /// True while the dead-man key is held; otherwise nothing moves.
    pub(super) is_held: bool,
}

/// Dead-man key, held as long as it repeats.
///
/// A single press is not holding: a tap must move nothing.
#[derive(Debug, Default)]
pub(super) struct DeadMan {
    last_s: Option<f64>,
    repeats: bool,
}

impl DeadMan {
    /// Registers a press or a repeat of the dead-man key.
    pub(super) fn pressed(&mut self, now_s: f64) {
        let longest_s = if self.repeats { HELD_S } else { FIRST_REPEAT_S };
        self.repeats = self.last_s.is_some_and(|last_s| (0.0..=longest_s).contains(&(now_s - last_s)));
        self.last_s = Some(now_s);
    }

    /// Registers another key: it extends a hold but does not begin one.
    pub(super) fn other(&mut self, now_s: f64) {
        if self.is_held(now_s) {
            self.last_s = Some(now_s);
        }
    }

    /// Releases the key, as after arming or a stop.
    pub(super) fn release(&mut self) {
        *self = Self::default();
    }

    pub(super) fn is_held(&self, now_s: f64) -> bool {
        self.repeats && self.last_s.is_some_and(|last_s| (0.0..HELD_S).contains(&(now_s - last_s)))
    }
}

/// Virtual stick, moved by keys in steps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Stick {
    pub(super) forwards: i8,
    pub(super) turn: i8,
    /// Steps from the middle to either end.
    pub(super) steps: i8,
}

impl Stick {
    pub(super) fn new(steps: i8) -> Self {
        Self { forwards: 0, turn: 0, steps: steps.max(1) }
    }

    pub(super) fn push(&mut self, forwards: i8, turn: i8) {
        let within = |at: i8, by: i8| at.saturating_add(by).clamp(-self.steps, self.steps);
        (self.forwards, self.turn) = (within(self.forwards, forwards), within(self.turn, turn));
    }

    pub(super) fn centre(&mut self) {
        (self.forwards, self.turn) = (0, 0);
    }

    pub(super) fn hand(&self, is_held: bool) -> Hand {
        let share = |at: i8| f64::from(at) / f64::from(self.steps);
        Hand { forwards: share(self.forwards), turn: share(self.turn), is_held }
    }
}

/// Mixes the input to shares of the highest speed for the left and the right wheels, -1 to 1.
///
/// `turn_share` is the share that a full turn on the spot uses. Where speed and turn together exceed 1, both sides are
/// scaled by the same factor, which keeps the curve.
pub(super) fn mix(hand: Hand, turn_share: f64) -> [f64; 2] {
    if !hand.is_held || !hand.forwards.is_finite() || !hand.turn.is_finite() {
        return [0.0; 2];
    }
    let (forwards, turn) = (hand.forwards.clamp(-1.0, 1.0), hand.turn.clamp(-1.0, 1.0) * turn_share);
    let sides = [forwards - turn, forwards + turn];
    let most = sides[0].abs().max(sides[1].abs()).max(1.0);
    sides.map(|side| side / most)
}

/// Angle of steered wheels within `limits`, rad, positive to the left; `None` to keep the present angle.
///
/// The stick's middle is straight ahead, wherever that lies between the limits.
pub(super) fn steered(hand: Hand, limits: [f64; 2]) -> Option<f64> {
    if !hand.is_held || !hand.turn.is_finite() {
        return None;
    }
    let turn = hand.turn.clamp(-1.0, 1.0);
    let [right, left] = limits;
    Some((if turn < 0.0 { -turn * right } else { turn * left }).clamp(right, left))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn front_wheels_go_to_their_limits_and_stay_where_they_are_let_go() {
        let limits = [-0.3, 0.4];
        for (turn, angle_rad) in
            [(0.0, 0.0), (1.0, 0.4), (-1.0, -0.3), (0.5, 0.2), (-0.5, -0.15), (7.0, 0.4), (-7.0, -0.3)]
        {
            assert_eq!(steered(held(1.0, turn), limits), Some(angle_rad), "{turn}");
        }
        assert_eq!(steered(held(0.0, f64::NAN), limits), None);
        assert_eq!(steered(Hand { is_held: false, ..held(1.0, 1.0) }, limits), None);
        // Where straight ahead is out of reach, the nearest angle.
        assert_eq!(steered(held(1.0, 0.0), [0.1, 0.4]), Some(0.1));
    }

    fn held(forwards: f64, turn: f64) -> Hand {
        Hand { forwards, turn, is_held: true }
    }

    #[test]
    fn wheels_of_both_sides_make_the_curve() {
        for (forwards, turn, expected) in [
            (1.0, 0.0, [1.0, 1.0]),
            (-0.5, 0.0, [-0.5, -0.5]),
            // A left turn drives the right wheels forwards.
            (0.0, 1.0, [-0.5, 0.5]),
            (0.0, -1.0, [0.5, -0.5]),
            (0.5, 1.0, [0.0, 1.0]),
            // The sum would be 0.5 and 1.5: scaled by 2/3.
            (1.0, 1.0, [1.0 / 3.0, 1.0]),
            (-1.0, 1.0, [-1.0, -1.0 / 3.0]),
            // A stick beyond its end, and one that returns NaN.
            (7.0, 0.0, [1.0, 1.0]),
            (f64::NAN, 0.0, [0.0, 0.0]),
        ] {
            assert_eq!(mix(held(forwards, turn), 0.5), expected, "{forwards} {turn}");
        }
    }

    #[test]
    fn nothing_moves_without_the_dead_man_key() {
        assert_eq!(mix(Hand { is_held: false, ..held(1.0, 0.5) }, 0.5), [0.0; 2]);
    }

    #[test]
    fn sides_never_ask_for_more_than_there_is() {
        for step in 0..=1600u32 {
            let (forwards, turn) = (f64::from(step / 41) / 20.0 - 1.0, f64::from(step % 41) / 20.0 - 1.0);
            for turn_share in [0.0, 0.45, 1.0] {
                let [left, right] = mix(held(forwards, turn), turn_share);
                assert!(left.abs() <= 1.0 && right.abs() <= 1.0, "{forwards} {turn}: {left} {right}");
                // The turn keeps its direction.
                assert!((right - left) * turn >= 0.0, "{forwards} {turn}: {left} {right}");
            }
        }
    }

    #[test]
    fn a_key_is_held_from_its_first_repeat_until_repeats_stay_out() {
        let mut key = DeadMan::default();
        assert!(!key.is_held(0.0));
        key.pressed(1.0);
        assert!(!key.is_held(1.0), "pressed once");
        key.pressed(1.66);
        assert!(key.is_held(1.66));
        for repeat in 1..=30 {
            let now_s = 1.66 + f64::from(repeat) * 0.033;
            key.pressed(now_s);
            assert!(key.is_held(now_s));
        }
        let last_s = 1.66 + 30.0 * 0.033;
        assert!(key.is_held(last_s + 0.29));
        assert!(!key.is_held(last_s + 0.301));
        // After a release the key must repeat again.
        key.pressed(last_s + 0.5);
        assert!(!key.is_held(last_s + 0.5));
        key.pressed(last_s + 0.9);
        assert!(key.is_held(last_s + 0.9));
    }

    #[test]
    fn slow_taps_and_a_clock_that_went_back_are_not_holding() {
        let mut key = DeadMan::default();
        for tap in 0..10 {
            let now_s = f64::from(tap) * 0.8;
            key.pressed(now_s);
            assert!(!key.is_held(now_s));
        }
        key.release();
        key.pressed(5.0);
        key.pressed(4.0);
        assert!(!key.is_held(4.0));
    }

    #[test]
    fn other_keys_keep_it_held_and_do_not_begin() {
        let mut key = DeadMan::default();
        key.other(0.0);
        key.other(0.1);
        assert!(!key.is_held(0.1));
        key.pressed(1.0);
        key.pressed(1.5);
        key.other(1.7);
        assert!(key.is_held(1.9));
        key.other(2.1);
        assert!(!key.is_held(2.1), "too late");
        key.pressed(3.0);
        key.pressed(3.1);
        key.release();
        assert!(!key.is_held(3.1));
    }

    #[test]
    fn a_stick_has_two_ends() {
        let mut stick = Stick::new(5);
        (0..9).for_each(|_| stick.push(1, -1));
        assert_eq!(stick.hand(true), held(1.0, -1.0));
        stick.push(-2, 1);
        assert_eq!(stick.hand(false), Hand { forwards: 0.6, turn: -0.8, is_held: false });
        stick.centre();
        assert_eq!(stick.hand(true), held(0.0, 0.0));
    }
}
