//! Execution of a scenario on a virtual board.

use r4_driver::{Board, Error as DriverError};
use r4_protocol::{
    PathPoint, Setpoint,
    config::{AS5600_COUNTS, BoardConfig, Feedback, Place},
};
use r4_sim::{
    VirtualBoard,
    i2c::{Disturbance, Injection, Span},
};
use serde::Serialize;

use super::{Action, Scenario, ScenarioError, Step, file::Point};
use crate::{Error, HostClock, Session, cable::CableState};

/// Result of a scenario on one board.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Outcome {
    /// Checkpoints in the order of time.
    #[serde(rename = "looks")]
    pub checkpoints: Vec<Checkpoint>,
    /// Causes of each trip, the oldest trip first.
    pub trips: Vec<Vec<String>>,
    /// Steps that the board refused, each with its reason.
    pub refused: Vec<String>,
}

/// Positions of all outputs, and the board's state, at one moment.
#[derive(Clone, Debug, Serialize)]
pub struct Checkpoint {
    /// Time of the step, s.
    pub at_s: f64,
    /// Safety state of the board.
    pub state: String,
    /// Outputs that move, in the order of the board's channels.
    pub motions: Vec<Motion>,
}

/// True motion of one output in the simulated world, which the board knows only by its sensor.
#[derive(Clone, Debug, Serialize)]
pub struct Motion {
    /// Channel of the output.
    pub channel: String,
    /// Unit of the position and the resolution.
    pub unit: &'static str,
    /// True position of the output.
    pub position: f64,
    /// True speed, in the unit per second.
    pub speed: f64,
    /// Resolution of the output's sensor; for a stepper its step.
    pub resolution: f64,
    /// One period of the board's control loop, s.
    pub period_s: f64,
}

/// Noise amplitude of the simulated potentiometers, in codes: 4.3 standard deviations of 2.3 codes.
const POTENTIOMETER_CODES: f64 = 10.0;

/// Plays the steps of `scenario` to the session's board, at their times. Refused steps are part of the outcome.
///
/// # Errors
/// [`Error::NotVirtual`] for a board on a link; [`ScenarioError::Step`] when the link fails; [`ScenarioError::Trips`]
/// when the trips cannot be read.
pub async fn play(session: &Session<'_>, scenario: &Scenario) -> Result<Outcome, Error> {
    let (around, cable) = (session.virtual_board()?, session.cable()?);
    let mut outcome = Outcome::default();
    let begin_s = session.board.now_s();
    for step in &scenario.steps {
        session.board.sleep_s(begin_s + step.at_s - session.board.now_s()).await;
        match act(session.board, around, cable, step, &mut outcome).await {
            Ok(()) => {}
            // A refusal is part of the outcome: a scenario may deliberately request what is not allowed.
            Err(error @ (DriverError::Refused { .. } | DriverError::Stopped { .. } | DriverError::TimedOut { .. })) => {
                outcome.refused.push(format!("{} at {} s: {error}", step.action.what(), step.at_s));
            }
            Err(source) => return Err(ScenarioError::Step { at_s: step.at_s, source }.into()),
        }
    }
    let faults = session.board.faults().await.map_err(ScenarioError::Trips)?;
    let causes = |fault: &r4_protocol::FaultInfo| fault.causes.iter().map(|cause| cause.to_string()).collect();
    outcome.trips = faults.iter().map(causes).collect();
    outcome.trips.reverse();
    Ok(outcome)
}

async fn act(
    board: &Board<HostClock>,
    around: &dyn VirtualBoard,
    cable: &CableState,
    step: &Step,
    outcome: &mut Outcome,
) -> Result<(), DriverError> {
    match step.action {
        Action::Look => outcome.checkpoints.push(checkpoint(board, around, step.at_s)),
        Action::Arm => board.arm().await?,
        Action::Disarm => board.disarm().await?,
        Action::Stop => board.stop().await?,
        Action::Clear => board.clear().await?,
        Action::Set { channel, mode, value } => board.set(channel, Setpoint { mode, value }).await?,
        Action::Follow { channel, ref points } => {
            let now_us = board.device_us();
            let dated = |point: &Point| PathPoint {
                at_us: now_us + (point.after_s * 1e6) as u64,
                position: point.position,
                speed: point.speed,
                feed_forward: 0.0,
            };
            board.follow(channel, &points.iter().map(dated).collect::<Vec<_>>()).await?;
        }
        Action::Subscribe { channel, period_ms } => board.subscribe(channel, period_ms).await?,
        Action::DeadMan { held } => around.dead_man().set(held),
        Action::AuxiliaryStop { pressed } => around.auxiliary_stop().set(!pressed),
        Action::Distance { range, distance_m } => {
            if let Some(sensor) = around.world().range_sensor(range) {
                sensor.set_distance_m(distance_m);
            }
        }
        Action::Supply { channel, emf_v } => around.world().set_emf(channel, emf_v),
        Action::Block { channel, blocked } => {
            // Fails only for a plant that cannot be built, and this one was built at power-up.
            let _ = around.block_motor(channel, blocked);
        }
        Action::BusNack { address, transfers } => inject(
            around,
            Injection {
                disturbance: Disturbance::AddressNack,
                span: Span::Transfers { count: transfers },
                address: Some(address),
            },
        ),
        Action::BusStuck { for_s, persistent } => {
            let from_ns = around.world().clock().now_ns();
            let span = Span::Time { from_ns, until_ns: from_ns + (for_s * 1e9) as u64 };
            inject(around, Injection { disturbance: Disturbance::StuckLow { persistent }, span, address: None });
        }
        Action::LoseEdges { encoder, count } => {
            let mut world = around.world();
            if let Some(signal) = world.pins().encoders.get_mut(usize::from(encoder)) {
                signal.lose_edges(count);
            }
        }
        Action::HostCable { cut } => cable.cut.set(cut),
    }
    Ok(())
}

fn inject(around: &dyn VirtualBoard, injection: Injection) {
    around.world().bus.inject(injection);
}

fn checkpoint(board: &Board<HostClock>, around: &dyn VirtualBoard, at_s: f64) -> Checkpoint {
    let config = &around.robot().config;
    let mut world = around.world();
    let motions = config.channels().filter_map(|(channel, place)| {
        let (resolution, unit) = resolution(config, place)?;
        Some(Motion {
            channel: channel.to_string(),
            unit,
            position: world.position(channel)?,
            speed: world.speed(channel).unwrap_or(0.0),
            resolution,
            period_s: f64::from(config.control_period_us) * 1e-6,
        })
    });
    Checkpoint { at_s, motions: motions.collect(), state: board.safety().0.to_string() }
}

/// Resolution of an output's sensor, or its smallest command, with the unit; `None` for a channel that does not move.
fn resolution(config: &BoardConfig, place: Place) -> Option<(f64, &'static str)> {
    use std::f64::consts::TAU;
    match place {
        Place::Motor(index) => match config.motors.get(index)?.control.as_ref()?.feedback {
            Feedback::Encoder { counts_per_turn, .. } => Some((TAU / f64::from(counts_per_turn), "rad")),
            Feedback::Angle { .. } | Feedback::Pulses { .. } => Some((TAU / f64::from(AS5600_COUNTS), "rad")),
            Feedback::Potentiometer { low, high, .. } => {
                let m_per_code = (high.position_m - low.position_m) / (f32::from(high.code) - f32::from(low.code));
                Some((f64::from(m_per_code.abs()) * POTENTIOMETER_CODES, "m"))
            }
        },
        Place::Stepper(index) => Some((TAU / f64::from(config.steppers.get(index)?.steps_per_turn), "rad")),
        // The pulse of a servo has 4096 steps in its cycle of 20 ms: 4.9 µs, of about 1 ms for a quarter of a turn.
        Place::Servo(_) => Some((0.0049 * TAU / 4.0, "rad")),
        _ => None,
    }
}
