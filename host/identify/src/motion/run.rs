//! A recorded run as the simulation wants it.

use std::sync::{Arc, OnceLock};

use crate::{
    data::Run,
    fit::{rounding, white_noise},
};

use super::{command::Command, weak::Windows};

/// Steps of the simulation are no longer where friction or load change within a step's motion, and twice as long where
/// they do not, s.
const LONGEST_STEP_S: f64 = 2.5e-3;
/// So many steps at most between two samples.
const MOST_STEPS: f64 = 60.0;
/// Steps whose lengths differ by less than this share are as long as each other: the difference is rounding.
const SAME_STEP: f64 = 1e-10;

/// Deviation of a position that nothing tells, rad or m: far more than any effect asks for.
const ANYWHERE: f64 = 10.0;

/// All of a recording.
#[derive(Clone, Debug)]
pub(super) struct Recording {
    pub(super) name: String,
    pub(super) time_s: Vec<f64>,
    /// From each sample to the next.
    pub(super) input: Vec<f64>,
    /// The input at moments between samples, in its own unit.
    pub(super) command: Command,
    supply: Vec<f64>,
    pub(super) supply_recorded: bool,
    enabled: Vec<bool>,
    gain: Vec<f64>,
    pub(super) measured: Vec<f64>,
    /// Deviation of the noise on `measured`.
    pub(super) noise: f64,
    /// Deviation of what the resolution of the sensor leaves of it.
    pub(super) rounding: f64,
    /// From each sample to the next in steps: how many, and how long each is. Long ones, and short ones.
    pub(super) steps: [Vec<(u32, f64)>; 2],
    /// Time at the first sample since the axis was switched on, if known.
    pub(super) origin_s: f64,
    /// The same since slots of a held value began.
    pub(super) slots_s: f64,
    /// Made when they are first asked for.
    pub(super) windows: OnceLock<Option<Arc<Windows>>>,
}

/// A recording, or a part of it; what was commanded before the part is known.
#[derive(Clone, Debug)]
pub struct MotionRun {
    pub(super) all: Arc<Recording>,
    pub(super) from: usize,
    pub(super) to: usize,
}

impl MotionRun {
    /// Of roles `input`, `output`, and where there are: `supply`, `enabled`, `gain`. A missing command is what was
    /// commanded before.
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
        // With the board. After longer than a recording, the period would have to be known too well to tell.
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

    /// The same run with other values of the output.
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

    /// How many steps to take from a sample to the next one of this run, and how long each is; none from the last.
    #[inline]
    pub(super) fn steps(&self, sample: usize, fine: bool) -> (u32, f64) {
        if sample + 1 < self.to { self.all.steps[usize::from(fine)][sample] } else { (0, 0.0) }
    }

    pub(super) fn coasts(&self) -> bool {
        self.all.enabled.contains(&false)
    }

    /// Guess and deviation of position and speed at the first sample. Where speeds were recorded, the position is anywhere.
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

/// From each sample to the next.
fn steps(time_s: &[f64], longest_s: f64) -> Vec<(u32, f64)> {
    let mut last_s = f64::NAN;
    time_s
        .windows(2)
        .map(|pair| {
            let dt_s = pair[1] - pair[0];
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
