//! Environments that are stepped together.

use r4_rig::Place;
use rayon::prelude::*;

use crate::{
    Action, Error, Goal, Observation, Step, Truth,
    full::{Answer, FullBoard, Order},
    kinematic::Kinematic,
};

/// Fidelity of the simulation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fidelity {
    /// Full simulation of board and robot: reported results come from it.
    Full,
    /// Kinematic model identified from full boards: policies are trained on it.
    Kinematic,
}

/// Number of kinematic environments from which on all cores step them: one step takes about a microsecond, handing it
/// to another core as long as some tens of them.
const SHARED_FROM: usize = 256;

enum Boards {
    Full(Vec<FullBoard>),
    Kinematic(Vec<Kinematic>),
}

/// Environments that are reset and stepped together: full boards on a thread each, and so on all cores; kinematic ones
/// in slices.
///
/// Results depend on seeds and actions only, not on the number of cores.
pub struct Environments {
    boards: Boards,
    /// State of each environment: `None` without an episode; inside, the last step once the episode is over.
    ended: Vec<Option<Option<Step>>>,
}

impl Environments {
    /// Creates `count` environments without an episode: [`Environments::reset`] begins one in each.
    ///
    /// # Errors
    /// [`Error::NoSkidSteer`] when the robot does not fit; [`Error::Thread`] when there is no thread for a board.
    pub fn new(count: usize, fidelity: Fidelity) -> Result<Self, Error> {
        let boards = match fidelity {
            Fidelity::Full => Boards::Full((0..count).map(|_| FullBoard::new()).collect::<Result<_, _>>()?),
            Fidelity::Kinematic => {
                let one = Kinematic::new()?;
                Boards::Kinematic(vec![one; count])
            }
        };
        Ok(Self { boards, ended: vec![None; count] })
    }

    /// Number of environments in the set.
    #[must_use]
    pub fn len(&self) -> usize {
        self.ended.len()
    }

    /// Returns true when there are no environments.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.ended.is_empty()
    }

    /// Begins an episode in each environment. The seed decides the goal, and a full board's noise.
    ///
    /// # Errors
    /// [`Error::WrongCount`] unless there is one seed for each environment; [`Error::Rig`] when a board cannot be
    /// powered up or armed.
    pub fn reset(&mut self, seeds: &[u64]) -> Result<Vec<Observation>, Error> {
        self.count("seeds", seeds.len())?;
        let seeds: Vec<_> = seeds.iter().copied().map(Some).collect();
        Ok(self.reset_some(&seeds)?.into_iter().flatten().collect())
    }

    /// Begins an episode in each environment with a seed, and returns its first observation.
    ///
    /// # Errors
    /// The errors of [`Environments::reset`].
    pub fn reset_some(&mut self, seeds: &[Option<u64>]) -> Result<Vec<Option<Observation>>, Error> {
        self.count("seeds", seeds.len())?;
        let orders: Vec<_> = seeds.iter().map(|seed| seed.map(Order::Reset)).collect();
        let seen = |answer| match answer {
            Some(Answer::Seen(seen)) => Some(seen),
            Some(Answer::Stepped(_)) | None => None,
        };
        Ok(self.carry_out(&orders)?.into_iter().map(seen).collect())
    }

    /// Steps each environment. One whose episode is over stands still and returns its last step again, with a reward of
    /// 0.
    ///
    /// # Errors
    /// Before anything moves: [`Error::WrongCount`]; [`Error::BadAction`] for an action outside -1..=1;
    /// [`Error::NotReset`] without an episode. Afterwards: [`Error::Rig`] when a board fails otherwise than by a trip,
    /// which ends its episode.
    pub fn step(&mut self, actions: &[Action]) -> Result<Vec<Step>, Error> {
        let nothing = vec![None; self.len()];
        self.step_or_reset(actions, &nothing)
    }

    /// Steps each environment as [`Environments::step`], but begins an episode in those with a seed, at the same time.
    /// These ignore their action and have a reward of 0.
    ///
    /// # Errors
    /// The errors of [`Environments::step`] and [`Environments::reset`].
    pub fn step_or_reset(&mut self, actions: &[Action], seeds: &[Option<u64>]) -> Result<Vec<Step>, Error> {
        self.count("actions", actions.len())?;
        self.count("seeds", seeds.len())?;
        let mut orders = Vec::with_capacity(self.len());
        for (index, ((numbers, seed), ended)) in actions.iter().zip(seeds).zip(&self.ended).enumerate() {
            for (action, value) in numbers.iter().copied().enumerate() {
                if !(-1.0..=1.0).contains(&value) {
                    return Err(Error::BadAction { index, action, value });
                }
            }
            orders.push(match (seed, ended) {
                (Some(seed), _) => Some(Order::Reset(*seed)),
                (None, None) => return Err(Error::NotReset { index }),
                (None, Some(Some(_))) => None,
                (None, Some(None)) => Some(Order::Step(*numbers)),
            });
        }
        let answers = self.carry_out(&orders)?;
        let step = |(answer, (seed, ended)): (_, (&Option<u64>, &Option<Option<Step>>))| match (answer, ended) {
            (Some(Answer::Stepped(step)), _) => step,
            (Some(Answer::Seen(observation)), _) => {
                let distance_m = Goal::new(seed.unwrap_or_default()).distance_m(Place::default());
                let truth = Truth { distance_m, tripped: false };
                Step { observation, reward: 0.0, terminated: false, truncated: false, truth }
            }
            (None, Some(Some(last))) => Step { reward: 0.0, ..*last },
            // No order was given, so that the episode is over.
            (None, _) => Step::default(),
        };
        Ok(answers.into_iter().zip(seeds.iter().zip(&self.ended)).map(step).collect())
    }

    /// Carries out an order in each environment that has one, all at the same time.
    fn carry_out(&mut self, orders: &[Option<Order>]) -> Result<Vec<Option<Answer>>, Error> {
        let answers: Vec<Option<Result<Answer, Error>>> = match &mut self.boards {
            Boards::Full(boards) => {
                // All boards begin before the first answer is awaited; an error is returned only after every board has
                // answered.
                boards.iter().zip(orders).for_each(|(board, order)| order.iter().for_each(|order| board.order(*order)));
                let answer = |(index, (board, order)): (usize, (&FullBoard, &Option<Order>))| {
                    order.map(|_| board.answer().map_err(|error| at(index, error)))
                };
                boards.iter().zip(orders).enumerate().map(answer).collect()
            }
            Boards::Kinematic(boards) => {
                let carry_out = |(board, order): (&mut Kinematic, &Option<Order>)| {
                    order.map(|order| {
                        Ok(match order {
                            Order::Reset(seed) => Answer::Seen(board.reset(seed)),
                            Order::Step(action) => Answer::Stepped(board.step(action)),
                        })
                    })
                };
                if boards.len() < SHARED_FROM {
                    boards.iter_mut().zip(orders).map(carry_out).collect()
                } else {
                    boards.par_iter_mut().zip(orders).with_min_len(SHARED_FROM / 4).map(carry_out).collect()
                }
            }
        };
        for (ended, answer) in self.ended.iter_mut().zip(&answers) {
            match answer {
                Some(Ok(Answer::Seen(_))) => *ended = Some(None),
                Some(Ok(Answer::Stepped(step))) => *ended = Some((step.terminated || step.truncated).then_some(*step)),
                Some(Err(_)) => *ended = None,
                None => {}
            }
        }
        answers.into_iter().map(Option::transpose).collect()
    }

    /// Returns true for each environment whose episode is over or has not begun.
    pub fn is_over(&self) -> impl Iterator<Item = bool> {
        self.ended.iter().map(|ended| !matches!(ended, Some(None)))
    }

    fn count(&self, what: &'static str, given: usize) -> Result<(), Error> {
        if given == self.len() { Ok(()) } else { Err(Error::WrongCount { what, given, expected: self.len() }) }
    }
}

/// Adds the number of the environment to an error of its board.
fn at(index: usize, error: Error) -> Error {
    match error {
        Error::NotReset { .. } => Error::NotReset { index },
        Error::Gone { .. } => Error::Gone { index },
        error => error,
    }
}

impl Step {
    /// Returns true when the step reached the goal.
    #[must_use]
    pub fn reached(&self) -> bool {
        let Truth { tripped, .. } = self.truth;
        self.terminated && !tripped
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Proportional controller that turns towards the goal and drives, independent of the model.
    fn towards(seen: &Observation) -> Action {
        let [_, cos, sin, ..] = seen.map(f64::from);
        [if cos > 0.9 { 0.8 } else { 0.0 }, (1.5 * sin.atan2(cos)).clamp(-1.0, 1.0)]
    }

    fn driven(fidelity: Fidelity, seeds: &[u64]) -> Vec<Step> {
        let mut environments = Environments::new(seeds.len(), fidelity).expect("a robot");
        let mut seen = environments.reset(seeds).expect("boards");
        loop {
            let actions: Vec<Action> = seen.iter().map(towards).collect();
            let steps = environments.step(&actions).expect("boards");
            if environments.is_over().all(|over| over) {
                return steps;
            }
            seen = steps.iter().map(|step| step.observation).collect();
        }
    }

    #[test]
    fn goals_are_reached_at_both_fidelities() {
        for fidelity in [Fidelity::Full, Fidelity::Kinematic] {
            let steps = driven(fidelity, &[21, 22, 23]);
            assert!(steps.iter().all(Step::reached), "{fidelity:?}: {steps:?}");
        }
    }

    #[test]
    fn the_same_seeds_and_actions_give_the_same_bits_whatever_stands_beside() {
        let alone = driven(Fidelity::Full, &[5]);
        let beside = driven(Fidelity::Full, &[5, 6]);
        // The final state must agree. Its reward is 0 where it waited for the other environment.
        assert_eq!((alone[0].observation, alone[0].truth), (beside[0].observation, beside[0].truth));
    }

    #[test]
    fn one_begins_anew_while_another_goes_on() {
        for fidelity in [Fidelity::Full, Fidelity::Kinematic] {
            let mut both = Environments::new(2, fidelity).expect("a robot");
            both.reset(&[1, 2]).expect("boards");
            both.step(&[[1.0, 0.0]; 2]).expect("boards");
            let steps = both.step_or_reset(&[[1.0, 0.0]; 2], &[Some(3), None]).expect("boards");
            let fresh = Environments::new(1, fidelity).expect("a robot").reset(&[3]).expect("a board");
            assert_eq!((steps[0].observation, steps[0].reward), (fresh[0], 0.0));
            assert!(steps[1].observation[3] > 0.1, "it goes on: {:?}", steps[1]);
        }
    }

    #[test]
    fn what_cannot_be_done_is_said_before_anything_moves() {
        for fidelity in [Fidelity::Full, Fidelity::Kinematic] {
            let mut environments = Environments::new(2, fidelity).expect("a robot");
            assert!(matches!(environments.step(&[[0.0; 2]; 2]), Err(Error::NotReset { index: 0 })));
            assert!(matches!(environments.reset(&[1]), Err(Error::WrongCount { given: 1, expected: 2, .. })));
            environments.reset(&[1, 2]).expect("boards");
            for bad in [f64::NAN, 1.01, f64::NEG_INFINITY] {
                let error = environments.step(&[[0.0; 2], [0.0, bad]]).expect_err("bad");
                assert!(matches!(error, Error::BadAction { index: 1, action: 1, .. }), "{error}");
            }
            environments.step(&[[0.0; 2]; 2]).expect("still there");
        }
    }
}
