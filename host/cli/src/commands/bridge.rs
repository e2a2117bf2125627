//! `r4 bridge legacy-udp`: a board for hosts that speak the R4 network protocol of before.

use std::{
    io,
    net::{IpAddr, SocketAddr, UdpSocket},
};

use anyhow::{Context, bail};
use r4_driver::Error;
use r4_links::legacy::{BOARD_PORT, Command, LOST_AFTER_S, Packet, Sequence, TELEMETRY_PORT};
use r4_protocol::{ChannelId, ChannelKind, Mode, SafetyState, Sample, Setpoint, Unit};
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
            host: None,
            heard_s: f64::NEG_INFINITY,
            sequence: Sequence::default(),
            number: 0,
            counts: Counts::default(),
        };
        hosts.serve().await?;
        Ok(hosts.counts)
    })?;
    eprintln!(
        "r4: {} packets; {} damaged, {} late or twice, {} commands not carried out",
        counts.packets, counts.damaged, counts.late, counts.refused
    );
    Ok(true)
}

/// Packets, since the start.
#[derive(Clone, Copy, Debug, Default)]
struct Counts {
    packets: u64,
    damaged: u64,
    late: u64,
    refused: u64,
}

/// A board, as hosts see it.
struct Hosts<'s> {
    session: &'s Session<'s>,
    bridge: &'s LegacyUdp,
    socket: &'s UdpSocket,
    /// Who is answered: whoever sent a good packet last.
    host: Option<IpAddr>,
    /// The last heartbeat of a host, on the session's clock.
    heard_s: f64,
    sequence: Sequence,
    number: u32,
    counts: Counts,
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
            if now_s >= telemetry_s {
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
            if self.is_silent() {
                // Whoever speaks now may have begun to count anew.
                self.sequence = Sequence::default();
            }
            if !self.sequence.is_new(&packet) {
                self.counts.late += 1;
                continue;
            }
            self.host = Some(from.ip());
            if packet.is_heartbeat() {
                self.heard().await?;
            }
            for command in packet.commands() {
                if !self.command(command).await? {
                    self.counts.refused += 1;
                }
            }
        }
    }

    /// No heartbeat of a host has come for too long.
    fn is_silent(&self) -> bool {
        self.session.board.now_s() > self.heard_s + LOST_AFTER_S
    }

    async fn heard(&mut self) -> anyhow::Result<()> {
        let board = self.session.board;
        self.heard_s = board.now_s();
        if self.bridge.arm && board.safety().0 == SafetyState::Disarmed {
            match board.arm().await {
                Ok(()) => eprintln!("r4: a host is there: armed"),
                // It says so itself, and is asked again with the next heartbeat.
                Err(Error::Refused(refusal)) => eprintln!("r4: cannot arm: {refusal}"),
                Err(error) => return Err(error.into()),
            }
        }
        Ok(())
    }

    /// Whether it was carried out.
    async fn command(&self, command: Option<Command>) -> anyhow::Result<bool> {
        let board = self.session.board;
        let (kind, channel, duty) = match command {
            None => return Ok(false),
            Some(Command::Stop) => {
                board.stop().await?;
                eprintln!("r4: the host has stopped the board: `r4 clear` leaves that behind");
                return Ok(true);
            }
            Some(Command::Osmc { duty, channel }) => (ChannelKind::Osmc, channel, duty),
            Some(Command::Dhb { duty, channel }) => (ChannelKind::Dhb, channel, duty),
        };
        // Without a host's heartbeat nothing moves.
        if self.is_silent() {
            return Ok(false);
        }
        match board.set(ChannelId::new(kind, channel), Setpoint { mode: Mode::Duty, value: duty }).await {
            Ok(()) => Ok(true),
            Err(Error::Refused(_) | Error::TimedOut { .. }) => Ok(false),
            Err(error) => Err(error.into()),
        }
    }

    /// A host that is silent drives nothing any more.
    async fn watch_link(&self) -> anyhow::Result<()> {
        let board = self.session.board;
        let silent_s = board.now_s() - self.heard_s;
        if self.is_silent() && board.safety().0 == SafetyState::Armed && self.bridge.arm {
            board.disarm().await?;
            eprintln!("r4: no heartbeat of the host for {silent_s:.1} s: disarmed");
        }
        Ok(())
    }
}
