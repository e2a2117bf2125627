//! Input for the firmware while it is measured: random requests of all kinds, then as much traffic as the links carry.

use std::cell::Cell;

use futures::future::{join_all, join3};
use r4_driver::{Board, Error};
use r4_emu::EmuBoard;
use r4_protocol::{
    ChannelInfo, Mode, Range, SafetyState, Setpoint,
    can::{BITRATE, Direction, MAX_DATA, Node},
    config::PidGains,
};
use r4_sim::Clock;
use r4_thumb::ThumbCore;
use rand_pcg::{Pcg64, rand_core::Rng};
use serde::Serialize;

use crate::session::HostClock;

const MS: u64 = 1_000_000;
/// Requests in flight at once: more than the link carries in the time of one answer.
const UNDER_WAY: usize = 8;
/// Period of reversals of all moving outputs, ns.
const TURN_NS: u64 = 100 * MS;
/// Settling time, ms: longer than contacts bounce and motors need to start.
const SETTLE_MS: u64 = 200;
/// Time limit for arming, ms; a board that exceeds it does not recover.
const ARMED_WITHIN_MS: u64 = 5_000;
/// CAN node number with which the images are built.
const NODE: Node = Node::new(0).expect("below 128");
/// Bits of a full frame with its inter-frame space and few stuff bits: the shortest frame, which gives the most frames.
const FRAME_BITS: u64 = 111;
/// Address on a connector without a device; the missing acknowledgement is an answer too.
const ADDRESS: u8 = 0x42;

/// Counters of requests by outcome.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub(super) struct Requests {
    /// Requests with an answer, refusals included.
    pub(super) answered: u64,
    /// Requests with a refusal.
    pub(super) refused: u64,
    /// Requests without an answer in time.
    pub(super) timed_out: u64,
}

/// Host that stresses a board.
pub(super) struct Tormentor<'b> {
    pub(super) host: &'b Board<HostClock>,
    pub(super) board: &'b EmuBoard<ThumbCore>,
    pub(super) clock: Clock,
    requests: Cell<Requests>,
    /// True while one of the concurrent senders arms the board again.
    arming: Cell<bool>,
    /// Trips under load, after each of which the board was armed again.
    trips: Cell<u32>,
}

impl<'b> Tormentor<'b> {
    pub(super) fn new(host: &'b Board<HostClock>, board: &'b EmuBoard<ThumbCore>, clock: Clock) -> Self {
        Self { host, board, clock, requests: Cell::default(), arming: Cell::default(), trips: Cell::default() }
    }

    /// Returns the counters since the last call, and resets them.
    pub(super) fn take_requests(&self) -> Requests {
        self.requests.take()
    }

    /// Trips under load, for example by stall monitoring of a motor at its end stop.
    pub(super) fn trips(&self) -> u32 {
        self.trips.get()
    }

    async fn sleep_ms(&self, ms: u64) {
        self.clock.sleep(ms * MS).await;
    }

    /// Counts a result; only a lost link is an error.
    fn note<T>(&self, result: Result<T, Error>) -> anyhow::Result<()> {
        let mut requests = self.requests.get();
        match result {
            Ok(_) => requests.answered += 1,
            Err(Error::Refused(_)) => {
                requests.answered += 1;
                requests.refused += 1;
            }
            Err(Error::TimedOut { .. }) => requests.timed_out += 1,
            Err(error) => return Err(error.into()),
        }
        self.requests.set(requests);
        Ok(())
    }

    /// Arms the board from any state.
    async fn armed(&self) -> anyhow::Result<()> {
        let until_ns = self.clock.now_ns() + ARMED_WITHIN_MS * MS;
        while self.host.safety().0 != SafetyState::Armed {
            self.note(self.host.clear().await)?;
            self.note(self.host.arm().await)?;
            // The next heartbeat brings the new state.
            self.sleep_ms(60).await;
            anyhow::ensure!(
                self.clock.now_ns() < until_ns,
                "the board cannot be armed: it is {} ({})",
                self.host.safety().0,
                self.host.safety().1
            );
        }
        Ok(())
    }

    /// Sends random requests of all kinds, stops included, for a time.
    pub(super) async fn mix(&self, random: &mut Pcg64, seconds: f64) -> anyhow::Result<()> {
        let parameters = self.host.parameters().await?;
        let until_ns = self.clock.now_ns() + (seconds * 1e9) as u64;
        while self.clock.now_ns() < until_ns {
            let channel = pick(random, self.host.channels());
            match below(random, 64) {
                0..40 => self.command(random, channel).await?,
                40..44 => {
                    let gain = share(random);
                    let gains = PidGains { kp: gain, ki: gain, kd: 0.01 * gain };
                    let mode = if below(random, 2) == 0 { Mode::Position } else { Mode::Speed };
                    self.note(self.host.set_gains(channel.id, mode, gains).await)?;
                }
                44..48 => {
                    let parameter = pick(random, &parameters);
                    let value = parameter.built_in * (0.9 + 0.2 * share(random));
                    self.note(self.host.set_parameter(parameter.key, value).await)?;
                }
                48 => self.note(self.host.save_parameters().await)?,
                49 => self.note(self.host.reset_parameters().await)?,
                50..54 => {
                    let period_ms = below(random, 20) as u16;
                    self.note(self.host.subscribe(channel.id, period_ms).await)?;
                }
                54 => self.all_subscribed(1).await?,
                55 => self.note(self.host.stats().await)?,
                56 => self.note(self.host.faults().await)?,
                57 => self.note(self.host.fault_snapshots(below(random, 4) as u8).await)?,
                58 => self.note(self.host.i2c_transfer(below(random, 2) as u8, ADDRESS, &[1, 2, 3], 4).await)?,
                59 => self.note(self.host.uart_write(below(random, 2) as u8, b"0123456789abcdef").await)?,
                60 => self.note(self.host.stop().await)?,
                61 => self.note(self.host.disarm().await)?,
                62 => {
                    self.board.dead_man().set(false);
                    self.sleep_ms(u64::from(below(random, 10))).await;
                    self.board.dead_man().set(true);
                }
                _ => self.clock.sleep(u64::from(below(random, 20 * MS as u32))).await,
            }
            if self.host.safety().0 != SafetyState::Armed && below(random, 4) == 0 {
                self.note(self.host.clear().await)?;
                self.note(self.host.arm().await)?;
            }
        }
        Ok(())
    }

    /// Sends a set point within the channel's range, or in one of eight cases outside it.
    async fn command(&self, random: &mut Pcg64, channel: &ChannelInfo) -> anyhow::Result<()> {
        let Some(mode) = channel.modes.get(below(random, 4) as usize % channel.modes.len().max(1)) else {
            return Ok(());
        };
        let Range { min, max } = mode.range;
        let value = match below(random, 16) {
            0 => f32::NAN,
            1 => max + 1.0,
            _ => min + (max - min) * share(random),
        };
        self.note(self.host.set(channel.id, Setpoint { mode: mode.mode, value }).await)
    }

    async fn all_subscribed(&self, period_ms: u16) -> anyhow::Result<()> {
        for channel in self.host.channels() {
            self.note(self.host.subscribe(channel.id, period_ms).await)?;
        }
        Ok(())
    }

    /// Arms, subscribes to all channels every millisecond, and lets transients settle.
    pub(super) async fn prepare_load(&self) -> anyhow::Result<()> {
        self.armed().await?;
        self.all_subscribed(1).await?;
        self.sleep_ms(SETTLE_MS).await;
        Ok(())
    }

    /// Sends as many requests as the link carries, continuous frames on CAN, and raw transfers.
    pub(super) async fn load(&self, seconds: f64) -> anyhow::Result<()> {
        let until_ns = self.clock.now_ns() + (seconds * 1e9) as u64;
        let requests = join_all((0..UNDER_WAY).map(|first| self.commands(first, until_ns)));
        let (requests, raw, ()) = join3(requests, self.raw(until_ns), self.can(until_ns)).await;
        raw?;
        requests.into_iter().collect()
    }

    /// Sends set points to all outputs in turn, 40 % or 60 % of the way through their ranges.
    async fn commands(&self, first: usize, until_ns: u64) -> anyhow::Result<()> {
        let moving: Vec<_> = self
            .host
            .channels()
            .iter()
            .filter_map(|channel| {
                let mode = channel.mode(Mode::Duty).or(channel.mode(Mode::Position)).or(channel.modes.first())?;
                Some((channel.id, *mode))
            })
            .collect();
        for (channel, mode) in moving.iter().cycle().skip(first) {
            let now_ns = self.clock.now_ns();
            if now_ns >= until_ns {
                break;
            }
            if self.host.safety().0 != SafetyState::Armed && !self.arming.replace(true) {
                self.trips.set(self.trips.get() + 1);
                let armed = self.armed().await;
                self.arming.set(false);
                armed?;
            }
            let side = if (now_ns / TURN_NS).is_multiple_of(2) { 0.4 } else { 0.6 };
            let Range { min, max } = mode.range;
            let value = if mode.mode == Mode::Switch { f32::from(side > 0.5) } else { min + (max - min) * side };
            self.note(self.host.set(*channel, Setpoint { mode: mode.mode, value }).await)?;
        }
        Ok(())
    }

    /// Transfers bytes on the external connectors.
    async fn raw(&self, until_ns: u64) -> anyhow::Result<()> {
        for step in (0..=u8::MAX).cycle() {
            if self.clock.now_ns() >= until_ns {
                break;
            }
            self.note(self.host.uart_write(step & 1, &[0x55; 16]).await)?;
            self.note(self.host.i2c_transfer(step & 1, ADDRESS, &[step], 1).await)?;
            self.sleep_ms(1).await;
        }
        Ok(())
    }

    /// Sends back-to-back CAN frames to the board. Their content is damaged: the firmware checks each one completely,
    /// but no session starts that would end this one.
    async fn can(&self, until_ns: u64) {
        const FRAME_NS: u64 = FRAME_BITS * 1_000_000_000 / BITRATE as u64;
        let identifier = NODE.identifier(Direction::ToDevice);
        let (mut at_ns, mut byte) = (self.clock.now_ns(), 0_u8);
        while self.clock.now_ns() < until_ns {
            // Queue the frames of the next two milliseconds.
            while at_ns < self.clock.now_ns() + 2 * MS {
                at_ns += FRAME_NS;
                let mut data = vec![0; MAX_DATA];
                for place in &mut data {
                    byte = byte.wrapping_add(1);
                    // A frame of the byte link ends with a zero byte.
                    *place = if byte.is_multiple_of(32) { 0 } else { byte };
                }
                self.board.can_receive(at_ns, identifier, data);
            }
            self.sleep_ms(1).await;
        }
    }
}

fn below(random: &mut Pcg64, limit: u32) -> u32 {
    random.next_u32() % limit
}

fn share(random: &mut Pcg64) -> f32 {
    below(random, 1 << 16) as f32 / 65536.0
}

fn pick<'v, T>(random: &mut Pcg64, values: &'v [T]) -> &'v T {
    &values[below(random, values.len() as u32) as usize]
}
