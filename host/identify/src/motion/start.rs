//! Creation of a model for given data: the effects that can show in them, and initial guesses.

use nalgebra::{DMatrix, DVector};
use std::{f64::consts::TAU, sync::Arc};

use crate::{
    data::{Need, Quantity, Run, check},
    error::IdentifyError,
    family::{Family, Model},
};

use super::{ASSUMED_V, Effect, Kind, Known, Motion, MotionRun, Scales, Units, stairs, through, waves};

/// Smallest number of samples.
const LEAST_SAMPLES: usize = 50;
/// Time constants from which a fit begins, s, besides the one found by regression.
const TIME_CONSTANTS_S: [f64; 4] = [0.03, 0.1, 0.3, 1.0];

impl Motion {
    /// Creates a model of this kind for some runs, and prepares these.
    ///
    /// # Errors
    /// An [`IdentifyError`] that names what is missing.
    pub fn new(
        kind: Kind,
        known: &Known,
        train: &[Run],
        holdout: &[Run],
    ) -> Result<(Self, Vec<MotionRun>, Vec<MotionRun>), IdentifyError> {
        let first = train.first().ok_or(IdentifyError::NoRuns)?;
        let need = |role: &str, what: &str, driving| Need {
            role: role.to_owned(),
            what: what.to_owned(),
            quantities: vec![],
            required: true,
            driving,
            varies: true,
            samples: LEAST_SAMPLES,
        };
        let needs = [need("input", "what drives the axis", true), need("output", "how it moves", false)];
        check(train, &needs)?;
        let missing = |role: &'static str| IdentifyError::MissingRole { model: kind.name(), role };
        let input = first.signals.get("input").ok_or_else(|| missing("input"))?;
        let output = first.signals.get("output").ok_or_else(|| missing("output"))?;
        let (rotary, of_speed) = match output.quantity {
            Quantity::Angle => (true, false),
            Quantity::AngularSpeed => (true, true),
            Quantity::Length => (false, false),
            Quantity::Speed => (false, true),
            _ => (kind != Kind::LinearActuator, false),
        };
        let is_duty =
            !matches!(input.quantity, Quantity::Voltage | Quantity::Force | Quantity::Torque) && kind != Kind::Axis;
        let recorded = first.signals.contains_key("supply");
        let supply_v = if is_duty { known.supply_v.unwrap_or(ASSUMED_V) } else { 1.0 };
        let prepare = |runs: &[Run]| -> Result<Vec<MotionRun>, IdentifyError> {
            runs.iter().map(|run| MotionRun::new(run, supply_v).ok_or_else(|| missing("output"))).collect()
        };
        let (train, holdout) = (prepare(train)?, prepare(holdout)?);
        let coasts = train.iter().chain(&holdout).any(MotionRun::coasts);
        let scales = Scales { damps_by_emf: kind != Kind::Axis, ..scales(&train, rotary, of_speed, input.quantity)? };
        let (base, places) = Self::base_of(kind, rotary, known, coasts, scales.period_s);
        let mut model = Self {
            kind,
            known: known.clone(),
            base,
            effects: vec![],
            catalogue: vec![],
            rotary,
            of_speed,
            duty_limit: known.duty_limit.unwrap_or(1.0),
            is_duty,
            bridge: if is_duty { known.bridge().collect() } else { Arc::default() },
            stops: known.stroke_m.map(|stroke_m| (0.0, stroke_m)),
            supply_assumed: is_duty && !recorded && known.supply_v.is_none(),
            scales,
            places,
        };
        let seen = |effect: &Effect| model.can_be_seen(*effect, is_duty && !recorded);
        model.effects = Effect::ALL.into_iter().filter(seen).collect();
        model.catalogue = model.effects.iter().map(|effect| effect.candidate(&model.scales, model.of_speed)).collect();
        Ok((model, train, holdout))
    }

    /// Returns whether an effect can show in the data. `supply_may_sag`: a supply of unknown voltage is behind the
    /// duty.
    fn can_be_seen(&self, effect: Effect, supply_may_sag: bool) -> bool {
        let servo = self.is_servo();
        let turns = self.scales.distance / TAU;
        match effect {
            // With a free gain, a scale error of the sensor is part of the gain, and an offset is another zero.
            Effect::EncoderScale => servo,
            Effect::EncoderOffset => servo && self.places.offset.is_none(),
            Effect::SupplySag => supply_may_sag && !servo,
            Effect::Gravity => self.rotary && self.places.pendulum.is_none() && turns > 0.15,
            Effect::Eccentricity => self.rotary && !self.of_speed && turns > 0.5,
            Effect::PositionFriction | Effect::Cogging => !self.rotary || turns > 0.1,
            Effect::SlewLimit | Effect::InputSign => !servo,
            _ => true,
        }
    }

    /// Returns initial guesses of the two base parameters, by linear regression on integrals, which average noise:
    /// `v(t) = v0 + k ∫u − b (q − q0)`, for a position integrated once more.
    pub(super) fn starting_values(&self, runs: &[&MotionRun]) -> Vec<Vec<f64>> {
        let regression = self.regression(runs);
        let mut found: Vec<(f64, f64)> = regression.into_iter().collect();
        // The regression gives one guess at most, so some fixed time constants are tried as well.
        for time_constant_s in TIME_CONSTANTS_S {
            if let Some(gain) = self.gain_for(runs, time_constant_s) {
                found.push((gain / time_constant_s, 1.0 / time_constant_s));
            }
        }
        if found.is_empty() {
            found.push((1.0, 10.0));
        }
        found
            .into_iter()
            .flat_map(|(k, b)| {
                let mut values = match self.kind {
                    Kind::Axis => {
                        let inertia = self.known.gain.unwrap_or(1.0) / k;
                        vec![inertia, inertia * b]
                    }
                    _ => vec![k / b, 1.0 / b],
                };
                values.resize(self.base.len(), 0.0);
                if let Some(place) = self.places.b_open {
                    values[place] = 0.3;
                }
                if let Some(place) = self.places.loop_gain {
                    values[place] = 5.0;
                }
                if let Some(place) = self.places.pendulum {
                    values[place] = 0.9;
                }
                let mut all = vec![values.clone()];
                if self.is_servo() {
                    // The loop hides the motor's gain and time constant: several magnitudes of both are tried.
                    for (gain, time) in [(0.3, 1.0), (3.0, 1.0), (1.0, 0.3), (1.0, 3.0)] {
                        let mut other = values.clone();
                        other[0] *= gain;
                        other[1] *= time;
                        all.push(other);
                    }
                }
                all
            })
            .collect()
    }

    /// Returns `k` and `b` by regression; `None` if either is not positive.
    fn regression(&self, runs: &[&MotionRun]) -> Option<(f64, f64)> {
        if self.is_servo() {
            return None;
        }
        let mut normal = DMatrix::<f64>::zeros(2, 2);
        let mut right = DVector::<f64>::zeros(2);
        for run in runs {
            let rows = self.integrals(run, |_, _| None);
            // Removes the unknown initial state from the regression.
            let detrended = without_line(&rows, self.of_speed);
            for [response, drive, damping] in detrended {
                let features = [drive, -damping];
                for i in 0..2 {
                    right[i] += features[i] * response;
                    for j in 0..2 {
                        normal[(i, j)] += features[i] * features[j];
                    }
                }
            }
        }
        let solution = normal.lu().solve(&right)?;
        let (k, b) = (solution[0].abs(), solution[1]);
        (k.is_finite() && k > 0.0 && b > 1e-3 * k.min(1.0) && b < 1e4).then_some((k, b))
    }

    /// Returns the steady gain of a first-order response with this time constant, by least squares.
    fn gain_for(&self, runs: &[&MotionRun], time_constant_s: f64) -> Option<f64> {
        if self.is_servo() {
            return Some(self.scales.speed.max(1.0) / runs[0].supply_at(0).max(1e-3));
        }
        let (mut product, mut square) = (0.0, 0.0);
        for run in runs {
            let mut speed = 0.0;
            let rows = self.integrals(run, |dt_s, volts| {
                let mean = volts + (speed - volts) * (time_constant_s / dt_s) * -(-dt_s / time_constant_s).exp_m1();
                speed = volts + (speed - volts) * (-dt_s / time_constant_s).exp();
                Some((speed, mean))
            });
            for [response, simulated, _] in without_line(&rows, self.of_speed) {
                product += simulated * response;
                square += simulated * simulated;
            }
        }
        let gain = (product / square).abs();
        (gain.is_finite() && gain > 0.0).then_some(gain)
    }

    /// Returns time, response, drive and damping, the latter two integrated as often as the response is.
    fn integrals(
        &self,
        run: &MotionRun,
        mut filtered: impl FnMut(f64, f64) -> Option<(f64, f64)>,
    ) -> Vec<(f64, [f64; 3])> {
        let measured = self.measured(run);
        let times = self.time_s(run);
        let mut rows = Vec::with_capacity(measured.len());
        let (mut drive, mut drive_twice, mut damping, mut last) = (0.0, 0.0, 0.0, f64::NAN);
        for (place, (&value, &time_s)) in measured.iter().zip(times).enumerate() {
            if value.is_finite() {
                let driven = if self.of_speed { drive } else { drive_twice };
                rows.push((time_s, [value, driven, damping]));
                last = value;
            }
            let dt_s = times.get(place + 1).map_or(0.0, |next| next - time_s);
            if dt_s <= 0.0 {
                continue;
            }
            let sample = run.from + place;
            let volts = through(&self.bridge, run.input_at(sample)) * run.supply_at(sample);
            if let Some((speed, mean)) = filtered(dt_s, volts) {
                drive = speed;
                drive_twice += mean * dt_s;
            } else {
                drive_twice += drive * dt_s + 0.5 * volts * dt_s * dt_s;
                drive += volts * dt_s;
            }
            if last.is_finite() {
                damping += last * dt_s;
            }
        }
        rows
    }
}

/// Returns the rows without their mean and, for positions, without a line over time: initial position and speed.
fn without_line(rows: &[(f64, [f64; 3])], of_speed: bool) -> Vec<[f64; 3]> {
    let count = rows.len().max(1) as f64;
    let mean_s = rows.iter().map(|row| row.0).sum::<f64>() / count;
    let square: f64 = rows.iter().map(|row| (row.0 - mean_s).powi(2)).sum();
    let mut lines = [(0.0, 0.0); 3];
    for (column, line) in lines.iter_mut().enumerate() {
        let mean = rows.iter().map(|row| row.1[column]).sum::<f64>() / count;
        let product: f64 = rows.iter().map(|row| (row.0 - mean_s) * (row.1[column] - mean)).sum();
        *line = (mean, if of_speed || square == 0.0 { 0.0 } else { product / square });
    }
    rows.iter()
        .map(|(time_s, row)| {
            let mut free = *row;
            for (value, (mean, slope)) in free.iter_mut().zip(lines) {
                *value -= mean + slope * (time_s - mean_s);
            }
            free
        })
        .collect()
}

fn scales(runs: &[MotionRun], rotary: bool, of_speed: bool, quantity: Quantity) -> Result<Scales, IdentifyError> {
    let units = if rotary { Units::ROTARY } else { Units::LINEAR }.with_input(quantity);
    let mut periods: Vec<f64> = Vec::new();
    let (mut input, mut distance, mut speed, mut duration_s, mut acceleration) = (0.0_f64, 0.0_f64, 0.0_f64, 0.0, 0.0);
    for run in runs {
        let all = &run.all;
        periods.extend(all.time_s.windows(2).map(|pair| pair[1] - pair[0]));
        input = all.input.iter().fold(input, |largest, value| largest.max(value.abs()));
        duration_s += all.time_s.last().copied().unwrap_or(0.0);
        let known: Vec<(f64, f64)> = all
            .time_s
            .iter()
            .copied()
            .zip(all.measured.iter().copied())
            .filter(|(_, value)| value.is_finite())
            .collect();
        let (Some(first), Some(last)) = (known.first(), known.last()) else { continue };
        let (low, high) =
            known.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), (_, v)| (l.min(*v), h.max(*v)));
        if of_speed {
            speed = speed.max(high.abs()).max(low.abs());
            let way: f64 = known.windows(2).map(|pair| pair[0].1 * (pair[1].0 - pair[0].0)).sum();
            distance = distance.max(way.abs()).max(0.1 * speed * (last.0 - first.0));
        } else {
            distance = distance.max(high - low);
            // Over a sixtieth of the run, noise hardly affects the speed.
            let stride = (known.len() / 60).max(1);
            for pair in known.iter().step_by(stride).collect::<Vec<_>>().windows(2) {
                speed = speed.max((pair[1].1 - pair[0].1).abs() / (pair[1].0 - pair[0].0));
            }
        }
    }
    periods.sort_by(f64::total_cmp);
    let period_s = periods.get(periods.len() / 2).copied().ok_or(IdentifyError::TooShort { samples: runs.len() })?;
    if speed > 0.0 {
        // Assumed: the highest speed is reached within a tenth of a second.
        acceleration = speed / 0.1;
    }
    // These scales divide later.
    if input <= 0.0 || distance <= 0.0 || acceleration <= 0.0 {
        return Err(IdentifyError::NothingMoves);
    }
    let (slow, teeth) = if rotary {
        (vec![1.0, 2.0], vec![2.0, 4.0, 6.0, 8.0, 12.0])
    } else {
        let per = |n: f64| n / distance;
        (vec![per(0.5), per(1.0), per(2.0)], vec![per(1.0), per(2.0), per(4.0), per(8.0)])
    };
    Ok(Scales {
        units,
        input,
        distance,
        speed,
        acceleration,
        period_s,
        duration_s: duration_s / runs.len() as f64,
        periods: slow,
        periods_within: waves::within(rotary, distance),
        cogging: teeth,
        damps_by_emf: true,
        stairs_s: stairs::periods(runs, period_s),
        input_is_sampled: runs.iter().any(|run| run.all.command.is_straight()),
    })
}
