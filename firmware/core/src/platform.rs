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
}

/// The divided analog inputs, sampled by hardware at least once per control period.
pub trait AnalogInputs {
    /// The latest code of input `index`, 0..=65535 for 0 V to the reference. Numbers the board does not have read 0.
    fn code(&mut self, index: u8) -> u16;
}
