//! Stream of DMA1 or DMA2: its registers, its FIFO and its next access.

use std::collections::VecDeque;

use super::{Access, Patience, size_of_code};
use crate::peripheral::Size;

pub(super) const EN: u32 = 1;
pub(super) const DMEIE: u32 = 1 << 1;
pub(super) const TEIE: u32 = 1 << 2;
pub(super) const HTIE: u32 = 1 << 3;
pub(super) const TCIE: u32 = 1 << 4;
pub(super) const PFCTRL: u32 = 1 << 5;
pub(super) const CIRC: u32 = 1 << 8;
pub(super) const PINC: u32 = 1 << 9;
pub(super) const MINC: u32 = 1 << 10;
pub(super) const PINCOS: u32 = 1 << 15;
pub(super) const DBM: u32 = 1 << 18;
pub(super) const CT: u32 = 1 << 19;
pub(super) const DMDIS: u32 = 1 << 2;
pub(super) const FEIE: u32 = 1 << 7;
/// Bits that are writable while the stream is enabled; the rest of SxCR is protected.
pub(super) const WHILE_ENABLED: u32 = EN | DMEIE | TEIE | HTIE | TCIE | CIRC;

/// Flags of LISR, shifted to stream 0.
pub(super) const FEIF: u32 = 1;
pub(super) const TEIF: u32 = 1 << 3;
pub(super) const HTIF: u32 = 1 << 4;
pub(super) const TCIF: u32 = 1 << 5;
pub(super) const ALL_FLAGS: u32 = 0x3d;

const FIFO_BYTES: usize = 16;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Direction {
    FromPeripheral,
    ToPeripheral,
    Memory,
}

/// Port of the stream that an access uses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Port {
    Peripheral,
    Memory,
}

/// Access wanted by a stream, without the stream's number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Wanted {
    pub(super) port: Port,
    pub(super) address: u32,
    pub(super) size: Size,
    pub(super) access: Access,
    /// The access serves the request line.
    pub(super) serves: bool,
}

#[derive(Clone, Debug, Default)]
pub(super) struct Stream {
    pub(super) control: u32,
    pub(super) fifo_control: u32,
    pub(super) remaining: u32,
    /// Value last written to SxNDTR.
    pub(super) programmed: u32,
    pub(super) peripheral_address: u32,
    pub(super) memory_address: [u32; 2],
    pub(super) flags: u32,
    /// The program has cleared EN; the content of the FIFO goes to memory first (RM0399, DMA, FIFO).
    pub(super) stopping: bool,
    fifo: VecDeque<u8>,
    /// The FIFO has reached its threshold and is being emptied.
    emptying: bool,
    /// Addresses of the next accesses at both ports.
    peripheral: u32,
    memory: u32,
    /// Bytes that the memory port still has to move in this round.
    memory_left: u32,
    /// Remaining items of a burst at the peripheral port.
    burst_left: u32,
    pub(super) patience: Patience,
}

impl Stream {
    pub(super) fn new() -> Self {
        Self { fifo_control: 0x21, ..Self::default() }
    }

    pub(super) fn is_enabled(&self) -> bool {
        self.control & EN != 0
    }

    pub(super) fn direction(&self) -> Option<Direction> {
        match self.control >> 6 & 3 {
            0 => Some(Direction::FromPeripheral),
            1 => Some(Direction::ToPeripheral),
            2 => Some(Direction::Memory),
            _ => None,
        }
    }

    /// Returns true for direct mode, without the FIFO; memory to memory always uses it (RM0399, DMA, direct mode).
    pub(super) fn is_direct(&self) -> bool {
        self.fifo_control & DMDIS == 0 && self.direction() != Some(Direction::Memory)
    }

    pub(super) fn peripheral_size(&self) -> Size {
        size_of_code(self.control >> 11).unwrap_or(Size::Word)
    }

    /// Returns the width at the memory port; in direct mode MSIZE equals PSIZE (RM0399, DMA_SxCR).
    pub(super) fn memory_size(&self) -> Size {
        if self.is_direct() { self.peripheral_size() } else { size_of_code(self.control >> 13).unwrap_or(Size::Word) }
    }

    pub(super) fn priority(&self) -> u32 {
        self.control >> 16 & 3
    }

    pub(super) fn threshold_bytes(&self) -> usize {
        4 * ((self.fifo_control & 3) as usize + 1)
    }

    /// Returns the beats of a burst: PBURST is at bit 21, MBURST at bit 23. Direct mode has single transfers only.
    pub(super) fn burst_beats(&self, bit: u32) -> u32 {
        match self.control >> bit & 3 {
            0 => 1,
            _ if self.is_direct() => 1,
            code => 2 << code,
        }
    }

    /// Starts the stream when EN is set.
    pub(super) fn start(&mut self) {
        self.control |= EN;
        // Double-buffer mode implies circular mode (RM0399, DMA_SxCR).
        if self.control & DBM != 0 {
            self.control |= CIRC;
        }
        self.stopping = false;
        self.fifo.clear();
        self.emptying = false;
        self.burst_left = 0;
        // A stream that is enabled again restarts with the number written before.
        if self.remaining == 0 {
            self.remaining = self.programmed;
        }
        self.rewind();
        if self.remaining == 0 {
            self.control &= !EN;
        }
    }

    fn rewind(&mut self) {
        self.peripheral = self.peripheral_address;
        self.memory = self.memory_address[usize::from(self.control & CT != 0)];
        self.memory_left = self.remaining * self.peripheral_size().bytes();
    }

    /// Stops the stream at once, after a bus error or a wrong configuration.
    pub(super) fn abort(&mut self) {
        self.control &= !EN;
        self.stopping = false;
        self.fifo.clear();
    }

    /// Stops the stream when the program clears EN. TCIF is set when the FIFO is empty; SxNDTR stays (RM0399, DMA, FIFO
    /// flush and suspension).
    pub(super) fn stop(&mut self) {
        let drains = self.direction() != Some(Direction::ToPeripheral);
        // Data read from memory is dropped: only received data must reach its destination.
        if !drains {
            self.fifo.clear();
        }
        if self.fifo.is_empty() {
            self.control &= !EN;
            self.flags |= TCIF;
        } else {
            self.stopping = true;
        }
    }

    /// Returns the access that the stream wants now, given its request line.
    pub(super) fn wants(&self, request: bool) -> Option<Wanted> {
        if !self.is_enabled() || self.patience.is_over() {
            return None;
        }
        match self.direction()? {
            Direction::ToPeripheral => self.wants_to_peripheral(request),
            direction => self.wants_to_memory(request || direction == Direction::Memory, direction),
        }
    }

    fn wants_to_memory(&self, request: bool, direction: Direction) -> Option<Wanted> {
        let held = self.fifo.len();
        let size = self.memory_size();
        // The rest of a transfer leaves the FIFO below its threshold too.
        let last = self.remaining == 0 || self.stopping;
        if held > 0 && (last || self.emptying || self.is_direct()) && (last || held >= size.bytes() as usize) {
            return Some(Wanted {
                port: Port::Memory,
                address: self.memory,
                size,
                access: Access::Write(self.peek(size)),
                serves: false,
            });
        }
        let size = self.peripheral_size();
        let room = held + size.bytes() as usize <= FIFO_BYTES;
        // A burst in progress needs no further request.
        (self.remaining > 0 && !self.stopping && room && (request || self.burst_left > 0)).then_some(Wanted {
            port: Port::Peripheral,
            address: self.peripheral,
            size,
            access: Access::Read,
            serves: self.burst_left == 0 && direction == Direction::FromPeripheral,
        })
    }

    fn wants_to_peripheral(&self, request: bool) -> Option<Wanted> {
        let held = self.fifo.len();
        let size = self.memory_size();
        // Direct mode holds one item at most.
        let room = if self.is_direct() { held == 0 } else { held + size.bytes() as usize <= FIFO_BYTES };
        if self.memory_left > 0 && room {
            return Some(Wanted {
                port: Port::Memory,
                address: self.memory,
                size,
                access: Access::Read,
                serves: false,
            });
        }
        let size = self.peripheral_size();
        let enough = held >= size.bytes() as usize;
        (self.remaining > 0 && enough && (request || self.burst_left > 0)).then(|| Wanted {
            port: Port::Peripheral,
            address: self.peripheral,
            size,
            access: Access::Write(self.peek(size)),
            serves: self.burst_left == 0,
        })
    }

    /// Returns the oldest bytes of the FIFO, with zeros for missing ones (a last item narrower than MSIZE).
    fn peek(&self, size: Size) -> u32 {
        (0..size.bytes()).map(|n| u32::from(self.fifo.get(n as usize).copied().unwrap_or(0)) << (8 * n)).sum()
    }

    /// Completes an access; `value` is the value read.
    pub(super) fn done(&mut self, wanted: Wanted, value: u32) {
        let bytes = wanted.size.bytes();
        match wanted.access {
            Access::Read => self.fifo.extend(&value.to_le_bytes()[..bytes as usize]),
            Access::Write(_) => drop(self.fifo.drain(..self.fifo.len().min(bytes as usize))),
        }
        match wanted.port {
            Port::Peripheral => self.done_peripheral(wanted, bytes),
            Port::Memory => self.done_memory(bytes),
        }
        // Flags count items at the destination, not reads at the source.
        let arrived = match self.direction() {
            Some(Direction::ToPeripheral) => wanted.port == Port::Peripheral,
            _ => wanted.port == Port::Memory,
        };
        if arrived {
            self.account();
        }
    }

    fn done_peripheral(&mut self, wanted: Wanted, bytes: u32) {
        if self.control & PINC != 0 {
            self.peripheral = self.peripheral.wrapping_add(if self.control & PINCOS != 0 { 4 } else { bytes });
        }
        self.remaining -= 1;
        // The first beat of a burst serves the request, the others follow without one.
        self.burst_left = match (wanted.serves, self.burst_left) {
            (true, _) => self.burst_beats(21) - 1,
            (false, left) => left.saturating_sub(1),
        };
        if self.fifo.len() >= self.threshold_bytes() {
            self.emptying = true;
        }
    }

    fn done_memory(&mut self, bytes: u32) {
        if self.control & MINC != 0 {
            self.memory = self.memory.wrapping_add(bytes);
        }
        self.memory_left = self.memory_left.saturating_sub(bytes);
        // Emptying ends when no whole item is left, so that the FIFO fills to its threshold again.
        if self.fifo.len() < self.memory_size().bytes() as usize {
            self.emptying = false;
        }
    }

    /// Updates the flags after an item has arrived: half, complete, or the end of a stop.
    fn account(&mut self) {
        let unit = self.peripheral_size().bytes();
        let left = match self.direction() {
            Some(Direction::ToPeripheral) => self.remaining * unit,
            _ => self.memory_left,
        };
        let half = self.programmed * unit / 2;
        let moved_last = match self.direction() {
            Some(Direction::ToPeripheral) => unit,
            _ => self.memory_size().bytes(),
        };
        // The flag is set by the item that passes the half.
        if self.programmed > 1 && left <= half && left + moved_last > half {
            self.flags |= HTIF;
        }
        if left == 0 {
            self.complete();
        } else if self.stopping && self.fifo.is_empty() {
            self.control &= !EN;
            self.stopping = false;
            self.flags |= TCIF;
        }
    }

    fn complete(&mut self) {
        self.flags |= TCIF;
        self.burst_left = 0;
        if self.control & CIRC == 0 || self.stopping {
            self.control &= !EN;
            self.stopping = false;
            return;
        }
        if self.control & DBM != 0 {
            self.control ^= CT;
        }
        self.remaining = self.programmed;
        self.rewind();
    }
}
