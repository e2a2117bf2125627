//! Common part of all links over CAN: identifiers of both ends, and assembly of the byte stream from frames.

use std::collections::VecDeque;

use r4_protocol::can::{Direction, Inbound, Node, NotTaken};

/// End of a link over CAN.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// Host that talks to this board.
    Host(Node),
    /// Board with this node number.
    Board(Node),
}

impl End {
    /// Returns the identifier of the frames that this end sends.
    #[must_use]
    pub fn sends_with(self) -> u16 {
        match self {
            Self::Host(node) => node.identifier(Direction::ToDevice),
            Self::Board(node) => node.identifier(Direction::ToHost),
        }
    }

    /// Returns the identifiers that this end receives; a board receives set points too.
    #[must_use]
    pub fn listens_to(self) -> Vec<u16> {
        match self {
            Self::Host(node) => vec![node.identifier(Direction::ToHost)],
            Self::Board(node) => vec![node.identifier(Direction::ToDevice), node.setpoint_identifier()],
        }
    }
}

/// Assembles the byte stream from frames. At a board, set points are inserted between the frames of the stream.
pub(crate) struct Assembly {
    end: End,
    /// Received bytes at a host, in their order.
    bytes: VecDeque<u8>,
    /// Received bytes and set points at a board.
    inbound: Box<Inbound>,
    /// Frames that `inbound` had no room for.
    waiting: VecDeque<Vec<u8>>,
}

impl Assembly {
    pub(crate) fn new(end: End) -> Self {
        let (End::Host(node) | End::Board(node)) = end;
        Self { end, bytes: VecDeque::new(), inbound: Box::new(Inbound::new(node)), waiting: VecDeque::new() }
    }

    /// Takes a frame from the bus; ignores frames for other ends.
    pub(crate) fn take(&mut self, identifier: u16, data: &[u8]) {
        match self.end {
            End::Host(node) if identifier == node.identifier(Direction::ToHost) => self.bytes.extend(data),
            End::Host(_) => {}
            // Frames behind waiting ones must wait too, to keep their order; set points overtake all.
            End::Board(node) if identifier == node.identifier(Direction::ToDevice) && !self.waiting.is_empty() => {
                self.waiting.push_back(data.to_vec());
            }
            End::Board(_) => match self.inbound.take(identifier, data) {
                Ok(()) | Err(NotTaken::NotOurs | NotTaken::Length) => {}
                Err(NotTaken::Full) => self.waiting.push_back(data.to_vec()),
            },
        }
    }

    /// Copies the available bytes to `buffer` and returns their number; 0 when another frame must arrive first.
    pub(crate) fn read(&mut self, buffer: &mut [u8]) -> usize {
        let End::Board(node) = self.end else {
            let len = buffer.len().min(self.bytes.len());
            for (place, byte) in buffer.iter_mut().zip(self.bytes.drain(..len)) {
                *place = byte;
            }
            return len;
        };
        loop {
            let len = self.inbound.read(buffer);
            if len > 0 {
                return len;
            }
            let Some(data) = self.waiting.pop_front() else { return 0 };
            // The frame fits, because `inbound` has just been emptied.
            let _ = self.inbound.take(node.identifier(Direction::ToDevice), &data);
        }
    }
}

impl std::fmt::Debug for Assembly {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Assembly").field("end", &self.end).finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use r4_protocol::{Cycle, FrameDecoder, Request, ToDevice, can::cut, encode_frame, frame::MAX_FRAME};

    use super::*;

    fn stats(seq: u16) -> ToDevice {
        ToDevice::Request { seq, request: Request::Stats }
    }

    fn frame(message: &ToDevice) -> Vec<u8> {
        encode_frame(message, &mut [0; MAX_FRAME]).expect("it fits").to_vec()
    }

    fn node() -> Node {
        Node::new(3).expect("in range")
    }

    #[test]
    fn a_board_reads_set_points_between_the_frames_however_many_have_come() {
        let mut board = Assembly::new(End::Board(node()));
        let stream = [stats(1), stats(2), stats(3)].map(|message| frame(&message)).concat();
        for piece in cut(&stream) {
            board.take(0x203, piece);
            // Frames to another board, and from a board, are ignored.
            board.take(0x204, piece);
            board.take(0x283, piece);
        }
        board.take(0x103, &[7, 0, 8, 0, 9, 0, 10, 0]);
        let (mut decoder, mut messages, mut buffer) = (FrameDecoder::new(), Vec::new(), [0; 5]);
        while let len @ 1.. = board.read(&mut buffer) {
            messages.extend(buffer[..len].iter().filter_map(|byte| decoder.push::<ToDevice>(*byte)));
        }
        let cycle = ToDevice::Cycle(Cycle::new(0, None, None, [7, 8, 9, 10]));
        assert_eq!(messages, [cycle, stats(1), stats(2), stats(3)].map(Ok));
    }

    /// The order holds for any number of pieces before the first read, and for any length of the reads after each
    /// further piece.
    #[test]
    fn a_board_reads_the_byte_stream_in_its_order() {
        let stream = [1, 2, 3, 4, 5, 6].map(|seq| frame(&stats(seq))).concat();
        for ahead in 0..cut(&stream).len() {
            for step in 1..20 {
                let mut board = Assembly::new(End::Board(node()));
                let (mut heard, mut buffer) = (Vec::new(), [0; 20]);
                for (place, piece) in cut(&stream).enumerate() {
                    board.take(0x203, piece);
                    if place >= ahead {
                        let len = board.read(&mut buffer[..step]);
                        heard.extend_from_slice(&buffer[..len]);
                    }
                }
                while let len @ 1.. = board.read(&mut buffer[..step]) {
                    heard.extend_from_slice(&buffer[..len]);
                }
                assert_eq!(heard, stream, "{ahead} pieces, then {step} bytes a piece");
            }
        }
    }

    #[test]
    fn each_end_listens_to_what_the_other_sends() {
        let (host, board) = (End::Host(node()), End::Board(node()));
        assert_eq!(host.listens_to(), [board.sends_with()]);
        assert_eq!(board.listens_to(), [host.sends_with(), node().setpoint_identifier()]);
    }

    #[test]
    fn a_host_reads_what_its_board_says_and_nothing_else() {
        let mut host = Assembly::new(End::Host(node()));
        for identifier in [0x103, 0x203, 0x282, 0x284] {
            host.take(identifier, &[1; 8]);
        }
        host.take(0x283, &[1, 2, 3]);
        host.take(0x283, &[4]);
        let mut buffer = [0; 3];
        assert_eq!((host.read(&mut buffer), buffer), (3, [1, 2, 3]));
        assert_eq!((host.read(&mut buffer), buffer[0]), (1, 4));
        assert_eq!(host.read(&mut buffer), 0);
    }
}
