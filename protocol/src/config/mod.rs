//! Configuration of a board: wiring, limits, gains and calibration.
//!
//! It is made from `boards/*.toml`. The firmware takes it as it is and checks it with [`BoardConfig::validate`].

mod force;
mod input;
mod motor;
mod numbers;
mod output;
mod sensor;

use core::{fmt, ops::RangeInclusive};

use heapless::{String, Vec};
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

pub use force::{FORCE_RATE_MIN_HZ, ForceConfig, ForceSensor};
pub use input::{AnalogConfig, EncoderConfig, RangeConfig, SupplyConfig, SwitchConfig};
pub use motor::{
    ANGLE_RATE_MIN_HZ, ANGLE_READINGS_LOST, BridgeConfig, BridgeLines, ControlConfig, CurrentSense, DUTY_HARD_MAX,
    DhbLines, ENCODER_3_COUNTS_PER_MS, FeedForward, Feedback, FollowConfig, HomingConfig, MotorConfig, MotorSideConfig,
    PidGains, PotPoint, ProfileLimits, SettleConfig, StallConfig, Tuning, WindingConfig,
};
pub use output::{
    BldcConfig, DAC_FULL_SCALE_V, DacChipConfig, DacConfig, DriveLine, ExpanderConfig, RelayConfig, RelayRole, Reverse,
    ServoChipConfig, ServoConfig, ServoPoint, StepperBankConfig, StepperConfig,
};
pub use sensor::{
    AS5600_COUNTS, As5600Config, Icm20948Config, Ina226Config, MAX_SENSORS, NAU7802_FULL_SCALE_MV_V, NAU7802_RATES_HZ,
    Nau7802Config, SensorChip, SensorConfig, SensorDescription, VL6180X_FARTHEST_M, Vl6180xConfig, bus_bits,
};

use crate::{
    can::{BITRATES_KBIT, DATA_RATES_KBIT, Node},
    channel::{ChannelId, ChannelKind, Range},
};

/// Maximum length of a robot's name, bytes.
pub const MAX_NAME: usize = 32;
/// Maximum number of motors on bridges: four OSMC and four on DHB.
pub const MAX_MOTORS: usize = 8;
/// Maximum number of brushless drives.
pub const MAX_BLDCS: usize = 4;
/// Maximum number of servos.
pub const MAX_SERVOS: usize = 16;
/// Maximum number of step/direction drivers.
pub const STEPPERS: usize = 4;
/// Maximum number of relays.
pub const MAX_RELAYS: usize = 8;
/// Maximum number of outputs of the processor's own DAC.
pub const DAC_OUTPUTS: usize = 2;
/// Maximum number of quadrature counters.
pub const ENCODERS: usize = 4;
/// Maximum number of switches.
pub const SWITCHES: usize = 4;
/// Maximum number of range sensors.
pub const RANGE_SENSORS: usize = 4;
/// Maximum number of analog inputs.
pub const ANALOG_INPUTS: usize = 6;
/// Maximum number of measured supply rails.
pub const MAX_SUPPLIES: usize = 4;
/// Highest number of counts or steps in a turn: up to it every whole number is an `f32`.
pub const MAX_EXACT: u32 = 1 << 24;

/// Longest time that a controlled stop may brake, ms. A vehicle that needs more is on a slope.
pub const STOP_BRAKE_MAX_MS: u16 = 5000;
/// Range of link time-outs, ms.
pub const LINK_TIMEOUT_MS: RangeInclusive<u16> = 20..=1000;
const STOP_BRAKE_RULE: &str = "stop_brake_ms must be at most 5000";

/// Configuration of one R4 board in one robot.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct BoardConfig {
    /// Name of the robot.
    pub robot: String<MAX_NAME>,
    /// Period of the control loop, µs.
    pub control_period_us: u32,
    /// Link time-out: the board trips after this long without a heartbeat, ms; 20 to 1000.
    pub link_timeout_ms: u16,
    /// Clock of the bus with the output chips, Hz.
    pub i2c_hz: u32,
    /// True where a stop button is wired to the auxiliary stop input; it trips the board while the line is low.
    pub auxiliary_stop: bool,
    /// True where a screen is plugged in, for the board's own display.
    pub screen: bool,
    /// Temperature of the air in front of the range sensors, °C; the speed of sound follows from it.
    pub air_temperature_c: f32,
    /// The PWM chip behind the OSMC bridges; needed when there are any.
    pub osmc_pwm: Option<PwmConfig>,
    /// The PWM chip behind the DHB bridges; needed when there are any.
    pub dhb_pwm: Option<PwmConfig>,
    /// The PWM chip behind the servos; needed when there are any.
    pub servo_pwm: Option<ServoChipConfig>,
    /// The DAC behind the brushless drives; needed when there are any.
    pub bldc_dac: Option<DacChipConfig>,
    /// The port expander with relays and the lines of brushless drives; needed when there are any.
    pub expander: Option<ExpanderConfig>,
    /// Settings that all step/direction drivers share; needed when there are any.
    pub stepper_bank: Option<StepperBankConfig>,
    /// Motors on OSMC and DHB bridges.
    pub motors: Vec<MotorConfig, MAX_MOTORS>,
    /// Brushless drives with voltage and lines.
    pub bldcs: Vec<BldcConfig, MAX_BLDCS>,
    /// Servos on the PWM chip.
    pub servos: Vec<ServoConfig, MAX_SERVOS>,
    /// Step/direction drivers with their motors.
    pub steppers: Vec<StepperConfig, STEPPERS>,
    /// Relays on the expander.
    pub relays: Vec<RelayConfig, MAX_RELAYS>,
    /// Analog outputs of the processor.
    pub dacs: Vec<DacConfig, DAC_OUTPUTS>,
    /// Quadrature encoders that are channels of their own.
    pub encoders: Vec<EncoderConfig, ENCODERS>,
    /// Switch inputs beside the encoders.
    pub switches: Vec<SwitchConfig, SWITCHES>,
    /// Ultrasonic range sensors at the range connectors.
    pub ranges: Vec<RangeConfig, RANGE_SENSORS>,
    /// Analog inputs that are channels.
    pub analogs: Vec<AnalogConfig, ANALOG_INPUTS>,
    /// Supply rails that are measured.
    pub supplies: Vec<SupplyConfig, MAX_SUPPLIES>,
    /// CAN bus by which hosts may reach the board.
    pub can: CanConfig,
    /// Sensors on the bus with the output chips.
    pub sensors: Vec<SensorConfig, MAX_SENSORS>,
}

/// CAN bus by which hosts reach the board. Settings are read when the board starts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct CanConfig {
    /// Bit rate, kbit/s: 125, 250, 500 or 1000.
    pub kbit_per_s: u16,
    /// Node number of the board on the bus, 0 to 127.
    pub node: u16,
    /// Bit rate of the data phase, kbit/s: 500, 1000 or 2000, not below `kbit_per_s`. The board then takes and sends
    /// frames of CAN FD, which every node of the bus must support: one that does not destroys them. 0 stands for
    /// classic frames only.
    pub data_kbit_per_s: u16,
}

impl Default for CanConfig {
    /// Returns classic frames, 1 Mbit/s and node 0: the defaults of hosts.
    fn default() -> Self {
        Self { kbit_per_s: 1000, node: 0, data_kbit_per_s: 0 }
    }
}

/// PWM chip with 16 outputs, a PCA9685.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct PwmConfig {
    /// I2C address of the chip, 7 bits.
    pub address: u8,
    /// Requested PWM frequency, Hz; the chip has 24 to 1526.
    pub frequency_hz: f32,
}

/// Place of a channel in a [`BoardConfig`]: the list and the index in it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Place {
    /// Motor, by its index in [`BoardConfig::motors`].
    Motor(usize),
    /// Brushless drive, by its index in [`BoardConfig::bldcs`].
    Bldc(usize),
    /// Servo, by its index in [`BoardConfig::servos`].
    Servo(usize),
    /// Stepper, by its index in [`BoardConfig::steppers`].
    Stepper(usize),
    /// Relay, by its index in [`BoardConfig::relays`].
    Relay(usize),
    /// Analog output, by its index in [`BoardConfig::dacs`].
    Dac(usize),
    /// Encoder, by its index in [`BoardConfig::encoders`].
    Encoder(usize),
    /// Switch, by its index in [`BoardConfig::switches`].
    Switch(usize),
    /// Range sensor, by its index in [`BoardConfig::ranges`].
    Range(usize),
    /// Analog input, by its index in [`BoardConfig::analogs`].
    Analog(usize),
    /// Supply rail, by its index in [`BoardConfig::supplies`].
    Supply(usize),
    /// Stop input: 0 is the dead-man's handle, which every board has, 1 the auxiliary stop, if it is wired.
    DeadMan(usize),
    /// Sensor on the bus, by its index in [`BoardConfig::sensors`].
    Sensor(usize),
}

/// Reason why a configuration is not valid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ConfigError {
    /// Channel of the error, or `None` for the board.
    pub channel: Option<ChannelId>,
    /// Rule that the configuration breaks; empty in builds with the feature `brief`.
    pub rule: &'static str,
}

impl ConfigError {
    fn new(channel: Option<ChannelId>, rule: &'static str) -> Self {
        Self { channel, rule: if cfg!(feature = "brief") { "" } else { rule } }
    }
}

impl fmt::Display for ConfigError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(channel) = self.channel {
            write!(f, "{channel}: ")?;
        }
        f.write_str(self.rule)
    }
}

impl core::error::Error for ConfigError {}

impl BoardConfig {
    /// Iterates over the channels with their places, in the order in which a board describes them.
    pub fn channels(&self) -> impl Iterator<Item = (ChannelId, Place)> {
        macro_rules! list {
            ($field:ident, $place:ident) => {
                self.$field.iter().enumerate().map(|(index, config)| (config.id, Place::$place(index)))
            };
        }
        // The dead-man's handle is always there, the auxiliary stop only if it is wired.
        let stops = (0..1 + usize::from(self.auxiliary_stop))
            .map(|index| (ChannelId::new(ChannelKind::DeadMan, index as u8), Place::DeadMan(index)));
        list!(motors, Motor)
            .chain(list!(bldcs, Bldc))
            .chain(list!(servos, Servo))
            .chain(list!(steppers, Stepper))
            .chain(list!(relays, Relay))
            .chain(list!(dacs, Dac))
            .chain(list!(encoders, Encoder))
            .chain(list!(switches, Switch))
            .chain(list!(ranges, Range))
            .chain(list!(analogs, Analog))
            .chain(list!(supplies, Supply))
            .chain(list!(sensors, Sensor))
            .chain(stops)
    }

    /// Returns the place of `channel`, or `None` when the board does not have it.
    #[must_use]
    pub fn place(&self, channel: ChannelId) -> Option<Place> {
        self.channels().find(|(id, _)| *id == channel).map(|(_, place)| place)
    }

    /// Returns whether a motor or an encoder channel uses encoder counter `index`.
    #[must_use]
    pub fn uses_encoder(&self, index: u8) -> bool {
        let of_motor =
            |motor: &MotorConfig| motor.control.is_some_and(|control| control.encoders().any(|of| of == index));
        self.motors.iter().any(of_motor) || self.encoders.iter().any(|encoder| encoder.id.index == index)
    }

    /// Returns whether the index pulse of encoder `index` is active while the line of the switch of the same number is
    /// low; `None` for an encoder without an index pulse.
    #[must_use]
    pub fn index_active_low(&self, index: u8) -> Option<bool> {
        let of_motor = |motor: &MotorConfig| {
            motor.control.is_some_and(|control| {
                matches!(control.feedback, Feedback::Encoder { index: of, counts_per_index: 1.., .. } if of == index)
            })
        };
        let switch = self.switches.iter().find(|switch| switch.id.index == index)?;
        self.motors.iter().any(of_motor).then_some(switch.active_low)
    }

    /// Returns the rate of angle sensor number `angle`, Hz; `None` when there is none.
    #[must_use]
    pub fn angle_rate_hz(&self, angle: u8) -> Option<u16> {
        let id = ChannelId::new(ChannelKind::Angle, angle);
        self.sensors.iter().find(|sensor| sensor.id == id).map(|sensor| sensor.rate_hz)
    }

    /// Returns whether a range sensor, or the angle sensor of a motor, is at range connector `index`.
    #[must_use]
    pub fn uses_range(&self, index: u8) -> bool {
        let feedback = self.motors.iter().filter_map(|motor| Some(motor.control?.feedback));
        let of_motor = |feedback| matches!(feedback, Feedback::Pulses { range, .. } if range == index);
        feedback.map(of_motor).chain(self.ranges.iter().map(|range| range.id.index == index)).any(|uses| uses)
    }

    /// Returns how long a controlled stop of this board takes, ms: the longest time of its channels; 0 when none
    /// brakes.
    ///
    /// Channels stop by the categories of IEC 60204-1. Category 0 takes the power away at once, and the motor coasts.
    /// Category 1 brakes with the power on for this time, then takes it away. A channel with a time of 0 is switched
    /// off at once in either case. Category 1 is only for causes that leave bus, control loop and supply working: see
    /// [`crate::Causes::allow_braking`].
    #[must_use]
    pub fn stop_brake_ms(&self) -> u16 {
        let motors = self.motors.iter().map(|motor| motor.stop_brake_ms);
        let bldcs = self.bldcs.iter().map(|bldc| bldc.stop_brake_ms);
        let steppers = self.steppers.iter().map(|stepper| stepper.stop_brake_ms);
        motors.chain(bldcs).chain(steppers).max().unwrap_or(0)
    }

    /// Checks every number on its own and against the others.
    ///
    /// Numbers that must be positive must be 1e-9 to 1e9, and no number may be larger. Products and quotients of four
    /// such numbers are finite, and so is everything that the firmware computes from them.
    ///
    /// # Errors
    /// [`ConfigError`] with the first rule that the configuration breaks.
    pub fn validate(&self) -> Result<(), ConfigError> {
        self.validate_board()?;
        self.validate_motors()?;
        self.validate_outputs()?;
        self.validate_inputs()?;
        self.validate_homing()?;
        for (position, (id, _)) in self.channels().enumerate() {
            let twice = self.channels().take(position).any(|(other, _)| other == id);
            check(Some(id), !twice, "the channel is named twice")?;
        }
        self.validate_sensors()?;
        self.validate_windings()?;
        self.validate_forces()
    }

    fn validate_board(&self) -> Result<(), ConfigError> {
        let rule = |holds: bool, rule| check(None, holds, rule);
        rule((500..=20_000).contains(&self.control_period_us), "control_period_us must be 500 to 20000")?;
        rule(LINK_TIMEOUT_MS.contains(&self.link_timeout_ms), "link_timeout_ms must be 20 to 1000")?;
        rule((10_000..=400_000).contains(&self.i2c_hz), "i2c_hz must be 10000 to 400000")?;
        rule(Range::new(-40.0, 60.0).contains(self.air_temperature_c), "air_temperature_c must be -40 to 60")?;
        rule(BITRATES_KBIT.contains(&self.can.kbit_per_s), "can_rate must be 125, 250, 500 or 1000 kbit/s")?;
        let CanConfig { kbit_per_s, data_kbit_per_s, .. } = self.can;
        rule(
            DATA_RATES_KBIT.contains(&data_kbit_per_s) && (data_kbit_per_s == 0 || data_kbit_per_s >= kbit_per_s),
            "can_data_rate must be 500, 1000 or 2000 kbit/s, not below can_rate, or 0 for classic frames only",
        )?;
        rule(self.can.node < u16::from(Node::COUNT), "can_node must be 0 to 127")?;
        for chip in self.osmc_pwm.into_iter().chain(self.dhb_pwm) {
            // Prescaler 255 to 3 of the PCA9685 (datasheet 7.3.5).
            rule(Range::new(24.0, 1526.0).contains(chip.frequency_hz), "the PWM chip has 24 to 1526 Hz")?;
            rule(pca9685_address(chip.address), PCA9685_RULE)?;
        }
        if let Some(chip) = self.servo_pwm {
            chip.validate()?;
        }
        if let Some(chip) = self.bldc_dac {
            rule((0x60..0x68).contains(&chip.address), "an MCP4728 has an address from 0x60 to 0x67")?;
            rule(Range::new(2.7, 5.5).contains(chip.full_scale_v), "an MCP4728 is supplied with 2.7 to 5.5 V")?;
        }
        if let Some(expander) = self.expander {
            rule((0x20..0x28).contains(&expander.address), "an MCP23017 has an address from 0x20 to 0x27")?;
        }
        if let Some(bank) = self.stepper_bank {
            bank.validate()?;
        }
        self.validate_bus()?;
        let mut addresses = Used::default();
        rule(self.output_addresses().all(|address| addresses.take(address)), "two chips have the same address")
    }

    /// Returns the addresses of the output chips.
    fn output_addresses(&self) -> impl Iterator<Item = u8> {
        let pwm = [self.osmc_pwm, self.dhb_pwm].map(|chip| chip.map(|chip| chip.address));
        let others = [
            self.servo_pwm.map(|chip| chip.address),
            self.bldc_dac.map(|chip| chip.address),
            self.expander.map(|chip| chip.address),
        ];
        pwm.into_iter().chain(others).flatten()
    }

    /// Checks the sensors on the bus. Each has an address of its own, and its longest transfer fits beside the writes
    /// of all OSMC bridges in a period. All readings together take at most half of what those writes leave; the other
    /// half is for DHB bridges, drives, servos and read-back.
    fn validate_sensors(&self) -> Result<(), ConfigError> {
        let mut addresses = Used::default();
        for address in self.output_addresses() {
            addresses.take(address);
        }
        // OSMC bridges may be written in every period; sensors come after the outputs.
        let left = self.period_bits().saturating_sub(self.osmc_bits());
        let periods_per_s = 1_000_000 / u64::from(self.control_period_us.max(1));
        let mut bits_per_s = 0;
        for sensor in &self.sensors {
            let rule = |holds: bool, rule| check(Some(sensor.id), holds, rule);
            sensor.validate()?;
            rule(addresses.take(sensor.address), "the address belongs to another chip on the bus")?;
            let SensorDescription { longest_bits, reading_bits, transfers, .. } = sensor.chip.description();
            // A transfer is not split: one that does not fit beside these writes would never start.
            rule(u64::from(longest_bits) <= left, "the outputs' writes leave no room on the bus for this sensor")?;
            rule(
                u64::from(sensor.rate_hz) * u64::from(transfers) <= periods_per_s,
                "rate_hz is too high: each transfer of a reading takes a control period",
            )?;
            bits_per_s += u64::from(sensor.rate_hz) * u64::from(reading_bits);
            rule(
                2 * bits_per_s <= left * periods_per_s,
                "the sensors' readings must fit half of what the OSMC bridges leave of the bus: lower rate_hz",
            )?;
        }
        Ok(())
    }

    /// Returns the bits that the bus carries in a control period: 95 % of it, the rest is for the processor.
    fn period_bits(&self) -> u64 {
        u64::from(self.control_period_us) * u64::from(self.i2c_hz) / 1_000_000 * 95 / 100
    }

    /// Returns the most bits that the OSMC bridges take in a period: six bytes each, whose pulse ends with the PWM
    /// period.
    fn osmc_bits(&self) -> u64 {
        let is_osmc = |motor: &&MotorConfig| matches!(motor.bridge, BridgeConfig::Osmc(_));
        self.motors.iter().filter(is_osmc).count() as u64 * u64::from(bus_bits(6))
    }

    /// Checks that each control period has room on the bus for the largest single write, and beside every OSMC bridge
    /// for the largest of the others. Otherwise some output would never be written.
    fn validate_bus(&self) -> Result<(), ConfigError> {
        let bits = |bytes| u64::from(bus_bits(bytes));
        let is_osmc = |motor: &&MotorConfig| matches!(motor.bridge, BridgeConfig::Osmc(_));
        let osmc = self.motors.iter().filter(is_osmc).count();
        let has_dhb = self.motors.len() > osmc;
        // All lines of a bridge, reading back a PWM chip's mode, all voltages of the DAC.
        let all_lines = if osmc > 0 { bits(18) } else { 0 };
        let others =
            [(has_dhb, bits(14)), (!self.bldcs.is_empty(), bits(9)), (!self.motors.is_empty(), bits(5) + bits(4))];
        // The others may wait for another period, so only the largest must fit.
        let largest = others.into_iter().filter(|(there, _)| *there).map(|(_, bits)| bits).max();
        let needed = all_lines.max(self.osmc_bits() + largest.unwrap_or(0)).max(bits(6));
        let room = self.period_bits();
        check(None, room >= needed, "i2c_hz and control_period_us must leave room for every output in a period")
    }

    fn validate_motors(&self) -> Result<(), ConfigError> {
        let (mut osmc_lines, mut dhb_lines, mut encoders) = (Used::default(), Used::default(), Used::default());
        let mut angles = Used::default();
        for (position, motor) in self.motors.iter().enumerate() {
            let rule = |holds: bool, rule| check(Some(motor.id), holds, rule);
            let lines_rule = "bridge lines must be 0 to 15, each used once";
            match motor.bridge {
                BridgeConfig::Osmc(lines) => {
                    rule(self.osmc_pwm.is_some(), "a motor on an OSMC needs osmc_pwm")?;
                    rule(lines.all().iter().all(|line| *line < 16 && osmc_lines.take(*line)), lines_rule)?;
                }
                BridgeConfig::Dhb(lines) => {
                    rule(self.dhb_pwm.is_some(), "a motor on a DHB needs dhb_pwm")?;
                    rule(lines.all().iter().all(|line| *line < 16 && dhb_lines.take(*line)), lines_rule)?;
                }
            }
            motor.validate()?;
            if let Some(control) = &motor.control {
                let once = control.encoders().all(|index| encoders.take(index));
                rule(once, "the encoder must exist and be used by one motor")?;
                self.validate_angle(motor.id, control, &mut angles)?;
            }
            // `osmc` and `actuator` are two uses of the same connector; `dhb` has connectors of its own.
            let same_connector = |other: &MotorConfig| {
                other.id.index == motor.id.index
                    && (other.id.kind == ChannelKind::Dhb) == (motor.id.kind == ChannelKind::Dhb)
            };
            let taken = self.motors.iter().take(position).any(same_connector);
            rule(!taken, "the bridge connector is used twice")?;
        }
        Ok(())
    }

    /// Checks the angle sensor of a motor: it exists, belongs to this motor alone, and is read often enough that no
    /// turn of the shaft can hide between two readings, even when some of them fail.
    fn validate_angle(&self, id: ChannelId, control: &ControlConfig, taken: &mut Used) -> Result<(), ConfigError> {
        let rule = |holds: bool, rule| check(Some(id), holds, rule);
        let rate_hz = match control.feedback {
            Feedback::Angle { angle, .. } => {
                let rate_hz = self.angle_rate_hz(angle).filter(|_| angle < 64 && taken.take(angle));
                let Some(rate_hz) = rate_hz else {
                    return rule(
                        false,
                        "the motor's angle sensor must be in the list of sensors, and belong to one motor",
                    );
                };
                rule(rate_hz >= ANGLE_RATE_MIN_HZ, "the rate_hz of a motor's angle sensor must be at least 250")?;
                rate_hz
            }
            Feedback::Pulses { range, frames_hz, .. } => {
                // Connectors are numbered behind the sensors, in the same set.
                let free = taken.take(64 + range) && self.ranges.iter().all(|sensor| sensor.id.index != range);
                rule(free, "the range connector of a motor's pulses must belong to it alone")?;
                frames_hz
            }
            Feedback::Encoder { .. } | Feedback::Potentiometer { .. } => return Ok(()),
        };
        let lost_s = f32::from(ANGLE_READINGS_LOST) / f32::from(rate_hz);
        rule(
            control.speed_max * lost_s < core::f32::consts::PI / 2.0,
            "speed_max must turn less than a quarter of a turn in five readings of the angle sensor",
        )
    }

    fn validate_outputs(&self) -> Result<(), ConfigError> {
        // Drives and relays share the expander, so they share its bits.
        let mut bits = Used::default();
        let bits_rule = "expander bits must be 0 to 15, each used once";
        let mut dac_outputs = Used::default();
        for bldc in &self.bldcs {
            let rule = |holds: bool, rule| check(Some(bldc.id), holds, rule);
            let Some(chip) = self.bldc_dac else { return rule(false, "a brushless drive needs bldc_dac") };
            bldc.validate(chip.full_scale_v)?;
            rule(bldc.output < 4 && dac_outputs.take(bldc.output), "DAC outputs must be 0 to 3, each used once")?;
            rule(bldc.lines().all(|line| line.bit < 16 && bits.take(line.bit)), bits_rule)?;
            rule(
                self.expander.is_some() || bldc.lines().next().is_none(),
                "the lines of a brushless drive need the expander",
            )?;
        }
        for relay in &self.relays {
            let rule = |holds: bool, rule| check(Some(relay.id), holds, rule);
            rule(relay.id.kind == ChannelKind::Relay, "a relay needs a relay channel name")?;
            rule(self.expander.is_some(), "a relay needs the expander")?;
            rule(relay.bit < 16 && bits.take(relay.bit), bits_rule)?;
        }
        let mut servo_outputs = Used::default();
        for servo in &self.servos {
            let rule = |holds: bool, rule| check(Some(servo.id), holds, rule);
            rule(self.servo_pwm.is_some(), "a servo needs servo_pwm")?;
            servo.validate()?;
            rule(
                servo.output < 16 && servo_outputs.take(servo.output),
                "servo outputs must be 0 to 15, each used once",
            )?;
        }
        for stepper in &self.steppers {
            let rule = |holds: bool, rule| check(Some(stepper.id), holds, rule);
            let Some(bank) = self.stepper_bank else { return rule(false, "a stepper needs stepper_bank") };
            stepper.validate(bank.rate_max_hz)?;
        }
        self.dacs.iter().try_for_each(DacConfig::validate)
    }

    fn validate_inputs(&self) -> Result<(), ConfigError> {
        self.encoders.iter().try_for_each(EncoderConfig::validate)?;
        self.switches.iter().try_for_each(SwitchConfig::validate)?;
        self.ranges.iter().try_for_each(RangeConfig::validate)?;
        // Potentiometers, analog channels and supplies share the analog inputs; each input has one use.
        let mut analogs = Used::default();
        let analog_rule = "the analog input must exist and be used once";
        for motor in &self.motors {
            if let Some(ControlConfig { feedback: Feedback::Potentiometer { analog, .. }, .. }) = motor.control {
                check(Some(motor.id), analogs.take(analog), analog_rule)?;
            }
        }
        for analog in &self.analogs {
            analog.validate()?;
            check(Some(analog.id), analogs.take(analog.id.index), analog_rule)?;
        }
        for supply in &self.supplies {
            supply.validate()?;
            check(Some(supply.id), analogs.take(supply.analog), analog_rule)?;
        }
        Ok(())
    }

    fn validate_windings(&self) -> Result<(), ConfigError> {
        for (id, winding) in self.motors.iter().filter_map(|motor| Some((motor.id, motor.winding?))) {
            let measured = |number| self.supplies.iter().any(|supply| supply.id.index == number);
            check(
                Some(id),
                winding.supply.is_none_or(measured),
                "the winding's supply must be in the list of supplies",
            )?;
            let sensed = |sense: CurrentSense| self.analogs.iter().any(|analog| analog.id.index == sense.analog);
            let rule = "the current sensor's analog input must be in the list of analog inputs";
            check(Some(id), winding.current_sense.is_none_or(sensed), rule)?;
        }
        Ok(())
    }

    /// Checks that each motor's force sensor is among the analog inputs or sensors.
    fn validate_forces(&self) -> Result<(), ConfigError> {
        let forces = self.motors.iter().filter_map(|motor| Some((motor.id, motor.control.as_ref()?.force?)));
        for (id, force) in forces {
            let rule = |holds: bool, rule| check(Some(id), holds, rule);
            match force.sensor {
                ForceSensor::Analog { analog, .. } => {
                    let known = self.analogs.iter().any(|config| config.id.index == analog);
                    rule(known, "the force sensor's analog input must be in the list of analog inputs")?;
                }
                ForceSensor::LoadCell { force } => {
                    let cell = ChannelId::new(ChannelKind::Force, force);
                    let rate_hz = self.sensors.iter().find(|sensor| sensor.id == cell).map(|sensor| sensor.rate_hz);
                    rule(rate_hz.is_some(), "the motor's load cell must be in the list of sensors")?;
                    // Analog inputs have no rate of their own.
                    let fast = rate_hz.is_some_and(|rate_hz| rate_hz >= FORCE_RATE_MIN_HZ);
                    rule(fast, "the rate_hz of a motor's load cell must be at least 250")?;
                }
            }
        }
        Ok(())
    }

    fn validate_homing(&self) -> Result<(), ConfigError> {
        let motors = self.motors.iter().filter_map(|motor| Some((motor.id, motor.control.as_ref()?.homing?)));
        let steppers = self.steppers.iter().filter_map(|stepper| Some((stepper.id, stepper.homing?)));
        let mut switches = Used::default();
        for (id, HomingConfig { switch, .. }) in motors.chain(steppers) {
            let known = self.switches.iter().any(|config| config.id.index == switch);
            let rule = "the homing switch must be in the list of switches, and belong to one axis";
            check(Some(id), known && switches.take(switch), rule)?;
        }
        for motor in &self.motors {
            let Some(control) = motor.control else { continue };
            let Feedback::Encoder { index, counts_per_index: 1.., .. } = control.feedback else { continue };
            let known = self.index_active_low(index).is_some();
            // The index pulse may share its input with the axis' own homing, which seeks the same line.
            let own = control.homing.is_some_and(|homing| homing.switch == index);
            let rule =
                "an index pulse needs the switch with its encoder's number in the list, which no other axis may seek";
            check(Some(motor.id), known && (own || switches.take(index)), rule)?;
        }
        Ok(())
    }
}

const PCA9685_RULE: &str = "a PCA9685 has an address from 0x40 to 0x77, but for 0x70, which all of them answer";

/// Returns whether a PCA9685 can have this address. All of them answer the all-call address, 0x70, from power-up on
/// (NXP datasheet, "LED All Call I2C-bus address").
fn pca9685_address(address: u8) -> bool {
    (0x40..0x78).contains(&address) && address != 0x70
}

/// Set of small numbers that are taken.
#[derive(Default)]
struct Used(u128);

impl Used {
    /// Takes `number`, which is below 128; returns whether it was free.
    fn take(&mut self, number: u8) -> bool {
        // The mask keeps a wrong number from overflowing the shift.
        let bit = 1u128 << (number & 127);
        let free = self.0 & bit == 0;
        self.0 |= bit;
        free
    }
}

fn check(channel: Option<ChannelId>, holds: bool, rule: &'static str) -> Result<(), ConfigError> {
    if holds { Ok(()) } else { Err(ConfigError::new(channel, rule)) }
}

/// Largest number in a configuration; its inverse is the smallest that must be positive.
const LARGEST: f32 = 1e9;

fn finite(value: f32) -> bool {
    value.abs() <= LARGEST
}

fn positive(value: f32) -> bool {
    (1.0 / LARGEST..=LARGEST).contains(&value)
}

fn not_negative(value: f32) -> bool {
    value == 0.0 || positive(value)
}

fn finite_range(range: Range) -> bool {
    finite(range.min) && finite(range.max) && positive(range.max - range.min)
}
