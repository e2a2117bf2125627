//! Tests of the ADC. The kernel clock of the bench is 16 MHz: 8 MHz behind the fixed divider of revision V, half clocks
//! of 62.5 ns.

use super::Adc12;
use crate::testing::Bench;
use crate::{Peripheral, Pin, Signal};

const ISR: u32 = 0x00;
const IER: u32 = 0x04;
const CR: u32 = 0x08;
const CFGR: u32 = 0x0c;
const CFGR2: u32 = 0x10;
const SMPR1: u32 = 0x14;
const SMPR2: u32 = 0x18;
const PCSEL: u32 = 0x1c;
const SQR1: u32 = 0x30;
const SQR2: u32 = 0x34;
const DR: u32 = 0x40;
const CCR: u32 = 0x308;

const ADEN: u32 = 1;
const ADSTART: u32 = 1 << 2;
const ADSTP: u32 = 1 << 4;
/// BOOST field for up to 12.5 MHz.
const BOOST: u32 = 1 << 8;
const ADVREGEN: u32 = 1 << 28;
const ON: u32 = ADVREGEN | BOOST;

const US: u64 = 1_000;

/// Makes an ADC1 that is ready, without calibration.
fn ready() -> (Bench, Adc12) {
    let (mut bench, mut adc) = (Bench::default(), Adc12::new());
    bench.write(&mut adc, CR, ON);
    bench.run(&mut adc, 10 * US);
    assert_eq!(bench.read(&mut adc, ISR), 1 << 12, "LDORDY");
    bench.write(&mut adc, CR, ON | ADEN);
    bench.run(&mut adc, 20 * US);
    assert_eq!(bench.read(&mut adc, ISR), 1 << 12 | 1);
    bench.write(&mut adc, ISR, 1);
    (bench, adc)
}

fn requests(bench: &mut Bench) -> Vec<(u8, bool)> {
    let request = |signal| if let Signal::Dma { request, level } = signal { Some((request, level)) } else { None };
    bench.take_signals().into_iter().filter_map(request).collect()
}

#[test]
fn starting_up_takes_its_time() {
    let (mut bench, mut adc) = (Bench::default(), Adc12::new());
    assert_eq!(bench.read(&mut adc, CR), 1 << 29, "deep power-down after reset");
    bench.write(&mut adc, CR, ON);
    bench.write(&mut adc, CR, ON | 1 << 31);
    assert_eq!(bench.take_misuse().len(), 1, "calibrating before the regulator is ready");
    let mut adc = Adc12::new();
    bench.write(&mut adc, CR, ON);
    bench.run(&mut adc, 10 * US);
    // Calibration of offset and linearity takes 165010 clocks of 125 ns.
    bench.write(&mut adc, CR, ON | 1 << 16 | 1 << 31);
    bench.run(&mut adc, 10 * US + 165_010 * 125 - 1);
    assert_eq!(bench.read(&mut adc, CR) >> 31, 1);
    bench.run(&mut adc, 10 * US + 165_010 * 125);
    assert_eq!(bench.read(&mut adc, CR) >> 31, 0);
    let now_ns = bench.now_ns;
    bench.write(&mut adc, CR, ON | ADEN);
    bench.run(&mut adc, now_ns + 10 * 125 - 1);
    assert_eq!(bench.read(&mut adc, ISR) & 1, 0);
    bench.run(&mut adc, now_ns + 10 * 125);
    assert_eq!(bench.read(&mut adc, ISR) & 1, 1);
    // ADDIS takes effect at once.
    bench.write(&mut adc, CR, ON | 1 << 1);
    assert_eq!(bench.read(&mut adc, CR), ON);
    bench.assert_no_misuse();
}

#[test]
fn one_conversion() {
    let (mut bench, mut adc) = ready();
    bench.outside.volts.insert(Pin::new('C', 4), 1.1);
    bench.write(&mut adc, PCSEL, 1 << 4);
    bench.write(&mut adc, SMPR1, 2 << 12);
    bench.write(&mut adc, SQR1, 4 << 6);
    bench.write(&mut adc, IER, 1 << 2);
    bench.write(&mut adc, CR, ON | ADEN | ADSTART);
    // The conversion takes 8.5 clocks for sampling and 8.5 for 16 bits: 17 of 125 ns.
    assert_eq!(adc.next_event_ns(), 20 * US + 2_125);
    bench.run(&mut adc, 20 * US + 2_124);
    assert_eq!(bench.read(&mut adc, ISR) & 0x1e, 0);
    bench.run(&mut adc, 20 * US + 2_125);
    assert_eq!(bench.read(&mut adc, ISR) & 0x1e, 0b1110, "EOSMP, EOC, EOS");
    assert_eq!(bench.take_signals(), [Signal::Irq { number: 18, level: true }]);
    assert_eq!(bench.read(&mut adc, CR) & ADSTART, 0);
    assert_eq!(bench.read(&mut adc, DR), 21_845, "a third of 65536");
    assert_eq!(bench.read(&mut adc, ISR) & 0x1e, 0b1010, "reading clears EOC");
    assert_eq!(bench.take_signals(), [Signal::Irq { number: 18, level: false }]);
    assert_eq!(adc.next_event_ns(), u64::MAX);
    bench.assert_no_misuse();
}

#[test]
fn codes_follow_the_resolution_and_stay_in_range() {
    // Cases: RES of revision V, bits, and half clocks of the approximation.
    for (res, bits, halves) in [(0, 16, 17), (5, 14, 15), (1, 14, 15), (6, 12, 13), (2, 12, 13), (3, 10, 11), (7, 8, 9)]
    {
        for (volts, share) in [(-0.2, 0.0), (0.0, 0.0), (1.65, 0.5), (3.3, 1.0), (5.0, 1.0)] {
            let (mut bench, mut adc) = ready();
            bench.outside.volts.insert(Pin::new('A', 5), volts);
            bench.write(&mut adc, PCSEL, 1 << 19);
            bench.write(&mut adc, SMPR2, 1 << 27);
            bench.write(&mut adc, CFGR, res << 2);
            bench.write(&mut adc, SQR1, 19 << 6);
            bench.write(&mut adc, CR, ON | ADEN | ADSTART);
            assert_eq!(adc.next_event_ns(), 20 * US + (5 + halves) * 125 / 2);
            bench.run(&mut adc, 40 * US);
            let full = f64::from(1 << bits);
            assert_eq!(bench.read(&mut adc, DR), (share * full).min(full - 1.0) as u32, "{bits} bits, {volts} V");
        }
    }
}

#[test]
fn oversampling_sums_and_shifts() {
    let (mut bench, mut adc) = ready();
    bench.outside.volts.insert(Pin::new('C', 5), 1.65);
    bench.write(&mut adc, PCSEL, 1 << 8);
    bench.write(&mut adc, SQR1, 8 << 6);
    // Oversampling: 16 parts, divided by 4.
    bench.write(&mut adc, CFGR2, 1 | 2 << 5 | 15 << 16);
    bench.write(&mut adc, CR, ON | ADEN | ADSTART);
    assert_eq!(adc.next_event_ns(), 20 * US + 16 * 10 * 125);
    bench.run(&mut adc, 60 * US);
    assert_eq!(bench.read(&mut adc, DR), 32_768 * 4);
    // Without oversampling the left shift still applies.
    bench.write(&mut adc, CFGR2, 3 << 28);
    bench.write(&mut adc, CR, ON | ADEN | ADSTART);
    bench.run(&mut adc, 70 * US);
    assert_eq!(bench.read(&mut adc, DR), 32_768 << 3);
    bench.assert_no_misuse();
}

/// The sequence of a driver with DMA: the six analog inputs of the board, continuously, until the transfer ends.
#[test]
fn a_sequence_goes_to_memory() {
    let (mut bench, mut adc) = ready();
    let inputs = [('C', 4, 4), ('C', 5, 8), ('B', 0, 9), ('B', 1, 5), ('C', 3, 13), ('C', 2, 12)];
    for (n, (port, number, channel)) in inputs.into_iter().enumerate() {
        bench.outside.volts.insert(Pin::new(port, number), 0.5 * n as f64);
        bench.modify(&mut adc, PCSEL, 0, 1 << channel);
        let (register, position) = if n < 4 { (SQR1, n + 1) } else { (SQR2, n - 4) };
        bench.modify(&mut adc, register, 0, channel << (6 * position));
    }
    bench.modify(&mut adc, SQR1, 0, 5);
    bench.write(&mut adc, CFGR, 1 << 13 | 1);
    bench.write(&mut adc, CR, ON | ADEN | ADSTART);
    let mut codes = Vec::new();
    for n in 1..=7 {
        bench.run(&mut adc, 20 * US + n * 1_250);
        assert_eq!(requests(&mut bench), [(9, true)]);
        codes.push(bench.read(&mut adc, DR));
        assert_eq!(requests(&mut bench), [(9, false)]);
    }
    let expected = [0, 1, 2, 3, 4, 5, 0].map(|n| (0.5 * f64::from(n) / 3.3 * 65_536.0) as u32);
    assert_eq!(codes, expected);
    assert_eq!(bench.read(&mut adc, ISR) & 1 << 4, 0);
    adc.dma_ended(9, &mut bench.context());
    bench.run(&mut adc, 100 * US);
    assert_eq!((requests(&mut bench), adc.next_event_ns()), (vec![], u64::MAX), "one-shot mode ends the conversions");
    assert_eq!(bench.read(&mut adc, CR) & ADSTART, ADSTART);
    bench.write(&mut adc, CR, ON | ADEN | ADSTP);
    assert_eq!(bench.read(&mut adc, CR) & (ADSTART | ADSTP), 0);
    bench.assert_no_misuse();
}

#[test]
fn unread_results_overrun() {
    let (mut bench, mut adc) = ready();
    bench.write(&mut adc, PCSEL, 1 << 4);
    bench.write(&mut adc, SQR1, 4 << 6);
    bench.write(&mut adc, CFGR, 1 << 13 | 3);
    bench.write(&mut adc, CR, ON | ADEN | ADSTART);
    // The eight stages fill, and the ninth result is lost.
    let mut now_ns = bench.now_ns;
    for n in 1..=9 {
        bench.outside.volts.insert(Pin::new('C', 4), 0.1 * f64::from(n));
        now_ns += 1_250;
        bench.run(&mut adc, now_ns);
        assert_eq!(bench.read(&mut adc, ISR) >> 4 & 1, u32::from(n == 9));
    }
    assert_eq!(requests(&mut bench), [(9, true), (9, false)], "no requests after an overrun");
    // A day of conversions without reads costs no work, and keeps their phase.
    assert_eq!(adc.next_event_ns(), u64::MAX);
    now_ns += 86_400_000_000 * US + 1_000;
    bench.run(&mut adc, now_ns);
    bench.write(&mut adc, ISR, 1 << 4);
    assert_eq!(adc.next_event_ns(), now_ns + 250);
    bench.run(&mut adc, now_ns + 250);
    assert_eq!(bench.read(&mut adc, ISR) >> 4 & 1, 1);
    assert_eq!(bench.read(&mut adc, DR), (0.1 / 3.3 * 65_536.0) as u32, "the oldest");
    // With OVRMOD the newest result overwrites instead.
    bench.write(&mut adc, CR, ON | ADEN | ADSTP);
    bench.write(&mut adc, ISR, 1 << 4);
    bench.write(&mut adc, CFGR, 1 << 13 | 1 << 12);
    bench.write(&mut adc, CR, ON | ADEN | ADSTART);
    let now_ns = bench.now_ns;
    bench.run(&mut adc, now_ns + 1_250);
    bench.outside.volts.insert(Pin::new('C', 4), 3.0);
    bench.run(&mut adc, now_ns + 2_500);
    assert_eq!(bench.read(&mut adc, ISR) >> 4 & 1, 1);
    assert_eq!(bench.read(&mut adc, DR), (3.0 / 3.3 * 65_536.0) as u32, "the newest");
}

#[test]
fn a_timer_starts_conversions() {
    let (mut bench, mut adc) = ready();
    bench.write(&mut adc, PCSEL, 1 << 4);
    bench.write(&mut adc, SQR1, 4 << 6);
    // EXTSEL 13 selects TIM6's trigger output; rising edges.
    bench.write(&mut adc, CFGR, 13 << 5 | 1 << 10);
    bench.write(&mut adc, CR, ON | ADEN | ADSTART);
    assert_eq!(adc.next_event_ns(), u64::MAX);
    adc.trigger(3, &mut bench.context());
    assert_eq!(adc.next_event_ns(), u64::MAX);
    adc.trigger(6, &mut bench.context());
    assert_eq!(adc.next_event_ns(), 20 * US + 1_250);
    bench.run(&mut adc, 30 * US);
    assert_eq!(bench.read(&mut adc, CR) & ADSTART, ADSTART, "armed for the next");
    assert_eq!(bench.read(&mut adc, ISR) & 8, 8);
    // With DMA in one-shot mode it continues after the transfer, but makes no request.
    bench.write(&mut adc, CR, ON | ADEN | ADSTP);
    bench.write(&mut adc, CFGR, 13 << 5 | 1 << 10 | 1);
    bench.write(&mut adc, CR, ON | ADEN | ADSTART);
    adc.trigger(6, &mut bench.context());
    bench.run(&mut adc, 40 * US);
    bench.read(&mut adc, DR);
    assert_eq!(requests(&mut bench), [(9, true), (9, false)]);
    adc.dma_ended(10, &mut bench.context());
    adc.dma_ended(9, &mut bench.context());
    adc.trigger(6, &mut bench.context());
    bench.run(&mut adc, 50 * US);
    assert_eq!(requests(&mut bench), []);
}

#[test]
fn the_clock_is_divided_and_may_change() {
    let (mut bench, mut adc) = (Bench::default(), Adc12::new());
    // The clock is AHB/4 = 60 MHz, halved to 30 MHz: 33.3 ns.
    bench.write(&mut adc, CCR, 3 << 16);
    bench.write(&mut adc, 0x100 + CR, ADVREGEN | 3 << 8);
    bench.run(&mut adc, 10 * US);
    bench.write(&mut adc, 0x100 + CR, ADVREGEN | 3 << 8 | ADEN);
    bench.run(&mut adc, 20 * US);
    bench.write(&mut adc, 0x100 + PCSEL, 1 << 4);
    bench.write(&mut adc, 0x100 + SQR1, 4 << 6);
    bench.write(&mut adc, 0x100 + CR, ADVREGEN | 3 << 8 | ADEN | ADSTART);
    assert_eq!(adc.next_event_ns(), 20 * US + 334);
    bench.assert_no_misuse();
    bench.write(&mut adc, CCR, 0);
    assert_eq!(bench.take_misuse(), ["the clock changed while an ADC is enabled (RM0399, ADCx_CCR)"]);
    // All of its 10 clocks remain, now of 125 ns; after 5 of them they take 62.5 ns each.
    assert_eq!(adc.next_event_ns(), 20 * US + 1_250);
    bench.run(&mut adc, 20 * US + 625);
    bench.clocks.adc_hz = 32_000_000;
    adc.clocks_changed(&mut bench.context());
    assert_eq!(adc.next_event_ns(), 20 * US + 625 + 313);
    bench.run(&mut adc, 30 * US);
    assert_eq!(bench.read(&mut adc, 0x300) >> 16 & 0x1f, 0b1111, "ADC2 in the common status");
}

#[test]
fn misuse_is_told() {
    let (mut bench, mut adc) = ready();
    bench.write(&mut adc, SQR1, 4 << 6);
    bench.write(&mut adc, CR, ON | ADEN | ADSTART);
    bench.write(&mut adc, SQR1, 5 << 6);
    bench.run(&mut adc, 30 * US);
    assert_eq!(
        bench.take_misuse(),
        [
            "register 0x30 written while ADSTART is set (RM0399, ADC registers)",
            "channel 5 converted without its bit in PCSEL (RM0399, ADC, channel preselection)"
        ]
    );
    // A clock of 8 MHz exceeds the limit of the lowest BOOST.
    bench.write(&mut adc, PCSEL, 1 << 5);
    bench.write(&mut adc, CR, ADVREGEN | ADEN | ADSTART);
    assert_eq!(bench.take_misuse(), ["a clock of 8000000 Hz with BOOST for 6250000 Hz (RM0399, ADC, clocks)"]);
    let mut adc = Adc12::new();
    bench.write(&mut adc, CR, ADSTART | 1 << 29);
    assert_eq!(bench.take_misuse(), ["ADSTART set while the ADC is not ready (RM0399, ADC, on-off control)"]);
}

#[test]
fn what_is_not_modelled_is_refused() {
    let refused: &[(u32, u32)] = &[
        (CR, ON | ADEN | 1 << 3),
        (CR, ON | ADEN | 1 << 22),
        (CFGR, 1 << 14),
        (CFGR, 1 << 16),
        (CFGR, 1 << 23),
        (CFGR, 2),
        (CFGR2, 2),
        (0x60, 1 << 31),
        (0xc0, 1),
        (CCR, 6),
        (CCR, 1 << 22),
        (0x4c, 0),
    ];
    for &(offset, value) in refused {
        let (mut bench, mut adc) = ready();
        assert!(bench.try_write(&mut adc, offset, crate::Size::Word, value).is_err(), "{offset:#x} {value:#x}");
    }
    let (mut bench, mut adc) = ready();
    bench.write(&mut adc, SQR1, 1 << 6);
    let start = bench.try_write(&mut adc, CR, crate::Size::Word, ON | ADEN | ADSTART);
    assert!(start.is_err(), "INP1 is the pad PA1_C");
}

#[test]
fn reset_brings_everything_back() {
    let (mut bench, mut adc) = ready();
    bench.write(&mut adc, PCSEL, 1 << 4);
    bench.write(&mut adc, SQR1, 4 << 6);
    bench.write(&mut adc, CFGR, 3);
    bench.write(&mut adc, IER, 4);
    bench.write(&mut adc, CR, ON | ADEN | ADSTART);
    bench.run(&mut adc, 30 * US);
    bench.take_signals();
    adc.reset(&mut bench.context());
    let off = [Signal::Dma { request: 9, level: false }, Signal::Irq { number: 18, level: false }];
    assert_eq!(bench.take_signals(), off);
    assert_eq!((bench.read(&mut adc, CR), bench.read(&mut adc, CFGR)), (1 << 29, 1 << 31));
}
