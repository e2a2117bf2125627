//! The files that are part of the program, against what they are made from.

use std::{collections::HashSet, fs};

use r4_boards::{
    SimulatedSensor,
    carrier::{Chip, PinKind},
    carrier_names, load, load_carrier, names,
};
use r4_protocol::{
    channel::{ChannelId, ChannelKind},
    config::{BridgeConfig, Feedback, MotorConfig, PotPoint, PwmConfig},
};

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
    let encoder = Feedback::Encoder { index: 0, counts_per_turn: 2400, inverted: false };
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
    fs::write(&path, include_str!("../osmc-bench.toml")).unwrap();
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
