//! One motor channel of a DHB-12 (also sold as DBH-12) dual H-bridge, 5 V to 15 V, 30 A per motor.
//!
//! # Truth table (library of the same family's DBH-1)
//! | supply | EN | IN1 | IN2 | motor |
//! | --- | --- | --- | --- | --- |
//! | outside 5 V to 15 V | any | any | any | coasts |
//! | good | 0 | any | any | coasts |
//! | good | 1 | 1 | 0 | forward |
//! | good | 1 | 0 | 1 | reverse |
//! | good | 1 | 0 | 0 | brakes (assumed) |
//! | good | 1 | 1 | 1 | brakes (assumed), reported |
//!
//! #  Assumptions without a source
//! - Equal inputs brake: both low turn on both low sides, both high both high sides. The library calls braking
//!   untested.
//! - An input that is not driven is low, so an unplugged ribbon cable coasts.
//! - Above 15 V the bridge turns off. The real one may be destroyed.
//! - Above a duty of 98 %, which the library forbids, the output still follows.
//!
//! Not modelled: current sense output CT, current limit, heat, dead time between the FETs of a leg.

use super::{osmc::BridgeOutput, reversal::Reversals};
use crate::chips::{COUNTS, Line, stretches};
use crate::misuse::{Misuse, MisuseKind, MisuseLog};

/// Lowest supply voltage, V.
const SUPPLY_MIN_V: f64 = 5.0;
/// Highest supply voltage, V.
const SUPPLY_MAX_V: f64 = 15.0;
/// Highest duty that the library of the family allows, 98 % of a cycle, in counts, rounded down.
const DUTY_LIMIT_COUNTS: u16 = 4014;

/// Inputs of one motor. They come from one PWM chip, so their cycles start together.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DhbInputs {
    /// Line to input IN1, forward.
    pub in1: Line,
    /// Line to input IN2, reverse.
    pub in2: Line,
    /// Line to input EN, enable.
    pub en: Line,
}

/// Counts of one PWM cycle in each state, 0 to 4096; the remainder coasts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Shares {
    forward: u16,
    reverse: u16,
    both_low: u16,
    both_high: u16,
}

impl Shares {
    /// Adds up the intervals in which no line changes.
    fn of(inputs: &DhbInputs) -> Self {
        let mut shares = Self::default();
        for (from, length) in stretches::<7>([inputs.in1, inputs.in2, inputs.en]) {
            shares.add(inputs, from, length);
        }
        shares
    }

    fn add(&mut self, inputs: &DhbInputs, count: u16, length: u16) {
        let is_high = |line: Line| line.is_high_at(count, false);
        if !is_high(inputs.en) {
            return;
        }
        let share = match (is_high(inputs.in1), is_high(inputs.in2)) {
            (true, false) => &mut self.forward,
            (false, true) => &mut self.reverse,
            (false, false) => &mut self.both_low,
            (true, true) => &mut self.both_high,
        };
        *share += length;
    }

    fn output(&self) -> BridgeOutput {
        let share = |counts: u16| f64::from(counts) / f64::from(COUNTS);
        let brake = self.both_low + self.both_high;
        BridgeOutput {
            duty: share(self.forward) - share(self.reverse),
            coast: share(COUNTS - self.forward - self.reverse - brake),
            brake: share(brake),
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Supply {
    Low,
    Good,
    TooHigh,
}

impl Supply {
    /// Class of a supply voltage; NaN counts as low.
    fn of(supply_v: f64) -> Self {
        if supply_v > SUPPLY_MAX_V {
            Self::TooHigh
        } else if supply_v >= SUPPLY_MIN_V {
            Self::Good
        } else {
            Self::Low
        }
    }
}

/// Bridge of one motor, with its last direction and the misuses so far.
#[derive(Clone, Debug, PartialEq)]
pub struct DhbMotor {
    number: u8,
    inputs: DhbInputs,
    supply: Supply,
    output: BridgeOutput,
    /// It pauses without an enabled input at high level.
    reversals: Reversals,
    misuse: MisuseLog,
}

impl DhbMotor {
    /// Name of the bridge in reports.
    pub const NAME: &str = "DHB-12 bridge";

    /// A bridge without supply, its inputs low; `number` identifies it in reports.
    #[must_use]
    pub const fn new(number: u8) -> Self {
        Self {
            number,
            inputs: DhbInputs { in1: Line::Low, in2: Line::Low, en: Line::Low },
            supply: Supply::Low,
            output: BridgeOutput::COAST,
            reversals: Reversals::new(),
            misuse: MisuseLog::new(),
        }
    }

    /// Sets the inputs from `at_ns` on, and returns the output to the motor. Cheap while they do not change.
    ///
    /// `pwm_period_ns` is that of the chip that drives the inputs.
    pub fn update(&mut self, at_ns: u64, inputs: &DhbInputs, pwm_period_ns: u64, supply_v: f64) -> BridgeOutput {
        let supply = Supply::of(supply_v);
        let supply_changed = supply != self.supply;
        if supply_changed && supply == Supply::TooHigh {
            let millivolts = |volts: f64| (volts * 1e3).round() as u64;
            let kind =
                MisuseKind::SupplyAboveLimit { supply_mv: millivolts(supply_v), limit_mv: millivolts(SUPPLY_MAX_V) };
            self.report(at_ns, kind);
        }
        if supply_changed || *inputs != self.inputs {
            self.supply = supply;
            self.inputs = *inputs;
            self.change(at_ns, pwm_period_ns);
        }
        self.output
    }

    /// Output to the motor at the last [`update`](Self::update).
    #[must_use]
    pub const fn output(&self) -> BridgeOutput {
        self.output
    }

    /// Misuses so far: inputs that violate the rules of the bridge.
    #[must_use]
    pub const fn misuse(&self) -> &MisuseLog {
        &self.misuse
    }

    /// Misuses so far, mutable, so that a test can clear them.
    pub const fn misuse_mut(&mut self) -> &mut MisuseLog {
        &mut self.misuse
    }

    fn change(&mut self, at_ns: u64, pwm_period_ns: u64) {
        // without a good supply it behaves as with EN low
        let shares = if self.supply == Supply::Good { Shares::of(&self.inputs) } else { Shares::default() };
        self.output = shares.output();
        if let Some(idle_ns) = self.reversals.too_short(at_ns, shares.forward, shares.reverse, pwm_period_ns) {
            self.report(at_ns, MisuseKind::ReversalWithoutPause { idle_ns, needed_ns: pwm_period_ns });
        }
        if shares.both_high > 0 {
            self.report(at_ns, MisuseKind::InputsOverlap { counts: shares.both_high });
        }
        let counts = shares.forward.max(shares.reverse);
        if counts > DUTY_LIMIT_COUNTS {
            self.report(at_ns, MisuseKind::DutyAboveLimit { counts, limit_counts: DUTY_LIMIT_COUNTS });
        }
        self.reversals.set_idle(at_ns, shares.forward + shares.reverse + shares.both_high == 0);
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

    const PERIOD_NS: u64 = 655_360;

    const fn pwm(on: u16, off: u16) -> Line {
        Line::Pwm { on, off }
    }

    const fn inputs(in1: Line, in2: Line, en: Line) -> DhbInputs {
        DhbInputs { in1, in2, en }
    }

    const fn forward(counts: u16) -> DhbInputs {
        inputs(pwm(0, counts), Line::Low, Line::High)
    }

    const fn reverse(counts: u16) -> DhbInputs {
        inputs(Line::Low, pwm(0, counts), Line::High)
    }

    const STOPPED: DhbInputs = inputs(Line::Low, Line::Low, Line::High);

    fn kinds(bridge: &DhbMotor) -> Vec<MisuseKind> {
        bridge.misuse().first().iter().map(|misuse| misuse.kind).collect()
    }

    #[test]
    fn truth_table_of_steady_levels() {
        use Line::{High, HighZ, Low};
        // in1, in2, en -> duty, coast, brake
        for (levels, duty, coast, brake) in [
            ([Low, Low, Low], 0.0, 1.0, 0.0),
            ([High, Low, Low], 0.0, 1.0, 0.0),
            ([Low, High, Low], 0.0, 1.0, 0.0),
            ([High, High, Low], 0.0, 1.0, 0.0),
            ([Low, Low, High], 0.0, 0.0, 1.0),
            ([High, Low, High], 1.0, 0.0, 0.0),
            ([Low, High, High], -1.0, 0.0, 0.0),
            ([High, High, High], 0.0, 0.0, 1.0),
            // not driven is low
            ([High, Low, HighZ], 0.0, 1.0, 0.0),
            ([HighZ, High, High], -1.0, 0.0, 0.0),
        ] {
            let [in1, in2, en] = levels;
            let mut bridge = DhbMotor::new(0);
            let output = bridge.update(0, &inputs(in1, in2, en), PERIOD_NS, 12.0);
            assert_eq!(output, BridgeOutput { duty, coast, brake }, "{levels:?}");
        }
    }

    #[test]
    fn the_library_s_scheme_is_normal_use() {
        let mut bridge = DhbMotor::new(0);
        let output = bridge.update(0, &forward(1024), PERIOD_NS, 12.0);
        assert_eq!(output, BridgeOutput { duty: 0.25, coast: 0.0, brake: 0.75 });
        bridge.update(1, &STOPPED, PERIOD_NS, 12.0);
        let output = bridge.update(1 + PERIOD_NS, &reverse(3072), PERIOD_NS, 12.0);
        assert_eq!(output, BridgeOutput { duty: -0.75, coast: 0.0, brake: 0.25 });
        // switched at EN, the remainder of the cycle coasts
        let output = bridge.update(2, &inputs(Line::Low, Line::High, pwm(0, 1024)), PERIOD_NS, 12.0);
        assert_eq!(output, BridgeOutput { duty: -0.25, coast: 0.75, brake: 0.0 });
        assert!(bridge.misuse().is_empty(), "{:?}", bridge.misuse());
    }

    #[test]
    fn duty_is_limited_to_98_per_cent() {
        assert_eq!(u32::from(DUTY_LIMIT_COUNTS), u32::from(COUNTS) * 98 / 100);
        for (counts, line) in [(4014, pwm(0, 4014)), (4015, pwm(0, 4015)), (4095, pwm(0, 4095)), (4096, Line::High)] {
            for asked in [inputs(line, Line::Low, Line::High), inputs(Line::Low, line, Line::High)] {
                let mut bridge = DhbMotor::new(0);
                let output = bridge.update(0, &asked, PERIOD_NS, 12.0);
                assert_eq!(output.duty.abs(), f64::from(counts) / 4096.0);
                let expected = MisuseKind::DutyAboveLimit { counts, limit_counts: 4014 };
                assert_eq!(kinds(&bridge), if counts > 4014 { vec![expected] } else { vec![] });
            }
        }
    }

    #[test]
    fn runs_from_5_v_to_15_v_only() {
        let mut bridge = DhbMotor::new(2);
        for (at_ns, supply_v, runs) in [
            (0, f64::NAN, false),
            (1, 4.99, false),
            (2, 5.0, true),
            (3, 15.0, true),
            (4, 15.001, false),
            (5, 24.0, false),
            (6, 12.0, true),
            (7, f64::INFINITY, false),
            (8, 0.0, false),
            (9, -12.0, false),
        ] {
            let output = bridge.update(at_ns, &forward(2048), PERIOD_NS, supply_v);
            assert_eq!(output != BridgeOutput::COAST, runs, "{supply_v}");
        }
        let expected = |supply_mv| MisuseKind::SupplyAboveLimit { supply_mv, limit_mv: 15_000 };
        assert_eq!(kinds(&bridge), [expected(15_001), expected(u64::MAX)]);
        assert_eq!((bridge.misuse().first()[0].address, bridge.misuse().first()[0].time_ns), (2, 4));
    }

    #[test]
    fn reversal_needs_a_whole_period_without_drive() {
        let off = inputs(pwm(0, 1000), Line::Low, Line::Low);
        for between in [STOPPED, off] {
            for (idle_ns, reported) in [(0, true), (PERIOD_NS - 1, true), (PERIOD_NS, false)] {
                let mut bridge = DhbMotor::new(0);
                bridge.update(0, &forward(1000), PERIOD_NS, 12.0);
                if idle_ns > 0 {
                    bridge.update(10_000_000, &between, PERIOD_NS, 12.0);
                }
                bridge.update(10_000_000 + idle_ns, &reverse(1000), PERIOD_NS, 12.0);
                let expected = MisuseKind::ReversalWithoutPause { idle_ns, needed_ns: PERIOD_NS };
                assert_eq!(kinds(&bridge), if reported { vec![expected] } else { vec![] });
            }
        }
    }

    #[test]
    fn both_inputs_high_is_reported_and_no_pause() {
        let mut bridge = DhbMotor::new(0);
        let output = bridge.update(0, &inputs(pwm(0, 2000), pwm(1500, 2000), Line::High), PERIOD_NS, 12.0);
        assert_eq!(output.duty, 1500.0 / 4096.0);
        assert_eq!(kinds(&bridge), [MisuseKind::InputsOverlap { counts: 500 }]);
        bridge.update(1, &inputs(Line::High, Line::High, Line::High), PERIOD_NS, 12.0);
        bridge.update(10 * PERIOD_NS, &reverse(1000), PERIOD_NS, 12.0);
        let reversal = MisuseKind::ReversalWithoutPause { idle_ns: 0, needed_ns: PERIOD_NS };
        assert_eq!(kinds(&bridge)[1..], [MisuseKind::InputsOverlap { counts: 4096 }, reversal]);
    }

    #[test]
    fn both_directions_in_one_cycle_are_reported_once() {
        let mut bridge = DhbMotor::new(0);
        for at_ns in 0..5 {
            let both = inputs(pwm(0, 1000), pwm(2000, 3000), Line::High);
            assert_eq!(bridge.update(at_ns, &both, PERIOD_NS, 12.0).duty, 0.0);
        }
        assert_eq!(kinds(&bridge), [MisuseKind::ReversalWithoutPause { idle_ns: 0, needed_ns: PERIOD_NS }]);
    }

    fn any_line() -> impl Strategy<Value = Line> {
        prop_oneof![
            Just(Line::Low),
            Just(Line::High),
            Just(Line::HighZ),
            (0..COUNTS, 0..COUNTS).prop_map(|(on, off)| pwm(on, off)),
            // coinciding edges
            (0..4u16, 0..4u16).prop_map(|(on, off)| pwm(on * 1024, off * 1024)),
        ]
    }

    fn any_inputs() -> impl Strategy<Value = DhbInputs> {
        (any_line(), any_line(), any_line()).prop_map(|(in1, in2, en)| inputs(in1, in2, en))
    }

    proptest! {
        #[test]
        fn shares_equal_counting_every_count(inputs in any_inputs()) {
            let mut counted = Shares::default();
            for count in 0..COUNTS {
                counted.add(&inputs, count, 1);
            }
            prop_assert_eq!(Shares::of(&inputs), counted);
        }

        #[test]
        fn looking_often_changes_nothing(
            changes in prop::collection::vec((1..2_000_000u64, any_inputs(), 0.0..20.0f64), 1..20),
        ) {
            let [mut lazy, mut eager] = [DhbMotor::new(0), DhbMotor::new(0)];
            let mut at_ns = 0;
            for (wait_ns, inputs, supply_v) in changes {
                for look_ns in 0..4 {
                    eager.update(at_ns + wait_ns * look_ns / 4, &inputs, PERIOD_NS, supply_v);
                }
                lazy.update(at_ns, &inputs, PERIOD_NS, supply_v);
                at_ns += wait_ns;
            }
            prop_assert_eq!(lazy, eager);
        }

        #[test]
        fn never_panics(changes in prop::collection::vec(
            (any::<u64>(), any::<[Option<(u16, u16)>; 3]>(), any::<f64>(), any::<u64>()), 0..20,
        )) {
            let mut bridge = DhbMotor::new(0);
            for (at_ns, lines, supply_v, period_ns) in changes {
                let [in1, in2, en] = lines.map(|edges| edges.map_or(Line::High, |(on, off)| pwm(on, off)));
                let output = bridge.update(at_ns, &inputs(in1, in2, en), period_ns, supply_v);
                prop_assert!(output.duty.abs() + output.coast + output.brake <= 1.0);
            }
        }
    }
}
