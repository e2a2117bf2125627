//! Timers TIM1 to 8 and 12 to 17 (RM0399, one chapter for each group).
//!
//! **Time.** A timer counts nothing by itself: whenever it is looked at it works out, exactly, what has happened since the
//! last time. It asks to be advanced ([`Peripheral::next_event_ns`]) only for what others can see: an enabled interrupt or DMA
//! request, a trigger output that fires, an edge of an enabled output, a captured edge that a filter still holds back. A free
//! running timer costs nothing; any number of its periods is skipped at once.
//!
//! **Outputs.** An edge of an output is told as `Signal::TimerOutput` with its exact time. Edges that follow one another within
//! [`OUTPUT_BATCH_NS`] may be told together, late by at most that, so that a fast PWM does not cost an event for each; an edge
//! after a longer pause is told at its time. Accesses and other events tell what is due as well, so edges are always told in
//! order, and before anything that an access does. A disabled output counts as low ([`Tim::drives`] tells whether it drives).
//!
//! **Inputs.** [`Tim::edge`] takes the edges of the pins, each before the timer is accessed at a later time. Behind the filter
//! they are captured, or move an encoder's count. Two clock periods of synchronization are left out. TI1 of TIM15, 16 and 17 can be
//! an oscillator (TISEL, `source`), by which a program compares one clock with another.
//!
//! Not modelled, and refused: center-aligned and down counting, slave modes other than the encoder's, capture of TRC, the
//! external trigger, combined and retriggerable modes, channels 5 and 6, complementary outputs, commutation. Break inputs are
//! ignored, and reported when they are enabled.

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
use crate::peripherals::width;

/// How late an output's edge may be told, when another was told this short before it.
pub const OUTPUT_BATCH_NS: u64 = 20_000;

/// CR1.
const CEN: u32 = 1;
const UDIS: u32 = 1 << 1;
const URS: u32 = 1 << 2;
const OPM: u32 = 1 << 3;
const DIR: u32 = 1 << 4;
const CMS: u32 = 3 << 5;
const ARPE: u32 = 1 << 7;
const UIFREMAP: u32 = 1 << 11;
/// CR2.
const CCDS: u32 = 1 << 3;
/// SR and DIER.
const UIF: u32 = 1;
const UDE: u32 = 1 << 8;
/// BDTR.
const OSSI: u32 = 1 << 10;
const AOE: u32 = 1 << 14;
const MOE: u32 = 1 << 15;

/// A timer.
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
    /// The prescaler, the auto-reload value and the repetitions as written, and as in use.
    psc_preload: u32,
    psc: u32,
    arr_preload: u64,
    arr: u64,
    rcr_preload: u32,
    /// Overflows until the next update.
    repetitions: u32,
    count: u64,
    channels: [Channel; 4],
    inputs: [Input; 4],
    /// What TI1 is instead of the pin.
    source: Option<Source>,
    /// The timer's clock since counting began, and how much of it was counted.
    clock: Ticks,
    done: u64,
    /// Clocks within the present count.
    prescaled: u64,
    /// Up to when everything is worked out.
    now_ns: u64,
    /// Something has happened since the next event was worked out.
    crossed: bool,
    /// When an output's edge was last told.
    told_ns: u64,
    next_ns: u64,
    /// Interrupt lines that are set, by index in the kind's vectors.
    lines: u8,
    /// Accesses to DMAR within the present burst, and the request that asked for it.
    burst: u32,
    burst_request: u8,
}

impl Tim {
    /// TIM`number`, as after a reset.
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
            // BKINE and BK2INE are set after reset.
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

    /// The pin of input TI`channel` (1 to 4) has this level from `at_ns` on. Also to be called when a pin is connected to the
    /// timer. Edges come in order of time, and before the timer is accessed or advanced beyond them; one that is late counts
    /// as of the last look.
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

    /// Whether an edge at input TI`channel` does anything.
    #[must_use]
    pub fn listens(&self, channel: u8) -> bool {
        let index = usize::from(channel).wrapping_sub(1);
        let encoder = self.encoder_mode().is_some() && index < 2 && self.cr1 & CEN != 0;
        index < self.kind.channels && (encoder || self.capturing(index).next().is_some())
    }

    /// Whether an edge at input TI`channel` must be told when it happens, because an interrupt or a DMA request may follow.
    #[must_use]
    pub fn watches(&self, channel: u8) -> bool {
        let index = usize::from(channel).wrapping_sub(1);
        if index >= self.kind.channels {
            return false;
        }
        let encoder = self.encoder_mode().is_some() && index < 2 && self.dier & 0x1f1f != 0;
        encoder || self.capturing(index).any(|channel| self.dier >> channel & 0x202 != 0)
    }

    /// Whether the levels of its inputs must be up to date for an access: they move the count or are captured, or the write
    /// may be the one from which on they do.
    #[must_use]
    pub fn needs_inputs(&self, offset: u32, write: bool) -> bool {
        let encoder = self.encoder_mode().is_some() && self.cr1 & CEN != 0;
        let captures = |index| self.is_enabled(index) && !self.is_output(index);
        // SR, DIER, CNT and CCRx set nothing up.
        let sets_up = write && !matches!(offset & !3, 0x0C | 0x10 | 0x24 | 0x34..=0x40);
        sets_up || encoder || (0..self.kind.channels).any(captures)
    }

    /// [`Tim::watches`] of every input: bit 0 is TI1.
    #[must_use]
    pub fn watching(&self) -> u8 {
        if self.dier & 0x1f1f == 0 {
            return 0;
        }
        let first = u8::from(self.source.is_some());
        (first..4).filter(|index| self.watches(index + 1)).fold(0, |bits, index| bits | 1 << index)
    }

    /// The level of output OC`channel` (1 to 4); low when it does not drive.
    #[must_use]
    pub fn output(&self, channel: u8) -> bool {
        self.channels.get(usize::from(channel).wrapping_sub(1)).is_some_and(|channel| channel.level)
    }

    /// Whether output OC`channel` drives its pin: CCxE, and with a main output enable (TIM1, 8, 15 to 17) MOE or OSSI.
    #[must_use]
    pub fn drives(&self, channel: u8) -> bool {
        let index = usize::from(channel).wrapping_sub(1);
        index < self.kind.channels && self.is_driving(index)
    }

    /// Works out what has happened, up to now.
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

    /// Sets interrupt lines and the next event by the present state.
    fn leave(&mut self, context: &mut Context<'_>) {
        // Enable bits lie as their flags, but BIE is for both break flags.
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
        Ok(width::part(value, offset, size))
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
