//! ADC1 and ADC2 with their common registers (RM0399, ADC), silicon revision V.
//!
//! Modelled are regular conversions: software start or a timer's trigger output, single or continuous sequences,
//! oversampling, DMA. An input is sampled once per conversion, at its end, and so are the `OSVR + 1` parts of an
//! oversampled one; EOSMP comes with EOC. Codes are those of an ideal converter with a reference of 3.3 V: the voltage
//! over the reference times 2 to the resolution, rounded down and limited to the range. So calibration takes its time
//! but finds no error.
//!
//! Injected conversions, analog watchdogs, discontinuous and auto-delayed mode, offsets, differential inputs, dual
//! modes, internal channels and the direct pads PA0_C and PA1_C are not modelled and end the run.

mod converter;
#[cfg(test)]
mod tests;

use converter::Converter;

use crate::context::{Clocks, Context};
use crate::peripheral::{Peripheral, Size, Unmodelled};
use crate::peripherals::access;

const IRQ: u16 = 18;
/// Clock source and divider fields of CCR, the only ones with an effect in the model.
const CLOCKING: u32 = 0x003f_0000;

/// ADC1 (offset 0x000), ADC2 (0x100) and their common registers (0x300) from base address 0x4002_2000.
#[derive(Debug)]
pub struct Adc12 {
    converters: [Converter; 2],
    common: u32,
    line: bool,
}

impl Default for Adc12 {
    fn default() -> Self {
        Self::new()
    }
}

/// Divided clock of the converters: a tick of `frequency_hz / divider` is half a period of the ADC clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Clock {
    frequency_hz: u64,
    divider: u64,
}

impl Adc12 {
    /// Makes the converters in their reset state.
    #[must_use]
    pub fn new() -> Self {
        Self { converters: [Converter::new(1), Converter::new(2)], common: 0, line: false }
    }

    /// Handles a timer's trigger output (`Signal::Trigger`).
    pub fn trigger(&mut self, timer: u8, context: &mut Context<'_>) {
        self.enter(context);
        for converter in &mut self.converters {
            converter.trigger(timer, context.now_ns);
        }
        self.leave(context);
    }

    /// Handles the last item of a DMA transfer for this request (9 is ADC1, 10 ADC2): in one-shot mode it ends the
    /// conversions.
    pub fn dma_ended(&mut self, request: u8, context: &mut Context<'_>) {
        self.enter(context);
        for converter in &mut self.converters {
            converter.dma_ended(request, context);
        }
        self.leave(context);
    }

    /// Returns the clock of the converters (RM0399, ADC, clocks), with revision V's fixed divider by 2 behind the
    /// others.
    fn clock(&self, clocks: &Clocks) -> Clock {
        const DIVIDERS: [u64; 12] = [1, 2, 4, 6, 8, 10, 12, 16, 32, 64, 128, 256];
        let (frequency_hz, divider) = match self.common >> 16 & 3 {
            0 => (clocks.adc_hz, DIVIDERS.get((self.common >> 18 & 15) as usize).copied().unwrap_or(256)),
            1 => (clocks.ahb_hz, 1),
            2 => (clocks.ahb_hz, 2),
            _ => (clocks.ahb_hz, 4),
        };
        Clock { frequency_hz: 2 * frequency_hz, divider: 2 * divider }
    }

    fn enter(&mut self, context: &mut Context<'_>) {
        let clock = self.clock(context.clocks);
        for converter in &mut self.converters {
            converter.run(clock, context);
        }
    }

    fn leave(&mut self, context: &mut Context<'_>) {
        for converter in &mut self.converters {
            converter.tell_request(context);
        }
        let line = self.converters.iter().any(Converter::interrupts);
        if self.line != line {
            self.line = line;
            context.irq(IRQ, line);
        }
    }

    fn read_register(&mut self, offset: u32) -> Result<u32, Unmodelled> {
        match offset {
            0x000..0x100 => self.converters[0].read(offset),
            0x100..0x200 => self.converters[1].read(offset - 0x100),
            0x300 => Ok(self.converters[0].status() & 0x7ff | (self.converters[1].status() & 0x7ff) << 16),
            0x308 => Ok(self.common),
            _ => Err(Unmodelled::register("ADC12", offset)),
        }
    }

    fn write_common(&mut self, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        if value & 0x1f != 0 {
            return Err(Unmodelled { peripheral: "ADC12", what: "dual modes (DUAL)".into() });
        }
        if value & 0x01c0_0000 != 0 {
            return Err(Unmodelled {
                peripheral: "ADC12",
                what: "internal channels (VREFEN, VSENSEEN, VBATEN)".into(),
            });
        }
        if (value ^ self.common) & CLOCKING != 0 && self.converters.iter().any(Converter::is_on) {
            context.misuse("ADC12", "the clock changed while an ADC is enabled (RM0399, ADCx_CCR)");
        }
        self.common = value & 0x01ff_cf1f;
        Ok(())
    }
}

impl Peripheral for Adc12 {
    fn read(&mut self, offset: u32, size: Size, context: &mut Context<'_>) -> Result<u32, Unmodelled> {
        self.enter(context);
        let value = self.read_register(offset & !3)?;
        self.leave(context);
        Ok(access::part(value, offset, size))
    }

    fn write(&mut self, offset: u32, size: Size, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        self.enter(context);
        if size != Size::Word {
            return Err(Unmodelled {
                peripheral: "ADC12",
                what: format!("a write of less than a word at {offset:#05x}"),
            });
        }
        let clock = self.clock(context.clocks);
        match offset {
            0x000..0x100 => self.converters[0].write(offset, value, clock, context)?,
            0x100..0x200 => self.converters[1].write(offset - 0x100, value, clock, context)?,
            0x308 => self.write_common(value, context)?,
            0x300 => {}
            _ => return Err(Unmodelled::register("ADC12", offset)),
        }
        // A changed divider counts from this moment.
        self.enter(context);
        self.leave(context);
        Ok(())
    }

    fn next_event_ns(&self) -> u64 {
        self.converters.iter().map(Converter::next_event_ns).min().unwrap_or(u64::MAX)
    }

    fn advance(&mut self, context: &mut Context<'_>) {
        self.enter(context);
        self.leave(context);
    }

    fn clocks_changed(&mut self, context: &mut Context<'_>) {
        self.advance(context);
    }

    fn reset(&mut self, context: &mut Context<'_>) {
        for converter in &mut self.converters {
            converter.reset();
        }
        self.common = 0;
        self.leave(context);
    }
}
