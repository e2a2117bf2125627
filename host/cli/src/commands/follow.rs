//! `r4 follow`: moves motors along paths from a table.

use std::{fs, path::Path};

use anyhow::Context;
use r4_rig::{Followed, Paths, Quantity};
use r4_sim::Pace;
use serde::Serialize;

use crate::{args::Args, output, session, table};

/// Result of one motor's path, in SI units.
#[derive(Serialize)]
struct Row {
    channel: String,
    unit: String,
    points: usize,
    worst: f64,
    rms: f64,
    lag_s: f64,
    end: f64,
    settled: bool,
}

#[derive(Serialize)]
struct Report {
    board: String,
    duration_s: f64,
    rows: Vec<Row>,
    /// True if every motor came to rest at the end of its path.
    held: bool,
}

pub(crate) fn run(args: &Args, file: &Path) -> anyhow::Result<bool> {
    let what = || format!("cannot follow {}", file.display());
    let paths = Paths::parse(&fs::read_to_string(file).with_context(what)?).with_context(what)?;
    let (followed, _) = session::run(args, Pace::Free, async |session| Ok(session.follow(&paths, None).await?))?;
    let held = followed.iter().all(|path| path.settled);
    if args.json {
        let rows = followed.iter().map(row).collect();
        output::json(&Report { board: args.board.to_string(), duration_s: paths.duration_s(), rows, held })?;
        return Ok(held);
    }
    let mut rows = table::new(&["motor", "points", "worst", "RMS", "lag ms", "at the end", "rests"], 1..6);
    for Followed { info, points, worst, rms, lag_s, end, settled } in &followed {
        let quantity = |value: f64| Quantity::new(value, info.unit).to_string();
        rows.add_row([
            info.id.to_string(),
            points.to_string(),
            quantity(*worst),
            quantity(*rms),
            format!("{:.1}", lag_s * 1e3),
            quantity(*end),
            if *settled { "yes" } else { "no" }.to_owned(),
        ]);
    }
    output::line(format_args!("{rows}"))?;
    output::line(format_args!(
        "distances from the path by the motors' own sensors, over {:.2} s, on {}",
        paths.duration_s(),
        args.board.described()
    ))?;
    for path in followed.iter().filter(|path| !path.settled) {
        eprintln!("r4: {} did not come to rest at the end of its path, on {}", path.info.id, args.board.described());
    }
    Ok(held)
}

fn row(followed: &Followed) -> Row {
    let Followed { info, points, worst, rms, lag_s, end, settled } = followed;
    Row {
        channel: info.id.to_string(),
        unit: info.unit.to_string(),
        points: *points,
        worst: *worst,
        rms: *rms,
        lag_s: *lag_s,
        end: *end,
        settled: *settled,
    }
}
