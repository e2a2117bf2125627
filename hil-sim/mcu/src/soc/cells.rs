//! All cells of the flash: those that the processor reads directly, which are the bytes of [`Memory`], and those that
//! the board keeps.

use std::{cell::Cell, collections::BTreeMap, ops::Range, rc::Rc};

use crate::{
    memory::{Bank, Memory},
    peripherals::flash::{BANK_WORDS, BASE, FlashCells, PowerLost, SECTOR_WORDS, WORD_BYTES, Word},
};

/// Parts of the flash in order of address.
pub(super) const FLASH: [Bank; 3] = [Bank::Flash1, Bank::Flash2, Bank::Storage];

/// First word of the cells kept elsewhere: sector 4 of bank 2.
const KEPT: u32 = BANK_WORDS + 4 * SECTOR_WORDS;

/// Flash cells of a chip.
pub(super) struct Cells<F> {
    /// Bytes that the processor reads directly, by address.
    places: [Rc<[Cell<u8>]>; 3],
    /// The banks' addresses are exchanged.
    swapped: bool,
    kept: F,
    /// Words of the banks that do not read as their bytes, for example after a failed programming.
    spoiled: BTreeMap<u32, Word>,
    changed: bool,
}

impl<F: FlashCells> Cells<F> {
    pub(super) fn new(memory: &Memory, kept: F) -> Self {
        let places = FLASH.map(|bank| Rc::clone(memory.region(bank).bytes()));
        Self { places, swapped: false, kept, spoiled: BTreeMap::new(), changed: false }
    }

    /// Sets whether the banks' addresses are exchanged; returns true if that is new, so that the contents of [`Memory`]
    /// must follow.
    pub(super) fn swap(&mut self, swapped: bool) -> bool {
        let changes = std::mem::replace(&mut self.swapped, swapped) != swapped;
        self.changed |= changes;
        changes
    }

    /// Returns true if the directly readable bytes have changed since the last call.
    pub(super) fn take_changed(&mut self) -> bool {
        std::mem::take(&mut self.changed)
    }

    /// Returns the addresses in a part of the flash that cannot be read directly: spoiled words, and cells kept
    /// elsewhere.
    pub(super) fn holes(&self, bank: Bank) -> Vec<Range<u32>> {
        let (base, len) = bank.span();
        let first = self.place((base - BASE) / WORD_BYTES as u32);
        let mut holes: Vec<Range<u32>> = Vec::new();
        for (word, _) in self.spoiled.range(first..first + len / WORD_BYTES as u32) {
            let start = BASE + self.place(*word) * WORD_BYTES as u32;
            let end = start + WORD_BYTES as u32;
            match holes.last_mut().filter(|hole| hole.end == start) {
                Some(hole) => hole.end = end,
                None => holes.push(start..end),
            }
        }
        if self.swapped && bank == Bank::Flash1 {
            // The kept part follows all cells that can be spoiled here, so the holes stay in order.
            holes.push(BASE + self.place(KEPT) * WORD_BYTES as u32..base + len);
        }
        holes
    }

    /// Converts a word's index to its place in the memory map, and back.
    fn place(&self, index: u32) -> u32 {
        index ^ if self.swapped { BANK_WORDS } else { 0 }
    }

    fn bytes(&self, index: u32) -> &[Cell<u8>] {
        let mut at = self.place(index) as usize * WORD_BYTES;
        for bytes in &self.places {
            if at < bytes.len() {
                return bytes.get(at..at + WORD_BYTES).unwrap_or(&[]);
            }
            at -= bytes.len();
        }
        &[]
    }

    /// Splits a range of words into the part in this type and the part kept elsewhere.
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
