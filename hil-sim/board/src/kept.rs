//! The part of a board's flash that stores parameters and trips, for inspection before a board starts with it.

use embassy_futures::block_on;
use r4_firmware::storage;
pub use r4_firmware::storage::parameters::{Loaded, Saved};
use r4_protocol::config::BoardConfig;

use crate::flash::Flash;

/// Number of sectors that store them.
pub const SECTORS: usize = storage::SECTORS;

/// Parameters and trips that a board built with `config` uses when it starts with `flash`.
#[must_use]
pub fn review(flash: &Flash, config: &BoardConfig) -> Loaded {
    // reading the flash takes no time
    block_on(storage::parameters::load(&mut flash.clone(), config))
}
