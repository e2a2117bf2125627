//! The task on a full board: firmware, chips, motors and tyres on virtual time, each board on a thread of its own.
//!
//! A step is a cycle of set points for the four wheels, the rest of its 0.1 s, and a cycle that reads the wheels. The
//! board's clock stands still between steps, so that a slow learner does not appear as a late host.

use std::{
    sync::mpsc::{self, Receiver, Sender},
    thread::{self, JoinHandle},
};

use r4_driver::{Clock as _, CycleReport, Cycles};
use r4_protocol::{Mode, SafetyState};
use r4_rig::{HostClock, Odometry, Place, Rig, Session, Target};

use crate::{
    Action, Error, Goal, Observation, STEP_S, Step,
    goal::{Episode, Truth},
    wheels::{ROBOT, SIDE, Wheels},
};

/// Time to live of set points, ms: two and a half steps.
const TTL_MS: u16 = 250;

/// Order to an environment.
#[derive(Clone, Copy)]
pub(crate) enum Order {
    /// Begin an episode of this seed.
    Reset(u64),
    /// Take a step with this action.
    Step(Action),
}

/// Answer of an environment: the observation after a reset, or a step.
pub(crate) enum Answer {
    Seen(Observation),
    Stepped(Step),
}

/// A board that runs one episode after the other.
pub(crate) struct FullBoard {
    orders: Option<Sender<Order>>,
    answers: Receiver<Result<Answer, Error>>,
    thread: Option<JoinHandle<()>>,
}

impl FullBoard {
    pub(crate) fn new() -> Result<Self, Error> {
        let (orders, inbox) = mpsc::channel();
        let (outbox, answers) = mpsc::channel();
        let work = move || {
            let mut next = inbox.recv().ok();
            while let Some(order) = next {
                next = match order {
                    Order::Reset(seed) => match episode(seed, &inbox, &outbox) {
                        Ok(next) => next,
                        Err(error) => answer(&outbox, Err(error), &inbox),
                    },
                    // The previous episode has failed: only a reset helps.
                    Order::Step(_) => answer(&outbox, Err(Error::NotReset { index: 0 }), &inbox),
                };
            }
        };
        let thread = thread::Builder::new().name("r4-environment".into()).spawn(work).map_err(Error::Thread)?;
        Ok(Self { orders: Some(orders), answers, thread: Some(thread) })
    }

    /// Waits for the answer to the last order.
    pub(crate) fn answer(&self) -> Result<Answer, Error> {
        self.answers.recv().unwrap_or(Err(Error::Gone { index: 0 }))
    }

    /// Begins an order without waiting for it; [`FullBoard::answer`] waits.
    pub(crate) fn order(&self, order: Order) {
        // Sending fails only when the thread is gone, which the answer reports.
        let _ = self.orders.as_ref().map(|orders| orders.send(order));
    }
}

impl Drop for FullBoard {
    fn drop(&mut self) {
        self.orders = None;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Sends an answer and waits for the next order; `None` when the environment was dropped.
fn answer(
    outbox: &Sender<Result<Answer, Error>>,
    answer: Result<Answer, Error>,
    inbox: &Receiver<Order>,
) -> Option<Order> {
    outbox.send(answer).ok()?;
    inbox.recv().ok()
}

/// Runs an episode until it is to be reset, and returns the order of the reset.
fn episode(seed: u64, inbox: &Receiver<Order>, outbox: &Sender<Result<Answer, Error>>) -> Result<Option<Order>, Error> {
    let wheels = Wheels::new()?;
    let (next, _) = rig(seed).run(None, async |session| {
        session.board.arm().await.map_err(r4_rig::Error::Arm)?;
        let mut driver = Driver::new(session, &wheels).await?;
        let mut episode = Episode::new(seed);
        let mut told = Answer::Seen(driver.look(episode.goal).await?);
        loop {
            // Blocking here, inside of a poll, is what stops the virtual clock.
            match answer(outbox, Ok(told), inbox) {
                Some(Order::Step(action)) => told = Answer::Stepped(driver.step(action, &mut episode).await?),
                next => return Ok::<_, Error>(next),
            }
        }
    })?;
    Ok(next)
}

/// True poses of a full board's robot: at the start, and after each action.
pub(crate) fn record(seed: u64, actions: &[Action]) -> Result<Vec<Place>, Error> {
    let wheels = Wheels::new()?;
    let (places, _) = rig(seed).run(None, async |session| {
        session.board.arm().await.map_err(r4_rig::Error::Arm)?;
        let mut driver = Driver::new(session, &wheels).await?;
        let mut episode = Episode::new(seed);
        let mut places = vec![driver.place()];
        for action in actions {
            driver.step(*action, &mut episode).await?;
            places.push(driver.place());
        }
        Ok::<_, Error>(places)
    })?;
    Ok(places)
}

fn rig(seed: u64) -> Rig {
    Rig { seed, ..Rig::new(Target::Sim(ROBOT.to_owned())) }
}

/// Session in which a robot is driven step by step.
pub(crate) struct Driver<'s> {
    session: &'s Session<'s>,
    wheels: &'s Wheels,
    cycles: Cycles<'s, HostClock>,
    odometry: Odometry,
    /// Number of steps since `begin_us`.
    steps: u64,
    begin_us: u64,
    last: Place,
    tripped: bool,
}

impl<'s> Driver<'s> {
    /// Starts on an armed board; the present positions of the wheels are the origin.
    pub(crate) async fn new(session: &'s Session<'s>, wheels: &'s Wheels) -> Result<Self, Error> {
        let channels: Vec<_> = wheels.channels.iter().map(|wheel| (*wheel, Mode::Speed)).collect();
        let mut cycles = session.board.stream(&channels, TTL_MS).await.map_err(r4_rig::Error::from)?;
        let report = cycles.ask().await.map_err(r4_rig::Error::from)?;
        let mut driver = Self {
            session,
            wheels,
            cycles,
            odometry: Odometry::new(&wheels.drive),
            steps: 0,
            begin_us: session.clock.now_us(),
            last: Place::default(),
            tripped: false,
        };
        driver.take(&report);
        Ok(driver)
    }

    fn take(&mut self, report: &CycleReport) {
        let mean = |motors: &[r4_driver::CycleMotion]| {
            motors.iter().map(|motor| motor.position).sum::<f64>() / motors.len() as f64
        };
        let (left, right) = report.motors.split_at(SIDE);
        self.odometry.look(mean(left), mean(right));
        self.tripped |= report.state != SafetyState::Armed;
    }

    /// Observation of a goal at the present moment.
    async fn look(&mut self, goal: Goal) -> Result<Observation, Error> {
        let report = self.cycles.ask().await.map_err(r4_rig::Error::from)?;
        self.take(&report);
        let (before, at) = (self.last, self.odometry.place());
        self.last = at;
        // Mean speeds over the step; exact on an arc, along the heading halfway.
        let bow_rad = (before.yaw_rad + at.yaw_rad) / 2.0;
        let forward_m = (at.x_m - before.x_m) * bow_rad.cos() + (at.y_m - before.y_m) * bow_rad.sin();
        Ok(goal.observation(at, forward_m / STEP_S, (at.yaw_rad - before.yaw_rad) / STEP_S))
    }

    /// True pose of the robot, from the simulation; by odometry for a board on a link.
    fn place(&self) -> Place {
        self.session.true_place().unwrap_or(self.odometry.place())
    }

    /// Drives one step of the episode.
    pub(crate) async fn step(&mut self, action: Action, episode: &mut Episode) -> Result<Step, Error> {
        if !self.tripped {
            let values = self.wheels.speeds_rad_s(action);
            let report = self.cycles.cycle(&values).await.map_err(r4_rig::Error::from)?;
            self.take(&report);
        }
        self.steps += 1;
        let until_us = self.begin_us + (self.steps as f64 * STEP_S * 1e6) as u64;
        self.session.clock.sleep_until(until_us).await;
        let observation = self.look(episode.goal).await?;
        let truth = Truth { distance_m: episode.goal.distance_m(self.place()), tripped: self.tripped };
        Ok(episode.step(observation, truth))
    }
}
