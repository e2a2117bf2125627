//! Text protocol of the previous R4 firmware, over UDP, as the published OpenPodCar ROS 2 nodes use it.
//!
//! A packet is `key:value;` fields, then `^0x<crc>^`: the CRC-32 of zlib over everything up to and including the first
//! `^`, in hex as Python's `hex()` writes it. (Rak-r/OpenPodCar_V2, R4 nodes.) It detects damaged packets, not foreign
//! ones.
//!
//! Messages of the published nodes and their source ports (`R4-Websockets-Client.py`, `R4_Receiver.py`,
//! `Podcar_Steer_node.py`, `Podcar_motor_driver.py`):
//!
//! | message | sent from port | when |
//! | --- | --- | --- |
//! | `H:ROS2-R4;T:<ms>;` | 2390 | in answer to each heartbeat of the board, with its `T`; never before one |
//! | `O:<pwm>,<dir>,1;PNum:<n>;T:<ms>;` | 4000 | when it changes, at most ten times a second |
//! | `D:<0 or 4095>,<dir>,1;PNum:<n>;T:<ms>;` | 4000 | when it changes, at most ten times a second |
//! | `S:Stop;PNum:<n>;T:<ms>;` | 4000 | by hand |
//!
//! The board sends `H:R4-ROS2;` and telemetry (`AINSTEER:<volts>;`, `OSMC1:<share>;`) to port 2390, both with `PNum`
//! and `T`; the client accepts 200 bytes per packet.

use std::fmt;

use crc::{CRC_32_ISO_HDLC, Crc};

const CRC32: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);

/// Longest packet that the old firmware accepts, bytes.
pub const LONGEST: usize = 200;
/// UDP port on which the board listens for commands.
pub const BOARD_PORT: u16 = 2018;
/// UDP port from which hosts send heartbeats, and on which they listen for telemetry; commands go to [`BOARD_PORT`].
pub const TELEMETRY_PORT: u16 = 2390;
/// Time without a heartbeat after which a link counts as lost, s.
pub const LOST_AFTER_S: f64 = 0.7;
/// PWM value that means full supply voltage.
const FULL: i32 = 4095;
/// Largest step of a packet number above the newest that counts as the next; a larger one may be a stray packet's.
const AHEAD: u32 = 16;
/// Largest step below the newest number that counts as late; below that, the sender has restarted its count.
const LATE: u32 = 100;

/// Fields of a packet in their order.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Packet(Vec<(String, String)>);

/// Error of a packet that cannot be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum BadPacket {
    /// The packet has more than [`LONGEST`] bytes.
    #[error("more than {LONGEST} bytes")]
    TooLong,
    /// The packet is not text, or does not end with `^0x<crc>^`.
    #[error("no `^0x<crc>^` at its end")]
    Form,
    /// The checksum does not match.
    #[error("its checksum is wrong")]
    Checksum,
    /// A field is not of the form `key:value;`.
    #[error("a part of it is not `key:value;`")]
    Field,
}

impl Packet {
    /// Parses a packet and verifies its checksum.
    ///
    /// # Errors
    /// [`BadPacket`] names the reason.
    pub fn parse(bytes: &[u8]) -> Result<Self, BadPacket> {
        if bytes.len() > LONGEST {
            return Err(BadPacket::TooLong);
        }
        let text = std::str::from_utf8(bytes).map_err(|_| BadPacket::Form)?.trim_end_matches(['\0', '\r', '\n']);
        let (fields, end) = text.split_once('^').ok_or(BadPacket::Form)?;
        let sum = end.strip_suffix('^').and_then(|sum| sum.strip_prefix("0x")).ok_or(BadPacket::Form)?;
        if sum.is_empty() || !sum.bytes().all(|digit| digit.is_ascii_hexdigit()) {
            return Err(BadPacket::Form);
        }
        let sum = u32::from_str_radix(sum, 16).map_err(|_| BadPacket::Form)?;
        // The sum includes the first `^`, the byte behind the fields.
        if sum != CRC32.checksum(&bytes[..=fields.len()]) {
            return Err(BadPacket::Checksum);
        }
        let field = |part: &str| {
            let (key, value) = part.split_once(':')?;
            Some((key.trim().to_owned(), value.trim().to_owned()))
        };
        let parts = fields.split(';').filter(|part| !part.trim().is_empty());
        parts.map(field).collect::<Option<_>>().map(Self).ok_or(BadPacket::Field)
    }

    /// Appends a field and returns the packet.
    #[must_use]
    pub fn with(mut self, key: &str, value: impl fmt::Display) -> Self {
        self.0.push((key.to_owned(), value.to_string()));
        self
    }

    /// Returns the value of the first field with this key.
    #[must_use]
    pub fn get(&self, key: &str) -> Option<&str> {
        self.0.iter().find(|(name, _)| name == key).map(|(_, value)| value.as_str())
    }

    /// Returns the packet number, if present.
    #[must_use]
    pub fn number(&self) -> Option<u32> {
        self.get("PNum")?.parse().ok()
    }

    /// Returns true for the host's heartbeat.
    #[must_use]
    pub fn is_heartbeat(&self) -> bool {
        self.get("H") == Some("ROS2-R4")
    }

    /// Returns all commands in the packet, in order.
    pub fn commands(&self) -> impl Iterator<Item = Command> {
        self.0.iter().filter_map(|(key, value)| match key.as_str() {
            "O" => Some(drive(Bridge::Osmc, value)),
            "D" => Some(drive(Bridge::Dhb, value)),
            "S" if value == "Stop" => Some(Command::Stop),
            "S" => Some(Command::Unknown),
            _ => None,
        })
    }

    /// Returns true if the packet contains a stop command.
    #[must_use]
    pub fn stops(&self) -> bool {
        self.commands().any(|command| command == Command::Stop)
    }
}

impl fmt::Display for Packet {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut text: String = self.0.iter().map(|(key, value)| format!("{key}:{value};")).collect();
        text.push('^');
        write!(f, "{text}{:#x}^", CRC32.checksum(text.as_bytes()))
    }
}

/// Type of motor bridge that a command addresses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bridge {
    /// OSMC bridge, key `O`.
    Osmc,
    /// Dual H-bridge, key `D`.
    Dhb,
}

/// Command of a host. Channels count from 0, as elsewhere in this crate; in packets they count from 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Command {
    /// Drives a motor with a duty.
    Drive {
        /// Type of its bridge.
        bridge: Bridge,
        /// Channel number of the bridge, from 0.
        channel: u8,
        /// Duty as a share of the supply voltage, -1 to 1.
        duty: f32,
    },
    /// Motor command that violates the protocol, such as a PWM value above 4095.
    Bad {
        /// Type of its bridge.
        bridge: Bridge,
        /// Channel number of the bridge, if readable.
        channel: Option<u8>,
    },
    /// Stops all motors of the board.
    Stop,
    /// Unknown value of the `S` key.
    Unknown,
}

/// Parses `<pwm 0-4095>,<dir 0|1>,<channel>`; direction 0 is forwards.
fn drive(bridge: Bridge, value: &str) -> Command {
    let numbers: Vec<Option<i32>> = value.split(',').map(|number| number.trim().parse().ok()).collect();
    let channel = match numbers[..] {
        [_, _, Some(channel @ 1..=16)] => Some(channel as u8 - 1),
        _ => None,
    };
    match (&numbers[..], channel) {
        ([Some(pwm @ 0..=FULL), Some(direction @ (0 | 1)), _], Some(channel)) => {
            let duty = *pwm as f32 / FULL as f32;
            Command::Drive { bridge, channel, duty: if *direction == 0 { duty } else { -duty } }
        }
        _ => Command::Bad { bridge, channel },
    }
}

/// Order of a packet relative to the earlier ones.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// Newer than all earlier packets.
    New,
    /// Repetition of the newest packet.
    Twice,
    /// Older than the newest packet.
    Late,
}

/// Detects late and repeated packets by their increasing numbers; one instance per sender address.
///
/// A packet far ahead of the others is new but does not move the count; only its successors do, so that one stray
/// packet does not block a sender. After [`LOST_AFTER_S`] without a packet any number is new: no packet is on its way
/// for so long, but a restarted host may count from anywhere.
#[derive(Clone, Copy, Debug, Default)]
pub struct Sequence {
    /// Newest number and its arrival time, s.
    newest: Option<(u32, f64)>,
    /// Number of the last packet far from the newest.
    far: Option<u32>,
}

impl Sequence {
    /// Returns the order of the packet with `number` that arrives at `now_s`. A packet without a number is new.
    pub fn place(&mut self, number: Option<u32>, now_s: f64) -> Order {
        let Some(number) = number else { return Order::New };
        let after = |earlier: u32| (1..=AHEAD).contains(&number.wrapping_sub(earlier));
        let newest = self.newest.filter(|(_, at_s)| now_s - at_s < LOST_AFTER_S).map(|(newest, _)| newest);
        let order = match newest {
            Some(newest) if newest == number => Order::Twice,
            Some(newest) if (1..LATE).contains(&newest.wrapping_sub(number)) => Order::Late,
            Some(newest) if !after(newest) && !self.far.is_some_and(after) => {
                // Far from the newest: only a successor of this packet will confirm its sender's count.
                let twice = self.far.replace(number) == Some(number);
                return if twice { Order::Twice } else { Order::New };
            }
            _ => Order::New,
        };
        if order == Order::New {
            *self = Self { newest: Some((number, now_s)), far: None };
        }
        order
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn packets_are_as_the_nodes_write_them() {
        // Checksums computed with Python: hex(zlib.crc32(b"...^")).
        for (text, sum) in [("H:ROS2-R4;T:1234;", "0xffc9f582"), ("O:2048,0,1;PNum:7;", "0x98cfb6d9")] {
            let whole = format!("{text}^{sum}^");
            let packet = Packet::parse(whole.as_bytes()).unwrap_or_else(|why| panic!("{text}: {why}"));
            assert_eq!(packet.to_string(), whole);
        }
        let heartbeat = Packet::default().with("H", "ROS2-R4").with("T", 1234);
        assert!(heartbeat.is_heartbeat() && heartbeat.get("T") == Some("1234"));
        for other in [Packet::default(), Packet::default().with("H", "R4-ROS2"), Packet::default().with("T", "ROS2-R4")]
        {
            assert!(!other.is_heartbeat(), "{other}");
        }
    }

    #[test]
    fn what_is_no_packet_is_told_apart() {
        let of_length = |len: usize| {
            let packet = |fill: usize| Packet::default().with("A", "x".repeat(fill)).to_string();
            // The checksum has up to eight digits, so the fill is searched for the wanted length.
            (1..LONGEST).map(packet).find(|text| text.len() == len).expect("one of this length")
        };
        for len in [LONGEST - 1, LONGEST] {
            assert!(Packet::parse(of_length(len).as_bytes()).is_ok(), "{len} bytes");
        }
        assert_eq!(Packet::parse(of_length(LONGEST + 1).as_bytes()), Err(BadPacket::TooLong));
        let good = Packet::default().with("S", "Stop").to_string();
        for (bad, why) in [
            // `from_str_radix` accepts a sign, but a checksum has none.
            (good.replace("0x", "0x+"), BadPacket::Form),
            (good.replace("0x", ""), BadPacket::Form),
            ("S:Stop;^0x^".into(), BadPacket::Form),
            ("S:Stop;".into(), BadPacket::Form),
            (good.replace("Stop", "Stay"), BadPacket::Checksum),
            (format!("Stop;^{:#x}^", CRC32.checksum(b"Stop;^")), BadPacket::Field),
        ] {
            assert_eq!(Packet::parse(bad.as_bytes()), Err(why), "{bad}");
        }
    }

    #[test]
    fn commands_are_shares_of_the_supply() {
        let commands = |text: &str| {
            let mut packet = Packet::default();
            for part in text.split(';') {
                let (key, value) = part.split_once(':').expect("a field");
                packet = packet.with(key, value);
            }
            packet.commands().collect::<Vec<_>>()
        };
        let drive = |bridge, channel, duty| Command::Drive { bridge, channel, duty };
        assert_eq!(commands("O:4095,0,1;PNum:3"), [drive(Bridge::Osmc, 0, 1.0)]);
        assert_eq!(commands("D:0,1,2;S:Stop"), [drive(Bridge::Dhb, 1, -0.0), Command::Stop]);
        assert_eq!(commands("D:4095,1,16"), [drive(Bridge::Dhb, 15, -1.0)]);
        assert_eq!(commands("S:Go"), [Command::Unknown]);
        let stop = Packet::default().with("O", "4095,0,1").with("S", "Stop");
        assert!(stop.stops() && !Packet::default().with("O", "0,0,1").with("S", "Go").stops());
        for (bad, channel) in [
            ("4096,0,1", Some(0)),
            ("-1,0,1", Some(0)),
            ("1,2,16", Some(15)),
            ("a,0,1", Some(0)),
            ("2000.0,0,1", Some(0)),
            ("99999999999,0,1", Some(0)),
            ("1,0,0", None),
            ("1,0,17", None),
            ("1,0", None),
            ("1,0,1,1", None),
            ("", None),
        ] {
            for (key, bridge) in [("O", Bridge::Osmc), ("D", Bridge::Dhb)] {
                assert_eq!(commands(&format!("{key}:{bad}")), [Command::Bad { bridge, channel }], "{bad}");
            }
        }
    }

    /// Returns the orders of packets with these numbers that arrive 10 ms apart.
    fn places(numbers: &[u32]) -> String {
        let mut sequence = Sequence::default();
        let place = |(at, number): (u32, &u32)| match sequence.place(Some(*number), f64::from(at) * 0.01) {
            Order::New => 'n',
            Order::Twice => 't',
            Order::Late => 'l',
        };
        (0..).zip(numbers).map(place).collect()
    }

    #[test]
    fn late_packets_are_told_from_a_host_that_began_anew() {
        assert_eq!(places(&[5, 6, 6, 5, 7]), "nntln");
        assert_eq!(places(&[500, 501, 2, 3, 4, 3]), "nnnnnl", "its counter is far below");
        assert_eq!(places(&[u32::MAX, 0, 1, u32::MAX]), "nnnl", "it wraps");
        // The number is only a little below, but the network has been quiet long enough for a restart.
        let mut sequence = Sequence::default();
        assert_eq!(sequence.place(Some(50), 0.0), Order::New);
        assert_eq!(sequence.place(Some(2), LOST_AFTER_S - 0.01), Order::Late);
        assert_eq!(sequence.place(Some(2), LOST_AFTER_S), Order::New);
        assert_eq!(sequence.place(None, LOST_AFTER_S), Order::New);
        // The same holds at any time of the clock.
        assert_eq!(sequence.place(Some(50), 100.0), Order::New);
        assert_eq!(sequence.place(Some(49), 100.0 + LOST_AFTER_S - 0.01), Order::Late);
    }

    #[test]
    fn a_stray_packet_far_ahead_silences_nobody() {
        assert_eq!(places(&[5, 6, 1000, 7, 8, 9]), "nnnnnn");
        assert_eq!(places(&[5, 6, 4_000_000_000, 4_000_000_000, 7, 8]), "nnntnn");
        // Numbers above those of a sender that was briefly silent and below those of late packets.
        for ahead in (AHEAD + 1..1000).chain(u32::MAX - 1000..=u32::MAX - LATE) {
            assert_eq!(places(&[5, 6, 6_u32.wrapping_add(ahead), 7, 8, 9]), "nnnnnn", "{ahead}");
        }
        for ahead in 1..=AHEAD {
            assert_eq!(places(&[5, 6, 6 + ahead, 7 + ahead, 6]), "nnnnl", "{ahead}");
        }
        // Two packets in sequence belong to a host.
        assert_eq!(places(&[5, 1000, 1001, 1000]), "nnnl");
    }

    proptest! {
        #[test]
        fn whatever_comes_is_no_panic_and_damage_is_seen(bytes: Vec<u8>, number: u32, at: prop::sample::Index, bit in 0..8) {
            let _ = Packet::parse(&bytes);
            let text = Packet::default().with("PNum", number).with("O", "100,1,2").to_string();
            prop_assert_eq!(Packet::parse(text.as_bytes()).map(|packet| packet.number()), Ok(Some(number)));
            let mut damaged = text.clone().into_bytes();
            let at = at.index(damaged.len());
            damaged[at] ^= 1_u8 << bit;
            // Damage that only changes the case of a hex digit is harmless.
            prop_assert!(Packet::parse(&damaged).is_err() || damaged.eq_ignore_ascii_case(text.as_bytes()));
        }
    }
}
