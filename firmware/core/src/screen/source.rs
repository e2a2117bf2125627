//! View of the board's state for the screen.

use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_time::{Duration, Instant};
use r4_protocol::config::{BoardConfig, Place};

use super::view::{Bar, Link, Source, Supply, View};
use crate::shared::{MotorStatus, ReportSide, Shared, Status};

impl<M: RawMutex> Source for Shared<M> {
    fn view(&self) -> View<'_> {
        let report = ReportSide::of(self);
        let config = self.config();
        let safety = self.safety();
        let stats = report.stats();
        let volts =
            |index| if let Status::Scalar(volts) = report.status(Place::Supply(index)) { volts } else { f32::NAN };
        let supplies = config.supplies.iter().enumerate();
        let bars = config.channels().filter_map(|(id, place)| {
            let (value, moving) = bar(config, place, report.status(place))?;
            Some(Bar { id, value, moving })
        });
        View {
            robot: &config.robot,
            state: safety.state,
            causes: safety.causes,
            supplies: supplies
                .map(|(index, supply)| Supply { id: supply.id, volts: volts(index), range_v: supply.range_v })
                .collect(),
            link: match report.heartbeat_age() {
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

/// Drive of a moving channel as a share of its maximum, and true if it is moving. `None` for a channel that moves
/// nothing.
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

#[cfg(test)]
mod tests {
    extern crate std;

    use std::vec::Vec;

    use r4_protocol::{ChannelKind, Range};

    use super::*;
    use crate::{
        ResetCause,
        testing::{Board, Tasks, board, robot},
    };

    /// Board with one channel of each kind that moves something, and the supplies. The servo goes from -0.5 to 1.5 rad.
    fn one_of_each() -> Board {
        let mut config = robot("every-interface");
        config.motors.truncate(1);
        config.bldcs.truncate(1);
        config.servos.truncate(1);
        config.steppers.truncate(1);
        (config.servos[0].low.angle_rad, config.servos[0].high.angle_rad) = (-0.5, 1.5);
        (config.motors[0].duty_max, config.steppers[0].speed_max) = (0.9, 12.0);
        board(config, ResetCause::Normal)
    }

    /// A bar shows the duty relative to its maximum, the speed relative to the highest, a servo's angle from one end of
    /// its travel to the other. A channel at rest, and a servo without pulses, is not moving.
    #[test]
    fn a_bar_is_a_share_of_the_most_that_a_channel_can_do() {
        let shared = one_of_each();
        let kinds = [ChannelKind::Osmc, ChannelKind::Bldc, ChannelKind::Servo, ChannelKind::Stepper];
        let show = |duty, share, angle, speed| {
            shared.publish(Place::Motor(0), Status::Motor(MotorStatus { duty, ..MotorStatus::IDLE }));
            shared.publish(Place::Bldc(0), Status::Scalar(share));
            shared.publish(Place::Servo(0), Status::Scalar(angle));
            shared.publish(Place::Stepper(0), Status::Motor(MotorStatus { speed, ..MotorStatus::IDLE }));
            let bars = shared.view().bars;
            assert_eq!(bars.iter().map(|bar| bar.id.kind).collect::<Vec<_>>(), kinds, "nothing else has one");
            bars.iter().map(|bar| ((bar.value * 1000.0).round(), bar.moving)).collect::<Vec<_>>()
        };
        assert_eq!(show(0.45, 0.25, 1.0, -3.0), [(500.0, true), (250.0, true), (500.0, true), (-250.0, true)]);
        assert_eq!(show(-0.9, -1.0, -0.5, 12.0), [(-1000.0, true), (-1000.0, true), (-1000.0, true), (1000.0, true)]);
        let rest = show(0.0, 0.0, f32::NAN, 0.0);
        assert!(rest.iter().all(|(_, moving)| !moving) && rest[2].0.is_nan(), "{rest:?}");
        assert!([0, 1, 3].iter().all(|index| rest[*index].0 == 0.0));
    }

    #[test]
    fn a_host_is_lost_when_it_is_silent_for_longer_than_the_time_out() {
        let shared = one_of_each();
        let mut tasks = Tasks::default();
        assert_eq!(shared.view().link, Link::NoHost);
        shared.as_host().open_session(0, Instant::now()).expect("nobody has one");
        for (after_us, link) in [
            (0, Link::Alive { age_ms: 0 }),
            (200_000, Link::Alive { age_ms: 200 }),
            (1, Link::Lost { age_ms: 200 }),
            (1_000_000, Link::Lost { age_ms: 1200 }),
        ] {
            tasks.advance(Duration::from_micros(after_us));
            assert_eq!(shared.view().link, link);
        }
    }

    #[test]
    fn each_supply_is_shown_with_its_range() {
        let shared = one_of_each();
        shared.publish(Place::Supply(1), Status::Scalar(12.5));
        let supplies = shared.view().supplies;
        assert_eq!((supplies[1].volts, supplies[1].range_v), (12.5, Range::new(10.0, 15.0)));
        assert_eq!(supplies.iter().map(|supply| supply.id.index).collect::<Vec<_>>(), [0, 1]);
    }
}
