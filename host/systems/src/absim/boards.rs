//! Full fidelity: each robot is a board, whose firmware turns wheels that carry a body.

use std::{cell::RefCell, collections::VecDeque};

use futures::channel::mpsc::{UnboundedReceiver, UnboundedSender, unbounded};
use r4_boards::{Drive, SkidSteer};
use r4_driver::TelemetryStream;
use r4_protocol::{Mode, SafetyState};
use r4_rig::{
    Error as RigError, Fleet, Follower, GroundDrive, Limits, Odometry, Place, Rig, Session, Velocity, sides_rad,
};

use super::{
    fleet::{Fidelity, Run},
    mission::{Input, Mission, Order},
    wall::Wall,
};
use crate::{Error, Trial};

/// Period of the program on the host, ms: that of the wheels' telemetry.
pub(super) const PERIOD_MS: u16 = 20;
/// Time to live of the wheels' set points, ms: five periods.
const SETPOINT_TTL_MS: u16 = 100;

/// Limits of the robots' motion. Four fifths of the top speed leave the outer wheels a margin for curves: the follower
/// turns on the spot from 0.35 rad off the bow on, so that it requests at most 0.7 rad/s while it travels, and 9.3 of
/// 9.5 rad/s of openscout's wheels.
pub(super) fn limits(drive: &SkidSteer) -> Limits {
    Limits {
        speed_m_s: 0.8 * drive.speed_max_m_s,
        turn_rate_rad_s: 1.0,
        braking_m_s2: 0.5,
        stop_m: 0.0,
        reached_m: 0.05,
    }
}

/// A leg driven by a board, from rest to rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DrivenLeg {
    /// Start of the leg, by odometry.
    pub from: Place,
    /// Goal of the leg, m.
    pub goal_m: [f64; 2],
    /// Duration of the leg, s.
    pub duration_s: f64,
}

/// Record of one board's robot.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Driven {
    /// Legs in the order in which they were driven.
    pub legs: Vec<DrivenLeg>,
    /// Time, s, and true position, m, once each period.
    pub path: Vec<(f64, [f64; 2])>,
    /// Distance between odometry and truth at each sample, m.
    pub off_m: Vec<f64>,
}

/// Runs a mission in which every robot is a board of the trial's kind. `released` names a robot and the time, s, at
/// which its dead man is released.
///
/// # Errors
/// [`Error::Unsuitable`] when the board is no skid-steer robot with a body; another error when a session fails.
pub fn run(
    trial: &Trial,
    mission: Mission,
    wall: Wall,
    released: Option<(usize, f64)>,
) -> Result<(Run<Mission>, Vec<Driven>), Error> {
    let drive = skid_steer(trial)?;
    let scene = mission.scene().clone();
    let rigs = (0..scene.robots).map(|robot| {
        let mut rig = Rig::new(trial.board.clone());
        rig.seed = trial.seed.wrapping_mul(1_000).wrapping_add(robot as u64);
        rig
    });
    let fleet = Fleet::new(rigs.collect());
    let (reports, reported) = unbounded();
    let (senders, inboxes): (Vec<_>, VecDeque<_>) = (0..scene.robots).map(|_| unbounded()).unzip();
    let inboxes: RefCell<VecDeque<Option<UnboundedReceiver<Order>>>> =
        RefCell::new(inboxes.into_iter().map(Some).collect());
    let robots = senders.into_iter().map(Fidelity::Board).collect();
    let member = async |robot: usize, session: &Session<'_>| {
        let Some(orders) = inboxes.borrow_mut()[robot].take() else { return Ok(Driven::default()) };
        let start = scene.starts[robot];
        let truth = Truth::of(session, start);
        let mut pilot = Pilot {
            session,
            robot,
            drive: &drive,
            start,
            truth,
            reports: reports.clone(),
            odometry: Odometry::new(&drive),
            driven: Driven::default(),
            release_s: released.filter(|(other, _)| *other == robot).map(|(_, at_s)| at_s),
        };
        pilot.fly(orders).await?;
        Ok::<_, Error>(pilot.driven)
    };
    let work = async move |clock: &r4_rig::HostClock| {
        let mut run = Run::new(mission, robots, wall);
        run.drive(clock, reported).await?;
        // The members end when their senders are dropped.
        run.robots.clear();
        Ok(run)
    };
    let (run, driven, _) = fleet.run(member, work)?;
    Ok((run, driven))
}

/// Returns the skid-steer drive of a trial's robot.
///
/// # Errors
/// [`Error::Unsuitable`] when the robot has no such drive, or no body.
pub fn skid_steer(trial: &Trial) -> Result<SkidSteer, Error> {
    let unsuitable =
        |why: &str| Error::Unsuitable { system: super::NAME, board: trial.board.to_string(), why: why.to_owned() };
    let robot = Rig::new(trial.board.clone()).robot()?;
    if robot.simulation.body.as_ref().and_then(|body| body.wheeled()).is_none() {
        return Err(unsuitable("it has no [body.wheeled]"));
    }
    match robot.drive {
        Some(Drive::SkidSteer(drive)) => Ok(drive),
        _ => Err(unsuitable("it has no [drive.skid-steer]")),
    }
}

/// Transformation of a body's true pose in its own world to the mission's field.
struct Truth {
    first: Option<Place>,
    start: Place,
}

impl Truth {
    fn of(session: &Session<'_>, start: Place) -> Self {
        Self { first: session.true_place(), start }
    }

    fn place(&self, session: &Session<'_>) -> Option<Place> {
        let (first, now) = (self.first?, session.true_place()?);
        let (x_m, y_m) = (now.x_m - first.x_m, now.y_m - first.y_m);
        let (sin, cos) = first.yaw_rad.sin_cos();
        let yaw_rad = now.yaw_rad - first.yaw_rad;
        Some(moved(self.start, Place { x_m: cos * x_m + sin * y_m, y_m: cos * y_m - sin * x_m, yaw_rad }))
    }
}

/// Converts a pose in the frame of `from` to the frame in which `from` is given.
fn moved(from: Place, by: Place) -> Place {
    let (sin, cos) = from.yaw_rad.sin_cos();
    Place {
        x_m: from.x_m + cos * by.x_m - sin * by.y_m,
        y_m: from.y_m + sin * by.x_m + cos * by.y_m,
        yaw_rad: from.yaw_rad + by.yaw_rad,
    }
}

/// Activity of a robot.
enum Doing {
    Waiting,
    Driving { follower: Follower, since: (f64, Place), goal_m: [f64; 2], driven_m: f64 },
    Sampling { until_s: f64 },
}

/// Program that drives one robot by its board.
struct Pilot<'s> {
    session: &'s Session<'s>,
    robot: usize,
    drive: &'s SkidSteer,
    start: Place,
    truth: Truth,
    reports: UnboundedSender<Input>,
    odometry: Odometry,
    driven: Driven,
    release_s: Option<f64>,
}

impl Pilot<'_> {
    /// Carries out orders until their channel closes or the board stops.
    async fn fly(&mut self, mut orders: UnboundedReceiver<Order>) -> Result<(), RigError> {
        let board = self.session.board;
        let wheels: Vec<_> = self.drive.left.iter().chain(&self.drive.right).copied().collect();
        let telemetry = board.telemetry();
        for channel in &wheels {
            board.subscribe(*channel, PERIOD_MS).await?;
        }
        board.arm().await.map_err(RigError::Arm)?;
        match self.follow(telemetry, &wheels, &mut orders).await {
            Ok(()) => board.disarm().await.map_err(RigError::Disarm),
            // A stop of the board is a result: the mission gives its goals to other robots.
            Err(RigError::Board(error @ (r4_driver::Error::Stopped { .. } | r4_driver::Error::Refused(_)))) => {
                self.report(Input::Failed(self.robot, error.to_string()));
                Ok(())
            }
            Err(error) => Err(error),
        }
    }

    fn report(&self, input: Input) {
        // Sending fails only when the mission is over and the coordinator is gone.
        drop(self.reports.unbounded_send(input));
    }

    async fn follow(
        &mut self,
        mut telemetry: TelemetryStream,
        wheels: &[r4_protocol::ChannelId],
        orders: &mut UnboundedReceiver<Order>,
    ) -> Result<(), RigError> {
        let board = self.session.board;
        let ground = GroundDrive::new(Drive::SkidSteer(self.drive.clone()));
        let speeds: Vec<_> = wheels.iter().map(|channel| (*channel, Mode::Speed)).collect();
        let mut setpoints = board.stream(&speeds, SETPOINT_TTL_MS).await?;
        let mut doing = Doing::Waiting;
        loop {
            let frame = telemetry.next().await?;
            if frame.state == SafetyState::Tripped {
                return Err(r4_driver::Error::Stopped { causes: frame.causes }.into());
            }
            let Some([left_rad, right_rad]) = sides_rad(board, self.drive, &frame.samples) else { continue };
            let before = self.odometry.place();
            self.odometry.look(left_rad, right_rad);
            let now_s = board.now_s();
            if let Some(place) = self.truth.place(self.session) {
                self.driven.path.push((now_s, [place.x_m, place.y_m]));
            }
            if self.release_s.take_if(|at_s| now_s >= *at_s).is_some() {
                self.session.virtual_board()?.dead_man().set(false);
            }
            let at = moved(self.start, self.odometry.place());
            match orders.try_recv() {
                Ok(order) => doing = self.begin(order, doing, now_s, at),
                // The coordinator has dropped its end: the mission is over.
                Err(error) if error.is_closed() => return Ok(()),
                Err(_) => {}
            }
            let mut velocity = Velocity::default();
            match &mut doing {
                Doing::Waiting => {}
                Doing::Driving { follower, since, goal_m, driven_m } => {
                    let step = self.odometry.place();
                    *driven_m += (step.x_m - before.x_m).hypot(step.y_m - before.y_m);
                    if let Some(next) = follower.velocity(at, f64::INFINITY) {
                        velocity = next;
                    } else {
                        let (since_s, from) = *since;
                        self.driven.legs.push(DrivenLeg { from, goal_m: *goal_m, duration_s: now_s - since_s });
                        self.report(Input::Arrived(self.robot, *driven_m));
                        doing = Doing::Waiting;
                    }
                }
                Doing::Sampling { until_s } if now_s >= *until_s => {
                    let truth = self.truth.place(self.session).unwrap_or(at);
                    self.driven.off_m.push((truth.x_m - at.x_m).hypot(truth.y_m - at.y_m));
                    self.report(Input::Sampled(self.robot, [truth.x_m, truth.y_m]));
                    doing = Doing::Waiting;
                }
                Doing::Sampling { .. } => {}
            }
            let values: Vec<f64> =
                ground.setpoints(velocity).iter().map(|(_, setpoint)| f64::from(setpoint.value)).collect();
            setpoints.set(&values)?;
        }
    }

    fn begin(&self, order: Order, doing: Doing, now_s: f64, at: Place) -> Doing {
        match order {
            Order::Go { goal_m, .. } => Doing::Driving {
                follower: Follower::new(limits(self.drive), [goal_m]),
                since: (now_s, at),
                goal_m,
                driven_m: 0.0,
            },
            Order::Sample { for_s, .. } => Doing::Sampling { until_s: now_s + for_s },
            Order::Stop { .. } => {
                let driven_m = if let Doing::Driving { driven_m, .. } = doing { driven_m } else { 0.0 };
                self.report(Input::Stopped(self.robot, driven_m));
                Doing::Waiting
            }
            Order::Plan(_) | Order::End => doing,
        }
    }
}
