//! CAN through an adapter of the CANable type on a serial port, with the text protocol of Lawicel's CAN232 ("slcan").
//!
//! A line ends with a carriage return. `S8` selects 1 Mbit/s (others: `rate_command`), `O` opens the bus, `C` closes
//! it; a frame with a standard identifier is `t`, three hex digits of identifier, one of length, and the data in hex.
//! The adapter answers a frame with `z` and a command with an empty line, both ended by a carriage return, and an error
//! with a bell. (CAN232 manual, version 3, sections 2 to 4.)
//!
//! [`Parser`] and [`Frame::line`] implement the protocol; [`Receiver`] and [`Transmitter`] carry a board's byte stream
//! in frames.

use std::io;

use embedded_io_async::{ErrorType, Read, Write};
use r4_protocol::can::{MAX_DATA, Node, cut};

use crate::{
    Descriptor,
    bus::{Assembly, End},
};

/// Length of the longest line with a frame: `t`, identifier, length, data.
const LONGEST: usize = 1 + 3 + 1 + 2 * MAX_DATA;

/// Classic CAN frame with a standard identifier.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Frame {
    /// Standard identifier, 11 bits.
    pub identifier: u16,
    len: u8,
    data: [u8; MAX_DATA],
}

impl Frame {
    /// Makes a frame; `None` for an identifier of more than 11 bits, or more than 8 bytes.
    #[must_use]
    pub fn new(identifier: u16, data: &[u8]) -> Option<Self> {
        let mut frame = Self { identifier, len: data.len() as u8, data: [0; MAX_DATA] };
        frame.data.get_mut(..data.len())?.copy_from_slice(data);
        (identifier < 0x800).then_some(frame)
    }

    /// Data bytes of the frame.
    #[must_use]
    pub fn data(&self) -> &[u8] {
        &self.data[..usize::from(self.len)]
    }

    /// Formats the frame as a line, with its carriage return.
    #[must_use]
    pub fn line(&self) -> String {
        use std::fmt::Write;
        let mut line = format!("t{:03X}{}", self.identifier, self.len);
        for byte in self.data() {
            let _ = write!(line, "{byte:02X}");
        }
        line.push('\r');
        line
    }

    fn from_line(line: &[u8]) -> Option<Self> {
        let digits = line.strip_prefix(b"t")?;
        let number = |digits: &[u8]| {
            digits.iter().try_fold(0_u16, |value, digit| Some(value << 4 | char::from(*digit).to_digit(16)? as u16))
        };
        let (identifier, rest) = digits.split_at_checked(3)?;
        let (len, rest) = rest.split_first()?;
        // A character above '9' gives a length that the test of `rest` refuses.
        let len = usize::from(len.checked_sub(b'0')?);
        // Adapters with time stamps append four digits to a frame.
        let data = rest.get(..2 * len).filter(|_| rest.len() == 2 * len || rest.len() == 2 * len + 4)?;
        let data: Vec<u8> = data.chunks(2).map(|pair| Some(number(pair)? as u8)).collect::<Option<_>>()?;
        Self::new(number(identifier)?, &data)
    }
}

/// Line from the other end.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Line {
    /// Line with a CAN frame.
    Frame(Frame),
    /// Bell: the adapter reports that a command failed.
    Bell,
    /// Any other line: an answer, a command, a frame of a kind that no board sends.
    Other(Vec<u8>),
}

/// Parser of the byte stream into lines. After any garbage, the next line is parsed correctly.
#[derive(Clone, Debug, Default)]
pub struct Parser {
    line: Vec<u8>,
    too_long: bool,
}

impl Parser {
    /// Takes the next byte; returns a line when the byte completes one.
    pub fn push(&mut self, byte: u8) -> Option<Line> {
        match byte {
            b'\r' => {
                let line = std::mem::take(&mut self.line);
                if std::mem::take(&mut self.too_long) {
                    return None;
                }
                Some(Frame::from_line(&line).map_or(Line::Other(line), Line::Frame))
            }
            0x07 => {
                self.line.clear();
                self.too_long = false;
                Some(Line::Bell)
            }
            // Time stamps add four digits to the longest frame.
            _ if self.line.len() >= LONGEST + 4 => {
                self.too_long = true;
                None
            }
            _ => {
                self.line.push(byte);
                None
            }
        }
    }
}

/// Receiving half: assembles the byte stream from frames for one end.
#[derive(Debug)]
pub struct Receiver {
    port: Descriptor,
    parser: Parser,
    assembly: Assembly,
}

/// Transmitting half: cuts the byte stream into frames with one identifier.
#[derive(Debug)]
pub struct Transmitter {
    port: Descriptor,
    identifier: u16,
}

/// Opens the bus of an adapter for a host of the board `node`.
pub(crate) async fn host(mut port: Descriptor, kbit_per_s: u16, node: Node) -> io::Result<(Receiver, Transmitter)> {
    // The carriage returns end a partial line of another program; then the bus is closed (harmless when it is closed
    // already), the rate is set, and the bus is opened.
    port.write_all(format!("\r\rC\r{}\rO\r", rate_command(kbit_per_s)).as_bytes()).await?;
    Ok(ends(port, End::Host(node)))
}

/// Returns the command for a bit rate (CAN232 manual, section 2: `S4` is 125 kbit/s, `S5` 250, `S6` 500, `S8` 1000).
fn rate_command(kbit_per_s: u16) -> &'static str {
    match kbit_per_s {
        125 => "S4",
        250 => "S5",
        500 => "S6",
        _ => "S8",
    }
}

/// Makes both halves on a port with an adapter, or with a program that acts as one.
#[must_use]
pub fn ends(port: Descriptor, end: End) -> (Receiver, Transmitter) {
    let receiver = Receiver { port: port.clone(), parser: Parser::default(), assembly: Assembly::new(end) };
    (receiver, Transmitter { port, identifier: end.sends_with() })
}

impl ErrorType for Receiver {
    type Error = io::Error;
}

impl Read for Receiver {
    async fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        loop {
            let len = self.assembly.read(buffer);
            if len > 0 || buffer.is_empty() {
                return Ok(len);
            }
            let mut text = [0; 512];
            let len = self.port.read(&mut text).await?;
            if len == 0 {
                return Ok(0);
            }
            for byte in &text[..len] {
                if let Some(Line::Frame(frame)) = self.parser.push(*byte) {
                    self.assembly.take(frame.identifier, frame.data());
                }
            }
        }
    }
}

impl ErrorType for Transmitter {
    type Error = io::Error;
}

impl Write for Transmitter {
    async fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let lines: String =
            cut(bytes).filter_map(|data| Frame::new(self.identifier, data)).map(|frame| frame.line()).collect();
        self.port.write_all(lines.as_bytes()).await?;
        Ok(bytes.len())
    }

    async fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn lines(text: &[u8]) -> Vec<Line> {
        let mut parser = Parser::default();
        text.iter().filter_map(|byte| parser.push(*byte)).collect()
    }

    #[test]
    fn lines_are_as_the_manual_writes_them() {
        let frame = Frame::new(0x100, &[0x11, 0x22, 0x33]).expect("good");
        assert_eq!(frame.line(), "t1003112233\r");
        assert_eq!(lines(b"t1003112233\r"), [Line::Frame(frame)]);
        // Variants that adapters send: with a time stamp, in lower case, without data.
        assert_eq!(lines(b"t10031122330ABC\r"), [Line::Frame(frame)]);
        let other = Frame::new(0x28a, &[0xab]).expect("good");
        assert_eq!(lines(b"t28a1ab\rt7FF0\r")[..1], [Line::Frame(other)]);
        assert_eq!(Frame::new(0x800, &[]), None);
        assert_eq!(Frame::new(1, &[0; 9]), None);
    }

    #[cfg(unix)]
    fn pair() -> [Descriptor; 2] {
        let (one, other) = std::os::unix::net::UnixStream::pair().expect("sockets of this machine");
        [one, other].map(|end| Descriptor::new(end.into()).expect("it can be waited for"))
    }

    #[cfg(unix)]
    #[test]
    fn an_adapter_is_told_the_rate_before_the_bus_is_opened() {
        for (kbit_per_s, rate) in [(125, "S4"), (250, "S5"), (500, "S6"), (1000, "S8")] {
            let [port, mut adapter] = pair();
            let node = Node::new(5).expect("in range");
            let (_rx, mut tx) = crate::block_on(host(port, kbit_per_s, node)).expect("written");
            crate::block_on(tx.write_all(&[0xAB])).expect("written");
            let expected = format!("\r\rC\r{rate}\rO\rt2051AB\r");
            let mut told = vec![0; expected.len()];
            crate::block_on(adapter.read_exact(&mut told)).expect("read");
            assert_eq!(String::from_utf8_lossy(&told), expected);
        }
    }

    /// Both directions carry the bytes, in reads of any length.
    #[cfg(unix)]
    #[test]
    fn two_ends_read_what_the_other_wrote() {
        let node = Node::new(5).expect("in range");
        let [one, other] = pair();
        let (mut of_host, mut to_board) = ends(one, End::Host(node));
        let (mut of_board, mut to_host) = ends(other, End::Board(node));
        // The byte stream to a board consists of whole frames, which end with a 0.
        let said: Vec<u8> = (1..=200).chain([0]).collect();
        crate::block_on(async {
            for len in [1, 7, 8, 64, 201] {
                let (mut heard, mut buffer) = (Vec::new(), vec![0; len]);
                assert_eq!(to_board.write(&said).await.expect("written"), said.len());
                while heard.len() < said.len() {
                    let len = of_board.read(&mut buffer).await.expect("read");
                    heard.extend_from_slice(&buffer[..len]);
                }
                assert_eq!(heard, said);
                to_host.write_all(&said).await.expect("written");
                let mut heard = vec![0; said.len()];
                of_host.read_exact(&mut heard).await.expect("read");
                assert_eq!(heard, said);
            }
            assert_eq!(of_host.read(&mut []).await.expect("nothing to do"), 0);
            drop((of_board, to_host));
            assert_eq!(of_host.read(&mut [0; 8]).await.expect("the end is no error"), 0);
        });
    }

    #[test]
    fn what_is_no_frame_disturbs_nothing() {
        let frame = Line::Frame(Frame::new(0x281, &[5]).expect("good"));
        for before in [
            "t2819\r",
            "t281",
            "t2811\r",
            "T000002811AB\r",
            "z\r\r",
            "garbage that has no end for a long time ",
            "\u{7}",
        ] {
            let text = format!("{before}\rt281105\r");
            assert_eq!(lines(text.as_bytes()).last(), Some(&frame), "{before}");
        }
    }

    /// A bell needs no carriage return and discards a partial line. A line longer than any frame with its time stamp is
    /// dropped.
    #[test]
    fn a_bell_and_a_long_line_end_where_they_should() {
        let frame = Line::Frame(Frame::new(0x281, &[5]).expect("good"));
        for before in ["", "t28", &"x".repeat(1000)] {
            let text = format!("{before}\u{7}t281105\r");
            assert_eq!(lines(text.as_bytes()), [Line::Bell, frame.clone()], "{before}");
        }
        let longest = "t2818".to_owned() + &"AB".repeat(8) + "1234";
        for len in [0, longest.len() - 1, longest.len()] {
            assert_eq!(lines(format!("{}\r", "x".repeat(len)).as_bytes()), [Line::Other(vec![b'x'; len])]);
        }
        assert_eq!(lines(format!("{}\r", "x".repeat(longest.len() + 1)).as_bytes()), []);
        assert_eq!(
            lines(format!("{longest}\r").as_bytes()),
            [Line::Frame(Frame::new(0x281, &[0xAB; 8]).expect("good"))]
        );
    }

    proptest! {
        #[test]
        fn a_frame_is_read_as_it_was_written(identifier in 0_u16..0x800, data in prop::collection::vec(any::<u8>(), 0..=8), garbage: Vec<u8>) {
            let frame = Frame::new(identifier, &data).expect("good");
            let mut text = garbage;
            text.push(b'\r');
            text.extend_from_slice(frame.line().as_bytes());
            prop_assert_eq!(lines(&text).pop(), Some(Line::Frame(frame)));
        }
    }
}
