//! Drivers of the DAC and of servos, and the rules of brushless drives and servos, against the models of the chips.
//!
//! Bytes and bits are literal values of the MCP4728 and PCA9685 datasheets; the drivers' own constants are not used.
#![allow(clippy::unwrap_used, reason = "tests")]

use std::{cell::RefCell, rc::Rc};

use embedded_hal::i2c::{Error, ErrorKind, ErrorType, Operation};
use embedded_hal_async::i2c::I2c;
use proptest::prelude::*;
use r4_firmware::{
    chips::{ChipError, mcp4728::Mcp4728},
    outputs::{
        bldc::{Bldcs, Command},
        servo::Servos,
    },
};
use r4_protocol::{
    ChannelId, ChannelKind,
    config::{BldcConfig, DacChipConfig, Reverse, ServoChipConfig, ServoConfig, ServoPoint},
};
use r4_sim::{
    Clock, Simulation,
    chips::{
        Line,
        mcp4728::{self, Impedance, Setting},
        pca9685,
    },
    i2c::{Disturbance, Fault, I2cBus, Injection, Span, WireRecord},
    misuse::MisuseKind,
};

const US: u64 = 1_000;
const MS: u64 = 1_000_000;

const DAC: u8 = 0x60;
const SERVOS: u8 = 0x42;
const VDD_V: f64 = 5.0;
/// Duration of a byte and its acknowledge at 400 kHz, ns.
const BYTE_NS: u64 = 22_500;
/// Voltage of one code of 4096, V.
const CODE_V: f64 = VDD_V / 4096.0;
/// Neutral codes of four drives; the second is the 2.05 V of a vehicle's throttle that reverses below it.
const NEUTRAL: [u16; 4] = [0, 1679, 4095, 2048];

/// A bus with the two chips, and a fault for one of its transfers.
#[derive(Clone)]
struct Rig {
    clock: Clock,
    bus: Rc<RefCell<I2cBus>>,
    dac: Rc<RefCell<mcp4728::Mcp4728>>,
    pwm: Rc<RefCell<pca9685::Pca9685>>,
    fault: Rc<RefCell<Option<(u32, WireFault)>>>,
}

#[derive(Debug, PartialEq)]
struct RigError;

/// A fault at one byte of a transfer; byte 0 is the address.
#[derive(Clone, Copy, Debug)]
enum WireFault {
    Nack { byte: u64 },
    Flip { byte: u64, mask: u8 },
    Stuck { byte: u64 },
}

impl Error for RigError {
    fn kind(&self) -> ErrorKind {
        ErrorKind::Other
    }
}

impl ErrorType for Rig {
    type Error = RigError;
}

impl I2c for Rig {
    async fn transaction(&mut self, address: u8, operations: &mut [Operation<'_>]) -> Result<(), RigError> {
        let start_ns = self.bus.borrow().earliest_start_ns(self.clock.now_ns());
        let planned_ns = self.bus.borrow().planned_duration_ns(operations);
        self.clock.sleep_until(start_ns + planned_ns).await;
        let fault = self.fault.borrow_mut().take();
        match fault {
            Some((0, fault)) => self.inject(fault, start_ns),
            Some((transfers, fault)) => *self.fault.borrow_mut() = Some((transfers - 1, fault)),
            None => {}
        }
        let result = self.bus.borrow_mut().execute(start_ns, address, operations);
        if let Err(Fault::StuckLow { .. }) = result {
            // time-out of the controller; any duration serves
            self.clock.sleep(MS).await;
        }
        result.map(|_| ()).map_err(|_| RigError)
    }
}

impl Rig {
    /// Injects `fault` into the transfer that starts at `start_ns`.
    fn inject(&self, fault: WireFault, start_ns: u64) {
        let once = Span::Transfers { count: 1 };
        let (disturbance, span) = match fault {
            WireFault::Nack { byte: 0 } => (Disturbance::AddressNack, once),
            WireFault::Nack { byte } => (Disturbance::DataNack { byte: byte as usize - 1 }, once),
            // the bus model has no flipped bits in an address: no chip, or another one, would answer
            WireFault::Flip { byte: 0, .. } => (Disturbance::AddressNack, once),
            WireFault::Flip { byte, mask } => (Disturbance::BitFlip { byte: byte as usize - 1, mask }, once),
            WireFault::Stuck { byte } => {
                // in the middle of a byte of 9 clocks
                let from_ns = start_ns + byte * BYTE_NS + BYTE_NS / 2;
                (Disturbance::StuckLow { persistent: false }, Span::Time { from_ns, until_ns: u64::MAX })
            }
        };
        self.bus.borrow_mut().inject(Injection { disturbance, span, address: None });
    }

    /// Recovers the bus after a failed transfer.
    async fn recover(&self) {
        let end_ns = self.bus.borrow_mut().recover(self.clock.now_ns()).end_ns;
        self.clock.sleep_until(end_ns).await;
        self.bus.borrow_mut().clear_injections();
        *self.fault.borrow_mut() = None;
    }

    /// Waits for `ns`, and advances the chips.
    async fn wait(&self, ns: u64) {
        self.clock.sleep(ns).await;
        self.dac.borrow_mut().advance(self.clock.now_ns());
        self.pwm.borrow_mut().advance(self.clock.now_ns());
    }

    fn misuse(&self) -> Vec<MisuseKind> {
        let (bus, dac, pwm) = (self.bus.borrow(), self.dac.borrow(), self.pwm.borrow());
        let logs = [bus.misuse(), dac.misuse(), pwm.misuse()];
        logs.into_iter().flat_map(|log| log.first()).map(|misuse| misuse.kind).collect()
    }

    /// Clears the recorded misuse and traffic.
    fn look_from_here(&self) {
        self.bus.borrow_mut().misuse_mut().clear();
        self.dac.borrow_mut().misuse_mut().clear();
        self.pwm.borrow_mut().misuse_mut().clear();
        self.bus.borrow_mut().set_trace(100_000);
    }

    fn wire(&self) -> Vec<WireRecord> {
        self.bus.borrow().trace().cloned().collect()
    }

    fn volts(&self) -> [f64; 4] {
        std::array::from_fn(|channel| {
            let output = self.dac.borrow().output_v(channel);
            // an output that is powered down has no defined voltage
            if output.impedance == Impedance::Normal { output.volts } else { f64::NAN }
        })
    }

    fn eeprom(&self) -> [Setting; 4] {
        std::array::from_fn(|channel| self.dac.borrow().eeprom(channel).unwrap())
    }

    /// Pulse width of a servo, s; 0 without pulses.
    fn pulse_s(&self, output: u8, oscillator_hz: u32) -> f64 {
        let pwm = self.pwm.borrow();
        match pwm.line(output.into()) {
            Line::Low => 0.0,
            Line::Pwm { on: 0, off } => f64::from(off) * count_s(&pwm, oscillator_hz),
            line => panic!("no pulse from the start of the period: {line:?}"),
        }
    }
}

/// One count of the chip, s: prescaler + 1 clocks (PCA9685 datasheet, 7.3.5).
fn count_s(pwm: &pca9685::Pca9685, oscillator_hz: u32) -> f64 {
    f64::from(pwm.register(0xFE).unwrap() + 1) / f64::from(oscillator_hz)
}

/// Runs `work` with chips that were just powered up, the DAC with `eeprom` and its slowest EEPROM write.
fn on_rig<T>(eeprom: [u16; 4], oscillator_hz: u32, work: impl AsyncFnOnce(Rig) -> T) -> T {
    let mut simulation = Simulation::default();
    let rig = Rig {
        clock: simulation.clock(),
        bus: Rc::new(RefCell::new(I2cBus::new(400_000))),
        dac: Rc::new(RefCell::new(mcp4728::Mcp4728::new(DAC, VDD_V, eeprom.map(Setting)))),
        pwm: Rc::new(RefCell::new(pca9685::Pca9685::new(SERVOS, oscillator_hz))),
        fault: Rc::default(),
    };
    rig.bus.borrow_mut().attach(rig.dac.clone());
    rig.bus.borrow_mut().attach(rig.pwm.clone());
    rig.look_from_here();
    simulation.block_on(work(rig)).expect("time goes on")
}

/// Settings with VREF = VDD, powered, gain 1: the upper four bits are 0.
fn settings(codes: [u16; 4]) -> [Setting; 4] {
    codes.map(Setting)
}

fn assert_volts(rig: &Rig, codes: [u16; 4]) {
    for (volts, code) in rig.volts().into_iter().zip(codes) {
        let expected = f64::from(code) * CODE_V;
        assert!((volts - expected).abs() < CODE_V / 2.0, "{volts} V, not {expected} V");
    }
}

/// Complete commands that change the chip's registers: fast write, multi-write, sequential and single write with
/// EEPROM, reference, power-down, gain; with any settings.
fn any_dac_command() -> impl Strategy<Value = Vec<u8>> {
    let setting = prop::collection::vec(any::<u8>(), 8);
    prop_oneof![
        setting.prop_map(|bytes| bytes.chunks(2).flat_map(|pair| [pair[0] & 0x3F, pair[1]]).collect()),
        any::<[u8; 3]>().prop_map(|[first, upper, lower]| vec![0x40 | first & 0x07, upper, lower]),
        any::<[u8; 8]>().prop_map(|bytes| [&[0x50][..], &bytes].concat()),
        any::<[u8; 3]>().prop_map(|[first, upper, lower]| vec![0x58 | first & 0x07, upper, lower]),
        any::<u8>().prop_map(|byte| vec![0x80 | byte & 0x1F]),
        any::<[u8; 2]>().prop_map(|[first, second]| vec![0xA0 | first & 0x1F, second]),
        any::<u8>().prop_map(|byte| vec![0xC0 | byte & 0x1F]),
    ]
}

fn any_codes() -> impl Strategy<Value = [u16; 4]> {
    let code = || prop_oneof![Just(0u16), Just(4095), 0..4096u16];
    [code(), code(), code(), code()]
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    /// Set-up succeeds for any content of EEPROM and registers, also during an EEPROM write that a reset of the
    /// processor left.
    #[test]
    fn the_dac_is_set_up_from_any_state(
        eeprom in any::<[u16; 4]>(),
        commands in prop::collection::vec(any_dac_command(), 0..6),
        write_ns in 0..=50 * MS,
        ldac_high in any::<bool>(),
        codes in any_codes(),
    ) {
        on_rig(eeprom, 25_000_000, async |mut rig| {
            rig.dac.borrow_mut().set_eeprom_write_ns(write_ns);
            rig.dac.borrow_mut().set_ldac(0, ldac_high);
            for command in commands {
                rig.write(DAC, &command).await.unwrap();
            }
            rig.look_from_here();
            Mcp4728::new(DAC).init(&mut rig, codes).await.unwrap();
            assert_eq!(rig.eeprom(), settings(codes));
            assert_volts(&rig, codes);
            rig.dac.borrow_mut().power_cycle(rig.clock.now_ns());
            assert_volts(&rig, codes);
            assert_eq!(rig.misuse(), []);
            // the second time the EEPROM needs no write, even if an output has moved: a multi-write of B
            rig.write(DAC, &[0x42, 0x95, 0x55]).await.unwrap();
            rig.look_from_here();
            let begin_ns = rig.clock.now_ns();
            Mcp4728::new(DAC).init(&mut rig, codes).await.unwrap();
            assert!(rig.wire().iter().all(|record| record.written.first().is_none_or(|first| first >> 3 == 0b01000)));
            // RDY/BSY, 12 bytes and 24 bytes: 47.5, 295 and 565 us, and the bus-free time between
            assert!(rig.clock.now_ns() - begin_ns < 912 * US);
            assert_volts(&rig, codes);
        });
    }

    /// Any sequence of codes: only changed outputs are written, with no more bytes than up to the last of them.
    #[test]
    fn fast_writes_set_what_changes(steps in prop::collection::vec(any_codes(), 1..20), keep in any::<[bool; 4]>()) {
        on_rig([0; 4], 25_000_000, async |mut rig| {
            let chip = Mcp4728::new(DAC);
            chip.init(&mut rig, NEUTRAL).await.unwrap();
            let mut now = NEUTRAL;
            for mut codes in steps {
                for channel in 0..4 {
                    if keep[channel] {
                        codes[channel] = now[channel];
                    }
                }
                rig.look_from_here();
                chip.set(&mut rig, codes, Some(now)).await.unwrap();
                let channels = (0..4).filter(|channel| codes[*channel] != now[*channel]).max().map_or(0, |last| last + 1);
                let written: Vec<_> = rig.wire().into_iter().map(|record| record.written).collect();
                let expected: Vec<_> = codes[..channels].iter().flat_map(|code| code.to_be_bytes()).collect();
                assert_eq!(written.concat(), expected);
                now = codes;
                assert_volts(&rig, now);
                chip.verify(&mut rig, &now).await.unwrap();
            }
            assert_eq!(rig.eeprom(), settings(NEUTRAL), "only init writes it");
            assert_eq!(rig.misuse(), []);
        });
    }
}

#[test]
fn transfers_of_the_dac_take_what_their_documentation_says() {
    on_rig([0; 4], 25_000_000, async |mut rig| {
        let chip = Mcp4728::new(DAC);
        chip.init(&mut rig, [0; 4]).await.unwrap();
        for (outputs, write_us, read_us) in [(1, 70.0, 92.5), (2, 115.0, 227.5), (3, 160.0, 362.5), (4, 205.0, 497.5)] {
            rig.look_from_here();
            let mut codes = [0; 4];
            codes[outputs - 1] = 1;
            chip.set(&mut rig, codes, Some([0; 4])).await.unwrap();
            chip.verify(&mut rig, &codes[..outputs]).await.unwrap();
            chip.set(&mut rig, [0; 4], None).await.unwrap();
            let us: Vec<_> = rig.wire().iter().map(|record| (record.end_ns - record.start_ns) as f64 / 1e3).collect();
            assert_eq!(us, [write_us, read_us, 205.0]);
        }
    });
}

#[test]
fn an_eeprom_that_stays_busy_is_reported() {
    on_rig([0x8000; 4], 25_000_000, async |mut rig| {
        rig.dac.borrow_mut().set_eeprom_write_ns(200 * MS);
        let chip = Mcp4728::new(DAC);
        let result = chip.init(&mut rig, NEUTRAL).await;
        assert_eq!(result, Err(ChipError::Mismatch { register: 0, written: 0x80, read: 0 }));
        assert!(rig.clock.now_ns() < 53 * MS, "{} ns", rig.clock.now_ns());
        let result = chip.verify(&mut rig, &NEUTRAL).await;
        assert_eq!(result, Err(ChipError::Mismatch { register: 0, written: 0x80, read: 0 }), "it takes no commands");
        rig.wait(200 * MS).await;
        chip.init(&mut rig, NEUTRAL).await.unwrap();
        assert_eq!(rig.misuse(), []);
    });
}

/// A bit flipped in any byte of a fast write never starts an EEPROM write, and is found, unless the transfer fails.
#[test]
fn a_flipped_bit_in_a_fast_write_is_found() {
    for bit in 0..8 * 8 {
        on_rig([0; 4], 25_000_000, async |mut rig| {
            let chip = Mcp4728::new(DAC);
            chip.init(&mut rig, NEUTRAL).await.unwrap();
            let codes = [100, 1700, 4000, 2000];
            *rig.fault.borrow_mut() = Some((0, WireFault::Flip { byte: 1 + bit / 8, mask: 1 << (bit % 8) }));
            let written = chip.set(&mut rig, codes, Some(NEUTRAL)).await;
            assert!(rig.dac.borrow().ready(), "bit {bit} started a write of the EEPROM");
            let found = chip.verify(&mut rig, &codes).await;
            // the upper two bits of all but the first byte of a fast write are ignored
            let ignored = bit >= 16 && bit % 16 >= 6 && bit % 16 < 8;
            assert_eq!(written.is_err() || found.is_err(), !ignored, "bit {bit}: {written:?}, {found:?}");
            assert_eq!(found.is_ok(), ignored, "bit {bit}");
        });
    }
}

/// A sequence of all operations of the DAC's driver.
async fn use_dac(rig: &mut Rig) -> Result<(), ChipError<RigError>> {
    let chip = Mcp4728::new(DAC);
    chip.init(rig, NEUTRAL).await?;
    chip.set(rig, [4095, 1, 2, 3], None).await?;
    chip.verify(rig, &[4095, 1, 2, 3]).await
}

/// Writes the next servo in turn, if one has a new pulse.
async fn write_next(servos: &mut Servos, rig: &mut Rig) -> Result<(), RigError> {
    let Some((write, pulse)) = servos.next_write() else { return Ok(()) };
    write.send(rig).await?;
    servos.sent(pulse);
    Ok(())
}

async fn use_servos(rig: &mut Rig) -> Result<(), ChipError<RigError>> {
    let mut servos = Servos::new(servo_chip(25e6, false), &[servo(3), servo(15)]);
    servos.init(rig).await?;
    for angle in [0.0, 0.5] {
        servos.command(0, angle);
        servos.command(1, -angle);
        servos.step(1.0);
        write_next(&mut servos, rig).await?;
        write_next(&mut servos, rig).await?;
        servos.verify(rig, 0).await?;
        servos.verify(rig, 1).await?;
    }
    servos.verify_mode(rig).await?;
    Ok(servos.make_safe(rig).await?)
}

/// After a fault at any byte of any transfer the bus is recovered, and init brings both chips into their safe state.
#[test]
fn init_recovers_from_a_fault_at_any_byte() {
    // the transfers without a fault; RDY/BSY is polled some 50 times, all equivalent
    let lengths = on_rig([0x8ABC; 4], 25_000_000, async |mut rig| {
        use_dac(&mut rig).await.unwrap();
        use_servos(&mut rig).await.unwrap();
        assert_eq!(rig.misuse(), []);
        let transfer = |record: &WireRecord| (record.written.len(), record.read.len());
        rig.wire().iter().map(transfer).collect::<Vec<_>>()
    });
    let mut tried = 0;
    for (number, (written, read)) in (0..).zip(&lengths) {
        if number > 5 && lengths[number as usize - 1] == (*written, *read) && (*written, *read) == (0, 1) {
            continue;
        }
        let bytes = 1 + written + read + usize::from(*written > 0 && *read > 0);
        for byte in 0..bytes as u64 {
            let flips = [0x01, 0x10, 0x40, 0x80].map(|mask| WireFault::Flip { byte, mask });
            for fault in flips.into_iter().chain([WireFault::Nack { byte }, WireFault::Stuck { byte }]) {
                tried += 1;
                on_rig([0x8ABC; 4], 25_000_000, async |mut rig| {
                    *rig.fault.borrow_mut() = Some((number, fault));
                    if use_dac(&mut rig).await.is_ok() {
                        _ = use_servos(&mut rig).await;
                    }
                    rig.recover().await;
                    // a bit of PRE_SCALE may have flipped: the longest possible period, 42 ms
                    rig.wait(50 * MS).await;
                    rig.look_from_here();
                    Mcp4728::new(DAC).init(&mut rig, NEUTRAL).await.unwrap();
                    assert_eq!(rig.eeprom(), settings(NEUTRAL), "{number}, {fault:?}");
                    assert_volts(&rig, NEUTRAL);
                    let mut servos = Servos::new(servo_chip(25e6, false), &[servo(3), servo(15)]);
                    let result = servos.init(&mut rig).await;
                    // EXTCLK, once set, stays until the supply is cycled (PCA9685 datasheet, 7.3.1): reported
                    if rig.pwm.borrow().register(0x00).unwrap() & 0x40 != 0 {
                        assert!(matches!(result, Err(ChipError::Mismatch { register: 0x00, .. })), "{result:?}");
                        return;
                    }
                    assert_eq!(result, Ok(()), "{number}, {fault:?}");
                    rig.wait(50 * MS).await;
                    assert_eq!(*rig.pwm.borrow().lines(), [Line::Low; 16], "{number}, {fault:?}");
                    assert_eq!(rig.misuse(), [], "{number}, {fault:?}");
                });
            }
        }
    }
    // init of the DAC alone has 2 + 13 + 25 + 10 + 2 + 25 bytes
    assert!(tried > 6 * 77, "{tried}");
}

const fn servo_chip(oscillator_hz: f32, hold_when_safe: bool) -> ServoChipConfig {
    ServoChipConfig { address: SERVOS, frequency_hz: 50.0, oscillator_hz, hold_when_safe }
}

/// Servo with 0.6 ms at -1 rad to 2.4 ms at 1 rad, 2 rad/s.
const fn servo(output: u8) -> ServoConfig {
    ServoConfig {
        id: ChannelId::new(ChannelKind::Servo, output),
        output,
        low: ServoPoint { pulse_s: 0.6e-3, angle_rad: -1.0 },
        high: ServoPoint { pulse_s: 2.4e-3, angle_rad: 1.0 },
        speed_max: 2.0,
    }
}

/// Pulse width of [`servo`] at an angle, s.
fn pulse_at(angle: f32) -> f64 {
    1.5e-3 + 0.9e-3 * f64::from(angle)
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    /// Pulses are correct to half a count, and the frequency to half a step of the prescaler, once the oscillator is
    /// known, for any earlier content of the registers.
    #[test]
    fn pulses_follow_the_calibrated_oscillator(
        oscillator_hz in prop::sample::select(vec![24_000_000u32, 25_000_000, 26_200_000]),
        frequency_hz in 40.0f32..330.0,
        writes in prop::collection::vec((0x06..=0x45u8, any::<u8>()), 0..40),
        angles in [-1.0f32..=1.0, -1.0f32..=1.0],
    ) {
        on_rig([0; 4], oscillator_hz, async |mut rig| {
            for (register, value) in writes {
                rig.write(SERVOS, &[register, value]).await.unwrap();
            }
            rig.look_from_here();
            let chip = ServoChipConfig { frequency_hz, ..servo_chip(oscillator_hz as f32, false) };
            let mut servos = Servos::new(chip, &[servo(0), servo(9)]);
            servos.init(&mut rig).await.unwrap();
            for (index, angle) in angles.into_iter().enumerate() {
                servos.command(index, angle);
                write_next(&mut servos, &mut rig).await.unwrap();
            }
            rig.wait(60 * MS).await;
            let half_count_s = 0.5 * count_s(&rig.pwm.borrow(), oscillator_hz);
            for (output, angle) in [0, 9].into_iter().zip(angles) {
                let error_s = rig.pulse_s(output, oscillator_hz) - pulse_at(angle);
                // 1e-9 s is several times the rounding of 2.4 ms in f32
                assert!(error_s.abs() <= half_count_s + 1e-9, "{error_s} s, half a count is {half_count_s} s");
            }
            // half a step in clocks of 4096
            let period_s = rig.pwm.borrow().pwm_period_ns() as f64 * 1e-9;
            let clocks = f64::from(oscillator_hz) / 4096.0;
            assert!((period_s - 1.0 / f64::from(frequency_hz)).abs() * clocks <= 0.5001);
            assert_eq!(rig.misuse(), []);
        });
    }
}

#[test]
fn an_oscillator_that_is_not_calibrated_scales_all_pulses() {
    on_rig([0; 4], 24_000_000, async |mut rig| {
        let mut servos = Servos::new(servo_chip(25e6, false), &[servo(0)]);
        servos.init(&mut rig).await.unwrap();
        servos.command(0, 0.0);
        write_next(&mut servos, &mut rig).await.unwrap();
        rig.wait(50 * MS).await;
        // 1.5 ms with a clock period that is 25 / 24 too long; a count is 5 us
        assert!((rig.pulse_s(0, 24_000_000) - 1.5625e-3).abs() < 2.5e-6);
    });
}

/// Sixteen servos back and forth at full speed, one transfer a millisecond: all take their turn, none is late.
#[test]
fn sixteen_servos_that_move_are_each_written_within_20_ms() {
    on_rig([0; 4], 25_000_000, async |mut rig| {
        let configs: Vec<_> = (0..16).map(servo).collect();
        let mut servos = Servos::new(servo_chip(25e6, false), &configs);
        servos.init(&mut rig).await.unwrap();
        assert_eq!(servos.writes_per_period(0.001), 1);
        for index in 0..16 {
            servos.command(index, 0.9);
        }
        for _ in 0..16 {
            write_next(&mut servos, &mut rig).await.unwrap();
        }
        assert!(servos.next_write().is_none());
        rig.look_from_here();
        let begin_ns = rig.clock.now_ns();
        for ms in 1..=800u64 {
            // 1.8 rad at 2 rad/s take 0.9 s: they move all the time
            for index in (0..16).filter(|_| ms == 1) {
                servos.command(index, -0.9);
            }
            servos.step(0.001);
            write_next(&mut servos, &mut rig).await.unwrap();
            let until_ns = begin_ns + ms * MS;
            rig.clock.sleep_until(until_ns).await;
        }
        let wire = rig.wire();
        assert!(wire.iter().all(|record| record.end_ns - record.start_ns == 92_500 && record.written.len() == 3));
        for output in 0..16u8 {
            // OFF_L is the third of the four registers of an output, which start at 06h
            let mine = |record: &&WireRecord| record.written[0] == 0x06 + 4 * output + 2;
            let times: Vec<_> = wire.iter().filter(mine).map(|record| record.end_ns).collect();
            let ends = [begin_ns].into_iter().chain(times.iter().copied()).zip(&times);
            assert!(ends.clone().all(|(from, to)| to - from <= 20 * MS), "output {output}");
            assert!(begin_ns + 800 * MS - times.last().unwrap() <= 20 * MS);
        }
        rig.wait(25 * MS).await;
        for (index, output) in (0..16u8).enumerate() {
            let asked = pulse_at(servos.angle(index).unwrap());
            // of the last 20 ms, at 2 rad/s and 0.9 ms/rad, and half a count
            let most_s = 0.02 * 2.0 * 0.9e-3 + 2.5e-6;
            assert!((rig.pulse_s(output, 25_000_000) - asked).abs() <= most_s, "output {output}");
        }
        assert_eq!(rig.misuse(), []);
    });
}

#[test]
fn safe_is_no_pulses_or_the_last_ones() {
    for hold_when_safe in [false, true] {
        on_rig([0; 4], 25_000_000, async |mut rig| {
            let mut servos = Servos::new(servo_chip(25e6, hold_when_safe), &[servo(0), servo(1), servo(2)]);
            servos.init(&mut rig).await.unwrap();
            for (index, angle) in [(0, 0.5), (1, -0.5)] {
                servos.command(index, angle);
                write_next(&mut servos, &mut rig).await.unwrap();
            }
            rig.wait(50 * MS).await;
            let pulses = [0, 1, 2].map(|output| rig.pulse_s(output, 25_000_000));
            assert!(pulses[0] > 0.0 && pulses[1] > 0.0 && pulses[2] == 0.0, "{pulses:?}");
            // moving when the stop comes
            servos.command(0, -0.5);
            rig.look_from_here();
            servos.make_safe(&mut rig).await.unwrap();
            let written: Vec<_> = rig.wire().into_iter().map(|record| record.written).collect();
            for _ in 0..100 {
                servos.step(0.001);
                write_next(&mut servos, &mut rig).await.unwrap();
            }
            rig.wait(50 * MS).await;
            let held = [0, 1, 2].map(|output| rig.pulse_s(output, 25_000_000));
            if hold_when_safe {
                assert_eq!((written, held), (vec![], pulses));
                assert_eq!(servos.angle(0), Some(0.5));
            } else {
                assert_eq!((written, held), (vec![vec![0xFD, 0x10]], [0.0; 3]));
                assert_eq!(servos.angle(0), None);
                // restarts at the next commanded angle
                servos.command(0, 0.25);
                write_next(&mut servos, &mut rig).await.unwrap();
                rig.wait(50 * MS).await;
                assert!((rig.pulse_s(0, 25_000_000) - pulse_at(0.25)).abs() < 2.5e-6);
            }
            for index in 0..3 {
                servos.verify(&mut rig, index).await.unwrap();
            }
            servos.verify_mode(&mut rig).await.unwrap();
            assert_eq!(rig.misuse(), []);
        });
    }
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    /// The voltage at the pin corresponds to the share, to half a code.
    #[test]
    fn shares_become_voltages(
        neutral_v in 1.0f32..4.0,
        forward_v in 0.0f32..1.0,
        backwards_v in 4.0f32..4.99,
        share in -1.0f32..=1.0,
        output in 0..4u8,
    ) {
        on_rig([0; 4], 25_000_000, async |mut rig| {
            let config = BldcConfig {
                id: ChannelId::new(ChannelKind::Bldc, 0),
                output,
                neutral_v,
                forward_v,
                reverse: Reverse::Voltage { full_v: backwards_v },
                brake: None,
                slew_per_s: 100.0,
                stop_brake_ms: 0,
            };
            let chip = Mcp4728::new(DAC);
            let mut drives = Bldcs::new(&[config], DacChipConfig { address: DAC, full_scale_v: VDD_V as f32 });
            chip.init(&mut rig, drives.wanted().codes).await.unwrap();
            let mut written = drives.wanted().codes;
            let volts = rig.volts()[usize::from(output)];
            assert!((volts - f64::from(neutral_v)).abs() <= CODE_V * 0.501, "{volts} V is not neutral");
            drives.command(0, Command::Run(share));
            for _ in 0..20 {
                let codes = drives.step(0.001).codes;
                chip.set(&mut rig, codes, Some(written)).await.unwrap();
                written = codes;
            }
            let full_v = if share < 0.0 { backwards_v } else { forward_v };
            let expected = f64::from(neutral_v) + f64::from(share.abs()) * f64::from(full_v - neutral_v);
            let volts = rig.volts()[usize::from(output)];
            // f32 leaves 1e-3 codes of 4096
            assert!((volts - expected).abs() <= CODE_V * 0.501, "{volts} V, not {expected} V");
            assert_eq!(rig.misuse(), []);
        });
    }
}
