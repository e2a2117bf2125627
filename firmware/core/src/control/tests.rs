//! Whether each cause that the control loop sees is raised, when, and by nothing less: [`run`] beside the supervisor, on chips
//! that only remember.

use embassy_time::{Duration, Instant};
use r4_protocol::{
    Cause, Causes, Mode, SafetyState, Setpoint,
    config::{BoardConfig, Place},
};

use super::{BoardIo, run};
use crate::{
    ResetCause,
    safety::{Event, SafetyPins, supervise},
    testing::{Board, Line, Peripherals, Registers, Tasks, board, robot},
};

const MS: Duration = Duration::from_millis(1);
/// From arming on: the motors' supply closes, and drivers are given time.
const POWER_UP: Duration = Duration::from_millis(51);
const EXPANDER: u8 = 0x20;

/// The bench with its two motors, on a bus that takes no time.
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
        // The actuator's wiper, in the middle.
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

    /// Armed, and the motors' supply is on.
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

    /// Periods until the board is not armed any more.
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
        assert_eq!(self.shared.command(Place::Motor(motor), setpoint, Instant::now().as_micros()), Ok(()));
    }
}

/// A transfer is repeated twice, after the bus was freed each time; the third failure in a row is a fault.
#[test]
fn three_failures_in_a_row_are_an_i2c_fault() {
    let mut bench = Bench::armed();
    bench.bus.fail(2);
    bench.advance(20);
    bench.is_armed();
    assert_eq!((bench.bus.recoveries(), bench.shared.stats().bus_retries), (2, 2));
    let mut bench = Bench::armed();
    bench.bus.fail(3);
    bench.advance(20);
    bench.is_tripped_by(Cause::I2cFault);
    // The chips are set up again, and then it can be left.
    assert_eq!(bench.shared.request(Event::Clear), Ok(()));
    bench.arm();
    bench.advance(20);
    bench.is_armed();
}

/// The supervisor knows of it before the period with the failure ends.
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

/// Every register that keeps an output where it should be: the relays' latches and directions, mode and prescaler of the
/// bridges' PWM chip, the lines of each bridge. One that changes by itself is found while armed within 64 periods.
#[test]
fn a_register_that_changes_by_itself_is_a_mismatch() {
    let bridges = robot("osmc-bench").osmc_pwm.expect("it has bridges").address;
    let expander = robot("osmc-bench").expander.map_or(EXPANDER, |expander| expander.address);
    let [off_of_first_line, mode1, mode2, prescale] = [6 + 3, 0x00, 0x01, 0xFE];
    for (chip, register, flip) in [
        (expander, 0x00, 0x01),
        (expander, 0x01, 0x80),
        (expander, 0x14, 0x04),
        (expander, 0x15, 0x04),
        (bridges, mode1, 0x10),
        (bridges, mode2, 0x10),
        (bridges, prescale, 0x01),
        (bridges, off_of_first_line, 0x10),
    ] {
        let mut bench = Bench::armed();
        bench.bus.set(chip, register, bench.bus.get(chip, register) ^ flip);
        assert!(bench.periods_until_tripped(64) < 64, "{chip:#x} {register:#x}");
        bench.is_tripped_by(Cause::ReadBackMismatch);
        // Setting up again has put it right.
        bench.advance(20);
        assert_eq!(bench.shared.request(Event::Clear), Ok(()), "{chip:#x} {register:#x}");
    }
}

/// Each rail at both ends of its range, by itself; it is judged smoothed by 10 ms.
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

/// An encoder that shows more than four times the highest speed, and eight counts, within a period has jumped: of 2400
/// counts to a turn and 5 rad/s that is 15.6 counts.
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

/// Stall duty 0.8 for 300 ms without 0.02 rad, which is 7.6 counts: on the way to 0.9 at 20/s it is passed after 40 ms.
#[test]
fn a_motor_that_is_driven_hard_and_stands_is_stalled() {
    let mut bench = Bench::armed();
    bench.drive(0, 0.9);
    let periods = bench.periods_until_tripped(1000);
    bench.is_tripped_by(Cause::Stalled);
    // The command is taken in the first, and 300 sums of 1 ms in f32 may be short of 300 ms by one.
    assert!((341..=342).contains(&periods), "{periods}");
    // One that moves just enough is not, and one that is driven less hard is not either.
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

/// It must come round within 150 ms, and then not go 0.02 rad further against its drive.
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
    // 40 ms to the stall's duty, 150 ms to come round, 8 counts of 4 ms.
    assert!(periods.is_some_and(|periods| (220..=224).contains(&periods)), "{periods:?}");
}

/// Ten late periods in a row are an overrun; nine are counted only.
#[test]
fn ten_late_periods_in_a_row_are_an_overrun() {
    let mut bench = Bench::armed();
    bench.drive(0, 0.1);
    bench.bus.slow_down(Duration::from_micros(2100));
    let before = bench.shared.stats().late_ticks;
    let begin = Instant::now();
    while bench.shared.safety().state == SafetyState::Armed && begin.elapsed() < MS * 1000 {
        bench.advance(1);
        // Something to write in each period.
        let _ = bench.shared.command(
            Place::Motor(0),
            Setpoint { mode: Mode::Duty, value: 0.1 + begin.elapsed().as_millis() as f32 * 1e-3 },
            Instant::now().as_micros(),
        );
    }
    bench.is_tripped_by(Cause::ControlOverrun);
    assert_eq!(bench.shared.stats().late_ticks - before, 10);
}

#[test]
fn with_a_bad_configuration_nothing_is_driven() {
    let mut bench = Bench::with(BoardConfig { i2c_hz: 0, ..robot("osmc-bench") });
    bench.advance(100);
    bench.is_tripped_by(Cause::BadConfiguration);
    assert!(bench.shared.request(Event::Clear).is_err());
}

/// Half the supply at an actuator that does not move, below the duty of a stall: `(0.5 - 0.15) 12 V / 2 ohm` are 1.4 times what
/// its winding withstands, for `60 s ln((1.96 - 0.8) / (1.96 - 1))`.
#[test]
fn a_winding_that_is_too_hot_trips_and_has_to_cool() {
    let mut bench = Bench::armed();
    bench.drive(1, 0.5);
    let expected_s = 60.0 * ((1.96_f64 - 0.8) / (1.96 - 1.0)).ln();
    let after_s = f64::from(bench.periods_until_tripped(20_000)) * 1e-3;
    // The supply's codes and the slew to the duty, 25 ms.
    assert!((expected_s..expected_s + 0.1).contains(&after_s), "{after_s} s, not {expected_s} s");
    bench.is_tripped_by(Cause::Overload);
    // 60 s ln(1 / 0.8) are 13.4 s; being disarmed or asked changes nothing.
    bench.advance(13_000);
    assert!(bench.shared.request(Event::Clear).is_err());
    bench.advance(500);
    assert_eq!(bench.shared.request(Event::Clear), Ok(()));
    // What it has then is what a restarted board starts with.
    bench.arm();
    bench.tasks.advance(POWER_UP);
    bench.drive(1, 0.5);
    let again_s = f64::from(bench.periods_until_tripped(20_000)) * 1e-3;
    assert!((expected_s - 0.1..=expected_s + 0.3).contains(&again_s), "{again_s} s");
}

/// A dead track beside the other's edges: ten transitions that no shaft makes, in a tenth of a second.
#[test]
fn illegal_transitions_at_a_rate_are_implausible() {
    let mut bench = Bench::armed();
    let mut illegal = 0;
    // One each 20 ms, for a second: dirt on the disc.
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
        let stats = bench.shared.stats();
        (stats.worst_tick_cycles, stats.ticks_over_share)
    };
    assert_eq!(counted(&bench), (0, 0));
    for (taken, expected) in [(40, (40, 0)), (41, (41, 1)), (7, (41, 1)), (300, (300, 2))] {
        bench.inputs.cycles.set(bench.inputs.cycles.get().wrapping_add(taken));
        bench.advance(1);
        assert_eq!(counted(&bench), expected);
    }
}
