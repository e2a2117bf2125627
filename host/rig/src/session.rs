//! A session with a board.

use std::{cell::Cell, convert::Infallible, pin::pin, rc::Rc};

use futures::future::{Either, select};
use r4_driver::Board;
use r4_protocol::{ChannelId, Mode, config::PidGains};
use r4_sim::VirtualBoard;

use crate::{
    Error, HostClock, NotVirtual, Notice, Target, cable::CableState, heat::Warned, recording::SharedTap, rig::Notify,
};

/// How often hot windings are looked for, s: heartbeats report them.
const HEAT_EVERY_S: f64 = 0.05;

/// Gains that a loop of a motor gets when a session ends.
type GainsAtEnd = (ChannelId, Mode, PidGains);

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
    gains_at_end: Cell<Option<GainsAtEnd>>,
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
        let (warned, gains_at_end) = (Warned::default(), Cell::new(None));
        Self { board, clock, tap, target, notify, warned, gains_at_end, environment }
    }
}

impl Session<'_> {
    /// Name of the board.
    #[must_use]
    pub fn target(&self) -> &Target {
        self.target
    }

    /// True position of a motor's output, rad or m: of a virtual board only.
    #[must_use]
    pub fn true_position(&self, channel: ChannelId) -> Option<f64> {
        self.environment.as_ref()?.0.world().position(channel)
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

    /// Sets the gains that one loop gets when the session ends, also when it fails or is interrupted; `None` takes that back.
    pub fn gains_at_end(&self, gains: Option<GainsAtEnd>) {
        self.gains_at_end.set(gains);
    }

    pub(crate) fn take_gains_at_end(&self) -> Option<GainsAtEnd> {
        self.gains_at_end.take()
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
