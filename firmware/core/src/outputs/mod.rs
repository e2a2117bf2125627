//! The board's outputs on I2C: the one owner of the bus, of the order of writes and of the safe state.

pub mod bridge;
mod expander;

use heapless::Vec;
use r4_protocol::config::{BoardConfig, MAX_MOTORS};

use crate::{
    chips::{ChipError, pca9685::Pca9685},
    platform::Bus,
};
use bridge::Bridge;
use expander::Expander;

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
/// Share of a control period that transfers may take: what is left is for the processor and for a repeat.
const BUS_SHARE: f32 = 0.92;
/// Bits on the bus for a byte, and for what is around the bytes of a transfer.
const BITS_PER_BYTE: f32 = 9.0;
/// Most bytes on the bus to read one thing back: mode and prescaler of a PWM chip, each with two addresses and a register.
const CHECK_BYTES: u32 = 9;
/// Bytes on the bus to set the expander.
const EXPANDER_BYTES: u32 = 4;

/// The outputs of one board.
pub struct Outputs<B> {
    bus: B,
    osmc: Option<Pca9685>,
    dhb: Option<Pca9685>,
    bridges: Vec<Bridge, MAX_MOTORS>,
    expander: Option<Expander>,
    /// Bytes that fit a control period, and those left of this one.
    bytes_per_tick: u32,
    bytes_left: u32,
    next_check: usize,
    retries: u32,
}

impl<B: Bus> Outputs<B> {
    /// The outputs as `config` wires them, or none to drive when it is not valid. Call [`Outputs::init`] before anything else.
    #[must_use]
    pub fn new(bus: B, config: &BoardConfig) -> Self {
        let chip = |pwm: r4_protocol::config::PwmConfig| Pca9685::new(pwm.address, pwm.frequency_hz);
        let (osmc, dhb) = (config.osmc_pwm.map(chip), config.dhb_pwm.map(chip));
        let valid = config.validate().is_ok();
        let motors = config.motors.iter().filter(|_| valid);
        let bridges = motors.map(|motor| {
            let chip = if let r4_protocol::config::BridgeConfig::Osmc(_) = motor.bridge { osmc } else { dhb };
            // A change takes effect at the end of the running PWM period; a whole one must then pass with the bridge at rest.
            let reversal = chip.map_or(embassy_time::Duration::MIN, |chip| 2 * chip.period());
            Bridge::new(motor.bridge, motor.inverted, reversal)
        });
        let expander = config.expander.filter(|_| valid);
        let period_s = config.control_period_us as f32 * 1e-6;
        let bytes_per_tick = (period_s * BUS_SHARE * config.i2c_hz as f32 / BITS_PER_BYTE) as u32;
        Self {
            bus,
            bridges: bridges.collect(),
            osmc,
            dhb,
            expander: expander.map(|expander| Expander::new(expander, config.relays.clone())),
            bytes_per_tick,
            bytes_left: bytes_per_tick,
            next_check: 0,
            retries: 0,
        }
    }

    /// Brings every output chip from any state into a known one with all outputs off.
    ///
    /// # Errors
    /// See [`OutputFault`]; outputs may then be in any state the chips were in.
    pub async fn init(&mut self) -> Result<(), OutputFault> {
        self.expander_safe(async |expander: &mut Expander, bus: &mut B| expander.init(bus).await).await?;
        for chip in self.bridge_chips() {
            self.checked(async |bus: &mut B| chip.init(bus).await).await?;
        }
        self.bridges.iter_mut().for_each(Bridge::now_off);
        Ok(())
    }

    /// Opens every relay, the motors' supply with them, then turns every motor output off, whatever they did.
    ///
    /// # Errors
    /// [`OutputFault::Bus`], after all were tried; the lines of [`crate::safety::SafetyPins`] still hold the bridges.
    pub async fn make_safe(&mut self) -> Result<(), OutputFault> {
        let mut result =
            self.expander_safe(async |expander: &mut Expander, bus: &mut B| Ok(expander.rewrite(bus).await?)).await;
        for chip in self.bridge_chips() {
            let off = self.checked(async |bus: &mut B| Ok(chip.all_off(bus).await?)).await;
            result = result.and(off);
        }
        if result.is_ok() {
            self.bridges.iter_mut().for_each(Bridge::now_off);
        }
        result
    }

    /// The PWM chips behind bridges.
    fn bridge_chips(&self) -> impl Iterator<Item = Pca9685> + use<B> {
        self.osmc.into_iter().chain(self.dhb)
    }

    /// Opens all relays and lets `write` tell the chip.
    async fn expander_safe(
        &mut self,
        mut write: impl AsyncFnMut(&mut Expander, &mut B) -> Result<(), ChipError<B::Error>>,
    ) -> Result<(), OutputFault> {
        let Some(mut expander) = self.expander.take() else { return Ok(()) };
        expander.open_all();
        let result = self.checked(async |bus: &mut B| write(&mut expander, bus).await).await;
        self.expander = Some(expander);
        result
    }

    /// A control period begins: the bus is free again.
    pub fn begin_tick(&mut self) {
        self.bytes_left = self.bytes_per_tick;
    }

    /// Takes `bytes` out of what is left of this period; false when they do not fit, and must wait.
    fn fits(&mut self, bytes: u32) -> bool {
        let left = self.bytes_left.checked_sub(bytes);
        self.bytes_left = left.unwrap_or(self.bytes_left);
        left.is_some()
    }

    /// Whether the motors' supply goes over a relay.
    #[must_use]
    pub fn has_motor_power_relay(&self) -> bool {
        self.expander.as_ref().is_some_and(Expander::has_motor_power)
    }

    /// Closes the motors' supply, with the next [`Outputs::write_expander`].
    pub fn close_motor_power(&mut self) {
        self.expander.iter_mut().for_each(Expander::close_motor_power);
    }

    /// Closes or opens relay number `index` of the configuration, with the next [`Outputs::write_expander`].
    pub fn switch(&mut self, index: usize, closed: bool) {
        self.expander.iter_mut().for_each(|expander| expander.switch(index, closed));
    }

    /// Whether relay number `index` of the configuration is told to be closed.
    #[must_use]
    pub fn is_closed(&self, index: usize) -> bool {
        self.expander.as_ref().is_some_and(|expander| expander.is_closed(index))
    }

    /// Tells the expander what has changed, if anything has.
    ///
    /// # Errors
    /// [`OutputFault::Bus`]; its pins may then be in either state.
    pub async fn write_expander(&mut self) -> Result<(), OutputFault> {
        let Some(mut expander) = self.expander.take_if(|expander| expander.has_changed()) else { return Ok(()) };
        // Never waits: it comes first in every period.
        self.fits(EXPANDER_BYTES);
        let result = self.checked(async |bus: &mut B| Ok(expander.rewrite(bus).await?)).await;
        self.expander = Some(expander);
        result
    }

    /// Drives bridge `index` at `duty`, within its rules, and returns the duty it now has. What does not fit this period
    /// on the bus is left to the next.
    ///
    /// # Errors
    /// [`OutputFault::Bus`]; the bridge then still does what it did before.
    pub async fn drive(&mut self, index: usize, duty: f32) -> Result<f32, OutputFault> {
        let mut bridge = self.bridges[index];
        let Some(chip) = self.chip_of(bridge) else { return Ok(0.0) };
        if !self.fits(bridge.bytes(duty)) {
            return Ok(bridge.applied());
        }
        let applied = self.checked(async |bus: &mut B| Ok(bridge.drive(&chip, bus, duty).await?)).await?;
        self.bridges[index] = bridge;
        Ok(applied)
    }

    /// The bridges in the order in which they are written in period number `tick`: OSMC first, then DHB, each group
    /// beginning with another one each time, so that those which have to wait take turns.
    pub fn order(&self, tick: u32) -> Vec<usize, MAX_MOTORS> {
        let count = self.bridges.len();
        let turned = (0..count).map(|place| (place + tick as usize) % count);
        let (osmc, dhb): (Vec<_, MAX_MOTORS>, Vec<_, MAX_MOTORS>) =
            turned.partition(|index| self.bridges[*index].is_osmc());
        osmc.into_iter().chain(dhb).collect()
    }

    fn chip_of(&self, bridge: Bridge) -> Option<Pca9685> {
        if bridge.is_osmc() { self.osmc } else { self.dhb }
    }

    /// Reads one thing back and compares; each call takes the next one in turn. Waits when it does not fit this period.
    ///
    /// # Errors
    /// See [`OutputFault`].
    pub async fn check_next(&mut self) -> Result<(), OutputFault> {
        if !self.fits(CHECK_BYTES) {
            return Ok(());
        }
        let checks = 1 + self.bridge_chips().count() + self.bridges.iter().map(Bridge::line_count).sum::<usize>();
        let mut step = self.next_check;
        self.next_check = (step + 1) % checks;
        if step == 0 {
            let Some(expander) = self.expander.clone() else { return Ok(()) };
            return self.checked(async |bus: &mut B| expander.verify(bus).await).await;
        }
        step -= 1;
        for chip in self.bridge_chips() {
            if step == 0 {
                return self.checked(async |bus: &mut B| chip.verify_mode(bus).await).await;
            }
            step -= 1;
        }
        for bridge in self.bridges.clone() {
            if let (Some(chip), true) = (self.chip_of(bridge), step < bridge.line_count()) {
                return self.checked(async |bus: &mut B| bridge.verify(&chip, bus, step).await).await;
            }
            step -= bridge.line_count().min(step);
        }
        Ok(())
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
