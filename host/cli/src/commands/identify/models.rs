//! `r4 identify models`

use r4_identify::{ModelInfo, data::Quantity};
use serde::Serialize;

use crate::{args::Args, output};

#[derive(Serialize)]
struct Models {
    models: Vec<Model>,
}

#[derive(Serialize)]
struct Model {
    name: String,
    summary: String,
    /// Needs a time for each sample.
    timed: bool,
    roles: Vec<Role>,
    parameters: Vec<Parameter>,
    effects: Vec<String>,
}

#[derive(Serialize)]
struct Role {
    name: String,
    required: bool,
    what: String,
    units: Vec<&'static str>,
}

#[derive(Serialize)]
struct Parameter {
    name: String,
    unit: String,
    what: String,
}

pub(super) fn run(args: &Args) -> anyhow::Result<bool> {
    let models: Vec<Model> = r4_identify::models().into_iter().map(described).collect();
    if args.json {
        output::json(&Models { models })?;
        return Ok(true);
    }
    for (index, model) in models.iter().enumerate() {
        if index > 0 {
            output::line("")?;
        }
        output::line(format_args!("{}: {}", model.name, model.summary))?;
        let width = |names: &mut dyn Iterator<Item = usize>| names.max().unwrap_or(0);
        let roles = width(&mut model.roles.iter().map(|role| role.name.len()));
        for Role { name, required, what, units } in &model.roles {
            let need = if *required { "needed" } else { "may be given" };
            output::line(format_args!("  role {name:roles$}  {what} ({}; {need})", units.join(", ")))?;
        }
        let parameters = width(&mut model.parameters.iter().map(|parameter| parameter.name.len()));
        for Parameter { name, unit, what } in &model.parameters {
            let unit = if unit == "1" { String::new() } else { format!(" ({unit})") };
            output::line(format_args!("  param {name:parameters$}  {what}{unit}"))?;
        }
        output::line(format_args!("  effects {}", model.effects.join(", ")))?;
    }
    Ok(true)
}

fn described(model: ModelInfo) -> Model {
    let role = |need: &r4_identify::data::Need| Role {
        name: need.role.clone(),
        required: need.required,
        what: need.what.clone(),
        units: if need.quantities.is_empty() {
            vec!["any unit"]
        } else {
            need.quantities.iter().map(|of| unit(*of)).collect()
        },
    };
    Model {
        name: model.name.to_owned(),
        summary: model.summary.to_owned(),
        timed: model.timed,
        roles: model.roles.iter().map(role).collect(),
        parameters: model
            .parameters
            .iter()
            .map(|parameter| Parameter {
                name: parameter.name.to_owned(),
                unit: parameter.unit.to_owned(),
                what: parameter.what.to_owned(),
            })
            .collect(),
        effects: model.effects.iter().map(|effect| (*effect).to_owned()).collect(),
    }
}

/// What its SI unit is called.
fn unit(quantity: Quantity) -> &'static str {
    match quantity {
        Quantity::Angle => "rad",
        Quantity::AngularSpeed => "rad/s",
        Quantity::Length => "m",
        Quantity::Speed => "m/s",
        Quantity::Voltage => "V",
        Quantity::Force => "N",
        Quantity::Torque => "N m",
        Quantity::Current => "A",
        Quantity::Temperature => "°C",
        Quantity::Number => "a plain number",
    }
}
