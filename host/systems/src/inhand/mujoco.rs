//! Comparison of both methods on fingers in MuJoCo 3.17.0, which shares no code with `r4-world`:
//! `tests/oracle/inhand_mujoco.py` grips discs and square bars and performs both motions. Angles are exact; contact,
//! friction and rolling differ.

use serde::Deserialize;

use super::{
    four_bar::{self, Observation},
    rolling,
};

#[derive(Deserialize)]
struct Oracle {
    half_width_m: f64,
    grasps: Vec<Grasp>,
}

#[derive(Deserialize)]
struct Grasp {
    shape: String,
    across_m: f64,
    /// Palm, m; left and right finger, rad; left and right contact from the joints, and distance between the contacts,
    /// m.
    stops: Vec<[f64; 6]>,
}

#[test]
fn objects_in_mujoco_are_measured_by_ours_and_less_well_by_constant_links() {
    let oracle: Oracle =
        serde_json::from_str(include_str!("../../tests/oracle/inhand_mujoco.json")).expect("the oracle's file");
    for Grasp { shape, across_m, stops } in &oracle.grasps {
        let seen: Vec<Observation> = stops
            .iter()
            .map(|&[palm_m, left_rad, right_rad, ..]| Observation { palm_m, finger_rad: [left_rad, right_rad] })
            .collect();
        let [.., left_m, right_m, size_m] = stops[0];
        let ours = rolling::fit(oracle.half_width_m, &seen, true).expect("a grasp");
        let paper = four_bar::fit(oracle.half_width_m, &seen);
        let errors_m = [
            ours.size_m - size_m,
            (ours.contact_m[0] - left_m).abs().max((ours.contact_m[1] - right_m).abs()),
            paper.c_m - size_m,
            (paper.b_m - left_m).abs().max((paper.d_m - right_m).abs()),
        ];
        println!("{shape} {across_m} m: size and contact, ours and constant links {errors_m:?}");
        let [size_m, contact_m, _, constant_m] = errors_m;
        assert!(size_m.abs() < 3e-4 && contact_m < 1e-3, "{shape} {across_m}: {errors_m:?}");
        // Sharp bars do not roll: both methods are alike there.
        assert!(shape == "bar" || constant_m > 3.0 * contact_m, "{shape} {across_m}: {errors_m:?}");
    }
}
