//! Fault confinement (Bosch CAN 2.0, part B, chapter 8; RM0399, 59.5.12 and 59.5.13).

use super::registers::{cccr, ir, psr};
use super::{Module, Recovery};

/// Codes of LEC and DLEC.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum LastError {
    None = 0,
    Stuff = 1,
    Form = 2,
    Acknowledge = 3,
    Bit1 = 4,
    Bit0 = 5,
    NoChange = 7,
}

/// Number of sequences of 11 recessive bits after which a bus-off node takes part again (RM0399, 59.5.13; ISO 11898-1
/// has 128).
pub(super) const RECOVERY_SEQUENCES: u32 = 129;

/// State of a bus that is held dominant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Dominant {
    /// The node was sending when it began.
    transmitter: bool,
    /// Time of the next increment of its error counter, ns; `u64::MAX` for none.
    pub(super) next_ns: u64,
}

/// Bits of an error flag, then the dominant bits after it that count as the first error, and as each further one (Bosch
/// CAN 2.0, part B, 8, rule 6).
const FLAG_BITS: u64 = 6;
const FIRST_DOMINANT_BITS: u64 = 14;
const MORE_DOMINANT_BITS: u64 = 8;
/// Bits of error delimiter and intermission, or of bus integration.
const IDLE_BITS: u64 = 11;

/// Error counters and reported states.
#[derive(Clone, Copy, Debug)]
pub(super) struct Errors {
    pub(super) transmit: u32,
    pub(super) receive: u32,
    pub(super) logged: u32,
    pub(super) bus_off: bool,
    pub(super) last: LastError,
    pub(super) last_in_data: LastError,
}

impl Default for Errors {
    fn default() -> Self {
        Self {
            transmit: 0,
            receive: 0,
            logged: 0,
            bus_off: false,
            last: LastError::NoChange,
            last_in_data: LastError::NoChange,
        }
    }
}

impl Errors {
    pub(super) fn passive(&self) -> bool {
        self.transmit >= 128 || self.receive >= 128
    }

    fn warning(&self) -> bool {
        self.transmit >= 96 || self.receive >= 96
    }

    /// Returns the bits BO, EW and EP of PSR.
    pub(super) fn state(&self) -> u32 {
        let flag = |set: bool, bit: u32| if set { bit } else { 0 };
        flag(self.bus_off, psr::BO) | flag(self.warning(), psr::EW) | flag(self.passive(), psr::EP)
    }

    /// Returns ECR without CEL.
    pub(super) fn ecr(&self) -> u32 {
        self.transmit.min(255) | self.receive.min(127) << 8 | u32::from(self.receive >= 128) << 15
    }
}

impl Module {
    /// Changes the error counters, and raises the interrupts of states that change with them.
    pub(super) fn count(&mut self, change: impl FnOnce(&mut Errors)) {
        let before = self.errors.state();
        change(&mut self.errors);
        // Bus-off sets INIT; the recovery begins when the program clears it.
        if self.errors.transmit > 255 && !self.errors.bus_off {
            self.errors.bus_off = true;
            self.enter_init();
        }
        let changed = before ^ self.errors.state();
        for (state, flag) in [(psr::BO, ir::BO), (psr::EW, ir::EW), (psr::EP, ir::EP)] {
            if changed & state != 0 {
                self.raise(flag);
            }
        }
    }

    /// Handles a protocol error: logs it, and counts it unless operation is restricted.
    pub(super) fn protocol_error(&mut self, error: LastError, in_data: bool, change: impl FnOnce(&mut Errors)) {
        if in_data {
            self.errors.last_in_data = error;
            self.raise(ir::PED);
        } else {
            self.errors.last = error;
            self.raise(ir::PEA);
        }
        let (transmit, receive) = (self.errors.transmit, self.errors.receive);
        // In restricted operation TEC and REC stay; only CEL counts.
        if self.on(cccr::ASM) {
            self.log();
            return;
        }
        self.count(change);
        if (self.errors.transmit, self.errors.receive) != (transmit, receive) {
            self.log();
        }
    }

    /// Starts or ends a short that holds the bus dominant.
    pub(super) fn hold_dominant(&mut self, held: bool, now_ns: u64) {
        if held == self.dominant.is_some() {
            return;
        }
        if held {
            // The short destroys the frame on the wire.
            let transmitter = self.transmission.take().is_some();
            let takes_part = self.takes_part(now_ns);
            let next_ns = self.bits_after(now_ns, FLAG_BITS + FIRST_DOMINANT_BITS);
            self.dominant = Some(Dominant { transmitter, next_ns: if takes_part { next_ns } else { u64::MAX } });
            match (takes_part, transmitter) {
                (false, _) => {}
                // A transmitter reads its recessive bit as dominant; a receiver sees more than five equal bits.
                (true, true) => self.protocol_error(LastError::Bit1, false, |errors| errors.transmit += 8),
                (true, false) => {
                    self.protocol_error(LastError::Stuff, false, |errors| {
                        errors.receive = (errors.receive + 1).min(128);
                    });
                }
            }
            return;
        }
        self.dominant = None;
        let idle_ns = self.bits_after(now_ns, IDLE_BITS);
        self.synchronised_ns = self.synchronised_ns.max(idle_ns);
        self.free_ns = self.free_ns.max(idle_ns);
        if let Some(recovery) = &mut self.recovery {
            // Complete sequences still count; the interrupted one does not.
            let seen = u64::from(recovery.seen);
            let recovery = Recovery { since_ns: now_ns, ..*recovery };
            let seen_ns = self.bits_after(now_ns, 11 * seen) - now_ns;
            self.recovery = Some(Recovery { since_ns: now_ns.saturating_sub(seen_ns), ..recovery });
        }
    }

    /// Counts the error of a further run of dominant bits.
    pub(super) fn dominant_bits(&mut self, dominant: Dominant) {
        if dominant.transmitter {
            self.count(|errors| errors.transmit += 8);
        } else {
            self.count(|errors| errors.receive = (errors.receive + 8).min(128));
        }
        // No further event changes a counter at its limit.
        let over = if dominant.transmitter { self.errors.bus_off } else { self.errors.receive >= 128 };
        let next_ns = if over { u64::MAX } else { self.bits_after(dominant.next_ns, MORE_DOMINANT_BITS) };
        self.dominant = Some(Dominant { next_ns, ..dominant });
    }

    fn log(&mut self) {
        // CEL stops at 255; the next error sets ELO.
        if self.errors.logged == 0xFF {
            self.raise(ir::ELO);
        } else {
            self.errors.logged += 1;
        }
    }

    /// Notes a frame without error.
    pub(super) fn no_error(&mut self, in_data: bool) {
        if in_data {
            self.errors.last_in_data = LastError::None;
        } else {
            self.errors.last = LastError::None;
        }
    }

    /// Counts eleven recessive bits after a bus-off.
    pub(super) fn recovery_sequence(&mut self, recovery: Recovery) {
        self.errors.last = LastError::Bit0;
        self.raise(ir::PEA);
        let seen = recovery.seen + 1;
        if seen < RECOVERY_SEQUENCES {
            self.errors.receive = seen.min(127);
            self.recovery = Some(Recovery { seen, ..recovery });
            return;
        }
        self.recovery = None;
        self.count(|errors| {
            errors.bus_off = false;
            errors.transmit = 0;
            errors.receive = 0;
        });
    }
}
