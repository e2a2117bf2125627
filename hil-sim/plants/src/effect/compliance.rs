//! An elastic part between the motor side and the output.

use crate::{
    discretisation::SecondOrder,
    parameter::{Parameter, fitted},
};

fitted! {
    /// The output hangs on the motor side by a spring with a damper: `y'' = w² (x - y) + 2 d w (x' - y')`, with
    /// `w = 2π f`, `x` the position of the motor side and `y` that of the output.
    ///
    /// The output is light compared with the motor side, which feels no reaction; the inertia of the plant is all at
    /// the motor side.
    ///
    /// # Source
    /// Den Hartog, *Mechanical Vibrations*, 4th edition, McGraw-Hill 1956, chapter 2: motion of the support.
    pub struct Compliance {
        /// Undamped natural frequency of the output, Hz.
        pub frequency_hz: Parameter::new("frequency_hz", "Hz").within(0.05, 500.0).typical(5.0);
        /// Damping ratio; 1 is critical.
        pub damping: Parameter::new("damping", "1").within(0.0, 2.0).typical(0.1);
    }
}

/// State of the spring between motor side and output.
#[derive(Clone, Debug)]
pub(crate) struct Spring {
    /// System matrix for the state `[y - x, y' - x']`.
    matrix: [[f64; 2]; 2],
    step_s: f64,
    step: SecondOrder,
    /// State `[y - x, y' - x']`: deflection and its rate.
    state: [f64; 2],
    /// Speed of the motor side after the last step.
    speed: f64,
}

impl Spring {
    pub(crate) fn new(compliance: &Compliance) -> Self {
        let rad_s = std::f64::consts::TAU * compliance.frequency_hz;
        let matrix = [[0.0, 1.0], [-rad_s * rad_s, -2.0 * compliance.damping * rad_s]];
        Self { matrix, step_s: 0.0, step: SecondOrder::default(), state: [0.0; 2], speed: 0.0 }
    }

    /// Moves the output to the motor side, both at rest.
    pub(crate) fn settle(&mut self) {
        self.state = [0.0; 2];
        self.speed = 0.0;
    }

    /// Position and speed of the output once the motor side is at `position` with `speed`, under constant acceleration
    /// over the step.
    pub(crate) fn apply(&mut self, position: f64, speed: f64, step_s: f64) -> (f64, f64) {
        if step_s != self.step_s {
            self.step_s = step_s;
            self.step = SecondOrder::new(self.matrix, step_s);
        }
        let against = -(speed - self.speed) / step_s;
        self.speed = speed;
        let SecondOrder { transition: e, integral: p, .. } = &self.step;
        let [late, late_speed] = self.state;
        self.state = [
            e[0][0] * late + e[0][1] * late_speed + p[0][1] * against,
            e[1][0] * late + e[1][1] * late_speed + p[1][1] * against,
        ];
        (position + self.state[0], speed + self.state[1])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn after_a_jump_of_speed_the_output_swings_as_the_closed_form_does() {
        // x = t from t = 0 on; y − x = −exp(−d w t) sin(wd t) / wd
        let (w, d) = (10.0, 0.25);
        let damped = w * (1.0f64 - d * d).sqrt();
        for steps in [1, 16, 256] {
            let mut spring = Spring::new(&Compliance { frequency_hz: w / std::f64::consts::TAU, damping: d });
            // the jump takes no time
            spring.apply(0.0, 1.0, 1e-12);
            let step_s = 0.4 / f64::from(steps);
            let mut output = 0.0;
            for step in 1..=steps {
                output = spring.apply(step_s * f64::from(step), 1.0, step_s).0;
            }
            let expected = 0.4 - (-d * w * 0.4f64).exp() * (damped * 0.4).sin() / damped;
            // the jump took 1e-12 s
            assert!((output - expected).abs() < 1e-11, "{steps}: {output} against {expected}");
        }
    }

    #[test]
    fn under_even_acceleration_the_output_trails_by_what_the_spring_gives() {
        let mut spring = Spring::new(&Compliance { frequency_hz: 2.0, damping: 1.0 });
        let late = (1..=40_000).fold(0.0, |_, step| spring.apply(0.0, 3.0 * 1e-3 * f64::from(step), 1e-3).0);
        // a / w²; 40 s are 500 time constants
        assert!((late + 3.0 / (4.0 * std::f64::consts::PI).powi(2)).abs() < 1e-12, "{late}");
    }
}
