//! Potential gradient over open ground: fixed space charges, and clouds that drift and change.

use super::{FieldError, ou::Wander};
use crate::{
    dice::Dice,
    scene::{Point, dot, minus, plus},
};

/// Step of the time-varying part, s. Linear interpolation between steps removes at most 5 % of the variance of a
/// process with the shortest time allowed, and 0.5 % at 5 s.
const STEP_S: f64 = 0.1;

/// Space charge with a Gaussian field around its centre.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Charge {
    /// Centre at time 0, m.
    pub place_m: Point,
    /// Standard deviation of the Gaussian, m.
    pub size_m: f64,
    /// Field in the centre, V/m.
    pub peak_v_per_m: f64,
}

/// Gaussian part that moves with the wind and whose peak varies randomly.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cloud {
    /// Centre at time 0 and size; `peak_v_per_m` is the mean of the peak.
    pub charge: Charge,
    /// Velocity of the centre, m/s.
    pub velocity_m_s: Point,
    /// Random variation of the peak about its mean, V/m.
    pub wander: Wander,
}

/// Components of an electric field.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ElectricSpec {
    /// Uniform part, V/m: 100 in fair weather.
    pub uniform_v_per_m: f64,
    /// Charges that stay in place.
    pub charges: Vec<Charge>,
    /// Clouds that move with the wind.
    pub clouds: Vec<Cloud>,
    /// Random variation of the whole field at once, V/m.
    pub drift: Wander,
    /// Seed of all random variations.
    pub seed: u64,
}

/// Vertical potential gradient, V/m, with its state.
#[derive(Clone, Debug, PartialEq)]
pub struct Electric {
    spec: ElectricSpec,
    dice: Dice,
    steps: u64,
    /// Values of the drift and of each cloud's variation, V/m: at the last step, and at the next one.
    wandering: Vec<[f64; 2]>,
}

impl Electric {
    /// The field at time 0.
    ///
    /// # Errors
    /// [`FieldError::Number`] for a size of 0, a number that is not finite or a time constant below 0.5 s.
    pub fn new(spec: ElectricSpec) -> Result<Self, FieldError> {
        let is_charge = |charge: &Charge| {
            charge.size_m > 0.0
                && [charge.size_m, charge.peak_v_per_m].into_iter().chain(charge.place_m).all(f64::is_finite)
        };
        if !spec.uniform_v_per_m.is_finite() || !spec.charges.iter().all(is_charge) {
            return Err(FieldError::Number {
                what: "charges",
                rule: "need finite numbers and `size_m` above 0; so does `uniform_v_per_m`",
            });
        }
        let is_cloud = |cloud: &Cloud| {
            is_charge(&cloud.charge)
                && cloud.velocity_m_s.into_iter().all(f64::is_finite)
                && cloud.wander.is_valid(STEP_S)
        };
        if !spec.clouds.iter().all(is_cloud) || !spec.drift.is_valid(STEP_S) {
            return Err(FieldError::Number {
                what: "clouds",
                rule: "need finite numbers, `size_m` above 0 and `tau_s` of 0.5 or more; so does `drift`",
            });
        }
        let mut dice = Dice::new(spec.seed);
        let pair = |wander: Wander, dice: &mut Dice| {
            let first = wander.first(dice);
            [first, wander.next(first, STEP_S, dice)]
        };
        let mut wandering = vec![pair(spec.drift, &mut dice)];
        wandering.extend(spec.clouds.iter().map(|cloud| pair(cloud.wander, &mut dice)));
        Ok(Self { spec, dice, steps: 0, wandering })
    }

    /// Components the field was made of.
    #[must_use]
    pub const fn spec(&self) -> &ElectricSpec {
        &self.spec
    }

    /// The part constant in time, V/m, which maps are scored against.
    #[must_use]
    pub fn steady(&self, point: Point) -> f64 {
        let charges = self.spec.charges.iter();
        self.spec.uniform_v_per_m
            + charges.map(|charge| charge.peak_v_per_m * bell(point, charge.place_m, charge.size_m)).sum::<f64>()
    }

    pub(super) fn value(&mut self, time_s: f64, point: Point) -> f64 {
        while (self.steps + 1) as f64 * STEP_S <= time_s {
            self.steps += 1;
            let wanders = std::iter::once(self.spec.drift).chain(self.spec.clouds.iter().map(|cloud| cloud.wander));
            for (pair, wander) in self.wandering.iter_mut().zip(wanders) {
                *pair = [pair[1], wander.next(pair[1], STEP_S, &mut self.dice)];
            }
        }
        let share = (time_s / STEP_S - self.steps as f64).clamp(0.0, 1.0);
        let mut now = self.wandering.iter().map(|[from, to]| from + share * (to - from));
        let drift = now.next().unwrap_or_default();
        let clouds = self.spec.clouds.iter().zip(now).map(|(cloud, wandered)| {
            let centre = plus(cloud.charge.place_m, cloud.velocity_m_s, time_s);
            (cloud.charge.peak_v_per_m + wandered) * bell(point, centre, cloud.charge.size_m)
        });
        self.steady(point) + drift + clouds.sum::<f64>()
    }
}

fn bell(point: Point, centre: Point, size_m: f64) -> f64 {
    let way = minus(point, centre);
    libm::exp(-0.5 * dot(way, way) / (size_m * size_m))
}
