//! Effects: mechanisms of a real plant that its base model lacks.
//!
//! Each effect is one type with public parameters, a `PARAMETERS` table and, where it has no memory, the formula itself
//! as a method. An effect with memory (delay, lag, noise …) keeps it in a private stage that a [`crate::Plant`] builds.
//! A [`table`] is an effect without a name, described by its curve; an [`unlisted`] one is code that no file can hold.

use crate::{
    error::{InvalidField, Problem},
    kind::PlantKind,
    parameter::{Fitted, Parameter},
};

pub mod backlash;
pub mod compliance;
pub mod delay;
mod dependence;
pub(crate) mod direction;
pub mod friction;
pub mod input;
pub mod load;
pub(crate) mod noise;
pub(crate) mod periodic;
pub mod sensor;
pub mod slew;
pub mod supply;
pub mod table;
pub(crate) mod transmission;
pub mod unlisted;

use backlash::Backlash;
use compliance::Compliance;
use delay::InputDelay;
pub use dependence::Dependence;
use friction::{
    CoulombFriction, DirectionFriction, DirectionViscous, FrictionWarmUp, LoadFriction, PositionFriction,
    QuadraticDrag, StaticFriction,
};
use input::{DeadZone, DirectionAsymmetry, DriveLag, GainCurve, InputHold, InputSign, Saturation};
use load::{Cogging, ConstantLoad, GravityLoad, RandomLoad};
use sensor::{
    Eccentricity, EncoderOffset, EncoderScale, EncoderSign, MissedEdges, PotentiometerDeadSpot, SensorHold, SensorLag,
    SensorNoise,
};
use slew::SlewLimit;
use supply::{SupplySag, WindingHeating};

/// Point in the plant at which an effect acts. Several at one point act in the order of the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum InsertionPoint {
    /// On the duty, before it becomes a voltage.
    Input,
    /// On the voltage of the supply.
    Supply,
    /// On the motor's winding.
    Winding,
    /// A force against motion, on the motor side of the backlash. Friction levels add up.
    Friction,
    /// A force whatever the motion, on the motor side of the backlash. Loads add up.
    Load,
    /// Between the motor side and the output.
    Transmission,
    /// Between the position of the output and the reading of its sensor.
    Sensor,
}

/// Catalogue entry of an effect, independent of its values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EffectInfo {
    /// Name in files and reports.
    pub name: &'static str,
    /// Summary of the mechanism, in one sentence.
    pub summary: &'static str,
    /// Point at which it acts.
    pub insertion: InsertionPoint,
    /// Quantities that its contribution is a function of.
    pub depends_on: &'static [Dependence],
    /// Kinds of plants that can have the effect.
    pub kinds: &'static [PlantKind],
    /// Names, units and bounds of its parameters.
    pub parameters: &'static [Parameter],
    /// The effect with every parameter at its typical value.
    pub typical: Effect,
}

const ANY: &[PlantKind] = &[PlantKind::Rotary, PlantKind::Linear];
const ROTARY: &[PlantKind] = &[PlantKind::Rotary];

/// Defines the enum and the catalogue from one table, so that neither can lack an entry of the other.
macro_rules! effects {
    ($($variant:ident, $name:literal, $insertion:ident, $kinds:ident, [$($dependence:ident),+], $summary:literal;)+) => {
        /// An effect of the catalogue with its parameters.
        #[derive(Clone, Copy, Debug, PartialEq)]
        pub enum Effect {
            $(#[doc = concat!("`", $name, "`: ", $summary)] $variant($variant),)+
        }

        $(impl $variant {
            /// Entry of the effect in the catalogue.
            pub const INFO: EffectInfo = EffectInfo {
                name: $name,
                summary: $summary,
                insertion: InsertionPoint::$insertion,
                depends_on: &[$(Dependence::$dependence),+],
                kinds: $kinds,
                parameters: Self::PARAMETERS,
                typical: Effect::$variant(Self::TYPICAL),
            };
        })+

        static CATALOGUE: &[EffectInfo] = &[$($variant::INFO),+];

        impl Effect {
            /// Entry of the effect in the catalogue.
            #[must_use]
            pub const fn info(&self) -> &'static EffectInfo {
                match self { $(Self::$variant(_) => &$variant::INFO,)+ }
            }

            fn fitted(&self) -> &dyn Fitted {
                match self { $(Self::$variant(effect) => effect,)+ }
            }
        }

        impl Fitted for Effect {
            fn parameters(&self) -> &'static [Parameter] {
                self.fitted().parameters()
            }

            fn value(&self, index: usize) -> Option<f64> {
                self.fitted().value(index)
            }

            fn value_mut(&mut self, index: usize) -> Option<&mut f64> {
                match self { $(Self::$variant(effect) => effect.value_mut(index),)+ }
            }
        }
    };
}

effects! {
    DeadZone, "dead-zone", Input, ANY, [Input],
        "A duty below a threshold does nothing; above, the output continues from zero.";
    GainCurve, "gain-curve", Input, ANY, [Input],
        "The duty acts by a power of itself; full duty stays full.";
    Saturation, "saturation", Input, ANY, [Input],
        "The duty is clipped.";
    DirectionAsymmetry, "direction-asymmetry", Input, ANY, [Input, Direction],
        "The duty acts by another factor forwards than backwards.";
    InputDelay, "input-delay", Input, ANY, [Input, History],
        "The drive acts a fixed time after it was commanded.";
    SlewLimit, "slew-limit", Input, ANY, [Input, History],
        "The duty changes at no more than a given rate.";
    DriveLag, "drive-lag", Input, ANY, [Input, History],
        "The duty acts through a first-order low-pass.";
    InputHold, "input-hold", Input, ANY, [Input, History],
        "The drive is looked at from time to time only, and held in between.";
    InputSign, "input-sign", Input, ANY, [Input],
        "The duty acts the other way round.";
    SupplySag, "supply-sag", Supply, ANY, [Supply, Input, Speed],
        "The supply voltage falls with the current drawn from it.";
    WindingHeating, "winding-heating", Winding, ANY, [Time, Input, History],
        "The winding's resistance rises with the power lost in it.";
    CoulombFriction, "coulomb-friction", Friction, ANY, [Direction],
        "A constant force against motion, which also holds at rest.";
    StaticFriction, "static-friction", Friction, ANY, [Speed, Direction],
        "Friction on top of Coulomb's at rest, falling off with speed (Stribeck).";
    DirectionFriction, "direction-friction", Friction, ANY, [Direction],
        "A constant force against motion, different forwards and backwards.";
    DirectionViscous, "direction-viscous", Friction, ANY, [Speed, Direction],
        "A force against motion by speed, different forwards and backwards.";
    PositionFriction, "position-friction", Friction, ANY, [Position, Direction],
        "A force against motion that varies periodically with position.";
    LoadFriction, "load-friction", Friction, ANY, [Input, Direction],
        "A force against motion that grows with the force the gear transmits.";
    FrictionWarmUp, "friction-warm-up", Friction, ANY, [Time, Direction],
        "Friction on top of the warm plant's, falling off with time from the start.";
    QuadraticDrag, "quadratic-drag", Friction, ANY, [Speed],
        "A force against motion by the square of speed.";
    ConstantLoad, "constant-load", Load, ANY, [Time],
        "A constant force towards negative positions, such as a weight.";
    GravityLoad, "gravity-load", Load, ROTARY, [Position],
        "A weight off the axis: a torque by the sine of position.";
    Cogging, "cogging", Load, ANY, [Position],
        "A force by the sine of a multiple of position, whatever the motion.";
    RandomLoad, "random-load", Load, ANY, [Time],
        "A random force of given deviation and correlation time.";
    Backlash, "backlash", Transmission, ANY, [History, Direction],
        "The output trails the motor side by half a gap in either direction.";
    Compliance, "compliance", Transmission, ANY, [Acceleration, History],
        "The output hangs on the motor side by a spring with a damper.";
    EncoderScale, "encoder-scale", Sensor, ANY, [Position],
        "The sensor measures a multiple of the position.";
    EncoderOffset, "encoder-offset", Sensor, ANY, [Position],
        "The sensor's zero is elsewhere.";
    Eccentricity, "eccentricity", Sensor, ROTARY, [Position],
        "The sensor's disc sits off the axis: an error once per turn.";
    MissedEdges, "missed-edges", Sensor, ANY, [Speed, History],
        "Above a speed a share of the sensor's edges is lost for good.";
    PotentiometerDeadSpot, "potentiometer-dead-spot", Sensor, ANY, [Position, History],
        "Within a band of positions the wiper has no contact and the last reading stays.";
    SensorLag, "sensor-lag", Sensor, ANY, [Speed, History],
        "The sensor follows the position as a first-order low-pass.";
    EncoderSign, "encoder-sign", Sensor, ANY, [Position],
        "The sensor counts the other way round.";
    SensorHold, "sensor-hold", Sensor, ANY, [Speed, History],
        "The position is sampled periodically and held in between.";
    SensorNoise, "sensor-noise", Sensor, ANY, [Time],
        "A random error of given deviation and correlation time.";
}

/// All effects with their parameters, units, bounds and dependences.
#[must_use]
pub fn catalogue() -> &'static [EffectInfo] {
    CATALOGUE
}

impl EffectInfo {
    /// The effect with this name; `None` if the catalogue has none.
    #[must_use]
    pub fn named(name: &str) -> Option<&'static Self> {
        CATALOGUE.iter().find(|info| info.name == name)
    }
}

impl Effect {
    /// Name in files and reports.
    #[must_use]
    pub const fn name(&self) -> &'static str {
        self.info().name
    }

    /// Duty behind a static effect of the bridge, which depends on the duty only and has no memory (dead zone, gain
    /// curve, saturation); `None` for all others.
    #[must_use]
    pub fn at_once(&self, duty: f64) -> Option<f64> {
        match self {
            Self::DeadZone(zone) => Some(zone.apply(duty)),
            Self::GainCurve(curve) => Some(curve.apply(duty)),
            Self::Saturation(saturation) => Some(saturation.apply(duty)),
            _ => None,
        }
    }

    /// Checks that a plant of this kind can have the effect with these values.
    ///
    /// # Errors
    /// [`InvalidField`] with `field` `effect` ([`Problem::WrongKind`]) or the name of the first parameter out of range.
    pub fn check(&self, kind: PlantKind) -> Result<(), InvalidField> {
        if !self.info().kinds.contains(&kind) {
            return Err(InvalidField { field: "effect".into(), problem: Problem::WrongKind { kind } });
        }
        check_values(self, kind)
    }
}

/// Checks that every parameter is in range; the error's `field` is the parameter's name.
pub(crate) fn check_values(fitted: &dyn Fitted, kind: PlantKind) -> Result<(), InvalidField> {
    for (index, parameter) in fitted.parameters().iter().enumerate() {
        let value = fitted.value(index).unwrap_or(f64::NAN);
        parameter.check(kind, value).map_err(|problem| InvalidField { field: parameter.name(kind).into(), problem })?;
    }
    Ok(())
}
