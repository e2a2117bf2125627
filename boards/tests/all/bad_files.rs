//! Tests of the error about a file with a mistake: file, line, field, and what is expected.

use std::{fs, path::Path};

use proptest::prelude::*;
use r4_boards::{
    BoardError, Robot, SimulatedDistance, SimulatedEncoder, SimulatedForce, SimulatedPulses, load, load_carrier,
};
use r4_protocol::config::{As5600Config, Feedback, MotorSideConfig, Nau7802Config, SensorChip, Vl6180xConfig};
use tempfile::TempDir;

const ROBOT: &str = include_str!("../../osmc-bench.toml");
const ALL: &str = include_str!("../../every-interface.toml");
const CAR: &str = include_str!("../../openpodcar.toml");
const SKID_STEERED: &str = include_str!("../../openscout.toml");
const TAIL: &str = include_str!("../../balance-tail.toml");
const LOOP: &str = include_str!("../../cable-loop.toml");
const SHELL: &str = include_str!("../../deformobot.toml");
const FINGERS: &str = include_str!("../../two-finger-gripper.toml");
const SUCTION: &str = include_str!("../../suction-pad.toml");
const PICKER: &str = include_str!("../../berry-picker.toml");
const CARRIER: &str = include_str!("../../r4-carrier.toml");

/// One mistake: `from` is replaced once by `to`. The error must name the line that then has `line`, or that of `to`.
struct Mistake {
    from: &'static str,
    to: &'static str,
    line: Option<&'static str>,
    lines_below: usize,
    field: &'static str,
    says: &'static str,
}

const fn mistake(
    from: &'static str,
    to: &'static str,
    line: &'static str,
    field: &'static str,
    says: &'static str,
) -> Mistake {
    Mistake { from, to, line: Some(line), lines_below: 0, field, says }
}

/// Makes a mistake that is reported in its own line.
const fn there(from: &'static str, to: &'static str, field: &'static str, says: &'static str) -> Mistake {
    Mistake { from, to, line: None, lines_below: 0, field, says }
}

impl Mistake {
    /// Expects the error one line after `line`, or after the first of `to`.
    const fn on_the_next_line(mut self) -> Self {
        self.lines_below = 1;
        self
    }
}

const ROBOT_MISTAKES: &[Mistake] = &[
    // Text that is not TOML.
    there("speed_max_rad_s = 5.0", "speed_max_rad_s = ", "osmc[0].speed_max_rad_s", "string values must be quoted"),
    there("kp_duty_per_rad = 4.0", "kp_duty_per_rad = 4.0.0", "osmc[0].position_pid.kp_duty_per_rad", "invalid float"),
    there("[osmc.profile]", "[osmc.profile", "", "expected"),
    mistake(
        "kp_duty_per_rad = 4.0",
        "kp_duty_per_rad = 4.0\nkp_duty_per_rad = 3.0",
        "kp_duty_per_rad = 3.0",
        "",
        "duplicate key",
    ),
    // Wrong types, unknown and missing fields.
    there("link_timeout_ms = 200", "link_timeout_ms = \"200\"", "link_timeout_ms", "expected"),
    there("control_period_us = 1000", "control_period_us = -1", "control_period_us", "expected u32"),
    there("speed_filter_s = 0.010", "speed_filter_ms = 10", "osmc[0].speed_filter_ms", "unknown field"),
    there(
        "static_duty = 0.38",
        "static_duti = 0.38",
        "osmc[0].feed_forward.static_duti",
        "expected one of `static_duty`, `duty_s_per_rad`",
    ),
    there("emf_v = 24.0", "emf = 24.0", "simulation.rail[0].emf", "unknown field `emf`"),
    mistake("speed_max_rad_s = 5.0\n", "", "[[osmc]]", "osmc[0]", "missing field `speed_max_rad_s`"),
    mistake("travel_rad = 0.02\n", "", "[osmc.stall]", "osmc[0].stall", "missing field `travel_rad`"),
    mistake("name = \"osmc-bench\"\n", "", "# The bench", "", "missing field `name`"),
    there("name = \"osmc-bench\"", "name = \"a name that is longer than thirty-two bytes\"", "name", "32"),
    // Numbers out of their range.
    there("control_period_us = 1000", "control_period_us = 100", "control_period_us", "must be 500 to 20000"),
    there("link_timeout_ms = 200", "link_timeout_ms = 2000", "link_timeout_ms", "must be 20 to 1000"),
    there(
        "duty_max = 0.902",
        "duty_max = 0.99",
        "osmc[0].duty_max",
        "0.99 is out of range, must be above 0 and at most",
    ),
    there("duty_max = 0.784", "duty_max = nan", "actuator[0].duty_max", "must be above 0"),
    there("kp_duty_per_rad = 4.0", "kp_duty_per_rad = -4.0", "osmc[0].position_pid.kp_duty_per_rad", "0 or above"),
    there(
        "ki_duty_per_m_s = 1234.0",
        "ki_duty_per_m_s = inf",
        "actuator[0].position_pid.ki_duty_per_m_s",
        "0 or above",
    ),
    there("speed_m_s = 0.008", "speed_m_s = 1e300", "actuator[0].profile.speed_m_s", "above 0"),
    there("jerk_rad_s3 = 50.0", "jerk_rad_s3 = -1.0", "osmc[0].profile.jerk_rad_s3", "0 or above"),
    mistake(
        "_m_s2 = 0.05",
        "_m_s2 = 0.05\njerk_m_s3 = nan",
        "jerk_m_s3",
        "actuator[0].profile.jerk_m_s3",
        "0 or above",
    ),
    mistake(
        "_m_s2 = 0.05",
        "_m_s2 = 0.05\njerk_rad_s3 = 1.0",
        "jerk_rad_s3 = 1.0",
        "actuator[0].profile.jerk_rad_s3",
        "unknown field",
    ),
    there("counts_per_turn = 2400", "counts_per_turn = 0", "osmc[0].encoder.counts_per_turn", "above 0"),
    there("code_16bit = 63357", "code_16bit = 65536", "actuator[0].potentiometer.high.code_16bit", "u16"),
    there("code_10bit = 989.0", "code_10bit = 1024", "simulation.linear[0].potentiometer.high.code_10bit", "0 to 1023"),
    there("min = 20.0, max = 30.0", "min = 30.0, max = 20.0", "supply[0].range_v", "min must be below max"),
    there("max = 0.1 }\nspeed", "max = 1e39 }\nspeed", "actuator[0].position_m", "32-bit"),
    // References to what is not there.
    there("channel = \"osmc0\" #", "channel = \"osmc7\" #", "osmc[0].channel", "no OSMC connector `7`, write 0 to 3"),
    there("channel = \"osmc0\" #", "channel = \"motor0\" #", "osmc[0].channel", "`motor0` is not a channel name"),
    there("channel = \"osmc0\" #", "channel = \"actuator0\" #", "osmc[0].channel", "named osmc"),
    there(
        "channel = \"actuator1\"\nposition",
        "channel = \"osmc1\"\nposition",
        "actuator[0].channel",
        "named actuator",
    ),
    there("channel = \"supply0\" #", "channel = \"analog0\" #", "supply[0].channel", "named supply"),
    there("input = 0\ncounts", "input = 9\ncounts", "osmc[0].encoder.input", "no encoder `9`, write 0 to 3"),
    there("input = 0\nlow = { code_16", "input = 6\nlow = { code_16", "actuator[0].potentiometer.input", "0 to 5"),
    there("analog = 5\nrange_v", "analog = 6\nrange_v", "supply[1].analog", "no analog input `6`, write 0 to 5"),
    there("carrier = \"r4-carrier\"", "carrier = \"r5\"", "carrier", "no carrier `r5`, write r4-carrier"),
    there("plants/osmc-bench-rotary.toml", "plants/no.toml", "simulation.rotary[0].plant", "cannot be read"),
    there("rail = \"supply0\"", "rail = \"supply2\"", "simulation.rotary[0].rail", "write supply0 or supply1"),
    there(
        "encoder = { input = 0, lines",
        "encoder = { input = 4, lines",
        "simulation.rotary[0].encoder.input",
        "no encoder `4`",
    ),
    there(
        "channel = \"osmc0\"\nplant",
        "channel = \"osmc1\"\nplant",
        "simulation.rotary[0].channel",
        "no channel of that kind `osmc1`, write osmc0",
    ),
    // Used twice.
    mistake(
        "analog = 5\nrange_v",
        "analog = 4\nrange_v",
        "analog = 4\nrange_v = { min = 10",
        "supply[1].analog",
        "`4`",
    ),
    mistake("\"supply1\" #", "\"supply0\" #", "\"supply0\" # 12 V", "supply[1].channel", "`supply0` is already used"),
    there(
        "channel = \"actuator1\"\nposition",
        "channel = \"actuator0\"\nposition",
        "actuator[0].channel",
        "`0` is already",
    ),
    mistake(
        "analog = 5\nemf",
        "analog = 4\nemf",
        "analog = 4\nemf_v = 12",
        "simulation.rail[1].analog",
        "already used",
    ),
    // Rules between fields.
    mistake(
        "static_duty = 0.38",
        "static_duty = 0.95",
        "[[osmc]]",
        "osmc[0]",
        "osmc0: feed-forward must not be negative",
    ),
    mistake("code_16bit = 63357", "code_16bit = 1858", "[[actuator]]", "actuator[0]", "need different codes"),
    mistake(
        "time_ms = 300\n\n[osmc.follow]",
        "time_ms = 0\n\n[osmc.follow]",
        "time_ms = 0",
        "osmc[0].stall.time_ms",
        "above 0",
    ),
    mistake(
        "high = { code_10bit = 989.0, position_m = 0.1 }",
        "high = { code_10bit = 989.0, position_m = -0.1 }",
        "high = { code_10bit",
        "simulation.linear[0].potentiometer.high.position_m",
        "above the low point",
    ),
];

const ALL_MISTAKES: &[Mistake] = &[
    // Motors without feedback.
    there("channel = \"dhb1\"", "channel = \"dhb0\"", "dhb[1].channel", "DHB connector `0` is already used in line"),
    there("channel = \"dhb3\"", "channel = \"dhb4\"", "dhb[3].channel", "no DHB connector `4`, write 0 to 3"),
    there("channel = \"dhb3\"", "channel = \"osmc3\"", "dhb[3].channel", "named dhb and a number, as in dhb0"),
    there(
        "channel = \"dhb3\"",
        "channel = \"dhb3\"\nduty = 0.5",
        "dhb[3].duty",
        "unknown field `duty`, expected one of `channel`, `inverted`, `duty_max`, `duty_slew_per_s`",
    )
    .on_the_next_line(),
    mistake(
        "channel = \"dhb3\"",
        "channel = \"dhb3\"\nposition_rad = { min = 0, max = 1 }\nspeed_max_rad_s = 1.0\nspeed_filter_s = 0.0",
        "[[dhb]]\nchannel = \"dhb3\"",
        "dhb[3]",
        "missing field `position_pid`",
    ),
    there(
        "encoder = { input = 1, counts_per_turn = 2400 }",
        "angle = { sensor = \"imu0\" }",
        "osmc[1].angle.sensor",
        "`imu0` is no angle: write angle and its number, as in angle0",
    ),
    there(
        "encoder = { input = 1, counts_per_turn = 2400 }",
        "angle = { sensor = \"angle0\" }",
        "osmc[1].angle.sensor",
        "the robot has none",
    ),
    mistake(
        "encoder = { input = 1, counts_per_turn = 2400 }",
        "encoder = { input = 1, counts_per_turn = 2400 }\npulses = { range = 0, frames_hz = 230 }",
        "channel = \"osmc1\"",
        "osmc[1].channel",
        "needs one of the tables encoder, angle and pulses",
    ),
    there(
        "encoder = { input = 1, counts_per_turn = 2400 }",
        "pulses = { range = 4, frames_hz = 230 }",
        "osmc[1].pulses.range",
        "0 to 3",
    ),
    // Brushless drives.
    there("rest_ms = 4000 }", "rest_s = 0.5 }", "bldc[0].direction.rest_s", "unknown field `rest_s`"),
    mistake(
        "brake = { active_low = true }",
        "brake = { active_low = true }\nreverse_v = 1.0",
        "reverse_v = 1.0",
        "bldc[3].reverse_v",
        "leave one out",
    ),
    mistake("forward_v = 3.07", "forward_v = 5.5", "[[bldc]]\nchannel = \"bldc3\"", "bldc[3]", "the DAC's full scale"),
    mistake(
        "forward_v = 3.07",
        "forward_v = 2.08",
        "[[simulation.rotary]]",
        "simulation",
        "forwards above its dead_zone_v",
    ),
    // Servos.
    there("oscillator_hz = 25.6e6", "oscillator_hz = 25.6", "servo_chip.oscillator_hz", "20e6 to 30e6"),
    mistake(
        "[servo_chip]\nhold_when_safe = true\noscillator_hz = 25.6e6",
        "",
        "[[servo]]",
        "servo[0]",
        "need a [servo_chip]",
    ),
    there("pulse_s = 0.0024", "pulse_s = 0.0026", "servo[15].high.pulse_s", "inside servo.pulse_hard_s"),
    mistake("pulse_s = 0.0024", "pulse_s = 0.0006", "[[servo]] # a wide one", "servo[15]", "the low point's shorter"),
    there("channel = \"servo15\"", "channel = \"servo16\"", "servo[15].channel", "no servo output `16`, write 0 to 15"),
    // Steppers.
    mistake(
        "[stepper_bank]\nenable_active_low = false",
        "[stepper_bank]",
        "[stepper_bank]",
        "stepper_bank",
        "missing field `enable_active_low`",
    ),
    mistake(
        "steps_per_turn = 1600",
        "steps_per_turn = 160000",
        "[[stepper]]",
        "stepper[0]",
        "no more than rate_max_hz pulses per second",
    ),
    there(
        "homing = { switch = 1",
        "homing = { switch = 4",
        "stepper[0].homing.switch",
        "no switch table for `switch4`",
    ),
    mistake("position_rad = -0.5", "position_rad = -20.5", "[[stepper]]", "stepper[0]", "a position in range"),
    // Relays and analog outputs.
    there("channel = \"relay7\"", "channel = \"relay6\"", "relay[7].channel", "relay output `6` is already used"),
    mistake(
        "channel = \"relay7\"\nactive_low = true",
        "channel = \"relay7\"\nactive_low = true\nrole = \"motor-power\"",
        "channel = \"relay7\"",
        "relay[7].channel",
        "relay.motor_power",
    ),
    there("channel = \"dac1\"", "channel = \"dac2\"", "dac[1].channel", "no DAC output `2`, write 0 to 1"),
    mistake("max = 2.8 }", "max = 5.0 }", "[[dac]] # a device", "dac[1]", "between 0 and 3.3 V"),
    // Inputs.
    there("channel = \"encoder3\"", "channel = \"encoder4\"", "encoder[3].channel", "no encoder `4`"),
    there("channel = \"switch3\"", "channel = \"switch2\"", "switch[3].channel", "switch `2` is already used"),
    there("stop_below_m = 0.3", "stop_below_m = -0.3", "range[0].stop_below_m", "above 0"),
    mistake("stop_below_m = 0.3", "stop_below_m = 4.5", "[[range]]", "range[0]", "must lie within range_m"),
    there("channel = \"analog3\"", "channel = \"analog6\"", "analog[3].channel", "no analog input `6`, write 0 to 5"),
    mistake("analog = 4", "analog = 3", "analog = 3", "supply[0].analog", "analog input `3` is already used"),
    there("air_temperature_c = 20.0", "air_temperature_c = 293.0", "air_temperature_c", "-40 to 60"),
    there("auxiliary_stop = true", "auxiliary_stop = 1", "auxiliary_stop", "expected a boolean"),
    // True values of the simulation.
    there("volts = 5.0", "volts = inf", "simulation.analog[0].volts", "must be finite"),
    mistake(
        "[[simulation.analog]]\nchannel = \"analog3\"",
        "[[simulation.analog]]\nchannel = \"analog2\"",
        "[[simulation.analog]]\nchannel = \"analog2\"\nvolts = 20",
        "simulation.analog[3].channel",
        "already used",
    )
    .on_the_next_line(),
    mistake("rail = \"supply0\"\n", "", "[[simulation.rotary]]", "simulation.rotary[0]", "needs a rail"),
];

const CAR_MISTAKES: &[Mistake] = &[
    mistake(
        "track_m = 0.70",
        "tracks_m = 0.70",
        "tracks_m",
        "drive.ackermann.tracks_m",
        "expected one of `wheelbase_m`",
    ),
    mistake("\ncontrol_period", "\nactuator = 3\ncontrol_period", "actuator = 3", "actuator", "write [[actuator]]"),
    there("steering = \"dhb0\"", "steering = \"osmc0\"", "drive.ackermann.steering", "write dhb0"),
    there("drive = \"osmc0\"", "drive = \"dhb0\"", "drive.ackermann.drive", "no motor that turns `dhb0`, write osmc0"),
    mistake(
        "full_speed_m_s = 2.04",
        "",
        "[drive.ackermann]",
        "drive.ackermann.full_speed_m_s",
        "for a drive without an encoder, which needs it",
    ),
    there("max = 0.436 }", "max = 0.5 }", "drive.ackermann.steering_rad", "outside the position_m"),
    mistake("rad_per_m = 19.080", "rad_per_m = 0.0", "steering_rad", "drive.ackermann.steering_rad", "outside"),
    mistake(
        "[dhb.follow]\n",
        "[dhb.homing]\nswitch = 0\n\n[dhb.follow]\n",
        "[dhb.homing]",
        "dhb[0].homing",
        "needs no homing",
    ),
    mistake(
        "[dhb.potentiometer]",
        "[dhb.potentiometre]",
        "[dhb.potentiometre]",
        "dhb[0].potentiometre",
        "unknown field",
    ),
];

const SKID_MISTAKES: &[Mistake] = &[
    there(
        "right = [\"dhb1\", \"dhb3\"]",
        "right = [\"dhb1\", \"dhb2\"]",
        "drive.skid-steer.right[1]",
        "wheel `dhb2` is already used",
    ),
    there("left = [\"dhb0\", \"dhb2\"]", "left = []", "drive.skid-steer.left", "a wheel on each side"),
    there("left = [\"dhb0\",", "left = [\"osmc0\",", "drive.skid-steer.left[0]", "no motor with an encoder `osmc0`"),
    there("left = [\"dhb0\",", "left = [\"wheel\",", "drive.skid-steer.left[0]", "not a channel name"),
    there("input = 3", "input = 2", "dhb[3].encoder.input", "motor's encoder `2` is already used"),
    there("mass_kg = 9.0", "mass_kg = -9.0", "body.wheeled.mass_kg", "must be above 0"),
    there("mass_kg = 9.0", "weight_kg = 9.0", "body.wheeled.weight_kg", "unknown field `weight_kg`"),
    mistake("height_m = 0.08", "centre_m = [0.5, 0.0]", "[body.wheeled]", "body.wheeled", "would fall over"),
    there("outline_m = [[0.20, -0.18]", "outline_m = [[-0.30, 0.0]", "body.wheeled.outline_m", "counterclockwise"),
    there("friction = 0.8", "friction = nan", "body.wheeled.tyre.friction", "must be 0 or above"),
    there("place_m = [0.12, 0.151]", "place_m = [0.12]", "body.wheeled.wheel[0].place_m", "length 2"),
    there(
        "channel = \"dhb0\"\nplace_m",
        "channel = \"dhb4\"\nplace_m",
        "body.wheeled.wheel[0].channel",
        "no channel that turns `dhb4`",
    ),
    mistake(
        "place_m = [0.12, 0.151]\n",
        "place_m = [0.12, 0.151]\nsteered = true\n",
        "[body.wheeled]",
        "body.wheeled.steering",
        "a steered wheel needs an axle",
    ),
    mistake(
        "place_m = [0.12, 0.151]\n",
        "place_m = [0.12, 0.151]\ncaster = true\n",
        "[[body.wheeled.wheel]] # front left",
        "body.wheeled.wheel[0]",
        "a caster has no channel",
    ),
    there(
        "mount = { place_m = [0.20, 0.12] }",
        "distance_m = -1.0",
        "simulation.range[0].distance_m",
        "must be above 0",
    ),
    mistake(
        "mount = { place_m = [0.20, 0.12] }\n",
        "",
        "[[simulation.range]]",
        "simulation.range[0]",
        "needs distance_m, or mount",
    ),
    there(
        "[[simulation.rail]]",
        "[[world.post]]\ncentre_m = [1.0, 0.0]\nradius_m = 0.0\n\n[[simulation.rail]]",
        "world.post[0]",
        "`radius_m` must be positive",
    ),
    there(
        "[[simulation.rail]]",
        "[[world.wall]]\npoints_m = [[1.0, 0.0]]\n\n[[simulation.rail]]",
        "world.wall[0]",
        "at least 2 points",
    ),
    there(
        "[[simulation.rail]]",
        "[[world.person]]\nradius_m = 0.2\npath = [[1, 0, 0], [0, 1, 1]]\n\n[[simulation.rail]]",
        "world.person[0]",
        "increasing times",
    ),
    there(
        "[[simulation.rail]]",
        "[[world.box]]\nsize_m = [0.2, 0.0]\nmass_kg = 1.0\nfriction = 0.4\nplace_m = [1, 0]\n\n[[simulation.rail]]",
        "world.box[0]",
        "`size_m` and `mass_kg` above 0",
    ),
    there(
        "[[simulation.rail]]",
        "[[world.box]]\nsize_m = [0.2, 0.2]\nmass_kg = 1.0\nfriction = 0.4\nkinetic_share = 1.5\nplace_m = [1, 0]\n\n[[simulation.rail]]",
        "world.box[0]",
        "`kinetic_share` from 0 to 1",
    ),
    there(
        "[[simulation.rail]]",
        "[[world.surface]]\npoints_m = [[0, 0], [1, 0], [0, 1]]\nslope = [2, 0]\n\n[[simulation.rail]]",
        "world.surface[0]",
        "45 degrees",
    ),
    there(
        "[[simulation.rail]]",
        "[[world.field]]\nname = \"gas\"\n\n[[simulation.rail]]",
        "world.field[0]",
        "only one",
    ),
    mistake(
        "[[simulation.rail]]",
        "[[world.field]]\nname = \"a\"\nelectric = {}\n[[world.field]]\nname = 'a'\nelectric = {}\n\n[[simulation.rail]]",
        "name = 'a'",
        "world.field[1].name",
        "a field before it",
    ),
    mistake(
        "[[simulation.rail]]",
        "[[world.field]]\nname = \"gas\"\n[world.field.gas]\nsource_m = [20.0, 5.0]\nrelease_m3_s = 1e-4\nlayer_m = 2.0\nradius_m = 0.1\ngrowth_m2_s = 0.001\nspread_m2_s = 0.005\nlifetime_s = 100.0\n[world.field.gas.flow]\ncorners_m = [[0, 0], [10, 10]]\ncell_m = 0.5\ninlets_m = [[[0, 0], [0, 10]]]\noutlets_m = [[[10, 0], [10, 10]]]\nspeed_m_s = 0.2\n\n[[simulation.rail]]",
        "source_m = [20.0, 5.0]",
        "world.field[0].gas.source_m",
        "no air flows",
    ),
    mistake(
        "[[simulation.rail]]",
        "[[world.field]]\nname = \"gas\"\n[world.field.gas]\nsource_m = [2.0, 5.0]\nrelease_m3_s = 1e-4\nlayer_m = 0.0\nradius_m = 0.1\ngrowth_m2_s = 0.001\nspread_m2_s = 0.005\nlifetime_s = 100.0\n[world.field.gas.flow]\ncorners_m = [[0, 0], [10, 10]]\ncell_m = 0.5\ninlets_m = [[[0, 0], [0, 10]]]\noutlets_m = [[[10, 0], [10, 10]]]\nspeed_m_s = 0.2\n\n[[simulation.rail]]",
        "layer_m = 0.0",
        "world.field[0].gas.layer_m",
        "above 0",
    ),
    mistake(
        "[[simulation.rail]]",
        "[[world.field]]\nname = \"gas\"\n[world.field.gas]\nsource_m = [2.0, 5.0]\nrelease_m3_s = 1e-4\nlayer_m = 2.0\nradius_m = 0.1\ngrowth_m2_s = 0.001\nspread_m2_s = 0.005\nlifetime_s = 1e5\n[world.field.gas.flow]\ncorners_m = [[0, 0], [10, 10]]\ncell_m = 0.5\ninlets_m = [[[0, 0], [0, 10]]]\noutlets_m = [[[10, 0], [10, 10]]]\nspeed_m_s = 0.2\n\n[[simulation.rail]]",
        "[world.field.gas]",
        "world.field[0].gas.filaments_per_s",
        "filaments at once",
    ),
    mistake(
        "[[simulation.rail]]",
        "[[world.field]]\nname = \"gas\"\n[world.field.gas]\nsource_m = [2.0, 5.0]\nrelease_m3_s = 1e-4\nlayer_m = 2.0\nradius_m = 0.1\ngrowth_m2_s = 0.001\nspread_m2_s = 0.005\nlifetime_s = 100.0\n[world.field.gas.flow]\ncorners_m = [[0, 0], [10, 10]]\ncell_m = 0.5\ninlets_m = [[[5, 0], [0, 10]]]\noutlets_m = [[[10, 0], [10, 10]]]\nspeed_m_s = 0.2\n\n[[simulation.rail]]",
        "[world.field.gas.flow]",
        "world.field[0].gas.flow",
        "on no side",
    ),
    mistake(
        "[[simulation.rail]]",
        "[[world.field]]\nname = \"e\"\n[world.field.electric]\ndrift = { deviation = 1.0, tau_s = 0.1 }\n\n[[simulation.rail]]",
        "[world.field.electric]",
        "world.field[0].electric.clouds",
        "0.5 or more",
    ),
    mistake(
        "[[simulation.rail]]",
        "[[simulation.lidar]]\nuart = 2\nmount = { place_m = [0.2, 0.0] }\n\n[[simulation.rail]]",
        "uart = 2",
        "simulation.lidar[0].uart",
        "two UART connectors",
    ),
    mistake(
        "[[simulation.rail]]",
        "[[simulation.lidar]]\nuart = 0\nmount = { place_m = [0.2, 0.0] }\n[[simulation.gnss]]\nuart = 0\norigin = { latitude_deg = 53.2, longitude_deg = -0.5 }\n\n[[simulation.rail]]",
        "uart = 0\norigin",
        "simulation.gnss[0].uart",
        "already used",
    ),
    mistake(
        "[[simulation.rail]]",
        "[[simulation.gnss]]\nuart = 1\norigin = { latitude_deg = 53.2, longitude_deg = -0.5 }\nrate_hz = 20\n\n[[simulation.rail]]",
        "rate_hz = 20",
        "simulation.gnss[0].rate_hz",
        "must be 1 to 10",
    ),
    mistake(
        "[[simulation.rail]]",
        "[[simulation.gnss]]\nuart = 1\norigin = { latitude_deg = 89.0, longitude_deg = -0.5 }\n\n[[simulation.rail]]",
        "latitude_deg",
        "simulation.gnss[0].origin.latitude_deg",
        "-85 to 85",
    ),
    mistake(
        "[[simulation.rail]]",
        "[[simulation.gnss]]\nuart = 1\norigin = { latitude_deg = 53.2, longitude_deg = -0.5 }\ndeviation_m = -1.0\n\n[[simulation.rail]]",
        "deviation_m",
        "simulation.gnss[0].deviation_m",
        "must be 0 or above",
    ),
];

const TAIL_MISTAKES: &[Mistake] = &[
    there(
        "channel = \"bldc0\"\nlength_m",
        "channel = \"bldc1\"\nlength_m",
        "body.balance-tail.link[1].channel",
        "a motor of its own",
    ),
    there(
        "channel = \"bldc1\"\nlength_m",
        "channel = \"bldc2\"\nlength_m",
        "body.balance-tail.link[0].channel",
        "no channel that turns `bldc2`",
    ),
    there("mass_kg = 3.6", "mass_kg = -3.6", "body.balance-tail.link[0].mass_kg", "must be above 0"),
    there("wraps = 10.0 #", "turns = 10.0 #", "body.balance-tail.link[0].cable.turns", "unknown field `turns`"),
    mistake(
        "ratio = 25.0 # tail",
        "ratio = 0.0 # tail",
        "[body.balance-tail.link.cable]",
        "body.balance-tail.link[0].cable",
        "a ratio other than 0",
    ),
    mistake(
        "torque_max_nm = 150.0",
        "torque_max_nm = 5.0",
        "[body.balance-tail.ankle]",
        "body.balance-tail.ankle",
        "needs 8.1 N m",
    ),
    mistake(
        "inertia_kg_m2 = 70.0",
        "inertia_kg_m2 = 60.0",
        "[body.balance-tail.wearer]",
        "body.balance-tail.wearer",
        "mass times height squared",
    ),
    there("at_s = 5.0", "at_s = -5.0", "body.balance-tail.lift.at_s", "must be 0 or above"),
    there("torque_max_nm = 0.625", "torque_max_nm = 0", "simulation.bldc[0].rotor.torque_max_nm", "must be above 0"),
    there("input = 1, lines", "input = 0, lines", "simulation.bldc[1].encoder.input", "encoder `0` is already used"),
];

const LOOP_MISTAKES: &[Mistake] = &[
    mistake(
        "lift = \"stepper0\"",
        "lift = \"stepper1\"",
        "ahead = \"stepper1\"",
        "body.cable-loop.ahead",
        "a channel of its own",
    ),
    there("spool = \"dhb0\"", "spool = \"dhb1\"", "body.cable-loop.spool", "no channel that turns `dhb1`"),
    there("legs_m = 0.012", "legs_m = 0.0", "body.cable-loop.finger.legs_m", "must be above 0"),
    there("reading = \"force_n\"", "reading = \"force_kg\"", "simulation.force[0].body.reading", "no `force_kg`"),
];

const SHELL_MISTAKES: &[Mistake] = &[
    there("panel_m = 0.21", "panel_m = 0.0", "body.deformable.shell.panel_m", "must be above 0"),
    mistake(
        "ends_rad = [0.58, 1.0471976]",
        "ends_rad = [1.1, 1.2]",
        "[body.deformable.shell]",
        "body.deformable.shell",
        "rest_rad between them",
    ),
    mistake(
        "late_s = 0.2",
        "late_s = 30.0",
        "[body.deformable.whiskers]",
        "body.deformable.whiskers",
        "late_s at most 100 times every_s",
    ),
    mistake(
        "channel = \"servo0\"\npanel_m",
        "channel = \"dhb1\"\npanel_m",
        "channel = \"dhb1\"\npanel_m",
        "body.deformable.shell.channel",
        "the shell needs its own",
    ),
    there("channel = \"servo0\"\npanel_m", "channel = \"servo1\"\npanel_m", "body.deformable.shell.channel", "servo1"),
    there(
        "height_m = 0.03",
        "outline_m = [[0.1, -0.1], [0.1, 0.1], [-0.1, 0.0]]",
        "body.deformable.wheeled.outline_m",
        "leave `outline_m` out",
    ),
    mistake(
        "place_m = [0.0, 0.08]",
        "place_m = [0.0, 0.08]\nsteered = true",
        "[body.deformable.wheeled]",
        "body.deformable.wheeled.steering",
        "a steered wheel needs an axle",
    ),
    there("reading = \"right_rad\"", "reading = \"right_deg\"", "simulation.analog[1].body.reading", "no `right_deg`"),
];

const FINGERS_MISTAKES: &[Mistake] = &[
    there("left = \"servo0\"", "left = \"servo3\"", "body.two-fingers.left", "no channel that turns `servo3`"),
    mistake(
        "right = \"servo1\"",
        "right = \"servo0\"",
        "[body.two-fingers]",
        "body.two-fingers",
        "left, right and palm need a channel of their own each",
    ),
    mistake(
        "m_per_rad = 0.040",
        "m_per_rad = 0.0",
        "[body.two-fingers.palm]",
        "body.two-fingers.palm",
        "m_per_rad other than 0",
    ),
    there("zero_m = 0.061", "zero_m = -0.061", "body.two-fingers.palm.zero_m", "must be above 0"),
    there("inertia_kg_m2 = 2e-4", "inertia_kg_m2 = 0.0", "body.two-fingers.finger.inertia_kg_m2", "must be above 0"),
    mistake(
        "stiffness_n_per_m = 8e4",
        "stiffness_n_per_m = 8e9",
        "[body.two-fingers.pads]",
        "body.two-fingers.pads",
        "stiff for this object and these fingers",
    ),
    there("friction = 0.8", "friction = -0.8", "body.two-fingers.pads.friction", "must be 0 or above"),
    mistake(
        "edge_m = 0.015",
        "edge_m = 0.016",
        "[body.two-fingers.object]",
        "body.two-fingers.object",
        "edges from 0 to half the side",
    ),
    there("step_rad = 0.001533981", "step_rad = 0.0", "body.two-fingers.encoder.step_rad", "must be above 0"),
    there("reading = \"palm_rad\"", "reading = \"palm_m\"", "simulation.analog[2].body.reading", "no `palm_m`"),
];

const SUCTION_MISTAKES: &[Mistake] = &[
    mistake(
        "stepper = \"stepper1\"",
        "stepper = \"stepper0\"",
        "[[body.suction-pad.membrane]]\nstepper = \"stepper0\"\nvalve = \"relay3\"",
        "body.suction-pad.membrane[1]",
        "a stepper and a valve of its own",
    ),
    there("valve = \"relay4\"", "valve = \"relay5\"", "body.suction-pad.membrane[2].valve", "no relay `relay5`"),
    there(
        "burst_stretch = 4.0 #",
        "burst_strain = 4.0 #",
        "body.suction-pad.membrane[0].burst_strain",
        "unknown field `burst_strain`",
    ),
    mistake(
        "burst_stretch = 4.0 #",
        "burst_stretch = 1.2 #",
        "[[body.suction-pad.membrane]]",
        "body.suction-pad.membrane[0]",
        "a burst beyond a stretch of 1.5",
    ),
    mistake(
        "peel = 0.35 #",
        "peel = 1.35 #",
        "[[body.suction-pad.cup]]",
        "body.suction-pad.cup[0]",
        "a peeling share from 0 to 1",
    ),
    mistake(
        "critical_ratio = 0.3 }\norifice",
        "critical_ratio = 1.3 }\norifice",
        "[body.suction-pad.line]",
        "body.suction-pad.line",
        "critical ratios from 0 to below 1",
    ),
    there("suction_pa = 11600.0 #", "suction_pa = nan #", "body.suction-pad.cup[0].suction_pa", "must be above 0"),
    there("middle = 1.0", "middle = -1.0", "body.suction-pad.strip.middle", "must be 0 or above"),
    mistake(
        "[body.suction-pad.strip]",
        "[body.suction-pad]\nsupply_pa = -1.0\n[body.suction-pad.strip]",
        "supply_pa = -1.0",
        "body.suction-pad.supply_pa",
        "must be 0 or above",
    ),
    there(
        "reading = \"pressure_2_pa\"",
        "reading = \"pressure_3_pa\"",
        "simulation.analog[2].body.reading",
        "no `pressure_3_pa`",
    ),
];

const PICKER_MISTAKES: &[Mistake] = &[
    there(
        "channel = \"relay0\"\non_s",
        "channel = \"relay1\"\non_s",
        "body.berry-picker.valve.channel",
        "no relay `relay1`",
    ),
    there("row = \"stepper1\"", "row = \"stepper0\"", "body.berry-picker.axes.row", "a motor of its own"),
    mistake(
        "runs_between_pa = [5.0e5, 6.0e5]",
        "runs_between_pa = [6.0e5, 5.0e5]",
        "[body.berry-picker.supply]",
        "body.berry-picker.supply",
        "a compressor that stops above where it starts",
    ),
    mistake(
        "rod_m = 0.005",
        "rod_m = 0.017",
        "[body.berry-picker.cylinder]",
        "body.berry-picker.cylinder",
        "a bore above its rod",
    ),
    there("dead_m3 = 2.0e-6", "dead_l = 0.002", "body.berry-picker.cylinder.dead_l", "unknown field `dead_l`"),
    mistake(
        "on_s = 0.020",
        "delay_s = 0.020",
        "delay_s = 0.020",
        "body.berry-picker.valve.delay_s",
        "unknown field `delay_s`",
    ),
    there("pad_m = 0.008", "pad_m = 0.0", "body.berry-picker.fingers.pad_m", "must be above 0"),
    mistake(
        "detach_n = 1.5",
        "detach_n = -1.5",
        "[[body.berry-picker.berry]]",
        "body.berry-picker.berry[0]",
        "berry 0 needs a size",
    ),
    there("reading = \"trigger\"", "reading = \"handle\"", "simulation.switch[0].reading", "no `handle`"),
];

const CARRIER_MISTAKES: &[Mistake] = &[
    there("\"PJ8\"", "\"PL8\"", "pins[0].stm32", "`PL8` is not a pin"),
    there(
        "kind = \"gpio\" },\n\n    # Stepper",
        "kind = \"gpoi\" },\n\n    # Stepper",
        "pins[11].kind",
        "expected one of",
    ),
    there("\"PJ6\"", "\"PJ8\"", "pins[1].stm32", "pin `PJ8` is already used in line 23"),
    there("header = \"D37\"", "header = \"D4\"", "pins[1].header", "header pin `D4` is already used"),
    there("id = \"dir0\"", "id = \"step0\"", "pins[13].id", "function `step0` is already used"),
    there(
        "\"PI11\", signal = \"EXTI11\"",
        "\"PA10\", signal = \"EXTI10\"",
        "pins[7].stm32",
        "EXTI line `10` is already used",
    ),
    there("\"PI11\", signal = \"EXTI11\"", "\"PI11\", signal = \"EXTI10\"", "pins[7].signal", "its own number"),
    there("\"TIM8_CH2\"", "\"TIM8_CH1\"", "pins[1].signal", "signal `TIM8_CH1` is already used"),
    there("signal = \"TIM8_CH2\", af = 3", "signal = \"TIM8_CH2\"", "pins[1].af", "cap and bus pins have an af"),
    there("signal = \"TIM8_CH2\"", "signal = \"TIM5_CH2\"", "pins[1].signal", "keeps the time"),
    there("address = 0x40", "address = 0x18", "i2c.devices[1].address", "0x40 to 0x77"),
    there("address = 0x20", "address = 0x78", "i2c.devices[0].address", "0x08 to 0x77"),
    there("rate_hz = 400_000", "rate_hz = 1_000_000", "i2c.rate_hz", "at most 400000"),
    there("frequency_hz = 1526.0\n# Used", "frequency_hz = 2000.0\n# Used", "osmc.frequency_hz", "24 to 1526"),
    there("duty_max_hard = 0.98\n# PCA", "duty_max_hard = 0.99\n# PCA", "osmc.duty_max_hard", "at most 0.98"),
    there("address = 0x41", "address = 0x40", "i2c.devices[2].address", "I2C address `0x40` is already used"),
    mistake(
        "address = 0x41",
        "address = 0x70",
        "{ address = 0x70",
        "i2c.reserved[0].address",
        "`0x70` is already used",
    ),
    mistake(
        "duty_max_hard = 0.98\n# PCA",
        "duty_max_hard = 0.9\n# PCA",
        "duty_max_default",
        "osmc.duty_max_default",
        "at most osmc.duty_max_hard",
    ),
    there("ali = 13", "ali = 12", "osmc.connectors[3].ali", "PWM output `12 of osmc_pwm` is already used"),
    mistake(
        "direction = 6, brake",
        "direction = 8, brake",
        "outputs = [8",
        "relay.outputs[0]",
        "expander bit `8 of expander` is already used",
    ),
    there("b = \"enc1_b\"", "b = \"enc1_a\"", "encoder.connectors[1].b", "`enc1_a` is already used"),
    there("bli = 15", "bli = 16", "osmc.connectors[3].bli", "no PWM output `16`, write 0 to 15"),
    there("disable = \"osmc_dis\"", "disable = \"osmc_off\"", "osmc.disable", "no pin `osmc_off`"),
    there("disable = \"osmc_dis\"", "disable = \"ain0\"", "osmc.disable", "a kind that cannot do this"),
    there("pwm = \"dhb_pwm\"", "pwm = \"expander\"", "dhb.pwm", "a kind that cannot do this"),
    there("motor_power = 0", "motor_power = 8", "relay.motor_power", "number of a relay"),
    there("ignition = 1", "ignition = 0", "relay.ignition", "relay `0` is already used"),
    there("full_scale_v = 50.0", "full_scale_v = 3.0", "analog.full_scale_v", "a divider cannot amplify"),
    there(
        "min = 0.001, max = 0.002",
        "min = 0.0001, max = 0.002",
        "servo.pulse_default_s",
        "inside servo.pulse_hard_s",
    ),
];

/// Loads the text of a robot file from a folder of its own.
fn load_text(folder: &Path, text: &str) -> Result<Robot, BoardError> {
    let path = folder.join("robot.toml");
    fs::write(&path, text).expect("a writable folder");
    load(path.to_str().expect("UTF-8"))
}

fn load_carrier_text(folder: &Path, text: &str) -> Result<(), BoardError> {
    let path = folder.join("carrier.toml");
    fs::write(&path, text).expect("a writable folder");
    load_carrier(path.to_str().expect("UTF-8")).map(drop)
}

fn line_of(text: &str, part: &str) -> usize {
    let offset = text.find(part).unwrap_or_else(|| panic!("no `{part}` in the file"));
    1 + text[..offset].matches('\n').count()
}

/// Returns how the error differs from the expected one.
fn check(
    mistake: &Mistake,
    original: &str,
    file: &str,
    load: impl Fn(&str) -> Result<(), BoardError>,
) -> Option<String> {
    let Mistake { from, to, line, lines_below, field, says } = mistake;
    let line = match line {
        Some(line) => line_of(&original.replacen(from, to, 1), line),
        None => line_of(original, from),
    } + lines_below;
    let Err(error) = load(&original.replacen(from, to, 1)) else { return Some(format!("`{to}` was taken")) };
    let said = error.to_string();
    let colon = if field.is_empty() { "" } else { ": " };
    let place = format!("{file}:{line}{colon}{field}");
    let expected = said.contains(&place) && said.contains(says);
    (!expected).then(|| format!("`{to}`\n  expected `{place}` … `{says}`\n  said     `{said}`"))
}

#[test]
fn mistakes_in_a_robot_file() {
    let folder = TempDir::new().unwrap();
    let load = |text: &str| load_text(folder.path(), text).map(drop);
    let robots = [
        (ROBOT, ROBOT_MISTAKES),
        (ALL, ALL_MISTAKES),
        (CAR, CAR_MISTAKES),
        (SKID_STEERED, SKID_MISTAKES),
        (TAIL, TAIL_MISTAKES),
        (LOOP, LOOP_MISTAKES),
        (SHELL, SHELL_MISTAKES),
        (FINGERS, FINGERS_MISTAKES),
        (SUCTION, SUCTION_MISTAKES),
        (PICKER, PICKER_MISTAKES),
    ];
    let mistakes = robots.into_iter().flat_map(|(robot, mistakes)| mistakes.iter().map(move |m| (robot, m)));
    let wrong: Vec<_> = mistakes.filter_map(|(robot, m)| check(m, robot, "robot.toml", load)).collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn mistakes_in_a_carrier_file() {
    let folder = TempDir::new().unwrap();
    let load = |text: &str| load_carrier_text(folder.path(), text);
    let wrong: Vec<_> = CARRIER_MISTAKES.iter().filter_map(|m| check(m, CARRIER, "carrier.toml", load)).collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn a_mistake_in_a_carrier_beside_the_robot_names_the_carrier() {
    let folder = TempDir::new().unwrap();
    let carrier = CARRIER.replacen("rate_hz = 400_000", "rate_hz = 0", 1);
    fs::write(folder.path().join("r4-carrier.toml"), &carrier).unwrap();
    let said = load_text(folder.path(), ROBOT).unwrap_err().to_string();
    assert!(said.contains(&format!("r4-carrier.toml:{}: i2c.rate_hz", line_of(&carrier, "rate_hz = 0"))), "{said}");
}

#[test]
fn a_robot_may_have_less_than_its_carrier() {
    let folder = TempDir::new().unwrap();
    let header = &ROBOT[..ROBOT.find("# 73ZYT").unwrap()];
    let robot = load_text(folder.path(), header).unwrap();
    assert!(robot.config.motors.is_empty() && robot.simulation.is_empty());
    let without_simulation = &ROBOT[..ROBOT.find("[[simulation.rotary]]").unwrap()];
    let robot = load_text(folder.path(), without_simulation).unwrap();
    assert!(robot.config.motors.len() == 2 && robot.simulation.is_empty());
}

#[test]
fn what_exists_is_simulated() {
    let folder = TempDir::new().unwrap();
    let without_actuator = &ROBOT[..ROBOT.find("[[simulation.linear]]").unwrap()];
    let said = load_text(folder.path(), without_actuator).unwrap_err().to_string();
    assert!(said.contains("simulation: needs one rotary or linear table for each motor"), "{said}");
    // rails have a default for everything
    let without_rails = &ROBOT[..ROBOT.find("[[simulation.rail]]").unwrap()];
    let rails = load_text(folder.path(), without_rails).unwrap().simulation.rails;
    assert_eq!([rails[0].emf_v, rails[1].emf_v], [25.0, 12.5]);
}

#[test]
fn nothing_there() {
    let said = load("osmc_bench").unwrap_err().to_string();
    let names: Vec<_> = r4_boards::names().collect();
    let known = names.join(", ");
    assert_eq!(said, format!("there is no robot `osmc_bench`: write {known}, or the path of a .toml file"));
    let said = load("no/such.toml").unwrap_err().to_string();
    assert!(said.starts_with("no/such.toml: cannot be read"), "{said}");
    assert!(matches!(load("/tmp"), Err(BoardError::UnknownName { .. })));
    assert!(load_carrier("r5").unwrap_err().to_string().contains("write r4-carrier"));
}

fn without_line(text: &str, gone: usize) -> String {
    let lines = text.lines().enumerate().filter(|(index, _)| *index != gone);
    lines.map(|(_, line)| format!("{line}\n")).collect()
}

fn places(error: &BoardError) -> bool {
    let said = error.to_string();
    ["robot.toml:", "carrier.toml:"].iter().any(|file| {
        let line = said.find(file).and_then(|at| said[at + file.len()..].split(':').next());
        line.is_some_and(|line| line.parse::<usize>().is_ok_and(|line| line > 0))
    })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, ..ProptestConfig::default() })]

    #[test]
    fn damaged_files_are_refused_with_a_place_or_taken(
        start in 0..CARRIER.len().max(ALL.len()),
        length in 0..60_usize,
        inserted in "[\\[\\]{}=\",.0-9a-z\n-]{0,4}",
        line in 0..600_usize,
    ) {
        let folder = TempDir::new().unwrap();
        for (text, is_robot) in [(ROBOT, true), (ALL, true), (CARRIER, false)] {
            let load = |text: &str| {
                if is_robot { load_text(folder.path(), text).map(drop) } else { load_carrier_text(folder.path(), text) }
            };
            let mut bytes = text.as_bytes().to_vec();
            let start = start % bytes.len();
            let end = (start + length).min(bytes.len());
            bytes.splice(start..end, inserted.bytes());
            // The rest of a character that was cut is replaced: a file that is no UTF-8 is not readable at all.
            for damaged in [String::from_utf8_lossy(&bytes).into_owned(), without_line(text, line)] {
                if let Err(error) = load(&damaged) {
                    prop_assert!(places(&error), "{error}");
                }
            }
        }
    }
}

/// Reads the bench's motor with an angle sensor, on the bus or by pulses, and with a second encoder: it is simulated as
/// configured.
#[test]
fn angle_sensors_and_second_encoders_are_read_and_simulated() {
    let folder = TempDir::new().unwrap();
    let with = |table: &str, more: &str| {
        let text = ROBOT
            .replace(
                "[osmc.encoder] # on the output shaft (paper: \"external incremental encoder\")\ninput = 0\n",
                table,
            )
            .replace("counts_per_turn = 2400 # 600 lines, each edge of both tracks counted: our choice\n", "")
            .replace("encoder = { input = 0, lines_per_turn = 600 }\n", "");
        load_text(folder.path(), &format!("{text}\n{more}")).unwrap()
    };
    let side = "[osmc.motor_side]\ninput = 2\ncounts_per_turn = 12000\ngap_max_rad = 0.06\n";
    let angle = format!("{side}[osmc.angle]\nsensor = \"angle0\"\nzero_rad = 1.5\n");
    let robot = with(&angle, "[[angle]]\nchannel = \"angle0\"\nrate_hz = 1000\n");
    let control = robot.config.motors[0].control.unwrap();
    assert_eq!(control.feedback, Feedback::Angle { angle: 0, zero: 1.5, inverted: false });
    let expected = MotorSideConfig { index: 2, counts_per_turn: 12_000, inverted: false, gap_max: 0.06 };
    assert_eq!(control.motor_side, Some(expected));
    assert_eq!(robot.config.sensors[0].chip, SensorChip::As5600(As5600Config { averages: 2 }));
    let osmc0 = Some(robot.config.motors[0].id);
    let [simulated] = robot.simulation.angles[..] else { panic!("one sensor") };
    assert_eq!((simulated.of, simulated.zero_rad), (osmc0, 1.5));
    let motor = &robot.simulation.motors[0];
    assert!(motor.sensor.is_none());
    assert_eq!(motor.motor_side, Some(SimulatedEncoder { input: 2, lines_per_turn: 3000 }));

    let robot = with("[osmc.pulses]\nrange = 1\nframes_hz = 115\ninverted = true\n", "");
    let feedback = robot.config.motors[0].control.unwrap().feedback;
    assert_eq!(feedback, Feedback::Pulses { range: 1, frames_hz: 115, zero: 0.0, inverted: true });
    let expected = SimulatedPulses { connector: 1, of: osmc0, zero_rad: 0.0, frames_hz: 115.0 };
    assert_eq!(robot.simulation.pulses, [expected]);
}

/// Reads load cells and optical distance sensors: they are simulated as configured, and impossible ones are refused.
#[test]
fn load_cells_and_distance_sensors_are_read_and_simulated() {
    const TABLES: &str = "[[force]]\nchannel = \"force0\"\nrate_hz = 80\nnewtons_per_mv_v = 49.0\nzero_mv_v = 0.25\n\
                          [[distance]]\nchannel = \"distance2\"\nrate_hz = 20\n";
    let folder = TempDir::new().unwrap();
    let with = |more: &str| load_text(folder.path(), &format!("{ROBOT}\n{TABLES}\n{more}"));
    let robot = with("").unwrap();
    let [cell, optical] = robot.config.sensors[..] else { panic!("two sensors") };
    let chip = Nau7802Config { gain: 128, newtons_per_mv_v: 49.0, zero_mv_v: 0.25 };
    assert_eq!((cell.address, cell.chip), (0x2A, SensorChip::Nau7802(chip)));
    assert_eq!((optical.address, optical.chip), (0x29, SensorChip::Vl6180x(Vl6180xConfig {})));
    let force = SimulatedForce {
        channel: cell.id,
        force_n: 0.0,
        reads: None,
        newtons_per_mv_v: 49.0,
        zero_mv_v: 0.25,
        noise_n: 0.0,
    };
    let (reads, reflectance, offset_m) = (None, 0.17, 0.0);
    let distance = SimulatedDistance { channel: optical.id, distance_m: None, reads, reflectance, offset_m };
    assert_eq!((&robot.simulation.forces[..], &robot.simulation.distances[..]), (&[force][..], &[distance][..]));

    let robot = with(
        "[[simulation.force]]\nchannel = \"force0\"\nforce_n = 12.0\nnewtons_per_mv_v = 47.5\nzero_mv_v = -0.1\nnoise_n = 0.02\n\
         [[simulation.distance]]\nchannel = \"distance2\"\ndistance_m = 0.05\nreflectance = 0.88\noffset_m = -0.004\n",
    )
    .unwrap();
    let truth = SimulatedForce { force_n: 12.0, newtons_per_mv_v: 47.5, zero_mv_v: -0.1, noise_n: 0.02, ..force };
    let seen = SimulatedDistance { distance_m: Some(0.05), reflectance: 0.88, offset_m: -0.004, ..distance };
    assert_eq!((&robot.simulation.forces[..], &robot.simulation.distances[..]), (&[truth][..], &[seen][..]));

    let force = "[[simulation.force]]\nchannel = \"force0\"\n";
    let distance = "[[simulation.distance]]\nchannel = \"distance2\"\n";
    for (more, says) in [
        (format!("{force}force_n = 1.0\nbody = {{ reading = \"force_n\" }}"), "needs force_n, or body, and not both"),
        (format!("{force}body = {{ reading = \"force_n\" }}"), "there is no [body]"),
        (format!("{force}newtons_per_mv_v = 0.0"), "must not be 0"),
        (format!("{force}noise_n = -1.0"), "noise_n"),
        (format!("{distance}distance_m = 1.0\nbody = {{ reading = \"force_n\" }}"), "not both"),
        (format!("{distance}reflectance = 1.5"), "must be at most 1"),
        ("[[simulation.force]]\nchannel = \"force1\"".into(), "force1"),
        ("[[force]]\nchannel = \"force1\"\nrate_hz = 10\nnewtons_per_mv_v = 1.0".into(), "address"),
        ("[[distance]]\nchannel = \"force1\"\nrate_hz = 10\naddress = 0x30".into(), "distance0"),
    ] {
        let error = with(&more).unwrap_err().to_string();
        assert!(error.contains(says), "{more}: {error}");
    }
}
