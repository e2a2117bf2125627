//! Tests of states in the middle of instructions, which the tests of both cores (hil-sim/unicorn/tests) do not cover.

use r4_mcu::cpu::{Access, Core, CoreBus, CoreStop, Fault, Limits, NoResult, Register, Why};
use r4_mcu::{Memory, Region};

use crate::ThumbCore;

const CODE: u32 = 0x0800_0000;
/// Address without memory or peripheral.
const NOWHERE: u32 = 0x6000_0000;

/// Bus on which nothing answers.
struct Silent;

impl CoreBus for Silent {
    fn read(&mut self, _: &Access) -> Result<u32, NoResult> {
        Err(NoResult)
    }

    fn write(&mut self, _: &Access, _: u32) -> Result<(), NoResult> {
        Ok(())
    }

    fn limits(&self) -> Limits {
        Limits { instructions: 1000, mask_changes: false }
    }

    fn event(&mut self) {}

    fn remapped(&mut self) -> Option<&[Region]> {
        None
    }
}

/// Silent bus with another limit, which records the origin of accesses.
struct Limited {
    instructions: u64,
    accesses: Vec<(u32, u64)>,
}

impl CoreBus for Limited {
    fn read(&mut self, access: &Access) -> Result<u32, NoResult> {
        self.accesses.push((access.pc - CODE, access.instructions));
        Ok(0)
    }

    fn write(&mut self, _: &Access, _: u32) -> Result<(), NoResult> {
        Ok(())
    }

    fn limits(&self) -> Limits {
        Limits { instructions: self.instructions, mask_changes: false }
    }

    fn event(&mut self) {}

    fn remapped(&mut self) -> Option<&[Region]> {
        None
    }
}

fn core(code: &[u16]) -> (ThumbCore, Memory) {
    let memory = Memory::new();
    let bytes: Vec<u8> = code.iter().flat_map(|half| half.to_le_bytes()).collect();
    memory.write_slice(CODE, &bytes).unwrap();
    let mut core = ThumbCore::new();
    core.map(memory.regions()).unwrap();
    core.set(Register::Sp, 0x2000_8000);
    core.set(Register::Pc, CODE);
    (core, memory)
}

fn run(core: &mut ThumbCore) -> (u64, Why, u32) {
    let CoreStop { instructions, why } = core.run(&mut Silent).unwrap();
    (instructions, why, core.get(Register::Pc) - CODE)
}

fn registers(core: &ThumbCore) -> Vec<u32> {
    (0..13).map(|index| core.get(Register::R(index))).collect()
}

#[test]
fn a_refused_load_in_an_it_block_keeps_its_state_and_the_block_goes_on_with_it() {
    // cmp r0,r0; itete eq; moveq r1,#1; ldrne r2,[r3]; ldreq r4,[r3]; movne r5,#1; wfi
    let (mut core, _) = core(&[0x4280, 0xBF0B, 0x2101, 0x681A, 0x681C, 0x2501, 0xBF30]);
    core.set(Register::R(3), NOWHERE);
    assert_eq!(run(&mut core), (4, Why::Fault(Fault::Load), 8));
    // ITSTATE 0x0B was advanced twice: condition EQ, two instructions left.
    let it = core.get(Register::Xpsr) & 0x0600_FC00;
    assert_eq!(it, 0x0C >> 2 << 10);
    core.set(Register::R(3), CODE);
    // Two writes, as a handler's return makes them.
    let xpsr = core.get(Register::Xpsr);
    core.set(Register::Xpsr, 1 << 24);
    core.set(Register::Xpsr, xpsr);
    assert_eq!(run(&mut core), (3, Why::Wfi, 14));
    let values = registers(&core);
    assert_eq!((values[1], values[2], values[4], values[5]), (1, 0, 0xBF0B_4280, 0));
    assert_eq!(core.get(Register::Xpsr) & 0x0600_FC00, 0);
}

#[test]
fn a_refused_load_of_many_changes_nothing() {
    // ldmia r0!,{r1,r2}; ldr r1,[r0,#4]!; pop {r1,pc}; ldrd r1,r2,[r0],#8
    for code in [vec![0xC806], vec![0xF850, 0x1F04], vec![0xBD02], vec![0xE8F0, 0x1202]] {
        let (mut core, _) = core(&code);
        core.set(Register::R(0), NOWHERE);
        core.set(Register::Sp, NOWHERE);
        let before = registers(&core);
        assert_eq!(run(&mut core), (0, Why::Fault(Fault::Load), 0), "{code:04x?}");
        assert_eq!((registers(&core), core.get(Register::Sp)), (before, NOWHERE), "{code:04x?}");
    }
}

#[test]
fn accesses_of_words_together_are_aligned() {
    // ldmia r0!,{r1,r2}; stmia r0!,{r1,r2}; ldrd r1,r2,[r0]; strd r1,r2,[r0]; ldrex r1,[r0]; strexh r2,r1,[r0]
    for code in [
        vec![0xC806],
        vec![0xC006],
        vec![0xE9D0, 0x1200],
        vec![0xE9C0, 0x1200],
        vec![0xE850, 0x1F00],
        vec![0xE8C0, 0x1F52],
    ] {
        let (mut core, _) = core(&code);
        core.set(Register::R(0), 0x2000_0001);
        assert_eq!(run(&mut core), (0, Why::Fault(Fault::Unaligned), 0), "{code:04x?}");
    }
}

#[test]
fn a_store_to_another_address_than_the_claimed_one_fails() {
    // ldrex r1,[r0]; strex r2,r1,[r0,#4]; strex r3,r1,[r0]; wfi
    let (mut core, memory) = core(&[0xE850, 0x1F00, 0xE840, 0x1201, 0xE840, 0x1300, 0xBF30]);
    core.set(Register::R(0), 0x2000_0000);
    memory.write(0x2000_0000, r4_mcu::Size::Word, 5).unwrap();
    assert_eq!(run(&mut core), (4, Why::Wfi, 14));
    // The first store has released the claim.
    assert_eq!((core.get(Register::R(2)), core.get(Register::R(3))), (1, 1));
    assert_eq!(memory.read(0x2000_0004, r4_mcu::Size::Word), Some(Memory::POWER_ON));
}

#[test]
fn basepri_has_the_bits_of_a_priority() {
    // msr basepri,r0; mrs r1,basepri; msr basepri_max,r2; mrs r3,basepri; msr basepri_max,r4; mrs r5,basepri; wfi
    let code = [0xF380, 0x8811, 0xF3EF, 0x8111, 0xF382, 0x8812, 0xF3EF, 0x8311, 0xF384, 0x8812, 0xF3EF, 0x8511, 0xBF30];
    let (mut core, _) = core(&code);
    // 16 levels: the low half of the byte does not exist, so 0x2F is 0x20, and 0x0F is 0, which
    // BASEPRI_MAX ignores.
    core.set(Register::R(0), 0x1FF);
    core.set(Register::R(2), 0x2F);
    core.set(Register::R(4), 0x0F);
    assert_eq!(run(&mut core), (7, Why::Wfi, 26));
    let values = registers(&core);
    assert_eq!((values[1], values[3], values[5]), (0xF0, 0x20, 0x20));
    // A debugger's write is no other.
    core.set(Register::Basepri, 0x3F);
    assert_eq!(core.get(Register::Basepri), 0x30);
}

#[test]
fn a_literal_follows_a_change_of_the_flash() {
    // ldr r0,[pc,#0]; wfi; .word
    let (mut core, memory) = core(&[0x4800, 0xBF30, 0x5678, 0x1234]);
    assert_eq!(run(&mut core), (2, Why::Wfi, 4));
    assert_eq!(core.get(Register::R(0)), 0x1234_5678);
    memory.write(CODE + 4, r4_mcu::Size::Word, 7).unwrap();
    core.code_changed().unwrap();
    core.set(Register::Pc, CODE);
    assert_eq!(run(&mut core), (2, Why::Wfi, 4));
    assert_eq!(core.get(Register::R(0)), 7);
}

#[test]
fn a_comparison_and_its_branch_are_two_instructions() {
    // 0: cmp r0,#3; 2: beq 8; 4: adds r0,#1; 6: b 0; 8: wfi
    let code = [0x2803, 0xD001, 0x3001, 0xE7FB, 0xBF30];
    let (mut core, _) = core(&code);
    assert_eq!(run(&mut core), (3 * 4 + 3, Why::Wfi, 10));
    // Stopped at between them, and stepped.
    core.set(Register::R(0), 3);
    core.set(Register::Pc, CODE);
    core.observe(&[CODE + 2]).unwrap();
    assert_eq!(run(&mut core), (1, Why::Observed, 2));
    assert!(core.is_within_block());
    assert_eq!(run(&mut core), (2, Why::Wfi, 10));
    core.observe(&[]).unwrap();
    core.set(Register::Pc, CODE);
    for (pc, within) in [(2, true), (8, false)] {
        assert_eq!(core.step(&mut Silent).unwrap(), CoreStop { instructions: 1, why: Why::Observed });
        assert_eq!((core.get(Register::Pc) - CODE, core.is_within_block()), (pc, within));
    }
}

#[test]
fn code_at_the_end_of_a_memory_is_not_fetched_beyond_it() {
    let (mut core, memory) = core(&[]);
    // nop, then the first half of a wide instruction.
    let last = 0xFFFC;
    memory.write_slice(last, &[0x00, 0xBF, 0x00, 0xF0]).unwrap();
    core.set(Register::Pc, last);
    let stop = core.run(&mut Silent).unwrap();
    assert_eq!(stop, CoreStop { instructions: 1, why: Why::Fault(Fault::Fetch) });
    assert_eq!(core.get(Register::Pc), last + 2);
}

#[test]
fn blocks_that_follow_each_other_are_each_begun_within_the_limit() {
    // 0: movs r0,#1; 2: beq 6; 4: movs r0,#2; 6: b 10; 8: wfi; 10: ldr r1,[r3]; 12: wfi
    let code = [0x2001, 0xD000, 0x2002, 0xE000, 0xBF30, 0x6819, 0xBF30];
    for (limit, executed, pc) in [(0, 0, 0), (1, 2, 4), (2, 2, 4), (3, 4, 10), (4, 4, 10)] {
        // The first run decodes the code, the second finds it decoded.
        let (mut core, _) = core(&code);
        for _ in 0..2 {
            core.set(Register::Pc, CODE);
            let mut bus = Limited { instructions: limit, accesses: Vec::new() };
            let stop = core.run(&mut bus).unwrap();
            assert_eq!(stop, CoreStop { instructions: executed, why: Why::Limit }, "limit {limit}");
            assert_eq!(core.get(Register::Pc) - CODE, pc, "limit {limit}");
        }
    }
    let (mut core, _) = core(&code);
    core.set(Register::R(3), NOWHERE);
    let mut bus = Limited { instructions: 1000, accesses: Vec::new() };
    assert_eq!(core.run(&mut bus).unwrap(), CoreStop { instructions: 6, why: Why::Wfi });
    assert_eq!((bus.accesses, core.get(Register::Pc) - CODE), (vec![(10, 4)], 14));
    core.set(Register::Pc, CODE);
    assert_eq!(run(&mut core), (4, Why::Fault(Fault::Load), 10));
}
