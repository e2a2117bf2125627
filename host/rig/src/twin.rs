//! Digital twins: the difference between a recorded run and the same run on a simulated board.

use r4_log::{Log, MotorSample, MotorSeries};
use r4_maths::statistics::RootMeanSquare;
use r4_protocol::{ChannelId, SafetyState};
use serde::Serialize;

use crate::{Error, PlantFile, Rig, replay};

/// A simulated board cannot be compared with a recording.
#[derive(Debug, thiserror::Error)]
pub enum TwinError {
    /// The recording has no samples of the motor.
    #[error("the log has no samples of a motor {channel}: it has {}", listed(motors))]
    NotRecorded {
        /// The motor.
        channel: ChannelId,
        /// The motors that are recorded.
        motors: Vec<ChannelId>,
    },
    /// The replay has no samples of the motor.
    #[error("the simulated board sent no samples of {channel}")]
    NotSimulated {
        /// The motor.
        channel: ChannelId,
    },
    /// The two runs do not overlap in time.
    #[error("the simulated board sent no samples at the times of the recording")]
    NothingInCommon,
}

fn listed(motors: &[ChannelId]) -> String {
    let names: Vec<_> = motors.iter().map(ToString::to_string).collect();
    if names.is_empty() { "none".to_owned() } else { names.join(", ") }
}

/// Difference between a simulated board and a recording.
#[derive(Clone, Debug, Serialize)]
pub struct Twin {
    /// Root mean square error of the position, rad or m; of an angle from where each run began.
    pub position_rmse: f64,
    /// Root mean square error of the speed, rad/s or m/s.
    pub speed_rmse: f64,
    /// Causes of the simulated board's trip, if the recorded one did not trip.
    pub stopped: Option<String>,
}

/// The differences with two plants.
#[derive(Clone, Debug, Serialize)]
pub struct Twins {
    /// With the plant as it was.
    pub before: Twin,
    /// With the plant as it is now.
    pub after: Twin,
    /// Unit of the position's error.
    pub position_unit: &'static str,
    /// Unit of the speed's error.
    pub speed_unit: &'static str,
    /// Number of recorded samples.
    pub samples: usize,
}

/// Replays `log` on the virtual board of `rig` with two plants for the motor, and compares each run with the recording. For a plant
/// of `None` it is that of `rig`.
///
/// # Errors
/// When the motor is not in the log, or the log cannot be replayed.
pub fn compare(
    rig: &Rig,
    log: &Log,
    channel: ChannelId,
    (before, after): (Option<PlantFile>, PlantFile),
) -> Result<Twins, Error> {
    rig.target.robot()?;
    let motors = || log.motors.iter().map(|motor| motor.info.id).collect();
    let recorded = log.motor(channel).ok_or_else(|| TwinError::NotRecorded { channel, motors: motors() })?;
    let (position_unit, speed_unit) = if recorded.is_linear() { ("m", "m/s") } else { ("rad", "rad/s") };
    let before = twin(rig, log, recorded, before)?;
    let after = twin(rig, log, recorded, Some(after))?;
    Ok(Twins { before, after, position_unit, speed_unit, samples: recorded.samples.len() })
}

fn twin(rig: &Rig, log: &Log, recorded: &MotorSeries, plant: Option<PlantFile>) -> Result<Twin, Error> {
    let channel = recorded.info.id;
    let mut rig = rig.clone();
    if let Some(plant) = plant {
        rig.plants.retain(|other| other.channel != channel);
        rig.plants.push(plant);
    }
    let (again, shift_s) = replay::again(&rig, log)?;
    let simulated = again.motor(channel).ok_or(TwinError::NotSimulated { channel })?;
    let stopped = |log: &Log| log.states.iter().find(|state| state.state == SafetyState::Tripped).map(|it| it.causes);
    let stopped = stopped(&again).filter(|_| stopped(log).is_none()).map(|causes| causes.to_string());
    let rmse = |value: fn(&MotorSample) -> f64, from_start| rmse(recorded, simulated, shift_s, value, from_start);
    // The zero of an angle is where power came on, which differs between the machine and a simulation; a rod's zero is calibrated.
    let position_rmse = rmse(|sample| sample.position, !recorded.is_linear());
    let speed_rmse = rmse(|sample| sample.speed, false);
    let (Some(position_rmse), Some(speed_rmse)) = (position_rmse, speed_rmse) else {
        return Err(TwinError::NothingInCommon.into());
    };
    Ok(Twin { position_rmse, speed_rmse, stopped })
}

/// Root mean square of the difference between two runs, at the moments of the first. The second is interpolated linearly, its times
/// shifted by `shift_s`. `None` without a common moment.
fn rmse(
    recorded: &MotorSeries,
    simulated: &MotorSeries,
    shift_s: f64,
    value: fn(&MotorSample) -> f64,
    from_start: bool,
) -> Option<f64> {
    let zero = |series: &MotorSeries| series.samples.first().map(value).filter(|_| from_start).unwrap_or(0.0);
    let (zero_recorded, zero_simulated) = (zero(recorded), zero(simulated));
    let mut differences = RootMeanSquare::default();
    for sample in &recorded.samples {
        let at_s = sample.time_s - shift_s;
        let after = simulated.samples.partition_point(|other| other.time_s < at_s);
        let (Some(right), left) = (simulated.samples.get(after), after.saturating_sub(1)) else { continue };
        let left = &simulated.samples[left];
        let step_s = right.time_s - left.time_s;
        // The second run has no sample yet.
        if at_s < left.time_s && at_s != right.time_s {
            continue;
        }
        let share = if step_s > 0.0 { (at_s - left.time_s) / step_s } else { 1.0 };
        let there = value(left) + share * (value(right) - value(left)) - zero_simulated;
        let difference = value(sample) - zero_recorded - there;
        if difference.is_finite() {
            differences.push(difference);
        }
    }
    differences.value()
}
