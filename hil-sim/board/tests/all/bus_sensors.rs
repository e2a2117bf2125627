//! Sensors on the bus of the output chips: their drivers on models of the chips, and whole boards that have them.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use std::{
    cell::RefCell,
    f64::consts::{PI, TAU},
    rc::Rc,
};

use embedded_hal::i2c::Operation;
use r4_boards::{Robot, SimulatedDistance, SimulatedForce};
use r4_firmware::chips::{
    any::AnyDriver,
    sensor::{Driver, Outcome},
};
use r4_protocol::{
    Cause, Causes, ChannelId, ChannelKind, Mode, Quality, SafetyState, Sample,
    config::{As5600Config, Icm20948Config, Ina226Config, Nau7802Config, SensorChip, SensorConfig, Vl6180xConfig},
};
use r4_sim::{
    chips::{
        as5600::{As5600, Magnet},
        icm20948::{Icm20948, Truth},
        ina226::{Ina226, Inputs},
        nau7802::Nau7802,
        vl6180x::{Target, Vl6180x},
    },
    i2c::{Disturbance, I2cBus, Injection, Span},
};

use crate::{
    harness::{Bench, MS, bench},
    whole_board::sample,
};

const IMU: ChannelId = ChannelId::new(ChannelKind::Imu, 0);
const ADDRESS: u8 = 0x68;

fn openscout() -> Robot {
    r4_boards::load("openscout").expect("built in")
}

const CURRENT: ChannelId = ChannelId::new(ChannelKind::Current, 0);

/// Runs `driver` alone on the bus, a transfer in each millisecond, until it has a reading.
fn read(driver: &mut AnyDriver, bus: &mut I2cBus, address: u8, mut pass: impl FnMut(u64)) -> ([f32; 6], Quality) {
    let mut now_ns = 0;
    for _ in 0..1000 {
        pass(now_ns);
        let exchange = driver.next();
        let mut bytes = vec![0; exchange.read()];
        let done = if bytes.is_empty() {
            bus.execute(now_ns, address, &mut [Operation::Write(exchange.written())])
        } else {
            bus.execute(now_ns, address, &mut [Operation::Write(exchange.written()), Operation::Read(&mut bytes)])
        };
        // longest time that a stop may have to wait
        let done = done.unwrap();
        assert!(done.end_ns - done.start_ns <= 450_000, "{exchange:?}");
        now_ns += MS;
        match driver.done(&bytes) {
            Outcome::Next | Outcome::NotReady => {}
            Outcome::Wait(duration) => now_ns += duration.as_micros() * 1000,
            Outcome::Reading { values, quality } => return (values, quality),
            Outcome::WrongChip => panic!("it is the right one"),
        }
    }
    panic!("no reading in 1000 transfers");
}

#[test]
fn an_icm_20948_gives_what_it_feels_at_every_full_scale() {
    for (acceleration_max_g, rate_max_deg_s) in [(2, 250), (4, 500), (8, 1000), (16, 2000)] {
        for rate_hz in [5, 100, 400] {
            let chip = Rc::new(RefCell::new(Icm20948::new(ADDRESS, 7)));
            let mut bus = I2cBus::new(400_000);
            bus.attach(chip.clone());
            let config = Icm20948Config { acceleration_max_g, rate_max_deg_s };
            let config = SensorConfig { id: IMU, address: ADDRESS, rate_hz, chip: SensorChip::Icm20948(config) };
            let truth = Truth { acceleration_m_s2: [1.0, -2.0, 9.806_65], rate_rad_s: [0.5, -1.0, 2.0] };
            let pass = |now_ns: u64| chip.borrow_mut().feel(100 * MS + now_ns, truth);
            let mut driver = AnyDriver::new(&config);
            read(&mut driver, &mut bus, ADDRESS, pass);
            // The first sample is of an unsettled filter: at 5 Hz it is one of 5.7 Hz, and 1 s is 36 time constants.
            chip.borrow_mut().feel(2000 * MS, truth);
            let (values, quality) = read(&mut driver, &mut bus, ADDRESS, |now_ns| {
                chip.borrow_mut().feel(2000 * MS + now_ns, truth);
            });
            assert_eq!(quality, Quality::Good);
            // five standard deviations behind the widest filter, 151.8 Hz or 246 Hz, plus a count at the largest full
            // scale
            for (axis, value) in values.iter().enumerate() {
                let (expected, tolerance) = if axis < 3 {
                    (truth.acceleration_m_s2[axis], 5.0 * 230e-6 * 9.8 * 19.7 + 0.005)
                } else {
                    (truth.rate_rad_s[axis - 3], (5.0 * 0.015 * 15.5 + 0.061_f64).to_radians())
                };
                let error = (f64::from(*value) - expected).abs();
                assert!(error < tolerance, "{config:?}, axis {axis}: {value}, not {expected}");
            }
            assert_eq!(chip.borrow().misuse().first(), []);
        }
    }
}

#[test]
fn an_ina226_gives_current_and_voltage_for_every_shunt() {
    for (shunt_ohm, current_a) in [(0.1, -0.5), (0.005, 12.5), (0.000_5, 150.0)] {
        for rate_hz in [1, 50, 333] {
            let chip = Rc::new(RefCell::new(Ina226::new(0x45)));
            let mut bus = I2cBus::new(400_000);
            bus.attach(chip.clone());
            let config = SensorChip::Ina226(Ina226Config { shunt_ohm });
            let config = SensorConfig { id: CURRENT, address: 0x45, rate_hz, chip: config };
            let inputs = Inputs { shunt_v: current_a * f64::from(shunt_ohm), bus_v: 12.34 };
            let mut driver = AnyDriver::new(&config);
            let pass = |now_ns| chip.borrow_mut().feel(now_ns, inputs);
            let (values, quality) = read(&mut driver, &mut bus, 0x45, pass);
            assert_eq!(quality, Quality::Good);
            // half a count of 2.5 uV and of 1.25 mV, and the rounding of f32
            let tolerance_a = 1.25e-6 / f64::from(shunt_ohm) + 1e-6 * current_a.abs();
            assert!((f64::from(values[0]) - current_a).abs() < tolerance_a, "{values:?}");
            assert!((f64::from(values[1]) - 12.34).abs() < 0.000_63, "{values:?}");
            assert_eq!(chip.borrow().misuse().first(), []);
        }
    }
}

#[test]
fn an_as5600_gives_the_angle_of_its_magnet_with_every_filter() {
    const DEVIATION_DEG: [(u8, f64); 4] = [(2, 0.043), (4, 0.030), (8, 0.021), (16, 0.015)];
    for (averages, deviation_deg) in DEVIATION_DEG {
        for (magnet, expected) in [
            (Magnet::Good, Quality::Good),
            (Magnet::Weak, Quality::WeakMagnet),
            (Magnet::Strong, Quality::StrongMagnet),
            (Magnet::Absent, Quality::NoMagnet),
        ] {
            let chip = Rc::new(RefCell::new(As5600::new(7)));
            let mut bus = I2cBus::new(400_000);
            bus.attach(chip.clone());
            let config = SensorChip::As5600(As5600Config { averages });
            let id = ChannelId::new(ChannelKind::Angle, 0);
            let config = SensorConfig { id, address: 0x36, rate_hz: 1000, chip: config };
            let mut driver = AnyDriver::new(&config);
            chip.borrow_mut().set_magnet(magnet);
            let mut now_ns = 0;
            for angle_rad in [0.0, 1.0, 3.2, 6.2, -0.01, 400.0] {
                let from_ns = now_ns;
                // the magnet jumps there, and 20 ms are nine settling times of the slowest filter
                chip.borrow_mut().feel(from_ns + 1, angle_rad);
                chip.borrow_mut().feel(from_ns + 20 * MS, angle_rad);
                let (values, quality) = read(&mut driver, &mut bus, 0x36, |passed_ns| {
                    now_ns = from_ns + 20 * MS + passed_ns;
                    chip.borrow_mut().feel(now_ns, angle_rad);
                });
                assert_eq!(quality, expected);
                if magnet == Magnet::Absent {
                    continue;
                }
                let error = (f64::from(values[0]) - angle_rad + PI).rem_euclid(TAU) - PI;
                // a count, since it is rounded down, and five deviations; three times as much for a weak magnet
                let noise = if magnet == Magnet::Weak { 15.0 } else { 5.0 };
                let tolerance = TAU / 4096.0 + noise * deviation_deg.to_radians();
                assert!(error.abs() < tolerance, "{averages}, {magnet:?}: {} for {angle_rad}", values[0]);
            }
            assert_eq!(chip.borrow().misuse().first(), []);
        }
    }
}

#[test]
fn an_as5600_that_does_not_keep_its_settings_is_another_chip() {
    let chip = Rc::new(RefCell::new(As5600::new(7)));
    let mut bus = I2cBus::new(400_000);
    bus.attach(chip.clone());
    let id = ChannelId::new(ChannelKind::Angle, 0);
    let chip_config = SensorChip::As5600(As5600Config { averages: 2 });
    let mut driver = AnyDriver::new(&SensorConfig { id, address: 0x36, rate_hz: 1000, chip: chip_config });
    let mut outcomes = Vec::new();
    for transfer in 0..3 {
        let exchange = driver.next();
        let mut bytes = vec![0; exchange.read()];
        let mut operations = vec![Operation::Write(exchange.written())];
        if !bytes.is_empty() {
            operations.push(Operation::Read(&mut bytes));
        }
        bus.execute(transfer * MS, 0x36, &mut operations).unwrap();
        outcomes.push(driver.done(&bytes));
        if transfer == 1 {
            chip.borrow_mut().power_cycle();
        }
    }
    assert_eq!(outcomes, [Outcome::Next, Outcome::Next, Outcome::WrongChip]);
}

#[test]
fn a_current_monitor_follows_its_supply() {
    let supply = ChannelId::new(ChannelKind::Supply, 0);
    bench(&openscout(), async |bench| {
        bench.host.arm().await.unwrap();
        for (left, right) in [(0.0, 0.0), (-3.0, 3.0)] {
            drive(bench, left, right).await;
            bench.sleep_ms(1500).await;
            let (mut measured, mut truth) = ([0.0; 2], [0.0; 2]);
            for _ in 0..50 {
                let Sample::Sensor { values, quality, .. } = sample(bench, CURRENT).await else { panic!("a sensor") };
                assert_eq!(quality, Quality::Good);
                let mut world = bench.board.world();
                let exact = [world.rail_current_a(supply), world.rail_v(supply)];
                for index in 0..2 {
                    measured[index] += f64::from(values[index]) / 50.0;
                    truth[index] += exact[index].unwrap() / 50.0;
                }
            }
            // samples and truth are of different times: the loops change the current by a few per cent
            assert!((measured[0] - truth[0]).abs() < 0.02 + 0.1 * truth[0].abs(), "{measured:?}, {truth:?}");
            assert!((measured[1] - truth[1]).abs() < 0.02, "{measured:?}, {truth:?}");
            assert!(left == 0.0 || truth[0] > 0.2, "turning takes a current: {truth:?}");
        }
    });
}

/// Newest sample of `imu0`: values, age in ms, quality.
async fn imu(bench: &Bench<'_>) -> ([f64; 6], u16, Quality) {
    match sample(bench, IMU).await {
        Sample::Sensor { values, age_ms, quality, .. } => (values.map(f64::from), age_ms, quality),
        other => panic!("{other:?}"),
    }
}

/// Drives `openscout` with its left and right wheels at these speeds, rad/s.
async fn drive(bench: &Bench<'_>, left: f32, right: f32) {
    for (index, speed) in [left, right, left, right].into_iter().enumerate() {
        let wheel = ChannelId::new(ChannelKind::Dhb, index as u8);
        bench.set(wheel, Mode::Speed, speed).await.unwrap();
    }
}

#[test]
fn an_imu_follows_the_body() {
    let robot = openscout();
    let [mounting] = robot.simulation.imus[..] else { panic!("openscout has one") };
    bench(&robot, async |bench| {
        bench.host.arm().await.unwrap();
        for (left, right) in [(-3.0, 3.0), (3.0, -3.0)] {
            drive(bench, left, right).await;
            bench.sleep_ms(2000).await;
            let mean_of = 50;
            let mut mean = [0.0; 6];
            for _ in 0..mean_of {
                let (values, age_ms, quality) = imu(bench).await;
                // 100 readings a second, each sent within 5 ms
                assert!(quality == Quality::Good && age_ms <= 20, "{quality}, {age_ms} ms");
                mean.iter_mut().zip(values).for_each(|(mean, value)| *mean += value / f64::from(mean_of));
            }
            let yaw_rad_s = bench.board.world().twist().expect("it has a body").yaw_rad_s;
            assert!(yaw_rad_s.abs() > 0.5, "it turns: {yaw_rad_s} rad/s");
            // Noise is 1.6 mrad/s and 0.014 m/s2, less in the mean; the variation of the turn by the wheels' loops is
            // larger.
            let rate = mean[5] - mounting.rate_bias_rad_s[2];
            assert!((rate - yaw_rad_s).abs() < 0.02, "{rate} rad/s, {yaw_rad_s} rad/s");
            let up = mean[2] - mounting.acceleration_bias_m_s2[2];
            assert!((up - 9.806_65).abs() < 0.02, "{up} m/s2");
        }
    });
}

fn inject(bench: &Bench<'_>, disturbance: Disturbance) {
    let span = Span::Time { from_ns: bench.clock.now_ns(), until_ns: u64::MAX };
    bench.board.world().bus.inject(Injection { disturbance, span, address: Some(ADDRESS) });
}

/// A fault affects only its channel, and the sensor recovers by itself: it is addressed again each second, and its
/// set-up takes 0.2 s.
#[test]
fn a_sensor_that_fails_is_told_of_and_stops_nothing() {
    type Change = fn(&Bench<'_>);
    let broken: [(Change, Change, Quality, u64); 4] = [
        (|bench| inject(bench, Disturbance::AddressNack), |bench| bench.device().free_bus(), Quality::NoAnswer, 500),
        // it holds the bus when addressed, until it is clocked
        (
            |bench| inject(bench, Disturbance::StuckLow { persistent: false }),
            |bench| bench.device().free_bus(),
            Quality::NoAnswer,
            500,
        ),
        (
            |bench| bench.board.world().imu(IMU).unwrap().borrow_mut().set_hung(true),
            |bench| bench.board.world().imu(IMU).unwrap().borrow_mut().set_hung(false),
            Quality::Stale,
            500,
        ),
        // asleep after the loss of its supply, and another chip at the next address
        (
            |bench| {
                let now_ns = bench.clock.now_ns();
                let world = bench.board.world();
                let mut chip = world.imu(IMU).unwrap().borrow_mut();
                chip.set_identity(0xE1);
                chip.power_cycle(now_ns);
            },
            |bench| bench.board.world().imu(IMU).unwrap().borrow_mut().set_identity(0xEA),
            Quality::WrongChip,
            1500,
        ),
    ];
    bench(&openscout(), async |bench| {
        bench.host.arm().await.unwrap();
        drive(bench, 3.0, 3.0).await;
        bench.sleep_ms(1000).await;
        for (break_it, repair, expected, after_ms) in broken {
            assert_eq!(imu(bench).await.2, Quality::Good, "before {expected}");
            break_it(bench);
            bench.sleep_ms(after_ms).await;
            let (_, age_ms, quality) = imu(bench).await;
            assert_eq!(quality, expected);
            assert!(u64::from(age_ms) > after_ms - 50, "{expected}: {age_ms} ms");
            assert_eq!(bench.safety().await, (SafetyState::Armed, Causes::NONE), "{expected}");
            repair(bench);
            bench.sleep_ms(1500).await;
        }
        assert_eq!(imu(bench).await.2, Quality::Good);
        // the wheels did not stop meanwhile
        let speed = bench.board.world().speed(ChannelId::new(ChannelKind::Dhb, 0)).unwrap();
        assert!((speed - 3.0).abs() < 0.2, "{speed} rad/s");
    });
}

#[test]
fn a_bus_that_a_sensor_holds_for_ever_trips_the_board() {
    bench(&openscout(), async |bench| {
        bench.host.arm().await.unwrap();
        bench.sleep_ms(500).await;
        inject(bench, Disturbance::StuckLow { persistent: true });
        bench.sleep_ms(500).await;
        let (state, causes) = bench.safety().await;
        assert!(state == SafetyState::Tripped && causes.contains(Cause::I2cFault), "{causes}");
    });
}

#[test]
fn a_number_at_the_end_of_its_range_is_told() {
    let mut robot = openscout();
    robot.simulation.imus[0].acceleration_bias_m_s2 = [0.0, -50.0, 0.0];
    bench(&robot, async |bench| {
        bench.sleep_ms(1000).await;
        let (values, _, quality) = imu(bench).await;
        // 4 g, the end of the range
        assert!(quality == Quality::Saturated && (values[1] + 39.2266).abs() < 0.01, "{values:?}, {quality}");
    });
}

/// Writes to the output chips and read-backs have the same times as with unplugged sensors, which are addressed three
/// times a second.
#[test]
fn outputs_have_the_bus_when_they_would_have_it_without_a_sensor() {
    let wire = |robot: &Robot| {
        bench(robot, async |bench| {
            bench.sleep_ms(500).await;
            bench.device().record_wire();
            bench.host.arm().await.unwrap();
            // duties, which do not depend on measurements: sampling the world more often changes its rounding
            for duty in [0.4, -0.6, 0.2, 0.9] {
                for index in 0..4 {
                    bench.set(ChannelId::new(ChannelKind::Dhb, index), Mode::Duty, duty).await.unwrap();
                }
                bench.sleep_ms(250).await;
            }
            bench.host.disarm().await.unwrap();
            bench.sleep_ms(100).await;
            bench.device().wire_since(0).collect::<Vec<_>>()
        })
    };
    let is_sensor = |address| address == ADDRESS || address == 0x45;
    let with = wire(&openscout());
    let mut robot = openscout();
    robot.simulation.imus.clear();
    robot.simulation.currents.clear();
    let without: Vec<_> = wire(&robot).into_iter().filter(|record| !is_sensor(record.address)).collect();
    let (sensors, outputs): (Vec<_>, Vec<_>) = with.into_iter().partition(|record| is_sensor(record.address));
    // 1.1 s, 100 readings a second of two transfers, and 50 of three
    assert!((340..=420).contains(&sensors.len()), "{}", sensors.len());
    assert!(outputs.len() > 400, "{}", outputs.len());
    let differs = outputs.iter().zip(&without).find(|(with, without)| with != without);
    assert!(differs.is_none() && outputs.len() == without.len(), "{differs:?}");
}

const FORCE: ChannelId = ChannelId::new(ChannelKind::Force, 0);

/// Half of the range that the gain leaves of 500 mV/V, and the force of it, N, at 24.5 N per mV/V.
#[test]
fn an_nau7802_gives_the_force_at_every_gain_and_rate() {
    for gain in [1, 2, 4, 8, 16, 32, 64, 128] {
        for rate_hz in [10, 20, 40, 80, 320] {
            let chip = Rc::new(RefCell::new(Nau7802::new(7)));
            let mut bus = I2cBus::new(400_000);
            bus.attach(chip.clone());
            let config = Nau7802Config { gain, newtons_per_mv_v: 24.5, zero_mv_v: 0.125 };
            let config = SensorConfig { id: FORCE, address: 0x2A, rate_hz, chip: SensorChip::Nau7802(config) };
            let mut driver = AnyDriver::new(&config);
            for share in [0.5, -0.5] {
                let mv_v = 0.125 + share * 500.0 / f64::from(gain);
                let from_ns = chip.borrow().felt_ns();
                // after a step, the settling time of the filter: ten periods of the slowest rate
                chip.borrow_mut().feel(from_ns + 1000 * MS, mv_v);
                let pass = |now_ns| chip.borrow_mut().feel(from_ns + 1000 * MS + now_ns, mv_v);
                let (values, quality) = read(&mut driver, &mut bus, 0x2A, pass);
                assert_eq!(quality, Quality::Good);
                let newtons = share * 500.0 / f64::from(gain) * 24.5;
                // five standard deviations of the model's noise at this rate, for an input fed with 3 V, plus f32
                let noise_v = 50e-9_f64.hypot(1.5e-6 / f64::from(gain)) * (f64::from(rate_hz) / 10.0).sqrt();
                let tolerance_n = 5.0 * noise_v / 3.0 * 1e3 * 24.5 + 1e-6 * newtons.abs();
                let error_n = (f64::from(values[0]) - newtons).abs();
                assert!(error_n < tolerance_n, "gain {gain}, {rate_hz} Hz: {} N, not {newtons} N", values[0]);
            }
            assert_eq!(chip.borrow().misuse().first(), []);
        }
    }
}

/// Beyond its range the quality says so, and another chip at its address is rejected.
#[test]
fn an_nau7802_tells_what_it_cannot_measure() {
    let config = Nau7802Config { gain: 128, newtons_per_mv_v: 24.5, zero_mv_v: 0.0 };
    let config = SensorConfig { id: FORCE, address: 0x2A, rate_hz: 80, chip: SensorChip::Nau7802(config) };
    for (mv_v, expected) in [(3.85, Quality::Good), (4.1, Quality::Saturated), (-4.1, Quality::Saturated)] {
        let chip = Rc::new(RefCell::new(Nau7802::new(7)));
        let mut bus = I2cBus::new(400_000);
        bus.attach(chip.clone());
        let pass = |now_ns| chip.borrow_mut().feel(now_ns, mv_v);
        let (_, quality) = read(&mut AnyDriver::new(&config), &mut bus, 0x2A, pass);
        assert_eq!(quality, expected, "{mv_v} mV/V");
    }
    let chip = Rc::new(RefCell::new(Nau7802::new(7)));
    chip.borrow_mut().set_revision(0x05);
    let mut bus = I2cBus::new(400_000);
    bus.attach(chip.clone());
    let mut driver = AnyDriver::new(&config);
    for transfer in 0..10 {
        let exchange = driver.next();
        let mut bytes = vec![0; exchange.read()];
        let mut operations = vec![Operation::Write(exchange.written())];
        if !bytes.is_empty() {
            operations.push(Operation::Read(&mut bytes));
        }
        bus.execute(transfer * MS, 0x2A, &mut operations).unwrap();
        if driver.done(&bytes) == Outcome::WrongChip {
            return;
        }
    }
    panic!("it was taken for an NAU7802");
}

/// `openscout` with a load cell of 100 N and 2 mV/V whose true parameters differ from the configured ones.
fn with_a_load_cell(newtons_per_mv_v: f64, zero_mv_v: f64, noise_n: f64) -> Robot {
    let mut robot = openscout();
    let chip = SensorChip::Nau7802(Nau7802Config { gain: 128, newtons_per_mv_v: 50.0, zero_mv_v: 0.0 });
    robot.config.sensors.push(SensorConfig { id: FORCE, address: 0x2A, rate_hz: 80, chip }).unwrap();
    let cell = SimulatedForce { channel: FORCE, force_n: 60.0, reads: None, newtons_per_mv_v, zero_mv_v, noise_n };
    robot.simulation.forces = vec![cell];
    robot
}

async fn force(bench: &Bench<'_>) -> (f64, u16, Quality) {
    match sample(bench, FORCE).await {
        Sample::Sensor { values, age_ms, quality, .. } => (values[0].into(), age_ms, quality),
        other => panic!("{other:?}"),
    }
}

/// A cell that gives 48 N where the board assumes 50 N, with 0.02 mV/V at rest: 60 N are read as 63.5 N.
#[test]
fn a_load_cell_is_read_80_times_a_second_as_the_board_takes_it_to_be() {
    bench(&with_a_load_cell(48.0, 0.02, 0.05), async |bench| {
        // time for regulator, calibration and settling
        bench.sleep_ms(1000).await;
        let mut mean_n = 0.0;
        for _ in 0..50 {
            let (newtons, age_ms, quality) = force(bench).await;
            assert!(quality == Quality::Good && age_ms <= 20, "{quality}, {age_ms} ms");
            mean_n += newtons / 50.0;
            bench.sleep_ms(10).await;
        }
        let expected_n = 50.0 * (0.02 + 60.0 / 48.0);
        // five standard errors of the mean of some 40 conversions of 0.05 N
        assert!((mean_n - expected_n).abs() < 5.0 * 0.05 / 40_f64.sqrt(), "{mean_n} N, not {expected_n} N");
    });
}

#[test]
fn a_load_cell_that_fails_is_told_of_and_comes_back() {
    type Change = fn(&mut Nau7802);
    let broken: [(Change, Change, Quality, u64); 2] = [
        (|chip| chip.set_hung(true), |chip| chip.set_hung(false), Quality::Stale, 500),
        // supply lost: the chip is off, is set up again, and then it is another one
        (
            |chip| {
                chip.set_revision(0);
                chip.power_cycle();
            },
            |chip| chip.set_revision(0x0F),
            Quality::WrongChip,
            500,
        ),
    ];
    bench(&with_a_load_cell(50.0, 0.0, 0.0), async |bench| {
        bench.sleep_ms(1000).await;
        for (break_it, repair, expected, after_ms) in broken {
            assert_eq!(force(bench).await.2, Quality::Good, "before {expected}");
            break_it(&mut bench.board.world().load_cell(FORCE).unwrap().borrow_mut());
            bench.sleep_ms(after_ms).await;
            assert_eq!(force(bench).await.2, expected);
            repair(&mut bench.board.world().load_cell(FORCE).unwrap().borrow_mut());
            bench.sleep_ms(2500).await;
            let (newtons, _, quality) = force(bench).await;
            assert_eq!(quality, Quality::Good, "after {expected}");
            // noise of a conversion is 1.2 mN, plus f32
            assert!((newtons - 60.0).abs() < 0.02, "{newtons} N after {expected}");
        }
    });
}

const DISTANCE: ChannelId = ChannelId::new(ChannelKind::Distance, 0);

/// Runs `driver` on the bus until `count` readings, a transfer in each millisecond; `pass` gets the time.
fn readings(
    driver: &mut AnyDriver,
    bus: &mut I2cBus,
    address: u8,
    count: usize,
    mut pass: impl FnMut(u64),
) -> Vec<(u64, f32, Quality)> {
    let (mut now_ns, mut all) = (0, Vec::new());
    for _ in 0..20_000 {
        pass(now_ns);
        let exchange = driver.next();
        let mut bytes = vec![0; exchange.read()];
        let mut operations = vec![Operation::Write(exchange.written())];
        if !bytes.is_empty() {
            operations.push(Operation::Read(&mut bytes));
        }
        bus.execute(now_ns, address, &mut operations).unwrap();
        now_ns += MS;
        match driver.done(&bytes) {
            Outcome::Next | Outcome::NotReady => {}
            Outcome::Wait(duration) => now_ns += duration.as_micros() * 1000,
            Outcome::Reading { values, quality } => all.push((now_ns, values[0], quality)),
            Outcome::WrongChip => panic!("it is the right one"),
        }
        if all.len() == count {
            return all;
        }
    }
    panic!("only {} readings", all.len());
}

/// Includes a chip that still measures by its settings of before the board's restart.
#[test]
fn a_vl6180x_gives_the_distance_at_every_rate() {
    for rate_hz in [1, 2, 4, 5, 10, 20, 25, 50] {
        let chip = Rc::new(RefCell::new(Vl6180x::new(7, 0.003)));
        let mut bus = I2cBus::new(400_000);
        bus.attach(chip.clone());
        let config = SensorChip::Vl6180x(Vl6180xConfig {});
        let config = SensorConfig { id: DISTANCE, address: 0x29, rate_hz, chip: config };
        for distance_m in [0.01, 0.05, 0.1] {
            let mut driver = AnyDriver::new(&config);
            let from_ns = chip.borrow().felt_ns();
            let target = Some(Target { distance_m, reflectance: 0.17 });
            let pass = |now_ns| chip.borrow_mut().feel(from_ns + now_ns, target);
            let all = readings(&mut driver, &mut bus, 0x29, 10, pass);
            for (_, shown_m, quality) in &all {
                // 3 mm of offset; five deviations of 1 mm up to 50 mm, and a count
                let tolerance_m = 5e-3 * (distance_m / 0.05).max(1.0) + 0.5e-3;
                assert_eq!(*quality, Quality::Good);
                assert!((f64::from(*shown_m) - distance_m - 0.003).abs() < tolerance_m, "{shown_m} at {distance_m} m");
            }
            let took_s = (all[9].0 - all[0].0) as f64 * 1e-9;
            // sampled each millisecond
            assert!((took_s - 9.0 / f64::from(rate_hz)).abs() < 0.003, "{rate_hz} Hz: {took_s} s");
        }
        assert_eq!(chip.borrow().misuse().first(), []);
    }
}

#[test]
fn a_vl6180x_tells_that_there_is_nothing_and_what_is_too_near() {
    let config = SensorChip::Vl6180x(Vl6180xConfig {});
    let config = SensorConfig { id: DISTANCE, address: 0x29, rate_hz: 20, chip: config };
    let white = |distance_m| Some(Target { distance_m, reflectance: 0.88 });
    for (target, offset_m, expected, metres) in [
        (None, 0.0, Quality::OutOfRange, 0.2),
        (white(2.0), 0.0, Quality::OutOfRange, 0.2),
        (white(0.25), 0.0, Quality::OutOfRange, 0.2),
        (white(0.001), -0.03, Quality::Saturated, 0.0),
    ] {
        let chip = Rc::new(RefCell::new(Vl6180x::new(7, offset_m)));
        let mut bus = I2cBus::new(400_000);
        bus.attach(chip.clone());
        let pass = |now_ns| chip.borrow_mut().feel(now_ns, target);
        let all = readings(&mut AnyDriver::new(&config), &mut bus, 0x29, 3, pass);
        for (_, shown_m, quality) in all {
            assert_eq!((quality, shown_m), (expected, metres), "{target:?}");
        }
    }
}

#[test]
fn a_distance_sensor_is_read_and_comes_back_after_the_loss_of_its_supply() {
    let mut robot = openscout();
    let chip = SensorChip::Vl6180x(Vl6180xConfig {});
    robot.config.sensors.push(SensorConfig { id: DISTANCE, address: 0x29, rate_hz: 20, chip }).unwrap();
    let (reads, reflectance, offset_m) = (None, 0.17, 0.0);
    let sees = SimulatedDistance { channel: DISTANCE, distance_m: Some(0.04), reads, reflectance, offset_m };
    robot.simulation.distances = vec![sees];
    bench(&robot, async |bench| {
        let read = async || match sample(bench, DISTANCE).await {
            Sample::Sensor { values, age_ms, quality, .. } => (f64::from(values[0]), age_ms, quality),
            other => panic!("{other:?}"),
        };
        let near = |(metres, _, quality): (f64, u16, Quality)| {
            // five deviations of 1 mm, and half a count
            assert!(quality == Quality::Good && (metres - 0.04).abs() < 5.5e-3, "{metres} m, {quality}");
        };
        bench.sleep_ms(600).await;
        for _ in 0..20 {
            let sample = read().await;
            near(sample);
            // period of 50 ms, plus three transfers and the telemetry frame
            assert!(sample.1 <= 60, "{} ms", sample.1);
            bench.sleep_ms(23).await;
        }
        bench.board.world().distance_sensor(DISTANCE).unwrap().borrow_mut().power_cycle();
        bench.sleep_ms(400).await;
        assert_eq!(read().await.2, Quality::Stale);
        bench.sleep_ms(1500).await;
        near(read().await);
    });
}
