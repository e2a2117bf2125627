//! Preparation of series for drawing: gaps, steps, decimation, clipping and axis ticks.

/// Time, s, and value. A value that is not finite is a gap in the line.
pub(super) type Point = (f64, f64);

/// Most points drawn per line: two to three per pixel of a wide screen.
const MOST_POINTS: usize = 2_000;

/// Inserts a gap where samples are missing: a pause of more than five median periods and 2 % of the run.
pub(super) fn with_gaps(points: &[Point]) -> Vec<Point> {
    let mut periods: Vec<f64> = points.windows(2).map(|pair| pair[1].0 - pair[0].0).collect();
    periods.sort_by(f64::total_cmp);
    // The median ignores the gaps themselves.
    let usual_s = periods.get(periods.len() / 2).copied().unwrap_or_default();
    let run_s = points.last().map_or(0.0, |last| last.0) - points.first().map_or(0.0, |first| first.0);
    let longest_s = (5.0 * usual_s).max(0.02 * run_s);
    let mut drawn = Vec::with_capacity(points.len());
    for (index, &point) in points.iter().enumerate() {
        if index > 0 && point.0 - points[index - 1].0 > longest_s {
            drawn.push((points[index - 1].0, f64::NAN));
        }
        drawn.push(point);
    }
    drawn
}

/// Removes the middle of three equal values in a row.
pub(super) fn without_repeats(points: &[Point]) -> Vec<Point> {
    let same = |a: f64, b: f64| a == b || (!a.is_finite() && !b.is_finite());
    let mut kept: Vec<Point> = Vec::new();
    for &point in points {
        match kept.as_mut_slice() {
            [.., before, last] if same(before.1, last.1) && same(last.1, point.1) => *last = point,
            _ => kept.push(point),
        }
    }
    kept
}

/// Holds each value until the next sample, as a board holds its set point.
pub(super) fn as_steps(points: &[Point]) -> Vec<Point> {
    let mut steps: Vec<Point> = Vec::with_capacity(2 * points.len());
    for &point in points {
        if let Some(&(_, before)) = steps.last()
            && before.is_finite()
            && before != point.1
        {
            steps.push((point.0, before));
        }
        steps.push(point);
    }
    steps
}

/// Decimates to at most [`MOST_POINTS`] points that look the same: first, lowest, highest and last of equal spans of
/// time, and the gap at the end of a span.
pub(super) fn decimated(points: &[Point]) -> Vec<Point> {
    let (Some(first), Some(last)) = (points.first(), points.last()) else { return Vec::new() };
    if points.len() <= MOST_POINTS {
        return points.to_vec();
    }
    // Five points at most per span: four extremes and a gap.
    let buckets = MOST_POINTS / 5;
    let per_second = buckets as f64 / (last.0 - first.0).max(f64::MIN_POSITIVE);
    let bucket_of = |point: &Point| (((point.0 - first.0) * per_second) as usize).min(buckets - 1);
    let mut kept = Vec::with_capacity(MOST_POINTS);
    for bucket in points.chunk_by(|a, b| bucket_of(a) == bucket_of(b)) {
        let finite = || bucket.iter().enumerate().filter(|(_, point)| point.1.is_finite());
        let by_value = |a: &(usize, &Point), b: &(usize, &Point)| a.1.1.total_cmp(&b.1.1);
        let Some((start, _)) = finite().next() else {
            kept.push(bucket[0]);
            continue;
        };
        let of = |found: Option<(usize, &Point)>| found.map_or(start, |(index, _)| index);
        let mut indices =
            [start, of(finite().min_by(by_value)), of(finite().max_by(by_value)), of(finite().next_back())];
        indices.sort_unstable();
        for (place, &index) in indices.iter().enumerate() {
            if place == 0 || index != indices[place - 1] {
                kept.push(bucket[index]);
            }
        }
        kept.extend(bucket.last().filter(|point| !point.1.is_finite()));
    }
    kept
}

/// Parts of the line within `low..=high`, cut exactly at the limits.
pub(super) fn clipped(points: &[Point], (low, high): (f64, f64)) -> Vec<Vec<Point>> {
    let mut parts: Vec<Vec<Point>> = Vec::new();
    let mut part: Vec<Point> = Vec::new();
    let mut before: Option<Point> = None;
    for &point in points {
        if !point.1.is_finite() {
            parts.push(std::mem::take(&mut part));
            before = None;
            continue;
        }
        if let Some(from) = before {
            let at = |value: f64| {
                let share = (value - from.1) / (point.1 - from.1);
                (share, (from.0 + share * (point.0 - from.0), value))
            };
            // A segment crosses each limit at most once; sort the crossings along the segment.
            let mut crossings: Vec<_> = [low, high]
                .into_iter()
                .filter(|limit| (from.1 < *limit) != (point.1 < *limit) && from.1 != *limit && point.1 != *limit)
                .map(at)
                .collect();
            crossings.sort_by(|a, b| a.0.total_cmp(&b.0));
            for (_, crossing) in crossings {
                let inside = !part.is_empty();
                part.push(crossing);
                if inside {
                    parts.push(std::mem::take(&mut part));
                }
            }
        }
        if (low..=high).contains(&point.1) {
            part.push(point);
        } else if !part.is_empty() {
            parts.push(std::mem::take(&mut part));
        }
        before = Some(point);
    }
    parts.push(part);
    parts.retain(|part| part.len() > 1);
    parts
}

/// Lowest and highest finite value; `None` without any.
pub(super) fn extent(values: impl Iterator<Item = f64>) -> Option<(f64, f64)> {
    values.filter(|value| value.is_finite()).fold(None, |extent, value| {
        let (low, high) = extent.unwrap_or((value, value));
        Some((value.min(low), value.max(high)))
    })
}

/// Range widened to at least `span`, with a margin so that no line runs along the frame.
pub(super) fn framed((low, high): (f64, f64), span: f64) -> (f64, f64) {
    let half = ((high - low) / 2.0).max(span / 2.0) * 1.08;
    let middle = low + (high - low) / 2.0;
    (middle - half, middle + half)
}

/// About `count` round numbers within `low..=high`, and the decimals to write them.
pub(super) fn ticks(low: f64, high: f64, count: u32) -> (Vec<f64>, usize) {
    let least = (high - low) / f64::from(count.max(1));
    if !(least.is_finite() && least > 0.0) {
        return (vec![low], 0);
    }
    let decade = 10_f64.powf(least.log10().floor());
    // 0.999 accepts a round step that rounding made slightly too small.
    let step = [1.0, 2.0, 5.0].map(|factor| factor * decade).into_iter().find(|step| *step >= 0.999 * least);
    let step = step.unwrap_or(10.0 * decade);
    let (first, last) = ((low / step - 1e-9).ceil(), (high / step + 1e-9).floor());
    let mut ticks = Vec::new();
    let mut multiple = first;
    // Adding 0.0 turns a negative zero into zero.
    while multiple <= last && ticks.len() < 100 {
        ticks.push(multiple * step + 0.0);
        multiple += 1.0;
    }
    (ticks, (-(step * 1.000_001).log10().floor()).clamp(0.0, 9.0) as usize)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn decimation_keeps_every_extreme_and_the_ends() {
        let mut points: Vec<Point> = (0..100_000).map(|i| (f64::from(i) * 1e-3, (f64::from(i) * 0.01).sin())).collect();
        points[31_234].1 = 7.0;
        points[77_777].1 = -9.0;
        let drawn = decimated(&points);
        assert!(drawn.len() <= MOST_POINTS, "{}", drawn.len());
        assert!(drawn.contains(&points[31_234]) && drawn.contains(&points[77_777]));
        assert_eq!((drawn.first(), drawn.last()), (points.first(), points.last()));
        assert!(drawn.windows(2).all(|pair| pair[0].0 < pair[1].0), "in order of time, none twice");
        assert_eq!(decimated(&drawn), drawn, "few enough is left alone");
    }

    #[test]
    fn a_gap_survives_decimation() {
        let points: Vec<Point> =
            (0..10_000).map(|i| (f64::from(i), if (3_000..4_000).contains(&i) { f64::NAN } else { 1.0 })).collect();
        assert_eq!(clipped(&decimated(&points), (0.0, 2.0)).len(), 2);
        for samples in [1_000, 10_000] {
            let missing = samples / 10 * 3..samples / 10 * 4;
            let points: Vec<Point> =
                (0..samples).filter(|i| !missing.contains(i)).map(|i| (f64::from(i), 1.0)).collect();
            assert_eq!(clipped(&decimated(&with_gaps(&points)), (0.0, 2.0)).len(), 2);
        }
    }

    #[test]
    fn a_line_is_cut_at_the_limits() {
        let points = [(0.0, 0.0), (1.0, 4.0), (2.0, 0.0), (3.0, -4.0)];
        let parts = clipped(&points, (-2.0, 2.0));
        assert_eq!(parts, [vec![(0.0, 0.0), (0.5, 2.0)], vec![(1.5, 2.0), (2.0, 0.0), (2.5, -2.0)]]);
        let through = clipped(&[(0.0, -4.0), (1.0, 4.0)], (-2.0, 2.0));
        assert_eq!(through, [vec![(0.25, -2.0), (0.75, 2.0)]]);
        assert_eq!(clipped(&[(0.0, 9.0), (1.0, 8.0)], (-2.0, 2.0)), Vec::<Vec<Point>>::new());
        let touching = clipped(&[(0.0, 0.0), (1.0, 2.0), (2.0, 5.0), (3.0, 2.0), (4.0, 0.0)], (-2.0, 2.0));
        assert_eq!(touching, [vec![(0.0, 0.0), (1.0, 2.0)], vec![(3.0, 2.0), (4.0, 0.0)]]);
    }

    #[test]
    fn a_set_point_is_drawn_as_steps() {
        let points = [(0.0, 1.0), (1.0, 1.0), (2.0, 1.0), (3.0, 5.0), (4.0, f64::NAN), (5.0, 2.0)];
        let steps = as_steps(&without_repeats(&points));
        assert_eq!(steps[..4], [(0.0, 1.0), (2.0, 1.0), (3.0, 1.0), (3.0, 5.0)]);
        assert_eq!(steps[4], (4.0, 5.0), "held until the next sample");
        assert!(steps[5].1.is_nan() && steps[6] == (5.0, 2.0));
    }

    #[test]
    fn ticks_are_round() {
        assert_eq!(ticks(-0.31, 0.32, 5), (vec![-0.2, 0.0, 0.2], 1));
        assert_eq!(ticks(0.0, 10.0, 10), ((0..=10).map(f64::from).collect(), 0));
        assert_eq!(ticks(23.4, 24.6, 4), (vec![23.5, 24.0, 24.5], 1));
        assert_eq!(ticks(3.0, 3.0, 4), (vec![3.0], 0));
        assert_eq!(ticks(f64::NAN, 1.0, 4).0.len(), 1);
        assert_eq!(ticks(0.0, 0.004, 4), (vec![0.0, 0.001, 0.002, 0.003, 0.004], 3));
    }
}
