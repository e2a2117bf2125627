//! Names of links: `serial:/dev/ttyACM0`, `tcp:localhost:4444`, `can:can0`, `can:slcan:/dev/ttyACM1#5`.

use std::{fmt, path::PathBuf, str::FromStr};

use r4_protocol::can::{BITRATE, BITRATES_KBIT, Node};

/// Baud rate of a serial port without one in its address, bit/s: that of the board's UART. USB ignores it.
pub const DEFAULT_BAUD: u32 = 1_000_000;

/// Default bit rate of a CAN bus, kbit/s.
const DEFAULT_KBIT_PER_S: u16 = (BITRATE / 1000) as u16;

/// Address of a board.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Address {
    /// Serial port: USB of the board, its UART, or a served pseudo-terminal.
    Serial {
        /// Device path such as `/dev/ttyACM0`; `None` selects the only board found.
        path: Option<PathBuf>,
        /// Baud rate of the port, bit/s.
        baud: u32,
    },
    /// TCP port of a served board, or of a serial server with a board.
    Tcp {
        /// Host name or IP address.
        host: String,
        /// TCP port number, not 0.
        port: u16,
    },
    /// Board on a CAN bus.
    Can {
        /// Interface to the bus.
        interface: CanInterface,
        /// Node number of the board.
        node: Node,
    },
}

/// Interface to a CAN bus.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum CanInterface {
    /// Network interface of Linux (SocketCAN), such as `can0`.
    Socket(String),
    /// Adapter of the CANable type, with the slcan protocol on a serial port.
    Slcan {
        /// Serial port of the adapter.
        path: PathBuf,
        /// Bit rate of the bus, kbit/s, which the link sets in the adapter. A network interface gets its rate from
        /// Linux.
        kbit_per_s: u16,
    },
}

/// Kind of links, as users write its addresses.
#[derive(Clone, Copy, Debug)]
pub struct LinkKind {
    /// Text before the first colon of an address.
    pub prefix: &'static str,
    /// Forms of an address, for messages and help; optional parts are in brackets.
    pub forms: &'static [&'static str],
    /// Reads the text after the colon; `whole` makes the complete text, for errors.
    read: fn(&str, whole: &dyn Fn() -> String) -> Result<Address, BadAddress>,
}

/// All kinds of links.
pub static LINK_KINDS: [LinkKind; 3] = [
    LinkKind { prefix: "serial", forms: &["serial:auto", "serial:/dev/ttyACM0[@BAUD]"], read: serial },
    LinkKind { prefix: "tcp", forms: &["tcp:HOST:PORT"], read: tcp },
    LinkKind { prefix: "can", forms: &["can:can0[#NODE]", "can:slcan:/dev/ttyACM1[@KBIT][#NODE]"], read: can },
];

impl LinkKind {
    /// Returns the kind of an address by its prefix; `None` for text that is no address of a link.
    #[must_use]
    pub fn of(text: &str) -> Option<(&'static Self, &str)> {
        let (prefix, rest) = text.split_once(':')?;
        Some((LINK_KINDS.iter().find(|kind| kind.prefix == prefix)?, rest))
    }

    /// Lists the forms of all kinds, for messages and help.
    #[must_use]
    pub fn all_forms() -> String {
        let forms: Vec<_> = LINK_KINDS.iter().flat_map(|kind| kind.forms).copied().collect();
        let (last, others) = forms.split_last().unwrap_or((&"", &[]));
        format!("{} or {last}", others.join(", "))
    }
}

/// Error of a text that is no [`Address`].
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum BadAddress {
    /// The text has none of the known forms.
    #[error("`{0}`: write {forms}", forms = LinkKind::all_forms())]
    Kind(String),
    /// The text after `@` is no baud rate.
    #[error("`{0}`: after @ comes a rate in bits per second, as in serial:/dev/ttyUSB0@1000000")]
    Baud(String),
    /// Host or port is missing.
    #[error("`{0}`: tcp: needs a host and a port, as in tcp:localhost:4444 or tcp:[::1]:4444")]
    Port(String),
    /// The text after `@` is no bit rate of a board's bus.
    #[error("`{0}`: after @ comes the bus's rate in kbit/s, 125, 250, 500 or 1000, as in can:slcan:/dev/ttyACM0@500#5")]
    CanRate(String),
    /// The node number is out of range.
    #[error("`{0}`: a board on a bus has a number from 0 to {last}, as in can:can0#5", last = Node::COUNT - 1)]
    Node(String),
}

impl FromStr for Address {
    type Err = BadAddress;

    fn from_str(text: &str) -> Result<Self, BadAddress> {
        let whole = || text.to_owned();
        let (kind, rest) = LinkKind::of(text).ok_or_else(|| BadAddress::Kind(whole()))?;
        (kind.read)(rest, &whole)
    }
}

fn serial(rest: &str, whole: &dyn Fn() -> String) -> Result<Address, BadAddress> {
    if rest.is_empty() {
        return Err(BadAddress::Kind(whole()));
    }
    // From the right, because a path may contain `@`.
    let (path, baud) = match rest.rsplit_once('@') {
        Some((path, baud)) => {
            (path, baud.parse().ok().filter(|baud| *baud > 0).ok_or_else(|| BadAddress::Baud(whole()))?)
        }
        None => (rest, DEFAULT_BAUD),
    };
    Ok(Address::Serial { path: (path != "auto").then(|| path.into()), baud })
}

fn tcp(rest: &str, whole: &dyn Fn() -> String) -> Result<Address, BadAddress> {
    let (host, port) = rest.rsplit_once(':').ok_or_else(|| BadAddress::Port(whole()))?;
    // An IPv6 address is in brackets, because it contains colons.
    let host = host.strip_prefix('[').and_then(|host| host.strip_suffix(']')).unwrap_or(host);
    let port = port.parse().ok().filter(|port| *port > 0);
    match port {
        Some(port) if !host.is_empty() => Ok(Address::Tcp { host: host.to_owned(), port }),
        _ => Err(BadAddress::Port(whole())),
    }
}

fn can(rest: &str, whole: &dyn Fn() -> String) -> Result<Address, BadAddress> {
    let (name, node) = match rest.rsplit_once('#') {
        Some((name, node)) => (name, node.parse().ok()),
        None => (rest, Some(0)),
    };
    let interface = match name.strip_prefix("slcan:") {
        Some(port) if !port.is_empty() => {
            let (path, kbit_per_s) = match port.rsplit_once('@') {
                // A board's bus has one of these rates only.
                Some((path, rate)) => {
                    let known = |rate: &u16| BITRATES_KBIT.contains(rate);
                    (path, rate.parse().ok().filter(known).ok_or_else(|| BadAddress::CanRate(whole()))?)
                }
                None => (port, DEFAULT_KBIT_PER_S),
            };
            CanInterface::Slcan { path: path.into(), kbit_per_s }
        }
        None if is_interface(name) => CanInterface::Socket(name.to_owned()),
        _ => return Err(BadAddress::Kind(whole())),
    };
    let node = node.and_then(Node::new).ok_or_else(|| BadAddress::Node(whole()))?;
    Ok(Address::Can { interface, node })
}

/// Returns true for a valid name of a network interface (`dev_valid_name` in the kernel's net/core/dev.c). `slcan`
/// alone is refused: it is an adapter without its port.
fn is_interface(name: &str) -> bool {
    let good = |char: char| char != '/' && char != ':' && !char.is_whitespace();
    (1..16).contains(&name.len()) && ![".", "..", "slcan"].contains(&name) && name.chars().all(good)
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Serial { path, baud } => {
                let path = path.as_ref().map_or("auto".into(), |path| path.to_string_lossy());
                write!(f, "serial:{path}")?;
                if *baud == DEFAULT_BAUD { Ok(()) } else { write!(f, "@{baud}") }
            }
            Self::Tcp { host, port } if host.contains(':') => write!(f, "tcp:[{host}]:{port}"),
            Self::Tcp { host, port } => write!(f, "tcp:{host}:{port}"),
            Self::Can { interface: CanInterface::Socket(name), node } => write!(f, "can:{name}#{}", node.number()),
            Self::Can { interface: CanInterface::Slcan { path, kbit_per_s }, node } => {
                write!(f, "can:slcan:{}", path.display())?;
                if *kbit_per_s != DEFAULT_KBIT_PER_S {
                    write!(f, "@{kbit_per_s}")?;
                }
                write!(f, "#{}", node.number())
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_printed_is_read_again() {
        for text in [
            "serial:/dev/ttyACM0",
            "serial:auto",
            "serial:/dev/ttyUSB0@115200",
            "serial:/dev/serial/by-id/usb-R4@home@9600",
            "tcp:localhost:4444",
            "tcp:[::1]:4444",
            "can:slcan:/dev/ttyACM1#5",
            "can:slcan:/dev/ttyACM1@500#5",
            "can:can0#127",
        ] {
            let address: Address = text.parse().expect(text);
            assert_eq!(address.to_string(), text);
        }
        let node_0: Address = "can:slcan:/dev/ttyACM1".parse().expect("node 0");
        assert_eq!(node_0.to_string(), "can:slcan:/dev/ttyACM1#0");
        assert_eq!("can:slcan:/dev/ttyACM1@1000".parse(), Ok(node_0), "the rate of a bus that names none");
        let socket =
            Address::Can { interface: CanInterface::Socket("vcan0".into()), node: Node::new(0).expect("in range") };
        assert_eq!("can:vcan0".parse(), Ok(socket));
    }

    /// The forms of messages and help are addresses, with and without what is in brackets.
    #[test]
    fn what_messages_advise_is_read() {
        let filled = |form: &str| {
            let parts = [("[", ""), ("]", ""), ("HOST", "host"), ("PORT", "1"), ("BAUD", "9600"), ("KBIT", "500")];
            let text = parts.iter().fold(form.to_owned(), |text, (from, to)| text.replace(from, to));
            text.replace("NODE", "5")
        };
        for form in LINK_KINDS.iter().flat_map(|kind| kind.forms) {
            let short = form.split('[').next().expect("the first part").replace("HOST:PORT", "host:1");
            for text in [short, filled(form)] {
                assert!(text.parse::<Address>().is_ok(), "{text}");
            }
        }
    }

    #[test]
    fn what_is_wrong_is_named() {
        for (text, error) in [
            ("usb:1", BadAddress::Kind("usb:1".into())),
            ("serial:", BadAddress::Kind("serial:".into())),
            ("serial:/dev/x@0", BadAddress::Baud("serial:/dev/x@0".into())),
            ("serial:/dev/x@fast", BadAddress::Baud("serial:/dev/x@fast".into())),
            ("tcp:localhost", BadAddress::Port("tcp:localhost".into())),
            ("tcp::80", BadAddress::Port("tcp::80".into())),
            ("tcp:host:0", BadAddress::Port("tcp:host:0".into())),
            ("can:slcan:", BadAddress::Kind("can:slcan:".into())),
            ("can:slcan", BadAddress::Kind("can:slcan".into())),
            ("can:slcan:/dev/x@800#1", BadAddress::CanRate("can:slcan:/dev/x@800#1".into())),
            ("can:slcan:/dev/x@fast", BadAddress::CanRate("can:slcan:/dev/x@fast".into())),
            ("can:", BadAddress::Kind("can:".into())),
            ("can:#1", BadAddress::Kind("can:#1".into())),
            ("can:/dev/can0", BadAddress::Kind("can:/dev/can0".into())),
            ("can:a-name-of-16-bytes", BadAddress::Kind("can:a-name-of-16-bytes".into())),
            ("can:can0#five", BadAddress::Node("can:can0#five".into())),
            ("can:slcan:/dev/x#128", BadAddress::Node("can:slcan:/dev/x#128".into())),
        ] {
            assert_eq!(text.parse::<Address>(), Err(error), "{text}");
        }
    }
}
