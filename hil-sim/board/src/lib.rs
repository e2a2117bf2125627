//! A simulated R4 board: the firmware's own code on virtual time, register-level chips, and devices with physics.
//!
//! ```text
//!  Simulation (clock.rs, executor.rs): virtual nanoseconds, tasks by priority
//!    firmware tasks ── traits ──> lines.rs, io.rs, world/{pins,stepping}.rs: the processor's peripherals
//!                                   └─> world/: i2c.rs ─ chips/ ─ devices/ ─ plants ─ rails ─ sensors/
//!    host task ── link.rs: bytes with the speed of a UART ── firmware's link task
//! ```
//!
//! A processor can also drive the world's pins and buses itself, with its own timing: `world/wires.rs`. The environment
//! of a board, independent of what runs on its processor, is the type that [`VirtualBoard`] dereferences to.
//!
//! Chip models are written from datasheets and share no constant with the firmware's drivers. Requests that a real chip
//! silently ignores are reported ([`misuse`]). Same robot, same seed, same host: same bits, on every machine.
//!
//! ```
//! use r4_sim::{Pace, SimBoard, Simulation};
//!
//! let mut simulation = Simulation::new(Pace::Free);
//! let board = SimBoard::start(&mut simulation, &r4_boards::load("osmc-bench")?, 1)?;
//! let clock = simulation.clock();
//! simulation.block_on(clock.sleep(1_000_000_000));
//! assert_eq!(board.world().misuse(), []);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod board;
pub mod chips;
mod clock;
pub mod devices;
mod environment;
mod executor;
pub mod flash;
pub mod i2c;
mod io;
pub mod kept;
pub mod lines;
pub mod link;
pub mod misuse;
mod plants;
pub mod sensors;
pub mod stop;
pub mod uart;
pub mod world;

pub use board::SimBoard;
pub use clock::{Clock, GiveWay, Sleep};
pub use environment::{Environment, Light, Lights, SimError, VirtualBoard};
pub use executor::{Pace, Simulation, TaskId};
pub use plants::{MotorPlant, ReplaceError, plants, replace_plant};
pub use r4_firmware::ResetCause;
