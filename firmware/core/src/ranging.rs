//! The ranging task: pings the range sensors, one after the other.

use core::future::pending;

use embassy_time::{Duration, Instant, Timer};
use heapless::Vec;
use r4_protocol::config::{RANGE_SENSORS, RangeConfig};

use crate::{
    platform::{EchoState, Ranging},
    sensing::range::{Echo, LOST_AFTER, RangeReading, RangeSensor},
};

/// From one ping to the next, of the same sensor or of another.
///
/// The datasheet wants 60 ms between the pings of one sensor, for late echoes to die away: in 60 ms sound goes 10 m there
/// and back. Another sensor hears the same echoes, so it waits as long: two sensors are read every 120 ms, four every
/// 240 ms.
pub const TURN: Duration = Duration::from_millis(60);
/// The datasheet wants 10 µs; the clock's tick of 1 µs may cut one off at either end.
const TRIGGER: Duration = Duration::from_micros(12);
/// From the trigger on: an echo starts after about 0.5 ms and ends at the latest, without a target, 38 ms later.
const WAIT: Duration = Duration::from_millis(40);
/// How often the capture is looked at, and with it how late a reading is.
const POLL: Duration = Duration::from_millis(1);

/// Time between two readings of one of `sensors` sensors.
#[must_use]
pub fn cycle(sensors: usize) -> Duration {
    TURN * sensors as u32
}

/// Whether a sensor with a limit says that the board must stop, or has not been heard of for so long that the ranging
/// task itself must be dead. `readings` are the newest published, in the order of `config`.
#[must_use]
pub fn must_stop(config: &[RangeConfig], readings: &[RangeReading], now: Instant) -> bool {
    // One cycle more than a sensor may miss answers: pings that end late are not yet a dead task.
    let silence = cycle(config.len()) * (u32::from(LOST_AFTER) + 1);
    config.iter().zip(readings).any(|(config, reading)| {
        config.stop_below_m.is_some() && (reading.stop || now.saturating_duration_since(reading.updated) > silence)
    })
}

/// Pings the sensors of `config` in turn for ever and gives each outcome to `publish`, with the sensor's place in
/// `config`, within 1 ms of the end of its echo.
///
/// A sensor whose echo does not end keeps its turn but is not triggered, which it would ignore; the others go on.
pub async fn run<H: Ranging>(
    config: &[RangeConfig],
    air_temperature_c: f32,
    mut hardware: H,
    mut publish: impl FnMut(usize, RangeReading),
) -> ! {
    let sensor = |config: &RangeConfig| (config.id.index, RangeSensor::new(config, air_temperature_c));
    let mut sensors: Vec<_, RANGE_SENSORS> = config.iter().take(RANGE_SENSORS).map(sensor).collect();
    // The first ping waits too: a sensor may still listen to one from before a restart, or be starting up itself.
    let mut next = Instant::now() + TURN;
    loop {
        if sensors.is_empty() {
            pending::<()>().await;
        }
        for (place, (index, sensor)) in sensors.iter_mut().enumerate() {
            Timer::at(next).await;
            next = Instant::now() + TURN;
            let echo = ping(&mut hardware, *index).await;
            publish(place, sensor.update(echo, Instant::now()));
        }
    }
}

async fn ping<H: Ranging>(hardware: &mut H, index: u8) -> Echo {
    hardware.clear(index);
    if let EchoState::High { .. } = hardware.echo(index) {
        return Echo::Stuck;
    }
    hardware.trigger(index, true);
    Timer::after(TRIGGER).await;
    hardware.trigger(index, false);
    let end = Instant::now() + WAIT;
    loop {
        match hardware.echo(index) {
            EchoState::Done { width_us } => return Echo::Width(width_us),
            EchoState::Idle if Instant::now() >= end => return Echo::None,
            EchoState::High { .. } if Instant::now() >= end => return Echo::Stuck,
            EchoState::Idle | EchoState::High { .. } => Timer::after(POLL).await,
        }
    }
}
