//! Interface of sensor drivers: a driver names its next transfer and receives its result.
//!
//! A driver does not own the bus and never waits for it: each transfer is carried out in a control period that has room
//! for it.

use embassy_time::Duration;
use r4_protocol::{Quality, channel::MAX_QUANTITIES, config::bus_bits as bits};

/// Maximum bytes written in one exchange: a register and two more.
const WRITTEN: usize = 3;
/// Maximum bytes read in one exchange: with two addresses and a register, 15 bytes take 0.35 ms at 400 kHz.
pub const MAX_READ: usize = 12;

/// One transfer: bytes written, then, if any, bytes read after a repeated START.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Exchange {
    written: [u8; WRITTEN],
    length: u8,
    read: u8,
}

impl Exchange {
    /// Writes `value` into a register of one byte.
    #[must_use]
    pub const fn set(register: u8, value: u8) -> Self {
        Self { written: [register, value, 0], length: 2, read: 0 }
    }

    /// Writes a register of two bytes, or two registers in a row.
    #[must_use]
    pub const fn set_both(register: u8, values: [u8; 2]) -> Self {
        Self { written: [register, values[0], values[1]], length: 3, read: 0 }
    }

    /// Reads `count` bytes from `register` on, at most [`MAX_READ`].
    #[must_use]
    pub const fn get(register: u8, count: u8) -> Self {
        let read = if count as usize > MAX_READ { MAX_READ as u8 } else { count };
        Self { written: [register, 0, 0], length: 1, read }
    }

    /// Writes `value` into a one-byte register with a two-byte address.
    #[must_use]
    pub const fn set_far(register: u16, value: u8) -> Self {
        let [high, low] = register.to_be_bytes();
        Self { written: [high, low, value], length: 3, read: 0 }
    }

    /// Reads `count` bytes, at most [`MAX_READ`], from `register` on, which has a two-byte address.
    #[must_use]
    pub const fn get_far(register: u16, count: u8) -> Self {
        let read = if count as usize > MAX_READ { MAX_READ as u8 } else { count };
        let [high, low] = register.to_be_bytes();
        Self { written: [high, low, 0], length: 2, read }
    }

    /// Bytes to write, without the chip's address.
    #[must_use]
    pub fn written(&self) -> &[u8] {
        &self.written[..usize::from(self.length)]
    }

    /// Number of bytes to read.
    #[must_use]
    pub const fn read(&self) -> usize {
        self.read as usize
    }

    /// Bus time of the exchange in bit times, addresses included.
    #[must_use]
    pub const fn bits(&self) -> u32 {
        let addresses = if self.read > 0 { 2 } else { 1 };
        bits(addresses + self.length as u32 + self.read as u32)
    }
}

/// Result of an exchange.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Outcome {
    /// The next exchange may follow.
    Next,
    /// The chip needs this time before the next exchange.
    Wait(Duration),
    /// No new measurement since the last reading: ask again.
    NotReady,
    /// All quantities of the channel have been measured.
    Reading {
        /// Values in SI units, in the order of the channel's quantities.
        values: [f32; MAX_QUANTITIES],
        /// Quality of all values.
        quality: Quality,
    },
    /// Another chip answers at this address, or the chip does not keep its settings.
    WrongChip,
}

/// Driver of one sensor chip.
pub trait Driver {
    /// Starts over: the chip may be in any state.
    fn restart(&mut self);

    /// Returns the transfer to be carried out next.
    fn next(&self) -> Exchange;

    /// Takes the result of that transfer, the bytes `read`; [`Driver::next`] then returns another one.
    fn done(&mut self, read: &[u8]) -> Outcome;
}

/// Quality of a reading: saturated when any of its numbers may be at the end of its range.
pub(super) const fn saturation(saturated: bool) -> Quality {
    if saturated { Quality::Saturated } else { Quality::Good }
}

#[cfg(test)]
pub(super) mod tests {
    extern crate std;

    use std::vec::Vec;

    use r4_protocol::config::SensorDescription;

    use super::*;

    /// Bus load of a driver.
    #[derive(Debug, PartialEq)]
    pub(crate) struct Taken {
        longest_bits: u32,
        reading_bits: u32,
        transfers: u32,
    }

    impl Taken {
        /// Bus load according to the chip description of the configuration.
        pub(crate) fn planned(chip: &SensorDescription) -> Self {
            Self { longest_bits: chip.longest_bits, reading_bits: chip.reading_bits, transfers: chip.transfers }
        }
    }

    /// Carries out the set-up and two readings of a driver whose chip gives `answer`; the transfers of a reading are
    /// those of the second.
    pub(crate) fn taken<D: Driver>(driver: &mut D, answer: impl Fn(&D) -> Vec<u8>) -> Taken {
        let mut longest_bits = 0;
        let mut until_reading = || {
            let (mut bits, mut transfers) = (0, 0);
            loop {
                let exchange = driver.next();
                (bits, transfers) = (bits + exchange.bits(), transfers + 1);
                longest_bits = longest_bits.max(exchange.bits());
                match driver.done(&answer(driver)[..]) {
                    Outcome::Next | Outcome::Wait(_) => {}
                    Outcome::Reading { .. } => return (bits, transfers),
                    outcome => panic!("{outcome:?} to {exchange:?}"),
                }
            }
        };
        until_reading();
        let (reading_bits, transfers) = until_reading();
        Taken { longest_bits, reading_bits, transfers }
    }
}
