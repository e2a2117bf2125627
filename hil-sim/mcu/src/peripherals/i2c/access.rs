//! Accesses to the registers, and the progress of time.

use crate::context::Context;
use crate::peripheral::{Peripheral, Size, Unmodelled};

use super::I2c;
use super::registers::{self as register, cr1, cr2, isr, timeoutr};
use super::transfer::Phase;

impl I2c {
    fn unmodelled(&self, what: impl Into<String>) -> Unmodelled {
        Unmodelled { peripheral: self.instance.name, what: what.into() }
    }

    fn misuse(&self, what: &str, context: &mut Context<'_>) {
        context.misuse(self.instance.name, what);
    }

    pub(super) fn bring_to_now(&mut self, context: &mut Context<'_>) {
        self.kernel_hz = self.kernel_hz_of(context.clocks);
        loop {
            let next_ns = self.next_ns();
            if next_ns > context.now_ns || next_ns == u64::MAX {
                break;
            }
            self.step(next_ns, context);
        }
    }

    fn write_cr1(&mut self, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        if value & cr1::UNMODELLED != 0 {
            return Err(self.unmodelled(format!("CR1 = {value:#010x}: target mode and SMBus are not modelled")));
        }
        let mut value = value & cr1::ALL;
        if self.enabled() && (self.cr1 ^ value) & cr1::LOCKED != 0 {
            self.misuse("DNF, ANFOFF or NOSTRETCH changes while PE is 1 (RM0399, 50.7.1)", context);
            value = value & !cr1::LOCKED | self.cr1 & cr1::LOCKED;
        }
        let turned = self.cr1 ^ value;
        self.cr1 = value;
        if turned & cr1::PE == 0 {
            return Ok(());
        }
        if self.enabled() {
            let since_ns = self.disabled_ns.take();
            let three_clocks = |at_ns: u64| {
                let elapsed = u128::from(context.now_ns.saturating_sub(at_ns));
                elapsed * u128::from(self.apb_hz(context)) >= 3 * 1_000_000_000
            };
            if since_ns.is_some_and(|at_ns| !three_clocks(at_ns)) {
                self.misuse("PE is 0 for less than 3 APB clocks, and was not read back (RM0399, 50.4.6)", context);
            }
            if value & cr1::NOSTRETCH != 0 {
                self.misuse("NOSTRETCH must be 0 for a controller (RM0399, 50.7.1)", context);
            }
        } else {
            self.software_reset();
            self.disabled_ns = Some(context.now_ns);
        }
        Ok(())
    }

    fn apb_hz(&self, context: &Context<'_>) -> u64 {
        if self.instance.number == 4 { context.clocks.apb4_hz } else { context.clocks.apb1_hz }
    }

    /// Handles PE = 0: both lines are released, at any point of a transfer (RM0399, 50.4.6).
    fn software_reset(&mut self) {
        self.abandon();
        self.cr2 &= !(cr2::SET_ONLY | cr2::PECBYTE);
        self.flags = 0;
        self.to_send = None;
        self.held_low = false;
        self.remaining = 0;
    }

    fn write_cr2(&mut self, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        if value & (cr2::ADD10 | cr2::PECBYTE) != 0 {
            return Err(self.unmodelled("10-bit addresses and PEC (CR2) are not modelled"));
        }
        let old = self.cr2;
        // START, STOP and NACK can only be set; the hardware clears them.
        let mut value = value & cr2::ALL | old & cr2::SET_ONLY;
        if old & cr2::START != 0 && (old ^ value) & cr2::FIXED_BY_START != 0 {
            self.misuse("address, direction or NBYTES changes while START is 1 (RM0399, 50.7.2)", context);
            value = value & !cr2::FIXED_BY_START | old & cr2::FIXED_BY_START;
        }
        // With PE = 0 the hardware keeps START, STOP and NACK at 0.
        if !self.enabled() {
            if value & (cr2::START | cr2::STOP) != 0 {
                self.misuse("START or STOP is set while PE is 0 (RM0399, 50.7.2)", context);
            }
            self.cr2 = value & !cr2::SET_ONLY;
            return Ok(());
        }
        self.cr2 = value;
        let now_ns = context.now_ns;
        match self.phase {
            Phase::Idle => {
                if value & cr2::STOP != 0 && old & cr2::STOP == 0 {
                    self.misuse("STOP is set without a transfer: it will end the next one (RM0399, 50.7.2)", context);
                }
                self.start_requested(now_ns, context);
            }
            // STOP takes precedence over a repeated START and over a reload.
            Phase::Held { since_ns } if value & cr2::STOP != 0 => self.stop(since_ns, now_ns),
            Phase::Held { since_ns } if self.flags & isr::TC != 0 && value & cr2::START != 0 => {
                self.start_again(since_ns, now_ns);
            }
            Phase::Held { .. } if self.flags & isr::TCR != 0 && value & cr2::NBYTES != 0 => {
                self.flags &= !isr::TCR;
                self.remaining = (value & cr2::NBYTES) >> cr2::NBYTES_AT;
                self.go_on(now_ns);
            }
            _ => (),
        }
        Ok(())
    }

    fn write_timeoutr(&mut self, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        if value & timeoutr::TEXTEN != 0 || value & timeoutr::TIMOUTEN != 0 && value & timeoutr::TIDLE != 0 {
            return Err(self.unmodelled("TIMEOUTR: only the timeout of a low SCL is modelled"));
        }
        let fields = timeoutr::TIMEOUTA | timeoutr::TIDLE;
        if self.timeoutr & timeoutr::TIMOUTEN != 0 && (self.timeoutr ^ value) & fields != 0 {
            self.misuse("TIMEOUTA or TIDLE changes while TIMOUTEN is 1 (RM0399, 50.7.6)", context);
            return Ok(());
        }
        self.timeoutr = value & timeoutr::ALL;
        Ok(())
    }

    fn write_txdr(&mut self, value: u8, context: &mut Context<'_>) {
        if !self.enabled() || self.to_send.is_some() {
            self.misuse("TXDR is written while TXE is 0 or PE is 0 (RM0399, 50.7.11)", context);
            return;
        }
        self.to_send = Some(value);
        self.flags &= !isr::TXIS;
        self.send_next(context.now_ns);
    }

    /// Writes ISR: setting TXE empties TXDR; TXIS can be set with NOSTRETCH only.
    fn write_isr(&mut self, value: u32) {
        if value & isr::TXE != 0 {
            self.to_send = None;
        }
    }
}

impl Peripheral for I2c {
    fn read(&mut self, offset: u32, size: Size, context: &mut Context<'_>) -> Result<u32, Unmodelled> {
        self.bring_to_now(context);
        if size != Size::Word && offset != register::RXDR {
            return Err(
                self.unmodelled(format!("read of {} bytes at {offset:#05x} (RM0399, 50.7: words)", size.bytes()))
            );
        }
        let value = match offset {
            register::CR1 => {
                // The program has read PE back as 0, which ensures the three APB clocks (RM0399, 50.4.6).
                self.disabled_ns = None;
                self.cr1
            }
            register::CR2 => self.cr2,
            register::OAR1 => self.oar1,
            register::OAR2 => self.oar2,
            register::TIMINGR => self.timingr,
            register::TIMEOUTR => self.timeoutr,
            register::ISR => {
                self.look_at_lines(context);
                self.isr()
            }
            register::ICR | register::PECR => 0,
            register::RXDR => {
                self.flags &= !isr::RXNE;
                self.room_made(context.now_ns);
                u32::from(self.received)
            }
            register::TXDR => u32::from(self.to_send.unwrap_or(0)),
            _ => return Err(Unmodelled::register(self.instance.name, offset)),
        };
        self.update_lines(context);
        Ok(value)
    }

    fn write(&mut self, offset: u32, size: Size, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        self.bring_to_now(context);
        if size != Size::Word && offset != register::TXDR {
            return Err(
                self.unmodelled(format!("write of {} bytes at {offset:#05x} (RM0399, 50.7: words)", size.bytes()))
            );
        }
        match offset {
            register::CR1 => self.write_cr1(value, context)?,
            register::CR2 => self.write_cr2(value, context)?,
            register::OAR1 | register::OAR2 if value & 1 << 15 != 0 => {
                return Err(self.unmodelled("own addresses (target mode) are not modelled"));
            }
            register::OAR1 => self.oar1 = value & 0x7FF,
            register::OAR2 => self.oar2 = value & 0x7FE,
            register::TIMINGR if self.enabled() => {
                self.misuse("TIMINGR is written while PE is 1 (RM0399, 50.7.5)", context);
            }
            register::TIMINGR => self.timingr = value & 0xF0FF_FFFF,
            register::TIMEOUTR => self.write_timeoutr(value, context)?,
            register::ISR => self.write_isr(value),
            register::ICR => {
                self.flags &= !(value & isr::CLEARED_BY_ICR);
                // ADDRCF also cancels a START that still waits for the bus.
                if value & isr::ADDR != 0 && matches!(self.phase, Phase::Waiting { .. }) {
                    self.cr2 &= !cr2::START;
                    self.phase = Phase::Idle;
                }
            }
            register::TXDR => self.write_txdr(value as u8, context),
            register::PECR | register::RXDR => self.misuse("a read-only register is written (RM0399, 50.7)", context),
            _ => return Err(Unmodelled::register(self.instance.name, offset)),
        }
        self.update_lines(context);
        Ok(())
    }

    fn next_event_ns(&self) -> u64 {
        self.next_ns()
    }

    fn stable_until_ns(&self, offset: u32, _: u64) -> Option<u64> {
        // While the controller drives nothing, each read samples the lines, so ISR may change.
        let under_way = self.owns_bus && self.phase.end_ns().is_some();
        (offset == register::ISR && under_way).then(|| self.next_ns())
    }

    fn advance(&mut self, context: &mut Context<'_>) {
        self.bring_to_now(context);
        self.update_lines(context);
    }

    fn clocks_changed(&mut self, context: &mut Context<'_>) {
        let kernel_hz = self.kernel_hz_of(context.clocks);
        if kernel_hz != self.kernel_hz && self.owns_bus {
            self.misuse("the kernel clock changes within a transfer (RM0399, 50.4.5)", context);
        }
        self.kernel_hz = kernel_hz;
    }

    fn reset(&mut self, context: &mut Context<'_>) {
        // The line levels stay so that their changes are reported, and tBUF passes on the bus regardless of the reset.
        let kept = (self.lines, self.free_ns);
        if let Some(fresh) = Self::new(self.instance.number) {
            *self = fresh;
        }
        (self.lines, self.free_ns) = kept;
        self.update_lines(context);
    }
}
