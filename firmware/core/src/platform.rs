//! What a board must offer beyond `embedded-hal-async` and `embedded-io-async`.

use embedded_hal_async::i2c::I2c;

/// An I2C bus that can be freed when a chip holds it.
#[allow(async_fn_in_trait, reason = "single-core executors: futures need not be Send")]
pub trait Bus: I2c {
    /// Clocks SCL nine times with SDA released, sends a STOP and starts the controller afresh (UM10204, 3.1.16).
    async fn recover(&mut self);
}

/// The quadrature counters: four counts to an encoder line, wrapping at 16 bits.
pub trait Encoders {
    /// The present count of encoder `index`. Numbers the board does not have read 0.
    fn count(&mut self, index: u8) -> u16;

    /// Transitions of encoder `index` since power-up in which both tracks changed, which no shaft does; 0 where a timer
    /// counts, for it cannot tell.
    fn illegal(&mut self, index: u8) -> u32;
}

/// The switches beside the encoders.
pub trait SwitchInputs {
    /// The level of switch input `index`. Inputs are pulled up; numbers the board does not have read high.
    fn is_high(&mut self, index: u8) -> bool;
}

/// The processor's own analog outputs.
pub trait AnalogOutputs {
    /// Sets output `index` to a share of the reference, 0..=4095 of 4096. Numbers the board does not have do nothing.
    fn set(&mut self, index: u8, code: u16);
}

/// The divided analog inputs, sampled by hardware at least once per control period.
pub trait AnalogInputs {
    /// The latest code of input `index`, 0..=65535 for 0 V to the reference. Numbers the board does not have read 0.
    fn code(&mut self, index: u8) -> u16;
}

/// Everything of the processor that the control loop uses, in one.
pub trait Peripherals: Encoders + AnalogInputs + SwitchInputs + AnalogOutputs {}

impl<P: Encoders + AnalogInputs + SwitchInputs + AnalogOutputs> Peripherals for P {}
