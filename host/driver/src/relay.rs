//! A board whose requests, cycles and heartbeats come from elsewhere, as from the clients of a broker: they are passed on as they are.

use r4_protocol::{Causes, Cycle, CycleState, HotWinding, Reply, Request, SafetyState, ToDevice};

use crate::{
    Board, Clock, Error,
    streams::{LogStream, Stream, lock},
};

/// A heartbeat that the board answered.
#[derive(Clone, Debug, PartialEq)]
pub struct HeartbeatAnswer {
    /// The host's clock when it left, µs: what [`Board::send_heartbeat`] returned, for one of its own.
    pub host_us: u64,
    /// The board's clock when it answered, µs.
    pub device_us: u64,
    /// State of the board's supervisor.
    pub state: SafetyState,
    /// Causes latched by a trip.
    pub causes: Causes,
    /// Motors whose windings are close to what they withstand.
    pub hot: Vec<HotWinding>,
}

impl<C: Clock> Board<C> {
    /// Whether this driver sends heartbeats by itself, as it does from the beginning. If not, the board trips after its link time-out unless
    /// [`Board::send_heartbeat`] is called more often; after five such time-outs the session has ended, as whenever no heartbeat is answered.
    pub fn keep_heartbeat(&self, keeps: bool) {
        lock(&self.wire.state).relays_heartbeats = !keeps;
    }

    /// Sends a heartbeat now. Returns the host's clock that is in it, µs, by which its answer is known.
    pub fn send_heartbeat(&self) -> u64 {
        let host_us = self.wire.clock.now_us();
        let message = lock(&self.wire.state).heartbeat(host_us);
        if let Some(message) = message {
            self.wire.send(message);
        }
        host_us
    }

    /// The clock of this host now, µs.
    #[must_use]
    pub fn host_now_us(&self) -> u64 {
        self.wire.clock.now_us()
    }

    /// What the firmware logs from now on, for which the board is asked by [`Request::Log`].
    #[must_use]
    pub fn log_chunks(&self) -> LogStream {
        lock(&self.wire.state).log.open()
    }

    /// Answers to heartbeats from now on.
    #[must_use]
    pub fn heartbeat_answers(&self) -> Stream<HeartbeatAnswer> {
        lock(&self.wire.state).heartbeats.open()
    }

    /// Passes a request on. It is on its way when this returns, before all that is asked for later; it is sent again as the driver's own are.
    ///
    /// # Errors
    /// Of the future: those of any request.
    pub fn pass_on(&self, request: Request) -> impl Future<Output = Result<Reply, Error>> + use<C> {
        self.wire.send_request("request passed on", request, None)
    }

    /// Passes a cycle on. Its answer comes by [`Board::cycle_answers`]; [`Board::stream`] must not be in use.
    pub fn pass_on_cycle(&self, cycle: Cycle) {
        self.wire.send(ToDevice::Cycle(cycle));
    }

    /// Answers to cycles from now on.
    #[must_use]
    pub fn cycle_answers(&self) -> Stream<CycleState> {
        lock(&self.wire.state).cycle_answers.open()
    }
}
