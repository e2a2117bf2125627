//! Skipping of loops that poll registers: one iteration is analysed, and time jumps to the next event.
//!
//! A loop is skipped only where that cannot change any result: one iteration was executed block by block; it loaded,
//! computed and branched; every register of the core was the same after it as before; no event was due in it; and each
//! register that it read keeps its value ([`Chip::stable_until_ns`]) up to the end of the skip. Skipped instructions
//! count as executed.

use super::{Machine, MachineError};
use crate::chip::Chip;
use crate::cpu::{Core, Register};

/// Number of equal reads after which a loop is analysed. Fewer would analyse code that is no loop, more would execute
/// more of real ones. Half the number changes no result.
const SUSPICIOUS: u32 = 16;
/// Largest number of different reads in a loop.
const DIFFERENT: usize = 4;
/// Largest number of blocks in a loop.
const BLOCKS: usize = 16;
/// Number of equal reads before the next attempt, after the last one found no such loop.
const PAUSE: u32 = 4096;

/// Read by the program: PC, address and value.
type Read = (u32, u32, u32);

/// Recent reads of the program, to detect repetition.
#[derive(Clone, Debug, Default)]
pub(super) struct Polls {
    on: bool,
    last: [Option<Read>; DIFFERENT],
    next: usize,
    equal: u32,
    /// Number of equal reads to ignore first.
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
            // Another address or value: the program makes progress.
            (self.equal, self.pause) = (0, 0);
            self.last[self.next] = Some(read);
            self.next = (self.next + 1) % DIFFERENT;
        }
    }

    pub(super) fn wrote(&mut self) {
        // A write can change what the next reads return.
        (self.equal, self.pause) = (0, 0);
        self.last = [None; DIFFERENT];
    }

    pub(super) fn suspected(&self) -> bool {
        self.equal > SUSPICIOUS + self.pause
    }

    fn done(&mut self, left_out: bool) {
        // An attempt executes block by block, which is slow, so a failed one is not repeated at once.
        (self.equal, self.pause) = (0, if left_out { 0 } else { PAUSE });
    }
}

/// Returns all registers of the core.
fn registers<C: Core>(core: &C) -> Vec<u32> {
    use Register::{Basepri, Control, Faultmask, Fpscr, Lr, Msp, Pc, Primask, Psp, R, S, Xpsr};
    let others = [Lr, Pc, Msp, Psp, Xpsr, Primask, Basepri, Faultmask, Control, Fpscr];
    let all = (0..=12).map(R).chain(others).chain((0..32).map(S));
    all.map(|register| core.get(register)).collect()
}

impl<C: Core, S: Chip> Machine<C, S> {
    /// Executes one iteration of the loop at PC, and skips further ones until the next event. If it finds no loop, it
    /// has only executed a part of the program as usual.
    pub(super) fn leave_out_polling(&mut self, t_ns: u64) -> Result<(), MachineError> {
        let (head, executed) = (registers(&self.core), self.instructions());
        let event_ns = self.next_event_ns().min(t_ns);
        // The pause applies unless `leave_out` succeeds and cancels it.
        self.polls.done(false);
        self.one_block.begin();
        for _ in 0..BLOCKS {
            if !self.core.only_looks() {
                break;
            }
            let told = self.execute(t_ns)?;
            // Other consequences are the program's, and are handled before its next instruction.
            if told.is_some() || self.one_block.is_broken() || self.now_ns() >= event_ns {
                break;
            }
            // With the registers as at the head and no write in between, the next iteration is the same.
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
        // The last skipped iteration ends before that time.
        let rounds = self.time.until(until_ns).saturating_sub(1).checked_div(round).unwrap_or(0);
        // The skipped instructions count as executed, so that the time advances as it would with them.
        self.time.execute(rounds * round);
        if let Some(profile) = &mut self.profile {
            profile.executed(crate::cpu::take::active(&self.core), rounds * round);
        }
        self.polls.done(true);
    }
}

/// Observation of blocks executed one by one.
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

    /// Records an executed block.
    pub(super) fn executed(&mut self, reads: &[u32], plain: bool) {
        self.reads.extend(reads);
        self.broken |= !plain;
    }
}
