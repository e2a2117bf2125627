//! Sensor with a first-order lag.

/// State of a sensor whose reading `y` obeys `T dy/dt = x - y`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lag {
    time_constant_s: f64,
    /// Time and input of the last sample; `None` before the first, at which the sensor has settled.
    last: Option<(f64, f64)>,
    reading: f64,
}

impl Lag {
    /// A lag of `time_constant_s`, s; 0 follows at once.
    #[must_use]
    pub const fn new(time_constant_s: f64) -> Self {
        Self { time_constant_s, last: None, reading: 0.0 }
    }

    /// Takes a sample of the input at a time, s, not before the last one. Exact for an input that is linear between
    /// samples.
    pub fn follow(&mut self, time_s: f64, input: f64) {
        let Some((before_s, before)) = self.last.replace((time_s, input)) else {
            self.reading = input;
            return;
        };
        let step = (time_s - before_s) / self.time_constant_s;
        // also for a time constant of 0, and for two samples at one time
        if !step.is_finite() {
            self.reading = input;
        } else if step > 0.0 {
            let kept = libm::exp(-step);
            // the reading lags a ramp of slope s per time constant by s
            let slope = (input - before) / step;
            self.reading = input - slope + (self.reading - before + slope) * kept;
        }
    }

    /// Reading in the unit of the input.
    #[must_use]
    pub const fn reading(&self) -> f64 {
        self.reading
    }
}
