//! XRHMI: instructions for picking and placing by lamps, tones and buzzes, and the analysis of trials with people.
//!
//! Paper: "Human Machine Interface for a Pick-and-Place Task Using Extended Reality Devices", TAROS 2023. Ten people move objects between
//! four zones of a desk, told by a ring in a headset, a recorded word or buzzes of two watches; 14 commands in each modality. Scores
//! on the System Usability Scale 78.25, 76.5 and 54.2; Welch's t-test between the modalities, with "powers" of 0.58 and 0.53.
//!
//! # Repairs
//! The first head of table 2 is lost in print: visual. A mean of ten scores is a multiple of 0.25, so that 54.2 is 54.25.
//! A power of 0.58 and 0.53 at n = 10 means d = 1.02 and 0.96. All people did all modalities, yet the test compares them as
//! if they were different people.
//!
//! Results of people cannot be simulated: [`protocol`] runs and logs a session on a board, real or virtual, [`analysis`]
//! compares the modalities within persons, and [`synthetic`] measures how often that finds a declared difference.

pub mod analysis;
pub mod cue;
pub mod desk;
pub mod log;
pub mod missing;
pub mod person;
pub mod protocol;
mod rates;
pub mod sus;
pub mod synthetic;

use r4_maths::statistics::{nearest_rank, two_sample_power};
use r4_rig::{Rig, Session};

use crate::{
    About, Arm, Curve, Error, Figure, Limit, Metric, Panel, Paper, REPORTED, ResultFile, Source, Statistic, System,
    Target, Trial, Values,
};
use protocol::Outcome;
use rates::{Analysis, Rates};
use synthetic::Hidden;

/// Robot system XRHMI, listed in [`crate::all`].
#[derive(Debug)]
pub struct Xrhmi;

/// Name of the system in commands and records.
const NAME: &str = "xrhmi";
/// Names of the arms.
const PAPER: &str = "paper";
const OURS: &str = "ours";
const SLOW: &str = "ablation:slow-telemetry";
const UNORDERED: &str = "ablation:no-order";
const WILCOXON: &str = "baseline:wilcoxon";
const REPEATED: &str = "baseline:welch-repeated";
/// Prefix of the arms with a hidden effect; the name of the effect, or `clean`, follows.
const BLIND: &str = "blind:";
const CLEAN: &str = "blind:clean";
/// Number of people in a synthetic study, as in the paper.
const PEOPLE: usize = 10;
/// Telemetry period of the range sensors, ms, and that of the ablation.
const TELEMETRY_MS: u16 = 2;
const SLOW_MS: u16 = 50;
/// Powers that the paper prints, for haptic against visual and auditory, and the differences that they imply.
const PRINTED_POWERS: [f64; 2] = [0.58, 0.53];
const IMPLIED: [f64; 2] = [1.02, 0.96];
/// Scores that the paper prints, with their decimals.
const PRINTED_SUS: [(f64, i32); 3] = [(78.25, 2), (76.5, 1), (54.2, 1)];

const fn board(name: &'static str, does: &'static str) -> Arm {
    Arm { name, does, is_kinematic: false }
}

const fn numbers(name: &'static str, does: &'static str) -> Arm {
    Arm { name, does, is_kinematic: true }
}

const fn simulated(name: &'static str, unit: &'static str, statistic: Statistic, targets: &'static [Target]) -> Metric {
    Metric { name, unit, statistic, source: Source::Simulated, targets }
}

const fn printed(name: &'static str, targets: &'static [Target]) -> Metric {
    Metric { name, unit: "1", statistic: Statistic::Mean, source: Source::Printed, targets }
}

const fn target(arm: &'static str, limit: Limit, from: &'static str) -> Target {
    Target { arm, limit, from }
}

/// Robot, arms and metrics of the system.
static ABOUT: About = About {
    name: NAME,
    paper: Paper {
        title: "Human Machine Interface for a Pick-and-Place Task Using Extended Reality Devices",
        published: "TAROS 2023",
    },
    question: "How soon does a cue follow a hand, and how often does a study of ten people find a difference of the paper's size?",
    robot: "cue-desk",
    reported: REPORTED,
    sampled: &[
        "zones of the 14 commands of each trial; order of the modalities by a Williams design over the seeds",
        "pace of the synthetic person log-normal, 15 %, reaction 0.30 to 0.45 s times a log-normal of 20 %, mistakes 1, 2 and 6 % of \
         the cues, 15 % of haptic centre and discard cues miscounted",
        "noise of the range sensors, 3 mm rms",
        "studies: person's share of the variance 0.6 to 0.8, the order's 0 to 0.1, uniform; 200 studies with the paper's differences and \
         2000 without any",
        "in blind arms, 0.15 to 0.35 s saved per trial, or 0.02 to 0.05 s per command, or 40 to 80 % of haptic cues with both bands \
         miscounted, or nothing",
    ],
    arms: &[
        numbers(PAPER, "Welch's t-test between the modalities, uncorrected, of other people in each, as it assumes"),
        board(
            OURS,
            "a session on the board; pairs within persons with the order as covariate, Holm's correction for three comparisons",
        ),
        numbers(REPEATED, "the paper's test of people who do all modalities, as in the paper's trials"),
        numbers(WILCOXON, "Wilcoxon's signed ranks within persons, Holm's correction, without the order"),
        numbers(UNORDERED, "paired t-test within persons, Holm's correction, without the order"),
        board(SLOW, "a session on the board with telemetry of the sensors every 50 ms instead of 2"),
        numbers("blind:order", "names the effect in command times of ten people: order of the trials"),
        numbers("blind:practice", "the same: practice within a trial"),
        numbers("blind:miscount", "the same: miscounted buzzes"),
        numbers(CLEAN, "the same: nothing"),
    ],
    metrics: &[
        simulated(
            "cue_latency_p99_s",
            "s",
            Statistic::Quantile(0.99),
            &[target(OURS, Limit::AtMost(0.020), "set by this project")],
        ),
        simulated("cue_latency_s", "s", Statistic::Quantile(0.5), &[]),
        simulated("crossing_latency_s", "s", Statistic::Quantile(0.5), &[]),
        simulated("crossing_latency_p99_s", "s", Statistic::Quantile(0.99), &[]),
        simulated("cues_measured", "1", Statistic::Mean, &[]),
        simulated(
            "cues_shown",
            "1",
            Statistic::Share,
            &[target(OURS, Limit::AtLeast(1.0), "set by this project: every cue at the pins as it should be")],
        ),
        simulated(
            "mistakes_missed",
            "1",
            Statistic::Mean,
            &[target(OURS, Limit::AtMost(0.0), "set by this project: the log has every wrong stay, and no other")],
        ),
        simulated("mistakes", "1", Statistic::Mean, &[]),
        simulated("timeouts", "1", Statistic::Mean, &[]),
        simulated(
            "power_visual",
            "1",
            Statistic::Mean,
            &[target(OURS, Limit::AtLeast(0.8), "set by this project, for n = 10 and the paper's d = 1.02")],
        ),
        simulated(
            "power_auditory",
            "1",
            Statistic::Mean,
            &[target(OURS, Limit::AtLeast(0.8), "set by this project, for n = 10 and the paper's d = 0.96")],
        ),
        simulated(
            "false_alarms",
            "1",
            Statistic::Mean,
            &[target(OURS, Limit::AtMost(0.05), "set by this project: studies without any difference that claim one")],
        ),
        printed("power_printed_visual", &[]),
        printed("power_printed_auditory", &[]),
        simulated(
            "power_reproduced_error",
            "1",
            Statistic::Quantile(1.0),
            &[target(PAPER, Limit::AtMost(0.005), "half of the last printed digit")],
        ),
        printed("sus_visual", &[]),
        printed("sus_auditory", &[]),
        printed("sus_haptic", &[]),
        simulated(
            "effect_named",
            "1",
            Statistic::Share,
            &[
                target("blind:order", Limit::AtLeast(0.9), "set by this project"),
                target("blind:practice", Limit::AtLeast(0.9), "set by this project"),
                target("blind:miscount", Limit::AtLeast(0.9), "set by this project"),
            ],
        ),
        simulated("clean_quiet", "1", Statistic::Share, &[target(CLEAN, Limit::AtLeast(0.95), "set by this project")]),
        simulated("effect_in_interval", "1", Statistic::Share, &[]),
        simulated("effect_size_error", "1", Statistic::Quantile(0.5), &[]),
    ],
};

impl System for Xrhmi {
    fn about(&self) -> &'static About {
        &ABOUT
    }

    fn run(&self, trial: &Trial) -> Result<Values, Error> {
        if let Some(hidden) = trial.arm.strip_prefix(BLIND) {
            return blind(trial, hidden);
        }
        let mut values = Values::new();
        let analysis = match trial.arm {
            PAPER => Some(Analysis::Independent),
            REPEATED => Some(Analysis::Welch),
            OURS => Some(Analysis::Paired),
            UNORDERED => Some(Analysis::Unordered),
            WILCOXON => Some(Analysis::Wilcoxon),
            _ => None,
        };
        if ABOUT.arm(trial.arm).is_some_and(|arm| !arm.is_kinematic) {
            values.extend(evaluate(&session(trial)?));
        }
        if let Some(analysis) = analysis {
            let Rates { powers, false_alarms } = rates::sampled(trial.seed, analysis)?;
            values.insert("power_visual".into(), powers[0]);
            values.insert("power_auditory".into(), powers[1]);
            values.insert("false_alarms".into(), false_alarms);
        }
        if trial.arm == PAPER {
            values.extend(reproduced()?);
        }
        Ok(values)
    }

    fn figure(&self, trial: &Trial) -> Result<Option<Figure>, Error> {
        if trial.arm == PAPER { rates::figure(trial.seed).map(Some) } else { Ok(Some(course(&session(trial)?))) }
    }

    fn files(&self, trial: &Trial) -> Result<Vec<ResultFile>, Error> {
        let outcome = session(trial)?;
        Ok(vec![
            ResultFile { name: "events.csv", text: outcome.log.events_csv() },
            ResultFile { name: "trials.csv", text: outcome.log.trials_csv() },
        ])
    }
}

/// Runs the session of the participant whose number is the trial's seed. On a link the board is a real one, and so is the
/// person.
///
/// # Errors
/// [`Error::Unsuitable`] when the board lacks a channel of the desk; [`Error::Rig`] when the session fails before its first
/// trial.
pub fn session(trial: &Trial) -> Result<Outcome, Error> {
    let mut rig = Rig::new(trial.board.clone());
    rig.seed = trial.seed;
    let period_ms = if trial.arm == SLOW { SLOW_MS } else { TELEMETRY_MS };
    let work = async |session: &Session<'_>| {
        desk::check(session).map_err(|why| Error::Unsuitable { system: NAME, board: trial.board.to_string(), why })?;
        Ok::<_, Error>(protocol::run(session, trial.seed, period_ms).await?)
    };
    Ok(rig.run(None, work)?.0)
}

/// Computes the metrics of a session.
fn evaluate(outcome: &Outcome) -> Values {
    let mut values = Values::new();
    let mut put = |name: &str, value: f64| values.insert(name.to_owned(), value);
    let trials = &outcome.log.trials;
    let logged: usize = trials.iter().map(log::TrialLog::mistakes).sum();
    put("mistakes", logged as f64);
    put("timeouts", trials.iter().map(log::TrialLog::timeouts).sum::<usize>() as f64);
    for (name, mut of) in
        [("cue_latency", outcome.latencies_s.clone()), ("crossing_latency", outcome.crossings_s.clone())]
    {
        of.sort_by(f64::total_cmp);
        if let (Some(half), Some(most)) = (nearest_rank(&of, 0.5), nearest_rank(&of, 0.99)) {
            put(&format!("{name}_s"), half);
            put(&format!("{name}_p99_s"), most);
        }
    }
    // Without pins to read, as on a real board, nothing is known of them, nor of true mistakes.
    if !outcome.trace.is_empty() {
        put("cues_measured", outcome.latencies_s.len() as f64);
        put("cues_shown", f64::from(u8::from(outcome.not_shown == 0 && outcome.stopped.is_none())));
        put("mistakes_missed", logged.abs_diff(outcome.wrong_stays) as f64);
    }
    values
}

/// Recomputes what the paper prints.
fn reproduced() -> Result<Values, Error> {
    let mut values = Values::new();
    let mut worst: f64 = 0.0;
    for (place, name) in ["visual", "auditory"].into_iter().enumerate() {
        values.insert(format!("power_printed_{name}"), PRINTED_POWERS[place]);
        worst = worst.max((two_sample_power(IMPLIED[place], [PEOPLE; 2], 0.05)? - PRINTED_POWERS[place]).abs());
    }
    values.insert("power_reproduced_error".into(), worst);
    for (name, (score, decimals)) in ["visual", "auditory", "haptic"].into_iter().zip(PRINTED_SUS) {
        if let [mean] = sus::attainable(score, decimals, PEOPLE as u32)[..] {
            values.insert(format!("sus_{name}"), mean);
        }
    }
    Ok(values)
}

/// Samples a study with a hidden effect, or none, and searches for it.
fn blind(trial: &Trial, hidden: &str) -> Result<Values, Error> {
    let effect = Hidden::named(hidden, trial.seed);
    let people = synthetic::command_times(trial.seed, PEOPLE, effect);
    let found = missing::found(&people).map_err(|why| Error::Effects(why.to_string()))?;
    let mut values = Values::new();
    let share = |is: bool| f64::from(u8::from(is));
    match effect {
        Some(effect) => {
            let named = found.filter(|found| found.name == hidden);
            values.insert("effect_named".into(), share(named.is_some()));
            if let Some(found) = named {
                values.insert("effect_in_interval".into(), share(found.interval.contains(effect.size_s())));
                values.insert("effect_size_error".into(), (found.size_s / effect.size_s() - 1.0).abs());
            }
        }
        None => {
            values.insert("clean_quiet".into(), share(found.is_none()));
        }
    }
    Ok(values)
}

/// Time course of the session's haptic trial: its first commands.
fn course(outcome: &Outcome) -> Figure {
    const SHOWN_S: f64 = 16.0;
    let haptic = |moment: &&person::Moment| moment.outputs.bands != [false; 2];
    let begin_s = outcome.trace.iter().find(haptic).map_or(0.0, |moment| moment.time_s - 1.0);
    let shown: Vec<person::Moment> =
        outcome.trace.iter().filter(|moment| (begin_s..begin_s + SHOWN_S).contains(&moment.time_s)).copied().collect();
    let range = |name: &'static str, zone: usize| {
        Curve::new(name, &shown, |moment| (moment.time_s - begin_s, moment.ranges_m[zone]))
    };
    // The bands are drawn above each other: their buzzes coincide.
    let band = |name: &'static str, side: usize| {
        Curve::new(name, &shown, |moment| {
            let level = 1.5 - 1.5 * side as f64;
            (moment.time_s - begin_s, level + f64::from(u8::from(moment.outputs.bands[side])))
        })
    };
    Figure {
        description: format!(
            "the first haptic cues of participant {}: ranges over the zones, and buzzes of the bands",
            outcome.log.participant
        ),
        axis: "Time (s)",
        panels: vec![
            Panel {
                title: "Range over the zone (m)",
                curves: vec![range("left", 0), range("centre", 1), range("right", 2), range("discard", 3)],
            },
            Panel {
                title: "Bands: up while buzzing, left above right",
                curves: vec![band("left band", 0), band("right band", 1)],
            },
        ],
    }
}

#[cfg(test)]
mod oracle;
#[cfg(test)]
mod tests;
