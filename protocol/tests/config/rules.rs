//! Tests that every rule of `BoardConfig::validate` can be broken, by one change to the good configuration.

use std::{collections::BTreeSet, fs, path::PathBuf};

use r4_protocol::{
    ChannelId,
    ChannelKind::{Actuator, Analog, Bldc, Dac, DeadMan, Dhb, Encoder, Osmc, Range as RangeSensor, Relay, Servo},
    ChannelKind::{Angle, Current, Distance, Force, Imu, Stepper, Supply, Switch},
    Range,
    config::{
        As5600Config, BoardConfig, BridgeConfig, BridgeLines, ConfigError, ControlConfig, DUTY_HARD_MAX, DacChipConfig,
        DhbLines, DriveLine, ExpanderConfig, FeedForward, Feedback, ForceConfig, ForceSensor, HomingConfig,
        Icm20948Config, Ina226Config, MAX_EXACT, MotorSideConfig, Nau7802Config, PidGains, Place, PotPoint, Reverse,
        SensorChip, SensorConfig, Vl6180xConfig, WindingConfig,
    },
};

use crate::good::{good, id};

/// Channel of the error (`None` is the board), the rule, and the one change that breaks it.
type Case = (Option<ChannelId>, &'static str, fn(&mut BoardConfig));

const WHEEL: Option<ChannelId> = Some(id(Osmc, 0));
const ROD: Option<ChannelId> = Some(id(Actuator, 1));
const FAN: Option<ChannelId> = Some(id(Osmc, 2));
const ARM: Option<ChannelId> = Some(id(Dhb, 0));
const HIP: Option<ChannelId> = Some(id(Dhb, 1));

/// Returns the loops of motor number `index`.
fn loops(config: &mut BoardConfig, index: usize) -> &mut ControlConfig {
    config.motors[index].control.as_mut().expect("it has loops")
}

fn wheel(config: &mut BoardConfig) -> &mut ControlConfig {
    loops(config, 0)
}

fn pot(config: &mut BoardConfig, change: fn(&mut u8, &mut PotPoint, &mut PotPoint)) {
    let Feedback::Potentiometer { analog, low, high } = &mut loops(config, 1).feedback else { panic!("the rod's") };
    change(analog, low, high);
}

fn encoder(config: &mut BoardConfig, change: fn(&mut u8, &mut u32)) {
    let Feedback::Encoder { index, counts_per_turn, .. } = &mut wheel(config).feedback else { panic!("the wheel's") };
    change(index, counts_per_turn);
}

fn index_pulse(config: &mut BoardConfig) -> &mut u32 {
    let Feedback::Encoder { counts_per_index, .. } = &mut wheel(config).feedback else { panic!("the wheel's") };
    counts_per_index
}

fn hip(config: &mut BoardConfig, change: fn(&mut u8, &mut f32)) {
    let Feedback::Angle { angle, zero, .. } = &mut loops(config, 4).feedback else { panic!("the hip's") };
    change(angle, zero);
}

/// Gives the hip's angle by pulses, without the range sensor at connector 1.
fn pulses(config: &mut BoardConfig, range: u8, frames_hz: u16) {
    config.ranges.truncate(1);
    loops(config, 4).feedback = Feedback::Pulses { range, frames_hz, zero: 1.0, inverted: false };
}

fn side(config: &mut BoardConfig) -> &mut MotorSideConfig {
    wheel(config).motor_side.as_mut().expect("the wheel's")
}

fn force(config: &mut BoardConfig) -> &mut ForceConfig {
    wheel(config).force.as_mut().expect("the wheel's")
}

fn winding(config: &mut BoardConfig) -> &mut WindingConfig {
    config.motors[0].winding.as_mut().expect("the wheel's")
}

fn home(config: &mut BoardConfig) -> &mut HomingConfig {
    loops(config, 3).homing.as_mut().expect("the arm's")
}

fn slide_home(config: &mut BoardConfig) -> &mut HomingConfig {
    config.steppers[1].homing.as_mut().expect("the slide's")
}

fn osmc(ahi: u8, ali: u8, bhi: u8, bli: u8) -> BridgeConfig {
    BridgeConfig::Osmc(BridgeLines { ahi, ali, bhi, bli })
}

fn dhb(in1: u8, in2: u8, en: u8) -> BridgeConfig {
    BridgeConfig::Dhb(DhbLines { in1, in2, en })
}

const BOARD: &[Case] = {
    const PERIOD: &str = "control_period_us must be 500 to 20000";
    const TIMEOUT: &str = "link_timeout_ms must be 20 to 1000";
    const ROOM: &str = "i2c_hz and control_period_us must leave room for every output in a period";
    const BUS: &str = "i2c_hz must be 10000 to 400000";
    const CAN_RATE: &str = "can_rate must be 125, 250, 500 or 1000 kbit/s";
    const CAN_DATA_RATE: &str =
        "can_data_rate must be 500, 1000 or 2000 kbit/s, not below can_rate, or 0 for classic frames only";
    const CAN_NODE: &str = "can_node must be 0 to 127";
    const AIR: &str = "air_temperature_c must be -40 to 60";
    const PWM: &str = "the PWM chip has 24 to 1526 Hz";
    const PCA: &str = "a PCA9685 has an address from 0x40 to 0x77, but for 0x70, which all of them answer";
    const PULSES: &str = "servo pulses repeat at 40 to 330 Hz";
    const OSCILLATOR: &str = "the servo chip's oscillator is 25 MHz within some percent: 20 to 30 MHz";
    const DAC: &str = "an MCP4728 has an address from 0x60 to 0x67";
    const DAC_V: &str = "an MCP4728 is supplied with 2.7 to 5.5 V";
    const EXPANDER: &str = "an MCP23017 has an address from 0x20 to 0x27";
    const RATE: &str = "rate_max_hz must be above 0 and at most 100000";
    const SETUP: &str = "enable_setup_us must be at most 1000000, direction_setup_us at most 10000";
    const SAME: &str = "two chips have the same address";
    &[
        (None, PERIOD, |c| c.control_period_us = 499),
        (None, PERIOD, |c| c.control_period_us = 20_001),
        (None, PERIOD, |c| c.control_period_us = u32::MAX),
        (None, TIMEOUT, |c| c.link_timeout_ms = 19),
        (None, TIMEOUT, |c| c.link_timeout_ms = 1001),
        (None, ROOM, |c| c.i2c_hz = 100_000),
        (None, ROOM, |c| c.control_period_us = 500),
        (None, BUS, |c| c.i2c_hz = 9999),
        (None, BUS, |c| c.i2c_hz = 400_001),
        (None, CAN_RATE, |c| c.can.kbit_per_s = 0),
        (None, CAN_RATE, |c| c.can.kbit_per_s = 800),
        (None, CAN_DATA_RATE, |c| c.can.data_kbit_per_s = 500),
        (None, CAN_DATA_RATE, |c| c.can.data_kbit_per_s = 4000),
        (None, CAN_NODE, |c| c.can.node = 128),
        (None, AIR, |c| c.air_temperature_c = -41.0),
        (None, AIR, |c| c.air_temperature_c = 61.0),
        (None, AIR, |c| c.air_temperature_c = f32::NAN),
        (None, PWM, |c| c.osmc_pwm.as_mut().expect("one").frequency_hz = 24.0f32.next_down()),
        (None, PWM, |c| c.osmc_pwm.as_mut().expect("one").frequency_hz = 1526.0f32.next_up()),
        (None, PWM, |c| c.dhb_pwm.as_mut().expect("one").frequency_hz = f32::NAN),
        (None, PCA, |c| c.osmc_pwm.as_mut().expect("one").address = 0x3F),
        (None, PCA, |c| c.osmc_pwm.as_mut().expect("one").address = 0x70),
        (None, PCA, |c| c.dhb_pwm.as_mut().expect("one").address = 0x78),
        (None, PCA, |c| c.servo_pwm.as_mut().expect("one").address = u8::MAX),
        (None, PCA, |c| c.servo_pwm.as_mut().expect("one").address = 0x70),
        (None, PULSES, |c| c.servo_pwm.as_mut().expect("one").frequency_hz = 39.0),
        (None, PULSES, |c| c.servo_pwm.as_mut().expect("one").frequency_hz = f32::INFINITY),
        (None, OSCILLATOR, |c| c.servo_pwm.as_mut().expect("one").oscillator_hz = 19e6),
        (None, OSCILLATOR, |c| c.servo_pwm.as_mut().expect("one").oscillator_hz = f32::NAN),
        (None, DAC, |c| c.bldc_dac.as_mut().expect("one").address = 0x5F),
        (None, DAC, |c| c.bldc_dac.as_mut().expect("one").address = 0x68),
        (None, DAC_V, |c| c.bldc_dac.as_mut().expect("one").full_scale_v = 2.6),
        (None, DAC_V, |c| c.bldc_dac.as_mut().expect("one").full_scale_v = f32::NAN),
        (None, EXPANDER, |c| c.expander = Some(ExpanderConfig { address: 0x1F })),
        (None, EXPANDER, |c| c.expander = Some(ExpanderConfig { address: 0x28 })),
        (None, RATE, |c| c.stepper_bank.as_mut().expect("one").rate_max_hz = 0.0),
        (None, RATE, |c| c.stepper_bank.as_mut().expect("one").rate_max_hz = 100_001.0),
        (None, RATE, |c| c.stepper_bank.as_mut().expect("one").rate_max_hz = f32::NAN),
        (None, SETUP, |c| c.stepper_bank.as_mut().expect("one").enable_setup_us = 1_000_001),
        (None, SETUP, |c| c.stepper_bank.as_mut().expect("one").direction_setup_us = 10_001),
        (None, SAME, |c| c.dhb_pwm = c.osmc_pwm),
        (None, SAME, |c| c.servo_pwm.as_mut().expect("one").address = 0x41),
        (None, SAME, |c| c.osmc_pwm.as_mut().expect("one").address = 0x60),
    ]
};

const MOTORS: &[Case] = {
    const LINES: &str = "bridge lines must be 0 to 15, each used once";
    const FOUR: &str = "a bridge's lines must be four in a row, so that one transfer sets them";
    const THREE: &str = "a bridge's lines must be three in a row, so that one transfer sets them";
    const KIND: &str = "osmc and actuator channels are on OSMC bridges, dhb channels on DHB bridges";
    const NUMBER: &str = "bridges are numbered 0 to 3";
    const TAKEN: &str = "the bridge connector is used twice";
    const DUTY: &str = "duty_max must be above 0 and at most 0.98";
    const SLEW: &str = "duty_slew_per_s must be positive";
    const DEAD: &str = "dead_duty must not be negative, and must stay below duty_max";
    const THERMAL: &str = "thermal_s must be 0.1 to 36000";
    const SENSE: &str = "a current sensor's zero_v must be finite, and its volts_per_a positive";
    const STOP: &str = "stop_brake_ms must be at most 5000";
    &[
        (WHEEL, "a motor on an OSMC needs osmc_pwm", |c| c.osmc_pwm = None),
        (ARM, "a motor on a DHB needs dhb_pwm", |c| c.dhb_pwm = None),
        (WHEEL, LINES, |c| c.motors[0].bridge = osmc(13, 14, 15, 16)),
        (WHEEL, LINES, |c| c.motors[0].bridge = osmc(0, 1, 2, u8::MAX)),
        (WHEEL, LINES, |c| c.motors[0].bridge = osmc(0, 1, 2, 0)),
        (ROD, LINES, |c| c.motors[1].bridge = c.motors[0].bridge),
        (ARM, LINES, |c| c.motors[3].bridge = dhb(14, 15, 16)),
        (ARM, LINES, |c| c.motors[3].bridge = dhb(1, 2, 1)),
        (WHEEL, FOUR, |c| c.motors[0].bridge = osmc(0, 1, 2, 12)),
        (WHEEL, FOUR, |c| c.motors[0].bridge = osmc(0, 1, 2, 4)),
        (ARM, THREE, |c| c.motors[3].bridge = dhb(0, 1, 3)),
        (WHEEL, KIND, |c| c.motors[0].bridge = dhb(10, 11, 12)),
        (ARM, KIND, |c| c.motors[3].bridge = osmc(12, 13, 14, 15)),
        (Some(id(Supply, 0)), KIND, |c| c.motors[0].id = id(Supply, 0)),
        (Some(id(Osmc, 4)), NUMBER, |c| c.motors[0].id.index = 4),
        (Some(id(Dhb, u8::MAX)), NUMBER, |c| c.motors[3].id.index = u8::MAX),
        (Some(id(Actuator, 0)), TAKEN, |c| c.motors[1].id.index = 0),
        (Some(id(Osmc, 0)), TAKEN, |c| c.motors[2].id.index = 0),
        (WHEEL, DUTY, |c| c.motors[0].duty_max = 0.0),
        (FAN, DUTY, |c| c.motors[2].duty_max = DUTY_HARD_MAX.next_up()),
        (WHEEL, DUTY, |c| c.motors[0].duty_max = f32::NAN),
        (WHEEL, SLEW, |c| c.motors[0].duty_slew_per_s = 0.0),
        (FAN, SLEW, |c| c.motors[2].duty_slew_per_s = f32::INFINITY),
        (WHEEL, "a motor with feedback needs a winding, for its overload protection", |c| c.motors[0].winding = None),
        (WHEEL, "nominal_v must be positive", |c| winding(c).nominal_v = 0.0),
        (WHEEL, DEAD, |c| winding(c).dead_duty = 0.9),
        (WHEEL, DEAD, |c| winding(c).dead_duty = -0.1),
        (WHEEL, "resistance_ohm must be positive", |c| winding(c).resistance_ohm = f32::NAN),
        (WHEEL, "back_emf must not be negative", |c| winding(c).back_emf = -1.0),
        (WHEEL, "rated_a must be positive", |c| winding(c).rated_a = 0.0),
        (WHEEL, THERMAL, |c| winding(c).thermal_s = 0.1f32.next_down()),
        (WHEEL, THERMAL, |c| winding(c).thermal_s = f32::NAN),
        (WHEEL, SENSE, |c| winding(c).current_sense.as_mut().expect("one").volts_per_a = 0.0),
        (WHEEL, SENSE, |c| winding(c).current_sense.as_mut().expect("one").zero_v = f32::NAN),
        (WHEEL, "the winding's supply must be in the list of supplies", |c| winding(c).supply = Some(2)),
        (WHEEL, "the current sensor's analog input must be in the list of analog inputs", |c| {
            winding(c).current_sense.as_mut().expect("one").analog = 3;
        }),
        (FAN, STOP, |c| c.motors[2].stop_brake_ms = 5001),
        (FAN, "stop_brake_ms must leave duty_max time to fall to 0 by duty_slew_per_s", |c| {
            c.motors[2].stop_brake_ms = 89
        }),
        (ROD, "an actuator needs a potentiometer", |c| c.motors[1].control = None),
        (WHEEL, "an osmc channel has an encoder or an angle sensor", |c| wheel(c).feedback = loops(c, 1).feedback),
        (ROD, "an actuator has a potentiometer", |c| loops(c, 1).feedback = wheel(c).feedback),
    ]
};

const LOOPS: &[Case] = {
    const INDEX: &str = "counts_per_index must be 16 to 16777216, or 0 without an index pulse";
    const ENCODER: &str = "the encoder must exist and be used by one motor";
    const COUNTS: &str = "counts_per_turn must be 1 to 16777216";
    const ANALOG: &str = "the analog input must exist and be used once";
    const CODES: &str = "the calibration points need different codes, at least 1024 apart";
    const RAILS: &str = "the calibration points need codes from 256 to 65279, or a shorted wiper passes for an end";
    const LOW_HIGH: &str = "the low calibration point must be below the high one";
    const BEYOND: &str = "position must lie between the calibration points, beyond which the sensor counts as broken";
    const POSITION: &str = "position must have a finite min below a finite max";
    const FAR: &str = "position must be within 1e9 counts of 0";
    const SPEED: &str = "speed_max must be positive";
    const GAINS: &str = "gains must be 0 to 1000000";
    const FILTER: &str = "speed_filter_s must be 0 to 1, or the speed is known too late";
    const PROFILE: &str = "profile speed and acceleration must be positive, jerk not negative";
    const CASCADE: &str = "cascade must be 0 to 1000, in 1/s";
    const FORWARD: &str = "feed-forward must not be negative, and static_duty must stay below duty_max";
    const SETTLE: &str = "settle error and speed must be positive";
    const STALL: &str = "stall duty, travel and time must be positive";
    const UNSEEN: &str = "stall duty must be below duty_max, or a stall is never seen";
    const FOLLOW: &str = "follow error and time must be positive";
    const HOMING: &str =
        "homing needs a switch from 0 to 3, a position in range and a positive speed of at most speed_max";
    const SWITCH: &str = "the homing switch must be in the list of switches, and belong to one axis";
    const PULSE: &str =
        "an index pulse needs the switch with its encoder's number in the list, which no other axis may seek";
    const ANGLE: &str = "the motor's angle sensor must be in the list of sensors, and belong to one motor";
    const FRAMES: &str = "frames_hz must be 115 or 230: shorter pulses are over before they are captured";
    const ALONE: &str = "the range connector of a motor's pulses must belong to it alone";
    const ZERO: &str = "the zero angle must be 0 to 6.2831855";
    const SIDE: &str = "motor_side_counts must be 1 to 16777216";
    const GAP: &str = "gap_max must be above 0 and below one turn";
    const FORCE_SENSOR: &str = "a force sensor's zero_v must be finite, and its newtons_per_v other than 0";
    &[
        (WHEEL, ENCODER, |c| encoder(c, |index, _| *index = 4)),
        (WHEEL, INDEX, |c| *index_pulse(c) = 15),
        (WHEEL, INDEX, |c| *index_pulse(c) = MAX_EXACT + 1),
        (ARM, ENCODER, |c| encoder(c, |index, _| *index = 1)),
        (WHEEL, COUNTS, |c| encoder(c, |_, counts| *counts = 0)),
        (WHEEL, COUNTS, |c| encoder(c, |_, counts| *counts = MAX_EXACT + 1)),
        (WHEEL, FAR, |c| wheel(c).position.max = 3e6),
        (WHEEL, FAR, |c| wheel(c).position.min = -3e6),
        (ROD, ANALOG, |c| pot(c, |analog, _, _| *analog = 6)),
        (ROD, ANALOG, |c| pot(c, |analog, _, _| *analog = u8::MAX)),
        (ROD, CODES, |c| pot(c, |_, low, high| low.code = high.code)),
        (ROD, CODES, |c| pot(c, |_, low, high| low.code = high.code + 1023)),
        (ROD, RAILS, |c| pot(c, |_, low, _| low.code = 65_280)),
        (ROD, RAILS, |c| pot(c, |_, _, high| high.code = 255)),
        (ROD, LOW_HIGH, |c| pot(c, |_, low, high| low.position_m = high.position_m)),
        (ROD, LOW_HIGH, |c| pot(c, |_, low, _| low.position_m = f32::NEG_INFINITY)),
        (ROD, LOW_HIGH, |c| pot(c, |_, _, high| high.position_m = f32::NAN)),
        (ROD, BEYOND, |c| loops(c, 1).position.min = -0.001),
        (ROD, BEYOND, |c| loops(c, 1).position.max = 0.101),
        (ROD, "a potentiometer needs no homing", |c| loops(c, 1).homing = Some(*home(c))),
        (WHEEL, POSITION, |c| wheel(c).position = Range::new(1.0, 1.0)),
        (WHEEL, POSITION, |c| wheel(c).position = Range::new(f32::NAN, 1.0)),
        (WHEEL, POSITION, |c| wheel(c).position.min = f32::NEG_INFINITY),
        (ROD, POSITION, |c| loops(c, 1).position.max = f32::INFINITY),
        // 2400 counts at 130.9 rad/s are 50 in a millisecond.
        (WHEEL, "encoder 3 counts by interrupts, at most 50 counts a ms at speed_max: use encoders 0 to 2", |c| {
            encoder(c, |index, _| *index = 3);
            wheel(c).speed_max = 131.0;
        }),
        (WHEEL, SPEED, |c| wheel(c).speed_max = 0.0),
        (WHEEL, SPEED, |c| wheel(c).speed_max = f32::MIN_POSITIVE),
        (WHEEL, SPEED, |c| wheel(c).speed_max = f32::MAX),
        (ROD, SPEED, |c| loops(c, 1).speed_max = -1.0),
        (WHEEL, GAINS, |c| wheel(c).position_pid.kp = -1.0),
        (WHEEL, GAINS, |c| wheel(c).position_pid.ki = f32::NAN),
        (WHEEL, GAINS, |c| wheel(c).position_pid.kd = f32::INFINITY),
        (WHEEL, GAINS, |c| wheel(c).speed_pid.kp = PidGains::MAX.next_up()),
        (WHEEL, GAINS, |c| wheel(c).speed_pid.ki = -f32::MIN_POSITIVE),
        (WHEEL, GAINS, |c| wheel(c).speed_pid.kd = f32::NAN),
        (WHEEL, FILTER, |c| wheel(c).speed_filter_s = -0.001),
        (WHEEL, FILTER, |c| wheel(c).speed_filter_s = 1.0f32.next_up()),
        (WHEEL, FILTER, |c| wheel(c).speed_filter_s = f32::NAN),
        (WHEEL, PROFILE, |c| wheel(c).profile.speed = 0.0),
        (WHEEL, PROFILE, |c| wheel(c).profile.acceleration = f32::NAN),
        (WHEEL, PROFILE, |c| wheel(c).profile.jerk = -1.0),
        (WHEEL, PROFILE, |c| wheel(c).profile.jerk = f32::MIN_POSITIVE),
        (WHEEL, PROFILE, |c| wheel(c).profile.jerk = f32::NAN),
        (WHEEL, "profile speed must be at most speed_max", |c| wheel(c).profile.speed = 20.0f32.next_up()),
        (WHEEL, FORWARD, |c| wheel(c).feed_forward.static_duty = -0.01),
        (WHEEL, FORWARD, |c| wheel(c).feed_forward.static_duty = 0.9),
        (WHEEL, FORWARD, |c| wheel(c).feed_forward.duty_per_speed = f32::NAN),
        (WHEEL, FORWARD, |c| wheel(c).feed_forward.duty_per_acceleration = -f32::MIN_POSITIVE),
        (WHEEL, CASCADE, |c| wheel(c).cascade_per_s = -0.001),
        (WHEEL, CASCADE, |c| wheel(c).cascade_per_s = 1000.0f32.next_up()),
        (WHEEL, CASCADE, |c| wheel(c).cascade_per_s = f32::NAN),
        (WHEEL, SETTLE, |c| wheel(c).settle.error = 0.0),
        (WHEEL, SETTLE, |c| wheel(c).settle.speed = f32::NAN),
        (WHEEL, STALL, |c| wheel(c).stall.duty = 0.0),
        (WHEEL, STALL, |c| wheel(c).stall.travel = f32::INFINITY),
        (WHEEL, STALL, |c| wheel(c).stall.time_ms = 0),
        (WHEEL, UNSEEN, |c| wheel(c).stall.duty = 0.9),
        (WHEEL, FOLLOW, |c| wheel(c).follow.error = f32::NAN),
        (WHEEL, FOLLOW, |c| wheel(c).follow.time_ms = 0),
        (ARM, HOMING, |c| home(c).switch = 4),
        (ARM, HOMING, |c| home(c).position = -8.0f32.next_up()),
        (ARM, HOMING, |c| home(c).position = f32::NAN),
        (ARM, HOMING, |c| home(c).speed_max = 0.0),
        (ARM, HOMING, |c| home(c).speed_max = 20.0f32.next_up()),
        (ARM, SWITCH, |c| home(c).switch = 2),
        (WHEEL, PULSE, |c| home(c).switch = 0),
        (WHEEL, PULSE, |c| slide_home(c).switch = 0),
        (WHEEL, PULSE, |c| _ = c.switches.remove(0)),
        (HIP, ANGLE, |c| hip(c, |angle, _| *angle = 6)),
        (HIP, ANGLE, |c| hip(c, |angle, _| *angle = u8::MAX)),
        (HIP, ANGLE, |c| c.sensors.truncate(1)),
        (HIP, ANGLE, |c| {
            loops(c, 3).homing = None;
            loops(c, 3).position = Range::symmetric(3.0);
            loops(c, 3).feedback = loops(c, 4).feedback;
        }),
        (HIP, "the rate_hz of a motor's angle sensor must be at least 250", |c| c.sensors[1].rate_hz = 249),
        // 1.5708 rad in 20 ms.
        (HIP, "speed_max must turn less than a quarter of a turn in five readings of the angle sensor", |c| {
            loops(c, 4).speed_max = 78.6;
        }),
        (HIP, ZERO, |c| hip(c, |_, zero| *zero = -0.01)),
        (HIP, ZERO, |c| hip(c, |_, zero| *zero = 6.3)),
        (HIP, ZERO, |c| hip(c, |_, zero| *zero = f32::NAN)),
        (HIP, FAR, |c| loops(c, 4).position.max = 2e6),
        (HIP, "an angle sensor with a range within one turn needs no homing", |c| {
            loops(c, 4).homing = Some(HomingConfig { switch: 0, position: 0.0, speed_max: 0.5 });
        }),
        (HIP, "pulses need range connector 0 or 1, whose edges a timer captures", |c| pulses(c, 2, 230)),
        (HIP, FRAMES, |c| pulses(c, 1, 460)),
        (HIP, FRAMES, |c| pulses(c, 1, 0)),
        (HIP, ALONE, |c| pulses(c, 0, 230)),
        (HIP, ALONE, |c| {
            pulses(c, 1, 230);
            c.ranges.clear();
            loops(c, 3).homing = None;
            loops(c, 3).position = Range::symmetric(3.0);
            loops(c, 3).feedback = loops(c, 4).feedback;
        }),
        (ROD, "motor_side is for motors that turn", |c| loops(c, 1).motor_side = wheel(c).motor_side),
        (WHEEL, "the motor side's encoder must exist and be used by one motor", |c| side(c).index = 4),
        (WHEEL, ENCODER, |c| side(c).index = 0),
        (ARM, ENCODER, |c| side(c).index = 1),
        (WHEEL, SIDE, |c| side(c).counts_per_turn = 0),
        (WHEEL, SIDE, |c| side(c).counts_per_turn = MAX_EXACT + 1),
        // 9600 counts at 32.7 rad/s are 50 in a millisecond.
        (WHEEL, "encoder 3 counts by interrupts, at most 50 counts a ms at speed_max: use encoders 0 to 2", |c| {
            (side(c).index, wheel(c).speed_max) = (3, 32.8);
        }),
        (WHEEL, FAR, |c| (side(c).counts_per_turn, wheel(c).position.max) = (MAX_EXACT, 400.0)),
        (WHEEL, GAP, |c| side(c).gap_max = 0.0),
        (WHEEL, GAP, |c| side(c).gap_max = 6.3),
        (WHEEL, GAP, |c| side(c).gap_max = f32::NAN),
        (WHEEL, "the force sensor's analog input must be in the list of analog inputs", |c| {
            force(c).sensor = ForceSensor::Analog { analog: 3, zero_v: 0.5, newtons_per_v: 10.0 };
        }),
        (WHEEL, FORCE_SENSOR, |c| {
            force(c).sensor = ForceSensor::Analog { analog: 4, zero_v: f32::NAN, newtons_per_v: 10.0 };
        }),
        (WHEEL, FORCE_SENSOR, |c| {
            force(c).sensor = ForceSensor::Analog { analog: 4, zero_v: 0.5, newtons_per_v: 0.0 };
        }),
        (WHEEL, "the motor's load cell must be in the list of sensors", |c| {
            force(c).sensor = ForceSensor::LoadCell { force: 3 };
        }),
        (WHEEL, "the rate_hz of a motor's load cell must be at least 250", |c| {
            let chip = SensorChip::Nau7802(Nau7802Config { gain: 128, newtons_per_mv_v: 50.0, zero_mv_v: 0.0 });
            let cell = SensorConfig { id: id(Force, 3), address: 0x2A, rate_hz: 80, chip };
            c.sensors.push(cell).expect("room");
            force(c).sensor = ForceSensor::LoadCell { force: 3 };
        }),
        (WHEEL, "force range must have a finite min below a finite max", |c| force(c).range = Range::new(5.0, 5.0)),
        (WHEEL, "force_limit must be above all forces of the range", |c| force(c).limit_n = 20.0),
        (WHEEL, "force_limit must be above all forces of the range", |c| force(c).range.min = -30.0),
        (WHEEL, "force_gain must be finite and other than 0", |c| force(c).speed_per_n = 0.0),
        (WHEEL, "approach_speed must be positive and at most speed_max", |c| force(c).approach_speed = 20.5),
        (WHEEL, "contact_force must be positive, below force_limit", |c| force(c).contact_n = 30.0),
        (WHEEL, "force_error must be positive", |c| force(c).error_n = 0.0),
        (WHEEL, "a force's filter_s must be 0 to 1, its drift_s not negative", |c| force(c).filter_s = 1.5),
        (WHEEL, "a force's filter_s must be 0 to 1, its drift_s not negative", |c| force(c).drift_s = -1.0),
        (Some(id(Stepper, 3)), SWITCH, |c| slide_home(c).switch = 1),
    ]
};

const OUTPUTS: &[Case] = {
    const VOLTS: &str = "voltages must lie between 0 and the DAC's full scale";
    const SIDE: &str = "full speed backwards must be on the other side of neutral";
    const DAC_OUTPUTS: &str = "DAC outputs must be 0 to 3, each used once";
    const BITS: &str = "expander bits must be 0 to 15, each used once";
    const PULSES: &str = "servo pulses are 0.5 to 2.5 ms, the low point's shorter than the high point's";
    const ANGLES: &str = "a servo's two angles must differ";
    const SERVO_OUTPUTS: &str = "servo outputs must be 0 to 15, each used once";
    const SERVO: Option<ChannelId> = Some(id(Servo, 0));
    const STEPPER: Option<ChannelId> = Some(id(Stepper, 0));
    const STEPS: &str = "steps_per_turn must be 1 to 16777216";
    const POSITION: &str = "position must have a finite min below a finite max";
    const FAR: &str = "position must be within 1e9 steps of 0";
    const RATE: &str = "speed_max must be positive, and no more than rate_max_hz pulses per second";
    const STOP: &str = "stop_brake_ms must be at most 5000";
    const ACCELERATION: &str = "acceleration must be positive, jerk and start_speed not negative";
    const HOMING: &str =
        "homing needs a switch from 0 to 3, a position in range and a positive speed of at most speed_max";
    const RANGE_V: &str = "range_v must lie between 0 and 3.3 V";
    const SAFE_V: &str = "safe_v must lie between 0 and 3.3 V";
    &[
        (Some(id(Bldc, 0)), "a brushless drive needs bldc_dac", |c| c.bldc_dac = None),
        (Some(id(Dac, 0)), "a brushless drive needs a bldc channel name", |c| c.bldcs[0].id = id(Dac, 0)),
        (Some(id(Bldc, 0)), VOLTS, |c| {
            c.bldc_dac = Some(DacChipConfig { full_scale_v: 3.3, ..c.bldc_dac.expect("one") });
        }),
        (Some(id(Bldc, 0)), VOLTS, |c| c.bldcs[0].neutral_v = -0.1),
        (Some(id(Bldc, 0)), VOLTS, |c| c.bldcs[0].forward_v = f32::NAN),
        (Some(id(Bldc, 2)), VOLTS, |c| c.bldcs[2].reverse = Reverse::Voltage { full_v: -0.5 }),
        (Some(id(Bldc, 0)), "forward_v must differ from neutral_v", |c| c.bldcs[0].neutral_v = 5.0),
        (Some(id(Bldc, 2)), SIDE, |c| c.bldcs[2].reverse = Reverse::Voltage { full_v: 3.0 }),
        (Some(id(Bldc, 2)), SIDE, |c| c.bldcs[2].reverse = Reverse::Voltage { full_v: 2.5 }),
        (Some(id(Bldc, 0)), "slew_per_s must be positive", |c| c.bldcs[0].slew_per_s = 0.0),
        (Some(id(Bldc, 1)), STOP, |c| c.bldcs[1].stop_brake_ms = 5001),
        (Some(id(Bldc, 0)), "a brushless drive needs its brake line for a stop that brakes", |c| {
            c.bldcs[0].stop_brake_ms = 1;
        }),
        (Some(id(Bldc, 0)), DAC_OUTPUTS, |c| c.bldcs[0].output = 4),
        (Some(id(Bldc, 2)), DAC_OUTPUTS, |c| c.bldcs[2].output = 1),
        (Some(id(Bldc, 1)), BITS, |c| c.bldcs[1].brake = Some(DriveLine { bit: 16, active_low: false })),
        (Some(id(Bldc, 1)), BITS, |c| c.bldcs[1].brake = Some(DriveLine { bit: 0, active_low: false })),
        (Some(id(Bldc, 1)), "the lines of a brushless drive need the expander", |c| c.expander = None),
        (Some(id(Osmc, 0)), "a relay needs a relay channel name", |c| c.relays[0].id = id(Osmc, 0)),
        (Some(id(Relay, 0)), "a relay needs the expander", |c| {
            c.expander = None;
            c.bldcs.clear();
        }),
        (Some(id(Relay, 0)), BITS, |c| c.relays[0].bit = 16),
        (Some(id(Relay, 0)), BITS, |c| c.relays[0].bit = 1), // the brake's
        (Some(id(Relay, 1)), BITS, |c| c.relays[1].bit = 8),
        (SERVO, "a servo needs servo_pwm", |c| c.servo_pwm = None),
        (Some(id(Osmc, 3)), "a servo needs a servo channel name", |c| c.servos[0].id = id(Osmc, 3)),
        (SERVO, PULSES, |c| c.servos[0].low.pulse_s = 499e-6),
        (SERVO, PULSES, |c| c.servos[0].high.pulse_s = 2501e-6),
        (SERVO, PULSES, |c| c.servos[0].high.pulse_s = 1e-3),
        (SERVO, PULSES, |c| c.servos[0].low.pulse_s = f32::NAN),
        (SERVO, ANGLES, |c| c.servos[0].low.angle_rad = 0.75),
        (SERVO, ANGLES, |c| c.servos[0].low.angle_rad = f32::NAN),
        (SERVO, ANGLES, |c| c.servos[0].low.angle_rad = f32::MIN),
        (SERVO, "speed_max must be positive", |c| c.servos[0].speed_max = 0.0),
        (SERVO, SERVO_OUTPUTS, |c| c.servos[0].output = 16),
        (Some(id(Servo, 15)), SERVO_OUTPUTS, |c| c.servos[1].output = 0),
        (STEPPER, "a stepper needs stepper_bank", |c| c.stepper_bank = None),
        (Some(id(Osmc, 3)), "a stepper needs a stepper channel name", |c| c.steppers[0].id = id(Osmc, 3)),
        (Some(id(Stepper, 4)), "steppers are numbered 0 to 3", |c| c.steppers[0].id.index = 4),
        (STEPPER, STEPS, |c| c.steppers[0].steps_per_turn = 0),
        (STEPPER, STEPS, |c| c.steppers[0].steps_per_turn = MAX_EXACT + 1),
        (STEPPER, POSITION, |c| c.steppers[0].position = Range::new(0.0, 0.0)),
        (STEPPER, POSITION, |c| c.steppers[0].position.max = f32::NAN),
        (STEPPER, FAR, |c| c.steppers[0].position.max = 2e6),
        (STEPPER, FAR, |c| c.steppers[0].position.min = -2e6),
        (STEPPER, RATE, |c| c.steppers[0].speed_max = 0.0),
        (STEPPER, RATE, |c| c.steppers[0].speed_max = 98.2), // 50 kHz * 2 pi / 3200 is 98.17 rad/s
        (STEPPER, RATE, |c| c.steppers[0].speed_max = f32::NAN),
        (STEPPER, ACCELERATION, |c| c.steppers[0].acceleration = 0.0),
        (STEPPER, ACCELERATION, |c| c.steppers[0].jerk = -1.0),
        (STEPPER, ACCELERATION, |c| c.steppers[0].jerk = f32::MIN_POSITIVE),
        (STEPPER, ACCELERATION, |c| c.steppers[0].start_speed = f32::NAN),
        (STEPPER, STOP, |c| c.steppers[0].stop_brake_ms = 5001),
        (STEPPER, "start_speed must be at most speed_max", |c| c.steppers[0].start_speed = 60.0f32.next_up()),
        (Some(id(Stepper, 3)), HOMING, |c| slide_home(c).speed_max = 60.0f32.next_up()),
        (Some(id(Stepper, 3)), HOMING, |c| slide_home(c).position = 101.0),
        (Some(id(Osmc, 3)), "an analog output needs a dac channel name", |c| c.dacs[0].id = id(Osmc, 3)),
        (Some(id(Dac, 2)), "analog outputs are numbered 0 and 1", |c| c.dacs[0].id.index = 2),
        (Some(id(Dac, 0)), RANGE_V, |c| c.dacs[0].range_v = Range::new(1.0, 1.0)),
        (Some(id(Dac, 0)), RANGE_V, |c| c.dacs[0].range_v.min = -0.1),
        (Some(id(Dac, 1)), RANGE_V, |c| c.dacs[1].range_v.max = 3.3f32.next_up()),
        (Some(id(Dac, 0)), RANGE_V, |c| c.dacs[0].range_v.max = f32::NAN),
        (Some(id(Dac, 0)), SAFE_V, |c| c.dacs[0].safe_v = -0.1),
        (Some(id(Dac, 0)), SAFE_V, |c| c.dacs[0].safe_v = f32::NAN),
    ]
};

const INPUTS: &[Case] = {
    const COUNTS: &str = "counts_per_turn must be 1 to 16777216";
    const RANGE_M: &str = "range_m must lie between 0.02 and 4 m";
    const STOP: &str = "stop_below_m must lie within range_m and above its min, or nothing is ever nearer";
    const SENSOR: Option<ChannelId> = Some(id(RangeSensor, 0));
    const ANALOG: Option<ChannelId> = Some(id(Analog, 4));
    const PLAUSIBLE: &str = "plausible_v must have a finite min below a finite max";
    const PER_CODE: &str = "volts_per_code must be positive";
    const ONCE: &str = "the analog input must exist and be used once";
    const RANGE_V: &str = "range_v must have a finite min below a finite max";
    const REGENERATION: &str = "regeneration_v must lie within range_v and below its max";
    const TOP: &str = "range_v must end below the converter's highest voltage, or a higher one is never seen";
    &[
        (Some(id(Osmc, 3)), "an encoder needs an encoder channel name", |c| c.encoders[0].id = id(Osmc, 3)),
        (Some(id(Encoder, 4)), "encoders are numbered 0 to 3", |c| c.encoders[0].id.index = 4),
        (Some(id(Encoder, 0)), COUNTS, |c| c.encoders[0].counts_per_turn = 0),
        (Some(id(Encoder, 0)), COUNTS, |c| c.encoders[0].counts_per_turn = MAX_EXACT + 1),
        (Some(id(Osmc, 3)), "a switch needs a switch channel name", |c| c.switches[0].id = id(Osmc, 3)),
        (Some(id(Switch, 4)), "switches are numbered 0 to 3", |c| c.switches[0].id.index = 4),
        (Some(id(Osmc, 3)), "a range sensor needs a range channel name", |c| c.ranges[0].id = id(Osmc, 3)),
        (Some(id(RangeSensor, 4)), "range sensors are numbered 0 to 3", |c| c.ranges[0].id.index = 4),
        (SENSOR, RANGE_M, |c| c.ranges[0].range_m.min = 0.01),
        (SENSOR, RANGE_M, |c| c.ranges[0].range_m.max = 4.01),
        (SENSOR, RANGE_M, |c| c.ranges[0].range_m = Range::new(1.0, 1.0)),
        (SENSOR, RANGE_M, |c| c.ranges[0].range_m.max = f32::NAN),
        (SENSOR, STOP, |c| c.ranges[0].stop_below_m = Some(0.02)),
        (SENSOR, STOP, |c| c.ranges[0].stop_below_m = Some(4.0f32.next_up())),
        (SENSOR, STOP, |c| c.ranges[0].stop_below_m = Some(f32::NAN)),
        (Some(id(Osmc, 3)), "an analog input needs an analog channel name", |c| c.analogs[0].id = id(Osmc, 3)),
        (Some(id(Analog, 6)), "analog inputs are numbered 0 to 5", |c| c.analogs[0].id.index = 6),
        (ANALOG, PER_CODE, |c| c.analogs[0].volts_per_code = 0.0),
        (ANALOG, "offset_v must be finite", |c| c.analogs[0].offset_v = f32::NEG_INFINITY),
        (ANALOG, PLAUSIBLE, |c| c.analogs[0].plausible_v = Range::new(1.0, 1.0)),
        (ANALOG, PLAUSIBLE, |c| c.analogs[0].plausible_v.max = f32::NAN),
        (Some(id(Analog, 0)), ONCE, |c| c.analogs[0].id.index = 0), // the rod's
        (Some(id(Supply, 0)), ONCE, |c| c.supplies[0].analog = 6),
        (Some(id(Supply, 0)), ONCE, |c| c.supplies[0].analog = 4),
        (Some(id(Supply, 1)), ONCE, |c| c.supplies[1].analog = 1),
        (Some(id(Osmc, 3)), "a supply needs a supply channel name", |c| c.supplies[0].id = id(Osmc, 3)),
        (Some(id(Supply, 0)), PER_CODE, |c| c.supplies[0].volts_per_code = f32::NAN),
        (Some(id(Supply, 0)), RANGE_V, |c| c.supplies[0].range_v = Range::new(30.0, 20.0)),
        (Some(id(Supply, 1)), RANGE_V, |c| c.supplies[1].range_v.max = f32::INFINITY),
        (Some(id(Supply, 0)), TOP, |c| c.supplies[0].range_v.max = 32.8), // 65535 * 0.5 mV is 32.77 V
        (Some(id(Supply, 0)), TOP, |c| c.supplies[0].range_v.max = 65_535.0 * c.supplies[0].volts_per_code),
        (Some(id(Supply, 0)), REGENERATION, |c| c.supplies[0].regeneration_v = Some(30.0)),
        (Some(id(Supply, 1)), REGENERATION, |c| c.supplies[1].regeneration_v = Some(19.9)),
        (Some(id(Supply, 1)), REGENERATION, |c| c.supplies[1].regeneration_v = Some(f32::NAN)),
    ]
};

/// Second channel of each kind with the first one's name. For motors another rule, on the bridge connector, comes
/// first.
const TWICE: &[Case] = {
    const RULE: &str = "the channel is named twice";
    &[
        (Some(id(Bldc, 0)), RULE, |c| c.bldcs[1].id.index = 0),
        (Some(id(Servo, 0)), RULE, |c| c.servos[1].id.index = 0),
        (Some(id(Stepper, 0)), RULE, |c| c.steppers[1].id.index = 0),
        (Some(id(Relay, 0)), RULE, |c| c.relays[1].id.index = 0),
        (Some(id(Dac, 0)), RULE, |c| c.dacs[1].id.index = 0),
        (Some(id(Encoder, 0)), RULE, |c| c.encoders[1].id.index = 0),
        (Some(id(Switch, 1)), RULE, |c| {
            *index_pulse(c) = 0;
            c.switches[0].id.index = 1;
        }),
        (Some(id(RangeSensor, 0)), RULE, |c| c.ranges[1].id.index = 0),
        (Some(id(Supply, 0)), RULE, |c| c.supplies[1].id.index = 0),
    ]
};

const SENSORS: &[Case] = {
    const IMU0: Option<ChannelId> = Some(id(Imu, 0));
    const TAKEN: &str = "the address belongs to another chip on the bus";
    const RATE: &str = "the chip cannot be read at this rate_hz";
    const ACCELERATION: &str = "acceleration_max_g must be 2, 4, 8 or 16";
    const TURNING: &str = "rate_max_deg_s must be 250, 500, 1000 or 2000";
    fn imu(config: &mut BoardConfig) -> &mut Icm20948Config {
        let SensorChip::Icm20948(imu) = &mut config.sensors[0].chip else { panic!("the IMU") };
        imu
    }
    fn second(config: &mut BoardConfig, address: u8) {
        let second = SensorConfig { id: id(Imu, 1), address, ..config.sensors[0] };
        config.sensors.push(second).expect("room");
    }
    fn cell(config: &mut BoardConfig, rate_hz: u16, gain: u8, newtons_per_mv_v: f32, zero_mv_v: f32) {
        let chip = SensorChip::Nau7802(Nau7802Config { gain, newtons_per_mv_v, zero_mv_v });
        config.sensors[0] = SensorConfig { id: id(Force, 0), address: 0x2A, rate_hz, chip };
    }
    const CELL0: Option<ChannelId> = Some(ChannelId::new(Force, 0));
    const GAIN: &str = "gain must be 1, 2, 4, 8, 16, 32, 64 or 128";
    const CONVERSIONS: &str = "rate_hz must be 10, 20, 40, 80 or 320";
    &[
        (Some(id(Dhb, 7)), "the channel's name must be of the kind that the chip measures", |c| {
            c.sensors[0].id = id(Dhb, 7);
        }),
        (IMU0, "the chip cannot have this address", |c| c.sensors[0].address = 0x6A),
        (IMU0, RATE, |c| c.sensors[0].rate_hz = 4),
        (IMU0, RATE, |c| c.sensors[0].rate_hz = 401),
        (IMU0, ACCELERATION, |c| imu(c).acceleration_max_g = 3),
        (IMU0, TURNING, |c| imu(c).rate_max_deg_s = 125),
        (Some(id(Current, 0)), "shunt_ohm must be positive", |c| {
            let chip = SensorChip::Ina226(Ina226Config { shunt_ohm: 0.0 });
            c.sensors[0] = SensorConfig { id: id(Current, 0), address: 0x45, rate_hz: 10, chip };
        }),
        (Some(id(Angle, 7)), "averages must be 2, 4, 8 or 16", |c| {
            c.sensors[1].chip = SensorChip::As5600(As5600Config { averages: 3 });
        }),
        (Some(id(Angle, 7)), RATE, |c| c.sensors[1].rate_hz = 1001),
        (CELL0, CONVERSIONS, |c| cell(c, 100, 128, 24.5, 0.0)),
        (Some(id(Distance, 3)), "rate_hz must be 1, 2, 4, 5, 10, 20, 25 or 50", |c| {
            let chip = SensorChip::Vl6180x(Vl6180xConfig {});
            c.sensors[0] = SensorConfig { id: id(Distance, 3), address: 0x29, rate_hz: 30, chip };
        }),
        (CELL0, GAIN, |c| cell(c, 80, 0, 24.5, 0.0)),
        (CELL0, GAIN, |c| cell(c, 80, 96, 24.5, 0.0)),
        (CELL0, "newtons_per_mv_v must be positive or negative", |c| cell(c, 80, 128, 0.0, 0.0)),
        (CELL0, "newtons_per_mv_v must be positive or negative", |c| cell(c, 80, 128, f32::NAN, 0.0)),
        (CELL0, "zero_mv_v must be within 500 mV/V divided by gain", |c| cell(c, 80, 128, -24.5, 3.91)),
        (Some(id(Imu, 1)), TAKEN, |c| second(c, 0x68)),
        (IMU0, TAKEN, |c| c.dhb_pwm.as_mut().expect("it has one").address = 0x68),
        // 2 x 250 periods of 2 ms; a period has room for 760 bits.
        (IMU0, "rate_hz is too high: each transfer of a reading takes a control period", |c| {
            (c.control_period_us, c.sensors[0].rate_hz) = (2000, 251);
        }),
        // 309 bits, 171 of them for three OSMC bridges: the longest transfer needs 138.
        (IMU0, "the outputs' writes leave no room on the bus for this sensor", |c| {
            (c.i2c_hz, c.control_period_us) = (400_000, 812);
        }),
        // Of 380 bits three OSMC bridges leave 209: half of that is 104 500 bits a second, 590 readings of 177 bits.
        (
            Some(id(Imu, 1)),
            "the sensors' readings must fit half of what the OSMC bridges leave of the bus: lower rate_hz",
            |c| {
                c.sensors[0].rate_hz = 296;
                second(c, 0x69);
            },
        ),
    ]
};

const GROUPS: [&[Case]; 7] = [BOARD, MOTORS, LOOPS, OUTPUTS, INPUTS, TWICE, SENSORS];

#[test]
fn each_change_breaks_its_rule() {
    // The change alone must break the rule.
    assert_eq!(good().validate(), Ok(()));
    for (group, cases) in GROUPS.into_iter().enumerate() {
        for (number, (channel, rule, change)) in cases.iter().enumerate() {
            let mut config = good();
            change(&mut config);
            let expected = Err(ConfigError { channel: *channel, rule });
            assert_eq!(config.validate(), expected, "case {number} of group {group}");
        }
    }
}

/// Reads the rules from the sources: texts with a space in them and nothing to fill in.
#[test]
fn no_rule_is_without_a_change_that_breaks_it() {
    let sources = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("src/config");
    let broken: BTreeSet<_> = GROUPS.into_iter().flatten().map(|(_, rule, _)| (*rule).to_owned()).collect();
    let mut known = BTreeSet::new();
    // A rule without a case here would be untested.
    for file in fs::read_dir(sources).expect("the sources are beside the tests") {
        let path = file.expect("an entry").path();
        // Rules of a single number: `parameters.rs` has its tests.
        if path.ends_with("numbers.rs") {
            continue;
        }
        let source = fs::read_to_string(&path).expect("a source");
        let code = source.lines().filter(|line| !line.trim_start().starts_with("//"));
        known.extend(
            code.filter_map(|line| line.split('"').nth(1))
                .filter(|text| text.contains(' ') && !text.contains('{'))
                .map(str::to_owned),
        );
    }
    let missing: Vec<_> = known.difference(&broken).collect();
    assert!(missing.is_empty(), "nothing here breaks {missing:#?}");
    // Guards the search by text: a changed style of the sources would find none.
    assert!(known.len() > 70, "{} rules found: are they written otherwise now?", known.len());
}

#[test]
fn the_ends_of_what_is_allowed_are_taken() {
    let ends: &[fn(&mut BoardConfig)] = &[
        |c| {
            c.motors.clear();
            c.control_period_us = 500;
        },
        |c| {
            // The hip's angle sensor must go too: its readings do not fit this period.
            c.motors.pop();
            c.sensors.truncate(1);
            c.control_period_us = 20_000;
        },
        |c| c.link_timeout_ms = 20,
        |c| c.link_timeout_ms = 1000,
        |c| c.can.kbit_per_s = 125,
        |c| c.can.node = 127,
        |c| (c.can.kbit_per_s, c.can.data_kbit_per_s) = (500, 500),
        |c| c.can.data_kbit_per_s = 2000,
        |c| {
            c.motors.clear();
            c.sensors.truncate(1);
            (c.i2c_hz, c.control_period_us) = (10_000, 20_000);
        },
        |c| c.air_temperature_c = -40.0,
        |c| c.air_temperature_c = 60.0,
        |c| c.osmc_pwm.as_mut().expect("one").frequency_hz = 24.0,
        |c| c.osmc_pwm.as_mut().expect("one").address = 0x77,
        |c| c.osmc_pwm.as_mut().expect("one").address = 0x6F,
        |c| c.servo_pwm.as_mut().expect("one").frequency_hz = 330.0,
        |c| c.servo_pwm.as_mut().expect("one").oscillator_hz = 30e6,
        |c| c.bldc_dac.as_mut().expect("one").full_scale_v = 5.5,
        |c| c.expander = Some(ExpanderConfig { address: 0x27 }),
        |c| c.stepper_bank.as_mut().expect("one").rate_max_hz = 100e3,
        |c| c.stepper_bank.as_mut().expect("one").enable_setup_us = 1_000_000,
        |c| c.stepper_bank.as_mut().expect("one").direction_setup_us = 0,
        |c| c.motors[0].duty_max = DUTY_HARD_MAX,
        |c| c.motors[2].id.index = 3,
        |c| c.motors[2].stop_brake_ms = 5000,
        |c| c.motors[2].stop_brake_ms = 90, // 0.9 at 10 per second
        |c| c.motors[0].bridge = osmc(15, 12, 14, 13),
        |c| c.motors[3].bridge = dhb(13, 15, 14),
        |c| c.bldcs[1].stop_brake_ms = 5000,
        |c| encoder(c, |_, counts| *counts = MAX_EXACT),
        |c| {
            *index_pulse(c) = 0;
            encoder(c, |index, _| *index = 3);
        },
        |c| (wheel(c).motor_side, wheel(c).position.max) = (None, 2.6e6), // 0.993e9 counts
        |c| loops(c, 1).position = Range::new(0.0, 0.1),
        |c| pot(c, |_, low, _| low.code = 65_279),
        |c| pot(c, |_, _, high| high.code = 256),
        |c| pot(c, |_, low, high| low.code = high.code + 1024),
        |c| c.sensors[1].rate_hz = 1000,
        |c| hip(c, |_, zero| *zero = core::f32::consts::TAU),
        |c| loops(c, 4).speed_max = 78.5,
        |c| pulses(c, 1, 230),
        |c| pulses(c, 1, 115),
        |c| {
            *index_pulse(c) = 0;
            loops(c, 4).homing = Some(HomingConfig { switch: 0, position: 0.0, speed_max: 0.5 });
            loops(c, 4).position = Range::symmetric(3.2);
        },
        |c| side(c).counts_per_turn = MAX_EXACT,
        |c| side(c).gap_max = 6.2,
        |c| wheel(c).speed_filter_s = 0.0,
        |c| wheel(c).speed_filter_s = 1.0,
        |c| wheel(c).profile.speed = 20.0,
        |c| wheel(c).profile.jerk = 0.0,
        |c| *index_pulse(c) = 0,
        |c| *index_pulse(c) = 16,
        |c| wheel(c).position_pid = PidGains { kp: 0.0, ki: 0.0, kd: PidGains::MAX },
        |c| wheel(c).feed_forward = FeedForward { static_duty: 0.0, duty_per_speed: 0.0, duty_per_acceleration: 0.0 },
        |c| wheel(c).cascade_per_s = 0.0,
        |c| wheel(c).cascade_per_s = 1000.0,
        |c| wheel(c).settle.time_ms = 0,
        |c| home(c).position = -8.0,
        |c| home(c).speed_max = 20.0,
        |c| c.bldcs[2].reverse = Reverse::Voltage { full_v: 0.0 },
        |c| (c.bldcs[2].forward_v, c.bldcs[2].reverse) = (0.5, Reverse::Voltage { full_v: 4.5 }),
        |c| c.servos[0].low.pulse_s = 500e-6,
        |c| c.servos[0].high.pulse_s = 2500e-6,
        |c| c.steppers[0].jerk = 0.0,
        |c| c.steppers[0].start_speed = 60.0,
        |c| c.steppers[0].speed_max = 98.1,
        |c| c.dacs[0].range_v = Range::new(0.0, 3.3),
        |c| c.dacs[0].safe_v = 0.0,
        |c| c.ranges[0].stop_below_m = Some(4.0),
        |c| c.ranges[0].stop_below_m = Some(0.02f32.next_up()),
        |c| c.supplies[0].range_v.max = 32.7,
        |c| c.supplies[0].range_v.min = -1.0,
    ];
    for (number, change) in ends.iter().enumerate() {
        let mut config = good();
        change(&mut config);
        assert_eq!(config.validate(), Ok(()), "end number {number}");
    }
}

/// Checks the room on the bus. A transfer has nine bits a byte and three more. One period must have room for all lines
/// of a bridge, 18 bytes, or 6 bytes for each OSMC bridge and the longest other transfer: 14 bytes for a DHB, 5 and 4
/// to read a PWM chip's mode back, 9 for the DAC.
#[test]
fn a_period_has_room_for_every_output() {
    let with = |motors: &[usize], bldcs: bool| {
        let mut config = good();
        config.sensors.clear();
        config.motors = motors.iter().map(|motor| good().motors[*motor]).collect();
        if !bldcs {
            config.bldcs.clear();
        }
        // At 100 kHz a bit takes a whole number of microseconds.
        config.i2c_hz = 100_000;
        config
    };
    // Motors 0 to 2 are on OSMC bridges, 3 is on a DHB.
    for (config, bits) in [
        (with(&[], false), 57),
        (with(&[], true), 84),
        (with(&[2], false), 165),
        (with(&[2], true), 165),
        (with(&[0, 2], true), 2 * 57 + 87),
        (with(&[3], true), 129),
        (with(&[2, 3], true), 57 + 129),
        (with(&[0, 1, 2, 3], true), 3 * 57 + 129),
    ] {
        // A bit takes 10 us, and 5 % of the period are the processor's.
        let period_us = 10 * u32::div_ceil(bits * 100, 95);
        let validate = |control_period_us| BoardConfig { control_period_us, ..config.clone() }.validate();
        let rule = "i2c_hz and control_period_us must leave room for every output in a period";
        assert_eq!(validate(period_us), Ok(()), "{bits} bits in {period_us} us");
        assert_eq!(validate(period_us - 1), Err(ConfigError { channel: None, rule }), "{bits} bits");
    }
}

#[test]
fn a_board_knows_which_inputs_it_uses() {
    let mut config = good();
    let used = |config: &BoardConfig| [0, 1, 2, 3].map(|index| (config.uses_encoder(index), config.uses_range(index)));
    // Encoder 0 is the wheel's and a channel, 1 the arm's, 2 on the motor's side of the wheel's play, 3 a channel.
    assert_eq!(used(&config), [(true, true), (true, true), (true, false), (true, false)]);
    config.motors.clear();
    assert_eq!(used(&config), [(true, true), (false, true), (false, false), (true, false)]);
    config.encoders.clear();
    config.ranges.clear();
    assert_eq!(used(&config), [(false, false); 4]);
}

#[test]
fn a_controlled_stop_takes_as_long_as_the_slowest_channel() {
    let mut config = good();
    for motor in &mut config.motors {
        motor.stop_brake_ms = 0;
    }
    assert_eq!(config.stop_brake_ms(), 0, "nothing brakes");
    config.steppers[1].stop_brake_ms = 100;
    assert_eq!(config.stop_brake_ms(), 100);
    config.motors[2].stop_brake_ms = 300;
    config.bldcs[1].stop_brake_ms = 200;
    assert_eq!(config.stop_brake_ms(), 300);
    config.bldcs[1].stop_brake_ms = 400;
    assert_eq!(config.stop_brake_ms(), 400);
}

/// Leaves out the chips and lists that nothing needs.
#[test]
fn a_board_with_nothing_on_it_is_taken() {
    let mut config = good();
    config.motors.clear();
    config.bldcs.clear();
    config.servos.clear();
    config.steppers.clear();
    config.relays.clear();
    config.dacs.clear();
    config.encoders.clear();
    config.switches.clear();
    config.ranges.clear();
    config.analogs.clear();
    config.supplies.clear();
    config.sensors.clear();
    config.osmc_pwm = None;
    config.dhb_pwm = None;
    config.servo_pwm = None;
    config.bldc_dac = None;
    config.expander = None;
    config.stepper_bank = None;
    assert_eq!(config.validate(), Ok(()));
    config.auxiliary_stop = false;
    // Every board has the dead-man's handle.
    assert!(config.channels().eq([(id(DeadMan, 0), Place::DeadMan(0))]));
}

#[test]
fn channels_are_in_the_order_of_the_lists_and_found_by_name() {
    let config = good();
    let names: Vec<_> = config.channels().map(|(id, _)| id.to_string()).collect();
    assert_eq!(
        names.join(" "),
        "osmc0 actuator1 osmc2 dhb0 dhb1 bldc0 bldc1 bldc2 servo0 servo15 stepper0 stepper3 relay0 relay1 dac0 dac1 \
         encoder0 encoder3 switch0 switch1 switch3 range0 range1 analog4 analog5 supply0 supply1 imu0 angle7 dead-man0 dead-man1"
    );
    for (id, place) in config.channels() {
        assert_eq!(config.place(id), Some(place));
    }
    assert_eq!(config.place(id(Dhb, 0)), Some(Place::Motor(3)));
    assert_eq!(config.place(id(Dhb, 2)), None);
}

#[test]
fn an_error_names_its_channel() {
    let error = ConfigError { channel: ROD, rule: "speed_max must be positive" };
    assert_eq!(error.to_string(), "actuator1: speed_max must be positive");
    let error = ConfigError { channel: None, rule: "link_timeout_ms must be 20 to 1000" };
    assert_eq!(error.to_string(), "link_timeout_ms must be 20 to 1000");
}
