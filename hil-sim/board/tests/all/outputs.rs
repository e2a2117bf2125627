//! Driver of the PWM chip and the rules of the bridges, against the models of both and on the wire.
//!
//! Register numbers are literal values of the PCA9685 datasheet, section 7.3; the driver's own constants are not used.

use std::{cell::RefCell, rc::Rc};

use crate::harness::{ALL_OFF, LINEAR, MS, ROTARY, US, bench, bench_with_misuse, lines_of, osmc_bench, pwm_of};
use embedded_hal::i2c::{Error, ErrorKind, ErrorType, Operation};
use embedded_hal_async::i2c::I2c;
use proptest::prelude::*;
use r4_firmware::{
    chips::{ChipError, pca9685::Pca9685},
    outputs::{OutputFault, Outputs},
    platform::Bus,
};
use r4_protocol::{
    Cause, Causes, Mode, SafetyState,
    config::{BoardConfig, BridgeConfig, BridgeLines, MotorConfig},
};
use r4_sim::{
    Clock, Simulation,
    chips::{Line, pca9685 as chip},
    devices::osmc::{BridgeInputs, OsmcBridge},
    i2c::{Disturbance, Fault, I2cBus, Injection, Span, WireRecord},
};

const MODE1: u8 = 0x00;
const MODE2: u8 = 0x01;
const PRE_SCALE: u8 = 0xFE;
const LED0_ON_L: u8 = 0x06;
/// MODE1 after set-up: awake, auto-increment, All Call.
const RUNNING: u8 = 0x21;
/// MODE2 after set-up: totem pole, outputs change on STOP.
const TOTEM_POLE: u8 = 0x04;
/// Prescaler for the highest frequency, 25 MHz / 4096 / (3 + 1) = 1526 Hz.
const FASTEST: u8 = 3;
/// PWM period at that prescaler, ns: 4096 · 4 / 25 MHz.
const PWM_PERIOD_NS: u64 = 655_360;
/// Number of read-backs for one round: the mode, the relays, and four lines of each of two bridges.
const CHECKS: u64 = 10;

fn osmc_lines(motor: &MotorConfig) -> BridgeLines {
    let BridgeConfig::Osmc(lines) = motor.bridge else { panic!("{} is on no OSMC", motor.id) };
    lines
}

/// A bus with one PWM chip and the bridges of the bench, which are never disabled.
struct Rig {
    clock: Clock,
    bus: I2cBus,
    chip: Rc<RefCell<chip::Pca9685>>,
    bridges: Vec<(BridgeLines, OsmcBridge)>,
    /// Every state of the chip's outputs since power-up, with its start time.
    history: Vec<(u64, [Line; 16])>,
}

impl Rig {
    fn new(clock: Clock, config: &BoardConfig) -> Self {
        let mut bus = I2cBus::new(400_000);
        bus.set_trace(10_000);
        let chip = Rc::new(RefCell::new(chip::Pca9685::new(pwm_of(&mut config.clone()).address, 25_000_000)));
        bus.attach(chip.clone());
        let bridges = config.motors.iter().zip(0..).map(|(motor, number)| (osmc_lines(motor), OsmcBridge::new(number)));
        Self { clock, bus, chip, bridges: bridges.collect(), history: vec![(0, [Line::Low; 16])] }
    }

    /// Advances chip and bridges to the clock's time, change by change.
    fn catch_up(&mut self) {
        let now_ns = self.clock.now_ns();
        loop {
            let change_ns = self.chip.borrow().next_change_ns().filter(|at_ns| *at_ns <= now_ns);
            self.chip.borrow_mut().advance(change_ns.unwrap_or(now_ns));
            self.look(change_ns.unwrap_or(now_ns));
            if change_ns.is_none() {
                return;
            }
        }
    }

    fn look(&mut self, at_ns: u64) {
        let chip = self.chip.borrow();
        if self.history.last().is_none_or(|(_, lines)| lines != chip.lines()) {
            self.history.push((at_ns, *chip.lines()));
        }
        let line = |output: u8| chip.line(output.into());
        for (lines, bridge) in &mut self.bridges {
            let BridgeLines { ahi, ali, bhi, bli } = *lines;
            let inputs =
                BridgeInputs { ahi: line(ahi), ali: line(ali), bhi: line(bhi), bli: line(bli), disabled: false };
            bridge.update(at_ns, &inputs, chip.pwm_period_ns(), 12.0);
        }
    }

    /// All misuses of chip and bridges.
    fn misuse(&self) -> Vec<String> {
        let (chip, bridges) = (self.chip.borrow(), self.bridges.iter().map(|(_, bridge)| bridge.misuse()));
        let logs = [self.bus.misuse(), chip.misuse()].into_iter().chain(bridges);
        logs.flat_map(|log| log.first()).map(ToString::to_string).collect()
    }

    fn register(&self, register: u8) -> u8 {
        self.chip.borrow().register(register).expect("the chip has it")
    }
}

/// Controller on the rig's bus.
#[derive(Clone)]
struct RigBus(Rc<RefCell<Rig>>);

#[derive(Debug)]
struct RigError;

impl Error for RigError {
    fn kind(&self) -> ErrorKind {
        ErrorKind::Other
    }
}

impl ErrorType for RigBus {
    type Error = RigError;
}

impl I2c for RigBus {
    async fn transaction(&mut self, address: u8, operations: &mut [Operation<'_>]) -> Result<(), RigError> {
        let (clock, start_ns, end_ns) = {
            let rig = self.0.borrow();
            let start_ns = rig.bus.earliest_start_ns(rig.clock.now_ns());
            (rig.clock.clone(), start_ns, start_ns + rig.bus.planned_duration_ns(operations))
        };
        clock.sleep_until(end_ns).await;
        let result = {
            let mut rig = self.0.borrow_mut();
            rig.catch_up();
            let result = rig.bus.execute(start_ns, address, operations);
            rig.catch_up();
            result
        };
        if let Err(Fault::StuckLow { .. }) = result {
            // time-out of the controller; any duration serves
            clock.sleep(MS).await;
        }
        result.map(|_| ()).map_err(|_| RigError)
    }
}

impl Bus for RigBus {
    async fn recover(&mut self) {
        let (clock, end_ns) = {
            let mut rig = self.0.borrow_mut();
            let now_ns = rig.clock.now_ns();
            (rig.clock.clone(), rig.bus.recover(now_ns).end_ns)
        };
        clock.sleep_until(end_ns).await;
    }
}

/// The bench without its relays: the rig has only the PWM chip.
fn rig_config() -> BoardConfig {
    let mut config = osmc_bench().config;
    config.relays.clear();
    config.expander = None;
    config
}

/// Runs `work` with a rig that was just powered up.
fn on_rig<T>(work: impl AsyncFnOnce(RigBus, Clock) -> T) -> T {
    let mut simulation = Simulation::default();
    let clock = simulation.clock();
    let rig = Rc::new(RefCell::new(Rig::new(clock.clone(), &rig_config())));
    simulation.block_on(work(RigBus(rig), clock)).expect("time goes on")
}

/// As [`on_rig`], with outputs that are set up.
fn with_outputs<T>(work: impl AsyncFnOnce(&mut Outputs<RigBus>, &RigBus, &Clock) -> T) -> T {
    on_rig(async |bus, clock| {
        let mut outputs = Outputs::new(bus.clone(), &rig_config());
        outputs.init().await.expect("nothing is wrong");
        work(&mut outputs, &bus, &clock).await
    })
}

/// Commands `duty` for one bridge; returns the duty that was set on the way to it.
async fn drive(outputs: &mut Outputs<RigBus>, index: usize, duty: f32) -> Result<f32, OutputFault> {
    let applied = outputs.drive(index, duty);
    outputs.flush(|_| false).await.map(|_| applied)
}

fn driver() -> Pca9685 {
    let config = *pwm_of(&mut osmc_bench().config);
    Pca9685::new(config.address, config.frequency_hz)
}

/// Any write to any register of the chip, except EXTCLK (MODE1 bit 6): it stays until the supply is cycled, see
/// `an_external_clock_is_reported`.
fn any_write() -> impl Strategy<Value = [u8; 2]> {
    let register = prop_oneof![Just(MODE1), Just(MODE2), 0..=0x45u8, 0xFA..=0xFEu8];
    (register, any::<u8>())
        .prop_map(|(register, value)| [register, if register == MODE1 { value & !0x40 } else { value }])
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    /// Set-up from any state of the chip ends with all outputs off. A change takes effect at the end of the present PWM
    /// cycle (7.3.3), which can last 42 ms; from then on nothing is driven high.
    #[test]
    fn setting_up_from_any_state_ends_off(writes in prop::collection::vec(any_write(), 0..40), wait_us in 600u64..50_000) {
        let ended = on_rig(async |mut bus, clock| {
            // no bridge tolerates such outputs
            bus.0.borrow_mut().bridges.clear();
            for write in writes {
                // MODE1 never changes this address, so every write is acknowledged
                bus.write(0x40, &write).await.unwrap();
                // outside the start of the oscillator (500 us), which the datasheet asks not to disturb
                clock.sleep(600 * US).await;
            }
            clock.sleep(wait_us * US).await;
            let last_cycle_ns = {
                let mut rig = bus.0.borrow_mut();
                rig.catch_up();
                rig.bus.misuse_mut().clear();
                rig.chip.borrow_mut().misuse_mut().clear();
                rig.chip.borrow().pwm_period_ns()
            };
            let begin_ns = clock.now_ns();
            let result = driver().init(&mut bus).await;
            clock.sleep(50 * MS).await;
            let mut rig = bus.0.borrow_mut();
            rig.catch_up();
            // two transfers of three bytes, 72 us each
            let off_ns = begin_ns + 150 * US + last_cycle_ns;
            let changes: Vec<_> = rig.history.iter().filter(|(at_ns, _)| *at_ns > off_ns).copied().collect();
            let modes = [MODE1, MODE2, PRE_SCALE].map(|register| rig.register(register));
            (result.map_err(|error| format!("{error:?}")), changes, *rig.chip.borrow().lines(), modes, rig.misuse())
        });
        let (result, changes, lines, modes, misuse) = ended;
        prop_assert_eq!(result, Ok(()));
        prop_assert_eq!(modes, [RUNNING, TOTEM_POLE, FASTEST]);
        prop_assert_eq!(lines, [Line::Low; 16]);
        prop_assert_eq!(changes, vec![]);
        prop_assert_eq!(misuse, Vec::<String>::new());
    }
}

#[test]
fn an_external_clock_is_reported() {
    let result = on_rig(async |mut bus, _| {
        // 7.3.1: SLEEP, then SLEEP and EXTCLK together
        bus.write(0x40, &[MODE1, 0x10]).await.unwrap();
        bus.write(0x40, &[MODE1, 0x50]).await.unwrap();
        driver().init(&mut bus).await
    });
    assert!(matches!(result, Err(ChipError::Mismatch { register: MODE1, .. })), "{result:?}");
}

#[test]
fn an_unchanged_direction_writes_two_registers_of_one_line() {
    with_outputs(async |outputs, bus, clock| {
        clock.sleep(5 * MS).await;
        // forwards the PWM is on BLI, backwards on ALI
        let lines = *lines_of(&mut osmc_bench().config);
        for (sign, low_line) in [(1.0, lines.bli), (-1.0, lines.ali)] {
            // continue through the direction change, if there is one
            while drive(outputs, 0, 0.25 * sign).await == Ok(0.0) {
                outputs.begin_tick();
                clock.sleep(MS).await;
            }
            for (duty, off_count) in [(0.5, Some([0x00, 0x08])), (0.5, None), (0.75, Some([0x00, 0x0C]))] {
                bus.0.borrow_mut().bus.set_trace(100);
                outputs.begin_tick();
                assert_eq!(drive(outputs, 0, duty * sign).await, Ok(duty * sign));
                let written: Vec<_> = bus.0.borrow().bus.trace().map(|record| record.written.clone()).collect();
                // LEDn_OFF_L is the third of a line's four registers
                let expected: Vec<_> =
                    off_count.iter().map(|[low, high]| vec![LED0_ON_L + 4 * low_line + 2, *low, *high]).collect();
                assert_eq!(written, expected, "at {duty}");
            }
        }
    });
}

/// One step of a random test of the outputs.
#[derive(Clone, Copy, Debug)]
enum Step {
    Drive { index: usize, duty: f32 },
    MakeSafe,
    Check,
    Disturb(Disturbance),
    Wait { us: u64 },
}

fn any_step() -> impl Strategy<Value = Step> {
    let duty = prop_oneof![Just(0.0f32), Just(0.95), Just(-0.95), -0.98f32..0.98];
    let disturbance = prop_oneof![
        Just(Disturbance::AddressNack),
        // A fault at the register pointer. A later byte would leave half a write in the chip until the repetition,
        // which is misuse by itself.
        Just(Disturbance::DataNack { byte: 0 }),
        Just(Disturbance::StuckLow { persistent: false }),
    ];
    prop_oneof![
        8 => (0..2usize, duty).prop_map(|(index, duty)| Step::Drive { index, duty }),
        1 => Just(Step::MakeSafe),
        1 => Just(Step::Check),
        1 => disturbance.prop_map(Step::Disturb),
        4 => (0..3000u64).prop_map(|us| Step::Wait { us }),
    ]
}

/// Times from the STOP that took the last low side off to the STOP of each transfer that then set all four lines of a
/// bridge, ns.
fn rests_before_direction_changes(lines: BridgeLines, trace: &[WireRecord]) -> Vec<u64> {
    let first = LED0_ON_L + 4 * lines.first();
    let low_sides = [lines.ali, lines.bli].map(|line| LED0_ON_L + 4 * line);
    let (mut on, mut off_since_ns, mut rests) = (false, None, Vec::new());
    for record in trace.iter().filter(|record| record.fault.is_none()) {
        let [register, values @ ..] = &record.written[..] else { continue };
        let was_on = on;
        // bit 4 of LEDn_OFF_H is full OFF
        match values {
            _ if record.written == ALL_OFF => on = false,
            [_, high] if low_sides.contains(&(register - 2)) => on = high & 0x10 == 0,
            [_, _, _, high] if low_sides.contains(register) => on = high & 0x10 == 0,
            [..] if values.len() == 16 && *register == first => {
                rests.extend(off_since_ns.take().map(|since_ns: u64| record.end_ns - since_ns));
                on = low_sides.iter().any(|low| values[usize::from(low - first) + 3] & 0x10 == 0);
            }
            _ => {}
        }
        if was_on && !on {
            off_since_ns = Some(record.end_ns);
        }
    }
    rests
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    /// For any duties at any pace, also with temporary bus faults: no misuse of chip or bridge, directions change in
    /// one transfer of four lines, and the low sides were off for two PWM periods before.
    #[test]
    fn any_duties_keep_the_rules_of_the_bridges(steps in prop::collection::vec(any_step(), 1..60)) {
        let (misuse, trace) = with_outputs(async |outputs, bus, clock| {
            bus.0.borrow_mut().bus.set_trace(10_000);
            for step in &steps {
                match *step {
                    Step::Drive { index, duty } => {
                        outputs.begin_tick();
                        let now = drive(outputs, index, duty).await.expect("faults pass");
                        assert!(now == duty || now == 0.0, "{now} on the way to {duty}");
                    }
                    Step::MakeSafe => outputs.make_safe().await.expect("faults pass"),
                    Step::Check => outputs.check_next().await.expect("nothing is lost"),
                    Step::Disturb(disturbance) => bus.0.borrow_mut().bus.inject(Injection {
                        disturbance,
                        span: Span::Transfers { count: 1 },
                        address: None,
                    }),
                    Step::Wait { us } => clock.sleep(us * US).await,
                }
            }
            clock.sleep(5 * MS).await;
            bus.0.borrow_mut().catch_up();
            let rig = bus.0.borrow();
            (rig.misuse(), rig.bus.trace().cloned().collect::<Vec<_>>())
        });
        prop_assert_eq!(misuse, Vec::<String>::new());
        for motor in osmc_bench().config.motors {
            let rests = rests_before_direction_changes(osmc_lines(&motor), &trace);
            prop_assert!(rests.iter().all(|ns| *ns >= 2 * PWM_PERIOD_NS), "{:?} ns of rest", rests);
        }
    }

    /// A flipped bit in any byte of any write: after a round of read-backs it was found, or it changed nothing that a
    /// bridge or the chip's timing depends on.
    #[test]
    fn a_flipped_bit_is_found_by_reading_back(from in -0.9f32..0.9, to in -0.9f32..0.9, byte in 0..17usize, bit in 0..8u8) {
        let run = |flip: Option<Disturbance>| {
            with_outputs(async |outputs, bus, clock| {
                let turn = async |outputs: &mut Outputs<RigBus>, duty| {
                    for _ in 0..5 {
                        outputs.begin_tick();
                        drive(outputs, 0, duty).await.unwrap();
                        clock.sleep(2 * MS).await;
                    }
                };
                turn(outputs, from).await;
                if let Some(disturbance) = flip {
                    let span = Span::Transfers { count: 1 };
                    bus.0.borrow_mut().bus.inject(Injection { disturbance, span, address: None });
                }
                turn(outputs, to).await;
                bus.0.borrow_mut().bus.clear_injections();
                let mut found = false;
                for _ in 0..CHECKS {
                    outputs.begin_tick();
                    found |= outputs.check_next().await == Err(OutputFault::Mismatch);
                }
                clock.sleep(2 * MS).await;
                let mut rig = bus.0.borrow_mut();
                rig.catch_up();
                let bridges = rig.chip.borrow().lines()[..8].to_vec();
                (found, bridges, [MODE1, MODE2, PRE_SCALE].map(|register| rig.register(register)))
            })
        };
        let (_, bridges, modes) = run(None);
        let (found, flipped_bridges, flipped_modes) = run(Some(Disturbance::BitFlip { byte, mask: 1 << bit }));
        prop_assert!(found || (flipped_bridges == bridges && flipped_modes == modes), "{flipped_bridges:?}, {flipped_modes:02X?}");
    }
}

#[test]
fn a_wrong_duty_on_the_wire_trips_within_one_round_of_reading_back() {
    // While armed one item is read back every 4 periods of 1 ms. The trip's own write follows within 5 ms, as promised.
    let limit_ns = CHECKS * 4 * MS + 5 * MS;
    let mut worst_ns = 0;
    for (byte, mask) in [(1, 0x01), (1, 0x80), (2, 0x01), (2, 0x08), (2, 0x10)] {
        bench_with_misuse(&osmc_bench(), async |bench| {
            bench.run_rotary(0).await;
            let device = bench.device();
            device.record_wire();
            // Right after a line was read back there is time for a write before the next read-back: the flip hits the
            // write. The mode and the relays take two transfers each, of which the flip would hit the second.
            let begin_ns = device.clock.now_ns();
            let line_read = || {
                let mut reads = device.wire_since(begin_ns).filter(|record| !record.read.is_empty());
                reads.any(|record| record.address == 0x40 && (LED0_ON_L..PRE_SCALE).contains(&record.written[0]))
            };
            device.wait_until(begin_ns, 20 * MS, line_read).await.expect("looks");
            let flip_ns = device.clock.now_ns();
            device.inject(Disturbance::BitFlip { byte, mask }, Span::Transfers { count: 1 });
            // less than the slew limit of one period: a single write
            bench.set(ROTARY, Mode::Duty, 0.81).await.unwrap();
            let written_ns = device.wait_all_off_written(flip_ns, limit_ns).await;
            assert!(written_ns.is_some_and(|ns| ns <= limit_ns), "byte {byte}, mask {mask:#04x}: {written_ns:?}");
            worst_ns = worst_ns.max(written_ns.unwrap_or(u64::MAX));
            let flipped = device.wire_since(flip_ns).next().expect("the write");
            assert_eq!((flipped.written.len(), flipped.read.len()), (3, 0), "the flip met the write");
            assert_eq!(bench.safety().await, (SafetyState::Tripped, Causes::only(Cause::ReadBackMismatch)));
        });
    }
    eprintln!("flipped bit: written off after at most {} us", worst_ns / US);
}

/// Loops that request far more than the cap get the cap at the bridge, to the next 1/4096, and never more.
#[test]
fn no_loop_drives_beyond_the_duty_cap() {
    let mut robot = osmc_bench();
    robot.simulation.motors[1].start = 0.02;
    for motor in &mut robot.config.motors {
        let control = motor.control.as_mut().expect("a measured motor");
        control.position_pid.kp *= 100.0;
        control.speed_pid.ki *= 100.0;
    }
    for (mode, rotary, linear) in [(Mode::Position, 20.0, 0.09), (Mode::Speed, -5.0, 0.010)] {
        bench(&robot, async |bench| {
            bench.host.arm().await.unwrap();
            bench.set(ROTARY, mode, rotary).await.unwrap();
            bench.set(LINEAR, mode, linear).await.unwrap();
            let mut highest = [0.0f64; 2];
            for _ in 0..1000 {
                bench.sleep_ms(1).await;
                for (highest, channel) in highest.iter_mut().zip([ROTARY, LINEAR]) {
                    *highest = highest.max(bench.device().duty(channel).abs());
                }
            }
            for (highest, motor) in highest.into_iter().zip(&robot.config.motors) {
                let cap = f64::from(motor.duty_max);
                assert!((highest - cap).abs() < 1.0 / 4096.0, "{mode}: {highest}, the cap is {cap}");
            }
        });
    }
}
