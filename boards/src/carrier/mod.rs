//! What is on a carrier board, as in its file; sources and reasons are in the comments there.

mod check;
mod pin;

use r4_protocol::config::{BridgeLines, DhbLines};
use serde::Deserialize;

pub(crate) use check::read;
pub use pin::{NotAPin, Pin, PinKind, Stm32Pin};

use crate::number::{Interval, duty, positive, pwm_frequency_hz};

/// A carrier board.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Carrier {
    /// Its name.
    pub name: String,
    /// The microcontroller.
    pub mcu: String,
    /// Every pin with a function, each once.
    pub pins: Vec<Pin>,
    /// The clock of the firmware.
    pub time: Time,
    /// The bus with the board's own chips.
    pub i2c: I2c,
    /// OSMC bridges.
    pub osmc: Osmc,
    /// Dual H-bridges.
    pub dhb: Dhb,
    /// RC servos.
    pub servo: Servo,
    /// Brushless drives.
    pub bldc: Bldc,
    /// Relays.
    pub relay: Relay,
    /// Step/direction drivers.
    pub stepper: Stepper,
    /// Quadrature encoders.
    pub encoder: Encoder,
    /// Ultrasonic range sensors.
    pub range: RangeSensors,
    /// Divided analog inputs.
    pub analog: Analog,
    /// Digital-to-analog outputs.
    pub dac: Dac,
    /// Lines of the safety functions.
    pub safety: Safety,
    /// Power into the board.
    pub supply: Supply,
}

impl Carrier {
    /// The pin with the function `id`.
    #[must_use]
    pub fn pin(&self, id: &str) -> Option<&Pin> {
        self.pins.iter().find(|pin| pin.id == id)
    }

    /// The I2C chip named `id`.
    #[must_use]
    pub fn device(&self, id: &str) -> Option<&Device> {
        self.i2c.devices.iter().find(|device| device.id == id)
    }

    /// The address of a chip that other fields name, so that it is there.
    pub(crate) fn address(&self, id: &str) -> u8 {
        self.device(id).map_or(0, |device| device.address)
    }
}

/// The clock of the firmware.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Time {
    /// The timer that keeps it; no pin may need it.
    pub timer: String,
}

/// The I2C bus of the board's own chips.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct I2c {
    /// Pin of the data line.
    pub sda: String,
    /// Pin of the clock line.
    pub scl: String,
    /// Clock.
    pub rate_hz: u32,
    /// Chips on the bus.
    pub devices: Vec<Device>,
    /// Addresses that nothing else may have.
    pub reserved: Vec<ReservedAddress>,
}

/// A chip on the I2C bus.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Device {
    /// Name by which the rest of the file refers to it.
    pub id: String,
    /// Which chip.
    pub chip: Chip,
    /// 7-bit address.
    pub address: u8,
    /// What it does, for people.
    pub role: String,
}

/// The kinds of chip.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Chip {
    /// 16-channel PWM.
    Pca9685,
    /// 16-bit port expander.
    Mcp23017,
    /// Quad 12-bit DAC.
    Mcp4728,
}

/// An address that is not a chip's own.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReservedAddress {
    /// 7-bit address.
    pub address: u8,
    /// What answers to it.
    pub why: String,
}

/// OSMC bridges behind a PWM chip.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Osmc {
    /// The PWM chip.
    pub pwm: String,
    /// PWM frequency.
    #[serde(deserialize_with = "pwm_frequency_hz")]
    pub frequency_hz: f32,
    /// Highest duty of a robot whose file names none.
    #[serde(deserialize_with = "duty")]
    pub duty_max_default: f32,
    /// Highest duty that a robot's file may name.
    #[serde(deserialize_with = "duty")]
    pub duty_max_hard: f32,
    /// PWM periods with all low sides off between two directions.
    pub reversal_wait_periods: u8,
    /// Pin of the bridges' DISABLE.
    pub disable: String,
    /// PWM outputs of each connector.
    #[serde(deserialize_with = "bridges")]
    pub connectors: Vec<BridgeLines>,
}

/// [`BridgeLines`] is the wire's type and lets unknown fields pass; the file's type does not.
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
    /// The PWM chip.
    pub pwm: String,
    /// PWM frequency.
    #[serde(deserialize_with = "pwm_frequency_hz")]
    pub frequency_hz: f32,
    /// Highest duty of a robot whose file names none.
    #[serde(deserialize_with = "duty")]
    pub duty_max_default: f32,
    /// Highest duty that a robot's file may name.
    #[serde(deserialize_with = "duty")]
    pub duty_max_hard: f32,
    /// PWM outputs of each motor.
    #[serde(deserialize_with = "dual_bridges")]
    pub connectors: Vec<DhbLines>,
}

/// As [`bridges`].
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
    /// The PWM chip.
    pub pwm: String,
    /// Repetition of the pulses.
    #[serde(deserialize_with = "pwm_frequency_hz")]
    pub frequency_hz: f32,
    /// Pulse widths of a robot whose file names none.
    pub pulse_default_s: Interval,
    /// Pulse widths that a robot's file may name.
    pub pulse_hard_s: Interval,
    /// PWM output of each servo.
    pub outputs: Vec<u8>,
}

/// Brushless drives: speed from a DAC, direction and brake from a port expander.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Bldc {
    /// The DAC.
    pub dac: String,
    /// Its full scale.
    #[serde(deserialize_with = "positive")]
    pub dac_full_scale_v: f32,
    /// Pin of the DAC's LDAC.
    pub load_dac: String,
    /// The port expander.
    pub expander: String,
    /// Lines of each drive.
    pub connectors: Vec<BldcLines>,
}

/// Lines of one brushless drive.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BldcLines {
    /// DAC output, 0 to 3.
    pub speed: u8,
    /// Expander bit, 0 to 15.
    pub direction: u8,
    /// Expander bit, 0 to 15.
    pub brake: u8,
}

/// Relays behind a port expander.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Relay {
    /// The port expander.
    pub expander: String,
    /// Expander bit of each relay, 0 to 15.
    pub outputs: Vec<u8>,
    /// The relay in the motors' supply.
    pub motor_power: u8,
    /// The relay in the vehicle's ignition.
    pub ignition: u8,
}

/// Step/direction drivers.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stepper {
    /// Pin of the enable that all share.
    pub enable: String,
    /// Shortest high and shortest low of a step pulse.
    #[serde(deserialize_with = "positive")]
    pub pulse_min_s: f32,
    /// Direction stable before and after a step.
    #[serde(deserialize_with = "positive")]
    pub direction_setup_s: f32,
    /// Enable before the first step.
    #[serde(deserialize_with = "positive")]
    pub enable_setup_s: f32,
    /// Most steps per second.
    #[serde(deserialize_with = "positive")]
    pub rate_max_hz: f32,
    /// Pins of each driver.
    pub connectors: Vec<StepperPins>,
}

/// Pins of one step/direction driver.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StepperPins {
    /// Step.
    pub step: String,
    /// Direction.
    pub direction: String,
}

/// Quadrature encoders.
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
    /// Track A.
    pub a: String,
    /// Track B.
    pub b: String,
    /// The switch beside it.
    pub switch: String,
}

/// Ultrasonic range sensors.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RangeSensors {
    /// Length of the trigger pulse.
    #[serde(deserialize_with = "positive")]
    pub trigger_s: f32,
    /// Shortest time between two triggers.
    #[serde(deserialize_with = "positive")]
    pub cycle_s: f32,
    /// What they can measure.
    pub range_m: Interval,
    /// Pins of each sensor.
    pub connectors: Vec<RangePins>,
}

/// Pins of one range sensor.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RangePins {
    /// Trigger.
    pub trigger: String,
    /// Echo.
    pub echo: String,
}

/// Divided analog inputs.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Analog {
    /// Reference of the converter.
    #[serde(deserialize_with = "positive")]
    pub reference_v: f64,
    /// Voltage before the divider at the highest code: nominal, until an input is calibrated.
    #[serde(deserialize_with = "positive")]
    pub full_scale_v: f64,
    /// Highest code of the converter.
    #[serde(deserialize_with = "positive")]
    pub code_max: u16,
    /// Pin of each input.
    pub inputs: Vec<String>,
}

impl Analog {
    /// Volts before the divider for one count of the converter.
    #[must_use]
    pub fn volts_per_code(&self) -> f64 {
        self.full_scale_v / f64::from(self.code_max)
    }

    /// How much the divider divides by.
    #[must_use]
    pub fn divider_ratio(&self) -> f64 {
        self.full_scale_v / self.reference_v
    }
}

/// Digital-to-analog outputs of the microcontroller.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Dac {
    /// Voltage at the highest code.
    #[serde(deserialize_with = "positive")]
    pub full_scale_v: f32,
    /// Pin of each output.
    pub outputs: Vec<String>,
}

/// Pins of the safety functions.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Safety {
    /// Sense of the dead-man's handle; low is released.
    pub dead_man: String,
    /// Auxiliary stop input.
    pub stop: String,
    /// Output that moves while the firmware is alive.
    pub heartbeat: String,
    /// Output enable of the motors' PWM chips; high is off.
    pub motor_output_enable_n: String,
}

/// Power into the board.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Supply {
    /// Nominal voltage.
    #[serde(deserialize_with = "positive")]
    pub input_v: f32,
    /// What the printed circuit board is rated for.
    #[serde(deserialize_with = "positive")]
    pub current_max_a: f32,
}
