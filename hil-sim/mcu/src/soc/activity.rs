//! Activity counters of a chip, to find what an emulation spends its time on.

use std::collections::BTreeMap;

use super::map::{self, Id};

/// Numbers of accesses to one register.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Accesses {
    /// Number of the program's loads.
    pub reads: u64,
    /// Number of the program's stores.
    pub writes: u64,
}

/// Counters of a chip since power-on.
#[derive(Clone, Debug)]
pub struct Activity {
    accesses: [u64; Id::COUNT],
    events: [u64; Id::COUNT],
    /// Number of calls of [`Outside::poll`](crate::Outside::poll).
    pub polls: u64,
    /// Number of accesses by DMA controllers to memory and peripherals.
    pub beats: u64,
    /// Accesses by address; `None` before [`Activity::count_registers`].
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

    /// Starts to count accesses by address, which costs time.
    pub fn count_registers(&mut self) {
        self.registers.get_or_insert_default();
    }

    /// Iterates over the registers that the program has accessed since [`Activity::count_registers`], by address.
    pub fn registers(&self) -> impl Iterator<Item = (u32, Accesses)> {
        self.registers.iter().flatten().map(|(address, accesses)| (*address, *accesses))
    }

    /// Iterates over the peripherals: name, accesses of the program, and events of its own.
    pub fn peripherals(&self) -> impl Iterator<Item = (String, u64, u64)> {
        map::names()
            .into_iter()
            .zip(self.accesses.into_iter().zip(self.events))
            .map(|(name, (all, own))| (name, all, own))
    }
}
