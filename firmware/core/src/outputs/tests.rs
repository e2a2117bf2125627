//! All outputs of a board that uses each kind, on chips that only store registers: the state after a stop, the writes
//! that go out in a period and those that wait.

extern crate std;

use core::{
    future::Future,
    pin::pin,
    task::{Context, Poll, Waker},
};
use std::vec::Vec;

use embassy_time::{Duration, Instant};
use r4_protocol::config::{BoardConfig, BridgeConfig, Reverse};

use super::{Order, OutputFault, Outputs, bldc::Command, sweep};
use crate::testing::{Registers, Tasks, robot};

/// Clock pulses that fit a period of 1 ms at 400 kHz: transfers may use 95 %.
const CLOCKS: u32 = 380;
/// Step of the test's clock, after which timers are polled.
const MOMENT: Duration = Duration::from_micros(5);

/// Polls a future to its result; time passes while it waits.
fn done<T>(future: impl Future<Output = T>) -> T {
    let mut future = pin!(future);
    loop {
        match future.as_mut().poll(&mut Context::from_waker(Waker::noop())) {
            Poll::Ready(done) => return done,
            Poll::Pending => Tasks::default().advance(MOMENT),
        }
    }
}

/// Configuration with every kind of output; servos get no pulses when safe.
fn everything() -> BoardConfig {
    let mut config = robot("every-interface");
    config.servo_pwm.as_mut().expect("it has one").hold_when_safe = false;
    config
}

fn pwm_chips(config: &BoardConfig) -> [u8; 3] {
    let bridges = [config.osmc_pwm, config.dhb_pwm].map(|chip| chip.expect("it has both").address);
    [bridges[0], bridges[1], config.servo_pwm.expect("it has one").address]
}

/// Register contents of the chips, interpreted by their data sheets.
struct Chips {
    bus: Registers,
    config: BoardConfig,
}

impl Chips {
    fn expander(&self) -> u8 {
        self.config.expander.expect("it has one").address
    }

    fn dac(&self) -> u8 {
        self.config.bldc_dac.expect("it has one").address
    }

    /// Output latches of the expander.
    fn pins(&self) -> u16 {
        u16::from_le_bytes([0x14, 0x15].map(|register| self.bus.get(self.expander(), register)))
    }

    /// Number of PWM outputs of a chip that are not off.
    fn pulsing(&self, chip: u8) -> usize {
        (0..16).filter(|output| self.bus.get(chip, 6 + 4 * output + 3) & 0x10 == 0).count()
    }

    /// Code with reference and gain bits of each brushless drive's voltage.
    fn codes(&self) -> Vec<u16> {
        let code = |output: u8| u16::from_be_bytes([1, 2].map(|byte| self.bus.get(self.dac(), 6 * output + byte)));
        self.config.bldcs.iter().map(|bldc| code(bldc.output)).collect()
    }

    /// Codes of the given voltages, V, by drive number.
    fn codes_of(&self, volts: impl Fn(usize) -> f32) -> Vec<u16> {
        let full_scale_v = self.config.bldc_dac.expect("it has one").full_scale_v;
        let code = |index| (volts(index) / full_scale_v * 4096.0).round() as u16;
        (0..self.config.bldcs.len()).map(code).collect()
    }

    /// Levels of the pins with these relays closed, these brakes applied, and direction lines as in `directions`.
    fn pins_of(&self, closed: impl Fn(usize) -> bool, braked: bool, directions: u16) -> u16 {
        let relays = self.config.relays.iter().enumerate();
        let relays = relays.map(|(index, relay)| (relay.bit, closed(index) != relay.active_low));
        let brakes = self.config.bldcs.iter().map(|bldc| bldc.brake.expect("it has one"));
        let brakes = brakes.map(|line| (line.bit, braked != line.active_low));
        let turns = self.config.bldcs.iter().map(|bldc| match bldc.reverse {
            Reverse::Line { line, .. } => (line.bit, directions >> line.bit & 1 != 0),
            other => panic!("{other:?}"),
        });
        relays.chain(brakes).chain(turns).fold(0, |pins, (bit, high)| pins | u16::from(high) << bit)
    }

    /// Sets all chips as a reset of the processor at full speed leaves them: every PWM output on, relays closed, drives
    /// backwards with their brakes released. The DAC has its internal reference doubled, as on no board of ours.
    fn run_away(&self) {
        for chip in pwm_chips(&self.config) {
            for output in 0..16 {
                [0, 0x10, 0, 0].iter().zip(6 + 4 * output..).for_each(|(byte, register)| {
                    self.bus.set(chip, register, *byte);
                });
            }
        }
        let backwards = u16::MAX;
        let [low, high] = self.pins_of(|_| true, false, backwards).to_le_bytes();
        [(0x00, 0), (0x01, 0), (0x14, low), (0x15, high)].into_iter().for_each(|(register, value)| {
            self.bus.set(self.expander(), register, value);
        });
        for bldc in &self.config.bldcs {
            self.bus.set(self.dac(), 6 * bldc.output + 1, 0x9F);
            self.bus.set(self.dac(), 6 * bldc.output + 2, 0xFF);
        }
    }

    /// Addresses of the chips that are not safe. Direction lines must be unchanged.
    fn unsafe_chips(&self, directions: u16) -> Vec<u8> {
        let mut found: Vec<u8> = pwm_chips(&self.config).into_iter().filter(|chip| self.pulsing(*chip) > 0).collect();
        if self.pins() != self.pins_of(|_| false, true, directions) {
            found.push(self.expander());
        }
        if self.codes() != self.codes_of(|index| self.config.bldcs[index].neutral_v) {
            found.push(self.dac());
        }
        found
    }
}

/// After a reset every chip still has its last outputs: the sweep ends all of them, and a chip that does not answer
/// does not protect any other.
#[test]
fn a_sweep_makes_every_chip_safe_that_answers() {
    let config = everything();
    let [osmc, dhb, servo] = pwm_chips(&config);
    let chips = |config: &BoardConfig| {
        let chips = Chips { bus: Registers::default(), config: config.clone() };
        chips.run_away();
        chips
    };
    let swept = chips(&config);
    let [expander, dac] = [swept.expander(), swept.dac()];
    assert_eq!(swept.unsafe_chips(u16::MAX), [osmc, dhb, servo, expander, dac]);
    // The first transfer is acknowledged at its third try.
    swept.bus.fail(2);
    assert_eq!(done(sweep(swept.bus.clone(), &config)), Ok(()));
    assert_eq!(swept.unsafe_chips(u16::MAX), []);
    for chip in [osmc, dhb, servo, expander, dac] {
        let swept = chips(&config);
        swept.bus.mute(chip);
        assert_eq!(done(sweep(swept.bus.clone(), &config)), Err(OutputFault::Bus), "{chip:#x}");
        assert_eq!(swept.unsafe_chips(u16::MAX), [chip]);
    }
    // Held servos are left alone.
    let held = chips(&robot("every-interface"));
    assert_eq!(done(sweep(held.bus.clone(), &held.config)), Ok(()));
    assert_eq!(held.unsafe_chips(u16::MAX), [servo]);
}

/// Outputs and the chips behind them.
struct Rig {
    outputs: Outputs<Registers>,
    chips: Chips,
    tasks: Tasks,
    periods: u32,
}

impl Rig {
    fn new(config: BoardConfig) -> Self {
        assert_eq!(config.validate(), Ok(()));
        let chips = Chips { bus: Registers::default(), config };
        // After power-up all pins of the expander are inputs.
        [0x00, 0x01].into_iter().for_each(|register| chips.bus.set(chips.expander(), register, 0xFF));
        let mut outputs = Outputs::new(chips.bus.clone(), &chips.config);
        assert_eq!(done(outputs.init()), Ok(()));
        Self { outputs, chips, tasks: Tasks::default(), periods: 0 }
    }

    /// Rig with everything driven: motors at half of their supply, drives forwards, servos on their way, relays closed.
    fn running() -> Self {
        let mut rig = Self::new(everything());
        (0..rig.chips.config.relays.len()).for_each(|index| rig.outputs.switch(index, true));
        rig.command_all(1.0, 0.7);
        for _ in 0..2000 {
            rig.period(|_| 0.5);
        }
        rig
    }

    fn command_all(&mut self, share: f32, angle: f32) {
        (0..self.chips.config.bldcs.len()).for_each(|index| self.outputs.command_drive(index, Command::Run(share)));
        (0..self.chips.config.servos.len()).for_each(|index| self.outputs.command_servo(index, angle));
    }

    /// Runs one control period with the duty for each motor; returns the duties applied and the number of clock pulses.
    fn period(&mut self, duty: impl Fn(usize) -> f32) -> (Vec<f32>, u32) {
        let before = self.chips.bus.clocks();
        self.tasks.advance(Duration::from_micros(self.chips.config.control_period_us.into()));
        self.periods += 1;
        let outputs = &mut self.outputs;
        outputs.begin_tick();
        outputs.step_drives();
        outputs.step_servos();
        assert_eq!(done(outputs.write_expander()), Ok(()));
        let mut applied = [0.0; 8];
        let [osmc, dhb] = outputs.order();
        osmc.for_each(|index| applied[index] = outputs.drive(index, duty(index)));
        if self.periods % 2 == 1 {
            outputs.write_drives();
            outputs.write_servos();
        }
        dhb.for_each(|index| applied[index] = outputs.drive(index, duty(index)));
        if self.periods.is_multiple_of(2) {
            outputs.write_drives();
            outputs.write_servos();
        }
        let check = outputs.reserve_check();
        assert_eq!(done(outputs.flush(|_| false)), Ok(true));
        if check {
            assert_eq!(done(outputs.check_next()), Ok(()));
        }
        (applied[..self.chips.config.motors.len()].to_vec(), self.chips.bus.clocks() - before)
    }

    /// Runs a period of the servos alone and returns the number of servos written.
    fn servo_period(&mut self, taken: Duration) -> u32 {
        let before = self.chips.bus.clocks();
        self.outputs.begin_tick();
        self.outputs.bus().leave_time(taken);
        self.outputs.step_servos();
        self.outputs.write_servos();
        assert_eq!(done(self.outputs.flush(|_| false)), Ok(true));
        // A write has the address, a register, and two bytes of a count.
        (self.chips.bus.clocks() - before) / (9 * 4)
    }
}

/// Voltages rise to full speed, brakes are released, relays close, bridges and servos get their pulses. The safe state
/// ends all of that; the direction lines stay.
#[test]
fn everything_that_runs_is_ended_by_the_safe_state() {
    let mut rig = Rig::running();
    let chips = &rig.chips;
    let forwards = chips.pins();
    assert_eq!(forwards, chips.pins_of(|_| true, false, forwards));
    assert_eq!(chips.codes(), chips.codes_of(|index| chips.config.bldcs[index].forward_v));
    assert_eq!(rig.outputs.drive_shares().collect::<Vec<_>>(), [1.0; 4]);
    // An OSMC has both high sides and the PWM on, a DHB enable and PWM.
    assert_eq!(pwm_chips(&chips.config).map(|chip| chips.pulsing(chip)), [4 * 3, 4 * 2, 16]);
    assert_eq!(done(rig.outputs.make_safe()), Ok(()));
    assert_eq!(rig.chips.unsafe_chips(forwards), []);
    // It stays ended in the following periods.
    for _ in 0..10 {
        rig.period(|_| 0.0);
    }
    assert_eq!(rig.chips.pins(), rig.chips.pins_of(|_| false, true, forwards));
    assert_eq!(rig.chips.codes(), rig.chips.codes_of(|index| rig.chips.config.bldcs[index].neutral_v));
}

/// Drives, servos and relays are as when safe, except the relay of the motors' supply; bridges continue and are braked
/// in steps.
#[test]
fn a_stop_that_brakes_ends_all_but_bridges_and_their_supply() {
    let mut rig = Rig::running();
    let [osmc, dhb, servo] = pwm_chips(&rig.chips.config);
    let forwards = rig.chips.pins();
    let before = [osmc, dhb].map(|chip| rig.chips.pulsing(chip));
    assert_eq!(done(rig.outputs.brake()), Ok(()));
    assert_eq!(rig.chips.pins(), rig.chips.pins_of(|index| index == 0, true, forwards));
    assert_eq!(rig.chips.codes(), rig.chips.codes_of(|index| rig.chips.config.bldcs[index].neutral_v));
    assert_eq!([osmc, dhb, servo].map(|chip| rig.chips.pulsing(chip)), [before[0], before[1], 0]);
}

/// None of these motors brakes: each period turns off as many as fit it, and the result becomes true when all are off.
#[test]
fn bridges_that_do_not_brake_are_turned_off_within_periods() {
    let mut rig = Rig::running();
    let [osmc, dhb, _] = pwm_chips(&rig.chips.config);
    let pulsing = |rig: &Rig| rig.chips.pulsing(osmc) + rig.chips.pulsing(dhb);
    let mut last = pulsing(&rig);
    // Each period has room for two of the eight.
    for period in 0..4 {
        let before = rig.chips.bus.clocks();
        rig.outputs.begin_tick();
        let all_off = done(rig.outputs.step_brakes()).expect("the bus works");
        assert!(rig.chips.bus.clocks() - before <= CLOCKS, "period {period}");
        assert_eq!(all_off, pulsing(&rig) == 0);
        assert!(pulsing(&rig) < last);
        last = pulsing(&rig);
    }
    assert_eq!(last, 0);
}

/// While everything moves and relays switch, no period exceeds its bus time, and waiting writes are caught up with.
#[test]
fn what_goes_out_in_a_period_fits_it_and_nothing_is_left_behind() {
    let mut rig = Rig::new(everything());
    let wave = |period: u32, motor: usize| 0.8 * (period as f32 / (20.0 + motor as f32)).sin();
    rig.command_all(1.0, 0.7);
    for period in 0..1000 {
        rig.outputs.switch(1, period % 50 < 25);
        if period % 200 == 100 {
            rig.command_all(1.0, -0.7);
        } else if period % 200 == 0 {
            rig.command_all(1.0, 0.7);
        }
        let (_, clocks) = rig.period(|motor| wave(period, motor));
        assert!(clocks <= CLOCKS, "{clocks} clock pulses in period {period}");
    }
    let duty = |motor| wave(1000, motor);
    let last = (0..1000).map(|_| rig.period(duty).0).last();
    assert_eq!(last, Some((0..8).map(duty).collect()));
    assert_eq!(rig.chips.codes(), rig.chips.codes_of(|index| rig.chips.config.bldcs[index].forward_v));
    assert_eq!(rig.servo_period(Duration::MIN), 0, "all are where they were sent");
}

/// On the slowest bus allowed for such a board, three of four bridges fit a period: none waits for longer than one
/// period.
#[test]
fn bridges_that_had_to_wait_go_first() {
    let mut config = everything();
    config.motors.retain(|motor| matches!(motor.bridge, BridgeConfig::Dhb(_)));
    config.i2c_hz = 136_000;
    let mut rig = Rig::new(BoardConfig { bldcs: heapless::Vec::new(), bldc_dac: None, ..config });
    (0..100).for_each(|_| _ = rig.period(|_| 0.1));
    let mut waited = [0; 4];
    for period in 1..=100 {
        let duty = 0.1 + period as f32 * 1e-3;
        let (applied, _) = rig.period(|_| duty);
        for (waited, applied) in waited.iter_mut().zip(applied) {
            *waited = if applied == duty { 0 } else { *waited + 1 };
            assert!(*waited <= 1, "in period {period}");
        }
    }
}

/// Periods of 3.75 ms have the writes of three of 16 servos, so that each moving servo is written every 20 ms. After a
/// time without room the writes of eight periods are due and go out twice as fast; a servo that moves alone is written
/// once in each period.
#[test]
fn servos_that_had_to_wait_are_caught_up_with() {
    let mut rig = Rig::new(BoardConfig { control_period_us: 3750, ..everything() });
    rig.command_all(0.0, 0.7);
    (0..20).for_each(|_| _ = rig.servo_period(Duration::MIN));
    rig.command_all(0.0, -0.7);
    assert_eq!([Duration::MIN; 5].map(|taken| rig.servo_period(taken)), [3; 5]);
    assert_eq!([Duration::from_secs(1); 20].map(|taken| rig.servo_period(taken)), [0; 20]);
    assert_eq!([Duration::MIN; 10].map(|taken| rig.servo_period(taken)), [6, 6, 6, 6, 6, 6, 6, 3, 3, 3]);
    (0..200).for_each(|_| _ = rig.servo_period(Duration::MIN));
    rig.outputs.command_servo(3, 0.7);
    assert_eq!([Duration::MIN; 10].map(|taken| rig.servo_period(taken)), [1; 10]);
}

/// The write of a servo takes at most 39 bits: 36 clock pulses, START, STOP and the pause behind it.
#[test]
fn a_servo_is_written_where_there_is_just_room_for_it() {
    for (taken_us, written) in [(427, 1), (428, 0)] {
        let mut rig = Rig::new(everything());
        rig.command_all(0.0, 0.7);
        // The bus has 400 bits per ms, and each microsecond taken counts twice.
        assert_eq!(rig.servo_period(Duration::from_micros(taken_us)), written, "{taken_us} us taken");
    }
}

/// A write dropped by a stop has not happened: it is sent in the next period.
#[test]
fn what_a_stop_leaves_off_is_as_before() {
    let mut rig = Rig::new(everything());
    let osmc = pwm_chips(&rig.chips.config)[0];
    rig.tasks.advance(Duration::from_millis(10));
    rig.outputs.begin_tick();
    assert_eq!([0, 1].map(|index| rig.outputs.drive(index, 0.5)), [0.5; 2]);
    let mut asked = 0;
    let stop = |_: &mut Context<'_>| {
        asked += 1;
        asked > 1
    };
    assert_eq!(done(rig.outputs.flush(stop)), Ok(false));
    assert_eq!(rig.chips.pulsing(osmc), 3, "the first was under way");
    assert_eq!(done(rig.outputs.flush(|_| false)), Ok(true));
    assert_eq!(rig.chips.pulsing(osmc), 3, "the other is forgotten");
    rig.outputs.begin_tick();
    assert_eq!([0, 1].map(|index| rig.outputs.drive(index, 0.5)), [0.5; 2]);
    assert_eq!(done(rig.outputs.flush(|_| false)), Ok(true));
    assert_eq!(rig.chips.pulsing(osmc), 6);
}

/// Each write has three tries of its own, and each repeat is counted.
#[test]
fn every_write_of_a_period_has_three_tries() {
    let mut rig = Rig::new(everything());
    rig.tasks.advance(Duration::from_millis(10));
    rig.chips.bus.stutter(2);
    rig.outputs.begin_tick();
    assert_eq!([0, 1].map(|index| rig.outputs.drive(index, 0.5)), [0.5; 2]);
    assert_eq!(done(rig.outputs.flush(|_| false)), Ok(true));
    assert_eq!((rig.outputs.take_retries(), rig.chips.bus.recoveries()), (4, 4));
    rig.chips.bus.stutter(3);
    rig.outputs.begin_tick();
    assert_eq!([0, 1].map(|index| rig.outputs.drive(index, 0.6)), [0.6; 2]);
    assert_eq!(done(rig.outputs.flush(|_| false)), Err(OutputFault::Bus));
    assert_eq!(rig.outputs.take_retries(), 2);
}

/// Four bridges reverse at once on a bus of 100 kHz: 0.36 ms per write, plus START and STOP. Each rests two PWM periods
/// from the end of its own pulses, not from the end of the last write.
#[test]
fn a_bridge_rests_from_its_own_write_on() {
    const TRANSFER: Duration = Duration::from_micros(375);
    let mut rig = Rig::new(BoardConfig { control_period_us: 10_000, i2c_hz: 100_000, ..everything() });
    let rest_us = 2e6 / rig.chips.config.osmc_pwm.expect("it has one").frequency_hz;
    (0..5).for_each(|_| _ = rig.period(|index| if index < 4 { 0.5 } else { 0.0 }));
    rig.chips.bus.slow_down(TRANSFER);
    rig.outputs.begin_tick();
    (0..4).for_each(|index| assert_eq!(rig.outputs.drive(index, -0.5), 0.0));
    let begin = Instant::now();
    assert_eq!(done(rig.outputs.flush(|_| false)), Ok(true));
    let mut rested = [None; 4];
    while begin.elapsed() < Duration::from_millis(10) {
        rig.outputs.begin_tick();
        for (index, rested) in rested.iter_mut().enumerate() {
            if rested.is_none() && rig.outputs.drive(index, -0.5) == -0.5 {
                *rested = Some(begin.elapsed());
            }
        }
        rig.tasks.advance(MOMENT);
    }
    for (rested, number) in rested.into_iter().flatten().zip(1..) {
        let since_us = (rested - TRANSFER * number).as_micros() as f32;
        // Later by START and STOP of the writes behind it, whose time is not known exactly, and by one step of the
        // test's clock.
        let most_us = rest_us + 15.0 * (4 - number) as f32 + 2.0 * MOMENT.as_micros() as f32;
        assert!((rest_us - 1.0..=most_us).contains(&since_us), "write {number}: {since_us} us, {rest_us} us at least");
    }
}

/// At 400 kHz there are 400 bits per ms, 380 of them for transfers.
#[test]
fn a_processor_that_takes_long_leaves_transfers_less() {
    let mut outputs = Outputs::new(Registers::default(), &robot("every-interface"));
    let mut left_after = |taken_us| {
        outputs.begin_tick();
        outputs.bus().leave_time(Duration::from_micros(taken_us));
        outputs.bus().bits_left()
    };
    assert_eq!([0, 20, 475, 476, 3_600_000_000].map(&mut left_after), [380, 364, 0, 0, 0]);
    assert_eq!(left_after(0), 380, "it is the period's alone");
}

#[test]
fn an_order_begins_with_the_first_and_has_each_bridge_once() {
    let order = |left, first| Order { left, first }.collect::<Vec<_>>();
    assert_eq!(order(0b1111, 0), [0, 1, 2, 3]);
    assert_eq!(order(0b1111, 2), [2, 3, 0, 1]);
    assert_eq!(order(0b1000_0011, 1), [1, 7, 0]);
    assert_eq!(order(0b1010_0000, 7), [7, 5]);
    assert_eq!(order(0, 3), []);
}
