//! Register addresses and bits (NXP PCA9685 datasheet, rev. 4, section 7.3).

/// Mode register 1 (7.3.1).
pub(super) const MODE1: u8 = 0x00;
/// Mode register 2 (7.3.2).
pub(super) const MODE2: u8 = 0x01;
/// Sub-addresses 1 to 3 (7.3.6): `SUBADR1..=SUBADR3`.
pub(super) const SUBADR1: u8 = 0x02;
/// Sub-address 3, the last of the three.
pub(super) const SUBADR3: u8 = 0x04;
/// LED All Call address (7.3.7).
pub(super) const ALLCALLADR: u8 = 0x05;
/// First of the four registers of each output, ON_L, ON_H, OFF_L, OFF_H (7.3.3).
pub(super) const LED0_ON_L: u8 = 0x06;
/// Last register of the last output.
pub(super) const LED15_OFF_H: u8 = 0x45;
/// First of the four registers that load all outputs at once; they read as 0 (7.3.4).
pub(super) const ALL_LED_ON_L: u8 = 0xFA;
/// Last of the four registers that load all outputs.
pub(super) const ALL_LED_OFF_H: u8 = 0xFD;
/// PWM prescaler (7.3.5); writable only while asleep.
pub(super) const PRE_SCALE: u8 = 0xFE;
/// Reserved (table 4, note 2).
pub(super) const TEST_MODE: u8 = 0xFF;

/// Bits of MODE1. Power-on: asleep, answers All Call.
pub(super) mod mode1 {
    /// Reads 1 if channels were running when put to sleep; writing 1 runs them again (7.3.1.1).
    pub(in super::super) const RESTART: u8 = 0x80;
    /// Clock from the EXTCLK pin; cannot be cleared except by a reset.
    pub(in super::super) const EXTCLK: u8 = 0x40;
    /// Register pointer increments after every byte.
    pub(in super::super) const AI: u8 = 0x20;
    /// Sleep mode: oscillator off.
    pub(in super::super) const SLEEP: u8 = 0x10;
    /// Answers to SUBADR1; the next two bits down are SUB2 and SUB3.
    pub(in super::super) const SUB1: u8 = 0x08;
    /// Answers to the address in ALLCALLADR.
    pub(in super::super) const ALLCALL: u8 = 0x01;
    /// Bits that a write sets directly; RESTART and EXTCLK have rules of their own.
    pub(in super::super) const PLAIN: u8 = 0x3F;
    /// Power-on value of MODE1.
    pub(in super::super) const RESET: u8 = 0x11;
}

/// Bits of MODE2. Power-on: totem pole, outputs low while OE is high.
pub(super) mod mode2 {
    /// Inverts the outputs while OE is low.
    pub(in super::super) const INVRT: u8 = 0x10;
    /// Outputs change on ACK (all four registers of a channel) instead of on STOP.
    pub(in super::super) const OCH: u8 = 0x08;
    /// Totem pole; 0 is open drain.
    pub(in super::super) const OUTDRV: u8 = 0x04;
    /// State of the outputs while OE is high (7.4, table 11).
    pub(in super::super) const OUTNE: u8 = 0x03;
    /// Writable bits; bits 7 to 5 are read-only.
    pub(in super::super) const WRITABLE: u8 = 0x1F;
    /// Power-on value of MODE2.
    pub(in super::super) const RESET: u8 = 0x04;
}

/// Power-on sub-addresses, as the registers hold them: address in the 7 upper bits (7.3.6).
pub(super) const SUBADR_RESET: [u8; 3] = [0xE2, 0xE4, 0xE8];
/// Power-on All Call address (7.3.7).
pub(super) const ALLCALLADR_RESET: u8 = 0xE0;
/// Writable bits of the address registers; bit 0 is read-only 0.
pub(super) const ADDRESS_WRITABLE: u8 = 0xFE;
/// Power-on ON_L, ON_H, OFF_L, OFF_H of every output: full OFF (7.3.3).
pub(super) const LED_RESET: [u8; 4] = [0x00, 0x00, 0x00, 0x10];
/// Writable bits of ON_L, ON_H, OFF_L, OFF_H.
pub(super) const LED_WRITABLE: [u8; 4] = [0xFF, 0x1F, 0xFF, 0x1F];
/// Full ON or full OFF bit, in the 13 bits of an ON or OFF pair.
pub(super) const FULL: u16 = 0x1000;
/// Count bits, in the 13 bits of an ON or OFF pair.
pub(super) const COUNT: u16 = 0x0FFF;
/// Power-on prescaler: 197 Hz from 25 MHz (7.3.5).
pub(super) const PRE_SCALE_RESET: u8 = 0x1E;
/// Smallest prescaler; the hardware raises smaller values to it (7.3.5).
pub(super) const PRE_SCALE_MIN: u8 = 3;
/// Only data byte of a general call that the chip acknowledges: software reset (7.6).
pub(super) const SOFTWARE_RESET: u8 = 0x06;
/// Start-up time of the oscillator after SLEEP is cleared, ns (7.3.1, note to SLEEP).
pub(super) const OSCILLATOR_START_NS: u64 = 500_000;

/// True if the chip acknowledges `register` as a pointer.
pub(super) const fn exists(register: u8) -> bool {
    register <= LED15_OFF_H || register >= ALL_LED_ON_L
}

/// Next pointer after an auto-increment from `register` (remark below table 4): 45h and FEh wrap to 00h.
pub(super) const fn after(register: u8) -> u8 {
    match register {
        LED15_OFF_H | PRE_SCALE | TEST_MODE => MODE1,
        other => other + 1,
    }
}
