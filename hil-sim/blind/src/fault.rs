//! Logging faults, added to recordings after the simulation: an identifier has to detect or tolerate them.
//!
//! [`Timing`] leaves a recording usable: stamps that are a little off. [`Broken`] makes it useless. Both change every
//! recording of an experiment, for the fit and held out, and are sampled from a seed. Outputs at other times are
//! simulated again, not interpolated; each row keeps its noise.

use std::fmt;

use crate::{
    Draw, Value,
    dice::Dice,
    excitation::RATE_HZ,
    experiment::{self, Experiment, Length, Recording, Setup},
    watch::{Output, Plan, noise},
};

/// Streams of [`Dice`] that no other module uses with the same seed.
const TIMING: u64 = 8;
const BROKEN: u64 = 9;

/// Largest error of one stamp, in sample periods: below a half, so that stamps ascend.
const MOST_JITTER: f64 = 0.45;

/// Sampling times of the output relative to their stamps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Timing {
    /// Samples are taken at their stamps.
    True,
    /// Samples are taken `periods` sample periods after the stamps; before them if negative.
    Shift {
        /// Shift in periods of 5 ms; positive if a sample was taken after its stamp.
        periods: f64,
    },
    /// Samples are taken at random times about their stamps; the input changes at its stamps.
    SampleJitter {
        /// Standard deviation in sample periods; no sample is more than 0.45 periods off.
        deviation: f64,
    },
    /// Input and output are sampled evenly, but the stamps of both are random about the true times.
    StampJitter {
        /// Standard deviation in sample periods; no stamp is more than 0.45 periods off.
        deviation: f64,
    },
    /// Samples are taken at `1 + drift` times the stamp: the output's clock is slow if this is positive.
    SlowClock {
        /// Relative error of the clock, as a plain number.
        drift: f64,
    },
}

/// Kind of timing fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum TimingKind {
    /// Shift by one sample period, early or late.
    WholeShift,
    /// Shift by 0.2 to 1.5 sample periods, early or late.
    Shift,
    /// [`Timing::SampleJitter`] of 5 to 30 % of a period.
    SampleJitter,
    /// [`Timing::StampJitter`] of 5 to 30 % of a period.
    StampJitter,
    /// [`Timing::SlowClock`] by 2e-4 to 1e-3, slow or fast.
    SlowClock,
}

impl TimingKind {
    /// All kinds of timing fault.
    pub const ALL: [Self; 5] = [Self::WholeShift, Self::Shift, Self::SampleJitter, Self::StampJitter, Self::SlowClock];

    /// Returns a fault of this kind, its size sampled from the seed.
    #[must_use]
    pub fn sample(self, seed: u64) -> Timing {
        let mut dice = Dice::new(seed, TIMING);
        match self {
            Self::WholeShift => Timing::Shift { periods: dice.sign() },
            Self::Shift => Timing::Shift { periods: dice.sign() * dice.between(0.2, 1.5) },
            Self::SampleJitter => Timing::SampleJitter { deviation: dice.between(0.05, 0.3) },
            Self::StampJitter => Timing::StampJitter { deviation: dice.between(0.05, 0.3) },
            Self::SlowClock => Timing::SlowClock { drift: dice.sign() * dice.ratio_between(2e-4, 1e-3) },
        }
    }
}

impl fmt::Display for Timing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::True => f.write_str("true stamps"),
            Self::Shift { periods } => write!(f, "output {periods:+.2} periods after its stamps"),
            Self::SampleJitter { deviation } => write!(f, "samples off by {deviation:.2} periods RMS"),
            Self::StampJitter { deviation } => write!(f, "stamps off by {deviation:.2} periods RMS"),
            Self::SlowClock { drift } => write!(f, "output's clock slow by {drift:+.1e}"),
        }
    }
}

impl Timing {
    /// Applies this fault to every recording of an experiment. The jitter of each row is sampled from the seed.
    ///
    /// The recordings must be unmodified: the plant is simulated again from [`Recording::start`] and
    /// [`Recording::input`].
    pub fn apply(self, experiment: &mut Experiment, seed: u64) {
        let mut dice = Dice::new(seed, TIMING);
        let Experiment { setup, train, holdout, hidden, input_per_duty, supply_v, .. } = experiment;
        for run in train.iter_mut().chain(holdout) {
            let rows = run.time_s.len();
            let mut jitter = |deviation: f64| -> Vec<f64> {
                (0..rows).map(|_| (deviation * dice.normal()).clamp(-MOST_JITTER, MOST_JITTER)).collect()
            };
            let stamps = (0..rows).map(|row| row as f64);
            let taken: Vec<f64> = match self {
                Self::True => continue,
                Self::Shift { periods } => stamps.map(|stamp| stamp + periods).collect(),
                Self::SampleJitter { deviation } => {
                    stamps.zip(jitter(deviation)).map(|(stamp, off)| stamp + off).collect()
                }
                Self::SlowClock { drift } => stamps.map(|stamp| stamp * (1.0 + drift)).collect(),
                Self::StampJitter { deviation } => {
                    // The first stamp stays, since it defines time 0.
                    let off = jitter(deviation).into_iter().skip(1);
                    run.time_s.iter_mut().skip(1).zip(off).for_each(|(time_s, off)| *time_s += off / RATE_HZ);
                    continue;
                }
            };
            let plan = plan(run, *input_per_duty);
            let clean = hidden.parts.outputs_at(&plan, *supply_v, setup.output_kind(), taken.into_iter());
            let zero = setup.zero(run.start);
            for ((output, before), after) in run.output.iter_mut().zip(&mut run.clean).zip(clean) {
                let noise = *output - *before;
                *before = after - zero;
                *output = *before + noise;
            }
        }
    }
}

/// Fault that makes recordings useless.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Broken {
    /// Rows of all columns except the stamps are in reverse order.
    Reversed,
    /// Input and output are in each other's column.
    Swapped,
    /// Rows of the output are in random order.
    Shuffled,
    /// The output is in degrees, though its column's name says rad; a second sensor has its speed in rad/s.
    Degrees,
    /// The output saturates at limits inside its range, on one side or both.
    Saturated,
    /// Rows are lost in bursts, and the others stamped evenly, as by a logger that stamps by counting.
    Dropped,
    /// The output's column has another quantity: a temperature, or the motion of another plant.
    WrongColumn,
}

impl fmt::Display for Broken {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Reversed => "reversed",
            Self::Swapped => "swapped",
            Self::Shuffled => "shuffled",
            Self::Degrees => "degrees",
            Self::Saturated => "saturated",
            Self::Dropped => "dropped",
            Self::WrongColumn => "wrong column",
        })
    }
}

impl Broken {
    /// All faults that break a recording.
    pub const ALL: [Self; 7] = [
        Self::Reversed,
        Self::Swapped,
        Self::Shuffled,
        Self::Degrees,
        Self::Saturated,
        Self::Dropped,
        Self::WrongColumn,
    ];

    /// Returns true if recordings of a setup can have it: only an angle can be in degrees.
    #[must_use]
    pub fn suits(self, setup: Setup) -> bool {
        self != Self::Degrees || setup == Setup::MotorPosition
    }

    /// Applies this fault, sampled from the seed, to every recording of an experiment, and returns its parameters.
    /// `None`, and no change, if the setup does not suit.
    ///
    /// [`Recording::clean`] is then the output's column without noise; [`Experiment::noise`] is that of the column,
    /// except for [`Broken::Swapped`], whose column has none.
    pub fn apply(self, experiment: &mut Experiment, seed: u64) -> Option<Vec<Value>> {
        if !self.suits(experiment.setup) {
            return None;
        }
        let mut dice = Dice::new(seed, BROKEN);
        let dice = &mut dice;
        let mut numbers = Vec::new();
        match self {
            Self::Reversed => runs(experiment).for_each(|run| columns(run).for_each(|column| column.reverse())),
            Self::Swapped => runs(experiment).for_each(|run| {
                std::mem::swap(&mut run.input, &mut run.output);
                // The output's column now has the input, which has no noise.
                run.clean.clone_from(&run.output);
            }),
            Self::Shuffled => runs(experiment).for_each(|run| shuffle(run, dice)),
            Self::Degrees => degrees(experiment, dice),
            Self::Saturated => numbers = saturate(experiment, dice),
            Self::Dropped => numbers = drop_rows(experiment, dice),
            Self::WrongColumn if dice.share() < 0.5 => temperature(experiment, dice),
            Self::WrongColumn => numbers = another_plant(experiment, dice),
        }
        Some(numbers)
    }
}

fn runs(experiment: &mut Experiment) -> impl Iterator<Item = &mut Recording> {
    experiment.train.iter_mut().chain(&mut experiment.holdout)
}

/// All columns except the stamps.
fn columns(run: &mut Recording) -> impl Iterator<Item = &mut Vec<f64>> {
    [&mut run.input, &mut run.supply_v, &mut run.output, &mut run.speed, &mut run.clean].into_iter()
}

fn plan(run: &Recording, input_per_duty: f64) -> Plan {
    Plan { start: run.start, duty: run.input.iter().map(|input| input / input_per_duty).collect() }
}

/// Shuffles the output by the Fisher-Yates method.
fn shuffle(run: &mut Recording, dice: &mut Dice) {
    for last in (1..run.output.len()).rev() {
        let other = dice.below(last + 1);
        run.output.swap(last, other);
        run.clean.swap(last, other);
    }
}

fn degrees(experiment: &mut Experiment, dice: &mut Dice) {
    let Experiment { train, holdout, hidden, input_per_duty, supply_v, noise: output_noise, .. } = experiment;
    let speeds = |run: &Recording| hidden.parts.outputs(&plan(run, *input_per_duty), *supply_v, Output::Speed);
    // Noise 30 dB below the speed, like that of the output.
    let noise = noise(&train.iter().map(speeds).collect::<Vec<_>>());
    for run in train.iter_mut().chain(holdout) {
        run.speed = speeds(run).into_iter().map(|speed| speed + noise * dice.normal()).collect();
        run.output.iter_mut().chain(&mut run.clean).for_each(|angle| *angle = angle.to_degrees());
    }
    *output_noise = output_noise.to_degrees();
}

fn saturate(experiment: &mut Experiment, dice: &mut Dice) -> Vec<Value> {
    // One sensor: the limits are the same for all runs, and at least one run for the fit reaches them.
    let outputs = || experiment.train.iter().flat_map(|run| &run.output).copied();
    let (least, most) = (outputs().fold(f64::INFINITY, f64::min), outputs().fold(f64::NEG_INFINITY, f64::max));
    let lost = (1.0 - dice.between(0.5, 0.7)) * (most - least);
    let (below, above) = match dice.below(3) {
        0 => (0.5 * lost, 0.5 * lost),
        1 => (lost, 0.0),
        _ => (0.0, lost),
    };
    // A side on which nothing is lost has no limit, whatever the held-out runs do.
    let low = if below > 0.0 { least + below } else { f64::NEG_INFINITY };
    let high = if above > 0.0 { most - above } else { f64::INFINITY };
    runs(experiment)
        .flat_map(|run| run.output.iter_mut().chain(&mut run.clean))
        .for_each(|value| *value = value.clamp(low, high));
    let unit = match experiment.setup {
        Setup::MotorPosition => "rad",
        Setup::MotorSpeed => "rad/s",
        Setup::AxisPosition => "m",
    };
    [("low", low), ("high", high)].into_iter().map(|(name, value)| Value { name, value, unit }).collect()
}

/// Rows of the shortest burst, and number of different lengths: 25 to 200 ms.
const BURST: [usize; 2] = [5, 36];

fn drop_rows(experiment: &mut Experiment, dice: &mut Dice) -> Vec<Value> {
    let share = dice.between(0.05, 0.15);
    for run in runs(experiment) {
        let rows = run.time_s.len();
        let mut left = (share * rows as f64) as usize;
        let mut is_kept = vec![true; rows];
        while left > 0 {
            let from = dice.below(rows);
            let burst = (BURST[0] + dice.below(BURST[1])).min(left);
            for kept in is_kept.iter_mut().skip(from).take(burst) {
                // Bursts may overlap: a row that is lost already does not count again.
                left -= usize::from(std::mem::replace(kept, false));
            }
        }
        for column in columns(run) {
            let mut kept = is_kept.iter();
            column.retain(|_| kept.next() == Some(&true));
        }
        // The stamps stay even, as if no row had been lost.
        run.time_s.truncate(run.output.len());
    }
    vec![Value { name: "share", value: share, unit: "1" }]
}

/// Room temperature, °C: mean at the start, standard deviation of its change per sample, and sensor noise.
const ROOM: f64 = 25.0;
const WALK: f64 = 0.02;
const THERMOMETER: f64 = 0.05;

fn temperature(experiment: &mut Experiment, dice: &mut Dice) {
    for run in runs(experiment) {
        let mut now = ROOM + dice.between(-3.0, 3.0);
        for (output, clean) in run.output.iter_mut().zip(&mut run.clean) {
            now += WALK * dice.normal();
            *clean = now;
            *output = now + THERMOMETER * dice.normal();
        }
    }
    experiment.noise = THERMOMETER;
}

fn another_plant(experiment: &mut Experiment, dice: &mut Dice) -> Vec<Value> {
    // Below 2^32, so that a report can hold the number exactly.
    let seed = (dice.share() * f64::from(u32::MAX)) as u64;
    let longest = experiment.train.iter().chain(&experiment.holdout).map(|run| run.time_s.len()).max().unwrap_or(0);
    let length = Length {
        train: experiment.train.len(),
        holdout: experiment.holdout.len(),
        // Half a sample more, so that rounding does not lose one.
        seconds: (longest as f64 + 0.5) / RATE_HZ,
    };
    let mut other = experiment::experiment(experiment.setup, Draw::Nothing, length, seed);
    for (run, mut other) in runs(experiment).zip(other.train.drain(..).chain(other.holdout.drain(..))) {
        other.output.truncate(run.time_s.len());
        other.clean.truncate(run.time_s.len());
        (run.output, run.clean) = (other.output, other.clean);
    }
    experiment.noise = other.noise;
    vec![Value { name: "other_seed", value: seed as f64, unit: "1" }]
}

#[cfg(test)]
mod tests {
    use r4_maths::statistics::RootMeanSquare;

    use super::*;

    const SHORT: Length = Length { train: 2, holdout: 1, seconds: 8.0 };

    fn made(setup: Setup) -> Experiment {
        experiment::experiment(setup, Draw::Nothing, SHORT, 21)
    }

    /// Each run before and after the fault.
    fn faulty(setup: Setup, fault: impl FnOnce(&mut Experiment)) -> Vec<(Recording, Recording)> {
        let before = made(setup);
        let mut after = before.clone();
        fault(&mut after);
        let runs = |made: Experiment| made.train.into_iter().chain(made.holdout);
        runs(before).zip(runs(after)).collect()
    }

    fn rms(values: impl Iterator<Item = f64>) -> f64 {
        values.collect::<RootMeanSquare>().value().unwrap()
    }

    #[test]
    fn a_shift_by_whole_samples_moves_the_column_and_keeps_the_noise() {
        for setup in Setup::ALL {
            for periods in [1.0, -1.0] {
                for (before, after) in faulty(setup, |made| Timing::Shift { periods }.apply(made, 3)) {
                    assert_eq!((&after.time_s, &after.input), (&before.time_s, &before.input));
                    let rows = before.clean.len();
                    for row in 1..rows - 1 {
                        let there = before.clean[if periods > 0.0 { row + 1 } else { row - 1 }];
                        // The axis is driven again by its force: rounding of 50 m.
                        assert!((after.clean[row] - there).abs() < 1e-9, "{setup:?} {periods} {row}");
                        let noise = [&before, &after].map(|run| run.output[row] - run.clean[row]);
                        assert!((noise[0] - noise[1]).abs() < 1e-12);
                    }
                    // Before the run the plant stands still.
                    assert!(periods > 0.0 || after.clean[0] == before.clean[0]);
                }
            }
        }
    }

    #[test]
    fn a_shift_by_half_a_sample_is_half_way_between_two() {
        for (before, after) in faulty(Setup::MotorPosition, |made| Timing::Shift { periods: -0.5 }.apply(made, 3)) {
            let bend = before.clean.windows(3).map(|at| (at[0] - 2.0 * at[1] + at[2]).abs()).fold(0.0, f64::max);
            for row in 1..before.clean.len() {
                let middle = 0.5 * (before.clean[row - 1] + before.clean[row]);
                // A chord deviates by an eighth of the curve's bend, twice that at the corner of its input.
                assert!((after.clean[row] - middle).abs() <= 0.25 * bend, "{row}");
            }
        }
    }

    #[test]
    fn jitter_of_samples_has_its_deviation_and_leaves_the_stamps() {
        let deviation = 0.2;
        for (before, after) in faulty(Setup::MotorPosition, |made| Timing::SampleJitter { deviation }.apply(made, 3)) {
            assert_eq!((&after.time_s, &after.input), (&before.time_s, &before.input));
            let fastest = before.clean.windows(2).map(|at| (at[1] - at[0]).abs()).fold(0.0, f64::max);
            let off = (1..before.clean.len() - 1).filter_map(|row| {
                let per_period = 0.5 * (before.clean[row + 1] - before.clean[row - 1]);
                (per_period.abs() > 0.3 * fastest).then(|| (after.clean[row] - before.clean[row]) / per_period)
            });
            let off: Vec<f64> = off.collect();
            // At least 1000 samples: their standard deviation is known to 2.3 %, and clipping the tails takes 5 %.
            let found = rms(off.iter().copied());
            assert!(off.len() > 300 && (found / deviation - 1.0).abs() < 0.15, "{found} of {}", off.len());
        }
    }

    #[test]
    fn jitter_of_stamps_has_its_deviation_and_leaves_the_columns() {
        for deviation in [0.05, 0.3] {
            for (before, after) in faulty(Setup::MotorPosition, |made| Timing::StampJitter { deviation }.apply(made, 3))
            {
                assert_eq!((&after.input, &after.output), (&before.input, &before.output));
                assert!(after.time_s[0] == 0.0 && after.time_s.windows(2).all(|at| at[0] < at[1]));
                let off = after.time_s.iter().zip(&before.time_s).map(|(after, before)| (after - before) * RATE_HZ);
                // With 1600 samples it is known to 1.8 %; clipping at 1.5 of its own takes 9 % of the largest.
                assert!((rms(off) / deviation - 0.95).abs() < 0.1);
            }
        }
    }

    #[test]
    fn a_slow_clock_falls_behind_by_its_share_of_the_time() {
        let drift = 1e-3;
        for (before, after) in faulty(Setup::MotorPosition, |made| Timing::SlowClock { drift }.apply(made, 3)) {
            assert_eq!((&after.time_s, &after.input), (&before.time_s, &before.input));
            let bend = before.clean.windows(3).map(|at| (at[0] - 2.0 * at[1] + at[2]).abs()).fold(0.0, f64::max);
            for row in (0..1500).step_by(50) {
                let at = row as f64 * (1.0 + drift);
                let (low, share) = (at as usize, at.fract());
                let chord = before.clean[low] * (1.0 - share) + before.clean[low + 1] * share;
                assert!((after.clean[row] - chord).abs() <= 0.25 * bend + 1e-12, "{row}");
            }
        }
    }

    #[test]
    fn timing_is_in_range_and_the_same_for_a_seed() {
        for kind in TimingKind::ALL {
            for seed in 0..50 {
                let timing = kind.sample(seed);
                assert_eq!(timing, kind.sample(seed));
                match timing {
                    Timing::Shift { periods } if kind == TimingKind::WholeShift => assert_eq!(periods.abs(), 1.0),
                    Timing::Shift { periods } => assert!((0.2..=1.5).contains(&periods.abs())),
                    Timing::SampleJitter { deviation } | Timing::StampJitter { deviation } => {
                        assert!((0.05..=0.3).contains(&deviation));
                    }
                    Timing::SlowClock { drift } => assert!((2e-4..=1e-3).contains(&drift.abs())),
                    Timing::True => panic!("no fault"),
                }
            }
        }
        let [one, again] =
            [0, 0].map(|_| faulty(Setup::MotorSpeed, |made| TimingKind::SampleJitter.sample(1).apply(made, 1)));
        assert_eq!(one, again);
        assert!(
            faulty(Setup::MotorSpeed, |made| Timing::True.apply(made, 1)).iter().all(|(before, after)| before == after)
        );
    }

    fn broken(setup: Setup, broken: Broken, seed: u64) -> (Vec<Value>, Vec<(Recording, Recording)>) {
        let mut numbers = None;
        let runs = faulty(setup, |made| numbers = broken.apply(made, seed));
        (numbers.unwrap(), runs)
    }

    fn sorted(values: &[f64]) -> Vec<f64> {
        let mut values = values.to_vec();
        values.sort_by(f64::total_cmp);
        values
    }

    #[test]
    fn whole_columns_are_reversed_swapped_or_shuffled() {
        for setup in Setup::ALL {
            for (before, after) in broken(setup, Broken::Reversed, 1).1 {
                assert_eq!(after.time_s, before.time_s);
                assert!(after.input.iter().eq(before.input.iter().rev()));
                assert!(after.output.iter().eq(before.output.iter().rev()));
            }
            for (before, after) in broken(setup, Broken::Swapped, 1).1 {
                assert_eq!((&after.input, &after.output), (&before.output, &before.input));
                assert_eq!((&after.clean, &after.time_s), (&before.input, &before.time_s));
            }
            for (before, after) in broken(setup, Broken::Shuffled, 1).1 {
                assert_eq!((&after.time_s, &after.input), (&before.time_s, &before.input));
                assert_eq!(sorted(&after.output), sorted(&before.output));
                let same = after.output.iter().zip(&before.output).filter(|(after, before)| after == before).count();
                assert!(same < 20, "{same} rows where they were");
            }
        }
    }

    #[test]
    fn degrees_have_a_speed_in_radians_beside_them() {
        let (_, runs) = broken(Setup::MotorPosition, Broken::Degrees, 1);
        for (before, after) in runs {
            assert!(after.output.iter().zip(&before.output).all(|(after, before)| *after == before.to_degrees()));
            let true_speed = |row: usize| 0.5 * (before.clean[row + 1] - before.clean[row - 1]) * RATE_HZ;
            let rows = 1..before.clean.len() - 1;
            let off = rms(rows.clone().map(|row| after.speed[row] - true_speed(row)));
            // Its noise is 30 dB below it, 3.2 %, and differences over 10 ms lag at steps.
            assert!((0.02..0.08).contains(&(off / rms(rows.map(true_speed)))), "{off}");
            let mut text = Vec::new();
            after.write_csv(Setup::MotorPosition, &mut text).unwrap();
            assert!(text.starts_with(b"time_s,duty,supply_v,theta_rad,speed_rad_s\n0,"));
        }
        let mut axis = made(Setup::AxisPosition);
        assert_eq!(Broken::Degrees.apply(&mut axis, 1), None);
        assert_eq!(axis.train, made(Setup::AxisPosition).train);
    }

    #[test]
    fn a_saturated_output_stands_at_its_limits() {
        let mut sides = [0; 2];
        for seed in 0..12 {
            let (numbers, runs) = broken(Setup::MotorSpeed, Broken::Saturated, seed);
            let [low, high] = [numbers[0].value, numbers[1].value];
            let of_train = || runs[..2].iter().flat_map(|(before, _)| &before.output).copied();
            let (least, most) =
                (of_train().fold(f64::INFINITY, f64::min), of_train().fold(f64::NEG_INFINITY, f64::max));
            let left = (high.min(most) - low.max(least)) / (most - least);
            assert!((0.5..=0.7 + 1e-9).contains(&left), "{left}");
            for (before, after) in &runs {
                assert!(
                    after.output.iter().zip(&before.output).all(|(after, before)| *after == before.clamp(low, high))
                );
            }
            let stands = |limit: f64| runs[..2].iter().any(|(_, after)| after.output.contains(&limit));
            for (side, limit) in sides.iter_mut().zip([low, high]) {
                *side += usize::from(limit.is_finite());
                assert_eq!(stands(limit), limit.is_finite());
            }
        }
        // Each of the 24 sides, two in each of 12 runs, has no limit with a probability of one third.
        assert!(sides.iter().all(|&side| side > 3 && side < 12) && sides.iter().sum::<usize>() > 12, "{sides:?}");
    }

    #[test]
    fn dropped_rows_are_in_bursts_and_the_stamps_do_not_show_it() {
        for seed in 0..6 {
            let (numbers, runs) = broken(Setup::MotorPosition, Broken::Dropped, seed);
            assert!((0.05..=0.15).contains(&numbers[0].value));
            for (before, after) in runs {
                let rows = after.time_s.len();
                assert_eq!(before.time_s.len() - rows, (numbers[0].value * 1600.0) as usize);
                assert_eq!(after.time_s, before.time_s[..rows]);
                assert_eq!([after.input.len(), after.supply_v.len(), after.clean.len()], [rows; 3]);
                // Rows are recognised by their noise.
                let was: Vec<usize> = after
                    .output
                    .iter()
                    .map(|output| before.output.iter().position(|other| other == output).unwrap())
                    .collect();
                assert!(was.windows(2).all(|at| at[0] < at[1]));
                let jumps = was.windows(2).filter(|at| at[1] > at[0] + 1).count();
                assert!((1..=(1600 - rows) / BURST[0]).contains(&jumps), "{jumps}");
            }
        }
    }

    #[test]
    fn a_wrong_column_follows_nothing_that_was_driven() {
        let mut kinds = [0; 2];
        for seed in 0..8 {
            let (numbers, runs) = broken(Setup::MotorPosition, Broken::WrongColumn, seed);
            kinds[numbers.len()] += 1;
            for (before, after) in &runs {
                assert_eq!((&after.time_s, &after.input), (&before.time_s, &before.input));
                assert_eq!([after.output.len(), after.clean.len()], [before.output.len(); 2]);
                if numbers.is_empty() {
                    // Four standard deviations of a walk of 8 s, and of its start.
                    assert!(after.output.iter().all(|celsius| (25.0 - celsius).abs() < 3.0 + 4.0 * 0.8 + 0.3));
                }
            }
            if let Some(other) = numbers.first() {
                let other = experiment::experiment(Setup::MotorPosition, Draw::Nothing, SHORT, other.value as u64);
                assert_eq!((&runs[0].1.output, &runs[2].1.output), (&other.train[0].output, &other.holdout[0].output));
            }
        }
        assert!(kinds.iter().all(|&kind| kind > 0), "{kinds:?}");
    }
}
