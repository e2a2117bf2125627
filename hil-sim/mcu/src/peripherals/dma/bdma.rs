//! BDMA and DMAMUX2 in domain D3 (RM0399, BDMA, DMAMUX): eight channels without FIFO.

use super::mux::{DMAMUX2, Mux};
use super::{Access, Beat, BusError, Patience, size_of_code};
use crate::context::Context;
use crate::peripheral::{Peripheral, Size, Unmodelled};
use crate::peripherals::access;

const CHANNELS: usize = 8;
const FIRST_IRQ: u16 = 129;

const EN: u32 = 1;
const TEIE: u32 = 1 << 3;
const FROM_MEMORY: u32 = 1 << 4;
const CIRC: u32 = 1 << 5;
const PINC: u32 = 1 << 6;
const MINC: u32 = 1 << 7;
const MEM2MEM: u32 = 1 << 14;
const DBM: u32 = 1 << 15;
const CT: u32 = 1 << 16;
/// Interrupt enable bits, at the same places in CCRx as their flags in ISR: transfer complete, half transfer, transfer
/// error.
const INTERRUPTS: u32 = 0xe;

const TCIF: u32 = 1 << 1;
const HTIF: u32 = 1 << 2;
const TEIF: u32 = 1 << 3;

#[derive(Clone, Debug, Default)]
struct Channel {
    control: u32,
    remaining: u32,
    programmed: u32,
    peripheral_address: u32,
    memory_address: [u32; 2],
    flags: u32,
    /// Addresses of the next item at both ports.
    peripheral: u32,
    memory: u32,
    /// Item that was read and not written yet.
    held: Option<u32>,
    level: bool,
    patience: Patience,
}

impl Channel {
    /// Returns true for transfers from memory to the peripheral.
    fn reads_memory(&self) -> bool {
        self.control & FROM_MEMORY != 0
    }

    fn peripheral_side(&self) -> (u32, Size) {
        (self.peripheral, size_of_code(self.control >> 8).unwrap_or(Size::Word))
    }

    fn memory_side(&self) -> (u32, Size) {
        (self.memory, size_of_code(self.control >> 10).unwrap_or(Size::Word))
    }

    fn rewind(&mut self) {
        self.peripheral = self.peripheral_address;
        self.memory = self.memory_address[usize::from(self.control & CT != 0)];
    }

    fn wants(&self, request: bool) -> Option<(u32, Size, Access)> {
        let idle = self.control & EN == 0 || self.remaining == 0 || self.patience.is_over();
        if idle {
            return None;
        }
        let (source, destination) = if self.reads_memory() {
            (self.memory_side(), self.peripheral_side())
        } else {
            (self.peripheral_side(), self.memory_side())
        };
        match self.held {
            // Items are right-aligned: wider destinations get zeros, narrower ones the low part (RM0399, BDMA, data
            // width and alignment).
            Some(value) => Some((destination.0, destination.1, Access::Write(value))),
            None => (request || self.control & MEM2MEM != 0).then_some((source.0, source.1, Access::Read)),
        }
    }

    fn item_done(&mut self) {
        self.held = None;
        self.remaining -= 1;
        if self.control & PINC != 0 {
            self.peripheral = self.peripheral.wrapping_add(self.peripheral_side().1.bytes());
        }
        if self.control & MINC != 0 {
            self.memory = self.memory.wrapping_add(self.memory_side().1.bytes());
        }
        if self.remaining == self.programmed / 2 && self.remaining > 0 {
            self.flags |= HTIF;
        }
        if self.remaining > 0 {
            return;
        }
        self.flags |= TCIF;
        // Otherwise EN stays set, and no transfer follows until the program writes it again.
        if self.control & (CIRC | DBM) != 0 && self.control & MEM2MEM == 0 {
            if self.control & DBM != 0 {
                self.control ^= CT;
            }
            self.remaining = self.programmed;
            self.rewind();
        }
    }
}

/// BDMA (offset 0x000) and DMAMUX2 (0x400) from base address 0x5802_5400. It reaches domain D3 only: SRAM4 and D3's
/// peripherals; the bus refuses all other addresses.
#[derive(Debug)]
pub struct Bdma {
    mux: Mux,
    channels: [Channel; CHANNELS],
    current: Option<(usize, Access)>,
    /// No channel wants an access, and nothing has changed since that was found.
    quiet: bool,
}

impl Default for Bdma {
    fn default() -> Self {
        Self::new()
    }
}

impl Bdma {
    /// Makes the controller in its reset state.
    #[must_use]
    pub fn new() -> Self {
        Self { mux: Mux::new(&DMAMUX2, CHANNELS), channels: Default::default(), current: None, quiet: false }
    }

    /// Sets a request line of a peripheral (`Signal::Bdma`).
    pub fn request(&mut self, request: u8, level: bool) {
        self.mux.request(request, level);
        self.quiet &= !level;
    }

    /// Handles a pulse at an input of the request generators (RM0399, DMAMUX2, trigger inputs).
    pub fn trigger(&mut self, input: u8, context: &mut Context<'_>) {
        self.quiet = false;
        self.mux.trigger_pulse(input, context);
    }

    /// Returns the next access to the bus, which must be answered with [`Bdma::finish_beat`] before the next call. The
    /// order is that of priority, then number; an item that was read is written before all others.
    #[inline]
    pub fn next_beat(&mut self) -> Option<Beat> {
        if self.quiet { None } else { self.find_beat() }
    }

    fn find_beat(&mut self) -> Option<Beat> {
        let wanted = |number: usize| {
            let channel = &self.channels[number];
            channel.wants(self.mux.output(number)).map(|wanted| (number, wanted, channel.control >> 12 & 3))
        };
        let held = (0..CHANNELS).filter(|&number| self.channels[number].held.is_some()).find_map(wanted);
        let mut best = held;
        if best.is_none() {
            for next in (0..CHANNELS).filter_map(wanted) {
                // Strictly greater, so that the lower number wins among equal priorities.
                if best.as_ref().is_none_or(|(_, _, priority)| next.2 > *priority) {
                    best = Some(next);
                }
            }
        }
        let Some((number, (address, size, access), _)) = best else {
            self.quiet = true;
            return None;
        };
        let channel = &self.channels[number];
        // The access on the peripheral's side serves the request; memory to memory has none.
        let serves = (access == Access::Read) != channel.reads_memory();
        if serves && channel.control & MEM2MEM == 0 {
            self.mux.acknowledge(number);
        }
        self.current = Some((number, access));
        let access = match access {
            Access::Write(value) => Access::Write(access::part(value, 0, size)),
            Access::Read => Access::Read,
        };
        Some(Beat { channel: number as u8, address, size, access })
    }

    /// Completes the access with the value read (any value after a write), or with the refusal of the bus.
    pub fn finish_beat(&mut self, result: Result<u32, BusError>, context: &mut Context<'_>) {
        let Some((number, access)) = self.current.take() else { return };
        self.quiet = false;
        let request = self.mux.selected(number);
        let channel = &mut self.channels[number];
        match (result, access) {
            (Ok(value), Access::Read) => channel.held = Some(value),
            (Ok(_), Access::Write(_)) => channel.item_done(),
            (Err(BusError), _) => {
                let is_memory = channel.reads_memory() == (access == Access::Read);
                let address = if is_memory { channel.memory } else { channel.peripheral };
                context.misuse(
                    "BDMA",
                    format!("channel {number} cannot reach {address:#010x} (RM0399, BDMA, error management)"),
                );
                channel.flags |= TEIF;
                channel.control &= !EN;
                channel.held = None;
            }
        }
        // A request that never falls would stop virtual time.
        if channel.patience.spend(context.now_ns) {
            context
                .misuse("BDMA", format!("channel {number}: request {request} never falls, it waits until time passes"));
        }
        self.irq(number, context);
        self.mux.carry_events(context);
    }

    fn irq(&mut self, number: usize, context: &mut Context<'_>) {
        let channel = &mut self.channels[number];
        let level = channel.flags & channel.control & INTERRUPTS != 0;
        if channel.level != level {
            channel.level = level;
            context.irq(FIRST_IRQ + number as u16, level);
        }
    }

    fn register(&self, offset: u32) -> Result<u32, Unmodelled> {
        match offset {
            // GIFx is set while any of the channel's other flags is.
            0x00 => Ok((0..CHANNELS)
                .map(|n| (self.channels[n].flags | u32::from(self.channels[n].flags != 0)) << (4 * n))
                .sum()),
            0x04 => Ok(0),
            0x08..0xa8 => {
                let channel = &self.channels[((offset - 8) / 0x14) as usize];
                Ok(match (offset - 8) % 0x14 {
                    0x00 => channel.control,
                    0x04 => channel.remaining,
                    0x08 => channel.peripheral_address,
                    0x0c => channel.memory_address[0],
                    _ => channel.memory_address[1],
                })
            }
            0x400.. => self.mux.read(offset - 0x400),
            _ => Err(Unmodelled::register("BDMA", offset)),
        }
    }

    fn write_channel(&mut self, number: usize, register: u32, value: u32, context: &mut Context<'_>) {
        let channel = &mut self.channels[number];
        let enabled = channel.control & EN != 0;
        match register {
            0x00 if enabled => {
                // While the channel is enabled, only the interrupt bits, EN and CIRC are writable.
                let writable = EN | INTERRUPTS | CIRC;
                channel.control = channel.control & !writable | value & writable;
                if channel.control & EN == 0 {
                    channel.held = None;
                }
            }
            0x00 => Self::enable(channel, number, value & 0x1_ffff, context),
            0x0c | 0x10 if enabled && channel.control & DBM != 0 => {
                let buffer = (register as usize - 0x0c) / 4;
                if (buffer == 1) == (channel.control & CT != 0) {
                    context.misuse(
                        "BDMA",
                        format!("channel {number}: address of the buffer in use written (RM0399, BDMA registers)"),
                    );
                }
                channel.memory_address[buffer] = value;
            }
            _ if enabled => {
                context.misuse(
                    "BDMA",
                    format!(
                        "channel {number}: register {register:#x} written while it is enabled (RM0399, BDMA registers)"
                    ),
                );
            }
            0x04 => {
                channel.remaining = value & 0xffff;
                channel.programmed = channel.remaining;
            }
            0x08 => channel.peripheral_address = value,
            0x0c => channel.memory_address[0] = value,
            _ => channel.memory_address[1] = value,
        }
    }

    fn enable(channel: &mut Channel, number: usize, value: u32, context: &mut Context<'_>) {
        channel.control = value;
        if value & EN == 0 {
            return;
        }
        if size_of_code(value >> 8).is_none() || size_of_code(value >> 10).is_none() {
            context
                .misuse("BDMA", format!("channel {number}: PSIZE or MSIZE has a reserved value (RM0399, BDMA_CCRx)"));
        }
        if value & MEM2MEM != 0 && value & (CIRC | DBM) != 0 {
            context.misuse(
                "BDMA",
                format!("channel {number}: memory to memory in circular mode (RM0399, BDMA, memory-to-memory mode)"),
            );
        }
        if channel.flags & TEIF != 0 && value & TEIE != 0 {
            context.misuse(
                "BDMA",
                format!("channel {number}: enabled with TEIF not cleared (RM0399, BDMA, error management)"),
            );
        }
        channel.rewind();
    }
}

impl Peripheral for Bdma {
    fn read(&mut self, offset: u32, size: Size, _context: &mut Context<'_>) -> Result<u32, Unmodelled> {
        Ok(access::part(self.register(offset & !3)?, offset, size))
    }

    fn write(&mut self, offset: u32, size: Size, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        self.advance(context);
        let value = access::merged(self.register(offset & !3)?, offset, size, value);
        let offset = offset & !3;
        match offset {
            0x00 => Ok(()),
            0x04 => {
                for number in 0..CHANNELS {
                    let clear = value >> (4 * number) & 0xf;
                    let flags = &mut self.channels[number].flags;
                    // CGIF clears all flags of the channel.
                    *flags = if clear & 1 != 0 { 0 } else { *flags & !clear };
                    self.irq(number, context);
                }
                Ok(())
            }
            0x08..0xa8 => {
                let number = ((offset - 8) / 0x14) as usize;
                self.write_channel(number, (offset - 8) % 0x14, value, context);
                self.irq(number, context);
                Ok(())
            }
            _ => self.mux.write(offset - 0x400, value, context),
        }
    }

    fn advance(&mut self, context: &mut Context<'_>) {
        self.quiet = false;
        for channel in &mut self.channels {
            channel.patience.renew(context.now_ns);
        }
    }

    fn reset(&mut self, context: &mut Context<'_>) {
        for (number, channel) in self.channels.iter_mut().enumerate() {
            let level = channel.level;
            *channel = Channel::default();
            if level {
                context.irq(FIRST_IRQ + number as u16, false);
            }
        }
        self.mux.reset(context);
        self.current = None;
        self.quiet = false;
    }
}
