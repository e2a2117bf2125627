//! Machine on every backend, with a chip of six registers around it (`common::TestChip`): time, interrupts, sleep,
//! resets, faults, and the reasons that end a run. Programs are hand-assembled, their source is next to them.

#![allow(clippy::unwrap_used, reason = "failing is a test's way to speak")]

use crate::common::{PERIPHERAL, TestChip, Tested, for_every_core, machine};
use r4_mcu::cpu::{Core, Register};
use r4_mcu::{Bank, Machine, MachineError, Reason, ResetCause, Settings, Size, Stopped};

type TestMachine<C> = Machine<C, TestChip>;

const TABLE: u32 = 0x0800_0000;
const MAIN: u32 = 0x0800_0200;
const HANDLER: u32 = 0x0800_0300;
const FAULT: u32 = 0x0800_0400;
const MILLISECOND: u64 = 1_000_000;

/// Endless loop: the instruction `b .`.
const SPIN: [u16; 1] = [0xE7FE];

/// Machine with a program: code of the reset handler, and of interrupt 0's handler. HardFault spins.
fn program<C: Tested>(main: &[u16], handler: &[u16]) -> TestMachine<C> {
    with_settings(main, handler, Settings { stop_at_breakpoints: true, ..Settings::default() })
}

fn with_settings<C: Tested>(main: &[u16], handler: &[u16], settings: Settings) -> TestMachine<C> {
    let mut machine = machine(settings);
    let memory = &machine.chip.memory;
    for (exception, vector) in [(0, 0x2000_8000), (1, MAIN | 1), (3, FAULT | 1), (16, HANDLER | 1)] {
        memory.write(TABLE + 4 * exception, Size::Word, vector).unwrap();
    }
    for (at, code) in [(MAIN, main), (HANDLER, handler), (FAULT, &SPIN)] {
        let bytes: Vec<u8> = code.iter().flat_map(|half| half.to_le_bytes()).collect();
        memory.write_slice(at, &bytes).unwrap();
    }
    machine.reset(ResetCause::PowerOn).unwrap();
    machine
}

fn word<C: Core>(machine: &TestMachine<C>, address: u32) -> u32 {
    machine.chip.memory.read(address, Size::Word).unwrap()
}

fn register<C: Core>(machine: &TestMachine<C>, index: u8) -> u32 {
    machine.core.get(Register::R(index))
}

/// Program `movw r0,#0; movt r0,#0x4000; movw r4,#0xE100; movt r4,#0xE000; movs r1,#1; str r1,[r4]; movw r1,#1000; 1:
/// str r1,[r0,#4]; wfi; b 1b`: sets an alarm 1 us after the last one each time, and sleeps.
const ALARM: [u16; 15] = [
    0xF240, 0x0000, 0xF2C4, 0x0000, 0xF24E, 0x1400, 0xF2CE, 0x0400, 0x2101, 0x6021, 0xF240, 0x31E8, 0x6041, 0xBF30,
    0xE7FC,
];

/// Handler `movw r0,#0; movt r0,#0x4000; movw r3,#0; movt r3,#0x2000; ldr r2,[r0,#4]; ldr r1,[r3]; adds r1,#1; str
/// r1,[r3]; str r2,[r3,#4]; movs r1,#0; str r1,[r0]; bx lr`: counts at 0x2000_0000, stores the time after it, takes the
/// line down.
const COUNT: [u16; 16] = [
    0xF240, 0x0000, 0xF2C4, 0x0000, 0xF240, 0x0300, 0xF2C2, 0x0300, 0x6842, 0x6819, 0x3101, 0x6019, 0x605A, 0x2100,
    0x6001, 0x4770,
];

fn alarms<C: Tested>() -> TestMachine<C> {
    let mut machine = program::<C>(&ALARM, &COUNT);
    machine.chip.memory.write(0x2000_0000, Size::Word, 0).unwrap();
    machine.start_trace();
    machine
}

fn an_interrupt_wakes_at_its_moment_and_time_passes_by_instructions_and_sleep<C: Tested>() {
    let mut machine = alarms::<C>();
    let stopped = machine.run_until(1_020).unwrap();
    assert_eq!(stopped.reason, Reason::Time);
    // 7 instructions before the store of 1000, at 240 MHz: 29.17 ns, the store is at 30. WFI, 1030 ns: 4 instructions of
    // the handler, 16.67 ns, and the time is read at 1047.
    assert_eq!(machine.chip.writes[0], (30, PERIPHERAL + 4, 1000));
    machine.run_until(1_100).unwrap();
    assert_eq!((word(&machine, 0x2000_0000), word(&machine, 0x2000_0004)), (1, 1_047));
    machine.run_until(MILLISECOND).unwrap();
    // Each round: 1000 ns from the store to the alarm, 12 instructions of the handler, a branch, and the store again.
    let rounds = (MILLISECOND - 30) / (1000 + 13 * 1000 / 240 + 1);
    assert!(u64::from(word(&machine, 0x2000_0000)).abs_diff(rounds) <= 1, "{rounds}");
    // It slept nearly all the time: 15 instructions a round.
    assert!(machine.instructions() < 16 * rounds);
}

fn a_run_does_not_depend_on_how_it_is_cut<C: Tested>() {
    let whole = |mut machine: TestMachine<C>| {
        machine.run_until(2 * MILLISECOND).unwrap();
        (machine.trace(), machine.instructions(), word(&machine, 0x2000_0000))
    };
    let expected = whole(alarms());
    assert!(expected.0.unwrap().exceptions() > 3_000);
    for step_ns in [1_000_000, 1_000, 333, 61] {
        let mut machine = alarms::<C>();
        let mut at_ns = 0;
        while at_ns < 2 * MILLISECOND {
            at_ns += step_ns;
            machine.run_until(at_ns.min(2 * MILLISECOND)).unwrap();
        }
        assert_eq!((machine.trace(), machine.instructions(), word(&machine, 0x2000_0000)), expected, "{step_ns}");
    }
}

/// Machine with the same program and an IT block after the count: `cmp r1,#0; ite ge; movge r5,#1; movlt r5,#2`.
fn with_if_then<C: Tested>() -> TestMachine<C> {
    let mut handler = COUNT.to_vec();
    handler.splice(13..13, [0x2900, 0xBFAC, 0x2501, 0x2502]);
    let mut machine = program::<C>(&ALARM, &handler);
    machine.chip.memory.write(0x2000_0000, Size::Word, 0).unwrap();
    machine.start_trace();
    machine
}

fn a_debugger_does_not_change_what_happens<C: Tested>() {
    let result = |machine: &TestMachine<C>| {
        let registers: Vec<u32> = (0..13).map(|index| register(machine, index)).collect();
        (machine.trace(), machine.instructions(), machine.now_ns(), word(machine, 0x2000_0000), registers)
    };
    let mut free = with_if_then::<C>();
    free.run_until(MILLISECOND).unwrap();
    let expected = result(&free);
    assert_eq!((expected.4[5], expected.3 > 900), (1, true));
    // Stops in the middle of blocks, including the middle of the IT block.
    let mut watched = with_if_then::<C>();
    watched.observe(&[MAIN + 20, MAIN + 26, HANDLER + 18, HANDLER + 30]).unwrap();
    let mut stops = 0;
    let mut visited = std::collections::BTreeSet::new();
    while watched.run_until(MILLISECOND).unwrap().reason != Reason::Time {
        visited.insert(watched.core.get(Register::Pc));
        stops += 1;
    }
    // For an instruction in the IT block it stops before the block.
    assert_eq!(visited.into_iter().collect::<Vec<_>>(), [MAIN + 20, MAIN + 26, HANDLER + 18, HANDLER + 28]);
    assert_eq!(result(&watched), expected);
    assert!(stops > 3 * expected.3, "{stops}");
    // Every instruction is a step of its own.
    let mut stepped = with_if_then::<C>();
    let mut steps = 0;
    while stepped.step_until(MILLISECOND).unwrap().reason != Reason::Time {
        steps += 1;
    }
    assert_eq!(result(&stepped), expected);
    // ITE and its two instructions are one step, and so is taking an exception.
    assert!(steps + 2 * u64::from(expected.3) >= expected.1, "{steps}");
}

fn a_step_is_one_instruction_or_one_exception<C: Tested>() {
    let mut machine = alarms::<C>();
    let mut visited = Vec::new();
    for _ in 0..16 {
        assert_eq!(machine.step_until(MILLISECOND).unwrap().reason, Reason::Stepped);
        visited.push(machine.core.get(Register::Pc) - MAIN);
    }
    // Seven instructions of four bytes with two of two, WFI, and the handler once the alarm has come.
    let handler = HANDLER - MAIN;
    assert_eq!(
        visited,
        [
            4,
            8,
            12,
            16,
            18,
            20,
            24,
            26,
            28,
            handler,
            handler + 4,
            handler + 8,
            handler + 12,
            handler + 16,
            handler + 18,
            handler + 20
        ]
    );
}

fn a_reset_by_the_program_or_the_chip_starts_again_and_keeps_memory<C: Tested>() {
    // movw r3,#0; movt r3,#0x2400; ldr r1,[r3]; adds r1,#1; str r1,[r3]; movw r0,#0xED0C; movt r0,#0xE000; movw r1,#4;
    // movt r1,#0x05FA; str r1,[r0]; b .
    let request = [
        0xF240, 0x0300, 0xF2C2, 0x4300, 0x6819, 0x3101, 0x6019, 0xF64E, 0x500C, 0xF2CE, 0x0000, 0xF240, 0x0104, 0xF2C0,
        0x51FA, 0x6001, 0xE7FE,
    ];
    let mut machine = program::<C>(&request, &SPIN);
    machine.chip.memory.write(0x2400_0000, Size::Word, 5).unwrap();
    for count in 6..9 {
        let stopped = machine.run_until(MILLISECOND).unwrap();
        assert_eq!(stopped.reason, Reason::Reset(ResetCause::Software));
        assert_eq!((word(&machine, 0x2400_0000), machine.core.get(Register::Pc)), (count, MAIN));
    }
    // movw r0,#0; movt r0,#0x4000; movs r1,#1; str r1,[r0,#12]; b .
    let mut machine = program::<C>(&[0xF240, 0x0000, 0xF2C4, 0x0000, 0x2101, 0x60C1, 0xE7FE], &SPIN);
    // 5 instructions, at the end of their block.
    let expected = Stopped { at_ns: 21, reason: Reason::Reset(ResetCause::Watchdog) };
    assert_eq!(machine.run_until(MILLISECOND).unwrap(), expected);
    assert_eq!(machine.core.get(Register::Sp), 0x2000_8000);
}

fn what_is_not_modelled_ends_the_run_with_the_place<C: Tested>() {
    // nop; movw r6,#0x4444; movt r6,#0x5802; ldrb r5,[r6]; b .
    let mut machine = program::<C>(&[0xBF00, 0xF244, 0x4644, 0xF6C5, 0x0602, 0x7835, 0xE7FE], &SPIN);
    let error = machine.run_until(MILLISECOND).unwrap_err();
    let MachineError::Unmodelled { address, size, write, at_ns, location, .. } = &error else { panic!("{error}") };
    assert_eq!((*address, *size, *write, *at_ns), (0x5802_4444, Size::Byte, false, 13));
    assert_eq!(location, "0x0800020a");
    assert_eq!(error.to_string(), "read of 0x58024444 (byte) at 13 ns from 0x0800020a: test: nothing at 0x58024444");
}

fn a_fault_in_the_hard_fault_handler_locks_up<C: Tested>() {
    let mut machine = program::<C>(&[0xBF00, 0xDE00], &SPIN);
    machine.chip.memory.write(FAULT, Size::Half, 0xDE00).unwrap();
    machine.reset(ResetCause::PowerOn).unwrap();
    let error = machine.run_until(MILLISECOND).unwrap_err();
    assert!(matches!(&error, MachineError::LockUp { location, .. } if location == "0x08000400"), "{error}");
    assert_eq!(machine.processor().faults.to_string(), "CFSR 0x00010000, HFSR 0x40000000");
}

fn bus_errors_of_loads_are_ignored_under_faultmask_when_asked_for<C: Tested>() {
    // movw r0,#0xED14; movt r0,#0xE000; movw r1,#0x300; str r1,[r0]; movw r6,#0; movt r6,#0x0818; cpsid f; ldr r5,[r6],#4;
    // ldr r7,[r0,#20] (CFSR); cpsie f; ldr r5,[r6]; b .
    let code = [
        0xF64E, 0x5014, 0xF2CE, 0x0000, 0xF240, 0x3100, 0x6001, 0xF240, 0x0600, 0xF6C0, 0x0618, 0xB671, 0xF856, 0x5B04,
        0x6947, 0xB661, 0x6835, 0xE7FE,
    ];
    let mut machine = program::<C>(&code, &SPIN);
    machine.observe(&[MAIN + 32]).unwrap();
    let stopped = machine.run_until(MILLISECOND).unwrap();
    assert_eq!(stopped.reason, Reason::Observed { address: MAIN + 32 });
    // The load wrote back its address; PRECISERR and BFARVALID are set, and no fault was taken.
    assert_eq!((register(&machine, 5), register(&machine, 6), register(&machine, 7)), (0, 0x0818_0004, 0x8200));
    // Without the mask, the next one is a fault.
    machine.observe(&[FAULT]).unwrap();
    assert_eq!(machine.run_until(MILLISECOND).unwrap().reason, Reason::Observed { address: FAULT });
    let frame = machine.core.get(Register::Sp);
    assert_eq!((word(&machine, frame + 0x18), register(&machine, 5)), (MAIN + 32, 0));
}

fn a_refused_store_is_an_imprecise_fault<C: Tested>() {
    // movw r6,#0; movt r6,#0x9000; str r6,[r6]; movs r1,#1; b next; next: movs r1,#2; b .
    let mut machine = program::<C>(&[0xF240, 0x0600, 0xF2C9, 0x0600, 0x6036, 0x2101, 0xE7FF, 0x2102, 0xE7FE], &SPIN);
    machine.observe(&[FAULT]).unwrap();
    assert_eq!(machine.run_until(MILLISECOND).unwrap().reason, Reason::Observed { address: FAULT });
    assert_eq!(machine.processor().faults.to_string(), "CFSR 0x00000400, HFSR 0x40000000");
    // At the end of the block.
    assert_eq!(word(&machine, machine.core.get(Register::Sp) + 0x18), MAIN + 14);
}

fn an_unaligned_load_of_a_peripheral_is_a_usage_fault<C: Tested>() {
    // movw r6,#1; movt r6,#0x4000; ldr r5,[r6]; b .
    let mut machine = program::<C>(&[0xF240, 0x0601, 0xF2C4, 0x0600, 0x6835, 0xE7FE], &SPIN);
    machine.observe(&[FAULT]).unwrap();
    machine.run_until(MILLISECOND).unwrap();
    assert_eq!(machine.processor().faults.to_string(), "CFSR 0x01000000, HFSR 0x40000000");
}

fn a_memory_is_used_as_soon_as_its_clock_is_on<C: Tested>() {
    // movw r0,#0; movt r0,#0x4000; movw r3,#0x100; movt r3,#0x3000; movs r1,#1; str r1,[r0,#8] (on); movs r2,#77;
    // str r2,[r3]; ldr r4,[r3]; bkpt #1
    let code = [
        0xF240, 0x0000, 0xF2C4, 0x0000, 0xF240, 0x1300, 0xF2C3, 0x0300, 0x2101, 0x6081, 0x224D, 0x601A, 0x681C, 0xBE01,
    ];
    let mut machine = program::<C>(&code, &SPIN);
    assert!(!machine.chip.memory.is_enabled(Bank::Sram1));
    assert_eq!(machine.run_until(MILLISECOND).unwrap().reason, Reason::Breakpoint { operand: 1 });
    assert_eq!((register(&machine, 4), word(&machine, 0x3000_0100)), (77, 77));
    // Switched off again, by the chip: the memory at the stack pointer is unusable then.
    machine.chip.memory.set_enabled(Bank::Sram1, false);
    machine.core.set(Register::Pc, MAIN + 24);
    machine.observe(&[FAULT]).unwrap();
    assert_eq!(machine.run_until(MILLISECOND).unwrap().reason, Reason::Observed { address: FAULT });
    assert_eq!(machine.processor().faults.to_string(), "CFSR 0x00008200, HFSR 0x40000000, BFAR 0x30000100");
}

fn a_stack_without_memory_is_told_to_the_handler_and_its_use_there_locks_up<C: Tested>() {
    let mut machine = program::<C>(&[0xBF00, 0xDE00], &SPIN);
    // push {r4}; b .
    machine.chip.memory.write_slice(FAULT, &[0x10, 0xB4, 0xFE, 0xE7]).unwrap();
    machine.reset(ResetCause::PowerOn).unwrap();
    machine.core.set(Register::Sp, 0x3000_0100);
    machine.observe(&[FAULT]).unwrap();
    assert_eq!(machine.run_until(MILLISECOND).unwrap().reason, Reason::Observed { address: FAULT });
    // UNDEFINSTR, and STKERR of the frame that could not be stored.
    assert_eq!(machine.processor().faults.to_string(), "CFSR 0x00011000, HFSR 0x40000000");
    assert_eq!(machine.core.get(Register::Sp), 0x3000_00E0);
    let error = machine.run_until(MILLISECOND).unwrap_err();
    assert!(matches!(&error, MachineError::LockUp { what, .. } if what == "a store was refused"), "{error}");
}

fn the_outside_is_let_run_when_it_wants<C: Tested>() {
    // movw r0,#0; movt r0,#0x4000; movs r1,#1; str r1,[r0,#16]; b next; next: b .
    let mut machine = program::<C>(&[0xF240, 0x0000, 0xF2C4, 0x0000, 0x2101, 0x6101, 0xE7FF, 0xE7FE], &SPIN);
    // 5 instructions of the first block.
    assert_eq!(machine.run_until(MILLISECOND).unwrap(), Stopped { at_ns: 21, reason: Reason::Outside });
    machine.chip.outside = false;
    assert_eq!(machine.run_until(MILLISECOND).unwrap().reason, Reason::Time);
}

fn breakpoints_without_a_debugger_are_hard_faults<C: Tested>() {
    let mut machine = with_settings::<C>(&[0xBF00, 0xBE07], &SPIN, Settings::default());
    machine.observe(&[FAULT]).unwrap();
    assert_eq!(machine.run_until(MILLISECOND).unwrap().reason, Reason::Observed { address: FAULT });
    assert_eq!(machine.processor().faults.to_string(), "HFSR 0x80000000, DFSR 0x00000002");
}

fn uses_of_the_processor_that_are_not_modelled_say_so<C: Tested>() {
    // movw r0,#0xED10; movt r0,#0xE000; movs r1,#4 (SLEEPDEEP); str r1,[r0]; wfi; b .
    let mut machine = program::<C>(&[0xF64E, 0x5010, 0xF2CE, 0x0000, 0x2104, 0x6001, 0xBF30, 0xE7FE], &SPIN);
    let error = machine.run_until(MILLISECOND).unwrap_err().to_string();
    assert_eq!(error, "at 21 ns, 0x0800020e: SLEEPDEEP: stop and standby modes are not modelled");
    // movw r6,#1; movt r6,#0x0818; bx r6
    let mut machine = program::<C>(&[0xF240, 0x0601, 0xF6C0, 0x0618, 0x4730], &SPIN);
    let error = machine.run_until(MILLISECOND).unwrap_err().to_string();
    assert_eq!(error, "at 13 ns, 0x08180000: execution from the flash's upper megabyte at 0x08180000 is not modelled");
}

fn sleep_on_exit_does_not_go_back_to_the_main_program<C: Tested>() {
    // movw r0,#0xED10; movt r0,#0xE000; movs r1,#2; str r1,[r0]; movw r0,#0; movt r0,#0x4000; movw r4,#0xE100; movt
    // r4,#0xE000; movs r1,#1; str r1,[r4]; movw r1,#1000; str r1,[r0,#4]; wfi; movs r5,#1; b .
    let code = [
        0xF64E, 0x5010, 0xF2CE, 0x0000, 0x2102, 0x6001, 0xF240, 0x0000, 0xF2C4, 0x0000, 0xF24E, 0x1400, 0xF2CE, 0x0400,
        0x2101, 0x6021, 0xF240, 0x31E8, 0x6041, 0xBF30, 0x2501, 0xE7FE,
    ];
    let mut machine = program::<C>(&code, &COUNT);
    machine.chip.memory.write(0x2000_0000, Size::Word, 0).unwrap();
    machine.run_until(MILLISECOND).unwrap();
    assert_eq!((word(&machine, 0x2000_0000), register(&machine, 5)), (1, 0));
}

fn a_pending_interrupt_is_an_event_when_asked_for<C: Tested>() {
    // movw r0,#0xED10; movt r0,#0xE000; movs r1,#16 (SEVONPEND); str r1,[r0]; movw r0,#0; movt r0,#0x4000; movw r1,#1000;
    // str r1,[r0,#4]; wfe; ldr r5,[r0,#4]; bkpt #1
    let code = [
        0xF64E, 0x5010, 0xF2CE, 0x0000, 0x2110, 0x6001, 0xF240, 0x0000, 0xF2C4, 0x0000, 0xF240, 0x31E8, 0x6041, 0xBF20,
        0x6845, 0xBE01,
    ];
    let mut machine = program::<C>(&code, &SPIN);
    assert_eq!(machine.run_until(MILLISECOND).unwrap().reason, Reason::Breakpoint { operand: 1 });
    // The interrupt is not enabled; the alarm is at 30 + 1000 ns.
    assert_eq!(register(&machine, 5), 1_030);
}

fn cycles_are_of_the_core_clock_and_not_instructions<C: Tested>() {
    // DEMCR.TRCENA, DWT_LAR, CYCCNTENA, CYCCNT = 0; movw r2,#480; 1: subs r2,#1; bne 1b; ldr r5,[r0,#4]; bkpt #1
    let code = [
        0xF64E, 0x50FC, 0xF2CE, 0x0000, 0x2101, 0x0609, 0x6001, 0xF241, 0x0000, 0xF2CE, 0x0000, 0xF64C, 0x6155, 0xF2CC,
        0x51AC, 0xF8C0, 0x1FB0, 0x2101, 0x6001, 0x2100, 0x6041, 0xF240, 0x12E0, 0x3A01, 0xD1FD, 0x6845, 0xBE01,
    ];
    let mut machine = program::<C>(&code, &SPIN);
    machine.run_until(MILLISECOND).unwrap();
    // 1 + 960 instructions after the one that cleared it, and that one: 962 at 240 MHz are 4008.3 ns, 1924 cycles at
    // 480 MHz. Each end is rounded to a nanosecond, half a cycle.
    assert!(register(&machine, 5).abs_diff(1924) <= 1, "{}", register(&machine, 5));
}

fn an_event_that_never_ends_is_found<C: Tested>() {
    let mut machine = program::<C>(&SPIN, &SPIN);
    machine.run_until(100).unwrap();
    // The chip asks to be advanced to a past time, indefinitely: its alarm has been reported, and only this event
    // raises it again.
    machine.chip.stuck = true;
    let error = machine.run_until(MILLISECOND).unwrap_err().to_string();
    assert!(error.contains("an event that never ends"), "{error}");
}

for_every_core!(
    an_interrupt_wakes_at_its_moment_and_time_passes_by_instructions_and_sleep,
    a_run_does_not_depend_on_how_it_is_cut,
    a_debugger_does_not_change_what_happens,
    a_step_is_one_instruction_or_one_exception,
    a_reset_by_the_program_or_the_chip_starts_again_and_keeps_memory,
    what_is_not_modelled_ends_the_run_with_the_place,
    a_fault_in_the_hard_fault_handler_locks_up,
    bus_errors_of_loads_are_ignored_under_faultmask_when_asked_for,
    a_refused_store_is_an_imprecise_fault,
    an_unaligned_load_of_a_peripheral_is_a_usage_fault,
    a_memory_is_used_as_soon_as_its_clock_is_on,
    a_stack_without_memory_is_told_to_the_handler_and_its_use_there_locks_up,
    the_outside_is_let_run_when_it_wants,
    breakpoints_without_a_debugger_are_hard_faults,
    uses_of_the_processor_that_are_not_modelled_say_so,
    sleep_on_exit_does_not_go_back_to_the_main_program,
    a_pending_interrupt_is_an_event_when_asked_for,
    cycles_are_of_the_core_clock_and_not_instructions,
    an_event_that_never_ends_is_found,
);
