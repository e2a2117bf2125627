//! The task `openscout-goto`: drive to a goal on the open plane.
//!
//! | | |
//! | --- | --- |
//! | action | forward speed and yaw rate, each -1..1 of what the robot may be asked for |
//! | observation | distance to the goal by odometry, m; cosine and sine of its bearing off the bow; forward speed, m/s, and yaw rate, rad/s, both means over the last step by the wheels |
//! | reward | way towards the goal in the last step, m, by the truth, less 0.01 for the time; and 1 for reaching it, -1 for a trip |
//! | terminated | nearer to the goal than 0.1 m by the truth; or the board has tripped |
//! | truncated | after 300 steps of 0.1 s |
//!
//! Goals are 1 m to 3 m away in any direction. The robot sees its goal by odometry and is rewarded by the truth: a policy that makes
//! its wheels slip loses by it.

use std::f64::consts::PI;

use r4_rig::Place;
use rand_distr::{Distribution, Uniform};
use rand_pcg::Pcg64;

/// Number of values in an action.
pub const ACTIONS: usize = 2;
/// Number of values in an observation.
pub const OBSERVATIONS: usize = 5;
/// Action: forward speed and yaw rate, as shares of the robot's limits, -1 to 1.
pub type Action = [f64; ACTIONS];
/// Observation, as in the module's table; `f32`, like in learning libraries.
pub type Observation = [f32; OBSERVATIONS];
/// Time between two decisions, s. Our choice: OpenScout's own controller runs at 20 Hz, planners of such robots at 5 Hz
/// to 20 Hz.
pub const STEP_S: f64 = 0.1;
/// Number of steps after which an episode is truncated: 30 s, in which the robot could drive 15 m.
pub const EPISODE_STEPS: u32 = 300;
/// Distance at which the goal is reached, m. Our choice: a quarter of the robot's length.
pub const REACHED_M: f64 = 0.1;
/// Lowest and highest value of each number of an observation; measured values are clipped to them. The distance covers
/// a goal 3 m away and an episode at 0.5 m/s; speeds are four times the robot's limits, for noise.
pub const BOUNDS: [(f32, f32); OBSERVATIONS] = [(0.0, 20.0), (-1.0, 1.0), (-1.0, 1.0), (-2.0, 2.0), (-6.0, 6.0)];
/// Distance of the nearest and the farthest goal, m.
const GOAL_M: (f64, f64) = (1.0, 3.0);
/// Cost of a step, m: a straight drive at full speed earns 0.05 a step.
const TIME_COST: f64 = 0.01;
/// Stream of random numbers that separates goals from other uses of a seed.
const PURPOSE: u128 = 0x676f_7474;

/// A goal, in the frame of the robot's start.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Goal {
    /// Position along the initial heading, m.
    pub x_m: f64,
    /// Position to the left of the initial heading, m.
    pub y_m: f64,
}

/// True state after a step, which the robot does not observe.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Truth {
    /// True distance to the goal, m.
    pub distance_m: f64,
    /// True when the board has tripped.
    pub tripped: bool,
}

/// Result of a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Step {
    /// Observation after the step.
    pub observation: Observation,
    /// Reward of the step, as in the module's table.
    pub reward: f64,
    /// True when the episode is over because the goal was reached or the board tripped.
    pub terminated: bool,
    /// True when the episode is over because of its time limit.
    pub truncated: bool,
    /// True state after the step.
    pub truth: Truth,
}

impl Goal {
    /// Samples the goal of an episode from its seed.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        let mut random = Pcg64::new(seed.into(), PURPOSE);
        let mut uniform = |low: f64, high: f64| {
            // Cannot fail: the bounds are finite and in order.
            Uniform::new(low, high).map_or(low, |uniform| uniform.sample(&mut random))
        };
        let (distance_m, bearing_rad) = (uniform(GOAL_M.0, GOAL_M.1), uniform(-PI, PI));
        Self { x_m: distance_m * bearing_rad.cos(), y_m: distance_m * bearing_rad.sin() }
    }

    /// Distance from a pose, m.
    #[must_use]
    pub fn distance_m(self, at: Place) -> f64 {
        (self.x_m - at.x_m).hypot(self.y_m - at.y_m)
    }

    /// Observation of a robot whose odometry is at a pose, with these measured speeds, m/s and rad/s.
    #[must_use]
    pub fn observation(self, at: Place, forward_m_s: f64, yaw_rad_s: f64) -> Observation {
        let bearing_rad = (self.y_m - at.y_m).atan2(self.x_m - at.x_m) - at.yaw_rad;
        let numbers = [self.distance_m(at), bearing_rad.cos(), bearing_rad.sin(), forward_m_s, yaw_rad_s];
        let mut observation = [0.0; OBSERVATIONS];
        for ((seen, number), (low, high)) in observation.iter_mut().zip(numbers).zip(BOUNDS) {
            *seen = (number as f32).clamp(low, high);
        }
        observation
    }
}

/// State of an episode, at either fidelity.
#[derive(Clone, Debug)]
pub(crate) struct Episode {
    pub(crate) goal: Goal,
    distance_m: f64,
    steps: u32,
}

impl Episode {
    pub(crate) fn new(seed: u64) -> Self {
        let goal = Goal::new(seed);
        Self { goal, distance_m: goal.distance_m(Place::default()), steps: 0 }
    }

    /// Evaluates a step by its observation and true state.
    pub(crate) fn step(&mut self, observation: Observation, truth: Truth) -> Step {
        self.steps += 1;
        let way_m = self.distance_m - truth.distance_m;
        self.distance_m = truth.distance_m;
        let reached = truth.distance_m < REACHED_M && !truth.tripped;
        let end = if truth.tripped { -1.0 } else { f64::from(reached) };
        let terminated = reached || truth.tripped;
        Step {
            observation,
            reward: way_m - TIME_COST + end,
            terminated,
            truncated: !terminated && self.steps >= EPISODE_STEPS,
            truth,
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn rewards_add_up_to_the_way_less_time_and_an_end() {
        let mut episode = Episode::new(7);
        let begin_m = episode.goal.distance_m(Place::default());
        let seen = episode.goal.observation(Place::default(), 0.0, 0.0);
        let mut sum = 0.0;
        for distance_m in [begin_m * 0.7, begin_m * 0.8, 0.05] {
            let step = episode.step(seen, Truth { distance_m, tripped: false });
            assert_eq!(step.terminated, distance_m < REACHED_M);
            sum += step.reward;
        }
        assert!((sum - (begin_m - 0.05 - 0.03 + 1.0)).abs() < 1e-12, "{sum}");
    }

    #[test]
    fn a_trip_ends_an_episode_also_at_the_goal() {
        let mut episode = Episode::new(7);
        let distance_m = episode.goal.distance_m(Place::default());
        let step = episode.step([0.0; OBSERVATIONS], Truth { distance_m, tripped: true });
        assert!(step.terminated && !step.truncated && (step.reward + 1.01).abs() < 1e-12, "{step:?}");
    }

    #[test]
    fn an_episode_without_an_end_is_truncated_once() {
        let mut episode = Episode::new(7);
        let truth = Truth { distance_m: 2.0, tripped: false };
        let over = (0..EPISODE_STEPS).filter(|_| episode.step([0.0; OBSERVATIONS], truth).truncated).count();
        assert_eq!(over, 1);
    }

    proptest! {
        #[test]
        fn goals_and_observations_are_within_their_bounds(
            seed: u64, x_m in -30.0..30.0f64, y_m in -30.0..30.0f64, yaw_rad in -50.0..50.0f64, speed in -9.0..9.0f64
        ) {
            let goal = Goal::new(seed);
            prop_assert!((GOAL_M.0..=GOAL_M.1).contains(&goal.distance_m(Place::default())));
            let seen = goal.observation(Place { x_m, y_m, yaw_rad }, speed, speed);
            for (number, (low, high)) in seen.into_iter().zip(BOUNDS) {
                prop_assert!((low..=high).contains(&number));
            }
            // Rounding errors of f32.
            prop_assert!((seen[1].hypot(seen[2]) - 1.0).abs() < 1e-6);
        }
    }
}
