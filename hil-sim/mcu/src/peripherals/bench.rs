//! Bench for tests of the serial peripherals: wires that record what was sent, and prepared answers.

use std::collections::VecDeque;

use crate::context::{Clocks, Context, Misuse, Signal};
use crate::outside::{CanFrame, CanOutcome, Edge, I2cResponse, Level, Outside, Pin};
use crate::peripheral::{Peripheral, Size, Unmodelled};

/// Event on an I2C bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum OnI2c {
    Start { at_ns: u64, address: u8, read: bool },
    Write { at_ns: u64, byte: u8 },
    Read { at_ns: u64 },
    Stop { at_ns: u64 },
}

/// Recorder of everything that leaves the chip.
pub(crate) struct Wires {
    pub(crate) uart: Vec<(u8, u64, u8)>,
    /// Sent SPI frames: controller, time, frame, bits.
    pub(crate) spi: Vec<(u8, u64, u32, u8)>,
    pub(crate) i2c: Vec<OnI2c>,
    /// Responses to the next I2C bytes (address included); then acknowledged.
    pub(crate) i2c_answers: VecDeque<I2cResponse>,
    /// Bytes read next from I2C; `None` is a stuck bus; 0xFF after the last one.
    pub(crate) i2c_data: VecDeque<Option<u8>>,
    pub(crate) i2c_lines: (bool, bool),
    pub(crate) can: Vec<(u8, u64, CanFrame)>,
    /// Outcomes of the next CAN frames; then `can_outcome`.
    pub(crate) can_outcomes: VecDeque<CanOutcome>,
    /// Outcome of CAN frames after the list.
    pub(crate) can_outcome: CanOutcome,
}

impl Default for Wires {
    fn default() -> Self {
        Self {
            uart: Vec::new(),
            spi: Vec::new(),
            i2c: Vec::new(),
            i2c_answers: VecDeque::new(),
            i2c_data: VecDeque::new(),
            i2c_lines: (true, true),
            can: Vec::new(),
            can_outcomes: VecDeque::new(),
            can_outcome: CanOutcome::Acknowledged,
        }
    }
}

impl Outside for Wires {
    fn drive(&mut self, _at_ns: u64, _pin: Pin, _level: Level) {}

    fn poll(&mut self, _now_ns: u64, _edges: &mut Vec<Edge>) {}

    fn next_poll_ns(&mut self, _now_ns: u64, _watched: &[Pin]) -> u64 {
        u64::MAX
    }

    fn level(&mut self, _now_ns: u64, _pin: Pin, pull: Option<bool>) -> bool {
        pull.unwrap_or(false)
    }

    fn volts(&mut self, _now_ns: u64, _pin: Pin) -> f64 {
        0.0
    }

    fn set_volts(&mut self, _at_ns: u64, _pin: Pin, _volts: f64) {}

    fn i2c_start(&mut self, _controller: u8, at_ns: u64, address: u8, read: bool) -> I2cResponse {
        self.i2c.push(OnI2c::Start { at_ns, address, read });
        self.i2c_answers.pop_front().unwrap_or(I2cResponse::Ack)
    }

    fn i2c_write(&mut self, _controller: u8, at_ns: u64, byte: u8) -> I2cResponse {
        self.i2c.push(OnI2c::Write { at_ns, byte });
        self.i2c_answers.pop_front().unwrap_or(I2cResponse::Ack)
    }

    fn i2c_read(&mut self, _controller: u8, at_ns: u64) -> Option<u8> {
        self.i2c.push(OnI2c::Read { at_ns });
        self.i2c_data.pop_front().unwrap_or(Some(0xFF))
    }

    fn i2c_stop(&mut self, _controller: u8, at_ns: u64) {
        self.i2c.push(OnI2c::Stop { at_ns });
    }

    fn i2c_lines(&mut self, _controller: u8, _now_ns: u64) -> (bool, bool) {
        self.i2c_lines
    }

    fn uart_sent(&mut self, port: u8, at_ns: u64, byte: u8) {
        self.uart.push((port, at_ns, byte));
    }

    fn spi_sent(&mut self, controller: u8, at_ns: u64, frame: u32, bits: u8) {
        self.spi.push((controller, at_ns, frame, bits));
    }

    fn can_sent(&mut self, bus: u8, at_ns: u64, frame: &CanFrame) -> CanOutcome {
        self.can.push((bus, at_ns, frame.clone()));
        self.can_outcomes.pop_front().unwrap_or(self.can_outcome)
    }
}

/// Bench with one peripheral, time, and the wires around it. It records the levels of interrupt and request lines.
pub(crate) struct Bench<P> {
    pub(crate) peripheral: P,
    pub(crate) now_ns: u64,
    pub(crate) clocks: Clocks,
    pub(crate) wires: Wires,
    pub(crate) misuse: Vec<Misuse>,
    irqs: Vec<u16>,
    dmas: Vec<u8>,
    bdmas: Vec<u8>,
}

fn set<T: PartialEq>(list: &mut Vec<T>, item: T, level: bool) {
    list.retain(|other| *other != item);
    if level {
        list.push(item);
    }
}

impl<P: Peripheral> Bench<P> {
    pub(crate) fn new(peripheral: P, clocks: Clocks) -> Self {
        Self {
            peripheral,
            now_ns: 0,
            clocks,
            wires: Wires::default(),
            misuse: Vec::new(),
            irqs: Vec::new(),
            dmas: Vec::new(),
            bdmas: Vec::new(),
        }
    }

    pub(crate) fn with<T>(&mut self, f: impl FnOnce(&mut P, &mut Context<'_>) -> T) -> T {
        let mut signals = Vec::new();
        let mut context = Context {
            now_ns: self.now_ns,
            clocks: &self.clocks,
            outside: &mut self.wires,
            signals: &mut signals,
            misuse: &mut self.misuse,
        };
        let result = f(&mut self.peripheral, &mut context);
        for signal in signals {
            match signal {
                Signal::Irq { number, level } => set(&mut self.irqs, number, level),
                Signal::Dma { request, level } => set(&mut self.dmas, request, level),
                Signal::Bdma { request, level } => set(&mut self.bdmas, request, level),
                other => panic!("unexpected {other:?}"),
            }
        }
        result
    }

    pub(crate) fn read(&mut self, offset: u32) -> u32 {
        self.with(|peripheral, context| peripheral.read(offset, Size::Word, context)).unwrap()
    }

    pub(crate) fn write(&mut self, offset: u32, value: u32) {
        self.try_write(offset, value).unwrap();
    }

    pub(crate) fn try_write(&mut self, offset: u32, value: u32) -> Result<(), Unmodelled> {
        self.with(|peripheral, context| peripheral.write(offset, Size::Word, value, context))
    }

    /// Advances time as a machine does, from one event to the next.
    pub(crate) fn run_until(&mut self, until_ns: u64) {
        loop {
            let next_ns = self.peripheral.next_event_ns();
            if next_ns > until_ns {
                break;
            }
            self.now_ns = self.now_ns.max(next_ns);
            self.with(|peripheral, context| peripheral.advance(context));
            assert!(self.peripheral.next_event_ns() > self.now_ns, "the event at {next_ns} ns does not go away");
        }
        self.now_ns = until_ns;
        self.with(|peripheral, context| peripheral.advance(context));
    }

    pub(crate) fn irq(&self, number: u16) -> bool {
        self.irqs.contains(&number)
    }

    pub(crate) fn dma(&self, request: u8) -> bool {
        self.dmas.contains(&request)
    }

    pub(crate) fn bdma(&self, request: u8) -> bool {
        self.bdmas.contains(&request)
    }

    /// Takes the misuse since the last call.
    pub(crate) fn take_misuse(&mut self) -> Vec<String> {
        self.misuse.drain(..).map(|misuse| misuse.what).collect()
    }
}
