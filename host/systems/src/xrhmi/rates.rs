//! Rates at which analyses of synthetic studies claim a difference: with the paper's differences, and without any.

use r4_maths::statistics::{Alternative, StatisticsError, holm, paired_t, welch_t, wilcoxon_signed_rank};

use super::{
    PEOPLE,
    analysis::{self, PAIRS, Person},
    synthetic::Population,
};
use crate::{Curve, Error, Figure, Panel, Sampler, participants::ParticipantsError};

/// Purposes of the random numbers: the shares of the variance, and the places of people who do one modality only.
const OF_SHARES: u64 = 1_730;
const OF_PLACES: u64 = 1_740 << 32;
/// Number of studies with a difference, and without, in a trial; rows are means of many trials. The rate of false alarms is
/// close to its limit, 0.046 in 200 000 studies in NumPy: of 8 trials, with 200 studies in each, its standard error was 0.005, and
/// such a row missed the limit by chance; with 2000 it is 0.0017.
const STUDIES: [u64; 2] = [200, 2000];
/// Level of all tests.
const LEVEL: f64 = 0.05;

/// Way to analyse a study.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Analysis {
    /// The paper's: Welch's t-test between persons, uncorrected, of other people in each modality, as it assumes.
    Independent,
    /// The same test of the same people in all modalities, as the paper's trials were.
    Welch,
    /// Pairs within persons with the order as covariate, Holm's correction.
    Paired,
    /// Paired t-test without the order, Holm's correction.
    Unordered,
    /// Wilcoxon's signed ranks without the order, Holm's correction.
    Wilcoxon,
}

/// Rates of claims.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Rates {
    /// Share of studies that claim the difference of haptic to visual, and to auditory.
    pub(super) powers: [f64; 2],
    /// Share of studies without any difference that claim at least one.
    pub(super) false_alarms: f64,
}

/// Rates of a population whose shares are sampled from `seed`.
pub(super) fn sampled(seed: u64, analysis: Analysis) -> Result<Rates, Error> {
    let mut sampler = Sampler::new(seed, OF_SHARES);
    let (person_share, order_share) = (sampler.uniform(0.6, 0.8), sampler.uniform(0.0, 0.1));
    of(seed, &Population::of_paper(person_share, order_share), analysis, STUDIES)
}

/// Rates of a population, over numbers of studies with a difference and without.
fn of(seed: u64, population: &Population, analysis: Analysis, studies: [u64; 2]) -> Result<Rates, Error> {
    let none = population.without_difference();
    let claims = |population: &Population, number: u64| {
        let people = match analysis {
            Analysis::Independent => strangers(population, seed, number),
            _ => population.study(seed, number, PEOPLE),
        };
        claims(&people, analysis).map_err(|why| Error::Effects(why.to_string()))
    };
    let mut rates = Rates { powers: [0.0; 2], false_alarms: 0.0 };
    for number in 0..studies[0] {
        for (power, found) in rates.powers.iter_mut().zip(claims(population, number)?) {
            *power += f64::from(u8::from(found)) / studies[0] as f64;
        }
    }
    // Other people than those with a difference.
    for number in studies[0]..studies[0] + studies[1] {
        rates.false_alarms += f64::from(u8::from(claims(&none, number)?.contains(&true))) / studies[1] as f64;
    }
    Ok(rates)
}

/// Samples a study in which other people do each modality, each at a place of their own.
fn strangers(population: &Population, seed: u64, number: u64) -> Vec<Person> {
    /// Number of people over which a Williams design has each modality at each place equally often.
    const BLOCK: usize = 6;
    let mut sampler = Sampler::new(seed, OF_PLACES + number);
    // Numbers beyond those of the other studies, so that no person is in two of them.
    let studies = [0, 1, 2].map(|modality| population.study(seed, (1 + modality) * 1_000_000 + number, BLOCK * PEOPLE));
    let mut person = |at: usize| {
        // One of six, so that the place is random: a design that balances the places would take their variance away.
        let chosen = studies.each_ref().map(|study| {
            let place = sampler.uniform(0.0, BLOCK as f64) as usize;
            study[BLOCK * at + place.min(BLOCK - 1)]
        });
        Person {
            places: std::array::from_fn(|modality| chosen[modality].places[modality]),
            values: std::array::from_fn(|modality| chosen[modality].values[modality]),
        }
    };
    (0..PEOPLE).map(&mut person).collect()
}

/// Two-sided p-value of a test of two samples.
type Test = dyn Fn(&[f64], &[f64]) -> Result<f64, StatisticsError>;

/// Claims of one study, in the order of [`PAIRS`].
fn claims(people: &[Person], analysis: Analysis) -> Result<[bool; 3], ParticipantsError> {
    let values = |at: usize| people.iter().map(|person| person.values[at]).collect::<Vec<f64>>();
    // By the tests alone where the order does not matter: places sampled for strangers may all be equally far apart.
    let each = |test: &Test| {
        let mut p_values = [1.0; 3];
        for (p, [first, second]) in p_values.iter_mut().zip(PAIRS) {
            *p = test(&values(first), &values(second))?;
        }
        Ok::<_, StatisticsError>(p_values)
    };
    let p_values = match analysis {
        Analysis::Paired => analysis::compare(people)?.map(|comparison| comparison.holm_p),
        Analysis::Independent | Analysis::Welch => each(&|a, b| Ok(welch_t(a, b, Alternative::TwoSided)?.p_value))?,
        Analysis::Unordered => corrected(each(&|a, b| Ok(paired_t(a, b, Alternative::TwoSided)?.p_value))?)?,
        Analysis::Wilcoxon => corrected(each(&|a, b| Ok(wilcoxon_signed_rank(a, b, Alternative::TwoSided)?.p_value))?)?,
    };
    Ok(p_values.map(|p| p <= LEVEL))
}

fn corrected(p_values: [f64; 3]) -> Result<[f64; 3], ParticipantsError> {
    let corrected = holm(&p_values)?;
    Ok([corrected[0], corrected[1], corrected[2]])
}

/// Rates over the person's share of the variance, with 5 % for the order.
pub(super) fn figure(seed: u64) -> Result<Figure, Error> {
    const SHARES: usize = 19;
    const ORDER: f64 = 0.05;
    let mut powers = [Vec::new(), Vec::new(), Vec::new()];
    let mut alarms = [Vec::new(), Vec::new(), Vec::new()];
    let analyses = [Analysis::Paired, Analysis::Unordered, Analysis::Welch];
    for step in 0..SHARES {
        let share = step as f64 * 0.05;
        for (place, analysis) in analyses.into_iter().enumerate() {
            let rates = of(seed, &Population::of_paper(share, ORDER), analysis, [1000; 2])?;
            powers[place].push((share, rates.powers[0]));
            alarms[place].push((share, rates.false_alarms));
        }
    }
    let curves = |points: [Vec<(f64, f64)>; 3]| {
        let names = ["paired, order as covariate, Holm", "paired, Holm", "Welch of the same people"];
        names.into_iter().zip(points).map(|(name, points)| Curve { name, points }).collect()
    };
    Ok(Figure {
        description: format!(
            "how often studies of {PEOPLE} synthetic people claim a difference, over the person's share of the variance, seed {seed}"
        ),
        axis: "Person's share of the variance",
        panels: vec![
            Panel { title: "Power, haptic against visual, d = 1.02", curves: curves(powers) },
            Panel { title: "False alarms, no difference at all", curves: curves(alarms) },
        ],
    })
}
