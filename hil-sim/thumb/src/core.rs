//! Core that connects interpreter, cache and machine: [`ThumbCore`].

use r4_mcu::Region;
use r4_mcu::cpu::{Core, CoreBus, CoreError, CoreStop, Fault, Protection, Register, Why};

use crate::blocks::{Block, Blocks};
use crate::decode::What;
use crate::execute::execute;
use crate::operation::Op;
use crate::state::State;

/// Interpreter for the instruction set of a Cortex-M7.
pub struct ThumbCore {
    state: State,
    blocks: Blocks,
    observed: Vec<u32>,
    /// The last run stopped within a block.
    within: bool,
}

impl Default for ThumbCore {
    fn default() -> Self {
        Self::new()
    }
}

impl ThumbCore {
    /// Makes a processor without memory: call [`Core::map`] next.
    #[must_use]
    pub fn new() -> Self {
        Self { state: State::new(), blocks: Blocks::new(), observed: Vec::new(), within: false }
    }

    fn forget(&mut self) {
        self.blocks.clear();
        self.state.stale = false;
        self.state.memory.forget_code();
    }

    /// Handles the rare conditions before a block; `Some` ends the run.
    #[cold]
    fn attention(&mut self, bus: &mut dyn CoreBus) -> Option<Why> {
        if self.state.stale {
            self.forget();
            self.state.refresh_limits(bus);
        }
        if self.state.limits.mask_changes && self.state.masks() != self.state.masks {
            return Some(Why::MaskChanged);
        }
        if self.state.executed >= self.state.limits.instructions {
            // The bus does the work that is due and may set a later limit; otherwise the run ends.
            bus.reached(self.state.executed);
            self.state.refresh_limits(bus);
            if self.state.executed >= self.state.limits.instructions {
                return Some(Why::Limit);
            }
        }
        None
    }

    /// Returns the number of the block at PC and decodes it if necessary; `None` where no instruction can be fetched.
    #[cold]
    fn find(&mut self) -> Option<u32> {
        let State { memory, it, pc, .. } = &mut self.state;
        let what = What { memory, observed: &self.observed, it: *it, one: false };
        // Within an IT block the decoding depends on ITSTATE, so such blocks are not found by their address.
        if *it == 0 { self.blocks.find(*pc, &what) } else { self.blocks.add(*pc, &what) }
    }

    /// Executes a block with observed instructions up to the first of them.
    #[cold]
    fn execute_observed(&mut self, block: &Block, is_first: bool, bus: &mut dyn CoreBus) -> Option<Why> {
        let Some((ops, address)) = self.blocks.observed(block, self.state.it, is_first) else {
            return execute(&mut self.state, &self.blocks, block, false, bus);
        };
        if address == block.address {
            return Some(Why::Observed);
        }
        // The part before it is not the end of the block, and does not branch.
        let instructions = self.instructions_before(block, address);
        let before = block.beginning(address, ops, instructions);
        let why = execute(&mut self.state, &self.blocks, &before, false, bus);
        self.within = why.is_none();
        Some(why.unwrap_or(Why::Observed))
    }

    /// Counts the instructions of a block before `address`.
    fn instructions_before(&self, block: &Block, address: u32) -> u16 {
        let (mut at, mut count) = (block.address, 0);
        // Merged operations hide instruction borders, so the instructions are counted in memory.
        while at != address {
            let Some(first) = self.state.memory.fetch(at) else { break };
            at = at.wrapping_add(if crate::decode::is_wide(first) { 4 } else { 2 });
            count += 1;
        }
        count
    }

    fn begin(&mut self, bus: &mut dyn CoreBus) {
        self.within = false;
        self.state.executed = 0;
        self.state.error = None;
        self.blocks.make_room();
        self.state.refresh_limits(bus);
    }

    fn finish(&mut self, why: Why) -> Result<CoreStop, CoreError> {
        match self.state.error.take() {
            Some(error) => Err(error),
            None => Ok(CoreStop { instructions: self.state.executed, why }),
        }
    }

    /// Executes blocks until the run ends; returns the reason.
    fn until_stop(&mut self, bus: &mut dyn CoreBus) -> Why {
        let mut is_first = true;
        loop {
            // A single comparison covers the limit and the slow checks, which set `attention_at` to 0.
            if self.state.executed >= self.state.attention_at
                && let Some(why) = self.attention(bus)
            {
                return why;
            }
            if !self.state.thumb {
                return Why::Fault(Fault::InvalidState);
            }
            // The table has only blocks that begin outside IT blocks.
            let known = if self.state.it == 0 { self.blocks.number(self.state.pc) } else { None };
            let number = known.or_else(|| self.find());
            let Some(block) = number.and_then(|number| self.blocks.by_number(number)) else {
                return Why::Fault(Fault::Fetch);
            };
            let why = if block.observed {
                // The copy ends the borrow of `blocks`, which executing a part needs.
                let block = block.clone();
                self.execute_observed(&block, is_first, bus)
            } else {
                let chain = block.it == 0 && self.state.it == 0;
                execute(&mut self.state, &self.blocks, block, chain, bus)
            };
            if let Some(why) = why {
                return why;
            }
            is_first = false;
        }
    }

    /// Executes a single instruction, or nothing if the run ends before it.
    fn one(&mut self, bus: &mut dyn CoreBus) -> Why {
        if let Some(why) = self.attention(bus) {
            return why;
        }
        if !self.state.thumb {
            return Why::Fault(Fault::InvalidState);
        }
        let (pc, it) = (self.state.pc, self.state.it);
        // Two decodings: one instruction alone, and the whole block, to see if a part of it remains.
        let decode =
            |core: &mut Self, one| core.blocks.add(pc, &What { memory: &core.state.memory, observed: &[], it, one });
        let numbers = (decode(self, true), decode(self, false));
        let by_number = |number: Option<u32>| number.and_then(|number| self.blocks.by_number(number));
        let (Some(block), Some(whole)) = (by_number(numbers.0), by_number(numbers.1)) else {
            return Why::Fault(Fault::Fetch);
        };
        let part = block.instructions < whole.instructions;
        let why = execute(&mut self.state, &self.blocks, block, false, bus);
        self.within = why.is_none() && part;
        why.unwrap_or(Why::Observed)
    }
}

impl Core for ThumbCore {
    fn map(&mut self, regions: &[Region]) -> Result<(), CoreError> {
        self.remap(regions)
    }

    fn remap(&mut self, regions: &[Region]) -> Result<(), CoreError> {
        self.forget();
        self.state.memory.map(regions)
    }

    fn code_changed(&mut self) -> Result<(), CoreError> {
        self.forget();
        Ok(())
    }

    fn protect(&mut self, protection: Option<&Protection>) -> Result<(), CoreError> {
        self.forget();
        self.state.memory.protect(protection.cloned())
    }

    fn get(&self, register: Register) -> u32 {
        self.state.get(register)
    }

    fn set(&mut self, register: Register, value: u32) {
        self.state.set(register, value);
    }

    fn set_fpu(&mut self, on: bool) {
        self.state.fpu = on;
    }

    fn clear_exclusive(&mut self) -> Result<(), CoreError> {
        self.state.exclusive = None;
        Ok(())
    }

    fn observe(&mut self, addresses: &[u32]) -> Result<(), CoreError> {
        self.observed = addresses.to_vec();
        self.forget();
        Ok(())
    }

    fn run(&mut self, bus: &mut dyn CoreBus) -> Result<CoreStop, CoreError> {
        self.begin(bus);
        let why = self.until_stop(bus);
        self.finish(why)
    }

    fn step(&mut self, bus: &mut dyn CoreBus) -> Result<CoreStop, CoreError> {
        self.begin(bus);
        let why = self.one(bus);
        self.finish(why)
    }

    fn only_looks(&self) -> bool {
        let number = if self.state.it == 0 { self.blocks.number(self.state.pc) } else { None };
        let block = number.and_then(|number| self.blocks.by_number(number));
        // The rest of its stretch is another block, before which limits are checked.
        let own = |op: &&Op| !matches!(op, Op::Onward { .. });
        block.is_some_and(|block| self.blocks.ops(block).iter().take_while(own).all(Op::only_looks))
    }

    fn is_within_block(&self) -> bool {
        self.within
    }
}
