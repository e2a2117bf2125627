//! Bootloaders on this machine's USB.

use std::{thread, time::Duration};

use dfu_core::functional_descriptor::FunctionalDescriptor;
use nusb::{
    Interface, MaybeFuture,
    transfer::{ControlIn, ControlOut, ControlType, Recipient, TransferError},
};

use crate::{Descriptor, Usb, UsbError};

/// Time-out of a request. Some bootloaders erase a sector within one: 4 s by the data sheet of an STM32H7.
const PATIENCE: Duration = Duration::from_secs(10);
/// Time-out of a string request, which is answered at once.
const STRING: Duration = Duration::from_secs(3);
/// Class and subclass of a DFU interface (DFU 1.1, table 4.4).
const DFU: (u8, u8) = (0xFE, 0x01);

/// Reason why no bootloader could be opened.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// The operating system cannot list USB devices.
    #[error("cannot list the USB devices: a container or a virtual machine has to be given the board first")]
    List(#[source] nusb::Error),
    /// Several boards are in their bootloaders.
    #[error("{count} boards are in their bootloader: leave one of them plugged in")]
    Several {
        /// Number of bootloaders found.
        count: usize,
    },
    /// The operating system does not let this user open the device.
    #[error(
        "cannot open the bootloader: does another program use it, and may you? On Linux only root may until the rule from \
         docs/program.md is installed; Windows needs the driver WinUSB for it (zadig.akeo.ie)"
    )]
    Open(#[source] nusb::Error),
    /// The device has no DFU interface: it is of another kind.
    #[error("the bootloader's USB device has no DFU interface for flash")]
    NoInterface,
}

/// Flash of a bootloader on USB.
pub struct Device {
    interface: Interface,
    descriptor: Descriptor,
}

impl Device {
    /// Opens the bootloader of this vendor and product; `None` when there is none.
    ///
    /// # Errors
    /// [`OpenError`] when it cannot be opened, or there are several.
    pub fn find(vendor: u16, product: u16) -> Result<Option<Self>, OpenError> {
        let devices = nusb::list_devices().wait().map_err(OpenError::List)?;
        let mut found: Vec<_> =
            devices.filter(|info| (info.vendor_id(), info.product_id()) == (vendor, product)).collect();
        let Some(info) = found.pop() else { return Ok(None) };
        // Writing to the wrong board must not happen by the order of the list.
        if !found.is_empty() {
            return Err(OpenError::Several { count: found.len() + 1 });
        }
        let device = info.open().wait().map_err(OpenError::Open)?;
        let configuration = device.active_configuration().map_err(|_| OpenError::NoInterface)?;
        let dfu = configuration.interface_alt_settings().find(|alt| (alt.class(), alt.subclass()) == DFU);
        let alt = dfu.ok_or(OpenError::NoInterface)?;
        let (number, setting, name) = (alt.interface_number(), alt.alternate_setting(), alt.string_index());
        // The functional descriptor may follow any alternate setting of the interface.
        let functional = configuration
            .interface_alt_settings()
            .flat_map(|alt| alt.descriptors().collect::<Vec<_>>())
            .find_map(|bytes| FunctionalDescriptor::from_bytes(&bytes))
            .and_then(Result::ok)
            .ok_or(OpenError::NoInterface)?;
        // A driver of the system may hold the interface; it gives it back when the device is closed.
        let interface = device.detach_and_claim_interface(number).wait().map_err(OpenError::Open)?;
        interface.set_alt_setting(setting).wait().map_err(OpenError::Open)?;
        let languages = device.get_string_descriptor_supported_languages(STRING).wait();
        let language = languages.ok().and_then(|mut all| all.next()).unwrap_or_default();
        // Without a description the update refuses the memory, with a better message than an error here.
        let memory = name.and_then(|name| device.get_string_descriptor(name, language, STRING).wait().ok());
        Ok(Some(Self { interface, descriptor: Descriptor { functional, memory: memory.unwrap_or_default() } }))
    }
}

fn of(error: TransferError) -> UsbError {
    match error {
        TransferError::Stall => UsbError::Stalled,
        TransferError::Disconnected => UsbError::Gone,
        TransferError::Cancelled => UsbError::TimedOut,
        other => UsbError::System(other.to_string()),
    }
}

impl Usb for Device {
    fn descriptor(&self) -> Descriptor {
        self.descriptor.clone()
    }

    fn control_out(&mut self, request: u8, value: u16, data: &[u8]) -> Result<(), UsbError> {
        let index = self.interface.interface_number().into();
        let (control_type, recipient) = (ControlType::Class, Recipient::Interface);
        let control = ControlOut { control_type, recipient, request, value, index, data };
        self.interface.control_out(control, PATIENCE).wait().map_err(of)
    }

    fn control_in(&mut self, request: u8, value: u16, buffer: &mut [u8]) -> Result<usize, UsbError> {
        let index = self.interface.interface_number().into();
        let (control_type, recipient) = (ControlType::Class, Recipient::Interface);
        let length = u16::try_from(buffer.len()).unwrap_or(u16::MAX);
        let control = ControlIn { control_type, recipient, request, value, index, length };
        let data = self.interface.control_in(control, PATIENCE).wait().map_err(of)?;
        let got = data.len().min(buffer.len());
        buffer[..got].copy_from_slice(&data[..got]);
        Ok(got)
    }

    fn sleep(&mut self, time: Duration) {
        thread::sleep(time);
    }
}
