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
//! assert!(outcome.margin_deg >= 60.0 && !outcome.saved);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod error;
mod experiment;
mod plan;

use r4_driver::tune::{
    Fit, Friction, Gains, Loop, Response, SpeedEstimate, Surroundings, feed_forward, position_through,
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
    /// Which of its loops; `None` is the one that holds its positions.
    pub of: Option<Loop>,
    /// Whether gains that are better are kept over restarts of the board.
    pub save: bool,
    /// How far it may go from where it begins; `None` is 1 rad or a tenth of the range, for a speed what the run takes.
    pub travel: Option<Quantity>,
    /// Where it begins; `None` is where it is, or the nearest place with room.
    pub at: Option<Quantity>,
    /// How hard it is driven, as a share of the supply; `None` is short of a stall for a position, for a speed a third of what
    /// holds it.
    pub amplitude: Option<f64>,
    /// Least phase margin, degrees, 30 to 80.
    pub margin_deg: f64,
    /// Time constant of the closed loop, s; `None` is the shortest that leaves the phase margin and that the sensor allows.
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
#[derive(Clone, Debug)]
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
    /// Phase margin that they leave on what was found of the motor, degrees.
    pub margin_deg: f64,
    /// Gains that were found.
    pub proposed: PidGains,
    /// Feed-forward and cascade that go with them.
    pub tuning: Tuning,
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
    /// The loop that holds a motor's positions, by runs under changing duties, with a phase margin of 60 degrees, within two
    /// minutes; nothing is saved.
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
/// Gains that do not do what they should are tried again in a loop so many times as slow. Of a position a faster one overcomes
/// friction that changes and a dead zone, as long as it has this phase margin, degrees; a slower one keeps a motor that is not as it
/// was found from overshooting. A faster speed loop corrects an inexact feed-forward sooner: with 1, 2 and 4 alone 6 of
/// the 200 motors 2001 to 2200 of `r4 bench motion` had no good speed loop, with 0.5 and 0.3 three.
const SLOWER: [f64; 4] = [1.0, 0.65, 0.45, 2.0];
const SPEED_SLOWER: [f64; 5] = [1.0, 2.0, 0.5, 0.3, 4.0];
const LEAST_MARGIN_DEG: f64 = 45.0;

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
    // What the board started with. It does not tell gains that were changed since, and `r4` changes them nowhere else.
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

/// What was done while armed.
struct Driven {
    finding: Finding,
    before: Answer,
    attempt: Attempt,
}

/// Gains for what was found, and the rule in words.
struct Proposal {
    gains: PidGains,
    tuning: Tuning,
    rule: String,
    margin_deg: f64,
}

/// How the board did with it.
struct Attempt {
    proposal: Proposal,
    after: Result<Answer, String>,
    worse: Option<String>,
}

impl Attempt {
    /// Better than what there was, and without overshoot worth the name.
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
            // What was tried already is all that there is.
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
    // The first that is better; where none is, the first of all says why not.
    let best = tried.iter().position(Attempt::is_good).or(tried.iter().position(|attempt| attempt.worse.is_none()));
    let attempt = tried.swap_remove(best.unwrap_or(0));
    motor.stay_within(None);
    experiment::come(motor, plan.base, plan.approach_s).await?;
    Ok(Driven { finding, before, attempt })
}

/// Steps with proposed gains, after which the motor has its present ones again.
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
        // Gains that do not hold the motor are no gains; the motor goes back with those that do.
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

/// Gains by the rule of the method and the loop; `None` where the rule knows none for a loop so many times slower.
fn propose(request: &TuneRequest, plan: &Plan, finding: &Finding, slower: f64) -> Result<Option<Proposal>, Error> {
    let present = plan.motor.tuning;
    let margin_rad = request.margin_deg.to_radians();
    let (fit, tuning, board) = match (finding, plan.of) {
        (Finding::Swing(_), Loop::Position) if slower != 1.0 => return Ok(None),
        (Finding::Swing(swing), Loop::Position) => {
            let Surroundings { estimate, period_s, .. } = plan.surroundings();
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
            let board = plan.surroundings();
            // A speed swings behind the board's estimate of it: its lag is in the swing already.
            let seen = of == Loop::Speed;
            let estimate = if seen { SpeedEstimate::LowPass { time_s: 0.0 } } else { board.estimate };
            (fit, present, Surroundings { estimate, ..board })
        }
        (Finding::Fit(fit), _) => {
            let tuning = Tuning { feed_forward: feed_forward(fit, plan.motor.duty_max), ..present };
            (fit.clone(), tuning, plan.surroundings())
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
