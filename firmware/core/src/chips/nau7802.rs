//! Nuvoton NAU7802: force on a load cell, from the ratio of its bridge's output to its supply. Section and register
//! numbers are those of the datasheet, revision 1.7.
//!
//! The chip's own regulator feeds the bridge and is the converter's reference, so its voltage cancels out. After a
//! start the chip calibrates its offset with its inputs shorted; the bridge's own offset remains and is part of the
//! configuration.
//!
//! A reading takes two transfers: status (conversion ended), then three data bytes. The status also shows whether the
//! chip still has its settings: a chip that lost its supply is set up again.

use embassy_time::Duration;
use r4_protocol::{
    channel::MAX_QUANTITIES,
    config::{NAU7802_FULL_SCALE_MV_V, NAU7802_RATES_HZ, Nau7802Config},
};

use super::sensor::{Driver, Exchange, Outcome, saturation};

// Registers (section 10).
const PU_CTRL: u8 = 0x00;
const CTRL1: u8 = 0x01;
const CTRL2: u8 = 0x02;
const ADCO_B2: u8 = 0x12;
const ADC: u8 = 0x15;
const POWER: u8 = 0x1C;
const REVISION: u8 = 0x1F;

// PU_CTRL (11.1).
const RR: u8 = 1 << 0;
const PUD: u8 = 1 << 1;
const PUA: u8 = 1 << 2;
const PUR: u8 = 1 << 3;
const CS: u8 = 1 << 4;
const CR: u8 = 1 << 5;
const AVDDS: u8 = 1 << 7;
/// PU_CTRL: analog and digital part on, fed by the chip's regulator, converting.
const ON: u8 = AVDDS | CS | PUA | PUD;

/// CTRL1: the regulator gives 3.0 V, the highest that a supply of 3.3 V allows.
const VLDO_3_0_V: u8 = 0b101 << 3;
/// CTRL2: calibrate the offset with the inputs shorted (CALMOD 00).
const CALS: u8 = 1 << 2;
const CAL_ERR: u8 = 1 << 3;
const CRS_AT: u8 = 4;
/// CRS codes of [`NAU7802_RATES_HZ`], in the same order.
const CRS: [u8; NAU7802_RATES_HZ.len()] = [0b000, 0b001, 0b010, 0b011, 0b111];
/// ADC: the chopper's clock off, as the start-up sequence says (9.1).
const CHOPPER_OFF: u8 = 0b11 << 4;
/// POWER: the capacitor at the second input's pins filters the first (9.4).
const PGA_CAPACITOR: u8 = 1 << 7;
/// REVISION: value of its lower four bits.
const REVISION_CODE: u8 = 0x0F;

/// Time from power-up to PUR: about 200 us (9.1).
const START_UP: Duration = Duration::from_millis(1);
/// Start-up time of the regulator. It depends on the capacitor; a published board's library waits 200 ms. Our choice.
const REGULATOR: Duration = Duration::from_millis(250);
/// Interval and number of polls for the end of the calibration: the datasheet gives no time, and users have measured
/// 344 ms.
const CALIBRATION_LOOK: Duration = Duration::from_millis(100);
const CALIBRATION_LOOKS: u8 = 50;
/// Conversions after a start that still contain older input: as many as Linux's driver discards
/// (`NAU7802_MIN_CONVERSIONS`).
const SETTLING: u32 = 6;

/// Full scale in counts, in either direction: 24 bits, two's complement.
const FULL_SCALE: f32 = 8_388_608.0;
/// Share of the full scale from which on the converter may be saturated: the calibration is subtracted behind it
/// (8.6.2).
const SATURATED: f32 = 0.995;

/// Step of the driver: the transfer that follows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Reset,
    PowerDigital,
    Ready,
    Revision,
    Set,
    Chopper,
    Capacitor,
    PowerAnalog,
    Calibrate,
    /// Number of polls of the status so far.
    Calibrating(u8),
    Check,
    Status,
    Conversion,
}

/// Driver of one NAU7802.
#[derive(Clone, Debug)]
pub struct Nau7802 {
    state: State,
    /// Settings for CTRL1 and CTRL2.
    settings: [u8; 2],
    settling: Duration,
    /// Scale of the reading, N per count.
    newtons_per_count: f32,
    /// Counts without any force.
    zero: f32,
}

impl Nau7802 {
    /// Creates a driver for `rate_hz` conversions per second, one of [`NAU7802_RATES_HZ`].
    #[must_use]
    pub fn new(config: &Nau7802Config, rate_hz: u16) -> Self {
        let rate = NAU7802_RATES_HZ.iter().position(|known| *known >= rate_hz).unwrap_or(NAU7802_RATES_HZ.len() - 1);
        let gain = config.gain.max(1);
        let mv_v_per_count = NAU7802_FULL_SCALE_MV_V / f32::from(gain) / FULL_SCALE;
        Self {
            state: State::Reset,
            settings: [VLDO_3_0_V | gain.trailing_zeros() as u8 & 0b111, CRS[rate] << CRS_AT],
            settling: Duration::from_hz(u64::from(NAU7802_RATES_HZ[rate])) * SETTLING,
            newtons_per_count: config.newtons_per_mv_v * mv_v_per_count,
            zero: config.zero_mv_v / mv_v_per_count,
        }
    }

    fn reading(&self, bytes: [u8; 3]) -> Outcome {
        let code = i32::from_be_bytes([bytes[0], bytes[1], bytes[2], 0]) >> 8;
        // 24 bits are exact in f32.
        let code = code as f32;
        let mut values = [0.0; MAX_QUANTITIES];
        values[0] = (code - self.zero) * self.newtons_per_count;
        Outcome::Reading { values, quality: saturation(code.abs() > SATURATED * FULL_SCALE) }
    }
}

impl Driver for Nau7802 {
    fn restart(&mut self) {
        self.state = State::Reset;
    }

    fn next(&self) -> Exchange {
        let [ctrl1, ctrl2] = self.settings;
        match self.state {
            State::Reset => Exchange::set(PU_CTRL, RR),
            State::PowerDigital => Exchange::set(PU_CTRL, PUD),
            State::Ready | State::Status => Exchange::get(PU_CTRL, 1),
            State::Revision => Exchange::get(REVISION, 1),
            State::Set => Exchange::set_both(CTRL1, [ctrl1, ctrl2]),
            State::Chopper => Exchange::set(ADC, CHOPPER_OFF),
            State::Capacitor => Exchange::set(POWER, PGA_CAPACITOR),
            State::PowerAnalog => Exchange::set(PU_CTRL, ON),
            State::Calibrate => Exchange::set(CTRL2, ctrl2 | CALS),
            State::Calibrating(_) => Exchange::get(CTRL2, 1),
            State::Check => Exchange::get(PU_CTRL, 3),
            State::Conversion => Exchange::get(ADCO_B2, 3),
        }
    }

    fn done(&mut self, read: &[u8]) -> Outcome {
        let is_on = |pu_ctrl: u8| pu_ctrl & !CR == ON | PUR;
        let (state, outcome) = match (self.state, read) {
            (State::Reset, _) => (State::PowerDigital, Outcome::Next),
            (State::PowerDigital, _) => (State::Ready, Outcome::Wait(START_UP)),
            (State::Ready, [status]) if status & PUR != 0 => (State::Revision, Outcome::Next),
            (State::Revision, [revision]) if revision & 0x0F == REVISION_CODE => (State::Set, Outcome::Next),
            (State::Set, _) => (State::Chopper, Outcome::Next),
            (State::Chopper, _) => (State::Capacitor, Outcome::Next),
            (State::Capacitor, _) => (State::PowerAnalog, Outcome::Next),
            (State::PowerAnalog, _) => (State::Calibrate, Outcome::Wait(REGULATOR)),
            (State::Calibrate, _) => (State::Calibrating(0), Outcome::Wait(CALIBRATION_LOOK)),
            (State::Calibrating(looks @ 0..CALIBRATION_LOOKS), [ctrl2]) if ctrl2 & CALS != 0 => {
                (State::Calibrating(looks + 1), Outcome::Wait(CALIBRATION_LOOK))
            }
            (State::Calibrating(_), [ctrl2]) if ctrl2 & (CALS | CAL_ERR) == 0 => {
                (State::Check, Outcome::Wait(self.settling))
            }
            (State::Check, [status, settings @ ..]) if is_on(*status) && *settings == self.settings => {
                (State::Status, Outcome::Next)
            }
            (State::Status, [status]) if is_on(*status) && status & CR != 0 => (State::Conversion, Outcome::Next),
            (State::Status, [status]) if is_on(*status) => (State::Status, Outcome::NotReady),
            (State::Conversion, &[high, middle, low]) => (State::Status, self.reading([high, middle, low])),
            _ => (State::Reset, Outcome::WrongChip),
        };
        self.state = state;
        outcome
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use r4_protocol::{Quality, config::SensorChip};

    use super::{
        super::sensor::tests::{Taken, taken},
        *,
    };

    const CONFIG: Nau7802Config = Nau7802Config { gain: 128, newtons_per_mv_v: 24.5, zero_mv_v: 0.25 };

    /// The bus schedule relies on the transfer lengths in the configuration's chip description.
    #[test]
    fn transfers_are_as_long_as_the_board_plans_them() {
        let planned = SensorChip::Nau7802(CONFIG).description();
        let taken = taken(&mut Nau7802::new(&CONFIG, 80), |driver| match driver.state {
            State::Ready => [PUR].into(),
            State::Revision => [REVISION_CODE].into(),
            State::Calibrating(_) => [driver.settings[1]].into(),
            State::Check => [ON | PUR, driver.settings[0], driver.settings[1]].into(),
            State::Status => [ON | PUR | CR].into(),
            State::Conversion => [0; 3].into(),
            _ => [].into(),
        });
        assert_eq!(taken, Taken::planned(&planned));
    }

    /// A full scale of 3.90625 mV/V is 2^23 counts; 0.25 mV/V of it are the bridge's own offset.
    #[test]
    fn a_code_is_a_force_by_gain_bridge_and_zero() {
        let driver = Nau7802::new(&CONFIG, 80);
        for (bytes, newtons, quality) in [
            ([0, 0, 0], -0.25 * 24.5, Quality::Good),
            ([0x08, 0x31, 0x27], 0.0, Quality::Good),
            ([0x40, 0, 0], (1.953_125 - 0.25) * 24.5, Quality::Good),
            ([0xC0, 0, 0], (-1.953_125 - 0.25) * 24.5, Quality::Good),
            ([0x7F, 0xFF, 0xFF], (3.906_25 - 0.25) * 24.5, Quality::Saturated),
            ([0x80, 0, 0], (-3.906_25 - 0.25) * 24.5, Quality::Saturated),
        ] {
            let Outcome::Reading { values, quality: told } = driver.reading(bytes) else { panic!("a reading") };
            assert_eq!(told, quality, "{bytes:?}");
            // Rounding of f32 at 90 N, and half a count of 11.4 uN.
            assert!((values[0] - newtons).abs() < 3e-5, "{bytes:?}: {} N, not {newtons} N", values[0]);
        }
    }

    /// A calibration that does not end, or ends with an error, does not keep the driver waiting indefinitely.
    #[test]
    fn a_calibration_ends_or_the_chip_is_given_up() {
        let mut driver = Nau7802::new(&CONFIG, 80);
        driver.state = State::Calibrating(0);
        for _ in 0..CALIBRATION_LOOKS {
            assert_eq!(driver.done(&[CALS]), Outcome::Wait(CALIBRATION_LOOK));
        }
        assert_eq!(driver.done(&[CALS]), Outcome::WrongChip);
        driver.state = State::Calibrating(3);
        assert_eq!((driver.done(&[CAL_ERR]), driver.state), (Outcome::WrongChip, State::Reset));
    }
}
