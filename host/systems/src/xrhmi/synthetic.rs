//! Synthetic participants as numbers, without a board: trial times of whole studies, to measure how often an analysis finds
//! what is there, and what is not.
//!
//! Nothing here is about people. The differences between modalities are those that the paper's powers imply; how the variance divides into
//! person, order and the rest is our choice, and printed with each result.

use super::analysis::Person;
use crate::{participants::williams_order, sampler::Sampler};

/// Purposes of the random numbers.
const OF_STUDY: u64 = 1_710;
const OF_TIMES: u64 = 1_711;
/// Mean time of a visual trial, s, and standard deviation of the times between persons, s: synthetic. The paper has both in a figure
/// only.
const MEAN_S: f64 = 40.0;
const SPREAD_S: f64 = 6.0;

/// Population from which studies are sampled.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Population {
    /// Differences to the visual modality over the standard deviation between persons, for auditory and haptic.
    pub differences: [f64; 2],
    /// Share of the variance between persons that a person has in all modalities alike.
    pub person_share: f64,
    /// Share of that variance that comes from the place of the trial in the sequence.
    pub order_share: f64,
}

impl Population {
    /// Population with the differences that the paper's powers imply: d = 1.02 from haptic to visual and 0.96 from haptic
    /// to auditory.
    #[must_use]
    pub const fn of_paper(person_share: f64, order_share: f64) -> Self {
        Self { differences: [1.02 - 0.96, 1.02], person_share, order_share }
    }

    /// The same population without any difference between modalities.
    #[must_use]
    pub const fn without_difference(self) -> Self {
        Self { differences: [0.0; 2], ..self }
    }

    /// Samples one study of `persons` people in counterbalanced orders.
    #[must_use]
    pub fn study(&self, seed: u64, number: u64, persons: usize) -> Vec<Person> {
        let mut sampler = Sampler::new(seed, (OF_STUDY << 32) + number);
        // Places 1, 2 and 3 equally often have a variance of 2/3 of a place squared.
        let per_place_s = -SPREAD_S * (1.5 * self.order_share).sqrt();
        let rest = SPREAD_S * (1.0 - self.person_share - self.order_share).max(0.0).sqrt();
        let person = |number: usize| {
            let mut places = [0.0; 3];
            for (place, modality) in williams_order(number, 3).into_iter().enumerate() {
                places[modality] = place as f64 + 1.0;
            }
            let own_s = sampler.normal(SPREAD_S * self.person_share.sqrt());
            let differences = [0.0, self.differences[0], self.differences[1]];
            let values = std::array::from_fn(|at| {
                let learnt_s = per_place_s * (places[at] - 2.0);
                MEAN_S + own_s + SPREAD_S * differences[at] + learnt_s + sampler.normal(rest)
            });
            Person { places, values }
        };
        (0..persons).map(person).collect()
    }
}

/// Hidden effect in the times of single commands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Hidden {
    /// Time saved per command from one trial to the next, s.
    Order(f64),
    /// Time saved from one command to the next within a trial, s.
    Practice(f64),
    /// Share of haptic cues with both bands whose buzzes are miscounted, which costs a wrong way each.
    Miscount(f64),
}

/// Time that a miscounted cue costs, s: the wrong way, and the wait for the next presentation.
pub const MISCOUNT_S: f64 = 2.5;

impl Hidden {
    /// The effect of this name with a size sampled from `seed`; `None` for any other name.
    #[must_use]
    pub fn named(name: &str, seed: u64) -> Option<Self> {
        let mut sampler = Sampler::new(seed, OF_TIMES);
        match name {
            "order" => Some(Self::Order(sampler.uniform(0.15, 0.35))),
            "practice" => Some(Self::Practice(sampler.uniform(0.02, 0.05))),
            "miscount" => Some(Self::Miscount(sampler.uniform(0.4, 0.8))),
            _ => None,
        }
    }

    /// Size as an analysis of times finds it: seconds per trial, per command, or per haptic cue with both bands.
    #[must_use]
    pub fn size_s(self) -> f64 {
        match self {
            Self::Order(saved_s) | Self::Practice(saved_s) => -saved_s,
            Self::Miscount(share) => share * MISCOUNT_S,
        }
    }
}

/// Times of one synthetic person's commands.
#[derive(Clone, Debug, PartialEq)]
pub struct PersonTimes {
    /// Place of each modality in the sequence, 1 to 3.
    pub places: [f64; 3],
    /// Time of each command, s, and whether its zone is centre or discard, by modality.
    pub commands: [Vec<(f64, bool)>; 3],
}

/// Samples the command times of a study with a hidden effect, or none.
#[must_use]
pub fn command_times(seed: u64, persons: usize, hidden: Option<Hidden>) -> Vec<PersonTimes> {
    let mut sampler = Sampler::new(seed, OF_TIMES + 1);
    let person = |number: usize| {
        let pace = sampler.normal(0.15).exp();
        let order = williams_order(number, 3);
        let mut places = [0.0; 3];
        let mut commands = [const { Vec::new() }; 3];
        for (place, modality) in order.into_iter().enumerate() {
            places[modality] = place as f64 + 1.0;
            let own_s = sampler.normal(0.12);
            for (step, command) in super::cue::commands(seed.wrapping_mul(64) + number as u64, place).iter().enumerate()
            {
                let is_both = matches!(command.zone, super::cue::Zone::Centre | super::cue::Zone::Discard);
                let mut time_s = pace * ([1.9, 2.0, 2.3][modality] + own_s) + sampler.normal(0.3);
                match hidden {
                    Some(Hidden::Order(saved_s)) => time_s -= saved_s * place as f64,
                    Some(Hidden::Practice(saved_s)) => time_s -= saved_s * step as f64,
                    Some(Hidden::Miscount(share)) if modality == 2 && is_both && sampler.uniform(0.0, 1.0) < share => {
                        time_s += MISCOUNT_S;
                    }
                    _ => {}
                }
                commands[modality].push((time_s, is_both));
            }
        }
        PersonTimes { places, commands }
    };
    (0..persons).map(person).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The variance between persons is that of the population, whatever its shares: d is then Cohen's.
    #[test]
    fn shares_divide_one_variance() {
        for (person_share, order_share) in [(0.0, 0.0), (0.7, 0.05), (0.5, 0.3)] {
            let population = Population::of_paper(person_share, order_share);
            let people: Vec<Person> = (0..2000).flat_map(|number| population.study(1, number, 12)).collect();
            let of = |at: usize| people.iter().map(|person| person.values[at]).collect::<Vec<f64>>();
            let spread = |at: usize| r4_maths::statistics::standard_deviation(&of(at)).expect("many");
            let mean = |at: usize| r4_maths::statistics::mean(&of(at)).expect("many");
            // Of 24 000 values the standard deviation is within 0.5 % (one sigma), correlated places more.
            assert!((spread(0) / SPREAD_S - 1.0).abs() < 0.03, "{}", spread(0));
            assert!(((mean(2) - mean(0)) / SPREAD_S - 1.02).abs() < 0.04, "{person_share} {order_share}");
        }
    }
}
