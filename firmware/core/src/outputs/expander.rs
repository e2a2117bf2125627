//! Port expander with relays and the lines of brushless drives.

use embedded_hal_async::i2c::I2c;
use heapless::Vec;
use r4_protocol::config::{ExpanderConfig, MAX_RELAYS, RelayConfig, RelayRole};

use crate::chips::{ChipError, mcp23017::Mcp23017};

/// One expander: its relays and lines, and the last levels written to its pins.
#[derive(Clone, Debug)]
pub(super) struct Expander {
    chip: Mcp23017,
    relays: Vec<RelayConfig, MAX_RELAYS>,
    /// Requested state of each relay, true for closed, by position in `relays`.
    closed: [bool; MAX_RELAYS],
    /// Levels of the brushless drives' lines.
    lines: u16,
    /// Levels last written to the pins; `None` when unknown.
    written: Option<u16>,
}

impl Expander {
    /// Creates an expander with open relays.
    pub(super) fn new(expander: ExpanderConfig, relays: Vec<RelayConfig, MAX_RELAYS>) -> Self {
        Self { chip: Mcp23017::new(expander.address), relays, closed: [false; MAX_RELAYS], lines: 0, written: None }
    }

    /// Returns true if a relay switches the motors' supply.
    pub(super) fn has_motor_power(&self) -> bool {
        self.relays.iter().any(|relay| relay.role == RelayRole::MotorPower)
    }

    /// Requests that all relays open, with the next write.
    pub(super) fn open_all(&mut self) {
        self.closed = [false; MAX_RELAYS];
    }

    /// Requests that all relays but the motors' supply open, with the next write.
    pub(super) fn open_general(&mut self) {
        for (closed, relay) in self.closed.iter_mut().zip(&self.relays) {
            *closed &= relay.role == RelayRole::MotorPower;
        }
    }

    /// Requests that one relay closes or opens, with the next [`Expander::rewrite`].
    pub(super) fn switch(&mut self, index: usize, closed: bool) {
        self.closed[index] = closed;
    }

    /// Requested state of each relay, true for closed.
    pub(super) fn closed(&self) -> impl Iterator<Item = bool> + '_ {
        self.closed.iter().copied().take(self.relays.len())
    }

    /// Sets the lines of the drives, effective with the next [`Expander::rewrite`]. Bits of relays must be 0.
    pub(super) fn set_lines(&mut self, levels: u16) {
        self.lines = levels;
    }

    /// Requests that the motors' supply closes, with the next [`Expander::rewrite`].
    pub(super) fn close_motor_power(&mut self) {
        for (closed, relay) in self.closed.iter_mut().zip(&self.relays) {
            *closed |= relay.role == RelayRole::MotorPower;
        }
    }

    /// Reads the pins' levels of a chip that was set up before the processor started; `None` if not all pins are
    /// outputs.
    pub(super) async fn driven<B: I2c>(&self, bus: &mut B) -> Result<Option<u16>, B::Error> {
        self.chip.driven(bus).await
    }

    /// Sets up the chip with the requested levels and reads them back.
    pub(super) async fn init<B: I2c>(&mut self, bus: &mut B) -> Result<(), ChipError<B::Error>> {
        self.written = None;
        self.chip.init(bus, self.levels()).await?;
        self.written = Some(self.levels());
        Ok(())
    }

    /// Writes all registers of a chip in any state, and reads nothing back.
    pub(super) async fn force<B: I2c>(&mut self, bus: &mut B) -> Result<(), B::Error> {
        self.written = None;
        self.chip.force(bus, self.levels()).await
    }

    /// Returns true if the pins have to be written.
    pub(super) fn has_changed(&self) -> bool {
        self.written != Some(self.levels())
    }

    /// Writes the levels of all pins.
    pub(super) async fn rewrite<B: I2c>(&mut self, bus: &mut B) -> Result<(), B::Error> {
        self.written = None;
        self.chip.set(bus, self.levels()).await?;
        self.written = Some(self.levels());
        Ok(())
    }

    /// Reads the registers back and compares them with the requested levels.
    pub(super) async fn verify<B: I2c>(&self, bus: &mut B) -> Result<(), ChipError<B::Error>> {
        self.chip.verify(bus, self.levels()).await
    }

    /// Requested levels of the pins. Unused pins are low.
    fn levels(&self) -> u16 {
        let high = self.relays.iter().zip(self.closed).filter(|(relay, closed)| relay.active_low != *closed);
        high.fold(self.lines, |levels, (relay, _)| levels | 1 << relay.bit)
    }
}

#[cfg(test)]
mod tests {
    use embassy_futures::block_on;
    use r4_protocol::{ChannelId, ChannelKind};

    use super::*;
    use crate::testing::Registers;

    const CHIP: u8 = 0x20;

    /// Expander with the motors' supply on an active-low relay, and one relay for general use.
    fn expander() -> Expander {
        let relay = |index, bit, active_low, role| RelayConfig {
            id: ChannelId::new(ChannelKind::Relay, index),
            bit,
            active_low,
            role,
        };
        let relays = [relay(0, 8, true, RelayRole::MotorPower), relay(3, 11, false, RelayRole::General)];
        Expander::new(ExpanderConfig { address: CHIP }, relays.into_iter().collect())
    }

    /// Levels in the output latches.
    fn pins(bus: &Registers) -> u16 {
        u16::from_le_bytes([0x14, 0x15].map(|register| bus.get(CHIP, register)))
    }

    /// A changed level is written once, and again after a failure.
    #[test]
    fn a_change_is_written_once() {
        let (mut expander, mut bus) = (expander(), Registers::default());
        (0..2).for_each(|register| bus.set(CHIP, register, 0xFF));
        assert_eq!(block_on(expander.driven(&mut bus)).ok(), Some(None), "as after power-up");
        assert!(expander.has_changed());
        assert!(block_on(expander.init(&mut bus)).is_ok());
        assert_eq!((pins(&bus), block_on(expander.driven(&mut bus)).ok()), (0x0100, Some(Some(0x0100))));
        assert!(!expander.has_changed());
        expander.switch(1, true);
        expander.set_lines(0x0003);
        assert!(expander.has_changed());
        bus.fail(1);
        assert!(block_on(expander.rewrite(&mut bus)).is_err());
        assert!(expander.has_changed());
        assert!(block_on(expander.rewrite(&mut bus)).is_ok());
        assert_eq!((pins(&bus), expander.has_changed()), (0x0903, false));
        // After a failed write even the level before it counts as a change.
        bus.fail(1);
        expander.switch(1, false);
        assert!(block_on(expander.rewrite(&mut bus)).is_err());
        expander.switch(1, true);
        assert!(expander.has_changed());
        assert!(block_on(expander.rewrite(&mut bus)).is_ok());
        assert!(!expander.has_changed());
        // A chip just powered up, or set up by another program in its other register map.
        bus.set(CHIP, 0x00, 0xFF);
        bus.set(CHIP, 0x0A, 0x80);
        assert!(block_on(expander.force(&mut bus)).is_ok());
        assert_eq!([0x00, 0x01, 0x05, 0x0A].map(|register| bus.get(CHIP, register)), [0; 4]);
        assert_eq!(pins(&bus), 0x0903);
        // Nothing was read back, so the levels count as unknown.
        assert!(expander.has_changed());
    }

    #[test]
    fn a_pin_that_changes_is_found() {
        let (mut expander, mut bus) = (expander(), Registers::default());
        assert!(block_on(expander.init(&mut bus)).is_ok());
        assert!(block_on(expander.verify(&mut bus)).is_ok());
        for register in [0x00, 0x01, 0x14, 0x15] {
            bus.set(CHIP, register, bus.get(CHIP, register) ^ 0x40);
            assert!(block_on(expander.verify(&mut bus)).is_err(), "{register:#x}");
            bus.set(CHIP, register, bus.get(CHIP, register) ^ 0x40);
        }
        expander.switch(1, true);
        assert!(block_on(expander.verify(&mut bus)).is_err(), "it was not told yet");
    }

    #[test]
    fn polarity_is_per_relay_and_motor_power_is_only_that() {
        let mut relays = expander();
        assert!(relays.has_motor_power());
        let general = relays.relays.iter().filter(|relay| relay.role == RelayRole::General).copied();
        assert!(!Expander::new(ExpanderConfig { address: CHIP }, general.collect()).has_motor_power());
        assert_eq!(relays.levels(), 0x0100, "all open");
        relays.close_motor_power();
        assert_eq!(relays.levels(), 0x0000);
        relays.switch(1, true);
        assert!(relays.levels() == 0x0800 && relays.closed().eq([true; 2]));
        relays.open_general();
        assert_eq!(relays.levels(), 0x0000, "the motors' supply stays");
        assert!(relays.closed().eq([true, false]));
        relays.open_all();
        assert_eq!(relays.levels(), 0x0100);
        relays.open_general();
        assert_eq!(relays.levels(), 0x0100, "and is not closed by a stop");
    }
}
