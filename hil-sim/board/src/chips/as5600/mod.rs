//! ams AS5600: magnetic angle sensor on I2C. Page and figure numbers are those of its datasheet, v1-06 of 2018-06-20.
//!
//! # Measurement
//! Every 150 µs the chip samples the angle. The sample passes a first-order low-pass with the settling time of the
//! selected slow filter, gets white noise of that filter's deviation, and is rounded down to one of 4096 counts. The
//! reading increases with the true angle: the DIR pin is assumed to be wired accordingly.
//!
//! # Where the datasheet leaves room
//! - Sampling rate, settling times and noise of the slow filters, and the polling times of the low-power modes (figure
//!   6) are quoted from memory. The settling time is taken as that to 95 %, three time constants.
//! - Before its first sample after power-up the chip reads angle 0 and no magnet.
//! - A weak magnet trebles the noise, a strong one does not change it; without a magnet each sample is random.
//! - The fast filter, the watchdog, the outputs and the OTP memory are not modelled: their bits only store writes.
//! - Two bytes of one register belong to one sample if they are read in one transfer.
//! - A pointer that reaches RAW ANGLE, ANGLE or MAGNITUDE by auto-increment keeps incrementing (page 13: only a pointer
//!   set to one of them stays there).

#[cfg(test)]
mod tests;

use std::f64::consts::TAU;

use rand_pcg::{
    Pcg64,
    rand_core::{Rng, SeedableRng},
};

use crate::{
    i2c::I2cChip,
    misuse::{Misuse, MisuseKind, MisuseLog},
    sensors::normal,
};

const ADDRESS: u8 = 0x36;
/// Sampling period by PM, ns.
const SAMPLING_NS: [u64; 4] = [150_000, 5_000_000, 20_000_000, 100_000_000];
/// Settling times of the slow filters by SF, s.
const SETTLING_S: [f64; 4] = [2.2e-3, 1.1e-3, 0.55e-3, 0.286e-3];
/// Noise after the slow filters by SF, ° rms.
const NOISE_DEG: [f64; 4] = [0.015, 0.021, 0.030, 0.043];
/// Factor on the noise with a weak magnet: our choice.
const WEAK_NOISE: f64 = 3.0;

/// Magnet in front of the chip.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Magnet {
    /// A magnet in the middle of the chip's range.
    #[default]
    Good,
    /// A field too weak for the highest gain.
    Weak,
    /// A field too strong for the lowest gain.
    Strong,
    /// No magnet in front of the chip.
    Absent,
}

/// Phase of an I2C transfer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Transfer {
    None,
    Pointer,
    Data,
}

/// Simulated chip with its registers.
#[derive(Clone, Debug)]
pub struct As5600 {
    /// ZPOS, MPOS, MANG and CONF: registers 1 to 8.
    settings: [u8; 8],
    magnet: Magnet,
    pointer: u8,
    /// Upper byte's address, to which a pointer returns that was set to a two-byte measurement.
    comes_back_to: Option<u8>,
    /// Value of the two-byte register whose upper byte has been read in this transfer.
    latched: u16,
    transfer: Transfer,
    now_ns: u64,

    /// Time up to which the angle is known, and the angle then, rad, with whole turns.
    felt_ns: u64,
    felt_rad: f64,
    /// Output of the low-pass, rad; `None` before the first sample.
    filtered_rad: Option<f64>,
    raw: u16,
    next_sample_ns: u64,
    noise: Pcg64,
    misuse: MisuseLog,
}

impl As5600 {
    /// Name of the chip in reports.
    pub const NAME: &str = "AS5600";

    /// A chip just powered up, with a blank OTP memory. `seed` is that of its noise.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        Self {
            settings: [0; 8],
            magnet: Magnet::Good,
            pointer: 0,
            comes_back_to: None,
            latched: 0,
            transfer: Transfer::None,
            now_ns: 0,
            felt_ns: 0,
            felt_rad: 0.0,
            filtered_rad: None,
            raw: 0,
            next_sample_ns: 0,
            noise: Pcg64::seed_from_u64(seed),
            misuse: MisuseLog::new(),
        }
    }

    /// Interrupts the supply: all settings return to those after power-up.
    pub fn power_cycle(&mut self) {
        self.settings = [0; 8];
        (self.filtered_rad, self.raw, self.pointer) = (None, 0, 0);
        self.transfer = Transfer::None;
    }

    /// Sets the magnet in front of the chip.
    pub const fn set_magnet(&mut self, magnet: Magnet) {
        self.magnet = magnet;
    }

    /// Violations of the datasheet so far.
    #[must_use]
    pub const fn misuse(&self) -> &MisuseLog {
        &self.misuse
    }

    /// Advances to `until_ns`, with the angle moving linearly from the last call to `angle_rad`, and takes the samples
    /// due meanwhile.
    pub fn feel(&mut self, until_ns: u64, angle_rad: f64) {
        let (from_ns, from_rad) = (self.felt_ns, self.felt_rad);
        if until_ns < from_ns {
            return;
        }
        while self.next_sample_ns <= until_ns {
            let at_ns = self.next_sample_ns;
            let whole_ns = (until_ns - from_ns) as f64;
            // the first angle has no predecessor to interpolate from
            let share = if whole_ns == 0.0 || from_ns == 0 { 1.0 } else { (at_ns - from_ns) as f64 / whole_ns };
            self.sample(from_rad + (angle_rad - from_rad) * share);
        }
        (self.felt_ns, self.felt_rad) = (until_ns, angle_rad);
    }

    fn sample(&mut self, angle_rad: f64) {
        let filter = usize::from(self.settings[6] & 0b11);
        let every_ns = SAMPLING_NS[usize::from(self.settings[7] & 0b11)];
        let taken = 1.0 - (-3.0 * every_ns as f64 * 1e-9 / SETTLING_S[filter]).exp();
        let filtered = self.filtered_rad.map_or(angle_rad, |before| before + (angle_rad - before) * taken);
        let deviation = NOISE_DEG[filter].to_radians() * if self.magnet == Magnet::Weak { WEAK_NOISE } else { 1.0 };
        let shown = filtered + deviation * normal(&mut self.noise);
        self.raw = match self.magnet {
            Magnet::Absent => (self.noise.next_u32() & 0xFFF) as u16,
            _ => ((shown / TAU).rem_euclid(1.0) * 4096.0) as u16 & 0xFFF,
        };
        self.filtered_rad = Some(filtered);
        self.next_sample_ns += every_ns;
    }

    /// Twelve-bit value of a pair of setting registers.
    fn position(&self, at: usize) -> u16 {
        u16::from_be_bytes([self.settings[at], self.settings[at + 1]]) & 0xFFF
    }

    /// ANGLE register: scaled from ZPOS over MANG, or up to MPOS (page 21), or the whole turn if both are 0. Without
    /// hysteresis.
    fn angle(&self) -> u16 {
        let [zero, stop, range] = [0, 2, 4].map(|at| self.position(at));
        let span = match (range, stop) {
            (0, 0) => 0,
            (0, stop) => stop.wrapping_sub(zero) & 0xFFF,
            (range, _) => range,
        };
        let beyond = self.raw.wrapping_sub(zero) & 0xFFF;
        match span {
            0 => beyond,
            span => ((u32::from(beyond) * 4096 / u32::from(span)).min(0xFFF)) as u16,
        }
    }

    /// STATUS register (figure 23).
    fn status(&self) -> u8 {
        let sampled = self.filtered_rad.is_some();
        match self.magnet {
            Magnet::Good if sampled => 0x20,
            Magnet::Weak if sampled => 0x30,
            Magnet::Strong if sampled => 0x28,
            _ => 0x10,
        }
    }

    /// AGC register at 3.3 V operation, 0 to 128 (page 20).
    const fn gain(&self) -> u8 {
        match self.magnet {
            Magnet::Good => 64,
            Magnet::Strong => 0,
            Magnet::Weak | Magnet::Absent => 128,
        }
    }

    const fn has(register: u8) -> bool {
        matches!(register, 0x00..=0x08 | 0x0B..=0x0F | 0x1A..=0x1C | 0xFF)
    }

    fn read_register(&mut self) -> u8 {
        let wide = match self.pointer {
            0x0C => Some(self.raw),
            0x0E => Some(self.angle()),
            // CORDIC magnitude, whose range the datasheet does not give: mid-scale
            0x1B => Some(2048),
            _ => None,
        };
        if let Some(value) = wide {
            self.latched = value;
            return self.latched.to_be_bytes()[0];
        }
        match self.pointer {
            0x01..=0x08 => self.settings[usize::from(self.pointer) - 1],
            0x0B => self.status(),
            0x0D | 0x0F | 0x1C => self.latched.to_be_bytes()[1],
            0x1A => self.gain(),
            // ZMCO: OTP not written. Addresses without a register read as zero (page 13).
            _ => 0,
        }
    }

    /// Increments the pointer, also past the last register; a pointer that stays returns to its upper byte.
    fn count_on(&mut self, read: bool) {
        self.pointer = match self.comes_back_to {
            Some(upper) if read && self.pointer == upper + 1 => upper,
            _ => self.pointer.wrapping_add(1),
        };
    }

    #[cold]
    fn report(&mut self, kind: MisuseKind) {
        self.misuse.report(Misuse { time_ns: self.now_ns, chip: Self::NAME, address: ADDRESS, kind });
    }
}

impl I2cChip for As5600 {
    fn acknowledges(&self, address: u8, _read: bool) -> bool {
        address == ADDRESS
    }

    fn start(&mut self, at_ns: u64, _address: u8, read: bool) {
        self.now_ns = self.now_ns.max(at_ns);
        self.transfer = if read { Transfer::Data } else { Transfer::Pointer };
    }

    fn write(&mut self, at_ns: u64, byte: u8) -> bool {
        self.now_ns = self.now_ns.max(at_ns);
        match self.transfer {
            Transfer::None => false,
            Transfer::Pointer => {
                self.transfer = Transfer::Data;
                self.pointer = byte;
                self.comes_back_to = matches!(byte, 0x0C | 0x0E | 0x1B).then_some(byte);
                if !Self::has(byte) {
                    self.report(MisuseKind::UnmappedRegister { register: byte });
                }
                Self::has(byte)
            }
            Transfer::Data => {
                let register = self.pointer;
                match register {
                    0x01..=0x08 => self.settings[usize::from(register) - 1] = byte,
                    // BURN writes the OTP memory permanently; the model reports it as an error of the driver
                    _ if Self::has(register) => self.report(MisuseKind::ReadOnlyRegister { register }),
                    _ => self.report(MisuseKind::UnmappedRegister { register }),
                }
                self.count_on(false);
                Self::has(register)
            }
        }
    }

    fn read(&mut self, at_ns: u64) -> u8 {
        self.now_ns = self.now_ns.max(at_ns);
        let byte = self.read_register();
        self.count_on(true);
        byte
    }

    fn stop(&mut self, at_ns: u64) {
        self.now_ns = self.now_ns.max(at_ns);
        self.transfer = Transfer::None;
    }
}
