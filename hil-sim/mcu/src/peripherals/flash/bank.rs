//! One bank of the flash: its control and status registers, write buffer and queue of operations (RM0399, 4.3.9,
//! 4.3.10, 4.7, 4.9).

use std::collections::VecDeque;

use super::cells::{BANK_WORDS, FlashCells, SECTOR_WORDS, WORD_BYTES, Word};
use crate::Context;

/// Bits of the control register CR.
pub(super) const LOCK: u32 = 1;
const PG: u32 = 1 << 1;
const SER: u32 = 1 << 2;
const BER: u32 = 1 << 3;
const FW: u32 = 1 << 6;
const START: u32 = 1 << 7;
pub(super) const CRC_EN: u32 = 1 << 15;
pub(super) const CR_AT_RESET: u32 = 0x31;
const CR_WRITABLE: u32 = 0x1FEF_077F | START;

/// Bits of the status register SR.
const BSY: u32 = 1;
const WBNE: u32 = 1 << 1;
const QW: u32 = 1 << 2;
pub(super) const EOP: u32 = 1 << 16;
pub(super) const WRPERR: u32 = 1 << 17;
pub(super) const PGSERR: u32 = 1 << 18;
pub(super) const STRBERR: u32 = 1 << 19;
pub(super) const INCERR: u32 = 1 << 21;
pub(super) const RDPERR: u32 = 1 << 23;
pub(super) const SNECCERR: u32 = 1 << 25;
pub(super) const DBECCERR: u32 = 1 << 26;
/// Flags of SR; the bits at the same places in CR enable their interrupts, and those in CCR clear them.
pub(super) const FLAGS: u32 = 0x1FEF_0000;
/// Flags that block programming while set; the others do not (4.8, table 26).
const PROGRAM_ERRORS: u32 = PGSERR | INCERR;

const KEYS: [u32; 2] = [0x4567_0123, 0xCDEF_89AB];

/// Typical durations by PSIZE (x8, x16, x32, x64), ns (DS12930, table "Flash memory programming").
const PROGRAM_NS: [u64; 4] = [290_000, 180_000, 130_000, 100_000];
const ERASE_SECTOR_NS: [u64; 4] = [2_000_000_000, 1_800_000_000, 1_100_000_000, 1_000_000_000];
const ERASE_BANK_NS: [u64; 4] = [13_000_000_000, 8_000_000_000, 6_000_000_000, 5_000_000_000];

enum Step {
    Program([u8; WORD_BYTES]),
    Erase,
}

struct Operation {
    step: Step,
    first: u32,
    words: u32,
    takes_ns: u64,
    /// End of the operation, ns; known once it is the first in the queue.
    ends_ns: u64,
}

/// Bytes written so far of an incomplete flash word.
struct Buffer {
    index: u32,
    bytes: [u8; WORD_BYTES],
    /// Mask with one bit for each written byte.
    written: u32,
}

/// State of one bank.
pub(super) struct Bank {
    /// Number of its first word in the cells.
    base: u32,
    /// First address of the bank on the bus.
    address: u32,
    /// Readout protection blocks all access.
    pub(super) closed: bool,
    pub(super) cr: u32,
    flags: u32,
    /// Number of keys written correctly; `None` after a wrong one, until a reset.
    keys: Option<usize>,
    buffer: Option<Buffer>,
    queue: VecDeque<Operation>,
    /// ECC_FA: word of the first error since the flags were cleared.
    pub(super) fault_word: u32,
}

impl Bank {
    pub(super) fn new(number: u32, address: u32) -> Self {
        Self {
            base: number * BANK_WORDS,
            address,
            closed: false,
            cr: CR_AT_RESET,
            flags: 0,
            keys: Some(0),
            buffer: None,
            queue: VecDeque::new(),
            fault_word: 0,
        }
    }

    pub(super) fn status(&self) -> u32 {
        let busy = if self.queue.is_empty() { 0 } else { BSY | QW };
        self.flags | busy | if self.buffer.is_some() { WBNE } else { 0 }
    }

    pub(super) fn is_locked(&self) -> bool {
        self.cr & LOCK != 0
    }

    pub(super) fn interrupt(&self) -> bool {
        self.flags & self.cr & FLAGS != 0
    }

    pub(super) fn busy_until_ns(&self) -> u64 {
        self.queue.front().map_or(u64::MAX, |operation| operation.ends_ns)
    }

    pub(super) fn write_key(&mut self, key: u32, context: &mut Context<'_>) {
        // The keys must come in their order, and only while the register is locked.
        self.keys = match self.keys {
            Some(given) if self.cr & LOCK != 0 && KEYS.get(given) == Some(&key) => Some(given + 1),
            _ => {
                context.misuse("FLASH", "a wrong key: the registers stay locked until a reset (RM0399, 4.5.1)");
                self.cr |= LOCK;
                None
            }
        };
        if self.keys == Some(KEYS.len()) {
            (self.cr, self.keys) = (self.cr & !LOCK, Some(0));
        }
    }

    pub(super) fn clear(&mut self, flags: u32) {
        self.flags &= !(flags & FLAGS);
    }

    pub(super) fn write_cr(&mut self, value: u32, context: &mut Context<'_>) {
        if self.cr & LOCK != 0 {
            if (value ^ self.cr) & CR_WRITABLE != 0 {
                context.misuse("FLASH", "CR is written while it is locked; the chip ignores it (RM0399, 4.5.1)");
            }
            return;
        }
        const SETTINGS: u32 = 0b11 << 4 | 0b111 << 8;
        if !self.queue.is_empty() && (value ^ self.cr) & SETTINGS != 0 {
            context.misuse("FLASH", "PSIZE or SNB is changed during an operation (FLASH_CR)");
        }
        // START and FW clear themselves.
        self.cr = value & CR_WRITABLE & !(START | FW);
        if value & PG == 0 && self.buffer.is_some() {
            // A word abandoned before it is complete is lost.
            self.buffer = None;
            self.flags |= PGSERR;
        }
        if value & FW != 0 {
            self.force(context.now_ns);
        }
        if value & START != 0 {
            self.start_erase(context.now_ns);
        }
    }

    fn force(&mut self, now_ns: u64) {
        match self.buffer.take() {
            // Unwritten bytes stay all ones.
            Some(buffer) => self.start_program(buffer, now_ns),
            None => self.flags |= PGSERR,
        }
    }

    /// Handles OPTCR.MER, which sets BER and START in both banks (4.3.10).
    pub(super) fn mass_erase(&mut self, now_ns: u64) {
        self.cr |= BER;
        self.start_erase(now_ns);
    }

    /// Starts the erase of a bank for a regression, whatever its lock and flags, with `more_ns` for the option bytes;
    /// returns its end, ns.
    pub(super) fn erase_for_regression(&mut self, now_ns: u64, more_ns: u64) -> u64 {
        let takes_ns = ERASE_BANK_NS[self.parallelism()] + more_ns;
        let (first, words) = (self.base, BANK_WORDS);
        self.buffer = None;
        self.enqueue(Operation { step: Step::Erase, first, words, takes_ns, ends_ns: 0 }, now_ns)
    }

    /// Returns the field PSIZE.
    fn parallelism(&self) -> usize {
        (self.cr >> 4 & 3) as usize
    }

    fn start_erase(&mut self, now_ns: u64) {
        if self.closed {
            self.flags |= WRPERR;
            return;
        }
        let size = self.parallelism();
        let (first, words, takes_ns) = if self.cr & BER != 0 {
            (self.base, BANK_WORDS, ERASE_BANK_NS[size])
        } else if self.cr & SER != 0 {
            (self.base + (self.cr >> 8 & 7) * SECTOR_WORDS, SECTOR_WORDS, ERASE_SECTOR_NS[size])
        } else {
            self.flags |= PGSERR;
            return;
        };
        // Programming and erasing exclude each other, and error flags must be cleared first.
        if self.cr & PG != 0 || self.buffer.is_some() || self.flags & PROGRAM_ERRORS != 0 {
            self.flags |= PGSERR;
            return;
        }
        self.enqueue(Operation { step: Step::Erase, first, words, takes_ns, ends_ns: 0 }, now_ns);
    }

    fn start_program(&mut self, buffer: Buffer, now_ns: u64) {
        let takes_ns = PROGRAM_NS[self.parallelism()];
        let step = Step::Program(buffer.bytes);
        self.enqueue(Operation { step, first: buffer.index, words: 1, takes_ns, ends_ns: 0 }, now_ns);
    }

    /// Queues an operation; returns its end, ns.
    fn enqueue(&mut self, mut operation: Operation, now_ns: u64) -> u64 {
        // Operations run one after another.
        operation.ends_ns = self.queue.back().map_or(now_ns, |last| last.ends_ns) + operation.takes_ns;
        let ends_ns = operation.ends_ns;
        self.queue.push_back(operation);
        ends_ns
    }

    /// Handles a store of the core: `word` in the bank, `at` in the word.
    pub(super) fn store(&mut self, word: u32, at: usize, bytes: &[u8], context: &mut Context<'_>) {
        if self.closed {
            self.flags |= WRPERR;
            return;
        }
        let erasing = self.cr & (SER | BER) != 0;
        if self.cr & LOCK != 0 || self.cr & PG == 0 || erasing || self.flags & PROGRAM_ERRORS != 0 {
            self.flags |= PGSERR;
            return;
        }
        // The queue has room for one operation that runs and one that waits.
        if self.queue.len() > 1 {
            context.misuse(
                "FLASH",
                "a store with the queue full: the bus stands still until there is room, which is not modelled",
            );
        }
        let index = self.base + word;
        let mut buffer = self.buffer.take().unwrap_or(Buffer { index, bytes: [0xFF; WORD_BYTES], written: 0 });
        let mask = ((1_u32 << bytes.len()) - 1) << at;
        // A store to another word before this one is complete is inconsistent.
        if buffer.index != index {
            self.flags |= INCERR;
            return;
        }
        if buffer.written & mask != 0 {
            // The new bytes replace the old ones, with a flag (4.7.4).
            self.flags |= STRBERR;
        }
        buffer.bytes[at..at + bytes.len()].copy_from_slice(bytes);
        buffer.written |= mask;
        if buffer.written == u32::MAX {
            self.start_program(buffer, context.now_ns);
        } else {
            self.buffer = Some(buffer);
        }
    }

    /// Completes the operations that end until now. `Err` if the power failed in a step.
    pub(super) fn advance(
        &mut self,
        cells: &mut dyn FlashCells,
        context: &mut Context<'_>,
    ) -> Result<(), super::PowerLost> {
        while let Some(operation) = self.queue.pop_front_if(|operation| operation.ends_ns <= context.now_ns) {
            match operation.step {
                Step::Program(bytes) => {
                    if cells.word(operation.first) != Word::ERASED {
                        let address = self.address + (operation.first - self.base) * WORD_BYTES as u32;
                        context.misuse("FLASH", format!("the word at {address:#010x} is programmed without having been erased: it becomes unreadable (RM0399, 4.3.9)"));
                    }
                    cells.program(operation.first, &bytes)?;
                }
                Step::Erase => cells.erase(operation.first, operation.words)?,
            }
            self.flags |= EOP;
        }
        Ok(())
    }

    /// Handles a read that readout protection forbids.
    pub(super) fn refuse_read(&mut self, address: u32, context: &mut Context<'_>) {
        if self.flags & RDPERR == 0 {
            let what = format!(
                "{address:#010x} is read at readout protection level 1 while a debugger is or was connected: a bus error (RM0399, 4.5.3)"
            );
            context.misuse("FLASH", what);
        }
        self.flags |= RDPERR;
    }

    /// Sets the flags of an error found by a read, and the address of the first one.
    pub(super) fn note_ecc(&mut self, flag: u32, word: u32) {
        if self.flags & (SNECCERR | DBECCERR) == 0 {
            self.fault_word = word;
        }
        self.flags |= flag;
    }

    /// Resets the bank with the chip; from then on it begins at `address`.
    pub(super) fn reset(&mut self, cells: &mut dyn FlashCells, address: u32) {
        // Only the first operation in the queue has begun.
        if let Some(operation) = self.queue.front() {
            cells.abandon(operation.first, operation.words);
        }
        *self = Self::new(self.base / BANK_WORDS, address);
    }
}
