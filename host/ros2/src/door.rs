//! The node in a session: orders from ROS to the board, readings of the board to ROS. It never arms and never clears by itself.

mod reports;
#[cfg(test)]
mod tests;

use std::{future::poll_fn, pin::pin, task::Poll};

use futures::{
    FutureExt, StreamExt,
    channel::{mpsc::UnboundedReceiver, oneshot},
    future::LocalBoxFuture,
    stream::FuturesUnordered,
};
use r4_boards::{Drive, SkidSteer};
use r4_driver::{Clock as _, CycleReport, Error as DriverError, TelemetryStream};
use r4_protocol::{Causes, ChannelId, CycleOutcome, SafetyState, Setpoint, Telemetry};
use r4_rig::{Error, GroundDrive, Odometry, Session, Velocity};

use crate::{
    BASE_FRAME,
    gate::{self, Gate, Refused},
    leased::{Binding, Bound, CYCLE_CHANNELS, Leased, Setpoints},
    message::{Header, JointState, TriggerResponse, Twist, TwistStamped, Vector3},
    time::{RosClock, Stamp},
};

pub use reports::Report;

/// What a service does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Request {
    /// `~/arm`: lets outputs move.
    Arm,
    /// `~/disarm`: makes outputs safe.
    Disarm,
    /// `~/clear`: leaves a trip behind.
    Clear,
    /// `~/estop`: trips.
    Stop,
}

/// Something from ROS.
#[derive(Debug)]
pub enum Order {
    /// A velocity over the ground.
    Velocity {
        /// When it was decided; `None` for a stamp that is no time.
        stamp: Option<Stamp>,
        /// The velocity.
        twist: Twist,
    },
    /// Set points of joints.
    Joints {
        /// When they were decided; `None` for a stamp that is no time.
        stamp: Option<Stamp>,
        /// The set points.
        joints: JointState,
    },
    /// The e-stop topic: engaged or released.
    Estop(bool),
    /// A message that cannot be read. Whatever it was, the commands before it end.
    Unreadable {
        /// Name of the topic.
        topic: &'static str,
        /// What is wrong with it.
        why: String,
    },
    /// A service call.
    Call {
        /// Of which.
        request: Request,
        /// Where its answer goes.
        answer: oneshot::Sender<TriggerResponse>,
    },
}

/// A board's side of a node.
#[derive(Clone, Copy, Debug)]
pub struct Door {
    /// ROS time.
    pub clock: RosClock,
    /// Whether `/tf` gets the transform from `odom` to `base_link`; off where something else, as a filter, gives it.
    pub has_transform: bool,
}

/// How often simulated time is published, and the supervisor's state is looked at, s.
const TICK_S: f64 = 0.01;
/// How often diagnostics are published where nothing changes, s.
const DIAGNOSE_EVERY_S: f64 = 1.0;

impl Door {
    /// Serves `orders` until all senders are gone. `report` publishes, and returns whether it could.
    ///
    /// # Errors
    /// When the link ends, or the board refuses subscriptions.
    pub async fn serve<'b>(
        &self,
        session: &'b Session<'b>,
        mut orders: UnboundedReceiver<Order>,
        report: impl FnMut(Report) -> bool,
    ) -> Result<(), Error> {
        let mut telemetry = session.board.telemetry();
        let mut serving = Serving::new(*self, session, report);
        serving.subscribe().await?;
        serving.prepare();
        serving.publish_state();
        let (mut tick_s, mut diagnose_s) = (session.board.now_s(), session.board.now_s());
        loop {
            match serving.event(&mut orders, &mut telemetry, tick_s).await {
                Event::Order(Order::Velocity { stamp, twist }) => {
                    serving.take(|serving| serving.velocity(stamp, &twist))
                }
                Event::Order(Order::Joints { stamp, joints }) => serving.take(|serving| serving.joints(stamp, &joints)),
                Event::Order(Order::Estop(is_engaged)) => serving.estop(is_engaged),
                Event::Order(Order::Unreadable { topic, why }) => {
                    serving.take(|_| Err(Refused::Unreadable { topic, why }));
                }
                Event::Order(Order::Call { request, answer }) => serving.call(request, Some(answer)),
                Event::Ended => return Ok(()),
                Event::Done(Done::Called { request, result, answer }) => serving.called(request, result, answer),
                Event::Done(Done::Bound(binding)) => serving.take(|serving| serving.bound(binding)),
                Event::Frame(frame) => serving.frame(&frame?),
                Event::Answer(answer) => {
                    let (report, command) = answer?;
                    serving.answered(&report, command);
                }
                Event::Tick => {
                    let now_s = session.board.now_s();
                    // From now on, also where the machine was busy elsewhere.
                    tick_s = now_s + TICK_S;
                    serving.tick();
                    if now_s >= diagnose_s {
                        diagnose_s = now_s + DIAGNOSE_EVERY_S;
                        serving.diagnose();
                    }
                }
            }
        }
    }
}

/// What ends a wait.
enum Event<'b> {
    Order(Order),
    Ended,
    Done(Done<'b>),
    Frame(Result<Telemetry, DriverError>),
    Answer(Result<(CycleReport, Option<Echo>), DriverError>),
    Tick,
}

/// What was asked of the board, done.
enum Done<'b> {
    Called { request: Request, result: Result<(), DriverError>, answer: Option<oneshot::Sender<TriggerResponse>> },
    Bound(Result<Bound<'b>, DriverError>),
}

/// What is published when the board has taken a command.
type Echo = Option<TwistStamped>;

struct Serving<'b, R> {
    door: Door,
    session: &'b Session<'b>,
    report: R,
    drive: Option<GroundDrive>,
    odometry: Option<(SkidSteer, Odometry)>,
    gate: Gate,
    leased: Leased<'b, Echo>,
    work: FuturesUnordered<LocalBoxFuture<'b, Done<'b>>>,
    /// As published last.
    safety: (SafetyState, Causes),
    is_estop_engaged: bool,
    is_stopping: bool,
    taken: u64,
    refused: u64,
    refusal: Option<String>,
    unpublished: u64,
}

impl<'b, R: FnMut(Report) -> bool> Serving<'b, R> {
    fn new(door: Door, session: &'b Session<'b>, report: R) -> Self {
        let board = session.board;
        let drive = session.ground_drive();
        let odometry = match drive.as_ref().map(GroundDrive::drive) {
            Some(Drive::SkidSteer(robot)) => Some((robot.clone(), Odometry::new(robot))),
            Some(Drive::Ackermann(_)) | None => None,
        };
        let timeout_ms = board.info().link_timeout_ms;
        Self {
            door,
            session,
            report,
            drive,
            odometry,
            gate: Gate::new(f64::from(timeout_ms) * 1e-3),
            leased: Leased::new(board, timeout_ms),
            work: FuturesUnordered::new(),
            safety: board.safety(),
            is_estop_engaged: false,
            is_stopping: false,
            taken: 0,
            refused: 0,
            refusal: None,
            unpublished: 0,
        }
    }

    fn now(&self) -> Stamp {
        self.door.clock.now(self.session.clock.now_us())
    }

    /// Binds the wheels, so that the first velocity does not wait for it.
    fn prepare(&mut self) {
        let Some(drive) = &self.drive else { return };
        let channels = drive.setpoints(Velocity::default()).iter().map(|(channel, set)| (*channel, set.mode)).collect();
        let binding = self.leased.prepare(channels);
        self.push(binding);
    }

    fn push(&mut self, binding: Option<Binding<'b>>) {
        self.work.extend(binding.map(|binding| binding.map(Done::Bound).boxed_local()));
    }

    /// Waits for what comes first. Orders go before the rest, an e-stop is one of them.
    async fn event(
        &mut self,
        orders: &mut UnboundedReceiver<Order>,
        telemetry: &mut TelemetryStream,
        tick_s: f64,
    ) -> Event<'b> {
        let board = self.session.board;
        let Self { leased, work, .. } = self;
        let (mut frame, mut answer) = (pin!(telemetry.next()), pin!(leased.answer()));
        let mut tick = pin!(board.sleep_s(tick_s - board.now_s()));
        poll_fn(|context| {
            if let Poll::Ready(order) = orders.poll_next_unpin(context) {
                return Poll::Ready(order.map_or(Event::Ended, Event::Order));
            }
            // None when nothing is under way.
            if let Poll::Ready(Some(done)) = work.poll_next_unpin(context) {
                return Poll::Ready(Event::Done(done));
            }
            if let Poll::Ready(answer) = answer.as_mut().poll(context) {
                return Poll::Ready(Event::Answer(answer));
            }
            if let Poll::Ready(frame) = frame.as_mut().poll(context) {
                return Poll::Ready(Event::Frame(frame));
            }
            tick.as_mut().poll(context).map(|()| Event::Tick)
        })
        .await
    }

    /// Tries to carry out a command. Where it is refused, those before it end.
    fn take(&mut self, command: impl FnOnce(&mut Self) -> Result<(), Refused>) {
        if let Err(refused) = command(self) {
            self.leased.rest();
            self.refuse(refused.to_string());
        }
    }

    fn refuse(&mut self, why: String) {
        self.refused += 1;
        let was_well = self.refusal.replace(why).is_none();
        if was_well {
            self.diagnose();
        }
    }

    fn velocity(&mut self, stamp: Option<Stamp>, twist: &Twist) -> Result<(), Refused> {
        let drive = self.drive.as_ref().ok_or(Refused::NoDrive)?;
        let velocity = gate::velocity(twist)?;
        let setpoints = drive.setpoints(velocity);
        let now = self.now();
        if !self.gate.pass(stamp, now)? {
            return Ok(());
        }
        let stamp = stamp.filter(|stamp| !stamp.is_none()).unwrap_or(now);
        let echo = self.echo(stamp, &setpoints);
        self.command(setpoints, echo)
    }

    /// The velocity that set points of wheels make, slowed down to what the robot may be asked for.
    fn echo(&self, stamp: Stamp, setpoints: &[(ChannelId, Setpoint)]) -> Echo {
        let (robot, _) = self.odometry.as_ref()?;
        let speed = |side: &[ChannelId]| {
            let wheel = setpoints.iter().find(|(channel, _)| side.first() == Some(channel));
            wheel.map(|(_, setpoint)| f64::from(setpoint.value))
        };
        let Velocity { forward_m_s, yaw_rad_s } =
            Velocity::of_sides(robot, [speed(&robot.left)?, speed(&robot.right)?]);
        let twist = Twist {
            linear: Vector3 { x: forward_m_s, ..Vector3::default() },
            angular: Vector3 { z: yaw_rad_s, ..Vector3::default() },
        };
        Some(TwistStamped { header: Header::new(stamp.to_time(), BASE_FRAME), twist })
    }

    fn joints(&mut self, stamp: Option<Stamp>, joints: &JointState) -> Result<(), Refused> {
        let setpoints = gate::joints(joints, self.session.board.channels(), CYCLE_CHANNELS)?;
        if !self.gate.pass(stamp, self.now())? || setpoints.is_empty() {
            return Ok(());
        }
        self.command(setpoints, None)
    }

    fn command(&mut self, setpoints: Setpoints, echo: Echo) -> Result<(), Refused> {
        let binding = self.leased.command(setpoints, echo).map_err(Refused::Board)?;
        self.push(binding);
        Ok(())
    }

    fn bound(&mut self, binding: Result<Bound<'b>, DriverError>) -> Result<(), Refused> {
        let next = self.leased.bound(binding).map_err(Refused::Board)?;
        self.push(next);
        Ok(())
    }

    /// Takes the board's answer to a command.
    fn answered(&mut self, report: &CycleReport, command: Option<Echo>) {
        // Bringing motors to rest is no client's command.
        let Some(echo) = command else { return };
        match report.outcome {
            CycleOutcome::Taken => {
                self.taken += 1;
                let was_refused = self.refusal.take().is_some();
                if let Some(echo) = echo {
                    self.publish(Report::Commanded(echo));
                }
                if was_refused {
                    self.diagnose();
                }
            }
            CycleOutcome::Refused if report.state != SafetyState::Armed => {
                self.refuse(format!("the board is {}: call ~/arm first", report.state));
            }
            CycleOutcome::Refused => self.refuse("the board refused it: `r4 info` lists what its channels take".into()),
            CycleOutcome::Stale => {
                self.refuse("it came to the board too late: the link or this machine is busy".into())
            }
            CycleOutcome::Unbound => self.refuse("the board has no stream for it: start the node again".into()),
        }
    }

    /// The e-stop topic. Released it lets others arm and clear again, and does neither.
    fn estop(&mut self, is_engaged: bool) {
        let has_changed = self.is_estop_engaged != is_engaged;
        self.is_estop_engaged = is_engaged;
        if is_engaged {
            self.leased.rest();
            self.stop();
        }
        if has_changed {
            self.diagnose();
        }
    }

    /// Trips the board for the e-stop topic, unless that is under way.
    fn stop(&mut self) {
        if !self.is_stopping {
            self.is_stopping = true;
            self.call(Request::Stop, None);
        }
    }

    fn call(&mut self, request: Request, answer: Option<oneshot::Sender<TriggerResponse>>) {
        if self.is_estop_engaged && matches!(request, Request::Arm | Request::Clear) {
            let message = "the e-stop topic is engaged: release it first (std_msgs/Bool false on estop)".into();
            respond(answer, TriggerResponse { success: false, message });
            return;
        }
        if request == Request::Stop {
            self.leased.rest();
        }
        let board = self.session.board;
        let work = async move {
            let result = match request {
                Request::Arm => board.arm().await,
                Request::Disarm => board.disarm().await,
                Request::Clear => board.clear().await,
                Request::Stop => board.stop().await,
            };
            Done::Called { request, result, answer }
        };
        self.work.push(work.boxed_local());
    }

    fn called(
        &mut self,
        request: Request,
        result: Result<(), DriverError>,
        answer: Option<oneshot::Sender<TriggerResponse>>,
    ) {
        let is_of_topic = request == Request::Stop && answer.is_none();
        self.is_stopping &= !is_of_topic;
        let message = match &result {
            Ok(()) => String::new(),
            Err(error) => error.to_string(),
        };
        respond(answer, TriggerResponse { success: result.is_ok(), message });
        self.look_at_safety();
    }

    /// Publishes what changed in the supervisor, and stops a board that moves while the e-stop topic is engaged: one whose stop got lost,
    /// or was under way to be armed.
    fn look_at_safety(&mut self) {
        let safety = self.session.board.safety();
        if self.is_estop_engaged && safety.0 == SafetyState::Armed {
            self.stop();
        }
        if safety != self.safety {
            self.safety = safety;
            self.publish_state();
            self.diagnose();
        }
    }
}

/// Answers a service call. A caller that is gone by now gets none.
fn respond(answer: Option<oneshot::Sender<TriggerResponse>>, response: TriggerResponse) {
    if let Some(answer) = answer {
        let _ = answer.send(response);
    }
}
