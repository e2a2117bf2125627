//! Tuning: gains for a loop of a motor, from an experiment on the board.
//!
//! The loop of the experiment is closed on the host, over set points and telemetry, so that it has a delay that the
//! board's own loop lacks. The delay is measured, from the sample that makes the relay switch to the board following
//! it, and reported. It decides the frequency of the oscillation, but does not bias the result: the board reports duty
//! and position of the same moment. Gains are cautious where the oscillation is slower than the board's loop could be.
//!
//! ```
//! use r4_rig::{Error, Rig, tune::{TuneRequest, tune}};
//!
//! let rig = Rig::new("sim:osmc-bench".parse()?);
//! let request = TuneRequest::new("osmc0".parse().expect("a channel"));
//! let (outcome, _) = rig.run(None, async |session| tune(session, &request, |step| println!("{step}")).await)?;
//! assert!(outcome.margin_deg >= 60.0 && !outcome.saved);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod error;
mod experiment;
mod plan;

use r4_driver::tune::{
    Fit, Friction, Gains, Loop, LoopConditions, Response, SpeedEstimate, feed_forward, position_through,
};
use r4_protocol::{
    ChannelId, Parameter, ParameterKey,
    config::{PidGains, Tuning},
};

use crate::{
    Error, Session,
    parameters::Parameters,
    quantity::Quantity,
    session::AtEnd,
    watch::{MotorWatch, WatchError},
};

pub use error::{Inconclusive, TuneError};
pub use experiment::{Answer, AnswerSample, Swing};
pub use plan::{Motor, Plan};

/// Telemetry period of the motor, ms.
const LOOK_EVERY_MS: u16 = 2;
const LOOK_EVERY_S: f64 = LOOK_EVERY_MS as f64 * 1e-3;

/// Request to tune a loop.
#[derive(Clone, Debug, PartialEq)]
pub struct TuneRequest {
    /// Channel of the motor, which must be free to move.
    pub channel: ChannelId,
    /// Experiment that identifies the motor.
    pub method: Method,
    /// Loop to tune; `None` selects the one that holds positions.
    pub of: Option<Loop>,
    /// True: better gains are saved in the board.
    pub save: bool,
    /// Largest distance from the start; `None` uses 1 rad or a tenth of the range, for a speed what the run needs.
    pub travel: Option<Quantity>,
    /// Start of the run; `None` uses the present position, or the nearest one with room.
    pub at: Option<Quantity>,
    /// Amplitude of the duty, as a share of the supply; `None` uses just below a stall for a position, and for a speed
    /// a third of the duty that holds it.
    pub amplitude: Option<f64>,
    /// Least phase margin, degrees, 30 to 80.
    pub margin_deg: f64,
    /// Time constant of the closed loop, s; `None` uses the shortest one that keeps the phase margin and that the
    /// sensor allows.
    pub time_constant_s: Option<f64>,
    /// Time limit while the board is armed, s.
    pub time_s: f64,
}

/// Experiment that identifies a motor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// Relay feedback: the motor oscillates.
    Relay,
    /// Steps of the duty, to which a model is fitted.
    Step,
}

impl Method {
    /// Name of the method, for the user.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Relay => "relay",
            Self::Step => "step",
        }
    }
}

/// Result of the experiment.
#[derive(Clone, Debug)]
pub enum Finding {
    /// Oscillation under the relay of [`Method::Relay`].
    Swing(Swing),
    /// Model fitted by [`Method::Step`].
    Fit(Fit),
}

/// Result of tuning a loop.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// Plan of the run.
    pub plan: Plan,
    /// Result of the experiment.
    pub finding: Finding,
    /// Rule that chose the gains, in words.
    pub rule: String,
    /// Phase margin of the gains with the identified motor, degrees.
    pub margin_deg: f64,
    /// Proposed gains of the loop.
    pub proposed: PidGains,
    /// Proposed feed-forward and cascade gain.
    pub tuning: Tuning,
    /// Response with the present gains.
    pub before: Answer,
    /// Response with the proposed gains, or the reason why there is none.
    pub after: Result<Answer, String>,
    /// Reason why the proposed gains are worse; `None` when they are not.
    pub worse: Option<String>,
    /// True when the board has saved the proposed gains. Otherwise it has the present ones again when the session ends.
    pub saved: bool,
}

impl TuneRequest {
    /// Request with default options: the loop that holds a motor's positions, runs under changing duties, a phase
    /// margin of 60 degrees, two minutes; nothing is saved.
    #[must_use]
    pub fn new(channel: ChannelId) -> Self {
        Self {
            channel,
            method: Method::Step,
            of: None,
            save: false,
            travel: None,
            at: None,
            amplitude: None,
            margin_deg: 60.0,
            time_constant_s: None,
            time_s: 120.0,
        }
    }

    /// Checks the options that need no board.
    ///
    /// # Errors
    /// [`TuneError::Margin`] outside 30 to 80 degrees; [`TuneError::NoTime`] for a time that is not above 0.
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

/// Overshoot above which a response is worse, unless it was as large before.
const OVERSHOOT: f64 = 0.05;
/// Share of the settling time below which a response counts as faster; a response that is not faster may overshoot by
/// this share of the step more.
const FASTER: f64 = 0.95;
const SAME_OVERSHOOT: f64 = 0.01;
/// Factors of the closed-loop time constant that are tried in turn until the gains are good. For a position, a faster
/// loop overcomes varying friction and a dead zone, as long as it has this phase margin, degrees; a slower one prevents
/// overshoot where the motor differs from the model. A faster speed loop corrects an inexact feed-forward sooner: with
/// 1, 2 and 4 alone, 6 of the 200 motors 2001 to 2200 of `r4 bench motion` had no good speed loop, with 0.5 and 0.3
/// added three.
const SLOWER: [f64; 4] = [1.0, 0.65, 0.45, 2.0];
const SPEED_SLOWER: [f64; 5] = [1.0, 2.0, 0.5, 0.3, 4.0];
const LEAST_MARGIN_DEG: f64 = 45.0;

/// Arms, runs the experiment of `request`, compares the resulting gains with those that the board started with, saves
/// them if they are better and the request says so, and disarms. `progress` receives each step in words.
///
/// The motor has its present gains again when the session ends, unless the proposed ones were saved.
///
/// # Errors
/// [`TuneError`] when the request is not possible or the experiment has no conclusion; [`WatchError`] when the motor
/// leaves its travel, does not settle, or exceeds the time limit; the error of the board when it refuses or stops, or
/// of the link.
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
    // The gains at the board's start. The board does not report gains that were changed since, and `r4` changes them
    // only here.
    let present = AtEnd { channel, mode: plan.gains_of(), gains: plan.motor.gains, tuning: plan.motor.tuning };
    session.at_end(Some(present));
    set(session, &plan, channel, plan.motor.gains, plan.motor.tuning).await?;
    let driven = session.armed(async || drive(session, request, &mut motor, &plan, &mut progress).await).await?;
    let Driven { finding, before, attempt } = driven;
    let Attempt { proposal: Proposal { gains: proposed, tuning, rule, margin_deg }, after, worse } = attempt;
    let saved = worse.is_none() && request.save;
    if saved {
        progress("saving");
        let Tuning { feed_forward, cascade_per_s } = tuning;
        let of_gains = plan::of_gains(plan.of).into_iter().zip([proposed.kp, proposed.ki, proposed.kd]);
        let of_tuning = [
            (Parameter::StaticDuty, feed_forward.static_duty),
            (Parameter::DutyPerSpeed, feed_forward.duty_per_speed),
            (Parameter::DutyPerAcceleration, feed_forward.duty_per_acceleration),
            (Parameter::Cascade, cascade_per_s),
        ];
        for (parameter, value) in of_gains.chain(of_tuning) {
            board.set_parameter(ParameterKey { channel: Some(channel), parameter }, value).await?;
        }
        board.save_parameters().await.map_err(TuneError::NotSaved)?;
        session.at_end(None);
    }
    Ok(Outcome { plan, finding, rule, margin_deg, proposed, tuning, before, after, worse, saved })
}

/// Result of the armed part.
struct Driven {
    finding: Finding,
    before: Answer,
    attempt: Attempt,
}

/// Proposed gains, with their rule in words.
struct Proposal {
    gains: PidGains,
    tuning: Tuning,
    rule: String,
    margin_deg: f64,
}

/// Trial of a proposal on the board.
struct Attempt {
    proposal: Proposal,
    after: Result<Answer, String>,
    worse: Option<String>,
}

impl Attempt {
    /// Returns true for a response that is better than before and has negligible overshoot.
    fn is_good(&self) -> bool {
        self.worse.is_none() && self.after.as_ref().is_ok_and(|after| after.response.overshoot <= OVERSHOOT)
    }
}

async fn set(
    session: &Session<'_>,
    plan: &Plan,
    channel: ChannelId,
    gains: PidGains,
    tuning: Tuning,
) -> Result<(), Error> {
    session.board.set_gains(channel, plan.gains_of(), gains).await?;
    session.board.set_tuning(channel, tuning).await?;
    Ok(())
}

async fn drive(
    session: &Session<'_>,
    request: &TuneRequest,
    motor: &mut MotorWatch<'_>,
    plan: &Plan,
    progress: &mut impl FnMut(&str),
) -> Result<Driven, Error> {
    let channel = request.channel;
    progress(&format!("{channel}: going to where the run begins"));
    experiment::come(motor, plan.base, plan.approach_s).await?;
    motor.stay_within(Some(plan.window));
    progress(&format!("{channel}: steps with the present gains"));
    let before = experiment::answer(motor, plan).await?;
    experiment::come(motor, plan.base, plan.settle_s).await?;
    let finding = match request.method {
        Method::Relay => {
            progress(&format!("{channel}: swinging"));
            Finding::Swing(experiment::relay(motor, plan).await?)
        }
        Method::Step => {
            progress(&format!("{channel}: runs under changing duties"));
            Finding::Fit(experiment::step(motor, plan).await?)
        }
    };
    let mut tried: Vec<Attempt> = Vec::new();
    for &slower in if plan.of == Loop::Speed { &SPEED_SLOWER[..] } else { &SLOWER[..] } {
        let proposal = match propose(request, plan, &finding, slower) {
            Ok(Some(proposal)) => proposal,
            // The rule has no further proposals.
            Ok(None) => break,
            Err(error) if tried.is_empty() => return Err(error),
            Err(_) => break,
        };
        if slower < 1.0 && proposal.margin_deg < LEAST_MARGIN_DEG {
            continue;
        }
        progress(&format!("{channel}: steps with the proposed gains"));
        tried.push(attempt(session, request, motor, plan, &before, proposal).await?);
        if tried.last().is_some_and(Attempt::is_good) {
            break;
        }
    }
    // The first good attempt; without one, the first that is not worse; otherwise the first, which reports why.
    let best = tried.iter().position(Attempt::is_good).or(tried.iter().position(|attempt| attempt.worse.is_none()));
    let attempt = tried.swap_remove(best.unwrap_or(0));
    motor.stay_within(None);
    experiment::come(motor, plan.base, plan.approach_s).await?;
    Ok(Driven { finding, before, attempt })
}

/// Steps with proposed gains; afterwards the motor has its present ones again.
async fn attempt(
    session: &Session<'_>,
    request: &TuneRequest,
    motor: &mut MotorWatch<'_>,
    plan: &Plan,
    before: &Answer,
    proposal: Proposal,
) -> Result<Attempt, Error> {
    experiment::come(motor, plan.base, plan.settle_s).await?;
    set(session, plan, request.channel, proposal.gains, proposal.tuning).await?;
    let after = match experiment::answer(motor, plan).await {
        Ok(after) => Ok(after),
        // Gains that do not hold the motor are rejected; the motor returns with the present ones.
        Err(Error::Watch(error)) if matches!(*error, WatchError::Travel { .. } | WatchError::NotSettled { .. }) => {
            Err(error.to_string())
        }
        Err(error @ Error::Watch(_)) => return Err(error),
        Err(error) => return Err(TuneError::WithProposed(Box::new(error)).into()),
    };
    if after.is_err() {
        motor.stay_within(None);
        experiment::stop(motor).await?;
    }
    set(session, plan, request.channel, plan.motor.gains, plan.motor.tuning).await?;
    if after.is_err() {
        experiment::come(motor, plan.base, plan.approach_s).await?;
        motor.stay_within(Some(plan.window));
    }
    let worse = match &after {
        Ok(after) => worse(plan, before.response, after.response),
        Err(why) => Some(why.clone()),
    };
    Ok(Attempt { proposal, after, worse })
}

/// Computes gains by the rule of method and loop; `None` where the rule has none for a loop slower by this factor.
fn propose(request: &TuneRequest, plan: &Plan, finding: &Finding, slower: f64) -> Result<Option<Proposal>, Error> {
    let present = plan.motor.tuning;
    let margin_rad = request.margin_deg.to_radians();
    let (fit, tuning, board) = match (finding, plan.of) {
        (Finding::Swing(_), Loop::Position) if slower != 1.0 => return Ok(None),
        (Finding::Swing(swing), Loop::Position) => {
            let LoopConditions { estimate, period_s, .. } = plan.conditions();
            let filter_s = match estimate {
                SpeedEstimate::LowPass { time_s } => time_s,
                SpeedEstimate::Observer { .. } => 0.0,
            };
            let point = swing.oscillation.point;
            let gains = position_through(point, margin_rad, filter_s, period_s).map_err(TuneError::from)?;
            let rule = "Astrom-Hagglund, through the motor's gain and phase at the frequency of the swing".to_owned();
            let tuning = Tuning { cascade_per_s: 0.0, ..present };
            return Ok(Some(Proposal { gains, tuning, rule, margin_deg: request.margin_deg }));
        }
        (Finding::Swing(swing), of) => {
            let point = swing.oscillation.point;
            let point = if of == Loop::Speed { point } else { point.of_speed() };
            let friction = Friction { up: 0.0, down: 0.0 };
            let model = point.integrator();
            let fit = Fit { model, friction, residual: 0.0, residual_rms: 0.0, plausible: Vec::new() };
            let board = plan.conditions();
            // The swing of a speed is measured behind the board's estimate, whose lag it therefore contains already.
            let seen = of == Loop::Speed;
            let estimate = if seen { SpeedEstimate::LowPass { time_s: 0.0 } } else { board.estimate };
            (fit, present, LoopConditions { estimate, ..board })
        }
        (Finding::Fit(fit), _) => {
            let tuning = Tuning { feed_forward: feed_forward(fit, plan.motor.duty_max), ..present };
            (fit.clone(), tuning, plan.conditions())
        }
    };
    let design = board.design(plan.of, &fit, margin_rad, request.time_constant_s, slower).map_err(TuneError::from)?;
    let (gains, cascade_per_s) = match design.gains {
        Gains::Position(gains) => (gains, 0.0),
        Gains::Speed(gains) => (gains, present.cascade_per_s),
        Gains::Cascade { speed, per_s } => (speed, per_s as f32),
    };
    let rule = format!("SIMC with a closed loop of {:.1} ms", design.closed_s * 1e3);
    let tuning = Tuning { cascade_per_s, ..tuning };
    Ok(Some(Proposal { gains, tuning, rule, margin_deg: design.margin_rad.to_degrees() }))
}

/// Reason why the new response is worse, if it is. It must settle at least as fast, and be no worse in any other
/// respect.
fn worse(plan: &Plan, before: Response, after: Response) -> Option<String> {
    match (after.settling_s, before.settling_s) {
        // Settling times within one sample are equal.
        (Some(after_s), Some(before_s)) if after_s > before_s + LOOK_EVERY_S / 2.0 => {
            return Some(format!("they settle after {after_s:.3} s instead of {before_s:.3} s"));
        }
        (None, Some(before_s)) => {
            return Some(format!("they do not settle, the present ones do after {before_s:.3} s"));
        }
        (None, None) => return Some("neither they nor the present ones settle".into()),
        (Some(_), _) => {}
    }
    // A faster response may be slightly rougher; one that is not faster must not.
    let faster = after.settling_s.zip(before.settling_s).is_none_or(|(after, before)| after < FASTER * before);
    let overshoot = if faster { before.overshoot.max(OVERSHOOT) } else { before.overshoot + SAME_OVERSHOOT };
    if after.overshoot > overshoot {
        let (after, before) = (after.overshoot * 100.0, before.overshoot * 100.0);
        return Some(format!("they overshoot by {after:.1} % instead of {before:.1} %"));
    }
    // The board lets a motor rest at up to twice the error at which it counts as settled.
    let band = plan.steady_band() * if faster { 2.0 } else { 1.0 };
    let steady = before.steady_error.abs().max(band);
    (after.steady_error.abs() > steady).then(|| {
        let [after, before] = [after, before].map(|of| Quantity::new(of.steady_error, plan.unit()));
        format!("they leave an error of {after} instead of {before}")
    })
}
