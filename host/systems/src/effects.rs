//! Search for the effect that a base model lacks, over recordings of independent runs.
//!
//! Each candidate is the base model with one additional effect, fitted to the recordings by nonlinear least squares.
//! Leave-one-run-out cross-validation chooses between the candidates. The best one is claimed when its cross-validated
//! error is below the base model's and the confidence interval of its size excludes its absence, with the size at least
//! [`Effect::least`] away from it. The last run is held out: it decides nothing, and the reported errors before and
//! after are those on this run.

use r4_maths::{
    least_squares::{Fit, FitError, newey_west_lag, nonlinear},
    statistics::{Interval, rmse},
};

use crate::Error;

/// Confidence level of the interval that must exclude the absence of an effect: with three candidates, three of a thousand clean
/// recordings claim one.
const CONFIDENCE: f64 = 0.999;

/// Factors of the guess from which a fit begins again, in this order, while none has converged: a model with creases can send the
/// iteration to and fro across one of them. Set on WHISKER's seed 230028. One fold of its base model did not converge from the guess itself,
/// nor from 5 % and 10 % below it; from 5 % and 10 % above it reached minima whose residual deviations differ by 1e-6 of themselves. Half of
/// these distances were not tried.
const RESTARTS: [f64; 4] = [1.05, 0.95, 1.1, 0.9];

/// An effect that a base model may lack.
#[derive(Clone, Copy, Debug)]
pub struct Effect {
    /// Name of the effect in reports.
    pub name: &'static str,
    /// Initial guess of the effect's parameters; the first is its size.
    pub start: &'static [f64],
    /// The size at which the effect is absent, in the size's unit.
    pub absent: f64,
    /// Smallest distance of the size from `absent` that is claimed. An effect that every base model ignores, such as
    /// the quantisation of an encoder, looks like a small effect whose interval excludes its absence. 0 where the
    /// interval alone decides.
    pub least: f64,
}

/// Predicted observations of one run: arguments are the effect's index (`None` for the base model), the parameters and
/// the run's index.
pub type Predict<'a> = dyn Fn(Option<usize>, &[f64], usize) -> Vec<f64> + 'a;

/// Inputs of a search for the missing effect: base model, candidates and recordings.
pub struct Search<'a> {
    /// Initial guess of the base model's parameters.
    pub base_start: &'a [f64],
    /// Candidate effects, of which at most one is claimed.
    pub effects: &'a [Effect],
    /// Observations of each run, of equal standard deviation; at least three runs, the last of which is held out.
    pub observed: &'a [Vec<f64>],
    /// Predicts the observations of a run by the base model, or with one effect added. The base model's parameters come
    /// first, then those of the effect.
    pub predict: &'a Predict<'a>,
}

/// An effect that the recordings show.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Found {
    /// Name of the effect, from [`Effect::name`].
    pub name: &'static str,
    /// Size of the effect: its first parameter, fitted to all runs but the held-out one.
    pub size: f64,
    /// 99.9 % confidence interval of the size, with residuals taken as autocorrelated (Newey-West).
    pub interval: Interval,
    /// RMSE of the held-out run with the base model, in the observations' unit.
    pub before: f64,
    /// RMSE of the held-out run with the effect, in the observations' unit.
    pub after: f64,
}

impl Search<'_> {
    /// Searches for the effect that the recordings show; `None` where they show none.
    ///
    /// An effect whose fit fails, on all runs or with one run held out for cross-validation, is no candidate.
    ///
    /// # Errors
    /// [`Error::Effects`] where there are fewer than three runs, or the base model cannot be fitted.
    pub fn run(&self) -> Result<Option<Found>, Error> {
        let runs = self.observed.len().saturating_sub(1);
        if runs < 2 {
            return Err(Error::Effects(format!(
                "a search needs three recordings, of which one is held out; {} given",
                runs + 1
            )));
        }
        let base = self.cross_validated(None).map_err(Error::Effects)?;
        let all: Vec<usize> = (0..runs).collect();
        let scored = (0..self.effects.len()).filter_map(|effect| {
            let error = self.cross_validated(Some(effect)).ok().filter(|error| *error < base)?;
            Some((effect, error, self.fit(Some(effect), &all).ok()?))
        });
        let Some((best, _, fit)) = scored.min_by(|a, b| a.1.total_cmp(&b.1)) else { return Ok(None) };
        let plain = self.fit(None, &all).map_err(Error::Effects)?;
        let observations = all.iter().map(|run| self.observed[*run].len()).sum();
        let fit = fit.autocorrelated(newey_west_lag(observations));
        let place = self.base_start.len();
        let size = fit.parameters[place];
        let Some(interval) = fit.intervals(CONFIDENCE)?.get(place).copied() else { return Ok(None) };
        let Effect { name, absent, least, .. } = self.effects[best];
        // Newey-West: residuals of a sampled trajectory are autocorrelated, and a plain interval would be too narrow.
        // A fit that the data do not determine has an interval without ends, which excludes nothing.
        if !(interval.low > absent || interval.high < absent) || (size - absent).abs() < least {
            return Ok(None);
        }
        let before = self.error(None, &plain, runs)?;
        let after = self.error(Some(best), &fit, runs)?;
        Ok(Some(Found { name, size, interval, before, after }))
    }

    /// Root mean square error over the held-out folds: each run is predicted by a fit to the others.
    fn cross_validated(&self, effect: Option<usize>) -> Result<f64, String> {
        let runs = self.observed.len() - 1;
        let mut squares = 0.0;
        for left_out in 0..runs {
            let others: Vec<usize> = (0..runs).filter(|run| *run != left_out).collect();
            let fit = self.fit(effect, &others)?;
            let error = self.error(effect, &fit, left_out).map_err(|error| error.to_string())?;
            squares += error * error;
        }
        Ok((squares / runs as f64).sqrt())
    }

    fn error(&self, effect: Option<usize>, fit: &Fit, run: usize) -> Result<f64, Error> {
        Ok(rmse(&self.observed[run], &(self.predict)(effect, fit.parameters.as_slice(), run))?)
    }

    fn fit(&self, effect: Option<usize>, runs: &[usize]) -> Result<Fit, String> {
        let start = [self.base_start, effect.map_or(&[][..], |effect| self.effects[effect].start)].concat();
        let residuals = |parameters: &[f64]| {
            let of = |run: &usize| {
                let predicted = (self.predict)(effect, parameters, *run);
                let observed = &self.observed[*run];
                // NaN makes the fit fail: a prediction that is too short must not score as a good one.
                (0..observed.len())
                    .map(|place| observed[place] - predicted.get(place).copied().unwrap_or(f64::NAN))
                    .collect::<Vec<_>>()
            };
            runs.iter().flat_map(of).collect()
        };
        let from = |factor: f64| nonlinear(&start.iter().map(|guess| guess * factor).collect::<Vec<_>>(), residuals);
        let fit = RESTARTS.iter().fold(from(1.0), |fit, factor| match fit {
            Err(FitError::NotConverged { .. }) => from(*factor),
            ended => ended,
        });
        let name = effect.map_or("the base model", |effect| self.effects[effect].name);
        fit.map_err(|why| format!("{name} cannot be fitted: {why}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Sampler;

    const LENGTH: usize = 120;
    const EFFECTS: [Effect; 3] = [
        Effect { name: "offset", start: &[0.1], absent: 0.0, least: 0.0 },
        Effect { name: "drift", start: &[0.1], absent: 0.0, least: 0.0 },
        Effect { name: "square", start: &[0.1], absent: 0.0, least: 0.0 },
    ];

    /// Model of the tests: a gain on a sine input, with the effect's term added when one is given.
    fn predict(effect: Option<usize>, parameters: &[f64], run: usize) -> Vec<f64> {
        let input = |place: usize| ((place as f64 * 0.17 + run as f64).sin(), place as f64 / LENGTH as f64);
        (0..LENGTH)
            .map(|place| {
                let (x, time) = input(place);
                parameters[0] * x + effect.map_or(0.0, |effect| parameters[1] * [1.0, time, x * x][effect])
            })
            .collect()
    }

    fn search(hidden: Option<usize>, seed: u64) -> Option<Found> {
        let mut noise = Sampler::new(seed, 0);
        let observed: Vec<Vec<f64>> = (0..4)
            .map(|run| predict(hidden, &[2.0, 0.3], run).into_iter().map(|y| y + noise.normal(0.1)).collect())
            .collect();
        let search = Search { base_start: &[1.0], effects: &EFFECTS, observed: &observed, predict: &predict };
        search.run().expect("a fit")
    }

    #[test]
    fn the_hidden_effect_is_named_with_its_size() {
        for (hidden, effect) in EFFECTS.iter().enumerate() {
            for seed in 1..=20 {
                let found = search(Some(hidden), seed).expect("an effect");
                assert_eq!(found.name, effect.name, "seed {seed}: {found:?}");
                assert!(found.interval.contains(0.3), "seed {seed}: {found:?}");
                // The noise is 0.1; of 120 samples its RMS is within 30 % in all but one of a million.
                assert!(found.after < found.before && (found.after / 0.1 - 1.0).abs() < 0.3, "{found:?}");
            }
        }
    }

    /// At 99.9 % three candidates claim something in at most three of a thousand: more than 4 of 200 has a probability of 4e-4.
    #[test]
    fn clean_recordings_show_nothing() {
        let claimed = (1..=200).filter(|seed| search(None, *seed).is_some()).count();
        assert!(claimed <= 4, "{claimed} of 200");
    }

    /// Both effects add the same term; the second has a parameter more, which changes nothing and cannot be fitted.
    #[test]
    fn an_effect_that_cannot_be_fitted_is_no_candidate() {
        let observed: Vec<Vec<f64>> = (0..4).map(|run| predict(Some(0), &[2.0, 0.3], run)).collect();
        let loose = Effect { name: "loose", start: &[0.1, 0.1], ..EFFECTS[0] };
        let search = |effects: &[Effect]| {
            let predict = |effect: Option<usize>, parameters: &[f64], run: usize| {
                predict(effect.map(|_| 0), &parameters[..parameters.len().min(2)], run)
            };
            Search { base_start: &[1.0], effects, observed: &observed, predict: &predict }.run().expect("a search")
        };
        assert_eq!(search(&[loose]), None);
        assert_eq!(search(&[loose, EFFECTS[0]]).map(|found| found.name), Some("offset"));
    }

    #[test]
    fn an_effect_below_its_least_size_is_not_claimed() {
        let observed: Vec<Vec<f64>> = (0..4).map(|run| predict(Some(0), &[2.0, 0.3], run)).collect();
        for (least, is_claimed) in [(0.29, true), (0.31, false)] {
            let effects = EFFECTS.map(|effect| Effect { least, ..effect });
            let search = Search { base_start: &[1.0], effects: &effects, observed: &observed, predict: &predict };
            assert_eq!(search.run().expect("a fit").is_some(), is_claimed, "{least}");
        }
    }

    #[test]
    fn two_recordings_are_too_few() {
        let observed = vec![vec![0.0; LENGTH]; 2];
        let search = Search { base_start: &[1.0], effects: &EFFECTS, observed: &observed, predict: &predict };
        assert!(search.run().is_err_and(|error| error.to_string().contains("three recordings")));
    }
}
