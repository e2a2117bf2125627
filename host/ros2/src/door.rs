//! Session of the node with a board: it passes orders from ROS to the board, and readings of the board to ROS. It never arms and never
//! clears by itself.

mod commands;
mod managed;
mod order;
mod parameters;
mod reports;
#[cfg(test)]
mod tests;
mod trajectories;

use std::{
    cell::Cell,
    collections::{BTreeSet, VecDeque},
    future::poll_fn,
    pin::pin,
    rc::Rc,
    task::Poll,
};

use futures::{
    FutureExt, StreamExt,
    channel::{mpsc::UnboundedReceiver, oneshot},
    future::LocalBoxFuture,
    stream::FuturesUnordered,
};
use r4_driver::{Clock as _, CycleReport, Error as DriverError, TelemetryStream};
use r4_protocol::{Causes, SafetyState, Telemetry};
use r4_rig::{Error, GroundDrive, Session, Velocity};

use crate::{
    frames::Frames,
    gate::{Gate, Refused},
    leased::{Binding, Bound, Leased},
    message::{TriggerResponse, TwistStamped},
    parameters::{ParameterCall, ParameterStore},
    time::{RosClock, Stamp},
};

pub use managed::Ended;
pub use order::{Order, Request};
pub use reports::Report;
use trajectories::{Following, Positions};

/// Settings of a node for a session with a board.
#[derive(Clone, Copy, Debug)]
pub struct Door {
    /// Source of ROS time for stamps and the age of commands.
    pub clock: RosClock,
    /// True publishes the transform from `odom` to `base_link` on `/tf`; false where another node publishes it, for example a filter.
    pub has_transform: bool,
    /// True for a managed node: its lifecycle arms the board, and `~/arm` is refused.
    pub is_managed: bool,
}

/// Period at which simulated time is published and the supervisor's state is checked, s.
const TICK_S: f64 = 0.01;
/// Period of diagnostics while nothing changes, s.
const DIAGNOSE_EVERY_S: f64 = 1.0;

impl Door {
    /// Serves `orders` until all senders are gone, or until a managed node ends its session. `report` publishes a message, and
    /// returns false when it could not.
    ///
    /// # Errors
    /// The error of the link when it ends; the board's refusal of a subscription.
    pub async fn serve<'b>(
        &self,
        session: &'b Session<'b>,
        mut orders: UnboundedReceiver<Order>,
        report: impl FnMut(Report) -> bool,
    ) -> Result<Ended, Error> {
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
                Event::Order(Order::Trajectory { stamp, trajectory }) => {
                    serving.take(|serving| serving.trajectory(stamp, &trajectory));
                }
                Event::Order(Order::Estop(is_engaged)) => serving.estop(is_engaged),
                Event::Order(Order::Unreadable { topic, why }) => {
                    serving.take(|_| Err(Refused::Unreadable { topic, why }));
                }
                Event::Order(Order::Call { request, answer }) => serving.call(request, Some(answer)),
                Event::Order(Order::Parameters(call)) => serving.parameter_call(call),
                Event::Order(Order::Change(change)) => {
                    if let Some(ended) = serving.change(change).await {
                        return Ok(ended);
                    }
                }
                Event::Ended => return Ok(Ended::Orders),
                Event::Done(Done::Called { request, result, answer }) => serving.called(request, result, answer),
                Event::Done(Done::Bound(binding)) => serving.take(|serving| serving.bound(binding)),
                Event::Done(Done::Fed { has_ended, result }) => serving.fed(&has_ended, result),
                Event::Done(Done::Changed { to_active, result, answer }) => serving.changed(to_active, result, answer),
                Event::Done(Done::Parameters(store)) => serving.next_parameter_call(store),
                Event::Done(Done::Rested(result)) => serving.take(|_| result.map_err(Refused::Board)),
                Event::Frame(frame) => serving.frame(&frame?),
                Event::Answer(answer) => {
                    let (report, command) = answer?;
                    serving.answered(&report, command);
                }
                Event::Tick => {
                    let now_s = session.board.now_s();
                    // Counted from now: after a stall of the machine, missed ticks are not made up.
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

/// Event for which the session waits.
enum Event<'b> {
    Order(Order),
    Ended,
    Done(Done<'b>),
    Frame(Result<Telemetry, DriverError>),
    Answer(Result<(CycleReport, Option<Echo>), DriverError>),
    Tick,
}

/// Completion of a request to the board, with its result.
enum Done<'b> {
    Called {
        request: Request,
        result: Result<(), DriverError>,
        answer: Option<oneshot::Sender<TriggerResponse>>,
    },
    Bound(Result<Bound<'b>, DriverError>),
    /// Points of a trajectory were sent; the trajectory may have ended since.
    Fed {
        has_ended: Rc<Cell<bool>>,
        result: Result<(), DriverError>,
    },
    /// A managed node's board was armed or disarmed, or refused it.
    Changed {
        to_active: bool,
        result: Result<(), DriverError>,
        answer: oneshot::Sender<bool>,
    },
    /// A call of a parameter service was answered.
    Parameters(ParameterStore),
    /// Joints of an ended trajectory were brought to rest.
    Rested(Result<(), DriverError>),
}

/// Message that is published once the board accepts a command; `None` for commands to joints.
type Echo = Option<TwistStamped>;

/// State of a node during a session with a board.
struct Serving<'b, R> {
    door: Door,
    session: &'b Session<'b>,
    report: R,
    drive: Option<GroundDrive>,
    frames: Frames,
    gate: Gate,
    leased: Leased<'b, Echo>,
    following: Option<Following>,
    positions: Positions,
    /// Parameters of the board; `None` while a call works on them.
    parameters: Option<ParameterStore>,
    parameter_calls: VecDeque<ParameterCall>,
    work: FuturesUnordered<LocalBoxFuture<'b, Done<'b>>>,
    /// Supervisor's state and causes as last published.
    safety: (SafetyState, Causes),
    is_estop_engaged: bool,
    is_stopping: bool,
    /// True while a managed node is active.
    is_active: bool,
    taken: u64,
    refused: u64,
    refusal: Option<String>,
    unpublished: u64,
}

impl<'b, R: FnMut(Report) -> bool> Serving<'b, R> {
    fn new(door: Door, session: &'b Session<'b>, report: R) -> Self {
        let board = session.board;
        let drive = session.ground_drive();
        let frames = Frames::new(board.channels(), drive.as_ref(), door.has_transform);
        let timeout_ms = board.info().link_timeout_ms;
        Self {
            door,
            session,
            report,
            drive,
            frames,
            gate: Gate::new(f64::from(timeout_ms) * 1e-3),
            leased: Leased::new(board, timeout_ms),
            following: None,
            positions: Positions::new(),
            parameters: Some(ParameterStore::default()),
            parameter_calls: VecDeque::new(),
            work: FuturesUnordered::new(),
            safety: board.safety(),
            is_estop_engaged: false,
            is_stopping: false,
            is_active: false,
            taken: 0,
            refused: 0,
            refusal: None,
            unpublished: 0,
        }
    }

    fn now(&self) -> Stamp {
        self.door.clock.now(self.session.clock.now_us())
    }

    /// Binds the stream to the wheels, so that the first velocity need not wait for the binding.
    fn prepare(&mut self) {
        let Some(drive) = &self.drive else { return };
        let channels = drive.setpoints(Velocity::default()).iter().map(|(channel, set)| (*channel, set.mode)).collect();
        let binding = self.leased.prepare(channels);
        self.push(binding);
    }

    fn push(&mut self, binding: Option<Binding<'b>>) {
        self.work.extend(binding.map(|binding| binding.map(Done::Bound).boxed_local()));
    }

    /// Waits for the next event. Orders have priority, because an e-stop is one of them.
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
            // `None` when no request is under way: such a queue must not end the wait.
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

    /// Runs a command. A refusal also ends the commands before it.
    fn take(&mut self, command: impl FnOnce(&mut Self) -> Result<(), Refused>) {
        if let Err(refused) = command(self) {
            self.leased.rest();
            self.end_trajectory(&BTreeSet::new());
            self.refuse(refused.to_string());
        }
    }

    fn refuse(&mut self, why: String) {
        self.refused += 1;
        // Only the first of several refusals is published at once: a faulty publisher must not flood `/diagnostics`.
        let was_well = self.refusal.replace(why).is_none();
        if was_well {
            self.diagnose();
        }
    }

    /// Handles a message on the e-stop topic. A release permits arming and clearing again, but does neither.
    fn estop(&mut self, is_engaged: bool) {
        let has_changed = self.is_estop_engaged != is_engaged;
        self.is_estop_engaged = is_engaged;
        if is_engaged {
            self.leased.rest();
            self.drop_trajectory();
            self.stop();
        }
        if has_changed {
            self.diagnose();
        }
    }

    /// Trips the board for the e-stop topic, unless a stop is already under way.
    fn stop(&mut self) {
        // One request at a time: while the topic is engaged and the board armed, each tick comes here.
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
        if self.door.is_managed && request == Request::Arm {
            let message = "this node is managed: activate it (ros2 lifecycle set NODE activate)".into();
            respond(answer, TriggerResponse { success: false, message });
            return;
        }
        // Waiting set points are dropped, so that none reaches the board after the stop.
        if request == Request::Stop {
            self.leased.rest();
        }
        if matches!(request, Request::Stop | Request::Disarm) {
            self.drop_trajectory();
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

    /// Publishes changes of the supervisor's state, and stops a board that is armed while the e-stop topic is engaged: its stop was lost,
    /// or it was being armed when the stop arrived.
    fn look_at_safety(&mut self) {
        let safety = self.session.board.safety();
        if self.is_estop_engaged && safety.0 == SafetyState::Armed {
            self.stop();
        }
        // Not only on a change: a board that trips right after arming may never be seen armed.
        if safety.0 != SafetyState::Armed {
            self.deactivated();
        }
        if safety != self.safety {
            self.safety = safety;
            if safety.0 != SafetyState::Armed {
                self.drop_trajectory();
            }
            self.publish_state();
            self.diagnose();
        }
    }
}

/// Answers a service call, unless the caller is gone.
fn respond(answer: Option<oneshot::Sender<TriggerResponse>>, response: TriggerResponse) {
    if let Some(answer) = answer {
        // The caller may have given up; then the answer is dropped.
        let _ = answer.send(response);
    }
}
