//! One converter of the ADC.

use std::collections::VecDeque;

use super::Clock;
use crate::context::{Context, Ticks};
use crate::outside::Pin;
use crate::peripheral::Unmodelled;

/// Bits of ISR and IER.
const ADRDY: u32 = 1;
const EOSMP: u32 = 1 << 1;
const EOC: u32 = 1 << 2;
const EOS: u32 = 1 << 3;
const OVR: u32 = 1 << 4;
const LDORDY: u32 = 1 << 12;
/// Bits of the control register CR.
const ADEN: u32 = 1;
const ADDIS: u32 = 1 << 1;
const ADSTART: u32 = 1 << 2;
const JADSTART: u32 = 1 << 3;
const ADSTP: u32 = 1 << 4;
const LINEARITY: u32 = 1 << 16;
const LINCALRDY: u32 = 0x0fc0_0000;
const ADVREGEN: u32 = 1 << 28;
const DEEPPWD: u32 = 1 << 29;
const DIFFERENTIAL: u32 = 1 << 30;
const ADCAL: u32 = 1 << 31;
/// Bits of the configuration register CFGR.
const OVRMOD: u32 = 1 << 12;
const CONT: u32 = 1 << 13;
const REFUSED: u32 = 1 << 14 | 1 << 16 | 1 << 20 | 1 << 22 | 1 << 23 | 1 << 24 | 1 << 25;
/// Bits of the configuration register CFGR2.
const ROVSE: u32 = 1;

/// Number of FIFO stages behind DR.
const FIFO: usize = 8;
const VREF_V: f64 = 3.3;
/// Start-up time of the regulator, ns: the typical value (DS12930, 16-bit ADC characteristics); the maximum is 10 µs.
const REGULATOR_NS: u64 = 5_000;
/// Duration of calibration, of the offset alone and with the linearity, ADC clocks (DS12930, same table).
const OFFSET_CLOCKS: u64 = 1_280;
const LINEARITY_CLOCKS: u64 = 165_010;
/// Time from ADEN to ADRDY, ADC clocks: one conversion (DS12930, same table), of 1.5 + 8.5 clocks.
const READY_CLOCKS: u64 = 10;

/// Sampling time by SMPx, half clocks (RM0399, ADC, sampling time).
const SAMPLING: [u64; 8] = [3, 5, 17, 33, 65, 129, 775, 1621];

/// Returns the pin of INP2 to INP19 (DS12930, pin definitions); `None` for inputs that are internal, or missing on this
/// converter.
fn pin(converter: u8, channel: u32) -> Option<Pin> {
    let first = converter == 1;
    Some(match channel {
        2 => Pin::new('F', if first { 11 } else { 13 }),
        3 => Pin::new('A', 6),
        4 => Pin::new('C', 4),
        5 => Pin::new('B', 1),
        6 => Pin::new('F', if first { 12 } else { 14 }),
        7 => Pin::new('A', 7),
        8 => Pin::new('C', 5),
        9 => Pin::new('B', 0),
        10 => Pin::new('C', 0),
        11 => Pin::new('C', 1),
        12 => Pin::new('C', 2),
        13 => Pin::new('C', 3),
        14 => Pin::new('A', 2),
        15 => Pin::new('A', 3),
        16 if first => Pin::new('A', 0),
        17 if first => Pin::new('A', 1),
        18 => Pin::new('A', 4),
        19 => Pin::new('A', 5),
        _ => return None,
    })
}

/// Sequence of conversions in progress.
#[derive(Clone, Copy, Debug)]
struct Running {
    /// Rank of the present conversion, 1 to 16.
    rank: u32,
    /// Half clocks since the first conversion began, and the number at which the present one ends.
    ticks: Ticks,
    end: u64,
}

/// State of ADC1 or ADC2.
#[derive(Debug)]
pub(super) struct Converter {
    number: u8,
    name: &'static str,
    isr: u32,
    ier: u32,
    cr: u32,
    cfgr: u32,
    cfgr2: u32,
    smpr: [u32; 2],
    pcsel: u32,
    sqr: [u32; 4],
    /// Last value read from DR, and the results not read yet.
    data: u32,
    results: VecDeque<u32>,
    /// Thresholds of the watchdogs, which cannot be enabled: LTR1, HTR1, LTR2, HTR2, LTR3, HTR3.
    thresholds: [u32; 6],
    calibration: [u32; 2],
    running: Option<Running>,
    clock: Clock,
    regulator_ns: u64,
    calibrated_ns: u64,
    ready_ns: u64,
    /// The transfer of DMA one-shot mode has ended.
    dma_over: bool,
    request: bool,
}

impl Converter {
    pub(super) fn new(number: u8) -> Self {
        Self {
            number,
            name: if number == 1 { "ADC1" } else { "ADC2" },
            isr: 0,
            ier: 0,
            cr: DEEPPWD,
            cfgr: 1 << 31,
            cfgr2: 0,
            smpr: [0; 2],
            pcsel: 0,
            sqr: [0; 4],
            data: 0,
            results: VecDeque::new(),
            thresholds: [0, 0x03ff_ffff, 0, 0x03ff_ffff, 0, 0x03ff_ffff],
            calibration: [0; 2],
            running: None,
            clock: Clock { frequency_hz: 0, divider: 1 },
            regulator_ns: u64::MAX,
            calibrated_ns: u64::MAX,
            ready_ns: u64::MAX,
            dma_over: false,
            request: false,
        }
    }

    pub(super) fn reset(&mut self) {
        *self = Self { request: self.request, clock: self.clock, ..Self::new(self.number) };
    }

    pub(super) fn is_on(&self) -> bool {
        self.cr & ADEN != 0
    }

    pub(super) fn status(&self) -> u32 {
        self.isr
    }

    pub(super) fn interrupts(&self) -> bool {
        self.isr & self.ier & 0x7ff != 0
    }

    pub(super) fn tell_request(&mut self, context: &mut Context<'_>) {
        // No request follows an overrun, so that memory stays in step with the sequence (RM0399, ADC, DMA one-shot
        // mode).
        let lost = self.isr & OVR != 0 && self.cfgr & OVRMOD == 0;
        let request = self.uses_dma() && !self.results.is_empty() && !lost && !self.dma_over;
        if self.request != request {
            self.request = request;
            context.dma(8 + self.number, request);
        }
    }

    fn uses_dma(&self) -> bool {
        matches!(self.cfgr & 3, 1 | 3)
    }

    pub(super) fn next_event_ns(&self) -> u64 {
        let running = self.running.filter(|_| !self.is_drowned());
        let conversion_ns = running.map_or(u64::MAX, |running| running.ticks.when_ns(running.end));
        let ready_ns = if self.ier & ADRDY != 0 { self.ready_ns } else { u64::MAX };
        conversion_ns.min(ready_ns)
    }

    /// Carries out the conversions that have ended up to now.
    pub(super) fn run(&mut self, clock: Clock, context: &mut Context<'_>) {
        let now_ns = context.now_ns;
        // Done first, so that a long pause does not compute conversions without any effect.
        self.skip_lost(now_ns);
        while let Some(running) = self.running.filter(|running| running.ticks.when_ns(running.end) <= now_ns) {
            self.convert(running, context);
        }
        if now_ns >= self.regulator_ns {
            self.regulator_ns = u64::MAX;
            self.isr |= LDORDY;
        }
        if now_ns >= self.calibrated_ns {
            self.calibrated_ns = u64::MAX;
            self.cr &= !ADCAL;
        }
        if now_ns >= self.ready_ns {
            self.ready_ns = u64::MAX;
            self.isr |= ADRDY;
        }
        if clock != self.clock {
            self.clock = clock;
            if let Some(running) = &mut self.running {
                // The rest of this conversion takes the same number of clocks, at the new frequency.
                let left = running.end - running.ticks.at(now_ns);
                let ticks = Ticks { start_ns: now_ns, frequency_hz: clock.frequency_hz, divider: clock.divider };
                *running = Running { ticks, end: left, ..*running };
            }
        }
    }

    /// Returns true if the program does not read: all flags that a further conversion could set are set, and its result
    /// would be lost.
    fn is_drowned(&self) -> bool {
        let overwrites = self.cfgr & OVRMOD != 0;
        self.isr & (EOSMP | EOC | EOS | OVR) == EOSMP | EOC | EOS | OVR && self.results.len() == FIFO && !overwrites
    }

    /// Skips sequences in continuous mode whose results would be lost.
    fn skip_lost(&mut self, now_ns: u64) {
        let lost = self.is_drowned() && self.cfgr & CONT != 0;
        let sequence: u64 = (1..=self.ranks()).map(|rank| self.duration(rank)).sum();
        if let Some(running) = self.running.as_mut().filter(|_| lost) {
            let late = running.ticks.at(now_ns).saturating_sub(running.end);
            running.end += late / sequence * sequence;
        }
    }

    fn bits(&self) -> u32 {
        match self.cfgr >> 2 & 7 {
            1 | 5 => 14,
            2 | 6 => 12,
            3 => 10,
            7 => 8,
            _ => 16,
        }
    }

    fn ratio(&self) -> u64 {
        if self.cfgr2 & ROVSE != 0 { u64::from(self.cfgr2 >> 16 & 0x3ff) + 1 } else { 1 }
    }

    fn ranks(&self) -> u32 {
        (self.sqr[0] & 15) + 1
    }

    fn channel(&self, rank: u32) -> u32 {
        self.sqr[(rank / 5) as usize] >> (6 * (rank % 5)) & 0x1f
    }

    /// Returns the duration of the conversions for one result, half clocks.
    fn duration(&self, rank: u32) -> u64 {
        let channel = self.channel(rank);
        let sampling = SAMPLING[(self.smpr[(channel / 10).min(1) as usize] >> (3 * (channel % 10)) & 7) as usize];
        // Successive approximation takes 8.5 clocks for 16 bits, one less for each two bits less (RM0399, ADC,
        // conversion timing).
        let approximation = u64::from(self.bits()) + 1;
        (sampling + approximation) * self.ratio()
    }

    fn begin(&mut self, now_ns: u64) {
        let ticks = Ticks { start_ns: now_ns, frequency_hz: self.clock.frequency_hz, divider: self.clock.divider };
        self.running = Some(Running { rank: 1, ticks, end: self.duration(1) });
    }

    /// Ends one conversion: stores its result and starts the next one.
    fn convert(&mut self, running: Running, context: &mut Context<'_>) {
        let code = self.sample(self.channel(running.rank), context);
        self.store(code);
        self.isr |= EOSMP | EOC;
        // The ends add up in half clocks from the start of the sequence, so that rounding errors do not accumulate.
        if running.rank < self.ranks() {
            let rank = running.rank + 1;
            self.running = Some(Running { rank, end: running.end + self.duration(rank), ..running });
            return;
        }
        self.isr |= EOS;
        self.running = None;
        // A software start ends with its sequence; a triggered one stays armed.
        let software = self.cfgr >> 10 & 3 == 0;
        if self.cfgr & CONT != 0 {
            self.running = Some(Running { rank: 1, end: running.end + self.duration(1), ..running });
        } else if software {
            self.cr &= !ADSTART;
        }
    }

    /// Stores a result. DR has a FIFO of eight stages, but of only one if results may be overwritten (RM0399, ADC,
    /// overrun).
    fn store(&mut self, code: u32) {
        let overwrites = self.cfgr & OVRMOD != 0;
        let depth = if overwrites { 1 } else { FIFO };
        if self.results.len() >= depth {
            self.isr |= OVR;
            if !overwrites {
                return;
            }
            self.results.clear();
        }
        self.results.push_back(code);
    }

    fn sample(&self, channel: u32, context: &mut Context<'_>) -> u32 {
        if self.pcsel >> channel & 1 == 0 {
            context.misuse(
                self.name,
                format!("channel {channel} converted without its bit in PCSEL (RM0399, ADC, channel preselection)"),
            );
            return 0;
        }
        let Some(pin) = pin(self.number, channel) else { return 0 };
        let volts = context.outside.volts(context.now_ns, pin);
        let steps = f64::from(1_u32 << self.bits());
        let code = (volts / VREF_V * steps).clamp(0.0, steps - 1.0) as u64;
        let sum = if self.cfgr2 & ROVSE == 0 { code } else { (code * self.ratio()) >> (self.cfgr2 >> 5 & 15) };
        (sum << (self.cfgr2 >> 28)) as u32
    }

    pub(super) fn trigger(&mut self, timer: u8, now_ns: u64) {
        let hardware = self.cfgr >> 10 & 3 != 0;
        if self.cr & ADSTART != 0 && hardware && self.running.is_none() && self.trigger_timer() == Some(timer) {
            self.begin(now_ns);
        }
    }

    /// Returns the timer whose trigger output EXTSEL selects (RM0399, ADC, external triggers).
    fn trigger_timer(&self) -> Option<u8> {
        match self.cfgr >> 5 & 0x1f {
            4 => Some(3),
            7 => Some(8),
            9 => Some(1),
            11 => Some(2),
            12 => Some(4),
            13 => Some(6),
            14 => Some(15),
            _ => None,
        }
    }

    pub(super) fn dma_ended(&mut self, request: u8, context: &mut Context<'_>) {
        if request == 8 + self.number && self.cfgr & 3 == 1 {
            self.dma_over = true;
            // The conversion in progress is dropped; ADSTART stays set until the program stops it (RM0399, ADC, DMA
            // one-shot mode).
            self.running = None;
            self.tell_request(context);
        }
    }

    pub(super) fn read(&mut self, offset: u32) -> Result<u32, Unmodelled> {
        Ok(match offset {
            0x00 => self.isr,
            0x04 => self.ier,
            0x08 => self.cr,
            0x0c => self.cfgr,
            0x10 => self.cfgr2,
            0x14 | 0x18 => self.smpr[(offset as usize - 0x14) / 4],
            0x1c => self.pcsel,
            0x20 | 0x24 => self.thresholds[(offset as usize - 0x20) / 4],
            0x30..=0x3c => self.sqr[(offset as usize - 0x30) / 4],
            0x40 => {
                self.data = self.results.pop_front().unwrap_or(self.data);
                if self.results.is_empty() {
                    self.isr &= !EOC;
                }
                self.data
            }
            0x60..=0x6c | 0xa0 | 0xa4 | 0xc0 => 0,
            0xb0..=0xbc => self.thresholds[2 + (offset as usize - 0xb0) / 4],
            0xc4 | 0xc8 => self.calibration[(offset as usize - 0xc4) / 4],
            _ => return Err(Unmodelled::register(self.name, offset)),
        })
    }

    fn refuse<T>(&self, what: &str) -> Result<T, Unmodelled> {
        Err(Unmodelled { peripheral: self.name, what: what.into() })
    }

    pub(super) fn write(
        &mut self,
        offset: u32,
        value: u32,
        clock: Clock,
        context: &mut Context<'_>,
    ) -> Result<(), Unmodelled> {
        let sequence = matches!(offset, 0x0c..=0x1c | 0x30..=0x3c);
        if sequence && self.cr & ADSTART != 0 {
            context.misuse(
                self.name,
                format!("register {offset:#04x} written while ADSTART is set (RM0399, ADC registers)"),
            );
        }
        match offset {
            // LDORDY is read-only.
            0x00 => self.isr &= !(value & 0x7ff),
            0x04 => self.ier = value & 0x7ff,
            0x08 => return self.write_control(value, clock, context),
            0x0c => return self.write_configuration(value, context),
            0x10 if value & (1 << 1 | 1 << 9) != 0 => {
                return self.refuse("injected or triggered oversampling (JOVSE, TROVS)");
            }
            0x10 => self.cfgr2 = value & 0xf3ff_7de1,
            0x14 | 0x18 => self.smpr[(offset as usize - 0x14) / 4] = value & 0x3fff_ffff,
            0x1c => self.pcsel = value & 0xf_ffff,
            0x20 | 0x24 => self.thresholds[(offset as usize - 0x20) / 4] = value & 0x03ff_ffff,
            0x30..=0x3c => {
                const BITS: [u32; 4] = [0x1f7d_f7cf, 0x1f7d_f7df, 0x1f7d_f7df, 0x07df];
                let index = (offset as usize - 0x30) / 4;
                self.sqr[index] = value & BITS[index];
            }
            0xb0..=0xbc => self.thresholds[2 + (offset as usize - 0xb0) / 4] = value & 0x03ff_ffff,
            0xc4 => self.calibration[0] = value & 0x07ff_07ff,
            0xc8 => self.calibration[1] = value & 0x3fff_ffff,
            0x40 => {}
            // Offsets, watchdogs 2 and 3 and differential inputs are modelled in their off state only.
            0x60..=0x6c | 0xa0 | 0xa4 | 0xc0 if value == 0 => {}
            0x60..=0x6c => return self.refuse("offsets (OFRx)"),
            0xa0 | 0xa4 => return self.refuse("analog watchdogs"),
            0xc0 => return self.refuse("differential inputs (DIFSEL)"),
            _ => return Err(Unmodelled::register(self.name, offset)),
        }
        Ok(())
    }

    fn write_configuration(&mut self, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        if value & REFUSED != 0 {
            return self.refuse("auto-delayed, discontinuous or injected mode, or an analog watchdog (CFGR)");
        }
        if value & 3 == 2 {
            return self.refuse("results to the DFSDM (DMNGT)");
        }
        if value >> 2 & 7 == 4 {
            context.misuse(self.name, "a reserved resolution (RM0399, ADC_CFGR)");
        }
        if (value ^ self.cfgr) & 3 != 0 {
            self.dma_over = false;
        }
        self.cfgr = value & 0xffff_7fff;
        Ok(())
    }

    fn write_control(&mut self, value: u32, clock: Clock, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        if value & JADSTART != 0 {
            return self.refuse("injected conversions (JADSTART)");
        }
        if value & LINCALRDY != 0 {
            return self.refuse("linearity words (LINCALRDYW)");
        }
        let set = value & !self.cr;
        if value & ADCAL != 0 && value & DIFFERENTIAL != 0 {
            return self.refuse("calibration for differential inputs (ADCALDIF)");
        }
        let plain = 0x300 | LINEARITY | DIFFERENTIAL | ADVREGEN | DEEPPWD;
        self.cr = self.cr & !plain | value & plain;
        self.power(set, context);
        if set & ADCAL != 0 {
            self.calibrate(clock, context);
        }
        if set & ADEN != 0 {
            if self.isr & LDORDY == 0 || self.cr & ADCAL != 0 {
                context.misuse(
                    self.name,
                    "ADEN set before the regulator is ready, or while calibrating (RM0399, ADC, on-off control)",
                );
            }
            self.cr |= ADEN;
            self.ready_ns = after(clock, 2 * READY_CLOCKS, context);
        }
        if set & ADSTART != 0 {
            self.start(clock, context)?;
        }
        if value & ADSTP != 0 && self.cr & ADSTART != 0 {
            self.running = None;
            self.results.clear();
            self.cr &= !ADSTART;
        }
        if value & ADDIS != 0 && self.cr & ADEN != 0 {
            if self.cr & ADSTART != 0 {
                context.misuse(self.name, "ADDIS set while converting (RM0399, ADC_CR)");
            }
            self.cr &= !(ADEN | ADSTART);
            self.running = None;
            self.results.clear();
            self.ready_ns = u64::MAX;
            self.isr &= !ADRDY;
        }
        Ok(())
    }

    fn power(&mut self, set: u32, context: &mut Context<'_>) {
        if self.cr & DEEPPWD != 0 || self.cr & ADVREGEN == 0 {
            if set & ADVREGEN != 0 {
                context.misuse(self.name, "ADVREGEN set in deep power-down (RM0399, ADC, voltage regulator)");
            }
            self.isr &= !LDORDY;
            self.regulator_ns = u64::MAX;
        } else if self.isr & LDORDY == 0 && self.regulator_ns == u64::MAX {
            self.regulator_ns = context.now_ns + REGULATOR_NS;
        }
    }

    fn calibrate(&mut self, clock: Clock, context: &mut Context<'_>) {
        if self.isr & LDORDY == 0 || self.cr & ADEN != 0 {
            context.misuse(self.name, "ADCAL set without the regulator, or while enabled (RM0399, ADC, calibration)");
        }
        let clocks = if self.cr & LINEARITY != 0 { LINEARITY_CLOCKS } else { OFFSET_CLOCKS };
        self.cr |= ADCAL;
        self.calibrated_ns = after(clock, 2 * clocks, context);
    }

    fn start(&mut self, clock: Clock, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        if self.cr & ADEN == 0 || self.ready_ns != u64::MAX {
            context.misuse(self.name, "ADSTART set while the ADC is not ready (RM0399, ADC, on-off control)");
            return Ok(());
        }
        if let Some(channel) =
            (1..=self.ranks()).map(|rank| self.channel(rank)).find(|&channel| pin(self.number, channel).is_none())
        {
            return self.refuse(&format!("channel {channel}"));
        }
        let hz = clock.frequency_hz / (2 * clock.divider);
        // Clock limits by BOOST: 6.25, 12.5, 25 and 50 MHz (RM0399, ADC_CR).
        let limit_hz = 6_250_000 << (self.cr >> 8 & 3);
        if hz > limit_hz {
            context.misuse(self.name, format!("a clock of {hz} Hz with BOOST for {limit_hz} Hz (RM0399, ADC, clocks)"));
        }
        let hardware = self.cfgr >> 10 & 3 != 0;
        if hardware && self.trigger_timer().is_none() {
            return self.refuse("an external trigger other than a timer's trigger output (EXTSEL)");
        }
        self.cr |= ADSTART;
        self.dma_over = false;
        if !hardware {
            self.begin(context.now_ns);
        }
        Ok(())
    }
}

fn after(clock: Clock, half_clocks: u64, context: &Context<'_>) -> u64 {
    Ticks { start_ns: context.now_ns, frequency_hz: clock.frequency_hz, divider: clock.divider }.when_ns(half_clocks)
}
