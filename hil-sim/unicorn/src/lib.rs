//! Unicorn behind the `Core` trait of r4-mcu.
