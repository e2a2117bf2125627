//! Program that writes the part of the corpus that is made from valid messages and files: `cargo run -p r4-fuzz
//! --example seeds`.
//!
//! To be run again after a change of the protocol. Files with other names stay.
#![allow(clippy::unwrap_used, reason = "made for developers")]

use std::{cell::RefCell, fs, io::Cursor, path::Path, rc::Rc};

use embassy_futures::block_on;
use embedded_io_async::{ErrorType, Read, Write};
use r4_driver::{Board, Error, with_board};
use r4_firmware::storage::{
    SECTORS,
    parameters::{self, Changes},
};
use r4_fuzz::script::{WAIT, frame, of_messages};
use r4_links::legacy::Packet;
use r4_log::{About, Tap, Wall};
use r4_plants::{Model, PlantSpec, catalogue};
use r4_protocol::{
    FrameDecoder, Mode, Setpoint, ToDevice, ToHost, encode_frame,
    frame::{Check, MAX_FRAME, Message},
};
use r4_sim::{Pace, SimBoard, Simulation, flash::Flash};

fn main() {
    let write = |target: &str, name: &str, bytes: &[u8]| {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus").join(target);
        fs::create_dir_all(&folder).unwrap();
        fs::write(folder.join(name), bytes).unwrap();
        println!("{target}/{name}: {} bytes", bytes.len());
    };
    let runs: [(&str, &str, Work); 4] = [
        ("hello", "osmc-bench", |_| Box::pin(async { Ok(()) })),
        ("duty", "osmc-bench", |board| Box::pin(duty(board))),
        ("everything", "every-interface", |board| Box::pin(everything(board))),
        ("reads", "every-interface", |board| Box::pin(reads(board))),
    ];
    for (name, robot, work) in runs {
        let said = session(robot, work);
        let to_device: Vec<u8> = said.iter().filter(|said| said.by_host).flat_map(|said| said.bytes.clone()).collect();
        write("link", name, &to_device);
        write("frames", &format!("{name}-to-device"), &to_device);
        let to_host: Vec<u8> = said.iter().filter(|said| !said.by_host).flat_map(|said| said.bytes.clone()).collect();
        write("frames", &format!("{name}-to-host"), &to_host[..to_host.len().min(4000)]);
        write("dispatcher", name, &timed(&said, |said| said.by_host, plain::<ToDevice>));
        write("driver", name, &timed(&said, |said| !said.by_host, plain::<ToHost>));
        write("tap", name, &by_turns(&said));
        let mut tap = Tap::new(
            Cursor::new(Vec::new()),
            About {
                board: format!("sim:{robot}"),
                seed: Some(1),
                program: "a test".into(),
                command: "record".into(),
                wall: Wall::Began { unix_ns: 0 },
            },
        );
        for said in &said {
            if said.by_host { tap.sent(said.at_us, &said.bytes) } else { tap.received(said.at_us, &said.bytes) }
        }
        write("log", name, &tap.finish().unwrap().unwrap().into_inner());
    }

    let mut flash = Flash::<512>::new(SECTORS);
    for robot in ["Ada", "Grace"] {
        let changes = Changes { robot: Some(robot.try_into().unwrap()), ..Changes::default() };
        block_on(parameters::save(&mut flash, "osmc-bench", &changes)).unwrap();
        write("flash", &format!("saved-{robot}"), without_blank_end(&flash.to_bytes()));
    }
    block_on(parameters::save(&mut flash, "another", &Changes::default())).unwrap();
    write("flash", "of-another-robot", without_blank_end(&flash.to_bytes()));
    write("flash", "blank", &Flash::<512>::new(1).to_bytes());

    for (name, packet) in [
        ("heartbeat", Packet::default().with("H", "ROS2-R4").with("T", 1234)),
        ("osmc", Packet::default().with("O", "2048,0,1").with("PNum", 7)),
        ("dhb", Packet::default().with("D", "4095,1,16").with("D", "1,0,2").with("PNum", 4_294_967_295_u32)),
        ("full", Packet::default().with("D", "4095,0,1").with("PNum", 2).with("T", 1_692_316_800_000_u64)),
        ("beyond", Packet::default().with("O", "4096,0,1").with("D", "1,2,3").with("O", "1,0,99").with("S", "Go")),
        ("stop", Packet::default().with("S", "Stop").with("PNum", 8)),
    ] {
        write("legacy", name, packet.to_string().as_bytes());
    }
    for (name, text) in [
        ("frames", "t28185500000000000000\rt2820\rt7FF1ff\r"),
        ("opening", "\r\rC\rS8\rO\rV\rz\rZ\r\u{7}"),
        ("stamped", "t10031122330ABC\rT000002811AB\rr2812\r"),
        ("too-long", "t2818000102030405060708090A0B0C0D0E0F\rt2811AB\r"),
    ] {
        write("slcan", name, text.as_bytes());
    }
    write("key", "good", "0123456789abcdef".repeat(4).as_bytes());
    write("key", "good-with-line-end", format!("{}\n", "0123456789ABCDEF".repeat(4)).as_bytes());
    write("key", "short", b"0123");
    for (name, how) in [
        ("nothing", &[2][..]),
        ("first-message", &[0, 0, 3, 1]),
        ("answer", &[1, 0, 20, 0x80]),
        ("answer-cut", &[1, 1, 0, 3]),
        ("record-bit", &[2, 0, 0, 5]),
        ("record-length", &[2, 0, 0, 1]),
        ("record-again", &[2, 3, 1, 9]),
        ("record-more", &[2, 2, 2, 0]),
    ] {
        write("secure", name, how);
    }
    for (kind, model) in [("motor", Model::ALL[0]), ("actuator", Model::ALL[1])] {
        let effects = catalogue().iter().filter(|info| info.kinds.contains(&model.kind())).map(|info| info.typical);
        let spec = PlantSpec::new(model, "a corpus: every effect at once", effects.collect()).unwrap();
        write("plant", kind, spec.to_toml().as_bytes());
    }
    let boards = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../boards");
    write("carrier", "r4-carrier.toml", &fs::read(boards.join("r4-carrier.toml")).unwrap());
}

/// Cuts off blank flash, which is all ones, to keep the corpus small.
fn without_blank_end(content: &[u8]) -> &[u8] {
    const WORD: usize = 33;
    let blank = |word: &[u8]| word[0] == 1 && word[1..].iter().all(|byte| *byte == 0xFF);
    let used = content.chunks(WORD).rposition(|word| !blank(word)).map_or(0, |last| last + 1);
    &content[..used * WORD]
}

type Work = for<'b> fn(&'b Board<VirtualClock>) -> futures::future::LocalBoxFuture<'b, Result<(), Error>>;

async fn duty(board: &Board<VirtualClock>) -> Result<(), Error> {
    board.arm().await?;
    let motor = board.channels()[0].id;
    board.subscribe(motor, 10).await?;
    board.set(motor, Setpoint { mode: Mode::Duty, value: 0.5 }).await?;
    board.sleep_s(0.06).await;
    board.disarm().await
}

/// Sends a set point to every channel that takes one, and a cycle.
async fn everything(board: &Board<VirtualClock>) -> Result<(), Error> {
    board.arm().await?;
    let mut bound = Vec::new();
    for channel in board.channels() {
        board.subscribe(channel.id, 20).await?;
        let Some(mode) = channel.modes.first() else { continue };
        let value = mode.range.max.min(0.2);
        // A refused request is a message, too.
        let _ = board.set(channel.id, Setpoint { mode: mode.mode, value }).await;
        if bound.len() < 2 && mode.mode != Mode::Home {
            bound.push((channel.id, mode.mode));
        }
    }
    if let Ok(mut cycles) = board.stream(&bound, 100).await {
        let _ = cycles.cycle(&vec![0.0; bound.len()]).await;
    }
    board.sleep_s(0.02).await;
    board.stop().await?;
    board.clear().await
}

async fn reads(board: &Board<VirtualClock>) -> Result<(), Error> {
    board.stats().await?;
    board.stop().await?;
    board.clear().await?;
    let _ = board.faults().await;
    let _ = board.i2c_transfer(0, 0x50, &[1, 2], 4).await;
    let _ = board.uart_write(0, b"hello").await;
    let _ = board.uart_read(0).await;
    board.save_parameters().await
}

#[derive(Clone)]
struct VirtualClock(r4_sim::Clock);

impl r4_driver::Clock for VirtualClock {
    fn now_us(&self) -> u64 {
        self.0.now_ns() / 1000
    }

    fn sleep_until(&self, at_us: u64) -> impl Future<Output = ()> {
        self.0.sleep_until(at_us * 1000)
    }
}

/// Bytes of one end of a link, with their time.
struct Said {
    at_us: u64,
    by_host: bool,
    bytes: Vec<u8>,
}

/// Link that records what goes through.
struct Written<T> {
    inner: T,
    clock: r4_sim::Clock,
    said: Rc<RefCell<Vec<Said>>>,
}

impl<T> Written<T> {
    fn note(&self, by_host: bool, bytes: &[u8]) {
        let at_us = self.clock.now_ns() / 1000;
        self.said.borrow_mut().push(Said { at_us, by_host, bytes: bytes.to_vec() });
    }
}

impl<T: ErrorType> ErrorType for Written<T> {
    type Error = T::Error;
}

impl<T: Read> Read for Written<T> {
    async fn read(&mut self, buffer: &mut [u8]) -> Result<usize, T::Error> {
        let len = self.inner.read(buffer).await?;
        self.note(false, &buffer[..len]);
        Ok(len)
    }
}

impl<T: Write> Write for Written<T> {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, T::Error> {
        let len = self.inner.write(bytes).await?;
        self.note(true, &bytes[..len]);
        Ok(len)
    }

    async fn flush(&mut self) -> Result<(), T::Error> {
        self.inner.flush().await
    }
}

/// Returns the messages of both ends while `work` is done on a simulated board.
fn session(robot: &str, work: Work) -> Vec<Said> {
    let robot = r4_boards::load(robot).unwrap();
    let mut simulation = Simulation::new(Pace::Free);
    let board = SimBoard::start(&mut simulation, &robot, 1).unwrap();
    let port = board.connect().unwrap();
    let said = Rc::new(RefCell::new(Vec::new()));
    let clock = simulation.clock();
    let rx = Written { inner: port.rx, clock: clock.clone(), said: said.clone() };
    let tx = Written { inner: port.tx, clock: clock.clone(), said: said.clone() };
    simulation
        .block_on(with_board(rx, tx, VirtualClock(clock), async |board| work(board).await))
        .unwrap()
        .unwrap()
        .unwrap();
    said.take()
}

/// Returns the encoded message of a frame when `byte` completes one.
fn plain<T: Message>(decoder: &mut FrameDecoder, byte: u8) -> Option<Vec<u8>> {
    let message = decoder.push::<T>(byte)?.ok()?;
    let mut buffer = [0; MAX_FRAME];
    let sent = encode_frame(&message, &mut buffer).unwrap();
    // The length is found by trying: COBS adds one byte here, the checksum two or four, the delimiter one.
    let mut plain = vec![0; sent.len()];
    let mut from = 0;
    let mut to = 0;
    while sent[from] != 0 {
        let code = usize::from(sent[from]);
        plain[to..to + code - 1].copy_from_slice(&sent[from + 1..from + code]);
        to += code - 1;
        from += code;
        if sent[from] != 0 && code < 0xFF {
            to += 1;
        }
    }
    plain.truncate(to - if message.check() == Check::Long { 4 } else { 2 });
    assert_eq!(frame::<T>(&plain), sent);
    Some(plain)
}

type Plain = fn(&mut FrameDecoder, u8) -> Option<Vec<u8>>;

/// Makes a script of one end's messages, with the pauses between them.
fn timed(said: &[Said], which: fn(&Said) -> bool, plain: Plain) -> Vec<u8> {
    let mut script = Vec::new();
    let mut decoder = FrameDecoder::new();
    let mut last_us = 0;
    for said in said.iter().filter(|said| which(said)) {
        for byte in &said.bytes {
            if let Some(message) = plain(&mut decoder, *byte) {
                // Each message of a script takes a millisecond by itself.
                for bit in (0..4).rev() {
                    let pause_us = 1000 << bit;
                    if said.at_us.saturating_sub(last_us) > pause_us + 1000 {
                        script.push(WAIT + bit);
                        last_us += pause_us;
                    }
                }
                last_us += 1000;
                script.extend(of_messages([&message[..]]));
            }
        }
    }
    script
}

/// Makes a script of both ends' messages by turns: one of the host, one of the board.
fn by_turns(said: &[Said]) -> Vec<u8> {
    let mut script = Vec::new();
    let (mut to_device, mut to_host) = (FrameDecoder::new(), FrameDecoder::new());
    let mut by_host = true;
    for said in said {
        for byte in &said.bytes {
            let message = if said.by_host {
                plain::<ToDevice>(&mut to_device, *byte)
            } else {
                plain::<ToHost>(&mut to_host, *byte)
            };
            let Some(message) = message else { continue };
            if said.by_host != by_host {
                // A pause in the place of the other end's turn.
                script.push(WAIT);
            }
            script.extend(of_messages([&message[..]]));
            by_host = !said.by_host;
        }
    }
    script
}
