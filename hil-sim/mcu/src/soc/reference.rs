//! Comparison of every register of the chip with ST's description of it: `tests/oracle/registers.txt`, which
//! `registers.py` beside it makes from a crate that is generated from ST's SVD file.
//!
//! Addresses, values after a reset, and the bits that keep what is written are compared, on the bus as a program sees
//! them. A bit that the model refuses to write ends the run, so it is no difference; nor is a register that it refuses.
//! Every difference that remains is in `tests/oracle/differences.txt` with its reason, and an entry there without a
//! difference fails.

use std::collections::BTreeMap;

use super::{
    Soc,
    map::{self, AddressMap},
};
use crate::{
    Chip, Memory, Size,
    peripherals::{flash::PlainCells, rcc::Oscillators},
    testing::Recorder,
};

/// Reads a file of `tests/oracle`, without its comments.
fn lines(name: &str) -> Vec<String> {
    let path = format!("{}/tests/oracle/{name}", env!("CARGO_MANIFEST_DIR"));
    let text = std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{path}: {error}"));
    text.lines().filter(|line| !line.is_empty() && !line.starts_with('#')).map(str::to_owned).collect()
}

/// Register of the source; several at one address (views of TIMx_CCMR1) are one.
struct Register {
    peripheral: String,
    address: u32,
    name: String,
    reset: u32,
    readable: bool,
    /// Bits that keep what is written, as far as the source has them.
    kept: u32,
}

fn hexadecimal(text: &str) -> u32 {
    u32::from_str_radix(text.trim_start_matches("0x"), 16).expect("a number of registers.txt")
}

/// Registers of the source in order of address.
fn registers() -> Vec<Register> {
    let mut registers: BTreeMap<u32, Register> = BTreeMap::new();
    let mut layout: Vec<(String, u32)> = Vec::new();
    for line in lines("registers.txt") {
        if !line.starts_with(' ') {
            let places = line.split(' ').map(|place| place.split_once('=').expect("NAME=address"));
            layout = places.map(|(name, base)| (name.to_owned(), hexadecimal(base))).collect();
            continue;
        }
        let words: Vec<&str> = line.split_whitespace().collect();
        let [offset, name, reset, readable, writable, by_one, by_zero] = words[..] else {
            panic!("seven columns: {line}")
        };
        let mask = |text: &str| if text == "-" { 0 } else { hexadecimal(text) };
        let kept = mask(readable) & mask(writable) & !mask(by_one) & !mask(by_zero);
        for (peripheral, base) in &layout {
            let address = base + hexadecimal(offset);
            let register = registers.entry(address).or_insert(Register {
                peripheral: peripheral.clone(),
                address,
                name: String::new(),
                reset: hexadecimal(reset),
                readable: false,
                kept: 0,
            });
            register.name += if register.name.is_empty() { "" } else { "/" };
            register.name += name;
            register.readable |= readable != "-";
            register.kept |= kept;
        }
    }
    registers.into_values().collect()
}

type Bare = Soc<Recorder, PlainCells>;

/// Makes a chip at power-on, on memory that is shared because no test here looks at it.
fn chip(memory: &Memory) -> Bare {
    Soc::with_memory(Recorder::default(), Oscillators::default(), PlainCells::new(), memory.clone())
}

/// Writes before a peripheral's registers can be written, by RM0399: keys, write protections, settings that enable a
/// change of others. Peripherals, then addresses and values in order.
const UNLOCKED_BY: &[(&str, &[(u32, u32)])] = &[
    // PWR_CR1.DBP opens the backup domain (7.4.4).
    ("PWR|RCC|RTC", &[(0x5802_4800, 1 << 8)]),
    // Keys of both banks and of the option bytes (4.5.1).
    (
        "FLASH",
        &[
            (0x5200_2004, 0x4567_0123),
            (0x5200_2004, 0xCDEF_89AB),
            (0x5200_2104, 0x4567_0123),
            (0x5200_2104, 0xCDEF_89AB),
            (0x5200_2008, 0x0819_2A3B),
            (0x5200_2008, 0x4C5D_6E7F),
        ],
    ),
    // The key of write access (49.4.1).
    ("IWDG1", &[(0x5800_4800, 0x5555)]),
    // CCCR.INIT, then CCE (59.5.6).
    ("FDCAN1", &[(0x4000_A018, 1), (0x4000_A018, 3)]),
    ("FDCAN2", &[(0x4000_A418, 1), (0x4000_A418, 3)]),
];

/// Kind of difference, each in some bits of a register.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Kind {
    /// After a reset the model's value is another one.
    Reset,
    /// The model keeps what is written, and the source has no such field.
    Kept,
    /// The source has a field, and the model does not keep what is written.
    Lost,
}

/// Permitted difference: a line of `differences.txt`.
struct Permitted {
    line: String,
    peripherals: String,
    names: String,
    kind: Kind,
    bits: u32,
    used: u32,
}

fn permitted() -> Vec<Permitted> {
    let parse = |line: String| {
        let mut words = line.split_whitespace();
        let mut next = || words.next().unwrap_or_else(|| panic!("peripherals, registers, kind, bits, reason: {line}"));
        let (peripherals, names) = (next().to_owned(), next().to_owned());
        let kind = match next() {
            "reset" => Kind::Reset,
            "kept" => Kind::Kept,
            "lost" => Kind::Lost,
            other => panic!("no kind of difference: {other}"),
        };
        let bits = hexadecimal(next());
        next(); // A reason there must be.
        Permitted { peripherals, names, kind, bits, used: 0, line }
    };
    lines("differences.txt").into_iter().filter(|line| !line.starts_with("0x")).map(parse).collect()
}

/// Ranges of addresses that the model answers and the source does not describe: first, last, line.
fn undescribed() -> Vec<(u32, u32, String)> {
    let ranges = lines("differences.txt").into_iter().filter(|line| line.starts_with("0x"));
    let parse = |line: String| {
        let (range, _) = line.split_once(' ').unwrap_or_else(|| panic!("a reason: {line}"));
        let (first, last) = range.split_once("..=").unwrap_or((range, range));
        (hexadecimal(first), hexadecimal(last), line)
    };
    ranges.map(parse).collect()
}

fn matches_one(pattern: &str, name: &str) -> bool {
    match pattern.split_once('*') {
        None => pattern == name,
        Some((head, tail)) => name.len() >= head.len() + tail.len() && name.starts_with(head) && name.ends_with(tail),
    }
}

fn matches(patterns: &str, name: &str) -> bool {
    patterns.split('|').any(|pattern| matches_one(pattern, name))
}

/// Bits that differ, by kind; `None` for a register that the model refuses.
fn differences(register: &Register, memory: &Memory) -> Option<[(Kind, u32); 3]> {
    let at = register.address;
    let reset = chip(memory).read(0, at, Size::Word).ok()?;
    let (mut kept, mut refused) = (0, 0);
    for bit in (0..32).map(|place| 1 << place) {
        let mut chip = chip(memory);
        let unlocked = UNLOCKED_BY.iter().filter(|(peripherals, _)| matches(peripherals, &register.peripheral));
        for (address, value) in unlocked.flat_map(|(_, writes)| writes.iter()) {
            chip.write(0, *address, Size::Word, *value).expect("registers that the model has");
        }
        let before = chip.read(0, at, Size::Word).ok()?;
        let written = chip.write(0, at, Size::Word, before ^ bit).and_then(|()| chip.read(0, at, Size::Word));
        match written {
            Ok(after) => kept |= (before ^ after) & bit,
            Err(_) => refused |= bit,
        }
    }
    Some([
        (Kind::Reset, reset ^ register.reset),
        (Kind::Kept, kept & !register.kept),
        (Kind::Lost, register.kept & !kept & !refused),
    ])
}

#[test]
fn registers_are_as_st_describes_them() {
    let memory = Memory::new();
    let mut compared: BTreeMap<String, u32> = BTreeMap::new();
    let mut permitted = permitted();
    let mut unexplained = String::new();
    for register in registers().iter().filter(|register| register.readable) {
        let count = compared.entry(register.peripheral.clone()).or_default();
        let Some(differences) = differences(register, &memory) else { continue };
        *count += 1;
        for (kind, mut bits) in differences {
            for entry in &mut permitted {
                if entry.kind == kind
                    && matches(&entry.peripherals, &register.peripheral)
                    && matches(&entry.names, &register.name)
                {
                    entry.used |= bits & entry.bits;
                    bits &= !entry.bits;
                }
            }
            if bits != 0 {
                unexplained += &format!("{} {} {kind:?} {bits:#010x}\n", register.peripheral, register.name);
            }
        }
    }
    let all: u32 = compared.values().sum();
    eprintln!("{all} registers of {} peripherals compared, {} differences permitted", compared.len(), permitted.len());
    assert!(unexplained.is_empty(), "differences without a reason:\n{unexplained}");
    let stale = permitted.iter().filter(|entry| entry.used != entry.bits);
    let stale: Vec<_> = stale.map(|entry| format!("{:08x} of {}", entry.bits & !entry.used, entry.line)).collect();
    assert!(stale.is_empty(), "no difference any more in the bits\n{}", stale.join("\n"));
    // The source's names for what the model refuses as a whole.
    let refused: Vec<_> = compared.iter().filter(|(_, count)| **count == 0).map(|(name, _)| name.as_str()).collect();
    assert_eq!(refused, ["CAN_CCU", "OTG2_HS_HOST"], "peripherals without a register in the model");
}

#[test]
fn no_register_is_where_st_describes_none() {
    let memory = Memory::new();
    let described: Vec<u32> = registers().iter().map(|register| register.address).collect();
    let undescribed = undescribed();
    let mut used = vec![false; undescribed.len()];
    let mut found = String::new();
    let mut chip = chip(&memory);
    for address in map::words().filter(|address| described.binary_search(address).is_err()) {
        if chip.read(0, address, Size::Word).is_err() {
            continue;
        }
        match undescribed.iter().position(|(first, last, _)| (*first..=*last).contains(&address)) {
            Some(index) => used[index] = true,
            None => found += &format!("{address:#010x}\n"),
        }
    }
    assert!(found.is_empty(), "registers of the model that the source does not describe:\n{found}");
    for ((_, _, line), used) in undescribed.iter().zip(used) {
        assert!(used, "the model has nothing there: {line}");
    }
    let addresses = AddressMap::new();
    let missing: Vec<_> = described.iter().filter(|address| addresses.find(**address).is_none()).collect();
    assert!(missing.is_empty(), "registers of the source outside the map: {missing:#010x?}");
}
