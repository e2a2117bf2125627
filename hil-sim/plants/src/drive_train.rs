//! A brushed motor, its transmission and the mass at its output: the core of both base models.
//!
//! ```text
//! L di/dt = u − R i − k v          k: force per ampere at the output = volts per unit of output speed
//! M dv/dt = k i − B v − friction + load
//!   dx/dt = v
//! ```
//!
//! The linear part is stepped exactly ([`crate::discretisation`]) under inputs held over the step. Friction, and the
//! diodes of an open bridge, are *dry*: at rest a force (voltage) of any magnitude up to a level, in motion a constant
//! level against the motion (current). Each is a constant input while its variable keeps its sign; where the speed
//! would change sign the step is cut, so a stop is a stop (speed 0.0 to the bit) and a reversal costs no time. There is
//! no smoothing and no chatter.
//!
//! # Accuracy
//! Exact to rounding for constant input, constant load and Coulomb friction while moving. Terms that depend on speed or
//! position are evaluated half-way through the step: second order. The instant of a stop is found by a secant: second
//! order. An impact on an end stop and a break-away take effect at a boundary of steps: first order, within
//! [`MAX_STEP_S`].

use crate::{
    discretisation::{FirstOrder, SecondOrder},
    effect::{direction::Direction, friction::Frictions},
    model::{DcGearMotor, LinearActuator, Model},
};

/// Longest step, s. Short against the changes of friction and load at the 1 kHz at which plants are controlled; the
/// electrical time constant needs no shorter one.
pub(crate) const MAX_STEP_S: f64 = 2.5e-4;
/// Number of shorter step lengths whose discretisation is cached. In `r4 demo --robot openscout` there are 589 490
/// discretisations with 8 and 448 310 with 32, which need four times the memory; 16 and 4 were not tried.
const PARTS: usize = 8;

/// Limit of `L/R`, s, below which the current follows the voltage at once: `i = (u − k v) / R`. It settles 250 times
/// within a step.
const QUASI_STATIC_S: f64 = 1e-6;

/// Forward voltage of the two body diodes in series, 0.7 V each, in the path of a current through an open bridge.
const DIODES_V: f64 = 1.4;

/// Largest number of cuts of one step: a stop, a reversal, and one more.
const MAX_CUTS: usize = 3;

/// Electrical side of a step: drive, supply and resistances.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Terminals {
    pub(crate) duty: f64,
    pub(crate) coast: f64,
    pub(crate) supply_v: f64,
    /// Resistance of the supply, in series with the motor while it is across it.
    pub(crate) source_ohm: f64,
    /// Relative rise of the winding's resistance above its cold value; 0 when cold.
    pub(crate) winding_rise: f64,
}

/// State of the motor side: current, speed, position.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Motion {
    pub(crate) current_a: f64,
    /// Speed of the motor side, in output units: rad/s or m/s.
    pub(crate) speed: f64,
    /// Position of the motor side, in output units: rad or m.
    pub(crate) position: f64,
    /// Mean acceleration over the last step, which extrapolates the speed to the middle of the next one.
    acceleration: f64,
}

/// Constants of a base model, referred to the output shaft or rod.
#[derive(Clone, Copy, Debug)]
struct Constants {
    resistance_ohm: f64,
    inductance_h: f64,
    force_per_ampere: f64,
    mass: f64,
    viscous: f64,
    /// Dry friction per unit of transmitted force: 1 - efficiency of a lead screw, 0 for a gear motor.
    loss: f64,
    /// Positions of the lower and upper end stop, m; `None` for a rotary output.
    stops: Option<[f64; 2]>,
}

impl From<&DcGearMotor> for Constants {
    fn from(motor: &DcGearMotor) -> Self {
        Self {
            resistance_ohm: motor.resistance_ohm,
            inductance_h: motor.inductance_h,
            force_per_ampere: motor.gear_ratio * motor.torque_constant_nm_per_a,
            mass: motor.inertia_kg_m2,
            viscous: motor.viscous_nm_s_per_rad,
            loss: 0.0,
            stops: None,
        }
    }
}

impl From<&LinearActuator> for Constants {
    fn from(actuator: &LinearActuator) -> Self {
        let motor_rad_per_m = std::f64::consts::TAU / actuator.lead_m_per_rev;
        Self {
            resistance_ohm: actuator.resistance_ohm,
            inductance_h: actuator.inductance_h,
            force_per_ampere: motor_rad_per_m * actuator.torque_constant_nm_per_a,
            mass: actuator.moving_mass_kg + actuator.rotor_inertia_kg_m2 * motor_rad_per_m * motor_rad_per_m,
            viscous: actuator.viscous_n_s_per_m,
            loss: 1.0 - actuator.efficiency,
            stops: Some([0.0, actuator.stroke_m]),
        }
    }
}

/// Discretised linear part for one step length and one resistance of the circuit.
#[derive(Clone, Copy, Debug, Default)]
struct Step {
    step_s: f64,
    circuit_ohm: f64,
    /// Current and speed coupled; not used in the quasi-static case.
    coupled: SecondOrder,
    /// Speed alone with the current settled; used in the quasi-static case only.
    settled: FirstOrder,
    /// Speed alone with the terminals open.
    open: FirstOrder,
    /// Share of the current that remains after the step at zero speed and voltage.
    current_kept: f64,
    /// The same after half of the step.
    current_kept_half_way: f64,
}

/// Electrical input over a step: the mean voltage, and the level of the diodes that opposes the current.
#[derive(Clone, Copy, Debug)]
struct Voltage {
    mean_v: f64,
    diodes_v: f64,
}

impl Constants {
    fn is_quasi_static(&self, circuit_ohm: f64) -> bool {
        self.inductance_h < QUASI_STATIC_S * circuit_ohm
    }

    fn step(&self, step_s: f64, circuit_ohm: f64) -> Step {
        let k = self.force_per_ampere;
        let (coupled, settled, current_kept) = if self.is_quasi_static(circuit_ohm) {
            let rate = (self.viscous + k * k / circuit_ohm) / self.mass;
            (SecondOrder::default(), FirstOrder::new(rate, step_s), [0.0; 2])
        } else {
            let inductance_h = self.inductance_h;
            let matrix = [[-circuit_ohm / inductance_h, -k / inductance_h], [k / self.mass, -self.viscous / self.mass]];
            let half_way = libm::exp(-0.5 * step_s * circuit_ohm / inductance_h);
            (SecondOrder::new(matrix, step_s), FirstOrder::default(), [half_way * half_way, half_way])
        };
        let open = FirstOrder::new(self.viscous / self.mass, step_s);
        let [current_kept, current_kept_half_way] = current_kept;
        Step { step_s, circuit_ohm, coupled, settled, open, current_kept, current_kept_half_way }
    }

    /// Sign of the current while the diodes conduct: its own sign or, from zero, that of a voltage which exceeds the
    /// diodes' level. 0 when the current stays zero.
    fn current_sign(&self, motion: &Motion, voltage: Voltage) -> f64 {
        if motion.current_a != 0.0 {
            return motion.current_a.signum();
        }
        let driving_v = voltage.mean_v - self.force_per_ampere * motion.speed;
        if driving_v.abs() <= voltage.diodes_v { 0.0 } else { driving_v.signum() }
    }

    /// Current after a step with the motor side at rest.
    fn current_at_rest(&self, step: &Step, motion: &Motion, voltage: Voltage) -> f64 {
        let sign = self.current_sign(motion, voltage);
        let settled_a = (voltage.mean_v - sign * voltage.diodes_v) / step.circuit_ohm;
        let current_a = settled_a + (motion.current_a - settled_a) * step.current_kept;
        if voltage.diodes_v > 0.0 && current_a * sign <= 0.0 { 0.0 } else { current_a }
    }

    /// Current in the middle of a step, from the speed extrapolated to there.
    fn current_half_way(&self, step: &Step, motion: &Motion, voltage: Voltage) -> f64 {
        let sign = self.current_sign(motion, voltage);
        if voltage.diodes_v > 0.0 && sign == 0.0 {
            return 0.0;
        }
        let speed = motion.speed + 0.5 * step.step_s * motion.acceleration;
        let settled_a = (voltage.mean_v - sign * voltage.diodes_v - self.force_per_ampere * speed) / step.circuit_ohm;
        settled_a + (motion.current_a - settled_a) * step.current_kept_half_way
    }

    /// Motion after a step under a constant force besides the motor's, without end stops.
    fn free(&self, step: &Step, motion: &Motion, voltage: Voltage, force: f64) -> Motion {
        let sign = self.current_sign(motion, voltage);
        if voltage.diodes_v > 0.0 && sign == 0.0 {
            return self.with_open_terminals(step, motion, force, 0.0);
        }
        let terminal_v = voltage.mean_v - sign * voltage.diodes_v;
        let next = if self.is_quasi_static(step.circuit_ohm) {
            self.with_settled_current(step, motion, terminal_v, force)
        } else {
            self.with_current(step, motion, terminal_v, force)
        };
        if voltage.diodes_v > 0.0 && next.current_a * sign < 0.0 {
            return self.with_open_terminals(step, motion, force, self.charge_until_open(step, motion, terminal_v));
        }
        next
    }

    fn with_current(&self, step: &Step, motion: &Motion, terminal_v: f64, force: f64) -> Motion {
        let SecondOrder { transition: e, integral: p, double_integral: q } = &step.coupled;
        let (i, v) = (motion.current_a, motion.speed);
        let (di, dv) = (terminal_v / self.inductance_h, force / self.mass);
        Motion {
            current_a: e[0][0] * i + e[0][1] * v + p[0][0] * di + p[0][1] * dv,
            speed: e[1][0] * i + e[1][1] * v + p[1][0] * di + p[1][1] * dv,
            position: motion.position + p[1][0] * i + p[1][1] * v + q[1][0] * di + q[1][1] * dv,
            acceleration: 0.0,
        }
    }

    fn with_settled_current(&self, step: &Step, motion: &Motion, terminal_v: f64, force: f64) -> Motion {
        let k = self.force_per_ampere;
        let next = first_order(&step.settled, motion, (k * terminal_v / step.circuit_ohm + force) / self.mass);
        Motion { current_a: (terminal_v - k * next.speed) / step.circuit_ohm, ..next }
    }

    /// Motion with open terminals. A `charge_as` that still flows at the start of the step acts as an impulse.
    fn with_open_terminals(&self, step: &Step, motion: &Motion, force: f64, charge_as: f64) -> Motion {
        let kicked = Motion { speed: motion.speed + self.force_per_ampere * charge_as / self.mass, ..*motion };
        Motion { current_a: 0.0, ..first_order(&step.open, &kicked, force / self.mass) }
    }

    /// Charge that flows until the diodes block, A s: from `i(t) = (i₀ + V/R) exp(−R t/L) − V/R` down to 0, with `V`
    /// the voltage against the current.
    fn charge_until_open(&self, step: &Step, motion: &Motion, terminal_v: f64) -> f64 {
        let sign = motion.current_a.signum();
        let against_v = sign * (self.force_per_ampere * motion.speed - terminal_v);
        let (i, r, l) = (motion.current_a.abs(), step.circuit_ohm, self.inductance_h);
        if against_v <= 0.0 || l <= 0.0 || i <= 0.0 {
            return 0.0;
        }
        let until_s = l / r * libm::log1p(r * i / against_v);
        sign * ((l * i - against_v * until_s) / r).max(0.0)
    }

    fn is_against_stop(&self, position: f64, direction: Direction) -> bool {
        self.stops.is_some_and(|[low, high]| match direction {
            Direction::Forward => position >= high,
            Direction::Backward => position <= low,
        })
    }

    /// Motion limited to the end stops. The impact is inelastic: a stop takes all speed.
    fn stopped(&self, motion: Motion) -> Motion {
        match self.stops {
            Some([low, _]) if motion.position < low => {
                Motion { position: low, speed: 0.0, acceleration: 0.0, ..motion }
            }
            Some([_, high]) if motion.position > high => {
                Motion { position: high, speed: 0.0, acceleration: 0.0, ..motion }
            }
            _ => motion,
        }
    }
}

fn first_order(step: &FirstOrder, motion: &Motion, acceleration: f64) -> Motion {
    Motion {
        speed: step.kept * motion.speed + step.integral * acceleration,
        position: motion.position + step.integral * motion.speed + step.double_integral * acceleration,
        ..*motion
    }
}

/// Cached discretisations of the full step and of the last shorter ones: most steps find theirs.
#[derive(Clone, Debug)]
struct Steps {
    full: Step,
    parts: [Step; PARTS],
    /// Index of the cached part that is replaced next.
    next_part: usize,
}

impl Steps {
    fn new() -> Self {
        Self { full: Step::default(), parts: [Step::default(); PARTS], next_part: 0 }
    }

    fn get(&mut self, constants: &Constants, step_s: f64, circuit_ohm: f64) -> &Step {
        let is_it = |step: &Step| step.step_s == step_s && step.circuit_ohm == circuit_ohm;
        if step_s == MAX_STEP_S {
            if !is_it(&self.full) {
                self.full = constants.step(step_s, circuit_ohm);
            }
            return &self.full;
        }
        let known = self.parts.iter().position(is_it);
        let place = known.unwrap_or_else(|| {
            let place = self.next_part;
            self.next_part = (place + 1) % PARTS;
            self.parts[place] = constants.step(step_s, circuit_ohm);
            place
        });
        &self.parts[place]
    }
}

/// A base model and its state.
#[derive(Clone, Debug)]
pub(crate) struct DriveTrain {
    constants: Constants,
    steps: Steps,
    pub(crate) motion: Motion,
}

impl DriveTrain {
    pub(crate) fn new(model: &Model) -> Self {
        let constants = match model {
            Model::DcGearMotor(motor) => motor.into(),
            Model::LinearActuator(actuator) => actuator.into(),
        };
        Self { constants, steps: Steps::new(), motion: Motion::default() }
    }

    /// Puts the motor side at rest, without current, at this position or the end stop before it.
    pub(crate) fn rest_at(&mut self, position: f64) {
        self.motion = self.constants.stopped(Motion { position, ..Motion::default() });
    }

    /// Position half-way through the step, extrapolated at the present speed (first order).
    pub(crate) fn position_half_way(&self, step_s: f64) -> f64 {
        self.motion.position + 0.5 * step_s * self.motion.speed
    }

    /// Speed half-way through the step, extrapolated at the last acceleration (first order); 0 where it would change
    /// sign.
    pub(crate) fn speed_half_way(&self, step_s: f64) -> f64 {
        let Motion { speed, acceleration, .. } = self.motion;
        let half_way = speed + 0.5 * step_s * acceleration;
        if half_way * speed > 0.0 { half_way } else { 0.0 }
    }

    /// Power lost in the winding, W.
    pub(crate) fn winding_power_w(&self, winding_rise: f64) -> f64 {
        self.motion.current_a * self.motion.current_a * self.constants.resistance_ohm * (1.0 + winding_rise)
    }

    /// Advances by one step of at most [`MAX_STEP_S`] under a constant load, positive towards positive positions.
    pub(crate) fn advance(&mut self, terminals: &Terminals, friction: &Frictions<'_>, load: f64, step_s: f64) {
        let mut left_s = step_s;
        for cut in 0..=MAX_CUTS {
            left_s -= self.advance_to_stop(terminals, friction, load, left_s, cut < MAX_CUTS);
            if left_s <= 0.0 {
                return;
            }
        }
    }

    /// Advances until the end of the step or, if the plant stops and the step may be cut, until the stop. Returns the
    /// time passed, s.
    fn advance_to_stop(
        &mut self,
        terminals: &Terminals,
        friction: &Frictions<'_>,
        load: f64,
        step_s: f64,
        may_cut: bool,
    ) -> f64 {
        let constants = &self.constants;
        let motion = self.motion;
        let winding_ohm = constants.resistance_ohm * (1.0 + terminals.winding_rise);
        let circuit_ohm = winding_ohm + terminals.duty * terminals.duty * terminals.source_ohm;
        let voltage = voltage(terminals, constants.force_per_ampere * motion.speed);
        let step = self.steps.get(constants, step_s, circuit_ohm);

        let direction = if motion.speed == 0.0 {
            let current_a = constants.current_at_rest(step, &motion, voltage);
            let motor_force = constants.force_per_ampere * current_a;
            let force = motor_force + load;
            let direction = Direction::of(force);
            let held =
                || friction.level(direction, 0.0, motion.position, motor_force) + constants.loss * motor_force.abs();
            if force == 0.0 || constants.is_against_stop(motion.position, direction) || force.abs() <= held() {
                self.motion = Motion { current_a, acceleration: 0.0, ..motion };
                return step_s;
            }
            direction
        } else {
            Direction::of(motion.speed)
        };

        let sign = direction.sign();
        let speed_half_way = (sign * (motion.speed + 0.5 * step_s * motion.acceleration)).max(0.0);
        let position_half_way = motion.position + 0.5 * step_s * motion.speed;
        let motor_force = constants.force_per_ampere * constants.current_half_way(step, &motion, voltage);
        let level = friction.level(direction, speed_half_way, position_half_way, motor_force)
            + constants.loss * motor_force.abs();
        let force = load - sign * level;
        let next = constants.free(step, &motion, voltage, force);

        let turns_around = next.speed * sign < 0.0;
        let sticks = || level > 0.0 || friction.level(direction.reverse(), 0.0, motion.position, motor_force) > 0.0;
        if turns_around && sticks() {
            if motion.speed == 0.0 {
                // enough force to break away only at the end of the step: it does in the next one
                let current_a = constants.current_at_rest(step, &motion, voltage);
                self.motion = Motion { current_a, acceleration: 0.0, ..motion };
                return step_s;
            }
            let stop_s = step_s * motion.speed.abs() / (motion.speed.abs() + next.speed.abs());
            if may_cut && stop_s < step_s {
                let step = self.steps.get(constants, stop_s, circuit_ohm);
                let at_stop = constants.free(step, &motion, voltage, force);
                self.motion = constants.stopped(Motion { speed: 0.0, acceleration: 0.0, ..at_stop });
                return stop_s;
            }
            self.motion = constants.stopped(Motion { speed: 0.0, acceleration: 0.0, ..next });
            return step_s;
        }
        let acceleration = (next.speed - motion.speed) / step_s;
        self.motion = constants.stopped(Motion { acceleration, ..next });
        step_s
    }
}

/// Mean voltage of the drive, and the level of the diodes. While coasting a current flows on through the body diodes
/// against the supply. The rail is taken to float up to the back-EMF rather than to brake the motor, so a plant without
/// supply coasts too.
fn voltage(terminals: &Terminals, back_emf_v: f64) -> Voltage {
    let diodes_v = if terminals.coast > 0.0 {
        terminals.coast * (terminals.supply_v.max(back_emf_v.abs()) + DIODES_V)
    } else {
        0.0
    };
    Voltage { mean_v: terminals.duty * terminals.supply_v, diodes_v }
}
