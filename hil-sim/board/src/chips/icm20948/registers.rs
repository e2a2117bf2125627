//! Register map (section 7): the registers of modelled functions, and those that only store writes.

/// One bank of registers.
pub(super) type Bank = [u8; 128];

/// Access of the bus to a register.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Access {
    /// Read-only: writes are reported.
    Read,
    /// Readable and writable register.
    Write,
}

/// Registers of all banks after power-up: those of section 7 that are not 0.
pub(super) const RESET: [Bank; 4] = {
    let mut banks = [[0; 128]; 4];
    // LP_CONFIG; PWR_MGMT_1: asleep, on the best clock.
    banks[0][0x05] = 0x40;
    banks[0][0x06] = 0x41;
    // GYRO_CONFIG_1 and ACCEL_CONFIG: the filter is on. ODR_ALIGN_EN and others are 0.
    banks[2][0x01] = 0x01;
    banks[2][0x14] = 0x01;
    banks
};

/// Access to an address; `None` for an address without a register.
pub(super) const fn access(bank: usize, register: u8) -> Option<Access> {
    match (bank, register) {
        // WHO_AM_I, I2C_MST_STATUS to INT_STATUS_3, DELAY_TIMEH and L, ACCEL_XOUT_H to EXT_SLV_SENS_DATA_23, FIFO_COUNT, DATA_RDY_STATUS.
        (0, 0x00 | 0x17 | 0x19..=0x1C | 0x28 | 0x29 | 0x2D..=0x52 | 0x70 | 0x71 | 0x74) => Some(Access::Read),
        // USER_CTRL, LP_CONFIG, PWR_MGMT_1 and 2, INT_PIN_CFG, INT_ENABLE to INT_ENABLE_3, FIFO_EN_1 and 2, FIFO_RST, FIFO_MODE, FIFO_R_W,
        // FIFO_CFG.
        (0, 0x03 | 0x05..=0x07 | 0x0F..=0x13 | 0x66..=0x69 | 0x72 | 0x76) => Some(Access::Write),
        // Self-test, accelerometer offsets, TIMEBASE_CORRECTION_PLL.
        (1, 0x02..=0x04 | 0x0E..=0x10 | 0x14 | 0x15 | 0x17 | 0x18 | 0x1A | 0x1B | 0x28) => Some(Access::Write),
        // GYRO_SMPLRT_DIV, GYRO_CONFIG_1 and 2, gyroscope offsets, ODR_ALIGN_EN, ACCEL_SMPLRT_DIV_1 and 2, ACCEL_INTEL_CTRL,
        // ACCEL_WOM_THR, ACCEL_CONFIG, ACCEL_CONFIG_2, FSYNC_CONFIG, TEMP_CONFIG, MOD_CTRL_USR.
        (2, 0x00..=0x09 | 0x10..=0x15 | 0x52..=0x54) => Some(Access::Write),
        // The auxiliary bus.
        (3, 0x00..=0x16) => Some(Access::Write),
        _ => None,
    }
}
