//! The part of a board's flash that keeps parameters and trips, looked at before a board starts with it.

use embassy_futures::block_on;
use r4_firmware::storage;
pub use r4_firmware::storage::parameters::{Loaded, Saved};
use r4_protocol::config::BoardConfig;

use crate::flash::Flash;

/// Its sectors.
pub const SECTORS: usize = storage::SECTORS;

/// What a board that was built with `config` uses when it starts with `flash`.
#[must_use]
pub fn review(flash: &Flash, config: &BoardConfig) -> Loaded {
    // Reading takes no time.
    block_on(storage::parameters::load(&mut flash.clone(), config))
}
