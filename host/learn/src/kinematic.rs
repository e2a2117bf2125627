//! The task on a kinematic model, for training.
//!
//! Each side's wheels follow their set points after a delay, with limited acceleration and a first-order lag; the
//! robot's forward speed and yaw rate are those of its wheels times a gain each. These five parameters stand for slip,
//! winding, friction and firmware; [`identify`] fits them to full boards. They are for training: reported results come
//! from full boards.
//!
//! Tried instead of the limited acceleration: a lag each for forward speed and yaw rate. Its residual was 36 mm RMS
//! after 1 s on seeds 9 to 12.

use r4_maths::minimise::nelder_mead;
use r4_rig::Place;
use rand_distr::{Distribution, StandardUniform};
use rand_pcg::Pcg64;

use crate::{
    Action, Error, Observation, STEP_S, Step,
    full::record,
    goal::{Episode, Truth},
    wheels::Wheels,
};

/// Parameters of the model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Model {
    /// Forward speed of the robot over that of its wheels.
    pub forward_gain: f64,
    /// Yaw rate of the robot over that of its wheels, with the track of its file.
    pub yaw_gain: f64,
    /// Largest acceleration of a wheel's rim, m/s².
    pub acceleration_m_s2: f64,
    /// Time constant of the wheels' lag behind that, s.
    pub lag_s: f64,
    /// Time from the decision to the start of the wheels' reaction, s; at most a step.
    pub delay_s: f64,
}

/// Model identified from full boards of seeds 1 to 8 by [`identify`]; the test
/// `the_numbers_are_those_of_the_experiment` repeats it. The lag is at the lower bound of the fit: the limited
/// acceleration, which is the profile's 1 m/s² of the robot's file, explains all of it.
pub const MODEL: Model =
    Model { forward_gain: 0.989, yaw_gain: 0.930, acceleration_m_s2: 1.033, lag_s: 0.001, delay_s: 0.022 };

/// Integration step of the path, s. With half of it, the position after 1 s changes by less than 0.1 mm.
const PATH_STEP_S: f64 = 0.01;
/// Steps over which a prediction is compared with a full board: 1 s.
const WINDOW: usize = 10;
/// Number of steps in a recording.
const RECORDED: usize = 100;
/// Weight of yaw errors against positions, m/rad: a third of the robot's length.
const YAW_M: f64 = 0.15;
/// Bounds of the fit, in the order of the model's fields.
const FITTED: [(f64, f64); 5] = [(0.5, 1.5), (0.5, 1.5), (0.1, 10.0), (0.001, 0.5), (0.0, STEP_S)];
/// Evaluations of each of three fits, which start from the best point before: the last one changes no parameter by
/// 1e-4.
const EVALUATIONS: usize = 400;
/// Stream of random numbers that separates excitations from other uses of a seed.
const PURPOSE: u128 = 0x6578_6369;

/// Environment of the task on a kinematic model.
#[derive(Clone, Debug)]
pub(crate) struct Kinematic {
    wheels: Wheels,
    episode: Episode,
    state: State,
}

/// Speeds of the left and the right rims, m/s.
type Sides = [f64; 2];

/// Motion of the model.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct State {
    at: Place,
    /// Ramped set points of the wheels' loops, m/s.
    ramped: Sides,
    /// Present rim speeds, m/s.
    rims: Sides,
    /// Requested rim speeds of the previous step, m/s.
    asked: Sides,
}

impl State {
    /// State after a step with the requested rim speeds `asked`, for a robot with this track, m.
    fn stepped(mut self, model: &Model, track_m: f64, asked: Sides) -> Self {
        let count = (STEP_S / PATH_STEP_S).round() as usize;
        let keep = (-PATH_STEP_S / model.lag_s).exp();
        let most = model.acceleration_m_s2 * PATH_STEP_S;
        let velocity = |[left, right]: Sides| {
            (model.forward_gain * (left + right) / 2.0, model.yaw_gain * (right - left) / track_m)
        };
        for step in 0..count {
            // The path step in which the delay ends gets a weighted mean of both requests.
            let late = ((model.delay_s / PATH_STEP_S) - step as f64).clamp(0.0, 1.0);
            let before = self.rims;
            for side in 0..2 {
                let target = late * self.asked[side] + (1.0 - late) * asked[side];
                self.ramped[side] += (target - self.ramped[side]).clamp(-most, most);
                self.rims[side] = self.ramped[side] + (before[side] - self.ramped[side]) * keep;
            }
            let (forward_m_s, yaw_rad_s) = velocity([0, 1].map(|side| (before[side] + self.rims[side]) / 2.0));
            let (way_m, turned_rad) = (forward_m_s * PATH_STEP_S, yaw_rad_s * PATH_STEP_S);
            let (sin, cos) = (self.at.yaw_rad + turned_rad / 2.0).sin_cos();
            self.at.x_m += way_m * cos;
            self.at.y_m += way_m * sin;
            self.at.yaw_rad += turned_rad;
        }
        self.asked = asked;
        self
    }
}

impl Kinematic {
    pub(crate) fn new() -> Result<Self, Error> {
        Ok(Self { wheels: Wheels::new()?, episode: Episode::new(0), state: State::default() })
    }

    pub(crate) fn reset(&mut self, seed: u64) -> Observation {
        (self.episode, self.state) = (Episode::new(seed), State::default());
        self.episode.goal.observation(self.state.at, 0.0, 0.0)
    }

    pub(crate) fn step(&mut self, action: Action) -> Step {
        let before = self.state.at;
        self.state = self.state.stepped(&MODEL, self.wheels.drive.track_m, self.wheels.rims_m_s(action));
        let at = self.state.at;
        let bow_rad = (before.yaw_rad + at.yaw_rad) / 2.0;
        let forward_m = (at.x_m - before.x_m) * bow_rad.cos() + (at.y_m - before.y_m) * bow_rad.sin();
        let (forward_m_s, yaw_rad_s) = (forward_m / STEP_S, (at.yaw_rad - before.yaw_rad) / STEP_S);
        let observation = self.episode.goal.observation(at, forward_m_s, yaw_rad_s);
        let truth = Truth { distance_m: self.episode.goal.distance_m(at), tripped: false };
        self.episode.step(observation, truth)
    }
}

/// Actions that excite the robot: each of both numbers is held for one to ten steps.
fn excitation(seed: u64) -> Vec<Action> {
    let mut random = Pcg64::new(seed.into(), PURPOSE);
    let mut share = move || -> f64 { StandardUniform.sample(&mut random) };
    let (mut action, mut held) = ([0.0; 2], [0u32; 2]);
    let mut step = || {
        for (number, left) in action.iter_mut().zip(&mut held) {
            if *left == 0 {
                (*number, *left) = (2.0 * share() - 1.0, 1 + (10.0 * share()) as u32);
            }
            *left -= 1;
        }
        action
    };
    (0..RECORDED).map(|_| step()).collect()
}

/// Drive of a full board: requested rim speeds of each step, and the true poses, one more.
struct Recording {
    track_m: f64,
    asked: Vec<Sides>,
    places: Vec<Place>,
}

fn recordings(seeds: &[u64]) -> Result<Vec<Recording>, Error> {
    let wheels = Wheels::new()?;
    let recorded = |seed: &u64| {
        let actions = excitation(*seed);
        let places = record(*seed, &actions)?;
        let asked = actions.iter().map(|action| wheels.rims_m_s(*action)).collect();
        Ok(Recording { track_m: wheels.drive.track_m, asked, places })
    };
    seeds.iter().map(recorded).collect()
}

/// RMS distance of predictions over 1 s from full boards, m; a radian of yaw counts as 0.15 m. Predictions restart each
/// second at the true pose, with the model's own speeds.
fn error_m(model: &Model, recordings: &[Recording]) -> f64 {
    let (mut squares, mut count) = (0.0, 0usize);
    for recording in recordings {
        let mut state = State::default();
        for (step, (asked, place)) in recording.asked.iter().zip(&recording.places[1..]).enumerate() {
            if step % WINDOW == 0 {
                state.at = recording.places[step];
            }
            state = state.stepped(model, recording.track_m, *asked);
            let off = [state.at.x_m - place.x_m, state.at.y_m - place.y_m, (state.at.yaw_rad - place.yaw_rad) * YAW_M];
            squares += off.iter().map(|number| number * number).sum::<f64>();
            count += 1;
        }
    }
    (squares / count.max(1) as f64).sqrt()
}

impl Model {
    /// Model of wheels that follow at once and do not slip: the reference for an identified model.
    pub const IDEAL: Self =
        Self { forward_gain: 1.0, yaw_gain: 1.0, acceleration_m_s2: 1e3, lag_s: 0.001, delay_s: 0.0 };

    fn of(numbers: &[f64]) -> Self {
        let of = |place: usize| numbers.get(place).copied().unwrap_or(0.0);
        Self { forward_gain: of(0), yaw_gain: of(1), acceleration_m_s2: of(2), lag_s: of(3), delay_s: of(4) }
    }

    /// RMS distance of the model's predictions over 1 s from full boards of these seeds, m, with a radian of yaw as
    /// 0.15 m.
    ///
    /// # Errors
    /// [`Error::Rig`] when a board cannot be driven.
    pub fn error_m(&self, seeds: &[u64]) -> Result<f64, Error> {
        Ok(error_m(self, &recordings(seeds)?))
    }
}

/// Identifies the model that best predicts full boards of these seeds one second ahead, each over 10 s of random
/// actions.
///
/// # Errors
/// [`Error::Rig`] when a board cannot be driven.
pub fn identify(seeds: &[u64]) -> Result<Model, Error> {
    let recordings = recordings(seeds)?;
    let cost = |numbers: &[f64]| error_m(&Model::of(numbers), &recordings);
    let mut at = vec![1.0, 1.0, 1.0, 0.02, 0.02];
    for _ in 0..3 {
        at = nelder_mead(&FITTED, &at, EVALUATIONS, cost).at;
    }
    Ok(Model::of(&at))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Seeds 1 to 8, from which MODEL was identified.
    const TRAINING: [u64; 8] = [1, 2, 3, 4, 5, 6, 7, 8];

    #[test]
    fn the_numbers_are_those_of_the_experiment() {
        let found = identify(&TRAINING).expect("boards");
        println!("{found:?}");
        // MODEL is rounded to three decimals.
        let pairs = [
            (found.forward_gain, MODEL.forward_gain),
            (found.yaw_gain, MODEL.yaw_gain),
            (found.acceleration_m_s2, MODEL.acceleration_m_s2),
            (found.lag_s, MODEL.lag_s),
            (found.delay_s, MODEL.delay_s),
        ];
        for (found, committed) in pairs {
            assert!((found - committed).abs() < 1e-3, "{found} is committed as {committed}");
        }
    }

    /// Prediction on seeds that were not used for the fit. The factor of five against ideal wheels was measured on
    /// seeds 1 to 8.
    #[test]
    fn it_predicts_other_boards_better_than_ideal_wheels() {
        let seeds = [9, 10, 11, 12];
        let (identified_m, ideal_m) =
            (MODEL.error_m(&seeds).expect("boards"), Model::IDEAL.error_m(&seeds).expect("boards"));
        println!("{identified_m} m, ideal wheels {ideal_m} m");
        assert!(5.0 * identified_m < ideal_m, "{identified_m} m, ideal wheels {ideal_m} m");
    }

    const TRACK_M: f64 = 0.35;

    #[test]
    fn a_lag_without_delay_follows_its_closed_form() {
        let model = Model { forward_gain: 0.9, yaw_gain: 1.1, acceleration_m_s2: 1e3, lag_s: 0.08, delay_s: 0.0 };
        let mut state = State::default();
        for _ in 0..5 {
            state = state.stepped(&model, TRACK_M, [0.4, 0.4]);
        }
        let decay = (-0.5f64 / 0.08).exp();
        assert!((state.rims[0] - 0.4 * (1.0 - decay)).abs() < 1e-12);
        // Error of the trapezoidal rule over one lag: 0.01²/(12 · 0.08) of the speed.
        assert!((state.at.x_m - 0.36 * (0.5 - 0.08 * (1.0 - decay))).abs() < 5e-5, "{}", state.at.x_m);
        assert_eq!((state.at.y_m, state.at.yaw_rad), (0.0, 0.0));
    }

    #[test]
    fn limited_acceleration_is_a_ramp() {
        let model = Model { acceleration_m_s2: 1.0, lag_s: 1e-4, ..Model::IDEAL };
        let state = State::default().stepped(&model, TRACK_M, [0.5, 0.5]);
        // With a lag much shorter than a path step only the ramp remains: half of a t².
        assert!((state.rims[0] - 0.1).abs() < 1e-12 && (state.at.x_m - 0.005).abs() < 1e-12, "{state:?}");
    }

    #[test]
    fn a_delay_of_a_step_is_the_step_before() {
        let late = Model { delay_s: STEP_S, ..Model::IDEAL };
        let first = State::default().stepped(&late, TRACK_M, [0.3, 0.4]);
        assert_eq!(first.at, Place::default());
        let second = first.stepped(&late, TRACK_M, [0.0, 0.0]);
        let at_once = State::default().stepped(&Model::IDEAL, TRACK_M, [0.3, 0.4]);
        assert!((second.at.x_m - at_once.at.x_m).abs() < 1e-12 && at_once.at.yaw_rad > 0.0);
    }
}
