//! What the hooks know during a run.

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

/// An access that a permission hook made, whose result the I/O callback hands over.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Window {
    /// The address, rounded down to the width of the access.
    pub(crate) base: u32,
    /// Bytes from there on.
    pub(crate) bytes: [u8; 16],
    /// A store that the translator repeats byte by byte: of what follows, these addresses are not accesses.
    pub(crate) repeated: (u32, u32),
}

/// State shared by hooks.
pub(crate) struct State {
    /// The bus of the present run.
    pub(crate) bus: Option<NonNull<dyn CoreBus>>,
    /// Executable memories.
    pub(crate) code: Vec<CodeMemory>,
    pub(crate) cache: Cache,
    /// Blocks as far as an instruction that has made an access.
    pub(crate) parts: RefCell<Cache>,
    /// Hooks for accesses to memories that are not, or not wholly, direct; by base address.
    pub(crate) access_hooks: BTreeMap<u64, [UcHookId; 2]>,
    /// The block that was begun last.
    pub(crate) block: Block,
    /// Instructions of this run, up to the end of `block`.
    pub(crate) executed: u64,
    pub(crate) limits: Limits,
    /// PRIMASK, BASEPRI, FAULTMASK when `limits` were asked for.
    pub(crate) masks: [u32; 3],
    /// A hook wants to stop, and why.
    pub(crate) why: Option<Why>,
    /// Where a hook before an instruction wants to stop.
    pub(crate) stop_at: u32,
    /// A block begins with, or holds, floating point that is not allowed, from here.
    pub(crate) float_at: Option<u32>,
    /// The exception that the translator raised.
    pub(crate) exception: Option<u32>,
    pub(crate) window: Window,
    /// The first instruction of the run: observed or not, it is executed.
    pub(crate) first: Option<u32>,
    pub(crate) fpu: bool,
    /// The exclusive monitor may be set.
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

    /// Forgets the run before.
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

    /// The bus of the present run.
    #[allow(unsafe_code, reason = "the bus is lent to hooks for one run")]
    pub(crate) fn bus(&mut self) -> &mut dyn CoreBus {
        let bus = self.bus.as_mut().expect("hooks run within a run only");
        // SAFETY: `UnicornCore::run` sets it from a `&mut dyn CoreBus` that it holds for the whole run and does not use
        // meanwhile, and clears it at the end; hooks run within that and one at a time.
        unsafe { bus.as_mut() }
    }

    /// Bytes of code in `from..to`; none where that is not executable memory.
    pub(crate) fn code(&self, from: u32, to: u32) -> &[Cell<u8>] {
        slice(&self.code, from, to)
    }

    /// The present block as far as `pc`.
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
