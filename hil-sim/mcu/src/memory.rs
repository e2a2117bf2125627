//! Memories of the chip: RAM and flash, in host memory that a [`Core`](crate::cpu::Core) accesses by pointer.
//!
//! Contents are cells behind a shared reference: the core, DMA models, the flash model and debuggers all access them,
//! one at a time (the emulator has one thread). Values are little-endian, as the processor's.
//!
//! A [`Region`] states which accesses the core may make by itself. All others go to [`Chip::read`](crate::Chip::read)
//! and [`Chip::write`](crate::Chip::write): stores to flash, any access to the part of flash that is modelled access by
//! access or to words with an error of their ECC, and any access to a memory without clock or to a bank that programs
//! or erases.

use std::cell::{Cell, RefCell};
use std::fmt;
use std::ops::Range;
use std::rc::Rc;

use crate::peripheral::Size;

/// Memory bank, after RM0399 2.3 (memory map) and 2.4 (embedded SRAM).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Bank {
    /// Instruction TCM, which only the core and MDMA reach.
    Itcm,
    /// Flash, the lower megabyte: bank 1, sectors 0 to 7, unless banks are swapped.
    Flash1,
    /// Flash, the lower half of the upper megabyte: bank 2, sectors 0 to 3.
    Flash2,
    /// Flash, the upper half of the upper megabyte: bank 2, sectors 4 to 7, where every access goes to the chip
    /// ([`Memory::kept`]). With swapped banks these are bank 1's, as all its others.
    Storage,
    /// Data TCM, which only the core and MDMA reach.
    Dtcm,
    /// AXI SRAM in domain 1.
    Axi,
    /// SRAM1 in domain 2.
    Sram1,
    /// SRAM2 in domain 2.
    Sram2,
    /// SRAM3 in domain 2.
    Sram3,
    /// SRAM4 in domain 3.
    Sram4,
    /// Backup SRAM in domain 3.
    Backup,
}

impl fmt::Display for Bank {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Itcm => "ITCM",
            Self::Flash1 => "the flash's lower megabyte",
            Self::Flash2 | Self::Storage => "the flash's upper megabyte",
            Self::Dtcm => "DTCM",
            Self::Axi => "AXI SRAM",
            Self::Sram1 => "SRAM1",
            Self::Sram2 => "SRAM2",
            Self::Sram3 => "SRAM3",
            Self::Sram4 => "SRAM4",
            Self::Backup => "backup SRAM",
        })
    }
}

impl Bank {
    /// All banks in order of address.
    pub const ALL: [Self; 11] = [
        Self::Itcm,
        Self::Flash1,
        Self::Flash2,
        Self::Storage,
        Self::Dtcm,
        Self::Axi,
        Self::Sram1,
        Self::Sram2,
        Self::Sram3,
        Self::Sram4,
        Self::Backup,
    ];

    /// Returns the first address and the length, bytes.
    #[must_use]
    pub const fn span(self) -> (u32, u32) {
        const K: u32 = 1024;
        match self {
            Self::Itcm => (0x0000_0000, 64 * K),
            Self::Flash1 => (0x0800_0000, 1024 * K),
            Self::Flash2 => (0x0810_0000, 512 * K),
            Self::Storage => (0x0818_0000, 512 * K),
            Self::Dtcm => (0x2000_0000, 128 * K),
            Self::Axi => (0x2400_0000, 512 * K),
            Self::Sram1 => (0x3000_0000, 128 * K),
            Self::Sram2 => (0x3002_0000, 128 * K),
            Self::Sram3 => (0x3004_0000, 32 * K),
            Self::Sram4 => (0x3800_0000, 64 * K),
            Self::Backup => (0x3880_0000, 4 * K),
        }
    }

    /// Returns true for flash, which is erased to ones; the other banks start with [`Memory::POWER_ON`].
    #[must_use]
    pub const fn is_flash(self) -> bool {
        matches!(self, Self::Flash1 | Self::Flash2 | Self::Storage)
    }

    /// Returns true for a bank that DMA1, DMA2 and BDMA reach (RM0399 2.1, the bus matrix): all but the TCMs. BDMA
    /// reaches domain 3 only.
    #[must_use]
    pub const fn on_bus(self) -> bool {
        !matches!(self, Self::Itcm | Self::Dtcm)
    }
}

/// Address after the last memory; peripherals follow.
const END: u32 = {
    let (base, len) = Bank::Backup.span();
    base + len
};

/// Accesses that the core may make to a memory by itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Direct {
    /// Loads of data, without the chip.
    pub read: bool,
    /// Stores of data, without the chip.
    pub write: bool,
    /// Fetches of instructions, without the chip.
    pub execute: bool,
}

/// Size of the blocks in which decoded code is tracked, as a power of 2, bytes.
const CODE_BITS: u32 = 10;

/// Memory bank with its contents and present restrictions.
#[derive(Clone, Debug)]
pub struct Region {
    /// Bank of the region.
    pub bank: Bank,
    /// First address of the region.
    pub base: u32,
    bytes: Rc<[Cell<u8>]>,
    enabled: Cell<bool>,
    /// The contents are outside this type: every access goes to the chip.
    kept: Cell<bool>,
    /// Addresses that are never accessed directly, in ascending order.
    holes: RefCell<Vec<Range<u32>>>,
    /// Marks of 1 KiB blocks from which a core has decoded instructions.
    code: Rc<[Cell<bool>]>,
}

impl Region {
    /// Returns the length, bytes.
    #[must_use]
    pub fn len(&self) -> u32 {
        self.bytes.len() as u32
    }

    /// Returns false for every bank, because none is empty.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.bytes.is_empty()
    }

    /// The contents, shared: a core that maps them keeps the reference.
    #[must_use]
    pub fn bytes(&self) -> &Rc<[Cell<u8>]> {
        &self.bytes
    }

    /// Returns the accesses that the core may make by itself at present: none while the memory's clock is off.
    #[must_use]
    pub fn direct(&self) -> Direct {
        let on = self.enabled.get() && !self.kept.get();
        Direct { read: on, write: on && !self.bank.is_flash(), execute: on }
    }

    /// Returns true if some of these bytes must not be accessed directly, whatever [`Region::direct`] allows: flash
    /// words that do not hold what was programmed.
    #[must_use]
    pub fn has_hole(&self, address: u32, bytes: u32) -> bool {
        let end = address.saturating_add(bytes);
        self.holes.borrow().iter().any(|hole| hole.start < end && address < hole.end)
    }

    /// Marks that a core has decoded code at an address: later changes there increment [`Memory::code_version`].
    pub fn mark_code(&self, address: u32) {
        if let Some(mark) = self.code.get((address.wrapping_sub(self.base) >> CODE_BITS) as usize) {
            mark.set(true);
        }
    }

    /// Clears the marks, after a core has dropped its decoded instructions.
    pub fn forget_code(&self) {
        self.code.iter().for_each(|mark| mark.set(false));
    }

    fn holds_code(&self, offset: usize, bytes: usize) -> bool {
        let last = (offset + bytes.saturating_sub(1)) >> CODE_BITS;
        self.code.get(offset >> CODE_BITS..=last).is_some_and(|marks| marks.iter().any(Cell::get))
    }
}

/// All memories of the chip.
#[derive(Clone, Debug)]
pub struct Memory {
    regions: Vec<Region>,
    mapping: Cell<u32>,
    code: Cell<u32>,
}

impl Default for Memory {
    fn default() -> Self {
        Self::new()
    }
}

impl Memory {
    /// Content of RAM at power-on: not zero, so that missing initialisation is noticed, and an address that faults when
    /// it is used as a pointer.
    pub const POWER_ON: u32 = 0xDEAD_0BAD;

    /// Makes erased flash and RAM filled with [`Memory::POWER_ON`]; every memory is enabled.
    #[must_use]
    pub fn new() -> Self {
        let region = |bank: Bank| {
            let (base, len) = bank.span();
            let fill = if bank.is_flash() { [0xFF; 4] } else { Self::POWER_ON.to_le_bytes() };
            let bytes = fill.into_iter().cycle().take(len as usize).map(Cell::new).collect();
            let code = (0..len >> CODE_BITS).map(|_| Cell::new(false)).collect();
            let kept = Cell::new(bank == Bank::Storage);
            Region { bank, base, bytes, enabled: Cell::new(true), kept, holes: RefCell::default(), code }
        };
        Self { regions: Bank::ALL.into_iter().map(region).collect(), mapping: Cell::new(0), code: Cell::new(0) }
    }

    /// Returns all memories in order of address.
    #[must_use]
    pub fn regions(&self) -> &[Region] {
        &self.regions
    }

    /// Returns the memory of a bank.
    #[must_use]
    pub fn region(&self, bank: Bank) -> &Region {
        // The index is valid, because discriminants are positions in `Bank::ALL`, the order in which the regions were
        // made.
        &self.regions[bank as usize]
    }

    /// Returns the memory that holds an address, and the offset in it.
    #[must_use]
    pub fn locate(&self, address: u32) -> Option<(&Region, u32)> {
        // Peripheral addresses need no search.
        if address >= END {
            return None;
        }
        let after = self.regions.partition_point(|region| region.base <= address);
        let region = self.regions.get(after.checked_sub(1)?)?;
        let offset = address - region.base;
        (offset < region.len()).then_some((region, offset))
    }

    /// Enables or disables a memory, as its clock does (RM0399: SRAM1 to 3 of domain 2 and the backup SRAM have enable
    /// bits). Its contents stay.
    pub fn set_enabled(&self, bank: Bank, on: bool) {
        if self.region(bank).enabled.replace(on) != on {
            self.mapping.set(self.mapping.get().wrapping_add(1));
        }
    }

    /// Sets the bytes of a memory that are never accessed directly, in order of address.
    pub fn set_holes(&self, bank: Bank, holes: Vec<Range<u32>>) {
        let before = self.region(bank).holes.replace(holes);
        if before != *self.region(bank).holes.borrow() {
            self.mapping.set(self.mapping.get().wrapping_add(1));
        }
    }

    /// Returns the addresses of bank 2's sectors 4 to 7. Their cells are elsewhere: every access goes to the chip,
    /// which models errors of their ECC, and nothing is executed there. With swapped banks they are in the lower
    /// megabyte, and the code that swaps them makes them a hole.
    #[must_use]
    pub fn kept(&self) -> Range<u32> {
        let (base, len) = Bank::Storage.span();
        let moved = if self.region(Bank::Storage).kept.get() { 0 } else { Bank::Flash1.span().1 };
        base - moved..base - moved + len
    }

    /// Exchanges the contents of the flash's two megabytes, after the banks have swapped their addresses (RM0399,
    /// 4.3.13).
    pub fn swap_flash(&self) {
        let [lower, middle, upper] = [Bank::Flash1, Bank::Flash2, Bank::Storage].map(|bank| self.region(bank));
        // The cores have mapped the regions by address, so the contents move and the regions stay.
        for (low, high) in lower.bytes.iter().zip(middle.bytes.iter().chain(upper.bytes.iter())) {
            low.swap(high);
        }
        upper.kept.set(!upper.kept.get());
        self.mapping.set(self.mapping.get().wrapping_add(1));
        self.code_changed();
    }

    /// Notes a change of code made without this type's functions.
    pub fn code_changed(&self) {
        self.code.set(self.code.get().wrapping_add(1));
    }

    /// Returns true while the memory's clock is on.
    #[must_use]
    pub fn is_enabled(&self, bank: Bank) -> bool {
        self.region(bank).enabled.get()
    }

    /// Returns a version number that changes with [`Region::direct`] of any region.
    #[must_use]
    pub fn mapping_version(&self) -> u32 {
        self.mapping.get()
    }

    /// Returns a version number that changes when this type's functions write instructions that a core has decoded.
    #[must_use]
    pub fn code_version(&self) -> u32 {
        self.code.get()
    }

    /// Fills RAM and backup SRAM as after a loss of power.
    pub fn lose_power(&self) {
        for region in self.regions.iter().filter(|region| !region.bank.is_flash()) {
            for (cell, byte) in region.bytes.iter().zip(Self::POWER_ON.to_le_bytes().into_iter().cycle()) {
                cell.set(byte);
            }
        }
        self.code_changed();
    }

    /// Reads a value, whatever the clocks; `None` where no memory holds all of it.
    #[must_use]
    pub fn read(&self, address: u32, size: Size) -> Option<u32> {
        let mut value = [0; 4];
        self.read_slice(address, &mut value[..size.bytes() as usize])?;
        Some(u32::from_le_bytes(value))
    }

    /// Writes a value; `None` where no memory holds all of it.
    pub fn write(&self, address: u32, size: Size, value: u32) -> Option<()> {
        self.write_slice(address, &value.to_le_bytes()[..size.bytes() as usize])
    }

    /// Reads bytes of one memory; `None`, with nothing read, where it does not hold all of them.
    pub fn read_slice(&self, address: u32, into: &mut [u8]) -> Option<()> {
        let cells = self.cells(address, into.len())?.1;
        into.iter_mut().zip(cells).for_each(|(byte, cell)| *byte = cell.get());
        Some(())
    }

    /// Writes bytes of one memory, including flash (for the flash model and loaders); `None`, with nothing written,
    /// where it does not hold all of them.
    pub fn write_slice(&self, address: u32, bytes: &[u8]) -> Option<()> {
        let (region, cells) = self.cells(address, bytes.len())?;
        cells.iter().zip(bytes).for_each(|(cell, byte)| cell.set(*byte));
        if region.holds_code((address - region.base) as usize, bytes.len()) {
            self.code_changed();
        }
        Some(())
    }

    fn cells(&self, address: u32, len: usize) -> Option<(&Region, &[Cell<u8>])> {
        let (region, offset) = self.locate(address)?;
        let start = offset as usize;
        Some((region, region.bytes.get(start..start.checked_add(len)?)?))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn banks_are_in_order_of_address_and_do_not_overlap() {
        let memory = Memory::new();
        for (index, pair) in memory.regions().windows(2).enumerate() {
            assert!(pair[0].base + pair[0].len() <= pair[1].base);
            assert_eq!(pair[0].bank as usize, index);
        }
        for bank in Bank::ALL {
            assert_eq!(memory.region(bank).bank, bank);
        }
    }

    #[test]
    fn values_are_little_endian_and_do_not_leave_a_memory() {
        let memory = Memory::new();
        memory.write(0x2000_0000, Size::Word, 0x1122_3344).unwrap();
        assert_eq!(memory.read(0x2000_0000, Size::Byte), Some(0x44));
        assert_eq!(memory.read(0x2000_0001, Size::Half), Some(0x2233));
        assert_eq!(memory.read(0x2001_FFFF, Size::Byte), Some(Memory::POWER_ON >> 24));
        assert_eq!(memory.read(0x2001_FFFE, Size::Word), None);
        assert_eq!(memory.read(0x2002_0000, Size::Byte), None);
        // SRAM1 and SRAM2 are adjacent, but separate memories: each has its own clock.
        assert_eq!(memory.read(0x3001_FFFE, Size::Word), None);
        assert_eq!(memory.write(0x4000_0000, Size::Word, 0), None);
        assert_eq!(memory.locate(0xFFFF_FFFF).map(|(region, _)| region.bank), None);
    }

    #[test]
    fn a_memory_without_clock_keeps_its_contents_and_is_not_direct() {
        let memory = Memory::new();
        memory.write(0x3000_0010, Size::Word, 7).unwrap();
        let before = memory.mapping_version();
        memory.set_enabled(Bank::Sram1, false);
        assert_ne!(memory.mapping_version(), before);
        let off = Direct { read: false, write: false, execute: false };
        assert_eq!(memory.region(Bank::Sram1).direct(), off);
        assert_eq!(memory.region(Bank::Sram2).direct(), Direct { read: true, write: true, execute: true });
        assert_eq!(memory.read(0x3000_0010, Size::Word), Some(7));
        let unchanged = memory.mapping_version();
        memory.set_enabled(Bank::Sram1, false);
        assert_eq!(memory.mapping_version(), unchanged);
    }

    #[test]
    fn swapped_flash_has_its_kept_sectors_in_the_lower_megabyte() {
        let memory = Memory::new();
        for (address, value) in [(0x0800_0000, 1), (0x080F_FFFC, 2), (0x0810_0000, 3), (0x0817_FFFC, 4)] {
            memory.write(address, Size::Word, value).unwrap();
        }
        let before = (memory.mapping_version(), memory.code_version());
        let read = |address| memory.read(address, Size::Word);
        memory.swap_flash();
        assert_ne!((memory.mapping_version(), memory.code_version()), before);
        assert_eq!([0x0810_0000, 0x081F_FFFC, 0x0800_0000, 0x0807_FFFC].map(read), [1, 2, 3, 4].map(Some));
        assert_eq!(memory.kept(), 0x0808_0000..0x0810_0000);
        assert!(memory.region(Bank::Storage).direct().execute);
        memory.swap_flash();
        assert_eq!((read(0x080F_FFFC), memory.kept()), (Some(2), 0x0818_0000..0x0820_0000));
        assert!(!memory.region(Bank::Storage).direct().read);
    }

    #[test]
    fn only_writes_of_code_count_as_such() {
        let memory = Memory::new();
        let before = memory.code_version();
        memory.region(Bank::Axi).mark_code(0x2400_07FE);
        memory.write(0x2400_0000, Size::Word, 0).unwrap();
        memory.write(0x2400_0800, Size::Word, 0).unwrap();
        memory.write(0x0800_0400, Size::Word, 0).unwrap();
        assert_eq!(memory.code_version(), before);
        memory.write_slice(0x2400_03F0, &[0; 32]).unwrap();
        assert_ne!(memory.code_version(), before);
        let before = memory.code_version();
        memory.region(Bank::Axi).forget_code();
        memory.write(0x2400_0400, Size::Word, 0).unwrap();
        assert_eq!(memory.code_version(), before);
    }

    #[test]
    fn a_hole_is_told_by_any_byte_of_it() {
        let memory = Memory::new();
        let before = memory.mapping_version();
        memory.set_holes(Bank::Flash1, vec![0x0800_0020..0x0800_0030, 0x0800_0030..0x0800_0040]);
        assert_ne!(memory.mapping_version(), before);
        let flash = memory.region(Bank::Flash1);
        assert!(!flash.has_hole(0x0800_001C, 4) && flash.has_hole(0x0800_001E, 4));
        assert!(flash.has_hole(0x0800_003F, 1) && !flash.has_hole(0x0800_0040, 4));
    }
}
