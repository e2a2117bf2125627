//! The flash of the STM32H747, as a driver shows it: sectors, words that can be programmed once, and what is left of both
//! when the power goes.
//!
//! Sectors of 128 KiB and flash words of 32 bytes, each with its own error correction (RM0399, 4.3). A word that is
//! programmed again does not fit its correction any more; reading such a word is a bus error, which a driver reports. An
//! erase takes 1 s and programming a word 0.1 ms, about what the datasheet gives as typical.
//!
//! A power cut during one of these steps leaves what [`Tear`] says. Everything else stays as it was.

use std::fmt;

use embedded_storage_async::nor_flash::{ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash};
use rand_pcg::{
    Pcg64,
    rand_core::{Rng, SeedableRng},
};

use crate::Clock;

/// Bytes of a sector of the STM32H747.
pub const SECTOR_BYTES: usize = 128 * 1024;
/// Bytes of a flash word.
pub const WORD_BYTES: usize = 32;

const ERASE_NS: u64 = 1_000_000_000;
const PROGRAM_NS: u64 = 100_000;

/// What a power cut leaves of the word that was being programmed, or of the sector that was being erased.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tear {
    /// What was there before: it had hardly begun.
    Nothing,
    /// The word, or each word of the sector, fails its error correction.
    Unreadable,
    /// The first half of the word or sector is as it was to be, the rest as it was; the correction says nothing.
    FirstHalf,
    /// The second half is as it was to be, the rest as it was; the correction says nothing.
    SecondHalf,
    /// Each bit had its own pace. The correction notices most of it, repairs single bits, and now and then is wrong.
    Bits {
        /// Chooses which.
        seed: u64,
    },
}

/// What a driver does with what the flash says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FlashError {
    /// The address or length is not one of words, or of sectors for an erase.
    NotAligned,
    /// Beyond the end.
    OutOfBounds,
    /// Error correction found more than it can repair.
    Unreadable {
        /// The first such word.
        address: u32,
    },
    /// The power is off.
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

/// Some sectors of flash. `SECTOR` is their size in bytes; small ones make tests fast.
#[derive(Clone)]
pub struct Flash<const SECTOR: usize = SECTOR_BYTES> {
    words: Vec<Word>,
    clock: Option<Clock>,
    steps: u64,
    /// The power goes in this step.
    cut: Option<(u64, Tear)>,
    has_power: bool,
    programmed_twice: Vec<u32>,
}

impl<const SECTOR: usize> Flash<SECTOR> {
    /// Erased sectors, whose steps take no time.
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

    /// The same, with steps that take their time on `clock`.
    #[must_use]
    pub fn with_clock(self, clock: Clock) -> Self {
        Self { clock: Some(clock), ..self }
    }

    /// Words programmed and sectors erased since power-up.
    #[must_use]
    pub fn steps(&self) -> u64 {
        self.steps
    }

    /// Addresses of words that were programmed without having been erased: the chip says nothing and they become unreadable.
    #[must_use]
    pub fn programmed_twice(&self) -> &[u32] {
        &self.programmed_twice
    }

    /// Cuts the power in the step after `steps` more.
    pub fn cut_after(&mut self, steps: u64, tear: Tear) {
        self.cut = Some((self.steps + steps, tear));
    }

    /// Whether the power is on.
    #[must_use]
    pub fn has_power(&self) -> bool {
        self.has_power
    }

    /// Power again, and no cut planned.
    pub fn power_up(&mut self) {
        (self.steps, self.cut, self.has_power) = (0, None, true);
    }

    /// The content, to be kept in a file: for each word 1 if it can be read or else 0, and its bytes.
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        self.words.iter().flat_map(|word| [word.readable.into()].into_iter().chain(word.bytes)).collect()
    }

    /// A flash with the content from [`Flash::to_bytes`], or `None` if it is something else, or not that of whole sectors.
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

    /// Whatever the content was, it is now these bytes, from `address` on, which is that of a word.
    pub fn overwrite(&mut self, address: u32, bytes: &[u8]) {
        let (words, _) = bytes.as_chunks();
        for (word, bytes) in self.words.iter_mut().skip(address as usize / WORD_BYTES).zip(words) {
            *word = Word { bytes: *bytes, readable: true };
        }
    }

    /// Words from `address` on lose what they held, as when a reset falls into their programming: they cannot be read.
    pub fn spoil(&mut self, address: u32, words: u32) {
        let first = address as usize / WORD_BYTES;
        self.words.iter_mut().skip(first).take(words as usize).for_each(|word| *word = Word::UNREADABLE);
    }

    /// The next step, if the power lasts: after it, what a cut within it leaves.
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
    /// What `before` became on the way to `after`.
    fn apply(self, before: &[Word], after: &[Word]) -> Vec<Word> {
        let halves = |first: &[Word], second: &[Word]| -> Vec<Word> {
            if let ([first], [second]) = (first, second) {
                // What is half of one word and half of another, and passes.
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
                // How far it has come, in 256ths: the same for all cells, which differ a little.
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

/// A word of which each bit that changes has changed with probability `progress` / 256.
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
    // Error correction repairs one bit. More it notices, but for one pattern in four (its 10 bits tell 1024 patterns apart,
    // of which 267 look like a whole word or one with a single error).
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
