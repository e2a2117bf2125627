//! Experiments with the motor: steps of the set point, a relay, and steps of the duty.

use r4_driver::tune::{Fit, FitError, Loop, Oscillation, Relay, RelayError, Response, Run, Sample, beyond_friction};
use r4_protocol::Mode;

use super::{Inconclusive, LOOK_EVERY_S, Plan, TuneError, plan::BELOW_STALL};
use crate::{
    Error,
    watch::{Look, MotorWatch, WatchError},
};

/// Duration for which a speed is held before a step from it, s.
const SPEED_HOLD_S: f64 = 1.0;
/// Settling band of a speed, as a share of the step; and averaging time that removes the encoder's quantisation, s.
const SPEED_BAND: f64 = 0.05;
const SPEED_MEAN_S: f64 = 0.03;
/// Time for a motor driven by duty to come to rest, s.
const REST_S: f64 = 0.3;
/// Number of relay cycles that must agree, and their tolerance as a share of the mean.
const CYCLES: usize = 5;
const CYCLES_WITHIN: f64 = 0.1;
/// Number of first cycles that are ignored.
const FIRST_CYCLES: usize = 2;
/// Time limit of a relay experiment, s: of a position, and of a speed.
const RELAY_LIMIT_S: f64 = 8.0;
const SPEED_RELAY_LIMIT_S: f64 = 3.0;
/// Hysteresis: in counts of the sensor, and in standard deviations of the noise.
const HYSTERESIS_COUNTS: f64 = 4.0;
const HYSTERESIS_NOISE: f64 = 4.0;
/// Deviation of a cycle's high share from one half, beyond which the bias is moved.
const BIAS_BEYOND: f64 = 0.03;
/// Amplitude of a speed experiment: share of the duty beyond friction that holds the speed.
const SPEED_SHARE: f64 = 0.35;
/// Least duty of an experiment; smaller ones do not show above the noise.
const LEAST_DUTY: f64 = 0.02;
/// Search for the duty that overcomes friction: rate of the duty, 1/s; number of samples in a step; counts of travel
/// that end it.
const RAMP_PER_S: f64 = 0.2;
const RAMP_LOOKS: usize = 5;
const RAMP_COUNTS: f64 = 4.0;
/// Count that is equivalent to a sensor's noise, in standard deviations: a uniformly distributed error of one count has
/// that ratio.
const NOISE_AS_COUNT: f64 = 3.5;
/// Duty beyond friction of the first runs, which each further pair doubles, until the motor reaches this share of its
/// path's speed.
const FIRST_BEYOND: f64 = 0.04;
const OF_PATH_SPEED: f64 = 0.7;
/// Share of the path's speed above which a run is aborted.
const TOO_FAST: f64 = 1.2;
/// Pattern of a run: its duty beyond friction alternates between all of it and this share, for these times, s. They
/// show lags of 10 to 300 ms.
const LOW_SHARE: f64 = 0.5;
const HALVES_S: [f64; 6] = [0.08, 0.08, 0.04, 0.04, 0.16, 0.16];
/// End of a run: at this share of the window on either side, or at the time limit, s. It ends sooner where the motor
/// would not stop by itself within the second share. The stop is assumed as fast as the acceleration, after a reaction
/// time, s: two samples, the latency of the host, and the speed filter.
const RUN_SHARE: f64 = 0.5;
const STOP_SHARE: f64 = 0.8;
const REACTION_S: f64 = 0.03;
/// Growth of the speed that counts as still accelerating.
const STILL_RISING: f64 = 1.05;
const RUN_LIMIT_S: f64 = 1.5;
/// Duration of a run below which it was so fast that a faster one would give less information, s.
const SHORT_RUN_S: f64 = 0.08;
/// Number of pairs of runs for the fit: the fastest ones, since the model is needed at the speed of paths.
const PAIRS: usize = 3;
/// Least number of pairs: a single short one cannot separate friction from gain.
const LEAST_PAIRS: usize = 2;
/// Least total of counts in the runs, below which they determine the lag poorly; the fastest pair is repeated at most
/// this number of times. Our choice: on sampled motors 1 to 200 as many are good without.
const LEAST_COUNTS: f64 = 1500.0;
const MORE_PAIRS: usize = 4;
/// Share of the largest duty for a motor that turns.
const OF_DUTY_MAX: f64 = 0.95;
/// End of braking: share of the initial speed, and time limit, s.
const BRAKED_TO: f64 = 0.1;
const BRAKE_LIMIT_S: f64 = 1.0;
/// Rest: time without motion by a count, s, and time limit of the wait, s.
const STILL_S: f64 = 0.1;
const STILL_LIMIT_S: f64 = 2.0;
/// Largest residual of a model, as a share of the motion.
const RESIDUAL: f64 = 0.25;

/// Sample of a step response, in the units of the loop: rad, m, rad/s or m/s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AnswerSample {
    /// Time since the first step, s.
    pub time_s: f64,
    /// Measured output of the loop; a speed is the mean over 30 ms.
    pub output: f64,
    /// Set point of the loop.
    pub setpoint: f64,
}

/// Response to steps of the set point, up and down again.
#[derive(Clone, Debug)]
pub struct Answer {
    /// Samples of both steps.
    pub samples: Vec<AnswerSample>,
    /// Worse value of both steps in each respect.
    pub response: Response,
}

/// Result of a relay experiment.
#[derive(Clone, Copy, Debug)]
pub struct Swing {
    /// Oscillation of the motor.
    pub oscillation: Oscillation,
    /// Half the height of the duty's square wave, as a share of the supply.
    pub height: f64,
    /// Mean of the duty's square wave, as a share of the supply.
    pub bias: f64,
    /// Hysteresis of the relay, in the unit of the loop.
    pub hysteresis: f64,
    /// Mean time from the sample at which the relay switched until the board followed, s.
    pub host_delay_s: f64,
}

/// Steps the set point with the board's present gains, ending at the start.
pub(crate) async fn answer(motor: &mut MotorWatch<'_>, plan: &Plan) -> Result<Answer, Error> {
    let (low, high) = plan.steps;
    let mode = plan.mode();
    match plan.of {
        Loop::Position | Loop::Cascade => {
            come(motor, low, plan.settle_s).await?;
        }
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
        // A measurement is exact to half a count: an overshoot below that is none.
        let (band, known) = match plan.of {
            Loop::Position | Loop::Cascade => (plan.motor.settle_error, plan.motor.resolution / 2.0),
            Loop::Speed => {
                let known = plan.speed_resolution(SPEED_MEAN_S);
                ((SPEED_BAND * (to - from).abs()).max(known), known)
            }
        };
        let mut response = Response::of(&step, from, to, band);
        if let Some(response) = &mut response {
            response.overshoot = (response.overshoot - known / (to - from).abs()).max(0.0);
        }
        if let (Some(response), Mode::Position) = (&mut response, mode) {
            // The board's own verdict, which is what a user waits for.
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
        come(motor, plan.base, plan.settle_s).await?;
    }
    let response = responses.into_iter().reduce(Response::worse);
    let response = response.ok_or(TuneError::NoAnswer)?;
    Ok(Answer { samples, response })
}

/// Samples for `seconds`, from the first one with this set point on.
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

/// Output of the loop in a sample.
fn output(look: &Look, of: Loop) -> f64 {
    match of {
        Loop::Position | Loop::Cascade => look.position,
        Loop::Speed => look.speed,
    }
}

/// Moving average around each value.
fn smooth(values: &[f64]) -> Vec<f64> {
    let half = (SPEED_MEAN_S / LOOK_EVERY_S / 2.0) as usize;
    let around = |index: usize| &values[index.saturating_sub(half)..(index + half + 1).min(values.len())];
    (0..values.len()).map(|index| mean(around(index).iter().copied())).collect()
}

fn mean(values: impl Iterator<Item = f64> + Clone) -> f64 {
    values.clone().sum::<f64>() / values.count().max(1) as f64
}

/// Standard deviation around the mean.
fn noise(values: impl Iterator<Item = f64> + Clone) -> f64 {
    let mean = mean(values.clone());
    self::mean(values.map(|value| (value - mean) * (value - mean))).sqrt()
}

/// Sends the motor to a position; returns true when it came to rest there in time. Poor gains may miss that.
pub(crate) async fn come(motor: &mut MotorWatch<'_>, target: f64, timeout_s: f64) -> Result<bool, Error> {
    match motor.go_to(target, timeout_s).await {
        Ok(()) => Ok(true),
        Err(Error::Watch(error)) if matches!(*error, WatchError::NotSettled { .. }) => Ok(false),
        Err(error) => Err(error),
    }
}

/// Lets a driven motor come to rest.
pub(crate) async fn stop(motor: &mut MotorWatch<'_>) -> Result<(), Error> {
    motor.command(Mode::Duty, 0.0).await?;
    motor.watch(REST_S).await?;
    Ok(())
}

/// Start of an experiment: duty and output around which it swings, half the height of the duty, and the noise.
struct Start {
    duty: f64,
    output: f64,
    height: f64,
    noise: f64,
}

async fn start(motor: &mut MotorWatch<'_>, plan: &Plan) -> Result<Start, Error> {
    match plan.of {
        Loop::Position | Loop::Cascade => {
            motor.go_to(plan.base, plan.settle_s).await?;
            motor.command(Mode::Duty, 0.0).await?;
            let looks = motor.watch(REST_S).await?;
            // The first half may still contain the end of the motion.
            let still = &looks[looks.len() / 2..];
            let noise = noise(still.iter().map(|look| look.position));
            Ok(Start { duty: 0.0, output: plan.base, height: plan.amplitude, noise })
        }
        Loop::Speed => {
            let speed = (plan.steps.0 + plan.steps.1) / 2.0;
            motor.command(Mode::Speed, speed).await?;
            let looks = motor.watch(SPEED_HOLD_S).await?;
            // The first half may still contain the acceleration.
            let steady = &looks[looks.len() / 2..];
            let duty = mean(steady.iter().map(|look| look.duty));
            let room = plan.motor.duty_max - duty.abs();
            let wanted = plan.given_amplitude.unwrap_or(SPEED_SHARE * (duty.abs() - plan.motor.static_duty()));
            // Both levels must stay below the board's limit, which would distort the square wave.
            let height = wanted.min(0.95 * room);
            if height.is_nan() || height < LEAST_DUTY {
                return Err(TuneError::from(Inconclusive::NoRoom { duty }).into());
            }
            let output = mean(steady.iter().map(|look| look.speed));
            Ok(Start { duty, output, height, noise: noise(steady.iter().map(|look| look.speed)) })
        }
    }
}

/// Converts a sample to the input and output of the experiment.
fn sample(plan: &Plan, look: &Look) -> Sample {
    let input = match plan.of {
        Loop::Position | Loop::Cascade => beyond_friction(look.duty, plan.motor.static_duty()),
        Loop::Speed => look.duty,
    };
    Sample { time_s: look.time_s, input, output: output(look, plan.of) }
}

/// Lets the motor oscillate under a relay until several cycles agree.
pub(crate) async fn relay(motor: &mut MotorWatch<'_>, plan: &Plan) -> Result<Swing, Error> {
    let Start { duty, output: centre, height, noise } = start(motor, plan).await?;
    let resolved = match plan.of {
        Loop::Position | Loop::Cascade => HYSTERESIS_COUNTS * plan.motor.resolution,
        Loop::Speed => 0.0,
    };
    let hysteresis = resolved.max(HYSTERESIS_NOISE * noise);
    let (limit_s, most) = match plan.of {
        Loop::Position | Loop::Cascade => (RELAY_LIMIT_S, plan.cap),
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
            // The board followed at an unknown time between the previous sample and this one: half a period is the
            // mean.
            delays_s.push(look.time_s - decided_s - LOOK_EVERY_S / 2.0);
        }
        let decided = relay.step(output(&look, plan.of));
        if decided != high {
            high = decided;
            let lasted_s = switched_s.map_or(0.0, |since_s| look.time_s - since_s);
            switched_s = Some(look.time_s);
            if high {
                rises += 1;
                // A cycle that is high for longer than low shows a static load, which the bias must balance.
                let share = high_s / (high_s + lasted_s).max(f64::MIN_POSITIVE) - 0.5;
                if rises > 1 && share.abs() > BIAS_BEYOND {
                    // Keeps both levels within the duty limit.
                    let room = (most - height).max(0.0);
                    bias = (bias + height * share).clamp(-room, room);
                }
            } else {
                high_s = lasted_s;
            }
            let value = bias + if high { height } else { -height };
            motor.command(Mode::Duty, value).await?;
            asked = Some((look.time_s, value as f32));
            // Evaluated at rises only, so that the samples contain whole cycles.
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

/// Drives the motor up and down with increasing duty, and fits a model to the runs. Friction needs no prior value: the
/// duty that overcomes it is searched first.
pub(crate) async fn step(motor: &mut MotorWatch<'_>, plan: &Plan) -> Result<Fit, Error> {
    come(motor, (plan.window.0 + plan.window.1) / 2.0, plan.settle_s).await?;
    stop(motor).await?;
    let still = motor.watch(REST_S).await?;
    // A noisy sensor resolves less than its counts.
    let count = plan.motor.resolution.max(NOISE_AS_COUNT * noise(still.iter().map(|look| look.position)));
    let up = overcomes_friction(motor, plan, 1.0, count).await?;
    let down = overcomes_friction(motor, plan, -1.0, count).await?;
    let most = plan.given_amplitude.unwrap_or(OF_DUTY_MAX * plan.motor.duty_max);
    let mut runs: Vec<Run> = Vec::new();
    let mut beyond = FIRST_BEYOND;
    loop {
        let (mut fastest, mut shortest_s) = (0.0_f64, f64::INFINITY);
        for (sign, friction) in [(1.0, up), (-1.0, down)] {
            let (run, speed) = run(motor, plan, sign, friction, (friction + beyond).min(most)).await?;
            fastest = fastest.max(speed);
            let duration_s =
                run.samples.first().zip(run.samples.last()).map(|(first, last)| last.time_s - first.time_s);
            shortest_s = shortest_s.min(duration_s.unwrap_or(0.0));
            runs.push(run);
        }
        // Fast enough for the speeds of paths, or too short for a faster run to add information.
        let is_fast = fastest >= OF_PATH_SPEED * plan.motor.speed || shortest_s < SHORT_RUN_S;
        if is_fast && runs.len() >= 2 * LEAST_PAIRS || up.max(down) + beyond >= most {
            break;
        }
        beyond *= 2.0;
    }
    // The slow first runs are dropped: the model is needed at the speed of paths.
    let mut runs = runs.split_off(runs.len().saturating_sub(2 * PAIRS));
    for _ in 0..MORE_PAIRS {
        let counts: f64 = runs.iter().map(|run| counts(run, count)).sum();
        if counts >= LEAST_COUNTS {
            break;
        }
        for (sign, friction) in [(1.0, up), (-1.0, down)] {
            runs.push(run(motor, plan, sign, friction, (friction + beyond).min(most)).await?.0);
        }
    }
    let fit = match Fit::of(&runs, count, RESIDUAL) {
        // The gain of some motors grows with the duty: these are linear at one duty only, for which that of the path is
        // taken.
        Err(FitError::Poor { .. }) => Fit::of(&runs[runs.len() - 2..], count, RESIDUAL),
        fit => fit,
    };
    Ok(fit.map_err(TuneError::from)?)
}

/// Searches the duty at which a resting motor begins to move.
async fn overcomes_friction(motor: &mut MotorWatch<'_>, plan: &Plan, sign: f64, count: f64) -> Result<f64, Error> {
    // The search must not trip the board by a stall.
    let most = BELOW_STALL * plan.motor.stall_duty.min(plan.motor.duty_max);
    let first = motor.look().await?;
    for number in 1_usize.. {
        let look = motor.look().await?;
        if (look.position - first.position) * sign >= RAMP_COUNTS * count {
            rest(motor, plan, sign, look.speed * sign, look.duty.abs()).await?;
            return Ok(look.duty.abs());
        }
        let duty = RAMP_PER_S * (look.time_s - first.time_s);
        if duty > most {
            break;
        }
        if number % RAMP_LOOKS == 0 {
            motor.command(Mode::Duty, sign * duty).await?;
        }
    }
    stop(motor).await?;
    let direction = if sign > 0.0 { "up" } else { "down" };
    Err(TuneError::DoesNotMove { channel: motor.channel(), direction, duty: most }.into())
}

/// Travel of a run in counts of the sensor.
fn counts(run: &Run, resolution: f64) -> f64 {
    let ends = run.samples.first().zip(run.samples.last());
    ends.map_or(0.0, |(first, last)| (last.output - first.output).abs() / resolution)
}

/// Makes one run from rest; returns it with its highest speed. Its duty alternates between `high` and a value closer to
/// friction.
async fn run(
    motor: &mut MotorWatch<'_>,
    plan: &Plan,
    sign: f64,
    friction: f64,
    high: f64,
) -> Result<(Run, f64), Error> {
    let (low_end, high_end) = plan.window;
    let end_at = |share: f64| (low_end + high_end) / 2.0 + sign * share * (high_end - low_end) / 2.0;
    let (end, stopped) = (end_at(RUN_SHARE), end_at(STOP_SHARE));
    let low = friction + LOW_SHARE * (high - friction);
    let first = motor.look().await?;
    let mut samples = vec![recorded(&first)];
    motor.command(Mode::Duty, sign * high).await?;
    let (mut is_high, mut half, mut since_s, mut fastest) = (true, 0, first.time_s, 0.0_f64);
    let (mut risen, mut rise_s) = (0.0, 0.0);
    loop {
        let look = motor.look().await?;
        samples.push(recorded(&look));
        fastest = fastest.max(look.speed * sign);
        if look.speed * sign > STILL_RISING * risen {
            (risen, rise_s) = (look.speed * sign, look.time_s - first.time_s);
        }
        // A stop that takes as long as the acceleration did travels half of that time at the present speed.
        let stops_at = look.position + look.speed * (REACTION_S + rise_s / 2.0);
        let is_there = (look.position - end) * sign >= 0.0 || (stops_at - stopped) * sign >= 0.0;
        if is_there || fastest > TOO_FAST * plan.motor.speed || look.time_s - first.time_s > RUN_LIMIT_S {
            break;
        }
        if look.time_s - since_s >= HALVES_S[half % HALVES_S.len()] {
            (is_high, half, since_s) = (!is_high, half + 1, look.time_s);
            motor.command(Mode::Duty, sign * if is_high { high } else { low }).await?;
        }
    }
    rest(motor, plan, sign, fastest, high).await?;
    Ok((Run { up: sign > 0.0, samples }, fastest))
}

/// Brakes a motor that turns at up to `speed` in the direction of `sign`, with at most `duty`, and waits until it
/// rests.
async fn rest(motor: &mut MotorWatch<'_>, plan: &Plan, sign: f64, speed: f64, duty: f64) -> Result<(), Error> {
    let first = motor.look().await?;
    let brake = BELOW_STALL * plan.motor.stall_duty.min(plan.motor.duty_max);
    if first.speed * sign > BRAKED_TO * speed {
        // Neither as much as a stall, nor more than the duty that the motor was driven by.
        motor.command(Mode::Duty, -sign * brake.min(duty)).await?;
        loop {
            let look = motor.look().await?;
            if look.speed * sign <= BRAKED_TO * speed || look.time_s - first.time_s > BRAKE_LIMIT_S {
                break;
            }
        }
    }
    motor.command(Mode::Duty, 0.0).await?;
    let mut still = motor.look().await?;
    let begin_s = still.time_s;
    loop {
        let look = motor.look().await?;
        // Half a count or half the settle error is no motion.
        if (look.position - still.position).abs() >= plan.motor.settle_error.max(plan.motor.resolution) / 2.0 {
            still = look;
        }
        if look.time_s - still.time_s >= STILL_S || look.time_s - begin_s >= STILL_LIMIT_S {
            return Ok(());
        }
    }
}

fn recorded(look: &Look) -> Sample {
    Sample { time_s: look.time_s, input: look.duty, output: look.position }
}
