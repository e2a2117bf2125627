//! Loading of programs: their segments and symbols.

use object::read::elf::{ElfFile32, ProgramHeader};
use object::{Architecture, Object, ObjectSegment, ObjectSymbol, SymbolKind, SymbolSection};

use super::error::LoadError;
use crate::memory::Memory;

/// Function or variable of a program.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Symbol {
    address: u32,
    len: u32,
    name: String,
    function: bool,
}

/// Symbols of a program.
#[derive(Clone, Debug, Default)]
pub struct Symbols {
    /// Symbols in order of address.
    all: Vec<Symbol>,
}

/// Writes an ELF file's segments to memory and returns its symbols.
pub(super) fn load(elf: &[u8], memory: &Memory) -> Result<Symbols, LoadError> {
    let format = |error: object::Error| LoadError::Format(error.to_string());
    let file = ElfFile32::<object::Endianness>::parse(elf).map_err(format)?;
    if file.architecture() != Architecture::Arm || !file.is_little_endian() {
        return Err(LoadError::Processor);
    }
    for segment in file.segments() {
        let bytes = segment.data().map_err(format)?;
        // The physical address is where a segment is stored, not where it runs: initial values of variables lie in
        // flash.
        let address = segment.elf_program_header().p_paddr(file.endian());
        if !bytes.is_empty() && memory.write_slice(address, bytes).is_none() {
            return Err(LoadError::Segment { address, len: bytes.len() });
        }
    }
    let mut all: Vec<_> = file
        .symbols()
        .filter(|symbol| {
            let of_program = matches!(symbol.kind(), SymbolKind::Text | SymbolKind::Data | SymbolKind::Label);
            // Absolute symbols come from a linker script, as the ends of a stack.
            let of_script = symbol.section() == SymbolSection::Absolute && symbol.kind() == SymbolKind::Unknown;
            of_program && symbol.is_definition() || of_script
        })
        .filter_map(|symbol| {
            let function = symbol.kind() == SymbolKind::Text;
            let name = symbol.name().ok().filter(|name| !name.is_empty() && !name.starts_with('$'))?;
            // The low bit of a function's address marks Thumb code.
            let address = symbol.address() as u32 & if function { !1 } else { !0 };
            Some(Symbol {
                address,
                len: symbol.size() as u32,
                name: format!("{:#}", rustc_demangle::demangle(name)),
                function,
            })
        })
        .collect();
    all.sort_by(|a, b| (a.address, &a.name).cmp(&(b.address, &b.name)));
    Ok(Symbols { all })
}

impl Symbols {
    /// Returns the address of the symbol with this demangled name, without a hash: a full path such as
    /// `app::control::tick`.
    #[must_use]
    pub fn address(&self, name: &str) -> Option<u32> {
        self.all.iter().find(|symbol| symbol.name == name).map(|symbol| symbol.address)
    }

    /// Iterates over names and addresses of all functions and variables, by address.
    pub fn iter(&self) -> impl Iterator<Item = (&str, u32)> {
        self.all.iter().map(|symbol| (symbol.name.as_str(), symbol.address))
    }

    /// Returns the function that contains an address, and the offset in it.
    #[must_use]
    pub fn function(&self, address: u32) -> Option<(&str, u32)> {
        let after = self.all.partition_point(|symbol| symbol.address <= address);
        let holds = |symbol: &&Symbol| symbol.function && address - symbol.address < symbol.len.max(2);
        let symbol = self.all[..after].iter().rev().take(64).find(holds)?;
        Some((&symbol.name, address - symbol.address))
    }

    /// Formats an address with the function that contains it.
    #[must_use]
    pub fn locate(&self, address: u32) -> String {
        match self.function(address) {
            Some((name, offset)) => format!("{address:#010x} ({name}+{offset:#x})"),
            None => format!("{address:#010x}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_function_is_found_by_any_address_in_it() {
        let symbol = |address, len, name: &str, function| Symbol { address, len, name: name.into(), function };
        let all =
            vec![symbol(0x100, 8, "first", true), symbol(0x104, 0, "label", false), symbol(0x110, 4, "second", true)];
        let symbols = Symbols { all };
        assert_eq!(symbols.function(0x107), Some(("first", 7)));
        assert_eq!(symbols.function(0x108), None);
        assert_eq!(symbols.locate(0x110), "0x00000110 (second+0x0)");
        assert_eq!(symbols.locate(0x10), "0x00000010");
        assert_eq!((symbols.address("second"), symbols.address("third")), (Some(0x110), None));
    }

    #[test]
    fn what_is_no_elf_is_refused() {
        assert!(matches!(load(b"no elf", &Memory::new()), Err(LoadError::Format(_))));
    }
}
