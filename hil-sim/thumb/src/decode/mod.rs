//! Decoder from instructions to operations (DDI0403E A5).

mod narrow;
mod wide;
mod wide_data;
mod wide_memory;

use crate::float::{self, Float};
use crate::memory::Memory;
use crate::operation::{ALWAYS, Condition, Index, NONE, Op, SCRATCH, SP, ZERO};

/// Size of a line, bytes: a block ends where an instruction would begin in the next line.
const LINE: u32 = 128;

/// Origin of an operation in the program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Position {
    /// Number of instructions of the block before its own.
    pub(crate) instruction: u16,
    /// Address of its instruction.
    pub(crate) address: u32,
    /// ITSTATE at its instruction.
    pub(crate) it: u8,
}

/// Result of decoding a block of instructions.
#[derive(Default)]
pub(crate) struct Decoded {
    pub(crate) ops: Vec<Op>,
    /// Origin of each operation, in the same order.
    pub(crate) positions: Vec<Position>,
    /// Address after the last instruction.
    pub(crate) end: u32,
    pub(crate) instructions: u16,
    /// ITSTATE after the last instruction.
    pub(crate) it: u8,
    /// The block ends at the end of a line, and not with a branch.
    pub(crate) full: bool,
    /// Observed instructions outside IT blocks: the number of operations before each, and its address.
    pub(crate) observed: Vec<(u16, u32)>,
}

/// Conditions of decoding, apart from the address.
#[derive(Clone, Copy)]
pub(crate) struct What<'a> {
    pub(crate) memory: &'a Memory,
    pub(crate) observed: &'a [u32],
    /// ITSTATE at the first instruction.
    pub(crate) it: u8,
    /// Decode only the first instruction, with those it makes conditional.
    pub(crate) one: bool,
}

/// Continuation of the block after an instruction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Then {
    Next,
    End,
}

/// Decoder state for one instruction.
struct Instruction<'a> {
    ops: &'a mut Vec<Op>,
    floats: &'a mut Vec<Float>,
    memory: &'a Memory,
    address: u32,
    /// The instruction is within an IT block: narrow instructions do not set flags (A5.2).
    conditional: bool,
    /// The instruction may be merged with the one before it, which is always executed and is no stop point.
    joins: bool,
}

/// Advances ITSTATE by one instruction (A7.3.3).
fn advanced(it: u8) -> u8 {
    if it & 7 == 0 { 0 } else { it & 0xE0 | it << 1 & 0x1F }
}

/// Returns true if the instruction has two halfwords (A5.1).
pub(crate) fn is_wide(first: u16) -> bool {
    first >> 11 >= 0b11101
}

/// Number of operations at which a stretch is not extended any more.
const LONG: usize = 32;

/// Decodes the stretch at an address: a block, and the blocks that are likely to follow it. `None` where no instruction
/// can be fetched.
pub(crate) fn stretch(address: u32, what: &What<'_>, floats: &mut Vec<Float>) -> Option<Decoded> {
    let mut stretch = block(address, what, floats)?;
    // Stop points and IT blocks need single blocks.
    let goes_on = what.it == 0 && what.observed.is_empty() && !what.one;
    while goes_on && stretch.ops.len() < LONG {
        let Some(next) = stretch.next() else { break };
        let Some(mut more) = block(next, what, floats).filter(|block| block.it == 0) else { break };
        // Execution simply continues in the target's operations.
        if let Some(Op::Branch { .. }) = stretch.ops.last() {
            stretch.ops.pop();
        }
        stretch.ops.push(Op::Onward { instructions: more.instructions, address: next });
        // Positions have one entry per operation; that of the removed branch is replaced.
        stretch.positions.truncate(stretch.ops.len() - 1);
        stretch.positions.push(Position { instruction: 0, address: next, it: 0 });
        stretch.ops.append(&mut more.ops);
        stretch.positions.append(&mut more.positions);
        (stretch.end, stretch.full) = (more.end, more.full);
    }
    Some(stretch)
}

impl Decoded {
    /// Returns the address at which the stretch continues; `None` if it branches away or ends in an IT block.
    fn next(&self) -> Option<u32> {
        let last = self.ops.last()?;
        if self.it != 0 || self.positions.last()?.it != 0 && !self.full {
            return None;
        }
        match last {
            _ if self.full => Some(self.end),
            Op::Branch { target } => Some(*target),
            Op::BranchEqual { .. }
            | Op::BranchNotEqual { .. }
            | Op::BranchCarry { .. }
            | Op::BranchNoCarry { .. }
            | Op::BranchLess { .. }
            | Op::BranchNotLess { .. }
            | Op::CmpValueBranch { .. }
            | Op::CmpBranch { .. }
            | Op::BranchIf { .. }
            | Op::BranchZero { .. }
            | Op::BranchNotZero { .. } => Some(self.end),
            _ => None,
        }
    }
}

/// Decodes the block at an address; `None` where no instruction can be fetched.
pub(crate) fn block(address: u32, what: &What<'_>, floats: &mut Vec<Float>) -> Option<Decoded> {
    let mut block = Decoded { end: address, it: what.it, ..Decoded::default() };
    // Last `Unless` whose condition still holds, with the number of the operation after it.
    let mut open: Option<(Condition, usize)> = None;
    // Stop point of an instruction within an IT block: before the IT, if that is in this block.
    let mut outside = None;
    loop {
        let at = block.end;
        let within = block.it != 0;
        // The end of a line ends a block, but not within an IT block, which must stay together.
        let full = block.instructions > 0 && !within && (at ^ address) >= LINE;
        if full || what.one && block.instructions > 0 && !within {
            block.full = full;
            break;
        }
        let Some(first) = what.memory.fetch(at) else { break };
        let second = if is_wide(first) {
            let Some(second) = what.memory.fetch(at.wrapping_add(2)) else { break };
            second
        } else {
            0
        };
        if !within {
            outside = Some((block.ops.len() as u16, at));
        }
        if let Some(stop) = outside.filter(|stop| what.observed.contains(&at) && !block.observed.contains(stop)) {
            block.observed.push(stop);
        }
        let position = Position { instruction: block.instructions, address: at, it: block.it };
        // BKPT is executed whatever the condition in an IT block is (A7.7.17).
        let unconditional = !within || first & 0xFF00 == 0xBE00;
        let condition = if unconditional { ALWAYS } else { (block.it >> 4).min(ALWAYS) };
        // Operations join the previous condition if it is the same and the flags have not changed.
        if condition == ALWAYS || open.is_none_or(|(before, _)| before != condition) {
            open = None;
        }
        if condition != ALWAYS && open.is_none() {
            block.ops.push(Op::Unless { condition, skip: 0 });
            open = Some((condition, block.ops.len()));
        }
        let start = block.ops.len();
        // Merging hides the border between two instructions, so neither may be observed or in an IT block.
        let joins = what.observed.is_empty() && !within && block.positions.last().is_some_and(|before| before.it == 0);
        let mut instruction =
            Instruction { ops: &mut block.ops, floats, memory: what.memory, address: at, conditional: within, joins };
        let (then, it) = match first {
            // IT (A7.7.38), which must not be within another IT block.
            0xBF00..=0xBFFF if first & 0xF != 0 && !within => (Then::Next, first as u8),
            _ if is_wide(first) => (instruction.wide(first, second), advanced(block.it)),
            _ => (instruction.narrow(first), advanced(block.it)),
        };
        if let Some((_, after)) = open {
            // The number of operations to skip is known only now.
            let skip = (block.ops.len() - after) as u8;
            block.ops[after - 1] = Op::Unless { condition, skip };
            if block.ops[start..].iter().any(|op| !op.keeps_flags()) {
                open = None;
            }
        }
        block.positions.resize(block.ops.len(), position);
        block.instructions += 1;
        block.end = at.wrapping_add(if is_wide(first) { 4 } else { 2 });
        block.it = it;
        if then == Then::End {
            break;
        }
    }
    (block.instructions > 0).then_some(block)
}

impl Op {
    /// Returns true if the operation certainly leaves the flags unchanged.
    fn keeps_flags(&self) -> bool {
        matches!(
            self,
            Self::AlignSp
                | Self::Value { .. }
                | Self::Mov { .. }
                | Self::Top { .. }
                | Self::AddValue { .. }
                | Self::AndValue { .. }
                | Self::OrrValue { .. }
                | Self::EorValue { .. }
                | Self::Add { .. }
                | Self::AddShifted { .. }
                | Self::Sub { .. }
                | Self::And { .. }
                | Self::Orr { .. }
                | Self::Eor { .. }
                | Self::Bic { .. }
                | Self::Orn { .. }
                | Self::Lsl { .. }
                | Self::Lsr { .. }
                | Self::Asr { .. }
                | Self::Mul { .. }
                | Self::Ubfx { .. }
                | Self::Sbfx { .. }
                | Self::Bfi { .. }
                | Self::Uxtb { .. }
                | Self::Uxth { .. }
                | Self::Sxtb { .. }
                | Self::Sxth { .. }
                | Self::Ldr { .. }
                | Self::Ldrb { .. }
                | Self::Ldrh { .. }
                | Self::Str { .. }
                | Self::Strb { .. }
                | Self::Strh { .. }
                | Self::Ldrd { .. }
                | Self::Strd { .. }
                | Self::Push { .. }
                | Self::Pop { .. }
        )
    }
}

/// Extracts `count` bits of an encoding from bit `lowest` on.
fn bits(word: u16, lowest: u32, count: u32) -> u32 {
    u32::from(word) >> lowest & ((1 << count) - 1)
}

/// Extracts a register number of 4 bits.
fn index(word: u16, lowest: u32) -> Index {
    bits(word, lowest, 4) as Index
}

/// Sign-extends the lowest `count` bits of a value.
fn signed(value: u32, count: u32) -> u32 {
    ((value << (32 - count)) as i32 >> (32 - count)) as u32
}

/// Codes of data-processing operations (A5.3.1).
mod data {
    pub(super) const AND: u32 = 0;
    pub(super) const BIC: u32 = 1;
    pub(super) const ORR: u32 = 2;
    pub(super) const ORN: u32 = 3;
    pub(super) const EOR: u32 = 4;
    pub(super) const PKH: u32 = 6;
    pub(super) const ADD: u32 = 8;
    pub(super) const ADC: u32 = 10;
    pub(super) const SBC: u32 = 11;
    pub(super) const SUB: u32 = 13;
    pub(super) const RSB: u32 = 14;
}

/// Load or store of one register.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Single {
    Str,
    Strh,
    Strb,
    Ldrsb,
    Ldr,
    Ldrh,
    Ldrb,
    Ldrsh,
}

impl Instruction<'_> {
    /// Emits a conditional branch, merged with the comparison before it if possible.
    fn branch_if(&mut self, condition: Condition, target: u32) -> Then {
        let joined = match self.ops.last() {
            Some(&Op::CmpValue { n, value }) if value < 256 => {
                Some(Op::CmpValueBranch { n, value: value as u8, condition, target })
            }
            Some(&Op::Cmp { n, m }) => Some(Op::CmpBranch { n, m, condition, target }),
            _ => None,
        };
        if let Some(op) = joined.filter(|_| self.joins) {
            self.ops.pop();
            return self.end(op);
        }
        self.end(match condition {
            0 => Op::BranchEqual { target },
            1 => Op::BranchNotEqual { target },
            2 => Op::BranchCarry { target },
            3 => Op::BranchNoCarry { target },
            10 => Op::BranchNotLess { target },
            11 => Op::BranchLess { target },
            _ => Op::BranchIf { condition, target },
        })
    }

    fn push(&mut self, op: Op) -> Then {
        self.ops.push(op);
        Then::Next
    }

    /// Emits the last operation of the block.
    fn end(&mut self, op: Op) -> Then {
        self.ops.push(op);
        Then::End
    }

    fn undefined(&mut self) -> Then {
        self.end(Op::Undefined)
    }

    /// Aligns SP if `d`, which was written, is SP.
    fn wrote(&mut self, d: Index) -> Then {
        if d == SP {
            self.ops.push(Op::AlignSp);
        }
        Then::Next
    }

    /// Returns PC as instructions read it: their address plus 4.
    fn pc(&self) -> u32 {
        self.address.wrapping_add(4)
    }

    /// Returns PC rounded down to a multiple of 4.
    fn aligned_pc(&self) -> u32 {
        self.pc() & !3
    }

    /// Emits data processing of registers. A missing destination is [`NONE`], a missing first operand [`ZERO`].
    fn data(&mut self, operation: u32, s: bool, d: Index, n: Index, m: Index) -> Then {
        let op = match (operation, s) {
            (data::AND, false) => Op::And { d, n, m },
            (data::AND, true) => Op::Ands { d, n, m },
            (data::BIC, false) => Op::Bic { d, n, m },
            (data::BIC, true) => Op::Bics { d, n, m },
            (data::ORR, false) if n == ZERO => Op::Mov { d, m },
            (data::ORR, true) if n == ZERO => Op::Movs { d, m },
            (data::ORR, false) => Op::Orr { d, n, m },
            (data::ORR, true) => Op::Orrs { d, n, m },
            (data::ORN, false) => Op::Orn { d, n, m },
            (data::ORN, true) => Op::Orns { d, n, m },
            (data::EOR, false) => Op::Eor { d, n, m },
            (data::EOR, true) => Op::Eors { d, n, m },
            (data::ADD, false) => Op::Add { d, n, m },
            (data::ADD, true) => Op::Adds { d, n, m },
            (data::ADC, false) => Op::Adc { d, n, m },
            (data::ADC, true) => Op::Adcs { d, n, m },
            (data::SBC, false) => Op::Sbc { d, n, m },
            (data::SBC, true) => Op::Sbcs { d, n, m },
            (data::SUB, true) if d == NONE => Op::Cmp { n, m },
            (data::SUB, false) => Op::Sub { d, n, m },
            (data::SUB, true) => Op::Subs { d, n, m },
            (data::RSB, false) => Op::Sub { d, n: m, m: n },
            (data::RSB, true) => Op::Subs { d, n: m, m: n },
            _ => return self.undefined(),
        };
        self.push(op);
        self.wrote(d)
    }

    /// Emits data processing with a constant.
    fn data_value(&mut self, operation: u32, s: bool, d: Index, n: Index, value: u32) -> Then {
        let op = match (operation, s) {
            (data::AND, false) => Op::AndValue { d, n, value },
            (data::AND, true) => Op::AndValues { d, n, value },
            (data::BIC, false) => Op::AndValue { d, n, value: !value },
            (data::BIC, true) => Op::AndValues { d, n, value: !value },
            (data::ORR, false) if n == ZERO => Op::Value { d, value },
            (data::ORR, true) if n == ZERO => Op::Values { d, value },
            (data::ORN, false) if n == ZERO => Op::Value { d, value: !value },
            (data::ORN, true) if n == ZERO => Op::Values { d, value: !value },
            (data::ORR, false) => Op::OrrValue { d, n, value },
            (data::ORR, true) => Op::OrrValues { d, n, value },
            (data::ORN, false) => Op::OrrValue { d, n, value: !value },
            (data::ORN, true) => Op::OrrValues { d, n, value: !value },
            (data::EOR, false) => Op::EorValue { d, n, value },
            (data::EOR, true) => Op::EorValues { d, n, value },
            (data::ADD, false) => Op::AddValue { d, n, value },
            (data::ADD, true) => Op::AddValues { d, n, value },
            (data::SUB, false) => Op::AddValue { d, n, value: value.wrapping_neg() },
            (data::SUB, true) if d == NONE => Op::CmpValue { n, value },
            (data::SUB, true) => Op::SubValues { d, n, value },
            // RSB from 0 is NEG: a subtraction from the register that reads zero.
            (data::RSB, _) if value == 0 => return self.data(data::SUB, s, d, ZERO, n),
            _ => {
                self.push(Op::Value { d: SCRATCH, value });
                return self.data(operation, s, d, n, SCRATCH);
            }
        };
        self.push(op);
        // SP stays aligned when a multiple of 4 is added, so no AlignSp is needed.
        if matches!(op, Op::AddValue { d: SP, n: SP, value } if value & 3 == 0) {
            return Then::Next;
        }
        self.wrote(d)
    }

    /// Emits a shift by a constant as encoded (A7.4.2): kind and amount.
    fn shift(&mut self, s: bool, d: Index, m: Index, kind: u32, amount: u32) -> Then {
        let by = amount as u8;
        let op = match (kind, amount, s) {
            (0, 0, false) => Op::Mov { d, m },
            (0, 0, true) => Op::Movs { d, m },
            (0, _, false) => Op::Lsl { d, m, by },
            (0, _, true) => Op::Lsls { d, m, by },
            // An amount of 0 encodes LSR by 32, ASR by 32 and RRX (A7.4.2).
            (1, 0, false) => Op::Value { d, value: 0 },
            (1, 0, true) => Op::Lsrs { d, m, by: 32 },
            (1, _, false) => Op::Lsr { d, m, by },
            (1, _, true) => Op::Lsrs { d, m, by },
            (2, 0, false) => Op::Asr { d, m, by: 31 },
            (2, 0, true) => Op::Asrs { d, m, by: 32 },
            (2, _, false) => Op::Asr { d, m, by },
            (2, _, true) => Op::Asrs { d, m, by },
            (_, 0, false) => Op::Rrx { d, m },
            (_, 0, true) => Op::Rrxs { d, m },
            (_, _, false) => Op::Ror { d, m, by },
            (_, _, true) => Op::Rors { d, m, by },
        };
        self.push(op);
        self.wrote(d)
    }

    /// Reads a literal from code that the program cannot change; `None` elsewhere.
    fn literal(&self, single: Single, address: u32) -> Option<u32> {
        if self.memory.is_changeable_code(address) {
            return None;
        }
        let low = u32::from(self.memory.fetch(address)?);
        Some(match single {
            Single::Ldr => low | u32::from(self.memory.fetch(address.wrapping_add(2))?) << 16,
            Single::Ldrh => low,
            Single::Ldrsh => signed(low, 16),
            Single::Ldrb => low & 0xFF,
            Single::Ldrsb => signed(low, 8),
            Single::Str | Single::Strh | Single::Strb => return None,
        })
    }

    /// Emits a load or store of one register at an offset; `n` may be [`ZERO`].
    fn single(&mut self, single: Single, t: Index, n: Index, offset: u32) {
        if n == ZERO
            && let Some(value) = self.literal(single, offset)
        {
            self.push(Op::Value { d: t, value });
            return;
        }
        self.push(match single {
            Single::Str => Op::Str { t, n, offset },
            Single::Strh => Op::Strh { t, n, offset },
            Single::Strb => Op::Strb { t, n, offset },
            Single::Ldrsb => Op::Ldrsb { t, n, offset },
            Single::Ldr => Op::Ldr { t, n, offset },
            Single::Ldrh => Op::Ldrh { t, n, offset },
            Single::Ldrb => Op::Ldrb { t, n, offset },
            Single::Ldrsh => Op::Ldrsh { t, n, offset },
        });
    }

    /// Emits a load or store of one register with a register offset.
    fn single_by(&mut self, single: Single, t: Index, n: Index, m: Index, left: u8) {
        self.push(match single {
            Single::Str => Op::StrBy { t, n, m, left },
            Single::Strh => Op::StrhBy { t, n, m, left },
            Single::Strb => Op::StrbBy { t, n, m, left },
            Single::Ldrsb => Op::LdrsbBy { t, n, m, left },
            Single::Ldr => Op::LdrBy { t, n, m, left },
            Single::Ldrh => Op::LdrhBy { t, n, m, left },
            Single::Ldrb => Op::LdrbBy { t, n, m, left },
            Single::Ldrsh => Op::LdrshBy { t, n, m, left },
        });
    }

    /// Decodes coprocessor instructions (A5.3.18): the floating-point unit is the only coprocessor.
    fn coprocessor(&mut self, first: u16, second: u16) -> Then {
        // These are encodings of Advanced SIMD, which ARMv7-M does not have.
        if bits(first, 8, 2) == 3 {
            return self.undefined();
        }
        if !matches!(bits(second, 8, 4), 10 | 11) {
            return self.end(Op::NoCoprocessor);
        }
        match float::decode(first, second) {
            Some(float) => {
                let index = self.floats.len() as u32;
                self.floats.push(float);
                self.push(Op::Float { index })
            }
            None => self.end(Op::FloatUndefined),
        }
    }
}
