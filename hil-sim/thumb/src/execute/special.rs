//! Execution of accesses to special registers (DDI0403E B5.2).

use crate::state::{FLOAT_ACTIVE, PROCESS_STACK, State, priority};

/// Bit CONTROL.nPRIV: thread mode is unprivileged.
const UNPRIVILEGED: u32 = 1;
/// Exceptions with negative priority: NMI and HardFault.
const NEGATIVE: [u16; 2] = [2, 3];

/// Numbers of special registers in MRS and MSR.
mod number {
    pub(super) const MSP: u8 = 8;
    pub(super) const PSP: u8 = 9;
    pub(super) const PRIMASK: u8 = 16;
    pub(super) const BASEPRI: u8 = 17;
    pub(super) const BASEPRI_MAX: u8 = 18;
    pub(super) const FAULTMASK: u8 = 19;
    pub(super) const CONTROL: u8 = 20;
}

impl State {
    /// Reads a special register, as MRS does (B5.2.2).
    pub(super) fn special(&self, special: u8) -> u32 {
        let privileged = self.is_privileged();
        match special {
            // EPSR reads as zero.
            0..=7 => {
                let exception = if special & 1 != 0 && privileged { self.exception.into() } else { 0 };
                exception | if special & 4 == 0 { self.apsr() } else { 0 }
            }
            number::CONTROL => self.control,
            _ if !privileged => 0,
            number::MSP => self.stack(false),
            number::PSP => self.stack(true),
            number::PRIMASK => self.primask,
            number::BASEPRI | number::BASEPRI_MAX => self.basepri,
            number::FAULTMASK => self.faultmask,
            _ => 0,
        }
    }

    /// Writes a special register, as MSR does (B5.2.3).
    pub(super) fn set_special(&mut self, special: u8, mask: u8, value: u32) {
        match special {
            0..=3 => {
                if mask & 2 != 0 {
                    self.flags.set_nzcv(value >> 28);
                    self.q = value >> 27 & 1 != 0;
                }
                if mask & 1 != 0 {
                    self.ge = (value >> 16 & 15) as u8;
                }
            }
            _ if !self.is_privileged() => {}
            number::CONTROL => {
                // Only thread mode can select the stack.
                let stack = if self.exception == 0 { PROCESS_STACK } else { 0 };
                let allowed = UNPRIVILEGED | FLOAT_ACTIVE | stack;
                self.set_control(self.control & !allowed | value & allowed);
            }
            number::MSP => self.set_stack(false, value),
            number::PSP => self.set_stack(true, value),
            number::PRIMASK => self.primask = value & 1,
            number::BASEPRI => self.basepri = priority(value),
            // BASEPRI_MAX only raises the priority: a lower number, or any while BASEPRI is 0 (off).
            number::BASEPRI_MAX => {
                let value = priority(value);
                if value != 0 && (value < self.basepri || self.basepri == 0) {
                    self.basepri = value;
                }
            }
            number::FAULTMASK => self.set_faultmask(value & 1),
            _ => {}
        }
    }

    fn set_faultmask(&mut self, value: u32) {
        // NMI and HardFault run at negative priority, where FAULTMASK cannot be set (B5.2.3).
        if value == 0 || !NEGATIVE.contains(&self.exception) {
            self.faultmask = value;
        }
    }

    /// Executes CPS (B5.2.1): bit 0 of `what` is FAULTMASK, bit 1 PRIMASK.
    pub(super) fn change_masks(&mut self, disable: bool, what: u8) {
        if !self.is_privileged() {
            return;
        }
        if what & 2 != 0 {
            self.primask = disable.into();
        }
        if what & 1 != 0 {
            self.set_faultmask(disable.into());
        }
    }
}
