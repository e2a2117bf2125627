//! Tests of the built-in plant files: they do what their comments say, by the closed forms of a motor and by
//! simulation.

use r4_boards::{Robot, SimulatedMotor, SimulatedSensor, load, names};
use r4_plants::{Drive, Plant, PlantKind, PlantSpec, catalogue};

fn plant(motor: &SimulatedMotor) -> Plant {
    let spec = PlantSpec::from_toml(&motor.plant.name, &motor.plant.text).expect("a plant file");
    let mut plant = Plant::new(&spec, 1);
    plant.set_position(motor.start);
    plant
}

fn motor<'r>(robot: &'r Robot, channel: &str) -> &'r SimulatedMotor {
    robot.simulation.motors.iter().find(|motor| motor.channel.to_string() == channel).expect("simulated")
}

fn run(plant: &mut Plant, duty: f64, supply_v: f64, time_s: f64) {
    let steps = (time_s / 1e-3).round() as u32;
    (0..steps).for_each(|_| plant.advance(Drive { duty, coast: 0.0 }, supply_v, 1e-3));
}

#[test]
fn every_plant_is_one_of_its_motors_kind() {
    for robot in names().map(|name| load(name).unwrap()) {
        for motor in &robot.simulation.motors {
            let slides = matches!(motor.sensor, Some(SimulatedSensor::Potentiometer { .. }));
            let expected = if slides { PlantKind::Linear } else { PlantKind::Rotary };
            assert_eq!(plant(motor).kind(), expected, "{} of {}", motor.channel, robot.file);
        }
    }
}

#[test]
fn the_page_names_every_effect() {
    let page = include_str!("../../README.md");
    for effect in catalogue() {
        assert!(page.contains(&format!("`{}`", effect.name)), "boards/README.md lacks {}", effect.name);
    }
}

#[test]
fn wheels_reach_the_speed_and_have_the_time_constant_that_is_said() {
    // rad/s, ms; 2 % covers the three digits of the comments. A random load on the ground averages out in the mean.
    let said = [("openscout", "dhb0", 12.0, 1.0, 10.34, 0.0077), ("openagribot", "osmc0", 24.0, 1.0, 7.67, 0.0426)];
    for (robot, channel, supply_v, duty, speed_rad_s, time_constant_s) in said {
        let mut plant = plant(motor(&load(robot).unwrap(), channel));
        run(&mut plant, duty, supply_v, time_constant_s);
        // The winding, L/R of 1 and 1.7 ms, delays: 10 %.
        assert!((plant.speed() / speed_rad_s - 0.632).abs() < 0.1 * 0.632, "{robot} {}", plant.speed());
        run(&mut plant, duty, supply_v, 1.0);
        let from_rad = plant.position();
        run(&mut plant, duty, supply_v, 10.0);
        let mean_rad_s = (plant.position() - from_rad) / 10.0;
        assert!((mean_rad_s / speed_rad_s - 1.0).abs() < 0.02, "{robot} {mean_rad_s}");
    }
}

#[test]
fn openpodcar_drives_a_metre_per_second_at_the_published_duty() {
    let mut plant = plant(motor(&load("openpodcar").unwrap(), "osmc0"));
    run(&mut plant, 0.49, 24.0, 3.0);
    // 1 % is what the chosen constants leave
    assert!((plant.speed() * 0.17775 - 1.0).abs() < 0.01, "{}", plant.speed() * 0.17775);
}

#[test]
fn the_implement_lifts_lowers_and_stays() {
    let robot = load("openagribot").unwrap();
    let mut implement = plant(motor(&robot, "dhb0"));
    // m/s; 3 % for two digits
    for (duty, speed_m_s) in [(0.95, 0.0184), (-0.95, -0.0218)] {
        run(&mut implement, duty, 12.0, 1.0);
        assert!((implement.speed() / speed_m_s - 1.0).abs() < 0.03, "{duty} {}", implement.speed());
    }
    for terminals in [Drive::COAST, Drive::BRAKE] {
        implement.set_position(0.1);
        (0..1000).for_each(|_| implement.advance(terminals, 12.0, 1e-3));
        assert_eq!(implement.position(), 0.1);
    }
}

#[test]
fn the_feed_forward_of_friction_does_not_move_a_motor_by_itself() {
    for robot in names().map(|name| load(name).unwrap()) {
        for (config, simulated) in robot.config.motors.iter().zip(&robot.simulation.motors) {
            let Some(control) = config.control else { continue };
            let rail = robot.simulation.rails.iter().find(|rail| rail.channel == simulated.rail).unwrap();
            let mut plant = plant(simulated);
            // A little inside its travel, so that no end stop holds it.
            plant.set_position(f64::from(control.position.min) + 0.01);
            let from = plant.position();
            run(&mut plant, control.feed_forward.static_duty.into(), rail.emf_v, 0.5);
            let moved = (plant.position() - from).abs();
            // A random load may push it a little, by less than what counts as standing.
            assert!(moved <= f64::from(control.settle.error), "{} of {}: {moved}", config.id, robot.file);
        }
    }
}
