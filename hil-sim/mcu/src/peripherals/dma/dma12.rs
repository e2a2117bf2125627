//! DMA1, DMA2 and DMAMUX1, which are adjacent on the bus and work as one.

use super::controller::{Controller, STREAMS};
use super::mux::{DMAMUX1, Mux};
use super::stream::Wanted;
use super::{Beat, BusError};
use crate::context::Context;
use crate::peripheral::{Peripheral, Size, Unmodelled};
use crate::peripherals::access;

/// Part of [`Dma12`] with its own reset bit in RCC.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// DMA1, with channels 0 to 7 of DMAMUX1.
    Dma1,
    /// DMA2, with channels 8 to 15.
    Dma2,
    /// The request multiplexer DMAMUX1.
    Dmamux1,
}

/// DMA1 (offset 0x000), DMA2 (0x400) and DMAMUX1 (0x800) from base address 0x4002_0000.
///
/// DMA1's streams are channels 0 to 7 of the multiplexer, DMA2's 8 to 15.
#[derive(Debug)]
pub struct Dma12 {
    mux: Mux,
    controllers: [Controller; 2],
    /// Access returned by [`Dma12::next_beat`] and not finished yet.
    current: Option<(usize, usize, Wanted)>,
    /// No stream wants an access, and nothing has changed since that was found.
    quiet: bool,
}

impl Default for Dma12 {
    fn default() -> Self {
        Self::new()
    }
}

impl Dma12 {
    /// Makes the controllers in their reset state.
    #[must_use]
    pub fn new() -> Self {
        Self {
            mux: Mux::new(&DMAMUX1, 2 * STREAMS),
            controllers: [
                Controller::new("DMA1", [11, 12, 13, 14, 15, 16, 17, 47]),
                Controller::new("DMA2", [56, 57, 58, 59, 60, 68, 69, 70]),
            ],
            current: None,
            quiet: false,
        }
    }

    /// Sets a request line of a peripheral (`Signal::Dma`).
    pub fn request(&mut self, request: u8, level: bool) {
        self.mux.request(request, level);
        self.quiet &= !level;
    }

    /// Handles a pulse at an input of the request generators (RM0399, DMAMUX1, trigger inputs): TIM12's trigger output
    /// is 7, LPTIM1 to 3 are 3 to 5. The multiplexer's own events (0 to 2) are wired inside.
    pub fn trigger(&mut self, input: u8, context: &mut Context<'_>) {
        self.quiet = false;
        self.mux.trigger_pulse(input, context);
        self.mux.synchronize(input, true, context);
    }

    /// Handles an edge at an input of the request generators: EXTI line 0 is 6.
    pub fn trigger_edge(&mut self, input: u8, rising: bool, context: &mut Context<'_>) {
        self.quiet = false;
        self.mux.trigger_edge(input, rising, context);
        self.mux.synchronize(input, rising, context);
    }

    /// Returns the next access to the bus, which must be answered with [`Dma12::finish_beat`] before the next call.
    #[inline]
    pub fn next_beat(&mut self) -> Option<Beat> {
        if self.quiet { None } else { self.find_beat() }
    }

    fn find_beat(&mut self) -> Option<Beat> {
        let mut all = self.controllers.iter().enumerate();
        let next = all.find_map(|(unit, one)| one.next(&self.mux, unit * STREAMS).map(|next| (unit, next)));
        let Some((unit, (number, wanted))) = next else {
            self.quiet = true;
            return None;
        };
        let channel = unit * STREAMS + number;
        // The acknowledge precedes the access, because the access may make the peripheral raise its request again.
        if wanted.serves {
            self.mux.acknowledge(channel);
        }
        self.current = Some((unit, number, wanted));
        Some(Beat { channel: channel as u8, address: wanted.address, size: wanted.size, access: wanted.access })
    }

    /// Completes the access with the value read (any value after a write), or with the refusal of the bus.
    ///
    /// Returns the request whose transfer ended with it, if any, for the ADCs' one-shot mode.
    pub fn finish_beat(&mut self, result: Result<u32, BusError>, context: &mut Context<'_>) -> Option<u8> {
        let (unit, number, wanted) = self.current.take()?;
        self.quiet = false;
        let request = self.mux.selected(unit * STREAMS + number);
        self.controllers[unit].finish(number, wanted, result, request, context);
        self.mux.carry_events(context);
        (!self.controllers[unit].is_enabled(number)).then_some(request)
    }

    /// Resets one part, as RCC does.
    pub fn reset_part(&mut self, part: Part, context: &mut Context<'_>) {
        self.quiet = false;
        match part {
            Part::Dma1 => self.controllers[0].reset(context),
            Part::Dma2 => self.controllers[1].reset(context),
            Part::Dmamux1 => self.mux.reset(context),
        }
    }

    fn register(&self, offset: u32) -> Result<u32, Unmodelled> {
        match offset {
            0x000..0x400 => self.controllers[0].read(offset),
            0x400..0x800 => self.controllers[1].read(offset - 0x400),
            _ => self.mux.read(offset.wrapping_sub(0x800)),
        }
    }
}

impl Peripheral for Dma12 {
    fn read(&mut self, offset: u32, size: Size, _context: &mut Context<'_>) -> Result<u32, Unmodelled> {
        Ok(access::part(self.register(offset & !3)?, offset, size))
    }

    fn write(&mut self, offset: u32, size: Size, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        self.advance(context);
        let value = if size == Size::Word {
            value
        } else {
            context.misuse(
                "DMA",
                format!("register at offset {offset:#05x} written in less than a word (RM0399, DMA, main features)"),
            );
            access::merged(self.register(offset & !3)?, offset, size, value)
        };
        let offset = offset & !3;
        match offset {
            0x000..0x400 => self.controllers[0].write(offset, value, context),
            0x400..0x800 => self.controllers[1].write(offset - 0x400, value, context),
            _ => self.mux.write(offset - 0x800, value, context),
        }
    }

    fn advance(&mut self, context: &mut Context<'_>) {
        self.quiet = false;
        for controller in &mut self.controllers {
            controller.renew(context.now_ns);
        }
    }

    fn reset(&mut self, context: &mut Context<'_>) {
        for part in [Part::Dma1, Part::Dma2, Part::Dmamux1] {
            self.reset_part(part, context);
        }
        self.current = None;
    }
}
