//! Names, roles and known parameters of the models of an axis.

use std::collections::BTreeMap;

use r4_plants::PlantSpec;

use crate::{
    error::IdentifyError,
    task::{FileKind, ModelInfo, ParameterInfo, RoleInfo},
};

use super::{Kind, Known, Motion, effect::Effect};

const fn role(name: &'static str, required: bool, driving: bool, what: &'static str) -> RoleInfo {
    RoleInfo { name, required, driving, what }
}

const fn parameter(name: &'static str, unit: &'static str, what: &'static str) -> ParameterInfo {
    ParameterInfo { name, unit, what }
}

const SUPPLY: ParameterInfo =
    parameter("supply_v", "V", "of the supply, where the input is a duty and no column has it");
const RESISTANCE: ParameterInfo = parameter(
    "resistance_ohm",
    "ohm",
    "of the winding: fixes the scale of torques, which position and duty alone do not",
);

impl Motion {
    /// Returns the description of a kind of model.
    #[must_use]
    pub fn info(kind: Kind) -> ModelInfo {
        let input = role("input", true, true, "duty -1..1, V, or N");
        let output = role("output", true, false, "position or speed, by the unit in the column's name");
        let supply = role("supply", false, true, "voltage of the supply");
        let speed =
            role("speed", false, false, "of the output by another sensor; compared with it, nothing is fitted to it");
        let (summary, roles, parameters) = match kind {
            Kind::DcMotor => (
                "duty or volts to the position or speed of a brushed motor",
                vec![input, output, supply, speed],
                vec![SUPPLY, RESISTANCE],
            ),
            Kind::Axis => (
                "force, or the volts of a drive of known gain, to the position or speed of a mass",
                vec![input, output, speed],
                vec![parameter("gain_per_unit", "N or N m", "of force for each unit of the input")],
            ),
            Kind::LinearActuator => (
                "duty or volts to the position or speed of a rod",
                vec![input, output, supply, speed],
                vec![SUPPLY, RESISTANCE, parameter("stroke_m", "m", "between the end stops at 0 and here")],
            ),
            Kind::Servo => (
                "goal to position of a servo with a proportional loop",
                vec![
                    role("input", true, true, "goal"),
                    output,
                    supply,
                    speed,
                    role("enabled", false, true, "1 while it is driven, 0 while its terminals are open"),
                    role("gain", false, true, "of the position loop, in any unit"),
                ],
                vec![
                    SUPPLY,
                    RESISTANCE,
                    parameter(
                        "duty_per_rad",
                        "1/rad",
                        "duty for each rad of error and unit of gain; fitted if unknown",
                    ),
                    parameter("duty_limit", "1", "largest duty; 1 if unknown"),
                    parameter("arm_m", "m", "of a pendulum on its output, with all mass at its end"),
                ],
            ),
        };
        let effects = Effect::ALL.iter().map(|effect| effect.name()).collect();
        ModelInfo { name: kind.name(), summary, roles, parameters, effects, file: FileKind::Plant }
    }
}

impl Known {
    /// Reads known parameters by name.
    ///
    /// # Errors
    /// [`IdentifyError::UnknownParameter`] for an unknown name, [`IdentifyError::OutOfRange`] for a value not above
    /// 0.
    pub fn from_parameters(
        kind: Kind,
        parameters: &BTreeMap<String, f64>,
        plant: Option<PlantSpec>,
    ) -> Result<Self, IdentifyError> {
        let info = Motion::info(kind);
        let mut known = Self { plant, ..Self::default() };
        for (name, &value) in parameters {
            if !info.parameters.iter().any(|parameter| parameter.name == name) {
                let names: Vec<_> = info.parameters.iter().map(|parameter| parameter.name).collect();
                return Err(IdentifyError::UnknownParameter {
                    model: kind.name(),
                    name: name.clone(),
                    known: names.join(", "),
                });
            }
            if !(value.is_finite() && value > 0.0) {
                return Err(IdentifyError::OutOfRange { name: name.clone(), value, allowed: "a number above 0" });
            }
            let place = match name.as_str() {
                "supply_v" => &mut known.supply_v,
                "resistance_ohm" => &mut known.resistance_ohm,
                "gain_per_unit" => &mut known.gain,
                "stroke_m" => &mut known.stroke_m,
                "duty_per_rad" => &mut known.loop_gain,
                "duty_limit" => &mut known.duty_limit,
                _ => &mut known.arm_m,
            };
            *place = Some(value);
        }
        Ok(known)
    }
}
