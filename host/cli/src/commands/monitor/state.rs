//! State of the screen, updated by telemetry; independent of terminal and clock.

use std::collections::VecDeque;

use r4_driver::Error;
use r4_protocol::{
    Causes, ChannelId, ChannelInfo, DeviceInfo, DeviceStats, FaultInfo, ParameterInfo, Quality, Refusal, SafetyState,
    Sample, Telemetry, Unit,
};

use super::{
    Ask,
    order::{Order, takes},
};
use crate::commands::watch;

/// Length of the history of each channel, s.
pub(crate) const HISTORY_S: f64 = 60.0;
/// Window of the rates, s.
const RATE_OVER_S: f64 = 2.0;
/// Time from a trip until the board has stored it in its history, s.
const TRIP_WRITTEN_S: f64 = 1.0;
/// Most signals on the graph: one per distinguishable colour.
pub(crate) const MOST_MARKED: usize = 6;
/// Time without telemetry after which the board counts as silent, s: two link time-outs of 200 ms.
pub(crate) const SILENT_S: f64 = 0.4;

/// State that the screen shows.
pub(crate) struct State {
    pub(crate) board: String,
    pub(crate) robot: String,
    pub(crate) firmware: String,
    pub(crate) safety: SafetyState,
    pub(crate) causes: Causes,
    /// Board's clock in the last telemetry, s.
    pub(crate) device_s: f64,
    /// Host's clock at the time of drawing, s.
    pub(crate) now_s: f64,
    pub(crate) rows: Vec<Row>,
    pub(crate) selected: usize,
    pub(crate) link: Link,
    pub(crate) message: Option<Message>,
    pub(crate) view: View,
    /// First visible line of a list that is longer than the screen.
    pub(crate) scroll: usize,
    /// Channels on the graph; empty for the selected channel alone.
    pub(crate) marked: Vec<ChannelId>,
    /// Prompt for a set point of the selected channel, while it is open.
    pub(crate) prompt: Option<Prompt>,
    /// Parameters of the board; `None` until read.
    pub(crate) parameters: Option<Vec<ParameterInfo>>,
    /// Trips, newest first; `None` until read.
    pub(crate) trips: Option<Vec<FaultInfo>>,
    wants_parameters: bool,
    /// Time at which the trips are read again, s, on the host's clock.
    wants_trips_s: Option<f64>,
}

/// Content below the head of the screen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum View {
    Channels,
    Parameters,
    Trips,
    Help,
}

/// Typed set point and its error.
#[derive(Default)]
pub(crate) struct Prompt {
    pub(crate) text: String,
    pub(crate) error: Option<String>,
}

/// Channel with its last sample and history.
pub(crate) struct Row {
    pub(crate) info: ChannelInfo,
    pub(crate) sample: Option<Sample>,
    /// Board time, s, and value, SI; finite values only.
    pub(crate) history: VecDeque<(f64, f64)>,
    pub(crate) rate: Rate,
}

/// Quality of the link.
#[derive(Default)]
pub(crate) struct Link {
    /// Reason of the lost link; `None` while it is up.
    pub(crate) lost: Option<String>,
    /// Host time of the last telemetry, s.
    pub(crate) heard_s: f64,
    pub(crate) frames: Rate,
    /// Round trip of the last request and the longest one, ms.
    pub(crate) round_trip_ms: Option<(f64, f64)>,
    /// Requests that timed out.
    pub(crate) unanswered: u64,
    /// Damaged frames received; `dropped` counts telemetry that this program was too slow to read.
    pub(crate) bad: u64,
    pub(crate) dropped: u64,
    /// Counters of the board; `None` until read.
    pub(crate) stats: Option<DeviceStats>,
}

/// Message about the last request.
pub(crate) struct Message {
    pub(crate) text: String,
    pub(crate) is_error: bool,
}

/// Times of recent events, s, for a rate.
#[derive(Default)]
pub(crate) struct Rate(VecDeque<f64>);

impl Rate {
    pub(crate) fn count(&mut self, now_s: f64) {
        self.forget(now_s);
        self.0.push_back(now_s);
    }

    fn forget(&mut self, now_s: f64) {
        // Also drops times that lie ahead after the clock was set back.
        while self.0.front().is_some_and(|at_s| !(0.0..=RATE_OVER_S).contains(&(now_s - at_s))) {
            self.0.pop_front();
        }
    }

    /// Rate, Hz; 0 without an event in the window.
    pub(crate) fn hz(&self, now_s: f64) -> f64 {
        let (Some(first), Some(last)) = (self.0.front(), self.0.back()) else { return 0.0 };
        if now_s - last > RATE_OVER_S || last <= first {
            return 0.0;
        }
        (self.0.len() - 1) as f64 / (last - first)
    }
}

impl State {
    pub(crate) fn new(board: String, info: &DeviceInfo, channels: &[ChannelInfo], now_s: f64) -> Self {
        let rows = channels.iter().cloned().map(Row::new).collect();
        Self {
            board,
            robot: info.robot.to_string(),
            firmware: info.firmware.to_string(),
            safety: info.state,
            causes: info.causes,
            device_s: info.device_us as f64 * 1e-6,
            now_s,
            rows,
            selected: 0,
            link: Link { heard_s: now_s, ..Link::default() },
            message: None,
            view: View::Channels,
            scroll: 0,
            marked: Vec::new(),
            prompt: None,
            parameters: None,
            trips: None,
            wants_parameters: true,
            wants_trips_s: Some(now_s),
        }
    }

    /// Takes over a board after a reconnection: histories are kept if its channels are the same.
    pub(crate) fn reconnected(&mut self, info: &DeviceInfo, channels: &[ChannelInfo], now_s: f64) {
        let mut new = Self::new(std::mem::take(&mut self.board), info, channels, now_s);
        new.message = self.message.take();
        let same =
            channels.len() == self.rows.len() && self.rows.iter().zip(channels).all(|(row, info)| row.info == *info);
        if same {
            new.rows = std::mem::take(&mut self.rows);
            new.selected = self.selected;
            new.marked = std::mem::take(&mut self.marked);
        }
        // Keep the view, also for another board.
        new.view = self.view;
        *self = new;
    }

    /// Shows that the link is back; `how` is the message.
    pub(crate) fn back(&mut self, how: String) {
        self.message = Some(Message { text: how, is_error: false });
    }

    /// Marks the link as lost.
    pub(crate) fn lost(&mut self, why: String) {
        self.link.lost = Some(why);
        // The longest round trip is that of the present link.
        self.link.round_trip_ms = None;
    }

    pub(crate) fn telemetry(&mut self, frame: &Telemetry, now_s: f64) {
        let device_s = frame.device_us as f64 * 1e-6;
        if device_s < self.device_s {
            // A lower board time means a restart: the old history has another time base.
            self.rows.iter_mut().for_each(|row| row.history.clear());
        }
        if frame.state == SafetyState::Tripped && self.safety != SafetyState::Tripped {
            self.wants_trips_s = Some(now_s + TRIP_WRITTEN_S);
        }
        (self.safety, self.causes, self.device_s) = (frame.state, frame.causes, device_s);
        self.link.heard_s = now_s;
        self.link.frames.count(now_s);
        for sample in &frame.samples {
            if let Some(row) = self.rows.iter_mut().find(|row| row.info.id == sample.channel()) {
                row.take(sample, device_s, now_s);
            }
        }
    }

    /// Stores the board's counters and the round trip of their request.
    pub(crate) fn measured(&mut self, round_trip_s: f64, stats: DeviceStats) {
        let last_ms = round_trip_s * 1e3;
        let longest_ms = self.link.round_trip_ms.map_or(last_ms, |(_, longest_ms)| longest_ms.max(last_ms));
        self.link.round_trip_ms = Some((last_ms, longest_ms));
        self.link.stats = Some(stats);
    }

    pub(crate) fn done(&mut self, what: &str, result: Result<(), Error>) {
        self.message = Some(match result {
            Ok(()) => Message { text: format!("{what}: done"), is_error: false },
            Err(error) => Message { text: format!("{what}: {error}"), is_error: true },
        });
    }

    /// Shows a message of success.
    pub(crate) fn say(&mut self, text: String) {
        self.message = Some(Message { text, is_error: false });
    }

    /// Shows a refusal; the board has stopped the channel of the refused set point.
    pub(crate) fn refused(&mut self, order: Order, refusal: Refusal) {
        let id = order.channel;
        let info = self.rows.iter().map(|row| &row.info).find(|info| info.id == id);
        let why = match (refusal, info.and_then(takes)) {
            // The range in the units in which the set point was typed.
            (Refusal::OutOfRange { .. }, Some(takes)) => format!("it takes {takes}"),
            _ => refusal.to_string(),
        };
        let text = format!("{order} on {} is refused, which stops {id}: {why}", self.board);
        self.message = Some(Message { text, is_error: true });
    }

    /// Requests that are due now; each is returned once.
    pub(crate) fn wanted(&mut self) -> Vec<Ask> {
        let parameters = std::mem::take(&mut self.wants_parameters).then_some(Ask::Parameters);
        let trips = self.wants_trips_s.take_if(|at_s| *at_s <= self.now_s).map(|_| Ask::Trips);
        parameters.into_iter().chain(trips).collect()
    }

    /// Opens the prompt for the selected channel, if it accepts set points.
    pub(crate) fn open_prompt(&mut self) {
        let Some(row) = self.rows.get(self.selected) else { return };
        self.view = View::Channels;
        if takes(&row.info).is_some() {
            self.prompt = Some(Prompt::default());
        } else {
            let text = format!("{} takes no set points: select a motor or another output", row.info.id);
            self.message = Some(Message { text, is_error: true });
        }
    }

    /// Puts the selected channel on the graph, or takes it off.
    pub(crate) fn mark(&mut self) {
        let Some(id) = self.rows.get(self.selected).map(|row| row.info.id) else { return };
        if let Some(at) = self.marked.iter().position(|marked| *marked == id) {
            self.marked.remove(at);
        } else if self.marked.len() < MOST_MARKED {
            self.marked.push(id);
        } else {
            let text = format!("the graph has {MOST_MARKED} signals: remove one first, with g");
            self.message = Some(Message { text, is_error: true });
        }
    }

    /// Shows `view`, or the channels if it is already shown.
    pub(crate) fn show(&mut self, view: View) {
        self.view = if self.view == view { View::Channels } else { view };
        self.scroll = 0;
        let selected = self.rows.get(self.selected).map(|row| row.info.id);
        if self.view == View::Parameters {
            let of_selected = self.parameters.iter().flatten().position(|info| info.key.channel == selected);
            self.scroll = of_selected.unwrap_or_default();
        }
    }

    /// Time without telemetry, s; `None` within the limit.
    pub(crate) fn silent_s(&self) -> Option<f64> {
        Some(self.now_s - self.link.heard_s).filter(|silent_s| *silent_s > SILENT_S)
    }

    /// Moves the selection by `down` channels, or a list by `down` lines, limited to the last one.
    pub(crate) fn select(&mut self, down: isize) {
        let list = match self.view {
            View::Channels => None,
            View::Parameters => Some(self.parameters.as_ref().map_or(0, Vec::len)),
            View::Trips => Some(self.trips.as_ref().map_or(0, Vec::len)),
            View::Help => Some(0),
        };
        if let Some(lines) = list {
            self.scroll = self.scroll.saturating_add_signed(down).min(lines.saturating_sub(1));
            return;
        }
        self.selected = self.selected.saturating_add_signed(down).min(self.rows.len().saturating_sub(1));
    }
}

impl Row {
    fn new(info: ChannelInfo) -> Self {
        Self { info, sample: None, history: VecDeque::new(), rate: Rate::default() }
    }

    fn take(&mut self, sample: &Sample, device_s: f64, now_s: f64) {
        self.sample = Some(*sample);
        self.rate.count(now_s);
        // A sample of bad quality repeats the last good value: keep it out of the history.
        let is_good = !matches!(sample, Sample::Reading { quality, .. } | Sample::Sensor { quality, .. } if *quality != Quality::Good);
        if let Some(value) = watch::number(&self.info, sample).filter(|_| is_good) {
            self.history.push_back((device_s, value));
        }
        while self.history.front().is_some_and(|(at_s, _)| device_s - at_s > HISTORY_S) {
            self.history.pop_front();
        }
    }

    /// Vertical range of the history since `since_s`: at least eight counts or 1 % of the value, so that noise stays
    /// flat.
    pub(crate) fn bounds(&self, since_s: f64) -> [f64; 2] {
        let values = self.history.iter().filter(|(at_s, _)| *at_s >= since_s).map(|(_, value)| *value);
        let (low, high) = values.fold((f64::MAX, f64::MIN), |(low, high), value| (low.min(value), high.max(value)));
        if low > high {
            return [0.0, 1.0];
        }
        if self.info.unit == Unit::Bool {
            return [0.0, 1.0];
        }
        // Eight counts, or a hundredth of the value.
        let narrowest = (8.0 * f64::from(self.info.resolution)).max(0.01 * low.abs().max(high.abs())).max(1e-3);
        let (middle, half) = (f64::midpoint(low, high), (high - low).max(narrowest) / 2.0);
        [middle - half, middle + half]
    }

    /// Sparkline: `cells` mean values scaled to 0..1, each over `cell_s` seconds, the last one up to now; `None` where
    /// nothing was measured.
    pub(crate) fn cells(&self, device_s: f64, cells: usize, cell_s: f64) -> Vec<Option<f64>> {
        // Cells are aligned to the board's clock, not to now, so that past cells do not change from one drawing to the
        // next.
        let last = (device_s / cell_s).floor();
        let [low, high] = self.bounds((last - cells as f64 + 1.0) * cell_s);
        let mut sums = vec![(0.0, 0u32); cells];
        for (at_s, value) in &self.history {
            let back = last - (at_s / cell_s).floor();
            if (0.0..cells as f64).contains(&back) {
                let (sum, count) = &mut sums[cells - 1 - back as usize];
                *sum += value;
                *count += 1;
            }
        }
        let share = |(sum, count): (f64, u32)| {
            (count > 0).then(|| ((sum / f64::from(count) - low) / (high - low)).clamp(0.0, 1.0))
        };
        sums.into_iter().map(share).collect()
    }
}
