//! Forces on the output that do not depend on the direction of motion.

use super::{
    noise::{CORRELATION, Noise},
    periodic::{PERIODS, PHASE},
};
use crate::parameter::{Parameter, fitted};

fitted! {
    /// A constant force towards negative positions, such as a weight; a negative value pushes towards positive
    /// positions.
    pub struct ConstantLoad {
        /// Force, N m or N; positive towards negative positions.
        pub force: Parameter::new("torque_nm", "N m").linear("force_n", "N").within(-1e6, 1e6).typical(0.5);
    }
}

fitted! {
    /// A weight off the axis: the torque `-torque · sin(position + phase)`, so that it hangs at `position = -phase`.
    pub struct GravityLoad {
        /// Weight times distance from the axis, N m.
        pub torque_nm: Parameter::new("torque_nm", "N m").within(0.0, 1e6).typical(0.5);
        /// Angle from the hanging position at position 0, rad.
        pub phase_rad: PHASE;
    }
}

fitted! {
    /// A force sinusoidal in position, whatever the motion: magnets against slots.
    pub struct Cogging {
        /// Amplitude of the force, N m or N.
        pub amplitude: Parameter::new("torque_nm", "N m").linear("force_n", "N").within(0.0, 1e6).typical(0.1);
        /// Periods per turn or per metre.
        pub periods: PERIODS;
        /// Phase at position 0, rad.
        pub phase_rad: PHASE;
    }
}

fitted! {
    /// A random force: Gaussian, with an autocorrelation that falls to 1/e in the correlation time. Other steps over
    /// the same time give another realisation of the same statistics.
    pub struct RandomLoad {
        /// Standard deviation of the force, N m or N.
        pub deviation: Parameter::new("deviation_nm", "N m").linear("deviation_n", "N").within(0.0, 1e6).typical(0.05);
        /// Correlation time of the force, s.
        pub correlation_s: CORRELATION;
    }
}

/// A load with its precomputed constants or its noise.
#[derive(Clone, Debug)]
pub(crate) enum LoadStage {
    Constant(ConstantLoad),
    Gravity(GravityLoad),
    /// Cogging with the factor from position to angle within the period.
    Cogging(Cogging, f64),
    Random(Noise),
}

impl LoadStage {
    /// Force towards positive positions, N m or N, over a step that is at `position` half-way.
    #[inline]
    pub(crate) fn force(&mut self, position: f64, step_s: f64) -> f64 {
        match self {
            Self::Constant(load) => -load.force,
            Self::Gravity(load) => -load.torque_nm * libm::sin(position + load.phase_rad),
            Self::Cogging(cogging, angle_per_position) => {
                cogging.amplitude * libm::sin(*angle_per_position * position + cogging.phase_rad)
            }
            Self::Random(noise) => noise.next(step_s),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Effect, PlantKind};

    #[test]
    fn gravity_pulls_back_and_cogging_repeats() {
        let mut gravity = LoadStage::new(
            &Effect::GravityLoad(GravityLoad { torque_nm: 2.0, phase_rad: 0.0 }),
            PlantKind::Rotary,
            0,
            0,
        )
        .unwrap();
        assert_eq!(gravity.force(std::f64::consts::FRAC_PI_2, 1e-3), -2.0);
        let cogging = Effect::Cogging(Cogging { amplitude: 1.0, periods: 500.0, phase_rad: 0.0 });
        let mut cogging = LoadStage::new(&cogging, PlantKind::Linear, 0, 0).unwrap();
        assert!((cogging.force(0.0005, 1e-3) - 1.0).abs() < 1e-15); // a quarter of 1/500 m
        assert!((cogging.force(0.0025, 1e-3) - 1.0).abs() < 1e-12); // and one period on; the angle rounds to 1e-15
    }
}
