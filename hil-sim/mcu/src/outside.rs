//! Interface to the world at the chip's pins.

use std::fmt;

/// Pin of the chip: port and number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Pin {
    /// Port number: 0 is port A, 10 is port K.
    pub port: u8,
    /// Number in the port, 0 to 15.
    pub number: u8,
}

impl Pin {
    /// Makes a pin, as in `Pin::new('H', 6)` for PH6.
    #[must_use]
    pub const fn new(port: char, number: u8) -> Self {
        Self { port: port as u8 - b'A', number }
    }
}

impl fmt::Display for Pin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "P{}{}", char::from(b'A' + self.port), self.number)
    }
}

/// Output state of a pin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Level {
    /// Driven low by the chip.
    Low,
    /// Driven high by the chip.
    High,
    /// Not driven, with the chip's own pull resistor if enabled: `Some(true)` up, `Some(false)` down.
    Floating(Option<bool>),
}

/// Change of an input pin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Edge {
    /// Virtual time of the edge, ns.
    pub at_ns: u64,
    /// Input pin that changes.
    pub pin: Pin,
    /// Level after the edge.
    pub high: bool,
}

/// Response of a target on an I2C bus to a byte.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum I2cResponse {
    /// The byte was acknowledged.
    Ack,
    /// The byte was not acknowledged.
    Nack,
    /// A line is held low, so that the byte never ends.
    Stuck,
}

/// Byte on a UART's line, as the receiver gets it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UartByte {
    /// End of its stop bit, ns.
    pub at_ns: u64,
    /// Value of the byte.
    pub value: u8,
    /// Framing error: the stop bit was low.
    pub framing_error: bool,
    /// Noise was detected in a sample.
    pub noise: bool,
}

/// CAN frame, classic or FD.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CanFrame {
    /// Identifier, 11 or 29 bits.
    pub id: u32,
    /// Extended identifier of 29 bits.
    pub extended: bool,
    /// Remote frame; classic only.
    pub remote: bool,
    /// Frame in FD format.
    pub fd: bool,
    /// FD frame with its data at the higher bit rate.
    pub bit_rate_switch: bool,
    /// Data: 0..=8, and in FD 12, 16, 20, 24, 32, 48, 64 bytes.
    pub data: Vec<u8>,
}

/// Outcome of a frame that was sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CanOutcome {
    /// Another node acknowledged the frame.
    Acknowledged,
    /// No other node is on the bus to acknowledge.
    NotAcknowledged,
    /// The bits on the bus differed from those sent.
    BitError,
}

/// Everything outside the chip. All times are virtual nanoseconds and never go back.
pub trait Outside {
    /// Takes a change of the chip's output at a pin from `at_ns` on.
    fn drive(&mut self, at_ns: u64, pin: Pin, level: Level);

    /// Appends the changes of input pins up to and including `now_ns` that were not reported before, in order of time.
    fn poll(&mut self, now_ns: u64, edges: &mut Vec<Edge>);

    /// Returns the time of the next poll even if the program reads no pin: the earliest time at which one of the
    /// `watched` pins (with an interrupt or a capture) may change, ns; `u64::MAX` for never.
    fn next_poll_ns(&mut self, now_ns: u64, watched: &[Pin]) -> u64;

    /// Returns the level at a pin that the chip does not drive, given its own pull resistor. It is consistent with the
    /// polled edges.
    fn level(&mut self, now_ns: u64, pin: Pin, pull: Option<bool>) -> bool;

    /// Returns the voltage at an analog input, V.
    fn volts(&mut self, now_ns: u64, pin: Pin) -> f64;

    /// Takes the voltage of an analog output, V.
    fn set_volts(&mut self, at_ns: u64, pin: Pin, volts: f64);

    /// Handles START or repeated START with the address; the time is the end of its acknowledge bit.
    fn i2c_start(&mut self, controller: u8, at_ns: u64, address: u8, read: bool) -> I2cResponse;

    /// Handles a byte to the addressed target; the time is the end of its acknowledge bit.
    fn i2c_write(&mut self, controller: u8, at_ns: u64, byte: u8) -> I2cResponse;

    /// Returns a byte from the addressed target; the time is the end of its acknowledge bit. `None` for a stuck bus.
    fn i2c_read(&mut self, controller: u8, at_ns: u64) -> Option<u8>;

    /// Handles a STOP condition.
    fn i2c_stop(&mut self, controller: u8, at_ns: u64);

    /// Returns the levels of SCL and SDA while the chip's controller releases both.
    fn i2c_lines(&mut self, controller: u8, now_ns: u64) -> (bool, bool);

    /// Takes a byte sent by UART `port` (1 to 8, as in USART1, UART4); the time is the end of its stop bit.
    fn uart_sent(&mut self, port: u8, at_ns: u64, byte: u8);

    /// Takes a data frame of `bits` (4 to 32) sent by SPI `controller`; the time is the end of its last clock. The
    /// first bit on the wire is the most significant one. Pins select the chip.
    fn spi_sent(&mut self, _controller: u8, _at_ns: u64, _frame: u32, _bits: u8) {}

    /// Takes a frame sent by FDCAN `bus` (1 or 2); the time is the end of its acknowledge slot.
    fn can_sent(&mut self, bus: u8, at_ns: u64, frame: &CanFrame) -> CanOutcome;

    /// Returns true if a task outside waits to run at the present time, so that the processor must pause.
    fn wants_to_run(&self) -> bool {
        false
    }
}
