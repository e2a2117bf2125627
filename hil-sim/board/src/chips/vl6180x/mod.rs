//! ST VL6180X: time-of-flight range sensor, behind registers with 16-bit addresses. Section numbers are those of its
//! datasheet, DocID026171 revision 6; the light sensor is not modelled.
//!
//! # Measurement
//! A range takes 3.2 ms before the emission, the convergence time, and 1.3 ms plus 64.5 us for each sample of
//! averaging. The returned light falls with the square of the distance and is proportional to the target's reflectance.
//! A target that would need more than the maximum convergence time is not detected: error 7, range 255. Otherwise the
//! range is the distance at the end of the convergence plus an offset and white noise, rounded to millimetres.
//!
//! # Where the datasheet leaves room
//! - Convergence time and noise are quoted from memory of its tables: 1.2 ms at 50 mm on a target of 17 %, 1 mm rms up
//!   to 50 mm and proportional to the distance beyond.
//! - A chip without the private settings of AN4545 fails with error 1, as users who omitted them have reported.
//! - Cross-talk, the early convergence estimate, thresholds, history, scaling of the range and the calibration for the
//!   temperature are not modelled: their registers only store writes.
//! - A range below 0 is 0 with error 14, one above 255 mm is 255 with error 15.

#[cfg(test)]
mod tests;

use std::collections::BTreeMap;

use rand_pcg::{Pcg64, rand_core::SeedableRng};

use crate::{
    i2c::I2cChip,
    misuse::{Misuse, MisuseKind, MisuseLog},
    sensors::normal,
};

const ADDRESS: u8 = 0x29;
/// Time before the emission, ns.
const BEFORE_NS: u64 = 3_200_000;
/// Time after the convergence, and per sample of averaging, ns.
const AVERAGING_NS: [u64; 2] = [1_300_000, 64_500];
/// Convergence time at 50 mm on a target of 17 %, s; and the shortest.
const CONVERGENCE_S: f64 = 1.2e-3;
const CONVERGENCE_MIN_S: f64 = 0.18e-3;
/// Noise up to 50 mm, mm rms.
const NOISE_MM: f64 = 1.0;

/// Settings required by section 9 of AN4545, as runs of registers: the address of the first, and their values.
const NEEDED: [(u16, &[u8]); 24] = [
    (0x0030, &[0x00]),
    (0x0096, &[0x00, 0xFD]),
    (0x009F, &[0x00]),
    (0x00A3, &[0x3C]),
    (0x00B2, &[0x09]),
    (0x00B7, &[0x00]),
    (0x00BB, &[0x3C]),
    (0x00CA, &[0x09]),
    (0x00D9, &[0x05]),
    (0x00DB, &[0xCE, 0x03, 0xF8]),
    (0x00E3, &[0x00, 0x04, 0x02, 0x01, 0x03]),
    (0x00F5, &[0x02]),
    (0x00FF, &[0x05]),
    (0x0100, &[0x05]),
    (0x0198, &[0x01]),
    (0x0199, &[0x05]),
    (0x01A6, &[0x1B]),
    (0x01A7, &[0x1F]),
    (0x01AC, &[0x3E]),
    (0x01AD, &[0x00]),
    (0x01B0, &[0x17]),
    (0x0207, &[0x01]),
    (0x0208, &[0x01]),
    (0x0016, &[0x00]),
];

/// Target in front of the chip.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Target {
    /// Distance of the target, m.
    pub distance_m: f64,
    /// Reflectance: 0.17 is grey, 0.88 white.
    pub reflectance: f64,
}

/// Result of a range measurement.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Ranged {
    millimetres: u8,
    error: u8,
}

/// A range measurement in progress.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Ranging {
    began_ns: u64,
    /// Result and its time, ns, known once the light is emitted.
    result: Option<(Ranged, u64)>,
}

/// Simulated chip with its registers.
#[derive(Clone, Debug)]
pub struct Vl6180x {
    /// Registers written since power-up.
    written: BTreeMap<u16, u8>,
    model: u8,
    pointer: u16,
    /// Number of bytes of the write transfer so far; `None` while not addressed for writing.
    taken: Option<u8>,
    now_ns: u64,

    ranged: Ranged,
    flag: u8,
    is_continuous: bool,
    ranging: Option<Ranging>,
    /// Start of the next measurement of a series, ns.
    next_ns: u64,
    felt_ns: u64,
    offset_mm: f64,
    /// True if measurements never end, as with a broken oscillator.
    hung: bool,
    noise: Pcg64,
    misuse: MisuseLog,
}

impl Vl6180x {
    /// Name of the chip in reports.
    pub const NAME: &str = "VL6180X";

    /// A chip just powered up whose ranges are `offset_m` too long. `seed` is that of its noise.
    #[must_use]
    pub fn new(seed: u64, offset_m: f64) -> Self {
        Self {
            written: BTreeMap::new(),
            model: 0xB4,
            pointer: 0,
            taken: None,
            now_ns: 0,
            ranged: Ranged { millimetres: 0, error: 0 },
            flag: 0,
            is_continuous: false,
            ranging: None,
            next_ns: 0,
            felt_ns: 0,
            offset_mm: offset_m * 1e3,
            hung: false,
            noise: Pcg64::seed_from_u64(seed),
            misuse: MisuseLog::new(),
        }
    }

    /// Interrupts the supply of the chip.
    pub fn power_cycle(&mut self) {
        self.written.clear();
        self.ranged = Ranged { millimetres: 0, error: 0 };
        (self.flag, self.is_continuous, self.ranging, self.taken) = (0, false, None, None);
    }

    /// Sets the model ID, as if another chip were at its address.
    pub fn set_model(&mut self, model: u8) {
        self.model = model;
    }

    /// Stops all measurements, or lets them continue.
    pub fn set_hung(&mut self, hung: bool) {
        self.hung = hung;
    }

    /// Time up to which the target is known, ns.
    #[must_use]
    pub const fn felt_ns(&self) -> u64 {
        self.felt_ns
    }

    /// Violations of the datasheet so far.
    #[must_use]
    pub const fn misuse(&self) -> &MisuseLog {
        &self.misuse
    }

    /// Advances to `until_ns` with `target` in front of the chip since the last call, and completes measurements due
    /// meanwhile.
    pub fn feel(&mut self, until_ns: u64, target: Option<Target>) {
        while !self.hung {
            let Some(mut ranging) = self.ranging else {
                if self.is_continuous && self.next_ns <= until_ns {
                    self.begin(self.next_ns);
                    continue;
                }
                break;
            };
            let lit_ns = ranging.began_ns + BEFORE_NS;
            let Some((ranged, end_ns)) = ranging.result else {
                if lit_ns > until_ns {
                    break;
                }
                ranging.result = Some(self.range(lit_ns, target));
                self.ranging = Some(ranging);
                continue;
            };
            if end_ns > until_ns {
                break;
            }
            (self.ranged, self.ranging) = (ranged, None);
            if self.register(0x014) & 0b111 == 0b100 {
                self.flag = 0b100;
            }
            let period_ns = (u64::from(self.register(0x01B)) + 1) * 10_000_000;
            // next measurement of a series: a period after this one began, but not before it ends
            self.next_ns = (ranging.began_ns + period_ns).max(end_ns);
        }
        self.felt_ns = self.felt_ns.max(until_ns);
    }

    fn begin(&mut self, at_ns: u64) {
        self.ranging = Some(Ranging { began_ns: at_ns, result: None });
    }

    /// Result of a measurement whose light is emitted at `lit_ns`, and the time of its end, ns.
    fn range(&mut self, lit_ns: u64, target: Option<Target>) -> (Ranged, u64) {
        let longest_s = f64::from(self.register(0x01C)) * 1e-3;
        // NaN means no target
        let converged = target.filter(|target| !target.distance_m.is_nan()).and_then(|target| {
            let distance_mm = target.distance_m.max(0.0) * 1e3;
            let farther = distance_mm / 50.0;
            let takes_s = (CONVERGENCE_S * farther * farther * 0.17 / target.reflectance).max(CONVERGENCE_MIN_S);
            (takes_s <= longest_s).then_some((distance_mm, takes_s))
        });
        let (ranged, takes_s) = if !self.is_tuned() {
            (Ranged { millimetres: 255, error: 1 }, CONVERGENCE_MIN_S)
        } else if let Some((distance_mm, takes_s)) = converged {
            let deviation_mm = NOISE_MM * (distance_mm / 50.0).max(1.0);
            let shown = (distance_mm + self.offset_mm + deviation_mm * normal(&mut self.noise)).round();
            let error = match shown {
                ..0.0 => 14,
                256.0.. => 15,
                _ => 0,
            };
            (Ranged { millimetres: shown as u8, error }, takes_s)
        } else {
            (Ranged { millimetres: 255, error: 7 }, longest_s)
        };
        let [behind_ns, sample_ns] = AVERAGING_NS;
        let averaging_ns = behind_ns + sample_ns * u64::from(self.register(0x10A));
        (ranged, lit_ns + (takes_s * 1e9) as u64 + averaging_ns)
    }

    fn is_tuned(&self) -> bool {
        let mut all = NEEDED.iter().flat_map(|(first, values)| (*first..).zip(values.iter()));
        all.all(|(register, value)| self.written.get(&register) == Some(value))
    }

    /// Value of a register that only stores writes, or its value after power-up (section 6.2).
    fn register(&self, register: u16) -> u8 {
        let after_power_up = match register {
            0x016 => 0x01,
            0x01B => 0xFF,
            0x01C => 0x31,
            0x10A => 0x30,
            0x212 => ADDRESS,
            _ => 0,
        };
        self.written.get(&register).copied().unwrap_or(after_power_up)
    }

    /// True for an address with a register; identification and results among them are read-only.
    const fn has(register: u16) -> bool {
        matches!(register, 0x000..=0x008 | 0x010..=0x040 | 0x04D..=0x083 | 0x096..=0x208 | 0x212 | 0x2A3)
    }

    fn read_register(&mut self) -> u8 {
        let register = self.pointer;
        let is_idle = self.ranging.is_none() && !self.is_continuous;
        match register {
            0x000 => self.model,
            0x001 => 1,
            0x002 => 3,
            0x04D => self.ranged.error << 4 | u8::from(is_idle),
            0x04F => self.flag,
            0x062 => self.ranged.millimetres,
            _ if Self::has(register) => self.register(register),
            _ => {
                self.report(MisuseKind::UnimplementedRegister { register: register as u8 });
                0
            }
        }
    }

    fn write_register(&mut self, value: u8) {
        match self.pointer {
            0x015 => {
                if value & 1 != 0 {
                    self.flag = 0;
                }
            }
            0x018 => self.command(value),
            register @ (0x000..=0x008 | 0x04D..=0x083) => {
                self.report(MisuseKind::ReadOnlyRegister { register: register as u8 });
            }
            register if Self::has(register) => {
                self.written.insert(register, value);
            }
            register => self.report(MisuseKind::UnimplementedRegister { register: register as u8 }),
        }
    }

    /// Handles a write of the start register: bit 0 starts a measurement, or a series if bit 1 is set; it ends a
    /// running series.
    fn command(&mut self, value: u8) {
        if value & 1 == 0 {
            return;
        }
        if self.is_continuous {
            self.is_continuous = false;
            return;
        }
        self.is_continuous = value & 2 != 0;
        if self.ranging.is_none() {
            self.begin(self.now_ns.max(self.felt_ns));
        }
    }

    #[cold]
    fn report(&mut self, kind: MisuseKind) {
        self.misuse.report(Misuse { time_ns: self.now_ns, chip: Self::NAME, address: ADDRESS, kind });
    }
}

impl I2cChip for Vl6180x {
    fn acknowledges(&self, address: u8, _read: bool) -> bool {
        address == ADDRESS
    }

    fn start(&mut self, at_ns: u64, _address: u8, read: bool) {
        self.now_ns = self.now_ns.max(at_ns);
        self.taken = (!read).then_some(0);
    }

    fn write(&mut self, at_ns: u64, byte: u8) -> bool {
        self.now_ns = self.now_ns.max(at_ns);
        let Some(taken) = self.taken else { return false };
        match taken {
            0 => self.pointer = u16::from(byte) << 8,
            1 => self.pointer |= u16::from(byte),
            _ => {
                self.write_register(byte);
                self.pointer = self.pointer.wrapping_add(1);
            }
        }
        self.taken = Some(taken.saturating_add(1));
        true
    }

    fn read(&mut self, at_ns: u64) -> u8 {
        self.now_ns = self.now_ns.max(at_ns);
        let byte = self.read_register();
        self.pointer = self.pointer.wrapping_add(1);
        byte
    }

    fn stop(&mut self, at_ns: u64) {
        self.now_ns = self.now_ns.max(at_ns);
        self.taken = None;
    }
}
