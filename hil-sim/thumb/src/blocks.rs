//! Cache of decoded blocks, by address.

use std::cell::Cell;
use std::collections::HashMap;

use crate::decode::{self, Position, What};
use crate::float::Float;
use crate::operation::Op;

/// Head of a stretch (superblock): its address, and the place of its operations in the store.
#[derive(Clone, Debug)]
pub(crate) struct Block {
    pub(crate) address: u32,
    /// Address after its last instruction.
    pub(crate) end: u32,
    first: u32,
    len: u16,
    /// Number of instructions in the first block.
    pub(crate) instructions: u16,
    /// ITSTATE after the stretch.
    pub(crate) it: u8,
    /// Some of its instructions are observed, so that runs stop before them.
    pub(crate) observed: bool,
    /// Number of the block that begins at `end`, once it was executed.
    after: Cell<u32>,
    /// Last branch targets with the numbers of their blocks; a target's address selects its slot.
    branched: [Cell<(u32, u32)>; Self::BRANCHES],
}

impl Block {
    const BRANCHES: usize = 4;

    #[inline(always)]
    fn branched(&self, address: u32) -> &Cell<(u32, u32)> {
        &self.branched[address as usize / 2 % Self::BRANCHES]
    }

    /// Returns the front part of the block, up to the instruction at `end`, which is not in an IT block.
    pub(crate) fn beginning(&self, end: u32, len: u16, instructions: u16) -> Self {
        let (after, branched) = unlinked();
        Self { end, len, instructions, it: 0, after, branched, ..*self }
    }
}

/// Block number that means no block.
const NONE: u32 = u32::MAX;

/// Links of a block without known successors.
fn unlinked() -> (Cell<u32>, [Cell<(u32, u32)>; Block::BRANCHES]) {
    (Cell::new(NONE), std::array::from_fn(|_| Cell::new((NONE, NONE))))
}

/// Operations of all blocks, one after the other.
#[derive(Default)]
struct Store {
    ops: Vec<Op>,
    positions: Vec<Position>,
    floats: Vec<Float>,
}

/// All decoded blocks. `table` is a direct-mapped cache by address; its blocks contain no observed instruction and do
/// not end within an IT block. `known` has all others too. A block remembers its successors.
pub(crate) struct Blocks {
    blocks: Vec<Block>,
    table: Box<[u32; Self::LEN]>,
    known: HashMap<u32, u32>,
    /// Stop points in blocks with observed instructions: the number of operations before each, and its address. The key
    /// is the block's address and the ITSTATE there.
    observed: HashMap<(u32, u8), Vec<(u16, u32)>>,
    store: Store,
}

impl Blocks {
    const LEN: usize = 1 << 16;
    /// Largest number of stored operations; beyond it the cache is cleared, because changing code is decoded again and
    /// again.
    const MANY: usize = 1 << 22;

    pub(crate) fn new() -> Self {
        Self {
            blocks: Vec::new(),
            table: Box::new([NONE; Self::LEN]),
            known: HashMap::new(),
            observed: HashMap::new(),
            store: Store::default(),
        }
    }

    pub(crate) fn clear(&mut self) {
        if self.blocks.is_empty() {
            return;
        }
        self.blocks.clear();
        self.table.fill(NONE);
        self.known.clear();
        self.observed.clear();
        self.store.ops.clear();
        self.store.positions.clear();
        self.store.floats.clear();
    }

    /// Returns the number of the block at an address, if it is in the direct-mapped table.
    #[inline(always)]
    pub(crate) fn number(&self, address: u32) -> Option<u32> {
        let number = self.table[address as usize / 2 % Self::LEN];
        let block = self.blocks.get(number as usize)?;
        (block.address == address).then_some(number)
    }

    /// Returns the block at `address` that follows `before`, if both are known.
    #[inline(always)]
    pub(crate) fn follow(&self, before: &Block, address: u32) -> Option<&Block> {
        let number = if address == before.end {
            before.after.get()
        } else {
            let (to, number) = before.branched(address).get();
            if to == address { number } else { NONE }
        };
        match self.blocks.get(number as usize) {
            Some(block) => Some(block),
            None => self.join(before, address),
        }
    }

    #[inline(never)]
    fn join(&self, before: &Block, address: u32) -> Option<&Block> {
        let number = self.number(address)?;
        if address == before.end {
            before.after.set(number);
        } else {
            before.branched(address).set((address, number));
        }
        self.by_number(number)
    }

    /// Returns the number of the block at an address and decodes it if necessary; `None` where no instruction can be
    /// fetched.
    #[cold]
    pub(crate) fn find(&mut self, address: u32, what: &What<'_>) -> Option<u32> {
        let number = match self.known.get(&address) {
            Some(number) => *number,
            None => {
                self.make_room();
                let number = self.add(address, what)?;
                self.known.insert(address, number);
                number
            }
        };
        let block = self.blocks.get(number as usize)?;
        // Blocks that need checks before or after them stay out of the fast table.
        if !block.observed && block.it == 0 {
            self.table[address as usize / 2 % Self::LEN] = number;
        }
        Some(number)
    }

    /// Clears the cache if it has grown too large.
    pub(crate) fn make_room(&mut self) {
        if self.store.ops.len() > Self::MANY {
            self.clear();
        }
    }

    /// Decodes a block without entering it in `known`: only its number finds it again.
    pub(crate) fn add(&mut self, address: u32, what: &What<'_>) -> Option<u32> {
        let decoded = decode::stretch(address, what, &mut self.store.floats)?;
        let first = self.store.ops.len() as u32;
        let len = decoded.ops.len() as u16;
        self.store.ops.extend(decoded.ops);
        self.store.positions.extend(decoded.positions);
        let observed = !decoded.observed.is_empty();
        if observed {
            self.observed.insert((address, what.it), decoded.observed);
        }
        let (end, instructions, it) = (decoded.end, decoded.instructions, decoded.it);
        let number = self.blocks.len() as u32;
        let (after, branched) = unlinked();
        self.blocks.push(Block { address, end, first, len, instructions, it, observed, after, branched });
        Some(number)
    }

    /// Returns the number of operations before the first observed instruction of a block, and its address; skips the
    /// first instruction if `executes_first`.
    pub(crate) fn observed(&self, block: &Block, it: u8, executes_first: bool) -> Option<(u16, u32)> {
        let stops = self.observed.get(&(block.address, it))?;
        stops.iter().find(|(_, address)| !(executes_first && *address == block.address)).copied()
    }

    /// Returns a block by its number.
    pub(crate) fn by_number(&self, number: u32) -> Option<&Block> {
        self.blocks.get(number as usize)
    }

    #[inline(always)]
    pub(crate) fn ops(&self, block: &Block) -> &[Op] {
        let first = block.first as usize;
        self.store.ops.get(first..first + usize::from(block.len)).unwrap_or(&[])
    }

    #[inline(always)]
    pub(crate) fn positions(&self, block: &Block) -> &[Position] {
        let first = block.first as usize;
        self.store.positions.get(first..first + usize::from(block.len)).unwrap_or(&[])
    }

    pub(crate) fn floats(&self) -> &[Float] {
        &self.store.floats
    }
}
