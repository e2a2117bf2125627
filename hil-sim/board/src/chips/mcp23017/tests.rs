//! Tables and sequences of the datasheet. Register addresses are literal, so that a wrong constant in the model fails.

use core::cell::RefCell;
use std::rc::Rc;

use super::*;
use crate::chips::pca9685::Pca9685;
use crate::i2c::{Fault, I2cBus};
use embedded_hal::i2c::Operation;
use proptest::prelude::*;

use PinState::{Driven, Floating, PulledUp};
use Port::{A, B};

fn chip() -> Mcp23017 {
    Mcp23017::new(0x20)
}

/// One write transaction; true if every byte was acknowledged.
fn write(chip: &mut Mcp23017, bytes: &[u8]) -> bool {
    chip.start(0, 0x20, false);
    let acknowledged = bytes.iter().all(|&byte| chip.write(0, byte));
    chip.stop(0);
    acknowledged
}

fn read<const N: usize>(chip: &mut Mcp23017, register: u8) -> [u8; N] {
    chip.start(0, 0x20, false);
    assert!(chip.write(0, register));
    chip.start(0, 0x20, true);
    let bytes = core::array::from_fn(|_| chip.read(0));
    chip.stop(0);
    bytes
}

fn kinds(chip: &Mcp23017) -> Vec<MisuseKind> {
    chip.misuse().first().iter().map(|misuse| misuse.kind).collect()
}

/// States of the pins of a port, 0 to 7.
fn pins(chip: &Mcp23017, port: Port) -> [PinState; 8] {
    core::array::from_fn(|bit| chip.pin_level(port, bit as u8))
}

fn interrupts(chip: &Mcp23017) -> [bool; 2] {
    [chip.interrupt(A), chip.interrupt(B)]
}

#[test]
fn power_on_values() {
    // table 3-5: IODIRA and IODIRB all ones, the rest 0
    let mut chip = chip();
    for register in 0..=0x15 {
        let expected = if register < 2 { 0xFF } else { 0x00 };
        assert_eq!(chip.register(register), Some(expected), "register 0x{register:02X}");
        assert_eq!(read(&mut chip, register), [expected], "register 0x{register:02X}");
    }
    assert_eq!((pins(&chip, A), pins(&chip, B)), ([Floating; 8], [Floating; 8]));
    assert_eq!(chip.interrupt_pin(A), Driven(true));
}

#[test]
fn three_pins_give_the_address_and_the_general_call_is_not_answered() {
    for (given, expected) in [(0x20, 0x20), (0x25, 0x25), (0x27, 0x27), (0x02, 0x22)] {
        let chip = Mcp23017::new(given);
        assert_eq!(chip.address(), expected);
        for read in [false, true] {
            let answers: Vec<u8> = (0..=0x7F).filter(|&address| chip.acknowledges(address, read)).collect();
            assert_eq!(answers, [expected]);
        }
    }
}

#[test]
fn the_two_maps() {
    // table 3-1: address with BANK = 1, address with BANK = 0; and a value unique to the register
    let writable_a = [(0x00, 0x00), (0x01, 0x02), (0x03, 0x06), (0x04, 0x08), (0x06, 0x0C), (0x0A, 0x14)];
    let mut chip = chip();
    for (index, (banked, paired)) in writable_a.into_iter().enumerate() {
        let value = 0x51 + index as u8;
        assert!(write(&mut chip, &[paired, value, value ^ 0xFF]));
        assert!(write(&mut chip, &[0x0A, 0x80]));
        assert_eq!(read(&mut chip, banked), [value], "0x{banked:02X}");
        assert_eq!(read(&mut chip, banked | 0x10), [value ^ 0xFF], "0x{:02X}", banked | 0x10);
        assert!(write(&mut chip, &[0x05, 0x00]));
        assert_eq!(read(&mut chip, paired), [value, value ^ 0xFF], "0x{paired:02X}");
    }
    assert!(chip.misuse().is_empty());
    // GPINTEN alone, because the read-only registers follow from it: A0 differs from DEFVAL
    let mut chip = Mcp23017::new(0x20);
    assert!(write(&mut chip, &[0x00, 0x7F, 0x7F]));
    assert!(write(&mut chip, &[0x06, 0x01]));
    assert!(write(&mut chip, &[0x08, 0x01]));
    assert!(write(&mut chip, &[0x04, 0x01]));
    chip.set_external(A, 3, Some(true));
    assert!(write(&mut chip, &[0x0B, 0x80]));
    let values = [0x02, 0x07, 0x08, 0x09].map(|register| chip.register(register));
    assert_eq!(values, [Some(0x01), Some(0x01), Some(0x00), Some(0x08)]);
    assert!([0x12, 0x17, 0x18, 0x19].iter().all(|&register| chip.register(register) == Some(0)));
}

#[test]
fn one_configuration_register_at_two_addresses() {
    for (bank, addresses) in [(0x00, [0x0A, 0x0B]), (0x80, [0x05, 0x15])] {
        for address in addresses {
            let mut chip = chip();
            assert!(write(&mut chip, &[0x0A, bank]));
            // bit 0 is not implemented
            assert!(write(&mut chip, &[address, bank | 0x7F]));
            for address in addresses {
                assert_eq!(chip.register(address), Some(bank | 0x7E));
            }
        }
    }
}

#[test]
fn sequential_mode_rolls_over_to_zero() {
    let mut chip = chip();
    assert!(write(&mut chip, &[0x14, 0xA5, 0x5A, 0x0F, 0xF0]));
    assert_eq!(read(&mut chip, 0x14), [0xA5, 0x5A, 0x0F, 0xF0, 0x00]);
    // the pointer stays for the next transfer
    chip.start(0, 0x20, true);
    assert_eq!(chip.read(0), 0x00);
    assert_eq!(chip.pointer, 0x04);
    // BANK = 1
    assert!(write(&mut chip, &[0x0A, 0x80]));
    assert_eq!(read(&mut chip, 0x1A), [0x5A, 0x0F]);
    assert!(chip.misuse().is_empty());
}

#[test]
fn byte_mode_toggles_within_the_pair_or_stays() {
    // 3.2.1: from GPIOA or GPIOB
    let mut chip = chip();
    assert!(write(&mut chip, &[0x0A, 0x20]));
    assert!(write(&mut chip, &[0x00, 0x00, 0x00]));
    assert!(write(&mut chip, &[0x12, 0x01, 0x02, 0x03, 0x04]));
    assert_eq!(read(&mut chip, 0x14), [0x03, 0x04, 0x03, 0x04]);
    assert_eq!(read(&mut chip, 0x13), [0x04, 0x03, 0x04]);
    assert!(write(&mut chip, &[0x0A, 0xA0]));
    assert!(write(&mut chip, &[0x1A, 0x05, 0x06, 0x07]));
    assert_eq!(read(&mut chip, 0x1A), [0x07, 0x07]);
    assert_eq!(read(&mut chip, 0x0A), [0x03, 0x03]);
}

#[test]
fn a_driver_that_forgets_bank_writes_elsewhere() {
    let mut chip = chip();
    assert!(write(&mut chip, &[0x0A, 0x80]));
    assert!(write(&mut chip, &[0x0A, 0x00]));
    assert_eq!((chip.register(0x0A), chip.register(0x05)), (Some(0x00), Some(0x80)));
    // 3.5.6: after the byte that sets BANK the pointer is at 0Bh, where no register is
    assert!(chip.misuse().is_empty());
    let mut sequence = Mcp23017::new(0x20);
    assert!(write(&mut sequence, &[0x0A, 0x80, 0x00]));
    assert_eq!(kinds(&sequence), [MisuseKind::UnimplementedRegister { register: 0x0B }]);
    // a write that returns to BANK = 0 and is harmless in either map: 05h is IOCON, or GPINTENB
    assert!(write(&mut chip, &[0x05, 0x00]));
    assert_eq!(chip.register(0x0A), Some(0x00));
    assert!(write(&mut chip, &[0x05, 0x00]));
    assert!(chip.misuse().is_empty());
}

#[test]
fn addresses_without_a_register_are_reported() {
    let mut chip = chip();
    assert!(write(&mut chip, &[0x16, 0xFF]));
    assert_eq!(read(&mut chip, 0xFF), [0x00, 0xFF]);
    let unimplemented = |register| MisuseKind::UnimplementedRegister { register };
    assert_eq!(kinds(&chip), [unimplemented(0x16), unimplemented(0xFF)]);
    chip.misuse_mut().clear();
    assert!(write(&mut chip, &[0x0A, 0x80]));
    for register in 0..=0xFF {
        let exists = register & 0x0F <= 0x0A && register < 0x20;
        assert_eq!(chip.register(register).is_some(), exists, "0x{register:02X}");
    }
    let [.., iodir_b]: [u8; 7] = read(&mut chip, 0x0A);
    assert_eq!(iodir_b, 0xFF);
    assert_eq!(kinds(&chip), [0x0B, 0x0C, 0x0D, 0x0E, 0x0F].map(unimplemented));
}

#[test]
fn read_only_registers_are_not_written() {
    let mut chip = chip();
    assert!(write(&mut chip, &[0x0E, 1, 2, 3, 4]));
    assert_eq!(kinds(&chip), [0x0E, 0x0F, 0x10, 0x11].map(|register| MisuseKind::ReadOnlyRegister { register }));
    assert_eq!(read(&mut chip, 0x0E), [0; 4]);
}

#[test]
fn outputs_follow_the_latch_and_gpio_the_pins() {
    let mut chip = chip();
    let quiet = chip.generation();
    // latches first, then direction, to avoid a glitch
    assert!(write(&mut chip, &[0x14, 0x05, 0xF0]));
    assert_eq!(chip.generation(), quiet);
    assert!(write(&mut chip, &[0x00, 0xF0, 0x00]));
    assert_ne!(chip.generation(), quiet);
    let expected = [Driven(true), Driven(false), Driven(true), Driven(false), Floating, Floating, Floating, Floating];
    assert_eq!(pins(&chip, A), expected);
    assert_eq!(pins(&chip, B)[3..5], [Driven(false), Driven(true)]);
    assert_eq!(chip.pin_level(A, 8), Floating);
    // inputs as driven by the board, outputs as driven by the chip
    for bit in 0..=8 {
        chip.set_external(A, bit, Some(bit != 5));
    }
    assert_eq!(chip.register(0x12), Some(0xD5));
    chip.set_external(A, 4, None);
    assert_eq!(chip.register(0x12), Some(0xC5));
    // a write to GPIO is one to OLAT (3.5.10), also for inputs
    assert!(write(&mut chip, &[0x12, 0x3A]));
    assert_eq!((chip.register(0x14), chip.register(0x12)), (Some(0x3A), Some(0xCA)));
}

#[test]
fn pull_ups_of_inputs() {
    let mut chip = chip();
    assert!(write(&mut chip, &[0x0C, 0x0F]));
    assert!(write(&mut chip, &[0x00, 0xF7]));
    assert_eq!(pins(&chip, A)[1..5], [PulledUp, PulledUp, Driven(false), Floating]);
    chip.set_external(A, 1, Some(false));
    chip.set_external(A, 5, Some(true));
    assert_eq!(chip.register(0x12), Some(0x25));
}

#[test]
fn polarity_inverts_what_gpio_reads_as_only() {
    let mut chip = chip();
    assert!(write(&mut chip, &[0x00, 0x0F]));
    assert!(write(&mut chip, &[0x14, 0xA0]));
    assert!(write(&mut chip, &[0x02, 0xF1]));
    chip.set_external(A, 0, Some(true));
    chip.set_external(A, 1, Some(true));
    assert_eq!((chip.register(0x12), chip.register(0x14)), (Some(0x52), Some(0xA0)));
    assert_eq!((chip.pin_level(A, 7), chip.pin_level(A, 4)), (Driven(true), Driven(false)));
}

#[test]
fn pin_7_as_an_input_is_reported_when_read() {
    let mut chip = chip();
    assert_eq!(read(&mut chip, 0x12), [0, 0]);
    let pin7 = |port| MisuseKind::Pin7ReadAsInput { port };
    assert_eq!(kinds(&chip), [pin7('A'), pin7('B')]);
    chip.misuse_mut().clear();
    assert!(write(&mut chip, &[0x00, 0x7F, 0x7F]));
    assert_eq!(read(&mut chip, 0x12), [0, 0]);
    assert!(chip.misuse().is_empty());
}

/// A chip with inputs 0 to 6 on both ports, and `enabled` of port A with interrupt on change.
fn watching(enabled: u8) -> Mcp23017 {
    let mut chip = chip();
    assert!(write(&mut chip, &[0x00, 0x7F, 0x7F]));
    assert!(write(&mut chip, &[0x04, enabled]));
    chip
}

#[test]
fn interrupt_on_pin_change() {
    // 3.6.2, 3.6.4, 3.6.5 and figure 3-8
    let mut chip = watching(0x03);
    chip.set_external(A, 2, Some(true));
    assert_eq!(interrupts(&chip), [false, false]);
    chip.set_external(A, 0, Some(true));
    assert_eq!(interrupts(&chip), [true, false]);
    assert_eq!(chip.interrupt_pin(A), Driven(false));
    assert_eq!((chip.register(0x0E), chip.register(0x10)), (Some(0x01), Some(0x05)));
    // the first cause stays; writes and other reads do not clear it
    chip.set_external(A, 1, Some(true));
    assert!(write(&mut chip, &[0x12, 0x00]));
    assert_eq!(read(&mut chip, 0x0E), [0x01]);
    assert_eq!(read(&mut chip, 0x13), [0x00]);
    assert_eq!(interrupts(&chip), [true, false]);
    // a change since then is the next cause
    assert_eq!(read(&mut chip, 0x10), [0x05]);
    assert_eq!(interrupts(&chip), [true, false]);
    assert_eq!((chip.register(0x0E), chip.register(0x10)), (Some(0x02), Some(0x07)));
    assert_eq!(read(&mut chip, 0x12), [0x07]);
    assert_eq!((interrupts(&chip), chip.register(0x0E)), ([false, false], Some(0x00)));
    // new reference level after the read
    chip.set_external(A, 0, Some(false));
    assert_eq!((chip.register(0x0E), chip.register(0x10)), (Some(0x01), Some(0x06)));
    assert_eq!(read(&mut chip, 0x12), [0x06]);
    assert_eq!(interrupts(&chip), [false, false]);
    // INTCAP keeps the last capture
    assert_eq!(chip.register(0x10), Some(0x06));
}

#[test]
fn a_pulse_is_two_interrupts_and_the_first_capture_can_be_lost() {
    // note below figure 3-9
    let mut chip = watching(0x01);
    chip.set_external(A, 0, Some(true));
    chip.set_external(A, 0, Some(false));
    assert_eq!((interrupts(&chip), chip.register(0x10)), ([true, false], Some(0x01)));
    assert_eq!(read(&mut chip, 0x12), [0x00]);
    assert_eq!((interrupts(&chip), chip.register(0x10)), ([true, false], Some(0x00)));
    assert_eq!(read(&mut chip, 0x10), [0x00]);
    assert_eq!(interrupts(&chip), [false, false]);
    // a pin enabled later is compared with its level at that time
    chip.set_external(A, 0, Some(true));
    chip.set_external(A, 1, Some(true));
    assert!(write(&mut chip, &[0x04, 0x03]));
    assert_eq!(read(&mut chip, 0x12), [0x03]);
    assert_eq!(interrupts(&chip), [false, false]);
}

#[test]
fn interrupt_on_difference_from_defval() {
    // figure 3-9: INT clears only if the condition does not exist
    let mut chip = watching(0x00);
    chip.set_external(A, 2, Some(true));
    assert!(write(&mut chip, &[0x06, 0x04]));
    assert!(write(&mut chip, &[0x08, 0x04]));
    assert!(write(&mut chip, &[0x04, 0x04]));
    assert_eq!(interrupts(&chip), [false, false]);
    chip.set_external(A, 2, Some(false));
    assert_eq!((interrupts(&chip), chip.register(0x0E)), ([true, false], Some(0x04)));
    chip.set_external(A, 1, Some(true));
    assert_eq!(read(&mut chip, 0x10), [0x00]);
    assert_eq!((interrupts(&chip), chip.register(0x10)), ([true, false], Some(0x02)));
    chip.set_external(A, 2, Some(true));
    assert_eq!(interrupts(&chip), [true, false]);
    assert_eq!(read(&mut chip, 0x12), [0x06]);
    assert_eq!(interrupts(&chip), [false, false]);
}

#[test]
fn outputs_cause_no_interrupt() {
    let mut chip = watching(0x00);
    assert!(write(&mut chip, &[0x00, 0x00]));
    assert!(write(&mut chip, &[0x04, 0xFF]));
    assert!(write(&mut chip, &[0x14, 0xFF]));
    assert_eq!(interrupts(&chip), [false, false]);
}

#[test]
fn interrupt_pins() {
    // 3.6.1 and register 3-5: IOCON, then the pins of A and B without and with an interrupt on A
    for (iocon, idle, active) in [
        (0x00, [Driven(true), Driven(true)], [Driven(false), Driven(true)]),
        (0x02, [Driven(false), Driven(false)], [Driven(true), Driven(false)]),
        (0x04, [Floating, Floating], [Driven(false), Floating]),
        (0x06, [Floating, Floating], [Driven(false), Floating]),
        (0x40, [Driven(true), Driven(true)], [Driven(false), Driven(false)]),
        (0x46, [Floating, Floating], [Driven(false), Driven(false)]),
    ] {
        let mut chip = watching(0x01);
        assert!(write(&mut chip, &[0x0A, iocon]));
        let pins = |chip: &Mcp23017| [chip.interrupt_pin(A), chip.interrupt_pin(B)];
        assert_eq!(pins(&chip), idle, "IOCON 0x{iocon:02X}");
        let quiet = chip.generation();
        chip.set_external(A, 0, Some(true));
        assert_eq!(pins(&chip), active, "IOCON 0x{iocon:02X}");
        assert_ne!(chip.generation(), quiet);
        // only a read of the causing port clears the interrupt
        let _: [u8; 1] = read(&mut chip, 0x13);
        assert_eq!(pins(&chip), active, "IOCON 0x{iocon:02X}");
        let _: [u8; 1] = read(&mut chip, 0x12);
        assert_eq!(pins(&chip), idle, "IOCON 0x{iocon:02X}");
    }
}

#[test]
fn reset_pin_and_power_cycle() {
    let configured = || {
        let mut chip = watching(0x01);
        assert!(write(&mut chip, &[0x0A, 0x42]));
        assert!(write(&mut chip, &[0x14, 0xFF, 0xFF]));
        assert!(write(&mut chip, &[0x00, 0x0F, 0x00]));
        chip.set_external(A, 0, Some(true));
        assert!(chip.interrupt(B));
        chip
    };
    let after = |chip: &Mcp23017| {
        assert_eq!((pins(chip, A), pins(chip, B)), ([Floating; 8], [Floating; 8]));
        assert_eq!(interrupts(chip), [false, false]);
        // the levels set by the board remain
        let expected = |register| Some(if register < 2 { 0xFF } else { u8::from(register == 0x12) });
        assert!((0..=0x15).all(|register| chip.register(register) == expected(register)));
    };
    let mut chip = configured();
    chip.power_cycle(1_000);
    after(&chip);
    let mut chip = configured();
    chip.start(0, 0x20, false);
    chip.set_reset(1_000, true);
    after(&chip);
    assert!(!chip.acknowledges(0x20, false) && !chip.write(1_000, 0x00));
    assert_eq!(chip.read(1_000), 0xFF);
    chip.set_reset(2_000, false);
    assert!(write(&mut chip, &[0x00, 0x00]));
    assert_eq!(chip.register(0x00), Some(0x00));
}

#[test]
fn a_relay_on_the_bus_and_a_software_reset_of_others_that_leaves_it_alone() {
    let (relays, pwm) = (Rc::new(RefCell::new(chip())), Rc::new(RefCell::new(Pca9685::new(0x40, 25_000_000))));
    let mut bus = I2cBus::new(400_000);
    bus.attach(relays.clone());
    bus.attach(pwm);
    bus.execute(0, 0x20, &mut [Operation::Write(&[0x14, 0x00, 0x01])]).unwrap();
    bus.execute(0, 0x20, &mut [Operation::Write(&[0x00, 0x00, 0x00])]).unwrap();
    bus.execute(0, 0x00, &mut [Operation::Write(&[0x06])]).unwrap();
    assert_eq!(relays.borrow().pin_level(B, 0), Driven(true));
    let mut bytes = [0; 2];
    bus.execute(0, 0x20, &mut [Operation::Write(&[0x12]), Operation::Read(&mut bytes)]).unwrap();
    assert_eq!(bytes, [0x00, 0x01]);
    relays.borrow_mut().set_reset(1_000_000, true);
    let fault = bus.execute(1_000_000, 0x20, &mut [Operation::Write(&[0x00])]);
    assert!(matches!(fault, Err(Fault::AddressNack { address: 0x20, .. })));
    assert!(relays.borrow().misuse().is_empty());
}

/// Random action of a bus and a board, sensible or not.
#[derive(Clone, Debug)]
enum Action {
    Start { read: bool },
    Write(u8),
    Read,
    Stop,
    External(Port, u8, Option<bool>),
    Reset(bool),
    PowerCycle,
}

fn any_action() -> impl Strategy<Value = Action> {
    let external = (prop_oneof![Just(A), Just(B)], 0u8..10, any::<Option<bool>>());
    prop_oneof![
        4 => any::<bool>().prop_map(|read| Action::Start { read }),
        8 => any::<u8>().prop_map(Action::Write),
        8 => (0u8..0x1C).prop_map(Action::Write),
        6 => Just(Action::Read),
        3 => Just(Action::Stop),
        6 => external.prop_map(|(port, bit, level)| Action::External(port, bit, level)),
        1 => any::<bool>().prop_map(Action::Reset),
        1 => Just(Action::PowerCycle),
    ]
}

fn act(chip: &mut Mcp23017, at_ns: u64, action: &Action) {
    match *action {
        Action::Start { read } => chip.start(at_ns, 0x20, read),
        Action::Write(byte) => {
            let _ = chip.write(at_ns, byte);
        }
        Action::Read => {
            let _ = chip.read(at_ns);
        }
        Action::Stop => chip.stop(at_ns),
        Action::External(port, bit, level) => chip.set_external(port, bit, level),
        Action::Reset(asserted) => chip.set_reset(at_ns, asserted),
        Action::PowerCycle => chip.power_cycle(at_ns),
    }
}

proptest! {
    #[test]
    fn any_traffic_leaves_pins_and_registers_consistent(
        actions in prop::collection::vec((any::<u64>(), any_action()), 0..300),
    ) {
        let mut chip = chip();
        for (at_ns, action) in &actions {
            let before = (pins(&chip, A), pins(&chip, B), chip.interrupt_pin(A), chip.interrupt_pin(B));
            let generation = chip.generation();
            act(&mut chip, *at_ns, action);
            let now = (pins(&chip, A), pins(&chip, B), chip.interrupt_pin(A), chip.interrupt_pin(B));
            prop_assert_eq!(before != now, generation != chip.generation());

            let bank = chip.iocon & 0x80 != 0;
            let value = |paired: u8, port: Port| {
                let banked = paired / 2 + 0x10 * port as u8;
                chip.register(if bank { banked } else { paired + port as u8 }).unwrap()
            };
            for port in Port::ALL {
                let [iodir, ipol, gppu, gpio, olat] =
                    [0x00, 0x02, 0x0C, 0x12, 0x14].map(|register| value(register, port));
                for bit in 0..8 {
                    let has = |byte: u8| byte >> bit & 1 != 0;
                    let expected = match (has(iodir), has(gppu)) {
                        (false, _) => Driven(has(olat)),
                        (true, true) => PulledUp,
                        (true, false) => Floating,
                    };
                    prop_assert_eq!(chip.pin_level(port, bit), expected);
                    if let Driven(high) = expected {
                        prop_assert_eq!(has(gpio), high != has(ipol));
                    }
                }
            }
        }
    }
}
