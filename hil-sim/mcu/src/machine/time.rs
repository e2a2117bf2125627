//! Virtual time from instructions.

const SECOND: u64 = 1_000_000_000;

/// A moment: so many instructions after another moment, without rounding that adds up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Instructions {
    start_ns: u64,
    since: u64,
    per_second: u64,
    executed: u64,
}

impl Instructions {
    pub(crate) fn new(per_second: u64) -> Self {
        Self { start_ns: 0, since: 0, per_second: per_second.max(1), executed: 0 }
    }

    /// The moment.
    pub(crate) fn now_ns(&self) -> u64 {
        self.after_ns(0)
    }

    /// The moment `instructions` later: the first nanosecond that is not before it.
    pub(crate) fn after_ns(&self, instructions: u64) -> u64 {
        let since = self.since + instructions;
        let whole = since / self.per_second;
        // Below `per_second` squared, which is far from 2^64 at up to 4 instructions per nanosecond.
        let rest = (since % self.per_second * SECOND).div_ceil(self.per_second);
        self.start_ns + whole * SECOND + rest
    }

    /// How many instructions later the moment is at or after `t_ns`; 0 when it is already.
    pub(crate) fn until(&self, t_ns: u64) -> u64 {
        let Some(before) = t_ns.saturating_sub(self.start_ns).checked_sub(1) else { return 0 };
        // The first n for which ceil(n * SECOND / per_second) > before, whole seconds and the rest apart.
        let whole = (before / SECOND).saturating_mul(self.per_second);
        let needed = whole.saturating_add(before % SECOND * self.per_second / SECOND + 1);
        needed.saturating_sub(self.since)
    }

    /// Executes instructions.
    pub(crate) fn execute(&mut self, instructions: u64) {
        self.since += instructions;
        self.executed += instructions;
    }

    /// Instructions executed ever.
    pub(crate) fn executed(&self) -> u64 {
        self.executed
    }

    /// Passes time without instructions.
    pub(crate) fn jump(&mut self, t_ns: u64) {
        if t_ns > self.now_ns() {
            self.start_ns = t_ns;
            self.since = 0;
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn so_many_instructions_are_just_enough(per_second in 1..2_000_000_000_u64, since in 0..1_u64 << 40, ns in 0..1_u64 << 44) {
            let mut time = Instructions::new(per_second);
            time.execute(since);
            let needed = time.until(ns);
            prop_assert!(time.after_ns(needed) >= ns);
            prop_assert!(needed == 0 || time.after_ns(needed - 1) < ns);
        }
    }

    #[test]
    fn thirds_of_a_nanosecond_do_not_add_up() {
        let mut time = Instructions::new(3_000_000_000);
        for _ in 0..3_000_000 {
            time.execute(1);
        }
        assert_eq!(time.now_ns(), 1_000_000);
        time.jump(2_000_000);
        assert_eq!((time.now_ns(), time.after_ns(1), time.executed()), (2_000_000, 2_000_001, 3_000_000));
        time.jump(5);
        assert_eq!(time.now_ns(), 2_000_000);
    }
}
