//! Acceptance filtering (RM0399, 59.4.2, figures 781 and 782).

use crate::outside::CanFrame;

use super::ram::MessageRam;

/// Result of the filters for a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Verdict {
    pub(super) store: Store,
    /// Index of the matching element, if any.
    pub(super) element: Option<u32>,
    /// The element reports a priority match.
    pub(super) priority: bool,
}

/// Destination of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Store {
    Nowhere,
    Fifo(usize),
    Buffer(usize),
    Debug,
}

/// Filter registers of a module.
#[derive(Clone, Copy, Debug)]
pub(super) struct Filters {
    pub(super) global: u32,
    pub(super) standard: u32,
    pub(super) extended: u32,
    pub(super) extended_mask: u32,
    /// Rx buffers with their New data flag set.
    pub(super) locked_buffers: u64,
}

/// Filter element of either kind.
struct Element {
    configuration: u32,
    kind: u32,
    first: u32,
    second: u32,
}

const RANGE: u32 = 0;
const DUAL: u32 = 1;
const CLASSIC: u32 = 2;
/// Type code 3: disabled for standard identifiers, a range without XIDAM for extended ones.
const OTHER: u32 = 3;

impl Filters {
    /// Searches the list from element 0 for the first match.
    pub(super) fn judge(&self, frame: &CanFrame, ram: &MessageRam) -> Verdict {
        let (reject_remote, not_matching, list, limit) = if frame.extended {
            (self.global & 1, self.global >> 2 & 3, self.extended, 64)
        } else {
            (self.global >> 1 & 1, self.global >> 4 & 3, self.standard, 128)
        };
        let nowhere = Verdict { store: Store::Nowhere, element: None, priority: false };
        if frame.remote && reject_remote == 1 {
            return nowhere;
        }
        let start = (list & 0xFFFC) as usize / 4;
        for index in 0..(list >> 16 & 0xFF).min(limit) {
            let element = element(frame.extended, start, index as usize, ram);
            if let Some(verdict) = self.matches(frame, &element, index) {
                return verdict;
            }
        }
        // ANFS and ANFE: 0 and 1 select a FIFO, 2 and 3 reject.
        match not_matching {
            fifo @ 0..2 => Verdict { store: Store::Fifo(fifo as usize), ..nowhere },
            _ => nowhere,
        }
    }

    fn matches(&self, frame: &CanFrame, element: &Element, index: u32) -> Option<Verdict> {
        let masked = if frame.extended { frame.id & self.extended_mask } else { frame.id };
        // Configuration 7: the frame goes to an Rx buffer, or is a debug message.
        if element.configuration == 7 {
            let buffer = (element.second & 0x3F) as usize;
            let debug = element.second >> 9 & 3 != 0;
            // A buffer whose New data flag is set accepts no frame.
            let matched = masked == element.first && (debug || self.locked_buffers >> buffer & 1 == 0);
            let store = if debug { Store::Debug } else { Store::Buffer(buffer) };
            return matched.then_some(Verdict { store, element: Some(index), priority: false });
        }
        let in_range = |id: u32| (element.first..=element.second).contains(&id);
        let matched = element.configuration != 0
            && match element.kind {
                RANGE => in_range(masked),
                DUAL => masked == element.first || masked == element.second,
                CLASSIC => (masked ^ element.first) & element.second == 0,
                OTHER => frame.extended && in_range(frame.id),
                _ => false,
            };
        let store = match element.configuration {
            1 | 5 => Store::Fifo(0),
            2 | 6 => Store::Fifo(1),
            _ => Store::Nowhere,
        };
        // Configurations 4 to 6 report a priority match.
        matched.then_some(Verdict { store, element: Some(index), priority: element.configuration >= 4 })
    }
}

fn element(extended: bool, start: usize, index: usize, ram: &MessageRam) -> Element {
    if extended {
        let (first, second) = (ram.word(start + 2 * index), ram.word(start + 2 * index + 1));
        Element {
            configuration: first >> 29,
            kind: second >> 30,
            first: first & 0x1FFF_FFFF,
            second: second & 0x1FFF_FFFF,
        }
    } else {
        let word = ram.word(start + index);
        Element { configuration: word >> 27 & 7, kind: word >> 30, first: word >> 16 & 0x7FF, second: word & 0x7FF }
    }
}
