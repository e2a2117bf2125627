//! Access of tests to the chip: inspection and faults.

use super::{Id, Soc};
use crate::{
    outside::Outside,
    peripheral::Peripheral,
    peripherals::{flash::FlashCells, gpio::Gpio, rcc::Oscillators},
};

impl<O: Outside, F: FlashCells> Soc<O, F> {
    /// Returns the GPIO ports: configuration and output state of each pin.
    #[must_use]
    pub fn gpio(&self) -> &Gpio {
        &self.devices.gpio
    }

    /// Returns a backup register of the RTC, 0 to 31; `None` beyond.
    #[must_use]
    pub fn backup_register(&self, index: usize) -> Option<u32> {
        self.devices.backup.register(index)
    }

    /// Changes the frequencies of the oscillators now, as temperature does to crystals.
    pub fn drift(&mut self, oscillators: Oscillators) {
        self.call(Id::Rcc as usize, |devices, context| {
            devices.rcc.set_oscillators(oscillators);
            devices.rcc.advance(context);
        });
        self.settle();
    }

    /// Stops the main crystal at `at_ns`, or now if that is past: broken solder, a crack, damp. It does not start
    /// again.
    pub fn stop_crystal_at(&mut self, at_ns: u64) {
        self.call(Id::Rcc as usize, |devices, _| devices.rcc.stop_hse_at(at_ns));
    }

    /// Sets VDD to `millivolts` from `at_ns` on, until a later change. For the effects see the module comment of
    /// `peripherals/pwr.rs`.
    pub fn supply_at(&mut self, at_ns: u64, millivolts: u32) {
        self.call(Id::Pwr as usize, |devices, _| devices.pwr.supply_at(at_ns, millivolts));
    }

    /// Returns the present supply voltage VDD, mV.
    #[must_use]
    pub fn supply_mv(&self) -> u32 {
        self.devices.pwr.supply_mv()
    }

    /// Sets the option bytes (OPTSR), as a programmer would; swapped banks take effect at the next reset. Settings that
    /// are not modelled end the run at the program's next access to a peripheral.
    pub fn set_option_bytes(&mut self, options: u32) {
        if let Err(unmodelled) = self.devices.flash.set_options(options) {
            self.unmodelled.get_or_insert(unmodelled);
        }
        self.link_power();
        self.follow_flash();
        self.settle();
    }

    /// Connects or disconnects a debugger. For the effects, which depend on the option bytes, see the module comment of
    /// `peripherals/flash`.
    pub fn set_debugger(&mut self, connected: bool) {
        self.devices.flash.set_debugger(connected);
        self.follow_flash();
    }

    /// Returns true while readout protection blocks all access to the flash and the backup SRAM.
    #[must_use]
    pub fn is_closed(&self) -> bool {
        self.devices.flash.is_closed()
    }

    /// Returns the bit rates of an FDCAN's arbitration and data phases, bit/s, by the clock tree at the last access.
    #[must_use]
    pub fn can_bit_rates(&self, bus: u8) -> (f64, f64) {
        self.devices.fdcan.bit_rates(bus)
    }

    /// Sends node 1 or 2 to bus-off now, as 32 failed frames would.
    pub fn inject_can_bus_off(&mut self, bus: u8) {
        self.call(Id::Fdcan as usize, |devices, context| devices.fdcan.inject_bus_off(bus, context));
        self.settle();
    }

    /// Starts or ends a short that holds CAN bus 1 or 2 dominant.
    pub fn hold_can_dominant(&mut self, bus: u8, held: bool) {
        self.call(Id::Fdcan as usize, |devices, context| devices.fdcan.hold_dominant(bus, held, context));
        self.settle();
    }

    /// Returns the end of the frame that node 1 or 2 is sending, ns; `None` if it sends none.
    #[must_use]
    pub fn can_sends_until_ns(&self, bus: u8) -> Option<u64> {
        self.devices.fdcan.sends_until_ns(bus)
    }
}
