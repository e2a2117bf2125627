use super::*;

const STEP_S: f64 = MAX_STEP_S;
const FLOW: Restriction = Restriction { conductance_m3_s_pa: 8e-10, critical_ratio: 0.3 };
const SUPPLY: AirSupply =
    AirSupply { receiver_m3: 0.5e-3, compressor_m3_s: 5e-5, runs_between_pa: [5e5, 6e5], regulated_pa: 1.4e5 };
const VALVE: CoilValve = CoilValve { shaft: 0, delay_s: [0.02, 0.03], inlet: FLOW, exhaust: FLOW };
const CYLINDER: Cylinder = Cylinder {
    bore_m: 0.016,
    rod_m: 0.005,
    stroke_m: 0.025,
    dead_m3: 2e-6,
    mass_kg: 0.05,
    coulomb_n: 4.0,
    viscous_n_s_per_m: 15.0,
    cushion_n_s_per_m: 60.0,
    closes_outwards: false,
};
const FINGERS: Fingers =
    Fingers { open_gap_m: 0.036, gap_ratio: 1.2, stiffness_n_per_m: 1200.0, bending_n_per_m: 800.0, pad_m: 0.008 };
const AXES: ToolAxes = ToolAxes { shafts: [1, 2], m_per_rad: 0.01, tray_m: 0.03 };
const BERRY: Berry = Berry {
    place_m: [0.13, 0.0],
    diameter_m: 0.019,
    mass_kg: 0.004,
    stiffness_n_per_m: 1500.0,
    friction: 0.55,
    stalk_n_per_m: 150.0,
    detach_n: 1.5,
    crush_n: 10.0,
};

fn picker(supply: AirSupply, cylinder: Cylinder, berry: Berry) -> BerryPicker {
    BerryPicker::new(supply, VALVE, cylinder, FINGERS, AXES, vec![berry]).expect("a gripper")
}

/// Moves the tool at constant speed to `reach_m`, with the relay closed or open.
fn go(picker: &mut BerryPicker, is_closed: bool, reach_m: f64, over_s: f64) {
    let from_m = picker.tool_m()[0];
    let steps = (over_s / STEP_S).round() as usize;
    for step in 1..=steps {
        let at_m = from_m + (reach_m - from_m) * step as f64 / steps as f64;
        let relay = ShaftMotion { position: f64::from(u8::from(is_closed)), speed: 0.0 };
        let reach = ShaftMotion { position: at_m / 0.01, speed: (reach_m - from_m) / over_s / 0.01 };
        picker.step(&mut Scene::default(), 0.0, &[relay, reach, ShaftMotion::default()], &mut [0.0; 3], STEP_S);
    }
}

/// Moves to the bush, closes, pulls back to `release_m`, and opens.
fn pick(picker: &mut BerryPicker, release_m: f64) -> Fate {
    go(picker, false, 0.13, 0.3);
    go(picker, true, 0.13, 0.3);
    go(picker, true, release_m, 0.3);
    go(picker, false, release_m, 0.3);
    picker.fates()[0]
}

/// Forces of the paper at 5 bar and 16 mm: 100.5 N, and 90.7 N on the side of the rod; its 50 N correspond to 2.5 bar.
#[test]
fn five_bar_are_a_hundred_newtons() {
    let supply = AirSupply { regulated_pa: 5e5, ..SUPPLY };
    for (closes_outwards, expected_n) in [(true, 100.5), (false, 90.7)] {
        let mut picker = picker(supply, Cylinder { closes_outwards, ..CYLINDER }, BERRY);
        go(&mut picker, true, 0.0, 1.0);
        // Printed to a tenth of a newton; the supply has refilled the chambers to the regulator's setting.
        assert!((picker.air_n() - expected_n).abs() < 0.06, "{} N", picker.air_n());
        assert_eq!(picker.travel_m(), 0.025);
    }
}

/// With a stalled rod the pneumatic force equals bending plus squeeze plus at most the dry friction.
#[test]
fn a_squeeze_is_that_of_statics() {
    let mut picker = picker(SUPPLY, CYLINDER, BERRY);
    go(&mut picker, false, 0.13, 0.3);
    go(&mut picker, true, 0.13, 1.0);
    let (travel_m, squeeze_n) = (picker.travel_m(), picker.squeeze_n());
    let stiffness = 1.0 / (1.0 / 1200.0 + 1.0 / 1500.0);
    assert!((squeeze_n - stiffness * (0.019 - 0.036 + 1.2 * travel_m)).abs() < 1e-9);
    let friction_n = picker.air_n() - 800.0 * travel_m - 1.2 * squeeze_n;
    assert!((0.0..=4.0).contains(&friction_n), "{friction_n} N");
    assert!(travel_m < 0.024 && (3.0..7.0).contains(&squeeze_n), "{travel_m} m, {squeeze_n} N");
}

/// Mass balance: the air of the receiver and of the compressor is in receiver and chambers or left through the exhaust;
/// a stroke consumes the amount of the ideal gas law.
#[test]
fn a_stroke_takes_its_air_from_the_receiver() {
    let still = AirSupply { compressor_m3_s: 1e-12, regulated_pa: 4e5, ..SUPPLY };
    let mut picker = picker(still, CYLINDER, BERRY);
    let before_pa = picker.receiver_pa();
    go(&mut picker, true, 0.0, 2.0);
    let [close_m2, _] = CYLINDER.areas_m2();
    let volume_m3 = 2e-6 + close_m2 * 0.025;
    // Polytropic air in the chamber ends warmer than its walls, so less flows in: within the exponent, 1 to 1.2, of
    // isothermal.
    let isothermal_pa = (volume_m3 * (4e5 + ATMOSPHERE_PA) - 2e-6 * ATMOSPHERE_PA) / 0.5e-3;
    let taken_pa = before_pa - picker.receiver_pa();
    assert!(taken_pa < isothermal_pa && taken_pa > isothermal_pa / 1.2 - 200.0, "{taken_pa} {isothermal_pa}");
}

#[test]
fn a_berry_goes_into_the_tray() {
    let mut one = picker(SUPPLY, CYLINDER, BERRY);
    let fate = pick(&mut one, 0.0);
    assert!(fate.place == Place::Tray && !fate.is_crushed, "{fate:?}");
    // The stalk's tension at detachment: the tool had moved 10 mm, plus the slip.
    assert!(fate.squeeze_max_n * 2.0 * 0.55 > 1.5);
    // Released before the tray, the berry is on the ground.
    assert_eq!(pick(&mut picker(SUPPLY, CYLINDER, BERRY), 0.08).place, Place::Ground);
}

#[test]
fn a_berry_that_the_gap_does_not_fit_is_pushed_away() {
    // Half the gap minus half the berry: 8.5 mm.
    for (aside_m, place) in [(0.008, Place::Tray), (0.009, Place::Hanging)] {
        let berry = Berry { place_m: [0.13, aside_m], ..BERRY };
        assert_eq!(pick(&mut picker(SUPPLY, CYLINDER, berry), 0.0).place, place, "{aside_m}");
    }
    let out_of_reach = Berry { place_m: [0.139, 0.0], ..BERRY };
    assert_eq!(pick(&mut picker(SUPPLY, CYLINDER, out_of_reach), 0.0).place, Place::Hanging);
}

#[test]
fn a_weak_grip_slips_and_a_strong_one_crushes() {
    let slips = pick(&mut picker(SUPPLY, CYLINDER, Berry { detach_n: 12.0, ..BERRY }), 0.0);
    assert_eq!(slips.place, Place::Hanging);
    let strong = AirSupply { regulated_pa: 5e5, ..SUPPLY };
    let crushed = pick(&mut picker(strong, CYLINDER, Berry { crush_n: 7.0, ..BERRY }), 0.0);
    // The rod is at its end: 0.667 N/mm on 19 - 6 mm.
    assert!(crushed.is_crushed && (crushed.squeeze_max_n - 8.67).abs() < 0.05, "{crushed:?}");
}

/// Faster than the compressor refills, the receiver falls below the regulator's setting, and rises again at rest.
#[test]
fn fast_cycles_empty_the_receiver() {
    let mut picker = picker(AirSupply { regulated_pa: 5e5, ..SUPPLY }, CYLINDER, BERRY);
    for _ in 0..20 {
        go(&mut picker, true, 0.0, 0.25);
        go(&mut picker, false, 0.0, 0.25);
    }
    let sagged_pa = picker.receiver_pa();
    assert!(sagged_pa < 4.7e5, "{sagged_pa}");
    go(&mut picker, false, 0.0, 20.0);
    assert!(picker.receiver_pa() > 5.9e5, "{}", picker.receiver_pa());
}

/// Without current the spring opens the fingers after its delay, with or without an object.
#[test]
fn without_current_the_fingers_open() {
    let mut picker = picker(SUPPLY, CYLINDER, BERRY);
    go(&mut picker, false, 0.13, 0.3);
    go(&mut picker, true, 0.13, 0.3);
    assert!(picker.squeeze_n() > 3.0);
    go(&mut picker, false, 0.13, 0.029);
    assert!(picker.squeeze_n() > 3.0, "within the spool's 30 ms");
    go(&mut picker, false, 0.13, 0.3);
    assert_eq!((picker.squeeze_n(), picker.travel_m()), (0.0, 0.0));
    assert_eq!(picker.fates()[0].place, Place::Hanging);
}

#[test]
fn numbers_of_no_gripper_are_refused() {
    let new = |cylinder, berry| BerryPicker::new(SUPPLY, VALVE, cylinder, FINGERS, AXES, vec![berry]).err();
    assert!(matches!(new(Cylinder { dead_m3: 1e-7, ..CYLINDER }, BERRY), Some(BerryError::Stiff { .. })));
    assert_eq!(new(Cylinder { rod_m: 0.02, ..CYLINDER }, BERRY), Some(BerryError::Cylinder));
    let wide = Berry { diameter_m: 0.04, ..BERRY };
    assert_eq!(new(CYLINDER, wide), Some(BerryError::Berry { berry: 0 }));
}
