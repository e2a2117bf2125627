//! `r4 watch`

use r4_protocol::{ChannelId, Sample, Telemetry};
use r4_sim::Pace;
use serde::Serialize;

use super::speed_unit;
use crate::{
    args::{Args, Watch},
    output,
    quantity::{Quantity, human},
    session::{self, Session},
};

/// One line of `--json`: an object per sample time.
#[derive(Serialize)]
struct Line {
    time_s: f64,
    state: String,
    causes: Vec<String>,
    channels: Vec<Value>,
}

/// A channel's value in SI.
#[derive(Serialize)]
struct Value {
    channel: String,
    unit: String,
    value: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    speed: Option<f32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    duty: Option<f32>,
}

pub(crate) fn run(args: &Args, watch: &Watch) -> anyhow::Result<bool> {
    session::run(args, Pace::RealTime(1.0), async |session| {
        let channels: Vec<ChannelId> = match watch.channels.as_slice() {
            [] => session.board.channels().iter().map(|info| info.id).collect(),
            some => some.to_vec(),
        };
        let mut telemetry = session.board.telemetry();
        let period_ms = (1000.0 / watch.rate).round() as u16;
        for channel in channels {
            session.board.channel(channel)?;
            session.board.subscribe(channel, period_ms).await?;
        }
        let end_us = watch.seconds.map(|seconds| session.board.device_us() + (seconds * 1e6) as u64);
        let (mut since_header, mut last_shape) = (0, Vec::new());
        loop {
            let frame = telemetry.next().await?;
            if end_us.is_some_and(|end_us| frame.device_us > end_us) {
                return Ok(());
            }
            // Channels join one after another at the start.
            let shape: Vec<_> = frame.samples.iter().map(Sample::channel).collect();
            if !args.json && (since_header == HEADER_EVERY || shape != last_shape) {
                output::line(header(session, &frame)?)?;
                since_header = 0;
            }
            since_header += 1;
            last_shape = shape;
            print(args, session, &frame)?;
        }
    })?;
    Ok(true)
}

/// The header is printed again after so many lines, about a screen.
const HEADER_EVERY: usize = 20;

/// Names and units above the columns of [`print()`].
fn header(session: &Session<'_>, frame: &Telemetry) -> anyhow::Result<String> {
    let mut line = format!("{:>9}  {:<8}", "s", "state");
    for sample in &frame.samples {
        let info = session.board.channel(sample.channel())?;
        line += &format!("{:>13}", format!("{} {}", info.id, human(info.unit).1));
        if let Sample::Motor { .. } = sample {
            line += &format!("{:>9}{:>8}", human(speed_unit(info.unit)).1, "duty");
        }
    }
    Ok(line)
}

fn print(args: &Args, session: &Session<'_>, frame: &Telemetry) -> anyhow::Result<()> {
    let mut values = Vec::new();
    for sample in &frame.samples {
        let info = session.board.channel(sample.channel())?;
        let (value, speed, duty) = match *sample {
            Sample::Motor { position, speed, duty, .. } => {
                (f64::from(position) * f64::from(info.resolution), Some(speed), Some(duty))
            }
            Sample::Scalar { value, .. } => (value.into(), None, None),
        };
        values
            .push((info.unit, Value { channel: info.id.to_string(), unit: info.unit.to_string(), value, speed, duty }));
    }
    let time_s = frame.device_us as f64 / 1e6;
    if args.json {
        return output::json(&Line {
            time_s,
            state: frame.state.to_string(),
            causes: frame.causes.iter().map(|cause| cause.to_string()).collect(),
            channels: values.into_iter().map(|(_, value)| value).collect(),
        });
    }
    let mut line = format!("{time_s:9.3}  {:<8}", frame.state.to_string());
    for (unit, value) in values {
        line += &format!("{:>13}", Quantity { value: value.value, unit }.number());
        if let (Some(speed), Some(duty)) = (value.speed, value.duty) {
            let speed = Quantity { value: speed.into(), unit: speed_unit(unit) };
            line += &format!("{:>9}{duty:>8.3}", speed.number());
        }
    }
    if !frame.causes.is_empty() {
        line += &format!("  {}", frame.causes);
    }
    Ok(output::line(line)?)
}
