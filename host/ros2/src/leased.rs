//! Leased set points, which expire unless they are repeated: one stream of cycles, which is bound again when other joints are commanded.
//!
//! The board stops a channel whose set point is older than the stream's time to live, also after a failure of this node or the publisher.

use std::collections::VecDeque;

use futures::{FutureExt, future::LocalBoxFuture};
use r4_driver::{Board, CycleReport, Cycles, Error};
use r4_protocol::{ChannelId, Mode, Setpoint};
use r4_rig::HostClock;

/// Maximum number of channels in one command.
pub use r4_protocol::cycle::CYCLE_CHANNELS;

/// Set points of one command, by channel.
pub type Setpoints = Vec<(ChannelId, Setpoint)>;

/// Open stream with the channels that it is bound to.
pub struct Bound<'b> {
    channels: Vec<(ChannelId, Mode)>,
    cycles: Cycles<'b, HostClock>,
    /// Number of the next cycle; the driver counts cycles from 0.
    next: u64,
    last: Setpoints,
}

/// Future that binds a stream to channels, whose result goes to [`Leased::bound`].
pub type Binding<'b> = LocalBoxFuture<'b, Result<Bound<'b>, Error>>;

/// Leased set points. `E` is a tag of the caller that is returned with the answer to a command.
pub struct Leased<'b, E> {
    board: &'b Board<HostClock>,
    ttl_ms: u16,
    bound: Option<Bound<'b>>,
    is_binding: bool,
    /// Command that waits for the binding of the stream: set points, time of the command on the driver's clock, s, and the caller's tag.
    waiting: Option<(Setpoints, f64, E)>,
    /// Commands that await an answer: number of the cycle and the caller's tag.
    under_way: VecDeque<(u64, E)>,
}

impl<'b, E> Leased<'b, E> {
    /// Creates leased set points with a time to live of `ttl_ms`, without a command yet.
    #[must_use]
    pub fn new(board: &'b Board<HostClock>, ttl_ms: u16) -> Self {
        Self { board, ttl_ms, bound: None, is_binding: false, waiting: None, under_way: VecDeque::new() }
    }

    /// Sends set points to channels; channels of the last command that are not among them come to rest. Returns a binding to await when the
    /// stream is bound to other channels.
    ///
    /// # Errors
    /// The driver's refusal of a set point, for example out of a channel's range: all channels come to rest, and `with` is not returned.
    pub fn command(&mut self, setpoints: Setpoints, with: E) -> Result<Option<Binding<'b>>, Error> {
        let channels: Vec<_> = setpoints.iter().map(|(channel, setpoint)| (*channel, setpoint.mode)).collect();
        if let Some(bound) = self.bound.as_mut().filter(|bound| bound.channels == channels) {
            let number = bound.set(setpoints)?;
            self.under_way.push_back((number, with));
            return Ok(None);
        }
        // Only the newest command waits: an older one would be overwritten at once.
        self.waiting = Some((setpoints, self.board.now_s(), with));
        Ok(self.prepare(channels))
    }

    /// Starts to bind the stream to channels before they are commanded; `None` while a binding is under way.
    pub fn prepare(&mut self, channels: Vec<(ChannelId, Mode)>) -> Option<Binding<'b>> {
        if self.is_binding {
            return None;
        }
        self.is_binding = true;
        self.under_way.clear();
        let (board, ttl_ms, before) = (self.board, self.ttl_ms, self.bound.take());
        let binding = async move {
            if let Some(Bound { mut cycles, last, .. }) = before {
                // The old set points must not hold until their lease expires. If this fails, the lease still ends them.
                let _ = cycles.cycle(&values(&at_rest(&last))).await;
            }
            let cycles = board.stream(&channels, ttl_ms).await?;
            Ok(Bound { channels, cycles, next: 0, last: Vec::new() })
        };
        Some(binding.boxed_local())
    }

    /// Handles the result of a binding, and sends the command that waited for it unless its lease has expired. Returns the next binding to
    /// await, if the command is for other channels.
    ///
    /// # Errors
    /// The error of the binding; the errors of [`Leased::command`].
    pub fn bound(&mut self, binding: Result<Bound<'b>, Error>) -> Result<Option<Binding<'b>>, Error> {
        self.is_binding = false;
        let waiting = self.waiting.take();
        self.bound = Some(binding?);
        match waiting {
            Some((setpoints, at_s, with)) if (self.board.now_s() - at_s) * 1e3 <= f64::from(self.ttl_ms) => {
                self.command(setpoints, with)
            }
            _ => Ok(None),
        }
    }

    /// Brings the commanded channels to rest: speeds and duties become 0, positions are kept.
    pub fn rest(&mut self) {
        self.waiting = None;
        self.under_way.clear();
        if let Some(bound) = &mut self.bound {
            let setpoints = at_rest(&bound.last);
            // If the driver refuses them, it has stopped the channels itself.
            let _ = bound.set(setpoints);
        }
    }

    /// Waits for the next answer of the board and returns it with the tag of its command; `None` for set points that bring channels to
    /// rest. Never ready without a stream.
    ///
    /// # Errors
    /// The error of the link when it ends.
    pub async fn answer(&mut self) -> Result<(CycleReport, Option<E>), Error> {
        let Some(bound) = &mut self.bound else { return std::future::pending().await };
        let report = bound.cycles.next().await?;
        // A cycle that was lost, or replaced by a newer one before it was sent, never gets an answer.
        while self.under_way.front().is_some_and(|(number, _)| *number < report.number) {
            self.under_way.pop_front();
        }
        let with = self.under_way.pop_front_if(|(number, _)| *number == report.number);
        Ok((report, with.map(|(_, with)| with)))
    }
}

impl Bound<'_> {
    /// Sends set points for all bound channels and returns the number of their cycle.
    fn set(&mut self, setpoints: Setpoints) -> Result<u64, Error> {
        if setpoints.is_empty() {
            return Ok(self.next);
        }
        self.cycles.set(&values(&setpoints))?;
        self.last = setpoints;
        let number = self.next;
        self.next += 1;
        Ok(number)
    }
}

fn values(setpoints: &[(ChannelId, Setpoint)]) -> Vec<f64> {
    setpoints.iter().map(|(_, setpoint)| f64::from(setpoint.value)).collect()
}

/// Returns set points that bring the channels to rest: a position is at rest already, other modes get 0.
fn at_rest(setpoints: &[(ChannelId, Setpoint)]) -> Setpoints {
    let rest = |(channel, setpoint): &(ChannelId, Setpoint)| match setpoint.mode {
        Mode::Position => (*channel, *setpoint),
        mode => (*channel, Setpoint { mode, value: 0.0 }),
    };
    setpoints.iter().map(rest).collect()
}
