//! ST VL6180X: ranges by time of flight, behind registers with addresses of 16 bits. Section numbers are those of its datasheet,
//! DocID026171 revision 6; the light sensor is not modelled.
//!
//! # What it measures
//! A range takes 3.2 ms before the light, the time until enough of it has come back, and 1.3 ms with 64.5 us for each sample of averaging.
//! What comes back falls with the square of the distance and with the target's reflectance. A target for which that takes longer than the
//! longest convergence time is none: error 7, range 255. Otherwise the range is the distance at the end of the convergence with an
//! offset and white noise, rounded to millimetres.
//!
//! # Where the datasheet leaves room
//! - Time to converge and noise are from memory of its tables: 1.2 ms at 50 mm on a target of 17 %, 1 mm rms up to 50 mm and
//!   proportional to the distance beyond.
//! - A chip that was not given the private settings of AN4545 fails with error 1, as users who left them out have reported.
//! - Cross-talk, the early convergence estimate, thresholds, history, scaling of the range and the calibration for the temperature are not
//!   modelled: their registers hold what is written.
//! - A range that would be below 0 is 0 with error 14, one above 255 mm is 255 with error 15.

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
/// Before the light, ns.
const BEFORE_NS: u64 = 3_200_000;
/// Behind it, and for each sample of averaging, ns.
const AVERAGING_NS: [u64; 2] = [1_300_000, 64_500];
/// Time to converge at 50 mm on a target of 17 %, s; and the shortest.
const CONVERGENCE_S: f64 = 1.2e-3;
const CONVERGENCE_MIN_S: f64 = 0.18e-3;
/// Noise up to 50 mm, mm rms.
const NOISE_MM: f64 = 1.0;

/// The settings of section 9 of AN4545, as runs of registers: the first one's address, and their values.
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

/// What is in front of the chip.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Target {
    /// How far away it is, m.
    pub distance_m: f64,
    /// Share of the light that it gives back: 0.17 is grey, 0.88 white.
    pub reflectance: f64,
}

/// What came of a range.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Ranged {
    millimetres: u8,
    error: u8,
}

/// A range under way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Ranging {
    began_ns: u64,
    /// What it will be, and when, as soon as the light is back.
    result: Option<(Ranged, u64)>,
}

/// One chip.
#[derive(Clone, Debug)]
pub struct Vl6180x {
    /// What was written since power-up.
    written: BTreeMap<u16, u8>,
    model: u8,
    pointer: u16,
    /// Bytes of the transfer under way; `None` while it is not addressed to be written.
    taken: Option<u8>,
    now_ns: u64,

    ranged: Ranged,
    flag: u8,
    is_continuous: bool,
    ranging: Option<Ranging>,
    /// When the next one of a series begins.
    next_ns: u64,
    felt_ns: u64,
    offset_mm: f64,
    /// Ranges never end, as with a broken oscillator.
    hung: bool,
    noise: Pcg64,
    misuse: MisuseLog,
}

impl Vl6180x {
    /// What it is called in reports.
    pub const NAME: &str = "VL6180X";

    /// A chip just powered that ranges `offset_m` too far. Its noise is drawn from `seed`.
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

    /// Takes the supply away and returns it.
    pub fn power_cycle(&mut self) {
        self.written.clear();
        self.ranged = Ranged { millimetres: 0, error: 0 };
        (self.flag, self.is_continuous, self.ranging, self.taken) = (0, false, None, None);
    }

    /// Another chip is at its address.
    pub fn set_model(&mut self, model: u8) {
        self.model = model;
    }

    /// From now on no range ends, or they do again.
    pub fn set_hung(&mut self, hung: bool) {
        self.hung = hung;
    }

    /// Up to when it has seen its target, ns.
    #[must_use]
    pub const fn felt_ns(&self) -> u64 {
        self.felt_ns
    }

    /// What was done to the chip against its datasheet.
    #[must_use]
    pub const fn misuse(&self) -> &MisuseLog {
        &self.misuse
    }

    /// `target` has been in front of it since the last call, up to `until_ns`: ranges end that were due meanwhile.
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
            self.next_ns = (ranging.began_ns + period_ns).max(end_ns);
        }
        self.felt_ns = self.felt_ns.max(until_ns);
    }

    fn begin(&mut self, at_ns: u64) {
        self.ranging = Some(Ranging { began_ns: at_ns, result: None });
    }

    /// What a range comes to whose light goes out at `lit_ns`, and when.
    fn range(&mut self, lit_ns: u64, target: Option<Target>) -> (Ranged, u64) {
        let longest_s = f64::from(self.register(0x01C)) * 1e-3;
        // Not a number: nothing is there.
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

    /// A register that holds what is written, or what it has after power-up (section 6.2).
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

    /// Identification, results and what the datasheet gives no name to are read only, or are not there.
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

    /// Bit 0 starts a range, or a series where bit 1 says so; it ends the series that is under way.
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
