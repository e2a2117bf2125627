//! Commands of velocities and of joints' set points, which are leased: they expire unless they are repeated.

use r4_driver::{CycleReport, Error as DriverError};
use r4_protocol::{ChannelId, CycleOutcome, SafetyState, Setpoint};
use r4_rig::Velocity;

use super::{Echo, Report, Serving};
use crate::{
    BASE_FRAME,
    gate::{self, Refused},
    leased::{Bound, CYCLE_CHANNELS, Setpoints},
    message::{Header, JointState, Twist, TwistStamped, Vector3},
    time::Stamp,
};

impl<'b, R: FnMut(Report) -> bool> Serving<'b, R> {
    pub(super) fn velocity(&mut self, stamp: Option<Stamp>, twist: &Twist) -> Result<(), Refused> {
        let drive = self.drive.as_ref().ok_or(Refused::NoDrive)?;
        let velocity = gate::velocity(twist)?;
        let setpoints = drive.setpoints(velocity);
        let now = self.now();
        // Checked last, because an accepted stamp counts as the newest: that of a refused velocity must not.
        if !self.gate.pass(stamp, now)? {
            return Ok(());
        }
        let stamp = stamp.filter(|stamp| !stamp.is_none()).unwrap_or(now);
        let echo = self.echo(stamp, &setpoints);
        self.command(setpoints, echo)
    }

    /// Returns the message with the velocity that the wheels' set points amount to, after the robot's limits; `None` for a robot that does
    /// not steer by its sides.
    fn echo(&self, stamp: Stamp, setpoints: &[(ChannelId, Setpoint)]) -> Echo {
        let robot = self.frames.robot()?;
        let speed = |side: &[ChannelId]| {
            let wheel = setpoints.iter().find(|(channel, _)| side.first() == Some(channel));
            wheel.map(|(_, setpoint)| f64::from(setpoint.value))
        };
        let Velocity { forward_m_s, yaw_rad_s } =
            Velocity::of_sides(robot, [speed(&robot.left)?, speed(&robot.right)?]);
        let twist = Twist {
            linear: Vector3 { x: forward_m_s, ..Vector3::default() },
            angular: Vector3 { z: yaw_rad_s, ..Vector3::default() },
        };
        Some(TwistStamped { header: Header::new(stamp.to_time(), BASE_FRAME), twist })
    }

    pub(super) fn joints(&mut self, stamp: Option<Stamp>, joints: &JointState) -> Result<(), Refused> {
        let setpoints = gate::joints(joints, self.session.board.channels(), CYCLE_CHANNELS)?;
        if !self.gate.pass(stamp, self.now())? || setpoints.is_empty() {
            return Ok(());
        }
        self.command(setpoints, None)
    }

    fn command(&mut self, setpoints: Setpoints, echo: Echo) -> Result<(), Refused> {
        self.end_trajectory(&setpoints.iter().map(|(channel, _)| *channel).collect());
        let binding = self.leased.command(setpoints, echo).map_err(Refused::Board)?;
        self.push(binding);
        Ok(())
    }

    pub(super) fn bound(&mut self, binding: Result<Bound<'b>, DriverError>) -> Result<(), Refused> {
        let next = self.leased.bound(binding).map_err(Refused::Board)?;
        self.push(next);
        Ok(())
    }

    /// Handles the board's answer to a command.
    pub(super) fn answered(&mut self, report: &CycleReport, command: Option<Echo>) {
        // Set points that bring motors to rest come from the node, not from a publisher: they are not counted.
        let Some(echo) = command else { return };
        match report.outcome {
            CycleOutcome::Taken => {
                if let Some(echo) = echo {
                    self.publish(Report::Commanded(echo));
                }
                self.note_taken();
            }
            CycleOutcome::Refused if report.state != SafetyState::Armed => {
                self.refuse(format!("the board is {}: call ~/arm first", report.state));
            }
            CycleOutcome::Refused => {
                self.refuse("the board refused the set point: `r4 info` lists modes and ranges".into())
            }
            CycleOutcome::Stale => {
                self.refuse("the command reached the board too late: the link or this machine is busy".into())
            }
            CycleOutcome::Unbound => self.refuse("the board has no stream for the command: restart the node".into()),
        }
    }

    /// Counts a command that the board has accepted, and ends the warning about an earlier refusal.
    pub(super) fn note_taken(&mut self) {
        self.taken += 1;
        if self.refusal.take().is_some() {
            self.diagnose();
        }
    }
}
