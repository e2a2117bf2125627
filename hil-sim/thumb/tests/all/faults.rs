//! External faults of the chip: its crystal stops, its supply sags.

use r4_mcu::{Memory, Reason};

use super::*;

const RCC: u32 = 0x5802_4400;
const RSR: u32 = RCC + 0xD0;
const IWDG: u32 = 0x5800_4800;
const NMI: u16 = 2;
const MS: u64 = 1_000_000;

/// str r6,[r5] (starts the watchdog, or writes RAM); ldr r1,[r0]; orr r1,r1,r4; str r1,[r0] (HSEON);
/// wait: ldr r1,[r0]; lsls r2,r1,#14; bpl wait; movs r1,#2; str r1,[r0,#0x10] (SW = HSE);
/// count: adds r3,#1; b count
const ON_HSE: [u16; 12] =
    [0x602E, 0x6801, 0xEA41, 0x0104, 0x6001, 0x6801, 0x038A, 0xD5FC, 0x2102, 0x6101, 0x3301, 0xE7FD];
const HSEON: u32 = 1 << 16;
const HSECSSON: u32 = 1 << 19;

fn on_hse(bits: u32, store: (u32, u32)) -> Board {
    let mut board = board(&ON_HSE);
    set(&mut board, &[(0, RCC), (3, 0), (4, bits), (5, store.0), (6, store.1)]);
    run_for(&mut board, 3 * MS);
    assert_eq!(board.chip.core_hz(), 16_000_000);
    board
}

const SOME_RAM: (u32, u32) = (0x2000_0000, 77);

#[test]
fn a_program_on_a_guarded_crystal_goes_on_in_its_nmi_handler_when_it_stops() {
    let mut board = on_hse(HSEON | HSECSSON, SOME_RAM);
    // mov.w r1,#0x400; str r1,[r0,#0x68] (CICR.HSECSSC); adds r7,#1; bx lr
    write(&board, handler(NMI), &[0xF44F, 0x6180, 0x6681, 0x3701, 0x4770]);
    board.chip.stop_crystal_at(4 * MS);
    run_for(&mut board, 2 * MS);
    assert_eq!((board.chip.core_hz(), r(&board, 7), exception(&board)), (64_000_000, 1, 0));
    let before = r(&board, 3);
    run_for(&mut board, MS);
    assert!(r(&board, 3) > before);
    assert_eq!(board.chip.misuse(), []);
}

#[test]
fn an_nmi_that_is_not_cleared_comes_again_and_again() {
    let mut board = on_hse(HSEON | HSECSSON, SOME_RAM);
    // adds r7,#1; bx lr
    write(&board, handler(NMI), &[0x3701, 0x4770]);
    board.chip.stop_crystal_at(4 * MS);
    run_for(&mut board, MS + 10_000);
    let (entries, counted) = (r(&board, 7), r(&board, 3));
    run_for(&mut board, MS);
    assert!(entries > 10 && r(&board, 7) > 2 * entries, "{entries}, {}", r(&board, 7));
    assert_eq!(r(&board, 3), counted, "the program gets nowhere");
}

#[test]
fn without_its_guard_the_core_stands_still_until_the_watchdog() {
    let mut board = on_hse(HSEON, (IWDG, 0xCCCC));
    board.chip.stop_crystal_at(4 * MS);
    run_for(&mut board, 2 * MS);
    let (counted, executed) = (r(&board, 3), board.instructions());
    run_for(&mut board, 400 * MS);
    assert_eq!((r(&board, 3), board.instructions(), board.chip.core_hz()), (counted, executed, 0));
    // Expected time-out: 4096 counts of 4 periods of LSI from its start.
    let stopped = board.run_until(1000 * MS).unwrap();
    assert_eq!(stopped.reason, Reason::Reset(ResetCause::Watchdog));
    assert!((512 * MS..513 * MS).contains(&stopped.at_ns), "{}", stopped.at_ns);
    assert_eq!(board.chip.core_hz(), 64_000_000);
    run_for(&mut board, MS);
    assert!(board.instructions() > executed);
}

/// Option bytes with BOR_LEV 3 (2.7 V), the rest as the Giga has it.
const BROWN_OUT_3: u32 = 0x0B86_AAFC;

#[test]
fn a_dip_of_the_supply_resets_the_chip_and_leaves_its_ram() {
    let mut board = on_hse(HSEON, SOME_RAM);
    board.chip.set_option_bytes(BROWN_OUT_3);
    peek(&mut board, RSR);
    board.chip.supply_at(4 * MS, 2_600);
    board.chip.supply_at(6 * MS, 3_300);
    let stopped = board.run_until(100 * MS).unwrap();
    assert_eq!(stopped.reason, Reason::Reset(ResetCause::BrownOut));
    // The reset comes at the end of a block.
    assert!((4 * MS..4 * MS + 100).contains(&stopped.at_ns), "{}", stopped.at_ns);
    let executed = board.instructions();
    // The processor is held in reset, and then for 377 µs more.
    board.run_until(6 * MS + 376_000).unwrap();
    assert_eq!(board.instructions(), executed);
    board.run_until(7 * MS).unwrap();
    assert!(board.instructions() > executed);
    // BORRSTF and PINRSTF are set with the flags of the earlier power-on, which the program has not cleared.
    assert_eq!(peek(&mut board, RSR) >> 21 & 0b111, 0b111);
    assert_eq!(board.chip.memory().read(SOME_RAM.0, Size::Word), Some(SOME_RAM.1));
}

#[test]
fn without_a_brown_out_level_the_same_dip_does_nothing() {
    let mut board = on_hse(HSEON, SOME_RAM);
    board.chip.supply_at(4 * MS, 2_600);
    board.chip.supply_at(6 * MS, 3_300);
    assert_eq!(board.run_until(10 * MS).unwrap().reason, Reason::Time);
    assert_eq!(board.chip.core_hz(), 16_000_000);
}

#[test]
fn a_supply_that_goes_altogether_takes_the_ram_with_it() {
    let mut board = on_hse(HSEON, SOME_RAM);
    board.chip.supply_at(4 * MS, 0);
    board.chip.supply_at(1_000 * MS, 3_300);
    let stopped = board.run_until(2_000 * MS).unwrap();
    assert_eq!(stopped.reason, Reason::Reset(ResetCause::PowerOn));
    assert!((4 * MS..4 * MS + 100).contains(&stopped.at_ns), "{}", stopped.at_ns);
    assert_eq!(board.run_until(999 * MS).unwrap().reason, Reason::Time);
    assert_eq!(board.chip.memory().read(SOME_RAM.0, Size::Word), Some(Memory::POWER_ON));
    assert_eq!(peek(&mut board, RSR) >> 21 & 0b111, 0b111, "POR, pin, BOR");
    board.run_until(1_002 * MS).unwrap();
    assert!(board.instructions() > 0 && board.chip.core_hz() == 64_000_000);
}
