//! Serial ports, real ones and pseudo-terminals, which look the same to a program.
//!
//! They are opened here and not by the crate `serialport`, because its ports block a thread while they wait; the driver
//! waits for several events at once. That crate lists the ports ([`crate::ports`]).

use std::{
    io,
    os::fd::{AsFd, OwnedFd},
    path::Path,
};

use rustix::{
    fs::{FlockOperation, Mode, OFlags, flock, open},
    io::Errno,
    termios::{OptionalActions, QueueSelector, ioctl_tiocexcl, tcflush, tcgetattr, tcsetattr},
};

use crate::Descriptor;

/// Opens a port exclusively in raw mode: eight bits, no parity, one stop bit, no flow control, no translation. Discards
/// bytes received before.
pub(crate) fn open_port(path: &Path, baud: u32) -> io::Result<Descriptor> {
    let port = open(path, OFlags::RDWR | OFlags::NOCTTY | OFlags::NONBLOCK | OFlags::CLOEXEC, Mode::empty())?;
    // A second program would take bytes from this one. `flock` stops programs that check it, TIOCEXCL those that do
    // not; but the superuser can open an exclusive port.
    flock(&port, FlockOperation::NonBlockingLockExclusive).map_err(|error| match error {
        Errno::WOULDBLOCK => io::ErrorKind::ResourceBusy.into(),
        error => io::Error::from(error),
    })?;
    ioctl_tiocexcl(&port)?;
    make_raw(&port, baud)?;
    // Flushed last, so that no byte received with the old settings remains.
    tcflush(&port, QueueSelector::IFlush)?;
    Descriptor::new(port)
}

/// Sets a terminal to raw mode at `baud` bit/s.
pub(crate) fn make_raw(port: &OwnedFd, baud: u32) -> io::Result<()> {
    let mut terminal = tcgetattr(port.as_fd())?;
    terminal.make_raw();
    terminal.set_speed(baud)?;
    tcsetattr(port, OptionalActions::Now, &terminal)?;
    Ok(())
}
