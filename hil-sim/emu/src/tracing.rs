//! Symbolic trace: exceptions, calls, misuse and transfers of the board's own I2C bus, one event per line in order of
//! time.

use std::io::Write;

use r4_mcu::{
    MachineError, Stopped, Symbols,
    cpu::{Core, Register},
    machine::Change,
};
use r4_sim::{i2c::WireRecord, world::World};

use crate::{
    vectors,
    watch::{SharedMachine, Watcher, observed_at},
};

/// Number of transfers kept between two polls, which are at most 10 ms apart: at 400 kHz an address alone takes 25 µs.
const TRANSFERS_KEPT: usize = 1000;

/// Error of a function name for the trace.
#[derive(Debug, thiserror::Error)]
pub enum SymbolError {
    /// No function has this name.
    #[error("the image has no function `{0}`")]
    None(String),
    /// Several functions have this name.
    #[error("`{name}` can be {}", .candidates.join(", "))]
    Several {
        /// Name in the request.
        name: String,
        /// Full paths of the candidates.
        candidates: Vec<String>,
    },
}

/// Finds a function by its full path, or by the end of a path at a `::` if only one function ends so.
///
/// # Errors
/// [`SymbolError`] for no function, or several.
pub fn resolve(symbols: &Symbols, name: &str) -> Result<(String, u32), SymbolError> {
    if let Some(address) = symbols.address(name).filter(|address| symbols.function(*address).is_some()) {
        return Ok((name.to_owned(), address));
    }
    let end = format!("::{name}");
    let mut found: Vec<_> = symbols
        .iter()
        .filter(|(symbol, address)| symbol.ends_with(&end) && symbols.function(*address).is_some())
        .map(|(symbol, address)| (symbol.to_owned(), address))
        .collect();
    found.dedup_by_key(|(_, address)| *address);
    match found.len() {
        0 => Err(SymbolError::None(name.to_owned())),
        1 => Ok(found.remove(0)),
        _ => {
            let candidates = found.into_iter().take(10).map(|(symbol, _)| symbol).collect();
            Err(SymbolError::Several { name: name.to_owned(), candidates })
        }
    }
}

/// Selection of events for a trace.
#[derive(Clone, Debug, Default)]
pub struct Wanted {
    /// Names and addresses of functions whose calls are traced.
    pub calls: Vec<(String, u32)>,
    /// Trace only these calls.
    pub only_calls: bool,
}

/// Writer of a trace.
pub struct Tracer<W: Write> {
    out: W,
    wanted: Wanted,
    /// Number of the chip's misuse records already written.
    misuses: usize,
    /// Transfers that ended up to this time are written, ns.
    transfers_ns: Option<u64>,
    lines: Vec<(u64, String)>,
    error: Option<std::io::Error>,
}

impl<W: Write> Tracer<W> {
    /// Starts a trace with the events from now on.
    pub fn new<C: Core>(machine: &SharedMachine<C>, out: W, wanted: Wanted) -> Self {
        let mut machine = machine.borrow_mut();
        let misuses = machine.chip.misuse().len();
        let mut transfers_ns = None;
        if !wanted.only_calls {
            machine.keep_changes(true);
            let mut world = machine.chip.outside().world();
            world.bus.set_trace(TRANSFERS_KEPT);
            transfers_ns = Some(world.clock().now_ns());
        }
        Self { out, wanted, misuses, transfers_ns, lines: Vec::new(), error: None }
    }

    /// Takes the first error of writing, after which lines are missing.
    pub fn error(&mut self) -> Option<std::io::Error> {
        self.error.take()
    }

    /// Writes the events since the last call.
    pub fn collect<C: Core>(&mut self, machine: &SharedMachine<C>, called: Option<u32>) {
        let mut machine = machine.borrow_mut();
        if let Some((name, _)) = called.and_then(|at| self.wanted.calls.iter().find(|(_, known)| *known == at)) {
            let register = |index| machine.core.get(Register::R(index));
            let from = machine.symbols().locate(machine.core.get(Register::Lr) & !1);
            let [r0, r1, r2, r3] = [0, 1, 2, 3].map(register);
            let line = format!("call    {name} r0={r0:#x} r1={r1:#x} r2={r2:#x} r3={r3:#x} from {from}");
            self.lines.push((machine.now_ns(), line));
        }
        if !self.wanted.only_calls {
            for change in machine.take_changes() {
                self.lines.push((change.at_ns, exception(&change, machine.symbols())));
            }
            for misuse in machine.chip.misuse().iter().skip(self.misuses) {
                self.lines.push((misuse.at_ns, format!("misuse  {}: {}", misuse.peripheral, misuse.what)));
            }
            self.misuses = machine.chip.misuse().len();
            self.transfers(&machine.chip.outside().world());
        }
        // Sorting is needed because the three sources are collected one after another.
        self.lines.sort_by_key(|(at_ns, _)| *at_ns);
        for (at_ns, line) in self.lines.drain(..) {
            if let Err(error) = writeln!(self.out, "{at_ns:>13} ns  {line}") {
                self.error.get_or_insert(error);
            }
        }
    }

    fn transfers(&mut self, world: &World) {
        let last_ns = self.transfers_ns;
        for record in world.bus.trace().filter(|record| last_ns.is_none_or(|last_ns| record.end_ns > last_ns)) {
            self.lines.push((record.end_ns, transfer(record)));
            self.transfers_ns = Some(record.end_ns);
        }
    }
}

fn exception(change: &Change, symbols: &Symbols) -> String {
    let Change { from, to, before, after, .. } = *change;
    let name = vectors::name;
    if !change.is_return() {
        return format!("enter   {} at {} to {}", name(after), symbols.locate(from), symbols.locate(to));
    }
    let to = symbols.locate(to);
    match after {
        0 => format!("return  {} to {to}", name(before)),
        _ => format!("return  {} to {to}, {}", name(before), name(after)),
    }
}

fn transfer(record: &WireRecord) -> String {
    let bytes = |bytes: &[u8]| bytes.iter().map(|byte| format!("{byte:02x}")).collect::<Vec<_>>().join(" ");
    let mut line = format!("i2c     {:#04x}", record.address);
    if !record.written.is_empty() {
        line += &format!(" write {}", bytes(&record.written));
    }
    if !record.read.is_empty() {
        line += &format!(" read {}", bytes(&record.read));
    }
    line += &format!(" ({} ns)", record.end_ns - record.start_ns);
    if let Some(fault) = record.fault {
        line += &format!(" {fault}");
    }
    line
}

impl<C: Core, W: Write> Watcher<C> for Tracer<W> {
    fn observed(&self, addresses: &mut Vec<u32>) {
        addresses.extend(self.wanted.calls.iter().map(|(_, address)| *address));
    }

    fn after(&mut self, machine: &SharedMachine<C>, stopped: Stopped) {
        self.collect(machine, observed_at(stopped));
    }

    fn failed(&mut self, machine: &SharedMachine<C>, error: &MachineError) {
        self.collect(machine, None);
        let now_ns = machine.borrow().now_ns();
        let written = writeln!(self.out, "{now_ns:>13} ns  failure {error}").and_then(|()| self.out.flush());
        if let Err(error) = written {
            self.error.get_or_insert(error);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exceptions_are_told_with_their_names() {
        let symbols = Symbols::default();
        let line = |from, to, before, after| exception(&Change { at_ns: 0, from, to, before, after }, &symbols);
        assert_eq!(line(0x100, 0x200, 0, 66), "enter   66 TIM5 at 0x00000100 to 0x00000200");
        assert_eq!(line(0xFFFF_FFF8, 0x100, 66, 0), "return  66 TIM5 to 0x00000100");
        assert_eq!(line(0xFFFF_FFF0, 0x300, 66, 15), "return  66 TIM5 to 0x00000300, 15 SysTick");
    }

    #[test]
    fn a_transfer_is_told_with_its_bytes_and_its_end() {
        let record = WireRecord {
            start_ns: 1_000,
            end_ns: 76_000,
            address: 0x20,
            written: vec![0x12, 0xA0],
            read: Vec::new(),
            fault: None,
        };
        assert_eq!(transfer(&record), "i2c     0x20 write 12 a0 (75000 ns)");
    }
}
