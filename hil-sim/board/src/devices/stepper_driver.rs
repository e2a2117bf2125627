//! Stepper driver of the M542 class, with a model of whether the rotor of its motor can follow.
//!
//! # Rules for the inputs
//! Limits of the DM542T, or of the M542 V2 where that is slower:
//!
//! | rule | limit |
//! | --- | --- |
//! | step high, step low | 2.5 us each; so 200 kHz at most |
//! | direction set up before, held after the rising edge of a step | 5 us |
//! | enabled before the first step | 5 ms |
//!
//! A real driver may or may not take a step that violates a rule; here it is always dropped, and reported. A step is
//! counted 5 us after its edge, when it can no longer violate a rule. An unconnected enable input is enabled. The
//! position is kept while disabled: the motor is not loaded.
//!
//! # The rotor
//! - Up to the start-stop rate each step is a start and a stop of its own.
//! - Above it, the rotor's speed follows the step rate with an acceleration proportional to the difference, up to the
//!   motor's highest at a difference of the start-stop rate. With a larger difference the rotor loses synchronism.
//! - Steps may end or reverse if the rotor or the last interval is no faster than the start-stop rate. A ramp of up to
//!   the motor's acceleration is therefore followed, and jitter below the start-stop rate averages out.
//! - A stalled rotor stands until the steps pause for 50 ms. The lost steps are `commanded` minus `position`; a sudden
//!   end of the steps is reported, but how far the rotor then slips is not modelled.
//!
//! Not modelled: torque, load, resonance, current and its reduction at rest, heat, the optocouplers' 5 mA.

use crate::misuse::{Misuse, MisuseKind, MisuseLog};

/// Shortest high and low time of the step input, ns.
const PULSE_NS: u64 = 2_500;
/// Set-up and hold time of the direction input, ns.
const DIRECTION_NS: u64 = 5_000;
/// Time from enable to the first step, ns.
const ENABLE_NS: u64 = 5_000_000;
/// Time after which a stalled rotor has come to rest, ns; a modelling choice.
const REST_NS: u64 = 50_000_000;

/// Parameters of a driver and its motor. All are finite and above 0; steps are those of the step input, microsteps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepperDriverSpec {
    /// Level of the enable input that enables: high if true.
    pub enabled_when_high: bool,
    /// Start-stop rate, also called pull-in rate, steps/s: followed without a ramp.
    pub start_stop_hz: f64,
    /// Highest acceleration and deceleration, steps/s².
    pub acceleration_hz_s: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Step {
    rise_ns: u64,
    forward: bool,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Rotor {
    /// Last step that the driver took.
    last: Option<Step>,
    /// Rate of the steps in the last interval, steps/s.
    step_hz: f64,
    /// Speed in the direction of the last step, steps/s, not negative.
    speed_hz: f64,
    stalled: bool,
}

impl Rotor {
    const AT_REST: Self = Self { last: None, step_hz: 0.0, speed_hz: 0.0, stalled: false };
}

/// One driver with its motor. Calls are in order of time: an earlier time than one already seen counts as that one.
#[derive(Clone, Debug, PartialEq)]
pub struct StepperDriver {
    number: u8,
    spec: StepperDriverSpec,
    now_ns: u64,
    step_high: bool,
    /// Times of the last rising and falling edge of the step input, ns.
    rise_ns: Option<u64>,
    fall_ns: Option<u64>,
    forward: bool,
    /// Time of the last edge of the direction input, ns.
    direction_ns: Option<u64>,
    enable_input: bool,
    supplied: bool,
    /// Time from which on the driver takes steps, ns; `None` while disabled.
    ready_ns: Option<u64>,
    /// Step that may still violate a rule.
    pending: Option<Step>,
    rotor: Rotor,
    commanded: i64,
    position: i64,
    misuse: MisuseLog,
}

impl StepperDriver {
    /// Name of the driver in reports.
    pub const NAME: &str = "stepper driver";

    /// A driver whose supply has long been on, with an unconnected enable input and so enabled; step low, direction
    /// forward (high). `number` identifies it in reports.
    #[must_use]
    pub const fn new(number: u8, spec: StepperDriverSpec) -> Self {
        Self {
            number,
            spec,
            now_ns: 0,
            step_high: false,
            rise_ns: None,
            fall_ns: None,
            forward: true,
            direction_ns: None,
            enable_input: true,
            supplied: true,
            ready_ns: Some(0),
            pending: None,
            rotor: Rotor::AT_REST,
            commanded: 0,
            position: 0,
            misuse: MisuseLog::new(),
        }
    }

    /// Sets the level of the step input from `t_ns` on; its rising edge is a step.
    pub fn step(&mut self, t_ns: u64, high: bool) {
        self.advance(t_ns);
        if high == self.step_high {
            return;
        }
        self.step_high = high;
        if high { self.rise() } else { self.fall() }
    }

    /// Sets the level of the direction input from `t_ns` on; high is forward, towards positive positions.
    pub fn direction(&mut self, t_ns: u64, high: bool) {
        self.advance(t_ns);
        if high == self.forward {
            return;
        }
        self.forward = high;
        self.direction_ns = Some(self.now_ns);
        // a step still pending has not had its hold time of 5 us
        if let Some(step) = self.pending.take() {
            let held_ns = self.now_ns - step.rise_ns;
            self.report(self.now_ns, MisuseKind::DirectionHoldTooShort { held_ns, needed_ns: DIRECTION_NS });
        }
    }

    /// Sets the level of the enable input from `t_ns` on.
    pub fn enable(&mut self, t_ns: u64, high: bool) {
        self.advance(t_ns);
        self.enable_input = high == self.spec.enabled_when_high;
        self.look_at_enable();
    }

    /// Switches the motor supply, as a relay does: without it the driver behaves as disabled.
    pub fn supply(&mut self, t_ns: u64, on: bool) {
        self.advance(t_ns);
        self.supplied = on;
        self.look_at_enable();
    }

    /// Sends `count` pulses of `high_ns`, the first rising at `first_ns`, one every `interval_ns`.
    ///
    /// Equivalent to [`step`](Self::step) for each edge, but steps at a constant speed that the rotor has reached take
    /// no computing time.
    pub fn pulses(&mut self, first_ns: u64, interval_ns: u64, count: u64, high_ns: u64) {
        let rise_ns = |index: u64| first_ns.saturating_add(interval_ns.saturating_mul(index));
        let mut index = 0;
        while index < count {
            let at_ns = rise_ns(index);
            let whole = count - 1 - index;
            // the last one stays a single step, because it is pending afterwards
            if whole > 0 && rise_ns(count) < u64::MAX && self.is_steady(at_ns, interval_ns, high_ns) {
                self.skip(rise_ns(index + whole - 1), whole, high_ns);
                index += whole;
            } else {
                self.step(at_ns, true);
                self.step(at_ns.saturating_add(high_ns), false);
                index += 1;
            }
        }
    }

    /// Advances the driver to `to_ns`.
    pub fn advance(&mut self, to_ns: u64) {
        self.now_ns = self.now_ns.max(to_ns);
        if let Some(step) = self.pending {
            if self.now_ns - step.rise_ns < DIRECTION_NS {
                // this step decides if the steps have ended
                return;
            }
            self.pending = None;
            self.take(step);
        }
        self.look_for_end_of_steps();
    }

    /// Position of the rotor, steps from its start; a step is counted 5 us after its edge.
    #[must_use]
    pub const fn position(&self) -> i64 {
        self.position
    }

    /// Speed of the rotor, steps/s; 0 once the next step is late by half an interval.
    #[must_use]
    pub fn speed_hz(&self) -> f64 {
        let Rotor { last, speed_hz, stalled, .. } = self.rotor;
        let Some(last) = last.filter(|_| !stalled) else { return 0.0 };
        let since_s = (self.now_ns - last.rise_ns) as f64 * 1e-9;
        if since_s * speed_hz > 1.5 {
            0.0
        } else if last.forward {
            speed_hz
        } else {
            -speed_hz
        }
    }

    /// Position of a rotor that never stalls: all steps that the driver took.
    #[must_use]
    pub const fn commanded(&self) -> i64 {
        self.commanded
    }

    /// True while the rotor is out of step.
    #[must_use]
    pub const fn is_stalled(&self) -> bool {
        self.rotor.stalled
    }

    /// True while the driver has its supply and is enabled.
    #[must_use]
    pub const fn is_enabled(&self) -> bool {
        self.ready_ns.is_some()
    }

    /// Inputs so far that violate the rules of driver and motor.
    #[must_use]
    pub const fn misuse(&self) -> &MisuseLog {
        &self.misuse
    }

    /// Misuses so far, mutable, so that a test can clear them.
    pub const fn misuse_mut(&mut self) -> &mut MisuseLog {
        &mut self.misuse
    }

    // ---- inputs ----

    fn look_at_enable(&mut self) {
        if !(self.enable_input && self.supplied) {
            self.ready_ns = None;
        } else if self.ready_ns.is_none() {
            self.ready_ns = Some(self.now_ns.saturating_add(ENABLE_NS));
        }
    }

    fn rise(&mut self) {
        self.rise_ns = Some(self.now_ns);
        match self.refusal() {
            None => self.pending = Some(Step { rise_ns: self.now_ns, forward: self.forward }),
            Some(kind) => self.report(self.now_ns, kind),
        }
    }

    fn fall(&mut self) {
        self.fall_ns = Some(self.now_ns);
        let lasted_ns = self.since(self.rise_ns);
        if lasted_ns >= PULSE_NS {
            return;
        }
        // an earlier step may be pending if this one was refused at its rise
        if self.pending.is_some_and(|step| Some(step.rise_ns) == self.rise_ns) {
            self.pending = None;
            let kind = MisuseKind::StepPulseTooShort { high: true, lasted_ns, needed_ns: PULSE_NS };
            self.report(self.now_ns, kind);
        }
    }

    /// First rule that a step at the present time violates; `None` if it is valid.
    fn refusal(&self) -> Option<MisuseKind> {
        let Some(ready_ns) = self.ready_ns else { return Some(MisuseKind::StepWhileDisabled) };
        let lasted_ns = self.since(self.fall_ns);
        let setup_ns = self.since(self.direction_ns);
        if self.now_ns < ready_ns {
            let enabled_ns = ENABLE_NS.saturating_sub(ready_ns - self.now_ns);
            Some(MisuseKind::StepBeforeEnabled { enabled_ns, needed_ns: ENABLE_NS })
        } else if lasted_ns < PULSE_NS {
            Some(MisuseKind::StepPulseTooShort { high: false, lasted_ns, needed_ns: PULSE_NS })
        } else if setup_ns < DIRECTION_NS {
            Some(MisuseKind::DirectionSetupTooShort { setup_ns, needed_ns: DIRECTION_NS })
        } else {
            None
        }
    }

    fn since(&self, at_ns: Option<u64>) -> u64 {
        at_ns.map_or(u64::MAX, |at_ns| self.now_ns - at_ns)
    }

    // ---- rotor ----

    /// Takes a step that kept all rules.
    fn take(&mut self, step: Step) {
        let way = if step.forward { 1 } else { -1 };
        self.commanded = self.commanded.wrapping_add(way);
        if !self.rotor.stalled {
            self.follow(step);
        }
        if !self.rotor.stalled {
            self.position = self.position.wrapping_add(way);
        }
        self.rotor.last = Some(step);
    }

    /// Accelerates or decelerates the rotor, or finds that it cannot follow.
    fn follow(&mut self, step: Step) {
        let Some(last) = self.rotor.last else { return };
        let interval_s = (step.rise_ns - last.rise_ns) as f64 * 1e-9;
        let step_hz = 1.0 / interval_s;
        if last.forward != step.forward {
            // reversal only from a speed at which the rotor can stop
            if self.longest_interval_s().is_some() {
                self.stall(step.rise_ns, step_hz);
                return;
            }
            self.rotor.speed_hz = 0.0;
        }
        let change_hz = self.spec.acceleration_hz_s * interval_s;
        let reach_hz = self.spec.start_stop_hz + change_hz;
        let missing_hz = step_hz - self.rotor.speed_hz;
        // a slow step that came too late was detected when it rose
        if step_hz <= self.spec.start_stop_hz || missing_hz.abs() <= change_hz {
            self.rotor.speed_hz = step_hz;
        } else if missing_hz.abs() <= reach_hz {
            // speed differs from the rate of the steps by no more than the start-stop rate
            self.rotor.speed_hz += change_hz * missing_hz / reach_hz;
        } else {
            self.stall(step.rise_ns, step_hz);
        }
        self.rotor.step_hz = step_hz;
    }

    /// Stalls a rotor whose steps end too suddenly, and ends a stall after the pause. No step may be pending.
    fn look_for_end_of_steps(&mut self) {
        let Some(last) = self.rotor.last else { return };
        if !self.rotor.stalled
            && let Some(limit_s) = self.longest_interval_s()
        {
            let limit_ns = last.rise_ns.saturating_add((limit_s * 1e9).ceil() as u64);
            if self.now_ns > limit_ns {
                self.stall(limit_ns, 0.0);
            }
        }
        if self.rotor.stalled && self.now_ns - last.rise_ns >= REST_NS {
            self.rotor = Rotor::AT_REST;
        }
    }

    /// Longest interval to the next step for which the rotor can decelerate, s; `None` if it could also stop.
    ///
    /// An interval `t` is too long where `1 / t < speed - start_stop - acceleration * t`: from the smaller root on. In
    /// a ramp down the steps may already be slower than the rotor; then their rate counts as the speed.
    fn longest_interval_s(&self) -> Option<f64> {
        let acceleration_hz_s = self.spec.acceleration_hz_s;
        let excess_hz = self.rotor.speed_hz.min(self.rotor.step_hz) - self.spec.start_stop_hz;
        let root_squared = excess_hz * excess_hz - 4.0 * acceleration_hz_s;
        // in the form that avoids cancellation
        (excess_hz > 0.0 && root_squared > 0.0).then(|| 2.0 / (excess_hz + root_squared.sqrt()))
    }

    #[cold]
    fn stall(&mut self, at_ns: u64, step_hz: f64) {
        let rotor_hz = self.rotor.speed_hz.round() as u64;
        self.rotor.stalled = true;
        self.rotor.speed_hz = 0.0;
        self.report(at_ns, MisuseKind::StepperStalled { step_hz: step_hz.round() as u64, rotor_hz });
    }

    // ---- many steps at once ----

    /// True if a pulse at `at_ns` and those after it only need counting: equal to the one before, with the rotor at
    /// their speed.
    fn is_steady(&mut self, at_ns: u64, interval_ns: u64, high_ns: u64) -> bool {
        let low_ns = interval_ns.saturating_sub(high_ns);
        if at_ns < self.now_ns || high_ns < PULSE_NS || low_ns < PULSE_NS || interval_ns >= REST_NS {
            return false;
        }
        self.advance(at_ns);
        let before_ns = at_ns.saturating_sub(interval_ns);
        let as_before = !self.step_high
            && self.refusal().is_none()
            && self.rotor.last == Some(Step { rise_ns: before_ns, forward: self.forward })
            && self.rise_ns == Some(before_ns)
            && self.fall_ns == Some(before_ns.saturating_add(high_ns));
        let step_hz = 1.0 / (interval_ns as f64 * 1e-9);
        as_before && (self.rotor.stalled || (self.rotor.speed_hz == step_hz && self.rotor.step_hz == step_hz))
    }

    /// Takes `count` steady steps, the last rising at `rise_ns`.
    fn skip(&mut self, rise_ns: u64, count: u64, high_ns: u64) {
        let way = (count as i64).wrapping_mul(if self.forward { 1 } else { -1 });
        self.commanded = self.commanded.wrapping_add(way);
        if !self.rotor.stalled {
            self.position = self.position.wrapping_add(way);
        }
        self.rotor.last = Some(Step { rise_ns, forward: self.forward });
        self.rise_ns = Some(rise_ns);
        self.fall_ns = Some(rise_ns.saturating_add(high_ns));
        self.now_ns = rise_ns.saturating_add(high_ns);
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

    const MS_NS: u64 = 1_000_000;
    /// Shortest pulse and interval that the driver takes: 200 kHz.
    const HIGH_NS: u64 = 2_500;

    const SPEC: StepperDriverSpec =
        StepperDriverSpec { enabled_when_high: false, start_stop_hz: 1_000.0, acceleration_hz_s: 20_000.0 };

    fn driver() -> StepperDriver {
        StepperDriver::new(7, SPEC)
    }

    /// A driver with a motor that follows any rate, to test the driver alone.
    fn without_inertia() -> StepperDriver {
        StepperDriver::new(7, StepperDriverSpec { start_stop_hz: 1e9, ..SPEC })
    }

    fn pulse(driver: &mut StepperDriver, at_ns: u64) {
        driver.step(at_ns, true);
        driver.step(at_ns + HIGH_NS, false);
    }

    fn kinds(driver: &StepperDriver) -> Vec<MisuseKind> {
        driver.misuse().first().iter().map(|misuse| misuse.kind).collect()
    }

    /// Position long after the last step, and the reports.
    fn result(mut driver: StepperDriver) -> (i64, Vec<MisuseKind>) {
        driver.advance(u64::MAX);
        assert_eq!(driver.position(), driver.commanded());
        (driver.position(), kinds(&driver))
    }

    #[test]
    fn counts_rising_edges_in_the_direction_of_its_input() {
        let mut driver = without_inertia();
        for index in 0..5 {
            pulse(&mut driver, index * MS_NS);
        }
        driver.direction(6 * MS_NS, false);
        for index in 7..15 {
            pulse(&mut driver, index * MS_NS);
        }
        assert_eq!(result(driver), (-3, vec![]));
    }

    #[test]
    fn a_step_counts_when_it_can_no_longer_break_a_rule() {
        let mut driver = driver();
        driver.step(100, true);
        driver.advance(5_099);
        assert_eq!(driver.position(), 0);
        driver.advance(5_100);
        assert_eq!(driver.position(), 1);
    }

    #[test]
    fn high_time_has_a_limit() {
        for (lasted_ns, taken) in [(1, false), (2_499, false), (2_500, true), (10_000, true)] {
            let mut driver = driver();
            driver.step(0, true);
            driver.step(lasted_ns, false);
            let kind = MisuseKind::StepPulseTooShort { high: true, lasted_ns, needed_ns: 2_500 };
            assert_eq!(result(driver), if taken { (1, vec![]) } else { (0, vec![kind]) });
        }
    }

    #[test]
    fn low_time_has_a_limit() {
        for (lasted_ns, taken) in [(1, false), (2_499, false), (2_500, true)] {
            let mut driver = without_inertia();
            pulse(&mut driver, 0);
            pulse(&mut driver, HIGH_NS + lasted_ns);
            let kind = MisuseKind::StepPulseTooShort { high: false, lasted_ns, needed_ns: 2_500 };
            assert_eq!(result(driver), if taken { (2, vec![]) } else { (1, vec![kind]) });
        }
    }

    #[test]
    fn a_short_pulse_does_not_take_an_earlier_step_with_it() {
        let mut driver = driver();
        pulse(&mut driver, 0);
        driver.step(4_000, true);
        driver.step(4_100, false);
        let kind = MisuseKind::StepPulseTooShort { high: false, lasted_ns: 1_500, needed_ns: 2_500 };
        assert_eq!(result(driver), (1, vec![kind]));
    }

    #[test]
    fn runs_at_200_khz_and_no_faster() {
        for (interval_ns, taken) in [(5_000, 1_000), (4_999, 1)] {
            let mut driver = without_inertia();
            driver.pulses(0, interval_ns, 1_000, HIGH_NS);
            driver.advance(u64::MAX);
            // the first step of the faster train is valid, and the low time before each later one is too short
            assert_eq!((driver.position(), driver.misuse().total()), (taken, 1_000 - taken as u64));
        }
    }

    #[test]
    fn direction_has_a_set_up_time() {
        for (setup_ns, taken) in [(0, false), (4_999, false), (5_000, true)] {
            let mut driver = driver();
            driver.direction(MS_NS, false);
            pulse(&mut driver, MS_NS + setup_ns);
            let kind = MisuseKind::DirectionSetupTooShort { setup_ns, needed_ns: 5_000 };
            assert_eq!(result(driver), if taken { (-1, vec![]) } else { (0, vec![kind]) });
        }
    }

    #[test]
    fn direction_has_a_hold_time() {
        for (held_ns, taken) in [(0, false), (2_000, false), (4_999, false), (5_000, true)] {
            let mut driver = driver();
            driver.step(MS_NS, true);
            if held_ns > HIGH_NS {
                driver.step(MS_NS + HIGH_NS, false);
            }
            driver.direction(MS_NS + held_ns, false);
            driver.step(MS_NS + 6_000, false);
            let kind = MisuseKind::DirectionHoldTooShort { held_ns, needed_ns: 5_000 };
            assert_eq!(result(driver), if taken { (1, vec![]) } else { (0, vec![kind]) }, "{held_ns}");
        }
    }

    #[test]
    fn a_level_that_stays_is_no_edge() {
        let mut driver = driver();
        driver.step(0, true);
        driver.direction(1_000, true);
        driver.step(2_000, true);
        driver.enable(2_000, false);
        driver.step(2_500, false);
        assert_eq!(result(driver), (1, vec![]));
    }

    #[test]
    fn enable_needs_5_ms_in_both_polarities() {
        for enabled_when_high in [false, true] {
            for (enabled_ns, taken) in [(0, false), (4_999_999, false), (5_000_000, true)] {
                let mut driver = StepperDriver::new(7, StepperDriverSpec { enabled_when_high, ..SPEC });
                driver.enable(MS_NS, !enabled_when_high);
                assert!(!driver.is_enabled());
                driver.enable(3 * MS_NS, enabled_when_high);
                assert!(driver.is_enabled());
                pulse(&mut driver, 3 * MS_NS + enabled_ns);
                let kind = MisuseKind::StepBeforeEnabled { enabled_ns, needed_ns: 5_000_000 };
                assert_eq!(result(driver), if taken { (1, vec![]) } else { (0, vec![kind]) });
            }
        }
    }

    #[test]
    fn steps_while_disabled_or_without_supply_are_dropped_and_the_position_is_kept() {
        let off: [fn(&mut StepperDriver, bool); 2] =
            [|driver, off| driver.enable(10 * MS_NS, off), |driver, off| driver.supply(10 * MS_NS, !off)];
        for set_off in off {
            let mut driver = driver();
            pulse(&mut driver, 0);
            set_off(&mut driver, true);
            assert!(!driver.is_enabled());
            pulse(&mut driver, 20 * MS_NS);
            assert_eq!((driver.misuse().first()[0].address, driver.misuse().first()[0].time_ns), (7, 20 * MS_NS));
            assert_eq!(result(driver), (1, vec![MisuseKind::StepWhileDisabled]));
        }
        // both are required
        let mut driver = driver();
        driver.enable(0, true);
        driver.supply(0, false);
        driver.supply(1, true);
        assert!(!driver.is_enabled());
        driver.enable(2, false);
        assert!(driver.is_enabled());
    }

    #[test]
    fn starts_and_stops_at_once_up_to_the_start_stop_rate() {
        // in the first interval the rotor gains a / f: 1000 Hz + 20 000 / 1019 Hz = 1019.6 Hz is the limit
        for (step_hz, stalls) in [(100, false), (1_000, false), (1_019, false), (1_021, true), (100_000, true)] {
            let mut driver = driver();
            driver.pulses(0, 1_000_000_000 / step_hz, 200, HIGH_NS);
            driver.advance(driver.now_ns + MS_NS);
            assert_eq!(driver.is_stalled(), stalls, "{step_hz}");
            driver.advance(u64::MAX);
            let kind = MisuseKind::StepperStalled { step_hz, rotor_hz: 0 };
            assert_eq!(kinds(&driver), if stalls { vec![kind] } else { vec![] });
            assert_eq!((driver.position(), driver.commanded()), (if stalls { 1 } else { 200 }, 200));
        }
    }

    /// Sends steps that change linearly from one rate to another, and returns the time of the step that would follow.
    fn ramp(driver: &mut StepperDriver, from_ns: u64, from_hz: f64, to_hz: f64, acceleration_hz_s: f64) -> u64 {
        let mut at_ns = from_ns;
        let mut step_hz = from_hz;
        while (step_hz - from_hz).abs() < (to_hz - from_hz).abs() {
            pulse(driver, at_ns);
            at_ns += (1e9 / step_hz) as u64;
            step_hz += (acceleration_hz_s / step_hz).copysign(to_hz - from_hz);
        }
        at_ns
    }

    #[test]
    fn follows_ramps_up_to_its_acceleration() {
        // the rounding of intervals to a nanosecond is 10 Hz at 100 kHz, 1 % of the start-stop rate
        for (up, down, stalls) in [(0.97, 0.97, false), (0.1, 0.97, false), (1.03, 0.97, true), (0.97, 1.03, true)] {
            let mut driver = driver();
            let acceleration_hz_s = SPEC.acceleration_hz_s;
            let mut at_ns = ramp(&mut driver, 0, 1_000.0, 100_000.0, up * acceleration_hz_s);
            driver.pulses(at_ns, 10_000, 100_000, HIGH_NS);
            at_ns += 10_000 * 100_000;
            ramp(&mut driver, at_ns, 100_000.0, 1_000.0, down * acceleration_hz_s);
            driver.advance(u64::MAX);
            let stalled = kinds(&driver).iter().any(|kind| matches!(kind, MisuseKind::StepperStalled { .. }));
            assert_eq!(stalled, stalls, "{up} {down}");
            assert_eq!(driver.position() != driver.commanded(), stalls);
        }
    }

    #[test]
    fn a_sudden_end_of_steps_is_a_stall_even_if_none_follows() {
        for (step_hz, stalls) in [(1_000.0, false), (1_200.0, false), (2_000.0, true), (10_000.0, true)] {
            let mut driver = driver();
            let at_ns = ramp(&mut driver, 0, 500.0, step_hz, 5_000.0);
            driver.pulses(at_ns, (1e9 / step_hz) as u64, 1_000, HIGH_NS);
            driver.advance(u64::MAX);
            // at 1200 Hz the rotor is below 1000 Hz before it needs the next step: (f - 1000 Hz)^2 < 4 a
            let kind = MisuseKind::StepperStalled { step_hz: 0, rotor_hz: step_hz as u64 };
            assert_eq!(kinds(&driver), if stalls { vec![kind] } else { vec![] });
            assert_eq!(driver.position(), driver.commanded());
        }
    }

    #[test]
    fn a_stalled_rotor_follows_again_after_a_pause_of_50_ms() {
        for (pause_ns, follows) in [(49_999_999, false), (50_000_000, true)] {
            let mut driver = driver();
            driver.pulses(0, 100_000, 2, HIGH_NS);
            assert_eq!((driver.position(), driver.commanded()), (1, 1));
            driver.advance(MS_NS);
            assert!(driver.is_stalled());
            pulse(&mut driver, 100_000 + pause_ns);
            driver.advance(pause_ns + MS_NS);
            assert_eq!((driver.is_stalled(), driver.commanded()), (!follows, 3));
            assert_eq!(driver.position(), if follows { 2 } else { 1 });
        }
    }

    #[test]
    fn reverses_at_once_up_to_the_start_stop_rate() {
        for (step_hz, stalls) in [(1_000.0, false), (1_500.0, true)] {
            let mut driver = driver();
            let mut at_ns = ramp(&mut driver, 0, 500.0, step_hz, 5_000.0);
            let interval_ns = (1e9 / step_hz) as u64;
            driver.pulses(at_ns, interval_ns, 1_000, HIGH_NS);
            at_ns += interval_ns * 1_000;
            driver.direction(at_ns - 100_000, false);
            driver.pulses(at_ns, interval_ns, 1_000, HIGH_NS);
            driver.advance(u64::MAX);
            assert_eq!(!kinds(&driver).is_empty(), stalls, "{step_hz}");
        }
    }

    #[test]
    fn jitter_of_the_step_timer_is_no_stall() {
        // 1 us at 100 kHz is 10 kHz up and down, within a start-stop rate of 12 kHz
        let spec = StepperDriverSpec { start_stop_hz: 12_000.0, acceleration_hz_s: 200_000.0, ..SPEC };
        let mut driver = StepperDriver::new(0, spec);
        let mut at_ns = ramp(&mut driver, 0, 12_000.0, 100_000.0, 150_000.0);
        driver.pulses(at_ns, 10_000, 50_000, HIGH_NS);
        at_ns += 50_000 * 10_000;
        for index in 0..10_000 {
            pulse(&mut driver, at_ns);
            at_ns += if index % 2 == 0 { 9_000 } else { 11_000 };
        }
        assert!(driver.misuse().is_empty(), "{:?}", driver.misuse().first());
    }

    #[test]
    fn a_long_batch_is_not_walked_through() {
        let mut driver = driver();
        // a year and a half at 20 kHz would take hours step by step
        let at_ns = ramp(&mut driver, 0, 1_000.0, 20_000.0, 10_000.0);
        driver.advance(at_ns);
        let before = driver.commanded();
        driver.pulses(at_ns, 50_000, 1_000_000_000_000, HIGH_NS);
        driver.advance(driver.now_ns + 10_000);
        assert_eq!(driver.position(), before + 1_000_000_000_000);
    }

    #[derive(Clone, Copy, Debug)]
    enum Call {
        Step(bool),
        Direction(bool),
        Enable(bool),
        Supply(bool),
        Pulses { interval_ns: u64, count: u64, high_ns: u64 },
    }

    fn any_call() -> impl Strategy<Value = Call> {
        let interval_ns = prop_oneof![Just(5_000u64), Just(10_000), 4_000..20_000u64, 20_000..60_000_000u64];
        let high_ns = prop_oneof![8 => Just(HIGH_NS), 1 => 2_000..20_000u64];
        let pulses = (interval_ns, 0..300u64, high_ns).prop_map(|(interval_ns, count, high_ns)| Call::Pulses {
            interval_ns,
            count,
            high_ns,
        });
        prop_oneof![
            2 => any::<bool>().prop_map(Call::Step),
            2 => any::<bool>().prop_map(Call::Direction),
            1 => prop::bool::weighted(0.2).prop_map(Call::Enable),
            1 => prop::bool::weighted(0.8).prop_map(Call::Supply),
            6 => pulses,
        ]
    }

    /// Waiting times around all limits, and `None` for the continuation of a train of pulses at its own interval.
    fn any_wait() -> impl Strategy<Value = Option<u64>> {
        prop_oneof![
            Just(None),
            (0..12_000u64).prop_map(Some),
            (0..8 * MS_NS).prop_map(Some),
            (0..80 * MS_NS).prop_map(Some),
        ]
    }

    fn any_motor() -> impl Strategy<Value = StepperDriver> {
        prop_oneof![
            Just(driver()),
            Just(without_inertia()),
            (50.0..50_000.0f64, 100.0..1e7f64).prop_map(|(start_stop_hz, acceleration_hz_s)| {
                StepperDriver::new(7, StepperDriverSpec { start_stop_hz, acceleration_hz_s, ..SPEC })
            }),
        ]
    }

    /// Makes a call `wait_ns` after the end of the one before, and returns the time of its end.
    fn make(driver: &mut StepperDriver, at_ns: u64, call: Call, single: bool) -> u64 {
        match call {
            Call::Step(high) => driver.step(at_ns, high),
            Call::Direction(high) => driver.direction(at_ns, high),
            Call::Enable(high) => driver.enable(at_ns, high),
            Call::Supply(on) => driver.supply(at_ns, on),
            Call::Pulses { interval_ns, count, high_ns } => {
                if single {
                    for index in 0..count {
                        driver.step(at_ns + index * interval_ns, true);
                        driver.step(at_ns + index * interval_ns + high_ns, false);
                    }
                } else {
                    driver.pulses(at_ns, interval_ns, count, high_ns);
                }
                return at_ns + count * interval_ns;
            }
        }
        at_ns
    }

    proptest! {
        #[test]
        fn a_batch_equals_its_single_edges(
            motor in any_motor(), calls in prop::collection::vec((any_wait(), any_call()), 1..12),
        ) {
            let [mut batch, mut single] = [motor.clone(), motor];
            let mut at_ns = 0;
            for (wait_ns, call) in calls {
                at_ns += wait_ns.unwrap_or(0);
                make(&mut single, at_ns, call, true);
                at_ns = make(&mut batch, at_ns, call, false);
                // to the bit, including reports
                prop_assert_eq!(&batch, &single);
            }
        }

        #[test]
        fn looking_often_changes_nothing(
            motor in any_motor(),
            calls in prop::collection::vec((any_wait(), any_call(), 1..10u64), 1..12),
        ) {
            let [mut lazy, mut eager] = [motor.clone(), motor];
            let mut at_ns = 0;
            for (wait_ns, call, looks) in calls {
                let wait_ns = wait_ns.unwrap_or(0);
                for look in 0..looks {
                    eager.advance(at_ns + wait_ns * look / looks);
                }
                at_ns += wait_ns;
                make(&mut eager, at_ns, call, true);
                at_ns = make(&mut lazy, at_ns, call, true);
            }
            lazy.advance(at_ns + 100 * MS_NS);
            eager.advance(at_ns + 100 * MS_NS);
            prop_assert_eq!(lazy, eager);
        }

        #[test]
        fn every_step_is_counted_or_reported(
            calls in prop::collection::vec((any_wait(), any_call()), 1..12),
        ) {
            let mut driver = without_inertia();
            let (mut at_ns, mut rises, mut forward_only) = (0, 0, true);
            for (wait_ns, call) in calls {
                at_ns += wait_ns.unwrap_or(0).max(5_000);
                let was_high = driver.step_high;
                rises += match call {
                    Call::Step(high) => u64::from(high && !was_high),
                    Call::Pulses { interval_ns, count, high_ns } if high_ns < interval_ns =>
                        count - u64::from(was_high && count > 0),
                    Call::Pulses { .. } => break,
                    _ => 0,
                };
                forward_only &= !matches!(call, Call::Direction(false));
                at_ns = make(&mut driver, at_ns, call, false);
            }
            driver.advance(at_ns + MS_NS);
            if forward_only {
                prop_assert_eq!(driver.position() as u64 + driver.misuse().total(), rises);
            }
        }

        #[test]
        fn never_panics(
            start_stop_hz: f64, acceleration_hz_s: f64,
            calls in prop::collection::vec((any::<u64>(), 0..6u8, any::<bool>(), any::<[u64; 2]>(), 0..50u64), 0..30),
        ) {
            let spec = StepperDriverSpec { enabled_when_high: true, start_stop_hz, acceleration_hz_s };
            let mut driver = StepperDriver::new(0, spec);
            for (at_ns, call, high, [interval_ns, high_ns], count) in calls {
                match call {
                    0 => driver.step(at_ns, high),
                    1 => driver.direction(at_ns, high),
                    2 => driver.enable(at_ns, high),
                    3 => driver.supply(at_ns, high),
                    4 => driver.pulses(at_ns, interval_ns, count, high_ns),
                    _ => driver.pulses(at_ns, interval_ns % 100_000, count, high_ns % 10_000),
                }
            }
        }
    }
}
