//! NXP PCA9685: sixteen 12-bit PWM outputs on I2C. Section numbers are those of its datasheet, rev. 4.
//!
//! # Time
//! The model is lazy: it has no event queue. Every call with a time first advances the chip to it; an earlier time than
//! one already seen counts as that one. A register write is committed at STOP, or at the ACK of the last of a channel's
//! four registers (MODE2.OCH), and reaches the pin at the end of the PWM cycle (7.3.3, 7.3.4), to the nanosecond:
//! boundaries are whole multiples of the exact period, rounded down.
//!
//! # Where the datasheet leaves room
//! - With every output full OFF the cycle timing is disabled (7.3.3, remark). The first output to leave full OFF
//!   therefore starts a cycle at once, at the STOP; and SLEEP then takes effect at once and leaves RESTART clear.
//! - SLEEP while outputs run takes effect at the end of the cycle, when RESTART is set (7.3.1.1). Waking before that
//!   continues without interruption; a new prescaler then applies from the end of the cycle.
//! - While the oscillator is off or starting, outputs are off (low; high with INVRT). They run from 500 us after
//!   waking: the datasheet's maximum is taken as the value.
//! - Channels that were running when put to sleep stay off after waking until RESTART is written, or until their own
//!   registers are.
//! - An ON count after the OFF count, or full ON with an ON count, first turns on at that count, also in the first
//!   cycle (figures 9 to 11).
//! - The bus time-out (25 ms, table 15, note 1) is not modelled.

mod cycle;
mod registers;
#[cfg(test)]
mod tests;

use crate::chips::{COUNTS, Line};
use crate::i2c::I2cChip;
use crate::misuse::{Misuse, MisuseKind, MisuseLog};
use cycle::{Cycle, Rate};
use registers::{COUNT, FULL, mode1, mode2};

/// Number of outputs of the chip.
pub const CHANNELS: usize = 16;

/// ON and OFF registers of a channel, 13 bits each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Pattern {
    on: u16,
    off: u16,
}

impl Pattern {
    const FULL_OFF: Self = Self { on: 0, off: FULL };

    const fn from_registers(registers: [u8; 4]) -> Self {
        let [on_l, on_h, off_l, off_h] = registers;
        Self { on: u16::from_le_bytes([on_l, on_h]), off: u16::from_le_bytes([off_l, off_h]) }
    }

    /// Full OFF has priority over full ON (7.3.3).
    const fn is_full_off(self) -> bool {
        self.off & FULL != 0
    }

    const fn is_full_on(self) -> bool {
        self.on & FULL != 0 && !self.is_full_off()
    }

    const fn on_count(self) -> u16 {
        self.on & COUNT
    }

    const fn off_count(self) -> u16 {
        self.off & COUNT
    }

    /// True for a pattern without a pulse that is neither full ON nor full OFF: the datasheet forbids it (7.3.4), the
    /// output stays off.
    const fn is_empty(self) -> bool {
        !self.is_full_off() && !self.is_full_on() && self.on_count() == self.off_count()
    }

    const fn line(self) -> Line {
        if self.is_full_off() || self.is_empty() {
            Line::Low
        } else if self.is_full_on() {
            Line::High
        } else {
            Line::Pwm { on: self.on_count(), off: self.off_count() }
        }
    }

    /// State in the first cycle: the output cannot be high before the ON count, since nothing has turned it on.
    const fn first_line(self) -> Line {
        if self.turns_on_late() { Line::Pwm { on: self.on_count(), off: 0 } } else { self.line() }
    }

    const fn turns_on_late(self) -> bool {
        let on = self.on_count();
        !self.is_full_off() && on > 0 && (self.is_full_on() || (self.off_count() > 0 && on > self.off_count()))
    }

    const fn is_high_at_end(self) -> bool {
        self.line().is_high_at(COUNTS - 1, false)
    }
}

/// State of the oscillator and the cycle counter.
#[derive(Clone, Copy, Debug)]
enum Timing {
    /// No clock: asleep, or EXTCLK without one.
    Off,
    /// The oscillator is starting.
    Starting { ready_ns: u64 },
    /// Clock running, but every output full OFF: no cycles.
    Idle,
    /// PWM cycles are running.
    Running(Cycle),
}

/// Phase of an I2C transfer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Transfer {
    /// Not addressed by the bus.
    None,
    /// Addressed for writing; the next byte is the register pointer.
    Pointer,
    /// The next byte goes to, or comes from, the register pointed at.
    Data,
    /// A byte was not acknowledged; the rest is not either.
    Refused,
    /// General call; its data byte follows.
    GeneralCall,
    /// General call with 06h: a STOP now resets the chip (7.6).
    ResetAtStop,
}

/// Simulated chip with its outputs.
#[derive(Clone, Debug)]
pub struct Pca9685 {
    address: u8,
    oscillator_hz: u32,
    external_clock_hz: Option<u32>,
    outputs_enabled: bool,

    mode1: u8,
    mode2: u8,
    subaddresses: [u8; 3],
    all_call: u8,
    led: [[u8; 4]; CHANNELS],
    prescale: u8,

    pointer: u8,
    transfer: Transfer,
    /// Channels written since the last STOP (OCH = 0).
    written: u16,
    /// Registers of each channel written since its last commit, one bit each (OCH = 1).
    loaded: [u8; CHANNELS],

    committed: [Pattern; CHANNELS],
    /// Patterns in force in this cycle.
    latched: [Pattern; CHANNELS],
    /// Channels whose committed pattern waits for the end of the cycle.
    pending: u16,
    /// Channels in a first cycle that differs from the later ones.
    first_cycle: u16,
    /// Channels that ran when put to sleep and wait for RESTART.
    held: u16,

    timing: Timing,
    /// Time at which SLEEP was last cleared, ns.
    awake_since_ns: u64,
    early_write_reported: bool,
    now_ns: u64,
    /// Time of the next event, ns; `u64::MAX` for none.
    next_event_ns: u64,

    lines: [Line; CHANNELS],
    generation: u64,
    misuse: MisuseLog,
}

impl Pca9685 {
    /// Name of the chip in reports.
    pub const NAME: &str = "PCA9685";

    /// A chip just powered up, with OE low and its address pins giving the 7-bit `address` (0x40 to 0x7F).
    ///
    /// `oscillator_hz` is 25 MHz in the datasheet; individual chips are several per cent off. 0 counts as 1.
    #[must_use]
    pub fn new(address: u8, oscillator_hz: u32) -> Self {
        Self {
            address: address & 0x7F,
            oscillator_hz,
            external_clock_hz: None,
            outputs_enabled: true,
            mode1: mode1::RESET,
            mode2: mode2::RESET,
            subaddresses: registers::SUBADR_RESET,
            all_call: registers::ALLCALLADR_RESET,
            led: [registers::LED_RESET; CHANNELS],
            prescale: registers::PRE_SCALE_RESET,
            pointer: 0,
            transfer: Transfer::None,
            written: 0,
            loaded: [0; CHANNELS],
            committed: [Pattern::FULL_OFF; CHANNELS],
            latched: [Pattern::FULL_OFF; CHANNELS],
            pending: 0,
            first_cycle: 0,
            held: 0,
            timing: Timing::Off,
            awake_since_ns: 0,
            early_write_reported: false,
            now_ns: 0,
            next_event_ns: u64::MAX,
            lines: [Line::Low; CHANNELS],
            generation: 0,
            misuse: MisuseLog::new(),
        }
    }

    /// The chip's own 7-bit address.
    #[must_use]
    pub const fn address(&self) -> u8 {
        self.address
    }

    /// Advances the chip to `to_ns`, including events at that time.
    #[inline]
    pub fn advance(&mut self, to_ns: u64) {
        while self.next_event_ns <= to_ns && self.next_event_ns != u64::MAX {
            self.step();
        }
        self.now_ns = self.now_ns.max(to_ns);
    }

    /// Time at which a pending update reaches the pins, ns; `None` if nothing is pending.
    #[must_use]
    pub fn next_change_ns(&self) -> Option<u64> {
        let starts_nothing = matches!(self.timing, Timing::Starting { .. }) && !self.has_work();
        (self.next_event_ns != u64::MAX && !starts_nothing).then_some(self.next_event_ns)
    }

    /// State of an output at the last [`advance`](Self::advance); [`Line::HighZ`] for a channel above 15.
    #[must_use]
    pub fn line(&self, channel: usize) -> Line {
        self.lines.get(channel).copied().unwrap_or(Line::HighZ)
    }

    /// States of all outputs at the last [`advance`](Self::advance).
    #[must_use]
    pub const fn lines(&self) -> &[Line; CHANNELS] {
        &self.lines
    }

    /// PWM period, rounded to the nearest nanosecond, also while no cycles run. `u64::MAX` with EXTCLK set and no clock
    /// on the pin.
    #[must_use]
    pub fn pwm_period_ns(&self) -> u64 {
        let rate = match &self.timing {
            Timing::Running(cycle) => Some(cycle.rate()),
            _ => self.rate(),
        };
        rate.map_or(u64::MAX, Rate::period_ns)
    }

    /// Counter that changes whenever a line or the PWM period in force changes, so that a caller can cache values
    /// derived from them.
    #[must_use]
    pub const fn generation(&self) -> u64 {
        self.generation
    }

    /// Drives the OE pin: `enabled` is low. Acts at once, independent of the PWM cycle (7.4; delay under 60 ns, table
    /// 15).
    pub fn set_output_enable(&mut self, at_ns: u64, enabled: bool) {
        self.advance(at_ns);
        self.outputs_enabled = enabled;
        self.refresh_lines();
    }

    /// Interrupts the supply: registers and outputs as after power-on (7.5). The levels of the pins stay.
    pub fn power_cycle(&mut self, at_ns: u64) {
        self.advance(at_ns);
        self.transfer = Transfer::None;
        self.reset();
    }

    /// Sets the frequency of the internal oscillator, in force from the end of the cycle.
    pub fn set_oscillator_hz(&mut self, at_ns: u64, oscillator_hz: u32) {
        self.advance(at_ns);
        self.oscillator_hz = oscillator_hz;
        self.schedule();
    }

    /// Connects a clock to the EXTCLK pin, or removes it; without one a chip with EXTCLK set stops, outputs off.
    pub fn set_external_clock_hz(&mut self, at_ns: u64, clock_hz: Option<u32>) {
        self.advance(at_ns);
        self.external_clock_hz = clock_hz;
        match (self.timing, self.rate()) {
            (Timing::Off, Some(_)) if self.mode1 & mode1::SLEEP == 0 => self.start_oscillator(),
            (Timing::Running(_) | Timing::Starting { .. } | Timing::Idle, None) => self.switch_off(),
            _ => self.schedule(),
        }
    }

    /// Value that a read of `register` would return, without side effects; `None` for an address without a register.
    #[must_use]
    pub fn register(&self, register: u8) -> Option<u8> {
        registers::exists(register).then(|| self.read_register(register))
    }

    /// Violations of the datasheet so far.
    #[must_use]
    pub const fn misuse(&self) -> &MisuseLog {
        &self.misuse
    }

    /// Violations so far, mutable, so that a test can clear them.
    pub const fn misuse_mut(&mut self) -> &mut MisuseLog {
        &mut self.misuse
    }

    #[cold]
    fn report(&mut self, kind: MisuseKind) {
        self.misuse.report(Misuse { time_ns: self.now_ns, chip: Self::NAME, address: self.address, kind });
    }

    // ---- clock and cycles ----

    /// Rate set by registers and pins; `None` without a clock.
    fn rate(&self) -> Option<Rate> {
        let clock_hz = if self.mode1 & mode1::EXTCLK == 0 { Some(self.oscillator_hz) } else { self.external_clock_hz };
        clock_hz.map(|clock_hz| Rate { prescale: self.prescale, clock_hz })
    }

    /// True if a channel that may run is not full OFF.
    fn has_work(&self) -> bool {
        (0..CHANNELS).any(|channel| self.held & bit(channel) == 0 && !self.committed[channel].is_full_off())
    }

    /// Handles the event at `next_event_ns`.
    fn step(&mut self) {
        self.now_ns = self.now_ns.max(self.next_event_ns);
        match self.timing {
            Timing::Starting { .. } => {
                self.timing = Timing::Idle;
                self.start_cycles();
            }
            Timing::Running(cycle) => self.end_cycle(cycle),
            Timing::Off | Timing::Idle => {}
        }
        self.refresh_lines();
        self.schedule();
    }

    fn end_cycle(&mut self, cycle: Cycle) {
        self.first_cycle = 0;
        self.latch_pending();
        let active = self.latched_active();
        let rate = self.rate();
        if self.mode1 & mode1::SLEEP != 0 || rate.is_none() {
            self.held |= active;
            if active != 0 {
                self.mode1 |= mode1::RESTART;
            } else if self.held == 0 {
                self.mode1 &= !mode1::RESTART;
            }
            self.stop_cycles(Timing::Off);
        } else if active == 0 {
            self.stop_cycles(Timing::Idle);
        } else if let Some(rate) = rate.filter(|&rate| rate != cycle.rate()) {
            self.timing = Timing::Running(Cycle::new(self.now_ns, rate));
            self.generation += 1;
        }
    }

    /// Leaves [`Timing::Idle`]: latches the committed patterns, and starts cycles if any is not full OFF.
    fn start_cycles(&mut self) {
        self.refresh_pending();
        self.latch_pending();
        if let (Some(rate), true) = (self.rate(), self.latched_active() != 0) {
            self.timing = Timing::Running(Cycle::new(self.now_ns, rate));
        }
    }

    fn stop_cycles(&mut self, timing: Timing) {
        self.timing = timing;
        self.latched = [Pattern::FULL_OFF; CHANNELS];
        self.first_cycle = 0;
        self.pending = 0;
    }

    /// Stops all outputs without waiting for the end of the cycle.
    fn switch_off(&mut self) {
        self.stop_cycles(Timing::Off);
        self.refresh_lines();
        self.schedule();
    }

    fn start_oscillator(&mut self) {
        self.timing = Timing::Starting { ready_ns: self.now_ns.saturating_add(registers::OSCILLATOR_START_NS) };
        self.schedule();
    }

    fn latched_active(&self) -> u16 {
        (0..CHANNELS)
            .filter(|&channel| !self.latched[channel].is_full_off())
            .fold(0, |mask, channel| mask | bit(channel))
    }

    fn refresh_pending(&mut self) {
        self.pending = (0..CHANNELS)
            .filter(|&channel| self.held & bit(channel) == 0 && self.committed[channel] != self.latched[channel])
            .fold(0, |mask, channel| mask | bit(channel));
    }

    fn latch_pending(&mut self) {
        for channel in channels(self.pending) {
            let next = self.committed[channel];
            if next.turns_on_late() && !self.latched[channel].is_high_at_end() {
                self.first_cycle |= bit(channel);
            }
            self.latched[channel] = next;
        }
        self.pending = 0;
    }

    /// Sets the time of the next event.
    fn schedule(&mut self) {
        let rate = self.rate();
        let asleep = self.mode1 & mode1::SLEEP != 0;
        self.next_event_ns = match &mut self.timing {
            Timing::Off | Timing::Idle => u64::MAX,
            Timing::Starting { ready_ns } => *ready_ns,
            Timing::Running(cycle) => {
                if self.pending | self.first_cycle != 0 || asleep || rate != Some(cycle.rate()) {
                    cycle.next_after(self.now_ns)
                } else {
                    u64::MAX
                }
            }
        };
    }

    // ---- pins ----

    fn refresh_lines(&mut self) {
        let mut changed = false;
        for channel in 0..CHANNELS {
            let pattern = self.latched[channel];
            let wanted = if self.first_cycle & bit(channel) == 0 { pattern.line() } else { pattern.first_line() };
            let line = self.output_stage(wanted);
            changed |= line != self.lines[channel];
            self.lines[channel] = line;
        }
        self.generation += u64::from(changed);
    }

    /// Output stage: INVRT, OUTDRV (7.7, table 12), OE and OUTNE (7.4, table 11).
    const fn output_stage(&self, wanted: Line) -> Line {
        let totem_pole = self.mode2 & mode2::OUTDRV != 0;
        let line = if self.outputs_enabled {
            if self.mode2 & mode2::INVRT == 0 { wanted } else { wanted.inverted() }
        } else {
            match self.mode2 & mode2::OUTNE {
                0 => Line::Low,
                1 => Line::High,
                _ => Line::HighZ,
            }
        };
        match line {
            Line::High if !totem_pole => Line::HighZ,
            line => line,
        }
    }

    // ---- registers ----

    fn read_register(&self, register: u8) -> u8 {
        match register {
            registers::MODE1 => self.mode1,
            registers::MODE2 => self.mode2,
            registers::SUBADR1..=registers::SUBADR3 => self.subaddresses[usize::from(register - registers::SUBADR1)],
            registers::ALLCALLADR => self.all_call,
            registers::LED0_ON_L..=registers::LED15_OFF_H => {
                let index = usize::from(register - registers::LED0_ON_L);
                self.led[index / 4][index % 4]
            }
            registers::PRE_SCALE => self.prescale,
            // ALL_LED_* read as zero (7.3.4). The value of the test register is not published.
            _ => 0,
        }
    }

    fn write_register(&mut self, register: u8, value: u8) {
        match register {
            registers::MODE1 => self.write_mode1(value),
            registers::MODE2 => self.write_mode2(value),
            registers::SUBADR1..=registers::SUBADR3 => {
                self.subaddresses[usize::from(register - registers::SUBADR1)] = value & registers::ADDRESS_WRITABLE;
            }
            registers::ALLCALLADR => self.all_call = value & registers::ADDRESS_WRITABLE,
            registers::LED0_ON_L..=registers::LED15_OFF_H => {
                let index = usize::from(register - registers::LED0_ON_L);
                self.write_led(index / 4, index % 4, value);
            }
            registers::ALL_LED_ON_L..=registers::ALL_LED_OFF_H => {
                self.write_all_led(usize::from(register - registers::ALL_LED_ON_L), value);
            }
            registers::PRE_SCALE => self.write_prescale(value),
            registers::TEST_MODE => self.report(MisuseKind::TestModeWritten { value }),
            _ => {}
        }
    }

    fn write_mode1(&mut self, value: u8) {
        let old = self.mode1;
        let was_asleep = old & mode1::SLEEP != 0;
        let asleep = value & mode1::SLEEP != 0;
        self.mode1 = value & mode1::PLAIN | old & (mode1::RESTART | mode1::EXTCLK);

        if value & mode1::EXTCLK != 0 && old & mode1::EXTCLK == 0 {
            // 7.3.1, note to EXTCLK: first SLEEP, then SLEEP and EXTCLK together
            if was_asleep && asleep {
                self.mode1 |= mode1::EXTCLK;
            } else {
                self.report(MisuseKind::ExternalClockWhileAwake);
            }
        }
        match (was_asleep, asleep) {
            (false, true) => self.fall_asleep(),
            (true, false) => self.wake(),
            _ => {}
        }
        if value & mode1::RESTART != 0 {
            self.restart(was_asleep || asleep);
        }
        self.schedule();
    }

    fn fall_asleep(&mut self) {
        match self.timing {
            // takes effect at the end of the cycle
            Timing::Running(_) => {}
            Timing::Idle => {
                // an orderly shutdown clears RESTART (7.3.1.1)
                if self.held == 0 {
                    self.mode1 &= !mode1::RESTART;
                }
                self.switch_off();
            }
            Timing::Starting { .. } | Timing::Off => self.switch_off(),
        }
    }

    fn wake(&mut self) {
        self.awake_since_ns = self.now_ns;
        self.early_write_reported = false;
        if !matches!(self.timing, Timing::Running(_)) {
            if self.rate().is_some() {
                self.start_oscillator();
            } else {
                self.report(MisuseKind::ExternalClockMissing);
            }
        }
    }

    /// Handles a 1 written to RESTART (7.3.1.1).
    fn restart(&mut self, not_awake_before: bool) {
        let awake_ns = if not_awake_before { 0 } else { self.now_ns - self.awake_since_ns };
        let needed_ns = registers::OSCILLATOR_START_NS;
        if awake_ns < needed_ns {
            self.report(MisuseKind::RestartTooEarly { awake_ns, needed_ns });
        } else if self.mode1 & mode1::RESTART != 0 {
            self.mode1 &= !mode1::RESTART;
            self.held = 0;
            self.take_over();
        }
    }

    fn write_mode2(&mut self, value: u8) {
        let value = value & mode2::WRITABLE;
        if (value ^ self.mode2) & mode2::OCH != 0 {
            self.loaded = [0; CHANNELS];
        }
        self.mode2 = value;
        self.refresh_lines();
    }

    fn write_prescale(&mut self, value: u8) {
        if self.mode1 & mode1::SLEEP == 0 {
            self.report(MisuseKind::PrescaleWhileAwake { value, kept: self.prescale });
            return;
        }
        self.prescale = value.max(registers::PRE_SCALE_MIN);
        if value < registers::PRE_SCALE_MIN {
            self.report(MisuseKind::PrescaleBelowMinimum { value, taken: self.prescale });
        }
        self.schedule();
    }

    /// Writes ON_L, ON_H, OFF_L or OFF_H (`part` 0 to 3) of all channels.
    fn write_all_led(&mut self, part: usize, value: u8) {
        for channel in 0..CHANNELS {
            self.write_led(channel, part, value);
        }
    }

    /// Writes ON_L, ON_H, OFF_L or OFF_H (`part` 0 to 3) of a channel.
    #[inline]
    fn write_led(&mut self, channel: usize, part: usize, value: u8) {
        if matches!(self.timing, Timing::Starting { .. }) {
            self.report_early_write();
        }
        self.led[channel][part] = value & registers::LED_WRITABLE[part];
        if self.mode2 & mode2::OCH == 0 {
            self.written |= bit(channel);
            return;
        }
        self.loaded[channel] |= 1 << part;
        if self.loaded[channel] == 0b1111 {
            self.loaded[channel] = 0;
            self.commit(bit(channel));
        }
    }

    /// Reports a write of PWM registers while the oscillator starts: timing is not guaranteed then (7.3.1, note to
    /// SLEEP).
    #[cold]
    fn report_early_write(&mut self) {
        if !self.early_write_reported {
            self.early_write_reported = true;
            let awake_ns = self.now_ns - self.awake_since_ns;
            let needed_ns = registers::OSCILLATOR_START_NS;
            self.report(MisuseKind::OutputsBeforeOscillatorReady { awake_ns, needed_ns });
        }
    }

    /// Commits the registers of the channels in `mask`, which reach the pins at the end of the cycle.
    fn commit(&mut self, mask: u16) {
        for channel in channels(mask) {
            let pattern = Pattern::from_registers(self.led[channel]);
            if pattern.is_empty() && pattern != self.committed[channel] {
                self.report(MisuseKind::OnEqualsOff { channel: channel as u8, count: pattern.on_count() });
            }
            self.committed[channel] = pattern;
        }
        self.held &= !mask;
        self.mode1 &= !mode1::RESTART;
        self.take_over();
        self.schedule();
    }

    fn take_over(&mut self) {
        match self.timing {
            Timing::Running(_) => self.refresh_pending(),
            Timing::Idle => {
                self.start_cycles();
                self.refresh_lines();
            }
            Timing::Off | Timing::Starting { .. } => {}
        }
    }

    /// Sets registers and outputs as after power-on; pins, clocks and reports stay.
    fn reset(&mut self) {
        self.mode1 = mode1::RESET;
        self.mode2 = mode2::RESET;
        self.subaddresses = registers::SUBADR_RESET;
        self.all_call = registers::ALLCALLADR_RESET;
        self.led = [registers::LED_RESET; CHANNELS];
        self.prescale = registers::PRE_SCALE_RESET;
        self.pointer = registers::MODE1;
        self.written = 0;
        self.loaded = [0; CHANNELS];
        self.committed = [Pattern::FULL_OFF; CHANNELS];
        self.held = 0;
        self.switch_off();
    }

    fn increment_pointer(&mut self) {
        if self.mode1 & mode1::AI != 0 {
            self.pointer = registers::after(self.pointer);
        }
    }

    /// Reports a full OFF with OCH set that is not followed by the rest of the channel, and so never reaches the pin.
    fn check_full_off(&mut self) {
        for channel in 0..CHANNELS {
            let wanted = Pattern::from_registers(self.led[channel]);
            let waiting = self.loaded[channel] & 0b1000 != 0;
            if waiting && wanted.is_full_off() && !self.committed[channel].is_full_off() {
                self.report(MisuseKind::FullOffNotApplied { channel: channel as u8 });
            }
        }
    }
}

impl I2cChip for Pca9685 {
    fn acknowledges(&self, address: u8, read: bool) -> bool {
        if address == 0 {
            // 7.6: the software reset call is not acknowledged with R/W = 1
            return !read;
        }
        let sub = |index: usize| self.mode1 & (mode1::SUB1 >> index) != 0 && self.subaddresses[index] >> 1 == address;
        address == self.address
            || (self.mode1 & mode1::ALLCALL != 0 && self.all_call >> 1 == address)
            || (self.mode1 & (mode1::SUB1 | mode1::SUB1 >> 1 | mode1::SUB1 >> 2) != 0 && (sub(0) || sub(1) || sub(2)))
    }

    fn start(&mut self, at_ns: u64, address: u8, read: bool) {
        self.advance(at_ns);
        self.transfer = match (address, read) {
            (0, _) => Transfer::GeneralCall,
            (_, true) => Transfer::Data,
            (_, false) => Transfer::Pointer,
        };
    }

    fn write(&mut self, at_ns: u64, byte: u8) -> bool {
        self.advance(at_ns);
        match self.transfer {
            Transfer::Data => {
                self.write_register(self.pointer, byte);
                // the pointer increments after the write: setting AI already moves it to MODE2 (figure 21)
                self.increment_pointer();
                true
            }
            Transfer::Pointer if registers::exists(byte) => {
                self.pointer = byte;
                self.transfer = Transfer::Data;
                true
            }
            Transfer::Pointer => {
                self.transfer = Transfer::Refused;
                self.report(MisuseKind::UnmappedRegister { register: byte });
                false
            }
            Transfer::GeneralCall if byte == registers::SOFTWARE_RESET => {
                self.transfer = Transfer::ResetAtStop;
                true
            }
            Transfer::GeneralCall | Transfer::ResetAtStop | Transfer::Refused | Transfer::None => {
                self.transfer = Transfer::Refused;
                false
            }
        }
    }

    fn read(&mut self, at_ns: u64) -> u8 {
        self.advance(at_ns);
        if self.transfer != Transfer::Data {
            return 0xFF;
        }
        let value = self.read_register(self.pointer);
        self.increment_pointer();
        value
    }

    fn stop(&mut self, at_ns: u64) {
        self.advance(at_ns);
        if self.transfer == Transfer::ResetAtStop {
            self.reset();
        } else if self.written != 0 {
            let mask = core::mem::take(&mut self.written);
            self.commit(mask);
        } else if self.mode2 & mode2::OCH != 0 {
            self.check_full_off();
        }
        self.transfer = Transfer::None;
    }
}

const fn bit(channel: usize) -> u16 {
    1 << (channel % CHANNELS)
}

fn channels(mut mask: u16) -> impl Iterator<Item = usize> {
    core::iter::from_fn(move || {
        let channel = mask.trailing_zeros() as usize;
        mask &= mask.wrapping_sub(1);
        (channel < CHANNELS).then_some(channel)
    })
}
