//! `r4 log record`: records telemetry of a board to a log.

use std::{cell::RefCell, collections::BTreeSet, future::pending, path::PathBuf, pin::pin, time::Duration};

use anyhow::{Context, anyhow};
use futures::future::{Either, select};
use indicatif::{ProgressBar, ProgressStyle};
use r4_driver::Clock as _;
use r4_links::Event;
use r4_protocol::ChannelId;
use r4_sim::Pace;

use super::{info::Info, read};
use crate::{
    args::{Args, seconds},
    session::{self, HostClock, Session},
};

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Record {
    /// Channels to record [default: all]
    pub(crate) channels: Vec<ChannelId>,
    /// Log to write [default: --record, or the first free name of r4-1.mcap, r4-2.mcap ..]
    #[arg(long, value_name = "FILE")]
    pub(crate) out: Option<PathBuf>,
    /// Stop after this time [default: on Ctrl-C]
    #[arg(long = "for", value_parser = seconds, value_name = "SECONDS", allow_negative_numbers = true)]
    pub(crate) seconds: Option<f64>,
    /// Samples of each channel per second; the period is rounded to whole milliseconds
    #[arg(long, default_value_t = 100.0, value_parser = rate, value_name = "HZ")]
    pub(crate) rate: f64,
}

fn rate(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if (0.1..=1000.0).contains(&value) => Ok(value),
        _ => Err("0.1 to 1000 per second".into()),
    }
}

/// Time that a session has to end by itself after the requested duration, s.
const GRACE_S: f64 = 1.0;
/// Polling period for a failed recording, us.
const LOOK_EVERY_US: u64 = 50_000;

pub(super) fn run(args: &Args, record: &Record) -> anyhow::Result<bool> {
    let path = record.out.clone().or_else(|| args.record.clone()).map_or_else(free_name, Ok)?;
    let progress = ProgressBar::new_spinner().with_style(
        ProgressStyle::with_template("{spinner} {elapsed} recording, {msg}")
            .unwrap_or(ProgressStyle::default_spinner()),
    );
    progress.enable_steady_tick(Duration::from_millis(200));
    // `session::keep` writes the recording of `--record`.
    let recorded = Args { record: Some(path.clone()), ..args.clone() };
    let mut end_us = None;
    let lost = RefCell::new(None);
    let tell = |event| {
        progress.suspend(|| eprintln!("r4: {}", session::told(&event)));
        lost.replace(if let Event::Lost { why } = event { Some(why) } else { None });
    };
    // Without a link, no telemetry ends the recording in time.
    let meanwhile = async |clock: &HostClock| {
        match record.seconds {
            Some(seconds) => clock.sleep_until(clock.now_us() + ((seconds + GRACE_S) * 1e6) as u64).await,
            None => pending().await,
        }
        Err(lost.take().map_or_else(|| anyhow!("no answer"), Into::into))
    };
    let work = async |session: &Session<'_>| follow(session, record, &mut end_us, &progress).await;
    let recorded = session::keep(&recorded, Pace::RealTime(1.0), work, tell, meanwhile);
    progress.finish_and_clear();
    match recorded {
        // Ctrl-C is the usual end of a recording.
        Err(error) if !session::was_interrupted(&error) => return Err(error),
        Ok(()) | Err(_) => {}
    }
    let log = read(&path)?;
    let info = Info::of(&path, &log);
    info.print(args)?;
    if info.missing() > 0 {
        eprintln!("r4: {} samples did not arrive: record fewer channels, or at a lower --rate", info.missing());
    }
    Ok(info.missing() == 0 && log.warnings.is_empty())
}

/// First free file name.
fn free_name() -> anyhow::Result<PathBuf> {
    let names = (1..10_000).map(|number| PathBuf::from(format!("r4-{number}.mcap")));
    names.into_iter().find(|path| !path.exists()).context("there are too many logs here: name one with --out")
}

/// Subscribes to the channels and waits while the tap records. `end_us` is the end of the recording, set by the first
/// session.
async fn follow(
    session: &Session<'_>,
    record: &Record,
    end_us: &mut Option<u64>,
    progress: &ProgressBar,
) -> anyhow::Result<()> {
    let board = session.board;
    let mut channels: Vec<ChannelId> = match record.channels.as_slice() {
        [] => board.channels().iter().map(|info| info.id).collect(),
        some => some.to_vec(),
    };
    // A channel named twice is subscribed to once.
    let mut seen = BTreeSet::new();
    channels.retain(|channel| seen.insert(*channel));
    for channel in &channels {
        board.channel(*channel)?;
    }
    let period_ms = (1000.0 / record.rate).round() as u16;
    let mut telemetry = board.telemetry();
    for channel in channels {
        board.subscribe(channel, period_ms).await?;
    }
    let clock = &session.clock;
    *end_us = end_us.or(record.seconds.map(|seconds| clock.now_us() + (seconds * 1e6) as u64));
    let end_us = *end_us;
    while end_us.is_none_or(|end_us| clock.now_us() < end_us) {
        let look_us = clock.now_us() + LOOK_EVERY_US;
        let until_us = end_us.map_or(look_us, |end_us| end_us.min(look_us));
        // The end of the link ends the stream; the tap records the frames.
        if let Either::Left((frame, _)) = select(pin!(telemetry.next()), pin!(clock.sleep_until(until_us))).await {
            frame?;
        }
        if let Some(tap) = &session.tap {
            let tap = tap.borrow();
            progress.set_message(format!("{} samples", tap.samples()));
            // The error is reported when the recording is closed.
            if tap.failure().is_some() {
                break;
            }
        }
    }
    Ok(())
}
