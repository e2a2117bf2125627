//! Tx handler of a module (RM0399, 59.4.2).

use crate::context::{Context, Ticks};
use crate::outside::{CanFrame, CanOutcome};

use super::Module;
use super::errors::LastError;
use super::ram::{self, MessageRam, element_bytes, element_words};
use super::registers::{self as register, cccr, ir, psr, txbc};
use super::wire::{AFTER_ACK_BITS, INTERMISSION_BITS};

/// Bits of an error flag with its delimiter.
const ERROR_FRAME_BITS: u64 = 6 + 8;
/// Additional wait of an error-passive transmitter, bits.
const SUSPEND_BITS: u64 = 8;
/// Transmit pause with TXP, bits.
const PAUSE_BITS: u64 = 2;

/// Frame being sent on the wire.
#[derive(Clone, Debug)]
pub(super) struct Transmission {
    buffer: usize,
    frame: CanFrame,
    esi: bool,
    /// Second word of the Tx buffer, with message marker and EFC.
    control: u32,
    timestamp: u32,
    kernel: Ticks,
    ack_clocks: u64,
    end_clocks: u64,
    acknowledged: bool,
}

impl Transmission {
    /// Returns the time of the next step, ns: the end of the acknowledge slot, then that of EOF.
    pub(super) fn next_ns(&self) -> u64 {
        self.kernel.when_ns(if self.acknowledged { self.end_clocks } else { self.ack_clocks })
    }

    pub(super) fn end_ns(&self) -> u64 {
        self.kernel.when_ns(self.end_clocks)
    }
}

impl Module {
    /// Returns the first buffer of the Tx FIFO or queue, and its number of buffers.
    pub(super) fn tx_fifo_place(&self) -> (usize, usize) {
        let txbc = self.reg(register::TXBC);
        let dedicated = (txbc >> txbc::NDTB_AT & 0x3F).min(32) as usize;
        let size = (txbc >> txbc::TFQS_AT & 0x3F).min(32) as usize;
        (dedicated, size.min(32 - dedicated))
    }

    pub(super) fn tx_fifo_pending(&self) -> usize {
        let (first, size) = self.tx_fifo_place();
        (first..first + size).filter(|buffer| self.pending(*buffer)).count()
    }

    fn is_queue(&self) -> bool {
        self.reg(register::TXBC) & txbc::TFQM != 0
    }

    fn pending(&self, buffer: usize) -> bool {
        self.reg(register::TXBRP) >> buffer & 1 == 1
    }

    fn buffer_word(&self, buffer: usize) -> usize {
        (self.reg(register::TXBC) & 0xFFFC) as usize / 4 + buffer * element_words(self.reg(register::TXESC))
    }

    /// Handles a write to TXBAR.
    pub(super) fn add_requests(&mut self, requests: u32, context: &mut Context<'_>) {
        if self.on(cccr::CCE) {
            context.misuse(self.name, "TXBAR is written while CCE is 1 (RM0399, 59.4.1)");
            return;
        }
        // A node in bus monitoring mode cannot send (59.4.1).
        if self.on(cccr::MON) && !self.loops_back() {
            return;
        }
        let (first, size) = self.tx_fifo_place();
        // The first request of an idle handler sets the earliest start.
        if self.reg(register::TXBRP) == 0 {
            self.requested_ns = context.now_ns;
        }
        // Buffers are taken cyclically from the put index on, so that simultaneous requests keep the FIFO's order.
        let in_fifo = (0..size).map(|nth| first + (self.tx_put + nth) % size);
        for buffer in (0..first).chain(in_fifo.collect::<Vec<_>>()) {
            if requests >> buffer & 1 == 0 || self.pending(buffer) {
                continue;
            }
            if buffer >= first && !self.is_queue() && buffer != first + self.tx_put {
                context.misuse(self.name, "a Tx FIFO element is requested that is not next (RM0399, 59.4.2)");
            }
            let bit = 1 << buffer;
            self.set_reg(register::TXBRP, self.reg(register::TXBRP) | bit);
            self.set_reg(register::TXBTO, self.reg(register::TXBTO) & !bit);
            self.set_reg(register::TXBCF, self.reg(register::TXBCF) & !bit);
            if buffer >= first {
                self.tx_put = (buffer - first + 1) % size;
                self.tx_taken = match (self.tx_put + size - self.tx_get) % size {
                    0 => size,
                    taken => taken,
                };
                self.seek_get();
                self.seek_put();
            }
        }
    }

    /// Moves the get index of a FIFO to the oldest request, or to the next one.
    fn seek_get(&mut self) {
        let (first, size) = self.tx_fifo_place();
        while self.tx_taken > 0 && !self.pending(first + self.tx_get) {
            self.tx_get = (self.tx_get + 1) % size;
            self.tx_taken -= 1;
        }
    }

    /// Moves the put index of a queue to the next free buffer.
    fn seek_put(&mut self) {
        let (first, size) = self.tx_fifo_place();
        if self.is_queue()
            && let Some(free) =
                (0..size).map(|nth| (self.tx_put + nth) % size).find(|index| !self.pending(first + index))
        {
            self.tx_put = free;
        }
    }

    /// Handles a write to TXBCR.
    pub(super) fn add_cancellations(&mut self, requests: u32, context: &mut Context<'_>) {
        if self.on(cccr::CCE) {
            context.misuse(self.name, "TXBCR is written while CCE is 1 (RM0399, 59.4.1)");
            return;
        }
        let (first, size) = self.tx_fifo_place();
        for buffer in (0..first + size).filter(|buffer| requests >> buffer & 1 == 1) {
            // A frame on the wire cannot be stopped; its cancellation completes with it.
            if self.transmission.as_ref().is_some_and(|transmission| transmission.buffer == buffer) {
                self.set_reg(register::TXBCR, self.reg(register::TXBCR) | 1 << buffer);
            } else {
                self.retire(buffer);
                self.cancellation_finished(buffer);
            }
        }
    }

    fn cancellation_finished(&mut self, buffer: usize) {
        self.set_reg(register::TXBCF, self.reg(register::TXBCF) | 1 << buffer);
        if self.reg(register::TXBCIE) >> buffer & 1 == 1 {
            self.raise(ir::TCF);
        }
    }

    /// Removes the request of a buffer.
    fn retire(&mut self, buffer: usize) {
        let (first, size) = self.tx_fifo_place();
        let had_requests = self.tx_fifo_pending() > 0;
        self.set_reg(register::TXBRP, self.reg(register::TXBRP) & !(1 << buffer));
        self.set_reg(register::TXBCR, self.reg(register::TXBCR) & !(1 << buffer));
        if buffer < first || size == 0 {
            return;
        }
        self.seek_get();
        self.seek_put();
        if had_requests && self.tx_fifo_pending() == 0 && !self.is_queue() {
            self.raise(ir::TFE);
        }
    }

    /// Returns the buffer to send next: the lowest identifier among the dedicated ones and the queue, the oldest of a
    /// FIFO.
    fn next_buffer(&self, ram: &MessageRam) -> Option<usize> {
        let (first, size) = self.tx_fifo_place();
        let candidates = if self.is_queue() { first + size } else { first };
        let oldest = (!self.is_queue() && self.tx_taken > 0).then_some(first + self.tx_get);
        (0..candidates)
            .chain(oldest)
            .filter(|buffer| self.pending(*buffer))
            .min_by_key(|buffer| (priority(ram.word(self.buffer_word(*buffer))), *buffer))
    }

    /// Returns the time at which the next frame begins, ns; `None` without a request.
    pub(super) fn start_ns(&self) -> Option<u64> {
        let may = !self.on(cccr::INIT)
            && !self.errors.bus_off
            && !self.on(cccr::ASM)
            && (!self.on(cccr::MON) || self.loops_back())
            && self.reg(register::TXBRP) != 0
            && self.dominant.is_none()
            && self.transmission.is_none();
        if !may {
            return None;
        }
        // All three conditions must hold: synchronised, bus free, and requested.
        let mut start_ns = self.synchronised_ns.max(self.free_ns).max(self.requested_ns);
        // Another node that began first wins the bus; this one waits until the frame and the intermission are over.
        for (end_ns, frame) in &self.coming {
            let others_ns = end_ns.saturating_sub(self.frame_ns(frame));
            if others_ns <= start_ns && start_ns < *end_ns {
                start_ns = self.bits_after(*end_ns, INTERMISSION_BITS);
            }
        }
        Some(start_ns)
    }

    pub(super) fn start(&mut self, at_ns: u64, ram: &MessageRam) {
        let Some(buffer) = self.next_buffer(ram) else { return };
        let word = self.buffer_word(buffer);
        let frame = ram.frame(word, element_bytes(self.reg(register::TXESC)), self.on(cccr::FDOE), self.on(cccr::BRSE));
        // ESI is sent recessive by an error-passive node, or if the buffer demands it.
        let esi = frame.fd && (self.errors.passive() || ram.word(word) & ram::ESI != 0);
        let ack_clocks = self.clocks_to_ack(&frame, esi);
        // Without a transceiver delay, the measured value is the offset.
        if frame.fd && self.reg(register::DBTP) >> 23 & 1 == 1 {
            let tdco = self.reg(register::TDCR) >> 8 & 0x7F;
            self.protocol = self.protocol & !(0x7F << psr::TDCV_AT) | tdco << psr::TDCV_AT;
        }
        self.transmission = Some(Transmission {
            buffer,
            frame,
            esi,
            control: ram.word(word + 1),
            timestamp: self.timestamp(at_ns),
            kernel: self.kernel_from(at_ns),
            ack_clocks,
            end_clocks: ack_clocks + AFTER_ACK_BITS * self.nominal().clocks(),
            acknowledged: false,
        });
    }

    /// Handles the end of the acknowledge slot or of EOF.
    pub(super) fn transmission_event(&mut self, at_ns: u64, ram: &mut MessageRam, context: &mut Context<'_>) {
        let Some(mut transmission) = self.transmission.take() else { return };
        if transmission.acknowledged {
            self.sent(at_ns, transmission, ram, context);
            return;
        }
        // Internal loop back does not reach the bus.
        let internal = self.loops_back() && self.on(cccr::MON);
        let outcome = match internal {
            true => CanOutcome::Acknowledged,
            false => context.outside.can_sent(self.bus, at_ns, &transmission.frame),
        };
        match outcome {
            // Loop back ignores a missing acknowledge (59.4.1).
            CanOutcome::NotAcknowledged if self.loops_back() => (),
            CanOutcome::Acknowledged => (),
            CanOutcome::NotAcknowledged => return self.not_sent(LastError::Acknowledge, at_ns, &transmission),
            CanOutcome::BitError => return self.not_sent(LastError::Bit0, at_ns, &transmission),
        }
        transmission.acknowledged = true;
        self.transmission = Some(transmission);
    }

    fn sent(&mut self, at_ns: u64, transmission: Transmission, ram: &mut MessageRam, context: &mut Context<'_>) {
        let buffer = transmission.buffer;
        let cancelled = self.reg(register::TXBCR) >> buffer & 1 == 1;
        self.no_error(transmission.frame.bit_rate_switch);
        // A frame sent without error lowers TEC by one (Bosch CAN 2.0, B, 8, rule 7).
        self.count(|errors| errors.transmit = errors.transmit.saturating_sub(1));
        self.wait(at_ns, if self.on(cccr::TXP) { PAUSE_BITS } else { 0 });
        self.retire(buffer);
        self.set_reg(register::TXBTO, self.reg(register::TXBTO) | 1 << buffer);
        if self.reg(register::TXBTIE) >> buffer & 1 == 1 {
            self.raise(ir::TC);
        }
        if cancelled {
            self.cancellation_finished(buffer);
        }
        if transmission.control & ram::EFC != 0 {
            self.store_event(&transmission, cancelled || self.on(cccr::DAR), ram);
        }
        if self.loops_back() {
            self.accept(&transmission.frame, transmission.timestamp, ram, context);
        }
    }

    /// Handles a disturbed frame: an error frame follows, then the same frame again, unless automatic retransmission is
    /// off.
    fn not_sent(&mut self, error: LastError, at_ns: u64, transmission: &Transmission) {
        // An error-passive node does not count a missing acknowledgement (Bosch CAN 2.0, B, 8, rule 3 exception 1).
        let alone = error == LastError::Acknowledge && self.errors.passive();
        self.protocol_error(error, false, |errors| errors.transmit += if alone { 0 } else { 8 });
        self.wait(at_ns, ERROR_FRAME_BITS);
        let cancelled = self.reg(register::TXBCR) >> transmission.buffer & 1 == 1;
        if cancelled || self.on(cccr::DAR) {
            self.retire(transmission.buffer);
            self.cancellation_finished(transmission.buffer);
        }
    }

    /// Marks the bus as occupied for `bits` and the intermission.
    fn wait(&mut self, at_ns: u64, bits: u64) {
        let suspended = if self.errors.passive() { SUSPEND_BITS } else { 0 };
        self.free_ns = self.bits_after(at_ns, bits + INTERMISSION_BITS + suspended);
    }

    fn store_event(&mut self, transmission: &Transmission, in_spite_of_cancellation: bool, ram: &mut MessageRam) {
        let txefc = self.reg(register::TXEFC);
        let size = (txefc >> 16 & 0x3F).min(32) as usize;
        let Some(index) = self.tx_events.put(size, false) else {
            self.raise(ir::TEFL);
            return;
        };
        let word = (txefc & 0xFFFC) as usize / 4 + 2 * index;
        let kind = if in_spite_of_cancellation { 2 } else { 1 };
        ram.set_word(word, ram::header(&transmission.frame, transmission.esi));
        let marker = transmission.control & 0xFF00_0000;
        ram.set_word(word + 1, marker | kind << 22 | ram::format(&transmission.frame) | transmission.timestamp);
        let level = self.tx_events.level;
        let watermark = (txefc >> 24 & 0x3F) as usize;
        self.raise(ir::TEFN);
        if level == watermark {
            self.raise(ir::TEFW);
        }
        if level == size {
            self.raise(ir::TEFF);
        }
    }
}

/// Returns a key in the order of arbitration: the first 11 bits, a standard before an extended frame, the rest.
fn priority(header: u32) -> (u32, bool, u32) {
    let id = header & 0x1FFF_FFFF;
    let extended = header & ram::XTD != 0;
    (id >> 18, extended, if extended { id & 0x3_FFFF } else { 0 })
}
