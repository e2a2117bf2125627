//! The chip around the processor: every peripheral at its address, and the wires between them.
//!
//! An access, or an event that is due, reaches one peripheral. The signals it gives off are carried out when it returns:
//! interrupt lines to the processor, requests to DMA, whose beats follow at once, timer outputs to pins, changes of the
//! clock tree to everybody. DMA takes no time; what it waits for does.

mod map;

use std::cmp::Reverse;

pub use map::Id;

use crate::{
    chip::{AccessError, Chip},
    context::{Clocks, Context, Misuse, ResetCause, Signal},
    memory::{Bank, Memory},
    outside::{CanFrame, Edge, Outside, Pin, UartByte},
    peripheral::{Peripheral, Size, Unmodelled},
    peripherals::{
        adc::Adc12,
        backup::Rtc,
        dac::Dac,
        dbgmcu::Dbgmcu,
        dma::{self, Bdma, Dma12},
        exti::Exti,
        fdcan::Fdcan,
        flash::{Flash, FlashCells},
        fmc::Fmc,
        gpio::Gpio,
        i2c::I2c,
        iwdg::Iwdg,
        pwr::Pwr,
        rcc::{Oscillators, Rcc},
        rng::Rng,
        spi::Spi,
        syscfg::Syscfg,
        tim::Tim,
        usart::Usart,
        usb::Usb,
    },
};

/// Every peripheral.
struct Devices {
    rcc: Rcc,
    pwr: Pwr,
    gpio: Gpio,
    exti: Exti,
    syscfg: Syscfg,
    flash: Flash,
    iwdg: Iwdg,
    rtc: Rtc,
    dbgmcu: Dbgmcu,
    usb: Usb,
    fmc: Fmc,
    dma: Dma12,
    bdma: Bdma,
    timers: Vec<Tim>,
    adc: Adc12,
    dac: Dac,
    usarts: Vec<Usart>,
    i2cs: Vec<I2c>,
    fdcan: Fdcan,
    spi: Spi,
    rng: Rng,
}

/// The chip around the processor, wired to `O`.
pub struct Soc<O> {
    devices: Devices,
    outside: O,
    memory: Memory,
    map: map::AddressMap,
    clocks: Clocks,
    now_ns: u64,
    signals: Vec<Signal>,
    misuse: Vec<Misuse>,
    /// When each peripheral must be advanced, by its place.
    next_ns: [u64; Id::COUNT],
    next_poll_ns: u64,
    /// Pins with an interrupt or a capture on them.
    watched: Vec<Pin>,
    irqs: Vec<(u16, bool)>,
    reset: Option<ResetCause>,
    edges: Vec<Edge>,
    waits: bool,
}

/// The memories and peripherals of domain 3, which are all that BDMA reaches.
const DOMAIN_3: u32 = 0x3800_0000;
/// Misuses are kept, the first so many.
const MISUSE_KEPT: usize = 1000;

impl<O: Outside> Soc<O> {
    /// A chip that power has just come to, with erased flash but for what `cells` hold in bank 2's last four sectors.
    #[must_use]
    pub fn new(outside: O, oscillators: Oscillators, cells: Box<dyn FlashCells>) -> Self {
        let devices = Devices::new(oscillators, cells);
        let mut soc = Self {
            clocks: devices.rcc.clocks(),
            devices,
            outside,
            memory: Memory::new(),
            map: map::AddressMap::new(),
            now_ns: 0,
            signals: Vec::new(),
            misuse: Vec::new(),
            next_ns: [u64::MAX; Id::COUNT],
            next_poll_ns: u64::MAX,
            watched: Vec::new(),
            irqs: Vec::new(),
            reset: None,
            edges: Vec::new(),
            waits: false,
        };
        soc.update_memory_clocks();
        soc
    }

    /// What the pins are wired to.
    pub fn outside(&mut self) -> &mut O {
        &mut self.outside
    }

    /// What was done against the manual, the first of it.
    #[must_use]
    pub fn misuse(&self) -> &[Misuse] {
        &self.misuse
    }

    /// Calls `f` with a peripheral and its context, then carries out the signals it gave off.
    fn with<R>(&mut self, id: usize, f: impl FnOnce(&mut dyn Peripheral, &mut Context<'_>) -> R) -> R {
        let mut context = Context {
            now_ns: self.now_ns,
            clocks: &self.clocks,
            outside: &mut self.outside,
            signals: &mut self.signals,
            misuse: &mut self.misuse,
        };
        let device = self.devices.get(id);
        let result = f(device, &mut context);
        self.next_ns[id] = device.next_event_ns();
        self.misuse.truncate(MISUSE_KEPT);
        result
    }

    /// Carries out what peripherals have given off, and what follows from that, until nothing is left.
    fn settle(&mut self) {
        let mut next = 0;
        loop {
            while next < self.signals.len() {
                let signal = self.signals[next];
                next += 1;
                self.carry_out(signal);
            }
            self.signals.clear();
            next = 0;
            if !self.dma_beat() {
                break;
            }
        }
    }

    fn carry_out(&mut self, signal: Signal) {
        match signal {
            Signal::Irq { number, level } => self.irqs.push((number, level)),
            Signal::Dma { request, level } => self.devices.dma.request(request, level),
            Signal::Bdma { request, level } => self.devices.bdma.request(request, level),
            Signal::Trigger { timer } => {
                if let Some(input) = dma_trigger(timer) {
                    self.with_dma(|dma, context| dma.trigger(input, context));
                }
            }
            Signal::TimerOutput { timer, channel, at_ns, high } => {
                self.devices.gpio.drive_timer(timer, channel, at_ns, high, &mut self.outside);
            }
            Signal::Clocks => self.follow_clocks(),
            Signal::Reset(cause) => self.reset = self.reset.or(Some(cause)),
        }
    }

    fn with_dma<R>(&mut self, f: impl FnOnce(&mut Dma12, &mut Context<'_>) -> R) -> R {
        let mut context = Context {
            now_ns: self.now_ns,
            clocks: &self.clocks,
            outside: &mut self.outside,
            signals: &mut self.signals,
            misuse: &mut self.misuse,
        };
        f(&mut self.devices.dma, &mut context)
    }

    fn with_bdma<R>(&mut self, f: impl FnOnce(&mut Bdma, &mut Context<'_>) -> R) -> R {
        let mut context = Context {
            now_ns: self.now_ns,
            clocks: &self.clocks,
            outside: &mut self.outside,
            signals: &mut self.signals,
            misuse: &mut self.misuse,
        };
        f(&mut self.devices.bdma, &mut context)
    }

    /// One access of a DMA controller; false when none wants any.
    fn dma_beat(&mut self) -> bool {
        if let Some(beat) = self.devices.dma.next_beat() {
            let result = self.bus_access(beat);
            self.with_dma(|dma, context| dma.finish_beat(result, context));
            return true;
        }
        if let Some(beat) = self.devices.bdma.next_beat() {
            let result = if beat.address < DOMAIN_3 { Err(dma::BusError) } else { self.bus_access(beat) };
            self.with_bdma(|bdma, context| bdma.finish_beat(result, context));
            return true;
        }
        false
    }

    /// An access by a DMA controller: to memory that it reaches and that has a clock, or to a peripheral.
    fn bus_access(&mut self, beat: dma::Beat) -> Result<u32, dma::BusError> {
        if let Some((region, _)) = self.memory.locate(beat.address) {
            let bank = region.bank;
            if !bank.on_bus() || !self.memory.is_enabled(bank) || bank == Bank::Storage {
                let at_ns = self.now_ns;
                let what = format!("DMA cannot reach {bank:?} at {:#010x} (RM0399, 2.1; 9.5)", beat.address);
                self.misuse.push(Misuse { at_ns, peripheral: "DMA", what });
                return Err(dma::BusError);
            }
            return match beat.access {
                dma::Access::Read => self.memory.read(beat.address, beat.size).ok_or(dma::BusError),
                dma::Access::Write(_) if bank.is_flash() => Err(dma::BusError),
                dma::Access::Write(value) => {
                    self.memory.write(beat.address, beat.size, value).map(|()| 0).ok_or(dma::BusError)
                }
            };
        }
        let Some(id) = self.map.find(beat.address) else { return Err(dma::BusError) };
        let offset = beat.address - self.base(id);
        let result = match beat.access {
            dma::Access::Read => self.with(id, |device, context| device.read(offset, beat.size, context)),
            dma::Access::Write(value) => {
                self.with(id, |device, context| device.write(offset, beat.size, value, context)).map(|()| 0)
            }
        };
        result.map_err(|unmodelled| {
            self.unmodelled = self.unmodelled.take().or(Some(unmodelled));
            dma::BusError
        })
    }
}
