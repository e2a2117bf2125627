//! Sensors on the body that read a field of the world at their place.
//!
//! They sample at multiples of a fixed period, independent of queries: the world is stepped up to each of these times.
//! The input of the converter is at most one period old.

use r4_boards::FieldReading;
use r4_world::{Field, Lag};

use super::{World, body::Coupling};

/// Period of the samples, ns: our choice, a hundredth of the fastest gas sensors' time constant of 1 s; a robot at 1
/// m/s moves 10 mm.
const PERIOD_NS: u64 = 10_000_000;

/// A sensor with the state of its lag and of the body's charge.
#[derive(Clone, Debug)]
pub struct FieldSensor {
    reading: FieldReading,
    lag: Lag,
    /// Field of the body's charge, in the field's unit.
    charge: f64,
}

impl FieldSensor {
    pub(super) fn new(reading: FieldReading) -> Self {
        Self { lag: Lag::new(reading.lag_s), charge: reading.charge.rest, reading }
    }

    /// Output of the sensor, V.
    #[must_use]
    pub fn volts(&self) -> f64 {
        let FieldReading { zero_v, volts_per_unit, enhancement, .. } = self.reading;
        zero_v + volts_per_unit * enhancement * self.lag.reading()
    }

    /// Field of the body's own charge, in the field's unit.
    #[must_use]
    pub const fn charge(&self) -> f64 {
        self.charge
    }

    fn sample(&mut self, at_ns: u64, fields: &mut [Field], body: &Coupling) {
        let place_m = body.pose().to_world(self.reading.at_m);
        let field = fields.iter_mut().find(|field| field.name == self.reading.name);
        let time_s = at_ns as f64 * 1e-9;
        let value = field.map_or(0.0, |field| field.value(time_s, place_m));
        if at_ns > 0 {
            let charge = self.reading.charge;
            let kept = libm::exp(-(PERIOD_NS as f64) * 1e-9 / charge.leak_s);
            let settled = charge.rest + charge.per_rad * body.turning() * charge.leak_s;
            self.charge = settled + (self.charge - settled) * kept;
        }
        self.lag.follow(time_s, value + self.charge);
    }
}

impl World {
    /// Takes the sample that is due now, if there is one.
    pub(super) fn sense_fields(&mut self) {
        let Some(at_ns) = self.next_field_ns.filter(|at_ns| *at_ns <= self.now_ns) else { return };
        self.next_field_ns = Some(at_ns + PERIOD_NS);
        let Some(body) = &self.body else { return };
        for source in self.pins.analogs.iter_mut().flatten() {
            if let Some(sensor) = &mut source.field {
                sensor.sample(at_ns, &mut self.fields, body);
            }
        }
    }

    /// Value of a named field at a place, m, now, in its unit; `None` if the world has no field of that name. For
    /// comparison with the truth: a query changes nothing.
    pub fn field(&mut self, name: &str, place_m: [f64; 2]) -> Option<f64> {
        self.catch_up();
        let time_s = self.now_ns as f64 * 1e-9;
        self.fields.iter_mut().find(|field| field.name == name).map(|field| field.value(time_s, place_m))
    }
}
