//! Random number generator RNG (RM0399, chapter 36), deterministic from a seed.
//!
//! The numbers are the upper halves of SplitMix64 (Steele, Lea, Flood, *Fast Splittable Pseudorandom Number
//! Generators*, OOPSLA 2014), without zeros, because the manual states that a valid number is not 0. Their times are
//! those of 36.5. The RNG clock is assumed to be HSI48, the reset value of its multiplexer. A reset by RCC does not
//! restart the sequence.

use crate::context::{Clocks, Context, Ticks};
use crate::peripheral::{Peripheral, Size, Unmodelled};

const NAME: &str = "RNG";
/// Interrupt number, the position in the vector table (RM0399, chapter 20).
const IRQ: u16 = 80;

const CR: u32 = 0x00;
const SR: u32 = 0x04;
const DR: u32 = 0x08;

/// Bits of the control register CR (36.7.1).
const RNGEN: u32 = 1 << 2;
const IE: u32 = 1 << 3;
const CED: u32 = 1 << 5;

/// Bits of the status register SR (36.7.2).
const DRDY: u32 = 1 << 0;
const CECS: u32 = 1 << 1;
const SECS: u32 = 1 << 2;
const CEIS: u32 = 1 << 5;
const SEIS: u32 = 1 << 6;

/// Size of the output buffer, words.
const BUFFER: u32 = 4;
/// Number of words to discard after a seed error (36.3.7).
const DISCARDED: u32 = 12;
/// Duration of a conditioning round, AHB clocks.
const ROUND: u64 = 213;

/// State of the generator.
#[derive(Clone, Debug)]
pub struct Rng {
    state: u64,
    cr: u32,
    seed_interrupt: bool,
    clock_interrupt: bool,
    /// Present seed error, with the number of words to read until it ends.
    seed_error: Option<u32>,
    /// Number of words that can be read.
    ready: u32,
    /// Time at which the buffer is filled, ns.
    fill_ns: Option<u64>,
    /// The conditioning is set up: words were delivered since the reset.
    warm: bool,
    clocks: Clocks,
    line: bool,
}

impl Rng {
    /// Makes a generator; the same seed gives the same numbers.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        Self {
            state: seed,
            cr: 0,
            seed_interrupt: false,
            clock_interrupt: false,
            seed_error: None,
            ready: 0,
            fill_ns: None,
            warm: false,
            clocks: Clocks::default(),
            line: false,
        }
    }

    /// Injects a failed test of the noise source: SEIS and SECS, until the program has recovered according to 36.3.7.
    pub fn inject_seed_error(&mut self, context: &mut Context<'_>) {
        self.bring_to_now(context);
        if self.enabled() {
            self.seed_interrupt = true;
            self.seed_error = Some(DISCARDED);
            self.ready = 0;
            self.fill_ns = None;
        }
        self.update_line(context);
    }

    fn enabled(&self) -> bool {
        self.cr & RNGEN != 0
    }

    fn number(&mut self) -> u32 {
        loop {
            self.state = self.state.wrapping_add(0x9E37_79B9_7F4A_7C15);
            let mut mixed = self.state;
            mixed = (mixed ^ mixed >> 30).wrapping_mul(0xBF58_476D_1CE4_E5B9);
            mixed = (mixed ^ mixed >> 27).wrapping_mul(0x94D0_49BB_1331_11EB);
            let upper = ((mixed ^ mixed >> 31) >> 32) as u32;
            // A valid number is not 0.
            if upper != 0 {
                return upper;
            }
        }
    }

    /// Returns true if the RNG clock is too slow against the AHB clock (36.3.6).
    fn clock_error(&self) -> bool {
        self.enabled() && self.cr & CED == 0 && self.clocks.hsi48_hz * 32 < self.clocks.ahb_hz
    }

    /// Starts a round if the buffer is empty and there is no error.
    fn begin_round(&mut self, now_ns: u64) {
        if !self.enabled() || self.ready > 0 || self.fill_ns.is_some() || self.seed_error.is_some() {
            return;
        }
        let (ahb_hz, rng_hz) = (self.clocks.ahb_hz, self.clocks.hsi48_hz);
        if ahb_hz == 0 || rng_hz == 0 {
            return;
        }
        let after = |clocks: u64, frequency_hz: u64| Ticks { start_ns: 0, frequency_hz, divider: 1 }.when_ns(clocks);
        // Cycle counts of 36.5; the first words after a reset take longer, by counts that depend on the clock ratio.
        let takes_ns = if self.warm {
            after(ROUND, ahb_hz).max(after(16, rng_hz))
        } else if ahb_hz < ROUND * rng_hz / 64 {
            after(128, rng_hz) + after(2 * ROUND, ahb_hz)
        } else {
            after(192, rng_hz) + after(ROUND, ahb_hz)
        };
        self.fill_ns = Some(now_ns.saturating_add(takes_ns));
    }

    fn bring_to_now(&mut self, context: &mut Context<'_>) {
        self.clocks = *context.clocks;
        if self.fill_ns.is_some_and(|at_ns| at_ns <= context.now_ns) {
            self.fill_ns = None;
            self.ready = BUFFER;
            self.warm = true;
        }
        self.clock_interrupt |= self.clock_error();
        self.begin_round(context.now_ns);
    }

    fn sr(&self) -> u32 {
        [
            (self.ready > 0, DRDY),
            (self.clock_error(), CECS),
            (self.seed_error.is_some(), SECS),
            (self.clock_interrupt, CEIS),
            (self.seed_interrupt, SEIS),
        ]
        .iter()
        .filter(|(set, _)| *set)
        .fold(0, |value, (_, bit)| value | bit)
    }

    /// Reads DR: 0 if the buffer is empty.
    fn take(&mut self, context: &mut Context<'_>) -> u32 {
        if self.seed_interrupt || self.clock_interrupt && self.ready == 0 {
            context.misuse(NAME, "DR is read in spite of an error (RM0399, 36.3.5)");
        }
        // After SEIS is cleared, the words to discard read as 0 (36.3.7).
        if let Some(left) = self.seed_error.filter(|_| !self.seed_interrupt) {
            self.seed_error = Some(left - 1).filter(|left| *left > 0);
            self.begin_round(context.now_ns);
            return 0;
        }
        if self.ready == 0 {
            return 0;
        }
        self.ready -= 1;
        let number = self.number();
        self.begin_round(context.now_ns);
        number
    }

    fn write_cr(&mut self, value: u32, context: &mut Context<'_>) {
        let mut value = value & (RNGEN | IE | CED);
        if self.enabled() && (self.cr ^ value) & CED != 0 {
            context.misuse(NAME, "CED changes while RNGEN is 1 (RM0399, 36.7.1)");
            value = value & !CED | self.cr & CED;
        }
        self.cr = value;
        if !self.enabled() {
            // The buffer remains readable; the noise source stops.
            self.fill_ns = None;
            self.seed_error = None;
        }
        self.clock_interrupt |= self.clock_error();
        self.begin_round(context.now_ns);
    }

    fn update_line(&mut self, context: &mut Context<'_>) {
        let level = self.enabled() && self.cr & IE != 0 && self.sr() & (DRDY | CEIS | SEIS) != 0;
        if level != self.line {
            context.irq(IRQ, level);
        }
        self.line = level;
    }

    /// Refuses accesses other than words, which are bus errors (36.2).
    fn words_only(size: Size) -> Result<(), Unmodelled> {
        match size {
            Size::Word => Ok(()),
            _ => Err(Unmodelled { peripheral: NAME, what: "access of less than a word is a bus error (36.2)".into() }),
        }
    }
}

impl Peripheral for Rng {
    fn read(&mut self, offset: u32, size: Size, context: &mut Context<'_>) -> Result<u32, Unmodelled> {
        Self::words_only(size)?;
        self.bring_to_now(context);
        let value = match offset {
            CR => self.cr,
            SR => self.sr(),
            DR => self.take(context),
            _ => return Err(Unmodelled::register(NAME, offset)),
        };
        self.update_line(context);
        Ok(value)
    }

    fn write(&mut self, offset: u32, size: Size, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        Self::words_only(size)?;
        self.bring_to_now(context);
        match offset {
            CR => self.write_cr(value, context),
            SR => {
                // Flags are cleared by writing 0.
                self.seed_interrupt &= value & SEIS != 0;
                self.clock_interrupt &= value & CEIS != 0;
            }
            DR => context.misuse(NAME, "DR is read-only (RM0399, 36.7.3)"),
            _ => return Err(Unmodelled::register(NAME, offset)),
        }
        self.update_line(context);
        Ok(())
    }

    fn next_event_ns(&self) -> u64 {
        self.fill_ns.unwrap_or(u64::MAX)
    }

    fn advance(&mut self, context: &mut Context<'_>) {
        self.bring_to_now(context);
        self.update_line(context);
    }

    fn clocks_changed(&mut self, context: &mut Context<'_>) {
        self.clocks = *context.clocks;
        // A round in progress starts again.
        self.fill_ns = None;
        self.bring_to_now(context);
        self.update_line(context);
    }

    fn reset(&mut self, context: &mut Context<'_>) {
        // The sequence continues after a reset by RCC.
        *self = Self { state: self.state, clocks: *context.clocks, line: self.line, ..Self::new(0) };
        self.update_line(context);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::peripherals::bench::Bench;

    fn bench(seed: u64) -> Bench<Rng> {
        Bench::new(Rng::new(seed), Clocks { ahb_hz: 240_000_000, hsi48_hz: 48_000_000, ..Clocks::default() })
    }

    /// Reads numbers with the polling procedure of 36.3.5.
    fn numbers(bench: &mut Bench<Rng>, count: usize) -> Vec<u32> {
        let mut numbers = Vec::new();
        while numbers.len() < count {
            let sr = bench.read(SR);
            assert_eq!(sr & (SEIS | CEIS), 0);
            if sr & DRDY != 0 {
                numbers.push(bench.read(DR));
            } else {
                let next_ns = bench.peripheral.next_event_ns();
                bench.run_until(next_ns);
            }
        }
        numbers
    }

    #[test]
    fn the_first_number_of_seed_0_is_published() {
        // Published sequence: SplitMix64 of seed 0 begins with 0xE220A8397B1DCDAF, 0x6E789E6AA1B965F4.
        let mut bench = bench(0);
        bench.write(CR, RNGEN);
        assert_eq!(numbers(&mut bench, 2), [0xE220_A839, 0x6E78_9E6A]);
    }

    #[test]
    fn a_seed_gives_one_sequence() {
        let run = |seed| {
            let mut bench = bench(seed);
            bench.write(CR, RNGEN);
            numbers(&mut bench, 100)
        };
        assert_eq!(run(7), run(7));
        assert_ne!(run(7), run(8));
        assert!(!run(7).contains(&0));
    }

    #[test]
    fn four_words_come_at_the_times_of_the_manual() {
        let mut bench = bench(1);
        assert_eq!(bench.read(SR), 0);
        bench.write(CR, RNGEN | IE);
        // Because 240 MHz exceeds 213 * 48 MHz / 64: 192 periods of 48 MHz, then 213 of 240 MHz.
        let first_ns = 4_000 + 888;
        bench.run_until(first_ns - 1);
        assert_eq!(bench.read(SR) & DRDY, 0);
        assert_eq!(bench.read(DR), 0);
        bench.run_until(first_ns);
        assert!(bench.irq(80));
        for _ in 0..4 {
            assert_eq!(bench.read(SR), DRDY);
            assert_ne!(bench.read(DR), 0);
        }
        assert!(!bench.irq(80));
        // The round takes 213 AHB clocks, which are longer than 16 of the RNG clock.
        bench.run_until(first_ns + 887);
        assert_eq!(bench.read(SR), 0);
        bench.run_until(first_ns + 888);
        assert_eq!(bench.read(SR), DRDY);
        assert_eq!(bench.take_misuse(), [""; 0]);
    }

    #[test]
    fn a_clock_that_is_too_slow_is_an_error_unless_detection_is_off() {
        let mut bench = bench(1);
        bench.clocks.hsi48_hz = 7_000_000; // below 240 MHz / 32
        bench.write(CR, RNGEN | IE);
        assert_eq!(bench.read(SR), CECS | CEIS);
        assert!(bench.irq(80));
        bench.clocks.hsi48_hz = 48_000_000;
        bench.with(|rng, context| rng.clocks_changed(context));
        assert_eq!(bench.read(SR), CEIS);
        bench.write(SR, 0);
        assert_eq!(bench.read(SR), 0);
        bench.write(CR, CED | RNGEN);
        assert_eq!(bench.take_misuse().len(), 1);
        bench.write(CR, 0);
        bench.write(CR, CED | RNGEN);
        bench.clocks.hsi48_hz = 400_000;
        bench.with(|rng, context| rng.clocks_changed(context));
        assert_eq!(bench.read(SR), 0);
    }

    #[test]
    fn a_seed_error_is_left_by_reading_twelve_words() {
        let mut bench = bench(1);
        bench.write(CR, RNGEN | IE);
        numbers(&mut bench, 1);
        bench.with(|rng, context| rng.inject_seed_error(context));
        assert!(bench.irq(80));
        assert_eq!(bench.read(SR), SECS | SEIS);
        bench.read(DR);
        assert_eq!(bench.take_misuse().len(), 1);
        bench.write(SR, 0);
        for _ in 0..12 {
            assert_eq!(bench.read(SR), SECS);
            assert_eq!(bench.read(DR), 0);
        }
        assert_eq!(bench.read(SR), 0);
        assert_ne!(numbers(&mut bench, 1), [0]);
        assert_eq!(bench.take_misuse(), [""; 0]);
    }

    #[test]
    fn only_words_and_only_these_registers() {
        let mut bench = bench(1);
        assert!(bench.with(|rng, context| rng.read(DR, Size::Byte, context)).is_err());
        assert!(bench.try_write(0x0C, 0).is_err());
        bench.write(DR, 1);
        assert_eq!(bench.take_misuse().len(), 1);
        bench.write(CR, RNGEN);
        bench.with(|rng, context| rng.reset(context));
        assert_eq!(bench.read(CR), 0);
        assert_eq!(bench.peripheral.next_event_ns(), u64::MAX);
    }
}
