//! Tightly coupled memories: code that is copied into ITCM, and data of DTCM that is cleared, as `memory.x.in` places
//! them.
//!
//! The start-up code of cortex-m-rt initialises neither.

use cortex_m::asm;

use crate::bus_faults;

#[allow(unsafe_code, reason = "symbols of the linker's")]
// SAFETY: only the addresses of the symbols are used.
unsafe extern "C" {
    safe static mut _itcm_start: u32;
    safe static mut _itcm_end: u32;
    safe static _itcm_load: u32;
    safe static mut _dtcm_start: u32;
    safe static mut _dtcm_end: u32;
}

/// Initialises both memories. Call it once, before any function in ITCM is called, and before anything in DTCM is used.
///
/// Word by word and volatile, because the compiler turns any other loop into a call of `memcpy`.
pub(crate) fn load() {
    let words = |start: *mut u32, end: *mut u32| (end.addr() - start.addr()) / size_of::<u32>();
    let (code, from) = (&raw mut _itcm_start, &raw const _itcm_load);
    let data = &raw mut _dtcm_start;
    #[allow(unsafe_code, reason = "memory that only the linker knows")]
    // SAFETY: the linker reserves both regions for this alone, as long as the copy in flash and aligned to words;
    // nothing refers to them yet.
    unsafe {
        // A word that cannot be read here also fails the check of the image, before any code runs that may arm.
        let _ = bus_faults::ignored(|| {
            for word in 0..words(code, &raw mut _itcm_end) {
                code.add(word).write_volatile(from.add(word).read_volatile());
            }
        });
        for word in 0..words(data, &raw mut _dtcm_end) {
            data.add(word).write_volatile(0);
        }
    }
    // Instructions fetched from now on are those just written.
    asm::dsb();
    asm::isb();
}
