//! Tests of timers, DMA and the ADC wired to each other, as in the chip.

use crate::peripherals::adc::Adc12;
use crate::peripherals::dma::{Access, BusError, Dma12};
use crate::peripherals::tim::Tim;
use crate::testing::Bench;
use crate::{Peripheral, Pin, Signal};

const RAM: u32 = 0x2400_0000;
/// Address of GPIOK's BSRR, whose writes are recorded with their time.
const BSRR: u32 = 0x5802_2818;
const ADC1_DR: u32 = 0x4002_2040;
const TIM12: u32 = 0x4000_1800;

struct Chip {
    bench: Bench,
    tim: Tim,
    adc: Adc12,
    dma: Dma12,
    memory: Vec<u8>,
    pins: Vec<(u64, u32)>,
    interrupts: Vec<(u64, u16)>,
}

impl Chip {
    fn new() -> Self {
        Self {
            bench: Bench::default(),
            tim: Tim::new(12),
            adc: Adc12::new(),
            dma: Dma12::new(),
            memory: vec![0; 64],
            pins: Vec::new(),
            interrupts: Vec::new(),
        }
    }

    fn route(&mut self) {
        loop {
            for signal in self.bench.take_signals() {
                match signal {
                    Signal::Dma { request, level } => self.dma.request(request, level),
                    Signal::Trigger { timer: 12 } => self.dma.trigger(7, &mut self.bench.context()),
                    Signal::Irq { number, level: true } => self.interrupts.push((self.bench.now_ns, number)),
                    _ => {}
                }
            }
            let Some(beat) = self.dma.next_beat() else { break };
            let mut context = self.bench.context();
            let result = match (beat.address, beat.access) {
                (BSRR, Access::Write(value)) => {
                    self.pins.push((context.now_ns, value));
                    Ok(0)
                }
                (ADC1_DR, Access::Read) => self.adc.read(0x40, beat.size, &mut context).map_err(|_| BusError),
                (TIM12..0x4000_1c00, Access::Write(value)) => self
                    .tim
                    .write(beat.address - TIM12, beat.size, value, &mut context)
                    .map(|()| 0)
                    .map_err(|_| BusError),
                (address, access) => {
                    let at = (address - RAM) as usize;
                    let cells = &mut self.memory[at..at + beat.size.bytes() as usize];
                    match access {
                        Access::Read => Ok(cells.iter().rev().fold(0, |word, &byte| word << 8 | u32::from(byte))),
                        Access::Write(value) => {
                            cells.copy_from_slice(&value.to_le_bytes()[..cells.len()]);
                            Ok(0)
                        }
                    }
                }
            };
            if let Some(request) = self.dma.finish_beat(result, &mut self.bench.context()) {
                self.adc.dma_ended(request, &mut self.bench.context());
            }
        }
    }

    fn run(&mut self, to_ns: u64) {
        loop {
            self.route();
            let next_ns = self.tim.next_event_ns().min(self.adc.next_event_ns());
            if next_ns > to_ns {
                break;
            }
            self.bench.now_ns = next_ns;
            self.tim.advance(&mut self.bench.context());
            self.adc.advance(&mut self.bench.context());
        }
        self.bench.now_ns = to_ns;
    }

    fn stream(&mut self, number: u32, request: u32, peripheral: u32, items: u32, control: u32) {
        let base = 0x10 + 0x18 * number;
        let (bench, dma) = (&mut self.bench, &mut self.dma);
        bench.write(dma, 0x800 + 4 * number, request);
        bench.write(dma, base + 0x04, items);
        bench.write(dma, base + 0x08, peripheral);
        bench.write(dma, base + 0x0c, RAM);
        bench.write(dma, base, control | 1);
    }
}

/// A timer's trigger output paces a table of pin changes, without the processor.
#[test]
fn a_table_of_pin_changes_by_timer_and_dma() {
    let mut chip = Chip::new();
    let table = [1_u32, 1 << 16, 2, 2 << 16];
    chip.memory[..16].copy_from_slice(&table.map(u32::to_le_bytes).concat());
    // Generator 0 makes one request for each rising edge of input 7.
    chip.bench.write(&mut chip.dma, 0x900, 7 | 1 << 16 | 1 << 17);
    // Settings: words, memory to peripheral, circular.
    chip.stream(3, 1, BSRR, 4, 1 << 6 | 1 << 8 | 1 << 10 | 2 << 11 | 2 << 13);
    let (bench, tim) = (&mut chip.bench, &mut chip.tim);
    bench.write(tim, 0x28, 239);
    bench.write(tim, 0x2c, 49);
    bench.write(tim, 0x14, 1);
    bench.take_signals();
    bench.write(tim, 0x04, 2 << 4);
    bench.write(tim, 0x00, 1);
    chip.run(300_000);
    let expected =
        [(50_000, 1), (100_000, 1 << 16), (150_000, 2), (200_000, 2 << 16), (250_000, 1), (300_000, 1 << 16)];
    assert_eq!(chip.pins, expected);
    chip.bench.assert_no_misuse();
}

/// Continuous conversions of two inputs fill a ring; interrupts report half and complete.
#[test]
fn a_ring_of_conversions() {
    let mut chip = Chip::new();
    chip.bench.outside.volts.insert(Pin::new('C', 4), 1.65);
    chip.bench.outside.volts.insert(Pin::new('C', 5), 0.825);
    // Settings: half-words, memory increment, circular, interrupts at half and complete.
    chip.stream(0, 9, ADC1_DR, 4, 1 << 8 | 1 << 10 | 1 << 11 | 1 << 13 | 1 << 3 | 1 << 4);
    let on = 1 << 28 | 1 << 8;
    let (bench, adc) = (&mut chip.bench, &mut chip.adc);
    bench.write(adc, 0x08, on);
    bench.run(adc, 10_000);
    bench.write(adc, 0x08, on | 1);
    bench.run(adc, 20_000);
    bench.write(adc, 0x1c, 1 << 4 | 1 << 8);
    bench.write(adc, 0x30, 1 | 4 << 6 | 8 << 12);
    bench.write(adc, 0x0c, 1 << 13 | 3);
    bench.write(adc, 0x08, on | 1 | 1 << 2);
    // A conversion takes 1.5 + 8.5 clocks of 125 ns each.
    chip.run(20_000 + 2 * 1_250);
    assert_eq!(chip.interrupts, [(22_500, 11)]);
    chip.bench.write(&mut chip.dma, 0x08, 1 << 4);
    chip.run(20_000 + 4 * 1_250);
    assert_eq!(chip.interrupts, [(22_500, 11), (25_000, 11)]);
    let samples: Vec<u16> = chip.memory[..8].chunks(2).map(|pair| u16::from_le_bytes([pair[0], pair[1]])).collect();
    assert_eq!(samples, [32_768, 16_384, 32_768, 16_384]);
    chip.run(1_000_000);
    assert_eq!(chip.bench.read(&mut chip.adc, 0x00) & 1 << 4, 0, "never an overrun");
    chip.bench.assert_no_misuse();
}
