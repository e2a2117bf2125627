//! Registers that the checks use, and the special ones of the core.

use core::arch::asm;

pub(crate) const SYST_CSR: u32 = 0xE000_E010;
pub(crate) const SYST_RVR: u32 = 0xE000_E014;
pub(crate) const SYST_CVR: u32 = 0xE000_E018;
pub(crate) const NVIC_ISER: u32 = 0xE000_E100;
pub(crate) const NVIC_ICER: u32 = 0xE000_E180;
pub(crate) const NVIC_ISPR: u32 = 0xE000_E200;
pub(crate) const NVIC_ICPR: u32 = 0xE000_E280;
pub(crate) const NVIC_IABR: u32 = 0xE000_E300;
pub(crate) const NVIC_IPR: u32 = 0xE000_E400;
pub(crate) const ICSR: u32 = 0xE000_ED04;
pub(crate) const VTOR: u32 = 0xE000_ED08;
pub(crate) const AIRCR: u32 = 0xE000_ED0C;
pub(crate) const SHPR: u32 = 0xE000_ED18;
pub(crate) const SHCSR: u32 = 0xE000_ED24;
pub(crate) const CFSR: u32 = 0xE000_ED28;
pub(crate) const HFSR: u32 = 0xE000_ED2C;
pub(crate) const BFAR: u32 = 0xE000_ED38;
pub(crate) const STIR: u32 = 0xE000_EF00;

pub(crate) const PEND_SV: u32 = 1 << 28;

pub(crate) fn read(address: u32) -> u32 {
    // SAFETY: the constants above are registers of the processor.
    unsafe { (address as *const u32).read_volatile() }
}

pub(crate) fn write(address: u32, value: u32) {
    // SAFETY: as for `read`; the effect of the writes is the subject of the checks.
    unsafe { (address as *mut u32).write_volatile(value) }
}

/// Writes a byte of IPR or SHPR.
pub(crate) fn write_byte(address: u32, value: u8) {
    // SAFETY: as for `write`.
    unsafe { (address as *mut u8).write_volatile(value) }
}

pub(crate) fn read_byte(address: u32) -> u8 {
    // SAFETY: as for `read`.
    unsafe { (address as *const u8).read_volatile() }
}

/// Waits until earlier writes have taken effect (B2.8, A3.7.3).
pub(crate) fn barrier() {
    // SAFETY: affects only the order of accesses.
    unsafe { asm!("dsb", "isb") }
}

macro_rules! special {
    ($read:ident, $write:ident, $name:literal) => {
        #[allow(dead_code)]
        pub(crate) fn $read() -> u32 {
            let value;
            // SAFETY: only reads a register.
            unsafe { asm!(concat!("mrs {}, ", $name), out(reg) value) };
            value
        }
        #[allow(dead_code)]
        pub(crate) fn $write(value: u32) {
            // SAFETY: the effect of the write is the subject of the checks.
            unsafe { asm!(concat!("msr ", $name, ", {}"), "isb", in(reg) value) }
        }
    };
}

special!(primask, set_primask, "PRIMASK");
special!(basepri, set_basepri, "BASEPRI");
special!(basepri_max, set_basepri_max, "BASEPRI_MAX");
special!(faultmask, set_faultmask, "FAULTMASK");
special!(control, set_control, "CONTROL");
special!(ipsr, set_ipsr, "IPSR");

/// Enables an interrupt with a priority.
pub(crate) fn enable(irq: u32, priority: u8) {
    write_byte(NVIC_IPR + irq, priority);
    write(NVIC_ISER, 1 << irq);
}

/// Makes interrupts pending, a bit each.
pub(crate) fn pend(irqs: u32) {
    write(NVIC_ISPR, irqs);
    barrier();
}
