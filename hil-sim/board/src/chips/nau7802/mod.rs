//! Nuvoton NAU7802: bridge amplifier and 24-bit converter. Section and page numbers are those of its datasheet,
//! revision 1.7.
//!
//! # Measurement
//! AVDD feeds the bridge and is also the converter's reference: the code is the bridge's output ratio times the gain,
//! in units of half the reference. The chip adds an offset and white noise, both volts at its input. A fourth-order
//! filter covers the last four periods, so a step of the force is converted in full four conversions later, and so is a
//! change of the gain.
//!
//! # Where the datasheet leaves room
//! - The filter is the usual one of converters that settle in four conversions, a sinc of fourth order. Its weights are
//!   those for an input that is constant within each period, and its history is 0 when conversions start.
//! - Offset and noise are quoted from memory of the figures on pages 7 and 11; the noise rises with the square root of
//!   the rate. Gain error and non-linearity are 0.
//! - A calibration takes 344 ms at any rate, as users of a published library have measured, and no conversion ends
//!   meanwhile.
//! - The regulator starts with a time constant of 40 ms. Nothing else feeds AVDD: without it there is no reference and
//!   no conversion. A setting above the limit by DVDD, 3.3 V minus 0.3 V, gives that limit.
//! - CR is cleared with the last of the three bytes of a conversion. The bytes belong to one conversion if they are
//!   read in one transfer.
//! - Temperature sensor, second channel, external clock and the low-power bits are not modelled: their bits only store
//!   writes.

#[cfg(test)]
mod tests;

use rand_pcg::{Pcg64, rand_core::SeedableRng};

use crate::{
    i2c::I2cChip,
    misuse::{Misuse, MisuseKind, MisuseLog},
    sensors::normal,
};

const ADDRESS: u8 = 0x2A;
/// Full scale, half of 24 bits, counts.
const HALF: f64 = 8_388_608.0;
/// Duration of a conversion by CRS, ns; 0 for reserved codes.
const PERIOD_NS: [u64; 8] = [100_000_000, 50_000_000, 25_000_000, 12_500_000, 0, 0, 0, 3_125_000];
/// Filter weights of the last four periods, newest first: those of a cubic spline.
const FILTER: [f64; 4] = [1.0 / 24.0, 11.0 / 24.0, 11.0 / 24.0, 1.0 / 24.0];
/// Time from PUD to PUR (9.1), ns.
const POWER_UP_NS: u64 = 200_000;
const CALIBRATION_NS: u64 = 344_000_000;
const REGULATOR_S: f64 = 0.04;
/// Largest AVDD: DVDD minus the regulator's drop-out, V.
const AVDD_MAX_V: f64 = 3.0;
/// Offset voltage at the input, V.
const OFFSET_V: f64 = 20e-6;
/// Noise at the input at 10 conversions a second, V rms: of the amplifier, and of the converter behind it.
const NOISE_V: [f64; 2] = [50e-9, 1.5e-6];
/// Largest gain that can be calibrated (8.6.3).
const GAIN_MAX: f64 = 256.0;

// Registers that the model itself interprets.
const PU_CTRL: usize = 0x00;
const CTRL1: usize = 0x01;
const CTRL2: usize = 0x02;
const OCAL1: usize = 0x03;
const GCAL1: usize = 0x06;

/// Phase of an I2C transfer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Transfer {
    None,
    Pointer,
    Data,
}

/// Simulated chip with its registers.
#[derive(Clone, Debug)]
pub struct Nau7802 {
    registers: [u8; 0x20],
    revision: u8,
    pointer: u8,
    transfer: Transfer,
    /// Newest conversion, and the one whose bytes are being read.
    converted: i32,
    latched: [u8; 3],
    is_ready: bool,
    now_ns: u64,

    /// Times at which the digital part and the regulator were powered up, ns.
    digital_ns: u64,
    regulator_ns: u64,
    /// End of the calibration in progress, ns.
    calibrated_ns: Option<u64>,

    /// Time up to which the input is known, and its integral over the present period, mV/V s.
    felt_ns: u64,
    felt_mv_v_s: f64,
    period_from_ns: u64,
    /// Inputs of the last four periods as a share of full scale behind the amplifier, newest first.
    past: [f64; 4],
    /// Noise of the source at the input, mV/V rms per conversion.
    source_noise_mv_v: f64,
    /// True if conversions never end, as with a broken oscillator.
    hung: bool,
    noise: Pcg64,
    misuse: MisuseLog,
}

impl Nau7802 {
    /// Name of the chip in reports.
    pub const NAME: &str = "NAU7802";

    /// A chip just powered up. `seed` is that of its noise.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        let mut chip = Self {
            registers: [0; 0x20],
            revision: 0x0F,
            pointer: 0,
            transfer: Transfer::None,
            converted: 0,
            latched: [0; 3],
            is_ready: false,
            now_ns: 0,
            digital_ns: 0,
            regulator_ns: 0,
            calibrated_ns: None,
            felt_ns: 0,
            felt_mv_v_s: 0.0,
            period_from_ns: 0,
            past: [0.0; 4],
            source_noise_mv_v: 0.0,
            hung: false,
            noise: Pcg64::seed_from_u64(seed),
            misuse: MisuseLog::new(),
        };
        chip.reset();
        chip
    }

    /// Sets all registers to those after power-up (section 10): gains of 1, everything else 0, and off.
    fn reset(&mut self) {
        self.registers = [0; 0x20];
        self.registers[GCAL1 + 1] = 0x80;
        self.registers[0x0D + 1] = 0x80;
        (self.converted, self.is_ready, self.calibrated_ns) = (0, false, None);
        self.begin_period(self.felt_ns);
        self.past = [0.0; 4];
    }

    /// Interrupts the supply of the chip.
    pub fn power_cycle(&mut self) {
        self.reset();
        (self.pointer, self.transfer) = (0, Transfer::None);
    }

    /// Sets the revision code, as if another chip were at its address.
    pub fn set_revision(&mut self, revision: u8) {
        self.revision = revision;
    }

    /// Stops all conversions, or lets them continue.
    pub fn set_hung(&mut self, hung: bool) {
        self.hung = hung;
    }

    /// Sets the noise of the source, standard deviation per conversion, mV/V.
    pub fn set_source_noise_mv_v(&mut self, noise_mv_v: f64) {
        self.source_noise_mv_v = noise_mv_v;
    }

    /// Time up to which the input is known, ns.
    #[must_use]
    pub const fn felt_ns(&self) -> u64 {
        self.felt_ns
    }

    /// Violations of the datasheet so far.
    #[must_use]
    pub const fn misuse(&self) -> &MisuseLog {
        &self.misuse
    }

    /// Advances to `until_ns` with the bridge at `mv_v`, mV/V, since the last call, and completes conversions due
    /// meanwhile.
    pub fn feel(&mut self, until_ns: u64, mv_v: f64) {
        if until_ns < self.felt_ns {
            return;
        }
        if let Some(end_ns) = self.calibrated_ns.filter(|end_ns| *end_ns <= until_ns && self.is_converting()) {
            self.calibrated_ns = None;
            self.calibrate(end_ns, mv_v);
            self.felt_ns = self.felt_ns.max(end_ns);
            self.begin_period(end_ns);
            // no conversion from before the calibration stays in the filter
            self.past = [0.0; 4];
        }
        let Some(period_ns) = self.period_ns() else {
            self.felt_ns = until_ns;
            self.begin_period(until_ns);
            return;
        };
        while self.period_from_ns + period_ns <= until_ns {
            let end_ns = self.period_from_ns + period_ns;
            self.integrate(end_ns, mv_v);
            self.convert(end_ns, period_ns);
            self.begin_period(end_ns);
        }
        self.integrate(until_ns, mv_v);
    }

    fn integrate(&mut self, until_ns: u64, mv_v: f64) {
        self.felt_mv_v_s += mv_v * until_ns.saturating_sub(self.felt_ns) as f64 * 1e-9;
        self.felt_ns = self.felt_ns.max(until_ns);
    }

    fn begin_period(&mut self, at_ns: u64) {
        (self.period_from_ns, self.felt_mv_v_s) = (at_ns, 0.0);
    }

    /// Completes a conversion at the end of a period.
    fn convert(&mut self, at_ns: u64, period_ns: u64) {
        let mean_mv_v = self.felt_mv_v_s / (period_ns as f64 * 1e-9);
        self.past.rotate_right(1);
        self.past[0] = self.amplified(at_ns, mean_mv_v);
        let filtered: f64 = self.past.iter().zip(FILTER).map(|(past, weight)| past * weight).sum();
        let noise = self.noise_of_full_scale(at_ns, period_ns) * normal(&mut self.noise);
        let measured = ((filtered + noise) * HALF).clamp(-HALF, HALF);
        // conversion formula of page 21
        let output = self.gain_calibration() * (measured - self.offset_calibration());
        self.converted = output.round().clamp(-HALF, HALF - 1.0) as i32;
        self.is_ready = true;
    }

    /// Output of the amplifier for the bridge's ratio and the chip's offset, as a share of full scale, clipped to ±1.
    fn amplified(&self, at_ns: u64, mv_v: f64) -> f64 {
        let avdd_v = self.avdd_v(at_ns);
        let input_v = mv_v * 1e-3 * avdd_v + OFFSET_V;
        (input_v * self.gain() / (0.5 * avdd_v)).clamp(-1.0, 1.0)
    }

    fn noise_of_full_scale(&self, at_ns: u64, period_ns: u64) -> f64 {
        let [amplifier_v, converter_v] = NOISE_V;
        let faster = (PERIOD_NS[0] as f64 / period_ns as f64).sqrt();
        let own_v = amplifier_v.hypot(converter_v / self.gain()) * faster;
        let own = own_v / (0.5 * self.avdd_v(at_ns));
        own.hypot(self.source_noise_mv_v * 1e-3 / 0.5) * self.gain()
    }

    fn gain(&self) -> f64 {
        f64::from(1_u8 << (self.registers[CTRL1] & 0b111))
    }

    /// Voltage of AVDD by VLDO (11.2): 4.5 V minus 0.3 V per step.
    fn avdd_v(&self, at_ns: u64) -> f64 {
        let set_v = 4.5 - 0.3 * f64::from(self.registers[CTRL1] >> 3 & 0b111);
        let up_s = at_ns.saturating_sub(self.regulator_ns) as f64 * 1e-9;
        // never 0, which would be no reference
        set_v.min(AVDD_MAX_V) * (1.0 - (-up_s / REGULATOR_S).exp()).max(1e-3)
    }

    /// Offset calibration, counts, stored as sign and magnitude.
    fn offset_calibration(&self) -> f64 {
        let [high, middle, low] = [0, 1, 2].map(|at| self.registers[OCAL1 + at]);
        let magnitude = f64::from(u32::from_be_bytes([0, high & 0x7F, middle, low]));
        if high & 0x80 != 0 { -magnitude } else { magnitude }
    }

    fn set_offset_calibration(&mut self, counts: f64) {
        let [_, high, middle, low] = (counts.abs().round().min(HALF - 1.0) as u32).to_be_bytes();
        let sign = if counts < 0.0 { 0x80 } else { 0 };
        self.registers[OCAL1..OCAL1 + 3].copy_from_slice(&[high | sign, middle, low]);
    }

    /// Gain calibration factor, stored in units of 2^-23.
    fn gain_calibration(&self) -> f64 {
        let bytes = [0, 1, 2, 3].map(|at| self.registers[GCAL1 + at]);
        f64::from(u32::from_be_bytes(bytes)) / HALF
    }

    /// Starts a calibration (8.6): by CALMOD, of the offset with shorted inputs or with the present input, or of the
    /// gain.
    fn calibrate(&mut self, at_ns: u64, mv_v: f64) {
        let measured = self.amplified(at_ns, mv_v) * HALF;
        let mut failed = false;
        match self.registers[CTRL2] & 0b11 {
            0b00 => self.set_offset_calibration(self.amplified(at_ns, 0.0) * HALF),
            0b10 => self.set_offset_calibration(measured),
            0b11 => {
                let gain = HALF / (measured - self.offset_calibration());
                failed = !(0.0..=GAIN_MAX).contains(&gain);
                if !failed {
                    let bytes = ((gain * HALF).round() as u32).to_be_bytes();
                    self.registers[GCAL1..GCAL1 + 4].copy_from_slice(&bytes);
                }
            }
            _ => {}
        }
        self.registers[CTRL2] &= 0b1111_0011;
        self.registers[CTRL2] |= u8::from(failed) << 3;
    }

    /// True if powered, with a reference, started and not hung.
    fn is_converting(&self) -> bool {
        const ON: u8 = 0x96;
        self.registers[PU_CTRL] & (ON | 1) == ON && !self.hung
    }

    fn period_ns(&self) -> Option<u64> {
        let period_ns = PERIOD_NS[usize::from(self.registers[CTRL2] >> 4 & 0b111)];
        (self.is_converting() && self.calibrated_ns.is_none() && period_ns > 0).then_some(period_ns)
    }

    const fn has(register: u8) -> bool {
        matches!(register, 0x00..=0x17 | 0x1B | 0x1C | 0x1F)
    }

    fn read_register(&mut self) -> u8 {
        let register = self.pointer;
        match register {
            0x00 => {
                let control = self.registers[PU_CTRL];
                let is_up = control & 1 << 1 != 0 && self.now_ns >= self.digital_ns + POWER_UP_NS;
                control | u8::from(is_up) << 3 | u8::from(self.is_ready) << 5
            }
            0x12 => {
                let [_, bytes @ ..] = self.converted.to_be_bytes();
                self.latched = bytes;
                self.latched[0]
            }
            0x13 => self.latched[1],
            0x14 => {
                self.is_ready = false;
                self.latched[2]
            }
            0x1F => self.revision,
            _ if Self::has(register) => self.registers[usize::from(register)],
            _ => {
                self.report(MisuseKind::UnimplementedRegister { register });
                0
            }
        }
    }

    fn write_register(&mut self, value: u8) {
        let register = self.pointer;
        match register {
            0x00 => self.write_control(value),
            0x02 => {
                let before = self.registers[CTRL2];
                // CAL_ERR is read-only
                self.registers[CTRL2] = value & !(1 << 3) | before & 1 << 3;
                if value & 1 << 2 != 0 {
                    self.calibrated_ns = Some(self.now_ns + CALIBRATION_NS);
                } else {
                    self.calibrated_ns = None;
                }
                if (value ^ before) & 0xF4 != 0 {
                    self.is_ready = false;
                    self.begin_period(self.felt_ns);
                }
            }
            0x12..=0x14 | 0x16 | 0x17 | 0x1F => self.report(MisuseKind::ReadOnlyRegister { register }),
            _ if Self::has(register) => self.registers[usize::from(register)] = value,
            _ => self.report(MisuseKind::UnimplementedRegister { register }),
        }
    }

    fn write_control(&mut self, value: u8) {
        let before = self.registers[PU_CTRL];
        if value & 1 != 0 {
            self.reset();
        }
        let rises = |bit: u8| value & !before & 1 << bit != 0;
        if rises(1) {
            self.digital_ns = self.now_ns;
        }
        if rises(7) {
            self.regulator_ns = self.now_ns;
        }
        if rises(4) {
            self.is_ready = false;
            self.begin_period(self.felt_ns.max(self.now_ns));
            self.felt_ns = self.felt_ns.max(self.now_ns);
            self.past = [0.0; 4];
        }
        // PUR and CR are read-only
        self.registers[PU_CTRL] = value & 0b1101_0111;
    }

    #[cold]
    fn report(&mut self, kind: MisuseKind) {
        self.misuse.report(Misuse { time_ns: self.now_ns, chip: Self::NAME, address: ADDRESS, kind });
    }
}

impl I2cChip for Nau7802 {
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
                (self.transfer, self.pointer) = (Transfer::Data, byte);
                true
            }
            Transfer::Data => {
                self.write_register(byte);
                self.pointer = self.pointer.wrapping_add(1);
                true
            }
        }
    }

    fn read(&mut self, at_ns: u64) -> u8 {
        self.now_ns = self.now_ns.max(at_ns);
        let byte = self.read_register();
        self.pointer = self.pointer.wrapping_add(1);
        byte
    }

    fn stop(&mut self, at_ns: u64) {
        self.now_ns = self.now_ns.max(at_ns);
        self.transfer = Transfer::None;
    }
}
