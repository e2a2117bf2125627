//! Test bench for peripherals: time, clocks, and a world at the pins that records the chip's actions and plays back
//! what a test has prepared.

use std::collections::{HashMap, VecDeque};

use crate::{
    CanFrame, CanOutcome, Clocks, Context, Edge, I2cResponse, Level, Misuse, Outside, Peripheral, Pin, Signal, Size,
    Unmodelled,
};

/// Action of the chip on the world outside.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Event {
    Drive { at_ns: u64, pin: Pin, level: Level },
    Volts { at_ns: u64, pin: Pin, volts: f64 },
    I2cStart { controller: u8, at_ns: u64, address: u8, read: bool },
    I2cWrite { controller: u8, at_ns: u64, byte: u8 },
    I2cRead { controller: u8, at_ns: u64 },
    I2cStop { controller: u8, at_ns: u64 },
    Uart { port: u8, at_ns: u64, byte: u8 },
    Can { bus: u8, at_ns: u64, frame: CanFrame },
}

/// Outside world that records the chip's actions in order; the test sets its answers.
#[derive(Default)]
pub(crate) struct Recorder {
    /// All actions of the chip.
    pub(crate) events: Vec<Event>,
    /// Future changes of input pins, in order of time.
    pub(crate) edges: VecDeque<Edge>,
    /// Levels driven at pins from outside; other pins follow their pull resistor, or are low.
    pub(crate) levels: HashMap<Pin, bool>,
    /// Voltages at analog inputs, V; 0 without an entry.
    pub(crate) volts: HashMap<Pin, f64>,
    /// Responses to the next I2C addresses and written bytes, in order; then `Ack`.
    pub(crate) i2c_responses: VecDeque<I2cResponse>,
    /// Next bytes from I2C targets; then `None`, a stuck bus.
    pub(crate) i2c_bytes: VecDeque<u8>,
    /// SCL and SDA are held low by another device.
    pub(crate) i2c_held: (bool, bool),
    /// Outcomes of the next CAN frames; then `Acknowledged`.
    pub(crate) can_outcomes: VecDeque<CanOutcome>,
}

impl Outside for Recorder {
    fn drive(&mut self, at_ns: u64, pin: Pin, level: Level) {
        self.events.push(Event::Drive { at_ns, pin, level });
    }

    fn poll(&mut self, now_ns: u64, edges: &mut Vec<Edge>) {
        while let Some(edge) = self.edges.pop_front_if(|edge| edge.at_ns <= now_ns) {
            self.levels.insert(edge.pin, edge.high);
            edges.push(edge);
        }
    }

    fn next_poll_ns(&mut self, _now_ns: u64, watched: &[Pin]) -> u64 {
        self.edges.iter().find(|edge| watched.contains(&edge.pin)).map_or(u64::MAX, |edge| edge.at_ns)
    }

    fn level(&mut self, _now_ns: u64, pin: Pin, pull: Option<bool>) -> bool {
        self.levels.get(&pin).copied().or(pull).unwrap_or(false)
    }

    fn volts(&mut self, _now_ns: u64, pin: Pin) -> f64 {
        self.volts.get(&pin).copied().unwrap_or(0.0)
    }

    fn set_volts(&mut self, at_ns: u64, pin: Pin, volts: f64) {
        self.events.push(Event::Volts { at_ns, pin, volts });
    }

    fn i2c_start(&mut self, controller: u8, at_ns: u64, address: u8, read: bool) -> I2cResponse {
        self.events.push(Event::I2cStart { controller, at_ns, address, read });
        self.i2c_responses.pop_front().unwrap_or(I2cResponse::Ack)
    }

    fn i2c_write(&mut self, controller: u8, at_ns: u64, byte: u8) -> I2cResponse {
        self.events.push(Event::I2cWrite { controller, at_ns, byte });
        self.i2c_responses.pop_front().unwrap_or(I2cResponse::Ack)
    }

    fn i2c_read(&mut self, controller: u8, at_ns: u64) -> Option<u8> {
        self.events.push(Event::I2cRead { controller, at_ns });
        self.i2c_bytes.pop_front()
    }

    fn i2c_stop(&mut self, controller: u8, at_ns: u64) {
        self.events.push(Event::I2cStop { controller, at_ns });
    }

    fn i2c_lines(&mut self, _controller: u8, _now_ns: u64) -> (bool, bool) {
        (!self.i2c_held.0, !self.i2c_held.1)
    }

    fn uart_sent(&mut self, port: u8, at_ns: u64, byte: u8) {
        self.events.push(Event::Uart { port, at_ns, byte });
    }

    fn can_sent(&mut self, bus: u8, at_ns: u64, frame: &CanFrame) -> CanOutcome {
        self.events.push(Event::Can { bus, at_ns, frame: frame.clone() });
        self.can_outcomes.pop_front().unwrap_or(CanOutcome::Acknowledged)
    }
}

/// Bench for one peripheral, which keeps its signals until a test takes them.
pub(crate) struct Bench {
    pub(crate) now_ns: u64,
    pub(crate) clocks: Clocks,
    pub(crate) outside: Recorder,
    pub(crate) signals: Vec<Signal>,
    pub(crate) misuse: Vec<Misuse>,
}

impl Default for Bench {
    /// Starts at time 0 with the clocks of the R4 firmware: 480 MHz, and timers at 240 MHz.
    fn default() -> Self {
        let clocks = Clocks {
            core_hz: 480_000_000,
            ahb_hz: 240_000_000,
            apb1_hz: 120_000_000,
            apb2_hz: 120_000_000,
            apb3_hz: 120_000_000,
            apb4_hz: 120_000_000,
            tim_apb1_hz: 240_000_000,
            tim_apb2_hz: 240_000_000,
            usart16_hz: 120_000_000,
            usart234578_hz: 120_000_000,
            i2c123_hz: 120_000_000,
            i2c4_hz: 120_000_000,
            spi123_hz: 80_000_000,
            fdcan_hz: 80_000_000,
            adc_hz: 16_000_000,
            lsi_hz: 32_000,
            hsi48_hz: 48_000_000,
            lse_hz: 32_768,
            lsi_ready_hz: 32_000,
            hse_rtc_hz: 0,
        };
        Self { now_ns: 0, clocks, outside: Recorder::default(), signals: Vec::new(), misuse: Vec::new() }
    }
}

impl Bench {
    /// Returns the context for calls without a method below.
    pub(crate) fn context(&mut self) -> Context<'_> {
        Context {
            now_ns: self.now_ns,
            clocks: &self.clocks,
            outside: &mut self.outside,
            signals: &mut self.signals,
            misuse: &mut self.misuse,
        }
    }

    /// Reads a word from a register.
    pub(crate) fn read(&mut self, peripheral: &mut impl Peripheral, offset: u32) -> u32 {
        self.try_read(peripheral, offset, Size::Word).unwrap()
    }

    /// Writes a word to a register.
    pub(crate) fn write(&mut self, peripheral: &mut impl Peripheral, offset: u32, value: u32) {
        self.try_write(peripheral, offset, Size::Word, value).unwrap();
    }

    /// Modifies a word: clears the bits of `clear`, then sets those of `set`.
    pub(crate) fn modify(&mut self, peripheral: &mut impl Peripheral, offset: u32, clear: u32, set: u32) {
        let value = self.read(peripheral, offset);
        self.write(peripheral, offset, value & !clear | set);
    }

    pub(crate) fn try_read(
        &mut self,
        peripheral: &mut impl Peripheral,
        offset: u32,
        size: Size,
    ) -> Result<u32, Unmodelled> {
        peripheral.read(offset, size, &mut self.context())
    }

    pub(crate) fn try_write(
        &mut self,
        peripheral: &mut impl Peripheral,
        offset: u32,
        size: Size,
        value: u32,
    ) -> Result<(), Unmodelled> {
        peripheral.write(offset, size, value, &mut self.context())
    }

    /// Advances time to `to_ns`, with a stop at each event of the peripheral on the way.
    pub(crate) fn run(&mut self, peripheral: &mut impl Peripheral, to_ns: u64) {
        loop {
            let next_ns = peripheral.next_event_ns();
            assert!(
                next_ns == u64::MAX || next_ns >= self.now_ns,
                "an event at {next_ns} is in the past of {}",
                self.now_ns
            );
            if next_ns > to_ns {
                break;
            }
            self.now_ns = next_ns;
            peripheral.advance(&mut self.context());
            assert!(peripheral.next_event_ns() > self.now_ns, "an event at {next_ns} is still there after it");
        }
        self.now_ns = to_ns;
        peripheral.advance(&mut self.context());
    }

    /// Takes the signals since the last call.
    pub(crate) fn take_signals(&mut self) -> Vec<Signal> {
        std::mem::take(&mut self.signals)
    }

    /// Takes the chip's actions on the world since the last call.
    pub(crate) fn take_events(&mut self) -> Vec<Event> {
        std::mem::take(&mut self.outside.events)
    }

    /// Takes the misuse since the last call, without its times.
    pub(crate) fn take_misuse(&mut self) -> Vec<String> {
        std::mem::take(&mut self.misuse).into_iter().map(|misuse| misuse.what).collect()
    }

    /// Asserts that no misuse was recorded.
    pub(crate) fn assert_no_misuse(&self) {
        assert!(self.misuse.is_empty(), "{:?}", self.misuse);
    }
}
