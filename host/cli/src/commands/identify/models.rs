//! `r4 identify models`: lists the base models.

use r4_identify::{ModelInfo, task::FileKind};
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
    roles: Vec<Role>,
    parameters: Vec<Parameter>,
    effects: Vec<String>,
    /// Name of the file written for a simulated board.
    writes: &'static str,
    /// Option by which a simulated board loads that file.
    loads: &'static str,
}

#[derive(Serialize)]
struct Role {
    name: String,
    required: bool,
    what: String,
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
        for Role { name, required, what } in &model.roles {
            let need = if *required { "" } else { " (optional)" };
            output::line(format_args!("  role {name:roles$}  {what}{need}"))?;
        }
        let parameters = width(&mut model.parameters.iter().map(|parameter| parameter.name.len()));
        for Parameter { name, unit, what } in &model.parameters {
            let unit = if unit == "1" { String::new() } else { format!(" ({unit})") };
            output::line(format_args!("  param {name:parameters$}  {what}{unit}"))?;
        }
        output::line(format_args!("  effects {}", model.effects.join(", ")))?;
        output::line(format_args!("  writes {}, which a simulated board loads with {}", model.writes, model.loads))?;
    }
    Ok(true)
}

fn described(model: ModelInfo) -> Model {
    let role = |role: &r4_identify::task::RoleInfo| Role {
        name: role.name.to_owned(),
        required: role.required,
        what: role.what.to_owned(),
    };
    Model {
        name: model.name.to_owned(),
        summary: model.summary.to_owned(),
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
        writes: model.file.name(),
        loads: match model.file {
            FileKind::Plant => "--plant CHANNEL=FILE",
            FileKind::Body => "--body FILE",
        },
    }
}
