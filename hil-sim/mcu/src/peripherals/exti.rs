//! Extended interrupt controller (RM0399, 21) for the Cortex-M7: lines 0 to 15, which are pins, and line 16.
//!
//! An edge selected by RTSR or FTSR sets its bit of C1PR1, whether C1IMR1 unmasks it or not; the interrupt lines follow
//! both registers. Line 16 is the voltage detector of PWR; lines 17 to 21 can be configured, and only software raises
//! them. Events (EMR), the D3 domain, the lines from 32 on and the registers of the Cortex-M4 are not modelled.

use crate::{
    Context, Edge, Peripheral, Pin, Size, Unmodelled,
    peripherals::{
        access::{merged, part},
        syscfg::Syscfg,
    },
};

const RTSR1: u32 = 0x00;
const FTSR1: u32 = 0x04;
const SWIER1: u32 = 0x08;
const C1IMR1: u32 = 0x80;
const C1EMR1: u32 = 0x84;
const C1PR1: u32 = 0x88;

/// Lines with selectable edges.
const CONFIGURABLE: u32 = 0x003F_FFFF;
/// Lines that are pins.
const PINS: u32 = 0xFFFF;
/// Mask register after reset: all direct lines are unmasked.
const MASK_AT_RESET: u32 = 0xFFC0_0000;

/// Interrupt numbers, with the EXTI lines that raise them.
const IRQS: [(u16, u32); 8] =
    [(1, 1 << 16), (6, 1), (7, 1 << 1), (8, 1 << 2), (9, 1 << 3), (10, 1 << 4), (23, 0x03E0), (40, 0xFC00)];

/// State of the EXTI.
pub struct Exti {
    rising: u32,
    falling: u32,
    mask: u32,
    pending: u32,
    /// Raised interrupt lines, in the order of [`IRQS`].
    raised: [bool; IRQS.len()],
}

impl Default for Exti {
    fn default() -> Self {
        Self::new()
    }
}

impl Exti {
    /// Makes the controller in its reset state.
    #[must_use]
    pub fn new() -> Self {
        Self { rising: 0, falling: 0, mask: MASK_AT_RESET, pending: 0, raised: [false; IRQS.len()] }
    }

    /// Handles an edge at a pin. The input is asynchronous and needs no clock, so it takes effect at once.
    pub fn edge(&mut self, syscfg: &Syscfg, edge: Edge, context: &mut Context<'_>) {
        let chosen = if edge.high { self.rising } else { self.falling };
        if syscfg.exti_pin(edge.pin.number) == edge.pin && chosen >> edge.pin.number & 1 != 0 {
            self.pending |= 1 << edge.pin.number;
            self.raise(context);
        }
    }

    /// Handles a change of a line from 16 on.
    pub fn line(&mut self, line: u8, high: bool, context: &mut Context<'_>) {
        let chosen = if high { self.rising } else { self.falling };
        self.pending |= chosen & CONFIGURABLE & 1 << (line & 31);
        self.raise(context);
    }

    /// Returns true for registers that may change [`Exti::watched`]: RTSR, FTSR or IMR, not the pending bits.
    #[must_use]
    pub fn chooses(offset: u32) -> bool {
        !matches!(offset & !3, SWIER1 | C1PR1)
    }

    /// Returns the pins of which an edge would raise an interrupt.
    pub fn watched<'a>(&self, syscfg: &'a Syscfg) -> impl Iterator<Item = Pin> + use<'a> {
        let lines = (self.rising | self.falling) & self.mask & PINS;
        (0..16).filter(move |line| lines >> line & 1 != 0).map(|line| syscfg.exti_pin(line))
    }

    fn raise(&mut self, context: &mut Context<'_>) {
        for ((number, lines), raised) in IRQS.into_iter().zip(&mut self.raised) {
            let level = self.pending & self.mask & lines != 0;
            if level != *raised {
                *raised = level;
                context.irq(number, level);
            }
        }
    }

    fn value(&self, at: u32) -> Option<u32> {
        match at {
            RTSR1 => Some(self.rising),
            FTSR1 => Some(self.falling),
            SWIER1 | C1EMR1 => Some(0),
            C1IMR1 => Some(self.mask),
            C1PR1 => Some(self.pending),
            _ => None,
        }
    }
}

impl Peripheral for Exti {
    fn read(&mut self, offset: u32, size: Size, _: &mut Context<'_>) -> Result<u32, Unmodelled> {
        let value = self.value(offset & !3).ok_or_else(|| Unmodelled::register("EXTI", offset))?;
        Ok(part(value, offset, size))
    }

    fn write(&mut self, offset: u32, size: Size, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        let at = offset & !3;
        let before = self.value(at).ok_or_else(|| Unmodelled::register("EXTI", offset))?;
        let whole = merged(before, offset, size, value);
        // For bits that act when written with 1, unwritten bits are 0.
        let acting = merged(0, offset, size, value);
        match at {
            RTSR1 => self.rising = whole & CONFIGURABLE,
            FTSR1 => self.falling = whole & CONFIGURABLE,
            SWIER1 => self.pending |= acting & CONFIGURABLE,
            C1IMR1 => self.mask = whole,
            C1PR1 => self.pending &= !acting,
            _ if acting == 0 => {}
            _ => return Err(Unmodelled { peripheral: "EXTI", what: "events (C1EMR1)".into() }),
        }
        self.raise(context);
        Ok(())
    }

    fn reset(&mut self, context: &mut Context<'_>) {
        let raised = self.raised;
        *self = Self { raised, ..Self::new() };
        self.raise(context);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Signal, testing::Bench};

    /// Makes EXTI line 10 on port I, with both edges, unmasked.
    fn encoder() -> (Exti, Syscfg, Bench) {
        let (mut exti, mut syscfg, mut bench) = (Exti::new(), Syscfg::new(), Bench::default());
        bench.write(&mut syscfg, 0x10, 8 << 8);
        bench.write(&mut exti, RTSR1, 1 << 10);
        bench.write(&mut exti, FTSR1, 1 << 10);
        bench.modify(&mut exti, C1IMR1, 0, 1 << 10);
        (exti, syscfg, bench)
    }

    fn edge(port: char, number: u8, high: bool) -> Edge {
        Edge { at_ns: 0, pin: Pin::new(port, number), high }
    }

    #[test]
    fn an_edge_raises_the_shared_interrupt_until_it_is_cleared() {
        let (mut exti, syscfg, mut bench) = encoder();
        exti.edge(&syscfg, edge('I', 10, true), &mut bench.context());
        exti.edge(&syscfg, edge('I', 10, false), &mut bench.context());
        assert_eq!(bench.take_signals(), [Signal::Irq { number: 40, level: true }]);
        assert_eq!(bench.read(&mut exti, C1PR1), 1 << 10);
        bench.write(&mut exti, C1PR1, 1 << 11);
        assert_eq!(bench.take_signals(), []);
        bench.write(&mut exti, C1PR1, 1 << 10);
        assert_eq!(bench.take_signals(), [Signal::Irq { number: 40, level: false }]);
        assert_eq!(exti.watched(&syscfg).collect::<Vec<_>>(), [Pin::new('I', 10)]);
    }

    #[test]
    fn the_same_number_on_another_port_and_an_edge_not_chosen_do_nothing() {
        let (mut exti, syscfg, mut bench) = encoder();
        exti.edge(&syscfg, edge('A', 10, true), &mut bench.context());
        bench.write(&mut exti, RTSR1, 0);
        exti.edge(&syscfg, edge('I', 10, true), &mut bench.context());
        assert_eq!(bench.read(&mut exti, C1PR1), 0);
        assert_eq!(bench.take_signals(), []);
    }

    #[test]
    fn a_masked_edge_waits() {
        let (mut exti, syscfg, mut bench) = encoder();
        bench.modify(&mut exti, C1IMR1, 1 << 10, 0);
        assert_eq!(exti.watched(&syscfg).count(), 0);
        exti.edge(&syscfg, edge('I', 10, true), &mut bench.context());
        assert_eq!(bench.take_signals(), []);
        bench.modify(&mut exti, C1IMR1, 0, 1 << 10);
        assert_eq!(bench.take_signals(), [Signal::Irq { number: 40, level: true }]);
        bench.modify(&mut exti, C1IMR1, 1 << 10, 0);
        assert_eq!(bench.take_signals(), [Signal::Irq { number: 40, level: false }]);
    }

    #[test]
    fn each_line_has_the_interrupt_of_the_vector_table() {
        let (mut exti, mut bench) = (Exti::new(), Bench::default());
        bench.write(&mut exti, C1IMR1, 0x1FFFF);
        for line in 0..17 {
            // Numbers of RM0399's table of vectors: 6 to 10, 23, 40, and 1 for PVD_PVM.
            let number = [6, 7, 8, 9, 10, 23, 23, 23, 23, 23, 40, 40, 40, 40, 40, 40, 1][line];
            bench.write(&mut exti, SWIER1, 1 << line);
            bench.write(&mut exti, C1PR1, 1 << line);
            assert_eq!(bench.take_signals(), [true, false].map(|level| Signal::Irq { number, level }));
        }
    }

    #[test]
    fn a_line_that_is_no_pin_has_the_edges_that_were_chosen() {
        let (mut exti, mut bench) = (Exti::new(), Bench::default());
        bench.write(&mut exti, RTSR1, 1 << 16);
        bench.modify(&mut exti, C1IMR1, 0, 1 << 16);
        exti.line(16, false, &mut bench.context());
        assert_eq!(bench.take_signals(), []);
        exti.line(16, true, &mut bench.context());
        assert_eq!(bench.take_signals(), [Signal::Irq { number: 1, level: true }]);
        assert_eq!(bench.read(&mut exti, C1PR1), 1 << 16);
    }

    #[test]
    fn events_end_the_run() {
        let (mut exti, mut bench) = (Exti::new(), Bench::default());
        assert!(bench.try_write(&mut exti, C1EMR1, Size::Word, 0).is_ok());
        assert!(bench.try_write(&mut exti, C1EMR1, Size::Word, 1).is_err());
        assert!(bench.try_read(&mut exti, 0xC0, Size::Word).is_err());
    }
}
