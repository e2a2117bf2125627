//! Cycles: set points for the channels that the host of one link has bound, and what these do.
//!
//! A cycle is taken whole or not at all, by the same checks as a single command, and always answered. Its set points are
//! leased: [`Shared`](crate::shared::Shared) stops the channels whose lease has run out. A cycle that is refused stops the
//! channels it has set points for, unless they follow something newer.

use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_time::{Duration, Instant};
use heapless::Vec;
use r4_protocol::{
    Cycle, CycleChannel, CycleMotor, CycleOutcome, CycleState, Mode, Refusal, Setpoint, ToHost,
    config::Place,
    cycle::{CYCLE_CHANNELS, DUTY_SCALE, NOTHING, steps},
};

use crate::{
    dispatch::{check_setpoint, modes_of, place},
    shared::{MotorStatus, Shared, Status},
};

/// The channels that the cycles of one link are about.
#[derive(Default)]
pub(crate) struct Bound {
    channels: Vec<(CycleChannel, Place), CYCLE_CHANNELS>,
    ttl: Duration,
}

impl Bound {
    pub(crate) fn clear(&mut self) {
        self.channels.clear();
    }

    /// Binds `channels` instead of those that were; what these follow ends with its time-to-live.
    ///
    /// # Errors
    /// Nothing is changed then. [`Refusal::UnknownChannel`], [`Refusal::WrongMode`] for a mode or a channel that no cycle
    /// moves, [`Refusal::BadBinding`].
    pub(crate) fn bind<M: RawMutex>(
        &mut self,
        shared: &Shared<M>,
        channels: &[CycleChannel],
        ttl_ms: u16,
    ) -> Result<(), Refusal> {
        let mut bound = Vec::new();
        for asked in channels {
            let CycleChannel { channel, mode, .. } = *asked;
            let place = place(shared, channel)?;
            let moves = matches!(place, Place::Motor(_) | Place::Stepper(_) | Place::Bldc(_));
            let known = modes_of(shared.config(), place).iter().any(|info| info.mode == mode);
            if !moves || !known || asked.scale(mode).is_none() {
                return Err(Refusal::WrongMode { channel, mode });
            }
            let twice = bound.iter().any(|(_, other)| *other == place);
            // A message has no more than fit.
            if twice || !asked.is_scaled() || bound.push((*asked, place)).is_err() {
                return Err(Refusal::BadBinding { channel });
            }
        }
        self.channels = bound;
        self.ttl = Duration::from_millis(ttl_ms.into());
        Ok(())
    }

    /// Carries `cycle` out, or not, and says what the channels do.
    pub(crate) fn answer<M: RawMutex>(&self, shared: &Shared<M>, link: u8, cycle: Cycle, now: Instant) -> ToHost {
        let outcome = self.outcome(shared, link, cycle, now);
        if outcome != CycleOutcome::Taken {
            shared.count(|stats| stats.cycles_refused = stats.cycles_refused.wrapping_add(1));
        }
        let mut motors = [CycleMotor::NONE; CYCLE_CHANNELS];
        for (motor, (channel, place)) in motors.iter_mut().zip(&self.channels) {
            *motor = told(shared.status(*place), channel.speed_scale);
        }
        let view = shared.safety();
        ToHost::Cycle(CycleState::new(cycle.seq, outcome, now.as_micros(), (view.state, view.causes), motors))
    }

    fn outcome<M: RawMutex>(&self, shared: &Shared<M>, link: u8, cycle: Cycle, now: Instant) -> CycleOutcome {
        if self.channels.is_empty() || !shared.has_session(link) {
            return CycleOutcome::Unbound;
        }
        // Neither is longer than 66 s.
        let (age_us, ttl_us) = (i64::from(cycle.age_us(now.as_micros())), self.ttl.as_micros() as i64);
        let sent_us = now.as_micros().saturating_add_signed(-age_us);
        let follow = || {
            // A point of a path is dated with its own moment, and one of the past is no use.
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

    /// Whether some channel follows a path by this cycle.
    fn has_points(&self, cycle: Cycle) -> bool {
        let given = self.channels.iter().zip(cycle.set()).filter(|(_, steps)| *steps != NOTHING);
        let all_in = cycle.mode().ok().flatten();
        given.into_iter().any(|((channel, _), _)| all_in.unwrap_or(channel.mode) == Mode::Follow)
    }

    fn setpoints<M: RawMutex>(
        &self,
        shared: &Shared<M>,
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

/// Which set point, and why, is not told in a cycle: a single command of the same does.
struct Refused;

/// Set point of a motor that stops, by the mode it followed.
pub(crate) const fn at_rest(mode: Mode) -> Setpoint {
    match mode {
        // One that presses stays where it is, and so holds what it holds.
        Mode::Position | Mode::Speed | Mode::Home | Mode::Follow | Mode::Force => {
            Setpoint { mode: Mode::Speed, value: 0.0 }
        }
        _ => Setpoint::NONE,
    }
}

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
