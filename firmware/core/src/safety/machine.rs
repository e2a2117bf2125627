//! Safety state machine: states and causes of the board, as a pure function.

use r4_protocol::{Causes, Refusal, SafetyState};

/// Safety state of the board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Safety {
    /// Outputs safe. [`Event::Arm`] leaves, while no cause is present.
    Disarmed,
    /// The only state in which an output may move.
    Armed,
    /// Outputs safe. Keeps every cause seen; [`Event::Clear`] leaves to `Disarmed`, while none is present.
    Tripped {
        /// All causes since the trip.
        causes: Causes,
    },
}

/// Event that the machine handles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// Time has passed; causes may have come or gone.
    Tick,
    /// The host asks to arm, so that outputs may move.
    Arm,
    /// The host asks for safe outputs.
    Disarm,
    /// The host clears a trip.
    Clear,
    /// Causes that trip and are over at once.
    Trip(Causes),
}

impl Safety {
    /// Returns the state after `event` while the causes in `present` hold, and the refusal of the event, if any.
    ///
    /// A present cause trips from every state and at every event.
    ///
    /// # Errors
    /// [`Refusal::CausesPresent`] for arming or clearing while a cause holds, [`Refusal::Tripped`] for arming in a
    /// trip.
    #[must_use = "the new state must be kept"]
    pub fn next(self, event: Event, present: Causes) -> (Self, Result<(), Refusal>) {
        let momentary = if let Event::Trip(causes) = event { causes } else { Causes::NONE };
        let tripping = present.union(momentary);
        if !tripping.is_empty() {
            let refused = match event {
                Event::Arm | Event::Clear => Err(Refusal::CausesPresent { causes: present }),
                Event::Tick | Event::Disarm | Event::Trip(_) => Ok(()),
            };
            return (Self::Tripped { causes: self.causes().union(tripping) }, refused);
        }
        match (self, event) {
            (Self::Tripped { causes }, Event::Arm) => (self, Err(Refusal::Tripped { causes })),
            (Self::Tripped { .. }, Event::Clear) => (Self::Disarmed, Ok(())),
            (Self::Disarmed, Event::Arm) => (Self::Armed, Ok(())),
            (Self::Armed, Event::Disarm) => (Self::Disarmed, Ok(())),
            (Self::Disarmed | Self::Armed | Self::Tripped { .. }, _) => (self, Ok(())),
        }
    }

    /// State as reported to hosts.
    #[must_use]
    pub const fn state(self) -> SafetyState {
        match self {
            Self::Disarmed => SafetyState::Disarmed,
            Self::Armed => SafetyState::Armed,
            Self::Tripped { .. } => SafetyState::Tripped,
        }
    }

    /// Latched causes; none unless tripped.
    #[must_use]
    pub const fn causes(self) -> Causes {
        match self {
            Self::Tripped { causes } => causes,
            Self::Disarmed | Self::Armed => Causes::NONE,
        }
    }
}

#[cfg(test)]
mod tests {
    use r4_protocol::Cause;

    use super::*;

    /// All subsets of the known causes.
    fn all_causes() -> impl Iterator<Item = Causes> {
        (0..1u32 << Cause::ALL.len()).map(Causes::from_bits)
    }

    /// Sets of present causes: none, each alone, and all. The machine only forms unions and checks for the empty set,
    /// so larger sets make no difference to it. Every subset of both would be 2^34 pairs.
    fn present_causes() -> impl Iterator<Item = Causes> {
        let all = Cause::ALL.into_iter().fold(Causes::NONE, |all, cause| all.union(Causes::only(cause)));
        Cause::ALL.into_iter().map(Causes::only).chain([Causes::NONE, all])
    }

    fn all_states() -> impl Iterator<Item = Safety> {
        [Safety::Disarmed, Safety::Armed]
            .into_iter()
            .chain(all_causes().filter(|c| !c.is_empty()).map(|causes| Safety::Tripped { causes }))
    }

    /// All events except trips with several causes at once: to the machine those do not differ from `present`.
    fn all_events() -> impl Iterator<Item = Event> {
        [Event::Tick, Event::Arm, Event::Disarm, Event::Clear]
            .into_iter()
            .chain(Cause::ALL.map(|cause| Event::Trip(Causes::only(cause))))
    }

    /// Walks the table: every state, with every event, against few present causes, and every set of present causes
    /// against states of at most one cause.
    #[test]
    fn the_whole_table_is_safe() {
        for state in all_states() {
            let few = state.causes().iter().count() <= 1;
            for event in all_events() {
                let present: &mut dyn Iterator<Item = Causes> =
                    if few { &mut all_causes() } else { &mut present_causes() };
                present.for_each(|present| check(state, event, present));
            }
        }
    }

    fn check(state: Safety, event: Event, present: Causes) {
        let (next, result) = state.next(event, present);
        let momentary = if let Event::Trip(causes) = event { causes } else { Causes::NONE };
        let tripping = present.union(momentary);
        if !tripping.is_empty() {
            // Every cause trips from every state, and none is lost.
            assert_eq!(next, Safety::Tripped { causes: state.causes().union(tripping) });
        }
        if next == Safety::Armed {
            // Armed is entered only by Arm from Disarmed, without causes.
            assert!(state == Safety::Armed || (state == Safety::Disarmed && event == Event::Arm));
            assert!(present.is_empty());
        }
        if state.state() == SafetyState::Tripped && next.state() != SafetyState::Tripped {
            // A trip is left only by Clear, without causes, and never straight into Armed.
            assert_eq!((event, next), (Event::Clear, Safety::Disarmed));
            assert!(present.is_empty());
        }
        if result.is_err() {
            assert!(next != Safety::Armed && matches!(event, Event::Arm | Event::Clear));
        }
    }
}
