//! Side of links, dispatch and cycles: sessions, set points and configuration as hosts ask for them.

use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_time::{Duration, Instant};
use r4_protocol::{
    ImageInfo, Mode, PathPoint, Refusal, Setpoint,
    config::{BoardConfig, PidGains, Place, Tuning},
};

use super::{
    commands::stop_of,
    paths::at,
    start::Restart,
    state::{Shared, side},
};
use crate::{log::Log, safety::Event};

side! {
    /// Shared state for what hosts ask for.
    HostSide
}

// Set points.
impl<M: RawMutex> HostSide<'_, M> {
    /// Stores a command, decided at `sent_us`, for the control loop's next period; a later one replaces it.
    pub(crate) fn command(&self, output: Place, setpoint: Setpoint, sent_us: u64) -> Result<(), Refusal> {
        self.with(|s| s.command(output, setpoint, sent_us))
    }

    /// Stops `output` because a set point for it, decided at `sent_us`, was refused: the host no longer wants the one
    /// in force. An output that follows a set point decided later goes on, so that an old frame that comes late or
    /// twice stops nothing. If the refused one has `expired`, an equal date means the same set point, and the output
    /// goes on, too.
    ///
    /// Only for requests of the link that holds the session: no other link commands outputs, but any link may stop the
    /// whole board.
    pub(crate) fn withdraw(&self, output: Place, sent_us: u64, expired: bool) {
        self.with(|s| {
            let Some(given) = s.commands.given(output).filter(|given| !given.supersedes(sent_us, expired)) else {
                return;
            };
            if let Some(stop) = stop_of(self.config(), output, given.setpoint, s.statuses.get(output)) {
                // The error is ignored: nothing is in force unless the board is armed.
                let _ = s.command(output, stop, sent_us);
            }
        });
    }

    /// Stores the commands of a cycle, each as [`HostSide::command`] does, with a lease until `until`. Points of paths,
    /// dated `sent_us`, need no lease: a path ends by itself.
    pub(crate) fn lease(&self, setpoints: &[(Place, Setpoint)], sent_us: u64, until: Instant) -> Result<(), Refusal> {
        let is_point = |setpoint: &Setpoint| setpoint.mode == Mode::Follow;
        let point = |setpoint: &Setpoint| at(sent_us, setpoint.value);
        self.with(|s| {
            // Check all points before any is stored, so that all are taken or none.
            for (place, setpoint) in setpoints.iter().filter(|(_, setpoint)| is_point(setpoint)) {
                s.check_path(self.config(), *place, &[point(setpoint)])?;
            }
            for (place, setpoint) in setpoints {
                if is_point(setpoint) {
                    s.follow(*place, &[point(setpoint)], sent_us)?;
                    continue;
                }
                s.command(*place, *setpoint, sent_us)?;
                s.commands.lease(*place, setpoint.mode, until);
            }
            Ok(())
        })
    }

    /// Adds points of a path, decided at `sent_us`, whose numbers were checked, to a motor's path: all of them, or
    /// none.
    pub(crate) fn follow(&self, output: Place, points: &[PathPoint], sent_us: u64) -> Result<(), Refusal> {
        self.with(|s| {
            s.check_path(self.config(), output, points)?;
            s.follow(output, points, sent_us)
        })
    }

    /// Stores gains for the control loop's next period, armed or not. An open-loop duty has none.
    pub(crate) fn change_gains(&self, motor: usize, mode: Mode, gains: PidGains) {
        self.with(|s| s.tunings.set_gains(motor, mode, gains));
    }

    /// Stores a tuning for the control loop's next period, armed or not.
    pub(crate) fn change_tuning(&self, motor: usize, tuning: Tuning) {
        self.with(|s| s.tunings.set_tuning(motor, tuning));
    }
}

// Sessions.
impl<M: RawMutex> HostSide<'_, M> {
    /// Returns true if outputs are in a known state and every range sensor that can stop the board has reported.
    pub(crate) fn has_started(&self) -> bool {
        self.with(|s| s.held || s.started && s.ranges.have_reported(&self.config().ranges))
    }

    /// Opens a session for `link`, and closes the previous session of that link.
    ///
    /// # Errors
    /// [`Refusal::InUse`] while another link's session is alive.
    pub(crate) fn open_session(&self, link: u8, now: Instant) -> Result<u16, Refusal> {
        let timeout = Duration::from_millis(self.config().link_timeout_ms.into());
        self.with(|s| s.sessions.check(link, timeout, now))?;
        // A new host does not know what the last one left running.
        self.request(Event::Disarm)?;
        Ok(self.with(|s| s.sessions.open(link, now)))
    }

    /// Returns true if `link` holds the session.
    pub(crate) fn has_session(&self, link: u8) -> bool {
        self.with(|s| s.sessions.is_of(link))
    }

    /// Takes a heartbeat; false when it belongs to no open session.
    pub(crate) fn heartbeat(&self, link: u8, id: u16, now: Instant) -> bool {
        self.with(|s| s.sessions.heartbeat(link, id, now))
    }

    /// Closes the session of `link`, and disarms.
    pub(crate) fn close_session(&self, link: u8) {
        if self.has_session(link) {
            // Disarming is never refused.
            let _ = self.request(Event::Disarm);
            self.with(|s| s.sessions.close());
        }
    }
}

// Configuration and restart.
impl<'s, M: RawMutex> HostSide<'s, M> {
    pub(crate) fn image(&self) -> Result<ImageInfo, Refusal> {
        self.0.image.ok_or(Refusal::NoImage)
    }

    pub(crate) fn log(&self) -> Option<&'s Log> {
        self.0.log.as_ref()
    }

    /// Configuration that the firmware was built with.
    pub(crate) fn built_in(&self) -> &'s BoardConfig {
        &self.0.built_in
    }

    /// Configuration as changed by hosts.
    pub(crate) fn pending(&self) -> BoardConfig {
        self.with(|s| s.pending.clone())
    }

    /// Sets the changed configuration. If two hosts change it at once, the later wins.
    pub(crate) fn set_pending(&self, config: BoardConfig) {
        self.with(|s| s.pending = config);
    }

    /// Prevents arming for the lifetime of the result.
    ///
    /// # Errors
    /// [`Refusal::NotWhile`] while the board is armed.
    pub(crate) fn hold_arming(&self) -> Result<ArmingHeld<'s, M>, Refusal> {
        self.with(|s| s.supervision.hold_arming())?;
        Ok(ArmingHeld(self.0))
    }

    /// Requests a restart of the board, which cannot be armed any more.
    ///
    /// # Errors
    /// [`Refusal::NotWhile`] while it is armed, [`Refusal::NoBootloader`] without a bootloader that started the image.
    pub(crate) fn restart(&self, restart: Restart) -> Result<(), Refusal> {
        if restart == Restart::Bootloader && !self.0.image.is_some_and(|image| image.hosted) {
            return Err(Refusal::NoBootloader);
        }
        core::mem::forget(self.hold_arming()?);
        self.0.restart.signal(restart);
        Ok(())
    }
}

/// Guard returned by [`HostSide::hold_arming`].
pub(crate) struct ArmingHeld<'s, M: RawMutex>(&'s Shared<M>);

impl<M: RawMutex> Drop for ArmingHeld<'_, M> {
    fn drop(&mut self) {
        self.0.with(|s| s.supervision.release_arming());
    }
}
