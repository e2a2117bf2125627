//! Raw flash image out of an ELF file, for tools that do not read ELF.

use crate::ImageError;

/// Value of erased flash; nothing is programmed between segments.
const ERASED: u8 = 0xFF;
/// Size of a flash word of the STM32H7, the unit of programming (RM0399, 4.3.8), bytes.
const WORD: usize = 32;
/// Largest image, bytes: the size of the processor's flash, so that a damaged file cannot ask for gigabytes.
const LARGEST: usize = 2 * 1024 * 1024;

/// Flash image without gaps.
#[derive(Clone, Debug, PartialEq)]
pub struct Binary {
    /// Address of the first byte.
    pub start: u32,
    /// Bytes of the image, padded to whole flash words.
    pub bytes: Vec<u8>,
}

impl Binary {
    /// Builds the image from the segments that are loaded, at the addresses they are loaded to (System V ABI, chapter
    /// 5). Data with an initial value is where start-up copies it from, not where the program sees it.
    ///
    /// # Errors
    /// [`ImageError::NoElf`] for another kind of file, [`ImageError::Empty`] without a loaded segment,
    /// [`ImageError::Apart`] for segments further apart than flash is large, [`ImageError::Overlap`] for overlapping
    /// ones.
    pub fn of(elf: &[u8]) -> Result<Self, ImageError> {
        let mut segments = segments(elf).ok_or(ImageError::NoElf)?;
        // In the file they are ordered by virtual address (System V ABI, chapter 5), not by the physical one.
        segments.sort_by_key(|segment| segment.address);
        let (Some(first), Some(last)) = (segments.first(), segments.last()) else {
            return Err(ImageError::Empty);
        };
        let start = first.address;
        let length = (last.address - start) as usize + last.bytes.len();
        if length > LARGEST {
            return Err(ImageError::Apart { bytes: length });
        }
        let mut bytes = vec![ERASED; length.next_multiple_of(WORD)];
        let mut free = 0;
        for Segment { address, bytes: content, .. } in segments {
            let from = (address - start) as usize;
            if from < free {
                return Err(ImageError::Overlap { address });
            }
            free = from + content.len();
            bytes[from..free].copy_from_slice(content);
        }
        Ok(Self { start, bytes })
    }

    /// Offset in an ELF file of the byte that is loaded to `address`; `None` if no segment has it.
    pub(crate) fn offset_in(elf: &[u8], address: u32) -> Option<usize> {
        segments(elf)?.into_iter().find_map(|segment| {
            let within = address.checked_sub(segment.address)? as usize;
            (within < segment.bytes.len()).then_some(segment.offset + within)
        })
    }

    /// Address behind the last byte.
    #[must_use]
    pub fn end(&self) -> u64 {
        u64::from(self.start) + self.bytes.len() as u64
    }

    /// Word at offset `at`, bytes from the start; `None` behind the end.
    #[must_use]
    pub fn word(&self, at: usize) -> Option<u32> {
        self.bytes.get(at..at.checked_add(4)?).map(|word| u32::from_le_bytes([word[0], word[1], word[2], word[3]]))
    }
}

struct Segment<'e> {
    /// Offset of the first byte from the beginning of the file.
    offset: usize,
    address: u32,
    bytes: &'e [u8],
}

/// Loaded segments that have content; `None` if it is not a little-endian ELF file of 32 bits.
fn segments(elf: &[u8]) -> Option<Vec<Segment<'_>>> {
    const LOAD: u32 = 1;
    // Offsets in a damaged file can have any value.
    let word = |at: usize| Some(u32::from_le_bytes(elf.get(at..at.checked_add(4)?)?.try_into().ok()?));
    let half = |at: usize| Some(usize::from(u16::from_le_bytes(elf.get(at..at + 2)?.try_into().ok()?)));
    if elf.get(..6)? != b"\x7fELF\x01\x01" {
        return None;
    }
    let (table, entry, count) = (word(0x1C)? as usize, half(0x2A)?, half(0x2C)?);
    let mut segments = Vec::new();
    for header in (0..count).map(|index| table + index * entry) {
        let (kind, offset, address, size) = (word(header)?, word(header + 4)?, word(header + 12)?, word(header + 16)?);
        if kind == LOAD && size > 0 {
            let offset = offset as usize;
            segments.push(Segment { offset, address, bytes: elf.get(offset..offset.checked_add(size as usize)?)? });
        }
    }
    Some(segments)
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// ELF file with these segments: kind, physical address, content. Virtual addresses are elsewhere.
    pub(crate) fn elf(segments: &[(u32, u32, &[u8])]) -> Vec<u8> {
        let mut elf = vec![0; 52];
        elf[..6].copy_from_slice(b"\x7fELF\x01\x01");
        elf[0x1C] = 52;
        elf[0x2A] = 32;
        elf[0x2C] = segments.len() as u8;
        let mut offset = 52 + 32 * segments.len() as u32;
        for (kind, address, content) in segments {
            let size = content.len() as u32;
            for value in [*kind, offset, 0x2400_0000, *address, size, size, 0, 4] {
                elf.extend(value.to_le_bytes());
            }
            offset += size;
        }
        segments.iter().for_each(|(_, _, content)| elf.extend(*content));
        elf
    }

    #[test]
    fn segments_are_put_where_they_are_loaded_and_gaps_stay_erased() {
        // Out of order; the stack's segment has no content, the last one is not loaded.
        let file =
            elf(&[(1, 0x0804_0006, &[5, 6]), (1, 0x0804_0000, &[1, 2, 3, 0x24]), (1, 0x2400_0000, &[]), (4, 7, &[9])]);
        let mut expected = vec![0xFF; 32];
        expected[..8].copy_from_slice(&[1, 2, 3, 0x24, 0xFF, 0xFF, 5, 6]);
        let binary = Binary::of(&file).expect("good");
        assert_eq!(binary, Binary { start: 0x0804_0000, bytes: expected });
        assert_eq!((binary.word(0), binary.word(4), binary.word(30)), (Some(0x2403_0201), Some(0x0605_FFFF), None));
    }

    #[test]
    fn what_cannot_be_flashed_is_refused() {
        for (file, why) in [
            (elf(&[]), "nothing"),
            (elf(&[(1, 0x0800_0000, &[1; 8]), (1, 0x0800_0004, &[2; 8])]), "overlap at 0x08000004"),
            (elf(&[(1, 0x0800_0000, &[1]), (1, 0x2400_0000, &[2])]), "apart"),
            (elf(&[(1, 0x0800_0000, &[1; 8])])[..90].to_vec(), "cut off"),
            (b"\x7fELF\x02\x01".to_vec(), "32 bits"),
        ] {
            let problem = Binary::of(&file).expect_err(why).to_string();
            assert!(problem.contains(why), "{problem}");
        }
    }
}
