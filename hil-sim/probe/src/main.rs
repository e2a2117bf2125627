//! Probe: checks a Cortex-M7 against its manual (DDI0403E; chapters are named in the checks).
//!
//! Every check has a known result, from the manual or computed elsewhere. Results go to [`report::R4_PROBE`] in memory
//! and as text to a debugger (semihosting), so that the same source runs on an emulated STM32H747, on qemu (feature
//! `an500`), and on a chip with a debugger attached; a check that fails names itself.

#![no_std]
#![no_main]

mod arithmetic;
mod dsp;
mod exceptions;
mod exclusive;
mod faults;
mod float;
mod handlers;
mod integer;
mod masks;
mod memory;
mod registers;
mod report;
mod storm;

use core::panic::PanicInfo;

#[cortex_m_rt::entry]
fn main() -> ! {
    integer::run();
    dsp::run();
    memory::run();
    float::run();
    exclusive::run();
    exceptions::run();
    masks::run();
    faults::run();
    storm::run();
    report::finish()
}

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    report::text("panic\n");
    report::finish()
}
