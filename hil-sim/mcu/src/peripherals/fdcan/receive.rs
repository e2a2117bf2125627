//! Rx handler of a module (RM0399, 59.4.2).

use crate::context::Context;
use crate::outside::CanFrame;

use super::Module;
use super::errors::LastError;
use super::filter::{Filters, Store};
use super::ram::{self, MessageRam, element_bytes, element_words};
use super::registers::{self as register, cccr, ir, psr};
use super::wire::INTERMISSION_BITS;

/// Indices of a FIFO of elements, for reception or for Tx events.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct RxFifo {
    pub(super) put: usize,
    pub(super) get: usize,
    pub(super) level: usize,
}

impl RxFifo {
    /// Returns the place of the next element; `None` if the element is lost.
    pub(super) fn put(&mut self, size: usize, overwrite: bool) -> Option<usize> {
        if size == 0 || self.level >= size && !overwrite {
            return None;
        }
        let index = self.put;
        self.put = (self.put + 1) % size;
        // In overwrite mode the oldest element is lost.
        if self.level >= size {
            self.get = self.put;
        } else {
            self.level += 1;
        }
        Some(index)
    }

    /// Marks all elements up to and including `index` as read. Returns `false` if the FIFO does not hold it.
    pub(super) fn acknowledge(&mut self, index: usize, size: usize) -> bool {
        let read = (index + size.max(1) - self.get % size.max(1)) % size.max(1) + 1;
        if index >= size || read > self.level {
            return false;
        }
        self.get = (index + 1) % size;
        self.level -= read;
        true
    }

    /// Returns RXFnS or TXEFS, without the lost flag.
    pub(super) fn status(&self, size: usize) -> u32 {
        let full = u32::from(size > 0 && self.level == size);
        full << 24 | (self.put as u32) << 16 | (self.get as u32) << 8 | self.level as u32
    }
}

impl Module {
    pub(super) fn queue(&mut self, at_ns: u64, frame: CanFrame) {
        let place = self.coming.partition_point(|(other_ns, _)| *other_ns <= at_ns);
        self.coming.insert(place, (at_ns, frame));
    }

    /// Handles the end of EOF of another node's frame.
    pub(super) fn frame_arrived(
        &mut self,
        at_ns: u64,
        frame: &CanFrame,
        ram: &mut MessageRam,
        context: &mut Context<'_>,
    ) {
        let started_ns = at_ns.saturating_sub(self.frame_ns(frame));
        // A node that joined the bus within the frame does not receive it; in loop-back mode it ignores the bus.
        if !self.takes_part(started_ns) || self.dominant.is_some() || self.loops_back() {
            return;
        }
        self.free_ns = self.free_ns.max(self.bits_after(at_ns, INTERMISSION_BITS));
        if frame.fd && !self.on(cccr::FDOE) {
            // A classic node answers an FD frame with an error frame (59.4.1, CAN FD operation).
            self.protocol_error(LastError::Form, false, |errors| errors.receive = (errors.receive + 1).min(128));
            return;
        }
        self.no_error(frame.bit_rate_switch);
        // An error-passive receiver returns to between 119 and 127 (Bosch CAN 2.0, B, 8, rule 8).
        self.count(|errors| {
            errors.receive = if errors.receive >= 128 { 119 } else { errors.receive.saturating_sub(1) };
        });
        if frame.fd {
            self.protocol = self.protocol & !(psr::RBRS | psr::RESI)
                | psr::REDL
                | if frame.bit_rate_switch { psr::RBRS } else { 0 };
        }
        self.accept(frame, self.timestamp(started_ns), ram, context);
    }

    /// Filters a frame and stores it.
    pub(super) fn accept(&mut self, frame: &CanFrame, timestamp: u32, ram: &mut MessageRam, context: &mut Context<'_>) {
        let filters = Filters {
            global: self.reg(register::GFC),
            standard: self.reg(register::SIDFC),
            extended: self.reg(register::XIDFC),
            extended_mask: self.reg(register::XIDAM),
            locked_buffers: u64::from(self.reg(register::NDAT1)) | u64::from(self.reg(register::NDAT2)) << 32,
        };
        let verdict = filters.judge(frame, ram);
        let second = match verdict.element {
            Some(index) => index << 24,
            None => 1 << 31,
        } | ram::format(frame)
            | timestamp;
        let stored = match verdict.store {
            Store::Nowhere => 0,
            Store::Fifo(fifo) => self.store_in_fifo(fifo, frame, second, ram),
            Store::Buffer(buffer) => self.store_in_buffer(buffer, frame, second, ram),
            Store::Debug => {
                context.misuse(self.name, "a debug message (59.4.2) is dropped: not modelled");
                0
            }
        };
        if verdict.priority {
            let list = u32::from(frame.extended) << 15;
            self.set_reg(register::HPMS, list | verdict.element.unwrap_or(0) << 8 | stored);
            self.raise(ir::HPM);
        }
    }

    /// Returns the number of elements of FIFO 0 or 1.
    pub(super) fn fifo_size(&self, fifo: usize) -> usize {
        (self.reg([register::RXF0C, register::RXF1C][fifo]) >> 16 & 0x7F).min(64) as usize
    }

    /// Stores a frame in a FIFO; returns MSI and BIDX of HPMS.
    fn store_in_fifo(&mut self, fifo: usize, frame: &CanFrame, second: u32, ram: &mut MessageRam) -> u32 {
        let configuration = self.reg([register::RXF0C, register::RXF1C][fifo]);
        let shift = 4 * fifo as u32;
        let size = self.fifo_size(fifo);
        let Some(index) = self.fifos[fifo].put(size, configuration >> 31 == 1) else {
            self.raise(ir::RF0L << shift);
            // MSI = 1: the message is lost.
            return 1 << 6;
        };
        let code = self.reg(register::RXESC) >> (4 * fifo) & 7;
        store(ram, (configuration & 0xFFFC) as usize / 4 + index * element_words(code), code, frame, second);
        let level = self.fifos[fifo].level;
        let watermark = (configuration >> 24 & 0x7F) as usize;
        self.raise(ir::RF0N << shift);
        if level == watermark && watermark <= 64 {
            self.raise(ir::RF0W << shift);
        }
        if level == size {
            self.raise(ir::RF0F << shift);
        }
        (2 + fifo as u32) << 6 | index as u32
    }

    fn store_in_buffer(&mut self, buffer: usize, frame: &CanFrame, second: u32, ram: &mut MessageRam) -> u32 {
        let code = self.reg(register::RXESC) >> 8 & 7;
        let start = (self.reg(register::RXBC) & 0xFFFC) as usize / 4;
        store(ram, start + buffer * element_words(code), code, frame, second);
        let offset = if buffer < 32 { register::NDAT1 } else { register::NDAT2 };
        self.set_reg(offset, self.reg(offset) | 1 << (buffer % 32));
        self.raise(ir::DRX);
        0
    }
}

fn store(ram: &mut MessageRam, word: usize, code: u32, frame: &CanFrame, second: u32) {
    ram.set_word(word, ram::header(frame, false));
    ram.set_word(word + 1, second);
    ram.set_data(word, element_bytes(code), &frame.data);
}
