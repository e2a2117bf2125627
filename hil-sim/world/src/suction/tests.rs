use super::*;
use crate::MAX_STEP_S;

const LINE: Line = Line {
    stepper: 0,
    valve: 1,
    lead_m: 2e-3,
    bore_m2: 165e-6,
    syringe_m3: 10e-6,
    dead_m3: 2e-6,
    tube: Restriction { conductance_m3_s_pa: 1.5e-10, critical_ratio: 0.3 },
    orifice: Restriction { conductance_m3_s_pa: 2e-10, critical_ratio: 0.3 },
    leak: Restriction { conductance_m3_s_pa: 0.0, critical_ratio: 0.3 },
};
const MEMBRANE: Membrane = Membrane {
    radius_m: 5e-3,
    thickness_m: 1e-3,
    shear_pa: 47e3,
    stiffening: 114.0,
    viscosity_pa_s: 1e3,
    burst_stretch: 4.0,
    softening: 0.0,
    relaxing: 0.0,
    relaxing_s: 1.0,
};
const CUP: Cup =
    Cup { radius_m: 9e-3, suction_pa: 11.6e3, stiffness_n_m: 800.0, leak_strain: 0.08, leak_per_s: 8.0, peel: 0.35 };
const STRIP: Strip = Strip { stiffness_n_m: 250.0, middle: 1.0, outer: 0.5, near: 0.15 };

fn pad(supply_pa: Option<f64>) -> SuctionPad {
    let lines = [0, 1, 2].map(|number| Line { stepper: 2 * number, valve: 2 * number + 1, ..LINE });
    SuctionPad::new(STRIP, [CUP, Cup { leak_strain: 0.1, ..CUP }], [MEMBRANE; 3], lines, supply_pa).expect("a pad")
}

/// Runs with `pushed_m3(t)` pushed in by the middle syringe, and its valve closed (`true`) or not.
fn run(
    pad: &mut SuctionPad,
    seconds: f64,
    pushed_m3: impl Fn(f64) -> f64,
    valve: bool,
    mut look: impl FnMut(&SuctionPad),
) {
    let mut shafts = [ShaftMotion::default(); 6];
    let mut loads = [0.0; 6];
    let mut scene = Scene::default();
    for step in 0..(seconds / MAX_STEP_S).round() as u32 {
        let time_s = f64::from(step) * MAX_STEP_S;
        shafts[2].position = pushed_m3(time_s) / (LINE.lead_m * LINE.bore_m2) * TAU;
        shafts[3].position = f64::from(u8::from(valve));
        pad.step(&mut scene, time_s, &shafts, &mut loads, MAX_STEP_S);
        look(pad);
    }
}

/// Boyle's law `(p_a + p) (V_line - pushed + V_balloon) = p_a (V_line + V_0)`, and the membrane's own pressure.
#[test]
fn a_closed_syringe_keeps_its_gas_and_passes_the_limit_point() {
    let mut pad = pad(None).in_air();
    let (mut highest_pa, mut passes) = (0.0_f64, false);
    run(
        &mut pad,
        8.0,
        |time_s| (1e-6 * time_s).min(6e-6),
        true,
        |pad| {
            highest_pa = highest_pa.max(pad.state().balloon[MIDDLE].gauge_pa());
            passes |= pad.state().membrane[MIDDLE].stretch > LIMIT_STRETCH;
        },
    );
    let SuctionState { line, balloon, membrane, .. } = *pad.state();
    let amount = |chamber: Chamber| chamber.pressure_pa * chamber.volume_m3;
    let before = ATMOSPHERE_PA * (12e-6 + MEMBRANE.volume_m3(1.0));
    let after = amount(line[MIDDLE]) + amount(balloon[MIDDLE]);
    // Chamber::step is of second order: 32 000 steps leave 1e-5
    assert!((after / before - 1.0).abs() < 1e-4, "{after} {before}");
    let held_pa = MEMBRANE.pressure_pa(membrane[MIDDLE].stretch);
    assert!((balloon[MIDDLE].gauge_pa() - held_pa).abs() < 5.0, "{} {held_pa}", balloon[MIDDLE].gauge_pa());
    // viscosity adds 1 kPa s times a stretch rate of at most 0.6 per second
    let limit_pa = MEMBRANE.pressure_pa(LIMIT_STRETCH);
    assert!(passes && !membrane[MIDDLE].is_burst, "{membrane:?}");
    assert!((limit_pa..limit_pa + 600.0).contains(&highest_pa), "{highest_pa} {limit_pa}");
}

#[test]
fn a_constant_pressure_beyond_the_limit_runs_away_and_one_below_it_does_not() {
    let limit_pa = MEMBRANE.pressure_pa(LIMIT_STRETCH);
    for (supply_pa, bursts) in [(0.9 * limit_pa, false), (1.1 * limit_pa, true), (20e3, true), (38e3, true)] {
        let mut pad = pad(Some(supply_pa)).in_air();
        run(&mut pad, 30.0, |_| 0.0, true, |_| {});
        let state = pad.state().membrane[MIDDLE];
        assert_eq!(state.is_burst, bursts, "{supply_pa} Pa: {state:?}");
        assert!(bursts || state.stretch < LIMIT_STRETCH, "{supply_pa} Pa: {state:?}");
    }
}

/// The weaker cup comes off; the pressure drops by the strip's share, and the free end relieves the other cup.
#[test]
fn a_cup_comes_off_with_a_drop_of_pressure_and_the_other_stays() {
    let mut pad = pad(None);
    let mut drop_pa = None;
    let mut before = *pad.state();
    run(
        &mut pad,
        7.0,
        |time_s| (1e-6 * time_s).min(6e-6),
        true,
        |pad| {
            let state = *pad.state();
            if before.is_attached[0] && !state.is_attached[0] {
                drop_pa = Some((before.balloon[MIDDLE].gauge_pa(), before.shear_n[0], before.membrane[MIDDLE].stretch));
            }
            before = state;
        },
    );
    let (at_pa, shear_n, stretch) = drop_pa.expect("it came off");
    let state = pad.state();
    assert_eq!(state.is_attached, [false, true], "{state:?}");
    // strain of the cup at an outer membrane, which is never inflated
    assert!(pad.adhesion_n(0) == 0.0 && state.rim_strain[1] < 1e-12, "{state:?}");
    let radius_m = MEMBRANE.radius_m * stretch;
    let strip_pa = shear_n * STRIP.middle / (4.0 * PI * radius_m * radius_m);
    assert!(strip_pa > 300.0 && at_pa > MEMBRANE.pressure_pa(stretch) + 0.8 * strip_pa, "{strip_pa} {at_pa}");
    // afterwards the membrane's own pressure alone
    let own_pa = MEMBRANE.pressure_pa(state.membrane[MIDDLE].stretch);
    assert!((state.balloon[MIDDLE].gauge_pa() - own_pa).abs() < 5.0);
}

#[test]
fn an_open_valve_vents_the_line() {
    let mut pad = pad(None);
    run(&mut pad, 3.0, |time_s| 1e-6 * time_s.min(2.5), true, |_| {});
    assert!(pad.state().membrane[MIDDLE].stretch > 1.3);
    run(&mut pad, 3.0, |_| 2.5e-6, false, |_| {});
    let state = pad.state();
    assert!(state.membrane[MIDDLE].stretch < 1.01 && state.line[MIDDLE].gauge_pa().abs() < 10.0, "{state:?}");
    assert_eq!(state.is_attached, [true; 2]);
}

#[test]
fn impossible_pads_are_refused() {
    let lines = [LINE; 3];
    let with = |membrane, line, cup, strip| SuctionPad::new(strip, [cup; 2], [membrane; 3], [line; 3], None);
    assert!(SuctionPad::new(STRIP, [CUP; 2], [MEMBRANE; 3], lines, Some(f64::NAN)).is_err());
    let bad = Membrane { burst_stretch: 9.0, ..MEMBRANE };
    assert_eq!(with(bad, LINE, CUP, STRIP), Err(SuctionError::Membrane { membrane: 0 }));
    let stiff = Membrane { viscosity_pa_s: 10.0, ..MEMBRANE };
    assert_eq!(with(stiff, LINE, CUP, STRIP), Err(SuctionError::Stiff { membrane: 0 }));
    let wide = Restriction { conductance_m3_s_pa: 1e-8, ..LINE.tube };
    assert_eq!(with(MEMBRANE, Line { tube: wide, ..LINE }, CUP, STRIP), Err(SuctionError::Wide { line: 0 }));
    assert_eq!(with(MEMBRANE, Line { dead_m3: 0.0, ..LINE }, CUP, STRIP), Err(SuctionError::Line { line: 0 }));
    let cup = Cup { leak_strain: f64::NAN, ..CUP };
    assert_eq!(with(MEMBRANE, LINE, cup, STRIP), Err(SuctionError::Cup { cup: 0 }));
    assert_eq!(with(MEMBRANE, LINE, CUP, Strip { near: -1.0, ..STRIP }), Err(SuctionError::Strip));
}
