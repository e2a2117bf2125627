//! Nuvoton NAU7802: a bridge's ratio, behind an amplifier and a converter of 24 bits. Section and page numbers are those of its datasheet,
//! revision 1.7.
//!
//! # What it measures
//! The bridge is fed by AVDD, which is the converter's reference too: the code is the ratio that the bridge puts out, times the gain, in
//! parts of half the reference. What the chip adds are an offset and white noise, both volts at its input. A filter of fourth order lies
//! over the last four periods; a step of the force is converted in full four conversions later, and so is one behind a change of the gain.
//!
//! # Where the datasheet leaves room
//! - The filter: that of the converters of this kind that settle in four conversions, a sinc of fourth order. Its weights are those for an
//!   input that is constant within each period, and its past is 0 when conversions begin.
//! - Offset and noise are from memory of the figures on pages 7 and 11; the noise rises with the root of the rate. Gain error and
//!   non-linearity are 0.
//! - A calibration takes 344 ms at any rate, as users of a published library have measured, and no conversion ends meanwhile.
//! - The regulator comes up with a time constant of 40 ms. Nothing else feeds AVDD: without it there is no reference and no conversion.
//!   One that is set above what DVDD leaves, 0.3 V less than 3.3 V, gives that much.
//! - CR goes with the last of the three bytes of a conversion. These are of one conversion if they come in one transfer.
//! - Temperature sensor, second channel, external clock and the low-power bits are not modelled: their bits hold what is written.

#[cfg(test)]
mod tests;

use rand_pcg::{Pcg64, rand_core::SeedableRng};

use crate::{
    i2c::I2cChip,
    misuse::{Misuse, MisuseKind, MisuseLog},
    sensors::normal,
};

const ADDRESS: u8 = 0x2A;
/// Half of 24 bits: full scale.
const HALF: f64 = 8_388_608.0;
/// Of a conversion, by CRS, ns; 0 for codes that are reserved.
const PERIOD_NS: [u64; 8] = [100_000_000, 50_000_000, 25_000_000, 12_500_000, 0, 0, 0, 3_125_000];
/// Of the last four periods, newest first: a cubic spline's shares.
const FILTER: [f64; 4] = [1.0 / 24.0, 11.0 / 24.0, 11.0 / 24.0, 1.0 / 24.0];
/// From PUD to PUR (9.1), ns.
const POWER_UP_NS: u64 = 200_000;
const CALIBRATION_NS: u64 = 344_000_000;
const REGULATOR_S: f64 = 0.04;
/// DVDD less what the regulator needs, V.
const AVDD_MAX_V: f64 = 3.0;
/// At the input, V.
const OFFSET_V: f64 = 20e-6;
/// Noise at the input at 10 conversions a second: of the amplifier, and of the converter behind it, V rms.
const NOISE_V: [f64; 2] = [50e-9, 1.5e-6];
/// Largest gain that can be calibrated (8.6.3).
const GAIN_MAX: f64 = 256.0;

// Places of what the chip itself needs.
const PU_CTRL: usize = 0x00;
const CTRL1: usize = 0x01;
const CTRL2: usize = 0x02;
const OCAL1: usize = 0x03;
const GCAL1: usize = 0x06;

/// Where the chip is in a transfer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Transfer {
    None,
    Pointer,
    Data,
}

/// One chip.
#[derive(Clone, Debug)]
pub struct Nau7802 {
    registers: [u8; 0x20],
    revision: u8,
    pointer: u8,
    transfer: Transfer,
    /// The newest conversion, and that of which bytes are being read.
    converted: i32,
    latched: [u8; 3],
    is_ready: bool,
    now_ns: u64,

    /// When the digital part was powered, and the regulator.
    digital_ns: u64,
    regulator_ns: u64,
    /// When the calibration under way ends.
    calibrated_ns: Option<u64>,

    /// Up to when its input is known, and what that came to in the period under way, mV/V s.
    felt_ns: u64,
    felt_mv_v_s: f64,
    period_from_ns: u64,
    /// Of full scale behind the amplifier, the last four periods, newest first.
    past: [f64; 4],
    /// Noise of what is in front of the chip, mV/V rms of a conversion.
    source_noise_mv_v: f64,
    /// Conversions never end, as with a broken oscillator.
    hung: bool,
    noise: Pcg64,
    misuse: MisuseLog,
}

impl Nau7802 {
    /// What it is called in reports.
    pub const NAME: &str = "NAU7802";

    /// A chip just powered. Its noise is drawn from `seed`.
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

    /// All registers as after power-up (section 10): gains of 1, everything else 0, and off.
    fn reset(&mut self) {
        self.registers = [0; 0x20];
        self.registers[GCAL1 + 1] = 0x80;
        self.registers[0x0D + 1] = 0x80;
        (self.converted, self.is_ready, self.calibrated_ns) = (0, false, None);
        self.begin_period(self.felt_ns);
        self.past = [0.0; 4];
    }

    /// Takes the supply away and returns it.
    pub fn power_cycle(&mut self) {
        self.reset();
        (self.pointer, self.transfer) = (0, Transfer::None);
    }

    /// Another chip is at its address.
    pub fn set_revision(&mut self, revision: u8) {
        self.revision = revision;
    }

    /// From now on no conversion ends, or they do again.
    pub fn set_hung(&mut self, hung: bool) {
        self.hung = hung;
    }

    /// What is in front of it is noisy: standard deviation of a conversion, mV/V.
    pub fn set_source_noise_mv_v(&mut self, noise_mv_v: f64) {
        self.source_noise_mv_v = noise_mv_v;
    }

    /// Up to when its input is known, ns.
    #[must_use]
    pub const fn felt_ns(&self) -> u64 {
        self.felt_ns
    }

    /// What was done to the chip against its datasheet.
    #[must_use]
    pub const fn misuse(&self) -> &MisuseLog {
        &self.misuse
    }

    /// The bridge has put out `mv_v` since the last call, mV/V, up to `until_ns`: conversions end that were due meanwhile.
    pub fn feel(&mut self, until_ns: u64, mv_v: f64) {
        if until_ns < self.felt_ns {
            return;
        }
        if let Some(end_ns) = self.calibrated_ns.filter(|end_ns| *end_ns <= until_ns && self.is_converting()) {
            self.calibrated_ns = None;
            self.calibrate(end_ns, mv_v);
            self.felt_ns = self.felt_ns.max(end_ns);
            self.begin_period(end_ns);
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

    /// A period has ended.
    fn convert(&mut self, at_ns: u64, period_ns: u64) {
        let mean_mv_v = self.felt_mv_v_s / (period_ns as f64 * 1e-9);
        self.past.rotate_right(1);
        self.past[0] = self.amplified(at_ns, mean_mv_v);
        let filtered: f64 = self.past.iter().zip(FILTER).map(|(past, weight)| past * weight).sum();
        let noise = self.noise_of_full_scale(at_ns, period_ns) * normal(&mut self.noise);
        let measured = ((filtered + noise) * HALF).clamp(-HALF, HALF);
        // Page 21.
        let output = self.gain_calibration() * (measured - self.offset_calibration());
        self.converted = output.round().clamp(-HALF, HALF - 1.0) as i32;
        self.is_ready = true;
    }

    /// What the bridge puts out and the chip's own offset, behind the amplifier, in parts of full scale, which it cannot pass.
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

    /// By VLDO (11.2): 4.5 V less 0.3 V for each step.
    fn avdd_v(&self, at_ns: u64) -> f64 {
        let set_v = 4.5 - 0.3 * f64::from(self.registers[CTRL1] >> 3 & 0b111);
        let up_s = at_ns.saturating_sub(self.regulator_ns) as f64 * 1e-9;
        // Never quite 0, which would be no reference.
        set_v.min(AVDD_MAX_V) * (1.0 - (-up_s / REGULATOR_S).exp()).max(1e-3)
    }

    /// Sign and magnitude, counts.
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

    /// In parts of 2^23.
    fn gain_calibration(&self) -> f64 {
        let bytes = [0, 1, 2, 3].map(|at| self.registers[GCAL1 + at]);
        f64::from(u32::from_be_bytes(bytes)) / HALF
    }

    /// 8.6: by CALMOD, of the offset with the inputs shorted or of what is there, or of the gain.
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

    /// Powered, with a reference, started and not hung.
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
                // CAL_ERR is read only.
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
        // PUR and CR are read only.
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
