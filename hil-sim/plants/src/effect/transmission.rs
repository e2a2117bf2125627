//! Effects between the motor side and the output.

use super::{backlash::Play, compliance::Spring};

/// Stage between the motor side and the output.
#[derive(Clone, Debug)]
pub(crate) enum TransmissionStage {
    Play(Play),
    Spring(Box<Spring>),
}

impl TransmissionStage {
    pub(crate) fn settle(&mut self, position: f64) {
        match self {
            Self::Play(play) => play.centre(position),
            Self::Spring(spring) => spring.settle(),
        }
    }

    pub(crate) fn apply(&mut self, position: f64, speed: f64, step_s: f64) -> (f64, f64) {
        match self {
            Self::Play(play) => play.apply(position, speed),
            Self::Spring(spring) => spring.apply(position, speed, step_s),
        }
    }
}
