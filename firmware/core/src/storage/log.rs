//! Log in flash: items in the order in which they were written; the oldest sector is erased when there is no room for a
//! new one.

use embedded_storage_async::nor_flash::NorFlash;
use sequential_storage::{
    Error,
    cache::{Cache, Uncached},
    queue::{QueueConfig, QueueStorage},
};

use super::words::{WordError, Words};

/// Error of reading or writing stored data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StorageError {
    /// The flash reports an error, or does not hold what was written to it.
    Flash,
    /// The content cannot be interpreted.
    Damaged,
}

impl From<Error<WordError>> for StorageError {
    fn from(error: Error<WordError>) -> Self {
        match error {
            Error::Storage { value: WordError::Flash, .. } => Self::Flash,
            _ => Self::Damaged,
        }
    }
}

/// Sectors of one log: while one is erased, the other holds the latest items.
pub(super) const SECTORS: usize = 2;

/// Log of the parameters.
pub(super) fn parameter_log<F: NorFlash>(flash: &mut F) -> Log<'_, F> {
    Log::new(flash, 0, SECTORS)
}

/// Log of the trips.
pub(super) fn fault_log<F: NorFlash>(flash: &mut F) -> Log<'_, F> {
    Log::new(flash, SECTORS, SECTORS)
}

/// Log in some sectors of a flash.
pub(super) struct Log<'f, F>(Words<'f, F>);

type Queue<'w, 'f, F> = QueueStorage<&'w mut Words<'f, F>, Cache<Uncached, Uncached, Uncached>>;

impl<'f, F: NorFlash> Log<'f, F> {
    /// Creates the log in `sectors` sectors from `first_sector` on.
    pub(super) fn new(flash: &'f mut F, first_sector: usize, sectors: usize) -> Self {
        Self(Words::new(flash, first_sector, sectors))
    }

    fn queue(&mut self) -> Result<Queue<'_, 'f, F>, StorageError> {
        let config = QueueConfig::try_new(self.0.range()).map_err(|_| StorageError::Damaged)?;
        Ok(QueueStorage::new(&mut self.0, config, Cache::new_uncached()))
    }

    /// Returns true if nothing has ever been written here.
    pub(super) async fn is_blank(&mut self) -> bool {
        self.0.is_blank().await
    }

    /// Calls `see` with every item from the oldest to the newest. `buffer` must hold the largest, rounded up to a whole
    /// word.
    ///
    /// # Errors
    /// [`StorageError::Damaged`] for contents that cannot be interpreted; single spoilt items are skipped.
    pub(super) async fn visit(&mut self, buffer: &mut [u8], mut see: impl FnMut(&[u8])) -> Result<(), StorageError> {
        let mut queue = self.queue()?;
        let mut items = queue.iter().await?;
        while let Some(item) = items.next(buffer).await? {
            see(&item);
        }
        Ok(())
    }

    /// Appends `item` and reads it back. If the content cannot be interpreted, or hides the new item, all of it is
    /// erased first.
    ///
    /// # Errors
    /// [`StorageError::Flash`] when the flash fails, or still does not hold the item after an erase.
    pub(super) async fn push(&mut self, item: &[u8], buffer: &mut [u8]) -> Result<(), StorageError> {
        for first in [true, false, false] {
            match self.push_once(item, buffer).await {
                Ok(true) => return Ok(()),
                // A bad cell spoils one place; the next try is written behind it.
                Ok(false) if first => {}
                Ok(false) | Err(StorageError::Damaged) => self.queue()?.erase_all().await?,
                Err(StorageError::Flash) => return Err(StorageError::Flash),
            }
        }
        Err(StorageError::Flash)
    }

    /// Appends `item` and returns true if it is now the newest item.
    async fn push_once(&mut self, item: &[u8], buffer: &mut [u8]) -> Result<bool, StorageError> {
        self.queue()?.push(item, true).await?;
        let mut newest = false;
        self.visit(buffer, |seen| newest = seen == item).await?;
        Ok(newest)
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use std::{vec, vec::Vec};

    use embassy_futures::block_on;
    use embedded_storage_async::nor_flash::{ErrorType, NorFlashError, NorFlashErrorKind, ReadNorFlash};

    use super::*;

    const SECTOR: usize = 1024;

    /// Fake flash of two sectors whose words can be made to spoil what is written to them.
    struct Flash {
        bytes: Vec<u8>,
        /// Number of following writes that are spoilt.
        spoils: u32,
        /// True if every write is spoilt, until a sector is erased.
        worn: bool,
    }

    #[derive(Debug)]
    struct Never;

    impl NorFlashError for Never {
        fn kind(&self) -> NorFlashErrorKind {
            NorFlashErrorKind::Other
        }
    }

    impl ErrorType for Flash {
        type Error = Never;
    }

    impl ReadNorFlash for Flash {
        const READ_SIZE: usize = 1;

        async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Never> {
            bytes.copy_from_slice(&self.bytes[offset as usize..][..bytes.len()]);
            Ok(())
        }

        fn capacity(&self) -> usize {
            self.bytes.len()
        }
    }

    impl NorFlash for Flash {
        const WRITE_SIZE: usize = 32;
        const ERASE_SIZE: usize = SECTOR;

        async fn erase(&mut self, from: u32, to: u32) -> Result<(), Never> {
            self.bytes[from as usize..to as usize].fill(0xFF);
            self.worn = false;
            Ok(())
        }

        async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Never> {
            let spoilt = self.worn || self.spoils > 0;
            self.spoils = self.spoils.saturating_sub(1);
            for (cell, byte) in self.bytes[offset as usize..].iter_mut().zip(bytes) {
                // Programming clears bits; a spoilt word also loses some that should stay set.
                *cell &= if spoilt { byte & 0x55 } else { *byte };
            }
            Ok(())
        }
    }

    fn items(flash: &mut Flash) -> Vec<Vec<u8>> {
        let (mut buffer, mut items) = ([0; 60], Vec::new());
        block_on(Log::new(flash, 0, 2).visit(&mut buffer, |item| items.push(item.to_vec()))).expect("it makes sense");
        items
    }

    /// One bad place costs only that place; the older items are given up only where the second try fails too.
    #[test]
    fn what_was_kept_outlives_a_place_that_does_not_take_what_it_is_given() {
        let mut flash = Flash { bytes: vec![0xFF; 2 * SECTOR], spoils: 0, worn: false };
        let push = |flash: &mut Flash, item: &[u8]| block_on(Log::new(flash, 0, 2).push(item, &mut [0; 60]));
        assert_eq!(push(&mut flash, b"first"), Ok(()));
        flash.spoils = 1;
        assert_eq!(push(&mut flash, b"second"), Ok(()));
        assert_eq!(items(&mut flash), [&b"first"[..], b"second"]);
        flash.worn = true;
        assert_eq!(push(&mut flash, b"third"), Ok(()));
        assert_eq!(items(&mut flash), [b"third"]);
    }
}
