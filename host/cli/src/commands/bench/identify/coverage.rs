//! Coverage: how often the intervals of found parameters contain the true values.

use std::{collections::BTreeMap, fmt};

use r4_blind::{Truth, experiment::Experiment};
use r4_identify::report::{EffectReport, Estimate};
use r4_plants::Model;

use super::Row;

/// Expected range of the coverage of 95 % intervals, for this few parameters.
const PROMISED: [f64; 2] = [0.93, 0.97];
/// Assumption that the identifier states where a winding's resistance is unknown; torques refer to it.
const ASSUMED: &str = "resistance_ohm = 1";

/// Parameter of a hidden effect that was found.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Compared {
    /// Name of the effect, then of the parameter.
    name: String,
    truth: f64,
    value: f64,
    interval: Option<[f64; 2]>,
}

impl Compared {
    fn is_inside(&self) -> Option<bool> {
        self.interval.map(|[low, high]| (low..=high).contains(&self.truth))
    }
}

impl fmt::Display for Compared {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {:.4} for {:.4}", self.name, self.value, self.truth)?;
        match self.interval {
            Some([low, high]) => write!(f, " ({low:.4} to {high:.4})"),
            None => f.write_str(" (no interval)"),
        }
    }
}

/// Parameters of a found effect with their true values; empty for an effect under another name.
pub(super) fn compared(experiment: &Experiment, truth: &Truth, found: &EffectReport) -> Vec<Compared> {
    if truth.name != found.name {
        return Vec::new();
    }
    let compared = |(name, estimate): (&String, &Estimate)| {
        Some(Compared {
            name: format!("{} {name}", found.name),
            truth: true_value(experiment, truth, name, estimate)?,
            value: estimate.value,
            interval: estimate.interval,
        })
    };
    found.parameters.iter().filter_map(compared).collect()
}

/// True value of a parameter in the report's terms; `None` where the two have no number in common, and for phases,
/// which repeat after a turn.
fn true_value(experiment: &Experiment, truth: &Truth, name: &str, estimate: &Estimate) -> Option<f64> {
    if name.contains("phase") {
        return None;
    }
    let hidden = |name: &str| truth.parameters.iter().find(|value| value.name == name).map(|value| value.value);
    let value = match name {
        // Plants are driven by a duty; an axis is identified from its force.
        "input_force_n" => hidden("duty")? * experiment.input_per_duty,
        "rate_per_s" => hidden(name)? * experiment.input_per_duty,
        // The base model of a motor has no inductance: the lag of its current is a part of the delay.
        "delay_s" => hidden(name)? + current_lag_s(experiment),
        // The report's base model contains the forward gain.
        "backward_gain" => hidden(name)? / hidden("forward_gain")?,
        _ => hidden(name)?,
    };
    match estimate.assumed.as_deref() {
        None => Some(value),
        Some(ASSUMED) => Some(value * torques_at_1_ohm(experiment)?),
        Some(_) => None,
    }
}

/// Time constant of a motor's current, s; 0 for an axis, whose recorded input is a force.
fn current_lag_s(experiment: &Experiment) -> f64 {
    match experiment.base.model() {
        Model::DcGearMotor(motor) => motor.inductance_h / motor.resistance_ohm,
        Model::LinearActuator(_) => 0.0,
    }
}

/// Ratio of the torques of a motor with a winding of 1 Ω to those of the true one, if both move alike for each duty.
///
/// Observable are the speed per volt `k / (k² + B R)` and the acceleration per volt `k / (R J)`. With 1 Ω and all
/// viscous friction in the constant `K`, the same speed per volt takes `K = (k² + B R) / k`, and the same acceleration
/// per volt `K R J / k` as inertia. Torques grow with the inertia.
fn torques_at_1_ohm(experiment: &Experiment) -> Option<f64> {
    let Model::DcGearMotor(motor) = experiment.base.model() else { return None };
    let square = (motor.gear_ratio * motor.torque_constant_nm_per_a).powi(2);
    let resistance_ohm = motor.resistance_ohm;
    Some(resistance_ohm * (square + motor.viscous_nm_s_per_rad * resistance_ohm) / square)
}

/// Row of the share of true values within their intervals.
pub(super) fn row<'c>(data: &str, compared: impl Iterator<Item = &'c Compared>) -> Row {
    let (mut inside, mut with_interval, mut without) = (0, 0, 0);
    let mut outside: BTreeMap<&str, usize> = BTreeMap::new();
    for one in compared {
        match one.is_inside() {
            None => without += 1,
            Some(is_inside) => {
                with_interval += 1;
                inside += usize::from(is_inside);
                if !is_inside {
                    *outside.entry(&one.name).or_default() += 1;
                }
            }
        }
    }
    let mut detail =
        format!("{with_interval} parameters of effects with the right name; {without} more have no interval");
    if !outside.is_empty() {
        let outside: Vec<String> = outside.iter().map(|(name, count)| format!("{name} {count}")).collect();
        detail += &format!("; outside: {}", outside.join(", "));
    }
    Row::between(data, "true value in its 95 % interval", [inside, with_interval], PROMISED).with(detail)
}

#[cfg(test)]
mod tests {
    use r4_blind::{
        Draw, Value,
        experiment::{Length, Setup, experiment},
    };

    use super::*;

    const SHORT: Length = Length { train: 1, holdout: 1, seconds: 1.0 };

    fn estimate(assumed: Option<&str>) -> Estimate {
        Estimate { value: 1.0, std: None, unit: "1".to_owned(), interval: None, assumed: assumed.map(str::to_owned) }
    }

    fn truth(parameters: &[(&'static str, f64)]) -> Truth {
        let parameters = parameters.iter().map(|&(name, value)| Value { name, value, unit: "1" }).collect();
        Truth { name: "an-effect", parameters, depends_on: &[], listed: true, rivals: &[] }
    }

    #[test]
    fn true_values_are_in_the_report_s_terms() {
        let motor = experiment(Setup::MotorPosition, Draw::Nothing, SHORT, 1);
        let axis = experiment(Setup::AxisPosition, Draw::Nothing, SHORT, 1);
        let truth = truth(&[
            ("duty", 0.5),
            ("rate_per_s", 2.0),
            ("forward_gain", 0.8),
            ("backward_gain", 1.0),
            ("phase_rad", 1.0),
            ("delay_s", 0.1),
            ("torque_nm", 3.0),
        ]);
        let value = |made: &Experiment, name: &str| true_value(made, &truth, name, &estimate(None));
        assert_eq!((value(&motor, "duty"), value(&motor, "rate_per_s")), (Some(0.5), Some(2.0)));
        assert_eq!(value(&motor, "delay_s"), Some(0.1 + current_lag_s(&motor)));
        assert_eq!(value(&axis, "delay_s"), Some(0.1));
        assert_eq!(value(&axis, "input_force_n"), Some(0.5 * axis.input_per_duty));
        assert_eq!(value(&axis, "rate_per_s"), Some(2.0 * axis.input_per_duty));
        assert_eq!(value(&motor, "backward_gain"), Some(1.25));
        assert_eq!((value(&motor, "phase_rad"), value(&motor, "warm_up_s")), (None, None));
        let torque = |made: &Experiment, assumed| true_value(made, &truth, "torque_nm", &estimate(Some(assumed)));
        assert_eq!((torque(&motor, "supply_v = 1"), torque(&axis, ASSUMED)), (None, None));
        assert_eq!(torque(&motor, ASSUMED), torques_at_1_ohm(&motor).map(|factor| 3.0 * factor));
    }

    #[test]
    fn a_winding_of_1_ohm_moves_alike_under_converted_torques() {
        let made = experiment(Setup::MotorPosition, Draw::Nothing, SHORT, 1);
        let Model::DcGearMotor(motor) = *made.base.model() else { panic!("{:?}", made.base) };
        let factor = torques_at_1_ohm(&made).unwrap();
        let k = motor.gear_ratio * motor.torque_constant_nm_per_a;
        let (resistance_ohm, viscous, inertia) =
            (motor.resistance_ohm, motor.viscous_nm_s_per_rad, motor.inertia_kg_m2);
        let (other_k, other_inertia) = ((k * k + viscous * resistance_ohm) / k, factor * inertia);
        // Acceleration per volt, per speed, and per torque over its factor.
        let ours = [k / resistance_ohm / inertia, (k * k / resistance_ohm + viscous) / inertia, 1.0 / inertia];
        let other = [other_k / other_inertia, other_k * other_k / other_inertia, factor / other_inertia];
        assert!(ours.iter().zip(other).all(|(a, b)| (a / b - 1.0).abs() < 1e-12), "{ours:?} {other:?}");
    }

    #[test]
    fn intervals_are_counted_by_where_the_truth_is() {
        let of = |truth, interval| Compared { name: "an-effect share".to_owned(), truth, value: 0.0, interval };
        let compared = [of(1.0, Some([0.5, 1.5])), of(2.0, Some([0.5, 1.5])), of(1.0, None)];
        let row = row("", compared.iter());
        assert!(row.after == 0.5 && !row.met && row.at_most == Some(0.97), "{row:?}");
        assert_eq!(
            row.detail,
            "2 parameters of effects with the right name; 1 more have no interval; outside: an-effect share 1"
        );
    }
}
