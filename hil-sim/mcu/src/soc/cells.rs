//! All cells of the flash: those that the processor reads directly, which are the bytes of [`Memory`], and those that the board
//! keeps.

use std::{cell::Cell, collections::BTreeMap, ops::Range, rc::Rc};

use crate::{
    memory::{Bank, Memory},
    peripherals::flash::{BANK_WORDS, FlashCells, PowerLost, SECTOR_WORDS, WORD_BYTES, Word},
};

/// The first word of those that are kept elsewhere: sector 4 of bank 2.
const KEPT: u32 = BANK_WORDS + 4 * SECTOR_WORDS;

/// Cells of a chip.
pub(super) struct Cells<F> {
    banks: [Rc<[Cell<u8>]>; 2],
    kept: F,
    /// Words of the banks that do not read as their bytes.
    spoiled: BTreeMap<u32, Word>,
    changed: bool,
}

impl<F: FlashCells> Cells<F> {
    pub(super) fn new(memory: &Memory, kept: F) -> Self {
        let banks = [Bank::Flash1, Bank::Flash2].map(|bank| Rc::clone(memory.region(bank).bytes()));
        Self { banks, kept, spoiled: BTreeMap::new(), changed: false }
    }

    /// Whether what the processor reads directly has changed since the last time.
    pub(super) fn take_changed(&mut self) -> bool {
        std::mem::take(&mut self.changed)
    }

    /// Addresses of words in a bank (0, 1) that cannot be read directly.
    pub(super) fn holes(&self, bank: usize) -> Vec<Range<u32>> {
        let first = bank as u32 * BANK_WORDS;
        let mut holes: Vec<Range<u32>> = Vec::new();
        for (word, _) in self.spoiled.range(first..first + BANK_WORDS) {
            let start = Bank::Flash1.span().0 + word * WORD_BYTES as u32;
            let end = start + WORD_BYTES as u32;
            match holes.last_mut().filter(|hole| hole.end == start) {
                Some(hole) => hole.end = end,
                None => holes.push(start..end),
            }
        }
        holes
    }

    fn bytes(&self, index: u32) -> &[Cell<u8>] {
        let (bank, word) = ((index / BANK_WORDS).min(1) as usize, (index % BANK_WORDS) as usize);
        self.banks[bank].get(word * WORD_BYTES..(word + 1) * WORD_BYTES).unwrap_or(&[])
    }

    /// The part of some words that is here, and the part that is kept.
    fn split(first: u32, words: u32) -> (Range<u32>, Range<u32>) {
        let end = first + words;
        (first..end.min(KEPT).max(first), first.max(KEPT).min(end)..end)
    }
}

impl<F: FlashCells> FlashCells for Cells<F> {
    fn word(&mut self, index: u32) -> Word {
        if index >= KEPT {
            return self.kept.word(index);
        }
        let mut bytes = [0; WORD_BYTES];
        bytes.iter_mut().zip(self.bytes(index)).for_each(|(byte, cell)| *byte = cell.get());
        self.spoiled.get(&index).copied().unwrap_or(Word::Good(bytes))
    }

    fn program(&mut self, index: u32, bytes: &[u8; WORD_BYTES]) -> Result<(), PowerLost> {
        if index >= KEPT {
            return self.kept.program(index, bytes);
        }
        if self.word(index) != Word::ERASED {
            self.spoiled.insert(index, Word::Unreadable);
        }
        self.bytes(index).iter().zip(bytes).for_each(|(cell, byte)| cell.set(cell.get() & byte));
        self.changed = true;
        Ok(())
    }

    fn erase(&mut self, first: u32, words: u32) -> Result<(), PowerLost> {
        let (here, kept) = Self::split(first, words);
        if !here.is_empty() {
            self.changed = true;
        }
        for index in here {
            self.bytes(index).iter().for_each(|cell| cell.set(0xFF));
            self.spoiled.remove(&index);
        }
        if kept.is_empty() { Ok(()) } else { self.kept.erase(kept.start, kept.end - kept.start) }
    }

    fn abandon(&mut self, first: u32, words: u32) {
        let (here, kept) = Self::split(first, words);
        if !here.is_empty() {
            self.changed = true;
        }
        self.spoiled.extend(here.map(|index| (index, Word::Unreadable)));
        if !kept.is_empty() {
            self.kept.abandon(kept.start, kept.end - kept.start);
        }
    }
}
