//! `r4 ros2`: the board as a ROS 2 node, in programs that are built with it.

use crate::args::Args;

/// Commands come on `cmd_vel` (`geometry_msgs/TwistStamped`), `cmd_vel_unstamped` (`Twist`) and `joint_commands`
/// (`JointState`); `odom`, `/tf`, `joint_states`, sensors, `/diagnostics` and `~/state` are published. Nothing moves
/// before the service `~/arm` is called; `true` on `estop` (`std_msgs/Bool`) or the service `~/estop` trips the board,
/// `~/clear` clears a trip. Motors stop when no command arrives for the board's link time-out. The environment
/// variables ROS_DOMAIN_ID, ROS_AUTOMATIC_DISCOVERY_RANGE, ROS_LOCALHOST_ONLY and RMW_IMPLEMENTATION have their
/// meanings of ROS. No ROS installation is needed. `docs/ros2.md` has the topics, frames and units.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Ros2 {
    /// Namespace of the node, its topics and its services; example: robot1
    #[arg(long, value_name = "NAMESPACE", default_value = "", hide_default_value = true)]
    pub(crate) namespace: String,
    /// Do not publish the transform from odom to base_link, for example where a filter node does
    #[arg(long)]
    pub(crate) no_tf: bool,
}

/// Error of programs that are built without the feature `ros2`.
#[cfg(not(feature = "ros2"))]
#[derive(Debug, thiserror::Error)]
#[error(
    "this r4 was built without ROS 2. Build one with it, in the repository:\n  \
     cargo install --locked --path host/cli --features ros2"
)]
struct NotBuilt;

#[cfg(not(feature = "ros2"))]
pub(crate) fn run(_: &Args, _: &Ros2) -> anyhow::Result<bool> {
    Err(NotBuilt.into())
}

#[cfg(feature = "ros2")]
pub(crate) fn run(args: &Args, ros2: &Ros2) -> anyhow::Result<bool> {
    use r4_ros2::{
        Discovery, Door, Namespace, RosClock, Stamp,
        dds::{Node, NodeError},
    };
    use r4_sim::Pace;

    use crate::{output, session};

    if args.pace == Some(Pace::Free) {
        anyhow::bail!(
            "--pace max: other nodes run in real time, by which commands time out; omit --pace, or give a factor"
        );
    }
    let namespace: Namespace = ros2.namespace.parse()?;
    let discovery = Discovery::from_environment()?;
    let served = session::run(args, Pace::RealTime(1.0), async |session| {
        let clock = if session.target().is_virtual() {
            RosClock::Simulated { start: Stamp::of_machine() }
        } else {
            RosClock::Machine
        };
        let serve = async {
            let node = Node::open(session, discovery, &namespace)?;
            let (name, board) = (namespace.resolve("~/"), args.board.described());
            output::line(format_args!("node {} for {board}; {discovery}", name.trim_end_matches('/')))?;
            let served = node.serve(session, Door { clock, has_transform: !ros2.no_tf }).await;
            served.map_err(|error| match error {
                // Unwrapped, so that the exit code follows from the board's error.
                NodeError::Board(error) => anyhow::Error::from(error),
                error => anyhow::Error::from(error),
            })
        };
        serve.await
    });
    served.map(|_| true)
}
