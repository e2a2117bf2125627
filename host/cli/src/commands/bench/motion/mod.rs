//! `r4 bench motion`: limits of motion on a board that a planner relies on, measured on simulated boards in virtual
//! time.

mod population;
mod speed;
mod tuning;

use std::cell::Cell;

use r4_driver::tune::Loop;
use r4_maths::statistics::{self, QuantileRule};
use r4_protocol::{ChannelId, ChannelKind, Mode, PathPoint, Sample, Setpoint};
use r4_rig::{Error, Fleet, Rig, Session};
use serde::Serialize;

use self::tuning::{MARGIN_DEG, OVERSHOOT, Tuned};
use crate::{
    args::{Args, BenchMotion},
    emulated, output, table,
};

/// Robot with the streamed wheels, and one of its wheels.
const WHEELS: &str = "sim:openscout";
const WHEEL: ChannelId = ChannelId::new(ChannelKind::Dhb, 0);
/// Speeds of the streamed paths, rad/s.
const SPEEDS_RAD_S: [f64; 3] = [2.0, 4.0, 6.0];
/// Period of the set points or path points, and lead of the path points, s.
const EVERY_S: f64 = 0.02;
const AHEAD_S: f64 = 0.1;
/// Acceleration time and duration of the paths, s, and the last part of them in which the lag is measured.
const SPEED_UP_S: f64 = 1.0;
const LASTS_S: f64 = 5.0;
const MEASURED_S: f64 = 1.0;
/// Limit of the lag at constant speed, counts.
const LAG_COUNTS: f64 = 2.0;
/// Least share of sampled motors that `r4 tune` must tune.
const LEAST_TUNED: f64 = 0.98;
/// Frequencies at which a motor's speed oscillates, and limits of its estimate: gain within 10 %, and at most half the
/// delay of the 10 ms low-pass.
const SWINGS_HZ: [f64; 3] = [2.0, 5.0, 10.0];
const SPEED_GAIN: f64 = 0.9;
const SPEED_DELAY_S: f64 = 0.005;
/// Emulated robots whose control ticks are counted, and the 99.9 % quantile of their instructions (docs/performance.md)
/// in the firmware before it had paths, jerk limits and learned friction.
const TICKS: [(&str, f64); 2] = [("osmc-bench", 6544.0), ("every-interface", 18_872.0)];
/// Length of the count, s: the default of `r4 bench firmware`.
const TICKS_S: f64 = 10.0;
/// Limit of the spread between channels or boards that start together: one period of 1 ms.
const TOGETHER_S: f64 = 0.001;

#[derive(Serialize)]
struct Row {
    what: String,
    unit: &'static str,
    /// Value of the previous firmware or method; null for none.
    before: Option<f64>,
    after: f64,
    at_least: Option<f64>,
    at_most: Option<f64>,
    met: bool,
}

#[derive(Serialize)]
struct Report {
    rows: Vec<Row>,
    held: bool,
    /// Sampled motors that miss a limit after tuning.
    failed: Vec<Failed>,
    /// Measurements that are missing, each with its reason.
    left_out: Vec<String>,
}

#[derive(Serialize)]
struct Failed {
    #[serde(serialize_with = "in_words")]
    mode: Loop,
    seed: u64,
    why: String,
}

fn in_words<S: serde::Serializer>(mode: &Loop, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_str(&format_args!("{mode:?}"))
}

pub(super) fn run(args: &Args, asked: &BenchMotion) -> anyhow::Result<bool> {
    let mut rows = Vec::new();
    for speed in SPEEDS_RAD_S {
        let rig = Rig { seed: args.seed, ..Rig::new(WHEELS.parse()?) };
        let before = rig.run(None, async |session| lag_counts(session, speed, false).await)?.0;
        let after = rig.run(None, async |session| lag_counts(session, speed, true).await)?.0;
        rows.push(at_most(format!("lag of {WHEEL} at {speed} rad/s"), "counts", Some(before), after, LAG_COUNTS));
    }
    for hz in SWINGS_HZ {
        let [before, after] = [false, true].map(|has_model| speed::seen(args, hz, has_model));
        let (before, after) = (before?, after?);
        let (what, least) = (format!("gain of the estimated speed at {hz} Hz"), SPEED_GAIN);
        rows.push(at_least(what, "1", Some(before.gain), after.gain, least));
        let (what, most) = (format!("delay of the estimated speed at {hz} Hz"), SPEED_DELAY_S);
        rows.push(at_most(what, "s", Some(before.delay_s.abs()), after.delay_s.abs(), most));
    }
    let rig = Rig { seed: args.seed, ..Rig::new(WHEELS.parse()?) };
    let began = rig.run(None, async |session| begins_s(session, 0.0).await)?.0;
    rows.push(at_most("four wheels begin within".to_owned(), "s", None, spread(&began), TOGETHER_S));
    let fleet = Fleet::new(vec![rig.clone(), Rig { seed: args.seed.wrapping_add(1), ..rig }]);
    // Connect the boards at different times.
    let member = async |number: usize, session: &Session<'_>| begins_s(session, 0.037 * number as f64).await;
    let (_, began, _) = fleet.run(member, async |_| Ok::<_, Error>(()))?;
    rows.push(at_most("wheels of two boards begin within".to_owned(), "s", None, spread(&began.concat()), TOGETHER_S));
    let mut failed = Vec::new();
    for of in [Loop::Position, Loop::Speed, Loop::Cascade] {
        let tuned = tuning::all(asked.from, asked.motors, of, |tuned| {
            if asked.each {
                eprintln!("{of:?} {tuned}");
            }
        })?;
        rows.extend(tuning_rows(of, &tuned));
        failed.extend(
            tuned.into_iter().filter_map(|tuned| Some(Failed { mode: of, seed: tuned.seed, why: tuned.fails? })),
        );
    }
    let mut left_out = Vec::new();
    for (robot, before) in TICKS.into_iter().filter(|_| !asked.no_ticks) {
        match emulated::tick(args.seed, robot, TICKS_S) {
            Ok((p999, most)) => {
                let what = format!("99.9 % of emu:{robot}'s control ticks");
                rows.push(at_most(what, "instructions", Some(before), p999, most));
            }
            Err(error) => left_out.push(format!("control ticks of emu:{robot} are not counted: {error:#}")),
        }
    }
    let held = rows.iter().all(|row| row.met);
    let report = Report { rows, held, failed, left_out };
    if args.json {
        output::json(&report)?;
        return Ok(held);
    }
    let mut table = table::new(&["simulated", "unit", "before", "after", "limit", "met"], 2..5);
    for Row { what, unit, before, after, at_most, at_least, met } in &report.rows {
        let most = at_most.map(|limit| format!("at most {limit}"));
        let least = at_least.map(|limit| format!("at least {limit}"));
        table.add_row([
            what.clone(),
            (*unit).to_owned(),
            before.map_or("-".to_owned(), |before| format!("{before:.4}")),
            format!("{after:.4}"),
            most.or(least).unwrap_or_default(),
            if *met { "yes" } else { "no" }.to_owned(),
        ]);
    }
    output::line(format_args!("{table}"))?;
    for Failed { mode, seed, why } in &report.failed {
        output::line(format_args!("{mode:?} loop of sampled motor {seed}: {why}"))?;
    }
    for why in &report.left_out {
        output::line(format_args!("{why}"))?;
    }
    Ok(held)
}

fn at_most(what: String, unit: &'static str, before: Option<f64>, after: f64, limit: f64) -> Row {
    Row { what, unit, before, after, at_least: None, at_most: Some(limit), met: after <= limit }
}

fn at_least(what: String, unit: &'static str, before: Option<f64>, after: f64, limit: f64) -> Row {
    Row { what, unit, before, after, at_least: Some(limit), at_most: None, met: after >= limit }
}

/// Rows of one loop: share of motors tuned within the limits, beside the share that already met them with their old
/// gains; overshoot and phase margin of the tuned ones.
fn tuning_rows(of: Loop, tuned: &[Tuned]) -> Vec<Row> {
    let share = |good: usize| good as f64 / tuned.len().max(1) as f64;
    let good: Vec<&Tuned> = tuned.iter().filter(|tuned| tuned.fails.is_none()).collect();
    let was_good = tuned.iter().filter(|tuned| tuned.was_good()).count();
    let overshoots: Vec<f64> = good.iter().filter_map(|tuned| Some(tuned.after?.overshoot)).collect();
    let margins = good.iter().filter_map(|tuned| tuned.margin_deg);
    let name = format!("{of:?}").to_lowercase();
    let motors = tuned.len();
    vec![
        at_least(
            format!("{name} loops tuned, of {motors}"),
            "share",
            Some(share(was_good)),
            share(good.len()),
            LEAST_TUNED,
        ),
        at_most(format!("their median overshoot, {name}"), "share", None, quantile(&overshoots, 0.5), OVERSHOOT),
        at_most(format!("their worst overshoot, {name}"), "share", None, quantile(&overshoots, 1.0), OVERSHOOT),
        at_least(
            format!("their least phase margin, {name}"),
            "deg",
            None,
            margins.fold(f64::INFINITY, f64::min),
            MARGIN_DEG,
        ),
    ]
}

/// Quantile of unsorted numbers; NaN of none, which meets no limit.
fn quantile(of: &[f64], share: f64) -> f64 {
    statistics::quantile(of, share, QuantileRule::NearestPosition).unwrap_or(f64::NAN)
}

fn spread(of: &[f64]) -> f64 {
    let least = of.iter().copied().fold(f64::INFINITY, f64::min);
    of.iter().copied().fold(f64::NEG_INFINITY, f64::max) - least
}

/// Position of the path `after_s` seconds from its beginning, rad.
fn law(speed: f64, after_s: f64) -> f64 {
    if after_s < SPEED_UP_S {
        speed * after_s.max(0.0).powi(2) / (2.0 * SPEED_UP_S)
    } else {
        speed * (after_s - SPEED_UP_S / 2.0)
    }
}

/// Largest distance from the path at constant speed, counts: with path points if `dated`, otherwise with position set
/// points.
async fn lag_counts(session: &Session<'_>, speed: f64, dated: bool) -> Result<f64, Error> {
    let board = session.board;
    let resolution = f64::from(board.channel(WHEEL)?.resolution);
    let mut samples = board.samples(WHEEL, 1).await?;
    let worst = Cell::new(0.0f64);
    session
        .armed(async || {
            board.sleep_s(0.1).await;
            let begin_us = board.device_us() + (AHEAD_S * 1e6) as u64;
            let after_s = |device_us: u64| (device_us as f64 - begin_us as f64) * 1e-6;
            for number in 0..=(LASTS_S / EVERY_S) as u64 {
                let at_us = begin_us + number * (EVERY_S * 1e6) as u64;
                let value = law(speed, after_s(at_us)) as f32;
                if dated {
                    let point = PathPoint { at_us, position: value, speed: None, feed_forward: 0.0 };
                    board.follow(WHEEL, &[point]).await?;
                } else {
                    let wait_us = at_us.saturating_sub(board.device_us());
                    board.sleep_s(wait_us as f64 * 1e-6).await;
                    board.set(WHEEL, Setpoint { mode: Mode::Position, value }).await?;
                }
                // Path points are sent ahead of their time, set points at their time.
                let next_us = at_us + (EVERY_S * 1e6) as u64 - if dated { (AHEAD_S * 1e6) as u64 } else { 0 };
                board.sleep_s(next_us.saturating_sub(board.device_us()) as f64 * 1e-6).await;
                while let Some(sample) = samples.try_next() {
                    let Sample::Motor { position, .. } = sample.sample else { continue };
                    let after_s = after_s(sample.device_us);
                    if (LASTS_S - MEASURED_S..LASTS_S).contains(&after_s) {
                        let distance = law(speed, after_s) / resolution - f64::from(position);
                        worst.set(worst.get().max(distance.abs()));
                    }
                }
            }
            Ok::<_, Error>(())
        })
        .await?;
    Ok(worst.get())
}

/// Times at which the set points of all wheels leave 0, s, on the host's clock. The paths are sent at different times
/// for a common start.
async fn begins_s(session: &Session<'_>, later_s: f64) -> Result<Vec<f64>, Error> {
    const BEGIN_S: f64 = 2.0;
    let board = session.board;
    board.sleep_s(later_s).await;
    let wheels: Vec<ChannelId> = (0..4).map(|index| ChannelId::new(ChannelKind::Dhb, index)).collect();
    let mut left: Vec<Option<f64>> = vec![None; wheels.len()];
    for wheel in &wheels {
        board.subscribe(*wheel, 1).await?;
    }
    session
        .armed(async || {
            let mut telemetry = board.telemetry();
            // One time on the host's clock, converted to each board's clock.
            let ahead_us = ((BEGIN_S - board.now_s()) * 1e6).round() as u64;
            let begin_us = board.device_us() + ahead_us;
            for wheel in &wheels {
                let rest = |at_us, position| PathPoint { at_us, position, speed: Some(0.0), feed_forward: 0.0 };
                board.follow(*wheel, &[rest(begin_us, 0.0), rest(begin_us + 1_000_000, 1.0)]).await?;
                board.sleep_s(0.05).await;
            }
            board.sleep_s(BEGIN_S + 0.1 - board.now_s()).await;
            while let Some(frame) = telemetry.try_next() {
                for sample in frame.samples {
                    let Sample::Motor { channel, setpoint, .. } = sample else { continue };
                    let Some(place) = wheels.iter().position(|wheel| *wheel == channel) else { continue };
                    if setpoint.mode == Mode::Follow && setpoint.value > 0.0 && left[place].is_none() {
                        left[place] = Some(board.host_us(frame.device_us) as f64 * 1e-6);
                    }
                }
            }
            Ok::<_, Error>(())
        })
        .await?;
    Ok(left.into_iter().map(|left| left.unwrap_or(f64::INFINITY)).collect())
}
