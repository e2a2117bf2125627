//! Cycles: set points for the channels that the host of one link has bound, and the answer with these channels' state.
//!
//! A cycle is accepted as a whole or not at all, by the same checks as a single command, and always answered. Its set
//! points are leased: the control loop stops the channels whose lease has run out. A refused cycle
//! stops the channels that it has set points for, unless they follow a newer one.

use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_time::{Duration, Instant};
use heapless::Vec;
use r4_protocol::{
    Cycle, CycleChannel, CycleMotor, CycleOutcome, CycleState, Mode, Refusal, Setpoint, ToHost,
    config::Place,
    cycle::{CYCLE_CHANNELS, DUTY_SCALE, NOTHING, steps},
};

use crate::{
    channel::{check_setpoint, modes_of, place},
    shared::{HostSide, MotorStatus, ReportSide, Status},
};

/// Channels bound to the cycles of one link.
#[derive(Default)]
pub(crate) struct Bound {
    channels: Vec<(CycleChannel, Place), CYCLE_CHANNELS>,
    ttl: Duration,
}

impl Bound {
    pub(crate) fn clear(&mut self) {
        self.channels.clear();
    }

    /// Binds `channels` and replaces the previous binding, whose set points end with their time to live.
    ///
    /// # Errors
    /// Nothing is changed then. [`Refusal::UnknownChannel`] for a channel that the board does not have;
    /// [`Refusal::WrongMode`] for a mode, or a channel, that cycles cannot move; [`Refusal::BadBinding`] for a channel
    /// given twice or without scales.
    pub(crate) fn bind<M: RawMutex>(
        &mut self,
        shared: HostSide<'_, M>,
        channels: &[CycleChannel],
        ttl_ms: u16,
    ) -> Result<(), Refusal> {
        let mut bound = Vec::new();
        for asked in channels {
            let CycleChannel { channel, mode, .. } = *asked;
            let place = place(shared.config(), channel)?;
            let moves = matches!(place, Place::Motor(_) | Place::Stepper(_) | Place::Bldc(_));
            let known = modes_of(shared.config(), place).iter().any(|info| info.mode == mode);
            if !moves || !known || asked.scale(mode).is_none() {
                return Err(Refusal::WrongMode { channel, mode });
            }
            let twice = bound.iter().any(|(_, other)| *other == place);
            // The push cannot fail: a message has no more channels than fit.
            if twice || !asked.is_scaled() || bound.push((*asked, place)).is_err() {
                return Err(Refusal::BadBinding { channel });
            }
        }
        self.channels = bound;
        self.ttl = Duration::from_millis(ttl_ms.into());
        Ok(())
    }

    /// Carries out `cycle` if it is accepted, and returns the answer with the channels' state.
    pub(crate) fn answer<M: RawMutex>(&self, shared: HostSide<'_, M>, link: u8, cycle: Cycle, now: Instant) -> ToHost {
        let outcome = self.outcome(shared, link, cycle, now);
        if outcome != CycleOutcome::Taken {
            shared.count(|stats| stats.cycles_refused = stats.cycles_refused.wrapping_add(1));
        }
        let mut motors = [CycleMotor::NONE; CYCLE_CHANNELS];
        let report = ReportSide::of(&shared);
        for (motor, (channel, place)) in motors.iter_mut().zip(&self.channels) {
            *motor = told(report.status(*place), channel.speed_scale);
        }
        let view = shared.safety();
        ToHost::Cycle(CycleState::new(cycle.seq, outcome, now.as_micros(), (view.state, view.causes), motors))
    }

    fn outcome<M: RawMutex>(&self, shared: HostSide<'_, M>, link: u8, cycle: Cycle, now: Instant) -> CycleOutcome {
        if self.channels.is_empty() || !shared.has_session(link) {
            return CycleOutcome::Unbound;
        }
        // Both are at most 66 s.
        let (age_us, ttl_us) = (i64::from(cycle.age_us(now.as_micros())), self.ttl.as_micros() as i64);
        let sent_us = now.as_micros().saturating_add_signed(-age_us);
        let follow = || {
            // A point of a path carries its own time, and one in the past is useless.
            if age_us.abs() > ttl_us || age_us >= 0 && self.has_points(cycle) {
                return Err(CycleOutcome::Stale);
            }
            let until = now + Duration::from_micros((ttl_us - age_us) as u64);
            let setpoints = self.setpoints(shared, cycle).map_err(|Refused| CycleOutcome::Refused)?;
            shared.lease(&setpoints, sent_us, until).map_err(|_| CycleOutcome::Refused)
        };
        let Err(outcome) = follow() else { return CycleOutcome::Taken };
        let asked = self.channels.iter().zip(cycle.set()).filter(|(_, steps)| *steps != NOTHING);
        asked.for_each(|((_, place), _)| shared.withdraw(*place, sent_us, outcome == CycleOutcome::Stale));
        outcome
    }

    /// Returns true if some channel follows a path by this cycle.
    fn has_points(&self, cycle: Cycle) -> bool {
        let given = self.channels.iter().zip(cycle.set()).filter(|(_, steps)| *steps != NOTHING);
        let all_in = cycle.mode().ok().flatten();
        given.into_iter().any(|((channel, _), _)| all_in.unwrap_or(channel.mode) == Mode::Follow)
    }

    fn setpoints<M: RawMutex>(
        &self,
        shared: HostSide<'_, M>,
        cycle: Cycle,
    ) -> Result<Vec<(Place, Setpoint), CYCLE_CHANNELS>, Refused> {
        let all_in = cycle.mode().map_err(|_| Refused)?;
        let mut setpoints = Vec::new();
        for ((channel, place), steps) in self.channels.iter().zip(cycle.set()) {
            let Some(setpoint) = channel.setpoint(all_in, steps).map_err(|_| Refused)? else { continue };
            check_setpoint(channel.channel, &modes_of(shared.config(), *place), setpoint).map_err(|_| Refused)?;
            setpoints.push((*place, setpoint)).map_err(|_| Refused)?;
        }
        Ok(setpoints)
    }
}

/// Error: a set point of the cycle is refused. The reason is not part of the answer; the same set point as a single
/// command returns it.
struct Refused;

fn told(status: Status, speed_scale: f32) -> CycleMotor {
    match status {
        Status::Motor(MotorStatus { position, speed, duty, settled, .. }) => CycleMotor {
            position,
            speed: steps(speed, speed_scale).unwrap_or(NOTHING),
            duty: steps(duty, DUTY_SCALE).unwrap_or(NOTHING),
            settled,
        },
        Status::Scalar(share) => CycleMotor { duty: steps(share, DUTY_SCALE).unwrap_or(NOTHING), ..CycleMotor::NONE },
        Status::Encoder { .. } | Status::Reading { .. } | Status::Sensor { .. } => CycleMotor::NONE,
    }
}
