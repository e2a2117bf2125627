//! Mechanical switch between an input with a pull resistor and a rail.

use rand_pcg::{Pcg64, rand_core::SeedableRng};

use super::uniform;

/// Bounce time of ordinary switches, ns (our choice of a worst case; data sheets say 5 ms to 10 ms).
pub const BOUNCE_NS: u64 = 5_000_000;
/// Largest number of bounces of a contact.
const MAX_BOUNCES: f64 = 6.0;

/// Pull resistor of an input, which also decides the rail that the switch connects to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pull {
    /// Pull-up: an open switch reads high; a closed one connects to ground.
    Up,
    /// Pull-down: an open switch reads low; a closed one connects to the supply.
    Down,
}

/// Contact of the switch that is used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Contact {
    /// Normally open: closes when actuated.
    NormallyOpen,
    /// Normally closed: opens when actuated.
    NormallyClosed,
}

/// Fault of the wiring.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SwitchFault {
    /// Cut wire: reads as the pull resistor.
    CutWire,
    /// Short between the wires, or welded contact: reads as closed.
    Shorted,
}

/// A switch that is actuated and released. Its contact changes at once, then opens and closes at random times, and
/// rests after the bounce time at the latest.
#[derive(Clone, Debug)]
pub struct Switch {
    contact: Contact,
    pull: Pull,
    bounce_ns: u64,
    fault: Option<SwitchFault>,
    actuated: bool,
    actuated_at_ns: u64,
    /// State of the contact before the last actuation, true if closed, and the times of its changes after it, ns.
    closed_before: bool,
    changes_ns: Vec<u64>,
    generator: Pcg64,
}

impl Switch {
    /// A released switch at rest that bounces for up to `bounce_ns`, [`BOUNCE_NS`] if unknown; 0 is ideal.
    #[must_use]
    pub fn new(contact: Contact, pull: Pull, bounce_ns: u64, seed: u64) -> Self {
        Self {
            contact,
            pull,
            bounce_ns,
            fault: None,
            actuated: false,
            actuated_at_ns: 0,
            closed_before: contact == Contact::NormallyClosed,
            changes_ns: Vec::new(),
            generator: Pcg64::seed_from_u64(seed),
        }
    }

    /// Actuates or releases the switch, also while it still bounces.
    pub fn set_actuated(&mut self, at_ns: u64, actuated: bool) {
        if actuated == self.actuated {
            return;
        }
        let at_ns = at_ns.max(self.actuated_at_ns);
        let closes = actuated == (self.contact == Contact::NormallyOpen);
        self.closed_before = self.is_closed(at_ns);
        (self.actuated, self.actuated_at_ns) = (actuated, at_ns);
        let bounces = (uniform(&mut self.generator) * (MAX_BOUNCES + 1.0)) as usize;
        self.changes_ns.clear();
        for _ in 0..2 * bounces {
            let after_ns = (uniform(&mut self.generator) * self.bounce_ns as f64) as u64;
            if after_ns > 0 {
                self.changes_ns.push(at_ns + after_ns);
            }
        }
        self.changes_ns.sort_unstable();
        self.changes_ns.dedup();
        // an even number, so that the contact ends in the state of the first change
        self.changes_ns.truncate(self.changes_ns.len() / 2 * 2);
        if closes != self.closed_before {
            self.changes_ns.insert(0, at_ns);
        }
    }

    /// Sets or clears a fault of the wiring, at once.
    pub fn set_fault(&mut self, fault: Option<SwitchFault>) {
        self.fault = fault;
    }

    /// Level of the input at any time; before the last actuation it is the level just before that.
    #[must_use]
    pub fn is_high(&self, at_ns: u64) -> bool {
        let conducts = match self.fault {
            Some(SwitchFault::CutWire) => false,
            Some(SwitchFault::Shorted) => true,
            None => self.is_closed(at_ns),
        };
        conducts == (self.pull == Pull::Down)
    }

    /// Time of the contact's next change after `after_ns`, ns, unless it is at rest.
    #[must_use]
    pub fn next_change_ns(&self, after_ns: u64) -> Option<u64> {
        self.changes_ns.iter().copied().find(|change_ns| *change_ns > after_ns)
    }

    fn is_closed(&self, at_ns: u64) -> bool {
        let changes = self.changes_ns.iter().take_while(|change_ns| **change_ns <= at_ns).count();
        self.closed_before ^ (changes % 2 == 1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const MS: u64 = 1_000_000;

    #[test]
    fn levels_at_rest() {
        use Contact::{NormallyClosed, NormallyOpen};
        for (contact, pull, released, actuated) in [
            (NormallyOpen, Pull::Up, true, false),
            (NormallyOpen, Pull::Down, false, true),
            (NormallyClosed, Pull::Up, false, true),
            (NormallyClosed, Pull::Down, true, false),
        ] {
            let mut switch = Switch::new(contact, pull, BOUNCE_NS, 1);
            assert_eq!(switch.is_high(0), released);
            switch.set_actuated(10 * MS, true);
            assert_eq!(
                [10 * MS - 1, 10 * MS, 15 * MS].map(|at_ns| switch.is_high(at_ns)),
                [released, actuated, actuated]
            );
            // a repeated actuation is no change
            switch.set_actuated(20 * MS, true);
            assert!(switch.is_high(20 * MS) == actuated && switch.next_change_ns(20 * MS).is_none());
            switch.set_actuated(30 * MS, false);
            assert_eq!(switch.is_high(35 * MS), released);
        }
    }

    #[test]
    fn a_cut_wire_reads_as_pulled_and_a_short_as_closed() {
        for (pull, pulled) in [(Pull::Up, true), (Pull::Down, false)] {
            for contact in [Contact::NormallyOpen, Contact::NormallyClosed] {
                let mut switch = Switch::new(contact, pull, BOUNCE_NS, 1);
                for actuated in [false, true] {
                    switch.set_actuated(0, actuated);
                    switch.set_fault(Some(SwitchFault::CutWire));
                    assert!((0..10).all(|at_ms| switch.is_high(at_ms * MS) == pulled));
                    switch.set_fault(Some(SwitchFault::Shorted));
                    assert!((0..10).all(|at_ms| switch.is_high(at_ms * MS) != pulled));
                }
                switch.set_fault(None);
                assert_eq!(switch.is_high(9 * MS) == pulled, contact == Contact::NormallyClosed);
            }
        }
    }

    #[test]
    fn bounces_as_its_seed_says() {
        let changes = |seed| {
            let mut switch = Switch::new(Contact::NormallyOpen, Pull::Up, BOUNCE_NS, seed);
            switch.set_actuated(MS, true);
            switch.changes_ns
        };
        assert_eq!(changes(3), changes(3));
        let all: Vec<_> = (0..100).map(changes).collect();
        // 0 to 6 bounces, uniform: six in seven bounce at all, of 100 samples surely more than half
        assert!(all.iter().filter(|changes| changes.len() > 1).count() > 50);
        assert!(all.iter().any(|changes| changes.len() == 1) && all.iter().any(|changes| changes.len() == 13));
        let mut ideal = Switch::new(Contact::NormallyOpen, Pull::Up, 0, 1);
        ideal.set_actuated(MS, true);
        assert_eq!(ideal.changes_ns, [MS]);
    }

    proptest! {
        /// The changes listed by `next_change_ns` are those of `is_high` at any time, and end in time.
        #[test]
        fn lazy_equals_eager(
            seed in any::<u64>(),
            // also so short that changes coincide
            bounce_ns in prop_oneof![0..20_u64, Just(BOUNCE_NS)],
            actuations_ns in prop::collection::vec(0..12 * MS, 1..10),
            look_ns in 0..12 * MS,
        ) {
            let mut switch = Switch::new(Contact::NormallyOpen, Pull::Down, bounce_ns, seed);
            let mut at_ns = 0;
            for (index, after_ns) in actuations_ns.into_iter().enumerate() {
                at_ns += after_ns;
                let before = switch.is_high(at_ns);
                switch.set_actuated(at_ns, index % 2 == 0);
                prop_assert_eq!(switch.is_high(at_ns), index % 2 == 0);
                prop_assert_eq!(at_ns == 0 || switch.is_high(at_ns - 1) == before, true);
                let (mut level, mut now_ns) = (switch.is_high(at_ns), at_ns);
                while let Some(change_ns) = switch.next_change_ns(now_ns).filter(|ns| *ns <= at_ns + look_ns) {
                    prop_assert_eq!(switch.is_high(change_ns - 1), level);
                    (level, now_ns) = (!level, change_ns);
                    prop_assert_eq!(switch.is_high(now_ns), level);
                }
                prop_assert_eq!(switch.is_high(at_ns + look_ns), level);
                prop_assert_eq!(switch.next_change_ns(at_ns + bounce_ns), None);
                prop_assert_eq!(switch.is_high(at_ns + bounce_ns), index % 2 == 0);
            }
        }
    }
}
