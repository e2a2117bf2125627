//! Free-run simulation of an axis: exact while it is linear, with events where friction stops or releases it.
//!
//! ```text
//! dv/dt = k · volts − b · v − friction + load        in rad/s² or m/s²: everything is per unit of inertia
//! ```
//!
//! Within a step, the command, the level of friction and the load are constant, and the rest is solved exactly up to
//! the time at which the speed passes zero; there the axis sticks unless the push exceeds friction.
//!
//! Three stages follow one another: the drive of the motor ([`Input`]), the motion ([`Mechanics`]) and its
//! measurement ([`Sensor`]). Nothing feeds back, except in a servo's loop and a sagging supply; so each stage is
//! computed for the whole run at once, and what several simulations have in common only once ([`simulate_each`]).

use std::{f64::consts::TAU, sync::Arc};

use crate::family::{Acts, Curve, Simulated, Structure, Term};
use r4_maths::spline::Spline;
use r4_plants::Dependence;

use super::{Kind, Motion, MotionRun, effect::Effect, smooth::Swinging, through};

/// Signals of a free-run simulation besides the output, one value per sample.
#[derive(Clone, Debug, Default)]
pub(super) struct Observed {
    pub(super) input: Vec<f64>,
    pub(super) speed: Vec<f64>,
    pub(super) position: Vec<f64>,
    pub(super) acceleration: Vec<f64>,
    pub(super) direction: Vec<f64>,
    pub(super) time_s: Vec<f64>,
    pub(super) supply: Vec<f64>,
    /// Distance from the last reversal, in the position's unit.
    pub(super) history: Vec<f64>,
}

/// Sine wave over the position.
#[derive(Clone, Copy, PartialEq)]
struct Wave {
    amplitude: f64,
    phase: f64,
    /// Spatial frequency, rad per unit of position.
    rate: f64,
}

impl Wave {
    fn at(&self, position: f64) -> f64 {
        self.amplitude * (self.rate * position + self.phase).sin()
    }
}

/// Value that depends on a step's length, cached while that stays the same.
#[derive(Clone, Copy)]
struct PerStep {
    step_s: f64,
    value: f64,
}

impl PerStep {
    const NONE: Self = Self { step_s: f64::NAN, value: 0.0 };

    fn get(&mut self, step_s: f64, value: impl FnOnce() -> f64) -> f64 {
        if self.step_s != step_s {
            *self = Self { step_s, value: value() };
        }
        self.value
    }
}

/// Product of damping and time below which the closed form of a displacement loses digits, and its series is more
/// accurate.
const STIFF: f64 = 1e-4;
/// Longest lateness of the stamps that is attributed to the current of a winding, s: inductance over resistance is 0.1
/// to 1 ms for the simulated plants. With none, shares of load-dependent friction are 0.3 to 0.8 % too large (tuning
/// plants 700118, 700154 and 700178 at a twentieth of the noise). Half of it was not compared.
const LONGEST_CURRENT_LAG_S: f64 = 2e-3;

/// Share of the way to its final value that a first-order response covers in a time.
// Not inlined, like everything that is rarely needed within a step: its divisor may be 0 there, and the compiler
// would hoist the division out of the loop and execute it anyway.
#[inline(never)]
fn first_order(time_s: f64, time_constant_s: f64) -> f64 {
    -(-time_s / time_constant_s).exp_m1()
}

/// Stage between the command and the motor.
#[derive(Clone, PartialEq)]
struct Input {
    sign: f64,
    /// Delay of the command, s; negative if the output's stamps are early.
    delay_s: f64,
    /// Growth of the delay, s/s.
    clock_drift: f64,
    hold_s: f64,
    /// Delay of the stamps from which a held command is sampled, s.
    sampled_late_s: f64,
    dead_zone: f64,
    exponent: Option<f64>,
    backward_gain: f64,
    limit: f64,
    rate: Option<f64>,
    lag_s: f64,
    sag: f64,
    /// Share of back-EMF in the damping, for a supply that sags.
    emf_share: f64,
    heating: Option<(f64, f64)>,
    /// Largest command, which heats the winding fully.
    largest: f64,
    /// Duty of a servo per rad of error and unit of gain, 1/rad.
    loop_gain: f64,
    duty_limit: f64,
    /// Known effects of the bridge.
    bridge: Arc<[r4_plants::Effect]>,
    /// True if friction or load change within a step's motion, which needs short steps.
    fine: bool,
}

/// Command over a step.
#[derive(Clone, Copy)]
struct Commanded {
    mean: f64,
    /// Values with weights that add up to 1, if the command changes within the step: a nonlinear bridge acts on the
    /// values, not on their mean.
    parts: Option<[(f64, f64); 3]>,
}

impl From<f64> for Commanded {
    fn from(mean: f64) -> Self {
        Self { mean, parts: None }
    }
}

/// Drive of the motor over a step.
#[derive(Clone, Copy)]
struct Driven {
    command: f64,
    volts: f64,
    /// Factor on the push and on the winding's share of damping, below 1 for a warm winding.
    colder: f64,
    enabled: bool,
}

#[derive(Clone, Copy)]
struct InputState {
    slewed: f64,
    lagged: f64,
    heat: f64,
    /// Index in the command of the last lookup.
    cursor: usize,
    /// Last command, and its value after the nonlinearities.
    shaped: (f64, f64),
    /// Last input of the bridge, and its output.
    bridged: (f64, f64),
    lag: PerStep,
    heating: PerStep,
}

impl Input {
    /// Returns the command after its nonlinearities, before lag and supply.
    fn shaped(&self, command: f64) -> f64 {
        let command = self.sign * command;
        let mut size = (command.abs() - self.dead_zone).max(0.0);
        if let Some(exponent) = self.exponent {
            size = size.powf(exponent);
        }
        let size = size.min(self.limit);
        if command < 0.0 { -size * self.backward_gain } else { size }
    }

    /// Returns the state at the begin of a run, as the commands before it left it.
    fn begin(&self, run: &MotionRun) -> InputState {
        // Only these stages depend on earlier commands; without them a part begins with its own.
        let remembers = self.rate.is_some() || self.lag_s > 0.0 || self.heating.is_some();
        let from = if remembers { 0 } else { run.from };
        // The recorded position stands for the one that a servo's loop used before the run.
        let mut told = run.all.measured.iter().skip(from).copied().find(|told| told.is_finite()).unwrap_or(0.0);
        let command = self.looped(run, from, run.input_at(from).into(), told).mean;
        let shaped = self.shaped(command);
        let mut state = InputState {
            slewed: if self.rate.is_some() { shaped } else { 0.0 },
            lagged: shaped,
            heat: 0.0,
            cursor: from,
            shaped: (command, shaped),
            bridged: (f64::NAN, 0.0),
            lag: PerStep::NONE,
            heating: PerStep::NONE,
        };
        for sample in from..run.from {
            let (steps, step_s) = run.all.steps[0][sample];
            let measured = run.all.measured[sample];
            told = if measured.is_finite() { measured } else { told };
            for step in 0..steps {
                let from_s = run.all.time_s[sample] + f64::from(step) * step_s;
                let command = self.command(run, sample, from_s, step_s, &mut state.cursor);
                let command = self.looped(run, sample, command, told);
                let of_sample = (run.supply_at(sample), run.enabled_at(sample));
                self.drive(&mut state, command, of_sample, step_s, 0.0);
            }
        }
        state
    }

    /// Returns the duty of a servo's loop for a goal and the measured position; the command itself without a loop.
    #[inline(always)]
    fn looped(&self, run: &MotionRun, sample: usize, command: Commanded, told: f64) -> Commanded {
        if self.loop_gain == 0.0 {
            return command;
        }
        let duty = self.loop_gain * run.gain_at(sample) * (command.mean - told);
        duty.clamp(-self.duty_limit, self.duty_limit).into()
    }

    /// Returns the command over a step, with its delay.
    #[inline(always)]
    fn command(&self, run: &MotionRun, sample: usize, from_s: f64, step_s: f64, cursor: &mut usize) -> Commanded {
        if self.hold_s > 0.0 || self.delay_s != 0.0 || self.clock_drift != 0.0 || run.all.command.is_straight() {
            self.delayed(run, from_s, step_s, cursor)
        } else {
            run.all.input[sample].into()
        }
    }

    #[inline(never)]
    fn delayed(&self, run: &MotionRun, from_s: f64, step_s: f64, cursor: &mut usize) -> Commanded {
        let begin_s = from_s - self.delay_s - self.clock_drift * from_s;
        if self.hold_s <= 0.0 {
            let mean = run.all.command.mean(begin_s, step_s, cursor);
            let mut at = |share: f64| run.all.command.at(begin_s + share * step_s, cursor);
            let (first, last) = (at(0.0), at(1.0));
            if first == last {
                return mean.into();
            }
            let parts = if run.all.command.is_straight() {
                // Simpson's rule, exact for a linear command through a smooth bridge.
                [(first, 1.0 / 6.0), (at(0.5), 4.0 / 6.0), (last, 1.0 / 6.0)]
            } else {
                // A held command changes once within a step, at the time that follows from its mean.
                let share = ((mean - first) / (last - first)).clamp(0.0, 1.0);
                [(first, 1.0 - share), (last, share), (0.0, 0.0)]
            };
            return Commanded { mean, parts: Some(parts) };
        }
        // The mean over the step makes the output continuous in the period.
        let begin_s = run.all.slots_s + begin_s;
        let stamp_s = self.sampled_late_s - run.all.slots_s;
        let end_s = begin_s + step_s;
        let (first, last) = ((begin_s / self.hold_s).floor(), (end_s / self.hold_s).floor());
        let held = run.all.command.at(first * self.hold_s + stamp_s, cursor);
        if last <= first {
            return held.into();
        }
        let share = (end_s - last * self.hold_s) / step_s;
        let next = run.all.command.at(last * self.hold_s + stamp_s, cursor);
        let parts = Some([(held, 1.0 - share), (next, share), (0.0, 0.0)]);
        Commanded { mean: held + share * (next - held), parts }
    }

    /// Computes the drive over one step. `back_emf` is the motor's own voltage, V, which only matters with a sagging
    /// supply.
    #[inline(always)]
    fn drive(
        &self,
        state: &mut InputState,
        Commanded { mean: command, parts }: Commanded,
        (supply_v, enabled): (f64, bool),
        step_s: f64,
        back_emf: f64,
    ) -> Driven {
        let over = |shape: &dyn Fn(f64) -> f64, parts: [(f64, f64); 3]| -> f64 {
            parts.into_iter().map(|(command, weight)| if weight == 0.0 { 0.0 } else { weight * shape(command) }).sum()
        };
        let mut acting = match parts {
            Some(parts) => over(&|command| self.shaped(command), parts),
            None => {
                if command != state.shaped.0 {
                    state.shaped = (command, self.shaped(command));
                }
                state.shaped.1
            }
        };
        if let Some(rate) = self.rate {
            let (from, gap, reach) = (state.slewed, acting - state.slewed, rate * step_s);
            // Mean over the step: half of the ramp, or the final value less the triangle before its corner.
            (state.slewed, acting) = if gap.abs() > reach {
                (from + reach.copysign(gap), from + 0.5 * reach.copysign(gap))
            } else {
                (acting, if gap == 0.0 { acting } else { acting - 0.5 * gap * gap.abs() / reach })
            };
        }
        if self.lag_s > 0.0 {
            let share = state.lag.get(step_s, || first_order(step_s, self.lag_s));
            let mean = acting + (state.lagged - acting) * share * self.lag_s / step_s;
            state.lagged += (acting - state.lagged) * share;
            acting = mean;
        }
        if !self.bridge.is_empty() {
            acting = match parts.filter(|_| self.rate.is_none() && self.lag_s <= 0.0) {
                Some(parts) => over(&|command| through(&self.bridge, self.shaped(command)), parts),
                None => {
                    if acting != state.bridged.0 {
                        state.bridged = (acting, through(&self.bridge, acting));
                    }
                    state.bridged.1
                }
            };
        }
        let colder = self.heating.map_or(1.0, |(rise, _)| 1.0 / (1.0 + rise * state.heat));
        let mut volts = acting * supply_v;
        if self.sag > 0.0 {
            // The current through the source lowers the voltage, by the ratio of its resistance to the motor's.
            volts = back_emf + (volts - back_emf) / (1.0 + self.sag * acting * acting);
        }
        if let Some((_, time_constant_s)) = self.heating {
            let power = (acting / self.largest).powi(2);
            state.heat += (power - state.heat) * state.heating.get(step_s, || first_order(step_s, time_constant_s));
        }
        Driven { command, volts: if enabled { volts } else { 0.0 }, colder, enabled }
    }

    /// Computes the drive over a whole run, without feedback.
    fn over(&self, run: &MotionRun) -> Vec<Driven> {
        let mut state = self.begin(run);
        let mut driven = Vec::with_capacity(if self.fine { 2 } else { 1 } * (run.to - run.from));
        for sample in run.from..run.to {
            let (steps, step_s) = run.steps(sample, self.fine);
            let of_sample = (run.supply_at(sample), run.enabled_at(sample));
            for step in 0..steps {
                let from_s = run.all.time_s[sample] + f64::from(step) * step_s;
                let command = self.command(run, sample, from_s, step_s, &mut state.cursor);
                driven.push(self.drive(&mut state, command, of_sample, step_s, 0.0));
            }
        }
        driven
    }
}

/// Stage of the moving mass.
#[derive(Clone, PartialEq)]
struct Mechanics<'s> {
    /// Acceleration per volt at rest.
    k: f64,
    b: f64,
    /// Damping with open terminals, 1/s.
    b_open: f64,
    /// Gravity of a known pendulum, per unit of inertia.
    pendulum: f64,
    /// Angle of the pendulum at position 0, rad.
    pendulum_offset: f64,
    coulomb: (f64, f64),
    stribeck: Option<(f64, f64)>,
    load_share: f64,
    /// Share of back-EMF in the damping, which loads a friction, and which a warm winding reduces.
    load_emf: f64,
    /// Time constant of the current that loads a friction, s. It shows as late stamps.
    current_lag_s: f64,
    heat_emf: f64,
    position_friction: Option<Wave>,
    warm_up: Option<(f64, f64)>,
    drag: f64,
    /// Additional damping forwards, and backwards.
    viscous: (f64, f64),
    load: f64,
    gravity: Option<Wave>,
    cogging: Option<Wave>,
    curves: Vec<(&'s Curve, Spline)>,
    stops: Option<(f64, f64)>,
    /// Duty beyond which no gain amplifies the input.
    full_duty: f64,
    position: f64,
    speed: f64,
    before: Before,
    /// Travel below which a first motion has no reversal, in the position's unit: its initial speed may be noise.
    least_travel: f64,
}

/// Returns the value of a curve's axis; `ahead` is the position at mid-step.
#[inline(always)]
fn place(curve: &Curve, body: &Body, driven: &Driven, (on_s, supply_v): (f64, f64), ahead: f64) -> f64 {
    match curve.over {
        Dependence::Input => driven.command,
        Dependence::Speed if curve.acts == Acts::Friction => body.speed.abs(),
        Dependence::Speed => body.speed,
        Dependence::Time => on_s,
        Dependence::Supply => supply_v,
        Dependence::Direction => body.direction,
        Dependence::History if curve.acts == Acts::Settling => on_s - body.turned_s,
        Dependence::History => (body.position - body.reversal).abs(),
        _ => ahead,
    }
}

/// Motion before a run: last direction, its travel and begin, and the hysteresis force at the reversal where it
/// began.
#[derive(Clone, Copy, PartialEq)]
struct Before {
    direction: f64,
    way: f64,
    turned_s: f64,
    wound: f64,
}

#[derive(Clone, Copy)]
struct Body {
    position: f64,
    speed: f64,
    reversal: f64,
    /// Time of the last reversal since power-up, s, like `on_s`.
    turned_s: f64,
    direction: f64,
    /// Hysteresis force at the last reversal.
    wound: f64,
    decay: Decay,
}

/// Values `exp(-b step_s)` and `1 / b`, cached while both stay the same.
#[derive(Clone, Copy)]
struct Decay {
    b: f64,
    step_s: f64,
    decayed: f64,
    per_b: f64,
}

impl Mechanics<'_> {
    fn begin(&self) -> Body {
        Body {
            position: self.position,
            speed: self.speed,
            reversal: self.position - self.before.way,
            turned_s: self.before.turned_s,
            direction: self.before.direction,
            wound: self.before.wound,
            decay: Decay { b: f64::NAN, step_s: f64::NAN, decayed: 0.0, per_b: 0.0 },
        }
    }

    /// Sets the motion before a run that is a part, from the recording before it.
    fn remember(&mut self, motion: &Motion, run: &MotionRun) {
        if !self.curves.iter().any(|(curve, _)| curve.over == Dependence::History) {
            return;
        }
        self.least_travel = motion.least_travel(run);
        if run.from == 0 {
            return;
        }
        let Some(moved) = motion.moved_before(run) else { return };
        let mut body = self.begin();
        for moved in moved {
            self.follow(&mut body, moved, 0.0);
        }
        self.before = Before {
            direction: body.direction,
            way: body.position - body.reversal,
            turned_s: run.all.origin_s + body.turned_s,
            wound: body.wound,
        };
    }

    /// Sets position and reversal of a body as they were measured, with an offset.
    fn follow(&self, body: &mut Body, moved: &Moved, offset: f64) {
        (body.position, body.turned_s) = (moved.position + offset, moved.turned_s);
        if (body.direction, body.reversal) != (moved.direction, moved.reversal + offset) {
            self.turn(body, moved.direction, moved.reversal + offset);
        }
    }

    /// Returns whether friction depends on the direction only, and the load is constant.
    fn is_plain(&self) -> bool {
        self.pendulum == 0.0
            && self.gravity.is_none()
            && self.cogging.is_none()
            && self.curves.is_empty()
            && self.drag <= 0.0
            && self.viscous == (0.0, 0.0)
            && self.stribeck.is_none()
            && self.load_share <= 0.0
            && self.position_friction.is_none()
            && self.warm_up.is_none()
    }

    /// Returns whether the motion is the same from any initial position.
    fn is_alike_everywhere(&self) -> bool {
        self.pendulum == 0.0
            && self.gravity.is_none()
            && self.cogging.is_none()
            && self.position_friction.is_none()
            && self.stops.is_none()
            && self.curves.iter().all(|(curve, _)| {
                matches!(
                    curve.over,
                    Dependence::Input
                        | Dependence::Speed
                        | Dependence::Time
                        | Dependence::Supply
                        | Dependence::Direction
                        | Dependence::History
                )
            })
    }

    /// Returns the hysteresis force at a position. The curves give it after a long travel in the other direction; a
    /// difference at the reversal fades as the curves approach their ends.
    fn hysteresis(&self, body: &Body, position: f64) -> f64 {
        let mut curves = self.curves.iter().filter(|(curve, _)| curve.acts == Acts::Hysteresis).peekable();
        if body.direction == 0.0 || curves.peek().is_none() {
            return 0.0;
        }
        let way = (position - body.reversal).abs();
        let [fresh, now, spent] = curves.fold([0.0; 3], |[fresh, now, spent], (_, curve)| {
            [fresh + curve.value(0.0), now + curve.value(way), spent + curve.value(f64::INFINITY)]
        });
        let left = if spent == fresh { 0.0 } else { ((spent - now) / (spent - fresh)).clamp(0.0, 1.0) };
        body.direction * (now + (body.direction * body.wound - fresh) * left)
    }

    /// Reverses the direction at a position.
    fn turn(&self, body: &mut Body, direction: f64, reversal: f64) {
        body.wound = self.hysteresis(body, reversal);
        (body.direction, body.reversal) = (direction, reversal);
    }

    /// Returns the motor's torque, per unit of inertia, in the middle of a step. The current follows the voltage and
    /// the back-EMF with a lag; the command's share of it is a delay of the stamps already.
    fn torque_half_way(&self, body: &Body, (driving, push, level, b): (f64, f64, f64, f64), step_s: f64) -> f64 {
        let rests = body.speed == 0.0;
        let direction = if rests { push.signum() } else { body.speed.signum() };
        let coulomb = if direction < 0.0 { self.coulomb.1 } else { self.coulomb.0 };
        let back_emf = self.load_emf * self.b;
        let torque = driving - back_emf * body.speed;
        let net = push - b * body.speed - direction * (level + coulomb + self.load_share * torque.abs());
        let acceleration = if rests && net * direction <= 0.0 { 0.0 } else { net };
        torque - back_emf * (0.5 * step_s - self.current_lag_s) * acceleration
    }

    /// Returns push, level of friction and damping over a step; `on_s` is the time since power-up at its begin.
    /// `PLAIN` omits what [`Self::is_plain`] excludes.
    #[inline(always)]
    fn forces<const PLAIN: bool>(
        &self,
        body: &Body,
        driven: &Driven,
        (on_s, supply_v, step_s): (f64, f64, f64),
    ) -> (f64, f64, f64) {
        let driving = self.k * driven.colder * driven.volts;
        let warmed = 1.0 - self.heat_emf * (1.0 - driven.colder);
        let mut b = if driven.enabled { self.b * warmed } else { self.b_open };
        let mut push = driving - self.load;
        let mut level = 0.0;
        if !PLAIN {
            let mut gain = 1.0;
            // What depends on position is evaluated half a step ahead, at the current speed.
            let ahead = body.position + 0.5 * step_s * body.speed;
            if self.pendulum != 0.0 {
                push -= self.pendulum * (ahead + self.pendulum_offset).sin();
            }
            if let Some(gravity) = &self.gravity {
                push -= gravity.at(ahead);
            }
            if let Some(cogging) = &self.cogging {
                push += cogging.at(ahead);
            }
            for (curve, spline) in &self.curves {
                let value = spline.value(place(curve, body, driven, (on_s, supply_v), ahead));
                match curve.acts {
                    Acts::Push => push += value,
                    Acts::Friction | Acts::Settling => level += value,
                    Acts::Gain => gain += value,
                    // All hysteresis curves act together, below.
                    Acts::Hysteresis => {}
                }
            }
            if gain != 1.0 {
                // A drive cannot exceed its limit.
                let most = (self.full_duty * supply_v).abs().max(driven.volts.abs());
                push += self.k * driven.colder * (gain * driven.volts).clamp(-most, most) - driving;
            }
            push -= self.hysteresis(body, body.position);
            if self.load_share > 0.0 {
                level += self.load_share * self.torque_half_way(body, (driving, push, level, b), step_s).abs();
            }
            if let Some(wave) = &self.position_friction {
                level += 0.5 * (wave.amplitude + wave.at(ahead));
            }
            if let Some((force, time_constant_s)) = self.warm_up {
                level += force * (-on_s / time_constant_s).exp();
            }
            if self.stribeck.is_some() || self.drag > 0.0 {
                let at = |speed: f64| {
                    let stribeck = self.stribeck.map_or(0.0, |(force, width)| force * (-(speed / width).powi(2)).exp());
                    (stribeck, b + self.drag * speed.abs())
                };
                // What depends on speed is evaluated at mid-step, by an Euler step that ends at rest at the latest.
                let coulomb = if body.speed < 0.0 { self.coulomb.1 } else { self.coulomb.0 };
                let (mut stribeck, mut damping) = at(body.speed);
                if step_s > 0.0 && body.speed != 0.0 {
                    let friction = (level + stribeck + coulomb).copysign(body.speed);
                    let middle = body.speed + 0.5 * step_s * (push - friction - damping * body.speed);
                    (stribeck, damping) = at(if body.speed * middle < 0.0 { 0.0 } else { middle });
                }
                level += stribeck;
                b = damping;
            }
        }
        let backward = if body.speed == 0.0 { push < 0.0 } else { body.speed < 0.0 };
        if !PLAIN {
            b += if backward { self.viscous.1 } else { self.viscous.0 };
        }
        (push, (level + if backward { self.coulomb.1 } else { self.coulomb.0 }).max(0.0), b)
    }
}

/// Advances several axes by one step in parallel, so that no arithmetic operation waits for another's result.
#[inline(always)]
fn step<const LANES: usize, const PLAIN: bool>(
    mechanics: &[&Mechanics<'_>; LANES],
    bodies: &mut [Body; LANES],
    driven: [&Driven; LANES],
    at @ (on_s, _, step_s): (f64, f64, f64),
) {
    let (mut push, mut level) = ([0.0; LANES], [0.0; LANES]);
    for lane in 0..LANES {
        let body = &mut bodies[lane];
        let b;
        (push[lane], level[lane], b) = mechanics[lane].forces::<PLAIN>(body, driven[lane], at);
        if body.decay.b != b || body.decay.step_s != step_s {
            body.decay = Decay { b, step_s, decayed: (-b * step_s).exp(), per_b: 1.0 / b };
        }
    }
    let before: [f64; LANES] = std::array::from_fn(|lane| bodies[lane].position);
    // Equals `advance` where no speed passes zero, but without a branch.
    let (mut position, mut speed, mut usual) = (before, [0.0; LANES], true);
    for lane in 0..LANES {
        let (body, push, level) = (&bodies[lane], push[lane], level[lane]);
        let rests = body.speed == 0.0;
        let direction = 1.0_f64.copysign(if rests { push } else { body.speed });
        let net = push - direction * level;
        let settled = net * body.decay.per_b;
        let next = settled + (body.speed - settled) * body.decay.decayed;
        let way = (net * step_s - (next - body.speed)) * body.decay.per_b;
        let holds = rests & (push.abs() <= level);
        usual &= (body.decay.b * step_s > STIFF) & (rests | (next * direction >= 0.0));
        speed[lane] = if holds { 0.0 } else { next };
        position[lane] += if holds { 0.0 } else { way };
    }
    for lane in 0..LANES {
        let body = &mut bodies[lane];
        if usual {
            (body.position, body.speed) = (position[lane], speed[lane]);
        } else {
            let (forward, backward) = mechanics[lane].coulomb;
            let goes_back = if body.speed == 0.0 { push[lane] < 0.0 } else { body.speed < 0.0 };
            // Level of friction after a reversal within the step.
            let other_way = level[lane] + if goes_back { forward - backward } else { backward - forward };
            advance(body, push[lane], [level[lane], other_way.max(0.0)]);
        }
        // End stops are inelastic: the speed is lost.
        if let Some(stops) = mechanics[lane].stops {
            let inside = body.position.clamp(stops.0, stops.1);
            if inside != body.position {
                (body.position, body.speed) = (inside, 0.0);
            }
        }
        if !PLAIN {
            let moved = (body.position - before[lane]).signum();
            if body.position != before[lane] && moved != body.direction {
                let travel = (before[lane] - body.reversal).abs();
                if body.turned_s.is_finite() || body.direction != 0.0 && travel >= mechanics[lane].least_travel {
                    body.turned_s = on_s;
                }
                mechanics[lane].turn(body, moved, before[lane]);
            }
        }
    }
}

/// Position and speed after each step.
type Way = Vec<(f64, f64)>;

/// Simulates the motion of axes, each under its own drive.
fn ways(run: &MotionRun, fine: bool, axes: &[(&Mechanics<'_>, &[Driven])]) -> Vec<Way> {
    // The axes of a group run the same code, so one with rarer forces slows them all.
    let plain = axes.iter().all(|(mechanics, _)| mechanics.is_plain());
    let side_by_side = |axes: &[(&Mechanics<'_>, &[Driven])]| match (axes, plain) {
        (&[a, b, c, d], true) => Vec::from(lanes::<4, true>(run, fine, [a, b, c, d])),
        (&[a, b, c, d], false) => Vec::from(lanes::<4, false>(run, fine, [a, b, c, d])),
        (&[a, b, c], true) => Vec::from(lanes::<3, true>(run, fine, [a, b, c])),
        (&[a, b, c], false) => Vec::from(lanes::<3, false>(run, fine, [a, b, c])),
        (&[a, b], true) => Vec::from(lanes::<2, true>(run, fine, [a, b])),
        (&[a, b], false) => Vec::from(lanes::<2, false>(run, fine, [a, b])),
        (&[a, ..], true) => Vec::from(lanes::<1, true>(run, fine, [a])),
        (&[a, ..], false) => Vec::from(lanes::<1, false>(run, fine, [a])),
        (&[], _) => Vec::new(),
    };
    axes.chunks(4).flat_map(side_by_side).collect()
}

fn lanes<const LANES: usize, const PLAIN: bool>(
    run: &MotionRun,
    fine: bool,
    axes: [(&Mechanics<'_>, &[Driven]); LANES],
) -> [Way; LANES] {
    let mechanics = axes.map(|(mechanics, _)| mechanics);
    let mut bodies = mechanics.map(Mechanics::begin);
    let mut ways = axes.map(|(_, driven)| Vec::with_capacity(driven.len()));
    let mut done = 0;
    for sample in run.from..run.to {
        let (steps, step_s) = run.steps(sample, fine);
        let (on_s, supply_v) = (run.all.origin_s + run.all.time_s[sample], run.supply_at(sample));
        for number in 0..steps {
            let driven = axes.map(|(_, driven)| &driven[done]);
            step::<LANES, PLAIN>(
                &mechanics,
                &mut bodies,
                driven,
                (on_s + f64::from(number) * step_s, supply_v, step_s),
            );
            for (way, body) in ways.iter_mut().zip(&bodies) {
                way.push((body.position, body.speed));
            }
            done += 1;
        }
    }
    ways
}

/// Stage between the motion and the recording.
#[derive(Clone, Copy)]
struct Sensor {
    of_speed: bool,
    gap: f64,
    compliance: Option<(f64, f64)>,
    /// Displacement and speed by which the mass behind the spring lags the output initially.
    stretched: (f64, f64),
    lag_s: f64,
    hold_s: f64,
    eccentricity: Option<Wave>,
    scale: f64,
    offset: f64,
}

/// Transition matrix of a spring with a damper over a step: displacement and speed relative to the output.
#[derive(Clone, Copy)]
struct Swing {
    step_s: f64,
    way: [f64; 2],
    speed: [f64; 2],
}

impl Swing {
    const NONE: Self = Self { step_s: f64::NAN, way: [0.0; 2], speed: [0.0; 2] };

    /// Computes the matrix exponential, exact for all frequencies and damping ratios.
    fn new((natural_hz, damping): (f64, f64), step_s: f64) -> Self {
        let omega = TAU * natural_hz;
        let rate = damping * omega;
        let square = (1.0 - damping * damping) * omega * omega * step_s * step_s;
        // cos x and sin(x)/x with x the root of `square`, or cosh x and sinh(x)/x if that is negative.
        let root = square.abs().sqrt();
        let decay = (-rate * step_s).exp();
        let (even, odd) = if square.abs() < 1e-6 {
            (decay * (1.0 - 0.5 * square), decay * (1.0 - square / 6.0))
        } else if square > 0.0 {
            (decay * root.cos(), decay * root.sin() / root)
        } else {
            // The decay is included in each exponential, which could overflow alone.
            let [grows, falls] = [root, -root].map(|root| 0.5 * (root - rate * step_s).exp());
            (grows + falls, (grows - falls) / root)
        };
        let odd_s = odd * step_s;
        Self { step_s, way: [even + rate * odd_s, odd_s], speed: [-omega * omega * odd_s, even - rate * odd_s] }
    }
}

#[derive(Clone, Copy)]
struct SensorState {
    /// Position and speed behind the gap.
    output: (f64, f64),
    /// Position and speed behind the spring.
    sprung: (f64, f64),
    sensed: f64,
    /// Last input of a sensor that lags.
    truth: f64,
    /// Last value of a sensor that holds, and the slot in which it was sampled.
    held: f64,
    slot: f64,
    lag: PerStep,
    swing: Swing,
}

impl Sensor {
    fn begin(&self, position: f64, speed: f64) -> SensorState {
        SensorState {
            output: (position, speed),
            sprung: (position - self.stretched.0, speed - self.stretched.1),
            sensed: if self.of_speed { speed } else { position },
            truth: if self.of_speed { speed } else { position },
            held: f64::NAN,
            slot: f64::NEG_INFINITY,
            lag: PerStep::NONE,
            swing: Swing::NONE,
        }
    }

    fn behind(&self, state: &SensorState) -> (f64, f64) {
        if self.compliance.is_some() { state.sprung } else { state.output }
    }

    /// Returns the sensor's value at a sample, `now_s` after the slots of a held value began.
    #[inline(always)]
    fn tell(&self, state: &mut SensorState, now_s: f64) -> f64 {
        if self.lag_s <= 0.0 {
            let (position, speed) = self.behind(state);
            state.sensed = if self.of_speed {
                speed
            } else {
                position + self.eccentricity.as_ref().map_or(0.0, |wave| wave.at(position))
            };
        }
        if self.hold_s > 0.0 {
            let slot = ((now_s + 1e-9) / self.hold_s).floor();
            if slot > state.slot {
                state.slot = slot;
                state.held = state.sensed;
            }
        } else {
            state.held = state.sensed;
        }
        if self.of_speed { state.held * self.scale } else { state.held * self.scale + self.offset }
    }

    /// Returns whether the sensor has no state between samples.
    fn is_at_once(&self) -> bool {
        self.gap <= 0.0 && self.compliance.is_none() && self.lag_s <= 0.0
    }

    #[inline(always)]
    fn step(&self, state: &mut SensorState, (position, speed): (f64, f64), step_s: f64) {
        let gap = 0.5 * self.gap;
        // `clamp` would panic if the simulation produced NaN.
        let before = state.output;
        let output = before.0.max(position - gap).min(position + gap);
        state.output = (output, if self.gap > 0.0 && output == before.0 { 0.0 } else { speed });
        if let Some(compliance) = self.compliance {
            swing(compliance, state, before, step_s);
        }
        if self.lag_s > 0.0 {
            let (position, speed) = self.behind(state);
            let truth = if self.of_speed { speed } else { position };
            // Exact for an input that is linear over the step.
            let share = state.lag.get(step_s, || first_order(step_s, self.lag_s));
            let way = truth - state.truth;
            state.sensed += (state.truth - state.sensed) * share + way * (1.0 - share * self.lag_s / step_s);
            state.truth = truth;
        }
    }

    /// Computes the sensor's values for a motion.
    fn over(&self, run: &MotionRun, first: (f64, f64), way: &[(f64, f64)], fine: bool, predicted: &mut [f64]) {
        let mut state = self.begin(first.0, first.1);
        let at_once = self.is_at_once();
        let mut done = 0;
        for (sample, told) in (run.from..run.to).zip(predicted) {
            *told = self.tell(&mut state, run.all.slots_s + run.all.time_s[sample]);
            let (steps, step_s) = run.steps(sample, fine);
            let next = done + steps as usize;
            if at_once {
                if let Some(&last) = way[done..next].last() {
                    state.output = last;
                }
            } else {
                for &moved in &way[done..next] {
                    self.step(&mut state, moved, step_s);
                }
            }
            done = next;
        }
    }
}

/// Advances the mass behind a spring and a damper by one step, exact for an output with constant acceleration.
#[inline(never)]
fn swing(compliance: (f64, f64), state: &mut SensorState, before: (f64, f64), step_s: f64) {
    if state.swing.step_s != step_s {
        state.swing = Swing::new(compliance, step_s);
    }
    let omega = TAU * compliance.0;
    let (position, speed) = state.output;
    // Acceleration from the speeds: at a jump, the difference of positions would differ from it.
    let acceleration = if step_s > 0.0 { (speed - before.1) / step_s } else { 0.0 };
    // Steady displacement behind an output with this acceleration.
    let behind = -acceleration / (omega * omega);
    let (way, rate) = (state.sprung.0 - before.0 - behind, state.sprung.1 - before.1);
    let Swing { way: [way_by_way, way_by_rate], speed: [rate_by_way, rate_by_rate], .. } = state.swing;
    state.sprung =
        (position + behind + way_by_way * way + way_by_rate * rate, speed + rate_by_way * way + rate_by_rate * rate);
}

/// Returns displacement and speed by which the mass behind a spring lags the output at the begin of a part, from the
/// measured acceleration. A part may begin within an oscillation; a whole recording begins at rest.
fn stretched((natural_hz, damping): (f64, f64), motion: &Motion, run: &MotionRun) -> Option<(f64, f64)> {
    /// Standard deviation of the weights, in periods of the oscillation: within three on each side, its drive hardly
    /// changes.
    const SHARE: f64 = 0.1;
    /// Smallest standard deviation in samples, and the number of standard deviations at which the weights end.
    const LEAST_SAMPLES: f64 = 1.5;
    const ENDS: f64 = 3.0;
    if run.from == 0 {
        return None;
    }
    let (time_s, measured) = (&run.all.time_s, &run.all.measured);
    let now_s = time_s[run.from];
    let width_s = (SHARE / natural_hz).max(LEAST_SAMPLES * motion.scales.period_s);
    let first = time_s.partition_point(|time_s| *time_s < now_s - ENDS * width_s);
    let last = time_s.partition_point(|time_s| *time_s <= now_s + ENDS * width_s);
    let omega = TAU * natural_hz;
    let swinging = Swinging::through(&time_s[first..last], &measured[first..last], now_s, (omega, width_s))?;
    let [slope, bend, third] = swinging.derivatives;
    let (acceleration, jerk) = if motion.of_speed { (slope, bend) } else { (bend, third) };
    // Exact for an oscillation at the natural frequency, the only transient that lasts into a part.
    let stiffness = omega * omega * (1.0 + 4.0 * damping * damping);
    let way = (acceleration - 2.0 * damping / omega * jerk) / stiffness;
    let speed = (jerk + 2.0 * damping * omega * acceleration) / stiffness;
    Some((way, speed)).filter(|(way, speed)| way.is_finite() && speed.is_finite())
}

/// Structure with its parameters in the form that the simulation uses.
struct Plan<'s> {
    input: Input,
    mechanics: Mechanics<'s>,
    sensor: Sensor,
}

impl<'s> Plan<'s> {
    fn new(motion: &Motion, structure: &'s Structure, initial: &[f64]) -> Self {
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
        // An axis is driven by the recorded force: all of its damping is viscous.
        let emf_share = |effect| match (motion.kind, of(effect)) {
            (Kind::Axis, _) => 0.0,
            (_, Some([.., viscous_share])) => 1.0 - viscous_share,
            _ => 1.0,
        };
        let coulomb = one(Effect::Coulomb, 0.0);
        let viscous = one(Effect::DirectionViscous, 0.0);
        let sensor = Sensor {
            of_speed: motion.of_speed,
            gap: one(Effect::Backlash, 0.0),
            compliance: two(Effect::Compliance),
            stretched: (0.0, 0.0),
            lag_s: one(Effect::SensorLag, 0.0),
            hold_s: one(Effect::SensorHold, 0.0),
            eccentricity: wave(Effect::Eccentricity),
            scale: one(Effect::EncoderScale, 1.0),
            offset: one(Effect::EncoderOffset, 0.0),
        };
        let (position, speed) = match *initial {
            [position, speed, ..] => ((position - sensor.offset) / sensor.scale, speed),
            _ => (0.0, 0.0),
        };
        let mechanics = Mechanics {
            k: base.k,
            b: base.b,
            b_open: base.b_open,
            pendulum: base.pendulum,
            pendulum_offset: motion.pendulum_offset(&structure.base),
            coulomb: two(Effect::DirectionFriction).unwrap_or((coulomb, coulomb)),
            stribeck: two(Effect::Static),
            load_share: one(Effect::LoadFriction, 0.0),
            load_emf: emf_share(Effect::LoadFriction),
            current_lag_s: motion.stamps_late_s(&structure.base).clamp(0.0, LONGEST_CURRENT_LAG_S),
            heat_emf: emf_share(Effect::WindingHeating),
            position_friction: wave(Effect::PositionFriction),
            warm_up: two(Effect::WarmUp),
            drag: one(Effect::Drag, 0.0),
            viscous: ((-viscous).max(0.0), viscous.max(0.0)),
            load: one(Effect::ConstantLoad, 0.0),
            gravity: wave(Effect::Gravity),
            cogging: wave(Effect::Cogging),
            curves: structure.curves().map(|(curve, values)| (curve, curve.spline(values))).collect(),
            stops: motion.stops,
            full_duty: motion.full_duty(),
            position,
            speed,
            before: Before { direction: 0.0, way: 0.0, turned_s: f64::NEG_INFINITY, wound: 0.0 },
            least_travel: 0.0,
        };
        let input = Input {
            sign: if of(Effect::InputSign).is_some() { -1.0 } else { 1.0 },
            // A delay that is fitted includes the delay of the stamps.
            delay_s: of(Effect::InputDelay).map_or_else(|| motion.stamps_late_s(&structure.base), |values| values[0]),
            clock_drift: one(Effect::ClockDrift, 0.0),
            hold_s: of(Effect::InputHold).and_then(|values| values.last()).copied().unwrap_or(0.0),
            sampled_late_s: match of(Effect::InputHold) {
                Some(&[late_s, _]) => late_s,
                _ => 0.0,
            },
            dead_zone: one(Effect::DeadZone, 0.0),
            exponent: of(Effect::GainCurve).map(|values| values[0]),
            backward_gain: one(Effect::DirectionAsymmetry, 1.0),
            limit: one(Effect::Saturation, f64::INFINITY),
            rate: of(Effect::SlewLimit).map(|values| values[0]),
            lag_s: one(Effect::DriveLag, 0.0),
            sag: one(Effect::SupplySag, 0.0),
            emf_share: emf_share(Effect::SupplySag),
            heating: two(Effect::WindingHeating),
            largest: through(&motion.bridge, motion.scales.input),
            bridge: motion.bridge.clone(),
            loop_gain: base.loop_gain,
            duty_limit: motion.duty_limit,
            fine: mechanics.stribeck.is_some()
                || mechanics.position_friction.is_some()
                || mechanics.gravity.is_some()
                || mechanics.cogging.is_some()
                || mechanics.pendulum != 0.0
                || mechanics.drag != 0.0
                || base.loop_gain != 0.0
                || mechanics.load_share != 0.0
                || sensor.compliance.is_some()
                || mechanics.curves.iter().any(|(curve, _)| curve.over != Dependence::Input),
        };
        Self { input, mechanics, sensor }
    }

    /// Creates the plan for a run, with the motion before it.
    fn of(motion: &Motion, structure: &'s Structure, initial: &[f64], run: &MotionRun) -> Self {
        let mut plan = Self::new(motion, structure, initial);
        if let Some(stretched) = plan.sensor.compliance.and_then(|compliance| stretched(compliance, motion, run)) {
            // The measured initial state is that of the mass behind the spring.
            plan.sensor.stretched = stretched;
            plan.mechanics.position += stretched.0;
            plan.mechanics.speed += stretched.1;
        }
        plan.mechanics.remember(motion, run);
        plan
    }

    /// Returns whether motion or measurement affects the drive.
    fn flows_back(&self) -> bool {
        self.input.loop_gain != 0.0 || self.input.sag > 0.0
    }

    /// Returns the offset of the prediction for another initial state, if that has no other effect.
    fn shift(&self, known: &Simulated<'_>, structure: &Structure, initial: &[f64]) -> Option<f64> {
        let ([from, speed], [to, same]) = (known.initial, initial) else { return None };
        let alike = speed == same
            && known.structure == structure
            && !self.flows_back()
            && self.sensor.eccentricity.is_none()
            && self.mechanics.is_alike_everywhere();
        alike.then_some(if self.sensor.of_speed { 0.0 } else { to - from })
    }

    /// Computes the sensor's values for a motion.
    fn tell(&self, run: &MotionRun, way: &[(f64, f64)], predicted: &mut [f64]) {
        let first = (self.mechanics.position, self.mechanics.speed);
        self.sensor.over(run, first, way, self.input.fine, predicted);
    }

    /// Simulates all three stages step by step, as feedback requires.
    fn simulate(&self, run: &MotionRun, predicted: &mut [f64], mut observed: Option<&mut Observed>) {
        let Self { input, mechanics, sensor } = self;
        let mut driving = input.begin(run);
        let mut body = mechanics.begin();
        let mut sensing = sensor.begin(body.position, body.speed);
        for (sample, told) in (run.from..run.to).zip(predicted) {
            let now_s = run.all.time_s[sample];
            *told = sensor.tell(&mut sensing, run.all.slots_s + now_s);
            let (steps, step_s) = run.steps(sample, input.fine);
            let (speed_before, supply_v) = (body.speed, run.supply_at(sample));
            let of_sample = (supply_v, run.enabled_at(sample));
            for number in 0..steps {
                let from_s = now_s + f64::from(number) * step_s;
                let command = input.command(run, sample, from_s, step_s, &mut driving.cursor);
                let command = input.looped(run, sample, command, sensing.held * sensor.scale + sensor.offset);
                let back_emf = body.speed * input.emf_share * mechanics.b / mechanics.k;
                let driven = input.drive(&mut driving, command, of_sample, step_s, back_emf);
                let at = (run.all.origin_s + from_s, supply_v, step_s);
                step::<1, false>(&[mechanics], std::array::from_mut(&mut body), [&driven], at);
                sensor.step(&mut sensing, (body.position, body.speed), step_s);
                // A servo's loop reads its sensor at each step, not only at the recorded samples.
                if input.loop_gain != 0.0 && sensor.hold_s <= 0.0 {
                    sensing.held = if sensor.lag_s > 0.0 { sensing.sensed } else { sensing.output.0 };
                }
            }
            if let Some(observed) = observed.as_deref_mut() {
                let dt_s = f64::from(steps) * step_s;
                observed.input.push(run.all.input[sample]);
                observed.speed.push(speed_before);
                observed.position.push(body.position);
                observed.acceleration.push(if dt_s > 0.0 { (body.speed - speed_before) / dt_s } else { 0.0 });
                observed.direction.push(if speed_before == 0.0 { 0.0 } else { speed_before.signum() });
                observed.time_s.push(run.all.origin_s + now_s);
                observed.supply.push(supply_v);
                observed.history.push((body.position - body.reversal).abs());
            }
        }
    }
}

/// Motion of an axis from a sample to the next.
#[derive(Clone, Copy, Debug)]
pub(super) struct Moved {
    pub(super) position: f64,
    pub(super) speed: f64,
    /// True if the speed does not differ significantly from zero.
    pub(super) rests: bool,
    pub(super) direction: f64,
    /// Position of the last reversal.
    pub(super) reversal: f64,
    /// Time of the last reversal, s of the recording.
    pub(super) turned_s: f64,
}

/// Returns whether the motion depends on the initial position.
pub(super) fn is_placed(motion: &Motion, structure: &Structure) -> bool {
    let plan = Plan::new(motion, structure, &[]);
    plan.sensor.eccentricity.is_some() || !plan.mechanics.is_alike_everywhere()
}

/// Returns a model's accelerations from each sample to the next, for a measured motion whose position is off by
/// `offset`.
pub(super) fn accelerations(
    motion: &Motion,
    structure: &Structure,
    run: &MotionRun,
    moved @ (steps, _): (&[Moved], f64),
) -> Vec<f64> {
    let plan = Plan::new(motion, structure, &[]);
    plan.accelerated(&plan.driven(run, steps), run, moved)
}

/// Computes the accelerations of models that differ little from a known one, each with its offset, and passes them to
/// `told` with their index. The common drive is computed once, and where one value of a curve differs, only the
/// accelerations near it.
pub(super) fn accelerations_each(
    motion: &Motion,
    (known, known_offset): (&Structure, f64),
    others: &[(&Structure, f64)],
    run: &MotionRun,
    steps: &[Moved],
    told: &mut dyn FnMut(usize, &[f64]),
) {
    let plan = Plan::new(motion, known, &[]);
    let driven = plan.driven(run, steps);
    let lookups = std::cell::LazyCell::new(|| plan.lookups(&driven, run, (steps, known_offset)));
    for (index, &(structure, offset)) in others.iter().enumerate() {
        let other = Plan::new(motion, structure, &[]);
        let is_shared = other.input == plan.input && !other.flows_back();
        if let Some(curve) = local_change(known, structure).filter(|_| is_shared && offset == known_offset) {
            told(index, &other.accelerated_near(&plan, curve, &lookups, &driven, run, (steps, offset)));
            continue;
        }
        let own = (!is_shared).then(|| other.driven(run, steps));
        told(index, &other.accelerated(own.as_ref().unwrap_or(&driven), run, (steps, offset)));
    }
}

/// Returns the index of the curve, among curves, whose values are the only difference between two structures of the
/// same terms, and whose values each act only near their knot. Hysteresis uses all of its curve.
fn local_change(known: &Structure, other: &Structure) -> Option<usize> {
    let mut changed = (0..known.added.len()).filter(|&term| known.added[term] != other.added[term]);
    let term = changed.next()?;
    let is_local = matches!(&known.terms[term], Term::Curve(curve) if curve.acts != Acts::Hysteresis);
    let alone = is_local && changed.next().is_none() && known.base == other.base;
    alone.then(|| known.terms[..term].iter().filter(|term| matches!(term, Term::Curve(_))).count())
}

/// Pieces of a model's curves that a recording passes, and its accelerations from each sample to the next.
struct Lookups {
    /// Index of the piece of each curve, from each sample to the next.
    pieces: Vec<Vec<usize>>,
    accelerations: Vec<f64>,
}

impl Plan<'_> {
    /// Computes the drive from each sample to the next, for a measured motion.
    fn driven(&self, run: &MotionRun, steps: &[Moved]) -> Vec<Driven> {
        let Self { input, mechanics, .. } = self;
        let mut state = input.begin(run);
        let mut driven = Vec::with_capacity(steps.len());
        for (sample, moved) in steps.iter().enumerate() {
            let (now_s, supply_v) = (run.all.time_s[sample], run.supply_at(sample));
            let step_s = run.all.time_s[sample + 1] - now_s;
            if step_s <= 0.0 {
                // Keeps the indexes aligned with the samples.
                driven.push(Driven { command: 0.0, volts: 0.0, colder: 1.0, enabled: true });
                continue;
            }
            let command = input.command(run, sample, now_s, step_s, &mut state.cursor);
            let command = input.looped(run, sample, command, moved.position);
            let back_emf = moved.speed * input.emf_share * mechanics.b / mechanics.k;
            driven.push(input.drive(&mut state, command, (supply_v, run.enabled_at(sample)), step_s, back_emf));
        }
        driven
    }

    /// Follows the motion from sample to sample. `visit` receives the sample, its motion, the body, and time (s) and
    /// supply (V).
    #[inline(always)]
    fn follow(
        &self,
        run: &MotionRun,
        (steps, offset): (&[Moved], f64),
        mut visit: impl FnMut(usize, &Moved, &Body, (f64, f64)),
    ) {
        let mut body = self.mechanics.begin();
        for (sample, moved) in steps.iter().enumerate() {
            let now_s = run.all.time_s[sample];
            let step_s = run.all.time_s[sample + 1] - now_s;
            if step_s <= 0.0 {
                continue;
            }
            body.speed = if moved.rests { 0.0 } else { moved.speed };
            self.mechanics.follow(&mut body, moved, offset);
            body.turned_s += run.all.origin_s;
            visit(sample, moved, &body, (run.all.origin_s + now_s + 0.5 * step_s, run.supply_at(sample)));
        }
    }

    #[inline(always)]
    fn acceleration<const PLAIN: bool>(
        &self,
        moved: &Moved,
        body: &Body,
        driven: &Driven,
        (on_s, supply_v): (f64, f64),
    ) -> f64 {
        let (push, level, b) = self.mechanics.forces::<PLAIN>(body, driven, (on_s, supply_v, 0.0));
        let friction = if moved.rests { push.max(-level).min(level) } else { level.copysign(moved.speed) };
        push - friction - b * moved.speed
    }

    /// Computes the accelerations from each sample to the next under a drive.
    fn accelerated(&self, driven: &[Driven], run: &MotionRun, moved: (&[Moved], f64)) -> Vec<f64> {
        let mut accelerations = vec![0.0; moved.0.len()];
        if self.mechanics.is_plain() {
            self.follow(run, moved, |sample, moved, body, at| {
                accelerations[sample] = self.acceleration::<true>(moved, body, &driven[sample], at);
            });
        } else {
            self.follow(run, moved, |sample, moved, body, at| {
                accelerations[sample] = self.acceleration::<false>(moved, body, &driven[sample], at);
            });
        }
        accelerations
    }

    fn lookups(&self, driven: &[Driven], run: &MotionRun, moved: (&[Moved], f64)) -> Lookups {
        let mut pieces = vec![vec![0; moved.0.len()]; self.mechanics.curves.len()];
        self.follow(run, moved, |sample, _, body, at| {
            for (pieces, (curve, spline)) in pieces.iter_mut().zip(&self.mechanics.curves) {
                pieces[sample] = spline.piece_at(place(curve, body, &driven[sample], at, body.position));
            }
        });
        Lookups { pieces, accelerations: self.accelerated(driven, run, moved) }
    }

    /// Like [`Self::accelerated`], for a model that differs from a known one in values of one curve.
    fn accelerated_near(
        &self,
        known: &Self,
        curve: usize,
        lookups: &Lookups,
        driven: &[Driven],
        run: &MotionRun,
        moved: (&[Moved], f64),
    ) -> Vec<f64> {
        let [own, others] = [self, known].map(|plan| &plan.mechanics.curves[curve].1);
        let unlike: Vec<bool> = own.pieces_unlike(others).collect();
        let mut accelerations = lookups.accelerations.clone();
        self.follow(run, moved, |sample, moved, body, at| {
            if unlike[lookups.pieces[curve][sample]] {
                accelerations[sample] = self.acceleration::<false>(moved, body, &driven[sample], at);
            }
        });
        accelerations
    }
}

/// Simulates a run from an initial position and speed, one output per sample.
pub(super) fn simulate(
    motion: &Motion,
    structure: &Structure,
    initial: &[f64],
    run: &MotionRun,
    predicted: &mut [f64],
    observed: Option<&mut Observed>,
) {
    let plan = Plan::of(motion, structure, initial, run);
    if plan.flows_back() || observed.is_some() {
        plan.simulate(run, predicted, observed);
    } else {
        let driven = plan.input.over(run);
        plan.tell(run, &ways(run, plan.input.fine, &[(&plan.mechanics, &driven)])[0], predicted);
    }
}

/// Returns the difference between the sensor's value and the motion in a model's free run, one value per sample, in the output's unit:
/// backlash, compliance, lag and hold, without the eccentricity.
pub(super) fn sensed(motion: &Motion, structure: &Structure, initial: &[f64], run: &MotionRun) -> Vec<f64> {
    let mut plan = Plan::of(motion, structure, initial, run);
    plan.sensor.eccentricity = None;
    let mut observed = Observed::default();
    let mut told = vec![0.0; run.to - run.from];
    plan.simulate(run, &mut told, Some(&mut observed));
    let moving: Vec<f64> = if motion.of_speed {
        observed.speed
    } else {
        // What is observed is the position at the end of a sample's step.
        std::iter::once(plan.mechanics.position).chain(observed.position).collect()
    };
    told.iter().zip(moving).map(|(told, moving)| told - moving).collect()
}

/// Free runs over one recording that differ little from one that is known: what they have in common is done once, and what
/// moves is simulated side by side.
pub(super) fn simulate_each(
    motion: &Motion,
    known: &Simulated<'_>,
    others: &[(&Structure, &[f64])],
    run: &MotionRun,
    told: &mut dyn FnMut(usize, &[f64]),
) {
    let plan = Plan::of(motion, known.structure, known.initial, run);
    let mut predicted = vec![0.0; known.predicted.len()];
    let mut left: Vec<(usize, Plan<'_>)> = Vec::new();
    for (index, &(structure, initial)) in others.iter().enumerate() {
        if let Some(shift) = plan.shift(known, structure, initial) {
            predicted.iter_mut().zip(known.predicted).for_each(|(predicted, known)| *predicted = known + shift);
            told(index, &predicted);
            continue;
        }
        let other = Plan::of(motion, structure, initial, run);
        if other.flows_back() {
            other.simulate(run, &mut predicted, None);
            told(index, &predicted);
        } else {
            left.push((index, other));
        }
    }
    // Grouped by the first stage that differs, so that the stages before it are computed once.
    let (driven_alike, driven_apart): (Vec<_>, Vec<_>) =
        left.into_iter().partition(|(_, other)| other.input == plan.input);
    let (moving_alike, moving_apart): (Vec<_>, Vec<_>) =
        driven_alike.into_iter().partition(|(_, other)| other.mechanics == plan.mechanics);
    if !moving_alike.is_empty() || !moving_apart.is_empty() {
        let driven = plan.input.over(run);
        let fine = plan.input.fine;
        if !moving_alike.is_empty() {
            let way = &ways(run, fine, &[(&plan.mechanics, &driven)])[0];
            for (index, other) in &moving_alike {
                other.tell(run, way, &mut predicted);
                told(*index, &predicted);
            }
        }
        let axes: Vec<_> = moving_apart.iter().map(|(_, other)| (&other.mechanics, &driven[..])).collect();
        for ((index, other), way) in moving_apart.iter().zip(ways(run, fine, &axes)) {
            other.tell(run, &way, &mut predicted);
            told(*index, &predicted);
        }
    }
    for fine in [false, true] {
        // Axes that run side by side need steps of the same length.
        let apart: Vec<_> = driven_apart.iter().filter(|(_, other)| other.input.fine == fine).collect();
        for apart in apart.chunks(4) {
            let driven: Vec<_> = apart.iter().map(|(_, other)| other.input.over(run)).collect();
            let axes: Vec<_> =
                apart.iter().zip(&driven).map(|((_, other), driven)| (&other.mechanics, &driven[..])).collect();
            for ((index, other), way) in apart.iter().zip(ways(run, fine, &axes)) {
                other.tell(run, &way, &mut predicted);
                told(*index, &predicted);
            }
        }
    }
}

/// Advances a body by the step of its decay, under a constant push and Coulomb friction of the first level; after a
/// reversal, of the second, for the other direction.
#[inline(always)]
fn advance(body: &mut Body, push: f64, [mut level, other_way]: [f64; 2]) {
    let Decay { b, step_s: mut left_s, mut decayed, per_b } = body.decay;
    // At most twice: towards zero speed, and away from it.
    for _ in 0..2 {
        let direction = if body.speed == 0.0 {
            if push.abs() <= level {
                return;
            }
            push.signum()
        } else {
            body.speed.signum()
        };
        let net = push - direction * level;
        let speed = if b * left_s > 1e-6 {
            let settled = net * per_b;
            settled + (body.speed - settled) * decayed
        } else {
            (body.speed + net * left_s) * (1.0 - b * left_s)
        };
        if speed * direction >= 0.0 || body.speed == 0.0 {
            body.position += distance(body.speed, speed, net, (b, per_b), left_s);
            body.speed = speed;
            return;
        }
        // It comes to rest within the step.
        let stop_s = if b * left_s > 1e-6 { (1.0 - b * body.speed / net).ln() * per_b } else { -body.speed / net };
        let stop_s = if stop_s.is_finite() { stop_s.clamp(0.0, left_s) } else { left_s };
        body.position += distance(body.speed, 0.0, net, (b, per_b), stop_s);
        body.speed = 0.0;
        if push * direction < 0.0 {
            level = other_way;
        }
        left_s -= stop_s;
        if left_s <= 0.0 {
            return;
        }
        decayed = (-b * left_s).exp();
    }
}

/// Returns the displacement while the speed changes from `from` to `to` under a constant net push; `per_b` is `1 /
/// b`.
#[inline(always)]
fn distance(from: f64, to: f64, net: f64, (b, per_b): (f64, f64), time_s: f64) -> f64 {
    if b * time_s > STIFF { (net * time_s - (to - from)) * per_b } else { 0.5 * (from + to) * time_s }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// It comes to rest after 1/11 s under 10 and a friction of 1; then a push of 10 and a friction of 3 act, the
    /// other way.
    #[test]
    fn what_turns_within_a_step_has_the_friction_of_the_other_way() {
        let step_s = 0.1;
        for (speed, push) in [(1.0, -10.0), (-1.0, 10.0)] {
            let b = 1e-9;
            let decay = Decay { b, step_s, decayed: (-b * step_s).exp(), per_b: 1.0 / b };
            let turned_s = f64::NEG_INFINITY;
            let mut body = Body { position: 0.0, speed, reversal: 0.0, turned_s, direction: speed, wound: 0.0, decay };
            advance(&mut body, push, [1.0, 3.0]);
            let expected = 0.7 * push * (step_s - 1.0 / 11.0);
            assert!((body.speed - expected).abs() < 1e-6, "{} {expected}", body.speed);
        }
    }

    proptest! {
        /// Comparison with a thousand short steps of the equation of motion, for an output with constant
        /// acceleration.
        #[test]
        fn a_spring_and_a_damper_are_exact(
            natural_hz in 0.1..60.0_f64,
            damping in 0.0..3.0_f64,
            [speed, acceleration] in [-5.0..5.0_f64, -50.0..50.0_f64],
        ) {
            let sensor = Sensor {
                of_speed: false,
                gap: 0.0,
                compliance: Some((natural_hz, damping)),
                stretched: (0.0, 0.0),
                lag_s: 0.0,
                hold_s: 0.0,
                eccentricity: None,
                scale: 1.0,
                offset: 0.0,
            };
            const STEP_S: f64 = 2.5e-3;
            let mut state = sensor.begin(0.0, speed);
            let (omega, mut now) = (TAU * natural_hz, (0.0, speed));
            for step in 1..=20 {
                let end_s = f64::from(step) * STEP_S;
                sensor.step(&mut state, (end_s * (speed + 0.5 * acceleration * end_s), speed + acceleration * end_s), STEP_S);
                for part in 0..1000 {
                    // Midpoint rule in a thousand steps.
                    let short_s = STEP_S / 1000.0;
                    let from_s = end_s - STEP_S + f64::from(part) * short_s;
                    let slope = |(way, rate): (f64, f64), at_s: f64| {
                        let output = (at_s * (speed + 0.5 * acceleration * at_s), speed + acceleration * at_s);
                        (rate, omega * omega * (output.0 - way) + 2.0 * damping * omega * (output.1 - rate))
                    };
                    let first = slope(now, from_s);
                    let half = (now.0 + 0.5 * short_s * first.0, now.1 + 0.5 * short_s * first.1);
                    let middle = slope(half, from_s + 0.5 * short_s);
                    now = (now.0 + short_s * middle.0, now.1 + short_s * middle.1);
                }
            }
            // The rule's own error is (2 zeta omega h)²/6 of the change, at most 1e-6 of the displacement of 0.3.
            prop_assert!((state.sprung.0 - now.0).abs() < 1e-6, "{} {}", state.sprung.0, now.0);
        }

        #[test]
        fn a_sensor_that_lags_is_exact_on_a_ramp(lag_s in 1e-3..1.0_f64, speed in -5.0..5.0_f64) {
            let sensor = Sensor {
                of_speed: false,
                gap: 0.0,
                compliance: None,
                stretched: (0.0, 0.0),
                lag_s,
                hold_s: 0.0,
                eccentricity: None,
                scale: 1.0,
                offset: 0.0,
            };
            let mut state = sensor.begin(0.0, speed);
            for step in 1..=40 {
                sensor.step(&mut state, (speed * f64::from(step) * 5e-3, speed), 5e-3);
            }
            let end_s = 40.0 * 5e-3;
            let expected = speed * (end_s + lag_s * (-end_s / lag_s).exp_m1());
            prop_assert!((state.sensed - expected).abs() < 1e-12, "{} {expected}", state.sensed);
        }
    }
}
