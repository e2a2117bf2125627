//! Robots with deliberately wrong parameters; the true values are read from the simulated world, as a person would
//! measure them.

use std::fs;

use r4_sim::chips::Line;
use r4_world::Pose;
use tempfile::TempDir;

use super::*;
use crate::{Rig, Target};

const BENCH: &str = include_str!("../../../../boards/osmc-bench.toml");
const EVERYTHING: &str = include_str!("../../../../boards/every-interface.toml");

/// A person who answers from the true state of the simulated world.
struct Known<F>(F);

impl<F: FnMut(&Session<'_>) -> String> Person for Known<F> {
    async fn ask(&mut self, session: &Session<'_>, _: &str) -> Result<String, NoAnswer> {
        Ok((self.0)(session))
    }
}

/// Returns `robot` with replacements, each of which must match exactly once.
fn wrong(robot: &str, changes: &[(&str, &str)]) -> String {
    changes.iter().fold(robot.to_owned(), |robot, (is, becomes)| {
        assert_eq!(robot.matches(is).count(), 1, "{is}");
        robot.replace(is, becomes)
    })
}

/// Calibrates a board of this robot; `known` answers the questions.
fn calibrated(
    robot: &str,
    calibration: &Calibration,
    known: impl FnMut(&Session<'_>) -> String,
) -> Result<Found, Error> {
    let folder = TempDir::new().expect("a folder");
    let file = folder.path().join("robot.toml");
    fs::write(&file, robot).expect("a file");
    let rig = Rig::new(Target::Sim(file.display().to_string()));
    Ok(rig.run(None, async |session| calibrate(session, calibration, &mut Known(known)).await)?.0)
}

fn encoder(name: &str, by: Turning) -> Calibration {
    Calibration::Encoder { channel: channel(name), by }
}

fn potentiometer(name: &str, drive: bool) -> Calibration {
    Calibration::Potentiometer { channel: channel(name), drive }
}

fn servo(name: &str) -> Calibration {
    Calibration::ServoOscillator { channel: channel(name) }
}

fn wheels(left: &[&str], right: &[&str]) -> Calibration {
    let [left, right] = [left, right].map(|names| names.iter().map(|name| channel(name)).collect());
    Calibration::Wheels { left, right, turn: quantity("2turns") }
}

fn quantity(text: &str) -> Quantity {
    text.parse().expect("a quantity")
}

fn channel(name: &str) -> ChannelId {
    name.parse().expect("a channel")
}

fn truth(session: &Session<'_>, of: &str) -> f64 {
    session.true_position(channel(of)).expect("it is simulated")
}

#[test]
fn an_encoders_scale_is_recovered() {
    // 600 lines give 2400 counts.
    for assumed in ["1800", "2500", "2400"] {
        let robot = wrong(BENCH, &[("counts_per_turn = 2400", &format!("counts_per_turn = {assumed}"))]);
        let mut begin = None;
        let found = calibrated(&robot, &encoder("osmc0", Turning::Driven(quantity("1000deg"))), move |session| {
            let at = truth(session, "osmc0");
            format!("{}rad", at - *begin.get_or_insert(at))
        });
        let found = found.expect("calibrated");
        // Two counts of some 6700, and the shaft creeps during the measurement.
        assert!((f64::from(found.changes[0].to) - 2400.0).abs() <= 3.0, "{assumed}: {found:?}");
    }
}

#[test]
fn a_shaft_that_nobody_turned_is_noticed() {
    let by_hand = |turns| Turning::ByHand { turns };
    for (calibration, says) in [
        (encoder("osmc0", by_hand(1.0)), "not seen to move"),
        (encoder("actuator1", by_hand(1.0)), "has no encoder"),
        (encoder("osmc0", by_hand(0.0)), "other than 0"),
        (encoder("osmc0", Turning::Driven(quantity("10mm"))), "takes an angle"),
        (potentiometer("osmc0", false), "has no potentiometer"),
        (potentiometer("actuator1", false), "not what was asked for"),
        (servo("osmc0"), "no servo"),
        (wheels(&["osmc0"], &["osmc0"]), "both sides"),
        (wheels(&["actuator1"], &[]), "no motor with an encoder"),
    ] {
        let error = calibrated(BENCH, &calibration, |_| String::new()).expect_err(says);
        assert!(error.to_string().contains(says), "{calibration:?}: {error}");
    }
}

#[test]
fn a_potentiometers_points_are_recovered() {
    let robot = wrong(
        BENCH,
        &[
            ("low = { code_16bit = 1858, position_m = 0.0 }", "low = { code_16bit = 1300, position_m = 0.0 }"),
            ("high = { code_16bit = 63357, position_m = 0.1 }", "high = { code_16bit = 64500, position_m = 0.1 }"),
        ],
    );
    let measure = |session: &Session<'_>| format!("{}m", truth(session, "actuator1"));
    let found = calibrated(&robot, &potentiometer("actuator1", true), measure).expect("calibrated");
    let codes: Vec<_> = found.changes.iter().map(|change| (change.parameter.to_string(), change.to)).collect();
    // The limit is 0.02 mm: rounding of the simulated 10-bit codes, noise, and creep of the rod.
    for ((key, code), (name, is)) in
        codes.iter().zip([("actuator1.pot_low_code", 1858.0), ("actuator1.pot_high_code", 63357.0)])
    {
        assert!(*key == name && (code - is).abs() <= 13.0, "{found:?}");
    }
    let twice = calibrated(&robot, &potentiometer("actuator1", true), |_| "50mm".into());
    assert!(twice.expect_err("too near").to_string().contains("too near"));
}

#[test]
fn a_servo_chips_oscillator_is_recovered() {
    // The board assumes 25 MHz; the true frequency is in the robot's file.
    for hz in ["26.1e6", "24.2e6"] {
        let robot = wrong(EVERYTHING, &[("oscillator_hz = 25.6e6 # as if it had been measured\n", "")]);
        let robot = robot + "\n[simulation]\nservo_oscillator_hz = " + hz + "\n";
        for by_pulse in [false, true] {
            let scope = move |session: &Session<'_>| {
                let board = session.virtual_board().expect("simulated");
                let world = board.world();
                let chip = world.servo_pwm().expect("there are servos").borrow();
                let period_s = chip.pwm_period_ns() as f64 * 1e-9;
                let Line::Pwm { on, off } = chip.line(0) else { panic!("no pulses") };
                let pulse_us = f64::from(off - on) / 4096.0 * period_s * 1e6;
                if by_pulse { format!("{pulse_us:.2}us") } else { format!("{:.4}Hz", 1.0 / period_s) }
            };
            let found = calibrated(&robot, &servo("servo0"), scope).expect("calibrated");
            let is: f32 = hz.parse().expect("a number");
            // Rounding of the answer: four digits after the point of 50 Hz, two after that of 2000 µs.
            assert!((found.changes[0].to / is - 1.0).abs() < 1e-5, "{found:?}");
        }
    }
    let wild = calibrated(EVERYTHING, &servo("servo0"), |_| "20ms".into()).expect_err("measured wrongly");
    assert!(wild.to_string().contains("measure again"), "{wild}");
}

#[test]
fn wheels_are_told_for_the_robots_file() {
    const RADIUS_M: f64 = 0.056;
    // By the linear law of the tyres: track (l² + r b²) / r b² for half a track b, half a wheelbase l, and r = 4 times
    // as much slip across.
    const TRACK_M: f64 = 0.302 * (0.12 * 0.12 + 4.0 * 0.151 * 0.151) / (4.0 * 0.151 * 0.151);
    let (mut asked, mut begin) = (0, Pose::default());
    // The answers of a ruler and a protractor on the floor.
    let measure = move |session: &Session<'_>| {
        let board = session.virtual_board().expect("simulated");
        let now = board.world().pose().expect("it has a body");
        let (way_m, turned_rad) = ((now.x_m - begin.x_m).hypot(now.y_m - begin.y_m), now.yaw_rad - begin.yaw_rad);
        begin = now;
        asked += 1;
        match asked {
            2 => format!("{way_m:.4}m"),
            4 => format!("{:.3}deg", turned_rad.to_degrees()),
            _ => String::new(),
        }
    };
    let robot = include_str!("../../../../boards/openscout.toml");
    let found = calibrated(robot, &wheels(&["dhb0", "dhb2"], &["dhb1", "dhb3"]), measure).expect("calibrated");
    let toml: toml::Table = found.toml.expect("for the file").parse().expect("TOML");
    let drive = &toml["drive"]["skid-steer"];
    let number = |name: &str| drive[name].as_float().expect("a number");
    // Wheels slip by 1 % while they accelerate, and by as much the other way while they brake; the brush slides a
    // little at once.
    assert!((number("wheel_radius_m") / RADIUS_M - 1.0).abs() < 2e-3, "{drive}");
    assert!((number("track_m") / TRACK_M - 1.0).abs() < 0.02, "{drive}");
    assert_eq!(drive["left"].as_array().expect("channels").len(), 2);
}
