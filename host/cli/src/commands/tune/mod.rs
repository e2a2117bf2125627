//! `r4 tune`: gains for a motor's loop, from an experiment on the board.

mod page;

use std::{fs, path::PathBuf};

use anyhow::Context;
use indicatif::{ProgressBar, ProgressStyle};
use r4_driver::tune::{Fit, Loop, Response};
use r4_log::Log;
use r4_protocol::{
    ChannelId, Unit,
    config::{FeedForward, PidGains, Tuning},
};
use r4_rig::{
    quantity::{Quantity, human},
    tune::{Answer, Finding, Outcome, Swing, TuneRequest},
};
use r4_sim::Pace;
use serde::Serialize;

use super::config;
use crate::{args::Args, output, session, table};

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Tune {
    /// Motor to tune; must be free to move; example: osmc0
    channel: ChannelId,
    /// Experiment: fit a model to runs under changing duties, or oscillate the motor with a relay
    #[arg(long, value_enum, default_value_t = Method::Step)]
    method: Method,
    /// Loop to tune [default: the one that holds the motor's positions]
    #[arg(long, value_enum)]
    mode: Option<Which>,
    /// Save gains and feed-forward to the board's flash if they are better
    #[arg(long)]
    save: bool,
    /// Write a page with the plots to this file
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
    /// Largest distance from the starting position; examples: 60deg, 10mm [default: 1 rad, or 200 counts of the sensor
    /// if that is more, or a tenth of the range; for a speed loop as far as the run takes]
    #[arg(long)]
    travel: Option<Quantity>,
    /// Starting position [default: the present one, or the nearest place with room]
    #[arg(long, allow_hyphen_values = true)]
    at: Option<Quantity>,
    /// Largest duty, as a share of the supply, 0 to 1 [default: what the path needs; with a relay, for a position just
    /// below a stall, for a speed a third of the holding duty]
    #[arg(long)]
    amplitude: Option<f64>,
    /// Least phase margin, degrees
    #[arg(long, default_value_t = 60.0, value_name = "DEGREES")]
    margin: f64,
    /// Time constant of the closed loop, s [default: the shortest with that margin that the sensor allows]
    #[arg(long, value_name = "SECONDS")]
    time_constant: Option<f64>,
    /// Longest time armed, s; then give up
    #[arg(long, default_value_t = 120.0, value_name = "SECONDS")]
    time: f64,
}

/// Experiment on the motor.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Method {
    /// Oscillate the motor with a relay
    Relay,
    /// Fit a model to runs under changing duties
    Step,
}

/// Control loop of a motor.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Which {
    /// Loop of the position
    Position,
    /// Loop of the speed
    Speed,
    /// Loop of the speed that also holds positions
    Cascade,
}

impl Tune {
    /// Request to `r4-rig` with these options.
    fn request(&self) -> TuneRequest {
        TuneRequest {
            channel: self.channel,
            method: match self.method {
                Method::Relay => r4_rig::tune::Method::Relay,
                Method::Step => r4_rig::tune::Method::Step,
            },
            of: self.mode.map(|which| match which {
                Which::Position => Loop::Position,
                Which::Speed => Loop::Speed,
                Which::Cascade => Loop::Cascade,
            }),
            save: self.save,
            travel: self.travel,
            at: self.at,
            amplitude: self.amplitude,
            margin_deg: self.margin,
            time_constant_s: self.time_constant,
            time_s: self.time,
        }
    }
}

#[derive(Serialize)]
struct Report {
    board: String,
    channel: String,
    mode: String,
    method: &'static str,
    rule: String,
    phase_margin_deg: f64,
    experiment: Experiment,
    present: Shown,
    proposed: Shown,
    better: bool,
    /// Reason why the proposed gains are not better.
    worse: Option<String>,
    saved: bool,
}

#[derive(Serialize)]
#[serde(untagged)]
enum Experiment {
    Swing {
        period_s: f64,
        amplitude: f64,
        cycles: usize,
        spread: f64,
        duty_bias: f64,
        duty_height: f64,
        hysteresis: f64,
        host_delay_s: f64,
        ultimate_gain: f64,
        frequency_rad_s: f64,
        phase_deg: f64,
    },
    Fit {
        gain: f64,
        lag_s: f64,
        delay_s: f64,
        friction_up: f64,
        friction_down: f64,
        residual: f64,
    },
}

#[derive(Serialize)]
struct Shown {
    kp: f32,
    ki: f32,
    kd: f32,
    static_duty: f32,
    duty_per_speed: f32,
    duty_per_acceleration: f32,
    cascade_per_s: f32,
    rise_s: Option<f64>,
    overshoot: Option<f64>,
    settling_s: Option<f64>,
    steady_error: Option<f64>,
}

impl Shown {
    fn new(gains: PidGains, tuning: Tuning, response: Option<Response>) -> Self {
        let FeedForward { static_duty, duty_per_speed, duty_per_acceleration } = tuning.feed_forward;
        Self {
            kp: gains.kp,
            ki: gains.ki,
            kd: gains.kd,
            static_duty,
            duty_per_speed,
            duty_per_acceleration,
            cascade_per_s: tuning.cascade_per_s,
            rise_s: response.and_then(|response| response.rise_s),
            overshoot: response.map(|response| response.overshoot),
            settling_s: response.and_then(|response| response.settling_s),
            steady_error: response.map(|response| response.steady_error),
        }
    }
}

pub(crate) fn run(args: &Args, tune: &Tune) -> anyhow::Result<bool> {
    let request = tune.request();
    request.check()?;
    // Refuse before the experiment, which takes up to minutes.
    if tune.save {
        config::check_keeps(args)?;
    }
    let style = ProgressStyle::with_template("{spinner} {msg}").unwrap_or(ProgressStyle::default_spinner());
    let progress = ProgressBar::new_spinner().with_style(style);
    progress.enable_steady_tick(std::time::Duration::from_millis(100));
    // Record in memory: the report page plots the experiment.
    let (result, log) = session::in_memory(args, Pace::Free, async |session| {
        Ok(r4_rig::tune::tune(session, &request, |step| progress.set_message(step.to_owned())).await?)
    });
    progress.finish_and_clear();
    let (outcome, _) = result?;
    if let Some(path) = &tune.report {
        let page = page::html(&Log::from_bytes(&log)?, tune.channel, &args.board.to_string(), &outcome);
        fs::write(path, page).with_context(|| format!("cannot write {}", path.display()))?;
    }
    if args.json {
        output::json(&report(args, &request, &outcome))?;
    } else {
        print(args, tune, &outcome)?;
    }
    Ok(true)
}

fn report(args: &Args, request: &TuneRequest, outcome: &Outcome) -> Report {
    let Outcome { plan, finding, rule, margin_deg, proposed, tuning, before, after, worse, saved } = outcome;
    let experiment = match finding {
        Finding::Swing(Swing { oscillation, height, bias, hysteresis, host_delay_s }) => Experiment::Swing {
            period_s: oscillation.period_s,
            amplitude: oscillation.amplitude,
            cycles: oscillation.cycles,
            spread: oscillation.spread,
            duty_bias: *bias,
            duty_height: *height,
            hysteresis: *hysteresis,
            host_delay_s: *host_delay_s,
            ultimate_gain: oscillation.point.ultimate_gain(),
            frequency_rad_s: oscillation.point.frequency_rad_s,
            phase_deg: oscillation.point.phase_rad.to_degrees(),
        },
        Finding::Fit(Fit { model, friction, residual, .. }) => Experiment::Fit {
            gain: model.gain,
            lag_s: model.lag_s,
            delay_s: model.delay_s,
            friction_up: friction.up,
            friction_down: friction.down,
            residual: *residual,
        },
    };
    Report {
        board: args.board.to_string(),
        channel: request.channel.to_string(),
        mode: plan.name().to_owned(),
        method: request.method.name(),
        rule: rule.clone(),
        phase_margin_deg: *margin_deg,
        experiment,
        present: Shown::new(plan.motor.gains, plan.motor.tuning, Some(before.response)),
        proposed: Shown::new(*proposed, *tuning, after.as_ref().ok().map(|after| after.response)),
        better: worse.is_none(),
        worse: worse.clone(),
        saved: *saved,
    }
}

/// Result of the experiment, in one or two sentences.
fn finding(outcome: &Outcome) -> String {
    let unit = outcome.plan.unit();
    match &outcome.finding {
        Finding::Swing(Swing { oscillation, height, hysteresis, host_delay_s, .. }) => {
            let quantity = |value| Quantity::new(value, unit);
            format!(
                "Swing under duty ±{height:.3}: period {:.1} ms, amplitude {}. Hysteresis {}, {} cycles within {:.1} %. \
                 Ultimate gain {:.4}, motor's phase {:.0} deg at {:.1} rad/s. Delay over the host {:.1} ms, not included.",
                oscillation.period_s * 1e3,
                quantity(oscillation.amplitude),
                quantity(*hysteresis),
                oscillation.cycles,
                oscillation.spread * 100.0,
                oscillation.point.ultimate_gain(),
                oscillation.point.phase_rad.to_degrees(),
                oscillation.point.frequency_rad_s,
                host_delay_s * 1e3
            )
        }
        Finding::Fit(Fit { model, friction, residual, .. }) => {
            let speed = if unit == Unit::M || unit == Unit::MPerS { Unit::MPerS } else { Unit::RadPerS };
            format!(
                "Model: {} per full duty, lag {:.1} ms, delay {:.1} ms; friction takes duty {:.3} up and {:.3} down. \
                 Residual {:.1} % of the motion.",
                Quantity::new(model.gain, speed),
                model.lag_s * 1e3,
                model.delay_s * 1e3,
                friction.up,
                friction.down,
                residual * 100.0
            )
        }
    }
}

/// Tuning rule and its phase margin.
fn rule(outcome: &Outcome) -> String {
    format!("{}, phase margin {:.0} deg", outcome.rule, outcome.margin_deg)
}

/// Conclusion: whether the proposed gains are better, and whether they were saved.
fn verdict(outcome: &Outcome, channel: ChannelId) -> String {
    let settled = |of: Option<&Answer>| match of.and_then(|answer| answer.response.settling_s) {
        Some(settling_s) => format!("after {settling_s:.3} s"),
        None => "never".into(),
    };
    let (before, after) = (settled(Some(&outcome.before)), settled(outcome.after.as_ref().ok()));
    match (&outcome.worse, outcome.saved) {
        (Some(why), _) => format!("the present gains are better and stay; with the proposed ones, {why}"),
        (None, true) => format!("settles {after} instead of {before}; saved, holds from now on"),
        (None, false) => format!(
            "settles {after} instead of {before}; not saved, {channel} has its old gains again: add --save to keep the new ones"
        ),
    }
}

/// Rows of the table: name, unit, present and proposed value as text.
fn rows(outcome: &Outcome) -> Vec<[String; 4]> {
    let plan = &outcome.plan;
    let (per_si, unit, decimals) = human(plan.unit());
    let after = outcome.after.as_ref().ok().map(|after| after.response);
    let before = outcome.before.response;
    let number = |value: Option<f64>, decimals: usize| value.map_or("-".into(), |value| format!("{value:.decimals$}"));
    let row = |name: &str, unit: &str, of: &dyn Fn(&Response) -> Option<f64>, decimals| {
        [name.into(), unit.into(), number(of(&before), decimals), number(after.as_ref().and_then(of), decimals)]
    };
    // E in the units below stands for the motor's length or angle.
    let of_length = if plan.motor.unit == Unit::M { "m" } else { "rad" };
    let gains = |name: &str, per: [&str; 2], of: fn(&PidGains) -> f32| {
        let [position, speed] = per.map(|per| per.replace('E', of_length));
        let unit = if plan.of == Loop::Position { position } else { speed };
        [name.into(), unit, format!("{:.4}", of(&plan.motor.gains)), format!("{:.4}", of(&outcome.proposed))]
    };
    let of_path = |name: &str, unit: &str, of: fn(&Tuning) -> f32| {
        let unit = unit.replace('E', of_length);
        [name.into(), unit, format!("{:.4}", of(&plan.motor.tuning)), format!("{:.4}", of(&outcome.tuning))]
    };
    vec![
        gains("kp", ["duty/E", "duty s/E"], |gains| gains.kp),
        gains("ki", ["duty/(E s)", "duty/E"], |gains| gains.ki),
        gains("kd", ["duty s/E", "duty s²/E"], |gains| gains.kd),
        of_path("cascade", "1/s", |tuning| tuning.cascade_per_s),
        of_path("static_duty", "", |tuning| tuning.feed_forward.static_duty),
        of_path("duty_per_speed", "duty s/E", |tuning| tuning.feed_forward.duty_per_speed),
        of_path("duty_per_acceleration", "duty s²/E", |tuning| tuning.feed_forward.duty_per_acceleration),
        row("rise, 10 to 90 %", "s", &|response| response.rise_s, 3),
        row("overshoot", "%", &|response| Some(response.overshoot * 100.0), 1),
        row("settled after", "s", &|response| response.settling_s, 3),
        row("steady error", unit, &|response| Some(response.steady_error * per_si), decimals + 1),
    ]
}

fn print(args: &Args, tune: &Tune, outcome: &Outcome) -> anyhow::Result<()> {
    let channel = tune.channel;
    let board = args.board.described();
    output::line(format_args!(
        "{channel}, {} loop, by {}, on {board}",
        outcome.plan.name(),
        tune.request().method.name()
    ))?;
    for sentence in finding(outcome).split_inclusive(". ") {
        output::line(sentence.trim_end())?;
    }
    output::line(rule(outcome))?;
    let mut shown = table::new(&["", "unit", "present", "proposed"], 2..4);
    for row in rows(outcome) {
        shown.add_row(row);
    }
    output::line(shown)?;
    output::line(format_args!("{channel}: {}", verdict(outcome, channel)))?;
    if let Some(path) = &tune.report {
        output::line(format_args!("report {}", path.display()))?;
    }
    Ok(())
}
