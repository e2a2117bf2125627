//! Plays a scenario on a virtual board.

use anyhow::Context;
use r4_driver::{Board, Error};
use r4_protocol::{
    Setpoint,
    config::{BoardConfig, Feedback, Place},
};
use r4_sim::{
    VirtualBoard,
    i2c::{Disturbance, Injection, Span},
};
use serde::Serialize;

use super::file::{Action, Scenario, Step};
use crate::session::{HostClock, Session};
use r4_rig::cable::CableState;

/// What came of a scenario.
#[derive(Clone, Debug, Default, Serialize)]
pub(super) struct Outcome {
    pub(super) looks: Vec<Look>,
    /// Causes of each trip, the first first.
    pub(super) trips: Vec<Vec<String>>,
    /// Steps the board refused, and why.
    pub(super) refused: Vec<String>,
}

/// Where everything was at one moment.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Look {
    pub(super) at_s: f64,
    pub(super) state: String,
    pub(super) motions: Vec<Motion>,
}

/// What one output did, as the world knows it and not as the board measured it.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Motion {
    pub(super) channel: String,
    pub(super) unit: &'static str,
    pub(super) position: f64,
    /// Per second.
    pub(super) speed: f64,
    /// What its sensor resolves, for a stepper its step.
    pub(super) resolution: f64,
    /// One period of the board's control loop, s.
    pub(super) period_s: f64,
}

/// Noise of the simulated potentiometers reaches this many codes now and then (4.3 standard deviations of 2.3 codes).
const POTENTIOMETER_CODES: f64 = 10.0;

pub(super) async fn play(session: &Session<'_>, scenario: &Scenario) -> anyhow::Result<Outcome> {
    let (around, cable) = (session.virtual_board()?, session.cable()?);
    let mut outcome = Outcome::default();
    let begin_s = session.board.now_s();
    for step in &scenario.steps {
        session.board.sleep_s(begin_s + step.at_s - session.board.now_s()).await;
        match act(session.board, around, cable, step, &mut outcome).await {
            Ok(()) => {}
            // Part of the outcome: a scenario may well ask for what is not allowed.
            Err(error @ (Error::Refused { .. } | Error::Stopped { .. } | Error::TimedOut { .. })) => {
                outcome.refused.push(format!("{} at {} s: {error}", step.action.what(), step.at_s));
            }
            Err(error) => return Err(error).with_context(|| format!("at {} s", step.at_s)),
        }
    }
    let faults = session.board.faults().await.context("cannot read the history of trips")?;
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
) -> Result<(), Error> {
    match step.action {
        Action::Look => outcome.looks.push(look(board, around, step.at_s)),
        Action::Arm => board.arm().await?,
        Action::Disarm => board.disarm().await?,
        Action::Stop => board.stop().await?,
        Action::Clear => board.clear().await?,
        Action::Set { channel, mode, value } => board.set(channel, Setpoint { mode, value }).await?,
        Action::DeadMan { held } => around.dead_man().set(held),
        Action::AuxiliaryStop { pressed } => around.auxiliary_stop().set(!pressed),
        Action::Distance { range, distance_m } => {
            if let Some(sensor) = around.world().range_sensor(range) {
                sensor.set_distance_m(distance_m);
            }
        }
        Action::Supply { channel, emf_v } => around.world().set_emf(channel, emf_v),
        Action::Block { channel, blocked } => {
            // The robot's file has been read with this plant before.
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

fn look(board: &Board<HostClock>, around: &dyn VirtualBoard, at_s: f64) -> Look {
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
    Look { at_s, motions: motions.collect(), state: board.safety().0.to_string() }
}

/// What the sensor of an output resolves, or its smallest command, and the unit of both; `None` for what does not move.
fn resolution(config: &BoardConfig, place: Place) -> Option<(f64, &'static str)> {
    use std::f64::consts::TAU;
    match place {
        Place::Motor(index) => match config.motors.get(index)?.control.as_ref()?.feedback {
            Feedback::Encoder { counts_per_turn, .. } => Some((TAU / f64::from(counts_per_turn), "rad")),
            Feedback::Potentiometer { low, high, .. } => {
                let m_per_code = (high.position_m - low.position_m) / (f32::from(high.code) - f32::from(low.code));
                Some((f64::from(m_per_code.abs()) * POTENTIOMETER_CODES, "m"))
            }
        },
        Place::Stepper(index) => Some((TAU / f64::from(config.steppers.get(index)?.steps_per_turn), "rad")),
        // A servo's pulse has 4096 steps to its cycle of 20 ms: 4.9 us, of about 1 ms for a quarter of a turn.
        Place::Servo(_) => Some((0.0049 * TAU / 4.0, "rad")),
        _ => None,
    }
}
