//! Contact of a tyre with the ground: a brush of bristles that bend, roll out of the contact patch, and slide.
//!
//! The bristles bend by the slip velocity and roll out within the relaxation length, so a steady slip bends them in
//! proportion to it and a standing wheel is held by a spring:
//!
//! ```text
//! dz/dt = v_slip - |v_rim| z / L          z: deflection, L: relaxation length
//! f     = z / (c L)                       steady: f = v_slip / (c |v_rim|)
//! ```
//!
//! `f` is the force of bristles that all adhere. [`SlipLaw`] gives the share that remains while those at the rear of
//! the patch slide; the limit is friction times normal force. A deflection beyond that does not grow, so a sliding
//! wheel adheres at once when it stops sliding.
//!
//! # Source
//! Pacejka, *Tire and Vehicle Dynamics*, 3rd edition, Butterworth-Heinemann 2012: the brush model, 3.2; the relaxation length with a
//! standing wheel and its damping, 8.6.

/// Law by which the force follows slip up to the friction limit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SlipLaw {
    /// The brush with a parabolic distribution of pressure: `F = mu N (3 r - 3 r² + r³)` with `r = f / 3 mu N`.
    #[default]
    Brush,
    /// Proportional up to friction, as Gazebo's `wheel_slip` and ODE have it.
    Linear,
}

/// Parameters of a tyre on the ground.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tyre {
    /// Slip (slip velocity over rim speed) per force, along and across the wheel, 1/N: `c_long` and `c_lat` of a
    /// `wheel_slip` plugin.
    pub compliance_per_n: [f64; 2],
    /// Friction coefficient: largest force over normal force.
    pub friction: f64,
    /// Relaxation length, m: distance over which a force follows slip by 1 - 1/e.
    pub relaxation_m: f64,
    /// Law of partial sliding.
    pub law: SlipLaw,
}

/// Reasons why a tyre cannot be simulated.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TyreError {
    /// A compliance is not positive and finite.
    #[error("`compliance_per_n` must be positive: slip per newton, typically 0.0005 to 0.05")]
    Compliance,
    /// Friction is negative or not finite.
    #[error("`friction` must be 0 or more: rubber on a floor has 0.6 to 0.9")]
    Friction,
    /// The relaxation length is not positive and finite.
    #[error("`relaxation_m` must be positive: about the length of the contact patch, typically half a wheel radius")]
    Relaxation,
}

impl Tyre {
    /// A small robot's rubber wheel on a floor.
    ///
    /// # Source
    /// The longitudinal compliance is that of a Pioneer P3-AT in the simulation of Trimble and Fox, TAROS 2023. The others are
    /// assumed: four times as compliant across, rubber on a floor, half the radius of a 60 mm wheel.
    pub const TYPICAL: Self =
        Self { compliance_per_n: [0.005, 0.02], friction: 0.8, relaxation_m: 0.03, law: SlipLaw::Brush };

    /// Returns the tyre if its parameters are valid.
    ///
    /// # Errors
    /// [`TyreError`] names the first invalid field.
    pub fn checked(self) -> Result<Self, TyreError> {
        let positive = |value: f64| value > 0.0 && value.is_finite();
        if !self.compliance_per_n.into_iter().all(positive) {
            return Err(TyreError::Compliance);
        }
        if !(0.0..f64::INFINITY).contains(&self.friction) {
            return Err(TyreError::Friction);
        }
        if !positive(self.relaxation_m) {
            return Err(TyreError::Relaxation);
        }
        Ok(self)
    }
}

/// Constants of a tyre, precomputed for its contact.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Springs {
    /// Force of all bristles per deflection along and across the wheel, N/m.
    stiffness_n_m: [f64; 2],
    per_relaxation_m: f64,
    law: SlipLaw,
}

impl From<&Tyre> for Springs {
    fn from(tyre: &Tyre) -> Self {
        Self {
            stiffness_n_m: tyre.compliance_per_n.map(|compliance| 1.0 / (compliance * tyre.relaxation_m)),
            per_relaxation_m: 1.0 / tyre.relaxation_m,
            law: tyre.law,
        }
    }
}

/// Rim speed below which a standing wheel's bristles are damped, m/s: above it, rolling out gives more damping than
/// that.
const STANDING_M_S: f64 = 0.1;
/// Damping of the bristles, s: the time in which a slip velocity causes an equal deflection. A standing robot of 12 kg
/// on four wheels of 0.005 1/N and 0.05 m then oscillates after a push with a tenth of the amplitude after a period of
/// 0.17 s; with half the damping, with a third.
const DAMPING_S: f64 = 20e-3;

/// State of one contact.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Contact {
    /// Deflection of the bristles along and across the wheel, m.
    deflection_m: [f64; 2],
}

impl Contact {
    /// Force of the ground on the wheel, along and across it, N, over a step of `step_s`.
    ///
    /// `springs` are those of its tyre; `slip_m_s` is the velocity of the rim's contact point over the ground, along
    /// and across; `rim_m_s` is the rolling speed of the rim; `normal_n` is the normal force; `friction` is the
    /// coefficient of the tyre, or of the ground if it has its own.
    pub fn step(
        &mut self,
        springs: &Springs,
        friction: f64,
        slip_m_s: [f64; 2],
        rim_m_s: f64,
        normal_n: f64,
        step_s: f64,
    ) -> [f64; 2] {
        let most_n = friction * normal_n.max(0.0);
        if most_n <= 0.0 {
            *self = Self::default();
            return [0.0; 2];
        }
        // backward Euler: stable for any distance rolled in a step, and exact in the steady state
        let kept = 1.0 / (1.0 + rim_m_s.abs() * step_s * springs.per_relaxation_m);
        // deflection force at which all bristles slide
        let slides_n = if springs.law == SlipLaw::Brush { 3.0 * most_n } else { most_n };
        let [long_n_m, lat_n_m] = springs.stiffness_n_m;
        let [mut long_m, mut lat_m] = self.deflection_m;
        long_m = kept * (long_m + slip_m_s[0] * step_s);
        lat_m = kept * (lat_m + slip_m_s[1] * step_s);
        let bent_squared = squared([long_n_m * long_m, lat_n_m * lat_m]);
        if bent_squared > slides_n * slides_n {
            let left = slides_n / bent_squared.sqrt();
            (long_m, lat_m) = (long_m * left, lat_m * left);
        }
        self.deflection_m = [long_m, lat_m];
        let damped_s = (1.0 - rim_m_s.abs() * (1.0 / STANDING_M_S)).max(0.0) * DAMPING_S;
        let adhering_n = [-long_n_m * (long_m + damped_s * slip_m_s[0]), -lat_n_m * (lat_m + damped_s * slip_m_s[1])];
        let size_n = squared(adhering_n).sqrt();
        // share of that force that remains while the rear of the patch slides
        let left = match springs.law {
            SlipLaw::Linear if size_n <= most_n => 1.0,
            SlipLaw::Brush if size_n < slides_n => {
                let share = size_n / slides_n;
                1.0 + share * (share * (1.0 / 3.0) - 1.0)
            }
            _ => most_n / size_n,
        };
        [adhering_n[0] * left, adhering_n[1] * left]
    }
}

fn squared([along, across]: [f64; 2]) -> f64 {
    along * along + across * across
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const STEP_S: f64 = crate::MAX_STEP_S;

    fn tyre(law: SlipLaw) -> Tyre {
        Tyre { compliance_per_n: [0.005, 0.02], friction: 0.8, relaxation_m: 0.05, law }
    }

    /// Force after settling at a constant slip.
    fn settled(tyre: &Tyre, slip_m_s: [f64; 2], rim_m_s: f64, normal_n: f64) -> [f64; 2] {
        let mut contact = Contact::default();
        let steps = (20.0 * tyre.relaxation_m / rim_m_s / STEP_S) as usize;
        (0..steps)
            .map(|_| contact.step(&Springs::from(tyre), tyre.friction, slip_m_s, rim_m_s, normal_n, STEP_S))
            .last()
            .unwrap()
    }

    proptest! {
        /// Force `F = v_slip / (c v_rim)` for small slip, for any normal force: exact for the linear law, and for the
        /// brush up to the share that slides, its first neglected term.
        #[test]
        fn little_slip_makes_a_force_in_proportion(
            slip in -1e-3..1e-3f64, across in -1e-3..1e-3f64, rim_m_s in 0.2..3.0f64, normal_n in 20.0..200.0f64,
        ) {
            for law in [SlipLaw::Linear, SlipLaw::Brush] {
                let tyre = tyre(law);
                let force = settled(&tyre, [slip * rim_m_s, across * rim_m_s], rim_m_s, normal_n);
                let expected = [-slip / tyre.compliance_per_n[0], -across / tyre.compliance_per_n[1]];
                let size = expected[0].hypot(expected[1]);
                let sliding = if law == SlipLaw::Brush { size / (3.0 * tyre.friction * normal_n) } else { 0.0 };
                for (got, expected) in force.into_iter().zip(expected) {
                    // exp(-20) of it has not settled
                    prop_assert!((got - expected).abs() <= (sliding + 1e-8) * size, "{got} {expected}");
                }
            }
        }

        #[test]
        fn no_force_is_beyond_friction_and_none_pushes_on(
            slip in prop::array::uniform2(-5.0..5.0f64), rim_m_s in 0.0..5.0f64, normal_n in -10.0..200.0f64, steps in 1..2000usize,
        ) {
            for law in [SlipLaw::Linear, SlipLaw::Brush] {
                let mut contact = Contact::default();
                for _ in 0..steps {
                    let [along, across] = contact.step(&Springs::from(&tyre(law)), 0.8, slip, rim_m_s, normal_n, STEP_S);
                    prop_assert!(along.hypot(across) <= 0.8 * normal_n.max(0.0) * (1.0 + 1e-12));
                    prop_assert!(along * slip[0] <= 0.0 && across * slip[1] <= 0.0);
                }
            }
        }
    }

    /// All bristles slide, in the direction of the slip if both stiffnesses are equal.
    #[test]
    fn a_locked_wheel_brakes_with_friction() {
        let tyre = Tyre { compliance_per_n: [0.005; 2], ..tyre(SlipLaw::Brush) };
        let mut contact = Contact::default();
        let force =
            (0..4000).map(|_| contact.step(&Springs::from(&tyre), 0.8, [3.0, 4.0], 0.0, 100.0, STEP_S)).last().unwrap();
        assert!((force[0] + 48.0).abs() < 1e-9 && (force[1] + 64.0).abs() < 1e-9, "{force:?}");
        // back by half of the deflection at sliding, 3 mu N c L = 60 mm, at 1 m/s: the rest adheres
        let back = (0..120)
            .map(|_| contact.step(&Springs::from(&tyre), 0.8, [-0.6, -0.8], 0.0, 100.0, STEP_S))
            .last()
            .unwrap();
        let share = (0.030 - DAMPING_S) / 0.060;
        let left = 80.0 * (1.0 - (1.0_f64 - share).powi(3));
        assert!((back[0] + 0.6 * left).abs() < 1e-6 && (back[1] + 0.8 * left).abs() < 1e-6, "{back:?}, {left}");
    }

    /// Two thirds of the slip at full sliding leave `1 - (1 - 2/3)³` of friction.
    #[test]
    fn a_brush_slides_from_the_rear() {
        let tyre = tyre(SlipLaw::Brush);
        let slip = 2.0 * 0.8 * 100.0 * 0.005;
        let [along, _] = settled(&tyre, [slip, 0.0], 1.0, 100.0);
        assert!((along + 80.0 * (1.0 - 1.0 / 27.0)).abs() < 1e-5, "{along}");
    }

    #[test]
    fn what_cannot_be_computed_is_named() {
        let good = tyre(SlipLaw::Brush);
        assert_eq!(good.checked(), Ok(good));
        for (bad, error) in [
            (Tyre { compliance_per_n: [0.0, 0.1], ..good }, TyreError::Compliance),
            (Tyre { compliance_per_n: [0.1, f64::NAN], ..good }, TyreError::Compliance),
            (Tyre { friction: -0.1, ..good }, TyreError::Friction),
            (Tyre { relaxation_m: f64::INFINITY, ..good }, TyreError::Relaxation),
        ] {
            assert_eq!(bad.checked(), Err(error));
        }
    }
}
