//! Connection of the controller to an SPI bus of its own.

use std::{
    cell::{Cell, RefCell},
    convert::Infallible,
    rc::Rc,
};

use embedded_hal::{
    digital::{self, OutputPin},
    spi::{self, ErrorKind, Operation, SpiDevice},
};

use super::Ili9488;
use crate::clock::Clock;

/// A screen with its bus and lines, as the firmware accesses it.
///
/// The bus is blocking, and code takes no virtual time: consecutive transfers are separated by the duration of their
/// bytes, starting at the time of the first, and may run ahead of the clock.
#[derive(Clone)]
pub struct ScreenWiring(Rc<Wires>);

struct Wires {
    clock: Clock,
    screen: RefCell<Ili9488>,
    byte_ns: u64,
    /// Time at which the bus is free again, ns.
    free_ns: Cell<u64>,
    fault: Cell<bool>,
    faults: Cell<u64>,
    backlight: Cell<bool>,
}

impl ScreenWiring {
    /// A screen on a bus with a clock of `clock_hz`.
    #[must_use]
    pub fn new(clock: Clock, clock_hz: u32) -> Self {
        let byte_ns = 8_000_000_000_u64.div_ceil(clock_hz.into());
        Self(Rc::new(Wires {
            clock,
            screen: RefCell::default(),
            byte_ns,
            free_ns: Cell::new(0),
            fault: Cell::new(false),
            faults: Cell::new(0),
            backlight: Cell::new(false),
        }))
    }

    /// Calls `look` with the screen's controller.
    pub fn screen<T>(&self, look: impl FnOnce(&Ili9488) -> T) -> T {
        look(&self.0.screen.borrow())
    }

    /// True while the backlight is on.
    #[must_use]
    pub fn is_lit(&self) -> bool {
        self.0.backlight.get()
    }

    /// Makes every transfer fail, as a broken SPI peripheral does; `false` ends it.
    pub fn set_fault(&self, fault: bool) {
        self.0.fault.set(fault);
    }

    /// Number of failed transfers.
    #[must_use]
    pub fn faults(&self) -> u64 {
        self.0.faults.get()
    }

    /// SPI bus as the firmware's driver takes it.
    #[must_use]
    pub fn spi(&self) -> ScreenSpi {
        ScreenSpi(self.0.clone())
    }

    /// Data/command line (D/CX), high for data.
    #[must_use]
    pub fn data_command(&self) -> ScreenLine {
        self.line(|wires, high| wires.screen.borrow_mut().set_data(high))
    }

    /// Reset line, low active.
    #[must_use]
    pub fn reset(&self) -> ScreenLine {
        self.line(|wires, high| wires.screen.borrow_mut().set_reset(wires.now_ns(), high))
    }

    /// Switch line of the backlight.
    #[must_use]
    pub fn backlight(&self) -> ScreenLine {
        self.line(|wires, high| wires.backlight.set(high))
    }

    fn line(&self, drive: fn(&Wires, bool)) -> ScreenLine {
        ScreenLine { wires: self.0.clone(), drive }
    }
}

impl Wires {
    /// Present time, ns, which is ahead of the clock while a blocking transfer runs.
    fn now_ns(&self) -> u64 {
        self.clock.now_ns().max(self.free_ns.get())
    }

    fn transfer(&self, byte: u8) -> u8 {
        let end_ns = self.now_ns() + self.byte_ns;
        self.free_ns.set(end_ns);
        self.screen.borrow_mut().transfer(end_ns, byte)
    }
}

/// SPI device returned by [`ScreenWiring::spi`].
pub struct ScreenSpi(Rc<Wires>);

impl spi::ErrorType for ScreenSpi {
    type Error = ErrorKind;
}

impl SpiDevice for ScreenSpi {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), ErrorKind> {
        if self.0.fault.get() {
            self.0.faults.set(self.0.faults.get() + 1);
            return Err(ErrorKind::ModeFault);
        }
        for operation in operations {
            match operation {
                Operation::Write(bytes) => bytes.iter().for_each(|byte| {
                    self.0.transfer(*byte);
                }),
                Operation::Read(bytes) => bytes.iter_mut().for_each(|byte| *byte = self.0.transfer(0)),
                Operation::TransferInPlace(bytes) => {
                    bytes.iter_mut().for_each(|byte| *byte = self.0.transfer(*byte));
                }
                Operation::Transfer(read, write) => {
                    for index in 0..read.len().max(write.len()) {
                        let answer = self.0.transfer(write.get(index).copied().unwrap_or(0));
                        if let Some(place) = read.get_mut(index) {
                            *place = answer;
                        }
                    }
                }
                Operation::DelayNs(ns) => self.0.free_ns.set(self.0.now_ns() + u64::from(*ns)),
            }
        }
        Ok(())
    }
}

/// One of the screen's digital lines.
pub struct ScreenLine {
    wires: Rc<Wires>,
    drive: fn(&Wires, bool),
}

impl digital::ErrorType for ScreenLine {
    type Error = Infallible;
}

impl OutputPin for ScreenLine {
    fn set_low(&mut self) -> Result<(), Infallible> {
        (self.drive)(&self.wires, false);
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        (self.drive)(&self.wires, true);
        Ok(())
    }
}
