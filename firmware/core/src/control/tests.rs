//! Tests of each cause that the control loop raises, when, and by nothing less: [`run`] beside the supervisor, on chips
//! that only store registers.

extern crate std;

use std::boxed::Box;

use embassy_time::{Duration, Instant};
use r4_protocol::{
    Cause, Causes, Mode, SafetyState, Setpoint,
    config::{BoardConfig, BridgeConfig, CurrentSense, Place, RelayRole},
};

use super::{BoardIo, run};
use crate::{
    ResetCause,
    safety::Event,
    sensing::range::RangeReading,
    shared::{MotorStatus, Status},
    supervisor::{SafetyPins, supervise},
    testing::{Board, Line, Peripherals, Registers, Tasks, board, robot},
};

const MS: Duration = Duration::from_millis(1);
/// Time from arming until motors are driven: the motors' supply closes, and drivers are given time.
const POWER_UP: Duration = Duration::from_millis(51);
const EXPANDER: u8 = 0x20;

/// Bench with its two motors, on a bus that takes no time.
struct Bench {
    shared: Board,
    tasks: Tasks,
    bus: Registers,
    inputs: Peripherals,
}

impl Bench {
    fn with(config: BoardConfig) -> Self {
        let high = || Line::new(true);
        let bench = Self {
            shared: board(config, ResetCause::Normal),
            tasks: Tasks::default(),
            bus: Registers::default(),
            inputs: Peripherals::default(),
        };
        bench.set_supply(0, 24.0);
        bench.set_supply(1, 12.0);
        // Wiper of the actuator, in the middle.
        bench.inputs.codes[0].set(32_768);
        let mut tasks = Tasks::default();
        tasks.spawn(supervise(
            bench.shared,
            SafetyPins {
                dead_man: high(),
                auxiliary_stop: high(),
                osmc_disable: high(),
                pwm_output_disable: high(),
                heartbeat: high(),
                red: high(),
                green: high(),
                blue: high(),
            },
        ));
        tasks.spawn(run(bench.shared, BoardIo { bus: bench.bus.clone(), peripherals: bench.inputs.clone() }));
        Self { tasks, ..bench }
    }

    fn new() -> Self {
        Self::with(robot("osmc-bench"))
    }

    /// Bench that is armed, with the motors' supply on.
    fn armed() -> Self {
        let mut bench = Self::new();
        bench.advance(20);
        bench.arm();
        bench.tasks.advance(POWER_UP);
        bench
    }

    #[track_caller]
    fn arm(&mut self) {
        assert_eq!(self.shared.request(Event::Arm), Ok(()));
    }

    fn set_supply(&self, index: usize, volts: f32) {
        let supply = self.shared.config().supplies[index];
        self.inputs.codes[usize::from(supply.analog)].set((volts / supply.volts_per_code) as u16);
    }

    fn advance(&mut self, ms: u32) {
        self.tasks.advance(MS * ms);
    }

    #[track_caller]
    fn is_armed(&self) {
        let view = self.shared.safety();
        assert_eq!((view.state, view.causes), (SafetyState::Armed, Causes::NONE));
    }

    #[track_caller]
    fn is_tripped_by(&self, cause: Cause) {
        let view = self.shared.safety();
        assert_eq!((view.state, view.causes), (SafetyState::Tripped, Causes::only(cause)));
    }

    /// Number of periods until the board is no longer armed.
    fn periods_until_tripped(&mut self, at_most: u32) -> u32 {
        (0..at_most)
            .find(|_| {
                self.advance(1);
                self.shared.safety().state != SafetyState::Armed
            })
            .map_or(at_most, |periods| periods + 1)
    }

    fn drive(&self, motor: usize, duty: f32) {
        let setpoint = Setpoint { mode: Mode::Duty, value: duty };
        assert_eq!(self.shared.as_host().command(Place::Motor(motor), setpoint, Instant::now().as_micros()), Ok(()));
    }
}

/// A transfer is repeated twice, after the bus was freed each time; the third failure in a row is a fault.
#[test]
fn three_failures_in_a_row_are_an_i2c_fault() {
    let mut bench = Bench::armed();
    bench.bus.fail(2);
    bench.advance(20);
    bench.is_armed();
    assert_eq!((bench.bus.recoveries(), bench.shared.report().stats().bus_retries), (2, 2));
    let mut bench = Bench::armed();
    bench.bus.fail(3);
    bench.advance(20);
    bench.is_tripped_by(Cause::I2cFault);
    // The chips are set up again, and then the trip can be cleared.
    assert_eq!(bench.shared.request(Event::Clear), Ok(()));
    bench.arm();
    bench.advance(20);
    bench.is_armed();
}

/// A stop is written at once. When it is requested again, as behind one within a period, it is not written again: that
/// would be the longest of all ticks.
#[test]
fn a_stop_is_carried_out_once() {
    let mut bench = Bench::armed();
    bench.drive(0, 0.5);
    bench.advance(5);
    let before = bench.pins();
    assert_eq!(bench.shared.request(Event::Disarm), Ok(()));
    bench.tasks.advance(Duration::from_micros(1));
    assert_ne!(bench.pins(), before, "the motors' supply opens");
    bench.bus.set(EXPANDER, 0x14, 0xEE);
    bench.shared.make_safe.signal(());
    bench.tasks.advance(Duration::from_micros(1));
    assert_eq!(bench.bus.get(EXPANDER, 0x14), 0xEE);
}

/// The supervisor learns of it before the period with the failure ends.
#[test]
fn a_dead_bus_trips_at_once_and_stays_a_fault() {
    let mut bench = Bench::armed();
    bench.drive(0, 0.5);
    bench.bus.fail(u32::MAX);
    assert_eq!(bench.periods_until_tripped(100), 1);
    bench.is_tripped_by(Cause::I2cFault);
    bench.advance(100);
    assert!(bench.shared.request(Event::Clear).is_err());
    bench.bus.fail(0);
    bench.advance(20);
    assert_eq!(bench.shared.request(Event::Clear), Ok(()));
}

/// Every register that keeps an output in place is read back: the relays' latches and directions, mode and prescaler of
/// the bridges' PWM chip, the lines of each bridge. While armed, one of these ten is read in every fourth period.
#[test]
fn a_register_that_changes_by_itself_is_a_mismatch() {
    let bridges = robot("osmc-bench").osmc_pwm.expect("it has bridges").address;
    let expander = robot("osmc-bench").expander.map_or(EXPANDER, |expander| expander.address);
    let [mode1, mode2, prescale] = [0x00, 0x01, 0xFE];
    let lines = robot("osmc-bench")
        .motors
        .iter()
        .flat_map(|motor| match motor.bridge {
            BridgeConfig::Osmc(lines) => lines.all(),
            BridgeConfig::Dhb(_) => panic!("it has none"),
        })
        .collect::<heapless::Vec<u8, 8>>();
    let lines = lines.into_iter().map(|line| (bridges, 6 + 4 * line + 3, 0x10));
    for (chip, register, flip) in lines.chain([
        (expander, 0x00, 0x01),
        (expander, 0x01, 0x80),
        (expander, 0x14, 0x04),
        (expander, 0x15, 0x04),
        (bridges, mode1, 0x10),
        (bridges, mode2, 0x10),
        (bridges, prescale, 0x01),
    ]) {
        let mut bench = Bench::armed();
        bench.bus.set(chip, register, bench.bus.get(chip, register) ^ flip);
        assert!(bench.periods_until_tripped(50) <= 40, "{chip:#x} {register:#x}");
        bench.is_tripped_by(Cause::ReadBackMismatch);
        // The new set-up has corrected it.
        bench.advance(20);
        assert_eq!(bench.shared.request(Event::Clear), Ok(()), "{chip:#x} {register:#x}");
    }
}

/// Each rail trips at both ends of its range, on its own; it is filtered with 10 ms.
#[test]
fn a_supply_out_of_range_trips() {
    for (index, volts) in [(0, 19.9), (0, 30.1), (1, 9.9), (1, 15.1)] {
        let mut bench = Bench::armed();
        bench.set_supply(index, volts);
        bench.advance(100);
        bench.is_tripped_by(Cause::SupplyOutOfRange);
        assert!(bench.shared.request(Event::Clear).is_err());
        bench.set_supply(index, if index == 0 { 24.0 } else { 12.0 });
        bench.advance(100);
        assert_eq!(bench.shared.request(Event::Clear), Ok(()));
    }
    for (index, volts) in [(0, 20.1), (0, 29.9), (1, 10.1), (1, 14.9)] {
        let mut bench = Bench::armed();
        bench.set_supply(index, volts);
        bench.advance(100);
        bench.is_armed();
    }
}

#[test]
fn a_flat_battery_is_known_before_the_first_host() {
    let mut bench = Bench::new();
    bench.set_supply(0, 12.0);
    bench.advance(20);
    bench.is_tripped_by(Cause::SupplyOutOfRange);
}

/// An encoder that moves within a period by more than four times the highest speed plus eight counts has jumped: with
/// 2400 counts per turn and 5 rad/s that is 15.6 counts.
#[test]
fn a_jump_of_the_encoder_is_implausible() {
    for (counts, jumped) in [(15, false), (16, true)] {
        for counts in [counts, 0u16.wrapping_sub(counts)] {
            let mut bench = Bench::armed();
            bench.drive(0, 0.1);
            bench.advance(10);
            bench.inputs.counts[0].set(counts);
            bench.advance(2);
            if jumped {
                bench.is_tripped_by(Cause::EncoderImplausible);
            } else {
                bench.is_armed();
            }
        }
    }
}

#[test]
fn an_open_or_shorted_wiper_is_implausible() {
    for code in [0, u16::MAX] {
        let mut bench = Bench::armed();
        bench.inputs.codes[0].set(code);
        bench.advance(100);
        bench.is_tripped_by(Cause::EncoderImplausible);
    }
}

/// Stall at a duty of 0.8 for 300 ms without 0.02 rad, which is 7.6 counts: on the way to 0.9 at 20/s that duty is
/// passed after 40 ms.
#[test]
fn a_motor_that_is_driven_hard_and_stands_is_stalled() {
    let mut bench = Bench::armed();
    bench.drive(0, 0.9);
    let periods = bench.periods_until_tripped(1000);
    bench.is_tripped_by(Cause::Stalled);
    // The command is taken in the first period, and 300 sums of 1 ms in f32 may be short of 300 ms by one.
    assert!((341..=342).contains(&periods), "{periods}");
    // Neither a motor that moves just enough nor one that is driven less hard is stalled.
    let mut bench = Bench::armed();
    bench.drive(0, 0.9);
    for period in 0..1000u16 {
        bench.inputs.counts[0].set(period / 36);
        bench.advance(1);
    }
    bench.is_armed();
    let mut bench = Bench::armed();
    bench.drive(0, 0.79);
    bench.advance(1000);
    bench.is_armed();
}

/// A motor must reverse within 150 ms, and then not travel 0.02 rad further against its drive.
#[test]
fn a_motor_that_runs_against_its_drive_is_implausible() {
    let mut bench = Bench::armed();
    bench.drive(0, 0.9);
    let mut backwards = 0u16;
    let periods = (1..=1000).find(|period| {
        if period % 4 == 0 {
            backwards = backwards.wrapping_sub(1);
        }
        bench.inputs.counts[0].set(backwards);
        bench.advance(1);
        bench.shared.safety().state != SafetyState::Armed
    });
    bench.is_tripped_by(Cause::EncoderImplausible);
    // Composed of 40 ms to the stall's duty, 150 ms to reverse, 8 counts of 4 ms.
    assert!(periods.is_some_and(|periods| (220..=224).contains(&periods)), "{periods:?}");
}

/// Ten consecutive late periods are an overrun; nine are only counted.
#[test]
fn ten_late_periods_in_a_row_are_an_overrun() {
    let mut bench = Bench::armed();
    bench.drive(0, 0.1);
    bench.bus.slow_down(Duration::from_micros(2100));
    let before = bench.shared.report().stats().late_ticks;
    let begin = Instant::now();
    while bench.shared.safety().state == SafetyState::Armed && begin.elapsed() < MS * 1000 {
        bench.advance(1);
        // A set point in each period, so that there is something to write.
        let _ = bench.shared.as_host().command(
            Place::Motor(0),
            Setpoint { mode: Mode::Duty, value: 0.1 + begin.elapsed().as_millis() as f32 * 1e-3 },
            Instant::now().as_micros(),
        );
    }
    bench.is_tripped_by(Cause::ControlOverrun);
    assert_eq!(bench.shared.report().stats().late_ticks - before, 10);
}

#[test]
fn with_a_bad_configuration_nothing_is_driven() {
    let mut bench = Bench::with(BoardConfig { i2c_hz: 0, ..robot("osmc-bench") });
    bench.advance(100);
    bench.is_tripped_by(Cause::BadConfiguration);
    assert!(bench.shared.request(Event::Clear).is_err());
}

/// Half the supply at an actuator that does not move, below the duty of a stall: `(0.5 - 0.15) 12 V / 2 ohm` gives 1.4
/// times the permitted heat, for `60 s ln((1.96 - 0.8) / (1.96 - 1))`.
#[test]
fn a_winding_that_is_too_hot_trips_and_has_to_cool() {
    let mut bench = Bench::armed();
    bench.drive(1, 0.5);
    let expected_s = 60.0 * ((1.96_f64 - 0.8) / (1.96 - 1.0)).ln();
    let after_s = f64::from(bench.periods_until_tripped(20_000)) * 1e-3;
    // Delays: the supply's codes, the slew to the duty, 25 ms, and the 0.1 s that the observer takes to find that the
    // motor stands.
    assert!((expected_s..expected_s + 0.2).contains(&after_s), "{after_s} s, not {expected_s} s");
    bench.is_tripped_by(Cause::Overload);
    // Cooling takes 60 s ln(1 / 0.8), 13.4 s; disarming or a request does not change that.
    bench.advance(13_000);
    assert!(bench.shared.request(Event::Clear).is_err());
    bench.advance(500);
    assert_eq!(bench.shared.request(Event::Clear), Ok(()));
    // The heat then is the one with which a restarted board starts.
    bench.arm();
    bench.tasks.advance(POWER_UP);
    bench.drive(1, 0.5);
    let again_s = f64::from(bench.periods_until_tripped(20_000)) * 1e-3;
    assert!((expected_s - 0.1..=expected_s + 0.3).contains(&again_s), "{again_s} s");
}

/// A dead track beside the other's edges gives ten illegal transitions in a tenth of a second.
#[test]
fn illegal_transitions_at_a_rate_are_implausible() {
    let mut bench = Bench::armed();
    let mut illegal = 0;
    // Dirt on the disc: one every 20 ms, for a second.
    for _ in 0..50 {
        illegal += 1;
        bench.inputs.illegal[0].set(illegal);
        bench.advance(20);
    }
    bench.is_armed();
    bench.inputs.illegal[0].set(illegal + 10);
    assert!(bench.periods_until_tripped(10) <= 2);
    bench.is_tripped_by(Cause::EncoderImplausible);
    bench.advance(200);
    assert_eq!(bench.shared.request(Event::Clear), Ok(()));
}

#[test]
fn a_masked_line_trips_and_keeps_tripped() {
    let mut bench = Bench::armed();
    bench.inputs.storm.set(true);
    assert!(bench.periods_until_tripped(10) <= 2);
    bench.is_tripped_by(Cause::InterruptStorm);
    assert!(bench.shared.request(Event::Clear).is_err());
    bench.inputs.storm.set(false);
    bench.advance(2);
    assert_eq!(bench.shared.request(Event::Clear), Ok(()));
}

/// The share is 40 of the 1000 cycles that a period has here. The counter wraps on the way.
#[test]
fn what_a_period_takes_of_the_processor_is_counted() {
    let mut bench = Bench::new();
    bench.inputs.cycles.set(u32::MAX - 50);
    bench.advance(20);
    let counted = |bench: &Bench| {
        let stats = bench.shared.report().stats();
        (stats.worst_tick_cycles, stats.ticks_over_share)
    };
    assert_eq!(counted(&bench), (0, 0));
    for (taken, expected) in [(40, (40, 0)), (41, (41, 1)), (7, (41, 1)), (300, (300, 2))] {
        bench.inputs.cycles.set(bench.inputs.cycles.get().wrapping_add(taken));
        bench.advance(1);
        assert_eq!(counted(&bench), expected);
    }
}

/// Configuration with every kind of output except brushless drives, whose DAC is more than registers.
fn everything() -> BoardConfig {
    BoardConfig { bldcs: heapless::Vec::new(), bldc_dac: None, ..robot("every-interface") }
}

impl Bench {
    /// Bench that has just been armed: the motors' supply has not settled.
    fn just_armed(config: BoardConfig) -> Self {
        let mut bench = Self::with(config);
        bench.inputs.room.set(1_000_000);
        // The set-up waits for the oscillators of three chips, 0.5 ms each; then switches are known after 5 ms.
        bench.advance(20);
        let heard = RangeReading { updated: Instant::now(), ..RangeReading::NONE };
        (0..bench.shared.config().ranges.len()).for_each(|index| bench.shared.publish_range(index, heard));
        bench.arm();
        bench
    }

    #[track_caller]
    fn set(&self, place: Place, mode: Mode, value: f32) {
        assert_eq!(
            self.shared.as_host().command(place, Setpoint { mode, value }, Instant::now().as_micros()),
            Ok(()),
            "{place:?}"
        );
    }

    /// Number of PWM outputs of a chip that are not off.
    fn pulsing(&self, chip: u8) -> usize {
        (0..16).filter(|output| self.bus.get(chip, 6 + 4 * output + 3) & 0x10 == 0).count()
    }

    /// Output latches of the expander.
    fn pins(&self) -> u16 {
        u16::from_le_bytes([0x14, 0x15].map(|register| self.bus.get(EXPANDER, register)))
    }
}

/// Relays and voltages follow at once; outputs in the motors' supply follow only when its contacts have stopped
/// bouncing, 50 ms after arming, with the commands received meanwhile.
#[test]
fn every_output_follows_its_commands() {
    let config = everything();
    let chips = [config.osmc_pwm, config.dhb_pwm].map(|pwm| pwm.expect("it has both").address);
    let servos = config.servo_pwm.expect("it has one").address;
    let [power, relay] = [0, 1].map(|index| 1 << config.relays[index].bit);
    let mut bench = Bench::just_armed(config);
    bench.set(Place::Motor(0), Mode::Duty, 0.5);
    bench.set(Place::Motor(4), Mode::Duty, -0.5);
    bench.set(Place::Servo(2), Mode::Position, 0.5);
    bench.set(Place::Stepper(1), Mode::Speed, 3.0);
    bench.set(Place::Relay(1), Mode::Switch, 1.0);
    bench.set(Place::Dac(1), Mode::Voltage, 2.5);
    let before = bench.pins();
    bench.advance(2);
    // Both relays close by a low level, and no other line is low.
    assert_eq!(before & !bench.pins(), power | relay);
    assert_eq!(bench.inputs.dacs[1].get(), (2.5f32 / 3.3 * 4096.0).round() as u16);
    bench.advance(47);
    assert_eq!([chips[0], chips[1], servos].map(|chip| bench.pulsing(chip)), [0; 3]);
    assert_eq!(bench.inputs.told[1].get(), 0);
    bench.advance(100);
    // An OSMC has both high sides and the PWM on, a DHB enable and PWM; the PWM of standing motors is off.
    assert_eq!([chips[0], chips[1], servos].map(|chip| bench.pulsing(chip)), [3 + 3 * 2, 2 + 3, 1]);
    assert!(bench.inputs.steppers_enabled.get() && bench.inputs.told[1].get() > 0);
    assert_eq!([0, 2, 3].map(|index| bench.inputs.told[index].get()), [0; 3]);
    // The statuses show the same.
    let motor = |place| match bench.shared.report().status(place) {
        Status::Motor(status) => (status.setpoint.mode, status.setpoint.value, status.duty),
        other => panic!("{other:?}"),
    };
    assert_eq!(motor(Place::Motor(0)), (Mode::Duty, 0.5, 0.5));
    assert_eq!(motor(Place::Motor(4)), (Mode::Duty, -0.5, -0.5));
    assert_eq!(motor(Place::Motor(1)).2, 0.0);
    assert_eq!(motor(Place::Stepper(1)), (Mode::Speed, 3.0, 0.0));
    for (place, value) in [
        (Place::Servo(2), 0.5),
        (Place::Relay(1), 1.0),
        (Place::Relay(0), 1.0),
        (Place::Relay(2), 0.0),
        (Place::Dac(1), 2.5),
    ] {
        assert_eq!(bench.shared.report().status(place), Status::Scalar(value), "{place:?}");
    }
    assert!(matches!(bench.shared.report().status(Place::Servo(0)), Status::Scalar(angle) if angle.is_nan()));
    // A stop ends all of it; these servos are held.
    bench.shared.trip(Cause::HostStop);
    bench.advance(2);
    assert_eq!([chips[0], chips[1], servos].map(|chip| bench.pulsing(chip)), [0, 0, 1]);
    assert_eq!((bench.pins(), bench.inputs.steppers_enabled.get()), (before, false));
    assert_eq!(bench.inputs.dacs[1].get(), (1.65f32 / 3.3 * 4096.0).round() as u16);
    assert_eq!(bench.shared.report().status(Place::Dac(1)), Status::Scalar(1.65));
    let Status::Motor(stopped) = bench.shared.report().status(Place::Motor(0)) else { panic!("a motor") };
    assert_eq!((stopped.setpoint, stopped.duty), (Setpoint::NONE, 0.0));
}

/// Without a relay in the motors' supply, nothing waits for contacts.
#[test]
fn without_a_relay_in_their_supply_motors_are_driven_at_once() {
    let mut config = everything();
    config.relays.iter_mut().for_each(|relay| relay.role = RelayRole::General);
    let chip = config.osmc_pwm.expect("it has one").address;
    let mut bench = Bench::just_armed(config);
    bench.set(Place::Motor(0), Mode::Duty, 0.5);
    let before = bench.pins();
    bench.advance(3);
    assert!(bench.pulsing(chip) > 0);
    assert_eq!(bench.pins(), before);
}

/// A motor of 4.3 V s driven with 0.5 at 2 rad/s feeds its supply; half way from 28 to 30 V it no longer does: it gets
/// the duty of its back-EMF plus the dead zone of 0.4.
#[test]
fn a_supply_that_is_full_is_not_fed() {
    // Without range sensors: nothing pings them here.
    let mut bench = Bench::just_armed(BoardConfig { ranges: heapless::Vec::new(), ..everything() });
    bench.set(Place::Motor(0), Mode::Duty, 0.5);
    let mut turned = 0.0;
    for (volts, expected) in [(24.0, 0.5), (29.0, 0.4 + 4.3 * 2.0 / 29.0)] {
        bench.set_supply(0, volts);
        for _ in 0..500 {
            turned += 2.0 * 1e-3 * 2400.0 / core::f32::consts::TAU;
            bench.inputs.counts[0].set(turned as u16);
            bench.advance(1);
        }
        bench.is_armed();
        let Status::Motor(MotorStatus { duty, .. }) = bench.shared.report().status(Place::Motor(0)) else {
            panic!("a motor")
        };
        // Ripple of the measured speed, in whole counts per period.
        assert!((duty - expected).abs() < 0.02, "{duty}, not {expected}, at {volts} V");
    }
}

/// Steps that were queued and not made are miscounted; a queue without room makes pulses late; a search ends that has
/// gone further than the range without its switch.
#[test]
fn steppers_raise_their_causes() {
    for (mode, value, room, made, cause) in [
        (Mode::Position, 0.2, 1_000_000, 0, Cause::EncoderImplausible),
        (Mode::Speed, 3.0, 5, 0, Cause::ControlOverrun),
        (Mode::Home, 2.0, 1_000_000, 100_000, Cause::EncoderImplausible),
    ] {
        let mut bench = Bench::just_armed(BoardConfig { ranges: heapless::Vec::new(), ..everything() });
        bench.advance(60);
        bench.set(Place::Stepper(0), mode, value);
        bench.inputs.room.set(room);
        bench.advance(1);
        bench.is_armed();
        bench.inputs.made[0].set(made);
        assert!(bench.periods_until_tripped(2000) < 2000, "{mode:?}");
        bench.is_tripped_by(cause);
    }
}

/// Each trip is handed to the fault history once, in the period after it; without a storage task the third and later
/// ones are lost.
#[test]
fn every_trip_is_handed_to_the_fault_history() {
    let mut bench = Bench::armed();
    for lost in [0, 0, 1, 2] {
        // A trip before the first session, which no host could have armed, is not recorded.
        assert!(bench.shared.as_host().open_session(1, Instant::now()).is_ok());
        bench.shared.trip(Cause::HostStop);
        bench.advance(20);
        assert_eq!(bench.shared.storage.lost(), lost);
        assert_eq!(bench.shared.request(Event::Clear), Ok(()));
        bench.arm();
        bench.tasks.advance(POWER_UP);
    }
}

impl Bench {
    /// Bench with every kind of output, armed, with the motors' supply on, and without range sensors.
    fn with_everything() -> Self {
        let mut bench = Self::just_armed(BoardConfig { ranges: heapless::Vec::new(), ..everything() });
        bench.advance(60);
        bench
    }

    /// Advances to the beginning of the next period, whose work is then done: the bus takes no time.
    fn advance_to_period(&mut self) {
        let before = self.shared.report().stats().ticks;
        while self.shared.report().stats().ticks == before {
            self.tasks.advance(Duration::from_micros(50));
        }
    }

    #[track_caller]
    fn motor(&self, place: Place) -> MotorStatus {
        match self.shared.report().status(place) {
            Status::Motor(status) => status,
            other => panic!("{other:?}"),
        }
    }
}

/// With transfers that take a period each: a period that writes a motor takes exactly its time, one that also reads
/// back takes more, and the next begins where it ends. Ten of the former are no overrun.
#[test]
fn a_period_that_takes_just_its_time_is_not_late() {
    let mut bench = Bench::armed();
    // The duty takes 45 periods to arrive: a write in each.
    bench.drive(0, 0.9);
    bench.bus.slow_down(MS);
    let (begin, before) = (Instant::now(), bench.shared.report().stats());
    let since = |bench: &Bench| {
        let stats = bench.shared.report().stats();
        (stats.ticks - before.ticks, stats.late_ticks - before.late_ticks)
    };
    while since(&bench).0 < 16 {
        bench.advance(1);
    }
    bench.is_armed();
    assert_eq!(since(&bench), (16, 4), "each fourth reads back");
    assert!(begin.elapsed() >= MS * (12 + 4 * 2), "{:?}", begin.elapsed());
}

/// An arming that ends between two periods: the loop sees the next arming, but not the end of the one whose outputs it
/// drives.
#[test]
fn an_arming_that_was_ended_before_the_loop_could_look_ends_at_once() {
    let mut bench = Bench::with_everything();
    let open = bench.pins() | 1 << bench.shared.config().relays[0].bit;
    bench.set(Place::Relay(1), Mode::Switch, 1.0);
    bench.advance(2);
    bench.tasks.advance(Duration::from_micros(300));
    assert_ne!(bench.pins() & open, open);
    assert_eq!(bench.shared.request(Event::Disarm), Ok(()));
    bench.arm();
    bench.tasks.advance(Duration::from_micros(1));
    assert_eq!(bench.pins() & open, open);
}

/// An arming that ends while the loop reads its inputs: it sees only the arming that follows, and ends the other first.
#[test]
fn an_arming_that_was_ended_within_a_period_is_ended_there() {
    let mut bench = Bench::with_everything();
    let before = bench.pins();
    bench.set(Place::Relay(1), Mode::Switch, 1.0);
    bench.advance(2);
    assert_ne!(bench.pins(), before);
    let shared = bench.shared;
    bench.inputs.meanwhile.set(Some(Box::new(move || {
        assert_eq!(shared.request(Event::Disarm), Ok(()));
        assert_eq!(shared.request(Event::Arm), Ok(()));
    })));
    bench.advance(2);
    bench.is_armed();
    assert_eq!(bench.pins(), before, "the motors' supply is closed again, the other relay is not");
}

/// Relays except the motors' open and voltages go to rest at once, non-braking motors are turned off, and the duty of
/// braking ones falls at its slew limit to 0, where the bridge shorts the motor. At the end all is off.
#[test]
fn a_stop_that_brakes_goes_by_its_order() {
    let mut config = BoardConfig { ranges: heapless::Vec::new(), ..everything() };
    config.motors[0].stop_brake_ms = 400;
    let ramp_ms = 0.5 / config.motors[0].duty_slew_per_s * 1e3;
    let chips = [config.osmc_pwm, config.dhb_pwm].map(|pwm| pwm.expect("it has both").address);
    let mut bench = Bench::just_armed(config);
    let open = bench.pins();
    bench.advance(60);
    let powered = bench.pins();
    assert_ne!(powered, open);
    bench.set(Place::Motor(0), Mode::Duty, 0.5);
    bench.set(Place::Motor(4), Mode::Duty, -0.5);
    bench.set(Place::Relay(1), Mode::Switch, 1.0);
    bench.set(Place::Dac(1), Mode::Voltage, 2.5);
    bench.advance(200);
    let pulsing = |bench: &Bench| chips.map(|chip| bench.pulsing(chip));
    assert_eq!(pulsing(&bench), [3 + 3 * 2, 2 + 3]);
    assert_eq!(bench.shared.request(Event::Disarm), Ok(()));
    bench.advance(2);
    assert_eq!(bench.pins(), powered);
    assert_eq!(bench.shared.report().status(Place::Dac(1)), Status::Scalar(1.65));
    bench.advance((0.9 * ramp_ms) as u32 - 2);
    assert_eq!(pulsing(&bench), [3, 0]);
    bench.advance((0.1 * ramp_ms) as u32 + 5);
    assert_eq!(pulsing(&bench), [2, 0], "without its PWM");
    assert_eq!(bench.pins(), powered);
    bench.advance(400);
    assert_eq!((pulsing(&bench), bench.pins()), ([0, 0], open));
}

/// The transfer under way ends, and the next one opens the relays: nothing is read back before.
#[test]
fn a_stop_within_a_period_waits_for_one_transfer() {
    for phase in 0..4 {
        let mut bench = Bench::with_everything();
        let closed = bench.pins();
        bench.set(Place::Motor(0), Mode::Duty, 0.9);
        bench.advance(5 + phase);
        bench.advance_to_period();
        bench.bus.slow_down(Duration::from_micros(400));
        bench.tasks.advance(Duration::from_micros(1200));
        assert_eq!(bench.shared.request(Event::Disarm), Ok(()));
        bench.tasks.advance(Duration::from_micros(599));
        assert_eq!(bench.pins(), closed);
        bench.tasks.advance(Duration::from_micros(1));
        assert_ne!(bench.pins(), closed, "200 us for the one and 400 us for the other");
    }
}

/// DHB bridges go first in every second period; servos still get their turn.
#[test]
fn servos_are_written_in_every_period() {
    let mut bench = Bench::with_everything();
    let config = bench.shared.config();
    let (chip, output) = (config.servo_pwm.expect("it has one").address, config.servos[2].output);
    let pulse = |bench: &Bench| [2, 3].map(|byte| bench.bus.get(chip, 6 + 4 * output + byte));
    bench.set(Place::Servo(2), Mode::Position, 0.0);
    bench.advance(5);
    bench.set(Place::Servo(2), Mode::Position, 0.5);
    let mut written = [0; 2];
    for period in 0..50 {
        let before = pulse(&bench);
        bench.advance(1);
        written[period % 2] += u32::from(pulse(&bench) != before);
    }
    assert!(written.iter().all(|written| *written > 0), "{written:?}");
}

/// A search that has found its switch and come to rest has settled; neither one under way nor a stepper without a
/// command has.
#[test]
fn a_search_has_settled_where_it_found_its_place() {
    let mut bench = Bench::with_everything();
    bench.inputs.obedient.set(true);
    let switch = usize::from(bench.shared.config().steppers[0].homing.expect("it has a switch").switch);
    let status = |bench: &Bench| bench.motor(Place::Stepper(0));
    assert!(!status(&bench).settled);
    bench.set(Place::Stepper(0), Mode::Home, 2.0);
    let begin = status(&bench).position;
    let mut homed = false;
    for _ in 0..5000 {
        bench.advance(1);
        // The switch is 400 steps away and closes to a low level.
        bench.inputs.low[switch].set(bench.inputs.made[0].get() - begin >= 400);
        let now = status(&bench);
        assert!(!now.settled || now.homed, "while it searches");
        homed |= now.homed;
        if now.settled {
            break;
        }
    }
    bench.is_armed();
    let found = status(&bench);
    assert!(homed && found.settled && found.setpoint.mode == Mode::Home);
    let made = bench.inputs.made[0].get();
    bench.advance(20);
    assert_eq!((bench.inputs.made[0].get(), status(&bench).settled), (made, true), "at rest, and so it stays");
    // Homed, and yet not settled: it moves at a speed.
    bench.set(Place::Stepper(0), Mode::Speed, 1.0);
    bench.advance(20);
    assert!(status(&bench).homed && !status(&bench).settled);
    bench.set(Place::Stepper(0), Mode::Speed, 0.0);
    bench.advance(500);
    assert!(!status(&bench).settled, "no search");
}

/// The rated current at a sensor with an offset heats a winding to `1 - 0.2 exp(-t / thermal_s)` of the permitted heat.
#[test]
fn a_measured_current_is_reckoned_from_the_voltage_at_rest() {
    let sense = CurrentSense { analog: 0, zero_v: 1.5, volts_per_a: 0.1 };
    let mut config = everything();
    let winding = config.motors[0].winding.as_mut().expect("it has one");
    winding.current_sense = Some(sense);
    let (rated_a, thermal_s) = (winding.rated_a, winding.thermal_s);
    let mut bench = Bench::with(BoardConfig { ranges: heapless::Vec::new(), ..config });
    let analog = bench.shared.config().analogs[0];
    let volts = sense.zero_v + rated_a * sense.volts_per_a;
    bench.inputs.codes[0].set(((volts - analog.offset_v) / analog.volts_per_code) as u16);
    bench.advance(5000);
    let expected = 100.0 * (1.0 - 0.2 * (-5.0 / thermal_s).exp());
    let heat = bench.motor(Place::Motor(0)).winding.expect("it is computed").heat_percent;
    // Rounded down, and without the filter's first periods.
    assert!((expected - 1.5..=expected).contains(&f32::from(heat)), "{heat} %, not {expected} %");
}

/// While safe all transistors are off: a shaft turned from outside generates a voltage, and no current.
#[test]
fn a_shaft_that_is_turned_while_safe_warms_no_winding() {
    let mut bench = Bench::new();
    let thermal_s = bench.shared.config().motors[0].winding.expect("it has one").thermal_s;
    let mut turned = 0.0;
    for _ in 0..5000 {
        turned += 2.0 * 1e-3 * 2400.0 / core::f32::consts::TAU;
        bench.inputs.counts[0].set(turned as u16);
        bench.advance(1);
    }
    let status = bench.motor(Place::Motor(0));
    assert!((status.speed - 2.0).abs() < 0.1, "{status:?}");
    let expected = 80.0 * (-5.0 / thermal_s).exp();
    let heat = f32::from(status.winding.expect("it is computed").heat_percent);
    assert!((expected - 1.5..=expected + 0.1).contains(&heat), "{heat} %, not {expected} %");
}

/// An output that no bridge uses is never read back: if something turns it on, the rewritten safe state undoes that
/// every 16 periods, and not more often.
#[test]
fn the_safe_state_is_written_again_every_sixteenth_period() {
    let mut bench = Bench::new();
    bench.advance(20);
    let chip = bench.shared.config().osmc_pwm.expect("it has one").address;
    let used = |output: u8| {
        bench.shared.config().motors.iter().any(|motor| match motor.bridge {
            BridgeConfig::Osmc(lines) => lines.all().contains(&output),
            BridgeConfig::Dhb(_) => false,
        })
    };
    let register = 6 + 4 * (0..16).find(|output| !used(*output)).expect("it has 16") + 3;
    let mut written = heapless::Vec::<u32, 8>::new();
    for period in 0..48 {
        bench.bus.set(chip, register, 0);
        bench.advance(1);
        if bench.bus.get(chip, register) & 0x10 != 0 {
            assert!(written.push(period).is_ok(), "{written:?}");
        }
    }
    assert_eq!(written.len(), 3, "{written:?}");
    assert!(written.windows(2).all(|pair| pair[1] - pair[0] == 16), "{written:?}");
}

/// While safe, the DAC of brushless drives is read back every 16 periods, between two writes of the safe state; one of
/// the other chips in each other period.
#[test]
fn while_safe_every_chip_is_read_back() {
    // Without range sensors: nothing pings them here.
    let config = || BoardConfig { ranges: heapless::Vec::new(), ..robot("every-interface") };
    let dac = config().bldc_dac.expect("it has one").address;
    let mut bench = Bench::with(config());
    // Time for the write of its EEPROM, and for the oscillators to start.
    bench.advance(100);
    assert!(bench.shared.safety().causes.is_empty());
    // Lower byte of the first output's code, which is 0 at rest.
    let periods = (1..=20).find(|_| {
        bench.bus.set(dac, 2, 1);
        bench.advance(1);
        !bench.shared.safety().causes.is_empty()
    });
    bench.is_tripped_by(Cause::ReadBackMismatch);
    assert!(periods.is_some_and(|periods| periods <= 16), "{periods:?}");
    // Modes, directions and every line: fewer than 60 checks, one in 15 of 16 periods.
    for (chip, register) in [(EXPANDER, 0x00), (config().dhb_pwm.expect("it has one").address, 0x01)] {
        let mut bench = Bench::with(config());
        bench.advance(100);
        bench.bus.set(chip, register, bench.bus.get(chip, register) ^ 0x10);
        bench.advance(64);
        bench.is_tripped_by(Cause::ReadBackMismatch);
    }
}
