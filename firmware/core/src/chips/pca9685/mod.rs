//! PCA9685 PWM controller: sixteen 12-bit outputs (NXP datasheet rev. 4).

mod registers;

use embassy_time::{Duration, Timer};
use embedded_hal_async::i2c::I2c;
use registers as reg;

use super::{ChipError, compare};
use crate::{platform::Write, within::Within};

/// Nominal frequency of the internal oscillator, Hz (datasheet 7.3.5). It differs by several percent from chip to chip.
const OSCILLATOR_HZ: f32 = 25e6;
/// Counts in one PWM period.
const STEPS: f32 = 4096.0;
/// Last count of a PWM period.
const LAST: u16 = 4095;
/// Start-up time of the oscillator after `SLEEP` is cleared (datasheet 7.3.1.1).
const OSCILLATOR_START: Duration = Duration::from_micros(500);

/// Setting of one output: 12-bit "on" and "off" counts with their full-on and full-off flags.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Output([u8; 4]);

impl Output {
    /// Output that is always low.
    pub const LOW: Self = Self([0, 0, 0, reg::FULL]);
    /// Output that is always high.
    pub const HIGH: Self = Self([0, reg::FULL, 0, 0]);

    /// Creates an output that is high from the start of the period for `share` of it, rounded to 1/4096; shares of 0
    /// and 1 are always low and always high.
    #[must_use]
    pub fn high_for(share: f32) -> Self {
        // On == off must not be programmed (datasheet 7.3.3), and 4096 does not fit: both ends have their own flags.
        match nearest(share * STEPS) {
            0 => Self::LOW,
            4096.. => Self::HIGH,
            off => {
                let [low, high] = off.to_le_bytes();
                Self([0, 0, low, high])
            }
        }
    }

    /// Creates an output that is high for `share` of the period from count `phase` on, rounded to 1/4096. Different
    /// phases keep outputs of one supply from switching on together. A pulse that would not fit begins earlier, so that
    /// it ends in the period in which it began: the output does not depend on its previous setting. `phase` is below
    /// 4096.
    #[must_use]
    pub fn high_from(phase: u16, share: f32) -> Self {
        match nearest(share * STEPS) {
            0 => Self::LOW,
            4096.. => Self::HIGH,
            length => {
                let on = phase.min(LAST - length);
                let ([on_low, on_high], [off_low, off_high]) = (on.to_le_bytes(), (on + length).to_le_bytes());
                Self([on_low, on_high, off_low, off_high])
            }
        }
    }

    /// Returns an always low output with the "on" count of this one, so that only the "off" count has to be written.
    #[must_use]
    pub const fn low(self) -> Self {
        let Self([on_low, on_high, ..]) = self;
        Self([on_low, on_high, 0, reg::FULL])
    }

    /// Returns true when the output is always low, whatever its "on" count.
    #[must_use]
    pub const fn is_low(self) -> bool {
        self.0[3] & reg::FULL != 0
    }

    /// Returns the registers that differ from `before`: index of the first, counted from `ON_L`, the bytes, and their
    /// number, 2 or 4.
    // A fixed array of four bytes: a slice of variable length would be copied by a call.
    fn change_from(self, before: Self) -> (u8, [u8; 4], usize) {
        let [on_low, on_high, off_low, off_high] = self.0;
        let same = |at: usize| self.0[at] == before.0[at];
        match (same(0) && same(1), same(2) && same(3)) {
            (true, _) => (2, [off_low, off_high, 0, 0], 2),
            (false, true) => (0, [on_low, on_high, 0, 0], 2),
            (false, false) => (0, self.0, 4),
        }
    }

    /// Returns the bytes of `ON_L, ON_H, OFF_L, OFF_H`.
    #[must_use]
    pub const fn registers(self) -> [u8; 4] {
        self.0
    }
}

/// A PCA9685 at one address. Each call borrows the bus.
#[derive(Clone, Copy, Debug)]
pub struct Pca9685 {
    address: u8,
    oscillator_hz: f32,
    prescale: u8,
}

impl Pca9685 {
    const MODE1_RUNNING: u8 = reg::MODE1_AI | reg::MODE1_ALLCALL;

    /// Creates a driver of the chip at `address` with the nominal oscillator, for the available PWM frequency nearest
    /// to `frequency_hz`.
    #[must_use]
    pub fn new(address: u8, frequency_hz: f32) -> Self {
        Self::with_oscillator(address, frequency_hz, OSCILLATOR_HZ)
    }

    /// Creates the same driver with the measured frequency of the oscillator, Hz, for accurate pulse widths.
    #[must_use]
    pub fn with_oscillator(address: u8, frequency_hz: f32, oscillator_hz: f32) -> Self {
        // The hardware's minimum is 3, which gives 1526 Hz (datasheet 7.3.5).
        let prescale = libm::roundf(oscillator_hz / (STEPS * frequency_hz)) - 1.0;
        Self { address, oscillator_hz, prescale: prescale.within(3.0, 255.0) as u8 }
    }

    /// Length of one PWM period, rounded up to 1 µs.
    #[must_use]
    pub fn period(&self) -> Duration {
        let us = STEPS * self.divider() / (self.oscillator_hz / 1e6);
        Duration::from_micros(libm::ceilf(us) as u64)
    }

    /// Creates an output that is high from the start of each period for `width_s`, to the nearest count: 1/4096 of a
    /// period, 4.9 µs at 50 Hz.
    #[must_use]
    pub fn pulse(&self, width_s: f32) -> Output {
        Output::high_for(width_s * self.oscillator_hz / (STEPS * self.divider()))
    }

    /// Oscillator clocks per count.
    fn divider(&self) -> f32 {
        f32::from(self.prescale) + 1.0
    }

    /// Turns every output off, sets frequency and output stage, starts the oscillator, and reads everything back.
    ///
    /// Takes about 2.7 ms at 400 kHz. Outputs turn off at the end of the PWM cycle that is running, and stay off, in
    /// whatever state the chip was.
    ///
    /// # Errors
    /// [`ChipError::Bus`] for a failed transfer, [`ChipError::Mismatch`] for a register that does not hold what was
    /// written.
    pub async fn init<B: I2c>(&self, bus: &mut B) -> Result<(), ChipError<B::Error>> {
        self.force_off(bus).await?;
        bus.write(self.address, &[reg::MODE1, Self::MODE1_RUNNING | reg::MODE1_SLEEP]).await?;
        // Off once more, now with the "on" counts of 0 that `set_off_count` relies on.
        bus.write(self.address, &[reg::ALL_LED_ON_L, 0, 0, 0, reg::FULL]).await?;
        bus.write(self.address, &[reg::PRE_SCALE, self.prescale]).await?;
        bus.write(self.address, &[reg::MODE1, Self::MODE1_RUNNING]).await?;
        Timer::after(OSCILLATOR_START).await;
        self.verify_mode(bus).await?;
        for output in 0..16 {
            self.verify_off(bus, output).await?;
        }
        Ok(())
    }

    /// Turns every output off from any state of the chip and reads nothing back: the first step of [`Pca9685::init`],
    /// 0.15 ms at 400 kHz.
    ///
    /// # Errors
    /// The bus's error, for a failed transfer.
    pub async fn force_off<B: I2c>(&self, bus: &mut B) -> Result<(), B::Error> {
        // MODE2 comes first: a chip set to change its outputs on ACK would not take the next transfer, and a chip set
        // to invert them would turn all on.
        bus.write(self.address, &[reg::MODE2, reg::MODE2_OUTDRV]).await?;
        self.all_off(bus).await
    }

    /// Turns every output off, in one transfer of 3 bytes.
    ///
    /// # Errors
    /// The bus's error, for a failed transfer.
    pub async fn all_off<B: I2c>(&self, bus: &mut B) -> Result<(), B::Error> {
        bus.write(self.address, &[reg::ALL_LED_OFF_H, reg::FULL]).await
    }

    /// Returns the write that sets up to four neighbouring outputs from `first` on; they change in the same PWM period.
    #[must_use]
    pub fn set(&self, first: u8, outputs: &[Output]) -> Write {
        let mut bytes = [0; Write::MAX];
        bytes[0] = on_register(first);
        let mut end = 1;
        for (registers, output) in bytes[1..].as_chunks_mut().0.iter_mut().zip(outputs) {
            *registers = output.registers();
            end += registers.len();
        }
        Write::new(self.address, bytes, end)
    }

    /// Returns the write that changes only the "off" count of `output`, whose "on" count is 0 as after
    /// [`Pca9685::init`]: 3 bytes after the address.
    #[must_use]
    pub fn set_off_count(&self, output: u8, to: Output) -> Write {
        let [_, _, low, high] = to.registers();
        let mut bytes = [0; Write::MAX];
        bytes[..3].copy_from_slice(&[on_register(output) + 2, low, high]);
        Write::new(self.address, bytes, 3)
    }

    /// Returns the write that takes `output` from its last written setting, `before`, to `to`, by the registers that
    /// differ.
    #[must_use]
    pub fn change(&self, output: u8, before: Output, to: Output) -> Write {
        let (first, changed, count) = to.change_from(before);
        let mut bytes = [0; Write::MAX];
        bytes[0] = on_register(output) + first;
        bytes[1..5].copy_from_slice(&changed);
        Write::new(self.address, bytes, 1 + count)
    }

    /// Reads `output` back and compares it with `written`.
    ///
    /// # Errors
    /// [`ChipError::Bus`] for a failed transfer, [`ChipError::Mismatch`] for a register that does not hold what was
    /// written.
    pub async fn verify<B: I2c>(&self, bus: &mut B, output: u8, written: Output) -> Result<(), ChipError<B::Error>> {
        let mut read = [0; 4];
        bus.write_read(self.address, &[on_register(output)], &mut read).await?;
        compare(on_register(output), written.registers(), read)
    }

    /// Reads back that `output` is off; the counts behind the full-off flag do not matter.
    ///
    /// # Errors
    /// [`ChipError::Bus`] for a failed transfer, [`ChipError::Mismatch`] when the flag is not set.
    pub async fn verify_off<B: I2c>(&self, bus: &mut B, output: u8) -> Result<(), ChipError<B::Error>> {
        let register = on_register(output) + 3;
        let mut read = [0];
        bus.write_read(self.address, &[register], &mut read).await?;
        compare(register, [reg::FULL], [read[0] & reg::FULL])
    }

    /// Reads mode and prescaler back: a chip that lost its supply for a moment is asleep at 200 Hz.
    ///
    /// # Errors
    /// [`ChipError::Bus`] for a failed transfer, [`ChipError::Mismatch`] for a register that does not hold what was
    /// written.
    pub async fn verify_mode<B: I2c>(&self, bus: &mut B) -> Result<(), ChipError<B::Error>> {
        let mut modes = [0; 2];
        bus.write_read(self.address, &[reg::MODE1], &mut modes).await?;
        compare(reg::MODE1, [Self::MODE1_RUNNING, reg::MODE2_OUTDRV], modes)?;
        let mut prescale = [0];
        bus.write_read(self.address, &[reg::PRE_SCALE], &mut prescale).await?;
        compare(reg::PRE_SCALE, [self.prescale], prescale)
    }
}

/// Rounds a non-negative number to the nearest count; 0 for NaN.
fn nearest(counts: f32) -> u16 {
    (counts + 0.5) as u16
}

const fn on_register(output: u8) -> u8 {
    reg::LED0_ON_L + 4 * output
}

#[cfg(test)]
mod tests {
    extern crate std;

    use core::cell::{Cell, RefCell};
    use std::{rc::Rc, vec::Vec};

    use embedded_hal::i2c::{ErrorType, Operation};

    use super::*;
    use crate::testing::{NoAnswer, Registers, Tasks};

    const CHIP: u8 = 0x40;

    /// Fake chip: its registers, and the writes to it in order.
    #[derive(Clone, Default)]
    struct Written {
        registers: Registers,
        writes: Rc<RefCell<Vec<Vec<u8>>>>,
    }

    impl ErrorType for Written {
        type Error = NoAnswer;
    }

    impl I2c for Written {
        async fn transaction(&mut self, chip: u8, operations: &mut [Operation<'_>]) -> Result<(), NoAnswer> {
            if let [Operation::Write(bytes)] = operations {
                self.writes.borrow_mut().push(bytes.to_vec());
            }
            self.registers.transaction(chip, operations).await
        }
    }

    /// Outputs turn off before anything else, the prescaler is written while the oscillator is off (7.3.5), and nothing
    /// is read back before it runs again.
    #[test]
    fn it_is_set_up_in_the_order_that_the_datasheet_asks_for() {
        let (bus, mut tasks) = (Written::default(), Tasks::default());
        let mut lent = bus.clone();
        let done = Rc::new(Cell::new(None));
        let tell = done.clone();
        tasks.spawn(async move {
            tell.set(Some(Pca9685::new(CHIP, 50.0).init(&mut lent).await.is_ok()));
            core::future::pending::<()>().await;
        });
        tasks.advance(Duration::from_micros(499));
        assert_eq!(done.get(), None);
        tasks.advance(Duration::from_micros(1));
        assert_eq!(done.get(), Some(true));
        let expected: [&[u8]; 6] = [
            // Totem pole, changes on STOP; full off for all outputs.
            &[0x01, 0x04],
            &[0xFD, 0x10],
            // Asleep, with auto-increment and the All Call address.
            &[0x00, 0x31],
            &[0xFA, 0, 0, 0, 0x10],
            &[0xFE, 121],
            &[0x00, 0x21],
        ];
        assert_eq!(*bus.writes.borrow(), expected.map(<[u8]>::to_vec));
    }

    #[test]
    fn shares_become_counts_and_ends_become_flags() {
        assert_eq!(Output::high_for(0.0), Output::LOW);
        assert_eq!(Output::high_for(1.0), Output::HIGH);
        assert_eq!(Output::high_for(0.5).registers(), [0, 0, 0x00, 0x08]);
        assert_eq!(Output::high_for(0.9).registers(), [0, 0, 0x66, 0x0E]); // 3686
        assert_eq!(Output::high_for(f32::NAN), Output::LOW);
    }

    /// For every phase and length a pulse is as long as without a phase, lies within the period, and starts at the
    /// phase or as shortly before it as fits.
    #[test]
    fn a_phase_moves_a_pulse_and_leaves_its_length() {
        for phase in (0..4096).step_by(64) {
            for length in 1..4096_u16 {
                let [on_low, on_high, off_low, off_high] =
                    Output::high_from(phase, f32::from(length) / STEPS).registers();
                let [on, off] = [[on_low, on_high], [off_low, off_high]].map(u16::from_le_bytes);
                assert_eq!(off - on, length);
                assert!(off <= LAST && on <= phase && (on == phase || off == LAST), "{phase} {length}: {on} {off}");
            }
            assert_eq!(Output::high_from(phase, 0.0), Output::LOW);
            assert_eq!(Output::high_from(phase, 1.0), Output::HIGH);
            assert_eq!(Output::high_from(phase, f32::NAN), Output::LOW);
        }
        assert_eq!(Output::high_from(0, 0.9), Output::high_for(0.9));
    }

    #[test]
    fn a_change_writes_the_registers_that_differ() {
        let [short, longer, longest] = [0.2, 0.4, 0.9].map(|share| Output::high_from(2048, share));
        let change = |to: Output, before| {
            let (first, bytes, count) = to.change_from(before);
            assert_eq!(bytes[..count], to.registers()[usize::from(first)..][..count]);
            (first, count)
        };
        assert_eq!([change(short, longer), change(longer, longest)], [(2, 2), (0, 4)]);
        // Both end at the end of the period: only their beginnings differ.
        assert_eq!(change(longest, Output::high_from(2048, 0.95)), (0, 2));
        assert_eq!((change(longest.low(), longest), longest.low().is_low()), ((2, 2), true));
        let chip = Pca9685::new(0x40, 1526.0);
        let [_, _, low, high] = short.registers();
        assert_eq!(chip.change(3, longer, short).bytes(), [0x14, low, high]);
        assert_eq!(chip.change(3, longest, longer).bytes(), [[0x12].as_slice(), &longer.registers()].concat());
    }

    #[test]
    fn frequencies_of_the_datasheet() {
        assert_eq!(Pca9685::new(0x40, 50.0).prescale, 121);
        assert_eq!(Pca9685::new(0x40, 200.0).prescale, 30);
        assert_eq!(Pca9685::new(0x40, 1526.0).prescale, 3);
        assert_eq!(Pca9685::new(0x40, 1526.0).period().as_micros(), 656);
    }

    #[test]
    fn frequency_and_pulses_follow_the_measured_oscillator() {
        // At 25 MHz 1.5 ms are 37500 clocks, and a count at 50 Hz is 122 of them. At 26.2 MHz they are 39300 and 128.
        let [nominal, fast] = [25e6, 26.2e6].map(|hz| Pca9685::with_oscillator(0x42, 50.0, hz));
        assert_eq!([nominal.prescale, fast.prescale], [121, 127]);
        assert_eq!(nominal.pulse(1.5e-3).registers(), [0, 0, 0x33, 0x01]); // 307.4
        assert_eq!(fast.pulse(1.5e-3).registers(), [0, 0, 0x33, 0x01]); // 307.0
        assert_eq!(nominal.period().as_micros(), 19_989);
        assert_eq!(fast.period().as_micros(), 20_011);
        assert_eq!(nominal.pulse(f32::NAN), Output::LOW);
    }
}
