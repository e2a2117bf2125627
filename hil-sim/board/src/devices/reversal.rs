//! Reversals of a bridge, and its pauses before them.

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Direction {
    Forward,
    Reverse,
}

/// Last direction of a bridge, and its present pause.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Reversals {
    direction: Option<Direction>,
    /// Start of the pause, ns; `None` while the bridge drives at some time of a cycle.
    idle_since_ns: Option<u64>,
}

impl Reversals {
    /// Bridge without a direction, which has paused since time 0.
    pub(super) const fn new() -> Self {
        Self { direction: None, idle_since_ns: Some(0) }
    }

    /// Takes the counts of each cycle from `at_ns` on in which the motor is driven `forward` and in `reverse`. Returns the
    /// length of the pause, ns, before a reversal that needed one of `needed_ns`; 0 if both occur in one cycle.
    pub(super) fn too_short(&mut self, at_ns: u64, forward: u16, reverse: u16, needed_ns: u64) -> Option<u64> {
        let idle_ns = self.idle_since_ns.map_or(0, |since_ns| at_ns.saturating_sub(since_ns));
        let (next, reversed, idle_ns) = match (forward > 0, reverse > 0) {
            (false, false) => return None,
            (true, true) => (None, true, 0),
            (true, false) => (Some(Direction::Forward), self.direction == Some(Direction::Reverse), idle_ns),
            (false, true) => (Some(Direction::Reverse), self.direction == Some(Direction::Forward), idle_ns),
        };
        self.direction = next;
        (reversed && idle_ns < needed_ns).then_some(idle_ns)
    }

    /// Records whether the bridge pauses from `at_ns` on, after [`Reversals::too_short`].
    pub(super) fn set_idle(&mut self, at_ns: u64, idle: bool) {
        if idle {
            self.idle_since_ns.get_or_insert(at_ns);
        } else {
            self.idle_since_ns = None;
        }
    }
}
