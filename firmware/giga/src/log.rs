//! The log: all that defmt writes goes into one ring, which debug probes read by RTT and hosts over their links. Neither is ever
//! waited for.

use core::{
    cell::UnsafeCell,
    sync::atomic::{AtomicBool, AtomicU8, AtomicU32, Ordering},
};

use critical_section::RestoreState;
use r4_firmware::log::{Log, Ring, SIZE};
use r4_protocol::log::{IMAGE_BYTES, fingerprint};

static RING: Ring = Ring::new();

/// What hosts are given.
pub(crate) fn for_hosts() -> Log {
    #[allow(unsafe_code, reason = "a symbol of the linker's")]
    // SAFETY: the linker script of cortex-m-rt puts as many words there, in flash.
    unsafe extern "C" {
        safe static __vector_table: [u8; IMAGE_BYTES];
    }
    Log { ring: &RING, image: fingerprint(&__vector_table) }
}

/// RTT's control block, as probes look for it by its symbol or its first bytes: SEGGER, "RTT", section "RTT Control Block".
#[repr(C)]
struct ControlBlock {
    identification: [u8; 16],
    channels_up: u32,
    channels_down: u32,
    name: *const u8,
    buffer: *const AtomicU8,
    size: u32,
    /// Next place that is written.
    write: AtomicU32,
    /// Next place that the probe reads: the probe's own.
    read: AtomicU32,
    /// 0 and 1 do not wait for the probe. One that asks for that is not heard.
    mode: AtomicU32,
}

#[allow(unsafe_code, reason = "shared memory with a debug probe")]
// SAFETY: what changes is atomic, and the pointers lead to statics.
unsafe impl Sync for ControlBlock {}

#[allow(unsafe_code, reason = "probes look for this name")]
// SAFETY: nothing else has it: defmt-rtt, which would, is not linked.
#[unsafe(no_mangle)]
static _SEGGER_RTT: ControlBlock = ControlBlock {
    identification: *b"SEGGER RTT\0\0\0\0\0\0",
    channels_up: 1,
    channels_down: 0,
    name: c"defmt".as_ptr().cast(),
    buffer: RING.place(),
    size: SIZE as u32,
    write: AtomicU32::new(0),
    read: AtomicU32::new(0),
    mode: AtomicU32::new(1),
};

fn put(bytes: &[u8]) {
    RING.push(bytes);
    _SEGGER_RTT.write.store(RING.written() % SIZE as u32, Ordering::Release);
}

/// Of a record that is being written. Whoever writes one has `TAKEN` and is in a critical section.
struct Writing(UnsafeCell<(defmt::Encoder, RestoreState)>);

#[allow(unsafe_code, reason = "guarded by hand: defmt begins and ends a record by two calls")]
// SAFETY: used between `acquire` and `release` only, where nothing else runs.
unsafe impl Sync for Writing {}

static WRITING: Writing = Writing(UnsafeCell::new((defmt::Encoder::new(), RestoreState::invalid())));
static TAKEN: AtomicBool = AtomicBool::new(false);

#[defmt::global_logger]
struct Logger;

#[allow(unsafe_code, reason = "the trait's")]
// SAFETY: a critical section lasts from `acquire` to `release`, so no two records mix.
unsafe impl defmt::Logger for Logger {
    fn acquire() {
        // SAFETY: `release` ends it with what this returned.
        let before = unsafe { critical_section::acquire() };
        // A record that is written in the middle of another one.
        if TAKEN.swap(true, Ordering::Relaxed) {
            panic!("a log line within a log line");
        }
        // SAFETY: in the critical section, and taken.
        let (encoder, restore) = unsafe { &mut *WRITING.0.get() };
        *restore = before;
        encoder.start_frame(put);
    }

    unsafe fn flush() {}

    unsafe fn release() {
        // SAFETY: defmt calls this after `acquire`, in whose critical section it still is.
        let (encoder, restore) = unsafe { &mut *WRITING.0.get() };
        encoder.end_frame(put);
        let before = *restore;
        TAKEN.store(false, Ordering::Relaxed);
        // SAFETY: the one that `acquire` began.
        unsafe { critical_section::release(before) };
    }

    unsafe fn write(bytes: &[u8]) {
        // SAFETY: as in `release`.
        let (encoder, _) = unsafe { &mut *WRITING.0.get() };
        encoder.write(bytes, put);
    }
}
