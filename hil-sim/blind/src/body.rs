//! Hides a changed parameter in a robot's body.
//!
//! A parameter of `[body.wheeled]` may differ from the robot's file. The inertia of a wheel is not among them: it
//! belongs to the wheel's plant. Nor is the scale of a gyroscope: no body has one.

use r4_plants::Dependence;
use r4_world::{Body as _, Chassis, MAX_STEP_S, Scene, ShaftMotion, Wheel, Wheeled};

use crate::{Truth, Value, dice::Dice};

/// Change of a body's parameters, with its values.
type Change = Box<dyn Fn(&mut Chassis, &mut [Wheel])>;

/// One parameter change that can be hidden in a body.
pub(crate) struct Candidate {
    pub(crate) name: &'static str,
    depends_on: &'static [Dependence],
    /// Other candidates that have a similar influence on a drive's path.
    rivals: &'static [&'static str],
    draw: fn(&mut Dice, &Wheeled) -> (Vec<Value>, Change),
}

fn value(name: &'static str, value: f64, unit: &'static str) -> Value {
    Value { name, value, unit }
}

/// Creates a change that applies equally to all tyres.
fn of_tyres(change: impl Fn(&mut r4_world::Tyre) + 'static) -> Change {
    Box::new(move |_, wheels| wheels.iter_mut().filter_map(|wheel| wheel.tyre.as_mut()).for_each(&change))
}

/// All parameter changes that can be hidden.
pub(crate) const CANDIDATES: &[Candidate] = &[
    Candidate {
        name: "wheel-radius",
        depends_on: &[Dependence::Speed],
        rivals: &[],
        draw: |dice, body| {
            let wheel = dice.below(body.wheels().len());
            let factor = if dice.share() < 0.5 { dice.between(0.75, 0.92) } else { dice.between(1.08, 1.25) };
            let numbers = vec![value("wheel", wheel as f64, "1"), value("factor", factor, "1")];
            (numbers, Box::new(move |_, wheels| wheels[wheel].radius_m *= factor))
        },
    },
    Candidate {
        name: "lateral-compliance",
        depends_on: &[Dependence::Input],
        rivals: &["longitudinal-compliance"],
        draw: |dice, _| {
            let factor = if dice.share() < 0.5 { dice.ratio_between(0.2, 0.6) } else { dice.ratio_between(2.0, 6.0) };
            (vec![value("factor", factor, "1")], of_tyres(move |tyre| tyre.compliance_per_n[1] *= factor))
        },
    },
    Candidate {
        name: "longitudinal-compliance",
        depends_on: &[Dependence::Input],
        rivals: &["lateral-compliance"],
        draw: |dice, _| {
            let factor = if dice.share() < 0.5 { dice.ratio_between(0.2, 0.6) } else { dice.ratio_between(2.0, 6.0) };
            (vec![value("factor", factor, "1")], of_tyres(move |tyre| tyre.compliance_per_n[0] *= factor))
        },
    },
    Candidate {
        name: "slippery-axle",
        depends_on: &[Dependence::Input],
        rivals: &[],
        draw: |dice, body| {
            let along_m = body.wheels()[dice.below(body.wheels().len())].place_m[0];
            let factor = dice.ratio_between(0.05, 0.3);
            let numbers = vec![value("place_m", along_m, "m"), value("factor", factor, "1")];
            let change = move |_: &mut Chassis, wheels: &mut [Wheel]| {
                let axle = wheels.iter_mut().filter(|wheel| wheel.place_m[0] == along_m);
                axle.filter_map(|wheel| wheel.tyre.as_mut()).for_each(|tyre| tyre.friction *= factor);
            };
            (numbers, Box::new(change))
        },
    },
    Candidate {
        name: "centre-of-mass",
        depends_on: &[Dependence::Input],
        rivals: &[],
        draw: |dice, body| {
            let reach_m = body.wheels().iter().map(|wheel| wheel.place_m[0].abs()).fold(0.0, f64::max);
            let along_m = dice.sign() * dice.between(0.5, 0.9) * reach_m;
            (vec![value("along_m", along_m, "m")], Box::new(move |chassis, _| chassis.centre_m[0] += along_m))
        },
    },
    Candidate {
        name: "relaxation",
        depends_on: &[Dependence::History],
        rivals: &[],
        draw: |dice, _| {
            let factor = dice.ratio_between(4.0, 12.0);
            (vec![value("factor", factor, "1")], of_tyres(move |tyre| tyre.relaxation_m *= factor))
        },
    },
];

/// Returns true if a seed hides something in the body, for a robot that has one; otherwise it is hidden in its motors.
#[must_use]
pub fn is_in_body(seed: u64) -> bool {
    Dice::new(seed, 5).share() < 0.5
}

/// Hides a change of one of the body's parameters, large enough to be detectable: a drive of 8 s with equal wheel
/// speeds differs by 9.5 % of its speeds. Parameter and size are sampled from the seed. The returned body is at rest in
/// the same place; if no candidate is detectable, nothing is hidden.
#[must_use]
pub fn hide_in_body(body: &Wheeled, seed: u64) -> (Wheeled, Option<Truth>) {
    let mut dice = Dice::new(seed, 6);
    if body.wheels().iter().any(|wheel| wheel.shaft.is_some()) {
        let speeds = Drive::new(&mut dice, body);
        // All candidates are compared on the same drive.
        let usual = speeds.of(body);
        for _ in 0..TRIES {
            let candidate = &CANDIDATES[dice.below(CANDIDATES.len())];
            let (parameters, change) = (candidate.draw)(&mut dice, body);
            let Ok(hidden) = body.changed(|chassis, wheels| change(chassis, wheels)) else { continue };
            if differs(&speeds.of(&hidden), &usual) >= SHOWS {
                let Candidate { name, depends_on, rivals, .. } = *candidate;
                return (hidden, Some(Truth { name, parameters, depends_on, listed: true, rivals }));
            }
        }
    }
    (body.clone(), None)
}

/// Maximum number of samples before nothing is hidden.
const TRIES: usize = 40;
/// Length of the drive, s.
const DURATION_S: f64 = 8.0;
/// Number of speed changes of the wheels during the drive.
const LEGS: usize = 8;
/// Steps of a body between two samples of its speeds.
const SAMPLE_STEPS: usize = 40;
/// Rim speed of the fastest wheel, m/s: a slow walk.
const RIM_M_S: f64 = 0.5;
/// Difference by which a drive counts as changed, as a share of the speeds: three times the noise, which is 30 dB below
/// them.
const SHOWS: f64 = 0.095;

/// Drive given by the speeds of both sides.
struct Drive {
    /// Rim speeds of left and right side in each leg, m/s.
    legs: Vec<[f64; 2]>,
    radius_m: f64,
}

impl Drive {
    fn new(dice: &mut Dice, body: &Wheeled) -> Self {
        let mut side = || RIM_M_S * dice.between(-1.0, 1.0);
        let radii = body.wheels().iter().filter(|wheel| wheel.shaft.is_some()).map(|wheel| wheel.radius_m);
        Self { legs: (0..LEGS).map(|_| [side(), side()]).collect(), radius_m: radii.fold(1e-3, f64::max) }
    }

    /// Forward speed, speed to the left, and the turning speed of a point half a metre ahead, m/s, every 10 ms.
    fn of(&self, body: &Wheeled) -> Vec<[f64; 3]> {
        let mut body = body.clone();
        let mut shafts = vec![ShaftMotion::default(); body.shafts()];
        let mut loads = vec![0.0; shafts.len()];
        // The steering stays straight; only the wheels' speeds are prescribed.
        if let Some(axle) = body.axle() {
            shafts[axle.shaft].position = axle.straight;
        }
        let mut scene = Scene::default();
        let steps = (DURATION_S / LEGS as f64 / MAX_STEP_S) as usize;
        let mut speeds = Vec::new();
        for leg in &self.legs {
            for wheel in body.wheels() {
                if let Some(shaft) = wheel.shaft.and_then(|shaft| shafts.get_mut(shaft)) {
                    let rim_m_s = if wheel.place_m[1] > 0.0 { leg[0] } else { leg[1] };
                    shaft.speed = rim_m_s / self.radius_m * if wheel.inverted { -1.0 } else { 1.0 };
                }
            }
            for step in 0..steps {
                body.step(&mut scene, 0.0, &shafts, &mut loads, MAX_STEP_S);
                if step.is_multiple_of(SAMPLE_STEPS) {
                    let twist = body.twist();
                    speeds.push([twist.forward_m_s, twist.left_m_s, 0.5 * twist.yaw_rad_s]);
                }
            }
        }
        speeds
    }
}

/// RMS of the difference of two drives relative to the RMS of the second; 0 where that is not finite.
fn differs(speeds: &[[f64; 3]], usual: &[[f64; 3]]) -> f64 {
    let square = |values: &[f64; 3]| values.iter().map(|value| value * value).sum::<f64>();
    let apart: f64 = speeds.iter().zip(usual).map(|(a, b)| square(&[a[0] - b[0], a[1] - b[1], a[2] - b[2]])).sum();
    let size: f64 = usual.iter().map(square).sum();
    let share = libm::sqrt(apart / size);
    if share.is_finite() { share } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use r4_world::Tyre;

    use super::*;

    /// Body with four wheels, like that of OpenScout.
    fn robot() -> Wheeled {
        let places = [[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]];
        let wheel = |(shaft, [x, y]): (usize, [f64; 2])| Wheel {
            place_m: [0.12 * x, 0.151 * y],
            radius_m: 0.056,
            shaft: Some(shaft),
            inverted: false,
            steered: false,
            tyre: Some(Tyre::TYPICAL),
        };
        let chassis = Chassis { mass_kg: 9.0, inertia_kg_m2: 0.18, centre_m: [0.0; 2], height_m: 0.08 };
        Wheeled::new(chassis, places.into_iter().enumerate().map(wheel).collect(), None, 4).unwrap()
    }

    #[test]
    fn every_candidate_is_hidden_by_some_seed_and_is_what_it_says() {
        let body = robot();
        let mut found: BTreeMap<&str, usize> = BTreeMap::new();
        for seed in 0..60 {
            let (hidden, truth) = hide_in_body(&body, seed);
            let (again, told) = hide_in_body(&body, seed);
            assert_eq!((&hidden, &truth), (&again, &told), "{seed}");
            let truth = truth.unwrap();
            let number = |name: &str| truth.parameters.iter().find(|value| value.name == name).unwrap().value;
            let tyres = |body: &Wheeled| body.wheels()[0].tyre.unwrap();
            match truth.name {
                "wheel-radius" => {
                    let wheel = number("wheel") as usize;
                    assert_eq!(hidden.wheels()[wheel].radius_m, 0.056 * number("factor"));
                }
                "lateral-compliance" => {
                    assert_eq!(tyres(&hidden).compliance_per_n[1], 0.02 * number("factor"));
                }
                "longitudinal-compliance" => {
                    assert_eq!(tyres(&hidden).compliance_per_n[0], 0.005 * number("factor"));
                }
                "slippery-axle" => {
                    let slippery = hidden.wheels().iter().filter(|wheel| wheel.tyre.unwrap().friction < 0.8);
                    assert!(slippery.clone().all(|wheel| wheel.place_m[0] == number("place_m")));
                    assert_eq!(slippery.count(), 2);
                }
                "centre-of-mass" => assert_eq!(hidden.chassis().centre_m, [number("along_m"), 0.0]),
                "relaxation" => assert_eq!(tyres(&hidden).relaxation_m, 0.03 * number("factor")),
                other => panic!("{other}"),
            }
            *found.entry(truth.name).or_default() += 1;
        }
        for candidate in CANDIDATES {
            assert!(found.contains_key(candidate.name), "{} is never hidden: {found:?}", candidate.name);
        }
    }

    #[test]
    fn nothing_is_hidden_where_nothing_drives() {
        let free = robot().changed(|_, wheels| wheels.iter_mut().for_each(|wheel| wheel.shaft = None)).unwrap();
        assert_eq!(hide_in_body(&free, 1), (free.clone(), None));
    }

    #[test]
    fn seeds_hide_in_the_body_about_as_often_as_in_the_motors() {
        let in_body = (0..1000).filter(|seed| is_in_body(*seed)).count();
        // Six standard deviations of a fair coin, 16.
        assert!((405..595).contains(&in_body), "{in_body}");
    }
}
