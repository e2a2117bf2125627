//! Interface of every peripheral model.

use std::fmt;

use crate::context::Context;

/// Width of a bus access.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Size {
    /// Access of 8 bits.
    Byte,
    /// Access of 16 bits.
    Half,
    /// Access of 32 bits.
    Word,
}

impl Size {
    /// Returns the width in bytes.
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

/// Register, or a use of one, that the model does not have: it ends the run instead of continuing with a wrong result.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{peripheral}: {what}")]
pub struct Unmodelled {
    /// Name of the peripheral, as in `TIM8`.
    pub peripheral: &'static str,
    /// Register offset, or description of the use.
    pub what: String,
}

impl Unmodelled {
    /// Makes the error for a register that is not modelled.
    #[must_use]
    pub fn register(peripheral: &'static str, offset: u32) -> Self {
        Self { peripheral, what: format!("register at offset {offset:#05x} is not modelled") }
    }
}

/// Peripheral on a bus.
///
/// It computes lazily: its state changes only when it is accessed or its next event is due. `read`, `write` and
/// [`Peripheral::advance`] are called with times that never go back, and first bring it to `context.now_ns`.
pub trait Peripheral {
    /// Reads a register. The offset is that of the access from the base address, not rounded; values are right-aligned.
    ///
    /// # Errors
    /// [`Unmodelled`] for a register or use without a model.
    fn read(&mut self, offset: u32, size: Size, context: &mut Context<'_>) -> Result<u32, Unmodelled>;

    /// Writes a register, with offset and value as for reads.
    ///
    /// # Errors
    /// [`Unmodelled`] for a register or use without a model.
    fn write(&mut self, offset: u32, size: Size, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled>;

    /// Returns the time by which it must be advanced, because others can observe an event then, ns; `u64::MAX` for
    /// never.
    fn next_event_ns(&self) -> u64 {
        u64::MAX
    }

    /// Returns the time until which reads of a register repeat the same value without side effects if nothing is
    /// written and no pin changes, ns; at most [`Peripheral::next_event_ns`]. `None` where that is unknown.
    fn stable_until_ns(&self, _offset: u32, _now_ns: u64) -> Option<u64> {
        None
    }

    /// Advances the peripheral to `context.now_ns`.
    fn advance(&mut self, _context: &mut Context<'_>) {}

    /// Handles a change of the clock tree: called after [`Peripheral::advance`] with the old clocks, with the new ones
    /// in `context`.
    fn clocks_changed(&mut self, _context: &mut Context<'_>) {}

    /// Resets the peripheral, for RCC or a reset of the chip. State of the backup domain stays.
    fn reset(&mut self, context: &mut Context<'_>);
}
