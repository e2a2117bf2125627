//! `r4 info`: board, firmware, state and channels.

use r4_protocol::{ChannelInfo, DeviceStats, Unit, message::CONTROL_SHARE};
use r4_sim::Pace;
use serde::Serialize;

use super::state::Hot;
use crate::{args::Args, output, session, table};
use r4_rig::quantity::human;

#[derive(Serialize)]
struct Report {
    board: String,
    robot: String,
    firmware: String,
    protocol: u16,
    state: String,
    causes: Vec<String>,
    hot_windings: Vec<Hot>,
    link_timeout_ms: u16,
    control: Control,
    can: Can,
    channels: Vec<Channel>,
}

/// Control periods since the board started.
#[derive(Serialize)]
struct Control {
    ticks: u32,
    late_ticks: u32,
    worst_tick_us: u32,
    /// Most processor cycles of the control task in one period; 0 where the firmware does not count them.
    worst_tick_cycles: u32,
    /// Periods in which the control task exceeded its share of the processor.
    ticks_over_share: u32,
}

impl From<&DeviceStats> for Control {
    fn from(stats: &DeviceStats) -> Self {
        let DeviceStats { ticks, late_ticks, worst_tick_us, worst_tick_cycles, ticks_over_share, .. } = *stats;
        Self { ticks, late_ticks, worst_tick_us, worst_tick_cycles, ticks_over_share }
    }
}

/// Error counters of the board's CAN bus since its start.
#[derive(Serialize)]
struct Can {
    bus_off: u32,
    error_warnings: u32,
}

#[derive(Serialize)]
struct Channel {
    id: String,
    kind: &'static str,
    unit: String,
    min: f32,
    max: f32,
    rate_hz: f32,
    modes: Vec<ModeLimits>,
    #[serde(skip)]
    si: Unit,
}

#[derive(Serialize)]
struct ModeLimits {
    mode: String,
    unit: String,
    min: f32,
    max: f32,
    #[serde(skip)]
    si: Unit,
}

impl From<&ChannelInfo> for Channel {
    fn from(info: &ChannelInfo) -> Self {
        let limits = |mode: &r4_protocol::ModeInfo| ModeLimits {
            mode: mode.mode.to_string(),
            unit: mode.unit.to_string(),
            min: finite(mode.range.min),
            max: finite(mode.range.max),
            si: mode.unit,
        };
        Self {
            id: info.id.to_string(),
            kind: info.id.kind.name(),
            unit: info.unit.to_string(),
            min: finite(info.range.min),
            max: finite(info.range.max),
            rate_hz: info.rate_hz,
            modes: info.modes.iter().map(limits).collect(),
            si: info.unit,
        }
    }
}

pub(crate) fn run(args: &Args) -> anyhow::Result<bool> {
    let (report, _) = session::run(args, Pace::Free, async |session| {
        let stats = session.board.stats().await?;
        let info = session.board.info();
        let hot = session.board.hot_windings();
        Ok(Report {
            board: args.board.to_string(),
            robot: info.robot.to_string(),
            firmware: info.firmware.to_string(),
            protocol: r4_protocol::VERSION,
            state: info.state.to_string(),
            causes: info.causes.iter().map(|cause| cause.to_string()).collect(),
            hot_windings: hot.iter().map(Hot::from).collect(),
            link_timeout_ms: info.link_timeout_ms,
            control: Control::from(&stats),
            can: Can { bus_off: stats.can_bus_off, error_warnings: stats.can_warnings },
            channels: session.board.channels().iter().map(Channel::from).collect(),
        })
    })?;
    if args.json {
        output::json(&report)?;
        return Ok(true);
    }
    output::line(format_args!(
        "{}: robot {}, firmware {}, protocol {}, {}, link timeout {} ms",
        report.board, report.robot, report.firmware, report.protocol, report.state, report.link_timeout_ms
    ))?;
    for cause in &report.causes {
        output::line(format_args!("  tripped by: {cause}"))?;
    }
    let Control { ticks, late_ticks, worst_tick_us, worst_tick_cycles, ticks_over_share } = report.control;
    // Print counters only where they differ from a healthy board's.
    if late_ticks != 0 {
        output::line(format_args!(
            "  {late_ticks} of {ticks} control periods were late, the longest took {worst_tick_us} us"
        ))?;
    }
    if worst_tick_cycles != 0 {
        output::line(format_args!(
            "  control took {worst_tick_cycles} cycles of the processor at most; {ticks_over_share} periods more than {:.0} %",
            CONTROL_SHARE * 100.0
        ))?;
    }
    let Can { bus_off, error_warnings } = report.can;
    if bus_off != 0 || error_warnings != 0 {
        output::line(format_args!(
            "  CAN: off the bus {bus_off} times, {error_warnings} warnings of errors: check wiring, termination and bit rate"
        ))?;
    }
    for hot in &report.hot_windings {
        output::line(format_args!("  {} winding {} %", hot.channel, hot.heat_percent))?;
    }
    let mut table = table::new(&["channel", "mode", "min", "max", "unit", "rate Hz"], 2..4);
    for channel in &report.channels {
        let rate = format!("{:.0}", channel.rate_hz);
        if channel.modes.is_empty() {
            let [min, max, unit] = limits(channel.min, channel.max, channel.si);
            table.add_row([&channel.id, "measured", &min, &max, &unit, &rate]);
        }
        for (index, mode) in channel.modes.iter().enumerate() {
            let id = if index == 0 { channel.id.as_str() } else { "" };
            let [min, max, unit] = limits(mode.min, mode.max, mode.si);
            table.add_row([id, &mode.mode, &min, &max, &unit, &rate]);
        }
    }
    output::line(table)?;
    Ok(true)
}

/// Limits an infinite value to the largest finite one: JSON has no infinity.
fn finite(limit: f32) -> f32 {
    limit.clamp(-f32::MAX, f32::MAX)
}

/// Both ends of a range and its unit, as text.
fn limits(min: f32, max: f32, unit: Unit) -> [String; 3] {
    let (factor, name, _) = human(unit);
    let shown = |value: f32| match value {
        value if value.abs() == f32::MAX => "unlimited".to_owned(),
        value => digits((f64::from(value) * factor) as f32),
    };
    [shown(min), shown(max), if name.is_empty() { unit.to_string() } else { name.to_owned() }]
}

/// Formats at most five significant digits, which hides the rounding of binary fractions.
fn digits(value: f32) -> String {
    let magnitude = value.abs().max(1e-9).log10().floor() as i32;
    let text = format!("{value:.*}", (4 - magnitude).clamp(0, 6) as usize);
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}
