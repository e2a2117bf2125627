//! Bank of steppers that share an enable line.

use heapless::Vec;
use r4_protocol::config::StepperConfig;

use super::{
    axis::{Axis, AxisStatus, BadStepper, Command, CommandError, Fault},
    steps::{DriverTiming, TickTiming},
};
use crate::platform::Steppers;

/// Maximum number of steppers on one enable.
pub const MAX_STEPPERS: usize = 4;

/// Reason why a command was refused.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum NotTaken {
    /// There is no such stepper.
    NoStepper,
    /// The steppers are in the safe state: arm first.
    NotArmed,
    /// The axis refuses it.
    Refused(CommandError),
}

/// State of the enable line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Enable {
    Off,
    /// The drivers are waking up, since this tick.
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
    /// Creates the bank with steppers at rest and the enable off; `active_low` when a low level enables. With
    /// `hold_when_safe` the enable, once on, stays on, so that loads are held.
    ///
    /// # Errors
    /// The connector's number of the stepper that cannot work, and the reason. Those beyond [`MAX_STEPPERS`] are
    /// ignored.
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

    /// Level of the enable line for the given state.
    const fn level(&self, enabled: bool) -> bool {
        enabled != self.active_low
    }

    /// Returns true while commands are accepted.
    #[must_use]
    pub const fn is_armed(&self) -> bool {
        self.armed
    }

    /// Turns the enable on. Commands are accepted from now on and act when the drivers are awake.
    pub fn arm(&mut self, hw: &mut impl Steppers) {
        if self.enable == Enable::Off {
            hw.enable(self.level(true));
            self.enable = Enable::Since(hw.now());
        }
        self.armed = true;
    }

    /// Begins a braking stop: steppers whose stop brakes come to rest by their ramps, the pulses of the others end, and
    /// no more commands are accepted. Until [`Bank::make_safe`] the enable stays on and [`Bank::step`] must continue to
    /// be called.
    pub fn brake(&mut self, hw: &mut impl Steppers) {
        self.armed = false;
        for axis in &mut self.axes {
            // An axis never refuses a stop.
            if axis.config().stop_brake_ms == 0 || axis.command(Command::Stop).is_err() {
                axis.stop_now(hw);
            }
        }
    }

    /// Stops all at once, clears their commands, and turns the enable off unless it is to hold. Without the enable a
    /// load can turn a shaft, so the axes no longer count as homed; their position counts are kept.
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
    /// [`NotTaken`] names the reason; nothing changes.
    pub fn command(&mut self, index: usize, command: Command) -> Result<(), NotTaken> {
        let axis = self.axes.get_mut(index).ok_or(NotTaken::NoStepper)?;
        if !self.armed {
            return Err(NotTaken::NotArmed);
        }
        axis.command(command).map_err(NotTaken::Refused)
    }

    /// Advances one period. `closed` reads a switch by its number; `fault` is called for each fault, with the stepper's
    /// index.
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

    /// Status of each stepper for telemetry, in the order of the configuration.
    pub fn status(&self) -> impl Iterator<Item = AxisStatus> + '_ {
        self.axes.iter().map(Axis::status)
    }
}
