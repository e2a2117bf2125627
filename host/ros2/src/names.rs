//! Names of the node, its topics and its services.

use std::borrow::Cow;

use r4_protocol::{ChannelId, ChannelKind};

/// Name of the node.
pub const NODE: &str = "r4";

/// Error of a text that is no valid namespace of ROS.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{asked:?} is not a namespace: give names of letters, digits and single underscores that begin with a letter, separated by \
     slashes, as in robot1 or fleet/robot1"
)]
pub struct NotANamespace {
    asked: String,
}

/// Namespace of ROS as a list of names from the root.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Namespace(Vec<String>);

impl std::str::FromStr for Namespace {
    type Err = NotANamespace;

    fn from_str(asked: &str) -> Result<Self, NotANamespace> {
        let tokens: Vec<String> = match asked.strip_prefix('/').unwrap_or(asked) {
            "" => Vec::new(),
            names => names.split('/').map(str::to_owned).collect(),
        };
        // The rules of ROS 2 for names, which also forbid repeated underscores.
        let is_name = |token: &String| {
            token.starts_with(|first: char| first.is_ascii_alphabetic())
                && token.chars().all(|letter| letter.is_ascii_alphanumeric() || letter == '_')
                && !token.contains("__")
        };
        if tokens.iter().all(is_name) { Ok(Self(tokens)) } else { Err(NotANamespace { asked: asked.to_owned() }) }
    }
}

impl Namespace {
    /// Returns the root, in which names have no prefix.
    #[must_use]
    pub fn root() -> Self {
        Self(Vec::new())
    }

    /// Returns the namespace as an absolute name: `/`, or `/fleet/robot1`.
    #[must_use]
    pub fn absolute(&self) -> String {
        format!("/{}", self.0.join("/"))
    }

    /// Returns the absolute name of a topic or service. A leading slash marks a name that is absolute already, `~/` one below the node's
    /// own name.
    #[must_use]
    pub fn resolve(&self, name: &str) -> String {
        let tokens = self.0.iter().map(String::as_str);
        let own = match (name.strip_prefix('/'), name.strip_prefix("~/")) {
            (Some(_), _) => return name.to_owned(),
            (None, Some(own)) => tokens.chain([NODE, own]).collect::<Vec<_>>(),
            (None, None) => tokens.chain([name]).collect(),
        };
        format!("/{}", own.join("/"))
    }
}

/// Topic that the node publishes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Topic {
    /// Relative or absolute name, for [`Namespace::resolve`].
    pub name: Cow<'static, str>,
    /// Type of its messages, as in `sensor_msgs/Imu`.
    pub kind: &'static str,
    /// True when readers that subscribe later receive the last message.
    pub is_latched: bool,
}

impl Topic {
    const fn new(name: &'static str, kind: &'static str) -> Self {
        Self { name: Cow::Borrowed(name), kind, is_latched: false }
    }

    const fn latched(name: &'static str, kind: &'static str) -> Self {
        Self { name: Cow::Borrowed(name), kind, is_latched: true }
    }
}

/// Topic of the odometry.
pub const ODOMETRY: Topic = Topic::new("odom", "nav_msgs/Odometry");
/// Topic of transforms between frames.
pub const TRANSFORM: Topic = Topic::new("/tf", "tf2_msgs/TFMessage");
/// Topic of motors, steppers and encoders.
pub const JOINTS: Topic = Topic::new("joint_states", "sensor_msgs/JointState");
/// Topic of the board's state with advice.
pub const DIAGNOSTICS: Topic = Topic::new("/diagnostics", "diagnostic_msgs/DiagnosticArray");
/// Topic of the supervisor's state.
pub const STATE: Topic = Topic::latched("~/state", "std_msgs/String");
/// Topic of velocities that the board has accepted.
pub const COMMANDED: Topic = Topic::new("~/cmd_vel_out", "geometry_msgs/TwistStamped");
/// Topic of simulated time.
pub const CLOCK: Topic = Topic::new("/clock", "rosgraph_msgs/Clock");

/// Returns the topic of a channel's readings. The first IMU and the first supply have the names that programs expect. `None` for a
/// channel that is in `joint_states` or not published.
#[must_use]
pub fn topic(channel: ChannelId) -> Option<Topic> {
    let ChannelId { kind, index } = channel;
    let (name, kind) = match (kind, index) {
        (ChannelKind::Imu, 0) => ("imu/data".to_owned(), "sensor_msgs/Imu"),
        (ChannelKind::Imu, _) => (format!("imu{index}/data"), "sensor_msgs/Imu"),
        // ROS refuses a part of a name that begins with a digit, as in range/0.
        (ChannelKind::Range | ChannelKind::Distance, _) => (channel.to_string(), "sensor_msgs/Range"),
        (ChannelKind::Supply, 0) => ("battery_state".to_owned(), "sensor_msgs/BatteryState"),
        (ChannelKind::Supply, _) => (format!("supply{index}/battery_state"), "sensor_msgs/BatteryState"),
        _ => return None,
    };
    Some(Topic { name: Cow::Owned(name), kind, is_latched: false })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_absolute_once_resolved() {
        for (namespace, name, resolved) in [
            ("", "cmd_vel", "/cmd_vel"),
            ("/", "cmd_vel", "/cmd_vel"),
            ("", "~/arm", "/r4/arm"),
            ("robot1", "imu/data", "/robot1/imu/data"),
            ("/fleet/robot1", "~/arm", "/fleet/robot1/r4/arm"),
            ("robot1", "/diagnostics", "/diagnostics"),
        ] {
            let namespace: Namespace = namespace.parse().expect(namespace);
            assert_eq!(namespace.resolve(name), resolved);
        }
        for (channel, name) in [("range1", "range1"), ("imu0", "imu/data"), ("supply1", "supply1/battery_state")] {
            assert_eq!(topic(channel.parse().expect("a channel")).expect("a topic").name, name);
        }
        assert_eq!("a/b".parse::<Namespace>().expect("a namespace").absolute(), "/a/b");
        assert_eq!("".parse::<Namespace>().expect("the root").absolute(), "/");
    }

    #[test]
    fn others_are_refused() {
        for bad in ["1robot", "robot-1", "a//b", "a/", "a__b", "~", "röbot", "a b"] {
            assert!(bad.parse::<Namespace>().is_err(), "{bad}");
        }
    }
}
