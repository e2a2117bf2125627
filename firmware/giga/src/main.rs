//! The R4 firmware on the Arduino Giga R1, for the Cortex-M7 of its STM32H747.
//!
//! All decisions are in `r4-firmware`; this crate provides its pins, clocks, interrupts and drivers.
//!
//! | module | subject |
//! | --- | --- |
//! | `boot` | from reset to running tasks, in order |
//! | `executors` | interrupt priorities, in one table |
//! | `sweep`, `hold` | outputs made safe right after the reset, and held so after repeated bad starts |
//! | `image` | check of the image in flash |
//! | `cycles` | time by the cycle counter, before there is a clock |
//! | `clocks` | the clock tree, with and without crystal |
//! | `pins` | the carrier's pins, from its file |
//! | `safety_pins` | the lines that stop the board without a bus |
//! | `guard` | no access at address 0, nor at the stack's end |
//! | `supply` | the processor's own supply, and its brown-out level |
//! | `watchdog` | IWDG1, fed by the supervisor alone |
//! | `reset`, `panic` | cause of the start; record that a failed run leaves |
//! | `i2c` | the three I2C buses, and freeing them |
//! | `links` | byte links to hosts, and the UART connectors |
//! | `peripherals` | counters, converters, pulses for the control loop |
//! | `encoders`, `steppers`, `ranging`, `analog`, `switches` | its parts |
//! | `flash`, `bus_faults` | storage of parameters and trips; reads that may fail |
//! | `tcm` | code and data in the memories that are as fast as the processor |
//! | `log` | log of defmt, for probes and hosts |
#![no_std]
#![no_main]

mod analog;
mod boot;
mod bus_faults;
mod clocks;
mod cycles;
mod encoders;
mod executors;
mod flash;
mod guard;
mod hold;
mod i2c;
mod image;
mod links;
mod log;
mod panic;
mod peripherals;
mod pins;
mod ranging;
mod reset;
mod safety_pins;
mod steppers;
mod supply;
mod sweep;
mod switches;
mod tcm;
mod watchdog;

use cortex_m_rt::entry;

#[entry]
fn main() -> ! {
    // Bridges off before the memories are filled, which takes tens of thousands of instructions; `claim` and its
    // callees lie in flash.
    safety_pins::claim();
    // Before any code or data in the tightly coupled memories is used.
    tcm::load();
    boot::run()
}
