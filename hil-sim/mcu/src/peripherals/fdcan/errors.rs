//! Fault confinement (Bosch CAN 2.0, part B, chapter 8; RM0399, 59.5.12 and 59.5.13).

use super::registers::{cccr, ir, psr};
use super::{Module, Recovery};

/// LEC and DLEC.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum LastError {
    None = 0,
    Form = 2,
    Acknowledge = 3,
    Bit0 = 5,
    NoChange = 7,
}

/// Sequences of 11 recessive bits after which a bus-off node takes part again (RM0399, 59.5.13; ISO 11898-1 has 128).
pub(super) const RECOVERY_SEQUENCES: u32 = 129;

/// Counters and what the host was told.
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

    /// BO, EW and EP of PSR.
    pub(super) fn state(&self) -> u32 {
        let flag = |set: bool, bit: u32| if set { bit } else { 0 };
        flag(self.bus_off, psr::BO) | flag(self.warning(), psr::EW) | flag(self.passive(), psr::EP)
    }

    /// ECR without CEL.
    pub(super) fn ecr(&self) -> u32 {
        self.transmit.min(255) | self.receive.min(127) << 8 | u32::from(self.receive >= 128) << 15
    }
}

impl Module {
    /// Changes the counters, and tells of states that change with them.
    pub(super) fn count(&mut self, change: impl FnOnce(&mut Errors)) {
        let before = self.errors.state();
        change(&mut self.errors);
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

    /// A protocol error: logged, counted unless operation is restricted.
    pub(super) fn protocol_error(&mut self, error: LastError, in_data: bool, change: impl FnOnce(&mut Errors)) {
        if in_data {
            self.errors.last_in_data = error;
            self.raise(ir::PED);
        } else {
            self.errors.last = error;
            self.raise(ir::PEA);
        }
        let (transmit, receive) = (self.errors.transmit, self.errors.receive);
        if self.on(cccr::ASM) {
            self.log();
            return;
        }
        self.count(change);
        if (self.errors.transmit, self.errors.receive) != (transmit, receive) {
            self.log();
        }
    }

    fn log(&mut self) {
        if self.errors.logged == 0xFF {
            self.raise(ir::ELO);
        } else {
            self.errors.logged += 1;
        }
    }

    /// A frame has passed without error.
    pub(super) fn no_error(&mut self, in_data: bool) {
        if in_data {
            self.errors.last_in_data = LastError::None;
        } else {
            self.errors.last = LastError::None;
        }
    }

    /// Eleven recessive bits have passed after a bus-off.
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
