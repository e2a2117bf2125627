//! The tightly coupled memories: code that is copied into ITCM, and data of DTCM that is cleared, as `memory.x.in` places them.
//!
//! The start-up code of cortex-m-rt knows neither.

use cortex_m::asm;

use crate::bus_faults;

#[allow(unsafe_code, reason = "symbols of the linker's")]
// SAFETY: only their addresses are used.
unsafe extern "C" {
    safe static mut _itcm_start: u32;
    safe static mut _itcm_end: u32;
    safe static _itcm_load: u32;
    safe static mut _dtcm_start: u32;
    safe static mut _dtcm_end: u32;
}

/// Fills both. Once, before any function is called that lies in ITCM, and before anything of DTCM is used.
///
/// Word by word and volatile: the compiler makes a call of `memcpy` of any other loop.
pub(crate) fn load() {
    let words = |start: *mut u32, end: *mut u32| (end.addr() - start.addr()) / size_of::<u32>();
    let (code, from) = (&raw mut _itcm_start, &raw const _itcm_load);
    let data = &raw mut _dtcm_start;
    #[allow(unsafe_code, reason = "memory that only the linker knows")]
    // SAFETY: the linker keeps both stretches for this alone, as long as the copy in flash and aligned to words; nothing
    // refers to them yet.
    unsafe {
        // What cannot be read here fails the check of the image, too, before any of it runs that may arm.
        let _ = bus_faults::ignored(|| {
            for word in 0..words(code, &raw mut _itcm_end) {
                code.add(word).write_volatile(from.add(word).read_volatile());
            }
        });
        for word in 0..words(data, &raw mut _dtcm_end) {
            data.add(word).write_volatile(0);
        }
    }
    // What is fetched from now on is what was written.
    asm::dsb();
    asm::isb();
}
