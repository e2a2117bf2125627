//! Steppers: paths, pulse times, axes, and the enable they share.

pub mod axis;
mod bank;
pub mod scurve;
pub mod steps;

#[cfg(test)]
mod tests;

pub use bank::{Bank, MAX_STEPPERS, NotTaken};
use r4_protocol::Range;

/// One stepper channel. Angles at the output shaft.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepperConfig {
    /// Pulses for a turn of the output shaft, with micro-steps and gear.
    pub steps_per_turn: u32,
    /// Whether the direction line turns the shaft the other way.
    pub inverted: bool,
    /// rad/s
    pub speed_max: f32,
    /// rad/s²
    pub acceleration: f32,
    /// rad/s³; 0 for trapezoids, whose acceleration jumps.
    pub jerk: f32,
    /// Speed that the loaded motor takes up and leaves at once without losing steps, rad/s.
    pub start_stop_speed: f32,
    /// Where the shaft may be, rad; infinite ends for shafts that turn on and on.
    pub position: Range,
    /// How the position is found.
    pub homing: Option<Homing>,
}

/// How an axis finds its position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Homing {
    /// Number of the switch.
    pub switch: u8,
    /// Position at which the switch opens when backed off from, rad.
    pub position: f32,
    /// Highest speed towards the switch, rad/s.
    pub speed_max: f32,
}
