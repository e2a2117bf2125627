//! Operations, the steps that instructions are decoded into.

/// Register number: 0 to 14 are the program's, the others are internal (below).
pub(crate) type Index = u8;

pub(crate) const SP: Index = 13;
pub(crate) const LR: Index = 14;
/// Loaded program counter before the branch; operations do not access PC itself.
pub(crate) const LOADED: Index = 15;
/// Destination of unused results, as of comparisons.
pub(crate) const NONE: Index = 16;
/// Source that always reads zero.
pub(crate) const ZERO: Index = 17;
/// Scratch register between the operations of one instruction.
pub(crate) const SCRATCH: Index = 18;
/// Second register like [`SCRATCH`].
pub(crate) const SCRATCH2: Index = 19;
/// Number of registers; a power of two, so that an index needs no check.
pub(crate) const COUNT: usize = 32;

/// Condition code (DDI0403E A7.3): 0 to 13, and 14 for always.
pub(crate) type Condition = u8;
/// Condition that always holds.
pub(crate) const ALWAYS: Condition = 14;

/// Width and extension of a memory access.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Width {
    Byte,
    Half,
    Word,
}

/// Step of an instruction. `d` is a destination, `n`, `m` and `a` are sources, `t` is transferred. Operations whose
/// name ends in `s` set N and Z, and arithmetic also C and V, shifts C.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Op {
    /// Skips `skip` operations, unless the condition holds.
    Unless {
        condition: Condition,
        skip: u8,
    },
    /// Clears SP's two lowest bits, which are always zero (B1.4.7).
    AlignSp,
    SetCarry {
        carry: bool,
    },

    Value {
        d: Index,
        value: u32,
    },
    Values {
        d: Index,
        value: u32,
    },
    Mov {
        d: Index,
        m: Index,
    },
    Movs {
        d: Index,
        m: Index,
    },
    /// Writes the upper halfword (MOVT).
    Top {
        d: Index,
        value: u16,
    },

    AddValue {
        d: Index,
        n: Index,
        value: u32,
    },
    AddValues {
        d: Index,
        n: Index,
        value: u32,
    },
    SubValues {
        d: Index,
        n: Index,
        value: u32,
    },
    CmpValue {
        n: Index,
        value: u32,
    },
    AndValue {
        d: Index,
        n: Index,
        value: u32,
    },
    AndValues {
        d: Index,
        n: Index,
        value: u32,
    },
    OrrValue {
        d: Index,
        n: Index,
        value: u32,
    },
    OrrValues {
        d: Index,
        n: Index,
        value: u32,
    },
    EorValue {
        d: Index,
        n: Index,
        value: u32,
    },
    EorValues {
        d: Index,
        n: Index,
        value: u32,
    },

    Add {
        d: Index,
        n: Index,
        m: Index,
    },
    Adds {
        d: Index,
        n: Index,
        m: Index,
    },
    AddShifted {
        d: Index,
        n: Index,
        m: Index,
        left: u8,
    },
    Sub {
        d: Index,
        n: Index,
        m: Index,
    },
    Subs {
        d: Index,
        n: Index,
        m: Index,
    },
    Cmp {
        n: Index,
        m: Index,
    },
    Adc {
        d: Index,
        n: Index,
        m: Index,
    },
    Adcs {
        d: Index,
        n: Index,
        m: Index,
    },
    Sbc {
        d: Index,
        n: Index,
        m: Index,
    },
    Sbcs {
        d: Index,
        n: Index,
        m: Index,
    },
    And {
        d: Index,
        n: Index,
        m: Index,
    },
    Ands {
        d: Index,
        n: Index,
        m: Index,
    },
    Orr {
        d: Index,
        n: Index,
        m: Index,
    },
    Orrs {
        d: Index,
        n: Index,
        m: Index,
    },
    Eor {
        d: Index,
        n: Index,
        m: Index,
    },
    Eors {
        d: Index,
        n: Index,
        m: Index,
    },
    Bic {
        d: Index,
        n: Index,
        m: Index,
    },
    Bics {
        d: Index,
        n: Index,
        m: Index,
    },
    Orn {
        d: Index,
        n: Index,
        m: Index,
    },
    Orns {
        d: Index,
        n: Index,
        m: Index,
    },

    /// Shift by a constant of 1 to 31; `Lsrs` and `Asrs` also by 32.
    Lsl {
        d: Index,
        m: Index,
        by: u8,
    },
    Lsls {
        d: Index,
        m: Index,
        by: u8,
    },
    Lsr {
        d: Index,
        m: Index,
        by: u8,
    },
    Lsrs {
        d: Index,
        m: Index,
        by: u8,
    },
    Asr {
        d: Index,
        m: Index,
        by: u8,
    },
    Asrs {
        d: Index,
        m: Index,
        by: u8,
    },
    Ror {
        d: Index,
        m: Index,
        by: u8,
    },
    Rors {
        d: Index,
        m: Index,
        by: u8,
    },
    Rrx {
        d: Index,
        m: Index,
    },
    Rrxs {
        d: Index,
        m: Index,
    },
    /// Shift by a register's lowest byte; the kind is 0 LSL, 1 LSR, 2 ASR, 3 ROR.
    ShiftBy {
        kind: u8,
        d: Index,
        n: Index,
        m: Index,
    },
    ShiftBys {
        kind: u8,
        d: Index,
        n: Index,
        m: Index,
    },

    Mul {
        d: Index,
        n: Index,
        m: Index,
    },
    Muls {
        d: Index,
        n: Index,
        m: Index,
    },
    Mla {
        d: Index,
        n: Index,
        m: Index,
        a: Index,
    },
    Mls {
        d: Index,
        n: Index,
        m: Index,
        a: Index,
    },
    Umull {
        low: Index,
        high: Index,
        n: Index,
        m: Index,
    },
    Smull {
        low: Index,
        high: Index,
        n: Index,
        m: Index,
    },
    Umlal {
        low: Index,
        high: Index,
        n: Index,
        m: Index,
    },
    Smlal {
        low: Index,
        high: Index,
        n: Index,
        m: Index,
    },
    Umaal {
        low: Index,
        high: Index,
        n: Index,
        m: Index,
    },
    Udiv {
        d: Index,
        n: Index,
        m: Index,
    },
    Sdiv {
        d: Index,
        n: Index,
        m: Index,
    },

    Ubfx {
        d: Index,
        n: Index,
        lsb: u8,
        width: u8,
    },
    Sbfx {
        d: Index,
        n: Index,
        lsb: u8,
        width: u8,
    },
    Bfi {
        d: Index,
        n: Index,
        lsb: u8,
        width: u8,
    },
    Uxtb {
        d: Index,
        m: Index,
    },
    Uxth {
        d: Index,
        m: Index,
    },
    Sxtb {
        d: Index,
        m: Index,
    },
    Sxth {
        d: Index,
        m: Index,
    },
    Uxtb16 {
        d: Index,
        m: Index,
    },
    Sxtb16 {
        d: Index,
        m: Index,
    },
    /// Addition of separate halves, without flags.
    AddHalves {
        d: Index,
        n: Index,
        m: Index,
    },
    Rev {
        d: Index,
        m: Index,
    },
    Rev16 {
        d: Index,
        m: Index,
    },
    Revsh {
        d: Index,
        m: Index,
    },
    Rbit {
        d: Index,
        m: Index,
    },
    Clz {
        d: Index,
        m: Index,
    },

    /// Packs the bottom half of `n` and the top half of `m`.
    Pkhbt {
        d: Index,
        n: Index,
        m: Index,
    },
    /// Packs the top half of `n` and the bottom half of `m`.
    Pkhtb {
        d: Index,
        n: Index,
        m: Index,
    },
    Ssat {
        d: Index,
        n: Index,
        bits: u8,
    },
    Usat {
        d: Index,
        n: Index,
        bits: u8,
    },
    Ssat16 {
        d: Index,
        n: Index,
        bits: u8,
    },
    Usat16 {
        d: Index,
        n: Index,
        bits: u8,
    },
    Qadd {
        d: Index,
        n: Index,
        m: Index,
    },
    Qsub {
        d: Index,
        n: Index,
        m: Index,
    },
    Sel {
        d: Index,
        n: Index,
        m: Index,
    },
    /// Parallel addition and subtraction; `State::parallel` in `execute/packed.rs` defines `kind`.
    Parallel {
        kind: u8,
        d: Index,
        n: Index,
        m: Index,
    },
    Usad8 {
        d: Index,
        n: Index,
        m: Index,
    },
    /// Product of halves of `n` (bit 1 of `tops`) and `m` (bit 0); a set bit selects the top half.
    SmulHalves {
        d: Index,
        n: Index,
        m: Index,
        tops: u8,
    },
    /// Product of a word and a half: the upper 32 of 48 bits.
    SmulWide {
        d: Index,
        n: Index,
        m: Index,
        top: bool,
    },
    /// Addition that sets Q on overflow.
    AddSticky {
        d: Index,
        n: Index,
        m: Index,
    },
    /// Adds a sign-extended word to a double word.
    AddLong {
        low: Index,
        high: Index,
        m: Index,
    },
    /// Multiplies both halves and adds the products to `a` (bit 1 of `how`: their difference; bit 0: halves of `m`
    /// exchanged).
    Dual {
        d: Index,
        n: Index,
        m: Index,
        a: Index,
        how: u8,
    },
    DualLong {
        low: Index,
        high: Index,
        n: Index,
        m: Index,
        how: u8,
    },
    /// Upper word of a product, added to `a` (bit 1 of `how`: subtracted from; bit 0: rounded).
    Upper {
        d: Index,
        n: Index,
        m: Index,
        a: Index,
        how: u8,
    },

    Ldr {
        t: Index,
        n: Index,
        offset: u32,
    },
    Ldrb {
        t: Index,
        n: Index,
        offset: u32,
    },
    Ldrh {
        t: Index,
        n: Index,
        offset: u32,
    },
    Ldrsb {
        t: Index,
        n: Index,
        offset: u32,
    },
    Ldrsh {
        t: Index,
        n: Index,
        offset: u32,
    },
    Str {
        t: Index,
        n: Index,
        offset: u32,
    },
    Strb {
        t: Index,
        n: Index,
        offset: u32,
    },
    Strh {
        t: Index,
        n: Index,
        offset: u32,
    },
    LdrBy {
        t: Index,
        n: Index,
        m: Index,
        left: u8,
    },
    LdrbBy {
        t: Index,
        n: Index,
        m: Index,
        left: u8,
    },
    LdrhBy {
        t: Index,
        n: Index,
        m: Index,
        left: u8,
    },
    LdrsbBy {
        t: Index,
        n: Index,
        m: Index,
        left: u8,
    },
    LdrshBy {
        t: Index,
        n: Index,
        m: Index,
        left: u8,
    },
    StrBy {
        t: Index,
        n: Index,
        m: Index,
        left: u8,
    },
    StrbBy {
        t: Index,
        n: Index,
        m: Index,
        left: u8,
    },
    StrhBy {
        t: Index,
        n: Index,
        m: Index,
        left: u8,
    },
    Ldrd {
        t: Index,
        second: Index,
        n: Index,
        offset: u32,
    },
    Strd {
        t: Index,
        second: Index,
        n: Index,
        offset: u32,
    },
    /// Loads the registers of a list from ascending addresses; the lowest is at an offset from `n`.
    Ldm {
        n: Index,
        list: u16,
        offset: i8,
    },
    Stm {
        n: Index,
        list: u16,
        offset: i8,
    },
    Push {
        list: u16,
    },
    Pop {
        list: u16,
    },
    Ldrex {
        width: Width,
        t: Index,
        n: Index,
        offset: u16,
    },
    Strex {
        width: Width,
        d: Index,
        t: Index,
        n: Index,
        words: u8,
    },
    Clrex,

    /// Ends the block and begins the next one of its stretch: its address and number of instructions.
    Onward {
        instructions: u16,
        address: u32,
    },

    /// Branches, the last operations of their block; if one is not taken, the next operation follows.
    Branch {
        target: u32,
    },
    /// Branches for the most frequent conditions: EQ, NE, CS, CC, LT, GE.
    BranchEqual {
        target: u32,
    },
    BranchNotEqual {
        target: u32,
    },
    BranchCarry {
        target: u32,
    },
    BranchNoCarry {
        target: u32,
    },
    BranchLess {
        target: u32,
    },
    BranchNotLess {
        target: u32,
    },
    /// Comparison and the branch after it in one operation; they count as two instructions.
    CmpValueBranch {
        n: Index,
        value: u8,
        condition: Condition,
        target: u32,
    },
    CmpBranch {
        n: Index,
        m: Index,
        condition: Condition,
        target: u32,
    },
    BranchIf {
        condition: Condition,
        target: u32,
    },
    Call {
        target: u32,
    },
    BranchZero {
        n: Index,
        target: u32,
    },
    BranchNotZero {
        n: Index,
        target: u32,
    },
    /// BX, and loads of PC: may change the state, and accept EXC_RETURN.
    Exchange {
        m: Index,
    },
    CallExchange {
        m: Index,
    },
    /// Branch of MOV and ADD to PC.
    BranchTo {
        m: Index,
    },
    /// Table branch, TBB and TBH; `next` is the address after the instruction.
    Table {
        half: bool,
        n: Index,
        m: Index,
        next: u32,
    },

    Mrs {
        d: Index,
        special: u8,
    },
    Msr {
        n: Index,
        special: u8,
        mask: u8,
    },
    /// CPS: bit 0 of `what` is FAULTMASK, bit 1 PRIMASK.
    Cps {
        disable: bool,
        what: u8,
    },
    Wfi,
    Wfe,
    Yield,
    Sev,
    Svc,
    Bkpt {
        operand: u8,
    },
    Undefined,
    /// Instruction of a coprocessor that does not exist.
    NoCoprocessor,
    /// Floating-point instruction, by its index among the decoded ones.
    Float {
        index: u32,
    },
    /// Undefined instruction of the floating-point unit.
    FloatUndefined,
}

impl Op {
    /// Returns true for operations that only load, compute or branch.
    pub(crate) fn only_looks(&self) -> bool {
        !matches!(
            self,
            Self::Str { .. }
                | Self::Strb { .. }
                | Self::Strh { .. }
                | Self::StrBy { .. }
                | Self::StrbBy { .. }
                | Self::StrhBy { .. }
                | Self::Strd { .. }
                | Self::Stm { .. }
                | Self::Push { .. }
                | Self::Ldrex { .. }
                | Self::Strex { .. }
                | Self::Clrex
                | Self::Msr { .. }
                | Self::Cps { .. }
                | Self::Wfi
                | Self::Wfe
                | Self::Yield
                | Self::Sev
                | Self::Svc
                | Self::Bkpt { .. }
                | Self::Undefined
                | Self::NoCoprocessor
                | Self::Float { .. }
                | Self::FloatUndefined
        )
    }
}

/// Operations are read in sequence and there are many, so their size matters.
const _: () = assert!(size_of::<Op>() == 8);
