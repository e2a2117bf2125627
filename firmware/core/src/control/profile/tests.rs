use proptest::prelude::*;

use super::*;
use crate::{motion::scurve::Piece, testing::Ruckig};

const DT: f32 = 1e-3;
/// Room on both sides whose end no ramp reaches.
const FREE: [f32; 2] = [f32::INFINITY; 2];

/// Limits typical of motors: full acceleration after 10 ms to 0.5 s.
fn limits() -> impl Strategy<Value = ProfileLimits> {
    (0.1f32..10.0, 1.0f32..50.0, 2.0f32..100.0).prop_map(|(speed, acceleration, per_s)| ProfileLimits {
        speed,
        acceleration,
        jerk: acceleration * per_s,
    })
}

fn wide(limits: &ProfileLimits) -> Limits {
    let [speed, acceleration, jerk] = [limits.speed, limits.acceleration, limits.jerk].map(f64::from);
    Limits { speed, acceleration, jerk }
}

/// Motion within the limits, also after its acceleration has been removed; arguments are shares of the limits.
fn inside(speed: f32, acceleration: f32, limits: &ProfileLimits) -> Ramp {
    let acceleration = acceleration * limits.acceleration;
    let change = acceleration * acceleration.abs() / (2.0 * limits.jerk);
    let most = (limits.speed - change.abs()).max(0.0);
    Ramp { speed: speed * most, acceleration: if change.abs() > limits.speed { 0.0 } else { acceleration } }
}

/// Checks continuity from one period to the next, up to the rounding of f32.
fn goes_on(before: Moment, now: Moment, limits: &ProfileLimits) -> Result<(), TestCaseError> {
    let rounding = |size: f32| 4.0 * f32::EPSILON * size;
    let ProfileLimits { speed, acceleration, jerk } = *limits;
    prop_assert!(now.speed.abs() <= speed + rounding(speed), "{now:?}");
    prop_assert!(now.acceleration.abs() <= acceleration + rounding(acceleration), "{now:?}");
    let jump = (now.acceleration - before.acceleration).abs();
    prop_assert!(jump <= jerk * DT + rounding(acceleration), "{before:?} {now:?}");
    let jump = (now.speed - before.speed - (now.acceleration + before.acceleration) / 2.0 * DT).abs();
    // The speed changes by the mean of two accelerations, except where the jerk changes.
    prop_assert!(jump <= jerk * DT * DT + rounding(speed), "{before:?} {now:?}");
    let jump = (before.to_go - now.to_go - (now.speed + before.speed) / 2.0 * DT).abs();
    // A path that has arrived absorbs up to 1e-6 of its plan's error.
    prop_assert!(jump <= jerk * DT * DT * DT + 1e-6 + rounding(now.to_go.abs()), "{before:?} {now:?}");
    Ok(())
}

proptest! {
    #[test]
    fn arrives_without_overshoot_in_the_time_of_a_trapezoid(
        distance in prop_oneof![-50.0f32..50.0, -0.05f32..0.05], speed in 0.1f32..10.0, acceleration in 1.0f32..50.0,
    ) {
        let mut profile = Profile::new(ProfileLimits { speed, acceleration, jerk: 0.0 }, DT);
        profile.start(distance, 0.0);
        let mut last_speed = 0.0f32;
        let mut periods = 0u32;
        loop {
            let Moment { to_go, speed: now, acceleration: led } = profile.step();
            prop_assert!(now.abs() <= speed * 1.000_01);
            // One rounding error of speed ± a dt; the last step takes the remainder of two steps.
            let steps = if now == 0.0 { 2.0 } else { 1.0 };
            prop_assert!((now - last_speed).abs() <= steps * acceleration * DT * 1.001 + 1e-6);
            prop_assert_eq!(led, (now - last_speed) / DT);
            last_speed = now;
            periods += 1;
            // Past the target by no more than the last step, and half an ulp of the distance for each step.
            let roundings = distance.abs() * f32::EPSILON / 2.0 * periods as f32;
            prop_assert!(to_go * distance.signum() >= -acceleration * DT * DT * 2.0 - roundings, "{}", to_go);
            if to_go == 0.0 && now == 0.0 {
                break;
            }
            prop_assert!(periods < 2_000_000, "never arrived: {} to go", to_go);
        }
        let (d, v, a) = (distance.abs(), speed, acceleration);
        let ideal_s = if d * a > v * v { d / v + v / a } else { 2.0 * (d / a).sqrt() };
        // A few periods for discretisation, and a share for f32 sums of thousands of steps.
        prop_assert!((periods as f32 * DT - ideal_s).abs() < 0.02 + 0.02 * ideal_s, "{} periods, ideal {} s", periods, ideal_s);
    }

    /// From rest or any other state within the limits, the path equals Ruckig's in each period, keeps the limits, and
    /// arrives in the same time.
    #[test]
    fn a_path_with_limited_jerk_is_ruckigs(
        limits in limits(), distance in prop_oneof![-50.0f32..50.0, -0.05f32..0.05],
        speed in prop_oneof![Just(0.0f32), -1.0f32..1.0], acceleration in prop_oneof![Just(0.0f32), -1.0f32..1.0],
    ) {
        let start = inside(speed, acceleration, &limits);
        let mut profile = Profile::new(limits, DT);
        profile.join(distance, start);
        let state = [-distance, start.speed, start.acceleration].map(f64::from);
        let ruckig = Ruckig::to_rest(state, 0.0, &wide(&limits));
        let mut before = profile.now();
        let periods = (ruckig.duration_s / f64::from(DT)) as u32;
        for period in 1..=periods {
            let now = profile.step();
            goes_on(before, now, &limits)?;
            before = now;
            let [position, speed, acceleration] = ruckig.at(f64::from(period) * f64::from(DT));
            // Both are in f32; Ruckig's roots are accurate to about 1e-7 of the distance.
            let far = distance.abs() + limits.speed;
            prop_assert!((f64::from(now.to_go) + position).abs() <= 1e-6 * f64::from(far), "{now:?} {position}");
            prop_assert!((f64::from(now.speed) - speed).abs() <= 1e-5 * f64::from(limits.speed), "{now:?} {speed}");
            // Square roots of the speed's rounding errors.
            let size = limits.acceleration + (limits.jerk * limits.speed).sqrt();
            prop_assert!((f64::from(now.acceleration) - acceleration).abs() <= 1e-3 * f64::from(size), "{now:?} {acceleration}");
        }
        // Ruckig arrives within this period, or by rounding in the next.
        profile.step();
        prop_assert_eq!(profile.step(), Moment::default());
    }

    /// With new targets on the way, position, speed and acceleration stay continuous.
    #[test]
    fn a_moved_target_bends_a_path_without_a_jump(
        limits in limits(), moves in prop::collection::vec((-2.0f32..2.0, 1u32..1000), 1..8),
    ) {
        let mut profile = Profile::new(limits, DT);
        for (shift, periods) in moves {
            profile.shift_target(shift);
            for _ in 0..periods {
                let before = profile.now();
                goes_on(before, profile.step(), &limits)?;
            }
        }
        let mut periods = 0;
        while profile.step() != Moment::default() {
            periods += 1;
            prop_assert!(periods < 1_000_000, "never arrived: {:?}", profile.now());
        }
    }

    /// For any limits that a configuration may have, paths and ramps are finite and do not panic.
    #[test]
    fn any_limits_give_finite_paths(
        exponents in prop::array::uniform3(-9.0f32..9.0), distance in -1e9f32..1e9, speed in -1e9f32..1e9,
        acceleration in -1e15f32..1e15,
    ) {
        let [speed_max, acceleration_max, jerk] = exponents.map(|exponent| 10f32.powf(exponent));
        let limits = ProfileLimits { speed: speed_max, acceleration: acceleration_max, jerk };
        let mut profile = Profile::new(limits, DT);
        let mut ramp = Ramp { speed, acceleration };
        profile.join(distance, ramp);
        prop_assert!(!profile.stopping(ramp).is_nan());
        for _ in 0..100 {
            let Moment { to_go, speed, acceleration } = profile.step();
            prop_assert!(to_go.is_finite() && speed.is_finite() && acceleration.is_finite());
            ramp.step(speed_max, [distance.abs(); 2], &limits, DT);
            prop_assert!(ramp.speed.is_finite() && ramp.acceleration.is_finite(), "{ramp:?}");
        }
    }

    #[test]
    fn stopping_takes_what_the_path_to_rest_takes(
        limits in limits(), speed in -1.0f32..1.0, acceleration in -1.0f32..1.0,
    ) {
        let motion = Ramp { speed: speed * limits.speed, acceleration: acceleration * limits.acceleration };
        let [speed, acceleration] = [motion.speed, motion.acceleration].map(f64::from);
        let start = Motion { position: Position::near_zero(0.0), speed, acceleration };
        let path = Path::to_speed(start, 0.0, &wide(&limits));
        let end = path.at(path.duration_s()).position;
        let way = -end.distance_to(0);
        // Rounding of the distance to f32, and of displacements that cancel.
        let most = f64::from(limits.speed * (limits.speed / limits.acceleration + 1.0)) + way.abs();
        prop_assert!((f64::from(motion.stopping(&limits)) - way).abs() <= 1e-6 * most, "{} {way}", motion.stopping(&limits));
        let trapezoid = ProfileLimits { jerk: 0.0, ..limits };
        let way = motion.speed * motion.speed.abs() / (2.0 * limits.acceleration);
        prop_assert!((motion.stopping(&trapezoid) - way).abs() <= 2.0 * f32::EPSILON * way.abs());
    }

    /// The ramp keeps its limits, has no jump of acceleration, and takes the time of the fastest one.
    #[test]
    fn a_speed_is_come_to_with_limited_jerk(
        limits in limits(), from in -1.0f32..1.0, to in -1.0f32..1.0, share in 0.0f32..1.0, then in -1.0f32..1.0,
    ) {
        let mut ramp = Ramp { speed: from * limits.speed, acceleration: 0.0 };
        let [from, to, then] = [from, to, then].map(|share| share * limits.speed);
        let duration_s = |motion: Ramp, speed: f32| {
            let [start, acceleration] = [motion.speed, motion.acceleration].map(f64::from);
            let start = Motion { position: Position::near_zero(0.0), speed: start, acceleration };
            Path::to_speed(start, speed.into(), &wide(&limits)).duration_s() as f32
        };
        let first = (share * duration_s(Ramp { speed: from, acceleration: 0.0 }, to) / DT) as u32;
        let mut ends = None;
        for period in 0.. {
            let wanted = if period < first { to } else { then };
            let before = ramp;
            if period == first {
                ends = Some(first + (duration_s(ramp, then) / DT) as u32);
            }
            prop_assert_eq!(ramp.step(wanted, FREE, &limits, DT), wanted);
            let jump = (ramp.acceleration - before.acceleration).abs();
            // The last step takes the remainder of two steps.
            prop_assert!(jump <= 2.0 * limits.jerk * DT * 1.001, "{before:?} {ramp:?}");
            prop_assert!(ramp.acceleration.abs() <= limits.acceleration * 1.000_001);
            if let Some(end) = ends && ramp == (Ramp { speed: then, acceleration: 0.0 }) {
                // Ramps of acceleration advance in whole periods.
                prop_assert!(period <= end + 6 + end / 50, "{period} periods, not {end}");
                break;
            }
            prop_assert!(period < 1_000_000, "never: {ramp:?}");
        }
    }

    /// For any set point, the speed stops at the end of the range and not beyond.
    #[test]
    fn a_speed_stops_before_the_end_of_the_range(limits in limits(), room in 0.01f32..20.0, up: bool) {
        let side = if up { 1.0 } else { -1.0 };
        let mut ramp = Ramp::default();
        let mut gone = 0.0f64;
        for _ in 0..60_000 {
            let ahead = (f64::from(room) - gone) as f32;
            let rooms = if up { [1e3, ahead] } else { [ahead, 1e3] };
            ramp.step(side * limits.speed, rooms, &limits, DT);
            gone += f64::from(side * ramp.speed * DT);
            // Change of acceleration and speed in two periods.
            let late = (limits.acceleration + limits.jerk * DT) * DT * DT * 4.0;
            prop_assert!(gone <= f64::from(room + late), "{gone} of {room}: {ramp:?}");
        }
        // Near the end the speed is low.
        let near = (limits.speed * DT).max(room * 0.02);
        prop_assert!(gone >= f64::from(room - near).min(f64::from(limits.speed) * 50.0), "{gone} of {room}");
    }
}

/// The memory of a motor's path is small.
#[test]
fn a_path_takes_little_memory() {
    assert!(size_of::<Profile>() <= 136, "{}", size_of::<Profile>());
    assert!(size_of::<Profile>() < 3 * size_of::<Piece>());
}
