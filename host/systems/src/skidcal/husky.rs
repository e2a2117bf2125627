//! Ratio of the spin on recordings of a real robot, `data/husky_skidsteer`: windows of 2 s in which a Husky turns
//! nearly on the spot.

use std::{collections::BTreeMap, path::Path};

use r4_maths::statistics::{QuantileRule, quantile};

use super::{
    estimate,
    protocol::{Recording, Run, SkidRobot, Tracked, WheelSample},
};

/// Radius of the wheels and half track from the recording's README, and half wheelbase from the maker's datasheet
/// (0.512 m), m.
const RADIUS_M: f64 = 0.165;
const HALF_M: [f64; 2] = [0.256, 0.275];
/// Limits of a window that counts as a spin: the robot moves less than the first, m/s, and its wheels turn it faster
/// than the second, rad/s.
const MOVES_M_S: f64 = 0.1;
const TURNS_RAD_S: f64 = 0.5;

struct Sample {
    time_s: f64,
    wheels_rad_s: [f64; 2],
    yaw_rad: f64,
}

/// Windows of the recording in which the speeds have settled.
fn windows() -> Vec<Vec<Sample>> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../data/husky_skidsteer/husky.csv");
    let text = std::fs::read_to_string(path).expect("the recording");
    let mut lines = text.lines();
    let names: Vec<&str> = lines.next().expect("a header").split(',').collect();
    let mut windows: BTreeMap<[u32; 2], Vec<Sample>> = BTreeMap::new();
    for line in lines {
        let fields: Vec<f64> = line.split(',').map(|field| field.parse().expect("a number")).collect();
        let of = |name: &str| fields[names.iter().position(|known| *known == name).expect("a column")];
        if of("steady") == 1.0 {
            let sample = Sample {
                time_s: of("t_s"),
                wheels_rad_s: [of("wheel_left_rad_s"), of("wheel_right_rad_s")],
                yaw_rad: of("yaw_rad"),
            };
            windows.entry([of("step") as u32, of("window") as u32]).or_default().push(sample);
        }
    }
    windows.into_values().collect()
}

/// Mean rim speeds of both sides, m/s.
fn rims_m_s(window: &[Sample]) -> [f64; 2] {
    [0, 1]
        .map(|side| RADIUS_M * window.iter().map(|sample| sample.wheels_rad_s[side]).sum::<f64>() / window.len() as f64)
}

/// Converts a window to SKIDCAL's spin.
fn spin(window: &[Sample]) -> Recording {
    let openscout = r4_boards::load("openscout").expect("built in");
    let mut robot = SkidRobot::of(&openscout, 50.0).expect("a skid-steer robot");
    robot.half_m = HALF_M;
    robot.drive.wheel_radius_m = RADIUS_M;
    let mut travel_m = [0.0; 2];
    let mut before_s = window.first().map_or(0.0, |sample| sample.time_s);
    let mut run = Run::default();
    for sample in window {
        for (travel_m, rad_s) in travel_m.iter_mut().zip(sample.wheels_rad_s) {
            *travel_m += RADIUS_M * rad_s * (sample.time_s - before_s);
        }
        before_s = sample.time_s;
        run.wheels.push(WheelSample { time_s: sample.time_s, travel_m });
        run.tracked.push(Tracked::new(sample.time_s, [0.0, 0.0, sample.yaw_rad], [0.0; 3]));
    }
    Recording { spin: run, ..Recording::new(robot, 0.0) }
}

/// On a real robot the ratio is not constant, unlike in the linear law: its quartiles are 13 % and more from the
/// median, as the page reports.
#[test]
fn spins_of_a_husky_have_a_ratio_of_two_thirds_that_scatters() {
    let is_spin = |window: &&Vec<Sample>| {
        let [left_m_s, right_m_s] = rims_m_s(window);
        let turns_rad_s = (right_m_s - left_m_s) / 2.0 / HALF_M[1];
        f64::midpoint(left_m_s, right_m_s).abs() < MOVES_M_S && turns_rad_s.abs() > TURNS_RAD_S
    };
    let ratio = |window: &Vec<Sample>| estimate::ratio(&spin(window)).expect("it turns").value;
    let ratios: Vec<f64> = windows().iter().filter(is_spin).map(ratio).collect();
    assert_eq!(ratios.len(), 22);
    let quartiles = [0.25, 0.5, 0.75].map(|share| quantile(&ratios, share, QuantileRule::Linear).expect("numbers"));
    for (found, reported) in quartiles.into_iter().zip([0.543, 0.642, 0.696]) {
        // Half of the last reported digit.
        assert!((found - reported).abs() < 5e-4, "{quartiles:?}");
    }
}
