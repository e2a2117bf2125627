//! Registers of the NVIC (DDI0403E B3.4), backed by [`Exceptions`].

use super::exceptions::{Exceptions, IRQS, number::IRQ0};

/// Kind of a register with 32 interrupts' bits: the effect of writing ones.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Group {
    SetEnable,
    ClearEnable,
    SetPending,
    ClearPending,
    Active,
}

/// Returns the kind and the first interrupt of a register; offsets are from 0xE000_E000.
fn group(offset: u32) -> Option<(Group, u16)> {
    let group = match offset {
        0x100..0x120 => Group::SetEnable,
        0x180..0x1A0 => Group::ClearEnable,
        0x200..0x220 => Group::SetPending,
        0x280..0x2A0 => Group::ClearPending,
        0x300..0x320 => Group::Active,
        _ => return None,
    };
    Some((group, (offset as u16 & 0x1F) / 4 * 32))
}

fn exceptions_from(first: u16) -> impl Iterator<Item = (u32, u16)> {
    (0..32).map(move |bit| (bit, first + bit as u16)).filter(|(_, irq)| *irq < IRQS).map(|(bit, irq)| (bit, IRQ0 + irq))
}

/// Reads a word; `None` where no register exists.
pub(super) fn read(exceptions: &Exceptions, offset: u32) -> Option<u32> {
    if let 0x400..0x4F0 = offset {
        let first = IRQ0 + (offset - 0x400) as u16;
        return Some(u32::from_le_bytes(std::array::from_fn(|byte| exceptions.priority_field(first + byte as u16))));
    }
    let (group, first) = group(offset)?;
    let set = match group {
        Group::SetEnable | Group::ClearEnable => &exceptions.enabled,
        Group::SetPending | Group::ClearPending => &exceptions.pending,
        Group::Active => &exceptions.active,
    };
    Some(exceptions_from(first).filter(|(_, exception)| set.get(*exception)).fold(0, |word, (bit, _)| word | 1 << bit))
}

/// Writes a word; `None` where no register exists.
pub(super) fn write(exceptions: &mut Exceptions, offset: u32, value: u32) -> Option<()> {
    if let 0x400..0x4F0 = offset {
        let first = IRQ0 + (offset - 0x400) as u16;
        for (byte, priority) in value.to_le_bytes().into_iter().enumerate() {
            exceptions.set_priority_field(first + byte as u16, priority);
        }
        return Some(());
    }
    let (group, first) = group(offset)?;
    for (_, exception) in exceptions_from(first).filter(|(bit, _)| value >> bit & 1 == 1) {
        match group {
            Group::SetEnable => exceptions.set_enabled(exception, true),
            Group::ClearEnable => exceptions.set_enabled(exception, false),
            Group::SetPending => exceptions.set_pending(exception),
            Group::ClearPending => exceptions.clear_pending(exception),
            // Writes to the active bits have no effect.
            Group::Active => {}
        }
    }
    Some(())
}

/// Handles STIR: makes an interrupt pending by its number.
pub(super) fn trigger(exceptions: &mut Exceptions, value: u32) {
    let irq = (value & 0x1FF) as u16;
    if irq < IRQS {
        exceptions.set_pending(IRQ0 + irq);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn enables_are_set_and_cleared_by_ones_and_read_in_both_places() {
        let mut exceptions = Exceptions::new();
        write(&mut exceptions, 0x104, 0x8000_0001).unwrap();
        assert_eq!((read(&exceptions, 0x104), read(&exceptions, 0x184)), (Some(0x8000_0001), Some(0x8000_0001)));
        write(&mut exceptions, 0x184, 1).unwrap();
        assert_eq!(read(&exceptions, 0x104), Some(0x8000_0000));
        assert!(exceptions.enabled.get(IRQ0 + 63));
    }

    #[test]
    fn priorities_have_four_bits_and_their_own_bytes() {
        let mut exceptions = Exceptions::new();
        write(&mut exceptions, 0x404, 0xFF_12_34_8F).unwrap();
        assert_eq!(read(&exceptions, 0x404), Some(0xF0_10_30_80));
        assert_eq!(exceptions.priority(IRQ0 + 7), 0xF0);
    }

    #[test]
    fn pending_by_register_and_by_stir() {
        let mut exceptions = Exceptions::new();
        write(&mut exceptions, 0x200, 2).unwrap();
        trigger(&mut exceptions, 34);
        assert_eq!((read(&exceptions, 0x200), read(&exceptions, 0x284)), (Some(2), Some(4)));
        write(&mut exceptions, 0x280, 2).unwrap();
        assert_eq!(read(&exceptions, 0x200), Some(0));
        exceptions.activate(IRQ0 + 34);
        assert_eq!((read(&exceptions, 0x304), read(&exceptions, 0x204)), (Some(4), Some(0)));
        trigger(&mut exceptions, 0x1FF);
    }

    #[test]
    fn there_are_240_interrupts() {
        let mut exceptions = Exceptions::new();
        write(&mut exceptions, 0x11C, u32::MAX).unwrap();
        assert_eq!(read(&exceptions, 0x11C), Some(0xFFFF));
        assert_eq!((read(&exceptions, 0x120), read(&exceptions, 0x4F0)), (None, None));
    }
}
