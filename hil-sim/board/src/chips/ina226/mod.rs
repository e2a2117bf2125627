//! TI INA226: shunt and bus voltage, current and power behind 16-bit registers. Section and table numbers are those of
//! its datasheet, SBOS547A. The ALERT pin is not modelled; its registers only store writes.
//!
//! # Where the datasheet leaves room
//! - The converter integrates: a result is the mean of its input over the whole cycle of all conversions, for shunt and
//!   bus alike. In the chip they alternate.
//! - Conversions take their typical time (6.5). Triggered modes and those of a single input do not convert here.
//! - Offset, gain error and noise are 0, except for the rounding to counts: typically 2.5 uV, one count (6.5).
//! - A transfer of one byte to a register has no effect.

#[cfg(test)]
mod tests;

use crate::{
    i2c::I2cChip,
    misuse::{Misuse, MisuseKind, MisuseLog},
};

/// Conversion times by their codes (tables 7 and 8), ns.
const CONVERSION_NS: [u64; 8] = [140_000, 204_000, 332_000, 588_000, 1_100_000, 2_116_000, 4_156_000, 8_244_000];
/// Number of averaged samples by code (table 6).
const SAMPLES: [u64; 8] = [1, 4, 16, 64, 128, 256, 512, 1024];
/// Configuration register after power-up (7.6.1).
const POWER_UP: u16 = 0x4127;

/// Voltages at the chip's inputs.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Inputs {
    /// Shunt voltage between IN+ and IN-, V.
    pub shunt_v: f64,
    /// Bus voltage at VBUS, V.
    pub bus_v: f64,
}

/// Simulated chip with its registers.
#[derive(Clone, Debug)]
pub struct Ina226 {
    address: u8,
    manufacturer: u16,
    configuration: u16,
    shunt: i16,
    bus: u16,
    calibration: u16,
    mask_enable: u16,
    alert_limit: u16,

    pointer: u8,
    /// Number of bytes of the transfer so far, pointer included; `None` while not addressed.
    position: Option<usize>,
    written: [u8; 2],
    shifting: u16,
    now_ns: u64,

    /// Time up to which the inputs are known, and their integrals over the present cycle, V s.
    felt_ns: u64,
    shunt_vs: f64,
    bus_vs: f64,
    cycle_from_ns: u64,
    /// True if conversions never end, as with a broken oscillator.
    hung: bool,
    misuse: MisuseLog,
}

impl Ina226 {
    /// Name of the chip in reports.
    pub const NAME: &str = "INA226";

    /// A chip just powered up, with A1 and A0 giving the lower four bits of the 7-bit `address` (0x40 to 0x4F).
    #[must_use]
    pub fn new(address: u8) -> Self {
        Self {
            address: 0x40 | address & 0x0F,
            manufacturer: 0x5449,
            configuration: POWER_UP,
            shunt: 0,
            bus: 0,
            calibration: 0,
            mask_enable: 0,
            alert_limit: 0,
            pointer: 0,
            position: None,
            written: [0; 2],
            shifting: 0,
            now_ns: 0,
            felt_ns: 0,
            shunt_vs: 0.0,
            bus_vs: 0.0,
            cycle_from_ns: 0,
            hung: false,
            misuse: MisuseLog::new(),
        }
    }

    /// Interrupts the supply: all registers return to those after power-up.
    pub fn power_cycle(&mut self) {
        let Self { address, manufacturer, now_ns, felt_ns, hung, .. } = *self;
        let misuse = std::mem::replace(&mut self.misuse, MisuseLog::new());
        *self = Self { manufacturer, now_ns, felt_ns, cycle_from_ns: felt_ns, hung, misuse, ..Self::new(address) };
    }

    /// Sets the manufacturer ID, as if another chip were at its address.
    pub fn set_manufacturer(&mut self, manufacturer: u16) {
        self.manufacturer = manufacturer;
    }

    /// Stops all conversions, or lets them continue.
    pub fn set_hung(&mut self, hung: bool) {
        self.hung = hung;
    }

    /// Violations of the datasheet so far.
    #[must_use]
    pub const fn misuse(&self) -> &MisuseLog {
        &self.misuse
    }

    /// Advances to `until_ns` with `inputs` constant since the last call, and completes conversions due meanwhile.
    pub fn feel(&mut self, until_ns: u64, inputs: Inputs) {
        let Some(cycle_ns) = self.cycle_ns().filter(|_| !self.hung) else {
            self.felt_ns = self.felt_ns.max(until_ns);
            self.begin_cycle(self.felt_ns);
            return;
        };
        while self.cycle_from_ns + cycle_ns <= until_ns {
            let end_ns = self.cycle_from_ns + cycle_ns;
            self.integrate(end_ns, inputs);
            let cycle_s = cycle_ns as f64 * 1e-9;
            // rounded to counts of 2.5 uV and 1.25 mV (7.6.2, 7.6.3), and clipped (`as` saturates)
            self.shunt = (self.shunt_vs / cycle_s / 2.5e-6).round() as i16;
            self.bus = ((self.bus_vs / cycle_s / 1.25e-3).round() as u16).min(0x7FFF);
            self.mask_enable |= 1 << 3;
            self.begin_cycle(end_ns);
        }
        self.integrate(until_ns, inputs);
    }

    fn integrate(&mut self, until_ns: u64, inputs: Inputs) {
        let dt_s = until_ns.saturating_sub(self.felt_ns) as f64 * 1e-9;
        self.felt_ns = self.felt_ns.max(until_ns);
        self.shunt_vs += inputs.shunt_v * dt_s;
        self.bus_vs += inputs.bus_v * dt_s;
    }

    fn begin_cycle(&mut self, at_ns: u64) {
        self.cycle_from_ns = at_ns;
        (self.shunt_vs, self.bus_vs) = (0.0, 0.0);
    }

    /// Duration of one cycle of all conversions, ns; `None` in modes other than continuous shunt and bus.
    fn cycle_ns(&self) -> Option<u64> {
        let code = |at: u16| usize::from(self.configuration >> at & 7);
        (code(0) == 7).then(|| SAMPLES[code(9)] * (CONVERSION_NS[code(6)] + CONVERSION_NS[code(3)]))
    }

    fn read_register(&mut self) -> u16 {
        // current register by the formula of 7.5.1
        let current = (i32::from(self.shunt) * i32::from(self.calibration) / 2048) as i16;
        match self.pointer {
            0x00 => self.configuration,
            0x01 => self.shunt as u16,
            0x02 => self.bus,
            0x03 => (i32::from(current).abs() * i32::from(self.bus) / 20_000) as u16,
            0x04 => current as u16,
            0x05 => self.calibration,
            0x06 => {
                // reading clears CVRF (7.6.7)
                let value = self.mask_enable;
                self.mask_enable &= !(1 << 3);
                value
            }
            0x07 => self.alert_limit,
            0xFE => self.manufacturer,
            0xFF => 0x2260,
            register => {
                self.report(MisuseKind::UnimplementedRegister { register });
                0
            }
        }
    }

    fn write_register(&mut self, value: u16) {
        match self.pointer {
            0x00 => {
                if value & 1 << 15 != 0 {
                    self.power_cycle();
                } else {
                    // bits 14 to 12 are read-only; a write restarts the conversions and clears CVRF (7.6.7)
                    self.configuration = value & 0x0FFF | POWER_UP & 0x7000;
                    self.mask_enable &= !(1 << 3);
                    self.begin_cycle(self.felt_ns);
                }
            }
            0x05 => self.calibration = value & 0x7FFF,
            0x06 => self.mask_enable = value & 0xFC03 | self.mask_enable & 0x001C,
            0x07 => self.alert_limit = value,
            register @ (0x01..=0x04 | 0xFE | 0xFF) => self.report(MisuseKind::ReadOnlyRegister { register }),
            register => self.report(MisuseKind::UnimplementedRegister { register }),
        }
    }

    #[cold]
    fn report(&mut self, kind: MisuseKind) {
        self.misuse.report(Misuse { time_ns: self.now_ns, chip: Self::NAME, address: self.address, kind });
    }
}

impl I2cChip for Ina226 {
    fn acknowledges(&self, address: u8, _read: bool) -> bool {
        address == self.address
    }

    fn start(&mut self, at_ns: u64, _address: u8, read: bool) {
        self.now_ns = self.now_ns.max(at_ns);
        self.position = Some(0);
        if read {
            self.shifting = self.read_register();
        }
    }

    fn write(&mut self, at_ns: u64, byte: u8) -> bool {
        self.now_ns = self.now_ns.max(at_ns);
        let Some(position) = self.position else { return false };
        match position {
            0 => self.pointer = byte,
            1 => self.written[0] = byte,
            2 => {
                self.written[1] = byte;
                self.write_register(u16::from_be_bytes(self.written));
            }
            // no byte is acknowledged after the register's second one
            _ => return false,
        }
        self.position = Some(position + 1);
        true
    }

    fn read(&mut self, at_ns: u64) -> u8 {
        self.now_ns = self.now_ns.max(at_ns);
        let Some(position) = self.position else { return 0xFF };
        self.position = Some(position + 1);
        self.shifting.to_be_bytes().get(position).copied().unwrap_or(0xFF)
    }

    fn stop(&mut self, at_ns: u64) {
        self.now_ns = self.now_ns.max(at_ns);
        self.position = None;
    }
}
