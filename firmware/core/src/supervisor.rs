//! The supervisor task: checks every cause each millisecond, and at once when a line or a task signals.

use core::future::pending;

use embassy_futures::select::{Either3, select3};
use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_time::{Duration, Instant, Ticker};
use embedded_hal::digital::{InputPin, OutputPin};
use embedded_hal_async::digital::Wait;
use r4_protocol::{Cause, Causes, SafetyState, config::Place};

use crate::shared::{Shared, Status, SupervisorSide};

/// Interval of checking the causes that have no line of their own.
const PERIOD: Duration = Duration::from_millis(1);
/// Time for which a handle must be held, or a button released, until it counts, so that bounce cannot clear a trip. The
/// opposite change counts at once.
const HELD_FOR: Duration = Duration::from_millis(20);

/// Lines that stop the board without the I2C bus.
pub struct SafetyPins<I, O> {
    /// High while the dead-man's handle is held. Pulled low, so that a cut wire reads as released.
    pub dead_man: I,
    /// High while the auxiliary stop is not pressed. Pulled low, so that a cut wire reads as pressed.
    pub auxiliary_stop: I,
    /// High turns every OSMC bridge off.
    pub osmc_disable: O,
    /// High turns the outputs of the motor PWM chips off.
    pub pwm_output_disable: O,
    /// Toggled in each supervisor period, for an external watchdog.
    pub heartbeat: O,
    /// Red light, on while low: tripped.
    pub red: O,
    /// Green light, on while low: armed.
    pub green: O,
    /// Blue light, on while low: a host is connected.
    pub blue: O,
}

/// Input line that must stay high for the board to be armed.
#[derive(Default)]
struct StopInput {
    low_at: Option<Instant>,
}

impl StopInput {
    /// Returns true if the line stops the board now.
    fn stops(&mut self, high: bool, now: Instant) -> bool {
        if !high {
            self.low_at = Some(now);
        }
        self.low_at.is_some_and(|at| now.saturating_duration_since(at) < HELD_FOR)
    }
}

/// Runs the supervisor indefinitely. Must have the highest priority of the three tasks.
///
/// It waits on nothing that another task can hold: a trip drives the stop lines here, before the control loop writes
/// the chips' safe state over I2C.
pub async fn supervise<M, I, O>(shared: &Shared<M>, mut pins: SafetyPins<I, O>) -> !
where
    M: RawMutex,
    I: InputPin + Wait,
    O: OutputPin,
{
    let shared = SupervisorSide::of(shared);
    let mut ticker = Ticker::every(PERIOD);
    let (mut dead_man, mut auxiliary) = (StopInput::default(), StopInput::default());
    let has_auxiliary = shared.config().auxiliary_stop;
    let mut kick = false;
    // True if an edge of the handle has been seen since the last tick.
    let mut heard = false;
    // GPIO outputs cannot fail on any supported board, so errors are ignored.
    let _ = pins.osmc_disable.set_high();
    let _ = pins.pwm_output_disable.set_high();
    loop {
        let now = Instant::now();
        // A pin that cannot be read counts as released.
        let held = pins.dead_man.is_high().unwrap_or(false);
        let mut watched = Causes::NONE;
        watched.set(Cause::DeadMan, dead_man.stops(held, now));
        let pressed = has_auxiliary && auxiliary.stops(pins.auxiliary_stop.is_high().unwrap_or(false), now);
        watched.set(Cause::AuxiliaryStop, pressed);
        let view = shared.supervise(watched, now);
        let _ = match view.state {
            SafetyState::Armed => pins.osmc_disable.set_low().and(pins.pwm_output_disable.set_low()),
            // The lines keep the state in which the stop began.
            SafetyState::Disarmed | SafetyState::Tripped if view.braking => Ok(()),
            SafetyState::Disarmed | SafetyState::Tripped => {
                pins.osmc_disable.set_high().and(pins.pwm_output_disable.set_high())
            }
        };
        let _ = light(&mut pins.red, view.state == SafetyState::Tripped);
        let _ = light(&mut pins.green, view.state == SafetyState::Armed);
        let _ = light(&mut pins.blue, shared.has_host());
        shared.publish(Place::DeadMan(0), Status::Scalar(held.into()));
        if has_auxiliary {
            shared.publish(Place::DeadMan(1), Status::Scalar((!pressed).into()));
        }
        // Waits for a level and not for an edge, so that an edge during the work above is not missed. At most one per
        // millisecond: a line that chatters would take the processor from everything below, and the first edge has
        // stopped the board already.
        let other_level = async {
            match (heard, held) {
                (true, _) => pending().await,
                (false, true) => pins.dead_man.wait_for_low().await,
                (false, false) => pins.dead_man.wait_for_high().await,
            }
        };
        match select3(ticker.next(), shared.supervisor.wait(), other_level).await {
            Either3::First(()) => {
                heard = false;
                kick = !kick;
                let _ = if kick { pins.heartbeat.set_high() } else { pins.heartbeat.set_low() };
            }
            Either3::Second(()) => {}
            // Released, or released and held again before the check: both count as a release.
            Either3::Third(_) => {
                heard = true;
                dead_man.low_at = Some(Instant::now());
            }
        }
    }
}

/// Switches a light, which is on while its line is low.
fn light<O: OutputPin>(line: &mut O, on: bool) -> Result<(), O::Error> {
    if on { line.set_low() } else { line.set_high() }
}

#[cfg(test)]
mod tests;
