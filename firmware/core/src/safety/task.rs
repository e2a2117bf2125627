//! The supervisor task: looks at every cause each millisecond and at once when a line or a task calls.

use embassy_futures::select::{Either3, select3};
use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_time::{Duration, Instant, Ticker};
use embedded_hal::digital::{InputPin, OutputPin};
use embedded_hal_async::digital::Wait;
use r4_protocol::{Cause, Causes, SafetyState};

use crate::shared::Shared;

/// How often causes without a line of their own are looked at.
const PERIOD: Duration = Duration::from_millis(1);
/// A released handle counts at once; a held one only after it has stayed so for this long, so that bounce cannot clear.
const DEAD_MAN_HELD_FOR: Duration = Duration::from_millis(20);

/// The lines that stop the board without the I2C bus.
pub struct SafetyPins<I, O> {
    /// High while the dead-man's handle is held. Pulled low, so that a cut wire reads as released.
    pub dead_man: I,
    /// High turns every OSMC bridge off.
    pub osmc_disable: O,
    /// High turns the outputs of the motor PWM chips off.
    pub pwm_output_disable: O,
    /// Toggled while the supervisor runs, for an external watchdog.
    pub heartbeat: O,
}

/// Runs the supervisor for ever. Must have the highest priority of the three tasks.
///
/// It waits on nothing another task can hold: a trip drives the stop lines here, before the control loop writes the
/// chips' safe state over I2C.
pub async fn supervise<M, I, O>(shared: &Shared<M>, mut pins: SafetyPins<I, O>) -> !
where
    M: RawMutex,
    I: InputPin + Wait,
    O: OutputPin,
{
    let mut ticker = Ticker::every(PERIOD);
    let mut released_at: Option<Instant> = None;
    let mut kick = false;
    // Outputs of a GPIO cannot fail on any supported board; a pin that reports an error is treated as released.
    let _ = pins.osmc_disable.set_high();
    let _ = pins.pwm_output_disable.set_high();
    loop {
        let now = Instant::now();
        // A pin that cannot be read is not held.
        let held = pins.dead_man.is_high().unwrap_or(false);
        if !held {
            released_at = Some(now);
        }
        let released = released_at.is_some_and(|at| now.saturating_duration_since(at) < DEAD_MAN_HELD_FOR);
        let mut watched = Causes::NONE;
        watched.set(Cause::DeadMan, released);
        let view = shared.supervise(watched, now);
        let _ = match view.state {
            SafetyState::Armed => pins.osmc_disable.set_low().and(pins.pwm_output_disable.set_low()),
            SafetyState::Disarmed | SafetyState::Tripped => {
                pins.osmc_disable.set_high().and(pins.pwm_output_disable.set_high())
            }
        };
        // Waiting for a level and not for an edge: one that came while we worked is not missed.
        let other_level =
            async { if held { pins.dead_man.wait_for_low().await } else { pins.dead_man.wait_for_high().await } };
        match select3(ticker.next(), shared.supervisor.wait(), other_level).await {
            Either3::First(()) => {
                kick = !kick;
                let _ = if kick { pins.heartbeat.set_high() } else { pins.heartbeat.set_low() };
            }
            Either3::Second(()) => {}
            // Released, or released and held again before we could look: both are a release.
            Either3::Third(_) => released_at = Some(Instant::now()),
        }
    }
}
