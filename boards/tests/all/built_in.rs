//! Tests of the built-in files against their sources.

use std::{collections::HashSet, fs};

use r4_boards::{
    Drive, Robot, SimulatedBody, SimulatedSensor, SwitchedBy, World,
    carrier::{Chip, PinKind},
    carrier_names, load, load_body, load_carrier, names,
};
use r4_protocol::{
    channel::{ChannelId, ChannelKind},
    config::{BridgeConfig, DhbLines, Feedback, MotorConfig, PotPoint, PwmConfig, RelayRole, Reverse},
};
use r4_world::{AnyBody, Pose, SlipLaw};

fn osmc_lines(motor: &MotorConfig) -> [u8; 4] {
    let BridgeConfig::Osmc(lines) = motor.bridge else { panic!("{motor:?}") };
    lines.all()
}

const OSMC0: ChannelId = ChannelId::new(ChannelKind::Osmc, 0);
const ACTUATOR1: ChannelId = ChannelId::new(ChannelKind::Actuator, 1);

#[test]
fn every_built_in_name_loads() {
    for name in names() {
        let robot = load(name).unwrap();
        assert_eq!(robot.config.robot.as_str(), name);
        assert_eq!(robot.file, format!("boards/{name}.toml"));
        assert_eq!(robot.config.validate(), Ok(()));
    }
    for name in carrier_names() {
        assert_eq!(load_carrier(name).unwrap().name, name);
    }
}

/// Writes and reads the body of every robot that has one, and one whose wheels differ in everything that a file can
/// have.
#[test]
fn a_body_is_written_as_it_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("body.toml");
    let robots = names().map(|name| load(name).unwrap());
    let is_on_wheels = |robot: &Robot| robot.simulation.body.as_ref().is_some_and(|body| body.wheeled().is_some());
    let with_bodies: Vec<_> = robots.filter(is_on_wheels).collect();
    assert!(with_bodies.iter().any(|robot| robot.config.robot == "openscout"));
    for mut robot in with_bodies {
        let body = robot.simulation.body.clone().unwrap();
        let wheeled = body.wheeled().unwrap();
        let text = SimulatedBody::wheeled_toml(wheeled, &body.channels, &["Where it is from.\nIn two lines.".into()]);
        assert!(text.starts_with("# Where it is from.\n# In two lines.\n[body.wheeled]\n"), "{text}");
        fs::write(&file, text).unwrap();
        assert_eq!(load_body(&file, &robot).unwrap(), body);

        let changed = wheeled.changed(|chassis, wheels| {
            chassis.centre_m = [0.01, -0.002];
            wheels[0].inverted = true;
            let tyre = wheels[1].tyre.as_mut().unwrap();
            (tyre.law, tyre.friction) = (SlipLaw::Linear, 0.1 + 0.2);
            wheels[2].radius_m = 0.1 / 3.0;
        });
        let changed = changed.unwrap();
        fs::write(&file, SimulatedBody::wheeled_toml(&changed, &body.channels, &[])).unwrap();
        let changed = SimulatedBody { kind: AnyBody::Wheeled(Box::new(changed)), channels: body.channels.clone() };
        assert_eq!(load_body(&file, &robot).unwrap(), changed);
        // The new body takes the pose of the old one.
        let start = Pose { x_m: 1.0, y_m: 2.0, yaw_rad: 0.5 };
        robot.simulation.enter(World { start, ..World::default() });
        robot.simulation.set_body(changed);
        assert_eq!(robot.simulation.body.unwrap().kind.pose(), start);
    }
}

#[test]
fn a_body_file_holds_a_body_of_the_robot_and_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("body.toml");
    let robot = load("openscout").unwrap();
    let body = robot.simulation.body.as_ref().unwrap();
    let good = SimulatedBody::wheeled_toml(body.wheeled().unwrap(), &body.channels, &[]);
    for (text, says) in [
        (
            good.replace("dhb2", "osmc0"),
            "body.toml:26: body.wheeled.wheel[2].channel: there is no channel that turns `osmc0`",
        ),
        (
            good.replace("mass_kg = 9.0", "mass_kg = -9.0"),
            "body.toml:2: body.wheeled.mass_kg: -9 is out of range, must be above 0",
        ),
        (format!("{good}[world]\n"), "unknown field `world`"),
    ] {
        fs::write(&file, text).unwrap();
        let error = load_body(&file, &robot).unwrap_err().to_string();
        assert!(error.contains(says), "{error}\nexpected {says}");
    }
    assert!(load_body(&folder.path().join("none.toml"), &robot).unwrap_err().to_string().contains("none.toml"));
}

#[test]
fn the_bench_has_the_published_numbers() {
    let robot = load("osmc-bench").unwrap();
    let [rotary, actuator] = robot.config.motors.as_slice() else { panic!("two motors") };
    assert_eq!([rotary.id, actuator.id], [OSMC0, ACTUATOR1]);
    assert_eq!([osmc_lines(rotary), osmc_lines(actuator)], [[0, 1, 2, 3], [4, 5, 6, 7]]);
    // 230 and 200 of 255, to the three digits of the file
    assert!((rotary.duty_max - 230.0 / 255.0).abs() < 5e-4 && (actuator.duty_max - 200.0 / 255.0).abs() < 5e-4);
    let code_16bit = |code_10bit: f64| (code_10bit / 1023.0 * 65535.0).round() as u16;
    let expected = Feedback::Potentiometer {
        analog: 0,
        low: PotPoint { code: code_16bit(29.0), position_m: 0.0 },
        high: PotPoint { code: code_16bit(989.0), position_m: 0.1 },
    };
    assert_eq!(actuator.control.unwrap().feedback, expected);
    let encoder = Feedback::Encoder { index: 0, counts_per_turn: 2400, inverted: false, counts_per_index: 0 };
    assert_eq!(rotary.control.unwrap().feedback, encoder);
    assert_eq!(robot.config.osmc_pwm, Some(PwmConfig { address: 0x40, frequency_hz: 1526.0 }));
    for supply in &robot.config.supplies {
        // 50 V at the highest of 65536 codes; f32 has 6e-8
        assert!((f64::from(supply.volts_per_code) * 65535.0 / 50.0 - 1.0).abs() < 1e-6);
    }
}

#[test]
fn the_simulated_bench_is_wired_as_the_controller_believes() {
    let robot = load("osmc-bench").unwrap();
    let [rotary, actuator] = robot.simulation.motors.as_slice() else { panic!("two motors") };
    assert_eq!([rotary.channel, actuator.channel], [OSMC0, ACTUATOR1]);
    assert_eq!(rotary.sensor, Some(SimulatedSensor::Encoder { input: 0, lines_per_turn: 600 }));
    let Some(SimulatedSensor::Potentiometer { input: 0, low, high, .. }) = actuator.sensor else {
        panic!("{actuator:?}")
    };
    assert_eq!([low.share(), high.share()], [29.0 / 1023.0, 989.0 / 1023.0]);
    for motor in &robot.simulation.motors {
        assert!(motor.plant.text.contains("[parameters]") && motor.plant.name.starts_with("boards/plants/"));
    }
    let rails: Vec<_> = robot.simulation.rails.iter().map(|rail| (rail.channel.to_string(), rail.emf_v)).collect();
    assert_eq!(rails, [("supply0".to_owned(), 24.0), ("supply1".to_owned(), 12.0)]);
}

#[test]
fn a_copy_elsewhere_uses_what_is_beside_it_and_else_what_is_built_in() {
    let folder = tempfile::TempDir::new().unwrap();
    let path = folder.path().join("mine.toml");
    fs::write(&path, include_str!("../../osmc-bench.toml")).unwrap();
    let mine = load(path.to_str().unwrap()).unwrap();
    let built_in = load("osmc-bench").unwrap();
    assert_eq!(
        (&mine.config, &mine.simulation, &mine.carrier),
        (&built_in.config, &built_in.simulation, &built_in.carrier)
    );

    fs::create_dir(folder.path().join("plants")).unwrap();
    fs::write(folder.path().join("plants/osmc-bench-rotary.toml"), "model = \"mine\"").unwrap();
    let changed = load(path.to_str().unwrap()).unwrap();
    assert_eq!(changed.simulation.motors[0].plant.text, "model = \"mine\"");
    assert_eq!(changed.simulation.motors[1], built_in.simulation.motors[1]);
}

/// A jerk that is left out is 0, for a trapezoid.
#[test]
fn a_profile_may_limit_its_jerk() {
    let folder = tempfile::TempDir::new().unwrap();
    let path = folder.path().join("mine.toml");
    let limited = include_str!("../../osmc-bench.toml")
        .replace("jerk_rad_s3 = 50.0", "jerk_rad_s3 = 200.0")
        .replace("acceleration_m_s2 = 0.05", "acceleration_m_s2 = 0.05\njerk_m_s3 = 0.5");
    fs::write(&path, limited).unwrap();
    let jerks = |robot: &str| {
        let motors = load(robot).unwrap().config.motors;
        motors.iter().map(|motor| motor.control.unwrap().profile.jerk).collect::<Vec<_>>()
    };
    assert_eq!(jerks("osmc-bench"), [50.0, 0.0]);
    assert_eq!(jerks(path.to_str().unwrap()), [200.0, 0.5]);
}

#[test]
fn the_carrier_uses_every_pin_and_every_exti_line_once() {
    let carrier = load_carrier("r4-carrier").unwrap();
    let pins: HashSet<_> = carrier.pins.iter().map(|pin| pin.stm32).collect();
    let headers: HashSet<_> = carrier.pins.iter().map(|pin| &pin.header).collect();
    assert_eq!((pins.len(), headers.len()), (carrier.pins.len(), carrier.pins.len()));
    let exti = carrier.pins.iter().filter(|pin| pin.kind == PinKind::Exti);
    let mut lines: Vec<_> = exti.map(|pin| pin.stm32.number).collect();
    lines.sort_unstable();
    assert_eq!(lines, [7, 10, 11, 14, 15]);
}

#[test]
fn the_carrier_has_what_the_paper_lists() {
    // R4 paper: the number of each kind of channel, and which chip does what
    let carrier = load_carrier("r4-carrier").unwrap();
    assert_eq!(carrier.dhb.connectors.len(), 4);
    assert_eq!(carrier.bldc.connectors.len(), 4);
    assert_eq!(carrier.stepper.connectors.len(), 4);
    assert_eq!(carrier.encoder.connectors.len(), 4);
    assert_eq!(carrier.range.connectors.len(), 4);
    assert_eq!(carrier.servo.outputs.len(), 16);
    assert_eq!(carrier.relay.outputs.len(), 8);
    assert_eq!(carrier.analog.inputs.len(), 6);
    assert_eq!(carrier.dac.outputs.len(), 2);
    let count = |chip| carrier.i2c.devices.iter().filter(|device| device.chip == chip).count();
    assert_eq!([count(Chip::Pca9685), count(Chip::Mcp23017), count(Chip::Mcp4728)], [3, 1, 1]);
    // divider 3.3 V to 50 V
    assert!((carrier.analog.divider_ratio() - 15.15).abs() < 0.005);
    // our choice: connector k has the outputs 4k to 4k + 3
    for (connector, lines) in (0u8..).zip(&carrier.osmc.connectors) {
        assert_eq!(lines.all(), [0, 1, 2, 3].map(|line| 4 * connector + line));
    }
    assert_eq!(carrier.osmc.connectors.len(), 4);
}

#[test]
fn a_board_has_the_chips_that_its_robot_uses() {
    let chips = |name: &str| {
        let config = load(name).unwrap().config;
        let outputs = [config.osmc_pwm.is_some(), config.dhb_pwm.is_some(), config.servo_pwm.is_some()];
        (outputs, [config.bldc_dac.is_some(), config.expander.is_some(), config.stepper_bank.is_some()])
    };
    assert_eq!(chips("osmc-bench"), ([true, false, false], [false, true, false]));
    assert_eq!(chips("openscout"), ([false, true, false], [false, true, false]));
    assert_eq!(chips("openpodcar"), ([true, true, false], [false, true, false]));
    assert_eq!(chips("every-interface"), ([true; 3], [true; 3]));
}

#[test]
fn every_interface_uses_every_channel_of_the_carrier() {
    let robot = load("every-interface").unwrap();
    let count = |kind| robot.config.channels().filter(|(id, _)| id.kind == kind).count();
    use ChannelKind::{Analog, Bldc, Dac, DeadMan, Dhb, Encoder, Osmc, Range, Relay, Servo, Stepper, Supply, Switch};
    assert_eq!([count(Osmc), count(Dhb), count(Bldc), count(Servo), count(Stepper)], [4, 4, 4, 16, 4]);
    assert_eq!([count(Relay), count(Dac), count(Encoder), count(Switch), count(Range)], [8, 2, 4, 4, 4]);
    // six divided inputs; the dead-man's handle and the auxiliary stop
    assert_eq!([count(Analog), count(Supply), count(DeadMan)], [4, 2, 2]);
    let config = &robot.config;
    let homed = config.motors.iter().filter_map(|motor| motor.control?.homing).count();
    assert_eq!((homed, config.steppers.iter().filter(|stepper| stepper.homing.is_some()).count()), (1, 2));
    assert_eq!(config.relays[0].role, RelayRole::MotorPower);
}

#[test]
fn wiring_and_times_come_from_the_carrier() {
    let config = load("every-interface").unwrap().config;
    let BridgeConfig::Dhb(lines) = config.motors[7].bridge else { panic!("a DHB after four OSMC") };
    assert_eq!(lines, DhbLines { in1: 9, in2: 10, en: 11 });
    let Reverse::Line { line, .. } = config.bldcs[3].reverse else { panic!("a direction line") };
    assert_eq!((config.bldcs[3].output, line.bit, config.bldcs[3].brake.unwrap().bit), (3, 6, 7));
    assert_eq!(config.relays.iter().map(|relay| relay.bit).collect::<Vec<_>>(), (8..16).collect::<Vec<_>>());
    assert_eq!(
        (config.servos[15].output, config.servos[0].low.pulse_s, config.servos[0].high.pulse_s),
        (15, 1e-3, 2e-3)
    );
    let chips = (config.dhb_pwm.unwrap().address, config.servo_pwm.unwrap().address, config.bldc_dac.unwrap().address);
    assert_eq!((chips, config.expander.unwrap().address), ((0x41, 0x42, 0x60), 0x20));
    let bank = config.stepper_bank.unwrap();
    assert_eq!((bank.enable_setup_us, bank.direction_setup_us, bank.rate_max_hz), (5000, 5, 100e3));
    assert_eq!((config.ranges[0].range_m.min, config.ranges[0].range_m.max), (0.02, 4.0));
}

#[test]
fn what_is_not_said_about_the_truth_is_as_configured() {
    let robot = load("every-interface").unwrap();
    let (config, truth) = (&robot.config, &robot.simulation);
    assert_eq!(truth.motors.len(), config.motors.len());
    for (motor, simulated) in config.motors.iter().zip(&truth.motors) {
        let expected = motor.control.map(|_| SimulatedSensor::Encoder { input: motor.id.index, lines_per_turn: 600 });
        assert_eq!((simulated.channel, simulated.sensor), (motor.id, expected));
    }
    assert_eq!(truth.servo_oscillator_hz, f64::from(config.servo_pwm.unwrap().oscillator_hz));
    for (servo, simulated) in config.servos.iter().zip(&truth.servos) {
        let configured =
            [servo.low.pulse_s, servo.high.pulse_s, servo.low.angle_rad, servo.high.angle_rad].map(f64::from);
        let real = [simulated.pulse_min_s, simulated.pulse_max_s, simulated.angle_min_rad, simulated.angle_max_rad];
        assert_eq!((simulated.channel, real), (servo.id, configured));
    }
    for (bldc, simulated) in config.bldcs.iter().zip(&truth.bldcs) {
        let neutral_v = f64::from(bldc.neutral_v);
        assert_eq!(simulated.dead_zone_v, [neutral_v - 0.05, neutral_v + 0.05]);
        assert_eq!((simulated.forward_v, simulated.reverse_v), (bldc.forward_v.into(), None));
    }
    // 1 rad/s of 1600 steps a turn, and twice that
    let start_rate_hz = 2.0 * 1600.0 / std::f64::consts::TAU;
    assert!(truth.steppers.iter().all(|stepper| (stepper.start_rate_hz / start_rate_hz - 1.0).abs() < 1e-12));
    let closed_by: Vec<_> = truth.switches.iter().map(|switch| switch.closed_by).collect();
    let homed = |axis: &str, below| SwitchedBy::Axis { channel: axis.parse().unwrap(), below };
    let expected = [homed("osmc0", -1.0), homed("stepper0", -0.5), homed("stepper1", -0.5), SwitchedBy::Nothing];
    assert_eq!(closed_by, expected);
    // no range sensor stops the board from the start
    let nearest = config.ranges.iter().map(|range| f64::from(range.stop_below_m.unwrap_or(range.range_m.min)));
    assert!(truth.ranges.iter().zip(nearest).all(|(range, nearest_m)| {
        matches!(range.sees, r4_boards::RangeView::Constant { distance_m } if distance_m > nearest_m)
    }));
    let scale = |volts_per_code: f32| f64::from(volts_per_code);
    assert!(truth.analogs.iter().zip(&config.analogs).all(|(t, c)| t.volts_per_code == scale(c.volts_per_code)));
}

#[test]
fn wheels_can_reach_what_their_robot_may_be_asked_for() {
    for name in ["openscout", "openagribot"] {
        let robot = load(name).unwrap();
        let Some(Drive::SkidSteer(drive)) = robot.drive else { panic!("{name}") };
        for wheel in drive.left.iter().chain(&drive.right) {
            let motor = robot.config.motors.iter().find(|motor| motor.id == *wheel).unwrap();
            let speed_rad_s = f64::from(motor.control.unwrap().speed_max);
            assert!(speed_rad_s * drive.wheel_radius_m >= drive.speed_max_m_s, "{name} {wheel}");
        }
    }
}

#[test]
fn openpodcar_steers_by_the_published_calibration() {
    let Some(Drive::Ackermann(drive)) = load("openpodcar").unwrap().drive else { panic!("a car") };
    // 10-bit codes 29 and 989 at 0 and 0.1 m, 5 V; angle = 0.40665 V - 0.50843 (OpenPodCar2)
    for position_m in [0.0, 0.0236, 0.05] {
        let feedback_v = (29.0 + position_m / 0.1 * 960.0) / 1023.0 * 5.0;
        let published_rad = 0.40665 * feedback_v - 0.50843;
        let law = drive.steering_law;
        // five digits in the file
        assert!((law.angle_rad(position_m) - published_rad).abs() < 2e-5);
        assert!((law.position_m(published_rad) - position_m).abs() < 2e-6);
    }
    // 25 degrees, and so a turning radius of 2.25 m at the rear axle
    assert!((drive.wheelbase_m / drive.steering_rad.max.tan() - 2.25).abs() < 0.01);
}

/// Published: 0.625 N m and 573 W, 4 N m and 262 W, links of 0.70 and 0.40 m, at most 7 kg, ratios of 20 to 30, centre
/// of mass at most 0.23 m behind the back while it hangs.
#[test]
fn the_tail_has_the_published_numbers() {
    let robot = load("balance-tail").unwrap();
    let rotors: Vec<_> = robot.simulation.bldcs.iter().map(|bldc| bldc.rotor.unwrap()).collect();
    let limits: Vec<_> = rotors.iter().map(|rotor| [rotor.torque_max_nm, rotor.power_max_w]).collect();
    assert_eq!(limits, [[0.625, 573.0], [4.0, 262.0]]);
    let body = robot.simulation.body.unwrap();
    let r4_world::AnyBody::BalanceTail(tail) = &body.kind else { panic!("a tail") };
    let [inner, outer] = tail.links();
    assert_eq!([inner.length_m, outer.length_m], [0.70, 0.40]);
    assert!(inner.mass_kg + outer.mass_kg <= 7.0 && -tail.tail_x_m() <= 0.23);
    assert!([inner, outer].iter().all(|link| (20.0..=30.0).contains(&link.cable.ratio)));
    // The stronger motor is at the back, where 50 N m are needed: 100 N m against 15.6 N m.
    let strongest_nm = |link: &r4_world::Link| {
        let channel = body.channels[link.cable.shaft];
        let bldc = robot.simulation.bldcs.iter().find(|bldc| bldc.channel == channel).unwrap();
        bldc.rotor.unwrap().torque_max_nm * link.cable.ratio
    };
    assert_eq!([inner, outer].map(strongest_nm), [100.0, 15.625]);
    let weight_nm = 9.80665 * (inner.mass_kg * inner.centre_m + outer.mass_kg * (inner.length_m + outer.centre_m));
    assert!((49.0..51.0).contains(&weight_nm), "{weight_nm}");
}

/// Published: vials of 10 to 50 mm and at most 150 g, 3 mm of clearance, a bend radius of 5 mm, which is half the
/// smallest vial.
#[test]
fn the_cable_loop_has_the_published_numbers() {
    let body = load("cable-loop").unwrap().simulation.body.unwrap();
    let r4_world::AnyBody::CableLoop(gripper) = &body.kind else { panic!("a gripper") };
    assert_eq!((gripper.vial().clearance_m, gripper.finger().bend_radius_m), (0.003, 0.005));
    assert!((0.010..=0.050).contains(&gripper.vial().diameter_m) && gripper.vial().mass_kg <= 0.150);
    let channels: Vec<_> = body.channels.iter().map(ToString::to_string).collect();
    assert_eq!(channels, ["dhb0", "stepper0", "stepper1", "stepper2"]);
}

/// Published: narrow 24 cm, 66 % of the width at rest; boxes of 22 x 16.5 cm, 24 cm apart, 20 cm before the robot, 10
/// kg in each; 200 ms.
#[test]
fn deformobot_and_its_gate_have_the_published_numbers() {
    let robot = load("deformobot").unwrap();
    let body = robot.simulation.body.unwrap();
    let AnyBody::Deformable(robot) = &body.kind else { panic!("a shell") };
    let channels: Vec<_> = body.channels.iter().map(ToString::to_string).collect();
    assert_eq!(channels, ["servo0", "dhb0", "dhb1"]);
    let shell = robot.shell();
    let wide_m = shell.width_m(shell.rest_rad);
    assert!((0.24 / wide_m - 0.66).abs() < 1e-3, "{wide_m}");
    assert!(shell.width_m(shell.angle_rad(1.0)) < 0.24);
    assert_eq!((robot.whiskers().every_s, robot.whiskers().late_s), (0.2, 0.2));
    let gate = r4_boards::load_world("gate").unwrap().scene;
    let [left, right] = gate.boxes() else { panic!("two boxes") };
    assert_eq!((left.spec().size_m, left.spec()), ([0.165, 0.22], right.spec()));
    let inner_m = left.corners_m()[0][1] - right.corners_m()[1][1];
    let before_m = left.corners_m()[2][0] - 0.5 * shell.length_m(shell.rest_rad);
    assert!((inner_m - 0.24).abs() < 1e-9 && (before_m - 0.20).abs() < 1e-6, "{inner_m}, {before_m}");
    assert!(left.spec().mass_kg > 10.0);
}

#[test]
fn every_world_is_read() {
    for name in r4_boards::world_names() {
        let world = r4_boards::load_world(name).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(world.on_stand, name == "stand");
    }
}
