//! Test of the estimators on a car in MuJoCo 3.17.0, which shares no code with `r4-world`:
//! `tests/oracle/skidcal_mujoco.py` drives it through both tests and measures its compliance by towing it.

use serde::Deserialize;

use super::{
    bristle, estimate,
    protocol::{Felt, Recording, Run, SkidRobot, Tracked, WheelSample},
    scene::Noise,
};

#[derive(Deserialize)]
struct Oracle {
    mass_kg: f64,
    half_m: [f64; 2],
    wheel_radius_m: f64,
    towed_per_n: Vec<f64>,
    straight: Vec<Seen>,
    spin: Seen,
}

#[derive(Deserialize)]
struct Seen {
    /// Time, s; travel left and right, m.
    wheels: Vec<[f64; 3]>,
    /// Time, s; x and y, m; yaw, rad.
    tracked: Vec<[f64; 4]>,
    /// Time, s; forward acceleration, m/s².
    felt: Vec<[f64; 2]>,
}

impl Seen {
    fn run(&self, noise: &mut Noise) -> Run {
        let wheels =
            self.wheels.iter().map(|&[time_s, left_m, right_m]| WheelSample { time_s, travel_m: [left_m, right_m] });
        let tracked = self
            .tracked
            .iter()
            .map(|&[time_s, x_m, y_m, yaw_rad]| Tracked::new(time_s, [x_m, y_m, yaw_rad], noise.place()));
        let (wheels, tracked) = (wheels.collect(), tracked.collect());
        let felt =
            self.felt.iter().map(|&[time_s, forward_m_s2]| Felt::new(time_s, forward_m_s2, noise.inertial_m_s2()));
        Run { wheels, tracked, felt: felt.collect(), ..Run::default() }
    }
}

fn oracle() -> Oracle {
    serde_json::from_str(include_str!("../../tests/oracle/skidcal_mujoco.json")).expect("the oracle's file")
}

impl Oracle {
    fn recording(&self, seed: u64) -> Recording {
        let openscout = r4_boards::load("openscout").expect("built in");
        let mut robot = SkidRobot::of(&openscout, self.mass_kg).expect("a skid-steer robot");
        robot.half_m = self.half_m;
        robot.drive.wheel_radius_m = self.wheel_radius_m;
        let mut recording = Recording::new(robot, 0.0);
        let mut noise = Noise::of(seed);
        recording.straight = self.straight.iter().map(|seen| seen.run(&mut noise)).collect();
        recording.runs = 1;
        recording.spin = self.spin.run(&mut noise);
        recording
    }
}

#[test]
fn without_noise_a_car_in_mujoco_has_the_compliances_it_was_towed_with() {
    let oracle = oracle();
    let exact = oracle.recording(1).without_noise();
    let [tracked, felt] = [bristle::c_long(&exact), bristle::c_long_inertial(&exact)];
    for towed_per_n in &oracle.towed_per_n {
        for (sensor, found) in [("tracker", &tracked), ("inertial", &felt)] {
            let relative = found.as_ref().expect("an estimate").value / towed_per_n;
            // The corners of the car's ramps are smeared over two samples of the wheels: 1 %.
            assert!((relative - 1.0).abs() < 0.02, "{sensor}: {relative} of {towed_per_n}");
        }
    }
    // The model has one damping for both directions. Wheels that sink in roll on a radius that is 0.1 % smaller.
    let ratio = estimate::ratio(&exact).expect("an estimate").value;
    assert!((ratio - 1.0).abs() < 0.003, "{ratio}");
}

#[test]
fn intervals_from_one_noisy_run_cover_what_a_car_in_mujoco_was_towed_with() {
    const SEEDS: u64 = 20;
    let oracle = oracle();
    let towed_per_n = oracle.towed_per_n[0];
    let covers = |found: estimate::Estimate| found.interval.is_some_and(|interval| interval.contains(towed_per_n));
    let count = |estimate: fn(&Recording) -> Option<estimate::Estimate>| {
        (1..=SEEDS).filter(|seed| estimate(&oracle.recording(*seed)).is_some_and(covers)).count()
    };
    // 95 % intervals: fewer than 16 of 20 have a probability of 0.3 %.
    let (tracked, felt) = (count(bristle::c_long), count(bristle::c_long_inertial));
    assert!(tracked >= 16 && felt >= 16, "tracker {tracked}, inertial {felt} of {SEEDS}");
}
