//! Mission that maps a field with several robots: it creates sampling goals, allocates them, and tracks the state of
//! each.
//!
//! A mission is a function from timed inputs to orders. It knows neither the robots' motion nor a clock, so that both
//! fidelities run the same one.

use std::collections::VecDeque;

use r4_maths::statistics::rmse;
use r4_rig::Place;

use super::{
    action::{Event, Impossible, State},
    fleet::Program,
    scene::Scene,
    soil::{Map, NOISE_OF_SAMPLE_KPA, Soil},
};
use crate::sampler::Sampler;

/// Purpose of the random numbers of samples: one sequence for each cell, so that a reading does not depend on who takes
/// it when.
const OF_SAMPLES: u64 = 1_000;

/// Goals of a batch for each robot. With one, robots wait for the coordinator after each sample; with four, two thirds
/// of the samples are placed before any of them is known.
const BATCH_PER_ROBOT: usize = 2;

/// An order of a mission to a robot or to the coordinator.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Order {
    /// A robot drives to a goal.
    Go {
        /// Number of the robot.
        robot: usize,
        /// Position of the goal, m.
        goal_m: [f64; 2],
    },
    /// A robot takes a sample.
    Sample {
        /// Number of the robot.
        robot: usize,
        /// Duration of the sample, s.
        for_s: f64,
    },
    /// A robot stops at once.
    Stop {
        /// Number of the robot.
        robot: usize,
    },
    /// The coordinator computes; [`Input::Planned`] follows after its compute time.
    Plan(Work),
    /// The mission is over.
    End,
}

/// Counted operations of the coordinator.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Work {
    /// Cell updates by earlier samples, in the creation of goals.
    pub updates: u64,
    /// Bids of a robot for a goal, in the allocation.
    pub bids: u64,
}

/// An event that a mission reacts to.
#[derive(Clone, Debug, PartialEq)]
pub enum Input {
    /// The mission starts, at time 0.
    Start,
    /// The coordinator has finished its computation.
    Planned,
    /// The deadline is reached.
    Deadline,
    /// A robot has reached its goal, after this path length, m.
    Arrived(usize, f64),
    /// A robot has taken its sample, at this true position, m.
    Sampled(usize, [f64; 2]),
    /// A robot has stopped as ordered, after this path length, m.
    Stopped(usize, f64),
    /// A robot is lost, with the reason.
    Failed(usize, String),
}

/// A goal of the mission.
#[derive(Clone, Debug, PartialEq)]
pub struct Goal {
    /// Cell of the map to be sampled.
    pub cell: usize,
    /// Robot that it was allocated to.
    pub robot: usize,
    /// State of the goal.
    pub state: State,
    /// Reason of an abort; `None` for goals that were not aborted.
    pub reason: Option<String>,
}

/// A sample that was taken.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Taken {
    /// Time of the sample, µs.
    pub at_us: u64,
    /// Number of the robot.
    pub robot: usize,
    /// True position of the sample, m.
    pub place_m: [f64; 2],
    /// Reading of the penetrometer, kPa.
    pub value_kpa: f64,
    /// Root mean square error of the map after this sample, kPa.
    pub rmse_kpa: f64,
}

#[derive(Clone, Debug, Default, PartialEq)]
struct Robot {
    /// Goals in their order; while the robot is busy, it drives to the first or samples there.
    goals: VecDeque<usize>,
    is_busy: bool,
    is_lost: bool,
    /// Start of the present waiting time, µs.
    idle_us: u64,
    waited_us: u64,
    driven_m: f64,
}

/// A mission and its state.
#[derive(Clone, Debug)]
pub struct Mission {
    scene: Scene,
    soil: Soil,
    truth_kpa: Vec<f64>,
    /// Map of the samples that were taken.
    map: Map,
    /// Map that also contains the samples still to be taken.
    planned: Map,
    robots: Vec<Robot>,
    goals: Vec<Goal>,
    /// Cells that wait for their allocation.
    cells: Vec<usize>,
    created: usize,
    is_planning: bool,
    taken: Vec<Taken>,
    first_rmse_kpa: f64,
    ended_us: Option<u64>,
}

impl Mission {
    /// Creates a mission before its start.
    #[must_use]
    pub fn new(scene: Scene) -> Self {
        let map = Map::new(scene.side_m, scene.cells);
        let soil = Soil::of(scene.seed);
        let truth_kpa = map.truth_kpa(&soil);
        Self {
            first_rmse_kpa: rmse(&truth_kpa, map.mean_kpa()).unwrap_or(f64::NAN),
            truth_kpa,
            soil,
            planned: map.clone(),
            map,
            robots: vec![Robot::default(); scene.robots],
            goals: Vec::new(),
            cells: Vec::new(),
            created: 0,
            is_planning: false,
            taken: Vec::new(),
            ended_us: None,
            scene,
        }
    }

    /// Scene of the mission.
    #[must_use]
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// All goals created so far.
    #[must_use]
    pub fn goals(&self) -> &[Goal] {
        &self.goals
    }

    /// All samples taken so far.
    #[must_use]
    pub fn taken(&self) -> &[Taken] {
        &self.taken
    }

    /// Map of the samples taken so far.
    #[must_use]
    pub fn map(&self) -> &Map {
        &self.map
    }

    /// True penetration resistance in the middle of each cell, kPa.
    #[must_use]
    pub fn truth_kpa(&self) -> &[f64] {
        &self.truth_kpa
    }

    /// Root mean square error of the map over all cells, kPa.
    #[must_use]
    pub fn rmse_kpa(&self) -> f64 {
        // Both have one value for each cell, so this does not fail.
        rmse(&self.truth_kpa, self.map.mean_kpa()).unwrap_or(f64::NAN)
    }

    /// Root mean square error of the map before the first sample, kPa.
    #[must_use]
    pub fn first_rmse_kpa(&self) -> f64 {
        self.first_rmse_kpa
    }

    /// Time at which the mission ended, µs; `None` while it runs.
    #[must_use]
    pub fn ended_us(&self) -> Option<u64> {
        self.ended_us
    }

    /// Path length of each robot, m.
    pub fn driven_m(&self) -> impl Iterator<Item = f64> + '_ {
        self.robots.iter().map(|robot| robot.driven_m)
    }

    /// Total waiting time of each robot without goals, s.
    pub fn waited_s(&self) -> impl Iterator<Item = f64> + '_ {
        self.robots.iter().map(|robot| robot.waited_us as f64 * 1e-6)
    }

    /// Ends the goal that a robot is busy with, and returns its number.
    fn ended(&mut self, robot: usize, event: Event, now_us: u64) -> Result<Option<usize>, Impossible> {
        let Some(goal) = self.robots[robot].goals.pop_front() else { return Ok(None) };
        self.happens(goal, event)?;
        (self.robots[robot].is_busy, self.robots[robot].idle_us) = (false, now_us);
        Ok(Some(goal))
    }

    fn happens(&mut self, goal: usize, event: Event) -> Result<(), Impossible> {
        let goal = &mut self.goals[goal];
        goal.state = goal.state.after(event)?;
        Ok(())
    }

    fn take(&mut self, at_us: u64, robot: usize, goal: Option<usize>, place_m: [f64; 2]) {
        let Some(cell) = goal.map(|goal| self.goals[goal].cell) else { return };
        // Noise by cell, not by time: a reading does not depend on the order of the samples.
        let noise_kpa = Sampler::new(self.scene.seed, OF_SAMPLES + cell as u64).normal(NOISE_OF_SAMPLE_KPA);
        let value_kpa = self.soil.at(place_m) + noise_kpa;
        self.map.add(cell, Some(value_kpa));
        let rmse_kpa = self.rmse_kpa();
        self.taken.push(Taken { at_us, robot, place_m, value_kpa, rmse_kpa });
    }

    /// Marks a robot as lost and returns its goals to the allocation.
    fn lose(&mut self, robot: usize, reason: &str, now_us: u64) -> Result<(), Impossible> {
        let lost = &mut self.robots[robot];
        lost.is_lost = true;
        let is_busy = std::mem::replace(&mut lost.is_busy, false);
        lost.idle_us = now_us;
        for (index, goal) in std::mem::take(&mut lost.goals).into_iter().enumerate() {
            // Only the goal that the robot was busy with is aborted; waiting ones are recalled.
            if index == 0 && is_busy {
                self.happens(goal, Event::Abort)?;
                self.goals[goal].reason = Some(reason.to_owned());
            } else {
                self.happens(goal, Event::Cancel)?;
                self.happens(goal, Event::Canceled)?;
            }
            self.cells.push(self.goals[goal].cell);
        }
        Ok(())
    }

    /// Cancels everything at the deadline: no goal is created any more, waiting goals are recalled, driving robots
    /// stop.
    fn cancel_all(&mut self, orders: &mut Vec<Order>) -> Result<(), Impossible> {
        // As if all goals had been created, so that `plan` creates no more.
        self.created = self.scene.samples;
        self.cells.clear();
        self.is_planning = false;
        for robot in 0..self.robots.len() {
            let busy = usize::from(self.robots[robot].is_busy);
            let waiting: Vec<usize> = self.robots[robot].goals.drain(busy..).collect();
            for goal in waiting {
                self.happens(goal, Event::Cancel)?;
                self.happens(goal, Event::Canceled)?;
            }
            if let Some(goal) = self.robots[robot].goals.front().copied() {
                self.happens(goal, Event::Cancel)?;
                orders.push(Order::Stop { robot });
            }
        }
        Ok(())
    }

    /// Sends idle robots to their next goals.
    fn dispatch(&mut self, now_us: u64, orders: &mut Vec<Order>) -> Result<(), Impossible> {
        for robot in 0..self.robots.len() {
            let idle = &mut self.robots[robot];
            let Some(goal) = idle.goals.front().copied().filter(|_| !idle.is_busy) else { continue };
            idle.is_busy = true;
            idle.waited_us += now_us - idle.idle_us;
            self.happens(goal, Event::Accept)?;
            orders.push(Order::Go { robot, goal_m: self.map.place_m(self.goals[goal].cell) });
        }
        Ok(())
    }

    /// Creates the next goals when a robot has none: one after the other, each where the map's variance is largest.
    fn plan(&mut self, orders: &mut Vec<Order>) {
        let has_idle = self.robots.iter().any(|robot| !robot.is_lost && !robot.is_busy);
        let more = self.scene.samples - self.created;
        if self.is_planning || !has_idle || more + self.cells.len() == 0 {
            return;
        }
        let robots = self.robots.iter().filter(|robot| !robot.is_lost).count();
        let mut work = Work::default();
        for _ in 0..more.min(BATCH_PER_ROBOT * robots) {
            let cell = self.planned.least_known();
            // The cost of kriging: every cell is updated by every earlier sample.
            work.updates += (self.planned.cells() * (self.created + 1)) as u64;
            // The planned sample lowers the variance at once, so that the next goal is placed elsewhere.
            self.planned.add(cell, None);
            self.cells.push(cell);
            self.created += 1;
        }
        let cells = self.cells.len() as u64;
        work.bids = cells * (cells + 1) / 2 * robots as u64;
        self.is_planning = true;
        orders.push(Order::Plan(work));
    }

    /// Allocates cells by sequential single-item auctions. Of all robots and goals, the pair with the shortest total
    /// path of the robot, including the goal, is closed first.
    ///
    /// # Source
    /// Koenig et al., "The power of sequential single-item auctions for agent coordination", AAAI 2006, with the objective `MiniMax`.
    fn allocate(&mut self) {
        let mut paths: Vec<(usize, f64, [f64; 2])> = Vec::new();
        for (robot, state) in self.robots.iter().enumerate().filter(|(_, state)| !state.is_lost) {
            // The robot's path through its goals, from the last goal that it reached, or from its start.
            let ended = self.goals.iter().rev().find(|goal| goal.robot == robot && goal.state == State::Succeeded);
            let start = self.scene.starts[robot];
            let mut at_m = ended.map_or([start.x_m, start.y_m], |goal| self.map.place_m(goal.cell));
            let mut length_m = 0.0;
            for goal in &state.goals {
                let to_m = self.map.place_m(self.goals[*goal].cell);
                length_m += distance_m(at_m, to_m);
                at_m = to_m;
            }
            paths.push((robot, length_m, at_m));
        }
        if paths.is_empty() {
            return;
        }
        let mut cells = std::mem::take(&mut self.cells);
        while !cells.is_empty() {
            let mut best = (f64::INFINITY, 0, 0);
            for (path, (_, length_m, at_m)) in paths.iter().enumerate() {
                for (index, cell) in cells.iter().enumerate() {
                    let bid_m = length_m + distance_m(*at_m, self.map.place_m(*cell));
                    // Strictly less: equal bids go to the lower number, so that the result is reproducible.
                    if bid_m < best.0 {
                        best = (bid_m, path, index);
                    }
                }
            }
            let (bid_m, path, index) = best;
            let cell = cells.remove(index);
            let robot = paths[path].0;
            paths[path] = (robot, bid_m, self.map.place_m(cell));
            self.robots[robot].goals.push_back(self.goals.len());
            self.goals.push(Goal { cell, robot, state: State::Pending, reason: None });
        }
    }

    /// Ends the mission when no work remains, or no robot.
    fn end(&mut self, now_us: u64, orders: &mut Vec<Order>) {
        let is_done = self.created == self.scene.samples
            && self.cells.is_empty()
            && self.goals.iter().all(|goal| goal.state.is_terminal());
        let is_lost = self.robots.iter().all(|robot| robot.is_lost);
        if (is_done && !self.is_planning) || is_lost {
            for robot in self.robots.iter_mut().filter(|robot| !robot.is_lost) {
                robot.waited_us += now_us - robot.idle_us;
            }
            self.ended_us = Some(now_us);
            orders.push(Order::End);
        }
    }
}

impl Program for Mission {
    fn starts(&self) -> &[Place] {
        &self.scene.starts
    }

    fn deadline_s(&self) -> f64 {
        self.scene.deadline_s
    }

    fn has_ended(&self) -> bool {
        self.ended_us.is_some()
    }

    fn handle(&mut self, now_us: u64, input: Input, orders: &mut Vec<Order>) -> Result<(), Impossible> {
        // Reports that cross the end of the mission are ignored.
        if self.ended_us.is_some() {
            return Ok(());
        }
        match input {
            Input::Start => {}
            Input::Planned => {
                self.is_planning = false;
                self.allocate();
            }
            Input::Deadline => self.cancel_all(orders)?,
            Input::Arrived(robot, driven_m) => {
                self.robots[robot].driven_m += driven_m;
                if let Some(goal) = self.robots[robot].goals.front() {
                    let for_s = self.scene.sampling_s(self.goals[*goal].cell);
                    orders.push(Order::Sample { robot, for_s });
                }
            }
            Input::Sampled(robot, place_m) => {
                let goal = self.ended(robot, Event::Succeed, now_us)?;
                self.take(now_us, robot, goal, place_m);
            }
            Input::Stopped(robot, driven_m) => {
                self.robots[robot].driven_m += driven_m;
                self.ended(robot, Event::Canceled, now_us)?;
            }
            Input::Failed(robot, reason) => self.lose(robot, &reason, now_us)?,
        }
        // In this order: idle robots take waiting goals before new ones are planned.
        self.dispatch(now_us, orders)?;
        self.plan(orders);
        self.end(now_us, orders);
        Ok(())
    }
}

fn distance_m([x_m, y_m]: [f64; 2], [other_x_m, other_y_m]: [f64; 2]) -> f64 {
    (other_x_m - x_m).hypot(other_y_m - y_m)
}
