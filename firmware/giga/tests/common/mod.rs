//! Common start of all tests: outputs off, then the clocks as in the firmware.

use core::{
    mem::MaybeUninit,
    sync::atomic::{AtomicBool, Ordering},
};

use defmt_rtt as _;
use embassy_stm32::{Peripherals, SharedData};
use embassy_time::Instant;

use crate::{clocks, cycles, safety_pins};

#[allow(unsafe_code, reason = "a section is chosen by an unsafe attribute")]
// SAFETY: the section is in SRAM4, which is always clocked and may hold any data.
#[unsafe(link_section = ".sram4.shared")]
static EMBASSY: MaybeUninit<SharedData> = MaybeUninit::uninit();

/// True once the time driver runs; earlier log lines have no time.
static CLOCK_RUNS: AtomicBool = AtomicBool::new(false);

defmt::timestamp!("{=u64:us}", if CLOCK_RUNS.load(Ordering::Relaxed) { Instant::now().as_micros() } else { 0 });

/// Holds every bridge off, and starts the clocks. The watchdog stays off: a debugger halts the processor in a test.
pub(crate) fn start() -> (Peripherals, clocks::Source) {
    safety_pins::claim();
    if let Some(mut core) = cortex_m::Peripherals::take() {
        cycles::start(&mut core.DCB, &mut core.DWT);
    }
    let source = clocks::probe();
    let mut config = embassy_stm32::Config::default();
    config.rcc = clocks::config(source);
    let peripherals = embassy_stm32::init_primary(config, &EMBASSY);
    CLOCK_RUNS.store(true, Ordering::Relaxed);
    (peripherals, source)
}
