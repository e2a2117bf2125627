//! Interrupt priorities of the whole firmware, and the executors that run the tasks.
//!
//! Of 16 levels, 0 interrupts all others:
//!
//! | level | runs | why there |
//! | --- | --- | --- |
//! | 0 | TIM2: step pulses, echoes 0 and 1 | must come within 8 us |
//! | 1 | encoder 3, echoes 2 and 3; TIM5: embassy's time; EXTI9_5: the dead-man's handle; index pulses | edges are 20 us apart, and a line with more than 100 in a ms is masked, index pulses after one per period; a wait must end, and a released handle be seen, whatever task runs |
//! | 2 | supervisor | must run when everything else is late |
//! | 3 | I2C2: the next transfer of the control loop, and the end of the last; DMA; CAN: three frames fill its memory, in 0.2 ms | only begins, wakes and copies |
//! | 4 | control, ranging | 1 kHz |
//! | 6 | UARTs, I2C1, I2C4, USB | only wakes and copies |
//! | 8 | links, passthrough, storage | as long as a request takes |
//! | 10 | USB: its device and its link | waits for the block's own flags, without bound: the other links must not wait with it |
//! | thread | screen | blocks for 230 ms |
//!
//! An interrupt executor needs a vector of its own: those of the SAIs, whose pins the carrier uses for other things.

use core::sync::atomic::{AtomicU32, Ordering};

use cortex_m::peripheral::DWT;
use embassy_executor::{InterruptExecutor, SendSpawner};
use embassy_stm32::interrupt::{self, InterruptExt, Priority};

/// Priority of step pulses.
pub(crate) const STEPS: Priority = Priority::P0;
/// Priority of the interrupts of edges and of time. Those of lines must not interrupt each other: all change the lines'
/// masks.
pub(crate) const EDGES: Priority = Priority::P1;
const SUPERVISOR: Priority = Priority::P2;
/// Priority of the interrupts that end transfers of the control loop. embassy sets those of DMA itself.
pub(crate) const TRANSFERS: Priority = Priority::P3;
const CONTROL: Priority = Priority::P4;
/// Priority of the interrupts of the links to hosts.
const TALK: Priority = Priority::P6;
const LINKS: Priority = Priority::P8;
const USB: Priority = Priority::P10;

static SUPERVISOR_EXECUTOR: InterruptExecutor = InterruptExecutor::new();
static CONTROL_EXECUTOR: InterruptExecutor = InterruptExecutor::new();
static LINK_EXECUTOR: InterruptExecutor = InterruptExecutor::new();
static USB_EXECUTOR: InterruptExecutor = InterruptExecutor::new();

/// Spawners of the executors, by urgency.
pub(crate) struct Executors {
    /// Executor of the supervisor alone.
    pub(crate) supervisor: SendSpawner,
    /// Executor of control and ranging.
    pub(crate) control: SendSpawner,
    /// Executor of the links to hosts, and of storage.
    pub(crate) links: SendSpawner,
    /// Executor of USB alone.
    pub(crate) usb: SendSpawner,
}

/// Sets every priority. Must run before any driver enables its interrupt.
pub(crate) fn prioritise() {
    for (priority, interrupts) in [
        (STEPS, &[interrupt::TIM2][..]),
        (
            EDGES,
            &[
                interrupt::TIM5,
                interrupt::EXTI0,
                interrupt::EXTI1,
                interrupt::EXTI2,
                interrupt::EXTI9_5,
                interrupt::EXTI15_10,
            ],
        ),
        (SUPERVISOR, &[interrupt::SAI1]),
        (
            TRANSFERS,
            &[interrupt::I2C2_EV, interrupt::I2C2_ER, interrupt::TIM7, interrupt::FDCAN2_IT0, interrupt::FDCAN2_IT1],
        ),
        (CONTROL, &[interrupt::SAI2]),
        (
            TALK,
            &[
                interrupt::USART1,
                interrupt::USART2,
                interrupt::UART4,
                interrupt::I2C1_EV,
                interrupt::I2C1_ER,
                interrupt::I2C4_EV,
                interrupt::I2C4_ER,
                interrupt::OTG_FS,
                interrupt::FLASH,
            ],
        ),
        (LINKS, &[interrupt::SAI3]),
        (USB, &[interrupt::SAI4]),
    ] {
        interrupts.iter().for_each(|interrupt| interrupt.set_priority(priority));
    }
}

/// Starts the interrupt executors. Call it once, after [`prioritise`].
pub(crate) fn start() -> Executors {
    Executors {
        supervisor: SUPERVISOR_EXECUTOR.start(interrupt::SAI1),
        control: CONTROL_EXECUTOR.start(interrupt::SAI2),
        links: LINK_EXECUTOR.start(interrupt::SAI3),
        usb: USB_EXECUTOR.start(interrupt::SAI4),
    }
}

/// Processor cycles of the control task's executor, wrapping.
static CONTROL_CYCLES: AtomicU32 = AtomicU32::new(0);

/// Cycles of the control task's executor until it was last entered, interrupts included.
pub(crate) fn control_cycles() -> u32 {
    CONTROL_CYCLES.load(Ordering::Relaxed)
}

#[allow(unsafe_code, reason = "an interrupt handler is called by its name")]
#[unsafe(no_mangle)]
extern "C" fn SAI2() {
    let begin = DWT::cycle_count();
    // SAFETY: this is the interrupt's handler and nothing else calls it; the interrupt is enabled by `start`, which
    // creates the executor first.
    unsafe { CONTROL_EXECUTOR.on_interrupt() }
    // No other code writes the counter.
    let taken = DWT::cycle_count().wrapping_sub(begin);
    CONTROL_CYCLES.store(control_cycles().wrapping_add(taken), Ordering::Relaxed);
}

macro_rules! executor_interrupt {
    ($vector:ident, $executor:ident) => {
        #[allow(unsafe_code, reason = "an interrupt handler is called by its name")]
        #[unsafe(no_mangle)]
        extern "C" fn $vector() {
            // SAFETY: this is the interrupt's handler and nothing else calls it; the interrupt is enabled by `start`,
            // which creates the executor first.
            unsafe { $executor.on_interrupt() }
        }
    };
}

executor_interrupt!(SAI1, SUPERVISOR_EXECUTOR);
executor_interrupt!(SAI3, LINK_EXECUTOR);
executor_interrupt!(SAI4, USB_EXECUTOR);
