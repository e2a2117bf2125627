//! Serial ports: real ones, and pseudo-terminals, which are the same to a program.
//!
//! Opened here and not by `serialport`, whose ports are waited for by blocking a thread: the driver waits for several things
//! at once. That crate lists the ports ([`crate::ports`]).

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

/// Opens a port raw: eight bits, no parity, one stop bit, no flow control, nothing changed on the way, and for this program
/// alone. What was received before is thrown away.
pub(crate) fn open_port(path: &Path, baud: u32) -> io::Result<Descriptor> {
    let port = open(path, OFlags::RDWR | OFlags::NOCTTY | OFlags::NONBLOCK | OFlags::CLOEXEC, Mode::empty())?;
    // A second program would take bytes away from this one. The lock is for programs that ask, the other is for those that
    // do not; but the superuser may open what is exclusive.
    flock(&port, FlockOperation::NonBlockingLockExclusive).map_err(|error| match error {
        Errno::WOULDBLOCK => io::ErrorKind::ResourceBusy.into(),
        error => io::Error::from(error),
    })?;
    ioctl_tiocexcl(&port)?;
    make_raw(&port, baud)?;
    tcflush(&port, QueueSelector::IFlush)?;
    Descriptor::new(port)
}

/// Makes a terminal carry bytes as they are.
pub(crate) fn make_raw(port: &OwnedFd, baud: u32) -> io::Result<()> {
    let mut terminal = tcgetattr(port.as_fd())?;
    terminal.make_raw();
    terminal.set_speed(baud)?;
    tcsetattr(port, OptionalActions::Now, &terminal)?;
    Ok(())
}
