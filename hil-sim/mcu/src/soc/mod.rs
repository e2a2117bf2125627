//! Chip around the processor: every peripheral at its address, and the wires between them.
//!
//! An access, or a due event, reaches one peripheral. The signals it gives off are carried out when it returns:
//! interrupt lines to the processor, requests to DMA, whose beats follow at once, timer outputs to pins, changes of the
//! clock tree to all peripherals. DMA itself takes no time; what it waits for does.

mod activity;
mod cells;
mod inspect;
mod map;
#[cfg(test)]
mod reference;

pub use activity::{Accesses, Activity};

use cells::{Cells, FLASH as FLASH_PARTS};
use map::Id;

use crate::{
    chip::{AccessError, Chip},
    context::{Clocks, Context, Misuse, ResetCause, Signal},
    memory::{Bank, Memory},
    outside::{CanFrame, Edge, Outside, Pin, UartByte},
    peripheral::{Peripheral, Size, Unmodelled},
    peripherals::{
        adc::Adc12,
        backup::Backup,
        crc::Crc,
        crs::Crs,
        dac::Dac,
        dbgmcu::Dbgmcu,
        dma::{self, Bdma, Dma12},
        exti::Exti,
        fdcan::Fdcan,
        flash::{Flash, FlashCells, LoadError},
        fmc::Fmc,
        gpio::{Function, Gpio},
        i2c::I2c,
        identity::Identity,
        iwdg::Iwdg,
        pwr::Pwr,
        rcc::{Oscillators, Rcc},
        rng::Rng,
        spi::Spi,
        syscfg::Syscfg,
        tim::Tim,
        usart::Usart,
        usb::Usb,
        wiring::Wired,
    },
};

/// All peripherals of the chip.
struct Devices<F> {
    rcc: Rcc,
    pwr: Pwr,
    gpio: Gpio,
    exti: Exti,
    syscfg: Syscfg,
    flash: Flash<Cells<F>>,
    iwdg: Iwdg,
    backup: Backup,
    dbgmcu: Dbgmcu,
    usb: Usb,
    fmc: Fmc,
    crs: Crs,
    identity: Identity,
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
    crc: Crc,
}

impl<F: FlashCells> Devices<F> {
    fn new(oscillators: Oscillators, cells: Cells<F>) -> Self {
        Self {
            rcc: Rcc::new(oscillators),
            pwr: Pwr::new(),
            gpio: Gpio::new(),
            exti: Exti::new(),
            syscfg: Syscfg::new(),
            flash: Flash::new(cells),
            iwdg: Iwdg::new(),
            backup: Backup::new(),
            dbgmcu: Dbgmcu::new(),
            usb: Usb::new(),
            fmc: Fmc::new(),
            crs: Crs::new(),
            identity: Identity::new(UNIQUE),
            dma: Dma12::new(),
            bdma: Bdma::new(),
            timers: TIMERS.into_iter().map(Tim::new).collect(),
            adc: Adc12::new(),
            dac: Dac::new(),
            usarts: (1..=8).filter_map(Usart::new).collect(),
            i2cs: (1..=4).filter_map(I2c::new).collect(),
            fdcan: Fdcan::new(),
            spi: Spi::new(),
            rng: Rng::new(0),
            crc: Crc::new(),
        }
    }

    /// Calls [`Peripheral::stable_until_ns`] of the peripherals that implement it.
    fn stable_until_ns(&self, id: usize, offset: u32, now_ns: u64) -> Option<u64> {
        const USART: usize = Id::Usart1 as usize;
        const I2C: usize = Id::I2c1 as usize;
        const FDCAN: usize = Id::Fdcan as usize;
        match id {
            0 => self.rcc.stable_until_ns(offset, now_ns),
            1 => self.pwr.stable_until_ns(offset, now_ns),
            FLASH => self.flash.stable_until_ns(offset, now_ns),
            USART..I2C => self.usarts[id - USART].stable_until_ns(offset, now_ns),
            I2C..FDCAN => self.i2cs[id - I2C].stable_until_ns(offset, now_ns),
            _ => None,
        }
    }

    /// Returns a peripheral by the place of its [`Id`].
    fn get(&mut self, id: usize) -> &mut dyn Peripheral {
        const TIM: usize = Id::Tim1 as usize;
        const USART: usize = Id::Usart1 as usize;
        const I2C: usize = Id::I2c1 as usize;
        const FDCAN: usize = Id::Fdcan as usize;
        const ADC: usize = Id::Adc12 as usize;
        const DAC: usize = Id::Dac1 as usize;
        const SPI: usize = Id::Spi1 as usize;
        const RNG: usize = Id::Rng as usize;
        const CRC: usize = Id::Crc as usize;
        match id {
            0 => &mut self.rcc,
            1 => &mut self.pwr,
            2 => &mut self.gpio,
            3 => &mut self.exti,
            4 => &mut self.syscfg,
            5 => &mut self.flash,
            6 => &mut self.iwdg,
            7 => &mut self.backup,
            8 => &mut self.dbgmcu,
            9 => &mut self.usb,
            10 => &mut self.fmc,
            11 => &mut self.crs,
            12 => &mut self.identity,
            13 => &mut self.dma,
            14 => &mut self.bdma,
            TIM..ADC => &mut self.timers[id - TIM],
            ADC => &mut self.adc,
            DAC => &mut self.dac,
            USART..I2C => &mut self.usarts[id - USART],
            I2C..FDCAN => &mut self.i2cs[id - I2C],
            FDCAN => &mut self.fdcan,
            SPI => &mut self.spi,
            RNG => &mut self.rng,
            CRC.. => &mut self.crc,
        }
    }
}

/// Chip around the processor, wired to the outside world `O`.
pub struct Soc<O, F> {
    devices: Devices<F>,
    outside: O,
    memory: Memory,
    map: map::AddressMap,
    bases: [u32; Id::COUNT],
    clocks: Clocks,
    now_ns: u64,
    signals: Vec<Signal>,
    /// Place of the peripheral that gave off each signal.
    sources: Vec<usize>,
    misuse: Vec<Misuse>,
    /// Time by which each peripheral must be advanced, by place, ns.
    next_ns: [u64; Id::COUNT],
    /// Earliest time in `next_ns`.
    next_device_ns: u64,
    next_poll_ns: u64,
    /// Pins with an interrupt or a capture on them.
    watched: Vec<Pin>,
    /// Places of the peripherals that assert each interrupt line now, by line number.
    asserted: Vec<Vec<usize>>,
    /// Watched inputs of timers, one bit each, by the timer's place.
    watching: [u8; TIMERS.len()],
    irqs: Vec<(u16, bool)>,
    /// Level of the NMI's input.
    nmi: bool,
    reset: Option<ResetCause>,
    edges: Vec<Edge>,
    boot: u32,
    /// Unmodelled use met by a DMA controller; reported at the program's next access.
    unmodelled: Option<Unmodelled>,
    /// Cache of 1 KiB blocks that are known to have their clock; a block's number selects its slot.
    clocked: [u32; CLOCKED],
    activity: Activity,
}

/// Boot address of the Cortex-M7 in the Giga's option bytes.
const BANK_1: u32 = 0x0800_0000;
/// Offsets of a GPIO port's registers with the functions of its pins (RM0399, 12.4).
const MODER: u32 = 0x00;
const AFRL: u32 = 0x20;
const AFRH: u32 = 0x24;
/// First address of peripherals; below are only memories and gaps.
const PERIPHERALS: u32 = 0x4000_0000;
/// First address of domain 3's memories and peripherals, the only ones that BDMA reaches.
const DOMAIN_3: u32 = 0x3800_0000;
/// Places of the peripherals that see pins.
const EXTI: usize = Id::Exti as usize;
const FLASH: usize = Id::Flash as usize;
const TIM1: usize = Id::Tim1 as usize;
const TIM17: usize = Id::Tim17 as usize;
/// Number of slots for blocks that are known to have their clock.
const CLOCKED: usize = 64;
const NO_BLOCK: u32 = u32::MAX;
/// Number of misuse records kept, the first ones.
const MISUSE_KEPT: usize = 1000;

impl<O: Outside, F: FlashCells> Soc<O, F> {
    /// Makes a chip at power-on with erased flash, except for the contents of `cells` in bank 2's last four sectors; it
    /// accesses no others of `cells`.
    #[must_use]
    pub fn new(outside: O, oscillators: Oscillators, cells: F) -> Self {
        Self::with_memory(outside, oscillators, cells, Memory::new())
    }

    fn with_memory(outside: O, oscillators: Oscillators, cells: F, memory: Memory) -> Self {
        let devices = Devices::new(oscillators, Cells::new(&memory, cells));
        let mut soc = Self {
            clocks: devices.rcc.clocks(),
            devices,
            outside,
            memory,
            map: map::AddressMap::new(),
            bases: map::bases(),
            now_ns: 0,
            signals: Vec::new(),
            sources: Vec::new(),
            misuse: Vec::new(),
            next_ns: [u64::MAX; Id::COUNT],
            next_device_ns: u64::MAX,
            next_poll_ns: u64::MAX,
            clocked: [NO_BLOCK; CLOCKED],
            watched: Vec::new(),
            asserted: Vec::new(),
            watching: [0; TIMERS.len()],
            irqs: Vec::new(),
            nmi: false,
            reset: None,
            edges: Vec::new(),
            boot: BANK_1,
            unmodelled: None,
            activity: Activity::new(),
        };
        soc.update_memory_clocks();
        soc
    }

    /// Returns the outside world at the pins.
    pub fn outside(&mut self) -> &mut O {
        &mut self.outside
    }

    /// Returns the first records of misuse.
    #[must_use]
    pub fn misuse(&self) -> &[Misuse] {
        &self.misuse
    }

    /// Returns the activity counters.
    pub fn activity(&mut self) -> &mut Activity {
        &mut self.activity
    }

    /// Calls `f` with the peripherals and the context of one of them, then renews its next event.
    fn call<R>(&mut self, id: usize, f: impl FnOnce(&mut Devices<F>, &mut Context<'_>) -> R) -> R {
        let mut context = Context {
            now_ns: self.now_ns,
            clocks: &self.clocks,
            outside: &mut self.outside,
            signals: &mut self.signals,
            misuse: &mut self.misuse,
        };
        let result = f(&mut self.devices, &mut context);
        if self.sources.len() != self.signals.len() {
            self.sources.resize(self.signals.len(), id);
        }
        self.misuse.truncate(MISUSE_KEPT);
        self.ask_next(id);
        result
    }

    /// Renews the time of a peripheral's next event.
    fn ask_next(&mut self, id: usize) {
        let next_ns = self.devices.get(id).next_event_ns();
        let was_ns = std::mem::replace(&mut self.next_ns[id], next_ns);
        if next_ns <= self.next_device_ns {
            self.next_device_ns = next_ns;
        } else if was_ns == self.next_device_ns {
            self.next_device_ns = self.next_ns.iter().copied().fold(u64::MAX, u64::min);
        }
    }

    /// Calls `f` with one peripheral as [`Peripheral`] and its context.
    fn with<R>(&mut self, id: usize, f: impl FnOnce(&mut dyn Peripheral, &mut Context<'_>) -> R) -> R {
        self.call(id, |devices, context| f(devices.get(id), context))
    }

    /// Carries out the signals of peripherals and their consequences, until none is left.
    fn settle(&mut self) {
        // Carrying out a signal may append more; an index allows for that, and keeps their order.
        let mut next = 0;
        loop {
            while next < self.signals.len() {
                let (signal, source) = (self.signals[next], self.sources[next]);
                next += 1;
                self.carry_out(signal, source);
            }
            self.signals.clear();
            self.sources.clear();
            next = 0;
            // DMA follows the signals: one of them may have raised or lowered a request.
            if !self.dma_beat() {
                break;
            }
        }
    }

    fn carry_out(&mut self, signal: Signal, source: usize) {
        match signal {
            Signal::Irq { number, level } => self.interrupt(number, level, source),
            Signal::Dma { request, level } => self.devices.dma.request(request, level),
            Signal::Bdma { request, level } => self.devices.bdma.request(request, level),
            Signal::Trigger { timer } => self.trigger(timer),
            Signal::TimerOutput { timer, channel, at_ns, high } => {
                let function = Function::Timer(timer, channel);
                self.devices.gpio.timer_output(function, Some(high), at_ns, &mut self.outside);
            }
            Signal::Nmi { level } => self.nmi = level,
            Signal::Exti { line, high } => {
                self.call(Id::Exti as usize, |devices, context| devices.exti.line(line, high, context));
            }
            Signal::Clocks => self.follow_clocks(),
            // Of two resets at one time, the one that loses more state counts.
            Signal::Reset(ResetCause::PowerOn) => self.reset = Some(ResetCause::PowerOn),
            Signal::Reset(cause) => self.reset = self.reset.or(Some(cause)),
        }
    }

    /// Sets an interrupt line of a peripheral. Lines that share a vector are ORed.
    fn interrupt(&mut self, number: u16, level: bool, source: usize) {
        let index = usize::from(number);
        if index >= self.asserted.len() {
            self.asserted.resize(index + 1, Vec::new());
        }
        let sources = &mut self.asserted[index];
        let was = !sources.is_empty();
        // A source is listed at most once, however often it repeats its level.
        sources.retain(|other| *other != source);
        if level {
            sources.push(source);
        }
        let is = !sources.is_empty();
        if was != is {
            self.irqs.push((number, is));
        }
    }

    /// Passes a timer's trigger output to its listeners.
    fn trigger(&mut self, timer: u8) {
        if let Some(input) = dma_trigger(timer) {
            self.call(Id::Dma as usize, |devices, context| devices.dma.trigger(input, context));
        }
        self.call(Id::Adc12 as usize, |devices, context| devices.adc.trigger(timer, context));
        self.call(Id::Dac1 as usize, |devices, context| devices.dac.trigger(timer, context));
    }

    /// Makes one access of a DMA controller; returns false if none wants any.
    fn dma_beat(&mut self) -> bool {
        if let Some(beat) = self.devices.dma.next_beat() {
            self.activity.beats += 1;
            let result = self.bus_access(beat);
            let finish = |devices: &mut Devices<F>, context: &mut Context<'_>| devices.dma.finish_beat(result, context);
            // DMA in one-shot mode ends the ADC's conversions with its last item.
            if let Some(request) = self.call(Id::Dma as usize, finish) {
                self.call(Id::Adc12 as usize, |devices, context| devices.adc.dma_ended(request, context));
            }
            return true;
        }
        if let Some(beat) = self.devices.bdma.next_beat() {
            self.activity.beats += 1;
            // The bus matrix connects BDMA to domain 3 only (RM0399, 2.1).
            let result = if beat.address < DOMAIN_3 { Err(dma::BusError) } else { self.bus_access(beat) };
            self.call(Id::Bdma as usize, |devices, context| devices.bdma.finish_beat(result, context));
            return true;
        }
        false
    }

    /// Accesses the bus for a DMA controller: memory that it reaches and that has a clock, or a peripheral.
    fn bus_access(&mut self, beat: dma::Beat) -> Result<u32, dma::BusError> {
        if let Some((region, _)) = self.memory.locate(beat.address) {
            let bank = region.bank;
            if bank.is_flash() && self.devices.flash.is_closed() {
                // The load sets the flag, and records the misuse.
                let load = |devices: &mut Devices<F>, context: &mut Context<'_>| {
                    let _ = devices.flash.load(beat.address, beat.size, context);
                };
                self.call(FLASH, load);
                return Err(dma::BusError);
            }
            // The bus would stall the DMA, which the model cannot; the program learns of it at its next access.
            if bank.is_flash() && self.devices.flash.busy_until_ns(beat.address).is_some() {
                let what = format!("DMA reads {:#010x} while the bank programs or erases: it would wait", beat.address);
                self.unmodelled = self.unmodelled.take().or(Some(Unmodelled { peripheral: "FLASH", what }));
                return Err(dma::BusError);
            }
            if !bank.on_bus() || !self.memory.is_enabled(bank) || self.memory.kept().contains(&beat.address) {
                let at_ns = self.now_ns;
                let what = format!("DMA cannot reach {bank} at {:#010x} (RM0399, 2.1; 9.5)", beat.address);
                self.misuse.push(Misuse { at_ns, peripheral: "DMA", what });
                return Err(dma::BusError);
            }
            return match beat.access {
                dma::Access::Read => self.memory.read(beat.address, beat.size).ok_or(dma::BusError),
                // The model lets only the core program the flash.
                dma::Access::Write(_) if bank.is_flash() => Err(dma::BusError),
                dma::Access::Write(value) => {
                    self.memory.write(beat.address, beat.size, value).map(|()| 0).ok_or(dma::BusError)
                }
            };
        }
        let Some(id) = self.map.find(beat.address) else { return Err(dma::BusError) };
        let offset = beat.address - self.bases[id];
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

    /// Handles a change of the clock tree: all peripherals advance to now with the old clocks and continue with the new
    /// ones.
    fn follow_clocks(&mut self) {
        for id in 0..Id::COUNT {
            // RCC, which made the change, is at the present moment already.
            if id != Id::Rcc as usize {
                self.with(id, |device, context| device.advance(context));
            }
        }
        self.clocks = self.devices.rcc.clocks();
        for id in 0..Id::COUNT {
            self.with(id, |device, context| device.clocks_changed(context));
        }
    }

    /// Updates the memories of domains 2 and 3 from their enable bits.
    fn update_memory_clocks(&mut self) {
        for bank in [Bank::Sram1, Bank::Sram2, Bank::Sram3, Bank::Backup] {
            let closed = bank == Bank::Backup && self.devices.flash.is_closed();
            self.memory.set_enabled(bank, self.devices.rcc.is_enabled(bank.span().0) && !closed);
        }
    }

    /// Updates contents and readability of the flash, after an access to it or an event in it.
    fn follow_flash(&mut self) {
        let flash = &mut self.devices.flash;
        // The swap exchanges the contents, so it precedes the update of the holes.
        if flash.cells.swap(flash.is_swapped()) {
            self.memory.swap_flash();
        }
        if flash.cells.take_changed() {
            for bank in FLASH_PARTS {
                self.memory.set_holes(bank, flash.cells.holes(bank));
            }
            self.memory.code_changed();
        }
        for bank in FLASH_PARTS {
            // A bank at work is taken from the core, so that its accesses and fetches stall in the chip.
            let waits = flash.busy_until_ns(bank.span().0).is_some();
            self.memory.set_enabled(bank, !waits && !flash.is_closed());
        }
        if flash.take_backup_erase() {
            self.devices.backup.clear();
            // The model fills it with zeros: our choice, the manual does not specify it.
            let (base, len) = Bank::Backup.span();
            (base..base + len).step_by(4).for_each(|address| {
                self.memory.write(address, Size::Word, 0);
            });
        }
        self.update_memory_clocks();
    }

    /// Exchanges state between RCC, PWR and SYSCFG, after a write to one of them or an event in it.
    fn link_power(&mut self) {
        // A write to RCC may have turned any clock off.
        self.clocked = [NO_BLOCK; CLOCKED];
        self.update_memory_clocks();
        for base in self.devices.rcc.take_resets() {
            if let Some(id) = self.map.find(base) {
                self.reset_part(id, base);
            }
        }
        self.call(Id::Rcc as usize, |devices, context| {
            let Devices { rcc, pwr, syscfg, flash, backup, .. } = devices;
            Wired { rcc, pwr, syscfg, flash, backup }.settle(context);
        });
    }

    /// Carries out a reset bit of RCC for one block, where several share a model.
    fn reset_part(&mut self, id: usize, base: u32) {
        self.call(id, |devices, context| match base {
            0x4002_0000 => devices.dma.reset_part(dma::Part::Dma1, context),
            0x4002_0400 => devices.dma.reset_part(dma::Part::Dma2, context),
            0x5802_0000..0x5802_2C00 => devices.gpio.reset_port(((base >> 10) & 0xF) as usize, context),
            _ => devices.get(id).reset(context),
        });
    }

    /// Passes changes at input pins to the chip.
    pub fn poll_outside(&mut self) {
        self.activity.polls += 1;
        // The buffer is reused, and taken out because carrying out an edge borrows the chip.
        let mut edges = std::mem::take(&mut self.edges);
        self.outside.poll(self.now_ns, &mut edges);
        for edge in edges.drain(..) {
            self.edge(edge);
        }
        self.edges = edges;
        self.settle();
        self.next_poll_ns = self.outside.next_poll_ns(self.now_ns, &self.watched);
    }

    fn edge(&mut self, edge: Edge) {
        if let Some(Function::Timer(timer, channel)) = self.devices.gpio.function(edge.pin)
            && let Some(index) = TIMERS.iter().position(|number| *number == timer)
        {
            self.call(Id::Tim1 as usize + index, |devices, context| {
                devices.timers[index].edge(channel, edge.high, edge.at_ns, context);
            });
        }
        self.call(Id::Exti as usize, |devices, context| devices.exti.edge(&devices.syscfg, edge, context));
    }

    /// Updates timers after pins of a port got other functions: they see the levels of their present pins.
    fn connect_timers(&mut self, port: u8) {
        for number in 0..16 {
            let pin = Pin { port, number };
            if let Some(Function::Timer(..)) = self.devices.gpio.function(pin) {
                let high = self.devices.gpio.level(pin, self.now_ns, &mut self.outside);
                self.edge(Edge { at_ns: self.now_ns, pin, high });
            }
        }
    }

    /// Collects the pins whose changes must be reported at once: those with an interrupt, or those of a timer that may
    /// raise one.
    fn update_watched(&mut self) {
        let Devices { exti, syscfg, gpio, timers, .. } = &self.devices;
        self.watched.clear();
        self.watched.extend(exti.watched(syscfg));
        for ((timer, number), watching) in timers.iter().zip(TIMERS).zip(&mut self.watching) {
            *watching = timer.watching();
            for channel in (1..=4).filter(|channel| *watching >> (channel - 1) & 1 != 0) {
                self.watched.extend(gpio.pins_with(Function::Timer(number, channel)));
            }
        }
        // Other pins are watched now: the outside world is asked again at once.
        self.next_poll_ns = self.now_ns;
    }
}

impl<O: Outside, F: FlashCells> Soc<O, F> {
    /// Queues a byte for a UART of the chip; its time must not be before now.
    pub fn uart_receive(&mut self, port: u8, byte: UartByte) {
        let index = usize::from(port).wrapping_sub(1);
        if let Some(usart) = self.devices.usarts.get_mut(index) {
            usart.receive(byte);
            self.ask_next(Id::Usart1 as usize + index);
        }
    }

    /// Queues a frame for an FDCAN of the chip, which ends at `at_ns`.
    pub fn can_receive(&mut self, bus: u8, at_ns: u64, frame: CanFrame) {
        self.devices.fdcan.receive(bus, at_ns, frame);
        self.ask_next(Id::Fdcan as usize);
    }

    /// Makes the flash word at `address` fail its error correction from now on, as after a power cut during its
    /// programming (RM0399, 4.3 "Error code correction"), until it is erased.
    pub fn spoil_flash(&mut self, address: u32) {
        if let Some(word) = self.devices.flash.word_at(address) {
            self.devices.flash.cells.abandon(word, 1);
        }
        self.follow_flash();
    }

    /// Sets the boot address: the vector table to which a bootloader would jump, if not that of bank 1.
    pub fn set_boot_address(&mut self, address: u32) {
        self.boot = address;
    }

    /// Returns RCC, to remove crystals or to let them drift.
    pub fn rcc(&mut self) -> &mut Rcc {
        &mut self.devices.rcc
    }

    /// Accesses a peripheral for the processor.
    fn access<R>(
        &mut self,
        now_ns: u64,
        address: u32,
        write: bool,
        f: impl FnOnce(&mut dyn Peripheral, u32, &mut Context<'_>) -> Result<R, Unmodelled>,
    ) -> Result<(R, usize), AccessError> {
        // Events before the access come first; an access always sees the peripheral at its own time.
        self.advance(now_ns);
        if let Some(unmodelled) = self.unmodelled.take() {
            return Err(unmodelled.into());
        }
        let Some(id) = self.map.find(address) else {
            // The gaps between memories answer with a bus error, as on the chip.
            if address < PERIPHERALS {
                let what = format!("an access to {address:#010x}, where no memory is: a bus error (RM0399, 2.3.2)");
                self.misuse.push(Misuse { at_ns: now_ns, peripheral: "bus", what });
                self.misuse.truncate(MISUSE_KEPT);
                return Err(AccessError::Bus);
            }
            let what = format!("nothing is modelled at {address:#010x}");
            return Err(Unmodelled { peripheral: "bus", what }.into());
        };
        // The access is forbidden; its result is not modelled, so the run ends.
        if id == Id::Backup as usize && self.devices.flash.is_closed() {
            let what = "the backup registers at readout protection level 1 with a debugger (RM0399, 4.5.3)".into();
            return Err(Unmodelled { peripheral: "RTC", what }.into());
        }
        self.activity.accessed(id, address, write);
        // The check of the clock is needed at each access, so its result is cached by block.
        let block = address >> 10;
        let place = block as usize % CLOCKED;
        if self.clocked[place] != block {
            if self.devices.rcc.is_enabled(address & !0x3FF) {
                self.clocked[place] = block;
            } else {
                let what = format!("access to {address:#010x} while its clock is off (RM0399, 9.5.10)");
                self.misuse.push(Misuse { at_ns: now_ns, peripheral: "RCC", what });
            }
        }
        let base = self.bases[id];
        // Only timers and EXTI depend on the edges of a poll, which is expensive.
        let sees_pins = match id {
            TIM1..=TIM17 => self.devices.timers[id - TIM1].needs_inputs(address - base, write),
            EXTI => true,
            _ => false,
        };
        if sees_pins {
            self.poll_outside();
        }
        let result = self.with(id, |device, context| f(device, address - base, context))?;
        Ok((result, id))
    }
}

impl<O: Outside, F: FlashCells> Chip for Soc<O, F> {
    fn memory(&self) -> &Memory {
        &self.memory
    }

    fn read(&mut self, now_ns: u64, address: u32, size: Size) -> Result<u32, AccessError> {
        if let Some((region, _)) = self.memory.locate(address) {
            let is_flash = region.bank.is_flash();
            // The core reaches enabled RAM directly, so an access here has no clock.
            return if is_flash { self.load_flash(now_ns, address, size) } else { Err(AccessError::Bus) };
        }
        let (value, _) =
            self.access(now_ns, address, false, |device, offset, context| device.read(offset, size, context))?;
        self.settle();
        Ok(value)
    }

    fn write(&mut self, now_ns: u64, address: u32, size: Size, value: u32) -> Result<(), AccessError> {
        if let Some((region, _)) = self.memory.locate(address) {
            let is_flash = region.bank.is_flash();
            return if is_flash { self.program_flash(now_ns, address, size, value) } else { Err(AccessError::Bus) };
        }
        let write =
            |device: &mut dyn Peripheral, offset, context: &mut Context<'_>| device.write(offset, size, value, context);
        let ((), id) = self.access(now_ns, address, true, write)?;
        // These three exchange voltages, limits and clock enables.
        if id == Id::Rcc as usize || id == Id::Pwr as usize || id == Id::Syscfg as usize {
            self.link_power();
        }
        if id == FLASH {
            self.follow_flash();
        }
        // A new selection of edges or ports changes the pins whose edges must be noticed at once.
        if id == EXTI && Exti::chooses(address & 0x3FF) || id == Id::Syscfg as usize {
            self.update_watched();
        }
        // MODER and AFR connect pins to timers.
        if id == Id::Gpio as usize && matches!(address & 0x3FF, MODER | AFRL | AFRH) {
            self.connect_timers((address >> 10 & 0xF) as u8);
            self.update_watched();
        }
        if (TIM1..=TIM17).contains(&id) {
            let index = id - TIM1;
            if self.watching[index] != self.devices.timers[index].watching() {
                self.update_watched();
            }
        }
        self.settle();
        // An output may have changed the world: the time of its next change is no longer valid.
        if id == Id::Gpio as usize || id == Id::Dac1 as usize {
            self.next_poll_ns = self.outside.next_poll_ns(now_ns, &self.watched);
        }
        Ok(())
    }

    fn advance(&mut self, now_ns: u64) {
        loop {
            let due = self.next_event_ns();
            if due > now_ns {
                break;
            }
            self.now_ns = self.now_ns.max(due);
            if self.next_poll_ns <= self.now_ns {
                self.poll_outside();
                // The next poll is at least 1 ns later, whatever the outside world returns: time must advance.
                self.next_poll_ns = self.next_poll_ns.max(self.now_ns + 1);
            }
            // If only a poll was due, no peripheral needs to be advanced.
            let looked_at = if self.next_device_ns <= self.now_ns { Id::COUNT } else { 0 };
            for id in 0..looked_at {
                if self.next_ns[id] <= self.now_ns {
                    self.activity.advanced(id);
                    self.with(id, |device, context| device.advance(context));
                    if id == Id::Rcc as usize || id == Id::Pwr as usize || id == FLASH {
                        self.link_power();
                    }
                    if id == FLASH {
                        self.follow_flash();
                    }
                }
            }
            self.settle();
        }
        self.now_ns = self.now_ns.max(now_ns);
    }

    fn next_event_ns(&self) -> u64 {
        self.next_device_ns.min(self.next_poll_ns)
    }

    fn take_irqs(&mut self, changes: &mut Vec<(u16, bool)>) {
        changes.append(&mut self.irqs);
    }

    fn wants_reset(&self) -> bool {
        self.reset.is_some()
    }

    fn take_reset(&mut self) -> Option<ResetCause> {
        self.reset.take()
    }

    fn reset(&mut self, now_ns: u64, cause: ResetCause) {
        self.now_ns = self.now_ns.max(now_ns);
        // A pending request of the chip is covered by this reset.
        self.reset = None;
        self.devices.rcc.note_reset(cause);
        if self.devices.pwr.take_power_loss() {
            // The model assumes no supply at VBAT: the backup domain loses power with VDD.
            self.devices.pwr.power_on();
            self.devices.rcc.reset_backup();
            self.devices.backup.clear();
            self.devices.flash.power_on();
            self.memory.lose_power();
        }
        for id in 0..Id::COUNT {
            self.with(id, |device, context| device.reset(context));
        }
        // Pending signals between peripherals are lost with the reset; levels of interrupt lines are not.
        for index in 0..self.signals.len() {
            match self.signals[index] {
                Signal::Irq { number, level } => self.interrupt(number, level, self.sources[index]),
                Signal::Nmi { level } => self.nmi = level,
                _ => {}
            }
        }
        self.signals.clear();
        self.sources.clear();
        // Clocks come first: limits and wait states are judged by them.
        self.follow_clocks();
        self.link_power();
        self.follow_flash();
        // IWDG1_SW of the option bytes makes it a hardware watchdog, running from reset.
        if self.devices.flash.starts_watchdog() {
            self.call(Id::Iwdg as usize, |devices, context| devices.iwdg.start(context));
        }
        self.update_watched();
        self.settle();
    }

    fn outside_waits(&self) -> bool {
        self.outside.wants_to_run()
    }

    fn nmi(&self) -> bool {
        self.nmi
    }

    fn stable_until_ns(&self, now_ns: u64, address: u32) -> Option<u64> {
        let id = self.map.find(address)?;
        self.devices.stable_until_ns(id, address - self.bases[id], now_ns)
    }

    fn fetch_waits_until_ns(&self, address: u32) -> Option<u64> {
        self.devices.flash.busy_until_ns(address)
    }

    fn is_halted(&self) -> bool {
        self.clocks.core_hz == 0 || self.devices.pwr.is_held()
    }

    fn core_hz(&self) -> u64 {
        self.clocks.core_hz
    }

    fn vector_table(&self) -> u32 {
        self.boot
    }
}

impl<O: Outside, F: FlashCells> Soc<O, F> {
    fn load_flash(&mut self, now_ns: u64, address: u32, size: Size) -> Result<u32, AccessError> {
        self.advance(now_ns);
        let result = self.call(Id::Flash as usize, |devices, context| devices.flash.load(address, size, context));
        self.settle();
        result.map_err(|error| match error {
            LoadError::Ecc | LoadError::Protected | LoadError::Outside => AccessError::Bus,
            LoadError::Busy { until_ns } => AccessError::Busy { until_ns },
        })
    }

    fn program_flash(&mut self, now_ns: u64, address: u32, size: Size, value: u32) -> Result<(), AccessError> {
        self.advance(now_ns);
        self.call(FLASH, |devices, context| devices.flash.store(address, size, value, context));
        self.follow_flash();
        self.settle();
        Ok(())
    }
}

/// Timer numbers in the order of their [`Id`]s.
const TIMERS: [u8; 14] = [1, 2, 3, 4, 5, 6, 7, 8, 12, 13, 14, 15, 16, 17];
/// Unique number engraved in the emulated chip: "R4 emulated!" in ASCII.
const UNIQUE: [u32; 3] = [0x6520_3452, 0x616C_756D, 0x2164_6574];

/// Returns the input of DMAMUX1's request generators for a timer's trigger output (RM0399, 18.3.2).
fn dma_trigger(timer: u8) -> Option<u8> {
    (timer == 12).then_some(7)
}
