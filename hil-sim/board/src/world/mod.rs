//! World outside the processor: the bus and its chips, bridges, motors, drives, servos, rails and sensors.
//!
//! Nothing is scheduled here. The world is brought up to date when it is queried or changed: from the last update to
//! now, in intervals in which no line changes.

mod body;
mod chips;
mod drives;
mod encoders;
mod fields;
mod motor;
mod pins;
mod stepping;
mod uarts;
mod wires;

use std::{cell::RefCell, rc::Rc};

use r4_boards::{Mount, Robot, SimulatedRail};
use r4_plants::{Drive, Plant, PlantError, PlantKind};
use r4_protocol::{
    ChannelId,
    config::{MAX_MOTORS, RelayConfig, RelayRole},
};
use r4_world::{Field, Inertial, Scene};
use rand_pcg::{Pcg64, rand_core::SeedableRng};

use crate::{
    chips::{
        as5600::As5600,
        icm20948::Icm20948,
        ina226::Ina226,
        mcp4728::Mcp4728,
        mcp23017::{Mcp23017, PinState},
        nau7802::Nau7802,
        pca9685::Pca9685,
        vl6180x::Vl6180x,
    },
    clock::Clock,
    i2c::I2cBus,
    misuse::Misuse,
    sensors::{
        as5600_pwm::As5600Pwm,
        hc_sr04::{HcSr04, HcSr04Array},
    },
};
use body::{Coupling, Movers, Relay};
use chips::Chips;
use drives::{Bldc, Servo};
pub use encoders::{EncoderEdge, EncoderLine};
pub use fields::FieldSensor;
use motor::Motor;
pub use pins::{AnalogSource, Pins, SwitchInput};
pub use stepping::StepPulses;
pub use wires::{BoardChip, Controller};

const RANGE_SENSORS: usize = HcSr04Array::MODULES;

/// The physical world around one board.
pub struct World {
    clock: Clock,
    now_ns: u64,
    /// The board's I2C bus.
    pub bus: I2cBus,
    chips: Chips,
    relays: Vec<Relay>,
    osmc_disabled: bool,
    /// True if bridge inputs may have changed since their last update.
    stale: bool,
    generation: u64,
    motors: Vec<Motor>,
    bldcs: Vec<Bldc>,
    servos: Vec<Servo>,
    steppers: Vec<stepping::Axis>,
    rails: Vec<Rail>,
    /// Body that couples some shafts.
    body: Option<Coupling>,
    scene: Scene,
    fields: Vec<Field>,
    /// Time of the next sample of the field sensors, ns; `None` without any.
    next_field_ns: Option<u64>,
    /// Mounts of the range sensors on the body, by connector.
    mounts: [Option<Mount>; RANGE_SENSORS],
    pins: Pins,
    /// The processor's counters of encoder edges; each is taken out while edges are passed to it.
    counters: [Option<encoders::Counter>; 4],
    index_latches: [encoders::IndexLatch; 4],
    /// True if the robot uses the encoder that interrupts count.
    encoder_3: bool,
    /// The processor's words that survive its resets; zero after power-on.
    kept_words: [u32; MAX_MOTORS],
    noise: Pcg64,
}

struct Rail {
    spec: SimulatedRail,
    volts: f64,
    /// Current drawn by motors, A; negative while they feed it back.
    current_a: f64,
}

impl Rail {
    /// Voltage after `dt_s` with a motor current of `current_a`, A, negative if fed back.
    ///
    /// A battery takes back the motors' current through its own resistance. A power supply does not: its capacitance
    /// stores the charge, and supplies the motors first.
    fn after(&self, current_a: f64, dt_s: f64) -> f64 {
        let source_v = self.spec.emf_v - self.spec.resistance_ohm * current_a;
        match self.spec.capacitance_f {
            None => source_v,
            Some(capacitance_f) => {
                // while the source delivers nothing, only the capacitance changes the voltage
                let lowest_v = self.spec.emf_v - self.spec.resistance_ohm * current_a.max(0.0);
                (self.volts - current_a * dt_s / capacitance_f).max(lowest_v)
            }
        }
    }
}

/// The processor, as the firmware accesses its peripherals.
#[derive(Clone)]
pub(crate) struct Processor(pub(crate) Rc<RefCell<World>>);

/// True if a relay's contact is closed: its input is driven to the active level, not floating.
fn is_closed(chips: &Chips, relay: &RelayConfig) -> bool {
    chips.pin(relay.bit) == PinState::Driven(!relay.active_low)
}

impl World {
    /// The world of `robot` at time 0, with noise from `seed`. It follows `clock`, which must be at 0.
    ///
    /// # Errors
    /// [`PlantError`] if a plant's file is wrong.
    pub fn new(robot: &Robot, clock: Clock, seed: u64) -> Result<Self, PlantError> {
        let mut bus = I2cBus::new(robot.carrier.i2c.rate_hz);
        let chips = Chips::new(robot, &mut bus, seed);
        let rails: Vec<_> =
            robot.simulation.rails.iter().map(|spec| Rail { volts: spec.emf_v, current_a: 0.0, spec: *spec }).collect();
        let mut motors = Vec::new();
        for (simulated, index) in robot.simulation.motors.iter().zip(0u8..) {
            // the file's reader has checked that rail and motor exist
            let rail = rails.iter().position(|rail| rail.spec.channel == simulated.rail).unwrap_or(0);
            let motor = robot.config.motors.iter().find(|motor| motor.id == simulated.channel);
            let Some(wiring) = motor.map(|motor| motor.bridge) else { continue };
            motors.push(Motor::new(simulated, wiring, rail, seed.wrapping_add(index.into()))?);
        }
        let (mut bldcs, mut servos, mut steppers) =
            (drives::bldcs(robot), drives::servos(robot), drives::steppers(robot));
        let relays: Vec<_> =
            robot.config.relays.iter().map(|relay| Relay { config: *relay, is_closed: false }).collect();
        let movers = Movers {
            motors: &mut motors,
            bldcs: &mut bldcs,
            servos: &mut servos,
            steppers: &mut steppers,
            relays: &relays,
        };
        let body = robot.simulation.body.as_ref().map(|body| Coupling::new(body, movers));
        let pins = Pins::new(robot, seed);
        let encoder_3 = robot.config.uses_encoder(3);
        let counters = encoders::counters(&pins.encoders, encoder_3);
        Ok(Self {
            clock,
            now_ns: 0,
            bus,
            chips,
            relays,
            osmc_disabled: true,
            stale: true,
            generation: 0,
            motors,
            bldcs,
            servos,
            steppers,
            rails,
            body,
            scene: robot.simulation.scene.clone(),
            fields: robot.simulation.fields.clone(),
            next_field_ns: robot.simulation.analogs.iter().any(|analog| analog.field.is_some()).then_some(0),
            mounts: body::mounts(robot),
            pins,
            counters,
            index_latches: Default::default(),
            encoder_3,
            kept_words: [0; MAX_MOTORS],
            noise: Pcg64::seed_from_u64(seed),
        })
    }

    /// The clock that this world follows.
    #[must_use]
    pub fn clock(&self) -> &Clock {
        &self.clock
    }

    /// Advances everything to the clock's time.
    pub fn catch_up(&mut self) {
        let target_ns = self.clock.now_ns();
        self.sense_fields();
        while self.now_ns < target_ns {
            let change_ns = self.chips.next_change_ns().into_iter().chain(self.next_field_ns).min();
            let until_ns = change_ns.map_or(target_ns, |at_ns| at_ns.clamp(self.now_ns, target_ns));
            self.step(until_ns);
            self.now_ns = until_ns;
            self.chips.advance(until_ns);
            self.look_at_lines();
            self.sense_fields();
        }
        for axis in &mut self.steppers {
            axis.catch_up(target_ns);
        }
    }

    /// Advances physics under constant lines.
    fn step(&mut self, until_ns: u64) {
        let dt_s = (until_ns - self.now_ns) as f64 * 1e-9;
        let advance = |motor: &mut Motor, dt_s: f64| {
            motor.plant.advance(motor.drive, self.rails[motor.rail].volts, dt_s);
        };
        match &mut self.body {
            Some(body) => {
                let mut movers = Movers {
                    motors: &mut self.motors,
                    bldcs: &mut self.bldcs,
                    servos: &mut self.servos,
                    steppers: &mut self.steppers,
                    relays: &self.relays,
                };
                body.step(&mut self.scene, [self.now_ns, until_ns], &mut movers, advance);
            }
            None => self.motors.iter_mut().for_each(|motor| advance(motor, dt_s)),
        }
        let shaft = |of: ChannelId| {
            let motor = self.motors.iter().find(|motor| motor.channel == of);
            motor.map(|motor| motor.plant.sensed_position())
        };
        self.chips.see_angles(until_ns, shaft);
        let measured = |reading| self.body.as_ref().map(|body| body.measured(reading));
        self.chips.see_forces(until_ns, measured);
        self.chips.see_distances(until_ns, measured);
        for source in &mut self.pins.pulses {
            let shaft_rad = source.mounting.of.and_then(shaft).unwrap_or_default();
            source.sensor.feel(until_ns, source.mounting.zero_rad + shaft_rad);
        }
        self.chips.feel(until_ns, self.body.as_ref().map_or(Inertial::AT_REST, Coupling::inertial));
        for (index, rail) in self.rails.iter_mut().enumerate() {
            let on_rail = self.motors.iter().filter(|motor| motor.rail == index);
            let current_a: f64 = on_rail.map(|motor| motor.plant.supply_current_a()).sum();
            rail.current_a = current_a;
            rail.volts = rail.after(current_a, dt_s);
            // near its lock-out the gate driver must be updated each time, not only when a line changes
            self.stale |= rail.volts < motor::GATE_SUPPLY_V;
        }
        self.chips.see_currents(until_ns, |of| {
            let rail = self.rails.iter().find(|rail| rail.spec.channel == of);
            let motor = || self.motors.iter().find(|motor| motor.channel == of);
            let of_motor = || motor().map(|motor| [motor.plant.supply_current_a(), self.rails[motor.rail].volts]);
            rail.map(|rail| [rail.current_a, rail.volts]).or_else(of_motor)
        });
    }

    /// Updates bridges, drives and servos with the present lines and supply.
    pub(crate) fn look_at_lines(&mut self) {
        let generation = self.chips.generation();
        if !self.stale && generation == self.generation {
            return;
        }
        self.stale = false;
        self.generation = generation;
        for relay in &mut self.relays {
            relay.is_closed = is_closed(&self.chips, &relay.config);
        }
        let powered = self.is_powered();
        for motor in &mut self.motors {
            let chip = if motor.is_on_osmc() { &self.chips.osmc_pwm } else { &self.chips.dhb_pwm };
            let Some(chip) = chip else { continue };
            // behind an open relay the bridge has no supply
            let supply_v = if powered { self.rails[motor.rail].volts } else { 0.0 };
            motor.look(self.now_ns, &chip.borrow(), self.osmc_disabled, supply_v);
        }
        for bldc in &mut self.bldcs {
            bldc.look(self.now_ns, &self.chips, powered);
        }
        for servo in &mut self.servos {
            servo.look(self.now_ns, &self.chips);
        }
        for axis in &mut self.steppers {
            // first the pulses up to now: a driver does not go back in time
            axis.catch_up(self.now_ns);
            axis.supply(self.now_ns, powered);
        }
    }

    /// True if the motors' supply is on; a relay may switch it.
    fn is_powered(&self) -> bool {
        let is_open =
            |relay: &Relay| relay.config.role == RelayRole::MotorPower && !is_closed(&self.chips, &relay.config);
        !self.relays.iter().any(is_open)
    }

    pub(crate) fn uart_port(&mut self, connector: usize) -> &mut pins::UartPort {
        &mut self.pins.uarts[connector]
    }

    fn axis(&mut self, connector: u8) -> Option<&mut stepping::Axis> {
        self.steppers.iter_mut().find(|axis| axis.channel.index == connector)
    }

    // interface for tests, and for programs that compare with the truth

    /// True position of a motor's, servo's, drive's or stepper's output, rad or m; `None` for other channels.
    pub fn position(&mut self, channel: ChannelId) -> Option<f64> {
        self.catch_up();
        let now_ns = self.now_ns;
        let motor = self.motor(channel).map(|motor| motor.plant.position());
        let stepper = || self.steppers.iter().find(|axis| axis.channel == channel).map(stepping::Axis::angle_rad);
        let position = motor.or_else(stepper);
        let servo = self.servos.iter_mut().find(|servo| servo.channel == channel);
        let position = position.or_else(|| servo.map(|servo| servo.angle_rad(now_ns)));
        let bldc = self.bldcs.iter_mut().find(|bldc| bldc.channel == channel);
        position.or_else(|| bldc.map(|bldc| bldc.at(now_ns).position_rad()))
    }

    /// True speed of a motor's or drive's output, rad/s or m/s; `None` for other channels.
    pub fn speed(&mut self, channel: ChannelId) -> Option<f64> {
        self.catch_up();
        let now_ns = self.now_ns;
        let motor = self.motor(channel).map(|motor| motor.plant.speed());
        let bldc = self.bldcs.iter_mut().find(|bldc| bldc.channel == channel);
        motor.or_else(|| bldc.map(|bldc| bldc.at(now_ns).speed_rad_s()))
    }

    /// True if a motor's positions are in m, false for rad.
    #[must_use]
    pub fn is_linear(&self, channel: ChannelId) -> bool {
        self.motor(channel).is_some_and(|motor| motor.plant.kind() == PlantKind::Linear)
    }

    /// True if a relay's contact is closed; `None` for a channel without a relay.
    #[must_use]
    pub fn relay_closed(&self, channel: ChannelId) -> Option<bool> {
        let relay = self.relays.iter().find(|relay| relay.config.id == channel)?;
        Some(is_closed(&self.chips, &relay.config))
    }

    /// Present output of a motor's bridge; `None` for other channels.
    pub fn drive(&mut self, channel: ChannelId) -> Option<Drive> {
        self.catch_up();
        self.motor(channel).map(|motor| motor.drive)
    }

    /// A brushless drive, for queries; `None` for other channels.
    pub fn bldc(&mut self, channel: ChannelId) -> Option<&crate::devices::bldc_drive::BldcDrive> {
        self.catch_up();
        let now_ns = self.now_ns;
        self.bldcs.iter_mut().find(|bldc| bldc.channel == channel).map(|bldc| bldc.at(now_ns))
    }

    /// Voltage at the speed input of a brushless drive, V; `None` for other channels.
    pub fn throttle_v(&mut self, channel: ChannelId) -> Option<f64> {
        self.catch_up();
        let bldc = self.bldcs.iter().find(|bldc| bldc.channel == channel)?;
        Some(bldc.throttle_v(&self.chips))
    }

    /// A servo, for queries; `None` for other channels.
    pub fn servo(&mut self, channel: ChannelId) -> Option<&crate::devices::rc_servo::RcServo> {
        self.catch_up();
        let now_ns = self.now_ns;
        self.servos.iter_mut().find(|servo| servo.channel == channel).map(|servo| servo.at(now_ns))
    }

    /// A stepper driver, for queries; `None` for other channels.
    pub fn stepper(&mut self, channel: ChannelId) -> Option<&crate::devices::stepper_driver::StepperDriver> {
        self.catch_up();
        self.steppers.iter().find(|axis| axis.channel == channel).map(|axis| &axis.driver)
    }

    /// A range sensor, for queries and faults; `None` beyond the board's connectors.
    pub fn range_sensor(&mut self, connector: u8) -> Option<&mut HcSr04> {
        self.catch_up();
        self.pins.rangers.modules.get_mut(usize::from(connector))
    }

    /// Other devices on the processor's pins.
    pub fn pins(&mut self) -> &mut Pins {
        self.catch_up();
        &mut self.pins
    }

    /// Moves a motor's output to a position, at rest.
    pub fn set_position(&mut self, channel: ChannelId, position: f64) {
        self.catch_up();
        if let Some(motor) = self.motors.iter_mut().find(|motor| motor.channel == channel) {
            motor.plant.set_position(position);
        }
    }

    /// Replaces a motor's physics, at rest at the present position.
    pub fn set_plant(&mut self, channel: ChannelId, plant: Plant) {
        self.catch_up();
        if let Some(motor) = self.motors.iter_mut().find(|motor| motor.channel == channel) {
            let position = motor.plant.position();
            motor.plant = plant;
            motor.plant.set_position(position);
        }
    }

    /// Voltage of a rail, V; `None` for other channels.
    pub fn rail_v(&mut self, rail: ChannelId) -> Option<f64> {
        self.catch_up();
        self.rails.iter().find(|known| known.spec.channel == rail).map(|rail| rail.volts)
    }

    /// Sets a rail's voltage without load, V.
    pub fn set_emf(&mut self, rail: ChannelId, emf_v: f64) {
        self.catch_up();
        if let Some(rail) = self.rails.iter_mut().find(|known| known.spec.channel == rail) {
            rail.spec.emf_v = emf_v;
        }
        self.stale = true;
    }

    /// PWM chip of the OSMC bridges, for inspection and faults.
    #[must_use]
    pub fn osmc_pwm(&self) -> Option<&Rc<RefCell<Pca9685>>> {
        self.chips.osmc_pwm.as_ref()
    }

    /// PWM chip of the DHB bridges.
    #[must_use]
    pub fn dhb_pwm(&self) -> Option<&Rc<RefCell<Pca9685>>> {
        self.chips.dhb_pwm.as_ref()
    }

    /// PWM chip of the servos.
    #[must_use]
    pub fn servo_pwm(&self) -> Option<&Rc<RefCell<Pca9685>>> {
        self.chips.servo_pwm.as_ref()
    }

    /// DAC of the brushless drives' speed inputs.
    #[must_use]
    pub fn bldc_dac(&self) -> Option<&Rc<RefCell<Mcp4728>>> {
        self.chips.bldc_dac.as_ref()
    }

    /// Expander for relays, directions and brakes.
    #[must_use]
    pub fn expander(&self) -> Option<&Rc<RefCell<Mcp23017>>> {
        self.chips.expander.as_ref()
    }

    /// An IMU, for inspection and faults; `None` for other channels.
    #[must_use]
    pub fn imu(&self, channel: ChannelId) -> Option<&Rc<RefCell<Icm20948>>> {
        self.chips.imus.iter().find(|imu| imu.mounting.channel == channel).map(|imu| &imu.chip)
    }

    /// A current monitor, for inspection and faults; `None` for other channels.
    #[must_use]
    pub fn current_monitor(&self, channel: ChannelId) -> Option<&Rc<RefCell<Ina226>>> {
        self.chips.currents.iter().find(|monitor| monitor.wiring.channel == channel).map(|monitor| &monitor.chip)
    }

    /// An angle sensor, for inspection and faults; `None` for other channels.
    #[must_use]
    pub fn angle_sensor(&self, channel: ChannelId) -> Option<&Rc<RefCell<As5600>>> {
        self.chips.angles.iter().find(|angle| angle.mounting.channel == channel).map(|angle| &angle.chip)
    }

    /// The converter of a load cell, for inspection and faults; `None` for other channels.
    #[must_use]
    pub fn load_cell(&self, channel: ChannelId) -> Option<&Rc<RefCell<Nau7802>>> {
        self.chips.forces.iter().find(|force| force.cell.channel == channel).map(|force| &force.chip)
    }

    /// An optical distance sensor, for inspection and faults; `None` for other channels.
    #[must_use]
    pub fn distance_sensor(&self, channel: ChannelId) -> Option<&Rc<RefCell<Vl6180x>>> {
        self.chips.distances.iter().find(|sensor| sensor.sees.channel == channel).map(|sensor| &sensor.chip)
    }

    /// The angle sensor that sends pulses to a range connector, for inspection and faults; `None` if there is none.
    pub fn pulse_sensor(&mut self, connector: u8) -> Option<&mut As5600Pwm> {
        self.catch_up();
        self.pins.pulses_at(connector.into()).map(|source| &mut source.sensor)
    }

    /// Current drawn by motors from a rail, A; negative while they feed it back.
    pub fn rail_current_a(&mut self, rail: ChannelId) -> Option<f64> {
        self.catch_up();
        self.rails.iter().find(|known| known.spec.channel == rail).map(|rail| rail.current_a)
    }

    /// All misuses so far, in order of time.
    #[must_use]
    pub fn misuse(&self) -> Vec<Misuse> {
        let mut all: Vec<_> = self.bus.misuse().first().to_vec();
        all.extend(self.chips.misuse());
        all.extend(self.motors.iter().flat_map(|motor| motor.misuse().first()));
        all.extend(self.bldcs.iter().flat_map(|bldc| bldc.misuse().first()));
        all.extend(self.servos.iter().flat_map(|servo| servo.misuse().first()));
        all.extend(self.steppers.iter().flat_map(|axis| axis.driver.misuse().first()));
        all.extend(self.pins.misuse());
        all.sort_by_key(|misuse| misuse.time_ns);
        all
    }

    fn motor(&self, channel: ChannelId) -> Option<&Motor> {
        self.motors.iter().find(|motor| motor.channel == channel)
    }
}
