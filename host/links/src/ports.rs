//! Serial ports of this machine, with those of boards identified.

use std::path::{Path, PathBuf};

use serialport::{SerialPortInfo, SerialPortType};

/// USB vendor and product ID of a board in service, as its firmware reports them.
pub const BOARD_USB: (u16, u16) = (0x1209, 0x0001);

/// Serial port of the machine.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Port {
    /// Path to open, such as `/dev/ttyACM0`.
    pub path: PathBuf,
    /// USB device behind the port; `None` for other ports.
    pub usb: Option<Usb>,
}

/// Identity of a USB device with a serial port.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Usb {
    /// USB vendor ID and product ID.
    pub id: (u16, u16),
    /// Serial number of the device, the same at any socket.
    pub serial: Option<String>,
    /// Product name from the device.
    pub product: Option<String>,
}

impl Port {
    /// Returns true if the USB IDs are those of a board.
    #[must_use]
    pub fn is_board(&self) -> bool {
        self.usb.as_ref().is_some_and(|usb| usb.id == BOARD_USB)
    }
}

/// Error of listing the ports.
#[derive(Debug, thiserror::Error)]
#[error("cannot list the serial ports: {0}")]
pub struct ListError(#[from] serialport::Error);

/// Returns all serial ports: boards first, then by name.
///
/// # Errors
/// Those of the operating system.
pub fn list() -> Result<Vec<Port>, ListError> {
    Ok(sorted(serialport::available_ports()?))
}

fn sorted(found: Vec<SerialPortInfo>) -> Vec<Port> {
    let mut ports: Vec<Port> = found
        .into_iter()
        .map(|info| Port {
            path: info.port_name.into(),
            usb: match info.port_type {
                SerialPortType::UsbPort(usb) => {
                    Some(Usb { id: (usb.vid, usb.pid), serial: usb.serial_number, product: usb.product })
                }
                SerialPortType::PciPort | SerialPortType::BluetoothPort | SerialPortType::Unknown => None,
            },
        })
        .collect();
    // `true` sorts after `false`; the exchanged operands put boards first.
    ports.sort_by(|one, other| other.is_board().cmp(&one.is_board()).then_with(|| one.path.cmp(&other.path)));
    ports
}

/// Returns the path of the port whose device has this USB serial number.
pub(crate) fn find_again(found: Vec<Port>, serial: &str) -> Option<PathBuf> {
    let with = |port: &Port| port.usb.as_ref().and_then(|usb| usb.serial.as_deref()) == Some(serial);
    found.into_iter().find(with).map(|port| port.path)
}

/// Returns the USB serial number of the device at `path`, if it is among these ports.
pub(crate) fn serial_of(found: Vec<Port>, path: &Path) -> Option<String> {
    found.into_iter().find(|port| port.path == path)?.usb?.serial
}

#[cfg(test)]
mod tests {
    use serialport::UsbPortInfo;

    use super::*;

    #[test]
    fn boards_come_first() {
        let port = |name: &str, usb: Option<(u16, u16)>| SerialPortInfo {
            port_name: name.into(),
            port_type: usb.map_or(SerialPortType::Unknown, |(vid, pid)| {
                SerialPortType::UsbPort(UsbPortInfo {
                    vid,
                    pid,
                    serial_number: Some("7".into()),
                    manufacturer: None,
                    product: None,
                    interface: None,
                })
            }),
        };
        let found = vec![
            port("/dev/ttyS1", None),
            port("/dev/ttyUSB0", Some((0x0403, 0x6001))),
            port("/dev/ttyS0", None),
            port("/dev/ttyACM3", Some(BOARD_USB)),
        ];
        let ports = sorted(found);
        let paths: Vec<_> = ports.iter().map(|port| port.path.to_string_lossy().into_owned()).collect();
        assert_eq!(paths, ["/dev/ttyACM3", "/dev/ttyS0", "/dev/ttyS1", "/dev/ttyUSB0"]);
        assert_eq!(ports.iter().map(Port::is_board).collect::<Vec<_>>(), [true, false, false, false]);
    }

    #[test]
    fn a_device_is_found_by_its_serial_number_wherever_it_is() {
        let port = |name: &str, serial: Option<&str>| Port {
            path: name.into(),
            usb: Some(Usb { id: BOARD_USB, serial: serial.map(Into::into), product: None }),
        };
        let found = || {
            vec![
                Port { path: "/dev/ttyS0".into(), usb: None },
                port("/dev/ttyACM0", None),
                port("/dev/ttyACM1", Some("A1")),
                port("/dev/ttyACM2", Some("B2")),
            ]
        };
        assert_eq!(find_again(found(), "B2"), Some("/dev/ttyACM2".into()));
        assert_eq!(find_again(found(), "C3"), None);
        assert_eq!(serial_of(found(), Path::new("/dev/ttyACM1")).as_deref(), Some("A1"));
        for without in ["/dev/ttyS0", "/dev/ttyACM0", "/dev/ttyACM9"] {
            assert_eq!(serial_of(found(), Path::new(without)), None, "{without}");
        }
    }
}
