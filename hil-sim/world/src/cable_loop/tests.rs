use super::*;

const STEP_S: f64 = 2.5e-4;

fn gripper() -> CableLoop {
    let finger = Finger {
        spool_radius_m: 0.010,
        legs_m: 0.012,
        bend_radius_m: 0.005,
        thickness_m: 0.0008,
        strand_n: 96.0,
        half_angle_rad: 0.35,
        tip_n_per_m: 3000.0,
        start_m: PI * 0.022 + 0.012,
    };
    let bowden = Bowden { stiffness_n_per_m: 8000.0, friction_angle: 0.5 };
    let creep = Creep { share: 0.2, time_s: 1.0 };
    let sensor = TipSensor { zero_n: 0.0, drift_n_per_s: 0.0, slip_share: 0.08 };
    let axes = Axes { raised_m: 0.085, lift_m_per_rad: 0.005, ahead_m_per_rad: 0.005, aside_m_per_rad: 0.005 };
    let vial = Vial {
        diameter_m: 0.020,
        mass_kg: 0.1,
        height_m: 0.045,
        place_m: [0.011, 0.0],
        friction: 0.5,
        kinetic_share: 0.85,
        crush_n: 15.0,
        clearance_m: 0.003,
    };
    CableLoop::new((finger, bowden, creep, sensor), axes, vial, None).expect("a gripper")
}

/// Moves lift and spool to positions at constant speed within `over_s`, and returns the load of the spool.
fn drive(body: &mut CableLoop, from: [f64; 2], to: [f64; 2], over_s: f64) -> f64 {
    let steps = (over_s / STEP_S).round() as usize;
    let mut loads = [0.0; 4];
    for step in 1..=steps {
        let share = step as f64 / steps as f64;
        let at = |axis: usize| ShaftMotion { position: from[axis] + share * (to[axis] - from[axis]), speed: 0.0 };
        let time_s = body.state.time_s + STEP_S;
        body.step(
            &mut Scene::default(),
            time_s,
            &[at(1), at(0), ShaftMotion::default(), ShaftMotion::default()],
            &mut loads,
            STEP_S,
        );
    }
    loads[0]
}

/// Lift position at which the loop is 25 mm above the table.
const DOWN_RAD: f64 = 12.0;

/// A gripper whose loop is lowered over the vial.
fn lowered(mut body: CableLoop) -> CableLoop {
    drive(&mut body, [0.0, 0.0], [DOWN_RAD, 0.0], 0.6);
    drive(&mut body, [DOWN_RAD, 0.0], [DOWN_RAD, 0.0], 0.2);
    assert_eq!(body.hold(), Hold::Inside);
    body
}

fn with(change: impl FnOnce(&mut CableLoop)) -> CableLoop {
    let mut body = gripper();
    change(&mut body);
    body.set_pose(Pose::default());
    body
}

/// Tight length `S = π D + s0`: with a loop paid out for 22 mm, 2 π mm are slack round 20 mm; each rad of the spool
/// takes up 20 mm.
#[test]
fn the_loop_is_tight_at_the_circumference_and_its_legs() {
    let mut body = lowered(with(|body| body.creep.share = 0.0));
    let contact_rad = -PI * 0.002 / 0.020;
    drive(&mut body, [DOWN_RAD, 0.0], [DOWN_RAD, contact_rad + 1e-4], 0.3);
    assert_eq!(body.squeeze_n(), 0.0);
    drive(&mut body, [DOWN_RAD, contact_rad + 1e-4], [DOWN_RAD, contact_rad - 1e-4], 0.1);
    assert!(body.squeeze_n() > 0.0 && body.squeeze_n() < 1e-2, "{}", body.squeeze_n());
}

/// Capstan law: reeling in, the tip has `exp(-μθ)` of the spool's tension; paying out, `exp(μθ)`; within the play it
/// does not change. The spool carries both strands.
#[test]
fn the_bowden_tube_holds_the_tension_by_the_capstan_law() {
    let mut body = lowered(with(|body| body.creep.share = 0.0));
    let tight_rad = -0.7;
    let load_nm = drive(&mut body, [DOWN_RAD, 0.0], [DOWN_RAD, tight_rad], 0.5);
    let [in_n, out_n] = body.tensions_n();
    assert!((out_n / in_n - (-0.5f64).exp()).abs() < 1e-12, "{in_n} {out_n}");
    assert!((load_nm - 2.0 * in_n * 0.010).abs() < 1e-12);
    // Springs in series; the tube as seen from the tip.
    let outer_m_per_n = 0.5 * (PI * 0.020 + 0.012) / 96.0 + 2.0 * 0.35f64.cos().powi(2) / 3000.0;
    let pulled_m = 0.7 * 0.010 - PI * 0.001;
    let expected_n = pulled_m / (outer_m_per_n + 0.5f64.exp() / 8000.0);
    assert!((out_n / expected_n - 1.0).abs() < 1e-9, "{out_n} {expected_n}");
    let squeeze_n = body.squeeze_n();
    assert!((squeeze_n - 2.0 * out_n * 0.35f64.cos()).abs() < 1e-12);
    // Paid out by less than the play: the strand in the tube relaxes, the force on the vial stays.
    drive(&mut body, [DOWN_RAD, tight_rad], [DOWN_RAD, tight_rad + 0.02], 0.1);
    assert_eq!(body.squeeze_n(), squeeze_n);
    assert!(body.tensions_n()[0] < in_n);
    drive(&mut body, [DOWN_RAD, tight_rad + 0.02], [DOWN_RAD, tight_rad + 0.2], 0.1);
    let [in_n, out_n] = body.tensions_n();
    assert!((out_n / in_n - 0.5f64.exp()).abs() < 1e-12, "{in_n} {out_n}");
}

/// Energy balance of a cycle: the work of the spool is stored in the springs or lost in the tube, so the loss is the
/// area enclosed by the play, never below 0.
#[test]
fn a_cycle_of_the_spool_loses_energy_in_the_tube_only() {
    for (friction_angle, least_j) in [(0.0, -1e-6), (0.6, 1e-3)] {
        let mut body = lowered(with(|body| {
            body.creep.share = 0.0;
            body.bowden.friction_angle = friction_angle;
        }));
        let mut work_j = 0.0;
        let (mut position, mut load_nm) = (0.0, 0.0);
        for step in 1..=4000 {
            let next = -0.7 * (PI * f64::from(step) / 4000.0).sin();
            let next_nm = drive(&mut body, [DOWN_RAD, position], [DOWN_RAD, next], STEP_S);
            work_j -= f64::midpoint(load_nm, next_nm) * (next - position);
            (position, load_nm) = (next, next_nm);
        }
        // The trapezoidal rule is exact for springs except for the steps at the knees.
        assert!(work_j >= least_j, "{friction_angle}: {work_j}");
        assert!((friction_angle == 0.0) == (work_j.abs() < 1e-6), "{friction_angle}: {work_j}");
    }
}

/// At a fixed length of the strand outside, the force relaxes from 1 to `1 - share`. The spool is let back into the
/// middle of the play for this: at its limit the tube's spring would draw the strand in while the force falls.
#[test]
fn creep_takes_its_share_of_the_force_at_a_fixed_length() {
    let closed = || {
        let mut body = lowered(with(|body| body.bowden.friction_angle = 2.0));
        drive(&mut body, [DOWN_RAD, 0.0], [DOWN_RAD, -0.7], STEP_S);
        let [in_n, out_n] = body.tensions_n();
        let middle_rad = -0.7 + (in_n - out_n) / 8000.0 / 0.010;
        let first_n = body.squeeze_n();
        drive(&mut body, [DOWN_RAD, -0.7], [DOWN_RAD, middle_rad], STEP_S);
        (body, middle_rad, first_n)
    };
    // Relaxation at fixed length is faster than creep at fixed force by 1 - share: 63 % after 0.8 s.
    for (after_s, expected) in [(0.8, 1.0 - (-1.0f64).exp()), (20.0, 1.0)] {
        let (mut body, middle_rad, first_n) = closed();
        drive(&mut body, [DOWN_RAD, middle_rad], [DOWN_RAD, middle_rad], after_s);
        let gone = (1.0 - body.squeeze_n() / first_n) / 0.2;
        // Error of explicit steps of 0.25 ms with 0.8 s.
        assert!((gone - expected).abs() < 1e-3, "{after_s}: {gone}");
    }
    let mut body = lowered(with(|body| body.bowden.friction_angle = 2.0));
    drive(&mut body, [DOWN_RAD, 0.0], [DOWN_RAD, -0.7], STEP_S);
    let first_n = body.squeeze_n();
    drive(&mut body, [DOWN_RAD, -0.7], [DOWN_RAD, -0.7], 20.0);
    assert!(body.squeeze_n() / first_n > 0.85, "{}", body.squeeze_n() / first_n);
}

/// Condition `2 μ N >= m g`: just above, the vial is lifted; just below, it stays.
#[test]
fn the_vial_is_lifted_while_friction_carries_its_weight() {
    for (factor, holds) in [(1.1, true), (0.9, false)] {
        let mut body = lowered(with(|body| body.creep.share = 0.0));
        drive(&mut body, [DOWN_RAD, 0.0], [DOWN_RAD, -0.7], 0.5);
        body.vial.mass_kg = 2.0 * 0.5 * body.squeeze_n() / GRAVITY_M_S2 / factor;
        drive(&mut body, [DOWN_RAD, -0.7], [4.0, -0.7], 4.0);
        if holds {
            // The finger lags its axis by 2 × 8 ms at 10 mm/s: 0.16 mm.
            assert!((body.height_m() - 0.040).abs() < 2e-4 && body.slip_m()[1] < 1e-4, "{}", body.height_m());
        } else {
            assert_eq!(body.hold(), Hold::Dropped, "it slid out");
        }
    }
}

/// A knock of 8 m/s² on a vial held with 1.6 times its weight lets it slide with `g + 8 - 0.85 · 1.6 g` until the
/// knock ends, then decelerate with `0.85 · 1.6 g - g`. The tolerance is that of steps of the simulation.
#[test]
fn a_knock_lets_the_vial_slide_as_mechanics_says() {
    let mut body = lowered(with(|body| {
        body.creep.share = 0.0;
        body.jerk = Some(Jerk { after_s: 4.0, lasts_s: 0.05, acceleration_m_s2: 8.0 });
    }));
    drive(&mut body, [DOWN_RAD, 0.0], [DOWN_RAD, -0.7], 0.5);
    body.vial.mass_kg = 2.0 * 0.5 * body.squeeze_n() / GRAVITY_M_S2 / 1.6;
    drive(&mut body, [DOWN_RAD, -0.7], [4.0, -0.7], 4.0);
    drive(&mut body, [4.0, -0.7], [4.0, -0.7], 4.0);
    let [up, down] = [GRAVITY_M_S2 + 8.0, GRAVITY_M_S2].map(|pull| pull - 0.85 * 1.6 * GRAVITY_M_S2);
    let speed_m_s = up * 0.05;
    let expected_m = 0.5 * up * 0.05 * 0.05 + speed_m_s * speed_m_s / (2.0 * -down);
    let slid_m = body.slip_m()[0];
    // 12.7 mm: short of the vial's top, 20 mm above the loop.
    assert!((slid_m - expected_m).abs() < 0.02 * expected_m, "{slid_m} {expected_m}");
    assert_ne!(body.hold(), Hold::Dropped);
}

/// Clearance of 1.1 mm to each side fits a loop that is 2 mm wider and 0.8 mm thick between a vial and neighbours at 3
/// mm.
#[test]
fn the_loop_goes_over_the_vial_within_its_clearance_only() {
    for (aside_m, ahead_m, fits) in
        [(0.0, 0.0, true), (0.0009, 0.0, true), (0.0, -0.0009, true), (0.0012, 0.0, false), (0.0, 0.0012, false)]
    {
        let mut body = with(|body| body.vial.place_m = [0.011 + ahead_m, aside_m]);
        drive(&mut body, [0.0, 0.0], [DOWN_RAD, 0.0], 0.6);
        assert_eq!(body.hold() == Hold::Inside, fits, "{aside_m} {ahead_m}");
    }
    // A loop that is too wide for the neighbours does not go down either.
    let mut wide = with(|body| body.finger.start_m = PI * 0.0256 + 0.012);
    drive(&mut wide, [0.0, 0.0], [DOWN_RAD, 0.0], 0.6);
    assert_eq!(wide.hold(), Hold::Outside);
}

#[test]
fn a_loop_that_lets_go_in_the_air_drops_the_vial_and_on_the_table_leaves_it() {
    let mut body = lowered(gripper());
    drive(&mut body, [DOWN_RAD, 0.0], [DOWN_RAD, -0.7], 0.5);
    drive(&mut body, [DOWN_RAD, -0.7], [4.0, -0.7], 1.0);
    let mut back = body.clone();
    drive(&mut body, [4.0, -0.7], [4.0, 0.0], 0.5);
    assert_eq!(body.hold(), Hold::Dropped);
    drive(&mut back, [4.0, -0.7], [DOWN_RAD, -0.7], 1.0);
    drive(&mut back, [DOWN_RAD, -0.7], [DOWN_RAD, 0.0], 0.5);
    drive(&mut back, [DOWN_RAD, 0.0], [0.0, 0.0], 1.0);
    assert_eq!((back.hold(), back.height_m(), back.is_crushed()), (Hold::Outside, 0.0, false));
}

#[test]
fn numbers_that_make_no_sense_are_refused() {
    let CableLoop { finger, bowden, creep, sensor, axes, vial, .. } = gripper();
    let new = CableLoop::new;
    let bad = Finger { strand_n: 0.0, ..finger };
    assert_eq!(new((bad, bowden, creep, sensor), axes, vial, None), Err(CableLoopError::Finger));
    let bad = Bowden { friction_angle: f64::NAN, ..bowden };
    assert_eq!(new((finger, bad, creep, sensor), axes, vial, None), Err(CableLoopError::Bowden));
    let bad = Creep { share: 1.0, ..creep };
    assert_eq!(new((finger, bowden, bad, sensor), axes, vial, None), Err(CableLoopError::Creep));
    let bad = Axes { lift_m_per_rad: 0.0, ..axes };
    assert_eq!(new((finger, bowden, creep, sensor), bad, vial, None), Err(CableLoopError::Axes));
    let bad = Vial { kinetic_share: 1.1, ..vial };
    assert_eq!(new((finger, bowden, creep, sensor), axes, bad, None), Err(CableLoopError::Vial));
}
