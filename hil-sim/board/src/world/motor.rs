//! Motors: a bridge, its plant, and the plant's sensors.

use r4_boards::{SimulatedEncoder, SimulatedMotor, SimulatedSensor};
use r4_plants::{Drive, Model, Plant, PlantError, PlantSpec};
use r4_protocol::{
    ChannelId,
    config::{BridgeConfig, BridgeLines, DhbLines},
};

use crate::{
    chips::pca9685::Pca9685,
    devices::{
        dhb::{DhbInputs, DhbMotor},
        osmc::{BridgeInputs, OsmcBridge},
    },
    misuse::MisuseLog,
};

/// Voltage of the bridge's own regulator for its gate driver, V; a battery with less gives less.
pub(super) const GATE_SUPPLY_V: f64 = 12.0;

pub(super) struct Motor {
    pub(super) channel: ChannelId,
    bridge: Bridge,
    /// Index of the rail that feeds the bridge.
    pub(super) rail: usize,
    pub(super) plant: Plant,
    pub(super) drive: Drive,
    pub(super) sensor: Option<SimulatedSensor>,
    /// Encoder on the motor side of backlash and compliance.
    pub(super) motor_side: Option<SimulatedEncoder>,
    /// True if its shaft is one of the body's.
    pub(super) coupled: bool,
    /// Acceleration by its stall current, per volt of supply: rad/s² or m/s² per V.
    acceleration_per_v: f64,
}

enum Bridge {
    Osmc { lines: BridgeLines, model: Box<OsmcBridge> },
    Dhb { lines: DhbLines, model: Box<DhbMotor> },
}

impl Motor {
    pub(super) fn new(
        simulated: &SimulatedMotor,
        wiring: BridgeConfig,
        rail: usize,
        seed: u64,
    ) -> Result<Self, PlantError> {
        let spec = PlantSpec::from_toml(&simulated.plant.name, &simulated.plant.text)?;
        let mut plant = Plant::new(&spec, seed);
        plant.set_position(simulated.start);
        let number = simulated.channel.index;
        Ok(Self {
            channel: simulated.channel,
            bridge: match wiring {
                BridgeConfig::Osmc(lines) => Bridge::Osmc { lines, model: Box::new(OsmcBridge::new(number)) },
                BridgeConfig::Dhb(lines) => Bridge::Dhb { lines, model: Box::new(DhbMotor::new(number)) },
            },
            rail,
            plant,
            drive: Drive::COAST,
            sensor: simulated.sensor,
            motor_side: simulated.motor_side,
            coupled: false,
            acceleration_per_v: acceleration_per_v(spec.model()),
        })
    }

    /// Acceleration on a reversal at full speed, rad/s² or m/s²: its back-EMF adds to the supply.
    pub(super) fn top_acceleration(&self, supply_v: f64) -> f64 {
        2.0 * supply_v.max(0.0) * self.acceleration_per_v
    }

    /// True if its PWM comes from the OSMC's chip; from the DHB's otherwise.
    pub(super) const fn is_on_osmc(&self) -> bool {
        matches!(self.bridge, Bridge::Osmc { .. })
    }

    /// Updates the bridge with its lines and supply from `at_ns` on.
    pub(super) fn look(&mut self, at_ns: u64, pwm: &Pca9685, disabled: bool, supply_v: f64) {
        let line = |output: u8| pwm.line(output.into());
        let output = match &mut self.bridge {
            Bridge::Osmc { lines: BridgeLines { ahi, ali, bhi, bli }, model } => {
                let inputs =
                    BridgeInputs { ahi: line(*ahi), ali: line(*ali), bhi: line(*bhi), bli: line(*bli), disabled };
                model.update(at_ns, &inputs, pwm.pwm_period_ns(), supply_v.min(GATE_SUPPLY_V))
            }
            Bridge::Dhb { lines: DhbLines { in1, in2, en }, model } => {
                let inputs = DhbInputs { in1: line(*in1), in2: line(*in2), en: line(*en) };
                model.update(at_ns, &inputs, pwm.pwm_period_ns(), supply_v)
            }
        };
        self.drive = Drive { duty: output.duty, coast: output.coast };
    }

    pub(super) fn misuse(&self) -> &MisuseLog {
        match &self.bridge {
            Bridge::Osmc { model, .. } => model.misuse(),
            Bridge::Dhb { model, .. } => model.misuse(),
        }
    }
}

/// Acceleration by the stall current, per volt of supply, without friction and inductance, which both reduce it.
fn acceleration_per_v(model: &Model) -> f64 {
    match model {
        Model::DcGearMotor(motor) => {
            motor.gear_ratio * motor.torque_constant_nm_per_a / (motor.resistance_ohm * motor.inertia_kg_m2)
        }
        Model::LinearActuator(actuator) => {
            let turn_per_m = std::f64::consts::TAU / actuator.lead_m_per_rev;
            let mass_kg = actuator.moving_mass_kg + actuator.rotor_inertia_kg_m2 * turn_per_m * turn_per_m;
            turn_per_m * actuator.torque_constant_nm_per_a / (actuator.resistance_ohm * mass_kg)
        }
    }
}
