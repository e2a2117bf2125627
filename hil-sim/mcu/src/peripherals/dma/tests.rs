//! Tests of DMA with a bus of limited memory, and one peripheral at 0x4000_0000 whose register supplies and takes
//! words.

use std::collections::VecDeque;

use proptest::prelude::*;

use super::{Access, Bdma, Beat, BusError, Dma12};
use crate::peripheral::Size;
use crate::testing::Bench;
use crate::{Context, Signal};

const RAM: u32 = 0x2400_0000;
const REGISTER: u32 = 0x4000_0000;
/// Requests of either kind: a level (USART1_RX), and a pulse (TIM2_UP).
const LEVEL: u8 = 41;
const PULSE: u8 = 22;

/// Bits of CR as in the manual.
const EN: u32 = 1;
const TEIE: u32 = 1 << 2;
const HTIE: u32 = 1 << 3;
const TCIE: u32 = 1 << 4;
const TO_PERIPHERAL: u32 = 1 << 6;
const MEMORY: u32 = 2 << 6;
const CIRC: u32 = 1 << 8;
const PINC: u32 = 1 << 9;
const MINC: u32 = 1 << 10;
const DBM: u32 = 1 << 18;

trait Controller {
    fn next(&mut self) -> Option<Beat>;
    fn finish(&mut self, result: Result<u32, BusError>, context: &mut Context<'_>);
    fn line(&mut self, level: bool);
}

impl Controller for Dma12 {
    fn next(&mut self) -> Option<Beat> {
        self.next_beat()
    }
    fn finish(&mut self, result: Result<u32, BusError>, context: &mut Context<'_>) {
        let _ = self.finish_beat(result, context);
    }
    fn line(&mut self, level: bool) {
        self.request(LEVEL, level);
    }
}

impl Controller for Bdma {
    fn next(&mut self) -> Option<Beat> {
        self.next_beat()
    }
    fn finish(&mut self, result: Result<u32, BusError>, context: &mut Context<'_>) {
        self.finish_beat(result, context);
    }
    fn line(&mut self, level: bool) {
        self.request(13, level);
    }
}

/// Bus with a peripheral whose request is a level: asserted while it has data to supply, or room.
#[derive(Default)]
struct Bus {
    memory: Vec<u8>,
    gives: VecDeque<u32>,
    room: usize,
    taken: Vec<u32>,
    beats: Vec<Beat>,
}

impl Bus {
    fn new() -> Self {
        Self { memory: vec![0; 0x100], ..Self::default() }
    }

    fn word(&self, offset: usize) -> u32 {
        u32::from_le_bytes(self.memory[offset..offset + 4].try_into().unwrap())
    }

    fn access(&mut self, beat: Beat) -> Result<u32, BusError> {
        let bytes = beat.size.bytes() as usize;
        if beat.address == REGISTER {
            return Ok(match beat.access {
                Access::Read => self.gives.pop_front().unwrap_or(0),
                Access::Write(value) => {
                    self.room = self.room.saturating_sub(1);
                    self.taken.push(value);
                    0
                }
            });
        }
        let at = beat.address.checked_sub(RAM).ok_or(BusError)? as usize;
        let cells = self.memory.get_mut(at..at + bytes).ok_or(BusError)?;
        match beat.access {
            Access::Read => Ok(cells.iter().rev().fold(0, |word, &byte| word << 8 | u32::from(byte))),
            Access::Write(value) => {
                cells.copy_from_slice(&value.to_le_bytes()[..bytes]);
                Ok(0)
            }
        }
    }

    fn serve(&mut self, dma: &mut impl Controller, bench: &mut Bench) {
        dma.line(!self.gives.is_empty() || self.room > 0);
        while let Some(beat) = dma.next() {
            self.beats.push(beat);
            let result = self.access(beat);
            dma.line(!self.gives.is_empty() || self.room > 0);
            dma.finish(result, &mut bench.context());
        }
    }
}

fn stream(number: u32) -> u32 {
    0x10 + 0x18 * number
}

/// Configures a stream of DMA1 (8 to 15: DMA2) and selects its request.
fn set_up(dma: &mut Dma12, bench: &mut Bench, number: u32, request: u8, items: u32, fifo: u32, control: u32) {
    let base = 0x400 * (number / 8) + stream(number % 8);
    bench.write(dma, 0x800 + 4 * number, request.into());
    bench.write(dma, base + 0x04, items);
    bench.write(dma, base + 0x08, REGISTER);
    bench.write(dma, base + 0x0c, RAM);
    bench.write(dma, base + 0x14, fifo);
    bench.write(dma, base, control);
}

fn bench() -> (Bench, Dma12, Bus) {
    (Bench::default(), Dma12::new(), Bus::new())
}

#[test]
fn a_receiver_fills_a_circular_buffer() {
    let (mut bench, mut dma, mut bus) = bench();
    set_up(&mut dma, &mut bench, 0, LEVEL, 4, 0, CIRC | MINC | HTIE | TCIE | EN);
    bus.gives = [0x11, 0x22].into();
    bus.serve(&mut dma, &mut bench);
    assert_eq!(bench.read(&mut dma, 0x00), 1 << 4, "half of four");
    assert_eq!(bench.read(&mut dma, stream(0) + 4), 2);
    assert_eq!(bench.take_signals(), [Signal::Irq { number: 11, level: true }]);

    bench.write(&mut dma, 0x08, 1 << 4);
    assert_eq!(bench.take_signals(), [Signal::Irq { number: 11, level: false }]);
    bus.gives = [0x33, 0x44, 0x55].into();
    bus.serve(&mut dma, &mut bench);
    assert_eq!(bench.read(&mut dma, 0x00), 1 << 5, "complete");
    assert_eq!(bench.read(&mut dma, stream(0) + 4), 3, "one of the next round");
    assert_eq!(bus.memory[..4], [0x55, 0x22, 0x33, 0x44]);
    assert_eq!(bench.read(&mut dma, stream(0)) & EN, EN);
    bench.assert_no_misuse();
}

#[test]
fn a_transmitter_is_fed_and_the_stream_ends() {
    let (mut bench, mut dma, mut bus) = bench();
    bus.memory[..3].copy_from_slice(&[1, 2, 3]);
    set_up(&mut dma, &mut bench, 13, LEVEL, 3, 0, TO_PERIPHERAL | MINC | TCIE | EN);
    // Direct mode fetches one item before the first request (RM0399, DMA, FIFO).
    bus.serve(&mut dma, &mut bench);
    assert_eq!(bus.beats.len(), 1);
    bus.memory[..3].copy_from_slice(&[9, 2, 3]);
    bus.room = 1;
    bus.serve(&mut dma, &mut bench);
    assert_eq!(bus.taken, [1]);
    assert_eq!(bench.read(&mut dma, 0x400 + stream(5) + 4), 2);

    bus.room = 5;
    bus.serve(&mut dma, &mut bench);
    assert_eq!(bus.taken, [1, 2, 3]);
    // Flags of stream 5 of DMA2 begin at bit 6 of HISR; its vector is 68. Half of three is reported when one is left.
    assert_eq!(bench.read(&mut dma, 0x404), (1 << 5 | 1 << 4) << 6);
    assert!(bench.take_signals().contains(&Signal::Irq { number: 68, level: true }));
    assert_eq!(bench.read(&mut dma, 0x400 + stream(5)) & EN, 0);
    assert_eq!(bench.read(&mut dma, 0x400 + stream(5) + 4), 0);

    // When enabled again, it restarts with the number written before (RM0399, DMA_SxNDTR).
    bench.write(&mut dma, 0x40c, 0x3d << 6);
    bench.modify(&mut dma, 0x400 + stream(5), 0, EN);
    bus.room = 9;
    bus.serve(&mut dma, &mut bench);
    assert_eq!(bus.taken, [1, 2, 3, 9, 2, 3]);
    bench.assert_no_misuse();
}

#[test]
fn stopping_sets_the_flag_and_keeps_the_count() {
    let (mut bench, mut dma, mut bus) = bench();
    set_up(&mut dma, &mut bench, 7, LEVEL, 8, 0, MINC | TCIE | EN);
    bus.gives = [7, 8, 9].into();
    bus.serve(&mut dma, &mut bench);
    // A driver resets a stream by clearing everything but the interrupts. The configuration is protected until EN is 0.
    bench.write(&mut dma, stream(7), TCIE | TEIE);
    assert_eq!(bench.read(&mut dma, stream(7)), MINC | TCIE | TEIE);
    assert_eq!(bench.read(&mut dma, stream(7) + 4), 5);
    assert_eq!(bench.read(&mut dma, 0x04), 1 << 27);
    assert!(bench.take_signals().contains(&Signal::Irq { number: 47, level: true }));
    bus.gives = [1].into();
    bus.serve(&mut dma, &mut bench);
    assert_eq!(bus.gives.len(), 1, "a stopped stream takes nothing");
    bench.assert_no_misuse();
}

#[test]
fn the_fifo_packs_and_flushes_what_is_left() {
    let (mut bench, mut dma, mut bus) = bench();
    // Bytes to words, with the threshold at half (8 bytes).
    let control = MINC | 2 << 13 | EN;
    set_up(&mut dma, &mut bench, 2, LEVEL, 16, 1 << 2 | 1, control);
    bus.gives = (1..=7).collect();
    bus.serve(&mut dma, &mut bench);
    assert_eq!(bus.word(0), 0, "below the threshold nothing is written");
    bus.gives = [8, 9, 10, 11, 12, 13].into();
    bus.serve(&mut dma, &mut bench);
    assert_eq!((bus.word(0), bus.word(4), bus.word(8)), (0x0403_0201, 0x0807_0605, 0), "then it fills anew");
    bench.modify(&mut dma, stream(2), EN, 0);
    bus.serve(&mut dma, &mut bench);
    assert_eq!((bus.word(8), bus.word(12)), (0x0c0b_0a09, 13), "the stop writes the rest");
    assert_eq!(bench.read(&mut dma, 0x00) & 1 << 21, 1 << 21);
    assert_eq!(bench.read(&mut dma, stream(2)) & EN, 0);
    assert_eq!(bench.read(&mut dma, stream(2) + 4), 3);
    bench.assert_no_misuse();
}

#[test]
fn memory_is_copied_without_a_request() {
    let (mut bench, mut dma, mut bus) = bench();
    bus.memory[..8].copy_from_slice(&[1, 2, 3, 4, 5, 6, 7, 8]);
    bench.write(&mut dma, stream(1) + 0x04, 8);
    bench.write(&mut dma, stream(1) + 0x08, RAM);
    bench.write(&mut dma, stream(1) + 0x0c, RAM + 0x40);
    bench.write(&mut dma, stream(1) + 0x14, 3);
    // Bytes to half-words; the hardware selects the FIFO itself.
    bench.write(&mut dma, stream(1), MEMORY | PINC | MINC | 1 << 13 | EN);
    assert_eq!(bench.read(&mut dma, stream(1) + 0x14) & 1 << 2, 1 << 2);
    bus.serve(&mut dma, &mut bench);
    assert_eq!(bus.memory[0x40..0x48], [1, 2, 3, 4, 5, 6, 7, 8]);
    assert_eq!(bench.read(&mut dma, 0x00), (1 << 5 | 1 << 4) << 6);
    bench.assert_no_misuse();
}

#[test]
fn two_buffers_take_turns() {
    let (mut bench, mut dma, mut bus) = bench();
    set_up(&mut dma, &mut bench, 3, LEVEL, 2, 0, MINC | DBM);
    bench.write(&mut dma, stream(3) + 0x10, RAM + 0x20);
    bench.modify(&mut dma, stream(3), 0, EN);
    assert_eq!(bench.read(&mut dma, stream(3)) & CIRC, CIRC, "forced by DBM");
    bus.gives = [1, 2, 3].into();
    bus.serve(&mut dma, &mut bench);
    assert_eq!((bus.memory[0], bus.memory[1], bus.memory[0x20]), (1, 2, 3));
    assert_eq!(bench.read(&mut dma, stream(3)) & 1 << 19, 1 << 19);
    bench.write(&mut dma, stream(3) + 0x0c, RAM + 0x40);
    bus.gives = [4, 5].into();
    bus.serve(&mut dma, &mut bench);
    assert_eq!((bus.memory[0x21], bus.memory[0x40]), (4, 5));
    bench.assert_no_misuse();

    bench.write(&mut dma, stream(3) + 0x0c, RAM);
    assert_eq!(bench.read(&mut dma, 0x00) & 1 << 25, 1 << 25, "TEIF: that buffer is in use");
    assert_eq!(bench.read(&mut dma, stream(3)) & EN, 0);
    assert_eq!(bench.take_misuse().len(), 1);
}

#[test]
fn the_higher_priority_goes_first_then_the_lower_number() {
    let (mut bench, mut dma, mut bus) = bench();
    for (number, request, priority) in [(1, LEVEL, 1), (2, 45, 2), (5, 46, 2)] {
        set_up(&mut dma, &mut bench, number, request, 1, 0, MINC | priority << 16 | EN);
    }
    dma.request(45, true);
    dma.request(46, true);
    bus.gives = [1, 2, 3].into();
    bus.serve(&mut dma, &mut bench);
    let reads: Vec<u8> = bus.beats.iter().filter(|b| b.access == Access::Read).map(|b| b.channel).collect();
    assert_eq!(reads, [2, 5, 1]);
}

#[test]
fn a_refused_access_ends_the_stream() {
    let (mut bench, mut dma, mut bus) = bench();
    set_up(&mut dma, &mut bench, 0, LEVEL, 4, 0, MINC | TEIE);
    // DMA1 has no path to DTCM.
    bench.write(&mut dma, stream(0) + 0x0c, 0x2000_0000);
    bench.modify(&mut dma, stream(0), 0, EN);
    bus.gives = [1, 2].into();
    bus.serve(&mut dma, &mut bench);
    assert_eq!(bench.read(&mut dma, 0x00), 1 << 3);
    assert_eq!(bench.read(&mut dma, stream(0)) & EN, 0);
    assert_eq!(bus.gives.len(), 1);
    assert!(bench.take_signals().contains(&Signal::Irq { number: 11, level: true }));
    assert_eq!(
        bench.take_misuse(),
        ["stream 0 cannot reach memory address 0x20000000 (RM0399, DMA, error management)"]
    );
}

#[test]
fn what_does_not_fit_is_refused_or_told() {
    let (mut bench, mut dma, _) = bench();
    // A burst of 8 words does not fit a FIFO of 4.
    set_up(&mut dma, &mut bench, 0, LEVEL, 8, 1 << 2 | 3, MINC | 2 << 11 | 2 << 13 | 2 << 23 | EN);
    assert_eq!(bench.read(&mut dma, stream(0)) & EN, 0);
    assert_eq!(bench.read(&mut dma, 0x00), 1, "FEIF");
    assert_eq!(bench.take_misuse().len(), 1);
    // The flag of the last transfer was not cleared.
    set_up(&mut dma, &mut bench, 0, LEVEL, 8, 0, MINC | EN);
    assert_eq!(
        bench.take_misuse(),
        ["stream 0: enabled with event flags 0x01 not cleared (RM0399, DMA, stream configuration)"]
    );
    // Registers of a running stream are protected.
    bench.write(&mut dma, stream(0) + 4, 1);
    assert_eq!(bench.read(&mut dma, stream(0) + 4), 8);
    assert_eq!(bench.take_misuse().len(), 1);
    // A half-word at an odd address is misaligned.
    set_up(&mut dma, &mut bench, 4, 45, 8, 0, MINC | 1 << 11 | 1 << 13);
    bench.write(&mut dma, stream(4) + 0x0c, RAM + 1);
    bench.modify(&mut dma, stream(4), 0, EN);
    assert_eq!(bench.take_misuse().len(), 1);
    let flow_control = bench.try_write(&mut dma, stream(6), Size::Word, 1 << 5);
    assert!(flow_control.is_err());
}

#[test]
fn a_timers_request_waits_until_it_is_served_once() {
    let (mut bench, mut dma, mut bus) = bench();
    dma.request(PULSE, true);
    set_up(&mut dma, &mut bench, 0, PULSE, 4, 0, MINC | 2 << 11 | EN);
    bus.gives = [1, 2, 3].into();
    bus.serve(&mut dma, &mut bench);
    assert_eq!(bench.read(&mut dma, stream(0) + 4), 3, "one pulse, one item");
    dma.request(PULSE, true);
    dma.request(PULSE, false);
    bus.serve(&mut dma, &mut bench);
    assert_eq!(bench.read(&mut dma, stream(0) + 4), 3, "the timer took it back");
}

#[test]
fn a_trigger_makes_requests() {
    let (mut bench, mut dma, mut bus) = bench();
    bus.memory[..8].copy_from_slice(&[1, 2, 3, 4, 5, 6, 7, 8]);
    // Generator 2 (request 3): TIM12's trigger output (7), rising, two requests each; with its overrun interrupt.
    bench.write(&mut dma, 0x908, 7 | 1 << 8 | 1 << 16 | 1 << 17 | 1 << 19);
    set_up(&mut dma, &mut bench, 0, 3, 8, 0, TO_PERIPHERAL | MINC | EN);
    dma.trigger(7, &mut bench.context());
    dma.trigger(6, &mut bench.context());
    bus.serve(&mut dma, &mut bench);
    assert_eq!(bus.taken, [1, 2]);
    assert_eq!(bench.read(&mut dma, 0x940), 0);
    dma.trigger(7, &mut bench.context());
    bench.take_signals();
    dma.trigger(7, &mut bench.context());
    assert_eq!(bench.read(&mut dma, 0x940), 1 << 2, "the second came before the first was served");
    assert_eq!(bench.take_signals(), [Signal::Irq { number: 102, level: true }]);
    bench.write(&mut dma, 0x944, 1 << 2);
    assert_eq!(bench.take_signals(), [Signal::Irq { number: 102, level: false }]);
    bus.serve(&mut dma, &mut bench);
    assert_eq!(bus.taken, [1, 2, 3, 4]);
}

#[test]
fn a_channels_event_triggers_another() {
    let (mut bench, mut dma, mut bus) = bench();
    // Channel 0 makes an event after each third request; generator 0 makes a request of it, for channel 1.
    set_up(&mut dma, &mut bench, 0, LEVEL, 8, 0, MINC | EN);
    bench.write(&mut dma, 0x800, u32::from(LEVEL) | 1 << 9 | 2 << 19);
    bench.write(&mut dma, 0x900, 1 << 16 | 1 << 17);
    // Channel 1 has a higher priority, so that it precedes the fourth access of channel 0.
    set_up(&mut dma, &mut bench, 1, 1, 8, 0, MINC | 1 << 16 | EN);
    bus.gives = [1, 2, 3, 4].into();
    bus.serve(&mut dma, &mut bench);
    let order: Vec<u8> = bus.beats.iter().filter(|b| b.access == Access::Read).map(|b| b.channel).collect();
    assert_eq!(order, [0, 0, 0, 1]);
    assert_eq!(bus.gives.len(), 0, "channel 1 read the fourth");
}

#[test]
fn synchronized_requests_wait_for_their_edge() {
    let (mut bench, mut dma, mut bus) = bench();
    set_up(&mut dma, &mut bench, 0, LEVEL, 8, 0, MINC | EN);
    bench.write(&mut dma, 0x800, u32::from(LEVEL) | 1 << 16 | 1 << 17 | 1 << 19 | 7 << 24);
    bus.gives = [1, 2, 3].into();
    bus.serve(&mut dma, &mut bench);
    assert_eq!(bus.gives.len(), 3);
    dma.trigger(7, &mut bench.context());
    bus.serve(&mut dma, &mut bench);
    assert_eq!(bus.gives.len(), 1, "two for each edge");
}

#[test]
fn a_request_that_never_falls_does_not_stop_time() {
    let (mut bench, mut dma, mut bus) = bench();
    set_up(&mut dma, &mut bench, 0, 45, 4, 0, MINC | CIRC | EN);
    dma.request(45, true);
    bus.serve(&mut dma, &mut bench);
    assert_eq!(bench.take_misuse(), ["stream 0: request 45 never falls, the stream waits until time passes"]);
    assert!(dma.next_beat().is_none());
}

#[test]
fn one_request_for_two_channels_is_told() {
    let (mut bench, mut dma, _) = bench();
    bench.write(&mut dma, 0x800, 41);
    bench.write(&mut dma, 0x804, 41);
    assert_eq!(
        bench.take_misuse(),
        ["request 41 selected by a second channel, 1 (RM0399, DMAMUX, request multiplexer)"]
    );
}

#[test]
fn bdma_moves_items_without_packing() {
    let (mut bench, mut dma, mut bus) = (Bench::default(), Bdma::new(), Bus::new());
    // Channel 2, request 13 (I2C4_RX): bytes from a register to words in memory, TCIE and HTIE.
    bench.write(&mut dma, 0x408, 13);
    let base = 0x08 + 0x14 * 2;
    bench.write(&mut dma, base + 0x04, 2);
    bench.write(&mut dma, base + 0x08, REGISTER);
    bench.write(&mut dma, base + 0x0c, RAM);
    bench.write(&mut dma, base, 1 | 1 << 1 | 1 << 2 | 1 << 7 | 2 << 10);
    bus.gives = [0xa1].into();
    bus.serve(&mut dma, &mut bench);
    assert_eq!(bench.read(&mut dma, 0x00), 0b0101 << 8, "GIF, HTIF");
    bus.gives = [0xb2, 0xc3].into();
    bus.serve(&mut dma, &mut bench);
    assert_eq!((bus.word(0), bus.word(4)), (0xa1, 0xb2));
    assert_eq!(bus.gives.len(), 1);
    assert_eq!(bench.read(&mut dma, base) & 1, 1, "EN stays");
    assert_eq!(bench.read(&mut dma, base + 4), 0);
    assert!(bench.take_signals().contains(&Signal::Irq { number: 131, level: true }));
    bench.write(&mut dma, 0x04, 1 << 8);
    assert_eq!(bench.read(&mut dma, 0x00), 0, "CGIF clears all");
    assert!(bench.take_signals().contains(&Signal::Irq { number: 131, level: false }));
    bench.assert_no_misuse();
}

#[test]
fn bdma_feeds_a_transmitter_and_stops_at_a_refusal() {
    let (mut bench, mut dma, mut bus) = (Bench::default(), Bdma::new(), Bus::new());
    bus.memory[0x9e..0xa0].copy_from_slice(&[5, 6]);
    bench.write(&mut dma, 0x400, 13);
    bench.write(&mut dma, 0x0c, 9);
    bench.write(&mut dma, 0x10, REGISTER);
    bench.write(&mut dma, 0x14, RAM + 0xfe);
    bus.memory[0xfe..].copy_from_slice(&[5, 6]);
    bench.write(&mut dma, 0x08, 1 | 1 << 3 | 1 << 4 | 1 << 7);
    bus.serve(&mut dma, &mut bench);
    assert!(bus.beats.is_empty(), "nothing is fetched ahead");
    bus.room = 4;
    bus.serve(&mut dma, &mut bench);
    assert_eq!(bus.taken, [5, 6]);
    assert_eq!(bench.read(&mut dma, 0x00), 0b1001);
    assert_eq!(bench.read(&mut dma, 0x08) & 1, 0);
    assert_eq!(bench.take_misuse(), ["channel 0 cannot reach 0x24000100 (RM0399, BDMA, error management)"]);
}

#[test]
fn bdma_goes_round_and_finishes_an_item_first() {
    let (mut bench, mut dma, mut bus) = (Bench::default(), Bdma::new(), Bus::new());
    // Channel 0 has low priority and transfers two bytes circularly; channel 1 has very high priority and request 14.
    for (channel, request, control) in [(0, 13, 1 | 1 << 5 | 1 << 7), (1, 14, 1 | 1 << 7 | 3 << 12)] {
        bench.write(&mut dma, 0x400 + 4 * channel, request);
        let base = 0x08 + 0x14 * channel;
        bench.write(&mut dma, base + 0x04, 2);
        bench.write(&mut dma, base + 0x08, REGISTER);
        bench.write(&mut dma, base + 0x0c, RAM + 0x40 * channel);
        bench.write(&mut dma, base, control);
    }
    bus.gives = [1, 2, 3].into();
    bus.serve(&mut dma, &mut bench);
    assert_eq!(bus.memory[..3], [3, 2, 0]);
    assert_eq!(bench.read(&mut dma, 0x0c), 1);

    dma.request(13, true);
    let read = dma.next_beat().unwrap();
    assert_eq!((read.channel, read.access), (0, Access::Read));
    dma.request(14, true);
    dma.finish_beat(Ok(4), &mut bench.context());
    let write = dma.next_beat().unwrap();
    assert_eq!((write.channel, write.access), (0, Access::Write(4)));
    dma.finish_beat(Ok(0), &mut bench.context());
    assert_eq!(dma.next_beat().unwrap().channel, 1);
}

#[test]
fn a_burst_takes_several_items_for_one_request() {
    let (mut bench, mut dma, mut bus) = bench();
    // Bursts of four half-words from addresses that advance by words (PINCOS), FIFO threshold full.
    bus.memory[..20].copy_from_slice(&[1, 1, 0, 0, 2, 2, 0, 0, 3, 3, 0, 0, 4, 4, 0, 0, 5, 5, 0, 0]);
    let sizes = 1 << 11 | 1 << 13;
    set_up(&mut dma, &mut bench, 0, PULSE, 8, 1 << 2 | 3, 1 << 21 | 1 << 15 | PINC | MINC | sizes);
    bench.write(&mut dma, stream(0) + 0x08, RAM);
    bench.write(&mut dma, stream(0) + 0x0c, RAM + 0x80);
    bench.modify(&mut dma, stream(0), 0, EN);
    dma.request(PULSE, true);
    bus.serve(&mut dma, &mut bench);
    assert_eq!(bench.read(&mut dma, stream(0) + 4), 4);
    bench.modify(&mut dma, stream(0), EN, 0);
    bus.serve(&mut dma, &mut bench);
    assert_eq!(bus.memory[0x80..0x8a], [1, 1, 2, 2, 3, 3, 4, 4, 0, 0]);
    bench.assert_no_misuse();
}

proptest! {
    /// The bytes arrive in their order for all widths and thresholds.
    #[test]
    fn no_byte_is_lost_in_the_fifo(
        peripheral in 0..3_u32, memory in 0..3_u32, threshold in 0..4_u32, words in 1..16_u32, chunk in 1..9_usize,
        to_peripheral: bool,
    ) {
        let (mut bench, mut dma, mut bus) = bench();
        let bytes: Vec<u8> = (0..4 * words).map(|n| n as u8 + 1).collect();
        let width = 1 << peripheral;
        let items: Vec<u32> = bytes
            .chunks(width)
            .map(|item| item.iter().rev().fold(0, |word, &byte| word << 8 | u32::from(byte)))
            .collect();
        let direction = if to_peripheral { TO_PERIPHERAL } else { 0 };
        let control = direction | MINC | peripheral << 11 | memory << 13 | EN;
        if to_peripheral {
            bus.memory[..bytes.len()].copy_from_slice(&bytes);
        }
        set_up(&mut dma, &mut bench, 0, LEVEL, items.len() as u32, 1 << 2 | threshold, control);
        for part in items.chunks(chunk) {
            if to_peripheral {
                bus.room = part.len();
            } else {
                bus.gives.extend(part);
            }
            bus.serve(&mut dma, &mut bench);
        }
        if to_peripheral {
            prop_assert_eq!(&bus.taken, &items);
        } else {
            prop_assert_eq!(&bus.memory[..bytes.len()], &bytes[..]);
        }
        // A single item has no half transfer.
        prop_assert_eq!(bench.read(&mut dma, 0x00), if items.len() > 1 { 1 << 5 | 1 << 4 } else { 1 << 5 });
        prop_assert_eq!(bench.read(&mut dma, stream(0)) & EN, 0);
    }
}
