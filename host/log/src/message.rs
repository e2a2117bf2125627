//! The JSON messages and their schemas.

use r4_protocol::{ChannelInfo, Quality, SafetyState, Unit};
use serde::{Deserialize, Serialize};

/// Topic of [`StateMessage`].
pub(crate) const STATE_TOPIC: &str = "/state";
/// Topic of [`CommandMessage`].
pub(crate) const COMMAND_TOPIC: &str = "/command";
/// Topic of [`crate::request::RequestMessage`].
pub(crate) const REQUEST_TOPIC: &str = "/request";
/// Topic of [`crate::request::RefusalMessage`].
pub(crate) const REFUSAL_TOPIC: &str = "/refusal";

/// `None` for what JSON cannot hold.
pub(crate) fn finite(value: f32) -> Option<f32> {
    value.is_finite().then_some(value)
}

/// A motor sample. Either the rotary or the linear fields are present.
///
/// `f32` as on the wire: the shortest decimal that means it, half as long as the same number written as `f64`.
#[derive(Serialize, Deserialize)]
pub(crate) struct MotorMessage<'a> {
    pub(crate) setpoint_mode: &'a str,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) setpoint: Option<f32>,
    pub(crate) position_counts: i32,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) position_rad: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) position_m: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) speed_rad_s: Option<f32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) speed_m_s: Option<f32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) duty: Option<f32>,
    pub(crate) settled: bool,
    /// Not in the first logs of this format.
    #[serde(default)]
    pub(crate) homed: bool,
}

/// A sample of an encoder.
#[derive(Serialize, Deserialize)]
pub(crate) struct EncoderMessage {
    pub(crate) position_counts: i32,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) position_rad: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) speed_rad_s: Option<f32>,
    pub(crate) illegal: u32,
}

/// A sample with one number: the field named after the channel's unit is present, and the last two of an input that can
/// fail.
#[derive(Default, Serialize, Deserialize)]
pub(crate) struct ScalarMessage<'a> {
    #[serde(default, skip_serializing_if = "Option::is_none")]
    angle_rad: Option<f32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    speed_rad_s: Option<f32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    distance_m: Option<f32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    speed_m_s: Option<f32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    duty: Option<f32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    voltage_v: Option<f32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    on: Option<bool>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) age_ms: Option<u16>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) quality: Option<&'a str>,
}

impl ScalarMessage<'_> {
    pub(crate) fn new(unit: Unit, value: f32) -> Self {
        let value = finite(value);
        let mut message = Self::default();
        match unit {
            Unit::Rad => message.angle_rad = value,
            Unit::RadPerS => message.speed_rad_s = value,
            Unit::M => message.distance_m = value,
            Unit::MPerS => message.speed_m_s = value,
            Unit::Duty => message.duty = value,
            Unit::V => message.voltage_v = value,
            Unit::Bool => message.on = value.map(|value| value != 0.0),
        }
        message
    }

    pub(crate) fn value(&self, unit: Unit) -> Option<f32> {
        match unit {
            Unit::Rad => self.angle_rad,
            Unit::RadPerS => self.speed_rad_s,
            Unit::M => self.distance_m,
            Unit::MPerS => self.speed_m_s,
            Unit::Duty => self.duty,
            Unit::V => self.voltage_v,
            Unit::Bool => self.on.map(|on| if on { 1.0 } else { 0.0 }),
        }
    }
}

/// Where the safety supervisor stands.
#[derive(Serialize, Deserialize)]
pub(crate) struct StateMessage<'a> {
    #[serde(borrow)]
    pub(crate) state: &'a str,
    /// For people; a cause that this version does not know is only in `causes_bits`.
    #[serde(default)]
    pub(crate) causes: Vec<String>,
    pub(crate) causes_bits: u16,
}

/// A command that was sent.
#[derive(Serialize, Deserialize)]
pub(crate) struct CommandMessage<'a> {
    pub(crate) channel: &'a str,
    pub(crate) setpoint_mode: &'a str,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) setpoint: Option<f32>,
    /// Not in the first logs of this format.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) sent_us: Option<u64>,
}

pub(crate) fn state_name(state: SafetyState) -> &'static str {
    match state {
        SafetyState::Disarmed => "disarmed",
        SafetyState::Armed => "armed",
        SafetyState::Tripped => "tripped",
    }
}

pub(crate) fn state_from(name: &str) -> Option<SafetyState> {
    [SafetyState::Disarmed, SafetyState::Armed, SafetyState::Tripped]
        .into_iter()
        .find(|state| state_name(*state) == name)
}

const QUALITIES: [(Quality, &str); 7] = [
    (Quality::Good, "good"),
    (Quality::None, "none"),
    (Quality::OutOfRange, "out-of-range"),
    (Quality::NoAnswer, "no-answer"),
    (Quality::Stuck, "stuck"),
    (Quality::Low, "low"),
    (Quality::High, "high"),
];

/// The name of `quality` in a file.
pub(crate) fn quality_name(quality: Quality) -> &'static str {
    QUALITIES[quality as usize].1
}

/// The quality of that name.
pub(crate) fn quality_from(name: &str) -> Option<Quality> {
    QUALITIES.into_iter().find(|(_, known)| *known == name).map(|(quality, _)| quality)
}

/// Whether the channel moves in a line; otherwise its fields are rotary.
pub(crate) fn is_linear(info: &ChannelInfo) -> bool {
    let linear = |unit| matches!(unit, Unit::M | Unit::MPerS);
    linear(info.unit) || info.modes.iter().any(|mode| linear(mode.unit))
}

/// A JSON Schema with the name under which a viewer lists it.
pub(crate) struct Schema {
    pub(crate) name: String,
    pub(crate) json: String,
}

/// `fields`: name, JSON type, meaning.
pub(crate) fn schema(name: &str, fields: &[(&str, &str, &str)]) -> Schema {
    let properties: Vec<String> = fields
        .iter()
        .map(|(field, kind, meaning)| {
            // JSON Schema asks for the type of the items; the only arrays here hold text
            let items = if *kind == "array" { r#","items":{"type":"string"}"# } else { "" };
            format!(r#""{field}":{{"type":"{kind}"{items},"description":"{meaning}"}}"#)
        })
        .collect();
    let json = format!(r#"{{"title":"{name}","type":"object","properties":{{{}}}}}"#, properties.join(","));
    Schema { name: name.to_owned(), json }
}

pub(crate) const ROTARY_MOTOR: &str = "r4.RotaryMotor";
pub(crate) const LINEAR_MOTOR: &str = "r4.LinearMotor";
pub(crate) const ENCODER: &str = "r4.Encoder";
pub(crate) const REQUEST: &str = "r4.Request";
pub(crate) const REFUSAL: &str = "r4.Refusal";
/// Ends the names of the schemas of inputs that can fail.
pub(crate) const READING: &str = "Reading";

pub(crate) const SENT_US: (&str, &str, &str) =
    ("sent_us", "integer", "When it was sent: since the host said hello, by its clock, us");

const SETPOINT_MODE: &str = "What the set point is: position, speed, duty, switch, voltage, brake or home";

pub(crate) fn motor_schema(linear: bool) -> Schema {
    let (name, position, speed, unit) = if linear {
        (LINEAR_MOTOR, ("position_m", "Position, m"), ("speed_m_s", "Speed, m/s"), "m, m/s")
    } else {
        (
            ROTARY_MOTOR,
            ("position_rad", "Angle of the output shaft, rad"),
            ("speed_rad_s", "Speed of the output shaft, rad/s"),
            "rad, rad/s",
        )
    };
    schema(
        name,
        &[
            ("setpoint_mode", "string", SETPOINT_MODE),
            ("setpoint", "number", &format!("Set point, {unit} or share of the supply, by setpoint_mode")),
            ("position_counts", "integer", "Position as measured, counts"),
            (position.0, "number", position.1),
            (speed.0, "number", speed.1),
            ("duty", "number", "Share of the supply at the bridge, -1 to 1"),
            ("settled", "boolean", "At the set point and at rest"),
            ("homed", "boolean", "Whether the position is known, and not only counted from where power came on"),
        ],
    )
}

/// The field of a channel that has one number in `unit`.
pub(crate) fn scalar_field(unit: Unit) -> &'static str {
    scalar(unit).1.0
}

/// Name of the schema, and the field.
fn scalar(unit: Unit) -> (&'static str, (&'static str, &'static str, &'static str)) {
    match unit {
        Unit::Rad => ("r4.Angle", ("angle_rad", "number", "Angle, rad")),
        Unit::RadPerS => ("r4.RotarySpeed", ("speed_rad_s", "number", "Speed, rad/s")),
        Unit::M => ("r4.Distance", ("distance_m", "number", "Distance, m")),
        Unit::MPerS => ("r4.LinearSpeed", ("speed_m_s", "number", "Speed, m/s")),
        Unit::Duty => ("r4.Duty", ("duty", "number", "Share of the supply, -1 to 1")),
        Unit::V => ("r4.Voltage", ("voltage_v", "number", "Voltage, V")),
        Unit::Bool => ("r4.Switch", ("on", "boolean", "On or off")),
    }
}

pub(crate) fn scalar_schema(unit: Unit) -> Schema {
    let (name, field) = scalar(unit);
    schema(name, &[field])
}

pub(crate) fn reading_schema(unit: Unit) -> Schema {
    let (name, field) = scalar(unit);
    let names: Vec<&str> = QUALITIES.iter().map(|(_, name)| *name).collect();
    let quality = format!("Whether it can be relied on: {}", names.join(", "));
    let age = ("age_ms", "integer", "Since it was measured, ms");
    schema(&format!("{name}{READING}"), &[field, age, ("quality", "string", &quality)])
}

pub(crate) fn encoder_schema() -> Schema {
    schema(
        ENCODER,
        &[
            ("position_counts", "integer", "Position, counts"),
            ("position_rad", "number", "Angle of the shaft, rad"),
            ("speed_rad_s", "number", "Speed of the shaft, rad/s"),
            ("illegal", "integer", "Transitions that no shaft makes, since power-up"),
        ],
    )
}

pub(crate) fn state_schema() -> Schema {
    schema(
        "r4.SafetyState",
        &[
            ("state", "string", "Safety state: disarmed, armed or tripped"),
            ("causes", "array", "Causes latched by a trip"),
            ("causes_bits", "integer", "The same causes as bits"),
        ],
    )
}

pub(crate) fn command_schema() -> Schema {
    schema(
        "r4.Command",
        &[
            ("channel", "string", "Channel commanded"),
            ("setpoint_mode", "string", SETPOINT_MODE),
            ("setpoint", "number", "Set point, SI, share of the supply, or 0 or 1, by setpoint_mode"),
            SENT_US,
        ],
    )
}
