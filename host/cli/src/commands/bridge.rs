//! `r4 bridge legacy-udp`: a board for hosts that speak the R4 network protocol of before.

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

/// What is bridged.
#[derive(Clone, Debug, clap::Subcommand)]
pub(crate) enum Bridge {
    /// The text protocol over UDP that OpenPodCar's published ROS 2 nodes speak: it knows who is damaged, not who is a
    /// stranger, so it is served to this machine alone unless --public is given
    LegacyUdp(LegacyUdp),
}

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct LegacyUdp {
    /// Where commands come in
    #[arg(long, value_name = "ADDRESS", default_value_t = SocketAddr::from(([127, 0, 0, 1], BOARD_PORT)))]
    pub(crate) listen: SocketAddr,
    /// The port of the host to which telemetry goes
    #[arg(long, value_name = "PORT", default_value_t = TELEMETRY_PORT)]
    pub(crate) telemetry_port: u16,
    /// The host to which heartbeats go before it has sent anything: the published client waits for the first one. Without it
    /// the first packet tells
    #[arg(long, value_name = "IP")]
    pub(crate) host: Option<IpAddr>,
    /// Listen on an address that other machines reach
    #[arg(long)]
    pub(crate) public: bool,
    /// Arm when a host's heartbeat is heard; otherwise somebody else has to
    #[arg(long)]
    pub(crate) arm: bool,
    /// The channel that steers, told as `AINSTEER` in volts
    #[arg(long, default_value = "dhb0")]
    pub(crate) steer: ChannelId,
    /// Volts that are told where the steering is at 0 (the actuator of the OSMC evaluation, 5 V in all)
    #[arg(long, default_value_t = 0.1417, value_name = "V", allow_negative_numbers = true)]
    pub(crate) volts_at_zero: f64,
    /// Volts a metre of the steering, or a radian
    #[arg(long, default_value_t = 46.92, value_name = "V", allow_negative_numbers = true)]
    pub(crate) volts_per_unit: f64,
    /// End after this long
    #[arg(long = "for", value_name = "SECONDS")]
    pub(crate) seconds: Option<f64>,
}

/// Where it listens, on the first line of `--json`.
#[derive(Serialize)]
struct Listening {
    udp: SocketAddr,
}

/// How often packets are looked for, s.
const LOOK_EVERY_S: f64 = 0.002;
/// The board's heartbeats: three in the time after which a host gives up, s.
const HEARTBEAT_S: f64 = 0.2;
/// Telemetry, s and ms.
const TELEMETRY_S: f64 = 0.05;
const TELEMETRY_MS: u16 = 50;

pub(crate) fn run(args: &Args, Bridge::LegacyUdp(bridge): &Bridge) -> anyhow::Result<bool> {
    if !bridge.listen.ip().is_loopback() && !bridge.public {
        bail!(
            "{} can be reached from other machines, and this protocol asks nobody who they are: add --public if everybody \
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
        "r4: {} packets; {} damaged, {} late or twice, {} of other hosts, {} commands not carried out",
        counts.packets, counts.damaged, counts.late, counts.strangers, counts.refused
    );
    Ok(true)
}

/// Packets, since the start.
#[derive(Clone, Copy, Debug, Default)]
struct Counts {
    packets: u64,
    damaged: u64,
    late: u64,
    strangers: u64,
    refused: u64,
}

/// Addresses of a host whose packets are counted: the published one sends from two ports.
const SEQUENCES: usize = 8;

/// A board, as hosts see it.
struct Hosts<'s> {
    session: &'s Session<'s>,
    bridge: &'s LegacyUdp,
    socket: &'s UdpSocket,
    /// Who is answered: who sent the last good packet, and while there are heartbeats nobody else.
    host: Option<IpAddr>,
    /// The last heartbeat of a host, on the session's clock.
    heard_s: f64,
    /// Whether this bridge has armed the board and not disarmed it since.
    armed: bool,
    sequences: Vec<(SocketAddr, Sequence)>,
    /// Commands that came before the host's first heartbeat, the newest of each channel, and when.
    waiting: Vec<(ChannelId, f32, f64)>,
    /// Why commands were not carried out, as far as the user has been told.
    said: HashSet<(ChannelId, Why)>,
    number: u32,
    counts: Counts,
}

/// Why a command was not carried out.
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
                        duties.retain(|(known, _)| *known != channel);
                        duties.push((channel, duty));
                    }
                }
            }
            let now_s = board.now_s();
            if now_s >= heartbeat_s {
                heartbeat_s += HEARTBEAT_S;
                self.send(Packet::default().with("H", "R4-ROS2"));
            }
            // Not before the board has said what both do: the published client reads every field of every packet.
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

    /// To the host, if there is one.
    fn send(&mut self, packet: Packet) {
        let Some(host) = self.host else { return };
        self.number = self.number.wrapping_add(1);
        let time_ms = (self.session.board.now_s() * 1e3) as u64;
        let text = packet.with("PNum", self.number).with("T", time_ms).to_string();
        // A host that is not there loses it, as on any network.
        let _ = self.socket.send_to(text.as_bytes(), (host, self.bridge.telemetry_port));
    }

    /// Takes every packet that has come.
    async fn receive(&mut self) -> anyhow::Result<()> {
        let mut buffer = [0; 1024];
        loop {
            let (len, from) = match self.socket.recv_from(&mut buffer) {
                Ok(received) => received,
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => return Ok(()),
                // What was sent before has reached nobody.
                Err(error) if error.kind() == io::ErrorKind::ConnectionRefused => continue,
                Err(error) => return Err(error).context("cannot receive"),
            };
            self.counts.packets += 1;
            let Ok(packet) = Packet::parse(&buffer[..len]) else {
                self.counts.damaged += 1;
                continue;
            };
            if packet.stops() {
                // From whoever, whatever its number: a stop too many does no harm.
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

    /// Numbers of the packets from one address.
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

    /// No heartbeat of a host has come for too long.
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
                // The state that was heard last may be older than the arming.
                Ok(()) if again => {}
                Ok(()) => eprintln!("r4: a host is there: armed"),
                // It says so itself, and is asked again with the next heartbeat.
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

    /// Carries a command out, or stops what it was for.
    async fn command(&mut self, command: Command) -> anyhow::Result<()> {
        match command {
            // Done before all others of its packet.
            Command::Stop => Ok(()),
            Command::Unknown => {
                self.counts.refused += 1;
                Ok(())
            }
            Command::Drive { bridge, channel, duty } => {
                let channel = channel_of(bridge, channel);
                // Without a host's heartbeat nothing moves. The published nodes say everything once, and so perhaps before
                // their first heartbeat, which answers ours.
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
                    self.hold(channel, Why::Bad, "its command is none of this protocol").await?;
                }
                Ok(())
            }
        }
    }

    /// Commands a channel. What it cannot take of a duty it is not given: 4095 means as much as there is.
    async fn drive(&mut self, channel: ChannelId, duty: f32) -> anyhow::Result<()> {
        let board = self.session.board;
        let range = board.channel(channel).ok().and_then(|info| info.mode(Mode::Duty)).map(|info| info.range);
        let value = range.map_or(duty, |range| duty.clamp(range.min, range.max));
        match board.set(channel, Setpoint { mode: Mode::Duty, value }).await {
            Ok(()) => Ok(()),
            Err(Error::Refused(refusal)) => {
                self.counts.refused += 1;
                // The board has stopped the channel itself.
                self.say(channel, Why::Refused(mem::discriminant(&refusal)), &refusal.to_string());
                Ok(())
            }
            Err(error @ Error::TimedOut { .. }) => {
                self.counts.refused += 1;
                // It may not have come, and then the channel follows the command before.
                self.hold(channel, Why::TimedOut, &error.to_string()).await
            }
            Err(error) => Err(error.into()),
        }
    }

    /// Stops the channels for which `packet`, which is late, has commands: it may be a host's that began to count anew.
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

    /// The channel with this number, or all of its kind where the number cannot be read.
    fn meant(&self, bridge: legacy::Bridge, channel: Option<u8>) -> Vec<ChannelId> {
        let kind = channel_of(bridge, 0).kind;
        let channels = self.session.board.channels().iter().map(|info| info.id).filter(|id| id.kind == kind);
        channels.filter(|id| channel.is_none_or(|channel| id.index == channel)).collect()
    }

    /// Stops a channel whose command is not carried out: the host wants something else than what it did.
    async fn hold(&mut self, channel: ChannelId, why: Why, reason: &str) -> anyhow::Result<()> {
        self.say(channel, why, reason);
        self.waiting.retain(|(other, ..)| *other != channel);
        let board = self.session.board;
        match board.set(channel, Setpoint::NONE).await {
            // Refused where the board is not armed, and then nothing is driven.
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
            eprintln!("r4: {channel} is stopped: {reason} (said once)");
        }
    }

    async fn stop(&mut self) -> anyhow::Result<()> {
        let board = self.session.board;
        board.stop().await?;
        self.waiting.clear();
        if mem::take(&mut self.armed) || board.safety().0 != SafetyState::Tripped {
            eprintln!("r4: the host has stopped the board: end this bridge, and `r4 clear` leaves the stop behind");
        }
        Ok(())
    }

    /// A host that is silent drives nothing any more.
    async fn watch_link(&mut self) -> anyhow::Result<()> {
        let board = self.session.board;
        if self.is_silent() && mem::take(&mut self.armed) {
            let silent_s = board.now_s() - self.heard_s;
            board.disarm().await?;
            eprintln!("r4: no heartbeat of the host for {silent_s:.1} s: disarmed");
        }
        Ok(())
    }
}

/// A bridge's channel.
fn channel_of(bridge: legacy::Bridge, channel: u8) -> ChannelId {
    let kind = match bridge {
        legacy::Bridge::Osmc => ChannelKind::Osmc,
        legacy::Bridge::Dhb => ChannelKind::Dhb,
    };
    ChannelId::new(kind, channel)
}
