//! Time-optimal path with limited speed, acceleration and jerk, from any state of motion to rest at a position or to a
//! speed.
//!
//! A path towards a target heads for full speed as fast as the limits allow, cruises, and brakes as hard as they allow.
//! The end of the path grows with the moment at which braking begins, so that moment is the only unknown, whatever the
//! state at the start. If even braking at once ends beyond the target, the same is done towards the other side. This
//! gives the seven segments from rest, and the right ones from any other state.
//!
//! Paths are functions of time and are not stepped: a new command starts a new path from a point of the old one.

use super::numbers::{rounded, to_f64};
use crate::{root::sqrt, within::Within};
use heapless::Vec;

/// Limits of a path. All positive; speed and acceleration finite.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Highest speed on the path, steps/s.
    pub speed: f64,
    /// Highest acceleration on the path, steps/s².
    pub acceleration: f64,
    /// Highest jerk, steps/s³; infinite for trapezoids, whose acceleration jumps.
    pub jerk: f64,
}

/// Position as an integer number of steps plus a fraction, in -0.5..=0.5, so that its resolution does not depend on the
/// distance from zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Position {
    /// Nearest step.
    pub steps: i64,
    /// Offset from that step, steps.
    pub fraction: f64,
}

impl Position {
    /// Position exactly at a step.
    #[must_use]
    pub const fn at_step(steps: i64) -> Self {
        Self { steps, fraction: 0.0 }
    }

    /// Position at `distance` steps from 0, which should be small.
    #[must_use]
    pub fn near_zero(distance: f64) -> Self {
        Self::at_step(0).moved(distance)
    }

    /// Distance from this position to a step, steps.
    #[must_use]
    pub fn distance_to(self, steps: i64) -> f64 {
        let distance = steps.wrapping_sub(self.steps);
        let size = to_f64(distance.unsigned_abs());
        if distance < 0 { -size - self.fraction } else { size - self.fraction }
    }

    fn moved(self, distance: f64) -> Self {
        let (whole, fraction) = rounded(self.fraction + distance);
        Self { steps: self.steps.wrapping_add(whole), fraction }
    }
}

/// State of motion at one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// Position of the motor.
    pub position: Position,
    /// Speed of the motor, steps/s.
    pub speed: f64,
    /// Acceleration of the motor, steps/s².
    pub acceleration: f64,
}

impl Motion {
    /// State at rest at a step.
    #[must_use]
    pub const fn rest(steps: i64) -> Self {
        Self { position: Position::at_step(steps), speed: 0.0, acceleration: 0.0 }
    }
}

/// Stretch of time with constant jerk. It stores its initial acceleration, because in a trapezoid that jumps between
/// arcs.
#[derive(Clone, Copy, Debug)]
struct Arc {
    duration_s: f64,
    acceleration: f64,
    jerk: f64,
}

impl Arc {
    const NONE: Self = Self { duration_s: 0.0, acceleration: 0.0, jerk: 0.0 };

    /// Returns the arc, limited to this duration.
    fn cut(self, duration_s: f64) -> Self {
        Self { duration_s: self.duration_s.min(duration_s), ..self }
    }
}

/// Distance, speed and acceleration while following an arc.
#[derive(Clone, Copy)]
struct Relative {
    distance: f64,
    speed: f64,
    acceleration: f64,
}

impl Relative {
    fn after(self, arc: Arc) -> Self {
        let (t, a, j) = (arc.duration_s, arc.acceleration, arc.jerk);
        Self {
            distance: self.distance + t * (self.speed + t * (a / 2.0 + t * j / 6.0)),
            speed: self.speed + t * (a + t * j / 2.0),
            acceleration: a + t * j,
        }
    }
}

/// Fastest ramp to the speed `to`, ending without acceleration. The speed leaves the interval between start and end
/// only while an initial acceleration is removed; an acceleration beyond the limit is first brought back to it.
fn ramp(speed: f64, acceleration: f64, to: f64, limits: &Limits) -> [Arc; 3] {
    let Limits { acceleration: most, jerk, .. } = *limits;
    if jerk.is_infinite() {
        let change = to - speed;
        let arc = Arc { duration_s: change.abs() / most, acceleration: most.copysign(change), jerk: 0.0 };
        return [arc, Arc::NONE, Arc::NONE];
    }
    let if_taken_back = speed + acceleration * acceleration.abs() / (2.0 * jerk);
    let side = if to >= if_taken_back { 1.0 } else { -1.0 };
    let (start, change) = (side * acceleration, side * (to - speed));
    // The changes from `start` up to the peak and from there to 0 add up to the change: (2 peak² - start²) / 2 jerk =
    // change.
    let free_peak_squared = (jerk * change + start * start / 2.0).max(0.0);
    let holds = free_peak_squared > most * most;
    // A square root takes as long as the rest of this function, and often it is not needed.
    let peak = if holds { most } else { sqrt(free_peak_squared) };
    let first_s = (peak - start).abs() / jerk;
    let last_s = peak / jerk;
    let hold_s =
        if holds { ((change - first_s * (start + peak) / 2.0 - last_s * peak / 2.0) / most).max(0.0) } else { 0.0 };
    let first_jerk = side * jerk.copysign(peak - start);
    [
        Arc { duration_s: first_s, acceleration, jerk: first_jerk },
        Arc { duration_s: hold_s, acceleration: side * peak, jerk: 0.0 },
        Arc { duration_s: last_s, acceleration: side * peak, jerk: -side * jerk },
    ]
}

/// State after `time_s` of a ramp that starts with `speed`.
fn along(ramp: &[Arc; 3], speed: f64, mut time_s: f64) -> Relative {
    let mut state = Relative { distance: 0.0, speed, acceleration: ramp[0].acceleration };
    for arc in ramp {
        if time_s <= 0.0 {
            break;
        }
        state = state.after(arc.cut(time_s));
        time_s -= arc.duration_s;
    }
    state
}

/// Distance of a whole ramp that starts with `speed`.
fn distance(ramp: &[Arc; 3], speed: f64) -> f64 {
    let start = Relative { distance: 0.0, speed, acceleration: 0.0 };
    let arcs = ramp.iter().filter(|arc| arc.duration_s > 0.0);
    arcs.fold(start, |state, arc| state.after(*arc)).distance
}

fn duration_s(ramp: &[Arc; 3]) -> f64 {
    ramp.iter().map(|arc| arc.duration_s).sum()
}

/// Piece of a path: constant jerk from `start_s` after the path's start until the next piece.
#[derive(Clone, Copy, Debug)]
pub struct Piece {
    /// Time after the path's start, s.
    pub start_s: f64,
    /// State of motion at `start_s`.
    pub start: Motion,
    /// Jerk of the piece, steps/s³.
    pub jerk: f64,
}

impl Piece {
    /// Returns the distance from the piece's start, steps, and the speed, steps/s, `time_s` after it.
    #[must_use]
    pub fn distance_and_speed(&self, time_s: f64) -> (f64, f64) {
        let (t, Motion { speed, acceleration, .. }) = (time_s, self.start);
        (t * (speed + t * (acceleration / 2.0 + t * self.jerk / 6.0)), speed + t * (acceleration + t * self.jerk / 2.0))
    }

    fn at(&self, time_s: f64) -> Motion {
        let (distance, speed) = self.distance_and_speed(time_s);
        Motion {
            position: self.start.position.moved(distance),
            speed,
            acceleration: self.start.acceleration + self.jerk * time_s,
        }
    }
}

/// Maximum number of pieces: heading for full speed, cruise, braking, and the final state.
const MAX_PIECES: usize = 8;

/// Path from some state of motion on, ending in a state that lasts.
#[derive(Clone, Debug)]
pub struct Path {
    pieces: Vec<Piece, MAX_PIECES>,
    /// Index of the first unfinished piece.
    first: usize,
}

/// Miss of the target, steps, below which a path needs no correction other than the shift that takes it exactly to the
/// target.
const NEGLIGIBLE: f64 = 1e-6;

impl Path {
    /// Path that stays at a state's position.
    #[must_use]
    pub fn rest(at: Motion) -> Self {
        let mut path = Self { pieces: Vec::new(), first: 0 };
        Builder::new(&mut path, at).finish(0.0);
        path
    }

    /// Fastest path to rest at a step.
    ///
    /// Keeps the limits, except from a state outside them: that is first brought inside, and a state too fast to stop
    /// before the target passes it and returns.
    #[must_use]
    pub fn to_position(from: Motion, target: i64, limits: &Limits) -> Self {
        let mut path = Self::rest(from);
        path.turn_to_position(from, target, limits);
        path
    }

    /// Replaces this path by [`Path::to_position`]'s, in place.
    pub fn turn_to_position(&mut self, from: Motion, target: i64, limits: &Limits) {
        let way = from.position.distance_to(target);
        let stop = ramp(from.speed, from.acceleration, 0.0, limits);
        let excess = way - distance(&stop, from.speed);
        let mut path = Builder::new(self, from);
        if excess.abs() <= NEGLIGIBLE {
            path.ramp(&stop, f64::INFINITY);
        } else {
            let side = 1f64.copysign(excess);
            let out = ramp(from.speed, from.acceleration, side * limits.speed, limits);
            // Overshoot of the path that begins to brake at this time of `out`; grows with that time.
            let beyond = |time_s: f64| {
                let Relative { distance: covered, speed, acceleration } = along(&out, from.speed, time_s);
                let stop = ramp(speed, acceleration, 0.0, limits);
                side * (covered + distance(&stop, speed) - way)
            };
            let out_s = duration_s(&out);
            let short = -beyond(out_s);
            if short >= 0.0 {
                path.ramp(&out, f64::INFINITY);
                path.settle(side * limits.speed);
                path.arc(Arc { duration_s: short / limits.speed, ..Arc::NONE });
            } else if limits.jerk.is_infinite() {
                // Up to a peak and down again, each with full acceleration: 2 peak² - speed² = 2 acceleration way.
                let peak = sqrt(side * way * limits.acceleration + from.speed * from.speed / 2.0);
                path.ramp(&out, (peak - side * from.speed) / limits.acceleration);
            } else {
                path.ramp(&out, root((0.0, -excess.abs()), (out_s, -short), beyond));
            }
            let braking = path.path.pieces.len();
            let stop = ramp(path.now.speed, path.now.acceleration, 0.0, limits);
            path.ramp(&stop, f64::INFINITY);
            // The rounding error of a long path is moved to where the path is fast.
            let missed = path.now.position.distance_to(target);
            for piece in path.path.pieces.iter_mut().skip(braking) {
                piece.start.position = piece.start.position.moved(missed);
            }
        }
        path.now.position = Position::at_step(target);
        path.finish(0.0);
    }

    /// Fastest path to a speed, which is then held; 0 stops.
    #[must_use]
    pub fn to_speed(from: Motion, speed: f64, limits: &Limits) -> Self {
        let mut path = Self::rest(from);
        path.turn_to_speed(from, speed, limits);
        path
    }

    /// Replaces this path by [`Path::to_speed`]'s, in place, without a copy of its pieces.
    pub fn turn_to_speed(&mut self, from: Motion, speed: f64, limits: &Limits) {
        let mut path = Builder::new(self, from);
        path.ramp(&ramp(from.speed, from.acceleration, speed, limits), f64::INFINITY);
        path.finish(speed);
    }

    /// Drops the pieces that are over at a time after the start. Later queries must not be before that.
    pub fn go_on_to(&mut self, time_s: f64) {
        while self.pieces.get(self.first + 1).is_some_and(|next| next.start_s <= time_s) {
            self.first += 1;
        }
    }

    /// Shifts the numbering of all its positions by `by` steps.
    pub fn shift(&mut self, by: i64) {
        for piece in &mut self.pieces {
            piece.start.position.steps = piece.start.position.steps.wrapping_add(by);
        }
    }

    /// Unfinished pieces in order of time; never empty. The last has no end, and constant speed.
    #[must_use]
    pub fn pieces(&self) -> &[Piece] {
        &self.pieces[self.first..]
    }

    /// State of motion `time_s` after the start.
    // Not inlined: several times in the control tick, which has to fit into ITCM.
    #[inline(never)]
    #[must_use]
    pub fn at(&self, time_s: f64) -> Motion {
        let piece = self.piece_at(time_s);
        piece.at(time_s - piece.start_s)
    }

    /// Speed `time_s` after the start, steps/s.
    #[must_use]
    pub fn speed_at(&self, time_s: f64) -> f64 {
        let piece = self.piece_at(time_s);
        piece.distance_and_speed(time_s - piece.start_s).1
    }

    fn piece_at(&self, time_s: f64) -> &Piece {
        let mut piece = &self.pieces()[0];
        for next in &self.pieces()[1..] {
            if next.start_s > time_s {
                break;
            }
            piece = next;
        }
        piece
    }

    /// Time after the start at which the final state is reached, s.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        self.pieces.last().map_or(0.0, |last| last.start_s)
    }

    /// Returns true if the path is over and nothing moves from `time_s` on.
    #[must_use]
    pub fn rests_at(&self, time_s: f64) -> bool {
        self.pieces.last().is_some_and(|last| last.start_s <= time_s && last.start.speed == 0.0)
    }
}

/// Builder of a path from its arcs.
struct Builder<'p> {
    path: &'p mut Path,
    now: Motion,
    time_s: f64,
}

impl<'p> Builder<'p> {
    fn new(path: &'p mut Path, from: Motion) -> Self {
        path.pieces.clear();
        path.first = 0;
        Self { path, now: from, time_s: 0.0 }
    }

    fn arc(&mut self, arc: Arc) {
        if arc.duration_s <= 0.0 {
            return;
        }
        let piece = Piece {
            start_s: self.time_s,
            start: Motion { acceleration: arc.acceleration, ..self.now },
            jerk: arc.jerk,
        };
        // There is room for three arcs, cruise, three arcs and the end.
        let _ = self.path.pieces.push(piece);
        self.now = piece.at(arc.duration_s);
        self.time_s += arc.duration_s;
    }

    /// Appends the first `time_s` of a ramp.
    fn ramp(&mut self, ramp: &[Arc; 3], mut time_s: f64) {
        for arc in ramp {
            self.arc(arc.cut(time_s));
            time_s -= arc.duration_s;
        }
    }

    /// Sets the speed at which a ramp has ended, to remove rounding errors.
    fn settle(&mut self, speed: f64) {
        self.now = Motion { speed, acceleration: 0.0, ..self.now };
    }

    fn finish(mut self, speed: f64) {
        self.settle(speed);
        let _ = self.path.pieces.push(Piece { start_s: self.time_s, start: self.now, jerk: 0.0 });
    }
}

/// Zero of an increasing function, between two of its points, below and above 0.
///
/// Inverse quadratic interpolation where it is safe, else bisection (Chandrupatla, Advances in Engineering Software 28,
/// 1997, 145-149). Ends at 1e-9 of the function or when the interval is down to rounding.
fn root(low: (f64, f64), high: (f64, f64), function: impl Fn(f64) -> f64) -> f64 {
    let (mut a, mut b) = (high, low);
    let mut share = 0.5;
    for _ in 0..100 {
        let x = a.0 + share * (b.0 - a.0);
        let y = function(x);
        let last = if (y > 0.0) == (a.1 > 0.0) { a } else { core::mem::replace(&mut b, a) };
        a = (x, y);
        let best = if a.1.abs() < b.1.abs() { a } else { b };
        let least = f64::EPSILON * (best.0.abs() + high.0 * 1e-3) / (b.0 - a.0).abs();
        if best.1.abs() <= 1e-9 || least >= 0.5 {
            return best.0;
        }
        let place = (a.0 - b.0) / (last.0 - b.0);
        let height = (a.1 - b.1) / (last.1 - b.1);
        share = if height * height < place && (1.0 - height) * (1.0 - height) < 1.0 - place {
            a.1 / (b.1 - a.1) * last.1 / (b.1 - last.1)
                + (last.0 - a.0) / (b.0 - a.0) * a.1 / (last.1 - a.1) * b.1 / (last.1 - b.1)
        } else {
            0.5
        };
        share = share.within(least, 1.0 - least);
    }
    a.0
}

#[cfg(test)]
mod tests {
    extern crate std;

    use core::cell::Cell;

    use proptest::prelude::*;

    use super::*;
    use crate::testing::Ruckig;

    /// Limits of a micro-stepped motor, from slow to 100 kHz, with times to full acceleration of 1 ms to 1 s or none.
    fn limits() -> impl Strategy<Value = Limits> {
        let jerk_time_s = prop_oneof![Just(0.0), (-3.0..0.0f64).prop_map(|exponent| 10f64.powf(exponent))];
        (1.0..5.0f64, 1.0..7.0f64, jerk_time_s).prop_map(|(speed, acceleration, jerk_time_s)| {
            let acceleration = 10f64.powf(acceleration);
            Limits { speed: 10f64.powf(speed), acceleration, jerk: acceleration / jerk_time_s }
        })
    }

    /// Shortest time from rest to rest, by cases: full speed reached, full acceleration reached, neither.
    fn ideal_s(distance: f64, limits: &Limits) -> f64 {
        let Limits { speed: v, acceleration: a, jerk: j } = *limits;
        let to_speed_s = if v * j < a * a { 2.0 * (v / j).sqrt() } else { a / j + v / a };
        let peak = a * ((a * a / j / j + 4.0 * distance / a).sqrt() - a / j) / 2.0;
        if distance >= v * to_speed_s {
            distance / v + to_speed_s
        } else if peak * j >= a * a {
            2.0 * (a / j + peak / a)
        } else {
            4.0 * (distance / 2.0 / j).cbrt()
        }
    }

    /// Distance between two positions, steps.
    fn between(from: Position, to: Position) -> f64 {
        from.distance_to(to.steps) + to.fraction
    }

    /// On curves from steep to flat, for which bisection takes 30 evaluations: 4.9 on average, as measured.
    #[test]
    fn a_root_takes_five_looks() {
        let looks = Cell::new(0);
        for exponent in [0.5, 1.0, 1.5, 2.0, 3.0, 4.0] {
            for share in 1..100 {
                let height = f64::from(share) / 100.0;
                root((0.0, -height), (1.0, 1.0 - height), |x| {
                    looks.set(looks.get() + 1);
                    x.powf(exponent) - height
                });
            }
        }
        assert!(looks.get() <= 49 * 6 * 99 / 10, "{} looks", looks.get());
    }

    /// A function so steep that no number comes within 1e-9 of its zero: the search ends where the interval is down to
    /// rounding, in any unit of time.
    #[test]
    fn a_root_below_rounding_ends() {
        for (height, end) in
            [1e-3, 0.1, 0.3, 0.7, 0.999].map(|height| [1e-3, 1.0, 1e6].map(|end| (height, end))).concat()
        {
            let looks = Cell::new(0);
            let x = root((0.0, -1e12 * height), (end, 1e12 * (1.0 - height)), |x| {
                looks.set(looks.get() + 1);
                1e12 * ((x / end).powf(3.0) - height)
            });
            assert!((x / end - height.cbrt()).abs() <= 4.0 * f64::EPSILON);
            assert!(looks.get() <= 11, "{} looks", looks.get());
        }
    }

    /// Checks the limits at the ends of every piece and, for speed, at its extremes within, and continuity between
    /// pieces.
    fn check(path: &Path, limits: &Limits) -> Result<(), TestCaseError> {
        // Rounding of f64 in sums of about ten terms.
        let above = 1.0 + 1e-9;
        for (piece, next) in path.pieces().iter().zip(&path.pieces()[1..]) {
            let time_s = next.start_s - piece.start_s;
            let end = piece.at(time_s);
            // Start times are in f64 from the path's start.
            let rounded_s = 4.0 * f64::EPSILON * next.start_s;
            let jerk_s = if piece.jerk == 0.0 { 0.0 } else { limits.jerk * rounded_s };
            prop_assert!(piece.jerk == 0.0 || (piece.jerk.abs() <= limits.jerk && limits.jerk.is_finite()));
            for acceleration in [piece.start.acceleration, end.acceleration] {
                prop_assert!(acceleration.abs() <= limits.acceleration * above + jerk_s, "{piece:?}, {limits:?}");
            }
            // The speed is a parabola with its extreme where the acceleration is 0.
            let extreme_s = (-piece.start.acceleration / piece.jerk).clamp(0.0, time_s);
            for time_s in [0.0, if extreme_s.is_finite() { extreme_s } else { 0.0 }, time_s] {
                let (_, speed) = piece.distance_and_speed(time_s);
                prop_assert!(
                    speed.abs() <= limits.speed * above + limits.acceleration * rounded_s,
                    "{speed} in {piece:?}, {limits:?}"
                );
            }
            // The shift before braking: 1e-6 steps, or the rounding of the distance; elsewhere rounding.
            let way = end.speed.abs() * next.start_s;
            prop_assert!(between(end.position, next.start.position).abs() <= 2e-6 + way * 1e-14, "{end:?} {next:?}");
            prop_assert!(
                (end.speed - next.start.speed).abs() <= limits.speed * 1e-9 + limits.acceleration * rounded_s,
                "{end:?} {next:?}"
            );
            if limits.jerk.is_finite() {
                let jump = (end.acceleration - next.start.acceleration).abs();
                // At the end of a path the accuracy of its roots: square root of the speed's rounding.
                prop_assert!(
                    jump <= limits.acceleration * 1e-6 + (limits.jerk * limits.speed).sqrt() * 1e-6 + jerk_s,
                    "{end:?} {next:?}"
                );
            }
        }
        Ok(())
    }

    #[derive(Clone, Debug)]
    enum Order {
        Position(i64),
        Speed(f64),
    }

    fn order() -> impl Strategy<Value = Order> {
        let far = (-9.3f64..9.3).prop_map(|e| Order::Position((10f64.powf(e.abs()).copysign(e)) as i64));
        prop_oneof![far, (-1.0..1.0f64).prop_map(Order::Speed), Just(Order::Speed(0.0))]
    }

    fn follow(from: Motion, order: &Order, limits: &Limits) -> Path {
        match order {
            Order::Position(target) => Path::to_position(from, *target, limits),
            Order::Speed(share) => Path::to_speed(from, share * limits.speed, limits),
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]

        #[test]
        fn rest_to_rest_takes_the_shortest_time(limits in limits(), exponent in 0.0..9.3f64, up: bool, start in -1_000_000i64..1_000_000) {
            // At most a million seconds.
            let distance = 10f64.powf(exponent).min(limits.speed * 1e6) as i64;
            let target = if up { start + distance } else { start - distance };
            let path = Path::to_position(Motion::rest(start), target, &limits);
            check(&path, &limits)?;
            let ideal_s = ideal_s(distance as f64, &limits);
            // The root is found to 1e-9 steps, of at least one; time grows at most with the distance.
            prop_assert!((path.duration_s() / ideal_s - 1.0).abs() < 1e-8, "{} s, ideal {ideal_s} s", path.duration_s());
            prop_assert_eq!(path.at(path.duration_s()), Motion::rest(target));
        }

        /// From any state within the limits, also after its acceleration has been removed, the path equals Ruckig's at
        /// every moment.
        #[test]
        fn paths_to_rest_are_ruckigs(
            speed_exponent in 1.0..5.0f64, acceleration_s in 0.01..2.0f64, jerk_s in 1e-3..1.0f64, exponent in 0.0..7.0f64,
            up: bool, start in prop_oneof![Just((0.0, 0.0)), (-1.0..1.0f64, -1.0..1.0f64)],
        ) {
            let speed = 10f64.powf(speed_exponent);
            let acceleration = speed / acceleration_s;
            let limits = Limits { speed, acceleration, jerk: acceleration / jerk_s };
            // At most a thousand seconds.
            let distance = 10f64.powf(exponent).min(speed * 1e3).round();
            let target = if up { distance } else { -distance };
            let most = (acceleration * acceleration).min(limits.jerk * speed).sqrt();
            let acceleration = start.1 * most;
            let speed = start.0 * (speed - acceleration * acceleration / (2.0 * limits.jerk));
            let from = Motion { position: Position::at_step(0), speed, acceleration };
            let path = Path::to_position(from, target as i64, &limits);
            let ruckig = Ruckig::to_rest([0.0, speed, acceleration], target, &limits);
            let far = distance + limits.speed * (acceleration_s + jerk_s);
            // Ruckig accepts paths that end within 1e-8 of the target's position, speed and acceleration, in any unit.
            let tolerance_s = 1e-8 * ruckig.duration_s + 1e-8 / limits.speed + 1e-8 / limits.acceleration;
            let duration_s = path.duration_s();
            prop_assert!((duration_s - ruckig.duration_s).abs() <= tolerance_s, "{duration_s} s, Ruckig {} s", ruckig.duration_s);
            prop_assert_eq!(path.at(duration_s), Motion::rest(target as i64));
            for share in 0..=20 {
                let time_s = f64::from(share) / 20.0 * duration_s;
                let [position, speed, acceleration] = ruckig.at(time_s);
                let at = path.at(time_s);
                prop_assert!((-at.position.distance_to(0) - position).abs() <= 1e-7 * far, "{at:?} {position}");
                prop_assert!((at.speed - speed).abs() <= 1e-6 * limits.speed, "{at:?} {speed}");
                prop_assert!((at.acceleration - acceleration).abs() <= 1e-4 * limits.acceleration, "{at:?} {acceleration}");
            }
        }

        #[test]
        fn new_orders_at_any_moment_keep_all_limits(
            limits in limits(), orders in prop::collection::vec((order(), 0.0..1.2f64), 1..12),
        ) {
            let mut now = Motion::rest(0);
            for (order, share) in &orders {
                let path = follow(now, order, &limits);
                check(&path, &limits)?;
                let start = path.at(0.0);
                prop_assert!(between(now.position, start.position).abs() < 2e-6 && (now.speed - start.speed).abs() <= 1e-9 * limits.speed);
                let rest_s = path.duration_s();
                match order {
                    Order::Position(target) => {
                        prop_assert_eq!(path.at(rest_s), Motion::rest(*target));
                        // Never longer than stopping first and then moving.
                        let stop = Path::to_speed(now, 0.0, &limits);
                        let stopped = stop.at(stop.duration_s());
                        let way = stopped.position.distance_to(*target).abs();
                        let at_most_s = stop.duration_s() + ideal_s(way, &limits);
                        prop_assert!(rest_s <= at_most_s * (1.0 + 1e-6) + 1e-9, "{rest_s} s, stop and go {at_most_s} s");
                    }
                    Order::Speed(share) => prop_assert_eq!(path.at(rest_s).speed, share * limits.speed),
                }
                now = path.at(share * rest_s);
            }
        }

        #[test]
        fn the_same_order_again_changes_nothing(limits in limits(), exponent in 0.0..9.0f64, share in 0.0..1.0f64) {
            let target = 10f64.powf(exponent) as i64;
            let path = Path::to_position(Motion::rest(0), target, &limits);
            let time_s = share * path.duration_s();
            let again = Path::to_position(path.at(time_s), target, &limits);
            let left_s = path.duration_s() - time_s;
            // Time to correct an error of 1e-6 steps with the available jerk or acceleration.
            let correction_s = 4.0 * (1e-6 / limits.jerk).cbrt() + 2.0 * (1e-6 / limits.acceleration).sqrt();
            prop_assert!((again.duration_s() - left_s).abs() < 1e-7 * path.duration_s() + 4.0 * correction_s, "{} s, {left_s} s left", again.duration_s());
        }

        #[test]
        fn a_state_outside_the_limits_is_brought_inside(
            limits in limits(), speed in -3.0..3.0f64, acceleration in -3.0..3.0f64, order in order(),
        ) {
            let speed = speed * limits.speed;
            let acceleration = acceleration * limits.acceleration;
            let from = Motion { position: Position { steps: -7, fraction: 0.25 }, speed, acceleration };
            let path = follow(from, &order, &limits);
            let end = path.at(path.duration_s());
            match order {
                Order::Position(target) => prop_assert_eq!(end, Motion::rest(target)),
                Order::Speed(share) => prop_assert_eq!(end.speed, share * limits.speed),
            }
            let stray = if limits.jerk.is_finite() { acceleration * acceleration / limits.jerk } else { 0.0 };
            for piece in path.pieces() {
                prop_assert!(piece.start.speed.abs() <= (speed.abs() + stray).max(limits.speed) * (1.0 + 1e-9));
                prop_assert!(piece.start.acceleration.abs() <= acceleration.abs().max(limits.acceleration) * (1.0 + 1e-9));
            }
        }

        #[test]
        fn a_root_takes_few_steps(exponent in 1.0..4.0f64, share in -9.0..-1e-3f64) {
            let height = 10f64.powf(share);
            let calls = Cell::new(0);
            let function = |x: f64| { calls.set(calls.get() + 1); x.powf(exponent) - height };
            let x = root((0.0, -height), (1.0, 1.0 - height), function);
            prop_assert!((x.powf(exponent) - height).abs() <= 1e-9);
            // Bisection to 1e-9 and 2e-16 takes 30 to 52 evaluations.
            prop_assert!(calls.get() <= 40, "{} calls", calls.get());
        }
    }
}
