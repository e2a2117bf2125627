//! Hand-assembled Thumb code on every backend: stop reasons, instruction counts, and bus accesses.

#![allow(clippy::unwrap_used, reason = "failing is a test's way to speak")]

use crate::common::{Tested, for_every_core};
use r4_mcu::cpu::{Access, Core, CoreBus, CoreStop, Fault, Limits, NoResult, Register, Why};
use r4_mcu::{Bank, Memory, Region, Size};

const CODE: u32 = 0x0800_0000;

/// Bus with one register at each address: the last value stored, or the address itself.
#[derive(Default)]
struct Bus {
    accesses: Vec<(char, Access, u32)>,
    refuse: Option<u32>,
    limit: u64,
    mask_changes: bool,
    events: u32,
    stop_at_access: bool,
    switch_on: Option<(Memory, Bank)>,
    remap: bool,
}

impl CoreBus for Bus {
    fn read(&mut self, access: &Access) -> Result<u32, NoResult> {
        self.accesses.push(('r', *access, 0));
        if self.refuse == Some(access.address) { Err(NoResult) } else { Ok(access.address ^ 0xA500_0000) }
    }
    fn write(&mut self, access: &Access, value: u32) -> Result<(), NoResult> {
        self.accesses.push(('w', *access, value));
        if let Some((memory, bank)) = &self.switch_on {
            memory.set_enabled(*bank, true);
            self.remap = true;
        }
        Ok(())
    }
    fn limits(&self) -> Limits {
        let now = self.stop_at_access && !self.accesses.is_empty();
        Limits { instructions: if now { 0 } else { self.limit }, mask_changes: self.mask_changes }
    }
    fn event(&mut self) {
        self.events += 1;
    }
    fn remapped(&mut self) -> Option<&[Region]> {
        let remap = std::mem::take(&mut self.remap);
        self.switch_on.as_ref().filter(|_| remap).map(|(memory, _)| memory.regions())
    }
}

fn core<C: Tested>(code: &[u16]) -> (C, Memory) {
    let memory = Memory::new();
    let core = load::<C>(&memory, code);
    (core, memory)
}

fn load<C: Tested>(memory: &Memory, code: &[u16]) -> C {
    let bytes: Vec<u8> = code.iter().flat_map(|half| half.to_le_bytes()).collect();
    memory.write_slice(CODE, &bytes).unwrap();
    let mut core = C::create();
    core.map(memory.regions()).unwrap();
    core.set_fpu(true);
    core.set(Register::Sp, 0x2000_8000);
    core.set(Register::Pc, CODE);
    core
}

fn bus() -> Bus {
    Bus { limit: 1000, ..Bus::default() }
}

fn run(core: &mut impl Core, bus: &mut Bus) -> (u64, Why, u32) {
    let CoreStop { instructions, why } = core.run(bus).unwrap();
    (instructions, why, core.get(Register::Pc) - CODE)
}

fn a_limit_stops_before_a_block_and_counts_every_instruction<C: Tested>() {
    // 0: movs r0,#0; 2: adds r0,#1; 4: adds r1,r0,#1; 6: b 2
    let (mut core, _) = core::<C>(&[0x2000, 0x3001, 0x1C41, 0xE7FC]);
    let mut bus = Bus { limit: 10, ..bus() };
    // 4 of the first block, then 3 each: 4, 7, 10.
    assert_eq!(run(&mut core, &mut bus), (10, Why::Limit, 2));
    assert_eq!(core.get(Register::R(0)), 3);
    bus.limit = 1;
    assert_eq!(run(&mut core, &mut bus), (3, Why::Limit, 2));
    assert_eq!(core.get(Register::R(0)), 4);
}

fn instructions_that_stop_are_told_apart<C: Tested>() {
    for (code, expected) in [
        (vec![0xBF00, 0xBF30, 0xE7FE], (2, Why::Wfi, 4)),
        (vec![0xBF00, 0xBF20, 0xE7FE], (2, Why::Wfe, 4)),
        (vec![0xBF00, 0xBF10, 0xE7FE], (2, Why::Yield, 4)),
        (vec![0xF3AF, 0x8003, 0xE7FE], (1, Why::Wfi, 4)),
        (vec![0xF3AF, 0x8002, 0xE7FE], (1, Why::Wfe, 4)),
        (vec![0xBF00, 0xDF07, 0xE7FE], (2, Why::Svc, 4)),
        (vec![0xBF00, 0xBE2A, 0xE7FE], (1, Why::Breakpoint(0x2A), 2)),
        (vec![0xBF00, 0xDE00, 0xE7FE], (1, Why::Fault(Fault::Undefined), 2)),
        (vec![0xBF00, 0xF7F0, 0xA000], (1, Why::Fault(Fault::Undefined), 2)),
    ] {
        let (mut core, _) = core::<C>(&code);
        assert_eq!(run(&mut core, &mut bus()), expected, "{code:04x?}");
    }
}

fn an_undefined_instruction_after_a_wait_is_not_taken_for_the_wait<C: Tested>() {
    let (mut core, _) = core::<C>(&[0xBF20, 0xDE00]);
    assert_eq!(run(&mut core, &mut bus()), (1, Why::Wfe, 2));
    assert_eq!(run(&mut core, &mut bus()), (0, Why::Fault(Fault::Undefined), 2));
}

fn an_access_knows_its_instruction_width_and_count<C: Tested>() {
    // nop; ldr r1,[r0]; ldrb r2,[r0,#1]; strh r1,[r0,#4]; ldrd r3,r4,[r0]; wfi
    let (mut core, _) = core::<C>(&[0xBF00, 0x6801, 0x7842, 0x8081, 0xE9D0, 0x3400, 0xBF30]);
    core.set(Register::R(0), 0x4000_1000);
    let mut bus = bus();
    assert_eq!(run(&mut core, &mut bus), (6, Why::Wfi, 14));
    let got: Vec<_> = bus
        .accesses
        .iter()
        .map(|(kind, access, value)| {
            (*kind, access.address, access.size, access.pc - CODE, access.instructions, *value)
        })
        .collect();
    assert_eq!(
        got,
        [
            ('r', 0x4000_1000, Size::Word, 2, 1, 0),
            ('r', 0x4000_1001, Size::Byte, 4, 2, 0),
            ('w', 0x4000_1004, Size::Half, 6, 3, 0x1000),
            ('r', 0x4000_1000, Size::Word, 8, 4, 0),
            ('r', 0x4000_1004, Size::Word, 8, 4, 0),
        ]
    );
    let registers = [1, 2, 3, 4].map(|index| core.get(Register::R(index)));
    assert_eq!(registers, [0xE500_1000, 0x01, 0xE500_1000, 0xE500_1004]);
}

fn an_access_in_a_conditional_block_does_not_make_what_follows_conditional<C: Tested>() {
    // cmp r5,r5; itt eq; ldreq r1,[r0]; streq r1,[r0]; cmp r5,#1; b next; next: movs r2,#7; wfi
    let (mut core, _) = core::<C>(&[0x42AD, 0xBF04, 0x6801, 0x6001, 0x2D01, 0xE7FF, 0x2207, 0xBF30]);
    core.set(Register::R(0), 0x4000_0000);
    let mut bus = bus();
    assert_eq!(run(&mut core, &mut bus), (8, Why::Wfi, 16));
    assert_eq!((bus.accesses.len(), core.get(Register::R(2))), (2, 7));
}

fn a_load_without_result_stops_at_its_instruction_and_changes_nothing<C: Tested>() {
    // movs r1,#5; ldr r1,[r0]; movs r2,#1
    let (mut core, _) = core::<C>(&[0x2105, 0x6801, 0x2201, 0xE7FE]);
    core.set(Register::R(0), 0x6000_0000);
    core.set(Register::R(2), 9);
    let mut bus = Bus { refuse: Some(0x6000_0000), ..bus() };
    assert_eq!(run(&mut core, &mut bus), (1, Why::Fault(Fault::Load), 2));
    assert_eq!((core.get(Register::R(1)), core.get(Register::R(2))), (5, 9));
}

fn a_limit_lowered_by_an_access_stops_at_the_end_of_its_block<C: Tested>() {
    // str r1,[r0]; movs r2,#1; b next; next: movs r3,#1; wfi
    let (mut core, _) = core::<C>(&[0x6001, 0x2201, 0xE7FF, 0x2301, 0xBF30]);
    core.set(Register::R(0), 0x4000_0000);
    let mut bus = Bus { stop_at_access: true, ..bus() };
    assert_eq!(run(&mut core, &mut bus), (3, Why::Limit, 6));
    assert_eq!(core.get(Register::R(2)), 1);
}

fn stores_to_flash_are_the_buss_and_do_not_change_it<C: Tested>() {
    // str r1,[r0]; ldr r2,[r0]; wfi; then strd, and an unaligned store
    let (mut core, memory) = core::<C>(&[0x6001, 0x6802, 0xE9C0, 0x1200, 0xF8C0, 0x1005, 0xBF30]);
    core.set(Register::R(0), CODE + 0x100);
    core.set(Register::R(1), 0x1234_5678);
    let mut bus = bus();
    assert_eq!(run(&mut core, &mut bus), (5, Why::Wfi, 14));
    let stores: Vec<_> =
        bus.accesses.iter().map(|(kind, access, value)| (*kind, access.address - CODE, access.size, *value)).collect();
    assert_eq!(
        stores,
        [
            ('w', 0x100, Size::Word, 0x1234_5678),
            ('w', 0x100, Size::Word, 0x1234_5678),
            ('w', 0x104, Size::Word, u32::MAX),
            ('w', 0x105, Size::Word, 0x1234_5678),
        ]
    );
    assert_eq!(core.get(Register::R(2)), u32::MAX);
    assert_eq!(memory.read(CODE + 0x100, Size::Word), Some(u32::MAX));
}

fn unaligned_accesses_reach_the_bus_whole<C: Tested>() {
    // ldr.w r1,[r0,#2]; str.w r2,[r0,#6]; wfi
    let (mut core, _) = core::<C>(&[0xF8D0, 0x1002, 0xF8C0, 0x2006, 0xBF30]);
    core.set(Register::R(0), Bank::Storage.span().0);
    core.set(Register::R(2), 0x0102_0304);
    let mut bus = bus();
    assert_eq!(run(&mut core, &mut bus), (3, Why::Wfi, 10));
    let base = Bank::Storage.span().0;
    let got: Vec<_> =
        bus.accesses.iter().map(|(kind, access, value)| (*kind, access.address - base, access.size, *value)).collect();
    assert_eq!(got, [('r', 2, Size::Word, 0), ('w', 6, Size::Word, 0x0102_0304)]);
    assert_eq!(core.get(Register::R(1)), (base + 2) ^ 0xA500_0000);
}

fn memory_without_clock_is_the_buss_until_it_is_switched_on<C: Tested>() {
    // str r1,[r0] (no clock); str r1,[r2] (switches it on); str r3,[r0]; ldr r4,[r0]; wfi
    let memory = Memory::new();
    memory.set_enabled(Bank::Sram1, false);
    let mut core = load::<C>(&memory, &[0x6001, 0x6011, 0x6003, 0x6804, 0xBF30]);
    core.set(Register::R(0), 0x3000_0040);
    core.set(Register::R(2), 0x5802_4400);
    core.set(Register::R(3), 77);
    let before = memory.read(0x3000_0040, Size::Word);
    let mut bus = bus();
    assert_eq!(core.get(Register::R(0)), 0x3000_0040);
    // First the store alone, then the rest with the switch.
    memory.write_slice(CODE + 2, &[0x30, 0xBF]).unwrap();
    core.code_changed().unwrap();
    assert_eq!(run(&mut core, &mut bus), (2, Why::Wfi, 4));
    assert_eq!(bus.accesses.len(), 1);
    assert_eq!(memory.read(0x3000_0040, Size::Word), before);
    memory.write_slice(CODE + 2, &[0x11, 0x60]).unwrap();
    core.code_changed().unwrap();
    core.set(Register::Pc, CODE + 2);
    let mut bus = Bus { switch_on: Some((memory.clone(), Bank::Sram1)), ..self::bus() };
    assert_eq!(run(&mut core, &mut bus), (4, Why::Wfi, 10));
    assert_eq!(bus.accesses.len(), 1);
    assert_eq!((memory.read(0x3000_0040, Size::Word), core.get(Register::R(4))), (Some(77), 77));
}

fn sev_is_heard_before_the_wait_that_follows<C: Tested>() {
    let (mut core, _) = core::<C>(&[0xBF40, 0xBF20]);
    let mut bus = bus();
    assert_eq!(run(&mut core, &mut bus), (2, Why::Wfe, 4));
    assert_eq!(bus.events, 1);
}

fn a_change_of_a_mask_is_noticed_at_once<C: Tested>() {
    // cpsid i; nop; cpsie i; nop; b .
    let (mut core, _) = core::<C>(&[0xB672, 0xBF00, 0xB662, 0xBF00, 0xE7FE]);
    let mut bus = Bus { mask_changes: true, ..bus() };
    assert_eq!(run(&mut core, &mut bus), (1, Why::MaskChanged, 2));
    assert_eq!(core.get(Register::Primask), 1);
    assert_eq!(run(&mut core, &mut bus), (2, Why::MaskChanged, 6));
    assert_eq!(core.get(Register::Primask), 0);
}

fn floating_point_faults_where_it_stands_while_it_is_not_allowed<C: Tested>() {
    // movs r0,#7; movs r1,#2; vmov s0,r0; wfi
    let (mut core, _) = core::<C>(&[0x2007, 0x2102, 0xEE00, 0x0A10, 0xBF30]);
    core.set_fpu(false);
    let mut bus = bus();
    assert_eq!(run(&mut core, &mut bus), (2, Why::Fault(Fault::NoCoprocessor), 4));
    assert_eq!((core.get(Register::R(0)), core.get(Register::R(1))), (7, 2));
    assert_eq!(run(&mut core, &mut bus), (0, Why::Fault(Fault::NoCoprocessor), 4));
    core.set_fpu(true);
    assert_eq!(core.get(Register::Control) & 4, 0);
    assert_eq!(run(&mut core, &mut bus), (2, Why::Wfi, 10));
    assert_eq!(core.get(Register::S(0)), 7);
    assert_eq!(core.get(Register::Control) & 4, 4, "FPCA is set by floating point");
}

fn handler_mode_uses_the_main_stack_and_returns_by_exc_return<C: Tested>() {
    // mrs r0,ipsr; bx lr
    let (mut core, _) = core::<C>(&[0xF3EF, 0x8005, 0x4770]);
    core.set(Register::Msp, 0x2000_1000);
    core.set(Register::Psp, 0x2000_2000);
    core.set(Register::Control, 2);
    assert_eq!(core.get(Register::Sp), 0x2000_2000);
    core.set(Register::Control, 0);
    core.set(Register::Xpsr, 0x0100_0000 | 15);
    assert_eq!(core.get(Register::Sp), 0x2000_1000);
    core.set(Register::Lr, 0xFFFF_FFFD);
    core.set(Register::Pc, CODE);
    let stop = core.run(&mut bus()).unwrap();
    assert_eq!(stop, CoreStop { instructions: 2, why: Why::ExceptionReturn(0xFFFF_FFFD) });
    assert_eq!(core.get(Register::R(0)), 15);
    core.set(Register::Xpsr, 0x0100_0000);
    core.set(Register::Control, 2);
    assert_eq!(core.get(Register::Sp), 0x2000_2000);
    // The instruction pop {pc} does the same.
    core.set(Register::Control, 0);
    core.set(Register::Xpsr, 0x0100_0000 | 3);
}

fn a_branch_to_an_even_address_or_to_data_faults<C: Tested>() {
    // bx r0
    let (mut core, _) = core::<C>(&[0x4700]);
    core.set(Register::R(0), CODE + 0x20);
    let (_, why, pc) = run(&mut core, &mut bus());
    assert_eq!((why, pc), (Why::Fault(Fault::InvalidState), 0x20));
    assert_eq!(core.get(Register::Xpsr) & 1 << 24, 0);
    for target in [0x4000_0001, 0x6000_0001, 0xE000_0001] {
        core.set(Register::Xpsr, 1 << 24);
        core.set(Register::R(0), target);
        core.set(Register::Pc, CODE);
        let stop = core.run(&mut bus()).unwrap();
        assert_eq!((stop.why, core.get(Register::Pc)), (Why::Fault(Fault::Fetch), target - 1));
    }
}

fn observed_instructions_are_stopped_at_and_then_executed<C: Tested>() {
    // nop; movs r0,#1; nop; b 2
    let (mut core, _) = core::<C>(&[0xBF00, 0x2001, 0xBF00, 0xE7FC]);
    core.observe(&[CODE + 2]).unwrap();
    let mut bus = bus();
    assert_eq!(run(&mut core, &mut bus), (1, Why::Observed, 2));
    assert_eq!(run(&mut core, &mut bus), (3, Why::Observed, 2));
    assert_eq!(run(&mut core, &mut bus), (3, Why::Observed, 2));
    core.observe(&[]).unwrap();
    bus.limit = 12;
    assert_eq!(run(&mut core, &mut bus), (12, Why::Limit, 2));
}

fn an_observed_instruction_in_a_conditional_block_does_not_confuse_the_stop_after_it<C: Tested>() {
    // cmp r5,r5; ite eq; moveq r1,#1 (observed); movne r1,#2; wfi
    let (mut core, _) = core::<C>(&[0x42AD, 0xBF0C, 0x2101, 0x2102, 0xBF30]);
    core.observe(&[CODE + 4]).unwrap();
    // At the IT, whose block contains the instruction.
    assert_eq!(run(&mut core, &mut bus()), (1, Why::Observed, 2));
    assert_eq!(run(&mut core, &mut bus()), (4, Why::Wfi, 10));
    assert_eq!(core.get(Register::R(1)), 1);
}

fn the_exclusive_monitor_can_be_cleared<C: Tested>() {
    // ldrex r1,[r0]; wfi; strex r2,r3,[r0]; wfi
    for clear in [false, true] {
        let (mut core, memory) = core::<C>(&[0xE850, 0x1F00, 0xBF30, 0xE840, 0x3200, 0xBF30]);
        core.set(Register::R(0), 0x2000_0000);
        core.set(Register::R(3), 42);
        assert_eq!(run(&mut core, &mut bus()).1, Why::Wfi);
        if clear {
            core.clear_exclusive().unwrap();
        }
        assert_eq!(run(&mut core, &mut bus()), (2, Why::Wfi, 12));
        assert_eq!(core.get(Register::R(2)), u32::from(clear));
        assert_eq!(memory.read(0x2000_0000, Size::Word), Some(if clear { Memory::POWER_ON } else { 42 }));
    }
}

fn code_in_itcm_runs_also_after_it_was_replaced<C: Tested>() {
    // at CODE: str r1,[r0]; bx r2 (to ITCM); in ITCM: movs r3,#1; wfi
    let (mut core, memory) = core::<C>(&[0x6001, 0x4710]);
    memory.write_slice(0x40, &[0x01, 0x23, 0x30, 0xBF]).unwrap();
    core.set(Register::R(0), 0x40);
    core.set(Register::R(1), 0xBF30_2301);
    core.set(Register::R(2), 0x41);
    assert_eq!(core.run(&mut bus()).unwrap(), CoreStop { instructions: 4, why: Why::Wfi });
    assert_eq!(core.get(Register::R(3)), 1);
    // movs r3,#2; wfi
    core.set(Register::R(1), 0xBF30_2302);
    core.set(Register::Pc, CODE);
    assert_eq!(core.run(&mut bus()).unwrap(), CoreStop { instructions: 4, why: Why::Wfi });
    assert_eq!(core.get(Register::R(3)), 2);
}

for_every_core!(
    a_limit_stops_before_a_block_and_counts_every_instruction,
    instructions_that_stop_are_told_apart,
    an_undefined_instruction_after_a_wait_is_not_taken_for_the_wait,
    an_access_knows_its_instruction_width_and_count,
    an_access_in_a_conditional_block_does_not_make_what_follows_conditional,
    a_load_without_result_stops_at_its_instruction_and_changes_nothing,
    a_limit_lowered_by_an_access_stops_at_the_end_of_its_block,
    stores_to_flash_are_the_buss_and_do_not_change_it,
    unaligned_accesses_reach_the_bus_whole,
    memory_without_clock_is_the_buss_until_it_is_switched_on,
    sev_is_heard_before_the_wait_that_follows,
    a_change_of_a_mask_is_noticed_at_once,
    floating_point_faults_where_it_stands_while_it_is_not_allowed,
    handler_mode_uses_the_main_stack_and_returns_by_exc_return,
    a_branch_to_an_even_address_or_to_data_faults,
    observed_instructions_are_stopped_at_and_then_executed,
    an_observed_instruction_in_a_conditional_block_does_not_confuse_the_stop_after_it,
    the_exclusive_monitor_can_be_cleared,
    code_in_itcm_runs_also_after_it_was_replaced,
);
