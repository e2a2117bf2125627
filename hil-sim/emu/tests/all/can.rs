//! Image on a CAN bus: its bit rate and node number, which it stores, and its recovery from bus-off.

use crate::emulated::{
    Board, Emu, Setup,
    harness::{Device, MS, ROTARY, US, frame},
};
use r4_emu::fault::{Fault, Lasting};
use r4_mcu::CanOutcome;
use r4_protocol::{
    Cause, Causes, DeviceInfo, DeviceStats, FrameDecoder, Mode, Parameter, ParameterKey, Refusal, Reply, Request,
    SCHEMA_HASH, SafetyState, Setpoint, ToDevice, ToHost, VERSION,
    can::{Direction, Node, cut, cut_fd},
    frame::encode_frame,
};
use r4_sim::flash::Flash;

const fn node(number: u8) -> Node {
    Node::new(number).expect("at most 127")
}

/// Sends a hello from another host to board number `to`; returns the number of frames with which board number `from`
/// has answered.
async fn answers(emu: &Emu<'_>, to: Node, from: Node) -> u64 {
    answers_within(emu, to, from, 100).await
}

/// Does the same with an answer time of `ms`.
async fn answers_within(emu: &Emu<'_>, to: Node, from: Node, ms: u64) -> u64 {
    let hello = Request::Hello { version: VERSION, schema: SCHEMA_HASH };
    let mut buffer = [0; _];
    let frame = encode_frame(&ToDevice::Request { seq: 1, request: hello }, &mut buffer).expect("short");
    let before = sent(emu, from);
    // The interval exceeds the duration of a frame of 8 bytes at 125 kbit/s.
    const APART_NS: u64 = 1_200_000;
    let begin_ns = emu.clock.now_ns();
    for (data, at_ns) in cut(frame).zip((begin_ns + APART_NS..).step_by(APART_NS as usize)) {
        emu.emulated.can_receive(at_ns, to.identifier(Direction::ToDevice), data.to_vec());
    }
    emu.sleep_ms(ms).await;
    sent(emu, from) - before
}

fn sent(emu: &Emu<'_>, node: Node) -> u64 {
    emu.emulated.can_sent(node.identifier(Direction::ToHost))
}

async fn set(emu: &Emu<'_>, parameter: Parameter, value: f32) -> Result<(), r4_driver::Error> {
    emu.host.set_parameter(ParameterKey { channel: None, parameter }, value).await
}

#[test]
fn bit_rate_and_number_are_those_that_the_board_has_kept() {
    let first = Setup::osmc_bench();
    first.bench(async |emu| {
        assert_eq!(emu.emulated.can_bit_rate(), 1e6);
        assert!(answers(emu, node(0), node(0)).await > 0);
        for (parameter, value) in [(Parameter::CanRate, 800.0), (Parameter::CanNode, 128.0)] {
            assert!(set(emu, parameter, value).await.is_err(), "{parameter} {value}");
        }
        set(emu, Parameter::CanRate, 125.0).await.expect("one of the rates");
        set(emu, Parameter::CanNode, 5.0).await.expect("in range");
        emu.host.save_parameters().await.expect("there is room");
        assert_eq!(emu.emulated.can_bit_rate(), 1e6, "taken at the next start");
    });
    let mut flash = first.last().flash().clone();
    flash.power_up();
    Setup::osmc_bench().with_flash(flash).bench(async |emu| {
        assert_eq!(emu.emulated.can_bit_rate(), 125e3);
        // The board ignores frames for other nodes.
        for other in [0, 4] {
            assert_eq!(answers(emu, node(other), node(5)).await, 0, "{other}");
        }
        assert!(answers(emu, node(5), node(5)).await > 0);
        assert_eq!(sent(emu, node(0)), 0);
    });
}

#[test]
fn a_board_comes_back_from_bus_off() {
    Setup::osmc_bench().bench(async |emu| {
        assert!(answers(emu, node(0), node(0)).await > 0);
        emu.emulated.inject_can_bus_off();
        // The firmware waits 50 ms, then for 128 times 11 recessive bits, 1.4 ms; then it takes part again.
        emu.sleep_ms(48).await;
        assert_eq!(answers_within(emu, node(0), node(0), 0).await, 0);
        emu.sleep_ms(5).await;
        assert!(answers(emu, node(0), node(0)).await > 0);
        assert_eq!(emu.host.stats().await.expect("it answers").can_bus_off, 1);
    });
}

/// Frame format that the host sends.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Format {
    Classic,
    /// CAN FD with a bit rate of its own in the data phase.
    Fd,
}

/// Host on the CAN bus that sends single frames.
struct CanHost<'a> {
    board: &'a Board,
    device: &'a Device,
    node: Node,
    format: Format,
    seq: u16,
    decoder: FrameDecoder,
    heard: Vec<ToHost>,
    /// Properties of each frame of the board: CAN FD, bit-rate switch, and bytes of data.
    frames: Vec<(bool, bool, usize)>,
}

impl<'a> CanHost<'a> {
    fn new(board: &'a Board, device: &'a Device, number: u8, format: Format) -> Self {
        let _ = board.take_can_frames();
        let decoder = FrameDecoder::new();
        Self { board, device, node: node(number), format, seq: 0, decoder, heard: Vec::new(), frames: Vec::new() }
    }

    /// Sends a message frame by frame, each in a pause of the board, at intervals longer than any frame at 500 kbit/s.
    async fn send(&self, message: &ToDevice) {
        const LONGEST_NS: u64 = 400 * US;
        let bytes = frame(message);
        let pieces: Vec<Vec<u8>> = match self.format {
            Format::Classic => cut(&bytes).map(<[u8]>::to_vec).collect(),
            Format::Fd => cut_fd(&bytes).map(|piece| piece.to_vec()).collect(),
        };
        for piece in pieces {
            while self.board.can_sends_until_ns().is_some() {
                self.device.clock.sleep(20 * US).await;
            }
            let (at_ns, identifier) =
                (self.device.clock.now_ns() + LONGEST_NS, self.node.identifier(Direction::ToDevice));
            match self.format {
                Format::Classic => self.board.can_receive(at_ns, identifier, piece),
                Format::Fd => self.board.can_receive_fd(at_ns, identifier, true, piece),
            }
            self.device.clock.sleep(LONGEST_NS + 20 * US).await;
        }
    }

    async fn listen(&mut self, ms: u64) {
        self.device.clock.sleep(ms * MS).await;
        for sent in self.board.take_can_frames() {
            if sent.id != u32::from(self.node.identifier(Direction::ToHost)) {
                continue;
            }
            self.frames.push((sent.fd, sent.bit_rate_switch, sent.data.len()));
            for byte in &sent.data {
                if let Some(Ok(message)) = self.decoder.push(*byte) {
                    self.heard.push(message);
                }
            }
        }
    }

    /// Sends a request and returns the answer; `None` without one.
    async fn ask(&mut self, request: Request) -> Option<Result<Reply, Refusal>> {
        self.seq += 1;
        let seq = self.seq;
        self.send(&ToDevice::Request { seq, request }).await;
        for _ in 0..20 {
            self.listen(2).await;
            let own = |message: &ToHost| matches!(message, ToHost::Response { seq: of, .. } if *of == seq);
            if let Some(place) = self.heard.iter().position(own) {
                let ToHost::Response { result, .. } = self.heard.remove(place) else { unreachable!() };
                return Some(result);
            }
        }
        None
    }

    async fn hello(&mut self) -> DeviceInfo {
        match self.ask(Request::Hello { version: VERSION, schema: SCHEMA_HASH }).await {
            Some(Ok(Reply::Hello(info))) => info,
            other => panic!("{other:?} to a hello"),
        }
    }

    async fn stats(&mut self) -> DeviceStats {
        match self.ask(Request::Stats).await {
            Some(Ok(Reply::Stats(stats))) => stats,
            other => panic!("{other:?} when asked for statistics"),
        }
    }

    /// Opens a session and starts the rotary motor; returns the session's number.
    async fn run_rotary(&mut self) -> u16 {
        let info = self.hello().await;
        assert_eq!(self.ask(Request::Arm).await, Some(Ok(Reply::Done)));
        let setpoint = Setpoint { mode: Mode::Duty, value: 0.8 };
        let set = Request::Set { channel: ROTARY, setpoint, sent_us: info.device_us, ttl_ms: 1000 };
        assert_eq!(self.ask(set).await, Some(Ok(Reply::Done)));
        self.keep_alive(info.session, 300).await;
        assert!(!self.device.is_off(ROTARY), "it must run before it can be stopped");
        info.session
    }

    /// Sends heartbeats for `ms`, four per link time-out, and checks that each is answered.
    async fn keep_alive(&mut self, session: u16, ms: u64) {
        for _ in 0..ms / 50 {
            self.send(&ToDevice::Heartbeat { session, host_us: 0 }).await;
            self.listen(45).await;
            let beats = self.heard.iter().filter(|message| matches!(message, ToHost::Heartbeat { .. })).count();
            assert!(beats > 0, "a heartbeat is answered");
            self.heard.clear();
        }
    }
}

/// Returns the flash of a board after these parameters were set and saved.
fn told(parameters: &[(Parameter, f32)]) -> Flash {
    let first = Setup::osmc_bench();
    first.bench(async |emu| {
        for (parameter, value) in parameters {
            set(emu, *parameter, *value).await.expect("in range");
        }
        emu.host.save_parameters().await.expect("there is room");
    });
    let mut flash = first.last().flash().clone();
    flash.power_up();
    flash
}

#[test]
fn a_board_that_was_told_nothing_speaks_classic_frames_only() {
    let (_, misuse) = Setup::osmc_bench().raw(async |_, device, board| {
        let mut host = CanHost::new(board, device, 0, Format::Classic);
        let session = host.run_rotary().await;
        host.keep_alive(session, 500).await;
        assert!(!host.frames.is_empty() && host.frames.iter().all(|(fd, _, length)| !fd && *length <= 8));
        // A CAN FD frame is an error for a classic node: the board does not take it, and the session goes on.
        let before = host.stats().await;
        host.format = Format::Fd;
        assert_eq!(host.ask(Request::Stats).await, None);
        host.format = Format::Classic;
        host.keep_alive(session, 100).await;
        let after = host.stats().await;
        assert_eq!((after.bad_frames, after.refused), (before.bad_frames, before.refused));
        assert_eq!((after.can_bus_off, after.can_warnings), (0, 0));
        assert!(!device.is_off(ROTARY));
        // One hundred errors, one at a time, raise the receive counter to the warning limit: the board reports it, and
        // stays on the bus.
        host.format = Format::Fd;
        for _ in 0..100 {
            host.send(&ToDevice::Request { seq: 1, request: Request::Bye }).await;
        }
        host.format = Format::Classic;
        let after = host.stats().await;
        assert_eq!((after.can_bus_off, after.can_warnings), (0, 1));
    });
    assert_eq!(misuse, Vec::<String>::new());
}

/// The host sends CAN FD from the board's first CAN FD frame on, as `r4` does.
#[test]
fn a_session_of_can_fd_at_two_rates() {
    for (rate, data_rate, switches) in [(1000.0, 2000.0, true), (500.0, 1000.0, true), (1000.0, 1000.0, false)] {
        let flash = told(&[(Parameter::CanDataRate, data_rate), (Parameter::CanRate, rate)]);
        let (_, misuse) = Setup::osmc_bench().with_flash(flash).raw(async |_, device, board| {
            assert_eq!((board.can_bit_rate(), board.can_data_bit_rate()), (rate as f64 * 1e3, data_rate as f64 * 1e3));
            let mut host = CanHost::new(board, device, 0, Format::Classic);
            host.hello().await;
            assert!(host.frames.iter().all(|(fd, switched, _)| *fd && *switched == switches), "{:?}", host.frames);
            assert!(host.frames.iter().any(|(.., length)| *length > 8));
            host.format = Format::Fd;
            let session = host.run_rotary().await;
            host.keep_alive(session, 500).await;
            // Classic frames come between others, as from a host that was restarted.
            for format in [Format::Classic, Format::Fd, Format::Classic] {
                host.format = format;
                host.keep_alive(session, 100).await;
            }
            let stats = host.stats().await;
            assert_eq!((stats.bad_frames, stats.can_bus_off, stats.can_warnings), (0, 0, 0));
            assert!(!device.is_off(ROTARY));
        });
        assert_eq!(misuse, Vec::<String>::new());
    }
}

/// The bus is held dominant in the middle of one of the board's frames: the board goes bus-off, the silence of its host
/// stops it, and it is back when the short is gone.
#[test]
fn a_shorted_bus_stops_the_board_and_a_session_works_again_after_it() {
    let (_, misuse) = Setup::osmc_bench().raw(async |_, device, board| {
        let mut host = CanHost::new(board, device, 0, Format::Classic);
        let session = host.run_rotary().await;
        let info_timeout_ns = 200 * MS;
        host.send(&ToDevice::Heartbeat { session, host_us: 0 }).await;
        let begin_ns = device.clock.now_ns();
        let sends = device.wait_until(begin_ns, 5 * MS, || board.can_sends_until_ns().is_some()).await;
        sends.expect("a heartbeat is answered");
        board.hold_can_dominant(true);
        let off_ns = device.wait_until(device.clock.now_ns(), 1000 * MS, || device.is_off(ROTARY)).await;
        let off_ns = off_ns.expect("its host is silent");
        assert!(off_ns >= info_timeout_ns - 10 * MS, "{} ms", off_ns / MS);
        eprintln!("off {} ms after the short", off_ns / MS);
        device.clock.sleep(2000 * MS).await;
        board.hold_can_dominant(false);
        // Bytes on their way at the short form a damaged frame.
        host.listen(100).await;
        host.decoder = FrameDecoder::new();
        host.heard.clear();
        let info = host.hello().await;
        assert_eq!((info.state, info.causes), (SafetyState::Tripped, Causes::only(Cause::LinkLost)));
        let stats = host.stats().await;
        assert_eq!((stats.can_bus_off, stats.can_warnings), (1, 1));
        assert_eq!(host.ask(Request::Clear).await, Some(Ok(Reply::Done)));
        host.run_rotary().await;
        assert_eq!(host.stats().await.can_bus_off, 1);
    });
    assert_eq!(misuse, Vec::<String>::new());
}

/// Every frame of the board fails at once: it retries, but not so often that other work suffers.
#[test]
fn a_broken_transceiver_costs_no_time() {
    let (_, misuse) = Setup::osmc_bench().raw(async |uart, device, board| {
        let mut host = CanHost::new(board, device, 0, Format::Classic);
        host.run_rotary().await;
        let before = host.stats().await;
        board.set_can_outcome(CanOutcome::BitError);
        host.send(&ToDevice::Request { seq: 1, request: Request::Stats }).await;
        device.clock.sleep(2000 * MS).await;
        // The session has ended by the silence of its host, so another link can open one.
        uart.hello().await;
        let during = uart.stats().await;
        uart.ask(Request::Bye).await.expect("it has a session");
        // Expected number in 2 s: one per 50 ms, 32 frames and 1.4 ms.
        let times = during.can_bus_off - before.can_bus_off;
        assert!((30..=40).contains(&times), "{times} times off the bus in 2 s");
        assert_eq!(during.late_ticks, before.late_ticks);
        board.set_can_outcome(CanOutcome::Acknowledged);
        device.clock.sleep(100 * MS).await;
        host.listen(0).await;
        host.heard.clear();
        let info = host.hello().await;
        assert_eq!(info.causes, Causes::only(Cause::LinkLost));
        let last = host.stats().await.can_bus_off;
        device.clock.sleep(500 * MS).await;
        assert_eq!(host.stats().await.can_bus_off, last);
    });
    assert_eq!(misuse, Vec::<String>::new());
}

/// In hold mode the board answers at its stored rate and node number, and not at those built into its image.
#[test]
fn a_held_board_keeps_its_rate_and_number() {
    let flash = told(&[(Parameter::CanRate, 500.0), (Parameter::CanNode, 7.0)]);
    let before = flash.to_bytes();
    let setup = Setup::osmc_bench().with_flash(flash);
    let _ = setup.raw(async |_, device, board| {
        board.inject(Fault::SupervisorHangs, Lasting::Always).expect("the image has it");
        device.clock.sleep(1000 * MS).await;
        assert_eq!(board.machine().chip.backup_register(22).map(|word| word & 0xFFFF), Some(3), "the first hold mode");
        let mut host = CanHost::new(board, device, 7, Format::Classic);
        let info = host.hello().await;
        assert_eq!(info.causes, Causes::only(Cause::RepeatedBadStarts));
        assert_eq!(board.can_bit_rate(), 500e3);
        assert!(board.can_sent(node(0).identifier(Direction::ToHost)) == 0);
        assert!(matches!(host.ask(Request::Arm).await, Some(Err(Refusal::CausesPresent { .. }))));
    });
    assert!(setup.last().flash().to_bytes() == before, "it reads and never erases");
}
