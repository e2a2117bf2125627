//! End of a failed run: the stop lines go safe, a record is left, the processor resets.

use core::{
    panic::{Location, PanicInfo},
    sync::atomic::{AtomicBool, Ordering},
};

use cortex_m::peripheral::SCB;
use cortex_m_rt::exception;
use embassy_stm32::pac;

use crate::{
    reset::{Kind, Record, leave},
    safety_pins,
};

/// Registers of configurable and hard fault status (ARMv7-M ARM, B3.2.15 and B3.2.16).
const CFSR: *const u32 = 0xE000_ED28 as *const u32;
const HFSR: *const u32 = 0xE000_ED2C as *const u32;

/// Ends the run. Takes no lock and allocates nothing: the holder of a lock will not run again.
fn end(record: &Record) -> ! {
    cortex_m::interrupt::disable();
    safety_pins::stop();
    leave(record);
    cortex_m::asm::dsb();
    SCB::sys_reset()
}

/// True while a panic is being recorded: a second one within it, as of a log line inside a log line, only resets.
static PANICKED: AtomicBool = AtomicBool::new(false);

/// Panic handler. The caller's address is useless, since it is in `core`. The record therefore has data that lead to
/// the place in the ELF file: the address of the location and of its file's name, the line, and the stack pointer.
#[panic_handler]
fn panic(info: &PanicInfo) -> ! {
    cortex_m::interrupt::disable();
    safety_pins::stop();
    if PANICKED.swap(true, Ordering::Relaxed) {
        SCB::sys_reset();
    }
    let at = info.location();
    let record = Record {
        kind: Kind::Panic,
        pc: at.map_or(0, |at| core::ptr::from_ref(at).addr() as u32),
        lr: cortex_m::register::msp::read(),
        detail: at.map_or(0, Location::line),
        more: at.map_or(0, |at| at.file().as_ptr().addr() as u32),
    };
    leave(&record);
    defmt::error!("panic at {}:{}", at.map_or("?", Location::file), record.detail);
    end(&record)
}

/// Stack of the fault handler: the fault may come from the end of the main one.
#[repr(align(8))]
#[allow(dead_code, reason = "only its place is used")]
struct Stack([u8; STACK]);
const STACK: usize = 1024;

#[allow(unsafe_code, reason = "the assembly below needs its address")]
static mut FAULT_STACK: Stack = Stack([0; STACK]);

/// Enters [`fault`] on a stack of its own, with the frame that the processor stacked. All code runs on the main stack.
#[allow(unsafe_code, reason = "an exception handler is called by its name, and begins without a stack")]
#[unsafe(no_mangle)]
#[unsafe(naked)]
extern "C" fn HardFault() -> ! {
    core::arch::naked_asm!(
        "mrs r0, msp",
        "movw r1, #:lower16:{stack} + {size}",
        "movt r1, #:upper16:{stack} + {size}",
        "mov sp, r1",
        "b {fault}",
        stack = sym FAULT_STACK,
        size = const STACK,
        fault = sym fault,
    )
}

/// Address range of DTCM, where the stack is.
const RAM: core::ops::Range<usize> = 0x2000_0000..0x2002_0000;
/// Indices of LR and PC in the frame that the processor stacks (ARMv7-M ARM, B1.5.6).
const STACKED_LR: usize = 5;
const STACKED_PC: usize = 6;

extern "C" fn fault(frame: *const u32) -> ! {
    safety_pins::stop();
    // After an overflow the frame is outside RAM, and reading it would fault again.
    let there = |word: usize| RAM.contains(&(frame as usize + 4 * word));
    let stacked = |word: usize| if there(word) { read(frame.wrapping_add(word)) } else { 0 };
    let (pc, lr) = (stacked(STACKED_PC), stacked(STACKED_LR));
    end(&Record { kind: Kind::Fault, pc, lr, detail: read(CFSR), more: read(HFSR) })
}

#[allow(unsafe_code, reason = "reads registers and the stack by their addresses")]
fn read(address: *const u32) -> u32 {
    // SAFETY: called with an address in RAM that is aligned as the processor aligns its stack, and with registers of
    // the processor that can always be read.
    unsafe { address.read_volatile() }
}

/// Handler of the clock security system, the only source of the NMI on this processor: the crystal stopped, the
/// hardware has switched the processor to its internal oscillator, and every peripheral that ran from a PLL stands
/// still (RM0399, 9.5.4).
#[exception]
#[allow(unsafe_code, reason = "exception handlers are declared so")]
unsafe fn NonMaskableInt() -> ! {
    safety_pins::stop();
    end(&Record { kind: Kind::Clock, pc: 0, lr: 0, detail: pac::RCC.cifr().read().0, more: 0 })
}

#[exception]
#[allow(unsafe_code, reason = "exception handlers are declared so")]
unsafe fn DefaultHandler(number: i16) -> ! {
    end(&Record { kind: Kind::Interrupt, pc: 0, lr: 0, detail: number as u32, more: 0 })
}
