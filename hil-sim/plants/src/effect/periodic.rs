//! Parameters common to effects that are periodic in position.

use crate::{
    kind::{PerKind, PlantKind},
    parameter::Parameter,
};

pub(crate) const PERIODS: Parameter =
    Parameter::new("periods_per_turn", "1/turn").linear("periods_per_m", "1/m").within(0.0, 1e4).typical(1.0);
pub(crate) const PHASE: Parameter =
    Parameter::new("phase_rad", "rad").within(-std::f64::consts::TAU, std::f64::consts::TAU);

/// Factor from position to angle within the period, rad per unit of position: periods are counted per turn, or per
/// metre.
pub(crate) fn angle_per_position(kind: PlantKind, periods: f64) -> f64 {
    periods * PerKind { rotary: 1.0, linear: std::f64::consts::TAU }.of(kind)
}
