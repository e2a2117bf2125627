//! What every peripheral is.

use std::fmt;

use crate::context::Context;

/// Width of an access.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Size {
    /// 8 bits.
    Byte,
    /// 16 bits.
    Half,
    /// 32 bits.
    Word,
}

impl Size {
    /// In bytes.
    #[must_use]
    pub const fn bytes(self) -> u32 {
        match self {
            Self::Byte => 1,
            Self::Half => 2,
            Self::Word => 4,
        }
    }
}

impl fmt::Display for Size {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Byte => "byte",
            Self::Half => "half-word",
            Self::Word => "word",
        })
    }
}

/// A register, or a use of one, that the model does not have: the run ends, rather than go on with something else.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{peripheral}: {what}")]
pub struct Unmodelled {
    /// As in `TIM8`.
    pub peripheral: &'static str,
    /// Register offset, or the use.
    pub what: String,
}

impl Unmodelled {
    /// A register that is not modelled.
    #[must_use]
    pub fn register(peripheral: &'static str, offset: u32) -> Self {
        Self { peripheral, what: format!("register at offset {offset:#05x} is not modelled") }
    }
}

/// A peripheral on a bus.
///
/// It computes lazily: nothing happens in it until it is accessed or its next event is due. `read`, `write` and
/// [`Peripheral::advance`] are called with times that never go back, and first bring it to `context.now_ns`.
pub trait Peripheral {
    /// Reads a register. The offset is that from its base address, not rounded; values are right-aligned.
    ///
    /// # Errors
    /// What is not modelled.
    fn read(&mut self, offset: u32, size: Size, context: &mut Context<'_>) -> Result<u32, Unmodelled>;

    /// Writes a register.
    ///
    /// # Errors
    /// What is not modelled.
    fn write(&mut self, offset: u32, size: Size, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled>;

    /// When it must be advanced at the latest, because something others can see happens then; `u64::MAX` is never.
    fn next_event_ns(&self) -> u64 {
        u64::MAX
    }

    /// Until when reads of a register give the same again and change nothing, if nothing is written and no pin changes: at most
    /// [`Peripheral::next_event_ns`]. `None` where that is not known.
    fn stable_until_ns(&self, _offset: u32, _now_ns: u64) -> Option<u64> {
        None
    }

    /// Brings it to `context.now_ns`.
    fn advance(&mut self, _context: &mut Context<'_>) {}

    /// The clock tree changes now: called after [`Peripheral::advance`] with the old clocks, with the new ones in `context`.
    fn clocks_changed(&mut self, _context: &mut Context<'_>) {}

    /// Reset by RCC or a reset of the chip. What survives that (the backup domain) stays.
    fn reset(&mut self, context: &mut Context<'_>);
}
