//! Effects that no plant file can hold: for whoever tries how well an identifier describes what it does not know.

use std::fmt::Debug;

/// What an unlisted effect sees of a plant at the start of a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moment {
    /// Since the start.
    pub time_s: f64,
    /// Length of the step.
    pub step_s: f64,
    /// As the input effects left it.
    pub duty: f64,
    /// Of the motor side, rad or m; half-way through the step, to first order.
    pub position: f64,
    /// Of the motor side, rad/s or m/s.
    pub speed: f64,
}

/// What an unlisted effect does over a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Doing {
    /// The duty that acts in place of [`Moment::duty`]. Clipped to what the bridge can do.
    pub duty: f64,
    /// A level of force against motion, which also holds at rest; not negative. N m or N.
    pub friction: f64,
    /// A force towards positive positions, whatever the motion. N m or N.
    pub force: f64,
}

/// An effect outside the catalogue, with its memory.
pub trait Unlisted: Debug + Send + Sync {
    /// Called once for each step of at most [`crate::Plant::max_step_s`], in the order of time. What is not finite is
    /// taken as nothing done.
    fn act(&mut self, moment: &Moment) -> Doing;

    /// The same with the same memory.
    fn copied(&self) -> Box<dyn Unlisted>;
}

impl Clone for Box<dyn Unlisted> {
    fn clone(&self) -> Self {
        self.copied()
    }
}

/// What several do together, the duty through one after the other.
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
