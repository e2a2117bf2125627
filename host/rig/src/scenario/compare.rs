//! Differences between two outcomes of one scenario.

use std::fmt;

use serde::Serialize;

use super::{Motion, Outcome};

/// Value in which a simulated and an emulated board differ by more than the tolerance.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Difference {
    /// Time and channel, or the list that differs.
    pub of: String,
    /// Value on the simulated board.
    pub simulated: String,
    /// Value on the emulated board.
    pub emulated: String,
    /// Tolerance of the difference.
    pub allowed: String,
}

impl fmt::Display for Difference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { of, simulated, emulated, allowed } = self;
        write!(f, "{of}: simulated {simulated}, emulated {emulated}, allowed {allowed}")
    }
}

/// Result of a comparison.
pub struct Compared {
    /// Differences beyond the tolerance.
    pub list: Vec<Difference>,
    /// Largest difference of a position, as a share of its tolerance.
    pub worst_share: f64,
}

/// Compares the outcomes of one scenario on a simulated and an emulated board.
///
/// Positions may differ by one count of the sensor and by one control period of motion, since the two boards' loops do
/// not run at the same times. The motion is that at this checkpoint or the previous one, whichever is faster: an output
/// that stopped in between stopped up to a period earlier or later. States, trips and refusals must be the same.
#[must_use]
pub fn differences(simulated: &Outcome, emulated: &Outcome) -> Compared {
    let mut list = Vec::new();
    let mut worst_share = 0.0_f64;
    let mut differ = |of: String, simulated: String, emulated: String, allowed: String| {
        list.push(Difference { of, simulated, emulated, allowed });
    };
    let mut speeds = Vec::new();
    for (ours, theirs) in simulated.checkpoints.iter().zip(&emulated.checkpoints) {
        if ours.state != theirs.state {
            differ(format!("state at {} s", ours.at_s), ours.state.clone(), theirs.state.clone(), "the same".into());
        }
        for (index, (one, other)) in ours.motions.iter().zip(&theirs.motions).enumerate() {
            let speed = one.speed.abs().max(other.speed.abs());
            // Channels are the same, in the same order, at each checkpoint.
            speeds.resize(speeds.len().max(index + 1), 0.0);
            let fastest = speed.max(std::mem::replace(&mut speeds[index], speed));
            let allowed = one.resolution + fastest * one.period_s;
            let share = (one.position - other.position).abs() / allowed;
            worst_share = worst_share.max(share);
            if share > 1.0 || share.is_nan() {
                let shown = |motion: &Motion| format!("{:.6} {}", motion.position, motion.unit);
                let of = format!("{} at {} s", one.channel, ours.at_s);
                differ(of, shown(one), shown(other), format!("{allowed:.6} {}", one.unit));
            }
        }
    }
    let trips =
        |outcome: &Outcome| outcome.trips.iter().map(|causes| causes.join(" + ")).collect::<Vec<_>>().join(", ");
    let lists = |outcome: &Outcome| (trips(outcome), outcome.refused.join(", "));
    let ((trips, refused), (other_trips, other_refused)) = (lists(simulated), lists(emulated));
    if trips != other_trips {
        differ("trips".into(), trips, other_trips, "the same".into());
    }
    if refused != other_refused {
        differ("refusals".into(), refused, other_refused, "the same".into());
    }
    Compared { list, worst_share }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::Checkpoint;

    fn outcome(position: f64, speed: f64) -> Outcome {
        let motion =
            Motion { channel: "osmc0".into(), unit: "rad", position, speed, resolution: 0.001, period_s: 0.001 };
        let checkpoint = Checkpoint { at_s: 1.0, state: "armed".into(), motions: vec![motion] };
        Outcome { checkpoints: vec![checkpoint], trips: vec![vec!["stalled".into()]], refused: Vec::new() }
    }

    #[test]
    fn a_count_and_a_period_of_motion_are_allowed() {
        let same = differences(&outcome(1.0, 0.0), &outcome(1.0009, 0.0));
        assert!(same.list.is_empty());
        assert!((same.worst_share - 0.9).abs() < 1e-9);
        assert_eq!(differences(&outcome(1.0, 0.0), &outcome(1.0011, 0.0)).list.len(), 1);
        // 2 rad/s for 1 ms allow 2 mrad more.
        assert!(differences(&outcome(1.0, 2.0), &outcome(1.0029, 2.0)).list.is_empty());
        assert_eq!(differences(&outcome(1.0, 2.0), &outcome(1.0031, 2.0)).list.len(), 1);
        assert_eq!(differences(&outcome(1.0, 0.0), &outcome(f64::NAN, 0.0)).list.len(), 1);
    }

    #[test]
    fn trips_must_be_the_same_in_the_same_order() {
        let mut other = outcome(1.0, 0.0);
        other.trips = vec![vec!["dead-man".into()]];
        let found = differences(&outcome(1.0, 0.0), &other).list;
        assert_eq!(found.len(), 1);
        assert!(found[0].to_string().starts_with("trips: simulated"));
    }
}
