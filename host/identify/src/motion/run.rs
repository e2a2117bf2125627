//! A recorded run, prepared for the simulation.

use std::sync::{Arc, OnceLock};

use crate::{
    data::Run,
    fit::{rounding, white_noise},
};

use super::{command::Command, weak::Windows};

/// Longest step of the simulation where friction or load change within a step's motion, s; elsewhere steps may be
/// twice as long.
const LONGEST_STEP_S: f64 = 2.5e-3;
/// Largest number of steps between two samples.
const MOST_STEPS: f64 = 60.0;
/// Relative difference of step lengths below which they are equal: the difference is rounding.
const SAME_STEP: f64 = 1e-10;

/// Standard deviation of an initial position that is not recorded, rad or m: far more than any effect needs.
const ANYWHERE: f64 = 10.0;

/// A whole recording, prepared for simulation.
#[derive(Clone, Debug)]
pub(super) struct Recording {
    pub(super) name: String,
    pub(super) time_s: Vec<f64>,
    /// Input from each sample to the next.
    pub(super) input: Vec<f64>,
    /// Input at times between samples, in its own unit.
    pub(super) command: Command,
    supply: Vec<f64>,
    pub(super) supply_recorded: bool,
    enabled: Vec<bool>,
    gain: Vec<f64>,
    pub(super) measured: Vec<f64>,
    /// Standard deviation of the noise on `measured`.
    pub(super) noise: f64,
    /// Standard deviation of the rounding error by the sensor's resolution.
    pub(super) rounding: f64,
    /// Number and length of the simulation's steps from each sample to the next: long and short ones.
    pub(super) steps: [Vec<(u32, f64)>; 2],
    /// Time from the axis' power-up to the first sample, s, if known.
    pub(super) origin_s: f64,
    /// Time from the begin of a held value's slots to the first sample, s.
    pub(super) slots_s: f64,
    /// Windows of the weak form, computed on first use.
    pub(super) windows: OnceLock<Option<Arc<Windows>>>,
}

/// Recording, or part of it; the command before the part is known.
#[derive(Clone, Debug)]
pub struct MotionRun {
    pub(super) all: Arc<Recording>,
    pub(super) from: usize,
    pub(super) to: usize,
}

impl MotionRun {
    /// Takes the roles `input`, `output` and optionally `supply`, `enabled`, `gain`. A missing command holds the one
    /// before.
    pub(super) fn new(run: &Run, supply_v: f64) -> Option<Self> {
        let time_s = run.time_s.clone();
        let held = |values: &[f64]| {
            let mut last = values.iter().copied().find(|value| value.is_finite()).unwrap_or(0.0);
            values
                .iter()
                .map(|&value| {
                    if value.is_finite() {
                        last = value;
                    }
                    last
                })
                .collect::<Vec<f64>>()
        };
        let input = held(run.values("input")?);
        let measured = run.values("output")?.to_vec();
        let command = if run.origin_s.is_some() { Command::sampled } else { Command::held };
        let recorded = run.values("supply");
        // Slots begin with the board's power-up. If that is longer ago than a recording lasts, their phase would need
        // too exact a period.
        let recording_s = time_s.last().copied().unwrap_or(0.0);
        let slots_s = run.origin_s.filter(|&origin_s| origin_s <= recording_s).unwrap_or(0.0);
        let count = input.len();
        Some(Self {
            from: 0,
            to: count,
            all: Arc::new(Recording {
                name: run.name.clone(),
                command: command(&time_s, &input),
                supply: recorded.map_or_else(|| vec![supply_v; count], held),
                supply_recorded: recorded.is_some(),
                enabled: run.values("enabled").map_or_else(
                    || vec![true; count],
                    |values| held(values).iter().map(|&value| value > 0.5).collect(),
                ),
                gain: run.values("gain").map_or_else(|| vec![1.0; count], held),
                noise: white_noise(&measured),
                rounding: rounding(&measured),
                origin_s: run.origin_s.unwrap_or(0.0),
                slots_s,
                windows: OnceLock::new(),
                steps: [2.0 * LONGEST_STEP_S, LONGEST_STEP_S].map(|longest_s| steps(&time_s, longest_s)),
                time_s,
                input,
                measured,
            }),
        })
    }

    /// Returns the same run with other values of the output.
    pub(super) fn measuring(&self, measured: Vec<f64>) -> Self {
        let all = Recording { measured, windows: OnceLock::new(), ..(*self.all).clone() };
        Self { all: Arc::new(all), ..*self }
    }

    pub(super) fn input_at(&self, sample: usize) -> f64 {
        self.all.input.get(sample).copied().unwrap_or(0.0)
    }

    pub(super) fn supply_at(&self, sample: usize) -> f64 {
        self.all.supply.get(sample).copied().unwrap_or(0.0)
    }

    pub(super) fn enabled_at(&self, sample: usize) -> bool {
        self.all.enabled.get(sample).copied().unwrap_or(true)
    }

    pub(super) fn gain_at(&self, sample: usize) -> f64 {
        self.all.gain.get(sample).copied().unwrap_or(1.0)
    }

    /// Returns number and length of the simulation's steps from a sample to the next one of this run; 0 from the
    /// last.
    #[inline]
    pub(super) fn steps(&self, sample: usize, fine: bool) -> (u32, f64) {
        if sample + 1 < self.to { self.all.steps[usize::from(fine)][sample] } else { (0, 0.0) }
    }

    pub(super) fn coasts(&self) -> bool {
        self.all.enabled.contains(&false)
    }

    /// Returns an initial guess and its standard deviation for position and speed at the first sample. If speeds were
    /// recorded, the position is arbitrary.
    pub(super) fn initial(&self, of_speed: bool) -> (Vec<f64>, Vec<f64>) {
        let all = &*self.all;
        let samples: Vec<(f64, f64)> = (self.from..self.to)
            .map(|sample| (all.time_s[sample] - all.time_s[self.from], all.measured[sample]))
            .filter(|(_, measured)| measured.is_finite())
            .take(8)
            .collect();
        let reach = all.measured.iter().filter(|value| value.is_finite());
        let (low, high) = reach.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), &v| (l.min(v), h.max(v)));
        let smallest = (1e-4 * (high - low)).max(f64::MIN_POSITIVE);
        let noise = all.noise.max(smallest);
        let Some(&(last_s, _)) = samples.last() else { return (vec![0.0; 2], vec![1.0; 2]) };
        let count = samples.len() as f64;
        let mean_s = samples.iter().map(|(time_s, _)| time_s).sum::<f64>() / count;
        let mean = samples.iter().map(|(_, value)| value).sum::<f64>() / count;
        let square: f64 = samples.iter().map(|(time_s, _)| (time_s - mean_s).powi(2)).sum();
        let product: f64 = samples.iter().map(|(time_s, value)| (time_s - mean_s) * (value - mean)).sum();
        let slope = if square > 0.0 { product / square } else { 0.0 };
        let at_first = mean - slope * mean_s;
        if of_speed {
            return (vec![0.0, at_first], vec![ANYWHERE, 3.0 * noise + slope.abs() * last_s]);
        }
        let slope_deviation = if square > 0.0 { noise / square.sqrt() } else { 1.0 };
        (vec![at_first, slope], vec![3.0 * noise, 3.0 * slope_deviation + 0.3 * slope.abs()])
    }
}

/// Returns number and length of the steps from each sample to the next.
fn steps(time_s: &[f64], longest_s: f64) -> Vec<(u32, f64)> {
    let mut last_s = f64::NAN;
    time_s
        .windows(2)
        .map(|pair| {
            let dt_s = pair[1] - pair[0];
            // The tolerance keeps rounding of a stamp from adding a step.
            let count = (dt_s / longest_s - 1e-6).ceil().clamp(1.0, MOST_STEPS);
            let step_s = dt_s / count;
            if step_s.is_nan() || step_s <= 0.0 {
                return (0, 0.0);
            }
            if (step_s - last_s).abs() > SAME_STEP * step_s || last_s.is_nan() {
                last_s = step_s;
            }
            (count as u32, last_s)
        })
        .collect()
}
