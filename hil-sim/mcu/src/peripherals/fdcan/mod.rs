//! FDCAN1 and FDCAN2 with their common message RAM (RM0399, chapter 59): Bosch's M_CAN 3.2.1.
//!
//! One [`Peripheral`](crate::Peripheral) from 0x4000_A000 on, 13 KB long: FDCAN1 at 0x000, FDCAN2 at 0x400, the clock
//! calibration unit at 0x800, the message RAM at 0xC00.
//!
//! A frame takes the time of its bits, stuff bits included (`wire.rs`). It is passed to
//! [`Outside::can_sent`](crate::Outside::can_sent) at the end of its acknowledge slot, and is complete at the end of
//! EOF. Frames of other nodes are queued by [`Fdcan::receive`] with the end of their EOF; a transmission waits until
//! they are over.
//!
//! Deviations: a node begins a frame at the moment it may (the chip at its next bit, less than a bit later); an error
//! reported by the outside world is detected in the acknowledge slot, wherever it was; an error frame is 14 bits long;
//! the delay of the transceiver is 0, so that TDCV shows TDCO; every received frame was sent by an error-active node.
//!
//! TTCAN, the clock calibration unit (assumed bypassed), the timeout counter, timestamps of TIM3, and software control
//! of the transmit pin are not modelled and end the run. Debug messages are reported and dropped.

mod access;
mod errors;
mod filter;
mod ram;
mod receive;
mod registers;
mod transmit;
mod wire;

#[cfg(test)]
mod tests;

use std::collections::VecDeque;

use crate::context::{Clocks, Context, Ticks};
use crate::outside::CanFrame;

use self::errors::{Dominant, Errors, LastError};
use self::ram::MessageRam;
use self::receive::RxFifo;
use self::registers as register;
use self::registers::{cccr, ir, psr, test, txbc};
use self::transmit::Transmission;
use self::wire::{AFTER_ACK_BITS, BitTime};

/// Names of the modules, and their interrupt numbers (RM0399, chapter 20).
const MODULES: [(&str, [u16; 2]); 2] = [("FDCAN1", [19, 21]), ("FDCAN2", [20, 22])];

/// Number of a module's register words up to TXEFA.
const REGISTERS: usize = 64;

/// Both modules and their message RAM.
#[derive(Clone, Debug)]
pub struct Fdcan {
    modules: [Module; 2],
    ram: MessageRam,
}

impl Default for Fdcan {
    fn default() -> Self {
        Self::new()
    }
}

impl Fdcan {
    /// Makes the modules in their reset state; the message RAM is zeros (undefined on the chip).
    #[must_use]
    pub fn new() -> Self {
        Self { modules: [Module::new(1), Module::new(2)], ram: MessageRam::new() }
    }

    /// Queues a frame of another node on bus 1 or 2, whose EOF ends at `at_ns`. Call it before the frame begins (its
    /// length is [`Fdcan::frame_ns`]), in order of time, and not for a time in which this node sends
    /// ([`Fdcan::sends_until_ns`]).
    pub fn receive(&mut self, bus: u8, at_ns: u64, frame: CanFrame) {
        self.module_mut(bus).queue(at_ns, frame);
    }

    /// Returns true if the node on that bus would acknowledge a frame that is on the bus at `now_ns`.
    #[must_use]
    pub fn acknowledges(&self, bus: u8, now_ns: u64) -> bool {
        let module = self.module(bus);
        module.takes_part(now_ns) && module.dominant.is_none() && !module.on(cccr::MON) && !module.loops_back()
    }

    /// Returns the end of EOF of the frame that the node is sending, ns; `None` if it sends none.
    #[must_use]
    pub fn sends_until_ns(&self, bus: u8) -> Option<u64> {
        self.module(bus).transmission.as_ref().map(Transmission::end_ns)
    }

    /// Returns the duration of a frame at the bit rates of that node, from SOF to the end of EOF, ns; `u64::MAX`
    /// without a clock.
    #[must_use]
    pub fn frame_ns(&self, bus: u8, frame: &CanFrame) -> u64 {
        self.module(bus).frame_ns(frame)
    }

    /// Returns the bit rates of the arbitration and the data phase, bit/s, by the clock tree at the last access.
    #[must_use]
    pub fn bit_rates(&self, bus: u8) -> (f64, f64) {
        let module = self.module(bus);
        let rate = |bit: BitTime| module.kernel_hz as f64 / bit.clocks() as f64;
        (rate(module.nominal()), rate(module.data()))
    }

    /// Sends the node to bus-off now, as 32 destroyed frames would.
    pub fn inject_bus_off(&mut self, bus: u8, context: &mut Context<'_>) {
        self.inject(bus, context, |module| module.count(|errors| errors.transmit = 256));
    }

    /// Sets the error counters TEC (0 to 255) and REC (0 to 128).
    pub fn set_error_counters(&mut self, bus: u8, transmit: u8, receive: u8, context: &mut Context<'_>) {
        self.inject(bus, context, |module| {
            module.count(|errors| {
                errors.transmit = u32::from(transmit);
                errors.receive = u32::from(receive).min(128);
            });
        });
    }

    /// Starts or ends a fault that holds the bus dominant: a short, or a failed transceiver. It aborts a frame that
    /// this node is sending.
    pub fn hold_dominant(&mut self, bus: u8, held: bool, context: &mut Context<'_>) {
        let now_ns = context.now_ns;
        self.inject(bus, context, |module| module.hold_dominant(held, now_ns));
    }

    /// Destroys a frame of another node now: REC increases by one.
    pub fn inject_receive_error(&mut self, bus: u8, context: &mut Context<'_>) {
        self.inject(bus, context, |module| {
            module.protocol_error(LastError::Form, false, |errors| errors.receive = (errors.receive + 1).min(128));
        });
    }

    fn inject(&mut self, bus: u8, context: &mut Context<'_>, change: impl FnOnce(&mut Module)) {
        self.bring_to_now(context);
        let module = self.module_mut(bus);
        change(module);
        module.update_lines(context);
    }

    fn module(&self, bus: u8) -> &Module {
        &self.modules[usize::from(bus == 2)]
    }

    fn module_mut(&mut self, bus: u8) -> &mut Module {
        &mut self.modules[usize::from(bus == 2)]
    }
}

/// Progress of the recovery from bus-off.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Recovery {
    /// Time at which INIT was cleared, ns.
    since_ns: u64,
    /// Sequences of 11 recessive bits since then.
    seen: u32,
}

/// State of one module.
#[derive(Clone, Debug)]
struct Module {
    bus: u8,
    name: &'static str,
    irqs: [u16; 2],
    /// Registers that are stored as written, and IR.
    registers: [u32; REGISTERS],
    errors: Errors,
    /// Bits PXE, REDL, RBRS, RESI and TDCV of PSR.
    protocol: u32,
    /// Time from which the module takes part in communication while INIT is 0, ns.
    synchronised_ns: u64,
    recovery: Option<Recovery>,
    /// State of a bus that is held dominant.
    dominant: Option<Dominant>,
    /// Time from which the bus is free for a frame of this node, ns.
    free_ns: u64,
    requested_ns: u64,
    transmission: Option<Transmission>,
    /// Put and get index of the Tx FIFO or queue, counted from its first buffer.
    tx_put: usize,
    tx_get: usize,
    /// Number of elements of the Tx FIFO from the get to the put index.
    tx_taken: usize,
    tx_events: RxFifo,
    coming: VecDeque<(u64, CanFrame)>,
    fifos: [RxFifo; 2],
    timestamp_start_ns: u64,
    kernel_hz: u64,
    apb_hz: u64,
    lines: [bool; 2],
}

impl Module {
    fn new(bus: u8) -> Self {
        let (name, irqs) = MODULES[usize::from(bus == 2)];
        let mut registers = [0; REGISTERS];
        for (offset, value) in register::RESET_VALUES {
            registers[offset as usize / 4] = value;
        }
        Self {
            bus,
            name,
            irqs,
            registers,
            errors: Errors::default(),
            protocol: 0,
            synchronised_ns: 0,
            recovery: None,
            dominant: None,
            free_ns: 0,
            requested_ns: 0,
            transmission: None,
            tx_put: 0,
            tx_get: 0,
            tx_taken: 0,
            tx_events: RxFifo::default(),
            coming: VecDeque::new(),
            fifos: [RxFifo::default(); 2],
            timestamp_start_ns: 0,
            kernel_hz: 0,
            apb_hz: 0,
            lines: [false; 2],
        }
    }

    fn reg(&self, offset: u32) -> u32 {
        self.registers[offset as usize / 4]
    }

    fn set_reg(&mut self, offset: u32, value: u32) {
        self.registers[offset as usize / 4] = value;
    }

    /// Returns a bit of CCCR.
    fn on(&self, bit: u32) -> bool {
        self.reg(register::CCCR) & bit != 0
    }

    fn raise(&mut self, flags: u32) {
        self.set_reg(register::IR, self.reg(register::IR) | flags);
    }

    fn use_clocks(&mut self, clocks: &Clocks) {
        self.kernel_hz = clocks.fdcan_hz;
        self.apb_hz = clocks.apb1_hz;
    }

    fn nominal(&self) -> BitTime {
        let nbtp = self.reg(register::NBTP);
        BitTime::new(nbtp >> 16 & 0x1FF, nbtp >> 8 & 0xFF, nbtp & 0x7F)
    }

    fn data(&self) -> BitTime {
        let dbtp = self.reg(register::DBTP);
        BitTime::new(dbtp >> 16 & 0x1F, dbtp >> 8 & 0x1F, dbtp >> 4 & 0xF)
    }

    /// Returns the count of kernel clocks from `start_ns` on.
    fn kernel_from(&self, start_ns: u64) -> Ticks {
        Ticks { start_ns, frequency_hz: self.kernel_hz, divider: 1 }
    }

    /// Returns the time `bits` nominal bits after `start_ns`, ns.
    fn bits_after(&self, start_ns: u64, bits: u64) -> u64 {
        self.kernel_from(start_ns).when_ns(bits * self.nominal().clocks())
    }

    fn clocks_to_ack(&self, frame: &CanFrame, esi: bool) -> u64 {
        wire::clocks_to_ack(frame, esi, self.on(cccr::NISO), self.nominal(), self.data())
    }

    fn frame_ns(&self, frame: &CanFrame) -> u64 {
        let clocks = self.clocks_to_ack(frame, false) + AFTER_ACK_BITS * self.nominal().clocks();
        self.kernel_from(0).when_ns(clocks)
    }

    fn loops_back(&self) -> bool {
        self.reg(register::TEST) & test::LBCK != 0
    }

    /// Returns true if the module is not in initialisation, not bus-off, and no longer waits for 11 recessive bits.
    fn takes_part(&self, now_ns: u64) -> bool {
        !self.on(cccr::INIT) && !self.errors.bus_off && now_ns >= self.synchronised_ns
    }

    /// Enters initialisation, with INIT = 1: no message is sent or received, a frame on the wire is aborted (59.4.1,
    /// software initialization).
    fn enter_init(&mut self) {
        self.set_reg(register::CCCR, self.reg(register::CCCR) | cccr::INIT);
        // The frame on the wire is lost; its request in TXBRP stays.
        self.transmission = None;
        self.recovery = None;
        self.protocol &= !(0x7F << psr::TDCV_AT);
    }

    /// Leaves initialisation, with INIT = 0.
    fn leave_init(&mut self, now_ns: u64) {
        self.set_reg(register::CCCR, self.reg(register::CCCR) & !(cccr::INIT | cccr::CCE));
        if self.errors.bus_off {
            // During the recovery REC counts the sequences of 11 recessive bits.
            self.errors.receive = 0;
            self.recovery = Some(Recovery { since_ns: now_ns, seen: 0 });
            self.synchronised_ns = self.bits_after(now_ns, 11 * u64::from(errors::RECOVERY_SEQUENCES));
        } else {
            // The node takes part after 11 recessive bits, which show an idle bus.
            self.synchronised_ns = self.bits_after(now_ns, 11);
        }
        self.free_ns = self.free_ns.max(self.synchronised_ns);
    }

    /// Enters configuration, with CCE = 1: status registers are as after reset, both message handlers are idle.
    fn enter_configuration(&mut self) {
        for offset in [register::HPMS, register::TXBRP, register::TXBCR, register::TXBTO, register::TXBCF] {
            self.set_reg(offset, 0);
        }
        self.fifos = [RxFifo::default(); 2];
        self.tx_events = RxFifo::default();
        self.tx_put = 0;
        self.tx_get = 0;
        self.tx_taken = 0;
    }

    fn recovery_ns(&self) -> u64 {
        self.recovery
            // A dominant bus has no recessive sequences, so the recovery makes no progress.
            .filter(|_| self.dominant.is_none())
            .map_or(u64::MAX, |recovery| self.bits_after(recovery.since_ns, 11 * (u64::from(recovery.seen) + 1)))
    }

    /// Returns the time base of the timestamp counter: multiples of nominal bits.
    fn timestamp_ticks(&self) -> Ticks {
        let prescaler = u64::from(self.reg(register::TSCC) >> 16 & 0xF) + 1;
        let divider = prescaler * self.nominal().clocks();
        Ticks { start_ns: self.timestamp_start_ns, frequency_hz: self.kernel_hz, divider }
    }

    fn counts_timestamps(&self) -> bool {
        self.reg(register::TSCC) & 3 == 1
    }

    fn timestamp(&self, at_ns: u64) -> u32 {
        if !self.counts_timestamps() {
            return 0;
        }
        let ticks = self.timestamp_ticks();
        // The frame may have begun before the counter's last wrap.
        let before = Ticks { start_ns: at_ns, ..ticks }.at(ticks.start_ns);
        (ticks.at(at_ns) as u32).wrapping_sub(before as u32) & 0xFFFF
    }

    fn timestamp_wrap_ns(&self) -> u64 {
        if self.counts_timestamps() { self.timestamp_ticks().when_ns(0x1_0000) } else { u64::MAX }
    }

    fn transmission_ns(&self) -> u64 {
        self.transmission.as_ref().map_or(u64::MAX, Transmission::next_ns)
    }

    fn coming_ns(&self) -> u64 {
        self.coming.front().map_or(u64::MAX, |(at_ns, _)| *at_ns)
    }

    /// Returns the time of the next observable event, ns; a wrap of the timestamp counter counts only with its
    /// interrupt.
    fn next_event_ns(&self) -> u64 {
        let wrap_ns = if self.reg(register::IE) & ir::TSW != 0 { self.timestamp_wrap_ns() } else { u64::MAX };
        self.next_but_wrap_ns().min(wrap_ns)
    }

    fn next_ns(&self) -> u64 {
        self.next_but_wrap_ns().min(self.timestamp_wrap_ns())
    }

    fn next_but_wrap_ns(&self) -> u64 {
        let start_ns = self.start_ns().unwrap_or(u64::MAX);
        let dominant_ns = self.dominant.map_or(u64::MAX, |dominant| dominant.next_ns);
        [self.transmission_ns(), self.coming_ns(), start_ns, self.recovery_ns(), dominant_ns]
            .into_iter()
            .min()
            .unwrap_or(u64::MAX)
    }

    fn bring_to_now(&mut self, ram: &mut MessageRam, context: &mut Context<'_>) {
        self.use_clocks(context.clocks);
        loop {
            // Each event may change the time of the others, so each pass determines the next one anew.
            let at_ns = self.next_ns();
            if at_ns > context.now_ns || at_ns == u64::MAX {
                break;
            }
            if at_ns == self.timestamp_wrap_ns() {
                self.timestamp_start_ns = at_ns;
                self.raise(ir::TSW);
            } else if let Some(recovery) = self.recovery.filter(|_| at_ns == self.recovery_ns()) {
                self.recovery_sequence(recovery);
            } else if let Some(dominant) = self.dominant.filter(|dominant| at_ns == dominant.next_ns) {
                self.dominant_bits(dominant);
            } else if at_ns == self.transmission_ns() {
                self.transmission_event(at_ns, ram, context);
            } else if at_ns == self.coming_ns() {
                if let Some((_, frame)) = self.coming.pop_front() {
                    self.frame_arrived(at_ns, &frame, ram, context);
                }
            } else {
                self.start(at_ns, ram);
            }
        }
        self.stop_clock_if_asked(context.now_ns);
    }

    /// Stops the clock at the request CSR: INIT and then CSA are set once all work is done (59.4.1, power down).
    fn stop_clock_if_asked(&mut self, now_ns: u64) {
        // A pending request is sent first, unless initialisation blocks it.
        let quiet = self.transmission.is_none() && (self.reg(register::TXBRP) == 0 || self.on(cccr::INIT));
        if self.on(cccr::CSR) && !self.on(cccr::CSA) && quiet && now_ns >= self.free_ns {
            self.enter_init();
            self.set_reg(register::CCCR, self.reg(register::CCCR) | cccr::CSA);
        }
    }

    /// Returns the value of PSR (59.5.13).
    fn psr(&self, now_ns: u64) -> u32 {
        let receiving = self
            .coming
            .front()
            .is_some_and(|(at_ns, frame)| now_ns < *at_ns && at_ns.saturating_sub(self.frame_ns(frame)) <= now_ns);
        let activity = match () {
            () if !self.takes_part(now_ns) => 0,
            () if self.transmission.is_some() => 3,
            () if receiving => 2,
            () => 1,
        };
        self.protocol
            | self.errors.state()
            | activity << psr::ACT_AT
            | self.errors.last as u32
            | (self.errors.last_in_data as u32) << psr::DLEC_AT
    }

    /// Returns the value of TXFQS (59.5.35).
    fn txfqs(&self) -> u32 {
        let (first, size) = self.tx_fifo_place();
        if size == 0 {
            return 0;
        }
        let put = ((first + self.tx_put) as u32) << 16;
        let full = |taken: usize| u32::from(taken == size) << 21;
        if self.reg(register::TXBC) & txbc::TFQM != 0 {
            return full(self.tx_fifo_pending()) | put;
        }
        full(self.tx_taken) | put | ((first + self.tx_get) as u32) << 8 | (size - self.tx_taken) as u32
    }

    fn update_lines(&mut self, context: &mut Context<'_>) {
        let flags = self.reg(register::IR) & self.reg(register::IE);
        let select = self.reg(register::ILS);
        let enable = self.reg(register::ILE);
        let lines = [flags & !select != 0 && enable & 1 != 0, flags & select != 0 && enable & 2 != 0];
        for (nth, level) in lines.into_iter().enumerate() {
            if level != self.lines[nth] {
                context.irq(self.irqs[nth], level);
            }
        }
        self.lines = lines;
    }
}
