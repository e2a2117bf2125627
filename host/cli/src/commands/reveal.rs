//! `r4 sim reveal`: the effects hidden by `--blind`.

use std::collections::BTreeMap;

use r4_blind::{Hidden, Truth};
use r4_protocol::ChannelId;
use r4_rig::InRobot;
use serde::Serialize;

use crate::{args::Args, output, session, table};

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Reveal {
    /// Seed that was given to --blind
    #[arg(value_name = "SEED")]
    pub(crate) seed: u64,
    /// Robot's name or file, as after sim: or emu: [default: that of --board]
    #[arg(long, value_name = "ROBOT")]
    pub(crate) robot: Option<String>,
}

#[derive(Serialize)]
struct Report {
    robot: String,
    seed: u64,
    channels: Vec<Channel>,
    /// Effects hidden in the robot's body instead of its motors.
    #[serde(skip_serializing_if = "Option::is_none")]
    body: Option<Vec<Effect>>,
}

#[derive(Serialize)]
struct Channel {
    channel: String,
    /// Hidden effects; empty if nothing is hidden.
    effects: Vec<Effect>,
}

#[derive(Serialize)]
struct Effect {
    name: &'static str,
    depends_on: Vec<&'static str>,
    parameters: BTreeMap<&'static str, Number>,
    /// True if the effect is in the catalogue.
    listed: bool,
    /// Effects that no recording can distinguish from it.
    rivals: &'static [&'static str],
}

#[derive(Serialize)]
struct Number {
    value: f64,
    unit: &'static str,
}

impl From<&Truth> for Effect {
    fn from(truth: &Truth) -> Self {
        Self {
            name: truth.name,
            depends_on: truth.depends_on.iter().map(|dependence| dependence.name()).collect(),
            parameters: truth
                .parameters
                .iter()
                .map(|number| (number.name, Number { value: number.value, unit: number.unit }))
                .collect(),
            listed: truth.listed,
            rivals: truth.rivals,
        }
    }
}

pub(crate) fn run(args: &Args, reveal: &Reveal) -> anyhow::Result<bool> {
    let name = match &reveal.robot {
        Some(robot) => robot.as_str(),
        None => args.board.robot()?,
    };
    let mut robot = r4_boards::load(name)?;
    r4_rig::replace_plants(&mut robot, &args.plants_of_channels()?)?;
    if let Some(file) = &args.body {
        r4_rig::replace_body(&mut robot, file)?;
    }
    session::uses_other_physics();
    let (channels, body): (Vec<Channel>, Option<Vec<Effect>>) = match r4_rig::hidden(&robot, reveal.seed)? {
        InRobot::Motors(motors) => {
            let channel = |(channel, hidden): &(ChannelId, Hidden)| Channel {
                channel: channel.to_string(),
                effects: hidden.truth().iter().map(Effect::from).collect(),
            };
            (motors.iter().map(channel).collect(), None)
        }
        InRobot::Body(_, truth) => (vec![], Some(truth.iter().map(Effect::from).collect())),
    };
    if args.json {
        output::json(&Report { robot: name.to_owned(), seed: reveal.seed, channels, body })?;
        return Ok(true);
    }
    let mut rows = table::new(&["channel", "hidden", "depends on", "size"], 0..0);
    let body = body.map(|effects| Channel { channel: "body".into(), effects });
    for Channel { channel, effects } in channels.into_iter().chain(body) {
        if effects.is_empty() {
            rows.add_row([channel.clone(), "nothing".into(), String::new(), String::new()]);
        }
        for effect in effects {
            let sizes = effect.parameters.iter().map(|(name, number)| format!("{name} {:.4}", number.value));
            let known = if effect.listed { "" } else { " (in no catalogue)" };
            rows.add_row([
                channel.clone(),
                format!("{}{known}", effect.name),
                effect.depends_on.join(", "),
                sizes.collect::<Vec<_>>().join("\n"),
            ]);
        }
    }
    output::line(rows)?;
    Ok(true)
}
