//! Tests of the timers. Their clock is 240 MHz: 240 clocks are 1 µs.

use proptest::prelude::*;

use super::{OUTPUT_BATCH_NS, Tim};
use crate::peripheral::Size;
use crate::testing::Bench;
use crate::{Peripheral, Signal};

const CR1: u32 = 0x00;
const CR2: u32 = 0x04;
const SMCR: u32 = 0x08;
const DIER: u32 = 0x0c;
const SR: u32 = 0x10;
const EGR: u32 = 0x14;
const CCMR1: u32 = 0x18;
const CCMR2: u32 = 0x1c;
const CCER: u32 = 0x20;
const CNT: u32 = 0x24;
const PSC: u32 = 0x28;
const ARR: u32 = 0x2c;
const RCR: u32 = 0x30;
const CCR1: u32 = 0x34;
const CCR2: u32 = 0x38;
const CCR4: u32 = 0x40;
const BDTR: u32 = 0x44;
const DCR: u32 = 0x48;
const DMAR: u32 = 0x4c;

const US: u64 = 1_000;
const MS: u64 = 1_000_000;

/// Makes a timer that counts microseconds from 0 to `arr`; the update that loads the prescaler leaves no flag.
fn microseconds(number: u8, arr: u32) -> (Bench, Tim) {
    let (mut bench, mut tim) = (Bench::default(), Tim::new(number));
    bench.write(&mut tim, PSC, 239);
    bench.write(&mut tim, ARR, arr);
    bench.write(&mut tim, CR1, 1 << 2);
    bench.write(&mut tim, EGR, 1);
    bench.write(&mut tim, CR1, 0);
    bench.take_signals();
    (bench, tim)
}

fn irqs(bench: &mut Bench) -> Vec<(u16, bool)> {
    let irq = |signal| if let Signal::Irq { number, level } = signal { Some((number, level)) } else { None };
    bench.take_signals().into_iter().filter_map(irq).collect()
}

fn edges(bench: &mut Bench) -> Vec<(u64, bool)> {
    let edge = |signal| if let Signal::TimerOutput { at_ns, high, .. } = signal { Some((at_ns, high)) } else { None };
    bench.take_signals().into_iter().filter_map(edge).collect()
}

fn input(bench: &mut Bench, tim: &mut Tim, channel: u8, high: bool, at_ns: u64) {
    bench.now_ns = at_ns;
    tim.edge(channel, high, at_ns, &mut bench.context());
}

#[test]
fn a_period_ends_with_an_update() {
    let (mut bench, mut tim) = microseconds(3, 999);
    assert_eq!(bench.read(&mut tim, SR), 0, "URS: UG leaves no flag");
    bench.write(&mut tim, DIER, 1);
    bench.write(&mut tim, CR1, 1);
    assert_eq!(tim.next_event_ns(), MS);
    bench.run(&mut tim, MS - 1);
    assert_eq!(bench.read(&mut tim, CNT), 999);
    assert!(bench.take_signals().is_empty());
    bench.run(&mut tim, MS);
    assert_eq!((bench.read(&mut tim, CNT), bench.read(&mut tim, SR) & 1), (0, 1));
    assert_eq!(irqs(&mut bench), [(29, true)]);
    assert_eq!(tim.next_event_ns(), u64::MAX, "the line is up, nothing more can be seen");
    // Writing 0 clears a flag, writing 1 does not.
    bench.write(&mut tim, SR, !2);
    assert_eq!(bench.read(&mut tim, SR) & 1, 1);
    bench.write(&mut tim, SR, !1);
    assert_eq!(irqs(&mut bench), [(29, false)]);
    assert_eq!(tim.next_event_ns(), 2 * MS);
}

/// Set-up of embassy-time's driver: a half-way mark on channel 1, the alarm on channel 2, 16-bit accesses to PSC.
#[test]
fn compare_interrupts_of_a_time_base() {
    let (mut bench, mut tim) = (Bench::default(), Tim::new(5));
    bench.try_write(&mut tim, PSC, Size::Half, 239).unwrap();
    bench.write(&mut tim, ARR, 0xffff);
    bench.write(&mut tim, CR1, 4);
    bench.write(&mut tim, EGR, 1);
    bench.write(&mut tim, CR1, 0);
    bench.write(&mut tim, CCR1, 0x8000);
    bench.write(&mut tim, DIER, 0b011);
    bench.write(&mut tim, CR1, 1);
    assert_eq!(tim.next_event_ns(), 0x8000 * US);
    bench.write(&mut tim, CCR2, 500);
    bench.write(&mut tim, DIER, 0b111);
    bench.run(&mut tim, 500 * US);
    assert_eq!(bench.read(&mut tim, SR) & 0x1f, 0b100);
    assert_eq!(irqs(&mut bench), [(50, true)]);
    bench.write(&mut tim, SR, !0b100);
    bench.write(&mut tim, DIER, 0b100);
    assert_eq!(tim.next_event_ns(), 0x1_0000 * US + 500 * US, "not before it comes round");
    bench.write(&mut tim, DIER, 0b011);
    bench.run(&mut tim, 0x1_0000 * US);
    // Unused channels match as well: 3 and 4 compare with 0, channel 2 with 500.
    assert_eq!(bench.read(&mut tim, SR), 0b1_1011);
    assert_eq!(irqs(&mut bench), [(50, false), (50, true)]);
}

#[test]
fn the_prescaler_and_preloaded_values_wait_for_the_update() {
    let (mut bench, mut tim) = microseconds(4, 99);
    bench.write(&mut tim, CR1, 0x81);
    bench.write(&mut tim, PSC, 479);
    bench.write(&mut tim, ARR, 49);
    bench.run(&mut tim, 60 * US);
    assert_eq!(bench.read(&mut tim, CNT), 60);
    assert_eq!(bench.read(&mut tim, ARR), 49, "reads give what was written");
    bench.run(&mut tim, 110 * US);
    assert_eq!(bench.read(&mut tim, CNT), 5, "2 us each from the update at 100 us on");
    bench.run(&mut tim, 200 * US);
    assert_eq!(bench.read(&mut tim, CNT), 0, "50 of them");
    // Without ARPE a new end takes effect at once; a count beyond it continues to 0xffff, which is no update.
    bench.write(&mut tim, CR1, 1);
    bench.run(&mut tim, 260 * US);
    bench.write(&mut tim, SR, 0);
    bench.write(&mut tim, ARR, 10);
    bench.run(&mut tim, 200 * US + 0xffff * 2 * US);
    assert_eq!((bench.read(&mut tim, CNT), bench.read(&mut tim, SR) & 1), (0xffff, 0));
    bench.run(&mut tim, 200 * US + 0x1_0001 * 2 * US);
    assert_eq!((bench.read(&mut tim, CNT), bench.read(&mut tim, SR) & 1), (1, 0));
}

#[test]
fn long_idle_times_cost_nothing_and_lose_nothing() {
    let (mut bench, mut tim) = (Bench::default(), Tim::new(14));
    // A period of 7 clocks of 1/240 µs is no whole number of nanoseconds. An hour has 123 thousand million periods.
    bench.write(&mut tim, ARR, 6);
    bench.write(&mut tim, CCR1, 3);
    bench.write(&mut tim, CR1, 1);
    bench.now_ns = 3_600_000 * MS;
    let clocks = 3_600 * 240_000_000_u64;
    assert_eq!(u64::from(bench.read(&mut tim, CNT)), clocks % 7);
    assert_eq!(bench.read(&mut tim, SR), 0b11);
    // The run starts in mid-period and ends just after an overflow: the compare value is reached in skipped periods.
    let (mut bench, mut tim) = (Bench::default(), Tim::new(14));
    bench.write(&mut tim, ARR, 239);
    bench.write(&mut tim, CCR1, 100);
    bench.write(&mut tim, CNT, 200);
    bench.write(&mut tim, CR1, 1);
    bench.now_ns = 100 * US + 200;
    assert_eq!((bench.read(&mut tim, CNT), bench.read(&mut tim, SR)), (8, 0b11));
    // With a repetition counter the phase of the updates is kept.
    let (mut bench, mut tim) = (Bench::default(), Tim::new(16));
    bench.write(&mut tim, ARR, 239);
    bench.write(&mut tim, RCR, 2);
    bench.write(&mut tim, EGR, 1);
    bench.write(&mut tim, CR1, 1);
    bench.now_ns = 1_000_000 * US + US / 2;
    bench.write(&mut tim, SR, 0);
    bench.write(&mut tim, DIER, 1);
    // After 1 000 000 overflows the next update is at 1 000 002, the third from 999 999 on.
    bench.run(&mut tim, 1_000_002 * US - 1);
    assert_eq!(bench.read(&mut tim, SR) & 1, 0);
    bench.run(&mut tim, 1_000_002 * US);
    assert_eq!(bench.read(&mut tim, SR) & 1, 1);
}

#[test]
fn a_pwm_has_exact_edges() {
    let (mut bench, mut tim) = microseconds(12, 99);
    bench.write(&mut tim, CCMR1, 0x68);
    bench.write(&mut tim, CCR1, 10);
    bench.write(&mut tim, CCER, 1);
    bench.write(&mut tim, EGR, 1);
    assert!(tim.drives(1));
    assert_eq!(edges(&mut bench), [(0, true)], "below the compare value");
    bench.write(&mut tim, CR1, 1);
    bench.run(&mut tim, 120 * US);
    assert_eq!(edges(&mut bench), [(10 * US, false), (100 * US, true), (110 * US, false)]);
    // A preloaded duty takes effect with the next period; 0 and 100 % have no edges.
    bench.write(&mut tim, CCR1, 0);
    bench.run(&mut tim, 250 * US);
    assert_eq!(edges(&mut bench), []);
    bench.write(&mut tim, CCR1, 100);
    bench.run(&mut tim, 550 * US);
    assert_eq!(edges(&mut bench), [(300 * US, true)]);
    assert_eq!(tim.next_event_ns(), u64::MAX);
    bench.write(&mut tim, CCER, 3);
    assert_eq!(edges(&mut bench), [(550 * US, false)], "the other polarity");
    bench.write(&mut tim, CCER, 0);
    assert!(!tim.drives(1));
}

#[test]
fn fast_edges_are_told_in_batches_and_slow_ones_at_once() {
    let (mut bench, mut tim) = (Bench::default(), Tim::new(13));
    // The output has 1 MHz with a duty of one half.
    bench.write(&mut tim, ARR, 239);
    bench.write(&mut tim, CCMR1, 0x60);
    bench.write(&mut tim, CCR1, 120);
    bench.write(&mut tim, CCER, 1);
    bench.write(&mut tim, CR1, 1);
    bench.take_signals();
    let mut events = 0;
    while tim.next_event_ns() <= MS {
        let event_ns = tim.next_event_ns();
        assert!(event_ns - bench.now_ns <= OUTPUT_BATCH_NS + 500);
        bench.now_ns = event_ns;
        tim.advance(&mut bench.context());
        events += 1;
    }
    assert!((45..=55).contains(&events), "{events} events a millisecond");
    bench.run(&mut tim, MS);
    let edges = edges(&mut bench);
    assert_eq!(edges.len(), 2000);
    assert!((1..=2000).zip(&edges).all(|(n, &edge)| edge == (n * 500, n % 2 == 0)));
}

#[test]
fn one_pulse_ends_the_count() {
    let (mut bench, mut tim) = microseconds(14, 29);
    // PWM mode 2: low for 10 µs, then high to the end.
    bench.write(&mut tim, CCMR1, 0x70);
    bench.write(&mut tim, CCR1, 10);
    bench.write(&mut tim, CCER, 1);
    bench.write(&mut tim, CR1, 1 << 3 | 1);
    bench.run(&mut tim, 500 * US);
    assert_eq!(edges(&mut bench), [(10 * US, true), (30 * US, false)]);
    assert_eq!((bench.read(&mut tim, CR1), bench.read(&mut tim, CNT)), (1 << 3, 0));
    bench.write(&mut tim, CR1, 1 << 3 | 1);
    bench.run(&mut tim, 600 * US);
    assert_eq!(edges(&mut bench), [(510 * US, true), (530 * US, false)]);
}

#[test]
fn outputs_toggle_set_and_clear_on_a_match() {
    let (mut bench, mut tim) = microseconds(2, 99);
    // Channel 1 toggles at 30; channel 2 is set at 40, once.
    bench.write(&mut tim, CCMR1, 0x1030);
    bench.write(&mut tim, CCR1, 30);
    bench.write(&mut tim, CCR2, 40);
    bench.write(&mut tim, CCER, 0x11);
    bench.write(&mut tim, CR1, 1);
    bench.run(&mut tim, 250 * US);
    assert_eq!(edges(&mut bench), [(30 * US, true), (40 * US, true), (130 * US, false), (230 * US, true)]);
    // Forced modes ignore the count.
    bench.write(&mut tim, CCMR1, 0x4050);
    assert_eq!(edges(&mut bench), [(250 * US, false)]);
    assert!(tim.output(1) && !tim.output(2));
}

#[test]
fn advanced_timers_need_their_main_output_enable() {
    let (mut bench, mut tim) = microseconds(1, 99);
    bench.write(&mut tim, CCMR1, 0x60);
    bench.write(&mut tim, CCR1, 50);
    bench.write(&mut tim, CCER, 1);
    assert!(!tim.drives(1) && bench.signals.is_empty());
    bench.write(&mut tim, BDTR, 1 << 15);
    assert_eq!(edges(&mut bench), [(0, true)]);
    // A break by software turns the output off; with AOE the next update turns it on again.
    bench.write(&mut tim, BDTR, 1 << 15 | 1 << 14);
    bench.write(&mut tim, EGR, 1 << 7);
    assert_eq!(edges(&mut bench), [(0, false)]);
    assert_eq!(bench.read(&mut tim, SR) & 1 << 7, 1 << 7);
    bench.write(&mut tim, CR1, 1);
    bench.run(&mut tim, 120 * US);
    assert_eq!(edges(&mut bench), [(100 * US, true)]);
    bench.write(&mut tim, BDTR, 1 << 12);
    assert_eq!(bench.take_misuse().len(), 1, "break inputs are ignored, which is told");
}

#[test]
fn an_echo_is_captured_at_both_edges() {
    let (mut bench, mut tim) = microseconds(2, u32::MAX);
    bench.write(&mut tim, CCMR2, 0x0100);
    bench.write(&mut tim, CCER, 0xb000);
    bench.write(&mut tim, DIER, 1 << 4);
    bench.write(&mut tim, CR1, 1);
    assert!(tim.listens(4) && tim.watches(4) && !tim.listens(3));
    input(&mut bench, &mut tim, 4, true, 1_000 * US + 300);
    assert_eq!(irqs(&mut bench), [(28, true)]);
    // Time passes between the edge and the interrupt handler's read.
    bench.now_ns = 1_005 * US;
    assert_eq!(bench.read(&mut tim, CCR4), 1_000);
    assert_eq!(bench.read(&mut tim, SR) & 1 << 4, 0, "reading clears the flag");
    assert_eq!(irqs(&mut bench), [(28, false)]);
    input(&mut bench, &mut tim, 4, false, 6_800 * US + 999);
    bench.now_ns += 40_000 * US;
    input(&mut bench, &mut tim, 4, true, 50_000 * US);
    assert_eq!(bench.read(&mut tim, SR) & (1 << 12 | 1 << 4), 1 << 12 | 1 << 4, "the second was not fetched");
    assert_eq!(bench.read(&mut tim, CCR4), 50_000);
    bench.write(&mut tim, CCR4, 1);
    assert_eq!(bench.read(&mut tim, CCR4), 50_000, "read-only while capturing");
    bench.assert_no_misuse();
}

#[test]
fn captures_can_be_divided_and_come_from_the_neighbour() {
    let (mut bench, mut tim) = microseconds(3, 0xffff);
    // Channel 1 captures every second rising edge of its own input, channel 2 the falling edges of input 1.
    bench.write(&mut tim, CCMR1, 0x0205);
    bench.write(&mut tim, CCER, 0x31);
    bench.write(&mut tim, CR1, 1);
    for (n, high) in [(10, true), (15, false), (20, true), (27, false)] {
        input(&mut bench, &mut tim, 1, high, n * US);
        let _ = bench.read(&mut tim, CCR2);
    }
    assert_eq!((bench.read(&mut tim, CCR1), bench.read(&mut tim, CCR2)), (20, 27));
    assert_eq!(bench.read(&mut tim, SR) & 1 << 9, 0, "one capture only");
}

#[test]
fn a_filter_drops_short_pulses_and_delays_the_rest() {
    let (mut bench, mut tim) = microseconds(2, u32::MAX);
    // IC1F = 15: 8 samples of f_DTS / 32, with CKD = 2 (f_CK / 4): 4266.7 ns.
    bench.write(&mut tim, CCMR1, 0xf1);
    bench.write(&mut tim, CCER, 1);
    bench.write(&mut tim, DIER, 2);
    bench.write(&mut tim, CR1, 2 << 8 | 1);
    input(&mut bench, &mut tim, 1, true, 100 * US);
    assert_eq!(tim.next_event_ns(), 104_267);
    input(&mut bench, &mut tim, 1, false, 104 * US);
    assert_eq!(tim.next_event_ns(), u64::MAX);
    bench.run(&mut tim, 200 * US);
    assert_eq!(bench.read(&mut tim, SR) & 2, 0);
    input(&mut bench, &mut tim, 1, true, 200 * US);
    bench.run(&mut tim, 210 * US);
    assert_eq!(irqs(&mut bench), [(28, true)]);
    assert_eq!(bench.read(&mut tim, CCR1), 204);
}

#[test]
fn an_encoder_counts_every_edge_both_ways() {
    let (mut bench, mut tim) = (Bench::default(), Tim::new(8));
    bench.write(&mut tim, CCMR1, 0x0101);
    bench.write(&mut tim, SMCR, 3);
    bench.write(&mut tim, CR1, 1);
    let cycle = [(1, true), (2, true), (1, false), (2, false)];
    let mut at_ns = 0;
    for _ in 0..5 {
        for (channel, high) in cycle {
            at_ns += US;
            input(&mut bench, &mut tim, channel, high, at_ns);
        }
    }
    assert_eq!((bench.read(&mut tim, CNT), bench.read(&mut tim, CR1) & 0x10), (20, 0));
    // The shaft turns back, through 0.
    for _ in 0..6 {
        for (channel, high) in [(2, true), (1, true), (2, false), (1, false)] {
            at_ns += US;
            input(&mut bench, &mut tim, channel, high, at_ns);
        }
    }
    assert_eq!((bench.read(&mut tim, CNT), bench.read(&mut tim, CR1) & 0x10), (0xfffc, 0x10));
    assert_eq!(bench.read(&mut tim, SR) & 1, 1, "an underflow is an update");
    // Writing CR1 back as read does not change DIR, which belongs to the hardware in encoder mode.
    bench.modify(&mut tim, CR1, 0x10, 4);
    assert_eq!(bench.read(&mut tim, CR1) & 0x10, 0x10);
    assert_eq!(tim.next_event_ns(), u64::MAX);
    bench.assert_no_misuse();
}

#[test]
fn an_encoder_can_count_one_input_or_turn_round() {
    // Cases: mode 1 counts TI1, mode 2 TI2; the third inverts TI1; the last does not count because the timer is off.
    for (mode, ccer, cr1, expected) in [(1, 0, 1, 2), (2, 0, 1, 2), (3, 2, 1, 0xfffc), (3, 0, 0, 0)] {
        let (mut bench, mut tim) = (Bench::default(), Tim::new(3));
        bench.write(&mut tim, CCMR1, 0x0101);
        bench.write(&mut tim, CCER, ccer);
        bench.write(&mut tim, SMCR, mode);
        bench.write(&mut tim, CR1, cr1);
        for (n, (channel, high)) in [(1, true), (2, true), (1, false), (2, false)].into_iter().enumerate() {
            input(&mut bench, &mut tim, channel, high, n as u64 * US);
        }
        assert_eq!(bench.read(&mut tim, CNT), expected, "mode {mode}, CCER {ccer}");
    }
}

#[test]
fn a_filtered_encoder_ignores_bouncing() {
    let (mut bench, mut tim) = (Bench::default(), Tim::new(1));
    // The filter takes 8 samples of the timer's clock: 33.3 ns.
    bench.write(&mut tim, CCMR1, 0x3131);
    bench.write(&mut tim, SMCR, 3);
    bench.write(&mut tim, CR1, 1);
    for (at_ns, high) in [(1_000, true), (1_020, false), (1_030, true), (1_050, false), (1_060, true)] {
        input(&mut bench, &mut tim, 1, high, at_ns);
    }
    assert_eq!(bench.read(&mut tim, CNT), 0);
    // TI2 changes before the filter has passed TI1, and passes after it.
    input(&mut bench, &mut tim, 2, true, 1_080);
    assert_eq!(bench.read(&mut tim, CNT), 0);
    bench.now_ns = 1_094;
    assert_eq!(bench.read(&mut tim, CNT), 1);
    bench.now_ns = 1_114;
    assert_eq!(bench.read(&mut tim, CNT), 2);
}

#[test]
fn dma_requests_follow_updates_and_compares() {
    let (mut bench, mut tim) = microseconds(3, 9);
    bench.write(&mut tim, CCR1, 4);
    bench.write(&mut tim, DIER, 1 << 8 | 1 << 9);
    bench.write(&mut tim, CR1, 1);
    bench.run(&mut tim, 15 * US);
    let cc = Signal::Dma { request: 23, level: true };
    let up = Signal::Dma { request: 27, level: true };
    assert_eq!(bench.take_signals(), [cc, up, cc]);
    // With CCDS the channels' requests come with the update.
    bench.write(&mut tim, CR2, 1 << 3);
    bench.run(&mut tim, 25 * US);
    assert_eq!(bench.take_signals(), [up, cc]);
    bench.write(&mut tim, DIER, 0);
    let down = |request| Signal::Dma { request, level: false };
    assert_eq!(bench.take_signals(), [down(27), down(23)]);
}

#[test]
fn the_trigger_output_follows_the_master_mode() {
    let (mut bench, mut tim) = microseconds(12, 9);
    let trigger = Signal::Trigger { timer: 12 };
    bench.write(&mut tim, EGR, 1);
    assert_eq!(bench.take_signals(), [trigger], "reset");
    bench.write(&mut tim, CR2, 1 << 4);
    bench.write(&mut tim, CR1, 1);
    assert_eq!(bench.take_signals(), [trigger], "enable");
    bench.write(&mut tim, CR2, 2 << 4);
    assert_eq!(tim.next_event_ns(), 10 * US);
    bench.run(&mut tim, 35 * US);
    assert_eq!(bench.take_signals(), [trigger; 3], "update");
    bench.write(&mut tim, CR2, 3 << 4);
    bench.write(&mut tim, CCR1, 7);
    bench.run(&mut tim, 57 * US);
    assert_eq!(bench.take_signals(), [trigger; 3], "compare at 37, 47 and 57 us");
}

#[test]
fn a_burst_writes_several_registers() {
    let (mut bench, mut tim) = microseconds(4, 99);
    // The burst starts at CCR1 (13th word), and has two registers.
    bench.write(&mut tim, DCR, 1 << 8 | 13);
    bench.write(&mut tim, DIER, 1 << 8);
    bench.write(&mut tim, CR1, 1);
    bench.run(&mut tim, 100 * US);
    let up = Signal::Dma { request: 32, level: true };
    assert_eq!(bench.take_signals(), [up]);
    bench.write(&mut tim, DMAR, 11);
    assert_eq!(bench.take_signals(), [up], "the second word");
    bench.write(&mut tim, DMAR, 22);
    assert_eq!(bench.take_signals(), []);
    assert_eq!((bench.read(&mut tim, CCR1), bench.read(&mut tim, CCR2)), (11, 22));
}

#[test]
fn the_flag_can_be_read_with_the_count() {
    let (mut bench, mut tim) = microseconds(5, 99);
    bench.write(&mut tim, CR1, 1 << 11 | 1);
    bench.run(&mut tim, 105 * US);
    assert_eq!(bench.read(&mut tim, CNT), 1 << 31 | 5);
}

#[test]
fn a_new_clock_counts_on() {
    let (mut bench, mut tim) = microseconds(2, u32::MAX);
    bench.write(&mut tim, CR1, 1);
    bench.run(&mut tim, 100 * US);
    bench.clocks.tim_apb1_hz = 120_000_000;
    tim.clocks_changed(&mut bench.context());
    bench.run(&mut tim, 200 * US);
    assert_eq!(bench.read(&mut tim, CNT), 150);
    bench.clocks.tim_apb1_hz = 0;
    tim.clocks_changed(&mut bench.context());
    bench.now_ns = 900 * US;
    assert_eq!(bench.read(&mut tim, CNT), 150, "stopped");
    assert_eq!(tim.next_event_ns(), u64::MAX);
}

#[test]
fn vectors_of_the_manual() {
    // Update interrupts of timers that share a vector with another, or have several vectors.
    for (number, vector) in
        [(1, 25), (8, 44), (12, 43), (13, 44), (14, 45), (15, 116), (16, 117), (17, 118), (6, 54), (7, 55)]
    {
        let (mut bench, mut tim) = microseconds(number, 9);
        bench.write(&mut tim, DIER, 1);
        bench.write(&mut tim, CR1, 1);
        bench.run(&mut tim, 10 * US);
        assert_eq!(irqs(&mut bench), [(vector, true)], "TIM{number}");
        tim.reset(&mut bench.context());
        assert_eq!(irqs(&mut bench), [(vector, false)], "TIM{number}");
        assert_eq!(bench.read(&mut tim, CR1), 0);
    }
    let (mut bench, mut tim) = microseconds(8, 9);
    bench.write(&mut tim, DIER, 1 << 3);
    bench.write(&mut tim, EGR, 1 << 3);
    assert_eq!(irqs(&mut bench), [(46, true)]);
}

#[test]
fn what_is_not_there_is_refused() {
    let refused: &[(u8, u32, u32)] = &[
        (2, CR1, 1 << 5),     // center-aligned
        (2, CR1, 1 << 4 | 1), // down
        (2, SMCR, 4),         // reset mode
        (12, SMCR, 3),        // no encoder there
        (2, SMCR, 1 << 14),   // external clock
        (2, CR2, 1 << 7),     // TI1S
        (2, CR2, 4 << 4),     // OC1REF as trigger
        (2, CCMR1, 1 << 16),  // OC1M = 8
        (2, CCMR1, 3),        // TRC
        (1, CCER, 4),         // CC1NE
        (1, 0x54, 0),         // CCMR3
        (2, 0x68, 1),         // TISEL
        (2, RCR, 0),
        (13, CR2, 0),
        (13, CCR2, 0),
        (6, CCER, 0),
        (12, CCMR2, 0),
    ];
    for &(number, offset, value) in refused {
        let (mut bench, mut tim) = (Bench::default(), Tim::new(number));
        assert!(bench.try_write(&mut tim, offset, Size::Word, value).is_err(), "TIM{number} {offset:#x} {value:#x}");
    }
    let (mut bench, mut tim) = (Bench::default(), Tim::new(2));
    assert!(bench.try_write(&mut tim, CNT, Size::Byte, 0).is_err());
    assert_eq!(bench.misuse.len(), 1);
}

#[derive(Clone, Debug)]
struct Setting {
    psc: u32,
    arr: u32,
    compare: [u32; 2],
    modes: [u32; 2],
    preload: bool,
    later: [u32; 2],
}

fn setting() -> impl Strategy<Value = Setting> {
    let mode = prop::sample::select(vec![0_u32, 1, 2, 3, 6, 7]);
    let compare = || [0..40_u32, 0..40_u32];
    (0..5_u32, 1..30_u32, compare(), [mode.clone(), mode], any::<bool>(), compare())
        .prop_map(|(psc, arr, compare, modes, preload, later)| Setting { psc, arr, compare, modes, preload, later })
}

/// Runs a timer for 20 µs, with new compare values at 7 µs; advances it at the given times, and if `events` at its own
/// too.
fn observe(setting: &Setting, looks: &[u64], events: bool) -> (Vec<(u64, u8, bool)>, [u32; 3]) {
    let (mut bench, mut tim) = (Bench::default(), Tim::new(12));
    let preload = if setting.preload { 8 } else { 0 };
    // The interrupts only make events; they are not served.
    let interrupts = if events { 7 } else { 0 };
    bench.write(&mut tim, DIER, interrupts);
    bench.write(&mut tim, CCMR1, setting.modes[0] << 4 | preload | (setting.modes[1] << 4 | preload) << 8);
    bench.write(&mut tim, PSC, setting.psc);
    bench.write(&mut tim, ARR, setting.arr);
    bench.write(&mut tim, CCR1, setting.compare[0]);
    bench.write(&mut tim, CCR2, setting.compare[1]);
    bench.write(&mut tim, EGR, 1);
    bench.write(&mut tim, CCER, 0x11);
    bench.write(&mut tim, CR1, 1);
    let mut changed = false;
    for &look in looks.iter().chain([&20_000]) {
        if look >= 7_000 && !changed {
            changed = true;
            if events {
                bench.run(&mut tim, 7_000);
            }
            bench.now_ns = 7_000;
            bench.write(&mut tim, CCR1, setting.later[0]);
            bench.write(&mut tim, CCR2, setting.later[1]);
        }
        if events {
            bench.run(&mut tim, look);
        }
        bench.now_ns = look;
        let _ = bench.read(&mut tim, CNT);
    }
    let mut edges: Vec<_> = bench
        .take_signals()
        .into_iter()
        .filter_map(|signal| match signal {
            Signal::TimerOutput { at_ns, channel, high, .. } => Some((at_ns, channel, high)),
            _ => None,
        })
        .collect();
    assert!(edges.is_sorted_by_key(|edge| edge.0));
    edges.sort();
    (edges, [CNT, SR, CCR1].map(|offset| bench.read(&mut tim, offset)))
}

/// Reference model that computes the same clock by clock, as the manual's figures show it.
fn reference(setting: &Setting) -> (Vec<(u64, u8, bool)>, [u32; 3]) {
    let mut compare = setting.compare;
    let (mut count, mut prescaler, mut flags) = (0, 0, 1);
    let mut references = [false; 2];
    let mut levels = [false; 2];
    let mut edges = Vec::new();
    let output = |mode: u32, count: u32, compare: u32, old: bool, matched: bool| match mode {
        1 => old || matched,
        2 => old && !matched,
        3 => old != matched,
        6 => count < compare,
        7 => count >= compare,
        _ => old,
    };
    let mut tell = |references: [bool; 2], at_ns: u64| {
        for n in 0..2 {
            if references[n] != levels[n] {
                levels[n] = references[n];
                edges.push((at_ns, n as u8 + 1, levels[n]));
            }
        }
    };
    for n in 0..2 {
        references[n] = output(setting.modes[n], 0, compare[n], false, false);
    }
    tell(references, 0);
    // 20 µs are 4800 clocks; 7 µs fall between the 1679th and the 1681st.
    for clock in 1..=4_800_u64 {
        let at_ns = (clock * 1_000_000_000).div_ceil(240_000_000);
        if clock == 1_681 && !setting.preload {
            compare = setting.later;
            for n in 0..2 {
                references[n] = output(setting.modes[n], count, compare[n], references[n], false);
            }
            tell(references, 7_000);
        }
        prescaler += 1;
        if prescaler <= setting.psc {
            continue;
        }
        prescaler = 0;
        count += 1;
        let mut beyond = [false; 2];
        if count > setting.arr {
            count = 0;
            flags |= 1;
            beyond = compare.map(|compare| compare > setting.arr);
            if clock > 1_680 {
                compare = setting.later;
            }
        }
        for n in 0..2 {
            let matched = count == compare[n];
            if matched || beyond[n] {
                flags |= 2 << n;
            }
            references[n] = output(setting.modes[n], count, compare[n], references[n], matched);
        }
        tell(references, at_ns);
    }
    edges.sort();
    (edges, [count, flags, setting.later[0]])
}

proptest! {
    #[test]
    fn a_timer_does_what_clock_by_clock_counting_does(setting in setting()) {
        prop_assert_eq!(observe(&setting, &[], false), reference(&setting));
    }

    /// Lazy and frequent advances give the same results.
    #[test]
    fn looking_changes_nothing(setting in setting(), mut looks in prop::collection::vec(0..20_000_u64, 0..20)) {
        looks.sort_unstable();
        let once = observe(&setting, &[], false);
        prop_assert_eq!(&observe(&setting, &looks, false), &once);
        prop_assert_eq!(&observe(&setting, &looks, true), &once);
    }

    /// A shaft turns at random: the count equals its position, modulo the timer's range.
    #[test]
    fn an_encoder_follows_its_shaft(steps in prop::collection::vec(any::<bool>(), 0..500), start in 0..0x1_0000_u32) {
        let (mut bench, mut tim) = (Bench::default(), Tim::new(3));
        bench.write(&mut tim, CCMR1, 0x0101);
        bench.write(&mut tim, SMCR, 3);
        bench.write(&mut tim, CNT, start);
        bench.write(&mut tim, CR1, 1);
        let mut position = 0_i32;
        for (n, &forwards) in steps.iter().enumerate() {
            position += if forwards { 1 } else { -1 };
            let phase = position.rem_euclid(4);
            for (channel, high) in [(1, phase == 1 || phase == 2), (2, phase == 2 || phase == 3)] {
                input(&mut bench, &mut tim, channel, high, n as u64 * US);
            }
        }
        prop_assert_eq!(bench.read(&mut tim, CNT), (start as i32 + position).rem_euclid(0x1_0000) as u32);
    }
}

const TISEL: u32 = 0x68;

/// Makes a TIM16 in microseconds that captures every eighth rising edge of LSI with an interrupt.
fn against_lsi(lsi_hz: u64) -> (Bench, Tim) {
    let (mut bench, mut tim) = microseconds(16, 0xffff);
    bench.clocks.lsi_ready_hz = lsi_hz;
    for (at, value) in [(TISEL, 1), (CCMR1, 3 << 2 | 1), (DIER, 2), (CCER, 1), (CR1, 1)] {
        bench.write(&mut tim, at, value);
    }
    (bench, tim)
}

#[test]
fn eight_periods_of_the_low_speed_oscillator_are_captured_in_the_timer_s_own_clock() {
    for (lsi_hz, expected_us) in [(32_000, 250), (31_400, 254), (32_600, 245)] {
        let (mut bench, mut tim) = against_lsi(lsi_hz);
        let mut captures = Vec::new();
        for _ in 0..20 {
            let next_ns = tim.next_event_ns();
            bench.run(&mut tim, next_ns);
            assert_eq!(irqs(&mut bench), [(117, true)]);
            captures.push(bench.read(&mut tim, CCR1));
            assert_eq!(irqs(&mut bench), [(117, false)]);
        }
        for pair in captures.windows(2) {
            // One count is 1 µs; the edges fall anywhere within it.
            assert!((expected_us..=expected_us + 1).contains(&(pair[1] - pair[0])), "{lsi_hz}: {captures:?}");
        }
        bench.assert_no_misuse();
    }
}

#[test]
fn an_oscillator_that_stops_or_is_not_on_is_never_captured() {
    let (mut bench, mut tim) = against_lsi(0);
    bench.run(&mut tim, 10 * MS);
    assert_eq!((tim.next_event_ns(), bench.read(&mut tim, SR)), (u64::MAX, 0));
    bench.clocks.lsi_ready_hz = 32_000;
    tim.clocks_changed(&mut bench.context());
    let first_ns = tim.next_event_ns();
    // The eighth rising edge comes after seven whole periods and half of one.
    assert_eq!(first_ns, 10 * MS + 7_500_000_000 / 32_000);
    bench.run(&mut tim, first_ns);
    bench.clocks.lsi_ready_hz = 0;
    tim.clocks_changed(&mut bench.context());
    bench.read(&mut tim, CCR1);
    assert_eq!(tim.next_event_ns(), u64::MAX);
}

#[test]
fn a_pin_is_not_heard_while_the_oscillator_is_chosen() {
    let (mut bench, mut tim) = against_lsi(0);
    input(&mut bench, &mut tim, 1, true, MS);
    assert_eq!(bench.read(&mut tim, SR) & 2, 0);
    assert_eq!(tim.watching(), 0);
    for (number, select) in [(16, 3), (17, 1), (17, 3), (15, 5), (2, 1)] {
        let (mut bench, mut tim) = microseconds(number, 0xffff);
        assert!(bench.try_write(&mut tim, TISEL, Size::Word, select).is_err(), "TIM{number} {select}");
    }
    let (mut bench, mut tim) = microseconds(17, 0xffff);
    bench.clocks.hse_rtc_hz = 1_000_000;
    for (at, value) in [(TISEL, 2), (CCMR1, 1), (CCER, 1), (CR1, 1)] {
        bench.write(&mut tim, at, value);
    }
    bench.run(&mut tim, bench.now_ns + 10 * US);
    assert_eq!(bench.read(&mut tim, SR) & 2, 2, "HSE divided by RTCPRE");
}
