//! A trial on a board: five seconds forwards, with the shell and the wheels under a law.

use futures::future::try_join_all;
use r4_boards::Drive;
use r4_driver::TelemetryStream;
use r4_protocol::{Mode, Quality, SafetyState, Sample, Setpoint};
use r4_rig::{Error, GroundDrive, Session, Velocity, sides_rad};
use r4_world::{AnyBody, Body as _, Deformable, Pose};

use super::{
    law::{Law, Order, Seen},
    scene::{Magnet, Setup, TRIAL_S},
};

/// Telemetry period of whiskers and wheels, ms.
const PERIOD_MS: u16 = 10;
/// Time constant of the board's low-pass on analog inputs, s: that of the firmware.
const FILTER_S: f64 = 0.010;
/// Threshold for two things, rad: consecutive inputs of that low-pass that count as equal, and a change of the shown
/// value. Six times the converter's noise, referred to the filter's input. With 1 mrad noise is taken for new samples.
const SAME_RAD: f64 = 4e-3;
/// Smallest change of the servo's set point that is sent, rad: a tenth of its dead band.
const SERVO_STEP_RAD: f64 = 1e-3;

/// True state at one moment, with the program's inputs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moment {
    /// Time since the start, s.
    pub time_s: f64,
    /// Inputs of the law, as the board shows them.
    pub seen: Seen,
    /// True bends of both whiskers, rad.
    pub bent_rad: [f64; 2],
    /// Width of the shell, m.
    pub width_m: f64,
    /// True pose of the robot's middle.
    pub pose: Pose,
}

/// Record of a trial.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Run {
    /// States every 10 ms from the start on.
    pub moments: Vec<Moment>,
}

impl Moment {
    pub(super) fn new(time_s: f64, seen: Seen, body: &Deformable) -> Self {
        let width_m = body.shell().width_m(body.angle_rad());
        Self { time_s, seen, bent_rad: body.bent_rad(), width_m, pose: body.pose() }
    }
}

/// Connection of the program to whiskers and wheels of a board.
pub(super) struct Rider<'r, 'b> {
    session: &'r Session<'b>,
    setup: &'r Setup,
    ground: GroundDrive,
    telemetry: TelemetryStream,
    whiskers: [Option<Whisker>; 2],
    time_s: f64,
    wheels_rad: Option<[f64; 2]>,
    sent: Option<Order>,
}

/// Inverse of the board's low-pass for one whisker. Samples are held, so that the filter's input is constant between
/// them.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Whisker {
    read_rad: f64,
    input_rad: f64,
    shown_rad: f64,
}

impl Whisker {
    const fn new(read_rad: f64) -> Self {
        Self { read_rad, input_rad: read_rad, shown_rad: read_rad }
    }

    fn next(self, read_rad: f64, after_s: f64) -> Self {
        // First-order low-pass over one period, solved for its input. The floor bounds the gain where two frames are
        // close.
        let keeps = (-after_s / FILTER_S).exp();
        let input_rad = (read_rad - keeps * self.read_rad) / (1.0 - keeps).max(0.1);
        let is_level = (input_rad - self.input_rad).abs() < SAME_RAD;
        let is_new = is_level && (input_rad - self.shown_rad).abs() > SAME_RAD;
        Self { read_rad, input_rad, shown_rad: if is_new { input_rad } else { self.shown_rad } }
    }
}

impl<'r, 'b> Rider<'r, 'b> {
    pub(super) async fn new(session: &'r Session<'b>, setup: &'r Setup) -> Result<Self, Error> {
        let telemetry = session.board.telemetry();
        let magnets = setup.magnets.map(|magnet| magnet.channel);
        let wheels = setup.drive.left.iter().chain(&setup.drive.right).copied();
        for channel in magnets.into_iter().chain(wheels) {
            session.board.subscribe(channel, PERIOD_MS).await?;
        }
        let ground = GroundDrive::new(Drive::SkidSteer(setup.drive.clone()));
        Ok(Self { session, setup, ground, telemetry, whiskers: [None; 2], time_s: 0.0, wheels_rad: None, sent: None })
    }

    /// Discards frames that were queued.
    pub(super) fn skip(&mut self) {
        while self.telemetry.try_next().is_some() {}
    }

    /// Waits for the next frame with whiskers and returns the law's inputs.
    pub(super) async fn seen(&mut self) -> Result<Seen, Error> {
        loop {
            let frame = self.telemetry.next().await?;
            if frame.state == SafetyState::Tripped {
                return Err(r4_driver::Error::Stopped { causes: frame.causes }.into());
            }
            let mut is_new = false;
            let time_s = self.session.board.host_us(frame.device_us) as f64 * 1e-6;
            for sample in &frame.samples {
                let Sample::Reading { channel, value, quality: Quality::Good, .. } = *sample else { continue };
                let magnet = |magnet: &Magnet| magnet.channel == channel;
                if let Some(side) = self.setup.magnets.iter().position(magnet) {
                    let Magnet { zero_v, v_per_rad, .. } = self.setup.magnets[side];
                    let read_rad = (f64::from(value) - zero_v) / v_per_rad;
                    let after_s = time_s - self.time_s;
                    self.whiskers[side] = Some(
                        self.whiskers[side].map_or(Whisker::new(read_rad), |before| before.next(read_rad, after_s)),
                    );
                    is_new = true;
                }
            }
            self.wheels_rad = sides_rad(self.session.board, &self.setup.drive, &frame.samples).or(self.wheels_rad);
            if is_new {
                self.time_s = time_s;
            }
            if let ([Some(left), Some(right)], Some(wheels_rad), true) = (self.whiskers, self.wheels_rad, is_new) {
                return Ok(Seen { time_s, bent_rad: [left.shown_rad, right.shown_rad], wheels_rad });
            }
        }
    }

    /// Sends the parts of a command that have changed.
    pub(super) async fn order(&mut self, order: Order) -> Result<(), Error> {
        let board = self.session.board;
        let changed = |is: f64, was: Option<f64>, step: f64| was.is_none_or(|was| (is - was).abs() > step);
        let was = self.sent;
        let mut sent = was.unwrap_or(order);
        if changed(order.servo_rad, was.map(|was| was.servo_rad), SERVO_STEP_RAD) {
            sent.servo_rad = order.servo_rad;
            board.set(self.setup.servo, Setpoint { mode: Mode::Position, value: order.servo_rad as f32 }).await?;
        }
        if was.is_none_or(|was| order.velocity != was.velocity) {
            sent.velocity = order.velocity;
            // Both sides at once: a side that starts before the other turns the robot.
            let sets = self.ground.setpoints(order.velocity).into_iter();
            try_join_all(sets.map(|(wheel, setpoint)| board.set(wheel, setpoint))).await?;
        }
        self.sent = Some(sent);
        Ok(())
    }
}

/// Drives for five seconds by a law, after `waits_s` at rest.
///
/// # Errors
/// The error of the board when it is not virtual, does not arm or stops.
pub async fn drive(session: &Session<'_>, setup: &Setup, law: &mut Law, waits_s: f64) -> Result<Run, Error> {
    session
        .armed(async || {
            let mut rider = Rider::new(session, setup).await?;
            rider.order(Order { servo_rad: 0.0, velocity: Velocity::default() }).await?;
            session.board.sleep_s(waits_s).await;
            rider.skip();
            let begin_s = session.board.now_s();
            let mut run = Run::default();
            while session.board.now_s() < begin_s + TRIAL_S {
                let seen = rider.seen().await?;
                let order = law.next(seen);
                rider.order(order).await?;
                if let Some(body) = truth(session)? {
                    run.moments.push(Moment::new(session.board.now_s() - begin_s, seen, &body));
                }
            }
            Ok(run)
        })
        .await
}

/// Copy of the robot's true state; `None` for a board without a shell.
///
/// # Errors
/// When the board is not virtual.
pub fn truth(session: &Session<'_>) -> Result<Option<Deformable>, Error> {
    let mut world = session.virtual_board()?.world();
    world.catch_up();
    Ok(match world.body() {
        Some(AnyBody::Deformable(body)) => Some((**body).clone()),
        _ => None,
    })
}
