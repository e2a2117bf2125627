//! Recordings for tests: a motor under steps, ramps, sines and rests, with noise or counts.

use rand_distr::{Distribution, Normal};
use rand_pcg::{
    Pcg64Mcg,
    rand_core::{Rng, SeedableRng},
};

use super::{Quantity, Run, Signal};

/// Recording of a first-order motor: 12 s at 200 Hz.
pub(super) struct Motor {
    pub(super) duty: Vec<f64>,
    pub(super) speed: Vec<f64>,
    pub(super) angle: Vec<f64>,
}

pub(super) const PERIOD_S: f64 = 0.005;
pub(super) const SAMPLES: usize = 2400;

pub(super) fn dice(seed: u64) -> Pcg64Mcg {
    Pcg64Mcg::seed_from_u64(seed)
}

/// Returns a number from 0 (included) to 1 (excluded).
pub(super) fn uniform(dice: &mut Pcg64Mcg) -> f64 {
    (dice.next_u64() >> 11) as f64 / (1_u64 << 53) as f64
}

/// Returns steps, ramps, sines and rests of half a second to two seconds.
pub(super) fn duties(dice: &mut Pcg64Mcg) -> Vec<f64> {
    let mut duty: Vec<f64> = Vec::new();
    while duty.len() < SAMPLES {
        let samples = (100.0 + 300.0 * uniform(dice)) as usize;
        let (size, kind) = (1.8 * uniform(dice) - 0.9, dice.next_u64() % 4);
        let rate = 2.0 + 15.0 * uniform(dice);
        duty.extend((0..samples).map(|at| match kind {
            0 => size,
            1 => size * at as f64 / samples as f64,
            2 => size * (rate * PERIOD_S * at as f64).sin(),
            _ => 0.0,
        }));
    }
    duty.truncate(SAMPLES);
    duty
}

/// Simulates a motor with random parameters, between end stops at `stops` (rad) if there are any.
pub(super) fn motor(seed: u64, stops: Option<[f64; 2]>) -> Motor {
    let mut dice = dice(seed);
    let duty = duties(&mut dice);
    let time_constant_s = 0.02 + 0.15 * uniform(&mut dice);
    let (gain, friction) = (5.0 + 25.0 * uniform(&mut dice), 0.1 * uniform(&mut dice));
    let (mut speed, mut angle) = (0.0_f64, 0.0_f64);
    let (mut speeds, mut angles) = (Vec::new(), Vec::new());
    let parts = 10;
    let step_s = PERIOD_S / f64::from(parts);
    for &duty in &duty {
        speeds.push(speed);
        angles.push(angle);
        for _ in 0..parts {
            let push = gain * duty / time_constant_s * step_s;
            let most = gain * friction / time_constant_s * step_s;
            let free = speed + push - speed / time_constant_s * step_s;
            speed = if free.abs() <= most { 0.0 } else { free - most.copysign(free) };
            angle += speed * step_s;
            let Some([low, high]) = stops else { continue };
            if angle <= low || angle >= high {
                angle = angle.clamp(low, high);
                speed = 0.0;
            }
        }
    }
    Motor { duty, speed: speeds, angle: angles }
}

fn deviation(values: &[f64]) -> f64 {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    (values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / values.len() as f64).sqrt()
}

/// Returns the values with white noise `decibels` below the signal.
pub(super) fn noisy(values: &[f64], decibels: f64, dice: &mut Pcg64Mcg) -> Vec<f64> {
    let size = deviation(values) * 10_f64.powf(-decibels / 20.0);
    let noise = Normal::new(0.0, size.max(1e-12)).expect("a deviation");
    values.iter().map(|value| value + noise.sample(dice)).collect()
}

/// Returns the values rounded to multiples of `count`.
pub(super) fn counted(values: &[f64], count: f64) -> Vec<f64> {
    values.iter().map(|value| (value / count).round() * count).collect()
}

pub(super) fn run(columns: Vec<(&str, Quantity, Vec<f64>)>) -> Run {
    let samples = columns.first().map_or(0, |column| column.2.len());
    Run {
        name: "generated".to_owned(),
        time_s: (0..samples).map(|at| PERIOD_S * at as f64).collect(),
        origin_s: None,
        signals: columns
            .into_iter()
            .map(|(role, quantity, values)| (role.to_owned(), Signal { column: role.to_owned(), quantity, values }))
            .collect(),
    }
}
