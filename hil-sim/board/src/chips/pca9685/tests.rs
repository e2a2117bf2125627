//! Sequences and limits of the datasheet. Register addresses are literal, so that a wrong constant in the model fails.

use core::cell::RefCell;
use std::rc::Rc;

use super::*;
use crate::i2c::{Fault, I2cBus};
use embedded_hal::i2c::Operation;
use proptest::prelude::*;

const OSCILLATOR_HZ: u32 = 25_000_000;
const START_NS: u64 = 500_000;
/// PWM period for prescaler 0x1E, the power-on value: 4096 * 31 * 40 ns.
const PERIOD_NS: u64 = 5_079_040;

fn chip() -> Pca9685 {
    Pca9685::new(0x40, OSCILLATOR_HZ)
}

/// One write transaction, all at one instant; true if every byte was acknowledged.
fn write(chip: &mut Pca9685, at_ns: u64, bytes: &[u8]) -> bool {
    chip.start(at_ns, 0x40, false);
    let acknowledged = bytes.iter().all(|&byte| chip.write(at_ns, byte));
    chip.stop(at_ns);
    acknowledged
}

fn read<const N: usize>(chip: &mut Pca9685, at_ns: u64, register: u8) -> [u8; N] {
    chip.start(at_ns, 0x40, false);
    assert!(chip.write(at_ns, register));
    chip.start(at_ns, 0x40, true);
    let bytes = core::array::from_fn(|_| chip.read(at_ns));
    chip.stop(at_ns);
    bytes
}

fn set(chip: &mut Pca9685, at_ns: u64, channel: u8, on: u16, off: u16) {
    let ([on_l, on_h], [off_l, off_h]) = (on.to_le_bytes(), off.to_le_bytes());
    assert!(write(chip, at_ns, &[0x06 + 4 * channel, on_l, on_h, off_l, off_h]));
}

/// A chip awake with auto-increment, oscillator running, at 1 ms.
fn awake() -> Pca9685 {
    let mut chip = chip();
    assert!(write(&mut chip, 0, &[0x00, 0x21]));
    chip.advance(1_000_000);
    chip
}

/// As [`awake`], with channel 15 full ON since 1 ms, so that cycles run from then on.
fn running() -> Pca9685 {
    let mut chip = awake();
    set(&mut chip, 1_000_000, 15, 0x1000, 0);
    assert_eq!(chip.line(15), Line::High);
    chip
}

fn kinds(chip: &Pca9685) -> Vec<MisuseKind> {
    chip.misuse().first().iter().map(|misuse| misuse.kind).collect()
}

#[test]
fn power_on_values() {
    let mut chip = chip();
    // 7.3: MODE1 asleep and answering All Call, MODE2 totem pole, addresses E2 E4 E8 E0, outputs full OFF, 200 Hz
    let mut expected = vec![(0x00, 0x11), (0x01, 0x04), (0x02, 0xE2), (0x03, 0xE4), (0x04, 0xE8), (0x05, 0xE0)];
    expected.extend((0x06..=0x45).map(|register| (register, if register % 4 == 1 { 0x10 } else { 0x00 })));
    expected.extend([(0xFA, 0), (0xFB, 0), (0xFC, 0), (0xFD, 0), (0xFE, 0x1E)]);
    for (register, value) in expected {
        assert_eq!(read(&mut chip, 0, register), [value], "register 0x{register:02X}");
        assert_eq!(chip.register(register), Some(value));
    }
    assert_eq!(chip.lines(), &[Line::Low; 16]);
    assert!(chip.misuse().is_empty());
}

#[test]
fn every_address_below_46_and_above_f9_is_acknowledged_and_no_other() {
    for register in 0..=0xFF {
        let exists = register <= 0x45 || register >= 0xFA;
        let mut chip = chip();
        assert_eq!(write(&mut chip, 0, &[register]), exists, "register 0x{register:02X}");
        let expected = if exists { vec![] } else { vec![MisuseKind::UnmappedRegister { register }] };
        assert_eq!(kinds(&chip), expected);
        assert_eq!(chip.register(register).is_some(), exists);
    }
}

#[test]
fn a_refused_pointer_ends_the_transfer_and_keeps_the_old_pointer() {
    let mut chip = chip();
    assert!(write(&mut chip, 0, &[0x05]));
    chip.start(0, 0x40, false);
    assert!(!chip.write(0, 0x80));
    assert!(!chip.write(0, 0x00));
    chip.stop(0);
    chip.start(0, 0x40, true);
    assert_eq!(chip.read(0), 0xE0);
}

#[test]
fn auto_increment_wraps_at_45_and_fe() {
    let mut chip = awake();
    set(&mut chip, 1_000_000, 15, 0x123, 0x456);
    assert_eq!(read(&mut chip, 1_000_000, 0x42), [0x23, 0x01, 0x56, 0x04, 0x21, 0x04, 0xE2]);
    assert_eq!(read(&mut chip, 1_000_000, 0xFA), [0, 0, 0, 0, 0x1E, 0x21, 0x04]);
}

#[test]
fn without_auto_increment_the_pointer_stays() {
    let mut chip = chip();
    assert!(write(&mut chip, 0, &[0x02, 0x10, 0x20, 0x30]));
    assert_eq!(read(&mut chip, 0, 0x02), [0x30, 0x30]);
    assert_eq!(read(&mut chip, 0, 0x03), [0xE4]);
}

#[test]
fn auto_increment_acts_from_the_byte_that_sets_it() {
    // figures 21 and 22: AI initially clear, then all registers in one transfer
    let mut chip = chip();
    assert!(write(&mut chip, 0, &[0x00, 0x31, 0x10, 0x02]));
    assert_eq!(read(&mut chip, 0, 0x00), [0x31, 0x10, 0x02]);
}

#[test]
fn addresses_and_their_enable_bits() {
    let mut chip = chip();
    let answers = |chip: &Pca9685| -> Vec<u8> {
        let both = |address: &u8| chip.acknowledges(*address, false) && chip.acknowledges(*address, true);
        (1..=0x7F).filter(both).collect()
    };
    assert_eq!(answers(&chip), [0x40, 0x70]);
    // SUB1, SUB2, SUB3 one by one; the power-on sub-addresses are E2h, E4h, E8h on 8 bits
    for (mode1, expected) in [(0x18, 0x71), (0x14, 0x72), (0x12, 0x74)] {
        assert!(write(&mut chip, 0, &[0x00, mode1]));
        assert_eq!(answers(&chip), [0x40, expected]);
    }
    // bit 0 of the registers is read-only
    assert!(write(&mut chip, 0, &[0x00, 0x39]));
    assert!(write(&mut chip, 0, &[0x02, 0xC1, 0xE5, 0xE9, 0xA5]));
    assert_eq!(read(&mut chip, 0, 0x02), [0xC0, 0xE4, 0xE8, 0xA4]);
    assert_eq!(answers(&chip), [0x40, 0x52, 0x60]);
}

#[test]
fn software_reset_acknowledges_06_only_and_acts_at_stop() {
    // bytes of a general call, number of acknowledged ones, and whether the chip resets (7.6)
    for (bytes, acknowledged, resets) in [
        (&[0x06][..], 1, true),
        (&[0x06, 0x06], 1, false),
        (&[0x05], 0, false),
        (&[0x05, 0x06], 0, false),
        (&[], 0, false),
    ] {
        let mut chip = running();
        assert!(chip.acknowledges(0, false) && !chip.acknowledges(0, true));
        chip.start(2_000_000, 0, false);
        let mut count = 0;
        for &byte in bytes {
            count += usize::from(chip.write(2_000_000, byte));
        }
        assert_eq!(count, acknowledged, "{bytes:?}");
        assert_eq!(chip.line(15), Line::High);
        chip.stop(2_000_100);
        assert_eq!(chip.line(15) == Line::Low, resets, "{bytes:?}");
        assert_eq!(chip.register(0x00), Some(if resets { 0x11 } else { 0x21 }));
    }
}

#[test]
fn prescaler_is_taken_asleep_only() {
    let mut chip = awake();
    assert!(write(&mut chip, 1_000_000, &[0xFE, 0x79]));
    assert_eq!(chip.register(0xFE), Some(0x1E));
    assert_eq!(kinds(&chip), [MisuseKind::PrescaleWhileAwake { value: 0x79, kept: 0x1E }]);
    assert!(write(&mut chip, 1_000_000, &[0x00, 0x31]));
    // written, taken, period
    for (value, taken, period_ns) in
        [(0x79, 0x79, 19_988_480), (0xFF, 0xFF, 41_943_040), (3, 3, 655_360), (2, 3, 655_360), (0, 3, 655_360)]
    {
        chip.misuse_mut().clear();
        assert!(write(&mut chip, 1_000_000, &[0xFE, value]));
        assert_eq!(chip.register(0xFE), Some(taken));
        assert_eq!(chip.pwm_period_ns(), period_ns);
        let low = MisuseKind::PrescaleBelowMinimum { value, taken };
        assert_eq!(kinds(&chip), if value < 3 { vec![low] } else { vec![] });
    }
}

#[test]
fn the_oscillator_needs_500_us() {
    let mut chip = chip();
    set_asleep(&mut chip, 0x0000, 0x0400);
    assert_eq!(chip.next_change_ns(), None);
    assert!(write(&mut chip, 10_000, &[0x00, 0x21]));
    assert_eq!(chip.next_change_ns(), Some(10_000 + START_NS));
    chip.advance(10_000 + START_NS - 1);
    assert_eq!(chip.line(0), Line::Low);
    chip.advance(10_000 + START_NS);
    assert_eq!(chip.line(0), Line::Pwm { on: 0, off: 0x400 });
    assert!(chip.misuse().is_empty());
}

/// Sets the registers of channel 0 one by one, without auto-increment.
fn set_asleep(chip: &mut Pca9685, on: u16, off: u16) {
    let ([on_l, on_h], [off_l, off_h]) = (on.to_le_bytes(), off.to_le_bytes());
    for (register, value) in [(0x06, on_l), (0x07, on_h), (0x08, off_l), (0x09, off_h)] {
        assert!(write(chip, 0, &[register, value]));
    }
}

#[test]
fn pwm_registers_written_while_the_oscillator_starts_are_reported_once() {
    let mut chip = chip();
    assert!(write(&mut chip, 0, &[0x00, 0x21]));
    set(&mut chip, 499_999, 0, 0, 100);
    assert_eq!(kinds(&chip), [MisuseKind::OutputsBeforeOscillatorReady { awake_ns: 499_999, needed_ns: START_NS }]);
    let mut chip = self::chip();
    assert!(write(&mut chip, 0, &[0x00, 0x21]));
    set(&mut chip, 500_000, 0, 0, 100);
    assert!(chip.misuse().is_empty());
}

#[test]
fn lines_of_on_and_off_registers() {
    const FULL: u16 = 0x1000;
    // on, off, line; figure 9 and 7.3.3
    for (on, off, line) in [
        (511, 3071, Line::Pwm { on: 511, off: 3071 }),
        (2047, 767, Line::Pwm { on: 2047, off: 767 }),
        (0, 4095, Line::Pwm { on: 0, off: 4095 }),
        (4095, 0, Line::Pwm { on: 4095, off: 0 }),
        (FULL, 0, Line::High),
        (FULL, 1022, Line::High),
        (0, FULL, Line::Low),
        // full OFF has priority
        (FULL, FULL, Line::Low),
        (FULL | 5, FULL | 7, Line::Low),
        // forbidden by the datasheet; off
        (0, 0, Line::Low),
        (1234, 1234, Line::Low),
    ] {
        let mut chip = running();
        chip.misuse_mut().clear();
        set(&mut chip, 1_000_000, 3, on, off);
        // second cycle, because the first may start late
        chip.advance(1_000_000 + 2 * PERIOD_NS);
        assert_eq!(chip.line(3), line, "{on:#x} {off:#x}");
        let equal = MisuseKind::OnEqualsOff { channel: 3, count: on };
        assert_eq!(kinds(&chip), if on == off && on < FULL { vec![equal] } else { vec![] });
    }
}

#[test]
fn changes_wait_for_the_end_of_the_cycle() {
    let mut chip = running();
    set(&mut chip, 1_000_001, 0, 0, 1000);
    let boundary_ns = 1_000_000 + PERIOD_NS;
    assert_eq!(chip.next_change_ns(), Some(boundary_ns));
    // reads return the written value, not the one in force
    assert_eq!(read(&mut chip, 1_000_002, 0x08), [0xE8, 0x03]);
    let generation = chip.generation();
    chip.advance(boundary_ns - 1);
    assert_eq!((chip.line(0), chip.generation()), (Line::Low, generation));
    chip.advance(boundary_ns);
    assert_eq!(chip.line(0), Line::Pwm { on: 0, off: 1000 });
    assert_eq!((chip.generation(), chip.next_change_ns()), (generation + 1, None));
    // an update written exactly at a boundary takes effect at the next one
    let at_ns = 1_000_000 + 7 * PERIOD_NS;
    set(&mut chip, at_ns, 0, 0, 0x1000);
    assert_eq!(chip.next_change_ns(), Some(at_ns + PERIOD_NS));
    chip.advance(at_ns + PERIOD_NS);
    assert_eq!(chip.line(0), Line::Low);
}

#[test]
fn four_bytes_take_effect_together_at_stop() {
    let mut chip = running();
    set(&mut chip, 1_000_000, 0, 0, 0x0200);
    chip.advance(1_000_000 + PERIOD_NS);
    let before = chip.line(0);
    // a cycle ends during the transfer
    let boundary_ns = 1_000_000 + 2 * PERIOD_NS;
    chip.start(boundary_ns - 40_000, 0x40, false);
    for (index, byte) in [0x06, 0x00, 0x01, 0x00, 0x03].into_iter().enumerate() {
        assert!(chip.write(boundary_ns - 40_000 + 20_000 * index as u64, byte));
    }
    assert_eq!(chip.next_change_ns(), None);
    chip.stop(boundary_ns + 60_000);
    assert_eq!(chip.line(0), before);
    chip.advance(boundary_ns + PERIOD_NS);
    assert_eq!(chip.line(0), Line::Pwm { on: 0x100, off: 0x300 });
}

#[test]
fn on_ack_a_channel_waits_for_all_four_registers() {
    let mut chip = running();
    assert!(write(&mut chip, 1_000_000, &[0x01, 0x0C]));
    chip.start(1_000_000, 0x40, false);
    for byte in [0x06, 0x00, 0x00, 0x00] {
        assert!(chip.write(1_000_000, byte));
    }
    assert_eq!(chip.next_change_ns(), None);
    assert!(chip.write(1_000_010, 0x02));
    // before STOP
    assert_eq!(chip.next_change_ns(), Some(1_000_000 + PERIOD_NS));
    chip.stop(1_000_020);
    assert!(chip.misuse().is_empty());
    // full OFF of all channels through one register has no effect, without any error
    assert!(write(&mut chip, 1_000_030, &[0xFD, 0x10]));
    chip.advance(10 * PERIOD_NS);
    assert_eq!(chip.line(15), Line::High);
    assert_eq!(kinds(&chip), [0, 15].map(|channel| MisuseKind::FullOffNotApplied { channel }));
}

#[test]
fn all_led_registers_load_every_channel() {
    let mut chip = awake();
    assert!(write(&mut chip, 1_000_000, &[0xFA, 0x10, 0x00, 0x20, 0x03]));
    assert_eq!(chip.lines(), &[Line::Pwm { on: 0x10, off: 0x320 }; 16]);
    assert_eq!(read(&mut chip, 1_000_000, 0x42), [0x10, 0x00, 0x20, 0x03]);
    assert_eq!(read(&mut chip, 1_000_000, 0xFA), [0, 0, 0, 0]);
    // figure 24
    assert!(write(&mut chip, 1_000_001, &[0xFD, 0x10]));
    chip.advance(1_000_000 + PERIOD_NS);
    assert_eq!(chip.lines(), &[Line::Low; 16]);
}

#[test]
fn with_all_outputs_full_off_a_change_starts_a_cycle_at_once() {
    // 7.3.3: the cycle timing is disabled then
    let mut chip = awake();
    set(&mut chip, 1_234_567, 0, 0, 1000);
    assert_eq!(chip.line(0), Line::Pwm { on: 0, off: 1000 });
    set(&mut chip, 1_300_000, 1, 0, 1000);
    assert_eq!(chip.next_change_ns(), Some(1_234_567 + PERIOD_NS));
    // all off again, from the end of a cycle
    assert!(write(&mut chip, 1_400_000, &[0xFD, 0x10]));
    chip.advance(1_234_567 + PERIOD_NS);
    let at_ns = 1_234_567 + PERIOD_NS + 1_000;
    set(&mut chip, at_ns, 0, 0, 2000);
    assert_eq!(chip.line(0), Line::Pwm { on: 0, off: 2000 });
    set(&mut chip, at_ns + 1, 0, 0, 3000);
    assert_eq!(chip.next_change_ns(), Some(at_ns + PERIOD_NS));
}

#[test]
fn the_on_delay_also_holds_in_the_first_cycle() {
    for (on, off, first, then) in [
        (0x1000 | 1022, 0, Line::Pwm { on: 1022, off: 0 }, Line::High),
        (2047, 767, Line::Pwm { on: 2047, off: 0 }, Line::Pwm { on: 2047, off: 767 }),
        (511, 3071, Line::Pwm { on: 511, off: 3071 }, Line::Pwm { on: 511, off: 3071 }),
    ] {
        let mut chip = awake();
        set(&mut chip, 1_000_000, 0, on, off);
        assert_eq!(chip.line(0), first);
        chip.advance(1_000_000 + PERIOD_NS);
        assert_eq!(chip.line(0), then);
        assert_eq!(chip.next_change_ns(), None);
    }
}

#[test]
fn restart_sequence() {
    // 7.3.1.1
    let mut chip = running();
    assert!(write(&mut chip, 2_000_000, &[0x00, 0x31]));
    assert_eq!(chip.register(0x00), Some(0x31));
    let asleep_ns = 1_000_000 + PERIOD_NS;
    assert_eq!(chip.next_change_ns(), Some(asleep_ns));
    chip.advance(asleep_ns - 1);
    assert_eq!(chip.line(15), Line::High);
    chip.advance(asleep_ns);
    assert_eq!((chip.register(0x00), chip.line(15)), (Some(0xB1), Line::Low));

    assert!(write(&mut chip, 10_000_000, &[0x00, 0x21]));
    assert_eq!(chip.register(0x00), Some(0xA1));
    // at the earliest instant allowed
    let mut prompt = chip.clone();
    assert!(write(&mut prompt, 10_500_000, &[0x00, 0xA1]));
    assert_eq!((prompt.register(0x00), prompt.line(15)), (Some(0x21), Line::High));
    assert!(prompt.misuse().is_empty());
    // too early
    assert!(write(&mut chip, 10_499_999, &[0x00, 0xA1]));
    let early = MisuseKind::RestartTooEarly { awake_ns: 499_999, needed_ns: START_NS };
    assert_eq!(kinds(&chip), [early]);
    chip.advance(20_000_000);
    assert_eq!((chip.register(0x00), chip.line(15)), (Some(0xA1), Line::Low));
    // in time
    assert!(write(&mut chip, 20_000_000, &[0x00, 0xA1]));
    assert_eq!((chip.register(0x00), chip.line(15)), (Some(0x21), Line::High));
    assert_eq!(chip.misuse().total(), 1);
}

#[test]
fn restart_is_cleared_by_a_pwm_write_and_never_set_after_an_orderly_shutdown() {
    let asleep = |chip: &mut Pca9685| {
        assert!(write(chip, 2_000_000, &[0x00, 0x31]));
        chip.advance(10_000_000);
    };
    let mut chip = running();
    asleep(&mut chip);
    assert_eq!(chip.register(0x00), Some(0xB1));
    set(&mut chip, 10_000_000, 0, 0, 100);
    assert_eq!(chip.register(0x00), Some(0x31));
    // only the written channel comes back; the others do when they are written too
    assert!(write(&mut chip, 11_000_000, &[0x00, 0x21]));
    chip.advance(12_000_000);
    assert_eq!((chip.line(0), chip.line(15)), (Line::Pwm { on: 0, off: 100 }, Line::Low));
    set(&mut chip, 12_000_000, 15, 0x1000, 0);
    chip.advance(12_000_000 + PERIOD_NS);
    assert_eq!(chip.line(15), Line::High);

    let mut chip = running();
    assert!(write(&mut chip, 1_500_000, &[0xFD, 0x10]));
    asleep(&mut chip);
    assert_eq!(chip.register(0x00), Some(0x31));

    let mut chip = running();
    asleep(&mut chip);
    chip.power_cycle(10_000_000);
    assert_eq!(chip.register(0x00), Some(0x11));
}

#[test]
fn waking_before_the_end_of_the_cycle_goes_on_at_the_new_rate() {
    let mut chip = running();
    assert!(write(&mut chip, 1_100_000, &[0x00, 0x31]));
    assert!(write(&mut chip, 1_200_000, &[0xFE, 0x03]));
    assert!(write(&mut chip, 1_300_000, &[0x00, 0x21]));
    assert_eq!(chip.pwm_period_ns(), PERIOD_NS);
    chip.advance(1_000_000 + PERIOD_NS);
    assert_eq!((chip.line(15), chip.pwm_period_ns()), (Line::High, 655_360));
    assert_eq!(chip.register(0x00), Some(0x21));
    set(&mut chip, 1_000_001 + PERIOD_NS, 0, 0, 1);
    assert_eq!(chip.next_change_ns(), Some(1_000_000 + PERIOD_NS + 655_360));
}

#[test]
fn external_clock_is_sticky_and_only_set_asleep() {
    let mut chip = awake();
    assert!(write(&mut chip, 1_000_000, &[0x00, 0x61]));
    assert!(write(&mut chip, 1_000_000, &[0x00, 0x71]));
    assert_eq!(kinds(&chip), [MisuseKind::ExternalClockWhileAwake; 2]);
    assert_eq!(chip.register(0x00), Some(0x31));
    chip.misuse_mut().clear();
    assert!(write(&mut chip, 1_000_000, &[0x00, 0x71]));
    assert!(write(&mut chip, 1_000_000, &[0x00, 0x31]));
    assert_eq!(chip.register(0x00), Some(0x71));
    assert_eq!(chip.pwm_period_ns(), u64::MAX);
    assert!(write(&mut chip, 1_000_000, &[0x00, 0x21]));
    assert_eq!(kinds(&chip), [MisuseKind::ExternalClockMissing]);
    set(&mut chip, 2_000_000, 0, 0x1000, 0);
    chip.advance(1_000_000_000);
    assert_eq!((chip.line(0), chip.next_change_ns()), (Line::Low, None));
    // 50 MHz on the pin: half the period
    chip.set_external_clock_hz(1_000_000_000, Some(50_000_000));
    chip.advance(1_000_000_000 + START_NS);
    assert_eq!((chip.line(0), chip.pwm_period_ns()), (Line::High, PERIOD_NS / 2));
    chip.power_cycle(2_000_000_000);
    assert_eq!(chip.register(0x00), Some(0x11));
}

#[test]
fn output_stage() {
    const PWM: Line = Line::Pwm { on: 0, off: 1000 };
    const INVERSE: Line = Line::Pwm { on: 1000, off: 0 };
    use Line::{High, HighZ, Low};
    // MODE2, OE low?, then a channel with PWM, one full ON, one full OFF (tables 11 and 12)
    for (mode2, enabled, expected) in [
        (0x04, true, [PWM, High, Low]),
        (0x14, true, [INVERSE, Low, High]),
        (0x00, true, [PWM, HighZ, Low]),
        (0x10, true, [INVERSE, Low, HighZ]),
        (0x04, false, [Low, Low, Low]),
        (0x14, false, [Low, Low, Low]),
        (0x00, false, [Low, Low, Low]),
        (0x05, false, [High, High, High]),
        (0x15, false, [High, High, High]),
        (0x01, false, [HighZ, HighZ, HighZ]),
        (0x06, false, [HighZ, HighZ, HighZ]),
        (0x07, false, [HighZ, HighZ, HighZ]),
    ] {
        let mut chip = awake();
        set(&mut chip, 1_000_000, 0, 0, 1000);
        set(&mut chip, 1_000_000, 1, 0x1000, 0);
        chip.advance(1_000_000 + PERIOD_NS);
        assert!(write(&mut chip, 7_000_000, &[0x01, mode2]));
        chip.set_output_enable(7_000_001, enabled);
        assert_eq!([0, 1, 2].map(|channel| chip.line(channel)), expected, "MODE2 0x{mode2:02X}, OE low: {enabled}");
    }
}

#[test]
fn test_mode_is_reported() {
    let mut chip = chip();
    assert!(write(&mut chip, 0, &[0xFF, 0x01]));
    assert_eq!(kinds(&chip), [MisuseKind::TestModeWritten { value: 1 }]);
}

#[test]
fn boundaries_do_not_drift() {
    // 24.9 MHz: a period of 5099437.75.. ns
    let mut chip = Pca9685::new(0x40, 24_900_000);
    assert!(write(&mut chip, 0, &[0x00, 0x21]));
    set(&mut chip, 1_000_000, 15, 0x1000, 0);
    let boundary_ns = |k: u64| 1_000_000 + k * 4096 * 31 * 1_000 * 10 / 249;
    for k in [1, 2, 3, 1_000, 1_000_000, 100_000_000] {
        set(&mut chip, boundary_ns(k) - 1, 0, 0, (k % 7) as u16 + 1);
        assert_eq!(chip.next_change_ns(), Some(boundary_ns(k)), "cycle {k}");
    }
}

#[test]
fn one_all_call_stops_every_chip_on_the_bus() {
    let chips: Vec<_> =
        [0x40, 0x41, 0x42].map(|address| Rc::new(RefCell::new(Pca9685::new(address, OSCILLATOR_HZ)))).into();
    let mut bus = I2cBus::new(400_000);
    for chip in &chips {
        bus.attach(chip.clone());
    }
    let lines = |expected| chips.iter().all(|chip| chip.borrow().lines() == &[expected; 16]);
    bus.execute(0, 0x70, &mut [Operation::Write(&[0x00, 0x21])]).unwrap();
    bus.execute(1_000_000, 0x70, &mut [Operation::Write(&[0xFA, 0x00, 0x10, 0x00, 0x00])]).unwrap();
    assert!(lines(Line::High));
    // figure 24
    let done = bus.execute(2_000_000, 0x70, &mut [Operation::Write(&[0xFD, 0x10])]).unwrap();
    for chip in &chips {
        chip.borrow_mut().advance(done.end_ns + PERIOD_NS);
    }
    assert!(lines(Line::Low));
}

#[test]
fn a_software_reset_on_the_bus_resets_every_chip() {
    let chips = [0x40, 0x41].map(|address| Rc::new(RefCell::new(Pca9685::new(address, OSCILLATOR_HZ))));
    let mut bus = I2cBus::new(400_000);
    for chip in &chips {
        bus.attach(chip.clone());
    }
    // awake, and not answering All Call
    for address in [0x40, 0x41] {
        bus.execute(0, address, &mut [Operation::Write(&[0x00, 0x20])]).unwrap();
    }
    assert!(matches!(bus.execute(0, 0x70, &mut [Operation::Write(&[])]), Err(Fault::AddressNack { .. })));
    let wrong = bus.execute(0, 0x00, &mut [Operation::Write(&[0x06, 0x06])]);
    assert!(matches!(wrong, Err(Fault::DataNack { byte: 1, .. })));
    assert_eq!(chips[1].borrow().register(0x00), Some(0x20));
    bus.execute(0, 0x00, &mut [Operation::Write(&[0x06])]).unwrap();
    bus.execute(0, 0x70, &mut [Operation::Write(&[])]).unwrap();
    assert!(chips.iter().all(|chip| chip.borrow().register(0x00) == Some(0x11)));
}

/// Random action of a bus, sensible or not.
#[derive(Clone, Debug)]
enum Action {
    Start { address: u8, read: bool },
    Write(u8),
    Read,
    Stop,
    Advance,
    OutputEnable(bool),
    PowerCycle,
    Oscillator(u32),
    ExternalClock(Option<u32>),
}

fn any_action() -> impl Strategy<Value = Action> {
    let address = prop_oneof![Just(0x40), Just(0x70), Just(0), any::<u8>()];
    prop_oneof![
        4 => (address, any::<bool>()).prop_map(|(address, read)| Action::Start { address, read }),
        12 => any::<u8>().prop_map(Action::Write),
        // with a useful share of valid registers, and a way to wake
        4 => prop_oneof![Just(0x00), Just(0x20), Just(0x21), Just(0xA1), Just(0xFE), Just(0x06), Just(0xFD)]
            .prop_map(Action::Write),
        3 => Just(Action::Read),
        3 => Just(Action::Stop),
        4 => Just(Action::Advance),
        1 => any::<bool>().prop_map(Action::OutputEnable),
        1 => Just(Action::PowerCycle),
        1 => any::<u32>().prop_map(Action::Oscillator),
        1 => any::<Option<u32>>().prop_map(Action::ExternalClock),
    ]
}

fn act(chip: &mut Pca9685, at_ns: u64, action: &Action) {
    match *action {
        Action::Start { address, read } => chip.start(at_ns, address, read),
        Action::Write(byte) => {
            let _ = chip.write(at_ns, byte);
        }
        Action::Read => {
            let _ = chip.read(at_ns);
        }
        Action::Stop => chip.stop(at_ns),
        Action::Advance => chip.advance(at_ns),
        Action::OutputEnable(enabled) => chip.set_output_enable(at_ns, enabled),
        Action::PowerCycle => chip.power_cycle(at_ns),
        Action::Oscillator(hz) => chip.set_oscillator_hz(at_ns, hz),
        Action::ExternalClock(hz) => chip.set_external_clock_hz(at_ns, hz),
    }
}

proptest! {
    #[test]
    fn any_traffic_keeps_registers_inside_their_masks(
        actions in prop::collection::vec((0u64..3_000_000, any_action()), 0..300),
    ) {
        let mut chip = chip();
        let mut at_ns = 0;
        for (step_ns, action) in &actions {
            at_ns += step_ns;
            act(&mut chip, at_ns, action);
            let value = |register| chip.register(register).unwrap();
            prop_assert_eq!(value(0x01) & 0xE0, 0);
            for register in 0x02..=0x05 {
                prop_assert_eq!(value(register) & 0x01, 0);
            }
            for register in (0x07..=0x45).step_by(2) {
                prop_assert_eq!(value(register) & 0xE0, 0);
            }
            for register in 0xFA..=0xFD {
                prop_assert_eq!(value(register), 0);
            }
            prop_assert!(value(0xFE) >= 3);
            prop_assert!(chip.next_change_ns().is_none_or(|next| next > at_ns));
            for channel in 0..16 {
                if let Line::Pwm { on, off } = chip.line(channel) {
                    prop_assert!(on != off && on < COUNTS && off < COUNTS);
                }
            }
        }
    }

    #[test]
    fn any_transactions_on_a_bus_are_survived(
        transactions in prop::collection::vec(
            (
                0u64..10_000_000,
                prop_oneof![Just(0x40), Just(0x41), Just(0x70), Just(0), any::<u8>()],
                prop::collection::vec((any::<bool>(), prop::collection::vec(any::<u8>(), 0..80)), 0..4),
            ),
            0..20,
        ),
    ) {
        let mut bus = I2cBus::new(400_000);
        for address in [0x40, 0x41] {
            bus.attach(Rc::new(RefCell::new(Pca9685::new(address, OSCILLATOR_HZ))));
        }
        let mut at_ns = 0;
        for (step_ns, address, mut operations) in transactions {
            at_ns += step_ns;
            let mut list: Vec<_> = operations
                .iter_mut()
                .map(|(read, bytes)| if *read { Operation::Read(bytes) } else { Operation::Write(bytes) })
                .collect();
            let planned_ns = bus.planned_duration_ns(&list);
            let start_ns = bus.earliest_start_ns(at_ns);
            let (end_ns, all) = match bus.execute(at_ns, address, &mut list) {
                Ok(done) => (done.end_ns, true),
                Err(fault) => (fault.end_ns().unwrap(), false),
            };
            prop_assert!(list.is_empty() || end_ns - start_ns <= planned_ns);
            prop_assert!(list.is_empty() || !all || end_ns - start_ns == planned_ns);
        }
    }

    #[test]
    fn any_times_are_survived(
        actions in prop::collection::vec((any::<u64>(), any_action()), 0..100),
    ) {
        let mut chip = chip();
        for (at_ns, action) in &actions {
            act(&mut chip, *at_ns, action);
        }
    }

    #[test]
    fn being_asked_more_often_changes_nothing(
        actions in prop::collection::vec((0u64..3_000_000, any_action()), 0..200),
    ) {
        let (mut lazy, mut eager) = (chip(), chip());
        let mut at_ns = 0;
        for (step_ns, action) in &actions {
            for part in 1..4 {
                eager.advance(at_ns + step_ns * part / 4);
            }
            at_ns += step_ns;
            act(&mut lazy, at_ns, action);
            act(&mut eager, at_ns, action);
            prop_assert_eq!(lazy.lines(), eager.lines());
            prop_assert_eq!(lazy.next_change_ns(), eager.next_change_ns());
            prop_assert_eq!(lazy.generation(), eager.generation());
        }
    }

    #[test]
    fn a_change_takes_effect_at_the_exact_boundary(
        prescale in 3u8..,
        oscillator_hz in 23_000_000u32..27_000_000,
        at_ns in 1_000_000u64..1_000_000_000_000,
    ) {
        let mut chip = Pca9685::new(0x40, oscillator_hz);
        prop_assert!(write(&mut chip, 0, &[0xFE, prescale]));
        prop_assert!(write(&mut chip, 0, &[0x00, 0x21]));
        set(&mut chip, 1_000_000, 15, 0x1000, 0);
        set(&mut chip, at_ns, 0, 0, 2048);
        let numerator = 4096 * (u128::from(prescale) + 1) * 1_000_000_000;
        let boundary_ns = |k: u128| 1_000_000 + (k * numerator / u128::from(oscillator_hz)) as u64;
        let mut k = u128::from(at_ns - 1_000_000) * u128::from(oscillator_hz) / numerator;
        while boundary_ns(k) <= at_ns {
            k += 1;
        }
        prop_assert_eq!(chip.next_change_ns(), Some(boundary_ns(k)));
        chip.advance(boundary_ns(k) - 1);
        prop_assert_eq!(chip.line(0), Line::Low);
        chip.advance(boundary_ns(k));
        prop_assert_eq!(chip.line(0), Line::Pwm { on: 0, off: 2048 });
    }
}
