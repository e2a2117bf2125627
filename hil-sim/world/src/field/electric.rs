//! The potential gradient over open ground: space charges that stay, and clouds that drift and change.

use super::{FieldError, ou::Wander};
use crate::{
    dice::Dice,
    scene::{Point, dot, minus, plus},
};

/// Step of the time-varying part, s. Between steps it is a straight line, which takes at most 5 % of the variance of a process of
/// the shortest time allowed, and 0.5 % of one of 5 s.
const STEP_S: f64 = 0.1;

/// A Gaussian part of the field.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Charge {
    /// Its centre at time 0, m.
    pub place_m: Point,
    /// Standard deviation of the Gaussian, m.
    pub size_m: f64,
    /// Field in its centre, V/m.
    pub peak_v_per_m: f64,
}

/// A Gaussian part that moves with the wind and whose peak wanders.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cloud {
    /// Its centre at time 0 and its size; `peak_v_per_m` is the mean of its peak.
    pub charge: Charge,
    /// m/s
    pub velocity_m_s: Point,
    /// How its peak wanders about the mean, V/m.
    pub wander: Wander,
}

/// All that makes an electric field.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ElectricSpec {
    /// Everywhere, V/m: 100 in fair weather.
    pub uniform_v_per_m: f64,
    /// What stays.
    pub charges: Vec<Charge>,
    /// What passes.
    pub clouds: Vec<Cloud>,
    /// How the field wanders everywhere at once, V/m.
    pub drift: Wander,
    /// Of everything that wanders.
    pub seed: u64,
}

/// Vertical potential gradient, V/m.
#[derive(Clone, Debug, PartialEq)]
pub struct Electric {
    spec: ElectricSpec,
    dice: Dice,
    steps: u64,
    /// Of the drift and each cloud: at the last step, and at the next one.
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

    /// What it was made of.
    #[must_use]
    pub const fn spec(&self) -> &ElectricSpec {
        &self.spec
    }

    /// The part that does not change with time, V/m: what a map is scored against.
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
