//! Bus of output chips and sensors: a budget of bits in each control period, and the repeats of failed transfers.
//!
//! [`Outputs`](crate::outputs::Outputs) spends the budget first, in the order of how much a late write matters;
//! [`Sensors`](crate::sensing::on_bus::Sensors) get the rest. A failed write is repeated at once, because a wrong
//! output trips the board. A sensor's transfer is not: its channel reports the failure, and nothing else waits for it.

use core::task::Context;

use embassy_time::Duration;
use embedded_hal_async::i2c::{Error, ErrorKind};
use r4_protocol::config::BoardConfig;

use crate::{
    chips::{ChipError, sensor::Exchange},
    platform::{Bus, Write},
};

/// Number of tries of a transfer.
pub(crate) const TRIES: u32 = 3;
/// Share of a control period that transfers may take: the rest is for the processor and for a repeat. A processor that
/// is slow in a period reduces it: see [`Scheduler::leave_time`].
const BUS_SHARE: f32 = 0.95;

/// Cause of a fault of the outputs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OutputFault {
    /// Transfers fail, even after repeats and after freeing the bus.
    Bus,
    /// A chip does not hold what was written.
    Mismatch,
}

/// Reason why a sensor's transfer failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ExchangeFault {
    /// The sensor does not acknowledge; the bus is free.
    NoAnswer,
    /// Something held the bus; it has been freed once.
    Bus,
}

/// Owner of the bus, which schedules all transfers.
pub(crate) struct Scheduler<B> {
    bus: B,
    retries: u32,
    /// Time of nine bits on the bus, rounded down to 1 µs.
    byte_time: Duration,
    bits_per_ms: u32,
    /// Bits that fit a control period, and those remaining in this one.
    bits_per_period: u32,
    bits_left: u32,
}

impl<B: Bus> Scheduler<B> {
    pub(crate) fn new(bus: B, config: &BoardConfig) -> Self {
        let period_s = config.control_period_us as f32 * 1e-6;
        let bits_per_period = (period_s * BUS_SHARE * config.i2c_hz as f32) as u32;
        Self {
            bus,
            retries: 0,
            byte_time: Duration::from_micros(9_000_000_u32.checked_div(config.i2c_hz).unwrap_or(0).into()),
            bits_per_ms: config.i2c_hz / 1000,
            bits_per_period,
            bits_left: bits_per_period,
        }
    }

    /// Begins a control period: the full budget is available again.
    pub(crate) fn begin_period(&mut self) {
        self.bits_left = self.bits_per_period;
    }

    /// Reserves processor time in this period. `taken` is the time that inputs and steppers have needed: outputs,
    /// values for hosts and interrupts need about twice that, which reduces the remaining budget. Fixed by `r4 --board
    /// emu:every-interface bench firmware --seconds 2`: with twice no period is late and jitter is 10 us, with half of
    /// that 15 of 2005 are late and jitter is 16 us.
    pub(crate) fn leave_time(&mut self, taken: Duration) {
        let taken_us = taken.as_micros().min(u16::MAX.into()) as u32;
        self.bits_left = self.bits_left.saturating_sub(2 * taken_us * self.bits_per_ms / 1000);
    }

    /// Reserves `bits` in this period; false when they do not fit and have to wait.
    pub(crate) fn fits(&mut self, bits: u32) -> bool {
        let left = self.bits_left.checked_sub(bits);
        self.bits_left = left.unwrap_or(self.bits_left);
        left.is_some()
    }

    /// Bits that remain in this period.
    pub(crate) const fn bits_left(&self) -> u32 {
        self.bits_left
    }

    /// Time of a byte on the bus, rounded down to 1 µs.
    pub(crate) const fn byte_time(&self) -> Duration {
        self.byte_time
    }

    /// Number of repeated transfers since the last call.
    pub(crate) fn take_retries(&mut self) -> u32 {
        core::mem::take(&mut self.retries)
    }

    /// Carries out one transfer with a sensor, which fills `read`. It is not repeated, because outputs would wait for
    /// it.
    ///
    /// # Errors
    /// [`ExchangeFault::NoAnswer`] without an acknowledge, [`ExchangeFault::Bus`] for any other failure.
    pub(crate) async fn exchange(
        &mut self,
        address: u8,
        exchange: &Exchange,
        read: &mut [u8],
    ) -> Result<(), ExchangeFault> {
        let result = if read.is_empty() {
            self.bus.write(address, exchange.written()).await
        } else {
            self.bus.write_read(address, exchange.written(), read).await
        };
        let Err(error) = result else { return Ok(()) };
        if let ErrorKind::NoAcknowledge(_) = error.kind() {
            return Err(ExchangeFault::NoAnswer);
        }
        // Recover now, so that the next write, which may be a stop, finds a free bus.
        self.bus.recover().await;
        Err(ExchangeFault::Bus)
    }

    /// Sends `writes`, each with up to [`TRIES`] tries, until `stops` returns true. Returns the number sent, and the
    /// fault that ended it, if any.
    pub(crate) async fn send(
        &mut self,
        writes: &[Write],
        mut stops: impl FnMut(&mut Context<'_>) -> bool,
    ) -> (usize, Result<(), OutputFault>) {
        let (mut sent, mut tries) = (0, 0);
        while let Some(rest) = writes.get(sent..).filter(|rest| !rest.is_empty()) {
            let (more, result) = self.bus.write_all(rest, &mut stops).await;
            sent += more;
            if result.is_ok() {
                break;
            }
            tries = if more > 0 { 1 } else { tries + 1 };
            if tries == TRIES {
                return (sent, Err(OutputFault::Bus));
            }
            self.retries += 1;
            self.bus.recover().await;
        }
        (sent, Ok(()))
    }

    /// Carries out an operation with up to [`TRIES`] tries and frees the bus after each failed transfer: on a bus that
    /// is held every further try would cost a time-out.
    ///
    /// # Errors
    /// [`OutputFault::Bus`] after the last try, [`OutputFault::Mismatch`] at once for a register that does not hold
    /// what was written.
    pub(crate) async fn checked<T>(
        &mut self,
        mut operation: impl AsyncFnMut(&mut B) -> Result<T, ChipError<B::Error>>,
    ) -> Result<T, OutputFault> {
        let mut tries = 1;
        loop {
            match operation(&mut self.bus).await {
                Ok(done) => return Ok(done),
                Err(ChipError::Mismatch { .. }) => return Err(OutputFault::Mismatch),
                Err(ChipError::Bus(_)) if tries == TRIES => return Err(OutputFault::Bus),
                Err(ChipError::Bus(_)) => self.bus.recover().await,
            }
            tries += 1;
            self.retries += 1;
        }
    }
}
