//! From an [`Address`] to a byte link.

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

/// A connection that is not answered within this time is given up.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(3);

/// Both directions of a link, for [`r4_driver::with_board`].
#[derive(Debug)]
pub struct Link {
    /// What comes from the board.
    pub rx: Receiver,
    /// What goes to the board.
    pub tx: Transmitter,
}

/// What comes from a board.
#[derive(Debug)]
pub enum Receiver {
    /// As it is.
    Bytes(Descriptor),
    /// From an adapter, in frames.
    Slcan(slcan::Receiver),
    /// From an interface of Linux, in frames.
    #[cfg(target_os = "linux")]
    Can(can::Receiver),
    /// In records that only the holder of the key can make.
    Secure(secure::Receiver),
}

/// What goes to a board.
#[derive(Debug)]
pub enum Transmitter {
    /// As it is.
    Bytes(Descriptor),
    /// Through an adapter, in frames.
    Slcan(slcan::Transmitter),
    /// Through an interface of Linux, in frames.
    #[cfg(target_os = "linux")]
    Can(can::Transmitter),
    /// In records that only the holder of the key can make.
    Secure(secure::Transmitter),
}

/// Why there is no link.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// `serial:auto`, and no port says that it is a board.
    #[error("no board is connected by USB: `r4 ports` lists what there is; a port is named as in serial:/dev/ttyACM0")]
    NoBoard,
    /// `serial:auto`, and it is not clear which.
    #[error("several boards are connected, at {}: name one, as in serial:{}", names(.0), .0[0].display())]
    SeveralBoards(Vec<PathBuf>),
    /// There is no such port.
    #[error("{} does not exist: `r4 ports` lists what there is", .0.display())]
    NoPort(PathBuf),
    /// Another program has it.
    #[error("{} is used by another program: end that, or connect to the board through it", .0.display())]
    Busy(PathBuf),
    /// No right to open it.
    #[error("this user may not open {}: install the rule host/udev/70-r4.rules as docs/program.md says, or join the group that owns it (`ls -l {}`), as in `sudo usermod -aG dialout $USER`, and log in again", .0.display(), .0.display())]
    Denied(PathBuf),
    /// Serial ports can be waited for on Unix only.
    #[cfg(not(unix))]
    #[error("{}: serial ports are not opened on this system yet: use a board over TCP, or run r4 in WSL 2 with the port attached by usbipd", .0.display())]
    NoSerialPorts(PathBuf),
    /// A name that nobody knows.
    #[error("no address is known for {0}")]
    NoHost(String),
    /// Nobody answers there.
    #[error("{0} does not answer: is the board served there, and the port open?")]
    NoAnswer(String),
    /// The other end does not have the key, or asks for none.
    #[error("{what}: {reason}")]
    Distrust {
        /// Where.
        what: String,
        /// How that was noticed.
        reason: String,
    },
    /// Linux knows why there is no CAN.
    #[cfg(target_os = "linux")]
    #[error(transparent)]
    Can(#[from] can::CanError),
    /// Interfaces for CAN are Linux's.
    #[cfg(not(target_os = "linux"))]
    #[error("{0}: only Linux has interfaces for CAN; use an adapter with slcan, as in can:slcan:/dev/ttyACM0")]
    NotLinux(Address),
    /// Anything else that the operating system says.
    #[error("cannot open {what}: {source}")]
    System {
        /// Port or host.
        what: String,
        /// Its words.
        source: io::Error,
    },
}

fn names(paths: &[PathBuf]) -> String {
    paths.iter().map(|path| path.display().to_string()).collect::<Vec<_>>().join(" and ")
}

/// Opens a link. A board that is served with a key is reached with the same `key`; other links need none, and a TCP port on
/// which a key is not asked for is none that this one was meant for.
///
/// # Errors
/// [`OpenError`], which says what can be done.
pub async fn open(address: &Address, key: Option<&Key>) -> Result<Link, OpenError> {
    match address {
        Address::Serial { path, baud } => {
            let path = path.clone().map_or_else(only_board, Ok)?;
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

/// The only board that is connected by USB.
fn only_board() -> Result<PathBuf, OpenError> {
    let boards = ports::list().unwrap_or_default().into_iter().filter(ports::Port::is_board);
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
    serial::open_port(&path, baud).map_err(|source| match source.kind() {
        io::ErrorKind::NotFound => OpenError::NoPort(path),
        io::ErrorKind::ResourceBusy => OpenError::Busy(path),
        io::ErrorKind::PermissionDenied => OpenError::Denied(path),
        _ => OpenError::System { what: path.display().to_string(), source },
    })
}

async fn connect(host: &str, port: u16) -> Result<Descriptor, OpenError> {
    let what = format!("{host}:{port}");
    // Asking for a name may take its time; nothing else runs yet.
    let addresses = (host, port).to_socket_addrs().map_err(|_| OpenError::NoHost(host.to_owned()))?;
    let mut last = None;
    for address in addresses {
        match select(std::pin::pin!(connect_to(address)), Timer::after(CONNECT_TIMEOUT)).await {
            Either::Left((Ok(socket), _)) => return Ok(socket),
            Either::Left((Err(error), _)) => last = Some(error),
            Either::Right(_) => last = Some(io::ErrorKind::TimedOut.into()),
        }
    }
    Err(match last {
        None => OpenError::NoHost(host.to_owned()),
        Some(error) if matches!(error.kind(), io::ErrorKind::ConnectionRefused | io::ErrorKind::TimedOut) => {
            OpenError::NoAnswer(what)
        }
        Some(source) => OpenError::System { what, source },
    })
}

/// Both ends prove to have the key, in time.
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

/// A connected socket that nothing has come from is asked after this time whether the other end is still there.
const KEEPALIVE_AFTER: Duration = Duration::from_secs(2);
/// It is asked again after this time,
const KEEPALIVE_EVERY: Duration = Duration::from_secs(1);
/// so often, and then counts as gone.
const KEEPALIVE_TIMES: u32 = 3;

/// A connected socket as a link: what is written goes out at once, and a peer that is gone without a word ends it.
///
/// # Errors
/// The operating system's.
pub fn tcp(stream: TcpStream) -> io::Result<Descriptor> {
    stream.set_nodelay(true)?;
    let socket = socket2::SockRef::from(&stream);
    let keepalive = socket2::TcpKeepalive::new().with_time(KEEPALIVE_AFTER).with_interval(KEEPALIVE_EVERY);
    socket.set_tcp_keepalive(&keepalive.with_retries(KEEPALIVE_TIMES))?;
    // What is under way asks, too, and would do so for a quarter of an hour.
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
