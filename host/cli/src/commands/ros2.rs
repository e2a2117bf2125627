//! Command `r4 ros2`: a board as a ROS 2 node, in programs that are built with the feature `ros2`.

#[cfg(not(feature = "ros2"))]
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
    /// Be a managed node: configuring it opens a session with the board, activating it arms the board
    #[arg(long)]
    pub(crate) lifecycle: bool,
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
pub(crate) use node::run;

#[cfg(feature = "ros2")]
mod node {
    use std::time::Duration;

    use anyhow::{bail, ensure};
    use r4_ros2::{
        Discovery, Door, Ended, Namespace, RosClock, Stamp,
        dds::{Graph, Lifecycle, Node, NodeError},
        lifecycle::{Change, Transition, Unasked},
    };
    use r4_sim::Pace;

    use super::Ros2;
    use crate::{
        args::Args,
        output,
        session::{self, Interrupted, Session},
    };

    /// Period of the check for Ctrl-C while there is no session.
    const LOOK_EVERY: Duration = Duration::from_millis(50);
    /// Time for DDS to send the answer to a shutdown, which it does on a thread that ends with this program. Our choice, not
    /// tuned.
    const FAREWELL: Duration = Duration::from_millis(200);

    pub(crate) fn run(args: &Args, ros2: &Ros2) -> anyhow::Result<bool> {
        if args.pace == Some(Pace::Free) {
            bail!(
                "--pace max: other nodes run in real time, by which commands time out; omit --pace, or give a factor"
            );
        }
        let namespace: Namespace = ros2.namespace.parse()?;
        let discovery = Discovery::from_environment()?;
        if ros2.lifecycle {
            ensure!(
                args.record.is_none(),
                "--record and --lifecycle: each `configure` would overwrite the file; record with ros2 bag"
            );
            return managed(args, ros2, &namespace, discovery);
        }
        let served = session::run(args, Pace::RealTime(1.0), async |session| {
            let door = door(session, ros2);
            let mut graph = Graph::join(discovery, &namespace)?;
            let node = Node::open(session, &mut graph)?;
            // Announced once topics and services exist, so that a script can use them from this line on.
            announce(args, &namespace, discovery, "")?;
            node.serve(session, door).await.map_err(of_board)
        });
        served.map(|_| true)
    }

    fn door(session: &Session<'_>, ros2: &Ros2) -> Door {
        let clock = if session.target().is_virtual() {
            RosClock::Simulated { start: Stamp::of_machine() }
        } else {
            RosClock::Machine
        };
        Door { clock, has_transform: !ros2.no_tf, is_managed: ros2.lifecycle }
    }

    fn announce(args: &Args, namespace: &Namespace, discovery: Discovery, how: &str) -> anyhow::Result<()> {
        let (name, board) = (namespace.resolve("~/"), args.board.described());
        Ok(output::line(format_args!("node {} for {board}; {discovery}{how}", name.trim_end_matches('/')))?)
    }

    /// Unwraps the board's error, so that the exit code follows from it.
    fn of_board(error: NodeError) -> anyhow::Error {
        match error {
            NodeError::Board(error) => error.into(),
            error => error.into(),
        }
    }

    /// Serves a managed node: a session lasts from each transition `configure` to the next `cleanup`, or until it fails.
    fn managed(args: &Args, ros2: &Ros2, namespace: &Namespace, discovery: Discovery) -> anyhow::Result<bool> {
        session::catch_interrupts();
        let mut graph = Graph::join(discovery, namespace)?;
        let mut lifecycle = Lifecycle::open(&mut graph)?;
        announce(args, namespace, discovery, "; managed, unconfigured")?;
        loop {
            let Change { transition, answer } = r4_links::block_on(asked(&mut lifecycle))?;
            if transition == Transition::Shutdown {
                farewell(answer);
                return Ok(true);
            }
            // Answered once: by the session when it has started, or below when it could not start.
            let mut asked = Some(answer);
            let served = session::run(args, Pace::RealTime(1.0), async |session| {
                let door = door(session, ros2);
                let node = Node::open(session, &mut graph)?;
                if let Some(answer) = asked.take() {
                    // Only now, with a session and its topics, is the node configured. The caller may be gone by now.
                    let _ = answer.send(true);
                }
                node.serve_managed(session, door, &mut lifecycle).await.map_err(of_board)
            });
            match served {
                Ok((Ended::Session(Change { transition: Transition::Shutdown, answer }), _)) => {
                    farewell(answer);
                    return Ok(true);
                }
                Ok((Ended::Session(Change { answer, .. }), _)) => drop(answer.send(true)),
                Ok((Ended::Orders, _)) => return Ok(true),
                Err(error) if session::was_interrupted(&error) => return Err(error),
                Err(error) => {
                    eprintln!("r4: {error:#}; the node is unconfigured");
                    match asked {
                        // The session never started, so the requested `configure` has failed.
                        Some(answer) => drop(answer.send(false)),
                        None => lifecycle.note(Unasked::Failed),
                    }
                }
            }
        }
    }

    /// Waits for the next requested transition, or for Ctrl-C.
    async fn asked(lifecycle: &mut Lifecycle) -> anyhow::Result<Change> {
        use futures::future::{Either, select};

        loop {
            let look = std::pin::pin!(async_io::Timer::after(LOOK_EVERY));
            match select(std::pin::pin!(lifecycle.change()), look).await {
                Either::Left((change, _)) => return Ok(change),
                Either::Right(_) if session::is_interrupted() => return Err(Interrupted.into()),
                Either::Right(_) => {}
            }
        }
    }

    fn farewell(answer: futures::channel::oneshot::Sender<bool>) {
        // The caller may be gone by now.
        let _ = answer.send(true);
        std::thread::sleep(FAREWELL);
    }
}
