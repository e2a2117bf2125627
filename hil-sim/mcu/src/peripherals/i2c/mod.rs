//! I2C1 to I2C4 as controllers of 7-bit targets (RM0399, chapter 50).
//!
//! A transfer takes time: START, address, bytes and STOP have the durations of TIMINGR and the kernel clock
//! (`timing.rs` has the approximation), and reach the [`Outside`](crate::Outside) at their end. While software or DMA
//! is late, SCL is held low and the transfer pauses; a target that holds a line stops it permanently.
//!
//! Deviations: RXNE is set at the end of the acknowledge bit, one bit later than on the chip, because the byte is known
//! only then; held lines are sampled at a request, and every 10 µs while a START waits for them. A START on an idle bus
//! occurs at the moment of the request (the chip takes up to a few periods of its clock).
//!
//! Target mode, SMBus except the timeout of a low SCL, PEC, and 10-bit addresses are not modelled and end the run.

mod access;
mod registers;
mod timing;
mod transfer;

#[cfg(test)]
mod tests;

use crate::context::{Clocks, Context, Signal};

use self::registers::{cr1, cr2, isr};
use self::timing::Timing;
use self::transfer::Phase;

/// Properties that distinguish the controllers.
#[derive(Clone, Copy, Debug)]
struct Instance {
    number: u8,
    name: &'static str,
    /// Interrupt numbers (RM0399, chapter 20).
    event_irq: u16,
    error_irq: u16,
    /// Inputs of DMAMUX1, for I2C4 of DMAMUX2 (RM0399, 18.3.2).
    rx_request: u8,
    tx_request: u8,
}

const fn instance(number: u8, name: &'static str, event_irq: u16, rx_request: u8) -> Instance {
    Instance { number, name, event_irq, error_irq: event_irq + 1, rx_request, tx_request: rx_request + 1 }
}

const INSTANCES: [Instance; 4] = [
    instance(1, "I2C1", 31, 33),
    instance(2, "I2C2", 33, 35),
    instance(3, "I2C3", 72, 73),
    instance(4, "I2C4", 95, 13),
];

/// State of one of the four controllers.
#[derive(Clone, Debug)]
pub struct I2c {
    instance: Instance,
    cr1: u32,
    cr2: u32,
    oar1: u32,
    oar2: u32,
    timingr: u32,
    timeoutr: u32,
    /// ISR without TXE and BUSY, which follow from the state.
    flags: u32,
    /// Content of TXDR, until it moves to the shift register.
    to_send: Option<u8>,
    received: u8,
    /// The controller is between its own START and STOP.
    owns_bus: bool,
    /// The lines were held low when they were last sampled.
    held_low: bool,
    /// Earliest time of a START, ns: tBUF after the last STOP.
    free_ns: u64,
    phase: Phase,
    /// Bytes of NBYTES that are still to be acknowledged.
    remaining: u32,
    /// Direction of the transfer in progress.
    reading: bool,
    /// Time at which PE was cleared, ns; `None` after it was read back.
    disabled_ns: Option<u64>,
    kernel_hz: u64,
    lines: [bool; 4],
}

impl I2c {
    /// Makes controller `number`, 1 to 4; `None` for any other number.
    #[must_use]
    pub fn new(number: u8) -> Option<Self> {
        let instance = *INSTANCES.iter().find(|instance| instance.number == number)?;
        Some(Self {
            instance,
            cr1: 0,
            cr2: 0,
            oar1: 0,
            oar2: 0,
            timingr: 0,
            timeoutr: 0,
            flags: 0,
            to_send: None,
            received: 0,
            owns_bus: false,
            held_low: false,
            free_ns: 0,
            phase: Phase::Idle,
            remaining: 0,
            reading: false,
            disabled_ns: None,
            kernel_hz: 0,
            lines: [false; 4],
        })
    }

    /// Returns the name, as in `I2C1`.
    #[must_use]
    pub fn name(&self) -> &'static str {
        self.instance.name
    }

    /// Returns SCL's frequency without stretching, by the clock tree at the last access, Hz; 0 for a stopped clock.
    #[must_use]
    pub fn scl_hz(&self) -> f64 {
        let thousand_bits_ns = self.timing().bits_ns(1000);
        if thousand_bits_ns == u64::MAX { 0.0 } else { 1e12 / thousand_bits_ns as f64 }
    }

    /// Lets another controller win the bus now: sets ARLO and ends the controller role (RM0399, 50.4.9). No effect
    /// without a transfer.
    pub fn inject_arbitration_loss(&mut self, context: &mut Context<'_>) {
        self.inject(isr::ARLO, context);
    }

    /// Injects a misplaced START or STOP: sets BERR and ends the transfer (RM0399, 50.4.16). No effect without a
    /// transfer.
    pub fn inject_bus_error(&mut self, context: &mut Context<'_>) {
        self.inject(isr::BERR, context);
    }

    fn inject(&mut self, flag: u32, context: &mut Context<'_>) {
        self.bring_to_now(context);
        if self.owns_bus {
            self.abandon();
            self.flags |= flag;
        }
        self.update_lines(context);
    }

    /// Ends the transfer without a STOP of its own.
    fn abandon(&mut self) {
        self.owns_bus = false;
        self.phase = Phase::Idle;
        self.cr2 &= !(cr2::START | cr2::STOP);
        self.flags &= !(isr::TXIS | isr::TC | isr::TCR);
    }

    fn enabled(&self) -> bool {
        self.cr1 & cr1::PE != 0
    }

    fn timing(&self) -> Timing {
        Timing::new(self.kernel_hz, self.timingr, self.cr1)
    }

    fn kernel_hz_of(&self, clocks: &Clocks) -> u64 {
        if self.instance.number == 4 { clocks.i2c4_hz } else { clocks.i2c123_hz }
    }

    /// Samples the lines, which is meaningful only while this controller does not drive them.
    fn look_at_lines(&mut self, context: &mut Context<'_>) {
        if !self.owns_bus && self.enabled() {
            let lines = context.outside.i2c_lines(self.instance.number, context.now_ns);
            self.held_low = lines != (true, true);
        }
    }

    fn isr(&self) -> u32 {
        let mut value = self.flags;
        if self.to_send.is_none() {
            value |= isr::TXE;
        }
        if self.enabled() && (self.owns_bus || self.held_low) {
            value |= isr::BUSY;
        }
        value
    }

    /// Updates the interrupt and request lines from the flags (RM0399, 50.6 and 50.4.17).
    fn update_lines(&mut self, context: &mut Context<'_>) {
        let flag = |enable: u32, flags: u32| self.cr1 & enable != 0 && self.flags & flags != 0;
        let lines = [
            flag(cr1::TXIE, isr::TXIS)
                || flag(cr1::RXIE, isr::RXNE)
                || flag(cr1::NACKIE, isr::NACKF)
                || flag(cr1::STOPIE, isr::STOPF)
                || flag(cr1::TCIE, isr::TC | isr::TCR),
            flag(cr1::ERRIE, isr::ERRORS),
            flag(cr1::RXDMAEN, isr::RXNE),
            flag(cr1::TXDMAEN, isr::TXIS),
        ];
        let changed = |nth: usize| lines[nth] != self.lines[nth];
        if changed(0) {
            context.irq(self.instance.event_irq, lines[0]);
        }
        if changed(1) {
            context.irq(self.instance.error_irq, lines[1]);
        }
        for (nth, request) in [(2, self.instance.rx_request), (3, self.instance.tx_request)] {
            if changed(nth) {
                let level = lines[nth];
                context.signals.push(match self.instance.number {
                    4 => Signal::Bdma { request, level },
                    _ => Signal::Dma { request, level },
                });
            }
        }
        self.lines = lines;
    }
}
