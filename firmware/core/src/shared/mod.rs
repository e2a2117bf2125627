//! State shared by the tasks. Every access is one short critical section; no task can make another wait for longer.
//!
//! The data is divided by subject; each part is a type of its own that knows neither the lock nor the other parts:
//!
//! | module | data | written by | read by |
//! | --- | --- | --- | --- |
//! | `commands` | newest set point of each output, leases of cycles | dispatch, cycles | control loop |
//! | `paths` | paths of motors | dispatch, cycles | control loop |
//! | `tunings` | new gains and tunings | dispatch | control loop |
//! | `statuses` | present status of each channel | control loop, supervisor, ranging | telemetry, cycles, screen |
//! | `ranges` | newest readings of the range sensors | ranging | supervisor |
//! | `supervision` | safety state, causes, trips | supervisor; every task may trip, and the host may clear | all |
//! | `sessions` | session of the board's host | dispatch | supervisor, screen |
//! | `start` | causes of a start, kinds of a restart | – | – |
//!
//! `state` puts them behind one lock, as [`Shared`], with what every task may do: read the safety state, trip, publish,
//! count. The rest is only on the side of the task that needs it, so that a module's imports show what it can reach:
//! [`HostSide`] of links, dispatch and cycles, [`ControlSide`] of the control loop, [`SupervisorSide`] of the supervisor,
//! [`ReportSide`] of the tasks that report the board to a person or a host.

mod commands;
mod control_side;
mod host_side;
mod paths;
mod ranges;
mod report_side;
mod sessions;
mod slots;
mod start;
mod state;
mod statuses;
mod supervision;
mod supervisor_side;
mod tunings;

pub(crate) use commands::Commanded;
pub(crate) use control_side::ControlSide;
pub(crate) use host_side::HostSide;
pub(crate) use paths::at;
pub(crate) use report_side::ReportSide;
pub use start::{ResetCause, Restart};
pub use state::Shared;
pub use statuses::MotorStatus;
pub(crate) use statuses::Status;
pub(crate) use supervision::SafetyView;
pub(crate) use supervisor_side::SupervisorSide;

#[cfg(test)]
mod tests;
