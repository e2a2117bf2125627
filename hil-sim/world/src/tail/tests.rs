#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use serde::Deserialize;

use super::*;

const FREE: Cable = Cable {
    shaft: 0,
    ratio: 25.0,
    stiffness_nm_per_rad: 0.0,
    damping_nm_s_per_rad: 0.0,
    wraps: 0.0,
    loss_per_wrap: 0.0,
    friction_nm: 0.0,
};
const INNER: Link = Link { length_m: 0.70, mass_kg: 3.4, centre_m: 0.45, inertia_kg_m2: 0.15, cable: FREE };
const OUTER: Link =
    Link { length_m: 0.40, mass_kg: 3.1, centre_m: 0.31, inertia_kg_m2: 0.05, cable: Cable { shaft: 1, ..FREE } };
const LIMP: Ankle = Ankle { stiffness_nm_per_rad: 0.0, damping_nm_s_per_rad: 0.0, torque_max_nm: f64::INFINITY };
const SPRING: Ankle = Ankle { stiffness_nm_per_rad: 1200.0, ..LIMP };
const WEARER: Wearer =
    Wearer { mass_kg: 72.0, centre_m: 0.97, inertia_kg_m2: 80.0, tail_m: [-0.12, 1.15], ankle: SPRING };
const LOAD: Lift = Lift { at_s: 0.0, over_s: 0.0, mass_kg: 10.0, place_m: [0.35, 1.05] };

fn stiff(cable: Cable) -> Cable {
    Cable { stiffness_nm_per_rad: 3000.0, damping_nm_s_per_rad: 20.0, ..cable }
}

fn on_cables(rest_rad: [f64; 2], change: fn(&mut Cable)) -> BalanceTail {
    worn_on_cables(Ankle { damping_nm_s_per_rad: 300.0, ..SPRING }, rest_rad, change)
}

fn worn_on_cables(ankle: Ankle, rest_rad: [f64; 2], change: fn(&mut Cable)) -> BalanceTail {
    let links = [INNER, OUTER].map(|mut link| {
        link.cable = stiff(link.cable);
        change(&mut link.cable);
        link
    });
    BalanceTail::new(Wearer { ankle, ..WEARER }, links, rest_rad, None).unwrap()
}

/// The same model as in `tests/oracle/tail.py`.
fn oracle_tail(load_kg: f64) -> BalanceTail {
    let mut body = BalanceTail::new(WEARER, [INNER, OUTER], [0.0; 2], Some(LOAD)).unwrap();
    body.wearer.ankle = LIMP;
    body.carried_kg = load_kg;
    body
}

fn run(body: &mut BalanceTail, shafts: [ShaftMotion; 2], for_s: f64, step_s: f64) -> [f64; 2] {
    let mut loads = [0.0; 2];
    for step in 0..(for_s / step_s).round() as u32 {
        body.step(&mut Scene::default(), f64::from(step) * step_s, &shafts, &mut loads, step_s);
    }
    loads
}

const HELD: [ShaftMotion; 2] = [ShaftMotion { position: 0.0, speed: 0.0 }; 2];

/// Kinetic energy plus that of gravity, the ankle's spring and the cables, J.
fn energy_j(body: &BalanceTail, shafts: [ShaftMotion; 2]) -> f64 {
    let Motion { mass, potential_j, .. } = body.motion(&body.state);
    let [trunk, first, second] = body.state.rate_rad_s;
    let rates = [trunk, trunk + first, trunk + first + second];
    let kinetic: f64 = (0..3).map(|i| (0..3).map(|j| 0.5 * rates[i] * mass[i][j] * rates[j]).sum::<f64>()).sum();
    let bent = body.posture_rad - body.state.angle_rad[0];
    let cables: f64 = (0..2)
        .map(|number| {
            let Cable { stiffness_nm_per_rad, .. } = body.links[number].cable;
            let still = TailState { rate_rad_s: [0.0; 3], ..body.state };
            let torque_nm = body.cable(number, &still, ShaftMotion { speed: 0.0, ..shafts[number] });
            if stiffness_nm_per_rad > 0.0 { 0.5 * torque_nm * torque_nm / stiffness_nm_per_rad } else { 0.0 }
        })
        .sum();
    kinetic + potential_j + 0.5 * body.wearer.ankle.stiffness_nm_per_rad * bent * bent + cables
}

/// Without losses energy changes only by the integrator's error: of fourth order, so at half the step it is a sixteenth
/// or less.
#[test]
fn energy_stays_to_the_order_of_the_integrator() {
    let drift_j = |step_s: f64| {
        let mut body = BalanceTail::new(WEARER, [INNER, OUTER], [0.0; 2], None).unwrap();
        for link in &mut body.links {
            link.cable.stiffness_nm_per_rad = 300.0;
        }
        body.state.angle_rad = [0.1, 1.2, -0.8];
        let before_j = energy_j(&body, HELD);
        run(&mut body, HELD, 2.0, step_s);
        assert!((body.state.angle_rad[1] - 1.2).abs() > 1e-3, "it moves");
        (energy_j(&body, HELD) - before_j).abs()
    };
    let [whole_j, half_j] = [4e-3, 2e-3].map(drift_j);
    assert!(whole_j > 1e-9, "the error is not rounding: {whole_j}");
    // 16 by the order; the energy's own error is of fifth order per step in an oscillation: up to 32
    assert!((12.0..40.0).contains(&(whole_j / half_j)), "{whole_j} J, {half_j} J");
    // at the longest step of boards, an eighth of that: 32^3 times less
    assert!(drift_j(MAX_STEP_S) < 1e-6 && half_j < 0.04, "{half_j} J, {} J", drift_j(MAX_STEP_S));
}

/// Measures the mean period of whole swings from zero crossings of an angle, s.
fn period_s(body: &mut BalanceTail, angle: usize, for_s: f64) -> f64 {
    let (mut crossings, mut before) = (Vec::new(), body.state.angle_rad[angle]);
    for step in 0..(for_s / MAX_STEP_S).round() as u32 {
        run(body, HELD, MAX_STEP_S, MAX_STEP_S);
        let now = body.state.angle_rad[angle];
        if before < 0.0 && now >= 0.0 {
            crossings.push((f64::from(step) - now / (now - before)) * MAX_STEP_S);
        }
        before = now;
    }
    (crossings[crossings.len() - 1] - crossings[0]) / (crossings.len() - 1) as f64
}

#[test]
fn small_swings_have_the_linear_frequency() {
    let feather = Link { mass_kg: 1e-9, inertia_kg_m2: 1e-9, ..INNER };
    // a person alone: I w^2 = k - m g h
    let mut body = BalanceTail::new(WEARER, [feather, Link { cable: OUTER.cable, ..feather }], [0.0; 2], None).unwrap();
    body.state.angle_rad[0] = 1e-4;
    let expected_s = std::f64::consts::TAU / ((1200.0 - 72.0 * GRAVITY_M_S2 * 0.97) / 80.0_f64).sqrt();
    let got_s = period_s(&mut body, 0, 20.0);
    // interpolated crossings: (w h)^2 of a step; the amplitude contributes 1e-9
    assert!((got_s / expected_s - 1.0).abs() < 1e-6, "{got_s} s, {expected_s} s");
    // the inner link as a pendulum on a person who cannot move: I w^2 = m g c
    let wearer = Wearer { mass_kg: 1e9, inertia_kg_m2: 1e9, ..WEARER };
    let ankle = Ankle { stiffness_nm_per_rad: 1e12, ..LIMP };
    let links = [INNER, Link { cable: OUTER.cable, ..feather }];
    let mut body = BalanceTail::new(Wearer { ankle, ..wearer }, links, [0.0; 2], None).unwrap();
    body.state.angle_rad[1] = 1e-4;
    let inertia_kg_m2 = 0.15 + 3.4 * 0.45 * 0.45;
    let expected_s = std::f64::consts::TAU / (3.4 * GRAVITY_M_S2 * 0.45 / inertia_kg_m2).sqrt();
    let got_s = period_s(&mut body, 1, 20.0);
    assert!((got_s / expected_s - 1.0).abs() < 1e-6, "{got_s} s, {expected_s} s");
}

/// Moments of both links' weights, divided by the ratio: `m g l cos q` for the angle from the horizontal.
#[test]
fn shafts_hold_the_weight_of_the_links() {
    for [first, second] in [[0.3, 0.2], [std::f64::consts::FRAC_PI_2, 0.0], [1.0, -1.5], [-0.4, 0.9]] {
        let mut body = on_cables([first, second], |cable| {
            if cable.shaft == 1 {
                cable.ratio = -20.0;
            }
        });
        let loads = run(&mut body, HELD, 2.0, MAX_STEP_S);
        // raised from hanging, so sines; the person keeps the ankle's lean
        let (first_sin, both_sin) = (first.sin(), (first + second).sin());
        let outer_nm = 3.1 * GRAVITY_M_S2 * 0.31 * both_sin;
        let inner_nm = GRAVITY_M_S2 * (3.4 * 0.45 + 3.1 * 0.70) * first_sin + outer_nm;
        let expected = [-inner_nm / 25.0, outer_nm / 20.0];
        assert!(body.state.angle_rad[0].abs() < 1e-12 && (body.state.angle_rad[1] - first).abs() < 1e-12);
        let apart = loads.iter().zip(expected).map(|(load, expected)| (load - expected).abs()).fold(0.0, f64::max);
        assert!(apart < 1e-9, "{loads:?}, {expected:?}");
        // the ankle holds the sum of moments about itself: the tail hangs behind
        let behind_m = |at_m: f64| 0.12 + at_m;
        let about_nm = 3.4 * GRAVITY_M_S2 * behind_m(0.45 * first_sin)
            + 3.1 * GRAVITY_M_S2 * behind_m(0.70 * first_sin + 0.31 * both_sin);
        assert!((body.ankle_nm() - about_nm).abs() < 1e-9, "{} {about_nm}", body.ankle_nm());
    }
}

/// About the ankle, angular momentum grows by the moments of gravity and of the ankle alone, for any internal torque of
/// the cables.
#[test]
fn angular_momentum_grows_by_what_acts_from_outside() {
    let momentum = |body: &BalanceTail| {
        let mass = body.motion(&body.state).mass;
        let [trunk, first, second] = body.state.rate_rad_s;
        let rates = [trunk, trunk + first, trunk + first + second];
        (0..3).map(|i| (0..3).map(|j| mass[i][j] * rates[j]).sum::<f64>()).sum::<f64>()
    };
    let mut body =
        on_cables([0.5, 0.3], |cable| (cable.wraps, cable.loss_per_wrap, cable.friction_nm) = (4.0, 0.1, 1.0));
    body.set_lift(Some(LOAD));
    let (mut grown, mut loads, mut moment_before) = (0.0, [0.0; 2], None);
    let (mut shafts, before) = (HELD, momentum(&body));
    for step in 0..8000 {
        // both motors oscillate
        let at_s = f64::from(step + 1) * MAX_STEP_S;
        for (number, shaft) in shafts.iter_mut().enumerate() {
            let rate = 3.0 + number as f64;
            *shaft = ShaftMotion { position: 8.0 * (rate * at_s).sin(), speed: 8.0 * rate * (rate * at_s).cos() };
        }
        body.step(&mut Scene::default(), at_s, &shafts, &mut loads, MAX_STEP_S);
        let still = TailState { rate_rad_s: [0.0; 3], ..body.state };
        let moment = body.motion(&still).force.iter().sum::<f64>() + body.ankle_nm();
        grown += MAX_STEP_S * 0.5 * (moment + moment_before.unwrap_or(moment));
        moment_before = Some(moment);
    }
    let expected = momentum(&body) - before;
    assert!(expected.abs() > 0.1, "it moves: {expected}");
    // trapezoidal rule: the first step's moment is that of its end, 34 N m x 0.25 ms of the load
    assert!((grown - expected).abs() < 0.01, "{grown} N m s, {expected} N m s");
}

/// A lifting motor gives the joint the share that pulleys transmit, and one that lowers carries as much less.
#[test]
fn pulleys_take_their_share_in_the_direction_of_motion() {
    // a trunk that does not move
    let ankle = Ankle { stiffness_nm_per_rad: 1e6, damping_nm_s_per_rad: 1e4, ..SPRING };
    let mut body = worn_on_cables(ankle, [1.0, 0.0], |cable| (cable.wraps, cable.loss_per_wrap) = (6.0, 0.1));
    let left = 0.9_f64.powi(6);
    for (rate_rad_s, share) in [(0.2, left), (-0.2, 1.0 / left)] {
        assert!((body.after_losses(0, 40.0, rate_rad_s) - 40.0 * share).abs() < 1e-6);
        assert!((body.after_losses(0, -40.0, -rate_rad_s) + 40.0 * share).abs() < 1e-6);
    }
    // slowly up and down by the motor, whose load is the cable's
    let weight_nm = |body: &BalanceTail| {
        let still = TailState { rate_rad_s: [0.0; 3], ..body.state };
        let [_, first_nm, second_nm] = body.motion(&still).force;
        -(first_nm + second_nm)
    };
    for speed in [2.5, -2.5] {
        let mut shafts = HELD;
        let mut loads = [0.0; 2];
        for step in 0..20_000 {
            shafts[0] = ShaftMotion { position: speed * f64::from(step) * MAX_STEP_S, speed };
            body.step(&mut Scene::default(), 0.0, &shafts, &mut loads, MAX_STEP_S);
        }
        let share = if speed > 0.0 { 1.0 / left } else { left };
        let expected_nm = -weight_nm(&body) * share / 25.0;
        // at 0.1 rad/s, after the start has decayed; the weight changes by 0.1 rad/s times its lag
        assert!((loads[0] / expected_nm - 1.0).abs() < 1e-3, "{} N m, {expected_nm} N m", loads[0]);
        body.set_pose(Pose::default());
    }
}

/// A stretched cable leaves the joint behind its motor by torque over stiffness.
#[test]
fn a_cable_stretches_under_its_torque() {
    let mut body = on_cables([0.0; 2], |_| {});
    let raised = [ShaftMotion { position: 25.0, speed: 0.0 }, ShaftMotion::default()];
    run(&mut body, raised, 20.0, MAX_STEP_S);
    let stretch_rad = 1.0 - body.state.angle_rad[1];
    assert!((stretch_rad * 3000.0 - body.cables_nm()[0]).abs() < 1e-6 && stretch_rad > 5e-3, "{stretch_rad}");
}

#[test]
fn a_load_is_taken_up_over_its_time_and_leans_the_person_forwards() {
    let mut body = on_cables([0.0; 2], |_| {});
    body.set_lift(Some(Lift { at_s: 1.0, over_s: 0.5, ..LOAD }));
    let mut loads = [0.0; 2];
    for step in 0..60_000 {
        let at_s = f64::from(step) * MAX_STEP_S;
        body.step(&mut Scene::default(), at_s, &HELD, &mut loads, MAX_STEP_S);
        let expected_kg = (10.0 * (at_s - 1.0) / 0.5).clamp(0.0, 10.0);
        assert!((body.carried_kg - expected_kg).abs() < 1e-9);
        assert!(at_s > 1.0 || body.wearer_x_m().abs() < 1e-12, "nothing moves before");
    }
    // at rest the ankle holds the lean, the load and the tail behind
    let lean = body.state.angle_rad[0];
    let still = body.motion(&body.state).force.iter().sum::<f64>();
    assert!((body.ankle_nm() + still).abs() < 1e-3 && lean > 0.02, "{lean} rad");
    assert!((body.wearer_x_m() - 0.97 * lean.sin()).abs() < 1e-12);
}

#[test]
fn an_ankle_gives_no_more_than_its_limit_and_a_trunk_that_falls_stays_down() {
    let mut body = on_cables([0.0; 2], |_| {});
    body.wearer.ankle.torque_max_nm = 30.0;
    body.set_lift(Some(LOAD));
    let mut loads = [0.0; 2];
    for step in 0..20_000 {
        body.step(&mut Scene::default(), f64::from(step) * MAX_STEP_S, &HELD, &mut loads, MAX_STEP_S);
        assert!(body.ankle_nm().abs() <= 30.0);
    }
    assert_eq!((body.state.angle_rad[0], body.state.rate_rad_s[0]), (LIES_RAD, 0.0));
}

#[test]
fn a_sensor_on_the_trunk_feels_its_lean() {
    let mut body = on_cables([0.0; 2], |_| {});
    assert_eq!(body.inertial().specific_force_m_s2, [0.0, 0.0, GRAVITY_M_S2]);
    (body.state.angle_rad[0], body.state.rate_rad_s[0]) = (0.1, 0.5);
    body.acceleration_rad_s2[0] = 2.0;
    let at = body.inertial().at([0.0, 0.0, 1.2]);
    let expected = [-GRAVITY_M_S2 * 0.1_f64.sin() + 2.0 * 1.2, 0.0, GRAVITY_M_S2 * 0.1_f64.cos() - 0.25 * 1.2];
    assert!(
        at.specific_force_m_s2.iter().zip(expected).all(|(got, expected)| (got - expected).abs() < 1e-12),
        "{at:?}"
    );
    assert_eq!(at.rate_rad_s, [0.0, 0.5, 0.0]);
}

#[test]
fn what_cannot_be_computed_is_named() {
    let new = |wearer, links| BalanceTail::new(wearer, links, [0.0; 2], None).map(drop);
    let links = [INNER, OUTER];
    assert_eq!(new(WEARER, links), Ok(()));
    assert_eq!(new(Wearer { inertia_kg_m2: 60.0, ..WEARER }, links), Err(TailError::Wearer));
    let weak = Ankle { torque_max_nm: 7.0, ..SPRING };
    let needed_nm = 6.5 * GRAVITY_M_S2 * 0.12;
    let Err(TailError::Ankle { needed_nm: got_nm }) = new(Wearer { ankle: weak, ..WEARER }, links) else {
        panic!("7 N m do not hold a tail of {needed_nm} N m")
    };
    assert!((got_nm - needed_nm).abs() < 1e-9);
    assert!(matches!(new(Wearer { ankle: LIMP, ..WEARER }, links), Err(TailError::Ankle { .. })));
    let link = |change: fn(&mut Link)| {
        let mut links = links;
        change(&mut links[1]);
        new(WEARER, links)
    };
    assert_eq!(link(|link| link.mass_kg = 0.0), Err(TailError::Link { link: 1 }));
    assert_eq!(link(|link| link.cable.ratio = 0.0), Err(TailError::Cable { link: 1 }));
    assert_eq!(link(|link| link.cable.loss_per_wrap = 1.0), Err(TailError::Cable { link: 1 }));
    assert_eq!(link(|link| link.cable.shaft = 2), Err(TailError::Cable { link: 1 }));
    assert!(matches!(link(|link| link.cable.stiffness_nm_per_rad = 1e7), Err(TailError::Stiff { link: 1, .. })));
    assert!(matches!(link(|link| link.cable.damping_nm_s_per_rad = 1e5), Err(TailError::Stiff { link: 1, .. })));
    let lift = Some(Lift { mass_kg: f64::NAN, ..LOAD });
    assert_eq!(BalanceTail::new(WEARER, links, [0.0; 2], lift).map(drop), Err(TailError::Lift));
}

#[derive(Deserialize)]
struct Oracle {
    rows: Vec<Row>,
    path: Vec<Place>,
}

#[derive(Deserialize)]
struct Row {
    load_kg: f64,
    q: [f64; 3],
    v: [f64; 3],
    tau: [f64; 3],
    pinocchio: [f64; 3],
    mujoco: [f64; 3],
}

#[derive(Deserialize)]
struct Place {
    t: f64,
    q: [f64; 3],
    v: [f64; 3],
}

fn oracle() -> Oracle {
    serde_json::from_str(include_str!("../../tests/oracle/tail.json")).unwrap()
}

/// Accelerations of Pinocchio 4.1.0 (articulated body algorithm) and MuJoCo 3.17.0 at 40 random states and torques,
/// half of them with a load.
#[test]
fn accelerations_are_those_of_pinocchio_and_mujoco() {
    let rows = oracle().rows;
    assert_eq!(rows.len(), 40);
    for Row { load_kg, q, v, tau, pinocchio, mujoco } in rows {
        let got = oracle_tail(load_kg).accelerations(&TailState { angle_rad: q, rate_rad_s: v }, tau);
        let largest = pinocchio.iter().fold(0.0, |largest: f64, value| largest.max(value.abs()));
        for (axis, expected) in [pinocchio, mujoco].into_iter().flat_map(|row| row.into_iter().enumerate()) {
            // rounding of a mass matrix of condition 2000; the two oracles differ by 3e-15
            assert!((got[axis] - expected).abs() < 1e-11 * largest, "{got:?}, {expected} of axis {axis}");
        }
    }
}

/// One second of free swinging by MuJoCo's Runge-Kutta of the same order and step.
#[test]
fn a_free_swing_follows_mujocos() {
    let mut body = oracle_tail(0.0);
    body.lift = None;
    body.state.angle_rad = [0.02, 1.2, -0.6];
    let mut before_s = 0.0;
    for Place { t, q, v } in oracle().path {
        run(&mut body, HELD, t - before_s, MAX_STEP_S);
        before_s = t;
        for axis in 0..3 {
            // same method and step: rounding, which a falling chain amplifies by less than 1e3 in a second
            assert!((body.state.angle_rad[axis] - q[axis]).abs() < 1e-9, "{t} s: {:?}, {q:?}", body.state.angle_rad);
            assert!((body.state.rate_rad_s[axis] - v[axis]).abs() < 1e-8, "{t} s: {:?}, {v:?}", body.state.rate_rad_s);
        }
    }
}
