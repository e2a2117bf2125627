//! Option bytes of the flash, as programs and debuggers use them: swapped banks and readout protection (RM0399, 4.3.13,
//! 4.5.3).

use r4_mcu::{AccessError, MachineError, Memory, Reason};

use super::*;

const FLASH: u32 = 0x5200_2000;
const OPTKEYR: u32 = FLASH + 0x08;
const OPTCR: u32 = FLASH + 0x18;
const OPTSR_CUR: u32 = FLASH + 0x1C;
const OPTSR_PRG: u32 = FLASH + 0x20;
const BANK_BYTES: u32 = 1024 * 1024;
const OPTION_KEYS: [u32; 2] = [0x0819_2A3B, 0x4C5D_6E7F];
const OPTSTART: u32 = 1 << 1;
/// Option bytes as the Giga is delivered, with swapped banks, and at readout protection level 1.
const DELIVERED: u32 = 0x0B86_AAF0;
const SWAPPED: u32 = DELIVERED | 1 << 31;
const LEVEL_1: u32 = DELIVERED & !0xFF00 | 0xBB00;
const MS: u64 = 1_000_000;
const AXI: u32 = 0x2400_0000;

/// again: adds r3,#1; b again
const COUNTS: [u16; 2] = [0x3301, 0xE7FD];
/// again: adds r4,#1; b again
const COUNTS_ELSEWHERE: [u16; 2] = [0x3401, 0xE7FD];
/// str r1,[r0,#8]; str r2,[r0,#8] (the keys); str r4,[r0,#0x20] (OPTSR_PRG); str r5,[r0,#0x18] (OPTCR);
/// wait: ldr r6,[r0,#0x1C]; lsls r6,r6,#31; bne wait (OPT_BUSY); str r7,[r3]; b .
const CHANGES: [u16; 9] = [0x6081, 0x6082, 0x6204, 0x6185, 0x69C6, 0x07F6, 0xD1FC, 0x601F, FOR_EVER];

/// Address and value for the last store of [`CHANGES`]: AIRCR.SYSRESETREQ with its key, or a word of RAM.
const RESET: (u32, u32) = (0xE000_ED0C, 0x05FA_0004);
const NO_RESET: (u32, u32) = (AXI + 0x1000, 1);

fn changing(board: &mut Board, options: u32, (last, value): (u32, u32)) {
    let [key, other_key] = OPTION_KEYS;
    set(board, &[(0, FLASH), (1, key), (2, other_key), (3, last), (4, options), (5, OPTSTART), (7, value)]);
}

/// Makes a board with a program in bank 1, and another in bank 2 for the same addresses.
fn two_banks(code: &[u16]) -> Board {
    let mut board = board(code);
    write(&board, TABLE + BANK_BYTES, &halves(&[STACK, CODE | 1]));
    write(&board, CODE + BANK_BYTES, &COUNTS_ELSEWHERE);
    // These are bank 1's last sectors, directly below bank 2.
    write(&board, 0x080F_0000, &COUNTS);
    board.chip.set_option_bytes(DELIVERED);
    board.reset(ResetCause::Software).unwrap();
    board
}

/// Makes a board with swapped banks, as after [`CHANGES`].
fn swapped(code: &[u16]) -> Board {
    let mut board = two_banks(code);
    board.chip.set_option_bytes(SWAPPED);
    board.reset(ResetCause::Software).unwrap();
    board
}

#[test]
fn a_program_swaps_the_banks_and_the_other_program_starts() {
    let mut board = two_banks(&CHANGES);
    changing(&mut board, SWAPPED, RESET);
    let stopped = board.run_until(200 * MS).unwrap();
    assert_eq!(stopped.reason, Reason::Reset(ResetCause::Software));
    assert!((100 * MS..101 * MS).contains(&stopped.at_ns), "{}", stopped.at_ns);
    run_for(&mut board, MS);
    assert!(r(&board, 4) > 100_000 && r(&board, 3) == 0, "{} {}", r(&board, 4), r(&board, 3));
    assert_eq!(peek(&mut board, OPTCR), 1 << 31 | 1);
    assert_eq!(peek(&mut board, CODE + BANK_BYTES) as u16, CHANGES[0], "bank 1's program is there, unharmed");
    assert_eq!(board.chip.misuse(), []);
}

#[test]
fn power_that_goes_before_the_end_of_the_change_keeps_the_banks() {
    let mut board = two_banks(&CHANGES);
    changing(&mut board, SWAPPED, NO_RESET);
    board.chip.supply_at(99 * MS, 0);
    board.chip.supply_at(150 * MS, 3_300);
    run_for(&mut board, 99 * MS + 1_000);
    run_for(&mut board, 100 * MS);
    assert_eq!((peek(&mut board, OPTSR_CUR), peek(&mut board, OPTCR)), (DELIVERED, 1));
    assert_eq!(peek(&mut board, CODE) as u16, CHANGES[0]);
}

#[test]
fn with_swapped_banks_all_of_bank_1_is_executed_and_read_in_the_upper_megabyte() {
    let mut board = swapped(&COUNTS);
    for address in [CODE + BANK_BYTES, 0x081F_0000] {
        board.core.set(Register::Pc, address);
        set(&mut board, &[(3, 0)]);
        run_for(&mut board, MS);
        assert!(r(&board, 3) > 100_000, "{address:#x}");
        assert_eq!(peek(&mut board, address) as u16, COUNTS[0]);
    }
    // Sector 7 is erased there with the second set of registers, while the program runs in the other half.
    board.core.set(Register::Pc, CODE);
    let now_ns = board.now_ns();
    for (at, value) in [(0x104, 0x4567_0123), (0x104, 0xCDEF_89AB), (0x10C, 3 << 4 | 7 << 8 | 1 << 7 | 1 << 2)] {
        board.chip.write(now_ns, FLASH + at, Size::Word, value).unwrap();
    }
    set(&mut board, &[(4, 0)]);
    run_for(&mut board, 1_001 * MS);
    assert!(r(&board, 4) > 100_000_000, "bank 2 runs on: {}", r(&board, 4));
    assert_eq!(peek(&mut board, 0x081F_0000), u32::MAX);
    assert_eq!(peek(&mut board, CODE + BANK_BYTES) as u16, COUNTS[0]);
}

/// ldr r5,[r6]; b .
const LOADS: [u16; 2] = [0x6835, FOR_EVER];

#[test]
fn with_swapped_banks_the_kept_sectors_are_in_the_lower_megabyte_and_programmed_there() {
    let mut board = swapped(&LOADS);
    let now_ns = board.now_ns();
    // The first set of registers belongs to the lower megabyte: unlock, PG.
    for (at, value) in [(0x04, 0x4567_0123), (0x04, 0xCDEF_89AB), (0x0C, 3 << 4 | 1 << 1)] {
        board.chip.write(now_ns, FLASH + at, Size::Word, value).unwrap();
    }
    let address = 0x0808_0040;
    (0..8).for_each(|part| board.chip.write(now_ns, address + 4 * part, Size::Word, 0xAB00 + part).unwrap());
    board.core.set(Register::Pc, CODE + BANK_BYTES);
    set(&mut board, &[(6, address + 4)]);
    run_for(&mut board, MS);
    assert_eq!(r(&board, 5), 0xAB01);
    // Without the swap it is sector 4 of bank 2.
    board.chip.set_option_bytes(DELIVERED);
    board.reset(ResetCause::Software).unwrap();
    assert_eq!((peek(&mut board, address), peek(&mut board, address + BANK_BYTES)), (u32::MAX, 0xAB00));
}

#[test]
fn nothing_is_executed_from_the_kept_sectors_wherever_they_are() {
    for (mut board, address) in [(two_banks(&COUNTS), 0x0818_0000), (swapped(&COUNTS), 0x0808_0000)] {
        board.core.set(Register::Pc, address);
        let error = board.run_until(MS).unwrap_err().to_string();
        assert!(error.contains("execution from") && error.contains("is not modelled"), "{error}");
    }
}

#[test]
fn a_word_that_was_spoiled_goes_with_its_bank() {
    let mut board = two_banks(&COUNTS);
    board.chip.spoil_flash(0x0804_0040);
    board.chip.set_option_bytes(SWAPPED);
    board.reset(ResetCause::Software).unwrap();
    let now_ns = board.now_ns();
    let mut read = |address| board.chip.read(now_ns, address, Size::Word);
    assert_eq!((read(0x0804_0040), read(0x0814_0040)), (Ok(u32::MAX), Err(AccessError::Bus)));
    board.chip.spoil_flash(0x0804_0040);
    assert!(board.chip.memory().region(r4_mcu::Bank::Flash1).has_hole(0x0804_0044, 4));
}

#[test]
fn a_fetch_that_fails_is_flagged_as_a_load_is() {
    let mut board = board(&COUNTS);
    board.chip.spoil_flash(CODE);
    run_for(&mut board, MS);
    assert_eq!(exception(&board), 3, "a HardFault");
    assert_eq!(peek(&mut board, FLASH + 0x10), 1 << 26, "DBECCERR");
    assert_eq!(peek(&mut board, FLASH + 0x60), (CODE - TABLE) / 32);
}

#[test]
fn at_level_1_a_program_runs_until_a_debugger_is_connected_and_again_after_power_on() {
    let mut board = board(&COUNTS);
    board.chip.set_option_bytes(LEVEL_1);
    board.reset(ResetCause::Software).unwrap();
    run_for(&mut board, MS);
    assert!(r(&board, 3) > 100_000 && !board.chip.is_closed());
    board.chip.set_debugger(true);
    let error = board.run_until(10 * MS).unwrap_err();
    assert!(matches!(error, MachineError::LockUp { at_ns, .. } if at_ns < MS + 1_000), "{error}");
    assert_eq!(peek(&mut board, FLASH + 0x10), 1 << 23, "RDPERR");
    let misuse = board.chip.misuse()[0].what.clone();
    assert!(misuse.contains("readout protection level 1"), "{misuse}");
    // The debugger has disconnected, but the protection stays closed.
    board.chip.set_debugger(false);
    assert!(board.chip.is_closed());
    board.chip.supply_at(board.now_ns() + MS, 0);
    board.chip.supply_at(board.now_ns() + 2 * MS, 3_300);
    board.chip.advance(board.now_ns() + 4 * MS);
    board.reset(ResetCause::PowerOn).unwrap();
    run_for(&mut board, 8 * MS);
    assert!(!board.chip.is_closed() && r(&board, 3) > 100_000, "{}", r(&board, 3));
}

#[test]
fn at_level_1_a_debugger_s_program_in_ram_meets_bus_errors() {
    for address in [CODE, 0x0812_0000, 0x0818_0000, 0x3880_0000] {
        let mut board = board(&[FOR_EVER]);
        board.chip.set_option_bytes(LEVEL_1);
        board.chip.set_debugger(true);
        // RCC_AHB4ENR.BKPRAMEN enables the clock of the backup SRAM.
        let now_ns = board.now_ns();
        board.chip.write(now_ns, 0x5802_44E0, Size::Word, 1 << 28).unwrap();
        write(&board, AXI, &LOADS);
        board.core.set(Register::Pc, AXI);
        set(&mut board, &[(6, address)]);
        // The fault's vector is in flash, which cannot be read, so the processor locks up.
        let error = board.run_until(MS).unwrap_err();
        assert!(matches!(error, MachineError::LockUp { .. }), "{address:#x}: {error}");
        assert_eq!(r(&board, 5), 0);
    }
    let mut board = board(&[FOR_EVER]);
    board.chip.set_option_bytes(LEVEL_1);
    board.chip.set_debugger(true);
    let error = board.chip.read(0, 0x5800_4050, Size::Word).unwrap_err();
    assert!(error.to_string().contains("backup registers at readout protection"), "{error}");
}

/// Makes DMA2 copy a word to AXI SRAM, memory to memory; returns whether a transfer error occurred, and the word.
fn dma_copies(board: &mut Board, address: u32) -> (bool, Option<u32>) {
    const DMA2: u32 = 0x4002_0400;
    // Registers written: RCC_AHB1ENR.DMA2EN; NDTR, PAR, M0AR, FCR.DMDIS; words, DIR 2, EN.
    let start = 0b10 << 13 | 0b10 << 11 | 0b10 << 6 | 1;
    let writes =
        [(0x14, 1), (0x18, address), (0x1C, AXI), (0x24, 1 << 2), (0x10, start)].map(|(at, value)| (DMA2 + at, value));
    for (at, value) in [(0x5802_44D8, 1 << 1)].into_iter().chain(writes) {
        let now_ns = board.now_ns();
        board.chip.write(now_ns, at, Size::Word, value).unwrap();
    }
    // Bit LISR.TEIF0: the transfer error.
    (peek(board, DMA2) >> 3 & 1 != 0, board.chip.memory().read(AXI, Size::Word))
}

#[test]
fn dma_reads_what_the_processor_reads_directly() {
    let unchanged = (true, Some(Memory::POWER_ON));
    let mut board = swapped(&COUNTS);
    assert_eq!(dma_copies(&mut board, 0x081F_0000), (false, Some(0xE7FD_3301)));
    let mut board = swapped(&COUNTS);
    assert_eq!(dma_copies(&mut board, 0x0808_0000), unchanged);
    assert!(board.chip.misuse()[0].what.contains("DMA cannot reach"), "{:?}", board.chip.misuse());
    let mut board = two_banks(&COUNTS);
    board.chip.set_option_bytes(LEVEL_1);
    board.chip.set_debugger(true);
    assert_eq!(dma_copies(&mut board, CODE), unchanged);
    assert_eq!(peek(&mut board, FLASH + 0x10), 1 << 23, "RDPERR");
}

#[test]
fn the_way_back_to_level_0_takes_its_time_and_erases_all_that_was_protected() {
    let mut board = board(&[FOR_EVER]);
    // Set-up: PWR_CR1.DBP; a backup register; the backup SRAM.
    for (at, value) in [(0x5802_4800, 1 << 8), (0x5800_4050, 0xDF59)] {
        let now_ns = board.now_ns();
        board.chip.write(now_ns, at, Size::Word, value).unwrap();
    }
    board.chip.memory().write(0x3880_0010, Size::Word, 7).unwrap();
    board.chip.set_option_bytes(LEVEL_1);
    board.chip.set_debugger(true);
    write(&board, AXI, &CHANGES);
    board.core.set(Register::Pc, AXI);
    changing(&mut board, DELIVERED, NO_RESET);
    // The change takes 5 s for the banks, then that of the option bytes.
    run_for(&mut board, 5_099 * MS);
    let done = |board: &Board| board.chip.memory().read(NO_RESET.0, Size::Word);
    assert_eq!((done(&board), board.chip.backup_register(0)), (Some(Memory::POWER_ON), Some(0xDF59)));
    run_for(&mut board, 2 * MS);
    assert_eq!((done(&board), board.chip.backup_register(0)), (Some(1), Some(0)));
    assert_eq!(board.chip.memory().read(0x3880_0010, Size::Word), Some(0));
    assert_eq!([CODE, 0x0812_0000, 0x0818_0000].map(|at| peek(&mut board, at)), [u32::MAX; 3]);
    assert!(!board.chip.is_closed());
}

#[test]
fn an_option_that_is_not_modelled_ends_the_run_with_its_name() {
    let mut board = two_banks(&CHANGES);
    changing(&mut board, DELIVERED ^ 1 << 22, RESET);
    let error = board.run_until(MS).unwrap_err().to_string();
    assert!(error.starts_with(&format!("write of {OPTSR_PRG:#010x}")) && error.contains("BOOT_CM4"), "{error}");
    // Option bytes left by a programmer take effect at the next access to a peripheral.
    let mut board = two_banks(&CHANGES);
    changing(&mut board, DELIVERED, RESET);
    board.chip.set_option_bytes(DELIVERED & !0xFF00 | 0xCC00);
    let error = board.run_until(MS).unwrap_err().to_string();
    assert!(error.starts_with(&format!("write of {OPTKEYR:#010x}")) && error.contains("RDP level 2"), "{error}");
}
