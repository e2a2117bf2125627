//! Tests with sequences of RM0399, 59.4, as a driver makes them, and with misuse.
//!
//! The kernel clock is 80 MHz: nominal bits of 80 clocks (1 Mbit/s: 1 + 63 + 16 quanta), data bits of 16 (5 Mbit/s: 1 +
//! 11 + 4). The message RAM has standard filters at word 0, extended ones at 16, FIFO 0 at 64, FIFO 1 at 256, events at
//! 448, buffers at 512.

use proptest::prelude::*;

use super::registers::*;
use super::*;
use crate::outside::CanOutcome;
use crate::peripherals::bench::Bench;
use crate::{Peripheral, Size};

const BIT_NS: u64 = 1_000;
const RAM: u32 = 0xC00;
const FILTERS: u32 = 0;
const EXTENDED: u32 = 16;
const FIFO_0: u32 = 64;
const FIFO_1: u32 = 256;
const EVENTS: u32 = 448;
const BUFFERS: u32 = 512;
/// Size of elements with 64 bytes of data, words.
const ELEMENT: u32 = 18;

fn new() -> Bench<Fdcan> {
    let clocks = Clocks { fdcan_hz: 80_000_000, apb1_hz: 80_000_000, ..Clocks::default() };
    Bench::new(Fdcan::new(), clocks)
}

/// Makes a module in configuration, with INIT and CCE, bit times and message RAM set.
fn configured(cccr_bits: u32) -> Bench<Fdcan> {
    let mut bench = new();
    bench.write(CCCR, cccr::INIT);
    bench.write(CCCR, cccr::INIT | cccr::CCE);
    bench.write(CCCR, cccr::INIT | cccr::CCE | cccr_bits);
    bench.write(NBTP, 62 << 8 | 15);
    bench.write(DBTP, 10 << 8 | 3 << 4);
    bench.write(SIDFC, FILTERS << 2);
    bench.write(XIDFC, EXTENDED << 2);
    bench.write(RXF0C, FIFO_0 << 2 | 3 << 16 | 2 << 24);
    bench.write(RXF1C, FIFO_1 << 2 | 3 << 16);
    bench.write(TXEFC, EVENTS << 2 | 2 << 16);
    bench.write(RXESC, 0x777);
    bench.write(TXESC, 7);
    bench.write(TXBC, BUFFERS << 2 | 3 << 24);
    bench.write(TXBTIE, u32::MAX);
    bench.write(IE, ir::ALL);
    bench.write(ILE, 3);
    bench
}

/// Ends the configuration and waits until the module is synchronised.
fn run(bench: &mut Bench<Fdcan>) {
    let value = bench.read(CCCR);
    bench.write(CCCR, value & !(cccr::CCE | cccr::INIT));
    bench.run_until(bench.now_ns + 11 * BIT_NS);
    assert_eq!(bench.take_misuse(), [""; 0]);
    assert_eq!(bench.read(PSR) >> psr::ACT_AT & 3, 1, "idle");
}

fn running(cccr_bits: u32) -> Bench<Fdcan> {
    let mut bench = configured(cccr_bits);
    run(&mut bench);
    bench
}

fn ram(bench: &mut Bench<Fdcan>, word: u32) -> u32 {
    bench.read(RAM + 4 * word)
}

fn set_ram(bench: &mut Bench<Fdcan>, word: u32, value: u32) {
    bench.write(RAM + 4 * word, value);
}

/// Fills a Tx buffer with a standard frame of one byte.
fn fill(bench: &mut Bench<Fdcan>, buffer: u32, id: u32, byte: u32) {
    let word = BUFFERS + ELEMENT * buffer;
    set_ram(bench, word, id << 18);
    set_ram(bench, word + 1, 1 << 16);
    set_ram(bench, word + 2, byte);
}

fn frame(id: u32, data: &[u8]) -> CanFrame {
    CanFrame { id, extended: false, remote: false, fd: false, bit_rate_switch: false, data: data.to_vec() }
}

/// Receives a frame, and waits until it is over.
fn receive(bench: &mut Bench<Fdcan>, frame: CanFrame) {
    let length_ns = bench.peripheral.frame_ns(1, &frame);
    let at_ns = bench.now_ns + length_ns + 5 * BIT_NS;
    bench.peripheral.receive(1, at_ns, frame);
    bench.run_until(at_ns + 3 * BIT_NS);
}

fn sent_ids(bench: &Bench<Fdcan>) -> Vec<u32> {
    bench.wires.can.iter().map(|(_, _, frame)| frame.id).collect()
}

#[test]
fn reset_values_and_identity() {
    let mut bench = new();
    for base in [0, 0x400] {
        for (offset, value) in [
            (CREL, 0x3214_1218),
            (ENDN, 0x8765_4321),
            (DBTP, 0x0A33),
            (CCCR, 1),
            (NBTP, 0x0600_0A03),
            (TOCC, 0xFFFF_0000),
            (TOCV, 0xFFFF),
            (XIDAM, 0x1FFF_FFFF),
            (IR, 0),
            (TXBRP, 0),
            (ECR, 0),
        ] {
            assert_eq!(bench.read(base + offset), value, "{offset:#x}");
        }
        // The documented reset value is 0x707, but the table of bits has ACT = 0.
        assert_eq!(bench.read(base + PSR), 0x707);
    }
    assert_eq!(bench.take_misuse(), [""; 0]);
}

#[test]
fn configuration_is_protected() {
    let mut bench = new();
    bench.write(NBTP, 0x1234);
    bench.write(TXBC, 4);
    bench.write(CCCR, cccr::INIT | cccr::FDOE | cccr::MON);
    assert_eq!(bench.read(NBTP), 0x0600_0A03);
    assert_eq!(bench.read(CCCR), cccr::INIT);
    assert_eq!(bench.take_misuse().len(), 3);
    bench.write(CCCR, cccr::INIT | cccr::CCE);
    bench.write(NBTP, 0x1234);
    assert_eq!(bench.read(NBTP), 0x1234);
    bench.write(CCCR, cccr::INIT | cccr::CCE | cccr::FDOE | cccr::MON);
    bench.write(CCCR, cccr::INIT | cccr::FDOE);
    assert_eq!(bench.read(CCCR), cccr::INIT | cccr::FDOE, "MON is cleared at any time");
    assert_eq!(bench.take_misuse(), [""; 0]);
    bench.write(CCCR, cccr::FDOE);
    assert_eq!(bench.read(CCCR), cccr::FDOE);
    bench.take_misuse();
    bench.write(CCCR, cccr::FDOE | cccr::CCE);
    assert_eq!(bench.read(CCCR), cccr::FDOE);
    assert_eq!(bench.take_misuse().len(), 1);
}

#[test]
fn a_frame_takes_its_bits_and_completes_at_the_end_of_eof() {
    let mut bench = running(0);
    fill(&mut bench, 0, 0x2AA, 0x55);
    let start_ns = bench.now_ns;
    bench.write(TXBAR, 1);
    assert_eq!(bench.read(TXBRP), 1);
    assert_eq!(bench.read(PSR) >> psr::ACT_AT & 3, 3);
    let expected = frame(0x2AA, &[0x55]);
    let length_ns = bench.peripheral.frame_ns(1, &expected);
    // A frame with one byte has 52 bits, and at most (42 - 1) / 4 stuff bits.
    assert!((52 * BIT_NS..=62 * BIT_NS).contains(&length_ns), "{length_ns}");
    bench.run_until(start_ns + length_ns - 1);
    assert_eq!(bench.wires.can, [(1, start_ns + length_ns - 8 * BIT_NS, expected)]);
    assert_eq!(bench.read(TXBRP), 1);
    assert!(!bench.irq(19));
    bench.run_until(start_ns + length_ns);
    assert!(bench.irq(19) && !bench.irq(21));
    assert_eq!(bench.read(IR), ir::TC | ir::TFE);
    assert_eq!((bench.read(TXBRP), bench.read(TXBTO), bench.read(TXBCF)), (0, 1, 0));
    assert_eq!(bench.read(PSR) & 7, 0);
    assert_eq!(bench.read(PSR) & 7, 7, "set on read");
    bench.write(ILS, ir::TC);
    bench.write(IR, ir::TFE);
    assert!(!bench.irq(19) && bench.irq(21));
    bench.write(IR, ir::TC);
    assert!(!bench.irq(21));
}

#[test]
fn a_fifo_sends_in_order_and_a_queue_by_identifier() {
    // The first frame is on the wire before the others are requested.
    for (queue, order) in [(0, [0x30, 0x20, 0x10]), (txbc::TFQM, [0x30, 0x10, 0x20])] {
        let mut bench = configured(0);
        bench.write(TXBC, BUFFERS << 2 | 3 << 24 | queue);
        run(&mut bench);
        for (nth, id) in [0x30, 0x20, 0x10].into_iter().enumerate() {
            assert_eq!(bench.read(TXFQS) >> 16 & 0x1F, nth as u32, "put index");
            fill(&mut bench, nth as u32, id, 0);
            bench.write(TXBAR, 1 << nth);
        }
        assert_eq!(bench.read(TXFQS) >> 21, 1, "full");
        if queue == 0 {
            assert_eq!(bench.read(TXFQS) & 0x3F, 0);
        }
        bench.run_until(bench.now_ns + 1_000_000);
        assert_eq!(sent_ids(&bench), order);
        if queue == 0 {
            assert_eq!(bench.read(TXFQS), 3, "free again, both indices at the start");
        }
        assert_eq!(bench.take_misuse(), [""; 0]);
    }
    // With all three requested at once, the lowest identifier is first, except in a FIFO.
    for (queue, order) in [(0, [0x30, 0x20, 0x10]), (txbc::TFQM, [0x10, 0x20, 0x30])] {
        let mut bench = configured(0);
        bench.write(TXBC, BUFFERS << 2 | 3 << 24 | queue);
        run(&mut bench);
        for (nth, id) in [0x30, 0x20, 0x10].into_iter().enumerate() {
            fill(&mut bench, nth as u32, id, 0);
        }
        bench.write(TXBAR, 7);
        bench.run_until(bench.now_ns + 1_000_000);
        assert_eq!(sent_ids(&bench), order);
    }
}

#[test]
fn frames_follow_after_the_intermission() {
    let mut bench = running(0);
    fill(&mut bench, 0, 0x100, 0);
    fill(&mut bench, 1, 0x100, 0);
    let start_ns = bench.now_ns;
    bench.write(TXBAR, 3);
    bench.run_until(start_ns + 1_000_000);
    let length_ns = bench.peripheral.frame_ns(1, &frame(0x100, &[0]));
    assert_eq!(bench.wires.can[1].1 - bench.wires.can[0].1, length_ns + 3 * BIT_NS);
}

#[test]
fn a_standard_frame_goes_before_an_extended_one_with_the_same_first_bits() {
    let mut bench = configured(0);
    bench.write(TXBC, BUFFERS << 2 | 3 << 16); // three dedicated buffers
    run(&mut bench);
    fill(&mut bench, 0, 0x101, 0);
    fill(&mut bench, 2, 0x100, 0);
    set_ram(&mut bench, BUFFERS + ELEMENT, ram::XTD | 0x100 << 18 | 5);
    set_ram(&mut bench, BUFFERS + ELEMENT + 1, 0);
    bench.write(TXBAR, 7);
    bench.run_until(bench.now_ns + 1_000_000);
    assert_eq!(sent_ids(&bench), [0x100, 0x100 << 18 | 5, 0x101]);
    assert!(bench.wires.can[1].2.extended);
}

#[test]
fn fd_with_bit_rate_switch() {
    let mut bench = running(cccr::FDOE | cccr::BRSE);
    set_ram(&mut bench, BUFFERS, 0x123 << 18);
    set_ram(&mut bench, BUFFERS + 1, ram::FDF | ram::BRS | 15 << 16);
    for nth in 0..16 {
        set_ram(&mut bench, BUFFERS + 2 + nth, 0x0302_0100 + 0x0404_0404 * nth);
    }
    let start_ns = bench.now_ns;
    bench.write(TXBAR, 1);
    bench.run_until(start_ns + 1_000_000);
    let data: Vec<u8> = (0..64).collect();
    let expected = CanFrame { fd: true, bit_rate_switch: true, ..frame(0x123, &data) };
    assert_eq!(bench.wires.can[0].2, expected);
    let slow = CanFrame { bit_rate_switch: false, ..expected };
    let (fast_ns, slow_ns) = (bench.wires.can[0].1 - start_ns, bench.peripheral.frame_ns(1, &slow) - 8 * BIT_NS);
    // 512 data bits, ESI, DLC and 32 bits of the CRC field take a fifth of the time.
    assert!(fast_ns < slow_ns - 512 * 800 && fast_ns > slow_ns / 5, "{fast_ns} {slow_ns}");
    assert_eq!(bench.read(PSR) >> psr::DLEC_AT & 7, 0);
    // Without FDOE the same buffer is a classic frame of eight bytes.
    let mut bench = running(0);
    set_ram(&mut bench, BUFFERS, 0x123 << 18);
    set_ram(&mut bench, BUFFERS + 1, ram::FDF | ram::BRS | 15 << 16);
    bench.write(TXBAR, 1);
    bench.run_until(1_000_000);
    assert_eq!(bench.wires.can[0].2, frame(0x123, &[0; 8]));
}

#[test]
fn what_does_not_fit_the_element_is_padded() {
    let mut bench = configured(cccr::FDOE);
    bench.write(TXESC, 0);
    run(&mut bench);
    set_ram(&mut bench, BUFFERS, 1 << 18);
    set_ram(&mut bench, BUFFERS + 1, ram::FDF | 9 << 16);
    bench.write(TXBAR, 1);
    bench.run_until(bench.now_ns + 1_000_000);
    assert_eq!(bench.wires.can[0].2.data, [0, 0, 0, 0, 0, 0, 0, 0, 0xCC, 0xCC, 0xCC, 0xCC]);
}

#[test]
fn a_node_alone_becomes_error_passive_but_not_bus_off() {
    let mut bench = running(0);
    bench.wires.can_outcome = CanOutcome::NotAcknowledged;
    fill(&mut bench, 0, 0x100, 0);
    bench.write(TXBAR, 1);
    bench.run_until(bench.now_ns + 10_000_000);
    assert_eq!(bench.read(ECR) & 0xFFFF, 128);
    let state = bench.read(PSR);
    assert_eq!(state & (psr::BO | psr::EP | psr::EW), psr::EP | psr::EW);
    assert_eq!(state & 7, 3, "AckError");
    assert_eq!(bench.read(IR), ir::PEA | ir::EP | ir::EW);
    assert_eq!(bench.read(TXBRP), 1);
    let times: Vec<u64> = bench.wires.can.iter().map(|(_, at_ns, _)| *at_ns).collect();
    let to_ack_ns = bench.peripheral.frame_ns(1, &frame(0x100, &[0])) - 8 * BIT_NS;
    assert_eq!(times[1] - times[0], to_ack_ns + 17 * BIT_NS, "error frame and intermission");
    assert_eq!(times[100] - times[99], to_ack_ns + 25 * BIT_NS, "and 8 bits of an error-passive node");
    // Another node joins the bus.
    bench.wires.can_outcome = CanOutcome::Acknowledged;
    bench.run_until(bench.now_ns + 1_000_000);
    assert_eq!(bench.read(TXBTO), 1);
    assert_eq!(bench.read(ECR) & 0xFF, 127);
    assert_eq!(bench.read(PSR) & (psr::EP | psr::EW), psr::EW);
}

#[test]
fn destroyed_frames_lead_to_bus_off_and_init_back_from_it() {
    let mut bench = running(0);
    bench.wires.can_outcome = CanOutcome::BitError;
    fill(&mut bench, 0, 0x100, 0);
    bench.write(TXBAR, 1);
    bench.run_until(bench.now_ns + 10_000_000);
    assert_eq!(bench.wires.can.len(), 32, "8 each, up to 256");
    assert_eq!(bench.read(CCCR) & cccr::INIT, cccr::INIT);
    assert_eq!(bench.read(PSR) & psr::BO, psr::BO);
    assert_eq!(bench.read(IR) & ir::BO, ir::BO);
    bench.write(IR, ir::ALL);
    bench.wires.can_outcome = CanOutcome::Acknowledged;
    let start_ns = bench.now_ns;
    bench.write(CCCR, 0);
    bench.run_until(start_ns + 50 * 11 * BIT_NS);
    assert_eq!(bench.read(ECR) >> 8 & 0x7F, 50, "REC counts the sequences");
    assert_eq!(bench.read(PSR) & (psr::BO | 7), psr::BO | 5);
    bench.run_until(start_ns + 129 * 11 * BIT_NS - 1);
    assert_eq!(bench.read(PSR) & psr::BO, psr::BO);
    assert_eq!(bench.wires.can.len(), 32);
    bench.run_until(start_ns + 129 * 11 * BIT_NS);
    assert_eq!(bench.read(PSR) & (psr::BO | psr::EP | psr::EW), 0);
    assert_eq!(bench.read(ECR) & 0xFFFF, 0);
    assert_eq!(bench.read(IR) & ir::BO, ir::BO);
    bench.run_until(bench.now_ns + 1_000_000);
    assert_eq!(bench.wires.can.len(), 33, "the request was kept");
}

/// Rule 6: a dominant bus counts 8 after the 14th bit behind the error flag, and 8 again after each further 8 bits.
#[test]
fn a_transmitter_on_a_dominant_bus_goes_off_it_and_stays_so_until_it_is_recessive() {
    let mut bench = running(0);
    fill(&mut bench, 0, 0x100, 0);
    bench.write(TXBAR, 1);
    bench.run_until(bench.now_ns + 20 * BIT_NS);
    let begin_ns = bench.now_ns;
    assert!(bench.peripheral.sends_until_ns(1).is_some());
    bench.with(|fdcan, context| fdcan.hold_dominant(1, true, context));
    assert_eq!((bench.read(ECR) & 0xFF, bench.read(PSR) & 7), (8, 4), "Bit1Error");
    bench.run_until(begin_ns + 20 * BIT_NS - 1);
    assert_eq!(bench.read(ECR) & 0xFF, 8);
    bench.run_until(begin_ns + 20 * BIT_NS);
    assert_eq!(bench.read(ECR) & 0xFF, 16);
    bench.run_until(begin_ns + (20 + 8 * 10) * BIT_NS);
    assert_eq!((bench.read(ECR) & 0xFF, bench.read(PSR) & psr::EW), (96, psr::EW));
    // The sum of 8 * 2 and 30 times 8 is 256.
    bench.run_until(begin_ns + (20 + 8 * 30) * BIT_NS - 1);
    assert_eq!(bench.read(PSR) & psr::BO, 0);
    bench.run_until(begin_ns + (20 + 8 * 30) * BIT_NS);
    assert_eq!(bench.read(PSR) & psr::BO, psr::BO);
    bench.write(CCCR, 0);
    bench.run_until(bench.now_ns + 10_000 * BIT_NS);
    assert_eq!((bench.read(PSR) & psr::BO, bench.read(ECR) >> 8 & 0x7F), (psr::BO, 0), "no recessive bit yet");
    let end_ns = bench.now_ns;
    bench.with(|fdcan, context| fdcan.hold_dominant(1, false, context));
    bench.run_until(end_ns + 129 * 11 * BIT_NS - 1);
    assert_eq!(bench.read(PSR) & psr::BO, psr::BO);
    assert_eq!(sent_ids(&bench), []);
    bench.run_until(end_ns + 129 * 11 * BIT_NS + 1_000_000);
    assert_eq!(bench.read(PSR) & psr::BO, 0);
    assert_eq!(sent_ids(&bench), [0x100], "the request was kept");
}

#[test]
fn a_receiver_on_a_dominant_bus_becomes_error_passive_and_loses_no_request() {
    let mut bench = running(0);
    let begin_ns = bench.now_ns;
    bench.with(|fdcan, context| fdcan.hold_dominant(1, true, context));
    fill(&mut bench, 0, 0x100, 0);
    bench.write(TXBAR, 1);
    bench.run_until(begin_ns + 10_000 * BIT_NS);
    assert_eq!(bench.read(ECR) & 0xFFFF, 1 << 15 | 127 << 8, "error passive by what it received");
    assert_eq!(bench.read(PSR) & (psr::BO | psr::EP), psr::EP);
    let end_ns = bench.now_ns;
    bench.with(|fdcan, context| fdcan.hold_dominant(1, false, context));
    bench.run_until(end_ns + 11 * BIT_NS - 1);
    assert_eq!(bench.peripheral.sends_until_ns(1), None);
    bench.run_until(end_ns + 1_000_000);
    assert_eq!(sent_ids(&bench), [0x100]);
}

#[test]
fn without_retransmission_a_lost_frame_is_cancelled() {
    let mut bench = running(cccr::DAR);
    bench.write(TXBCIE, 1);
    bench.wires.can_outcome = CanOutcome::NotAcknowledged;
    fill(&mut bench, 0, 0x100, 0);
    bench.write(TXBAR, 1);
    bench.run_until(bench.now_ns + 1_000_000);
    assert_eq!(bench.wires.can.len(), 1);
    assert_eq!((bench.read(TXBRP), bench.read(TXBTO), bench.read(TXBCF)), (0, 0, 1));
    assert_eq!(bench.read(IR) & (ir::TCF | ir::TC), ir::TCF);
    assert_eq!(bench.read(ECR) & 0xFF, 8);
}

#[test]
fn cancellation_before_within_and_without_a_transmission() {
    let mut bench = configured(0);
    bench.write(TXBC, BUFFERS << 2 | 3 << 24 | txbc::TFQM);
    run(&mut bench);
    bench.wires.can_outcome = CanOutcome::NotAcknowledged;
    for buffer in 0..3 {
        fill(&mut bench, buffer, 0x100 + buffer, 0);
    }
    bench.write(TXBAR, 3);
    bench.write(TXBCR, 2 | 4);
    assert_eq!((bench.read(TXBRP), bench.read(TXBCF)), (1, 6));
    bench.write(TXBCR, 1);
    assert_eq!((bench.read(TXBRP), bench.read(TXBCR)), (1, 1), "until it is over");
    bench.run_until(bench.now_ns + 1_000_000);
    assert_eq!((bench.read(TXBRP), bench.read(TXBCR), bench.read(TXBCF), bench.read(TXBTO)), (0, 0, 7, 0));
    assert_eq!(sent_ids(&bench), [0x100]);
}

#[test]
fn events_of_transmissions_are_stored() {
    let mut bench = running(0);
    for (buffer, marker) in [(0, 0xA1), (1, 0xA2), (2, 0xA3)] {
        fill(&mut bench, buffer, 0x100 + buffer, 0);
        set_ram(&mut bench, BUFFERS + ELEMENT * buffer + 1, marker << 24 | ram::EFC | 1 << 16);
    }
    bench.write(TXBAR, 7);
    bench.run_until(bench.now_ns + 1_000_000);
    // The FIFO has two elements, so the third event is lost.
    assert_eq!(bench.read(IR) & (ir::TEFN | ir::TEFF | ir::TEFL), ir::TEFN | ir::TEFF | ir::TEFL);
    assert_eq!(bench.read(TXEFS), 1 << 25 | 1 << 24 | 2);
    assert_eq!(ram(&mut bench, EVENTS), 0x100 << 18);
    assert_eq!(ram(&mut bench, EVENTS + 1), 0xA1 << 24 | 1 << 22 | 1 << 16);
    assert_eq!(ram(&mut bench, EVENTS + 3) >> 24, 0xA2);
    bench.write(TXEFA, 1);
    assert_eq!(bench.read(TXEFS) & 0x3F, 0);
    bench.write(IR, ir::TEFL);
    assert_eq!(bench.read(TXEFS) >> 25, 0);
}

#[test]
fn a_frame_arrives_in_fifo_0() {
    let mut bench = running(cccr::FDOE);
    bench.write(IR, ir::ALL);
    receive(&mut bench, frame(0x321, &[1, 2, 3, 4, 5]));
    assert!(bench.irq(19));
    assert_eq!(bench.read(IR), ir::RF0N);
    assert_eq!(bench.read(RXF0S), 1 << 16 | 1);
    assert_eq!(ram(&mut bench, FIFO_0), 0x321 << 18);
    assert_eq!(ram(&mut bench, FIFO_0 + 1), 1 << 31 | 5 << 16);
    assert_eq!((ram(&mut bench, FIFO_0 + 2), ram(&mut bench, FIFO_0 + 3)), (0x0403_0201, 5));
    receive(&mut bench, CanFrame { extended: true, fd: true, ..frame(0x1ABC_DEF0, &[7; 12]) });
    assert_eq!(bench.read(IR) & ir::RF0W, ir::RF0W, "watermark of two");
    assert_eq!(ram(&mut bench, FIFO_0 + ELEMENT), ram::XTD | 0x1ABC_DEF0);
    assert_eq!(ram(&mut bench, FIFO_0 + ELEMENT + 1), 1 << 31 | ram::FDF | 9 << 16);
    assert_eq!(bench.read(PSR) & (psr::REDL | psr::RBRS), psr::REDL);
    bench.write(RXF0A, 1);
    assert_eq!(bench.read(RXF0S), 2 << 16 | 2 << 8);
    bench.write(RXF0A, 1);
    assert_eq!(bench.take_misuse().len(), 1, "not held");
}

#[test]
fn a_full_fifo_blocks_or_overwrites() {
    for overwrite in [0, 1 << 31] {
        let mut bench = configured(0);
        bench.write(RXF0C, FIFO_0 << 2 | 3 << 16 | overwrite);
        run(&mut bench);
        for id in 0..3 {
            receive(&mut bench, frame(id, &[]));
        }
        assert_eq!(bench.read(IR) & (ir::RF0F | ir::RF0L), ir::RF0F);
        assert_eq!(bench.read(RXF0S), 1 << 24 | 3);
        receive(&mut bench, frame(3, &[]));
        if overwrite == 0 {
            assert_eq!(bench.read(IR) & ir::RF0L, ir::RF0L);
            assert_eq!(bench.read(RXF0S), 1 << 25 | 1 << 24 | 3);
            assert_eq!(ram(&mut bench, FIFO_0), 0);
        } else {
            assert_eq!(bench.read(IR) & ir::RF0L, 0);
            assert_eq!(bench.read(RXF0S), 1 << 24 | 1 << 16 | 1 << 8 | 3);
            assert_eq!(ram(&mut bench, FIFO_0), 3 << 18);
        }
    }
}

/// Returns the new elements in FIFO 0 and FIFO 1 after the filters have judged a frame.
fn filtered(filters: &[u32], extended_filters: &[(u32, u32)], gfc: u32, xidam: u32, frame: CanFrame) -> [u32; 2] {
    let mut bench = configured(0);
    bench.write(SIDFC, FILTERS << 2 | (filters.len() as u32) << 16);
    bench.write(XIDFC, EXTENDED << 2 | (extended_filters.len() as u32) << 16);
    bench.write(GFC, gfc);
    bench.write(XIDAM, xidam);
    for (nth, filter) in filters.iter().enumerate() {
        set_ram(&mut bench, FILTERS + nth as u32, *filter);
    }
    for (nth, (first, second)) in extended_filters.iter().enumerate() {
        set_ram(&mut bench, EXTENDED + 2 * nth as u32, *first);
        set_ram(&mut bench, EXTENDED + 2 * nth as u32 + 1, *second);
    }
    run(&mut bench);
    receive(&mut bench, frame);
    [bench.read(RXF0S) & 0x7F, bench.read(RXF1S) & 0x7F]
}

#[test]
fn standard_filters() {
    let reject_others = 0b10_1000;
    let range = 1 << 27 | 0x100 << 16 | 0x1FF;
    let dual = 0b01 << 30 | 2 << 27 | 0x300 << 16 | 0x305;
    let mask = 0b10 << 30 | 1 << 27 | 0x400 << 16 | 0x7F0;
    let off = 0b11 << 30 | 1 << 27 | 0x7FF;
    let reject = 3 << 27 | 0x150 << 16 | 0x15F;
    for (filters, id, stored) in [
        (vec![range], 0x100, [1, 0]),
        (vec![range], 0x1FF, [1, 0]),
        (vec![range], 0x200, [0, 0]),
        (vec![dual], 0x300, [0, 1]),
        (vec![dual], 0x305, [0, 1]),
        (vec![dual], 0x302, [0, 0]),
        (vec![mask], 0x40F, [1, 0]),
        (vec![mask], 0x410, [0, 0]),
        (vec![off], 0x005, [0, 0]),
        (vec![reject, range], 0x155, [0, 0]),
        (vec![reject, range], 0x165, [1, 0]),
        (vec![off, range & !(7 << 27), range], 0x100, [1, 0]),
    ] {
        assert_eq!(filtered(&filters, &[], reject_others, 0x1FFF_FFFF, frame(id, &[])), stored, "{filters:x?} {id:#x}");
    }
    // Frames without a match go by GFC to FIFO 0, to FIFO 1, or are rejected.
    for (anfs, stored) in [(0, [1, 0]), (1, [0, 1]), (2, [0, 0]), (3, [0, 0])] {
        assert_eq!(filtered(&[off], &[], anfs << 4, 0x1FFF_FFFF, frame(5, &[])), stored);
    }
    let remote = CanFrame { remote: true, ..frame(5, &[]) };
    assert_eq!(filtered(&[], &[], 0, 0, remote.clone()), [1, 0]);
    assert_eq!(filtered(&[], &[], 2, 0, remote), [0, 0]);
}

#[test]
fn extended_filters() {
    let reject_others = 0b10_1000;
    let all = 0x1FFF_FFFF;
    let extended = |id: u32| CanFrame { extended: true, ..frame(id, &[]) };
    let range = (1 << 29 | 0x1000_0000, 0x1000_FFFF);
    let range_unmasked = (1 << 29 | 0x1000_0000, 3 << 30 | 0x1000_FFFF);
    let mask = (2 << 29 | 0x0012_3400, 2 << 30 | 0x1FFF_FF00);
    let dual = (1 << 29 | 0x10, 1 << 30 | 0x20);
    for (filter, xidam, id, stored) in [
        (range, all, 0x1000_1234, [1, 0]),
        (range, all, 0x1001_0000, [0, 0]),
        (range, 0x1000_FFFF, 0x1F01_0000, [1, 0]),
        (range_unmasked, 0x1000_FFFF, 0x1F01_0000, [0, 0]),
        (mask, all, 0x0012_34FF, [0, 1]),
        (mask, all, 0x0012_35FF, [0, 0]),
        (dual, all, 0x20, [1, 0]),
        (dual, all, 0x11, [0, 0]),
    ] {
        assert_eq!(filtered(&[], &[filter], reject_others, xidam, extended(id)), stored, "{filter:x?} {id:#x}");
    }
    assert_eq!(filtered(&[], &[], 1 << 2, all, extended(1)), [0, 1]);
    assert_eq!(filtered(&[], &[], 1, all, CanFrame { remote: true, ..extended(1) }), [0, 0]);
}

#[test]
fn dedicated_buffers_and_priority() {
    let mut bench = configured(0);
    bench.write(SIDFC, FILTERS << 2 | 3 << 16);
    bench.write(RXBC, 1024 << 2);
    set_ram(&mut bench, FILTERS, 7 << 27 | 0x111 << 16 | 33); // into Rx buffer 33
    set_ram(&mut bench, FILTERS + 1, 5 << 27 | 0x111 << 16 | 0x112); // priority, FIFO 0
    set_ram(&mut bench, FILTERS + 2, 4 << 27 | 0x113 << 16 | 0x113); // priority only
    run(&mut bench);
    receive(&mut bench, frame(0x111, &[9]));
    assert_eq!((bench.read(NDAT1), bench.read(NDAT2)), (0, 2));
    assert_eq!(ram(&mut bench, 1024 + 33 * ELEMENT + 2), 9);
    assert_eq!(bench.read(IR) & (ir::DRX | ir::HPM | ir::RF0N), ir::DRX);
    // The buffer is locked, so the next element matches.
    receive(&mut bench, frame(0x111, &[8]));
    assert_eq!(bench.read(HPMS), 1 << 8 | 2 << 6);
    assert_eq!(bench.read(IR) & (ir::HPM | ir::RF0N), ir::HPM | ir::RF0N);
    assert_eq!(ram(&mut bench, FIFO_0 + 1) >> 24, 1, "index of the element");
    receive(&mut bench, frame(0x113, &[]));
    assert_eq!(bench.read(HPMS), 2 << 8);
    assert_eq!(bench.read(RXF0S) & 0x7F, 1);
    bench.write(NDAT2, 2);
    receive(&mut bench, frame(0x111, &[7]));
    assert_eq!(ram(&mut bench, 1024 + 33 * ELEMENT + 2), 7);
}

#[test]
fn a_transmission_waits_for_the_frame_of_another_node() {
    let mut bench = running(0);
    let others = frame(0x700, &[0; 8]);
    let end_ns = bench.now_ns + bench.peripheral.frame_ns(1, &others);
    bench.peripheral.receive(1, end_ns, others);
    bench.run_until(bench.now_ns + 10 * BIT_NS);
    assert_eq!(bench.read(PSR) >> psr::ACT_AT & 3, 2, "receiver");
    assert!(bench.peripheral.acknowledges(1, bench.now_ns));
    fill(&mut bench, 0, 0x001, 0);
    bench.write(TXBAR, 1);
    bench.run_until(end_ns + 1_000_000);
    let length_ns = bench.peripheral.frame_ns(1, &frame(1, &[0]));
    assert_eq!(bench.wires.can[0].1, end_ns + 3 * BIT_NS + length_ns - 8 * BIT_NS);
}

#[test]
fn frames_are_lost_until_eleven_recessive_bits() {
    let mut bench = configured(0);
    assert!(!bench.peripheral.acknowledges(1, 0));
    let length_ns = bench.peripheral.frame_ns(1, &frame(1, &[]));
    let value = bench.read(CCCR);
    bench.write(CCCR, value & !(cccr::CCE | cccr::INIT));
    bench.peripheral.receive(1, 5 * BIT_NS + length_ns, frame(1, &[]));
    bench.peripheral.receive(1, 20 * BIT_NS + 2 * length_ns, frame(2, &[]));
    bench.run_until(1_000_000);
    assert_eq!(bench.read(RXF0S) & 0x7F, 1);
    assert_eq!(ram(&mut bench, FIFO_0), 2 << 18);
}

#[test]
fn loop_back_external_and_internal() {
    for (mode, on_wire) in [(cccr::TEST, 1), (cccr::TEST | cccr::MON, 0)] {
        let mut bench = configured(mode);
        bench.write(TEST, test::LBCK);
        run(&mut bench);
        bench.wires.can_outcome = CanOutcome::NotAcknowledged;
        fill(&mut bench, 0, 0x42, 0x99);
        bench.write(TXBAR, 1);
        bench.run_until(bench.now_ns + 1_000_000);
        assert_eq!(bench.wires.can.len(), on_wire);
        assert_eq!(bench.read(IR) & (ir::TC | ir::RF0N), ir::TC | ir::RF0N);
        assert_eq!(ram(&mut bench, FIFO_0), 0x42 << 18);
        receive(&mut bench, frame(1, &[]));
        assert_eq!(bench.read(RXF0S) & 0x7F, 1, "the pin is not looked at");
    }
}

#[test]
fn bus_monitoring_only_listens() {
    let mut bench = running(cccr::MON);
    fill(&mut bench, 0, 1, 0);
    bench.write(TXBAR, 1);
    assert_eq!(bench.read(TXBRP), 0);
    assert!(!bench.peripheral.acknowledges(1, bench.now_ns));
    receive(&mut bench, frame(1, &[]));
    assert_eq!(bench.read(RXF0S) & 0x7F, 1);
    assert_eq!(bench.wires.can, []);
}

#[test]
fn an_fd_frame_is_an_error_to_a_classic_node() {
    let mut bench = running(0);
    receive(&mut bench, CanFrame { fd: true, ..frame(1, &[]) });
    assert_eq!(bench.read(RXF0S) & 0x7F, 0);
    assert_eq!(bench.read(PSR) & 7, 2, "form error");
    assert_eq!(bench.read(ECR), 1 << 16 | 1 << 8);
    assert_eq!(bench.read(ECR), 1 << 8, "CEL is cleared by reading");
    receive(&mut bench, frame(1, &[]));
    assert_eq!(bench.read(ECR) & 0xFFFF, 0);
}

#[test]
fn injected_errors_show() {
    let mut bench = running(0);
    bench.with(|fdcan, context| fdcan.set_error_counters(1, 100, 128, context));
    assert_eq!(bench.read(ECR), 1 << 15 | 127 << 8 | 100);
    assert_eq!(bench.read(IR), ir::EW | ir::EP);
    receive(&mut bench, frame(1, &[]));
    assert_eq!(bench.read(ECR) >> 8, 119);
    bench.with(|fdcan, context| fdcan.inject_receive_error(1, context));
    assert_eq!(bench.read(ECR) >> 8 & 0x7F, 120);
    bench.with(|fdcan, context| fdcan.inject_bus_off(1, context));
    assert!(bench.irq(19));
    assert_eq!(bench.read(CCCR) & cccr::INIT, 1);
    assert_eq!(bench.read(0x400 + PSR) & psr::BO, 0, "the other module goes on");
}

#[test]
fn timestamps_count_bits() {
    let mut bench = configured(0);
    bench.write(TSCC, 1 | 1 << 16); // every two bits
    let start_ns = bench.now_ns;
    run(&mut bench);
    bench.run_until(start_ns + 2_000 * 100 + 1);
    assert_eq!(bench.read(TSCV), 100);
    let length_ns = bench.peripheral.frame_ns(1, &frame(1, &[]));
    bench.peripheral.receive(1, start_ns + 2_000 * 200 + length_ns, frame(1, &[]));
    bench.run_until(start_ns + 2_000 * 0x1_0000 - 1);
    assert_eq!(ram(&mut bench, FIFO_0 + 1) & 0xFFFF, 200, "start of frame");
    assert_eq!(bench.read(IR) & ir::TSW, 0);
    bench.run_until(start_ns + 2_000 * 0x1_0000 + 5_000);
    assert_eq!(bench.read(IR) & ir::TSW, ir::TSW);
    assert_eq!(bench.read(TSCV), 2);
    bench.write(TSCV, 0);
    assert_eq!(bench.read(TSCV), 0);
}

#[test]
fn clock_stop_waits_for_what_is_pending() {
    let mut bench = running(0);
    fill(&mut bench, 0, 1, 0);
    bench.write(TXBAR, 1);
    bench.write(CCCR, cccr::CSR);
    assert_eq!(bench.read(CCCR), cccr::CSR);
    bench.run_until(bench.now_ns + 1_000_000);
    assert_eq!(bench.read(CCCR), cccr::CSR | cccr::CSA | cccr::INIT);
    assert_eq!(bench.read(TXBTO), 1);
    bench.write(CCCR, cccr::INIT);
    assert_eq!(bench.read(CCCR), cccr::INIT);
}

#[test]
fn configuration_mode_clears_the_handlers() {
    let mut bench = running(0);
    bench.wires.can_outcome = CanOutcome::NotAcknowledged;
    fill(&mut bench, 0, 1, 0);
    bench.write(TXBAR, 1);
    receive(&mut bench, frame(1, &[]));
    bench.write(CCCR, cccr::INIT);
    assert_eq!(bench.read(TXBRP), 1);
    let frames = bench.wires.can.len();
    bench.write(CCCR, cccr::INIT | cccr::CCE);
    assert_eq!((bench.read(TXBRP), bench.read(RXF0S), bench.read(TXFQS)), (0, 0, 3));
    bench.write(TXBAR, 1);
    assert_eq!(bench.take_misuse().len(), 1);
    bench.run_until(bench.now_ns + 1_000_000);
    assert_eq!(bench.wires.can.len(), frames);
}

#[test]
fn both_modules_share_the_ram() {
    let mut bench = running(0);
    set_ram(&mut bench, 2559, 0xCAFE_F00D);
    assert_eq!(ram(&mut bench, 2559), 0xCAFE_F00D);
    assert_eq!(bench.with(|fdcan, context| fdcan.read(RAM + 4 * 2559 + 1, Size::Byte, context)).unwrap(), 0xF0);
    assert!(bench.with(|fdcan, context| fdcan.read(RAM + 4 * 2560, Size::Word, context)).is_err());
    bench.with(|fdcan, context| fdcan.write(RAM, Size::Byte, 1, context)).unwrap();
    assert_eq!(bench.take_misuse().len(), 1);
    // FDCAN2 with the same layout sends the frame that FDCAN1 would.
    fill(&mut bench, 0, 0x77, 1);
    let base = 0x400;
    bench.write(base + CCCR, 3);
    bench.write(base + NBTP, 62 << 8 | 15);
    bench.write(base + TXBC, BUFFERS << 2 | 3 << 24);
    bench.write(base + TXBTIE, 1);
    bench.write(base + IE, ir::TC);
    bench.write(base + ILE, 1);
    bench.write(base + CCCR, 0);
    bench.write(base + TXBAR, 1);
    bench.run_until(bench.now_ns + 1_000_000);
    assert_eq!(bench.wires.can[0].0, 2);
    assert!(bench.irq(20) && !bench.irq(19));
    bench.with(|fdcan, context| fdcan.reset(context));
    assert!(!bench.irq(20));
    assert_eq!(bench.read(base + CCCR), 1);
}

#[test]
fn what_is_not_modelled_is_refused() {
    let mut bench = configured(0);
    assert!(bench.try_write(TSCC, 2).is_err());
    assert!(bench.try_write(TOCC, 1).is_err());
    assert!(bench.try_write(0x100, 0).is_err()); // TTCAN
    assert!(bench.try_write(0x804, 0).is_err()); // clock calibration
    assert!(bench.with(|fdcan, context| fdcan.read(CCCR, Size::Byte, context)).is_err());
}

#[test]
fn misuse_of_clocks_is_reported() {
    let mut bench = configured(cccr::FDOE | cccr::BRSE);
    bench.write(DBTP, 31 << 16 | 31 << 8);
    bench.clocks.apb1_hz = 40_000_000;
    let value = bench.read(CCCR);
    bench.write(CCCR, value & !3);
    assert_eq!(bench.take_misuse().len(), 2);
}

proptest! {
    /// More frequent advances change nothing: not the sent frames, the counters, the stored frames or the flags.
    #[test]
    fn looking_more_often_changes_nothing(
        cuts in prop::collection::vec(0..3_000_000_u64, 0..20),
        outcomes in prop::collection::vec(0..3_u8, 0..40),
        gaps in prop::collection::vec(0..500_000_u64, 0..5),
        queue: bool,
    ) {
        let outcome = |mut cuts: Vec<u64>| {
            let mut bench = configured(0);
            bench.write(TSCC, 1);
            bench.write(TXBC, BUFFERS << 2 | 3 << 24 | if queue { txbc::TFQM } else { 0 });
            run(&mut bench);
            bench.wires.can_outcomes = outcomes
                .iter()
                .map(|outcome| {
                    [CanOutcome::Acknowledged, CanOutcome::NotAcknowledged, CanOutcome::BitError][usize::from(*outcome)]
                })
                .collect();
            for buffer in 0..3 {
                fill(&mut bench, buffer, 0x300 - buffer, buffer);
            }
            bench.write(TXBAR, 7);
            let mut at_ns = bench.now_ns;
            for (nth, gap_ns) in gaps.iter().enumerate() {
                at_ns += 100_000 + gap_ns;
                bench.peripheral.receive(1, at_ns, frame(nth as u32, &[nth as u8]));
            }
            cuts.sort_unstable();
            for cut_ns in cuts {
                bench.run_until(bench.now_ns.max(cut_ns));
            }
            bench.run_until(20_000_000);
            let registers: Vec<u32> =
                [IR, ECR, PSR, TXBRP, TXBTO, TXBCF, TXFQS, RXF0S, TSCV].into_iter().map(|offset| bench.read(offset)).collect();
            let memory: Vec<u32> = (FIFO_0..FIFO_0 + 3 * ELEMENT).map(|word| ram(&mut bench, word)).collect();
            (bench.wires.can, registers, memory)
        };
        prop_assert_eq!(outcome(cuts), outcome(Vec::new()));
    }
}
