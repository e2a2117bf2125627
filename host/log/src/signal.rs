//! Signals of a run: named series of numbers and words.

use std::fmt;

use r4_protocol::{Mode, Request, Unit};

use crate::{
    EncoderSample, Log, LoggedRefusal, MotorSample, SensorSample,
    header::mode_name,
    message::{is_linear, quality_name, scalar_field, state_name},
};

/// Value of a signal at one time.
#[derive(Clone, Debug, PartialEq)]
pub enum Value {
    /// Number in double precision.
    Number(f64),
    /// Number in single precision, as it was on the wire.
    Single(f32),
    /// Count or other integer.
    Integer(i64),
    /// State of a switch, on or off.
    Switch(bool),
    /// Text, such as a state or a quality.
    Text(String),
}

impl Value {
    /// Returns the value as a number, `None` for text; a switch is 0 or 1.
    #[must_use]
    pub fn number(&self) -> Option<f64> {
        match self {
            Self::Number(value) => Some(*value),
            Self::Single(value) => Some(f64::from(*value)),
            Self::Integer(value) => Some(*value as f64),
            Self::Switch(on) => Some(if *on { 1.0 } else { 0.0 }),
            Self::Text(_) => None,
        }
    }
}

/// Prints numbers with as many digits as it takes to read back the identical value.
impl fmt::Display for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Number(value) => write!(f, "{value}"),
            Self::Single(value) => write!(f, "{value}"),
            Self::Integer(value) => write!(f, "{value}"),
            Self::Switch(on) => write!(f, "{}", u8::from(*on)),
            Self::Text(text) => f.write_str(text),
        }
    }
}

/// Meaning of a signal between two samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// The signal changes continuously from one sample to the next.
    Continuous,
    /// The earlier sample holds until the next one (zero-order hold).
    Held,
    /// The signal is recorded only when it changes, and holds until the next change.
    Changes,
    /// The samples are single events, with nothing in between.
    Event,
}

/// One named series of a run.
#[derive(Clone, Debug, PartialEq)]
pub struct Signal {
    /// Name of channel, field and unit, as in `osmc0.position_rad`. `state`, `causes`, `request`, `gap` and `refusal`
    /// belong to the board.
    pub name: String,
    /// Meaning of the signal between its samples.
    pub kind: Kind,
    /// Time on the board's clock (s) and value, in order of time; at least one. Numbers that are not finite are left
    /// out.
    pub samples: Vec<(f64, Value)>,
}

/// Returns the name of the field for a set point in `mode`, of a channel that moves linearly or turns; `what` is its
/// first part.
fn setpoint_field(what: &str, mode: Mode, linear: bool) -> String {
    let unit = match (mode, linear) {
        (Mode::Position | Mode::Follow, false) => "_rad",
        (Mode::Position | Mode::Follow, true) => "_m",
        (Mode::Speed | Mode::Home, false) => "_rad_s",
        (Mode::Speed | Mode::Home, true) => "_m_s",
        (Mode::Voltage, _) => "_v",
        (Mode::Force, _) => "_n",
        (Mode::Duty | Mode::Switch | Mode::Brake, _) => "",
    };
    format!("{what}_{}{unit}", mode_name(mode))
}

impl Log {
    /// Returns everything recorded that has a value: channels in the header's order, then the board's state,
    /// requests, gaps and refusals.
    #[must_use]
    pub fn signals(&self) -> Vec<Signal> {
        let mut all = Vec::new();
        for info in &self.header.channels {
            let id = info.id;
            let mut add = |field: &str, kind, samples: Samples| push(&mut all, format!("{id}.{field}"), kind, samples);
            if let Some(series) = self.motor(id) {
                let linear = series.is_linear();
                let (position, speed) =
                    if linear { ("position_m", "speed_m_s") } else { ("position_rad", "speed_rad_s") };
                for mode in Mode::ALL {
                    // One signal per mode, so that each has one unit.
                    let setpoint =
                        |sample: &MotorSample| single(sample.setpoint.value).filter(|_| sample.setpoint.mode == mode);
                    let samples = of(&series.samples, |sample| (sample.time_s, setpoint(sample)));
                    add(&setpoint_field("setpoint", mode, linear), Kind::Held, samples);
                }
                let field = |value: fn(&MotorSample) -> Option<Value>| of(&series.samples, |s| (s.time_s, value(s)));
                let counts = field(|sample| Some(Value::Integer(sample.position_counts.into())));
                add("position_counts", Kind::Continuous, counts);
                add(position, Kind::Continuous, field(|sample| finite(sample.position)));
                add(speed, Kind::Continuous, field(|sample| single(sample.speed)));
                add("duty", Kind::Continuous, field(|sample| single(sample.duty)));
                add("settled", Kind::Held, field(|sample| Some(Value::Switch(sample.settled))));
                add("homed", Kind::Held, field(|sample| Some(Value::Switch(sample.homed))));
                add("winding_heat", Kind::Continuous, field(|sample| single(sample.winding_heat)));
            }
            if let Some(series) = self.encoder(id) {
                let field = |value: fn(&EncoderSample) -> Option<Value>| of(&series.samples, |s| (s.time_s, value(s)));
                let counts = field(|sample| Some(Value::Integer(sample.position_counts.into())));
                add("position_counts", Kind::Continuous, counts);
                add("position_rad", Kind::Continuous, field(|sample| finite(sample.position)));
                add("speed_rad_s", Kind::Continuous, field(|sample| single(sample.speed)));
                add("illegal", Kind::Held, field(|sample| Some(Value::Integer(sample.illegal.into()))));
            }
            // Between two samples a switch cannot be interpolated.
            let switch = info.unit == Unit::Bool;
            let kind = if switch { Kind::Held } else { Kind::Continuous };
            let scalar = |value: f64| {
                if switch { finite(value).map(|_| Value::Switch(value != 0.0)) } else { single(value) }
            };
            if let Some(series) = self.reading(id) {
                add(scalar_field(info.unit), kind, of(&series.samples, |s| (s.time_s, scalar(s.value))));
                let age = of(&series.samples, |sample| (sample.time_s, Some(Value::Integer(sample.age_ms.into()))));
                add("age_ms", Kind::Continuous, age);
                add("quality", Kind::Held, of(&series.samples, |s| (s.time_s, text(quality_name(s.quality)))));
            }
            if let Some(series) = self.sensor(id) {
                for (place, quantity) in id.kind.quantities().iter().enumerate() {
                    let value = |sample: &SensorSample| sample.values.get(place).and_then(|value| single(*value));
                    add(quantity.field, Kind::Continuous, of(&series.samples, |s| (s.time_s, value(s))));
                }
                let age = of(&series.samples, |sample| (sample.time_s, Some(Value::Integer(sample.age_ms.into()))));
                add("age_ms", Kind::Continuous, age);
                add("quality", Kind::Held, of(&series.samples, |s| (s.time_s, text(quality_name(s.quality)))));
            }
            if let Some(series) = self.scalar(id) {
                add(scalar_field(info.unit), kind, of(&series.samples, |(time_s, value)| (*time_s, scalar(*value))));
            }
            let linear = is_linear(info);
            for mode in Mode::ALL {
                let commands = self.commands.iter().filter(|to| to.channel == id && to.setpoint.mode == mode);
                let samples = of(commands, |command| (command.time_s, single(command.setpoint.value)));
                add(&setpoint_field("command", mode, linear), Kind::Event, samples);
            }
        }
        let mut add = |name: &str, kind, samples| push(&mut all, name.to_owned(), kind, samples);
        add("state", Kind::Changes, of(&self.states, |change| (change.time_s, text(state_name(change.state)))));
        add("causes", Kind::Changes, of(&self.states, |change| (change.time_s, text(change.causes))));
        // Set points have signals of their own.
        let requests = self.requests.iter().filter(|logged| !matches!(logged.request, Request::Set { .. }));
        add("request", Kind::Event, of(requests, |request| (request.time_s, text(request))));
        let refused = |refusal: &LoggedRefusal| text(format_args!("{}: {}", refusal.request, refusal.reason));
        add("gap", Kind::Event, of(&self.gaps, |gap| (gap.time_s, text(gap))));
        add("refusal", Kind::Event, of(&self.refusals, |refusal| (refusal.time_s, refused(refusal))));
        all
    }
}

type Samples = Vec<(f64, Value)>;

/// Collects the samples of `from` that have a value.
fn of<T>(from: impl IntoIterator<Item = T>, sample: impl Fn(T) -> (f64, Option<Value>)) -> Samples {
    from.into_iter().map(sample).filter_map(|(time_s, value)| Some((time_s, value?))).collect()
}

fn push(all: &mut Vec<Signal>, name: String, kind: Kind, mut samples: Samples) {
    if !samples.is_empty() {
        samples.sort_by(|a, b| a.0.total_cmp(&b.0));
        all.push(Signal { name, kind, samples });
    }
}

fn text(text: impl fmt::Display) -> Option<Value> {
    Some(Value::Text(text.to_string()))
}

/// Returns a value that was an `f32` on the wire, so that it prints with its short decimal.
fn single(value: f64) -> Option<Value> {
    finite(value).map(|_| Value::Single(value as f32))
}

fn finite(value: f64) -> Option<Value> {
    value.is_finite().then_some(Value::Number(value))
}
