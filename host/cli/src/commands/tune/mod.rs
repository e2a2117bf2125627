//! `r4 tune`: gains for a loop of a motor, from an experiment on the board.
//!
//! The loop of the experiment is closed here, over set points and telemetry, so it has a delay that the board's own loop does
//! not have. The delay is measured, from the sample that makes the relay switch to the board following it, and told. It
//! decides at what frequency the motor swings, but is not in what the swing tells of the motor: the board tells duty and
//! position of the same moment. Gains come out cautious where the swing is slower than the board's loop could be.

mod experiment;
mod page;
mod plan;
mod rig;

use std::{fs, path::PathBuf};

use anyhow::{Context, bail};
use indicatif::{ProgressBar, ProgressStyle};
use r4_driver::tune::{Fit, Loop, Response, phase_margin, position_for, position_through, speed_for, speed_through};
use r4_log::Log;
use r4_protocol::{ChannelId, Parameter, ParameterKey, Unit, config::PidGains};
use r4_sim::Pace;
use serde::Serialize;

use super::config;
use crate::{
    args::Args,
    output,
    session::{self, Session},
    table,
};
use experiment::{Answer, Swing};
use plan::Plan;
use r4_rig::quantity::{Quantity, human};
use rig::{Abort, LOOK_EVERY_S, Rig};

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Tune {
    /// The motor, as in osmc0; it must be free to move
    channel: ChannelId,
    /// Swing it with a relay, or step its duty and fit a model
    #[arg(long, value_enum, default_value_t = Method::Relay)]
    method: Method,
    /// Which of its loops
    #[arg(long, value_enum, default_value_t = Which::Position)]
    mode: Which,
    /// Keep the gains, if they are better; holds over restarts
    #[arg(long)]
    save: bool,
    /// Write a page with the plots
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
    /// How far it may go from where it begins, as in 60deg or 10mm [default: 1 rad, or a tenth of the range; for a speed what
    /// the run takes]
    #[arg(long)]
    travel: Option<Quantity>,
    /// Where it begins [default: where it is, or the nearest place with room]
    #[arg(long, allow_hyphen_values = true)]
    at: Option<Quantity>,
    /// How hard it is driven, as a share of the supply [default: for a position short of a stall; for a speed a third of what
    /// holds it]
    #[arg(long)]
    amplitude: Option<f64>,
    /// Phase margin of a position loop by relay, degrees
    #[arg(long, default_value_t = 60.0, value_name = "DEGREES")]
    margin: f64,
    /// Time constant of the loop by step, s [default: the motor's delay]
    #[arg(long, value_name = "SECONDS")]
    time_constant: Option<f64>,
    /// Give up when it has been armed for so long, s
    #[arg(long, default_value_t = 60.0, value_name = "SECONDS")]
    time: f64,
}

/// How the motor is asked.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Method {
    /// By a relay.
    Relay,
    /// By steps of the duty.
    Step,
}

/// Which loop.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Which {
    /// Of the position.
    Position,
    /// Of the speed.
    Speed,
}

/// What the experiment told.
#[derive(Clone, Copy, Debug)]
enum Finding {
    Swing(Swing),
    Fit(Fit),
}

/// What came of it all.
struct Outcome {
    plan: Plan,
    finding: Finding,
    /// By what rule, and the phase margin it leaves, degrees.
    rule: String,
    margin_deg: Option<f64>,
    proposed: PidGains,
    before: Answer,
    /// Why there is none, if there is none.
    after: Result<Answer, String>,
    /// Why the proposed gains are worse, if they are.
    worse: Option<String>,
    saved: bool,
}

#[derive(Serialize)]
struct Report {
    board: String,
    channel: String,
    mode: String,
    method: &'static str,
    rule: String,
    phase_margin_deg: Option<f64>,
    experiment: Experiment,
    present: Shown,
    proposed: Shown,
    better: bool,
    /// Why the proposed gains are not better.
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
        residual: f64,
    },
}

#[derive(Serialize)]
struct Shown {
    kp: f32,
    ki: f32,
    kd: f32,
    rise_s: Option<f64>,
    overshoot: Option<f64>,
    settling_s: Option<f64>,
    steady_error: Option<f64>,
}

impl Shown {
    fn new(gains: PidGains, response: Option<Response>) -> Self {
        Self {
            kp: gains.kp,
            ki: gains.ki,
            kd: gains.kd,
            rise_s: response.and_then(|response| response.rise_s),
            overshoot: response.map(|response| response.overshoot),
            settling_s: response.and_then(|response| response.settling_s),
            steady_error: response.map(|response| response.steady_error),
        }
    }
}

/// More overshoot than this is worse, where there was less before.
const OVERSHOOT: f64 = 0.05;
/// What settles within this share of the time is faster; what is not may overshoot by this much more of the step.
const FASTER: f64 = 0.95;
const SAME_OVERSHOOT: f64 = 0.01;

pub(crate) fn run(args: &Args, tune: &Tune) -> anyhow::Result<bool> {
    if !(30.0..=80.0).contains(&tune.margin) {
        bail!("--margin takes 30 to 80 degrees");
    }
    for (name, value) in [("--time", Some(tune.time)), ("--time-constant", tune.time_constant)] {
        if value.is_some_and(|value| !value.is_finite() || value <= 0.0) {
            bail!("{name} takes a number of seconds above 0");
        }
    }
    if tune.save {
        config::check_keeps(args)?;
    }
    let style = ProgressStyle::with_template("{spinner} {msg}").unwrap_or(ProgressStyle::default_spinner());
    let progress = ProgressBar::new_spinner().with_style(style);
    progress.enable_steady_tick(std::time::Duration::from_millis(100));
    let (result, log) = session::in_memory(args, Pace::Free, async |session| work(tune, session, &progress).await);
    progress.finish_and_clear();
    let (outcome, _) = result?;
    if let Some(path) = &tune.report {
        let page = page::html(&Log::from_bytes(&log)?, tune.channel, &args.board.to_string(), &outcome);
        fs::write(path, page).with_context(|| format!("cannot write {}", path.display()))?;
    }
    if args.json {
        output::json(&report(args, tune, &outcome))?;
    } else {
        print(args, tune, &outcome)?;
    }
    Ok(true)
}

async fn work(tune: &Tune, session: &Session<'_>, progress: &ProgressBar) -> anyhow::Result<Outcome> {
    let board = session.board;
    progress.set_message("reading the motor's parameters");
    let channel = tune.channel;
    plan::check_has_loops(board.channel(channel)?)?;
    let parameters = board.parameters().await?;
    let mut rig = Rig::new(session, channel, tune.time).await?;
    let plan = Plan::new(tune, board.channel(channel)?, &parameters, rig.position().await?)?;
    let mode = plan.mode();
    // What the board started with. It does not tell gains that were changed since, and `r4` changes them nowhere else.
    board.set_gains(channel, mode, plan.motor.gains).await?;
    session.gains_at_end(Some((channel, mode, plan.motor.gains)));
    let driven = session.armed(async || drive(tune, session, &mut rig, &plan, progress).await).await?;
    let Driven { finding, rule, margin_deg, proposed, before, after } = driven;
    let worse = match &after {
        Ok(after) => worse(&plan, before.response, after.response),
        Err(why) => Some(why.clone()),
    };
    let saved = worse.is_none() && tune.save;
    if saved {
        progress.set_message("saving");
        let names = match plan.of {
            Loop::Position => [Parameter::PositionKp, Parameter::PositionKi, Parameter::PositionKd],
            Loop::Speed => [Parameter::SpeedKp, Parameter::SpeedKi, Parameter::SpeedKd],
        };
        for (parameter, value) in names.into_iter().zip([proposed.kp, proposed.ki, proposed.kd]) {
            board.set_parameter(ParameterKey { channel: Some(channel), parameter }, value).await?;
        }
        board.save_parameters().await.context("cannot save the gains")?;
        session.gains_at_end(None);
    }
    Ok(Outcome { plan, finding, rule, margin_deg, proposed, before, after, worse, saved })
}

/// What was done while armed.
struct Driven {
    finding: Finding,
    rule: String,
    margin_deg: Option<f64>,
    proposed: PidGains,
    before: Answer,
    after: Result<Answer, String>,
}

async fn drive(
    tune: &Tune,
    session: &Session<'_>,
    rig: &mut Rig<'_>,
    plan: &Plan,
    progress: &ProgressBar,
) -> anyhow::Result<Driven> {
    let (board, channel, mode) = (session.board, tune.channel, plan.mode());
    progress.set_message(format!("{channel}: going to where the run begins"));
    rig.go_to(plan.base, plan.approach_s).await?;
    rig.stay_within(Some(plan.window));
    progress.set_message(format!("{channel}: steps with the present gains"));
    let before = experiment::answer(rig, plan).await?;
    rig.go_to(plan.base, plan.settle_s).await?;
    let finding = match tune.method {
        Method::Relay => {
            progress.set_message(format!("{channel}: swinging"));
            Finding::Swing(experiment::relay(rig, plan).await?)
        }
        Method::Step => {
            progress.set_message(format!("{channel}: steps of the duty"));
            Finding::Fit(experiment::step(rig, plan).await?)
        }
    };
    let (proposed, rule, margin_deg) = propose(tune, plan, &finding)?;
    rig.go_to(plan.base, plan.settle_s).await?;
    progress.set_message(format!("{channel}: steps with the proposed gains"));
    board.set_gains(channel, mode, proposed).await?;
    let after = match experiment::answer(rig, plan).await {
        Ok(after) => Ok(after),
        // Gains that do not hold the motor are no gains; the motor goes back with those that do.
        Err(error) => match error.downcast::<Abort>() {
            Ok(abort @ (Abort::Travel { .. } | Abort::NotSettled { .. })) => Err(abort.to_string()),
            Ok(abort) => return Err(abort.into()),
            Err(error) => return Err(error.context("with the proposed gains, which are not kept")),
        },
    };
    if after.is_err() {
        rig.stay_within(None);
        rig.command(r4_protocol::Mode::Duty, 0.0).await?;
    }
    board.set_gains(channel, mode, plan.motor.gains).await?;
    rig.go_to(plan.base, plan.approach_s).await?;
    Ok(Driven { finding, rule, margin_deg, proposed, before, after })
}

/// Gains by the rule of the method and the loop, the rule in words, and its phase margin in degrees.
fn propose(tune: &Tune, plan: &Plan, finding: &Finding) -> anyhow::Result<(PidGains, String, Option<f64>)> {
    let filter_s = plan.motor.speed_filter_s;
    let (gains, rule, margin_deg) = match (finding, plan.of) {
        (Finding::Swing(swing), Loop::Position) => {
            let margin = tune.margin;
            let gains = position_through(swing.oscillation.point, margin.to_radians(), filter_s)?;
            let rule = format!("Astrom-Hagglund: phase margin {margin:.0} deg at the frequency of the swing");
            (gains, rule, Some(margin))
        }
        (Finding::Swing(swing), Loop::Speed) => {
            // The loop sees the speed behind its filter, and acts a period and half a period later.
            let gains = speed_through(swing.oscillation.point, filter_s + 1.5 * plan.motor.period_s)?;
            let rule =
                "SIMC for an integrator with the delay at the frequency of the swing: phase margin at least 47 deg";
            (gains, rule.to_owned(), None)
        }
        (Finding::Fit(fit), of) => {
            // The next period acts on what this one has measured.
            let model = r4_driver::tune::Model { delay_s: fit.model.delay_s + plan.motor.period_s, ..fit.model };
            let (gains, rate_s) = match of {
                Loop::Position => (position_for(&model, tune.time_constant, filter_s)?, filter_s),
                Loop::Speed => (speed_for(&model, tune.time_constant)?, 0.0),
            };
            let closed_s = tune.time_constant.unwrap_or(model.delay_s + rate_s);
            let rule = format!("SIMC with a closed loop's time constant of {:.1} ms", closed_s * 1e3);
            (gains, rule, phase_margin(&model, gains, rate_s).map(f64::to_degrees))
        }
    };
    Ok((gains, rule, margin_deg))
}

/// What is worse about the new response, if anything: it must settle at least as fast, and be no worse in anything else.
fn worse(plan: &Plan, before: Response, after: Response) -> Option<String> {
    match (after.settling_s, before.settling_s) {
        // A look apart is the same.
        (Some(after_s), Some(before_s)) if after_s > before_s + LOOK_EVERY_S / 2.0 => {
            return Some(format!("they settle after {after_s:.3} s instead of {before_s:.3} s"));
        }
        (None, Some(before_s)) => {
            return Some(format!("they do not settle, the present ones do after {before_s:.3} s"));
        }
        (None, None) => return Some("neither they nor the present ones settle".into()),
        (Some(_), _) => {}
    }
    // Speed may cost a little; what is no faster must be no rougher.
    let faster = after.settling_s.zip(before.settling_s).is_none_or(|(after, before)| after < FASTER * before);
    let overshoot = if faster { before.overshoot.max(OVERSHOOT) } else { before.overshoot + SAME_OVERSHOOT };
    if after.overshoot > overshoot {
        let (after, before) = (after.overshoot * 100.0, before.overshoot * 100.0);
        return Some(format!("they overshoot by {after:.1} % instead of {before:.1} %"));
    }
    // A board lets a motor rest at up to twice the error at which it counts as arrived.
    let band = plan.steady_band() * if faster { 2.0 } else { 1.0 };
    let steady = before.steady_error.abs().max(band);
    (after.steady_error.abs() > steady).then(|| {
        let [after, before] = [after, before].map(|of| Quantity::new(of.steady_error, plan.unit()));
        format!("they leave an error of {after} instead of {before}")
    })
}

fn report(args: &Args, tune: &Tune, outcome: &Outcome) -> Report {
    let Outcome { plan, finding, rule, margin_deg, proposed, before, after, worse, saved, .. } = outcome;
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
        Finding::Fit(Fit { model, residual }) => {
            Experiment::Fit { gain: model.gain, lag_s: model.lag_s, delay_s: model.delay_s, residual: *residual }
        }
    };
    Report {
        board: args.board.to_string(),
        channel: tune.channel.to_string(),
        mode: plan.mode().to_string(),
        method: tune.method.name(),
        rule: rule.clone(),
        phase_margin_deg: *margin_deg,
        experiment,
        present: Shown::new(plan.motor.gains, Some(before.response)),
        proposed: Shown::new(*proposed, after.as_ref().ok().map(|after| after.response)),
        better: worse.is_none(),
        worse: worse.clone(),
        saved: *saved,
    }
}

impl Method {
    fn name(self) -> &'static str {
        match self {
            Self::Relay => "relay",
            Self::Step => "step",
        }
    }
}

impl Outcome {
    /// What the experiment told, in one or two sentences.
    fn finding(&self) -> String {
        let unit = self.plan.unit();
        match self.finding {
            Finding::Swing(Swing { oscillation, height, hysteresis, host_delay_s, .. }) => {
                let quantity = |value| Quantity::new(value, unit);
                format!(
                    "Swing under duty ±{height:.3}: period {:.1} ms, amplitude {}. Hysteresis {}, {} cycles within {:.1} %. \
                     Ultimate gain {:.4}, motor's phase {:.0} deg at {:.1} rad/s. Delay over the host {:.1} ms, not in these.",
                    oscillation.period_s * 1e3,
                    quantity(oscillation.amplitude),
                    quantity(hysteresis),
                    oscillation.cycles,
                    oscillation.spread * 100.0,
                    oscillation.point.ultimate_gain(),
                    oscillation.point.phase_rad.to_degrees(),
                    oscillation.point.frequency_rad_s,
                    host_delay_s * 1e3
                )
            }
            Finding::Fit(Fit { model, residual }) => {
                let speed = if unit == Unit::M || unit == Unit::MPerS { Unit::MPerS } else { Unit::RadPerS };
                format!(
                    "Model: {} per full duty, lag {:.1} ms, delay {:.1} ms; leaves {:.1} % untold.",
                    Quantity::new(model.gain, speed),
                    model.lag_s * 1e3,
                    model.delay_s * 1e3,
                    residual * 100.0
                )
            }
        }
    }

    /// The rule and its margin.
    fn rule(&self) -> String {
        let margin = self.margin_deg.filter(|_| matches!(self.finding, Finding::Fit(_)));
        self.rule.clone() + &margin.map_or(String::new(), |deg| format!(", phase margin {deg:.0} deg on the model"))
    }

    /// What to think of it.
    fn verdict(&self, channel: ChannelId) -> String {
        let settled = |of: Option<&Answer>| match of.and_then(|answer| answer.response.settling_s) {
            Some(settling_s) => format!("after {settling_s:.3} s"),
            None => "never".into(),
        };
        let (before, after) = (settled(Some(&self.before)), settled(self.after.as_ref().ok()));
        match (&self.worse, self.saved) {
            (Some(why), _) => format!("the present gains are better and stay; with the proposed ones, {why}"),
            (None, true) => format!("settles {after} instead of {before}; saved, holds from now on"),
            (None, false) => format!(
                "settles {after} instead of {before}; not saved, {channel} has its old gains again: --save keeps the new"
            ),
        }
    }
}

/// Rows of present and proposed: what, in which unit, and both numbers as text.
fn rows(outcome: &Outcome) -> Vec<[String; 4]> {
    let plan = &outcome.plan;
    let (per_si, unit, decimals) = human(plan.unit());
    let after = outcome.after.as_ref().ok().map(|after| after.response);
    let before = outcome.before.response;
    let number = |value: Option<f64>, decimals: usize| value.map_or("-".into(), |value| format!("{value:.decimals$}"));
    let row = |name: &str, unit: &str, of: &dyn Fn(&Response) -> Option<f64>, decimals| {
        [name.into(), unit.into(), number(of(&before), decimals), number(after.as_ref().and_then(of), decimals)]
    };
    let of_length = if plan.motor.unit == Unit::M { "m" } else { "rad" };
    let gains = |name: &str, per: [&str; 2], of: fn(&PidGains) -> f32| {
        let [position, speed] = per.map(|per| per.replace('E', of_length));
        let unit = if plan.of == Loop::Position { position } else { speed };
        [name.into(), unit, format!("{:.4}", of(&plan.motor.gains)), format!("{:.4}", of(&outcome.proposed))]
    };
    vec![
        gains("kp", ["duty/E", "duty s/E"], |gains| gains.kp),
        gains("ki", ["duty/(E s)", "duty/E"], |gains| gains.ki),
        gains("kd", ["duty s/E", "duty s²/E"], |gains| gains.kd),
        row("rise, 10 to 90 %", "s", &|response| response.rise_s, 3),
        row("overshoot", "%", &|response| Some(response.overshoot * 100.0), 1),
        row("settled after", "s", &|response| response.settling_s, 3),
        row("steady error", unit, &|response| Some(response.steady_error * per_si), decimals + 1),
    ]
}

fn print(args: &Args, tune: &Tune, outcome: &Outcome) -> anyhow::Result<()> {
    let channel = tune.channel;
    let board = args.board.described();
    output::line(format_args!("{channel}, {} loop, by {}, on {board}", outcome.plan.mode(), tune.method.name()))?;
    for sentence in outcome.finding().split_inclusive(". ") {
        output::line(sentence.trim_end())?;
    }
    output::line(outcome.rule())?;
    let mut shown = table::new(&["", "unit", "present", "proposed"], 2..4);
    for row in rows(outcome) {
        shown.add_row(row);
    }
    output::line(shown)?;
    output::line(format_args!("{channel}: {}", outcome.verdict(channel)))?;
    if let Some(path) = &tune.report {
        output::line(format_args!("report {}", path.display()))?;
    }
    Ok(())
}
