//! Start addresses of images, and the requirements for an image there.

use std::{ffi::OsString, path::Path};

use crate::{Binary, ImageError};

/// Name of the chip in probe-rs: `probe-rs chip list`. Its file of the family is probe-rs/targets/STM32H7_Series.yaml.
pub const CHIP: &str = "STM32H747XIHx";
/// USB identity of the Giga in the Arduino bootloader (ArduinoCore-mbed, boards.txt).
pub const DFU_DEVICE: &str = "2341:0366";
/// The same identity as numbers: vendor and product.
pub const DFU_USB: (u16, u16) = (0x2341, 0x0366);
/// End of bank 1: the bootloader starts no image beyond it (mcuboot-arduino-stm32h7, app/main.cpp), and parameters and
/// trips follow.
const END: u32 = 0x0810_0000;
/// Top bytes of an initial stack pointer that the bootloader accepts (the same file): RAM.
const STACK_IN: [u8; 4] = [0x20, 0x24, 0x30, 0x38];

/// Place from which an image is started.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// Beginning of flash, where the processor starts.
    Bare,
    /// Behind the Arduino bootloader, which starts the image.
    Hosted,
}

impl Place {
    /// Address of the vector table. For hosted images it is fixed by the bootloader (mcuboot-arduino-stm32h7,
    /// app/main.cpp).
    #[must_use]
    pub const fn start(self) -> u32 {
        match self {
            Self::Bare => 0x0800_0000,
            Self::Hosted => 0x0804_0000,
        }
    }

    /// Name in the images' file names.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Bare => "bare",
            Self::Hosted => "hosted",
        }
    }

    /// Returns the place that an image is for, if it would be started there.
    ///
    /// # Errors
    /// [`ImageError::Elsewhere`] for other addresses, [`ImageError::NoStack`] or [`ImageError::NoEntry`] for an invalid
    /// vector table.
    pub fn of(binary: &Binary) -> Result<Self, ImageError> {
        let (start, end) = (binary.start, binary.end());
        let place = [Self::Bare, Self::Hosted].into_iter().find(|place| place.start() == start);
        let (Some(place), true) = (place, end <= END.into()) else {
            return Err(ImageError::Elsewhere { start, end });
        };
        // Stack pointer and reset vector (ARMv7-M ARM, B1.5.3); the vector's lowest bit selects Thumb.
        let (stack, entry) = (binary.word(0).unwrap_or(0), binary.word(4).unwrap_or(0));
        if !STACK_IN.contains(&stack.to_be_bytes()[0]) {
            return Err(ImageError::NoStack { word: stack });
        }
        if entry & 1 == 0 || entry < start || u64::from(entry) >= end {
            return Err(ImageError::NoEntry { word: entry });
        }
        Ok(place)
    }
}

/// Command line of the program that writes a raw file of a hosted image, and starts it.
#[must_use]
pub fn dfu_util(raw: &Path) -> Vec<OsString> {
    let place = format!("{:#010x}:leave", Place::Hosted.start());
    let words = ["dfu-util", "-d", DFU_DEVICE, "-a", "0", "-s", &place, "-D"];
    words.into_iter().map(OsString::from).chain([raw.into()]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn binary(start: u32, stack: u32, entry: u32, length: usize) -> Binary {
        let mut bytes = [stack.to_le_bytes(), entry.to_le_bytes()].concat();
        bytes.resize(length, 0);
        Binary { start, bytes }
    }

    #[test]
    fn images_are_told_by_where_they_begin() {
        assert_eq!(Place::of(&binary(0x0800_0000, 0x2401_0000, 0x0800_0041, 128)), Ok(Place::Bare));
        let all_of_bank_1 = binary(0x0804_0000, 0x2401_0000, 0x0804_0041, 0xC_0000);
        assert_eq!(Place::of(&all_of_bank_1), Ok(Place::Hosted));
    }

    #[test]
    fn what_would_not_start_is_refused() {
        let elsewhere = |start, end| ImageError::Elsewhere { start, end };
        for (file, why) in [
            (binary(0x0804_0000, 0x2401_0000, 0x0804_0041, 0xC_0020), elsewhere(0x0804_0000, 0x0810_0020)),
            (binary(0x0808_0000, 0x2401_0000, 0x0808_0041, 128), elsewhere(0x0808_0000, 0x0808_0080)),
            (binary(0x0804_0000, 0x1001_0000, 0x0804_0041, 128), ImageError::NoStack { word: 0x1001_0000 }),
            (binary(0x0800_0000, 0x2401_0000, 0x0800_0040, 128), ImageError::NoEntry { word: 0x0800_0040 }),
            (binary(0x0804_0000, 0x2401_0000, 0x0800_0041, 128), ImageError::NoEntry { word: 0x0800_0041 }),
            (binary(0x0800_0000, 0x2401_0000, 0x0800_0081, 128), ImageError::NoEntry { word: 0x0800_0081 }),
        ] {
            assert_eq!(Place::of(&file), Err(why));
        }
    }
}
