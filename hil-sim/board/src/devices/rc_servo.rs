//! Hobby RC servo: pulses of 500 us to 2500 us, 40 to 333 times a second, command an angle.
//!
//! # Behaviour
//! The horn moves at a constant rate towards the commanded angle and stops when the difference is within the dead band,
//! or at an end stop. It therefore rests one dead band short, on the side it came from. Only the servo moves the horn.
//!
//! | supply | pulses | horn |
//! | --- | --- | --- |
//! | off | any | no torque |
//! | on | valid | follows, held |
//! | on | none, or outside the window for pulse or frame | held for 25 ms, the longest valid frame, then no torque |
//!
//! A new pulse width acts at the time the line changes, at most one frame before a real servo has measured it.
//!
//! # Time
//! Between changes of the signal the motion has a closed form, so the frequency of queries does not change the result.
//!
//! Not modelled: load and back-driving, acceleration, current, heat, digital servos that hold without pulses.

use crate::chips::{COUNTS, Line};
use crate::misuse::{Misuse, MisuseKind, MisuseLog};

/// Pulse range that servos of all usual makes accept, ns.
const PULSE_MIN_NS: u64 = 500_000;
const PULSE_MAX_NS: u64 = 2_500_000;
/// Shortest frame, ns: 333 Hz, the fastest that digital servos are sold for, rounded to include that rate.
const FRAME_MIN_NS: u64 = 3_003_003;
/// Longest frame, ns: 40 Hz.
const FRAME_MAX_NS: u64 = 25_000_000;
/// Time without a valid pulse, the longest frame, after which the servo loses its torque, ns.
const LIMP_AFTER_NS: u64 = FRAME_MAX_NS;
/// Time driven against a stop after which it is reported, ns: a modelling choice, well above the time to correct a set
/// point.
const STOP_TOLERATED_NS: u64 = 1_000_000_000;

/// Parameters of a servo. All are finite, `pulse_max_s` above `pulse_min_s`, `stop_max_rad` not below `stop_min_rad`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RcServoSpec {
    /// Pulse width for `angle_at_min_rad`, s.
    pub pulse_min_s: f64,
    /// Pulse width for `angle_at_max_rad`, s; the line through both points extends on both sides.
    pub pulse_max_s: f64,
    /// Angle commanded by `pulse_min_s`, rad.
    pub angle_at_min_rad: f64,
    /// Angle commanded by `pulse_max_s`, rad; below the other for a servo of the opposite direction.
    pub angle_at_max_rad: f64,
    /// Speed of the horn without load, rad/s.
    pub rate_rad_s: f64,
    /// Dead band, s: a pulse that differs from the present angle's by no more than this moves nothing.
    pub dead_band_s: f64,
    /// Lower mechanical end stop, rad.
    pub stop_min_rad: f64,
    /// Upper mechanical end stop, rad.
    pub stop_max_rad: f64,
}

impl RcServoSpec {
    fn slope_rad_s(&self) -> f64 {
        (self.angle_at_max_rad - self.angle_at_min_rad) / (self.pulse_max_s - self.pulse_min_s)
    }

    fn angle_rad(&self, pulse_ns: u64) -> f64 {
        self.angle_at_min_rad + (pulse_ns as f64 * 1e-9 - self.pulse_min_s) * self.slope_rad_s()
    }

    fn within_stops(&self, angle_rad: f64) -> f64 {
        angle_rad.min(self.stop_max_rad).max(self.stop_min_rad)
    }
}

/// Motion since the last change.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Motion {
    from_ns: u64,
    from_rad: f64,
    /// Angle at its end, rad.
    to_rad: f64,
    /// Time of its end, ns.
    until_ns: u64,
    /// True if it ends at a stop short of the command.
    into_stop: bool,
}

/// One servo with its horn.
#[derive(Clone, Debug, PartialEq)]
pub struct RcServo {
    number: u8,
    spec: RcServoSpec,
    now_ns: u64,
    signal: Line,
    frame_ns: u64,
    powered: bool,
    /// Commanded angle, rad; `None` without torque.
    target_rad: Option<f64>,
    /// Time at which the servo loses its torque, ns; `u64::MAX` while pulses come.
    limp_ns: u64,
    motion: Motion,
    /// Start of the time driven against a stop, ns.
    against_stop_since_ns: Option<u64>,
    stop_reported: bool,
    misuse: MisuseLog,
}

impl RcServo {
    /// Name of the servo in reports.
    pub const NAME: &str = "RC servo";

    /// A servo without supply whose horn is at `angle_rad`; `number` identifies it in reports.
    #[must_use]
    pub fn new(number: u8, spec: RcServoSpec, angle_rad: f64) -> Self {
        let angle_rad = spec.within_stops(angle_rad);
        Self {
            number,
            spec,
            now_ns: 0,
            signal: Line::Low,
            frame_ns: 0,
            powered: false,
            target_rad: None,
            limp_ns: u64::MAX,
            motion: Motion { from_ns: 0, from_rad: angle_rad, to_rad: angle_rad, until_ns: 0, into_stop: false },
            against_stop_since_ns: None,
            stop_reported: false,
            misuse: MisuseLog::new(),
        }
    }

    /// Sets signal and supply from `at_ns` on. Cheap while they do not change.
    ///
    /// `frame_ns` is the PWM cycle of the chip that drives the signal, as its real oscillator gives it: pulse width and
    /// repetition rate both follow from it.
    pub fn update(&mut self, at_ns: u64, signal: Line, frame_ns: u64, powered: bool) {
        self.advance(at_ns);
        if (signal, frame_ns, powered) == (self.signal, self.frame_ns, self.powered) {
            return;
        }
        (self.signal, self.frame_ns, self.powered) = (signal, frame_ns, powered);
        if !powered {
            self.let_go();
        } else if let Some(pulse_ns) = self.valid_pulse_ns() {
            self.limp_ns = u64::MAX;
            self.target_rad = Some(self.spec.angle_rad(pulse_ns));
            self.set_off();
        } else if self.target_rad.is_some() {
            self.limp_ns = self.limp_ns.min(self.now_ns.saturating_add(LIMP_AFTER_NS));
        }
    }

    /// Advances the servo to `to_ns`; an earlier time than one already seen counts as that one.
    pub fn advance(&mut self, to_ns: u64) {
        let to_ns = to_ns.max(self.now_ns);
        if self.limp_ns <= to_ns {
            self.pass(self.limp_ns);
            self.let_go();
        }
        self.pass(to_ns);
    }

    /// Angle of the horn at the last call with a time, rad.
    #[must_use]
    pub fn angle_rad(&self) -> f64 {
        let Motion { from_ns, from_rad, to_rad, until_ns, .. } = self.motion;
        if self.now_ns >= until_ns {
            return to_rad;
        }
        let way_rad = self.spec.rate_rad_s * (self.now_ns - from_ns) as f64 * 1e-9;
        if to_rad > from_rad { (from_rad + way_rad).min(to_rad) } else { (from_rad - way_rad).max(to_rad) }
    }

    /// Speed of the horn at the last call with a time, rad/s.
    #[must_use]
    pub fn speed_rad_s(&self) -> f64 {
        let Motion { from_rad, to_rad, until_ns, .. } = self.motion;
        if self.now_ns >= until_ns { 0.0 } else { self.spec.rate_rad_s.copysign(to_rad - from_rad) }
    }

    /// True while the supply is on.
    #[must_use]
    pub const fn is_powered(&self) -> bool {
        self.powered
    }

    /// True while the servo holds or moves its horn; without torque otherwise.
    #[must_use]
    pub const fn is_holding(&self) -> bool {
        self.target_rad.is_some()
    }

    /// Inputs so far that servos ignore or that damage them.
    #[must_use]
    pub const fn misuse(&self) -> &MisuseLog {
        &self.misuse
    }

    /// Misuses so far, mutable, so that a test can clear them.
    pub const fn misuse_mut(&mut self) -> &mut MisuseLog {
        &mut self.misuse
    }

    /// Pulse width of the signal, ns; `None` for no pulse and, reported, for one that the servo ignores.
    fn valid_pulse_ns(&mut self) -> Option<u64> {
        let counts = self.signal.counts_high(false);
        if counts == 0 {
            return None;
        }
        let pulse_ns = u128::from(self.frame_ns) * u128::from(counts) / u128::from(COUNTS);
        let pulse_ns = u64::try_from(pulse_ns).unwrap_or(u64::MAX);
        let frame_ns = self.frame_ns;
        let pulse_fits = (PULSE_MIN_NS..=PULSE_MAX_NS).contains(&pulse_ns);
        let frame_fits = (FRAME_MIN_NS..=FRAME_MAX_NS).contains(&frame_ns);
        if !pulse_fits {
            let (low_ns, high_ns) = (PULSE_MIN_NS, PULSE_MAX_NS);
            self.report(self.now_ns, MisuseKind::ServoPulseOutsideWindow { pulse_ns, low_ns, high_ns });
        }
        if !frame_fits {
            let (low_ns, high_ns) = (FRAME_MIN_NS, FRAME_MAX_NS);
            self.report(self.now_ns, MisuseKind::ServoFrameOutsideWindow { frame_ns, low_ns, high_ns });
        }
        (pulse_fits && frame_fits).then_some(pulse_ns)
    }

    /// Starts the motion from the present angle to the target.
    fn set_off(&mut self) {
        let from_rad = self.angle_rad();
        let mut to_rad = from_rad;
        let mut into_stop = false;
        if let Some(target_rad) = self.target_rad {
            let band_rad = self.spec.dead_band_s * self.spec.slope_rad_s().abs();
            let error_rad = target_rad - from_rad;
            if error_rad.abs() > band_rad {
                let wanted_rad = target_rad - band_rad.copysign(error_rad);
                to_rad = self.spec.within_stops(wanted_rad);
                into_stop = to_rad != wanted_rad;
            }
        }
        let duration_ns = ((to_rad - from_rad).abs() / self.spec.rate_rad_s * 1e9).ceil() as u64;
        let until_ns = self.now_ns.saturating_add(duration_ns);
        self.motion = Motion { from_ns: self.now_ns, from_rad, to_rad, until_ns, into_stop };
        // a new command further into the same stop continues the same push
        let at_stop = into_stop && until_ns <= self.now_ns;
        if !at_stop {
            self.against_stop_since_ns = None;
            self.stop_reported = false;
        }
    }

    fn let_go(&mut self) {
        self.target_rad = None;
        self.limp_ns = u64::MAX;
        self.set_off();
    }

    /// Advances time within one motion.
    fn pass(&mut self, to_ns: u64) {
        self.now_ns = to_ns;
        if !self.motion.into_stop || to_ns < self.motion.until_ns {
            return;
        }
        let since_ns = *self.against_stop_since_ns.get_or_insert(self.motion.until_ns);
        let tolerated_until_ns = since_ns.saturating_add(STOP_TOLERATED_NS);
        if !self.stop_reported && to_ns >= tolerated_until_ns {
            self.stop_reported = true;
            self.report(tolerated_until_ns, MisuseKind::ServoHeldAgainstStop { held_ns: STOP_TOLERATED_NS });
        }
    }

    #[cold]
    fn report(&mut self, time_ns: u64, kind: MisuseKind) {
        self.misuse.report(Misuse { time_ns, chip: Self::NAME, address: self.number, kind });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Frame for 50 Hz within the PCA9685's steps: prescaler 121 at 25 MHz.
    const FRAME_NS: u64 = 19_988_480;
    const SECOND_NS: u64 = 1_000_000_000;

    /// Servo with 1 ms to 2 ms for -1 rad to 1 rad, so 1 us is 2 mrad; a slope that is easy to check by hand.
    const SPEC: RcServoSpec = RcServoSpec {
        pulse_min_s: 1e-3,
        pulse_max_s: 2e-3,
        angle_at_min_rad: -1.0,
        angle_at_max_rad: 1.0,
        rate_rad_s: 4.0,
        dead_band_s: 5e-6,
        stop_min_rad: -1.5,
        stop_max_rad: 1.5,
    };
    const BAND_RAD: f64 = 0.01;

    const fn pulse(counts: u16) -> Line {
        Line::Pwm { on: 0, off: counts }
    }

    /// Frame in which 1024 counts, a quarter, are `pulse_ns` wide.
    const fn frame_for(pulse_ns: u64) -> u64 {
        pulse_ns * 4
    }

    fn servo() -> RcServo {
        RcServo::new(5, SPEC, 0.0)
    }

    fn kinds(servo: &RcServo) -> Vec<MisuseKind> {
        servo.misuse().first().iter().map(|misuse| misuse.kind).collect()
    }

    #[test]
    fn moves_at_its_rate_and_rests_a_dead_band_short() {
        let mut servo = servo();
        // 1.8 ms: 0.6 rad
        servo.update(SECOND_NS, pulse(1024), frame_for(1_800_000), true);
        assert!(servo.is_powered() && servo.is_holding());
        servo.advance(SECOND_NS + 100_000_000);
        // 4 rad/s for 0.1 s; 1e-12 is rounding
        assert!((servo.angle_rad() - 0.4).abs() < 1e-12);
        servo.advance(2 * SECOND_NS);
        assert!((servo.angle_rad() - (0.6 - BAND_RAD)).abs() < 1e-12);
        // back to 1.4 ms, -0.2 rad: rests on the other side
        servo.update(2 * SECOND_NS, pulse(1024), frame_for(1_400_000), true);
        servo.advance(3 * SECOND_NS);
        assert!((servo.angle_rad() - (-0.2 + BAND_RAD)).abs() < 1e-12);
        assert!(servo.misuse().is_empty());
    }

    #[test]
    fn pulse_width_follows_the_oscillator() {
        for (cycle_ns, expected_ns) in [(FRAME_NS, 1_498_160), (FRAME_NS * 103 / 100, 1_543_104)] {
            let mut servo = servo();
            servo.update(0, pulse(307), cycle_ns, true);
            // 307 of 4096 counts; rounding down costs up to a nanosecond
            assert!(servo.valid_pulse_ns().expect("in the window").abs_diff(expected_ns) <= 1);
        }
    }

    #[test]
    fn dead_band_decides_whether_it_moves() {
        // 5 us is the dead band; 1 us to both sides of it
        for (pulse_ns, moves) in [(1_504_000, false), (1_506_000, true), (1_496_000, false), (1_494_000, true)] {
            let mut servo = servo();
            servo.update(0, pulse(1024), frame_for(pulse_ns), true);
            servo.advance(SECOND_NS);
            assert_eq!(servo.angle_rad() != 0.0, moves, "{pulse_ns}");
        }
    }

    #[test]
    fn pulses_outside_the_window_are_ignored_and_reported() {
        for (pulse_ns, valid) in [(499_999, false), (500_000, true), (2_500_000, true), (2_500_001, false)] {
            let mut servo = servo();
            servo.update(7, pulse(1024), frame_for(pulse_ns), true);
            // a quarter of the frame: 2 ms to 10 ms; for the shortest one the frame is too short as well
            let reported = kinds(&servo).iter().any(|kind| matches!(kind, MisuseKind::ServoPulseOutsideWindow { .. }));
            assert_eq!(reported, !valid, "{pulse_ns}");
        }
        let mut servo = servo();
        servo.update(7, Line::High, FRAME_NS, true);
        let expected =
            MisuseKind::ServoPulseOutsideWindow { pulse_ns: FRAME_NS, low_ns: PULSE_MIN_NS, high_ns: PULSE_MAX_NS };
        assert_eq!(kinds(&servo), [expected]);
        assert_eq!((servo.misuse().first()[0].address, servo.misuse().first()[0].time_ns), (5, 7));
        assert!(!servo.is_holding());
    }

    #[test]
    fn frames_outside_the_window_are_ignored_and_reported() {
        // 333 Hz and 40 Hz
        for (frame_ns, valid) in [(3_003_002, false), (3_003_003, true), (25_000_000, true), (25_000_001, false)] {
            let mut servo = servo();
            // 1.6 ms, within a count
            let counts = (1_600_000 * u64::from(COUNTS) / frame_ns) as u16;
            servo.update(0, pulse(counts), frame_ns, true);
            assert_eq!(servo.is_holding(), valid, "{frame_ns}");
            let expected =
                MisuseKind::ServoFrameOutsideWindow { frame_ns, low_ns: FRAME_MIN_NS, high_ns: FRAME_MAX_NS };
            assert_eq!(kinds(&servo), if valid { vec![] } else { vec![expected] });
            servo.advance(SECOND_NS);
            assert_eq!(servo.angle_rad() != 0.0, valid);
        }
    }

    #[test]
    fn goes_limp_after_the_longest_frame_without_pulses_and_stays_where_it_is() {
        for signal in [Line::Low, Line::HighZ, Line::High] {
            let mut servo = servo();
            servo.update(0, pulse(1024), frame_for(2_000_000), true);
            servo.update(100_000_000, signal, FRAME_NS, true);
            servo.advance(124_999_999);
            assert!(servo.is_holding());
            servo.advance(125_000_000);
            assert!(!servo.is_holding() && servo.is_powered());
            servo.advance(SECOND_NS);
            // 4 rad/s for 0.125 s; 1e-12 is rounding
            assert!((servo.angle_rad() - 0.5).abs() < 1e-12, "{signal:?}");
        }
    }

    #[test]
    fn a_short_gap_between_pulses_is_bridged() {
        let mut servo = servo();
        servo.update(0, pulse(1024), frame_for(1_900_000), true);
        servo.update(1_000_000, Line::Low, FRAME_NS, true);
        servo.update(20_000_000, pulse(1024), frame_for(1_900_000), true);
        servo.advance(SECOND_NS);
        assert!((servo.angle_rad() - (0.8 - BAND_RAD)).abs() < 1e-12);
    }

    #[test]
    fn without_supply_it_lets_go_at_once_and_reports_nothing() {
        let mut servo = servo();
        servo.update(0, pulse(1024), frame_for(1_900_000), true);
        servo.update(50_000_000, Line::High, FRAME_NS, false);
        assert!(!servo.is_holding() && !servo.is_powered());
        servo.advance(SECOND_NS);
        assert!((servo.angle_rad() - 0.2).abs() < 1e-12);
        assert!(servo.misuse().is_empty());
        servo.update(SECOND_NS, pulse(1024), frame_for(1_900_000), true);
        servo.advance(2 * SECOND_NS);
        assert!((servo.angle_rad() - (0.8 - BAND_RAD)).abs() < 1e-12);
    }

    #[test]
    fn a_second_against_a_stop_is_reported_once() {
        let held = MisuseKind::ServoHeldAgainstStop { held_ns: STOP_TOLERATED_NS };
        // 2.4 ms is 1.8 rad: at the stop, 1.5 rad, after 0.375 s
        let mut servo = servo();
        servo.update(0, pulse(1024), frame_for(2_400_000), true);
        servo.advance(1_374_999_999);
        assert_eq!(servo.angle_rad(), 1.5);
        assert!(servo.misuse().is_empty());
        // further into the stop continues the same push
        servo.update(1_374_999_999, pulse(1024), frame_for(2_500_000), true);
        servo.advance(1_375_000_000);
        assert_eq!(servo.misuse().first()[0].time_ns, 1_375_000_000);
        servo.advance(9 * SECOND_NS);
        assert_eq!(kinds(&servo), [held]);
        // away and back is a new one
        servo.update(10 * SECOND_NS, pulse(1024), frame_for(1_500_000), true);
        servo.update(11 * SECOND_NS, pulse(1024), frame_for(2_400_000), true);
        servo.advance(20 * SECOND_NS);
        assert_eq!(kinds(&servo), [held, held]);
    }

    #[test]
    fn within_a_dead_band_of_the_stop_it_does_not_push() {
        // 1.5 rad is 2.25 ms; 5 us more is the dead band, 1 ns less for rounding
        for (pulse_ns, pushes) in [(2_254_999, false), (2_256_000, true)] {
            let mut servo = RcServo::new(0, SPEC, 1.5);
            servo.update(0, pulse(1024), frame_for(pulse_ns), true);
            servo.advance(2 * SECOND_NS);
            assert_eq!(!servo.misuse().is_empty(), pushes);
        }
    }

    #[test]
    fn a_servo_that_turns_the_other_way() {
        let mut servo = RcServo::new(0, RcServoSpec { angle_at_min_rad: 1.0, angle_at_max_rad: -1.0, ..SPEC }, 0.0);
        servo.update(0, pulse(1024), frame_for(1_900_000), true);
        servo.advance(SECOND_NS);
        assert!((servo.angle_rad() - (-0.8 + BAND_RAD)).abs() < 1e-12);
    }

    fn any_signal() -> impl Strategy<Value = (Line, u64, bool)> {
        let line = prop_oneof![Just(Line::Low), Just(Line::High), Just(Line::HighZ), (80..560u16).prop_map(pulse)];
        (line, prop_oneof![4 => Just(FRAME_NS), 1 => 2_000_000..30_000_000u64], prop::bool::weighted(0.9))
    }

    proptest! {
        #[test]
        fn looking_often_changes_nothing(
            changes in prop::collection::vec((1..2 * SECOND_NS, any_signal()), 1..20),
            looks in 1..20u64,
        ) {
            let [mut lazy, mut eager] = [servo(), servo()];
            let mut at_ns = 0;
            for (wait_ns, (line, frame_ns, powered)) in changes {
                lazy.update(at_ns, line, frame_ns, powered);
                for look in 0..looks {
                    eager.update(at_ns + wait_ns * look / looks, line, frame_ns, powered);
                }
                at_ns += wait_ns;
            }
            lazy.advance(at_ns);
            eager.advance(at_ns);
            // to the bit
            prop_assert_eq!(lazy, eager);
        }

        #[test]
        fn stays_within_stops_and_rate(changes in prop::collection::vec((1..SECOND_NS, any_signal()), 1..30)) {
            let mut servo = servo();
            let mut at_ns = 0;
            for (wait_ns, (line, frame_ns, powered)) in changes {
                servo.update(at_ns, line, frame_ns, powered);
                let before_rad = servo.angle_rad();
                at_ns += wait_ns;
                servo.advance(at_ns);
                let way_rad = (servo.angle_rad() - before_rad).abs();
                // ends are at whole nanoseconds: 4e-9 rad
                prop_assert!(way_rad <= SPEC.rate_rad_s * wait_ns as f64 * 1e-9 + 5e-9);
                prop_assert!((SPEC.stop_min_rad..=SPEC.stop_max_rad).contains(&servo.angle_rad()));
            }
        }

        #[test]
        fn never_panics(
            numbers: [f64; 8],
            changes in prop::collection::vec((any::<u64>(), any::<Option<(u16, u16)>>(), any::<u64>(), any::<bool>()), 0..20),
        ) {
            let [pulse_min_s, pulse_max_s, angle_at_min_rad, angle_at_max_rad, rate_rad_s, dead_band_s, a, b] = numbers;
            let spec = RcServoSpec {
                pulse_min_s, pulse_max_s, angle_at_min_rad, angle_at_max_rad, rate_rad_s, dead_band_s,
                stop_min_rad: a, stop_max_rad: b,
            };
            let mut servo = RcServo::new(0, spec, a);
            for (at_ns, edges, frame_ns, powered) in changes {
                let line = edges.map_or(Line::High, |(on, off)| Line::Pwm { on, off });
                servo.update(at_ns, line, frame_ns, powered);
                let _ = servo.angle_rad();
            }
        }
    }
}
