//! Tests of the program on CAN interfaces, with boards that it serves there. Few kernels on which tests run have any. A
//! virtual machine therefore starts one that has: Debian's, with this very test in its file system, which does the rest
//! in there.
//!
//! Its parts are looked for in the folder `guest` of cargo's target folder, where `.ci/run` puts them:
//! `boot/vmlinuz-*`, `lib/modules/*` with can, can-raw, can-dev and vcan, and `bin/busybox`. `qemu-system-x86_64` is a
//! program of this machine. Without them the test prints that it did not run.

#![cfg(target_os = "linux")]

use std::{
    collections::BTreeMap,
    env, fs,
    io::{self, Write},
    os::fd::OwnedFd,
    path::{Path, PathBuf},
    process::Command,
    sync::mpsc::RecvTimeoutError,
    thread,
    time::{Duration, Instant},
};

use crate::program::{self, *};
use r4_driver::{Board, with_board};
use r4_links::{Address, Descriptor, Link, RealClock, Receiver, Transmitter, bus::End, slcan};
use r4_protocol::{
    ChannelId, Mode, Sample,
    can::{Node, SETPOINTS},
    cycle::DUTY_SCALE,
};
use socketcan::{CanAnyFrame, CanDataFrame, CanFdSocket, EmbeddedFrame, Id, Socket, StandardId};

/// Time-out of the machine: one that takes longer hangs. On an otherwise idle host it needs one minute.
const MACHINE: Duration = Duration::from_secs(300);

/// Last line on the console of the machine when all is well.
const WELL: &str = "guest: 0";

// Outside of the machine.

#[test]
fn boards_on_can_interfaces_work() {
    let image = match Parts::find() {
        Ok(parts) => parts.image(),
        Err(missing) => {
            // Written to stderr directly: the harness keeps the output of tests that pass to itself.
            let _ = writeln!(io::stderr(), "boards_on_can_interfaces_work: not run: {missing}");
            return;
        }
    };
    let folder = tempfile::TempDir::new().expect("a folder");
    let initrd = folder.path().join("initrd");
    fs::write(&initrd, image.files).expect("written");
    let mut qemu = Command::new("qemu-system-x86_64");
    // Without hardware virtualisation (KVM): a machine that is virtual itself may offer it and hang with it.
    qemu.args(["-accel", "tcg", "-cpu", "max", "-m", "1024"])
        // The clock counts instructions, 2^2 ns each, and skips idle time, so that load on the host does not change the
        // result. In real time a board that gets no processor for 0.1 s refuses set points as ahead of its clock, or
        // trips.
        .args(["-icount", "shift=2,sleep=off"])
        .args(["-nodefaults", "-display", "none", "-serial", "stdio", "-no-reboot", "-kernel"])
        .arg(&image.kernel)
        .arg("-initrd")
        .arg(&initrd)
        .args(["-append", "console=ttyS0 quiet loglevel=1 panic=-1"]);
    let machine = start(qemu);
    let console = machine.out.as_ref().expect("stdout");
    let mut seen = String::new();
    loop {
        match console.recv_timeout(MACHINE.saturating_sub(machine.begin.elapsed())) {
            Ok(line) => {
                println!("{:6.1} s: {}", machine.begin.elapsed().as_secs_f64(), line.trim_end());
                seen.extend([line.trim_end(), "\n"]);
            }
            Err(RecvTimeoutError::Disconnected) => break,
            Err(RecvTimeoutError::Timeout) => panic!("the machine still runs after {MACHINE:?}:\n{seen}"),
        }
    }
    let words = rest(&machine.err, Instant::now());
    assert!(seen.lines().any(|line| line == WELL), "{seen}\n{words}");
    let counts = seen.lines().find(|line| line.starts_with("test result: ok.")).expect("the harness ran");
    assert!(!counts.contains(" 0 passed"), "{counts}");
}

/// Parts of the virtual machine.
struct Parts {
    kernel: PathBuf,
    /// Kernel modules, in the order of loading.
    modules: Vec<PathBuf>,
    busybox: PathBuf,
}

struct Image {
    kernel: PathBuf,
    /// Initial file system, as the kernel unpacks it.
    files: Vec<u8>,
}

impl Parts {
    fn find() -> Result<Self, String> {
        if env::consts::ARCH != "x86_64" {
            return Err("the machine is for programs of x86-64".into());
        }
        if Command::new("qemu-system-x86_64").arg("--version").output().is_err() {
            return Err("there is no qemu-system-x86_64".into());
        }
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).with_file_name("guest");
        let missing = |what: &str| format!("there is no {what} in {}", folder.display());
        let kernel = fs::read_dir(folder.join("boot")).ok().and_then(|found| {
            found.flatten().map(|file| file.path()).find(|path| path.to_string_lossy().contains("/vmlinuz"))
        });
        let busybox = folder.join("bin/busybox");
        let mut all = BTreeMap::new();
        modules_in(&folder.join("lib/modules"), &mut all);
        let mut modules = Vec::new();
        for name in ["can_raw", "vcan"] {
            load(name, &all, &mut modules).map_err(|name| missing(&format!("module {name}")))?;
        }
        Ok(Self {
            kernel: kernel.ok_or_else(|| missing("boot/vmlinuz"))?,
            modules,
            busybox: busybox.is_file().then_some(busybox).ok_or_else(|| missing("bin/busybox"))?,
        })
    }

    /// Makes the machine's files: this test, the program, their libraries, and the script that starts the test.
    fn image(&self) -> Image {
        let (r4, test) = (Path::new(env!("CARGO_BIN_EXE_r4")), env::current_exe().expect("a path"));
        let mut files = Archive::default();
        files.add(Path::new("/bin/busybox"), &fs::read(&self.busybox).expect("busybox"));
        for program in [r4, &test] {
            files.add(program, &fs::read(program).expect("the program"));
            for library in libraries(program) {
                files.add(&library, &fs::read(&library).expect("a library"));
            }
        }
        let mut insert = String::new();
        for (number, module) in self.modules.iter().enumerate() {
            let to = format!("/modules/{number}.ko");
            files.add(Path::new(&to), &fs::read(module).expect("a module"));
            insert += &format!("insmod {to} || echo cannot load {}\n", module.display());
        }
        let (test, folder) = (test.display(), env!("CARGO_TARGET_TMPDIR"));
        let init = format!(
            "#!/bin/busybox sh\n\
             /bin/busybox mkdir -p /proc /sys /dev /tmp {folder}\n\
             /bin/busybox --install -s /bin\n\
             export PATH=/bin\n\
             mount -t proc none /proc\n\
             mount -t sysfs none /sys\n\
             mount -t devtmpfs none /dev\n\
             exec </dev/console >/dev/console 2>&1\n\
             {insert}\
             ip link set lo up\n\
             for name in classic0 fd0 down0; do ip link add $name type vcan; done\n\
             ip link set classic0 mtu 16\n\
             ip link set fd0 mtu 72\n\
             ip link set classic0 up\n\
             ip link set fd0 up\n\
             {test} can:: --ignored --nocapture --test-threads=1\n\
             echo guest: $?\n\
             poweroff -f\n"
        );
        files.add(Path::new("/init"), init.as_bytes());
        Image { kernel: self.kernel.clone(), files: files.end() }
    }
}

/// Finds all modules below a folder, by the names that they use for each other.
fn modules_in(folder: &Path, all: &mut BTreeMap<String, PathBuf>) {
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let path = entry.path();
        if path.is_dir() {
            modules_in(&path, all);
        } else if path.extension().is_some_and(|extension| extension == "ko") {
            let name = path.file_stem().expect("it has an extension").to_string_lossy().replace('-', "_");
            all.insert(name, path);
        }
    }
}

/// Adds a module after those that it needs; the error is the name of the first missing one.
fn load(name: &str, all: &BTreeMap<String, PathBuf>, order: &mut Vec<PathBuf>) -> Result<(), String> {
    let path = all.get(name).ok_or(name)?;
    let module = fs::read(path).map_err(|_| name)?;
    // Dependencies are strings of the section .modinfo.
    for text in module.split(|byte| *byte == 0) {
        let needed = text.strip_prefix(b"depends=").and_then(|names| std::str::from_utf8(names).ok());
        for needed in needed.unwrap_or_default().split(',').filter(|name| !name.is_empty()) {
            load(&needed.replace('-', "_"), all, order)?;
        }
    }
    if !order.contains(path) {
        order.push(path.clone());
    }
    Ok(())
}

/// Returns the libraries that a program is started with, and its dynamic loader.
fn libraries(program: &Path) -> Vec<PathBuf> {
    let listed = Command::new("ldd").arg(program).output().expect("ldd");
    let listed = String::from_utf8(listed.stdout).expect("text");
    listed.split_whitespace().filter(|word| word.starts_with('/')).map(PathBuf::from).collect()
}

/// Archive of files as the kernel unpacks it ("newc"; its documentation, driver-api/early-userspace/buffer-format).
#[derive(Default)]
struct Archive {
    bytes: Vec<u8>,
    added: Vec<PathBuf>,
}

impl Archive {
    fn add(&mut self, path: &Path, content: &[u8]) {
        const FOLDER: u32 = 0o040_755;
        const PROGRAM: u32 = 0o100_755;
        let folders: Vec<_> = path.ancestors().skip(1).filter(|folder| folder.parent().is_some()).collect();
        for folder in folders.into_iter().rev() {
            self.entry(folder, FOLDER, &[]);
        }
        self.entry(path, PROGRAM, content);
    }

    fn entry(&mut self, path: &Path, mode: u32, content: &[u8]) {
        if self.added.iter().any(|added| added == path) {
            return;
        }
        self.added.push(path.to_owned());
        self.record(program::path(path).trim_start_matches('/'), mode, content);
    }

    fn record(&mut self, name: &str, mode: u32, content: &[u8]) {
        let ino = self.added.len();
        let (size, name_size) = (content.len(), name.len() + 1);
        // The fields are: number, mode, user, group, links, time, size, devices, length of the name, checksum.
        self.bytes.extend(format!("070701{ino:08X}{mode:08X}").bytes());
        self.bytes.extend(format!("{:08X}{:08X}{:08X}{:08X}{size:08X}", 0, 0, 1, 0).bytes());
        self.bytes.extend(format!("{:032X}{name_size:08X}{:08X}{name}\0", 0, 0).bytes());
        self.fill();
        self.bytes.extend(content);
        self.fill();
    }

    fn fill(&mut self) {
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
    }

    fn end(mut self) -> Vec<u8> {
        self.record("TRAILER!!!", 0, &[]);
        self.bytes
    }
}

/// The error message on a machine without CAN.
#[test]
fn an_interface_that_is_not_there_is_named_with_what_to_do() {
    all_refused([
        (&["--board", "can:no-such-can0", "info"][..], &["no CAN interface no-such-can0", "ip link", "can:slcan:"][..]),
        (&["--board", "can:lo#3", "info"], &["no CAN"]),
        (&["sim", "serve", "openscout", "--can", "no-such-can0"], &["no CAN interface no-such-can0", "ip link"]),
        (&["sim", "serve", "openscout", "--can", "lo", "--node", "128"], &["128", "--node"]),
        (&["sim", "serve", "openscout", "--tcp", "--node", "1"], &["--slcan", "--can"]),
    ]);
}

/// Does the same as `a_frame_of_set_points_turns_a_motor` does on an interface.
#[test]
fn a_frame_of_set_points_turns_a_motor_behind_an_adapter() {
    let served = Served::new(&["openscout", "--slcan", "--node", "5"]);
    let port = fs::OpenOptions::new().read(true).write(true).open(&served.at).expect("the adapter");
    r4_links::block_on(async {
        let port = Descriptor::new(OwnedFd::from(port)).expect("a terminal");
        let (rx, tx) = slcan::ends(port.clone(), End::Host(Node::new(5).expect("in range")));
        let link = Link { rx: Receiver::Slcan(rx), tx: Transmitter::Slcan(tx) };
        let send = |data: [u8; SETPOINTS]| {
            let line = slcan::Frame::new(0x105, &data).expect("good").line();
            assert_eq!(port.try_write(line.as_bytes()).ok(), Some(line.len()));
        };
        with_board(link.rx, link.tx, RealClock, async |board| turns(board, send).await).await.expect("a session");
    });
}

// On either side.

/// Board that is served until it is dropped.
struct Served {
    #[expect(dead_code, reason = "ends the server when it is dropped")]
    server: Running,
    at: String,
}

impl Served {
    fn new(arguments: &[&str]) -> Self {
        let mut server = start(command(&[&["sim", "serve"], arguments].concat()));
        let Some(first) = next(server.out.as_ref().expect("stdout"), server.begin) else {
            panic!("{arguments:?}: {:?}", server.finish())
        };
        let place = object(&first);
        let at = place
            .as_object()
            .and_then(|place| place.values().find_map(|value| value.as_str()))
            .expect("a place")
            .to_owned();
        server.out = None;
        Self { server, at }
    }
}

/// Turns a motor by frames of set points alone, until they end.
async fn turns(board: &Board<RealClock>, send: impl Fn([u8; SETPOINTS])) {
    let motor: ChannelId = "dhb0".parse().expect("a channel");
    let mut samples = board.samples(motor, 10).await.expect("subscribed");
    board.arm().await.expect("armed");
    let cycles = board.stream(&[(motor, Mode::Duty)], 100).await.expect("bound");
    let channel = board.channel(motor).expect("it is there").clone();
    let mut data = [0; SETPOINTS];
    data[..2].copy_from_slice(&((0.3 / DUTY_SCALE) as i16).to_le_bytes());
    let (mut turned, mut sent) = (0.0, 0);
    while turned < 1.0 {
        send(data);
        sent += 1;
        let sample = samples.next().await.expect("the link holds");
        turned = sample.position(&channel).expect("an encoder");
        assert!(sent < 1000, "{turned} rad after 10 s");
    }
    // Only frames of set points drive the motor: without them it stops, and the session goes on.
    let stopped = async {
        loop {
            let sample = samples.next().await.expect("the link holds");
            if matches!(sample.sample, Sample::Motor { duty, .. } if duty == 0.0) {
                return sample.device_us;
            }
        }
    };
    let last_us = board.device_us();
    let after_us = stopped.await.saturating_sub(last_us);
    assert!(after_us < 1_000_000, "it stopped after {after_us} us");
    assert_eq!(cycles.counters().sent, 0, "nothing else was sent");
    drop(cycles);
    board.disarm().await.expect("disarmed");
}

// Inside of the machine.

/// Receiver of all frames on a bus.
struct Sniffer(CanFdSocket);

impl Sniffer {
    fn new(interface: &str) -> Self {
        let socket = CanFdSocket::open(interface).expect("the interface");
        socket.set_nonblocking(true).expect("set");
        Self(socket)
    }

    /// Returns the frames that have passed: identifier, and true for CAN FD.
    fn seen(&self) -> Vec<(u16, bool)> {
        let frames = std::iter::from_fn(|| self.0.read_frame().ok());
        frames
            .map(|frame| match (frame.id(), &frame) {
                (Id::Standard(identifier), CanAnyFrame::Normal(_)) => (identifier.as_raw(), false),
                (Id::Standard(identifier), CanAnyFrame::Fd(_)) => (identifier.as_raw(), true),
                _ => panic!("{frame:?}"),
            })
            .collect()
    }
}

fn good_on(board: &str, arguments: &[&str]) -> String {
    good(&[&["--board", board], arguments].concat())
}

#[test]
#[ignore = "needs the interfaces of the virtual machine"]
fn a_board_is_driven_in_classic_frames() {
    let _served = Served::new(&["openscout", "--can", "classic0"]);
    let sniffer = Sniffer::new("classic0");
    assert_eq!(text(&object(&good_on("can:classic0", &["info", "--json"])), "robot"), "openscout");
    let seen = sniffer.seen();
    assert!(seen.iter().all(|(identifier, fd)| [0x200, 0x280].contains(identifier) && !fd), "{seen:?}");
    good_on("can:classic0", &["move", "dhb0", "30deg"]);
    good_on("can:classic0", &["watch", "dhb1", "--for", "0.3", "--json"]);
}

#[test]
#[ignore = "needs the interfaces of the virtual machine"]
fn a_board_is_driven_in_frames_of_can_fd() {
    let _served = Served::new(&["openscout", "--can", "fd0", "--node", "127"]);
    let sniffer = Sniffer::new("fd0");
    assert_eq!(text(&object(&good_on("can:fd0#127", &["info", "--json"])), "robot"), "openscout");
    let seen = sniffer.seen();
    let (to_board, to_host): (Vec<(u16, bool)>, Vec<_>) = seen.iter().partition(|(identifier, _)| *identifier == 0x27F);
    assert!(to_host.iter().all(|frame| *frame == (0x2FF, true)), "{seen:?}");
    // The first frames to the board are classic, the later ones CAN FD.
    assert_eq!(to_board.first(), Some(&(0x27F, false)), "{seen:?}");
    assert_eq!(to_board.last(), Some(&(0x27F, true)), "{seen:?}");
    assert!(to_board.is_sorted_by_key(|(_, fd)| *fd), "{seen:?}");
    good_on("can:fd0#127", &["move", "dhb0", "30deg"]);
    good_on("can:fd0#127", &["watch", "dhb1", "--for", "0.3", "--json"]);
}

#[test]
#[ignore = "needs the interfaces of the virtual machine"]
fn boards_on_one_bus_are_driven_at_once() {
    let _one = Served::new(&["openscout", "--can", "classic0", "--node", "1"]);
    let _other = Served::new(&["osmc-bench", "--can", "classic0", "--node", "2"]);
    thread::scope(|scope| {
        for (board, robot, motor) in
            [("can:classic0#1", "openscout", "dhb0"), ("can:classic0#2", "osmc-bench", "osmc0")]
        {
            scope.spawn(move || {
                assert_eq!(text(&object(&good_on(board, &["info", "--json"])), "robot"), robot);
                good_on(board, &["move", motor, "30deg"]);
            });
        }
    });
    let seen = r4(&["--board", "can:classic0#3", "info"]);
    assert!(seen.code == Some(4) && seen.err.contains("did not answer"), "{seen:?}");
}

#[test]
#[ignore = "needs the interfaces of the virtual machine"]
fn a_frame_of_set_points_turns_a_motor() {
    for interface in ["classic0", "fd0"] {
        let _served = Served::new(&["openscout", "--can", interface, "--node", "5"]);
        let address: Address = format!("can:{interface}#5").parse().expect("an address");
        let socket = CanFdSocket::open(interface).expect("the interface");
        let send = |data: [u8; SETPOINTS]| {
            let frame = CanDataFrame::new(StandardId::new(0x105).expect("11 bits"), &data).expect("8 bytes");
            socket.write_frame(&CanAnyFrame::Normal(frame)).expect("sent");
        };
        r4_links::block_on(async {
            let link = r4_links::open(&address, None).await.expect("a link");
            with_board(link.rx, link.tx, RealClock, async |board| turns(board, send).await).await.expect("a session");
        });
    }
}

#[test]
#[ignore = "needs the interfaces of the virtual machine"]
fn a_lost_interface_is_told_and_comes_back() {
    let set = |state| assert!(Command::new("ip").args(["link", "set", "fd0", state]).status().expect("ip").success());
    let served = Served::new(&["osmc-bench", "--can", "fd0"]);
    let watching = start(command(&["--board", "can:fd0", "watch", "osmc0", "--json"]));
    let out = watching.out.as_ref().expect("stdout");
    next(out, watching.begin).expect("a line");
    set("down");
    let lost = next(&watching.err, watching.begin).expect("a word of it");
    assert!(lost.contains("link failed"), "{lost}");
    drop(served);
    set("up");
    let _served = Served::new(&["osmc-bench", "--can", "fd0"]);
    let back = next(&watching.err, watching.begin).expect("a word of it");
    assert!(back.contains("the link is back") && back.contains("device reset"), "{back}");
}

#[test]
#[ignore = "needs the interfaces of the virtual machine"]
fn what_is_wrong_with_an_interface_is_told() {
    all_refused([
        (&["--board", "can:down0", "info"][..], &["down0 is down", "ip link set down0 up type can"][..]),
        (&["sim", "serve", "openscout", "--can", "down0"], &["down0 is down"]),
        (&["--board", "can:lo", "info"], &["lo is no CAN interface"]),
        (&["--board", "can:fd1", "info"], &["no CAN interface fd1"]),
    ]);
}
