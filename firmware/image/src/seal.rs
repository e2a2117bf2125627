//! Record that shows that an image is complete: its length and CRC, in the layout of [`r4_protocol::image`].

use r4_protocol::image::{CRC_AT, MAGIC, RECORD_AT, RECORD_BYTES};

use crate::{Binary, ImageError};

/// Contents of an image's record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Seal {
    /// Length of the image, bytes.
    pub bytes: u32,
    /// CRC-32 of the image.
    pub crc: u32,
}

impl Seal {
    /// Reads the record of an image and checks it against the image's bytes.
    ///
    /// # Errors
    /// [`ImageError::NoRecord`] if there is none, [`ImageError::Damaged`] if length or CRC differ.
    pub fn of(binary: &Binary) -> Result<Self, ImageError> {
        let no_record = ImageError::NoRecord { address: binary.start.wrapping_add(RECORD_AT as u32) };
        let found = Self::due(binary).ok_or(no_record)?;
        let says = Self { bytes: binary.word(LENGTH_AT).ok_or(no_record)?, crc: binary.word(CRC_AT).ok_or(no_record)? };
        if says == found {
            return Ok(says);
        }
        Err(ImageError::Damaged { bytes: says.bytes, crc: says.crc, found_bytes: found.bytes, found: found.crc })
    }

    /// Record that these bytes, with their length, must have; `None` where there is no record.
    fn due(binary: &Binary) -> Option<Self> {
        if binary.bytes.get(RECORD_AT..)?.get(..MAGIC.len())? != MAGIC {
            return None;
        }
        let mut hasher = crc32fast::Hasher::new();
        hasher.update(binary.bytes.get(..CRC_AT)?);
        // The CRC's own bytes count as erased, as they are linked.
        hasher.update(&[0xFF; 4]);
        hasher.update(binary.bytes.get(CRC_AT + 4..)?);
        Some(Self { bytes: u32::try_from(binary.bytes.len()).ok()?, crc: hasher.finalize() })
    }
}

const LENGTH_AT: usize = RECORD_AT + MAGIC.len();

/// Fills in the record of an image's bytes.
///
/// # Errors
/// [`ImageError::NoRecord`] if they have no place for it.
pub fn seal(binary: &mut Binary) -> Result<Seal, ImageError> {
    let no_record = ImageError::NoRecord { address: binary.start.wrapping_add(RECORD_AT as u32) };
    // The length is covered by the CRC, so it is written first.
    let length = u32::try_from(binary.bytes.len()).map_err(|_| no_record)?;
    binary.bytes.get_mut(LENGTH_AT..LENGTH_AT + 4).ok_or(no_record)?.copy_from_slice(&length.to_le_bytes());
    let seal = Seal::due(binary).ok_or(no_record)?;
    binary.bytes.get_mut(CRC_AT..CRC_AT + 4).ok_or(no_record)?.copy_from_slice(&seal.crc.to_le_bytes());
    Ok(seal)
}

/// Fills in the record of an ELF file that was just linked.
///
/// # Errors
/// [`ImageError::NoRecord`] if the firmware has no place for it, and those of [`Binary::of`].
pub fn seal_elf(elf: &mut [u8]) -> Result<Seal, ImageError> {
    let mut binary = Binary::of(elf)?;
    let seal = seal(&mut binary)?;
    let address = binary.start.wrapping_add(RECORD_AT as u32);
    let record = Binary::offset_in(elf, address).and_then(|at| elf.get_mut(at..)?.get_mut(..RECORD_BYTES));
    record.ok_or(ImageError::NoRecord { address })?.copy_from_slice(&binary.bytes[RECORD_AT..RECORD_AT + RECORD_BYTES]);
    Ok(seal)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::binary::tests::elf;

    const BYTES: usize = 1216;

    /// ELF file with one segment of 1200 bytes at 0x0804_0000; the record as it is linked.
    fn linked() -> Vec<u8> {
        let content: Vec<u8> = (0..1200).map(|byte| (byte % 251) as u8).collect();
        let mut elf = elf(&[(1, 0x0804_0000, &content)]);
        elf[84 + RECORD_AT..][..32].fill(0xFF);
        elf[84 + RECORD_AT..][..4].copy_from_slice(b"R4im");
        elf
    }

    #[test]
    fn a_sealed_image_is_whole_and_sealing_again_changes_nothing() {
        let mut elf = linked();
        let sealed = seal_elf(&mut elf).expect("it has a record");
        // Computed independently, in Python: zlib.crc32(content[:0x3E8] + b"\xff" * 4 + content[0x3EC:] + b"\xff" *
        // 16).
        assert_eq!(sealed, Seal { bytes: BYTES as u32, crc: 0x193E_870B });
        assert_eq!(Seal::of(&Binary::of(&elf).expect("good")), Ok(sealed));
        let before = elf.clone();
        assert_eq!(seal_elf(&mut elf), Ok(sealed));
        assert_eq!(elf, before);
    }

    #[test]
    fn one_wrong_bit_anywhere_is_found() {
        let mut elf = linked();
        seal_elf(&mut elf).expect("it has a record");
        let whole = Binary::of(&elf).expect("good");
        for bit in 0..8 * BYTES {
            let mut wrong = whole.clone();
            wrong.bytes[bit / 8] ^= 1 << (bit % 8);
            assert!(Seal::of(&wrong).is_err(), "bit {bit}");
        }
    }

    #[test]
    fn an_image_that_is_cut_or_was_never_sealed_is_refused() {
        let mut elf = linked();
        let never = Seal::of(&Binary::of(&elf).expect("good"));
        assert!(matches!(never, Err(ImageError::Damaged { bytes: u32::MAX, .. })), "{never:?}");
        seal_elf(&mut elf).expect("it has a record");
        let mut cut = Binary::of(&elf).expect("good");
        for length in (0..BYTES).step_by(32).rev() {
            cut.bytes.truncate(length);
            let refused = Seal::of(&cut).expect_err("it is cut");
            let no_record = matches!(refused, ImageError::NoRecord { address: 0x0804_03E0 });
            assert_eq!(no_record, length <= RECORD_AT, "{length}: {refused}");
        }
        let mut other = linked();
        other[84 + RECORD_AT] = b'r';
        assert_eq!(seal_elf(&mut other), Err(ImageError::NoRecord { address: 0x0804_03E0 }));
    }
}
