//! Accesses to the registers, and the progress of time.

use crate::context::Context;
use crate::peripheral::{Peripheral, Size, Unmodelled};

use super::registers::{self as register, cr1, cr2, cr3, isr, rqr};
use super::transmit::Transmitter;
use super::{PRESCALER, Usart};

impl Usart {
    fn unmodelled(&self, what: impl Into<String>) -> Unmodelled {
        Unmodelled { peripheral: self.port.name, what: what.into() }
    }

    /// Changes only the bits that are writable now; keeps the others and reports the attempt.
    fn locked(&self, register: &str, old: u32, new: u32, locked: u32, context: &mut Context<'_>) -> u32 {
        let refused = (old ^ new) & locked;
        if !self.enabled() || refused == 0 {
            return new;
        }
        context
            .misuse(self.port.name, format!("bits {refused:#010x} of {register} change while UE is 1 (RM0399, 51.8)"));
        new & !locked | old & locked
    }

    fn write_cr1(&mut self, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        if value & (cr1::MME | 1 << 1 | 1 << 27) != 0 {
            return Err(self.unmodelled("mute mode, stop mode and end of block (CR1) are not modelled"));
        }
        let value = self.locked("CR1", self.cr1, value, cr1::LOCKED, context);
        match value & (cr1::M1 | cr1::M0 | cr1::PCE) {
            cr1::M0 => return Err(self.unmodelled("nine data bits are not modelled")),
            word if word & cr1::M1 != 0 && word & cr1::M0 != 0 => {
                context.misuse(self.port.name, "M1 and M0 are both 1 (RM0399, 51.8.1: reserved)");
            }
            _ => (),
        }
        let old = std::mem::replace(&mut self.cr1, value);
        let turned = old ^ value;
        if turned & cr1::UE != 0 && !self.enabled() {
            self.switch_off(context);
        } else if turned & cr1::UE != 0 && self.half_bits_from(0).frequency_hz != 0 && self.brr < 16 {
            context.misuse(self.port.name, "UE is set with BRR below 16 (RM0399, 51.5.7)");
        }
        if !self.enabled() {
            return Ok(());
        }
        if turned & (cr1::UE | cr1::TE) != 0 {
            // The transmitter sends an idle frame first after TE or UE is set.
            if self.on(cr1::TE) {
                self.transmitter.send_idle_frame();
                self.load(self.half_bits_from(context.now_ns), 0);
            } else {
                self.cut_transmitter("TE", context);
                // Without a transmission TC is set at once (51.8.9).
                self.kept |= isr::TC;
            }
        }
        if turned & (cr1::UE | cr1::RE) != 0 {
            let idle_ns = self.half_bits_from(context.now_ns).when_ns(self.frame_half_bits());
            self.receiver.restart(context.now_ns, self.on(cr1::RE).then_some(idle_ns));
        }
        Ok(())
    }

    fn cut_transmitter(&mut self, bit: &str, context: &mut Context<'_>) {
        if self.transmitter.sends_data() {
            context.misuse(self.port.name, format!("{bit} is cleared within a frame, which is lost (RM0399, 51.5.5)"));
        }
        self.transmitter.cut();
    }

    /// Handles UE = 0: frames in progress are discarded, the flags are as after reset (RM0399, 51.8.1, UE).
    fn switch_off(&mut self, context: &mut Context<'_>) {
        self.cut_transmitter("UE", context);
        self.transmitter.flush();
        self.receiver.flush();
        self.receiver.restart(context.now_ns, None);
        self.kept = isr::TC;
        self.txfe_cleared = false;
    }

    fn write_cr2(&mut self, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        if value & !cr2::MODELLED != 0 {
            return Err(self.unmodelled(format!("CR2 = {value:#010x}: a mode that is not modelled")));
        }
        // While RE is 1, ADD is locked too.
        let add = if self.on(cr1::RE) { 0xFF << cr2::ADD_AT } else { 0 };
        let value = self.locked("CR2", self.cr2, value, cr2::LOCKED | add, context);
        if value & cr2::RTOEN == 0 {
            self.receiver.cancel_timeout();
        }
        self.cr2 = value;
        Ok(())
    }

    fn write_cr3(&mut self, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        if value & !cr3::MODELLED != 0 {
            return Err(self.unmodelled(format!("CR3 = {value:#010x}: a mode that is not modelled")));
        }
        if value >> cr3::TXFTCFG_AT & 7 > 5 || value >> cr3::RXFTCFG_AT & 7 > 5 {
            context.misuse(self.port.name, "a FIFO threshold above 5 (RM0399, 51.8.4: reserved)");
        }
        self.cr3 = self.locked("CR3", self.cr3, value, cr3::LOCKED, context);
        Ok(())
    }

    fn write_rqr(&mut self, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        if value & rqr::ALL & !(rqr::RXFRQ | rqr::TXFRQ) != 0 {
            return Err(self.unmodelled("breaks, mute mode and baud-rate detection (RQR) are not modelled"));
        }
        if value & rqr::RXFRQ != 0 {
            self.receiver.flush();
        }
        if value & rqr::TXFRQ != 0 {
            if !self.fifo() {
                context.misuse(self.port.name, "TXFRQ without FIFO is for Smartcard mode only (RM0399, 51.8.8)");
            }
            self.transmitter.flush();
            self.txfe_cleared = false;
        }
        Ok(())
    }

    fn write_icr(&mut self, value: u32) {
        self.kept &= !(value & isr::KEPT);
        if value & isr::TXFECF != 0 && self.transmitter.waiting() == 0 {
            self.txfe_cleared = true;
        }
    }

    /// Carries out all events up to now, in order of time.
    fn bring_to_now(&mut self, context: &mut Context<'_>) {
        self.kernel_hz = self.kernel_hz_of(context.clocks);
        loop {
            let sent_ns = self.transmitter.next_ns();
            let received = self.receiver_next();
            let received_ns = received.map_or(u64::MAX, |(at_ns, _)| at_ns);
            // At the same time, the transmitter's event comes first.
            if let Some(at_ns) = sent_ns.filter(|at_ns| *at_ns <= context.now_ns && *at_ns <= received_ns) {
                self.frame_sent(at_ns, context);
            } else if let Some((_, happens)) = received.filter(|(at_ns, _)| *at_ns <= context.now_ns) {
                self.receiver_event(happens);
            } else {
                break;
            }
        }
    }
}

impl Peripheral for Usart {
    fn read(&mut self, offset: u32, size: Size, context: &mut Context<'_>) -> Result<u32, Unmodelled> {
        self.bring_to_now(context);
        if size != Size::Word && offset != register::RDR {
            return Err(
                self.unmodelled(format!("read of {} bytes at {offset:#05x} (RM0399, 51.8: words)", size.bytes()))
            );
        }
        let value = match offset {
            register::CR1 => self.cr1,
            register::CR2 => self.cr2,
            register::CR3 => self.cr3,
            register::BRR => self.brr,
            register::RTOR => self.rtor,
            register::RQR | register::ICR => 0,
            register::ISR => self.isr(context.now_ns),
            register::RDR => self.take(),
            register::TDR => 0,
            register::PRESC => self.presc,
            _ => return Err(Unmodelled::register(self.port.name, offset)),
        };
        self.update_lines(context);
        Ok(value)
    }

    fn write(&mut self, offset: u32, size: Size, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        self.bring_to_now(context);
        if size != Size::Word && offset != register::TDR {
            return Err(
                self.unmodelled(format!("write of {} bytes at {offset:#05x} (RM0399, 51.8: words)", size.bytes()))
            );
        }
        match offset {
            register::CR1 => self.write_cr1(value, context)?,
            register::CR2 => self.write_cr2(value, context)?,
            register::CR3 => self.write_cr3(value, context)?,
            register::BRR => self.brr = self.locked("BRR", self.brr, value & 0xFFFF, 0xFFFF, context),
            register::PRESC => {
                if value & 0xF >= PRESCALER.len() as u32 {
                    context.misuse(self.port.name, "PRESCALER above 11 (RM0399, 51.8.14: reserved)");
                }
                self.presc = self.locked("PRESC", self.presc, value & 0xF, 0xF, context);
            }
            register::RTOR => self.rtor = value,
            register::RQR => self.write_rqr(value, context)?,
            register::ICR => self.write_icr(value),
            register::TDR => self.put(value as u8, context),
            register::ISR | register::RDR => {
                context
                    .misuse(self.port.name, format!("a read-only register at {offset:#05x} is written (RM0399, 51.8)"));
            }
            _ => return Err(Unmodelled::register(self.port.name, offset)),
        }
        self.update_lines(context);
        Ok(())
    }

    fn next_event_ns(&self) -> u64 {
        let received_ns = self.receiver_next().map_or(u64::MAX, |(at_ns, _)| at_ns);
        self.transmitter.next_ns().unwrap_or(u64::MAX).min(received_ns)
    }

    fn stable_until_ns(&self, offset: u32, _: u64) -> Option<u64> {
        // ISR is stable only without incoming frames: BUSY is set between events, and reading RDR has side effects.
        let quiet = self.receiver_next().is_none();
        (offset & !3 == register::ISR && quiet).then(|| self.next_event_ns())
    }

    fn advance(&mut self, context: &mut Context<'_>) {
        self.bring_to_now(context);
        self.update_lines(context);
    }

    fn clocks_changed(&mut self, context: &mut Context<'_>) {
        let kernel_hz = self.kernel_hz_of(context.clocks);
        if kernel_hz != self.kernel_hz {
            self.kernel_hz = kernel_hz;
            self.retime(context);
        }
    }

    fn reset(&mut self, context: &mut Context<'_>) {
        self.cr1 = 0;
        self.cr2 = 0;
        self.cr3 = 0;
        self.brr = 0;
        self.rtor = 0;
        self.presc = 0;
        self.kept = isr::TC;
        self.txfe_cleared = false;
        self.transmitter = Transmitter::default();
        self.receiver.reset(context.now_ns);
        self.update_lines(context);
    }
}
