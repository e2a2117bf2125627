//! Effects that a moving axis may show, as the estimator models them.

use r4_plants::Dependence;

use crate::family::{Candidate, Parameter, Range};

use super::Scales;

/// Parameter name: share of a motor's damping that is friction, not back-EMF.
pub(super) const VISCOUS_SHARE: &str = "viscous_share_of_damping";
/// Parameter name: delay of the stamps of a sampled input, s, which shows only if the command is held.
pub(super) const INPUT_LATE: &str = "input_stamps_late_s";
/// Largest relative error of a clock that is fitted. Our choice: without a limit, 4.6e-3 explained part of a
/// recording whose rows run backwards; other values have not been compared.
const WORST_CLOCK: f64 = 2e-3;
/// Share of friction in the damping from which fits begin.
const LITTLE_VISCOUS: f64 = 0.1;

/// Defines the effects and their entries from one table, so that none can lack an entry: name in reports and plant files,
/// quantities that it depends on, and advice for a recording that separates it from similar ones.
macro_rules! effects {
    ($($variant:ident, $name:literal, [$($dependence:ident),+], $experiment:literal;)+) => {
        /// Effects of a moving axis, in the order of the catalogue.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub(super) enum Effect {
            $($variant,)+
        }

        impl Effect {
            pub(super) const ALL: [Self; [$($name),+].len()] = [$(Self::$variant),+];

            /// Returns the name in reports and plant files.
            pub(super) const fn name(self) -> &'static str {
                match self { $(Self::$variant => $name,)+ }
            }

            const fn depends_on(self) -> &'static [Dependence] {
                match self { $(Self::$variant => &[$(Dependence::$dependence),+],)+ }
            }

            /// Returns the advice for a recording that separates the effect from similar ones.
            const fn experiment(self) -> &'static str {
                match self { $(Self::$variant => $experiment,)+ }
            }
        }
    };
}

effects! {
    ClockDrift, "clock-drift", [Time],
        "input and output stamped by one clock";
    InputSign, "input-sign", [Input],
        "one step each way with the sensor's direction checked by eye";
    InputDelay, "input-delay", [Input, History],
        "steps of several sizes from rest at a high rate: a delay shifts them all alike, a lag rounds them";
    InputHold, "input-hold", [Input, History],
        "a fast triangle as command: a held command shows as stairs";
    DeadZone, "dead-zone", [Input],
        "slow ramps of the command through zero from rest and in motion: a dead zone also acts in motion";
    GainCurve, "gain-curve", [Input],
        "steady speeds at ten commands of each sign";
    DirectionAsymmetry, "direction-asymmetry", [Input, Direction],
        "the same steps both ways at three sizes: a gain scales with the size, a friction does not";
    Saturation, "saturation", [Input],
        "steady speeds at commands up to full scale";
    SlewLimit, "slew-limit", [Input, History],
        "steps of several sizes: a slew limit takes longer for larger ones, a lag does not";
    DriveLag, "drive-lag", [Input, History],
        "steps of several sizes at a high rate, and coasting after a cut";
    SupplySag, "supply-sag", [Supply, Input, Speed],
        "the voltage of the supply, recorded beside the rest";
    WindingHeating, "winding-heating", [Time, History],
        "a minute of hard driving, then the first steps again after a rest";
    Coulomb, "coulomb-friction", [Direction],
        "coasting down from several speeds, and slow ramps through zero";
    Static, "static-friction", [Speed, Direction],
        "very slow ramps from rest, each way, several times";
    DirectionFriction, "direction-friction", [Direction],
        "constant speeds both ways, slow and fast";
    DirectionViscous, "direction-viscous", [Speed, Direction],
        "constant speeds both ways, slow and fast";
    LoadFriction, "load-friction", [Direction, Input],
        "the same motion with two different loads on the output";
    PositionFriction, "position-friction", [Position, Direction],
        "slow constant speed over several turns, both ways";
    WarmUp, "friction-warm-up", [Time, Direction],
        "the same cycle repeated for some minutes from a cold start";
    Drag, "quadratic-drag", [Speed],
        "steady speeds at ten commands up to the highest";
    ConstantLoad, "constant-load", [Time],
        "holding at rest with the axis turned over";
    Gravity, "gravity-load", [Position],
        "slow constant speed over several turns, both ways: a load pulls alike both ways, friction does not";
    Cogging, "cogging", [Position],
        "slow constant speed over several turns at a high rate";
    Backlash, "backlash", [History, Direction],
        "small reversals, with sensors at the motor and at the output";
    Compliance, "compliance", [Acceleration, History],
        "a sweep of frequencies through the resonance, at two amplitudes";
    SensorLag, "sensor-lag", [Speed, History],
        "a second sensor, or the current beside the position";
    SensorHold, "sensor-hold", [Speed, History],
        "a steady motion recorded at a higher rate: a held value shows as stairs";
    Eccentricity, "eccentricity", [Position],
        "constant speed over several turns at two speeds: an error of the sensor does not change with speed";
    EncoderScale, "encoder-scale", [Position],
        "ten whole turns against a mark";
    EncoderOffset, "encoder-offset", [Position],
        "rest at a mark";
}

impl Effect {
    const fn excludes(self) -> &'static [&'static str] {
        match self {
            Self::Coulomb => &["direction-friction"],
            Self::DirectionFriction => &["coulomb-friction"],
            _ => &[],
        }
    }

    /// Returns the catalogue entry, with initial guesses scaled by the magnitudes in the data.
    pub(super) fn candidate(self, scales: &Scales, of_speed: bool) -> Candidate {
        let s = scales;
        let (distance, speed, force) = (s.units.distance, s.units.speed, s.units.force);
        // Acceleration by a tenth of the largest command.
        let push = 0.1 * s.acceleration;
        // For a limit: absent if it is beyond everything that is recorded.
        let below = |most: f64, name, unit, range| Parameter { name, unit, range, absent: Some(most) };
        let shaped = |name, unit, range| Parameter { name, unit, range, absent: None };
        let sized = |name, unit, range| Parameter { name, unit, range, absent: Some(0.0) };
        let whole = |name, unit, range| Parameter { name, unit, range, absent: Some(1.0) };
        let level = |scale| Range::NotNegative { scale };
        // A motor's damping is partly back-EMF and partly friction; only effects on the current distinguish them.
        let damping = s.damps_by_emf.then(|| shaped(VISCOUS_SHARE, "1", Range::Between(0.0, 1.0)));
        let with_viscous = |mut parameters: Vec<Parameter>| {
            parameters.extend(damping.clone());
            parameters
        };
        let from = |starts: Vec<Vec<f64>>| -> Vec<Vec<f64>> {
            let share = damping.is_some().then_some(LITTLE_VISCOUS);
            starts.into_iter().map(|start| start.into_iter().chain(share).collect()).collect()
        };
        let (parameters, starts): (Vec<Parameter>, Vec<Vec<f64>>) = match self {
            Self::ClockDrift => (
                vec![sized("drift", "1", Range::Reflected(-WORST_CLOCK, WORST_CLOCK))],
                vec![vec![0.2 * WORST_CLOCK], vec![-0.2 * WORST_CLOCK]],
            ),
            Self::InputSign => (vec![], vec![vec![]]),
            Self::InputDelay => (
                vec![sized("delay_s", "s", level(s.period_s))],
                vec![vec![1.5 * s.period_s], vec![5.0 * s.period_s], vec![0.05], vec![0.15]],
            ),
            Self::SensorHold => (
                vec![sized("period_s", "s", Range::Coarse { step: 2e-4 })],
                s.stairs_s.iter().map(|&hold_s| vec![hold_s]).collect(),
            ),
            Self::InputHold => {
                let late = || s.input_is_sampled.then_some(0.0);
                let late_s = late().map(|_| shaped(INPUT_LATE, "s", Range::Between(-s.period_s, s.period_s)));
                let period = sized("period_s", "s", Range::Coarse { step: 2e-4 });
                (
                    late_s.into_iter().chain([period]).collect(),
                    // The full list is only used if no period is found in the weak form.
                    (0..)
                        .map(|n| 2.0 * s.period_s * 1.015_f64.powi(n))
                        .take_while(|&hold_s| hold_s < 0.6)
                        .map(|hold_s| late().into_iter().chain([hold_s]).collect())
                        .collect(),
                )
            }
            Self::DeadZone => (
                vec![sized(s.units.input_name, s.units.input, level(0.05 * s.input))],
                [0.02, 0.1, 0.3].iter().map(|share| vec![share * s.input]).collect(),
            ),
            Self::GainCurve => (vec![whole("exponent", "1", Range::Positive)], vec![vec![0.7], vec![1.5], vec![2.5]]),
            Self::DirectionAsymmetry => {
                (vec![whole("backward_gain", "1", Range::Positive)], vec![vec![0.85], vec![1.15]])
            }
            Self::Saturation => (
                vec![below(s.input, s.units.input_name, s.units.input, Range::Positive)],
                [0.95, 0.8, 0.6, 0.4].iter().map(|share| vec![share * s.input]).collect(),
            ),
            Self::SlewLimit => (
                vec![below(f64::INFINITY, "rate_per_s", "1/s", Range::Positive)],
                [0.02, 0.1, 0.3, 1.0].iter().map(|time_s| vec![s.input / time_s]).collect(),
            ),
            Self::DriveLag | Self::SensorLag => (
                vec![sized("time_constant_s", "s", level(s.period_s))],
                vec![vec![2.0 * s.period_s], vec![0.03], vec![0.15]],
            ),
            Self::SupplySag => {
                (with_viscous(vec![sized("source_share", "1", level(0.05))]), from(vec![vec![0.1], vec![0.4]]))
            }
            Self::WindingHeating => (
                with_viscous(vec![
                    sized("rise_at_full", "1", level(0.05)),
                    shaped("time_constant_s", "s", Range::Between(0.02 * s.duration_s, 50.0 * s.duration_s)),
                ]),
                from(vec![vec![0.2, 0.3 * s.duration_s], vec![0.4, s.duration_s], vec![0.8, 3.0 * s.duration_s]]),
            ),
            Self::Coulomb => (
                vec![sized(s.units.force_name, force, level(0.2 * push))],
                [0.2, 1.0, 3.0].iter().map(|share| vec![share * push]).collect(),
            ),
            Self::Static => (
                vec![
                    sized(s.units.force_name, force, level(0.2 * push)),
                    shaped(s.units.stribeck_name, speed, Range::Positive),
                ],
                vec![vec![push, 0.02 * s.speed], vec![push, 0.1 * s.speed], vec![2.0 * push, 0.3 * s.speed]],
            ),
            Self::DirectionFriction => (
                vec![
                    sized(s.units.forward_name, force, level(0.2 * push)),
                    sized(s.units.backward_name, force, level(0.2 * push)),
                ],
                vec![vec![1.5 * push, 0.5 * push], vec![0.5 * push, 1.5 * push]],
            ),
            Self::DirectionViscous => {
                // Positive if the backward direction has more damping.
                let size = push / s.speed;
                (
                    vec![sized(s.units.viscous_name, s.units.viscous, Range::Any { scale: 0.3 * size })],
                    [-2.0, -0.3, 0.3, 2.0].iter().map(|share| vec![share * size]).collect(),
                )
            }
            Self::LoadFriction => {
                (with_viscous(vec![sized("share", "1", Range::Between(0.0, 0.95))]), from(vec![vec![0.1], vec![0.3]]))
            }
            Self::PositionFriction => (
                vec![
                    sized(s.units.force_name, force, level(0.2 * push)),
                    shaped("phase_rad", "rad", Range::Any { scale: 0.5 }),
                    shaped(s.units.periods_name, s.units.periods, s.waves()),
                ],
                s.periods.iter().flat_map(|&n| [0.0, 1.6, 3.1, 4.7].map(|phase| vec![push, phase, n])).collect(),
            ),
            Self::WarmUp => (
                vec![sized(s.units.force_name, force, level(0.2 * push)), shaped("warm_up_s", "s", Range::Positive)],
                vec![vec![push, 0.15 * s.duration_s], vec![push, 0.5 * s.duration_s], vec![push, 2.0 * s.duration_s]],
            ),
            Self::Drag => (
                vec![sized(s.units.drag_name, s.units.drag, level(push / s.speed.powi(2)))],
                vec![vec![0.3 * push / s.speed.powi(2)], vec![2.0 * push / s.speed.powi(2)]],
            ),
            Self::ConstantLoad => (
                vec![sized(s.units.force_name, force, Range::Any { scale: push })],
                vec![vec![0.3 * push], vec![-0.3 * push]],
            ),
            Self::Gravity => (
                vec![
                    sized(s.units.force_name, force, level(push)),
                    shaped("phase_rad", "rad", Range::Any { scale: 0.5 }),
                ],
                [0.0, 1.6, 3.1, 4.7].iter().map(|phase| vec![push, *phase]).collect(),
            ),
            Self::Cogging => (
                vec![
                    sized(s.units.force_name, force, level(push)),
                    shaped("phase_rad", "rad", Range::Any { scale: 0.5 }),
                    shaped(s.units.periods_name, s.units.periods, s.waves()),
                ],
                s.cogging.iter().flat_map(|&n| [0.0, 1.6, 3.1, 4.7].map(|phase| vec![push, phase, n])).collect(),
            ),
            // A gap changes the speed from one sample to the next, so the cost is not smooth in it.
            Self::Backlash if of_speed => (
                vec![sized(s.units.gap_name, distance, Range::Coarse { step: 0.06 })],
                [0.0003, 0.001, 0.003, 0.01, 0.03, 0.1].iter().map(|share| vec![share * s.distance]).collect(),
            ),
            Self::Backlash => (
                vec![sized(s.units.gap_name, distance, level(0.02 * s.distance))],
                // With 0.02 instead of the two in the middle, a backlash of 0.33 rad was missed if the recordings had
                // long holds (tuning board 60660042, noise of seed 660000).
                [0.003, 0.01, 0.03, 0.1].iter().map(|share| vec![share * s.distance]).collect(),
            ),
            Self::Compliance => (
                vec![
                    below(f64::INFINITY, "frequency_hz", "Hz", Range::Positive),
                    shaped("damping", "1", Range::Between(0.001, 3.0)),
                ],
                [1.5, 4.0, 10.0, 25.0].iter().map(|&hz| vec![hz, 0.1]).collect(),
            ),
            Self::Eccentricity => (
                vec![sized("amplitude_rad", "rad", level(0.01)), shaped("phase_rad", "rad", Range::Any { scale: 0.5 })],
                // With seven phases, none is more than 0.45 rad from the next start.
                [0.05, 0.15, 0.3, 0.5]
                    .iter()
                    .flat_map(|&amplitude_rad| {
                        (0..7u8).map(move |n| vec![amplitude_rad, f64::from(n) * std::f64::consts::TAU / 7.0])
                    })
                    .collect(),
            ),
            Self::EncoderScale => (vec![whole("scale", "1", Range::Positive)], vec![vec![1.03], vec![0.97]]),
            Self::EncoderOffset => (
                vec![sized(s.units.offset_name, distance, Range::Any { scale: 0.01 * s.distance })],
                vec![vec![0.02 * s.distance], vec![-0.02 * s.distance]],
            ),
        };
        Candidate {
            name: self.name(),
            depends_on: self.depends_on(),
            parameters,
            starts,
            experiment: self.experiment(),
            excludes: self.excludes(),
            led_by: (self == Self::InputHold).then_some(Self::InputDelay.name()),
        }
    }
}
