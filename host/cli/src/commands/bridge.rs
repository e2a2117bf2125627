//! `r4 bridge legacy-udp`: serves a board to hosts that speak the former R4 network protocol, text over UDP.

use std::{
    collections::HashSet,
    io,
    mem::{self, Discriminant},
    net::{IpAddr, SocketAddr, UdpSocket},
};

use anyhow::{Context, bail};
use r4_driver::Error;
use r4_links::legacy::{self, BOARD_PORT, Command, LOST_AFTER_S, Order, Packet, Sequence, TELEMETRY_PORT};
use r4_protocol::{ChannelId, ChannelKind, Mode, Refusal, SafetyState, Sample, Setpoint, Unit};
use r4_sim::Pace;
use serde::Serialize;

use crate::{
    args::Args,
    output,
    session::{self, Session},
};

/// Protocols of `r4 bridge`.
#[derive(Clone, Debug, clap::Subcommand)]
pub(crate) enum Bridge {
    /// Serve the text protocol over UDP of OpenPodCar's published ROS 2 nodes. It detects damaged packets but has no
    /// authentication, so that other machines reach it with --public only
    LegacyUdp(LegacyUdp),
}

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct LegacyUdp {
    /// Address at which commands are received
    #[arg(long, value_name = "ADDRESS", default_value_t = SocketAddr::from(([127, 0, 0, 1], BOARD_PORT)))]
    pub(crate) listen: SocketAddr,
    /// Port of the host that receives the telemetry
    #[arg(long, value_name = "PORT", default_value_t = TELEMETRY_PORT)]
    pub(crate) telemetry_port: u16,
    /// Host that receives heartbeats before it has sent a packet: the published client waits for the first one
    /// [default: the sender of the first packet]
    #[arg(long, value_name = "IP")]
    pub(crate) host: Option<IpAddr>,
    /// Allow an address that other machines can reach
    #[arg(long)]
    pub(crate) public: bool,
    /// Arm when a host's heartbeat arrives [default: another program arms]
    #[arg(long)]
    pub(crate) arm: bool,
    /// Steering channel, reported as `AINSTEER` in volts
    #[arg(long, default_value = "dhb0")]
    pub(crate) steer: ChannelId,
    /// Volts reported at steering position 0, V (default: the actuator of the OSMC evaluation, whose full range is 5 V)
    #[arg(long, default_value_t = 0.1417, value_name = "V", allow_negative_numbers = true)]
    pub(crate) volts_at_zero: f64,
    /// Volts per metre of steering travel, or per radian
    #[arg(long, default_value_t = 46.92, value_name = "V", allow_negative_numbers = true)]
    pub(crate) volts_per_unit: f64,
    /// End after this time [default: on Ctrl-C]
    #[arg(long = "for", value_name = "SECONDS")]
    pub(crate) seconds: Option<f64>,
}

/// Address of the socket: the first line of `--json`.
#[derive(Serialize)]
struct Listening {
    udp: SocketAddr,
}

/// Polling period of received packets, s.
const LOOK_EVERY_S: f64 = 0.002;
/// Period of the heartbeats to the host, s: three of them in the time after which a host gives up.
const HEARTBEAT_S: f64 = 0.2;
/// Period of the telemetry packets, s, and of the board's telemetry, ms.
const TELEMETRY_S: f64 = 0.05;
const TELEMETRY_MS: u16 = 50;

pub(crate) fn run(args: &Args, Bridge::LegacyUdp(bridge): &Bridge) -> anyhow::Result<bool> {
    if !bridge.listen.ip().is_loopback() && !bridge.public {
        bail!(
            "{} can be reached from other machines, and this protocol has no authentication: add --public if all users \
             there may move the robot",
            bridge.listen
        );
    }
    let socket = UdpSocket::bind(bridge.listen).with_context(|| format!("cannot listen at {}", bridge.listen))?;
    socket.set_nonblocking(true).context("cannot listen")?;
    let udp = socket.local_addr().context("cannot listen")?;
    if args.json {
        output::json(&Listening { udp })?;
    } else {
        output::line(format_args!("{} answers at {udp}", args.board.described()))?;
    }
    let (counts, _) = session::run(args, Pace::RealTime(1.0), async |session| {
        let mut hosts = Hosts {
            session,
            bridge,
            socket: &socket,
            host: bridge.host,
            heard_s: f64::NEG_INFINITY,
            armed: false,
            sequences: Vec::new(),
            waiting: Vec::new(),
            said: HashSet::new(),
            number: 0,
            counts: Counts::default(),
        };
        hosts.serve().await?;
        Ok(hosts.counts)
    })?;
    eprintln!(
        "r4: {} packets; {} damaged, {} late or duplicate, {} from other hosts, {} commands failed",
        counts.packets, counts.damaged, counts.late, counts.strangers, counts.refused
    );
    Ok(true)
}

/// Packet counters since the start.
#[derive(Clone, Copy, Debug, Default)]
struct Counts {
    packets: u64,
    damaged: u64,
    late: u64,
    strangers: u64,
    refused: u64,
}

/// Most addresses whose packet numbers are tracked: the published host sends from two ports.
const SEQUENCES: usize = 8;

/// Bridge between a board's session and the hosts on the network.
struct Hosts<'s> {
    session: &'s Session<'s>,
    bridge: &'s LegacyUdp,
    socket: &'s UdpSocket,
    /// Host that is served: the sender of the last good packet. While its heartbeats arrive, other hosts are ignored.
    host: Option<IpAddr>,
    /// Time of the host's last heartbeat, s, on the session's clock.
    heard_s: f64,
    /// True after this bridge has armed the board, until it disarms it or the board trips.
    armed: bool,
    sequences: Vec<(SocketAddr, Sequence)>,
    /// Commands received before the host's first heartbeat: the newest of each channel, with its time, s.
    waiting: Vec<(ChannelId, f32, f64)>,
    /// Reasons for failed commands that were already reported to the user.
    said: HashSet<(ChannelId, Why)>,
    number: u32,
    counts: Counts,
}

/// Reason why a command was not executed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Why {
    Refused(Discriminant<Refusal>),
    TimedOut,
    Bad,
    Late,
}

impl Hosts<'_> {
    async fn serve(&mut self) -> anyhow::Result<()> {
        let board = self.session.board;
        let steer = board.channel(self.bridge.steer)?.clone();
        let drives: Vec<ChannelId> = board
            .channels()
            .iter()
            .filter(|channel| channel.id.kind == ChannelKind::Osmc)
            .map(|channel| channel.id)
            .collect();
        let mut telemetry = board.telemetry();
        for channel in drives.iter().chain([&steer.id]) {
            board.subscribe(*channel, TELEMETRY_MS).await?;
        }
        let (mut volts, mut duties) = (None, Vec::new());
        let begin_s = board.now_s();
        let (mut heartbeat_s, mut telemetry_s) = (begin_s, begin_s);
        while self.bridge.seconds.is_none_or(|seconds| board.now_s() < begin_s + seconds) {
            self.receive().await?;
            self.watch_link().await?;
            while let Some(frame) = telemetry.try_next() {
                for sample in &frame.samples {
                    let Sample::Motor { channel, position, duty, .. } = *sample else { continue };
                    if channel == steer.id && steer.unit != Unit::Duty {
                        let position = f64::from(position) * f64::from(steer.resolution);
                        volts = Some(self.bridge.volts_at_zero + self.bridge.volts_per_unit * position);
                    }
                    if drives.contains(&channel) {
                        // Keep the newest duty of each channel only.
                        duties.retain(|(known, _)| *known != channel);
                        duties.push((channel, duty));
                    }
                }
            }
            let now_s = board.now_s();
            if now_s >= heartbeat_s {
                // From the due time rather than from now, which would drift.
                heartbeat_s += HEARTBEAT_S;
                self.send(Packet::default().with("H", "R4-ROS2"));
            }
            // Send telemetry only after the board has reported both: the published client reads every field of every
            // packet.
            let is_known = !duties.is_empty() && (volts.is_some() || steer.unit == Unit::Duty);
            if now_s >= telemetry_s && is_known {
                telemetry_s += TELEMETRY_S;
                let mut packet = Packet::default();
                if let Some(volts) = volts {
                    packet = packet.with("AINSTEER", format_args!("{volts:.4}"));
                }
                for (channel, duty) in &duties {
                    packet = packet.with(&format!("OSMC{}", channel.index + 1), format_args!("{duty:.4}"));
                }
                self.send(packet);
            }
            board.sleep_s(LOOK_EVERY_S).await;
        }
        Ok(())
    }

    /// Sends a packet to the host, if one is known.
    fn send(&mut self, packet: Packet) {
        let Some(host) = self.host else { return };
        self.number = self.number.wrapping_add(1);
        let time_ms = (self.session.board.now_s() * 1e3) as u64;
        let text = packet.with("PNum", self.number).with("T", time_ms).to_string();
        // A packet to an absent host is lost, as on any network.
        let _ = self.socket.send_to(text.as_bytes(), (host, self.bridge.telemetry_port));
    }

    /// Processes all received packets.
    async fn receive(&mut self) -> anyhow::Result<()> {
        let mut buffer = [0; 1024];
        loop {
            let (len, from) = match self.socket.recv_from(&mut buffer) {
                Ok(received) => received,
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => return Ok(()),
                // ICMP reported that an earlier packet reached no socket.
                Err(error) if error.kind() == io::ErrorKind::ConnectionRefused => continue,
                Err(error) => return Err(error).context("cannot receive"),
            };
            self.counts.packets += 1;
            let Ok(packet) = Packet::parse(&buffer[..len]) else {
                self.counts.damaged += 1;
                continue;
            };
            if packet.stops() {
                // Accept a stop from any host and with any number: a redundant stop does no harm.
                self.stop().await?;
            }
            let now_s = self.session.board.now_s();
            if self.is_silent() {
                self.host = Some(from.ip());
            }
            if self.host != Some(from.ip()) {
                self.counts.strangers += 1;
                continue;
            }
            match self.sequence(from).place(packet.number(), now_s) {
                Order::New => {}
                Order::Twice => {
                    self.counts.late += 1;
                    continue;
                }
                Order::Late => {
                    self.counts.late += 1;
                    self.hold_late(&packet).await?;
                    continue;
                }
            }
            if packet.is_heartbeat() {
                self.heard().await?;
            }
            for command in packet.commands() {
                self.command(command).await?;
            }
        }
    }

    /// Sequence of packet numbers from one address.
    fn sequence(&mut self, from: SocketAddr) -> &mut Sequence {
        let place = self.sequences.iter().position(|(known, _)| *known == from).unwrap_or_else(|| {
            if self.sequences.len() == SEQUENCES {
                self.sequences.remove(0);
            }
            self.sequences.push((from, Sequence::default()));
            self.sequences.len() - 1
        });
        &mut self.sequences[place].1
    }

    /// True when no heartbeat of a host arrived within the time-out.
    fn is_silent(&self) -> bool {
        self.session.board.now_s() > self.heard_s + LOST_AFTER_S
    }

    async fn heard(&mut self) -> anyhow::Result<()> {
        let board = self.session.board;
        self.heard_s = board.now_s();
        self.session.notify_of_heat();
        let state = board.safety().0;
        if state == SafetyState::Tripped {
            self.armed = false;
        } else if self.bridge.arm && !(self.armed && state == SafetyState::Armed) {
            let again = mem::replace(&mut self.armed, true);
            match board.arm().await {
                // The last reported state may be older than the arming.
                Ok(()) if again => {}
                Ok(()) => eprintln!("r4: heartbeat of a host: armed"),
                // The board's refusal names the reason; the next heartbeat tries again.
                Err(Error::Refused(refusal)) => {
                    self.armed = false;
                    eprintln!("r4: cannot arm: {refusal}");
                }
                Err(error) => return Err(error.into()),
            }
        }
        for (channel, duty, at_s) in mem::take(&mut self.waiting) {
            if board.now_s() < at_s + LOST_AFTER_S {
                self.drive(channel, duty).await?;
            } else {
                self.counts.refused += 1;
            }
        }
        Ok(())
    }

    /// Executes a command, or stops its channel where that fails.
    async fn command(&mut self, command: Command) -> anyhow::Result<()> {
        match command {
            // `receive` handles a stop before the other commands of its packet.
            Command::Stop => Ok(()),
            Command::Unknown => {
                self.counts.refused += 1;
                Ok(())
            }
            Command::Drive { bridge, channel, duty } => {
                let channel = channel_of(bridge, channel);
                // Nothing moves without a host's heartbeat. The published nodes send each command once, possibly before
                // their first heartbeat, which answers ours: keep it until then.
                if self.is_silent() {
                    self.counts.refused += self.waiting.extract_if(.., |(other, ..)| *other == channel).count() as u64;
                    self.waiting.push((channel, duty, self.session.board.now_s()));
                    return Ok(());
                }
                self.drive(channel, duty).await
            }
            Command::Bad { bridge, channel } => {
                self.counts.refused += 1;
                for channel in self.meant(bridge, channel) {
                    self.hold(channel, Why::Bad, "its command does not conform to the protocol").await?;
                }
                Ok(())
            }
        }
    }

    /// Sends a duty to a channel, limited to the channel's range: 4095 means full duty.
    async fn drive(&mut self, channel: ChannelId, duty: f32) -> anyhow::Result<()> {
        let board = self.session.board;
        let range = board.channel(channel).ok().and_then(|info| info.mode(Mode::Duty)).map(|info| info.range);
        let value = range.map_or(duty, |range| duty.clamp(range.min, range.max));
        match board.set(channel, Setpoint { mode: Mode::Duty, value }).await {
            Ok(()) => Ok(()),
            Err(Error::Refused(refusal)) => {
                self.counts.refused += 1;
                // The board itself stops a channel whose set point it refuses.
                self.say(channel, Why::Refused(mem::discriminant(&refusal)), &refusal.to_string());
                Ok(())
            }
            Err(error @ Error::TimedOut { .. }) => {
                self.counts.refused += 1;
                // The set point may not have arrived; the channel would then follow the previous one.
                self.hold(channel, Why::TimedOut, &error.to_string()).await
            }
            Err(error) => Err(error.into()),
        }
    }

    /// Stops the channels that a late packet commands: its host may have restarted its numbers.
    async fn hold_late(&mut self, packet: &Packet) -> anyhow::Result<()> {
        for command in packet.commands() {
            let (bridge, channel) = match command {
                Command::Drive { bridge, channel, .. } => (bridge, Some(channel)),
                Command::Bad { bridge, channel } => (bridge, channel),
                Command::Stop | Command::Unknown => continue,
            };
            for channel in self.meant(bridge, channel) {
                self.hold(channel, Why::Late, "its command came after one with a higher number").await?;
            }
        }
        Ok(())
    }

    /// Returns the channel with this number, or all channels of its kind where the number is unreadable.
    fn meant(&self, bridge: legacy::Bridge, channel: Option<u8>) -> Vec<ChannelId> {
        let kind = channel_of(bridge, 0).kind;
        let channels = self.session.board.channels().iter().map(|info| info.id).filter(|id| id.kind == kind);
        channels.filter(|id| channel.is_none_or(|channel| id.index == channel)).collect()
    }

    /// Stops a channel whose command failed: its previous set point is not what the host wants.
    async fn hold(&mut self, channel: ChannelId, why: Why, reason: &str) -> anyhow::Result<()> {
        self.say(channel, why, reason);
        self.waiting.retain(|(other, ..)| *other != channel);
        let board = self.session.board;
        match board.set(channel, Setpoint::NONE).await {
            // A disarmed board refuses the set point; nothing is driven then.
            Ok(()) | Err(Error::Refused(_)) => Ok(()),
            Err(Error::TimedOut { .. }) => {
                self.armed = false;
                board.disarm().await?;
                eprintln!("r4: the board does not answer: disarmed");
                Ok(())
            }
            Err(error) => Err(error.into()),
        }
    }

    fn say(&mut self, channel: ChannelId, why: Why, reason: &str) {
        if self.said.insert((channel, why)) {
            eprintln!("r4: {channel} is stopped: {reason} (reported once)");
        }
    }

    async fn stop(&mut self) -> anyhow::Result<()> {
        let board = self.session.board;
        board.stop().await?;
        self.waiting.clear();
        if mem::take(&mut self.armed) || board.safety().0 != SafetyState::Tripped {
            eprintln!("r4: the host has stopped the board: end this bridge, then clear the trip with `r4 clear`");
        }
        Ok(())
    }

    /// Disarms the board when the host falls silent.
    async fn watch_link(&mut self) -> anyhow::Result<()> {
        let board = self.session.board;
        if self.is_silent() && mem::take(&mut self.armed) {
            let silent_s = board.now_s() - self.heard_s;
            board.disarm().await?;
            eprintln!("r4: no heartbeat from the host for {silent_s:.1} s: disarmed");
        }
        Ok(())
    }
}

/// Channel of a bridge's motor by its kind and number.
fn channel_of(bridge: legacy::Bridge, channel: u8) -> ChannelId {
    let kind = match bridge {
        legacy::Bridge::Osmc => ChannelKind::Osmc,
        legacy::Bridge::Dhb => ChannelKind::Dhb,
    };
    ChannelId::new(kind, channel)
}
