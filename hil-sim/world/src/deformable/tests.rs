use std::f64::consts::{FRAC_PI_3, FRAC_PI_6, PI};

use super::*;
use crate::{BoxSpec, Chassis, MAX_STEP_S, SlipLaw, Tyre, Wheel};

const SHELL: Shell =
    Shell { panel_m: 0.21, rest_rad: FRAC_PI_3, per_rad: -0.5, ends_rad: [0.58, FRAC_PI_3], holds_n: 25.0, shaft: 2 };
const WHISKERS: Whiskers = Whiskers {
    hinge_m: [-0.02, 0.01],
    length_m: 0.19,
    rest_rad: 1.3,
    stiffness_nm_per_rad: 0.15,
    hysteresis_rad: 0.0,
    every_s: 0.2,
    late_s: 0.2,
    noise_rad: 0.0,
    seed: 1,
};
const RADIUS_M: f64 = 0.056;
const NARROW_RAD: f64 = 0.58;
const HEAVY: BoxSpec = BoxSpec { size_m: [0.165, 0.22], mass_kg: 10.2, friction: 0.4, kinetic_share: 0.85 };
const LIGHT: BoxSpec = BoxSpec { mass_kg: 0.2, ..HEAVY };

fn robot(whiskers: Whiskers) -> Deformable {
    let tyre = Tyre { compliance_per_n: [0.005, 0.02], friction: 0.7, relaxation_m: 0.03, law: SlipLaw::Brush };
    let wheel = |place_m, shaft: Option<usize>| Wheel {
        place_m,
        radius_m: RADIUS_M,
        shaft,
        inverted: false,
        steered: false,
        tyre: shaft.map(|_| tyre),
    };
    let wheels = vec![
        wheel([0.0, 0.08], Some(0)),
        wheel([0.0, -0.08], Some(1)),
        wheel([0.12, 0.0], None),
        wheel([-0.12, 0.0], None),
    ];
    let chassis = Chassis { mass_kg: 2.5, inertia_kg_m2: 0.03, centre_m: [0.0; 2], height_m: 0.03 };
    Deformable::new(Wheeled::new(chassis, wheels, None, 3).unwrap(), SHELL, whiskers).unwrap()
}

fn still(shape_rad: f64) -> [ShaftMotion; 3] {
    let mut shafts = [ShaftMotion::default(); 3];
    shafts[2].position = (shape_rad - SHELL.rest_rad) / SHELL.per_rad;
    shafts
}

/// Drives at 0.187 m/s, starting after the first second.
fn drive(body: &mut Deformable, scene: &mut Scene, shape_rad: f64, for_s: f64) {
    let mut shafts = still(shape_rad);
    for number in 0..(for_s / MAX_STEP_S) as usize {
        let rim_m_s = 0.187 * (number as f64 * MAX_STEP_S).min(1.0);
        (shafts[0].speed, shafts[1].speed) = (rim_m_s / RADIUS_M, rim_m_s / RADIUS_M);
        body.step(scene, number as f64 * MAX_STEP_S, &shafts, &mut [0.0; 3], MAX_STEP_S);
    }
}

/// Two boxes with a gap between them, their faces 0.41 m in front of the robot's middle.
fn gate(spec: BoxSpec, gap_m: f64) -> Scene {
    let mut scene = Scene::default();
    for side in [1.0, -1.0] {
        let y_m = side * 0.5 * (gap_m + spec.size_m[1]);
        scene.add_box(spec, Pose { x_m: 0.41 + 0.5 * spec.size_m[0], y_m, yaw_rad: 0.0 }).unwrap();
    }
    scene
}

/// Printed values, 66 % and 24 cm: 36.4 cm at rest; 24.0 cm and a third longer when narrow.
#[test]
fn the_hexagon_narrows_and_lengthens_as_printed() {
    let narrow_rad = libm::asin(0.24 / (2.0 * SHELL.panel_m));
    assert!((SHELL.width_m(FRAC_PI_3) - 0.3637).abs() < 1e-4);
    assert!((0.24 / SHELL.width_m(FRAC_PI_3) - 0.66).abs() < 1e-3);
    let longer = SHELL.length_m(narrow_rad) / SHELL.length_m(FRAC_PI_3);
    assert!((longer - 1.32).abs() < 2e-3, "{longer}");
    // Six sides of one length, and an inner hexagon 2 cm inside.
    let [nose, left, rear_left, ..] = SHELL.corners_m(0.8, 0.0);
    for side_m in [length(nose, left), length(left, rear_left)] {
        assert!((side_m - SHELL.panel_m).abs() < 1e-12, "{side_m}");
    }
    let inner = SHELL.corners_m(0.8, 0.02);
    let (along, way) = ([left[0] - nose[0], left[1] - nose[1]], [inner[0][0] - nose[0], inner[0][1] - nose[1]]);
    assert!(((along[0] * way[1] - along[1] * way[0]) / SHELL.panel_m - 0.02).abs() < 1e-12);
    assert!((inner[1][1] - (left[1] - 0.02)).abs() < 1e-12);
}

fn length(from: Point, to: Point) -> f64 {
    libm::hypot(to[0] - from[0], to[1] - from[1])
}

/// Expected bend of a whisker for a box whose inner corner is `corner_m` in front of the robot's middle: first its tip
/// on the near face, then the corner's bearing, then its tip on the inner face once the corner is out of reach, then
/// the shell.
fn bent_at(corner_m: f64) -> f64 {
    let hinge_m = 0.5 * SHELL.length_m(NARROW_RAD) + WHISKERS.hinge_m[0];
    let aside_m = 0.12 - WHISKERS.hinge_m[1];
    let on_face_rad = PI - libm::asin(aside_m / WHISKERS.length_m);
    let ahead_m = corner_m - hinge_m;
    let on_front_rad = libm::acos((ahead_m / WHISKERS.length_m).min(1.0));
    let corner_rad = libm::atan2(aside_m, ahead_m);
    on_front_rad.max(corner_rad).min(on_face_rad).min(PI - NARROW_RAD) - WHISKERS.rest_rad
}

#[test]
fn a_whisker_leans_on_what_is_in_its_way() {
    let mut scene = gate(HEAVY, 0.24);
    let mut body = robot(WHISKERS);
    let mut seen = 0;
    for millimetre in 0..900 {
        let corner_m = 0.41 - 1e-3 * f64::from(millimetre);
        body.base.set_pose(Pose { x_m: 0.41 - corner_m, ..Pose::default() });
        // narrow enough that the shell touches nothing
        body.step(&mut scene, 0.0, &still(NARROW_RAD), &mut [0.0; 3], 1e-6);
        let [left, right] = body.bent_rad();
        assert!((left - right).abs() < 1e-12, "mirror images: {left} {right}");
        // behind the rear corner, within reach of the tip, the faces end
        if corner_m > 0.02 {
            assert!((left - bent_at(corner_m).max(0.0)).abs() < 1e-9, "{corner_m}: {left}, {}", bent_at(corner_m));
            seen += 1;
        } else if corner_m < -0.2 {
            assert_eq!(left, 0.0, "past the boxes, at {corner_m}");
        }
    }
    assert!(seen > 300);
}

#[test]
fn a_sample_is_shown_at_the_end_of_its_period_and_play_keeps_it_back() {
    let spec = Whiskers { hysteresis_rad: 0.1, ..WHISKERS };
    let mut body = robot(spec);
    let mut scene = Scene::default();
    scene.add_post([0.225, 0.12], 0.02).unwrap();
    let mut step = |body: &mut Deformable, time_s: f64| {
        body.step(&mut scene, time_s, &still(FRAC_PI_3), &mut [0.0; 3], 1e-6);
        (body.bent_rad()[0], body.reading(0))
    };
    let (bent_rad, shown_rad) = step(&mut body, 0.0);
    assert!(bent_rad > 0.1 && shown_rad == 0.0, "{bent_rad}");
    assert_eq!(step(&mut body, 0.1999).1, 0.0);
    // The reading lags the whisker by half the play; it stays when the whisker returns by less than the whole play.
    let shown_rad = step(&mut body, 0.2).1;
    assert!((shown_rad - (bent_rad - 0.05)).abs() < 1e-9, "{shown_rad}, {bent_rad}");
    assert_eq!(body.reading(1), 0.0, "nothing on the right");
}

/// Momentum balance without friction: the robot loses what the box gains.
#[test]
fn a_whisker_pushes_box_and_robot_apart() {
    let mut scene = Scene::default();
    let smooth = BoxSpec { friction: 0.0, ..LIGHT };
    scene.add_box(smooth, Pose { x_m: 0.32, y_m: 0.24, yaw_rad: 0.0 }).unwrap();
    let caster = |place_m| Wheel { place_m, radius_m: 0.05, shaft: None, inverted: false, steered: false, tyre: None };
    let wheels = vec![caster([0.1, 0.1]), caster([0.1, -0.1]), caster([-0.1, 0.0])];
    let chassis = Chassis { mass_kg: 2.5, inertia_kg_m2: 0.03, centre_m: [0.0; 2], height_m: 0.03 };
    let base = Wheeled::new(chassis, wheels, None, 3).unwrap();
    let mut body = Deformable::new(base, SHELL, WHISKERS).unwrap();
    for _ in 0..200 {
        body.step(&mut scene, 0.0, &still(NARROW_RAD), &mut [0.0; 3], MAX_STEP_S);
    }
    let speed = |twist: Twist, yaw_rad: f64| {
        let (sin, cos) = libm::sincos(yaw_rad);
        [cos * twist.forward_m_s - sin * twist.left_m_s, sin * twist.forward_m_s + cos * twist.left_m_s]
    };
    let robot_m_s = speed(body.twist(), body.pose().yaw_rad);
    let centre = scene.boxes()[0].pose();
    let box_m_s = scene.boxes()[0].velocity_at([centre.x_m, centre.y_m]);
    assert!(box_m_s[0] > 0.05, "{box_m_s:?}");
    for axis in [0, 1] {
        // Pose and twist are of first order in the step: the turn of 0.03 rad within it.
        let sum = 2.5 * robot_m_s[axis] + 0.2 * box_m_s[axis];
        assert!(sum.abs() < 1e-3 * 0.2 * box_m_s[0], "{robot_m_s:?} {box_m_s:?}");
    }
}

#[test]
fn heavy_boxes_stop_the_wide_shell_and_let_the_narrow_one_through() {
    let reached = |spec, shape_rad| {
        let (mut body, mut scene) = (robot(WHISKERS), gate(spec, 0.24));
        drive(&mut body, &mut scene, shape_rad, 5.0);
        (body.pose().x_m, scene)
    };
    // The panels' half width equals that of the gap 6.9 cm behind the nose, which is 20 cm in front of the boxes.
    let (wide_m, scene) = reached(HEAVY, FRAC_PI_3);
    assert!((wide_m - 0.269).abs() < 0.01, "{wide_m}");
    assert!((scene.boxes()[0].pose().x_m - 0.4925).abs() < 1e-4, "it stays: {:?}", scene.boxes()[0].pose());
    let (narrow_m, _) = reached(HEAVY, NARROW_RAD);
    assert!((narrow_m - 0.187 * 4.5).abs() < 0.03, "{narrow_m}");
    let (pushed_m, scene) = reached(LIGHT, FRAC_PI_3);
    assert!(pushed_m > 0.8, "{pushed_m}");
    let pose = scene.boxes()[0].pose();
    assert!(pose.y_m > 0.23 + 0.04, "pushed aside: {pose:?}");
}

/// Between boxes of 40 N each it opens until they press with its holding force; boxes of 10 N friction slide away.
#[test]
fn a_shell_opens_no_further_than_its_force_reaches() {
    let opened = |mass_kg: f64| {
        let spec = BoxSpec { mass_kg, ..HEAVY };
        let (mut body, mut scene) = (robot(WHISKERS), gate(spec, 0.24));
        body.step(&mut scene, 0.0, &still(NARROW_RAD), &mut [0.0; 3], MAX_STEP_S);
        body.set_pose(Pose { x_m: 0.4925, ..Pose::default() });
        for number in 0..8000 {
            body.step(&mut scene, f64::from(number) * MAX_STEP_S, &still(FRAC_PI_3), &mut [0.0; 3], MAX_STEP_S);
        }
        let squeezed_n = body.outline().map_or(0.0, Outline::squeezed_n);
        (SHELL.width_m(body.angle_rad()), squeezed_n)
    };
    let (width_m, squeezed_n) = opened(10.2);
    // The bumper yields by a tenth of a millimetre.
    assert!((width_m - 0.24).abs() < 5e-4, "{width_m}");
    assert!((squeezed_n / SHELL.holds_n - 1.0).abs() < 0.02, "{squeezed_n}");
    let (width_m, _) = opened(2.5);
    assert!(width_m > 0.36, "{width_m}");
}

#[test]
fn what_cannot_be_computed_is_named() {
    let base = || robot(WHISKERS).base;
    let shell = |change: fn(&mut Shell)| {
        let mut shell = SHELL;
        change(&mut shell);
        Deformable::new(base(), shell, WHISKERS).map(drop)
    };
    assert_eq!(shell(|_| ()), Ok(()));
    let wrong = Err(DeformableError::Shell { least_m: 0.06 });
    assert_eq!(shell(|shell| shell.per_rad = 0.0), wrong);
    assert_eq!(shell(|shell| shell.ends_rad = [0.58, FRAC_PI_6]), wrong);
    assert_eq!(shell(|shell| shell.panel_m = 0.05), wrong);
    assert_eq!(shell(|shell| shell.holds_n = 0.0), wrong);
    assert_eq!(shell(|shell| shell.shaft = 3), Err(DeformableError::Shaft { shaft: 3, shafts: 3 }));
    let whiskers = |change: fn(&mut Whiskers)| {
        let mut whiskers = WHISKERS;
        change(&mut whiskers);
        Deformable::new(base(), SHELL, whiskers).map(drop)
    };
    assert_eq!(whiskers(|_| ()), Ok(()));
    assert_eq!(whiskers(|whiskers| whiskers.length_m = 0.0), Err(DeformableError::Whiskers));
    assert_eq!(whiskers(|whiskers| whiskers.late_s = f64::NAN), Err(DeformableError::Whiskers));
    assert_eq!(whiskers(|whiskers| whiskers.late_s = 21.0), Err(DeformableError::Whiskers));
}
