//! Output of an AS5600 whose OTP memory selects PWM: the angle as the length of a pulse. Page numbers are those of the
//! datasheet, v1-06 of 2018-06-20.
//!
//! ```text
//!  out  |~~~~~~~~~~~~~~~~~~~~~~~~~|_________________|~~~~~
//!        128 | as many as the angle      the rest | 128     of 4351 clock periods
//! ```
//!
//! # Where the datasheet leaves room
//! - A frame encodes the angle at its rise. The fast slow filter's noise of 0.043° rms (from memory) is included; its
//!   lag of 0.1 ms is not.
//! - The clock has a constant error, up to ±5 % (from memory).
//! - A frame in progress ends unchanged when the magnet is removed.

use std::{collections::VecDeque, f64::consts::TAU};

use rand_pcg::{Pcg64, rand_core::SeedableRng};

use super::{hc_sr04::EchoEdge, normal};

const NOISE_DEG: f64 = 0.043;
const FRAME: f64 = 4351.0;
const HEAD: f64 = 128.0;
/// Number of edges kept for a reader that is late; older ones are dropped.
const EDGES_KEPT: usize = 64;

/// PWM output of one sensor.
#[derive(Clone, Debug)]
pub struct As5600Pwm {
    frame_ns: f64,
    magnet: bool,
    felt_ns: u64,
    felt_rad: f64,
    /// Start of the next frame, not rounded, and end of the pulse of this one, ns.
    next_rise_ns: f64,
    fall_ns: Option<u64>,
    high: bool,
    edges: VecDeque<EchoEdge>,
    noise: Pcg64,
}

impl As5600Pwm {
    /// A sensor with `frames_hz` frames a second from time 0 on. `seed` is that of its noise.
    #[must_use]
    pub fn new(frames_hz: f64, seed: u64) -> Self {
        Self {
            frame_ns: 1e9 / frames_hz,
            magnet: true,
            felt_ns: 0,
            felt_rad: 0.0,
            next_rise_ns: 0.0,
            fall_ns: None,
            high: false,
            edges: VecDeque::new(),
            noise: Pcg64::seed_from_u64(seed),
        }
    }

    /// Puts a magnet in front of the sensor, or removes it: the output then stays low (page 31).
    pub const fn set_magnet(&mut self, magnet: bool) {
        self.magnet = magnet;
    }

    /// Advances to `until_ns`, with the angle moving linearly from the last call to `angle_rad`.
    pub fn feel(&mut self, until_ns: u64, angle_rad: f64) {
        let (from_ns, from_rad) = (self.felt_ns, self.felt_rad);
        if until_ns < from_ns {
            return;
        }
        while self.next_edge_ns() <= until_ns {
            let at_ns = self.next_edge_ns();
            if self.high {
                self.fall_ns = None;
                self.edge(at_ns, false);
                continue;
            }
            let whole_ns = (until_ns - from_ns) as f64;
            // the first angle has no predecessor to interpolate from
            let share = if whole_ns == 0.0 || from_ns == 0 { 1.0 } else { (at_ns - from_ns) as f64 / whole_ns };
            self.rise(at_ns, from_rad + (angle_rad - from_rad) * share);
        }
        (self.felt_ns, self.felt_rad) = (until_ns, angle_rad);
    }

    fn rise(&mut self, at_ns: u64, angle_rad: f64) {
        let shown = angle_rad + NOISE_DEG.to_radians() * normal(&mut self.noise);
        let counts = ((shown / TAU).rem_euclid(1.0) * 4096.0).floor().min(4095.0);
        if self.magnet {
            self.fall_ns = Some(at_ns + ((HEAD + counts) / FRAME * self.frame_ns) as u64);
            self.edge(at_ns, true);
        }
        self.next_rise_ns += self.frame_ns;
    }

    fn edge(&mut self, at_ns: u64, high: bool) {
        self.high = high;
        if self.edges.len() == EDGES_KEPT {
            self.edges.pop_front();
        }
        self.edges.push_back(EchoEdge { at_ns, high });
    }

    /// Level of the output at the last [`As5600Pwm::feel`].
    #[must_use]
    pub const fn is_high(&self) -> bool {
        self.high
    }

    /// Edges up to the last [`As5600Pwm::feel`] that were not taken before, oldest first. Of more than 64 the oldest
    /// are lost.
    pub fn take_edges(&mut self) -> impl Iterator<Item = EchoEdge> {
        self.edges.drain(..)
    }

    /// Earliest time of the next change of the output, ns.
    #[must_use]
    pub fn next_edge_ns(&self) -> u64 {
        self.fall_ns.unwrap_or(self.next_rise_ns as u64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn edges(sensor: &mut As5600Pwm, until_ns: u64, angle_rad: f64) -> Vec<(u64, bool)> {
        sensor.feel(until_ns, angle_rad);
        sensor.take_edges().map(|edge| (edge.at_ns, edge.high)).collect()
    }

    #[test]
    fn a_frame_is_its_head_and_as_many_clocks_as_counts() {
        for (turns, counts) in [(0.000_3, 0.0), (0.25, 1024.0), (0.999_9, 4095.0), (-1.5, 2048.0)] {
            let mut sensor = As5600Pwm::new(230.0, 1);
            sensor.feel(0, turns * TAU);
            sensor.take_edges().count();
            let edges = edges(&mut sensor, 10_000_000, turns * TAU);
            // the frame in progress ends first
            let first = edges.iter().position(|(_, high)| *high).unwrap_or(edges.len());
            let [(rise_ns, true), (fall_ns, false), ..] = edges[first..] else { panic!("{edges:?}") };
            assert_eq!(rise_ns, (1e9 / 230.0) as u64);
            let clocks = (fall_ns - rise_ns) as f64 / (1e9 / 230.0 / 4351.0);
            // five standard deviations of 0.49 counts
            let off = (clocks - 128.0 - counts + 2048.0).rem_euclid(4096.0) - 2048.0;
            assert!(off.abs() < 3.5, "{turns}: {clocks}");
        }
    }

    #[test]
    fn without_a_magnet_the_output_stays_low() {
        let mut sensor = As5600Pwm::new(115.0, 1);
        // a frame of 8.7 ms is in progress, high for 4.6 ms
        assert_eq!(edges(&mut sensor, 1_000_000, 3.2).len(), 1);
        sensor.set_magnet(false);
        assert_eq!(edges(&mut sensor, 100_000_000, 3.2).len(), 1);
        assert!(!sensor.is_high());
        sensor.set_magnet(true);
        assert!(edges(&mut sensor, 120_000_000, 3.2).len() >= 3);
    }
}
