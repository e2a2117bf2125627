//! Effects on the voltage of the supply.

use crate::parameter::{Parameter, fitted};

fitted! {
    /// The supply voltage falls with the current drawn from it, `V = E - R i`, and rises when the motor feeds back.
    ///
    /// `i` is the share of the motor current that passes the supply, `duty · motor current`, so the resistance acts on
    /// the motor as `duty² R` in its winding. What diodes return while coasting does not raise the voltage.
    pub struct SupplySag {
        /// Battery, fuse and leads.
        pub source_ohm: Parameter::new("source_ohm", "ohm").within(0.0, 100.0).typical(0.05);
    }
}

impl SupplySag {
    /// Voltage left of `emf_v` while `current_a` is drawn.
    #[must_use]
    pub fn apply(&self, emf_v: f64, current_a: f64) -> f64 {
        emf_v - self.source_ohm * current_a
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sag_is_ohms_law() {
        let sag = SupplySag { source_ohm: 0.25 };
        assert_eq!([sag.apply(24.0, 8.0), sag.apply(24.0, -8.0)], [22.0, 26.0]);
    }
}
