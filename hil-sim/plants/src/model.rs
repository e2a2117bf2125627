//! Base models: a plant without any effect.

use crate::{
    kind::PlantKind,
    parameter::{Fitted, Parameter, fitted},
};

fitted! {
    /// Brushed, permanent-magnet motor behind a gear.
    ///
    /// ```text
    /// L di/dt = u − R i − N K ω        N: gear ratio, K: torque constant = back-EMF constant (both SI)
    /// J dω/dt = N K i − B ω − T        T: friction and load
    /// ```
    ///
    /// # Source
    /// Franklin, Powell, Emami-Naeini, *Feedback Control of Dynamic Systems*, 7th edition, Pearson 2015, 2.3.
    pub struct DcGearMotor {
        /// Resistance of winding and brushes, cold, Ω.
        pub resistance_ohm: Parameter::new("resistance_ohm", "ohm").within(1e-4, 1e4).typical(1.0);
        /// Inductance of the winding, H. With `L/R` below 1 µs the current is taken as settled.
        pub inductance_h: Parameter::new("inductance_h", "H").within(0.0, 10.0).typical(1e-3);
        /// Torque per ampere at the motor shaft, N m/A; equal to the back-EMF constant in V s/rad.
        pub torque_constant_nm_per_a: Parameter::new("torque_constant_nm_per_a", "N m/A").within(1e-6, 1e3).typical(0.05);
        /// Motor turns per output turn.
        pub gear_ratio: Parameter::new("gear_ratio", "1").within(1e-3, 1e5).typical(25.0);
        /// Inertia at the output shaft, kg m², including the rotor's times the square of the gear ratio.
        pub inertia_kg_m2: Parameter::new("inertia_kg_m2", "kg m^2").within(1e-9, 1e6).typical(0.02);
        /// Viscous friction at the output shaft, N m s/rad.
        pub viscous_nm_s_per_rad: Parameter::new("viscous_nm_s_per_rad", "N m s/rad").within(0.0, 1e6).typical(0.01);
    }
}

fitted! {
    /// Brushed, permanent-magnet motor turning a lead screw that moves a rod between two end stops.
    ///
    /// The equations of [`DcGearMotor`] with `N = 2π / lead` in rad/m and the mass of the rod plus the rotor's
    /// `inertia · N²`. The share of the force that the screw loses acts as dry friction proportional to the force it
    /// transmits, so a rod pushed from outside has to overcome it too. The end stops at `0` and `stroke_m` take all
    /// speed.
    ///
    /// # Source
    /// The model as [`DcGearMotor`]; the screw: Budynas, Nisbett, *Shigley's Mechanical Engineering Design*,
    /// 10th edition, McGraw-Hill 2015, 8-2.
    pub struct LinearActuator {
        /// Resistance of winding and brushes, cold, Ω.
        pub resistance_ohm: Parameter::new("resistance_ohm", "ohm").within(1e-4, 1e4).typical(2.0);
        /// Inductance of the winding, H. With `L/R` below 1 µs the current is taken as settled.
        pub inductance_h: Parameter::new("inductance_h", "H").within(0.0, 10.0).typical(1e-3);
        /// Torque per ampere at the motor shaft, N m/A; equal to the back-EMF constant in V s/rad.
        pub torque_constant_nm_per_a: Parameter::new("torque_constant_nm_per_a", "N m/A").within(1e-6, 1e3).typical(0.02);
        /// Travel of the rod per turn of the motor, m, including a gear before the screw.
        pub lead_m_per_rev: Parameter::new("lead_m_per_rev", "m/rev").within(1e-6, 1.0).typical(0.002);
        /// Share of the motor's work that reaches the rod, 0.01 to 1.
        pub efficiency: Parameter::new("efficiency", "1").within(0.01, 1.0).typical(0.4);
        /// Rotor inertia at the motor shaft, kg m².
        pub rotor_inertia_kg_m2: Parameter::new("rotor_inertia_kg_m2", "kg m^2").within(0.0, 1e3).typical(1e-5);
        /// Mass of the rod and its load, kg.
        pub moving_mass_kg: Parameter::new("moving_mass_kg", "kg").within(1e-6, 1e6).typical(1.0);
        /// Viscous friction at the rod, N s/m.
        pub viscous_n_s_per_m: Parameter::new("viscous_n_s_per_m", "N s/m").within(0.0, 1e9).typical(100.0);
        /// Distance between the end stops, m.
        pub stroke_m: Parameter::new("stroke_m", "m").within(1e-6, 100.0).typical(0.1);
    }
}

/// The base model of a plant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Model {
    /// Brushed motor behind a gear, `dc-gear-motor` in files.
    DcGearMotor(DcGearMotor),
    /// Brushed motor with lead screw and rod, `linear-actuator` in files.
    LinearActuator(LinearActuator),
}

impl Model {
    /// One model of each variant, at typical values.
    pub const ALL: [Self; 2] = [Self::DcGearMotor(DcGearMotor::TYPICAL), Self::LinearActuator(LinearActuator::TYPICAL)];

    /// Name of the model in plant files.
    #[must_use]
    pub const fn name(&self) -> &'static str {
        match self {
            Self::DcGearMotor(_) => "dc-gear-motor",
            Self::LinearActuator(_) => "linear-actuator",
        }
    }

    /// Kind of motion of the output.
    #[must_use]
    pub const fn kind(&self) -> PlantKind {
        match self {
            Self::DcGearMotor(_) => PlantKind::Rotary,
            Self::LinearActuator(_) => PlantKind::Linear,
        }
    }

    fn fitted(&self) -> &dyn Fitted {
        match self {
            Self::DcGearMotor(motor) => motor,
            Self::LinearActuator(actuator) => actuator,
        }
    }
}

impl Fitted for Model {
    fn parameters(&self) -> &'static [Parameter] {
        self.fitted().parameters()
    }

    fn value(&self, index: usize) -> Option<f64> {
        self.fitted().value(index)
    }

    fn value_mut(&mut self, index: usize) -> Option<&mut f64> {
        match self {
            Self::DcGearMotor(motor) => motor.value_mut(index),
            Self::LinearActuator(actuator) => actuator.value_mut(index),
        }
    }
}
