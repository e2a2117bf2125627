//! Drive of a brushless motor with an analog throttle, a direction line and a brake line.
//!
//! # Throttle
//! In the dead zone the motor coasts. Above it the commanded speed rises linearly to full speed at `forward_v`. Below
//! it a drive that reverses by voltage does the same in the other direction; one that reverses by its line coasts.
//!
//! #  Behaviour, by the first row that applies
//! | when | motor |
//! | --- | --- |
//! | no supply | coasts; the drive is locked when supply returns |
//! | brake line | slows down evenly, then stands |
//! | locked: no dead zone seen since supply came, or since the throttle left what it tolerates | coasts |
//! | throttle in the dead zone | coasts |
//! | turning against the wanted direction | coasts to a standstill first |
//! | otherwise | speed approaches the commanded one with the drive's time constant |
//!
//! A four-quadrant drive ([`BldcDriveSpec::four_quadrant`]) also brakes and holds with its motor: it follows its
//! throttle through the dead zone, where it commands a standstill, and through a change of direction.
//!
//! # Loaded shafts
//! With a [`Rotor`] the motor has an inertia, limits of torque and power, and takes a load ([`BldcDrive::set_load`]).
//! The speed loop is proportional: the torque is `inertia / time constant` times the speed error, up to the limits.
//! Without a load the speed approaches the commanded one with the time constant, and under a load it has a steady
//! error.
//!
//! # Modelling choices
//! - The lock: drives of vehicles refuse to start with the throttle open. No source states it for a particular drive.
//! - The brake works even if no dead zone was seen, but not without supply.
//! - A coasting motor loses speed with a time constant of its own, and stands below 1 % of top speed.
//!
//! # Time
//! Between changes speed and position have closed forms, so the frequency of queries does not change the result. A
//! motor with a [`Rotor`] is stepped instead, in steps of at most 0.25 ms: exact under a constant load, except in a
//! step in which it reaches or leaves a limit.
//!
//! Not modelled: current, commutation, torque ripple, braking resistors and heat.

use crate::chips::mcp23017::PinState;
use crate::misuse::{Misuse, MisuseKind, MisuseLog};

/// Share of top speed below which a coasting motor stands.
const STANDSTILL: f64 = 0.01;
/// Longest step of a motor with a [`Rotor`], ns: that of a body, which holds loads for as long.
const STEP_NS: u64 = 250_000;

/// Method by which a drive reverses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Reverse {
    /// Reverses while its direction line has this level.
    ByLine {
        /// Level of the line for backwards.
        when_high: bool,
    },
    /// Reverses with a throttle below the dead zone; the direction line has no effect.
    ByVoltage {
        /// Throttle for full speed backwards, V.
        full_v: f64,
    },
}

/// Parameters of a drive and its motor. All numbers are finite, times and speeds above 0, pairs in rising order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BldcDriveSpec {
    /// Throttle range in which the motor rests, V, ends included.
    pub dead_zone_v: [f64; 2],
    /// Throttle for full speed forwards, above the dead zone, V.
    pub forward_v: f64,
    /// Method by which it turns backwards.
    pub reverse: Reverse,
    /// Throttle range that the drive tolerates, V, ends included.
    pub tolerated_v: [f64; 2],
    /// Level of a direction line that is not driven.
    pub direction_pull: bool,
    /// Level of a brake line that is not driven.
    pub brake_pull: bool,
    /// Active level of the brake line.
    pub brake_when_high: bool,
    /// Full speed of the motor, rad/s.
    pub top_speed_rad_s: f64,
    /// Time constant of the approach to a commanded speed, s.
    pub time_constant_s: f64,
    /// Time constant of a coasting motor, s.
    pub coast_time_constant_s: f64,
    /// Deceleration of the brake for a motor without a rotor, rad/s².
    pub brake_rad_s2: f64,
    /// True for a drive that brakes and holds with its motor instead of coasting in the dead zone and before a
    /// reversal.
    pub four_quadrant: bool,
    /// Inertia and limits of a motor that takes loads; `None` for one that turns as its drive commands.
    pub rotor: Option<Rotor>,
}

/// Inertia of a motor and the limits of its drive. All are above 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rotor {
    /// Moment of inertia of the motor and everything that turns with it, kg m².
    pub inertia_kg_m2: f64,
    /// Highest torque of the drive, in both directions, N m.
    pub torque_max_nm: f64,
    /// Highest mechanical power that the drive delivers, W; may be infinite. Power returned by the motor is limited by
    /// torque alone.
    pub power_max_w: f64,
    /// Friction torque of the brake, N m, which also holds at rest.
    pub brake_nm: f64,
}

impl BldcDriveSpec {
    /// Commanded speed as a share of the top speed, -1 to 1; 0 in the dead zone.
    fn command(&self, throttle_v: f64) -> f64 {
        let [low_v, high_v] = self.dead_zone_v;
        if throttle_v > high_v {
            ((throttle_v - high_v) / (self.forward_v - high_v)).min(1.0)
        } else if throttle_v < low_v {
            match self.reverse {
                Reverse::ByLine { .. } => 0.0,
                Reverse::ByVoltage { full_v } => -((low_v - throttle_v) / (low_v - full_v)).min(1.0),
            }
        } else {
            0.0
        }
    }
}

/// Inputs of a drive.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BldcInputs {
    /// Voltage of the throttle input, V.
    pub throttle_v: f64,
    /// Level of the direction input. A weak pull-up of the driving chip counts as high.
    pub direction: PinState,
    /// Level of the brake input.
    pub brake: PinState,
    /// True while the drive has its supply.
    pub supplied: bool,
}

const fn level(pin: PinState, pull: bool) -> bool {
    match pin {
        PinState::Driven(high) => high,
        PinState::PulledUp => true,
        PinState::Floating => pull,
    }
}

/// Mode of the motor since the last change.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Mode {
    Coast,
    Brake,
    Drive { target_rad_s: f64 },
}

/// State of the motion at one time, from which it is extrapolated.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Anchor {
    at_ns: u64,
    position_rad: f64,
    speed_rad_s: f64,
}

/// One drive with its motor.
#[derive(Clone, Debug, PartialEq)]
pub struct BldcDrive {
    number: u8,
    spec: BldcDriveSpec,
    inputs: BldcInputs,
    now_ns: u64,
    anchor: Anchor,
    mode: Mode,
    /// True once the dead zone was seen after the drive was locked.
    ready: bool,
    /// True while the throttle is outside the tolerated range, so that it is reported once.
    out_of_window: bool,
    /// Commanded direction: -1 or 1.
    direction: f64,
    /// External torque on the shaft, N m, towards positive positions. No effect on a motor without a rotor.
    load_nm: f64,
    /// Mean torque of drive and brake over the last step, N m.
    torque_nm: f64,
    misuse: MisuseLog,
}

impl BldcDrive {
    /// Name of the drive in reports.
    pub const NAME: &str = "BLDC drive";

    /// A drive without supply at rest at position 0, its throttle in the dead zone and its lines not driven; `number`
    /// identifies it in reports.
    #[must_use]
    pub fn new(number: u8, spec: BldcDriveSpec) -> Self {
        let inputs = BldcInputs {
            throttle_v: spec.dead_zone_v[0],
            direction: PinState::Floating,
            brake: PinState::Floating,
            supplied: false,
        };
        let mut drive = Self {
            number,
            spec,
            inputs,
            now_ns: 0,
            anchor: Anchor { at_ns: 0, position_rad: 0.0, speed_rad_s: 0.0 },
            mode: Mode::Coast,
            ready: false,
            out_of_window: false,
            direction: 1.0,
            load_nm: 0.0,
            torque_nm: 0.0,
            misuse: MisuseLog::new(),
        };
        drive.direction = drive.wanted_direction();
        drive
    }

    /// Sets the inputs from `at_ns` on. Cheap while they do not change.
    pub fn update(&mut self, at_ns: u64, inputs: &BldcInputs) {
        self.advance(at_ns);
        if *inputs == self.inputs {
            return;
        }
        let supply_came = inputs.supplied && !self.inputs.supplied;
        self.inputs = *inputs;
        self.re_anchor();
        self.look_at_throttle(supply_came);
        self.look_at_direction();
        self.mode = self.wanted_mode();
    }

    /// Advances the motor to `to_ns`; an earlier time than one already seen counts as that one.
    pub fn advance(&mut self, to_ns: u64) {
        let to_ns = to_ns.max(self.now_ns);
        if let Some(rotor) = self.spec.rotor {
            while self.now_ns < to_ns {
                let step_ns = (to_ns - self.now_ns).min(STEP_NS);
                self.turn(&rotor, step_ns as f64 * 1e-9);
                self.now_ns += step_ns;
                self.anchor.at_ns = self.now_ns;
                // a drive that coasts to a standstill before a reversal may have reached it
                self.mode = self.wanted_mode();
            }
            return;
        }
        if let Some(standstill_ns) = self.standstill_ns().filter(|&at_ns| at_ns <= to_ns) {
            self.now_ns = standstill_ns;
            self.re_anchor();
            self.anchor.speed_rad_s = 0.0;
            self.mode = self.wanted_mode();
        }
        self.now_ns = to_ns;
    }

    /// Speed of the motor at the last call with a time, rad/s; positive is forwards.
    #[must_use]
    pub fn speed_rad_s(&self) -> f64 {
        self.motion().1
    }

    /// Angle of the shaft at the last call with a time, rad.
    #[must_use]
    pub fn position_rad(&self) -> f64 {
        self.motion().0
    }

    /// Sets the torque with which something outside pushes the shaft from now on, N m, towards positive positions. One
    /// that is not finite is ignored.
    pub fn set_load(&mut self, load_nm: f64) {
        if load_nm.is_finite() {
            self.load_nm = load_nm;
        }
    }

    /// Torque of drive and brake on the shaft, N m, mean of the last step of at most 0.25 ms; 0 without a [`Rotor`].
    #[must_use]
    pub const fn torque_nm(&self) -> f64 {
        self.torque_nm
    }

    /// Parameters of the drive and its motor.
    #[must_use]
    pub const fn spec(&self) -> &BldcDriveSpec {
        &self.spec
    }

    /// True while only friction and loads act on the motor.
    #[must_use]
    pub const fn is_coasting(&self) -> bool {
        matches!(self.mode, Mode::Coast)
    }

    /// True while the drive follows its throttle: the supply is on, and the dead zone has been seen since.
    #[must_use]
    pub const fn is_ready(&self) -> bool {
        self.ready
    }

    /// True while the drive brakes.
    #[must_use]
    pub const fn is_braking(&self) -> bool {
        matches!(self.mode, Mode::Brake)
    }

    /// Inputs so far that the drive ignores or that damage it.
    #[must_use]
    pub const fn misuse(&self) -> &MisuseLog {
        &self.misuse
    }

    /// Misuses so far, mutable, so that a test can clear them.
    pub const fn misuse_mut(&mut self) -> &mut MisuseLog {
        &mut self.misuse
    }

    /// Locks and unlocks the drive by its throttle.
    fn look_at_throttle(&mut self, supply_came: bool) {
        let throttle_v = self.inputs.throttle_v;
        let [low_v, high_v] = self.spec.tolerated_v;
        // written so that NaN is outside
        let out_of_window = !(low_v <= throttle_v && throttle_v <= high_v);
        if out_of_window && !self.out_of_window {
            let throttle_mv = (!throttle_v.is_nan()).then(|| milli(throttle_v));
            let (low_mv, high_mv) = (milli(low_v), milli(high_v));
            self.report(MisuseKind::ThrottleOutsideWindow { throttle_mv, low_mv, high_mv });
        }
        self.out_of_window = out_of_window;
        if !self.inputs.supplied || out_of_window {
            self.ready = false;
        } else if self.spec.command(throttle_v) == 0.0 {
            self.ready = true;
        } else if supply_came {
            self.report(MisuseKind::ThrottleBeforeNeutral { throttle_mv: milli(throttle_v) });
        }
    }

    /// Follows the direction input. Without supply it is not sampled; a change made then takes effect when supply
    /// returns.
    fn look_at_direction(&mut self) {
        if !self.inputs.supplied {
            return;
        }
        let wanted = self.wanted_direction();
        if wanted != self.direction && self.turns_against(wanted) && !self.spec.four_quadrant {
            let speed_mrad_s = milli(self.anchor.speed_rad_s);
            self.report(MisuseKind::DirectionChangedWhileTurning { speed_mrad_s });
        }
        self.direction = wanted;
    }

    /// Commanded direction; by voltage, the last one requested outside the dead zone.
    fn wanted_direction(&self) -> f64 {
        let backwards = match self.spec.reverse {
            Reverse::ByLine { when_high } => level(self.inputs.direction, self.spec.direction_pull) == when_high,
            Reverse::ByVoltage { .. } => {
                let command = self.spec.command(self.inputs.throttle_v);
                command < 0.0 || (command == 0.0 && self.direction < 0.0)
            }
        };
        if backwards { -1.0 } else { 1.0 }
    }

    /// Mode by the table of the module, for the speed at the anchor.
    fn wanted_mode(&self) -> Mode {
        let share = self.spec.command(self.inputs.throttle_v).abs();
        if !self.inputs.supplied {
            Mode::Coast
        } else if level(self.inputs.brake, self.spec.brake_pull) == self.spec.brake_when_high {
            Mode::Brake
        } else if !self.ready || !self.spec.four_quadrant && (share == 0.0 || self.turns_against(self.direction)) {
            Mode::Coast
        } else {
            Mode::Drive { target_rad_s: share * self.direction * self.spec.top_speed_rad_s }
        }
    }

    fn turns_against(&self, direction: f64) -> bool {
        self.anchor.speed_rad_s * direction < -self.standstill_rad_s()
    }

    fn standstill_rad_s(&self) -> f64 {
        STANDSTILL * self.spec.top_speed_rad_s
    }

    /// Time at which a coasting motor reaches a standstill, ns; `None` if it stands or does not coast.
    fn standstill_ns(&self) -> Option<u64> {
        let speed_rad_s = self.anchor.speed_rad_s.abs();
        if self.mode != Mode::Coast || speed_rad_s == 0.0 {
            return None;
        }
        let ratio = speed_rad_s / self.standstill_rad_s();
        let after_ns = (self.spec.coast_time_constant_s * ratio.ln() * 1e9).ceil() as u64;
        Some(self.anchor.at_ns.saturating_add(after_ns))
    }

    /// Advances a motor with a rotor by `step_s`.
    fn turn(&mut self, rotor: &Rotor, step_s: f64) {
        let Anchor { position_rad, speed_rad_s, .. } = self.anchor;
        let Rotor { inertia_kg_m2, torque_max_nm, power_max_w, brake_nm } = *rotor;
        let load_rad_s2 = self.load_nm / inertia_kg_m2;
        // exact for a torque proportional to the speed error, under a constant load
        let towards = |target_rad_s: f64, time_constant_s: f64| {
            let gone = -(-step_s / time_constant_s).exp_m1();
            let missing_rad_s = target_rad_s + load_rad_s2 * time_constant_s - speed_rad_s;
            (
                missing_rad_s * (step_s - time_constant_s * gone) + speed_rad_s * step_s,
                speed_rad_s + missing_rad_s * gone,
            )
        };
        let pushed = |torque_nm: f64| {
            let change_rad_s = (torque_nm / inertia_kg_m2 + load_rad_s2) * step_s;
            ((speed_rad_s + 0.5 * change_rad_s) * step_s, speed_rad_s + change_rad_s)
        };
        let torque_for = |next_rad_s: f64| (next_rad_s - speed_rad_s) / step_s * inertia_kg_m2 - self.load_nm;
        let (way_rad, next_rad_s) = match self.mode {
            Mode::Coast => towards(0.0, self.spec.coast_time_constant_s),
            Mode::Drive { target_rad_s } => {
                let (way_rad, next_rad_s) = towards(target_rad_s, self.spec.time_constant_s);
                let torque_nm = torque_for(next_rad_s);
                let reached_rad_s = pushed(torque_max_nm.copysign(torque_nm)).1;
                // highest speed of the step, so that power stays within its limit all through it
                let fastest_rad_s = speed_rad_s.abs().max(reached_rad_s.abs().min(next_rad_s.abs()));
                let gives = torque_nm * speed_rad_s > 0.0 || torque_nm * next_rad_s > 0.0;
                // no limit of power for a motor that decelerates
                let most_nm = if gives { torque_max_nm.min(power_max_w / fastest_rad_s) } else { torque_max_nm };
                if torque_nm.abs() <= most_nm { (way_rad, next_rad_s) } else { pushed(most_nm.copysign(torque_nm)) }
            }
            // dry friction holds at a standstill, up to its torque
            Mode::Brake if speed_rad_s == 0.0 && self.load_nm.abs() <= brake_nm => (0.0, 0.0),
            Mode::Brake => {
                let moves = if speed_rad_s == 0.0 { self.load_nm } else { speed_rad_s };
                let (way_rad, next_rad_s) = pushed(-brake_nm.copysign(moves));
                if next_rad_s * speed_rad_s < 0.0 {
                    // standstill within the step: friction does not reverse the rotor
                    let stopped_s = step_s * speed_rad_s / (speed_rad_s - next_rad_s);
                    (0.5 * speed_rad_s * stopped_s, 0.0)
                } else {
                    (way_rad, next_rad_s)
                }
            }
        };
        self.torque_nm = match self.mode {
            Mode::Coast => 0.0,
            Mode::Brake | Mode::Drive { .. } => torque_for(next_rad_s),
        };
        self.anchor.position_rad = position_rad + way_rad;
        self.anchor.speed_rad_s = next_rad_s;
    }

    /// Position, rad, and speed, rad/s, at the present time.
    fn motion(&self) -> (f64, f64) {
        let Anchor { at_ns, position_rad, speed_rad_s } = self.anchor;
        if self.spec.rotor.is_some() {
            return (position_rad, speed_rad_s);
        }
        let elapsed_s = (self.now_ns - at_ns) as f64 * 1e-9;
        let towards = |target_rad_s: f64, time_constant_s: f64| {
            let gone = -(-elapsed_s / time_constant_s).exp_m1();
            let missing_rad_s = target_rad_s - speed_rad_s;
            let way_rad = target_rad_s * elapsed_s - missing_rad_s * time_constant_s * gone;
            (position_rad + way_rad, speed_rad_s + missing_rad_s * gone)
        };
        match self.mode {
            Mode::Coast => towards(0.0, self.spec.coast_time_constant_s),
            Mode::Drive { target_rad_s } => towards(target_rad_s, self.spec.time_constant_s),
            Mode::Brake => {
                let brake_rad_s2 = self.spec.brake_rad_s2.copysign(speed_rad_s);
                let braked_s = elapsed_s.min(speed_rad_s / brake_rad_s2);
                let way_rad = (speed_rad_s - 0.5 * brake_rad_s2 * braked_s) * braked_s;
                let left_rad_s = if braked_s < elapsed_s { 0.0 } else { speed_rad_s - brake_rad_s2 * braked_s };
                (position_rad + way_rad, left_rad_s)
            }
        }
    }

    fn re_anchor(&mut self) {
        let (position_rad, speed_rad_s) = self.motion();
        self.anchor = Anchor { at_ns: self.now_ns, position_rad, speed_rad_s };
    }

    #[cold]
    fn report(&mut self, kind: MisuseKind) {
        self.misuse.report(Misuse { time_ns: self.now_ns, chip: Self::NAME, address: self.number, kind });
    }
}

fn milli(value: f64) -> i64 {
    (value * 1e3).round() as i64
}

#[cfg(test)]
mod tests {
    use super::*;
    use PinState::{Driven, Floating, PulledUp};
    use proptest::prelude::*;

    const SECOND_NS: u64 = 1_000_000_000;

    /// Donor controller of OpenPodCar: 0 V fast reverse, 5 V fast forward, dead zone 1.92 V to 2.71 V. It tolerates
    /// codes 1000 to 2519 of 4095 at 5 V. The dynamics are synthetic.
    const BY_VOLTAGE: BldcDriveSpec = BldcDriveSpec {
        dead_zone_v: [1.92, 2.71],
        forward_v: 5.0,
        reverse: Reverse::ByVoltage { full_v: 0.0 },
        tolerated_v: [1.22, 3.08],
        direction_pull: false,
        brake_pull: false,
        brake_when_high: true,
        top_speed_rad_s: 20.0,
        time_constant_s: 0.5,
        coast_time_constant_s: 2.0,
        brake_rad_s2: 10.0,
        four_quadrant: false,
        rotor: None,
    };

    const BY_LINE: BldcDriveSpec = BldcDriveSpec {
        dead_zone_v: [0.0, 1.0],
        forward_v: 5.0,
        reverse: Reverse::ByLine { when_high: true },
        tolerated_v: [0.0, 5.0],
        ..BY_VOLTAGE
    };

    const REST: BldcInputs =
        BldcInputs { throttle_v: 1.0, direction: Driven(false), brake: Driven(false), supplied: true };
    const FULL: BldcInputs = BldcInputs { throttle_v: 5.0, ..REST };
    const BACKWARDS: BldcInputs = BldcInputs { direction: Driven(true), ..FULL };
    const BRAKED: BldcInputs = BldcInputs { brake: Driven(true), ..FULL };

    /// A drive that reverses by its line and follows its throttle, with `inputs` from time 0 on.
    fn ready(inputs: BldcInputs) -> BldcDrive {
        let mut drive = BldcDrive::new(3, BY_LINE);
        drive.update(0, &REST);
        drive.update(0, &inputs);
        drive
    }

    fn kinds(drive: &BldcDrive) -> Vec<MisuseKind> {
        drive.misuse().first().iter().map(|misuse| misuse.kind).collect()
    }

    #[test]
    fn command_is_straight_outside_the_dead_zone() {
        for (throttle_v, by_voltage, by_line) in [
            (-1.0, -1.0, 0.0),
            (0.0, -1.0, 0.0),
            (0.96, -0.5, 0.0),
            (1.92, 0.0, 0.23),
            (2.05, 0.0, 0.2625),
            (2.71, 0.0, 0.4275),
            (3.855, 0.5, 0.71375),
            (5.0, 1.0, 1.0),
            (6.0, 1.0, 1.0),
        ] {
            // 1e-12 is rounding
            assert!((BY_VOLTAGE.command(throttle_v) - by_voltage).abs() < 1e-12, "{throttle_v}");
            assert!((BY_LINE.command(throttle_v) - by_line).abs() < 1e-12, "{throttle_v}");
        }
        assert_eq!((BY_LINE.command(1.0), BY_LINE.command(1.0 + 1e-9) > 0.0), (0.0, true));
        assert_eq!((BY_VOLTAGE.command(1.92), BY_VOLTAGE.command(1.92 - 1e-9) < 0.0), (0.0, true));
    }

    #[test]
    fn speed_and_position_follow_the_closed_form() {
        let mut drive = ready(FULL);
        drive.advance(SECOND_NS);
        // w = W (1 - e^(-t/T)), x = W (t - T (1 - e^(-t/T))) with W = 20, T = 0.5, t = 1; 1e-12 is rounding
        let gone = 1.0 - (-2.0f64).exp();
        assert!((drive.speed_rad_s() - 20.0 * gone).abs() < 1e-12);
        assert!((drive.position_rad() - 20.0 * (1.0 - 0.5 * gone)).abs() < 1e-12);
        assert!(drive.misuse().is_empty());
    }

    #[test]
    fn table_of_what_the_drive_does() {
        let turning = |inputs: BldcInputs| {
            let mut drive = ready(FULL);
            drive.update(10 * SECOND_NS, &inputs);
            drive.advance(11 * SECOND_NS);
            drive.speed_rad_s()
        };
        let coasted = 20.0 * (-0.5f64).exp();
        for (inputs, expected_rad_s) in [
            (FULL, 20.0),
            (BldcInputs { throttle_v: 1.0, ..FULL }, coasted),
            (BRAKED, 10.0),
            // the brake has priority
            (BldcInputs { throttle_v: 1.0, ..BRAKED }, 10.0),
            (BldcInputs { direction: Driven(true), ..BRAKED }, 10.0),
            (BldcInputs { throttle_v: 9.0, ..BRAKED }, 10.0),
            (BACKWARDS, coasted),
            // no supply: neither brake nor drive
            (BldcInputs { supplied: false, ..FULL }, coasted),
            (BldcInputs { supplied: false, ..BRAKED }, coasted),
            (BldcInputs { throttle_v: 5.1, ..FULL }, coasted),
            (BldcInputs { throttle_v: f64::NAN, ..FULL }, coasted),
        ] {
            // 10 s are 20 time constants: 20 e^-20 = 4e-8
            assert!((turning(inputs) - expected_rad_s).abs() < 1e-7, "{inputs:?}");
        }
    }

    #[test]
    fn levels_of_lines() {
        for (direction, pull, high) in [
            (Driven(true), false, true),
            (Driven(false), true, false),
            (PulledUp, false, true),
            (Floating, false, false),
            (Floating, true, true),
        ] {
            assert_eq!(level(direction, pull), high);
            let spec = BldcDriveSpec { direction_pull: pull, brake_pull: pull, ..BY_LINE };
            for (backwards_when, brake_when) in [(true, true), (false, false)] {
                let reverse = Reverse::ByLine { when_high: backwards_when };
                let mut drive = BldcDrive::new(0, BldcDriveSpec { reverse, brake_when_high: brake_when, ..spec });
                drive.update(0, &BldcInputs { direction, brake: Driven(!brake_when), ..REST });
                drive.update(0, &BldcInputs { direction, brake: Driven(!brake_when), ..FULL });
                drive.advance(SECOND_NS);
                assert_eq!(drive.speed_rad_s() < 0.0, high == backwards_when);
                drive.update(SECOND_NS, &BldcInputs { brake: direction, ..FULL });
                assert_eq!(drive.is_braking(), high == brake_when);
            }
        }
    }

    #[test]
    fn brakes_evenly_to_a_stand() {
        let mut drive = ready(BACKWARDS);
        drive.advance(20 * SECOND_NS);
        let (from_rad, from_rad_s) = (drive.position_rad(), drive.speed_rad_s());
        drive.update(20 * SECOND_NS, &BldcInputs { direction: Driven(true), ..BRAKED });
        drive.advance(21 * SECOND_NS);
        assert!((drive.speed_rad_s() - (from_rad_s + 10.0)).abs() < 1e-12);
        drive.advance(23 * SECOND_NS);
        assert_eq!(drive.speed_rad_s(), 0.0);
        // v^2 / 2a; 1e-9 is rounding at 380 rad
        assert!((drive.position_rad() - (from_rad - from_rad_s * from_rad_s / 20.0)).abs() < 1e-9);
        assert!(drive.misuse().is_empty());
    }

    #[test]
    fn coasts_to_a_stand_at_one_per_cent() {
        let mut drive = ready(FULL);
        drive.update(20 * SECOND_NS, &REST);
        // 2 s * ln 100 = 9.21034 s
        drive.advance(29_210_340_000);
        assert!((drive.speed_rad_s() - 0.2).abs() < 1e-6);
        drive.advance(29_210_341_000);
        assert_eq!(drive.speed_rad_s(), 0.0);
    }

    #[test]
    fn refuses_to_run_before_the_dead_zone_was_seen() {
        let mut drive = BldcDrive::new(3, BY_LINE);
        drive.update(7, &FULL);
        drive.advance(SECOND_NS);
        assert_eq!((drive.is_ready(), drive.speed_rad_s()), (false, 0.0));
        assert_eq!(kinds(&drive), [MisuseKind::ThrottleBeforeNeutral { throttle_mv: 5000 }]);
        assert_eq!((drive.misuse().first()[0].address, drive.misuse().first()[0].time_ns), (3, 7));
        drive.update(SECOND_NS, &BldcInputs { throttle_v: 1.001, ..REST });
        assert!(!drive.is_ready());
        drive.update(2 * SECOND_NS, &REST);
        assert!(drive.is_ready());
        drive.update(2 * SECOND_NS, &FULL);
        drive.advance(3 * SECOND_NS);
        assert!(drive.speed_rad_s() > 10.0);
        // and again after a loss of supply
        drive.update(3 * SECOND_NS, &BldcInputs { supplied: false, ..FULL });
        drive.update(4 * SECOND_NS, &FULL);
        assert!(!drive.is_ready());
        assert_eq!(drive.misuse().total(), 2);
    }

    #[test]
    fn a_throttle_outside_the_window_locks_the_drive() {
        let outside = |throttle_mv| MisuseKind::ThrottleOutsideWindow { throttle_mv, low_mv: 1220, high_mv: 3080 };
        for (throttle_v, throttle_mv) in [
            (1.22, None),
            (3.08, None),
            (1.219, Some(outside(Some(1219)))),
            (3.081, Some(outside(Some(3081)))),
            (f64::NAN, Some(outside(None))),
        ] {
            let mut drive = BldcDrive::new(0, BY_VOLTAGE);
            drive.update(0, &BldcInputs { throttle_v: 2.05, ..REST });
            for at_ns in 1..4 {
                drive.update(at_ns, &BldcInputs { throttle_v, ..REST });
            }
            assert_eq!(kinds(&drive), Vec::from_iter(throttle_mv), "{throttle_v}");
            assert_eq!(drive.is_ready(), throttle_mv.is_none());
            drive.update(4, &BldcInputs { throttle_v: 3.0, ..REST });
            assert_eq!(drive.is_ready(), throttle_mv.is_none());
            drive.update(5, &BldcInputs { throttle_v: 2.05, ..REST });
            assert!(drive.is_ready());
        }
    }

    #[test]
    fn direction_changed_while_turning_coasts_first() {
        let mut drive = ready(FULL);
        drive.update(20 * SECOND_NS, &BACKWARDS);
        assert_eq!(kinds(&drive), [MisuseKind::DirectionChangedWhileTurning { speed_mrad_s: 20_000 }]);
        drive.advance(29 * SECOND_NS);
        assert!(drive.speed_rad_s() > 0.0);
        // stands at 29.21 s, then 20 rad/s backwards with 0.5 s: 1e-4 is the microsecond of the standstill
        drive.advance(30 * SECOND_NS);
        let after_s = 30.0 - 20.0 - 2.0 * 100.0f64.ln();
        assert!((drive.speed_rad_s() + 20.0 * (1.0 - (-after_s / 0.5).exp())).abs() < 1e-4);
        assert_eq!(drive.misuse().total(), 1);
    }

    #[test]
    fn a_direction_changed_without_supply_counts_when_supply_returns() {
        let mut drive = ready(FULL);
        drive.update(20 * SECOND_NS, &BldcInputs { supplied: false, throttle_v: 1.0, ..BACKWARDS });
        assert!(drive.misuse().is_empty());
        drive.update(20 * SECOND_NS, &BldcInputs { throttle_v: 1.0, ..BACKWARDS });
        assert_eq!(kinds(&drive), [MisuseKind::DirectionChangedWhileTurning { speed_mrad_s: 20_000 }]);
    }

    #[test]
    fn direction_may_change_at_a_standstill() {
        let speed_at = |share: f64| {
            let mut drive = ready(FULL);
            drive.anchor.speed_rad_s = share * 20.0;
            drive.update(0, &BACKWARDS);
            drive.misuse().total()
        };
        assert_eq!([speed_at(0.0), speed_at(0.01), speed_at(0.0101), speed_at(-0.5)], [0, 0, 1, 0]);
    }

    #[test]
    fn by_voltage_the_other_side_of_the_dead_zone_is_the_other_direction() {
        let at = |throttle_v| BldcInputs { throttle_v, ..REST };
        let mut drive = BldcDrive::new(0, BldcDriveSpec { tolerated_v: [0.0, 5.0], ..BY_VOLTAGE });
        drive.update(0, &at(2.05));
        drive.update(0, &at(0.0));
        drive.advance(SECOND_NS);
        let backwards_rad_s = drive.speed_rad_s();
        assert!((backwards_rad_s + 20.0 * (1.0 - (-2.0f64).exp())).abs() < 1e-12);
        // through the dead zone and out of it again: still turning
        drive.update(SECOND_NS, &at(2.3));
        drive.update(SECOND_NS, &at(5.0));
        let speed_mrad_s = (backwards_rad_s * 1e3).round() as i64;
        assert_eq!(kinds(&drive), [MisuseKind::DirectionChangedWhileTurning { speed_mrad_s }]);
        drive.advance(30 * SECOND_NS);
        assert!(drive.speed_rad_s() > 19.9);
        // its direction line has no effect
        drive.update(30 * SECOND_NS, &BldcInputs { direction: Driven(true), ..at(5.0) });
        drive.advance(31 * SECOND_NS);
        assert!(drive.speed_rad_s() > 19.9);
    }

    const ROTOR: Rotor = Rotor { inertia_kg_m2: 0.01, torque_max_nm: 0.3, power_max_w: 2.0, brake_nm: 0.2 };
    /// Servo drive: four quadrants about 2.5 V, 5 ms.
    const LOADED: BldcDriveSpec = BldcDriveSpec {
        dead_zone_v: [2.499, 2.501],
        reverse: Reverse::ByVoltage { full_v: 0.0 },
        tolerated_v: [0.0, 5.0],
        time_constant_s: 0.005,
        four_quadrant: true,
        rotor: Some(ROTOR),
        ..BY_VOLTAGE
    };

    /// A loaded drive that follows its throttle, with `throttle_v` and `load_nm` from time 0 on.
    fn loaded(spec: BldcDriveSpec, throttle_v: f64, load_nm: f64) -> BldcDrive {
        let mut drive = BldcDrive::new(3, spec);
        drive.update(0, &BldcInputs { throttle_v: 2.5, ..REST });
        drive.set_load(load_nm);
        drive.update(0, &BldcInputs { throttle_v, ..REST });
        drive
    }

    /// Full speed is 20 rad/s, the speed loop's gain 0.01 / 0.005 = 2 N m s/rad.
    #[test]
    fn a_loaded_drive_lags_behind_its_command_by_what_the_load_takes() {
        let mut drive = loaded(LOADED, 2.5 + 2.499 / 20.0 * 0.1 + 0.001, -0.1);
        drive.advance(SECOND_NS);
        // 0.1 rad/s commanded, minus 0.1 N m / 2 N m s/rad; after 200 time constants the difference is rounding
        assert!((drive.speed_rad_s() - 0.05).abs() < 1e-9, "{}", drive.speed_rad_s());
        assert!((drive.torque_nm() - 0.1).abs() < 1e-9);
        // in the dead zone it holds, and is pushed back with the same error
        drive.update(SECOND_NS, &BldcInputs { throttle_v: 2.5, ..REST });
        drive.advance(2 * SECOND_NS);
        assert!((drive.speed_rad_s() + 0.05).abs() < 1e-9);
    }

    #[test]
    fn torque_and_power_of_a_loaded_drive_are_limited() {
        let mut drive = loaded(LOADED, 5.0, 0.0);
        let (mut at_ns, mut torque_until_s) = (0, 0.0);
        while at_ns < SECOND_NS / 2 {
            at_ns += 100_000;
            drive.advance(at_ns);
            let (torque_nm, speed_rad_s) = (drive.torque_nm(), drive.speed_rad_s());
            assert!(torque_nm <= 0.3 + 1e-12 && torque_nm * speed_rad_s <= 2.0 + 1e-9, "{torque_nm} {speed_rad_s}");
            if torque_nm > 0.3 - 1e-9 {
                torque_until_s = at_ns as f64 * 1e-9;
            }
        }
        // 0.3 N m up to 2 W / 0.3 N m = 6.67 rad/s, at 30 rad/s^2, to the 0.1 ms of a sample; then J w dw/dt = P
        let (corner_rad_s, corner_s): (f64, f64) = (2.0 / 0.3, 2.0 / 0.3 / 30.0);
        assert!((torque_until_s - corner_s).abs() < 2e-4, "{torque_until_s}");
        let after_rad_s = (corner_rad_s.powi(2) + 2.0 * 2.0 / 0.01 * (0.5 - corner_s)).sqrt();
        // the power limit uses the higher speed of a step of 0.1 ms: too low by half its growth, at 14 rad/s^2
        assert!((drive.speed_rad_s() - after_rad_s).abs() < 2e-3, "{after_rad_s} {}", drive.speed_rad_s());
    }

    #[test]
    fn a_loaded_drive_of_four_quadrants_turns_round_without_a_rest() {
        let mut drive = loaded(LOADED, 3.5, 0.0);
        drive.advance(2 * SECOND_NS);
        drive.update(2 * SECOND_NS, &BldcInputs { throttle_v: 1.5, ..REST });
        // from 8 rad/s to -8 rad/s with 0.3 N m: 30 rad/s^2 down to 0
        drive.advance(2 * SECOND_NS + 100_000_000);
        assert!((drive.speed_rad_s() - (8.0 - 3.0)).abs() < 0.01, "{}", drive.speed_rad_s());
        drive.advance(4 * SECOND_NS);
        assert!((drive.speed_rad_s() + 8.0).abs() < 0.01, "{}", drive.speed_rad_s());
        assert!(drive.misuse().is_empty());
        // a two-quadrant drive coasts first, with 2 s, and the change is reported
        let mut drive = loaded(BldcDriveSpec { four_quadrant: false, ..LOADED }, 3.5, 0.0);
        drive.advance(2 * SECOND_NS);
        let before_rad_s = drive.speed_rad_s();
        drive.update(2 * SECOND_NS, &BldcInputs { throttle_v: 1.5, ..REST });
        drive.advance(3 * SECOND_NS);
        assert!((drive.speed_rad_s() - before_rad_s * (-0.5f64).exp()).abs() < 1e-9);
        assert_eq!(drive.misuse().total(), 1);
    }

    #[test]
    fn the_brake_of_a_loaded_drive_holds_up_to_its_torque() {
        for (load_nm, speed_rad_s) in [(0.0, 0.0), (0.2, 0.0), (-0.2, 0.0), (0.3, 10.0), (-0.3, -10.0)] {
            let mut drive = loaded(LOADED, 2.5, load_nm);
            drive.update(0, &BldcInputs { throttle_v: 2.5, brake: Driven(true), ..REST });
            drive.advance(SECOND_NS);
            // (0.3 - 0.2) N m / 0.01 kg m^2
            assert!((drive.speed_rad_s() - speed_rad_s).abs() < 1e-9, "{load_nm} N m: {} rad/s", drive.speed_rad_s());
        }
        let mut drive = loaded(LOADED, 5.0, 0.0);
        drive.advance(5 * SECOND_NS);
        let (from_rad, from_rad_s) = (drive.position_rad(), drive.speed_rad_s());
        drive.update(5 * SECOND_NS, &BldcInputs { throttle_v: 2.5, brake: Driven(true), ..REST });
        drive.advance(10 * SECOND_NS);
        // v^2 / 2a with 20 rad/s^2; the step in which it stops is exact
        assert_eq!(drive.speed_rad_s(), 0.0);
        assert!((drive.position_rad() - from_rad - from_rad_s * from_rad_s / 40.0).abs() < 1e-9);
    }

    /// Spring load held over each step: frequency and energy without the drive.
    #[test]
    fn a_coasting_rotor_on_a_spring_swings_by_its_inertia() {
        let spec = BldcDriveSpec { coast_time_constant_s: 1e7, ..LOADED };
        let mut drive = BldcDrive::new(0, spec);
        drive.anchor.speed_rad_s = 1.0;
        let (stiffness_nm_per_rad, mut crossings) = (1.0, 0);
        for step in 1..=40_000u64 {
            let before_rad = drive.position_rad();
            // half a step ahead, so that a held load neither adds nor removes energy
            let middle_rad = before_rad + 0.5 * 0.25e-3 * drive.speed_rad_s();
            drive.set_load(-stiffness_nm_per_rad * middle_rad);
            drive.advance(step * STEP_NS);
            crossings += u32::from(before_rad * drive.position_rad() < 0.0);
        }
        // sqrt(k / J) = 10 rad/s for 10 s: 31.8 half turns
        assert_eq!(crossings, 31);
        let energy_j =
            0.5 * 0.01 * drive.speed_rad_s().powi(2) + 0.5 * stiffness_nm_per_rad * drive.position_rad().powi(2);
        // coasting removes 10 s / 1e7 s of it, and (w h)^2 / 4 = 1.6e-6 oscillates
        assert!((energy_j / 0.005 - 1.0).abs() < 1e-5, "{energy_j}");
    }

    fn any_pin() -> impl Strategy<Value = PinState> {
        prop_oneof![Just(Driven(false)), Just(Driven(true)), Just(Floating), Just(PulledUp)]
    }

    fn any_inputs() -> impl Strategy<Value = BldcInputs> {
        let brake = prop_oneof![4 => Just(Driven(false)), 1 => any_pin()];
        let throttle_v = prop_oneof![1 => Just(1.0), 1 => Just(2.05), 4 => -0.5..5.5f64];
        (throttle_v, any_pin(), brake, prop::bool::weighted(0.9))
            .prop_map(|(throttle_v, direction, brake, supplied)| BldcInputs { throttle_v, direction, brake, supplied })
    }

    proptest! {
        #[test]
        fn looking_often_changes_nothing(
            by_line: bool,
            changes in prop::collection::vec((1..5 * SECOND_NS, any_inputs()), 1..20),
            looks in 1..20u64,
        ) {
            let spec = if by_line { BY_LINE } else { BldcDriveSpec { tolerated_v: [0.0, 5.0], ..BY_VOLTAGE } };
            let [mut lazy, mut eager] = [BldcDrive::new(0, spec), BldcDrive::new(0, spec)];
            let mut at_ns = 0;
            for (wait_ns, inputs) in changes {
                lazy.update(at_ns, &inputs);
                for look in 0..looks {
                    eager.update(at_ns + wait_ns * look / looks, &inputs);
                }
                at_ns += wait_ns;
            }
            lazy.advance(at_ns);
            eager.advance(at_ns);
            // to the bit
            prop_assert_eq!(lazy, eager);
        }

        #[test]
        fn speed_stays_in_bounds_and_is_the_slope_of_position(
            changes in prop::collection::vec((1..2_000_000u64, any_inputs()), 1..100),
        ) {
            let mut drive = BldcDrive::new(0, BY_LINE);
            let mut at_ns = 0;
            for (wait_ns, inputs) in changes {
                drive.update(at_ns, &inputs);
                let before = (drive.position_rad(), drive.speed_rad_s());
                at_ns += wait_ns;
                drive.advance(at_ns);
                let (speed_rad_s, dt_s) = (drive.speed_rad_s(), wait_ns as f64 * 1e-9);
                prop_assert!(speed_rad_s.abs() <= 20.0);
                // trapezoidal rule: the steepest change is 80 rad/s^2 over 2 ms, and the jump to a standstill is 0.2
                // rad/s
                let way_rad = 0.5 * (before.1 + speed_rad_s) * dt_s;
                prop_assert!((drive.position_rad() - before.0 - way_rad).abs() <= 0.2 * dt_s + 1e-9);
            }
        }

        #[test]
        fn never_panics(
            numbers: [f64; 10],
            changes in prop::collection::vec((any::<u64>(), any::<f64>(), any_inputs()), 0..20),
        ) {
            let [a, b, forward_v, full_v, c, d, top_speed_rad_s, time_constant_s, coast_time_constant_s, brake_rad_s2] =
                numbers;
            let mut drive = BldcDrive::new(0, BldcDriveSpec {
                dead_zone_v: [a, b], forward_v, reverse: Reverse::ByVoltage { full_v }, tolerated_v: [c, d],
                top_speed_rad_s, time_constant_s, coast_time_constant_s, brake_rad_s2, ..BY_LINE
            });
            for (at_ns, throttle_v, inputs) in changes {
                drive.update(at_ns, &BldcInputs { throttle_v, ..inputs });
                let _ = (drive.position_rad(), drive.speed_rad_s());
            }
        }
    }
}
