//! What a chip has done, counted: to see what an emulation spends its time on.

use std::collections::BTreeMap;

use super::map::{self, Id};

/// Accesses to one register.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Accesses {
    /// Loads.
    pub reads: u64,
    /// Stores.
    pub writes: u64,
}

/// Counts since power-on.
#[derive(Clone, Debug)]
pub struct Activity {
    accesses: [u64; Id::COUNT],
    events: [u64; Id::COUNT],
    /// Calls of [`Outside::poll`](crate::Outside::poll).
    pub polls: u64,
    /// Accesses of DMA controllers to memory and peripherals.
    pub beats: u64,
    /// By address, where that was asked for.
    registers: Option<BTreeMap<u32, Accesses>>,
}

impl Activity {
    pub(super) fn new() -> Self {
        Self { accesses: [0; Id::COUNT], events: [0; Id::COUNT], polls: 0, beats: 0, registers: None }
    }

    #[inline]
    pub(super) fn accessed(&mut self, id: usize, address: u32, write: bool) {
        self.accesses[id] += 1;
        if let Some(registers) = &mut self.registers {
            let register = registers.entry(address).or_default();
            if write { register.writes += 1 } else { register.reads += 1 }
        }
    }

    #[inline]
    pub(super) fn advanced(&mut self, id: usize) {
        self.events[id] += 1;
    }

    /// Counts accesses by address from now on, which costs time.
    pub fn count_registers(&mut self) {
        self.registers.get_or_insert_default();
    }

    /// Every register that the program has accessed since [`Activity::count_registers`], by address.
    pub fn registers(&self) -> impl Iterator<Item = (u32, Accesses)> {
        self.registers.iter().flatten().map(|(address, accesses)| (*address, *accesses))
    }

    /// Of every peripheral its name, accesses of the program, and events of its own.
    pub fn peripherals(&self) -> impl Iterator<Item = (String, u64, u64)> {
        map::names()
            .into_iter()
            .zip(self.accesses.into_iter().zip(self.events))
            .map(|(name, (all, own))| (name, all, own))
    }
}
