//! Effects on the voltage of the supply, and on the resistance of the winding.

use crate::parameter::{Parameter, fitted};

fitted! {
    /// The supply voltage falls with the current drawn from it, `V = E - R i`, and rises when the motor feeds back.
    ///
    /// `i` is the share of the motor current that passes through the supply, `duty · motor current`, so the resistance
    /// acts on the motor as `duty² R` in its winding. Current returned by the diodes while coasting does not raise the
    /// voltage.
    pub struct SupplySag {
        /// Resistance of battery, fuse and leads, Ω.
        pub source_ohm: Parameter::new("source_ohm", "ohm").within(0.0, 100.0).typical(0.05);
    }
}

impl SupplySag {
    /// Supply voltage, V, at an electromotive force of `emf_v` while `current_a` is drawn.
    #[must_use]
    pub fn apply(&self, emf_v: f64, current_a: f64) -> f64 {
        emf_v - self.source_ohm * current_a
    }
}

fitted! {
    /// The winding's resistance rises with the heat in it, `R (1 + rise)`: `tau d(rise)/dt = coefficient · i² R(1 + rise) - rise`.
    ///
    /// One thermal mass, cold at the start. Copper gains 0.39 % per kelvin, so 0.01 per watt is a winding of 2.5 K/W.
    pub struct WindingHeating {
        /// Settled relative rise of the resistance per watt of heat.
        pub rise_per_w: Parameter::new("rise_per_w", "1/W").within(0.0, 10.0).typical(0.01);
        /// Time constant of the warming, s.
        pub time_constant_s: Parameter::new("time_constant_s", "s").within(1e-3, 1e5).typical(10.0);
    }
}

/// State of a winding: its relative rise of resistance.
#[derive(Clone, Debug)]
pub(crate) struct Heat {
    effect: WindingHeating,
    rise: f64,
}

impl Heat {
    pub(crate) fn new(effect: &WindingHeating) -> Self {
        Self { effect: *effect, rise: 0.0 }
    }

    /// Relative rise of the resistance above that of the cold winding.
    pub(crate) fn rise(&self) -> f64 {
        self.rise
    }

    /// Advances by a step with `power_w` in the winding.
    pub(crate) fn warm(&mut self, power_w: f64, step_s: f64) {
        let settled = self.effect.rise_per_w * power_w;
        self.rise -= (settled - self.rise) * libm::expm1(-step_s / self.effect.time_constant_s);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_winding_warms_by_its_time_constant_whatever_the_steps() {
        for steps in [1, 8, 100] {
            let mut heat = Heat::new(&WindingHeating { rise_per_w: 0.02, time_constant_s: 4.0 });
            (0..steps).for_each(|_| heat.warm(25.0, 4.0 / f64::from(steps)));
            assert!((heat.rise() - 0.5 * (1.0 - (-1.0f64).exp())).abs() < 1e-14, "{steps}"); // 100 roundings
        }
    }

    #[test]
    fn sag_is_ohms_law() {
        let sag = SupplySag { source_ohm: 0.25 };
        assert_eq!([sag.apply(24.0, 8.0), sag.apply(24.0, -8.0)], [22.0, 26.0]);
    }
}
