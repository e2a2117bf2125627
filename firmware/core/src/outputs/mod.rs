//! The board's outputs: the one owner of the I2C bus, of the order of writes and of the safe state.

pub mod osmc;

use heapless::Vec;
use r4_protocol::config::{BoardConfig, MAX_MOTORS};

use crate::{
    chips::pca9685::{Pca9685, PwmError},
    platform::Bus,
};
use osmc::Bridge;

/// Why outputs are not what they should be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OutputFault {
    /// Transfers fail, also after a repeat and after freeing the bus.
    Bus,
    /// A chip does not hold what was written.
    Mismatch,
}

/// A transfer that fails so often has failed.
const TRIES: u32 = 3;

/// The outputs of one board.
pub struct Outputs<B> {
    bus: B,
    osmc: Pca9685,
    bridges: Vec<Bridge, MAX_MOTORS>,
    next_check: usize,
    retries: u32,
}

impl<B: Bus> Outputs<B> {
    /// The outputs as `config` wires them, or none to drive when it is not valid. Call [`Outputs::init`] before anything else.
    #[must_use]
    pub fn new(bus: B, config: &BoardConfig) -> Self {
        let osmc = Pca9685::new(config.osmc_pwm.address, config.osmc_pwm.frequency_hz);
        // A change takes effect at the end of the running PWM period; a whole one must then pass with both low sides off.
        let reversal = 2 * osmc.period();
        let motors = config.motors.iter().filter(|_| config.validate().is_ok());
        Self {
            bus,
            bridges: motors.map(|motor| Bridge::new(motor.lines, motor.inverted, reversal)).collect(),
            osmc,
            next_check: 0,
            retries: 0,
        }
    }

    /// Brings every output chip from any state into a known one with all outputs off.
    ///
    /// # Errors
    /// See [`OutputFault`]; outputs may then be in any state the chips were in.
    pub async fn init(&mut self) -> Result<(), OutputFault> {
        let osmc = self.osmc;
        self.checked(async |bus: &mut B| osmc.init(bus).await).await?;
        self.bridges.iter_mut().for_each(Bridge::now_off);
        Ok(())
    }

    /// Turns every motor output off, whatever it did.
    ///
    /// # Errors
    /// [`OutputFault::Bus`]; the lines of [`crate::safety::SafetyPins`] still hold the bridges.
    pub async fn make_safe(&mut self) -> Result<(), OutputFault> {
        let osmc = self.osmc;
        self.checked(async |bus: &mut B| Ok(osmc.all_off(bus).await?)).await?;
        self.bridges.iter_mut().for_each(Bridge::now_off);
        Ok(())
    }

    /// Drives bridge `index` at `duty`, within its rules, and returns the duty it now has.
    ///
    /// # Errors
    /// [`OutputFault::Bus`]; the bridge then still does what it did before.
    pub async fn drive(&mut self, index: usize, duty: f32) -> Result<f32, OutputFault> {
        let osmc = self.osmc;
        let mut bridge = self.bridges[index];
        let applied = self.checked(async |bus: &mut B| Ok(bridge.drive(&osmc, bus, duty).await?)).await?;
        self.bridges[index] = bridge;
        Ok(applied)
    }

    /// Reads one thing back and compares; each call takes the next one in turn.
    ///
    /// # Errors
    /// See [`OutputFault`].
    pub async fn check_next(&mut self) -> Result<(), OutputFault> {
        let step = self.next_check;
        self.next_check = (step + 1) % (1 + 4 * self.bridges.len());
        let osmc = self.osmc;
        let Some(line) = step.checked_sub(1) else {
            return self.checked(async |bus: &mut B| osmc.verify_mode(bus).await).await;
        };
        let bridge = self.bridges[line / 4];
        self.checked(async |bus: &mut B| bridge.verify(&osmc, bus, line % 4).await).await
    }

    /// Transfers that had to be repeated since the last call.
    pub fn take_retries(&mut self) -> u32 {
        core::mem::take(&mut self.retries)
    }

    /// Frees the bus after a failed transfer and repeats it, twice. A bus that is held must be freed first: every try on
    /// it costs a time-out.
    async fn checked<T>(
        &mut self,
        mut operation: impl AsyncFnMut(&mut B) -> Result<T, PwmError<B::Error>>,
    ) -> Result<T, OutputFault> {
        let mut tries = 1;
        loop {
            match operation(&mut self.bus).await {
                Ok(done) => return Ok(done),
                Err(PwmError::Mismatch { .. }) => return Err(OutputFault::Mismatch),
                Err(PwmError::Bus(_)) if tries == TRIES => return Err(OutputFault::Bus),
                Err(PwmError::Bus(_)) => self.bus.recover().await,
            }
            tries += 1;
            self.retries += 1;
        }
    }
}
