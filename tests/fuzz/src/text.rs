//! Targets of texts that come over links.

use r4_links::{
    legacy::{Command, LONGEST, Order, Packet, Sequence},
    slcan::{Frame, Line, Parser},
};

/// Target: reads any bytes of a CAN adapter. Whatever they are, the line behind a carriage return is read correctly.
///
/// # Panics
/// That line is not read correctly.
pub fn slcan(bytes: &[u8]) -> bool {
    let mut parser = Parser::default();
    let mut frames = 0;
    for byte in bytes {
        if let Some(Line::Frame(frame)) = parser.push(*byte) {
            frames += 1;
            let line = frame.line();
            assert_eq!(read(&mut Parser::default(), line.as_bytes()), [Line::Frame(frame)]);
        }
    }
    parser.push(b'\r');
    let good = Frame::new(0x281, &[1, 2, 3]).expect("a frame");
    assert_eq!(read(&mut parser, good.line().as_bytes()), [Line::Frame(good)]);
    frames > 0
}

fn read(parser: &mut Parser, text: &[u8]) -> Vec<Line> {
    text.iter().filter_map(|byte| parser.push(*byte)).collect()
}

/// Target: reads any packet of a host of the old firmware. An accepted one is read the same when it is written again.
///
/// # Panics
/// It is not.
pub fn legacy(bytes: &[u8]) -> bool {
    let Ok(packet) = Packet::parse(bytes) else { return false };
    let written = packet.to_string();
    if written.len() <= LONGEST {
        assert_eq!(Packet::parse(written.as_bytes()), Ok(packet.clone()));
    }
    for command in packet.commands() {
        match command {
            Command::Drive { duty, channel, .. } => {
                assert!((-1.0..=1.0).contains(&duty) && channel < 16, "{command:?}");
            }
            Command::Bad { channel, .. } => assert!(channel.is_none_or(|channel| channel < 16), "{command:?}"),
            Command::Stop => assert!(packet.stops()),
            Command::Unknown => {}
        }
    }
    let mut sequence = Sequence::default();
    assert_eq!(sequence.place(packet.number(), 0.0), Order::New);
    let again = if packet.number().is_none() { Order::New } else { Order::Twice };
    assert_eq!(sequence.place(packet.number(), 0.1), again, "the same packet twice");
    true
}
