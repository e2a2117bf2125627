//! Consistency of the flash: erased and programmed words are what the program reads and executes (RM0399, 4.3).

use r4_mcu::AccessError;

use super::*;

const FLASH: u32 = 0x5200_2000;
const SECTOR: u32 = 128 * 1024;
const KEYS: [u32; 2] = [0x4567_0123, 0xCDEF_89AB];
const PG: u32 = 1 << 1;
const ERASE: u32 = 1 << 7 | 1 << 2;
const X64: u32 = 3 << 4;
const MS: u64 = 1_000_000;
const AXI: u32 = 0x2400_0000;

/// Returns the address of a bank's registers.
fn registers(bank: u32) -> u32 {
    FLASH + 0x100 * bank
}

/// Access to the flash registers as a debugger has it, while the processor executes nothing.
struct Programmer {
    board: Board,
    now_ns: u64,
}

impl Programmer {
    fn new() -> Self {
        let mut programmer = Self { board: board(&[FOR_EVER]), now_ns: 0 };
        for bank in 0..2 {
            KEYS.iter().for_each(|key| programmer.write(registers(bank) + 4, *key));
        }
        programmer
    }

    fn write(&mut self, address: u32, value: u32) {
        self.board.chip.write(self.now_ns, address, Size::Word, value).unwrap();
    }

    fn read(&mut self, address: u32) -> Result<u32, AccessError> {
        self.board.chip.read(self.now_ns, address, Size::Word)
    }

    /// Reads a word as the processor would.
    fn load(&mut self, address: u32) -> Option<u32> {
        let memory = self.board.chip.memory();
        let (region, _) = memory.locate(address).unwrap();
        if region.direct().read && !region.has_hole(address, 4) {
            return memory.read(address, Size::Word);
        }
        self.read(address).ok()
    }

    fn finish(&mut self, bank: u32) {
        self.now_ns += 1_100 * MS;
        self.board.chip.advance(self.now_ns);
        assert_eq!(self.read(registers(bank) + 0x10), Ok(1 << 16), "EOP and nothing else");
        self.write(registers(bank) + 0x14, u32::MAX);
    }

    fn erase(&mut self, bank: u32, sector: u32) {
        self.write(registers(bank) + 0x0C, X64 | sector << 8 | ERASE);
        self.finish(bank);
    }

    fn program(&mut self, bank: u32, address: u32, value: u32) {
        self.write(registers(bank) + 0x0C, X64 | PG);
        (0..8).for_each(|part| self.write(address + 4 * part, value + part));
        self.finish(bank);
        self.write(registers(bank) + 0x0C, X64);
    }
}

#[test]
fn every_sector_of_both_banks_is_programmed_and_erased() {
    let mut programmer = Programmer::new();
    // Erasing sector 0 erases the vector table and the program too.
    for bank in 0..2 {
        (0..8).for_each(|sector| programmer.erase(bank, sector));
    }
    let place = |index: u32| 0x0800_0000 + index * SECTOR + index * 0x140;
    for index in 0..16 {
        programmer.program(index / 8, place(index), 0x1000 * (index + 1));
    }
    for index in 0..16 {
        for part in 0..8 {
            let expected = 0x1000 * (index + 1) + part;
            assert_eq!(programmer.load(place(index) + 4 * part), Some(expected), "sector {index}");
        }
        assert_eq!(programmer.load(place(index) + 32), Some(u32::MAX));
    }
    // Each erasure clears one sector and no other.
    for index in 0..16 {
        programmer.erase(index / 8, index % 8);
        for other in 0..16 {
            let left = other > index;
            assert_eq!(
                programmer.load(place(other)) != Some(u32::MAX),
                left,
                "sector {other} after the erase of {index}"
            );
        }
    }
    assert_eq!(programmer.board.chip.misuse(), []);
}

#[test]
fn a_word_programmed_twice_is_a_bus_error_until_its_sector_is_erased() {
    for address in [0x0804_0040, 0x0810_0040, 0x0818_0040] {
        let (bank, sector) = ((address >> 20) & 1, address >> 17 & 7);
        let mut programmer = Programmer::new();
        programmer.program(bank, address, 5);
        programmer.program(bank, address, 5);
        assert_eq!(programmer.load(address), None, "{address:#x}");
        assert_eq!(programmer.load(address + 32), Some(u32::MAX), "its neighbour is as it was");
        programmer.write(registers(bank) + 0x14, u32::MAX);
        programmer.erase(bank, sector);
        assert_eq!(programmer.load(address), Some(u32::MAX));
        assert_eq!(programmer.board.chip.misuse().len(), 1);
    }
}

#[test]
fn a_power_cut_in_the_middle_of_an_erase_leaves_a_sector_that_cannot_be_read_and_no_other() {
    for (bank, sector) in [(0, 3), (1, 2), (1, 5)] {
        let mut programmer = Programmer::new();
        let base = 0x0800_0000 + bank * 8 * SECTOR + sector * SECTOR;
        programmer.program(bank, base, 1);
        programmer.program(bank, base + SECTOR, 2);
        programmer.write(registers(bank) + 0x0C, X64 | sector << 8 | ERASE);
        programmer.board.chip.supply_at(programmer.now_ns + 500 * MS, 0);
        programmer.board.chip.supply_at(programmer.now_ns + 600 * MS, 3_300);
        run_for(&mut programmer.board, programmer.now_ns + 700 * MS);
        programmer.now_ns = programmer.board.now_ns();
        assert_eq!((programmer.load(base), programmer.load(base + SECTOR)), (None, Some(2)));
        KEYS.iter().for_each(|key| programmer.write(registers(bank) + 4, *key));
        programmer.write(registers(bank) + 0x14, u32::MAX);
        programmer.erase(bank, sector);
        assert_eq!(programmer.load(base), Some(u32::MAX));
    }
}

/// str r1,[r0]; str r2,[r0] (the keys); str r4,[r0,#8] (CR); count: adds r3,#1; b count
const ERASES: [u16; 5] = [0x6001, 0x6002, 0x6084, 0x3301, 0xE7FD];

fn erasing(mut board: Board, bank: u32, sector: u32) -> Board {
    set(&mut board, &[(0, registers(bank) + 4), (1, KEYS[0]), (2, KEYS[1]), (3, 0), (4, X64 | sector << 8 | ERASE)]);
    board
}

#[test]
fn an_erase_of_its_own_bank_stops_the_program_and_one_of_the_other_bank_does_not() {
    for (bank, stands_still) in [(0, true), (1, false)] {
        let mut board = erasing(board(&ERASES), bank, 3);
        run_for(&mut board, 999 * MS);
        let (executed, counted) = (board.instructions(), r(&board, 3));
        assert_eq!(counted < 100, stands_still, "{counted}");
        assert_eq!(executed < 300, stands_still, "{executed}");
        run_for(&mut board, 2 * MS);
        assert!(r(&board, 3) > counted + 1_000, "it goes on");
        assert_eq!((exception(&board), board.chip.misuse().len()), (0, 0));
    }
}

#[test]
fn a_load_from_a_bank_that_erases_waits_for_it() {
    // The program of [`ERASES`], with ldr r5,[r6] before the count.
    let mut board = erasing(board(&[0x6001, 0x6002, 0x6084, 0x6835, 0x3301, 0xE7FD]), 1, 0);
    set(&mut board, &[(6, 0x0812_0000)]);
    write(&board, 0x0812_0000, &halves(&[0xCAFE]));
    run_for(&mut board, 999 * MS);
    assert_eq!((r(&board, 3), r(&board, 5)), (0, 0));
    run_for(&mut board, 2 * MS);
    assert_eq!((r(&board, 3) > 1_000, r(&board, 5)), (true, 0xCAFE));
}

#[test]
fn a_program_in_ram_erases_the_bank_it_came_from_and_runs_on() {
    for ram in [AXI, 0x2000_0400, 0x0000_0400] {
        let mut board = erasing(board(&[FOR_EVER]), 0, 0);
        write(&board, ram, &ERASES);
        board.core.set(Register::Pc, ram);
        run_for(&mut board, 1_001 * MS);
        assert!(r(&board, 3) > 100_000_000 / 2, "{ram:#x}: {}", r(&board, 3));
        assert_eq!(board.chip.memory().read(CODE, Size::Word), Some(u32::MAX));
    }
}

#[test]
fn a_program_that_erases_itself_is_gone() {
    let mut board = erasing(board(&ERASES), 0, 0);
    // Erased flash holds no instruction, and no vector table.
    let error = board.run_until(2_000 * MS).unwrap_err();
    assert!(error.to_string().starts_with("lock-up at 1000"), "{error}");
}

#[test]
fn a_program_in_ram_that_changes_itself_executes_what_it_wrote() {
    // again: adds r3,#1; cmp r3,#1; bne out; strh r1,[r2]; dsb; isb; b again; out: b .
    let code = [0x3301, 0x2B01, 0xD105, 0x8011, 0xF3BF, 0x8F4F, 0xF3BF, 0x8F6F, 0xE7F6, 0xE7FE];
    for ram in [AXI, 0x2000_0400, 0x0000_0400] {
        let mut board = board(&[FOR_EVER]);
        write(&board, ram, &code);
        // The new word is movs r3,#7, in place of its first instruction.
        set(&mut board, &[(1, 0x2307), (2, ram), (3, 0)]);
        board.core.set(Register::Pc, ram);
        run_for(&mut board, 10_000);
        assert_eq!((r(&board, 3), pc(&board)), (7, ram + 18), "{ram:#x}");
    }
}
