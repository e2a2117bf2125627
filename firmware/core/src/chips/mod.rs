//! Drivers of the board's chips, on `embedded-hal-async` I2C.

pub mod pca9685;
