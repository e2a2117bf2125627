//! Commands of gdb's `monitor`.

use std::{fs::File, io};

use gdbstub::{
    outputln,
    target::ext::monitor_cmd::{ConsoleOutput, MonitorCmd},
};
use r4_mcu::{ResetCause, Size, cpu::Core, cpu::Register};

use super::inferior::Inferior;
use crate::{
    tracing::{Tracer, Wanted},
    vectors,
};

const HELP: &str = "\
time                       virtual time, instructions, what the processor does
reset                      resets the chip, as its NRST pin does; virtual time goes on
misuse                     what was done against the manual, and on the board's I2C bus against its specification
trace on [FILE]            writes exceptions, misuses and I2C transfers to a file, or to r4's stderr
trace off
read ADDRESS [8|16|32]     reads on the bus as the program would, with every effect that has on a peripheral";

/// Exception number field of xPSR (IPSR).
const EXCEPTION: u32 = 0x1FF;

impl<C: Core> MonitorCmd for Inferior<C> {
    fn handle_monitor_cmd(&mut self, command: &[u8], mut out: ConsoleOutput<'_>) -> Result<(), String> {
        let command = String::from_utf8_lossy(command);
        let answer = match *command.split_whitespace().collect::<Vec<_>>() {
            ["time"] => self.time(),
            ["reset"] => self.reset(),
            ["misuse"] => self.misuse(),
            ["trace", "on"] => self.trace(None),
            ["trace", "on", file] => self.trace(Some(file)),
            ["trace", "off"] => {
                self.tracer = None;
                self.machine.borrow_mut().keep_changes(false);
                "no trace".into()
            }
            ["read", address] => self.bus_read(address, "32"),
            ["read", address, bits] => self.bus_read(address, bits),
            _ => HELP.into(),
        };
        outputln!(out, "{answer}");
        Ok(())
    }
}

impl<C: Core> Inferior<C> {
    fn time(&self) -> String {
        let machine = self.machine.borrow();
        let exception = (machine.core.get(Register::Xpsr) & EXCEPTION) as u16;
        let does = if machine.is_asleep() { "asleep" } else { "awake" };
        let mut text = format!(
            "{} ns, {} instructions, in {}, {does}, at {}",
            machine.now_ns(),
            machine.instructions(),
            vectors::name(exception),
            machine.location()
        );
        if let Some(failure) = &self.failure {
            text += &format!("\ncannot go on: {failure}");
        }
        text
    }

    fn reset(&mut self) -> String {
        let mut machine = self.machine.borrow_mut();
        if let Err(error) = machine.reset(ResetCause::Pin) {
            return error.to_string();
        }
        machine.chip.outside().processor_reset();
        self.failure = None;
        format!("reset at {} ns, at {}", machine.now_ns(), machine.location())
    }

    fn misuse(&self) -> String {
        let mut machine = self.machine.borrow_mut();
        let mut lines: Vec<String> = machine
            .chip
            .misuse()
            .iter()
            .map(|misuse| format!("{} ns {}: {}", misuse.at_ns, misuse.peripheral, misuse.what))
            .collect();
        let world = machine.chip.outside().world();
        lines.extend(world.bus.misuse().first().iter().map(|misuse| format!("board's I2C bus: {misuse}")));
        if lines.is_empty() { "no misuse".into() } else { lines.join("\n") }
    }

    fn trace(&mut self, file: Option<&str>) -> String {
        let out: Box<dyn io::Write> = match file.map(File::create) {
            None => Box::new(io::stderr()),
            Some(Ok(file)) => Box::new(io::BufWriter::new(file)),
            Some(Err(error)) => return format!("cannot write the file: {error}"),
        };
        self.tracer = Some(Tracer::new(&self.machine, out, Wanted::default()));
        "traces exceptions, misuses and I2C transfers from now on".into()
    }

    fn bus_read(&self, address: &str, bits: &str) -> String {
        let digits = address.strip_prefix("0x").unwrap_or(address);
        let size = match bits {
            "8" => Size::Byte,
            "16" => Size::Half,
            "32" => Size::Word,
            _ => return HELP.into(),
        };
        let Ok(address) = u32::from_str_radix(digits, 16) else { return HELP.into() };
        match self.machine.borrow_mut().bus_read(address, size) {
            Ok(value) => format!("{address:#010x}: {value:#x}"),
            Err(error) => format!("{address:#010x}: {error}"),
        }
    }
}
