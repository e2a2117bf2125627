//! Reader of an ELF file of the firmware: its sizes in the processor's memories, and its symbols.

use rustc_demangle::demangle;

/// Sizes of an image by memory, bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Sizes {
    /// Bytes in flash only: code and constants.
    pub(crate) text: u32,
    /// Bytes in flash that are copied into RAM.
    pub(crate) data: u32,
    /// Bytes in RAM only, without the stack.
    pub(crate) bss: u32,
}

impl Sizes {
    /// Returns the bytes that are written to flash.
    pub(crate) fn flash(self) -> u32 {
        self.text + self.data
    }

    /// Returns the bytes that are reserved in RAM, without the stack.
    pub(crate) fn ram(self) -> u32 {
        self.data + self.bss
    }

    fn of(memory: Memory, bytes: u32) -> Self {
        match memory {
            Memory::Flash => Self { text: bytes, ..Self::default() },
            Memory::Both => Self { data: bytes, ..Self::default() },
            Memory::Ram => Self { bss: bytes, ..Self::default() },
        }
    }
}

/// Memory that a section or a symbol is in.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Memory {
    /// Flash, for code and constants.
    Flash,
    /// RAM, for variables that are zero or undefined at the start.
    Ram,
    /// Both, for variables whose initial values are in flash.
    Both,
}

impl Memory {
    /// Returns the name for people.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Flash => "flash",
            Self::Ram => "ram",
            Self::Both => "flash and ram",
        }
    }
}

/// Function or variable of an image.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Symbol {
    /// Name as in Rust's source.
    pub(crate) name: String,
    pub(crate) bytes: u32,
    pub(crate) memory: Memory,
}

/// Sizes and symbols of an ELF file.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Image {
    pub(crate) sizes: Sizes,
    /// Symbols, the largest first; of the same size, by name.
    pub(crate) symbols: Vec<Symbol>,
}

/// Type of the section with the symbols (System V ABI, chapter 4).
const SYMBOLS: u32 = 2;
const NOTES: u32 = 7;
const NOBITS: u32 = 8;
const WRITE: u32 = 1;
const ALLOCATED: u32 = 2;
/// Length of a section's header and of a symbol, bytes.
const HEADER: usize = 40;
const ENTRY: usize = 16;

/// Header of a section.
struct Section {
    kind: u32,
    flags: u32,
    offset: usize,
    size: u32,
    link: usize,
}

impl Section {
    /// Returns the memory that the section is loaded into; `None` for one that stays in the file.
    fn memory(&self) -> Option<Memory> {
        match (self.flags & ALLOCATED != 0, self.kind, self.flags & WRITE != 0) {
            (false, ..) | (_, NOTES, _) => None,
            (_, NOBITS, _) => Some(Memory::Ram),
            (_, _, true) => Some(Memory::Both),
            (_, _, false) => Some(Memory::Flash),
        }
    }
}

impl Image {
    /// Reads an ELF file; `None` when it is not a little-endian one of 32 bits, or is cut off.
    pub(crate) fn read(elf: &[u8]) -> Option<Self> {
        if elf.get(..6)? != b"\x7fELF\x01\x01" {
            return None;
        }
        let (table, count) = (word(elf, 0x20)? as usize, half(elf, 0x30)?);
        let sections = (0..count).map(|index| section(elf, table + index * HEADER)).collect::<Option<Vec<_>>>()?;
        let sizes = sections.iter().filter_map(|section| Some(Sizes::of(section.memory()?, section.size)));
        let sizes = sizes.fold(Sizes::default(), |sum, section| Sizes {
            text: sum.text + section.text,
            data: sum.data + section.data,
            bss: sum.bss + section.bss,
        });
        let mut symbols = Vec::new();
        for table in sections.iter().filter(|section| section.kind == SYMBOLS) {
            let names = sections.get(table.link)?.offset;
            for at in (table.offset..table.offset + table.size as usize).step_by(ENTRY) {
                let (name, bytes) = (word(elf, at)? as usize, word(elf, at + 8)?);
                // Absolute symbols have a number that no section has.
                let memory = sections.get(half(elf, at + 14)?).and_then(Section::memory);
                if let (1.., Some(memory)) = (bytes, memory) {
                    let name = elf.get(names + name..)?.split(|byte| *byte == 0).next()?;
                    let name = format!("{:#}", demangle(&String::from_utf8_lossy(name)));
                    symbols.push(Symbol { name, bytes, memory });
                }
            }
        }
        symbols.sort_by(|a, b| b.bytes.cmp(&a.bytes).then_with(|| a.name.cmp(&b.name)));
        Some(Self { sizes, symbols })
    }
}

/// Returns the length of the section of this name, bytes; `None` when there is none, or `elf` is no ELF file.
pub(crate) fn section_bytes(elf: &[u8], name: &str) -> Option<u32> {
    if elf.get(..6)? != b"\x7fELF\x01\x01" {
        return None;
    }
    let (table, count) = (word(elf, 0x20)? as usize, half(elf, 0x30)?);
    let names = section(elf, table + half(elf, 0x32)? * HEADER)?.offset;
    (0..count).find_map(|index| {
        let at = table + index * HEADER;
        let found = elf.get(names + word(elf, at)? as usize..)?.split(|byte| *byte == 0).next()?;
        if found == name.as_bytes() { Some(section(elf, at)?.size) } else { None }
    })
}

fn section(elf: &[u8], at: usize) -> Option<Section> {
    Some(Section {
        kind: word(elf, at + 4)?,
        flags: word(elf, at + 8)?,
        offset: word(elf, at + 16)? as usize,
        size: word(elf, at + 20)?,
        link: word(elf, at + 24)? as usize,
    })
}

fn word(elf: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_le_bytes(elf.get(at..at + 4)?.try_into().ok()?))
}

fn half(elf: &[u8], at: usize) -> Option<usize> {
    Some(u16::from_le_bytes(elf.get(at..at + 2)?.try_into().ok()?).into())
}

#[cfg(test)]
mod tests {
    use super::*;

    const NAMES: &[u8] = b"\0POOL\0_ZN4core9panicking5panic17h0123456789abcdefE\0VERSION\0";

    /// Makes an ELF file with code, data, bss, notes, debug information, symbols and their names, each `(kind, flags,
    /// size)`.
    fn file() -> Vec<u8> {
        // Name, size, section: the last one is absolute, the one before has no size.
        let symbols = [(0, 0, 0), (1, 3000, 2), (6, 60, 0), (6, 40, 0), (51, 20, 1), (51, 0, 1), (51, 9, 0xFFF1)];
        let names_at = 52 + symbols.len() * ENTRY;
        let sections = [
            (1, 6, 0, 100),
            (1, 3, 0, 20),
            (8, 3, 0, 3000),
            (7, 2, 0, 7),
            (1, 0, 0, 50_000),
            (SYMBOLS, 0, 52, symbols.len() * ENTRY),
            (3, 0, names_at, NAMES.len()),
        ];
        let mut elf = vec![0; 52];
        elf[..6].copy_from_slice(b"\x7fELF\x01\x01");
        for (name, size, section) in symbols {
            let mut entry = [0; ENTRY];
            entry[..4].copy_from_slice(&u32::to_le_bytes(name));
            entry[8..12].copy_from_slice(&u32::to_le_bytes(size));
            entry[14..].copy_from_slice(&u16::to_le_bytes(section));
            elf.extend(entry);
        }
        elf.extend(NAMES);
        elf[0x20] = elf.len() as u8;
        elf[0x21] = (elf.len() >> 8) as u8;
        elf[0x30] = sections.len() as u8;
        elf[0x32] = 6;
        let table = elf.len();
        for (kind, flags, offset, size) in sections {
            let mut header = [0; HEADER];
            for (at, value) in [(4, kind), (8, flags), (16, offset as u32), (20, size as u32), (24, 6)] {
                header[at..at + 4].copy_from_slice(&u32::to_le_bytes(value));
            }
            elf.extend(header);
        }
        // Only the first two sections have a name.
        elf[table] = 1;
        elf[table + HEADER] = 51;
        elf
    }

    #[test]
    fn sizes_are_those_of_the_allocated_sections() {
        let Sizes { text, data, bss } = Image::read(&file()).expect("good").sizes;
        assert_eq!((text, data, bss), (100, 20, 3000));
        let sizes = Sizes { text, data, bss };
        assert_eq!((sizes.flash(), sizes.ram()), (120, 3020));
    }

    #[test]
    fn sections_are_found_by_name() {
        let elf = file();
        let of = |name| section_bytes(&elf, name);
        assert_eq!((of("POOL"), of("VERSION"), of(".text")), (Some(100), Some(20), None));
        assert_eq!(section_bytes(&elf[..elf.len() - 20], ".text"), None, "cut off");
    }

    #[test]
    fn symbols_are_sorted_by_size_and_know_their_memory() {
        let symbols = Image::read(&file()).expect("good").symbols;
        let symbol = |name: &str, bytes, memory| Symbol { name: name.into(), bytes, memory };
        let expected = [
            symbol("POOL", 3000, Memory::Ram),
            symbol("core::panicking::panic", 60, Memory::Flash),
            symbol("core::panicking::panic", 40, Memory::Flash),
            symbol("VERSION", 20, Memory::Both),
        ];
        assert_eq!(symbols, expected);
    }

    #[test]
    fn other_files_are_refused() {
        let elf = file();
        assert_eq!(Image::read(&elf[..elf.len() - 20]), None, "cut off");
        assert_eq!(Image::read(b"\x7fELF\x02\x01"), None, "64 bits");
        assert_eq!(Image::read(b""), None, "empty");
    }
}
