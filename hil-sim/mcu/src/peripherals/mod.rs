//! The peripherals, one module each.
