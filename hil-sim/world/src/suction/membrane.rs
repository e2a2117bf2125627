//! A membrane that inflates as a sphere of hyperelastic material.

use core::f64::consts::PI;

/// Stretch at the highest pressure of a neo-Hookean sphere, `7^(1/6)`: beyond this limit point a constant pressure
/// inflates without bound.
pub const LIMIT_STRETCH: f64 = 1.3830875542684884;

/// Geometry and material of a membrane.
///
/// Neo-Hookean with Gent's stiffening, incompressible, a full sphere from the start: the strip around it, its bending
/// and its clamping ring are not modelled.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Membrane {
    /// Radius at rest, m.
    pub radius_m: f64,
    /// Thickness at rest, m.
    pub thickness_m: f64,
    /// Shear modulus of the material, Pa.
    pub shear_pa: f64,
    /// Gent's limit of `I1 - 3`, at which the chains are straight.
    pub stiffening: f64,
    /// Viscous pressure per rate of stretch, Pa s.
    pub viscosity_pa_s: f64,
    /// Stretch at which the membrane bursts.
    pub burst_stretch: f64,
    /// Share of the pressure that is lost on reloading below the largest stretch so far (Ogden and Roxburgh 1999), 0 to
    /// 1: Mullins effect.
    pub softening: f64,
    /// Share of the pressure that relaxes, 0 to 1: creep of a standard linear solid.
    pub relaxing: f64,
    /// Time constant of the relaxation, s.
    pub relaxing_s: f64,
}

/// State of a membrane: stretch and the history that its softening and relaxation depend on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MembraneState {
    /// Ratio of the radius to that at rest.
    pub stretch: f64,
    /// True once it has burst.
    pub is_burst: bool,
    /// Largest `I1 - 3` so far.
    invariant_max: f64,
    /// Elastic pressure that the relaxing part has reached, Pa.
    relaxed_pa: f64,
}

impl Default for MembraneState {
    fn default() -> Self {
        Self { stretch: 1.0, is_burst: false, invariant_max: 0.0, relaxed_pa: 0.0 }
    }
}

/// Invariant `I1 - 3` of an equibiaxial stretch.
fn invariant(stretch: f64) -> f64 {
    let square = stretch * stretch;
    2.0 * square + 1.0 / (square * square) - 3.0
}

impl Membrane {
    /// Pressure difference that holds a virgin membrane at a stretch, Pa:
    /// `2 mu (t0/r0) (lam^-1 - lam^-7) Jm / (Jm - (I1 - 3))`. Müller and Strehlow, *Rubber and Rubber Balloons*,
    /// Springer 2004.
    #[must_use]
    pub fn pressure_pa(&self, stretch: f64) -> f64 {
        let inverse = 1.0 / stretch;
        let cube = inverse * inverse * inverse;
        let left = (self.stiffening - invariant(stretch)).max(1e-3 * self.stiffening);
        2.0 * self.shear_pa * self.thickness_m / self.radius_m * (inverse - cube * cube * inverse) * self.stiffening
            / left
    }

    /// Enclosed volume at a stretch, m³.
    #[must_use]
    pub fn volume_m3(&self, stretch: f64) -> f64 {
        let radius_m = self.radius_m * stretch;
        4.0 / 3.0 * PI * radius_m * radius_m * radius_m
    }

    /// Advances by `step_s` under the gauge pressure of the gas and the external pressure of the strip, Pa.
    pub(super) fn step(&self, state: &mut MembraneState, gas_pa: f64, strip_pa: f64, step_s: f64) {
        if state.is_burst {
            return;
        }
        let elastic_pa = self.pressure_pa(state.stretch);
        let now = invariant(state.stretch);
        state.invariant_max = state.invariant_max.max(now);
        // A quarter of I1 - 3 below the maximum, the softening is nearly complete: the magnitude seen in cycles of
        // silicones.
        let softened = 1.0 - self.softening * libm::erf((state.invariant_max - now) / 0.25);
        state.relaxed_pa += (elastic_pa - state.relaxed_pa) * (step_s / self.relaxing_s).min(1.0);
        let holds_pa = elastic_pa * softened - self.relaxing * state.relaxed_pa;
        state.stretch += (gas_pa - strip_pa - holds_pa) / self.viscosity_pa_s * step_s;
        // a slack membrane folds; a smaller sphere does not exist
        state.stretch = state.stretch.max(0.9);
        state.is_burst = state.stretch >= self.burst_stretch;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Membrane of Ecoflex 00-50 with 83 kPa at a stretch of 2: `mu = 83 / (2 - 1/4)` kPa.
    fn membrane(radius_m: f64) -> Membrane {
        Membrane {
            radius_m,
            thickness_m: 1e-3,
            shear_pa: 83e3 / 1.75,
            stiffening: 1e9,
            viscosity_pa_s: 1e3,
            burst_stretch: 4.0,
            softening: 0.0,
            relaxing: 0.0,
            relaxing_s: 1.0,
        }
    }

    #[test]
    fn pressure_is_highest_at_the_limit_point() {
        assert!((LIMIT_STRETCH - 7.0_f64.powf(1.0 / 6.0)).abs() < 1e-12);
        // 11.8 kPa at t/r = 1/5 and 6.5 kPa at 1/9, to their printed digits
        for (radius_m, expected_pa) in [(5e-3, 11.8e3), (9e-3, 6.5e3)] {
            let membrane = membrane(radius_m);
            let most_pa = membrane.pressure_pa(LIMIT_STRETCH);
            assert!((most_pa - expected_pa).abs() < 0.1e3, "{most_pa} Pa");
            assert!(membrane.pressure_pa(LIMIT_STRETCH - 0.01) < most_pa);
            assert!(membrane.pressure_pa(LIMIT_STRETCH + 0.01) < most_pa);
        }
    }

    /// The pressure is the derivative of the energy by the volume: `W = mu/2 (I1 - 3)` times the rubber's volume
    /// `4 pi r0² t0`.
    #[test]
    fn pressure_is_the_derivative_of_the_energy() {
        let membrane = membrane(6e-3);
        let energy_j = |stretch: f64| {
            0.5 * membrane.shear_pa * invariant(stretch) * 4.0 * PI * membrane.radius_m.powi(2) * membrane.thickness_m
        };
        for stretch in [1.05, 1.3, 1.8, 3.0] {
            let by = 1e-5;
            let work = (energy_j(stretch + by) - energy_j(stretch - by))
                / (membrane.volume_m3(stretch + by) - membrane.volume_m3(stretch - by));
            // central difference of 1e-5: its error is below 1e-9 of the value
            assert!((work / membrane.pressure_pa(stretch) - 1.0).abs() < 1e-6, "{stretch}: {work}");
        }
    }

    #[test]
    fn a_softened_membrane_holds_less_on_the_way_back_and_a_relaxing_one_in_time() {
        let held_pa = |membrane: Membrane, state: &mut MembraneState| {
            // gas pressure in equilibrium: bisection on the sign of the stretch's rate
            let (mut low, mut high) = (0.0, 2e4);
            for _ in 0..50 {
                let middle = f64::midpoint(low, high);
                let mut tried = *state;
                membrane.step(&mut tried, middle, 0.0, 1e-6);
                if tried.stretch > state.stretch { high = middle } else { low = middle }
            }
            low
        };
        let virgin = membrane(5e-3);
        let at = |stretch| MembraneState { stretch, ..Default::default() };
        let softening = Membrane { softening: 0.3, ..virgin };
        let mut state = MembraneState { invariant_max: invariant(1.6), ..at(1.2) };
        let share = held_pa(softening, &mut state) / virgin.pressure_pa(1.2);
        assert!((share - 0.7).abs() < 0.01, "{share}");
        let relaxing = Membrane { relaxing: 0.2, ..virgin };
        let mut state = MembraneState { relaxed_pa: virgin.pressure_pa(1.2), ..at(1.2) };
        let share = held_pa(relaxing, &mut state) / virgin.pressure_pa(1.2);
        assert!((share - 0.8).abs() < 0.01, "{share}");
    }
}
