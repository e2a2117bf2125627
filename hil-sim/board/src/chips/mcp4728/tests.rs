//! Sequences, tables and limits of the datasheet. Commands are literal, so that a wrong constant in the model fails.

use core::cell::RefCell;
use std::rc::Rc;

use super::*;
use crate::chips::Line;
use crate::chips::pca9685::Pca9685;
use crate::i2c::{Fault, I2cBus};
use embedded_hal::i2c::Operation;
use proptest::prelude::*;

const VDD_V: f64 = 5.0;
const WRITE_NS: u64 = 50_000_000;
/// Setting for 0 V, with the supply as reference.
const ZERO: Setting = Setting(0x0000);
/// Setting for half of the internal reference.
const MID_SCALE: Setting = Setting(0x8800);

fn chip() -> Mcp4728 {
    Mcp4728::new(0x60, VDD_V, [ZERO; 4])
}

/// A chip with LDAC high, so that only UDAC, LDAC and general calls move outputs.
fn held() -> Mcp4728 {
    let mut chip = chip();
    chip.set_ldac(0, true);
    chip
}

/// One write transaction, all at one instant; returns the number of acknowledged bytes.
fn send(chip: &mut Mcp4728, at_ns: u64, address: u8, bytes: &[u8]) -> usize {
    chip.start(at_ns, address, false);
    let acknowledged = bytes.iter().take_while(|&&byte| chip.write(at_ns, byte)).count();
    chip.stop(at_ns);
    acknowledged
}

fn write(chip: &mut Mcp4728, at_ns: u64, bytes: &[u8]) -> bool {
    send(chip, at_ns, 0x60, bytes) == bytes.len()
}

fn general_call(chip: &mut Mcp4728, at_ns: u64, byte: u8) -> bool {
    send(chip, at_ns, 0x00, &[byte]) == 1
}

fn read<const N: usize>(chip: &mut Mcp4728, at_ns: u64) -> [u8; N] {
    chip.start(at_ns, 0x60, true);
    let bytes = core::array::from_fn(|_| chip.read(at_ns));
    chip.stop(at_ns);
    bytes
}

fn volts(chip: &Mcp4728) -> [f64; 4] {
    [0, 1, 2, 3].map(|channel| chip.output_v(channel).volts)
}

fn inputs(chip: &Mcp4728) -> [u16; 4] {
    [0, 1, 2, 3].map(|channel| chip.input(channel).unwrap().0)
}

fn eeprom(chip: &Mcp4728) -> [u16; 4] {
    [0, 1, 2, 3].map(|channel| chip.eeprom(channel).unwrap().0)
}

fn kinds(chip: &Mcp4728) -> Vec<MisuseKind> {
    chip.misuse().first().iter().map(|misuse| misuse.kind).collect()
}

#[test]
fn powers_up_from_the_eeprom() {
    let content = [MID_SCALE, Setting(0x9800), Setting(0x0FFF), Setting(0x2800)];
    let mut chip = Mcp4728::new(0x60, VDD_V, content);
    let expected = [1.024, 2.048, 5.0 * 4095.0 / 4096.0, 0.0];
    assert_eq!(volts(&chip), expected);
    assert_eq!(chip.output_v(3).impedance, Impedance::PulledDown { ohm: 1_000.0 });
    assert_eq!(chip.output_v(4), Output::OPEN);
    // a power cycle restores it, whatever was written and whatever LDAC is
    assert!(write(&mut chip, 0, &[0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00]));
    assert_eq!(volts(&chip), [0.0; 4]);
    chip.set_ldac(1_000, true);
    chip.power_cycle(2_000);
    assert_eq!((volts(&chip), inputs(&chip)), (expected, content.map(|setting| setting.0)));
}

#[test]
fn as_delivered() {
    // table 4-2: internal reference, normal mode, gain 1, code 0
    let mut chip = Mcp4728::new(0x60, VDD_V, [Setting::FACTORY; 4]);
    assert_eq!(chip.output_v(0), Output { volts: 0.0, impedance: Impedance::Normal });
    // the first fast write of a driver that assumes the supply as reference
    assert!(write(&mut chip, 0, &[0x08, 0x00]));
    assert_eq!(volts(&chip), [1.024, 0.0, 0.0, 0.0]);
}

#[test]
fn address_bits() {
    for (given, expected) in [(0x60, 0x60), (0x67, 0x67), (0x02, 0x62)] {
        let chip = Mcp4728::new(given, VDD_V, [ZERO; 4]);
        assert_eq!(chip.address(), expected);
        let answers = |read| (0..=0x7F).filter(|&address| chip.acknowledges(address, read)).collect::<Vec<u8>>();
        assert_eq!((answers(false), answers(true)), (vec![0x00, expected], vec![expected]));
    }
}

#[test]
fn codes_and_voltages() {
    // table 4-6; V = reference * code / 4096 * gain
    for (word, expected_v) in [
        (0x0FFF, VDD_V * 4095.0 / 4096.0),
        (0x0FFE, VDD_V * 4094.0 / 4096.0),
        (0x0002, VDD_V * 2.0 / 4096.0),
        (0x0001, VDD_V / 4096.0),
        (0x0000, 0.0),
        // the gain is ignored with the supply as reference
        (0x1FFF, VDD_V * 4095.0 / 4096.0),
        // 1 LSB is 0.5 mV at gain 1, 1 mV at gain 2
        (0x8FFF, 2.048 - 0.0005),
        (0x8001, 0.0005),
        (0x9FFF, 4.096 - 0.001),
        (0x9001, 0.001),
        (0x9000, 0.0),
    ] {
        let chip = Mcp4728::new(0x60, VDD_V, [Setting(word); 4]);
        let Output { volts, impedance } = chip.output_v(2);
        // exact to rounding; 1 uV still fails for a wrong code, reference or gain
        assert!((volts - expected_v).abs() < 1e-6, "0x{word:04X}: {volts} V");
        assert_eq!(impedance, Impedance::Normal);
    }
    for (word, ohm) in [(0x2FFF, 1_000.0), (0xCFFF, 100_000.0), (0x6FFF, 500_000.0)] {
        let chip = Mcp4728::new(0x60, VDD_V, [Setting(word); 4]);
        assert_eq!(chip.output_v(1), Output { volts: 0.0, impedance: Impedance::PulledDown { ohm } });
    }
}

#[test]
fn outputs_end_at_the_supply() {
    let mut chip = Mcp4728::new(0x60, 5.0, [Setting(0x9FFF), Setting(0x0800), Setting(0x8800), ZERO]);
    let quiet = chip.generation();
    chip.set_vdd_v(0, 3.3);
    assert_eq!(volts(&chip), [3.3, 1.65, 1.024, 0.0]);
    assert_ne!(chip.generation(), quiet);
    for (vdd_v, expected_v) in [(0.0, 0.0), (-1.0, 0.0), (f64::NAN, 0.0)] {
        chip.set_vdd_v(0, vdd_v);
        assert_eq!(volts(&chip), [expected_v; 4]);
    }
}

#[test]
fn fast_write_example_of_the_datasheet() {
    // figure 7-5
    let mut chip = chip();
    assert!(write(&mut chip, 0, &[0x0F, 0xFF, 0x07, 0xFF, 0x03, 0xFF, 0x01, 0xFF]));
    let lsb_v = VDD_V / 4096.0;
    assert_eq!(volts(&chip), [4095.0, 2047.0, 1023.0, 511.0].map(|code| code * lsb_v));
    assert_eq!(eeprom(&chip), [0; 4]);
    assert!(chip.misuse().is_empty());
}

#[test]
fn fast_write_keeps_reference_and_gain_may_stop_early_and_goes_round() {
    let mut chip = Mcp4728::new(0x60, VDD_V, [Setting(0x9123); 4]);
    // PD1 PD0 = 10; in the second channel the command bits are don't care
    assert!(write(&mut chip, 0, &[0x2A, 0xBC, 0xDD, 0xEF]));
    assert_eq!(inputs(&chip), [0xDABC, 0xBDEF, 0x9123, 0x9123]);
    assert!(write(&mut chip, 0, &[0x00, 0x01, 0x00, 0x02, 0x00, 0x03, 0x00, 0x04, 0x00, 0x05]));
    assert_eq!(inputs(&chip), [0x9005, 0x9002, 0x9003, 0x9004]);
    assert!(chip.misuse().is_empty());
}

#[test]
fn multi_write_selects_channels_in_any_order() {
    // figure 5-8
    let mut chip = chip();
    assert!(write(&mut chip, 0, &[0x46, 0x8F, 0xFF, 0xF8, 0x08, 0x00, 0x02, 0x94, 0x56]));
    assert_eq!(inputs(&chip), [0x0800, 0x9456, 0x0000, 0x8FFF]);
    assert_eq!(eeprom(&chip), [0; 4]);
    assert!(chip.ready() && chip.misuse().is_empty());
}

#[test]
fn udac_and_ldac() {
    // table 4-5: LDAC, UDAC, then the outputs that a multi-write of B moves, with A waiting in its input register
    for (ldac_high, udac, expected) in [
        (false, 0, [0x0400, 0x0800]),
        (false, 1, [0x0400, 0x0800]),
        (true, 0, [0x0000, 0x0800]),
        (true, 1, [0x0000, 0x0000]),
    ] {
        let mut chip = held();
        assert!(write(&mut chip, 0, &[0x41, 0x04, 0x00]));
        assert_eq!(volts(&chip), [0.0; 4]);
        chip.set_ldac(1_000, ldac_high);
        assert!(write(&mut chip, 1_000, &[0x42 | udac, 0x08, 0x00]));
        let [a, b, ..] = chip.output;
        assert_eq!([a.0, b.0], expected, "LDAC {ldac_high}, UDAC {udac}");
        // the next falling edge, or a software update, moves them in any case
        let mut updated = chip.clone();
        chip.set_ldac(2_000, true);
        chip.set_ldac(3_000, false);
        assert_eq!(volts(&chip), [1.25, 2.5, 0.0, 0.0]);
        assert!(general_call(&mut updated, 2_000, 0x08));
        assert_eq!(volts(&updated), [1.25, 2.5, 0.0, 0.0]);
        assert!(chip.misuse().is_empty());
    }
}

#[test]
fn fast_write_waits_for_ldac() {
    let mut chip = held();
    let quiet = chip.generation();
    assert!(write(&mut chip, 0, &[0x08, 0x00, 0x04, 0x00]));
    assert_eq!((volts(&chip), chip.generation()), ([0.0; 4], quiet));
    chip.set_ldac(1_000, false);
    assert_eq!(volts(&chip), [2.5, 1.25, 0.0, 0.0]);
    assert_ne!(chip.generation(), quiet);
}

#[test]
fn a_short_ldac_pulse_is_reported() {
    // T_LDAC: 210 ns
    let mut chip = held();
    chip.set_ldac(1_000, false);
    chip.set_ldac(1_210, true);
    assert!(chip.misuse().is_empty());
    chip.set_ldac(2_000, false);
    chip.set_ldac(2_209, true);
    assert_eq!(kinds(&chip), [MisuseKind::LdacPulseTooShort { low_ns: 209, needed_ns: 210 }]);
}

#[test]
fn sequential_write_example_of_the_datasheet() {
    // figure 7-4: VDD/2, VDD less 1 LSB, 2.048 V, 4.095 V
    let mut chip = chip();
    let bytes = [0x50, 0x08, 0x00, 0x0F, 0xFF, 0x98, 0x00, 0x9F, 0xFF];
    assert!(write(&mut chip, 1_000, &bytes));
    assert_eq!(volts(&chip), [2.5, VDD_V * 4095.0 / 4096.0, 2.048, 4.095]);
    assert_eq!((eeprom(&chip), chip.ready(), chip.next_change_ns()), ([0; 4], false, Some(1_000 + WRITE_NS)));
    chip.advance(1_000 + WRITE_NS - 1);
    assert_eq!((eeprom(&chip), chip.ready()), ([0; 4], false));
    let busy = chip.generation();
    chip.advance(1_000 + WRITE_NS);
    assert_eq!((eeprom(&chip), chip.ready()), ([0x0800, 0x0FFF, 0x9800, 0x9FFF], true));
    assert_eq!(chip.next_change_ns(), None);
    assert_ne!(chip.generation(), busy);
    chip.power_cycle(1_000_000_000);
    assert_eq!(volts(&chip)[3], 4.095);
    assert!(chip.misuse().is_empty());
}

#[test]
fn sequential_write_from_a_channel_on() {
    let mut chip = Mcp4728::new(0x60, VDD_V, [Setting(0x0111); 4]);
    chip.set_eeprom_write_ns(EEPROM_WRITE_TYPICAL_NS);
    assert!(write(&mut chip, 0, &[0x54, 0x02, 0x22, 0x03, 0x33]));
    assert_eq!(chip.next_change_ns(), Some(25_000_000));
    chip.advance(25_000_000);
    assert_eq!(eeprom(&chip), [0x0111, 0x0111, 0x0222, 0x0333]);
    // ended before channel D: only input registers change
    assert!(write(&mut chip, 30_000_000, &[0x50, 0x04, 0x44, 0x05, 0x55]));
    assert_eq!((inputs(&chip), chip.ready()), ([0x0444, 0x0555, 0x0222, 0x0333], true));
    assert_eq!(kinds(&chip), [MisuseKind::CommandIncomplete { command: 0x50 }]);
}

#[test]
fn single_write_programs_one_channel() {
    let mut chip = held();
    // B with UDAC = 1; input registers of other channels are not programmed
    assert!(write(&mut chip, 0, &[0x40, 0x01, 0x23]));
    assert!(write(&mut chip, 0, &[0x5B, 0x0A, 0xBC]));
    assert_eq!(volts(&chip)[1], 0.0);
    chip.advance(WRITE_NS);
    assert_eq!((inputs(&chip), eeprom(&chip)), ([0x0123, 0x0ABC, 0, 0], [0, 0x0ABC, 0, 0]));
    assert!(chip.misuse().is_empty());
}

#[test]
fn nothing_is_executed_during_an_eeprom_write_and_it_can_be_polled() {
    // table 5-1, note 3
    let mut chip = chip();
    assert!(write(&mut chip, 0, &[0x58, 0x08, 0x00]));
    for (at_ns, command) in [(1, 0x00), (2, 0x40), (3, 0x5A), (4, 0x80), (5, 0xA0), (6, 0xC0), (7, 0x61), (8, 0xE0)] {
        assert!(write(&mut chip, at_ns, &[command, 0x01, 0x23, 0x04]), "0x{command:02X}");
        let expected = MisuseKind::EepromBusy { command, ready_in_ns: WRITE_NS - at_ns };
        assert_eq!(kinds(&chip), [expected]);
        chip.misuse_mut().clear();
    }
    for command in [0x06, 0x08, 0x09] {
        assert!(general_call(&mut chip, 10, command));
        assert_eq!(kinds(&chip), [MisuseKind::EepromBusy { command, ready_in_ns: WRITE_NS - 10 }]);
        chip.misuse_mut().clear();
    }
    assert_eq!((inputs(&chip), volts(&chip)), ([0x0800, 0, 0, 0], [2.5, 0.0, 0.0, 0.0]));
    assert_eq!(read(&mut chip, WRITE_NS - 1), [0x40, 0x08, 0x00, 0x40, 0x00, 0x00]);
    assert_eq!(read(&mut chip, WRITE_NS), [0xC0, 0x08, 0x00, 0xC0, 0x08, 0x00]);
    // later bytes of the same transfer are not executed either
    let mut chip = chip.clone();
    assert!(write(&mut chip, 2 * WRITE_NS, &[0x58, 0x01, 0x00, 0x58, 0x02, 0x00]));
    assert_eq!(inputs(&chip)[0], 0x0100);
    assert_eq!(kinds(&chip), [MisuseKind::EepromBusy { command: 0x58, ready_in_ns: WRITE_NS }]);
}

#[test]
fn a_supply_lost_during_an_eeprom_write_is_reported() {
    let mut chip = chip();
    assert!(write(&mut chip, 0, &[0x58, 0x08, 0x00]));
    chip.power_cycle(WRITE_NS - 100);
    assert_eq!(kinds(&chip), [MisuseKind::EepromWriteInterrupted { ready_in_ns: 100 }]);
    chip.advance(2 * WRITE_NS);
    assert_eq!((eeprom(&chip), volts(&chip)), ([0; 4], [0.0; 4]));
}

#[test]
fn reference_power_down_and_gain_of_all_channels() {
    // figures 5-12 to 5-14 and table 5-1, note 4: independent of LDAC; EEPROM and codes stay
    let mut chip = Mcp4728::new(0x60, VDD_V, [Setting(0x0800); 4]);
    chip.set_ldac(0, true);
    assert!(write(&mut chip, 0, &[0x8C]));
    assert_eq!(inputs(&chip), [0x8800, 0x8800, 0x0800, 0x0800]);
    assert_eq!(volts(&chip), [1.024, 1.024, 2.5, 2.5]);
    assert!(write(&mut chip, 0, &[0xC5]));
    assert_eq!(inputs(&chip), [0x8800, 0x9800, 0x0800, 0x1800]);
    assert_eq!(volts(&chip), [1.024, 2.048, 2.5, 2.5]);
    // PD: A 01, B 10, C 11, D 00
    assert!(write(&mut chip, 0, &[0xA6, 0xCF]));
    assert_eq!(inputs(&chip), [0xA800, 0xD800, 0x6800, 0x1800]);
    let ohms = [0, 1, 2, 3].map(|channel| chip.output_v(channel).impedance);
    let down = |ohm| Impedance::PulledDown { ohm };
    assert_eq!(ohms, [down(1_000.0), down(100_000.0), down(500_000.0), Impedance::Normal]);
    // 5.4.2
    assert!(general_call(&mut chip, 0, 0x09));
    assert_eq!(volts(&chip), [1.024, 2.048, 2.5, 2.5]);
    // a code that waits for LDAC keeps waiting
    assert!(write(&mut chip, 0, &[0x00, 0x00]));
    assert!(write(&mut chip, 0, &[0x80]));
    assert_eq!(volts(&chip), [2.5, 2.5, 2.5, 2.5]);
    assert_eq!(eeprom(&chip), [0x0800; 4]);
    assert!(chip.misuse().is_empty());
}

#[test]
fn general_call_reset_reloads_the_eeprom_whatever_ldac_is() {
    // 5.4.1
    let mut chip = Mcp4728::new(0x60, VDD_V, [MID_SCALE; 4]);
    assert!(write(&mut chip, 0, &[0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00]));
    chip.set_ldac(1_000, true);
    assert_eq!(volts(&chip), [0.0; 4]);
    assert!(general_call(&mut chip, 2_000, 0x06));
    assert_eq!((volts(&chip), inputs(&chip)), ([1.024; 4], [0x8800; 4]));
}

#[test]
fn one_software_reset_reaches_the_pwm_chip_and_the_dac() {
    let dac = Rc::new(RefCell::new(Mcp4728::new(0x60, VDD_V, [MID_SCALE; 4])));
    let pwm = Rc::new(RefCell::new(Pca9685::new(0x40, 25_000_000)));
    let mut bus = I2cBus::new(400_000);
    bus.attach(pwm.clone());
    bus.attach(dac.clone());
    bus.execute(0, 0x40, &mut [Operation::Write(&[0x00, 0x21])]).unwrap();
    bus.execute(1_000_000, 0x40, &mut [Operation::Write(&[0x06, 0x00, 0x10, 0x00, 0x00])]).unwrap();
    bus.execute(0, 0x60, &mut [Operation::Write(&[0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00])]).unwrap();
    assert_eq!((pwm.borrow().line(0), volts(&dac.borrow())), (Line::High, [0.0; 4]));
    // meant for the PWM chip, it also changes the outputs of the DAC
    bus.execute(0, 0x00, &mut [Operation::Write(&[0x06])]).unwrap();
    assert_eq!((pwm.borrow().line(0), volts(&dac.borrow())), (Line::Low, [1.024; 4]));
    // only the DAC acknowledges software update and wake-up
    bus.execute(0, 0x00, &mut [Operation::Write(&[0x08])]).unwrap();
    bus.execute(0, 0x00, &mut [Operation::Write(&[0x09])]).unwrap();
    let unknown = bus.execute(0, 0x00, &mut [Operation::Write(&[0x04])]);
    assert!(matches!(unknown, Err(Fault::DataNack { byte: 0, .. })));
    assert!(dac.borrow().misuse().is_empty() && pwm.borrow().misuse().is_empty());
}

#[test]
fn read_back_is_24_bytes_that_repeat() {
    // figure 5-15
    let mut chip = Mcp4728::new(0x65, VDD_V, [0x0111, 0x8222, 0x7333, 0xF444].map(Setting));
    assert!(write(&mut chip, 0, &[0x0A, 0xAA]));
    let expected = [
        [0xC5, 0x0A, 0xAA, 0xC5, 0x01, 0x11],
        [0xD5, 0x82, 0x22, 0xD5, 0x82, 0x22],
        [0xE5, 0x73, 0x33, 0xE5, 0x73, 0x33],
        [0xF5, 0xF4, 0x44, 0xF5, 0xF4, 0x44],
    ];
    let bytes: [u8; 48] = read(&mut chip, 0);
    assert_eq!(bytes[..24], expected.concat());
    assert_eq!(bytes[24..], expected.concat());
}

#[test]
fn incomplete_commands_are_dropped_and_reported() {
    for bytes in [&[0x0F][..], &[0x00, 0x11, 0x02], &[0x40], &[0x40, 0x0F], &[0x58, 0x0F], &[0x50, 0x0F], &[0xA0]] {
        let mut chip = chip();
        assert!(write(&mut chip, 0, bytes));
        assert_eq!(kinds(&chip), [MisuseKind::CommandIncomplete { command: bytes[0] }], "{bytes:02X?}");
        assert_eq!(inputs(&chip)[1..], [0; 3]);
        assert!(chip.ready());
        // also at a repeated START
        let mut chip = Mcp4728::new(0x60, VDD_V, [ZERO; 4]);
        chip.start(0, 0x60, false);
        for &byte in bytes {
            assert!(chip.write(0, byte));
        }
        chip.start(0, 0x60, true);
        assert_eq!(chip.misuse().total(), 1);
    }
    // a probe without data is no incomplete command
    let mut chip = chip();
    assert!(write(&mut chip, 0, &[]));
    assert!(chip.misuse().is_empty());
}

#[test]
fn what_the_tables_do_not_have_is_refused_and_reported() {
    for (bytes, acknowledged, byte) in
        [(&[0x48, 0x0F, 0xFF][..], 0, 0x48), (&[0xE0, 0x00], 0, 0xE0), (&[0x80, 0x55, 0x00], 1, 0x55)]
    {
        let mut chip = chip();
        assert_eq!(send(&mut chip, 0, 0x60, bytes), acknowledged);
        assert_eq!(kinds(&chip), [MisuseKind::UnexpectedByte { byte }]);
        assert_eq!(inputs(&chip), [0; 4]);
    }
}

#[test]
fn address_commands_answer_as_without_the_ldac_edge() {
    // figure 5-11, note 2c; 5.4.4
    let mut chip = chip();
    assert_eq!(send(&mut chip, 0, 0x60, &[0x61, 0x66, 0x67]), 1);
    assert_eq!(kinds(&chip), [MisuseKind::AddressCommand { command: 0x61 }]);
    assert_eq!(chip.address(), 0x60);
    chip.misuse_mut().clear();
    chip.start(0, 0x00, false);
    assert!(chip.write(0, 0x0C));
    assert!(!chip.acknowledges(0x60, true));
    chip.stop(0);
    assert!(chip.acknowledges(0x60, true));
    assert_eq!(kinds(&chip), [MisuseKind::AddressCommand { command: 0x0C }]);
}

/// Random action of a bus and a board, sensible or not.
#[derive(Clone, Debug)]
enum Action {
    Start { address: u8, read: bool },
    Write(u8),
    Read,
    Stop,
    Advance,
    Ldac(bool),
    Supply(f64),
    WriteTime(u64),
    PowerCycle,
}

fn any_action() -> impl Strategy<Value = Action> {
    let address = prop_oneof![3 => Just(0x60), 1 => Just(0)];
    prop_oneof![
        4 => (address, any::<bool>()).prop_map(|(address, read)| Action::Start { address, read }),
        12 => any::<u8>().prop_map(Action::Write),
        // with a useful share of valid general calls
        2 => prop_oneof![Just(0x06), Just(0x08), Just(0x09), Just(0x0C)].prop_map(Action::Write),
        3 => Just(Action::Read),
        3 => Just(Action::Stop),
        3 => Just(Action::Advance),
        2 => any::<bool>().prop_map(Action::Ldac),
        1 => any::<f64>().prop_map(Action::Supply),
        1 => any::<u64>().prop_map(Action::WriteTime),
        1 => Just(Action::PowerCycle),
    ]
}

fn act(chip: &mut Mcp4728, at_ns: u64, action: &Action) {
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
        Action::Ldac(high) => chip.set_ldac(at_ns, high),
        Action::Supply(vdd_v) => chip.set_vdd_v(at_ns, vdd_v),
        Action::WriteTime(duration_ns) => {
            chip.advance(at_ns);
            chip.set_eeprom_write_ns(duration_ns);
        }
        Action::PowerCycle => chip.power_cycle(at_ns),
    }
}

proptest! {
    #[test]
    fn any_traffic_at_any_time_is_survived(actions in prop::collection::vec((any::<u64>(), any_action()), 0..200)) {
        let mut chip = chip();
        for (at_ns, action) in &actions {
            act(&mut chip, *at_ns, action);
        }
    }

    #[test]
    fn any_traffic_keeps_outputs_within_the_supply_and_tells_of_every_change(
        actions in prop::collection::vec((0u64..30_000_000, any_action()), 0..300),
    ) {
        let mut chip = chip();
        let mut at_ns = 0;
        for (step_ns, action) in &actions {
            at_ns += step_ns;
            let before = (chip.generation(), chip.outputs, chip.ready());
            act(&mut chip, at_ns, action);
            prop_assert!(before.0 != chip.generation() || (before.1, before.2) == (chip.outputs, chip.ready()));
            prop_assert!(chip.next_change_ns().is_none_or(|next| next >= at_ns));
            for channel in 0..4 {
                let volts = chip.output_v(channel).volts;
                prop_assert!((0.0..=chip.vdd_v).contains(&volts));
            }
            if !chip.ldac_high {
                prop_assert_eq!(chip.input, chip.output);
            }
        }
    }

    #[test]
    fn being_asked_more_often_changes_nothing(
        actions in prop::collection::vec((0u64..30_000_000, any_action()), 0..200),
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
            lazy.advance(at_ns);
            eager.advance(at_ns);
            prop_assert_eq!(lazy.outputs, eager.outputs);
            prop_assert_eq!(lazy.eeprom, eager.eeprom);
            prop_assert_eq!(lazy.next_change_ns(), eager.next_change_ns());
            prop_assert_eq!(lazy.generation(), eager.generation());
            prop_assert_eq!(lazy.misuse(), eager.misuse());
        }
    }

    #[test]
    fn any_transactions_on_a_bus_are_survived(
        transactions in prop::collection::vec(
            (
                0u64..30_000_000,
                prop_oneof![Just(0x60), Just(0x40), Just(0x20), Just(0), any::<u8>()],
                prop::collection::vec((any::<bool>(), prop::collection::vec(any::<u8>(), 0..40)), 0..4),
            ),
            0..20,
        ),
    ) {
        let mut bus = I2cBus::new(400_000);
        bus.attach(Rc::new(RefCell::new(chip())));
        bus.attach(Rc::new(RefCell::new(Pca9685::new(0x40, 25_000_000))));
        bus.attach(Rc::new(RefCell::new(crate::chips::mcp23017::Mcp23017::new(0x20))));
        let mut at_ns = 0;
        for (step_ns, address, mut operations) in transactions {
            at_ns += step_ns;
            let mut list: Vec<_> = operations
                .iter_mut()
                .map(|(read, bytes)| if *read { Operation::Read(bytes) } else { Operation::Write(bytes) })
                .collect();
            let _ = bus.execute(at_ns, address, &mut list);
        }
    }
}
