//! Body for a simulated board from a fitted skid-steered robot.
//!
//! | identified effect | place in the body |
//! | --- | --- |
//! | `slip-longitudinal`, `encoder-scale` | radii of the wheels |
//! | `slip-lateral` | positions of the wheels along the body |
//! | all slip of the yaw rate | `compliance_lat_per_n`: the body turns as the fitted model does, at the speeds of the recordings |
//! | lags, delays, limits of the drives; sensors | none: they belong to the motors' plants and to the recording |
//!
//! The yaw rate of wheels that slip depends on the ratio of the tyres' compliances, and hardly on the compliances
//! themselves. The longitudinal one therefore keeps its known value; if that is wrong, the body's steady turning is
//! right, but its transients differ from the robot's. The ratio is found by simulating the body (`r4_world`) with
//! several lateral compliances.

use r4_world::{Body as _, Chassis, ChassisError, MAX_STEP_S, Scene, ShaftMotion, Tyre, Wheel, Wheeled};

use super::{
    Geometry, Output, SkidRun, SkidSteer,
    effect::{Effect, Scales},
    simulate::settles_at,
};
use crate::family::{FittedBody, Structure, Term};

/// Share of the usual turning rate below which a sample contains little information on slip.
const TURNS: f64 = 0.2;
/// Largest number of speeds at which body and model are compared.
const COMPARED: usize = 9;
/// Range of the ratio of lateral to longitudinal compliance, as powers of ten, from the stiffest to the softest tyre
/// tried. Measured tyres have 0.1 to 10.
const RATIOS: [f64; 2] = [-2.0, 3.0];
/// Number of intervals that the range of ratios is divided into, and of golden section steps in the best: to 1e-4 of
/// a power of ten.
const INTERVALS: u32 = 10;
const HALVINGS: u32 = 24;
/// Longest time that a body takes to turn steadily, s: ten times the time in which a wheel at 0.1 m/s rolls 30 mm.
const SETTLES_S: f64 = 3.0;
/// Assumed mass of a robot of which only the wheels are known, kg.
const ASSUMED_MASS_KG: f64 = 10.0;

/// Returns speeds of the sides at which a robot turned, from its fastest right turn to its fastest left one, rad/s.
pub(super) fn turns(geometry: &Geometry, scales: &Scales, runs: &[SkidRun]) -> Vec<(f64, f64)> {
    let sides = runs.iter().flat_map(|run| run.sides.left.iter().copied().zip(run.sides.right.iter().copied()));
    let mut turns: Vec<(f64, f64)> =
        sides.filter(|(left, right)| geometry.turn(*left, *right).abs() >= TURNS * scales.turn).collect();
    turns.sort_by(|a, b| geometry.turn(a.0, a.1).total_cmp(&geometry.turn(b.0, b.1)));
    if turns.len() <= COMPARED {
        return turns;
    }
    // One speed from the middle of each of equal parts: the ends of the range are outliers.
    (0..COMPARED).map(|part| turns[(2 * part + 1) * turns.len() / (2 * COMPARED)]).collect()
}

/// Returns the place of an effect that no body has; `None` for an effect that is in the body.
fn elsewhere(effect: Effect) -> Option<&'static str> {
    const DRIVES: &str = "of the drives: fit the motors' plants";
    const SENSORS: &str = "of what recorded the motion, not of the robot";
    const TYRES: &str = "in the tyres as far as these can: the body turns as the model does on average";
    const NOWHERE: &str = "no tyre has it";
    match effect {
        Effect::Track | Effect::Longitudinal | Effect::Lateral | Effect::EncoderScale => None,
        Effect::Turning | Effect::Driving | Effect::StandingSide | Effect::FrictionLimit | Effect::RateLimit => {
            Some(TYRES)
        }
        Effect::TurnDirection | Effect::TravelDirection | Effect::Drift | Effect::LongitudinalTurning => Some(NOWHERE),
        Effect::DeadZone
        | Effect::WheelSaturation
        | Effect::SlewLimit
        | Effect::DriveLag
        | Effect::DriveLagSides
        | Effect::InputDelay => Some(DRIVES),
        Effect::EncoderDelay | Effect::SensorLag | Effect::SensorOffset => Some(SENSORS),
    }
}

/// Returns a robot on four wheels from the wheels' radius and the track.
pub(super) fn assumed(geometry: &Geometry) -> Result<Wheeled, ChassisError> {
    let Geometry { wheel_radius_m, track_m } = *geometry;
    let half_m = 0.5 * track_m;
    let tyre = Tyre { relaxation_m: 0.5 * wheel_radius_m, ..Tyre::TYPICAL };
    let wheel = |(shaft, place): (usize, [f64; 2])| Wheel {
        place_m: place.map(|side| side * half_m),
        radius_m: wheel_radius_m,
        shaft: Some(shaft),
        inverted: false,
        steered: false,
        tyre: Some(tyre),
    };
    let places = [[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]];
    // Inertia of a square plate, which has its corners on the wheels.
    let inertia_kg_m2 = ASSUMED_MASS_KG * track_m * track_m / 6.0;
    let chassis = Chassis { mass_kg: ASSUMED_MASS_KG, inertia_kg_m2, centre_m: [0.0; 2], height_m: 0.0 };
    Wheeled::new(chassis, places.into_iter().enumerate().map(wheel).collect(), None, 4)
}

/// Returns the steady yaw rate of a body, rad/s, for constant speeds of its sides' wheels, rad/s.
fn turns_at(body: &Wheeled, (left, right): (f64, f64)) -> f64 {
    let mut shafts = vec![ShaftMotion::default(); body.shafts()];
    for wheel in body.wheels() {
        if let Some(shaft) = wheel.shaft.and_then(|shaft| shafts.get_mut(shaft)) {
            let speed = if wheel.place_m[1] > 0.0 { left } else { right };
            shaft.speed = if wheel.inverted { -speed } else { speed };
        }
    }
    let mut body = body.clone();
    let mut loads = vec![0.0; shafts.len()];
    let mut scene = Scene::default();
    let mut before = f64::NAN;
    for step in 1..=(SETTLES_S / MAX_STEP_S) as usize {
        body.step(&mut scene, 0.0, &shafts, &mut loads, MAX_STEP_S);
        // A yaw rate that changes by less than 1e-6 in 50 ms has settled.
        if step.is_multiple_of(200) {
            let now = body.twist().yaw_rad_s;
            if (now - before).abs() <= 1e-6 * now.abs() {
                break;
            }
            before = now;
        }
    }
    body.twist().yaw_rad_s
}

/// Returns the body with this ratio of lateral to longitudinal compliance in every tyre.
fn with_ratio(body: &Wheeled, ratio: f64) -> Result<Wheeled, ChassisError> {
    body.changed(|_, wheels| {
        for tyre in wheels.iter_mut().filter_map(|wheel| wheel.tyre.as_mut()) {
            tyre.compliance_per_n[1] = ratio * tyre.compliance_per_n[0];
        }
    })
}

impl SkidSteer {
    /// Returns the robot's body with the identified effects.
    pub(super) fn fitted_body(&self, structure: &Structure, source: &str) -> FittedBody {
        let Geometry { wheel_radius_m, track_m } = self.geometry;
        let mut provenance = vec![source.to_owned()];
        let mut left_out = Vec::new();
        let mut found = |name: &str, place| left_out.push((name.to_owned(), place));
        let value = |effect: Effect| {
            let index = self.effects.iter().position(|known| *known == effect)?;
            structure.of(index).and_then(|values| values.first().copied())
        };
        // Effects that no body has are listed, so that a user knows where they belong.
        for term in &structure.terms {
            match term {
                Term::Known(index) => {
                    if let Some(place) = elsewhere(self.effects[*index]) {
                        found(self.effects[*index].name(), place);
                    }
                }
                Term::Curve(curve) => found(
                    &format!("a curve over {}", curve.over.name()),
                    "in the tyres as far as these can: the body turns as the model does on average",
                ),
            }
        }
        provenance.push(if self.is_body_known {
            "What is not named here is as it was known before.".to_owned()
        } else {
            format!(
                "Assumed, not fitted: {ASSUMED_MASS_KG} kg in a square plate on four wheels, as far apart along as across \
                 ({track_m:?} m), on the channels of openscout; tyres but for their lateral compliance. --board or --body \
                 names a robot whose own body is kept instead."
            )
        });
        let scale = value(Effect::Longitudinal).unwrap_or(1.0);
        let right_over_left = value(Effect::EncoderScale).unwrap_or(1.0);
        provenance.push(format!(
            "radius_m: declared {wheel_radius_m:?} m; times {scale:?} (slip-longitudinal); right over left {right_over_left:?} \
             (encoder-scale)"
        ));
        let shift_m = value(Effect::Lateral).unwrap_or(0.0);
        if shift_m != 0.0 {
            provenance.push(format!("place_m: moved along by {shift_m:?} m (slip-lateral)"));
        }
        // Centre of mass and wheels move together relative to the pose's point.
        let moved = self.body.changed(|chassis, wheels| {
            chassis.centre_m[0] += shift_m;
            for wheel in wheels {
                let side = if wheel.place_m[1] > 0.0 { right_over_left.sqrt().recip() } else { right_over_left.sqrt() };
                wheel.radius_m = wheel_radius_m * scale * side;
                wheel.place_m[0] += shift_m;
            }
        });
        let body = moved.unwrap_or_else(|why| {
            provenance.push(format!("The body is as it was: no chassis has these numbers: {why}."));
            self.body.clone()
        });
        let wheeled =
            if self.output == Output::YawRate { self.turning(body, structure, &mut provenance) } else { body };
        FittedBody { wheeled, provenance, left_out }
    }

    /// Returns the body with tyres by which it turns as the model does.
    fn turning(&self, body: Wheeled, structure: &Structure, provenance: &mut Vec<String>) -> Wheeled {
        let wanted: Vec<f64> =
            self.turns.iter().map(|&(left, right)| settles_at(self, structure, left, right)).collect();
        let off = |body: &Wheeled| {
            let squares =
                self.turns.iter().zip(&wanted).map(|(&sides, wanted)| (turns_at(body, sides) - wanted).powi(2));
            (squares.sum::<f64>() / wanted.len().max(1) as f64).sqrt()
        };
        let of = |power: f64| with_ratio(&body, 10f64.powf(power)).map_or(f64::INFINITY, |body| off(&body));
        let width = (RATIOS[1] - RATIOS[0]) / f64::from(INTERVALS);
        let powers = (0..=INTERVALS).map(|at| RATIOS[0] + width * f64::from(at));
        let Some((best, _)) = powers.map(|power| (power, of(power))).min_by(|a, b| a.1.total_cmp(&b.1)) else {
            return body;
        };
        // Golden section search in the two intervals around the best ratio.
        let golden = 0.5 * (5f64.sqrt() - 1.0);
        let (mut low, mut high) = ((best - width).max(RATIOS[0]), (best + width).min(RATIOS[1]));
        let (mut a, mut b) = (high - golden * (high - low), low + golden * (high - low));
        let (mut at_a, mut at_b) = (of(a), of(b));
        for _ in 0..HALVINGS {
            if at_a < at_b {
                (high, b, at_b) = (b, a, at_a);
                a = high - golden * (high - low);
                at_a = of(a);
            } else {
                (low, a, at_a) = (a, b, at_b);
                b = low + golden * (high - low);
                at_b = of(b);
            }
        }
        let ratio = 10f64.powf(0.5 * (low + high));
        let Ok(tyred) = with_ratio(&body, ratio) else { return body };
        provenance.push(format!(
            "compliance_lat_per_n: {ratio:.4} times compliance_long_per_n, with which the body turns as the fitted model does to \
             {:.2e} rad/s (RMSE, at {} speeds of the recordings)",
            off(&tyred),
            wanted.len()
        ));
        tyred
    }
}
