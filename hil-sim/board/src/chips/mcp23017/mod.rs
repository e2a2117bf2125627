//! Microchip MCP23017: sixteen pins on I2C. Section numbers are those of its datasheet, DS20001952, rev. D.
//!
//! # Time
//! Nothing in the chip takes time: a write acts at the ACK of its byte, and an interrupt with the edge that causes it.
//! Delays of pins and INT, up to 600 ns (table 1-5), are not modelled. RESET acts for any pulse length (the datasheet
//! requires 1 us, table 1-2).
//!
//! # Pins 7
//! Revision D (2022) makes GPA7 and GPB7 outputs only (3.5.1, note), because an edge on them while their bit of GPIO is
//! sent can corrupt SDA. Only the document changed: the silicon is the same, and every pin is an input after power-on.
//! The model reads such a pin correctly, and reports it.
//!
//! # Where the datasheet leaves room
//! - An address without a register is acknowledged; it reads as 0 and ignores writes. The pointer passes such addresses
//!   one by one, so between the two blocks of BANK = 1 it takes six bytes from OLATA to IODIRB.
//! - SEQOP acts on the pointer from the byte that sets it, as BANK does (3.5.6).
//! - An input that is neither driven nor pulled reads as low.
//! - The board never overpowers an output: GPIO reads the level driven by the chip.
//! - INTCAP captures the value of GPIO, including IPOL; interrupts compare the levels of the pins, without IPOL.
//! - An interrupt stays until GPIO or INTCAP of its port is read, even if it is disabled meanwhile. Pins are then
//!   compared again, where INTCON is 0 with their levels at the interrupt: a change since then causes a new interrupt
//!   at once, with a new INTCAP (note below figure 3-9).

mod registers;
#[cfg(test)]
mod tests;

use crate::i2c::I2cChip;
use crate::misuse::{Misuse, MisuseKind, MisuseLog};
use registers::{Register, iocon};

/// One of the two ports, eight pins each.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Port {
    /// Port A: GPA0 to GPA7, and INTA.
    A,
    /// Port B: GPB0 to GPB7, and INTB.
    B,
}

impl Port {
    /// Both ports, in order.
    pub const ALL: [Self; 2] = [Self::A, Self::B];

    const fn letter(self) -> char {
        match self {
            Self::A => 'A',
            Self::B => 'B',
        }
    }
}

/// State of a pin as set by the chip.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum PinState {
    /// Output, high or low.
    Driven(bool),
    /// Input with 100 kOhm to the supply.
    PulledUp,
    /// Input, or open-drain output that is off: the external circuit sets the level.
    Floating,
}

/// Registers and inputs of one port. IOCON is common to both.
#[derive(Clone, Copy, Debug)]
struct Bank {
    iodir: u8,
    ipol: u8,
    gpinten: u8,
    defval: u8,
    intcon: u8,
    gppu: u8,
    intf: u8,
    intcap: u8,
    olat: u8,
    /// Levels that pins are compared with where INTCON is 0.
    previous: u8,
    /// Pins that the board drives or pulls, and their levels.
    external: u8,
    external_high: u8,
}

impl Bank {
    const RESET: Self = Self {
        iodir: registers::IODIR_RESET,
        ipol: 0,
        gpinten: 0,
        defval: 0,
        intcon: 0,
        gppu: 0,
        intf: 0,
        intcap: 0,
        olat: 0,
        previous: 0,
        external: 0,
        external_high: 0,
    };

    /// Levels of the pins, one bit each.
    const fn levels(&self) -> u8 {
        let pulled = self.external & self.external_high | !self.external & self.gppu;
        self.iodir & pulled | !self.iodir & self.olat
    }

    /// Value of the GPIO register.
    const fn gpio(&self) -> u8 {
        self.levels() ^ self.ipol
    }

    const fn pin(&self, bit: u8) -> PinState {
        let mask = 1 << (bit % 8);
        if self.iodir & mask == 0 {
            PinState::Driven(self.olat & mask != 0)
        } else if self.gppu & mask != 0 {
            PinState::PulledUp
        } else {
            PinState::Floating
        }
    }

    /// Updates the interrupt on change (3.6): only the first cause is latched.
    const fn watch(&mut self) {
        let levels = self.levels();
        let enabled = self.gpinten & self.iodir;
        if self.intf != 0 {
            self.previous = self.previous & enabled | levels & !enabled;
            return;
        }
        let changed = self.intcon & (levels ^ self.defval) | !self.intcon & (levels ^ self.previous);
        self.previous = levels;
        self.intf = changed & enabled;
        if self.intf != 0 {
            self.intcap = self.gpio();
        }
    }

    /// Masks of the pins that are outputs, outputs at high level, and pulled-up inputs.
    const fn outside(&self) -> [u8; 3] {
        [!self.iodir, self.olat & !self.iodir, self.gppu & self.iodir]
    }
}

/// Phase of an I2C transfer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Transfer {
    /// Not addressed by the bus.
    None,
    /// Addressed for writing; the next byte is the address pointer.
    Pointer,
    /// The next byte goes to, or comes from, the register pointed at.
    Data,
}

/// Simulated chip with both ports.
#[derive(Clone, Debug)]
pub struct Mcp23017 {
    address: u8,
    iocon: u8,
    ports: [Bank; 2],
    in_reset: bool,

    pointer: u8,
    transfer: Transfer,
    now_ns: u64,

    /// Pin states at the last change of `generation`: [`Bank::outside`], and the INT pins.
    seen: ([[u8; 3]; 2], [PinState; 2]),
    generation: u64,
    misuse: MisuseLog,
}

impl Mcp23017 {
    /// Name of the chip in reports.
    pub const NAME: &str = "MCP23017";

    /// A chip just powered up, with RESET high, nothing connected, and its address pins giving the 7-bit `address`
    /// (0x20 to 0x27; only the three lower bits count).
    #[must_use]
    pub fn new(address: u8) -> Self {
        Self {
            address: registers::ADDRESS | address & registers::ADDRESS_PINS,
            iocon: 0,
            ports: [Bank::RESET; 2],
            in_reset: false,
            pointer: 0,
            transfer: Transfer::None,
            now_ns: 0,
            seen: ([Bank::RESET.outside(); 2], [PinState::Driven(true); 2]),
            generation: 0,
            misuse: MisuseLog::new(),
        }
    }

    /// The chip's own 7-bit address.
    #[must_use]
    pub const fn address(&self) -> u8 {
        self.address
    }

    /// Sets the level to which the board drives or pulls a pin; `None` leaves it open. Pins are 0 to 7; others are
    /// ignored.
    pub fn set_external(&mut self, port: Port, bit: u8, level: Option<bool>) {
        let Some(mask) = 1_u8.checked_shl(u32::from(bit)) else { return };
        let bank = &mut self.ports[port as usize];
        bank.external = with(bank.external, mask, level.is_some());
        bank.external_high = with(bank.external_high, mask, level == Some(true));
        self.settle();
    }

    /// State of a pin as set by the chip; [`PinState::Floating`] for a pin above 7.
    #[must_use]
    pub const fn pin_level(&self, port: Port, bit: u8) -> PinState {
        if bit < 8 { self.ports[port as usize].pin(bit) } else { PinState::Floating }
    }

    /// True while the INT pin of a port is active (3.6.1).
    #[must_use]
    pub const fn interrupt(&self, port: Port) -> bool {
        let [a, b] = [self.ports[0].intf != 0, self.ports[1].intf != 0];
        if self.iocon & iocon::MIRROR != 0 {
            a || b
        } else {
            match port {
                Port::A => a,
                Port::B => b,
            }
        }
    }

    /// State of the INT pin of a port as set by the chip (3.5.6: ODR, INTPOL).
    #[must_use]
    pub const fn interrupt_pin(&self, port: Port) -> PinState {
        let active = self.interrupt(port);
        if self.iocon & iocon::ODR != 0 {
            if active { PinState::Driven(false) } else { PinState::Floating }
        } else {
            PinState::Driven(active == (self.iocon & iocon::INTPOL != 0))
        }
    }

    /// Counter that changes whenever a pin or an INT pin changes its state, so that a caller can cache values derived
    /// from them.
    #[must_use]
    pub const fn generation(&self) -> u64 {
        self.generation
    }

    /// Drives the RESET pin: `asserted` is low. While it is low, registers have their power-on values and the chip does
    /// not answer.
    pub fn set_reset(&mut self, at_ns: u64, asserted: bool) {
        self.now_ns = self.now_ns.max(at_ns);
        self.in_reset = asserted;
        self.reset();
    }

    /// Interrupts the supply: registers as after power-on (3.1), all pins inputs. External levels stay.
    pub fn power_cycle(&mut self, at_ns: u64) {
        self.now_ns = self.now_ns.max(at_ns);
        self.reset();
    }

    /// Value that a read of `register` would return, in the map selected by IOCON.BANK, without side effects; `None`
    /// for an address without a register.
    #[must_use]
    pub fn register(&self, register: u8) -> Option<u8> {
        let (register, port) = registers::decode(register, self.bank())?;
        Some(self.peek(register, port))
    }

    /// Violations of the datasheet so far.
    #[must_use]
    pub const fn misuse(&self) -> &MisuseLog {
        &self.misuse
    }

    /// Violations so far, mutable, so that a test can clear them.
    pub const fn misuse_mut(&mut self) -> &mut MisuseLog {
        &mut self.misuse
    }

    #[cold]
    fn report(&mut self, kind: MisuseKind) {
        self.misuse.report(Misuse { time_ns: self.now_ns, chip: Self::NAME, address: self.address, kind });
    }

    const fn bank(&self) -> bool {
        self.iocon & iocon::BANK != 0
    }

    /// Updates interrupts and `generation` after any change of a level.
    fn settle(&mut self) {
        for bank in &mut self.ports {
            bank.watch();
        }
        let outside = (self.ports.map(|bank| bank.outside()), Port::ALL.map(|port| self.interrupt_pin(port)));
        self.generation += u64::from(outside != self.seen);
        self.seen = outside;
    }

    fn reset(&mut self) {
        self.iocon = 0;
        for bank in &mut self.ports {
            let Bank { external, external_high, .. } = *bank;
            *bank = Bank { external, external_high, ..Bank::RESET };
        }
        self.pointer = 0;
        self.transfer = Transfer::None;
        self.settle();
    }

    fn peek(&self, register: Register, port: Port) -> u8 {
        let bank = &self.ports[port as usize];
        match register {
            Register::Iodir => bank.iodir,
            Register::Ipol => bank.ipol,
            Register::Gpinten => bank.gpinten,
            Register::Defval => bank.defval,
            Register::Intcon => bank.intcon,
            Register::Iocon => self.iocon,
            Register::Gppu => bank.gppu,
            Register::Intf => bank.intf,
            Register::Intcap => bank.intcap,
            Register::Gpio => bank.gpio(),
            Register::Olat => bank.olat,
        }
    }

    fn read_register(&mut self) -> u8 {
        let Some((register, port)) = registers::decode(self.pointer, self.bank()) else {
            self.report(MisuseKind::UnimplementedRegister { register: self.pointer });
            return 0;
        };
        let value = self.peek(register, port);
        if register == Register::Gpio && self.ports[port as usize].iodir & 0x80 != 0 {
            self.report(MisuseKind::Pin7ReadAsInput { port: port.letter() });
        }
        if matches!(register, Register::Gpio | Register::Intcap) {
            // reading GPIO or INTCAP clears the interrupt (3.6.4)
            self.ports[port as usize].intf = 0;
            self.settle();
        }
        value
    }

    fn write_register(&mut self, value: u8) {
        let Some((register, port)) = registers::decode(self.pointer, self.bank()) else {
            self.report(MisuseKind::UnimplementedRegister { register: self.pointer });
            return;
        };
        let bank = &mut self.ports[port as usize];
        match register {
            Register::Iodir => bank.iodir = value,
            Register::Ipol => bank.ipol = value,
            Register::Gpinten => bank.gpinten = value,
            Register::Defval => bank.defval = value,
            Register::Intcon => bank.intcon = value,
            Register::Iocon => self.iocon = value & iocon::WRITABLE,
            Register::Gppu => bank.gppu = value,
            Register::Intf | Register::Intcap => {
                self.report(MisuseKind::ReadOnlyRegister { register: self.pointer });
            }
            Register::Gpio | Register::Olat => bank.olat = value,
        }
        self.settle();
    }

    /// Moves the pointer after a data byte (3.2.1).
    fn move_pointer(&mut self) {
        self.pointer = match (self.iocon & iocon::SEQOP != 0, self.bank()) {
            (false, bank) => registers::after(self.pointer, bank),
            // byte mode with paired registers: toggles within the pair
            (true, false) => self.pointer ^ 1,
            (true, true) => self.pointer,
        };
    }
}

impl I2cChip for Mcp23017 {
    /// True for its own address; the chip does not answer the general call.
    fn acknowledges(&self, address: u8, _read: bool) -> bool {
        address == self.address && !self.in_reset
    }

    fn start(&mut self, at_ns: u64, _address: u8, read: bool) {
        self.now_ns = self.now_ns.max(at_ns);
        self.transfer = if read { Transfer::Data } else { Transfer::Pointer };
    }

    fn write(&mut self, at_ns: u64, byte: u8) -> bool {
        self.now_ns = self.now_ns.max(at_ns);
        match self.transfer {
            _ if self.in_reset => false,
            Transfer::None => false,
            Transfer::Pointer => {
                self.pointer = byte;
                self.transfer = Transfer::Data;
                true
            }
            Transfer::Data => {
                self.write_register(byte);
                self.move_pointer();
                true
            }
        }
    }

    fn read(&mut self, at_ns: u64) -> u8 {
        self.now_ns = self.now_ns.max(at_ns);
        if self.transfer != Transfer::Data || self.in_reset {
            return 0xFF;
        }
        let value = self.read_register();
        self.move_pointer();
        value
    }

    fn stop(&mut self, at_ns: u64) {
        self.now_ns = self.now_ns.max(at_ns);
        self.transfer = Transfer::None;
    }
}

const fn with(byte: u8, mask: u8, set: bool) -> u8 {
    if set { byte | mask } else { byte & !mask }
}
