//! New gains and tunings of motors: written for hosts, taken by the control loop.

use r4_protocol::{
    Mode,
    config::{MAX_MOTORS, PidGains, Tuning},
};

/// Gains and tunings that the control loop has not taken yet.
pub(super) struct Tunings {
    /// New gains of the position and of the speed loop.
    gains: [[Option<PidGains>; 2]; MAX_MOTORS],
    tunings: [Option<Tuning>; MAX_MOTORS],
}

impl Tunings {
    pub(super) const fn new() -> Self {
        Self { gains: [[None; 2]; MAX_MOTORS], tunings: [None; MAX_MOTORS] }
    }

    /// Stores gains; an open-loop duty has none.
    pub(super) fn set_gains(&mut self, motor: usize, mode: Mode, gains: PidGains) {
        match mode {
            Mode::Position => self.gains[motor][0] = Some(gains),
            Mode::Speed => self.gains[motor][1] = Some(gains),
            _ => {}
        }
    }

    pub(super) fn set_tuning(&mut self, motor: usize, tuning: Tuning) {
        self.tunings[motor] = Some(tuning);
    }

    /// Takes the next new gains of some motor's loop; `None` without any.
    pub(super) fn take_gains(&mut self) -> Option<(usize, Mode, PidGains)> {
        let (index, slot) = self.gains.as_flattened_mut().iter_mut().enumerate().find(|(_, gains)| gains.is_some())?;
        let mode = if index % 2 == 0 { Mode::Position } else { Mode::Speed };
        slot.take().map(|gains| (index / 2, mode, gains))
    }

    /// Takes the next new tuning of some motor; `None` without any.
    pub(super) fn take_tuning(&mut self) -> Option<(usize, Tuning)> {
        let (index, slot) = self.tunings.iter_mut().enumerate().find(|(_, tuning)| tuning.is_some())?;
        slot.take().map(|tuning| (index, tuning))
    }
}
