//! Motors and actuators as a *base model* plus a list of *effects*.
//!
//! ```text
//!            input          supply  winding           friction, load             transmission       sensor
//!  Drive ──► dead zone … ─► sag ─► R, L, K ─► inertia ◄─ coulomb, cogging … ───► backlash … ┬──► scale, lag … ──►
//!            (duty, coast)         (current)  (speed, position of the motor side)           │      sensed_position
//!                                                                                           └──► position, speed
//! ```
//!
//! | module | subject |
//! | --- | --- |
//! | `text` | plant files: TOML to [`PlantSpec`] and back |
//! | [`plant`] | [`Plant`]: a plant with its state, stepped in time |
//! | `stages` | which stage of a plant steps an effect |
//! | [`spec`] | [`PlantSpec`]: the description of a plant |
//! | [`effect`] | every effect, and the [`catalogue()`] of them; a [`Table`] for an effect without a name |
//! | [`model`] | the base models and their parameters |
//! | [`drive`] | [`Drive`]: duty and coast share at the motor's terminals |
//! | [`parameter`] | named, bounded parameters with units, which an identifier can vary |
//! | [`error`] | errors in a plant's description |
//! | [`kind`] | [`PlantKind`]: rotary or linear output |
//!
//! A module uses those below it in this table, never one above; a test of `tests/xtask` reads the sources and holds
//! them to it.
//!
//! An effect is one small type that the simulator steps; the identifier uses its name in plant files, but has formulas
//! of its own. Effects act at seven *insertion points*, in the order of the picture; several at one point act in the
//! order of the file (which matters except for frictions and loads, which add up, and for a delay among the input
//! effects).
//!
//! Everything is SI, `f64`, and at the output shaft or rod. The same description, seed and sequence of
//! [`Plant::advance`] calls give the same bits on every machine.
//!
//! ```
//! use r4_plants::{Drive, Plant, PlantSpec};
//!
//! let spec = PlantSpec::from_toml("wheel.toml", r#"
//!     model = "dc-gear-motor"
//!     source = "an example, not a measured motor"
//!     [parameters]
//!     resistance_ohm = 0.8
//!     inductance_h = 1e-3
//!     torque_constant_nm_per_a = 0.05
//!     gear_ratio = 25.0
//!     inertia_kg_m2 = 0.02
//!     viscous_nm_s_per_rad = 0.01
//!     [[effects]]
//!     effect = "coulomb-friction"
//!     torque_nm = 0.3
//! "#)?;
//! let mut wheel = Plant::new(&spec, 1);
//! for _ in 0..500 {
//!     wheel.advance(Drive::with_brake(0.5), 24.0, 1e-3);
//! }
//! assert!(wheel.speed() > 9.0 && wheel.speed() < 9.6); // 0.5 · 24 V / (25 · 0.05 V s/rad), less friction
//! # Ok::<(), r4_plants::PlantError>(())
//! ```

mod discretisation;
pub mod drive;
mod drive_train;
pub mod effect;
pub mod error;
pub mod kind;
pub mod model;
pub mod parameter;
pub mod plant;
pub mod spec;
mod stages;
#[cfg(test)]
mod tests;
mod text;

pub use drive::Drive;
pub use effect::{Dependence, Effect, EffectInfo, InsertionPoint, catalogue, table::Table, unlisted::Unlisted};
pub use error::{InvalidField, PlantError, Problem};
pub use kind::PlantKind;
pub use model::{DcGearMotor, LinearActuator, Model};
pub use parameter::{Fitted, Parameter};
pub use plant::Plant;
pub use spec::PlantSpec;
