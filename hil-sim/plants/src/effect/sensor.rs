//! Effects between the position of the output and the reading of its sensor.

use super::{
    noise::{CORRELATION, Noise},
    periodic::PHASE,
};
use crate::parameter::{Parameter, fitted};

fitted! {
    /// The sensor reads a multiple of the position: the assumed counts per turn or volts per metre are wrong.
    pub struct EncoderScale {
        /// Ratio of the reading to the true position.
        pub scale: Parameter::new("scale", "1").within(0.1, 10.0).typical(1.01);
    }
}

fitted! {
    /// The sensor's zero is displaced.
    pub struct EncoderOffset {
        /// Offset added to the position, rad or m.
        pub offset: Parameter::new("offset_rad", "rad").linear("offset_m", "m").within(-1e3, 1e3).typical(0.01);
    }
}

fitted! {
    /// The sensor's disc is mounted eccentrically: an error once per turn, `amplitude · sin(position + phase)`.
    pub struct Eccentricity {
        /// Largest error, rad.
        pub amplitude_rad: Parameter::new("amplitude_rad", "rad").within(0.0, 1.0).typical(0.01);
        /// Phase at position 0, rad.
        pub phase_rad: PHASE;
    }
}

fitted! {
    /// Above a speed a share of the sensor's edges is lost permanently: `(|speed| - threshold) / reference`, at most
    /// all.
    ///
    /// The lost travel adds up with the sign of the motion, so the reading falls behind in both directions. The model
    /// gives the mean, not single edges.
    pub struct MissedEdges {
        /// Speed up to which no edge is lost, rad/s or m/s.
        pub threshold: Parameter::new("threshold_rad_s", "rad/s").linear("threshold_m_s", "m/s").within(0.0, 1e4).typical(1.0);
        /// Excess over the threshold at which all edges would be lost, rad/s or m/s.
        pub reference: Parameter::new("reference_rad_s", "rad/s").linear("reference_m_s", "m/s").within(1e-3, 1e6).typical(100.0);
    }
}

impl MissedEdges {
    /// Share of the edges lost at a speed, 0..=1.
    #[must_use]
    pub fn share(&self, speed: f64) -> f64 {
        ((speed.abs() - self.threshold) / self.reference).clamp(0.0, 1.0)
    }
}

fitted! {
    /// Within a band of positions the wiper has no contact and the last reading before the band stays.
    ///
    /// A plant that starts within the band reads its lower edge.
    pub struct PotentiometerDeadSpot {
        /// Lower edge of the band, rad or m.
        pub start: Parameter::new("start_rad", "rad").linear("start_m", "m").within(-1e3, 1e3).typical(0.05);
        /// Width of the band, rad or m.
        pub width: Parameter::new("width_rad", "rad").linear("width_m", "m").within(0.0, 1e3).typical(0.002);
    }
}

impl PotentiometerDeadSpot {
    /// True if the wiper has no contact at `position`.
    #[must_use]
    pub fn covers(&self, position: f64) -> bool {
        position > self.start && position < self.start + self.width
    }
}

fitted! {
    /// The sensor follows the position as a first-order low-pass.
    pub struct SensorLag {
        /// Time constant, s: the delay of the reading at constant speed.
        pub time_constant_s: Parameter::new("time_constant_s", "s").within(1e-6, 100.0).typical(0.01);
    }
}

fitted! {
    /// A random error: Gaussian, with an autocorrelation that falls to 1/e in the correlation time. Other steps over
    /// the same time give another realisation of the same statistics.
    pub struct SensorNoise {
        /// Standard deviation of the error, rad or m.
        pub deviation: Parameter::new("deviation_rad", "rad").linear("deviation_m", "m").within(0.0, 10.0).typical(1e-3);
        /// Correlation time of the error, s.
        pub correlation_s: CORRELATION;
    }
}

fitted! {
    /// The sensor counts in the opposite direction: its two lines are swapped.
    pub struct EncoderSign {}
}

fitted! {
    /// The position is sampled periodically and held in between (zero-order hold); the first sample is at the start.
    pub struct SensorHold {
        /// Sampling period, s.
        pub period_s: Parameter::new("period_s", "s").within(1e-4, 10.0).typical(0.025);
    }
}

/// A sensor effect with its memory.
#[derive(Clone, Debug)]
pub(crate) enum SensorStage {
    Scale(EncoderScale),
    Offset(EncoderOffset),
    Eccentricity(Eccentricity),
    MissedEdges { effect: MissedEdges, before: f64, lost: f64 },
    DeadSpot { effect: PotentiometerDeadSpot, held: f64 },
    Lag { effect: SensorLag, before: f64, reading: f64 },
    Noise(Noise),
    Sign,
    Hold { period_s: f64, left_s: f64, before: f64, held: f64 },
}

impl SensorStage {
    /// True if the reading depends on more than the present position, so that the stage must be applied in every step.
    pub(crate) fn has_memory(&self) -> bool {
        !matches!(self, Self::Scale(_) | Self::Offset(_) | Self::Eccentricity(_) | Self::Sign)
    }

    /// Resets the memory and returns the reading after a long rest at `position`.
    pub(crate) fn settle(&mut self, position: f64) -> f64 {
        match self {
            Self::MissedEdges { before, lost, .. } => {
                *before = position;
                *lost = 0.0;
                position
            }
            Self::DeadSpot { effect, held } => {
                *held = if effect.covers(position) { effect.start } else { position };
                *held
            }
            Self::Lag { before, reading, .. } => {
                *before = position;
                *reading = position;
                position
            }
            Self::Noise(noise) => position + noise.value(),
            Self::Hold { period_s, left_s, before, held } => {
                *left_s = *period_s;
                *before = position;
                *held = position;
                position
            }
            Self::Scale(_) | Self::Offset(_) | Self::Eccentricity(_) | Self::Sign => self.apply(position, 0.0),
        }
    }

    /// Reading at `position`, reached from the last one at constant speed in `step_s`.
    pub(crate) fn apply(&mut self, position: f64, step_s: f64) -> f64 {
        match self {
            Self::Scale(scale) => position * scale.scale,
            Self::Offset(offset) => position + offset.offset,
            Self::Eccentricity(eccentricity) => {
                position + eccentricity.amplitude_rad * libm::sin(position + eccentricity.phase_rad)
            }
            Self::MissedEdges { effect, before, lost } => {
                let way = position - *before;
                *before = position;
                *lost += effect.share(way / step_s) * way;
                position - *lost
            }
            Self::DeadSpot { effect, held } => {
                if !effect.covers(position) {
                    *held = position;
                }
                *held
            }
            Self::Lag { effect, before, reading } => {
                // exact for a ramp: the reading lags by `tau · speed`, and its difference from that decays
                // exponentially
                let late = effect.time_constant_s * (position - *before) / step_s;
                let decay = libm::exp(-step_s / effect.time_constant_s);
                *reading = position - late + (*reading - *before + late) * decay;
                *before = position;
                *reading
            }
            Self::Noise(noise) => position + noise.next(step_s),
            Self::Sign => -position,
            Self::Hold { period_s, left_s, before, held } => {
                let late_s = step_s - *left_s;
                *left_s -= step_s;
                // a sample at the edge of a step belongs to it, despite the rounding of many steps
                if late_s >= -1e-9 * *period_s {
                    let late_s = late_s % *period_s;
                    *held = position - (position - *before) * (late_s / step_s).clamp(0.0, 1.0);
                    *left_s = *period_s - late_s;
                }
                *before = position;
                *held
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Effect;

    fn stage(effect: Effect) -> SensorStage {
        SensorStage::new(&effect, 0, 0).unwrap()
    }

    #[test]
    fn missed_edges_fall_behind_in_both_directions_and_do_not_come_back() {
        let mut sensor = stage(Effect::MissedEdges(MissedEdges { threshold: 2.0, reference: 16.0 }));
        sensor.settle(0.0);
        assert_eq!(sensor.apply(1.0, 0.5), 1.0); // 2 rad/s: at the threshold, none lost
        assert_eq!(sensor.apply(4.0, 0.5), 3.25); // 6 rad/s: a quarter of 3 rad
        assert_eq!(sensor.apply(1.0, 0.5), 1.0); // back at the same speed: a quarter of -3 rad makes it up again
        assert_eq!(sensor.apply(4.0, 3.0), 4.0); // slowly: none lost
        assert_eq!(sensor.apply(1.0, 0.5), 1.75); // fast backwards only: left on the positive side
    }

    #[test]
    fn a_dead_spot_holds_the_last_reading() {
        let mut sensor = stage(Effect::PotentiometerDeadSpot(PotentiometerDeadSpot { start: 0.5, width: 0.25 }));
        assert_eq!(sensor.settle(0.625), 0.5);
        assert_eq!(sensor.settle(0.0), 0.0);
        assert_eq!([0.375, 0.625, 0.7, 0.875].map(|at| sensor.apply(at, 1e-3)), [0.375, 0.375, 0.375, 0.875]);
        assert_eq!([0.625, 0.25].map(|at| sensor.apply(at, 1e-3)), [0.875, 0.25]);
    }

    #[test]
    fn a_lag_is_exact_on_a_ramp_whatever_the_steps() {
        // reading of x = v t from rest: v (t - tau (1 - exp(-t / tau)))
        let expected = 3.0 * (0.5 - 0.2 * (1.0 - (-2.5f64).exp()));
        for steps in [1, 10, 137] {
            let mut sensor = stage(Effect::SensorLag(SensorLag { time_constant_s: 0.2 }));
            sensor.settle(0.0);
            let step_s = 0.5 / f64::from(steps);
            let mut reading = 0.0;
            for step in 1..=steps {
                reading = sensor.apply(3.0 * step_s * f64::from(step), step_s);
            }
            // rounding: 1e-16 of the position, divided by the step over the time constant, per step
            assert!((reading - expected).abs() < 1e-12, "{steps}: {reading} against {expected}");
        }
    }

    #[test]
    fn a_hold_tells_what_a_ramp_was_at_its_readings() {
        // read at 0.3, 0.6, 0.9 s, whether a step ends there or goes over them
        for (step_s, steps) in [(0.3, 3), (0.1, 9), (0.25, 4), (1.0, 1)] {
            let mut sensor = stage(Effect::SensorHold(SensorHold { period_s: 0.3 }));
            assert_eq!(sensor.settle(0.0), 0.0);
            let told = (1..=steps).map(|step| sensor.apply(2.0 * step_s * f64::from(step), step_s)).last().unwrap();
            assert!((told - 1.8).abs() < 1e-12, "{step_s}: {told}"); // roundings of times
        }
        let mut sensor = stage(Effect::SensorHold(SensorHold { period_s: 0.3 }));
        assert_eq!([sensor.apply(1.0, 0.1), sensor.apply(2.0, 0.1)], [0.0, 0.0]);
        assert_eq!(stage(Effect::EncoderSign(EncoderSign {})).apply(2.0, 1e-3), -2.0);
    }

    #[test]
    fn scale_offset_and_eccentricity_follow_their_formula() {
        assert_eq!(stage(Effect::EncoderScale(EncoderScale { scale: 1.25 })).apply(2.0, 1e-3), 2.5);
        assert_eq!(stage(Effect::EncoderOffset(EncoderOffset { offset: -0.5 })).apply(2.0, 1e-3), 1.5);
        let wobble = Effect::Eccentricity(Eccentricity { amplitude_rad: 0.25, phase_rad: 0.0 });
        let quarter = std::f64::consts::FRAC_PI_2;
        assert_eq!(stage(wobble).apply(quarter, 1e-3), quarter + 0.25);
    }
}
