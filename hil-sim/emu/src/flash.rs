//! The chip's flash cells: the sectors that keep parameters and trips are those of the simulated board's flash.

use std::{cell::RefCell, rc::Rc};

use embassy_futures::block_on;
use embedded_storage_async::nor_flash::{NorFlash, ReadNorFlash};
use r4_mcu::peripherals::flash::{BANK_WORDS, FlashCells, PlainCells, PowerLost, SECTOR_WORDS, WORD_BYTES, Word};
use r4_sim::flash::{Flash, FlashError};

/// Bank 2's sectors 4 to 7.
const FIRST: u32 = BANK_WORDS + 4 * SECTOR_WORDS;

/// All cells of the chip.
pub struct Cells {
    /// What is kept.
    kept: Rc<RefCell<Flash>>,
    /// The rest: code, which the processor reads from the chip's memory, and four sectors that nobody uses.
    rest: PlainCells,
}

impl Cells {
    pub(crate) fn new(kept: Rc<RefCell<Flash>>) -> Self {
        Self { kept, rest: PlainCells::new() }
    }
}

/// Address in the kept sectors.
fn kept_address(word: u32) -> Option<u32> {
    Some(word.checked_sub(FIRST)? * WORD_BYTES as u32)
}

impl FlashCells for Cells {
    fn word(&mut self, index: u32) -> Word {
        let Some(address) = kept_address(index) else { return self.rest.word(index) };
        let mut bytes = [0; WORD_BYTES];
        // Its steps take no time of their own here: the chip's model of the registers lets it pass.
        match block_on(self.kept.borrow_mut().read(address, &mut bytes)) {
            Ok(()) => Word::Good(bytes),
            Err(_) => Word::Unreadable,
        }
    }

    fn program(&mut self, index: u32, bytes: &[u8; WORD_BYTES]) -> Result<(), PowerLost> {
        let Some(address) = kept_address(index) else { return self.rest.program(index, bytes) };
        lost(block_on(self.kept.borrow_mut().write(address, bytes)))
    }

    fn erase(&mut self, first: u32, words: u32) -> Result<(), PowerLost> {
        let Some(address) = kept_address(first) else { return self.rest.erase(first, words) };
        lost(block_on(self.kept.borrow_mut().erase(address, address + words * WORD_BYTES as u32)))
    }

    fn abandon(&mut self, first: u32, words: u32) {
        match kept_address(first) {
            Some(address) => self.kept.borrow_mut().spoil(address, words),
            None => self.rest.abandon(first, words),
        }
    }
}

/// Of the errors of the simulated flash, the registers' model lets only one happen.
fn lost(result: Result<(), FlashError>) -> Result<(), PowerLost> {
    result.map_err(|_| PowerLost)
}
