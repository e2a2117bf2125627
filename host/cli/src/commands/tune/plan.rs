//! What a run does, checked before anything moves.

use anyhow::{Context, bail, ensure};
use r4_driver::tune::Loop;
use r4_protocol::{ChannelInfo, ChannelKind, Mode, Parameter, ParameterInfo, Unit, config::PidGains};

use super::{Tune, Which};
use crate::commands::speed_unit;
use r4_rig::quantity::Quantity;

/// What a rotary motor may travel unless told otherwise, rad; what a linear one, as a share of its range.
const TRAVEL_RAD: f64 = 1.0;
const TRAVEL_SHARE: f64 = 0.1;
/// A step of the position, as a share of the travel.
const STEP_SHARE: f64 = 0.5;
/// Of the path's speed: between what a speed loop steps, and for how long it runs in one go.
const SPEEDS: (f64, f64) = (0.4, 0.8);
const SPEED_RUN_S: f64 = 6.0;
/// A relay stays this short of the duty that counts as a stall when nothing moves.
const BELOW_STALL: f64 = 0.9;
/// So much duty beyond friction is the least that is worth a try.
const LEAST_BEYOND: f64 = 0.03;
/// The steps are watched for the time of the path and so long, s.
const SETTLE_S: f64 = 3.0;
/// A speed is watched for so long, s.
const SPEED_ANSWER_S: f64 = 1.5;
/// A motor that does not rest for so long beyond its path's time does not come to rest, s.
const PATIENCE_S: f64 = 5.0;
/// What all but going there and the steps takes at most, s.
const EXPERIMENT_S: f64 = 12.0;

/// What the board says of the motor, SI.
#[derive(Clone, Copy, Debug)]
pub(super) struct Motor {
    pub(super) unit: Unit,
    pub(super) resolution: f64,
    pub(super) period_s: f64,
    pub(super) duty_max: f64,
    pub(super) static_duty: f64,
    pub(super) settle_error: f64,
    pub(super) speed_filter_s: f64,
    pub(super) gains: PidGains,
    stall_duty: f64,
    speed: f64,
    acceleration: f64,
    range: (f64, f64),
}

/// What is done.
#[derive(Clone, Copy, Debug)]
pub(super) struct Plan {
    pub(super) of: Loop,
    pub(super) motor: Motor,
    /// Where it begins, and how far from there it may go.
    pub(super) base: f64,
    pub(super) travel: f64,
    /// Where the motor must stay.
    pub(super) window: (f64, f64),
    /// Set points between which the loop steps.
    pub(super) steps: (f64, f64),
    /// How long each is watched, how long the motor may take to a position within the window and to where it begins, s.
    pub(super) answer_s: f64,
    pub(super) settle_s: f64,
    pub(super) approach_s: f64,
    /// Duty of a position experiment; what was asked for; and the most there may be.
    pub(super) amplitude: f64,
    pub(super) given_amplitude: Option<f64>,
    pub(super) cap: f64,
}

impl Motor {
    fn new(info: &ChannelInfo, parameters: &[ParameterInfo], of: Loop) -> anyhow::Result<Self> {
        let channel = info.id;
        let number = |parameter: Parameter| {
            let of = |info: &&ParameterInfo| info.key.channel == Some(channel) && info.key.parameter == parameter;
            let found = parameters.iter().find(of).map(|info| info.active);
            found.with_context(|| format!("the board does not tell {} of {channel}", parameter.name()))
        };
        let gains = match of {
            Loop::Position => [Parameter::PositionKp, Parameter::PositionKi, Parameter::PositionKd],
            Loop::Speed => [Parameter::SpeedKp, Parameter::SpeedKi, Parameter::SpeedKd],
        };
        Ok(Self {
            unit: info.unit,
            resolution: info.resolution.into(),
            period_s: 1.0 / f64::from(info.rate_hz),
            duty_max: number(Parameter::DutyMax)?.into(),
            static_duty: number(Parameter::StaticDuty)?.into(),
            settle_error: number(Parameter::SettleError)?.into(),
            speed_filter_s: number(Parameter::SpeedFilter)?.into(),
            gains: PidGains { kp: number(gains[0])?, ki: number(gains[1])?, kd: number(gains[2])? },
            stall_duty: number(Parameter::StallDuty)?.into(),
            speed: number(Parameter::ProfileSpeed)?.into(),
            acceleration: number(Parameter::ProfileAcceleration)?.into(),
            range: (number(Parameter::PositionMin)?.into(), number(Parameter::PositionMax)?.into()),
        })
    }

    /// How long a path takes, s.
    fn path_s(&self, distance: f64) -> f64 {
        let ramps = self.speed * self.speed / self.acceleration;
        if distance > ramps {
            distance / self.speed + self.speed / self.acceleration
        } else {
            2.0 * (distance / self.acceleration).sqrt()
        }
    }

    fn position(&self, given: Quantity, option: &str) -> anyhow::Result<f64> {
        ensure!(given.unit == self.unit, "{option} takes a number in {}, as in {}", self.unit, example(self.unit));
        Ok(given.value)
    }
}

fn example(unit: Unit) -> &'static str {
    if unit == Unit::M { "10mm" } else { "60deg" }
}

/// Whether a channel has loops at all.
pub(super) fn check_has_loops(info: &ChannelInfo) -> anyhow::Result<()> {
    let channel = info.id;
    let moves = matches!(channel.kind, ChannelKind::Osmc | ChannelKind::Actuator | ChannelKind::Dhb);
    ensure!(
        moves && info.mode(Mode::Position).is_some(),
        "{channel} has no loops to tune: a motor with an encoder or a potentiometer has"
    );
    Ok(())
}

impl Plan {
    /// The run that `tune` asks for with a motor that stands at `position`.
    ///
    /// # Errors
    /// Why it cannot be made within the travel, the time and the duty that there are.
    pub(super) fn new(
        tune: &Tune,
        info: &ChannelInfo,
        parameters: &[ParameterInfo],
        position: f64,
    ) -> anyhow::Result<Self> {
        let channel = info.id;
        let of = match tune.mode {
            Which::Position => Loop::Position,
            Which::Speed => Loop::Speed,
        };
        let motor = Motor::new(info, parameters, of)?;
        let quantity = |value| Quantity::new(value, motor.unit);
        let room = motor.range.1 - motor.range.0;
        let run = SPEEDS.1 * motor.speed * SPEED_RUN_S;
        let travel = match (tune.travel, of, motor.unit) {
            (Some(given), ..) => motor.position(given, "--travel")?,
            (None, Loop::Speed, _) => run,
            (None, Loop::Position, Unit::M) => TRAVEL_SHARE * room,
            (None, Loop::Position, _) => TRAVEL_RAD.min(TRAVEL_SHARE * room),
        };
        let least = if of == Loop::Speed { run } else { 20.0 * motor.settle_error.max(motor.resolution) };
        if travel.is_nan() || travel < least {
            bail!("{channel} needs a travel of {} for this, not {}", quantity(least), quantity(travel));
        }
        // A speed is run upwards; what it swings back is little.
        let (below, above) = if of == Loop::Speed { (0.1 * travel, travel) } else { (travel, travel) };
        let (lowest, highest) = (motor.range.0 + below, motor.range.1 - above);
        if lowest > highest {
            bail!("{channel} has no room for a travel of {}: its range is {}", quantity(travel), quantity(room));
        }
        let base = match tune.at {
            None => position.clamp(lowest, highest),
            Some(at) => {
                let at = motor.position(at, "--at")?;
                if !(lowest..=highest).contains(&at) {
                    let (low, high) = (quantity(lowest), quantity(highest));
                    bail!(
                        "{channel} has room for a travel of {} from {low} to {high}, not at {}",
                        quantity(travel),
                        quantity(at)
                    );
                }
                at
            }
        };
        let cap = motor.duty_max.min(BELOW_STALL * motor.stall_duty);
        if let Some(given) = tune.amplitude
            && !(given > 0.0 && given <= motor.duty_max)
        {
            bail!("{channel} takes an --amplitude up to {:.3}", motor.duty_max);
        }
        let amplitude = tune.amplitude.unwrap_or(cap);
        if of == Loop::Position && amplitude < motor.static_duty + LEAST_BEYOND {
            bail!(
                "duty {amplitude:.3} is no more than what friction takes of {channel} ({:.3}): allow more with --amplitude",
                motor.static_duty
            );
        }
        let step = STEP_SHARE * travel;
        let (steps, answer_s) = match of {
            Loop::Position => ((base, base + step), motor.path_s(step) + SETTLE_S),
            Loop::Speed => ((SPEEDS.0 * motor.speed, SPEEDS.1 * motor.speed), SPEED_ANSWER_S),
        };
        let settle_s = motor.path_s(travel) + PATIENCE_S;
        let approach_s = motor.path_s((base - position).abs().max(travel)) + PATIENCE_S;
        let needs_s =
            motor.path_s((base - position).abs()) + 4.0 * answer_s + 3.0 * motor.path_s(travel) + EXPERIMENT_S;
        if needs_s > tune.time {
            bail!("{channel} may take {needs_s:.0} s: allow it with --time, or less --travel");
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
            given_amplitude: tune.amplitude,
            cap: cap.max(amplitude),
        })
    }

    /// How the loop is commanded.
    pub(super) fn mode(&self) -> Mode {
        match self.of {
            Loop::Position => Mode::Position,
            Loop::Speed => Mode::Speed,
        }
    }

    /// What the loop measures in.
    pub(super) fn unit(&self) -> Unit {
        match self.of {
            Loop::Position => self.motor.unit,
            Loop::Speed => speed_unit(self.motor.unit),
        }
    }

    /// Steady errors within this are as good as none.
    pub(super) fn steady_band(&self) -> f64 {
        match self.of {
            Loop::Position => self.motor.settle_error,
            Loop::Speed => 0.02 * (self.steps.1 - self.steps.0).abs(),
        }
    }
}

#[cfg(test)]
mod tests {
    use r4_protocol::{ChannelId, ModeInfo, ParameterKey, Range};

    use super::*;

    fn tune(channel: ChannelId) -> Tune {
        Tune {
            channel,
            method: super::super::Method::Relay,
            mode: Which::Position,
            save: false,
            report: None,
            travel: None,
            at: None,
            amplitude: None,
            margin: 60.0,
            time_constant: None,
            time: 60.0,
        }
    }

    /// An actuator of 100 mm, as the bench's.
    fn actuator() -> (ChannelInfo, Vec<ParameterInfo>) {
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
            (Parameter::PositionMin, 0.0),
            (Parameter::PositionMax, 0.1),
        ];
        let info_of = |(parameter, value)| ParameterInfo {
            key: ParameterKey { channel: Some(id), parameter },
            active: value,
            set: value,
            built_in: value,
        };
        (info, parameters.map(info_of).to_vec())
    }

    #[test]
    fn a_run_stays_within_the_range_and_below_a_stall() {
        let (info, parameters) = actuator();
        for (position, base) in [(0.0, 0.01), (0.05, 0.05), (0.1, 0.09)] {
            let plan = Plan::new(&tune(info.id), &info, &parameters, position).expect("a plan");
            assert!((plan.base - base).abs() < 1e-6, "{plan:?}");
            assert!(plan.window.0 >= -1e-8 && plan.window.1 <= 0.1 + 1e-8, "{plan:?}");
            assert!(plan.amplitude < 0.6, "{plan:?}");
        }
        let fast = Tune { mode: Which::Speed, ..tune(info.id) };
        let plan = Plan::new(&fast, &info, &parameters, 0.1).expect("a plan");
        assert!(plan.window.1 <= 0.1 + 1e-8 && plan.window.0 >= -1e-8, "{plan:?}");
    }

    #[test]
    fn what_does_not_fit_is_refused_before_anything_moves() {
        let (info, parameters) = actuator();
        let tune = tune(info.id);
        let mm = |value: f64| Some(Quantity::new(value * 1e-3, Unit::M));
        for (tune, says) in [
            (Tune { travel: mm(60.0), ..tune.clone() }, "no room"),
            (Tune { travel: mm(0.1), ..tune.clone() }, "needs a travel"),
            (Tune { travel: mm(f64::NAN), ..tune.clone() }, "needs a travel"),
            (Tune { travel: Some(Quantity::new(1.0, Unit::Rad)), ..tune.clone() }, "as in 10mm"),
            (Tune { at: mm(95.0), ..tune.clone() }, "not at"),
            (Tune { amplitude: Some(0.9), ..tune.clone() }, "--amplitude up to 0.784"),
            (Tune { amplitude: Some(0.23), ..tune.clone() }, "friction"),
            (Tune { time: 5.0, ..tune.clone() }, "--time"),
            (Tune { mode: Which::Speed, travel: mm(10.0), ..tune }, "needs a travel"),
        ] {
            let error = Plan::new(&tune, &info, &parameters, 0.05).expect_err(says).to_string();
            assert!(error.contains(says), "{error}");
        }
    }
}
