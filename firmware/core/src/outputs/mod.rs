//! The board's outputs: the one owner of the I2C bus, of the order of writes and of the safe state.

pub mod osmc;
mod relays;

use heapless::Vec;
use r4_protocol::config::{BoardConfig, MAX_MOTORS};

use crate::{
    chips::{ChipError, pca9685::Pca9685},
    platform::Bus,
};
use osmc::Bridge;
use relays::Relays;

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
    relays: Option<Relays>,
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
        let valid = config.validate().is_ok();
        let motors = config.motors.iter().filter(|_| valid);
        let expander = config.expander.filter(|_| valid);
        Self {
            bus,
            bridges: motors.map(|motor| Bridge::new(motor.lines, motor.inverted, reversal)).collect(),
            osmc,
            relays: expander.map(|expander| Relays::new(expander, config.relays.clone())),
            next_check: 0,
            retries: 0,
        }
    }

    /// Brings every output chip from any state into a known one with all outputs off.
    ///
    /// # Errors
    /// See [`OutputFault`]; outputs may then be in any state the chips were in.
    pub async fn init(&mut self) -> Result<(), OutputFault> {
        self.relays_open(async |relays: &mut Relays, bus: &mut B| relays.init(bus).await).await?;
        let osmc = self.osmc;
        self.checked(async |bus: &mut B| osmc.init(bus).await).await?;
        self.bridges.iter_mut().for_each(Bridge::now_off);
        Ok(())
    }

    /// Opens every relay, the motors' supply with them, then turns every motor output off, whatever they did.
    ///
    /// # Errors
    /// [`OutputFault::Bus`], after both were tried; the lines of [`crate::safety::SafetyPins`] still hold the bridges.
    pub async fn make_safe(&mut self) -> Result<(), OutputFault> {
        let opened = self.relays_open(async |relays: &mut Relays, bus: &mut B| Ok(relays.rewrite(bus).await?)).await;
        let osmc = self.osmc;
        self.checked(async |bus: &mut B| Ok(osmc.all_off(bus).await?)).await?;
        self.bridges.iter_mut().for_each(Bridge::now_off);
        opened
    }

    /// Opens all relays and lets `write` tell the chip.
    async fn relays_open(
        &mut self,
        mut write: impl AsyncFnMut(&mut Relays, &mut B) -> Result<(), ChipError<B::Error>>,
    ) -> Result<(), OutputFault> {
        let Some(mut relays) = self.relays.take() else { return Ok(()) };
        relays.open_all();
        let result = self.checked(async |bus: &mut B| write(&mut relays, bus).await).await;
        self.relays = Some(relays);
        result
    }

    /// Whether the motors' supply goes over a relay.
    #[must_use]
    pub fn has_motor_power_relay(&self) -> bool {
        self.relays.as_ref().is_some_and(Relays::has_motor_power)
    }

    /// Closes the motors' supply, with the next [`Outputs::write_relays`].
    pub fn close_motor_power(&mut self) {
        self.relays.iter_mut().for_each(Relays::close_motor_power);
    }

    /// Closes or opens relay number `index` of the configuration, with the next [`Outputs::write_relays`].
    pub fn switch(&mut self, index: usize, closed: bool) {
        self.relays.iter_mut().for_each(|relays| relays.switch(index, closed));
    }

    /// Whether relay number `index` of the configuration is told to be closed.
    #[must_use]
    pub fn is_closed(&self, index: usize) -> bool {
        self.relays.as_ref().is_some_and(|relays| relays.is_closed(index))
    }

    /// Tells the relays what has changed, if anything has: one transfer of 3 bytes.
    ///
    /// # Errors
    /// [`OutputFault::Bus`]; the relays may then be in either state.
    pub async fn write_relays(&mut self) -> Result<(), OutputFault> {
        let Some(mut relays) = self.relays.take() else { return Ok(()) };
        let result = self.checked(async |bus: &mut B| Ok(relays.write(bus).await?)).await;
        self.relays = Some(relays);
        result
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
        self.next_check = (step + 1) % (2 + 4 * self.bridges.len());
        let osmc = self.osmc;
        if step == 0 {
            return self.checked(async |bus: &mut B| osmc.verify_mode(bus).await).await;
        }
        let Some(line) = step.checked_sub(2) else {
            let Some(relays) = self.relays.clone() else { return Ok(()) };
            return self.checked(async |bus: &mut B| relays.verify(bus).await).await;
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
        mut operation: impl AsyncFnMut(&mut B) -> Result<T, ChipError<B::Error>>,
    ) -> Result<T, OutputFault> {
        let mut tries = 1;
        loop {
            match operation(&mut self.bus).await {
                Ok(done) => return Ok(done),
                Err(ChipError::Mismatch { .. }) => return Err(OutputFault::Mismatch),
                Err(ChipError::Bus(_)) if tries == TRIES => return Err(OutputFault::Bus),
                Err(ChipError::Bus(_)) => self.bus.recover().await,
            }
            tries += 1;
            self.retries += 1;
        }
    }
}
