//! `r4 tune` on a population of sampled motors.

use std::{fmt, rc::Rc};

use r4_driver::tune::{Loop, Response};
use r4_rig::{
    Rig,
    tune::{Outcome, TuneRequest, tune},
};
use rayon::prelude::*;

use super::population::{CHANNEL, ROBOT, Sampled};

/// Limits of a tuned loop: overshoot as a share of the step, and phase margin.
pub(super) const OVERSHOOT: f64 = 0.05;
pub(super) const MARGIN_DEG: f64 = 45.0;
/// Cascade gain of the robot before tuning, 1/s.
const CASCADE_PER_S: f64 = 2.0;
/// Time limit, s: long enough for every motor.
const TIME_S: f64 = 600.0;

/// Motor with the result of its tuning.
pub(super) struct Tuned {
    pub(super) seed: u64,
    /// Response with the old gains; `None` if tuning failed.
    pub(super) before: Option<Response>,
    /// Response with the proposed gains.
    pub(super) after: Option<Response>,
    /// Phase margin of the proposed gains on the identified model, degrees.
    pub(super) margin_deg: Option<f64>,
    /// Missed limit, or the reason why there are no proposed gains.
    pub(super) fails: Option<String>,
}

impl Tuned {
    /// True if the old gains meet the limits visible in a step response.
    pub(super) fn was_good(&self) -> bool {
        self.before.is_some_and(|before| before.settling_s.is_some() && before.overshoot <= OVERSHOOT)
    }
}

impl fmt::Display for Tuned {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:", self.seed)?;
        for response in [self.before, self.after] {
            match response {
                None => write!(f, " - ")?,
                Some(Response { settling_s: None, overshoot, .. }) => write!(f, " never, {:.1} %;", overshoot * 100.0)?,
                Some(Response { settling_s: Some(settling_s), overshoot, .. }) => {
                    write!(f, " {settling_s:.3} s, {:.1} %;", overshoot * 100.0)?;
                }
            }
        }
        let margin_deg = self.margin_deg.unwrap_or(f64::NAN);
        write!(f, " margin {margin_deg:.0} deg; {}", self.fails.as_deref().unwrap_or("good"))
    }
}

/// Tunes the motor of a seed.
fn tuned(seed: u64, of: Loop) -> anyhow::Result<Tuned> {
    let sampled = Sampled::new(seed);
    let cascade_per_s = if of == Loop::Cascade { CASCADE_PER_S } else { 0.0 };
    let mut rig = Rig { seed, ..Rig::new(ROBOT.parse()?) };
    sampled.put_into(&mut rig.robot()?, cascade_per_s)?;
    rig.alter = Some(Rc::new(move |robot| {
        // The same change succeeded above.
        let _ = sampled.put_into(robot, cascade_per_s);
    }));
    let request = TuneRequest { of: Some(of), time_s: TIME_S, ..TuneRequest::new(CHANNEL) };
    let outcome = rig.run(None, async |session| tune(session, &request, |_| ()).await);
    let (Outcome { before, after, margin_deg, worse, .. }, _) = match outcome {
        Ok(outcome) => outcome,
        Err(error) => {
            let error: anyhow::Error = error.into();
            let fails = Some(format!("{error:#}"));
            return Ok(Tuned { seed, before: None, after: None, margin_deg: None, fails });
        }
    };
    let after = after.ok().map(|after| after.response);
    let overshoot = after.map_or(0.0, |after| after.overshoot);
    let fails = if worse.is_some() {
        worse
    } else if overshoot > OVERSHOOT {
        Some(format!("they overshoot by {:.1} %", overshoot * 100.0))
    } else if margin_deg < MARGIN_DEG {
        Some(format!("their phase margin is {margin_deg:.0} deg"))
    } else {
        None
    };
    Ok(Tuned { seed, before: Some(before.response), after, margin_deg: Some(margin_deg), fails })
}

/// Tunes `motors` motors from seed `from` on, on all cores; `each` is called with every one.
pub(super) fn all(from: u64, motors: u64, of: Loop, each: impl Fn(&Tuned) + Sync) -> anyhow::Result<Vec<Tuned>> {
    let seeds: Vec<u64> = (from..from.saturating_add(motors)).collect();
    let run = |seed: &u64| {
        let tuned = tuned(*seed, of)?;
        each(&tuned);
        Ok(tuned)
    };
    seeds.par_iter().map(run).collect()
}
