//! CAN through a network interface of Linux (SocketCAN): `can0` of an adapter or controller, `vcan0` between programs.
//!
//! The kernel's filter passes only frames for this end, classic and CAN FD. A board sends CAN FD if its interface is
//! set up for it, and a host once its board does: classic-only nodes on the bus would destroy such frames, so a host
//! never begins with one. An interface is set up for CAN FD when its MTU is 72 (`ip link set can0 type can … fd on`).

use std::{
    fs, io,
    path::Path,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};

use async_io::{Async, Timer};
use embedded_io_async::{ErrorType, Read, Write};
use r4_protocol::can::{cut, cut_fd};
use rustix::io::Errno;
use socketcan::{
    CanAnyFrame, CanDataFrame, CanFdFrame, CanFdSocket, CanFilter, EmbeddedFrame, Id, Socket, SocketOptions,
    StandardId, id::FdFlags,
};

use crate::bus::{Assembly, End};

/// Size of the kernel's CAN FD frame, bytes (`CANFD_MTU`).
const FD_MTU: u32 = 72;
/// Kernel's type number of CAN interfaces (`ARPHRD_CAN`).
const CAN_INTERFACE: u32 = 280;
/// Flag of an interface that is up (`IFF_UP`).
const UP: u32 = 1;
/// Filter mask that matches one standard identifier in data frames only: all its bits, not extended, not remote.
const EXACTLY: u32 = 0x7FF | 0x8000_0000 | 0x4000_0000;
/// Wait after a full transmit queue, which the kernel does not signal otherwise. A full frame takes 0.13 ms.
const QUEUE_FULL: Duration = Duration::from_micros(500);

/// Reason why an interface cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum CanError {
    /// No interface has that name.
    #[error(
        "there is no CAN interface {0}: `ip link show type can` lists what there is; an adapter with slcan is can:slcan:/dev/ttyACM0"
    )]
    NoInterface(String),
    /// The interface is of another type.
    #[error("{0} is no CAN interface: `ip link show type can` lists those")]
    NotCan(String),
    /// The interface is down.
    #[error("{0} is down: `sudo ip link set {0} up type can bitrate 1000000` starts it")]
    Down(String),
    /// The kernel has no CAN sockets, or their module is not loaded.
    #[error(
        "this kernel has no CAN sockets: `sudo modprobe can_raw` loads them where there are; an adapter with slcan needs none, as in can:slcan:/dev/ttyACM0"
    )]
    NoSockets,
    /// Any other error of the operating system.
    #[error("cannot open {interface}: {source}")]
    System {
        /// Name of the interface.
        interface: String,
        /// Error of the operating system.
        source: io::Error,
    },
}

/// Receiving half: assembles the byte stream from frames.
#[derive(Debug)]
pub struct Receiver {
    socket: Arc<Async<CanFdSocket>>,
    assembly: Assembly,
    fd: Arc<AtomicBool>,
    interface_has_fd: bool,
}

/// Transmitting half: cuts the byte stream into frames with one identifier.
#[derive(Debug)]
pub struct Transmitter {
    socket: Arc<Async<CanFdSocket>>,
    identifier: StandardId,
    /// CAN FD frames are sent; a host's receiver sets this when its board sends one.
    fd: Arc<AtomicBool>,
}

/// Opens one end of a link over `interface`.
///
/// # Errors
/// [`CanError`], which names the remedy.
pub fn open(interface: &str, end: End) -> Result<(Receiver, Transmitter), CanError> {
    let name = || interface.to_owned();
    let system = |source| CanError::System { interface: name(), source };
    let socket = CanFdSocket::open(interface).map_err(|source| {
        match source.raw_os_error().map(Errno::from_raw_os_error) {
            Some(Errno::AFNOSUPPORT | Errno::PROTONOSUPPORT) => CanError::NoSockets,
            // The kernel returns the same error for an interface of another type.
            Some(Errno::NODEV) if property(interface, "type").is_some_and(|kind| kind != CAN_INTERFACE) => {
                CanError::NotCan(name())
            }
            Some(Errno::NODEV) => CanError::NoInterface(name()),
            _ => system(source),
        }
    })?;
    if property(interface, "flags").is_some_and(|flags| flags & UP == 0) {
        return Err(CanError::Down(name()));
    }
    let filters: Vec<_> =
        end.listens_to().into_iter().map(|identifier| CanFilter::new(identifier.into(), EXACTLY)).collect();
    socket.set_filters(&filters).map_err(system)?;
    let identifier = StandardId::new(end.sends_with()).ok_or_else(|| system(io::ErrorKind::InvalidInput.into()))?;
    let interface_has_fd = property(interface, "mtu") == Some(FD_MTU);
    let fd = Arc::new(AtomicBool::new(interface_has_fd && matches!(end, End::Board(_))));
    let socket = Arc::new(Async::new(socket).map_err(system)?);
    let receiver = Receiver { socket: socket.clone(), assembly: Assembly::new(end), fd: fd.clone(), interface_has_fd };
    Ok((receiver, Transmitter { socket, identifier, fd }))
}

/// Reads a number that the kernel shows for an interface in `/sys/class/net`; `None` if it is absent.
fn property(interface: &str, name: &str) -> Option<u32> {
    let text = fs::read_to_string(Path::new("/sys/class/net").join(interface).join(name)).ok()?;
    let text = text.trim();
    text.strip_prefix("0x").map_or_else(|| text.parse().ok(), |hex| u32::from_str_radix(hex, 16).ok())
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
            let frame = self.socket.read_with(CanFdSocket::read_frame).await?;
            let Id::Standard(identifier) = frame.id() else { continue };
            match &frame {
                CanAnyFrame::Normal(frame) => self.assembly.take(identifier.as_raw(), frame.data()),
                CanAnyFrame::Fd(frame) => {
                    // The board sends CAN FD, so this end may too, if its interface can.
                    if self.interface_has_fd {
                        self.fd.store(true, Ordering::Relaxed);
                    }
                    self.assembly.take(identifier.as_raw(), frame.data());
                }
                CanAnyFrame::Remote(_) | CanAnyFrame::Error(_) => {}
            }
        }
    }
}

impl Transmitter {
    /// Sends one frame; waits while the interface's queue is full.
    async fn send(&self, data: &[u8]) -> io::Result<()> {
        let frame = if self.fd.load(Ordering::Relaxed) {
            CanFdFrame::with_flags(self.identifier, data, FdFlags::BRS).map(CanAnyFrame::Fd)
        } else {
            CanDataFrame::new(self.identifier, data).map(CanAnyFrame::Normal)
        };
        // The pieces are cut to the length of their kind of frame, so this cannot fail.
        let frame = frame.ok_or(io::ErrorKind::InvalidInput)?;
        loop {
            match self.socket.write_with(|socket| socket.write_frame(&frame)).await {
                Err(error) if error.raw_os_error() == Some(Errno::NOBUFS.raw_os_error()) => {
                    Timer::after(QUEUE_FULL).await;
                }
                other => return other,
            }
        }
    }
}

impl ErrorType for Transmitter {
    type Error = io::Error;
}

impl Write for Transmitter {
    async fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if self.fd.load(Ordering::Relaxed) {
            for data in cut_fd(bytes) {
                self.send(&data).await?;
            }
        } else {
            for data in cut(bytes) {
                self.send(data).await?;
            }
        }
        Ok(bytes.len())
    }

    async fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use r4_protocol::can::Node;

    use super::*;

    /// The test reads the loopback interface, which every machine has.
    #[test]
    fn properties_are_read_as_the_kernel_writes_them() {
        // Expected values: `ARPHRD_LOOPBACK`, and `IFF_LOOPBACK` among the flags, which are in hex.
        assert_eq!(property("lo", "type"), Some(772));
        assert!(property("lo", "flags").is_some_and(|flags| flags & 8 != 0));
        assert_eq!(property("lo", "address"), None, "no number");
        assert_eq!(property("no-such-can0", "type"), None);
    }

    #[test]
    fn what_is_no_can_interface_is_told() {
        let end = End::Host(Node::new(0).expect("in range"));
        let missing = open("no-such-can0", end).expect_err("nobody calls one so");
        assert!(matches!(&missing, CanError::NoInterface(name) if name == "no-such-can0"), "{missing}");
        let loopback = open("lo", end).expect_err("it is not CAN");
        assert!(matches!(&loopback, CanError::NotCan(_) | CanError::NoSockets), "{loopback}");
    }
}
