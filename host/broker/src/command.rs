//! Command of the board: which client has it, and when it ends.

use futures::channel::oneshot;
use r4_protocol::{Request, SafetyState};

/// Longest time a request may be on its way to the board after it was passed on, µs: the driver's time-out for an
/// answer.
const UNDER_WAY_US: u64 = 600_000;
/// Number of link time-outs of silence after which a client no longer commands. The board has tripped after one.
const SILENT_TIMEOUTS: u64 = 2;

/// Kind of a request with respect to a shared board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Role {
    /// Opens or closes the client's session.
    Session,
    /// Changes nothing for others: allowed to any client with a session.
    Watch,
    /// Stops the board: allowed to any client, with or without a session.
    Stop,
    /// Changes the board: allowed only to the client that commands.
    Command,
}

/// Returns the role of a request. The match has no wildcard, so that each new request has to be classified.
pub(crate) const fn role(request: &Request) -> Role {
    match request {
        Request::Hello { .. } | Request::Bye => Role::Session,
        Request::Describe { .. }
        | Request::Subscribe { .. }
        | Request::Stats
        | Request::DescribeParameter { .. }
        | Request::Fault { .. }
        | Request::FaultSnapshot { .. }
        | Request::Log { .. }
        | Request::Image => Role::Watch,
        Request::Stop => Role::Stop,
        Request::Arm
        | Request::Disarm
        | Request::Clear
        | Request::Set { .. }
        | Request::SetGains { .. }
        | Request::SetParameter { .. }
        | Request::SetName { .. }
        | Request::SaveParameters
        | Request::ResetParameters
        | Request::Restart
        | Request::I2cTransfer { .. }
        | Request::UartWrite { .. }
        // Reading takes bytes that another client may be waiting for.
        | Request::UartRead { .. }
        | Request::Bind { .. }
        | Request::Bootloader
        | Request::Follow { .. }
        | Request::SetTuning { .. } => Role::Command,
    }
}

/// Holder of the command, with the times that decide when it ends.
#[derive(Default)]
pub(crate) struct Command {
    holder: Holder,
    /// Time until which a [`Request::Arm`] may still be under way, on the host's clock, µs.
    arming_until_us: u64,
    /// Time at which the last answered heartbeat was sent, on the host's clock, µs.
    answered_us: u64,
    /// Time at which the client that commands, or last commanded, was heard, on the host's clock, µs.
    heard_us: u64,
    /// Senders for the callers that wait for the end of [`Holder::Ending`].
    waiting: Vec<oneshot::Sender<()>>,
}

#[derive(Clone, Copy, Default, PartialEq, Eq)]
enum Holder {
    #[default]
    Nobody,
    Client(u64),
    /// The client has ended its session; the board is not disarmed yet.
    Ending,
    /// The client is silent or has left without ending its session.
    Lost,
}

/// Actions that follow from a check of the commanding client.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Look {
    /// True if the broker sends the board's heartbeat by itself: nothing can move, or no client commands.
    pub(crate) keeps_heartbeat: bool,
    /// True if the board has to be disarmed, and [`Command::ended`] called after that.
    pub(crate) disarms: bool,
}

impl Command {
    /// Returns the number of the client that commands; `None` if no client does or its command is ending.
    pub(crate) const fn holder(&self) -> Option<u64> {
        if let Holder::Client(number) = self.holder { Some(number) } else { None }
    }

    /// Returns true unless the next client could command: one commands, or the board is not disarmed yet after the last one.
    pub(crate) fn is_taken(&self) -> bool {
        self.holder != Holder::Nobody
    }

    /// Gives the command to client `number` if no client has it. Returns whether `number` has it now.
    pub(crate) fn claim(&mut self, number: u64) -> bool {
        if self.holder == Holder::Nobody {
            self.holder = Holder::Client(number);
        }
        self.holder == Holder::Client(number)
    }

    /// Notes that a [`Request::Arm`] is sent now.
    pub(crate) const fn arming(&mut self, now_us: u64) {
        self.arming_until_us = now_us + UNDER_WAY_US;
    }

    /// Notes the answer to a heartbeat that was sent at `sent_us`.
    pub(crate) fn heard(&mut self, sent_us: u64) {
        self.answered_us = self.answered_us.max(sent_us);
    }

    /// Ends the command of client `number`, which has closed its session. Returns a receiver that is ready once the
    /// board is disarmed; `None` if the client did not command.
    pub(crate) fn end(&mut self, number: u64) -> Option<oneshot::Receiver<()>> {
        (self.holder() == Some(number)).then(|| {
            self.holder = Holder::Ending;
            let (sender, receiver) = oneshot::channel();
            self.waiting.push(sender);
            receiver
        })
    }

    /// Notes that client `number` has left without closing its session.
    pub(crate) fn lose(&mut self, number: u64) {
        if self.holder() == Some(number) {
            self.holder = Holder::Lost;
        }
    }

    /// Frees the command after the board was disarmed and the binding of the former client removed.
    pub(crate) fn ended(&mut self) {
        if matches!(self.holder, Holder::Ending | Holder::Lost) {
            self.holder = Holder::Nobody;
        }
        for waiting in self.waiting.drain(..) {
            // The waiting client may have left by now.
            let _ = waiting.send(());
        }
    }

    /// Returns whether outputs may be moving or about to move. `state` is the last known state of the board.
    fn may_be_armed(&self, now_us: u64, state: SafetyState) -> bool {
        state == SafetyState::Armed || now_us.min(self.answered_us) < self.arming_until_us
    }

    /// Checks the commanding client at `now_us`. `timeout_us` is the board's link time-out, `heard_us` the time at
    /// which the client was last heard (`None`: it is gone).
    pub(crate) fn look(&mut self, now_us: u64, timeout_us: u64, state: SafetyState, heard_us: Option<u64>) -> Look {
        // A client that has left keeps the time at which it was last heard.
        self.heard_us = heard_us.unwrap_or(self.heard_us);
        let is_silent = now_us.saturating_sub(self.heard_us) > SILENT_TIMEOUTS * timeout_us;
        if matches!(self.holder, Holder::Client(_)) && is_silent {
            self.holder = Holder::Lost;
        }
        let may_be_armed = self.may_be_armed(now_us, state);
        match self.holder {
            Holder::Nobody => Look { keeps_heartbeat: true, disarms: false },
            Holder::Client(_) => Look { keeps_heartbeat: !may_be_armed, disarms: false },
            Holder::Ending => Look { keeps_heartbeat: !may_be_armed, disarms: true },
            // The board is left to trip by itself first, so that it latches the lost link as the cause.
            Holder::Lost => Look { keeps_heartbeat: !may_be_armed, disarms: is_silent || !may_be_armed },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TIMEOUT_US: u64 = 200_000;

    fn held_since(us: u64) -> Command {
        let mut command = Command::default();
        assert!(command.claim(1) && !command.claim(2));
        command.look(us, TIMEOUT_US, SafetyState::Disarmed, Some(us));
        command
    }

    #[test]
    fn a_board_that_may_be_armed_has_no_heartbeat_of_the_broker() {
        let mut command = held_since(0);
        let kept = |command: &mut Command, now_us, state| {
            command.look(now_us, TIMEOUT_US, state, Some(now_us)).keeps_heartbeat
        };
        assert!(kept(&mut command, 1, SafetyState::Disarmed) && kept(&mut command, 2, SafetyState::Tripped));
        assert!(!kept(&mut command, 3, SafetyState::Armed));
        // The broker's heartbeats resume only after an answer proves that the arm request had no effect.
        command.arming(10);
        assert!(!kept(&mut command, 11, SafetyState::Disarmed));
        command.heard(UNDER_WAY_US);
        assert!(!kept(&mut command, 2 * UNDER_WAY_US, SafetyState::Disarmed));
        command.heard(UNDER_WAY_US + 10);
        assert!(kept(&mut command, 2 * UNDER_WAY_US, SafetyState::Disarmed));
    }

    #[test]
    fn who_is_lost_is_waited_for_until_the_board_has_tripped() {
        let mut command = held_since(0);
        command.lose(2);
        assert_eq!(command.holder(), Some(1));
        command.lose(1);
        let lost = |command: &mut Command, now_us| command.look(now_us, TIMEOUT_US, SafetyState::Armed, None);
        assert_eq!(lost(&mut command, 2 * TIMEOUT_US), Look { keeps_heartbeat: false, disarms: false });
        assert!(!command.claim(2) && command.is_taken());
        assert_eq!(lost(&mut command, 2 * TIMEOUT_US + 1), Look { keeps_heartbeat: false, disarms: true });
        command.ended();
        assert!(!command.is_taken() && command.claim(2));
    }

    #[test]
    fn who_is_lost_with_a_disarmed_board_is_waited_for_no_longer() {
        let mut command = held_since(0);
        command.lose(1);
        let ends = command.look(1, TIMEOUT_US, SafetyState::Disarmed, None);
        assert_eq!(ends, Look { keeps_heartbeat: true, disarms: true });
    }

    #[test]
    fn who_is_silent_no_longer_commands() {
        let mut command = held_since(0);
        let look =
            |command: &mut Command, now_us| command.look(now_us, TIMEOUT_US, SafetyState::Armed, Some(0)).disarms;
        assert!(!look(&mut command, 2 * TIMEOUT_US));
        assert!(look(&mut command, 2 * TIMEOUT_US + 1) && command.holder().is_none());
    }

    #[test]
    fn a_goodbye_is_answered_when_the_board_is_disarmed() {
        let mut command = held_since(0);
        assert!(command.end(2).is_none());
        let mut ended = command.end(1).expect("it commanded");
        assert!(command.look(1, TIMEOUT_US, SafetyState::Armed, None).disarms);
        assert_eq!(ended.try_recv(), Ok(None));
        command.ended();
        assert_eq!(ended.try_recv(), Ok(Some(())));
    }
}
