//! TDK ICM-20948: accelerometer and gyroscope behind registers in four banks. Section and table numbers are those of
//! its datasheet, DS-000189, rev. 1.3. The magnetometer, the FIFO, the DMP and the auxiliary bus are not modelled:
//! their registers only store writes.
//!
//! # Measurement
//! Each axis passes a first-order low-pass with the bandwidth of the selected filter, gets white noise, is rounded to
//! counts and clipped to 16 bits, at the sample rate set by the gyroscope's divider. Noise of a sample is the noise
//! density of table 1 or 2 times the square root of the noise bandwidth, π/2 times the filter's.
//!
//! # Where the datasheet leaves room
//! - It gives bandwidths of the filters, but neither order nor delay: the first order is our choice.
//! - With both sensors on, all samples are taken at the gyroscope's rate (10.1).
//! - RAW_DATA_0_RDY of INT_STATUS_1 is set by a new sample even if its interrupt is disabled, and is cleared by reading
//!   (8.13).
//! - The chip acknowledges nothing for 11 ms after power-up, a typical value, and 100 ms after a reset, the maximum
//!   (table 3).
//! - Cross-axis sensitivity and temperature are 0; biases and scale errors are part of the input.

mod registers;
#[cfg(test)]
mod tests;

use std::f64::consts::{FRAC_PI_2, TAU};

use rand_pcg::{Pcg64, rand_core::SeedableRng};

use crate::{
    i2c::I2cChip,
    misuse::{Misuse, MisuseKind, MisuseLog},
    sensors::normal,
};
use registers::{Bank, access};

/// Time from power-up to the first access, typical (table 3), ns.
const POWER_UP_NS: u64 = 11_000_000;
/// Time from a reset to the first access, maximum (table 3), ns.
const RESET_NS: u64 = 100_000_000;
/// Undivided sample rate with the low-pass on, Hz (10.1).
const SAMPLES_HZ: f64 = 1125.0;
/// Sample rate of the gyroscope with the low-pass off, Hz (table 16).
const UNFILTERED_HZ: f64 = 9000.0;
/// Noise density of the gyroscope, °/s/√Hz (table 1), and of the accelerometer, g/√Hz (table 2).
const RATE_NOISE_DEG_S: f64 = 0.015;
const ACCELERATION_NOISE_G: f64 = 230e-6;
/// Bandwidths at -3 dB of filters 0 to 7, Hz: gyroscope (table 16) and accelerometer (table 18).
const GYRO_HZ: [f64; 8] = [196.6, 151.8, 119.5, 51.2, 23.9, 11.6, 5.7, 361.4];
const ACCEL_HZ: [f64; 8] = [246.0, 246.0, 111.4, 50.4, 23.9, 11.5, 5.7, 473.0];
/// Bandwidths with the filter off, Hz.
const GYRO_OFF_HZ: f64 = 12_106.0;
const ACCEL_OFF_HZ: f64 = 1209.0;
/// Sensitivity at the smallest full scale: counts per °/s (table 1) and per g (table 2). It halves with each larger
/// one.
const COUNTS_PER_DEG_S: f64 = 131.072;
const COUNTS_PER_G: f64 = 16_384.0;
/// Standard gravity, m/s² per g.
const STANDARD_GRAVITY: f64 = 9.806_65;

/// Motion of the chip, biases included.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Truth {
    /// Acceleration minus gravity, m/s²: +9.8 on the upward axis at rest.
    pub acceleration_m_s2: [f64; 3],
    /// Angular rates about x, y and z, rad/s.
    pub rate_rad_s: [f64; 3],
}

/// Phase of an I2C transfer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Transfer {
    /// The chip is not addressed.
    None,
    /// The next byte is the register address.
    Pointer,
    /// The next byte goes to, or comes from, the register pointed at.
    Data,
}

/// One chip on the bus, with its four banks of registers.
#[derive(Clone, Debug)]
pub struct Icm20948 {
    address: u8,
    /// Value of WHO_AM_I, which differs in another chip.
    identity: u8,
    banks: [Bank; 4],
    bank: usize,
    pointer: u8,
    transfer: Transfer,
    now_ns: u64,
    ready_at_ns: u64,

    /// Time up to which the inputs are known, and the filters' outputs: accelerations in g, rates in °/s.
    felt_ns: u64,
    filtered: [f64; 6],
    next_sample_ns: u64,
    /// True if samples have stopped, as with a broken oscillator.
    hung: bool,
    noise: Pcg64,
    misuse: MisuseLog,
}

impl Icm20948 {
    /// Name of the chip in reports.
    pub const NAME: &str = "ICM-20948";

    /// A chip just powered up, asleep, with AD0 giving the lowest bit of the 7-bit `address` (0x68 or 0x69). `seed` is
    /// that of its noise.
    #[must_use]
    pub fn new(address: u8, seed: u64) -> Self {
        Self {
            address: 0x68 | address & 1,
            identity: 0xEA,
            banks: registers::RESET,
            bank: 0,
            pointer: 0,
            transfer: Transfer::None,
            now_ns: 0,
            ready_at_ns: POWER_UP_NS,
            felt_ns: 0,
            filtered: [0.0; 6],
            next_sample_ns: u64::MAX,
            hung: false,
            noise: Pcg64::seed_from_u64(seed),
            misuse: MisuseLog::new(),
        }
    }

    /// Interrupts the supply: the chip is asleep, all registers return to those after power-up.
    pub fn power_cycle(&mut self, at_ns: u64) {
        self.reset(at_ns, POWER_UP_NS);
    }

    /// Sets the value of WHO_AM_I, as if another chip were at its address.
    pub fn set_identity(&mut self, identity: u8) {
        self.identity = identity;
    }

    /// Stops all samples, or lets them continue.
    pub fn set_hung(&mut self, hung: bool) {
        self.hung = hung;
    }

    /// Violations of the datasheet so far.
    #[must_use]
    pub const fn misuse(&self) -> &MisuseLog {
        &self.misuse
    }

    /// Advances to `until_ns` with `truth` constant since the last call: filters follow, and samples due meanwhile are
    /// taken.
    pub fn feel(&mut self, until_ns: u64, truth: Truth) {
        let inputs = inputs(truth);
        while self.next_sample_ns <= until_ns {
            let at_ns = self.next_sample_ns;
            self.filter(at_ns, inputs);
            self.sample();
            self.next_sample_ns = at_ns + self.sample_period_ns();
        }
        self.filter(until_ns, inputs);
    }

    fn filter(&mut self, until_ns: u64, inputs: [f64; 6]) {
        let dt_s = until_ns.saturating_sub(self.felt_ns) as f64 * 1e-9;
        self.felt_ns = self.felt_ns.max(until_ns);
        let shares = self.bandwidths_hz().map(|hz| 1.0 - (-TAU * hz * dt_s).exp());
        for (axis, (filtered, input)) in self.filtered.iter_mut().zip(inputs).enumerate() {
            *filtered += shares[axis / 3] * (input - *filtered);
        }
    }

    /// Bandwidths of accelerometer and gyroscope, Hz.
    fn bandwidths_hz(&self) -> [f64; 2] {
        let of = |config: u8, filters: &[f64; 8], off: f64| {
            if config & 1 == 0 { off } else { filters[usize::from(config >> 3 & 7)] }
        };
        [of(self.banks[2][0x14], &ACCEL_HZ, ACCEL_OFF_HZ), of(self.banks[2][0x01], &GYRO_HZ, GYRO_OFF_HZ)]
    }

    fn sample_period_ns(&self) -> u64 {
        let hz = if self.banks[2][0x01] & 1 == 0 {
            UNFILTERED_HZ
        } else {
            SAMPLES_HZ / (1.0 + f64::from(self.banks[2][0x00]))
        };
        (1e9 / hz).round() as u64
    }

    fn sample(&mut self) {
        if self.hung {
            return;
        }
        let [accel_hz, gyro_hz] = self.bandwidths_hz();
        let full_scale = |config: u8| f64::from(1u8 << (config >> 1 & 3));
        let accel =
            (COUNTS_PER_G / full_scale(self.banks[2][0x14]), ACCELERATION_NOISE_G * (FRAC_PI_2 * accel_hz).sqrt());
        let gyro =
            (COUNTS_PER_DEG_S / full_scale(self.banks[2][0x01]), RATE_NOISE_DEG_S * (FRAC_PI_2 * gyro_hz).sqrt());
        for axis in 0..6 {
            let (counts_per_unit, noise_rms) = if axis < 3 { accel } else { gyro };
            let drawn = normal(&mut self.noise);
            // rounded, and clipped to 16 bits (`as` saturates)
            let counts = ((self.filtered[axis] + noise_rms * drawn) * counts_per_unit).round() as i16;
            let at = 0x2D + 2 * axis;
            self.banks[0][at..at + 2].copy_from_slice(&counts.to_be_bytes());
        }
        self.banks[0][0x1A] |= 1;
    }

    fn is_asleep(&self) -> bool {
        self.banks[0][0x06] & 1 << 6 != 0
    }

    fn reset(&mut self, at_ns: u64, start_up_ns: u64) {
        self.now_ns = self.now_ns.max(at_ns);
        self.banks = registers::RESET;
        self.bank = 0;
        self.transfer = Transfer::None;
        self.next_sample_ns = u64::MAX;
        self.filtered = [0.0; 6];
        self.ready_at_ns = self.now_ns + start_up_ns;
    }

    fn write_register(&mut self, value: u8) {
        let (bank, register) = (self.bank, self.pointer);
        if register == 0x7F {
            self.bank = usize::from(value >> 4 & 3);
            return;
        }
        match access(bank, register) {
            None => return self.report(MisuseKind::UnimplementedRegister { register }),
            Some(registers::Access::Read) => return self.report(MisuseKind::ReadOnlyRegister { register }),
            Some(registers::Access::Write) => self.banks[bank][usize::from(register)] = value,
        }
        if (bank, register) == (0, 0x06) {
            if value & 1 << 7 != 0 {
                self.reset(self.now_ns, RESET_NS);
            } else if self.is_asleep() {
                self.next_sample_ns = u64::MAX;
            } else {
                self.next_sample_ns = self.next_sample_ns.min(self.now_ns + self.sample_period_ns());
            }
        }
    }

    fn read_register(&mut self) -> u8 {
        let (bank, register) = (self.bank, self.pointer);
        match (bank, register) {
            (_, 0x7F) => (bank as u8) << 4,
            (0, 0x00) => self.identity,
            _ if access(bank, register).is_none() => {
                self.report(MisuseKind::UnimplementedRegister { register });
                0
            }
            // reading INT_STATUS_1 clears it
            (0, 0x1A) => std::mem::take(&mut self.banks[0][0x1A]),
            _ => self.banks[bank][usize::from(register)],
        }
    }

    #[cold]
    fn report(&mut self, kind: MisuseKind) {
        self.misuse.report(Misuse { time_ns: self.now_ns, chip: Self::NAME, address: self.address, kind });
    }
}

/// Accelerations in g, then rates in °/s.
fn inputs(truth: Truth) -> [f64; 6] {
    let [x, y, z] = truth.acceleration_m_s2.map(|acceleration| acceleration / STANDARD_GRAVITY);
    let [p, q, r] = truth.rate_rad_s.map(f64::to_degrees);
    [x, y, z, p, q, r]
}

impl I2cChip for Icm20948 {
    fn acknowledges(&self, address: u8, _read: bool) -> bool {
        address == self.address && self.felt_ns.max(self.now_ns) >= self.ready_at_ns
    }

    fn start(&mut self, at_ns: u64, _address: u8, read: bool) {
        self.now_ns = self.now_ns.max(at_ns);
        self.transfer = if read { Transfer::Data } else { Transfer::Pointer };
    }

    fn write(&mut self, at_ns: u64, byte: u8) -> bool {
        self.now_ns = self.now_ns.max(at_ns);
        match self.transfer {
            Transfer::None => return false,
            Transfer::Pointer => {
                self.pointer = byte & 0x7F;
                self.transfer = Transfer::Data;
            }
            Transfer::Data => {
                self.write_register(byte);
                self.pointer = (self.pointer + 1) & 0x7F;
            }
        }
        true
    }

    fn read(&mut self, at_ns: u64) -> u8 {
        self.now_ns = self.now_ns.max(at_ns);
        let value = self.read_register();
        self.pointer = (self.pointer + 1) & 0x7F;
        value
    }

    fn stop(&mut self, at_ns: u64) {
        self.now_ns = self.now_ns.max(at_ns);
        self.transfer = Transfer::None;
    }
}
