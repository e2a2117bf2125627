//! Friction forces: at rest they hold up to their level, in motion they oppose it and never reverse it.

use super::{
    direction::Direction,
    periodic::{PERIODS, PHASE},
    table::SpeedForce,
};
use crate::parameter::{Parameter, fitted};

const LEVEL: Parameter = Parameter::new("torque_nm", "N m").linear("force_n", "N").within(0.0, 1e6).typical(0.3);

fitted! {
    /// A constant force against motion, which also holds at rest.
    ///
    /// # Source
    /// Armstrong-Hélouvry, Dupont, Canudas de Wit, *A survey of models, analysis tools and compensation methods for
    /// the control of machines with friction*, Automatica 30 (1994), 2.1.
    pub struct CoulombFriction {
        /// Magnitude of the force, N m or N.
        pub level: LEVEL;
    }
}

fitted! {
    /// Friction at rest in excess of Coulomb's, which falls with speed: `level · exp(-(speed / stribeck)²)`.
    ///
    /// # Source
    /// As [`CoulombFriction`], 2.1, the Stribeck curve in Gaussian form.
    pub struct StaticFriction {
        /// Excess of the break-away force over the Coulomb force.
        pub level: LEVEL;
        /// Speed at which 1/e of the excess remains.
        pub stribeck: Parameter::new("stribeck_rad_s", "rad/s").linear("stribeck_m_s", "m/s").within(1e-6, 1e3).typical(0.1);
    }
}

fitted! {
    /// A constant force against motion, different forwards and backwards.
    pub struct DirectionFriction {
        /// Force against positive speed, N m or N.
        pub forward: Parameter::new("forward_torque_nm", "N m").linear("forward_force_n", "N").within(0.0, 1e6).typical(0.4);
        /// Force against negative speed, N m or N.
        pub backward: Parameter::new("backward_torque_nm", "N m").linear("backward_force_n", "N").within(0.0, 1e6).typical(0.2);
    }
}

fitted! {
    /// A force against motion proportional to speed, in addition to the model's own, different forwards and backwards:
    /// the lips of a seal, the two flanks of a screw.
    pub struct DirectionViscous {
        /// Coefficient against positive speed, N m s/rad or N s/m.
        pub forward: Parameter::new("forward_nm_s_per_rad", "N m s/rad")
            .linear("forward_n_s_per_m", "N s/m").within(0.0, 1e6).typical(0.0);
        /// Coefficient against negative speed, N m s/rad or N s/m.
        pub backward: Parameter::new("backward_nm_s_per_rad", "N m s/rad")
            .linear("backward_n_s_per_m", "N s/m").within(0.0, 1e6).typical(0.1);
    }
}

fitted! {
    /// A force against motion that varies periodically with position, between 0 and `level`: a bent shaft, a seal, a
    /// worn stretch of screw.
    pub struct PositionFriction {
        /// Force at its highest, N m or N.
        pub level: LEVEL;
        /// Periods per turn or per metre.
        pub periods: PERIODS;
        /// Phase at position 0: 0 is half of `level` and rising, π/2 the highest.
        pub phase_rad: PHASE;
    }
}

fitted! {
    /// A force against motion proportional to the square of speed: air, a stirrer, a hydraulic damper.
    pub struct QuadraticDrag {
        /// Force over the square of speed.
        pub drag: Parameter::new("drag_nm_s2_per_rad2", "N m s^2/rad^2")
            .linear("drag_n_s2_per_m2", "N s^2/m^2").within(0.0, 1e6).typical(0.01);
    }
}

fitted! {
    /// A force against motion proportional to the force the gear transmits: `share · |motor force|` at the output, in
    /// addition to the loss of a [`crate::LinearActuator`] by its efficiency.
    ///
    /// # Source
    /// Pelchen, Schweiger, Otter, *Modeling and simulating the efficiency of gearboxes and of planetary gearboxes*,
    /// 2nd International Modelica Conference (2002): losses of a mesh in proportion to its load.
    pub struct LoadFriction {
        /// Share of the motor's force that is lost, 0 to 0.95.
        pub share: Parameter::new("share", "1").within(0.0, 0.95).typical(0.2);
    }
}

fitted! {
    /// Friction of a cold plant in addition to that of a warm one: `level · exp(-time / warm-up)`, time since the
    /// start.
    pub struct FrictionWarmUp {
        /// Additional force at the start, N m or N.
        pub level: LEVEL;
        /// Time constant of the decay, s.
        pub warm_up_s: Parameter::new("warm_up_s", "s").within(1e-3, 1e6).typical(10.0);
    }
}

/// A friction effect with its precomputed constants.
#[derive(Clone, Debug)]
pub(crate) enum FrictionStage {
    Coulomb(CoulombFriction),
    Static(StaticFriction),
    Direction(DirectionFriction),
    Viscous(DirectionViscous),
    /// Position friction with the factor from position to angle within the period.
    Position(PositionFriction, f64),
    Drag(QuadraticDrag),
    Load(LoadFriction),
    WarmUp(FrictionWarmUp),
    Table(SpeedForce),
}

/// Quantities besides the direction on which a friction may depend.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Contact {
    /// Magnitude of the speed; the sign is ignored.
    pub(crate) speed: f64,
    pub(crate) position: f64,
    /// Magnitude of the motor's force at the output.
    pub(crate) transmitted: f64,
    pub(crate) time_s: f64,
}

impl FrictionStage {
    /// True for damping as opposed to dry friction: a table of negative dry friction does not reduce it.
    fn grows_with_speed(&self) -> bool {
        matches!(self, Self::Viscous(_) | Self::Drag(_) | Self::Table(_))
    }

    /// Force against motion in `direction`, never negative; at speed 0, the largest force it holds against.
    #[inline]
    pub(crate) fn level(&self, direction: Direction, contact: &Contact) -> f64 {
        let Contact { speed, position, transmitted, time_s } = *contact;
        match self {
            Self::Coulomb(friction) => friction.level,
            Self::Static(friction) => {
                let ratio = speed / friction.stribeck;
                // exp(-40) of a force is below the rounding of the other forces
                if ratio * ratio > 40.0 { 0.0 } else { friction.level * libm::exp(-ratio * ratio) }
            }
            Self::Direction(friction) => match direction {
                Direction::Forward => friction.forward,
                Direction::Backward => friction.backward,
            },
            Self::Viscous(friction) => match direction {
                Direction::Forward => friction.forward * speed.abs(),
                Direction::Backward => friction.backward * speed.abs(),
            },
            Self::Position(friction, angle_per_position) => {
                0.5 * friction.level * (1.0 + libm::sin(angle_per_position * position + friction.phase_rad))
            }
            Self::Drag(drag) => drag.drag * speed * speed,
            Self::Load(friction) => friction.share * transmitted,
            Self::WarmUp(friction) => friction.level * libm::exp(-time_s / friction.warm_up_s),
            Self::Table(force) => force.against(direction, speed),
        }
    }
}

/// All frictions of a plant at one instant.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Frictions<'a> {
    pub(crate) stages: &'a [FrictionStage],
    /// Dry friction besides that of the stages, N m or N; a negative value reduces theirs.
    pub(crate) more: f64,
    /// Time since the start, s.
    pub(crate) time_s: f64,
}

impl Frictions<'_> {
    /// Force against motion in `direction`, N m or N: the sum of all dry friction, at least 0, plus the damping.
    #[inline]
    pub(crate) fn level(&self, direction: Direction, speed: f64, position: f64, transmitted: f64) -> f64 {
        let contact = Contact { speed, position, transmitted: transmitted.abs(), time_s: self.time_s };
        let (mut dry, mut by_speed) = (self.more, 0.0);
        for stage in self.stages {
            *if stage.grows_with_speed() { &mut by_speed } else { &mut dry } += stage.level(direction, &contact);
        }
        dry.max(0.0) + by_speed
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Effect, PlantKind};

    fn level(effect: Effect, direction: Direction, speed: f64, position: f64) -> f64 {
        let contact = Contact { speed, position, ..Contact::default() };
        FrictionStage::new(&effect, PlantKind::Rotary).unwrap().level(direction, &contact)
    }

    #[test]
    fn static_friction_falls_by_e_at_the_stribeck_speed() {
        let effect = Effect::StaticFriction(StaticFriction { level: 2.0, stribeck: 0.5 });
        assert_eq!(level(effect, Direction::Forward, 0.0, 0.0), 2.0);
        let left = level(effect, Direction::Forward, 0.5, 0.0);
        assert!((left - 2.0 / std::f64::consts::E).abs() < 1e-15); // one rounding of exp
        assert_eq!(level(effect, Direction::Backward, 50.0, 0.0), 0.0);
    }

    #[test]
    fn friction_by_load_and_warm_up_take_force_and_time() {
        let level = |effect: Effect, transmitted, time_s| {
            let contact = Contact { speed: 1.0, position: 1.0, transmitted, time_s };
            FrictionStage::new(&effect, PlantKind::Rotary).unwrap().level(Direction::Forward, &contact)
        };
        let load = Effect::LoadFriction(LoadFriction { share: 0.25 });
        assert_eq!([level(load, 0.0, 9.0), level(load, 6.0, 9.0)], [0.0, 1.5]);
        let cold = Effect::FrictionWarmUp(FrictionWarmUp { level: 2.0, warm_up_s: 5.0 });
        assert_eq!(level(cold, 9.0, 0.0), 2.0);
        assert!((level(cold, 9.0, 5.0) - 2.0 / std::f64::consts::E).abs() < 1e-15); // one rounding of exp
    }

    #[test]
    fn direction_position_and_drag_take_their_own_variable() {
        let direction = Effect::DirectionFriction(DirectionFriction { forward: 0.4, backward: 0.2 });
        assert_eq!(level(direction, Direction::Forward, 1.0, 1.0), 0.4);
        assert_eq!(level(direction, Direction::Backward, 1.0, 1.0), 0.2);
        let viscous = Effect::DirectionViscous(DirectionViscous { forward: 0.5, backward: 0.25 });
        assert_eq!(level(viscous, Direction::Forward, 2.0, 1.0), 1.0);
        assert_eq!(level(viscous, Direction::Backward, -2.0, 1.0), 0.5);
        let drag = Effect::QuadraticDrag(QuadraticDrag { drag: 0.5 });
        assert_eq!(level(drag, Direction::Forward, 3.0, 1.0), 4.5);
        // two periods per turn: highest at 1/8 turn, 0 at 3/8
        let position = Effect::PositionFriction(PositionFriction { level: 1.0, periods: 2.0, phase_rad: 0.0 });
        let eighth = std::f64::consts::FRAC_PI_4;
        assert!((level(position, Direction::Forward, 1.0, eighth) - 1.0).abs() < 1e-15);
        assert!(level(position, Direction::Forward, 1.0, 3.0 * eighth).abs() < 1e-15);
    }
}
