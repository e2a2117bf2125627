//! Requests, cycles and heartbeats from elsewhere, such as a broker's clients, passed on to the board unchanged.

use r4_protocol::{Causes, Cycle, CycleState, HotWinding, Reply, Request, SafetyState, ToDevice};

use crate::{
    Board, Clock, Error,
    streams::{LogStream, Stream, lock},
};

/// Board's answer to a heartbeat.
#[derive(Clone, Debug, PartialEq)]
pub struct HeartbeatAnswer {
    /// Host's clock when the heartbeat left, µs: the value that [`Board::send_heartbeat`] returned for it.
    pub host_us: u64,
    /// Board's clock at the answer, µs.
    pub device_us: u64,
    /// State of the board's supervisor.
    pub state: SafetyState,
    /// Causes latched by a trip.
    pub causes: Causes,
    /// Motors with windings close to their temperature limit.
    pub hot: Vec<HotWinding>,
}

impl<C: Clock> Board<C> {
    /// Selects whether the driver sends heartbeats by itself, which it does initially. With `false`, the board trips
    /// after its link time-out unless [`Board::send_heartbeat`] is called often enough; after five such time-outs
    /// without an answer the session ends.
    pub fn keep_heartbeat(&self, keeps: bool) {
        lock(&self.wire.state).relays_heartbeats = !keeps;
    }

    /// Sends a heartbeat now. Returns the host's clock in it, µs, which its answer repeats.
    pub fn send_heartbeat(&self) -> u64 {
        let host_us = self.wire.clock.now_us();
        let message = lock(&self.wire.state).heartbeat(host_us);
        if let Some(message) = message {
            self.wire.send(message);
        }
        host_us
    }

    /// Returns the host's clock, µs.
    #[must_use]
    pub fn host_now_us(&self) -> u64 {
        self.wire.clock.now_us()
    }

    /// Stream of the firmware's log from now on; [`Request::Log`] makes the board send it.
    #[must_use]
    pub fn log_chunks(&self) -> LogStream {
        lock(&self.wire.state).log.open()
    }

    /// Stream of answers to heartbeats from now on.
    #[must_use]
    pub fn heartbeat_answers(&self) -> Stream<HeartbeatAnswer> {
        lock(&self.wire.state).heartbeats.open()
    }

    /// Passes a request on. It is sent before this function returns and before everything sent later; it is repeated
    /// under the same rules as the driver's own requests.
    ///
    /// # Errors
    /// Those of any request, from the future.
    pub fn pass_on(&self, request: Request) -> impl Future<Output = Result<Reply, Error>> + use<C> {
        self.wire.send_request("request passed on", request, None)
    }

    /// Passes a cycle on. [`Board::cycle_answers`] returns its answer; [`Board::stream`] must not be in use.
    pub fn pass_on_cycle(&self, cycle: Cycle) {
        self.wire.send(ToDevice::Cycle(cycle));
    }

    /// Stream of answers to cycles from now on.
    #[must_use]
    pub fn cycle_answers(&self) -> Stream<CycleState> {
        lock(&self.wire.state).cycle_answers.open()
    }
}
