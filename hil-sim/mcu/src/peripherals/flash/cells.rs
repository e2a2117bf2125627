//! The memory cells, apart from the registers: a board may have its own, with power cuts and wear.

/// Bytes of a flash word: the unit of programming and of error correction.
pub const WORD_BYTES: usize = 32;
/// Flash words of a sector of 128 KiB.
pub const SECTOR_WORDS: u32 = 4096;
/// Sectors of a bank.
pub const BANK_SECTORS: u32 = 8;
/// Flash words of a bank.
pub const BANK_WORDS: u32 = BANK_SECTORS * SECTOR_WORDS;

const ERASED: [u8; WORD_BYTES] = [0xFF; WORD_BYTES];

/// How a flash word reads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Word {
    /// As it was programmed or erased.
    Good([u8; WORD_BYTES]),
    /// One bit was wrong and is corrected.
    Corrected([u8; WORD_BYTES]),
    /// More is wrong than can be corrected.
    Unreadable,
}

impl Word {
    /// After an erase.
    pub const ERASED: Self = Self::Good(ERASED);
}

/// The power went away during a step; what it left is in the cells. Nothing runs any more.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PowerLost;

/// 2 MiB of cells. Words are numbered from the start of bank 1 (0x0800_0000); bank 2 begins with [`BANK_WORDS`].
///
/// Steps are called when they end, the time they take having passed.
pub trait FlashCells {
    /// Reads a word.
    fn word(&mut self, index: u32) -> Word;

    /// Programs a word. One that was not erased is left unreadable: its correction does not fit any more.
    ///
    /// # Errors
    /// The power went in this step.
    fn program(&mut self, index: u32, bytes: &[u8; WORD_BYTES]) -> Result<(), PowerLost>;

    /// Erases whole sectors.
    ///
    /// # Errors
    /// The power went in this step.
    fn erase(&mut self, first: u32, words: u32) -> Result<(), PowerLost>;

    /// A reset of the chip fell into a step that concerned these words: what they hold is not defined.
    fn abandon(&mut self, first: u32, words: u32);
}

/// Cells that always work.
#[derive(Clone)]
pub struct PlainCells {
    /// By sector; those that were never written are erased.
    sectors: Vec<Option<Vec<Word>>>,
}

impl Default for PlainCells {
    fn default() -> Self {
        Self::new()
    }
}

impl PlainCells {
    /// Erased.
    #[must_use]
    pub fn new() -> Self {
        Self { sectors: vec![None; 2 * BANK_SECTORS as usize] }
    }

    /// Puts content at an offset from 0x0800_0000, as a programmer does; what is between stays.
    ///
    /// # Panics
    /// Beyond the end of the flash.
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

    /// Makes a word read like this.
    ///
    /// # Panics
    /// Beyond the end of the flash.
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
