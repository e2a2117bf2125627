//! Plan of a run, checked before anything moves.

use r4_driver::tune::{Loop, LoopConditions, SpeedEstimate};
use r4_protocol::{
    ChannelInfo, ChannelKind, Mode, Parameter, Unit,
    config::{FeedForward, PidGains, Tuning},
};

use super::{Method, TuneError, TuneRequest};
use crate::{
    Error,
    parameters::Parameters,
    quantity::{Quantity, speed_unit},
};

/// Default travel: of a rotary motor, rad, and of a linear one, as a share of its range.
const TRAVEL_RAD: f64 = 1.0;
const TRAVEL_SHARE: f64 = 0.1;
/// Least default travel, counts. Less shows a step's overshoot of 5 % as less than five counts of the sensor. With 80,
/// 3 of 200 sampled position loops found no gains: the lag of one of them was undetermined between 63 ms and 3 s.
const TRAVEL_COUNTS: f64 = 200.0;
/// Step of the position, as a share of the travel.
const STEP_SHARE: f64 = 0.5;
/// Speed steps of a speed loop, as shares of the path's speed; and longest run in one direction, s.
const SPEEDS: (f64, f64) = (0.4, 0.8);
const SPEED_RUN_S: f64 = 6.0;
/// Limit of a relay's duty, as a share of the duty that counts as a stall at standstill.
pub(super) const BELOW_STALL: f64 = 0.9;
/// Least duty beyond friction for an experiment.
const LEAST_BEYOND: f64 = 0.03;
/// Time for which a position step is sampled beyond the duration of its path, s.
const SETTLE_S: f64 = 3.0;
/// Time for which a speed step is sampled, s.
const SPEED_ANSWER_S: f64 = 1.5;
/// Timeout of a move beyond the duration of its path, s.
const PATIENCE_S: f64 = 5.0;
/// Longest duration of the experiment itself, without approach and steps, s.
const EXPERIMENT_S: f64 = 30.0;

/// A motor with its parameters from the board, SI.
#[derive(Clone, Copy, Debug)]
pub struct Motor {
    /// Unit of its position.
    pub unit: Unit,
    /// Resolution of the sensor, rad or m.
    pub resolution: f64,
    /// Period of the board's loops, s.
    pub period_s: f64,
    /// Largest duty, as a share of the supply.
    pub duty_max: f64,
    /// Position error at which the motor counts as arrived, rad or m.
    pub settle_error: f64,
    /// Time constant of the speed filter, s.
    pub speed_filter_s: f64,
    /// Gains of the loop when the board started.
    pub gains: PidGains,
    /// Feed-forward and cascade when the board started.
    pub tuning: Tuning,
    /// Duty that counts as a stall at standstill, as a share of the supply.
    pub stall_duty: f64,
    /// Speed limit of the path, rad/s or m/s.
    pub speed: f64,
    acceleration: f64,
    /// Time for the jerk to reach full acceleration, s.
    onset_s: f64,
    range: (f64, f64),
}

/// Plan of a run: actions and bounds. Positions in rad or m.
#[derive(Clone, Copy, Debug)]
pub struct Plan {
    /// Loop that is tuned.
    pub of: Loop,
    /// Motor with its parameters.
    pub motor: Motor,
    /// Start of the run.
    pub base: f64,
    /// Largest distance from the start.
    pub travel: f64,
    /// Allowed positions of the motor, lowest and highest.
    pub window: (f64, f64),
    /// Set points between which the loop steps, in its unit.
    pub steps: (f64, f64),
    /// Time for which each step is sampled, s.
    pub answer_s: f64,
    /// Timeout of a move within the window, s.
    pub settle_s: f64,
    /// Timeout of the move to the start, s.
    pub approach_s: f64,
    /// Duty of a position experiment, as a share of the supply.
    pub amplitude: f64,
    /// Requested duty; `None` for the default.
    pub given_amplitude: Option<f64>,
    /// Largest duty of a position experiment.
    pub cap: f64,
}

impl Motor {
    fn new(info: &ChannelInfo, parameters: &Parameters, of: Loop) -> Result<Self, Error> {
        let number = |parameter| parameters.active(info.id, parameter);
        let [kp, ki, kd] = of_gains(of);
        Ok(Self {
            unit: info.unit,
            resolution: info.resolution.into(),
            period_s: 1.0 / f64::from(info.rate_hz),
            duty_max: number(Parameter::DutyMax)?.into(),
            settle_error: number(Parameter::SettleError)?.into(),
            speed_filter_s: number(Parameter::SpeedFilter)?.into(),
            gains: PidGains { kp: number(kp)?, ki: number(ki)?, kd: number(kd)? },
            tuning: Tuning {
                feed_forward: FeedForward {
                    static_duty: number(Parameter::StaticDuty)?,
                    duty_per_speed: number(Parameter::DutyPerSpeed)?,
                    duty_per_acceleration: number(Parameter::DutyPerAcceleration)?,
                },
                cascade_per_s: number(Parameter::Cascade)?,
            },
            stall_duty: number(Parameter::StallDuty)?.into(),
            speed: number(Parameter::ProfileSpeed)?.into(),
            acceleration: number(Parameter::ProfileAcceleration)?.into(),
            onset_s: match f64::from(number(Parameter::Jerk)?) {
                0.0 => 0.0,
                jerk => f64::from(number(Parameter::ProfileAcceleration)?) / jerk,
            },
            range: (number(Parameter::PositionMin)?.into(), number(Parameter::PositionMax)?.into()),
        })
    }

    /// Duty that is assumed for friction, as a share of the supply.
    pub(crate) fn static_duty(&self) -> f64 {
        self.tuning.feed_forward.static_duty.into()
    }

    /// Longest duration of a path, s.
    fn path_s(&self, distance: f64) -> f64 {
        let ramps = self.speed * self.speed / self.acceleration;
        let trapezoid_s = if distance > ramps {
            distance / self.speed + self.speed / self.acceleration
        } else {
            2.0 * (distance / self.acceleration).sqrt()
        };
        // Limited jerk adds 1 to 1.2 times the onset.
        trapezoid_s + 1.2 * self.onset_s
    }

    fn position(&self, given: Quantity, option: &'static str) -> Result<f64, Error> {
        if given.unit == self.unit {
            Ok(given.value)
        } else {
            Err(TuneError::WrongUnit { option, unit: self.unit }.into())
        }
    }
}

/// Parameters with the gains of a loop: proportional, integral and derivative.
pub(crate) fn of_gains(of: Loop) -> [Parameter; 3] {
    match of {
        Loop::Position => [Parameter::PositionKp, Parameter::PositionKi, Parameter::PositionKd],
        Loop::Speed | Loop::Cascade => [Parameter::SpeedKp, Parameter::SpeedKi, Parameter::SpeedKd],
    }
}

/// Checks that a channel has loops.
///
/// # Errors
/// [`TuneError::NoLoops`] when it has none.
pub(crate) fn check_has_loops(info: &ChannelInfo) -> Result<(), Error> {
    let channel = info.id;
    let moves = matches!(channel.kind, ChannelKind::Osmc | ChannelKind::Actuator | ChannelKind::Dhb);
    if moves && info.mode(Mode::Position).is_some() { Ok(()) } else { Err(TuneError::NoLoops { channel }.into()) }
}

impl Plan {
    /// Plans the run of `request` for a motor at `position`, rad or m.
    ///
    /// # Errors
    /// [`TuneError`] when the run is not possible within the travel, the time and the duty.
    pub(crate) fn new(
        request: &TuneRequest,
        info: &ChannelInfo,
        parameters: &Parameters,
        position: f64,
    ) -> Result<Self, Error> {
        let channel = info.id;
        // A cascade gain above 0 selects the cascade.
        let present =
            if parameters.active(channel, Parameter::Cascade)? > 0.0 { Loop::Cascade } else { Loop::Position };
        let of = request.of.unwrap_or(present);
        let motor = Motor::new(info, parameters, of)?;
        let quantity = |value| Quantity::new(value, motor.unit);
        let room = motor.range.1 - motor.range.0;
        let run = SPEEDS.1 * motor.speed * SPEED_RUN_S;
        let travel = match (request.travel, of, motor.unit) {
            (Some(given), ..) => motor.position(given, "--travel")?,
            (None, Loop::Speed, _) => run,
            (None, _, Unit::M) => TRAVEL_SHARE * room,
            (None, ..) => TRAVEL_RAD.max(TRAVEL_COUNTS * motor.resolution).min(TRAVEL_SHARE * room),
        };
        // A step must be well above the error at which the motor counts as arrived.
        let least = if of == Loop::Speed { run } else { 20.0 * motor.settle_error.max(motor.resolution) };
        if travel.is_nan() || travel < least {
            let (least, travel) = (quantity(least), quantity(travel));
            return Err(TuneError::TravelTooShort { channel, least, travel }.into());
        }
        // A speed is run upwards; its backward swing is small.
        let (below, above) = if of == Loop::Speed { (0.1 * travel, travel) } else { (travel, travel) };
        let (lowest, highest) = (motor.range.0 + below, motor.range.1 - above);
        if lowest > highest {
            let (travel, range) = (quantity(travel), quantity(room));
            return Err(TuneError::TravelTooLong { channel, travel, range }.into());
        }
        let base = match request.at {
            None => position.clamp(lowest, highest),
            Some(at) => {
                let at = motor.position(at, "--at")?;
                if !(lowest..=highest).contains(&at) {
                    let [travel, low, high, at] = [travel, lowest, highest, at].map(quantity);
                    return Err(TuneError::NoRoomThere { channel, travel, low, high, at }.into());
                }
                at
            }
        };
        let (most, static_duty) = (motor.duty_max, motor.static_duty());
        // The experiment starts from rest, where more duty would count as a stall.
        let cap = most.min(BELOW_STALL * motor.stall_duty);
        if let Some(given) = request.amplitude
            && !(given > 0.0 && given <= most)
        {
            return Err(TuneError::Amplitude { channel, most }.into());
        }
        let amplitude = request.amplitude.unwrap_or(cap);
        if of != Loop::Speed && request.method == Method::Relay && amplitude < static_duty + LEAST_BEYOND {
            return Err(TuneError::WithinFriction { channel, amplitude, static_duty }.into());
        }
        let step = STEP_SHARE * travel;
        let (steps, answer_s) = match of {
            Loop::Position | Loop::Cascade => ((base, base + step), motor.path_s(step) + SETTLE_S),
            Loop::Speed => ((SPEEDS.0 * motor.speed, SPEEDS.1 * motor.speed), SPEED_ANSWER_S),
        };
        let settle_s = motor.path_s(travel) + PATIENCE_S;
        let approach_s = motor.path_s((base - position).abs().max(travel)) + PATIENCE_S;
        // Approach, two responses of two steps each, three moves within the window, and the experiment itself.
        let needs_s =
            motor.path_s((base - position).abs()) + 4.0 * answer_s + 3.0 * motor.path_s(travel) + EXPERIMENT_S;
        if needs_s > request.time_s {
            return Err(TuneError::NotInTime { channel, needs_s }.into());
        }
        Ok(Self {
            of,
            motor,
            base,
            travel,
            window: (base - below, base + above),
            steps,
            answer_s,
            settle_s,
            approach_s,
            amplitude,
            given_amplitude: request.amplitude,
            // A requested amplitude may exceed the default limit.
            cap: cap.max(amplitude),
        })
    }

    /// Name of the loop, for the user.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self.of {
            Loop::Position => "position",
            Loop::Speed => "speed",
            Loop::Cascade => "cascade",
        }
    }

    /// Mode of the loop's set points.
    #[must_use]
    pub fn mode(&self) -> Mode {
        match self.of {
            Loop::Position | Loop::Cascade => Mode::Position,
            Loop::Speed => Mode::Speed,
        }
    }

    /// Mode of the loop that gets the tuned gains.
    #[must_use]
    pub fn gains_of(&self) -> Mode {
        match self.of {
            Loop::Position => Mode::Position,
            Loop::Speed | Loop::Cascade => Mode::Speed,
        }
    }

    /// The board around the motor's loop.
    ///
    /// The speed is assumed to be low-pass filtered, even though a board with a model of the motor knows it sooner: an
    /// angle sensor has no model, and a board does not report which sensor a motor has. Such loops are slower than they
    /// could be.
    pub(crate) fn conditions(&self) -> LoopConditions {
        let Motor { period_s, speed_filter_s: time_s, resolution, speed, .. } = self.motor;
        let estimate = SpeedEstimate::LowPass { time_s };
        LoopConditions { period_s, estimate, resolution, speeds: (SPEEDS.0 * speed, speed) }
    }

    /// Speed error that the sensor's counts alone cause in a mean over `mean_s`.
    pub(crate) fn speed_resolution(&self, mean_s: f64) -> f64 {
        let Motor { period_s, resolution, .. } = self.motor;
        let speed = self.steps.1;
        // Between infrequent counts lies a whole number of periods; of frequent ones there is one more or less.
        (speed * speed * period_s / resolution).min(resolution / mean_s)
    }

    /// Unit of the loop's output.
    #[must_use]
    pub fn unit(&self) -> Unit {
        match self.of {
            Loop::Position | Loop::Cascade => self.motor.unit,
            Loop::Speed => speed_unit(self.motor.unit),
        }
    }

    /// Steady error below which a loop counts as exact, in its unit.
    pub(crate) fn steady_band(&self) -> f64 {
        match self.of {
            Loop::Position | Loop::Cascade => self.motor.settle_error,
            Loop::Speed => 0.02 * (self.steps.1 - self.steps.0).abs(),
        }
    }
}

#[cfg(test)]
mod tests {
    use r4_protocol::{ChannelId, ModeInfo, ParameterInfo, ParameterKey, Range};

    use super::*;

    /// An actuator of 100 mm, like that of the bench.
    fn actuator() -> (ChannelInfo, Parameters) {
        let id = ChannelId::new(ChannelKind::Actuator, 1);
        let range = Range::new(0.0, 0.1);
        let position = ModeInfo { mode: Mode::Position, unit: Unit::M, range };
        let info = ChannelInfo {
            id,
            unit: Unit::M,
            range,
            rate_hz: 1000.0,
            resolution: 1e-6,
            modes: [position].into_iter().collect(),
        };
        let parameters = [
            (Parameter::DutyMax, 0.784),
            (Parameter::StaticDuty, 0.22),
            (Parameter::DutyPerSpeed, 54.0),
            (Parameter::DutyPerAcceleration, 0.0),
            (Parameter::Cascade, 0.0),
            (Parameter::SettleError, 5e-5),
            (Parameter::SpeedFilter, 0.03),
            (Parameter::PositionKp, 400.0),
            (Parameter::PositionKi, 400.0),
            (Parameter::PositionKd, 0.0),
            (Parameter::SpeedKp, 20.0),
            (Parameter::SpeedKi, 200.0),
            (Parameter::SpeedKd, 0.0),
            (Parameter::StallDuty, 0.6),
            (Parameter::ProfileSpeed, 0.008),
            (Parameter::ProfileAcceleration, 0.05),
            (Parameter::Jerk, 0.0),
            (Parameter::PositionMin, 0.0),
            (Parameter::PositionMax, 0.1),
        ];
        let info_of = |(parameter, value)| ParameterInfo {
            key: ParameterKey { channel: Some(id), parameter },
            active: value,
            set: value,
            built_in: value,
        };
        (info, Parameters(parameters.map(info_of).to_vec()))
    }

    #[test]
    fn a_run_stays_within_the_range_and_below_a_stall() {
        let (info, parameters) = actuator();
        for (position, base) in [(0.0, 0.01), (0.05, 0.05), (0.1, 0.09)] {
            let plan = Plan::new(&TuneRequest::new(info.id), &info, &parameters, position).expect("a plan");
            assert!((plan.base - base).abs() < 1e-6, "{plan:?}");
            assert!(plan.window.0 >= -1e-8 && plan.window.1 <= 0.1 + 1e-8, "{plan:?}");
            assert!(plan.amplitude < 0.6, "{plan:?}");
        }
        let fast = TuneRequest { of: Some(Loop::Speed), ..TuneRequest::new(info.id) };
        let plan = Plan::new(&fast, &info, &parameters, 0.1).expect("a plan");
        assert!(plan.window.1 <= 0.1 + 1e-8 && plan.window.0 >= -1e-8, "{plan:?}");
    }

    #[test]
    fn what_does_not_fit_is_refused_before_anything_moves() {
        let (info, parameters) = actuator();
        let tune = TuneRequest { method: Method::Relay, ..TuneRequest::new(info.id) };
        let mm = |value: f64| Some(Quantity::new(value * 1e-3, Unit::M));
        for (tune, says) in [
            (TuneRequest { travel: mm(60.0), ..tune.clone() }, "no room"),
            (TuneRequest { travel: mm(0.1), ..tune.clone() }, "needs a travel"),
            (TuneRequest { travel: mm(f64::NAN), ..tune.clone() }, "needs a travel"),
            (TuneRequest { travel: Some(Quantity::new(1.0, Unit::Rad)), ..tune.clone() }, "as in 10mm"),
            (TuneRequest { at: mm(95.0), ..tune.clone() }, "not at"),
            (TuneRequest { amplitude: Some(0.9), ..tune.clone() }, "--amplitude up to 0.784"),
            (TuneRequest { amplitude: Some(0.23), ..tune.clone() }, "friction"),
            (TuneRequest { time_s: 5.0, ..tune.clone() }, "--time"),
            (TuneRequest { of: Some(Loop::Speed), travel: mm(10.0), ..tune }, "needs a travel"),
        ] {
            let error = Plan::new(&tune, &info, &parameters, 0.05).expect_err(says).to_string();
            assert!(error.contains(says), "{error}");
        }
    }
}
