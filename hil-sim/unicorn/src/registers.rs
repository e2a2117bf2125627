//! Register names in Unicorn.

use r4_mcu::cpu::Register;
use unicorn_engine::RegisterARM;

/// Number of a register in Unicorn.
pub(crate) fn number(register: Register) -> i32 {
    let first = |register: RegisterARM, index: u8| i32::from(register) + i32::from(index);
    match register {
        Register::R(index) => first(RegisterARM::R0, index.min(12)),
        Register::S(index) => first(RegisterARM::S0, index.min(31)),
        Register::Sp => RegisterARM::SP.into(),
        Register::Lr => RegisterARM::LR.into(),
        Register::Pc => RegisterARM::PC.into(),
        Register::Msp => RegisterARM::MSP.into(),
        Register::Psp => RegisterARM::PSP.into(),
        Register::Xpsr => RegisterARM::XPSR.into(),
        Register::Primask => RegisterARM::PRIMASK.into(),
        Register::Basepri => RegisterARM::BASEPRI.into(),
        Register::Faultmask => RegisterARM::FAULTMASK.into(),
        Register::Control => RegisterARM::CONTROL.into(),
        Register::Fpscr => RegisterARM::FPSCR.into(),
    }
}
