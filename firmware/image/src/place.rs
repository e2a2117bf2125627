//! Where images lie, and what is expected of them there.

use std::{ffi::OsString, path::Path};

use crate::{Binary, ImageError};

/// As probe-rs lists it: `probe-rs chip list`. Its file of the family is probe-rs/targets/STM32H7_Series.yaml.
pub const CHIP: &str = "STM32H747XIHx";
/// The Giga in the Arduino bootloader (ArduinoCore-mbed, boards.txt).
pub const DFU_DEVICE: &str = "2341:0366";
/// The same as numbers: vendor and product.
pub const DFU_USB: (u16, u16) = (0x2341, 0x0366);
/// Bank 1 ends here; the bootloader starts nothing that goes on (mcuboot-arduino-stm32h7, app/main.cpp), and parameters and trips
/// follow.
const END: u32 = 0x0810_0000;
/// Top bytes of an initial stack pointer by which the bootloader knows a program (the same file): RAM.
const STACK_IN: [u8; 4] = [0x20, 0x24, 0x30, 0x38];

/// Where an image is started from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// The beginning of flash, where the processor starts.
    Bare,
    /// Behind the Arduino bootloader, which starts it.
    Hosted,
}

impl Place {
    /// The address of the vector table. Hosted: where the bootloader looks (mcuboot-arduino-stm32h7, app/main.cpp).
    #[must_use]
    pub const fn start(self) -> u32 {
        match self {
            Self::Bare => 0x0800_0000,
            Self::Hosted => 0x0804_0000,
        }
    }

    /// As the images' files are called.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Bare => "bare",
            Self::Hosted => "hosted",
        }
    }

    /// Where an image is for, if it would be started there.
    ///
    /// # Errors
    /// [`ImageError::Elsewhere`], [`ImageError::NoStack`], [`ImageError::NoEntry`].
    pub fn of(binary: &Binary) -> Result<Self, ImageError> {
        let (start, end) = (binary.start, binary.end());
        let place = [Self::Bare, Self::Hosted].into_iter().find(|place| place.start() == start);
        let (Some(place), true) = (place, end <= END.into()) else {
            return Err(ImageError::Elsewhere { start, end });
        };
        // Stack pointer and reset vector (ARMv7-M ARM, B1.5.3); the vector's lowest bit says Thumb.
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

/// The program and the words that write a raw file of a hosted image, and start it.
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
