//! Accesses to the registers and the message RAM, and the progress of time.

use crate::context::Context;
use crate::peripheral::{Peripheral, Size, Unmodelled};

use super::errors::LastError;
use super::ram;
use super::registers::{self as register, PROTECTED, cccr, ir, psr, test};
use super::{Fdcan, Module};

/// Offsets of the parts.
const FDCAN2_AT: u32 = 0x400;
const CCU_AT: u32 = 0x800;
const RAM_AT: u32 = 0xC00;

impl Module {
    fn unmodelled(&self, what: impl Into<String>) -> Unmodelled {
        Unmodelled { peripheral: self.name, what: what.into() }
    }

    fn configurable(&self) -> bool {
        self.on(cccr::INIT) && self.on(cccr::CCE)
    }

    fn read(&mut self, offset: u32, now_ns: u64) -> Result<u32, Unmodelled> {
        let lost = |flag: u32| u32::from(self.reg(register::IR) & flag != 0) << 25;
        Ok(match offset {
            register::CREL => register::CREL_VALUE,
            register::ENDN => register::ENDN_VALUE,
            // The receive pin always reads recessive: single bits are not modelled.
            register::TEST => self.reg(offset) | test::RX,
            register::TSCV => self.timestamp(now_ns),
            register::TOCV => 0xFFFF,
            register::ECR => {
                // A read of ECR clears CEL.
                let logged = std::mem::take(&mut self.errors.logged);
                self.errors.ecr() | logged << 16
            }
            register::PSR => {
                let value = self.psr(now_ns);
                // A read of PSR sets LEC and DLEC to "no change" and clears the event flags.
                self.errors.last = LastError::NoChange;
                self.errors.last_in_data = LastError::NoChange;
                self.protocol &= !(psr::PXE | psr::REDL | psr::RBRS | psr::RESI);
                value
            }
            register::RXF0S => self.fifos[0].status(self.fifo_size(0)) | lost(ir::RF0L),
            register::RXF1S => self.fifos[1].status(self.fifo_size(1)) | lost(ir::RF0L << 4),
            register::TXEFS => self.tx_events.status(self.tx_event_size()) | lost(ir::TEFL),
            register::TXFQS => self.txfqs(),
            register::RXF0A => self.fifos[0].get.saturating_sub(1) as u32,
            register::RXF1A => self.fifos[1].get.saturating_sub(1) as u32,
            register::TXEFA => self.tx_events.get.saturating_sub(1) as u32,
            register::TXBAR => 0,
            _ if self.is_stored(offset) => self.reg(offset),
            _ => return Err(Unmodelled::register(self.name, offset)),
        })
    }

    /// Returns true for registers that read as they were written.
    fn is_stored(&self, offset: u32) -> bool {
        matches!(
            offset,
            register::CCCR
                | register::IR
                | register::IE
                | register::ILS
                | register::ILE
                | register::HPMS
                | register::NDAT1
                | register::NDAT2
                | register::TXBRP
                | register::TXBCR
                | register::TXBTO
                | register::TXBCF
                | register::TXBTIE
                | register::TXBCIE
        ) || PROTECTED.iter().any(|(protected, _)| *protected == offset)
    }

    fn tx_event_size(&self) -> usize {
        (self.reg(register::TXEFC) >> 16 & 0x3F).min(32) as usize
    }

    fn write(&mut self, offset: u32, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        if let Some((_, bits)) = PROTECTED.iter().find(|(protected, _)| *protected == offset) {
            return self.write_protected(offset, value & bits, context);
        }
        match offset {
            register::CCCR => self.write_cccr(value, context),
            register::TEST if !self.on(cccr::TEST) => {
                if value & (test::LBCK | test::TX) != 0 {
                    context.misuse(self.name, "TEST is written while CCCR.TEST is 0 (RM0399, 59.5.4)");
                }
            }
            register::TEST if value & test::TX != 0 => {
                return Err(self.unmodelled("software control of the transmit pin (TEST.TX) is not modelled"));
            }
            register::TEST => self.set_reg(offset, value & test::LBCK),
            // A write of any value clears the counter.
            register::TSCV => self.timestamp_start_ns = context.now_ns,
            register::TOCV => (),
            // Flags are cleared by writing 1, here and in the two NDAT registers.
            register::IR => self.set_reg(offset, self.reg(offset) & !value),
            register::IE | register::ILS => self.set_reg(offset, value & ir::ALL),
            register::ILE => self.set_reg(offset, value & 3),
            register::NDAT1 | register::NDAT2 => self.set_reg(offset, self.reg(offset) & !value),
            register::RXF0A => self.acknowledge(0, value, context),
            register::RXF1A => self.acknowledge(1, value, context),
            register::TXEFA => {
                let size = self.tx_event_size();
                if !self.tx_events.acknowledge(value as usize & 0x1F, size) {
                    context.misuse(self.name, "TXEFA is an element that is not held (RM0399, 59.4.3)");
                }
            }
            register::TXBAR => self.add_requests(value, context),
            register::TXBCR => self.add_cancellations(value, context),
            register::TXBTIE | register::TXBCIE => self.set_reg(offset, value),
            _ if self.is_stored(offset) => {
                context.misuse(self.name, format!("a read-only register at {offset:#05x} is written (RM0399, 59.5)"));
            }
            register::CREL | register::ENDN | register::ECR | register::PSR => {
                context.misuse(self.name, format!("a read-only register at {offset:#05x} is written (RM0399, 59.5)"));
            }
            register::RXF0S | register::RXF1S | register::TXFQS | register::TXEFS => {
                context.misuse(self.name, format!("a read-only register at {offset:#05x} is written (RM0399, 59.5)"));
            }
            _ => return Err(Unmodelled::register(self.name, offset)),
        }
        Ok(())
    }

    fn acknowledge(&mut self, fifo: usize, value: u32, context: &mut Context<'_>) {
        let size = self.fifo_size(fifo);
        if !self.fifos[fifo].acknowledge(value as usize & 0x3F, size) {
            context.misuse(self.name, format!("RXF{fifo}A is an element that is not held (RM0399, 59.4.3)"));
        }
    }

    fn write_protected(&mut self, offset: u32, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        if !self.configurable() {
            // A write of the present value has no effect, so it is no misuse.
            if value != self.reg(offset) {
                context.misuse(
                    self.name,
                    format!("the register at {offset:#05x} is written without CCE and INIT (RM0399, 59.4.1)"),
                );
            }
            return Ok(());
        }
        if offset == register::TSCC && value & 3 == 2 {
            return Err(self.unmodelled("timestamps of TIM3 (TSCC.TSS = 2) are not modelled"));
        }
        if offset == register::TOCC && value & 1 != 0 {
            return Err(self.unmodelled("the timeout counter (TOCC.ETOC) is not modelled"));
        }
        // The timestamp counter counts nominal bit times, so it starts anew with a new one.
        if offset == register::TSCC || offset == register::NBTP {
            self.timestamp_start_ns = context.now_ns;
        }
        self.set_reg(offset, value);
        Ok(())
    }

    fn write_cccr(&mut self, value: u32, context: &mut Context<'_>) {
        let old = self.reg(register::CCCR);
        // CSA is read-only.
        let mut new = value & 0xF3FF & !cccr::CSA | old & cccr::CSA;
        if !self.configurable() {
            let refused = (old ^ new) & cccr::PROTECTED | new & !old & cccr::SET_PROTECTED;
            if refused != 0 {
                context.misuse(
                    self.name,
                    format!("bits {refused:#06x} of CCCR change without CCE and INIT (RM0399, 59.4.1)"),
                );
                new = new & !refused | old & refused;
            }
        }
        // CCE requires that INIT was 1 before, and falls with INIT.
        if new & cccr::CCE != 0 && (old & cccr::INIT == 0 || new & cccr::INIT == 0) {
            if old & cccr::CCE == 0 {
                context.misuse(self.name, "CCE is set while INIT is 0 (RM0399, 59.4.1)");
            }
            new &= !cccr::CCE;
        }
        if old & cccr::CSA != 0 {
            // INIT stays set until the clock stop request is withdrawn.
            new |= cccr::INIT;
            if new & cccr::CSR == 0 {
                new &= !cccr::CSA;
            }
        }
        self.set_reg(register::CCCR, new);
        if new & cccr::TEST == 0 {
            self.set_reg(register::TEST, 0);
        }
        if new & !old & cccr::CCE != 0 {
            self.enter_configuration();
        }
        if new & !old & cccr::INIT != 0 {
            self.enter_init();
        }
        if old & !new & cccr::INIT != 0 {
            self.check_bit_timing(context);
            self.leave_init(context.now_ns);
        }
        // In bus monitoring mode the node sends nothing.
        if new & cccr::MON != 0 && !self.loops_back() {
            self.set_reg(register::TXBRP, 0);
        }
        self.stop_clock_if_asked(context.now_ns);
    }

    /// Checks the manual's rules for clocks and bit times.
    fn check_bit_timing(&self, context: &mut Context<'_>) {
        if self.kernel_hz > self.apb_hz {
            context.misuse(self.name, "the kernel clock is faster than the APB clock (RM0399, 59.4.5)");
        }
        let nominal = self.reg(register::NBTP);
        if (nominal >> 8 & 0xFF) + (nominal & 0x7F) + 3 < 4 || self.kernel_hz == 0 {
            context.misuse(self.name, "no bit time of at least 4 quanta, or no kernel clock (RM0399, 59.5.7)");
        }
        if self.on(cccr::BRSE) && self.data().clocks() > self.nominal().clocks() {
            context.misuse(self.name, "the data phase is slower than the nominal bit rate (RM0399, 59.5.3)");
        }
    }
}

impl Fdcan {
    pub(super) fn bring_to_now(&mut self, context: &mut Context<'_>) {
        for module in &mut self.modules {
            module.bring_to_now(&mut self.ram, context);
        }
    }

    fn update_lines(&mut self, context: &mut Context<'_>) {
        for module in &mut self.modules {
            module.update_lines(context);
        }
    }
}

/// Returns the module an offset belongs to, and the offset in it; `None` is the message RAM.
fn part(offset: u32) -> Result<Option<(u8, u32)>, Unmodelled> {
    match offset {
        0..FDCAN2_AT => Ok(Some((1, offset))),
        FDCAN2_AT..CCU_AT => Ok(Some((2, offset - FDCAN2_AT))),
        CCU_AT..RAM_AT => Err(Unmodelled::register("FDCAN_CCU", offset - CCU_AT)),
        _ if (offset - RAM_AT) as usize / 4 < ram::WORDS => Ok(None),
        _ => Err(Unmodelled::register("FDCAN message RAM", offset - RAM_AT)),
    }
}

impl Peripheral for Fdcan {
    fn read(&mut self, offset: u32, size: Size, context: &mut Context<'_>) -> Result<u32, Unmodelled> {
        self.bring_to_now(context);
        let value = match part(offset)? {
            None => {
                let word = self.ram.word((offset - RAM_AT) as usize / 4) >> (8 * (offset % 4));
                match size {
                    Size::Byte => word & 0xFF,
                    Size::Half => word & 0xFFFF,
                    Size::Word => word,
                }
            }
            Some((bus, _)) if size != Size::Word => {
                return Err(self.module(bus).unmodelled("registers are read as words"));
            }
            Some((bus, offset)) => self.module_mut(bus).read(offset, context.now_ns)?,
        };
        self.update_lines(context);
        Ok(value)
    }

    fn write(&mut self, offset: u32, size: Size, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        self.bring_to_now(context);
        match part(offset)? {
            None if size != Size::Word => {
                context.misuse("FDCAN message RAM", "the message RAM is written as words only (RM0399, 59.4.2)");
                return Ok(());
            }
            None => self.ram.set_word((offset - RAM_AT) as usize / 4, value),
            Some((bus, _)) if size != Size::Word => {
                return Err(self.module(bus).unmodelled("registers are written as words"));
            }
            Some((bus, offset)) => self.module_mut(bus).write(offset, value, context)?,
        }
        // A frame that may begin now begins at once.
        self.bring_to_now(context);
        self.update_lines(context);
        Ok(())
    }

    fn next_event_ns(&self) -> u64 {
        self.modules[0].next_event_ns().min(self.modules[1].next_event_ns())
    }

    fn advance(&mut self, context: &mut Context<'_>) {
        self.bring_to_now(context);
        self.update_lines(context);
    }

    fn clocks_changed(&mut self, context: &mut Context<'_>) {
        for module in &mut self.modules {
            if context.clocks.fdcan_hz != module.kernel_hz && module.transmission.is_some() {
                context.misuse(module.name, "the kernel clock changes within a frame (RM0399, 59.4.4)");
            }
            module.use_clocks(context.clocks);
        }
    }

    fn reset(&mut self, context: &mut Context<'_>) {
        for module in &mut self.modules {
            // Frames under way are on the bus, not in the module, so that a reset keeps them.
            let kept = (std::mem::take(&mut module.coming), module.lines);
            *module = Module::new(module.bus);
            (module.coming, module.lines) = kept;
            module.use_clocks(context.clocks);
        }
        self.update_lines(context);
    }
}
