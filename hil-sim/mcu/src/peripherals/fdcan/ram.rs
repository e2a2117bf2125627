//! Message RAM of both modules (RM0399, 59.4.2), and its elements (59.4.18 to 59.4.22).

use crate::outside::CanFrame;

/// Size of the RAM, words: 10 KB.
pub(super) const WORDS: usize = 2560;

/// Bits of an element's first word.
pub(super) const ESI: u32 = 1 << 31;
pub(super) const XTD: u32 = 1 << 30;
pub(super) const RTR: u32 = 1 << 29;
/// Bits of an element's second word.
pub(super) const FDF: u32 = 1 << 21;
pub(super) const BRS: u32 = 1 << 20;
pub(super) const EFC: u32 = 1 << 23;

/// Length of a data field by DLC, bytes; a classic frame has at most 8 (table 502).
const FD_LENGTH: [usize; 16] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64];

/// Size of an element's data field by RXESC and TXESC, bytes (table 506).
const ELEMENT_BYTES: [usize; 8] = [8, 12, 16, 20, 24, 32, 48, 64];

/// Returns the DLC of a length, or that of the next longer one.
pub(super) fn dlc(length: usize) -> u32 {
    FD_LENGTH.iter().position(|bytes| *bytes >= length).unwrap_or(15) as u32
}

/// Returns the length that a DLC means, bytes.
pub(super) fn length(dlc: u32, fd: bool) -> usize {
    let bytes = FD_LENGTH[(dlc & 0xF) as usize];
    if fd { bytes } else { bytes.min(8) }
}

/// Makes the first word of an element.
pub(super) fn header(frame: &CanFrame, esi: bool) -> u32 {
    let id = if frame.extended { frame.id & 0x1FFF_FFFF | XTD } else { (frame.id & 0x7FF) << 18 };
    id | if frame.remote { RTR } else { 0 } | if esi { ESI } else { 0 }
}

/// Returns FDF, BRS and DLC for the second word of an element.
pub(super) fn format(frame: &CanFrame) -> u32 {
    dlc(frame.data.len()) << 16 | if frame.fd { FDF } else { 0 } | if frame.bit_rate_switch { BRS } else { 0 }
}

/// RAM of 2560 words; addresses outside read 0 and ignore writes.
#[derive(Clone, Debug)]
pub(super) struct MessageRam {
    words: Vec<u32>,
}

impl MessageRam {
    pub(super) fn new() -> Self {
        Self { words: vec![0; WORDS] }
    }

    pub(super) fn word(&self, index: usize) -> u32 {
        self.words.get(index).copied().unwrap_or(0)
    }

    pub(super) fn set_word(&mut self, index: usize, value: u32) {
        if let Some(word) = self.words.get_mut(index) {
            *word = value;
        }
    }

    /// Reads the frame in the Tx buffer at a word; data beyond its element is padded with 0xCC (59.4.1).
    pub(super) fn frame(&self, index: usize, element_bytes: usize, fd_enabled: bool, brs_enabled: bool) -> CanFrame {
        let (first, second) = (self.word(index), self.word(index + 1));
        let extended = first & XTD != 0;
        let remote = first & RTR != 0;
        let fd = fd_enabled && !remote && second & FDF != 0;
        let bytes = if remote { 0 } else { length(second >> 16, fd) };
        let data = (0..bytes)
            .map(|nth| if nth < element_bytes { (self.word(index + 2 + nth / 4) >> (nth % 4 * 8)) as u8 } else { 0xCC })
            .collect();
        CanFrame {
            id: if extended { first & 0x1FFF_FFFF } else { first >> 18 & 0x7FF },
            extended,
            remote,
            fd,
            bit_rate_switch: fd && brs_enabled && second & BRS != 0,
            data,
        }
    }

    /// Writes data behind the two header words of an element, as far as it has room.
    pub(super) fn set_data(&mut self, index: usize, element_bytes: usize, data: &[u8]) {
        for (nth, four) in data[..data.len().min(element_bytes)].chunks(4).enumerate() {
            let mut bytes = [0; 4];
            bytes[..four.len()].copy_from_slice(four);
            self.set_word(index + 2 + nth, u32::from_le_bytes(bytes));
        }
    }
}

/// Returns the data size of an element by its code in RXESC or TXESC, bytes.
pub(super) fn element_bytes(code: u32) -> usize {
    ELEMENT_BYTES[(code & 7) as usize]
}

/// Returns the size of an element, words.
pub(super) fn element_words(code: u32) -> usize {
    2 + element_bytes(code) / 4
}
