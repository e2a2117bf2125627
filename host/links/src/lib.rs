//! Links to boards on this machine: serial ports, TCP and CAN adapters as byte links for [`r4_driver::with_board`], and
//! real time for it to run on.
//!
//! All I/O is asynchronous on the reactor of `async-io`; a program needs no other executor than [`block_on`]:
//!
//! ```no_run
//! use r4_links::{Address, RealClock, block_on, open};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let address: Address = "serial:/dev/ttyACM0".parse()?;
//! let robot = block_on(async {
//!     let link = open(&address, None).await?;
//!     let robot = r4_driver::with_board(link.rx, link.tx, RealClock, async |board| board.info().robot.clone()).await?;
//!     Ok::<_, Box<dyn std::error::Error>>(robot)
//! })?;
//! println!("{robot}");
//! # Ok(())
//! # }
//! ```

mod address;
pub mod blocking;
pub mod bus;
#[cfg(target_os = "linux")]
pub mod can;
mod clock;
mod descriptor;
#[cfg(test)]
mod fake_board;
mod key_file;
pub mod legacy;
mod listener;
pub mod measure;
mod open;
pub mod ports;
#[cfg(unix)]
pub mod pty;
mod reconnect;
pub mod secure;
#[cfg(unix)]
mod serial;
pub mod slcan;

pub use address::{Address, BadAddress, CanInterface, DEFAULT_BAUD, LINK_KINDS, LinkKind};
pub use async_io::block_on;
pub use clock::{RealClock, monotonic_ns};
pub use descriptor::Descriptor;
pub use listener::{Accepted, Listener};
pub use open::{Link, OpenError, Receiver, Transmitter, open, tcp};
pub use reconnect::{Event, Restart, is_of_link, with_reconnect};
pub use secure::Key;
