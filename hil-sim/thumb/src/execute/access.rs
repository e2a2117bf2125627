//! Memory accesses, direct or by the bus.

use std::cell::Cell;

use r4_mcu::Size;
use r4_mcu::cpu::{Access, CoreBus, Fault, NoResult};

use super::Context;
use crate::float::Transfer;
use crate::operation::{COUNT, LOADED, Width};
use crate::state::{FLOAT_ACTIVE, State};

fn word(cells: &[Cell<u8>; 4]) -> u32 {
    u32::from_le_bytes([cells[0].get(), cells[1].get(), cells[2].get(), cells[3].get()])
}

fn set_word(cells: &[Cell<u8>; 4], value: u32) {
    for (cell, byte) in cells.iter().zip(value.to_le_bytes()) {
        cell.set(byte);
    }
}

impl State {
    fn access(&self, address: u32, size: Size, index: usize, context: &Context<'_>) -> Access {
        let instructions = self.executed + u64::from(context.position(index).instruction);
        Access { address, size, pc: context.pc(index), instructions }
    }

    /// Handles the consequences of a bus access: a changed memory map, and new limits.
    fn accessed(&mut self, bus: &mut dyn CoreBus) {
        if let Some(regions) = bus.remapped() {
            if let Err(error) = self.memory.map(regions) {
                self.error = Some(error);
            }
            self.stale = true;
        }
        self.refresh_limits(bus);
    }

    /// Loads by the bus, where direct access is impossible; `None` stops the instruction.
    #[cold]
    #[inline(never)]
    pub(super) fn load_by_bus(
        &mut self,
        address: u32,
        size: Size,
        index: usize,
        context: &Context<'_>,
        bus: &mut dyn CoreBus,
    ) -> Option<u32> {
        let access = self.access(address, size, index, context);
        let result = bus.read(&access);
        self.accessed(bus);
        result.ok()
    }

    /// Stores by the bus, where direct access is impossible, or to code.
    #[cold]
    #[inline(never)]
    pub(super) fn store_by_bus(
        &mut self,
        address: u32,
        size: Size,
        value: u32,
        index: usize,
        context: &Context<'_>,
        bus: &mut dyn CoreBus,
    ) -> Result<(), Fault> {
        let bytes = size.bytes() as usize;
        // Pages with decoded code are not in the table of direct stores, so their stores arrive here.
        if let Some(decoded) = self.memory.store_code(address, &value.to_le_bytes()[..bytes]) {
            if decoded {
                self.set_stale();
            }
            return Ok(());
        }
        let access = self.access(address, size, index, context);
        // The bus expects only the bits of the access; a register has 32.
        let value = if bytes == 4 { value } else { value & ((1 << (8 * bytes)) - 1) };
        let result = bus.write(&access, value);
        self.accessed(bus);
        result.map_err(|NoResult| Fault::Store)
    }

    pub(super) fn load_byte(
        &mut self,
        address: u32,
        index: usize,
        context: &Context<'_>,
        bus: &mut dyn CoreBus,
    ) -> Option<u32> {
        match self.memory.load::<1>(address) {
            Some([byte]) => Some(byte.into()),
            None => self.load_by_bus(address, Size::Byte, index, context, bus),
        }
    }

    pub(super) fn load_half(
        &mut self,
        address: u32,
        index: usize,
        context: &Context<'_>,
        bus: &mut dyn CoreBus,
    ) -> Option<u32> {
        match self.memory.load::<2>(address) {
            Some(bytes) => Some(u16::from_le_bytes(bytes).into()),
            None => self.load_by_bus(address, Size::Half, index, context, bus),
        }
    }

    /// Loads words, one by one where direct access is impossible.
    #[inline(always)]
    pub(super) fn load_words(
        &mut self,
        address: u32,
        words: &mut [u32],
        index: usize,
        context: &Context<'_>,
        bus: &mut dyn CoreBus,
    ) -> Result<(), Fault> {
        if address & 3 != 0 {
            return Err(Fault::Unaligned);
        }
        if let Some(cells) = self.memory.load_words(address, words.len()) {
            for (value, cells) in words.iter_mut().zip(cells.as_chunks().0) {
                *value = word(cells);
            }
            return Ok(());
        }
        self.load_words_by_bus(address, words, index, context, bus)
    }

    #[cold]
    #[inline(never)]
    fn load_words_by_bus(
        &mut self,
        address: u32,
        words: &mut [u32],
        index: usize,
        context: &Context<'_>,
        bus: &mut dyn CoreBus,
    ) -> Result<(), Fault> {
        for (offset, value) in (0..).step_by(4).zip(words) {
            let address = address.wrapping_add(offset);
            *value = match self.memory.load::<4>(address) {
                Some(bytes) => u32::from_le_bytes(bytes),
                None => self.load_by_bus(address, Size::Word, index, context, bus).ok_or(Fault::Load)?,
            };
        }
        Ok(())
    }

    /// Stores words, one by one where direct access is impossible.
    #[inline(always)]
    pub(super) fn store_words(
        &mut self,
        address: u32,
        words: &[u32],
        index: usize,
        context: &Context<'_>,
        bus: &mut dyn CoreBus,
    ) -> Result<(), Fault> {
        if address & 3 != 0 {
            return Err(Fault::Unaligned);
        }
        if let Some(cells) = self.memory.store_words(address, words.len()) {
            for (value, cells) in words.iter().zip(cells.as_chunks().0) {
                set_word(cells, *value);
            }
            return Ok(());
        }
        self.store_words_by_bus(address, words, index, context, bus)
    }

    #[cold]
    #[inline(never)]
    fn store_words_by_bus(
        &mut self,
        address: u32,
        words: &[u32],
        index: usize,
        context: &Context<'_>,
        bus: &mut dyn CoreBus,
    ) -> Result<(), Fault> {
        for (offset, value) in (0..).step_by(4).zip(words) {
            let address = address.wrapping_add(offset);
            if self.memory.store::<4>(address, value.to_le_bytes()).is_none() {
                self.store_by_bus(address, Size::Word, *value, index, context, bus)?;
            }
        }
        Ok(())
    }

    /// Loads the registers of a list, all or none; PC goes to [`LOADED`].
    pub(super) fn load_list(
        &mut self,
        address: u32,
        list: u16,
        index: usize,
        context: &Context<'_>,
        bus: &mut dyn CoreBus,
    ) -> Result<(), Fault> {
        if address & 3 != 0 {
            return Err(Fault::Unaligned);
        }
        let count = list.count_ones() as usize;
        let mut left = list;
        if let Some(cells) = self.memory.load_words(address, count) {
            for cells in cells.as_chunks().0 {
                self.r[left.trailing_zeros() as usize % COUNT] = word(cells);
                left &= left.wrapping_sub(1);
            }
            return Ok(());
        }
        // Registers change only after all loads, because one of them may be refused.
        let mut words = [0; LOADED as usize + 1];
        let words = &mut words[..count];
        self.load_words_by_bus(address, words, index, context, bus)?;
        for value in words {
            self.r[left.trailing_zeros() as usize % COUNT] = *value;
            left &= left.wrapping_sub(1);
        }
        Ok(())
    }

    /// Stores the registers of a list.
    pub(super) fn store_list(
        &mut self,
        address: u32,
        list: u16,
        index: usize,
        context: &Context<'_>,
        bus: &mut dyn CoreBus,
    ) -> Result<(), Fault> {
        if address & 3 != 0 {
            return Err(Fault::Unaligned);
        }
        let count = list.count_ones() as usize;
        let mut left = list;
        if let Some(cells) = self.memory.store_words(address, count) {
            for cells in cells.as_chunks().0 {
                set_word(cells, self.r[left.trailing_zeros() as usize % COUNT]);
                left &= left.wrapping_sub(1);
            }
            return Ok(());
        }
        let mut words = [0; LOADED as usize + 1];
        for value in &mut words[..count] {
            *value = self.r[left.trailing_zeros() as usize % COUNT];
            left &= left.wrapping_sub(1);
        }
        self.store_words_by_bus(address, &words[..count], index, context, bus)
    }

    /// Executes LDREX and relatives: the exclusive monitor watches the address (A3.4).
    pub(super) fn load_exclusive(
        &mut self,
        width: Width,
        address: u32,
        index: usize,
        context: &Context<'_>,
        bus: &mut dyn CoreBus,
    ) -> Result<u32, Fault> {
        if address & (width.bytes() - 1) != 0 {
            return Err(Fault::Unaligned);
        }
        let value = match width {
            Width::Byte => self.load_byte(address, index, context, bus),
            Width::Half => self.load_half(address, index, context, bus),
            Width::Word => {
                let mut words = [0];
                self.load_words(address, &mut words, index, context, bus)?;
                Some(words[0])
            }
        };
        let value = value.ok_or(Fault::Load)?;
        self.exclusive = Some(address);
        Ok(value)
    }

    /// Executes STREX and relatives; returns `true` if nothing was stored.
    pub(super) fn store_exclusive(
        &mut self,
        width: Width,
        address: u32,
        value: u32,
        index: usize,
        context: &Context<'_>,
        bus: &mut dyn CoreBus,
    ) -> Result<bool, Fault> {
        if address & (width.bytes() - 1) != 0 {
            return Err(Fault::Unaligned);
        }
        if self.exclusive.take() != Some(address) {
            return Ok(true);
        }
        let bytes = value.to_le_bytes();
        let (direct, size) = match width {
            Width::Byte => (self.memory.store(address, [bytes[0]]), Size::Byte),
            Width::Half => (self.memory.store(address, [bytes[0], bytes[1]]), Size::Half),
            Width::Word => (self.memory.store(address, bytes), Size::Word),
        };
        if direct.is_none() {
            self.store_by_bus(address, size, value, index, context, bus)?;
        }
        Ok(false)
    }

    /// Loads or stores one S or D register.
    #[inline(always)]
    fn transfer(
        &mut self,
        transfer: &Transfer,
        address: u32,
        index: usize,
        context: &Context<'_>,
        bus: &mut dyn CoreBus,
    ) -> Result<(), Fault> {
        let (first, second) = (usize::from(transfer.first & 31), usize::from(transfer.first.wrapping_add(1) & 31));
        if address & 3 != 0 {
            return Err(Fault::Unaligned);
        }
        match (transfer.load, transfer.words) {
            (true, 1) => self.float.s[first] = self.load_word(address, index, context, bus)?,
            // Both words are loaded before either half is written, because the second may be refused.
            (true, _) => {
                let low = self.load_word(address, index, context, bus)?;
                self.float.s[second] = self.load_word(address.wrapping_add(4), index, context, bus)?;
                self.float.s[first] = low;
            }
            (false, words) => {
                self.store_word(address, self.float.s[first], index, context, bus)?;
                if words == 2 {
                    self.store_word(address.wrapping_add(4), self.float.s[second], index, context, bus)?;
                }
            }
        }
        Ok(())
    }

    #[inline(always)]
    fn load_word(
        &mut self,
        address: u32,
        index: usize,
        context: &Context<'_>,
        bus: &mut dyn CoreBus,
    ) -> Result<u32, Fault> {
        match self.memory.load(address) {
            Some(bytes) => Ok(u32::from_le_bytes(bytes)),
            None => self.load_by_bus(address, Size::Word, index, context, bus).ok_or(Fault::Load),
        }
    }

    #[inline(always)]
    fn store_word(
        &mut self,
        address: u32,
        value: u32,
        index: usize,
        context: &Context<'_>,
        bus: &mut dyn CoreBus,
    ) -> Result<(), Fault> {
        match self.memory.store(address, value.to_le_bytes()) {
            Some(()) => Ok(()),
            None => self.store_by_bus(address, Size::Word, value, index, context, bus),
        }
    }

    /// Executes a floating-point instruction, if the unit is enabled.
    pub(super) fn float(
        &mut self,
        number: u32,
        index: usize,
        context: &Context<'_>,
        bus: &mut dyn CoreBus,
    ) -> Result<(), Fault> {
        let float = context.blocks.floats()[number as usize];
        if self.control & FLOAT_ACTIVE == 0 {
            // A new floating-point context starts with FPDSCR in FPSCR (B1.5.7); the machine models only FPDSCR's reset
            // value.
            self.control |= FLOAT_ACTIVE;
            self.float.set_fpscr(0);
        }
        let Some(transfer) = float.transfer() else {
            self.execute_float(&float);
            return Ok(());
        };
        let base = if transfer.base == 15 {
            context.pc(index).wrapping_add(4) & !3
        } else {
            self.r[usize::from(transfer.base) % COUNT]
        };
        let address = base.wrapping_add(i32::from(transfer.offset) as u32);
        // Fast path: most instructions transfer one register without write-back.
        if let (1 | 2, 0) = (transfer.words, transfer.write_back) {
            return self.transfer(&transfer, address, index, context, bus);
        }
        let (first, words) = (usize::from(transfer.first), usize::from(transfer.words));
        // The decoder accepts only lists that fit the registers.
        let list = first..(first + words).min(self.float.s.len());
        let mut values = [0; 32];
        let values = &mut values[..list.len()];
        if transfer.load {
            self.load_words(address, values, index, context, bus)?;
            self.float.s[list].copy_from_slice(values);
        } else {
            values.copy_from_slice(&self.float.s[list]);
            self.store_words(address, values, index, context, bus)?;
        }
        if transfer.write_back != 0 {
            self.r[usize::from(transfer.base) % COUNT] = base.wrapping_add(i32::from(transfer.write_back) as u32);
        }
        Ok(())
    }
}

impl Width {
    fn bytes(self) -> u32 {
        match self {
            Self::Byte => 1,
            Self::Half => 2,
            Self::Word => 4,
        }
    }
}
