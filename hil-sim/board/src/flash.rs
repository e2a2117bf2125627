//! Flash memory of the STM32H747 as a driver sees it: sectors, words that can be programmed once, and the effects of a
//! power cut.
//!
//! Sectors have 128 KiB and flash words 32 bytes, each word with its own error correction (RM0399, 4.3). A word that is
//! programmed again no longer matches its correction code; reading it is a bus error, which a driver reports. An erase
//! takes 1 s and programming a word 0.1 ms, about the typical values of the datasheet.
//!
//! A power cut during one of these steps has the effect described by [`Tear`]. Everything else stays.

use std::fmt;

use embedded_storage_async::nor_flash::{ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash};
use rand_pcg::{
    Pcg64,
    rand_core::{Rng, SeedableRng},
};

use crate::Clock;

/// Size of a sector of the STM32H747, bytes.
pub const SECTOR_BYTES: usize = 128 * 1024;
/// Size of a flash word, bytes.
pub const WORD_BYTES: usize = 32;

const ERASE_NS: u64 = 1_000_000_000;
const PROGRAM_NS: u64 = 100_000;

/// Effect of a power cut on the word being programmed, or on the sector being erased.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tear {
    /// The old content stays: the step had hardly begun.
    Nothing,
    /// The word, or each word of the sector, fails its error correction.
    Unreadable,
    /// The first half of the word or sector is new, the rest old; the correction detects nothing.
    FirstHalf,
    /// The second half is new, the rest old; the correction detects nothing.
    SecondHalf,
    /// Each bit has changed at random. The correction detects most of it, repairs single bits, and is sometimes wrong.
    Bits {
        /// Seed of the random selection.
        seed: u64,
    },
}

/// Error of a flash driver.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FlashError {
    /// Address or length that is not a multiple of a word, or of a sector for an erase.
    NotAligned,
    /// Range beyond the end of the flash.
    OutOfBounds,
    /// Word with more errors than the correction can repair.
    Unreadable {
        /// Address of the first such word.
        address: u32,
    },
    /// Access to a flash without power.
    NoPower,
}

impl fmt::Display for FlashError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotAligned => f.write_str("address or length is no multiple of a word or sector"),
            Self::OutOfBounds => f.write_str("beyond the end of the flash"),
            Self::Unreadable { address } => write!(f, "word at {address:#x}: double error, a bus error on the chip"),
            Self::NoPower => f.write_str("the power is off"),
        }
    }
}

impl std::error::Error for FlashError {}

impl NorFlashError for FlashError {
    fn kind(&self) -> NorFlashErrorKind {
        match self {
            Self::NotAligned => NorFlashErrorKind::NotAligned,
            Self::OutOfBounds => NorFlashErrorKind::OutOfBounds,
            Self::Unreadable { .. } | Self::NoPower => NorFlashErrorKind::Other,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Word {
    bytes: [u8; WORD_BYTES],
    readable: bool,
}

impl Word {
    const ERASED: Self = Self { bytes: [0xFF; WORD_BYTES], readable: true };
    const UNREADABLE: Self = Self { bytes: [0; WORD_BYTES], readable: false };
}

/// A number of flash sectors. `SECTOR` is their size in bytes; small ones make tests fast.
#[derive(Clone)]
pub struct Flash<const SECTOR: usize = SECTOR_BYTES> {
    words: Vec<Word>,
    clock: Option<Clock>,
    steps: u64,
    /// Step in which the power is cut, and its effect.
    cut: Option<(u64, Tear)>,
    has_power: bool,
    programmed_twice: Vec<u32>,
}

impl<const SECTOR: usize> Flash<SECTOR> {
    /// A flash of erased sectors, whose steps take no time.
    #[must_use]
    pub fn new(sectors: usize) -> Self {
        Self {
            words: vec![Word::ERASED; sectors * SECTOR / WORD_BYTES],
            clock: None,
            steps: 0,
            cut: None,
            has_power: true,
            programmed_twice: Vec::new(),
        }
    }

    /// The same flash with steps that take time on `clock`.
    #[must_use]
    pub fn with_clock(self, clock: Clock) -> Self {
        Self { clock: Some(clock), ..self }
    }

    /// Number of words programmed and sectors erased since power-up.
    #[must_use]
    pub fn steps(&self) -> u64 {
        self.steps
    }

    /// Addresses of words that were programmed without an erase: the chip does not report it, and they become
    /// unreadable.
    #[must_use]
    pub fn programmed_twice(&self) -> &[u32] {
        &self.programmed_twice
    }

    /// Cuts the power in the step after `steps` more.
    pub fn cut_after(&mut self, steps: u64, tear: Tear) {
        self.cut = Some((self.steps + steps, tear));
    }

    /// True while the power is on.
    #[must_use]
    pub fn has_power(&self) -> bool {
        self.has_power
    }

    /// Restores the power, and cancels a planned cut.
    pub fn power_up(&mut self) {
        (self.steps, self.cut, self.has_power) = (0, None, true);
    }

    /// Content for a file: for each word a byte, 1 if it is readable and 0 otherwise, and its data.
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        self.words.iter().flat_map(|word| [word.readable.into()].into_iter().chain(word.bytes)).collect()
    }

    /// A flash with the content of [`Flash::to_bytes`]; `None` for any other data, or if it is not a number of whole
    /// sectors.
    #[must_use]
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let (words, rest) = bytes.as_chunks::<{ 1 + WORD_BYTES }>();
        if !rest.is_empty() || !words.len().is_multiple_of(SECTOR / WORD_BYTES) {
            return None;
        }
        if words.iter().any(|raw| raw[0] > 1) {
            return None;
        }
        let word = |raw: &[u8; 1 + WORD_BYTES]| {
            let mut bytes = [0; WORD_BYTES];
            bytes.copy_from_slice(&raw[1..]);
            Word { bytes, readable: raw[0] == 1 }
        };
        Some(Self { words: words.iter().map(word).collect(), ..Self::new(0) })
    }

    /// Replaces the content by `bytes` from `address` on, which is that of a word, whatever the content was.
    pub fn overwrite(&mut self, address: u32, bytes: &[u8]) {
        let (words, _) = bytes.as_chunks();
        for (word, bytes) in self.words.iter_mut().skip(address as usize / WORD_BYTES).zip(words) {
            *word = Word { bytes: *bytes, readable: true };
        }
    }

    /// Makes words from `address` on unreadable, as a reset during their programming does.
    pub fn spoil(&mut self, address: u32, words: u32) {
        let first = address as usize / WORD_BYTES;
        self.words.iter_mut().skip(first).take(words as usize).for_each(|word| *word = Word::UNREADABLE);
    }

    /// Executes the next step while the power lasts; returns the effect if the power is cut in it.
    async fn step(&mut self, takes_ns: u64) -> Result<Option<Tear>, FlashError> {
        self.check_power()?;
        if let Some(clock) = &self.clock {
            clock.sleep(takes_ns).await;
        }
        match self.cut {
            Some((at, tear)) if at == self.steps => {
                self.has_power = false;
                Ok(Some(tear))
            }
            _ => {
                self.steps += 1;
                Ok(None)
            }
        }
    }

    fn check(&self, offset: u32, length: usize, alignment: usize) -> Result<(), FlashError> {
        let offset = offset as usize;
        if !offset.is_multiple_of(alignment) || !length.is_multiple_of(alignment) {
            return Err(FlashError::NotAligned);
        }
        if offset + length > self.capacity() { Err(FlashError::OutOfBounds) } else { Ok(()) }
    }

    fn check_power(&self) -> Result<(), FlashError> {
        if self.has_power { Ok(()) } else { Err(FlashError::NoPower) }
    }
}

impl Tear {
    /// Content after a power cut on the way from `before` to `after`.
    fn apply(self, before: &[Word], after: &[Word]) -> Vec<Word> {
        let halves = |first: &[Word], second: &[Word]| -> Vec<Word> {
            if let ([first], [second]) = (first, second) {
                // half of one word and half of another, undetected by the correction
                let mut bytes = second.bytes;
                bytes[..WORD_BYTES / 2].copy_from_slice(&first.bytes[..WORD_BYTES / 2]);
                return vec![Word { bytes, readable: first.readable && second.readable }];
            }
            let half = first.len() / 2;
            [&first[..half], &second[half..]].concat()
        };
        match self {
            Self::Nothing => before.to_vec(),
            Self::Unreadable => vec![Word::UNREADABLE; before.len()],
            Self::FirstHalf => halves(after, before),
            Self::SecondHalf => halves(before, after),
            Self::Bits { seed } => {
                let mut random = Pcg64::seed_from_u64(seed);
                // progress in 256ths, common to all cells, which differ a little
                let progress = random.next_u32() as u8;
                before
                    .iter()
                    .zip(after)
                    .map(|(before, after)| torn_bits(&mut random, progress, before, after))
                    .collect()
            }
        }
    }
}

/// A word in which each bit that changes has changed with probability `progress` / 256.
fn torn_bits(random: &mut Pcg64, progress: u8, before: &Word, after: &Word) -> Word {
    let mut bytes = before.bytes;
    for (byte, after) in bytes.iter_mut().zip(after.bytes) {
        for bit in 0..8 {
            if (random.next_u32() as u8) < progress {
                *byte = *byte & !(1 << bit) | after & 1 << bit;
            }
        }
    }
    let differs = |from: &Word| from.bytes.iter().zip(bytes).map(|(a, b)| (a ^ b).count_ones()).sum::<u32>();
    // Error correction repairs one bit. It detects more, except for one pattern in four (its 10 bits distinguish 1024
    // patterns, of which 267 look like a valid word or one with a single error).
    if differs(before) <= 1 {
        *before
    } else if differs(after) <= 1 {
        *after
    } else {
        Word { bytes, readable: random.next_u32().is_multiple_of(4) }
    }
}

impl<const SECTOR: usize> ErrorType for Flash<SECTOR> {
    type Error = FlashError;
}

impl<const SECTOR: usize> ReadNorFlash for Flash<SECTOR> {
    const READ_SIZE: usize = 1;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), FlashError> {
        self.check_power()?;
        self.check(offset, bytes.len(), Self::READ_SIZE)?;
        for (address, byte) in (offset..).zip(bytes) {
            let word = &self.words[address as usize / WORD_BYTES];
            if !word.readable {
                return Err(FlashError::Unreadable { address: address - address % WORD_BYTES as u32 });
            }
            *byte = word.bytes[address as usize % WORD_BYTES];
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.words.len() * WORD_BYTES
    }
}

impl<const SECTOR: usize> NorFlash for Flash<SECTOR> {
    const WRITE_SIZE: usize = WORD_BYTES;
    const ERASE_SIZE: usize = SECTOR;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), FlashError> {
        let length = to.checked_sub(from).ok_or(FlashError::OutOfBounds)?;
        self.check(from, length as usize, Self::ERASE_SIZE)?;
        let size = SECTOR / WORD_BYTES;
        for first in (from as usize / WORD_BYTES..to as usize / WORD_BYTES).step_by(size) {
            let torn = self.step(ERASE_NS).await?;
            let sector = &mut self.words[first..first + size];
            let erased = vec![Word::ERASED; size];
            match torn {
                None => sector.copy_from_slice(&erased),
                Some(tear) => {
                    let left = tear.apply(sector, &erased);
                    sector.copy_from_slice(&left);
                    return Err(FlashError::NoPower);
                }
            }
        }
        Ok(())
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), FlashError> {
        self.check(offset, bytes.len(), Self::WRITE_SIZE)?;
        let (chunks, _) = bytes.as_chunks::<WORD_BYTES>();
        for (address, chunk) in (offset..).step_by(WORD_BYTES).zip(chunks) {
            let torn = self.step(PROGRAM_NS).await?;
            let word = &mut self.words[address as usize / WORD_BYTES];
            let mut after = Word { bytes: *chunk, readable: true };
            if *word != Word::ERASED {
                self.programmed_twice.push(address);
                after = Word::UNREADABLE;
            }
            match torn {
                None => *word = after,
                Some(tear) => {
                    *word = tear.apply(&[*word], &[after])[0];
                    return Err(FlashError::NoPower);
                }
            }
        }
        Ok(())
    }
}
