//! Drivers of the board's chips, on `embedded-hal-async` I2C.

pub mod as5600;
pub mod icm20948;
pub mod ina226;
pub mod mcp23017;
pub mod mcp4728;
pub mod nau7802;
pub mod pca9685;
pub mod sensor;
pub mod vl6180x;

/// Why an operation did not succeed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ChipError<E> {
    /// The transfer failed.
    Bus(E),
    /// A register does not hold what was written.
    Mismatch {
        /// Which.
        register: u8,
        /// What was written.
        written: u8,
        /// What was read.
        read: u8,
    },
}

impl<E> From<E> for ChipError<E> {
    fn from(error: E) -> Self {
        Self::Bus(error)
    }
}

/// Compares registers from `first` on with what was written.
fn compare<E, const N: usize>(first: u8, written: [u8; N], read: [u8; N]) -> Result<(), ChipError<E>> {
    // The count comes second: a zip asks its first side once more at the end, and the last register is 0xFF.
    let mut compared = written.into_iter().zip(read).zip(first..);
    match compared.find(|((written, read), _)| written != read) {
        Some(((written, read), register)) => Err(ChipError::Mismatch { register, written, read }),
        None => Ok(()),
    }
}
