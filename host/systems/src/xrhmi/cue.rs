//! Cues: which lamps, pitches and bands tell a person to pick from a zone or to put there.

use crate::sampler::Sampler;

/// Purpose of the random numbers that choose the zones; the place of the trial is added.
const OF_COMMANDS: u64 = 1_700;
/// Number of commands of a trial: 7 to pick and 7 to put, printed.
pub const COMMANDS: usize = 14;
/// Number of zones on the desk.
pub const ZONES: usize = 4;
/// Pitch voltage of a tone, V: our choice; the discard zone has the higher one.
const TONE_V: f64 = 1.0;
const HIGH_TONE_V: f64 = 2.0;
/// Duration of a tone, s: our choice, about that of a spoken word.
const TONE_S: f64 = 0.5;
/// Duration of a buzz and of the pause between two, s: our choice. The motor of a band takes 50 ms to 63 % of its speed, so that a
/// pause of 0.1 s would hardly be felt.
const BUZZ_S: f64 = 0.25;
const PAUSE_S: f64 = 0.20;
/// Duty of a buzzing band: 3 V of 5 V.
pub const BUZZ_DUTY: f64 = 0.6;

/// Zone of the desk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Zone {
    /// Zone at the left hand.
    Left,
    /// Zone in the middle, before the person.
    Centre,
    /// Zone at the right hand.
    Right,
    /// Zone for discarded objects, behind the centre.
    Discard,
}

impl Zone {
    /// All zones, in the order of their channels.
    pub const ALL: [Self; ZONES] = [Self::Left, Self::Centre, Self::Right, Self::Discard];

    /// Name of the zone in tables.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Left => "left",
            Self::Centre => "centre",
            Self::Right => "right",
            Self::Discard => "discard",
        }
    }
}

/// Sense that a cue addresses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Modality {
    /// Lamps at the zones.
    Visual,
    /// Tones from left, right or both sides.
    Auditory,
    /// Buzzes on one wrist or both.
    Haptic,
}

impl Modality {
    /// All modalities, in the order of the paper's tables.
    pub const ALL: [Self; 3] = [Self::Visual, Self::Auditory, Self::Haptic];

    /// Name of the modality in tables.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Visual => "visual",
            Self::Auditory => "auditory",
            Self::Haptic => "haptic",
        }
    }
}

/// One instruction of a trial.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Command {
    /// True to pick an object up, false to put it down.
    pub is_pick: bool,
    /// Zone to which the hand has to go.
    pub zone: Zone,
}

/// Samples the commands of a trial: objects are picked from left, centre or right and put into any other zone, and no
/// two successive commands name the same zone, in which the hand would rest already. The first is not for the centre,
/// where the hand starts the trial.
#[must_use]
pub fn commands(seed: u64, place: usize) -> [Command; COMMANDS] {
    let mut sampler = Sampler::new(seed, OF_COMMANDS + place as u64);
    let mut last = Zone::Centre;
    std::array::from_fn(|number| {
        let is_pick = number.is_multiple_of(2);
        let choices: Vec<Zone> =
            Zone::ALL.into_iter().filter(|zone| *zone != last && !(is_pick && *zone == Zone::Discard)).collect();
        let choice = sampler.uniform(0.0, choices.len() as f64) as usize;
        // The sample is below the length, but for rounding up to it.
        last = choices[choice.min(choices.len() - 1)];
        Command { is_pick, zone: last }
    })
}

/// State of all outputs of the desk.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Outputs {
    /// Lit lamps: red in the order of [`Zone::ALL`], then blue.
    pub lamps: [bool; 2 * ZONES],
    /// Pitch voltages of the left and right oscillator, V; 0 is silence.
    pub pitch_v: [f64; 2],
    /// Buzzing bands, left and right.
    pub bands: [bool; 2],
}

/// Part of a cue: outputs, and the time for which they stay, s; infinite for a cue that stays until the dwell.
pub type Step = (Outputs, f64);

/// Steps of a cue. Haptic as printed: left, both, right; two buzzes on both to discard. Tones follow the same sides,
/// with a higher pitch to discard.
#[must_use]
pub fn steps(modality: Modality, command: Command) -> Vec<Step> {
    let sides = match command.zone {
        Zone::Left => [true, false],
        Zone::Centre | Zone::Discard => [true, true],
        Zone::Right => [false, true],
    };
    let off = Outputs::default();
    match modality {
        Modality::Visual => {
            let mut lamps = [false; 2 * ZONES];
            lamps[command.zone as usize + if command.is_pick { 0 } else { ZONES }] = true;
            vec![(Outputs { lamps, ..off }, f64::INFINITY)]
        }
        Modality::Auditory => {
            let tone_v = if command.zone == Zone::Discard { HIGH_TONE_V } else { TONE_V };
            vec![(Outputs { pitch_v: sides.map(|on| if on { tone_v } else { 0.0 }), ..off }, TONE_S), (off, 0.0)]
        }
        Modality::Haptic => {
            let buzz = (Outputs { bands: sides, ..off }, BUZZ_S);
            if command.zone == Zone::Discard {
                vec![buzz, (off, PAUSE_S), buzz, (off, 0.0)]
            } else {
                vec![buzz, (off, 0.0)]
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_trial_has_seven_picks_and_seven_puts() {
        for seed in 1..200 {
            let commands = commands(seed, (seed % 3) as usize);
            assert_eq!(commands.iter().filter(|command| command.is_pick).count(), 7);
            assert!(commands[0].zone != Zone::Centre, "{commands:?}");
            assert!(commands.windows(2).all(|pair| pair[0].zone != pair[1].zone), "{commands:?}");
            assert!(commands.iter().all(|command| !(command.is_pick && command.zone == Zone::Discard)));
        }
    }

    /// No two commands of a modality look alike, except that only lamps distinguish picks from puts.
    #[test]
    fn cues_are_distinct() {
        for modality in Modality::ALL {
            for is_pick in [true, false] {
                let cues = Zone::ALL.map(|zone| steps(modality, Command { is_pick, zone }));
                for (place, cue) in cues.iter().enumerate() {
                    assert!(!cues[..place].contains(cue), "{modality:?} {cue:?}");
                }
            }
        }
        let buzzes = |zone| {
            let cue = steps(Modality::Haptic, Command { is_pick: true, zone });
            (cue[0].0.bands, cue.iter().filter(|(outputs, _)| outputs.bands != [false; 2]).count())
        };
        let expected = [([true, false], 1), ([true, true], 1), ([false, true], 1), ([true, true], 2)];
        assert_eq!(Zone::ALL.map(buzzes), expected, "table 1 of the paper");
    }
}
