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

    /// The main crystal stops at `at_ns`, or has stopped if that is past: broken solder, a crack, damp. It does not start
    /// again.
    pub fn stop_crystal_at(&mut self, at_ns: u64) {
        self.call(Id::Rcc as usize, |devices, _| devices.rcc.stop_hse_at(at_ns));
    }

    /// VDD is `millivolts` from `at_ns` on, until a later change. What that does: see the first comment of `peripherals/pwr.rs`.
    pub fn supply_at(&mut self, at_ns: u64, millivolts: u32) {
        self.call(Id::Pwr as usize, |devices, _| devices.pwr.supply_at(at_ns, millivolts));
    }

    /// VDD, mV.
    #[must_use]
    pub fn supply_mv(&self) -> u32 {
        self.devices.pwr.supply_mv()
    }

    /// The option bytes (OPTSR) are these from now on, as a programmer has left them; swapped banks come with the next reset.
    /// What of them is not modelled ends the run at the program's next access to a peripheral.
    pub fn set_option_bytes(&mut self, options: u32) {
        if let Err(unmodelled) = self.devices.flash.set_options(options) {
            self.unmodelled.get_or_insert(unmodelled);
        }
        self.link_power();
        self.follow_flash();
        self.settle();
    }

    /// A debugger is connected from now on, or no longer. What that does depends on the option bytes: see the first comment of
    /// `peripherals/flash`.
    pub fn set_debugger(&mut self, connected: bool) {
        self.devices.flash.set_debugger(connected);
        self.follow_flash();
    }

    /// Readout protection keeps everybody, the debugger first, from the flash and the backup SRAM.
    #[must_use]
    pub fn is_closed(&self) -> bool {
        self.devices.flash.is_closed()
    }

    /// Bits per second of an FDCAN's arbitration and data phases, by the clock tree as of the last access.
    #[must_use]
    pub fn can_bit_rates(&self, bus: u8) -> (f64, f64) {
        self.devices.fdcan.bit_rates(bus)
    }

    /// Node 1 or 2 goes bus-off now, as after 32 frames that somebody destroyed.
    pub fn inject_can_bus_off(&mut self, bus: u8) {
        self.call(Id::Fdcan as usize, |devices, context| devices.fdcan.inject_bus_off(bus, context));
        self.settle();
    }

    /// Something holds CAN bus 1 or 2 dominant from now on, or no longer.
    pub fn hold_can_dominant(&mut self, bus: u8, held: bool) {
        self.call(Id::Fdcan as usize, |devices, context| devices.fdcan.hold_dominant(bus, held, context));
        self.settle();
    }

    /// The end of the frame that node 1 or 2 is sending.
    #[must_use]
    pub fn can_sends_until_ns(&self, bus: u8) -> Option<u64> {
        self.devices.fdcan.sends_until_ns(bus)
    }
}
