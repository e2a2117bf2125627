//! Excitation: the duties of a run that shows a plant's dynamics.

use crate::{dice::Dice, scale::Scale};

/// Sample rate of recordings, Hz.
pub(crate) const RATE_HZ: f64 = 200.0;

/// Kind of a stretch of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stretch {
    /// Steps in alternating directions, with rests.
    Steps,
    /// Sum of several sines.
    Multisine,
    /// Slow ramps up, down through zero, and back.
    Ramps,
    /// Steps in alternating directions without rests.
    Reversals,
}

const STRETCHES: [Stretch; 4] = [Stretch::Steps, Stretch::Multisine, Stretch::Ramps, Stretch::Reversals];

/// Duty for each sample of a run: stretches separated by rests. `number` is the number of the run: four successive runs
/// begin with different stretches.
pub(crate) fn run(dice: &mut Dice, scale: &Scale, number: usize, seconds: f64) -> Vec<f64> {
    let samples = (seconds * RATE_HZ) as usize;
    let mut shares = vec![0.0; (0.25 * RATE_HZ) as usize];
    let mut stretch = number;
    while shares.len() < samples {
        shares.extend(play(dice, scale, STRETCHES[stretch % STRETCHES.len()]));
        let rest_s = dice.between(0.15, 0.4);
        shares.extend(vec![0.0; (rest_s * RATE_HZ) as usize]);
        // One kind may be left out, so that the order varies.
        stretch += 1 + dice.below(2);
    }
    shares.truncate(samples);
    shares.into_iter().map(|share| duty(scale, share)).collect()
}

/// Duty for a share of the range that moves the plant.
fn duty(scale: &Scale, share: f64) -> f64 {
    if scale.threshold <= 0.0 {
        return share.clamp(-1.0, 1.0);
    }
    // Passes the dead zone quickly, as one would by hand.
    let over = scale.threshold * (share.abs() / 0.05).min(1.0);
    (over + (1.0 - scale.threshold) * share.abs()).min(1.0).copysign(share)
}

/// Samples a drive level, as a share.
fn level(dice: &mut Dice) -> f64 {
    dice.between(0.25, 0.95)
}

fn play(dice: &mut Dice, scale: &Scale, stretch: Stretch) -> Vec<f64> {
    // At full speed about 1.2 `way`, which is 36 % of the stroke of a linear plant.
    let longest_s = (1.2 * scale.way / scale.speed).clamp(0.2, 1.2);
    let count = |seconds: f64| (seconds * RATE_HZ).max(1.0) as usize;
    let mut shares = Vec::new();
    match stretch {
        Stretch::Steps | Stretch::Reversals => {
            for _ in 0..3 {
                let (go, come, sign) = (level(dice), level(dice), dice.sign());
                let go_s = dice.between(0.4, 1.0) * longest_s * (if go > come { come / go } else { 1.0 });
                // As far back as it went, without friction.
                for (share, seconds) in [(sign * go, go_s), (-sign * come, go_s * go / come)] {
                    shares.extend(vec![share; count(seconds)]);
                    if stretch == Stretch::Steps {
                        let rest_s = dice.between(0.1, 0.4);
                        shares.extend(vec![0.0; count(rest_s)]);
                    }
                }
            }
        }
        Stretch::Multisine => {
            let seconds = dice.between(2.5, 4.0);
            // Whole periods, so that the mean is zero.
            let tones: Vec<_> = [1.0, 2.0, 4.0, 7.0, 11.0]
                .into_iter()
                .map(|periods| (periods * std::f64::consts::TAU / seconds, dice.angle(), 1.0 / libm::sqrt(periods)))
                .collect();
            let sum = |index: usize| {
                let at_s = index as f64 / RATE_HZ;
                tones.iter().map(|(rad_s, phase, size)| size * libm::sin(rad_s * at_s + phase)).sum::<f64>()
            };
            let values: Vec<f64> = (0..count(seconds)).map(sum).collect();
            let most = values.iter().fold(f64::MIN_POSITIVE, |most, value| most.max(value.abs()));
            let height = dice.between(0.6, 0.98);
            shares.extend(values.into_iter().map(|value| height * value / most));
        }
        Stretch::Ramps => {
            let (seconds, height) = (dice.between(3.0, 5.0), dice.sign() * dice.between(0.5, 0.98));
            let samples = count(seconds);
            shares.extend((0..samples).map(|index| {
                // Up and down on one side, then on the other.
                let phase = 2.0 * index as f64 / samples as f64;
                let (sign, within) = if phase < 1.0 { (1.0, phase) } else { (-1.0, phase - 1.0) };
                height * sign * (1.0 - (2.0 * within - 1.0).abs())
            }));
        }
    }
    shares
}

#[cfg(test)]
mod tests {
    use super::*;

    fn triangle(phase_of_100: usize) -> f64 {
        let mut dice = Dice::new(1, 1);
        let spec = crate::tests::motor();
        let ramps = play(&mut dice, &Scale::of(&spec, 24.0), Stretch::Ramps);
        ramps[phase_of_100 * ramps.len() / 100]
    }

    #[test]
    fn a_ramp_goes_up_and_down_on_both_sides() {
        let [zero, quarter, half, three] = [0, 25, 50, 75].map(triangle);
        // At least 600 samples: a step of 4/600.
        assert!(zero.abs() < 0.01 && half.abs() < 0.01, "{zero} {half}");
        assert!((quarter + three).abs() < 0.01 && quarter.abs() > 0.49, "{quarter} {three}");
    }

    #[test]
    fn runs_are_of_their_length_in_range_and_not_the_same() {
        let scale = Scale::of(&crate::tests::motor(), 24.0);
        let mut dice = Dice::new(1, 1);
        let runs: Vec<_> = (0..4).map(|number| run(&mut dice, &scale, number, 12.0)).collect();
        for duty in &runs {
            assert_eq!(duty.len(), 2400);
            assert!(duty.iter().all(|duty| duty.abs() <= 1.0));
            assert!(duty.iter().any(|&duty| duty > 0.4) && duty.iter().any(|&duty| duty < -0.4));
        }
        assert!(runs[0] != runs[1] && runs[1] != runs[2]);
    }
}
