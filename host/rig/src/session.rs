//! Session with a board, and its state on the host.

use std::{
    cell::Cell,
    convert::Infallible,
    pin::{Pin, pin},
    rc::Rc,
};

use futures::future::{Either, select};
use r4_boards::Robot;
use r4_driver::Board;
use r4_protocol::{
    ChannelId, Mode,
    config::{PidGains, Tuning},
};
use r4_sim::VirtualBoard;

use crate::{
    Error, Footprint, GroundDrive, HostClock, NotVirtual, Notice, Place, Target,
    cable::CableState,
    heat::Warned,
    recording::SharedTap,
    rig::Notify,
    view::{LookAtWorld, View},
};

/// Period of the check for hot windings, s: that of the heartbeats, which report them.
const HEAT_EVERY_S: f64 = 0.05;

/// Gains and tuning that a motor gets when a session ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AtEnd {
    /// Channel of the motor.
    pub channel: ChannelId,
    /// Loop that the gains belong to, [`Mode::Position`] or [`Mode::Speed`].
    pub mode: Mode,
    /// Gains of that loop.
    pub gains: PidGains,
    /// Feed-forward and cascade settings.
    pub tuning: Tuning,
}

/// A connected board, with its state on this side of the link.
pub struct Session<'s> {
    /// Board of the session.
    pub board: &'s Board<HostClock>,
    /// Clock of the driver, virtual or real.
    pub clock: HostClock,
    /// Recording of this session; `None` without one.
    pub tap: Option<SharedTap>,
    target: &'s Target,
    notify: Notify,
    warned: Warned,
    at_end: Cell<Option<AtEnd>>,
    /// Virtual board and its cable; `None` for a board on a link.
    environment: Option<(Rc<dyn VirtualBoard>, Rc<CableState>)>,
}

impl<'s> Session<'s> {
    pub(crate) fn new(
        board: &'s Board<HostClock>,
        target: &'s Target,
        clock: HostClock,
        tap: Option<SharedTap>,
        notify: Notify,
        environment: Option<(Rc<dyn VirtualBoard>, Rc<CableState>)>,
    ) -> Self {
        let (warned, at_end) = (Warned::default(), Cell::new(None));
        Self { board, clock, tap, target, notify, warned, at_end, environment }
    }
}

impl Session<'_> {
    /// Name of the board, as the caller gave it.
    #[must_use]
    pub fn target(&self) -> &Target {
        self.target
    }

    /// Lets the recording hold a [`View`] of a robot that drives, in the world that `look` returns.
    pub(crate) fn record_view(&self, look: LookAtWorld) {
        // After a lost link the view goes on where it was.
        let Some(tap) = self.tap.as_ref().filter(|tap| !tap.borrow().is_deriving()) else { return };
        if let Some(footprint) = self.robot().as_ref().and_then(Footprint::of) {
            tap.borrow_mut().derive(Box::new(View::new(footprint, look)));
        }
    }

    /// Robot's file; `None` when it is not known: see [`Target::description`].
    #[must_use]
    pub fn robot(&self) -> Option<Robot> {
        self.target.description(self.board.info().robot.as_str())
    }

    /// Drive of the robot over the ground, from [its file](Self::robot); `None` when the file is not known.
    #[must_use]
    pub fn ground_drive(&self) -> Option<GroundDrive> {
        self.robot()?.drive.map(GroundDrive::new)
    }

    /// True position of a motor's output, rad or m; `None` unless the board is virtual.
    #[must_use]
    pub fn true_position(&self, channel: ChannelId) -> Option<f64> {
        self.environment.as_ref()?.0.world().position(channel)
    }

    /// True pose of the robot's body; `None` unless the board is virtual and its robot has one.
    #[must_use]
    pub fn true_place(&self) -> Option<Place> {
        let pose = self.environment.as_ref()?.0.world().pose()?;
        Some(Place { x_m: pose.x_m, y_m: pose.y_m, yaw_rad: pose.yaw_rad })
    }

    /// Virtual board with its environment, which the caller may read and change.
    ///
    /// # Errors
    /// [`NotVirtual`] for a board on a link.
    pub fn virtual_board(&self) -> Result<&dyn VirtualBoard, NotVirtual> {
        self.environment.as_ref().map(|(board, _)| &**board).ok_or_else(|| NotVirtual(self.target.clone()))
    }

    /// Cable to a virtual board, which the caller may cut.
    ///
    /// # Errors
    /// [`NotVirtual`] for a board on a link.
    pub fn cable(&self) -> Result<&CableState, NotVirtual> {
        self.environment.as_ref().map(|(_, cable)| &**cable).ok_or_else(|| NotVirtual(self.target.clone()))
    }

    /// Sets the gains and tuning that a motor gets when the session ends, also after an error or an interrupt; `None`
    /// cancels that.
    pub fn at_end(&self, of: Option<AtEnd>) {
        self.at_end.set(of);
    }

    pub(crate) fn take_at_end(&self) -> Option<AtEnd> {
        self.at_end.take()
    }

    /// Arms, runs `work`, and disarms whatever its result. Notifies of windings that become hot meanwhile.
    ///
    /// # Errors
    /// The error of `work`; [`Error::Arm`] or [`Error::Disarm`] when the board refuses.
    pub async fn armed<T, E: From<Error>>(&self, work: impl AsyncFnOnce() -> Result<T, E>) -> Result<T, E> {
        self.board.arm().await.map_err(Error::Arm)?;
        let mut result = None;
        let disarmed = self.disarmed_after(pin!(async { result = Some(work().await) })).await;
        // The error of the work goes first: a failed disarm is often its consequence.
        let value = result.ok_or(Error::Standstill)??;
        disarmed.map_err(Error::Disarm)?;
        Ok(value)
    }

    /// Waits until `work` ends, and disarms. Not generic, so that it is compiled once for all work.
    async fn disarmed_after(&self, work: Pin<&mut dyn Future<Output = ()>>) -> Result<(), r4_driver::Error> {
        match select(work, pin!(self.watch_heat())).await {
            Either::Left(((), _)) => {}
            Either::Right((never, _)) => match never {},
        }
        self.notify_of_heat();
        self.board.disarm().await
    }

    /// Notifies of windings that became hot since the last call.
    pub fn notify_of_heat(&self) {
        for hot in self.warned.fresh(&self.board.hot_windings()) {
            (self.notify)(&Notice::HotWinding(hot));
        }
    }

    async fn watch_heat(&self) -> Infallible {
        loop {
            self.notify_of_heat();
            self.board.sleep_s(HEAT_EVERY_S).await;
        }
    }
}
