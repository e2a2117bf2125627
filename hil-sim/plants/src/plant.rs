//! A plant: a base model with its effects and their state, stepped in time.

use crate::{
    drive::Drive,
    drive_train::{DriveTrain, MAX_STEP_S, Terminals},
    effect::{
        Effect,
        delay::DelayLine,
        friction::{FrictionStage, Frictions},
        input::InputStage,
        load::LoadStage,
        sensor::SensorStage,
        supply::Heat,
        table::{On, Over, SpeedForce, Table},
        transmission::TransmissionStage,
        unlisted::{Doing, Moment, Unlisted, act},
    },
    kind::PlantKind,
    spec::PlantSpec,
};

/// A base model and its effects, with their state.
///
/// Positions, speeds and forces are at the output shaft or rod: rad, rad/s and N m, or m, m/s and N.
#[derive(Clone, Debug)]
pub struct Plant {
    kind: PlantKind,
    train: DriveTrain,
    now_s: f64,
    delay: Option<DelayLine>,
    input: Vec<InputStage>,
    /// True when the acting drive may change while the commanded one does not: delays, ramps, holds, tables, unlisted
    /// effects.
    input_has_memory: bool,
    tables: Tables,
    pushes: Vec<SpeedForce>,
    /// Position and time of the motor side's last reversal, and its last nonzero speed, whose sign is the direction
    /// since then.
    turned_at: f64,
    turned_s: f64,
    went: f64,
    /// Hysteresis force at the last reversal, N m or N.
    wound: f64,
    unlisted: Vec<Box<dyn Unlisted>>,
    source_ohm: f64,
    heats: Vec<Heat>,
    friction: Vec<FrictionStage>,
    loads: Vec<LoadStage>,
    /// Load from outside, set by [`Plant::set_load`], N m or N.
    outside: f64,
    transmission: Vec<TransmissionStage>,
    sensor: Vec<SensorStage>,
    sensor_has_memory: bool,
    /// Duty at the output of the delays, before the other input effects.
    arrived: f64,
    acting: Drive,
    /// Contribution of the unlisted effects to this step.
    done: Doing,
    position: f64,
    speed: f64,
    sensed_position: f64,
}

/// Time of the last reversal of a plant that never reversed, s: so long ago that it is beyond every knot of a table.
const NEVER_S: f64 = -1e12;

/// Effects without a name, by the quantity they act on; forces over speed are [`SpeedForce`]s instead.
#[derive(Clone, Debug, Default)]
struct Tables {
    force: Vec<Table>,
    friction: Vec<Table>,
    gain: Vec<Table>,
    input: Vec<Table>,
    /// Hysteresis tables that [wind](winds), and the others.
    hysteresis: Vec<Table>,
    against: Vec<Table>,
}

impl Tables {
    fn new(spec: &PlantSpec) -> Self {
        let mut tables = Self::default();
        for table in spec.tables().iter().filter(|table| !is_speed_force(table)) {
            let place = match table.on() {
                On::Force => &mut tables.force,
                On::Friction => &mut tables.friction,
                On::Gain => &mut tables.gain,
                On::Input => &mut tables.input,
                On::Hysteresis if winds(table) => &mut tables.hysteresis,
                On::Hysteresis => &mut tables.against,
            };
            place.push(table.clone());
        }
        tables
    }
}

/// True for a hysteresis over travel without a period, whose force settles with the travel since the reversal.
fn winds(table: &Table) -> bool {
    table.over() == Over::History && table.period().is_none()
}

fn is_speed_force(table: &Table) -> bool {
    table.on() == On::Force && table.over() == Over::Speed
}

/// Shortest step, s; the rounding errors of longer ones add up to this.
const SHORTEST_STEP_S: f64 = 1e-12;

impl Plant {
    /// A plant at rest at position 0, without current; its noises start from `seed`.
    #[must_use]
    pub fn new(spec: &PlantSpec, seed: u64) -> Self {
        Self::with_unlisted(spec, seed, Vec::new())
    }

    /// As [`Plant::new`], with effects that a description cannot hold.
    #[must_use]
    pub fn with_unlisted(spec: &PlantSpec, seed: u64, unlisted: Vec<Box<dyn Unlisted>>) -> Self {
        let kind = spec.kind();
        let effects = || spec.effects().iter();
        let numbered = || effects().enumerate();
        let delay = DelayLine::of(effects());
        let input: Vec<_> = effects().filter_map(InputStage::new).collect();
        let sensor: Vec<_> = numbered().filter_map(|(stream, effect)| SensorStage::new(effect, seed, stream)).collect();
        let tables = Tables::new(spec);
        let pushes: Vec<_> = spec.tables().iter().filter(|table| is_speed_force(table)).map(SpeedForce::new).collect();
        let mut plant = Self {
            kind,
            train: DriveTrain::new(spec.model()),
            now_s: 0.0,
            input_has_memory: delay.is_some()
                || input.iter().any(InputStage::has_memory)
                || tables.input.iter().any(|table| table.over() != Over::Input)
                || !unlisted.is_empty(),
            delay,
            input,
            tables,
            turned_at: 0.0,
            turned_s: NEVER_S,
            wound: 0.0,
            went: 0.0,
            arrived: 0.0,
            unlisted,
            done: Doing { duty: 0.0, friction: 0.0, force: 0.0 },
            source_ohm: effects()
                .map(|effect| if let Effect::SupplySag(sag) = effect { sag.source_ohm } else { 0.0 })
                .sum(),
            heats: effects()
                .filter_map(
                    |effect| if let Effect::WindingHeating(heating) = effect { Some(Heat::new(heating)) } else { None },
                )
                .collect(),
            friction: effects()
                .filter_map(|effect| FrictionStage::new(effect, kind))
                .chain(pushes.iter().cloned().map(FrictionStage::Table))
                .collect(),
            pushes,
            loads: numbered().filter_map(|(stream, effect)| LoadStage::new(effect, kind, seed, stream)).collect(),
            outside: 0.0,
            transmission: effects().filter_map(TransmissionStage::new).collect(),
            sensor_has_memory: sensor.iter().any(SensorStage::has_memory),
            sensor,
            acting: Drive::COAST,
            position: 0.0,
            speed: 0.0,
            sensed_position: 0.0,
        };
        plant.set_position(0.0);
        plant
    }

    /// Kind of motion of the output.
    #[must_use]
    pub fn kind(&self) -> PlantKind {
        self.kind
    }

    /// Puts the plant at rest at a position, without current; the backlash is centred and the sensor has settled.
    /// Delayed commands and the other memory of the input stay. A position beyond an end stop becomes the stop; one
    /// that is not finite is ignored.
    pub fn set_position(&mut self, position: f64) {
        if !position.is_finite() {
            return;
        }
        self.train.rest_at(position);
        self.position = self.train.motion.position;
        self.speed = 0.0;
        (self.turned_at, self.turned_s) = (self.position, NEVER_S);
        (self.went, self.wound) = (0.0, 0.0);
        for stage in &mut self.transmission {
            stage.settle(self.position);
        }
        self.sensed_position = self.sensor.iter_mut().fold(self.position, |told, stage| stage.settle(told));
    }

    /// Sets the force with which something outside (a body, a hand) pushes the output from now on, N m or N, towards
    /// positive positions. One that is not finite is ignored.
    ///
    /// The force acts on the motor side of a backlash or spring, as the loads among the effects do.
    pub fn set_load(&mut self, force: f64) {
        if force.is_finite() {
            self.outside = force;
        }
    }

    /// Advances time by `dt_s` under a constant drive and a supply of `supply_v` before sag.
    ///
    /// `dt_s` may be of any length; it is divided into steps of at most [`Plant::max_step_s`], and the cost is
    /// proportional to their number. Other divisions into calls change the result only by the error of the steps, which
    /// is nil for the linear part, and by the assignment of random numbers to steps. A duty or coast out of range is
    /// clipped and a negative supply is taken as 0. The call is ignored, without time passing, when `dt_s` is not
    /// positive or any argument is not finite.
    pub fn advance(&mut self, drive: Drive, supply_v: f64, dt_s: f64) {
        let finite = drive.duty.is_finite() && drive.coast.is_finite() && supply_v.is_finite() && dt_s.is_finite();
        if !finite || dt_s <= 0.0 {
            return;
        }
        let drive = drive.clipped();
        let supply_v = supply_v.max(0.0);
        if !self.input_has_memory {
            self.acting = self.through_input(drive, supply_v, dt_s);
        }
        let mut left_s = dt_s;
        while left_s > 0.0 {
            let mut step_s = left_s.min(MAX_STEP_S);
            if self.input_has_memory {
                let drive = self.through_delay(drive, &mut step_s);
                step_s = self.input.iter().map(InputStage::constant_for_s).fold(step_s, f64::min);
                self.acting = self.through_input(drive, supply_v, step_s);
            }
            self.step(supply_v, step_s);
            self.now_s += step_s;
            left_s -= step_s;
            if left_s < SHORTEST_STEP_S.min(0.5 * step_s) {
                break;
            }
        }
        if !self.sensor_has_memory {
            self.sense(dt_s);
        }
    }

    /// Longest step into which [`Plant::advance`] divides its time, s.
    #[must_use]
    pub fn max_step_s(&self) -> f64 {
        MAX_STEP_S
    }

    /// Drive at the output of the delays; shortens the step so that it ends at the next change.
    fn through_delay(&mut self, drive: Drive, step_s: &mut f64) -> Drive {
        let Some(delay) = &mut self.delay else {
            return drive;
        };
        let arrived = delay.apply(drive, self.now_s);
        let next_s = delay.next_change_s() - self.now_s;
        if next_s > SHORTEST_STEP_S {
            *step_s = step_s.min(next_s);
        }
        arrived
    }

    fn through_input(&mut self, drive: Drive, supply_v: f64, step_s: f64) -> Drive {
        self.arrived = drive.duty;
        let drive = self.input.iter_mut().fold(drive, |drive, stage| stage.apply(drive, step_s));
        if self.tables.input.is_empty() && self.unlisted.is_empty() {
            return drive.clipped();
        }
        let drive = drive.clipped();
        let duty = self
            .tables
            .input
            .iter()
            .fold(drive.duty, |duty, table| duty + self.looked_up(table, duty, supply_v, step_s));
        let duty = Drive { duty, ..drive }.clipped().duty;
        if self.unlisted.is_empty() {
            return Drive { duty, ..drive };
        }
        let position = self.train.position_half_way(step_s);
        let moment = Moment { time_s: self.now_s, step_s, duty, position, speed: self.train.motion.speed };
        self.done = act(&mut self.unlisted, moment);
        Drive { duty: self.done.duty, ..drive }.clipped()
    }

    /// Value of a table, its argument taken half-way through a step.
    fn looked_up(&self, table: &Table, duty: f64, supply_v: f64, step_s: f64) -> f64 {
        table.value(match table.over() {
            Over::Input => duty,
            Over::Speed => self.train.speed_half_way(step_s),
            Over::Position => self.train.position_half_way(step_s),
            Over::Time => self.now_s + 0.5 * step_s,
            Over::Supply => supply_v,
            Over::SinceTurn => self.now_s + 0.5 * step_s - self.turned_s,
            Over::History => (self.train.position_half_way(step_s) - self.turned_at).abs(),
        })
    }

    /// Records a reversal of the motor side in the step that started at position `before`.
    fn look_back(&mut self, before: f64) {
        let speed = self.train.motion.speed;
        if speed * self.went < 0.0 {
            self.wound = self.hysteresis(before);
            (self.turned_at, self.turned_s) = (before, self.now_s);
        }
        if speed != 0.0 {
            self.went = speed;
        }
    }

    /// Hysteresis force at a position, N m or N. The force at the last reversal decays to the table's last value.
    fn hysteresis(&self, position: f64) -> f64 {
        let tables = &self.tables.hysteresis;
        if tables.is_empty() || self.went == 0.0 {
            return 0.0;
        }
        let after = |way: f64| tables.iter().map(|table| table.value(way)).sum::<f64>();
        let (fresh, now, spent) = (after(0.0), after((position - self.turned_at).abs()), after(f64::INFINITY));
        let left = if spent == fresh { 0.0 } else { ((spent - now) / (spent - fresh)).clamp(0.0, 1.0) };
        let way = self.went.signum();
        way * (now + (way * self.wound - fresh) * left)
    }

    fn step(&mut self, supply_v: f64, step_s: f64) {
        let position_half_way = self.train.position_half_way(step_s);
        let load: f64 = self.loads.iter_mut().map(|stage| stage.force(position_half_way, step_s)).sum();
        let sum = |tables: &[Table]| -> f64 {
            tables.iter().map(|table| self.looked_up(table, self.arrived, supply_v, step_s)).sum()
        };
        let multiplies = |table: &Table| (1.0 + self.looked_up(table, self.arrived, supply_v, step_s)).max(0.0);
        let pushes = self.pushes.iter().map(|push| push.push(self.train.speed_half_way(step_s)));
        let went = if self.went == 0.0 { 0.0 } else { self.went.signum() };
        let against = went * sum(&self.tables.against) + self.hysteresis(position_half_way);
        let load = load + self.outside + sum(&self.tables.force) + pushes.sum::<f64>() + self.done.force - against;
        let rubbing = self.done.friction + sum(&self.tables.friction);
        let supply_v = supply_v * self.tables.gain.iter().map(multiplies).product::<f64>();
        let before = self.train.motion.position;
        let Drive { duty, coast } = self.acting;
        let winding_rise = self.heats.iter().map(Heat::rise).sum();
        let terminals = Terminals { duty, coast, supply_v, source_ohm: self.source_ohm, winding_rise };
        let friction = Frictions { stages: &self.friction, more: rubbing, time_s: self.now_s };
        self.train.advance(&terminals, &friction, load, step_s);
        self.look_back(before);
        if !self.heats.is_empty() {
            let power_w = self.train.winding_power_w(winding_rise);
            self.heats.iter_mut().for_each(|heat| heat.warm(power_w, step_s));
        }
        let motor_side = (self.train.motion.position, self.train.motion.speed);
        (self.position, self.speed) = self
            .transmission
            .iter_mut()
            .fold(motor_side, |(position, speed), stage| stage.apply(position, speed, step_s));
        if self.sensor_has_memory {
            self.sense(step_s);
        }
    }

    fn sense(&mut self, step_s: f64) {
        self.sensed_position = self.sensor.iter_mut().fold(self.position, |told, stage| stage.apply(told, step_s));
    }

    /// True position of the output, rad or m.
    #[must_use]
    pub fn position(&self) -> f64 {
        self.position
    }

    /// True speed of the output, rad/s or m/s; 0 while the motor side crosses a gap.
    #[must_use]
    pub fn speed(&self) -> f64 {
        self.speed
    }

    /// Position and speed of the motor side, before backlash and compliance, in the units of the output.
    #[must_use]
    pub fn motor_side(&self) -> (f64, f64) {
        (self.train.motion.position, self.train.motion.speed)
    }

    /// Position after the sensor effects, rad or m, from which an ideal sensor would derive its counts or codes.
    #[must_use]
    pub fn sensed_position(&self) -> f64 {
        self.sensed_position
    }

    /// Current in the winding, A; positive drives towards positive positions.
    #[must_use]
    pub fn motor_current_a(&self) -> f64 {
        self.train.motion.current_a
    }

    /// Current drawn from the supply, A, averaged over a PWM period; negative when the motor feeds back.
    #[must_use]
    pub fn supply_current_a(&self) -> f64 {
        let current_a = self.train.motion.current_a;
        self.acting.duty * current_a - self.acting.coast * current_a.abs()
    }
}
