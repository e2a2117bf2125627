//! Set points that end by themselves unless they are repeated: one stream of cycles, bound anew when other joints are commanded.
//!
//! The board stops a channel whose set point is older than the stream's time-to-live, whatever became of this node or of the publisher.

use std::collections::VecDeque;

use futures::{FutureExt, future::LocalBoxFuture};
use r4_driver::{Board, CycleReport, Cycles, Error};
use r4_protocol::{ChannelId, Mode, Setpoint};
use r4_rig::HostClock;

/// Most channels in one command.
pub use r4_protocol::cycle::CYCLE_CHANNELS;

/// Set points for channels, in one command.
pub type Setpoints = Vec<(ChannelId, Setpoint)>;

/// A stream that is open, and the channels that it is bound to.
pub struct Bound<'b> {
    channels: Vec<(ChannelId, Mode)>,
    cycles: Cycles<'b, HostClock>,
    /// Number of the next cycle: the driver counts them from 0.
    next: u64,
    last: Setpoints,
}

/// The binding of a stream to other channels, to be awaited and handed to [`Leased::bound`].
pub type Binding<'b> = LocalBoxFuture<'b, Result<Bound<'b>, Error>>;

/// Leased set points. `E` is what their caller wants to have back with the answers to them.
pub struct Leased<'b, E> {
    board: &'b Board<HostClock>,
    ttl_ms: u16,
    bound: Option<Bound<'b>>,
    is_binding: bool,
    /// What is commanded once the stream is bound: set points, when they were decided on our clock in s, and what goes with them.
    waiting: Option<(Setpoints, f64, E)>,
    /// Commands without an answer, by their number.
    under_way: VecDeque<(u64, E)>,
}

impl<'b, E> Leased<'b, E> {
    /// Nothing is commanded. Set points hold for `ttl_ms`.
    #[must_use]
    pub fn new(board: &'b Board<HostClock>, ttl_ms: u16) -> Self {
        Self { board, ttl_ms, bound: None, is_binding: false, waiting: None, under_way: VecDeque::new() }
    }

    /// Commands channels; those that were commanded before and are not in it come to rest. Returns what has to be awaited first where
    /// the stream is bound to others.
    ///
    /// # Errors
    /// A set point that a channel does not take: then all of them come to rest, and `with` is not answered.
    pub fn command(&mut self, setpoints: Setpoints, with: E) -> Result<Option<Binding<'b>>, Error> {
        let channels: Vec<_> = setpoints.iter().map(|(channel, setpoint)| (*channel, setpoint.mode)).collect();
        if let Some(bound) = self.bound.as_mut().filter(|bound| bound.channels == channels) {
            let number = bound.set(setpoints)?;
            self.under_way.push_back((number, with));
            return Ok(None);
        }
        self.waiting = Some((setpoints, self.board.now_s(), with));
        Ok(self.prepare(channels))
    }

    /// Binds the stream to channels before they are commanded; `None` while it is being bound.
    pub fn prepare(&mut self, channels: Vec<(ChannelId, Mode)>) -> Option<Binding<'b>> {
        if self.is_binding {
            return None;
        }
        self.is_binding = true;
        self.under_way.clear();
        let (board, ttl_ms, before) = (self.board, self.ttl_ms, self.bound.take());
        let binding = async move {
            if let Some(Bound { mut cycles, last, .. }) = before {
                // What it commanded must not hold until its lease is over. Where this fails, the lease ends it.
                let _ = cycles.cycle(&values(&at_rest(&last))).await;
            }
            let cycles = board.stream(&channels, ttl_ms).await?;
            Ok(Bound { channels, cycles, next: 0, last: Vec::new() })
        };
        Some(binding.boxed_local())
    }

    /// Takes a stream that is bound, and commands what waited for it if that is not too old. Returns what has to be awaited next.
    ///
    /// # Errors
    /// Why it is not bound; as [`Leased::command`].
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

    /// Brings what is commanded to rest: speeds and duties to 0, positions stay.
    pub fn rest(&mut self) {
        self.waiting = None;
        self.under_way.clear();
        if let Some(bound) = &mut self.bound {
            let setpoints = at_rest(&bound.last);
            // Where the driver does not take them, it has stopped the channels.
            let _ = bound.set(setpoints);
        }
    }

    /// The next answer of the board, with what its command was given. Never ready where nothing is commanded.
    ///
    /// # Errors
    /// Why the link ended.
    pub async fn answer(&mut self) -> Result<(CycleReport, Option<E>), Error> {
        let Some(bound) = &mut self.bound else { return std::future::pending().await };
        let report = bound.cycles.next().await?;
        while self.under_way.front().is_some_and(|(number, _)| *number < report.number) {
            self.under_way.pop_front();
        }
        let with = self.under_way.pop_front_if(|(number, _)| *number == report.number);
        Ok((report, with.map(|(_, with)| with)))
    }
}

impl Bound<'_> {
    /// Sends set points for all of its channels; their number.
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

fn at_rest(setpoints: &[(ChannelId, Setpoint)]) -> Setpoints {
    let rest = |(channel, setpoint): &(ChannelId, Setpoint)| match setpoint.mode {
        Mode::Position => (*channel, *setpoint),
        mode => (*channel, Setpoint { mode, value: 0.0 }),
    };
    setpoints.iter().map(rest).collect()
}
