//! Memory protection unit as programs see it (DDI0403E B3.5, B1.5.14).

use r4_mcu::Size;

use super::*;

const RBAR: u32 = 0xE000_ED9C;
const CFSR: u32 = 0xE000_ED28;
const HFSR: u32 = 0xE000_ED2C;
const MMFAR: u32 = 0xE000_ED34;
const SHCSR: u32 = 0xE000_ED24;

const HARD_FAULT: u16 = 3;
const MEM_MANAGE: u16 = 4;

/// MPU_CTRL: on, with the default map where no region applies.
const ON: u32 = 0b101;
const ON_EVERYWHERE: u32 = 0b111;

/// Returns the RASR value of an enabled region of 2^(n + 1) bytes.
const fn sized(n: u32) -> u32 {
    n << 1 | 1
}
const NO_ACCESS: u32 = 0;
const READ_ONLY: u32 = 6 << 24;
const FULL: u32 = 3 << 24;
const NEVER_EXECUTE: u32 = 1 << 28;

/// str r1,[r0] (RBAR); str r2,[r0,#4] (RASR); str r3,[r0,#-8] (CTRL); dsb; isb
const SET_UP: [u16; 8] = [0x6001, 0x6042, 0xF840, 0x3C08, 0xF3BF, 0x8F4F, 0xF3BF, 0x8F6F];
const AFTER: u32 = CODE + 2 * SET_UP.len() as u32;

/// Makes a board with a region at `base`, then `code`, with R4 and R5 set, and MemManage enabled or not.
fn protected(base: u32, attributes: u32, control: u32, code: &[u16], r4: u32, handled: bool) -> Board {
    let mut program = Vec::new();
    if handled {
        // str r7,[r6]: SHCSR.MEMFAULTENA
        program.push(0x6037);
    } else {
        // nop
        program.push(0xBF00);
    }
    program.push(0xBF00);
    program.extend(SET_UP);
    program.extend(code);
    program.push(FOR_EVER);
    let mut board = board(&program);
    set(&mut board, &[(0, RBAR), (1, base | 0x10), (2, attributes), (3, control), (4, r4), (5, 0x5555_AAAA)]);
    set(&mut board, &[(6, SHCSR), (7, 1 << 16)]);
    board
}

const FAULTING: u32 = AFTER + 4;

/// Returns the return address in the exception's frame, the faulting instruction.
fn returns_to(board: &mut Board) -> u32 {
    let sp = board.core.get(Register::Sp);
    board.chip.memory().read(sp + 0x18, Size::Word).unwrap()
}

/// Case of a fault: code, R4, and the reported address.
type Case = (&'static [u16], u32, u32);

/// Guard region of 256 bytes in the middle of DTCM, as below a stack: 0x2000_4000 to 0x2000_40FF.
const GUARD: u32 = 0x2000_4000;
const CASES: [Case; 6] = [
    // str r5,[r4]
    (&[0x6025], GUARD, GUARD),
    // ldr r5,[r4]
    (&[0x6825], GUARD + 0xFC, GUARD + 0xFC),
    // strb r5,[r4,#1]!
    (&[0xF804, 0x5F01], GUARD - 1, GUARD),
    // stmdb r4!,{r5-r8}: the lowest word first
    (&[0xE924, 0x01E0], GUARD + 0x108, GUARD + 0xF8),
    // str r5,[r4,#2]: unaligned, from before the region into it
    (&[0xF8C4, 0x5002], GUARD - 4, GUARD + 1),
    // stmia r4!,{r5-r7}: reaches it in its last word
    (&[0xC4E0], GUARD - 8, GUARD),
];

#[test]
fn a_data_access_that_is_forbidden_is_a_mem_manage_fault_with_its_address() {
    for (code, r4, address) in CASES {
        let mut board = protected(GUARD, NO_ACCESS | sized(7), ON, code, r4, true);
        run_for(&mut board, 2_000);
        let told = format!("{code:04x?}");
        assert_eq!((exception(&board), pc(&board)), (MEM_MANAGE, handler(MEM_MANAGE)), "{told}");
        assert_eq!((peek(&mut board, CFSR), peek(&mut board, MMFAR)), (0x82, address), "{told}");
        // The frame names the instruction, which has not written its base back.
        assert_eq!(returns_to(&mut board), FAULTING, "{told}");
        assert_eq!((r(&board, 4), r(&board, 5)), (r4, 0x5555_AAAA), "{told}");
    }
}

#[test]
fn without_its_handler_it_is_a_hard_fault_that_may_access_what_is_forbidden() {
    let mut board = protected(GUARD, NO_ACCESS | sized(7), ON, &[0x6025], GUARD, false);
    // The handler: str r5,[r4]; b .
    write(&board, handler(HARD_FAULT), &[0x6025, FOR_EVER]);
    run_for(&mut board, 2_000);
    assert_eq!((exception(&board), pc(&board)), (HARD_FAULT, handler(HARD_FAULT) + 2));
    assert_eq!((peek(&mut board, CFSR), peek(&mut board, HFSR)), (0x82, 1 << 30));
    assert_eq!(board.chip.memory().read(GUARD, Size::Word), Some(0x5555_AAAA));
    // With HFNMIENA that is a fault in the fault handler: lock-up.
    let mut board = protected(GUARD, NO_ACCESS | sized(7), ON_EVERYWHERE, &[0x6025], GUARD, false);
    write(&board, handler(HARD_FAULT), &[0x6025, FOR_EVER]);
    let error = board.run_until(2_000).unwrap_err();
    assert!(error.to_string().starts_with("lock-up"), "{error}");
}

#[test]
fn what_is_around_a_region_and_what_it_allows_is_as_without_it() {
    // Accesses just below and above the guard, and reads where only writes are forbidden.
    for (attributes, code, r4) in [
        (NO_ACCESS | sized(7), 0x6025, GUARD - 4),
        (NO_ACCESS | sized(7), 0x6025, GUARD + 0x100),
        (READ_ONLY | sized(7), 0x6825, GUARD),
        (FULL | NEVER_EXECUTE | sized(7), 0x6025, GUARD),
        // The second eighth of the region, 32 bytes, is disabled.
        (NO_ACCESS | 0b10 << 8 | sized(7), 0x6025, GUARD + 0x20),
    ] {
        let mut board = protected(GUARD, attributes, ON, &[code], r4, true);
        run_for(&mut board, 2_000);
        assert_eq!((exception(&board), pc(&board)), (0, FAULTING + 2), "{attributes:#x} {r4:#x}");
        let value = board.chip.memory().read(r4, Size::Word).unwrap();
        assert_eq!(value, r(&board, 5), "{attributes:#x} {r4:#x}");
    }
    let mut board = protected(GUARD, READ_ONLY | sized(7), ON, &[0x6025], GUARD, true);
    run_for(&mut board, 2_000);
    assert_eq!((exception(&board), peek(&mut board, CFSR)), (MEM_MANAGE, 0x82));
}

#[test]
fn address_zero_is_caught_and_so_is_a_fetch_from_where_nothing_may_be_executed() {
    // ldr r5,[r4] with R4 = 0: the region is the first 32 bytes of ITCM.
    let mut board = protected(0, NO_ACCESS | sized(4), ON, &[0x6825], 0, true);
    run_for(&mut board, 2_000);
    assert_eq!((exception(&board), peek(&mut board, CFSR), peek(&mut board, MMFAR)), (MEM_MANAGE, 0x82, 0));
    // bx r4 to code in flash that must not be executed, and to the first 32 bytes of ITCM.
    for (base, to) in [(0x0804_0000, 0x0804_0010), (0, 0x10)] {
        let mut board = protected(base, READ_ONLY | NEVER_EXECUTE | sized(4), ON, &[0x4720], to | 1, true);
        write(&board, to, &[FOR_EVER]);
        run_for(&mut board, 2_000);
        assert_eq!((exception(&board), peek(&mut board, CFSR)), (MEM_MANAGE, 1), "{to:#x}");
        assert_eq!(returns_to(&mut board), to);
    }
}

#[test]
fn a_stack_that_reaches_its_guard_at_an_exception_is_told() {
    // mov sp,r4; svc #0
    let mut board = protected(GUARD, NO_ACCESS | sized(7), ON, &[0x46A5, 0xDF00], GUARD + 0x110, true);
    run_for(&mut board, 2_000);
    // MSTKERR is set; MemManage waits for SVCall, which has the same priority.
    assert_eq!((exception(&board), peek(&mut board, CFSR)), (11, 1 << 4));
    assert_eq!(peek(&mut board, SHCSR) >> 13 & 1, 1);
    // mov sp,r4; push {r0-r7}: the fault finds no room for its frame either.
    let mut board = protected(GUARD, NO_ACCESS | sized(7), ON, &[0x46A5, 0xB4FF], GUARD + 0x110, true);
    run_for(&mut board, 2_000);
    assert_eq!((exception(&board), peek(&mut board, CFSR)), (MEM_MANAGE, 0x92));
    assert_eq!(peek(&mut board, MMFAR), GUARD + 0xF0);
}

#[test]
fn protection_ends_with_a_reset() {
    let mut board = protected(GUARD, NO_ACCESS | sized(7), ON, &[0x6025], GUARD, true);
    run_for(&mut board, 2_000);
    assert_eq!(exception(&board), MEM_MANAGE);
    board.reset(ResetCause::Pin).unwrap();
    // str r5,[r4]; b .
    write(&board, CODE, &[0x6025, FOR_EVER]);
    set(&mut board, &[(4, GUARD), (5, 7)]);
    run_for(&mut board, 2_000);
    assert_eq!((exception(&board), board.chip.memory().read(GUARD, Size::Word)), (0, Some(7)));
}
