//! What is wired to the chip's pins.

use std::fmt;

/// A pin: port and number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Pin {
    /// 0 is port A, 10 is port K.
    pub port: u8,
    /// 0 to 15.
    pub number: u8,
}

impl Pin {
    /// As in `Pin::new('H', 6)` for PH6.
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

/// What the chip does to a pin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Level {
    /// Driven low.
    Low,
    /// Driven high.
    High,
    /// Not driven; with the chip's own pull resistor, where there is one: `Some(true)` up, `Some(false)` down.
    Floating(Option<bool>),
}

/// A change of an input pin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Edge {
    /// When.
    pub at_ns: u64,
    /// Where.
    pub pin: Pin,
    /// The level from then on.
    pub high: bool,
}

/// How a target on an I2C bus answers a byte.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum I2cResponse {
    /// Acknowledged.
    Ack,
    /// Not acknowledged.
    Nack,
    /// A line is held low: the byte never ends.
    Stuck,
}

/// A byte on a UART's line, as the receiver takes it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UartByte {
    /// When its stop bit ends.
    pub at_ns: u64,
    /// Its value.
    pub value: u8,
    /// The stop bit was low.
    pub framing_error: bool,
    /// A noise was seen in a sample.
    pub noise: bool,
}

/// A classic or FD frame.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CanFrame {
    /// 11 or 29 bits.
    pub id: u32,
    /// 29 bits.
    pub extended: bool,
    /// Remote frame, classic only.
    pub remote: bool,
    /// FD format.
    pub fd: bool,
    /// FD, data at the higher rate.
    pub bit_rate_switch: bool,
    /// 0..=8, and in FD 12, 16, 20, 24, 32, 48, 64 bytes.
    pub data: Vec<u8>,
}

/// What became of a frame that was sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CanOutcome {
    /// Some other node acknowledged it.
    Acknowledged,
    /// Nobody else is on the bus.
    NotAcknowledged,
    /// The bits on the bus were not those sent.
    BitError,
}

/// Everything outside the chip. All times are virtual nanoseconds and never go back.
pub trait Outside {
    /// The chip drives a pin differently from `at_ns` on.
    fn drive(&mut self, at_ns: u64, pin: Pin, level: Level);

    /// Appends the changes of input pins up to and including `now_ns` that were not told before, in order of time.
    fn poll(&mut self, now_ns: u64, edges: &mut Vec<Edge>);

    /// When to poll next although nobody reads a pin: the earliest moment at which one of the `watched` pins (with an
    /// interrupt or a capture on them) may change. `u64::MAX` is never.
    fn next_poll_ns(&mut self, now_ns: u64, watched: &[Pin]) -> u64;

    /// The level at a pin that the chip does not drive, given its own pull resistor. Polled edges are consistent with this.
    fn level(&mut self, now_ns: u64, pin: Pin, pull: Option<bool>) -> bool;

    /// Voltage at an analog input.
    fn volts(&mut self, now_ns: u64, pin: Pin) -> f64;

    /// The chip drives an analog output.
    fn set_volts(&mut self, at_ns: u64, pin: Pin, volts: f64);

    /// START, or a repeated one, and the address: the moment is the end of its acknowledge bit.
    fn i2c_start(&mut self, controller: u8, at_ns: u64, address: u8, read: bool) -> I2cResponse;

    /// A byte to the addressed target, at the end of its acknowledge bit.
    fn i2c_write(&mut self, controller: u8, at_ns: u64, byte: u8) -> I2cResponse;

    /// A byte from the addressed target, at the end of its acknowledge bit; `None` when the bus is stuck.
    fn i2c_read(&mut self, controller: u8, at_ns: u64) -> Option<u8>;

    /// STOP.
    fn i2c_stop(&mut self, controller: u8, at_ns: u64);

    /// Levels of SCL and SDA when the chip's controller lets go of both.
    fn i2c_lines(&mut self, controller: u8, now_ns: u64) -> (bool, bool);

    /// A byte left UART `port` (1 to 8, as in USART1, UART4); the moment is the end of its stop bit.
    fn uart_sent(&mut self, port: u8, at_ns: u64, byte: u8);

    /// A data frame of `bits` (4 to 32) left SPI `controller`; the moment is the end of its last clock. The bit that was first
    /// on the wire is the most significant one. What is selected is a matter of pins.
    fn spi_sent(&mut self, _controller: u8, _at_ns: u64, _frame: u32, _bits: u8) {}

    /// A frame left FDCAN `bus` (1 or 2); the moment is the end of its acknowledge slot.
    fn can_sent(&mut self, bus: u8, at_ns: u64, frame: &CanFrame) -> CanOutcome;

    /// Something outside waits to run at the present moment: the processor is to pause.
    fn wants_to_run(&self) -> bool {
        false
    }
}
