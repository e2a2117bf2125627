//! Newest readings of the range sensors: written by ranging, read by the supervisor.

use embassy_time::Instant;
use r4_protocol::{
    Quality,
    config::{RANGE_SENSORS, RangeConfig},
};

use crate::{ranging, sensing::range::RangeReading};

/// Newest reading of each sensor, in the order of the configuration.
pub(super) struct Ranges([RangeReading; RANGE_SENSORS]);

impl Ranges {
    pub(super) fn new() -> Self {
        // Silence counts from now on, and not from time 0.
        Self([RangeReading { updated: Instant::now(), ..RangeReading::NONE }; RANGE_SENSORS])
    }

    pub(super) fn set(&mut self, index: usize, reading: RangeReading) {
        self.0[index] = reading;
    }

    /// Returns true if a sensor, or its silence, stops the board.
    pub(super) fn must_stop(&self, config: &[RangeConfig], now: Instant) -> bool {
        ranging::must_stop(config, &self.0, now)
    }

    /// Returns true if every sensor that can stop the board has reported.
    pub(super) fn have_reported(&self, config: &[RangeConfig]) -> bool {
        let guards = config.iter().zip(&self.0).filter(|(range, _)| range.stop_below_m.is_some());
        guards.into_iter().all(|(_, reading)| reading.quality != Quality::None)
    }
}
