//! Effects that no plant file can hold: for tests of how well an identifier describes mechanisms it does not know.

use std::fmt::Debug;

/// State of a plant at the start of a step, as an unlisted effect sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moment {
    /// Time since the start, s.
    pub time_s: f64,
    /// Length of the step, s.
    pub step_s: f64,
    /// Duty after all other input effects.
    pub duty: f64,
    /// Position of the motor side half-way through the step (first order), rad or m.
    pub position: f64,
    /// Speed of the motor side, rad/s or m/s.
    pub speed: f64,
}

/// Contribution of an unlisted effect to a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Doing {
    /// Duty that replaces [`Moment::duty`]; clipped to the range of the bridge.
    pub duty: f64,
    /// Force against motion that also holds at rest, N m or N; a negative value counts as 0.
    pub friction: f64,
    /// Force towards positive positions, whatever the motion, N m or N.
    pub force: f64,
}

/// An effect outside the catalogue, with its memory.
pub trait Unlisted: Debug + Send + Sync {
    /// Called once for each step of at most [`crate::Plant::max_step_s`], in the order of time. A contribution that is
    /// not finite is ignored.
    fn act(&mut self, moment: &Moment) -> Doing;

    /// Boxed clone of the effect with its memory.
    fn copied(&self) -> Box<dyn Unlisted>;
}

impl Clone for Box<dyn Unlisted> {
    fn clone(&self) -> Self {
        self.copied()
    }
}

/// Sum of several effects; the duty passes through one after the other.
pub(crate) fn act(effects: &mut [Box<dyn Unlisted>], moment: Moment) -> Doing {
    effects.iter_mut().fold(Doing { duty: moment.duty, friction: 0.0, force: 0.0 }, |sum, effect| {
        let done = effect.act(&Moment { duty: sum.duty, ..moment });
        let finite = |value: f64, otherwise: f64| if value.is_finite() { value } else { otherwise };
        Doing {
            duty: finite(done.duty, sum.duty),
            friction: sum.friction + finite(done.friction, 0.0).max(0.0),
            force: sum.force + finite(done.force, 0.0),
        }
    })
}
