//! Registers of the step generators.

use embassy_stm32::{
    gpio::Output,
    pac::{
        self,
        timer::{TimGp16, vals},
    },
};
use r4_firmware::motion::generator::{IDLE, StepTimer};

/// Frequency of the clock and of all axes, Hz.
pub const TICK_HZ: u32 = 10_000_000;
/// Length of a pulse, ticks: 4 µs.
pub(super) const PULSE_TICKS: u32 = 40;

/// Free-running clock: the counter of TIM2.
#[derive(Clone, Copy)]
pub struct Clock(());

impl Clock {
    /// Present tick at [`TICK_HZ`], wrapping.
    #[must_use]
    pub fn now(self) -> u32 {
        Self::ticks()
    }

    pub(crate) fn ticks() -> u32 {
        pac::TIM2.cnt().read()
    }
}

/// Timer and direction line of one axis.
pub(super) struct Axis {
    timer: TimGp16,
    /// Output channel of the timer, from 0.
    channel: usize,
    direction: Output<'static>,
}

impl Axis {
    pub(super) fn on_tim12(direction: Output<'static>) -> Self {
        Self::new(pac::TIM12.as_ptr(), 0, direction)
    }

    pub(super) fn on_tim14(direction: Output<'static>) -> Self {
        Self::new(pac::TIM14.as_ptr(), 0, direction)
    }

    pub(super) fn on_tim15(direction: Output<'static>) -> Self {
        // A timer with a dead-time generator drives its outputs only with this bit.
        pac::TIM15.bdtr().write(|w| w.set_moe(true));
        Self::new(pac::TIM15.as_ptr(), 0, direction)
    }

    pub(super) fn on_tim4(direction: Output<'static>) -> Self {
        Self::new(pac::TIM4.as_ptr(), 1, direction)
    }

    fn new(timer: *mut (), channel: usize, direction: Output<'static>) -> Self {
        #[allow(unsafe_code, reason = "the small timers have the registers of a general-purpose timer, but fewer")]
        // SAFETY: the address of a timer; CR1, EGR, CCMR1, CCER, PSC, ARR and CCRx of its channels, which are used
        // here, have the same layout in all of them (RM0399).
        let timer = unsafe { TimGp16::from_ptr(timer) };
        Self { timer, channel, direction }
    }

    /// Sets up the timer with blank periods from the start on.
    pub(super) fn prepare(&self, clock_hz: u32) {
        let Self { timer, channel, .. } = self;
        timer.psc().write_value(prescaler(clock_hz));
        self.load(IDLE, false);
        timer.ccmr_output(0).modify(|w| {
            w.set_ocm(*channel, vals::OcmGp::PWM_MODE1);
            w.set_ocpe(*channel, true);
        });
        timer.ccer().modify(|w| w.set_cce(*channel, true));
        timer.cr1().write(|w| w.set_arpe(true));
        timer.egr().write(|w| w.set_ug(true));
    }

    fn load(&self, ticks: u32, pulse: bool) {
        self.timer.arr().write(|w| w.set_arr((ticks - 1) as u16));
        self.timer.ccr(self.channel).write(|w| w.set_ccr(if pulse { PULSE_TICKS as u16 } else { 0 }));
    }
}

impl StepTimer for Axis {
    fn now(&mut self) -> u32 {
        Clock::ticks()
    }

    fn preload(&mut self, ticks: u32, pulse: bool) {
        self.load(ticks, pulse);
    }

    fn turn(&mut self, positive: bool) {
        self.direction.set_level(positive.into());
    }
}

/// Flags UIF, CC1IF to CC4IF, TIF and CC1OF to CC4OF of TIMx_SR.
const FLAGS: u32 = 0x1E5F;

fn prescaler(clock_hz: u32) -> u16 {
    (clock_hz / TICK_HZ - 1) as u16
}

/// Starts the clock at 0 and the axes after it, each a few bus cycles after the other, far less than
/// [`r4_firmware::motion::generator::AFTER`]. Interrupts must be off.
pub(super) fn start(clock_hz: u32, axes: &[Axis; 4]) -> Clock {
    pac::TIM2.psc().write_value(prescaler(clock_hz));
    pac::TIM2.arr().write_value(u32::MAX);
    pac::TIM2.egr().write(|w| w.set_ug(true));
    pac::TIM2.dier().modify(|w| w.set_ccie(0, true));
    pac::TIM2.cr1().write(|w| w.set_cen(true));
    for axis in axes {
        axis.timer.cr1().write(|w| {
            w.set_arpe(true);
            w.set_cen(true);
        });
    }
    Clock(())
}

/// Sets the tick of the clock's next interrupt. Returns false if that is already past: the interrupt then does not
/// come.
pub(super) fn wake_at(tick: u32) -> bool {
    pac::TIM2.ccr(0).write_value(tick);
    // Other flags stay unchanged: writing 1 does nothing (RM0399, TIMx_SR: rc_w0).
    pac::TIM2.sr().write(|w| {
        w.0 = FLAGS;
        w.set_ccif(0, false);
    });
    tick.wrapping_sub(Clock::ticks()).cast_signed() > 0
}
