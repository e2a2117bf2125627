//! A byte link on a CAN bus: which frames carry it, and how the bytes are cut.
//!
//! Classic frames of 1 to 8 data bytes with standard identifiers; all data bytes belong to the byte stream, which carries the
//! frames of [`frame`](crate::frame). Each board has a node number on its bus. Frames towards it and from it differ in one bit
//! of the identifier:
//!
//! ```text
//!  bit  10 9 8   7           6 5 4 3 2 1 0
//!        0 1 0   to host     node
//! ```
//!
//! so 0x200 to 0x27F go to boards, 0x280 to 0x2FF to hosts. A lower identifier wins the bus: what hosts command goes before
//! what boards tell, and everything before CANopen-like services at 0x580 and above. One host at a time talks to a board.
//!
//! CAN delivers in order what is sent under one identifier, once or, after an error in the last bit of a frame, twice; a
//! receiver that is not served in time loses frames whole. Both damage the byte stream, and the checksum of its frames finds
//! it as on any other link. There is no number in the frames for that reason, and all 8 bytes are for data.
//!
//! At 1 Mbit/s a full frame takes 111 to 135 us with its stuff bits and the pause behind it: 59 to 72 bytes in a millisecond.

/// Most data bytes of a classic frame.
pub const MAX_DATA: usize = 8;

/// Bits in a second. As fast as classic CAN goes: at most 40 m of bus.
pub const BITRATE: u32 = 1_000_000;

const BASE: u16 = 0x200;
const TO_HOST: u16 = 0x80;

/// The number of a board on its bus, 0 to 127.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Node(u8);

/// Which way a frame goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// From a host.
    ToDevice,
    /// From a board.
    ToHost,
}

impl Node {
    /// As many boards can be on one bus.
    pub const COUNT: u8 = 128;

    /// `None` for a number that does not fit the identifier.
    #[must_use]
    pub const fn new(number: u8) -> Option<Self> {
        if number < Self::COUNT { Some(Self(number)) } else { None }
    }

    /// Its number.
    #[must_use]
    pub const fn number(self) -> u8 {
        self.0
    }

    /// The identifier, of 11 bits, of the frames to or from it.
    #[must_use]
    pub const fn identifier(self, direction: Direction) -> u16 {
        let to_host = match direction {
            Direction::ToDevice => 0,
            Direction::ToHost => TO_HOST,
        };
        BASE | to_host | self.0 as u16
    }

    /// Whose frame it is, and which way it goes; `None` for identifiers that are not ours.
    #[must_use]
    pub const fn of(identifier: u16) -> Option<(Self, Direction)> {
        let node = Self((identifier & 0x7F) as u8);
        match identifier & !(TO_HOST | 0x7F) {
            BASE if identifier & TO_HOST == 0 => Some((node, Direction::ToDevice)),
            BASE => Some((node, Direction::ToHost)),
            _ => None,
        }
    }
}

/// The data of the frames that carry `bytes`, in their order. Nothing is sent for no bytes.
pub fn cut(bytes: &[u8]) -> impl ExactSizeIterator<Item = &[u8]> {
    bytes.chunks(MAX_DATA)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_identifier_is_of_one_node_and_direction_or_not_ours() {
        let mut ours = 0;
        for identifier in 0..0x800 {
            let Some((node, direction)) = Node::of(identifier) else { continue };
            assert_eq!(node.identifier(direction), identifier);
            assert!(node.number() < Node::COUNT);
            ours += 1;
        }
        assert_eq!(ours, 256, "two for each node");
        assert_eq!(Node::new(128), None);
        assert_eq!(Node::of(0x200 | 0x800), None, "no extended identifier is taken for one of ours");
    }

    #[test]
    fn what_hosts_command_wins_the_bus() {
        let node = |number| Node::new(number).expect("in range");
        assert_eq!(node(1).identifier(Direction::ToDevice), 0x201);
        assert_eq!(node(1).identifier(Direction::ToHost), 0x281);
        assert!(node(127).identifier(Direction::ToDevice) < node(0).identifier(Direction::ToHost));
    }

    #[test]
    fn frames_put_together_are_the_bytes() {
        let bytes: [u8; 20] = core::array::from_fn(|index| index as u8);
        for len in 0..=bytes.len() {
            let mut next = 0;
            for data in cut(&bytes[..len]) {
                assert!((1..=MAX_DATA).contains(&data.len()));
                assert_eq!(data, &bytes[next..next + data.len()]);
                next += data.len();
            }
            assert_eq!(next, len);
            assert_eq!(cut(&bytes[..len]).len(), len.div_ceil(MAX_DATA), "as few as can be");
        }
    }
}
