//! What drivers of sensors have in common: each says its next transfer, and is given what came of it.
//!
//! A driver does not own the bus, so that it need not wait for it: a transfer is carried out in the control period that has room.

use embassy_time::Duration;
use r4_protocol::{
    Quality,
    channel::MAX_QUANTITIES,
    config::{SensorChip, SensorConfig},
};

use super::{as5600::As5600, icm20948::Icm20948, ina226::Ina226, nau7802::Nau7802, vl6180x::Vl6180x};
use crate::bus::bits;

/// Most bytes written in one exchange: a register and two more.
const WRITTEN: usize = 3;
/// Most bytes read in one exchange: with two addresses and a register, 15 bytes take 0.35 ms at 400 kHz.
pub const MAX_READ: usize = 12;

/// One transfer: bytes written, then bytes read behind a repeated START, where there are any.
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

    /// Writes `value` into a register of one byte whose address has two.
    #[must_use]
    pub const fn set_far(register: u16, value: u8) -> Self {
        let [high, low] = register.to_be_bytes();
        Self { written: [high, low, value], length: 3, read: 0 }
    }

    /// Reads `count` bytes from `register` on, whose address has two bytes, at most [`MAX_READ`].
    #[must_use]
    pub const fn get_far(register: u16, count: u8) -> Self {
        let read = if count as usize > MAX_READ { MAX_READ as u8 } else { count };
        let [high, low] = register.to_be_bytes();
        Self { written: [high, low, 0], length: 2, read }
    }

    /// The bytes written, without the address.
    #[must_use]
    pub fn written(&self) -> &[u8] {
        &self.written[..usize::from(self.length)]
    }

    /// How many bytes are read.
    #[must_use]
    pub const fn read(&self) -> usize {
        self.read as usize
    }

    /// What it takes of the bus.
    #[must_use]
    pub const fn bits(&self) -> u32 {
        let addresses = if self.read > 0 { 2 } else { 1 };
        bits(addresses + self.length as u32 + self.read as u32)
    }
}

/// What came of an exchange.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Outcome {
    /// The next exchange may follow.
    Next,
    /// The chip takes this long before the next exchange.
    Wait(Duration),
    /// Nothing has been measured since the last reading: ask again.
    NotReady,
    /// All quantities of the channel have been measured.
    Reading {
        /// SI, in the order of the channel's quantities.
        values: [f32; MAX_QUANTITIES],
        /// Whether they can be relied on.
        quality: Quality,
    },
    /// Another chip answers, or it does not keep its settings.
    WrongChip,
}

/// A driver of one chip.
pub trait Driver {
    /// Begins again: the chip may be in any state.
    fn restart(&mut self);

    /// The transfer to be carried out next.
    fn next(&self) -> Exchange;

    /// That transfer has been carried out, and `read` is what it gave; [`Driver::next`] then says another.
    fn done(&mut self, read: &[u8]) -> Outcome;
}

macro_rules! chips {
    ($($chip:ident)*) => {
        /// The driver of any of the chips.
        #[derive(Clone, Debug)]
        pub enum AnyDriver {
            $(
                #[doc = concat!("Of a [`", stringify!($chip), "`].")]
                $chip($chip),
            )*
        }

        impl AnyDriver {
            /// The driver of the chip that `config` names, which has not been asked anything yet.
            #[must_use]
            pub fn new(config: &SensorConfig) -> Self {
                match &config.chip {
                    $(SensorChip::$chip(chip) => Self::$chip($chip::new(chip, config.rate_hz)),)*
                }
            }
        }

        impl Driver for AnyDriver {
            fn restart(&mut self) {
                match self {
                    $(Self::$chip(driver) => driver.restart(),)*
                }
            }

            fn next(&self) -> Exchange {
                match self {
                    $(Self::$chip(driver) => driver.next(),)*
                }
            }

            fn done(&mut self, read: &[u8]) -> Outcome {
                match self {
                    $(Self::$chip(driver) => driver.done(read),)*
                }
            }
        }
    };
}

chips!(Icm20948 Ina226 As5600 Nau7802 Vl6180x);

/// Of a reading of which one number may be at the end of its range.
pub(super) const fn saturation(saturated: bool) -> Quality {
    if saturated { Quality::Saturated } else { Quality::Good }
}

#[cfg(test)]
pub(super) mod tests {
    extern crate std;

    use std::vec::Vec;

    use r4_protocol::config::SensorDescription;

    use super::*;

    /// What a driver takes of the bus.
    #[derive(Debug, PartialEq)]
    pub(crate) struct Taken {
        longest_bits: u32,
        reading_bits: u32,
        transfers: u32,
    }

    impl Taken {
        /// What the configuration says that it takes.
        pub(crate) fn planned(chip: &SensorDescription) -> Self {
            Self { longest_bits: chip.longest_bits, reading_bits: chip.reading_bits, transfers: chip.transfers }
        }
    }

    /// Carries out the set-up and two readings of a driver whose chip gives `answer`; a reading's transfers are those of the second.
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
