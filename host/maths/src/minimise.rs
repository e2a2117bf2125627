//! Minima within bounds of functions of a few numbers, which need not be smooth.

use std::cell::{Cell, RefCell};

use argmin::{
    core::{CostFunction, Error, IterState, Problem, Solver, State},
    solver::neldermead::NelderMead,
};
use argmin_math::{ArgminAdd, ArgminMul, ArgminSub};

/// Point within the bounds, with the function's value.
#[derive(Clone, Debug, PartialEq)]
pub struct Minimum {
    /// Coordinates of the point, within the bounds.
    pub at: Vec<f64>,
    /// Value of the function; infinite if it had no value anywhere.
    pub value: f64,
}

/// Limits of the effort of [`global`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Effort {
    /// Number of points that evolve; at least 4 are used, and 5 to 10 for each number are usual.
    pub points: usize,
    /// Number of generations of the points.
    pub generations: usize,
    /// Number of evaluations of the simplex that follows.
    pub simplex: usize,
}

/// Generator `splitmix64` (Steele, Lea, Flood, "Fast Splittable Pseudorandom Number Generators", OOPSLA 2014).
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Returns a random number in 0..1.
    fn share(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1u64 << 53) as f64
    }

    fn below(&mut self, end: usize) -> usize {
        ((self.share() * end as f64) as usize).min(end.saturating_sub(1))
    }
}

/// Finds the global minimum within bounds, by differential evolution, then [`nelder_mead`] from its best point,
/// restarted twice. The same seed gives the same result.
///
/// `bounds` are `(low, high)` of each number, in its unit. NaN as a value of `cost` counts as infinite. Without bounds
/// there is nothing to vary: `cost` is evaluated once.
///
/// # Source
/// Storn, Price, "Differential Evolution: A Simple and Efficient Heuristic for Global Optimization over Continuous Spaces",
/// Journal of Global Optimization 11, 1997: 1/bin, from the best or any point, with a scale sampled for each.
///
/// ```
/// use r4_maths::minimise::{Effort, global};
/// // Rastrigin's function has 121 local minima within these bounds.
/// let hollows = |at: &[f64]| at.iter().map(|x| x * x + 10.0 - 10.0 * (std::f64::consts::TAU * x).cos()).sum();
/// let effort = Effort { points: 30, generations: 100, simplex: 600 };
/// assert!(global(&[(-5.12, 5.12); 2], effort, 1, hollows).value < 1e-6);
/// ```
pub fn global(bounds: &[(f64, f64)], effort: Effort, seed: u64, cost: impl Fn(&[f64]) -> f64) -> Minimum {
    let cost = |at: &[f64]| finite(cost(at));
    if bounds.is_empty() {
        return Minimum { at: Vec::new(), value: cost(&[]) };
    }
    let mut random = Random(seed);
    let points = effort.points.max(4);
    let mut crowd: Vec<Minimum> = (0..points)
        .map(|_| {
            let at: Vec<f64> = bounds.iter().map(|(low, high)| low + (high - low) * random.share()).collect();
            Minimum { value: cost(&at), at }
        })
        .collect();
    for _ in 0..effort.generations {
        for point in 0..points {
            let best = best_of(&crowd);
            let (one, other) = (random.below(points), random.below(points));
            let scale = 0.4 + 0.5 * random.share();
            let kept = random.below(bounds.len());
            // From the best point alone the population would converge too early.
            let base = if random.share() < 0.3 { best } else { random.below(points) };
            let mut at = crowd[point].at.clone();
            for (number, &(low, high)) in bounds.iter().enumerate() {
                if number == kept || random.share() < 0.8 {
                    let step = scale * (crowd[one].at[number] - crowd[other].at[number]);
                    let moved = crowd[base].at[number] + step;
                    at[number] =
                        if (low..=high).contains(&moved) { moved } else { low + (high - low) * random.share() };
                }
            }
            let value = cost(&at);
            if value <= crowd[point].value {
                crowd[point] = Minimum { at, value };
            }
        }
    }
    let mut found = crowd.swap_remove(best_of(&crowd));
    // A simplex can collapse before it reaches the minimum; a fresh one from the same point continues.
    for _ in 0..3 {
        found = nelder_mead(bounds, &found.at, effort.simplex / 3, cost);
    }
    found
}

/// Finds a local minimum within bounds from a starting point, by a simplex, with at most about `evaluations` of `cost`:
/// a shrink of the simplex is completed.
///
/// The first simplex spans 5 % of the bounds. Points outside are moved to the bound. NaN as a value of `cost` counts as
/// infinite. Ends early when the costs of all vertices are equal.
///
/// # Source
/// Nelder, Mead, "A Simplex Method for Function Minimization", The Computer Journal 7, 1965, by the crate `argmin`.
///
/// ```
/// let bowl = |at: &[f64]| (at[0] - 2.0).powi(2) + (at[1] + 1.0).powi(2);
/// let found = r4_maths::minimise::nelder_mead(&[(-5.0, 5.0), (0.0, 5.0)], &[4.0, 4.0], 500, bowl);
/// // The second number would go to -1, beyond its bound.
/// assert!((found.at[0] - 2.0).abs() < 1e-6 && found.at[1] == 0.0);
/// ```
pub fn nelder_mead(bounds: &[(f64, f64)], from: &[f64], evaluations: usize, cost: impl Fn(&[f64]) -> f64) -> Minimum {
    let bounded = Bounded { bounds, cost: |at: &[f64]| finite(cost(at)), spent: Cell::new(0) };
    let start = bounded.at(from.to_vec());
    let found = if bounds.is_empty() { None } else { bounded.follow(&start.at, evaluations) };
    found.filter(|found| found.value <= start.value).unwrap_or(start)
}

fn finite(value: f64) -> f64 {
    if value.is_nan() { f64::INFINITY } else { value }
}

fn best_of(crowd: &[Minimum]) -> usize {
    let better = |a: &usize, b: &usize| crowd[*a].value.total_cmp(&crowd[*b].value);
    (0..crowd.len()).min_by(better).unwrap_or(0)
}

/// Vertex of a simplex. The solver evaluates each one before it keeps it, and that is when it is moved into the bounds.
/// If only the evaluated point were moved, the simplex would continue outside.
#[derive(Clone)]
struct Corner(RefCell<Vec<f64>>);

impl Corner {
    fn each(&self, other: &Self, combine: fn(f64, f64) -> f64) -> Self {
        Self(RefCell::new(self.0.borrow().iter().zip(&*other.0.borrow()).map(|(a, b)| combine(*a, *b)).collect()))
    }
}

impl ArgminAdd<Self, Self> for Corner {
    fn add(&self, other: &Self) -> Self {
        self.each(other, |a, b| a + b)
    }
}

impl ArgminSub<Self, Self> for Corner {
    fn sub(&self, other: &Self) -> Self {
        self.each(other, |a, b| a - b)
    }
}

impl ArgminMul<f64, Self> for Corner {
    fn mul(&self, factor: &f64) -> Self {
        Self(RefCell::new(self.0.borrow().iter().map(|value| value * factor).collect()))
    }
}

struct Bounded<'b, F> {
    bounds: &'b [(f64, f64)],
    cost: F,
    spent: Cell<usize>,
}

impl<F: Fn(&[f64]) -> f64> Bounded<'_, F> {
    fn at(&self, mut at: Vec<f64>) -> Minimum {
        self.clamp(&mut at);
        self.spent.set(self.spent.get() + 1);
        Minimum { value: (self.cost)(&at), at }
    }

    fn clamp(&self, at: &mut [f64]) {
        // Not `clamp`, which panics when bounds are swapped: such bounds have one point, the higher one.
        at.iter_mut().zip(self.bounds).for_each(|(value, (low, high))| *value = value.min(*high).max(*low));
    }

    /// Runs the simplex from `start`; `None` if the solver gives up, which it does not for costs that are numbers.
    fn follow(&self, start: &[f64], evaluations: usize) -> Option<Minimum> {
        let mut corners = vec![Corner(RefCell::new(start.to_vec()))];
        for (number, &(low, high)) in self.bounds.iter().enumerate() {
            let mut at = start.to_vec();
            let step = 0.05 * (high - low);
            at[number] += if at[number] + step <= high { step } else { -step };
            corners.push(Corner(RefCell::new(at)));
        }
        step(self, corners, || self.spent.get() < evaluations)
    }
}

/// Runs the solver step by step: argmin's own executor would count iterations, not evaluations.
fn step<O>(function: O, corners: Vec<Corner>, goes_on: impl Fn() -> bool) -> Option<Minimum>
where
    O: CostFunction<Param = Corner, Output = f64>,
{
    // Below any standard deviation but 0: which difference of costs matters is not known here.
    let mut solver = NelderMead::new(corners).with_sd_tolerance(f64::MIN_POSITIVE).ok()?;
    let mut problem = Problem::new(function);
    let (mut state, _) = solver.init(&mut problem, IterState::new()).ok()?;
    while goes_on() && !Solver::<O, _>::terminate(&mut solver, &state).terminated() {
        (state, _) = solver.next_iter(&mut problem, state).ok()?;
    }
    Some(Minimum { value: state.get_cost(), at: state.take_param()?.0.into_inner() })
}

impl<F: Fn(&[f64]) -> f64> CostFunction for &Bounded<'_, F> {
    type Param = Corner;
    type Output = f64;

    fn cost(&self, corner: &Corner) -> Result<f64, Error> {
        self.spent.set(self.spent.get() + 1);
        let mut at = corner.0.borrow_mut();
        self.clamp(&mut at);
        Ok((self.cost)(&at))
    }
}
