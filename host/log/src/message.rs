//! JSON messages of a log and their schemas.

use std::{borrow::Cow, collections::BTreeMap, fmt};

use r4_protocol::{ChannelInfo, ChannelKind, Mode, Quality, SafetyState, Setpoint, Unit};
use serde::{
    Deserialize, Deserializer, Serialize, Serializer,
    de::{Error as _, MapAccess, Visitor},
    ser::SerializeMap as _,
};

use crate::header::{mode_from, mode_name};

/// Topic of the state messages, [`StateMessage`].
pub(crate) const STATE_TOPIC: &str = "/state";
/// Topic of the commands, [`CommandMessage`].
pub(crate) const COMMAND_TOPIC: &str = "/command";
/// Topic of the other requests, [`crate::request::RequestMessage`].
pub(crate) const REQUEST_TOPIC: &str = "/request";
/// Topic of the refusals, [`crate::request::RefusalMessage`].
pub(crate) const REFUSAL_TOPIC: &str = "/refusal";
/// Topic of the gaps, [`GapMessage`].
pub(crate) const GAP_TOPIC: &str = "/gap";

/// Returns `None` for a number that JSON cannot hold: infinite or NaN.
pub(crate) fn finite(value: f32) -> Option<f32> {
    value.is_finite().then_some(value)
}

/// Defines a struct with the fields of a set point between those before and those after `setpoint`. At most one of
/// them is present, that of its mode and unit, so that each field has one unit.
///
/// The fields are written out because `serde(flatten)` would copy every message before reading it.
macro_rules! with_setpoint {
    (
        $(#[$meta:meta])*
        $name:ident { $($before:tt)* } setpoint { $($after:tt)* }
    ) => {
        $(#[$meta])*
        #[derive(Default, Serialize, Deserialize)]
        pub(crate) struct $name<'a> {
            $($before)*
            pub(crate) setpoint_mode: &'a str,
            /// Set point in any unit; only in logs of format 1.
            #[serde(default, skip_serializing)]
            pub(crate) setpoint: Option<f32>,
            #[serde(default, skip_serializing_if = "Option::is_none")]
            pub(crate) setpoint_position_rad: Option<f32>,
            #[serde(default, skip_serializing_if = "Option::is_none")]
            pub(crate) setpoint_position_m: Option<f32>,
            #[serde(default, skip_serializing_if = "Option::is_none")]
            pub(crate) setpoint_speed_rad_s: Option<f32>,
            #[serde(default, skip_serializing_if = "Option::is_none")]
            pub(crate) setpoint_speed_m_s: Option<f32>,
            #[serde(default, skip_serializing_if = "Option::is_none")]
            pub(crate) setpoint_home_rad_s: Option<f32>,
            #[serde(default, skip_serializing_if = "Option::is_none")]
            pub(crate) setpoint_home_m_s: Option<f32>,
            #[serde(default, skip_serializing_if = "Option::is_none")]
            pub(crate) setpoint_duty: Option<f32>,
            #[serde(default, skip_serializing_if = "Option::is_none")]
            pub(crate) setpoint_voltage_v: Option<f32>,
            #[serde(default, skip_serializing_if = "Option::is_none")]
            pub(crate) setpoint_switch: Option<f32>,
            #[serde(default, skip_serializing_if = "Option::is_none")]
            pub(crate) setpoint_brake: Option<f32>,
            #[serde(default, skip_serializing_if = "Option::is_none")]
            pub(crate) setpoint_force_n: Option<f32>,
            $($after)*
        }

        impl $name<'_> {
            /// Returns the message with this set point, of a channel that moves linearly (`linear`) or turns.
            pub(crate) fn with_setpoint(mut self, setpoint: Setpoint, linear: bool) -> Self {
                let field = match (setpoint.mode, linear) {
                    (Mode::Position | Mode::Follow, false) => &mut self.setpoint_position_rad,
                    (Mode::Position | Mode::Follow, true) => &mut self.setpoint_position_m,
                    (Mode::Speed, false) => &mut self.setpoint_speed_rad_s,
                    (Mode::Speed, true) => &mut self.setpoint_speed_m_s,
                    (Mode::Home, false) => &mut self.setpoint_home_rad_s,
                    (Mode::Home, true) => &mut self.setpoint_home_m_s,
                    (Mode::Duty, _) => &mut self.setpoint_duty,
                    (Mode::Voltage, _) => &mut self.setpoint_voltage_v,
                    (Mode::Switch, _) => &mut self.setpoint_switch,
                    (Mode::Brake, _) => &mut self.setpoint_brake,
                    (Mode::Force, _) => &mut self.setpoint_force_n,
                };
                *field = finite(setpoint.value);
                self.setpoint_mode = mode_name(setpoint.mode);
                self
            }

            /// Returns the set point's number; `None` if it was not finite.
            pub(crate) fn setpoint(&self) -> Option<f32> {
                let by_mode = match mode_from(self.setpoint_mode)? {
                    Mode::Position | Mode::Follow => self.setpoint_position_rad.or(self.setpoint_position_m),
                    Mode::Speed => self.setpoint_speed_rad_s.or(self.setpoint_speed_m_s),
                    Mode::Home => self.setpoint_home_rad_s.or(self.setpoint_home_m_s),
                    Mode::Duty => self.setpoint_duty,
                    Mode::Voltage => self.setpoint_voltage_v,
                    Mode::Switch => self.setpoint_switch,
                    Mode::Brake => self.setpoint_brake,
                    Mode::Force => self.setpoint_force_n,
                };
                by_mode.or(self.setpoint)
            }
        }
    };
}

with_setpoint! {
/// Sample of a motor channel. Either the rotary or the linear fields are present.
///
/// `f32` as on the wire: its shortest decimal is half as long as that of the same number written as `f64`.
MotorMessage {} setpoint {
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
    /// Absent from the first logs, which then read `false`.
    #[serde(default)]
    pub(crate) homed: bool,
    /// Only of boards that compute it, from protocol 7 on.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) winding_heat: Option<f32>,
}
}

/// Sample of an encoder channel.
#[derive(Serialize, Deserialize)]
pub(crate) struct EncoderMessage {
    pub(crate) position_counts: i32,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) position_rad: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) speed_rad_s: Option<f32>,
    pub(crate) illegal: u32,
}

/// Sample with one number, in the field named after the channel's unit. `age_ms` and `quality` are present for an
/// input that can fail.
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
    acceleration_m_s2: Option<f32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    current_a: Option<f32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    force_n: Option<f32>,
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
            Unit::MPerS2 => message.acceleration_m_s2 = value,
            Unit::A => message.current_a = value,
            Unit::N => message.force_n = value,
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
            Unit::MPerS2 => self.acceleration_m_s2,
            Unit::A => self.current_a,
            Unit::N => self.force_n,
        }
    }
}

/// Sample of a sensor that measures several numbers together. Each finite number is in the field that its kind names.
///
/// Serialisation is written out for the reason given at `with_setpoint`, and because a flattened number cannot be
/// read if serde_json keeps numbers as text, which another crate of the same program may ask for.
pub(crate) struct SensorMessage<'a> {
    values: BTreeMap<Cow<'a, str>, f32>,
    pub(crate) age_ms: u16,
    pub(crate) quality: Cow<'a, str>,
}

impl Serialize for SensorMessage<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(Some(self.values.len() + 2))?;
        for (field, value) in &self.values {
            map.serialize_entry(field, value)?;
        }
        map.serialize_entry("age_ms", &self.age_ms)?;
        map.serialize_entry("quality", &self.quality)?;
        map.end()
    }
}

impl<'de> Deserialize<'de> for SensorMessage<'de> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Fields;

        impl<'de> Visitor<'de> for Fields {
            type Value = SensorMessage<'de>;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a sample of a sensor: numbers, age_ms and quality")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
                let (mut values, mut age_ms, mut quality) = (BTreeMap::new(), None, None);
                while let Some(field) = map.next_key::<Cow<'de, str>>()? {
                    match &*field {
                        "age_ms" => age_ms = Some(map.next_value()?),
                        "quality" => quality = Some(map.next_value()?),
                        _ => {
                            values.insert(field, map.next_value()?);
                        }
                    }
                }
                Ok(SensorMessage {
                    values,
                    age_ms: age_ms.ok_or_else(|| A::Error::missing_field("age_ms"))?,
                    quality: quality.ok_or_else(|| A::Error::missing_field("quality"))?,
                })
            }
        }

        deserializer.deserialize_map(Fields)
    }
}

impl SensorMessage<'_> {
    pub(crate) fn new(kind: ChannelKind, values: &[f32], age_ms: u16, quality: Quality) -> Self {
        let named = kind.quantities().iter().zip(values).filter(|(_, value)| value.is_finite());
        Self {
            values: named.map(|(quantity, value)| (quantity.field.into(), *value)).collect(),
            age_ms,
            quality: quality_name(quality).into(),
        }
    }

    /// Returns the number in `field`; NaN if it is absent.
    pub(crate) fn value(&self, field: &str) -> f64 {
        self.values.get(field).map_or(f64::NAN, |value| f64::from(*value))
    }
}

/// State of the safety supervisor.
#[derive(Serialize, Deserialize)]
pub(crate) struct StateMessage<'a> {
    #[serde(borrow)]
    pub(crate) state: &'a str,
    /// Causes for people to read; one that this version does not know is only in `causes_bits`.
    #[serde(default)]
    pub(crate) causes: Vec<String>,
    pub(crate) causes_bits: u32,
}

with_setpoint! {
/// Set point that the host sent to a channel.
CommandMessage {
    pub(crate) channel: &'a str,
} setpoint {
    /// Absent from the first logs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) sent_us: Option<u64>,
}
}

/// End of a time without a link.
#[derive(Serialize, Deserialize)]
pub(crate) struct GapMessage {
    pub(crate) without_link_s: f64,
    pub(crate) restarted: bool,
    pub(crate) clock_shift_us: i64,
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

const QUALITIES: [(Quality, &str); 13] = [
    (Quality::Good, "good"),
    (Quality::None, "none"),
    (Quality::OutOfRange, "out-of-range"),
    (Quality::NoAnswer, "no-answer"),
    (Quality::Stuck, "stuck"),
    (Quality::Low, "low"),
    (Quality::High, "high"),
    (Quality::Stale, "stale"),
    (Quality::WrongChip, "wrong-chip"),
    (Quality::Saturated, "saturated"),
    (Quality::NoMagnet, "no-magnet"),
    (Quality::WeakMagnet, "weak-magnet"),
    (Quality::StrongMagnet, "strong-magnet"),
];

/// Returns the name of `quality` in a file, as in `out-of-range`.
#[must_use]
pub fn quality_name(quality: Quality) -> &'static str {
    QUALITIES[quality as usize].1
}

/// Returns the quality with that name; `None` for an unknown one.
pub(crate) fn quality_from(name: &str) -> Option<Quality> {
    QUALITIES.into_iter().find(|(_, known)| *known == name).map(|(quality, _)| quality)
}

/// Returns whether the channel moves linearly; otherwise its fields are rotary.
pub(crate) fn is_linear(info: &ChannelInfo) -> bool {
    // A channel in duty or volts is linear if one of its modes is.
    let linear = |unit| matches!(unit, Unit::M | Unit::MPerS);
    linear(info.unit) || info.modes.iter().any(|mode| linear(mode.unit))
}

/// JSON Schema with the name under which a viewer lists it.
pub(crate) struct Schema {
    pub(crate) name: String,
    pub(crate) json: String,
}

/// Builds the schema of an object. `fields` are name, JSON type and meaning of each. An `array` has strings, `objects` is an
/// array of objects.
pub(crate) fn schema(name: &str, fields: &[(&str, &str, &str)]) -> Schema {
    let properties: Vec<String> = fields
        .iter()
        .map(|(field, kind, meaning)| {
            // A viewer needs the type of an array's items.
            let (kind, items) = match *kind {
                "array" => ("array", r#","items":{"type":"string"}"#),
                "objects" => ("array", r#","items":{"type":"object"}"#),
                kind => (kind, ""),
            };
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
/// End of the schema names of inputs that can fail.
pub(crate) const READING: &str = "Reading";
/// End of the schema names of sensors that measure several numbers together.
pub(crate) const SENSOR: &str = "Sensor";

pub(crate) const SENT_US: (&str, &str, &str) =
    ("sent_us", "integer", "When it was sent: since the host said hello, by its clock, us");

const SETPOINT_MODE: &str =
    "Mode of the set point: position, speed, duty, switch, voltage, brake, home, follow or force";

const ROTARY_SETPOINTS: [(&str, &str, &str); 3] = [
    ("setpoint_position_rad", "number", "Set point in mode position, rad"),
    ("setpoint_speed_rad_s", "number", "Set point in mode speed, rad/s"),
    ("setpoint_home_rad_s", "number", "Set point in mode home, rad/s"),
];
const LINEAR_SETPOINTS: [(&str, &str, &str); 3] = [
    ("setpoint_position_m", "number", "Set point in mode position, m"),
    ("setpoint_speed_m_s", "number", "Set point in mode speed, m/s"),
    ("setpoint_home_m_s", "number", "Set point in mode home, m/s"),
];
const SETPOINTS: [(&str, &str, &str); 5] = [
    ("setpoint_duty", "number", "Set point in mode duty, share of the supply, -1 to 1"),
    ("setpoint_voltage_v", "number", "Set point in mode voltage, V"),
    ("setpoint_switch", "number", "Set point in mode switch, 0 or 1"),
    ("setpoint_brake", "number", "Set point in mode brake, 0 or 1"),
    ("setpoint_force_n", "number", "Set point in mode force, N"),
];

pub(crate) fn motor_schema(linear: bool) -> Schema {
    let (name, position, speed) = if linear {
        (LINEAR_MOTOR, ("position_m", "Position, m"), ("speed_m_s", "Speed, m/s"))
    } else {
        (
            ROTARY_MOTOR,
            ("position_rad", "Angle of the output shaft, rad"),
            ("speed_rad_s", "Speed of the output shaft, rad/s"),
        )
    };
    let mut fields = vec![("setpoint_mode", "string", SETPOINT_MODE)];
    fields.extend(if linear { LINEAR_SETPOINTS } else { ROTARY_SETPOINTS });
    fields.extend(SETPOINTS);
    fields.extend([
        ("position_counts", "integer", "Position as measured, counts"),
        (position.0, "number", position.1),
        (speed.0, "number", speed.1),
        ("duty", "number", "Share of the supply at the bridge, -1 to 1"),
        ("settled", "boolean", "At the set point and at rest"),
        ("homed", "boolean", "Whether the position is known, and not only counted from where power came on"),
        ("winding_heat", "number", "Heat of the winding, share of what it withstands"),
    ]);
    schema(name, &fields)
}

/// Returns the field of a channel that has one number in `unit`.
pub(crate) fn scalar_field(unit: Unit) -> &'static str {
    scalar(unit).1.0
}

/// Returns the name of the schema for `unit`, and its field as name, JSON type and meaning.
fn scalar(unit: Unit) -> (&'static str, (&'static str, &'static str, &'static str)) {
    match unit {
        Unit::Rad => ("r4.Angle", ("angle_rad", "number", "Angle, rad")),
        Unit::RadPerS => ("r4.RotarySpeed", ("speed_rad_s", "number", "Speed, rad/s")),
        Unit::M => ("r4.Distance", ("distance_m", "number", "Distance, m")),
        Unit::MPerS => ("r4.LinearSpeed", ("speed_m_s", "number", "Speed, m/s")),
        Unit::Duty => ("r4.Duty", ("duty", "number", "Share of the supply, -1 to 1")),
        Unit::V => ("r4.Voltage", ("voltage_v", "number", "Voltage, V")),
        Unit::Bool => ("r4.Switch", ("on", "boolean", "On or off")),
        Unit::MPerS2 => ("r4.Acceleration", ("acceleration_m_s2", "number", "Acceleration, m/s2")),
        Unit::A => ("r4.Current", ("current_a", "number", "Current, A")),
        Unit::N => ("r4.Force", ("force_n", "number", "Force, N")),
    }
}

pub(crate) fn scalar_schema(unit: Unit) -> Schema {
    let (name, field) = scalar(unit);
    schema(name, &[field])
}

pub(crate) fn reading_schema(unit: Unit) -> Schema {
    let (name, field) = scalar(unit);
    schema(&format!("{name}{READING}"), &[field, AGE, ("quality", "string", &quality_meaning())])
}

const AGE: (&str, &str, &str) = ("age_ms", "integer", "Since it was measured, ms");

fn quality_meaning() -> String {
    let names: Vec<&str> = QUALITIES.iter().map(|(_, name)| *name).collect();
    format!("Whether it can be relied on: {}", names.join(", "))
}

/// Returns the schema of a sensor that measures several numbers together.
pub(crate) fn sensor_schema(kind: ChannelKind) -> Schema {
    let meanings: Vec<_> = kind.quantities().iter().map(|quantity| format!("In {}", quantity.unit)).collect();
    let quantities = kind.quantities().iter().zip(&meanings);
    let mut fields: Vec<_> =
        quantities.map(|(quantity, meaning)| (quantity.field, "number", meaning.as_str())).collect();
    let quality = quality_meaning();
    fields.extend([AGE, ("quality", "string", &quality)]);
    schema(&format!("r4.{}{SENSOR}", kind.name()), &fields)
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
    let mut fields = vec![("channel", "string", "Channel commanded"), ("setpoint_mode", "string", SETPOINT_MODE)];
    fields.extend(ROTARY_SETPOINTS.into_iter().chain(LINEAR_SETPOINTS).chain(SETPOINTS));
    fields.push(SENT_US);
    schema("r4.Command", &fields)
}

pub(crate) fn gap_schema() -> Schema {
    schema(
        "r4.Gap",
        &[
            ("without_link_s", "number", "How long nothing was heard from the board, by the host's clock, s"),
            ("restarted", "boolean", "true if the board has restarted in between"),
            ("clock_shift_us", "integer", "From here on publish times are the board's clock plus this, us"),
        ],
    )
}
