//! Exception state: which exceptions are pending and active, and which is next (DDI0403E B1.5).

use super::bits::Bits;

/// Numbers of exceptions (B1.5.2).
pub mod number {
    /// Reset, which is never pending in this model.
    pub const RESET: u16 = 1;
    /// Non-maskable interrupt (NMI), above all configurable exceptions.
    pub const NMI: u16 = 2;
    /// HardFault, the exception for escalated faults.
    pub const HARD_FAULT: u16 = 3;
    /// MemManage fault, of the memory protection.
    pub const MEM_MANAGE: u16 = 4;
    /// BusFault, for refused bus accesses.
    pub const BUS_FAULT: u16 = 5;
    /// UsageFault, for invalid instructions and states.
    pub const USAGE_FAULT: u16 = 6;
    /// Supervisor call (SVCall), by the SVC instruction.
    pub const SV_CALL: u16 = 11;
    /// Debug monitor, which is not modelled.
    pub const DEBUG_MONITOR: u16 = 12;
    /// PendSV, requested by software.
    pub const PEND_SV: u16 = 14;
    /// SysTick, the system timer.
    pub const SYS_TICK: u16 = 15;
    /// The first external interrupt.
    pub const IRQ0: u16 = 16;
}

/// Number of external interrupts: the architectural maximum, of which the chip wires 150.
pub const IRQS: u16 = 240;

/// Implemented bits of a priority, the most significant ones (the chip has 16 levels).
pub const PRIORITY_MASK: u8 = 0xF0;

/// Registers that raise the execution priority (B1.4.3).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Masks {
    /// PRIMASK.PM: masks all configurable exceptions.
    pub primask: bool,
    /// FAULTMASK.FM: masks all but NMI.
    pub faultmask: bool,
    /// BASEPRI; 0 means off.
    pub basepri: u8,
}

impl Masks {
    /// No mask is set.
    pub const NONE: Self = Self { primask: false, faultmask: false, basepri: 0 };
}

/// State of all exceptions of the processor.
#[derive(Clone, Debug)]
pub struct Exceptions {
    pub(super) pending: Bits,
    pub(super) active: Bits,
    pub(super) enabled: Bits,
    lines: Bits,
    priority: [u8; 256],
    /// Field AIRCR.PRIGROUP, the split of priorities.
    pub(super) prigroup: u8,
    version: u32,
}

impl Default for Exceptions {
    fn default() -> Self {
        Self::new()
    }
}

impl Exceptions {
    /// Makes the state after a reset, with every line low.
    #[must_use]
    pub fn new() -> Self {
        let mut enabled = Bits::default();
        for always in [number::NMI, number::HARD_FAULT, number::SV_CALL, number::PEND_SV, number::SYS_TICK] {
            enabled.set(always, true);
        }
        Self {
            pending: Bits::default(),
            active: Bits::default(),
            enabled,
            lines: Bits::default(),
            priority: [0; 256],
            prigroup: 0,
            version: 0,
        }
    }

    /// Resets the state: lines keep their levels, and those that are high are pending at once.
    pub fn reset(&mut self) {
        let lines = self.lines;
        let version = self.version;
        *self = Self { lines, pending: lines, version: version.wrapping_add(1), ..Self::new() };
    }

    /// Returns a version number that changes whenever an exception may have become able to preempt: when it becomes
    /// pending or enabled, or priorities change.
    #[must_use]
    pub fn version(&self) -> u32 {
        self.version
    }

    pub(super) fn changed(&mut self) {
        self.version = self.version.wrapping_add(1);
    }

    /// Priority of an exception (B1.5.4), before grouping: the lower, the more urgent.
    #[must_use]
    pub fn priority(&self, exception: u16) -> i32 {
        match exception {
            number::RESET => -3,
            number::NMI => -2,
            number::HARD_FAULT => -1,
            _ => self.priority[usize::from(exception)].into(),
        }
    }

    /// Returns the priority field of an exception, as in SHPR and IPR.
    #[must_use]
    pub fn priority_field(&self, exception: u16) -> u8 {
        self.priority[usize::from(exception)]
    }

    /// Writes the priority field; unimplemented bits stay zero.
    pub fn set_priority_field(&mut self, exception: u16, value: u8) {
        self.priority[usize::from(exception)] = value & PRIORITY_MASK;
        self.changed();
    }

    /// Returns the group part of a priority, which decides on preemption (B1.5.4, PRIGROUP).
    fn group(&self, priority: i32) -> i32 {
        let sub_bits = u32::from(self.prigroup) + 1;
        if priority < 0 { priority } else { priority >> sub_bits << sub_bits }
    }

    /// Returns the execution priority (B1.5.4, `ExecutionPriority`); 256 in thread mode without masks.
    #[must_use]
    pub fn execution_priority(&self, masks: Masks) -> i32 {
        let active = self.active.iter().map(|exception| self.group(self.priority(exception))).min().unwrap_or(256);
        let mut boosted = 256;
        if masks.basepri != 0 {
            boosted = self.group(masks.basepri.into());
        }
        if masks.primask {
            boosted = boosted.min(0);
        }
        if masks.faultmask {
            boosted = -1;
        }
        active.min(boosted)
    }

    /// Returns the most urgent exception that is pending and enabled; ties go to the lower number (B1.5.4).
    #[must_use]
    pub fn next_pending(&self) -> Option<u16> {
        let candidates = self.pending.and(&self.enabled);
        candidates.iter().min_by_key(|exception| (self.priority(*exception), *exception))
    }

    /// Returns true if any exception is pending and enabled, of any priority.
    #[must_use]
    pub fn is_any_pending(&self) -> bool {
        !self.pending.and(&self.enabled).is_empty()
    }

    /// Returns the exception that preempts the present code, if one does.
    #[must_use]
    pub fn preempting(&self, masks: Masks) -> Option<u16> {
        if self.pending.is_empty() {
            return None;
        }
        // Sub-priorities only order pending exceptions; the group decides on preemption.
        self.next_pending().filter(|next| self.group(self.priority(*next)) < self.execution_priority(masks))
    }

    /// Returns true if a synchronous exception of this kind would be taken now: it is enabled and urgent enough.
    #[must_use]
    pub fn can_take(&self, exception: u16, masks: Masks) -> bool {
        self.enabled.get(exception) && self.group(self.priority(exception)) < self.execution_priority(masks)
    }

    /// Sets the level of an interrupt's line. A rising level makes it pending (B3.4: a level that stays makes it
    /// pending again after its handler).
    ///
    /// Lines from [`IRQS`] on do not exist and are ignored.
    pub fn set_line(&mut self, irq: u16, level: bool) {
        if irq >= IRQS {
            return;
        }
        let exception = number::IRQ0 + irq;
        if level && !self.lines.get(exception) {
            self.set_pending(exception);
        }
        self.lines.set(exception, level);
    }

    /// Sets the level of the NMI's input, which behaves as an interrupt's line (B1.5.1, B3.2.4).
    pub fn set_nmi(&mut self, level: bool) {
        if level && !self.lines.get(number::NMI) {
            self.set_pending(number::NMI);
        }
        self.lines.set(number::NMI, level);
    }

    /// Makes an exception pending.
    pub fn set_pending(&mut self, exception: u16) {
        self.pending.set(exception, true);
        self.changed();
    }

    /// Clears a pending state; an interrupt whose line is high stays pending, unless its handler is active.
    pub fn clear_pending(&mut self, exception: u16) {
        let held = self.lines.get(exception) && !self.active.get(exception);
        self.pending.set(exception, held);
    }

    /// Enables or disables an exception.
    pub fn set_enabled(&mut self, exception: u16, on: bool) {
        self.enabled.set(exception, on);
        self.changed();
    }

    /// Returns true if the exception is pending.
    #[must_use]
    pub fn is_pending(&self, exception: u16) -> bool {
        self.pending.get(exception)
    }

    /// Returns true if its handler runs, or is preempted.
    #[must_use]
    pub fn is_active(&self, exception: u16) -> bool {
        self.active.get(exception)
    }

    /// Returns the number of active exceptions.
    #[must_use]
    pub fn active_count(&self) -> usize {
        self.active.iter().count()
    }

    /// Marks the exception as active, when it is taken.
    pub fn activate(&mut self, exception: u16) {
        self.active.set(exception, true);
        self.pending.set(exception, false);
    }

    /// Marks the exception as inactive, when its handler has returned.
    pub fn deactivate(&mut self, exception: u16) {
        self.active.set(exception, false);
        if self.lines.get(exception) {
            self.set_pending(exception);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::number::*;
    use super::*;

    fn with(irqs: &[(u16, u8)]) -> Exceptions {
        let mut exceptions = Exceptions::new();
        for (irq, priority) in irqs {
            exceptions.set_enabled(IRQ0 + irq, true);
            exceptions.set_priority_field(IRQ0 + irq, *priority);
        }
        exceptions
    }

    #[test]
    fn the_most_urgent_comes_first_and_ties_go_to_the_lower_number() {
        let mut exceptions = with(&[(3, 0x40), (5, 0x20), (4, 0x20)]);
        for irq in [3, 5, 4] {
            exceptions.set_line(irq, true);
        }
        assert_eq!(exceptions.preempting(Masks::NONE), Some(IRQ0 + 4));
        exceptions.activate(IRQ0 + 4);
        // An exception of the same priority does not preempt.
        assert_eq!(exceptions.preempting(Masks::NONE), None);
        exceptions.set_line(4, false);
        exceptions.deactivate(IRQ0 + 4);
        assert_eq!(exceptions.preempting(Masks::NONE), Some(IRQ0 + 5));
    }

    #[test]
    fn sub_priorities_order_but_do_not_preempt() {
        let mut exceptions = with(&[(0, 0x50), (1, 0x40)]);
        // With PRIGROUP 6 only bit 7 is the group.
        exceptions.prigroup = 6;
        exceptions.set_line(0, true);
        exceptions.activate(IRQ0);
        exceptions.set_line(1, true);
        assert_eq!(exceptions.preempting(Masks::NONE), None);
        exceptions.prigroup = 3;
        assert_eq!(exceptions.preempting(Masks::NONE), Some(IRQ0 + 1));
    }

    #[test]
    fn masks_raise_the_execution_priority() {
        let mut exceptions = with(&[(0, 0x30)]);
        exceptions.set_line(0, true);
        let primask = Masks { primask: true, ..Masks::NONE };
        assert_eq!(exceptions.execution_priority(primask), 0);
        assert_eq!(exceptions.preempting(primask), None);
        // BASEPRI masks its own level and below, not above it.
        assert_eq!(exceptions.preempting(Masks { basepri: 0x30, ..Masks::NONE }), None);
        assert_eq!(exceptions.preempting(Masks { basepri: 0x40, ..Masks::NONE }), Some(IRQ0));
        exceptions.set_pending(HARD_FAULT);
        assert_eq!(exceptions.preempting(primask), Some(HARD_FAULT));
        let faultmask = Masks { faultmask: true, ..Masks::NONE };
        assert_eq!(exceptions.preempting(faultmask), None);
        exceptions.set_pending(NMI);
        assert_eq!(exceptions.preempting(faultmask), Some(NMI));
    }

    #[test]
    fn a_level_that_stays_is_pending_again_and_a_pulse_is_not() {
        let mut exceptions = with(&[(7, 0)]);
        exceptions.set_line(7, true);
        exceptions.activate(IRQ0 + 7);
        assert!(!exceptions.is_pending(IRQ0 + 7));
        exceptions.deactivate(IRQ0 + 7);
        assert!(exceptions.is_pending(IRQ0 + 7));
        exceptions.clear_pending(IRQ0 + 7);
        assert!(exceptions.is_pending(IRQ0 + 7), "the line is still high");
        exceptions.activate(IRQ0 + 7);
        exceptions.set_line(7, false);
        exceptions.set_line(7, true);
        assert!(exceptions.is_pending(IRQ0 + 7), "an edge during the handler");
        exceptions.set_line(7, false);
        exceptions.deactivate(IRQ0 + 7);
        assert!(exceptions.is_pending(IRQ0 + 7), "the edge is kept");
        exceptions.activate(IRQ0 + 7);
        exceptions.deactivate(IRQ0 + 7);
        assert!(!exceptions.is_pending(IRQ0 + 7));
    }

    #[test]
    fn what_is_disabled_stays_pending() {
        let mut exceptions = Exceptions::new();
        exceptions.set_line(9, true);
        exceptions.set_line(IRQS, true);
        assert_eq!(exceptions.preempting(Masks::NONE), None);
        let before = exceptions.version();
        exceptions.set_enabled(IRQ0 + 9, true);
        assert_ne!(exceptions.version(), before);
        assert_eq!(exceptions.preempting(Masks::NONE), Some(IRQ0 + 9));
    }
}
