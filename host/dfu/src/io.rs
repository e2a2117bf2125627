//! Control transfers to the DFU interface of a bootloader.

use std::{
    cell::{Cell, RefCell},
    time::Duration,
};

use dfu_core::{DfuIo, DfuProtocol, Status, functional_descriptor::FunctionalDescriptor, memory_layout::MemoryLayout};

/// Reason why a transfer failed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum UsbError {
    /// The device does not take this request in its state.
    #[error("the bootloader does not take this request now (stall)")]
    Stalled,
    /// The device has been unplugged or has reset.
    #[error("the bootloader is gone from USB")]
    Gone,
    /// No answer came in time.
    #[error("the bootloader does not answer")]
    TimedOut,
    /// The operating system reports another error.
    #[error("USB: {0}")]
    System(String),
}

/// Descriptors of a bootloader.
#[derive(Clone, Debug)]
pub struct Descriptor {
    /// Functional descriptor of DFU: transfer size, version, abilities.
    pub functional: FunctionalDescriptor,
    /// Name of the interface's alternate setting, which describes its memory: `@Internal Flash  2MB
    /// /0x08000000/01*128Ka,15*128Kg` (UM0424, 10.3.2).
    pub memory: String,
}

/// DFU interface of a bootloader: class requests to it, and time.
pub trait Usb {
    /// Returns the bootloader's descriptors.
    fn descriptor(&self) -> Descriptor;

    /// Sends a request with data for the device.
    ///
    /// # Errors
    /// [`UsbError`] of the transfer.
    fn control_out(&mut self, request: u8, value: u16, data: &[u8]) -> Result<(), UsbError>;

    /// Sends a request for data of the device; returns the number of bytes that came.
    ///
    /// # Errors
    /// [`UsbError`] of the transfer.
    fn control_in(&mut self, request: u8, value: u16, buffer: &mut [u8]) -> Result<usize, UsbError>;

    /// Waits for this time.
    fn sleep(&mut self, time: Duration);
}

/// Error of a step: of USB, or of `dfu-core`.
#[derive(Debug)]
pub(crate) enum Fault {
    Usb(UsbError),
    Dfu(dfu_core::Error),
}

impl From<dfu_core::Error> for Fault {
    fn from(error: dfu_core::Error) -> Self {
        Self::Dfu(error)
    }
}

impl From<UsbError> for Fault {
    fn from(error: UsbError) -> Self {
        Self::Usb(error)
    }
}

/// Request DFU_GETSTATUS (DFU 1.1, table 3.2).
pub(crate) const GETSTATUS: u8 = 3;

/// Bootloader as `dfu-core` accesses it.
pub(crate) struct Io<'u, U> {
    usb: RefCell<&'u mut U>,
    functional: FunctionalDescriptor,
    protocol: DfuProtocol<MemoryLayout>,
    /// Last status of the bootloader, which `dfu-core` does not return.
    status: Cell<Status>,
}

impl<'u, U: Usb> Io<'u, U> {
    pub(crate) fn new(usb: &'u mut U, functional: FunctionalDescriptor, protocol: DfuProtocol<MemoryLayout>) -> Self {
        Self { usb: RefCell::new(usb), functional, protocol, status: Cell::new(Status::Ok) }
    }

    pub(crate) fn status(&self) -> Status {
        self.status.get()
    }

    pub(crate) fn sleep(&self, time: Duration) {
        self.usb.borrow_mut().sleep(time);
    }

    pub(crate) fn control_out(&self, request: u8, value: u16, data: &[u8]) -> Result<(), Fault> {
        Ok(self.usb.borrow_mut().control_out(request, value, data)?)
    }

    pub(crate) fn control_in(&self, request: u8, value: u16, buffer: &mut [u8]) -> Result<usize, Fault> {
        let length = self.usb.borrow_mut().control_in(request, value, buffer)?;
        // Kept, because `dfu-core` does not return it and the errors depend on it.
        if let (GETSTATUS, Some(status), true) = (request, buffer.first(), length > 0) {
            self.status.set((*status).into());
        }
        Ok(length)
    }
}

impl<U: Usb> DfuIo for Io<'_, U> {
    type Read = usize;
    type Write = ();
    type Reset = ();
    type Error = Fault;
    type MemoryLayout = MemoryLayout;

    fn read_control(&self, _: u8, request: u8, value: u16, buffer: &mut [u8]) -> Result<usize, Fault> {
        self.control_in(request, value, buffer)
    }

    fn write_control(&self, _: u8, request: u8, value: u16, buffer: &[u8]) -> Result<(), Fault> {
        self.control_out(request, value, buffer)
    }

    /// Does nothing, and is never called: downloads stop before `dfu-core` would leave the bootloader.
    fn usb_reset(self) -> Result<(), Fault> {
        Ok(())
    }

    fn protocol(&self) -> &DfuProtocol<MemoryLayout> {
        &self.protocol
    }

    fn functional_descriptor(&self) -> &FunctionalDescriptor {
        &self.functional
    }
}
