//! Flash cells that outlive the chip: the sectors for parameters and trips are those of the simulated board's flash.

use std::{cell::RefCell, rc::Rc};

use embassy_futures::block_on;
use embedded_storage_async::nor_flash::{NorFlash, ReadNorFlash};
use r4_mcu::peripherals::flash::{BANK_WORDS, FlashCells, PowerLost, SECTOR_WORDS, WORD_BYTES, Word};
use r4_sim::flash::{Flash, FlashError};

/// First flash word of bank 2's sectors 4 to 7.
const FIRST: u32 = BANK_WORDS + 4 * SECTOR_WORDS;

/// Kept flash cells of the board; [`r4_mcu::soc::Soc`] has the others, and asks for none before these.
pub struct Cells(Rc<RefCell<Flash>>);

impl Cells {
    pub(crate) fn new(kept: Rc<RefCell<Flash>>) -> Self {
        Self(kept)
    }
}

/// Converts a flash word's index to an address in the kept sectors, bytes.
fn address(word: u32) -> u32 {
    word.saturating_sub(FIRST) * WORD_BYTES as u32
}

impl FlashCells for Cells {
    fn word(&mut self, index: u32) -> Word {
        let mut bytes = [0; WORD_BYTES];
        // The future is ready at once: the model of the flash registers accounts for the time of each step.
        match block_on(self.0.borrow_mut().read(address(index), &mut bytes)) {
            Ok(()) => Word::Good(bytes),
            Err(_) => Word::Unreadable,
        }
    }

    fn program(&mut self, index: u32, bytes: &[u8; WORD_BYTES]) -> Result<(), PowerLost> {
        lost(block_on(self.0.borrow_mut().write(address(index), bytes)))
    }

    fn erase(&mut self, first: u32, words: u32) -> Result<(), PowerLost> {
        let address = address(first);
        lost(block_on(self.0.borrow_mut().erase(address, address + words * WORD_BYTES as u32)))
    }

    fn abandon(&mut self, first: u32, words: u32) {
        self.0.borrow_mut().spoil(address(first), words);
    }
}

/// Converts an error of the simulated flash: the registers' model prevents all but the loss of power.
fn lost(result: Result<(), FlashError>) -> Result<(), PowerLost> {
    result.map_err(|_| PowerLost)
}
