//! A session with a board.

use std::{cell::Cell, convert::Infallible, pin::pin, rc::Rc};

use futures::future::{Either, select};
use r4_boards::Robot;
use r4_driver::Board;
use r4_protocol::{
    ChannelId, Mode,
    config::{PidGains, Tuning},
};
use r4_sim::VirtualBoard;

use crate::{
    Error, GroundDrive, HostClock, NotVirtual, Notice, Place, Target, cable::CableState, heat::Warned,
    recording::SharedTap, rig::Notify,
};

/// How often hot windings are looked for, s: heartbeats report them.
const HEAT_EVERY_S: f64 = 0.05;

/// What a motor gets when a session ends: the gains of a loop, and its tuning.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AtEnd {
    /// The motor.
    pub channel: ChannelId,
    /// Which of its loops gets gains, [`Mode::Position`] or [`Mode::Speed`].
    pub mode: Mode,
    /// Gains of that loop.
    pub gains: PidGains,
    /// Feed-forward and cascade.
    pub tuning: Tuning,
}

/// A connected board, and what is known about it on this side of the link.
pub struct Session<'s> {
    /// The board.
    pub board: &'s Board<HostClock>,
    /// Time of the driver.
    pub clock: HostClock,
    /// Recording of this session, if there is one.
    pub tap: Option<SharedTap>,
    target: &'s Target,
    notify: Notify,
    warned: Warned,
    at_end: Cell<Option<AtEnd>>,
    /// `None` at the end of a link.
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
    /// Name of the board.
    #[must_use]
    pub fn target(&self) -> &Target {
        self.target
    }

    /// The robot's file, if it is known: a board does not describe that. At the end of a link it is known for the name of a built-in robot.
    #[must_use]
    pub fn robot(&self) -> Option<Robot> {
        let name = match self.target {
            Target::Sim(name) | Target::Emu(name) => name,
            Target::Link(_) => r4_boards::names().find(|name| *name == self.board.info().robot.as_str())?,
        };
        r4_boards::load(name).ok()
    }

    /// How the robot drives over the ground, if [its file](Self::robot) is known.
    #[must_use]
    pub fn ground_drive(&self) -> Option<GroundDrive> {
        self.robot()?.drive.map(GroundDrive::new)
    }

    /// True position of a motor's output, rad or m: of a virtual board only.
    #[must_use]
    pub fn true_position(&self, channel: ChannelId) -> Option<f64> {
        self.environment.as_ref()?.0.world().position(channel)
    }

    /// True place of a robot's body now: of a virtual board whose robot has one.
    #[must_use]
    pub fn true_place(&self) -> Option<Place> {
        let pose = self.environment.as_ref()?.0.world().pose()?;
        Some(Place { x_m: pose.x_m, y_m: pose.y_m, yaw_rad: pose.yaw_rad })
    }

    /// The board with its environment, to read and to break.
    ///
    /// # Errors
    /// When the board is at the other end of a link.
    pub fn virtual_board(&self) -> Result<&dyn VirtualBoard, NotVirtual> {
        self.environment.as_ref().map(|(board, _)| &**board).ok_or_else(|| NotVirtual(self.target.clone()))
    }

    /// The cable to a virtual board, to cut.
    ///
    /// # Errors
    /// When the board is at the other end of a link.
    pub fn cable(&self) -> Result<&CableState, NotVirtual> {
        self.environment.as_ref().map(|(_, cable)| &**cable).ok_or_else(|| NotVirtual(self.target.clone()))
    }

    /// Sets what a motor gets when the session ends, also when it fails or is interrupted; `None` takes that back.
    pub fn at_end(&self, of: Option<AtEnd>) {
        self.at_end.set(of);
    }

    pub(crate) fn take_at_end(&self) -> Option<AtEnd> {
        self.at_end.take()
    }

    /// Arms, runs `work`, and disarms whatever its result. Notifies meanwhile of windings that become hot.
    ///
    /// # Errors
    /// That of `work`; or when the board does not arm or disarm.
    pub async fn armed<T, E: From<Error>>(&self, work: impl AsyncFnOnce() -> Result<T, E>) -> Result<T, E> {
        self.board.arm().await.map_err(Error::Arm)?;
        let result = match select(pin!(work()), pin!(self.watch_heat())).await {
            Either::Left((result, _)) => result,
            Either::Right((never, _)) => match never {},
        };
        self.notify_of_heat();
        let disarmed = self.board.disarm().await;
        let value = result?;
        disarmed.map_err(Error::Disarm)?;
        Ok(value)
    }

    /// Notifies of windings that became hot since the last time.
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
