//! Timers TIM1 to TIM8 and TIM12 to TIM17 (RM0399, one chapter for each group).
//!
//! **Time.** A timer does not count by itself: at each access it computes exactly the events since the last one. It
//! requests to be advanced ([`Peripheral::next_event_ns`]) only for events that others can observe: an enabled
//! interrupt or DMA request, a trigger output that fires, an edge of an enabled output, a captured edge that a filter
//! still delays. A free-running timer costs nothing; any number of its periods is skipped at once.
//!
//! **Outputs.** An edge of an output is a `Signal::TimerOutput` with its exact time. Edges that follow one another
//! within [`OUTPUT_BATCH_NS`] may be reported together, late by at most that, so that a fast PWM does not cost an event
//! for each; an edge after a longer pause is reported at its time. Accesses and other events report due edges as well,
//! so edges always come in order, and before any effect of an access. A disabled output counts as low ([`Tim::drives`]
//! returns whether it drives).
//!
//! **Inputs.** [`Tim::edge`] takes the edges of the pins, each before the timer is accessed at a later time. Behind the
//! filter they are captured, or move an encoder's count. Two clock periods of synchronization are not modelled. TI1 of
//! TIM15, 16 and 17 can be an oscillator (TISEL, `source`), by which a program compares one clock with another.
//!
//! Center-aligned and down counting, slave modes other than the encoder's, capture of TRC, the external trigger,
//! combined and retriggerable modes, channels 5 and 6, complementary outputs and commutation are not modelled and end
//! the run. Break inputs are ignored, and reported when they are enabled.

mod channel;
mod count;
mod input;
mod kind;
mod registers;
mod source;
#[cfg(test)]
mod tests;

use channel::Channel;
use input::Input;
use kind::Kind;
use source::Source;

use crate::context::{Context, Signal, Ticks};
use crate::peripheral::{Peripheral, Size, Unmodelled};
use crate::peripherals::access;

/// Largest delay in the report of an output's edge that follows another one within this time, ns.
pub const OUTPUT_BATCH_NS: u64 = 20_000;

/// Bits of the register CR1.
const CEN: u32 = 1;
const UDIS: u32 = 1 << 1;
const URS: u32 = 1 << 2;
const OPM: u32 = 1 << 3;
const DIR: u32 = 1 << 4;
const CMS: u32 = 3 << 5;
const ARPE: u32 = 1 << 7;
const UIFREMAP: u32 = 1 << 11;
/// Bit of the register CR2.
const CCDS: u32 = 1 << 3;
/// Bits of the registers SR and DIER.
const UIF: u32 = 1;
const UDE: u32 = 1 << 8;
/// Bits of the register BDTR.
const OSSI: u32 = 1 << 10;
const AOE: u32 = 1 << 14;
const MOE: u32 = 1 << 15;

/// State of one timer.
#[derive(Debug)]
pub struct Tim {
    kind: &'static Kind,
    cr1: u32,
    cr2: u32,
    smcr: u32,
    dier: u32,
    sr: u32,
    ccmr: [u32; 2],
    ccer: u32,
    bdtr: u32,
    dcr: u32,
    af: [u32; 2],
    /// Prescaler, auto-reload value and repetitions, as written and as in use.
    psc_preload: u32,
    psc: u32,
    arr_preload: u64,
    arr: u64,
    rcr_preload: u32,
    /// Number of overflows until the next update.
    repetitions: u32,
    count: u64,
    channels: [Channel; 4],
    inputs: [Input; 4],
    /// Oscillator at TI1 in place of the pin.
    source: Option<Source>,
    /// Ticks of the timer's clock since counting began, and the number already counted.
    clock: Ticks,
    done: u64,
    /// Clocks within the present count (prescaler).
    prescaled: u64,
    /// Time up to which everything is computed, ns.
    now_ns: u64,
    /// An event has occurred since the next one was computed.
    crossed: bool,
    /// Time of the last report of an output's edge, ns.
    told_ns: u64,
    next_ns: u64,
    /// Asserted interrupt lines, by index in the kind's vectors.
    lines: u8,
    /// Number of accesses to DMAR in the present burst, and the request that started it.
    burst: u32,
    burst_request: u8,
}

impl Tim {
    /// Makes TIM`number` in its reset state.
    ///
    /// # Panics
    /// If the chip has no such timer: there are 1 to 8 and 12 to 17.
    #[must_use]
    pub fn new(number: u8) -> Self {
        let kind = Kind::of(number).unwrap_or_else(|| panic!("the STM32H747 has no TIM{number}"));
        Self::of_kind(kind)
    }

    fn of_kind(kind: &'static Kind) -> Self {
        Self {
            kind,
            cr1: 0,
            cr2: 0,
            smcr: 0,
            dier: 0,
            sr: 0,
            ccmr: [0; 2],
            ccer: 0,
            bdtr: 0,
            dcr: 0,
            // After reset, BKINE and BK2INE are set.
            af: if kind.has_break() { [1; 2] } else { [0; 2] },
            psc_preload: 0,
            psc: 0,
            arr_preload: kind.top(),
            arr: kind.top(),
            rcr_preload: 0,
            repetitions: 0,
            count: 0,
            channels: Default::default(),
            inputs: Default::default(),
            source: None,
            clock: Ticks { start_ns: 0, frequency_hz: 0, divider: 1 },
            done: 0,
            prescaled: 0,
            now_ns: 0,
            crossed: false,
            told_ns: 0,
            next_ns: u64::MAX,
            lines: 0,
            burst: 0,
            burst_request: 0,
        }
    }

    /// Sets the level at the pin of input TI`channel` (1 to 4) from `at_ns` on; call it also when a pin is connected to
    /// the timer. Edges come in order of time, and before the timer is accessed or advanced beyond them; a late one
    /// counts as of the last access.
    pub fn edge(&mut self, channel: u8, high: bool, at_ns: u64, context: &mut Context<'_>) {
        let Some(index) = usize::from(channel).checked_sub(1).filter(|&index| index < self.kind.channels) else {
            return;
        };
        if index == 0 && self.source.is_some() {
            return;
        }
        let at_ns = at_ns.max(self.now_ns);
        self.run_to(at_ns, context);
        if self.inputs[index].raw == high {
            return;
        }
        let filter_ns = self.filter_ns(index);
        if self.inputs[index].edge(high, at_ns, filter_ns) {
            self.input_changed(index, at_ns, context);
        }
        self.leave(context);
    }

    /// Returns true if an edge at input TI`channel` has any effect.
    #[must_use]
    pub fn listens(&self, channel: u8) -> bool {
        let index = usize::from(channel).wrapping_sub(1);
        let encoder = self.encoder_mode().is_some() && index < 2 && self.cr1 & CEN != 0;
        index < self.kind.channels && (encoder || self.capturing(index).next().is_some())
    }

    /// Returns true if an edge at input TI`channel` must be reported at its time, because an interrupt or a DMA request
    /// may follow.
    #[must_use]
    pub fn watches(&self, channel: u8) -> bool {
        let index = usize::from(channel).wrapping_sub(1);
        if index >= self.kind.channels {
            return false;
        }
        let encoder = self.encoder_mode().is_some() && index < 2 && self.dier & 0x1f1f != 0;
        encoder || self.capturing(index).any(|channel| self.dier >> channel & 0x202 != 0)
    }

    /// Returns true if the input levels must be up to date for an access: they move the count or are captured, or the
    /// write may enable that.
    #[must_use]
    pub fn needs_inputs(&self, offset: u32, write: bool) -> bool {
        let encoder = self.encoder_mode().is_some() && self.cr1 & CEN != 0;
        let captures = |index| self.is_enabled(index) && !self.is_output(index);
        // Writes to SR, DIER, CNT and CCRx configure nothing.
        let sets_up = write && !matches!(offset & !3, 0x0C | 0x10 | 0x24 | 0x34..=0x40);
        sets_up || encoder || (0..self.kind.channels).any(captures)
    }

    /// Returns [`Tim::watches`] of all inputs: bit 0 is TI1.
    #[must_use]
    pub fn watching(&self) -> u8 {
        if self.dier & 0x1f1f == 0 {
            return 0;
        }
        let first = u8::from(self.source.is_some());
        (first..4).filter(|index| self.watches(index + 1)).fold(0, |bits, index| bits | 1 << index)
    }

    /// Returns the level of output OC`channel` (1 to 4); low while it does not drive.
    #[must_use]
    pub fn output(&self, channel: u8) -> bool {
        self.channels.get(usize::from(channel).wrapping_sub(1)).is_some_and(|channel| channel.level)
    }

    /// Returns true if output OC`channel` drives its pin: CCxE, and with a main output enable (TIM1, 8, 15 to 17) MOE
    /// or OSSI.
    #[must_use]
    pub fn drives(&self, channel: u8) -> bool {
        let index = usize::from(channel).wrapping_sub(1);
        index < self.kind.channels && self.is_driving(index)
    }

    /// Computes all events up to now, before an access.
    fn enter(&mut self, context: &mut Context<'_>) {
        let now_ns = context.now_ns.max(self.now_ns);
        self.run_to(now_ns, context);
        if let Some(source) = &mut self.source {
            source.follow(self.kind.number, now_ns, context.clocks);
        }
        let frequency_hz = self.kind.hz(context.clocks);
        if frequency_hz != self.clock.frequency_hz {
            self.clock = Ticks { start_ns: now_ns, frequency_hz, divider: 1 };
            self.done = 0;
            self.crossed = true;
        }
    }

    /// Updates interrupt lines and the next event, after an access.
    fn leave(&mut self, context: &mut Context<'_>) {
        // Enable bits are at the places of their flags, except BIE, which enables both break flags.
        let enabled = self.dier & 0xff | (self.dier & 0x80) << 1;
        for (index, &(flags, number)) in self.kind.vectors.iter().enumerate() {
            let level = self.sr & enabled & flags != 0;
            if (self.lines >> index & 1 != 0) != level {
                self.lines ^= 1 << index;
                context.irq(number, level);
            }
        }
        self.crossed = false;
        self.next_ns = self.find_next_event();
    }

    fn trigger(&self, context: &mut Context<'_>) {
        // TIM13, 14, 16 and 17 have no trigger output.
        if !matches!(self.kind.number, 13 | 14 | 16 | 17) {
            context.signals.push(Signal::Trigger { timer: self.kind.number });
        }
    }

    fn master_mode(&self) -> u32 {
        self.cr2 >> 4 & 7
    }

    fn request(&mut self, request: u8, context: &mut Context<'_>) {
        if request != 0 {
            self.burst_request = request;
            context.dma(request, true);
        }
    }
}

impl Peripheral for Tim {
    fn read(&mut self, offset: u32, size: Size, context: &mut Context<'_>) -> Result<u32, Unmodelled> {
        self.enter(context);
        let sr = self.sr;
        let value = self.read_register(offset & !3, context)?;
        if self.crossed || sr != self.sr {
            self.leave(context);
        }
        Ok(access::part(value, offset, size))
    }

    fn write(&mut self, offset: u32, size: Size, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        self.enter(context);
        self.write_sized(offset, size, value, context)?;
        self.leave(context);
        Ok(())
    }

    fn next_event_ns(&self) -> u64 {
        self.next_ns
    }

    fn advance(&mut self, context: &mut Context<'_>) {
        self.enter(context);
        self.leave(context);
    }

    fn clocks_changed(&mut self, context: &mut Context<'_>) {
        self.advance(context);
    }

    fn reset(&mut self, context: &mut Context<'_>) {
        self.enter(context);
        for request in self.kind.channel_requests.into_iter().chain([self.kind.update_request]).filter(|&id| id != 0) {
            if self.dier & 0x1f00 != 0 {
                context.dma(request, false);
            }
        }
        let old = std::mem::replace(self, Self::of_kind(self.kind));
        self.now_ns = old.now_ns;
        self.clock = old.clock;
        self.lines = old.lines;
        for (index, (channel, input)) in old.channels.iter().zip(old.inputs).enumerate() {
            self.channels[index].level = channel.level;
            self.inputs[index] = Input { raw: input.raw, filtered: input.raw, passes_ns: None };
        }
        self.tell_outputs(self.now_ns, context);
        self.leave(context);
    }
}
