//! Simulated plants with something hidden in them that the estimator is not told: how often it is found.

use std::{collections::BTreeMap, fmt, time::Instant};

use anyhow::Context;
use r4_blind::{
    Draw, Truth,
    experiment::{Experiment, Length, Recording, Setup, experiment},
};
use r4_identify::{
    data::{Quantity, Run, Signal},
    report::{EffectReport, Report},
};
use r4_maths::statistics;

use super::{Bench, Row, recorded::names};

const CATALOGUE: &str = "effects of the catalogue";
const NOTHING: &str = "nothing hidden";
const OUTSIDE: &str = "effects in no catalogue";

/// Of the seeds, for what takes fewer.
pub(super) const fn half(seeds: u32) -> u32 {
    seeds.div_ceil(2)
}

/// What came of one.
struct Outcome {
    truth: Vec<Truth>,
    /// Deviation of the noise: what is left for who knows the truth.
    noise: f64,
    report: Option<Report>,
}

fn drawn(number: u32, draw: Draw, length: Length, seed: u64) -> Experiment {
    let seed = seed.wrapping_add(number.into());
    experiment(Setup::ALL[number as usize % Setup::ALL.len()], draw, length, seed)
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
    let signals = BTreeMap::from([
        signal("input", setup.input(), input, &recording.input),
        signal("output", setup.output(), output, &recording.output),
    ]);
    Run { name, time_s: recording.time_s.clone(), signals }
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
        Setup::AxisPosition => ("axis", &[][..]),
    };
    Ok(bench.identify(model, known, &train, &test)?.report)
}

fn outcomes(bench: &Bench<'_>, count: u32, draw: impl Fn(u32) -> Draw) -> Vec<Outcome> {
    let outcome = |number| {
        let experiment = drawn(number, draw(number), Length::STANDARD, bench.seed);
        let started = Instant::now();
        let report = identify(bench, &experiment);
        let truth = experiment.hidden.truth().to_vec();
        bench.progress.inc(1);
        let why = report.as_ref().err().map(ToString::to_string);
        let outcome = Outcome { truth, noise: experiment.noise, report: report.ok() };
        if let Some(why) = why {
            bench.say(&format!("r4: number {number} came to nothing: {why}"));
        } else if bench.each {
            let seconds = started.elapsed().as_secs_f64();
            bench.say(&format!("{number:4} {}: {outcome}, {seconds:.1} s", experiment.setup));
        }
        outcome
    };
    (bench.from..bench.from.saturating_add(count)).map(outcome).collect()
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
        write!(f, "hidden {hidden}; found {found}{rivals}; over the noise {before:.2}, then {after:.2}")
    }
}

fn count(outcomes: &[&Outcome], is: impl Fn(&Outcome) -> bool) -> [usize; 2] {
    [outcomes.iter().filter(|outcome| is(outcome)).count(), outcomes.len()]
}

impl Outcome {
    fn first(&self) -> Option<&EffectReport> {
        self.report.as_ref()?.effects.first()
    }

    /// One of what was hidden is named first, or what no recording can tell from it.
    fn is_right(&self) -> bool {
        self.first().is_some_and(|first| {
            self.truth.iter().any(|truth| truth.name == first.name || truth.rivals.contains(&first.name.as_str()))
        })
    }

    /// Not named first, but told to be as good.
    fn is_listed(&self) -> bool {
        let listed = |name: &str| self.first().is_some_and(|first| first.rivals.iter().any(|rival| rival.name == name));
        !self.is_right() && self.truth.iter().any(|truth| listed(truth.name))
    }

    /// Nothing is claimed.
    fn is_quiet(&self) -> bool {
        self.report.as_ref().is_some_and(|report| report.effects.is_empty())
    }

    /// RMSE of the base model and of the last one, over the noise.
    fn ratios(&self) -> [f64; 2] {
        let ratio =
            |report: &Report| [report.baseline.holdout.rmse, report.last.holdout.rmse].map(|rmse| rmse / self.noise);
        self.report.as_ref().map_or([f64::INFINITY; 2], ratio)
    }

    /// What the first effect is said to depend on is a part of what it does depend on.
    fn depends_right(&self) -> bool {
        let depends = |truth: &Truth, over: &String| truth.depends_on.iter().any(|one| one.name() == over);
        self.first().is_some_and(|first| {
            !first.depends_on.is_empty()
                && self.truth.iter().any(|truth| first.depends_on.iter().all(|over| depends(truth, over)))
        })
    }
}

/// NaN of nothing; without a number a ratio counts as the worst.
fn median(ratios: impl Iterator<Item = f64>) -> f64 {
    let ratios: Vec<f64> = ratios.map(|ratio| if ratio.is_nan() { f64::INFINITY } else { ratio }).collect();
    statistics::median(&ratios).unwrap_or(f64::NAN)
}

/// One of eight hides two effects.
pub(super) fn listed(bench: &Bench<'_>) -> anyhow::Result<Vec<Row>> {
    const WITHIN: f64 = 1.15;
    let outcomes = outcomes(bench, bench.seeds, |number| if number % 8 == 7 { Draw::Pair } else { Draw::Listed });
    let hidden: Vec<&Outcome> = outcomes.iter().filter(|outcome| !outcome.truth.is_empty()).collect();
    let listed = count(&hidden, Outcome::is_listed)[0];
    let [before, after] = [0, 1].map(|place| median(hidden.iter().map(|outcome| outcome.ratios()[place])));
    let [within, all] = count(&hidden, |outcome| outcome.ratios()[1] <= WITHIN);
    let [low, high] = super::wilson(within, all);
    Ok(vec![
        Row::share(CATALOGUE, "right effect first", count(&hidden, Outcome::is_right), 0.90)
            .with(format!("{all} plants; {listed} more have it among the rivals"))
            .simulated(),
        Row::error(CATALOGUE, "RMSE over that of the noise, median", "1", [before, after, WITHIN])
            .with(format!("at most {WITHIN} for {within} of {all} ({low:.2} to {high:.2})"))
            .simulated(),
    ])
}

pub(super) fn clean(bench: &Bench<'_>) -> anyhow::Result<Vec<Row>> {
    let outcomes = outcomes(bench, half(bench.seeds), |_| Draw::Nothing);
    let all: Vec<&Outcome> = outcomes.iter().collect();
    let claimed: Vec<String> = outcomes
        .iter()
        .filter(|outcome| !outcome.is_quiet())
        .map(|outcome| outcome.report.as_ref().map_or_else(|| "no result".to_owned(), names))
        .collect();
    let claimed = if claimed.is_empty() { String::new() } else { format!(", claimed: {}", claimed.join("; ")) };
    Ok(vec![
        Row::share(NOTHING, "none claimed", count(&all, Outcome::is_quiet), 0.95)
            .with(format!("{} plants{claimed}", all.len()))
            .simulated(),
    ])
}

pub(super) fn unlisted(bench: &Bench<'_>) -> anyhow::Result<Vec<Row>> {
    let outcomes = outcomes(bench, half(bench.seeds), |_| Draw::Unlisted);
    let hidden: Vec<&Outcome> = outcomes.iter().filter(|outcome| !outcome.truth.is_empty()).collect();
    let halved = |outcome: &Outcome| {
        let [before, after] = outcome.ratios();
        after <= 0.5 * before
    };
    // The noise can be explained by nothing.
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
        Row::share(OUTSIDE, "RMSE halved", count(&hidden, halved), 0.80).with(detail).simulated(),
        Row::share(OUTSIDE, "`depends_on` right", count(&hidden, Outcome::depends_right), 0.80).simulated(),
    ])
}

/// Plants whose identification is timed.
const TIMED: u32 = 3;
/// Recordings that are so many times as long as others tell how the time grows with the samples.
const LONGER: u32 = 4;
/// What speed weighs for the progress bar.
pub(super) const TIMED_WEIGHT: u64 = (TIMED * (1 + 1 + LONGER)) as u64;

/// On two cores: the slowest of one plant of each setup, and how the time grows with the samples.
pub(super) fn speed(bench: &Bench<'_>) -> anyhow::Result<Vec<Row>> {
    /// A cost that grows with the square of the samples would be four times as much; two measurements of the same differ by
    /// less than this where nothing else runs.
    const LINEAR: f64 = 1.25;
    let cores = rayon::ThreadPoolBuilder::new().num_threads(2).build().context("no threads")?;
    let timed = |experiment: &Experiment, weight: u32| -> anyhow::Result<(f64, Report)> {
        let started = Instant::now();
        let report = cores.install(|| identify(bench, experiment))?;
        let seconds = started.elapsed().as_secs_f64();
        bench.progress.inc(weight.into());
        Ok((seconds, report))
    };
    let mut slowest = (0.0, String::new());
    // With nothing hidden, short and long recordings take the same rounds: all effects and all curves, once.
    let (mut short_s, mut long_s) = (0.0, 0.0);
    let long = Length { seconds: f64::from(LONGER) * Length::STANDARD.seconds, ..Length::STANDARD };
    for number in 0..TIMED {
        let experiment = drawn(number, Draw::Pair, Length::STANDARD, bench.seed);
        let (seconds, report) = timed(&experiment, 1)?;
        if seconds > slowest.0 {
            slowest = (seconds, format!("slowest of three: {}, {}", experiment.setup, names(&report)));
        }
        let mut experiment = drawn(number, Draw::Nothing, long, bench.seed);
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
        Row::error("3 runs, 12 s, 200 Hz", "whole catalogue, two threads", "s", [f64::NAN, slowest.0, 20.0])
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
    use super::*;

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
