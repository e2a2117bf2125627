//! PCA9685 register addresses and bits (NXP PCA9685 datasheet rev. 4, section 7.3).

/// Mode register 1 (7.3.1).
pub(super) const MODE1: u8 = 0x00;
/// Mode register 2 (7.3.2).
pub(super) const MODE2: u8 = 0x01;
/// `LED0_ON_L`, the first of four registers of output 0; output n follows at `4 n` (7.3.3).
pub(super) const LED0_ON_L: u8 = 0x06;
/// `ALL_LED_ON_L`, the first of four registers that are written to all 16 outputs at once (7.3.4).
pub(super) const ALL_LED_ON_L: u8 = 0xFA;
/// `ALL_LED_OFF_H`, the last of these four registers.
pub(super) const ALL_LED_OFF_H: u8 = 0xFD;
/// PWM prescaler (7.3.5); written only while `MODE1_SLEEP` is set.
pub(super) const PRE_SCALE: u8 = 0xFE;

/// Register pointer increments after each byte.
pub(super) const MODE1_AI: u8 = 1 << 5;
/// Sleep mode: the oscillator is off.
pub(super) const MODE1_SLEEP: u8 = 1 << 4;
/// The chip also answers the All Call address.
pub(super) const MODE1_ALLCALL: u8 = 1 << 0;
/// Outputs are totem pole, not open drain; changes take effect on STOP.
pub(super) const MODE2_OUTDRV: u8 = 1 << 2;
/// Bit 4 of `LEDn_ON_H` and `LEDn_OFF_H`: always on, always off. Off wins.
pub(super) const FULL: u8 = 1 << 4;
