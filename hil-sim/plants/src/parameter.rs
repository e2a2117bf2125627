//! Named, bounded parameters with units, which an identifier can vary without knowing what they belong to.

use crate::{
    error::Problem,
    kind::{PerKind, PlantKind},
};

/// Name, unit and bounds of a parameter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parameter {
    names: PerKind<&'static str>,
    units: PerKind<&'static str>,
    /// Smallest value allowed, inclusive.
    pub lower: f64,
    /// Largest value allowed, inclusive.
    pub upper: f64,
    /// A plausible value to start a fit from, large enough that its effect shows.
    pub typical: f64,
}

impl Parameter {
    /// A parameter with the same name and unit on rotary and linear plants, without bounds.
    pub(crate) const fn new(name: &'static str, unit: &'static str) -> Self {
        Self {
            names: PerKind { rotary: name, linear: name },
            units: PerKind { rotary: unit, linear: unit },
            lower: f64::NEG_INFINITY,
            upper: f64::INFINITY,
            typical: 0.0,
        }
    }

    /// Sets name and unit on linear plants, where metres and newtons take the place of radians and newton metres.
    pub(crate) const fn linear(mut self, name: &'static str, unit: &'static str) -> Self {
        self.names.linear = name;
        self.units.linear = unit;
        self
    }

    pub(crate) const fn within(mut self, lower: f64, upper: f64) -> Self {
        self.lower = lower;
        self.upper = upper;
        self
    }

    pub(crate) const fn typical(mut self, value: f64) -> Self {
        self.typical = value;
        self
    }

    /// Name in files, ending in the unit unless it is a plain number: `torque_nm` on a rotary plant, `force_n` on a
    /// linear one.
    #[must_use]
    pub const fn name(&self, kind: PlantKind) -> &'static str {
        self.names.of(kind)
    }

    /// Unit as printed, `N m`; `1` for a plain number.
    #[must_use]
    pub const fn unit(&self, kind: PlantKind) -> &'static str {
        self.units.of(kind)
    }

    /// Checks that the value is within the bounds.
    ///
    /// # Errors
    /// [`Problem::OutOfRange`] outside `lower..=upper`, and for NaN.
    pub fn check(&self, kind: PlantKind, value: f64) -> Result<(), Problem> {
        if (self.lower..=self.upper).contains(&value) {
            return Ok(());
        }
        Err(Problem::OutOfRange { value, lower: self.lower, upper: self.upper, unit: self.unit(kind) })
    }
}

/// A base model or an effect, seen as a list of numbers.
pub trait Fitted {
    /// The parameters, in the order in which they are written to files.
    fn parameters(&self) -> &'static [Parameter];

    /// Value of the parameter at this index of [`Fitted::parameters`]; `None` past its end.
    fn value(&self, index: usize) -> Option<f64>;

    /// Mutable value of the parameter at this index; `None` past the end. Bounds are not checked here but where a
    /// [`crate::PlantSpec`] takes the value.
    fn value_mut(&mut self, index: usize) -> Option<&mut f64>;

    /// Value of the parameter of this name on a plant of this kind; `None` if there is none.
    fn get(&self, kind: PlantKind, name: &str) -> Option<f64> {
        self.value(index_of(self.parameters(), kind, name)?)
    }

    /// Sets the parameter of this name on a plant of this kind.
    ///
    /// # Errors
    /// [`Problem::Unknown`] lists the known names; [`Problem::OutOfRange`] as in [`Parameter::check`]. Nothing is
    /// changed then.
    fn set(&mut self, kind: PlantKind, name: &str, value: f64) -> Result<(), Problem> {
        let parameters = self.parameters();
        let unknown = || Problem::Unknown { known: parameters.iter().map(|parameter| parameter.name(kind)).collect() };
        let index = index_of(parameters, kind, name).ok_or_else(unknown)?;
        parameters[index].check(kind, value)?;
        *self.value_mut(index).ok_or_else(unknown)? = value;
        Ok(())
    }
}

fn index_of(parameters: &[Parameter], kind: PlantKind, name: &str) -> Option<usize> {
    parameters.iter().position(|parameter| parameter.name(kind) == name)
}

/// Defines a struct of `f64` fields, or of none, each with its [`Parameter`]: the struct, its `PARAMETERS` table,
/// `TYPICAL`, and [`Fitted`].
macro_rules! fitted {
    ($(#[$meta:meta])* pub struct $name:ident {
        $($(#[$field_meta:meta])* pub $field:ident: $parameter:expr;)*
    }) => {
        $(#[$meta])*
        #[derive(Clone, Copy, Debug, PartialEq)]
        pub struct $name {
            $($(#[$field_meta])* pub $field: f64,)*
        }

        impl $name {
            /// Names, units and bounds, in the order in which they are written to files.
            pub const PARAMETERS: &'static [$crate::parameter::Parameter] = &[$($parameter),*];

            /// Every parameter at its typical value.
            pub const TYPICAL: Self = Self { $($field: $parameter.typical),* };
        }

        impl $crate::parameter::Fitted for $name {
            fn parameters(&self) -> &'static [$crate::parameter::Parameter] {
                Self::PARAMETERS
            }

            fn value(&self, index: usize) -> Option<f64> {
                [$(self.$field),*].get(index).copied()
            }

            fn value_mut(&mut self, index: usize) -> Option<&mut f64> {
                [$(&mut self.$field),*].into_iter().nth(index)
            }
        }
    };
}
pub(crate) use fitted;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effect::friction::CoulombFriction;

    #[test]
    fn a_parameter_is_known_by_the_unit_of_its_plant() {
        let mut friction = CoulombFriction { level: 0.3 };
        assert_eq!(friction.get(PlantKind::Rotary, "torque_nm"), Some(0.3));
        assert_eq!(friction.get(PlantKind::Linear, "torque_nm"), None);
        friction.set(PlantKind::Linear, "force_n", 40.0).unwrap();
        assert_eq!(friction.level, 40.0);
    }

    #[test]
    fn a_bad_value_changes_nothing() {
        let mut friction = CoulombFriction { level: 0.3 };
        for bad in [-0.1, f64::NAN, f64::INFINITY] {
            let problem = friction.set(PlantKind::Rotary, "torque_nm", bad).unwrap_err();
            assert!(matches!(problem, Problem::OutOfRange { lower: 0.0, .. }), "{problem}");
        }
        let problem = friction.set(PlantKind::Rotary, "torque", 1.0).unwrap_err();
        assert_eq!(problem, Problem::Unknown { known: vec!["torque_nm"] });
        assert_eq!(friction.level, 0.3);
    }
}
