//! The output chips on the board's I2C bus.

use std::{cell::RefCell, rc::Rc};

use r4_boards::{
    BodyReading, Robot, SimulatedAngle, SimulatedCurrent, SimulatedDistance, SimulatedForce, SimulatedImu,
};
use r4_protocol::{
    ChannelId,
    config::{SensorChip, SensorConfig},
};
use r4_world::Inertial;

use super::wires::BoardChip;
use crate::{
    chips::{
        as5600::As5600,
        icm20948::{Icm20948, Truth},
        ina226::{Ina226, Inputs},
        mcp4728::{CHANNELS, Mcp4728, Setting},
        mcp23017::{Mcp23017, PinState, Port},
        nau7802::Nau7802,
        pca9685::Pca9685,
        vl6180x::{Target, Vl6180x},
    },
    i2c::I2cBus,
    misuse::Misuse,
};

/// Nominal frequency of a PCA9685's oscillator, Hz (datasheet 7.3.5).
const PWM_OSCILLATOR_HZ: u32 = 25_000_000;

/// Chips on the bus. A robot's board has those that it uses.
pub(super) struct Chips {
    pub(super) osmc_pwm: Option<Rc<RefCell<Pca9685>>>,
    pub(super) dhb_pwm: Option<Rc<RefCell<Pca9685>>>,
    pub(super) servo_pwm: Option<Rc<RefCell<Pca9685>>>,
    pub(super) bldc_dac: Option<Rc<RefCell<Mcp4728>>>,
    pub(super) expander: Option<Rc<RefCell<Mcp23017>>>,
    pub(super) imus: Vec<Imu>,
    pub(super) currents: Vec<CurrentMonitor>,
    pub(super) angles: Vec<AngleSensor>,
    pub(super) forces: Vec<LoadCell>,
    pub(super) distances: Vec<DistanceSensor>,
}

/// An IMU with its mounting on the body.
pub(super) struct Imu {
    pub(super) chip: Rc<RefCell<Icm20948>>,
    pub(super) mounting: SimulatedImu,
}

impl Imu {
    fn new(config: &SensorConfig, mounting: &SimulatedImu, seed: u64) -> Self {
        let chip = Rc::new(RefCell::new(Icm20948::new(config.address, seed.wrapping_add(config.address.into()))));
        Self { chip, mounting: *mounting }
    }
}

/// A current monitor with its wiring.
pub(super) struct CurrentMonitor {
    pub(super) chip: Rc<RefCell<Ina226>>,
    pub(super) wiring: SimulatedCurrent,
    shunt_ohm: f64,
}

impl CurrentMonitor {
    fn new(config: &SensorConfig, wiring: &SimulatedCurrent) -> Option<Self> {
        let SensorChip::Ina226(chip) = config.chip else { return None };
        Some(Self {
            chip: Rc::new(RefCell::new(Ina226::new(config.address))),
            wiring: *wiring,
            shunt_ohm: wiring.shunt_ohm.unwrap_or(chip.shunt_ohm.into()),
        })
    }
}

/// An angle sensor with its shaft.
pub(super) struct AngleSensor {
    pub(super) chip: Rc<RefCell<As5600>>,
    pub(super) mounting: SimulatedAngle,
}

impl AngleSensor {
    fn new(mounting: &SimulatedAngle, seed: u64) -> Self {
        let chip = As5600::new(seed.wrapping_add(mounting.channel.index.into()));
        Self { chip: Rc::new(RefCell::new(chip)), mounting: *mounting }
    }
}

/// A load cell and its converter.
pub(super) struct LoadCell {
    pub(super) chip: Rc<RefCell<Nau7802>>,
    pub(super) cell: SimulatedForce,
}

impl LoadCell {
    fn new(cell: &SimulatedForce, seed: u64) -> Self {
        let mut chip = Nau7802::new(seed.wrapping_add(cell.channel.index.into()));
        chip.set_source_noise_mv_v(cell.noise_n / cell.newtons_per_mv_v.abs());
        Self { chip: Rc::new(RefCell::new(chip)), cell: *cell }
    }
}

/// An optical distance sensor with its target.
pub(super) struct DistanceSensor {
    pub(super) chip: Rc<RefCell<Vl6180x>>,
    pub(super) sees: SimulatedDistance,
}

impl DistanceSensor {
    fn new(sees: &SimulatedDistance, seed: u64) -> Self {
        let chip = Vl6180x::new(seed.wrapping_add(sees.channel.index.into()), sees.offset_m);
        Self { chip: Rc::new(RefCell::new(chip)), sees: *sees }
    }
}

impl Chips {
    pub(super) fn new(robot: &Robot, bus: &mut I2cBus, seed: u64) -> Self {
        let config = &robot.config;
        let pwm = |address, oscillator_hz| Rc::new(RefCell::new(Pca9685::new(address, oscillator_hz)));
        let sensor = |channel| config.sensors.iter().find(|sensor| sensor.id == channel);
        let imus = robot.simulation.imus.iter();
        let imus = imus.filter_map(|mounting| Some(Imu::new(sensor(mounting.channel)?, mounting, seed)));
        let currents = robot.simulation.currents.iter();
        let currents = currents.filter_map(|wiring| CurrentMonitor::new(sensor(wiring.channel)?, wiring));
        let chips = Self {
            imus: imus.collect(),
            currents: currents.collect(),
            angles: robot.simulation.angles.iter().map(|mounting| AngleSensor::new(mounting, seed)).collect(),
            forces: robot.simulation.forces.iter().map(|cell| LoadCell::new(cell, seed)).collect(),
            distances: robot.simulation.distances.iter().map(|sees| DistanceSensor::new(sees, seed)).collect(),
            osmc_pwm: config.osmc_pwm.map(|chip| pwm(chip.address, PWM_OSCILLATOR_HZ)),
            dhb_pwm: config.dhb_pwm.map(|chip| pwm(chip.address, PWM_OSCILLATOR_HZ)),
            servo_pwm: config.servo_pwm.map(|chip| pwm(chip.address, robot.simulation.servo_oscillator_hz as u32)),
            bldc_dac: config.bldc_dac.map(|chip| {
                // EEPROM as the firmware leaves it after its first start: a new chip would give every drive 0 V until
                // then, which is why drives are connected only after that
                let mut kept = [Setting(0); CHANNELS];
                for bldc in &config.bldcs {
                    let share = f64::from(bldc.neutral_v) / f64::from(chip.full_scale_v);
                    kept[usize::from(bldc.output)] = Setting((share * 4096.0).round().min(4095.0) as u16);
                }
                Rc::new(RefCell::new(Mcp4728::new(chip.address, chip.full_scale_v.into(), kept)))
            }),
            expander: config.expander.map(|chip| Rc::new(RefCell::new(Mcp23017::new(chip.address)))),
        };
        chips.pwms().for_each(|chip| bus.attach(chip.clone()));
        chips.bldc_dac.iter().for_each(|chip| bus.attach(chip.clone()));
        chips.expander.iter().for_each(|chip| bus.attach(chip.clone()));
        chips.imus.iter().for_each(|imu| bus.attach(imu.chip.clone()));
        chips.currents.iter().for_each(|current| bus.attach(current.chip.clone()));
        chips.angles.iter().for_each(|angle| bus.attach(angle.chip.clone()));
        chips.forces.iter().for_each(|force| bus.attach(force.chip.clone()));
        chips.distances.iter().for_each(|distance| bus.attach(distance.chip.clone()));
        chips
    }

    /// Advances inertial sensors to `until_ns` with `inertial`, the motion of the body's origin.
    pub(super) fn feel(&self, until_ns: u64, inertial: Inertial) {
        for Imu { chip, mounting } in &self.imus {
            let Inertial { specific_force_m_s2, rate_rad_s, .. } = inertial.at(mounting.place_m);
            let add = |felt: [f64; 3], bias: [f64; 3]| std::array::from_fn(|axis| felt[axis] + bias[axis]);
            let scaled = |felt: [f64; 3], scale: [f64; 3]| std::array::from_fn(|axis| felt[axis] * scale[axis]);
            let truth = Truth {
                acceleration_m_s2: add(specific_force_m_s2, mounting.acceleration_bias_m_s2),
                rate_rad_s: add(scaled(rate_rad_s, mounting.rate_scale), mounting.rate_bias_rad_s),
            };
            chip.borrow_mut().feel(until_ns, truth);
        }
    }

    /// Advances current monitors to `until_ns` with the current of a supply or motor, A, and its voltage.
    pub(super) fn see_currents(&self, until_ns: u64, drawn: impl Fn(ChannelId) -> Option<[f64; 2]>) {
        for CurrentMonitor { chip, wiring, shunt_ohm } in &self.currents {
            // the file's reader has checked that it exists
            let [current_a, volts] = drawn(wiring.of).unwrap_or_default();
            chip.borrow_mut().feel(until_ns, Inputs { shunt_v: current_a * shunt_ohm, bus_v: volts });
        }
    }

    /// Advances angle sensors to `until_ns` with the positions of their motors' shafts, rad.
    pub(super) fn see_angles(&self, until_ns: u64, position: impl Fn(ChannelId) -> Option<f64>) {
        for AngleSensor { chip, mounting } in &self.angles {
            // a sensor without a shaft stands still
            let shaft_rad = mounting.of.and_then(&position).unwrap_or_default();
            chip.borrow_mut().feel(until_ns, mounting.zero_rad + shaft_rad);
        }
    }

    /// Advances load cells to `until_ns` with their force; `measured` gives that of the body.
    pub(super) fn see_forces(&self, until_ns: u64, measured: impl Fn(BodyReading) -> Option<f64>) {
        for LoadCell { chip, cell } in &self.forces {
            let force_n = cell.reads.and_then(&measured).unwrap_or(cell.force_n);
            chip.borrow_mut().feel(until_ns, cell.zero_mv_v + force_n / cell.newtons_per_mv_v);
        }
    }

    /// Advances optical distance sensors to `until_ns` with their target; `measured` gives the distance on the body.
    pub(super) fn see_distances(&self, until_ns: u64, measured: impl Fn(BodyReading) -> Option<f64>) {
        for DistanceSensor { chip, sees } in &self.distances {
            let distance_m = sees.reads.and_then(&measured).or(sees.distance_m);
            let reflectance = sees.reflectance;
            chip.borrow_mut().feel(until_ns, distance_m.map(|distance_m| Target { distance_m, reflectance }));
        }
    }

    fn pwms(&self) -> impl Iterator<Item = &Rc<RefCell<Pca9685>>> {
        self.osmc_pwm.iter().chain(&self.dhb_pwm).chain(&self.servo_pwm)
    }

    /// Time of the next change of an output without a request, ns.
    pub(super) fn next_change_ns(&self) -> Option<u64> {
        self.pwms().filter_map(|chip| chip.borrow().next_change_ns()).min()
    }

    pub(super) fn advance(&self, to_ns: u64) {
        self.pwms().for_each(|chip| chip.borrow_mut().advance(to_ns));
        self.bldc_dac.iter().for_each(|chip| chip.borrow_mut().advance(to_ns));
    }

    /// Counter that changes whenever an output changes.
    pub(super) fn generation(&self) -> u64 {
        let pwms: u64 = self.pwms().map(|chip| chip.borrow().generation()).sum();
        let dac = self.bldc_dac.as_ref().map_or(0, |chip| chip.borrow().generation());
        pwms + dac + self.expander.as_ref().map_or(0, |chip| chip.borrow().generation())
    }

    /// State of one of the expander's pins: 0 to 7 on port A, 8 to 15 on port B.
    pub(super) fn pin(&self, bit: u8) -> PinState {
        let port = if bit < 8 { Port::A } else { Port::B };
        self.expander.as_ref().map_or(PinState::Floating, |chip| chip.borrow().pin_level(port, bit % 8))
    }

    pub(super) fn set_bridge_outputs_enabled(&self, at_ns: u64, enabled: bool) {
        self.osmc_pwm.iter().chain(&self.dhb_pwm).for_each(|chip| chip.borrow_mut().set_output_enable(at_ns, enabled));
    }

    /// Interrupts the supply of one chip; false if the board does not have it.
    pub(super) fn power_cycle(&self, chip: BoardChip, at_ns: u64) -> bool {
        match chip {
            BoardChip::OsmcPwm => self.osmc_pwm.as_ref().map(|chip| chip.borrow_mut().power_cycle(at_ns)),
            BoardChip::DhbPwm => self.dhb_pwm.as_ref().map(|chip| chip.borrow_mut().power_cycle(at_ns)),
            BoardChip::ServoPwm => self.servo_pwm.as_ref().map(|chip| chip.borrow_mut().power_cycle(at_ns)),
            BoardChip::BldcDac => self.bldc_dac.as_ref().map(|chip| chip.borrow_mut().power_cycle(at_ns)),
            BoardChip::Expander => self.expander.as_ref().map(|chip| chip.borrow_mut().power_cycle(at_ns)),
        }
        .is_some()
    }

    pub(super) fn misuse(&self) -> Vec<Misuse> {
        let mut all = Vec::new();
        self.pwms().for_each(|chip| all.extend(chip.borrow().misuse().first()));
        self.bldc_dac.iter().for_each(|chip| all.extend(chip.borrow().misuse().first()));
        self.expander.iter().for_each(|chip| all.extend(chip.borrow().misuse().first()));
        self.imus.iter().for_each(|imu| all.extend(imu.chip.borrow().misuse().first()));
        self.currents.iter().for_each(|current| all.extend(current.chip.borrow().misuse().first()));
        self.angles.iter().for_each(|angle| all.extend(angle.chip.borrow().misuse().first()));
        self.forces.iter().for_each(|force| all.extend(force.chip.borrow().misuse().first()));
        self.distances.iter().for_each(|distance| all.extend(distance.chip.borrow().misuse().first()));
        all
    }
}
