//! The free run of an axis: exact where it is linear, with events where friction holds or lets go.
//!
//! ```text
//! dv/dt = k · volts − b · v − friction + load        in rad/s² or m/s²: everything is per unit of inertia
//! ```
//!
//! Within a step, the command, the friction's level and the load are constant and the rest is solved exactly, up to the
//! moment at which the speed passes zero; there the axis holds unless it is pushed harder than friction.

use std::f64::consts::TAU;

use crate::family::{Acts, Curve, Structure};
use r4_plants::Dependence;

use super::{Motion, MotionRun, effect::Effect};

/// What a free run tells beside the output, sample by sample.
#[derive(Clone, Debug, Default)]
pub(super) struct Observed {
    pub(super) input: Vec<f64>,
    pub(super) speed: Vec<f64>,
    pub(super) position: Vec<f64>,
    pub(super) acceleration: Vec<f64>,
    pub(super) direction: Vec<f64>,
    pub(super) time_s: Vec<f64>,
    pub(super) supply: Vec<f64>,
    /// Distance since the last reversal.
    pub(super) history: Vec<f64>,
}

/// A sine over position.
#[derive(Clone, Copy)]
struct Wave {
    amplitude: f64,
    phase: f64,
    /// Radians per unit of position.
    rate: f64,
}

impl Wave {
    fn at(&self, position: f64) -> f64 {
        self.amplitude * (self.rate * position + self.phase).sin()
    }
}

/// A structure with every number where the simulation wants it.
struct Plan<'s> {
    /// Per volt.
    k: f64,
    b: f64,
    /// With open terminals.
    b_open: f64,
    /// Duty per rad of error and unit of gain; a servo's.
    loop_gain: f64,
    /// Of a pendulum that is known to be there.
    pendulum: f64,
    /// Its angle at position 0.
    pendulum_offset: f64,
    sign: f64,
    delay_s: f64,
    hold_s: f64,
    dead_zone: f64,
    exponent: Option<f64>,
    backward_gain: f64,
    limit: f64,
    rate: Option<f64>,
    lag_s: f64,
    sag: f64,
    heating: Option<(f64, f64)>,
    coulomb: (f64, f64),
    stribeck: Option<(f64, f64)>,
    load_share: f64,
    position_friction: Option<Wave>,
    warm_up: Option<(f64, f64)>,
    drag: f64,
    /// More damping forwards, and backwards.
    viscous: (f64, f64),
    load: f64,
    gravity: Option<Wave>,
    cogging: Option<Wave>,
    gap: f64,
    compliance: Option<(f64, f64)>,
    sensor_lag_s: f64,
    sensor_hold_s: f64,
    eccentricity: Option<Wave>,
    scale: f64,
    offset: f64,
    curves: Vec<(&'s Curve, &'s [f64])>,
    /// Friction or load change within a step's motion.
    fine: bool,
}

impl<'s> Plan<'s> {
    fn new(motion: &Motion, structure: &'s Structure) -> Self {
        let of = |effect: Effect| structure.of(motion.index(effect)?);
        let one = |effect, absent| of(effect).map_or(absent, |values| values[0]);
        let two = |effect| of(effect).map(|values| (values[0], values[1]));
        let wave = |effect| {
            of(effect).map(|values| Wave {
                amplitude: values[0],
                phase: values[1],
                rate: values.get(2).map_or(1.0, |periods| periods * motion.radians_per_period()),
            })
        };
        let base = motion.dynamics(&structure.base);
        let coulomb = one(Effect::Coulomb, 0.0);
        Self {
            k: base.k,
            b: base.b,
            b_open: base.b_open,
            loop_gain: base.loop_gain,
            pendulum: base.pendulum,
            pendulum_offset: motion.pendulum_offset(&structure.base),
            sign: if of(Effect::InputSign).is_some() { -1.0 } else { 1.0 },
            delay_s: one(Effect::InputDelay, 0.0),
            hold_s: one(Effect::InputHold, 0.0),
            dead_zone: one(Effect::DeadZone, 0.0),
            exponent: of(Effect::GainCurve).map(|values| values[0]),
            backward_gain: one(Effect::DirectionAsymmetry, 1.0),
            limit: one(Effect::Saturation, f64::INFINITY),
            rate: of(Effect::SlewLimit).map(|values| values[0]),
            lag_s: one(Effect::DriveLag, 0.0),
            sag: one(Effect::SupplySag, 0.0),
            heating: two(Effect::WindingHeating),
            coulomb: two(Effect::DirectionFriction).unwrap_or((coulomb, coulomb)),
            stribeck: two(Effect::Static),
            load_share: one(Effect::LoadFriction, 0.0),
            position_friction: wave(Effect::PositionFriction),
            warm_up: two(Effect::WarmUp),
            drag: one(Effect::Drag, 0.0),
            viscous: ((-one(Effect::DirectionViscous, 0.0)).max(0.0), one(Effect::DirectionViscous, 0.0).max(0.0)),
            load: one(Effect::ConstantLoad, 0.0),
            gravity: wave(Effect::Gravity),
            cogging: wave(Effect::Cogging),
            gap: one(Effect::Backlash, 0.0),
            compliance: two(Effect::Compliance),
            sensor_lag_s: one(Effect::SensorLag, 0.0),
            sensor_hold_s: one(Effect::SensorHold, 0.0),
            eccentricity: wave(Effect::Eccentricity),
            scale: one(Effect::EncoderScale, 1.0),
            offset: one(Effect::EncoderOffset, 0.0),
            curves: structure.curves().collect(),
            fine: false,
        }
        .finished()
    }

    fn finished(mut self) -> Self {
        self.fine = self.stribeck.is_some()
            || self.position_friction.is_some()
            || self.gravity.is_some()
            || self.cogging.is_some()
            || self.pendulum != 0.0
            || self.drag != 0.0
            || self.loop_gain != 0.0
            || self.load_share != 0.0
            || self.compliance.is_some()
            || self.curves.iter().any(|(curve, _)| curve.over != Dependence::Input);
        self
    }

    /// The command as it arrives at the motor, before lag and supply.
    fn shaped(&self, command: f64) -> f64 {
        let command = self.sign * command;
        let mut size = (command.abs() - self.dead_zone).max(0.0);
        if let Some(exponent) = self.exponent {
            size = size.powf(exponent);
        }
        let size = size.min(self.limit);
        if command < 0.0 { -size * self.backward_gain } else { size }
    }
}

#[derive(Clone, Copy, Default)]
struct State {
    position: f64,
    speed: f64,
    slewed: f64,
    lagged: f64,
    heat: f64,
    /// Behind the gap, with its speed.
    output: f64,
    output_speed: f64,
    /// Behind the spring, with its speed.
    sprung: (f64, f64),
    sensed: f64,
    /// What a sensor that holds last told, and when.
    held: f64,
    reversal: f64,
    direction: f64,
}

/// Simulates a run from an initial position and speed (or only a speed), one output for each sample.
pub(super) fn simulate(
    motion: &Motion,
    structure: &Structure,
    initial: &[f64],
    run: &MotionRun,
    predicted: &mut [f64],
    mut observed: Option<&mut Observed>,
) {
    let plan = Plan::new(motion, structure);
    let of_speed = motion.of_speed;
    let (position, speed) = match *initial {
        [speed] => (0.0, speed),
        [position, speed, ..] => ((position - plan.offset) / plan.scale, speed),
        [] => (0.0, 0.0),
    };
    let first = run.from;
    let command = plan.shaped(run.input_at(first));
    let mut state = State {
        position,
        speed,
        slewed: if plan.rate.is_some() { command } else { 0.0 },
        lagged: command * run.supply_at(first),
        heat: 0.0,
        output: position,
        output_speed: speed,
        sprung: (position, speed),
        sensed: if of_speed { speed } else { position },
        held: f64::NAN,
        reversal: position,
        direction: 0.0,
    };
    let longest_s = if plan.fine { motion.step_s } else { 2.0 * motion.step_s };
    let mut cursor = first;
    let mut decay = (f64::NAN, f64::NAN, 0.0);
    let mut hold_at = f64::NEG_INFINITY;
    for (place, sample) in (first..run.to).enumerate() {
        let now_s = run.all.time_s[sample];
        // What is told at this sample.
        let spring = plan.compliance.is_some();
        let true_position = if spring { state.sprung.0 } else { state.output };
        let truth = if of_speed {
            if spring { state.sprung.1 } else { state.output_speed }
        } else {
            true_position + plan.eccentricity.as_ref().map_or(0.0, |wave| wave.at(true_position))
        };
        if plan.sensor_lag_s <= 0.0 {
            state.sensed = truth;
        }
        if plan.sensor_hold_s > 0.0 {
            let slot = ((now_s + 1e-9) / plan.sensor_hold_s).floor();
            if slot > hold_at {
                hold_at = slot;
                state.held = state.sensed;
            }
        } else {
            state.held = state.sensed;
        }
        predicted[place] = if of_speed { state.held * plan.scale } else { state.held * plan.scale + plan.offset };
        let next = sample + 1;
        let dt_s = if next < run.to { run.all.time_s[next] - now_s } else { 0.0 };
        let steps = (dt_s / longest_s - 1e-6).ceil().clamp(1.0, 60.0);
        let step_s = dt_s / steps;
        let (speed_before, supply_v) = (state.speed, run.supply_at(sample));
        let enabled = run.enabled_at(sample);
        for step in 0..steps as usize {
            if step_s <= 0.0 {
                break;
            }
            let from_s = now_s + step as f64 * step_s;
            // The mean command over the step, as it was a delay ago.
            let command = if plan.hold_s > 0.0 {
                // The mean over the step, so that a little longer period makes a little difference.
                let (begin_s, end_s) = (from_s - plan.delay_s, from_s - plan.delay_s + step_s);
                let (first, last) = ((begin_s / plan.hold_s).floor(), (end_s / plan.hold_s).floor());
                let held = run.input_before(first * plan.hold_s, &mut cursor);
                if last > first {
                    let share = (end_s - last * plan.hold_s) / step_s;
                    held + share * (run.input_before(last * plan.hold_s, &mut cursor) - held)
                } else {
                    held
                }
            } else if plan.delay_s > 0.0 {
                run.mean_input(from_s - plan.delay_s, step_s, &mut cursor)
            } else {
                run.all.input[sample]
            };
            let command = if plan.loop_gain == 0.0 {
                command
            } else {
                let error = command - (state.held * plan.scale + plan.offset);
                (plan.loop_gain * run.gain_at(sample) * error).clamp(-motion.duty_limit, motion.duty_limit)
            };
            let mut acting = plan.shaped(command);
            if let Some(rate) = plan.rate {
                state.slewed += (acting - state.slewed).clamp(-rate * step_s, rate * step_s);
                acting = state.slewed;
            }
            let (mut k, mut b) = (plan.k, plan.b);
            if let Some((rise, _)) = plan.heating {
                let colder = 1.0 / (1.0 + rise * state.heat);
                k *= colder;
                b *= colder;
            }
            let mut volts = acting * supply_v;
            if plan.sag > 0.0 {
                // Of what the current through the source takes, by the share of its resistance in the motor's.
                let back_emf = state.speed * b / k;
                volts = back_emf + (volts - back_emf) / (1.0 + plan.sag * acting * acting);
            }
            if plan.lag_s > 0.0 {
                let share = -(-step_s / plan.lag_s).exp_m1();
                let mean = volts + (state.lagged - volts) * share * plan.lag_s / step_s;
                state.lagged += (volts - state.lagged) * share;
                volts = mean;
            }
            if let Some((_, time_constant_s)) = plan.heating {
                let power = (acting / motion.scales.input).powi(2);
                state.heat += (power - state.heat) * -(-step_s / time_constant_s).exp_m1();
            }
            if !enabled {
                (volts, b) = (0.0, plan.b_open);
            }
            // Half a step on, by the speed so far: what depends on position is taken there.
            let ahead = state.position + 0.5 * step_s * state.speed;
            let mut push = k * volts + plan.load;
            if plan.pendulum != 0.0 {
                push -= plan.pendulum * (ahead + plan.pendulum_offset).sin();
            }
            if let Some(gravity) = &plan.gravity {
                push -= gravity.at(ahead);
            }
            if let Some(cogging) = &plan.cogging {
                push -= cogging.at(ahead);
            }
            let mut more_friction = 0.0;
            for (curve, values) in &plan.curves {
                let at = match curve.over {
                    Dependence::Input => command,
                    Dependence::Speed => state.speed,
                    Dependence::Time => run.all.origin_s + from_s,
                    Dependence::Supply => supply_v,
                    Dependence::Direction => state.direction,
                    Dependence::History => (state.position - state.reversal).abs(),
                    _ => ahead,
                };
                let value = curve.value(values, at);
                match curve.acts {
                    Acts::Push => push += value,
                    Acts::Friction => more_friction += value,
                    Acts::Gain => push += k * volts * value,
                }
            }
            if plan.drag > 0.0 {
                b += plan.drag * state.speed.abs();
            }
            let direction = if state.speed == 0.0 { push.signum() } else { state.speed.signum() };
            b += if direction < 0.0 { plan.viscous.1 } else { plan.viscous.0 };
            let mut level = if direction < 0.0 { plan.coulomb.1 } else { plan.coulomb.0 };
            if let Some((force, stribeck)) = plan.stribeck {
                level += force * (-(state.speed / stribeck).powi(2)).exp();
            }
            if plan.load_share > 0.0 {
                level += plan.load_share * (k * volts - plan.b * state.speed).abs();
            }
            if let Some(wave) = &plan.position_friction {
                level += 0.5 * (wave.amplitude + wave.at(ahead));
            }
            if let Some((force, time_constant_s)) = plan.warm_up {
                level += force * (-(run.all.origin_s + from_s) / time_constant_s).exp();
            }
            level = (level + more_friction).max(0.0);
            if decay.0 != b || decay.1 != step_s {
                decay = (b, step_s, (-b * step_s).exp());
            }
            let before = state.position;
            advance(&mut state, push, level, b, step_s, decay.2);
            if let Some(stops) = motion.stops {
                let inside = state.position.clamp(stops.0, stops.1);
                if inside != state.position {
                    (state.position, state.speed) = (inside, 0.0);
                }
            }
            let moved = (state.position - before).signum();
            if state.position != before && moved != state.direction {
                state.direction = moved;
                state.reversal = before;
            }
            let gap = 0.5 * plan.gap;
            let output = state.output.clamp(state.position - gap, state.position + gap);
            state.output_speed = if plan.gap > 0.0 && output == state.output { 0.0 } else { state.speed };
            state.output = output;
            if let Some((natural_hz, damping)) = plan.compliance {
                let omega = TAU * natural_hz;
                let (position, speed) = &mut state.sprung;
                // Short enough for the spring.
                let parts = (omega * step_s / 0.3).ceil().clamp(1.0, 20.0);
                for _ in 0..parts as usize {
                    let pull =
                        omega * omega * (state.output - *position) + 2.0 * damping * omega * (state.speed - *speed);
                    *speed += pull * step_s / parts;
                    *position += *speed * step_s / parts;
                }
            }
            if plan.sensor_lag_s > 0.0 {
                let spring = plan.compliance.is_some();
                let truth = match (of_speed, spring) {
                    (true, true) => state.sprung.1,
                    (true, false) => state.output_speed,
                    (false, true) => state.sprung.0,
                    (false, false) => state.output,
                };
                let share = -(-step_s / plan.sensor_lag_s).exp_m1();
                state.sensed += (truth - state.sensed) * share;
            }
            if plan.loop_gain != 0.0 && plan.sensor_hold_s <= 0.0 {
                state.held = if plan.sensor_lag_s > 0.0 { state.sensed } else { state.output };
            }
        }
        if let Some(observed) = observed.as_deref_mut() {
            observed.input.push(run.all.input[sample]);
            observed.speed.push(speed_before);
            observed.position.push(state.position);
            observed.acceleration.push(if dt_s > 0.0 { (state.speed - speed_before) / dt_s } else { 0.0 });
            observed.direction.push(if speed_before == 0.0 { 0.0 } else { speed_before.signum() });
            observed.time_s.push(run.all.origin_s + now_s);
            observed.supply.push(supply_v);
            observed.history.push((state.position - state.reversal).abs());
        }
    }
}

/// One step under a constant push, level of friction and damping; `decayed` is `exp(-b step_s)`.
fn advance(state: &mut State, push: f64, level: f64, b: f64, step_s: f64, decayed: f64) {
    let mut left_s = step_s;
    let mut decayed = decayed;
    // Twice at most: towards zero, and away from it.
    for _ in 0..2 {
        let direction = if state.speed == 0.0 {
            if push.abs() <= level {
                return;
            }
            push.signum()
        } else {
            state.speed.signum()
        };
        let net = push - direction * level;
        let speed = if b * left_s > 1e-6 {
            net / b + (state.speed - net / b) * decayed
        } else {
            (state.speed + net * left_s) * (1.0 - b * left_s)
        };
        if speed * direction >= 0.0 || state.speed == 0.0 {
            state.position += distance(state.speed, speed, net, b, left_s);
            state.speed = speed;
            return;
        }
        // It comes to rest on the way.
        let stop_s = if b * left_s > 1e-6 { (1.0 - b * state.speed / net).ln() / b } else { -state.speed / net };
        let stop_s = if stop_s.is_finite() { stop_s.clamp(0.0, left_s) } else { left_s };
        state.position += distance(state.speed, 0.0, net, b, stop_s);
        state.speed = 0.0;
        left_s -= stop_s;
        if left_s <= 0.0 {
            return;
        }
        decayed = (-b * left_s).exp();
    }
}

/// Way made while the speed goes from `from` to `to` under a constant net push.
fn distance(from: f64, to: f64, net: f64, b: f64, time_s: f64) -> f64 {
    if b * time_s > 1e-4 { (net * time_s - (to - from)) / b } else { 0.5 * (from + to) * time_s }
}
