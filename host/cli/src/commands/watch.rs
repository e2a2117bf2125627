//! `r4 watch`

use r4_protocol::{ChannelId, Sample, Telemetry, Unit};
use r4_sim::Pace;
use serde::Serialize;

use crate::{
    args::{Args, Watch},
    output,
    quantity::Quantity,
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
        loop {
            let frame = telemetry.next().await?;
            if end_us.is_some_and(|end_us| frame.device_us > end_us) {
                return Ok(());
            }
            print(args, session, &frame)?;
        }
    })?;
    Ok(true)
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
    let mut line = format!("{time_s:9.3} s  {:<8}", frame.state.to_string());
    for (unit, value) in values {
        let speed_unit = if unit == Unit::M { Unit::MPerS } else { Unit::RadPerS };
        let quantity = Quantity { value: value.value, unit };
        line += &format!("  {} {:>10}", value.channel, quantity.to_string());
        if let (Some(speed), Some(duty)) = (value.speed, value.duty) {
            let speed = Quantity { value: speed.into(), unit: speed_unit };
            line += &format!(" {:>11} duty {duty:+.3}", speed.to_string());
        }
    }
    if !frame.causes.is_empty() {
        line += &format!("  {}", frame.causes);
    }
    Ok(output::line(line)?)
}
