//! From addresses to bytes: what the core accesses by itself.

use std::cell::Cell;
use std::rc::Rc;

use r4_mcu::Region;
use r4_mcu::cpu::CoreError;

/// Memories at most; a power of two, so that an index needs no check.
const REGIONS: usize = 16;

/// One memory; the first is none, of no bytes.
struct Mapped {
    base: u32,
    bytes: Rc<[Cell<u8>]>,
    /// The program may store to it.
    writable: bool,
}

/// The address space in pieces of 64 KiB, each of one memory at most: which one, for loads, stores and fetches. Zero is
/// none: the bus is asked.
pub(crate) struct Memory {
    mapped: [Mapped; REGIONS],
    loads: Box<[u8; 1 << 16]>,
    stores: Box<[u8; 1 << 16]>,
    fetches: Box<[u8; 1 << 16]>,
}

fn nowhere() -> Box<[u8; 1 << 16]> {
    Box::new([0; 1 << 16])
}

impl Memory {
    pub(crate) fn new() -> Self {
        let none = || Mapped { base: 0, bytes: Rc::new([]), writable: false };
        Self { mapped: std::array::from_fn(|_| none()), loads: nowhere(), stores: nowhere(), fetches: nowhere() }
    }

    /// Maps memories, in place of those before.
    ///
    /// # Errors
    /// More than there is room for, or two within 64 KiB.
    pub(crate) fn map(&mut self, regions: &[Region]) -> Result<(), CoreError> {
        *self = Self::new();
        if regions.len() >= REGIONS {
            return Err(CoreError(format!("{} memories", regions.len())));
        }
        for ((number, mapped), region) in (0_u8..).zip(&mut self.mapped).skip(1).zip(regions) {
            if region.base & 0xFFFF != 0 || region.is_empty() {
                return Err(CoreError(format!("{:?} does not begin at a multiple of 64 KiB", region.bank)));
            }
            let direct = region.direct();
            *mapped = Mapped { base: region.base, bytes: Rc::clone(region.bytes()), writable: direct.write };
            let first = region.base >> 16;
            for piece in first..=first + ((region.len() - 1) >> 16) {
                let piece = (piece & 0xFFFF) as usize;
                for (allowed, table) in [
                    (direct.read, &mut self.loads),
                    // Where there can be code, stores are looked at.
                    (direct.write && !direct.execute, &mut self.stores),
                    (direct.execute, &mut self.fetches),
                ] {
                    if allowed {
                        table[piece] = number;
                    }
                }
            }
        }
        Ok(())
    }

    #[inline(always)]
    fn bytes(&self, table: &[u8; 1 << 16], address: u32) -> (&[Cell<u8>], usize) {
        let mapped = &self.mapped[usize::from(table[(address >> 16) as usize]) % REGIONS];
        (&mapped.bytes, address.wrapping_sub(mapped.base) as usize)
    }

    /// Bytes that a load reaches directly.
    #[inline(always)]
    pub(crate) fn load<const BYTES: usize>(&self, address: u32) -> Option<[u8; BYTES]> {
        let (bytes, offset) = self.bytes(&self.loads, address);
        let cells: &[Cell<u8>; BYTES] = bytes.get(offset..offset + BYTES)?.first_chunk()?;
        Some(std::array::from_fn(|index| cells[index].get()))
    }

    /// Stores directly; `None` where that is not allowed.
    #[inline(always)]
    pub(crate) fn store<const BYTES: usize>(&self, address: u32, value: [u8; BYTES]) -> Option<()> {
        let (bytes, offset) = self.bytes(&self.stores, address);
        let cells: &[Cell<u8>; BYTES] = bytes.get(offset..offset + BYTES)?.first_chunk()?;
        for (cell, byte) in cells.iter().zip(value) {
            cell.set(byte);
        }
        Some(())
    }

    /// Words that loads reach directly.
    #[inline(always)]
    pub(crate) fn load_words(&self, address: u32, words: usize) -> Option<&[Cell<u8>]> {
        let (bytes, offset) = self.bytes(&self.loads, address);
        bytes.get(offset..offset + 4 * words)
    }

    /// Words that stores reach directly.
    #[inline(always)]
    pub(crate) fn store_words(&self, address: u32, words: usize) -> Option<&[Cell<u8>]> {
        let (bytes, offset) = self.bytes(&self.stores, address);
        bytes.get(offset..offset + 4 * words)
    }

    /// Stores where code may be; `None` elsewhere.
    pub(crate) fn store_code(&self, address: u32, value: &[u8]) -> Option<()> {
        let (bytes, offset) = self.bytes(&self.fetches, address);
        let cells = bytes.get(offset..offset + value.len()).filter(|_| self.is_changeable_code(address))?;
        cells.iter().zip(value).for_each(|(cell, byte)| cell.set(*byte));
        Some(())
    }

    /// Code that the program may change.
    pub(crate) fn is_changeable_code(&self, address: u32) -> bool {
        self.mapped[usize::from(self.fetches[(address >> 16) as usize]) % REGIONS].writable
    }

    /// A halfword of code.
    pub(crate) fn fetch(&self, address: u32) -> Option<u16> {
        let (bytes, offset) = self.bytes(&self.fetches, address);
        let [low, high] = bytes.get(offset..offset + 2)?.first_chunk()?;
        Some(u16::from_le_bytes([low.get(), high.get()]))
    }
}
