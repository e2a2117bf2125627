//! Results: a block of memory, and text to a debugger.

use core::arch::asm;
use core::ptr::{addr_of, addr_of_mut};

const MAX: usize = 256;

/// Result of one check.
#[repr(C)]
#[derive(Clone, Copy)]
pub(crate) struct Entry {
    name: *const u8,
    name_len: u32,
    got: u32,
    expected: u32,
}

/// Results of all checks so far.
#[repr(C)]
pub(crate) struct Block {
    /// Magic number "R4PB" once all checks are done.
    magic: u32,
    checks: u32,
    failed: u32,
    entries: [Entry; MAX],
}

const NOTHING: Entry = Entry { name: core::ptr::null(), name_len: 0, got: 0, expected: 0 };

/// Block of memory with the results.
#[unsafe(no_mangle)]
pub(crate) static mut R4_PROBE: Block = Block { magic: 0, checks: 0, failed: 0, entries: [NOTHING; MAX] };

/// Records a check. Only for the main program: handlers store their observations in variables.
pub(crate) fn check(name: &'static str, got: u32, expected: u32) {
    let entry = Entry { name: name.as_ptr(), name_len: name.len() as u32, got, expected };
    // SAFETY: no handler accesses the block, and there is only one main program.
    unsafe {
        let block = addr_of_mut!(R4_PROBE);
        let index = addr_of!((*block).checks).read_volatile() as usize;
        assert!(index < MAX);
        addr_of_mut!((*block).entries[index]).write_volatile(entry);
        addr_of_mut!((*block).checks).write_volatile(index as u32 + 1);
        if got != expected {
            (*block).failed += 1;
        }
    }
    text(name);
    text(" ");
    hex(got);
    if got != expected {
        text(" FAILED, expected ");
        hex(expected);
    }
    text("\n");
}

fn hex(value: u32) {
    let digits =
        core::array::from_fn::<u8, 8, _>(|index| b"0123456789abcdef"[(value >> (28 - 4 * index) & 15) as usize]);
    text(core::str::from_utf8(&digits).unwrap_or("?"));
}

/// Writes text by SYS_WRITE0, in pieces, since the text has no terminator.
pub(crate) fn text(text: &str) {
    for chunk in text.as_bytes().chunks(63) {
        let mut piece = [0; 64];
        piece[..chunk.len()].copy_from_slice(chunk);
        semihost(4, piece.as_ptr() as u32);
    }
}

/// Ends the program by SYS_EXIT, with ADP_Stopped_ApplicationExit when no check failed.
pub(crate) fn finish() -> ! {
    // SAFETY: as in `check`.
    let failed = unsafe {
        addr_of_mut!(R4_PROBE.magic).write_volatile(u32::from_le_bytes(*b"R4PB"));
        addr_of!(R4_PROBE.failed).read_volatile()
    };
    text(if failed == 0 { "all checks passed\n" } else { "some checks failed\n" });
    semihost(0x18, if failed == 0 { 0x2_0026 } else { 0x2_0023 });
    loop {
        core::hint::spin_loop();
    }
}

/// Calls Arm semihosting: the operation in R0, its argument in R1.
fn semihost(operation: u32, argument: u32) {
    // SAFETY: a debugger reads memory that lives through the call.
    unsafe { asm!("bkpt #0xAB", inout("r0") operation => _, in("r1") argument) }
}
