//! Link over USB: a serial port (CDC-ACM) at the USB-C connector.
//!
//! Vendor and product are pid.codes' 1209:0001, which is for tests and not for boards that are handed on
//! (pid.codes/1209/0001). The serial number is the processor's.

use embassy_stm32::{peripherals::USB_OTG_FS, uid, usb};
use embassy_usb::{
    Builder, Config, UsbDevice,
    class::cdc_acm::{BufferedReceiver, CdcAcmClass, CdcAcmError, Sender as PacketSender, State},
};
use embedded_io_async::{ErrorType, Read, Write};

const VENDOR: u16 = 0x1209;
const PRODUCT: u16 = 0x0001;
/// Size of a packet at full speed, bytes.
const PACKET: usize = 64;
/// Size of a sent packet, bytes: after a full one the host waits until an empty one follows.
const SHORT_PACKET: usize = PACKET - 1;
/// Current that the device requests, mA; the bus grants 500 mA, and the board has its own supply as well.
const MAX_MILLIAMPERE: u16 = 500;

/// Driver of the USB controller.
pub(crate) type Driver = usb::Driver<'static, USB_OTG_FS>;

/// Memory that the device uses permanently.
pub(crate) struct Memory {
    configuration: [u8; 128],
    bos: [u8; 16],
    control: [u8; PACKET],
    state: State<'static>,
    packet: [u8; PACKET],
}

impl Memory {
    /// Creates the empty memory.
    pub(crate) fn new() -> Self {
        Self { configuration: [0; 128], bos: [0; 16], control: [0; PACKET], state: State::new(), packet: [0; PACKET] }
    }
}

/// Configuration without VBUS sense, since the Giga uses that pin for a UART: the device is always on.
pub(crate) fn config() -> usb::Config {
    let mut config = usb::Config::default();
    config.vbus_detection = false;
    config
}

/// Creates the device and the two halves of the link, which work only while the device runs.
pub(crate) fn start(driver: Driver, memory: &'static mut Memory) -> (UsbDevice<'static, Driver>, Receiver, Sender) {
    let mut config = Config::new(VENDOR, PRODUCT);
    config.manufacturer = Some("R4");
    config.product = Some("R4 robotics board");
    config.serial_number = Some(uid::uid_hex());
    config.max_power = MAX_MILLIAMPERE;
    let Memory { configuration, bos, control, state, packet } = memory;
    let mut builder = Builder::new(driver, config, configuration, bos, &mut [], control);
    let class = CdcAcmClass::new(&mut builder, state, PACKET as u16);
    let (tx, rx) = class.split();
    (builder.build(), Receiver(rx.into_buffered(packet)), Sender(tx))
}

/// Byte stream from the host.
pub(crate) struct Receiver(BufferedReceiver<'static, Driver>);

impl Receiver {
    /// Waits until a host has configured the device.
    pub(crate) async fn wait_connection(&mut self) {
        self.0.wait_connection().await;
    }
}

impl ErrorType for Receiver {
    type Error = CdcAcmError;
}

impl Read for Receiver {
    /// Reads bytes; fails when the host is gone.
    async fn read(&mut self, buffer: &mut [u8]) -> Result<usize, CdcAcmError> {
        loop {
            // An empty packet does not end the link.
            match self.0.read(buffer).await? {
                0 => {}
                len => return Ok(len),
            }
        }
    }
}

/// Byte stream to the host.
pub(crate) struct Sender(PacketSender<'static, Driver>);

impl ErrorType for Sender {
    type Error = CdcAcmError;
}

impl Write for Sender {
    /// Sends one short packet; fails when the host is gone.
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, CdcAcmError> {
        self.0.write(&bytes[..bytes.len().min(SHORT_PACKET)]).await
    }

    async fn flush(&mut self) -> Result<(), CdcAcmError> {
        self.0.flush().await
    }
}
