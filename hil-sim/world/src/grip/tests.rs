use super::*;
use crate::MAX_STEP_S;

const PALM: Palm = Palm { zero_m: 0.070, m_per_rad: 0.040, play_m: 0.0 };
const FINGER: Finger = Finger {
    length_m: 0.12,
    half_width_m: 0.008,
    inertia_kg_m2: 2e-4,
    link_nm_per_rad: 60.0,
    link_nm_s_per_rad: 0.05,
    play_rad: 0.0,
    servo_nm_per_rad: 6.0,
    servo_nm_s_per_rad: 0.135,
};
const PADS: Pads = Pads { stiffness_n_per_m: 8e4, damping_n_s_per_m: 30.0, friction: 0.8, creep_per_s: 0.0 };
const DISC: Held =
    Held { side_m: 0.030, edge_m: 0.015, mass_kg: 0.06, table_friction: 0.0, place_m: [0.0, 0.08], angle_rad: 0.0 };
const EXACT: Encoders = Encoders { step_rad: 1e-9, noise_rad: 0.0, offset_rad: [0.0; 3], seed: 1 };

struct Hand {
    body: TwoFingers,
    at: [f64; 3],
}

impl Hand {
    fn new(pads: Pads, held: Held) -> Self {
        let body = TwoFingers::new(PALM, FINGER, pads, held, EXACT).expect("a gripper");
        Self { body, at: [0.05, -0.05, 0.0] }
    }

    /// Moves the servos to `to` within `over_s`, at constant speed.
    fn go(&mut self, to: [f64; 3], over_s: f64) {
        let steps = (over_s / MAX_STEP_S).round();
        let from = self.at;
        for step in 1..=steps as usize {
            self.at = [0, 1, 2].map(|number| from[number] + (to[number] - from[number]) * step as f64 / steps);
            let speed = |number: usize| (to[number] - from[number]) / over_s;
            let shafts = [0, 1, 2].map(|number| ShaftMotion { position: self.at[number], speed: speed(number) });
            self.body.step(&mut Scene::default(), 0.0, &shafts, &mut [0.0; 3], MAX_STEP_S);
        }
    }

    fn gripped(pads: Pads, held: Held) -> Self {
        let mut hand = Self::new(pads, held);
        hand.go([-0.18, 0.18, 0.0], 0.5);
        hand.go([-0.18, 0.18, 0.0], 0.5);
        hand
    }

    fn touches(&self) -> [Touch; 2] {
        self.body.touches().map(|touch| touch.expect("a contact"))
    }
}

/// Grip force from the servos' springs: k (set - shaft) = F times the lever arm of the line through both contacts.
#[test]
fn grip_force_is_that_of_the_servos_springs() {
    let hand = Hand::gripped(PADS, DISC);
    let [left, right] = hand.touches();
    assert!((left.normal_n / right.normal_n - 1.0).abs() < 1e-3, "{left:?} {right:?}");
    let torque_nm = 6.0 * ((hand.body.sides[0].shaft_rad - UPRIGHT_RAD) - hand.at[0]);
    // The line is horizontal in this symmetric grasp: its arm is the contact's height; F cos(tilt) is normal to the
    // finger.
    let tilt_rad = UPRIGHT_RAD - hand.body.finger_rad()[0];
    let expected_n = torque_nm / left.place_m[1] * tilt_rad.cos();
    assert!((left.normal_n / expected_n - 1.0).abs() < 0.01, "{} N, {expected_n} N", left.normal_n);
    assert!(hand.body.object_m_s() < 1e-6 && left.normal_n > 1.0);
}

/// Rolling without slip: the contact's travel along the finger is the radius times the rotation of the object relative
/// to the finger, whether fingers or palm move.
#[test]
fn a_disc_rolls_along_the_finger() {
    let mut hand = Hand::gripped(PADS, DISC);
    let begin = hand.body.clone();
    let along = |body: &TwoFingers, side: usize| {
        let touch = body.touches()[side].expect("a contact");
        (touch.distance_m * touch.distance_m - 0.008 * 0.008).sqrt()
    };
    for to in [[-0.28, 0.28, 0.375], [-0.08, 0.08, -0.375], [0.0, 0.36, 0.0], [-0.36, 0.0, 0.0]] {
        hand.go(to, 1.0);
        hand.go(to, 0.5);
        let turned_rad = hand.body.object_rad() - begin.object_rad();
        for (side, sign) in [(0, 1.0), (1, -1.0)] {
            let finger_rad = hand.body.finger_rad()[side] - begin.finger_rad()[side];
            let expected_m = sign * 0.015 * (turned_rad - finger_rad);
            let way_m = along(&hand.body, side) - along(&begin, side);
            // tangential springs of 1 N on 8e4 N/m change by up to 15 um
            assert!((way_m - expected_m).abs() < 1.5e-5, "{to:?}, side {side}: {way_m} {expected_m}");
            assert!(expected_m.abs() > 1e-3, "it rolls: {expected_m}");
        }
    }
}

/// A square between its edges keeps their distance for any motion of fingers and palm: the coupler of a four-bar
/// linkage.
#[test]
fn a_square_on_its_edges_is_a_four_bar_linkage() {
    let square = Held { side_m: 0.022, edge_m: 1e-4, angle_rad: std::f64::consts::FRAC_PI_4, ..DISC };
    let mut hand = Hand::gripped(PADS, square);
    let across_m = |hand: &Hand| {
        let [left, right] = hand.touches().map(|touch| touch.place_m);
        libm::hypot(right[0] - left[0], right[1] - left[1])
    };
    let expected_m = std::f64::consts::SQRT_2 * (0.022 - 2e-4) + 2e-4;
    for to in [[-0.18, 0.18, 0.0], [-0.10, 0.26, 0.0], [-0.18, 0.18, 0.0], [-0.24, 0.24, 0.2]] {
        hand.go(to, 0.5);
        hand.go(to, 0.3);
        let found_m = across_m(&hand);
        // both contacts yield by a grip of up to 8 N on 8e4 N/m
        assert!((found_m - expected_m).abs() < 2.5e-4, "{to:?}: {found_m} m, {expected_m} m");
        assert!(hand.touches().iter().all(|touch| !touch.slides));
    }
}

/// Fingers that lean towards each other push an object towards the palm if the lean exceeds the friction angle, and
/// hold it otherwise.
#[test]
fn slip_begins_outside_the_friction_cone() {
    let way_m = |friction: f64| {
        let mut hand = Hand::new(Pads { friction, ..PADS }, Held { place_m: [0.0, 0.06], ..DISC });
        hand.go([-0.20, 0.20, 0.0], 0.5);
        let begin_m = hand.body.object_m()[1];
        hand.go([-0.28, 0.28, 0.0], 0.5);
        hand.body.object_m()[1] - begin_m
    };
    // the fingers touch at about 0.17 rad: tan = 0.17
    assert!(way_m(0.3).abs() < 1e-3, "{}", way_m(0.3));
    assert!(way_m(0.08) < -5e-3, "{}", way_m(0.08));
}

/// A square as wide as the gap between upright fingers, put down askew, turns flush, and either face carries its force
/// between its edges.
#[test]
fn a_face_stands_flush() {
    let cube = Held { side_m: 0.054, edge_m: 1e-3, angle_rad: 0.04, place_m: [0.0, 0.08], ..DISC };
    let mut hand = Hand::new(PADS, cube);
    hand.at = [0.10, -0.10, 0.0];
    hand.go([-0.05, 0.05, 0.0], 0.5);
    hand.go([-0.05, 0.05, 0.0], 0.5);
    // two springs of 4 N on 8e4 N/m, 52 mm apart, turn by 1 mrad at most; the fingers yield by as much
    let [left, right] = hand.body.finger_rad().map(|angle| angle - UPRIGHT_RAD);
    assert!(hand.body.object_rad().abs() < 5e-3 && left.abs() < 5e-3 && right.abs() < 5e-3);
    for touch in hand.touches() {
        assert!(touch.normal_n > 1.0 && (touch.place_m[1] - hand.body.object_m()[1]).abs() < 0.026, "{touch:?}");
    }
}

#[test]
fn encoders_show_whole_steps() {
    let encoders = Encoders { step_rad: std::f64::consts::TAU / 4096.0, noise_rad: 5e-4, ..EXACT };
    let mut body = TwoFingers::new(PALM, FINGER, PADS, DISC, encoders).expect("a gripper");
    let shafts = [0.1, -0.1, 0.2].map(|position| ShaftMotion { position, speed: 0.0 });
    let mut sum = 0.0;
    for _ in 0..4000 {
        body.step(&mut Scene::default(), 0.0, &shafts, &mut [0.0; 3], MAX_STEP_S);
        let steps = body.reading(2) / encoders.step_rad;
        assert!((steps - steps.round()).abs() < 1e-9);
        sum += body.reading(2);
    }
    // Noise of a third of a step dithers the quantisation: a twentieth of a step remains.
    assert!((sum / 4000.0 - 0.2).abs() < 0.05 * encoders.step_rad, "{}", sum / 4000.0);
}

#[test]
fn wrong_numbers_are_refused() {
    let refused = |palm, finger, pads, held, encoders| {
        TwoFingers::new(palm, finger, pads, held, encoders).expect_err("a mistake")
    };
    assert_eq!(refused(Palm { m_per_rad: 0.0, ..PALM }, FINGER, PADS, DISC, EXACT), GripError::Palm);
    assert_eq!(refused(PALM, Finger { length_m: 0.0, ..FINGER }, PADS, DISC, EXACT), GripError::Finger);
    assert_eq!(refused(PALM, FINGER, PADS, Held { edge_m: 0.016, ..DISC }, EXACT), GripError::Object);
    assert_eq!(refused(PALM, FINGER, PADS, DISC, Encoders { step_rad: 0.0, ..EXACT }), GripError::Encoders);
    let stiff = Pads { stiffness_n_per_m: 1e7, ..PADS };
    assert!(matches!(refused(PALM, FINGER, stiff, DISC, EXACT), GripError::Pads { .. }));
}
