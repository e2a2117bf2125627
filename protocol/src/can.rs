//! A byte link on a CAN bus: which frames carry it, how the bytes are cut, and a short way for set points.
//!
//! Frames with standard identifiers; all data bytes belong to the byte stream, which carries the frames of
//! [`frame`](crate::frame). Each board has a node number on its bus. Frames towards it and from it differ in one bit of the
//! identifier:
//!
//! ```text
//!  bit  10 9 8   7           6 5 4 3 2 1 0
//!        0 1 0   to host     node             byte stream
//!        0 0 1   0           node             set points
//! ```
//!
//! so 0x200 to 0x27F go to boards, 0x280 to 0x2FF to hosts, and 0x100 to 0x17F carry set points. A lower identifier wins the
//! bus: set points go before all else, what hosts command goes before what boards tell, and everything before CANopen-like
//! services at 0x580 and above. One host at a time talks to a board.
//!
//! CAN delivers in order what is sent under one identifier, once or, after an error in the last bit of a frame, twice; a
//! receiver that is not served in time loses frames whole. Both damage the byte stream, and the checksum of its frames finds
//! it as on any other link. There is no number in the frames for that reason, and all bytes are for data.
//!
//! At 1 Mbit/s a full classic frame takes 111 to 135 us with its stuff bits and the pause behind it: 59 to 72 bytes in a
//! millisecond. With CAN FD the pieces have up to 64 bytes ([`cut_fd`]), filled up with 0x00, which between frames means
//! nothing.
//!
//! # Set points
//!
//! A frame of 8 bytes is four `i16`, little-endian, for the channels and scales of [`Request::Bind`](crate::Request::Bind),
//! which goes over the byte stream before. To the board it is a [`Cycle`] without a date, so that its age counts from its
//! arrival; the answer comes over the byte stream, numbered by the board: 6 classic frames, or one of CAN FD. A host sends
//! set points this way or in the byte stream, not both: their numbers would be mixed up. Where they come faster than the
//! board reads them, the newest is taken.

use heapless::Vec;

use crate::{
    cycle::{CYCLE_CHANNELS, CYCLE_FRAME, Cycle, whole},
    frame::{Check, MAX_FRAME, encode_with},
};

/// Most data bytes of a classic frame.
pub const MAX_DATA: usize = 8;

/// Most data bytes of a frame of CAN FD.
pub const MAX_FD_DATA: usize = 64;

/// Data bytes of a frame with set points.
pub const SETPOINTS: usize = 2 * CYCLE_CHANNELS;

/// Bits in a second where nothing else is said. As fast as classic CAN goes: at most 25 m of bus (CiA 301).
pub const BITRATE: u32 = 1_000_000;

/// Bit rates of boards, kbit/s: the usual ones (CiA 301) that are fast enough for a session, for buses of 500, 250, 100 and 25 m.
pub const BITRATES_KBIT: [u16; 4] = [125, 250, 500, 1000];

/// Bit rates of the data phase of CAN FD, kbit/s; 0 is none, and classic frames only. None is faster than the transceiver of the
/// board's carrier and its delay allow: an SN65HVD230, made for 1 Mbit/s, whose loop of at most 135 ns (its data sheet) is seen
/// before the sample of a bit at 2 Mbit/s.
pub const DATA_RATES_KBIT: [u16; 4] = [0, 500, 1000, 2000];

/// Position of `ToDevice::Cycle` among its variants.
const CYCLE_VARIANT: u8 = 2;

const SETPOINT_BASE: u16 = 0x100;
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

    /// The identifier, of 11 bits, of the frames with set points for it.
    #[must_use]
    pub const fn setpoint_identifier(self) -> u16 {
        SETPOINT_BASE | self.0 as u16
    }

    /// Whose frame of a byte stream it is, and which way it goes; `None` for identifiers that are not ours.
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

/// The data of the frames of CAN FD that carry `bytes`, in their order. Bytes that end with a delimiter are filled up with
/// 0x00 to a length that frames can have; others are not, and may take a few frames more.
pub fn cut_fd(bytes: &[u8]) -> impl Iterator<Item = Vec<u8, MAX_FD_DATA>> {
    let mut rest = bytes;
    core::iter::from_fn(move || {
        let may_fill = rest.ends_with(&[0]);
        let (piece, after) = match FD_LENGTHS.iter().find(|length| **length >= rest.len()) {
            Some(_) if rest.is_empty() => return None,
            Some(length) if may_fill || *length == rest.len() => (rest, &rest[rest.len()..]),
            _ => rest.split_at(*FD_LENGTHS.iter().rfind(|length| **length <= rest.len())?),
        };
        rest = after;
        let mut data = Vec::new();
        // No piece is longer than the longest frame.
        data.extend_from_slice(piece).ok()?;
        data.resize(*FD_LENGTHS.iter().find(|length| **length >= piece.len())?, 0).ok()?;
        Some(data)
    })
}

/// Lengths that a frame of CAN FD can have (ISO 11898-1:2015, table of DLC codes).
const FD_LENGTHS: [usize; 15] = [1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, MAX_FD_DATA];

/// Makes the byte stream of a board's link of the frames that come from hosts: [`Inbound::take`] takes a frame,
/// [`Inbound::read`] gives bytes.
///
/// Frames of the byte stream are given when they are whole, so that set points can go between them, and never wait for the
/// rest of one.
pub struct Inbound {
    node: Node,
    /// A frame of the byte stream as far as it has come; one byte more than any has, so that what is too long is seen as such.
    frame: [u8; MAX_FRAME + 1],
    len: usize,
    whole: bool,
    /// How much of it has been given.
    given: usize,
    /// What came in the same CAN frame as its end.
    rest: Vec<u8, MAX_FD_DATA>,
    setpoints: Option<[u8; SETPOINTS]>,
    /// A frame with set points that is being given, and how much of it has been.
    cycle: [u8; CYCLE_FRAME],
    cycle_given: usize,
    seq: u8,
    replaced: u32,
}

/// Why a frame was not taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NotTaken {
    /// Not for this board, or not from a host.
    NotOurs,
    /// Set points are 8 bytes, and no frame has more than 64.
    Length,
    /// Bytes of the frame before have not been read yet: read, then try again.
    Full,
}

impl Inbound {
    /// Nothing has come.
    #[must_use]
    pub const fn new(node: Node) -> Self {
        Self {
            node,
            frame: [0; MAX_FRAME + 1],
            len: 0,
            whole: false,
            given: 0,
            rest: Vec::new(),
            setpoints: None,
            cycle: [0; CYCLE_FRAME],
            cycle_given: CYCLE_FRAME,
            seq: 0,
            replaced: 0,
        }
    }

    /// Takes the frame `identifier` with `data`.
    ///
    /// # Errors
    /// [`NotTaken`]; nothing has changed then.
    pub fn take(&mut self, identifier: u16, data: &[u8]) -> Result<(), NotTaken> {
        if identifier == self.node.setpoint_identifier() {
            let setpoints = data.try_into().map_err(|_| NotTaken::Length)?;
            if self.setpoints.replace(setpoints).is_some() {
                self.replaced = self.replaced.wrapping_add(1);
            }
            return Ok(());
        }
        if identifier != self.node.identifier(Direction::ToDevice) {
            return Err(NotTaken::NotOurs);
        }
        if self.whole {
            return Err(NotTaken::Full);
        }
        self.rest = Vec::from_slice(data).map_err(|_| NotTaken::Length)?;
        self.assemble();
        Ok(())
    }

    /// Gives as many bytes as there are, up to the length of `buffer`; 0 when another frame must come first.
    pub fn read(&mut self, buffer: &mut [u8]) -> usize {
        let mut read = 0;
        while read < buffer.len() {
            // Not in the middle of a frame of the byte stream.
            if self.given == 0
                && self.cycle_given == CYCLE_FRAME
                && let Some(setpoints) = self.setpoints.take()
            {
                self.begin_cycle(setpoints);
            }
            let (from, given) = match () {
                () if self.cycle_given < CYCLE_FRAME => (&self.cycle[..], &mut self.cycle_given),
                () if self.whole => (&self.frame[..self.len], &mut self.given),
                () => break,
            };
            let len = (from.len() - *given).min(buffer.len() - read);
            buffer[read..read + len].copy_from_slice(&from[*given..*given + len]);
            (read, *given) = (read + len, *given + len);
            if self.whole && self.given == self.len {
                (self.len, self.given, self.whole) = (0, 0, false);
                self.assemble();
            }
        }
        read
    }

    /// Set points that never became bytes, because newer ones came before they were read.
    #[must_use]
    pub fn replaced(&self) -> u32 {
        self.replaced
    }

    /// Moves bytes from the rest to the frame, up to its end.
    fn assemble(&mut self) {
        let mut moved = 0;
        for byte in &self.rest {
            moved += 1;
            if *byte != 0 {
                // What is longer than a frame can be is not needed to see that it is. The last place is the delimiter's.
                if self.len < MAX_FRAME {
                    self.frame[self.len] = *byte;
                    self.len += 1;
                }
            } else if self.len > 0 {
                self.frame[self.len] = 0;
                self.len += 1;
                self.whole = true;
                break;
            }
        }
        let left = self.rest.len() - moved;
        self.rest.copy_within(moved.., 0);
        self.rest.truncate(left);
    }

    fn begin_cycle(&mut self, setpoints: [u8; SETPOINTS]) {
        // As `ToDevice::Cycle` is encoded; by its number, because boards have no other use for the encoder of all requests.
        let cycle = (CYCLE_VARIANT, Cycle::new(self.seq, None, None, whole(setpoints)));
        self.seq = self.seq.wrapping_add(1);
        let mut buffer = [0; MAX_FRAME];
        // Every cycle has this length.
        if let Ok(frame) = encode_with(&cycle, Check::Long, &mut buffer)
            && let Ok(frame) = frame.try_into()
        {
            self.cycle = frame;
            self.cycle_given = 0;
        }
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use std::vec::Vec as List;

    use proptest::{collection::vec, prelude::*};

    use super::*;
    use crate::{
        cycle::NOTHING,
        frame::{FrameDecoder, FrameError, encode_frame},
        message::{Request, ToDevice},
    };

    const NODE: Node = Node(5);
    const STREAM: u16 = 0x205;
    const SHORT: u16 = 0x105;

    fn frame(message: &ToDevice) -> List<u8> {
        encode_frame(message, &mut [0; MAX_FRAME]).expect("it fits").to_vec()
    }

    fn bye(seq: u16) -> ToDevice {
        ToDevice::Request { seq, request: Request::Bye }
    }

    fn cycle(seq: u8, set: [i16; CYCLE_CHANNELS]) -> ToDevice {
        ToDevice::Cycle(Cycle::new(seq, None, None, set))
    }

    fn setpoints(set: [i16; CYCLE_CHANNELS]) -> [u8; SETPOINTS] {
        core::array::from_fn(|byte| set[byte / 2].to_le_bytes()[byte % 2])
    }

    /// Everything there is, in reads of `step` bytes.
    fn drain(inbound: &mut Inbound, step: usize) -> List<u8> {
        let (mut all, mut buffer) = (List::new(), [0; 64]);
        loop {
            match inbound.read(&mut buffer[..step]) {
                0 => return all,
                len => all.extend_from_slice(&buffer[..len]),
            }
        }
    }

    fn decode(bytes: &[u8]) -> List<Result<ToDevice, FrameError>> {
        let mut decoder = FrameDecoder::new();
        bytes.iter().filter_map(|byte| decoder.push(*byte)).collect()
    }

    #[test]
    fn set_points_become_cycles_between_the_frames_of_the_byte_stream() {
        let mut inbound = Inbound::new(NODE);
        let stream = [frame(&bye(1)), frame(&bye(2))].concat();
        let mut pieces = cut(&stream);
        inbound.take(STREAM, pieces.next().unwrap()).unwrap();
        assert_eq!(decode(&drain(&mut inbound, 64)), [Ok(bye(1))], "the second has not come whole");
        // In the middle of the second: not after it, and not in it.
        inbound.take(SHORT, &setpoints([1, -1, 0, NOTHING])).unwrap();
        assert_eq!(decode(&drain(&mut inbound, 3)), [Ok(cycle(0, [1, -1, 0, NOTHING]))]);
        inbound.take(SHORT, &setpoints([2; 4])).unwrap();
        for piece in pieces {
            inbound.take(STREAM, piece).unwrap();
        }
        assert_eq!(decode(&drain(&mut inbound, 1)), [Ok(cycle(1, [2; 4])), Ok(bye(2))]);
    }

    #[test]
    fn the_newest_set_points_are_taken_and_the_others_counted() {
        let mut inbound = Inbound::new(NODE);
        for newest in 1..=3 {
            inbound.take(SHORT, &setpoints([newest; 4])).unwrap();
        }
        let mut first = [0; 5];
        assert_eq!(inbound.read(&mut first), 5);
        // A cycle that is being given is not torn.
        inbound.take(SHORT, &setpoints([4; 4])).unwrap();
        let bytes = [&first[..], &drain(&mut inbound, 64)].concat();
        assert_eq!(decode(&bytes), [Ok(cycle(0, [3; 4])), Ok(cycle(1, [4; 4]))]);
        assert_eq!(inbound.replaced(), 2);
    }

    #[test]
    fn frames_of_others_and_of_other_lengths_are_not_taken() {
        let mut inbound = Inbound::new(NODE);
        for identifier in (0..0x800).filter(|identifier| ![STREAM, SHORT].contains(identifier)) {
            assert_eq!(inbound.take(identifier, &[0; 8]), Err(NotTaken::NotOurs), "{identifier:#05x}");
        }
        for len in (0..=64).filter(|len| *len != SETPOINTS) {
            assert_eq!(inbound.take(SHORT, &[0; 64][..len]), Err(NotTaken::Length));
        }
        assert_eq!(inbound.take(STREAM, &[1; 65]), Err(NotTaken::Length));
        assert_eq!(drain(&mut inbound, 64), []);
        inbound.take(STREAM, &frame(&bye(1))[..]).unwrap();
        assert_eq!(inbound.take(STREAM, &[1, 0]), Err(NotTaken::Full), "a whole frame waits");
        assert_eq!(decode(&drain(&mut inbound, 64)), [Ok(bye(1))]);
    }

    #[test]
    fn a_frame_that_is_too_long_is_one_error_and_the_next_is_taken() {
        for len in [MAX_FRAME - 1, MAX_FRAME, MAX_FRAME + 1, 5000] {
            let mut inbound = Inbound::new(NODE);
            let stream = [&std::vec![7; len][..], &[0], &frame(&bye(1))].concat();
            let mut bytes = List::new();
            for piece in cut(&stream) {
                inbound.take(STREAM, piece).unwrap();
                bytes.extend(drain(&mut inbound, 64));
            }
            assert_eq!(decode(&bytes).len(), 2, "{len}");
            assert_eq!(decode(&bytes)[1], Ok(bye(1)), "{len}");
            assert_eq!(decode(&bytes)[0], decode(&stream)[0], "{len}");
        }
    }

    #[test]
    fn filling_between_frames_is_nothing() {
        let mut inbound = Inbound::new(NODE);
        for data in [&[][..], &[0], &[0; 8], &[0; 64]] {
            assert_eq!(inbound.take(STREAM, data), Ok(()), "nothing waits");
            assert_eq!(drain(&mut inbound, 64), []);
        }
        let filled = [&[0; 3][..], &frame(&bye(1)), &[0; 3]].concat();
        for piece in cut(&filled) {
            inbound.take(STREAM, piece).unwrap();
        }
        assert_eq!(drain(&mut inbound, 64), frame(&bye(1)));
    }

    #[test]
    fn the_answer_to_a_cycle_is_one_frame_of_can_fd() {
        let answer = [[7; 44].as_slice(), &[0]].concat();
        let pieces: List<_> = cut_fd(&answer).collect();
        assert_eq!(pieces.len(), 1);
        assert_eq!(pieces[0][..], [&answer[..], &[0; 3]].concat());
        assert_eq!(cut(&answer).len(), 6);
    }

    /// Bytes of every length that two frames have and more, with a delimiter at their end and without.
    #[test]
    fn only_behind_a_delimiter_a_frame_of_can_fd_is_filled_up() {
        for len in 0..=200 {
            let whole: List<u8> = core::iter::repeat_n(7, len).chain([0]).collect();
            let pieces: List<_> = cut_fd(&whole).collect();
            assert_eq!(pieces.len(), whole.len().div_ceil(MAX_FD_DATA), "{len}");
            let filled = pieces.concat();
            assert_eq!(filled[..whole.len()], whole[..]);
            assert!(filled[whole.len()..].iter().all(|byte| *byte == 0));

            let part = &whole[..len];
            let pieces: List<_> = cut_fd(part).collect();
            assert!(pieces.iter().all(|piece| FD_LENGTHS.contains(&piece.len())), "{len}");
            assert_eq!(pieces.concat(), part);
            // The rest below 64 is at most 48 + 12 + 3, in one of three frames each.
            assert!(pieces.len() <= len / MAX_FD_DATA + 3, "{len}");
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

        /// Cut for either kind of CAN, with set points anywhere between, read in any steps: the same messages in their order,
        /// and the newest set points.
        #[test]
        fn nothing_is_lost_on_the_way(
            seqs in vec(any::<u16>(), 0..20),
            garbage in vec(vec(any::<u8>(), 0..300), 0..3),
            short in vec(any::<prop::sample::Index>(), 0..20),
            fd: bool,
            step in 1..=64_usize,
        ) {
            let mut stream: List<u8> = List::new();
            for (place, seq) in seqs.iter().enumerate() {
                if let Some(garbage) = garbage.get(place) {
                    stream.extend(garbage);
                    stream.push(0);
                }
                stream.extend(frame(&bye(*seq)));
            }
            let pieces: List<List<u8>> =
                if fd { cut_fd(&stream).map(|data| data.to_vec()).collect() } else { cut(&stream).map(<[u8]>::to_vec).collect() };
            prop_assert!(pieces.iter().all(|piece| FD_LENGTHS.contains(&piece.len())));
            let mut inbound = Inbound::new(NODE);
            let (mut bytes, mut sent) = (List::new(), 0_i16);
            for (place, piece) in pieces.iter().enumerate() {
                for _ in short.iter().filter(|at| at.index(pieces.len()) == place) {
                    inbound.take(SHORT, &setpoints([sent; 4])).unwrap();
                    sent += 1;
                }
                while inbound.take(STREAM, piece) == Err(NotTaken::Full) {
                    bytes.extend(drain(&mut inbound, step));
                }
            }
            bytes.extend(drain(&mut inbound, step));
            let is_cycle = |message: &Result<ToDevice, FrameError>| matches!(message, Ok(ToDevice::Cycle(_)));
            let (cycles, others): (List<_>, List<_>) = decode(&bytes).into_iter().partition(is_cycle);
            prop_assert_eq!(others, decode(&stream));
            prop_assert_eq!(cycles.len() + inbound.replaced() as usize, sent as usize);
            if let Some(Ok(ToDevice::Cycle(last))) = cycles.last() {
                prop_assert_eq!(last.set(), [sent - 1; 4]);
            }
        }
    }

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
        for number in 0..=u8::MAX {
            assert_eq!(Node::new(number).map(Node::number), Some(number).filter(|number| *number < 128));
        }
        for node in (0..Node::COUNT).filter_map(Node::new) {
            assert_eq!(Node::of(node.setpoint_identifier()), None, "set points are no byte stream");
            assert!(node.setpoint_identifier() < Node(0).identifier(Direction::ToDevice), "they win the bus");
        }
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
