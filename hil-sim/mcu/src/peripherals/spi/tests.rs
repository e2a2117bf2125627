//! Tests with sequences of RM0399, 53.4, and with misuse. The clock is 64 MHz / 64: clocks of 1 µs, frames of 8 µs.

use super::registers::*;
use super::*;
use crate::context::Clocks;
use crate::peripherals::bench::Bench;
use crate::{Peripheral, Size};

/// CFG1: divider 64, 8 bits, packets of one frame.
const CFG1_VALUE: u32 = 5 << cfg1::MBR_AT | 7 << 16 | 7;
/// CFG2: master, SS by software: SSI = 0 is inactive for an SS that is active high.
const CFG2_VALUE: u32 = cfg2::MASTER | cfg2::SSM | cfg2::SSIOP;

fn configured(cfg1_value: u32, cfg2_value: u32) -> Bench<Spi> {
    let mut bench = Bench::new(Spi::new(), Clocks { spi123_hz: 64_000_000, ..Clocks::default() });
    bench.write(CFG1, cfg1_value);
    bench.write(CFG2, cfg2_value);
    bench
}

fn started(cfg1_value: u32, cfg2_value: u32) -> Bench<Spi> {
    let mut bench = configured(cfg1_value, cfg2_value);
    bench.write(CR1, cr1::SPE);
    bench.write(CR1, cr1::SPE | cr1::CSTART);
    bench
}

fn put(bench: &mut Bench<Spi>, size: Size, value: u32) {
    bench.with(|spi, context| spi.write(TXDR, size, value, context)).unwrap();
}

#[test]
fn reset_values() {
    let mut bench = Bench::new(Spi::new(), Clocks::default());
    for (offset, value) in
        [(CR1, 0), (CR2, 0), (CFG1, 0x0007_0007), (CFG2, 0), (SR, 0x1002), (CRCPOLY, 0x107), (I2SCFGR, 0)]
    {
        assert_eq!(bench.read(offset), value, "{offset:#x}");
    }
}

#[test]
fn frames_are_back_to_back_while_the_fifo_holds_one() {
    let mut bench = started(CFG1_VALUE, CFG2_VALUE);
    assert_eq!(bench.read(SR) & (sr::TXC | sr::TXP), sr::TXC | sr::TXP);
    put(&mut bench, Size::Byte, 0x12);
    put(&mut bench, Size::Byte, 0x34);
    assert_eq!(bench.read(SR) & sr::TXC, 0);
    bench.run_until(15_999);
    assert_eq!(bench.read(SR) & sr::TXC, 0);
    bench.run_until(16_000);
    assert_eq!(bench.read(SR) & sr::TXC, sr::TXC);
    assert_eq!(bench.wires.spi, [(1, 8_000, 0x12, 8), (1, 16_000, 0x34, 8)]);
    bench.run_until(20_000);
    put(&mut bench, Size::Byte, 0x56);
    bench.run_until(30_000);
    assert_eq!(bench.wires.spi[2], (1, 28_000, 0x56, 8));
    assert!((bench.peripheral.sck_hz() - 1e6).abs() < 1e-6);
}

#[test]
fn nothing_leaves_before_cstart() {
    let mut bench = configured(CFG1_VALUE, CFG2_VALUE);
    bench.write(CR1, cr1::SPE);
    put(&mut bench, Size::Byte, 1);
    bench.run_until(100_000);
    assert_eq!(bench.wires.spi, []);
    bench.write(CR1, cr1::SPE | cr1::CSTART);
    bench.run_until(200_000);
    assert_eq!(bench.wires.spi, [(1, 108_000, 1, 8)]);
}

#[test]
fn sixteen_bytes_fit_and_dma_is_asked_for_more() {
    let mut bench = started(CFG1_VALUE | cfg1::TXDMAEN, CFG2_VALUE | 1 << cfg2::COMM_AT);
    let mut sent = 0;
    while bench.dma(38) {
        put(&mut bench, Size::Byte, sent);
        sent += 1;
    }
    assert_eq!(sent, 17, "16 wait, one is on the wire");
    bench.run_until(8_000);
    assert!(bench.dma(38));
    put(&mut bench, Size::Byte, sent);
    assert!(!bench.dma(38));
    bench.run_until(200_000);
    assert_eq!(bench.wires.spi.len(), 18);
    assert!(bench.wires.spi.iter().enumerate().all(|(nth, sent)| sent.1 == 8_000 * (nth as u64 + 1)));
    assert_eq!(bench.read(SR) & (sr::RXP | sr::OVR), 0, "a transmitter receives nothing");
    bench.write(CR1, 0);
    assert!(!bench.dma(38));
    assert_eq!(bench.take_misuse(), [""; 0]);
}

#[test]
fn wider_accesses_pack_frames_and_frames_have_their_bits() {
    let mut bench = started(CFG1_VALUE, CFG2_VALUE);
    put(&mut bench, Size::Word, 0x4433_2211);
    bench.run_until(32_000);
    assert_eq!(bench.wires.spi.iter().map(|sent| sent.2).collect::<Vec<_>>(), [0x11, 0x22, 0x33, 0x44]);
    // Frames of 16 bits, the least significant first.
    let mut bench = started(CFG1_VALUE & !0x1F | 15, CFG2_VALUE | cfg2::LSBFRST);
    put(&mut bench, Size::Word, 0x8001_1234);
    bench.run_until(32_000);
    assert_eq!(bench.wires.spi, [(1, 16_000, 0x2C48, 16), (1, 32_000, 0x8001, 16)]);
    put(&mut bench, Size::Byte, 1);
    assert_eq!(bench.take_misuse().len(), 1, "less than a frame");
}

#[test]
fn idle_clocks_between_frames() {
    let mut bench = started(CFG1_VALUE, CFG2_VALUE | 3 << cfg2::MIDI_AT);
    put(&mut bench, Size::Half, 0x0201);
    bench.run_until(100_000);
    assert_eq!(bench.wires.spi, [(1, 8_000, 1, 8), (1, 19_000, 2, 8)]);
}

#[test]
fn a_counted_transfer_ends_with_eot_and_may_be_extended() {
    let mut bench = configured(CFG1_VALUE, CFG2_VALUE);
    bench.write(CR2, 2 | 1 << 16);
    bench.write(IER, sr::EOT);
    bench.write(CR1, cr1::SPE);
    bench.write(CR1, cr1::SPE | cr1::CSTART);
    assert_eq!(bench.read(SR) >> sr::CTSIZE_AT, 2);
    put(&mut bench, Size::Half, 0x0201);
    bench.run_until(16_000);
    assert_eq!(bench.read(SR) & (sr::EOT | sr::TSERF | sr::TXC), sr::TSERF);
    put(&mut bench, Size::Byte, 3);
    assert_eq!(bench.read(SR) & (sr::TXTF | sr::TXP), sr::TXTF);
    assert!(!bench.irq(35));
    bench.run_until(24_000);
    assert!(bench.irq(35));
    assert_eq!(bench.read(SR) & (sr::EOT | sr::TXC), sr::EOT | sr::TXC);
    assert_eq!(bench.read(CR1) & cr1::CSTART, 0);
    bench.write(IFCR, sr::EOT | sr::TXTF | sr::TSERF);
    assert!(!bench.irq(35));
}

#[test]
fn full_duplex_fills_the_rx_fifo_and_overruns() {
    let mut bench = started(CFG1_VALUE, CFG2_VALUE);
    for nth in 0..17 {
        put(&mut bench, Size::Byte, nth);
    }
    bench.run_until(3 * 8_000);
    assert_eq!(bench.read(SR) & (sr::RXP | sr::RXWNE | 3 << sr::RXPLVL_AT), sr::RXP | 3 << sr::RXPLVL_AT);
    bench.run_until(16 * 8_000);
    assert_eq!(bench.read(SR) & (sr::OVR | sr::RXWNE), sr::RXWNE);
    bench.run_until(17 * 8_000);
    assert_eq!(bench.read(SR) & sr::OVR, sr::OVR);
    assert!(bench.with(|spi, context| spi.read(RXDR, Size::Byte, context)).is_err(), "MISO is not modelled");
    bench.write(CR1, 0);
    assert_eq!(bench.read(SR) & (sr::RXP | sr::RXWNE), 0);
    assert_eq!(bench.with(|spi, context| spi.read(RXDR, Size::Word, context)).unwrap(), 0);
    bench.write(IFCR, sr::OVR);
    assert_eq!(bench.read(SR), 0x1002);
}

#[test]
fn suspension_ends_after_the_frame() {
    let mut bench = started(CFG1_VALUE, CFG2_VALUE);
    put(&mut bench, Size::Half, 0);
    bench.run_until(1_000);
    bench.write(CR1, cr1::SPE | cr1::CSUSP);
    assert_eq!(bench.read(SR) & sr::SUSP, 0);
    bench.run_until(100_000);
    assert_eq!(bench.read(SR) & sr::SUSP, sr::SUSP);
    assert_eq!(bench.read(CR1), cr1::SPE);
    assert_eq!(bench.wires.spi.len(), 1);
}

#[test]
fn a_master_that_is_selected_has_a_mode_fault() {
    let mut bench = configured(CFG1_VALUE, cfg2::MASTER | cfg2::SSM);
    bench.write(CR1, cr1::SPE);
    assert_eq!(bench.read(CR1) & cr1::SPE, 0);
    assert_eq!(bench.read(SR) & sr::MODF, sr::MODF);
    bench.write(IFCR, sr::MODF);
    bench.write(CR1, cr1::SSI);
    bench.write(CR1, cr1::SSI | cr1::SPE);
    assert_eq!(bench.read(CR1) & cr1::SPE, cr1::SPE);
}

#[test]
fn misuse_is_reported() {
    let mut bench = started(CFG1_VALUE, CFG2_VALUE);
    bench.write(CFG1, CFG1_VALUE | 8);
    bench.write(CFG1, CFG1_VALUE | cfg1::TXDMAEN);
    assert_eq!(bench.read(CFG1), CFG1_VALUE | cfg1::TXDMAEN);
    bench.write(CFG2, CFG2_VALUE);
    bench.write(CR2, 5);
    assert_eq!(bench.take_misuse().len(), 3);
    for nth in 0..18 {
        put(&mut bench, Size::Byte, nth);
    }
    bench.write(CR1, 0);
    put(&mut bench, Size::Byte, 0);
    assert_eq!(bench.take_misuse().len(), 3); // full, frames lost, SPE is 0
    bench.run_until(1_000_000);
    assert_eq!(bench.wires.spi, []);
}

#[test]
fn what_is_not_modelled_is_refused() {
    let mut bench = configured(CFG1_VALUE, 0);
    assert!(bench.try_write(CR1, cr1::SPE).is_err()); // slave
    assert!(bench.try_write(CFG2, cfg2::MASTER | 2 << cfg2::COMM_AT).is_err());
    assert!(bench.try_write(CFG1, cfg1::CRCEN).is_err());
    assert!(bench.try_write(I2SCFGR, 1).is_err());
    assert!(bench.try_write(0x24, 0).is_err());
}

#[test]
fn reset_is_as_new() {
    let mut bench = started(CFG1_VALUE | cfg1::TXDMAEN, CFG2_VALUE);
    put(&mut bench, Size::Byte, 0);
    bench.with(|spi, context| spi.reset(context));
    assert!(!bench.dma(38));
    assert_eq!(bench.read(SR), 0x1002);
    assert_eq!(bench.peripheral.next_event_ns(), u64::MAX);
}
