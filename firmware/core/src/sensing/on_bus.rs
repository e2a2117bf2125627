//! Sensors on the bus of the output chips, read in the bus time that the outputs leave.
//!
//! Each sensor gets at most one transfer per period. A failed transfer is not repeated in its period, and a sensor that
//! has failed is left alone for a while: the outputs' share of the bus does not depend on the sensors.

use embassy_time::{Duration, Instant};
use heapless::Vec;
use r4_protocol::{
    ChannelId, ChannelKind, Quality,
    channel::MAX_QUANTITIES,
    config::{AS5600_COUNTS, MAX_SENSORS, SensorConfig},
};

use crate::{
    bus::{ExchangeFault, Scheduler, TRIES},
    chips::{
        any::AnyDriver,
        sensor::{Driver, MAX_READ, Outcome},
    },
    platform::Bus,
    sensing::angle::Reading,
};

/// Pause before a failed sensor is tried again. One that holds the bus blocks it for up to 2 ms each time, until the
/// transfer is given up and the bus freed: then at most two periods in a thousand are late, while ten in a row trip.
const RETRY: Duration = Duration::from_secs(1);
/// Time from the start to the first transfer: the longest power-up time of the supported chips (ICM-20948, table 3).
const POWER_UP: Duration = Duration::from_millis(100);
/// Number of a sensor's own periods without a new reading after which it has failed.
const STALE_PERIODS: u32 = 5;

/// All sensors on the bus, in the order of the configuration.
pub(crate) struct Sensors {
    sensors: Vec<Sensor, MAX_SENSORS>,
    /// Index of the sensor that comes first in the next period.
    first: usize,
}

/// Present values of one sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Values {
    /// Values in SI units, in the order of the channel's quantities.
    pub(crate) values: [f32; MAX_QUANTITIES],
    /// Quality of all values.
    pub(crate) quality: Quality,
    /// Time of the transfer that read them.
    pub(crate) taken: Instant,
}

/// Last reading of a load cell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ForceReading {
    /// The force, N.
    pub(crate) newtons: f32,
    /// Time of the transfer. The measurement is older: the converter's filter takes four of its periods.
    pub(crate) taken: Instant,
    /// Nominal time between two readings.
    pub(crate) period: Duration,
}

struct Sensor {
    id: ChannelId,
    address: u8,
    period: Duration,
    /// Time by which a reading may come before it is due.
    early: Duration,
    driver: AnyDriver,
    /// Earliest time of the next transfer.
    due: Instant,
    /// Nominal time of the newest reading.
    reading_due: Instant,
    /// Deadline of the next reading; `None` during the set-up.
    stale_at: Option<Instant>,
    /// Number of failed transfers in a row.
    failed: u32,
    values: [f32; MAX_QUANTITIES],
    taken: Instant,
    quality: Quality,
}

impl Sensors {
    pub(crate) fn new<'c>(configs: impl Iterator<Item = &'c SensorConfig>, control_period: Duration) -> Self {
        let now = Instant::now();
        let due = now + POWER_UP;
        let period = |config: &SensorConfig| Duration::from_hz(u64::from(config.rate_hz).max(1));
        let sensors = configs.map(|config| Sensor {
            id: config.id,
            address: config.address,
            period: period(config),
            // Sensors read about once per control period may come early, since the moment within a period varies with
            // the other work: one polled slightly before its time must not wait for the next period.
            early: if period(config) < control_period * 2 { period(config) / 2 } else { Duration::MIN },
            driver: AnyDriver::new(config),
            due,
            reading_due: due,
            stale_at: None,
            failed: 0,
            values: [0.0; MAX_QUANTITIES],
            taken: now,
            quality: Quality::None,
        });
        Self { sensors: sensors.collect(), first: 0 }
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.sensors.is_empty()
    }

    /// Last reading of angle sensor number `angle`; `None` if it cannot be relied on or there is no such sensor.
    pub(crate) fn angle(&self, angle: u8) -> Option<Reading> {
        let id = ChannelId::new(ChannelKind::Angle, angle);
        let sensor = self.sensors.iter().find(|sensor| sensor.id == id)?;
        let usable = matches!(sensor.quality, Quality::Good | Quality::WeakMagnet | Quality::StrongMagnet);
        let counts = libm::roundf(sensor.values[0] * (f32::from(AS5600_COUNTS) / core::f32::consts::TAU)) as u16;
        usable.then_some(Reading { counts, taken: sensor.taken, period: sensor.period })
    }

    /// Last reading of load cell number `index`; `None` if it cannot be relied on or there is no such sensor. A cell at
    /// the end of its range is not relied on: the force may be anything beyond it.
    pub(crate) fn force(&self, index: u8) -> Option<ForceReading> {
        let id = ChannelId::new(ChannelKind::Force, index);
        let sensor = self.sensors.iter().find(|sensor| sensor.id == id)?;
        let usable = sensor.quality == Quality::Good;
        usable.then_some(ForceReading { newtons: sensor.values[0], taken: sensor.taken, period: sensor.period })
    }

    /// Carries out one transfer with each sensor that is due, while the bus has room in this period and until `stops`,
    /// called before each, returns true. The first sensor that had to wait comes first in the next period. Changed
    /// values are passed to `publish`, with the sensor's place in the configuration.
    pub(crate) async fn ask<B: Bus>(
        &mut self,
        bus: &mut Scheduler<B>,
        mut stops: impl FnMut() -> bool,
        mut publish: impl FnMut(usize, Values),
    ) {
        let count = self.sensors.len();
        let first = self.first;
        let mut waiting = None;
        for step in 0..count {
            let index = (first + step) % count;
            let Some(sensor) = self.sensors.get_mut(index) else { break };
            let now = Instant::now();
            let mut changed = sensor.has_become_stale(now);
            if now + sensor.early >= sensor.due {
                let exchange = sensor.driver.next();
                if waiting.is_none() && !stops() && bus.fits(exchange.bits()) {
                    let mut read = [0; MAX_READ];
                    let read = &mut read[..exchange.read()];
                    let result = bus.exchange(sensor.address, &exchange, read).await;
                    changed |= sensor.take(result, read, now);
                } else {
                    waiting.get_or_insert(index);
                }
            }
            if changed {
                let Sensor { values, quality, taken, .. } = *sensor;
                publish(index, Values { values, quality, taken });
            }
        }
        self.first = waiting.unwrap_or(first);
    }
}

impl Sensor {
    fn has_become_stale(&mut self, now: Instant) -> bool {
        let stale = self.stale_at.is_some_and(|at| now >= at);
        if stale {
            self.fail(Quality::Stale, now);
        }
        stale
    }

    /// Takes the result of the transfer begun at `now`; returns true if the status has changed.
    fn take(&mut self, result: Result<(), ExchangeFault>, read: &[u8], now: Instant) -> bool {
        if let Err(fault) = result {
            self.failed += 1;
            // A sensor that may hold the bus is not tried again at once.
            let given_up = self.failed == TRIES || fault == ExchangeFault::Bus;
            if given_up {
                self.fail(Quality::NoAnswer, now);
            }
            return given_up;
        }
        self.failed = 0;
        match self.driver.done(read) {
            Outcome::Next => false,
            Outcome::NotReady => {
                self.stale_at.get_or_insert(now + self.period * STALE_PERIODS);
                false
            }
            Outcome::Wait(duration) => {
                // The wait counts from the end of the transfer, which takes less than 1 ms.
                self.due = now + duration + Duration::from_millis(1);
                self.reading_due = self.due;
                false
            }
            Outcome::WrongChip => {
                self.fail(Quality::WrongChip, now);
                true
            }
            Outcome::Reading { values, quality } => {
                (self.values, self.taken, self.quality) = (values, now, quality);
                self.stale_at = Some(now + self.period * STALE_PERIODS);
                // Readings are due on a grid, so that a wait for the bus does not lower the rate; missed ones are not
                // made up for.
                self.reading_due = (self.reading_due + self.period).max(now);
                self.due = self.reading_due;
                true
            }
        }
    }

    /// Marks the sensor as failed and restarts its driver after [`RETRY`].
    fn fail(&mut self, quality: Quality, now: Instant) {
        self.quality = quality;
        (self.failed, self.stale_at) = (0, None);
        self.due = now + RETRY;
        self.driver.restart();
    }
}
