//! Tests with sequences of RM0399, 51.5, and with misuse. 64 MHz / 64 gives bits of exactly 1 µs, so that frames of 10
//! bits end at round numbers.

use proptest::prelude::*;

use super::registers::*;
use super::*;
use crate::peripherals::bench::Bench;
use crate::{Peripheral, Size};

/// BRR for bits of 1 µs and frames of 10 µs.
const BRR_1M: u32 = 64;

fn bench(number: u8) -> Bench<Usart> {
    let clocks = Clocks { usart16_hz: 64_000_000, usart234578_hz: 64_000_000, ..Clocks::default() };
    Bench::new(Usart::new(number).unwrap(), clocks)
}

/// Makes a port that is switched on, after the idle frame and the first idle line.
fn started(number: u8, extra_cr1: u32) -> Bench<Usart> {
    let mut bench = bench(number);
    bench.write(BRR, BRR_1M);
    bench.write(CR1, cr1::UE | cr1::TE | cr1::RE | extra_cr1);
    bench.run_until(100_000);
    bench.write(ICR, isr::IDLE);
    assert_eq!(bench.take_misuse(), [""; 0]);
    bench
}

fn byte(at_ns: u64, value: u8) -> UartByte {
    UartByte { at_ns, value, framing_error: false, noise: false }
}

#[test]
fn reset_values() {
    let mut bench = bench(1);
    assert_eq!(bench.read(ISR), 0xC0); // TXE and TC (51.8.10)
    for offset in [CR1, CR2, CR3, BRR, RTOR, RDR, TDR, PRESC] {
        assert_eq!(bench.read(offset), 0);
    }
    assert!(Usart::new(9).is_none());
}

#[test]
fn the_first_frame_follows_the_idle_frame_and_then_they_are_back_to_back() {
    let mut bench = bench(3);
    bench.write(BRR, BRR_1M);
    bench.write(CR1, cr1::UE | cr1::TE);
    bench.write(TDR, 0x55);
    assert_eq!(bench.read(ISR) & (isr::TXE | isr::TC), 0, "TDR waits for the idle frame");
    bench.run_until(10_000);
    assert_eq!(bench.read(ISR) & (isr::TXE | isr::TC), isr::TXE);
    bench.write(TDR, 0xAA);
    bench.run_until(40_000);
    assert_eq!(bench.wires.uart, [(3, 20_000, 0x55), (3, 30_000, 0xAA)]);
    assert_eq!(bench.read(ISR) & (isr::TXE | isr::TC), isr::TXE | isr::TC);
}

#[test]
fn bits_take_the_time_of_the_manuals_examples() {
    // Examples of 51.5.7: 1, with 8 MHz, 9600 baud by 16 and by 8; 2, with 48 MHz, 921.6 kbaud.
    for (hz, brr, over8, dividend_hz, usartdiv) in [
        (8_000_000, 0x341, false, 8_000_000_u64, 833_u64),
        (8_000_000, 0x681, true, 16_000_000, 1666),
        (48_000_000, 0x34, false, 48_000_000, 52),
        (48_000_000, 0x64, true, 96_000_000, 104),
    ] {
        let mut bench = bench(6);
        bench.clocks.usart16_hz = hz;
        bench.write(BRR, brr);
        bench.write(CR1, if over8 { cr1::OVER8 | cr1::UE | cr1::TE } else { cr1::UE | cr1::TE });
        bench.write(TDR, 1);
        bench.run_until(10_000_000);
        let baud = dividend_hz as f64 / usartdiv as f64;
        assert!((bench.peripheral.baud() / baud - 1.0).abs() < 1e-12, "{}", bench.peripheral.baud());
        // The idle frame and the byte, 20 bits, are rounded up to a nanosecond once.
        assert_eq!(bench.wires.uart, [(6, (20_000_000_000 * usartdiv).div_ceil(dividend_hz), 1)]);
    }
}

#[test]
fn rounding_does_not_add_up() {
    let mut bench = started(1, cr1::FIFOEN);
    bench.write(CR1, 0);
    bench.write(BRR, 555); // 115 315 baud: a frame is 86 718.75 ns
    bench.write(CR1, cr1::UE | cr1::TE | cr1::FIFOEN);
    let start_ns = bench.now_ns;
    for value in 0..16 {
        bench.write(TDR, value);
    }
    bench.run_until(start_ns + 2_000_000);
    for (nth, sent) in bench.wires.uart.iter().enumerate() {
        assert_eq!(sent.1, start_ns + (86_718.75 * (nth + 2) as f64).ceil() as u64);
    }
    assert_eq!(bench.wires.uart.len(), 16);
}

#[test]
fn prescaler_word_length_parity_and_stop_bits_lengthen_the_frame() {
    let mut bench = bench(2);
    bench.write(BRR, BRR_1M);
    bench.write(PRESC, 2); // by 4
    bench.write(CR2, 2 << cr2::STOP_AT);
    bench.write(CR1, cr1::UE | cr1::TE | cr1::M0 | cr1::PCE); // start, 8 data, parity, 2 stop: 12 bits
    bench.write(TDR, 0xFF);
    bench.run_until(200_000);
    assert_eq!(bench.wires.uart, [(2, 96_000, 0xFF)]);
    assert_eq!(bench.peripheral.frame_ns(), 48_000);
}

#[test]
fn parity_shows_above_the_data() {
    let mut bench = bench(2);
    bench.write(BRR, BRR_1M);
    bench.write(CR1, cr1::UE | cr1::RE | cr1::M0 | cr1::PCE);
    bench.peripheral.receive(byte(100_000, 0b0011_0101)); // 51.5.12: 4 ones, even parity is 0
    bench.peripheral.receive(byte(200_000, 0b0011_0111));
    bench.run_until(150_000);
    assert_eq!(bench.read(RDR), 0b0_0011_0101);
    bench.run_until(250_000);
    assert_eq!(bench.read(RDR), 0b1_0011_0111);
}

#[test]
fn a_byte_is_received_exactly_when_its_stop_bit_ends() {
    let mut bench = started(1, cr1::RXNEIE);
    bench.peripheral.receive(byte(200_000, 0x42));
    bench.run_until(195_000);
    assert_ne!(bench.read(ISR) & isr::BUSY, 0);
    bench.run_until(199_999);
    assert!(!bench.irq(37));
    bench.run_until(200_000);
    assert!(bench.irq(37));
    assert_eq!(bench.read(ISR) & (isr::RXNE | isr::BUSY), isr::RXNE);
    assert_eq!(bench.read(RDR), 0x42);
    assert!(!bench.irq(37));
}

#[test]
fn idle_comes_one_frame_after_the_last_byte_and_once() {
    let mut bench = started(1, cr1::IDLEIE | cr1::FIFOEN);
    for nth in 0..3 {
        bench.peripheral.receive(byte(200_000 + 10_000 * nth, nth as u8));
    }
    bench.run_until(229_999);
    assert_eq!(bench.read(ISR) & isr::IDLE, 0);
    bench.run_until(230_000);
    assert!(bench.irq(37));
    bench.write(ICR, isr::IDLE);
    bench.run_until(1_000_000);
    assert!(!bench.irq(37), "not again before another byte");
    // A pause of just less than a frame does not count.
    bench.peripheral.receive(byte(1_100_000, 0));
    bench.peripheral.receive(byte(1_119_999, 0));
    bench.run_until(1_119_999);
    assert!(!bench.irq(37));
}

#[test]
fn idle_is_seen_when_the_receiver_is_switched_on_at_a_silent_line() {
    let mut bench = bench(1);
    bench.write(BRR, BRR_1M);
    bench.write(CR1, cr1::UE | cr1::RE);
    bench.run_until(9_999);
    assert_eq!(bench.read(ISR) & isr::IDLE, 0);
    bench.run_until(10_000);
    assert_eq!(bench.read(ISR) & isr::IDLE, isr::IDLE);
}

#[test]
fn the_receiver_timeout_counts_bits_after_the_stop_bit() {
    let mut bench = started(7, cr1::RTOIE);
    bench.write(RTOR, 22);
    bench.write(CR2, cr2::RTOEN);
    bench.peripheral.receive(byte(200_000, 1));
    bench.run_until(221_999);
    assert!(!bench.irq(82));
    bench.run_until(222_000);
    assert!(bench.irq(82));
    bench.write(ICR, isr::RTOF);
    assert!(!bench.irq(82));
    // A pause of exactly 22 bits does not count; one nanosecond more does.
    bench.peripheral.receive(byte(300_000, 1));
    bench.peripheral.receive(byte(332_000, 1));
    bench.peripheral.receive(byte(364_001, 1));
    bench.run_until(353_999);
    assert!(!bench.irq(82));
    bench.run_until(354_000);
    assert!(bench.irq(82));
}

#[test]
fn a_character_match_is_flagged() {
    let mut bench = started(1, cr1::CMIE | cr1::FIFOEN);
    bench.write(CR2, 0x0A << cr2::ADD_AT);
    assert_eq!(bench.take_misuse().len(), 1, "ADD is written while RE is 1");
    bench.write(CR1, cr1::UE | cr1::CMIE | cr1::FIFOEN);
    bench.write(CR2, 0x0A << cr2::ADD_AT);
    bench.write(CR1, cr1::UE | cr1::RE | cr1::CMIE | cr1::FIFOEN);
    bench.peripheral.receive(byte(200_000, 0x0B));
    bench.peripheral.receive(byte(300_000, 0x0A));
    bench.run_until(299_999);
    assert!(!bench.irq(37));
    bench.run_until(300_000);
    assert!(bench.irq(37));
    bench.write(ICR, isr::CMF);
    assert!(!bench.irq(37));
    assert_eq!(bench.take_misuse(), [""; 0]);
}

#[test]
fn overrun_keeps_the_first_byte() {
    let mut bench = started(1, cr1::RXNEIE);
    bench.peripheral.receive(byte(200_000, 1));
    bench.peripheral.receive(byte(210_000, 2));
    bench.run_until(210_000);
    assert_eq!(bench.read(ISR) & (isr::ORE | isr::RXNE), isr::ORE | isr::RXNE);
    assert_eq!(bench.read(RDR), 1);
    assert_eq!(bench.read(ISR) & (isr::ORE | isr::RXNE), isr::ORE);
    assert!(bench.irq(37), "ORE alone interrupts with RXNEIE");
    bench.write(ICR, isr::ORE);
    assert!(!bench.irq(37));
}

#[test]
fn with_fifo_17_bytes_fit_and_the_18th_overruns() {
    let mut bench = started(1, cr1::FIFOEN);
    for nth in 0..18 {
        bench.peripheral.receive(byte(200_000 + 10_000 * nth, nth as u8));
    }
    bench.run_until(200_000 + 15 * 10_000);
    assert_eq!(bench.read(ISR) & (isr::RXFF | isr::ORE), 0);
    bench.run_until(200_000 + 16 * 10_000);
    assert_eq!(bench.read(ISR) & (isr::RXFF | isr::ORE), isr::RXFF);
    bench.run_until(200_000 + 17 * 10_000);
    assert_eq!(bench.read(ISR) & (isr::RXFF | isr::ORE), isr::RXFF | isr::ORE);
    let received: Vec<u32> = (0..17).map(|_| bench.read(RDR)).collect();
    assert_eq!(received, (0..17).collect::<Vec<u32>>());
    assert_eq!(bench.read(ISR) & isr::RXNE, 0);
}

#[test]
fn errors_of_a_byte_in_the_fifo_show_when_it_is_next() {
    let mut bench = started(1, cr1::FIFOEN);
    bench.write(CR3, cr3::EIE);
    bench.peripheral.receive(byte(200_000, 1));
    bench.peripheral.receive(UartByte { framing_error: true, noise: true, ..byte(210_000, 2) });
    bench.run_until(210_000);
    assert_eq!(bench.read(ISR) & (isr::FE | isr::NE), 0);
    bench.read(RDR);
    assert_eq!(bench.read(ISR) & (isr::FE | isr::NE), isr::FE | isr::NE);
    assert!(bench.irq(37));
    bench.write(ICR, isr::FE | isr::NE);
    assert!(!bench.irq(37));
}

#[test]
fn thresholds_of_both_fifos() {
    for (code, count) in [(0, 2), (1, 4), (2, 8), (3, 12), (4, 14), (5, 16)] {
        let mut bench = started(1, cr1::FIFOEN);
        bench.write(CR3, code << cr3::RXFTCFG_AT | code << cr3::TXFTCFG_AT | cr3::RXFTIE);
        for nth in 0..count {
            bench.peripheral.receive(byte(200_000 + 10_000 * nth, 0));
        }
        let last_ns = 200_000 + 10_000 * (count - 1);
        bench.run_until(last_ns - 1);
        assert!(!bench.irq(37));
        bench.run_until(last_ns);
        assert!(bench.irq(37), "{count} bytes are held");
        // One byte moves to the shift register at once, 16 fill the FIFO; each frame makes room for one.
        for _ in 0..17 {
            bench.write(TDR, 0);
        }
        assert_eq!(bench.read(ISR) & (isr::TXE | isr::TXFT), 0);
        bench.run_until(last_ns + 10_000 * count - 1);
        assert_eq!(bench.read(ISR) & isr::TXFT, 0);
        bench.run_until(last_ns + 10_000 * count);
        assert_eq!(bench.read(ISR) & isr::TXFT, isr::TXFT, "{count} places are free");
    }
}

#[test]
fn dma_requests_are_levels() {
    let mut bench = started(4, cr1::FIFOEN);
    assert!(!bench.dma(64));
    bench.write(CR3, cr3::DMAT | cr3::DMAR);
    assert!(bench.dma(64) && !bench.dma(63));
    for nth in 0..17 {
        assert!(bench.dma(64), "byte {nth}");
        bench.with(|uart, context| uart.write(TDR, Size::Byte, nth, context)).unwrap();
    }
    assert!(!bench.dma(64), "16 wait and one is on the line");
    bench.peripheral.receive(byte(200_000, 7));
    bench.run_until(200_000);
    assert!(bench.dma(63));
    assert_eq!(bench.with(|uart, context| uart.read(RDR, Size::Byte, context)).unwrap(), 7);
    assert!(!bench.dma(63));
    bench.write(CR1, 0);
    assert!(!bench.dma(64), "UE takes the requests back");
}

#[test]
fn ddre_holds_requests_back_until_the_error_is_cleared() {
    let mut bench = started(1, 0);
    bench.write(CR1, 0);
    bench.write(CR3, cr3::DMAR | cr3::DDRE);
    bench.write(CR1, cr1::UE | cr1::RE);
    bench.peripheral.receive(UartByte { framing_error: true, ..byte(200_000, 7) });
    bench.run_until(200_000);
    assert!(!bench.dma(41));
    bench.write(ICR, isr::FE);
    assert!(bench.dma(41));
}

#[test]
fn bytes_are_lost_while_the_receiver_is_off() {
    let mut bench = started(1, 0);
    bench.peripheral.receive(byte(200_000, 1));
    bench.peripheral.receive(byte(300_000, 2)); // begins at 290 µs
    bench.peripheral.receive(byte(310_000, 3));
    bench.write(CR1, cr1::UE | cr1::TE);
    bench.run_until(295_000);
    bench.write(CR1, cr1::UE | cr1::TE | cr1::RE);
    bench.run_until(400_000);
    assert_eq!(bench.read(ISR) & (isr::RXNE | isr::ORE), isr::RXNE);
    assert_eq!(bench.read(RDR), 3);
}

#[test]
fn configuration_is_locked_while_the_port_is_on() {
    let mut bench = started(1, 0);
    bench.write(BRR, 100);
    assert_eq!(bench.read(BRR), BRR_1M);
    bench.write(CR1, bench.peripheral.cr1 | cr1::FIFOEN | cr1::TXEIE);
    assert_eq!(bench.read(CR1) & (cr1::FIFOEN | cr1::TXEIE), cr1::TXEIE);
    bench.write(PRESC, 1);
    bench.write(CR2, 2 << cr2::STOP_AT);
    bench.write(CR3, cr3::OVRDIS);
    assert_eq!(bench.take_misuse().len(), 5);
}

#[test]
fn misuse_of_the_transmitter_is_reported() {
    let mut bench = bench(1);
    bench.write(BRR, 15);
    bench.write(CR1, cr1::UE);
    bench.write(TDR, 1);
    bench.write(TDR, 2);
    let misuse = bench.take_misuse();
    assert_eq!(misuse.len(), 4, "{misuse:?}"); // BRR, TE twice, full
    let mut bench = started(1, 0);
    bench.write(TDR, 1);
    bench.write(CR1, cr1::UE);
    bench.write(CR1, 0);
    bench.write(TDR, 1);
    assert_eq!(bench.take_misuse().len(), 2); // TE within a frame, TDR without UE
    bench.run_until(1_000_000);
    assert_eq!(bench.wires.uart, []);
}

#[test]
fn what_is_not_modelled_is_refused() {
    let mut bench = bench(1);
    assert!(bench.try_write(CR3, 1 << 3).is_err()); // half duplex
    assert!(bench.try_write(CR2, 1 << 11).is_err()); // synchronous
    assert!(bench.try_write(CR1, cr1::M0).is_err()); // nine data bits
    assert!(bench.try_write(RQR, 2).is_err()); // break
    assert!(bench.try_write(0x10, 0).is_err()); // GTPR
    assert!(bench.with(|uart, context| uart.read(ISR, Size::Byte, context)).is_err());
}

#[test]
fn a_stopped_clock_stops_the_frame_and_a_new_one_goes_on() {
    let mut bench = started(1, 0);
    bench.write(TDR, 9);
    bench.run_until(105_000);
    bench.clocks.usart16_hz = 0;
    bench.with(|uart, context| uart.clocks_changed(context));
    assert_eq!(bench.peripheral.next_event_ns(), u64::MAX);
    assert_eq!(bench.peripheral.baud(), 0.0);
    bench.run_until(500_000);
    bench.clocks.usart16_hz = 32_000_000;
    bench.with(|uart, context| uart.clocks_changed(context));
    bench.run_until(600_000);
    assert_eq!(bench.wires.uart, [(1, 510_000, 9)], "the other 5 bits, of 2 µs each");
}

#[test]
fn reset_ends_everything_but_not_what_comes() {
    let mut bench = started(1, cr1::TCIE);
    bench.write(TDR, 1);
    bench.peripheral.receive(byte(300_000, 5));
    bench.with(|uart, context| uart.reset(context));
    assert!(!bench.irq(37));
    assert_eq!(bench.read(ISR), 0xC0);
    bench.write(BRR, BRR_1M);
    bench.write(CR1, cr1::UE | cr1::RE);
    bench.run_until(300_000);
    assert_eq!(bench.read(RDR), 5);
    assert_eq!(bench.wires.uart, []);
}

proptest! {
    /// More frequent advances change nothing.
    #[test]
    fn time_may_be_cut_anywhere(
        cuts in prop::collection::vec(0..600_000_u64, 0..20), gaps in prop::collection::vec(0..30_000_u64, 1..15), fifo: bool,
    ) {
        let run = |mut cuts: Vec<u64>| {
            let mut bench = started(1, if fifo { cr1::FIFOEN } else { 0 });
            let mut at_ns = 150_000;
            for (nth, gap_ns) in gaps.iter().enumerate() {
                at_ns += 10_000 + gap_ns;
                bench.peripheral.receive(byte(at_ns, nth as u8));
            }
            for nth in 0..if fifo { 10 } else { 1 } {
                bench.write(TDR, nth);
            }
            cuts.sort_unstable();
            for cut_ns in cuts {
                bench.run_until(bench.now_ns.max(cut_ns));
            }
            bench.run_until(1_000_000);
            let flags = bench.read(ISR);
            let received: Vec<u32> = gaps.iter().map(|_| bench.read(RDR)).collect();
            (bench.wires.uart, flags, received)
        };
        prop_assert_eq!(run(cuts), run(Vec::new()));
    }
}
