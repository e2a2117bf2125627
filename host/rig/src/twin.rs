//! Digital twins: comparison of a recorded run with the same run on a simulated board.

use std::path::PathBuf;

use r4_log::{Log, MotorSample, MotorSeries};
use r4_maths::statistics::RootMeanSquare;
use r4_protocol::{ChannelId, SafetyState};
use serde::Serialize;

use crate::{Error, PlantFile, Rig, replay};

/// Quantity of a recorded run that is compared.
#[derive(Clone, Debug, PartialEq)]
pub enum Observed {
    /// Position and speed of a motor.
    Motor(ChannelId),
    /// A numeric signal by its name, as in `imu0.rate_z_rad_s`.
    Signal(String),
}

/// Physics that replace those of a virtual board's robot file.
#[derive(Clone, Debug, PartialEq)]
pub enum Physics {
    /// The plant of one motor, in place of the one in the robot's file.
    Plant(PlantFile),
    /// File with the robot's body.
    Body(PathBuf),
}

/// Error of a recording that cannot be compared with a simulated board.
#[derive(Debug, thiserror::Error)]
pub enum TwinError {
    /// The recording has no samples of the motor.
    #[error("the log has no samples of a motor {channel}: it has {}", listed(motors))]
    NotRecorded {
        /// Channel of the motor.
        channel: ChannelId,
        /// Motors that are in the log.
        motors: Vec<ChannelId>,
    },
    /// The recording has no numeric signal of this name.
    #[error("the log has no signal {name} of numbers: it has {}", .signals.join(", "))]
    NoSignal {
        /// Name that the caller requested.
        name: String,
        /// Names of the recorded signals.
        signals: Vec<String>,
    },
    /// The replay has no samples of the quantity.
    #[error("the simulated board sent no samples of {observed}")]
    NotSimulated {
        /// Name of the motor or signal.
        observed: String,
    },
    /// The two runs do not overlap in time.
    #[error("the simulated board sent no samples at the times of the recording")]
    NothingInCommon,
}

fn listed(motors: &[ChannelId]) -> String {
    let names: Vec<_> = motors.iter().map(ToString::to_string).collect();
    if names.is_empty() { "none".to_owned() } else { names.join(", ") }
}

/// Errors of one quantity on a simulated board with two sets of physics.
#[derive(Clone, Debug, Serialize)]
pub struct Difference {
    /// `position`, `speed`, or the signal's name.
    pub name: String,
    /// Unit of the errors; `None` for a signal, whose name ends with it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unit: Option<&'static str>,
    /// Root mean square error with the physics before; an angle is relative to the start of each run.
    pub rmse_before: f64,
    /// Root mean square error with the physics after.
    pub rmse_after: f64,
}

/// Differences between a recording and a simulated board with two sets of physics.
#[derive(Clone, Debug, Serialize)]
pub struct Twins {
    /// Difference of each quantity; the first decides which physics are nearer.
    pub differences: Vec<Difference>,
    /// Causes of the simulated board's trip with the physics before; `None` without a trip, or when the recorded board
    /// tripped too.
    pub stopped_before: Option<String>,
    /// Causes of the simulated board's trip with the physics after, in the same way.
    pub stopped_after: Option<String>,
    /// Number of recorded samples.
    pub samples: usize,
}

impl Twins {
    /// Returns true when the simulated board is at least as near to the recording as before.
    #[must_use]
    pub fn is_as_near(&self) -> bool {
        self.differences.first().is_some_and(|first| first.rmse_after <= first.rmse_before)
    }
}

/// Replays `log` on the virtual board of `rig` with two sets of physics, and compares each run with the recording.
/// `None` stands for the physics of `rig`.
///
/// # Errors
/// [`Error::Twin`] when the quantity is not in the log or the replay; the error of a log that cannot be replayed.
pub fn compare(
    rig: &Rig,
    log: &Log,
    observed: &Observed,
    (before, after): (Option<Physics>, Physics),
) -> Result<Twins, Error> {
    rig.target.robot()?;
    let recorded = tracks(log, observed)?;
    let (before, stopped_before) = errors(rig, log, (observed, &recorded), before)?;
    let (after, stopped_after) = errors(rig, log, (observed, &recorded), Some(after))?;
    let samples = recorded.iter().map(|track| track.samples.len()).max().unwrap_or(0);
    let errors = before.into_iter().zip(after);
    let differences = recorded.into_iter().zip(errors).map(|(Track { name, unit, .. }, (rmse_before, rmse_after))| {
        Difference { name, unit, rmse_before, rmse_after }
    });
    Ok(Twins { differences: differences.collect(), stopped_before, stopped_after, samples })
}

/// One quantity over time.
struct Track {
    name: String,
    unit: Option<&'static str>,
    /// Samples: time, s, and value.
    samples: Vec<(f64, f64)>,
}

impl Track {
    fn of_motor(motor: &MotorSeries, name: &str, unit: &'static str, value: fn(&MotorSample) -> f64) -> Self {
        let samples = motor.samples.iter().map(|sample| (sample.time_s, value(sample))).collect();
        Self { name: name.to_owned(), unit: Some(unit), samples }
    }

    /// Returns the track relative to its first sample.
    fn relative_to_start(mut self) -> Self {
        let start = self.samples.first().map_or(0.0, |(_, value)| *value);
        self.samples.iter_mut().for_each(|(_, value)| *value -= start);
        self
    }
}

/// Extracts the tracks of a quantity from `log`.
fn tracks(log: &Log, observed: &Observed) -> Result<Vec<Track>, TwinError> {
    match observed {
        &Observed::Motor(channel) => {
            let motors = || log.motors.iter().map(|motor| motor.info.id).collect();
            let motor = log.motor(channel).ok_or_else(|| TwinError::NotRecorded { channel, motors: motors() })?;
            let of = |name, unit, value| Track::of_motor(motor, name, unit, value);
            let position = |unit| of("position", unit, |sample| sample.position);
            let speed = |unit| of("speed", unit, |sample| sample.speed);
            Ok(if motor.is_linear() {
                // The zero of a rod is calibrated, so that positions compare absolutely.
                vec![position("m"), speed("m/s")]
            } else {
                // The zero of an angle is the position at power-on, which differs between the machine and a simulation.
                vec![position("rad").relative_to_start(), speed("rad/s")]
            })
        }
        Observed::Signal(name) => {
            let signals = log.signals();
            let named = signals.iter().find(|signal| signal.name == *name);
            let numbers = named.into_iter().flat_map(|signal| &signal.samples);
            let samples: Vec<_> = numbers.filter_map(|(time_s, value)| Some((*time_s, value.number()?))).collect();
            if samples.is_empty() {
                let signals = signals.into_iter().map(|signal| signal.name).collect();
                return Err(TwinError::NoSignal { name: name.clone(), signals });
            }
            Ok(vec![Track { name: name.clone(), unit: None, samples }])
        }
    }
}

/// Errors of each track of a virtual board that replays `log` with other physics, and causes of a trip that the log
/// does not have.
fn errors(
    rig: &Rig,
    log: &Log,
    (observed, recorded): (&Observed, &[Track]),
    physics: Option<Physics>,
) -> Result<(Vec<f64>, Option<String>), Error> {
    let mut rig = rig.clone();
    match physics {
        Some(Physics::Plant(plant)) => {
            rig.plants.retain(|other| other.channel != plant.channel);
            rig.plants.push(plant);
        }
        Some(Physics::Body(file)) => rig.body = Some(file),
        None => {}
    }
    let (again, shift_s) = replay::again(&rig, log)?;
    let simulated = tracks(&again, observed).map_err(|_| {
        let observed = match observed {
            Observed::Motor(channel) => channel.to_string(),
            Observed::Signal(name) => name.clone(),
        };
        TwinError::NotSimulated { observed }
    })?;
    let stopped = |log: &Log| log.states.iter().find(|state| state.state == SafetyState::Tripped).map(|it| it.causes);
    let stopped = stopped(&again).filter(|_| stopped(log).is_none()).map(|causes| causes.to_string());
    let errors = recorded.iter().zip(&simulated).map(|(recorded, simulated)| rmse(recorded, simulated, shift_s));
    let errors: Option<Vec<f64>> = errors.collect();
    Ok((errors.ok_or(TwinError::NothingInCommon)?, stopped))
}

/// Root mean square of the difference between two runs, at the times of the first. The second is linearly interpolated,
/// with its times shifted by `shift_s`. `None` without a common time.
fn rmse(recorded: &Track, simulated: &Track, shift_s: f64) -> Option<f64> {
    let mut differences = RootMeanSquare::default();
    for &(time_s, value) in &recorded.samples {
        let at_s = time_s - shift_s;
        let after = simulated.samples.partition_point(|(time_s, _)| *time_s < at_s);
        let (Some(&(right_s, right)), left) = (simulated.samples.get(after), after.saturating_sub(1)) else { continue };
        let (left_s, left) = simulated.samples[left];
        let step_s = right_s - left_s;
        // Before the first sample of the second run there is nothing to compare.
        if at_s < left_s && at_s != right_s {
            continue;
        }
        let share = if step_s > 0.0 { (at_s - left_s) / step_s } else { 1.0 };
        let difference = value - (left + share * (right - left));
        if difference.is_finite() {
            differences.push(difference);
        }
    }
    differences.value()
}
