//! Effects of the catalogue, sampled at sizes that matter on a plant of a given scale.

use r4_plants::{
    Effect,
    effect::{
        backlash::Backlash,
        compliance::Compliance,
        delay::InputDelay,
        friction::{
            CoulombFriction, DirectionFriction, DirectionViscous, FrictionWarmUp, LoadFriction, PositionFriction,
            QuadraticDrag, StaticFriction,
        },
        input::{DeadZone, DirectionAsymmetry, DriveLag, GainCurve, InputHold, Saturation},
        load::{Cogging, ConstantLoad, GravityLoad},
        sensor::{Eccentricity, SensorHold, SensorLag},
        slew::SlewLimit,
        supply::{SupplySag, WindingHeating},
    },
};

use crate::dice::{Dice, Draw};

/// One effect that can be hidden.
pub(crate) struct Candidate {
    pub(crate) name: &'static str,
    pub(crate) draw: Draw,
    /// Other effects that no recording of input and output can distinguish from it.
    pub(crate) rivals: &'static [&'static str],
}

/// Samples a number of periods per unit of position, for a plant that travels `way` in a second: `least` to `most` of
/// them on it.
fn often(dice: &mut Dice, way: f64, least: f64, most: f64) -> f64 {
    // Periods are counted per turn on a rotary plant, whose `way` is one turn, and per metre on a linear one.
    let whole = libm::round(dice.between(least, most));
    if way == std::f64::consts::TAU { whole } else { whole / way }
}

macro_rules! candidates {
    ($($name:literal, [$($rival:literal),*], $draw:expr;)+) => {
        &[$(Candidate { name: $name, rivals: &[$($rival),*], draw: $draw }),+]
    };
}

/// All effects of the catalogue that can be hidden.
pub(crate) const CANDIDATES: &[Candidate] = candidates! {
    "dead-zone", [], |dice, _| Effect::DeadZone(DeadZone { duty: dice.between(0.06, 0.22) });
    "gain-curve", [], |dice, _| Effect::GainCurve(GainCurve {
        exponent: if dice.share() < 0.6 { dice.between(1.4, 2.6) } else { dice.between(0.4, 0.7) },
    });
    "saturation", [], |dice, scale| {
        let headroom = 0.9 - scale.threshold;
        Effect::Saturation(Saturation { duty: scale.threshold + headroom * dice.between(0.35, 0.65) })
    };
    "direction-asymmetry", [], |dice, _| {
        let weaker = dice.between(0.7, 0.92);
        let [forward_gain, backward_gain] = if dice.share() < 0.5 { [1.0, weaker] } else { [weaker, 1.0] };
        Effect::DirectionAsymmetry(DirectionAsymmetry { forward_gain, backward_gain })
    };
    "input-delay", [], |dice, _| Effect::InputDelay(InputDelay { delay_s: dice.ratio_between(0.02, 0.12) });
    "slew-limit", [], |dice, _| Effect::SlewLimit(SlewLimit { rate_per_s: dice.ratio_between(0.8, 5.0) });
    "drive-lag", ["sensor-lag"], |dice, _| Effect::DriveLag(DriveLag { time_constant_s: dice.ratio_between(0.03, 0.2) });
    "input-hold", [], |dice, _| Effect::InputHold(InputHold { period_s: dice.ratio_between(0.05, 0.25) });
    "supply-sag", [], |dice, scale| {
        Effect::SupplySag(SupplySag { source_ohm: (scale.resistance_ohm * dice.between(0.3, 1.5)).min(100.0) })
    };
    "winding-heating", [], |dice, scale| Effect::WindingHeating(WindingHeating {
        rise_per_w: (dice.between(0.5, 2.0) / scale.power_w.max(1e-3)).min(10.0),
        time_constant_s: dice.ratio_between(2.0, 10.0),
    });
    "coulomb-friction", [], |dice, scale| {
        Effect::CoulombFriction(CoulombFriction { level: scale.force * dice.between(0.05, 0.25) })
    };
    "static-friction", [], |dice, scale| Effect::StaticFriction(StaticFriction {
        level: scale.force * dice.between(0.12, 0.35),
        stribeck: scale.speed * dice.ratio_between(0.05, 0.25),
    });
    "direction-friction", [], |dice, scale| {
        let more = scale.force * dice.between(0.12, 0.3);
        let less = more * dice.between(0.1, 0.55);
        let [forward, backward] = if dice.share() < 0.5 { [more, less] } else { [less, more] };
        Effect::DirectionFriction(DirectionFriction { forward, backward })
    };
    "direction-viscous", [], |dice, scale| {
        let more = scale.force / scale.speed * dice.between(0.4, 1.2);
        let [forward, backward] = if dice.share() < 0.5 { [more, 0.0] } else { [0.0, more] };
        Effect::DirectionViscous(DirectionViscous { forward, backward })
    };
    "position-friction", [], |dice, scale| Effect::PositionFriction(PositionFriction {
        level: scale.force * dice.between(0.15, 0.4),
        periods: often(dice, scale.way, 1.0, 3.0),
        phase_rad: dice.angle(),
    });
    "load-friction", [], |dice, _| Effect::LoadFriction(LoadFriction { share: dice.between(0.2, 0.6) });
    "friction-warm-up", [], |dice, scale| Effect::FrictionWarmUp(FrictionWarmUp {
        level: scale.force * dice.between(0.12, 0.35),
        warm_up_s: dice.ratio_between(1.5, 6.0),
    });
    "quadratic-drag", [], |dice, scale| Effect::QuadraticDrag(QuadraticDrag {
        drag: (scale.force * dice.between(0.3, 2.0) / (scale.speed * scale.speed)).min(1e6),
    });
    "constant-load", [], |dice, scale| {
        Effect::ConstantLoad(ConstantLoad { force: dice.sign() * scale.force * dice.between(0.05, 0.2) })
    };
    "gravity-load", ["cogging"], |dice, scale| Effect::GravityLoad(GravityLoad {
        torque_nm: scale.force * dice.between(0.1, 0.3),
        phase_rad: dice.angle(),
    });
    "cogging", [], |dice, scale| Effect::Cogging(Cogging {
        amplitude: scale.force * dice.between(0.08, 0.3),
        periods: often(dice, scale.way, 2.0, 7.0),
        phase_rad: dice.angle(),
    });
    "backlash", [], |dice, scale| Effect::Backlash(Backlash { gap: (scale.way * dice.ratio_between(0.03, 0.2)).min(10.0) });
    "compliance", [], |dice, _| Effect::Compliance(Compliance {
        frequency_hz: dice.ratio_between(0.8, 4.0),
        damping: dice.ratio_between(0.03, 0.3),
    });
    "eccentricity", [], |dice, _| Effect::Eccentricity(Eccentricity {
        amplitude_rad: dice.ratio_between(0.08, 0.6),
        phase_rad: dice.angle(),
    });
    "sensor-lag", ["drive-lag"], |dice, _| Effect::SensorLag(SensorLag { time_constant_s: dice.ratio_between(0.03, 0.2) });
    "sensor-hold", [], |dice, _| Effect::SensorHold(SensorHold { period_s: dice.ratio_between(0.05, 0.25) });
};
