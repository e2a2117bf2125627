//! What happens when the firmware cannot go on: the stop lines go safe, a record is left, the processor resets.

use core::panic::PanicInfo;

use cortex_m::peripheral::SCB;
use cortex_m_rt::{ExceptionFrame, exception};

use crate::{
    reset::{Kind, Record, leave},
    safety_pins,
};

/// Configurable and hard fault status (ARMv7-M ARM, B3.2.15 and B3.2.16).
const CFSR: *const u32 = 0xE000_ED28 as *const u32;
const HFSR: *const u32 = 0xE000_ED2C as *const u32;

/// Takes no lock and allocates nothing: whatever held a lock will not run again.
fn end(record: &Record) -> ! {
    cortex_m::interrupt::disable();
    safety_pins::stop();
    leave(record);
    cortex_m::asm::dsb();
    SCB::sys_reset()
}

#[panic_handler]
fn panic(info: &PanicInfo) -> ! {
    cortex_m::interrupt::disable();
    safety_pins::stop();
    let (line, file) = info.location().map_or((0, 0), |at| (at.line(), fnv1a(at.file().as_bytes())));
    let lr: u32;
    #[allow(unsafe_code, reason = "the link register has no other access")]
    // SAFETY: reads a register.
    unsafe {
        core::arch::asm!("mov {}, lr", out(reg) lr, options(nomem, nostack, preserves_flags));
    }
    defmt::error!("panic at {}:{}", info.location().map_or("?", |at| at.file()), line);
    end(&Record { kind: Kind::Panic, pc: panic as *const () as u32, lr, detail: line, more: file })
}

/// Of a file's name, so that a record can be matched against the sources.
fn fnv1a(bytes: &[u8]) -> u32 {
    bytes.iter().fold(0x811C_9DC5, |hash, byte| (hash ^ u32::from(*byte)).wrapping_mul(0x0100_0193))
}

#[exception]
#[allow(unsafe_code, reason = "exception handlers are declared so")]
unsafe fn HardFault(frame: &ExceptionFrame) -> ! {
    safety_pins::stop();
    // SAFETY: registers of the processor that can always be read.
    let (cfsr, hfsr) = unsafe { (CFSR.read_volatile(), HFSR.read_volatile()) };
    end(&Record { kind: Kind::Fault, pc: frame.pc(), lr: frame.lr(), detail: cfsr, more: hfsr })
}

#[exception]
#[allow(unsafe_code, reason = "exception handlers are declared so")]
unsafe fn DefaultHandler(number: i16) -> ! {
    end(&Record { kind: Kind::Interrupt, pc: 0, lr: 0, detail: number as u32, more: 0 })
}
