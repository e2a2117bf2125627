//! Blocks that were decoded, by address.

use std::collections::HashMap;

use crate::decode::{self, Position, What};
use crate::float::Float;
use crate::operation::Op;

/// A block: where it is, and where its operations are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Block {
    pub(crate) address: u32,
    /// After its last instruction.
    pub(crate) end: u32,
    pub(crate) first: u32,
    pub(crate) len: u16,
    pub(crate) instructions: u16,
    /// ITSTATE after it.
    pub(crate) it: u8,
    /// Some of its instructions are observed.
    pub(crate) observed: bool,
}

impl Block {
    /// None: at an odd address.
    const NONE: Self = Self { address: 1, end: 1, first: 0, len: 0, instructions: 0, it: 0, observed: false };
}

/// Operations of many blocks, one after the other.
#[derive(Default)]
struct Store {
    ops: Vec<Op>,
    positions: Vec<Position>,
    floats: Vec<Float>,
}

/// All blocks. A table has those used last: nothing in them is observed, and they do not end within an IT block. Whatever
/// else is known is behind it.
pub(crate) struct Blocks {
    table: Box<[Block; Self::LEN]>,
    known: HashMap<u32, Block>,
    /// Operations before which observed instructions are, and those instructions, of blocks that have some: by
    /// address and ITSTATE at it.
    observed: HashMap<(u32, u8), Vec<(u16, u32)>>,
    store: Store,
}

impl Blocks {
    const LEN: usize = 1 << 15;
    /// Operations that are kept at most, before all are forgotten: code that changes is decoded again and again.
    const MANY: usize = 1 << 22;

    pub(crate) fn new() -> Self {
        Self {
            table: Box::new([Block::NONE; Self::LEN]),
            known: HashMap::new(),
            observed: HashMap::new(),
            store: Store::default(),
        }
    }

    pub(crate) fn clear(&mut self) {
        self.table.fill(Block::NONE);
        self.known.clear();
        self.observed.clear();
        self.store.ops.clear();
        self.store.positions.clear();
        self.store.floats.clear();
    }

    /// The block at an address, if it was used lately.
    #[inline(always)]
    pub(crate) fn get(&self, address: u32) -> Option<&Block> {
        let block = &self.table[address as usize / 2 % Self::LEN];
        (block.address == address).then_some(block)
    }

    /// The block at an address, decoded if need be; `None` where nothing can be fetched.
    #[cold]
    pub(crate) fn find(&mut self, address: u32, what: &What<'_>) -> Option<Block> {
        let block = match self.known.get(&address) {
            Some(block) => *block,
            None => {
                self.make_room();
                let block = self.add(address, what)?;
                self.known.insert(address, block);
                block
            }
        };
        // What needs a look before or after it is not found at once.
        if !block.observed && block.it == 0 {
            self.table[address as usize / 2 % Self::LEN] = block;
        }
        Some(block)
    }

    /// Forgets everything, if it is much.
    pub(crate) fn make_room(&mut self) {
        if self.store.ops.len() > Self::MANY {
            self.clear();
        }
    }

    /// Decodes a block, which is not found again.
    pub(crate) fn add(&mut self, address: u32, what: &What<'_>) -> Option<Block> {
        let decoded = decode::block(address, what, &mut self.store.floats)?;
        let first = self.store.ops.len() as u32;
        let len = decoded.ops.len() as u16;
        self.store.ops.extend(decoded.ops);
        self.store.positions.extend(decoded.positions);
        let observed = !decoded.observed.is_empty();
        if observed {
            self.observed.insert((address, what.it), decoded.observed);
        }
        let (end, instructions, it) = (decoded.end, decoded.instructions, decoded.it);
        Some(Block { address, end, first, len, instructions, it, observed })
    }

    /// Operations before the first observed instruction of a block, and its address; not that at the beginning, if that
    /// is to be executed.
    pub(crate) fn observed(&self, block: &Block, it: u8, executes_first: bool) -> Option<(u16, u32)> {
        let stops = self.observed.get(&(block.address, it))?;
        stops.iter().find(|(_, address)| !(executes_first && *address == block.address)).copied()
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
