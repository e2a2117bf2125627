//! What a board keeps over a restart: changed parameters, and the history of its trips.
//!
//! | module | holds |
//! | --- | --- |
//! | [`parameters`] | what differs from the built-in configuration, saved as one item |
//! | [`faults`] | the last trips, each with what the board looked like before it |
//! | `task` | [`Storage`]: the one task that owns the flash, and how others ask it |
//! | `log` | items in a ring of sectors, by `sequential-storage` |
//! | `words` | flash on which a power cut leaves nothing half done |
//!
//! A flash is given as [`NorFlash`] of at least [`SECTORS`] sectors, of which the first two hold parameters and the next two
//! trips; a firmware update must leave them alone. On the STM32H747 they are the last four of bank 2, 0x0818_0000 to
//! 0x081F_FFFF: sectors of 128 KiB, words of 32 bytes. Programming or erasing a bank stalls whatever runs from it, an erase
//! for 1 to 2 s, so code belongs into bank 1. A driver must fail to read a word that fails its error correction, and not
//! fault.
//!
//! After a power cut at any write or erase, also while starting again after one, flash holds what was saved before or
//! what was being saved. A sector endures 10 000 erases; what that means is said in the two modules.

use embedded_storage_async::nor_flash::NorFlash;

pub mod faults;
mod log;
pub mod parameters;
mod task;
mod words;

pub use log::StorageError;
pub use task::{Done, Job, Storage, run};

/// Sectors of flash that are used.
pub const SECTORS: usize = 2 * LOG_SECTORS;

/// Sectors of one log: while one is erased, the other holds what was written last.
const LOG_SECTORS: usize = 2;

fn parameter_log<F: NorFlash>(flash: &mut F) -> log::Log<'_, F> {
    log::Log::new(flash, 0, LOG_SECTORS)
}

fn fault_log<F: NorFlash>(flash: &mut F) -> log::Log<'_, F> {
    log::Log::new(flash, LOG_SECTORS, LOG_SECTORS)
}
