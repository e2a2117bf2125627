//! MCP23017 port expander: sixteen inputs or outputs, used here as outputs (Microchip DS20001952).

use embedded_hal_async::i2c::I2c;

use super::ChipError;

/// `IODIRA`, then `IODIRB`: 1 is an input (3.5.1, with IOCON.BANK = 0 as after reset).
const IODIRA: u8 = 0x00;
/// `IOCON` (3.5.6); 0 after reset: banks interleaved, pointer increments.
const IOCON: u8 = 0x0A;
/// `OLATA`, then `OLATB`: the output latches (3.5.11).
const OLATA: u8 = 0x14;
/// Address of `IOCON` while its BANK bit is set. In the other map this is `GPINTENB`, where writing 0 does no harm.
const IOCON_IN_BANK_1: u8 = 0x05;

/// An MCP23017 whose sixteen pins are outputs. Each call borrows the bus.
#[derive(Clone, Copy, Debug)]
pub struct Mcp23017 {
    address: u8,
}

impl Mcp23017 {
    /// Creates a driver of the chip at `address`.
    #[must_use]
    pub const fn new(address: u8) -> Self {
        Self { address }
    }

    /// Makes all pins outputs at `levels` (bit 0 is A0, bit 8 is B0) without a glitch, and reads back.
    ///
    /// Latches are written first, because a pin that becomes an output shows its latch at once. Takes about 0.5 ms at
    /// 400 kHz.
    ///
    /// # Errors
    /// [`ChipError::Bus`] for a failed transfer, [`ChipError::Mismatch`] for a register that does not hold what was
    /// written.
    pub async fn init<B: I2c>(&self, bus: &mut B, levels: u16) -> Result<(), ChipError<B::Error>> {
        self.force(bus, levels).await?;
        self.verify(bus, levels).await
    }

    /// Drives all pins to `levels` from any state of the chip and reads nothing back: the first half of
    /// [`Mcp23017::init`], 0.3 ms at 400 kHz.
    ///
    /// # Errors
    /// The bus's error, for a failed transfer.
    pub async fn force<B: I2c>(&self, bus: &mut B, levels: u16) -> Result<(), B::Error> {
        // BANK may be set or not: one of the two writes reaches IOCON in either register map, and after both the map is
        // that of reset.
        bus.write(self.address, &[IOCON_IN_BANK_1, 0]).await?;
        bus.write(self.address, &[IOCON, 0]).await?;
        self.set(bus, levels).await?;
        bus.write(self.address, &[IODIRA, 0, 0]).await
    }

    /// Reads the levels that the pins are driven to; `None` unless all pins are outputs, as after power-up.
    ///
    /// # Errors
    /// The bus's error, for a failed transfer.
    pub async fn driven<B: I2c>(&self, bus: &mut B) -> Result<Option<u16>, B::Error> {
        let (mut directions, mut levels) = ([0; 2], [0; 2]);
        bus.write_read(self.address, &[IODIRA], &mut directions).await?;
        bus.write_read(self.address, &[OLATA], &mut levels).await?;
        Ok((directions == [0, 0]).then_some(u16::from_le_bytes(levels)))
    }

    /// Sets all pins in one transfer of 3 bytes.
    ///
    /// # Errors
    /// The bus's error, for a failed transfer.
    pub async fn set<B: I2c>(&self, bus: &mut B, levels: u16) -> Result<(), B::Error> {
        let [a, b] = levels.to_le_bytes();
        bus.write(self.address, &[OLATA, a, b]).await
    }

    /// Reads directions and latches back and compares them with outputs at `levels`.
    ///
    /// # Errors
    /// [`ChipError::Bus`] for a failed transfer, [`ChipError::Mismatch`] for a register that does not hold what was
    /// written.
    pub async fn verify<B: I2c>(&self, bus: &mut B, levels: u16) -> Result<(), ChipError<B::Error>> {
        for (register, written) in [(IODIRA, [0, 0]), (OLATA, levels.to_le_bytes())] {
            let mut read = [0; 2];
            bus.write_read(self.address, &[register], &mut read).await?;
            super::compare(register, written, read)?;
        }
        Ok(())
    }
}
