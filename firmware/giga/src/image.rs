//! Record and robot's configuration of the image, which the program that makes it fills in (see
//! [`r4_protocol::image`]), and the check of the record against the contents of flash.
//!
//! The check is done at each start, right after outputs are safe and before anything else is set up, by the chip's CRC unit: 0.46
//! million bytes at 20 instructions per 32 bytes are 0.3 million. Only the start runs before it: the vector table,
//! `main`, the sweep.

use core::ptr;

use embassy_stm32::pac::{
    CRC, RCC,
    crc::{
        regs::Cr,
        vals::{RevIn, RevOut},
    },
};
use r4_protocol::image::{CRC_AT, ImageInfo, MAGIC, RECORD_AT, RECORD_BYTES, ROBOT_BYTES};

use crate::bus_faults;

/// Number of 32-bit words in a flash word.
const WORDS: usize = RECORD_BYTES / 4;
/// Value of a word in erased flash.
const ERASED: u32 = u32::MAX;
/// Size of bank 1, which limits a plausible length of the image.
const LARGEST: usize = 0x10_0000;

/// Record of the image; `cargo xtask firmware` fills in the fields that are unknown before linking.
#[allow(unsafe_code, reason = "a section is chosen by an unsafe attribute")]
// SAFETY: the section is in flash and may hold any data.
#[unsafe(link_section = ".r4_image")]
#[used]
static RECORD: [u32; WORDS] = {
    let mut record = [ERASED; WORDS];
    record[0] = u32::from_le_bytes(MAGIC);
    record
};

/// Configuration of a robot on this carrier, as `build.rs` packed it; `cargo xtask firmware` writes that of the image's robot over it.
#[allow(unsafe_code, reason = "a section is chosen by an unsafe attribute")]
// SAFETY: the section is in flash and may hold any data.
#[unsafe(link_section = ".r4_robot")]
#[used]
static LINKED_ROBOT: [u8; ROBOT_BYTES] = *include_bytes!(concat!(env!("OUT_DIR"), "/config.postcard"));

/// Returns the configuration of the image's robot, in postcard's format, with trailing bytes.
pub(crate) fn robot() -> &'static [u8] {
    #[allow(unsafe_code, reason = "a symbol of the linker's")]
    // SAFETY: `memory.x` puts it at the start of the section that holds `LINKED_ROBOT`. By that name the compiler would know the contents before
    // they were replaced.
    unsafe extern "C" {
        safe static __r4_robot: [u8; ROBOT_BYTES];
    }
    &__r4_robot
}

/// Description of the image, and the result of its check.
#[derive(Clone, Copy)]
pub(crate) struct Image {
    pub(crate) info: ImageInfo,
    /// True if the contents of flash agree with the record.
    pub(crate) whole: bool,
}

/// Compares the image with its record.
pub(crate) fn check() -> Image {
    #[allow(unsafe_code, reason = "a symbol of the linker's")]
    // SAFETY: only the address of the symbol is used.
    unsafe extern "C" {
        safe static __vector_table: [u32; WORDS];
    }
    let start: *const [u32; WORDS] = &raw const __vector_table;
    let read = |word: usize| {
        #[allow(unsafe_code, reason = "flash is read by its address")]
        // SAFETY: aligned, and within bank 1, which can be read whatever is programmed into it: LARGEST.
        unsafe {
            start.wrapping_add(word).read_volatile()
        }
    };
    // Volatile: the compiler knows only the contents before they were filled in.
    let [_, bytes, crc, ..] = read(RECORD_AT / RECORD_BYTES);
    let info = ImageInfo { hosted: env!("R4_IMAGE_KIND") == "hosted", bytes, crc };
    let length = bytes as usize;
    let room = LARGEST - (start.addr() & (LARGEST - 1));
    if !length.is_multiple_of(RECORD_BYTES) || length <= RECORD_AT || length > room {
        return Image { info, whole: false };
    }
    // A word that a power cut left half programmed fails its error correction, and answers with a bus error.
    let (found, faults) = bus_faults::ignored(|| {
        begin();
        for word in 0..length / RECORD_BYTES {
            let mut words = read(word);
            if word == RECORD_AT / RECORD_BYTES {
                words[CRC_AT % RECORD_BYTES / 4] = ERASED;
            }
            for word in words {
                CRC.dr32().write_value(word);
            }
        }
        !CRC.dr32().read()
    });
    Image {
        info,
        whole: found == crc && !faults && ptr::eq(&raw const RECORD, start.wrapping_add(RECORD_AT / RECORD_BYTES)),
    }
}

/// Enables the CRC unit for CRC-32/ISO-HDLC (RM0399, 22.3.3): polynomial and initial value are those of its reset.
fn begin() {
    RCC.ahb4enr().modify(|w| w.set_crcen(true));
    // The clock runs two cycles later (RM0399, 9.5.10).
    let _ = RCC.ahb4enr().read();
    RCC.ahb4rstr().modify(|w| w.set_crcrst(true));
    RCC.ahb4rstr().modify(|w| w.set_crcrst(false));
    CRC.cr().write_value({
        let mut control = Cr::default();
        control.set_rev_in(RevIn::WORD);
        control.set_rev_out(RevOut::REVERSED);
        control.set_reset(true);
        control
    });
}
