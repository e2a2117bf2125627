//! Effects that a skid-steered robot may show, as the estimator models them.

use r4_plants::Dependence::{self, Direction, History, Input, Speed, Time};

use super::{Geometry, Output};
use crate::family::{Candidate, Parameter, Range};

/// Effects of a skid-steered robot, in the order of the catalogue.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Effect {
    /// Effective track: turning is less by a constant factor.
    Track,
    /// Slip that grows with the turning rate.
    Turning,
    /// Slip in turning that grows with the forward speed.
    Driving,
    /// Slip in turning that grows with the difference of the sides' speeds: a tyre that rolls slowly resists sliding
    /// more.
    StandingSide,
    /// Different turning to the left and to the right.
    TurnDirection,
    /// Different motion forwards and backwards.
    TravelDirection,
    /// Slip that changes exponentially during a run.
    Drift,
    /// Forward speed less than that of the wheels by a constant factor.
    Longitudinal,
    /// Forward speed that falls while the robot turns.
    LongitudinalTurning,
    /// Turning centre ahead of or behind the pose's point.
    Lateral,
    /// Wheels of different radius on both sides.
    EncoderScale,
    DeadZone,
    /// Largest yaw rate that ground friction allows, less with forward speed.
    FrictionLimit,
    RateLimit,
    /// Saturation of the drives, which slow down both sides by the same factor.
    WheelSaturation,
    SlewLimit,
    DriveLag,
    DriveLagSides,
    InputDelay,
    /// Recorded speeds of the sides are late: filtered, or held from sample to sample.
    EncoderDelay,
    SensorLag,
    SensorOffset,
}

/// Typical magnitudes of quantities in the data.
#[derive(Clone, Copy, Debug)]
pub(super) struct Scales {
    /// Speed of a wheel, rad/s.
    pub(super) wheel: f64,
    /// Speed along the body, m/s.
    pub(super) speed: f64,
    /// Yaw rate without slip, rad/s.
    pub(super) turn: f64,
    /// Magnitude of the output, in its unit.
    pub(super) output: f64,
    pub(super) period_s: f64,
    pub(super) duration_s: f64,
}

impl Effect {
    pub(super) const COUNT: usize = Self::ALL.len();

    const ALL: [Self; 22] = [
        Self::Track,
        Self::Turning,
        Self::Driving,
        Self::StandingSide,
        Self::TurnDirection,
        Self::TravelDirection,
        Self::Drift,
        Self::Longitudinal,
        Self::LongitudinalTurning,
        Self::Lateral,
        Self::EncoderScale,
        Self::DeadZone,
        Self::FrictionLimit,
        Self::RateLimit,
        Self::WheelSaturation,
        Self::SlewLimit,
        Self::DriveLag,
        Self::DriveLagSides,
        Self::InputDelay,
        Self::EncoderDelay,
        Self::SensorLag,
        Self::SensorOffset,
    ];

    /// Returns the effects that could show in an output; `averaged` if means over spans are compared.
    pub(super) fn of(output: Output, averaged: bool) -> Vec<Self> {
        let shows = |effect: &Self| match effect {
            Self::Track
            | Self::Turning
            | Self::Driving
            | Self::StandingSide
            | Self::TurnDirection
            | Self::EncoderScale
            | Self::FrictionLimit
            | Self::RateLimit
            | Self::WheelSaturation => output == Output::YawRate,
            Self::TravelDirection | Self::Drift => output != Output::LateralSpeed,
            Self::Longitudinal | Self::LongitudinalTurning => output == Output::ForwardSpeed,
            Self::Lateral => output == Output::LateralSpeed,
            // Means of long spans cannot distinguish short memories: a single lag represents them all.
            Self::DriveLagSides | Self::InputDelay | Self::EncoderDelay | Self::SensorLag => !averaged,
            Self::DeadZone | Self::SlewLimit | Self::DriveLag | Self::SensorOffset => true,
        };
        Self::ALL.into_iter().filter(shows).collect()
    }

    /// Returns the name of the effect in reports.
    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::Track => "slip-track",
            Self::Turning => "slip-turning",
            Self::Driving => "slip-driving",
            Self::StandingSide => "slip-standing-side",
            Self::TurnDirection => "direction-asymmetry",
            Self::TravelDirection => "travel-asymmetry",
            Self::Drift => "slip-drift",
            Self::Longitudinal => "slip-longitudinal",
            Self::LongitudinalTurning => "slip-longitudinal-turning",
            Self::Lateral => "slip-lateral",
            Self::EncoderScale => "encoder-scale",
            Self::DeadZone => "dead-zone",
            Self::FrictionLimit => "slip-limit",
            Self::RateLimit => "rate-limit",
            Self::WheelSaturation => "saturation",
            Self::SlewLimit => "slew-limit",
            Self::DriveLag => "drive-lag",
            Self::DriveLagSides => "drive-lag-sides",
            Self::InputDelay => "input-delay",
            Self::EncoderDelay => "encoder-delay",
            Self::SensorLag => "sensor-lag",
            Self::SensorOffset => "sensor-offset",
        }
    }

    const fn depends_on(self) -> &'static [Dependence] {
        match self {
            Self::Track | Self::Turning | Self::DeadZone | Self::RateLimit => &[Input],
            Self::Driving
            | Self::StandingSide
            | Self::LongitudinalTurning
            | Self::FrictionLimit
            | Self::WheelSaturation => &[Input, Speed],
            Self::TurnDirection => &[Input, Direction],
            Self::TravelDirection => &[Speed, Direction],
            Self::Drift => &[Input, Time],
            Self::Longitudinal | Self::EncoderScale => &[Speed],
            Self::Lateral => &[Input],
            Self::SlewLimit | Self::DriveLag | Self::DriveLagSides | Self::InputDelay | Self::EncoderDelay => {
                &[Input, History]
            }
            Self::SensorLag => &[Speed, History],
            Self::SensorOffset => &[],
        }
    }

    const fn experiment(self) -> &'static str {
        match self {
            Self::Track => "turns on the spot at several speeds, both ways, against a mark",
            Self::Turning => "turns on the spot, from slow to the fastest, both ways",
            Self::Driving => "the same difference of the sides at three forward speeds",
            Self::StandingSide => "turns about one side: its wheels held, then slowly forwards, then slowly backwards",
            Self::TurnDirection => "the same turn both ways",
            Self::TravelDirection => "the same arc forwards and backwards",
            Self::Drift => "the same turn at the beginning and the end of a long drive",
            Self::Longitudinal => "a straight drive of 10 m against a tape",
            Self::LongitudinalTurning => "arcs of several radii at one forward speed",
            Self::Lateral => "turns on the spot with the pose of two points of the body",
            Self::EncoderScale => {
                "a straight drive of 10 m both ways: the arc turns round with the direction, an offset does not"
            }
            Self::DeadZone => "slow ramps through zero",
            Self::FrictionLimit => "turns at the largest difference of the sides, at three forward speeds",
            Self::RateLimit => "turns on the spot by commands up to the largest",
            Self::WheelSaturation => "straight drives and turns by commands up to the largest",
            Self::SlewLimit => "steps of several sizes: a slew limit takes longer for larger ones, a lag does not",
            Self::DriveLag => "steps of several sizes, recorded at 100 Hz or more",
            Self::DriveLagSides => "steps of one side alone, then of the other",
            Self::InputDelay => {
                "steps of several sizes at 100 Hz or more: a delay shifts them all alike, a lag rounds them"
            }
            Self::EncoderDelay => {
                "the wheels' speeds recorded at a higher rate: a hold shows as stairs, a filter as rounded steps"
            }
            Self::SensorLag => "a second sensor of the body's motion beside the first",
            Self::SensorOffset => "a minute of standing still",
        }
    }

    const fn excludes(self) -> &'static [&'static str] {
        match self {
            Self::FrictionLimit => &["rate-limit"],
            Self::RateLimit => &["slip-limit"],
            Self::DriveLag => &["drive-lag-sides"],
            Self::DriveLagSides => &["drive-lag"],
            Self::InputDelay => &["encoder-delay"],
            Self::EncoderDelay => &["input-delay"],
            _ => &[],
        }
    }

    /// Returns the catalogue entry, with initial guesses scaled by the magnitudes in the data.
    pub(super) fn candidate(self, geometry: &Geometry, output: Output, scales: &Scales) -> Candidate {
        let s = scales;
        let any = |scale| Range::Any { scale };
        let level = |scale| Range::NotNegative { scale };
        let parameter = |name, unit, range, absent| Parameter { name, unit, range, absent };
        let (zero, whole) = (Some(0.0), Some(1.0));
        let sized = |sizes: &[f64], by: f64| sizes.iter().map(|size| vec![size * by]).collect();
        // A time shorter than a sample is collinear with the input's course between samples.
        let memory = Range::Between(s.period_s, (60.0 * s.period_s).max(3.0));
        let short = [2.0, 5.0, 20.0].map(|periods| vec![periods * s.period_s]).to_vec();
        let longer = [0.1, 0.4].into_iter().filter(|&time_s| time_s > 1.5 * s.period_s).map(|time_s| vec![time_s]);
        let short = [short, longer.collect()].concat();
        let (parameters, starts): (Vec<Parameter>, Vec<Vec<f64>>) = match self {
            Self::Track => (
                vec![parameter("effective_track_m", "m", Range::Positive, Some(geometry.track_m))],
                sized(&[0.7, 1.3, 2.5], geometry.track_m),
            ),
            Self::Turning => (
                vec![parameter("slip_s_per_rad", "s/rad", level(0.1 / s.turn), zero)],
                sized(&[0.2, 1.5], s.turn.recip()),
            ),
            Self::Driving => {
                (vec![parameter("slip_s_per_m", "s/m", any(0.1 / s.speed), zero)], sized(&[0.3, -0.3], s.speed.recip()))
            }
            Self::StandingSide => (
                vec![
                    parameter("resistance", "1", level(0.1), zero),
                    parameter("creep_m_s", "m/s", Range::Positive, None),
                ],
                [0.03, 0.3].iter().flat_map(|share| [0.3, 1.5].map(|size| vec![size, share * s.speed])).collect(),
            ),
            Self::TurnDirection => (
                vec![parameter("left_more_than_right", "1", Range::Between(-1.0, 1.0), zero)],
                sized(&[0.1, -0.1], 1.0),
            ),
            Self::TravelDirection => (
                vec![parameter("forwards_more_than_backwards", "1", Range::Between(-1.0, 1.0), zero)],
                sized(&[0.1, -0.1], 1.0),
            ),
            Self::Drift => (
                vec![parameter("change_per_s", "1/s", any(0.1 / s.duration_s), zero)],
                sized(&[0.3, -0.3], s.duration_s.recip()),
            ),
            Self::Longitudinal => (vec![parameter("scale", "1", Range::Positive, whole)], sized(&[0.8, 1.2], 1.0)),
            Self::LongitudinalTurning => (
                vec![parameter("slip_s_per_rad", "s/rad", any(0.1 / s.turn), zero)],
                sized(&[0.3, -0.1], s.turn.recip()),
            ),
            Self::Lateral => (
                vec![parameter("turning_centre_m", "m", any(0.2 * geometry.track_m), zero)],
                sized(&[0.2, -0.2], geometry.track_m),
            ),
            Self::EncoderScale => {
                (vec![parameter("right_over_left", "1", Range::Between(0.5, 2.0), whole)], sized(&[1.03, 0.97], 1.0))
            }
            Self::DeadZone => {
                (vec![parameter("wheel_rad_s", "rad/s", level(0.05 * s.wheel), zero)], sized(&[0.03, 0.2], s.wheel))
            }
            Self::RateLimit => (
                vec![parameter("limit_rad_s", "rad/s", Range::Positive, None)],
                sized(&[0.95, 0.7, 0.5, 0.3], s.output),
            ),
            Self::FrictionLimit => (
                vec![
                    parameter("limit_rad_s", "rad/s", Range::Positive, None),
                    parameter("less_rad_per_m", "rad/m", level(0.1 * s.output / s.speed), zero),
                ],
                [0.9, 0.6].map(|share| vec![share * s.output, 0.3 * s.output / s.speed]).to_vec(),
            ),
            // A controller that commands turning and driving does both with gains not far from one.
            Self::WheelSaturation => (
                vec![
                    parameter("wheel_rad_s", "rad/s", Range::Positive, None),
                    parameter("forward_gain", "1", Range::Between(0.5, 4.0), None),
                ],
                [0.95, 0.7, 0.4].iter().flat_map(|share| [1.0, 2.0].map(|gain| vec![share * s.wheel, gain])).collect(),
            ),
            Self::SlewLimit => {
                let (name, unit) = match output {
                    Output::YawRate => ("limit_rad_s2", "rad/s^2"),
                    _ => ("limit_m_s2", "m/s^2"),
                };
                (vec![parameter(name, unit, Range::Positive, None)], sized(&[10.0, 3.0, 1.0], s.output))
            }
            Self::DriveLag | Self::SensorLag => (vec![parameter("time_constant_s", "s", memory, zero)], short),
            Self::DriveLagSides => (
                vec![
                    parameter("left_time_constant_s", "s", level(s.period_s), zero),
                    parameter("right_time_constant_s", "s", level(s.period_s), zero),
                ],
                [0.1, 0.4].map(|time_s| vec![time_s, time_s]).to_vec(),
            ),
            Self::InputDelay => (
                vec![parameter("delay_s", "s", memory, zero)],
                // Delays are not whole samples, at which the gradient with respect to the delay jumps.
                sized(&[1.5, 4.5, 9.5], s.period_s),
            ),
            Self::EncoderDelay => (vec![parameter("late_s", "s", memory, zero)], sized(&[1.5, 4.5], s.period_s)),
            Self::SensorOffset => {
                let (name, unit) = match output {
                    Output::YawRate => ("offset_rad_s", "rad/s"),
                    _ => ("offset_m_s", "m/s"),
                };
                (vec![parameter(name, unit, any(0.05 * s.output), zero)], sized(&[0.05, -0.05], s.output))
            }
        };
        Candidate {
            name: self.name(),
            depends_on: self.depends_on(),
            parameters,
            starts,
            experiment: self.experiment(),
            excludes: self.excludes(),
            led_by: None,
        }
    }
}
