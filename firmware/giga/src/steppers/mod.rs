//! Step generators: a timer for each axis, and the clock that they share.
//!
//! | | timer | step pin | direction |
//! | --- | --- | --- | --- |
//! | clock | TIM2, 32 bits, runs continuously | | |
//! | axis 0 | TIM12 channel 1 | PH6 | PJ12 |
//! | axis 1 | TIM14 channel 1 | PA7 | PG12 |
//! | axis 2 | TIM15 channel 1 | PE5 | PJ14 |
//! | axis 3 | TIM4 channel 2 | PD13 | PJ15 |
//!
//! All run from 240 MHz through a prescaler of 24, 10 MHz. TIM12 has no DMA request of its own and TIM14 not even a
//! trigger, so all axes work alike, without either: each timer is in PWM mode 1 with preloaded registers and never
//! stops, and [`r4_firmware::motion::generator`] decides what to load into it and when. That module describes the
//! method and its accuracy: pulses within 0.8 µs of their events, fewer than 20 000 interrupts a second and axis,
//! pulses up to 100 kHz. Its only interrupt is channel 1 of the clock, which is set to the next moment at which any
//! axis needs service, in the last period of a stretch. It must come within 8 µs, so it has the highest priority of
//! all, and nothing may disable interrupts for longer.
//!
//! If the processor hangs, pulses continue at the last rate until the watchdog resets it, and with it the timers.

use core::cell::RefCell;

use critical_section::{CriticalSection, Mutex};
use embassy_stm32::{
    Peri,
    gpio::{AfType, AnyPin, Flex, Level, Output, OutputType, Pin, Speed},
    interrupt::{self, InterruptExt, Priority, typelevel},
    pac, peripherals, rcc,
};
use r4_firmware::{
    motion::generator::Generator,
    platform::{StepEvent, Steppers},
};
use static_cell::StaticCell;

mod timers;

use timers::{Axis, PULSE_TICKS};
pub use timers::{Clock, TICK_HZ};

/// Room for the events of 2.5 control periods at 100 kHz, with as many turns of the direction line as may be among
/// them.
const ROOM: usize = 512;

struct Driver {
    generator: Generator<ROOM>,
    axis: Axis,
}

/// Drivers by axis, created in [`MEMORY`], which has no initial value. With the drivers in this static 17 KB of initial
/// values would be in flash.
static DRIVERS: Mutex<RefCell<[Option<&'static mut Driver>; 4]>> = Mutex::new(RefCell::new([const { None }; 4]));
static MEMORY: [StaticCell<Driver>; 4] = [const { StaticCell::new() }; 4];

/// Timers and pins of the steppers, by connector.
pub struct Parts {
    /// Timer of the shared clock.
    #[expect(dead_code, reason = "whoever gives it away cannot use it")]
    pub clock: Peri<'static, peripherals::TIM2>,
    /// Timers of axes 0 to 3.
    #[expect(dead_code, reason = "whoever gives it away cannot use it")]
    pub timers: (
        Peri<'static, peripherals::TIM12>,
        Peri<'static, peripherals::TIM14>,
        Peri<'static, peripherals::TIM15>,
        Peri<'static, peripherals::TIM4>,
    ),
    /// Pins `step0` to `step3`.
    pub steps: (
        Peri<'static, peripherals::PH6>,
        Peri<'static, peripherals::PA7>,
        Peri<'static, peripherals::PE5>,
        Peri<'static, peripherals::PD13>,
    ),
    /// Pins `dir0` to `dir3`; high is positive.
    pub directions: (
        Peri<'static, peripherals::PJ12>,
        Peri<'static, peripherals::PG12>,
        Peri<'static, peripherals::PJ14>,
        Peri<'static, peripherals::PJ15>,
    ),
    /// Pin `step_en` of the carrier.
    pub enable: Peri<'static, peripherals::PK3>,
}

/// Step generators of all axes.
pub struct Generators {
    clock: Clock,
    enable: Flex<'static>,
    _steps: [Flex<'static>; 4],
}

impl Generators {
    /// Starts the timers, with blank periods. The enable line stays an input until [`Steppers::enable`].
    ///
    /// The interrupt [`OnClock`] is enabled at `priority`.
    #[must_use]
    pub fn new(parts: Parts, priority: Priority) -> Self {
        rcc::enable_and_reset::<peripherals::TIM2>();
        rcc::enable_and_reset::<peripherals::TIM12>();
        rcc::enable_and_reset::<peripherals::TIM14>();
        rcc::enable_and_reset::<peripherals::TIM15>();
        rcc::enable_and_reset::<peripherals::TIM4>();
        let (directions, steps) = (parts.directions, parts.steps);
        let direction = |pin: Peri<'static, AnyPin>| Output::new(pin, Level::High, Speed::Low);
        let axes = [
            Axis::on_tim12(direction(directions.0.into())),
            Axis::on_tim14(direction(directions.1.into())),
            Axis::on_tim15(direction(directions.2.into())),
            Axis::on_tim4(direction(directions.3.into())),
        ];
        let clocks = [
            rcc::frequency::<peripherals::TIM12>(),
            rcc::frequency::<peripherals::TIM14>(),
            rcc::frequency::<peripherals::TIM15>(),
            rcc::frequency::<peripherals::TIM4>(),
        ];
        axes.iter().zip(clocks).for_each(|(axis, clock)| axis.prepare(clock.0));
        // From here on the outputs are low.
        let steps = [step_pin(steps.0, 2), step_pin(steps.1, 9), step_pin(steps.2, 4), step_pin(steps.3, 2)];
        let clock = critical_section::with(|cs| {
            let clock = timers::start(rcc::frequency::<peripherals::TIM2>().0, &axes);
            // One after the other, because they are large for the stack.
            for ((driver, memory), axis) in DRIVERS.borrow_ref_mut(cs).iter_mut().zip(&MEMORY).zip(axes) {
                *driver = Some(memory.init_with(|| Driver { generator: Generator::new(0), axis }));
            }
            serve(cs);
            clock
        });
        interrupt::TIM2.set_priority(priority);
        #[allow(unsafe_code, reason = "turns an interrupt on")]
        // SAFETY: its handler shares state through critical sections only.
        unsafe {
            interrupt::TIM2.enable();
        }
        Self { clock, enable: Flex::new(parts.enable), _steps: steps }
    }

    /// Shared clock, for other modules that time events by it.
    #[must_use]
    pub fn clock(&self) -> Clock {
        self.clock
    }

    /// Calls `what` with the driver of `axis`. An earlier service that this may require is set up by
    /// [`Steppers::queued`].
    fn with<R: Default>(axis: u8, what: impl FnOnce(&mut Driver) -> R) -> R {
        critical_section::with(|cs| match DRIVERS.borrow_ref_mut(cs).get_mut(usize::from(axis)) {
            Some(Some(driver)) => what(driver),
            _ => R::default(),
        })
    }
}

fn step_pin(pin: Peri<'static, impl Pin>, function: u8) -> Flex<'static> {
    let mut pin = Flex::new(pin);
    pin.set_as_af_unchecked(function, AfType::output(OutputType::PushPull, Speed::Low));
    pin
}

/// Serves all axes, and sets the clock's compare to the next service.
fn serve(cs: CriticalSection<'_>) {
    let mut drivers = DRIVERS.borrow_ref_mut(cs);
    loop {
        let now = Clock::ticks();
        let wishes = drivers.iter_mut().flatten().map(|driver| driver.generator.serve(&mut driver.axis));
        let ahead = wishes.map(|wish| wish.wrapping_sub(now).cast_signed()).min().unwrap_or(i32::MAX);
        if timers::wake_at(now.wrapping_add_signed(ahead)) {
            return;
        }
    }
}

/// Handler of `TIM2`: the clock's compare, and the captures of [`crate::ranging`].
pub struct OnClock;

impl typelevel::Handler<typelevel::TIM2> for OnClock {
    #[allow(unsafe_code, reason = "the trait's")]
    unsafe fn on_interrupt() {
        critical_section::with(|cs| {
            if pac::TIM2.sr().read().ccif(0) {
                serve(cs);
            }
            crate::ranging::on_capture(cs);
        });
    }
}

impl Steppers for Generators {
    const TICK_HZ: u32 = TICK_HZ;
    const PULSE_TICKS: u32 = PULSE_TICKS;
    /// Latency of 10 µs: the interrupt, after the loads of all other axes.
    const DIRECTION_LATENCY_TICKS: u32 = 100;

    fn now(&mut self) -> u32 {
        self.clock.now()
    }

    fn enable(&mut self, high: bool) {
        self.enable.set_level(high.into());
        self.enable.set_as_output(Speed::Low);
    }

    fn queue(&mut self, axis: u8, events: &[StepEvent]) -> usize {
        Self::with(axis, |driver| driver.generator.queue(events))
    }

    fn queued(&mut self) {
        critical_section::with(serve);
    }

    fn pending(&mut self, axis: u8) -> u32 {
        Self::with(axis, |driver| driver.generator.pending(Clock::ticks()))
    }

    fn position(&mut self, axis: u8) -> i32 {
        Self::with(axis, |driver| driver.generator.position(Clock::ticks()))
    }

    fn stop(&mut self, axis: u8) {
        // No service becomes due earlier by a stop: the compare may then come without work.
        Self::with(axis, |driver| driver.generator.stop(&mut driver.axis));
    }
}
