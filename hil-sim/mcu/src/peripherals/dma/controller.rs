//! DMA1 or DMA2: eight streams, their flags, and the arbiter (RM0399, DMA).

use super::stream::{self, Direction, Port, Stream, Wanted};
use super::{BusError, mux::Mux, size_of_code};
use crate::context::Context;
use crate::peripheral::Unmodelled;

pub(super) const STREAMS: usize = 8;

/// First flag bit of streams 0 to 3 (4 to 7) in LISR (HISR).
const FLAG_SHIFT: [u32; 4] = [0, 6, 16, 22];

#[derive(Debug)]
pub(super) struct Controller {
    name: &'static str,
    interrupts: [u16; STREAMS],
    streams: [Stream; STREAMS],
    levels: [bool; STREAMS],
}

impl Controller {
    pub(super) fn new(name: &'static str, interrupts: [u16; STREAMS]) -> Self {
        Self { name, interrupts, streams: std::array::from_fn(|_| Stream::new()), levels: [false; STREAMS] }
    }

    pub(super) fn reset(&mut self, context: &mut Context<'_>) {
        self.streams = std::array::from_fn(|_| Stream::new());
        for number in 0..STREAMS {
            self.irq(number, context);
        }
    }

    /// Returns the access that the arbiter selects: the highest priority, then the lowest number.
    pub(super) fn next(&self, mux: &Mux, first_channel: usize) -> Option<(usize, Wanted)> {
        let mut best: Option<(usize, Wanted, u32)> = None;
        for (number, stream) in self.streams.iter().enumerate() {
            if !stream.is_enabled() {
                continue;
            }
            let Some(wanted) = stream.wants(mux.output(first_channel + number)) else { continue };
            if best.as_ref().is_none_or(|(_, _, priority)| stream.priority() > *priority) {
                best = Some((number, wanted, stream.priority()));
            }
        }
        best.map(|(number, wanted, _)| (number, wanted))
    }

    pub(super) fn is_enabled(&self, number: usize) -> bool {
        self.streams[number].is_enabled()
    }

    pub(super) fn finish(
        &mut self,
        number: usize,
        wanted: Wanted,
        result: Result<u32, BusError>,
        request: u8,
        context: &mut Context<'_>,
    ) {
        let name = self.name;
        let stream = &mut self.streams[number];
        match result {
            Ok(value) => stream.done(wanted, value),
            Err(BusError) => {
                let port = if wanted.port == Port::Memory { "memory" } else { "peripheral" };
                context.misuse(
                    name,
                    format!(
                        "stream {number} cannot reach {port} address {:#010x} (RM0399, DMA, error management)",
                        wanted.address
                    ),
                );
                stream.abort();
                stream.flags |= stream::TEIF;
            }
        }
        if stream.patience.spend(context.now_ns) {
            context.misuse(
                name,
                format!("stream {number}: request {request} never falls, the stream waits until time passes"),
            );
        }
        self.irq(number, context);
    }

    pub(super) fn renew(&mut self, now_ns: u64) {
        for stream in &mut self.streams {
            stream.patience.renew(now_ns);
        }
    }

    fn irq(&mut self, number: usize, context: &mut Context<'_>) {
        let stream = &self.streams[number];
        // Pairs of a flag and its enable bit: HTIF, TCIF and TEIF lie one place above HTIE, TCIE and TEIE; FEIF belongs
        // to FEIE of SxFCR.
        let enabled = [
            (stream::FEIF, stream.fifo_control & stream::FEIE),
            (stream::TEIF, stream.control & stream::TEIE),
            (stream::HTIF, stream.control & stream::HTIE),
            (stream::TCIF, stream.control & stream::TCIE),
        ];
        let level = enabled.iter().any(|&(flag, enable)| stream.flags & flag != 0 && enable != 0);
        if self.levels[number] != level {
            self.levels[number] = level;
            context.irq(self.interrupts[number], level);
        }
    }

    pub(super) fn read(&self, offset: u32) -> Result<u32, Unmodelled> {
        match offset {
            0x00 => Ok(self.flags(0)),
            0x04 => Ok(self.flags(4)),
            // LIFCR and HIFCR are write-only.
            0x08 | 0x0c => Ok(0),
            0x10..0xd0 => {
                let stream = &self.streams[((offset - 0x10) / 0x18) as usize];
                Ok(match (offset - 0x10) % 0x18 {
                    0x00 => stream.control,
                    0x04 => stream.remaining,
                    0x08 => stream.peripheral_address,
                    0x0c => stream.memory_address[0],
                    0x10 => stream.memory_address[1],
                    // Field FS: between accesses of the program a FIFO is empty or below its threshold; the model
                    // reports only "empty".
                    _ => stream.fifo_control & !(7 << 3) | 4 << 3,
                })
            }
            _ => Err(Unmodelled::register(self.name, offset)),
        }
    }

    fn flags(&self, first: usize) -> u32 {
        (0..4).map(|n| self.streams[first + n].flags << FLAG_SHIFT[n]).sum()
    }

    pub(super) fn write(&mut self, offset: u32, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        match offset {
            // LISR and HISR are read-only.
            0x00 | 0x04 => Ok(()),
            0x08 | 0x0c => {
                let first = if offset == 0x08 { 0 } else { 4 };
                for (n, shift) in FLAG_SHIFT.into_iter().enumerate() {
                    self.streams[first + n].flags &= !(value >> shift & stream::ALL_FLAGS);
                    self.irq(first + n, context);
                }
                Ok(())
            }
            0x10..0xd0 => {
                let number = ((offset - 0x10) / 0x18) as usize;
                match (offset - 0x10) % 0x18 {
                    0x00 => self.write_control(number, value, context)?,
                    register => self.write_parameter(number, register, value, context),
                }
                self.irq(number, context);
                Ok(())
            }
            _ => Err(Unmodelled::register(self.name, offset)),
        }
    }

    fn write_parameter(&mut self, number: usize, register: u32, value: u32, context: &mut Context<'_>) {
        let name = self.name;
        let stream = &mut self.streams[number];
        let enabled = stream.is_enabled();
        let target = u32::from(stream.control & stream::CT != 0);
        match register {
            0x0c | 0x10 if enabled && stream.control & stream::DBM != 0 => {
                let buffer = (register - 0x0c) / 4;
                if buffer == target {
                    context.misuse(
                        name,
                        format!(
                            "stream {number}: address of the buffer in use written (RM0399, DMA, double-buffer mode)"
                        ),
                    );
                    stream.abort();
                    stream.flags |= stream::TEIF;
                } else {
                    stream.memory_address[buffer as usize] = value;
                }
            }
            0x14 if enabled => {
                // Only FEIE is writable: FTH and DMDIS are protected.
                if (stream.fifo_control ^ value) & 7 != 0 {
                    context.misuse(
                        name,
                        format!("stream {number}: SxFCR written while it is enabled (RM0399, DMA_SxFCR)"),
                    );
                }
                stream.fifo_control = stream.fifo_control & !stream::FEIE | value & stream::FEIE;
            }
            _ if enabled => {
                context.misuse(
                    name,
                    format!(
                        "stream {number}: register {register:#x} written while it is enabled (RM0399, DMA registers)"
                    ),
                );
            }
            0x04 => {
                stream.remaining = value & 0xffff;
                stream.programmed = stream.remaining;
            }
            0x08 => stream.peripheral_address = value,
            0x0c => stream.memory_address[0] = value,
            0x10 => stream.memory_address[1] = value,
            _ => stream.fifo_control = value & 0x87,
        }
    }

    fn write_control(&mut self, number: usize, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        let value = value & 0x01ff_ffff;
        if value & stream::PFCTRL != 0 {
            return Err(Unmodelled {
                peripheral: self.name,
                what: format!("stream {number}: peripheral flow control"),
            });
        }
        let stream = &mut self.streams[number];
        if stream.is_enabled() {
            stream.control = stream.control & !stream::WHILE_ENABLED | value & stream::WHILE_ENABLED | stream::EN;
            if stream.control & stream::DBM != 0 {
                stream.control |= stream::CIRC;
            }
            if value & stream::EN == 0 && !stream.stopping {
                stream.stop();
            }
            return Ok(());
        }
        stream.control = value & !stream::EN;
        if value & stream::EN == 0 {
            return Ok(());
        }
        if let Err(what) = check(&self.streams[number]) {
            context.misuse(self.name, format!("stream {number}: {what}"));
            if what.is_fatal() {
                self.streams[number].flags |= stream::FEIF;
                return Ok(());
            }
        }
        let stream = &mut self.streams[number];
        if stream.direction() == Some(Direction::Memory) {
            stream.fifo_control |= stream::DMDIS;
        }
        stream.start();
        Ok(())
    }
}

#[derive(Debug, thiserror::Error)]
enum Wrong {
    #[error("DIR, PSIZE or MSIZE has a reserved value (RM0399, DMA_SxCR)")]
    Reserved,
    #[error("enabled with event flags {0:#04x} not cleared (RM0399, DMA, stream configuration)")]
    Flags(u32),
    #[error("memory to memory in circular or double-buffer mode (RM0399, DMA, memory-to-memory mode)")]
    CircularMemory,
    #[error("a memory burst of {burst} bytes and a FIFO threshold of {threshold} do not fit (RM0399, DMA, FIFO)")]
    Threshold { burst: usize, threshold: usize },
    #[error("{items} items of {size} bytes are not a multiple of MSIZE (RM0399, DMA, packing)")]
    Odd { items: u32, size: u32 },
    #[error("an address is not a multiple of its size (RM0399, DMA, pointers)")]
    Alignment,
}

impl Wrong {
    /// Returns true if the stream is disabled again and sets FEIF (RM0399, DMA, FIFO).
    fn is_fatal(&self) -> bool {
        matches!(self, Self::Reserved | Self::CircularMemory | Self::Threshold { .. })
    }
}

fn check(stream: &Stream) -> Result<(), Wrong> {
    let control = stream.control;
    let direction = stream.direction().ok_or(Wrong::Reserved)?;
    if size_of_code(control >> 11).is_none() || size_of_code(control >> 13).is_none() {
        return Err(Wrong::Reserved);
    }
    if direction == Direction::Memory && control & (stream::CIRC | stream::DBM) != 0 {
        return Err(Wrong::CircularMemory);
    }
    let unit = stream.memory_size().bytes();
    if !stream.is_direct() {
        let burst = stream.burst_beats(23) as usize * unit as usize;
        let threshold = stream.threshold_bytes();
        if burst > threshold || !threshold.is_multiple_of(burst) {
            return Err(Wrong::Threshold { burst, threshold });
        }
    }
    if stream.flags != 0 {
        return Err(Wrong::Flags(stream.flags));
    }
    let size = stream.peripheral_size().bytes();
    let items = if stream.remaining == 0 { stream.programmed } else { stream.remaining };
    if !(items * size).is_multiple_of(unit) {
        return Err(Wrong::Odd { items, size });
    }
    let aligned = stream.peripheral_address.is_multiple_of(size)
        && stream.memory_address[0].is_multiple_of(unit)
        && (control & stream::DBM == 0 || stream.memory_address[1].is_multiple_of(unit));
    if aligned { Ok(()) } else { Err(Wrong::Alignment) }
}
