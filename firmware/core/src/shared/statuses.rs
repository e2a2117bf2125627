//! Present status of each channel: written by the control loop and the supervisor, read by telemetry, cycles and screen.

use embassy_time::Instant;
use heapless::Vec;
use r4_protocol::{
    HotWinding, Quality, Setpoint, Winding,
    channel::MAX_QUANTITIES,
    config::{BoardConfig, MAX_MOTORS, Place},
};

use super::slots::{CHANNELS, slot};

/// Status of a motor or stepper, as published by the control loop each period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotorStatus {
    /// Set point that it follows.
    pub setpoint: Setpoint,
    /// Position, in counts of the channel's resolution.
    pub position: i32,
    /// Speed, in rad/s or m/s.
    pub speed: f32,
    /// Duty: share of the supply at the bridge.
    pub duty: f32,
    /// True at the set point and at rest; in position mode only.
    pub settled: bool,
    /// True if the position is known, and not only counted from power-on.
    pub homed: bool,
    /// Heat of its winding; `None` where it is not computed.
    pub winding: Option<Winding>,
}

impl MotorStatus {
    pub(crate) const IDLE: Self = Self {
        setpoint: Setpoint::NONE,
        position: 0,
        speed: 0.0,
        duty: 0.0,
        settled: false,
        homed: false,
        winding: None,
    };
}

/// Present status of a channel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Status {
    Motor(MotorStatus),
    Scalar(f32),
    Encoder { position: i32, speed: f32, illegal: u32 },
    Reading { value: f32, quality: Quality, taken: Instant },
    Sensor { values: [f32; MAX_QUANTITIES], quality: Quality, taken: Instant },
}

/// Statuses of all channels, and the time of their measurement.
pub(super) struct Statuses {
    all: [Status; CHANNELS],
    /// Time of the measurement of the positions.
    measured: Instant,
}

impl Statuses {
    /// Creates the statuses of a board that has just started; one whose configuration is not `valid` drives nothing.
    pub(super) fn new(config: &BoardConfig, valid: bool) -> Self {
        let mut all = [Status::Scalar(0.0); CHANNELS];
        for (_, place) in config.channels() {
            all[slot(place)] = match place {
                Place::Motor(_) | Place::Stepper(_) => Status::Motor(MotorStatus::IDLE),
                Place::Encoder(_) => Status::Encoder { position: 0, speed: 0.0, illegal: 0 },
                // A board that drives nothing gives no pulses.
                Place::Servo(_) if !valid => Status::Scalar(f32::NAN),
                Place::Range(_) | Place::Analog(_) => {
                    Status::Reading { value: 0.0, quality: Quality::None, taken: Instant::now() }
                }
                Place::Sensor(_) => {
                    Status::Sensor { values: [0.0; MAX_QUANTITIES], quality: Quality::None, taken: Instant::now() }
                }
                _ => Status::Scalar(0.0),
            };
        }
        Self { all, measured: Instant::MIN }
    }

    pub(super) fn set(&mut self, place: Place, status: Status) {
        self.all[slot(place)] = status;
    }

    /// Sets all statuses of a kind, from `first` on.
    pub(super) fn set_each(&mut self, first: Place, statuses: impl Iterator<Item = Status>) {
        let mut slots = self.all[slot(first)..].iter_mut();
        statuses.for_each(|status| {
            if let Some(slot) = slots.next() {
                *slot = status;
            }
        });
    }

    pub(super) fn get(&self, place: Place) -> Status {
        self.all[slot(place)]
    }

    pub(super) fn set_measured(&mut self, measured: Instant) {
        self.measured = measured;
    }

    pub(super) fn measured(&self) -> Instant {
        self.measured
    }

    /// Motors whose windings are close to their limit, in the order of the configuration.
    pub(super) fn hot_windings(&self, config: &BoardConfig) -> Vec<HotWinding, MAX_MOTORS> {
        let motors = config.motors.iter().enumerate();
        let hot = motors.filter_map(|(index, motor)| match self.get(Place::Motor(index)) {
            Status::Motor(MotorStatus { winding: Some(Winding { heat_percent, hot: true }), .. }) => {
                Some(HotWinding { channel: motor.id, heat_percent })
            }
            _ => None,
        });
        hot.collect()
    }
}
