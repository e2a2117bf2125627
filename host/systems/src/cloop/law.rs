//! Estimators of the controller, without a board: the sensor's zero and drift, the contact, and slip.

/// Zero of the force sensor and its drift, by least squares on readings of a slack loop.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Zero {
    count: f64,
    /// Sums of time, reading, time squared and their product, relative to the first reading.
    sums: [f64; 4],
    origin: Option<(f64, f64)>,
}

impl Zero {
    /// Number of readings from which on a drift is estimated; below, the zero is their mean.
    const LINE_FROM: f64 = 30.0;

    /// Takes a reading of the slack loop: time, s, and force, N.
    pub fn add(&mut self, time_s: f64, force_n: f64) {
        let (begin_s, begin_n) = *self.origin.get_or_insert((time_s, force_n));
        let (t, f) = (time_s - begin_s, force_n - begin_n);
        self.count += 1.0;
        for (sum, value) in self.sums.iter_mut().zip([t, f, t * t, t * f]) {
            *sum += value;
        }
    }

    /// Reading of the sensor without force at a time, N; 0 before any reading.
    #[must_use]
    pub fn at(&self, time_s: f64) -> f64 {
        let Some((begin_s, begin_n)) = self.origin else { return 0.0 };
        let [t, f, tt, tf] = self.sums.map(|sum| sum / self.count);
        let spread = tt - t * t;
        let slope = if self.count >= Self::LINE_FROM && spread > 0.0 { (tf - t * f) / spread } else { 0.0 };
        begin_n + f + slope * (time_s - begin_s - t)
    }
}

/// Contact detector: force over the spool's angle while a loop is drawn tight. The straight line through the points
/// begins at the contact.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Contact {
    points: Vec<(f64, f64)>,
}

impl Contact {
    /// Takes a pair of spool angle, rad, and force, N.
    pub fn add(&mut self, angle_rad: f64, force_n: f64) {
        self.points.push((angle_rad, force_n));
    }

    /// Number of pairs taken so far.
    #[must_use]
    pub fn count(&self) -> usize {
        self.points.len()
    }

    /// Angle at which the line through the points has no force, rad; `None` for fewer than three points, or a line that
    /// does not rise.
    ///
    /// While the spool reels in, tension, stretch and capstan friction are all proportional to the force. The line is
    /// therefore straight whatever they are, and the contact does not depend on them.
    #[must_use]
    pub fn angle_rad(&self) -> Option<f64> {
        if self.points.len() < 3 {
            return None;
        }
        let count = self.points.len() as f64;
        let mean = |of: &dyn Fn(&(f64, f64)) -> f64| self.points.iter().map(of).sum::<f64>() / count;
        let (angle, force) = (mean(&|point| point.0), mean(&|point| point.1));
        let spread = mean(&|point| (point.0 - angle).powi(2));
        let slope = mean(&|point| (point.0 - angle) * (point.1 - force)) / spread;
        // Negative angles reel in: a rising force has a negative slope.
        (slope < 0.0).then(|| angle - force / slope)
    }
}

/// Slip detector: CUSUM of drops of the force below its own low-pass (Page, *Continuous inspection schemes*, Biometrika
/// 41, 1954).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SlipWatch {
    low_passed_n: Option<f64>,
    sum_n: f64,
}

impl SlipWatch {
    /// Time constant of the low-pass, s. This constant and the two below come from the forces of seeds 1 to 59, 66, 92,
    /// 200 and 280: a sum of 0.245 N where a vial slid 14 mm, at most 0.028 N in the others. With 0.08 s the others
    /// reach 0.32 N. Measured with a force loop on the host and 3.5 N; not repeated with the board's.
    const FILTER_S: f64 = 0.05;
    /// Drop that is not counted, N: five times the noise of the filtered force.
    const ALLOWED_N: f64 = 0.03;
    /// Sum that raises the alarm, N.
    const ALARM_N: f64 = 0.08;

    /// Takes a force, N, `after_s` after the last one, and returns true when the vial slides.
    pub fn next(&mut self, force_n: f64, after_s: f64) -> bool {
        let low_passed_n = self.low_passed_n.get_or_insert(force_n);
        self.sum_n = (self.sum_n + (*low_passed_n - force_n) - Self::ALLOWED_N).max(0.0);
        *low_passed_n += (force_n - *low_passed_n) * (after_s / Self::FILTER_S).min(1.0);
        let is_slip = self.sum_n > Self::ALARM_N;
        if is_slip {
            *self = Self::default();
        }
        is_slip
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_drifting_zero_is_a_line() {
        let mut zero = Zero::default();
        assert_eq!(zero.at(1.0), 0.0);
        for step in 0..100 {
            let time_s = 3.0 + 0.01 * f64::from(step);
            zero.add(time_s, 0.7 - 0.05 * time_s);
        }
        assert!((zero.at(8.0) - 0.3).abs() < 1e-9, "{}", zero.at(8.0));
    }

    /// A line through forces of a spring that begins at -1.2 rad, with friction that makes it appear softer.
    #[test]
    fn the_contact_is_where_the_force_begins_whatever_the_friction() {
        for share in [1.0, 0.8] {
            let mut contact = Contact::default();
            assert_eq!(contact.angle_rad(), None);
            for step in 1..10 {
                let angle_rad = -1.2 - 0.02 * f64::from(step);
                contact.add(angle_rad, share * 15.0 * (-1.2 - angle_rad));
            }
            let found_rad = contact.angle_rad().expect("a line");
            assert!((found_rad + 1.2).abs() < 1e-12, "{found_rad}");
        }
    }

    #[test]
    fn a_drop_is_slip_and_creep_is_not() {
        let mut watch = SlipWatch::default();
        for step in 0..300 {
            // Residual of the force loop for creep, 0.3 N/s at first, with the spread of noise.
            let force_n = 3.5 - 0.2 * (1.0 - (-0.015 * f64::from(step)).exp()) + 0.006 * f64::from(step % 3 - 1);
            assert!(!watch.next(force_n, 0.01), "step {step}");
        }
        let mut alarmed_after = None;
        for step in 1..5 {
            if watch.next(3.30 - 0.15, 0.01) && alarmed_after.is_none() {
                alarmed_after = Some(step);
            }
        }
        assert!(alarmed_after.is_some_and(|samples| samples <= 3), "{alarmed_after:?}");
    }
}
