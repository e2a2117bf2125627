//! Tests of gdb on the emulated board: the real gdb where it is installed, and a small client of its protocol.

use std::{
    cell::Cell,
    io::{BufRead, BufReader, Read, Write},
    net::{SocketAddr, TcpListener, TcpStream},
    process::Command,
    rc::Rc,
    thread,
};

use crate::debugging::Debugged;
use r4_emu::gdb::{Server, Starter, State};
use r4_mcu::{
    cpu::{Core as _, Register},
    machine::Trace,
};
use r4_sim::VirtualBoard as _;

/// Time of a run that boots, sets up every chip on the bus, and runs control periods, ns.
const LONG_NS: u64 = 60_000_000;

struct Silent;

impl Starter for Silent {
    fn say(&self, _: &str) {}
}

/// Starts a board that waits for gdb at its reset.
fn waiting() -> (Debugged, SocketAddr, Rc<Cell<State>>) {
    let debugged = Debugged::start();
    let listener = TcpListener::bind("127.0.0.1:0").expect("there is a free port");
    let address = listener.local_addr().expect("it has an address");
    let server = Server::new(debugged.board.shared_machine(), listener, 0, Silent);
    let state = server.state();
    debugged.board.watch(server);
    debugged.board.machine().start_trace();
    (debugged, address, state)
}

fn address_of(debugged: &Debugged, symbol: &str) -> u32 {
    debugged.board.machine().symbols().address(symbol).unwrap_or_else(|| panic!("the image has no {symbol}"))
}

/// Returns trace and instructions of a run without a debugger.
fn undisturbed() -> (Option<Trace>, u64) {
    let mut debugged = Debugged::start();
    debugged.board.machine().start_trace();
    debugged.run_to_ns(LONG_NS);
    let machine = debugged.board.machine();
    (machine.trace(), machine.instructions())
}

/// Client side of the protocol, as far as these tests need it.
struct Client {
    to: TcpStream,
    from: BufReader<TcpStream>,
}

impl Client {
    fn connect(address: SocketAddr) -> Self {
        let to = TcpStream::connect(address).expect("somebody listens");
        let from = BufReader::new(to.try_clone().expect("it can be shared"));
        Self { to, from }
    }

    /// Sends a packet and returns the answer.
    fn ask(&mut self, packet: &str) -> String {
        let sum = packet.bytes().fold(0_u8, u8::wrapping_add);
        write!(self.to, "${packet}#{sum:02x}").expect("it is connected");
        self.answer()
    }

    fn answer(&mut self) -> String {
        let mut before = Vec::new();
        self.from.read_until(b'$', &mut before).expect("it is connected");
        assert!(before.iter().all(|byte| matches!(byte, b'+' | b'$')), "{}", String::from_utf8_lossy(&before));
        let mut packet = Vec::new();
        self.from.read_until(b'#', &mut packet).expect("it is connected");
        packet.pop();
        let mut sum = [0; 2];
        self.from.read_exact(&mut sum).expect("it is connected");
        self.to.write_all(b"+").expect("it is connected");
        expand(&packet)
    }

    fn register(&mut self, number: u32) -> u32 {
        let answer = self.ask(&format!("p{number:x}"));
        u32::from_str_radix(&answer, 16).unwrap_or_else(|_| panic!("{answer}")).swap_bytes()
    }

    fn word(&mut self, address: u32) -> u32 {
        let answer = self.ask(&format!("m{address:x},4"));
        u32::from_str_radix(&answer, 16).unwrap_or_else(|_| panic!("{answer}")).swap_bytes()
    }
}

/// Expands run-length encoding: after `*` comes the number of repetitions, plus 29.
fn expand(packet: &[u8]) -> String {
    let mut text = Vec::new();
    let mut rest = packet.iter();
    while let Some(byte) = rest.next() {
        match (byte, text.last().copied()) {
            (b'*', Some(last)) => {
                let count = rest.next().expect("a count follows") - 29;
                text.extend(std::iter::repeat_n(last, count.into()));
            }
            _ => text.push(*byte),
        }
    }
    String::from_utf8(text).expect("it is text")
}

const SP: u32 = 13;
const PC: u32 = 15;

#[test]
fn the_protocol_stops_steps_and_reads_and_changes_nothing() {
    let (mut debugged, address, state) = waiting();
    let [reset, main] = ["Reset", "main"].map(|name| address_of(&debugged, name));
    let stack_top = debugged.board.machine().core.get(Register::Sp);
    let client = thread::spawn(move || {
        let mut gdb = Client::connect(address);
        assert!(gdb.ask("?").starts_with("T05"), "halted");
        assert_eq!(gdb.register(PC), reset);
        assert_eq!(gdb.register(SP), stack_top);
        // Length in hexadecimal digits: 24 registers of 32 bits with xPSR, FPSCR and the masks, 16 of 64 bits.
        assert_eq!(gdb.ask("g").len(), 2 * (24 * 4 + 16 * 8));
        assert_eq!(gdb.word(0x0800_0000), stack_top, "the vector table");
        assert_eq!(gdb.word(0x0800_0004), reset | 1);
        // Reading USART1's receive register would take a byte.
        assert_eq!(&gdb.ask("m40011024,4")[..1], "E");
        let before = gdb.register(PC);
        let stepped = gdb.ask("s");
        assert!(stepped.starts_with("S05") || stepped.starts_with("T05"), "{stepped}");
        let step = gdb.register(PC).wrapping_sub(before);
        assert!(step == 2 || step == 4, "{step}");
        assert_eq!(gdb.ask(&format!("Z1,{main:x},2")), "OK");
        let stopped = gdb.ask("c");
        assert!(stopped.starts_with("T05") && stopped.contains("hwbreak"), "{stopped}");
        assert_eq!(gdb.register(PC), main);
        // `Reset` has called `main`, and keeps nothing or whole double words on the stack.
        let sp = gdb.register(SP);
        assert!(sp <= stack_top && stack_top - sp < 64 && sp.is_multiple_of(8), "{sp:#x}");
        assert_eq!(gdb.ask(&format!("M{:x},4:78563412", sp - 4)), "OK");
        assert_eq!(gdb.word(sp - 4), 0x1234_5678);
        for _ in 0..100 {
            gdb.ask("s");
        }
        assert_eq!(gdb.ask(&format!("z1,{main:x},2")), "OK");
        let time = gdb.ask(&format!("qRcmd,{}", hex("time")));
        assert!(time.starts_with('O') && text(&time[1..]).contains(" instructions, in 0 thread"), "{time}");
        assert_eq!(gdb.answer(), "OK");
        assert_eq!(gdb.ask("D"), "OK");
    });
    debugged.run_to_ns(LONG_NS);
    client.join().expect("the client's checks hold");
    assert_eq!(state.get(), State::Detached);
    let machine = debugged.board.machine();
    assert_eq!((machine.trace(), machine.instructions()), undisturbed());
}

/// Option bytes (OPTSR, RM0399 4.9.8) as the Giga is delivered, but with RDP 0xBB: readout protection level 1.
const PROTECTED: u32 = 0x0B86_BBF0;

#[test]
fn at_readout_protection_level_1_flash_is_refused_and_the_program_cannot_go_on() {
    let (mut debugged, address, _) = waiting();
    debugged.board.machine().chip.set_option_bytes(PROTECTED);
    let client = thread::spawn(move || {
        let mut gdb = Client::connect(address);
        assert!(gdb.ask("?").starts_with("T05"), "halted");
        // Both flash banks and the backup SRAM are refused; RAM and the system control space are not.
        for refused in ["m8000000,4", "m8100000,4", "m38800000,4", "M8000000,4:00000000", "M38800000,4:00000000"] {
            assert_eq!(&gdb.ask(refused)[..1], "E", "{refused}");
        }
        assert_eq!(gdb.ask("M24000000,4:78563412"), "OK");
        assert_eq!((gdb.word(0x2400_0000), gdb.word(0xE000_ED00) >> 24), (0x1234_5678, 0x41), "RAM, CPUID");
        let stopped = gdb.ask("c");
        assert!(stopped.starts_with("S06") || stopped.starts_with("T06"), "SIGABRT: {stopped}");
        let misuse = gdb.ask(&format!("qRcmd,{}", hex("misuse")));
        assert!(text(&misuse[1..]).contains("readout protection level 1"), "{}", text(&misuse[1..]));
        assert_eq!(gdb.answer(), "OK");
        gdb.ask("D");
    });
    let clock = debugged.clock.clone();
    // Virtual time passes without the processor.
    let _ = debugged.simulation.block_on(clock.sleep_until(LONG_NS));
    client.join().expect("the client's checks hold");
    let failure = debugged.board.failure();
    assert!(failure.as_deref().is_some_and(|failure| failure.contains("lock-up")), "{failure:?}");
}

#[test]
fn a_running_program_is_interrupted_and_virtual_time_stands_still() {
    let (mut debugged, address, state) = waiting();
    let client = thread::spawn(move || {
        let mut gdb = Client::connect(address);
        write!(gdb.to, "$c#63").expect("it is connected");
        gdb.to.write_all(b"\x03").expect("it is connected");
        let stopped = gdb.answer();
        assert!(stopped.starts_with("S02") || stopped.starts_with("T02"), "{stopped}");
        let mut time = || {
            let answer = gdb.ask(&format!("qRcmd,{}", hex("time")));
            assert_eq!(gdb.answer(), "OK");
            text(&answer[1..])
        };
        assert_eq!(time(), time());
        write!(gdb.to, "$k#6b").expect("it is connected");
    });
    // The machine runs until the client interrupts and kills it.
    let clock = debugged.clock.clone();
    let mut until_ns = 0;
    while state.get() != State::Killed {
        until_ns += 10_000_000;
        debugged.simulation.block_on(clock.sleep_until(until_ns)).expect("the clock does not stand still");
    }
    client.join().expect("the client's checks hold");
}

fn hex(text: &str) -> String {
    text.bytes().map(|byte| format!("{byte:02x}")).collect()
}

fn text(hex: &str) -> String {
    let byte = |at| u8::from_str_radix(&hex[at..at + 2], 16).expect("two digits");
    String::from_utf8((0..hex.len()).step_by(2).map(byte).collect()).expect("it is text")
}

#[test]
fn gdb_itself_stops_at_main_and_shows_registers_and_stack() {
    if Command::new("gdb-multiarch").arg("--version").output().is_err() {
        eprintln!("gdb-multiarch is not installed: only the protocol is tried, by another test");
        return;
    }
    let (mut debugged, address, _) = waiting();
    let [main, timer] = ["main", "TIM5"].map(|name| address_of(&debugged, name));
    let elf = debugged.image.path().to_owned();
    let gdb = thread::spawn(move || {
        let commands = [
            "set pagination off".to_owned(),
            format!("target remote {address}"),
            "hbreak *main".into(),
            "continue".into(),
            "info registers pc sp xpsr msp psp control".into(),
            "print $d0".into(),
            "x/2xw $sp".into(),
            "stepi".into(),
            format!("hbreak *{timer:#x}"),
            "continue".into(),
            "backtrace 3".into(),
            "stepi".into(),
            "monitor time".into(),
            "delete".into(),
            "detach".into(),
        ];
        let commands = commands.iter().flat_map(|command| ["-ex", command.as_str()]);
        let output = Command::new("gdb-multiarch").args(["-nx", "-batch"]).args(commands).arg(elf).output();
        output.expect("gdb-multiarch runs")
    });
    debugged.run_to_ns(LONG_NS);
    // Dropping the server ends a gdb that still waits for a breakpoint.
    drop(debugged);
    let output = gdb.join().expect("gdb ran");
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    let all = format!("{said}\n{}", String::from_utf8_lossy(&output.stderr));
    assert!(said.contains(&format!("pc             {main:#x}")), "{all}");
    assert!(said.contains("msp            0x2") && said.contains("control        0x"), "{all}");
    assert!(said.contains("$1 = ") && said.contains("main"), "{all}");
    // The interrupt is that of the firmware's timer; gdb unwinds the exception frame to the interrupted code.
    let frame = |number: &str, what: &str| said.lines().any(|line| line.starts_with(number) && line.contains(what));
    assert!(frame("#0", "TIM5") && frame("#1", "signal handler called") && frame("#2", " ("), "{all}");
    assert!(all.contains(" instructions, in 66 TIM5, awake"), "{all}");
}
