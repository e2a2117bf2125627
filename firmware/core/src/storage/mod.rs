//! Storage over a restart: changed parameters, and the history of trips.
//!
//! | module | holds |
//! | --- | --- |
//! | [`parameters`] | differences from the built-in configuration, saved as one item |
//! | [`faults`] | the last trips, each with snapshots of the board before it |
//! | `task` | [`Storage`]: the one task that owns the flash, and the requests of others |
//! | `log` | items in a ring of sectors, by `sequential-storage` |
//! | `words` | flash on which a power cut leaves no half-written state |
//!
//! The flash is a [`NorFlash`](embedded_storage_async::nor_flash::NorFlash) of at least [`SECTORS`] sectors, of which the first two hold parameters and the next two
//! trips; a firmware update must leave them alone. On the STM32H747 they are the last four of bank 2, 0x0818_0000 to
//! 0x081F_FFFF: sectors of 128 KiB, words of 32 bytes. Programming or erasing a bank stalls whatever runs from it, an
//! erase for 1 to 2 s, so code belongs into bank 1. A driver must return an error for a word that fails its error
//! correction, and not fault.
//!
//! After a power cut at any write or erase, also while starting again after one, flash holds what was saved before or
//! what was being saved. A sector endures 10 000 erases; the two modules give the resulting lifetimes.

pub mod faults;
mod log;
pub mod parameters;
mod task;
mod words;

pub use log::StorageError;
pub use task::{Done, Job, Storage, run};

/// Number of flash sectors used.
pub const SECTORS: usize = 2 * log::SECTORS;
