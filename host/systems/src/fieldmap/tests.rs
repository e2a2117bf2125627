use r4_boards::Drive;
use r4_maps::{
    grid::Frame,
    pose::{Pose, distance_m},
    process::Sample,
};
use r4_rig::{Limits, Place};
use r4_world::Person;

use super::{
    gnss::{Geodetic, Sentences},
    mill::{Calibration, ChargeState},
    run::{calibrated, readings, surveyed},
    scene::{Mill, PLOT, Scene},
    swarm::{Base, Member},
    *,
};

fn trial(arm: &'static str, seed: u64) -> Trial {
    Trial { arm, seed, board: "sim:field-rover".parse().expect("a board") }
}

const SOUND: Calibration = Calibration { offset_v: 2.5, form: 1.4, per_rad: 0.04, leak_s: 50.0 };

/// A person who stands in the first row, 5 m from the start, from 7 s to 40 s.
fn person() -> Person {
    let (beside, before) = ([9.0, 7.5], [9.0, 4.0]);
    Person { radius_m: 0.25, path: vec![(4.0, beside), (7.0, before), (40.0, before), (43.0, beside)] }
}

/// The robot stops before a person, readings go on without a gap, and the robot drives on round the person.
#[test]
fn a_person_in_the_way_costs_time_and_no_reading() {
    let trial = trial(OURS, 1);
    let scene = Scene::of(1, PLOT).expect("a scene");
    let run = |people| surveyed(&trial, &scene, SOUND, people).expect("a survey");
    let (with, without) = (run(vec![person()]), run(Vec::new()));
    let driven = with.driven.as_ref().expect("on a board");
    assert!((8.0..40.0).contains(&driven.stood_s), "{} s", driven.stood_s);
    assert_eq!(without.driven.as_ref().expect("on a board").stood_s, 0.0);
    // A sample every 100 ms, one of which the link may delay.
    assert!(driven.gap_s < 0.25, "{} s", driven.gap_s);
    let last_s = with.path.last().expect("a path").0;
    let expected = last_s / survey::PERIOD_S;
    // A reading ends with the first sample after its period: at most 2.1 s.
    assert!(with.taken.len() as f64 > 0.93 * expected, "{} of {expected}", with.taken.len());
    let furthest = with.path.iter().map(|(_, at)| at[1]).fold(0.0, f64::max);
    assert!(furthest > 30.0, "it went on to y = {furthest} m");
    // The receiver's 2 cm are correlated over a minute; the limit is six standard deviations.
    let off_m = driven.path.iter().map(|(_, at, truth)| distance_m(*at, *truth)).fold(0.0, f64::max);
    assert!(off_m < 0.12, "{off_m} m");
    assert!(driven.fixes[0] > 1000 && driven.fixes[1] < driven.fixes[0] / 100, "{:?}", driven.fixes);
}

#[test]
fn a_calibration_between_plates_finds_the_mill_of_a_board() {
    let mill = Mill::of(3);
    let found = calibrated(&trial(OURS, 3), mill).expect("a calibration");
    // Plates are 0.3 % off, their voltages 0.2 %: the limit is three standard deviations.
    assert!((found.form / mill.form - 1.0).abs() < 0.011, "{found:?} {mill:?}");
    // Converter noise of the mean, and 0.2 % of 150 V/m in the line's middle.
    assert!((found.offset_v - mill.offset_v()).abs() < 0.004, "{found:?} {mill:?}");
    assert!((found.per_rad / mill.charge.per_rad - 1.0).abs() < 0.05, "{found:?} {mill:?}");
    assert!((found.leak_s / mill.charge.leak_s - 1.0).abs() < 0.05, "{found:?} {mill:?}");
}

/// Compares a step response of the charge with its closed form.
#[test]
fn charge_grows_and_leaks_as_the_law_says() {
    let mut charge = ChargeState::default();
    let (rate_rad_s, step_s) = (7.0, 0.1);
    for step in 1..=1000 {
        charge.roll(&SOUND, f64::from(step) * step_s, rate_rad_s * step_s);
    }
    let settled = SOUND.per_rad * rate_rad_s * SOUND.leak_s;
    assert!((charge.field() - settled * (1.0 - (-100.0 / SOUND.leak_s).exp())).abs() < 1e-9);
    let before = charge.field();
    charge.roll(&SOUND, 150.0, 0.0);
    assert!((charge.field() - before * (-50.0 / SOUND.leak_s).exp()).abs() < 1e-9);
}

/// Latitude and longitude of a position 100 m east and 200 m south, computed elsewhere by way of earth-centred
/// coordinates.
#[test]
fn positions_become_metres_and_damaged_sentences_none() {
    let sentence = |content: &str| {
        let sum = content.bytes().fold(0, |sum: u8, byte| sum ^ byte);
        format!("${content}*{sum:02X}\r\n")
    };
    let origin =
        Geodetic { latitude_rad: 53.2_f64.to_radians(), longitude_rad: (-0.5_f64).to_radians(), height_m: 40.0 };
    // 53.198 202 884 and -0.498 503 652 degrees.
    let good = sentence("GPGGA,120000.00,5311.892173,N,00029.910219,W,1,12,0.8,40.0,M,0.0,M,,");
    let text = [
        "5,W,1*00\r\n".to_owned(),
        good.clone(),
        good.replace("5311", "5312"),
        sentence("GPRMC,120000.00,A,5312.00000,N,00030.00000,W,0.1,,010126,,,A"),
        sentence("GPGGA,120000.20,,,,,0,00,,,M,,M,,"),
    ]
    .concat();
    for piece in 1..40 {
        let mut sentences = Sentences::default();
        let positions: Vec<Geodetic> = text.as_bytes().chunks(piece).flat_map(|bytes| sentences.take(bytes)).collect();
        assert_eq!(positions.len(), 1, "pieces of {piece}");
        let at = positions[0].east_north_m(origin);
        // 1e-6 minutes of arc are 2 mm.
        assert!(distance_m(at, [100.0, -200.0]) < 0.005, "{at:?}");
    }
}

/// Expected errors need no readings: they follow from the places and times of a path. Rows that columns cross leave at
/// least a tenth less than rows alone.
#[test]
fn paths_that_come_back_tell_place_from_time() {
    use r4_maps::process::Process;
    let side_m = scene::PLOT.side_m;
    let path = |strategy| {
        let ends = survey::ends_m(strategy, side_m);
        let mut samples = Vec::new();
        let (mut since_s, mut left_s) = (0.0, 0.0);
        for leg in ends.windows(2) {
            let (length_m, speed_m_s) = (distance_m(leg[0], leg[1]), survey::limits().speed_m_s);
            while left_s * speed_m_s < length_m {
                let share = left_s * speed_m_s / length_m;
                let at = [0, 1].map(|axis| leg[0][axis] + share * (leg[1][axis] - leg[0][axis]));
                samples.push(Sample { at, at_s: since_s + left_s, value: 0.0 });
                left_s += survey::PERIOD_S;
            }
            since_s += length_m / speed_m_s;
            left_s -= length_m / speed_m_s;
        }
        samples
    };
    let deviation = |samples: &[Sample], places: &[[f64; 2]]| {
        let process = Process::of(survey::EXPECTED, samples).expect("a kernel");
        (process.pattern_covariance(places).trace() / places.len() as f64).sqrt()
    };
    let cells: Vec<[f64; 2]> =
        (0..100).map(|cell| [cell % 10, cell / 10].map(|number| (f64::from(number) + 0.5) * side_m / 10.0)).collect();
    let [crossing, rows] =
        [survey::Strategy::Crossing, survey::Strategy::LawnMower].map(|of| deviation(&path(of), &cells));
    assert!(crossing < 0.9 * rows, "{crossing} {rows} V/m");
    // The first lap, three and all of them: three cannot leave half of the first lap's error, since 1/√3 is 0.58.
    let laps = path(survey::Strategy::Loop);
    let lap = laps.len() / survey::LAPS;
    let along: Vec<[f64; 2]> = laps[..lap].iter().step_by(4).map(|sample| sample.at).collect();
    let [one, three, all] = [lap, 3 * lap, laps.len()].map(|count| deviation(&laps[..count], &along));
    assert!(three > 0.5 * one && all < 0.5 * one, "{one} {three} {all} V/m");
}

#[test]
fn means_of_cells_take_the_nearest_where_nothing_was_read() {
    let frame = Frame::new(Pose::default(), 2.0, 4, 1).expect("a grid");
    let sample = |x_m: f64, value: f64| Sample { at: [x_m, 1.0], at_s: 0.0, value };
    let map = map::per_cell(frame, &[sample(0.5, 1.0), sample(1.5, 3.0), sample(7.0, 10.0)], 2.0);
    assert_eq!(map.values(), &[2.0, 2.0, 10.0, 10.0]);
}

/// Samples wait while the link is down, and each reaches the base once.
#[test]
fn nothing_is_lost_by_links_that_come_and_go() {
    use crate::rover::Program;
    let base = Base::new(&scene::OPEN, 2).expect("a base");
    let mut members: Vec<Member> = (0..2).map(|number| Member::new(base.clone(), number, 5, SOUND)).collect();
    let mut waited = 0;
    for step in 0..6000 {
        let time_s = f64::from(step);
        for (number, member) in members.iter_mut().enumerate() {
            let at = Place { x_m: 10.0 * number as f64 + time_s / 10.0, y_m: 500.0, yaw_rad: 0.0 };
            member.sense(time_s, at, 2.9);
            waited = waited.max(member.waiting());
        }
    }
    // 6000 s in readings of 30 s from each robot, the last of which may wait.
    let arrived = base.borrow().samples().len();
    let still = members.iter().map(Member::waiting).sum::<usize>();
    assert!(waited > 1, "a link was down for longer than a reading");
    assert_eq!(arrived + still, 2 * 199, "{arrived} arrived, {still} wait");
}

/// Laps through the plates on a board, with each effect in turn and without one.
#[test]
fn each_hidden_effect_is_named_and_a_clean_mill_has_none() {
    for (arm, expected) in [(FORM, 1.0), (CHARGE, 1.0), (LAG, 1.0)] {
        let values = Fieldmap.run(&trial(arm, 2)).expect("laps");
        assert_eq!(values["effect_named"], expected, "{arm}: {values:?}");
        assert!(
            values["size_error"] < 0.2 && values["held_out_after"] < values["held_out_before"],
            "{arm}: {values:?}"
        );
    }
    let values = Fieldmap.run(&trial(CLEAN, 2)).expect("laps");
    assert_eq!(values["effect_claimed"], 0.0, "{values:?}");
}

/// The same trial gives the same readings, bit for bit.
#[test]
fn a_survey_repeats_itself() {
    let scene = Scene::of(2, PLOT).expect("a scene");
    let run = || {
        let surveyed = surveyed(&trial(PRINTED, 2), &scene, SOUND, Vec::new()).expect("a survey");
        readings(&surveyed.taken, &SOUND)
    };
    assert_eq!(run(), run());
}

/// At full speed in the fastest turn no wheel is asked for more than its motor takes.
#[test]
fn the_swarm_turns_within_what_its_wheels_take() {
    let robot = r4_boards::load("field-rover").expect("built in");
    let Some(Drive::SkidSteer(drive)) = robot.drive else { panic!("wheels on two sides") };
    // A faster one would be slowed down on the way, and the times that the planner reckons with would be wrong.
    let Limits { speed_m_s, turn_rate_rad_s, .. } = swarm::speeds();
    let outer_rad_s = (speed_m_s + turn_rate_rad_s * drive.track_m / 2.0) / drive.wheel_radius_m;
    assert!(outer_rad_s <= drive.wheel_speed_max_rad_s, "{outer_rad_s} of {} rad/s", drive.wheel_speed_max_rad_s);
}
