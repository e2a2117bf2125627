//! A lift on a board: the regulator is on the host, drives and encoders are on the board; the true state is sampled
//! meanwhile.

use std::{cell::RefCell, convert::Infallible, pin::pin};

use futures::future::{Either, select};
use r4_protocol::{Mode, SafetyState, Sample};
use r4_rig::{Error, InertialReading, Session, inertial_reading};
use r4_world::{AnyBody, BalanceTail};

use super::{
    law::{Measured, Regulator},
    scene::Setup,
    trunk::{self, Lean},
};

/// Duration of a trial after the start of the lift, s.
pub(super) const AFTER_S: f64 = 9.0;
/// Period of the samples of the true state, s.
pub(super) const WATCHED_EVERY_S: f64 = 1e-3;
/// Time over which the inertial sensor is averaged before the motors are armed, s.
const RESTS_S: f64 = 1.0;
/// Time to live of commands, ms: five periods of the regulator.
const COMMAND_TTL_MS: u16 = 50;

/// True state at one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moment {
    /// Time of the simulation, s.
    pub time_s: f64,
    /// Position of the person's centre of mass in front of the ankle, m.
    pub wearer_x_m: f64,
    /// Angles of trunk and joints, rad.
    pub angle_rad: [f64; 3],
    /// Torques of the motors' drives, from the back outwards, N m.
    pub torque_nm: [f64; 2],
    /// Speeds of the motors, rad/s.
    pub speed_rad_s: [f64; 2],
}

impl Moment {
    /// True state of a body, with the torques and speeds of its motors.
    pub(super) fn of(body: &BalanceTail, time_s: f64, torque_nm: [f64; 2], speed_rad_s: [f64; 2]) -> Self {
        Self { time_s, wearer_x_m: body.wearer_x_m(), angle_rad: body.state().angle_rad, torque_nm, speed_rad_s }
    }
}

/// True states over a trial.
#[derive(Clone, Debug, Default)]
pub struct Trace {
    /// True states, one every millisecond.
    pub moments: Vec<Moment>,
    /// Time at which the regulator started, s; infinite without a regulator.
    pub armed_at_s: f64,
}

/// Samples the true state until the lift is over.
///
/// With a `regulator` the motors are armed and regulated; without one they stay on their brakes.
///
/// # Errors
/// The error of the board when it is not virtual, does not arm, or stops; [`Error::NoReadings`] when the inertial
/// sensor sends nothing.
pub async fn lift(
    session: &Session<'_>,
    setup: &Setup,
    lift_at_s: f64,
    regulator: Option<&Regulator>,
) -> Result<Trace, Error> {
    let until_s = lift_at_s + AFTER_S;
    let moments = RefCell::new(Vec::new());
    let watch = async {
        loop {
            moments.borrow_mut().push(look(session, setup)?);
            session.board.sleep_s(WATCHED_EVERY_S).await;
        }
    };
    let mut armed_at_s = f64::INFINITY;
    let balance = async {
        if let Some(regulator) = regulator {
            let period_ms = (setup.settings.period_s * 1e3).round() as u16;
            for sensor in setup.joints.iter().map(|joint| joint.encoder).chain([setup.trunk]) {
                session.board.subscribe(sensor, period_ms).await?;
            }
            let still = rest(session, setup).await?;
            armed_at_s = time_s(session)?;
            session.armed(async || balance(session, setup, until_s, regulator, still).await).await
        } else {
            session.board.sleep_s((until_s - time_s(session)?).max(0.0)).await;
            Ok(())
        }
    };
    let ended: Either<Result<(), Error>, Result<Infallible, Error>> = match select(pin!(balance), pin!(watch)).await {
        Either::Left((ended, _)) => Either::Left(ended),
        Either::Right((ended, _)) => Either::Right(ended),
    };
    match ended {
        Either::Left(ended) => ended?,
        Either::Right(Err(error)) => return Err(error),
        Either::Right(Ok(never)) => match never {},
    }
    Ok(Trace { moments: moments.into_inner(), armed_at_s })
}

/// Time of the virtual board's world, s, to which the person's lift refers.
fn time_s(session: &Session<'_>) -> Result<f64, Error> {
    Ok(session.virtual_board()?.world().clock().now_ns() as f64 * 1e-9)
}

/// Reads the true state of person, tail and motors.
fn look(session: &Session<'_>, setup: &Setup) -> Result<Moment, Error> {
    let mut world = session.virtual_board()?.world();
    let time_s = world.clock().now_ns() as f64 * 1e-9;
    world.catch_up();
    let [torque_nm, speed_rad_s] = [0, 1].map(|what| {
        setup.joints.map(|joint| {
            let drive = world.bldc(joint.channel);
            drive.map_or(0.0, |drive| if what == 0 { drive.torque_nm() } else { drive.speed_rad_s() })
        })
    });
    match world.body() {
        Some(AnyBody::BalanceTail(body)) => Ok(Moment::of(body, time_s, torque_nm, speed_rad_s)),
        // Not reached: `Setup::of` refuses robots without a tail.
        _ => Ok(Moment { time_s, wearer_x_m: 0.0, angle_rad: [0.0; 3], torque_nm, speed_rad_s }),
    }
}

async fn balance(
    session: &Session<'_>,
    setup: &Setup,
    until_s: f64,
    regulator: &Regulator,
    still: Lean,
) -> Result<(), Error> {
    let board = session.board;
    let mut telemetry = board.telemetry();
    let channels = setup.joints.map(|joint| (joint.channel, Mode::Duty));
    let mut commands = board.stream(&channels, COMMAND_TTL_MS).await?;
    let (mut lean, mut integral_rad_s) = (still, 0.0);
    let mut before: Option<(u64, [f64; 2])> = None;
    while time_s(session)? < until_s {
        let frame = telemetry.next().await?;
        if frame.state == SafetyState::Tripped {
            return Err(r4_driver::Error::Stopped { causes: frame.causes }.into());
        }
        let Some(motors_rad) = encoders(session, setup, &frame.samples)? else { continue };
        let at_us = frame.device_us;
        let Some(sample) = trunk_sample(setup, &frame.samples) else {
            // The last command has expired by now, so that the board has stopped the tail.
            if before.is_some_and(|(before_us, _)| at_us.saturating_sub(before_us) > u64::from(COMMAND_TTL_MS) * 1000) {
                return Err(Error::NoReadings { channel: setup.trunk });
            }
            continue;
        };
        let Some((before_us, before_rad)) = before.replace((at_us, motors_rad)) else { continue };
        let after_s = at_us.saturating_sub(before_us) as f64 * 1e-6;
        if after_s <= 0.0 {
            continue;
        }
        let (lean_rad, lean_rad_s) = lean.next(sample, after_s);
        let mut measured = Measured { angle_rad: [lean_rad, 0.0, 0.0], rate_rad_s: [lean_rad_s, 0.0, 0.0] };
        for (number, joint) in setup.joints.iter().enumerate() {
            measured.angle_rad[number + 1] = motors_rad[number] / joint.ratio;
            measured.rate_rad_s[number + 1] = (motors_rad[number] - before_rad[number]) / after_s / joint.ratio;
        }
        let command;
        (command, integral_rad_s) = regulator.next(&measured, [0.0; 2], integral_rad_s);
        commands.set(&command.share)?;
    }
    Ok(())
}

/// Angles of the motors, rad; `None` for a frame without those of both.
fn encoders(session: &Session<'_>, setup: &Setup, samples: &[Sample]) -> Result<Option<[f64; 2]>, Error> {
    let mut angles_rad = [0.0; 2];
    for (angle_rad, joint) in angles_rad.iter_mut().zip(&setup.joints) {
        let counts = samples.iter().find_map(|sample| match *sample {
            Sample::Encoder { channel, position, .. } if channel == joint.encoder => Some(position),
            _ => None,
        });
        let Some(counts) = counts else { return Ok(None) };
        *angle_rad = f64::from(counts) * f64::from(session.board.channel(joint.encoder)?.resolution);
    }
    Ok(Some(angles_rad))
}

/// Estimates the lean of the trunk from a second of its sensor's readings, before the motors are armed.
async fn rest(session: &Session<'_>, setup: &Setup) -> Result<Lean, Error> {
    let mut telemetry = session.board.telemetry();
    let until_s = session.board.now_s() + RESTS_S;
    let mut samples = Vec::new();
    while session.board.now_s() < until_s {
        samples.extend(trunk_sample(setup, &telemetry.next().await?.samples));
    }
    if samples.is_empty() {
        return Err(Error::NoReadings { channel: setup.trunk });
    }
    Ok(Lean::at_rest(&samples))
}

/// Reading of the trunk's sensor in a telemetry frame; `None` for a frame without it.
fn trunk_sample(setup: &Setup, samples: &[Sample]) -> Option<trunk::Sample> {
    let InertialReading { acceleration_m_s2, rate_rad_s, .. } = inertial_reading(setup.trunk, samples)?;
    Some(trunk::Sample { rate_rad_s: rate_rad_s[1], force_m_s2: [acceleration_m_s2[0], acceleration_m_s2[2]] })
}
