//! What is done with the motor: steps of the set point, a relay, steps of the duty.

use r4_driver::tune::{Fit, Loop, Oscillation, Relay, RelayError, Response, Sample, beyond_friction};
use r4_protocol::Mode;

use super::{Inconclusive, LOOK_EVERY_S, Plan, TuneError};
use crate::{
    Error,
    watch::{Look, MotorWatch},
};

/// A speed is held so long before a step from it, s.
const SPEED_HOLD_S: f64 = 1.0;
/// A speed's band, as a share of the step, and the mean that the encoder's steps are taken out with, s.
const SPEED_BAND: f64 = 0.05;
const SPEED_MEAN_S: f64 = 0.03;
/// A motor that was driven by duty is let come to rest for so long, s.
const REST_S: f64 = 0.3;
/// Cycles of a relay that must agree, and within what share of their mean.
const CYCLES: usize = 5;
const CYCLES_WITHIN: f64 = 0.1;
/// The first cycles are not looked at.
const FIRST_CYCLES: usize = 2;
/// A relay that has not settled by then will not, s.
const RELAY_LIMIT_S: f64 = 8.0;
const SPEED_RELAY_LIMIT_S: f64 = 3.0;
/// Hysteresis: counts of the sensor, and times the noise.
const HYSTERESIS_COUNTS: f64 = 4.0;
const HYSTERESIS_NOISE: f64 = 4.0;
/// The bias is moved when a cycle is high for a share this far from a half.
const BIAS_BEYOND: f64 = 0.03;
/// Of the duty beyond friction that holds the speed: how far a speed experiment goes to both sides.
const SPEED_SHARE: f64 = 0.35;
/// Less does not show above the noise.
const LEAST_DUTY: f64 = 0.02;
/// A step of the duty ends here at the latest, s.
const STEP_LIMIT_S: f64 = 0.8;
const SPEED_STEP_S: f64 = 0.5;
/// What a model may leave untold of a position and, with the encoder's steps in it, of a speed.
const UNTOLD: f64 = 0.1;
const SPEED_UNTOLD: f64 = 0.35;

/// One moment of steps of the set point, in the units of the loop: rad, m, rad/s or m/s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AnswerSample {
    /// Time since the first step, s.
    pub time_s: f64,
    /// What the loop measured; of a speed the mean over 30 ms.
    pub output: f64,
    /// What it was to be.
    pub setpoint: f64,
}

/// The response to steps of the set point, up and down again.
#[derive(Clone, Debug)]
pub struct Answer {
    /// Recorded moments of both steps.
    pub samples: Vec<AnswerSample>,
    /// The worse of both steps in each respect.
    pub response: Response,
}

/// What a relay told.
#[derive(Clone, Copy, Debug)]
pub struct Swing {
    /// The motor's swing.
    pub oscillation: Oscillation,
    /// Half the height of the duty, as a share of the supply.
    pub height: f64,
    /// Middle of the duty, as a share of the supply.
    pub bias: f64,
    /// Hysteresis of the relay, in the unit of the loop.
    pub hysteresis: f64,
    /// Mean time from a sample that made the relay switch to the board following it, s.
    pub host_delay_s: f64,
}

/// Steps of the set point with the gains that the board has, ending where they began.
pub(crate) async fn answer(motor: &mut MotorWatch<'_>, plan: &Plan) -> Result<Answer, Error> {
    let (low, high) = plan.steps;
    let mode = plan.mode();
    match plan.of {
        Loop::Position => motor.go_to(low, plan.settle_s).await?,
        Loop::Speed => {
            motor.command(mode, low).await?;
            motor.watch(SPEED_HOLD_S).await?;
        }
    }
    let mut samples = Vec::new();
    let mut responses = Vec::new();
    let mut begin_s = None;
    for (from, to) in [(low, high), (high, low)] {
        motor.command(mode, to).await?;
        let looks = followed(motor, mode, to, plan.answer_s).await?;
        let Some(first) = looks.first() else { continue };
        let outputs: Vec<f64> = looks.iter().map(|look| output(look, plan.of)).collect();
        let outputs = if plan.of == Loop::Speed { smooth(&outputs) } else { outputs };
        let step: Vec<_> =
            looks.iter().zip(&outputs).map(|(look, value)| (look.time_s - first.time_s, *value)).collect();
        let band = match plan.of {
            Loop::Position => plan.motor.settle_error,
            Loop::Speed => SPEED_BAND * (to - from).abs(),
        };
        let mut response = Response::of(&step, from, to, band);
        if let (Some(response), Loop::Position) = (&mut response, plan.of) {
            // When the board says so, which is what a user waits for.
            let unsettled = looks.iter().rposition(|look| !look.settled).map_or(0, |index| index + 1);
            response.settling_s = looks.get(unsettled).map(|look| look.time_s - first.time_s);
        }
        responses.extend(response);
        let begin_s = *begin_s.get_or_insert(first.time_s);
        samples.extend(looks.iter().zip(&outputs).map(|(look, output)| AnswerSample {
            time_s: look.time_s - begin_s,
            output: *output,
            setpoint: to,
        }));
    }
    if plan.of == Loop::Speed {
        stop(motor).await?;
        motor.go_to(plan.base, plan.settle_s).await?;
    }
    let response = responses.into_iter().reduce(Response::worse);
    let response = response.ok_or(TuneError::NoAnswer)?;
    Ok(Answer { samples, response })
}

/// Looks from the first that shows this set point, for `seconds`.
async fn followed(motor: &mut MotorWatch<'_>, mode: Mode, value: f64, seconds: f64) -> Result<Vec<Look>, Error> {
    let mut looks: Vec<Look> = Vec::new();
    loop {
        let look = motor.look().await?;
        let shows = look.setpoint.mode == mode && look.setpoint.value == value as f32;
        if shows || !looks.is_empty() {
            looks.push(look);
        }
        if let (Some(first), Some(last)) = (looks.first(), looks.last())
            && last.time_s - first.time_s >= seconds
        {
            return Ok(looks);
        }
    }
}

/// What this loop measures.
fn output(look: &Look, of: Loop) -> f64 {
    match of {
        Loop::Position => look.position,
        Loop::Speed => look.speed,
    }
}

/// The mean around each value.
fn smooth(values: &[f64]) -> Vec<f64> {
    let half = (SPEED_MEAN_S / LOOK_EVERY_S / 2.0) as usize;
    let around = |index: usize| &values[index.saturating_sub(half)..(index + half + 1).min(values.len())];
    (0..values.len()).map(|index| mean(around(index).iter().copied())).collect()
}

fn mean(values: impl Iterator<Item = f64> + Clone) -> f64 {
    values.clone().sum::<f64>() / values.count().max(1) as f64
}

/// Root mean square around the mean.
fn noise(values: impl Iterator<Item = f64> + Clone) -> f64 {
    let mean = mean(values.clone());
    self::mean(values.map(|value| (value - mean) * (value - mean))).sqrt()
}

/// Lets a motor that was driven come to rest.
pub(crate) async fn stop(motor: &mut MotorWatch<'_>) -> Result<(), Error> {
    motor.command(Mode::Duty, 0.0).await?;
    motor.watch(REST_S).await?;
    Ok(())
}

/// Where an experiment begins: the middle of the duty and of the output, half the height of the duty, and the noise.
struct Start {
    duty: f64,
    output: f64,
    height: f64,
    noise: f64,
}

async fn start(motor: &mut MotorWatch<'_>, plan: &Plan) -> Result<Start, Error> {
    match plan.of {
        Loop::Position => {
            motor.go_to(plan.base, plan.settle_s).await?;
            motor.command(Mode::Duty, 0.0).await?;
            let looks = motor.watch(REST_S).await?;
            let still = &looks[looks.len() / 2..];
            let noise = noise(still.iter().map(|look| look.position));
            Ok(Start { duty: 0.0, output: plan.base, height: plan.amplitude, noise })
        }
        Loop::Speed => {
            let speed = (plan.steps.0 + plan.steps.1) / 2.0;
            motor.command(Mode::Speed, speed).await?;
            let looks = motor.watch(SPEED_HOLD_S).await?;
            let steady = &looks[looks.len() / 2..];
            let duty = mean(steady.iter().map(|look| look.duty));
            let room = plan.motor.duty_max - duty.abs();
            let wanted = plan.given_amplitude.unwrap_or(SPEED_SHARE * (duty.abs() - plan.motor.static_duty));
            let height = wanted.min(0.95 * room);
            if height.is_nan() || height < LEAST_DUTY {
                return Err(TuneError::from(Inconclusive::NoRoom { duty }).into());
            }
            let output = mean(steady.iter().map(|look| look.speed));
            Ok(Start { duty, output, height, noise: noise(steady.iter().map(|look| look.speed)) })
        }
    }
}

/// What a look is to an experiment.
fn sample(plan: &Plan, look: &Look) -> Sample {
    let input = match plan.of {
        Loop::Position => beyond_friction(look.duty, plan.motor.static_duty),
        Loop::Speed => look.duty,
    };
    Sample { time_s: look.time_s, input, output: output(look, plan.of) }
}

/// Lets the motor swing under a relay until several cycles agree.
pub(crate) async fn relay(motor: &mut MotorWatch<'_>, plan: &Plan) -> Result<Swing, Error> {
    let Start { duty, output: centre, height, noise } = start(motor, plan).await?;
    let resolved = match plan.of {
        Loop::Position => HYSTERESIS_COUNTS * plan.motor.resolution,
        Loop::Speed => 0.0,
    };
    let hysteresis = resolved.max(HYSTERESIS_NOISE * noise);
    let (limit_s, most) = match plan.of {
        Loop::Position => (RELAY_LIMIT_S, plan.cap),
        Loop::Speed => (SPEED_RELAY_LIMIT_S, plan.motor.duty_max),
    };
    let mut relay = Relay::new(centre, hysteresis);
    let (mut bias, mut high) = (duty, true);
    motor.command(Mode::Duty, bias + height).await?;
    let mut samples: Vec<Sample> = Vec::new();
    let (mut switched_s, mut high_s) = (None::<f64>, 0.0);
    let (mut asked, mut delays_s) = (None::<(f64, f32)>, Vec::new());
    let mut rises = 0;
    let mut last = RelayError::TooFew { seen: 0, wanted: CYCLES };
    loop {
        let look = motor.look().await?;
        samples.push(sample(plan, &look));
        if let Some((_, value)) = asked
            && look.setpoint.value == value
            && let Some((decided_s, _)) = asked.take()
        {
            // It was followed somewhere between this look and the one before.
            delays_s.push(look.time_s - decided_s - LOOK_EVERY_S / 2.0);
        }
        let decided = relay.step(output(&look, plan.of));
        if decided != high {
            high = decided;
            let lasted_s = switched_s.map_or(0.0, |since_s| look.time_s - since_s);
            switched_s = Some(look.time_s);
            if high {
                rises += 1;
                let share = high_s / (high_s + lasted_s).max(f64::MIN_POSITIVE) - 0.5;
                if rises > 1 && share.abs() > BIAS_BEYOND {
                    let room = (most - height).max(0.0);
                    bias = (bias + height * share).clamp(-room, room);
                }
            } else {
                high_s = lasted_s;
            }
            let value = bias + if high { height } else { -height };
            motor.command(Mode::Duty, value).await?;
            asked = Some((look.time_s, value as f32));
            if high && rises > FIRST_CYCLES + CYCLES {
                match Oscillation::of(&samples, centre, hysteresis, CYCLES, CYCLES_WITHIN) {
                    Ok(oscillation) => {
                        stop(motor).await?;
                        let host_delay_s = mean(delays_s.iter().copied());
                        return Ok(Swing { oscillation, height, bias, hysteresis, host_delay_s });
                    }
                    Err(error) => last = error,
                }
            }
        }
        let after_s = samples.first().map_or(0.0, |first| look.time_s - first.time_s);
        if after_s > limit_s {
            stop(motor).await?;
            return Err(TuneError::from(Inconclusive::Relay { after_s, last }).into());
        }
    }
}

/// Steps the duty to both sides and fits a motor to what comes.
pub(crate) async fn step(motor: &mut MotorWatch<'_>, plan: &Plan) -> Result<Fit, Error> {
    let Start { duty, height, .. } = start(motor, plan).await?;
    let mut looks = Vec::new();
    match plan.of {
        Loop::Position => {
            looks.extend(motor.watch(LOOK_EVERY_S * 10.0).await?);
            for (height, until) in [(height, plan.base + plan.travel / 3.0), (-height, plan.base)] {
                motor.command(Mode::Duty, height).await?;
                let begin_s = looks.last().map_or(0.0, |look| look.time_s);
                loop {
                    let look = motor.look().await?;
                    looks.push(look);
                    let there = (look.position - until) * height > 0.0;
                    if there || look.time_s - begin_s > STEP_LIMIT_S {
                        break;
                    }
                }
            }
            motor.command(Mode::Duty, 0.0).await?;
            looks.extend(motor.watch(REST_S).await?);
        }
        Loop::Speed => {
            motor.command(Mode::Duty, duty).await?;
            let steady = motor.watch(SPEED_STEP_S).await?;
            looks.extend_from_slice(&steady[steady.len() * 3 / 4..]);
            for value in [duty + height, duty - height, duty] {
                motor.command(Mode::Duty, value).await?;
                looks.extend(motor.watch(SPEED_STEP_S).await?);
            }
            stop(motor).await?;
        }
    }
    let samples: Vec<Sample> = looks.iter().map(|look| sample(plan, look)).collect();
    let untold = if plan.of == Loop::Position { UNTOLD } else { SPEED_UNTOLD };
    Ok(Fit::of(&samples, plan.of, untold).map_err(TuneError::from)?)
}
