//! Motors with undeclared friction, dead band, play or supply: the board learns them on line.

use std::f64::consts::TAU;

use r4_boards::{PlantFile, Robot};
use r4_protocol::{Mode, Sample};

use crate::{
    harness::{Bench, ROTARY, bench, control_of, osmc_bench},
    whole_board::sample,
};

/// A motor of 8.7 rad/s and 64 ms, to which a test adds effects.
const MOTOR: &str = r#"
model = "dc-gear-motor"
source = "test"
[parameters]
resistance_ohm = 2.4
inductance_h = 0.001
torque_constant_nm_per_a = 0.11
gear_ratio = 25.0
inertia_kg_m2 = 0.2
viscous_nm_s_per_rad = 0.03
"#;
/// Undeclared effects. Stalled at 24 V the motor has 27.5 N m; levels here are up to a third of that.
const HIDDEN: [&str; 7] = [
    "",
    "[[effects]]\neffect = \"coulomb-friction\"\ntorque_nm = 6.0",
    "[[effects]]\neffect = \"coulomb-friction\"\ntorque_nm = 2.0\n[[effects]]\neffect = \"static-friction\"\ntorque_nm = 7.0\n\
     stribeck_rad_s = 0.3",
    "[[effects]]\neffect = \"dead-zone\"\nduty = 0.25",
    "[[effects]]\neffect = \"direction-friction\"\nforward_torque_nm = 6.0\nbackward_torque_nm = 2.0",
    "[[effects]]\neffect = \"coulomb-friction\"\ntorque_nm = 1.0\n[[effects]]\neffect = \"backlash\"\ngap_rad = 0.035",
    "[[effects]]\neffect = \"coulomb-friction\"\ntorque_nm = 3.0\n[[effects]]\neffect = \"supply-sag\"\nsource_ohm = 0.5",
];
/// Counts per turn of an encoder of 600 lines.
const TURN: f64 = 2400.0;

/// The bench with this motor, whose file declares no friction.
fn robot(hidden: &str) -> Robot {
    let mut robot = osmc_bench();
    let control = control_of(&mut robot.config, 0);
    control.feed_forward.static_duty = 0.0;
    control.feed_forward.duty_per_speed = 0.115;
    control.feed_forward.duty_per_acceleration = 0.115 * 0.064;
    control.profile.jerk = 50.0;
    control.settle.error = 0.0027;
    robot.simulation.motors[0].plant = PlantFile { name: "hidden".to_owned(), text: format!("{MOTOR}\n{hidden}\n") };
    robot
}

async fn counts(bench: &Bench<'_>) -> f64 {
    let Sample::Motor { position, .. } = sample(bench, ROTARY).await else { panic!("a motor") };
    f64::from(position)
}

/// Three moves to whole counts; each ends within one of them, overshoots by at most a hundredth of the distance, and
/// stays: in 60 s at the last the encoder sees no motion, and the duty is below the break-away level.
#[test]
fn whatever_resists_a_motor_comes_to_within_a_count_and_stays() {
    for hidden in HIDDEN {
        bench(&robot(hidden), async |bench| {
            bench.host.arm().await.expect("it arms");
            bench.sleep_ms(100).await;
            let mut from = 0.0;
            for target in [600.0, 1200.0, 300.0] {
                bench.set(ROTARY, Mode::Position, (target / TURN * TAU) as f32).await.expect("it is in range");
                let mut beyond = 0.0f64;
                for _ in 0..1250 {
                    bench.sleep_ms(4).await;
                    beyond = beyond.max((bench.position(ROTARY) / TAU * TURN - target) * f64::signum(target - from));
                }
                let error = counts(bench).await - target;
                assert!(error.abs() <= 1.0, "{hidden}: {error} counts off {target}");
                // the true position is up to a count beyond the encoder's
                assert!(beyond <= 0.01 * f64::abs(target - from) + 1.0, "{hidden}: {beyond} counts beyond {target}");
                from = target;
            }
            let before = counts(bench).await;
            for _ in 0..60 {
                bench.sleep_ms(1000).await;
                assert_eq!(counts(bench).await, before, "{hidden}");
            }
        });
    }
}
