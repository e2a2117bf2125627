//! The flash that keeps parameters and trips.

use core::convert::Infallible;

use embedded_storage_async::nor_flash::{ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash};

/// PLACE-HOLDER: a flash of four erased sectors that takes nothing.
pub(crate) struct Flash;

/// Nothing is kept.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Refused;

impl From<Infallible> for Refused {
    fn from(never: Infallible) -> Self {
        match never {}
    }
}

impl NorFlashError for Refused {
    fn kind(&self) -> NorFlashErrorKind {
        NorFlashErrorKind::Other
    }
}

impl ErrorType for Flash {
    type Error = Refused;
}

impl ReadNorFlash for Flash {
    const READ_SIZE: usize = 1;
    async fn read(&mut self, _: u32, bytes: &mut [u8]) -> Result<(), Refused> {
        bytes.fill(0xFF);
        Ok(())
    }
    fn capacity(&self) -> usize {
        4 * 128 * 1024
    }
}

impl NorFlash for Flash {
    const WRITE_SIZE: usize = 32;
    const ERASE_SIZE: usize = 128 * 1024;
    async fn erase(&mut self, _: u32, _: u32) -> Result<(), Refused> {
        Err(Refused)
    }
    async fn write(&mut self, _: u32, _: &[u8]) -> Result<(), Refused> {
        Err(Refused)
    }
}
