//! Register accesses: reads, writes, and refused settings.

use super::{ARPE, CEN, CMS, DIR, MOE, Source, Tim, UDE, UIF, UIFREMAP};
use crate::context::{Context, Ticks};
use crate::peripheral::{Size, Unmodelled};
use crate::peripherals::access;

const CR1: u32 = 0x00;
const CR2: u32 = 0x04;
const SMCR: u32 = 0x08;
const DIER: u32 = 0x0c;
const SR: u32 = 0x10;
const EGR: u32 = 0x14;
const CCMR1: u32 = 0x18;
const CCMR2: u32 = 0x1c;
const CCER: u32 = 0x20;
const CNT: u32 = 0x24;
const PSC: u32 = 0x28;
const ARR: u32 = 0x2c;
const RCR: u32 = 0x30;
const CCR1: u32 = 0x34;
const CCR4: u32 = 0x40;
const BDTR: u32 = 0x44;
const DCR: u32 = 0x48;
const DMAR: u32 = 0x4c;
const AF1: u32 = 0x60;
const AF2: u32 = 0x64;
const TISEL: u32 = 0x68;

impl Tim {
    fn has(&self, offset: u32) -> bool {
        let kind = self.kind;
        let channels = kind.channels;
        match offset {
            CR1 | DIER | SR | EGR | CNT | PSC | ARR => true,
            CR2 => kind.has_cr2,
            SMCR => kind.has_smcr,
            CCMR1 | CCER | TISEL => channels > 0,
            CCMR2 => channels > 2,
            RCR | BDTR => kind.has_break(),
            CCR1..=CCR4 => ((offset - CCR1) / 4) < channels as u32,
            DCR | DMAR => kind.has_burst,
            AF1 => kind.has_burst,
            AF2 => kind.has_break() && kind.has_encoder,
            _ => false,
        }
    }

    fn refuse<T>(&self, what: impl Into<String>) -> Result<T, Unmodelled> {
        Err(Unmodelled { peripheral: self.kind.name, what: what.into() })
    }

    pub(super) fn read_register(&mut self, offset: u32, context: &mut Context<'_>) -> Result<u32, Unmodelled> {
        if offset == DMAR && self.has(DMAR) {
            let target = self.burst_target(context);
            return self.read_register(target, context);
        }
        let value = self.peek(offset)?;
        if (CCR1..=CCR4).contains(&offset) {
            let index = ((offset - CCR1) / 4) as usize;
            if !self.is_output(index) {
                // Reading a captured value clears its flag.
                self.sr &= !(2 << index);
            }
        }
        Ok(value)
    }

    /// Returns a register's value without the side effects of a read.
    fn peek(&self, offset: u32) -> Result<u32, Unmodelled> {
        if !self.has(offset) {
            return Err(Unmodelled::register(self.kind.name, offset));
        }
        Ok(match offset {
            CR1 => self.cr1,
            CR2 => self.cr2,
            SMCR => self.smcr,
            DIER => self.dier,
            SR => self.sr,
            CCMR1 => self.ccmr[0],
            CCMR2 => self.ccmr[1],
            CCER => self.ccer,
            CNT if self.cr1 & UIFREMAP != 0 => self.count as u32 & 0x7fff_ffff | (self.sr & UIF) << 31,
            CNT => self.count as u32,
            PSC => self.psc_preload,
            ARR => self.arr_preload as u32,
            RCR => self.rcr_preload,
            CCR1..=CCR4 => self.channels[((offset - CCR1) / 4) as usize].preload as u32,
            BDTR => self.bdtr,
            DCR => self.dcr,
            AF1 => self.af[0],
            AF2 => self.af[1],
            TISEL => self.source.map_or(0, |source| source.select()),
            // EGR is write-only.
            _ => 0,
        })
    }

    pub(super) fn write_sized(
        &mut self,
        offset: u32,
        size: Size,
        value: u32,
        context: &mut Context<'_>,
    ) -> Result<(), Unmodelled> {
        let register = offset & !3;
        let value = match (size, register) {
            (Size::Word, _) => value,
            (Size::Byte, _) => {
                context.misuse(
                    self.kind.name,
                    format!("register {register:#x} written by a byte (RM0399, TIM2 to 5, registers)"),
                );
                return self.refuse(format!("a byte written to offset {offset:#x}"));
            }
            // Unwritten bits must have no effect.
            (Size::Half, EGR) => access::merged(0, offset, size, value),
            (Size::Half, SR) => access::merged(u32::MAX, offset, size, value),
            (Size::Half, DMAR) => value,
            (Size::Half, _) => access::merged(self.peek(register)?, offset, size, value),
        };
        self.write_register(register, value, context)
    }

    fn write_register(&mut self, offset: u32, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        if !self.has(offset) {
            return Err(Unmodelled::register(self.kind.name, offset));
        }
        match offset {
            CR1 => return self.write_cr1(value, context),
            CR2 => return self.write_cr2(value, context),
            SMCR => return self.write_smcr(value, context),
            DIER => self.write_dier(value, context),
            SR => self.sr &= value,
            EGR => return self.write_egr(value, context),
            CCMR1 | CCMR2 => return self.write_ccmr(((offset - CCMR1) / 4) as usize, value, context),
            CCER => return self.write_ccer(value, context),
            CNT => {
                self.count = u64::from(value) & self.kind.top();
                self.tell_outputs(self.now_ns, context);
            }
            PSC => self.psc_preload = value & 0xffff,
            ARR => {
                self.arr_preload = u64::from(value) & self.kind.top();
                // Without preload the new limit applies at once; with it, from the next update event on.
                if self.cr1 & ARPE == 0 {
                    self.arr = self.arr_preload;
                }
            }
            RCR => self.rcr_preload = value & self.kind.repetition,
            CCR1..=CCR4 => self.write_ccr(((offset - CCR1) / 4) as usize, value, context),
            BDTR => self.write_bdtr(value, context),
            DCR => {
                self.dcr = value & 0x1f1f;
                // A write of DCR starts the burst at its base address again.
                self.burst = 0;
            }
            DMAR => {
                let target = self.burst_target(context);
                return self.write_register(target, value, context);
            }
            AF1 => self.af[0] = value & self.kind.af1_bits(),
            AF2 => self.af[1] = value & 0xf07,
            _ if value == 0 => self.source = None,
            _ => match Source::new(self.kind.number, value, self.now_ns, context.clocks) {
                Some(source) if self.source.is_none_or(|before| before.select() != value) => self.source = Some(source),
                Some(_) => {}
                None => {
                    return self.refuse(format!("an input other than the pin, LSI, LSE and HSE (TISEL {value:#x})"));
                }
            },
        }
        Ok(())
    }

    fn write_cr1(&mut self, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        let mut mask = 0x88f;
        if self.kind.channels > 0 {
            mask |= 3 << 8;
        }
        if self.kind.has_encoder {
            mask |= DIR | CMS;
        }
        let mut value = value & mask;
        if value & CMS != 0 {
            return self.refuse("center-aligned counting (CMS)");
        }
        // In encoder mode DIR is read-only: the inputs define the direction.
        if self.encoder_mode().is_some() {
            value = value & !DIR | self.cr1 & DIR;
        }
        let started = value & !self.cr1 & CEN != 0;
        self.cr1 = value;
        // The end of preload makes a pending limit effective at once.
        if value & ARPE == 0 {
            self.arr = self.arr_preload;
        }
        self.check_direction()?;
        // The prescaler's clock counts from the rising edge of CEN.
        if started {
            let frequency_hz = self.kind.hz(context.clocks);
            self.clock = Ticks { start_ns: self.now_ns, frequency_hz, divider: 1 };
            self.done = 0;
            // MMS = 1: the trigger output is the counter enable.
            if self.master_mode() == 1 {
                self.trigger(context);
            }
        }
        Ok(())
    }

    fn check_direction(&self) -> Result<(), Unmodelled> {
        let down = self.is_running() && self.cr1 & DIR != 0;
        if down { self.refuse("counting down (DIR)") } else { Ok(()) }
    }

    fn write_cr2(&mut self, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        if value & 0b1000_0101 != 0 {
            return self.refuse("CCPC, CCUS or TI1S in CR2");
        }
        if value & 0x40 != 0 || value & 0x00f0_0000 != 0 {
            return self.refuse("a trigger output other than reset, enable, update and compare pulse (MMS, MMS2)");
        }
        self.cr2 = value & self.kind.cr2_bits();
        self.tell_outputs(self.now_ns, context);
        Ok(())
    }

    fn write_smcr(&mut self, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        let value = value & self.kind.smcr_bits();
        let mode = value & 7 | (value >> 16 & 1) << 3;
        if mode > 3 || mode > 0 && !self.kind.has_encoder {
            return self.refuse(format!("slave mode {mode} (SMS)"));
        }
        if value & 1 << 14 != 0 {
            return self.refuse("external clock mode 2 (ECE)");
        }
        let was_running = self.is_running();
        self.smcr = value;
        // The internal clock counts again after the encoder mode, from now on.
        if !was_running && self.is_running() {
            self.clock = Ticks { start_ns: self.now_ns, frequency_hz: self.kind.hz(context.clocks), divider: 1 };
            self.done = 0;
        }
        self.check_direction()
    }

    fn write_dier(&mut self, value: u32, context: &mut Context<'_>) {
        let channels = (1_u32 << self.kind.channels) - 1;
        let mut mask = 1 | channels << 1;
        if self.kind.has_smcr {
            mask |= 0x40;
        }
        if self.kind.has_break() {
            mask |= 0xa0;
        }
        if self.kind.update_request != 0 {
            mask |= UDE | channels << 9;
            if self.kind.has_smcr {
                mask |= 0x4000;
            }
            if self.kind.has_break() {
                mask |= 0x2000;
            }
        }
        let value = value & mask;
        // A request that is disabled is withdrawn.
        let ended = self.dier & !value;
        self.dier = value;
        if ended & UDE != 0 {
            context.dma(self.kind.update_request, false);
        }
        for index in 0..self.kind.channels {
            let request = self.kind.channel_requests[index];
            if ended >> index & 0x200 != 0 && request != 0 {
                context.dma(request, false);
            }
        }
    }

    fn write_egr(&mut self, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        for index in (0..self.kind.channels).filter(|index| value >> index & 2 != 0) {
            if self.is_output(index) {
                self.compare_event(index, context);
            } else {
                self.capture(index, context);
            }
        }
        if value & 1 << 5 != 0 && self.kind.has_break() {
            return self.refuse("commutation (COMG)");
        }
        if value & 1 << 6 != 0 && self.kind.has_smcr {
            self.sr |= 1 << 6;
        }
        for (bit, flag) in [(1 << 7, 1 << 7), (1 << 8, 1 << 8)] {
            if value & bit != 0 && self.kind.has_break() {
                self.sr |= flag;
                self.bdtr &= !MOE;
                self.tell_outputs(self.now_ns, context);
            }
        }
        if value & 1 != 0 {
            self.generate_update(context);
        }
        Ok(())
    }

    fn write_ccmr(&mut self, register: usize, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        let used = self.kind.channels.saturating_sub(2 * register).min(2);
        let value = value & if used == 2 { 0x0101_ffff } else { 0x0001_00ff };
        for half in 0..used {
            let bits = value >> (8 * half);
            let index = 2 * register + half;
            match bits & 3 {
                0 if bits & 0x1_0000 != 0 => return self.refuse(format!("OC{}M above 7", index + 1)),
                0 if bits & 0x80 != 0 => return self.refuse(format!("OC{}CE", index + 1)),
                3 => return self.refuse(format!("capture of TRC by channel {}", index + 1)),
                _ => {}
            }
            if (bits ^ self.mode_byte(index)) & 3 != 0 && self.is_enabled(index) {
                context.misuse(
                    self.kind.name,
                    format!("CC{}S written while the channel is enabled (RM0399, TIMx_CCMR1)", index + 1),
                );
            }
        }
        self.ccmr[register] = value;
        for index in 2 * register..2 * register + used {
            if self.is_output(index) && !self.is_preloaded(index) {
                self.channels[index].compare = self.channels[index].preload;
            }
        }
        self.tell_outputs(self.now_ns, context);
        Ok(())
    }

    fn write_ccer(&mut self, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        let mask = ((1_u64 << (4 * self.kind.channels)) - 1) as u32;
        if value & mask & 0x4444 != 0 {
            return self.refuse("complementary outputs (CCxNE)");
        }
        if value & !0xffff != 0 {
            return self.refuse("channels 5 and 6 (CCER)");
        }
        self.ccer = value & mask;
        for index in 0..self.kind.channels {
            if !self.is_enabled(index) {
                self.channels[index].edges = 0;
            }
        }
        self.tell_outputs(self.now_ns, context);
        Ok(())
    }

    fn write_ccr(&mut self, index: usize, value: u32, context: &mut Context<'_>) {
        // CCRx is read-only while the channel is an input.
        if !self.is_output(index) {
            return;
        }
        let preloaded = self.is_preloaded(index);
        let channel = &mut self.channels[index];
        channel.preload = u64::from(value) & self.kind.top();
        if !preloaded {
            channel.compare = channel.preload;
            self.tell_outputs(self.now_ns, context);
        }
    }

    fn write_bdtr(&mut self, value: u32, context: &mut Context<'_>) {
        if value & !self.bdtr & (1 << 12 | 1 << 24) != 0 {
            context
                .misuse(self.kind.name, "a break input is enabled (BKE, BK2E); here it is ignored (RM0399, TIMx_BDTR)");
        }
        self.bdtr = value & self.kind.bdtr_bits();
        self.tell_outputs(self.now_ns, context);
    }

    /// Returns the register that an access to DMAR reaches; the timer repeats its request until the burst is complete
    /// (RM0399, TIM2 to 5, DMA burst mode).
    fn burst_target(&mut self, context: &mut Context<'_>) -> u32 {
        let target = 4 * ((self.dcr & 0x1f) + self.burst);
        self.burst += 1;
        if self.burst > self.dcr >> 8 & 0x1f {
            self.burst = 0;
        } else if self.burst_request != 0 {
            context.dma(self.burst_request, true);
        }
        // A burst that reaches DMAR itself addresses no register.
        if target == DMAR { u32::MAX } else { target }
    }
}
