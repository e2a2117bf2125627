//! Loops that look at registers until something happens: what they do until then is worked out once, and time passes.
//!
//! A loop is left out only where nothing can be different by it: one time round was executed block by block, it loaded, computed
//! and branched, every register of the core was the same after it as before, no event was due in it, and each register that
//! it looked at stays as it is ([`Chip::stable_until_ns`]) up to the end of what is left out. Instructions that are left out
//! count as executed.

use super::{Machine, MachineError};
use crate::chip::Chip;
use crate::cpu::{Core, Register};

/// Equal reads after which a loop is looked at: fewer would look at what is not one, more would execute more of what is.
/// Halving it changes no result.
const SUSPICIOUS: u32 = 16;
/// Different reads that a loop may have.
const DIFFERENT: usize = 4;
/// Blocks of a loop at most.
const BLOCKS: usize = 16;
/// Equal reads before the next attempt, where the last one found no such loop.
const PAUSE: u32 = 4096;

/// PC, address and value.
type Read = (u32, u32, u32);

/// The program's reads, as far as they repeat themselves.
#[derive(Clone, Debug, Default)]
pub(super) struct Polls {
    on: bool,
    last: [Option<Read>; DIFFERENT],
    next: usize,
    equal: u32,
    /// Equal reads that are let pass first.
    pause: u32,
}

impl Polls {
    pub(super) fn new(on: bool) -> Self {
        Self { on, ..Self::default() }
    }

    pub(super) fn read(&mut self, read: Read) {
        if !self.on {
            return;
        }
        if self.last.contains(&Some(read)) {
            self.equal += 1;
        } else {
            (self.equal, self.pause) = (0, 0);
            self.last[self.next] = Some(read);
            self.next = (self.next + 1) % DIFFERENT;
        }
    }

    pub(super) fn wrote(&mut self) {
        (self.equal, self.pause) = (0, 0);
        self.last = [None; DIFFERENT];
    }

    pub(super) fn suspected(&self) -> bool {
        self.equal > SUSPICIOUS + self.pause
    }

    fn done(&mut self, left_out: bool) {
        (self.equal, self.pause) = (0, if left_out { 0 } else { PAUSE });
    }
}

/// Every register of the core.
fn registers<C: Core>(core: &C) -> Vec<u32> {
    use Register::{Basepri, Control, Faultmask, Fpscr, Lr, Msp, Pc, Primask, Psp, R, S, Xpsr};
    let others = [Lr, Pc, Msp, Psp, Xpsr, Primask, Basepri, Faultmask, Control, Fpscr];
    let all = (0..=12).map(R).chain(others).chain((0..32).map(S));
    all.map(|register| core.get(register)).collect()
}

impl<C: Core, S: Chip> Machine<C, S> {
    /// Goes once round the loop at PC, and leaves out what is the same until something happens. Does nothing that executing
    /// would not do: where it finds no loop, so much of the program is executed. `false` is to be followed by that.
    pub(super) fn leave_out_polling(&mut self, t_ns: u64) -> Result<(), MachineError> {
        let (head, executed) = (registers(&self.core), self.instructions());
        let event_ns = self.next_event_ns().min(t_ns);
        self.polls.done(false);
        self.one_block.begin();
        for _ in 0..BLOCKS {
            if !self.core.only_looks() {
                break;
            }
            let told = self.execute(t_ns)?;
            // Whatever else has happened is the program's, and is seen to before its next instruction.
            if told.is_some() || self.one_block.is_broken() || self.now_ns() >= event_ns {
                break;
            }
            if registers(&self.core) == head {
                self.leave_out(self.instructions() - executed, event_ns);
                break;
            }
        }
        self.one_block.end();
        Ok(())
    }

    fn leave_out(&mut self, round: u64, event_ns: u64) {
        let now_ns = self.now_ns();
        let stable = |address: &u32| self.chip.stable_until_ns(now_ns, *address);
        let Some(until_ns) =
            self.one_block.reads().iter().map(stable).try_fold(event_ns, |all, one| Some(all.min(one?)))
        else {
            return;
        };
        // The last of them ends before that moment.
        let rounds = self.time.until(until_ns).saturating_sub(1).checked_div(round).unwrap_or(0);
        self.time.execute(rounds * round);
        if let Some(profile) = &mut self.profile {
            profile.executed(crate::cpu::take::active(&self.core), rounds * round);
        }
        self.polls.done(true);
    }
}

/// What blocks that are executed one by one do.
#[derive(Clone, Debug, Default)]
pub(super) struct OneBlock {
    on: bool,
    broken: bool,
    reads: Vec<u32>,
}

impl OneBlock {
    fn begin(&mut self) {
        (self.on, self.broken) = (true, false);
        self.reads.clear();
    }

    fn end(&mut self) {
        self.on = false;
    }

    pub(super) fn is_on(&self) -> bool {
        self.on
    }

    fn is_broken(&self) -> bool {
        self.broken
    }

    fn reads(&self) -> &[u32] {
        &self.reads
    }

    /// A block was executed.
    pub(super) fn executed(&mut self, reads: &[u32], plain: bool) {
        self.reads.extend(reads);
        self.broken |= !plain;
    }
}
