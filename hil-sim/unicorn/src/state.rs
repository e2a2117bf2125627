//! State of the hooks during a run.

use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;
use std::ptr::NonNull;
use std::rc::Rc;

use r4_mcu::cpu::{CoreBus, CoreError, Limits, Why};

use unicorn_engine::UcHookId;

use crate::blocks::{Block, Cache};
use crate::hooks::CACHED_FROM;

/// Code that the core can fetch: the address of its first byte, and the bytes.
pub(crate) type CodeMemory = (u32, Rc<[Cell<u8>]>);

/// Access that a permission hook made, whose result the I/O callback returns.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Window {
    /// Address, rounded down to the width of the access.
    pub(crate) base: u32,
    /// Bytes from `base` on.
    pub(crate) bytes: [u8; 16],
    /// Address range of a store that the translator repeats byte by byte: these repeats are not accesses.
    pub(crate) repeated: (u32, u32),
}

/// State shared by the hooks.
pub(crate) struct State {
    /// Bus of the present run; `None` between runs.
    pub(crate) bus: Option<NonNull<dyn CoreBus>>,
    /// Memories that the core can execute from.
    pub(crate) code: Vec<CodeMemory>,
    pub(crate) cache: Cache,
    /// Cache of parts of blocks, up to an instruction that has made an access.
    pub(crate) parts: RefCell<Cache>,
    /// Hooks for accesses to memories that are not, or not wholly, direct; by base address.
    pub(crate) access_hooks: BTreeMap<u64, [UcHookId; 2]>,
    /// Block that was begun last.
    pub(crate) block: Block,
    /// Number of instructions in this run, up to the end of `block`.
    pub(crate) executed: u64,
    pub(crate) limits: Limits,
    /// Values of PRIMASK, BASEPRI, FAULTMASK when `limits` were read.
    pub(crate) masks: [u32; 3],
    /// Reason for which a hook stops the run; `None` without one.
    pub(crate) why: Option<Why>,
    /// Address at which a hook before an instruction stops.
    pub(crate) stop_at: u32,
    /// Address of the first floating-point instruction of a block in which it is not allowed.
    pub(crate) float_at: Option<u32>,
    /// Exception that the translator raised.
    pub(crate) exception: Option<u32>,
    pub(crate) window: Window,
    /// Address of the run's first instruction, which is executed even if observed.
    pub(crate) first: Option<u32>,
    pub(crate) fpu: bool,
    /// True if the exclusive monitor may be set.
    pub(crate) claimed: bool,
    pub(crate) error: Option<CoreError>,
}

impl State {
    pub(crate) fn new() -> Self {
        Self {
            bus: None,
            code: Vec::new(),
            cache: Cache::new(),
            parts: RefCell::new(Cache::new()),
            access_hooks: BTreeMap::new(),
            block: Block::NONE,
            executed: 0,
            limits: Limits { instructions: 0, mask_changes: false },
            masks: [0; 3],
            why: None,
            stop_at: 0,
            float_at: None,
            exception: None,
            window: Window::default(),
            first: None,
            fpu: false,
            claimed: false,
            error: None,
        }
    }

    /// Resets the state for a new run from `pc`.
    pub(crate) fn begin(&mut self, pc: u32) {
        self.block = Block::NONE;
        self.executed = 0;
        self.why = None;
        self.float_at = None;
        self.exception = None;
        self.window = Window::default();
        self.first = Some(pc);
        self.error = None;
    }

    /// Bus of the present run.
    #[allow(unsafe_code, reason = "the bus is lent to hooks for one run")]
    pub(crate) fn bus(&mut self) -> &mut dyn CoreBus {
        let bus = self.bus.as_mut().expect("hooks run within a run only");
        // SAFETY: `UnicornCore::run` sets it from a `&mut dyn CoreBus` that it holds for the whole run and does not use
        // meanwhile, and clears it at the end; hooks run within that and one at a time.
        unsafe { bus.as_mut() }
    }

    /// Bytes of code in `from..to`; empty where that is not executable memory.
    pub(crate) fn code(&self, from: u32, to: u32) -> &[Cell<u8>] {
        slice(&self.code, from, to)
    }

    /// Number of instructions of this run before `pc`, which is in the present block.
    pub(crate) fn instructions_before(&self, pc: u32) -> u64 {
        let whole = u64::from(self.block.instructions);
        if pc < self.block.address || pc >= self.block.end() {
            return self.executed;
        }
        let (address, bytes) = (self.block.address, pc - self.block.address);
        let decode = || Block::decode(address, self.code(address, pc));
        let part = if address >= CACHED_FROM {
            self.parts.borrow_mut().get(address, bytes, decode).instructions
        } else {
            decode().instructions
        };
        self.executed - whole + u64::from(part)
    }
}

pub(crate) fn slice(memories: &[CodeMemory], from: u32, to: u32) -> &[Cell<u8>] {
    memories
        .iter()
        .find_map(|(base, bytes)| bytes.get(from.checked_sub(*base)? as usize..to.checked_sub(*base)? as usize))
        .unwrap_or(&[])
}
