//! What the screen shows.

use heapless::Vec;
use r4_protocol::{Causes, ChannelId, Range, SafetyState, config::MAX_SUPPLIES};

/// Most channels with a bar.
pub const MAX_BARS: usize = 16;

/// What the screen shows at one moment.
#[derive(Clone, Debug, PartialEq)]
pub struct View<'a> {
    /// The robot's name.
    pub robot: &'a str,
    /// Where the supervisor stands.
    pub state: SafetyState,
    /// Causes latched by a trip.
    pub causes: Causes,
    /// Supply rails, in the order of the screen.
    pub supplies: Vec<Supply, MAX_SUPPLIES>,
    /// The host.
    pub link: Link,
    /// Since power-up, s.
    pub uptime_s: u32,
    /// Channels that move something, in the order of the screen.
    pub bars: Vec<Bar, MAX_BARS>,
    /// Control ticks that ended too late, since power-up.
    pub late_ticks: u32,
    /// I2C transfers that were repeated, since power-up.
    pub bus_retries: u32,
}

/// A supply rail.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Supply {
    /// Its name.
    pub id: ChannelId,
    /// V
    pub volts: f32,
    /// The board trips outside this, V.
    pub range_v: Range,
}

/// The host, by its last heartbeat.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Link {
    /// No session is open.
    NoHost,
    /// Heartbeats come in time.
    Alive {
        /// Since the last heartbeat, ms.
        age_ms: u32,
    },
    /// A session is open, and its heartbeats stay away.
    Lost {
        /// Since the last heartbeat, ms.
        age_ms: u32,
    },
}

/// How hard a channel is driven.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bar {
    /// Its name.
    pub id: ChannelId,
    /// Share of the most it can do, -1..=1; beyond that the bar is full, and NaN has none.
    pub value: f32,
    /// Whether it is on its way.
    pub moving: bool,
}

/// Where the screen's task gets its view from.
pub trait Source {
    /// The view at this moment. Called a few times each second, at the lowest priority.
    fn view(&self) -> View<'_>;
}
