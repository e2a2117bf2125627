//! Byte link on a CAN bus: identifiers of its frames, how the bytes are cut into frames, and a short frame for set
//! points.
//!
//! The link uses frames with standard identifiers. All their data bytes belong to one byte stream, which carries the
//! frames of [`frame`](crate::frame). Each board has a node number on its bus. Frames to a board and from it differ in
//! one bit of the identifier:
//!
//! ```text
//!  bit  10 9 8   7           6 5 4 3 2 1 0
//!        0 1 0   to host     node             byte stream
//!        0 0 1   0           node             set points
//! ```
//!
//! so 0x200 to 0x27F go to boards, 0x280 to 0x2FF to hosts, and 0x100 to 0x17F carry set points. A lower identifier
//! wins the arbitration: set points go before all else, messages of hosts before those of boards, and everything before
//! CANopen-like services at 0x580 and above. One host at a time talks to a board.
//!
//! CAN delivers the frames of one identifier in order, each once or, after an error in its last bit, twice. A receiver
//! that is not served in time loses whole frames. Either damages the byte stream, and the checksum of its frames
//! detects it as on any other link. The CAN frames therefore carry no sequence number; all bytes are data.
//!
//! At 1 Mbit/s a full classic frame takes 111 to 135 us including stuff bits and interframe space: 59 to 72 bytes per
//! millisecond. Frames of CAN FD carry up to 64 bytes ([`cut_fd`]), padded with 0x00, which has no meaning between
//! frames.
//!
//! # Set points
//!
//! A frame of 8 bytes holds four `i16`, little-endian, for the channels and scales of an earlier
//! [`Request::Bind`](crate::Request::Bind), which goes over the byte stream. To the board it is a [`Cycle`] without a
//! date, so that its age counts from its arrival. The answer comes over the byte stream, numbered by the board: 6
//! classic frames, or one of CAN FD. A host sends set points either this way or in the byte stream, not both, because
//! the board numbers the former and the host the latter. When they arrive faster than the board reads them, it takes
//! the newest.

use heapless::Vec;

use crate::{
    cycle::{CYCLE_CHANNELS, CYCLE_FRAME, Cycle, whole},
    frame::{Check, MAX_FRAME, encode_with},
};

/// Maximum number of data bytes in a classic frame.
pub const MAX_DATA: usize = 8;

/// Maximum number of data bytes in a frame of CAN FD.
pub const MAX_FD_DATA: usize = 64;

/// Number of data bytes in a frame with set points.
pub const SETPOINTS: usize = 2 * CYCLE_CHANNELS;

/// Default bit rate, bit/s: the highest of classic CAN, for at most 25 m of bus (CiA 301).
pub const BITRATE: u32 = 1_000_000;

/// Bit rates a board can be set to, kbit/s: those of CiA 301 that are fast enough for a session, for buses of 500, 250,
/// 100 and 25 m.
pub const BITRATES_KBIT: [u16; 4] = [125, 250, 500, 1000];

/// Bit rates of the data phase of CAN FD, kbit/s; 0 stands for classic frames only. The carrier's transceiver sets the
/// upper limit: an SN65HVD230, made for 1 Mbit/s, whose loop delay of at most 135 ns (its data sheet) ends before the
/// sample point of a bit at 2 Mbit/s.
pub const DATA_RATES_KBIT: [u16; 4] = [0, 500, 1000, 2000];

/// Position of `ToDevice::Cycle` among its variants, which is its encoding.
const CYCLE_VARIANT: u8 = 2;

const SETPOINT_BASE: u16 = 0x100;
const BASE: u16 = 0x200;
const TO_HOST: u16 = 0x80;

/// Node number of a board on its bus, 0 to 127.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Node(u8);

/// Direction of a frame between host and board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// From a host to a board.
    ToDevice,
    /// From a board to a host.
    ToHost,
}

impl Node {
    /// Number of boards that one bus can have: the identifier has 7 bits for the node.
    pub const COUNT: u8 = 128;

    /// Makes a node of its number; `None` from [`Node::COUNT`] on.
    #[must_use]
    pub const fn new(number: u8) -> Option<Self> {
        if number < Self::COUNT { Some(Self(number)) } else { None }
    }

    /// Returns the node number, 0 to 127.
    #[must_use]
    pub const fn number(self) -> u8 {
        self.0
    }

    /// Returns the 11-bit identifier of byte stream frames to or from this board.
    #[must_use]
    pub const fn identifier(self, direction: Direction) -> u16 {
        let to_host = match direction {
            Direction::ToDevice => 0,
            Direction::ToHost => TO_HOST,
        };
        BASE | to_host | self.0 as u16
    }

    /// Returns the 11-bit identifier of frames with set points for this board.
    #[must_use]
    pub const fn setpoint_identifier(self) -> u16 {
        SETPOINT_BASE | self.0 as u16
    }

    /// Returns the board and the direction of a byte stream frame by its identifier; `None` for any other identifier,
    /// including that of set points.
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

/// Cuts `bytes` into the data of classic frames, in order; no frames for no bytes.
pub fn cut(bytes: &[u8]) -> impl ExactSizeIterator<Item = &[u8]> {
    bytes.chunks(MAX_DATA)
}

/// Cuts `bytes` into the data of CAN FD frames, in order. Bytes that end with a delimiter are padded with 0x00 to a
/// length that a frame can have. Others are not padded, and may take a few frames more.
pub fn cut_fd(bytes: &[u8]) -> impl Iterator<Item = Vec<u8, MAX_FD_DATA>> {
    let mut rest = bytes;
    core::iter::from_fn(move || {
        // Padding with 0x00 behind a delimiter is idle; inside a frame it would cut that frame.
        let may_fill = rest.ends_with(&[0]);
        let (piece, after) = match FD_LENGTHS.iter().find(|length| **length >= rest.len()) {
            Some(_) if rest.is_empty() => return None,
            Some(length) if may_fill || *length == rest.len() => (rest, &rest[rest.len()..]),
            _ => rest.split_at(*FD_LENGTHS.iter().rfind(|length| **length <= rest.len())?),
        };
        rest = after;
        let mut data = Vec::new();
        // Cannot fail: no piece is longer than the longest frame.
        data.extend_from_slice(piece).ok()?;
        data.resize(*FD_LENGTHS.iter().find(|length| **length >= piece.len())?, 0).ok()?;
        Some(data)
    })
}

/// Data lengths that a frame of CAN FD can have (ISO 11898-1:2015, table of DLC codes).
const FD_LENGTHS: [usize; 15] = [1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, MAX_FD_DATA];

/// Assembles the byte stream of a board's link from the frames of hosts: [`Inbound::take`] takes a CAN frame,
/// [`Inbound::read`] returns bytes.
///
/// Frames of the byte stream are returned only once they are complete. Set points can therefore go between them, and
/// never wait for the rest of one.
pub struct Inbound {
    node: Node,
    /// Bytes received of a byte stream frame; one byte longer than the longest frame, so that an overlong one is
    /// recognised.
    frame: [u8; MAX_FRAME + 1],
    len: usize,
    whole: bool,
    /// Number of bytes of `frame` that have been read.
    given: usize,
    /// Bytes behind the delimiter that ended `frame`, from the same CAN frame.
    rest: Vec<u8, MAX_FD_DATA>,
    setpoints: Option<[u8; SETPOINTS]>,
    /// Encoded set points that are being read, and how many of their bytes have been.
    cycle: [u8; CYCLE_FRAME],
    cycle_given: usize,
    seq: u8,
    replaced: u32,
}

/// Reason why a CAN frame was not taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NotTaken {
    /// The frame is for another board, or is not from a host.
    NotOurs,
    /// The data have a wrong length: set points have 8 bytes, and no frame has more than 64.
    Length,
    /// Bytes of an earlier frame have not been read yet: read, then try again.
    Full,
}

impl Inbound {
    /// Makes the assembler of board `node`, without any bytes.
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

    /// Takes the CAN frame `identifier` with `data`.
    ///
    /// # Errors
    /// [`NotTaken`], without any change.
    pub fn take(&mut self, identifier: u16, data: &[u8]) -> Result<(), NotTaken> {
        if identifier == self.node.setpoint_identifier() {
            let setpoints = data.try_into().map_err(|_| NotTaken::Length)?;
            // Set points are not queued: an older one must not move a motor after a newer one.
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

    /// Copies available bytes into `buffer` and returns their number; 0 when another frame must come first.
    pub fn read(&mut self, buffer: &mut [u8]) -> usize {
        let mut read = 0;
        while read < buffer.len() {
            // Set points go between frames of the byte stream, never into one.
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
            // The bytes behind this frame's end came in the same CAN frame and may complete the next one.
            if self.whole && self.given == self.len {
                (self.len, self.given, self.whole) = (0, 0, false);
                self.assemble();
            }
        }
        read
    }

    /// Returns how often set points were replaced by newer ones before they were read; wraps.
    #[must_use]
    pub fn replaced(&self) -> u32 {
        self.replaced
    }

    /// Moves bytes from `rest` to `frame`, up to the end of a frame.
    fn assemble(&mut self) {
        let mut moved = 0;
        for byte in &self.rest {
            moved += 1;
            if *byte != 0 {
                // Bytes beyond the longest frame are dropped: the length already shows that it is too long. The last
                // place is the delimiter's.
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
        // The encoding of `ToDevice::Cycle`, by its number: boards have no other use for the encoder of all requests.
        let cycle = (CYCLE_VARIANT, Cycle::new(self.seq, None, None, whole(setpoints)));
        self.seq = self.seq.wrapping_add(1);
        let mut buffer = [0; MAX_FRAME];
        // Cannot fail: every cycle has this length.
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

    /// Reads everything there is, in reads of `step` bytes.
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
        // The second frame has begun: set points wait neither for its end nor go into it.
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
        // A cycle that is being read stays whole.
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

    /// Tries bytes of every length up to more than two frames have, with a delimiter at their end and without.
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
            // The rest below 64 bytes is at most 48 + 12 + 3, in one of three frames each.
            assert!(pieces.len() <= len / MAX_FD_DATA + 3, "{len}");
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

        /// Cuts frames for either kind of CAN, puts set points anywhere between and reads in any steps: the same
        /// messages come out in order, and the newest set points.
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
