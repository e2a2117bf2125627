//! Content of the screen.

use heapless::Vec;
use r4_protocol::{Causes, ChannelId, Range, SafetyState, config::MAX_SUPPLIES};

/// Maximum number of channels with a bar.
pub const MAX_BARS: usize = 16;

/// Content of the screen at one moment.
#[derive(Clone, Debug, PartialEq)]
pub struct View<'a> {
    /// Name of the robot.
    pub robot: &'a str,
    /// State of the supervisor.
    pub state: SafetyState,
    /// Causes latched by a trip.
    pub causes: Causes,
    /// Supply rails, in the order of the screen.
    pub supplies: Vec<Supply, MAX_SUPPLIES>,
    /// State of the host's link.
    pub link: Link,
    /// Time since power-up, s.
    pub uptime_s: u32,
    /// Channels that move something, in the order of the screen.
    pub bars: Vec<Bar, MAX_BARS>,
    /// Control ticks that ended too late, since power-up.
    pub late_ticks: u32,
    /// I2C transfers that were repeated, since power-up.
    pub bus_retries: u32,
}

/// Supply rail on the screen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Supply {
    /// Channel of the rail.
    pub id: ChannelId,
    /// Measured voltage, V; NaN if unknown.
    pub volts: f32,
    /// Range outside which the board trips, V.
    pub range_v: Range,
}

/// State of the host's link, by its last heartbeat.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Link {
    /// No session is open.
    NoHost,
    /// Heartbeats come in time.
    Alive {
        /// Time since the last heartbeat, ms.
        age_ms: u32,
    },
    /// A session is open, and its heartbeats are missing.
    Lost {
        /// Time since the last heartbeat, ms.
        age_ms: u32,
    },
}

/// Drive level of one channel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bar {
    /// Channel of the bar.
    pub id: ChannelId,
    /// Drive as a share of the channel's maximum, -1..=1; beyond that the bar is full, and NaN gives none.
    pub value: f32,
    /// True while the channel is moving.
    pub moving: bool,
}

/// Source of the screen's view.
pub trait Source {
    /// Returns the view at this moment. Called a few times each second, at the lowest priority.
    fn view(&self) -> View<'_>;
}
