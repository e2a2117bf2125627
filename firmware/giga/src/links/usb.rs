//! The link over USB: a serial port (CDC-ACM) at the USB-C connector.
//!
//! Vendor and product are pid.codes' 1209:0001, which is for tests and not for boards that are handed on (pid.codes/1209/0001).
//! The serial number is the processor's.

use embassy_stm32::{peripherals::USB_OTG_FS, uid, usb};
use embassy_usb::{
    Builder, Config, UsbDevice,
    class::cdc_acm::{BufferedReceiver, CdcAcmClass, CdcAcmError, Sender as PacketSender, State},
};
use embedded_io_async::{ErrorType, Read, Write};

const VENDOR: u16 = 0x1209;
const PRODUCT: u16 = 0x0001;
/// Bytes of a packet at full speed.
const PACKET: usize = 64;
/// Of a packet that is sent: a full one would have to be followed by an empty one, or the host waits for more.
const SHORT_PACKET: usize = PACKET - 1;
/// The bus gives 500 mA to who asks; the board has its own supply as well.
const MAX_MILLIAMPERE: u16 = 500;

/// The controller's driver.
pub(crate) type Driver = usb::Driver<'static, USB_OTG_FS>;

/// What the device needs for good.
pub(crate) struct Memory {
    configuration: [u8; 128],
    bos: [u8; 16],
    control: [u8; PACKET],
    state: State<'static>,
    packet: [u8; PACKET],
}

impl Memory {
    /// Nothing in it.
    pub(crate) fn new() -> Self {
        Self { configuration: [0; 128], bos: [0; 16], control: [0; PACKET], state: State::new(), packet: [0; PACKET] }
    }
}

/// No VBUS sense, for the Giga's pin of it is a UART: the device is always on.
pub(crate) fn config() -> usb::Config {
    let mut config = usb::Config::default();
    config.vbus_detection = false;
    config
}

/// The device, which must run for the two halves of the link to do anything.
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

/// Bytes from the host.
pub(crate) struct Receiver(BufferedReceiver<'static, Driver>);

impl Receiver {
    /// Ready when a host has configured the device.
    pub(crate) async fn wait_connection(&mut self) {
        self.0.wait_connection().await;
    }
}

impl ErrorType for Receiver {
    type Error = CdcAcmError;
}

impl Read for Receiver {
    /// Fails when the host is gone.
    async fn read(&mut self, buffer: &mut [u8]) -> Result<usize, CdcAcmError> {
        loop {
            // An empty packet is no end of the link.
            match self.0.read(buffer).await? {
                0 => {}
                len => return Ok(len),
            }
        }
    }
}

/// Bytes to the host.
pub(crate) struct Sender(PacketSender<'static, Driver>);

impl ErrorType for Sender {
    type Error = CdcAcmError;
}

impl Write for Sender {
    /// Fails when the host is gone.
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, CdcAcmError> {
        self.0.write(&bytes[..bytes.len().min(SHORT_PACKET)]).await
    }

    async fn flush(&mut self) -> Result<(), CdcAcmError> {
        self.0.flush().await
    }
}
