//! Conversion of instructions to virtual time.

const SECOND: u64 = 1_000_000_000;

/// Time as a number of instructions after a start; rounding errors do not accumulate.
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

    /// Returns the present time, ns.
    pub(crate) fn now_ns(&self) -> u64 {
        self.after_ns(0)
    }

    /// Returns the time after `instructions` more, rounded up to a nanosecond.
    pub(crate) fn after_ns(&self, instructions: u64) -> u64 {
        let since = self.since + instructions;
        let whole = since / self.per_second;
        // The product is below `per_second` squared, far from 2^64 at up to 4 instructions per nanosecond.
        let rest = (since % self.per_second * SECOND).div_ceil(self.per_second);
        self.start_ns + whole * SECOND + rest
    }

    /// Returns the number of instructions until a time at or after `t_ns`; 0 if it is reached already.
    pub(crate) fn until(&self, t_ns: u64) -> u64 {
        let Some(before) = t_ns.saturating_sub(self.start_ns).checked_sub(1) else { return 0 };
        // Finds the first n for which ceil(n * SECOND / per_second) > before, with whole seconds and the rest separate.
        let whole = (before / SECOND).saturating_mul(self.per_second);
        let needed = whole.saturating_add(before % SECOND * self.per_second / SECOND + 1);
        needed.saturating_sub(self.since)
    }

    /// Advances time by executed instructions.
    pub(crate) fn execute(&mut self, instructions: u64) {
        self.since += instructions;
        self.executed += instructions;
    }

    /// Returns the instructions executed in total.
    pub(crate) fn executed(&self) -> u64 {
        self.executed
    }

    /// Advances time to `t_ns` without instructions.
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
