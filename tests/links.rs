//! Tests of the program on boards at the other end of links: served by `r4 sim serve`, in real time.

use std::{
    fs::{self, File, OpenOptions},
    io::{Read, Write},
    net::TcpStream,
    os::unix::fs::{OpenOptionsExt, PermissionsExt},
    path::{Path, PathBuf},
    process::{Command, Stdio},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread,
    time::{Duration, Instant},
};

use crate::program::*;
use r4_links::{Address, blocking, pty::Pty};
use r4_protocol::{
    Cause, Causes, ChannelId, ChannelKind, FrameDecoder, Mode, Refusal, Reply, Request, SafetyState, Sample, Setpoint,
    ToDevice, ToHost, encode_frame, frame::MAX_FRAME,
};
use rand_pcg::{
    Pcg32,
    rand_core::{Rng, SeedableRng},
};
use serde_json::Value;
use tempfile::TempDir;

/// Board that is served until it is dropped.
struct Served {
    #[expect(dead_code, reason = "ends the server when it is dropped")]
    server: Running,
    /// Name of the board as `--board` takes it.
    board: String,
    path: PathBuf,
}

impl Served {
    fn new(robot: &str, how: &str) -> Self {
        Self::with(&["sim", "serve", robot, how])
    }

    fn with(arguments: &[&str]) -> Self {
        let mut server = start(command(arguments));
        let first = next(server.out.as_ref().expect("stdout"), server.begin).expect("a first line");
        let place = object(&first);
        let fields = place.as_object().expect("an object");
        let (kind, at) = fields.iter().find_map(|(kind, at)| Some((kind, at.as_str()?))).expect("a place");
        let at = at.to_owned();
        let board = match kind.as_str() {
            "pty" => format!("serial:{at}"),
            "slcan" => format!("can:slcan:{at}"),
            "tcp" => format!("tcp:{at}"),
            other => panic!("served on {other}"),
        };
        // Later output is for people and is not read.
        server.out = None;
        Self { server, board, path: at.into() }
    }

    fn r4(&self, arguments: &[&str]) -> Seen {
        r4(&[&["--board", &self.board], arguments].concat())
    }

    /// Returns the output of a run that must succeed.
    fn good(&self, arguments: &[&str]) -> String {
        let seen = self.r4(arguments);
        assert!(seen.code == Some(0), "{} {arguments:?}: {seen:?}", self.board);
        seen.out
    }
}

/// Every verb that a link carries, as a user runs it.
const VERBS: [&[&str]; 18] = [
    &["info", "--json"],
    &["arm", "--for", "0.05"],
    &["disarm"],
    &["clear"],
    &["move", "osmc0", "5deg"],
    &["speed", "stepper0", "2rad/s", "--for", "0.4"],
    &["duty", "osmc1", "0.1", "--for", "0.1"],
    &["home", "stepper1", "--speed=-1.9rad/s"],
    &["step", "stepper0", "20"],
    &["servo", "servo0", "10deg", "--for", "0.1"],
    &["relay", "relay1", "on", "--for", "0.1"],
    &["bldc", "bldc0", "0.1", "--for", "0.8"],
    &["dac", "dac0", "1V", "--for", "0.1"],
    &["watch", "osmc0", "--for", "0.3", "--json"],
    &["config", "show", "osmc0"],
    &["config", "set", "osmc0.position_kp", "9.0"],
    &["faults"],
    &["uart", "0", "--write", "hello"],
];

#[test]
fn every_verb_works_on_every_kind_of_link() {
    thread::scope(|scope| {
        let sim = |how| ["sim", "serve", "every-interface", how];
        let shared = ["serve", "sim:every-interface", "--tcp", "127.0.0.1:0"];
        for how in [sim("--pty"), sim("--slcan"), sim("--tcp"), shared] {
            scope.spawn(move || {
                let served = Served::with(&how);
                let info = object(&served.good(VERBS[0]));
                assert_eq!(text(&info, "robot"), "every-interface", "{how:?}");
                for verb in &VERBS[1..] {
                    served.good(verb);
                }
            });
        }
    });
}

#[test]
fn what_is_not_there_is_named() {
    all_refused([
        (&["--board", "serial:/dev/nothing-here", "info"][..], &["/dev/nothing-here does not exist", "r4 ports"][..]),
        (&["--board", "tcp:127.0.0.1:9", "info"], &["127.0.0.1:9 does not answer"]),
        (&["--board", "can:no-such-can", "info"], &["no CAN interface no-such-can", "ip link", "can:slcan:"]),
        (&["--board", "serial:/dev/null", "scenario", "a.toml"], &["a.toml"]),
        (&["sim", "serve", "osmc-bench", "--tcp=0.0.0.0:0"], &["from other machines"]),
        (&["sim", "serve", "osmc-bench"], &["--pty"]),
        (&["serve", "sim:osmc-bench", "--tcp", "0.0.0.0:0"], &["from other machines", "--public"]),
        (&["serve", "serial:/dev/nothing-here", "--tcp", "127.0.0.1:0"], &["/dev/nothing-here does not exist"]),
        (&["serve", "sim:no-such-robot", "--tcp", "127.0.0.1:0"], &["no-such-robot"]),
        (&["--board", "emu:osmc-bench", "debug", "--gdb", "0.0.0.0:0"], &["from other machines", "--public"]),
    ]);
}

#[test]
#[cfg_attr(not(feature = "emu"), ignore = "logs of emulated boards are read by programs built with --features emu")]
fn a_simulated_board_has_no_log() {
    let served = Served::new("osmc-bench", "--pty");
    for board in [&served.board, "sim:osmc-bench"] {
        let seen = r4(&["--board", board, "--log", "info"]);
        let told = seen.err.contains("simulated board has no") && seen.err.contains("emu:osmc-bench");
        assert!(matches!(seen.code, Some(1 | 3)) && seen.out.is_empty() && told, "{board}: {seen:?}");
    }
}

#[test]
fn a_port_is_for_one_program() {
    let served = Served::new("osmc-bench", "--pty");
    let mut watching = start(command(&["--board", &served.board, "watch"]));
    next(watching.out.as_ref().expect("stdout"), watching.begin).expect("a line");
    let refused = served.r4(&["info"]);
    assert!(refused.code == Some(4) && refused.err.contains("another program"), "{refused:?}");
    watching.out = None;
}

#[test]
fn a_lost_link_comes_back_and_says_why_it_was_lost() {
    let folder = TempDir::new().expect("a folder");
    let tty = folder.path().join("tty");
    let how = format!("--pty={}", path(&tty));
    let served = Served::new("osmc-bench", &how);
    let log = folder.path().join("gap.mcap");
    let watching = start(command(&["--board", &served.board, "watch", "osmc0", "--json", "--record", path(&log)]));
    let out = watching.out.as_ref().expect("stdout");
    next(out, watching.begin).expect("a line");
    let watched = Instant::now();
    // The same as unplugging a board that USB powers, and plugging it in again.
    drop(served);
    let lost = next(&watching.err, watching.begin).expect("a word of it");
    assert!(lost.contains("link failed") || lost.contains("link lost"), "{lost}");
    let _served = Served::new("osmc-bench", &how);
    let returned = Instant::now();
    let back = next(&watching.err, watching.begin).expect("a word of it");
    let after = returned.elapsed();
    assert!(back.contains("the link is back") && back.contains("device reset"), "{back}");
    assert!(after < Duration::from_secs(1), "{after:?}");
    let line =
        std::iter::from_fn(|| next(out, watching.begin)).find(|line| object(line)["time_s"].as_f64() < Some(2.0));
    assert!(line.is_some(), "lines of the board that has started anew");

    // The recording went on, with a gap in it.
    let interrupted =
        Command::new("kill").args(["-INT", &watching.child.id().to_string()]).status().expect("kill runs");
    assert!(interrupted.success());
    assert_eq!(watching.finish().code, Some(0));
    let info = good_json(&["log", "info", path(&log), "--json"]);
    let gaps = array(&info, "gaps");
    assert_eq!((gaps.len(), &gaps[0]["restarted"]), (1, &true.into()), "{info}");
    let without_link_s = number(&gaps[0], "without_link_s");
    assert!((0.0..returned.duration_since(watched).as_secs_f64() + 1.0).contains(&without_link_s), "{without_link_s}");
    assert_eq!((&info["warnings"], &info["missing"]), (&serde_json::json!([]), &0.into()), "{info}");
    assert_eq!(info["requests"]["subscribe"], 2, "once each session");
}

/// A program that shares a board opens its lost link again, and its clients are served as before.
#[test]
fn a_shared_board_comes_back_after_its_link_was_lost() {
    let folder = TempDir::new().expect("a folder");
    let how = format!("--pty={}", path(&folder.path().join("tty")));
    let served = Served::new("osmc-bench", &how);
    let sharing = start(command(&["serve", &served.board, "--tcp", "127.0.0.1:0"]));
    let first = object(&next(sharing.out.as_ref().expect("stdout"), sharing.begin).expect("a first line"));
    let shared = format!("tcp:{}", text(&first, "tcp"));
    next(&sharing.err, sharing.begin).expect("where it is served");
    drop(served);
    let lost = next(&sharing.err, sharing.begin).expect("a lost link");
    assert!(lost.contains("link failed") || lost.contains("link lost"), "{lost}");
    let _served = Served::new("osmc-bench", &how);
    let back = next(&sharing.err, sharing.begin).expect("a link");
    assert!(back.contains("the link is back"), "{back}");
    assert_eq!(text(&good_json(&["--board", &shared, "info", "--json"]), "robot"), "osmc-bench");
    assert!(Command::new("kill").args(["-INT", &sharing.child.id().to_string()]).status().expect("kill").success());
    assert_eq!(sharing.finish().code, Some(0));
}

#[test]
fn a_name_belongs_to_one_server() {
    let folder = TempDir::new().expect("a folder");
    let name = folder.path().join("board");
    for kind in ["pty", "slcan"] {
        let how = format!("--{kind}={}", path(&name));
        let first = Served::new("osmc-bench", &how);
        for second in ["pty", "slcan"] {
            let second = r4(&["sim", "serve", "osmc-bench", &format!("--{second}={}", path(&name))]);
            let told = second.err.contains(path(&name)) && second.err.contains("another program serves");
            assert!(second.code != Some(0) && second.out.is_empty() && told, "{second:?}");
        }
        first.good(&["disarm"]);
        // A killed server leaves the name behind, and the next one takes it over.
        drop(first);
        assert!(name.is_symlink());
        Served::new("osmc-bench", &how).good(&["disarm"]);
    }
    // The server does not replace a link that it cannot have made.
    fs::remove_file(&name).expect("a name");
    std::os::unix::fs::symlink("/dev/null", &name).expect("a link");
    let refused = r4(&["sim", "serve", "osmc-bench", &format!("--pty={}", path(&name))]);
    assert!(refused.code != Some(0) && refused.err.contains("no terminal of a board"), "{refused:?}");
    assert_eq!(fs::read_link(&name).expect("still there"), Path::new("/dev/null"));
}

// Faults on the link.

/// Fault of a link.
#[derive(Clone, Copy, Debug)]
enum Fault {
    /// Every write has one byte.
    SingleBytes,
    /// Random bytes are added now and then.
    Garbage,
    /// Some bytes are lost.
    Dropped,
    /// Some bytes come twice.
    Repeated,
    /// The end of what was written together is missing now and then.
    Cut,
    /// Nothing passes for 300 ms, once a second.
    Stalls,
}

/// One write in this number is damaged. Of the three attempts that a request has, all fail once in some 10 000.
const RARELY: u32 = 40;
/// Length of a typical frame, bytes.
const BYTES: u32 = 30;

/// Line with a fault between a served board and the program that opens `board`.
struct Proxy {
    board: String,
    ended: Arc<AtomicBool>,
}

impl Drop for Proxy {
    fn drop(&mut self) {
        self.ended.store(true, Ordering::Relaxed);
    }
}

fn terminal(path: &Path) -> File {
    // 0o400 is O_NOCTTY: the terminal must not become that of the tests.
    OpenOptions::new().read(true).write(true).custom_flags(0o400).open(path).expect("the terminal opens")
}

impl Proxy {
    fn new(served: &Path, fault: Fault) -> Self {
        let pty = Pty::open().expect("a pseudo-terminal");
        let board = format!("serial:{}", pty.path().display());
        let ended = Arc::new(AtomicBool::new(false));
        let far = terminal(served);
        let (descriptor, stop) = (pty.descriptor.clone(), ended.clone());
        let mut to_board = far.try_clone().expect("a second handle");
        thread::spawn(move || {
            let mut line = Line::new(fault, 1);
            r4_links::block_on(async {
                use embedded_io_async::Read as _;
                let mut descriptor = descriptor;
                let mut buffer = [0; 512];
                while let Ok(len) = descriptor.read(&mut buffer).await {
                    for part in line.pass(&buffer[..len]) {
                        if to_board.write_all(&part).is_err() || stop.load(Ordering::Relaxed) {
                            return;
                        }
                    }
                }
            });
        });
        let stop = ended.clone();
        thread::spawn(move || {
            // Moves all of it into the thread: its client end must stay open.
            let pty = pty;
            let mut line = Line::new(fault, 2);
            let mut from_board = far;
            let mut buffer = [0; 512];
            while let Ok(len) = from_board.read(&mut buffer) {
                for mut part in line.pass(&buffer[..len]) {
                    while !part.is_empty() {
                        if stop.load(Ordering::Relaxed) {
                            return;
                        }
                        let written = pty.descriptor.try_write(&part).unwrap_or(part.len());
                        part.drain(..written);
                        if written == 0 {
                            thread::yield_now();
                        }
                    }
                }
            }
        });
        Self { board, ended }
    }
}

struct Line {
    fault: Fault,
    random: Pcg32,
    stalled: Instant,
}

impl Line {
    fn new(fault: Fault, seed: u64) -> Self {
        Self { fault, random: Pcg32::seed_from_u64(seed), stalled: Instant::now() }
    }

    fn one_in(&mut self, many: u32) -> bool {
        self.random.next_u32().is_multiple_of(many)
    }

    /// Returns the pieces that are written for bytes that were read together.
    fn pass(&mut self, bytes: &[u8]) -> Vec<Vec<u8>> {
        let fault = self.fault;
        match fault {
            Fault::SingleBytes => bytes.iter().map(|byte| vec![*byte]).collect(),
            Fault::Garbage if self.one_in(RARELY) => {
                let garbage = (0..40).map(|_| self.random.next_u32() as u8).collect();
                vec![garbage, bytes.to_vec()]
            }
            Fault::Dropped => vec![bytes.iter().copied().filter(|_| !self.one_in(RARELY * BYTES)).collect()],
            Fault::Repeated => {
                vec![
                    bytes
                        .iter()
                        .flat_map(|byte| if self.one_in(RARELY * BYTES) { vec![*byte; 2] } else { vec![*byte] })
                        .collect(),
                ]
            }
            Fault::Cut if self.one_in(RARELY) => vec![bytes[..bytes.len() / 2].to_vec()],
            Fault::Stalls if self.stalled.elapsed() > Duration::from_secs(1) => {
                // A pause of the line, which the test does not wait for.
                thread::sleep(Duration::from_millis(300));
                self.stalled = Instant::now();
                vec![bytes.to_vec()]
            }
            _ => vec![bytes.to_vec()],
        }
    }
}

#[test]
fn a_bad_line_costs_frames_and_nothing_else() {
    let faults = [Fault::SingleBytes, Fault::Garbage, Fault::Dropped, Fault::Repeated, Fault::Cut, Fault::Stalls];
    thread::scope(|scope| {
        for fault in faults {
            scope.spawn(move || {
                let served = Served::new("osmc-bench", "--pty");
                let proxy = Proxy::new(&served.path, fault);
                let on = |arguments: &[&str]| r4(&[&["--board", &proxy.board], arguments].concat());
                let seen = on(&["watch", "osmc0", "--rate", "50", "--for", "3", "--json"]);
                assert_eq!(seen.code, Some(0), "{fault:?}: {seen:?}");
                // Of 150 lines: a damaged byte costs a frame, a stall none.
                let lines = seen.out.lines().map(object).filter(|line| line["time_s"].is_number()).count();
                assert!(lines >= 90, "{fault:?}: {lines} lines");
                // Whatever is lost, a motor is where the program says, or the program says why not.
                let seen = on(&["move", "osmc0", "20deg", "--json"]);
                match seen.code {
                    Some(0) => assert!(seen.out.contains("settled"), "{fault:?}: {seen:?}"),
                    _ => assert!(seen.err.starts_with("r4: ") && !seen.err.contains("panicked"), "{fault:?}: {seen:?}"),
                }
                drop(proxy);
            });
        }
    });
}

// Another program on the CAN bus.

/// Gateway of python-can between two buses: reads every frame from one adapter and sends it by the other.
const GATEWAY: &str = r#"
import sys, can
one, other = [can.Bus(interface="slcan", channel=path, bitrate=1000000, sleep_after_open=0.05) for path in sys.argv[1:3]]
notifier = can.Notifier([], [])
import threading
def carry(source, sink):
    for frame in source:
        sink.send(can.Message(arbitration_id=frame.arbitration_id, data=frame.data, is_extended_id=False))
threading.Thread(target=carry, args=(one, other), daemon=True).start()
print("ready", flush=True)
carry(other, one)
"#;

/// Opens two pseudo-terminals, each the far end of the other.
fn null_modem() -> (PathBuf, PathBuf) {
    let (one, other) = (Pty::open().expect("a pseudo-terminal"), Pty::open().expect("a pseudo-terminal"));
    let paths = (one.path().to_owned(), other.path().to_owned());
    for (from, to) in
        [(one.descriptor.clone(), other.descriptor.clone()), (other.descriptor.clone(), one.descriptor.clone())]
    {
        thread::spawn(move || {
            r4_links::block_on(async {
                use embedded_io_async::{Read as _, Write as _};
                let (mut from, mut to) = (from, to);
                let mut buffer = [0; 512];
                while let Ok(len) = from.read(&mut buffer).await {
                    if to.write_all(&buffer[..len]).await.is_err() {
                        return;
                    }
                }
            });
        });
    }
    // Kept for the rest of the test's process: their client ends must stay open.
    std::mem::forget((one, other));
    paths
}

#[test]
fn python_can_understands_what_we_send_and_we_what_it_sends() {
    // Debian's packages belong to Debian's Python, whichever comes first in PATH.
    let has_can = |python: &&str| {
        let tried = Command::new(python).args(["-c", "import can, serial"]).stderr(Stdio::null()).status();
        tried.is_ok_and(|status| status.success())
    };
    let Some(python) = ["python3", "/usr/bin/python3"].into_iter().find(has_can) else {
        eprintln!("not run: python3 has no python-can (Debian: python3-can)");
        return;
    };
    let served = Served::new("openscout", "--slcan");
    let (ours, gateway) = null_modem();
    let mut python = Command::new(python);
    python.args(["-c", GATEWAY, path(&gateway), path(&served.path)]);
    let python = start(python);
    let ready = next(python.out.as_ref().expect("stdout"), python.begin);
    assert_eq!(ready.as_deref(), Some("ready"), "{}", rest(&python.err, python.begin));
    let board = format!("can:slcan:{}", path(&ours));
    let seen = r4(&["--board", &board, "info", "--json"]);
    assert_eq!(seen.code, Some(0), "{seen:?}");
    assert_eq!(object(&seen.out)["robot"], Value::from("openscout"));
    let seen = r4(&["--board", &board, "duty", "dhb0", "30%", "--for", "0.3"]);
    assert_eq!(seen.code, Some(0), "{seen:?}");
}

#[test]
fn without_the_key_nothing_is_told() {
    let folder = TempDir::new().expect("a folder");
    let key = |name: &str, digits: &str| {
        let file = folder.path().join(name);
        fs::write(&file, digits.repeat(32)).expect("written");
        fs::set_permissions(&file, fs::Permissions::from_mode(0o600)).expect("for the owner alone");
        path(&file).to_owned()
    };
    let (ours, theirs) = (key("ours", "5a"), key("theirs", "5b"));
    // Listens on every address of this machine, as a robot in a laboratory would.
    let served = Served::with(&["sim", "serve", "osmc-bench", "--tcp=0.0.0.0:0", "--public", "--key", &ours]);
    let served = Served { board: served.board.replace("0.0.0.0", "127.0.0.1"), ..served };
    served.good(&["--key", &ours, "move", "osmc0", "5deg"]);
    for arguments in [&["--key", &theirs, "info"][..], &["info"]] {
        let refused = served.r4(arguments);
        assert!(refused.code == Some(4) && refused.out.is_empty(), "{refused:?}");
    }
    // The server must not answer a single byte to any input, here as many bytes as a client's part of the handshake.
    let mut stranger = TcpStream::connect(served.board.trim_start_matches("tcp:")).expect("connects");
    stranger.write_all(&[0; 48]).expect("written");
    let mut heard = Vec::new();
    // A reset is as good as an end of the connection.
    let _ = stranger.read_to_end(&mut heard);
    assert!(heard.is_empty(), "{heard:?}");
    fs::set_permissions(&ours, fs::Permissions::from_mode(0o644)).expect("for everybody");
    let refused = served.r4(&["--key", &ours, "info"]);
    assert!(refused.err.contains("chmod 600"), "{refused:?}");
}

/// Connects silent strangers to servers with and without a key: they must not delay others. Served one after the other
/// they would, for 40 s.
#[test]
fn idle_strangers_hold_nobody_up() {
    let folder = TempDir::new().expect("a folder");
    let key = folder.path().join("key");
    fs::write(&key, "5a".repeat(32)).expect("written");
    fs::set_permissions(&key, fs::Permissions::from_mode(0o600)).expect("for the owner alone");
    for key in [&["--key", path(&key)][..], &[]] {
        let served = Served::with(&[&["sim", "serve", "osmc-bench", "--tcp"], key].concat());
        let connect = || TcpStream::connect(served.board.trim_start_matches("tcp:")).expect("connects");
        let mut idle: Vec<_> = (0..20).map(|_| connect()).collect();
        let begin = Instant::now();
        served.good(&[key, &["info"]].concat());
        assert!(begin.elapsed() < Duration::from_secs(15), "{:?}", begin.elapsed());
        // The server drops them without a byte.
        for stranger in &mut idle {
            let mut heard = Vec::new();
            let _ = stranger.read_to_end(&mut heard);
            assert!(heard.is_empty(), "{heard:?}");
        }
    }
}

/// Half a frame and noise of a client that is gone do not reach the next client. While one client has the board,
/// another is refused because it is in use.
#[test]
fn clients_of_a_socket_do_not_disturb_each_other() {
    let served = Served::new("osmc-bench", "--tcp");
    let connect = || TcpStream::connect(served.board.trim_start_matches("tcp:")).expect("connects");
    let noise: Vec<u8> = (1..=255).cycle().take(5000).collect();
    for said in [&b"\x05half a frame"[..], &noise, &[0; 700]] {
        connect().write_all(said).expect("written");
        served.good(&["info"]);
    }
    let mut watching = start(command(&["--board", &served.board, "watch"]));
    next(watching.out.as_ref().expect("stdout"), watching.begin).expect("a line");
    let mut noisy = connect();
    noisy.write_all(&noise).expect("written");
    let refused = served.r4(&["info"]);
    assert!(refused.code == Some(4) && refused.err.contains("another host"), "{refused:?}");
    // The first client goes on undisturbed.
    next(watching.out.as_ref().expect("stdout"), watching.begin).expect("a line");
    watching.out = None;
    drop(watching);
    served.good(&["info"]);
}

/// A stop needs no session, neither before there is one nor beside that of another client, whose answers stay its own.
#[test]
fn any_client_of_a_socket_stops_the_board() {
    let served = Served::new("osmc-bench", "--tcp");
    let asked = |request, seq| {
        let mut stranger = TcpStream::connect(served.board.trim_start_matches("tcp:")).expect("connects");
        let message = ToDevice::Request { seq, request };
        stranger.write_all(encode_frame(&message, &mut [0; MAX_FRAME]).expect("it fits")).expect("written");
        let mut decoder = FrameDecoder::new();
        let mut byte = [0];
        let answer = loop {
            stranger.read_exact(&mut byte).expect("an answer");
            if let Some(message) = decoder.push::<ToHost>(byte[0]) {
                break message.expect("a whole frame");
            }
        };
        let ToHost::Response { seq: of, result } = answer else { panic!("{answer:?}") };
        assert_eq!(of, seq);
        result
    };
    let stopped = Causes::only(Cause::HostStop);
    assert_eq!(asked(Request::Arm, 1), Err(Refusal::NoSession));
    assert_eq!(asked(Request::Stop, 2), Ok(Reply::Done));

    let address: Address = served.board.parse().expect("an address");
    let board = blocking::Board::connect(&address, None).expect("connects");
    assert_eq!((board.info().state, board.info().causes), (SafetyState::Tripped, stopped));
    let motor = ChannelId::new(ChannelKind::Osmc, 0);
    let mut samples = board.samples(&[motor], 10).expect("subscribes");
    board.clear().expect("clears");
    board.arm().expect("arms");
    board.set(motor, Setpoint { mode: Mode::Speed, value: 1.0 }).expect("accepted");
    let mut duty = || match samples.next().expect("a sample").expect("the link lasts").1 {
        Sample::Motor { duty, .. } => duty,
        other => panic!("{other:?}"),
    };
    assert!((0..500).any(|_| duty() != 0.0), "it turns");
    assert_eq!(asked(Request::Disarm, 3), Err(Refusal::InUse));
    assert_eq!(asked(Request::Bye, 4), Ok(Reply::Done));
    assert_ne!(duty(), 0.0, "neither ends what the host does");
    // A number that is the host's own as well.
    for seq in 0..20 {
        assert_eq!(asked(Request::Stop, seq), Ok(Reply::Done));
    }
    assert!((0..500).any(|_| duty() == 0.0), "it is switched off");
    assert_eq!(board.arm(), Err(r4_driver::Error::Refused(Refusal::Tripped { causes: stopped })));
    board.clear().expect("clears");
    board.arm().expect("arms");
}

/// A board behind a pseudo-terminal, which only one program can open, is shared among three.
#[test]
fn a_shared_board_is_recorded_whoever_commands_it() {
    let folder = TempDir::new().expect("a folder");
    let terminal = Served::new("osmc-bench", "--pty");
    let shared = Served::with(&["serve", &terminal.board, "--tcp", "127.0.0.1:0"]);
    let log = folder.path().join("run.mcap");
    let recording = start(command(&["--board", &shared.board, "log", "record", "osmc0", "--out", path(&log)]));
    shared.good(&["move", "osmc0", "20deg"]);
    let mut watching = start(command(&["--board", &shared.board, "watch", "osmc0", "--json"]));
    next(watching.out.as_ref().expect("stdout"), watching.begin).expect("a line");
    // The commanding client is killed while the motor turns.
    let driving = start(command(&["--board", &shared.board, "speed", "osmc0", "1rad/s", "--for", "30"]));
    let turning = |line: &String| object(line)["channels"][0]["duty"].as_f64() > Some(0.05);
    let turns = std::iter::from_fn(|| next(watching.out.as_ref().expect("stdout"), watching.begin)).find(turning);
    assert!(turns.is_some());
    let refused = shared.r4(&["move", "osmc0", "0deg"]);
    assert!(refused.code == Some(4) && refused.err.contains("another host commands"), "{refused:?}");
    drop(driving);
    let tripped = std::iter::from_fn(|| next(watching.out.as_ref().expect("stdout"), watching.begin))
        .find(|line| object(line)["state"] == "tripped")
        .expect("it trips");
    assert_eq!(object(&tripped)["causes"], serde_json::json!(["link lost"]), "{tripped}");
    watching.out = None;
    drop(watching);
    let interrupted =
        Command::new("kill").args(["-INT", &recording.child.id().to_string()]).status().expect("kill runs");
    assert!(interrupted.success());
    assert_eq!(recording.finish().code, Some(0));
    let info = good_json(&["log", "info", path(&log), "--json"]);
    assert_eq!((&info["warnings"], &info["missing"]), (&serde_json::json!([]), &0.into()), "{info}");
    assert_eq!(array(&info, "gaps").len(), 0, "{info}");
}

/// A key that comes through a pipe may take its time, and the user can interrupt the wait.
#[test]
fn waiting_for_a_key_can_be_interrupted() {
    let folder = TempDir::new().expect("a folder");
    let pipe = folder.path().join("key");
    let made = Command::new("mkfifo").args(["-m", "600"]).arg(&pipe).status().expect("mkfifo runs");
    assert!(made.success());
    let arguments = ["--board", "tcp:127.0.0.1:9", "--key", path(&pipe), "info"];
    let mut waiting = start(command(&arguments));
    // 0o4000 is O_NONBLOCK: opening for writing succeeds only once the program reads the pipe.
    let opened = || OpenOptions::new().write(true).custom_flags(0o4000).open(&pipe).ok();
    let _writer = loop {
        assert!(waiting.child.try_wait().expect("asked").is_none(), "it waits");
        if let Some(writer) = opened() {
            break writer;
        }
        thread::yield_now();
    };
    let interrupted = Command::new("kill").args(["-INT", &waiting.child.id().to_string()]).status().expect("kill runs");
    assert!(interrupted.success());
    let code = waiting.child.wait().expect("it ends").code();
    assert!(code.is_some_and(|code| code != 0), "{code:?}");
}

#[test]
fn a_program_that_waits_drives_a_board() {
    let served = Served::new("osmc-bench", "--pty");
    let address: Address = served.board.parse().expect("an address");
    let board = blocking::Board::connect(&address, None).expect("connects");
    let motor = ChannelId::new(ChannelKind::Osmc, 0);
    let position = |sample: &Sample| matches!(sample, Sample::Motor { channel, .. } if *channel == motor);
    let mut samples = board.samples(&[motor], 10).expect("subscribes");
    assert!(position(&samples.next().expect("a sample").expect("the link lasts").1));
    board.arm().expect("arms");
    // A thread that waits for a motor does not block another.
    let moved = thread::scope(|scope| {
        let moving = scope.spawn(|| board.move_to(motor, 3.0, 10.0));
        samples.by_ref().take(20).for_each(|sample| assert!(sample.is_ok()));
        board.stop().expect("stops");
        moving.join().expect("no panic")
    });
    assert!(matches!(moved, Err(r4_driver::Error::Stopped { .. })), "{moved:?}");
    assert_eq!(board.call(|board| Box::pin(board.faults())).map(|faults| faults.len()), Ok(1));
    drop(board);
    assert!(samples.find(Result::is_err).is_none(), "they end with the session");
    // The session was closed properly: another one opens at once.
    assert_eq!(served.r4(&["disarm"]).code, Some(0));
}
