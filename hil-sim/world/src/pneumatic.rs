//! Compressed air: flow through valves and tubes, and pressure in chambers. Pressures are absolute.

/// Specific gas constant of dry air, J/(kg K).
const AIR_J_KG_K: f64 = 287.05;
/// Temperature of the reference air of ISO 6358-1, 3.3, K: 100 kPa, 20 °C, 65 % relative humidity.
const REFERENCE_K: f64 = 293.15;
/// Density of the reference air of ISO 6358-1, kg/m³.
pub(crate) const REFERENCE_KG_M3: f64 = 1.185;
/// Pressure of the standard atmosphere, Pa.
pub const ATMOSPHERE_PA: f64 = 101_325.0;

/// Flow restriction (valve, tube or leak) as defined by ISO 6358-1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Restriction {
    /// Sonic conductance, m³/(s Pa) of reference air: 1e-8 is 1 dm³/(s bar).
    pub conductance_m3_s_pa: f64,
    /// Critical ratio of downstream to upstream pressure, 0 to 1: below it the flow is choked and independent of the
    /// downstream pressure. 0.2 to 0.5 for valves.
    pub critical_ratio: f64,
}

impl Restriction {
    /// Pressure ratio above which the flow is taken as linear in the pressure difference (ISO 6358's law has an
    /// infinite slope at 1, which no fixed step integrates).
    const LAMINAR_RATIO: f64 = 0.999;

    /// Mass flow from `from_pa` to `to_pa` at 20 °C, kg/s; negative in the other direction. Pressures are absolute.
    #[must_use]
    pub fn flow_kg_s(&self, from_pa: f64, to_pa: f64) -> f64 {
        if to_pa > from_pa {
            return -self.flow_kg_s(to_pa, from_pa);
        }
        if from_pa <= 0.0 {
            return 0.0;
        }
        let choked_kg_s = self.conductance_m3_s_pa * REFERENCE_KG_M3 * from_pa;
        let ratio = to_pa / from_pa;
        let share = if ratio <= self.critical_ratio {
            1.0
        } else if ratio < Self::LAMINAR_RATIO {
            self.subsonic(ratio)
        } else {
            self.subsonic(Self::LAMINAR_RATIO) * (1.0 - ratio) / (1.0 - Self::LAMINAR_RATIO)
        };
        choked_kg_s * share
    }

    /// Ratio of the flow to the choked one, above the critical pressure ratio.
    fn subsonic(&self, ratio: f64) -> f64 {
        let over = (ratio - self.critical_ratio) / (1.0 - self.critical_ratio);
        (1.0 - over * over).max(0.0).sqrt()
    }

    /// Largest relaxation rate of the pressure in a chamber of `volume_m3` towards its environment, 1/s: that near
    /// equal pressures. Its product with the step must stay below 1, or the pressure of [`Chamber::step`] oscillates.
    #[must_use]
    pub fn relaxation_per_s(&self, volume_m3: f64, polytropic_exponent: f64) -> f64 {
        let steepest = self.subsonic(Self::LAMINAR_RATIO) / (1.0 - Self::LAMINAR_RATIO);
        let kg_s_pa = self.conductance_m3_s_pa * REFERENCE_KG_M3 * steepest;
        polytropic_exponent * AIR_J_KG_K * REFERENCE_K * kg_s_pa / volume_m3
    }
}

/// Air in a volume that may change.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Chamber {
    /// Absolute pressure inside, Pa.
    pub pressure_pa: f64,
    /// Volume of the chamber, m³.
    pub volume_m3: f64,
    /// Polytropic exponent: 1 for isothermal air, 1.4 for adiabatic.
    pub polytropic_exponent: f64,
}

impl Chamber {
    /// A chamber at atmospheric pressure.
    #[must_use]
    pub const fn at_rest(volume_m3: f64, polytropic_exponent: f64) -> Self {
        Self { pressure_pa: ATMOSPHERE_PA, volume_m3, polytropic_exponent }
    }

    /// Advances by one step, in which `inflow_kg_s` at 20 °C enters while the volume changes to `volume_m3`.
    ///
    /// Second order in the step: `dp/dt = n / V (R T ṁ - p dV/dt)` (energy balance of an ideal gas with a polytropic exponent).
    pub fn step(&mut self, inflow_kg_s: f64, volume_m3: f64, step_s: f64) {
        let exponent = self.polytropic_exponent;
        let middle_m3 = f64::midpoint(self.volume_m3, volume_m3);
        // the content expands as p V^n, the inflow adds to it
        let expanded_pa = self.pressure_pa * libm::pow(self.volume_m3 / volume_m3, exponent);
        let added_pa = exponent * AIR_J_KG_K * REFERENCE_K * inflow_kg_s * step_s / middle_m3;
        self.pressure_pa = (expanded_pa + added_pa).max(0.0);
        self.volume_m3 = volume_m3;
    }

    /// Pressure above atmosphere (gauge), Pa.
    #[must_use]
    pub fn gauge_pa(&self) -> f64 {
        self.pressure_pa - ATMOSPHERE_PA
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const VALVE: Restriction = Restriction { conductance_m3_s_pa: 1e-8, critical_ratio: 0.3 };

    /// Definition of sonic conductance: 1 dm³/(s bar) passes 6 dm³/s of reference air at 6 bar absolute into the
    /// atmosphere.
    #[test]
    fn a_choked_valve_passes_its_conductance() {
        let flow_kg_s = VALVE.flow_kg_s(6e5, 1e5);
        assert!((flow_kg_s / (6e-3 * 1.185) - 1.0).abs() < 1e-12, "{flow_kg_s}");
        // any downstream pressure below the critical ratio gives the same flow
        assert_eq!(VALVE.flow_kg_s(6e5, 0.0), flow_kg_s);
        // ISO 6358's example of the ellipse: half way between critical ratio and 1 it is sqrt(1 - 1/4)
        let half = VALVE.flow_kg_s(1e5, 0.65e5) / VALVE.flow_kg_s(1e5, 0.0);
        assert!((half - 0.75_f64.sqrt()).abs() < 1e-12, "{half}");
    }

    /// Time constant `t = V / (C rho0 R T0 n)` of a vessel with choked outflow: p' = -n R T C rho0 p / V.
    #[test]
    fn a_vessel_empties_with_its_time_constant() {
        let mut vessel = Chamber { pressure_pa: 20e5, volume_m3: 1e-3, polytropic_exponent: 1.0 };
        let time_constant_s = 1e-3 / (1e-8 * 1.185 * 287.05 * 293.15);
        for _ in 0..10_000 {
            let outflow_kg_s = VALVE.flow_kg_s(vessel.pressure_pa, 1e5);
            vessel.step(-outflow_kg_s, 1e-3, time_constant_s * 1e-4);
        }
        // an explicit step of T/10 000 is off by half of that
        let expected_pa = 20e5 / std::f64::consts::E;
        assert!((vessel.pressure_pa / expected_pa - 1.0).abs() < 1e-4, "{}", vessel.pressure_pa);
    }

    #[test]
    fn a_closed_chamber_follows_its_polytrope() {
        for exponent in [1.0, 1.2, 1.4] {
            let mut chamber = Chamber::at_rest(2e-6, exponent);
            for step in 1..=1000 {
                chamber.step(0.0, 2e-6 - 1e-9 * f64::from(step), 1e-4);
            }
            let expected_pa = ATMOSPHERE_PA * 2.0_f64.powf(exponent);
            assert!((chamber.pressure_pa / expected_pa - 1.0).abs() < 1e-9, "{exponent}: {}", chamber.pressure_pa);
        }
    }

    /// At nine tenths of the limit an explicit step approaches the outside pressure from one side; beyond twice the
    /// limit it diverges.
    #[test]
    fn a_step_is_stable_up_to_its_limit() {
        let volume_m3 = 1e-6;
        let limit_s = 1.0 / VALVE.relaxation_per_s(volume_m3, 1.4);
        let after = |step_s: f64| {
            let mut chamber = Chamber::at_rest(volume_m3, 1.4);
            chamber.pressure_pa += 10.0;
            for _ in 0..20 {
                let inflow_kg_s = VALVE.flow_kg_s(ATMOSPHERE_PA, chamber.pressure_pa);
                chamber.step(inflow_kg_s, volume_m3, step_s);
            }
            chamber.gauge_pa()
        };
        assert!((0.0..1e-9).contains(&after(0.9 * limit_s)), "{}", after(0.9 * limit_s));
        assert!(after(2.2 * limit_s).abs() > 10.0, "{}", after(2.2 * limit_s));
    }

    proptest! {
        #[test]
        fn flow_goes_downhill_and_is_continuous(from_pa in 0.0..1e6_f64, to_pa in 0.0..1e6_f64, ratio in 0.0..0.9_f64) {
            let valve = Restriction { critical_ratio: ratio, ..VALVE };
            let flow = valve.flow_kg_s(from_pa, to_pa);
            prop_assert_eq!(valve.flow_kg_s(to_pa, from_pa), -flow);
            prop_assert!(flow * (from_pa - to_pa) >= 0.0);
            // A thousandth of a pascal changes the flow by at most the steepest slope of the law, at the laminar limit:
            // sqrt(2 / 0.001 / (1 - b)) / p.
            let next = valve.flow_kg_s(from_pa, to_pa + 1e-3);
            let steepest = 1e-8 * 1.185 * (2.0 / 1e-3 / (1.0 - ratio)).sqrt() * 2.0;
            prop_assert!((next - flow).abs() <= steepest * 1e-3 + 1e-18, "{} {}", flow, next);
        }
    }
}
