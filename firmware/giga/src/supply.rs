//! Supply of the processor: the voltage detector warns before the brown-out reset comes.
//!
//! The detector (PVD) interrupts when the 3.3 V rail falls below 2.75 V. The handler drives the stop lines and trips
//! the board, so that the chips on the I2C bus are written while the processor still runs; the cause is present until
//! the rail is above 2.85 V again. The brown-out reset is an option byte, which the image does not change: a power cut
//! while option bytes are written can lock the chip, so they are written once for a board, not at each start.
//! [`brown_out_level`] returns the present level, and the boot logs a warning when it is off. `docs/bring-up.md`, 3,
//! has the command.

use core::cell::Cell;

use critical_section::Mutex;
use embassy_stm32::{
    interrupt::{self, InterruptExt, Priority},
    pac::{EXTI, FLASH, PWR},
};
use r4_protocol::Cause;

use crate::{boot::Board, safety_pins};

/// Level in PWR_CR1.PLS: 2.85 V rising, 0.1 V less falling, the highest (RM0399, 7.8.1; STM32H747 datasheet, reset and
/// power control).
const LEVEL: u8 = 0b110;
/// EXTI line of the detector's output, high while the supply is low (RM0399, table "EXTI Event input mapping").
const LINE: usize = 16;

/// Board that the interrupt trips.
static BOARD: Mutex<Cell<Option<&'static Board>>> = Mutex::new(Cell::new(None));

/// Starts watching the supply, for `board`.
pub(crate) fn watch(board: &'static Board) {
    critical_section::with(|cs| BOARD.borrow(cs).set(Some(board)));
    PWR.cr1().modify(|w| {
        w.set_pls(LEVEL);
        w.set_pvde(true);
    });
    EXTI.rtsr(0).modify(|w| w.set_line(LINE, true));
    EXTI.ftsr(0).modify(|w| w.set_line(LINE, true));
    EXTI.pr(0).write(|w| w.set_line(LINE, true));
    EXTI.imr(0).modify(|w| w.set_line(LINE, true));
    interrupt::PVD_AVD.set_priority(Priority::P0);
    #[allow(unsafe_code, reason = "turns an interrupt on")]
    // SAFETY: no critical section relies on the interrupt being disabled; its handler shares only data behind critical
    // sections.
    unsafe {
        interrupt::PVD_AVD.enable();
    }
    // A supply that was low before gives no edge.
    look();
}

fn look() {
    let low = PWR.csr1().read().pvdo();
    if low {
        safety_pins::stop();
    }
    if let Some(board) = critical_section::with(|cs| BOARD.borrow(cs).get()) {
        board.set_processor_cause(Cause::SupplyOutOfRange, low);
    }
}

/// Level in FLASH_OPTSR_CUR.BOR_LEV: 0 is off, so that the chip resets below 1.7 V only; 3 is 2.7 V (RM0399, 4.9.9).
pub(crate) fn brown_out_level() -> u8 {
    FLASH.optsr_cur().read().bor_lev()
}

#[allow(unsafe_code, reason = "an interrupt handler is called by its name")]
#[unsafe(no_mangle)]
extern "C" fn PVD_AVD() {
    EXTI.pr(0).write(|w| w.set_line(LINE, true));
    look();
}
