//! Force control on the simulated board: reactions to a force sensor in each mode of the motor.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use r4_boards::{Robot, SimulatedAnalog, SimulatedForce};
use r4_protocol::{
    Cause, Causes, ChannelId, ChannelKind, Mode, Range, Refusal, SafetyState,
    config::{AnalogConfig, ForceConfig, ForceSensor, Nau7802Config, SensorChip, SensorConfig},
};

use crate::harness::{Bench, bench};

const FINGER: ChannelId = ChannelId::new(ChannelKind::Osmc, 0);
/// Sensor voltage without force, V, and its scale, N/V.
const ZERO_V: f64 = 0.5;
const N_PER_V: f64 = 10.0;

/// The bench's motor with a force sensor at analog input 2: 0.5 V and 10 N/V, up to 20 N, with a trip beyond 30 N.
fn finger() -> Robot {
    let mut robot = r4_boards::load("osmc-bench").expect("built in");
    let channel = ChannelId::new(ChannelKind::Analog, 2);
    let volts_per_code = robot.config.supplies[0].volts_per_code;
    let plausible_v = Range::new(0.2, 4.8);
    robot.config.analogs.push(AnalogConfig { id: channel, volts_per_code, offset_v: 0.0, plausible_v }).unwrap();
    robot.simulation.analogs.push(SimulatedAnalog {
        channel,
        volts: ZERO_V,
        volts_per_code: volts_per_code.into(),
        noise_rms_codes: 2.3,
        field: None,
        reads: None,
    });
    let control = robot.config.motors[0].control.as_mut().expect("it has an encoder");
    control.force = Some(ForceConfig {
        sensor: ForceSensor::Analog { analog: 2, zero_v: ZERO_V as f32, newtons_per_v: N_PER_V as f32 },
        range: Range::new(0.0, 20.0),
        limit_n: 30.0,
        speed_per_n: 0.1,
        approach_speed: 1.0,
        contact_n: 1.0,
        error_n: 0.5,
        filter_s: 0.0,
        drift_s: 0.0,
    });
    robot
}

fn press_sensor(bench: &Bench<'_>, newtons: f64) {
    bench.board.world().pins().analogs[2].as_mut().expect("the sensor's").volts = ZERO_V + newtons / N_PER_V;
}

/// Mean speed over half a second, rad/s, which averages cogging and friction ripple.
async fn speed(bench: &Bench<'_>) -> f64 {
    let before = bench.board.world().position(FINGER).expect("a motor");
    bench.sleep_ms(500).await;
    (bench.board.world().position(FINGER).expect("a motor") - before) / 0.5
}

/// A force 10 N too low gives 1 rad/s, 10 N too high the same backwards, and within the band it rests.
#[test]
fn a_motor_closes_opens_and_rests_by_its_force() {
    bench(&finger(), async |bench| {
        bench.host.arm().await.unwrap();
        bench.set(FINGER, Mode::Force, 12.0).await.unwrap();
        // the bench's motor takes 0.2 s to any speed
        for (newtons, expected) in [(0.0, 1.0), (8.0, 0.4), (12.3, 0.0), (18.0, -0.6)] {
            press_sensor(bench, newtons);
            bench.sleep_ms(400).await;
            let speed = speed(bench).await;
            // The position loop is still some 10 mrad from the ramp that it follows, and catches up within the half
            // second.
            assert!((speed - expected).abs() < 0.08, "{newtons} N: {speed} rad/s");
        }
        assert_eq!(bench.host.safety().0, SafetyState::Armed);
    });
}

/// The trip occurs in any mode, and before arming.
#[test]
fn too_much_force_trips_in_any_mode() {
    for mode in [None, Some((Mode::Duty, 0.0)), Some((Mode::Position, 0.5)), Some((Mode::Force, 5.0))] {
        bench(&finger(), async |bench| {
            if let Some((mode, value)) = mode {
                bench.host.arm().await.unwrap();
                bench.set(FINGER, mode, value).await.unwrap();
            }
            bench.sleep_ms(50).await;
            press_sensor(bench, 31.0);
            bench.sleep_ms(50).await;
            let (state, causes) = bench.safety().await;
            assert_eq!((state, causes), (SafetyState::Tripped, Causes::only(Cause::ForceLimit)), "{mode:?}");
            // after the force is removed, the motor may go on
            press_sensor(bench, 0.0);
            bench.sleep_ms(50).await;
            bench.host.clear().await.unwrap();
        });
    }
}

/// A cut wire gives 0 V, which the input reports as no reading. A motor in another mode does not need it.
#[test]
fn a_motor_that_presses_needs_its_sensor() {
    for (mode, value, expected) in [
        (Mode::Force, 5.0, (SafetyState::Tripped, Causes::only(Cause::EncoderImplausible))),
        (Mode::Speed, 0.5, (SafetyState::Armed, Causes::NONE)),
    ] {
        bench(&finger(), async |bench| {
            bench.host.arm().await.unwrap();
            bench.set(FINGER, mode, value).await.unwrap();
            bench.sleep_ms(200).await;
            bench.board.world().pins().analogs[2].as_mut().unwrap().volts = 0.0;
            bench.sleep_ms(200).await;
            assert_eq!(bench.safety().await, expected, "{mode}");
        });
    }
}

/// A refused newer force ends the older one: the motor stands.
#[test]
fn a_force_out_of_range_is_refused_and_stops_the_motor() {
    bench(&finger(), async |bench| {
        bench.host.arm().await.unwrap();
        bench.set(FINGER, Mode::Force, 12.0).await.unwrap();
        bench.sleep_ms(300).await;
        assert!(speed(bench).await > 0.9);
        let refused = bench.set(FINGER, Mode::Force, 20.5).await;
        assert!(
            matches!(&refused, Err(r4_driver::Error::Refused(Refusal::OutOfRange { channel: FINGER, .. }))),
            "{refused:?}"
        );
        bench.sleep_ms(400).await;
        let speed = speed(bench).await;
        assert!(speed.abs() < 0.02, "{speed} rad/s");
    });
    let plain = r4_boards::load("osmc-bench").expect("built in");
    bench(&plain, async |bench| {
        bench.host.arm().await.unwrap();
        let refused = bench.set(FINGER, Mode::Force, 5.0).await;
        assert!(matches!(&refused, Err(r4_driver::Error::Refused(Refusal::WrongMode { .. }))), "{refused:?}");
    });
}

/// The same motor with a load cell on the bus, read 320 times a second, with a force of 18 N.
#[test]
fn a_load_cell_serves_as_an_analog_sensor_does() {
    let mut robot = finger();
    let cell = ChannelId::new(ChannelKind::Force, 0);
    let chip = SensorChip::Nau7802(Nau7802Config { gain: 128, newtons_per_mv_v: 50.0, zero_mv_v: 0.0 });
    robot.config.sensors.push(SensorConfig { id: cell, address: 0x2A, rate_hz: 320, chip }).unwrap();
    let truth = SimulatedForce {
        channel: cell,
        force_n: 18.0,
        reads: None,
        newtons_per_mv_v: 50.0,
        zero_mv_v: 0.0,
        noise_n: 0.05,
    };
    robot.simulation.forces = vec![truth];
    let control = robot.config.motors[0].control.as_mut().unwrap();
    let force = control.force.as_mut().unwrap();
    force.sensor = ForceSensor::LoadCell { force: 0 };
    bench(&robot, async |bench| {
        // its calibration takes half a second
        bench.sleep_ms(1000).await;
        bench.host.arm().await.unwrap();
        bench.set(FINGER, Mode::Force, 12.0).await.unwrap();
        bench.sleep_ms(400).await;
        let speed = speed(bench).await;
        assert!((speed + 0.6).abs() < 0.08, "{speed} rad/s");
        bench.board.world().load_cell(cell).unwrap().borrow_mut().set_hung(true);
        bench.sleep_ms(200).await;
        assert_eq!(bench.safety().await, (SafetyState::Tripped, Causes::only(Cause::EncoderImplausible)));
    });
}
