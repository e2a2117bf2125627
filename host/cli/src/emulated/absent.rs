//! Placeholder for the emulated processor in programs that are built without it.

use std::rc::Rc;

use r4_boards::Robot;
use r4_driver::Board;
use r4_image::Image;
use r4_rig::{Rig, emulated::EmulatedError as NotBuilt};
use r4_sim::{Simulation, VirtualBoard};

use crate::{
    args::{Args, Debug, LogLevel, Safety},
    session::HostClock,
};

/// Does nothing: no emulated board can log.
pub(crate) fn log(_: &Args, _: &mut Rig) {}

pub(crate) fn debugged(_: &Args, _: &Debug, _: Rig) -> anyhow::Result<Rig> {
    Err(NotBuilt.into())
}

pub(crate) fn image(_: &str) -> anyhow::Result<Image> {
    Err(NotBuilt.into())
}

pub(crate) fn start_image(_: &mut Simulation, _: &Robot, _: u64, _: &Image) -> anyhow::Result<Rc<dyn VirtualBoard>> {
    Err(NotBuilt.into())
}

pub(crate) fn debug(_: &Args, _: &Debug) -> anyhow::Result<bool> {
    Err(NotBuilt.into())
}

pub(crate) fn bench(_: &Args, _: f64) -> anyhow::Result<bool> {
    Err(NotBuilt.into())
}

pub(crate) fn tick(_: u64, _: &str, _: f64) -> anyhow::Result<(f64, f64)> {
    Err(NotBuilt.into())
}

pub(crate) fn bench_safety(_: &Args, _: &Safety) -> anyhow::Result<bool> {
    Err(NotBuilt.into())
}

/// Type without values: no log is ever open.
pub(crate) enum LinkLog {}

impl LinkLog {
    pub(crate) async fn open(_: &Board<HostClock>, _: HostClock, _: LogLevel) -> anyhow::Result<Self> {
        Err(NotBuilt.into())
    }

    pub(crate) async fn follow(&mut self) {
        match *self {}
    }

    pub(crate) fn rest(&mut self) {
        match *self {}
    }
}
