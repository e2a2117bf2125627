//! The controller of the tail: a linear quadratic regulator on gravity compensation, inside what motors and joints can do.

use nalgebra::{SMatrix, SVector, Vector2, Vector3};

use super::{
    lqr::{self, LqrError},
    model::Model,
};

/// What a motor and its drive can do, at the motor's shaft.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motor {
    /// N m
    pub torque_max_nm: f64,
    /// W
    pub power_max_w: f64,
    /// At full share, rad/s.
    pub top_speed_rad_s: f64,
    /// Torque for each rad/s by which the motor lags behind its command, N m s/rad.
    pub speed_gain_nm_s: f64,
}

/// What the controller must keep to and what it weighs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Time from one command to the next, s.
    pub period_s: f64,
    /// Of trunk, joints, their rates, and the integral of the trunk's lean; squares of what counts as large.
    pub weight: [f64; 7],
    /// Of the joints' torques.
    pub torque_weight: [f64; 2],
    /// Lowest and highest angle of each joint, rad.
    pub range_rad: [[f64; 2]; 2],
    /// Share of torque and power that is asked for at most: the rest is for what is measured late.
    pub share: f64,
}

/// What is measured.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Measured {
    /// Trunk and joints, rad.
    pub angle_rad: [f64; 3],
    /// rad/s
    pub rate_rad_s: [f64; 3],
}

/// What goes to the drives.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Command {
    /// Share of full speed of each motor, -1 to 1.
    pub share: [f64; 2],
    /// Torque it is meant to give at each motor's shaft, N m.
    pub torque_nm: [f64; 2],
}

/// The regulator.
#[derive(Clone, Debug, PartialEq)]
pub struct Regulator {
    model: Model,
    motors: [Motor; 2],
    settings: Settings,
    gain: SMatrix<f64, 2, 7>,
}

impl Regulator {
    /// Designs the gain about the tail half raised, `about_rad`.
    ///
    /// # Errors
    /// [`LqrError`], for a model that no gain makes stable.
    pub fn new(model: Model, motors: [Motor; 2], settings: Settings, about_rad: [f64; 2]) -> Result<Self, LqrError> {
        let about = Vector3::new(0.0, about_rad[0], about_rad[1]);
        let (a, b) = model.linear(about).ok_or(LqrError::NotStabilisable)?;
        let mut with_integral = SMatrix::<f64, 7, 7>::zeros();
        with_integral.fixed_view_mut::<6, 6>(0, 0).copy_from(&a);
        with_integral[(6, 0)] = 1.0;
        // The law adds what gravity takes at the joints' own angles: the model of what is left has no such springs.
        let mut input = SMatrix::<f64, 7, 2>::zeros();
        input.fixed_view_mut::<6, 2>(0, 0).copy_from(&b);
        for joint in 0..2 {
            let by_angle = model.gravity_change(about, joint + 1);
            let held = b * Vector2::new(by_angle[1], by_angle[2]);
            for row in 0..6 {
                with_integral[(row, joint + 1)] += held[row];
            }
        }
        let (a, b) = lqr::sampled(&with_integral, &input, settings.period_s);
        let weight = SMatrix::<f64, 7, 7>::from_diagonal(&SVector::from(settings.weight));
        let torque_weight = SMatrix::<f64, 2, 2>::from_diagonal(&Vector2::from(settings.torque_weight));
        let gain = lqr::gain(&a, &b, &weight, &torque_weight)?;
        Ok(Self { model, motors, settings, gain })
    }

    /// The command for what is measured, and the integral of the lean, rad s, after it: a pure function of both.
    #[must_use]
    pub fn next(&self, measured: &Measured, rest_rad: [f64; 2], integral_rad_s: f64) -> (Command, f64) {
        let [trunk, first, second] = measured.angle_rad;
        let [trunk_rate, first_rate, second_rate] = measured.rate_rad_s;
        let state = SVector::<f64, 7>::from([
            trunk,
            first - rest_rad[0],
            second - rest_rad[1],
            trunk_rate,
            first_rate,
            second_rate,
            integral_rad_s,
        ]);
        let wanted_nm = -self.gain * state;
        let gravity_nm = self.model.gravity_nm(Vector3::from(measured.angle_rad));
        let mut command = Command::default();
        let mut is_limited = false;
        for joint in 0..2 {
            let ratio = self.model.links[joint].ratio;
            let motor_rad_s = measured.rate_rad_s[joint + 1] * ratio;
            let asked_nm = (wanted_nm[joint] + gravity_nm[joint + 1]) / ratio;
            let (torque_nm, share) = self.within(joint, asked_nm, measured.angle_rad[joint + 1], motor_rad_s);
            is_limited |= torque_nm != asked_nm;
            command.torque_nm[joint] = torque_nm;
            command.share[joint] = share;
        }
        // While a limit holds the torque, adding up the lean only delays the way back.
        let integral_rad_s = if is_limited { integral_rad_s } else { integral_rad_s + trunk * self.settings.period_s };
        (command, integral_rad_s)
    }

    /// Torque and share of speed of a motor that it and its joint can take.
    fn within(&self, joint: usize, asked_nm: f64, angle_rad: f64, motor_rad_s: f64) -> (f64, f64) {
        let Motor { torque_max_nm, power_max_w, top_speed_rad_s, speed_gain_nm_s } = self.motors[joint];
        let Settings { period_s, range_rad, share, .. } = self.settings;
        let most_nm = share * torque_max_nm;
        let gives = asked_nm * motor_rad_s > 0.0;
        let most_nm = if gives { most_nm.min(share * power_max_w / motor_rad_s.abs()) } else { most_nm };
        let torque_nm = asked_nm.clamp(-most_nm, most_nm);
        let mut speed_rad_s = motor_rad_s + torque_nm / speed_gain_nm_s;
        // Near an end the joint goes no faster than it can stop in, ten periods at an even rate.
        let ratio = self.model.links[joint].ratio;
        let [low_rad, high_rad] = range_rad[joint];
        let within_s = 10.0 * period_s;
        speed_rad_s = speed_rad_s.min((high_rad - angle_rad).max(0.0) * ratio / within_s);
        speed_rad_s = speed_rad_s.max((low_rad - angle_rad).min(0.0) * ratio / within_s);
        let share = (speed_rad_s / top_speed_rad_s).clamp(-1.0, 1.0);
        let torque_nm = (share * top_speed_rad_s - motor_rad_s) * speed_gain_nm_s;
        (torque_nm.clamp(-most_nm, most_nm), share)
    }
}

#[cfg(test)]
mod tests {
    use r4_world::{Ankle, BalanceTail, Body, Cable, Lift, MAX_STEP_S, Scene, ShaftMotion, Wearer};

    use super::*;
    use crate::tail::model::{Link, Trunk};

    const PERIOD_S: f64 = 0.01;
    /// The motors of the paper, at their shafts: torque, power; inertia and gain as in `boards/balance-tail.toml`.
    const MOTOR_1: (Motor, f64) = (
        Motor { torque_max_nm: 0.625, power_max_w: 573.0, top_speed_rad_s: 1100.0, speed_gain_nm_s: 1e-4 / 0.006 },
        1e-4,
    );
    const MOTOR_2: (Motor, f64) = (
        Motor { torque_max_nm: 4.0, power_max_w: 262.0, top_speed_rad_s: 80.0, speed_gain_nm_s: 1.5e-3 / 0.006 },
        1.5e-3,
    );

    /// Of a lean of 3 mrad, a rate of 10 mrad/s, 1 rad of the first joint, 0.06 rad of the second. With a fifth of the trunk's three
    /// weights the excursion is 52 % of that without a tail, with half of them 44 %, so 39 %.
    fn settings() -> Settings {
        Settings {
            period_s: PERIOD_S,
            weight: [1e5, 1.0, 300.0, 1e4, 0.1, 0.1, 1e6],
            torque_weight: [0.02, 0.2],
            range_rad: [[-0.2, 1.5], [-1.2, 1.2]],
            share: 0.95,
        }
    }

    fn model([first, second]: [f64; 2]) -> Model {
        let link = |mass_kg, length_m, centre_m, inertia_kg_m2, rotor_kg_m2| Link {
            mass_kg,
            length_m,
            centre_m,
            inertia_kg_m2,
            rotor_kg_m2,
            ratio: 25.0,
        };
        let trunk = Trunk {
            inertia_kg_m2: 70.0,
            moment_kg_m: [0.0, 75.0 * 0.90],
            tail_m: [-0.12, 1.10],
            ankle_nm_per_rad: 1200.0,
            ankle_nm_s_per_rad: 200.0,
        };
        Model { trunk, links: [link(3.6, 0.70, 0.48, 0.16, first), link(3.3, 0.40, 0.31, 0.05, second)] }
    }

    /// The person with or without what weighs anything on the back, who lifts 10 kg after 1 s within 0.5 s.
    fn body(weighs: f64, loss_per_wrap: f64) -> BalanceTail {
        let ankle = Ankle { stiffness_nm_per_rad: 1200.0, damping_nm_s_per_rad: 200.0, torque_max_nm: 150.0 };
        let wearer = Wearer { mass_kg: 75.0, centre_m: 0.90, inertia_kg_m2: 70.0, tail_m: [-0.12, 1.10], ankle };
        let link = |shaft, length_m, mass_kg, centre_m, inertia_kg_m2, stiffness_nm_per_rad| r4_world::Link {
            length_m,
            mass_kg: mass_kg * weighs,
            centre_m,
            inertia_kg_m2: inertia_kg_m2 * weighs,
            cable: Cable {
                shaft,
                ratio: 25.0,
                stiffness_nm_per_rad: stiffness_nm_per_rad * weighs,
                damping_nm_s_per_rad: 5.0 * weighs,
                wraps: 10.0,
                loss_per_wrap,
                friction_nm: 0.3 * weighs,
            },
        };
        let links = [link(0, 0.70, 3.6, 0.48, 0.16, 3000.0), link(1, 0.40, 3.3, 0.31, 0.05, 2000.0)];
        let lift = Lift { at_s: 1.0, over_s: 0.5, mass_kg: 10.0, place_m: [0.35, 1.05] };
        BalanceTail::new(wearer, links, [0.0; 2], Some(lift)).unwrap()
    }

    #[derive(Debug)]
    struct Outcome {
        /// Farthest the person's centre of mass is from where it was, m.
        excursion_m: f64,
        /// The same at the end.
        end_m: f64,
        /// Samples in which a motor was beyond torque, power or speed, or a joint beyond its range.
        violations: usize,
        joints_rad: [f64; 2],
    }

    /// Motors with the speed loop of their drives, limited as the drives are; the regulator every 10 ms.
    fn lift(body: &mut BalanceTail, motors: Option<[(Motor, f64); 2]>) -> Outcome {
        let regulator = motors.map(|motors| {
            let rotors = motors.map(|(_, inertia)| inertia);
            Regulator::new(model(rotors), motors.map(|(motor, _)| motor), settings(), [0.6, 0.3]).unwrap()
        });
        let mut shafts = [ShaftMotion::default(); 2];
        let (mut loads, mut command, mut integral) = ([0.0; 2], Command::default(), 0.0);
        let mut out = Outcome { excursion_m: 0.0, end_m: 0.0, violations: 0, joints_rad: [0.0; 2] };
        let every = (PERIOD_S / MAX_STEP_S).round() as usize;
        for step in 0..40_000 {
            let state = *body.state();
            if let Some(regulator) = regulator.as_ref().filter(|_| step % every == 0) {
                // Joints by the motors' encoders, as a board measures them.
                let measured = Measured {
                    angle_rad: [state.angle_rad[0], shafts[0].position / 25.0, shafts[1].position / 25.0],
                    rate_rad_s: [state.rate_rad_s[0], shafts[0].speed / 25.0, shafts[1].speed / 25.0],
                };
                (command, integral) = regulator.next(&measured, [0.0; 2], integral);
            }
            if let Some(motors) = motors {
                for (joint, (motor, inertia)) in motors.into_iter().enumerate() {
                    let shaft = &mut shafts[joint];
                    let target = command.share[joint] * motor.top_speed_rad_s;
                    // Implicit, so that 6 ms at 0.25 ms stay stable under a held load.
                    let rate = motor.speed_gain_nm_s / inertia;
                    let free = (shaft.speed + MAX_STEP_S * (rate * target + loads[joint] / inertia))
                        / (1.0 + MAX_STEP_S * rate);
                    let asked_nm = motor.speed_gain_nm_s * (target - free);
                    let gives = asked_nm * shaft.speed > 0.0;
                    let by_power_nm = motor.power_max_w / shaft.speed.abs().max(free.abs());
                    let most_nm = if gives { motor.torque_max_nm.min(by_power_nm) } else { motor.torque_max_nm };
                    let torque_nm = asked_nm.clamp(-most_nm, most_nm);
                    let next = shaft.speed + MAX_STEP_S * (torque_nm + loads[joint]) / inertia;
                    shaft.position += MAX_STEP_S * 0.5 * (shaft.speed + next);
                    shaft.speed = next;
                    let [low_rad, high_rad] = settings().range_rad[joint];
                    let angle_rad = state.angle_rad[joint + 1];
                    let beyond = command.torque_nm[joint].abs() > motor.torque_max_nm
                        || torque_nm * shaft.speed > motor.power_max_w * (1.0 + 1e-9)
                        || shaft.speed.abs() > motor.top_speed_rad_s
                        || angle_rad < low_rad
                        || angle_rad > high_rad;
                    out.violations += usize::from(beyond);
                }
            }
            body.step(&Scene::default(), step as f64 * MAX_STEP_S, &shafts, &mut loads, MAX_STEP_S);
            out.end_m = body.wearer_x_m();
            out.excursion_m = out.excursion_m.max(out.end_m.abs());
        }
        let [_, first, second] = body.state().angle_rad;
        out.joints_rad = [first, second];
        out
    }

    /// Kinematic: no board between. The stronger motor at the back, as in `boards/balance-tail.toml`, and the reading as printed.
    #[test]
    fn commands_stay_inside_what_motors_and_joints_take() {
        let (motors, settings) = ([MOTOR_2.0, MOTOR_1.0], settings());
        let regulator = Regulator::new(model([MOTOR_2.1, MOTOR_1.1]), motors, settings, [0.6, 0.3]).unwrap();
        for number in 0..2000 {
            // Low-discrepancy states well beyond what happens.
            let spread = |k: usize, most: f64| {
                ((number as f64 * [0.618, 0.414, 0.732, 0.236, 0.875, 0.156][k]).fract() - 0.5) * 2.0 * most
            };
            let measured = Measured {
                angle_rad: [spread(0, 0.5), 0.65 + spread(1, 1.0), spread(2, 1.4)],
                rate_rad_s: [spread(3, 2.0), spread(4, 3.0), spread(5, 30.0)],
            };
            let (Command { share, torque_nm }, integral) = regulator.next(&measured, [0.0; 2], 0.1);
            assert!(integral.is_finite());
            for joint in 0..2 {
                let (motor, rate_rad_s) = (motors[joint], measured.rate_rad_s[joint + 1] * 25.0);
                assert!(share[joint].abs() <= 1.0 && torque_nm[joint].abs() <= 0.95 * motor.torque_max_nm + 1e-12);
                assert!(torque_nm[joint] * rate_rad_s <= 0.95 * motor.power_max_w + 1e-9, "{measured:?}");
                let [low_rad, high_rad] = settings.range_rad[joint];
                let angle_rad = measured.angle_rad[joint + 1];
                assert!(angle_rad < high_rad || share[joint] <= 0.0, "{measured:?} {share:?}");
                assert!(angle_rad > low_rad || share[joint] >= 0.0, "{measured:?} {share:?}");
            }
        }
    }

    #[test]
    fn the_tail_halves_the_excursion_of_a_lift_with_the_stronger_motor_at_the_back() {
        let without = lift(&mut body(1e-6, 0.01), None);
        let with = lift(&mut body(1.0, 0.01), Some([MOTOR_2, MOTOR_1]));
        let printed = lift(&mut body(1.0, 0.01), Some([MOTOR_1, MOTOR_2]));
        // The columns of power exchanged, each motor where its torque fits.
        let crossed = [(MOTOR_2, 573.0), (MOTOR_1, 262.0)]
            .map(|((motor, inertia), power_max_w)| (Motor { power_max_w, ..motor }, inertia));
        let crossed = lift(&mut body(1.0, 0.01), Some(crossed));
        // Pulleys on plain bearings, which the model knows nothing of.
        let plain = lift(&mut body(1.0, 0.1), Some([MOTOR_2, MOTOR_1]));
        // By the load's moment over what is left of the ankle: 34.3 N m / (1200 - 662 - 103) N m/rad of 0.90 m at rest.
        assert!((without.end_m - 0.071).abs() < 1e-3 && without.excursion_m > without.end_m, "{without:?}");
        for outcome in [&with, &crossed, &plain] {
            assert!(outcome.excursion_m <= 0.5 * without.excursion_m, "{outcome:?}, {without:?}");
            assert_eq!(outcome.violations, 0, "{outcome:?}");
        }
        assert!(with.end_m.abs() < 1e-3, "the lean is taken back: {with:?}");
        // 15.6 N m do not lift 50 N m: the first joint hangs, and the lean stays.
        assert!(printed.excursion_m > 0.6 * without.excursion_m && printed.violations == 0, "{printed:?}");
        assert!(printed.joints_rad[0] < 0.35 && printed.end_m > 0.04, "{printed:?}");
    }
}
