//! Brushless drives, servos and steppers: the actuators on the other connectors.

use r4_boards::{Robot, SimulatedEncoder};
use r4_protocol::{
    ChannelId,
    config::{BldcConfig, Reverse as Wiring},
};

use super::{chips::Chips, stepping::Axis};
use crate::{
    chips::mcp23017::PinState,
    devices::{
        bldc_drive::{BldcDrive, BldcDriveSpec, BldcInputs, Reverse, Rotor},
        rc_servo::{RcServo, RcServoSpec},
        stepper_driver::StepperDriverSpec,
    },
    misuse::MisuseLog,
};

/// Ratio of the stopping time of a coasting drive to that of one that follows its throttle: synthetic.
const COAST_SLOWER: f64 = 2.0;
/// Time in which a brake stops the motor from full speed, s: synthetic.
const BRAKE_S: f64 = 0.3;
/// Tolerated throttle beyond full speed, V: synthetic.
const TOLERATED_V: f64 = 0.1;
/// Dead band of a servo's pulse, s: usual for analog servos.
const SERVO_DEAD_BAND_S: f64 = 2e-6;
/// Mechanical travel beyond the commanded one, rad: synthetic.
const SERVO_ROOM_RAD: f64 = 0.1;
/// Acceleration of a stepper relative to its start-stop rate, 1/s: 50 times that rate in a second. Synthetic.
const STEPPER_ACCELERATION_PER_S: f64 = 50.0;

pub(super) struct Bldc {
    pub(super) channel: ChannelId,
    wiring: BldcConfig,
    pub(super) drive: BldcDrive,
    /// Encoder on its shaft, if there is one.
    pub(super) encoder: Option<SimulatedEncoder>,
    /// True if its shaft is one of the body's.
    pub(super) coupled: bool,
}

impl Bldc {
    pub(super) fn look(&mut self, at_ns: u64, chips: &Chips, supplied: bool) {
        let pin =
            |line: Option<r4_protocol::config::DriveLine>| line.map_or(PinState::Floating, |line| chips.pin(line.bit));
        let direction = if let Wiring::Line { line, .. } = self.wiring.reverse { Some(line) } else { None };
        let inputs = BldcInputs {
            throttle_v: self.throttle_v(chips),
            direction: pin(direction),
            brake: pin(self.wiring.brake),
            supplied,
        };
        self.drive.update(at_ns, &inputs);
    }

    pub(super) fn throttle_v(&self, chips: &Chips) -> f64 {
        chips.bldc_dac.as_ref().map_or(0.0, |chip| chip.borrow().output_v(self.wiring.output.into()).volts)
    }

    pub(super) fn at(&mut self, at_ns: u64) -> &BldcDrive {
        self.drive.advance(at_ns);
        &self.drive
    }

    /// Largest acceleration of the drive without load, rad/s².
    pub(super) fn top_acceleration(&self) -> f64 {
        let spec = self.drive.spec();
        let limit =
            spec.rotor.map_or(f64::INFINITY, |rotor| rotor.torque_max_nm.max(rotor.brake_nm) / rotor.inertia_kg_m2);
        limit.min((2.0 * spec.top_speed_rad_s / spec.time_constant_s).max(spec.brake_rad_s2))
    }

    pub(super) fn misuse(&self) -> &MisuseLog {
        self.drive.misuse()
    }
}

pub(super) fn bldcs(robot: &Robot) -> Vec<Bldc> {
    let pairs = robot.config.bldcs.iter().zip(&robot.simulation.bldcs);
    let drive = |(wiring, truth): (&BldcConfig, &r4_boards::SimulatedBldc)| {
        let [low_v, high_v] = truth.dead_zone_v;
        let full = [truth.forward_v, truth.reverse_v.unwrap_or(low_v), low_v, high_v];
        let lowest = full.into_iter().fold(f64::INFINITY, f64::min);
        let highest = full.into_iter().fold(f64::NEG_INFINITY, f64::max);
        let spec = BldcDriveSpec {
            dead_zone_v: truth.dead_zone_v,
            forward_v: truth.forward_v,
            reverse: match (truth.reverse_v, wiring.reverse) {
                (Some(full_v), _) => Reverse::ByVoltage { full_v },
                (None, Wiring::Line { line, .. }) => Reverse::ByLine { when_high: !line.active_low },
                (None, _) => Reverse::ByLine { when_high: true },
            },
            tolerated_v: [lowest - TOLERATED_V, highest + TOLERATED_V],
            direction_pull: false,
            brake_pull: wiring.brake.is_some_and(|line| !line.active_low),
            brake_when_high: wiring.brake.is_none_or(|line| !line.active_low),
            top_speed_rad_s: truth.top_speed_rad_s,
            time_constant_s: truth.time_constant_s,
            coast_time_constant_s: COAST_SLOWER * truth.time_constant_s,
            brake_rad_s2: truth.top_speed_rad_s / BRAKE_S,
            four_quadrant: truth.four_quadrant,
            rotor: truth.rotor.map(|rotor| Rotor {
                inertia_kg_m2: rotor.inertia_kg_m2,
                torque_max_nm: rotor.torque_max_nm,
                power_max_w: rotor.power_max_w,
                brake_nm: rotor.brake_nm,
            }),
        };
        let drive = BldcDrive::new(wiring.id.index, spec);
        Bldc { channel: wiring.id, wiring: *wiring, drive, encoder: truth.encoder, coupled: false }
    };
    pairs.map(drive).collect()
}

pub(super) struct Servo {
    pub(super) channel: ChannelId,
    output: u8,
    servo: RcServo,
}

impl Servo {
    /// Updates the servo's signal. A servo has its own supply, which no relay switches.
    pub(super) fn look(&mut self, at_ns: u64, chips: &Chips) {
        if let Some(chip) = &chips.servo_pwm {
            let chip = chip.borrow();
            self.servo.update(at_ns, chip.line(self.output.into()), chip.pwm_period_ns(), true);
        }
    }

    pub(super) fn at(&mut self, at_ns: u64) -> &RcServo {
        self.servo.advance(at_ns);
        &self.servo
    }

    pub(super) fn angle_rad(&mut self, at_ns: u64) -> f64 {
        self.at(at_ns).angle_rad()
    }

    pub(super) fn misuse(&self) -> &MisuseLog {
        self.servo.misuse()
    }
}

pub(super) fn servos(robot: &Robot) -> Vec<Servo> {
    let pairs = robot.config.servos.iter().zip(&robot.simulation.servos);
    let servo = |(config, truth): (&r4_protocol::config::ServoConfig, &r4_boards::SimulatedServo)| {
        let ends = [truth.angle_min_rad, truth.angle_max_rad];
        let spec = RcServoSpec {
            pulse_min_s: truth.pulse_min_s,
            pulse_max_s: truth.pulse_max_s,
            angle_at_min_rad: truth.angle_min_rad,
            angle_at_max_rad: truth.angle_max_rad,
            rate_rad_s: truth.rate_rad_s,
            dead_band_s: SERVO_DEAD_BAND_S,
            stop_min_rad: ends[0].min(ends[1]) - SERVO_ROOM_RAD,
            stop_max_rad: ends[0].max(ends[1]) + SERVO_ROOM_RAD,
        };
        let middle_rad = (truth.angle_min_rad + truth.angle_max_rad) / 2.0;
        Servo { channel: config.id, output: config.output, servo: RcServo::new(config.id.index, spec, middle_rad) }
    };
    pairs.map(servo).collect()
}

pub(super) fn steppers(robot: &Robot) -> Vec<Axis> {
    let pairs = robot.config.steppers.iter().zip(&robot.simulation.steppers);
    let enabled_when_high = robot.config.stepper_bank.is_none_or(|bank| !bank.enable_active_low);
    let axis = |(config, truth): (&r4_protocol::config::StepperConfig, &r4_boards::SimulatedStepper)| {
        let spec = StepperDriverSpec {
            enabled_when_high,
            start_stop_hz: truth.start_rate_hz,
            acceleration_hz_s: STEPPER_ACCELERATION_PER_S * truth.start_rate_hz,
        };
        Axis::new(config.id, spec, config.steps_per_turn)
    };
    pairs.map(axis).collect()
}
