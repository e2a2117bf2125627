//! Steps of a transfer (RM0399, 50.4.7 and 50.4.9).

use crate::context::Context;
use crate::outside::I2cResponse;

use super::I2c;
use super::registers::{cr2, isr, timeoutr};

/// Interval at which held lines are sampled while a START waits, ns.
const LINES_POLLED_NS: u64 = 10_000;

/// Phase of the bus. Each end is that of an acknowledge bit, unless stated otherwise.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Phase {
    /// No transfer is in progress; START is 0.
    Idle,
    /// START is 1, but the bus is not free before that time.
    Waiting { until_ns: u64 },
    /// START and address are on the bus.
    Address { end_ns: u64 },
    /// A byte is being sent to the target.
    Sending { byte: u8, end_ns: u64 },
    /// Eight bits are being received from the target, without the acknowledge bit.
    Receiving { end_ns: u64 },
    /// Eight bits have arrived, and RXDR is not read yet: SCL is low since then.
    Unread { since_ns: u64 },
    /// The acknowledge bit for a received byte is being sent.
    Acknowledging { end_ns: u64 },
    /// SCL is held low since then, until software writes TXDR, NBYTES, START or STOP.
    Held { since_ns: u64 },
    /// STOP is being made; the end is the rise of SDA.
    Stopping { end_ns: u64 },
    /// A target holds a line since that time.
    Stuck { since_ns: u64 },
}

impl Phase {
    pub(super) fn end_ns(self) -> Option<u64> {
        match self {
            Self::Waiting { until_ns: end_ns }
            | Self::Address { end_ns }
            | Self::Sending { end_ns, .. }
            | Self::Receiving { end_ns }
            | Self::Acknowledging { end_ns }
            | Self::Stopping { end_ns } => Some(end_ns),
            Self::Idle | Self::Unread { .. } | Self::Held { .. } | Self::Stuck { .. } => None,
        }
    }
}

impl I2c {
    /// Returns the time of the next step without software, ns.
    pub(super) fn next_ns(&self) -> u64 {
        self.phase.end_ns().unwrap_or(u64::MAX).min(self.timeout_ns())
    }

    /// Returns the time at which SCL has been low for too long (RM0399, 50.4.12, tTIMEOUT), ns; `u64::MAX` for never.
    fn timeout_ns(&self) -> u64 {
        let (Phase::Held { since_ns } | Phase::Unread { since_ns } | Phase::Stuck { since_ns }) = self.phase else {
            return u64::MAX;
        };
        if self.timeoutr & timeoutr::TIMOUTEN == 0 || self.flags & isr::TIMEOUT != 0 {
            return u64::MAX;
        }
        let periods = (u64::from(self.timeoutr & timeoutr::TIMEOUTA) + 1) * 2048;
        since_ns.saturating_add(self.timing().periods_ns(periods))
    }

    /// Carries out the step due at `at_ns`.
    pub(super) fn step(&mut self, at_ns: u64, context: &mut Context<'_>) {
        if self.timeout_ns() == at_ns {
            self.timed_out(at_ns);
            return;
        }
        match self.phase {
            Phase::Waiting { .. } => self.start_if_free(at_ns, context),
            Phase::Address { .. } => self.address_sent(at_ns, context),
            Phase::Sending { byte, .. } => {
                let response = context.outside.i2c_write(self.instance.number, at_ns, byte);
                if self.acknowledged(response, at_ns) {
                    self.byte_done(at_ns);
                }
            }
            // While RXDR is unread, the controller holds SCL low before the acknowledge bit.
            Phase::Receiving { .. } if self.flags & isr::RXNE != 0 => self.phase = Phase::Unread { since_ns: at_ns },
            Phase::Receiving { .. } => {
                self.phase = Phase::Acknowledging { end_ns: at_ns.saturating_add(self.timing().bits_ns(1)) };
            }
            Phase::Acknowledging { .. } => match context.outside.i2c_read(self.instance.number, at_ns) {
                Some(byte) => {
                    self.received = byte;
                    self.flags |= isr::RXNE;
                    self.byte_done(at_ns);
                }
                None => self.phase = Phase::Stuck { since_ns: at_ns },
            },
            Phase::Stopping { .. } => {
                context.outside.i2c_stop(self.instance.number, at_ns);
                // The STOP releases the bus before a START requested meanwhile is examined.
                self.owns_bus = false;
                self.flags |= isr::STOPF;
                self.cr2 &= !cr2::STOP;
                // The model uses SCLL for tBUF.
                self.free_ns = at_ns.saturating_add(self.timing().phases_ns(1, 0));
                self.phase = Phase::Idle;
                self.start_requested(at_ns, context);
            }
            Phase::Idle | Phase::Unread { .. } | Phase::Held { .. } | Phase::Stuck { .. } => (),
        }
    }

    /// Handles START = 1 without a transfer of this controller in progress.
    pub(super) fn start_requested(&mut self, at_ns: u64, context: &mut Context<'_>) {
        if self.cr2 & cr2::START == 0 {
            return;
        }
        if self.free_ns > at_ns {
            self.phase = Phase::Waiting { until_ns: self.free_ns };
        } else {
            self.start_if_free(at_ns, context);
        }
    }

    fn start_if_free(&mut self, at_ns: u64, context: &mut Context<'_>) {
        let lines = context.outside.i2c_lines(self.instance.number, at_ns);
        self.held_low = lines != (true, true);
        // The lines are outside this model and report no change, so they are polled.
        if self.held_low {
            self.phase = Phase::Waiting { until_ns: at_ns + LINES_POLLED_NS };
            return;
        }
        self.owns_bus = true;
        // SCLH defines tHD:STA.
        self.send_address(at_ns.saturating_add(self.timing().phases_ns(0, 1)));
    }

    /// Makes a repeated START. SCL is low since `since_ns`; SCLL defines tSU:STA.
    pub(super) fn start_again(&mut self, since_ns: u64, at_ns: u64) {
        let timing = self.timing();
        let risen_ns = at_ns.max(since_ns.saturating_add(timing.phases_ns(1, 0)));
        self.flags &= !isr::TC;
        self.send_address(risen_ns.saturating_add(timing.phases_ns(1, 1)));
    }

    fn send_address(&mut self, scl_low_ns: u64) {
        self.reading = self.cr2 & cr2::RD_WRN != 0;
        self.phase = Phase::Address { end_ns: scl_low_ns.saturating_add(self.timing().bits_ns(9)) };
    }

    fn address_sent(&mut self, at_ns: u64, context: &mut Context<'_>) {
        let address = (self.cr2 >> 1 & 0x7F) as u8;
        self.cr2 &= !cr2::START;
        let response = context.outside.i2c_start(self.instance.number, at_ns, address, self.reading);
        if self.acknowledged(response, at_ns) {
            self.remaining = (self.cr2 & cr2::NBYTES) >> cr2::NBYTES_AT;
            self.go_on(at_ns);
        }
    }

    /// Returns true if the target acknowledges; otherwise a STOP follows, or the bus is stuck.
    fn acknowledged(&mut self, response: I2cResponse, at_ns: u64) -> bool {
        match response {
            I2cResponse::Ack => true,
            I2cResponse::Nack => {
                // The hardware sends the STOP after a NACK, also without AUTOEND.
                self.flags = self.flags & !isr::TXIS | isr::NACKF;
                self.stop(at_ns, at_ns);
                false
            }
            I2cResponse::Stuck => {
                self.phase = Phase::Stuck { since_ns: at_ns };
                false
            }
        }
    }

    fn byte_done(&mut self, at_ns: u64) {
        self.remaining = self.remaining.saturating_sub(1);
        self.go_on(at_ns);
    }

    /// Continues after an acknowledge bit: with the next byte, or as NBYTES, RELOAD, AUTOEND, START and STOP define.
    pub(super) fn go_on(&mut self, at_ns: u64) {
        // A STOP requested by the program takes precedence over the bytes that remain.
        if self.cr2 & cr2::STOP != 0 {
            self.stop(at_ns, at_ns);
        } else if self.remaining > 0 && self.reading {
            self.phase = Phase::Receiving { end_ns: at_ns.saturating_add(self.timing().bits_ns(8)) };
        } else if self.remaining > 0 {
            self.phase = Phase::Held { since_ns: at_ns };
            self.flags |= if self.to_send.is_none() { isr::TXIS } else { 0 };
            self.send_next(at_ns);
        // AUTOEND has no effect while RELOAD is set, so RELOAD is examined first.
        } else if self.cr2 & cr2::RELOAD != 0 {
            self.flags |= isr::TCR;
            self.phase = Phase::Held { since_ns: at_ns };
        } else if self.cr2 & cr2::AUTOEND != 0 {
            self.stop(at_ns, at_ns);
        } else if self.cr2 & cr2::START != 0 {
            self.start_again(at_ns, at_ns);
        } else {
            self.flags |= isr::TC;
            self.phase = Phase::Held { since_ns: at_ns };
        }
    }

    /// Moves TXDR to the shift register, if SCL is held for that.
    pub(super) fn send_next(&mut self, at_ns: u64) {
        let Phase::Held { since_ns } = self.phase else { return };
        if self.reading || self.remaining == 0 {
            return;
        }
        let Some(byte) = self.to_send.take() else { return };
        let timing = self.timing();
        // SCL stays low for SCLL at least, and for the data set-up time SCLDEL after the write of TXDR.
        let low_ended_ns = since_ns.saturating_add(timing.phases_ns(1, 0));
        let risen_ns = low_ended_ns.max(at_ns.saturating_add(timing.setup_ns()));
        self.phase = Phase::Sending { byte, end_ns: risen_ns.saturating_add(timing.phases_ns(8, 9)) };
        // TXDR is empty again, but only a further byte of this transfer is requested.
        if self.remaining > 1 {
            self.flags |= isr::TXIS;
        }
    }

    /// Continues after a read of RXDR with the acknowledge bit that waited for it.
    pub(super) fn room_made(&mut self, at_ns: u64) {
        if let Phase::Unread { since_ns } = self.phase {
            let timing = self.timing();
            let risen_ns = at_ns.max(since_ns.saturating_add(timing.phases_ns(1, 0)));
            self.phase = Phase::Acknowledging { end_ns: risen_ns.saturating_add(timing.phases_ns(0, 1)) };
        }
    }

    /// Makes a STOP: SCL, low since `since_ns`, rises, and tSU:STO later, which SCLH defines, SDA rises.
    pub(super) fn stop(&mut self, since_ns: u64, at_ns: u64) {
        let timing = self.timing();
        let risen_ns = at_ns.max(since_ns.saturating_add(timing.phases_ns(1, 0)));
        self.flags &= !(isr::TC | isr::TCR | isr::TXIS);
        self.phase = Phase::Stopping { end_ns: risen_ns.saturating_add(timing.phases_ns(0, 1)) };
    }

    /// Handles TIMEOUT: a STOP follows, if the lines allow it (RM0399, 50.4.16).
    fn timed_out(&mut self, at_ns: u64) {
        self.flags |= isr::TIMEOUT;
        self.cr2 &= !cr2::START;
        // Only in these phases this controller itself holds SCL, so that it can make a STOP.
        if let Phase::Held { since_ns } | Phase::Unread { since_ns } = self.phase {
            self.stop(since_ns, at_ns);
        }
    }
}
