//! TDK ICM-20948 inertial sensor: three accelerations and three angular rates. Section and table numbers are those of
//! its datasheet, DS-000189, rev. 1.3.

use core::f32::consts::PI;

use embassy_time::Duration;
use r4_protocol::{channel::MAX_QUANTITIES, config::Icm20948Config};

use super::sensor::{Driver, Exchange, Outcome, saturation};

/// Bank selection register, present in every bank (7.1): bits 5 and 4 are the bank.
const REG_BANK_SEL: u8 = 0x7F;
// Bank 0 (8).
const WHO_AM_I: u8 = 0x00;
const PWR_MGMT_1: u8 = 0x06;
const INT_STATUS_1: u8 = 0x1A;
const ACCEL_XOUT_H: u8 = 0x2D;
// Bank 2 (10).
const GYRO_SMPLRT_DIV: u8 = 0x00;
const GYRO_CONFIG_1: u8 = 0x01;
const ACCEL_SMPLRT_DIV_1: u8 = 0x10;
const ACCEL_CONFIG: u8 = 0x14;

const BANK_0: u8 = 0 << 4;
const BANK_2: u8 = 2 << 4;
/// Value of WHO_AM_I (8.1).
const IDENTITY: u8 = 0xEA;
/// PWR_MGMT_1: reset, after which all registers are as after power-up.
const DEVICE_RESET: u8 = 1 << 7;
/// PWR_MGMT_1: awake, on the best available clock.
const CLOCK_BEST: u8 = 1;
/// INT_STATUS_1: a complete sample is in its registers.
const RAW_DATA_0_RDY: u8 = 1;
/// GYRO_CONFIG_1 and ACCEL_CONFIG: the low-pass filter is on.
const FILTERED: u8 = 1;

/// Longest start-up time for register access (table 3).
const START_UP: Duration = Duration::from_millis(100);
/// Time from sleep to valid rates: typically 35 ms (table 1).
const GYRO_START_UP: Duration = Duration::from_millis(50);
/// Sample rate with the filter on, undivided, Hz (10.1, 10.11).
const BASE_HZ: u32 = 1125;
/// Bandwidth of the filters 1 to 6 at -3 dB, Hz: the wider of gyroscope (table 16) and accelerometer (table 18).
const BANDWIDTHS_HZ: [f32; 6] = [246.0, 119.5, 51.2, 23.9, 11.6, 5.7];
/// Standard gravity, m/s² per g.
const G_M_S2: f32 = 9.806_65;
/// Counts at the full scale of the 16-bit registers.
const FULL_SCALE: f32 = 32_768.0;

/// Step of the driver: the transfer that follows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    /// Selects bank 0, whichever bank was selected.
    Find,
    Identify,
    Reset,
    Wake,
    SelectSettings,
    SetGyroDivider,
    SetGyro,
    SetAccelDivider,
    SetAccel,
    CheckGyro,
    CheckAccel,
    SelectData,
    Status,
    Data,
}

/// Driver of one ICM-20948.
#[derive(Clone, Debug)]
pub struct Icm20948 {
    state: State,
    divider: u8,
    gyro_config: u8,
    accel_config: u8,
    /// Scales of acceleration and rate: m/s² and rad/s per count.
    scales: [f32; 2],
}

impl Icm20948 {
    /// Creates a driver for `rate_hz` readings per second, 5 to 400. The chip samples at least as often, behind the
    /// widest filter whose bandwidth is at most half of that rate.
    #[must_use]
    pub fn new(config: &Icm20948Config, rate_hz: u16) -> Self {
        let rate_hz = u32::from(rate_hz.max(1));
        let divider = (BASE_HZ / rate_hz).saturating_sub(1).min(u8::MAX.into()) as u8;
        let narrow_enough = |bandwidth_hz: &f32| 2.0 * bandwidth_hz <= rate_hz as f32;
        let filter = BANDWIDTHS_HZ.iter().position(narrow_enough).unwrap_or(BANDWIDTHS_HZ.len() - 1) as u8 + 1;
        // Each full scale is twice the one before: 2 to 16 g, 250 to 2000 °/s.
        let accel_scale = (config.acceleration_max_g.max(2) / 2).ilog2() as u8 & 3;
        let gyro_scale = (config.rate_max_deg_s.max(250) / 250).ilog2() as u8 & 3;
        let settings = |scale: u8| filter << 3 | scale << 1 | FILTERED;
        let acceleration_m_s2 = f32::from(config.acceleration_max_g) * G_M_S2 / FULL_SCALE;
        let rate_rad_s = f32::from(config.rate_max_deg_s) * (PI / 180.0) / FULL_SCALE;
        Self {
            state: State::Find,
            divider,
            gyro_config: settings(gyro_scale),
            accel_config: settings(accel_scale),
            scales: [acceleration_m_s2, rate_rad_s],
        }
    }

    fn reading(&self, read: &[u8]) -> Outcome {
        let mut values = [0.0; MAX_QUANTITIES];
        let mut saturated = false;
        let [acceleration, rate] = self.scales;
        let scales = [acceleration, acceleration, acceleration, rate, rate, rate];
        for ((value, scale), bytes) in values.iter_mut().zip(scales).zip(read.as_chunks().0) {
            let counts = i16::from_be_bytes(*bytes);
            saturated |= counts == i16::MAX || counts == i16::MIN;
            *value = f32::from(counts) * scale;
        }
        Outcome::Reading { values, quality: saturation(saturated) }
    }
}

impl Driver for Icm20948 {
    fn restart(&mut self) {
        self.state = State::Find;
    }

    fn next(&self) -> Exchange {
        match self.state {
            State::Find | State::SelectData => Exchange::set(REG_BANK_SEL, BANK_0),
            State::Identify => Exchange::get(WHO_AM_I, 1),
            State::Reset => Exchange::set(PWR_MGMT_1, DEVICE_RESET),
            State::Wake => Exchange::set(PWR_MGMT_1, CLOCK_BEST),
            State::SelectSettings => Exchange::set(REG_BANK_SEL, BANK_2),
            State::SetGyroDivider => Exchange::set(GYRO_SMPLRT_DIV, self.divider),
            State::SetGyro => Exchange::set(GYRO_CONFIG_1, self.gyro_config),
            State::SetAccelDivider => Exchange::set_both(ACCEL_SMPLRT_DIV_1, [0, self.divider]),
            State::SetAccel => Exchange::set(ACCEL_CONFIG, self.accel_config),
            State::CheckGyro => Exchange::get(GYRO_SMPLRT_DIV, 2),
            State::CheckAccel => Exchange::get(ACCEL_SMPLRT_DIV_1, 5),
            State::Status => Exchange::get(INT_STATUS_1, 1),
            State::Data => Exchange::get(ACCEL_XOUT_H, 12),
        }
    }

    fn done(&mut self, read: &[u8]) -> Outcome {
        let (state, outcome) = match (self.state, read) {
            (State::Find, _) => (State::Identify, Outcome::Next),
            (State::Identify, [IDENTITY]) => (State::Reset, Outcome::Next),
            (State::Reset, _) => (State::Wake, Outcome::Wait(START_UP)),
            (State::Wake, _) => (State::SelectSettings, Outcome::Next),
            (State::SelectSettings, _) => (State::SetGyroDivider, Outcome::Next),
            (State::SetGyroDivider, _) => (State::SetGyro, Outcome::Next),
            (State::SetGyro, _) => (State::SetAccelDivider, Outcome::Next),
            (State::SetAccelDivider, _) => (State::SetAccel, Outcome::Next),
            (State::SetAccel, _) => (State::CheckGyro, Outcome::Next),
            (State::CheckGyro, [divider, config]) if [*divider, *config] == [self.divider, self.gyro_config] => {
                (State::CheckAccel, Outcome::Next)
            }
            (State::CheckAccel, [0, divider, _, _, config])
                if [*divider, *config] == [self.divider, self.accel_config] =>
            {
                (State::SelectData, Outcome::Next)
            }
            (State::SelectData, _) => (State::Status, Outcome::Wait(GYRO_START_UP)),
            (State::Status, [status]) if status & RAW_DATA_0_RDY != 0 => (State::Data, Outcome::Next),
            (State::Status, _) => (State::Status, Outcome::NotReady),
            (State::Data, read) => (State::Status, self.reading(read)),
            (State::Identify | State::CheckGyro | State::CheckAccel, _) => (State::Find, Outcome::WrongChip),
        };
        self.state = state;
        outcome
    }
}

#[cfg(test)]
mod tests {
    use r4_protocol::config::SensorChip;

    use super::{
        super::sensor::tests::{Taken, taken},
        *,
    };

    /// The bus schedule relies on the transfer lengths in the configuration's chip description.
    #[test]
    fn transfers_are_as_long_as_the_board_plans_them() {
        let config = Icm20948Config { acceleration_max_g: 4, rate_max_deg_s: 500 };
        let planned = SensorChip::Icm20948(config).description();
        let taken = taken(&mut Icm20948::new(&config, 100), |driver| match driver.state {
            State::Identify => [IDENTITY].into(),
            State::CheckGyro => [driver.divider, driver.gyro_config].into(),
            State::CheckAccel => [0, driver.divider, 0, 0, driver.accel_config].into(),
            State::Status => [RAW_DATA_0_RDY].into(),
            _ => [0; 12].into(),
        });
        assert_eq!(taken, Taken::planned(&planned));
    }
}
