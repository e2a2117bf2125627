//! A fleet on one event clock, in which each robot is either timed events or a board.

use std::pin::pin;

use futures::{
    StreamExt,
    channel::mpsc::{UnboundedReceiver, UnboundedSender},
    future::{Either, select},
};
use r4_driver::Clock as _;
use r4_rig::{Fleet, HostClock, Pace, Place, Session};

use super::{
    action::Impossible,
    ideal::IdealDrive,
    mission::{Input, Order},
    motion::{Leg, Motion},
    queue::Queue,
    wall::Wall,
};
use crate::Error;

/// Task of a fleet: a function from inputs to orders.
pub trait Program {
    /// Poses of the robots at the start.
    fn starts(&self) -> &[Place];

    /// Time of [`Input::Deadline`], s.
    fn deadline_s(&self) -> f64;

    /// Processes an input at `now_us` and appends the resulting orders to `orders`.
    ///
    /// # Errors
    /// [`Impossible`] when a robot reports an event that its goal's state does not allow.
    fn handle(&mut self, now_us: u64, input: Input, orders: &mut Vec<Order>) -> Result<(), Impossible>;

    /// Returns true when no more orders will follow.
    fn has_ended(&self) -> bool;
}

/// Fidelity by which a robot is simulated.
#[derive(Clone)]
pub enum Fidelity {
    /// Timed events: a leg is a duration by this motion.
    Abstract(Motion),
    /// Perfect actuators: the board's program drives wheels that turn as commanded.
    Ideal(IdealDrive),
    /// A board, which receives its orders by this channel.
    Board(UnboundedSender<Order>),
}

/// An event on the event clock. Events at the same time come in this order, and among robots by their numbers.
///
/// A loss is an entry of [`Run::losses`], which holds its reason: this keeps events small.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Due {
    Start,
    Arrived { robot: usize, leg: u64 },
    Sampled { robot: usize, leg: u64 },
    Stopped { robot: usize },
    Fails { robot: usize, loss: usize },
    Planned,
    Deadline,
}

/// State of a robot of the abstract fidelity.
#[derive(Clone)]
struct Body {
    at: Place,
    /// Current leg and its start, µs; `None` at rest.
    leg: Option<(Way, u64)>,
    /// Counter of orders, which marks events of earlier orders as stale.
    number: u64,
}

/// A leg to a goal.
#[derive(Clone)]
enum Way {
    Timed(Leg),
    Driven(Vec<Place>),
}

impl Way {
    fn duration_s(&self) -> f64 {
        match self {
            Self::Timed(leg) => leg.duration_s(),
            Self::Driven(places) => (places.len() - 1) as f64 * IdealDrive::PERIOD_S,
        }
    }

    /// Pose and path length, m, `time_s` after the start.
    fn at(&self, time_s: f64) -> (Place, f64) {
        match self {
            Self::Timed(leg) => (leg.at(time_s), leg.covered_m(time_s)),
            Self::Driven(places) => {
                let last = ((time_s / IdealDrive::PERIOD_S).round() as usize).min(places.len() - 1);
                let steps = places[..=last].windows(2);
                (places[last], steps.map(|pair| (pair[1].x_m - pair[0].x_m).hypot(pair[1].y_m - pair[0].y_m)).sum())
            }
        }
    }
}

/// A run of a program by a fleet.
pub struct Run<P> {
    /// Program of the fleet.
    pub mission: P,
    /// Fidelity of each robot.
    pub robots: Vec<Fidelity>,
    /// Model of the compute time.
    pub wall: Wall,
    /// Robots that are lost: time, µs, robot and reason.
    pub losses: Vec<(u64, usize, String)>,
    /// Carries out orders of the same time from the last to the first, to show that their order does not matter.
    pub is_reversed: bool,
    /// End poses of each abstract robot's legs, with their times, s.
    pub paths: Vec<Vec<(f64, Place)>>,
}

impl<P: Program> Run<P> {
    /// Creates a run without losses.
    #[must_use]
    pub fn new(mission: P, robots: Vec<Fidelity>, wall: Wall) -> Self {
        let paths = mission.starts().iter().map(|start| vec![(0.0, *start)]).collect();
        Self { mission, robots, wall, losses: Vec::new(), is_reversed: false, paths }
    }

    /// Runs a program in which no robot is a board; `pace` couples simulated time to the wall clock.
    ///
    /// # Errors
    /// [`Error::Unsuitable`] when a robot reports an event that its goal's state does not allow.
    pub fn alone(self, pace: Pace) -> Result<Self, Error> {
        let (_, reports) = futures::channel::mpsc::unbounded();
        let member = async |_: usize, _: &Session<'_>| Ok::<_, Error>(());
        let fleet = Fleet { rigs: Vec::new(), pace };
        let work = async move |clock: &HostClock| {
            let mut run = self;
            run.drive(clock, reports).await?;
            Ok(run)
        };
        Ok(fleet.run(member, work)?.0)
    }

    /// Runs the program on a clock; `reports` are the inputs that boards send.
    ///
    /// # Errors
    /// [`Error::Unsuitable`] when a robot reports an event that its goal's state does not allow.
    pub async fn drive(&mut self, clock: &HostClock, mut reports: UnboundedReceiver<Input>) -> Result<(), Error> {
        let begin_us = clock.now_us();
        let mut queue = Queue::default();
        queue.push(0, Due::Start);
        queue.push((self.mission.deadline_s() * 1e6) as u64, Due::Deadline);
        for (loss, &(at_us, robot, _)) in self.losses.iter().enumerate() {
            queue.push(at_us, Due::Fails { robot, loss });
        }
        let body = |at: &Place| Body { at: *at, leg: None, number: 0 };
        let mut bodies: Vec<Body> = self.mission.starts().iter().map(body).collect();
        let mut orders = Vec::new();
        while !self.mission.has_ended() {
            let now_us = clock.now_us() - begin_us;
            // An event keeps the time at which it was due, even if the clock is a little past it.
            let (at_us, input) = if let Some((at_us, due)) = queue.pop_due(now_us) {
                let Some(input) = self.happened(due, at_us, &mut bodies) else { continue };
                (at_us, input)
            } else {
                let due = async {
                    match queue.next_us() {
                        Some(at_us) => clock.sleep_until(begin_us + at_us).await,
                        None => std::future::pending().await,
                    }
                };
                match select(pin!(due), pin!(next(&mut reports))).await {
                    Either::Left(_) => continue,
                    Either::Right((input, _)) => (clock.now_us() - begin_us, input),
                }
            };
            self.mission.handle(at_us, input, &mut orders).map_err(|why| Error::Unsuitable {
                system: super::NAME,
                board: "the fleet".into(),
                why: why.to_string(),
            })?;
            if self.is_reversed {
                orders.reverse();
            }
            for order in orders.drain(..) {
                self.carry_out(order, at_us, &mut bodies, &mut queue);
            }
        }
        Ok(())
    }

    /// Converts a due event to an input of the mission; `None` for a stale one, whose order was replaced.
    fn happened(&mut self, due: Due, at_us: u64, bodies: &mut [Body]) -> Option<Input> {
        let at_s = at_us as f64 * 1e-6;
        Some(match due {
            Due::Start => Input::Start,
            Due::Planned => Input::Planned,
            Due::Deadline => Input::Deadline,
            Due::Arrived { robot, leg } => {
                let body = &mut bodies[robot];
                let (way, _) = body.leg.take_if(|_| body.number == leg)?;
                let (place, driven_m) = way.at(f64::INFINITY);
                body.at = place;
                self.paths[robot].push((at_s, place));
                Input::Arrived(robot, driven_m)
            }
            Due::Sampled { robot, leg } if bodies[robot].number == leg => {
                Input::Sampled(robot, [bodies[robot].at.x_m, bodies[robot].at.y_m])
            }
            Due::Sampled { .. } => return None,
            Due::Stopped { robot } => Input::Stopped(robot, self.stopped(robot, at_us, bodies)),
            Due::Fails { robot, loss } => {
                self.stopped(robot, at_us, bodies);
                Input::Failed(robot, self.losses[loss].2.clone())
            }
        })
    }

    /// Stops an abstract robot at its present pose and returns the path length of its leg, m.
    fn stopped(&mut self, robot: usize, at_us: u64, bodies: &mut [Body]) -> f64 {
        let body = &mut bodies[robot];
        // The arrival of this leg may still be in the queue; a new number makes it void.
        body.number += 1;
        let Some((way, since_us)) = body.leg.take() else { return 0.0 };
        let (place, driven_m) = way.at((at_us - since_us) as f64 * 1e-6);
        body.at = place;
        self.paths[robot].push((at_us as f64 * 1e-6, place));
        driven_m
    }

    fn carry_out(&mut self, order: Order, now_us: u64, bodies: &mut [Body], queue: &mut Queue<Due>) {
        let robot = match order {
            Order::End => return,
            Order::Plan(work) => {
                queue.push(now_us + self.wall.charge_us(work), Due::Planned);
                return;
            }
            Order::Go { robot, .. } | Order::Sample { robot, .. } | Order::Stop { robot } => robot,
        };
        let after = |seconds: f64| now_us + (seconds * 1e6).round() as u64;
        let body = &mut bodies[robot];
        let way = |goal_m| match &self.robots[robot] {
            Fidelity::Abstract(motion) => Some(Way::Timed(motion.leg(body.at, goal_m))),
            Fidelity::Ideal(drive) => Some(Way::Driven(drive.leg(body.at, goal_m))),
            Fidelity::Board(_) => None,
        };
        if let Fidelity::Board(orders) = &self.robots[robot] {
            // Sending fails only when the board is gone, which has reported its reason.
            drop(orders.unbounded_send(order));
            return;
        }
        match order {
            Order::Go { goal_m, .. } => {
                let Some(way) = way(goal_m) else { return };
                let arrives_us = after(way.duration_s());
                body.number += 1;
                body.leg = Some((way, now_us));
                queue.push(arrives_us, Due::Arrived { robot, leg: body.number });
            }
            Order::Sample { for_s, .. } => queue.push(after(for_s), Due::Sampled { robot, leg: body.number }),
            // A preemption is immediate: the event is due now.
            _ => queue.push(now_us, Due::Stopped { robot }),
        }
    }
}

/// Waits for the next report of a board; without boards, it never ends.
async fn next(reports: &mut UnboundedReceiver<Input>) -> Input {
    match reports.next().await {
        Some(input) => input,
        None => std::future::pending().await,
    }
}
