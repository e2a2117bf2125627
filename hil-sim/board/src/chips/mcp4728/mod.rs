//! Microchip MCP4728: DAC with four 12-bit outputs and EEPROM, on I2C. Section numbers are those of its datasheet,
//! DS22187, rev. E.
//!
//! # Time
//! The model is lazy: it has no event queue. Every call with a time first advances the chip to it; an earlier time than
//! one already seen counts as that one. Commands act at the ACK of their last byte. Only a write of the EEPROM takes
//! time. An output has its final value at once: the settling time, 6 us, the 4.5 us to leave power-down (4.10) and the
//! start after power-on are not modelled.
//!
//! # Registers
//! Every channel has an input register, an output register and a place in the EEPROM, all with the same 16 bits
//! ([`Setting`]). Input registers reach the outputs at once while LDAC is low, at its falling edge, at a general call
//! software update, or, one channel, at a command with UDAC = 0 (table 4-5).
//!
//! # Where the datasheet leaves room
//! - The EEPROM keeps its old content until the write is complete, also if the supply fails before.
//! - Commands during a write of the EEPROM are ignored (5.6.3; table 5-1, note 3): the model acknowledges them. Reads
//!   work, which is how RDY/BSY is polled, and so does LDAC.
//! - A sequential write starts the EEPROM at the last byte of channel D. If it ends before, only input registers have
//!   changed.
//! - A fast write continues with channel A after channel D.
//! - The general call wake-up changes input and output registers, as the commands for reference, power-down and gain do
//!   (table 5-1, note 4).
//! - Undefined commands, bytes after a complete command, and other general calls are not acknowledged.
//! - Reading and writing the address bits needs an edge of LDAC within a clock of SCL, but the bus model has a
//!   resolution of a byte: the chip always answers as without the edge, that is, it does not acknowledge the next byte.
//!   The address is fixed.
//! - High-speed mode (above 1 MHz) is not modelled.

mod commands;
#[cfg(test)]
mod tests;

use crate::i2c::I2cChip;
use crate::misuse::{Misuse, MisuseKind, MisuseLog};
use commands::{Command, general_call, setting, status};

/// Number of outputs of the chip: A, B, C, D.
pub const CHANNELS: usize = 4;

/// Typical duration of an EEPROM write, ns (1.0, electrical characteristics).
pub const EEPROM_WRITE_TYPICAL_NS: u64 = 25_000_000;

/// Longest duration of an EEPROM write, ns.
pub const EEPROM_WRITE_MAX_NS: u64 = 50_000_000;

/// Setting of a channel, as in commands and reads: VREF, PD1, PD0, GX, and the code in the lower 12 bits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Setting(pub u16);

impl Setting {
    /// Setting as delivered (table 4-2): 0 V, internal reference, gain 1, powered.
    pub const FACTORY: Self = Self(0x8000);

    /// Twelve-bit code of the setting.
    #[must_use]
    pub const fn code(self) -> u16 {
        self.0 & setting::CODE
    }

    /// The setting with the bits of `mask` taken from `bits`.
    const fn with(self, mask: u16, bits: u16) -> Self {
        Self(self.0 & !mask | bits & mask)
    }

    /// Output by section 4.7, and table 4-7 for power-down. No output exceeds the supply (equation 4-1).
    fn output(self, vdd_v: f64) -> Output {
        let ohm = match self.0 & setting::PD {
            0 => {
                let full_scale_v = match (self.0 & setting::VREF != 0, self.0 & setting::GX != 0) {
                    (false, _) => vdd_v,
                    (true, false) => commands::INTERNAL_REFERENCE_V,
                    (true, true) => 2.0 * commands::INTERNAL_REFERENCE_V,
                };
                let volts = full_scale_v * f64::from(self.code()) / commands::CODES;
                return Output { volts: volts.min(vdd_v), impedance: Impedance::Normal };
            }
            0x2000 => 1_000.0,
            0x4000 => 100_000.0,
            _ => 500_000.0,
        };
        Output { volts: 0.0, impedance: Impedance::PulledDown { ohm } }
    }
}

/// Output impedance by mode.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Impedance {
    /// Driven by the output amplifier.
    Normal,
    /// Powered down, with a resistor to ground; typical value.
    PulledDown {
        /// Resistance to ground, Ω.
        ohm: f64,
    },
}

/// Electrical state of an output.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Output {
    /// Voltage without load, V.
    pub volts: f64,
    /// Source of the voltage: amplifier or pull-down.
    pub impedance: Impedance,
}

impl Output {
    /// Output that is not connected.
    const OPEN: Self = Self { volts: 0.0, impedance: Impedance::PulledDown { ohm: f64::INFINITY } };
}

/// Kind of write that sends a setting in two bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Multi,
    /// Sequential write that starts at channel `first`.
    Sequential {
        first: usize,
    },
    Single,
}

/// Phase of an I2C transfer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Transfer {
    /// Not addressed by the bus.
    None,
    /// Addressed for writing; the next byte is a command.
    Command,
    /// Fast write: `upper` is the first byte of a channel, once received.
    Fast { channel: usize, upper: Option<u8> },
    /// Multi-write: the next byte selects a channel.
    Select,
    /// Multi-, sequential or single write: the two bytes of a setting follow.
    Setting { kind: Kind, channel: usize, updates_output: bool, upper: Option<u8> },
    /// Power-down command: the second byte of its bits follows.
    PowerDown { first: u8 },
    /// Complete command; no further byte is expected.
    Complete,
    /// A byte was not acknowledged; the rest is not either.
    Refused,
    /// EEPROM write in progress: bytes are acknowledged and ignored.
    Ignored,
    /// Write of the address bits: without the edge of LDAC the next byte is not acknowledged (figure 5-11, note 2c).
    Address,
    /// General call; its data byte follows.
    GeneralCall,
    /// General call 0Ch: a read of the address bits would follow.
    ReadAddress,
    /// Addressed for reading; `position` is the next of the 24 bytes.
    Read { position: usize },
}

/// A write of the EEPROM in progress.
#[derive(Clone, Copy, Debug)]
struct Programming {
    until_ns: u64,
    content: [Setting; CHANNELS],
}

/// Simulated chip with registers and EEPROM.
#[derive(Clone, Debug)]
pub struct Mcp4728 {
    address: u8,
    vdd_v: f64,
    eeprom_write_ns: u64,
    ldac_high: bool,
    /// Time of LDAC's last falling edge, ns, if there was one.
    ldac_fell_ns: Option<u64>,

    eeprom: [Setting; CHANNELS],
    input: [Setting; CHANNELS],
    output: [Setting; CHANNELS],
    programming: Option<Programming>,

    transfer: Transfer,
    /// First byte of the present command.
    command: u8,
    now_ns: u64,

    outputs: [Output; CHANNELS],
    generation: u64,
    misuse: MisuseLog,
}

impl Mcp4728 {
    /// Name of the chip in reports.
    pub const NAME: &str = "MCP4728";

    /// A chip just powered up, with LDAC low, the 7-bit `address` (0x60 to 0x67; only the three lower bits count, 0x60
    /// is as delivered) and `eeprom` in its EEPROM, A to D. A write of the EEPROM takes the maximum time.
    ///
    /// `vdd_v` is its supply, 2.7 V to 5.5 V; a negative value counts as 0.
    #[must_use]
    pub fn new(address: u8, vdd_v: f64, eeprom: [Setting; CHANNELS]) -> Self {
        let vdd_v = vdd_v.max(0.0);
        Self {
            address: commands::ADDRESS | address & commands::ADDRESS_BITS,
            vdd_v,
            eeprom_write_ns: EEPROM_WRITE_MAX_NS,
            ldac_high: false,
            ldac_fell_ns: None,
            eeprom,
            input: eeprom,
            output: eeprom,
            programming: None,
            transfer: Transfer::None,
            command: 0,
            now_ns: 0,
            outputs: eeprom.map(|setting| setting.output(vdd_v)),
            generation: 0,
            misuse: MisuseLog::new(),
        }
    }

    /// The chip's own 7-bit address.
    #[must_use]
    pub const fn address(&self) -> u8 {
        self.address
    }

    /// Advances the chip to `to_ns`, and completes a write of the EEPROM that ends by then.
    #[inline]
    pub fn advance(&mut self, to_ns: u64) {
        if let Some(Programming { until_ns, content }) = self.programming
            && until_ns <= to_ns
        {
            self.eeprom = content;
            self.programming = None;
            self.generation += 1;
        }
        self.now_ns = self.now_ns.max(to_ns);
    }

    /// End of the EEPROM write in progress, ns; `None` if there is none.
    #[must_use]
    pub fn next_change_ns(&self) -> Option<u64> {
        self.programming.map(|programming| programming.until_ns)
    }

    /// State of an output at the last [`advance`](Self::advance); 0 V with an infinite resistance for a channel above
    /// 3.
    #[must_use]
    pub fn output_v(&self, channel: usize) -> Output {
        self.outputs.get(channel).copied().unwrap_or(Output::OPEN)
    }

    /// Level of the RDY/BSY pin at the last [`advance`](Self::advance): false during a write of the EEPROM.
    #[must_use]
    pub const fn ready(&self) -> bool {
        self.programming.is_none()
    }

    /// EEPROM content of a channel at the last [`advance`](Self::advance); `None` above 3.
    #[must_use]
    pub fn eeprom(&self, channel: usize) -> Option<Setting> {
        self.eeprom.get(channel).copied()
    }

    /// Input register of a channel; `None` above 3.
    #[must_use]
    pub fn input(&self, channel: usize) -> Option<Setting> {
        self.input.get(channel).copied()
    }

    /// Counter that changes whenever an output or RDY/BSY changes, so that a caller can cache values derived from them.
    #[must_use]
    pub const fn generation(&self) -> u64 {
        self.generation
    }

    /// Drives the LDAC pin.
    pub fn set_ldac(&mut self, at_ns: u64, high: bool) {
        self.advance(at_ns);
        match (self.ldac_high, high) {
            (true, false) => {
                self.ldac_fell_ns = Some(self.now_ns);
                self.output = self.input;
                self.refresh();
            }
            (false, true) => {
                let low_ns = self.ldac_fell_ns.map_or(u64::MAX, |fell_ns| self.now_ns - fell_ns);
                if low_ns < commands::LDAC_LOW_NS {
                    self.report(MisuseKind::LdacPulseTooShort { low_ns, needed_ns: commands::LDAC_LOW_NS });
                }
            }
            _ => {}
        }
        self.ldac_high = high;
    }

    /// Interrupts the supply: all registers are loaded from the EEPROM, whatever LDAC is. The levels of the pins stay.
    pub fn power_cycle(&mut self, at_ns: u64) {
        self.advance(at_ns);
        if let Some(Programming { until_ns, .. }) = self.programming.take() {
            self.report(MisuseKind::EepromWriteInterrupted { ready_in_ns: until_ns - self.now_ns });
            self.generation += 1;
        }
        self.transfer = Transfer::None;
        self.reset();
    }

    /// Sets the supply voltage, which is also the reference of the channels with VREF = 0. A negative value counts as
    /// 0.
    pub fn set_vdd_v(&mut self, at_ns: u64, vdd_v: f64) {
        self.advance(at_ns);
        self.vdd_v = vdd_v.max(0.0);
        self.refresh();
    }

    /// Sets the duration of following EEPROM writes.
    pub fn set_eeprom_write_ns(&mut self, duration_ns: u64) {
        self.eeprom_write_ns = duration_ns;
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

    // ---- registers ----

    fn refresh(&mut self) {
        let outputs = self.output.map(|setting| setting.output(self.vdd_v));
        self.generation += u64::from(outputs != self.outputs);
        self.outputs = outputs;
    }

    /// Loads the EEPROM into all registers (5.4.1).
    fn reset(&mut self) {
        self.input = self.eeprom;
        self.output = self.eeprom;
        self.refresh();
    }

    /// Sets an input register, and the outputs according to LDAC and UDAC (table 4-5).
    fn store(&mut self, channel: usize, setting: Setting, updates_output: bool) {
        self.input[channel] = setting;
        if !self.ldac_high {
            self.output = self.input;
        } else if updates_output {
            self.output[channel] = setting;
        }
        self.refresh();
    }

    /// Sets bits of all channels in input and output registers, whatever LDAC is (table 5-1, note 4).
    fn store_bits(&mut self, mask: u16, bits: [u16; CHANNELS]) {
        for (channel, bits) in bits.into_iter().enumerate() {
            self.input[channel] = self.input[channel].with(mask, bits);
            self.output[channel] = self.output[channel].with(mask, bits);
        }
        self.refresh();
    }

    /// Starts to write the input registers of channels `first` to `last` to the EEPROM.
    fn program(&mut self, first: usize, last: usize) {
        let mut content = self.eeprom;
        content[first..=last].copy_from_slice(&self.input[first..=last]);
        let until_ns = self.now_ns.saturating_add(self.eeprom_write_ns);
        self.programming = Some(Programming { until_ns, content });
        self.generation += 1;
    }

    // ---- commands ----

    /// True, and reported, if a command is ignored because the EEPROM is being written.
    fn is_busy(&mut self, command: u8) -> bool {
        if let Some(Programming { until_ns, .. }) = self.programming {
            self.report(MisuseKind::EepromBusy { command, ready_in_ns: until_ns - self.now_ns });
        }
        self.programming.is_some()
    }

    /// Handles the first byte of a command.
    fn begin(&mut self, byte: u8) -> Transfer {
        if self.is_busy(byte) {
            return Transfer::Ignored;
        }
        self.command = byte;
        let channel = commands::channel(byte);
        let updates_output = commands::updates_output(byte);
        let setting = |kind| Transfer::Setting { kind, channel, updates_output, upper: None };
        match Command::decode(byte) {
            Some(Command::FastWrite) => Transfer::Fast { channel: 0, upper: Some(byte) },
            Some(Command::MultiWrite) => setting(Kind::Multi),
            Some(Command::SequentialWrite) => setting(Kind::Sequential { first: channel }),
            Some(Command::SingleWrite) => setting(Kind::Single),
            Some(Command::Address) => {
                self.report(MisuseKind::AddressCommand { command: byte });
                Transfer::Address
            }
            Some(Command::Reference) => {
                self.store_bits(setting::VREF, each_bit(byte, setting::VREF));
                Transfer::Complete
            }
            Some(Command::PowerDown) => Transfer::PowerDown { first: byte },
            Some(Command::Gain) => {
                self.store_bits(setting::GX, each_bit(byte, setting::GX));
                Transfer::Complete
            }
            None => self.refuse(byte),
        }
    }

    /// Handles the second byte of a channel in a fast write (figure 5-7). VREF and GX stay.
    fn fast_write(&mut self, channel: usize, upper: u8, lower: u8) -> Transfer {
        // upper: X X PD1 PD0 D11 D10 D9 D8
        let bits = u16::from(upper & 0x30) << 9 | u16::from(upper & 0x0F) << 8 | u16::from(lower);
        self.store(channel, self.input[channel].with(setting::PD | setting::CODE, bits), false);
        Transfer::Fast { channel: (channel + 1) % CHANNELS, upper: None }
    }

    /// Handles the last byte of a setting in one of the three other writes.
    fn write_setting(&mut self, kind: Kind, channel: usize, setting: Setting, updates_output: bool) -> Transfer {
        self.store(channel, setting, updates_output);
        match kind {
            Kind::Multi => Transfer::Select,
            Kind::Sequential { .. } if channel + 1 < CHANNELS => {
                Transfer::Setting { kind, channel: channel + 1, updates_output, upper: None }
            }
            Kind::Sequential { first } => {
                self.program(first, CHANNELS - 1);
                Transfer::Complete
            }
            Kind::Single => {
                self.program(channel, channel);
                Transfer::Complete
            }
        }
    }

    /// Handles the data byte of a general call (5.4).
    fn general_call(&mut self, byte: u8) -> Transfer {
        match byte {
            general_call::RESET | general_call::UPDATE | general_call::WAKE_UP if self.is_busy(byte) => {
                return Transfer::Ignored;
            }
            general_call::RESET => self.reset(),
            general_call::UPDATE => {
                self.output = self.input;
                self.refresh();
            }
            general_call::WAKE_UP => self.store_bits(setting::PD, [0; CHANNELS]),
            general_call::READ_ADDRESS => {
                self.report(MisuseKind::AddressCommand { command: byte });
                return Transfer::ReadAddress;
            }
            // a general call for other chips
            _ => return Transfer::Refused,
        }
        Transfer::Complete
    }

    fn refuse(&mut self, byte: u8) -> Transfer {
        self.report(MisuseKind::UnexpectedByte { byte });
        Transfer::Refused
    }

    /// Ends a transfer at STOP or repeated START, and reports an incomplete command.
    fn end(&mut self) {
        let complete = match self.transfer {
            Transfer::Fast { upper, .. } => upper.is_none(),
            Transfer::Setting { .. } | Transfer::PowerDown { .. } => false,
            _ => true,
        };
        if !complete {
            self.report(MisuseKind::CommandIncomplete { command: self.command });
        }
        self.transfer = Transfer::None;
    }

    /// Byte of a read, 24 in all (figure 5-15): per channel three of the input register, then three of the EEPROM.
    fn byte_at(&self, position: usize) -> u8 {
        let channel = position / 6 % CHANNELS;
        let setting = if position % 6 < 3 { self.input[channel] } else { self.eeprom[channel] };
        let [upper, lower] = setting.0.to_be_bytes();
        match position % 3 {
            0 => {
                let ready = if self.ready() { status::READY } else { 0 };
                ready | status::POR | (channel as u8) << 4 | self.address & commands::ADDRESS_BITS
            }
            1 => upper,
            _ => lower,
        }
    }
}

impl I2cChip for Mcp4728 {
    fn acknowledges(&self, address: u8, read: bool) -> bool {
        if address == 0 {
            return !read;
        }
        // 5.4.4: without the edge of LDAC the read that follows 0Ch is not acknowledged
        address == self.address && !(read && self.transfer == Transfer::ReadAddress)
    }

    fn start(&mut self, at_ns: u64, address: u8, read: bool) {
        self.advance(at_ns);
        self.end();
        self.transfer = match (address, read) {
            (0, _) => Transfer::GeneralCall,
            (_, true) => Transfer::Read { position: 0 },
            (_, false) => Transfer::Command,
        };
    }

    fn write(&mut self, at_ns: u64, byte: u8) -> bool {
        self.advance(at_ns);
        let transfer = self.transfer;
        self.transfer = match transfer {
            Transfer::Command => self.begin(byte),
            Transfer::Fast { channel, upper: None } => Transfer::Fast { channel, upper: Some(byte) },
            Transfer::Fast { channel, upper: Some(upper) } => self.fast_write(channel, upper, byte),
            Transfer::Select => Transfer::Setting {
                kind: Kind::Multi,
                channel: commands::channel(byte),
                updates_output: commands::updates_output(byte),
                upper: None,
            },
            Transfer::Setting { kind, channel, updates_output, upper: None } => {
                Transfer::Setting { kind, channel, updates_output, upper: Some(byte) }
            }
            Transfer::Setting { kind, channel, updates_output, upper: Some(upper) } => {
                self.write_setting(kind, channel, Setting(u16::from_be_bytes([upper, byte])), updates_output)
            }
            Transfer::PowerDown { first } => {
                self.store_bits(setting::PD, power_down_bits(first, byte));
                Transfer::Complete
            }
            Transfer::Complete if self.is_busy(byte) => Transfer::Ignored,
            Transfer::Complete => self.refuse(byte),
            Transfer::GeneralCall => self.general_call(byte),
            Transfer::Ignored => Transfer::Ignored,
            Transfer::None | Transfer::Address | Transfer::ReadAddress | Transfer::Read { .. } | Transfer::Refused => {
                Transfer::Refused
            }
        };
        self.transfer != Transfer::Refused
    }

    fn read(&mut self, at_ns: u64) -> u8 {
        self.advance(at_ns);
        let Transfer::Read { position } = self.transfer else { return 0xFF };
        self.transfer = Transfer::Read { position: (position + 1) % (6 * CHANNELS) };
        self.byte_at(position)
    }

    fn stop(&mut self, at_ns: u64) {
        self.advance(at_ns);
        self.end();
    }
}

/// Bit for each of A, B, C and D from the lower four bits of a command, moved to `bit` (figures 5-12 and 5-14).
fn each_bit(command: u8, bit: u16) -> [u16; CHANNELS] {
    core::array::from_fn(|channel| if command & (0b1000 >> channel) != 0 { bit } else { 0 })
}

/// Power-down bits of the channels from `101X PD1A PD0A PD1B PD0B`, `PD1C PD0C PD1D PD0D XXXX` (figure 5-13).
fn power_down_bits(first: u8, second: u8) -> [u16; CHANNELS] {
    let pairs = first << 4 | second >> 4;
    core::array::from_fn(|channel| u16::from(pairs >> (6 - 2 * channel) & 0b11) << 13)
}
