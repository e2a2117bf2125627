//! Mapping from each effect of a description to the stage that steps it.
//!
//! The stages are defined beside their effects and do not know the enum of all effects ([`Effect`]), which is composed
//! of them.

use crate::{
    drive::Drive,
    effect::{
        Effect,
        backlash::Play,
        compliance::Spring,
        delay::DelayLine,
        friction::FrictionStage,
        input::{InputSign, InputStage},
        load::LoadStage,
        noise::Noise,
        periodic::angle_per_position,
        sensor::{EncoderSign, SensorStage},
        slew::Slew,
        transmission::TransmissionStage,
    },
    kind::PlantKind,
};

impl DelayLine {
    /// All delays of a plant added up; `None` if it has none.
    pub(crate) fn of<'a>(effects: impl Iterator<Item = &'a Effect>) -> Option<Self> {
        let delays = effects
            .filter_map(|effect| if let Effect::InputDelay(delay) = effect { Some(delay.delay_s) } else { None });
        delays.reduce(|total_s, delay_s| total_s + delay_s).map(Self::new)
    }
}

impl InputStage {
    /// The stage of an input effect; `None` for a delay and for an effect that acts elsewhere.
    pub(crate) fn new(effect: &Effect) -> Option<Self> {
        Some(match effect {
            Effect::DeadZone(zone) => Self::DeadZone(*zone),
            Effect::GainCurve(curve) => Self::GainCurve(*curve),
            Effect::Saturation(saturation) => Self::Saturation(*saturation),
            Effect::DirectionAsymmetry(asymmetry) => Self::DirectionAsymmetry(*asymmetry),
            Effect::SlewLimit(limit) => Self::Slew(Slew::new(limit)),
            Effect::InputSign(InputSign {}) => Self::Sign,
            Effect::InputHold(hold) => Self::Hold { period_s: hold.period_s, left_s: 0.0, held: Drive::COAST },
            Effect::DriveLag(lag) => Self::Lag { time_constant_s: lag.time_constant_s, duty: 0.0 },
            _ => return None,
        })
    }
}

impl FrictionStage {
    /// The stage of a friction effect; `None` for an effect that acts elsewhere.
    pub(crate) fn new(effect: &Effect, kind: PlantKind) -> Option<Self> {
        Some(match effect {
            Effect::CoulombFriction(friction) => Self::Coulomb(*friction),
            Effect::StaticFriction(friction) => Self::Static(*friction),
            Effect::DirectionFriction(friction) => Self::Direction(*friction),
            Effect::DirectionViscous(friction) => Self::Viscous(*friction),
            Effect::PositionFriction(friction) => Self::Position(*friction, angle_per_position(kind, friction.periods)),
            Effect::QuadraticDrag(drag) => Self::Drag(*drag),
            Effect::LoadFriction(friction) => Self::Load(*friction),
            Effect::FrictionWarmUp(friction) => Self::WarmUp(*friction),
            _ => return None,
        })
    }
}

impl LoadStage {
    /// The stage of a load; `None` for an effect that acts elsewhere. `stream` separates the random numbers of two
    /// noises of one plant.
    pub(crate) fn new(effect: &Effect, kind: PlantKind, seed: u64, stream: usize) -> Option<Self> {
        Some(match effect {
            Effect::ConstantLoad(load) => Self::Constant(*load),
            Effect::GravityLoad(load) => Self::Gravity(*load),
            Effect::Cogging(cogging) => Self::Cogging(*cogging, angle_per_position(kind, cogging.periods)),
            Effect::RandomLoad(load) => Self::Random(Noise::new(load.deviation, load.correlation_s, seed, stream)),
            _ => return None,
        })
    }
}

impl SensorStage {
    /// The stage of a sensor effect; `None` for an effect that acts elsewhere. `stream` as in
    /// [`LoadStage::new`].
    pub(crate) fn new(effect: &Effect, seed: u64, stream: usize) -> Option<Self> {
        Some(match effect {
            Effect::EncoderScale(scale) => Self::Scale(*scale),
            Effect::EncoderOffset(offset) => Self::Offset(*offset),
            Effect::Eccentricity(eccentricity) => Self::Eccentricity(*eccentricity),
            Effect::MissedEdges(effect) => Self::MissedEdges { effect: *effect, before: 0.0, lost: 0.0 },
            Effect::PotentiometerDeadSpot(effect) => Self::DeadSpot { effect: *effect, held: 0.0 },
            Effect::SensorLag(effect) => Self::Lag { effect: *effect, before: 0.0, reading: 0.0 },
            Effect::EncoderSign(EncoderSign {}) => Self::Sign,
            Effect::SensorHold(hold) => {
                Self::Hold { period_s: hold.period_s, left_s: hold.period_s, before: 0.0, held: 0.0 }
            }
            Effect::SensorNoise(noise) => Self::Noise(Noise::new(noise.deviation, noise.correlation_s, seed, stream)),
            _ => return None,
        })
    }
}

impl TransmissionStage {
    /// The stage of an effect of the transmission; `None` for an effect that acts elsewhere.
    pub(crate) fn new(effect: &Effect) -> Option<Self> {
        match effect {
            Effect::Backlash(backlash) => Some(Self::Play(Play::new(backlash))),
            Effect::Compliance(compliance) => Some(Self::Spring(Box::new(Spring::new(compliance)))),
            _ => None,
        }
    }
}
