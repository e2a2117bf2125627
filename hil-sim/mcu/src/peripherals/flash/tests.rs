//! Tests of programming, erasing and reading, with the sequences of a driver.

use super::{
    bank::*,
    options::{
        CHANGE_NS as OPTION_NS, DELIVERED as OPTIONS, IWDG1_SW, KEYS as OPTION_KEYS, MER, OPT_BUSY, OPTLOCK, OPTSTART,
    },
    *,
};
use crate::{Signal, testing::Bench};

/// Sector 4 of bank 2, where the R4 firmware stores its configuration, and first registers of bank 2.
const SECTOR: u32 = 0x0818_0000;
const KEYR2: u32 = BANK_2 + KEYR;
const CR2: u32 = BANK_2 + CR;
const SR2: u32 = BANK_2 + SR;
const CCR2: u32 = BANK_2 + CCR;
const PG: u32 = 1 << 1;
const ERASE_SECTOR_4: u32 = 4 << 8 | 1 << 7 | 1 << 2;
const X64: u32 = 3 << 4;

fn unlocked() -> (Flash<PlainCells>, Bench) {
    let (mut flash, mut bench) = (Flash::new(PlainCells::new()), Bench::default());
    bench.write(&mut flash, KEYR2, 0x4567_0123);
    bench.write(&mut flash, KEYR2, 0xCDEF_89AB);
    assert_eq!(bench.read(&mut flash, CR2) & LOCK, 0);
    (flash, bench)
}

fn store(flash: &mut Flash<PlainCells>, bench: &mut Bench, address: u32, value: u32) {
    flash.store(address, Size::Word, value, &mut bench.context());
}

fn load(flash: &mut Flash<PlainCells>, bench: &mut Bench, address: u32) -> Result<u32, LoadError> {
    flash.load(address, Size::Word, &mut bench.context())
}

/// Programs the eight words of a flash word; the first one is `value`.
fn program(flash: &mut Flash<PlainCells>, bench: &mut Bench, address: u32, value: u32) {
    for part in 0..8 {
        store(flash, bench, address + 4 * part, value + part);
    }
}

#[test]
fn a_word_is_programmed_when_its_last_byte_comes_and_takes_100_us() {
    let (mut flash, mut bench) = unlocked();
    bench.write(&mut flash, CR2, X64 | PG | EOP);
    program(&mut flash, &mut bench, SECTOR, 100);
    assert_eq!(bench.read(&mut flash, SR2), 0b101, "BSY and QW");
    assert_eq!(load(&mut flash, &mut bench, SECTOR), Err(LoadError::Busy { until_ns: 100_000 }));
    assert_eq!(load(&mut flash, &mut bench, BASE), Ok(u32::MAX), "the other bank can be read meanwhile");
    bench.run(&mut flash, 100_000);
    assert_eq!(bench.take_signals(), [Signal::Irq { number: IRQ, level: true }]);
    assert_eq!(bench.read(&mut flash, SR2), EOP);
    bench.write(&mut flash, SR2, EOP);
    assert_eq!(bench.read(&mut flash, SR2), EOP, "only CCR clears it");
    bench.write(&mut flash, CCR2, EOP);
    assert_eq!(bench.take_signals(), [Signal::Irq { number: IRQ, level: false }]);
    assert_eq!(load(&mut flash, &mut bench, SECTOR + 28), Ok(107));
    assert_eq!(flash.load(SECTOR + 1, Size::Byte, &mut bench.context()), Ok(0));
    bench.assert_no_misuse();
}

#[test]
fn the_parallelism_sets_the_pace() {
    for (psize, takes_ns) in [(0, 290_000), (1, 180_000), (2, 130_000), (3, 100_000)] {
        let (mut flash, mut bench) = unlocked();
        bench.write(&mut flash, CR2, psize << 4 | PG);
        program(&mut flash, &mut bench, SECTOR, 0);
        assert_eq!(flash.next_event_ns(), takes_ns);
    }
}

#[test]
fn an_erase_takes_a_second_and_concerns_one_sector() {
    let (mut flash, mut bench) = unlocked();
    flash.cells.load(SECTOR - BASE, &[1; 32]);
    flash.cells.load(SECTOR - BASE + 128 * 1024, &[2; 32]);
    bench.write(&mut flash, CR2, X64 | ERASE_SECTOR_4);
    assert_eq!(bench.read(&mut flash, CR2) >> 7 & 1, 0, "START clears itself");
    bench.run(&mut flash, 999_999_999);
    assert_eq!(bench.read(&mut flash, SR2) & 1, 1);
    bench.run(&mut flash, 1_000_000_000);
    assert_eq!(bench.read(&mut flash, SR2), EOP);
    assert_eq!(load(&mut flash, &mut bench, SECTOR), Ok(u32::MAX));
    assert_eq!(load(&mut flash, &mut bench, SECTOR + 128 * 1024), Ok(0x0202_0202));
    bench.assert_no_misuse();
}

#[test]
fn a_word_programmed_twice_is_a_bus_error_with_its_address() {
    let (mut flash, mut bench) = unlocked();
    bench.write(&mut flash, CR2, X64 | PG);
    for _ in 0..2 {
        program(&mut flash, &mut bench, SECTOR + 64, 5);
        bench.run(&mut flash, bench.now_ns + 100_000);
    }
    let misuse = bench.take_misuse();
    assert!(misuse[0].contains("0x08180040 is programmed without"), "{misuse:?}");
    assert_eq!(load(&mut flash, &mut bench, SECTOR + 68), Err(LoadError::Ecc));
    assert_ne!(bench.read(&mut flash, SR2) & DBECCERR, 0);
    // The fault is in word 2 of the fifth sector of the bank.
    assert_eq!(bench.read(&mut flash, BANK_2 + ECC_FA), 4 * 4096 + 2);
}

#[test]
fn a_single_error_is_corrected_and_flagged() {
    let (mut flash, mut bench) = unlocked();
    flash.cells.set(BANK_WORDS + 7, Word::Corrected([0x11; 32]));
    bench.write(&mut flash, CR2, X64 | SNECCERR);
    assert_eq!(load(&mut flash, &mut bench, BASE + 0x10_0000 + 7 * 32), Ok(0x1111_1111));
    assert_eq!(bench.take_signals(), [Signal::Irq { number: IRQ, level: true }]);
    assert_eq!(bench.read(&mut flash, BANK_2 + ECC_FA), 7);
}

#[test]
fn sequences_that_the_chip_refuses_set_their_flag() {
    let cases: [(&str, u32, &[u32], u32); 3] = [
        ("without PG", X64, &[0], PGSERR),
        ("another word before the first is full", X64 | PG, &[0, 32], INCERR),
        ("with a sector erase chosen", X64 | PG | 1 << 2, &[0], PGSERR),
    ];
    for (name, cr, stores, flag) in cases {
        let (mut flash, mut bench) = unlocked();
        bench.write(&mut flash, CR2, cr);
        for at in stores {
            store(&mut flash, &mut bench, SECTOR + at, 1);
        }
        assert_eq!(bench.read(&mut flash, SR2), flag, "{name}");
        bench.write(&mut flash, CR2, X64 | PG);
        store(&mut flash, &mut bench, SECTOR, 1);
        assert_eq!(bench.read(&mut flash, SR2), flag | PGSERR, "{name}: nothing goes on before the flag is cleared");
        bench.write(&mut flash, CCR2, flag | PGSERR);
        program(&mut flash, &mut bench, SECTOR, 1);
        assert_eq!(bench.read(&mut flash, SR2), 0b101, "{name}");
    }
}

#[test]
fn a_byte_stored_twice_is_flagged_and_the_newer_one_is_programmed() {
    let (mut flash, mut bench) = unlocked();
    bench.write(&mut flash, CR2, X64 | PG);
    store(&mut flash, &mut bench, SECTOR, 1);
    program(&mut flash, &mut bench, SECTOR, 100);
    assert_eq!(bench.read(&mut flash, SR2), STRBERR | 0b101, "and it goes on");
    bench.run(&mut flash, 100_000);
    assert_eq!(load(&mut flash, &mut bench, SECTOR), Ok(100));
}

#[test]
fn a_word_that_is_not_full_waits_until_it_is_forced_or_given_up() {
    let (mut flash, mut bench) = unlocked();
    bench.write(&mut flash, CR2, X64 | PG);
    store(&mut flash, &mut bench, SECTOR, 1);
    assert_eq!(bench.read(&mut flash, SR2), 0b010, "WBNE");
    bench.write(&mut flash, CR2, X64 | PG | 1 << 6);
    bench.run(&mut flash, 100_000);
    assert_eq!(load(&mut flash, &mut bench, SECTOR), Ok(1));
    assert_eq!(load(&mut flash, &mut bench, SECTOR + 4), Ok(u32::MAX));
    store(&mut flash, &mut bench, SECTOR + 32, 1);
    bench.write(&mut flash, CR2, X64);
    assert_eq!(bench.read(&mut flash, SR2), EOP | PGSERR);
}

#[test]
fn a_wrong_key_locks_until_a_reset() {
    let (mut flash, mut bench) = (Flash::new(PlainCells::new()), Bench::default());
    bench.write(&mut flash, KEYR2, 0x4567_0123);
    bench.write(&mut flash, KEYR2, 0x1234_5678);
    assert_eq!(bench.take_misuse().len(), 1);
    for key in [0x4567_0123, 0xCDEF_89AB] {
        bench.write(&mut flash, KEYR2, key);
    }
    bench.take_misuse();
    assert_eq!(bench.read(&mut flash, CR2), CR_AT_RESET);
    bench.write(&mut flash, CR2, X64 | ERASE_SECTOR_4);
    assert_eq!(bench.read(&mut flash, SR2), 0);
    assert_eq!(bench.take_misuse().len(), 1, "the write to a locked register");
    flash.reset(&mut bench.context());
    for key in [0x4567_0123, 0xCDEF_89AB] {
        bench.write(&mut flash, KEYR2, key);
    }
    assert_eq!(bench.read(&mut flash, CR2) & LOCK, 0);
}

#[test]
fn a_reset_during_an_erase_leaves_nothing_that_can_be_trusted() {
    let (mut flash, mut bench) = unlocked();
    flash.cells.load(SECTOR - BASE, &[1; 64]);
    bench.write(&mut flash, CR2, X64 | ERASE_SECTOR_4);
    bench.run(&mut flash, 500_000_000);
    flash.reset(&mut bench.context());
    assert_eq!(bench.read(&mut flash, SR2), 0);
    assert_eq!(load(&mut flash, &mut bench, SECTOR), Err(LoadError::Ecc));
}

/// Cells that lose their power in the next step.
struct Failing;

impl FlashCells for Failing {
    fn word(&mut self, _: u32) -> Word {
        Word::ERASED
    }

    fn program(&mut self, _: u32, _: &[u8; WORD_BYTES]) -> Result<(), PowerLost> {
        Err(PowerLost)
    }

    fn erase(&mut self, _: u32, _: u32) -> Result<(), PowerLost> {
        Err(PowerLost)
    }

    fn abandon(&mut self, _: u32, _: u32) {}
}

#[test]
fn a_lost_power_is_told() {
    let (mut flash, mut bench) = (Flash::new(Failing), Bench::default());
    for key in [0x4567_0123, 0xCDEF_89AB] {
        bench.write(&mut flash, KEYR2, key);
    }
    bench.write(&mut flash, CR2, X64 | ERASE_SECTOR_4);
    bench.run(&mut flash, 999_999_999);
    assert!(!flash.power_lost());
    bench.run(&mut flash, 1_000_000_000);
    assert!(flash.power_lost());
    assert_eq!(flash.next_event_ns(), u64::MAX);
}

#[test]
fn too_few_wait_states_are_misuse() {
    let (mut flash, mut bench) = (Flash::new(PlainCells::new()), Bench::default());
    bench.write(&mut flash, ACR, 2 << 4 | 4);
    flash.set_conditions(240_000_000, VoltageScale::Vos0, &mut bench.context());
    bench.assert_no_misuse();
    bench.write(&mut flash, ACR, 2 << 4 | 3);
    assert!(bench.take_misuse()[0].contains("at least 4 and 2 are needed"));
}

/// Option bytes with BOR_LEV 3 and the hardware watchdog.
const OTHER_OPTIONS: u32 = OPTIONS & !IWDG1_SW | 0b11 << 2;

#[test]
fn option_bytes_are_those_of_a_giga_and_change_by_keys_and_a_start() {
    let (mut flash, mut bench) = unlocked();
    assert_eq!((bench.read(&mut flash, OPTSR_CUR), bench.read(&mut flash, OPTCR)), (0x0B86_AAF0, OPTLOCK));
    bench.write(&mut flash, OPTSR_PRG, OTHER_OPTIONS);
    bench.write(&mut flash, OPTCR, OPTSTART);
    assert_eq!(bench.take_misuse().len(), 2, "locked");
    for key in OPTION_KEYS {
        bench.write(&mut flash, OPTKEYR, key);
    }
    bench.write(&mut flash, OPTSR_PRG, OTHER_OPTIONS);
    bench.write(&mut flash, OPTCR, OPTSTART);
    assert_eq!(bench.read(&mut flash, OPTSR_CUR), OPTIONS | OPT_BUSY);
    bench.run(&mut flash, bench.now_ns + OPTION_NS);
    assert_eq!(bench.read(&mut flash, OPTSR_CUR), OTHER_OPTIONS);
    assert_eq!((flash.brown_out_level(), flash.starts_watchdog()), (3, true));
    bench.write(&mut flash, OPTCR, OPTLOCK);
    assert_eq!(bench.read(&mut flash, OPTCR), OPTLOCK);
    flash.reset(&mut bench.context());
    assert_eq!(bench.read(&mut flash, OPTSR_CUR), OTHER_OPTIONS, "they stay");
    bench.assert_no_misuse();
}

#[test]
fn a_wrong_option_key_and_a_change_that_a_reset_interrupts_change_nothing() {
    let (mut flash, mut bench) = unlocked();
    for key in [OPTION_KEYS[0], 1, OPTION_KEYS[0], OPTION_KEYS[1]] {
        bench.write(&mut flash, OPTKEYR, key);
    }
    assert_eq!((bench.read(&mut flash, OPTCR), bench.take_misuse().len()), (OPTLOCK, 3));
    flash.reset(&mut bench.context());
    for key in OPTION_KEYS {
        bench.write(&mut flash, OPTKEYR, key);
    }
    bench.write(&mut flash, OPTSR_PRG, OTHER_OPTIONS);
    bench.write(&mut flash, OPTCR, OPTSTART);
    bench.run(&mut flash, bench.now_ns + OPTION_NS - 1);
    flash.reset(&mut bench.context());
    bench.run(&mut flash, bench.now_ns + OPTION_NS);
    assert_eq!(bench.read(&mut flash, OPTSR_CUR), OPTIONS);
}

const SWAP: u32 = 1 << 31;
const BANK_1: u32 = BASE;
const BANK_2_ADDRESS: u32 = BASE + BYTES / 2;

fn unlock_options(flash: &mut Flash<PlainCells>, bench: &mut Bench) {
    OPTION_KEYS.iter().for_each(|key| bench.write(flash, OPTKEYR, *key));
}

fn unlock_bank_1(flash: &mut Flash<PlainCells>, bench: &mut Bench) {
    for key in [0x4567_0123, 0xCDEF_89AB] {
        bench.write(flash, KEYR, key);
    }
}

/// Makes a flash with both banks and the option bytes unlocked, and the first word of each sector programmed: 0x100 *
/// bank + sector.
fn filled() -> (Flash<PlainCells>, Bench) {
    let (mut flash, mut bench) = unlocked();
    unlock_bank_1(&mut flash, &mut bench);
    unlock_options(&mut flash, &mut bench);
    for index in 0..2 * BANK_SECTORS {
        let value = 0x100 * (index / BANK_SECTORS + 1) + index % BANK_SECTORS;
        let bytes = value.to_le_bytes();
        flash.cells.load(index * SECTOR_WORDS * WORD_BYTES as u32, &bytes);
    }
    (flash, bench)
}

/// Returns the first word of each sector in order of address; `None` where it is erased.
fn sectors(flash: &mut Flash<PlainCells>, bench: &mut Bench) -> Vec<Option<u32>> {
    let firsts = (BASE..BASE + BYTES).step_by(SECTOR_WORDS as usize * WORD_BYTES);
    firsts.map(|address| load(flash, bench, address).ok().filter(|value| *value != u32::MAX)).collect()
}

fn full(bank: u32) -> Vec<Option<u32>> {
    (0..BANK_SECTORS).map(|sector| Some(0x100 * bank + sector)).collect()
}

fn erased() -> Vec<Option<u32>> {
    vec![None; BANK_SECTORS as usize]
}

fn change_options(flash: &mut Flash<PlainCells>, bench: &mut Bench, options: u32) {
    bench.write(flash, OPTSR_PRG, options);
    bench.write(flash, OPTCR, OPTSTART);
}

fn swapped() -> (Flash<PlainCells>, Bench) {
    let (mut flash, mut bench) = filled();
    change_options(&mut flash, &mut bench, OPTIONS | SWAP);
    bench.run(&mut flash, OPTION_NS);
    flash.reset(&mut bench.context());
    unlock_bank_1(&mut flash, &mut bench);
    for key in [0x4567_0123, 0xCDEF_89AB] {
        bench.write(&mut flash, KEYR2, key);
    }
    (flash, bench)
}

#[test]
fn banks_are_swapped_by_the_reset_after_the_change_and_not_before() {
    let (mut flash, mut bench) = filled();
    change_options(&mut flash, &mut bench, OPTIONS | SWAP);
    bench.run(&mut flash, OPTION_NS);
    assert_eq!((bench.read(&mut flash, OPTSR_CUR), bench.read(&mut flash, OPTCR)), (OPTIONS | SWAP, 0));
    assert_eq!(sectors(&mut flash, &mut bench), [full(1), full(2)].concat());
    flash.reset(&mut bench.context());
    assert_eq!(bench.read(&mut flash, OPTCR), 1 << 31 | OPTLOCK);
    assert_eq!(bench.read(&mut flash, BANK_2 + OPTCR), 1 << 31 | OPTLOCK, "common registers are in both sets");
    assert_eq!(sectors(&mut flash, &mut bench), [full(2), full(1)].concat());
    assert!(flash.is_swapped());
    // The way back: SWAP_BANK is read-only, and writing it with the other bits is no misuse.
    unlock_options(&mut flash, &mut bench);
    bench.modify(&mut flash, OPTCR, 1 << 31, 0);
    assert_eq!(bench.read(&mut flash, OPTCR), 1 << 31);
    bench.write(&mut flash, OPTSR_PRG, OPTIONS);
    bench.modify(&mut flash, OPTCR, 0, OPTSTART);
    bench.run(&mut flash, bench.now_ns + OPTION_NS);
    flash.reset(&mut bench.context());
    assert_eq!(sectors(&mut flash, &mut bench), [full(1), full(2)].concat());
    bench.assert_no_misuse();
}

#[test]
fn a_power_cut_before_the_end_of_the_change_keeps_the_banks() {
    for (ns, is_swapped) in [(OPTION_NS - 1, false), (OPTION_NS, true)] {
        let (mut flash, mut bench) = filled();
        change_options(&mut flash, &mut bench, OPTIONS | SWAP);
        bench.run(&mut flash, ns);
        flash.power_on();
        flash.reset(&mut bench.context());
        assert_eq!(flash.is_swapped(), is_swapped);
        assert_eq!(bench.read(&mut flash, OPTSR_PRG) & SWAP != 0, is_swapped);
    }
}

#[test]
fn with_swapped_banks_the_first_registers_are_those_of_the_first_address() {
    let (mut flash, mut bench) = swapped();
    bench.write(&mut flash, CR, X64 | ERASE_SECTOR_4);
    assert_eq!((bench.read(&mut flash, SR) & 1, bench.read(&mut flash, SR2) & 1), (1, 0));
    assert!(flash.busy_until_ns(BANK_1).is_some() && flash.busy_until_ns(BANK_2_ADDRESS).is_none());
    bench.run(&mut flash, bench.now_ns + 1_000_000_000);
    let mut first = full(2);
    first[4] = None;
    assert_eq!(sectors(&mut flash, &mut bench), [first, full(1)].concat());
    // Cells are numbered by bank: this was bank 2's sector.
    assert_eq!(flash.cells.word(BANK_WORDS + 4 * SECTOR_WORDS), Word::ERASED);
    // Programming, its misuse and the address of an error follow the swapped addresses too.
    bench.write(&mut flash, CR2, X64 | PG);
    for _ in 0..2 {
        program(&mut flash, &mut bench, SECTOR + 64, 5);
        bench.run(&mut flash, bench.now_ns + 100_000);
    }
    assert!(bench.take_misuse()[0].contains("0x08180040 is programmed without"));
    assert_eq!(load(&mut flash, &mut bench, SECTOR + 64), Err(LoadError::Ecc));
    assert_eq!(bench.read(&mut flash, BANK_2 + ECC_FA), 4 * 4096 + 2);
    assert_eq!((flash.word_at(SECTOR + 64), bench.read(&mut flash, SR) & DBECCERR), (Some(4 * 4096 + 2), 0));
}

#[test]
fn a_bank_is_erased_in_5_s_and_the_other_is_not() {
    const BER: u32 = 1 << 3;
    for (at, bank) in [(CR, 0), (CR2, 1)] {
        let (mut flash, mut bench) = filled();
        // SER in addition to BER has no effect (4.3.10).
        bench.write(&mut flash, at, X64 | BER | ERASE_SECTOR_4);
        bench.run(&mut flash, 4_999_999_999);
        assert!(flash.busy_until_ns(BASE + bank * BYTES / 2).is_some());
        bench.run(&mut flash, 5_000_000_000);
        let mut expected = [full(1), full(2)];
        expected[bank as usize] = erased();
        assert_eq!(sectors(&mut flash, &mut bench), expected.concat());
        bench.assert_no_misuse();
    }
}

#[test]
fn a_mass_erase_takes_both_banks_at_once_and_only_unlocked_ones() {
    let (mut flash, mut bench) = filled();
    // PSIZE belongs to each bank: by half-words it takes 8 s.
    bench.write(&mut flash, CR2, 1 << 4);
    bench.write(&mut flash, OPTCR, MER);
    assert_eq!([CR, CR2].map(|at| bench.read(&mut flash, at) >> 3 & 1), [1, 1], "BER");
    assert_eq!((bench.read(&mut flash, OPTCR), bench.read(&mut flash, OPTSR_CUR)), (0, OPTIONS), "no option changes");
    bench.run(&mut flash, 5_000_000_000);
    assert_eq!([SR, SR2].map(|at| bench.read(&mut flash, at)), [EOP, 0b101]);
    bench.run(&mut flash, 8_000_000_000);
    assert_eq!([SR, SR2].map(|at| bench.read(&mut flash, at)), [EOP, EOP]);
    assert_eq!(sectors(&mut flash, &mut bench), [erased(), erased()].concat());
    bench.assert_no_misuse();

    let (mut flash, mut bench) = filled();
    bench.write(&mut flash, CR, X64 | LOCK);
    bench.write(&mut flash, OPTCR, MER);
    assert!(bench.take_misuse()[0].contains("OPTCR.MER while CR1 or CR2 is locked"));
    assert_eq!([SR, SR2].map(|at| bench.read(&mut flash, at)), [0, 0]);
}

/// Option bytes of readout protection level 1, with two of its values.
const LEVEL_1: u32 = OPTIONS & !0xFF00 | 0xBB00;
const ALSO_LEVEL_1: u32 = OPTIONS & !0xFF00;

#[test]
fn readout_protection_closes_the_flash_once_a_debugger_is_connected_until_power_on() {
    for options in [LEVEL_1, ALSO_LEVEL_1] {
        let (mut flash, mut bench) = filled();
        change_options(&mut flash, &mut bench, options);
        bench.run(&mut flash, OPTION_NS);
        flash.reset(&mut bench.context());
        let all = [full(1), full(2)].concat();
        assert_eq!(sectors(&mut flash, &mut bench), all, "nobody is there");
        bench.assert_no_misuse();
        flash.set_debugger(true);
        assert!(flash.is_closed());
        for address in [BANK_1, BANK_2_ADDRESS] {
            assert_eq!(load(&mut flash, &mut bench, address), Err(LoadError::Protected));
        }
        assert_eq!([SR, SR2].map(|at| bench.read(&mut flash, at)), [RDPERR, RDPERR]);
        assert!(bench.take_misuse()[0].contains("0x08000000 is read at readout protection level 1"));
        flash.set_debugger(false);
        flash.reset(&mut bench.context());
        assert_eq!(load(&mut flash, &mut bench, BANK_1), Err(LoadError::Protected), "a reset does not open it");
        flash.power_on();
        flash.reset(&mut bench.context());
        assert_eq!(sectors(&mut flash, &mut bench), all);
    }
}

#[test]
fn a_debugger_at_level_0_changes_nothing_until_the_level_does() {
    let (mut flash, mut bench) = filled();
    flash.set_debugger(true);
    assert_eq!(sectors(&mut flash, &mut bench), [full(1), full(2)].concat());
    change_options(&mut flash, &mut bench, LEVEL_1);
    bench.run(&mut flash, OPTION_NS - 1);
    assert!(!flash.is_closed());
    bench.run(&mut flash, OPTION_NS);
    assert!(flash.is_closed());
}

#[test]
fn a_closed_flash_is_neither_programmed_nor_erased() {
    let (mut flash, mut bench) = filled();
    flash.set_options(LEVEL_1).unwrap();
    flash.set_debugger(true);
    bench.write(&mut flash, CR2, X64 | PG | WRPERR);
    program(&mut flash, &mut bench, SECTOR + 32, 1);
    assert_eq!(bench.read(&mut flash, SR2), WRPERR);
    assert_eq!(bench.take_signals(), [Signal::Irq { number: IRQ, level: true }]);
    bench.write(&mut flash, CR, X64 | ERASE_SECTOR_4);
    assert_eq!(bench.read(&mut flash, SR), WRPERR);
    bench.write(&mut flash, OPTCR, MER);
    assert_eq!(flash.next_event_ns(), u64::MAX, "nothing is under way");
    flash.set_debugger(false);
    flash.power_on();
    // The flag does not block programming (4.7.2).
    bench.write(&mut flash, CR2, X64 | PG);
    program(&mut flash, &mut bench, SECTOR + 32, 1);
    bench.run(&mut flash, 100_000);
    assert_eq!(load(&mut flash, &mut bench, SECTOR + 32), Ok(1));
    assert_eq!(sectors(&mut flash, &mut bench), [full(1), full(2)].concat());
}

#[test]
fn back_to_level_0_everything_is_erased_and_a_reset_on_the_way_leaves_level_1() {
    const ALL_NS: u64 = 5_000_000_000 + OPTION_NS;
    let (mut flash, mut bench) = filled();
    flash.set_options(LEVEL_1).unwrap();
    flash.set_debugger(true);
    change_options(&mut flash, &mut bench, OPTIONS);
    bench.run(&mut flash, ALL_NS - 1);
    assert_eq!(bench.read(&mut flash, OPTSR_CUR), LEVEL_1 | OPT_BUSY);
    assert!(flash.is_closed() && !flash.take_backup_erase());
    bench.run(&mut flash, ALL_NS);
    assert_eq!(bench.read(&mut flash, OPTSR_CUR), OPTIONS);
    assert_eq!(sectors(&mut flash, &mut bench), [erased(), erased()].concat());
    assert_eq!((flash.take_backup_erase(), flash.take_backup_erase()), (true, false), "told once");
    bench.assert_no_misuse();

    let (mut flash, mut bench) = filled();
    flash.set_options(LEVEL_1).unwrap();
    change_options(&mut flash, &mut bench, OPTIONS);
    bench.run(&mut flash, ALL_NS - 1);
    flash.reset(&mut bench.context());
    assert_eq!(bench.read(&mut flash, OPTSR_CUR), LEVEL_1);
    for address in [BANK_1, BANK_2_ADDRESS] {
        assert_eq!(load(&mut flash, &mut bench, address), Err(LoadError::Ecc), "half erased");
    }
    assert!(!flash.take_backup_erase());
}

#[test]
fn from_level_1_to_level_1_nothing_is_erased() {
    let (mut flash, mut bench) = filled();
    flash.set_options(LEVEL_1).unwrap();
    change_options(&mut flash, &mut bench, ALSO_LEVEL_1);
    bench.run(&mut flash, OPTION_NS);
    assert_eq!(bench.read(&mut flash, OPTSR_CUR), ALSO_LEVEL_1);
    assert_eq!(sectors(&mut flash, &mut bench), [full(1), full(2)].concat());
}

#[test]
fn registers_are_not_written_while_options_change_and_no_difference_is_no_change() {
    let (mut flash, mut bench) = filled();
    bench.write(&mut flash, OPTCR, OPTSTART);
    assert_eq!(bench.read(&mut flash, OPTSR_CUR), OPTIONS, "at once");
    change_options(&mut flash, &mut bench, OPTIONS | SWAP);
    bench.write(&mut flash, OPTSR_PRG, OPTIONS);
    assert!(bench.take_misuse()[0].contains("while option bytes change"));
    bench.run(&mut flash, OPTION_NS);
    assert_eq!(bench.read(&mut flash, OPTSR_CUR), OPTIONS | SWAP);
}

#[test]
fn what_is_not_modelled_of_the_flash_ends_the_run_with_its_name() {
    let (mut flash, mut bench) = filled();
    let cases = [
        (OPTSR_PRG, OPTIONS ^ 1 << 22, "BOOT_CM4"),
        (OPTSR_PRG, OPTIONS ^ 1 << 23, "BOOT_CM7"),
        (OPTSR_PRG, OPTIONS ^ 1 << 21, "SECURITY"),
        (OPTSR_PRG, OPTIONS ^ (1 << 20 | 1 << 21), "SECURITY, ST_RAM_SIZE"),
        (OPTSR_PRG, OPTIONS ^ 1 << 16, "reserved bits"),
        (OPTSR_PRG, OPTIONS & !0xFF00 | 0xCC00, "RDP level 2"),
        (OPTCR, 1 << 30, "OPTCHANGEERRIE"),
        (CR2, X64 | CRC_EN, "CRC unit"),
        (0x2C, 0, "PCROP"),
        (BANK_2 + 0x34, 0, "secure-only"),
        (0x3C, 0, "write protection"),
        (0x44, 0, "boot addresses of the Cortex-M7"),
        (0x14C, 0, "boot addresses of the Cortex-M4"),
        (0x50, 0, "CRC unit"),
        (0x244, 0, "register at offset 0x244"),
    ];
    for (at, value, name) in cases {
        let refused = bench.try_write(&mut flash, at, Size::Word, value).unwrap_err();
        assert!(refused.what.contains(name), "{at:#x} {value:#x}: {}", refused.what);
    }
    assert!(flash.set_options(OPTIONS ^ 1 << 21).unwrap_err().what.contains("SECURITY"));
    assert_eq!(bench.read(&mut flash, OPTSR_CUR), OPTIONS);
}
