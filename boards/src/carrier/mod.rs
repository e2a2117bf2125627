//! Carrier board, as described in its file; sources and reasons are in the comments there.

mod check;
mod pin;

use r4_protocol::config::{BridgeLines, DhbLines};
use serde::Deserialize;

pub(crate) use check::read;
pub use pin::{NotAPin, Pin, PinKind, Stm32Pin};

use crate::number::{Interval, duty, positive, pwm_frequency_hz};

/// Carrier board with its chips and connectors.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Carrier {
    /// Name of the carrier.
    pub name: String,
    /// Type of the microcontroller.
    pub mcu: String,
    /// Pins with a function, each once.
    pub pins: Vec<Pin>,
    /// Clock of the firmware.
    pub time: Time,
    /// Bus with the board's own chips.
    pub i2c: I2c,
    /// OSMC bridges and their PWM chip.
    pub osmc: Osmc,
    /// Dual H-bridges and their PWM chip.
    pub dhb: Dhb,
    /// RC servos and their PWM chip.
    pub servo: Servo,
    /// Brushless drives, their DAC and their port expander.
    pub bldc: Bldc,
    /// Relays on the port expander.
    pub relay: Relay,
    /// Step/direction drivers and their timing.
    pub stepper: Stepper,
    /// Connectors of quadrature encoders.
    pub encoder: Encoder,
    /// Ultrasonic range sensor connectors.
    pub range: RangeSensors,
    /// Analog inputs behind voltage dividers.
    pub analog: Analog,
    /// Analog outputs of the microcontroller.
    pub dac: Dac,
    /// Lines of the safety functions.
    pub safety: Safety,
    /// Power supply of the board.
    pub supply: Supply,
}

impl Carrier {
    /// Returns the pin with the function `id`.
    #[must_use]
    pub fn pin(&self, id: &str) -> Option<&Pin> {
        self.pins.iter().find(|pin| pin.id == id)
    }

    /// Returns the I2C chip named `id`.
    #[must_use]
    pub fn device(&self, id: &str) -> Option<&Device> {
        self.i2c.devices.iter().find(|device| device.id == id)
    }

    /// Returns the address of a chip that another field names; that it exists has been checked.
    pub(crate) fn address(&self, id: &str) -> u8 {
        self.device(id).map_or(0, |device| device.address)
    }
}

/// Clock of the firmware.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Time {
    /// Name of the timer that keeps the time; no pin may need it.
    pub timer: String,
}

/// I2C bus of the board's own chips.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct I2c {
    /// Pin of the data line.
    pub sda: String,
    /// Pin of the clock line.
    pub scl: String,
    /// Frequency of the clock, Hz.
    pub rate_hz: u32,
    /// Chips on the bus.
    pub devices: Vec<Device>,
    /// Addresses that no other chip may have.
    pub reserved: Vec<ReservedAddress>,
}

/// Chip on the I2C bus.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Device {
    /// Name by which the rest of the file refers to it.
    pub id: String,
    /// Type of the chip.
    pub chip: Chip,
    /// I2C address, 7 bits.
    pub address: u8,
    /// Purpose of the chip, for people.
    pub role: String,
}

/// Type of a chip on the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Chip {
    /// PWM chip with 16 outputs.
    Pca9685,
    /// Port expander with 16 lines.
    Mcp23017,
    /// DAC with four outputs of 12 bits.
    Mcp4728,
}

/// Address that is not a chip's own.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReservedAddress {
    /// I2C address, 7 bits.
    pub address: u8,
    /// Reason why it is reserved: the chips that answer to it.
    pub why: String,
}

/// OSMC bridges behind a PWM chip.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Osmc {
    /// Name of the PWM chip.
    pub pwm: String,
    /// Frequency of the PWM, Hz.
    #[serde(deserialize_with = "pwm_frequency_hz")]
    pub frequency_hz: f32,
    /// Highest duty of a robot whose file gives none.
    #[serde(deserialize_with = "duty")]
    pub duty_max_default: f32,
    /// Highest duty that a robot's file may give.
    #[serde(deserialize_with = "duty")]
    pub duty_max_hard: f32,
    /// Number of PWM periods with all low sides off between two directions.
    pub reversal_wait_periods: u8,
    /// Pin of the DISABLE input of the bridges.
    pub disable: String,
    /// PWM outputs of each connector.
    #[serde(deserialize_with = "bridges")]
    pub connectors: Vec<BridgeLines>,
}

/// Reads bridge lines strictly: [`BridgeLines`] is the wire's type and accepts unknown fields, which the file must not
/// have.
fn bridges<'de, D: serde::Deserializer<'de>>(deserializer: D) -> Result<Vec<BridgeLines>, D::Error> {
    #[derive(Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Lines {
        ahi: u8,
        ali: u8,
        bhi: u8,
        bli: u8,
    }
    let lines = Vec::<Lines>::deserialize(deserializer)?;
    Ok(lines.into_iter().map(|Lines { ahi, ali, bhi, bli }| BridgeLines { ahi, ali, bhi, bli }).collect())
}

/// Dual H-bridges behind a PWM chip.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Dhb {
    /// Name of the PWM chip.
    pub pwm: String,
    /// Frequency of the PWM, Hz.
    #[serde(deserialize_with = "pwm_frequency_hz")]
    pub frequency_hz: f32,
    /// Highest duty of a robot whose file gives none.
    #[serde(deserialize_with = "duty")]
    pub duty_max_default: f32,
    /// Highest duty that a robot's file may give.
    #[serde(deserialize_with = "duty")]
    pub duty_max_hard: f32,
    /// PWM outputs of each motor.
    #[serde(deserialize_with = "dual_bridges")]
    pub connectors: Vec<DhbLines>,
}

/// Reads the lines of dual bridges strictly, as [`bridges`] does.
fn dual_bridges<'de, D: serde::Deserializer<'de>>(deserializer: D) -> Result<Vec<DhbLines>, D::Error> {
    #[derive(Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Lines {
        in1: u8,
        in2: u8,
        en: u8,
    }
    let lines = Vec::<Lines>::deserialize(deserializer)?;
    Ok(lines.into_iter().map(|Lines { in1, in2, en }| DhbLines { in1, in2, en }).collect())
}

/// RC servos behind a PWM chip.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Servo {
    /// Name of the PWM chip.
    pub pwm: String,
    /// Repetition rate of the pulses, Hz.
    #[serde(deserialize_with = "pwm_frequency_hz")]
    pub frequency_hz: f32,
    /// Range of pulse widths of a robot whose file gives none, s.
    pub pulse_default_s: Interval,
    /// Range of pulse widths that a robot's file may give, s.
    pub pulse_hard_s: Interval,
    /// PWM output of each servo.
    pub outputs: Vec<u8>,
}

/// Brushless drives: speed from a DAC, direction and brake from a port expander.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Bldc {
    /// Name of the DAC.
    pub dac: String,
    /// Full scale of the DAC, V.
    #[serde(deserialize_with = "positive")]
    pub dac_full_scale_v: f32,
    /// Pin of the DAC's LDAC input.
    pub load_dac: String,
    /// Name of the port expander.
    pub expander: String,
    /// Lines of each drive.
    pub connectors: Vec<BldcLines>,
}

/// Lines of one brushless drive.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BldcLines {
    /// Output of the DAC for the speed, 0 to 3.
    pub speed: u8,
    /// Bit of the expander for the direction, 0 to 15.
    pub direction: u8,
    /// Bit of the expander for the brake, 0 to 15.
    pub brake: u8,
}

/// Relays behind a port expander.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Relay {
    /// Name of the port expander.
    pub expander: String,
    /// Expander bit of each relay, 0 to 15.
    pub outputs: Vec<u8>,
    /// Number of the relay in the motors' supply.
    pub motor_power: u8,
    /// Number of the relay in the vehicle's ignition.
    pub ignition: u8,
}

/// Step/direction drivers and their timing.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stepper {
    /// Pin of the enable line that all drivers share.
    pub enable: String,
    /// Shortest high and shortest low time of a step pulse, s.
    #[serde(deserialize_with = "positive")]
    pub pulse_min_s: f32,
    /// Time for which the direction is stable before and after a step, s.
    #[serde(deserialize_with = "positive")]
    pub direction_setup_s: f32,
    /// Time from enabling to the first step, s.
    #[serde(deserialize_with = "positive")]
    pub enable_setup_s: f32,
    /// Highest step rate, Hz.
    #[serde(deserialize_with = "positive")]
    pub rate_max_hz: f32,
    /// Pins of each driver.
    pub connectors: Vec<StepperPins>,
}

/// Pins of one step/direction driver.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StepperPins {
    /// Pin of the step output.
    pub step: String,
    /// Pin of the direction output.
    pub direction: String,
}

/// Connectors of quadrature encoders.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Encoder {
    /// Pins of each encoder.
    pub connectors: Vec<EncoderPins>,
}

/// Pins of one quadrature encoder.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EncoderPins {
    /// Pin of track A.
    pub a: String,
    /// Pin of track B.
    pub b: String,
    /// Pin of the switch beside the encoder.
    pub switch: String,
}

/// Connectors of ultrasonic range sensors, and their timing.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RangeSensors {
    /// Length of the trigger pulse, s.
    #[serde(deserialize_with = "positive")]
    pub trigger_s: f32,
    /// Shortest time between two triggers, s.
    #[serde(deserialize_with = "positive")]
    pub cycle_s: f32,
    /// Range of distances that the sensors can measure, m.
    pub range_m: Interval,
    /// Pins of each sensor.
    pub connectors: Vec<RangePins>,
}

/// Pins of one range sensor.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RangePins {
    /// Pin of the trigger output.
    pub trigger: String,
    /// Pin of the echo input.
    pub echo: String,
}

/// Analog inputs behind voltage dividers.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Analog {
    /// Reference of the converter, V.
    #[serde(deserialize_with = "positive")]
    pub reference_v: f64,
    /// Voltage before the divider at the highest code, V: nominal, until an input is calibrated.
    #[serde(deserialize_with = "positive")]
    pub full_scale_v: f64,
    /// Highest code of the converter.
    #[serde(deserialize_with = "positive")]
    pub code_max: u16,
    /// Pin of each input.
    pub inputs: Vec<String>,
}

impl Analog {
    /// Returns the volts before the divider for one code of the converter.
    #[must_use]
    pub fn volts_per_code(&self) -> f64 {
        self.full_scale_v / f64::from(self.code_max)
    }

    /// Returns the ratio of the voltage before the divider to that behind it.
    #[must_use]
    pub fn divider_ratio(&self) -> f64 {
        self.full_scale_v / self.reference_v
    }
}

/// Analog outputs of the microcontroller.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Dac {
    /// Voltage at the highest code, V.
    #[serde(deserialize_with = "positive")]
    pub full_scale_v: f32,
    /// Pin of each output.
    pub outputs: Vec<String>,
}

/// Pins of the safety functions.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Safety {
    /// Pin that senses the dead-man's handle; low is released.
    pub dead_man: String,
    /// Pin of the auxiliary stop input.
    pub stop: String,
    /// Pin of the output that toggles while the firmware is alive.
    pub heartbeat: String,
    /// Pin of the output enable of the motors' PWM chips; high is off.
    pub motor_output_enable_n: String,
}

/// Power supply of the board.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Supply {
    /// Nominal input voltage, V.
    #[serde(deserialize_with = "positive")]
    pub input_v: f32,
    /// Rated current of the printed circuit board, A.
    #[serde(deserialize_with = "positive")]
    pub current_max_a: f32,
}
