//! A scenario's file.

use r4_protocol::{ChannelId, Mode};
use serde::{Deserialize, Deserializer, de::Error};

/// What is done to one board.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Scenario {
    /// A built-in robot, or a file beside this one.
    pub(super) robot: String,
    /// In order of time.
    pub(super) steps: Vec<Step>,
}

/// One thing that is done.
#[derive(Clone, Debug, Deserialize)]
pub(super) struct Step {
    /// Since the host's session began; a step that comes while another still waits for its answer is done after that.
    #[serde(deserialize_with = "seconds")]
    pub(super) at_s: f64,
    /// What.
    #[serde(flatten)]
    pub(super) action: Action,
}

/// What a step does.
#[derive(Clone, Debug, Deserialize)]
#[serde(tag = "do", rename_all = "kebab-case", deny_unknown_fields)]
pub(super) enum Action {
    /// Notes where everything is.
    Look,
    Arm,
    Disarm,
    /// Stop by the host.
    Stop,
    Clear,
    /// A set point; SI units.
    Set {
        #[serde(deserialize_with = "channel")]
        channel: ChannelId,
        #[serde(deserialize_with = "mode")]
        mode: Mode,
        value: f32,
    },
    /// The dead-man's handle.
    DeadMan {
        held: bool,
    },
    /// The auxiliary stop.
    AuxiliaryStop {
        pressed: bool,
    },
    /// What a range sensor sees; nothing without a distance.
    Distance {
        range: u8,
        #[serde(default, deserialize_with = "some_finite")]
        distance_m: Option<f64>,
    },
    /// A rail's voltage without load.
    Supply {
        #[serde(deserialize_with = "channel")]
        channel: ChannelId,
        #[serde(deserialize_with = "finite")]
        emf_v: f64,
    },
    /// What a motor drives blocks, or turns again.
    Block {
        #[serde(deserialize_with = "channel")]
        channel: ChannelId,
        blocked: bool,
    },
    /// The next transfers to an address on the board's bus are not acknowledged.
    BusNack {
        address: u8,
        transfers: u32,
    },
    /// The bus is held low from now on, for this long or until it is recovered.
    BusStuck {
        #[serde(deserialize_with = "seconds")]
        for_s: f64,
        persistent: bool,
    },
    /// The encoder's next edges are lost.
    LoseEdges {
        encoder: u8,
        count: u32,
    },
    /// The wire from the host is cut, or mended.
    HostCable {
        cut: bool,
    },
}

impl Action {
    /// What was done to the board, as a message names it.
    pub(super) fn what(&self) -> String {
        match self {
            Self::Arm => "arm".into(),
            Self::Disarm => "disarm".into(),
            Self::Stop => "stop".into(),
            Self::Clear => "clear".into(),
            Self::Set { channel, mode, value } => format!("set {channel} {mode} {value}"),
            // Done to what is around the board, which refuses nothing.
            _ => "step".into(),
        }
    }
}

/// Longer than any scenario, s.
const LONGEST_S: f64 = 1e6;

fn seconds<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    let seconds = f64::deserialize(deserializer)?;
    if (0.0..=LONGEST_S).contains(&seconds) {
        return Ok(seconds);
    }
    Err(D::Error::custom(format!("times are 0 to {LONGEST_S} s, not {seconds}")))
}

fn finite<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    let number = f64::deserialize(deserializer)?;
    if number.is_finite() { Ok(number) } else { Err(D::Error::custom(format!("{number} is no finite number"))) }
}

fn some_finite<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<f64>, D::Error> {
    finite(deserializer).map(Some)
}

fn channel<'de, D: Deserializer<'de>>(deserializer: D) -> Result<ChannelId, D::Error> {
    let text = String::deserialize(deserializer)?;
    text.parse().map_err(|problem| D::Error::custom(format!("`{text}`: {problem}")))
}

fn mode<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Mode, D::Error> {
    use Mode::{Brake, Duty, Home, Position, Speed, Switch, Voltage};
    let text = String::deserialize(deserializer)?;
    let known = [Position, Speed, Duty, Switch, Voltage, Brake, Home];
    let mode = known.into_iter().find(|mode| mode.to_string() == text);
    mode.ok_or_else(|| {
        D::Error::custom(format!("`{text}` is no mode: {}", known.map(|mode| mode.to_string()).join(", ")))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn steps(line: &str) -> Result<Scenario, toml::de::Error> {
        toml::from_str(&format!("robot = \"osmc-bench\"\nsteps = [{line}]"))
    }

    #[test]
    fn steps_are_read_by_what_they_do() {
        let scenario =
            steps(r#"{ at_s = 0.5, do = "set", channel = "osmc0", mode = "duty", value = 0.5 }"#).expect("right");
        assert!(matches!(scenario.steps[0].action, Action::Set { mode: Mode::Duty, value: 0.5, .. }));
        assert!(matches!(steps(r#"{ at_s = 1, do = "arm" }"#).expect("right").steps[0].action, Action::Arm));
    }

    #[test]
    fn what_means_nothing_is_refused_by_its_name() {
        for (line, word) in [
            (r#"{ at_s = 1.0, do = "amr" }"#, "amr"),
            (r#"{ at_s = 1.0, do = "dead-man", holt = true }"#, "holt"),
            (r#"{ at_s = 1.0, do = "set", channel = "osmc0", mode = "fast", value = 1.0 }"#, "`fast` is no mode"),
            (r#"{ at_s = 1.0, do = "block", channel = "motor7", blocked = true }"#, "motor7"),
            (r#"{ do = "arm" }"#, "at_s"),
            (r#"{ at_s = nan, do = "arm" }"#, "not NaN"),
            (r#"{ at_s = -1.0, do = "arm" }"#, "not -1"),
            (r#"{ at_s = 1.0, do = "bus-stuck", for_s = 1e30, persistent = true }"#, "1000000 s"),
            (r#"{ at_s = 1.0, do = "supply", channel = "supply0", emf_v = inf }"#, "inf is no"),
            (r#"{ at_s = 1.0, do = "distance", range = 0, distance_m = nan }"#, "NaN is no"),
        ] {
            let problem = steps(line).expect_err(line).to_string();
            assert!(problem.contains(word), "{line}: {problem}");
        }
    }
}
