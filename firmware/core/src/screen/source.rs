//! From the board's state to what the screen shows of it.

use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_time::{Duration, Instant};
use r4_protocol::config::{BoardConfig, Place};

use super::view::{Bar, Link, Source, Supply, View};
use crate::shared::{MotorStatus, Shared, Status};

impl<M: RawMutex> Source for Shared<M> {
    fn view(&self) -> View<'_> {
        let config = self.config();
        let safety = self.safety();
        let stats = self.stats();
        let volts =
            |index| if let Status::Scalar(volts) = self.status(Place::Supply(index)) { volts } else { f32::NAN };
        let supplies = config.supplies.iter().enumerate();
        let bars = config.channels().filter_map(|(id, place)| {
            let (value, moving) = bar(config, place, self.status(place))?;
            Some(Bar { id, value, moving })
        });
        View {
            robot: &config.robot,
            state: safety.state,
            causes: safety.causes,
            supplies: supplies
                .map(|(index, supply)| Supply { id: supply.id, volts: volts(index), range_v: supply.range_v })
                .collect(),
            link: match self.heartbeat_age() {
                None => Link::NoHost,
                Some(age) => {
                    let age_ms = age.as_millis() as u32;
                    let timeout = Duration::from_millis(config.link_timeout_ms.into());
                    if age > timeout { Link::Lost { age_ms } } else { Link::Alive { age_ms } }
                }
            },
            uptime_s: Instant::now().as_secs() as u32,
            bars: bars.take(super::view::MAX_BARS).collect(),
            late_ticks: stats.late_ticks,
            bus_retries: stats.bus_retries,
        }
    }
}

/// How hard a channel that moves something is driven, of the most it can do, and whether it is on its way.
fn bar(config: &BoardConfig, place: Place, status: Status) -> Option<(f32, bool)> {
    match (place, status) {
        (Place::Motor(index), Status::Motor(MotorStatus { duty, .. })) => {
            Some((duty / config.motors[index].duty_max, duty != 0.0))
        }
        (Place::Stepper(index), Status::Motor(MotorStatus { speed, .. })) => {
            Some((speed / config.steppers[index].speed_max, speed != 0.0))
        }
        (Place::Bldc(_), Status::Scalar(share)) => Some((share, share != 0.0)),
        (Place::Servo(index), Status::Scalar(angle)) => {
            let range = config.servos[index].position();
            Some((2.0 * (angle - range.min) / (range.max - range.min) - 1.0, !angle.is_nan()))
        }
        _ => None,
    }
}
