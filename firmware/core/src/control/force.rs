//! Force control: a force loop around the position loop.
//!
//! An admittance. The reference of the position loop moves at a speed proportional to the force error, so that motion
//! integrates a steady error away, and a motor that meets nothing closes at a limited speed. The stiffness of the
//! contact times [`ForceConfig::speed_per_n`] is the loop's bandwidth; it must stay well below the position loop's.

use r4_protocol::config::ForceConfig;

use crate::{sensing::filter::LowPass, within::Within};

/// Time for which the force must be present until contact is reported, s: five periods of 1 ms, so that a spike is no
/// contact.
const CONTACT_S: f32 = 0.005;
/// Share of the contact force below which contact is lost.
const LOST_SHARE: f32 = 0.5;
/// Maximum lead of the reference over the motor, as travel time at the approach speed, s: a motor that is blocked short
/// of contact must not wind up, and a position loop lags its reference by less.
const LEAD_S: f32 = 0.1;
/// Time without readings after which the force counts as unknown, s: five readings of a sensor of 250 Hz.
const LOST_S: f32 = 0.02;

/// Measured force of a motor, with contact detection.
pub(super) struct Force {
    config: ForceConfig,
    filter: LowPass,
    period_s: f32,
    /// Drift of the sensor's reading without force, N, relative to its configured zero.
    zero_n: f32,
    /// Low-pass filtered reading of the sensor, N, drift included.
    reading_n: f32,
    has_read: bool,
    missing_s: f32,
    pressed_s: f32,
    in_contact: bool,
}

/// State of the force loop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Press {
    /// Reference of the position loop, rad or m.
    pub(super) position: f64,
    /// Speed of the reference, rad/s or m/s.
    pub(super) speed: f32,
    /// Time for which the force has been within its band, s.
    pub(super) at_force_s: f32,
}

impl Force {
    pub(super) fn new(config: ForceConfig, period_s: f32) -> Self {
        Self {
            filter: LowPass::new(config.filter_s, period_s),
            config,
            period_s,
            zero_n: 0.0,
            reading_n: 0.0,
            has_read: false,
            missing_s: 0.0,
            pressed_s: 0.0,
            in_contact: false,
        }
    }

    /// Takes the sensor's reading of this period, N; `None` without one.
    pub(super) fn measure(&mut self, newtons: Option<f32>) {
        let Some(newtons) = newtons else {
            self.missing_s += self.period_s;
            return;
        };
        self.missing_s = 0.0;
        if !self.has_read {
            self.has_read = true;
            self.filter.reset(newtons);
        }
        self.reading_n = self.filter.step(newtons);
        let pressed = self.force_n().abs();
        self.pressed_s = if pressed >= self.config.contact_n { self.pressed_s + self.period_s } else { 0.0 };
        self.in_contact =
            self.pressed_s >= CONTACT_S || self.in_contact && pressed >= LOST_SHARE * self.config.contact_n;
        if !self.in_contact && self.pressed_s == 0.0 && self.config.drift_s > 0.0 {
            self.zero_n += (self.reading_n - self.zero_n) * (self.period_s / self.config.drift_s).min(1.0);
        }
    }

    /// Force with the drift removed, N.
    pub(super) fn force_n(&self) -> f32 {
        self.reading_n - self.zero_n
    }

    /// Returns true if the force has been unknown for too long to control it.
    pub(super) fn is_lost(&self) -> bool {
        !self.has_read || self.missing_s > LOST_S
    }

    /// Returns true if the force is beyond the limit at which the board trips, with or without the drift removed.
    pub(super) fn is_beyond_limit(&self) -> bool {
        self.has_read && !(self.reading_n.abs() <= self.config.limit_n && self.force_n().abs() <= self.config.limit_n)
    }

    pub(super) fn in_contact(&self) -> bool {
        self.in_contact
    }

    /// Returns the reference one period later, for a motor at `position` that is to press with `wanted_n`, N; the
    /// reference's speed changes by at most `acceleration`, rad/s² or m/s².
    pub(super) fn step(&self, last: Press, wanted_n: f32, position: f64, acceleration: f32) -> Press {
        let error_n = wanted_n - self.force_n();
        let is_there = error_n.abs() <= self.config.error_n;
        let most = self.config.approach_speed;
        // Within the band the reference rests: creeping on would wear the motor and never end.
        let wanted = if is_there { 0.0 } else { (self.config.speed_per_n * error_n).within(-most, most) };
        let step = acceleration * self.period_s;
        let speed = wanted.within(last.speed - step, last.speed + step);
        let lead = f64::from(most * LEAD_S);
        let next = last.position + f64::from(speed) * f64::from(self.period_s);
        Press {
            position: next.within(position - lead, position + lead),
            speed,
            at_force_s: if is_there { last.at_force_s + self.period_s } else { 0.0 },
        }
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use std::vec::Vec;

    use r4_protocol::{channel::Range, config::ForceSensor};

    use super::*;

    const PERIOD_S: f32 = 1e-3;

    /// Controller with 0.01 (rad/s)/N, contact at 1 N, 10 N at most.
    fn config() -> ForceConfig {
        ForceConfig {
            sensor: ForceSensor::Analog { analog: 0, zero_v: 0.0, newtons_per_v: 1.0 },
            range: Range::new(0.0, 8.0),
            limit_n: 10.0,
            speed_per_n: 0.01,
            approach_speed: 0.05,
            contact_n: 1.0,
            error_n: 0.05,
            filter_s: 0.0,
            drift_s: 2.0,
        }
    }

    fn press(position: f64) -> Press {
        Press { position, speed: 0.0, at_force_s: 0.0 }
    }

    /// A spring of 2000 N/rad, compressed by a perfect position loop, gives a first-order response with the bandwidth
    /// 0.01 · 2000 = 20/s.
    #[test]
    fn a_spring_is_pressed_with_the_loops_bandwidth() {
        let mut force = Force::new(config(), PERIOD_S);
        let mut now = press(0.0);
        let mut reached = Vec::new();
        for _ in 0..600 {
            force.measure(Some(2000.0 * now.position.max(0.0) as f32));
            now = force.step(now, 5.0, now.position, f32::INFINITY);
            reached.push(force.force_n());
        }
        // The speed limit, 100 N/s, holds in the first milliseconds; then the error falls to 1/e in 50 periods, less
        // one period of delay.
        let first = reached.iter().position(|n| *n > 2.0).expect("pressed");
        let [before, after] = [first, first + 50].map(|place| 5.0 - reached[place]);
        assert!((after / before / (-1.0f32).exp() - 1.0).abs() < 0.05, "{before} {after}");
        let last = reached[599];
        assert!((last - 5.0).abs() <= 0.05 && now.speed == 0.0 && now.at_force_s > 0.1, "{last} {now:?}");
    }

    #[test]
    fn without_contact_it_closes_at_its_speed_and_does_not_wind_up() {
        let mut force = Force::new(config(), PERIOD_S);
        let (mut now, mut free) = (press(0.0), press(0.0));
        for _ in 0..1000 {
            force.measure(Some(0.0));
            free = force.step(free, 6.0, free.position, 0.5);
            // A motor that does not move: blocked, or its supply is off.
            now = force.step(now, 6.0, 0.0, 0.5);
        }
        assert_eq!(free.speed, 0.05);
        // The ramp to that speed takes 0.1 s, and 0.9 s of it remain.
        assert!((free.position - 0.0475).abs() < 1e-4, "{free:?}");
        assert!((now.position - 0.005).abs() < 1e-6, "a tenth of a second ahead: {now:?}");
    }

    #[test]
    fn contact_needs_its_time_and_its_force() {
        let mut force = Force::new(config(), PERIOD_S);
        let mut run = |newtons: f32, periods: usize| {
            (0..periods).for_each(|_| force.measure(Some(newtons)));
            force.in_contact()
        };
        assert!(!run(0.0, 100));
        assert!(!run(5.0, 4), "a spike");
        assert!(!run(0.0, 10));
        assert!(run(1.2, 6));
        assert!(run(0.6, 1000), "held above half of it");
        assert!(!run(0.4, 1));
        assert!(run(-1.2, 6), "either way");
    }

    /// A drift of 0.2 N/min is followed with the time constant of 2 s, 7 mN behind. A pressing load is not taken for
    /// drift.
    #[test]
    fn zero_follows_drift_and_not_a_load() {
        let mut force = Force::new(config(), PERIOD_S);
        let drift = |period: u32| 0.2 / 60.0 * period as f32 * PERIOD_S;
        for period in 0..60_000 {
            force.measure(Some(drift(period)));
        }
        assert!((force.force_n() - 2.0 * 0.2 / 60.0).abs() < 1e-3, "{}", force.force_n());
        for period in 60_000..120_000 {
            force.measure(Some(drift(period) + 5.0));
        }
        // Meanwhile the sensor keeps drifting, which cannot be seen.
        assert!((force.force_n() - 5.2).abs() < 0.02, "{}", force.force_n());
        // Without compensation the whole drift is an error.
        let mut plain = Force::new(ForceConfig { drift_s: 0.0, ..config() }, PERIOD_S);
        (0..60_000).for_each(|period| plain.measure(Some(drift(period))));
        assert!((plain.force_n() - 0.2).abs() < 1e-3, "{}", plain.force_n());
    }

    #[test]
    fn a_sensor_that_is_silent_or_beyond_its_limit_is_seen() {
        let mut force = Force::new(config(), PERIOD_S);
        assert!(force.is_lost() && !force.is_beyond_limit(), "nothing read yet");
        force.measure(Some(3.0));
        assert!(!force.is_lost());
        (0..19).for_each(|_| force.measure(None));
        assert!(!force.is_lost());
        (0..3).for_each(|_| force.measure(None));
        assert!(force.is_lost());
        for (newtons, beyond) in [(10.0, false), (10.1, true), (-10.1, true), (f32::NAN, true)] {
            let mut force = Force::new(config(), PERIOD_S);
            force.measure(Some(newtons));
            assert_eq!(force.is_beyond_limit(), beyond, "{newtons}");
        }
    }

    /// Drift compensation does not raise the limit.
    #[test]
    fn the_limit_is_the_sensors_own() {
        let mut force = Force::new(ForceConfig { contact_n: 9.0, ..config() }, PERIOD_S);
        (0..60_000).for_each(|_| force.measure(Some(8.0)));
        assert!(force.force_n().abs() < 0.1 && !force.is_beyond_limit());
        force.measure(Some(10.5));
        assert!(force.is_beyond_limit());
    }
}
