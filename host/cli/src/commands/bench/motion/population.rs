//! A population of simulated gear motors with encoders, each sampled from its seed.
//!
//! Sampled numbers, independent of each other; carrier and first bridge are those of the bench:
//!
//! | number | from | to | scale |
//! | --- | --- | --- | --- |
//! | supply, V | 12 | 48 | logarithmic |
//! | speed without load at full duty, rad/s at the output | 2 | 40 | logarithmic |
//! | gear ratio | 5 | 200 | logarithmic |
//! | winding, ohm | 0.2 | 5 | logarithmic |
//! | electrical time constant, ms | 0.2 | 2 | logarithmic |
//! | mechanical time constant, ms | 15 | 300 | logarithmic |
//! | viscous friction, share of what back-EMF brakes | 0 | 0.2 | linear |
//! | Coulomb friction, share of the stall torque | 0.01 | 0.15 | linear |
//! | static friction above it, share of the Coulomb friction | 0 | 0.5 | linear |
//! | speed at which that is gone (Stribeck), share of the speed without load | 0.005 | 0.03 | logarithmic |
//! | backlash, deg, in two of three motors | 0.1 | 2 | linear |
//! | dead zone of the bridge, duty | 0 | 0.1 | linear |
//! | lines of the encoder, four counts each | 50 | 2500 | logarithmic |
//!
//! The robot's configuration has the data-sheet values of the motor: speed, winding, encoder. Its feed-forward is 0, and
//! its gains are safe for the slowest motor of that speed, which makes them poor for all others.

use std::f64::consts::TAU;

use anyhow::{Context, anyhow};
use r4_boards::{PlantFile, Robot, SimulatedSensor};
use r4_plants::{
    DcGearMotor, Effect, Model, PlantSpec,
    effect::{
        backlash::Backlash,
        friction::{CoulombFriction, StaticFriction},
        input::DeadZone,
    },
};
use r4_protocol::{
    ChannelId, ChannelKind, Range,
    config::{FeedForward, Feedback, FollowConfig, PidGains, ProfileLimits, SettleConfig, StallConfig},
};
use rand_pcg::{Pcg64, rand_core::Rng};

/// Channel of the sampled motor.
pub(super) const CHANNEL: ChannelId = ChannelId::new(ChannelKind::Osmc, 0);
/// Robot around the motor; its other motor is removed.
pub(super) const ROBOT: &str = "sim:osmc-bench";
const RAIL: ChannelId = ChannelId::new(ChannelKind::Supply, 0);

/// Stream of the random generator, which separates these samples from other uses of the same seed.
const STREAM: u128 = 0x6d6f_746f_7273;
/// Speed of the motor's path as a share of its speed without load, and the time to reach it, s.
const PATH_SPEED: f64 = 0.4;
const PATH_RAMP_S: f64 = 0.5;
/// Accuracy of positions that the user requires: this angle, rad, or a count and a half where that is more.
const SETTLE_RAD: f64 = 0.5 / 360.0 * TAU;
const SETTLE_COUNTS: f64 = 1.5;
/// Highest supply voltage in the configuration, V: the carrier's converter reads up to 50 V.
const MOST_V: f64 = 49.9;

/// Motor sampled from a seed.
#[derive(Clone, Debug)]
pub(super) struct Sampled {
    supply_v: f64,
    /// Speed of the output at full duty without load and friction, rad/s.
    speed_rad_s: f64,
    lines_per_turn: u32,
    motor: DcGearMotor,
    effects: Vec<Effect>,
}

/// Random numbers from a seed.
struct Dice(Pcg64);

impl Dice {
    /// Uniformly distributed number.
    fn between(&mut self, low: f64, high: f64) -> f64 {
        // An f64 has 53 bits of mantissa, so that every share is exact.
        let share = (self.0.next_u64() >> 11) as f64 / (1_u64 << 53) as f64;
        low + (high - low) * share
    }

    /// Number uniformly distributed on a logarithmic scale.
    fn ratio_between(&mut self, low: f64, high: f64) -> f64 {
        low * (high / low).powf(self.between(0.0, 1.0))
    }
}

impl Sampled {
    /// Samples the motor of a seed.
    pub(super) fn new(seed: u64) -> Self {
        let mut dice = Dice(Pcg64::new(seed.into(), STREAM));
        let supply_v = dice.ratio_between(12.0, 48.0);
        let speed_rad_s = dice.ratio_between(2.0, 40.0);
        let gear_ratio = dice.ratio_between(5.0, 200.0);
        let resistance_ohm = dice.ratio_between(0.2, 5.0);
        let electrical_s = dice.ratio_between(0.2e-3, 2e-3);
        let mechanical_s = dice.ratio_between(0.015, 0.3);
        let viscous_share = dice.between(0.0, 0.2);
        let coulomb_share = dice.between(0.01, 0.15);
        let static_share = dice.between(0.0, 0.5);
        let stribeck_share = dice.ratio_between(0.005, 0.03);
        let has_backlash = dice.between(0.0, 3.0) < 2.0;
        // Sampled in any case, so that the numbers after it do not depend on it.
        let backlash_deg = dice.between(0.1, 2.0);
        let dead_zone = dice.between(0.0, 0.1);
        let lines_per_turn = dice.ratio_between(50.0, 2500.0).round() as u32;

        let back_emf = supply_v / speed_rad_s;
        // Viscous coefficient of the back-EMF through the winding, N m s/rad.
        let damping = back_emf * back_emf / resistance_ohm;
        let viscous = viscous_share * damping;
        let stall_nm = back_emf * supply_v / resistance_ohm;
        let coulomb_nm = coulomb_share * stall_nm;
        let mut effects = vec![
            Effect::DeadZone(DeadZone { duty: dead_zone }),
            Effect::CoulombFriction(CoulombFriction { level: coulomb_nm }),
            Effect::StaticFriction(StaticFriction {
                level: static_share * coulomb_nm,
                stribeck: stribeck_share * speed_rad_s,
            }),
        ];
        if has_backlash {
            effects.push(Effect::Backlash(Backlash { gap: backlash_deg.to_radians() }));
        }
        let motor = DcGearMotor {
            resistance_ohm,
            inductance_h: electrical_s * resistance_ohm,
            torque_constant_nm_per_a: back_emf / gear_ratio,
            gear_ratio,
            // The mechanical time constant is J / (k² / R + B).
            inertia_kg_m2: mechanical_s * (damping + viscous),
            viscous_nm_s_per_rad: viscous,
        };
        Self { supply_v, speed_rad_s, lines_per_turn, motor, effects }
    }

    /// Replaces the physics of the robot's first motor, and configures it from its data-sheet values.
    pub(super) fn put_into(&self, robot: &mut Robot, cascade_per_s: f64) -> anyhow::Result<()> {
        let source = "a sampled motor";
        let spec = PlantSpec::new(Model::DcGearMotor(self.motor), source, self.effects.clone())?;
        let simulation = &mut robot.simulation;
        simulation.motors.retain(|motor| motor.channel == CHANNEL);
        let simulated = simulation.motors.first_mut().ok_or_else(|| anyhow!("{ROBOT} has no {CHANNEL}"))?;
        simulated.plant = PlantFile { name: source.to_owned(), text: spec.to_toml() };
        if let Some(SimulatedSensor::Encoder { lines_per_turn, .. }) = &mut simulated.sensor {
            *lines_per_turn = self.lines_per_turn;
        }
        let rail = simulation.rails.iter_mut().find(|rail| rail.channel == RAIL).context("no rail")?;
        rail.emf_v = self.supply_v;
        // A blocked motor makes the rail sag by 5 %.
        rail.resistance_ohm = 0.05 * self.motor.resistance_ohm;
        let supply = robot.config.supplies.iter_mut().find(|supply| supply.id == RAIL).context("no supply")?;
        supply.range_v = Range::new((0.7 * self.supply_v) as f32, MOST_V as f32);
        supply.regeneration_v = None;

        robot.config.motors.retain(|motor| motor.id == CHANNEL);
        let motor = robot.config.motors.first_mut().context("no motor")?;
        motor.duty_max = 0.95;
        let winding = motor.winding.as_mut().context("no winding")?;
        winding.nominal_v = self.supply_v as f32;
        winding.dead_duty = 0.0;
        winding.resistance_ohm = self.motor.resistance_ohm as f32;
        winding.back_emf = (self.supply_v / self.speed_rad_s) as f32;
        // Rated for its stall current: heating is not part of this benchmark.
        winding.rated_a = (self.supply_v / self.motor.resistance_ohm) as f32;
        let control = motor.control.as_mut().context("no feedback")?;
        let count_rad = TAU / f64::from(4 * self.lines_per_turn);
        if let Feedback::Encoder { counts_per_turn, .. } = &mut control.feedback {
            *counts_per_turn = 4 * self.lines_per_turn;
        }
        let speed = PATH_SPEED * self.speed_rad_s;
        control.position = Range::new(-400.0, 400.0);
        control.speed_max = (0.8 * self.speed_rad_s) as f32;
        control.profile = ProfileLimits { speed: speed as f32, acceleration: (speed / PATH_RAMP_S) as f32, jerk: 0.0 };
        control.settle = SettleConfig {
            error: SETTLE_RAD.max(SETTLE_COUNTS * count_rad) as f32,
            // At least two counts within the settling time of 100 ms.
            speed: (0.02 * self.speed_rad_s).max(2.0 * count_rad / 0.1) as f32,
            time_ms: 100,
        };
        control.stall = StallConfig { duty: 0.8, travel: (3.0 * count_rad).max(0.02) as f32, time_ms: 500 };
        control.follow = FollowConfig { error: (2.0 * speed).max(1.0) as f32, time_ms: 200 };
        control.feed_forward = FeedForward { static_duty: 0.0, duty_per_speed: 0.0, duty_per_acceleration: 0.0 };
        control.cascade_per_s = cascade_per_s as f32;
        let per_speed = 1.0 / self.speed_rad_s;
        let gains = |kp: f64, ki: f64| PidGains { kp: (kp * per_speed) as f32, ki: (ki * per_speed) as f32, kd: 0.0 };
        // Without friction, the position loop closes with 3/s, and the speed loop with an integral of 1.5/s.
        control.position_pid = gains(3.0, 1.5);
        control.speed_pid = gains(0.3, 1.5);
        robot.config.validate()?;
        Ok(())
    }
}
