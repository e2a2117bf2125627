//! Requests as log messages and as text.

use std::fmt::{self, Display};

use r4_protocol::{
    PathPoint, Refusal, Request,
    config::{FeedForward, PidGains, Tuning},
};
use serde::{Deserialize, Serialize};

use crate::{
    header::{mode_from, mode_name},
    message::{REFUSAL, REQUEST, SENT_US, Schema, finite, schema},
};

/// Request that the host sent, other than a set point.
#[derive(Default, Serialize, Deserialize)]
pub(crate) struct RequestMessage {
    request: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    channel: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    period_ms: Option<u16>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    mode: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    kp: Option<f32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    ki: Option<f32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    kd: Option<f32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    static_duty: Option<f32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    duty_per_speed: Option<f32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    duty_per_acceleration: Option<f32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    cascade_per_s: Option<f32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    parameter: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    value: Option<f32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    name: Option<String>,
    /// Connector of an I2C bus or UART.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    port: Option<u8>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    address: Option<u8>,
    /// Bytes written, as hexadecimal text.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    write: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    read: Option<u8>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    points: Option<Vec<PointMessage>>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) sent_us: Option<u64>,
}

/// Point of a path.
#[derive(Clone, Copy, Serialize, Deserialize)]
struct PointMessage {
    /// Time at which the channel is to be there, µs after the request was sent.
    after_us: u64,
    position: Option<f32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    speed: Option<f32>,
    feed_forward: Option<f32>,
}

impl PointMessage {
    fn new(point: &PathPoint, sent_us: u64) -> Self {
        Self {
            after_us: point.at_us.saturating_sub(sent_us),
            position: finite(point.position),
            speed: point.speed.and_then(finite),
            feed_forward: finite(point.feed_forward),
        }
    }

    fn point(self) -> PathPoint {
        let Self { after_us, position, speed, feed_forward } = self;
        // A number that was not finite was left out of the message.
        let number = |value: Option<f32>| value.unwrap_or(f32::NAN);
        PathPoint { at_us: after_us, position: number(position), speed, feed_forward: number(feed_forward) }
    }
}

/// Request that the board refused, with the reason.
#[derive(Serialize, Deserialize)]
pub(crate) struct RefusalMessage {
    pub(crate) request: String,
    pub(crate) reason: String,
}

/// Returns the name of `request` in a log.
#[must_use]
pub fn request_name(request: &Request) -> &'static str {
    match request {
        Request::Hello { .. } => "hello",
        Request::Bye => "bye",
        Request::Describe { .. } => "describe",
        Request::Arm => "arm",
        Request::Disarm => "disarm",
        Request::Clear => "clear",
        Request::Stop => "stop",
        Request::Set { .. } => "set",
        Request::Subscribe { .. } => "subscribe",
        Request::SetGains { .. } => "set-gains",
        Request::Stats => "stats",
        Request::DescribeParameter { .. } => "describe-parameter",
        Request::SetParameter { .. } => "set-parameter",
        Request::SetName { .. } => "set-name",
        Request::SaveParameters => "save-parameters",
        Request::ResetParameters => "reset-parameters",
        Request::Restart => "restart",
        Request::Fault { .. } => "fault",
        Request::FaultSnapshot { .. } => "fault-snapshot",
        Request::I2cTransfer { .. } => "i2c",
        Request::UartWrite { .. } => "uart-write",
        Request::UartRead { .. } => "uart-read",
        Request::Bind { .. } => "bind",
        Request::Log { .. } => "log",
        Request::Image => "image",
        Request::Bootloader => "bootloader",
        Request::Follow { .. } => "follow",
        Request::SetTuning { .. } => "set-tuning",
    }
}

/// Requests without fields, which their name describes completely.
const PLAIN: [Request; 10] = [
    Request::Bye,
    Request::Arm,
    Request::Disarm,
    Request::Clear,
    Request::Stop,
    Request::Stats,
    Request::SaveParameters,
    Request::ResetParameters,
    Request::Restart,
    Request::Bootloader,
];

impl RequestMessage {
    /// Returns the message of a request. `None` for a set point, which has a topic of its own, and for requests that
    /// only read the board's identity, parameters, faults or log, which every program repeats anyway.
    pub(crate) fn new(request: &Request) -> Option<Self> {
        let mut message = Self { request: request_name(request).to_owned(), ..Self::default() };
        match request {
            // The set points of the bound cycles are recorded one by one.
            Request::Bind { .. }
            | Request::Set { .. }
            | Request::Hello { .. }
            | Request::Log { .. }
            | Request::Image
            | Request::Describe { .. }
            | Request::DescribeParameter { .. }
            | Request::Fault { .. }
            | Request::FaultSnapshot { .. } => return None,
            Request::Bye
            | Request::Arm
            | Request::Disarm
            | Request::Clear
            | Request::Stop
            | Request::Stats
            | Request::SaveParameters
            | Request::ResetParameters
            | Request::Restart
            | Request::Bootloader => {}
            Request::Subscribe { channel, period_ms } => {
                (message.channel, message.period_ms) = (Some(channel.to_string()), Some(*period_ms));
            }
            Request::SetGains { channel, mode, gains } => {
                (message.channel, message.mode) = (Some(channel.to_string()), Some(mode_name(*mode).to_owned()));
                (message.kp, message.ki, message.kd) = (finite(gains.kp), finite(gains.ki), finite(gains.kd));
            }
            Request::SetTuning { channel, tuning: Tuning { feed_forward, cascade_per_s } } => {
                message.channel = Some(channel.to_string());
                message.static_duty = finite(feed_forward.static_duty);
                message.duty_per_speed = finite(feed_forward.duty_per_speed);
                message.duty_per_acceleration = finite(feed_forward.duty_per_acceleration);
                message.cascade_per_s = finite(*cascade_per_s);
            }
            Request::SetParameter { key, value } => {
                (message.parameter, message.value) = (Some(key.to_string()), finite(*value));
            }
            Request::SetName { robot } => message.name = Some(robot.to_string()),
            Request::Follow { channel, sent_us, points } => {
                message.channel = Some(channel.to_string());
                message.points = Some(points.iter().map(|point| PointMessage::new(point, *sent_us)).collect());
            }
            Request::I2cTransfer { bus, address, write, read } => {
                (message.port, message.address) = (Some(*bus), Some(*address));
                (message.write, message.read) = (Some(hex(write)), Some(*read));
            }
            Request::UartWrite { port, bytes } => (message.port, message.write) = (Some(*port), Some(hex(bytes))),
            Request::UartRead { port } => message.port = Some(*port),
        }
        Some(message)
    }

    /// Returns the request, if this version knows it and all its fields are present. Times of a path's points count
    /// from its sending.
    pub(crate) fn request(&self) -> Option<Request> {
        if let Some(plain) = PLAIN.iter().find(|plain| request_name(plain) == self.request) {
            return Some(plain.clone());
        }
        let channel = || self.channel.as_ref()?.parse().ok();
        // A number that was not finite was left out of the message.
        let number = |value: Option<f32>| value.unwrap_or(f32::NAN);
        let written = || unhex(self.write.as_ref()?);
        Some(match self.request.as_str() {
            "subscribe" => Request::Subscribe { channel: channel()?, period_ms: self.period_ms? },
            "set-gains" => Request::SetGains {
                channel: channel()?,
                mode: mode_from(self.mode.as_ref()?)?,
                gains: PidGains { kp: number(self.kp), ki: number(self.ki), kd: number(self.kd) },
            },
            "set-tuning" => Request::SetTuning {
                channel: channel()?,
                tuning: Tuning {
                    feed_forward: FeedForward {
                        static_duty: number(self.static_duty),
                        duty_per_speed: number(self.duty_per_speed),
                        duty_per_acceleration: number(self.duty_per_acceleration),
                    },
                    cascade_per_s: number(self.cascade_per_s),
                },
            },
            "set-parameter" => {
                Request::SetParameter { key: self.parameter.as_ref()?.parse().ok()?, value: number(self.value) }
            }
            "follow" => Request::Follow {
                channel: channel()?,
                sent_us: 0,
                points: self
                    .points
                    .as_ref()?
                    .iter()
                    .map(|point| point.point())
                    .collect::<Vec<_>>()
                    .as_slice()
                    .try_into()
                    .ok()?,
            },
            "set-name" => Request::SetName { robot: self.name.as_ref()?.parse().ok()? },
            "i2c" => Request::I2cTransfer {
                bus: self.port?,
                address: self.address?,
                write: written()?.as_slice().try_into().ok()?,
                read: self.read?,
            },
            "uart-write" => Request::UartWrite { port: self.port?, bytes: written()?.as_slice().try_into().ok()? },
            "uart-read" => Request::UartRead { port: self.port? },
            _ => return None,
        })
    }
}

/// Text of a request for people: its name and its fields, as in `subscribe osmc0 10 ms`.
pub(crate) struct Described<'a>(pub(crate) &'a Request);

impl Display for Described<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(request_name(self.0))?;
        match self.0 {
            Request::Set { channel, setpoint, .. } => write!(f, " {channel} {} {}", setpoint.mode, setpoint.value),
            Request::Subscribe { channel, period_ms } => write!(f, " {channel} {period_ms} ms"),
            Request::SetGains { channel, mode, gains: PidGains { kp, ki, kd } } => {
                write!(f, " {channel} {mode} kp {kp} ki {ki} kd {kd}")
            }
            Request::SetTuning { channel, tuning: Tuning { feed_forward, cascade_per_s } } => {
                let FeedForward { static_duty, duty_per_speed, duty_per_acceleration } = feed_forward;
                write!(f, " {channel} feed-forward {static_duty} {duty_per_speed} {duty_per_acceleration}")?;
                write!(f, " cascade {cascade_per_s}")
            }
            Request::SetParameter { key, value } => write!(f, " {key} {value}"),
            Request::Follow { channel, points, .. } => write!(f, " {channel} {} points", points.len()),
            Request::SetName { robot } => write!(f, " {robot}"),
            Request::I2cTransfer { bus, address, write, read } => {
                write!(f, " {bus} {address:#04x} write {} read {read}", hex(write))
            }
            Request::UartWrite { port, bytes } => write!(f, " {port} {}", hex(bytes)),
            Request::UartRead { port } => write!(f, " {port}"),
            _ => Ok(()),
        }
    }
}

/// Returns the message of a refused request.
pub(crate) fn refusal(request: &Request, reason: &Refusal) -> RefusalMessage {
    RefusalMessage { request: Described(request).to_string(), reason: reason.to_string() }
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn unhex(text: &str) -> Option<Vec<u8>> {
    let digits: Option<Vec<u8>> =
        text.chars().map(|digit| digit.to_digit(16).and_then(|digit| u8::try_from(digit).ok())).collect();
    // An odd digit at the end means a damaged field.
    let (pairs, rest) = digits.as_ref()?.as_chunks::<2>();
    rest.is_empty().then(|| pairs.iter().map(|[high, low]| high << 4 | low).collect())
}

pub(crate) fn request_schema() -> Schema {
    schema(
        REQUEST,
        &[
            ("request", "string", "What was asked: arm, disarm, clear, stop, subscribe, set-gains …"),
            ("channel", "string", "Channel it is about"),
            ("period_ms", "integer", "Time between samples, ms; 0 ends them"),
            ("mode", "string", "Which loop gains are of: position or speed"),
            ("kp", "number", "Gain, duty by the unit of the mode"),
            ("ki", "number", "Gain, duty by the unit of the mode and s"),
            ("kd", "number", "Gain, duty s by the unit of the mode"),
            ("static_duty", "number", "Feed-forward against friction, duty"),
            ("duty_per_speed", "number", "Feed-forward of speed, duty by rad/s or m/s"),
            ("duty_per_acceleration", "number", "Feed-forward of acceleration, duty by rad/s2 or m/s2"),
            ("cascade_per_s", "number", "Gain from position error to speed, 1/s; 0 without a cascade"),
            ("parameter", "string", "Parameter set"),
            ("value", "number", "What it is set to, in its unit"),
            ("name", "string", "Name given to the robot"),
            ("port", "integer", "Connector of the I2C bus or UART"),
            ("address", "integer", "7-bit address on the I2C bus"),
            ("write", "string", "Bytes written, in hex"),
            ("read", "integer", "Bytes asked for"),
            ("points", "objects", "Points of a path: after_us of sending, position, speed, feed_forward as a duty"),
            SENT_US,
        ],
    )
}

pub(crate) fn refusal_schema() -> Schema {
    schema(REFUSAL, &[("request", "string", "What was refused"), ("reason", "string", "Why")])
}

#[cfg(test)]
mod tests {
    use r4_protocol::{ChannelId, ChannelKind, Mode};

    use super::*;

    #[test]
    fn every_request_that_changes_something_comes_back() {
        let channel = ChannelId::new(ChannelKind::Osmc, 2);
        let bytes = || [0, 0x7F, 0xFF].into_iter().collect();
        let mut all = PLAIN.to_vec();
        all.extend([
            Request::Subscribe { channel, period_ms: 65_535 },
            Request::SetGains { channel, mode: Mode::Speed, gains: PidGains { kp: 0.1, ki: 1e6, kd: 0.0 } },
            Request::SetTuning {
                channel,
                tuning: Tuning {
                    feed_forward: FeedForward { static_duty: 0.1, duty_per_speed: 0.2, duty_per_acceleration: 1e-3 },
                    cascade_per_s: 12.5,
                },
            },
            Request::SetParameter { key: "osmc2.position_kp".parse().expect("a parameter"), value: -0.1 },
            Request::SetParameter { key: "board.link_timeout_ms".parse().expect("a parameter"), value: 1e-30 },
            Request::SetName { robot: "a \"b\" é".try_into().expect("short") },
            Request::I2cTransfer { bus: 1, address: 0x50, write: bytes(), read: 64 },
            Request::UartWrite { port: 1, bytes: bytes() },
            Request::UartRead { port: 0 },
            Request::Follow {
                channel,
                sent_us: 0,
                points: [(20_000, None), (u64::MAX, Some(-0.5))]
                    .map(|(at_us, speed)| PathPoint { at_us, position: 0.1, speed, feed_forward: -0.25 })
                    .into_iter()
                    .collect(),
            },
        ]);
        let schema: serde_json::Value = serde_json::from_str(&request_schema().json).expect("JSON");
        for request in all {
            let message = RequestMessage::new(&request).expect("recorded");
            let fields = serde_json::to_value(&message).expect("JSON");
            for (field, value) in fields.as_object().expect("an object") {
                assert!(is_declared(&schema["properties"][field], value), "{field} of {request:?}");
            }
            let json = serde_json::to_string(&message).expect("JSON");
            let read: RequestMessage = serde_json::from_str(&json).expect("its own JSON");
            assert_eq!(read.request(), Some(request), "{json}");
        }
    }

    /// Returns whether a value has the declared type; an array's items, too.
    fn is_declared(declared: &serde_json::Value, value: &serde_json::Value) -> bool {
        match declared["type"].as_str() {
            Some("string") => value.is_string(),
            Some("integer") => value.is_u64(),
            Some("number") => value.is_number(),
            Some("object") => value.is_object(),
            Some("array") => {
                value.as_array().is_some_and(|items| items.iter().all(|item| is_declared(&declared["items"], item)))
            }
            _ => false,
        }
    }

    #[test]
    fn what_lacks_a_field_is_no_request() {
        for json in [
            r#"{"request":"levitate"}"#,
            r#"{"request":"subscribe","channel":"osmc0"}"#,
            r#"{"request":"subscribe","channel":"osmc","period_ms":1}"#,
            r#"{"request":"set-gains","channel":"osmc0","mode":"fast"}"#,
            r#"{"request":"uart-write","port":0,"write":"0"}"#,
            r#"{"request":"uart-write","port":0,"write":"+1"}"#,
            r#"{"request":"follow","channel":"osmc0"}"#,
            r#"{"request":"follow","channel":"osmc","points":[]}"#,
            r#"{"request":"set-name","name":"far too long a name for what a board can hold, by all means"}"#,
        ] {
            let read: RequestMessage = serde_json::from_str(json).expect("JSON");
            assert_eq!(read.request(), None, "{json}");
        }
    }
}
