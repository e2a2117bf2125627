//! Messages of `/diagnostics`: state of the board, causes of a trip, and advice.

use r4_protocol::{Causes, HotWinding, SafetyState};

use crate::message::{DiagnosticArray, DiagnosticStatus, Header, KeyValue, Level, Time};

/// State of a board and its node, as diagnostics report it.
#[derive(Clone, Debug, PartialEq)]
pub struct Health {
    /// Name of the robot, as the board reports it.
    pub robot: String,
    /// Name of the board, as it was opened.
    pub board: String,
    /// Version of the board's firmware.
    pub firmware: String,
    /// State of the board's safety supervisor.
    pub state: SafetyState,
    /// Causes of the trip; none unless tripped.
    pub causes: Causes,
    /// Windings close to their thermal limit.
    pub hot: Vec<HotWinding>,
    /// State of the node; `None` for a log, which has none.
    pub node: Option<NodeHealth>,
}

/// State of the node and of its link, in diagnostics.
#[derive(Clone, Debug, PartialEq)]
pub struct NodeHealth {
    /// True while the e-stop topic is engaged.
    pub is_estop_engaged: bool,
    /// Lease of a command, s: without another one the board brings the motors to rest.
    pub timeout_s: f64,
    /// Number of commands that the board accepted.
    pub taken: u64,
    /// Number of commands that the node or the board refused.
    pub refused: u64,
    /// Reason for the refusal of the newest command; `None` when it was accepted.
    pub refusal: Option<String>,
    /// Number of messages that could not be published.
    pub unpublished: u64,
    /// Number of damaged frames from the board.
    pub bad_frames: u64,
}

/// Returns the supervisor's state as `~/state` publishes it: `armed`, `disarmed`, `tripped: link lost`.
#[must_use]
pub fn state(state: SafetyState, causes: Causes) -> String {
    match state {
        SafetyState::Tripped => format!("{state}: {causes}"),
        SafetyState::Armed | SafetyState::Disarmed => state.to_string(),
    }
}

impl Health {
    /// Returns the message with one status for the supervisor, one for commands (not for a log), and one for motors.
    #[must_use]
    pub fn diagnostics(&self, stamp: Time) -> DiagnosticArray {
        let commands = self.node.as_ref().map(|node| self.commands(node));
        let status = [Some(self.supervisor()), commands, Some(self.motors())].into_iter().flatten().collect();
        DiagnosticArray { header: Header::new(stamp, ""), status }
    }

    fn status(&self, part: &str, (level, message): (Level, String), values: &[(&str, String)]) -> DiagnosticStatus {
        let value = |(key, value): &(&str, String)| KeyValue { key: (*key).to_owned(), value: value.clone() };
        DiagnosticStatus {
            level: level as u8,
            name: format!("{}: {part}", self.robot),
            message,
            hardware_id: self.board.clone(),
            values: values.iter().map(value).collect(),
        }
    }

    fn supervisor(&self) -> DiagnosticStatus {
        // A trip is an error and comes first; an engaged e-stop topic, which usually caused it, is only a warning.
        let at = state(self.state, self.causes);
        let said = match self.state {
            SafetyState::Tripped => {
                let advice: Vec<_> = self.causes.iter().map(|cause| cause.advice()).collect();
                (Level::Error, format!("{at}; {}; then ~/clear", advice.join("; ")))
            }
            _ if self.node.as_ref().is_some_and(|node| node.is_estop_engaged) => {
                (Level::Warn, format!("{at}; the e-stop topic is engaged"))
            }
            SafetyState::Disarmed => (Level::Ok, format!("{at}; ~/arm permits motion")),
            SafetyState::Armed => (Level::Ok, at),
        };
        let mut values = vec![
            ("state", self.state.to_string()),
            ("causes", self.causes.to_string()),
            ("firmware", self.firmware.clone()),
        ];
        if let Some(NodeHealth { is_estop_engaged, bad_frames, .. }) = &self.node {
            values.push(("e-stop topic", if *is_estop_engaged { "engaged" } else { "released" }.to_owned()));
            values.push(("damaged frames", bad_frames.to_string()));
        }
        self.status("supervisor", said, &values)
    }

    fn commands(&self, node: &NodeHealth) -> DiagnosticStatus {
        let said = match &node.refusal {
            Some(why) => (Level::Warn, format!("the newest command was refused: {why}")),
            None => (Level::Ok, "taken".to_owned()),
        };
        self.status(
            "commands",
            said,
            &[
                ("taken", node.taken.to_string()),
                ("refused", node.refused.to_string()),
                ("motors stop without a command after, s", node.timeout_s.to_string()),
                ("messages not published", node.unpublished.to_string()),
            ],
        )
    }

    fn motors(&self) -> DiagnosticStatus {
        let hot = |winding: &HotWinding| format!("{} at {} %", winding.channel, winding.heat_percent);
        let said = match &self.hot[..] {
            [] => (Level::Ok, "windings are cool".to_owned()),
            some => {
                let names = some.iter().map(hot).collect::<Vec<_>>().join(", ");
                (Level::Warn, format!("hot windings: {names} of the thermal limit; reduce the load"))
            }
        };
        self.status("motors", said, &[])
    }
}

#[cfg(test)]
mod tests {
    use r4_protocol::{Cause, ChannelId, ChannelKind};

    use super::*;

    fn node() -> NodeHealth {
        NodeHealth {
            is_estop_engaged: false,
            timeout_s: 0.2,
            taken: 3,
            refused: 0,
            refusal: None,
            unpublished: 0,
            bad_frames: 0,
        }
    }

    fn health() -> Health {
        Health {
            robot: "openscout".into(),
            board: "sim:openscout".into(),
            firmware: "0.1.0".into(),
            state: SafetyState::Armed,
            causes: Causes::NONE,
            hot: Vec::new(),
            node: Some(node()),
        }
    }

    #[test]
    fn a_trip_says_why_and_what_to_do() {
        let causes = Causes::only(Cause::LinkLost);
        let tripped = Health { state: SafetyState::Tripped, causes, ..health() };
        let [supervisor, commands, motors] = &tripped.diagnostics(Time::default()).status[..] else { panic!("three") };
        assert_eq!((supervisor.level, supervisor.hardware_id.as_str()), (2, "sim:openscout"));
        assert!(supervisor.message.starts_with("tripped: link lost; ") && supervisor.message.ends_with("then ~/clear"));
        assert!(supervisor.message.contains(Cause::LinkLost.advice()));
        assert_eq!((commands.level, motors.level), (0, 0));
        assert_eq!(state(SafetyState::Tripped, causes), "tripped: link lost");
    }

    #[test]
    fn what_someone_should_look_at_is_a_warning() {
        let hot = vec![HotWinding { channel: ChannelId::new(ChannelKind::Dhb, 1), heat_percent: 93 }];
        let node = NodeHealth { refusal: Some("too old".into()), is_estop_engaged: true, ..node() };
        let warned = Health { hot, node: Some(node), ..health() };
        let status = warned.diagnostics(Time::default()).status;
        assert_eq!(status.iter().map(|status| status.level).collect::<Vec<_>>(), [1, 1, 1]);
        assert!(status[2].message.contains("dhb1 at 93 %") && status[1].message.ends_with("too old"));
        let well = health().diagnostics(Time::default()).status;
        assert!(well.iter().all(|status| status.level == 0));
    }
}
