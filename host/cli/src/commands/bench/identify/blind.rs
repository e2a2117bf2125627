//! Simulated plants with a hidden effect that the identifier does not know, or with faults in their recordings: how
//! often the effect or fault is found, and how well its intervals cover the truth.

use std::{collections::BTreeMap, fmt, time::Instant};

use anyhow::Context;
use r4_blind::{
    Draw, Truth, Value,
    experiment::{Experiment, Length, Recording, Setup, experiment},
    fault::{Broken, Timing, TimingKind},
};
use r4_identify::{
    data::{Quantity, Run, Signal},
    report::{EffectReport, Explained, Report},
};
use r4_maths::statistics;
use rayon::iter::{IntoParallelIterator, ParallelIterator};

use super::{
    Bench, Row,
    coverage::{self, Compared, compared},
    recorded::names,
};
use crate::args::IdentifyRows;

const CATALOGUE: &str = "an effect of the catalogue";
const PAIRS: &str = "two effects of the catalogue";
const NOTHING: &str = "nothing hidden";
const OUTSIDE: &str = "effects in no catalogue";
const BROKEN: &str = "broken recordings";

/// Ratio of the final model's RMSE to the noise up to which an effect counts as explained.
const WITHIN: f64 = 1.15;

/// Fault of a plant's recordings.
#[derive(Clone, Debug, PartialEq)]
enum Fault {
    Timing(Timing),
    Broken(Broken, Vec<Value>),
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Timing(timing) => write!(f, "{timing}"),
            Self::Broken(broken, numbers) => {
                write!(f, "{broken}")?;
                numbers.iter().try_for_each(|one| write!(f, ", {} {:.3} {}", one.name, one.value, one.unit))
            }
        }
    }
}

/// Result of identifying one plant.
struct Outcome {
    truth: Vec<Truth>,
    fault: Fault,
    /// Standard deviation of the noise: the residual of a model with the true effects.
    noise: f64,
    /// Parameters of the first effect beside their true values.
    compared: Vec<Compared>,
    report: Option<Report>,
}

fn setup(number: u32) -> Setup {
    Setup::ALL[number as usize % Setup::ALL.len()]
}

fn drawn(number: u32, draw: Draw, length: Length, first_seed: u64) -> Experiment {
    experiment(setup(number), draw, length, first_seed.wrapping_add(number.into()))
}

/// Plant without a hidden effect. Stamps are true for even numbers, and faulty for odd ones, in every kind for every
/// setup.
fn drawn_clean(number: u32, first_seed: u64) -> (Experiment, Fault) {
    let mut experiment = drawn(number, Draw::Nothing, Length::STANDARD, first_seed);
    if number.is_multiple_of(2) {
        return (experiment, Fault::Timing(Timing::True));
    }
    let seed = first_seed.wrapping_add(number.into());
    let timing = TimingKind::ALL[(number / 2) as usize % TimingKind::ALL.len()].sample(seed);
    timing.apply(&mut experiment, seed);
    (experiment, Fault::Timing(timing))
}

/// Plant with broken recordings, of each kind for each suitable setup; seven without a hidden effect, then seven with
/// an effect of the catalogue.
fn drawn_broken(number: u32, first_seed: u64, length: Length) -> (Experiment, Fault) {
    let kinds = Broken::ALL.len() as u32;
    let broken = Broken::ALL[(number % kinds) as usize];
    let setup = Some(setup(number)).filter(|setup| broken.suits(*setup)).unwrap_or(Setup::MotorPosition);
    let draw = if (number / kinds).is_multiple_of(2) { Draw::Nothing } else { Draw::Listed };
    let seed = first_seed.wrapping_add(number.into());
    let mut experiment = experiment(setup, draw, length, seed);
    let numbers = broken.apply(&mut experiment, seed).unwrap_or_default();
    (experiment, Fault::Broken(broken, numbers))
}

fn run(setup: Setup, name: String, recording: &Recording) -> Run {
    let (input, output) = match setup {
        Setup::MotorPosition => (Quantity::Number, Quantity::Angle),
        Setup::MotorSpeed => (Quantity::Number, Quantity::AngularSpeed),
        Setup::AxisPosition => (Quantity::Force, Quantity::Length),
    };
    let signal = |role: &str, column: &str, quantity, values: &[f64]| {
        (role.to_owned(), Signal { column: column.to_owned(), quantity, values: values.to_vec() })
    };
    let mut signals = BTreeMap::from([
        signal("input", setup.input(), input, &recording.input),
        signal("output", setup.output(), output, &recording.output),
    ]);
    if !recording.speed.is_empty() {
        signals.extend([signal("speed", "speed_rad_s", Quantity::AngularSpeed, &recording.speed)]);
    }
    Run { name, time_s: recording.time_s.clone(), origin_s: None, signals }
}

fn identify(bench: &Bench<'_>, experiment: &Experiment) -> Result<Report, r4_identify::IdentifyError> {
    let runs = |what: &str, recordings: &[Recording]| -> Vec<Run> {
        let numbered = recordings.iter().enumerate();
        numbered.map(|(number, one)| run(experiment.setup, format!("{what} {number}"), one)).collect()
    };
    let (train, test) = (runs("train", &experiment.train), runs("test", &experiment.holdout));
    let supply = [("supply_v", experiment.supply_v)];
    let (model, known) = match experiment.setup {
        Setup::MotorPosition | Setup::MotorSpeed => ("dc-motor", &supply[..]),
        // The axis is driven by its force.
        Setup::AxisPosition => ("axis", &[("gain_per_unit", 1.0)][..]),
    };
    Ok(bench.identify(model, known, &train, &test)?.report)
}

fn outcomes(
    bench: &Bench<'_>,
    rows: IdentifyRows,
    made: impl Fn(u32, u64) -> (Experiment, Fault) + Sync,
) -> Vec<Outcome> {
    let outcome = |number| {
        let (experiment, fault) = made(number, rows.first_seed(bench.base));
        let started = Instant::now();
        let report = identify(bench, &experiment);
        let truth = experiment.hidden.truth().to_vec();
        bench.progress.inc(1);
        let why = report.as_ref().err().map(ToString::to_string);
        let report = report.ok();
        let first = report.as_ref().and_then(|report| report.effects.first());
        let compared = truth.first().zip(first).map(|(truth, first)| compared(&experiment, truth, first));
        let outcome = Outcome { truth, fault, noise: experiment.noise, compared: compared.unwrap_or_default(), report };
        if let Some(why) = why {
            bench.say(&format!("r4: number {number} ({}) gave no result: {why}", outcome.fault));
        } else if bench.each {
            let seconds = started.elapsed().as_secs_f64();
            bench.say(&format!("{number:4} {}: {outcome}, {seconds:.1} s", experiment.setup));
        }
        outcome
    };
    // Plants run in parallel too: identifying one leaves cores idle at times.
    bench.numbers(rows).into_par_iter().map(outcome).collect()
}

/// Outcomes with true stamps and complete columns.
fn outcomes_of(bench: &Bench<'_>, rows: IdentifyRows, draw: Draw) -> Vec<Outcome> {
    outcomes(bench, rows, |number, first_seed| {
        (drawn(number, draw, Length::STANDARD, first_seed), Fault::Timing(Timing::True))
    })
}

impl fmt::Display for Outcome {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let values = |truth: &Truth| {
            let values = truth.parameters.iter().map(|one| format!("{:.3} {}", one.value, one.unit));
            format!("{} ({})", truth.name, values.collect::<Vec<_>>().join(", "))
        };
        let hidden = match &self.truth[..] {
            [] => "nothing".to_owned(),
            truth => truth.iter().map(values).collect::<Vec<_>>().join(" and "),
        };
        let found = self.report.as_ref().map_or_else(|| "no result".to_owned(), names);
        let rivals = self.first().map_or(&[][..], |first| &first.rivals);
        let rivals: String = rivals.iter().map(|rival| format!(" or {}", rival.name)).collect();
        let [before, after] = self.ratios();
        if self.fault != Fault::Timing(Timing::True) {
            write!(f, "{}; ", self.fault)?;
        }
        write!(f, "hidden {hidden}; found {found}{rivals}; over the noise {before:.2}, then {after:.2}")?;
        self.compared.iter().try_for_each(|compared| write!(f, "; {compared}"))?;
        if self.is_flagged() {
            let suspicions = self.report.iter().flat_map(|report| &report.suspicions);
            let suspicions: Vec<&str> = suspicions.map(String::as_str).collect();
            write!(
                f,
                "; flagged: {}",
                if suspicions.is_empty() { "not explained".to_owned() } else { suspicions.join(", ") }
            )?;
        }
        Ok(())
    }
}

fn count(outcomes: &[&Outcome], is: impl Fn(&Outcome) -> bool) -> [usize; 2] {
    [outcomes.iter().filter(|outcome| is(outcome)).count(), outcomes.len()]
}

impl Outcome {
    fn first(&self) -> Option<&EffectReport> {
        self.report.as_ref()?.effects.first()
    }

    /// True if the first effect found is one of the hidden ones, or indistinguishable from one.
    fn is_right(&self) -> bool {
        self.first().is_some_and(|first| {
            self.truth.iter().any(|truth| truth.name == first.name || truth.rivals.contains(&first.name.as_str()))
        })
    }

    /// True if a hidden effect is not first, but listed as a rival of the first.
    fn is_listed(&self) -> bool {
        let listed = |name: &str| self.first().is_some_and(|first| first.rivals.iter().any(|rival| rival.name == name));
        !self.is_right() && self.truth.iter().any(|truth| listed(truth.name))
    }

    /// True if each hidden effect has an effect of its own, under its name or that of an indistinguishable one.
    fn has_all(&self) -> bool {
        let effects = self.report.as_ref().map_or(&[][..], |report| &report.effects);
        let is_named = |truth: &Truth, effect: &EffectReport| {
            truth.name == effect.name || truth.rivals.contains(&effect.name.as_str())
        };
        match &self.truth[..] {
            [one, other] => (0..effects.len()).any(|place| {
                let (first, second) = (&effects[place], || effects.iter().enumerate().filter(|(at, _)| *at != place));
                is_named(one, first) && second().any(|(_, second)| is_named(other, second))
            }),
            truth => truth.iter().all(|truth| effects.iter().any(|effect| is_named(truth, effect))),
        }
    }

    /// True if more effects are found than are hidden.
    fn has_more(&self) -> bool {
        self.report.as_ref().is_some_and(|report| report.effects.len() > self.truth.len())
    }

    /// True if the recordings are refused, or reported as unexplained or suspicious.
    fn is_flagged(&self) -> bool {
        self.report.as_ref().is_none_or(|report| report.explained == Explained::Not || !report.suspicions.is_empty())
    }

    /// True if no effect is found.
    fn is_quiet(&self) -> bool {
        self.report.as_ref().is_some_and(|report| report.effects.is_empty())
    }

    /// RMSE of the base model and of the last model, as multiples of the noise.
    fn ratios(&self) -> [f64; 2] {
        let ratio =
            |report: &Report| [report.baseline.holdout.rmse, report.last.holdout.rmse].map(|rmse| rmse / self.noise);
        self.report.as_ref().map_or([f64::INFINITY; 2], ratio)
    }

    /// True if the first effect's reported dependences are all among those of a hidden effect.
    fn depends_right(&self) -> bool {
        let depends = |truth: &Truth, over: &String| truth.depends_on.iter().any(|one| one.name() == over);
        self.first().is_some_and(|first| {
            !first.depends_on.is_empty()
                && self.truth.iter().any(|truth| first.depends_on.iter().all(|over| depends(truth, over)))
        })
    }
}

/// Median of ratios; NaN of none. A NaN ratio counts as infinite.
pub(super) fn median(ratios: impl Iterator<Item = f64>) -> f64 {
    let ratios: Vec<f64> = ratios.map(|ratio| if ratio.is_nan() { f64::INFINITY } else { ratio }).collect();
    statistics::median(&ratios).unwrap_or(f64::NAN)
}

pub(super) fn listed(bench: &Bench<'_>) -> anyhow::Result<Vec<Row>> {
    let outcomes = outcomes_of(bench, IdentifyRows::Blind, Draw::Listed);
    let hidden: Vec<&Outcome> = outcomes.iter().filter(|outcome| !outcome.truth.is_empty()).collect();
    let listed = count(&hidden, Outcome::is_listed)[0];
    let [flagged, all] = count(&hidden, Outcome::is_flagged);
    let [before, after] = [0, 1].map(|place| median(hidden.iter().map(|outcome| outcome.ratios()[place])));
    let within = count(&hidden, |outcome| outcome.ratios()[1] <= WITHIN);
    let [low, high] = super::wilson(within[0], all);
    let compared = hidden.iter().filter(|outcome| outcome.is_right()).flat_map(|outcome| &outcome.compared);
    Ok(vec![
        Row::share(CATALOGUE, "right effect first", count(&hidden, Outcome::is_right), 0.95)
            .with(format!("{all} plants; {listed} more have it among the rivals; {flagged} flagged as broken"))
            .simulated(),
        Row::rare(CATALOGUE, "false extra effects", count(&hidden, Outcome::has_more), 0.05)
            .with(listed_names(hidden.iter().copied().filter(|outcome| outcome.has_more())))
            .simulated(),
        coverage::row(CATALOGUE, compared).simulated(),
        Row::error(CATALOGUE, "RMSE over that of the noise, median", "1", [before, after, WITHIN])
            .with(format!("at most {WITHIN} for {} of {all} ({low:.2} to {high:.2})", within[0]))
            .simulated(),
    ])
}

pub(super) fn pairs(bench: &Bench<'_>) -> anyhow::Result<Vec<Row>> {
    let outcomes = outcomes_of(bench, IdentifyRows::Pairs, Draw::Pair);
    let hidden: Vec<&Outcome> = outcomes.iter().filter(|outcome| !outcome.truth.is_empty()).collect();
    let [first, all] = count(&hidden, Outcome::is_right);
    let more = count(&hidden, Outcome::has_more)[0];
    let within = count(&hidden, |outcome| outcome.ratios()[1] <= WITHIN)[0];
    let [before, after] = [0, 1].map(|place| median(hidden.iter().map(|outcome| outcome.ratios()[place])));
    Ok(vec![
        Row::share(PAIRS, "both named", count(&hidden, Outcome::has_all), 0.85)
            .with(format!(
                "{all} plants; one of both first for {first}, more than two claimed for {more}; RMSE over the noise, median: \
                 {before:.2} before, {after:.2} after, at most {WITHIN} for {within}"
            ))
            .simulated(),
    ])
}

/// Names of the effects found, for a list of plants.
fn listed_names<'o>(outcomes: impl Iterator<Item = &'o Outcome>) -> String {
    let found = |outcome: &Outcome| {
        let found = outcome.report.as_ref().map_or_else(|| "no result".to_owned(), names);
        match (&outcome.truth[..], &outcome.fault) {
            ([], Fault::Timing(Timing::True)) => found,
            ([], fault) => format!("{found} ({fault})"),
            (truth, _) => {
                let hidden: Vec<&str> = truth.iter().map(|truth| truth.name).collect();
                format!("{found} for {}", hidden.join(", "))
            }
        }
    };
    outcomes.map(found).collect::<Vec<_>>().join("; ")
}

pub(super) fn clean(bench: &Bench<'_>) -> anyhow::Result<Vec<Row>> {
    let outcomes = outcomes(bench, IdentifyRows::Clean, drawn_clean);
    let (off, exact): (Vec<&Outcome>, Vec<&Outcome>) =
        outcomes.iter().partition(|outcome| outcome.fault != Fault::Timing(Timing::True));
    let all: Vec<&Outcome> = outcomes.iter().collect();
    let claimed = listed_names(outcomes.iter().filter(|outcome| !outcome.is_quiet()));
    let of_each = |is: fn(&Outcome) -> bool| {
        [&exact, &off].map(|outcomes| count(outcomes, is)).map(|[yes, all]| format!("{yes} of {all}"))
    };
    let ([quiet_exact, quiet_off], [flagged_exact, flagged_off]) =
        (of_each(Outcome::is_quiet), of_each(Outcome::is_flagged));
    let detail = format!(
        "stamps true {quiet_exact}, off {quiet_off}; flagged as broken: stamps true {flagged_exact}, off {flagged_off}{}{claimed}",
        if claimed.is_empty() { "" } else { "; claimed: " }
    );
    Ok(vec![
        Row::share(NOTHING, "nothing claimed but the timing", count(&all, Outcome::is_quiet), 0.98)
            .with(detail)
            .simulated(),
    ])
}

pub(super) fn broken(bench: &Bench<'_>) -> anyhow::Result<Vec<Row>> {
    let outcomes =
        outcomes(bench, IdentifyRows::Broken, |number, first_seed| drawn_broken(number, first_seed, Length::STANDARD));
    let all: Vec<&Outcome> = outcomes.iter().collect();
    let of_kind = |kind: Broken| {
        let is_kind = |outcome: &&Outcome| matches!(outcome.fault, Fault::Broken(broken, _) if broken == kind);
        let [flagged, all] = count(&all.iter().copied().filter(is_kind).collect::<Vec<_>>(), Outcome::is_flagged);
        (all > 0).then(|| format!("{kind} {flagged} of {all}"))
    };
    let kinds: Vec<String> = Broken::ALL.into_iter().filter_map(of_kind).collect();
    let refused = count(&all, |outcome| outcome.report.is_none())[0];
    Ok(vec![
        Row::share(BROKEN, "flagged", count(&all, Outcome::is_flagged), 1.0)
            .with(format!("{}; {refused} of them without a report", kinds.join(", ")))
            .simulated(),
    ])
}

pub(super) fn unlisted(bench: &Bench<'_>) -> anyhow::Result<Vec<Row>> {
    let outcomes = outcomes_of(bench, IdentifyRows::Unlisted, Draw::Unlisted);
    let hidden: Vec<&Outcome> = outcomes.iter().filter(|outcome| !outcome.truth.is_empty()).collect();
    let halved = |outcome: &Outcome| {
        let [before, after] = outcome.ratios();
        after <= 0.5 * before
    };
    // Exclude the noise, which no model can explain.
    let halved_beyond_noise = |outcome: &Outcome| {
        let [before, after] = outcome.ratios().map(|ratio| (ratio * ratio - 1.0).max(0.0).sqrt());
        after <= 0.5 * before
    };
    let [before, after] = [0, 1].map(|place| median(hidden.iter().map(|outcome| outcome.ratios()[place])));
    let beyond = count(&hidden, halved_beyond_noise)[0];
    let both = count(&hidden, |outcome| halved(outcome) && outcome.depends_right())[0];
    let detail = format!(
        "of {}: what is beyond the noise halved for {beyond}, RMSE halved with `depends_on` right for {both}; over the noise, \
         median: {before:.2} before, {after:.2} after",
        hidden.len()
    );
    Ok(vec![
        Row::share(OUTSIDE, "RMSE halved", count(&hidden, halved), 0.90).with(detail).simulated(),
        Row::share(OUTSIDE, "`depends_on` right", count(&hidden, Outcome::depends_right), 0.90).simulated(),
    ])
}

/// Plants with one hidden effect whose identification is timed, three of each setup.
const TIMED: u32 = 9;
/// Plants with two hidden effects, and without one, whose identification is timed, one of each setup.
const TIMED_ALIKE: u32 = 3;
/// Length of the long recordings as a multiple of the short ones, to measure how time grows with samples.
const LONGER: u32 = 4;
/// Weight of the speed measurement in the progress bar.
pub(super) const TIMED_WEIGHT: u64 = (TIMED + TIMED_ALIKE * (1 + 1 + LONGER)) as u64;
/// Limit of the median time for three recordings of 12 s at 200 Hz, s.
const MEDIAN_LIMIT_S: f64 = 5.0;

/// Measures on two threads the time for plants with one hidden effect, with two, and its growth with the samples.
pub(super) fn speed(bench: &Bench<'_>) -> anyhow::Result<Vec<Row>> {
    /// Limit of the growth relative to linear. A cost that grows with the square of the samples would give 4; two
    /// measurements of the same work differ by less than this limit on an idle machine.
    const LINEAR: f64 = 1.25;
    const SHORT: &str = "3 runs, 12 s, 200 Hz";
    let cores = rayon::ThreadPoolBuilder::new().num_threads(2).build().context("no threads")?;
    let timed = |experiment: &Experiment, weight: u32| -> anyhow::Result<(f64, Report)> {
        let started = Instant::now();
        let report = cores.install(|| identify(bench, experiment))?;
        let seconds = started.elapsed().as_secs_f64();
        bench.progress.inc(weight.into());
        Ok((seconds, report))
    };
    let first_seed = IdentifyRows::Speed.first_seed(bench.base);
    let mut times_s = Vec::new();
    for number in 0..TIMED {
        times_s.push(timed(&drawn(number, Draw::Listed, Length::STANDARD, first_seed), 1)?.0);
    }
    let slowest_s = times_s.iter().copied().fold(0.0, f64::max);
    let median_s = median(times_s.iter().copied());
    let mut slowest = (0.0, String::new());
    // Without a hidden effect, short and long recordings take the same rounds: all effects and all curves, once.
    let (mut short_s, mut long_s) = (0.0, 0.0);
    let long = Length { seconds: f64::from(LONGER) * Length::STANDARD.seconds, ..Length::STANDARD };
    for number in 0..TIMED_ALIKE {
        let experiment = drawn(number, Draw::Pair, Length::STANDARD, first_seed);
        let (seconds, report) = timed(&experiment, 1)?;
        if seconds > slowest.0 {
            slowest = (seconds, format!("slowest of three: {}, {}", experiment.setup, names(&report)));
        }
        let mut experiment = drawn(number, Draw::Nothing, long, first_seed);
        long_s += timed(&experiment, LONGER)?.0;
        for recording in experiment.train.iter_mut().chain(&mut experiment.holdout) {
            for series in [&mut recording.time_s, &mut recording.input, &mut recording.output] {
                series.truncate(series.len() / LONGER as usize);
            }
        }
        short_s += timed(&experiment, 1)?.0;
    }
    let growth = long_s / short_s / f64::from(LONGER);
    Ok(vec![
        Row::error(SHORT, "one effect, two threads, median of nine", "s", [f64::NAN, median_s, MEDIAN_LIMIT_S])
            .with(format!("slowest: {slowest_s:.1} s"))
            .simulated(),
        // The time is that of the search, which ends late where effects hide each other: without a limit.
        Row::told(SHORT, "two effects, two threads, slowest of three", "s", [f64::NAN, slowest.0])
            .with(slowest.1)
            .simulated(),
        Row::error(
            "3 runs, 48 s, 200 Hz",
            "time a sample over that of the first 12 s",
            "1",
            [f64::NAN, growth, LINEAR],
        )
        .with(format!("nothing hidden, three plants: {short_s:.1} s, then {long_s:.1} s"))
        .simulated(),
    ])
}

#[cfg(test)]
mod tests {
    use r4_identify::report::{Evidence, ResidualReport, Score, Scores};

    use super::*;

    const SHORT: Length = Length { train: 1, holdout: 1, seconds: 2.0 };

    fn effect(name: &str) -> EffectReport {
        EffectReport {
            name: name.to_owned(),
            depends_on: Vec::new(),
            parameters: BTreeMap::new(),
            holdout_rmse_before: 1.0,
            holdout_rmse_after: 0.5,
            evidence: Evidence {
                blocked_rmse_before: 1.0,
                blocked_rmse_after: 0.5,
                p_value: 0.0,
                blocks_better: [1, 1],
                z: 9.0,
            },
            rivals: Vec::new(),
            table: None,
        }
    }

    fn outcome(hidden: &[(&'static str, &'static [&'static str])], found: &[&str]) -> Outcome {
        let score = Score { rmse: 1.0, nrmse: 0.03, mae: 0.8 };
        let scores = Scores { train: score, holdout: score };
        let report = Report {
            model: "dc-motor".to_owned(),
            unit: "rad".to_owned(),
            baseline: scores,
            effects: found.iter().map(|name| effect(name)).collect(),
            last: scores,
            parameters: BTreeMap::new(),
            residual: ResidualReport { white: true, unexplained: Vec::new() },
            timing: BTreeMap::new(),
            rejected: Vec::new(),
            notes: Vec::new(),
            verdict: String::new(),
            explained: Explained::ToTheNoise,
            suspicions: Vec::new(),
        };
        let truth = hidden.iter().map(|&(name, rivals)| Truth {
            name,
            parameters: Vec::new(),
            depends_on: &[],
            listed: true,
            rivals,
        });
        Outcome {
            truth: truth.collect(),
            fault: Fault::Timing(Timing::True),
            noise: 1.0,
            compared: Vec::new(),
            report: Some(report),
        }
    }

    #[test]
    fn a_pair_is_named_by_two_effects() {
        const LAG: (&str, &[&str]) = ("drive-lag", &["sensor-lag"]);
        const SENSOR: (&str, &[&str]) = ("sensor-lag", &["drive-lag"]);
        const FRICTION: (&str, &[&str]) = ("coulomb-friction", &[]);
        for (hidden, found, all) in [
            ([LAG, FRICTION], &["coulomb-friction", "sensor-lag"][..], true),
            ([FRICTION, LAG], &["cogging", "drive-lag", "coulomb-friction"], true),
            ([LAG, FRICTION], &["drive-lag", "sensor-lag"], false),
            ([LAG, FRICTION], &["coulomb-friction"], false),
            // Each effect could be either, but one effect does not count twice.
            ([LAG, SENSOR], &["drive-lag"], false),
            ([LAG, SENSOR], &["drive-lag", "sensor-lag"], true),
            ([LAG, FRICTION], &[], false),
        ] {
            assert_eq!(outcome(&hidden, found).has_all(), all, "{hidden:?} {found:?}");
        }
    }

    #[test]
    fn extra_effects_are_those_beyond_the_hidden_ones() {
        const FRICTION: (&str, &[&str]) = ("coulomb-friction", &[]);
        for (found, more) in [
            (&[][..], false),
            (&["cogging"][..], false),
            (&["coulomb-friction"], false),
            (&["coulomb-friction", "cogging"], true),
            (&["cogging", "coulomb-friction"], true),
        ] {
            assert_eq!(outcome(&[FRICTION], found).has_more(), more, "{found:?}");
        }
    }

    #[test]
    fn flagged_is_what_is_refused_not_explained_or_suspected() {
        let with = |change: fn(&mut Report)| {
            let mut outcome = outcome(&[], &[]);
            outcome.report.iter_mut().for_each(change);
            outcome.is_flagged()
        };
        assert!(!with(|_| ()) && !with(|report| report.explained = Explained::InPart));
        assert!(with(|report| report.explained = Explained::Not));
        assert!(with(|report| report.suspicions.push("time runs backwards".to_owned())));
        assert!(Outcome { report: None, ..outcome(&[], &[]) }.is_flagged());
    }

    #[test]
    fn stamps_are_off_and_recordings_broken_in_each_way_for_each_setup() {
        let mut timings = std::collections::HashSet::new();
        for number in 0..30 {
            // Check the numbers only: simulating two plants is enough.
            let kind = TimingKind::ALL[(number / 2) as usize % TimingKind::ALL.len()];
            timings.extend((number % 2 == 1).then_some((setup(number), kind)));
        }
        assert_eq!(timings.len(), Setup::ALL.len() * TimingKind::ALL.len());
        let (_, fault) = drawn_clean(0, 5);
        assert_eq!(fault, Fault::Timing(Timing::True));
        let (made, fault) = drawn_clean(1, 5);
        assert_eq!(fault, Fault::Timing(TimingKind::WholeShift.sample(6)));
        assert_ne!(made.train, drawn(1, Draw::Nothing, Length::STANDARD, 5).train);

        let mut pairs = std::collections::HashSet::new();
        for number in 0..42 {
            let (made, fault) = drawn_broken(number, 5, SHORT);
            let Fault::Broken(broken, _) = fault else { panic!("{fault:?}") };
            // Two seconds are too short for some effects to show.
            assert!(made.hidden.truth().len() <= usize::from(number / 7 % 2 == 1));
            let run = run(made.setup, String::new(), &made.train[0]);
            assert_eq!(run.values("speed").is_some(), broken == Broken::Degrees);
            pairs.insert((made.setup, broken));
        }
        // Only an angle can be in degrees.
        assert_eq!(pairs.len(), Setup::ALL.len() * Broken::ALL.len() - 2);
    }

    #[test]
    fn what_is_drawn_is_what_is_meant() {
        let truths = |draw| -> Vec<usize> {
            (0..3).map(|number| drawn(number, draw, Length::STANDARD, 1).hidden.truth().len()).collect()
        };
        assert_eq!(truths(Draw::Nothing), [0; 3]);
        assert!(truths(Draw::Listed).contains(&1));
        let experiment = drawn(2, Draw::Nothing, Length::STANDARD, 1);
        assert_eq!((experiment.setup, experiment.train.len()), (Setup::AxisPosition, 3));
        let run = run(experiment.setup, String::new(), &experiment.train[0]);
        assert_eq!(run.values("output").map(<[f64]>::len), Some(2400));
        assert_eq!(run.signals["input"].quantity, Quantity::Force);
    }

    #[test]
    fn a_median_is_in_the_middle() {
        assert_eq!(median([3.0, f64::INFINITY, 1.0].into_iter()), 3.0);
        assert!(median(std::iter::empty()).is_nan());
    }
}
