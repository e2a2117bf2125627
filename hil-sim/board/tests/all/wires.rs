//! World as seen by a processor that drives its pins and buses itself, with its own timing.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use r4_boards::{Robot, SwitchedBy};
use r4_protocol::{
    ChannelId, ChannelKind,
    config::{BridgeConfig, BridgeLines},
};
use r4_sim::{
    Clock,
    i2c::Response,
    sensors::quadrature::Channel,
    uart::{LineNoise, UartByte},
    world::{BoardChip, Controller, EncoderLine, StepPulses, World},
};

const US: u64 = 1_000;
const MS: u64 = 1_000_000;
/// Clock period of I2C at 400 kHz, ns.
const I2C_CLOCK_NS: u64 = 2_500;

const ROTARY: ChannelId = ChannelId::new(ChannelKind::Osmc, 0);
/// Counts per turn of the bench's encoder 0.
const COUNTS_PER_TURN: f64 = 2400.0;

fn load(robot: &str) -> Robot {
    r4_boards::load(robot).unwrap()
}

fn world(robot: &str) -> (Clock, World) {
    let clock = Clock::default();
    let world = World::new(&load(robot), clock.clone(), 1).unwrap();
    (clock, world)
}

/// Advances the clock by `ns`, and returns the new time.
fn pass(clock: &Clock, ns: u64) -> u64 {
    clock.run_ahead(clock.now_ns() + ns)
}

/// Writes `bytes` to a chip, each with its nine clocks.
fn write(clock: &Clock, world: &mut World, controller: Controller, address: u8, bytes: &[u8]) -> Response {
    let mut response = world.i2c_start(controller, pass(clock, 10 * I2C_CLOCK_NS), address, false);
    for byte in bytes {
        if response == Response::Ack {
            response = world.i2c_write(controller, pass(clock, 9 * I2C_CLOCK_NS), *byte);
        }
    }
    world.i2c_stop(controller, pass(clock, 2 * I2C_CLOCK_NS));
    response
}

/// Closes all relays, including that of the motors' supply.
fn close_relays(clock: &Clock, world: &mut World, robot: &Robot) {
    let mut levels = [0_u8; 2];
    for relay in &robot.config.relays {
        levels[usize::from(relay.bit / 8)] |= u8::from(!relay.active_low) << (relay.bit % 8);
    }
    let address = robot.config.expander.unwrap().address;
    // GPIOA and B, then IODIRA and B: all outputs (3.5.1, 3.5.10)
    for bytes in [[0x12, levels[0], levels[1]], [0x00, 0, 0]] {
        assert_eq!(write(clock, world, Controller::Board, address, &bytes), Response::Ack);
    }
}

/// Runs the bench's rotary motor forwards at this duty: leg B low, leg A high for that share of each PWM cycle.
fn drive_rotary(clock: &Clock, world: &mut World, robot: &Robot, duty: f64) {
    let address = robot.config.osmc_pwm.unwrap().address;
    let BridgeConfig::Osmc(BridgeLines { ahi, ali, bli, .. }) = robot.config.motors[0].bridge else {
        panic!("an OSMC")
    };
    let mut tell = |bytes: &[u8]| {
        assert_eq!(write(clock, world, Controller::Board, address, bytes), Response::Ack);
        // the oscillator takes 500 us to start (7.3.1)
        pass(clock, 500 * US);
    };
    // PRE_SCALE 3 for 1526 Hz while asleep; MODE1 awake with auto-increment (datasheet 7.3.1, 7.3.5)
    tell(&[0xFE, 3]);
    tell(&[0x00, 0x20]);
    // LEDn_ON_L and on (7.3.3): full ON; leg A's low side, which has priority, from the duty's count to the end of the
    // cycle
    tell(&[0x06 + 4 * ahi, 0, 0x10, 0, 0]);
    tell(&[0x06 + 4 * bli, 0, 0x10, 0, 0]);
    let [low, high] = ((duty * 4096.0) as u16).to_le_bytes();
    tell(&[0x06 + 4 * ali, low, high, 0, 0]);
    world.set_pwm_outputs_disabled(false);
    world.set_osmc_disabled(false);
}

/// Software decoder that takes single edges.
#[derive(Default)]
struct Decoder {
    a: bool,
    b: bool,
    count: i64,
}

impl Decoder {
    fn take(&mut self, line: EncoderLine, high: bool) {
        let (up, level) = match line {
            EncoderLine::Track(Channel::A) => (high != self.b, &mut self.a),
            EncoderLine::Track(Channel::B) => (high == self.a, &mut self.b),
            EncoderLine::Index => panic!("it has none"),
        };
        *level = high;
        self.count += if up { 1 } else { -1 };
    }
}

/// Follows an encoder as an emulator does: it samples at the announced times, and no edge is later than stated.
#[test]
fn encoder_edges_are_told_when_they_happen() {
    let robot = load("osmc-bench");
    let (clock, mut world) = world("osmc-bench");
    close_relays(&clock, &mut world, &robot);
    drive_rotary(&clock, &mut world, &robot, 0.8);
    let mut decoder = Decoder::default();
    let (mut looks, mut late) = (0_u64, Vec::new());
    let mut last_ns = 0;
    while clock.now_ns() < 600 * MS {
        if clock.now_ns() > 300 * MS && world.drive(ROTARY).unwrap().coast < 1.0 {
            world.set_osmc_disabled(true);
        }
        let next_ns = world.next_encoder_change_ns(0);
        assert!(next_ns > clock.now_ns(), "time goes on");
        let now_ns = clock.run_ahead(next_ns);
        let left_out = world.take_encoder_edges(0, |edge| {
            assert!(edge.at_ns >= last_ns && edge.at_ns <= now_ns);
            last_ns = edge.at_ns;
            decoder.take(edge.line, edge.high);
            late.push(now_ns - edge.at_ns);
        });
        assert_eq!(left_out, 0);
        looks += 1;
    }
    let turned = world.position(ROTARY).unwrap() / std::f64::consts::TAU * COUNTS_PER_TURN;
    assert!(decoder.count > 200, "{} counts", decoder.count);
    assert_eq!(decoder.count, turned.floor() as i64);
    assert_eq!(world.encoder_levels(0).a, decoder.a);
    late.sort_unstable();
    // a twentieth of the time to the next edge at this speed, and the limit from rest: 20 us
    assert!(late[late.len() - 1] <= 20 * US, "{:?}", &late[late.len() - 5..]);
    // in 600 ms: at most every 100 us for unforeseeable motion, and two or three samples for each edge
    let edges = late.len() as u64;
    assert!(looks < 600 * MS / (100 * US) + 3 * edges, "{looks} looks for {edges} edges");
}

#[test]
fn a_shaft_at_rest_is_hardly_looked_at_and_other_inputs_never() {
    let (clock, mut world) = world("osmc-bench");
    let mut looks = 0;
    while clock.now_ns() < 100 * MS {
        clock.run_ahead(world.next_encoder_change_ns(0));
        looks += 1;
    }
    assert_eq!(looks, 100, "once a ms");
    assert_eq!(world.next_encoder_change_ns(3), u64::MAX);
    assert_eq!(world.next_encoder_change_ns(4), u64::MAX, "there is no such input");
}

/// A glitch is reported at its time, which is announced.
#[test]
fn a_glitch_on_a_track_is_told_at_its_time() {
    let (clock, mut world) = world("osmc-bench");
    world.pins().encoders[0].inject_glitch(Channel::B, 10_300, 250);
    let mut edges = Vec::new();
    while clock.now_ns() < 20 * US {
        clock.run_ahead(world.next_encoder_change_ns(0).min(20 * US));
        let now_ns = clock.now_ns();
        assert_eq!(world.take_encoder_edges(0, |edge| edges.push((now_ns, edge.at_ns, edge.line, edge.high))), 0);
    }
    let b = EncoderLine::Track(Channel::B);
    assert_eq!(edges, [(10_300, 10_300, b, true), (10_550, 10_550, b, false)]);
}

/// Steps at 200 Hz, up and back, reported late and line by line, as from timers that were not read in between.
#[test]
fn stepper_lines_count_whatever_the_order_in_which_they_are_told() {
    let (clock, mut world) = world("every-interface");
    let stepper = ChannelId::new(ChannelKind::Stepper, 1);
    let robot = load("every-interface");
    close_relays(&clock, &mut world, &robot);
    world.settle_steppers(clock.now_ns());
    let active_low = robot.config.stepper_bank.is_some_and(|bank| bank.enable_active_low);
    world.set_stepper_enable(!active_low);
    pass(&clock, 10 * MS);
    world.settle_steppers(clock.now_ns());
    let first_ns = clock.now_ns() + MS;
    let period_ns = 5 * MS;
    pass(&clock, 300 * MS);
    // 30 forward, 20 back; the direction first, and 50 us before the next step
    world.direction_line(1, first_ns - 50 * US, true);
    world.direction_line(1, first_ns + 30 * period_ns - 50 * US, false);
    for step in 0..50 {
        world.step_line(1, first_ns + step * period_ns, true);
        world.step_line(1, first_ns + step * period_ns + 5 * US, false);
    }
    assert_eq!(world.step_pulses(stepper), Some(StepPulses::default()), "not settled yet");
    world.settle_steppers(first_ns + 29 * period_ns + 500 * US);
    assert_eq!(world.step_pulses(stepper), Some(StepPulses { forward: 30, backward: 0 }));
    assert_eq!(world.stepper(stepper).unwrap().commanded(), 30);
    world.settle_steppers(clock.now_ns());
    assert_eq!(world.step_pulses(stepper), Some(StepPulses { forward: 30, backward: 20 }));
    assert_eq!(world.step_pulses(stepper).unwrap().net(), 10);
    assert_eq!(world.stepper(stepper).unwrap().commanded(), 10);
    assert_eq!(world.misuse(), []);
    // a reset of the processor lets the enable line float: a step is lost, and reported
    world.reset_processor();
    world.step_line(1, pass(&clock, MS), true);
    world.settle_steppers(pass(&clock, MS));
    assert_eq!(world.stepper(stepper).unwrap().commanded(), 10);
    assert_eq!(world.misuse().len(), 1);
    // lines of a connector without a driver are ignored
    world.step_line(9, clock.now_ns(), true);
}

/// 2 m there and back in air of 20 degrees, 343.42 m/s: 11.647 ms, 0.5 ms after the trigger
#[test]
fn an_echo_has_edges_at_foreseen_times() {
    let (clock, mut world) = world("every-interface");
    world.range_sensor(2).unwrap().set_noise_rms_mm(0.0);
    world.range_sensor(2).unwrap().set_distance_m(Some(2.0));
    assert_eq!(world.next_echo_edge_ns(2), u64::MAX);
    world.trigger(2, true);
    pass(&clock, 12 * US);
    world.trigger(2, false);
    let mut edges = Vec::new();
    while world.next_echo_edge_ns(2) != u64::MAX {
        let now_ns = clock.run_ahead(world.next_echo_edge_ns(2));
        world.take_echo_edges(2, |edge| edges.push((edge.at_ns == now_ns, edge.at_ns, edge.high)));
        assert_eq!(world.echo_is_high(2), edges.len() == 1);
    }
    let rise_ns = 12 * US + 500 * US;
    assert_eq!(edges.len(), 2);
    assert_eq!(edges[0], (true, rise_ns, true));
    let width_us = (edges[1].1 - rise_ns) / US;
    assert_eq!((edges[1].0, edges[1].2, width_us), (true, false, 11_647));
}

/// The same input as a voltage and as the code of an ideal 16-bit converter, including noise: same seed, same samples.
#[test]
fn a_voltage_is_what_the_converter_sees() {
    let [(_, mut volts), (_, mut codes)] = [world("every-interface"), world("every-interface")];
    for input in 0..6 {
        for _ in 0..50 {
            let ideal = (volts.analog_v(input) / 3.3 * 65_535.0).round() as u16;
            assert_eq!(ideal, codes.analog_code(input), "input {input}");
        }
    }
    assert_eq!(volts.analog_v(6), 0.0, "there is no such input");
}

#[test]
fn a_driven_analog_output_is_seen_and_gone_after_a_reset() {
    let (_, mut world) = world("every-interface");
    world.set_dac_v(1, 1.25);
    assert_eq!((world.pins().dac_v(0), world.pins().dac_v(1)), (Some(0.0), Some(1.25)));
    world.reset_processor();
    assert_eq!(world.pins().dac_v(1), Some(0.0));
}

#[test]
fn switches_are_high_until_what_they_watch_is_there() {
    let robot = load("every-interface");
    let (_, mut world) = world("every-interface");
    assert!(world.switch_is_high(17), "pulled, where there is none");
    for switch in &robot.simulation.switches {
        let SwitchedBy::Axis { channel, below } = switch.closed_by else { continue };
        let closed = world.position(channel).is_some_and(|position| position < below);
        assert_eq!(world.switch_is_high(switch.channel.index.into()), !closed);
    }
}

/// EEPROM 24C02 on a connector: a page written and read back byte by byte; it does not answer for the 5 ms of its
/// write.
#[test]
fn an_external_bus_goes_byte_by_byte() {
    let (clock, mut world) = world("every-interface");
    let bus = Controller::External(1);
    assert_eq!(write(&clock, &mut world, bus, 0x50, &[0x08, 1, 2, 3]), Response::Ack);
    assert_eq!(write(&clock, &mut world, bus, 0x50, &[0x08]), Response::Nack);
    pass(&clock, 5 * MS);
    assert_eq!(world.i2c_start(bus, pass(&clock, 25 * US), 0x50, false), Response::Ack);
    assert_eq!(world.i2c_write(bus, pass(&clock, 25 * US), 0x09), Response::Ack);
    assert_eq!(world.i2c_start(bus, pass(&clock, 25 * US), 0x50, true), Response::Ack);
    let read = [(); 2].map(|()| world.i2c_read(bus, pass(&clock, 25 * US)));
    world.i2c_stop(bus, pass(&clock, 5 * US));
    assert_eq!(read, [Some(2), Some(3)]);
    assert!(world.i2c_lines_are_free(bus));
    assert_eq!(world.misuse(), []);
}

#[test]
fn uart_connectors_give_back_what_they_are_sent_as_the_line_lets_it_through() {
    let (clock, mut world) = world("every-interface");
    pass(&clock, 100 * US);
    world.uart_sent(1, 95 * US, b'a');
    assert_eq!(world.next_uart_arrival_ns(1), 95 * US);
    assert_eq!(world.take_uart_arrived(0), None);
    assert_eq!(world.take_uart_arrived(1), Some(UartByte::clean(95 * US, b'a')));
    assert_eq!((world.take_uart_arrived(1), world.next_uart_arrival_ns(1)), (None, u64::MAX));
    // one bit in a hundred: of 1000 bytes about one in ten is disturbed
    world.pins().uart(1).unwrap().disturb(Some(LineNoise::new(0.01, 0.0, 3)));
    let mut hit = 0;
    for sent in 0..1000_u32 {
        let at_ns = pass(&clock, 87 * US);
        world.uart_sent(1, at_ns, sent as u8);
        let arrived = world.take_uart_arrived(1);
        hit += u32::from(arrived != Some(UartByte::clean(at_ns, sent as u8)));
    }
    // 1 - 0.99^10 is 0.096; four standard deviations of 1000 draws are 0.037
    assert!((59..=133).contains(&hit), "{hit}");
}

/// The DAC takes a code when LDAC falls, and at once while it is low.
#[test]
fn ldac_holds_voltages_back() {
    let robot = load("every-interface");
    let (clock, mut world) = world("every-interface");
    let address = robot.config.bldc_dac.unwrap().address;
    let bldc = robot.config.bldcs[0];
    // Multi-write (5.6.2) of the channel with UDAC = 1, code 2048 at the supply's reference: half of it.
    let half = [0x41 | bldc.output << 1, 0x08, 0x00];
    let before = world.throttle_v(bldc.id).unwrap();
    world.set_ldac(true);
    assert_eq!(write(&clock, &mut world, Controller::Board, address, &half), Response::Ack);
    assert_eq!(world.throttle_v(bldc.id), Some(before));
    world.set_ldac(false);
    let full_scale_v = f64::from(robot.config.bldc_dac.unwrap().full_scale_v);
    assert_eq!(world.throttle_v(bldc.id), Some(full_scale_v / 2.0));
}

/// Each chip loses its state, also in the middle of a transfer, while the others continue.
#[test]
fn a_brown_out_resets_one_chip() {
    let robot = load("every-interface");
    let (clock, mut world) = world("every-interface");
    let config = &robot.config;
    let pwms = [
        (BoardChip::OsmcPwm, config.osmc_pwm.unwrap().address),
        (BoardChip::DhbPwm, config.dhb_pwm.unwrap().address),
        (BoardChip::ServoPwm, config.servo_pwm.unwrap().address),
    ];
    let prescalers = |world: &World| {
        let chips = [world.osmc_pwm(), world.dhb_pwm(), world.servo_pwm()];
        chips.map(|chip| chip.unwrap().borrow().register(0xFE).unwrap())
    };
    let mut expected = [3; 3];
    for (_, address) in pwms {
        write(&clock, &mut world, Controller::Board, address, &[0xFE, 3]);
    }
    for (place, (chip, address)) in pwms.into_iter().enumerate() {
        assert_eq!(prescalers(&world), expected);
        assert_eq!(world.i2c_start(Controller::Board, pass(&clock, 25 * US), address, false), Response::Ack);
        assert!(world.brown_out(chip));
        assert_eq!(world.i2c_write(Controller::Board, pass(&clock, 25 * US), 0x00), Response::Nack);
        world.i2c_stop(Controller::Board, pass(&clock, 5 * US));
        // as delivered, 200 Hz (7.3.5)
        expected[place] = 0x1E;
    }
    assert_eq!(prescalers(&world), expected);

    let expander = config.expander.unwrap().address;
    write(&clock, &mut world, Controller::Board, expander, &[0x00, 0, 0]);
    assert!(world.brown_out(BoardChip::Expander));
    assert_eq!(world.expander().unwrap().borrow().register(0x00), Some(0xFF), "all inputs (3.5.1)");

    let bldc = config.bldcs[0];
    let kept_v = world.throttle_v(bldc.id).unwrap();
    write(&clock, &mut world, Controller::Board, config.bldc_dac.unwrap().address, &[0x40 | bldc.output << 1, 0x08, 0]);
    assert_ne!(world.throttle_v(bldc.id), Some(kept_v));
    assert!(world.brown_out(BoardChip::BldcDac));
    assert_eq!(world.throttle_v(bldc.id), Some(kept_v), "from its EEPROM");

    let (_, mut bench) = self::world("osmc-bench");
    assert!(!bench.brown_out(BoardChip::ServoPwm), "the bench has none");
}
