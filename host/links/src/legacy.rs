//! The text protocol of the R4 firmware before this one, over UDP, as the published OpenPodCar ROS 2 nodes speak it.
//!
//! A packet is `key:value;` fields, then `^0x<crc>^`: the CRC-32 of zlib over everything up to and including the first `^`, in
//! hex as Python's `hex()` writes it. (Rak-r/OpenPodCar_V2, R4 nodes.) It tells a damaged packet, not a stranger's.

use std::fmt;

use crc::{CRC_32_ISO_HDLC, Crc};

const CRC32: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);

/// Longest packet that the old firmware takes, bytes.
pub const LONGEST: usize = 200;
/// Where the board listens, from where hosts send, and where hosts listen for telemetry.
pub const BOARD_PORT: u16 = 2018;
/// See [`BOARD_PORT`].
pub const TELEMETRY_PORT: u16 = 2390;
/// A link without a heartbeat for so long is lost, s.
pub const LOST_AFTER_S: f64 = 0.7;
/// Greatest share of the supply in a command.
const FULL: i32 = 4095;
/// A packet's number may be this much lower than the last one's and is late then; lower still, and its sender began anew.
const LATE: u32 = 100;

/// What a packet says, field by field.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Packet(Vec<(String, String)>);

/// What is wrong with a packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum BadPacket {
    /// Longer than [`LONGEST`].
    #[error("more than {LONGEST} bytes")]
    TooLong,
    /// Bytes that are no text, or no `^0x<crc>^` at the end.
    #[error("no `^0x<crc>^` at its end")]
    Form,
    /// The sum is another one.
    #[error("its checksum is wrong")]
    Checksum,
    /// A part is not `key:value;`.
    #[error("a part of it is not `key:value;`")]
    Field,
}

impl Packet {
    /// Reads a packet.
    ///
    /// # Errors
    /// [`BadPacket`]
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

    /// With another field at the end.
    #[must_use]
    pub fn with(mut self, key: &str, value: impl fmt::Display) -> Self {
        self.0.push((key.to_owned(), value.to_string()));
        self
    }

    /// The value of the first field with this key.
    #[must_use]
    pub fn get(&self, key: &str) -> Option<&str> {
        self.0.iter().find(|(name, _)| name == key).map(|(_, value)| value.as_str())
    }

    /// Its number, if it has one.
    #[must_use]
    pub fn number(&self) -> Option<u32> {
        self.get("PNum")?.parse().ok()
    }

    /// It is the host's heartbeat.
    #[must_use]
    pub fn is_heartbeat(&self) -> bool {
        self.get("H") == Some("ROS2-R4")
    }

    /// Every command in it, in order; `None` for one that makes no sense.
    pub fn commands(&self) -> impl Iterator<Item = Option<Command>> {
        self.0.iter().filter_map(|(key, value)| match key.as_str() {
            "O" => Some(drive(value).map(|(duty, channel)| Command::Osmc { duty, channel })),
            "D" => Some(drive(value).map(|(duty, channel)| Command::Dhb { duty, channel })),
            "S" => Some((value == "Stop").then_some(Command::Stop)),
            _ => None,
        })
    }
}

impl fmt::Display for Packet {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut text: String = self.0.iter().map(|(key, value)| format!("{key}:{value};")).collect();
        text.push('^');
        write!(f, "{text}{:#x}^", CRC32.checksum(text.as_bytes()))
    }
}

/// What a host commands. Channels count from 0, as everywhere else here; in packets they count from 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Command {
    /// A share of the supply, -1 to 1, for an OSMC.
    Osmc {
        /// Share.
        duty: f32,
        /// Which.
        channel: u8,
    },
    /// The same for a DHB.
    Dhb {
        /// Share.
        duty: f32,
        /// Which.
        channel: u8,
    },
    /// Stop everything.
    Stop,
}

/// `<pwm 0-4095>,<dir 0|1>,<channel>`: direction 0 is forwards.
fn drive(value: &str) -> Option<(f32, u8)> {
    let numbers: Vec<i32> = value.split(',').map(|number| number.trim().parse().ok()).collect::<Option<_>>()?;
    let [pwm @ 0..=FULL, direction @ (0 | 1), channel @ 1..=16] = numbers[..] else { return None };
    let duty = pwm as f32 / FULL as f32;
    Some((if direction == 0 { duty } else { -duty }, channel as u8 - 1))
}

/// Tells packets that are late or come twice: their numbers rise.
#[derive(Clone, Copy, Debug, Default)]
pub struct Sequence(Option<u32>);

impl Sequence {
    /// Whether the packet is newer than all before it. One without a number counts as new.
    pub fn is_new(&mut self, packet: &Packet) -> bool {
        let Some(number) = packet.number() else { return true };
        let is_late = self.0.is_some_and(|last| number <= last && last - number < LATE);
        if !is_late {
            self.0 = Some(number);
        }
        !is_late
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn packets_are_as_the_nodes_write_them() {
        // Sums by Python: hex(zlib.crc32(b"...^")).
        for (text, sum) in [("H:ROS2-R4;T:1234;", "0xffc9f582"), ("O:2048,0,1;PNum:7;", "0x98cfb6d9")] {
            let whole = format!("{text}^{sum}^");
            let packet = Packet::parse(whole.as_bytes()).unwrap_or_else(|why| panic!("{text}: {why}"));
            assert_eq!(packet.to_string(), whole);
        }
        let heartbeat = Packet::default().with("H", "ROS2-R4").with("T", 1234);
        assert!(heartbeat.is_heartbeat() && heartbeat.get("T") == Some("1234"));
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
        assert_eq!(commands("O:4095,0,1;PNum:3"), [Some(Command::Osmc { duty: 1.0, channel: 0 })]);
        assert_eq!(commands("D:0,1,2;S:Stop"), [Some(Command::Dhb { duty: -0.0, channel: 1 }), Some(Command::Stop)]);
        for bad in ["O:4096,0,1", "O:-1,0,1", "O:1,2,1", "O:1,0,0", "O:1,0", "O:1,0,1,1", "O:a,0,1", "S:Go"] {
            assert_eq!(commands(bad), [None], "{bad}");
        }
    }

    #[test]
    fn late_packets_are_told_from_a_host_that_began_anew() {
        let mut sequence = Sequence::default();
        let mut is_new = |number: u32| sequence.is_new(&Packet::default().with("PNum", number));
        assert_eq!([5, 6, 6, 5, 7, 1000, 999, 1].map(&mut is_new), [true, true, false, false, true, true, false, true]);
        assert!(sequence.is_new(&Packet::default()));
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
            // But for the case of a hex digit.
            prop_assert!(Packet::parse(&damaged).is_err() || damaged.eq_ignore_ascii_case(text.as_bytes()));
        }
    }
}
