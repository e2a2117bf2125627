//! Pins of the carrier, generated from its file by `build.rs`.
//!
//! `pin!(p, enc0_sw)` is the pin with that function out of embassy's `Peripherals`. `pin!(p, enc0_a as TIM8_CH1)` is
//! the same where the code relies on the pin's peripheral: it does not compile when the carrier's file has another one.
//! `pin!(af enc0_a as TIM8_CH1)` is the number of the alternate function. The constants are for code below embassy: the
//! stop lines before the clocks run, a bus that is freed by GPIO.

#![allow(dead_code, unused_macros, reason = "a carrier has more pins than any one access to it needs")]

use embassy_stm32::pac::gpio::Gpio;

/// Pin of the processor, by port and number.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) struct Place {
    /// Port of the pin, 0 for port A.
    pub(crate) port: u8,
    /// Number within the port, 0 to 15.
    pub(crate) number: u8,
}

impl Place {
    /// Registers of the port. Its clock must run.
    #[allow(unsafe_code, reason = "the only access by number that the register crate has")]
    pub(crate) fn registers(self) -> Gpio {
        // SAFETY: ports A to K lie 0x400 apart from 0x5802_0000 on (RM0399, table 8), and the carrier's file has no
        // other letters.
        unsafe { Gpio::from_ptr((0x5802_0000 + 0x400 * usize::from(self.port)) as *mut ()) }
    }

    /// Sets the output's level, regardless of the pin's owner.
    pub(crate) fn set(self, high: bool) {
        let line = usize::from(self.number);
        self.registers().bsrr().write(|w| if high { w.set_bs(line, true) } else { w.set_br(line, true) });
    }

    /// Returns true if the line is high.
    pub(crate) fn is_high(self) -> bool {
        self.registers().idr().read().idr(usize::from(self.number)) == embassy_stm32::pac::gpio::vals::Idr::HIGH
    }
}

include!(concat!(env!("OUT_DIR"), "/pins.rs"));

pub(crate) use pin;
