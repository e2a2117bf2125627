//! Values that calls return to Python. SI units; NaN for a number that the channel does not have.

use std::collections::BTreeMap;

use pyo3::prelude::*;
use r4_driver::{ChannelSample, CycleReport};
use r4_protocol::{ChannelInfo, CycleOutcome, DeviceInfo, ModeInfo, Quality, Sample as WireSample};
use r4_rig::Followed;

use crate::error;

/// A mode in which a channel accepts set points.
#[pyclass(frozen, get_all, module = "r4", from_py_object)]
#[derive(Clone)]
pub(crate) struct Mode {
    mode: String,
    unit: String,
    min: f64,
    max: f64,
}

/// Description of a channel by the board.
#[pyclass(frozen, get_all, module = "r4", from_py_object)]
#[derive(Clone)]
pub(crate) struct Channel {
    name: String,
    kind: String,
    index: u8,
    unit: String,
    min: f64,
    max: f64,
    rate_hz: f64,
    resolution: f64,
    modes: Vec<Mode>,
}

/// Description of a board, received when its session opens.
#[pyclass(frozen, get_all, module = "r4")]
pub(crate) struct Info {
    address: String,
    robot: String,
    firmware: String,
    link_timeout_s: f64,
    channels: Vec<Channel>,
}

/// State of a motor in its last sample.
#[pyclass(frozen, get_all, module = "r4")]
pub(crate) struct Motion {
    position: f64,
    speed: f64,
    duty: f64,
    settled: bool,
    homed: bool,
    after_s: f64,
}

/// A sample of a channel.
#[pyclass(frozen, get_all, module = "r4")]
pub(crate) struct Sample {
    channel: String,
    time_s: f64,
    state: String,
    causes: Vec<String>,
    position: f64,
    speed: f64,
    duty: f64,
    value: f64,
    values: BTreeMap<String, f64>,
    settled: bool,
    homed: bool,
    quality: String,
    age_s: f64,
}

/// Result of following a path with one motor.
#[pyclass(frozen, get_all, module = "r4")]
pub(crate) struct PathReport {
    channel: String,
    points: usize,
    worst: f64,
    rms: f64,
    lag_s: f64,
    end: f64,
    settled: bool,
}

/// Result of a cycle of set points, with the state of the stream's channels, in their order.
#[pyclass(frozen, get_all, module = "r4")]
pub(crate) struct Cycle {
    number: u64,
    outcome: String,
    time_s: f64,
    round_trip_s: f64,
    state: String,
    causes: Vec<String>,
    positions: Vec<f64>,
    speeds: Vec<f64>,
    duties: Vec<f64>,
    settled: Vec<bool>,
}

/// A serial port of this computer.
#[pyclass(frozen, get_all, module = "r4")]
pub(crate) struct Port {
    address: String,
    is_board: bool,
    product: Option<String>,
    serial: Option<String>,
}

/// Implements `__repr__` as the call that would create the value.
macro_rules! shown {
    ($($class:ident { $($field:ident),* })*) => {
        $(
            #[pymethods]
            impl $class {
                fn __repr__(&self) -> String {
                    let fields = [$(format!(concat!(stringify!($field), "={:?}"), self.$field)),*];
                    format!(concat!(stringify!($class), "({})"), fields.join(", "))
                }
            }
        )*
    };
}

shown! {
    Mode { mode, unit, min, max }
    Cycle { number, outcome, time_s, positions, speeds }
    Motion { position, speed, duty, settled, homed, after_s }
    PathReport { channel, points, worst, rms, lag_s, end, settled }
    Port { address, is_board, product, serial }
    Sample { channel, time_s, state, position, speed, duty, value, quality }
}

#[pymethods]
impl Channel {
    fn __repr__(&self) -> String {
        let modes: Vec<_> = self.modes.iter().map(|mode| mode.mode.as_str()).collect();
        format!("Channel(name={:?}, unit={:?}, modes={modes:?})", self.name, self.unit)
    }
}

#[pymethods]
impl Info {
    fn __repr__(&self) -> String {
        format!("Info(address={:?}, robot={:?}, channels={})", self.address, self.robot, self.channels.len())
    }
}

impl From<&ModeInfo> for Mode {
    fn from(info: &ModeInfo) -> Self {
        let (min, max) = (info.range.min.into(), info.range.max.into());
        Self { mode: info.mode.to_string(), unit: info.unit.to_string(), min, max }
    }
}

impl From<&ChannelInfo> for Channel {
    fn from(info: &ChannelInfo) -> Self {
        Self {
            name: info.id.to_string(),
            kind: info.id.kind.name().to_owned(),
            index: info.id.index,
            unit: info.unit.to_string(),
            min: info.range.min.into(),
            max: info.range.max.into(),
            rate_hz: info.rate_hz.into(),
            resolution: info.resolution.into(),
            modes: info.modes.iter().map(Mode::from).collect(),
        }
    }
}

impl Info {
    pub(crate) fn new(address: String, info: &DeviceInfo, channels: &[ChannelInfo]) -> Self {
        Self {
            address,
            robot: info.robot.to_string(),
            firmware: info.firmware.to_string(),
            link_timeout_s: f64::from(info.link_timeout_ms) * 1e-3,
            channels: channels.iter().map(Channel::from).collect(),
        }
    }
}

impl From<r4_driver::Motion> for Motion {
    fn from(motion: r4_driver::Motion) -> Self {
        let r4_driver::Motion { position, speed, duty, settled, homed, after_s } = motion;
        Self { position, speed, duty, settled, homed, after_s }
    }
}

impl From<Followed> for PathReport {
    fn from(followed: Followed) -> Self {
        let Followed { info, points, worst, rms, lag_s, end, settled } = followed;
        Self { channel: info.id.to_string(), points, worst, rms, lag_s, end, settled }
    }
}

impl From<r4_links::ports::Port> for Port {
    fn from(port: r4_links::ports::Port) -> Self {
        let (address, is_board) = (format!("serial:{}", port.path.display()), port.is_board());
        let (product, serial) = port.usb.map_or((None, None), |usb| (usb.product, usb.serial));
        Self { address, is_board, product, serial }
    }
}

impl From<CycleReport> for Cycle {
    fn from(report: CycleReport) -> Self {
        let CycleReport { number, outcome, device_us, round_trip_us, state, causes, motors } = report;
        let outcome = match outcome {
            CycleOutcome::Taken => "taken",
            CycleOutcome::Refused => "refused",
            CycleOutcome::Stale => "stale",
            CycleOutcome::Unbound => "unbound",
        };
        Self {
            number,
            outcome: outcome.to_owned(),
            time_s: device_us as f64 * 1e-6,
            round_trip_s: round_trip_us as f64 * 1e-6,
            state: state.to_string(),
            causes: error::causes(causes),
            positions: motors.iter().map(|motor| motor.position).collect(),
            speeds: motors.iter().map(|motor| motor.speed).collect(),
            duties: motors.iter().map(|motor| motor.duty).collect(),
            settled: motors.iter().map(|motor| motor.settled).collect(),
        }
    }
}

impl Sample {
    /// A sample of the channel that `info` describes.
    pub(crate) fn new(sample: &ChannelSample, info: &ChannelInfo) -> Self {
        let mut made = Self {
            channel: info.id.to_string(),
            time_s: sample.device_us as f64 * 1e-6,
            state: sample.state.to_string(),
            causes: error::causes(sample.causes),
            position: sample.position(info).unwrap_or(f64::NAN),
            speed: f64::NAN,
            duty: f64::NAN,
            value: f64::NAN,
            values: BTreeMap::new(),
            settled: false,
            homed: false,
            // Samples without a quality of their own are always good.
            quality: r4_log::quality_name(Quality::Good).to_owned(),
            age_s: 0.0,
        };
        match &sample.sample {
            WireSample::Motor { speed, duty, settled, homed, .. } => {
                (made.speed, made.duty) = (f64::from(*speed), f64::from(*duty));
                (made.settled, made.homed) = (*settled, *homed);
            }
            WireSample::Encoder { speed, .. } => made.speed = f64::from(*speed),
            WireSample::Scalar { value, .. } => made.value = f64::from(*value),
            WireSample::Reading { value, age_ms, quality, .. } => {
                (made.value, made.age_s) = (f64::from(*value), f64::from(*age_ms) * 1e-3);
                made.quality = r4_log::quality_name(*quality).to_owned();
            }
            WireSample::Sensor { values, age_ms, quality, .. } => {
                let quantities = info.id.kind.quantities().iter().zip(values);
                made.values = quantities.map(|(of, value)| (of.field.to_owned(), f64::from(*value))).collect();
                made.age_s = f64::from(*age_ms) * 1e-3;
                made.quality = r4_log::quality_name(*quality).to_owned();
            }
        }
        made
    }
}
