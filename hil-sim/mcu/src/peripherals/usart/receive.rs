//! Receiver of a USART (RM0399, 51.5.6, 51.5.16).

use std::collections::VecDeque;

use crate::outside::UartByte;

use super::Usart;
use super::registers::{cr1, cr2, cr3, isr};

/// Incoming bytes, the FIFO with RDR, and the pending detection of silence.
#[derive(Clone, Debug, Default)]
pub(super) struct Receiver {
    /// Bytes still to come, in order of time.
    coming: VecDeque<UartByte>,
    held: VecDeque<UartByte>,
    /// Value of RDR when no byte is held.
    last: u32,
    /// Time since which the receiver is on, ns.
    since_ns: u64,
    /// Time at which IDLE is set, ns, if no start bit comes before.
    idle_ns: Option<u64>,
    /// Time at which RTOF is set, ns, if no start bit comes before.
    timeout_ns: Option<u64>,
}

/// Event in the receiver.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Happens {
    Byte,
    Idle,
    Timeout,
}

impl Receiver {
    pub(super) fn queue(&mut self, byte: UartByte) {
        let place = self.coming.partition_point(|other| other.at_ns <= byte.at_ns);
        self.coming.insert(place, byte);
    }

    pub(super) fn held(&self) -> usize {
        self.held.len()
    }

    /// Returns true while a frame is arriving.
    pub(super) fn busy(&self, now_ns: u64, frame_ns: u64) -> bool {
        self.coming.front().is_some_and(|byte| byte.at_ns.saturating_sub(frame_ns) <= now_ns && now_ns < byte.at_ns)
    }

    pub(super) fn flush(&mut self) {
        self.held.clear();
    }

    /// Handles a change of RE or UE; a line that is idle from then on is detected at `idle_ns`.
    pub(super) fn restart(&mut self, now_ns: u64, idle_ns: Option<u64>) {
        self.since_ns = now_ns;
        self.idle_ns = idle_ns;
        self.timeout_ns = None;
    }

    /// Resets the receiver; bytes on the line stay.
    pub(super) fn reset(&mut self, now_ns: u64) {
        *self = Self { coming: std::mem::take(&mut self.coming), since_ns: now_ns, ..Self::default() };
    }

    pub(super) fn cancel_timeout(&mut self) {
        self.timeout_ns = None;
    }

    /// Returns true if no byte is coming and no silence is awaited.
    pub(super) fn is_quiet(&self) -> bool {
        self.coming.is_empty() && self.idle_ns.is_none() && self.timeout_ns.is_none()
    }

    /// Returns the next event and its time, given the duration of a frame, ns.
    pub(super) fn next(&self, frame_ns: u64) -> Option<(u64, Happens)> {
        let byte = self.coming.front().map(|byte| byte.at_ns);
        let start_ns = byte.map_or(u64::MAX, |at_ns| at_ns.saturating_sub(frame_ns));
        // A pause of exactly the timeout does not count (51.8.9, RTOF).
        let idle = self.idle_ns.filter(|at_ns| *at_ns <= start_ns);
        let timeout = self.timeout_ns.filter(|at_ns| *at_ns < start_ns);
        // Of simultaneous events the byte comes first: queued late, it was on the line before.
        [
            byte.map(|at_ns| (at_ns, Happens::Byte)),
            idle.map(|at_ns| (at_ns, Happens::Idle)),
            timeout.map(|at_ns| (at_ns, Happens::Timeout)),
        ]
        .into_iter()
        .flatten()
        .min_by_key(|(at_ns, _)| *at_ns)
    }
}

impl Usart {
    /// Returns the next event in the receiver and its time, ns.
    pub(super) fn receiver_next(&self) -> Option<(u64, Happens)> {
        if self.receiver.is_quiet() { None } else { self.receiver.next(self.frame_ns()) }
    }

    /// Carries out an event in the receiver.
    pub(super) fn receiver_event(&mut self, happens: Happens) {
        match happens {
            Happens::Byte => {
                if let Some(byte) = self.receiver.coming.pop_front() {
                    self.byte_arrived(byte);
                }
            }
            Happens::Idle => {
                self.receiver.idle_ns = None;
                self.kept |= isr::IDLE;
            }
            Happens::Timeout => {
                self.receiver.timeout_ns = None;
                self.kept |= isr::RTOF;
            }
        }
    }

    fn byte_arrived(&mut self, byte: UartByte) {
        let started_ns = byte.at_ns.saturating_sub(self.frame_ns());
        // A frame that began before the receiver was on is lost.
        if !self.receiver_on() || started_ns < self.receiver.since_ns {
            return;
        }
        let half_bits = self.half_bits_from(byte.at_ns);
        self.receiver.idle_ns = Some(half_bits.when_ns(self.frame_half_bits()));
        self.receiver.timeout_ns =
            (self.cr2 & cr2::RTOEN != 0).then(|| half_bits.when_ns(2 * u64::from(self.rtor & 0x00FF_FFFF)));
        let byte = UartByte { value: byte.value & self.data_mask(), ..byte };
        if self.receiver.held() < self.receive_capacity() {
            self.receiver.held.push_back(byte);
            if self.receiver.held() == 1 {
                self.show_errors();
            }
        } else if self.cr3 & cr3::OVRDIS == 0 {
            // On overrun the new character is lost, the held ones stay (51.8.9, ORE).
            self.kept |= isr::ORE;
            return;
        } else {
            self.receiver.held[0] = byte;
            self.show_errors();
        }
        if u32::from(byte.value) == self.cr2 >> cr2::ADD_AT {
            self.kept |= isr::CMF;
        }
    }

    /// Sets the errors of the character in RDR (RM0399, 51.8.9: with FIFO they belong to the next one to be read).
    fn show_errors(&mut self) {
        if let Some(byte) = self.receiver.held.front() {
            if byte.framing_error {
                self.kept |= isr::FE;
            }
            if byte.noise && self.cr3 & cr3::ONEBIT == 0 {
                self.kept |= isr::NE;
            }
        }
    }

    /// Handles a read of RDR.
    pub(super) fn take(&mut self) -> u32 {
        if let Some(byte) = self.receiver.held.pop_front() {
            self.receiver.last = u32::from(byte.value) | self.parity_of(byte.value);
            self.show_errors();
        }
        self.receiver.last
    }

    /// Returns the parity bit above the data, as in RDR (RM0399, 51.5.12). It always arrives correctly.
    fn parity_of(&self, value: u8) -> u32 {
        if !self.on(cr1::PCE) {
            return 0;
        }
        let odd_ones = value.count_ones() % 2 == 1;
        u32::from(odd_ones != self.on(cr1::PS)) << self.data_mask().count_ones()
    }
}
