//! Address translation for the memory that the core accesses directly.

use std::cell::{Cell, RefCell};
use std::rc::Rc;

use r4_mcu::Region;
use r4_mcu::cpu::{CoreError, Protection, Purpose};

/// Capacity for memories; a power of two, so that an index needs no check.
const REGIONS: usize = 16;

/// Mapped memory; the first entry has no bytes and means none.
struct Mapped {
    base: u32,
    bytes: Rc<[Cell<u8>]>,
    /// Stores by the program are allowed.
    writable: bool,
}

/// Page size as a power of 2, bytes. Small, so that a guard below a stack slows down little of its neighbourhood; no
/// list of registers is longer than a page.
const PAGE_BITS: u32 = 10;
const PAGES: usize = 1 << (32 - PAGE_BITS);

type Table = Box<[u8; PAGES]>;

/// Address space in pages. Each table has the number of the page's memory, for loads, stores and fetches; 0 means none:
/// the access goes to the bus.
pub(crate) struct Memory {
    mapped: [Mapped; REGIONS],
    loads: Table,
    /// Table for stores. Pages with decoded instructions, and the pages before them, are left out, so that stores there
    /// are checked.
    stores: Box<[Cell<u8>; PAGES]>,
    fetches: Table,
    /// Pages left out of `stores` for that reason, with their entries.
    decoded: RefCell<Vec<(usize, u8)>>,
    /// Memory regions mapped at present.
    regions: Vec<Region>,
    protection: Option<Protection>,
}

fn nowhere<T: Clone>(zero: T) -> Box<[T; PAGES]> {
    // The operating system zeroes the pages of the table on first use; most are never used.
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

    /// Sets the memory protection from now on.
    ///
    /// # Errors
    /// Those of [`Memory::map`].
    pub(crate) fn protect(&mut self, protection: Option<Protection>) -> Result<(), CoreError> {
        self.protection = protection;
        let regions = self.regions.clone();
        self.map(&regions)
    }

    /// Maps memories in place of the previous ones.
    ///
    /// # Errors
    /// Too many memories, or one that does not begin and end at a page.
    pub(crate) fn map(&mut self, regions: &[Region]) -> Result<(), CoreError> {
        // The old memories are unmapped first: the new ones may lie elsewhere.
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
        // Number 0 is skipped: it means no memory.
        for ((number, mapped), region) in (0_u8..).zip(&mut self.mapped).skip(1).zip(regions) {
            if (region.base | region.len()) & ((1 << PAGE_BITS) - 1) != 0 || region.is_empty() {
                return Err(CoreError(format!("{} does not begin and end with a page", region.bank)));
            }
            let direct = region.direct();
            *mapped = Mapped { base: region.base, bytes: Rc::clone(region.bytes()), writable: direct.write };
            for piece in page(region.base)..=page(region.base + (region.len() - 1)) {
                let address = (piece as u32) << PAGE_BITS;
                // An access that begins in this page may end in the next one.
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
                // Fetches need no second page: each instruction is checked once, when it is decoded.
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

    /// Loads directly; `None` where that is not possible.
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

    /// Returns words for direct loads; `None` where that is not possible.
    #[inline(always)]
    pub(crate) fn load_words(&self, address: u32, words: usize) -> Option<&[Cell<u8>]> {
        let (bytes, offset) = self.bytes(self.loads[page(address)], address);
        bytes.get(offset..offset + 4 * words)
    }

    /// Returns words for direct stores; `None` where that is not allowed.
    #[inline(always)]
    pub(crate) fn store_words(&self, address: u32, words: usize) -> Option<&[Cell<u8>]> {
        let (bytes, offset) = self.bytes(self.stores[page(address)].get(), address);
        bytes.get(offset..offset + 4 * words)
    }

    /// Stores to changeable code; `None` elsewhere. Returns `true` if decoded code is affected.
    pub(crate) fn store_code(&self, address: u32, value: &[u8]) -> Option<bool> {
        let (bytes, offset) = self.bytes(self.fetches[page(address)], address);
        let cells = bytes.get(offset..offset + value.len()).filter(|_| self.is_changeable_code(address))?;
        // With protection a store may be refused although the memory is writable.
        let refuses =
            |protection: &Protection| protection.refuses(address, value.len() as u32, Purpose::Store).is_some();
        if self.protection.as_ref().is_some_and(refuses) {
            // The bus raises the fault of a refused store.
            return None;
        }
        cells.iter().zip(value).for_each(|(cell, byte)| cell.set(*byte));
        let last = page(address.wrapping_add(value.len() as u32 - 1));
        Some(self.decoded.borrow().iter().any(|(decoded, _)| (page(address)..=last).contains(decoded)))
    }

    /// Returns true for code that the program may change.
    pub(crate) fn is_changeable_code(&self, address: u32) -> bool {
        self.mapped[usize::from(self.fetches[page(address)]) % REGIONS].writable
    }

    /// Fetches a halfword of code for decoding; from now on stores to its page are checked.
    pub(crate) fn fetch(&self, address: u32) -> Option<u16> {
        let number = self.fetches[page(address)];
        let (bytes, offset) = self.bytes(number, address);
        let [low, high] = bytes.get(offset..offset + 2)?.first_chunk()?;
        if self.protection.as_ref().is_some_and(|protection| !protection.allows(address, Purpose::Fetch)) {
            return None;
        }
        // Words with an ECC error are holes: a fetch from them fails, and the machine raises the fault.
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

    /// Restores the store tables after all decoded code was dropped.
    pub(crate) fn forget_code(&self) {
        for (page, number) in self.decoded.take() {
            self.stores[page].set(number);
        }
        self.regions.iter().for_each(Region::forget_code);
    }
}
