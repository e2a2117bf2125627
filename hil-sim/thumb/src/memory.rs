//! From addresses to bytes: what the core accesses by itself.

use std::cell::{Cell, RefCell};
use std::rc::Rc;

use r4_mcu::Region;
use r4_mcu::cpu::{CoreError, Protection, Purpose};

/// Memories at most; a power of two, so that an index needs no check.
const REGIONS: usize = 16;

/// One memory; the first is none, of no bytes.
struct Mapped {
    base: u32,
    bytes: Rc<[Cell<u8>]>,
    /// The program may store to it.
    writable: bool,
}

/// Bytes of a page, as a power of 2. Small, so that a guard below a stack makes little of what is around it slow; no list of
/// registers is longer than a page.
const PAGE_BITS: u32 = 10;
const PAGES: usize = 1 << (32 - PAGE_BITS);

type Table = Box<[u8; PAGES]>;

/// The address space in pages, each of one memory at most: which one, for loads, stores and fetches. Zero is none: the bus is
/// asked.
pub(crate) struct Memory {
    mapped: [Mapped; REGIONS],
    loads: Table,
    /// Without pages from which instructions were decoded, and those before them: there stores are looked at.
    stores: Box<[Cell<u8>; PAGES]>,
    fetches: Table,
    /// Pages that are missing in `stores` for that reason, with what was there.
    decoded: RefCell<Vec<(usize, u8)>>,
    /// What is mapped.
    regions: Vec<Region>,
    protection: Option<Protection>,
}

fn nowhere<T: Clone>(zero: T) -> Box<[T; PAGES]> {
    // Zeroed by the system, page by page as they are used: most never are.
    match vec![zero.clone(); PAGES].into_boxed_slice().try_into() {
        Ok(table) => table,
        Err(_) => Box::new(std::array::from_fn(|_| zero.clone())),
    }
}

#[inline(always)]
fn page(address: u32) -> usize {
    (address >> PAGE_BITS) as usize
}

impl Memory {
    pub(crate) fn new() -> Self {
        let none = || Mapped { base: 0, bytes: Rc::new([]), writable: false };
        Self {
            mapped: std::array::from_fn(|_| none()),
            loads: nowhere(0),
            stores: nowhere(Cell::new(0)),
            fetches: nowhere(0),
            decoded: RefCell::default(),
            regions: Vec::new(),
            protection: None,
        }
    }

    /// What may be accessed from now on.
    ///
    /// # Errors
    /// As [`Memory::map`].
    pub(crate) fn protect(&mut self, protection: Option<Protection>) -> Result<(), CoreError> {
        self.protection = protection;
        let regions = self.regions.clone();
        self.map(&regions)
    }

    /// Maps memories, in place of those before.
    ///
    /// # Errors
    /// More than there is room for, or two within 64 KiB.
    pub(crate) fn map(&mut self, regions: &[Region]) -> Result<(), CoreError> {
        for region in std::mem::replace(&mut self.regions, regions.to_vec()) {
            let pages = page(region.base)..=page(region.base + (region.len() - 1));
            self.loads[pages.clone()].fill(0);
            self.fetches[pages.clone()].fill(0);
            self.stores[pages].iter().for_each(|entry| entry.set(0));
            region.forget_code();
        }
        self.decoded.get_mut().clear();
        if regions.len() >= REGIONS {
            return Err(CoreError(format!("{} memories", regions.len())));
        }
        for ((number, mapped), region) in (0_u8..).zip(&mut self.mapped).skip(1).zip(regions) {
            if (region.base | region.len()) & ((1 << PAGE_BITS) - 1) != 0 || region.is_empty() {
                return Err(CoreError(format!("{} does not begin and end with a page", region.bank)));
            }
            let direct = region.direct();
            *mapped = Mapped { base: region.base, bytes: Rc::clone(region.bytes()), writable: direct.write };
            for piece in page(region.base)..=page(region.base + (region.len() - 1)) {
                let address = (piece as u32) << PAGE_BITS;
                // An access that begins in this page may end in the next.
                let both = [address, address.wrapping_add(1 << PAGE_BITS)];
                let whole = !region.has_hole(address, 2 << PAGE_BITS);
                let free = |purpose| {
                    let allows = |protection: &Protection| {
                        let mut pages = both.iter();
                        pages.all(|page| protection.is_uniform(*page, PAGE_BITS) && protection.allows(*page, purpose))
                    };
                    whole && self.protection.as_ref().is_none_or(allows)
                };
                if direct.read && free(Purpose::Load) {
                    self.loads[piece] = number;
                }
                if direct.write && free(Purpose::Store) {
                    self.stores[piece].set(number);
                }
                // Each instruction is looked at, once.
                if direct.execute {
                    self.fetches[piece] = number;
                }
            }
        }
        Ok(())
    }

    #[inline(always)]
    fn bytes(&self, number: u8, address: u32) -> (&[Cell<u8>], usize) {
        let mapped = &self.mapped[usize::from(number) % REGIONS];
        (&mapped.bytes, address.wrapping_sub(mapped.base) as usize)
    }

    /// Bytes that a load reaches directly.
    #[inline(always)]
    pub(crate) fn load<const BYTES: usize>(&self, address: u32) -> Option<[u8; BYTES]> {
        let (bytes, offset) = self.bytes(self.loads[page(address)], address);
        let cells: &[Cell<u8>; BYTES] = bytes.get(offset..offset + BYTES)?.first_chunk()?;
        Some(std::array::from_fn(|index| cells[index].get()))
    }

    /// Stores directly; `None` where that is not allowed.
    #[inline(always)]
    pub(crate) fn store<const BYTES: usize>(&self, address: u32, value: [u8; BYTES]) -> Option<()> {
        let (bytes, offset) = self.bytes(self.stores[page(address)].get(), address);
        let cells: &[Cell<u8>; BYTES] = bytes.get(offset..offset + BYTES)?.first_chunk()?;
        for (cell, byte) in cells.iter().zip(value) {
            cell.set(byte);
        }
        Some(())
    }

    /// Words that loads reach directly.
    #[inline(always)]
    pub(crate) fn load_words(&self, address: u32, words: usize) -> Option<&[Cell<u8>]> {
        let (bytes, offset) = self.bytes(self.loads[page(address)], address);
        bytes.get(offset..offset + 4 * words)
    }

    /// Words that stores reach directly.
    #[inline(always)]
    pub(crate) fn store_words(&self, address: u32, words: usize) -> Option<&[Cell<u8>]> {
        let (bytes, offset) = self.bytes(self.stores[page(address)].get(), address);
        bytes.get(offset..offset + 4 * words)
    }

    /// Stores where code may be; `None` elsewhere. `true` where some was decoded.
    pub(crate) fn store_code(&self, address: u32, value: &[u8]) -> Option<bool> {
        let (bytes, offset) = self.bytes(self.fetches[page(address)], address);
        let cells = bytes.get(offset..offset + value.len()).filter(|_| self.is_changeable_code(address))?;
        let refuses =
            |protection: &Protection| protection.refuses(address, value.len() as u32, Purpose::Store).is_some();
        if self.protection.as_ref().is_some_and(refuses) {
            // The bus says what comes of it.
            return None;
        }
        cells.iter().zip(value).for_each(|(cell, byte)| cell.set(*byte));
        let last = page(address.wrapping_add(value.len() as u32 - 1));
        Some(self.decoded.borrow().iter().any(|(decoded, _)| (page(address)..=last).contains(decoded)))
    }

    /// Code that the program may change.
    pub(crate) fn is_changeable_code(&self, address: u32) -> bool {
        self.mapped[usize::from(self.fetches[page(address)]) % REGIONS].writable
    }

    /// A halfword of code, which is decoded.
    pub(crate) fn fetch(&self, address: u32) -> Option<u16> {
        let number = self.fetches[page(address)];
        let (bytes, offset) = self.bytes(number, address);
        let [low, high] = bytes.get(offset..offset + 2)?.first_chunk()?;
        if self.protection.as_ref().is_some_and(|protection| !protection.allows(address, Purpose::Fetch)) {
            return None;
        }
        let region = self.regions.get(usize::from(number).checked_sub(1)?)?;
        if region.has_hole(address, 2) {
            return None;
        }
        region.mark_code(address);
        if self.is_changeable_code(address) {
            let mut decoded = self.decoded.borrow_mut();
            // A store that begins in the page before may reach this one.
            for page in page(address).saturating_sub(1)..=page(address) {
                let before = self.stores[page].take();
                if before != 0 {
                    decoded.push((page, before));
                }
            }
        }
        Some(u16::from_le_bytes([low.get(), high.get()]))
    }

    /// Nothing that was decoded is used any more.
    pub(crate) fn forget_code(&self) {
        for (page, number) in self.decoded.take() {
            self.stores[page].set(number);
        }
        self.regions.iter().for_each(Region::forget_code);
    }
}
