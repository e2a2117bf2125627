//! Channels and their samples as a person reads them: named numbers in the program's units.

use r4_protocol::{ChannelId, ChannelInfo, ChannelKind, Mode, Quality, Sample, Unit};
use r4_rig::quantity::{Quantity, human, speed_unit};
use serde::Serialize;

/// A channel, with the numbers that it measures.
#[derive(Debug, PartialEq, Serialize)]
pub(crate) struct Channel {
    pub(crate) name: String,
    pub(crate) series: Vec<Series>,
}

/// One number of a channel.
#[derive(Debug, PartialEq, Serialize)]
pub(crate) struct Series {
    /// Name of the quantity, such as `position`.
    pub(crate) name: String,
    /// As it is shown; empty for a share or a switch.
    pub(crate) unit: &'static str,
    pub(crate) decimals: usize,
    /// Words for 0 and 1 of a binary value.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) words: Option<[&'static str; 2]>,
    /// Shown for one SI unit.
    #[serde(skip)]
    per_si: f64,
}

/// New numbers of a channel.
#[derive(Debug, PartialEq, Serialize)]
pub(crate) struct Values {
    /// Which, by its place in the list.
    pub(crate) at: usize,
    /// In the order of its series; `None` for one that is not known.
    pub(crate) numbers: Vec<Option<f64>>,
    /// Why there are none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) fault: Option<String>,
    /// True for a fault: nothing in range, or nothing measured yet, is none.
    pub(crate) is_bad: bool,
    /// Set point that the channel follows.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) follows: Option<String>,
}

impl Series {
    fn new(name: impl Into<String>, unit: Unit) -> Self {
        let (per_si, shown, decimals) = human(unit);
        Self { name: name.into(), unit: shown, decimals, words: None, per_si }
    }

    /// As it is shown, with no more digits than that.
    fn shown(&self, value: f64) -> Option<f64> {
        let digits = 10f64.powi(self.decimals as i32);
        let shown = (value * self.per_si * digits).round() / digits;
        shown.is_finite().then_some(shown + 0.0)
    }
}

/// Words for 0 and 1 of a switch.
const fn words(id: ChannelId) -> [&'static str; 2] {
    match (id.kind, id.index) {
        (ChannelKind::DeadMan, 0) => ["RELEASED", "held"],
        (ChannelKind::DeadMan, _) => ["PRESSED", "released"],
        _ => ["off", "on"],
    }
}

/// Name of a quantity without its unit: `acceleration_x_m_s2` is `acceleration x`.
fn plain_name(field: &str, unit: Unit) -> String {
    let suffix = match unit {
        Unit::Rad => "_rad",
        Unit::RadPerS => "_rad_s",
        Unit::M => "_m",
        Unit::MPerS => "_m_s",
        Unit::MPerS2 => "_m_s2",
        Unit::V => "_v",
        Unit::A => "_a",
        Unit::N => "_n",
        Unit::Duty | Unit::Bool => "",
    };
    field.strip_suffix(suffix).unwrap_or(field).replace('_', " ")
}

impl Channel {
    pub(crate) fn new(info: &ChannelInfo) -> Self {
        let quantities = info.id.kind.quantities();
        let is_motor =
            matches!(info.id.kind, ChannelKind::Osmc | ChannelKind::Actuator | ChannelKind::Dhb | ChannelKind::Stepper);
        let motion = || vec![Series::new("position", info.unit), Series::new("speed", speed_unit(info.unit))];
        let series = match info.id.kind {
            // A motor that nothing measures has only its duty.
            _ if is_motor && info.unit == Unit::Duty => vec![Series::new("duty", Unit::Duty)],
            _ if is_motor => {
                let duty = info.mode(Mode::Duty).map(|_| Series::new("duty", Unit::Duty));
                motion().into_iter().chain(duty).collect()
            }
            ChannelKind::Encoder => motion(),
            _ if !quantities.is_empty() => {
                quantities.iter().map(|of| Series::new(plain_name(of.field, of.unit), of.unit)).collect()
            }
            _ => {
                let words = (info.unit == Unit::Bool).then(|| words(info.id));
                vec![Series { words, ..Series::new("value", info.unit) }]
            }
        };
        Self { name: info.id.to_string(), series }
    }

    /// Numbers of a sample of this channel, which is the one at `at` in the list.
    pub(crate) fn values(&self, at: usize, info: &ChannelInfo, sample: &Sample) -> Values {
        let position = |counts: i32| f64::from(counts) * f64::from(info.resolution);
        let (numbers, quality) = match *sample {
            Sample::Motor { duty, .. } if info.unit == Unit::Duty => (vec![duty.into()], Quality::Good),
            Sample::Motor { position: counts, speed, duty, .. } => {
                (vec![position(counts), speed.into(), duty.into()], Quality::Good)
            }
            Sample::Encoder { position: counts, speed, .. } => (vec![position(counts), speed.into()], Quality::Good),
            Sample::Scalar { value, .. } => (vec![value.into()], Quality::Good),
            Sample::Reading { value, quality, .. } => (vec![value.into()], quality),
            Sample::Sensor { values, quality, .. } => (values.map(f64::from).to_vec(), quality),
        };
        // The values beside a bad quality are the last good ones.
        let is_good = quality == Quality::Good;
        let shown = |(series, value): (&Series, f64)| series.shown(value).filter(|_| is_good);
        Values {
            at,
            numbers: self.series.iter().zip(numbers).map(shown).collect(),
            fault: (!is_good).then(|| quality.to_string()),
            is_bad: !matches!(quality, Quality::Good | Quality::None | Quality::OutOfRange),
            follows: follows(info, sample),
        }
    }
}

/// The set point that a motor follows, in words.
fn follows(info: &ChannelInfo, sample: &Sample) -> Option<String> {
    let Sample::Motor { setpoint, settled, .. } = *sample else { return None };
    let unit = info.mode(setpoint.mode).map_or(Unit::Duty, |mode| mode.unit);
    let settled = if settled { ", settled" } else { "" };
    Some(format!("{} {}{settled}", setpoint.mode, Quantity::new(setpoint.value.into(), unit)))
}

#[cfg(test)]
mod tests {
    use std::f32::consts::FRAC_PI_2;

    use r4_protocol::{ModeInfo, Range, Setpoint};

    use super::*;

    fn info(kind: ChannelKind, unit: Unit, resolution: f32) -> ChannelInfo {
        let modes = [Mode::Position, Mode::Duty].map(|mode| ModeInfo {
            mode,
            unit: if mode == Mode::Duty { Unit::Duty } else { unit },
            range: Range::symmetric(1.0),
        });
        let (id, range) = (ChannelId::new(kind, 0), Range::symmetric(1.0));
        ChannelInfo { id, unit, range, rate_hz: 1.0, resolution, modes: modes.into_iter().collect() }
    }

    fn names(info: &ChannelInfo) -> Vec<String> {
        Channel::new(info).series.iter().map(|of| format!("{} {}", of.name, of.unit).trim().to_owned()).collect()
    }

    #[test]
    fn series_have_the_units_that_people_read() {
        assert_eq!(names(&info(ChannelKind::Osmc, Unit::Rad, 0.1)), ["position deg", "speed deg/s", "duty"]);
        assert_eq!(names(&info(ChannelKind::Actuator, Unit::M, 0.1)), ["position mm", "speed mm/s", "duty"]);
        assert_eq!(names(&info(ChannelKind::Dhb, Unit::Duty, 0.0)), ["duty"]);
        assert_eq!(names(&info(ChannelKind::Encoder, Unit::Rad, 0.1)), ["position deg", "speed deg/s"]);
        assert_eq!(names(&info(ChannelKind::Range, Unit::M, 0.0)), ["value mm"]);
        assert_eq!(names(&info(ChannelKind::Current, Unit::A, 0.0)), ["current A", "voltage V"]);
        let imu = names(&info(ChannelKind::Imu, Unit::MPerS2, 0.0));
        assert_eq!((imu[0].as_str(), imu[5].as_str()), ("acceleration x m/s2", "rate z deg/s"));
    }

    #[test]
    fn every_quantity_has_a_name_without_its_unit() {
        for kind in
            [ChannelKind::Imu, ChannelKind::Current, ChannelKind::Angle, ChannelKind::Force, ChannelKind::Distance]
        {
            for quantity in kind.quantities() {
                let name = plain_name(quantity.field, quantity.unit);
                assert!(name.len() < quantity.field.len() && !name.contains('_'), "{name}");
            }
        }
    }

    #[test]
    fn numbers_are_shown_as_the_program_prints_them() {
        let motor = info(ChannelKind::Osmc, Unit::Rad, 0.001);
        let sample = Sample::Motor {
            channel: motor.id,
            setpoint: Setpoint { mode: Mode::Position, value: FRAC_PI_2 },
            position: 1571,
            speed: -1e-9,
            duty: 0.123_456,
            settled: true,
            homed: false,
            winding: None,
        };
        let values = Channel::new(&motor).values(7, &motor, &sample);
        assert_eq!((values.at, values.fault.clone()), (7, None));
        assert_eq!(values.numbers, [Some(90.01), Some(0.0), Some(0.123)]);
        // Zero has no sign.
        assert!(values.numbers[1].is_some_and(f64::is_sign_positive));
        assert_eq!(values.follows.as_deref(), Some("position 90.00 deg, settled"));
    }

    #[test]
    fn what_is_wrong_with_a_reading_is_in_place_of_its_numbers() {
        let range = info(ChannelKind::Range, Unit::M, 0.0);
        let quality = Quality::NoAnswer;
        let sample = Sample::Reading { channel: range.id, value: 0.5, age_ms: 3, quality };
        let values = Channel::new(&range).values(0, &range, &sample);
        assert_eq!((values.numbers, values.fault, values.is_bad), (vec![None], Some(quality.to_string()), true));
        let nothing = Sample::Reading { channel: range.id, value: 4.0, age_ms: 3, quality: Quality::OutOfRange };
        assert!(!Channel::new(&range).values(0, &range, &nothing).is_bad);
        let lost = Sample::Scalar { channel: range.id, value: f32::NAN };
        assert_eq!(Channel::new(&range).values(0, &range, &lost).numbers, [None]);
    }

    #[test]
    fn switches_are_words() {
        let mut handle = info(ChannelKind::DeadMan, Unit::Bool, 0.0);
        assert_eq!(Channel::new(&handle).series[0].words, Some(["RELEASED", "held"]));
        handle.id.index = 1;
        assert_eq!(Channel::new(&handle).series[0].words, Some(["PRESSED", "released"]));
        assert_eq!(Channel::new(&info(ChannelKind::Relay, Unit::Bool, 0.0)).series[0].words, Some(["off", "on"]));
    }
}
