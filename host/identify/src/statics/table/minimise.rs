//! The least value of a function of a few numbers that need not be smooth: differential evolution, then a simplex.

/// Where a function is least, and how small it is there.
#[derive(Clone, Debug, PartialEq)]
pub struct Least {
    /// Within the bounds.
    pub at: Vec<f64>,
    /// The function there.
    pub value: f64,
}

/// How long to look.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Effort {
    /// Points that evolve.
    pub points: usize,
    /// How often each is tried anew.
    pub generations: usize,
    /// Evaluations of the simplex that follows.
    pub simplex: usize,
}

/// Numbers without correlation that matters here: `splitmix64` (Steele, Lea, Flood, "Fast splittable pseudorandom number
/// generators", OOPSLA 2014).
struct Numbers(u64);

impl Numbers {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// 0..1.
    fn share(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1u64 << 53) as f64
    }

    fn below(&mut self, end: usize) -> usize {
        ((self.share() * end as f64) as usize).min(end.saturating_sub(1))
    }
}

/// Looks everywhere between the bounds, then follows the slope from the best. The same seed gives the same answer.
///
/// Values of `cost` that are not numbers count as infinite. With no bounds there is nothing to vary.
///
/// # Source
/// Storn, Price, "Differential Evolution", J. Global Optimization 11, 1997 (1/bin from the best or any point, with
/// a scale drawn anew each time).
pub fn least(bounds: &[(f64, f64)], effort: Effort, seed: u64, cost: impl Fn(&[f64]) -> f64) -> Least {
    let cost = |at: &[f64]| finite(cost(at));
    if bounds.is_empty() {
        return Least { at: Vec::new(), value: cost(&[]) };
    }
    let mut numbers = Numbers(seed);
    let points = effort.points.max(4);
    let mut crowd: Vec<Least> = (0..points)
        .map(|_| {
            let at: Vec<f64> = bounds.iter().map(|(low, high)| low + (high - low) * numbers.share()).collect();
            Least { value: cost(&at), at }
        })
        .collect();
    for _ in 0..effort.generations {
        for point in 0..points {
            let best = best_of(&crowd);
            let (one, other) = (numbers.below(points), numbers.below(points));
            let scale = 0.4 + 0.5 * numbers.share();
            let kept = numbers.below(bounds.len());
            // From the best alone the crowd would gather too early.
            let base = if numbers.share() < 0.3 { best } else { numbers.below(points) };
            let mut at = crowd[point].at.clone();
            for (number, &(low, high)) in bounds.iter().enumerate() {
                if number == kept || numbers.share() < 0.8 {
                    let step = scale * (crowd[one].at[number] - crowd[other].at[number]);
                    let moved = crowd[base].at[number] + step;
                    at[number] =
                        if (low..=high).contains(&moved) { moved } else { low + (high - low) * numbers.share() };
                }
            }
            let value = cost(&at);
            if value <= crowd[point].value {
                crowd[point] = Least { at, value };
            }
        }
    }
    let best = crowd.swap_remove(best_of(&crowd));
    let mut found = best;
    // A simplex can collapse before it is there; a fresh one from where it stopped goes on.
    for _ in 0..3 {
        found = simplex(bounds, effort.simplex / 3, found, &cost);
    }
    found
}

/// Follows the slope from a point within the bounds, for `evaluations` of `cost`.
///
/// # Source
/// Nelder, Mead, "A simplex method for function minimization", Computer Journal 7, 1965; points outside are put on the bound.
pub fn descend(bounds: &[(f64, f64)], from: &[f64], evaluations: usize, cost: impl Fn(&[f64]) -> f64) -> Least {
    let cost = |at: &[f64]| finite(cost(at));
    let start = Least { at: from.to_vec(), value: cost(from) };
    if bounds.is_empty() { start } else { simplex(bounds, evaluations, start, &cost) }
}

fn finite(value: f64) -> f64 {
    if value.is_nan() { f64::INFINITY } else { value }
}

fn best_of(crowd: &[Least]) -> usize {
    let better = |a: &usize, b: &usize| crowd[*a].value.total_cmp(&crowd[*b].value);
    (0..crowd.len()).min_by(better).unwrap_or(0)
}

fn simplex(bounds: &[(f64, f64)], evaluations: usize, start: Least, cost: &impl Fn(&[f64]) -> f64) -> Least {
    let within = |at: Vec<f64>| -> Vec<f64> {
        at.into_iter().zip(bounds).map(|(value, &(low, high))| value.clamp(low, high)).collect()
    };
    let spent = std::cell::Cell::new(0);
    let look = |at: Vec<f64>| {
        spent.set(spent.get() + 1);
        let at = within(at);
        Least { value: cost(&at), at }
    };
    let mut corners = vec![start];
    for (number, &(low, high)) in bounds.iter().enumerate() {
        let mut at = corners[0].at.clone();
        let step = 0.05 * (high - low);
        at[number] += if at[number] + step <= high { step } else { -step };
        corners.push(look(at));
    }
    let last = bounds.len();
    while spent.get() < evaluations {
        corners.sort_by(|a, b| a.value.total_cmp(&b.value));
        let spread: f64 = bounds
            .iter()
            .enumerate()
            .map(|(number, (low, high))| (corners[last].at[number] - corners[0].at[number]).abs() / (high - low))
            .fold(0.0, f64::max);
        if spread < 1e-12 {
            break;
        }
        let middle: Vec<f64> = (0..last)
            .map(|number| corners[..last].iter().map(|corner| corner.at[number]).sum::<f64>() / last as f64)
            .collect();
        let towards = |factor: f64| -> Vec<f64> {
            middle.iter().zip(&corners[last].at).map(|(middle, worst)| middle + factor * (middle - worst)).collect()
        };
        let mirrored = look(towards(1.0));
        let next = if mirrored.value < corners[0].value {
            let further = look(towards(2.0));
            if further.value < mirrored.value { further } else { mirrored }
        } else if mirrored.value < corners[last - 1].value {
            mirrored
        } else {
            look(towards(if mirrored.value < corners[last].value { 0.5 } else { -0.5 }))
        };
        if next.value < corners[last].value {
            corners[last] = next;
        } else {
            let best = corners[0].at.clone();
            for corner in &mut corners[1..] {
                *corner = look(best.iter().zip(&corner.at).map(|(best, at)| f64::midpoint(*best, *at)).collect());
            }
        }
    }
    corners.swap_remove(best_of(&corners))
}

#[cfg(test)]
mod tests {
    use super::*;

    const EFFORT: Effort = Effort { points: 30, generations: 100, simplex: 600 };

    #[test]
    fn finds_the_end_of_a_bent_valley() {
        let rosenbrock = |at: &[f64]| (1.0 - at[0]).powi(2) + 100.0 * (at[1] - at[0] * at[0]).powi(2);
        let found = least(&[(-5.0, 5.0); 2], EFFORT, 1, rosenbrock);
        // The simplex ends at 1e-12 of the bounds; a quadratic bottom is flat to the root of that.
        assert!((found.at[0] - 1.0).abs() < 1e-5 && (found.at[1] - 1.0).abs() < 1e-5, "{found:?}");
    }

    #[test]
    fn is_not_caught_by_the_first_hollow() {
        // Rastrigin's function: 11² hollows in these bounds.
        let hollows = |at: &[f64]| at.iter().map(|x| x * x + 10.0 - 10.0 * (std::f64::consts::TAU * x).cos()).sum();
        for seed in 0..10 {
            assert!(least(&[(-5.12, 5.12); 2], EFFORT, seed, hollows).value < 1e-6, "{seed}");
        }
    }

    #[test]
    fn stays_within_the_bounds_and_is_repeatable() {
        let slope = |at: &[f64]| at[0] - at[1];
        let found = least(&[(2.0, 3.0), (-1.0, 4.0)], EFFORT, 7, slope);
        assert_eq!(found.at, [2.0, 4.0]);
        assert_eq!(found, least(&[(2.0, 3.0), (-1.0, 4.0)], EFFORT, 7, slope));
    }

    #[test]
    fn what_is_no_number_is_avoided_and_nothing_to_vary_is_looked_at_once() {
        let root = |at: &[f64]| if at[0] < 0.0 { f64::NAN } else { at[0] };
        assert!(least(&[(-1.0, 1.0)], EFFORT, 3, root).value < 1e-9);
        assert_eq!(least(&[], EFFORT, 3, |_| 5.0), Least { at: vec![], value: 5.0 });
    }

    #[test]
    fn descends_from_where_it_is_put() {
        let found =
            descend(&[(-10.0, 10.0); 3], &[5.0, -5.0, 1.0], 2000, |at| at.iter().map(|x| (x - 2.0).powi(2)).sum());
        assert!(found.value < 1e-12, "{found:?}");
    }
}
