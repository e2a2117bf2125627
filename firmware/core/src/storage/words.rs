//! Atomic flash words: every word is blank, whole or spoilt, and an erase is complete or has not happened.
//!
//! `sequential-storage` survives a power cut on flash whose erase begins at the start of a sector, and whose
//! half-written words can be read. A processor whose flash has error correction guarantees neither: a word that was
//! being programmed may raise a bus fault or read as anything, and an interrupted erase leaves a sector in an arbitrary
//! state. So each word carries a checksum, and each sector records whether its erase was completed:
//!
//! ```text
//! word     0     1      2 ...
//!        seal  void   what is stored
//! ```
//!
//! An erase first programs `void`, then erases, then programs the seal. A sector without a seal, or with anything in
//! `void`, reads as blank, and is erased again before the first word is written to it. An interrupted erase cannot
//! leave a seal and a blank `void` over half-erased content: the cells of a sector are erased together, so the 256
//! zeros of `void` are not all gone while those of the seal are all there; and if the erase ran from one end, either
//! the seal would go first, or `void` after everything else.

use crc::{CRC_16_IBM_3740, Crc};
use embassy_futures::yield_now;
use embedded_storage_async::nor_flash::{ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash};

/// Bytes of a word in flash: the unit that the STM32H747 programs, and protects by its error correction, at once.
const RAW_BYTES: usize = 32;
/// Bytes of a word without its checksum.
pub(super) const DATA_BYTES: usize = 30;
const SEAL_WORD: usize = 0;
const VOID_WORD: usize = 1;
const FIRST_DATA: usize = 2;

/// Contents of a seal; a change of the arrangement of words or of their contents gets another number, and then starts
/// empty.
const SEAL: [u8; DATA_BYTES] = *b"R4 storage, arrangement 1 \0\0\0\0";

const CHECKSUM: Crc<u16> = Crc::<u16>::new(&CRC_16_IBM_3740);

/// Reason why a word was not written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum WordError {
    /// The flash reports an error.
    Flash,
    /// The word has been written since the sector was erased.
    NotBlank,
}

impl NorFlashError for WordError {
    fn kind(&self) -> NorFlashErrorKind {
        NorFlashErrorKind::Other
    }
}

/// State of a word, with its data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Word {
    Blank,
    Whole([u8; DATA_BYTES]),
    /// Unreadable, or not what was written.
    Spoilt,
}

/// Word in memory, aligned because some flash controllers take words from aligned memory only.
#[repr(align(4))]
struct Raw([u8; RAW_BYTES]);

impl Raw {
    fn new(data: &[u8; DATA_BYTES]) -> Self {
        let mut raw = [0; RAW_BYTES];
        raw[..DATA_BYTES].copy_from_slice(data);
        raw[DATA_BYTES..].copy_from_slice(&CHECKSUM.checksum(data).to_le_bytes());
        Self(raw)
    }

    fn word(&self) -> Word {
        if self.0 == [0xFF; RAW_BYTES] {
            return Word::Blank;
        }
        let mut data = [0; DATA_BYTES];
        data.copy_from_slice(&self.0[..DATA_BYTES]);
        if Self::new(&data).0 == self.0 { Word::Whole(data) } else { Word::Spoilt }
    }
}

/// Sectors of a flash as `sequential-storage` needs them: spoilt words read as zeros, which it skips.
pub(super) struct Words<'f, F> {
    flash: &'f mut F,
    first_sector: usize,
    sectors: usize,
}

impl<'f, F: NorFlash> Words<'f, F> {
    pub(super) const SECTOR_WORDS: usize = F::ERASE_SIZE / RAW_BYTES;

    pub(super) fn new(flash: &'f mut F, first_sector: usize, sectors: usize) -> Self {
        const {
            assert!(RAW_BYTES.is_multiple_of(F::WRITE_SIZE) && RAW_BYTES.is_multiple_of(F::READ_SIZE));
            assert!(F::ERASE_SIZE.is_multiple_of(RAW_BYTES) && Self::SECTOR_WORDS > FIRST_DATA + 2);
        }
        Self { flash, first_sector, sectors }
    }

    /// Range of the addresses that this type uses.
    pub(super) fn range(&self) -> core::ops::Range<u32> {
        0..self.capacity() as u32
    }

    /// Returns true if nothing has ever been written here.
    pub(super) async fn is_blank(&mut self) -> bool {
        for sector in 0..self.sectors {
            for word in 0..Self::SECTOR_WORDS {
                if self.get(sector, word).await != Word::Blank {
                    return false;
                }
            }
            yield_now().await;
        }
        true
    }

    fn address(&self, sector: usize, word: usize) -> u32 {
        ((self.first_sector + sector) * F::ERASE_SIZE + word * RAW_BYTES) as u32
    }

    async fn get(&mut self, sector: usize, word: usize) -> Word {
        let mut raw = Raw([0; RAW_BYTES]);
        let address = self.address(sector, word);
        // A driver returns an error for a word that fails its error correction.
        if self.flash.read(address, &mut raw.0).await.is_err() { Word::Spoilt } else { raw.word() }
    }

    async fn put(&mut self, sector: usize, word: usize, data: &[u8; DATA_BYTES]) -> Result<(), WordError> {
        if self.get(sector, word).await != Word::Blank {
            return Err(WordError::NotBlank);
        }
        let address = self.address(sector, word);
        self.flash.write(address, &Raw::new(data).0).await.map_err(|_| WordError::Flash)
    }

    async fn is_sealed(&mut self, sector: usize) -> bool {
        self.get(sector, SEAL_WORD).await == Word::Whole(SEAL) && self.get(sector, VOID_WORD).await == Word::Blank
    }

    async fn erase_sector(&mut self, sector: usize) -> Result<(), WordError> {
        if self.is_sealed(sector).await {
            self.put(sector, VOID_WORD, &[0; DATA_BYTES]).await?;
        }
        let (from, to) = (self.address(sector, 0), self.address(sector + 1, 0));
        self.flash.erase(from, to).await.map_err(|_| WordError::Flash)?;
        self.put(sector, SEAL_WORD, &SEAL).await
    }

    /// Sector and word at `offset`, an address of this type.
    fn place(offset: u32) -> (usize, usize) {
        let offset = offset as usize;
        (offset / Self::ERASE_SIZE, offset % Self::ERASE_SIZE / DATA_BYTES + FIRST_DATA)
    }
}

impl<F> ErrorType for Words<'_, F> {
    type Error = WordError;
}

impl<F: NorFlash> ReadNorFlash for Words<'_, F> {
    const READ_SIZE: usize = DATA_BYTES;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), WordError> {
        // The store reads item after item: other tasks run in between.
        yield_now().await;
        let (sector, first_word) = Self::place(offset);
        let is_sealed = self.is_sealed(sector).await;
        for (word, chunk) in (first_word..).zip(bytes.chunks_mut(DATA_BYTES)) {
            let word = if is_sealed { self.get(sector, word).await } else { Word::Blank };
            match word {
                Word::Blank => chunk.fill(0xFF),
                Word::Whole(data) => chunk.copy_from_slice(&data[..chunk.len()]),
                Word::Spoilt => chunk.fill(0),
            }
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.sectors * Self::ERASE_SIZE
    }
}

impl<F: NorFlash> NorFlash for Words<'_, F> {
    const WRITE_SIZE: usize = DATA_BYTES;
    const ERASE_SIZE: usize = (F::ERASE_SIZE / RAW_BYTES - FIRST_DATA) * DATA_BYTES;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), WordError> {
        for sector in Self::place(from).0..Self::place(to).0 {
            self.erase_sector(sector).await?;
        }
        Ok(())
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), WordError> {
        let (sector, first_word) = Self::place(offset);
        if !self.is_sealed(sector).await {
            self.erase_sector(sector).await?;
        }
        for (word, chunk) in (first_word..).zip(bytes.chunks(DATA_BYTES)) {
            let mut data = [0; DATA_BYTES];
            data[..chunk.len()].copy_from_slice(chunk);
            self.put(sector, word, &data).await?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_content_looks_blank_and_every_content_comes_back() {
        for data in [[0xFF; DATA_BYTES], [0; DATA_BYTES], SEAL] {
            assert_eq!(Raw::new(&data).word(), Word::Whole(data));
        }
        assert_eq!(Raw([0xFF; RAW_BYTES]).word(), Word::Blank);
    }

    #[test]
    fn a_word_that_is_cut_short_anywhere_is_spoilt_or_blank() {
        let whole = Raw::new(&SEAL).0;
        for programmed in 0..RAW_BYTES - 4 {
            let mut raw = [0xFF; RAW_BYTES];
            raw[..programmed].copy_from_slice(&whole[..programmed]);
            let expected = if programmed == 0 { Word::Blank } else { Word::Spoilt };
            assert_eq!(Raw(raw).word(), expected, "{programmed} bytes");
        }
    }
}
