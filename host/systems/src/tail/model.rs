//! The controller's model of a person with a two-link tail: rigid cables without losses.
//!
//! Lagrange's equations in absolute angles `p = [trunk, trunk + joint 1, trunk + joint 2 + joint 1]`, from z to x;
//! links at 0 hang:
//!
//! ```text
//! M01 = -S1 (b cos(p1 - p0) + a sin(p1 - p0))    S1 = m1 c1 + m2 l1    tail at a forwards, b up
//! M02 = -S2 (b cos(p2 - p0) + a sin(p2 - p0))    S2 = m2 c2
//! M12 = S2 l1 cos(p2 - p1)
//! ```
//!
//! The motors' inertia counts as `N² J` of their joints.

use nalgebra::{Matrix3, SMatrix, Vector3};

const GRAVITY_M_S2: f64 = 9.806_65;
/// Step of an angle or rate for a central difference, rad or rad/s: about the cube root of the rounding unit, which
/// keeps both errors below 1e-9.
const DIFFERENCE: f64 = 1e-5;

/// Trunk with everything fixed to it, about the ankle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trunk {
    /// Moment of inertia about the ankle, kg m².
    pub inertia_kg_m2: f64,
    /// Mass times position of the centre of mass, `[forwards, up]`, kg m.
    pub moment_kg_m: [f64; 2],
    /// Position of the tail's joint, `[forwards, up]`, m.
    pub tail_m: [f64; 2],
    /// Stiffness of the person's own balance at the ankle, N m/rad.
    pub ankle_nm_per_rad: f64,
    /// Damping of the person's own balance at the ankle, N m s/rad.
    pub ankle_nm_s_per_rad: f64,
}

/// A link of the tail and its motor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Link {
    /// Mass of the link, kg.
    pub mass_kg: f64,
    /// Length of the link, m.
    pub length_m: f64,
    /// Distance of the centre of mass from the joint, m.
    pub centre_m: f64,
    /// Moment of inertia about the centre of mass, kg m².
    pub inertia_kg_m2: f64,
    /// Inertia of the motor, kg m².
    pub rotor_kg_m2: f64,
    /// Gear ratio: turns of the motor for one of the joint.
    pub ratio: f64,
}

/// Equations of motion of a person with a tail.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Model {
    /// The person, as a rigid trunk on the ankle.
    pub trunk: Trunk,
    /// Links from the back outwards.
    pub links: [Link; 2],
}

impl Model {
    fn absolute(joints: Vector3<f64>) -> Vector3<f64> {
        Vector3::new(joints[0], joints[0] + joints[1], joints[0] + joints[1] + joints[2])
    }

    /// Torques at trunk and joints that hold everything at rest without the ankle's balance, N m.
    #[must_use]
    pub fn gravity_nm(&self, angle_rad: Vector3<f64>) -> Vector3<f64> {
        let [first, second] = &self.links;
        let p = Self::absolute(angle_rad);
        let [forward, up] = self.trunk.moment_kg_m;
        let hung_kg = first.mass_kg + second.mass_kg;
        let [a, b] = self.trunk.tail_m;
        let about = [
            -(up + hung_kg * b) * p[0].sin() - (forward + hung_kg * a) * p[0].cos(),
            (first.mass_kg * first.centre_m + second.mass_kg * first.length_m) * p[1].sin(),
            second.mass_kg * second.centre_m * p[2].sin(),
        ]
        .map(|moment| moment * GRAVITY_M_S2);
        Vector3::new(about[0] + about[1] + about[2], about[1] + about[2], about[2])
    }

    /// Derivative of [`Model::gravity_nm`] by one of the angles, N m/rad.
    #[must_use]
    pub fn gravity_change(&self, angle_rad: Vector3<f64>, with: usize) -> Vector3<f64> {
        let step = Vector3::from_fn(|row, _| if row == with { DIFFERENCE } else { 0.0 });
        (self.gravity_nm(angle_rad + step) - self.gravity_nm(angle_rad - step)) / (2.0 * DIFFERENCE)
    }

    /// Accelerations of trunk and joints, rad/s², under torques at the ankle (in addition to the person's own) and at
    /// the joints.
    ///
    /// `None` when the mass matrix has no inverse.
    #[must_use]
    pub fn acceleration(
        &self,
        angle_rad: Vector3<f64>,
        rate_rad_s: Vector3<f64>,
        torque_nm: Vector3<f64>,
    ) -> Option<Vector3<f64>> {
        let Self { trunk, links: [first, second] } = self;
        let (p, w) = (Self::absolute(angle_rad), Self::absolute(rate_rad_s));
        let [a, b] = trunk.tail_m;
        let s1 = first.mass_kg * first.centre_m + second.mass_kg * first.length_m;
        let s2 = second.mass_kg * second.centre_m;
        let inner = |s: f64, between: f64| {
            let (sin, cos) = between.sin_cos();
            // The coefficient and its derivative by the second angle.
            [-s * (b * cos + a * sin), -s * (a * cos - b * sin)]
        };
        let ([m01, d01], [m02, d02]) = (inner(s1, p[1] - p[0]), inner(s2, p[2] - p[0]));
        let (m12, d12) = (s2 * first.length_m * (p[2] - p[1]).cos(), -s2 * first.length_m * (p[2] - p[1]).sin());
        let own = |link: &Link| link.inertia_kg_m2 + link.mass_kg * link.centre_m * link.centre_m;
        let m00 = trunk.inertia_kg_m2 + (first.mass_kg + second.mass_kg) * (a * a + b * b);
        let m11 = own(first) + second.mass_kg * first.length_m * first.length_m;
        let mass = Matrix3::new(m00, m01, m02, m01, m11, m12, m02, m12, own(second));
        let centrifugal = Vector3::new(
            d01 * w[1] * w[1] + d02 * w[2] * w[2],
            -d01 * w[0] * w[0] + d12 * w[2] * w[2],
            -d02 * w[0] * w[0] - d12 * w[1] * w[1],
        );
        let to_absolute = Matrix3::new(1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 1.0, 1.0, 1.0);
        let rotor = |link: &Link| link.ratio * link.ratio * link.rotor_kg_m2;
        let rotors = Matrix3::from_diagonal(&Vector3::new(0.0, rotor(first), rotor(second)));
        let ankle_nm = -trunk.ankle_nm_per_rad * angle_rad[0] - trunk.ankle_nm_s_per_rad * rate_rad_s[0];
        let force = torque_nm + Vector3::new(ankle_nm, 0.0, 0.0)
            - to_absolute.transpose() * centrifugal
            - self.gravity_nm(angle_rad);
        (to_absolute.transpose() * mass * to_absolute + rotors).try_inverse().map(|inverse| inverse * force)
    }

    /// Linear model about rest at `angle_rad`: the state has angles and rates of trunk and joints, the input the
    /// joints' torques.
    #[must_use]
    pub fn linear(&self, angle_rad: Vector3<f64>) -> Option<(SMatrix<f64, 6, 6>, SMatrix<f64, 6, 2>)> {
        let hold_nm = self.gravity_nm(angle_rad);
        let around = |angle: Vector3<f64>, rate: Vector3<f64>, torque: Vector3<f64>| {
            let at = |sign: f64| {
                let step = sign * DIFFERENCE;
                self.acceleration(angle_rad + angle * step, rate * step, hold_nm + torque * step)
            };
            Some((at(1.0)? - at(-1.0)?) / (2.0 * DIFFERENCE))
        };
        let (mut a, mut b) = (SMatrix::<f64, 6, 6>::zeros(), SMatrix::<f64, 6, 2>::zeros());
        let zero = Vector3::zeros();
        for k in 0..3 {
            let axis = Vector3::from_fn(|row, _| if row == k { 1.0 } else { 0.0 });
            a[(k, k + 3)] = 1.0;
            a.fixed_view_mut::<3, 1>(3, k).copy_from(&around(axis, zero, zero)?);
            a.fixed_view_mut::<3, 1>(3, k + 3).copy_from(&around(zero, axis, zero)?);
            if k > 0 {
                b.fixed_view_mut::<3, 1>(3, k - 1).copy_from(&around(zero, zero, axis)?);
            }
        }
        Some((a, b))
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;
    use serde::Deserialize;

    use super::*;

    #[derive(Deserialize)]
    struct Oracle {
        rows: Vec<Row>,
    }

    #[derive(Deserialize)]
    struct Row {
        load_kg: f64,
        q: [f64; 3],
        v: [f64; 3],
        tau: [f64; 3],
        pinocchio: [f64; 3],
    }

    /// Model with the parameters of `hil-sim/world/tests/oracle/tail.py`.
    fn oracle_model(load_kg: f64) -> Model {
        let link = |mass_kg, length_m, centre_m, inertia_kg_m2| Link {
            mass_kg,
            length_m,
            centre_m,
            inertia_kg_m2,
            rotor_kg_m2: 0.0,
            ratio: 25.0,
        };
        let trunk = Trunk {
            inertia_kg_m2: 80.0 + load_kg * (0.35 * 0.35 + 1.05 * 1.05),
            moment_kg_m: [load_kg * 0.35, 72.0 * 0.97 + load_kg * 1.05],
            tail_m: [-0.12, 1.15],
            ankle_nm_per_rad: 0.0,
            ankle_nm_s_per_rad: 0.0,
        };
        Model { trunk, links: [link(3.4, 0.70, 0.45, 0.15), link(3.1, 0.40, 0.31, 0.05)] }
    }

    #[test]
    fn accelerations_are_pinocchios() {
        let oracle: Oracle =
            serde_json::from_str(include_str!("../../../../hil-sim/world/tests/oracle/tail.json")).unwrap();
        assert_eq!(oracle.rows.len(), 40);
        for Row { load_kg, q, v, tau, pinocchio } in oracle.rows {
            let got =
                oracle_model(load_kg).acceleration(Vector3::from(q), Vector3::from(v), Vector3::from(tau)).unwrap();
            let expected = Vector3::from(pinocchio);
            // Rounding of an inverse with a condition number of 2000.
            assert!((got - expected).norm() < 1e-11 * expected.norm(), "{got}, {expected}");
        }
    }

    #[test]
    fn a_linear_model_predicts_small_motions() {
        let model = oracle_model(0.0);
        let at = Vector3::new(0.0, 0.6, 0.3);
        let (a, b) = model.linear(at).unwrap();
        let small = [1e-4, -2e-4, 1.5e-4, 1e-4, 3e-4, -2e-4];
        let state = nalgebra::SVector::<f64, 6>::from(small);
        let input = nalgebra::Vector2::new(0.01, -0.02);
        let predicted = a * state + b * input;
        let torque = model.gravity_nm(at) + Vector3::new(0.0, input[0], input[1]);
        let angle = at + Vector3::new(small[0], small[1], small[2]);
        let exact = model.acceleration(angle, Vector3::new(small[3], small[4], small[5]), torque).unwrap();
        let got = predicted.fixed_rows::<3>(3).into_owned();
        // The linear model neglects squares of 3e-4 rad, 3e-4 of the linear terms.
        assert!((got - exact).norm() < 1e-3 * exact.norm(), "{got} {exact}");
    }
}
