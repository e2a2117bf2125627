//! The steppers that share an enable.

use heapless::Vec;

use super::{
    StepperConfig,
    axis::{Axis, AxisStatus, BadStepper, Command, CommandError, Fault},
    steps::{DriverTiming, TickTiming},
};
use crate::platform::Steppers;

/// Most steppers on one enable.
pub const MAX_STEPPERS: usize = 4;

/// Why a command was not taken.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum NotTaken {
    /// There is no such stepper.
    NoStepper,
    /// The steppers are safe: arm first.
    NotArmed,
    /// Its axis does not take it.
    Refused(CommandError),
}

/// The enable line, and since when it is on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Enable {
    Off,
    /// The drivers wake up.
    Since(u32),
    Ready,
}

/// All steppers of a board, and the enable they share.
#[derive(Debug)]
pub struct Bank {
    axes: Vec<Axis, MAX_STEPPERS>,
    active_low: bool,
    hold_when_safe: bool,
    wake_ticks: u32,
    enable: Enable,
    armed: bool,
}

impl Bank {
    /// Steppers at rest, the enable off; `active_low` when a low level enables. With `hold_when_safe` the enable stays on once it is, so that loads are held.
    ///
    /// # Errors
    /// The number of the stepper that cannot work, and why. Those beyond [`MAX_STEPPERS`] are none.
    pub fn new<H: Steppers>(
        configs: &[StepperConfig],
        driver: &DriverTiming,
        active_low: bool,
        hold_when_safe: bool,
        period_us: u32,
        hw: &mut H,
    ) -> Result<Self, (u8, BadStepper)> {
        let timing = TickTiming::new::<H>(driver).ok_or((0, BadStepper::Timing))?;
        let mut axes = Vec::new();
        for config in configs.iter().take(MAX_STEPPERS) {
            let connector = config.id.index;
            let axis = Axis::new(connector, *config, driver, period_us, hw).map_err(|bad| (connector, bad))?;
            let _ = axes.push(axis);
        }
        let bank =
            Self { axes, active_low, hold_when_safe, wake_ticks: timing.enable, enable: Enable::Off, armed: false };
        hw.enable(bank.level(false));
        Ok(bank)
    }

    /// Level of the line that enables, or not.
    const fn level(&self, enabled: bool) -> bool {
        enabled != self.active_low
    }

    /// Whether commands are taken.
    #[must_use]
    pub const fn is_armed(&self) -> bool {
        self.armed
    }

    /// Turns the enable on. Commands are taken from now on and act when the drivers are awake.
    pub fn arm(&mut self, hw: &mut impl Steppers) {
        if self.enable == Enable::Off {
            hw.enable(self.level(true));
            self.enable = Enable::Since(hw.now());
        }
        self.armed = true;
    }

    /// Brings those steppers to rest by their ramps whose stop brakes, ends the pulses of the others, and takes no more
    /// commands. Until [`Bank::make_safe`] the enable stays on and [`Bank::step`] must go on.
    pub fn brake(&mut self, hw: &mut impl Steppers) {
        self.armed = false;
        for axis in &mut self.axes {
            // A stop is always taken.
            if axis.config().stop_brake_ms == 0 || axis.command(Command::Stop).is_err() {
                axis.stop_now(hw);
            }
        }
    }

    /// Stops all at once and forgets their commands, and turns the enable off unless it is to hold. Without it a shaft can be
    /// turned by its load, so the axes no longer count as homed; the books of their positions are kept.
    pub fn make_safe(&mut self, hw: &mut impl Steppers) {
        self.armed = false;
        for axis in &mut self.axes {
            axis.stop_now(hw);
        }
        if !self.hold_when_safe {
            hw.enable(self.level(false));
            self.enable = Enable::Off;
            self.axes.iter_mut().for_each(Axis::lose_home);
        }
    }

    /// Commands stepper number `index` of the configuration.
    ///
    /// # Errors
    /// [`NotTaken`]; nothing changes.
    pub fn command(&mut self, index: usize, command: Command) -> Result<(), NotTaken> {
        let axis = self.axes.get_mut(index).ok_or(NotTaken::NoStepper)?;
        if !self.armed {
            return Err(NotTaken::NotArmed);
        }
        axis.command(command).map_err(NotTaken::Refused)
    }

    /// One period. `closed` reads a switch by its number; `fault` is told what went wrong with which stepper.
    pub fn step(
        &mut self,
        closed: impl Fn(u8) -> Option<bool>,
        hw: &mut impl Steppers,
        mut fault: impl FnMut(u8, Fault),
    ) {
        if let Enable::Since(tick) = self.enable
            && hw.now().wrapping_sub(tick) >= self.wake_ticks
        {
            self.enable = Enable::Ready;
        }
        for (index, axis) in (0..).zip(&mut self.axes) {
            if self.enable != Enable::Ready {
                axis.observe(hw);
                continue;
            }
            let switch_closed = axis.config().homing.and_then(|homing| closed(homing.switch));
            if let Err(what) = axis.step(switch_closed, hw) {
                fault(index, what);
            }
        }
        hw.queued();
    }

    /// For telemetry, in the order of the configuration.
    pub fn status(&self) -> impl Iterator<Item = AxisStatus> + '_ {
        self.axes.iter().map(Axis::status)
    }
}
