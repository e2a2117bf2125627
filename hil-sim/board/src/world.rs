//! What is outside the processor: the bus and its chips, bridges, motors, rails and sensors.
//!
//! Nothing here is scheduled. The world is brought up to date when someone looks at it or changes it: from the last
//! moment to now, in stretches in which no line changes.

use std::{cell::RefCell, rc::Rc};

use r4_boards::{Robot, SimulatedMotor, SimulatedRail, SimulatedSensor};
use r4_plants::{Drive, Plant, PlantError, PlantSpec};
use r4_protocol::{
    ChannelId,
    config::{BridgeLines, RelayConfig, RelayRole},
};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::{Pcg64, rand_core::SeedableRng};

use crate::{
    chips::{
        mcp23017::{Mcp23017, PinState, Port},
        pca9685::Pca9685,
    },
    clock::Clock,
    i2c::I2cBus,
    misuse::Misuse,
    osmc::{BridgeInputs, OsmcBridge},
};

/// Nominal frequency of the PWM chip's oscillator (PCA9685 datasheet 7.3.5).
const PWM_OSCILLATOR_HZ: u32 = 25_000_000;
/// The bridge's own regulator makes this for its gate driver, or less from a battery that has less.
const GATE_SUPPLY_V: f64 = 12.0;
/// Full scale of the 16-bit converter.
const CODE_MAX: f64 = 65_535.0;

/// The physical world around one board.
pub struct World {
    clock: Clock,
    now_ns: u64,
    /// The board's I2C bus.
    pub bus: I2cBus,
    osmc_pwm: Rc<RefCell<Pca9685>>,
    /// The port expander with its relays, on a robot that has some.
    expander: Option<Rc<RefCell<Mcp23017>>>,
    relays: Vec<RelayConfig>,
    osmc_disabled: bool,
    /// Whether bridge inputs may have changed since the bridges last looked.
    stale: bool,
    pwm_generation: u64,
    expander_generation: u64,
    motors: Vec<Motor>,
    rails: Vec<Rail>,
    noise: Pcg64,
}

struct Motor {
    channel: ChannelId,
    lines: BridgeLines,
    bridge: OsmcBridge,
    rail: usize,
    plant: Plant,
    drive: Drive,
    sensor: SimulatedSensor,
}

struct Rail {
    spec: SimulatedRail,
    volts: f64,
}

impl World {
    /// The world of `robot` at time 0, its noise drawn from `seed`.
    ///
    /// # Errors
    /// When a plant's file is not right.
    pub(crate) fn new(robot: &Robot, clock: Clock, seed: u64) -> Result<Self, PlantError> {
        let mut bus = I2cBus::new(robot.carrier.i2c.rate_hz);
        let osmc_pwm = Rc::new(RefCell::new(Pca9685::new(robot.config.osmc_pwm.address, PWM_OSCILLATOR_HZ)));
        bus.attach(osmc_pwm.clone());
        let expander = robot.config.expander.map(|config| Rc::new(RefCell::new(Mcp23017::new(config.address))));
        expander.iter().for_each(|expander| bus.attach(expander.clone()));
        let rails: Vec<_> = robot.simulation.rails.iter().map(|spec| Rail { volts: spec.emf_v, spec: *spec }).collect();
        let mut motors = Vec::new();
        for (simulated, index) in robot.simulation.motors.iter().zip(0u8..) {
            // The file's reader has checked that rail and motor exist.
            let rail = rails.iter().position(|rail| rail.spec.channel == simulated.rail).unwrap_or(0);
            let motor = robot.config.motors.iter().find(|motor| motor.id == simulated.channel);
            let Some(lines) = motor.map(|motor| motor.lines) else { continue };
            motors.push(Motor::new(simulated, lines, rail, seed.wrapping_add(index.into()))?);
        }
        let noise = Pcg64::seed_from_u64(seed);
        Ok(Self {
            clock,
            now_ns: 0,
            bus,
            osmc_pwm,
            expander,
            relays: robot.config.relays.to_vec(),
            osmc_disabled: true,
            stale: true,
            pwm_generation: 0,
            expander_generation: 0,
            motors,
            rails,
            noise,
        })
    }

    /// The clock this world follows.
    #[must_use]
    pub fn clock(&self) -> &Clock {
        &self.clock
    }

    /// Brings everything to the clock's time.
    pub fn catch_up(&mut self) {
        let target_ns = self.clock.now_ns();
        while self.now_ns < target_ns {
            let change_ns = self.osmc_pwm.borrow().next_change_ns();
            let until_ns = change_ns.map_or(target_ns, |at_ns| at_ns.clamp(self.now_ns, target_ns));
            self.step((until_ns - self.now_ns) as f64 * 1e-9);
            self.now_ns = until_ns;
            self.osmc_pwm.borrow_mut().advance(until_ns);
            self.look_at_bridges();
        }
    }

    /// Lets physics pass under constant lines.
    fn step(&mut self, dt_s: f64) {
        for motor in &mut self.motors {
            motor.plant.advance(motor.drive, self.rails[motor.rail].volts, dt_s);
        }
        for (index, rail) in self.rails.iter_mut().enumerate() {
            let on_rail = self.motors.iter().filter(|motor| motor.rail == index);
            let current_a: f64 = on_rail.map(|motor| motor.plant.supply_current_a()).sum();
            rail.volts = rail.spec.emf_v - rail.spec.resistance_ohm * current_a;
            // Near its lock-out the gate driver must be asked each time, not only when a line changes.
            self.stale |= rail.volts < GATE_SUPPLY_V;
        }
    }

    /// Lets the bridges see their lines and supply as they are now.
    pub(crate) fn look_at_bridges(&mut self) {
        let pwm = self.osmc_pwm.borrow();
        let expander_generation = self.expander.as_ref().map_or(0, |expander| expander.borrow().generation());
        let seen = (pwm.generation(), expander_generation);
        if !self.stale && seen == (self.pwm_generation, self.expander_generation) {
            return;
        }
        self.stale = false;
        (self.pwm_generation, self.expander_generation) = seen;
        let powered = self.relays.iter().all(|relay| relay.role != RelayRole::MotorPower || self.is_closed(relay));
        for motor in &mut self.motors {
            let line = |output: u8| pwm.line(output.into());
            let inputs = BridgeInputs {
                ahi: line(motor.lines.ahi),
                ali: line(motor.lines.ali),
                bhi: line(motor.lines.bhi),
                bli: line(motor.lines.bli),
                disabled: self.osmc_disabled,
            };
            // Behind an open relay the bridge has no supply, and its driver turns everything off.
            let gate_v = if powered { self.rails[motor.rail].volts.min(GATE_SUPPLY_V) } else { 0.0 };
            let output = motor.bridge.update(self.now_ns, &inputs, pwm.pwm_period_ns(), gate_v);
            motor.drive = Drive { duty: output.duty, coast: output.coast };
        }
    }

    /// Whether a relay's contact is closed: its input is driven to the level that pulls it, not floating.
    fn is_closed(&self, relay: &RelayConfig) -> bool {
        let Some(expander) = &self.expander else { return false };
        let port = if relay.bit < 8 { Port::A } else { Port::B };
        expander.borrow().pin_level(port, relay.bit % 8) == PinState::Driven(!relay.active_low)
    }

    /// The DISABLE line of the bridges.
    pub(crate) fn set_osmc_disabled(&mut self, disabled: bool) {
        self.catch_up();
        self.osmc_disabled = disabled;
        self.stale = true;
        self.look_at_bridges();
    }

    /// The output-enable line of the motor PWM chips, as the board wires it: high is off.
    pub(crate) fn set_pwm_outputs_disabled(&mut self, disabled: bool) {
        self.catch_up();
        self.osmc_pwm.borrow_mut().set_output_enable(self.clock.now_ns(), !disabled);
        self.look_at_bridges();
    }

    /// What counter `index` shows: four counts to a line, rounded down as edges do, wrapping at 16 bits.
    pub(crate) fn encoder_count(&mut self, index: u8) -> u16 {
        self.catch_up();
        let count = self.motors.iter().find_map(|motor| match motor.sensor {
            SimulatedSensor::Encoder { input, lines_per_turn } if input == index => {
                let turns = motor.plant.sensed_position() / std::f64::consts::TAU;
                Some((turns * f64::from(lines_per_turn) * 4.0).floor() as i64)
            }
            _ => None,
        });
        count.unwrap_or(0) as u16
    }

    /// What the converter reads at input `index`.
    pub(crate) fn analog_code(&mut self, index: u8) -> u16 {
        self.catch_up();
        let potentiometer = self.motors.iter().find_map(|motor| match motor.sensor {
            SimulatedSensor::Potentiometer { input, low, high, noise_rms_codes } if input == index => {
                let along = (motor.plant.sensed_position() - low.position_m) / (high.position_m - low.position_m);
                let share = low.share() + along * (high.share() - low.share());
                Some((share * CODE_MAX, noise_rms_codes))
            }
            _ => None,
        });
        let rail = || {
            let rail = self.rails.iter().find(|rail| rail.spec.analog == index)?;
            Some((rail.volts / rail.spec.volts_per_code, rail.spec.noise_rms_codes))
        };
        let Some((code, noise_rms_codes)) = potentiometer.or_else(rail) else { return 0 };
        let noise: f64 = StandardNormal.sample(&mut self.noise);
        (code + noise * noise_rms_codes).round().clamp(0.0, CODE_MAX) as u16
    }

    // For tests, and for programs that compare with the truth.

    /// True position of a motor's output, rad or m; `None` for a channel without a motor.
    pub fn position(&mut self, channel: ChannelId) -> Option<f64> {
        self.catch_up();
        self.motor(channel).map(|motor| motor.plant.position())
    }

    /// True speed of a motor's output, rad/s or m/s.
    pub fn speed(&mut self, channel: ChannelId) -> Option<f64> {
        self.catch_up();
        self.motor(channel).map(|motor| motor.plant.speed())
    }

    /// Whether a relay's contact is closed; `None` for a channel without a relay.
    #[must_use]
    pub fn relay_closed(&self, channel: ChannelId) -> Option<bool> {
        self.relays.iter().find(|relay| relay.id == channel).map(|relay| self.is_closed(relay))
    }

    /// What a motor's bridge does to it now.
    pub fn drive(&mut self, channel: ChannelId) -> Option<Drive> {
        self.catch_up();
        self.motor(channel).map(|motor| motor.drive)
    }

    /// Puts a motor's output at a place, at rest.
    pub fn set_position(&mut self, channel: ChannelId, position: f64) {
        self.catch_up();
        if let Some(motor) = self.motors.iter_mut().find(|motor| motor.channel == channel) {
            motor.plant.set_position(position);
        }
    }

    /// Replaces a motor's physics, at rest where it is.
    pub fn set_plant(&mut self, channel: ChannelId, plant: Plant) {
        self.catch_up();
        if let Some(motor) = self.motors.iter_mut().find(|motor| motor.channel == channel) {
            let position = motor.plant.position();
            motor.plant = plant;
            motor.plant.set_position(position);
        }
    }

    /// Changes a rail's voltage without load.
    pub fn set_emf(&mut self, rail: ChannelId, emf_v: f64) {
        self.catch_up();
        if let Some(rail) = self.rails.iter_mut().find(|known| known.spec.channel == rail) {
            rail.spec.emf_v = emf_v;
        }
        self.stale = true;
    }

    /// The chip behind the bridges, to look into and to break.
    #[must_use]
    pub fn osmc_pwm(&self) -> &Rc<RefCell<Pca9685>> {
        &self.osmc_pwm
    }

    /// Everything done against a datasheet so far, in order of time.
    #[must_use]
    pub fn misuse(&self) -> Vec<Misuse> {
        let pwm = self.osmc_pwm.borrow();
        let bridges = self.motors.iter().flat_map(|motor| motor.bridge.misuse().first());
        let mut all: Vec<_> =
            self.bus.misuse().first().iter().chain(pwm.misuse().first()).chain(bridges).copied().collect();
        if let Some(expander) = &self.expander {
            all.extend(expander.borrow().misuse().first());
        }
        all.sort_by_key(|misuse| misuse.time_ns);
        all
    }

    fn motor(&self, channel: ChannelId) -> Option<&Motor> {
        self.motors.iter().find(|motor| motor.channel == channel)
    }
}

impl Motor {
    fn new(simulated: &SimulatedMotor, lines: BridgeLines, rail: usize, seed: u64) -> Result<Self, PlantError> {
        let spec = PlantSpec::from_toml(&simulated.plant.name, &simulated.plant.text)?;
        let mut plant = Plant::new(&spec, seed);
        plant.set_position(simulated.start);
        Ok(Self {
            channel: simulated.channel,
            lines,
            bridge: OsmcBridge::new(simulated.channel.index),
            rail,
            plant,
            drive: Drive::COAST,
            sensor: simulated.sensor,
        })
    }
}
