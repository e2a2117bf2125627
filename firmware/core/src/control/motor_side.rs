//! Motor side of a backlash: a second encoder, the backlash that it shows, and detection of the motor crossing it.

use r4_protocol::config::{Feedback, MotorSideConfig};

use crate::{channel::resolution, sensing::encoder::Encoder};

/// Encoder on the motor's side of the backlash, beside the sensor at the output.
///
/// Both sides are in rad at the output. Their position within the backlash at the start is unknown; the range of their
/// difference since then is the backlash seen so far plus the twist of the gear.
#[derive(Clone, Debug)]
pub(super) struct MotorSide {
    encoder: Encoder,
    /// Size of a count, and displacement that counts as motion of the output, rad.
    resolution: f32,
    output_step: f32,
    gap_max: f32,
    /// Initial difference of the motor's side minus the output's, rad; `None` before.
    origin: Option<f64>,
    /// Furthest that the motor's side has been behind and ahead since, rad.
    behind: f32,
    ahead: f32,
    /// Position of the output's last motion, and lead of the motor's side at that moment, rad.
    output: f64,
    ahead_then: f32,
    crosses: bool,
    speed: f32,
    still: f32,
}

/// Error: the two sensors are further apart than the backlash allows. One has come off its shaft, or counts wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Apart;

/// Counts by which an encoder at the output must move to count as moving: a shaft may stand between two.
const ENCODER_STEP: f32 = 1.5;
/// Counts by which an angle sensor must move to count as moving: its noise, 0.5 counts rms with the fastest filter,
/// seldom exceeds that.
const ANGLE_STEP: f32 = 3.0;

impl MotorSide {
    /// Creates the motor side of an output that `feedback` measures. A motor slower than `still`, rad/s, does not count
    /// as crossing.
    pub(super) fn new(config: MotorSideConfig, feedback: Feedback, still: f32, period_s: f32, filter_s: f32) -> Self {
        let MotorSideConfig { index: _, counts_per_turn, inverted, gap_max } = config;
        let steps =
            if let Feedback::Angle { .. } | Feedback::Pulses { .. } = feedback { ANGLE_STEP } else { ENCODER_STEP };
        Self {
            encoder: Encoder::new(inverted, period_s, filter_s),
            resolution: core::f32::consts::TAU / counts_per_turn as f32,
            output_step: steps * resolution(feedback),
            gap_max,
            origin: None,
            behind: 0.0,
            ahead: 0.0,
            output: 0.0,
            ahead_then: 0.0,
            crosses: false,
            speed: 0.0,
            still,
        }
    }

    /// Takes the encoder's counter and the position of the output, rad, or `None` while that is unknown.
    ///
    /// # Errors
    /// [`Apart`], once; the range of the backlash seen so far is then discarded.
    pub(super) fn update(&mut self, raw: u16, output: Option<f64>) -> Result<(), Apart> {
        let (counts, counts_per_s) = self.encoder.update(raw);
        self.speed = counts_per_s * self.resolution;
        let Some(output) = output else {
            self.crosses = false;
            return Ok(());
        };
        let motor = f64::from(counts) * f64::from(self.resolution);
        let Some(origin) = self.origin else {
            self.begin(motor - output, output);
            return Ok(());
        };
        let ahead = (motor - output - origin) as f32;
        (self.behind, self.ahead) = (self.behind.min(ahead), self.ahead.max(ahead));
        if self.ahead - self.behind > self.gap_max {
            self.begin(motor - output, output);
            return Err(Apart);
        }
        let output_moved = (output - self.output) as f32;
        if output_moved.abs() >= self.output_step {
            (self.output, self.ahead_then) = (output, ahead);
        }
        // The motor's own displacement since then: as much as would have moved the output without backlash.
        let moved = output_moved + ahead - self.ahead_then;
        self.crosses = moved.abs() > self.output_step + self.resolution && self.speed.abs() > self.still;
        self.crosses &= output_moved.abs() < self.output_step;
        Ok(())
    }

    fn begin(&mut self, origin: f64, output: f64) {
        self.origin = Some(origin);
        (self.behind, self.ahead, self.ahead_then) = (0.0, 0.0, 0.0);
        (self.output, self.crosses) = (output, false);
    }

    /// Shifts the output's position by `rad`, after its zero was found.
    pub(super) fn shift(&mut self, rad: f64) {
        self.origin = self.origin.map(|origin| origin - rad);
        self.output += rad;
    }

    /// Encoder on the motor's side.
    pub(super) const fn encoder(&self) -> &Encoder {
        &self.encoder
    }

    /// Size of one of its counts, rad at the output.
    pub(super) const fn resolution(&self) -> f32 {
        self.resolution
    }

    /// Speed of the motor's side, rad/s at the output.
    pub(super) const fn speed(&self) -> f32 {
        self.speed
    }

    /// Returns true while the motor moves and the output does not: it is crossing the backlash.
    pub(super) const fn crosses(&self) -> bool {
        self.crosses
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STEP: f32 = core::f32::consts::TAU / 1024.0;

    /// Sensors with 1024 counts per turn at the output and 4096 on the motor's side, read each 1/1024 s.
    fn side() -> MotorSide {
        let config = MotorSideConfig { index: 1, counts_per_turn: 4096, inverted: false, gap_max: 20.0 * STEP };
        let feedback = Feedback::Encoder { index: 0, counts_per_turn: 1024, inverted: false, counts_per_index: 0 };
        MotorSide::new(config, feedback, 0.01, 1.0 / 1024.0, 0.0)
    }

    /// Position of the output after `counts` of its counts, rad.
    fn output(counts: i32) -> Option<f64> {
        Some(f64::from(counts) * f64::from(STEP))
    }

    #[test]
    fn a_motor_crosses_play_while_it_moves_alone() {
        let mut side = side();
        side.update(0, output(0)).expect("the first");
        // Both move: no backlash.
        for count in 1..=40 {
            side.update(4 * count, output(count.into())).expect("together");
            assert!(!side.crosses(), "{count}");
        }
        // A displacement of 1.5 output counts is 6 of the motor's side, plus one: at 7 rounding decides.
        for moved in 1..=30 {
            side.update(160 - moved, output(40)).expect("within the play");
            assert!(moved == 7 || side.crosses() == (moved > 7), "{moved}");
        }
        // The output follows again.
        side.update(128, output(39)).expect("within the play");
        assert!(side.crosses(), "a count may be that of a shaft at its edge");
        side.update(124, output(38)).expect("within the play");
        assert!(!side.crosses());
    }

    #[test]
    fn a_motor_that_stands_within_the_play_crosses_nothing() {
        let mut side = side();
        side.update(0, output(0)).expect("the first");
        (1..=30).for_each(|moved| side.update(moved, output(0)).expect("within the play"));
        assert!(side.crosses());
        // Half a second without a count is a standstill.
        (0..600).for_each(|_| side.update(30, output(0)).expect("within the play"));
        assert!(!side.crosses());
    }

    /// From the furthest behind to the furthest ahead, 80 counts of the motor's side are `gap_max`.
    #[test]
    fn sensors_further_apart_than_the_play_are_told_once() {
        for way in [1, -1] {
            let mut side = side();
            side.update(0, output(0)).expect("the first");
            for moved in 0..=30 {
                side.update((-way * moved) as u16, output(0)).expect("within the play");
            }
            let apart = (-30..100).find(|moved| side.update((way * moved) as u16, output(0)).is_err());
            assert_eq!(apart, Some(51));
            side.update((way * 51) as u16, output(0)).expect("forgotten");
        }
    }

    /// A new zero of the output, and a sensor lost for a while, are no backlash.
    #[test]
    fn a_new_zero_is_no_play_and_neither_is_a_sensor_that_is_lost() {
        let mut side = side();
        side.update(0, output(0)).expect("the first");
        side.shift(output(500).expect("a place"));
        side.update(0, output(500)).expect("nothing has moved");
        assert!(!side.crosses());
        for moved in 0..200 {
            side.update(4 * moved, None).expect("nothing to compare with");
            assert!(!side.crosses());
        }
        side.update(796, output(699)).expect("both have moved alike");
    }
}
