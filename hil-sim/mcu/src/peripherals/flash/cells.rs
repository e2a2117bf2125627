//! Memory cells, separate from the registers: a board may provide its own, with power cuts and wear.

/// Size of a flash word, the unit of programming and of error correction, bytes.
pub const WORD_BYTES: usize = 32;
/// Size of a sector of 128 KiB, flash words.
pub const SECTOR_WORDS: u32 = 4096;
/// Number of sectors per bank.
pub const BANK_SECTORS: u32 = 8;
/// Size of a bank, flash words.
pub const BANK_WORDS: u32 = BANK_SECTORS * SECTOR_WORDS;

const ERASED: [u8; WORD_BYTES] = [0xFF; WORD_BYTES];

/// Result of reading a flash word.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Word {
    /// The word is as programmed or erased.
    Good([u8; WORD_BYTES]),
    /// One bit was wrong and has been corrected.
    Corrected([u8; WORD_BYTES]),
    /// More bits are wrong than can be corrected.
    Unreadable,
}

impl Word {
    /// Flash word after an erase.
    pub const ERASED: Self = Self::Good(ERASED);
}

/// Power failure during a step; the cells hold what it left. No further step may be executed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PowerLost;

/// Flash cells of 2 MiB. Words are numbered from the start of bank 1 (0x0800_0000); bank 2 begins at [`BANK_WORDS`].
///
/// Steps are called at their end, after their time has passed.
pub trait FlashCells {
    /// Reads a flash word.
    fn word(&mut self, index: u32) -> Word;

    /// Programs a word. One that was not erased becomes unreadable, because its ECC no longer matches.
    ///
    /// # Errors
    /// [`PowerLost`] if the power fails in this step.
    fn program(&mut self, index: u32, bytes: &[u8; WORD_BYTES]) -> Result<(), PowerLost>;

    /// Erases whole sectors, `words` flash words from `first` on.
    ///
    /// # Errors
    /// [`PowerLost`] if the power fails in this step.
    fn erase(&mut self, first: u32, words: u32) -> Result<(), PowerLost>;

    /// Notes a reset of the chip during a step on these words: their content is undefined.
    fn abandon(&mut self, first: u32, words: u32);
}

/// Cells without wear and power cuts.
#[derive(Clone)]
pub struct PlainCells {
    /// Content by sector; `None` for sectors that were never written and so are erased.
    sectors: Vec<Option<Vec<Word>>>,
}

impl Default for PlainCells {
    fn default() -> Self {
        Self::new()
    }
}

impl PlainCells {
    /// Makes cells that are all erased.
    #[must_use]
    pub fn new() -> Self {
        Self { sectors: vec![None; 2 * BANK_SECTORS as usize] }
    }

    /// Writes content at an offset from 0x0800_0000, as a programmer does; other content stays.
    ///
    /// # Panics
    /// At an offset beyond the end of the flash.
    pub fn load(&mut self, offset: u32, bytes: &[u8]) {
        for (offset, byte) in (offset..).zip(bytes) {
            let index = offset / WORD_BYTES as u32;
            let mut word = match self.word(index) {
                Word::Good(word) | Word::Corrected(word) => word,
                Word::Unreadable => ERASED,
            };
            word[offset as usize % WORD_BYTES] = *byte;
            self.set(index, Word::Good(word));
        }
    }

    /// Sets the result of reading a word.
    ///
    /// # Panics
    /// At an index beyond the end of the flash.
    pub fn set(&mut self, index: u32, word: Word) {
        let sector = &mut self.sectors[(index / SECTOR_WORDS) as usize];
        sector.get_or_insert_with(|| vec![Word::ERASED; SECTOR_WORDS as usize])[(index % SECTOR_WORDS) as usize] = word;
    }
}

impl FlashCells for PlainCells {
    fn word(&mut self, index: u32) -> Word {
        let sector = self.sectors.get((index / SECTOR_WORDS) as usize);
        sector.and_then(Option::as_ref).map_or(Word::ERASED, |words| words[(index % SECTOR_WORDS) as usize])
    }

    fn program(&mut self, index: u32, bytes: &[u8; WORD_BYTES]) -> Result<(), PowerLost> {
        let erased = self.word(index) == Word::ERASED;
        self.set(index, if erased { Word::Good(*bytes) } else { Word::Unreadable });
        Ok(())
    }

    fn erase(&mut self, first: u32, words: u32) -> Result<(), PowerLost> {
        for sector in first / SECTOR_WORDS..(first + words).div_ceil(SECTOR_WORDS) {
            self.sectors[sector as usize] = None;
        }
        Ok(())
    }

    fn abandon(&mut self, first: u32, words: u32) {
        for index in first..first + words {
            self.set(index, Word::Unreadable);
        }
    }
}
