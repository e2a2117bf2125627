//! Tests of pins: configuration by a program, and their state for the outside world.

use super::*;
use crate::testing::{Bench, Event};

const PORT_H: u32 = 7 * 0x400;
const PH6: Pin = Pin::new('H', 6);

fn bench() -> (Gpio, Bench) {
    (Gpio::new(), Bench::default())
}

/// Sets the two bits of a pin in MODER or PUPDR.
fn set(gpio: &mut Gpio, bench: &mut Bench, register: u32, pin: Pin, bits: u32) {
    let at = u32::from(pin.port) * 0x400 + register;
    bench.modify(gpio, at, 3 << (2 * pin.number), bits << (2 * pin.number));
}

fn drives(bench: &mut Bench) -> Vec<(Pin, Level)> {
    let drive = |event| if let Event::Drive { pin, level, .. } = event { (pin, level) } else { panic!("{event:?}") };
    bench.take_events().into_iter().map(drive).collect()
}

#[test]
fn pins_are_analog_after_a_reset_but_for_the_debug_pins() {
    let (mut gpio, mut bench) = bench();
    assert_eq!(gpio.mode(PH6), Mode::Analog);
    assert_eq!(gpio.function(Pin::new('A', 13)), Some(Function::DebugPort));
    gpio.reset(&mut bench.context());
    // Reset state of RM0399, 12.3.1: SWDIO, JTDI and NJTRST are pulled up, SWCLK down, JTDO (PB3) floats.
    let pulled = [('A', 13, true), ('A', 14, false), ('A', 15, true), ('B', 4, true)];
    let expected = pulled.map(|(port, number, up)| (Pin::new(port, number), Level::Floating(Some(up))));
    assert_eq!(drives(&mut bench), expected);
}

#[test]
fn an_output_is_told_when_it_changes_and_only_then() {
    let (mut gpio, mut bench) = bench();
    bench.write(&mut gpio, PORT_H + BSRR, 1 << 6);
    assert_eq!(drives(&mut bench), [], "still analog");
    bench.now_ns = 500;
    set(&mut gpio, &mut bench, MODER, PH6, 1);
    assert_eq!(bench.take_events(), [Event::Drive { at_ns: 500, pin: PH6, level: Level::High }]);
    bench.write(&mut gpio, PORT_H + BSRR, 1 << 6);
    assert_eq!(drives(&mut bench), []);
    bench.write(&mut gpio, PORT_H + BSRR, 1 << 22);
    assert_eq!(drives(&mut bench), [(PH6, Level::Low)]);
    bench.write(&mut gpio, PORT_H + BSRR, 1 << 22 | 1 << 6);
    assert_eq!(drives(&mut bench), [(PH6, Level::High)], "setting wins");
    bench.write(&mut gpio, PORT_H + ODR, 0);
    assert_eq!(drives(&mut bench), [(PH6, Level::Low)]);
    assert_eq!(bench.read(&mut gpio, PORT_H + IDR), 0);
}

#[test]
fn an_open_drain_pin_reads_what_is_outside_while_it_is_let_go() {
    let (mut gpio, mut bench) = bench();
    bench.write(&mut gpio, PORT_H + OTYPER, 1 << 6);
    set(&mut gpio, &mut bench, PUPDR, PH6, 1);
    bench.write(&mut gpio, PORT_H + ODR, 1 << 6);
    set(&mut gpio, &mut bench, MODER, PH6, 1);
    assert_eq!(drives(&mut bench), [(PH6, Level::Floating(Some(true)))]);
    assert_eq!(bench.read(&mut gpio, PORT_H + IDR), 1 << 6, "pulled up");
    bench.outside.levels.insert(PH6, false);
    assert_eq!(bench.read(&mut gpio, PORT_H + IDR), 0, "held low by someone else");
    bench.write(&mut gpio, PORT_H + ODR, 0);
    assert_eq!(drives(&mut bench), [(PH6, Level::Low)]);
    bench.outside.levels.insert(PH6, true);
    assert_eq!(bench.read(&mut gpio, PORT_H + IDR), 0, "the chip wins over a weak high");
}

#[test]
fn an_analog_pin_reads_as_0_and_is_what_analog_parts_need() {
    let (mut gpio, mut bench) = bench();
    bench.outside.levels.insert(PH6, true);
    assert_eq!(bench.read(&mut gpio, PORT_H + IDR), 0);
    gpio.check_analog(PH6, "ADC", &mut bench.context());
    bench.assert_no_misuse();
    set(&mut gpio, &mut bench, MODER, PH6, 0);
    assert_eq!(bench.read(&mut gpio, PORT_H + IDR), 1 << 6);
    gpio.check_analog(PH6, "ADC", &mut bench.context());
    assert_eq!(bench.take_misuse().len(), 1);
}

#[test]
fn a_timer_s_channel_is_on_the_pin_that_has_it() {
    let (mut gpio, mut bench) = bench();
    let step = Function::Timer(12, 1);
    gpio.timer_output(step, Some(true), 100, &mut bench.outside);
    assert_eq!(drives(&mut bench), [], "no pin has it yet");
    bench.modify(&mut gpio, PORT_H + AFRL, 0, 9 << 24);
    set(&mut gpio, &mut bench, MODER, PH6, 2);
    assert_eq!((gpio.alternate(PH6), gpio.function(PH6)), (Some(9), None));
    assert_eq!(drives(&mut bench), [], "the wrong alternate function");
    bench.now_ns = 200;
    bench.modify(&mut gpio, PORT_H + AFRL, 0xF << 24, 2 << 24);
    assert_eq!(bench.take_events(), [Event::Drive { at_ns: 200, pin: PH6, level: Level::High }]);
    assert_eq!(gpio.pins_with(step).collect::<Vec<_>>(), [PH6]);
    gpio.timer_output(step, Some(false), 350, &mut bench.outside);
    assert_eq!(bench.take_events(), [Event::Drive { at_ns: 350, pin: PH6, level: Level::Low }]);
    gpio.timer_output(step, None, 400, &mut bench.outside);
    assert_eq!(drives(&mut bench), [(PH6, Level::Floating(None))]);
}

#[test]
fn a_reset_lets_all_pins_go() {
    let (mut gpio, mut bench) = bench();
    set(&mut gpio, &mut bench, MODER, PH6, 1);
    bench.take_events();
    gpio.reset_port(7, &mut bench.context());
    assert_eq!(drives(&mut bench), [(PH6, Level::Floating(None))]);
}

#[test]
fn half_words_reach_their_half_of_bsrr() {
    let (mut gpio, mut bench) = bench();
    bench.write(&mut gpio, PORT_H + ODR, 0b11);
    bench.try_write(&mut gpio, PORT_H + BSRR + 2, Size::Half, 0b01).unwrap();
    assert_eq!(bench.read(&mut gpio, PORT_H + ODR), 0b10);
}

#[test]
fn what_is_reserved_or_not_modelled_is_told() {
    let (mut gpio, mut bench) = bench();
    set(&mut gpio, &mut bench, PUPDR, PH6, 3);
    assert!(bench.take_misuse()[0].contains("PH6"));
    assert!(bench.try_write(&mut gpio, PORT_H + LCKR, Size::Word, 1).is_err());
    assert!(bench.try_read(&mut gpio, PORT_H + 0x28, Size::Word).is_err());
    assert!(bench.try_read(&mut gpio, 11 * 0x400, Size::Word).is_err());
}
