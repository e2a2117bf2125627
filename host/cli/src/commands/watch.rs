//! `r4 watch`: prints telemetry of channels at a steady rate.

use std::{cell::RefCell, collections::BTreeMap, future::pending};

use anyhow::anyhow;
use r4_driver::Clock;
use r4_links::Event;
use r4_protocol::{ChannelId, ChannelInfo, HotWinding, Mode, Quality, Sample, Telemetry, Unit, Winding};
use r4_sim::Pace;
use serde::Serialize;

use crate::{
    args::{Args, Watch},
    output,
    session::{self, HostClock, Session},
};
use r4_rig::quantity::{Quantity, human, speed_unit};

/// Line of `--json`: one object per sample time.
#[derive(Serialize)]
struct Line {
    time_s: f64,
    state: String,
    causes: Vec<String>,
    channels: Vec<Value>,
}

/// Value of a channel in SI units; null before the first sample.
#[derive(Serialize)]
struct Value {
    channel: String,
    unit: String,
    value: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    speed: Option<f32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    duty: Option<f32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    homed: Option<bool>,
    #[serde(skip_serializing_if = "Option::is_none")]
    winding: Option<WindingHeat>,
    #[serde(skip_serializing_if = "Option::is_none")]
    illegal: Option<u32>,
    /// All quantities of a sensor that measures several, by name with unit suffix.
    #[serde(skip_serializing_if = "Option::is_none")]
    values: Option<BTreeMap<&'static str, f32>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    age_ms: Option<u16>,
    #[serde(skip_serializing_if = "Option::is_none")]
    quality: Option<String>,
}

/// Heat of a motor's winding, % of its limit.
#[derive(Clone, Copy, Serialize)]
struct WindingHeat {
    heat_percent: u8,
    /// True while the board warns of it.
    hot: bool,
}

impl Value {
    fn new(info: &ChannelInfo, sample: &Sample) -> Self {
        let position = |counts: i32| f64::from(counts) * f64::from(info.resolution);
        let mut value = Self {
            channel: info.id.to_string(),
            unit: info.unit.to_string(),
            value: None,
            speed: None,
            duty: None,
            homed: None,
            winding: None,
            illegal: None,
            values: None,
            age_ms: None,
            quality: None,
        };
        if let Sample::Motor { winding: Some(Winding { heat_percent, hot }), .. } = *sample {
            value.winding = Some(WindingHeat { heat_percent, hot });
        }
        let number = match *sample {
            // A motor that nothing measures has only its duty to tell.
            Sample::Motor { duty, .. } if info.unit == Unit::Duty => duty.into(),
            Sample::Motor { position: counts, speed, duty, homed, .. } => {
                (value.speed, value.homed) = (Some(speed), Some(homed));
                value.duty = info.mode(Mode::Duty).map(|_| duty);
                position(counts)
            }
            Sample::Scalar { value, .. } => value.into(),
            Sample::Reading { value: last, age_ms, quality, .. } => {
                (value.age_ms, value.quality) = (Some(age_ms), Some(quality.to_string()));
                if quality == Quality::None { f64::NAN } else { last.into() }
            }
            Sample::Sensor { channel, values, age_ms, quality } => {
                (value.age_ms, value.quality) = (Some(age_ms), Some(quality.to_string()));
                if quality != Quality::None {
                    let named = channel.kind.quantities().iter().zip(values);
                    value.values = Some(named.map(|(quantity, value)| (quantity.field, value)).collect());
                }
                if quality == Quality::None { f64::NAN } else { values[0].into() }
            }
            Sample::Encoder { position: counts, speed, illegal, .. } => {
                (value.speed, value.illegal) = (Some(speed), Some(illegal));
                position(counts)
            }
        };
        value.value = Some(number).filter(|number| number.is_finite());
        value
    }
}

/// Watched channels with the newest sample of each.
struct Watched {
    infos: Vec<ChannelInfo>,
    newest: Vec<Option<Sample>>,
    /// True for a sample that was not printed yet.
    fresh: Vec<bool>,
}

impl Watched {
    fn new(infos: Vec<ChannelInfo>) -> Self {
        Self { newest: vec![None; infos.len()], fresh: vec![false; infos.len()], infos }
    }

    /// Stores a frame's samples and returns those of one moment once all channels have one: a board splits a moment
    /// over several frames.
    ///
    /// A second sample of a channel also ends the moment, if another channel's is missing.
    fn take(&mut self, frame: &Telemetry) -> Option<Vec<Sample>> {
        let mut moment = None;
        for sample in &frame.samples {
            let Some(index) = self.infos.iter().position(|info| info.id == sample.channel()) else { continue };
            if self.fresh[index] {
                moment = self.moment().or(moment);
            }
            (self.newest[index], self.fresh[index]) = (Some(*sample), true);
        }
        if self.fresh.iter().all(|fresh| *fresh) { self.moment() } else { moment }
    }

    fn moment(&mut self) -> Option<Vec<Sample>> {
        self.fresh.fill(false);
        self.newest.iter().copied().collect()
    }
}

pub(crate) fn run(args: &Args, watch: &Watch) -> anyhow::Result<bool> {
    // `session::keep` opens the live view from the common arguments.
    let args = &Args { live: watch.live.foxglove, ..args.clone() };
    let mut end_s = None;
    let lost = RefCell::new(None);
    let tell = |event| {
        eprintln!("r4: {}", session::told(&event));
        lost.replace(if let Event::Lost { why } = event { Some(why) } else { None });
    };
    // Telemetry ends the command at its time; without a link, only this does.
    let meanwhile = async |clock: &HostClock| {
        match watch.seconds {
            Some(seconds) => clock.sleep_until(clock.now_us() + ((seconds + GRACE_S) * 1e6) as u64).await,
            None => pending().await,
        }
        Err(lost.take().map_or_else(|| anyhow!("no answer"), Into::into))
    };
    let work = async |session: &Session<'_>| {
        let board = session.board;
        let infos: Vec<ChannelInfo> = match watch.channels.as_slice() {
            [] => board.channels().to_vec(),
            some => {
                // Remove duplicates.
                let each = some.iter().enumerate().filter(|(at, id)| !some[..*at].contains(id));
                each.map(|(_, id)| board.channel(*id).cloned()).collect::<Result<_, _>>()?
            }
        };
        let channels: Vec<ChannelId> = infos.iter().map(|info| info.id).collect();
        let mut watched = Watched::new(infos);
        let mut telemetry = board.telemetry();
        // Boards take periods in whole milliseconds.
        let period_ms = (1000.0 / watch.rate).round() as u16;
        for channel in channels {
            board.subscribe(channel, period_ms).await?;
        }
        // The duration counts from the first session and includes gaps of the link.
        end_s = end_s.or(watch.seconds.map(|seconds| board.now_s() + seconds));
        // Use the board's clock, which stamps the lines.
        let end_us = end_s.map(|end_s| board.device_us() + ((end_s - board.now_s()) * 1e6) as u64);
        let mut since_header = HEADER_EVERY;
        loop {
            let frame = telemetry.next().await?;
            if end_us.is_some_and(|end_us| frame.device_us > end_us) {
                return Ok(());
            }
            let Some(samples) = watched.take(&frame) else { continue };
            if args.json {
                print_json(&watched.infos, &frame, &samples)?;
            } else if watched.infos.len() > MOST_COLUMNS {
                print_list(&watched.infos, &frame, &samples)?;
            } else {
                if since_header == HEADER_EVERY {
                    output::line(header(&watched.infos, &samples))?;
                    since_header = 0;
                }
                since_header += 1;
                print_line(&watched.infos, &frame, &samples)?;
            }
        }
    };
    session::keep(args, Pace::RealTime(1.0), work, tell, meanwhile)?;
    Ok(true)
}

/// Time that the work has to end by itself after the requested duration, s.
const GRACE_S: f64 = 1.0;

/// Lines between two headers, about a screen.
const HEADER_EVERY: usize = 20;
/// Most channels in columns; more are printed below each other.
const MOST_COLUMNS: usize = 8;

fn print_json(infos: &[ChannelInfo], frame: &Telemetry, samples: &[Sample]) -> anyhow::Result<()> {
    output::json(&Line {
        time_s: time_s(frame),
        state: frame.state.to_string(),
        causes: frame.causes.iter().map(|cause| cause.to_string()).collect(),
        channels: infos.iter().zip(samples).map(|(info, sample)| Value::new(info, sample)).collect(),
    })
}

fn time_s(frame: &Telemetry) -> f64 {
    frame.device_us as f64 / 1e6
}

/// Header of [`print_line()`]: channels and units.
fn header(infos: &[ChannelInfo], samples: &[Sample]) -> String {
    let mut line = format!("{:>9}  {:<8}", "s", "state");
    for (info, sample) in infos.iter().zip(samples) {
        line += &format!("{:>13}", format!("{} {}", info.id, human(info.unit).1).trim_end());
        let value = Value::new(info, sample);
        for quantity in info.id.kind.quantities().iter().skip(1) {
            line += &format!("{:>10}", human(quantity.unit).1);
        }
        if value.speed.is_some() {
            line += &format!("{:>9}", human(speed_unit(info.unit)).1);
        }
        if value.duty.is_some() {
            line += &format!("{:>8}", "duty");
        }
    }
    line
}

/// Value of a sample in SI units, if it has one.
pub(super) fn number(info: &ChannelInfo, sample: &Sample) -> Option<f64> {
    Value::new(info, sample).value
}

/// Columns of a sample: value or its fault, speed, duty.
pub(super) fn columns(info: &ChannelInfo, sample: &Sample) -> [String; 3] {
    let value = Value::new(info, sample);
    let number = match *sample {
        Sample::Reading { quality, .. } | Sample::Sensor { quality, .. } if quality != Quality::Good => {
            fault(quality).to_owned()
        }
        _ => value.value.map_or("-".to_owned(), |value| Quantity::new(value, info.unit).number()),
    };
    let speed = value.speed.map(|speed| Quantity::new(speed.into(), speed_unit(info.unit)).number());
    let duty = value.duty.map(|duty| Quantity::new(duty.into(), Unit::Duty).number());
    [number, speed.unwrap_or_default(), duty.unwrap_or_default()]
}

/// Further quantities of a sensor after its first, as text.
fn further(sample: &Sample) -> Vec<String> {
    let Sample::Sensor { channel, values, quality, .. } = *sample else { return Vec::new() };
    let others = channel.kind.quantities().iter().zip(values).skip(1);
    let number = |(quantity, value): (&r4_protocol::Quantity, f32)| match quality {
        Quality::Good | Quality::Saturated => Quantity::new(value.into(), quantity.unit).number(),
        _ => "-".to_owned(),
    };
    others.map(number).collect()
}

/// Motor of a sample with a winding warning.
pub(super) fn hot(sample: &Sample) -> Option<HotWinding> {
    match *sample {
        Sample::Motor { channel, winding: Some(Winding { heat_percent, hot: true }), .. } => {
            Some(HotWinding { channel, heat_percent })
        }
        _ => None,
    }
}

/// Fault of a value, short enough for a column.
fn fault(quality: Quality) -> &'static str {
    match quality {
        Quality::Good => "good",
        Quality::None => "-",
        Quality::OutOfRange => "out of range",
        Quality::NoAnswer => "no answer",
        Quality::Stuck => "stuck",
        Quality::Low => "too low",
        Quality::High => "too high",
        Quality::Stale => "stale",
        Quality::WrongChip => "wrong chip",
        Quality::Saturated => "saturated",
        Quality::NoMagnet => "no magnet",
        Quality::WeakMagnet => "weak magnet",
        Quality::StrongMagnet => "strong magnet",
    }
}

fn print_line(infos: &[ChannelInfo], frame: &Telemetry, samples: &[Sample]) -> anyhow::Result<()> {
    let mut line = format!("{:9.3}  {:<8}", time_s(frame), frame.state.to_string());
    for (info, sample) in infos.iter().zip(samples) {
        let [number, speed, duty] = columns(info, sample);
        line += &format!("{number:>13}");
        for number in further(sample) {
            line += &format!("{number:>10}");
        }
        if !speed.is_empty() {
            line += &format!("{speed:>9}");
        }
        if !duty.is_empty() {
            line += &format!("{duty:>8}");
        }
    }
    for hot in samples.iter().filter_map(hot) {
        line += &format!("  {}", r4_rig::heat::words(&hot));
    }
    if !frame.causes.is_empty() {
        line += &format!("  {}", frame.causes);
    }
    Ok(output::line(line)?)
}

fn print_list(infos: &[ChannelInfo], frame: &Telemetry, samples: &[Sample]) -> anyhow::Result<()> {
    output::line(format_args!("{:.3} s  {}  {}", time_s(frame), frame.state, frame.causes))?;
    for (info, sample) in infos.iter().zip(samples) {
        let [number, speed, duty] = columns(info, sample);
        let mut line = format!("  {:<12}{number:>13} {:<4}", info.id.to_string(), human(info.unit).1);
        for (number, quantity) in further(sample).iter().zip(info.id.kind.quantities().iter().skip(1)) {
            line += &format!("{number:>10} {}", human(quantity.unit).1);
        }
        if !speed.is_empty() {
            line += &format!("{speed:>10} {:<6}", human(speed_unit(info.unit)).1);
        }
        if !duty.is_empty() {
            line += &format!("{duty:>8} duty");
        }
        if let Some(hot) = hot(sample) {
            line += &format!("  winding {} %", hot.heat_percent);
        }
        output::line(line.trim_end())?;
    }
    Ok(())
}
