//! Programming, erasing and reading as a driver does it.

use super::{bank::*, *};
use crate::{Signal, testing::Bench};

/// Sector 4 of bank 2, as the R4 firmware keeps its configuration in, and the first registers of bank 2.
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

/// The eight words of a flash word, the first of which is `value`.
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
    // Word 2 of the fifth sector of the bank.
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
    let cases: [(&str, u32, &[u32], u32); 4] = [
        ("without PG", X64, &[0], PGSERR),
        ("another word before the first is full", X64 | PG, &[0, 32], INCERR),
        ("the same byte twice", X64 | PG, &[0, 0], STRBERR),
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

/// BOR_LEV 3 and the hardware watchdog.
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

#[test]
fn what_is_not_modelled_of_the_flash_ends_the_run() {
    let (mut flash, mut bench) = unlocked();
    for key in OPTION_KEYS {
        bench.write(&mut flash, OPTKEYR, key);
    }
    // Swap, read-out protection, the other core's boot; mass erase; CRC.
    for (at, value) in [
        (OPTSR_PRG, OPTIONS ^ 1 << 31),
        (OPTSR_PRG, OPTIONS ^ 1 << 8),
        (OPTSR_PRG, OPTIONS ^ 1 << 22),
        (OPTCR, 1 << 4),
        (CR2, X64 | CRC_EN),
    ] {
        assert!(bench.try_write(&mut flash, at, Size::Word, value).is_err(), "{at:#x} {value:#x}");
    }
}
