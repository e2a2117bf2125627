//! What is done with the motor: steps of the set point, a relay, steps of the duty.

use r4_driver::tune::{Fit, Loop, Oscillation, Relay, RelayError, Response, Sample, beyond_friction};
use r4_protocol::Mode;

use super::{
    Plan,
    rig::{LOOK_EVERY_S, Look, Rig},
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

/// Why an experiment says nothing.
#[derive(Clone, Debug, thiserror::Error)]
pub(super) enum Inconclusive {
    #[error("the relay did not settle into a swing within {after_s:.0} s: {last}")]
    Relay { after_s: f64, last: RelayError },
    #[error("there is no room for a duty around {duty:.3} that holds the speed: --amplitude, or another speed")]
    NoRoom { duty: f64 },
}

/// The steps of the set point, up and down again, and what is read off.
#[derive(Clone, Debug)]
pub(super) struct Answer {
    /// s since the first step, output, set point
    pub(super) samples: Vec<(f64, f64, f64)>,
    pub(super) response: Response,
}

/// What a relay told.
#[derive(Clone, Copy, Debug)]
pub(super) struct Swing {
    pub(super) oscillation: Oscillation,
    /// Half the height of the duty, of it what is beyond friction, and the middle.
    pub(super) height: f64,
    pub(super) bias: f64,
    pub(super) hysteresis: f64,
    /// From a sample that made the relay switch to the board following it, s; mean.
    pub(super) host_delay_s: f64,
}

/// Steps of the set point with the gains that the board has, ending where they began.
pub(super) async fn answer(rig: &mut Rig<'_>, plan: &Plan) -> anyhow::Result<Answer> {
    let (low, high) = plan.steps;
    let mode = plan.mode();
    match plan.of {
        Loop::Position => rig.go_to(low, plan.settle_s).await?,
        Loop::Speed => {
            rig.command(mode, low).await?;
            rig.watch(SPEED_HOLD_S).await?;
        }
    }
    let mut samples = Vec::new();
    let mut responses = Vec::new();
    let mut begin_s = None;
    for (from, to) in [(low, high), (high, low)] {
        rig.command(mode, to).await?;
        let looks = followed(rig, mode, to, plan.answer_s).await?;
        let Some(first) = looks.first() else { continue };
        let outputs: Vec<f64> = looks.iter().map(|look| look.output(plan.of)).collect();
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
        samples.extend(looks.iter().zip(&outputs).map(|(look, value)| (look.time_s - begin_s, *value, to)));
    }
    if plan.of == Loop::Speed {
        stop(rig).await?;
        rig.go_to(plan.base, plan.settle_s).await?;
    }
    let response = responses.into_iter().reduce(Response::worse);
    let response = response.ok_or_else(|| anyhow::anyhow!("no telemetry after the step"))?;
    Ok(Answer { samples, response })
}

/// Looks from the first that shows this set point, for `seconds`.
async fn followed(rig: &mut Rig<'_>, mode: Mode, value: f64, seconds: f64) -> anyhow::Result<Vec<Look>> {
    let mut looks: Vec<Look> = Vec::new();
    loop {
        let look = rig.look().await?;
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
pub(super) async fn stop(rig: &mut Rig<'_>) -> anyhow::Result<()> {
    rig.command(Mode::Duty, 0.0).await?;
    rig.watch(REST_S).await?;
    Ok(())
}

/// Where an experiment begins: the middle of the duty and of the output, half the height of the duty, and the noise.
struct Start {
    duty: f64,
    output: f64,
    height: f64,
    noise: f64,
}

async fn start(rig: &mut Rig<'_>, plan: &Plan) -> anyhow::Result<Start> {
    match plan.of {
        Loop::Position => {
            rig.go_to(plan.base, plan.settle_s).await?;
            rig.command(Mode::Duty, 0.0).await?;
            let looks = rig.watch(REST_S).await?;
            let still = &looks[looks.len() / 2..];
            let noise = noise(still.iter().map(|look| look.position));
            Ok(Start { duty: 0.0, output: plan.base, height: plan.amplitude, noise })
        }
        Loop::Speed => {
            let speed = (plan.steps.0 + plan.steps.1) / 2.0;
            rig.command(Mode::Speed, speed).await?;
            let looks = rig.watch(SPEED_HOLD_S).await?;
            let steady = &looks[looks.len() / 2..];
            let duty = mean(steady.iter().map(|look| look.duty));
            let room = plan.motor.duty_max - duty.abs();
            let wanted = plan.given_amplitude.unwrap_or(SPEED_SHARE * (duty.abs() - plan.motor.static_duty));
            let height = wanted.min(0.95 * room);
            if height.is_nan() || height < LEAST_DUTY {
                return Err(Inconclusive::NoRoom { duty }.into());
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
    Sample { time_s: look.time_s, input, output: look.output(plan.of) }
}

/// Lets the motor swing under a relay until several cycles agree.
pub(super) async fn relay(rig: &mut Rig<'_>, plan: &Plan) -> anyhow::Result<Swing> {
    let Start { duty, output: centre, height, noise } = start(rig, plan).await?;
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
    rig.command(Mode::Duty, bias + height).await?;
    let mut samples: Vec<Sample> = Vec::new();
    let (mut switched_s, mut high_s) = (None::<f64>, 0.0);
    let (mut asked, mut delays_s) = (None::<(f64, f32)>, Vec::new());
    let mut rises = 0;
    let mut last = RelayError::TooFew { seen: 0, wanted: CYCLES };
    loop {
        let look = rig.look().await?;
        samples.push(sample(plan, &look));
        if let Some((_, value)) = asked
            && look.setpoint.value == value
            && let Some((decided_s, _)) = asked.take()
        {
            // It was followed somewhere between this look and the one before.
            delays_s.push(look.time_s - decided_s - LOOK_EVERY_S / 2.0);
        }
        let decided = relay.step(look.output(plan.of));
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
            rig.command(Mode::Duty, value).await?;
            asked = Some((look.time_s, value as f32));
            if high && rises > FIRST_CYCLES + CYCLES {
                match Oscillation::of(&samples, centre, hysteresis, CYCLES, CYCLES_WITHIN) {
                    Ok(oscillation) => {
                        stop(rig).await?;
                        let host_delay_s = mean(delays_s.iter().copied());
                        return Ok(Swing { oscillation, height, bias, hysteresis, host_delay_s });
                    }
                    Err(error) => last = error,
                }
            }
        }
        let after_s = samples.first().map_or(0.0, |first| look.time_s - first.time_s);
        if after_s > limit_s {
            stop(rig).await?;
            return Err(Inconclusive::Relay { after_s, last }.into());
        }
    }
}

/// Steps the duty to both sides and fits a motor to what comes.
pub(super) async fn step(rig: &mut Rig<'_>, plan: &Plan) -> anyhow::Result<Fit> {
    let Start { duty, height, .. } = start(rig, plan).await?;
    let mut looks = Vec::new();
    match plan.of {
        Loop::Position => {
            looks.extend(rig.watch(LOOK_EVERY_S * 10.0).await?);
            for (height, until) in [(height, plan.base + plan.travel / 3.0), (-height, plan.base)] {
                rig.command(Mode::Duty, height).await?;
                let begin_s = looks.last().map_or(0.0, |look| look.time_s);
                loop {
                    let look = rig.look().await?;
                    looks.push(look);
                    let there = (look.position - until) * height > 0.0;
                    if there || look.time_s - begin_s > STEP_LIMIT_S {
                        break;
                    }
                }
            }
            rig.command(Mode::Duty, 0.0).await?;
            looks.extend(rig.watch(REST_S).await?);
        }
        Loop::Speed => {
            rig.command(Mode::Duty, duty).await?;
            let steady = rig.watch(SPEED_STEP_S).await?;
            looks.extend_from_slice(&steady[steady.len() * 3 / 4..]);
            for value in [duty + height, duty - height, duty] {
                rig.command(Mode::Duty, value).await?;
                looks.extend(rig.watch(SPEED_STEP_S).await?);
            }
            stop(rig).await?;
        }
    }
    let samples: Vec<Sample> = looks.iter().map(|look| sample(plan, look)).collect();
    let untold = if plan.of == Loop::Position { UNTOLD } else { SPEED_UNTOLD };
    Ok(Fit::of(&samples, plan.of, untold)?)
}
