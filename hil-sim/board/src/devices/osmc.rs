//! OSMC power bridge: four MOSFET banks behind an Intersil HIP4081A driver.
//!
//! # Truth table of a leg (HIP4081A datasheet, input logic)
//! | DIS | supply | xLI | xHI | low FET | high FET |
//! | --- | --- | --- | --- | --- | --- |
//! | 1 | any | any | any | off | off |
//! | any | locked out | any | any | off | off |
//! | 0 | good | 1 | any | on | off |
//! | 0 | good | 0 | 1 | off | on |
//! | 0 | good | 0 | 0 | off | off |
//!
//! The low input has priority, so the driver never shorts the supply. Inputs have pull-ups: one that is not driven
//! counts as high, and a floating DIS as disabled.
//!
//! #  Misuse
//! The published way to drive the board holds both high inputs high and switches one low input: both inputs of a leg
//! are then high together on purpose. A static high input is therefore never a shoot-through attempt; a high input that
//! is itself switched, and high at the same time as its low input, is one.
//!
//! The dead time between the two FETs of a leg (set by resistors, below a microsecond) is shorter than a count and not
//! modelled; neither are the 400 ns for which both low FETs turn on at power-up (Intersil AN9404).

use super::reversal::Reversals;
use crate::chips::{COUNTS, Line, stretches};
use crate::misuse::{Leg, Misuse, MisuseKind, MisuseLog};

/// Supply voltage below which the driver turns off all FETs, V (AN9404, nominal).
const LOCKOUT_FALLING_V: f64 = 8.25;
/// Supply voltage at which the driver starts, V (AN9404, nominal).
const LOCKOUT_RISING_V: f64 = 8.75;

/// Logic header of the board. The four lines come from one PWM chip, so their cycles start together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BridgeInputs {
    /// High side of leg A.
    pub ahi: Line,
    /// Low side of leg A.
    pub ali: Line,
    /// High side of leg B.
    pub bhi: Line,
    /// Low side of leg B.
    pub bli: Line,
    /// Level of the DIS pin; high turns off all FETs.
    pub disabled: bool,
}

/// Output of a bridge over one PWM cycle, as shares of the cycle.
///
/// Forward is leg A high and leg B low. With both directions in one cycle `duty` is the difference, so the three do not
/// always add up to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BridgeOutput {
    /// Share with the supply across the motor from A to B, minus the share from B to A: -1 to 1.
    pub duty: f64,
    /// Share in which at least one leg has both FETs off: the terminals float, current decays through body diodes only.
    pub coast: f64,
    /// Share with both terminals on the same rail: the motor is shorted.
    pub brake: f64,
}

impl BridgeOutput {
    /// Output with all FETs off.
    pub const COAST: Self = Self { duty: 0.0, coast: 1.0, brake: 0.0 };
}

/// State of one leg at one instant.
#[derive(Clone, Copy, PartialEq, Eq)]
enum LegState {
    High,
    Low,
    Open,
}

const fn leg_state(high_input: bool, low_input: bool) -> LegState {
    if low_input {
        LegState::Low
    } else if high_input {
        LegState::High
    } else {
        LegState::Open
    }
}

/// Counts of one PWM cycle in each state, 0 to 4096.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Sweep {
    forward: u16,
    reverse: u16,
    coast: u16,
    brake: u16,
    /// Counts with both inputs of a leg high.
    both_a: u16,
    both_b: u16,
}

/// Level of an input; one that is not driven is high, by the pull-ups in the driver.
const fn is_high(line: Line, count: u16) -> bool {
    line.is_high_at(count, true)
}

impl Sweep {
    /// Adds up the intervals in which no line changes.
    fn of(inputs: &BridgeInputs) -> Self {
        let mut sweep = Self::default();
        for (from, length) in stretches::<9>([inputs.ahi, inputs.ali, inputs.bhi, inputs.bli]) {
            sweep.add(inputs, from, length);
        }
        sweep
    }

    fn add(&mut self, inputs: &BridgeInputs, count: u16, length: u16) {
        let [ahi, ali] = [is_high(inputs.ahi, count), is_high(inputs.ali, count)];
        let [bhi, bli] = [is_high(inputs.bhi, count), is_high(inputs.bli, count)];
        self.both_a += if ahi && ali { length } else { 0 };
        self.both_b += if bhi && bli { length } else { 0 };
        let share = match (leg_state(ahi, ali), leg_state(bhi, bli)) {
            (LegState::High, LegState::Low) => &mut self.forward,
            (LegState::Low, LegState::High) => &mut self.reverse,
            (LegState::Open, _) | (_, LegState::Open) => &mut self.coast,
            (LegState::High, LegState::High) | (LegState::Low, LegState::Low) => &mut self.brake,
        };
        *share += length;
    }

    fn output(&self) -> BridgeOutput {
        let share = |counts: f64| counts / f64::from(COUNTS);
        BridgeOutput {
            duty: share(f64::from(self.forward) - f64::from(self.reverse)),
            coast: share(f64::from(self.coast)),
            brake: share(f64::from(self.brake)),
        }
    }
}

/// Average over one PWM cycle, exact to the count, for a bridge with a good supply.
#[must_use]
pub fn average(inputs: &BridgeInputs) -> BridgeOutput {
    if inputs.disabled { BridgeOutput::COAST } else { Sweep::of(inputs).output() }
}

/// One bridge, with its supply lock-out, last direction, and the misuses so far.
#[derive(Clone, Debug)]
pub struct OsmcBridge {
    number: u8,
    powered: bool,
    inputs: BridgeInputs,
    output: BridgeOutput,
    /// It pauses with both low FETs off.
    reversals: Reversals,
    misuse: MisuseLog,
}

impl OsmcBridge {
    /// Name of the bridge in reports.
    pub const NAME: &str = "OSMC bridge";

    /// A bridge without supply and disabled; `number` identifies it in reports.
    #[must_use]
    pub const fn new(number: u8) -> Self {
        let inputs = BridgeInputs { ahi: Line::Low, ali: Line::Low, bhi: Line::Low, bli: Line::Low, disabled: true };
        Self {
            number,
            powered: false,
            inputs,
            output: BridgeOutput::COAST,
            reversals: Reversals::new(),
            misuse: MisuseLog::new(),
        }
    }

    /// Sets the inputs from `at_ns` on, and returns the output to the motor. Cheap while they do not change.
    ///
    /// `gate_supply_v` is the driver's own supply: 12 V from the board's regulator, less if the battery is too low for
    /// that. `pwm_period_ns` is that of the chip that drives the inputs.
    pub fn update(
        &mut self,
        at_ns: u64,
        inputs: &BridgeInputs,
        pwm_period_ns: u64,
        gate_supply_v: f64,
    ) -> BridgeOutput {
        // written so that NaN counts as no supply
        let threshold_v = if self.powered { LOCKOUT_FALLING_V } else { LOCKOUT_RISING_V };
        let powered = gate_supply_v >= threshold_v;
        if powered != self.powered || *inputs != self.inputs {
            self.powered = powered;
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

    /// True while the driver's supply is good: off below 8.25 V, on from 8.75 V.
    #[must_use]
    pub const fn is_powered(&self) -> bool {
        self.powered
    }

    /// Misuses so far: inputs that violate the rules of the driver.
    #[must_use]
    pub const fn misuse(&self) -> &MisuseLog {
        &self.misuse
    }

    /// Misuses so far, mutable, so that a test can clear them.
    pub const fn misuse_mut(&mut self) -> &mut MisuseLog {
        &mut self.misuse
    }

    fn change(&mut self, at_ns: u64, pwm_period_ns: u64) {
        if !self.powered || self.inputs.disabled {
            self.output = BridgeOutput::COAST;
            self.reversals.set_idle(at_ns, true);
            return;
        }
        let sweep = Sweep::of(&self.inputs);
        self.output = sweep.output();
        // Also if both directions occur in one cycle.
        if let Some(off_ns) = self.reversals.too_short(at_ns, sweep.forward, sweep.reverse, pwm_period_ns) {
            self.report(at_ns, MisuseKind::ReversalWithoutDeadTime { off_ns, needed_ns: pwm_period_ns });
        }
        let BridgeInputs { ahi, ali, bhi, bli, .. } = self.inputs;
        self.check_leg(at_ns, Leg::A, ahi, ali, sweep.both_a);
        self.check_leg(at_ns, Leg::B, bhi, bli, sweep.both_b);
        self.reversals.set_idle(at_ns, !is_ever_high(ali) && !is_ever_high(bli));
    }

    fn check_leg(&mut self, at_ns: u64, leg: Leg, high: Line, low: Line, both: u16) {
        if !matches!(high, Line::Pwm { .. }) {
            return;
        }
        if both > 0 {
            self.report(at_ns, MisuseKind::ShootThroughAttempt { leg, counts: both });
        }
        if !is_ever_high(low) {
            self.report(at_ns, MisuseKind::HighSideWithoutRefresh { leg });
        }
    }

    #[cold]
    fn report(&mut self, time_ns: u64, kind: MisuseKind) {
        self.misuse.report(Misuse { time_ns, chip: Self::NAME, address: self.number, kind });
    }
}

const fn is_ever_high(line: Line) -> bool {
    line.counts_high(true) > 0
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const PERIOD_NS: u64 = 655_360;

    const fn pwm(on: u16, off: u16) -> Line {
        Line::Pwm { on, off }
    }

    const fn inputs(ahi: Line, ali: Line, bhi: Line, bli: Line) -> BridgeInputs {
        BridgeInputs { ahi, ali, bhi, bli, disabled: false }
    }

    /// Published drive scheme: both high inputs high, one low input switched.
    const fn forward(counts: u16) -> BridgeInputs {
        inputs(Line::High, Line::Low, Line::High, pwm(0, counts))
    }

    const fn reverse(counts: u16) -> BridgeInputs {
        inputs(Line::High, pwm(0, counts), Line::High, Line::Low)
    }

    const STOPPED: BridgeInputs = inputs(Line::High, Line::Low, Line::High, Line::Low);

    fn kinds(bridge: &OsmcBridge) -> Vec<MisuseKind> {
        bridge.misuse().first().iter().map(|misuse| misuse.kind).collect()
    }

    #[test]
    fn truth_table_of_steady_levels() {
        use Line::{High, HighZ, Low};
        // ahi, ali, bhi, bli -> duty, coast, brake
        for (levels, duty, coast, brake) in [
            ([Low, Low, Low, Low], 0.0, 1.0, 0.0),
            ([High, Low, Low, High], 1.0, 0.0, 0.0),
            ([Low, High, High, Low], -1.0, 0.0, 0.0),
            ([High, Low, High, Low], 0.0, 0.0, 1.0),
            ([Low, High, Low, High], 0.0, 0.0, 1.0),
            // one leg open
            ([High, Low, Low, Low], 0.0, 1.0, 0.0),
            ([Low, Low, Low, High], 0.0, 1.0, 0.0),
            // the low input has priority
            ([High, High, High, Low], -1.0, 0.0, 0.0),
            ([High, High, High, High], 0.0, 0.0, 1.0),
            // not driven is high
            ([HighZ, Low, Low, HighZ], 1.0, 0.0, 0.0),
        ] {
            let [ahi, ali, bhi, bli] = levels;
            let mut inputs = inputs(ahi, ali, bhi, bli);
            assert_eq!(average(&inputs), BridgeOutput { duty, coast, brake }, "{levels:?}");
            inputs.disabled = true;
            assert_eq!(average(&inputs), BridgeOutput::COAST);
        }
    }

    #[test]
    fn the_published_scheme_is_normal_use() {
        let mut bridge = OsmcBridge::new(0);
        let output = bridge.update(0, &forward(1024), PERIOD_NS, 12.0);
        assert_eq!(output, BridgeOutput { duty: 0.25, coast: 0.0, brake: 0.75 });
        bridge.update(1, &STOPPED, PERIOD_NS, 12.0);
        let output = bridge.update(1 + PERIOD_NS, &reverse(3072), PERIOD_NS, 12.0);
        assert_eq!(output, BridgeOutput { duty: -0.75, coast: 0.0, brake: 0.25 });
        assert!(bridge.misuse().is_empty(), "{:?}", bridge.misuse());
    }

    #[test]
    fn reversal_needs_a_whole_period_with_the_low_sides_off() {
        for (off_ns, reported) in [(0, true), (PERIOD_NS - 1, true), (PERIOD_NS, false)] {
            let mut bridge = OsmcBridge::new(0);
            bridge.update(0, &forward(1000), PERIOD_NS, 12.0);
            if off_ns > 0 {
                bridge.update(10_000_000, &STOPPED, PERIOD_NS, 12.0);
            }
            bridge.update(10_000_000 + off_ns, &reverse(1000), PERIOD_NS, 12.0);
            let expected = MisuseKind::ReversalWithoutDeadTime { off_ns, needed_ns: PERIOD_NS };
            assert_eq!(kinds(&bridge), if reported { vec![expected] } else { vec![] });
        }
    }

    #[test]
    fn a_brake_with_the_low_sides_is_no_dead_time_and_disabling_is() {
        let brake = inputs(Line::Low, Line::High, Line::Low, Line::High);
        let off = BridgeInputs { disabled: true, ..STOPPED };
        for (between, reports) in [(brake, 1), (off, 0)] {
            let mut bridge = OsmcBridge::new(0);
            bridge.update(0, &forward(1000), PERIOD_NS, 12.0);
            bridge.update(10_000_000, &between, PERIOD_NS, 12.0);
            bridge.update(20_000_000, &reverse(1000), PERIOD_NS, 12.0);
            assert_eq!(bridge.misuse().total(), reports);
        }
    }

    #[test]
    fn both_inputs_high_is_reported_when_the_high_side_is_switched() {
        let mut bridge = OsmcBridge::new(3);
        let output = bridge.update(7, &inputs(pwm(0, 2000), pwm(1500, 4000), Line::Low, Line::High), PERIOD_NS, 12.0);
        // the low side has priority from 1500: 1500 forward, 2500 braked, 96 open
        assert_eq!(output.duty, 1500.0 / 4096.0);
        assert_eq!(output.coast, 96.0 / 4096.0);
        assert_eq!(kinds(&bridge), [MisuseKind::ShootThroughAttempt { leg: Leg::A, counts: 500 }]);
        assert_eq!((bridge.misuse().first()[0].address, bridge.misuse().first()[0].time_ns), (3, 7));
    }

    #[test]
    fn a_switched_high_side_needs_its_low_side() {
        let mut bridge = OsmcBridge::new(0);
        bridge.update(0, &inputs(Line::Low, Line::High, pwm(0, 2048), Line::Low), PERIOD_NS, 12.0);
        assert_eq!(kinds(&bridge), [MisuseKind::HighSideWithoutRefresh { leg: Leg::B }]);
        bridge.misuse_mut().clear();
        bridge.update(1, &inputs(Line::Low, Line::High, pwm(0, 2048), pwm(2048, 0)), PERIOD_NS, 12.0);
        assert!(bridge.misuse().is_empty());
    }

    #[test]
    fn supply_lock_out_has_hysteresis() {
        let mut bridge = OsmcBridge::new(0);
        let full = inputs(Line::High, Line::Low, Line::High, Line::High);
        for (supply_v, powered) in [
            (0.0, false),
            (8.5, false),
            (8.75, true),
            (8.5, true),
            (8.25, true),
            (8.24, false),
            (8.74, false),
            (12.0, true),
            (f64::NAN, false),
        ] {
            let output = bridge.update(0, &full, PERIOD_NS, supply_v);
            assert_eq!(bridge.is_powered(), powered, "{supply_v}");
            assert_eq!(output == BridgeOutput::COAST, !powered);
        }
    }

    #[test]
    fn both_directions_in_one_cycle_are_reported_once() {
        let mut bridge = OsmcBridge::new(0);
        let both = inputs(Line::High, pwm(0, 1000), Line::High, pwm(2000, 3000));
        for at_ns in 0..5 {
            assert_eq!(bridge.update(at_ns, &both, PERIOD_NS, 12.0).duty, 0.0);
        }
        assert_eq!(kinds(&bridge), [MisuseKind::ReversalWithoutDeadTime { off_ns: 0, needed_ns: PERIOD_NS }]);
    }

    fn any_line() -> impl Strategy<Value = Line> {
        prop_oneof![
            Just(Line::Low),
            Just(Line::High),
            Just(Line::HighZ),
            (0..COUNTS, 0..COUNTS).prop_map(|(on, off)| Line::Pwm { on, off }),
            // coinciding edges
            (0..4u16, 0..4u16).prop_map(|(on, off)| Line::Pwm { on: on * 1024, off: off * 1024 }),
        ]
    }

    proptest! {
        #[test]
        fn sweep_equals_counting_every_count(
            ahi in any_line(), ali in any_line(), bhi in any_line(), bli in any_line(),
        ) {
            let inputs = inputs(ahi, ali, bhi, bli);
            let mut counted = Sweep::default();
            for count in 0..COUNTS {
                counted.add(&inputs, count, 1);
            }
            let swept = Sweep::of(&inputs);
            prop_assert_eq!(swept, counted);
            prop_assert_eq!(swept.forward + swept.reverse + swept.coast + swept.brake, COUNTS);
        }

        #[test]
        fn never_panics(changes in prop::collection::vec(
            (any::<u64>(), any_line(), any_line(), any_line(), any_line(), any::<bool>(), any::<f64>(), any::<u64>()),
            0..20,
        )) {
            let mut bridge = OsmcBridge::new(0);
            for (at_ns, ahi, ali, bhi, bli, disabled, supply_v, period_ns) in changes {
                let inputs = BridgeInputs { ahi, ali, bhi, bli, disabled };
                let output = bridge.update(at_ns, &inputs, period_ns, supply_v);
                prop_assert!(output.duty.abs() + output.coast + output.brake <= 1.0);
            }
        }
    }
}
