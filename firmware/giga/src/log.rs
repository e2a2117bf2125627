//! Log of the firmware: everything that defmt writes goes into one ring, which debug probes read by RTT and hosts over
//! their links. The firmware waits for neither.

use core::{
    cell::UnsafeCell,
    sync::atomic::{AtomicBool, AtomicU8, AtomicU32, Ordering},
};

use critical_section::RestoreState;
use r4_firmware::log::{Log, Ring, SIZE};
use r4_protocol::log::{IMAGE_BYTES, fingerprint};

static RING: Ring = Ring::new();

/// Log for hosts, with the image's fingerprint.
pub(crate) fn for_hosts() -> Log {
    #[allow(unsafe_code, reason = "a symbol of the linker's")]
    // SAFETY: the linker script of cortex-m-rt places that many bytes there, in flash.
    unsafe extern "C" {
        safe static __vector_table: [u8; IMAGE_BYTES];
    }
    Log { ring: &RING, image: fingerprint(&__vector_table) }
}

/// Control block of RTT, which probes find by its symbol or its first bytes: SEGGER, "RTT", section "RTT Control
/// Block".
#[repr(C)]
struct ControlBlock {
    identification: [u8; 16],
    channels_up: u32,
    channels_down: u32,
    name: *const u8,
    buffer: *const AtomicU8,
    size: u32,
    /// Index of the next byte to be written.
    write: AtomicU32,
    /// Index of the next byte that the probe reads; written by the probe.
    read: AtomicU32,
    /// Mode of the channel. 0 and 1 do not wait for the probe; a request by the probe to wait is ignored.
    mode: AtomicU32,
}

#[allow(unsafe_code, reason = "shared memory with a debug probe")]
// SAFETY: mutable fields are atomic, and the pointers lead to statics.
unsafe impl Sync for ControlBlock {}

#[allow(unsafe_code, reason = "probes look for this name")]
// SAFETY: no other symbol has this name: defmt-rtt, which would define it, is not linked.
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

/// State of the record being written. The writer holds `TAKEN` and is in a critical section.
struct Writing(UnsafeCell<(defmt::Encoder, RestoreState)>);

#[allow(unsafe_code, reason = "guarded by hand: defmt begins and ends a record by two calls")]
// SAFETY: used between `acquire` and `release` only, where nothing else runs.
unsafe impl Sync for Writing {}

static WRITING: Writing = Writing(UnsafeCell::new((defmt::Encoder::new(), RestoreState::invalid())));
static TAKEN: AtomicBool = AtomicBool::new(false);

#[defmt::global_logger]
struct Logger;

#[allow(unsafe_code, reason = "the trait's")]
// SAFETY: a critical section lasts from `acquire` to `release`, so records do not mix.
unsafe impl defmt::Logger for Logger {
    fn acquire() {
        // SAFETY: `release` ends it with the state returned here.
        let before = unsafe { critical_section::acquire() };
        // A log line inside another one.
        if TAKEN.swap(true, Ordering::Relaxed) {
            panic!("a log line within a log line");
        }
        // SAFETY: in the critical section, and `TAKEN` is held.
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
        // SAFETY: this ends the critical section that `acquire` began.
        unsafe { critical_section::release(before) };
    }

    unsafe fn write(bytes: &[u8]) {
        // SAFETY: as in `release`.
        let (encoder, _) = unsafe { &mut *WRITING.0.get() };
        encoder.write(bytes, put);
    }
}
