//! File format of a scenario.

use std::{
    fs,
    path::{Path, PathBuf},
};

use r4_protocol::{ChannelId, Mode};
use serde::{
    Deserialize, Deserializer,
    de::{Error, IgnoredAny},
};

use super::ScenarioError;
use crate::Rig;

/// Robot and timed steps of a scenario, as its file lists them.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scenario {
    /// Built-in name of the robot, or a file beside this one.
    pub robot: String,
    /// Steps in the order of time.
    pub steps: Vec<Step>,
    /// `[body]` and `[world]`, which [`Rig::robot`] reads for the robot of the board.
    #[serde(rename = "body")]
    _body: Option<IgnoredAny>,
    #[serde(rename = "world")]
    _world: Option<IgnoredAny>,
    /// Path of the scenario's file.
    #[serde(skip)]
    path: PathBuf,
}

/// An action with its time.
#[derive(Clone, Debug, Deserialize)]
pub struct Step {
    /// Time since the session began, s. A step whose time comes while another waits for its answer follows that answer.
    #[serde(deserialize_with = "seconds")]
    pub at_s: f64,
    /// Action of the step.
    #[serde(flatten)]
    pub action: Action,
}

/// A point of a path.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Point {
    /// Time after the step, s.
    #[serde(deserialize_with = "seconds")]
    pub after_s: f64,
    /// Position, rad or m.
    pub position: f32,
    /// Speed, rad/s or m/s; `None` lets the board compute it from the neighbouring points.
    pub speed: Option<f32>,
}

/// A request of the host, or a change of the board's environment.
#[derive(Clone, Debug, Deserialize)]
#[serde(tag = "do", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Action {
    /// Checkpoint: samples every position and the board's state.
    Look,
    /// The host arms the board.
    Arm,
    /// The host disarms the board.
    Disarm,
    /// The host stops the board.
    Stop,
    /// The host clears a trip.
    Clear,
    /// The host sends a set point.
    Set {
        /// Channel of the output.
        #[serde(deserialize_with = "channel")]
        channel: ChannelId,
        /// Mode of the set point.
        #[serde(deserialize_with = "mode")]
        mode: Mode,
        /// Value of the set point, SI.
        value: f32,
    },
    /// The host sends points of a path to a motor.
    Follow {
        /// Channel of the motor.
        #[serde(deserialize_with = "channel")]
        channel: ChannelId,
        /// Points of the path, with times relative to the step.
        points: Vec<Point>,
    },
    /// The host subscribes to a channel, so that a recording contains its samples.
    Subscribe {
        /// Channel whose samples are sent.
        #[serde(deserialize_with = "channel")]
        channel: ChannelId,
        /// Period of the samples, ms; 0 ends the subscription.
        period_ms: u16,
    },
    /// The operator holds or releases the dead man's handle.
    DeadMan {
        /// True while the handle is held.
        held: bool,
    },
    /// The operator presses or releases the auxiliary stop.
    AuxiliaryStop {
        /// True while the button is pressed.
        pressed: bool,
    },
    /// A range sensor detects an obstacle; without a distance it detects none.
    Distance {
        /// Index of the sensor.
        range: u8,
        /// Distance of the obstacle, m; `None` for none.
        #[serde(default, deserialize_with = "some_finite")]
        distance_m: Option<f64>,
    },
    /// The open-circuit voltage of a rail changes.
    Supply {
        /// Channel of the rail.
        #[serde(deserialize_with = "channel")]
        channel: ChannelId,
        /// New open-circuit voltage, V.
        #[serde(deserialize_with = "finite")]
        emf_v: f64,
    },
    /// The mechanism behind a motor blocks or is released.
    Block {
        /// Channel of the motor.
        #[serde(deserialize_with = "channel")]
        channel: ChannelId,
        /// True while it is blocked.
        blocked: bool,
    },
    /// A chip does not acknowledge the next transfers on the board's bus.
    BusNack {
        /// I²C address of the chip.
        address: u8,
        /// Number of transfers without acknowledgement.
        transfers: u32,
    },
    /// The bus is stuck low from now on.
    BusStuck {
        /// Duration of the fault, s.
        #[serde(deserialize_with = "seconds")]
        for_s: f64,
        /// True when it stays low after the nine clocks of a recovery.
        persistent: bool,
    },
    /// The next edges of an encoder are lost.
    LoseEdges {
        /// Index of the encoder.
        encoder: u8,
        /// Number of lost edges.
        count: u32,
    },
    /// The cable from the host is cut or restored.
    HostCable {
        /// True while it is cut.
        cut: bool,
    },
}

impl Scenario {
    /// Reads a scenario from the file at `path`.
    ///
    /// # Errors
    /// [`ScenarioError::NotReadable`], [`ScenarioError::Malformed`], or [`ScenarioError::NoSteps`] for an empty list of
    /// steps.
    pub fn read(path: &Path) -> Result<Self, ScenarioError> {
        let path = path.to_owned();
        let text = match fs::read_to_string(&path) {
            Ok(text) => text,
            Err(source) => return Err(ScenarioError::NotReadable { path, source }),
        };
        match toml::from_str::<Self>(&text) {
            Ok(scenario) if scenario.steps.is_empty() => Err(ScenarioError::NoSteps { path }),
            Ok(scenario) => Ok(Self { path, ..scenario }),
            Err(source) => Err(ScenarioError::Malformed { path, source: Box::new(source) }),
        }
    }

    /// Returns the rig with the scenario's `[body]` and `[world]`.
    #[must_use]
    pub fn set_up(&self, rig: Rig) -> Rig {
        Rig { environment: Some(self.path.clone()), ..rig }
    }
}

impl Action {
    /// Description of a request to the board, for messages about its refusal.
    pub(super) fn what(&self) -> String {
        match self {
            Self::Arm => "arm".into(),
            Self::Disarm => "disarm".into(),
            Self::Stop => "stop".into(),
            Self::Clear => "clear".into(),
            Self::Set { channel, mode, value } => format!("set {channel} {mode} {value}"),
            Self::Follow { channel, .. } => format!("follow {channel}"),
            Self::Subscribe { channel, .. } => format!("subscribe {channel}"),
            // Changes of the environment, which the board cannot refuse.
            _ => "step".into(),
        }
    }
}

/// Longest time in a scenario, s: far above any use, far below the range of a clock in nanoseconds.
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
    let text = String::deserialize(deserializer)?;
    // Points of paths have times, which a step of this kind does not contain.
    let known = || Mode::ALL.into_iter().filter(|mode| *mode != Mode::Follow);
    let mode = known().find(|mode| mode.to_string() == text);
    mode.ok_or_else(|| {
        let names: Vec<_> = known().map(|mode| mode.to_string()).collect();
        D::Error::custom(format!("`{text}` is no mode: {}", names.join(", ")))
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
    fn a_wrong_body_or_world_is_refused_by_line_and_field() {
        let robot = |tables: &str| {
            let file = tempfile::Builder::new().suffix(".toml").tempfile().expect("a file");
            let steps = r#"[{ at_s = 0.5, do = "arm" }]"#;
            fs::write(file.path(), format!("robot = \"openscout\"\nsteps = {steps}\n{tables}")).expect("written");
            let scenario = Scenario::read(file.path()).expect("the steps are right");
            scenario.set_up(Rig::new("sim:openscout".parse().expect("a board"))).robot()
        };
        let wall = "[[world.wall]]\npoints_m = [[1.0, -1.0], [1.0, 1.0]]\n";
        let own = robot("").expect("the robot's own");
        let walled = robot(wall).expect("a wall");
        assert_eq!(own.simulation.scene.walls_m().count(), 0);
        assert_eq!(walled.simulation.scene.walls_m().count(), 1);
        assert_eq!(walled.simulation.body, own.simulation.body);
        for (tables, at) in [
            ("[[world.wall]]\npoints = [[1.0, -1.0], [1.0, 1.0]]\n", "4: world.wall[0].points"),
            ("[[world.post]]\ncentre_m = [1.0, 0.0]\nradius_m = -0.1\n", "3: world.post[0]"),
            ("[body.wheeled]\nmass_kg = -9.0\n", "4: body.wheeled.mass_kg"),
        ] {
            let problem = robot(tables).expect_err(tables).to_string();
            assert!(problem.contains(&format!(".toml:{at}: ")), "{problem}");
        }
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
