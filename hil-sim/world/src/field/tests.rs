use std::f64::consts::TAU;

use super::{
    Charge, Cloud, Electric, ElectricSpec, Field, FieldError, FieldKind, Flow, FlowError, FlowSpec, Lag, Plume,
    PlumeSpec, Wander, plume::REACH,
};
use crate::{body::Pose, scene::Scene};

const STILL: Wander = Wander { deviation: 0.0, tau_s: 0.0 };

/// An empty hall, 20 m along the wind and 12 m across.
fn hall() -> FlowSpec {
    FlowSpec {
        corners_m: [[0.0, 0.0], [20.0, 12.0]],
        cell_m: 0.5,
        inlets_m: vec![[[0.0, 0.0], [0.0, 12.0]]],
        outlets_m: vec![[[20.0, 0.0], [20.0, 12.0]]],
        speed_m_s: 0.5,
    }
}

fn spec() -> PlumeSpec {
    PlumeSpec {
        source_m: [2.25, 6.0],
        release_m3_s: 1e-5,
        filaments_per_s: 5.0,
        layer_m: 2.0,
        radius_m: 0.05,
        growth_m2_s: 1e-4,
        spread_m2_s: 0.02,
        meander: STILL,
        lifetime_s: 300.0,
        running_s: 0.0,
        seed: 1,
    }
}

fn gas(plume: Plume) -> Field {
    Field { name: "gas".into(), kind: FieldKind::Gas(Box::new(plume)) }
}

/// Two halves with a door in the wall between them: the inlet's flow passes the door.
#[test]
fn air_goes_through_the_door() {
    let mut scene = Scene::default();
    scene.add_walls(&[[10.2, 0.0], [10.2, 5.0]], false).unwrap();
    scene.add_walls(&[[10.2, 7.0], [10.2, 12.0]], false).unwrap();
    let flow = Flow::new(&hall(), &scene).unwrap();
    let through = |x_m: f64| (0..24).map(|cell| flow.velocity_m_s([x_m, 0.25 + 0.5 * f64::from(cell)])[0]).sum::<f64>();
    // Sum over 24 cells of 0.5 m/s. The solution's residual is 1e-10 of the inlet's.
    for x_m in [0.0, 3.0, 10.0, 10.5, 19.99] {
        assert!((through(x_m) / 12.0 - 1.0).abs() < 1e-7, "{x_m}: {}", through(x_m));
    }
    assert_eq!(flow.velocity_m_s([10.0, 3.25])[0], 0.0, "the wall is at the face at 10 m");
    // The mean in the door is 3 m/s, higher at its sharp edges than in its middle.
    assert!((2.0..3.0).contains(&flow.velocity_m_s([10.0, 6.25])[0]));
    assert!(flow.sees([8.0, 6.0], [12.0, 6.0]) && !flow.sees([8.0, 3.0], [12.0, 3.0]));
    let step = |from: [f64; 2], way: [f64; 2]| flow.moved(from, way);
    assert_eq!(step([9.9, 3.0], [0.4, 0.1]), Some([9.9, 3.1]), "it slides along the wall");
    assert_eq!(step([19.9, 3.0], [0.4, 0.1]), None, "it leaves");
    assert_eq!(step([0.1, 3.0], [-0.4, 0.0]), Some([0.1, 3.0]), "nothing goes out by an inlet");
}

#[test]
fn an_empty_hall_has_wind_of_one_speed() {
    let flow = Flow::new(&hall(), &Scene::default()).unwrap();
    for point in [[0.1, 0.1], [10.0, 6.0], [19.9, 11.9]] {
        let [along, across] = flow.velocity_m_s(point);
        assert!((along - 0.5).abs() < 1e-8 && across.abs() < 1e-8, "{point:?}: {along} {across}");
    }
}

/// Mass balance with walls, meander, outflow and fading: to rounding, at every moment.
#[test]
fn no_gas_is_lost() {
    let mut scene = Scene::default();
    scene.add_walls(&[[6.0, 3.0], [14.0, 3.0], [14.0, 7.0], [6.0, 7.0]], true).unwrap();
    let meander = Wander { deviation: 0.1, tau_s: 10.0 };
    let plume = Plume::new(PlumeSpec { meander, lifetime_s: 35.0, ..spec() }, &hall(), &scene).unwrap();
    let mut field = gas(plume);
    for second in 1..=200 {
        field.value(f64::from(second), [10.0, 6.0]);
        let FieldKind::Gas(plume) = &field.kind else { unreachable!() };
        let balance = plume.balance();
        let sum = balance.inside_m3 + balance.left_m3 + balance.faded_m3;
        assert!((sum - balance.released_m3).abs() < 1e-15, "{balance:?}");
        // a filament carries a fifth of a second, and is released late by at most one
        assert!((balance.released_m3 - 1e-5 * f64::from(second)).abs() < 5e-6, "{balance:?}");
    }
    let FieldKind::Gas(plume) = &field.kind else { unreachable!() };
    let balance = plume.balance();
    assert!(balance.left_m3 > 0.0 && balance.faded_m3 > 0.0, "{balance:?}");
    assert_eq!(field.value(200.0, [10.0, 5.0]), 0.0, "nothing in the closed shelf");
}

/// The sum of the field over the plane gives the gas inside: the cut at 3.5 deviations removes exp(-3.5²/2) = 0.22 %.
#[test]
fn the_field_holds_the_gas_that_is_inside() {
    let mut field = gas(Plume::new(PlumeSpec { radius_m: 0.2, ..spec() }, &hall(), &Scene::default()).unwrap());
    field.value(20.0, [0.0, 0.0]);
    let (step_m, mut sum) = (0.1, 0.0);
    for x in 0..200 {
        for y in 0..120 {
            sum += field.value(20.0, [(f64::from(x) + 0.5) * step_m, (f64::from(y) + 0.5) * step_m]);
        }
    }
    let FieldKind::Gas(plume) = &field.kind else { unreachable!() };
    let found_m3 = sum * 1e-6 * step_m * step_m * 2.0;
    let kept = 1.0 - (-0.5 * REACH * REACH).exp();
    assert!((found_m3 / plume.balance().inside_m3 / kept - 1.0).abs() < 2e-3, "{found_m3} {:?}", plume.balance());
}

/// On the centre line filaments pass as a Poisson process of the density `f / (u sqrt(TAU) s)` on the plane, so the
/// share of time with gas is `1 - exp(-density pi (3.5 r)²)` and the mean that of a Gaussian plume, reduced by 0.2 % by
/// the cut.
#[test]
fn gas_comes_as_often_and_as_much_as_the_statistics_say() {
    let mut field = gas(Plume::new(spec(), &hall(), &Scene::default()).unwrap());
    let (distance_m, wind_m_s) = (8.0, 0.5);
    let age_s = distance_m / wind_m_s;
    let variance_m2 = spec().spread_m2_s * age_s;
    let radius2_m2 = 0.05 * 0.05 + spec().growth_m2_s * age_s;
    let density = spec().filaments_per_s / (wind_m_s * (TAU * variance_m2).sqrt());
    let expected_share = 1.0 - (-density * TAU / 2.0 * REACH * REACH * radius2_m2).exp();
    let across_m = (variance_m2 + radius2_m2).sqrt();
    let expected_ppm = 1e6 * 1e-5 / (wind_m_s * 2.0 * TAU.sqrt() * across_m);
    let (mut with_gas, mut sum) = (0.0, 0.0);
    let count = 20_000;
    for number in 0..count {
        let value = field.value(60.0 + 0.5 * f64::from(number), [2.25 + distance_m, 6.0]);
        with_gas += f64::from(u8::from(value > 0.0)) / f64::from(count);
        sum += value / f64::from(count);
    }
    // A filament is visible for about 0.7 s, so 10 000 s are 7000 independent samples: four standard errors are 0.024
    // of the share, and, with a standard deviation of about twice the mean, 0.1 of the mean.
    assert!((0.2..0.8).contains(&expected_share), "the test wants both: {expected_share}");
    assert!((with_gas - expected_share).abs() < 0.024, "{with_gas} of time, {expected_share}");
    assert!((sum / expected_ppm - 1.0).abs() < 0.1, "{sum} ppm, {expected_ppm} ppm");
}

/// Taylor (1921): `2 v² T² (t/T - 1 + exp(-t/T))` is the variance across the wind of particles that the meander has
/// carried for a time t.
#[test]
fn the_centre_line_meanders_by_taylors_law() {
    let meander = Wander { deviation: 0.05, tau_s: 5.0 };
    let still = Plume::new(PlumeSpec { spread_m2_s: 0.0, meander, ..spec() }, &hall(), &Scene::default()).unwrap();
    let time_s = 10.0;
    let runs = 2000;
    let mut variance_m2 = 0.0;
    for seed in 0..runs {
        let mut one =
            still.changed(|spec| (spec.seed, spec.filaments_per_s, spec.radius_m) = (seed, 10.0, 0.3)).unwrap();
        one.value(time_s, [0.0; 2]);
        let (place_m, _) = one.oldest().unwrap();
        variance_m2 += (place_m[1] - 6.0).powi(2) / runs as f64;
    }
    let ratio: f64 = time_s / 5.0;
    let expected_m2 = 2.0 * 0.05_f64.powi(2) * 25.0 * (ratio - 1.0 + (-ratio).exp());
    // Four standard errors, sqrt(2 / 2000) each; the step of 0.1 s adds another 1 %.
    assert!((variance_m2 / expected_m2 - 1.0).abs() < 0.14, "{variance_m2} m², {expected_m2} m²");
}

#[test]
fn the_same_seed_gives_the_same_values_however_often_one_looks() {
    let meander = Wander { deviation: 0.1, tau_s: 10.0 };
    let plume = Plume::new(PlumeSpec { meander, running_s: 30.0, ..spec() }, &hall(), &Scene::default()).unwrap();
    let at = [8.0, 6.0];
    let mut seldom = gas(plume.clone());
    let mut often = seldom.clone();
    for step in 0..500 {
        often.value(f64::from(step) * 0.02, at);
    }
    assert_eq!(seldom.value(10.0, at), often.value(10.0, at));
    assert_eq!(seldom, often);
    let mut other = gas(plume.changed(|spec| spec.seed = 2).unwrap());
    other.value(10.0, at);
    assert_ne!(seldom, other);
}

fn electric() -> ElectricSpec {
    ElectricSpec {
        uniform_v_per_m: 100.0,
        charges: vec![Charge { place_m: [10.0, 0.0], size_m: 5.0, peak_v_per_m: -80.0 }],
        clouds: vec![Cloud {
            charge: Charge { place_m: [-100.0, 0.0], size_m: 20.0, peak_v_per_m: 50.0 },
            velocity_m_s: [2.0, 0.0],
            wander: STILL,
        }],
        drift: STILL,
        seed: 3,
    }
}

#[test]
fn charges_stay_and_clouds_pass() {
    let mut field = Field { name: "e".into(), kind: FieldKind::Electric(Box::new(Electric::new(electric()).unwrap())) };
    // A hundred deviations away from everything, in the charge's centre, one deviation beside it; then below the cloud.
    for (time_s, point, expected) in [
        (0.0, [0.0, 2000.0], 100.0),
        (0.0, [10.0, 0.0], 20.0),
        (0.0, [10.0, 5.0], 100.0 - 80.0 * (-0.5_f64).exp()),
        (55.0, [10.0, 0.0], 70.0),
    ] {
        let value = field.value(time_s, point);
        assert!((value - expected).abs() < 1e-4, "{time_s} s {point:?}: {value}");
    }
}

/// 20 000 s of a process of 20 s are 500 independent values (two correlation times each): four standard errors of the
/// variance are 25 %, those of the correlation 0.1.
#[test]
fn drift_has_its_deviation_and_time() {
    let drift = Wander { deviation: 30.0, tau_s: 20.0 };
    let spec = ElectricSpec { drift, charges: Vec::new(), clouds: Vec::new(), ..electric() };
    let mut electric = Electric::new(spec).unwrap();
    let values: Vec<f64> = (0..1000).map(|step| electric.value(f64::from(step) * 20.0, [0.0; 2]) - 100.0).collect();
    let variance = values.iter().map(|value| value * value).sum::<f64>() / 1000.0;
    let neighbours = values.windows(2).map(|pair| pair[0] * pair[1]).sum::<f64>() / 999.0;
    assert!((variance / 900.0 - 1.0).abs() < 0.25, "{variance}");
    assert!((neighbours / variance - (-1.0_f64).exp()).abs() < 0.13, "{}", neighbours / variance);
}

/// A step between two samples is a ramp of 10 ms: its analytic response, to rounding.
#[test]
fn a_lag_answers_a_step_as_it_should() {
    let (constant_s, step_s) = (2.0, 0.01);
    let mut lag = Lag::new(constant_s);
    lag.follow(0.0, 0.0);
    for number in 1..=1000 {
        let time_s = f64::from(number) * step_s;
        lag.follow(time_s, 5.0);
        let after_ramp = 1.0 - constant_s / step_s * (1.0 - (-step_s / constant_s).exp());
        let expected = 5.0 * (1.0 - (1.0 - after_ramp) * (-(time_s - step_s) / constant_s).exp());
        assert!((lag.reading() - expected).abs() < 1e-9, "{time_s} s: {} {expected}", lag.reading());
        // and within half a sample of the response to an ideal step
        assert!(
            (lag.reading() - 5.0 * (1.0 - (-time_s / constant_s).exp())).abs() < 5.0 * 0.5 * step_s / constant_s + 1e-9
        );
    }
    let mut quick = Lag::new(0.0);
    for (time_s, input) in [(0.0, 1.0), (0.01, 4.0), (0.01, 4.5)] {
        quick.follow(time_s, input);
    }
    assert_eq!(quick.reading(), 4.5);
}

/// A body turns in a field with a gradient: the sensor on its rim reads the field at the rim's place.
#[test]
fn a_sensor_on_a_turning_body_reads_where_it_is() {
    let charges = vec![Charge { place_m: [0.0, 0.0], size_m: 1.0, peak_v_per_m: 100.0 }];
    let mut electric = Electric::new(ElectricSpec { charges, ..ElectricSpec::default() }).unwrap();
    for eighth in 0..8 {
        let yaw_rad = f64::from(eighth) * TAU / 8.0;
        let pose = Pose { x_m: 1.0, y_m: 0.0, yaw_rad };
        let squared = 1.0 + 0.25 + 2.0 * 0.5 * yaw_rad.cos();
        let value = electric.value(0.0, pose.to_world([0.5, 0.0]));
        assert!((value - 100.0 * (-0.5 * squared).exp()).abs() < 1e-9, "{yaw_rad}: {value}");
    }
}

#[test]
fn what_cannot_be_computed_is_named() {
    let scene = Scene::default();
    let flow = |change: &dyn Fn(&mut FlowSpec), scene: &Scene| {
        let mut spec = hall();
        change(&mut spec);
        Flow::new(&spec, scene).unwrap_err()
    };
    assert_eq!(flow(&|spec| spec.cell_m = 0.0, &scene), FlowError::Grid);
    assert_eq!(flow(&|spec| spec.cell_m = f64::NAN, &scene), FlowError::Grid);
    assert_eq!(flow(&|spec| spec.cell_m = 0.01, &scene), FlowError::Grid);
    let inside = FlowError::Opening { which: "inlets_m", number: 0 };
    assert_eq!(flow(&|spec| spec.inlets_m[0] = [[5.0, 1.0], [5.0, 3.0]], &scene), inside);
    let mut walled = Scene::default();
    walled.add_walls(&[[10.2, -1.0], [10.2, 13.0]], false).unwrap();
    assert_eq!(flow(&|_| {}, &walled), FlowError::Closed);
    assert_eq!(flow(&|spec| spec.outlets_m.clear(), &scene), FlowError::Closed);

    let plume = Plume::new(spec(), &hall(), &scene).unwrap();
    let wrong = |change: fn(&mut PlumeSpec)| plume.changed(change).unwrap_err();
    assert_eq!(wrong(|spec| spec.source_m = [-1.0, 0.0]), FieldError::Source([-1.0, 0.0]));
    assert!(matches!(wrong(|spec| spec.layer_m = 0.0), FieldError::Number { what: "layer_m", .. }));
    assert!(matches!(wrong(|spec| spec.growth_m2_s = -1.0), FieldError::Number { what: "growth_m2_s", .. }));
    assert!(matches!(wrong(|spec| spec.running_s = 1e9), FieldError::Number { what: "running_s", .. }));
    assert!(matches!(wrong(|spec| spec.meander.deviation = 1.0), FieldError::Number { what: "meander", .. }));
    assert!(matches!(wrong(|spec| spec.lifetime_s = 1e6), FieldError::TooMany { .. }));
    let flat = Charge { place_m: [0.0; 2], size_m: 0.0, peak_v_per_m: 1.0 };
    let charges = Electric::new(ElectricSpec { charges: vec![flat], ..ElectricSpec::default() });
    assert!(matches!(charges, Err(FieldError::Number { what: "charges", .. })));
    let drift = Wander { deviation: 1.0, tau_s: 0.1 };
    assert!(Electric::new(ElectricSpec { drift, ..ElectricSpec::default() }).is_err());
}
