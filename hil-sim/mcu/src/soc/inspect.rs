//! What tests may look at in the chip, and break there.

use super::{Id, Soc};
use crate::{
    outside::Outside,
    peripheral::Peripheral,
    peripherals::{flash::FlashCells, gpio::Gpio, rcc::Oscillators},
};

impl<O: Outside, F: FlashCells> Soc<O, F> {
    /// The pins: what each is set to, and what the chip does to it.
    #[must_use]
    pub fn gpio(&self) -> &Gpio {
        &self.devices.gpio
    }

    /// A backup register of the RTC, 0 to 31; `None` beyond.
    #[must_use]
    pub fn backup_register(&self, index: usize) -> Option<u32> {
        self.devices.backup.register(index)
    }

    /// The oscillators change their frequencies now, as crystals do with temperature.
    pub fn drift(&mut self, oscillators: Oscillators) {
        self.call(Id::Rcc as usize, |devices, context| {
            devices.rcc.set_oscillators(oscillators);
            devices.rcc.advance(context);
        });
        self.settle();
    }

    /// Node 1 or 2 goes bus-off now, as after 32 frames that somebody destroyed.
    pub fn inject_can_bus_off(&mut self, bus: u8) {
        self.call(Id::Fdcan as usize, |devices, context| devices.fdcan.inject_bus_off(bus, context));
        self.settle();
    }
}
