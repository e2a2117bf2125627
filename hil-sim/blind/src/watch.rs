//! Detectability of a hidden effect.

use r4_plants::{Drive, Fitted, Model, Plant, PlantSpec, Unlisted};

use crate::{excitation::RATE_HZ, scale::Scale};

/// Recorded output of a plant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Output {
    /// Position as its sensor measures it.
    Position,
    /// True speed of the output.
    Speed,
}

/// Planned run: start position of the plant, and its duties.
#[derive(Clone, Debug)]
pub(crate) struct Plan {
    pub(crate) start: f64,
    pub(crate) duty: Vec<f64>,
}

/// Plant as a list of parts.
#[derive(Clone, Debug)]
pub(crate) struct Parts {
    pub(crate) spec: PlantSpec,
    pub(crate) unlisted: Vec<Box<dyn Unlisted>>,
}

impl Parts {
    /// Creates the plant, at rest at its start.
    pub(crate) fn plant(&self, seed: u64) -> Plant {
        Plant::with_unlisted(&self.spec, seed, self.unlisted.clone())
    }

    /// Output at each sample of a run; a duty holds from its sample to the next.
    pub(crate) fn outputs(&self, plan: &Plan, supply_v: f64, output: Output) -> Vec<f64> {
        self.outputs_at(plan, supply_v, output, (0..plan.duty.len()).map(|sample| sample as f64))
    }

    /// Output at ascending times of the same run, in sample periods from its start. Before the start the plant stands
    /// still, after the end the last duty holds.
    pub(crate) fn outputs_at(
        &self,
        plan: &Plan,
        supply_v: f64,
        output: Output,
        periods: impl Iterator<Item = f64>,
    ) -> Vec<f64> {
        let mut plant = self.plant(0);
        plant.set_position(plan.start);
        let mut now = 0.0;
        let at = |at: f64| {
            while now < at {
                // Not beyond the next sample, where the duty may change.
                let next = (libm::floor(now) + 1.0).min(at);
                let duty = plan.duty.get(now as usize).or(plan.duty.last()).copied().unwrap_or_default();
                plant.advance(Drive::with_brake(duty), supply_v, (next - now) / RATE_HZ);
                now = next;
            }
            match output {
                Output::Position => plant.sensed_position(),
                Output::Speed => plant.speed(),
            }
        };
        periods.map(at).collect()
    }
}

/// Standard deviation of noise that is 30 dB below a signal: `10^(-30/20)` of the signal's.
pub(crate) fn noise(outputs: &[Vec<f64>]) -> f64 {
    let variances = outputs.iter().map(|run| {
        let mean = run.iter().sum::<f64>() / run.len().max(1) as f64;
        run.iter().map(|value| (value - mean) * (value - mean)).sum::<f64>() / run.len().max(1) as f64
    });
    let runs = outputs.len().max(1) as f64;
    libm::sqrt(variances.sum::<f64>() / runs) * libm::pow(10.0, -1.5)
}

/// Multiple of the noise by which an effect must change the free-run simulation.
pub(crate) const DIFFERENCE: f64 = 3.0;
/// Multiple of the noise that must remain as residual after the base model's parameters have been fitted again.
pub(crate) const LEFT: f64 = 1.0;

/// Returns true if `outputs` of a plant cannot be reproduced by `without`, whatever its base parameters.
pub(crate) fn shows(outputs: &[Vec<f64>], without: &Parts, scale: &Scale, plans: &[Plan], output: Output) -> bool {
    let noise = noise(outputs);
    let far = |parts: &Parts| {
        let runs = plans.iter().map(|plan| parts.outputs(plan, scale.supply_v, output));
        difference(outputs, &runs.collect::<Vec<_>>())
    };
    noise > 0.0 && far(without) >= DIFFERENCE * noise && left(outputs, without, scale, plans, output) >= LEFT * noise
}

/// RMS of the difference, over all runs.
fn difference(a: &[Vec<f64>], b: &[Vec<f64>]) -> f64 {
    let squares = a.iter().flatten().zip(b.iter().flatten()).map(|(a, b)| (a - b) * (a - b));
    libm::sqrt(squares.sum::<f64>() / a.iter().map(Vec::len).sum::<usize>().max(1) as f64)
}

/// Number of base parameters: logarithms of gain and mass, and viscous friction.
const PARAMETERS: usize = 3;
/// Number of iterations: fits come within a few per cent of their optimum, which is enough to estimate what a base model
/// can absorb.
const ITERATIONS: usize = 4;
/// Step of the finite differences.
const NUDGE: f64 = 0.02;

/// RMS of the residual after a fit of gain, mass and viscous friction by the Gauss-Newton method.
pub(crate) fn left(outputs: &[Vec<f64>], without: &Parts, scale: &Scale, plans: &[Plan], output: Output) -> f64 {
    let run = |parameters: &[f64; PARAMETERS]| -> Vec<f64> {
        let parts = Parts { spec: nudged(&without.spec, scale, parameters), unlisted: without.unlisted.clone() };
        let runs = plans.iter().zip(outputs).map(|(plan, measured)| {
            let simulated = parts.outputs(plan, scale.supply_v, output);
            let residual: Vec<f64> = measured.iter().zip(&simulated).map(|(a, b)| a - b).collect();
            // The mean is removed, because a start offset would be fitted too.
            let mean = match output {
                Output::Position => residual.iter().sum::<f64>() / residual.len().max(1) as f64,
                Output::Speed => 0.0,
            };
            residual.into_iter().map(move |value| value - mean).collect::<Vec<_>>()
        });
        runs.flatten().collect()
    };
    let square = |residual: &[f64]| residual.iter().map(|value| value * value).sum::<f64>();
    let mut parameters = [0.0; PARAMETERS];
    let mut residual = run(&parameters);
    for _ in 0..ITERATIONS {
        let slopes: Vec<Vec<f64>> = (0..PARAMETERS)
            .map(|index| {
                let mut nudged = parameters;
                nudged[index] += NUDGE;
                run(&nudged).iter().zip(&residual).map(|(there, here)| (there - here) / NUDGE).collect()
            })
            .collect();
        let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let mut matrix = [[0.0; PARAMETERS + 1]; PARAMETERS];
        for row in 0..PARAMETERS {
            for column in 0..PARAMETERS {
                matrix[row][column] = product(&slopes[row], &slopes[column]);
            }
            // Slightly damped: two parameters may have the same influence in these runs.
            matrix[row][row] *= 1.0 + 1e-6;
            matrix[row][PARAMETERS] = -product(&slopes[row], &residual);
        }
        let Some(step) = solved(matrix) else { break };
        let mut share = 1.0;
        // The step is shortened until it reduces the residual.
        let better = (0..4).find_map(|_| {
            let mut tried = parameters;
            tried.iter_mut().zip(step).for_each(|(value, step)| *value += (share * step).clamp(-0.7, 0.7));
            share *= 0.4;
            let there = run(&tried);
            (square(&there) < square(&residual)).then_some((tried, there))
        });
        let Some((tried, there)) = better else { break };
        let gained = 1.0 - square(&there) / square(&residual).max(f64::MIN_POSITIVE);
        (parameters, residual) = (tried, there);
        if gained < 0.02 {
            break;
        }
    }
    libm::sqrt(square(&residual) / residual.len().max(1) as f64)
}

/// Solves a linear system whose last column is the right side, by elimination with pivoting; `None` if it is singular.
fn solved(mut matrix: [[f64; PARAMETERS + 1]; PARAMETERS]) -> Option<[f64; PARAMETERS]> {
    for column in 0..PARAMETERS {
        let pivot =
            (column..PARAMETERS).max_by(|&a, &b| matrix[a][column].abs().total_cmp(&matrix[b][column].abs()))?;
        matrix.swap(column, pivot);
        let top = matrix[column];
        if top[column] == 0.0 || !top[column].is_finite() {
            return None;
        }
        for (index, row) in matrix.iter_mut().enumerate() {
            if index != column {
                let factor = row[column] / top[column];
                row.iter_mut().zip(top).for_each(|(value, top)| *value -= factor * top);
            }
        }
    }
    let mut solution = [0.0; PARAMETERS];
    for (index, value) in solution.iter_mut().enumerate() {
        *value = matrix[index][PARAMETERS] / matrix[index][index];
    }
    solution.iter().all(|value| value.is_finite()).then_some(solution)
}

/// Returns the plant with another gain, mass and viscous friction, as far as they are in range.
fn nudged(spec: &PlantSpec, scale: &Scale, parameters: &[f64; PARAMETERS]) -> PlantSpec {
    let [gain, mass, viscous] = *parameters;
    let (masses, drag): (&[&str], &str) = match spec.model() {
        Model::DcGearMotor(_) => (&["inertia_kg_m2"], "viscous_nm_s_per_rad"),
        Model::LinearActuator(_) => (&["rotor_inertia_kg_m2", "moving_mass_kg"], "viscous_n_s_per_m"),
    };
    let mut spec = spec.clone();
    let kind = spec.kind();
    let mut set = |name: &str, change: &dyn Fn(f64) -> f64| {
        let before = spec.model().get(kind, name).unwrap_or_default();
        // A value beyond a bound is not changed.
        let _ = spec.set_parameter(name, change(before));
    };
    set("torque_constant_nm_per_a", &|value| value * libm::exp(gain));
    masses.iter().for_each(|name| set(name, &|value| value * libm::exp(mass)));
    set(drag, &|value| (value + viscous * scale.force / scale.speed).max(0.0));
    spec
}
