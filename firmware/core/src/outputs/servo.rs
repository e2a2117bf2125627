//! Rules of RC servos on a PCA9685.
//!
//! - A servo does not report its position. Without pulses it is limp; at the first pulse it moves to the pulse's angle
//!   as fast as it can. It therefore gets no pulses before its first command, and that command is not slowed down. From
//!   there on the requested angle changes by at most `speed_max`.
//! - One transfer sets one servo: a stop never waits for more than that. Servos whose pulse changes take turns.
//! - In the safe state pulses end, and the angles are no longer known; with `hold_when_safe` pulses continue and each
//!   servo is held where it was last sent.

use embedded_hal_async::i2c::I2c;
use heapless::Vec;
use r4_protocol::config::{MAX_SERVOS, ServoChipConfig, ServoConfig};

use super::slew::towards;
use crate::{
    chips::{
        ChipError,
        pca9685::{Output, Pca9685},
    },
    platform::Write,
};

/// Maximum interval between new pulses of a moving servo, s: about one period of the pulses.
const UPDATE_S: f32 = 0.02;

/// All servos of one chip.
#[derive(Clone, Debug)]
pub struct Servos {
    chip: Pca9685,
    hold_when_safe: bool,
    servos: Vec<Servo, MAX_SERVOS>,
    /// Index of the servo to be written next.
    next: usize,
}

#[derive(Clone, Debug)]
struct Servo {
    config: ServoConfig,
    /// Requested angle and its target, rad; `None` before the first command.
    motion: Option<Motion>,
    /// Setting last written to its output; `None` when unknown.
    written: Option<Output>,
    /// Angle of the last pulse sent, rad; `None` without pulses.
    sent: Option<f32>,
}

#[derive(Clone, Copy, Debug)]
struct Motion {
    angle: f32,
    target: f32,
}

/// New state of a servo once its write has been sent.
#[derive(Clone, Copy, Debug)]
pub struct Pulse {
    /// Number of the servo in the configuration.
    index: usize,
    output: Output,
    /// Angle of the pulse, rad; `None` where the pulses end.
    angle: Option<f32>,
}

impl Pulse {
    /// Number of the servo in the configuration.
    pub(super) const fn index(&self) -> usize {
        self.index
    }
}

impl Servos {
    /// Bytes of a write of [`Servos::next_write`], address included: 93 µs at 400 kHz.
    pub const WRITE_BYTES: u32 = 4;

    /// Creates servos without pulses. The configuration must be valid.
    #[must_use]
    pub fn new(chip: ServoChipConfig, servos: &[ServoConfig]) -> Self {
        let new = |config: &ServoConfig| Servo { config: *config, motion: None, written: None, sent: None };
        Self {
            chip: Pca9685::with_oscillator(chip.address, chip.frequency_hz, chip.oscillator_hz),
            hold_when_safe: chip.hold_when_safe,
            servos: servos.iter().take(MAX_SERVOS).map(new).collect(),
            next: 0,
        }
    }

    /// Commands `angle`, rad, limited to its travel, for servo number `index` of the configuration; ignores NaN.
    pub fn command(&mut self, index: usize, angle: f32) {
        let servo = &mut self.servos[index];
        let travel = servo.config.position();
        if !angle.is_nan() {
            let target = angle.max(travel.min).min(travel.max);
            servo.motion = Some(Motion { angle: servo.motion.map_or(target, |motion| motion.angle), target });
        }
    }

    /// Advances the requested angles by one step of `period_s`, s, towards the commands.
    pub fn step(&mut self, period_s: f32) {
        for servo in &mut self.servos {
            if let Some(motion) = servo.motion.as_mut().filter(|motion| motion.angle != motion.target) {
                motion.angle = towards(motion.angle, motion.target, servo.config.speed_max * period_s);
            }
        }
    }

    /// Angle requested of servo number `index` at present, rad; `None` without pulses.
    #[must_use]
    pub fn angle(&self, index: usize) -> Option<f32> {
        self.servos[index].angle()
    }

    /// Angle requested of each servo at present, rad; `None` without pulses.
    pub fn angles(&self) -> impl Iterator<Item = Option<f32>> + '_ {
        self.servos.iter().map(Servo::angle)
    }

    /// Number of servos of the chip.
    #[must_use]
    pub fn count(&self) -> usize {
        self.servos.len()
    }

    /// Number of calls of [`Servos::next_write`] in a control period of `period_s`, s, that writes each moving servo
    /// every 20 ms: one, for up to 16 servos and 1.25 ms.
    #[must_use]
    pub fn writes_per_period(&self, period_s: f32) -> usize {
        libm::ceilf(self.servos.len() as f32 * period_s / UPDATE_S) as usize
    }

    /// Returns the write for the next servo in turn that has a new pulse, [`Servos::WRITE_BYTES`] long; `None` when
    /// none has. Call [`Servos::sent`] once it has been sent: until then that servo may have either pulse.
    pub fn next_write(&mut self) -> Option<(Write, Pulse)> {
        let count = self.servos.len();
        let (index, output) = (self.next..count).chain(0..self.next).find_map(|index| {
            let servo = &self.servos[index];
            // The same angle gives the same pulse: skip the computation.
            if servo.written.is_some() && servo.sent == servo.angle() {
                return None;
            }
            let wanted = servo.wanted(&self.chip);
            (servo.written != Some(wanted)).then_some((index, wanted))
        })?;
        self.next = (index + 1) % count;
        let servo = &mut self.servos[index];
        servo.written = None;
        let angle = servo.angle();
        Some((self.chip.set_off_count(servo.config.output, output), Pulse { index, output, angle }))
    }

    /// Records that the write with this pulse has been sent.
    pub fn sent(&mut self, pulse: Pulse) {
        let servo = &mut self.servos[pulse.index];
        (servo.written, servo.sent) = (Some(pulse.output), pulse.angle);
    }

    /// Brings the chip from any state to one without pulses, and reads that back; see [`Pca9685::init`].
    ///
    /// # Errors
    /// [`ChipError::Bus`] for a failed transfer, [`ChipError::Mismatch`] for a register that does not hold what was
    /// written.
    pub async fn init<B: I2c>(&mut self, bus: &mut B) -> Result<(), ChipError<B::Error>> {
        self.forget();
        self.chip.init(bus).await?;
        self.now_off();
        Ok(())
    }

    /// Ends all pulses of a chip in any state and reads nothing back; with `hold_when_safe` leaves the chip alone.
    ///
    /// # Errors
    /// The bus's error, for a failed transfer.
    pub async fn force_safe<B: I2c>(&mut self, bus: &mut B) -> Result<(), B::Error> {
        self.forget();
        if self.hold_when_safe { Ok(()) } else { self.chip.force_off(bus).await }
    }

    /// Ends all pulses in one transfer of 3 bytes, or, with `hold_when_safe`, stops all motion without a transfer.
    ///
    /// # Errors
    /// The bus's error, for a failed transfer.
    pub async fn make_safe<B: I2c>(&mut self, bus: &mut B) -> Result<(), B::Error> {
        if self.hold_when_safe {
            // Servos are held at their present pulses, not at queued ones: nothing moves now, nor at the next arming.
            for servo in &mut self.servos {
                servo.motion = servo.sent.map(|angle| Motion { angle, target: angle });
            }
            return Ok(());
        }
        self.forget();
        self.chip.all_off(bus).await?;
        self.now_off();
        Ok(())
    }

    /// Reads mode and prescaler of the chip back and compares.
    ///
    /// # Errors
    /// [`ChipError::Bus`] for a failed transfer, [`ChipError::Mismatch`] for a register that does not hold what was
    /// written.
    pub async fn verify_mode<B: I2c>(&self, bus: &mut B) -> Result<(), ChipError<B::Error>> {
        self.chip.verify_mode(bus).await
    }

    /// Reads the pulse of servo number `index` back and compares it with the last one written.
    ///
    /// # Errors
    /// [`ChipError::Bus`] for a failed transfer, [`ChipError::Mismatch`] for a register that does not hold what was
    /// written.
    pub async fn verify<B: I2c>(&self, bus: &mut B, index: usize) -> Result<(), ChipError<B::Error>> {
        let servo = &self.servos[index];
        match servo.written {
            Some(Output::LOW) => self.chip.verify_off(bus, servo.config.output).await,
            Some(output) => self.chip.verify(bus, servo.config.output, output).await,
            None => Ok(()),
        }
    }

    fn forget(&mut self) {
        for servo in &mut self.servos {
            (servo.motion, servo.written, servo.sent) = (None, None, None);
        }
    }

    /// Records that all outputs of the chip have just been turned off.
    fn now_off(&mut self) {
        for servo in &mut self.servos {
            servo.written = Some(Output::LOW);
        }
    }
}

impl Servo {
    fn angle(&self) -> Option<f32> {
        self.motion.map(|motion| motion.angle)
    }

    fn wanted(&self, chip: &Pca9685) -> Output {
        self.motion.map_or(Output::LOW, |motion| chip.pulse(self.pulse_s(motion.angle)))
    }

    /// Pulse length for `angle`, rad, in s: linear between the two configured points, and limited to them.
    fn pulse_s(&self, angle: f32) -> f32 {
        let (low, high) = (self.config.low, self.config.high);
        let share = (angle - low.angle_rad) / (high.angle_rad - low.angle_rad);
        (low.pulse_s + share * (high.pulse_s - low.pulse_s)).max(low.pulse_s).min(high.pulse_s)
    }
}

#[cfg(test)]
mod tests {
    use embassy_futures::{block_on, join::join};
    use embassy_time::Duration;
    use r4_protocol::{ChannelId, ChannelKind, config::ServoPoint};

    use super::*;
    use crate::testing::{Registers, Tasks};

    const CHIP: ServoChipConfig =
        ServoChipConfig { address: 0x42, frequency_hz: 50.0, oscillator_hz: 25e6, hold_when_safe: false };

    /// Servo with 1 ms at -1 rad and 2 ms at 1 rad, or the other way round; 2 rad/s.
    fn config(output: u8, sign: f32) -> ServoConfig {
        ServoConfig {
            id: ChannelId::new(ChannelKind::Servo, output),
            output,
            low: ServoPoint { pulse_s: 1e-3, angle_rad: -sign },
            high: ServoPoint { pulse_s: 2e-3, angle_rad: sign },
            speed_max: 2.0,
        }
    }

    fn pulses(servos: &Servos) -> [Output; 2] {
        [0, 1].map(|index| servos.servos[index].wanted(&servos.chip))
    }

    #[test]
    fn the_first_command_jumps_and_later_ones_are_limited() {
        let mut servos = Servos::new(CHIP, &[config(0, 1.0), config(5, -1.0)]);
        servos.step(1.0);
        assert_eq!((servos.angle(0), pulses(&servos)), (None, [Output::LOW; 2]));
        servos.command(0, 0.5);
        servos.command(1, 0.5);
        // Pulses of 1.75 ms and 1.25 ms at 4.88 us per count: 358.6 and 256.1 counts.
        assert_eq!(pulses(&servos).map(Output::registers), [[0, 0, 0x67, 0x01], [0, 0, 0x00, 0x01]]);
        servos.command(0, -5.0);
        servos.step(0.25);
        assert_eq!(servos.angle(0), Some(0.0));
        servos.step(10.0);
        assert_eq!(servos.angle(0), Some(-1.0), "the end of its travel");
        assert_eq!(pulses(&servos)[0].registers(), [0, 0, 0xCD, 0x00]); // 1 ms is 204.9 counts
        servos.command(0, f32::NAN);
        servos.command(1, f32::INFINITY);
        servos.step(10.0);
        assert_eq!([0, 1].map(|index| servos.angle(index)), [Some(-1.0), Some(1.0)]);
    }

    #[test]
    fn calls_for_a_write_of_each_in_20_ms() {
        let all: Vec<_, MAX_SERVOS> = (0..16).map(|output| config(output, 1.0)).collect();
        for (count, period_s, calls) in [(0, 0.001, 0), (1, 0.001, 1), (16, 0.001, 1), (16, 0.002, 2), (16, 0.02, 16)] {
            assert_eq!(Servos::new(CHIP, &all[..count]).writes_per_period(period_s), calls, "{count} at {period_s} s");
        }
    }

    /// Servos on outputs 0, 5 and 3 of a chip on a bus that is set up.
    fn rig(hold_when_safe: bool) -> (Servos, Registers) {
        let mut servos =
            Servos::new(ServoChipConfig { hold_when_safe, ..CHIP }, &[0, 5, 3].map(|output| config(output, 1.0)));
        let mut bus = Registers::default();
        init(&mut servos, &mut bus);
        (servos, bus)
    }

    /// Sets up the servos, which waits for the chip's oscillator.
    fn init(servos: &mut Servos, bus: &mut Registers) {
        let wait = async { Tasks::default().advance(Duration::from_millis(1)) };
        let (result, ()) = block_on(join(servos.init(bus), wait));
        result.expect("the chip answers");
    }

    /// Sends the due write and returns its output.
    fn write(servos: &mut Servos, bus: &mut Registers) -> Option<u8> {
        let (write, pulse) = servos.next_write()?;
        assert_eq!((write.address(), write.bytes().len() as u32 + 1), (0x42, Servos::WRITE_BYTES));
        block_on(write.send(bus)).expect("the bus works");
        servos.sent(pulse);
        Some((write.bytes()[0] - 8) / 4)
    }

    /// Register bytes of 1.5 ms, the middle, and of 1 ms, at -1 rad.
    const MIDDLE: [u8; 2] = [0x33, 0x01];
    const LOWEST: [u8; 2] = [0xCD, 0x00];

    fn pulse(bus: &Registers, output: u8) -> [u8; 2] {
        [2, 3].map(|byte| bus.get(0x42, 6 + 4 * output + byte))
    }

    /// Servos are written in turn, each on its own output; a servo whose write was not sent, or that has moved on,
    /// comes again after the others.
    #[test]
    fn servos_take_turns() {
        let (mut servos, mut bus) = rig(false);
        assert_eq!(servos.count(), 3);
        assert!(servos.next_write().is_none());
        for index in 0..3 {
            servos.command(index, 0.0);
        }
        assert_eq!([0; 4].map(|_| write(&mut servos, &mut bus)), [Some(0), Some(5), Some(3), None]);
        assert_eq!([0, 5, 3].map(|output| pulse(&bus, output)), [MIDDLE; 3]);
        for index in [0, 2] {
            servos.command(index, -1.0);
        }
        servos.step(0.5);
        assert_eq!(write(&mut servos, &mut bus), Some(0));
        // Its write was dropped by a stop: it may have either pulse.
        let (left_off, _) = servos.next_write().expect("the last");
        assert_eq!(left_off.bytes()[0], 6 + 4 * 3 + 2);
        servos.command(0, 0.0);
        servos.step(0.5);
        assert_eq!([0; 3].map(|_| write(&mut servos, &mut bus)), [Some(0), Some(3), None]);
        assert_eq!([0, 5, 3].map(|output| pulse(&bus, output)), [MIDDLE, MIDDLE, LOWEST]);
    }

    /// Without pulses servos are limp, and the next command counts as a first one again.
    #[test]
    fn when_safe_pulses_end() {
        let (mut servos, mut bus) = rig(false);
        servos.command(1, -1.0);
        write(&mut servos, &mut bus);
        block_on(servos.make_safe(&mut bus)).expect("the bus works");
        assert_eq!((servos.angle(1), pulse(&bus, 5)), (None, [LOWEST[0], 0x10]));
        assert!(servos.next_write().is_none());
        assert!(block_on(servos.verify(&mut bus, 1)).is_ok());
        servos.command(1, 0.0);
        assert_eq!(servos.angle(1), Some(0.0), "at once");
        write(&mut servos, &mut bus);
        // Force also works on a chip in any state, whose outputs may be inverted.
        bus.set(0x42, 0x01, 0x10);
        block_on(servos.force_safe(&mut bus)).expect("the bus works");
        assert_eq!((servos.angle(1), pulse(&bus, 5)[1], bus.get(0x42, 0x01)), (None, 0x10, 0x04));
        for call in [true, false] {
            bus.fail(1);
            let result =
                if call { block_on(servos.make_safe(&mut bus)) } else { block_on(servos.force_safe(&mut bus)) };
            assert!(result.is_err());
        }
    }

    /// Held servos keep the last pulse sent, not their target; nothing is written.
    #[test]
    fn servos_that_are_held_stay_where_they_were_sent() {
        let (mut servos, mut bus) = rig(true);
        for index in [0, 1] {
            servos.command(index, 0.0);
            write(&mut servos, &mut bus);
        }
        servos.command(0, -1.0);
        servos.step(0.25);
        servos.command(2, 0.5);
        bus.fail(1);
        assert!(block_on(servos.make_safe(&mut bus)).is_ok());
        bus.fail(0);
        assert_eq!([0, 1, 2].map(|index| servos.angle(index)), [Some(0.0), Some(0.0), None]);
        servos.step(10.0);
        assert_eq!(servos.angle(0), Some(0.0));
        // As after a reset of the processor: the angles are unknown, and the servos are left alone.
        bus.fail(1);
        assert!(block_on(servos.force_safe(&mut bus)).is_ok());
        bus.fail(0);
        assert_eq!((servos.angle(0), pulse(&bus, 0)), (None, MIDDLE));
    }

    /// Deviations of a pulse, its end, mode or prescaler from what was written are found; a pulse whose write is
    /// pending is not checked.
    #[test]
    fn a_register_that_changes_is_found() {
        let (mut servos, mut bus) = rig(false);
        let ok = |servos: &Servos, bus: &mut Registers| {
            (
                [0, 1, 2].map(|index| block_on(servos.verify(bus, index)).is_ok()),
                block_on(servos.verify_mode(bus)).is_ok(),
            )
        };
        servos.command(0, 0.0);
        write(&mut servos, &mut bus);
        assert_eq!(ok(&servos, &mut bus), ([true; 3], true));
        bus.set(0x42, 0xFE, bus.get(0x42, 0xFE) ^ 1);
        assert_eq!(ok(&servos, &mut bus), ([true; 3], false));
        bus.set(0x42, 0xFE, bus.get(0x42, 0xFE) ^ 1);
        bus.set(0x42, 8, 0);
        bus.set(0x42, 6 + 4 * 3 + 3, 0);
        assert_eq!(ok(&servos, &mut bus), ([false, true, false], true));
        // A write of this servo is pending.
        servos.command(0, 1.0);
        servos.step(1.0);
        servos.next_write().expect("it moves");
        assert_eq!(ok(&servos, &mut bus), ([true, true, false], true));
        // A new set-up corrects all registers and forgets the angles.
        init(&mut servos, &mut bus);
        assert_eq!((ok(&servos, &mut bus), servos.angle(0)), (([true; 3], true), None));
    }
}
