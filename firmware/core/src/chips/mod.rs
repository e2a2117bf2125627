//! Drivers of the board's chips, on `embedded-hal-async` I2C.

pub mod any;
pub mod as5600;
pub mod icm20948;
pub mod ina226;
pub mod mcp23017;
pub mod mcp4728;
pub mod nau7802;
pub mod pca9685;
pub mod sensor;
pub mod vl6180x;

/// Error of an operation on a chip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ChipError<E> {
    /// The transfer failed.
    Bus(E),
    /// A register does not hold what was written.
    Mismatch {
        /// Address of the register (for the MCP4728: index of the byte read).
        register: u8,
        /// Value that was written.
        written: u8,
        /// Value that was read back.
        read: u8,
    },
}

impl<E> From<E> for ChipError<E> {
    fn from(error: E) -> Self {
        Self::Bus(error)
    }
}

/// Compares consecutive registers, the first at address `first`, with the values written to them.
fn compare<E, const N: usize>(first: u8, written: [u8; N], read: [u8; N]) -> Result<(), ChipError<E>> {
    // The register count comes second: a zip polls its first side once more at the end, and 0xFF + 1 would overflow.
    let mut compared = written.into_iter().zip(read).zip(first..);
    match compared.find(|((written, read), _)| written != read) {
        Some(((written, read), register)) => Err(ChipError::Mismatch { register, written, read }),
        None => Ok(()),
    }
}
