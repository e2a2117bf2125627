//! Gains for a loop of a motor, from an experiment on the board.
//!
//! The loop of the experiment is closed here, over set points and telemetry, so it has a delay that the board's own loop does
//! not have. The delay is measured, from the sample that makes the relay switch to the board following it, and told. It
//! decides at what frequency the motor swings, but is not in what the swing tells of the motor: the board tells duty and
//! position of the same moment. Gains come out cautious where the swing is slower than the board's loop could be.
//!
//! ```
//! use r4_rig::{Error, Rig, tune::{TuneRequest, tune}};
//!
//! let rig = Rig::new("sim:osmc-bench".parse()?);
//! let request = TuneRequest::new("osmc0".parse().expect("a channel"));
//! let (outcome, _) = rig.run(None, async |session| tune(session, &request, |step| println!("{step}")).await)?;
//! assert!(outcome.margin_deg == Some(60.0) && !outcome.saved);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod error;
mod experiment;
mod plan;

use r4_driver::tune::{
    Fit, Loop, Model, Response, phase_margin, position_for, position_through, speed_for, speed_through,
};
use r4_protocol::{ChannelId, Mode, ParameterKey, config::PidGains};

use crate::{
    Error, Session,
    parameters::Parameters,
    quantity::Quantity,
    watch::{MotorWatch, WatchError},
};

pub use error::{Inconclusive, TuneError};
pub use experiment::{Answer, AnswerSample, Swing};
pub use plan::{Motor, Plan};

/// How often the motor is looked at, ms.
const LOOK_EVERY_MS: u16 = 2;
const LOOK_EVERY_S: f64 = LOOK_EVERY_MS as f64 * 1e-3;

/// A loop to tune, and how.
#[derive(Clone, Debug, PartialEq)]
pub struct TuneRequest {
    /// The motor; it must be free to move.
    pub channel: ChannelId,
    /// Experiment.
    pub method: Method,
    /// Which of its loops.
    pub of: Loop,
    /// Whether gains that are better are kept over restarts of the board.
    pub save: bool,
    /// How far it may go from where it begins; `None` is 1 rad or a tenth of the range, for a speed what the run takes.
    pub travel: Option<Quantity>,
    /// Where it begins; `None` is where it is, or the nearest place with room.
    pub at: Option<Quantity>,
    /// How hard it is driven, as a share of the supply; `None` is short of a stall for a position, for a speed a third of what
    /// holds it.
    pub amplitude: Option<f64>,
    /// Phase margin of a position loop by relay, degrees, 30 to 80.
    pub margin_deg: f64,
    /// Time constant of the loop by step, s; `None` is the motor's delay.
    pub time_constant_s: Option<f64>,
    /// The run is given up when the board has been armed for so long, s.
    pub time_s: f64,
}

/// Experiment by which a motor is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// It swings under a relay.
    Relay,
    /// The duty is stepped, and a model fitted.
    Step,
}

impl Method {
    /// Name of the method.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Relay => "relay",
            Self::Step => "step",
        }
    }
}

/// What the experiment told.
#[derive(Clone, Copy, Debug)]
pub enum Finding {
    /// By [`Method::Relay`].
    Swing(Swing),
    /// By [`Method::Step`].
    Fit(Fit),
}

/// A tuned loop.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// The run.
    pub plan: Plan,
    /// What the experiment told.
    pub finding: Finding,
    /// Rule by which the gains were chosen, in words.
    pub rule: String,
    /// Phase margin that they leave, degrees, where the rule tells.
    pub margin_deg: Option<f64>,
    /// Gains that were found.
    pub proposed: PidGains,
    /// Response with the present gains.
    pub before: Answer,
    /// Response with the proposed gains, or why there is none.
    pub after: Result<Answer, String>,
    /// Why the proposed gains are worse, if they are.
    pub worse: Option<String>,
    /// Whether the board keeps the proposed gains. Otherwise it has the present ones again when the session ends.
    pub saved: bool,
}

impl TuneRequest {
    /// The position loop of a motor, by a relay, with a phase margin of 60 degrees, within a minute; nothing is saved.
    #[must_use]
    pub fn new(channel: ChannelId) -> Self {
        Self {
            channel,
            method: Method::Relay,
            of: Loop::Position,
            save: false,
            travel: None,
            at: None,
            amplitude: None,
            margin_deg: 60.0,
            time_constant_s: None,
            time_s: 60.0,
        }
    }

    /// Checks what can be checked without the board.
    ///
    /// # Errors
    /// [`TuneError::Margin`], [`TuneError::NoTime`]
    pub fn check(&self) -> Result<(), Error> {
        if !(30.0..=80.0).contains(&self.margin_deg) {
            return Err(TuneError::Margin.into());
        }
        for (option, value) in [("--time", Some(self.time_s)), ("--time-constant", self.time_constant_s)] {
            if value.is_some_and(|value| !value.is_finite() || value <= 0.0) {
                return Err(TuneError::NoTime { option }.into());
            }
        }
        Ok(())
    }
}

/// More overshoot than this is worse, where there was less before.
const OVERSHOOT: f64 = 0.05;
/// What settles within this share of the time is faster; what is not may overshoot by this much more of the step.
const FASTER: f64 = 0.95;
const SAME_OVERSHOOT: f64 = 0.01;

/// Arms, asks the motor as `request` says, compares the gains that follow with those that the board started with, saves them
/// if they are better and that is wanted, and disarms. `progress` is told each step in words.
///
/// The motor has its present gains again when the session ends, unless the proposed ones were saved.
///
/// # Errors
/// [`TuneError`] when the request cannot be met or the experiment says nothing; [`WatchError`] when the motor leaves its travel,
/// does not come to rest, or is not done in time; when the board refuses or stops, or the link fails.
pub async fn tune(
    session: &Session<'_>,
    request: &TuneRequest,
    mut progress: impl FnMut(&str),
) -> Result<Outcome, Error> {
    request.check()?;
    let (board, channel) = (session.board, request.channel);
    progress("reading the motor's parameters");
    plan::check_has_loops(board.channel(channel)?)?;
    let parameters = Parameters::of(board).await?;
    let mut motor = MotorWatch::new(session, channel, LOOK_EVERY_MS).await?.within(request.time_s).gapless();
    let plan = Plan::new(request, board.channel(channel)?, &parameters, motor.position().await?)?;
    let mode = plan.mode();
    // What the board started with. It does not tell gains that were changed since, and `r4` changes them nowhere else.
    board.set_gains(channel, mode, plan.motor.gains).await?;
    session.gains_at_end(Some((channel, mode, plan.motor.gains)));
    let driven = session.armed(async || drive(session, request, &mut motor, &plan, &mut progress).await).await?;
    let Driven { finding, rule, margin_deg, proposed, before, after } = driven;
    let worse = match &after {
        Ok(after) => worse(&plan, before.response, after.response),
        Err(why) => Some(why.clone()),
    };
    let saved = worse.is_none() && request.save;
    if saved {
        progress("saving");
        for (parameter, value) in plan::of_gains(plan.of).into_iter().zip([proposed.kp, proposed.ki, proposed.kd]) {
            board.set_parameter(ParameterKey { channel: Some(channel), parameter }, value).await?;
        }
        board.save_parameters().await.map_err(TuneError::NotSaved)?;
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
    session: &Session<'_>,
    request: &TuneRequest,
    motor: &mut MotorWatch<'_>,
    plan: &Plan,
    progress: &mut impl FnMut(&str),
) -> Result<Driven, Error> {
    let (board, channel, mode) = (session.board, request.channel, plan.mode());
    progress(&format!("{channel}: going to where the run begins"));
    motor.go_to(plan.base, plan.approach_s).await?;
    motor.stay_within(Some(plan.window));
    progress(&format!("{channel}: steps with the present gains"));
    let before = experiment::answer(motor, plan).await?;
    motor.go_to(plan.base, plan.settle_s).await?;
    let finding = match request.method {
        Method::Relay => {
            progress(&format!("{channel}: swinging"));
            Finding::Swing(experiment::relay(motor, plan).await?)
        }
        Method::Step => {
            progress(&format!("{channel}: steps of the duty"));
            Finding::Fit(experiment::step(motor, plan).await?)
        }
    };
    let (proposed, rule, margin_deg) = propose(request, plan, &finding)?;
    motor.go_to(plan.base, plan.settle_s).await?;
    progress(&format!("{channel}: steps with the proposed gains"));
    board.set_gains(channel, mode, proposed).await?;
    let after = match experiment::answer(motor, plan).await {
        Ok(after) => Ok(after),
        // Gains that do not hold the motor are no gains; the motor goes back with those that do.
        Err(Error::Watch(error)) if matches!(*error, WatchError::Travel { .. } | WatchError::NotSettled { .. }) => {
            Err(error.to_string())
        }
        Err(error @ Error::Watch(_)) => return Err(error),
        Err(error) => return Err(TuneError::WithProposed(Box::new(error)).into()),
    };
    if after.is_err() {
        motor.stay_within(None);
        motor.command(Mode::Duty, 0.0).await?;
    }
    board.set_gains(channel, mode, plan.motor.gains).await?;
    motor.go_to(plan.base, plan.approach_s).await?;
    Ok(Driven { finding, rule, margin_deg, proposed, before, after })
}

/// Gains by the rule of the method and the loop, the rule in words, and its phase margin in degrees.
fn propose(request: &TuneRequest, plan: &Plan, finding: &Finding) -> Result<(PidGains, String, Option<f64>), Error> {
    let filter_s = plan.motor.speed_filter_s;
    let (gains, rule, margin_deg) = match (finding, plan.of) {
        (Finding::Swing(swing), Loop::Position) => {
            let margin = request.margin_deg;
            let gains =
                position_through(swing.oscillation.point, margin.to_radians(), filter_s).map_err(TuneError::from)?;
            let rule = format!("Astrom-Hagglund: phase margin {margin:.0} deg at the frequency of the swing");
            (gains, rule, Some(margin))
        }
        (Finding::Swing(swing), Loop::Speed) => {
            // The loop sees the speed behind its filter, and acts a period and half a period later.
            let gains = speed_through(swing.oscillation.point, filter_s + 1.5 * plan.motor.period_s)
                .map_err(TuneError::from)?;
            let rule =
                "SIMC for an integrator with the delay at the frequency of the swing: phase margin at least 47 deg";
            (gains, rule.to_owned(), None)
        }
        (Finding::Fit(fit), of) => {
            // The next period acts on what this one has measured.
            let model = Model { delay_s: fit.model.delay_s + plan.motor.period_s, ..fit.model };
            let (gains, rate_s) = match of {
                Loop::Position => (position_for(&model, request.time_constant_s, filter_s), filter_s),
                Loop::Speed => (speed_for(&model, request.time_constant_s), 0.0),
            };
            let gains = gains.map_err(TuneError::from)?;
            let closed_s = request.time_constant_s.unwrap_or(model.delay_s + rate_s);
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
