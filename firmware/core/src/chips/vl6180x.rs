//! ST VL6180X: distance to an object, by the time of flight of infrared light. Section and register numbers are those
//! of its datasheet, DocID026171 revision 6.
//!
//! The chip ranges on its own. A reading takes three transfers: status (new range ready, error code; neighbouring
//! registers), distance, and clearing the flag. Without a reflection the reading is the farthest distance, of quality
//! `OutOfRange`.
//!
//! After each power-up the chip needs settings of registers that the datasheet does not describe: those of section 9 of
//! the application note AN4545 (revision 1, "SR03 settings"), which explains neither their meaning nor what happens
//! without them.

use embassy_time::Duration;
use r4_protocol::{
    Quality,
    channel::MAX_QUANTITIES,
    config::{VL6180X_FARTHEST_M, Vl6180xConfig},
};

use super::sensor::{Driver, Exchange, Outcome};

// Registers (section 6).
const MODEL_ID: u16 = 0x000;
const INTERRUPT_CONFIG: u16 = 0x014;
const INTERRUPT_CLEAR: u16 = 0x015;
const FRESH_OUT_OF_RESET: u16 = 0x016;
const RANGE_START: u16 = 0x018;
const INTERMEASUREMENT_PERIOD: u16 = 0x01B;
const MAX_CONVERGENCE_TIME: u16 = 0x01C;
const VHV_RECALIBRATE: u16 = 0x02E;
const VHV_REPEAT_RATE: u16 = 0x031;
const RANGE_STATUS: u16 = 0x04D;
const RANGE_VALUE: u16 = 0x062;
const AVERAGING_PERIOD: u16 = 0x10A;

const MODEL: u8 = 0xB4;
/// RANGE_START: start (or stop while ranging), and continuous mode.
const START_STOP: u8 = 1 << 0;
const CONTINUOUS: u8 = 1 << 1;
/// RANGE_STATUS: the chip takes a start.
const DEVICE_READY: u8 = 1 << 0;
/// INTERRUPT_CONFIG and its status, lower three bits: a new range is ready.
const NEW_SAMPLE: u8 = 0b100;
const INTERRUPT_MASK: u8 = 0b111;
/// INTERRUPT_CLEAR: clears the interrupts of range, light and errors.
const CLEAR_ALL: u8 = 0b111;

/// Undocumented settings that AN4545 requires before all others.
const PRIVATE: [(u16, u8); 30] = [
    (0x207, 0x01),
    (0x208, 0x01),
    (0x096, 0x00),
    (0x097, 0xFD),
    (0x0E3, 0x00),
    (0x0E4, 0x04),
    (0x0E5, 0x02),
    (0x0E6, 0x01),
    (0x0E7, 0x03),
    (0x0F5, 0x02),
    (0x0D9, 0x05),
    (0x0DB, 0xCE),
    (0x0DC, 0x03),
    (0x0DD, 0xF8),
    (0x09F, 0x00),
    (0x0A3, 0x3C),
    (0x0B7, 0x00),
    (0x0BB, 0x3C),
    (0x0B2, 0x09),
    (0x0CA, 0x09),
    (0x198, 0x01),
    (0x1B0, 0x17),
    (0x1AD, 0x00),
    (0x0FF, 0x05),
    (0x100, 0x05),
    (0x199, 0x05),
    (0x1A6, 0x1B),
    (0x1AC, 0x3E),
    (0x1A7, 0x1F),
    (0x030, 0x00),
];
/// Settings that AN4545 recommends: 48 samples of averaging (4.3 ms), a temperature calibration now and after each 255
/// ranges; and the flag for a new range.
const PUBLIC: [(u16, u8); 4] =
    [(AVERAGING_PERIOD, 48), (VHV_REPEAT_RATE, 0xFF), (VHV_RECALIBRATE, 1), (INTERRUPT_CONFIG, NEW_SAMPLE)];

/// Interval and number of polls for the end of ranging, which may take a period of up to 1 s.
const STOP_LOOK: Duration = Duration::from_millis(100);
const STOP_LOOKS: u8 = 12;
/// Longest wait for the reflection, ms: the chip's power-up value.
const CONVERGENCE_MAX_MS: u16 = 49;

/// Step of the driver: the transfer that follows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Model,
    /// Number of polls of the status so far.
    Stopping(u8),
    Stop(u8),
    Private(u8),
    Public(u8),
    Period,
    Convergence,
    Check,
    Set,
    Start,
    Status,
    Value,
    Clear,
}

/// Driver of one VL6180X.
#[derive(Clone, Debug)]
pub struct Vl6180x {
    state: State,
    /// Settings for INTERMEASUREMENT_PERIOD and MAX_CONVERGENCE_TIME.
    timing: [u8; 2],
    /// Error code and distance of the range that is being read.
    error: u8,
    millimetres: u8,
}

impl Vl6180x {
    /// Creates a driver that ranges `rate_hz` times per second, a divisor of 100: the chip counts periods of 10 ms.
    #[must_use]
    pub fn new(_config: &Vl6180xConfig, rate_hz: u16) -> Self {
        let periods = (100 / rate_hz.max(1)).max(2);
        // Convergence and 5 ms fit nine tenths of the period (2.4.4).
        let convergence_ms = (periods * 9 - 5).min(CONVERGENCE_MAX_MS);
        Self { state: State::Model, timing: [(periods - 1) as u8, convergence_ms as u8], error: 0, millimetres: 0 }
    }

    /// Returns distance and quality by the error code of RANGE_STATUS (6.2.37).
    fn reading(&self) -> Outcome {
        let distance_m = f32::from(self.millimetres) * 1e-3;
        let (distance_m, quality) = match self.error {
            0 if distance_m < VL6180X_FARTHEST_M => (distance_m, Quality::Good),
            // Laser or clock fault: nothing was measured.
            1..=5 => (0.0, Quality::Stale),
            // The object is nearer than the chip's zero.
            12 | 14 => (0.0, Quality::Saturated),
            // No convergence, too much other light, or farther than it can count.
            _ => (VL6180X_FARTHEST_M, Quality::OutOfRange),
        };
        let mut values = [0.0; MAX_QUANTITIES];
        values[0] = distance_m;
        Outcome::Reading { values, quality }
    }
}

/// Returns the write of setting number `at`. The fallback is not reached: `at` stays within the list.
fn setting(settings: &[(u16, u8)], at: u8) -> Exchange {
    let (register, value) = settings.get(usize::from(at)).copied().unwrap_or((FRESH_OUT_OF_RESET, 1));
    Exchange::set_far(register, value)
}

impl Driver for Vl6180x {
    fn restart(&mut self) {
        self.state = State::Model;
    }

    fn next(&self) -> Exchange {
        match self.state {
            State::Model => Exchange::get_far(MODEL_ID, 1),
            State::Stopping(_) => Exchange::get_far(RANGE_STATUS, 1),
            State::Stop(_) => Exchange::set_far(RANGE_START, START_STOP),
            State::Private(at) => setting(&PRIVATE, at),
            State::Public(at) => setting(&PUBLIC, at),
            State::Period => Exchange::set_far(INTERMEASUREMENT_PERIOD, self.timing[0]),
            State::Convergence => Exchange::set_far(MAX_CONVERGENCE_TIME, self.timing[1]),
            State::Check => Exchange::get_far(INTERMEASUREMENT_PERIOD, 2),
            State::Set => Exchange::set_far(FRESH_OUT_OF_RESET, 0),
            State::Start => Exchange::set_far(RANGE_START, CONTINUOUS | START_STOP),
            // The status of the light sensor and the interrupt flags follow in the next two registers.
            State::Status => Exchange::get_far(RANGE_STATUS, 3),
            State::Value => Exchange::get_far(RANGE_VALUE, 1),
            State::Clear => Exchange::set_far(INTERRUPT_CLEAR, CLEAR_ALL),
        }
    }

    fn done(&mut self, read: &[u8]) -> Outcome {
        let (state, outcome) = match (self.state, read) {
            (State::Model, &[MODEL]) => (State::Stopping(0), Outcome::Next),
            (State::Stopping(_), [status]) if status & DEVICE_READY != 0 => (State::Private(0), Outcome::Next),
            // Still ranging from before the restart. Stop it only once: a second write of START_STOP would start it
            // again.
            (State::Stopping(0), [_]) => (State::Stop(1), Outcome::Next),
            (State::Stopping(looks @ ..STOP_LOOKS), [_]) => (State::Stopping(looks + 1), Outcome::Wait(STOP_LOOK)),
            (State::Stop(looks), _) => (State::Stopping(looks), Outcome::Wait(STOP_LOOK)),
            (State::Private(at), _) if usize::from(at) + 1 < PRIVATE.len() => (State::Private(at + 1), Outcome::Next),
            (State::Private(_), _) => (State::Public(0), Outcome::Next),
            (State::Public(at), _) if usize::from(at) + 1 < PUBLIC.len() => (State::Public(at + 1), Outcome::Next),
            (State::Public(_), _) => (State::Period, Outcome::Next),
            (State::Period, _) => (State::Convergence, Outcome::Next),
            (State::Convergence, _) => (State::Check, Outcome::Next),
            (State::Check, read) if *read == self.timing => (State::Set, Outcome::Next),
            (State::Set, _) => (State::Start, Outcome::Next),
            (State::Start, _) => (State::Status, Outcome::Next),
            (State::Status, [status, _, flags]) if flags & INTERRUPT_MASK == NEW_SAMPLE => {
                self.error = status >> 4;
                (State::Value, Outcome::Next)
            }
            (State::Status, [..]) if read.len() == 3 => (State::Status, Outcome::NotReady),
            (State::Value, [millimetres]) => {
                self.millimetres = *millimetres;
                (State::Clear, Outcome::Next)
            }
            (State::Clear, _) => (State::Status, self.reading()),
            _ => (State::Model, Outcome::WrongChip),
        };
        self.state = state;
        outcome
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use r4_protocol::config::SensorChip;

    use super::{
        super::sensor::tests::{Taken, taken},
        *,
    };

    /// The bus schedule relies on the transfer lengths in the configuration's chip description.
    #[test]
    fn transfers_are_as_long_as_the_board_plans_them() {
        let planned = SensorChip::Vl6180x(Vl6180xConfig {}).description();
        let taken = taken(&mut Vl6180x::new(&Vl6180xConfig {}, 20), |driver| match driver.state {
            State::Model => [MODEL].into(),
            State::Stopping(_) => [DEVICE_READY].into(),
            State::Check => driver.timing.into(),
            State::Status => [DEVICE_READY, 0, NEW_SAMPLE].into(),
            State::Value => [50].into(),
            _ => [].into(),
        });
        assert_eq!(taken, Taken::planned(&planned));
    }

    #[test]
    fn convergence_and_5_ms_fit_nine_tenths_of_the_period() {
        for (rate_hz, timing) in [(1, [99, 49]), (10, [9, 49]), (20, [4, 40]), (25, [3, 31]), (50, [1, 13])] {
            assert_eq!(Vl6180x::new(&Vl6180xConfig {}, rate_hz).timing, timing, "{rate_hz} Hz");
        }
    }

    #[test]
    fn every_error_code_says_what_the_range_is_worth() {
        for error in 0..16 {
            for (millimetres, near) in [(0, 0.0), (87, 0.087), (199, 0.199)] {
                let driver = Vl6180x { error, millimetres, ..Vl6180x::new(&Vl6180xConfig {}, 20) };
                let Outcome::Reading { values, quality } = driver.reading() else { panic!("a reading") };
                let (expected_m, expected) = match error {
                    0 => (near, Quality::Good),
                    1..=5 => (0.0, Quality::Stale),
                    12 | 14 => (0.0, Quality::Saturated),
                    _ => (0.2, Quality::OutOfRange),
                };
                assert!((values[0] - expected_m).abs() < 1e-6 && quality == expected, "{error}, {millimetres} mm");
            }
        }
        let driver = Vl6180x { millimetres: 230, ..Vl6180x::new(&Vl6180xConfig {}, 20) };
        let Outcome::Reading { quality, .. } = driver.reading() else { panic!("a reading") };
        assert_eq!(quality, Quality::OutOfRange);
    }

    /// A chip that still ranges from before a restart of the board is stopped once, and given up if it does not stop.
    #[test]
    fn a_chip_that_does_not_stop_is_given_up() {
        let mut driver = Vl6180x { state: State::Stopping(0), ..Vl6180x::new(&Vl6180xConfig {}, 20) };
        let (mut stops, mut transfers) = (0, 0);
        loop {
            transfers += 1;
            assert!(transfers < 100);
            let is_stop = driver.next() == Exchange::set_far(RANGE_START, START_STOP);
            stops += u32::from(is_stop);
            if driver.done(if is_stop { &[] } else { &[0] }) == Outcome::WrongChip {
                break;
            }
        }
        assert_eq!(stops, 1);
    }
}
