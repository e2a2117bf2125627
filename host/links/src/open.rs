//! Opens the link that an [`Address`] names.

use std::{
    io,
    net::{SocketAddr, TcpStream, ToSocketAddrs},
    path::PathBuf,
    time::Duration,
};

use async_io::Timer;
use embedded_io_async::{ErrorType, Read, Write};
use futures::future::{Either, select};

#[cfg(unix)]
use crate::serial;
use crate::{Address, CanInterface, DEFAULT_BAUD, Descriptor, Key, ports, secure, slcan};
#[cfg(target_os = "linux")]
use crate::{bus, can};

/// Time limit for a connection, and for the handshake with a key.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(3);

/// Both halves of a link, for [`r4_driver::with_board`].
#[derive(Debug)]
pub struct Link {
    /// Half that receives from the board.
    pub rx: Receiver,
    /// Half that sends to the board.
    pub tx: Transmitter,
}

/// Receiving half of a link.
#[derive(Debug)]
pub enum Receiver {
    /// Plain bytes of a serial port or socket.
    Bytes(Descriptor),
    /// Frames through an slcan adapter.
    Slcan(slcan::Receiver),
    /// Frames through a network interface of Linux.
    #[cfg(target_os = "linux")]
    Can(can::Receiver),
    /// Encrypted records that only holders of the key can make.
    Secure(secure::Receiver),
}

/// Transmitting half of a link.
#[derive(Debug)]
pub enum Transmitter {
    /// Plain bytes of a serial port or socket.
    Bytes(Descriptor),
    /// Frames through an slcan adapter.
    Slcan(slcan::Transmitter),
    /// Frames through a network interface of Linux.
    #[cfg(target_os = "linux")]
    Can(can::Transmitter),
    /// Encrypted records that only holders of the key can make.
    Secure(secure::Transmitter),
}

/// Reason why a link could not be opened.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// `serial:auto` found no port of a board.
    #[error("no board is connected by USB: `r4 ports` lists what there is; a port is named as in serial:/dev/ttyACM0")]
    NoBoard,
    /// `serial:auto` found several boards.
    #[error("several boards are connected, at {}: name one, as in serial:{}", names(.0), .0[0].display())]
    SeveralBoards(Vec<PathBuf>),
    /// The serial port does not exist.
    #[error("{} does not exist: `r4 ports` lists what there is", .0.display())]
    NoPort(PathBuf),
    /// Another program has opened the port.
    #[error("{} is used by another program: end that, or connect to the board through it", .0.display())]
    Busy(PathBuf),
    /// The user lacks permission to open it.
    #[error("this user may not open {}: install the rule host/udev/70-r4.rules as docs/program.md says, or join the group that owns it (`ls -l {}`), as in `sudo usermod -aG dialout $USER`, and log in again", .0.display(), .0.display())]
    Denied(PathBuf),
    /// Serial ports are pollable on Unix only.
    #[cfg(not(unix))]
    #[error("{}: serial ports are not opened on this system yet: use a board over TCP, or run r4 in WSL 2 with the port attached by usbipd", .0.display())]
    NoSerialPorts(PathBuf),
    /// The host name has no address.
    #[error("no address is known for {0}")]
    NoHost(String),
    /// The host does not answer or refuses the connection.
    #[error("{0} does not answer: is the board served there, and the port open?")]
    NoAnswer(String),
    /// The other end does not have the key, or does not use one.
    #[error("{what}: {reason}")]
    Distrust {
        /// Address of the other end.
        what: String,
        /// Reason for the distrust.
        reason: String,
    },
    /// The CAN interface cannot be used.
    #[cfg(target_os = "linux")]
    #[error(transparent)]
    Can(#[from] can::CanError),
    /// CAN network interfaces exist on Linux only.
    #[cfg(not(target_os = "linux"))]
    #[error("{0}: only Linux has interfaces for CAN; use an adapter with slcan, as in can:slcan:/dev/ttyACM0")]
    NotLinux(Address),
    /// Any other error of the operating system.
    #[error("cannot open {what}: {source}")]
    System {
        /// Port or host that was opened.
        what: String,
        /// Error of the operating system.
        source: io::Error,
    },
}

fn names(paths: &[PathBuf]) -> String {
    paths.iter().map(|path| path.display().to_string()).collect::<Vec<_>>().join(" and ")
}

/// Opens a link. A board that is served with a key needs the same `key`. Serial and CAN links ignore the key; a TCP
/// server that does not use it is refused.
///
/// # Errors
/// [`OpenError`], which names the remedy.
pub async fn open(address: &Address, key: Option<&Key>) -> Result<Link, OpenError> {
    match address {
        Address::Serial { path, baud } => {
            let path = path.clone().map_or_else(|| only_board(ports::list().unwrap_or_default()), Ok)?;
            let port = open_port(path, *baud)?;
            Ok(Link { rx: Receiver::Bytes(port.clone()), tx: Transmitter::Bytes(port) })
        }
        Address::Tcp { host, port } => {
            let socket = connect(host, *port).await?;
            if let Some(key) = key {
                return greet(socket, key)
                    .await
                    .map_err(|error| OpenError::Distrust { what: address.to_string(), reason: error.to_string() });
            }
            Ok(Link { rx: Receiver::Bytes(socket.clone()), tx: Transmitter::Bytes(socket) })
        }
        Address::Can { interface: CanInterface::Slcan { path, kbit_per_s }, node } => {
            let port = open_port(path.clone(), DEFAULT_BAUD)?;
            let (rx, tx) = slcan::host(port, *kbit_per_s, *node)
                .await
                .map_err(|source| OpenError::System { what: path.display().to_string(), source })?;
            Ok(Link { rx: Receiver::Slcan(rx), tx: Transmitter::Slcan(tx) })
        }
        #[cfg(target_os = "linux")]
        Address::Can { interface: CanInterface::Socket(interface), node } => {
            let (rx, tx) = can::open(interface, bus::End::Host(*node))?;
            Ok(Link { rx: Receiver::Can(rx), tx: Transmitter::Can(tx) })
        }
        #[cfg(not(target_os = "linux"))]
        Address::Can { interface: CanInterface::Socket(_), .. } => Err(OpenError::NotLinux(address.clone())),
    }
}

/// Returns the path of the only board among these ports.
fn only_board(found: Vec<ports::Port>) -> Result<PathBuf, OpenError> {
    let boards = found.into_iter().filter(ports::Port::is_board);
    let mut paths: Vec<PathBuf> = boards.map(|port| port.path).collect();
    match paths.len() {
        0 => Err(OpenError::NoBoard),
        1 => Ok(paths.remove(0)),
        _ => Err(OpenError::SeveralBoards(paths)),
    }
}

#[cfg(not(unix))]
fn open_port(path: PathBuf, _baud: u32) -> Result<Descriptor, OpenError> {
    Err(OpenError::NoSerialPorts(path))
}

#[cfg(unix)]
fn open_port(path: PathBuf, baud: u32) -> Result<Descriptor, OpenError> {
    serial::open_port(&path, baud).map_err(|source| not_opened(path, source))
}

/// Converts an error of opening a port.
#[cfg(unix)]
fn not_opened(path: PathBuf, source: io::Error) -> OpenError {
    match source.kind() {
        io::ErrorKind::NotFound => OpenError::NoPort(path),
        io::ErrorKind::ResourceBusy => OpenError::Busy(path),
        io::ErrorKind::PermissionDenied => OpenError::Denied(path),
        _ => OpenError::System { what: path.display().to_string(), source },
    }
}

async fn connect(host: &str, port: u16) -> Result<Descriptor, OpenError> {
    let what = format!("{host}:{port}");
    // Name resolution blocks the thread, which is acceptable because nothing else runs yet.
    let addresses = (host, port).to_socket_addrs().map_err(|_| OpenError::NoHost(host.to_owned()))?;
    let mut last = None;
    // A name may have several addresses, such as those of IPv6 and IPv4: the first one that answers is taken.
    for address in addresses {
        match select(std::pin::pin!(connect_to(address)), Timer::after(CONNECT_TIMEOUT)).await {
            Either::Left((Ok(socket), _)) => return Ok(socket),
            Either::Left((Err(error), _)) => last = Some(error),
            Either::Right(_) => last = Some(io::ErrorKind::TimedOut.into()),
        }
    }
    Err(last.map_or_else(|| OpenError::NoHost(host.to_owned()), |source| not_connected(what, source)))
}

/// Converts an error of connecting to `what`.
fn not_connected(what: String, source: io::Error) -> OpenError {
    match source.kind() {
        io::ErrorKind::ConnectionRefused | io::ErrorKind::TimedOut => OpenError::NoAnswer(what),
        _ => OpenError::System { what, source },
    }
}

/// Runs the client's handshake, within [`CONNECT_TIMEOUT`].
async fn greet(socket: Descriptor, key: &Key) -> io::Result<Link> {
    match select(std::pin::pin!(secure::client(socket, key)), Timer::after(CONNECT_TIMEOUT)).await {
        Either::Left((greeted, _)) => {
            let (rx, tx) = greeted?;
            Ok(Link { rx: Receiver::Secure(rx), tx: Transmitter::Secure(tx) })
        }
        Either::Right(_) => Err(io::Error::new(
            io::ErrorKind::TimedOut,
            "it does not answer to a key: is a board served there, and with this --key?",
        )),
    }
}

async fn connect_to(address: SocketAddr) -> io::Result<Descriptor> {
    let stream = async_io::Async::<TcpStream>::connect(address).await?;
    tcp(stream.into_inner()?)
}

/// Time without data after which a keep-alive probe checks the other end.
const KEEPALIVE_AFTER: Duration = Duration::from_secs(2);
/// Interval between further probes.
const KEEPALIVE_EVERY: Duration = Duration::from_secs(1);
/// Number of unanswered probes after which the other end counts as gone.
const KEEPALIVE_TIMES: u32 = 3;

/// Makes a link of a connected socket: writes leave at once (no Nagle delay), and a peer that vanishes silently ends it
/// within 5 s.
///
/// # Errors
/// Those of the operating system.
pub fn tcp(stream: TcpStream) -> io::Result<Descriptor> {
    // Frames are short and often wait for an answer: Nagle's algorithm would delay them.
    stream.set_nodelay(true)?;
    let socket = socket2::SockRef::from(&stream);
    let keepalive = socket2::TcpKeepalive::new().with_time(KEEPALIVE_AFTER).with_interval(KEEPALIVE_EVERY);
    socket.set_tcp_keepalive(&keepalive.with_retries(KEEPALIVE_TIMES))?;
    // Unacknowledged data suspends keep-alive probes and would be retransmitted for a quarter of an hour.
    #[cfg(target_os = "linux")]
    socket.set_tcp_user_timeout(Some(KEEPALIVE_AFTER + KEEPALIVE_EVERY * KEEPALIVE_TIMES))?;
    Descriptor::socket(stream)
}

impl ErrorType for Receiver {
    type Error = io::Error;
}

impl Read for Receiver {
    async fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        match self {
            Self::Bytes(descriptor) => descriptor.read(buffer).await,
            Self::Slcan(frames) => frames.read(buffer).await,
            #[cfg(target_os = "linux")]
            Self::Can(frames) => frames.read(buffer).await,
            Self::Secure(records) => records.read(buffer).await,
        }
    }
}

impl ErrorType for Transmitter {
    type Error = io::Error;
}

impl Write for Transmitter {
    async fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self {
            Self::Bytes(descriptor) => descriptor.write(bytes).await,
            Self::Slcan(frames) => frames.write(bytes).await,
            #[cfg(target_os = "linux")]
            Self::Can(frames) => frames.write(bytes).await,
            Self::Secure(records) => records.write(bytes).await,
        }
    }

    async fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::net::TcpListener;

    use async_io::Async;
    use futures::join;

    use super::*;
    use crate::{
        block_on,
        ports::{BOARD_USB, Port, Usb},
    };

    /// Opens a listener on this machine; returns it with its address.
    fn listen() -> (Async<TcpListener>, Address) {
        let listener = Async::<TcpListener>::bind(([127, 0, 0, 1], 0)).expect("a free port");
        let port = listener.get_ref().local_addr().expect("bound").port();
        (listener, Address::Tcp { host: "127.0.0.1".into(), port })
    }

    async fn accept(listener: &Async<TcpListener>) -> Descriptor {
        let (stream, _) = listener.accept().await.expect("a client");
        tcp(stream.into_inner().expect("not used otherwise")).expect("a socket")
    }

    /// Sends more data than one record of a keyed link holds, and checks that it arrives unchanged.
    async fn goes_through(tx: &mut impl Write, rx: &mut impl Read) {
        let said: Vec<u8> = (0..2000_u32).map(|number| number as u8).collect();
        let mut heard = vec![0; said.len()];
        tx.write_all(&said).await.expect("written");
        rx.read_exact(&mut heard).await.expect("read");
        assert_eq!(heard, said);
    }

    #[test]
    fn a_tcp_link_carries_bytes_both_ways() {
        block_on(async {
            let (listener, address) = listen();
            let mut link = open(&address, None).await.expect("it listens");
            let mut server = accept(&listener).await;
            goes_through(&mut link.tx, &mut server).await;
            goes_through(&mut server, &mut link.rx).await;
        });
    }

    #[test]
    fn a_keyed_link_is_between_ends_of_one_key() {
        let (ours, theirs) = (Key::new([7; 32]), Key::new([8; 32]));
        block_on(async {
            let (listener, address) = listen();
            let serve = async |key| secure::server(accept(&listener).await, key).await;
            let (client, server) = join!(open(&address, Some(&ours)), serve(&ours));
            let (mut link, (mut rx, mut tx)) = (client.expect("one key"), server.expect("one key"));
            goes_through(&mut link.tx, &mut rx).await;
            goes_through(&mut tx, &mut link.rx).await;

            let (client, server) = join!(open(&address, Some(&ours)), serve(&theirs));
            assert_eq!(server.expect_err("another key").kind(), io::ErrorKind::PermissionDenied);
            assert!(matches!(client, Err(OpenError::Distrust { what, .. }) if what == address.to_string()));
        });
    }

    /// A vanished peer ends a link in the same time, with and without unacknowledged data.
    #[test]
    fn a_peer_that_is_gone_is_noticed() {
        let (listener, _) = listen();
        let stream = TcpStream::connect(listener.get_ref().local_addr().expect("bound")).expect("it listens");
        let _link = tcp(stream.try_clone().expect("another handle")).expect("a socket");
        assert!(stream.nodelay().expect("asked"));
        let socket = socket2::SockRef::from(&stream);
        assert!(socket.keepalive().expect("asked"));
        #[cfg(target_os = "linux")]
        {
            let asked =
                socket.tcp_keepalive_interval().expect("asked") * socket.tcp_keepalive_retries().expect("asked");
            let gone = socket.tcp_keepalive_time().expect("asked") + asked;
            assert_eq!(gone, Duration::from_secs(5));
            assert_eq!(socket.tcp_user_timeout().expect("asked"), Some(gone));
        }
    }

    #[test]
    fn a_host_that_is_not_there_is_told_from_a_system_that_says_no() {
        let (listener, address) = listen();
        drop(listener);
        let refused = block_on(open(&address, None)).expect_err("nobody listens");
        assert!(matches!(&refused, OpenError::NoAnswer(what) if address.to_string().ends_with(what)), "{refused}");
        for (kind, answers_nothing) in [
            (io::ErrorKind::TimedOut, true),
            (io::ErrorKind::PermissionDenied, false),
            (io::ErrorKind::NetworkUnreachable, false),
        ] {
            let error = not_connected("host:9".into(), kind.into());
            assert_eq!(matches!(&error, OpenError::NoAnswer(what) if what == "host:9"), answers_nothing, "{error}");
        }
    }

    #[test]
    fn the_only_board_is_found_and_of_several_all_are_named() {
        let port = |name: &str, id| Port { path: name.into(), usb: Some(Usb { id, serial: None, product: None }) };
        let board = |name| port(name, BOARD_USB);
        let other = || port("/dev/ttyUSB0", (0x0403, 0x6001));
        assert!(matches!(only_board(vec![other()]), Err(OpenError::NoBoard)));
        assert_eq!(only_board(vec![board("/dev/ttyACM1"), other()]).expect("one"), PathBuf::from("/dev/ttyACM1"));
        let several = only_board(vec![board("/dev/ttyACM0"), board("/dev/ttyACM1"), other()]).expect_err("two");
        assert_eq!(
            several.to_string(),
            "several boards are connected, at /dev/ttyACM0 and /dev/ttyACM1: name one, as in serial:/dev/ttyACM0"
        );
    }

    #[cfg(unix)]
    mod ports_of_unix {
        use super::*;
        use crate::pty::Pty;

        #[test]
        fn what_is_wrong_with_a_port_is_told() {
            let pty = Pty::open().expect("a terminal");
            let serial = |path: PathBuf| Address::Serial { path: Some(path), baud: DEFAULT_BAUD };
            let address = serial(pty.path().to_owned());
            let mut link = block_on(open(&address, None)).expect("a port");
            block_on(goes_through(&mut link.tx, &mut pty.descriptor.clone()));
            let again = block_on(open(&address, None));
            assert!(matches!(again, Err(OpenError::Busy(path)) if path == pty.path()));
            let nowhere = PathBuf::from("/dev/no-such-port");
            let missing = block_on(open(&serial(nowhere.clone()), None));
            assert!(matches!(missing, Err(OpenError::NoPort(path)) if path == nowhere));
            // Errors that the test cannot provoke as superuser, and an unexpected one.
            let denied = not_opened(nowhere.clone(), io::ErrorKind::PermissionDenied.into());
            assert!(matches!(denied, OpenError::Denied(path) if path == nowhere));
            let other = not_opened(nowhere, io::ErrorKind::InvalidInput.into());
            assert!(matches!(other, OpenError::System { what, .. } if what == "/dev/no-such-port"));
        }

        #[test]
        fn an_adapter_is_opened_at_the_rate_of_its_address() {
            let mut pty = Pty::open().expect("a terminal");
            let address = format!("can:slcan:{}@250#5", pty.path().display()).parse().expect("an address");
            block_on(async {
                let mut link = open(&address, None).await.expect("a port");
                link.tx.write_all(b"\xAB").await.expect("written");
                let mut told = [0; 17];
                pty.descriptor.read_exact(&mut told).await.expect("read");
                assert_eq!(&told, b"\r\rC\rS5\rO\rt2051AB\r");
                pty.descriptor.write_all(b"z\rt2852CDEF\r").await.expect("written");
                let mut heard = [0; 2];
                link.rx.read_exact(&mut heard).await.expect("read");
                assert_eq!(heard, [0xCD, 0xEF]);
            });
        }
    }
}
