//! Execution of the operations of a block.

mod access;
mod multiply;
mod packed;
mod special;

use r4_mcu::Size;
use r4_mcu::cpu::{CoreBus, Fault, Why};

use crate::blocks::{Block, Blocks};
use crate::decode::Position;
use crate::operation::{COUNT, LR, Op, SP};
use crate::state::State;

/// Stretch of blocks that is being executed.
#[derive(Clone, Copy)]
pub(crate) struct Context<'a> {
    pub(crate) blocks: &'a Blocks,
    pub(crate) block: &'a Block,
}

impl Context<'_> {
    /// Returns the origin of an operation.
    pub(crate) fn position(&self, index: usize) -> Position {
        self.blocks.positions(self.block)[index]
    }

    /// Returns the address of an operation's instruction.
    pub(crate) fn pc(&self, index: usize) -> u32 {
        self.position(index).address
    }
}

fn add(state: &mut State, a: u32, b: u32, carry: bool) -> u32 {
    let (partial, first) = a.overflowing_add(b);
    let (result, second) = partial.overflowing_add(carry.into());
    state.flags.c = first | second;
    state.flags.v = (a ^ result) & (b ^ result);
    state.flags.n = result;
    state.flags.z = result;
    result
}

/// Shifts by a register (A2.2.1); returns the result, and the carry if it changes.
fn shift_by(kind: u8, value: u32, by: u32) -> (u32, Option<bool>) {
    let by = by & 0xFF;
    if by == 0 {
        return (value, None);
    }
    match kind {
        0 => (value.checked_shl(by).unwrap_or(0), Some(by <= 32 && value >> (32 - by) & 1 != 0)),
        1 => (value.checked_shr(by).unwrap_or(0), Some(by <= 32 && value >> (by - 1) & 1 != 0)),
        2 => {
            let by = by.min(32) - 1;
            let shifted = value as i32 >> by;
            ((shifted >> 1) as u32, Some(shifted & 1 != 0))
        }
        _ => {
            let result = value.rotate_right(by);
            (result, Some(result >> 31 != 0))
        }
    }
}

/// Ends the run before an instruction, which has no effect.
#[cold]
fn stop_before(state: &mut State, context: &Context<'_>, index: usize, why: Why) -> Option<Why> {
    let position = context.position(index);
    state.pc = context.pc(index);
    state.it = position.it;
    state.executed += u64::from(position.instruction);
    Some(why)
}

/// Ends the run after the last instruction of a stretch, whose last block has `instructions`; the next one is at `pc`.
#[cold]
fn stop_after(state: &mut State, context: &Context<'_>, instructions: u16, pc: u32, why: Why) -> Option<Why> {
    state.pc = pc;
    state.it = context.block.it;
    state.executed += u64::from(instructions);
    Some(why)
}

/// Executes a stretch of blocks, or its first operations. With `chain` also its successors, as long as they are known
/// and no check is due; checks are made before each block. `Some` ends the run.
pub(crate) fn execute(
    state: &mut State,
    blocks: &Blocks,
    block: &Block,
    chain: bool,
    bus: &mut dyn CoreBus,
) -> Option<Why> {
    let mut context = Context { blocks, block };
    let mut ops = blocks.ops(block);
    // Instructions of the current block, and the remaining operations of the stretch.
    let mut instructions = block.instructions;
    let mut rest = ops.iter();
    // Index of the current operation.
    macro_rules! here {
        () => {
            ops.len() - rest.len() - 1
        };
    }
    macro_rules! r {
        ($index:expr) => {
            state.r[usize::from($index) % COUNT]
        };
    }
    // Sets N and Z from a result.
    macro_rules! nz {
        ($d:expr, $result:expr) => {{
            let result = $result;
            r!($d) = result;
            state.flags.n = result;
            state.flags.z = result;
        }};
    }
    macro_rules! before {
        ($fault:expr) => {
            return stop_before(state, &context, here!(), Why::Fault($fault))
        };
    }
    macro_rules! after {
        ($why:expr) => {
            return stop_after(state, &context, instructions, context.block.end, $why)
        };
    }
    // Handles the result of accesses to several words.
    macro_rules! words {
        ($result:expr) => {
            match $result {
                Ok(value) => value,
                Err(fault) => before!(fault),
            }
        };
    }
    macro_rules! load {
        ($t:expr, $address:expr, $bytes:literal, $size:ident, $extend:expr) => {{
            let address: u32 = $address;
            let value = match state.memory.load::<$bytes>(address) {
                Some(bytes) => $extend(bytes),
                None => match state.load_by_bus(address, Size::$size, here!(), &context, bus) {
                    Some(word) => {
                        let mut bytes = [0; $bytes];
                        bytes.copy_from_slice(&word.to_le_bytes()[..$bytes]);
                        $extend(bytes)
                    }
                    None => before!(Fault::Load),
                },
            };
            r!($t) = value as u32;
        }};
    }
    macro_rules! store {
        ($t:expr, $address:expr, $bytes:literal, $size:ident, $type:ty) => {{
            let address: u32 = $address;
            let value = r!($t);
            if state.memory.store::<$bytes>(address, (value as $type).to_le_bytes()).is_none() {
                words!(state.store_by_bus(address, Size::$size, value, here!(), &context, bus));
            }
        }};
    }
    loop {
        let next = 'block: {
            // The target may be in this stretch or after it.
            macro_rules! branch {
                ($taken:expr, $target:expr) => {
                    if $taken {
                        break 'block $target;
                    }
                };
            }
            while let Some(op) = rest.next() {
                match *op {
                    Op::Unless { condition, skip } => {
                        if !state.flags.holds(condition) {
                            rest = rest.as_slice().get(usize::from(skip)..).unwrap_or(&[]).iter();
                        }
                    }
                    Op::AlignSp => r!(SP) &= !3,
                    Op::SetCarry { carry } => state.flags.c = carry,

                    Op::Value { d, value } => r!(d) = value,
                    Op::Values { d, value } => nz!(d, value),
                    Op::Mov { d, m } => r!(d) = r!(m),
                    Op::Movs { d, m } => nz!(d, r!(m)),
                    Op::Top { d, value } => r!(d) = r!(d) & 0xFFFF | u32::from(value) << 16,

                    Op::AddValue { d, n, value } => r!(d) = r!(n).wrapping_add(value),
                    Op::AddValues { d, n, value } => r!(d) = add(state, r!(n), value, false),
                    Op::SubValues { d, n, value } => r!(d) = add(state, r!(n), !value, true),
                    Op::CmpValue { n, value } => {
                        add(state, r!(n), !value, true);
                    }
                    Op::AndValue { d, n, value } => r!(d) = r!(n) & value,
                    Op::AndValues { d, n, value } => nz!(d, r!(n) & value),
                    Op::OrrValue { d, n, value } => r!(d) = r!(n) | value,
                    Op::OrrValues { d, n, value } => nz!(d, r!(n) | value),
                    Op::EorValue { d, n, value } => r!(d) = r!(n) ^ value,
                    Op::EorValues { d, n, value } => nz!(d, r!(n) ^ value),

                    Op::Add { d, n, m } => r!(d) = r!(n).wrapping_add(r!(m)),
                    Op::Adds { d, n, m } => r!(d) = add(state, r!(n), r!(m), false),
                    Op::AddShifted { d, n, m, left } => r!(d) = r!(n).wrapping_add(r!(m) << (left & 31)),
                    Op::Sub { d, n, m } => r!(d) = r!(n).wrapping_sub(r!(m)),
                    Op::Subs { d, n, m } => r!(d) = add(state, r!(n), !r!(m), true),
                    Op::Cmp { n, m } => {
                        add(state, r!(n), !r!(m), true);
                    }
                    Op::Adc { d, n, m } => r!(d) = r!(n).wrapping_add(r!(m)).wrapping_add(state.flags.c.into()),
                    Op::Adcs { d, n, m } => r!(d) = add(state, r!(n), r!(m), state.flags.c),
                    Op::Sbc { d, n, m } => r!(d) = r!(n).wrapping_add(!r!(m)).wrapping_add(state.flags.c.into()),
                    Op::Sbcs { d, n, m } => r!(d) = add(state, r!(n), !r!(m), state.flags.c),
                    Op::And { d, n, m } => r!(d) = r!(n) & r!(m),
                    Op::Ands { d, n, m } => nz!(d, r!(n) & r!(m)),
                    Op::Orr { d, n, m } => r!(d) = r!(n) | r!(m),
                    Op::Orrs { d, n, m } => nz!(d, r!(n) | r!(m)),
                    Op::Eor { d, n, m } => r!(d) = r!(n) ^ r!(m),
                    Op::Eors { d, n, m } => nz!(d, r!(n) ^ r!(m)),
                    Op::Bic { d, n, m } => r!(d) = r!(n) & !r!(m),
                    Op::Bics { d, n, m } => nz!(d, r!(n) & !r!(m)),
                    Op::Orn { d, n, m } => r!(d) = r!(n) | !r!(m),
                    Op::Orns { d, n, m } => nz!(d, r!(n) | !r!(m)),

                    Op::Lsl { d, m, by } => r!(d) = r!(m) << (by & 31),
                    Op::Lsls { d, m, by } => {
                        // Shifting in two steps gives the carry, which is the last bit shifted out; LSR and ASR may
                        // shift by 32.
                        let partial = r!(m) << (by.wrapping_sub(1) & 31);
                        state.flags.c = partial >> 31 != 0;
                        nz!(d, partial << 1);
                    }
                    Op::Lsr { d, m, by } => r!(d) = r!(m) >> (by & 31),
                    Op::Lsrs { d, m, by } => {
                        let partial = r!(m) >> (by.wrapping_sub(1) & 31);
                        state.flags.c = partial & 1 != 0;
                        nz!(d, partial >> 1);
                    }
                    Op::Asr { d, m, by } => r!(d) = (r!(m) as i32 >> (by & 31)) as u32,
                    Op::Asrs { d, m, by } => {
                        let partial = r!(m) as i32 >> (by.wrapping_sub(1) & 31);
                        state.flags.c = partial & 1 != 0;
                        nz!(d, (partial >> 1) as u32);
                    }
                    Op::Ror { d, m, by } => r!(d) = r!(m).rotate_right(by.into()),
                    Op::Rors { d, m, by } => {
                        // The last bit rotated is now the highest one.
                        let result = r!(m).rotate_right(by.into());
                        state.flags.c = result >> 31 != 0;
                        nz!(d, result);
                    }
                    Op::Rrx { d, m } => r!(d) = u32::from(state.flags.c) << 31 | r!(m) >> 1,
                    Op::Rrxs { d, m } => {
                        let value = r!(m);
                        let result = u32::from(state.flags.c) << 31 | value >> 1;
                        state.flags.c = value & 1 != 0;
                        nz!(d, result);
                    }
                    Op::ShiftBy { kind, d, n, m } => r!(d) = shift_by(kind, r!(n), r!(m)).0,
                    Op::ShiftBys { kind, d, n, m } => {
                        let (result, carry) = shift_by(kind, r!(n), r!(m));
                        state.flags.c = carry.unwrap_or(state.flags.c);
                        nz!(d, result);
                    }

                    Op::Mul { d, n, m } => r!(d) = r!(n).wrapping_mul(r!(m)),
                    Op::Muls { d, n, m } => nz!(d, r!(n).wrapping_mul(r!(m))),
                    Op::Mla { d, n, m, a } => r!(d) = r!(n).wrapping_mul(r!(m)).wrapping_add(r!(a)),
                    Op::Mls { d, n, m, a } => r!(d) = r!(a).wrapping_sub(r!(n).wrapping_mul(r!(m))),
                    Op::Umull { low, high, n, m } => state.set_long(low, high, u64::from(r!(n)) * u64::from(r!(m))),
                    Op::Smull { low, high, n, m } => {
                        state.set_long(low, high, (i64::from(r!(n) as i32) * i64::from(r!(m) as i32)) as u64);
                    }
                    Op::Umlal { low, high, n, m } => {
                        let sum = state.long(low, high).wrapping_add(u64::from(r!(n)) * u64::from(r!(m)));
                        state.set_long(low, high, sum);
                    }
                    Op::Smlal { low, high, n, m } => {
                        let product = i64::from(r!(n) as i32) * i64::from(r!(m) as i32);
                        let sum = state.long(low, high).wrapping_add(product as u64);
                        state.set_long(low, high, sum);
                    }
                    Op::Umaal { low, high, n, m } => {
                        let sum = u64::from(r!(n)) * u64::from(r!(m)) + u64::from(r!(low)) + u64::from(r!(high));
                        state.set_long(low, high, sum);
                    }
                    // Division by zero gives zero: CCR.DIV_0_TRP is not modelled.
                    Op::Udiv { d, n, m } => r!(d) = r!(n).checked_div(r!(m)).unwrap_or(0),
                    Op::Sdiv { d, n, m } => {
                        let (n, m) = (r!(n) as i32, r!(m) as i32);
                        r!(d) = if m == 0 { 0 } else { n.wrapping_div(m) as u32 };
                    }

                    Op::Ubfx { d, n, lsb, width } => {
                        r!(d) = r!(n) >> (lsb & 31) & (u32::MAX >> ((32 - u32::from(width)) & 31))
                    }
                    Op::Sbfx { d, n, lsb, width } => {
                        let unused = (32 - u32::from(width)) & 31;
                        r!(d) = ((r!(n) >> (lsb & 31) << unused) as i32 >> unused) as u32;
                    }
                    Op::Bfi { d, n, lsb, width } => {
                        let mask = (u32::MAX >> ((32 - u32::from(width)) & 31)) << (lsb & 31);
                        r!(d) = r!(d) & !mask | r!(n) << (lsb & 31) & mask;
                    }
                    Op::Uxtb { d, m } => r!(d) = r!(m) & 0xFF,
                    Op::Uxth { d, m } => r!(d) = r!(m) & 0xFFFF,
                    Op::Sxtb { d, m } => r!(d) = r!(m) as i8 as u32,
                    Op::Sxth { d, m } => r!(d) = r!(m) as i16 as u32,
                    Op::Uxtb16 { d, m } => r!(d) = r!(m) & 0x00FF_00FF,
                    Op::Sxtb16 { d, m } => {
                        let value = r!(m);
                        r!(d) = value as i8 as u32 & 0xFFFF | ((value >> 16) as i8 as u32) << 16;
                    }
                    Op::AddHalves { d, n, m } => {
                        let (n, m) = (r!(n), r!(m));
                        r!(d) = n.wrapping_add(m) & 0xFFFF | (n & 0xFFFF_0000).wrapping_add(m & 0xFFFF_0000);
                    }
                    Op::Rev { d, m } => r!(d) = r!(m).swap_bytes(),
                    Op::Rev16 { d, m } => r!(d) = r!(m).swap_bytes().rotate_right(16),
                    Op::Revsh { d, m } => r!(d) = (r!(m) as u16).swap_bytes() as i16 as u32,
                    Op::Rbit { d, m } => r!(d) = r!(m).reverse_bits(),
                    Op::Clz { d, m } => r!(d) = r!(m).leading_zeros(),

                    Op::Pkhbt { d, n, m } => r!(d) = r!(n) & 0xFFFF | r!(m) & 0xFFFF_0000,
                    Op::Pkhtb { d, n, m } => r!(d) = r!(n) & 0xFFFF_0000 | r!(m) & 0xFFFF,
                    Op::Ssat { d, n, bits } => r!(d) = state.signed_saturated(r!(n) as i32, bits) as u32,
                    Op::Usat { d, n, bits } => r!(d) = state.unsigned_saturated(r!(n) as i32, bits),
                    Op::Ssat16 { d, n, bits } => state.ssat16(d, n, bits),
                    Op::Usat16 { d, n, bits } => state.usat16(d, n, bits),
                    Op::Qadd { d, n, m } => state.qadd(d, n, m),
                    Op::Qsub { d, n, m } => state.qsub(d, n, m),
                    Op::Sel { d, n, m } => state.sel(d, n, m),
                    Op::Parallel { kind, d, n, m } => state.parallel(kind, d, n, m),
                    Op::Usad8 { d, n, m } => {
                        let differences = r!(n).to_le_bytes().into_iter().zip(r!(m).to_le_bytes());
                        r!(d) = differences.map(|(n, m)| u32::from(n.abs_diff(m))).sum();
                    }
                    Op::SmulHalves { d, n, m, tops } => state.smul_halves(d, n, m, tops),
                    Op::SmulWide { d, n, m, top } => state.smul_wide(d, n, m, top),
                    Op::AddSticky { d, n, m } => state.add_sticky(d, n, m),
                    Op::AddLong { low, high, m } => {
                        let sum = state.long(low, high).wrapping_add(r!(m) as i32 as u64);
                        state.set_long(low, high, sum);
                    }
                    Op::Dual { d, n, m, a, how } => state.dual(d, n, m, a, how),
                    Op::DualLong { low, high, n, m, how } => state.dual_long(low, high, n, m, how),
                    Op::Upper { d, n, m, a, how } => state.upper(d, n, m, a, how),

                    Op::Ldr { t, n, offset } => load!(t, r!(n).wrapping_add(offset), 4, Word, u32::from_le_bytes),
                    Op::Ldrb { t, n, offset } => load!(t, r!(n).wrapping_add(offset), 1, Byte, u8::from_le_bytes),
                    Op::Ldrh { t, n, offset } => load!(t, r!(n).wrapping_add(offset), 2, Half, u16::from_le_bytes),
                    Op::Ldrsb { t, n, offset } => load!(t, r!(n).wrapping_add(offset), 1, Byte, i8::from_le_bytes),
                    Op::Ldrsh { t, n, offset } => load!(t, r!(n).wrapping_add(offset), 2, Half, i16::from_le_bytes),
                    Op::Str { t, n, offset } => store!(t, r!(n).wrapping_add(offset), 4, Word, u32),
                    Op::Strb { t, n, offset } => store!(t, r!(n).wrapping_add(offset), 1, Byte, u8),
                    Op::Strh { t, n, offset } => store!(t, r!(n).wrapping_add(offset), 2, Half, u16),
                    Op::LdrBy { t, n, m, left } => {
                        load!(t, r!(n).wrapping_add(r!(m) << (left & 31)), 4, Word, u32::from_le_bytes);
                    }
                    Op::LdrbBy { t, n, m, left } => {
                        load!(t, r!(n).wrapping_add(r!(m) << (left & 31)), 1, Byte, u8::from_le_bytes);
                    }
                    Op::LdrhBy { t, n, m, left } => {
                        load!(t, r!(n).wrapping_add(r!(m) << (left & 31)), 2, Half, u16::from_le_bytes);
                    }
                    Op::LdrsbBy { t, n, m, left } => {
                        load!(t, r!(n).wrapping_add(r!(m) << (left & 31)), 1, Byte, i8::from_le_bytes);
                    }
                    Op::LdrshBy { t, n, m, left } => {
                        load!(t, r!(n).wrapping_add(r!(m) << (left & 31)), 2, Half, i16::from_le_bytes);
                    }
                    Op::StrBy { t, n, m, left } => store!(t, r!(n).wrapping_add(r!(m) << (left & 31)), 4, Word, u32),
                    Op::StrbBy { t, n, m, left } => store!(t, r!(n).wrapping_add(r!(m) << (left & 31)), 1, Byte, u8),
                    Op::StrhBy { t, n, m, left } => store!(t, r!(n).wrapping_add(r!(m) << (left & 31)), 2, Half, u16),
                    Op::Ldrd { t, second, n, offset } => {
                        let address = r!(n).wrapping_add(offset);
                        let mut words = [0; 2];
                        words!(state.load_words(address, &mut words, here!(), &context, bus));
                        r!(t) = words[0];
                        r!(second) = words[1];
                    }
                    Op::Strd { t, second, n, offset } => {
                        let address = r!(n).wrapping_add(offset);
                        let words = [r!(t), r!(second)];
                        words!(state.store_words(address, &words, here!(), &context, bus));
                    }
                    Op::Ldm { n, list, offset } => {
                        let address = r!(n).wrapping_add(i32::from(offset) as u32);
                        words!(state.load_list(address, list, here!(), &context, bus));
                    }
                    Op::Stm { n, list, offset } => {
                        let address = r!(n).wrapping_add(i32::from(offset) as u32);
                        words!(state.store_list(address, list, here!(), &context, bus));
                    }
                    Op::Push { list } => {
                        let address = r!(SP).wrapping_sub(4 * list.count_ones());
                        words!(state.store_list(address, list, here!(), &context, bus));
                        // SP changes last, so that an access that faults leaves it unchanged; the same holds for POP.
                        r!(SP) = address;
                    }
                    Op::Pop { list } => {
                        let address = r!(SP);
                        words!(state.load_list(address, list, here!(), &context, bus));
                        r!(SP) = address.wrapping_add(4 * list.count_ones());
                    }
                    Op::Ldrex { width, t, n, offset } => {
                        let address = r!(n).wrapping_add(offset.into());
                        let value = words!(state.load_exclusive(width, address, here!(), &context, bus));
                        r!(t) = value;
                    }
                    Op::Strex { width, d, t, n, words } => {
                        let address = r!(n).wrapping_add(4 * u32::from(words));
                        let value = r!(t);
                        let failed = words!(state.store_exclusive(width, address, value, here!(), &context, bus));
                        r!(d) = failed.into();
                    }
                    Op::Clrex => state.exclusive = None,

                    Op::Onward { instructions: next, address } => {
                        state.executed += u64::from(instructions);
                        instructions = next;
                        // The loop stops here only when an event is due; otherwise the next instructions follow without
                        // a lookup.
                        if state.executed >= state.attention_at {
                            state.pc = address;
                            state.it = 0;
                            return None;
                        }
                    }
                    Op::Branch { target } => break 'block target,
                    Op::BranchEqual { target } => branch!(state.flags.z == 0, target),
                    Op::BranchNotEqual { target } => branch!(state.flags.z != 0, target),
                    Op::BranchCarry { target } => branch!(state.flags.c, target),
                    Op::BranchNoCarry { target } => branch!(!state.flags.c, target),
                    Op::BranchLess { target } => branch!((state.flags.n ^ state.flags.v) >> 31 != 0, target),
                    Op::BranchNotLess { target } => branch!((state.flags.n ^ state.flags.v) >> 31 == 0, target),
                    Op::CmpValueBranch { n, value, condition, target } => {
                        add(state, r!(n), !u32::from(value), true);
                        branch!(state.flags.holds(condition), target);
                    }
                    Op::CmpBranch { n, m, condition, target } => {
                        add(state, r!(n), !r!(m), true);
                        branch!(state.flags.holds(condition), target);
                    }
                    Op::BranchIf { condition, target } => branch!(state.flags.holds(condition), target),
                    Op::Call { target } => {
                        r!(LR) = context.block.end | 1;
                        break 'block target;
                    }
                    Op::BranchZero { n, target } => branch!(r!(n) == 0, target),
                    Op::BranchNotZero { n, target } => branch!(r!(n) != 0, target),
                    Op::Exchange { m } => {
                        let target = r!(m);
                        // In handler mode, a branch to 0xFxxx_xxxx is an exception return (DDI0403E, BXWritePC).
                        if state.exception != 0 && target >> 28 == 0xF {
                            return stop_after(
                                state,
                                &context,
                                instructions,
                                target & !1,
                                Why::ExceptionReturn(target | 1),
                            );
                        }
                        state.thumb = target & 1 != 0;
                        break 'block target & !1;
                    }
                    Op::CallExchange { m } => {
                        // The target is read first, because `m` may be LR.
                        let target = r!(m);
                        r!(LR) = context.block.end | 1;
                        state.thumb = target & 1 != 0;
                        break 'block target & !1;
                    }
                    Op::BranchTo { m } => break 'block r!(m) & !1,
                    Op::Table { half, n, m, next } => {
                        let entry = if half {
                            let address = r!(n).wrapping_add(r!(m) << 1);
                            match state.load_half(address, here!(), &context, bus) {
                                Some(entry) => entry,
                                None => before!(Fault::Load),
                            }
                        } else {
                            let address = r!(n).wrapping_add(r!(m));
                            match state.load_byte(address, here!(), &context, bus) {
                                Some(entry) => entry,
                                None => before!(Fault::Load),
                            }
                        };
                        break 'block next.wrapping_add(2 * entry);
                    }

                    Op::Mrs { d, special } => r!(d) = state.special(special),
                    Op::Msr { n, special, mask } => {
                        let value = r!(n);
                        state.set_special(special, mask, value);
                    }
                    Op::Cps { disable, what } => state.change_masks(disable, what),
                    Op::Wfi => after!(Why::Wfi),
                    Op::Wfe => after!(Why::Wfe),
                    Op::Yield => after!(Why::Yield),
                    Op::Sev => bus.event(),
                    Op::Svc => after!(Why::Svc),
                    Op::Bkpt { operand } => return stop_before(state, &context, here!(), Why::Breakpoint(operand)),
                    Op::Undefined => before!(Fault::Undefined),
                    Op::NoCoprocessor => before!(Fault::NoCoprocessor),
                    Op::FloatUndefined if state.fpu => before!(Fault::Undefined),
                    Op::FloatUndefined => before!(Fault::NoCoprocessor),
                    Op::Float { .. } if !state.fpu => before!(Fault::NoCoprocessor),
                    Op::Float { index: number } => words!(state.float(number, here!(), &context, bus)),
                }
            }
            context.block.end
        };
        state.executed += u64::from(instructions);
        state.pc = next;
        state.it = context.block.it;
        if !chain || state.executed >= state.attention_at || !state.thumb {
            return None;
        }
        let block = blocks.follow(context.block, next)?;
        context.block = block;
        instructions = block.instructions;
        ops = blocks.ops(block);
        rest = ops.iter();
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::shift_by;

    /// Reference implementation that shifts by one place at a time (DDI0403E A2.2.1).
    fn by_ones(kind: u8, value: u32, by: u32) -> (u32, Option<bool>) {
        (0..by & 0xFF).fold((value, None), |(value, _), _| match kind {
            0 => (value << 1, Some(value >> 31 != 0)),
            1 => (value >> 1, Some(value & 1 != 0)),
            2 => ((value as i32 >> 1) as u32, Some(value & 1 != 0)),
            _ => (value.rotate_right(1), Some(value & 1 != 0)),
        })
    }

    proptest! {
        #[test]
        fn a_shift_is_as_many_shifts_by_one(kind in 0_u8..4, value: u32, by in 0_u32..0x1FF) {
            prop_assert_eq!(shift_by(kind, value, by), by_ones(kind, value, by));
        }
    }
}
