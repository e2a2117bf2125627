//! The task on a full board: firmware, chips, motors and tyres on virtual time, each board on a thread of its own.
//!
//! A step is a cycle of set points for the four wheels, the rest of its 0.1 s, and a cycle that asks what the wheels do. The board's clock
//! stands still between steps, so that a slow learner is no late host.

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

/// Set points hold this long, ms: two and a half steps.
const TTL_MS: u16 = 250;

/// What an environment is to do next.
#[derive(Clone, Copy)]
pub(crate) enum Order {
    /// Begin an episode of this seed.
    Reset(u64),
    /// Take a step.
    Step(Action),
}

/// What an environment answers: what is seen after a reset, or a step.
pub(crate) enum Answer {
    Seen(Observation),
    Stepped(Step),
}

/// A board with an episode on it.
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
                    // The episode before has failed.
                    Order::Step(_) => answer(&outbox, Err(Error::NotReset { index: 0 }), &inbox),
                };
            }
        };
        let thread = thread::Builder::new().name("r4-environment".into()).spawn(work).map_err(Error::Thread)?;
        Ok(Self { orders: Some(orders), answers, thread: Some(thread) })
    }

    /// The answer to the order before.
    pub(crate) fn answer(&self) -> Result<Answer, Error> {
        self.answers.recv().unwrap_or(Err(Error::Gone { index: 0 }))
    }

    /// Begins what is ordered. Does not wait for it: [`FullBoard::answer`] does.
    pub(crate) fn order(&self, order: Order) {
        // Where its thread is gone, the answer says so.
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

/// Gives an answer and takes the next order; `None` when nobody can order any more.
fn answer(
    outbox: &Sender<Result<Answer, Error>>,
    answer: Result<Answer, Error>,
    inbox: &Receiver<Order>,
) -> Option<Order> {
    outbox.send(answer).ok()?;
    inbox.recv().ok()
}

/// Runs an episode until it is to be reset, and returns the order to do so.
fn episode(seed: u64, inbox: &Receiver<Order>, outbox: &Sender<Result<Answer, Error>>) -> Result<Option<Order>, Error> {
    let wheels = Wheels::new()?;
    let (next, _) = rig(seed).run(None, async |session| {
        session.board.arm().await.map_err(r4_rig::Error::Arm)?;
        let mut driver = Driver::new(session, &wheels).await?;
        let mut episode = Episode::new(seed);
        let mut told = Answer::Seen(driver.look(episode.goal).await?);
        loop {
            // Waiting here, inside of a poll, is what stops the virtual clock.
            match answer(outbox, Ok(told), inbox) {
                Some(Order::Step(action)) => told = Answer::Stepped(driver.step(action, &mut episode).await?),
                next => return Ok::<_, Error>(next),
            }
        }
    })?;
    Ok(next)
}

/// True places of a full board's robot: at the start, and after each action.
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

/// A session in which a robot is driven step by step.
pub(crate) struct Driver<'s> {
    session: &'s Session<'s>,
    wheels: &'s Wheels,
    cycles: Cycles<'s, HostClock>,
    odometry: Odometry,
    /// Steps since `begin_us`.
    steps: u64,
    begin_us: u64,
    last: Place,
    tripped: bool,
}

impl<'s> Driver<'s> {
    /// On an armed board, whose wheels' positions count from now.
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

    /// What the robot sees of a goal now.
    async fn look(&mut self, goal: Goal) -> Result<Observation, Error> {
        let report = self.cycles.ask().await.map_err(r4_rig::Error::from)?;
        self.take(&report);
        let (before, at) = (self.last, self.odometry.place());
        self.last = at;
        // Over the step; exact on an arc, and forwards by the bow half way.
        let bow_rad = (before.yaw_rad + at.yaw_rad) / 2.0;
        let forward_m = (at.x_m - before.x_m) * bow_rad.cos() + (at.y_m - before.y_m) * bow_rad.sin();
        Ok(goal.observation(at, forward_m / STEP_S, (at.yaw_rad - before.yaw_rad) / STEP_S))
    }

    /// Where the robot is: by the truth of a simulation; a board at the end of a link has none but its odometry.
    fn place(&self) -> Place {
        self.session.true_place().unwrap_or(self.odometry.place())
    }

    /// Drives one step.
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
