//! `r4 faults`: the trips stored on a board.

use anyhow::{Context, anyhow};
use r4_protocol::{Causes, ChannelInfo, ChannelKind, FaultInfo, FaultSnapshot};
use r4_sim::Pace;
use serde::Serialize;

use crate::{
    args::Args,
    output,
    session::{self, Target},
    table,
};
use r4_rig::quantity::{Quantity, human, speed_unit};

#[derive(Serialize)]
struct History {
    board: String,
    faults: Vec<Fault>,
}

/// One trip, in SI units.
#[derive(Serialize)]
struct Fault {
    index: usize,
    number: u32,
    start: u32,
    time_s: f64,
    causes: Vec<String>,
    snapshots: u8,
}

#[derive(Serialize)]
struct Before {
    board: String,
    #[serde(flatten)]
    fault: Fault,
    before: Vec<Moment>,
}

/// Snapshot of the board before a trip, in SI units.
#[derive(Serialize)]
struct Moment {
    before_ms: u16,
    motors: Vec<Motor>,
    supplies: Vec<Supply>,
}

#[derive(Serialize)]
struct Motor {
    channel: String,
    unit: String,
    /// Position in rad or m; null without a sensor.
    position: Option<f64>,
    speed: f32,
    duty: f32,
}

#[derive(Serialize)]
struct Supply {
    channel: String,
    voltage_v: f32,
}

impl Fault {
    fn new(index: usize, info: &FaultInfo) -> Self {
        Self {
            index,
            number: info.number,
            start: info.start,
            time_s: info.device_us as f64 / 1e6,
            causes: info.causes.iter().map(|cause| cause.to_string()).collect(),
            snapshots: info.snapshots,
        }
    }
}

/// Channels that the snapshots contain.
struct Watched {
    motors: Vec<ChannelInfo>,
    supplies: Vec<ChannelInfo>,
}

pub(crate) fn run(args: &Args, index: Option<u8>) -> anyhow::Result<bool> {
    match index {
        None => history(args),
        Some(index) => before(args, index),
    }
}

fn history(args: &Args) -> anyhow::Result<bool> {
    let (infos, _) = session::run(args, Pace::Free, async |session| Ok(session.board.faults().await?))?;
    let faults: Vec<Fault> = infos.iter().enumerate().map(|(index, info)| Fault::new(index, info)).collect();
    if args.json {
        output::json(&History { board: args.board.to_string(), faults })?;
        return Ok(true);
    }
    if faults.is_empty() {
        output::line(format_args!("{} has no stored trip", args.board))?;
        if args.flash.is_none() && !matches!(args.board, Target::Link(_)) {
            eprintln!("r4: a simulated board keeps its trips from one command to the next only with --flash FILE");
        }
        return Ok(true);
    }
    let mut table = table::new(&["index", "trip", "start", "time s", "causes"], 0..4);
    for fault in &faults {
        table.add_row([
            fault.index.to_string(),
            fault.number.to_string(),
            fault.start.to_string(),
            format!("{:.3}", fault.time_s),
            fault.causes.join(", "),
        ]);
    }
    output::line(table)?;
    output::line(
        "start counts the starts of the board, time is since that start; `r4 faults INDEX` shows the time before a trip",
    )?;
    Ok(true)
}

fn before(args: &Args, index: u8) -> anyhow::Result<bool> {
    let ((info, snapshots, watched), _) = session::run(args, Pace::Free, async |session| {
        let board = session.board;
        let faults = board.faults().await?;
        let known = faults.len();
        let info = faults.get(usize::from(index)).copied();
        let info = info
            .ok_or_else(|| anyhow!("there is no trip {index}, the board has {known} stored: `r4 faults` lists them"))?;
        let of_kind = |kinds: &[ChannelKind]| -> Vec<ChannelInfo> {
            board.channels().iter().filter(|info| kinds.contains(&info.id.kind)).cloned().collect()
        };
        let motors = of_kind(&[ChannelKind::Osmc, ChannelKind::Actuator, ChannelKind::Dhb]);
        let watched = Watched { motors, supplies: of_kind(&[ChannelKind::Supply]) };
        let snapshots = board.fault_snapshots(index).await.context("cannot read what came before the trip")?;
        Ok((info, snapshots, watched))
    })?;
    let fault = Fault::new(index.into(), &info);
    if args.json {
        let before = snapshots.iter().map(|snapshot| watched.moment(snapshot)).collect();
        output::json(&Before { board: args.board.to_string(), fault, before })?;
        return Ok(true);
    }
    output::line(format_args!(
        "trip {}, {:.3} s after start {}: {}",
        fault.number,
        fault.time_s,
        fault.start,
        fault.causes.join(", ")
    ))?;
    advise(info.causes)?;
    output::line(watched.table(&snapshots))?;
    Ok(true)
}

fn advise(causes: Causes) -> anyhow::Result<()> {
    for cause in causes.iter() {
        output::line(format_args!("  {cause}: {}", cause.advice()))?;
    }
    Ok(())
}

impl Watched {
    fn moment(&self, snapshot: &FaultSnapshot) -> Moment {
        let motors = self.motors.iter().zip(&snapshot.motors).map(|(info, motor)| Motor {
            channel: info.id.to_string(),
            unit: info.unit.to_string(),
            position: position(info, motor.position),
            speed: motor.speed,
            duty: motor.duty,
        });
        let supplies = self.supplies.iter().zip(&snapshot.supplies_v);
        let supplies = supplies.map(|(info, volts)| Supply { channel: info.id.to_string(), voltage_v: *volts });
        Moment { before_ms: snapshot.before_ms, motors: motors.collect(), supplies: supplies.collect() }
    }

    fn table(&self, snapshots: &[FaultSnapshot]) -> comfy_table::Table {
        let mut header = vec!["ms before".to_owned()];
        for info in &self.motors {
            // A motor without a sensor has only its duty in a snapshot.
            let measured = info.resolution > 0.0;
            // The channel's name stands above its first column only.
            let mut name = info.id.to_string();
            let units = [(human(info.unit).1, measured), (human(speed_unit(info.unit)).1, measured), ("duty", true)];
            let shown = units.iter().filter(|(_, shown)| *shown);
            header.extend(shown.map(|(unit, _)| format!("{}\n{unit}", std::mem::take(&mut name))));
        }
        header.extend(self.supplies.iter().map(|info| format!("{}\nV", info.id)));
        let header: Vec<&str> = header.iter().map(String::as_str).collect();
        let mut table = table::new(&header, 0..header.len());
        for snapshot in snapshots {
            let mut row = vec![snapshot.before_ms.to_string()];
            for (info, motor) in self.motors.iter().zip(&snapshot.motors) {
                if let Some(value) = position(info, motor.position) {
                    row.push(Quantity::new(value, info.unit).number());
                    row.push(Quantity::new(motor.speed.into(), speed_unit(info.unit)).number());
                }
                row.push(format!("{:.3}", motor.duty));
            }
            row.extend(snapshot.supplies_v.iter().map(|volts| format!("{volts:.2}")));
            table.add_row(row);
        }
        table
    }
}

/// Position in rad or m; `None` without a sensor.
fn position(info: &ChannelInfo, counts: i32) -> Option<f64> {
    (info.resolution > 0.0).then(|| f64::from(counts) * f64::from(info.resolution))
}
