//! Parameters of the abstract fidelity, identified from boards.

use r4_maths::minimise::nelder_mead;

use super::{
    boards::DrivenLeg,
    motion::{Motion, Trapezoid, Turn},
};

/// Motion identified by [`identified`] from 192 legs that three simulated boards drove over seeds 1 to 8. The residual
/// is 17 ms RMS for legs of 5 to 50 s; that of [`Motion::NOMINAL`] is 471 ms RMS. The boards' program has a period of
/// 20 ms.
pub const CALIBRATED: Motion =
    Motion { travel: Trapezoid { speed: 0.4, acceleration: 1.1775 }, turn: turn(1.0277, 0.5909), reached_m: REACHED_M };
/// Angles and distance of [`r4_rig::Follower`] and its limits on the boards: declared, not identified.
const FACING_RAD: f64 = 0.35;
const FACED_RAD: f64 = 0.05;
const REACHED_M: f64 = 0.05;

const fn turn(rate_rad_s: f64, time_constant_s: f64) -> Turn {
    Turn::Proportional { rate_rad_s, time_constant_s, from_rad: FACING_RAD, to_rad: FACED_RAD }
}

/// Bounds of travel speed, m/s, and acceleration, m/s²; turn rate, rad/s, and time constant, s. The accelerations
/// absorb the latency of set points and telemetry: with legs that all reach the top speed, latency and ramps are not
/// separately identifiable.
const BOUNDS: [(f64, f64); 4] = [(0.1, 1.0), (0.05, 20.0), (0.1, 3.0), (0.05, 3.0)];
/// Evaluations of the simplex; half the number gives the same six digits.
const EVALUATIONS: usize = 2_000;

/// Identifies the motion whose durations are closest to those of driven legs, by least squares.
#[must_use]
pub fn identified(legs: &[DrivenLeg]) -> Motion {
    let motion = |numbers: &[f64]| Motion {
        travel: Trapezoid { speed: numbers[0], acceleration: numbers[1] },
        turn: turn(numbers[2], numbers[3]),
        reached_m: REACHED_M,
    };
    let found = nelder_mead(&BOUNDS, &[0.4, 1.0, 1.0, 0.5], EVALUATIONS, |numbers| {
        let motion = motion(numbers);
        legs.iter().map(|leg| error_s(&motion, leg).powi(2)).sum()
    });
    motion(&found.at)
}

/// Duration of a leg by `motion` minus the driven duration, s.
#[must_use]
pub fn error_s(motion: &Motion, leg: &DrivenLeg) -> f64 {
    motion.leg(leg.from, leg.goal_m).duration_s() - leg.duration_s
}
