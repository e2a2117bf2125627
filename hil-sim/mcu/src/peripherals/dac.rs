//! DAC1 (RM0399, DAC): two channels, on PA4 and PA5.
//!
//! A channel's output is `DOR / 4096` of its 3.3 V reference, immediately and to the rails: settling, and the 0.2 V
//! that a buffered output keeps from them, are not modelled. The voltage of a channel that does not drive its pin is
//! reported as 0 V, where a load pulls it.
//!
//! Wave generation, sample and hold, calibration, and triggers other than software and timers are not modelled and end
//! the run.

use crate::context::Context;
use crate::outside::Pin;
use crate::peripheral::{Peripheral, Size, Unmodelled};
use crate::peripherals::access;

const NAME: &str = "DAC1";
/// Interrupt number, shared with TIM6.
const IRQ: u16 = 54;
/// Input numbers of DMAMUX1, by channel.
const REQUESTS: [u8; 2] = [67, 68];
const PINS: [Pin; 2] = [Pin::new('A', 4), Pin::new('A', 5)];
const VREF_V: f64 = 3.3;

/// Bits of a channel's half of CR.
const EN: u32 = 1;
const TEN: u32 = 1 << 1;
const WAVE: u32 = 3 << 6;
const DMAEN: u32 = 1 << 12;
const DMAUDRIE: u32 = 1 << 13;
const CEN: u32 = 1 << 14;
/// Bit of a channel's half of SR.
const DMAUDR: u32 = 1 << 13;

#[derive(Clone, Copy, Debug, Default)]
struct Channel {
    /// Half of CR for this channel.
    control: u32,
    /// Field MODEx of MCR.
    mode: u32,
    /// Registers DHRx and DORx, 12 bits.
    holding: u32,
    output: u32,
    /// DMA underrun flag, DMAUDRx.
    underrun: bool,
    /// A DMA request was made and not served yet.
    asked: bool,
    /// Voltage last reported to the outside world, V.
    volts: f64,
}

impl Channel {
    fn drives(&self) -> bool {
        // Mode 3 connects the output to other peripherals only.
        self.control & EN != 0 && self.mode != 3
    }

    fn hold(&mut self, value: u32) {
        self.holding = value & 0xfff;
        self.asked = false;
        if self.control & TEN == 0 {
            self.output = self.holding;
        }
    }

    /// Returns the timer whose trigger output TSELx selects (RM0399, DAC, trigger selection); 0 for the software
    /// trigger.
    fn trigger_source(&self) -> Option<u8> {
        [0, 1, 2, 4, 5, 6, 7, 8, 15].get((self.control >> 2 & 15) as usize).copied()
    }
}

/// Digital-to-analog converter DAC1, base address 0x4000_7400.
#[derive(Debug, Default)]
pub struct Dac {
    channels: [Channel; 2],
    /// Register CCR, which only stores what is written.
    trim: u32,
    line: bool,
}

impl Dac {
    /// Makes the converter in its reset state.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Handles a timer's trigger output (`Signal::Trigger`).
    pub fn trigger(&mut self, timer: u8, context: &mut Context<'_>) {
        for (channel, request) in self.channels.iter_mut().zip(REQUESTS) {
            if channel.control & (EN | TEN) != EN | TEN || channel.trigger_source() != Some(timer) {
                continue;
            }
            channel.output = channel.holding;
            if channel.control & DMAEN != 0 && !channel.underrun {
                // A trigger before the last request was served ends DMA requests (RM0399, DAC, DMA requests).
                channel.underrun = channel.asked;
                channel.asked = true;
                if !channel.underrun {
                    context.dma(request, true);
                }
            }
        }
        self.tell(context);
    }

    fn tell(&mut self, context: &mut Context<'_>) {
        for (channel, pin) in self.channels.iter_mut().zip(PINS) {
            let volts = if channel.drives() { VREF_V * f64::from(channel.output) / 4096.0 } else { 0.0 };
            if channel.volts != volts {
                channel.volts = volts;
                context.outside.set_volts(context.now_ns, pin, volts);
            }
        }
        let line = self.channels.iter().any(|channel| channel.underrun && channel.control & DMAUDRIE != 0);
        if self.line != line {
            self.line = line;
            context.irq(IRQ, line);
        }
    }

    fn register(&self, offset: u32) -> Result<u32, Unmodelled> {
        let [first, second] = &self.channels;
        Ok(match offset {
            0x00 => first.control | second.control << 16,
            // SWTRIGR is write-only.
            0x04 => 0,
            0x08 => first.holding,
            0x0c => first.holding << 4,
            0x10 => first.holding >> 4,
            0x14 => second.holding,
            0x18 => second.holding << 4,
            0x1c => second.holding >> 4,
            0x20 => first.holding | second.holding << 16,
            0x24 => first.holding << 4 | second.holding << 20,
            0x28 => first.holding >> 4 | second.holding >> 4 << 8,
            0x2c => first.output,
            0x30 => second.output,
            0x34 => u32::from(first.underrun) << 13 | u32::from(second.underrun) << 29,
            0x38 => self.trim,
            0x3c => first.mode | second.mode << 16,
            _ => return Err(Unmodelled::register(NAME, offset)),
        })
    }

    fn refuse<T>(what: impl Into<String>) -> Result<T, Unmodelled> {
        Err(Unmodelled { peripheral: NAME, what: what.into() })
    }

    fn write_control(&mut self, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        for (index, channel) in self.channels.iter_mut().enumerate() {
            let new = value >> (16 * index) & 0x7fff;
            let number = index + 1;
            if new & WAVE != 0 {
                return Self::refuse(format!("wave generation on channel {number} (WAVE{number})"));
            }
            if new & CEN != 0 {
                return Self::refuse(format!("calibration of channel {number} (CEN{number})"));
            }
            let old = std::mem::replace(&mut channel.control, new);
            if new & TEN != 0 && channel.trigger_source().is_none() {
                return Self::refuse(format!("trigger {} of channel {number} (TSEL{number})", new >> 2 & 15));
            }
            if new & TEN == 0 {
                channel.output = channel.holding;
            }
            if old & !new & DMAEN != 0 {
                channel.asked = false;
                context.dma(REQUESTS[index], false);
            }
        }
        Ok(())
    }

    fn software_trigger(&mut self, value: u32) {
        for (index, channel) in self.channels.iter_mut().enumerate() {
            let selected = channel.control & (EN | TEN) == EN | TEN && channel.trigger_source() == Some(0);
            if value >> index & 1 != 0 && selected {
                // The software trigger makes no DMA request: only external triggers do (RM0399, DAC, DMA requests).
                channel.output = channel.holding;
            }
        }
    }

    fn write_mode(&mut self, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        for (index, channel) in self.channels.iter_mut().enumerate() {
            let mode = value >> (16 * index) & 7;
            if mode > 3 {
                return Self::refuse(format!("sample and hold on channel {} (MODE{})", index + 1, index + 1));
            }
            if mode != channel.mode && channel.control & EN != 0 {
                context
                    .misuse(NAME, format!("MODE{} changed while the channel is enabled (RM0399, DAC_MCR)", index + 1));
            }
            channel.mode = mode;
        }
        Ok(())
    }

    fn hold(&mut self, channel: usize, value: u32) {
        self.channels[channel].hold(value);
    }
}

impl Peripheral for Dac {
    fn read(&mut self, offset: u32, size: Size, _context: &mut Context<'_>) -> Result<u32, Unmodelled> {
        Ok(access::part(self.register(offset & !3)?, offset, size))
    }

    fn write(&mut self, offset: u32, size: Size, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        let register = offset & !3;
        let value = match register {
            // Unwritten bits are 0: they trigger nothing and clear nothing.
            0x04 | 0x34 => access::merged(0, offset, size, value),
            _ => access::merged(self.register(register)?, offset, size, value),
        };
        match register {
            0x00 => self.write_control(value, context)?,
            0x04 => self.software_trigger(value),
            0x08 => self.hold(0, value),
            0x0c => self.hold(0, value >> 4),
            0x10 => self.hold(0, (value & 0xff) << 4),
            0x14 => self.hold(1, value),
            0x18 => self.hold(1, value >> 4),
            0x1c => self.hold(1, (value & 0xff) << 4),
            0x20 => {
                self.hold(0, value);
                self.hold(1, value >> 16);
            }
            0x24 => {
                self.hold(0, value >> 4);
                self.hold(1, value >> 20);
            }
            0x28 => {
                self.hold(0, (value & 0xff) << 4);
                self.hold(1, (value >> 8 & 0xff) << 4);
            }
            0x34 => {
                for (index, channel) in self.channels.iter_mut().enumerate() {
                    channel.underrun &= value >> (16 * index) & DMAUDR == 0;
                }
            }
            0x38 => self.trim = value & 0x001f_001f,
            0x3c => self.write_mode(value, context)?,
            // DOR1 and DOR2 are read-only.
            _ => {}
        }
        self.tell(context);
        Ok(())
    }

    fn reset(&mut self, context: &mut Context<'_>) {
        for (index, channel) in self.channels.iter_mut().enumerate() {
            if channel.control & DMAEN != 0 {
                context.dma(REQUESTS[index], false);
            }
            *channel = Channel { volts: channel.volts, ..Channel::default() };
        }
        self.trim = 0;
        self.tell(context);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Signal;
    use crate::testing::{Bench, Event};

    fn volts(bench: &mut Bench) -> Vec<(Pin, f64)> {
        let volts = |event| if let Event::Volts { pin, volts, .. } = event { Some((pin, volts)) } else { None };
        bench.take_events().into_iter().filter_map(volts).collect()
    }

    #[test]
    fn a_voltage_follows_the_data_while_enabled() {
        let (mut bench, mut dac) = (Bench::default(), Dac::new());
        bench.write(&mut dac, 0x08, 0x800);
        assert_eq!(volts(&mut bench), [], "not enabled");
        bench.write(&mut dac, 0x00, EN | EN << 16);
        assert_eq!(volts(&mut bench), [(PINS[0], 1.65)]);
        bench.write(&mut dac, 0x14, 0xfff);
        assert_eq!(volts(&mut bench), [(PINS[1], 3.3 * 4095.0 / 4096.0)]);
        assert_eq!((bench.read(&mut dac, 0x2c), bench.read(&mut dac, 0x30)), (0x800, 0xfff));
        bench.write(&mut dac, 0x00, EN << 16);
        assert_eq!(volts(&mut bench), [(PINS[0], 0.0)]);
    }

    #[test]
    fn data_can_be_written_in_every_alignment() {
        let (mut bench, mut dac) = (Bench::default(), Dac::new());
        // Cases: register, value, and both outputs afterwards.
        let cases = [
            (0x08, 0xf123, (0x123, 0)),
            (0x0c, 0x456f, (0x456, 0)),
            (0x10, 0x178, (0x780, 0)),
            (0x18, 0x9abc, (0x780, 0x9ab)),
            (0x1c, 0xde, (0x780, 0xde0)),
            (0x20, 0x0234_0567, (0x567, 0x234)),
            (0x24, 0x1230_4560, (0x456, 0x123)),
            (0x28, 0xabcd, (0xcd0, 0xab0)),
        ];
        for (offset, value, outputs) in cases {
            bench.write(&mut dac, offset, value);
            assert_eq!((bench.read(&mut dac, 0x2c), bench.read(&mut dac, 0x30)), outputs, "{offset:#x}");
        }
        assert_eq!(bench.read(&mut dac, 0x20), 0x0ab0_0cd0);
        // DMA writes with these widths.
        bench.try_write(&mut dac, 0x08, Size::Half, 0x321).unwrap();
        bench.try_write(&mut dac, 0x1c, Size::Byte, 0x65).unwrap();
        assert_eq!((bench.read(&mut dac, 0x2c), bench.read(&mut dac, 0x30)), (0x321, 0x650));
    }

    #[test]
    fn triggered_data_waits() {
        let (mut bench, mut dac) = (Bench::default(), Dac::new());
        bench.write(&mut dac, 0x00, EN | TEN);
        bench.write(&mut dac, 0x08, 0x400);
        assert_eq!(bench.read(&mut dac, 0x2c), 0);
        bench.write(&mut dac, 0x04, 2);
        assert_eq!(bench.read(&mut dac, 0x2c), 0, "that is the other channel");
        bench.write(&mut dac, 0x04, 1);
        assert_eq!(bench.read(&mut dac, 0x2c), 0x400);
        assert_eq!(volts(&mut bench), [(PINS[0], 0.825)]);
        // TSEL 5 selects TIM6.
        bench.write(&mut dac, 0x00, EN | TEN | 5 << 2);
        bench.write(&mut dac, 0x08, 0x500);
        bench.write(&mut dac, 0x04, 1);
        dac.trigger(7, &mut bench.context());
        assert_eq!(bench.read(&mut dac, 0x2c), 0x400);
        dac.trigger(6, &mut bench.context());
        assert_eq!(bench.read(&mut dac, 0x2c), 0x500);
    }

    #[test]
    fn dma_refills_and_an_underrun_ends_it() {
        let (mut bench, mut dac) = (Bench::default(), Dac::new());
        bench.write(&mut dac, 0x00, (EN | TEN | 5 << 2 | DMAEN | DMAUDRIE) << 16);
        let ask = Signal::Dma { request: 68, level: true };
        dac.trigger(6, &mut bench.context());
        assert_eq!(bench.take_signals(), [ask]);
        bench.write(&mut dac, 0x14, 0x111);
        dac.trigger(6, &mut bench.context());
        assert_eq!((bench.read(&mut dac, 0x30), bench.take_signals()), (0x111, vec![ask]));
        dac.trigger(6, &mut bench.context());
        assert_eq!(bench.read(&mut dac, 0x34), DMAUDR << 16);
        assert_eq!(bench.take_signals(), [Signal::Irq { number: 54, level: true }]);
        bench.write(&mut dac, 0x34, DMAUDR << 16);
        assert_eq!(bench.take_signals(), [Signal::Irq { number: 54, level: false }]);
        bench.write(&mut dac, 0x00, 0);
        assert_eq!(bench.take_signals(), [Signal::Dma { request: 68, level: false }]);
    }

    #[test]
    fn modes() {
        let (mut bench, mut dac) = (Bench::default(), Dac::new());
        bench.write(&mut dac, 0x3c, 3);
        bench.write(&mut dac, 0x00, EN);
        bench.write(&mut dac, 0x08, 0x800);
        assert_eq!(volts(&mut bench), [], "inside the chip only");
        bench.write(&mut dac, 0x3c, 2);
        assert_eq!(bench.take_misuse().len(), 1);
        assert_eq!(volts(&mut bench), [(PINS[0], 1.65)]);
        dac.reset(&mut bench.context());
        assert_eq!(volts(&mut bench), [(PINS[0], 0.0)]);
        for (offset, value) in [(0x3c, 4), (0x00, WAVE), (0x00, CEN << 16), (0x00, EN | TEN | 9 << 2), (0x40, 0)] {
            assert!(bench.try_write(&mut Dac::new(), offset, Size::Word, value).is_err(), "{offset:#x} {value:#x}");
        }
    }
}
