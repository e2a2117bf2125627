//! Coprocessors 10 and 11: nothing of them yet, every instruction is undefined.

/// S0 to S31 as bits; D(n) is S(2n) | S(2n+1) << 32.
#[derive(Clone, Copy)]
pub(crate) struct Registers {
    pub(crate) s: [u32; 32],
    pub(crate) fpscr: u32,
}

/// A decoded floating-point instruction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Float {}

/// What a memory instruction transfers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Transfer {
    /// The register with the address; 15 is PC, aligned.
    pub(crate) base: u8,
    /// From there to the lowest address.
    pub(crate) offset: i32,
    /// What is added to the base register afterwards.
    pub(crate) write_back: i32,
    /// The first register of single precision.
    pub(crate) first: u8,
    /// Registers.
    pub(crate) count: u8,
    /// From memory to registers.
    pub(crate) is_load: bool,
}

/// `None`: undefined.
pub(crate) fn decode(_first: u16, _second: u16) -> Option<Float> {
    None
}

/// What floating-point instructions do to the core's registers.
pub(crate) trait CoreRegisters {
    fn get(&self, n: u8) -> u32;
    fn set(&mut self, n: u8, value: u32);
    fn set_nzcv(&mut self, flags: u32);
}

impl Float {
    /// Memory instructions: what to transfer.
    pub(crate) fn transfer(&self) -> Option<Transfer> {
        match *self {}
    }

    /// The others.
    pub(crate) fn execute(&self, _registers: &mut Registers, _core: &mut impl CoreRegisters) {
        match *self {}
    }
}
