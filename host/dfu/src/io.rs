//! Control transfers to the DFU interface of a bootloader.

use std::{
    cell::{Cell, RefCell},
    time::Duration,
};

use dfu_core::{DfuIo, DfuProtocol, Status, functional_descriptor::FunctionalDescriptor, memory_layout::MemoryLayout};

/// Why a transfer failed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum UsbError {
    /// The device does not take this request in its state.
    #[error("the bootloader does not take this request now (stall)")]
    Stalled,
    /// The device is not there any more.
    #[error("the bootloader is gone from USB")]
    Gone,
    /// No answer in time.
    #[error("the bootloader does not answer")]
    TimedOut,
    /// What else the operating system tells.
    #[error("USB: {0}")]
    System(String),
}

/// What a bootloader says of itself.
#[derive(Clone, Debug)]
pub struct Descriptor {
    /// DFU functional descriptor.
    pub functional: FunctionalDescriptor,
    /// Name of the interface's alternate setting, which is its memory: `@Internal Flash  2MB   /0x08000000/01*128Ka,15*128Kg`
    /// (UM0424, 10.3.2).
    pub memory: String,
}

/// The DFU interface of a bootloader: class requests to it, and time.
pub trait Usb {
    /// What it says of itself.
    fn descriptor(&self) -> Descriptor;

    /// A request with data for the device.
    ///
    /// # Errors
    /// [`UsbError`]
    fn control_out(&mut self, request: u8, value: u16, data: &[u8]) -> Result<(), UsbError>;

    /// A request for data of the device; how many came.
    ///
    /// # Errors
    /// [`UsbError`]
    fn control_in(&mut self, request: u8, value: u16, buffer: &mut [u8]) -> Result<usize, UsbError>;

    /// Waits.
    fn sleep(&mut self, time: Duration);
}

/// Why a step failed: as USB or as `dfu-core` tells it.
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

/// DFU_GETSTATUS (DFU 1.1, table 3.2).
pub(crate) const GETSTATUS: u8 = 3;

/// A bootloader as `dfu-core` wants it.
pub(crate) struct Io<'u, U> {
    usb: RefCell<&'u mut U>,
    functional: FunctionalDescriptor,
    protocol: DfuProtocol<MemoryLayout>,
    /// The bootloader's last status, which `dfu-core` does not tell of.
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

    /// Never asked for: what is asked of `dfu-core` ends before it would leave the bootloader.
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
