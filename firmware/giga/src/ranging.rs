//! Range sensors: trigger outputs, and the echoes' edges by the steppers' clock.
//!
//! Echoes 0 and 1 are captured by channels 4 and 3 of TIM2, which is the clock of [`crate::steppers`] (10 MHz, 32 bits), on
//! both edges; its interrupt must read a capture before the next edge, and an echo lasts 116 µs at least. Echoes 2 and 3 have
//! no timer: the interrupt of their lines reads the clock, so that their edges are late by its latency.
//!
//! An edge is a level that is not the one before. One that is over before its interrupt (less than the latency, some µs)
//! is none.

use core::cell::RefCell;

use critical_section::{CriticalSection, Mutex};
use embassy_stm32::{
    Peri,
    gpio::{AfType, AnyPin, Flex, Level, Output, Pin, Pull, Speed},
    pac::{self, timer::vals},
    peripherals,
};
use r4_firmware::{
    platform::{EchoState, Ranging},
    sensing::echo::Echo,
};

use crate::steppers::Clock;

/// Ticks of the clock in a µs.
const TICKS_PER_US: u32 = crate::steppers::TICK_HZ / 1_000_000;
/// Capture channels of echoes 0 and 1, counted from 0.
const CHANNELS: [usize; 2] = [3, 2];

static ECHOES: Mutex<RefCell<[Echo; 4]>> = Mutex::new(RefCell::new([Echo::new(false, 0); 4]));

/// Trigger and capture pins, by connector. Echoes 2 and 3 belong to [`crate::encoders::lines`].
pub struct Pins {
    /// `us0_trig`
    pub trigger0: Peri<'static, peripherals::PK4>,
    /// `us1_trig`
    pub trigger1: Peri<'static, peripherals::PK5>,
    /// `us2_trig`
    pub trigger2: Peri<'static, peripherals::PK6>,
    /// `us3_trig`
    pub trigger3: Peri<'static, peripherals::PJ7>,
    /// `us0_echo`
    pub echo0: Peri<'static, peripherals::PA3>,
    /// `us1_echo`
    pub echo1: Peri<'static, peripherals::PA2>,
}

/// The four range sensors.
pub struct Rangers {
    clock: Clock,
    triggers: [Output<'static>; 4],
    _echoes: [Flex<'static>; 2],
}

impl Rangers {
    /// Starts to capture, on the clock that runs already.
    #[must_use]
    pub fn new(pins: Pins, clock: Clock) -> Self {
        let echoes = [echo_pin(pins.echo0), echo_pin(pins.echo1)];
        critical_section::with(|_| {
            pac::TIM2.ccmr_input(1).modify(|w| {
                for channel in CHANNELS {
                    w.set_ccs(channel - 2, vals::CcmrInputCcs::TI4);
                    w.set_icf(channel - 2, vals::FilterValue::FDTS_DIV8_N8);
                }
            });
            pac::TIM2.ccer().modify(|w| {
                for channel in CHANNELS {
                    // Both edges (RM0399, TIMx_CCER: CCxNP and CCxP both set).
                    w.set_ccp(channel, true);
                    w.set_ccnp(channel, true);
                    w.set_cce(channel, true);
                }
            });
            pac::TIM2.dier().modify(|w| CHANNELS.into_iter().for_each(|channel| w.set_ccie(channel, true)));
        });
        let low = |pin: Peri<'static, AnyPin>| Output::new(pin, Level::Low, Speed::Low);
        let triggers = [
            low(pins.trigger0.into()),
            low(pins.trigger1.into()),
            low(pins.trigger2.into()),
            low(pins.trigger3.into()),
        ];
        let mut rangers = Self { clock, triggers, _echoes: echoes };
        (0..4).for_each(|index| rangers.clear(index));
        rangers
    }
}

fn echo_pin(pin: Peri<'static, impl Pin>) -> Flex<'static> {
    let mut pin = Flex::new(pin);
    // An echo without a sensor must not look like one that does not end.
    pin.set_as_af_unchecked(1, AfType::input(Pull::Down));
    pin
}

/// Levels of the four echoes.
fn levels() -> [bool; 4] {
    let (a, i) = (pac::GPIOA.idr().read(), pac::GPIOI.idr().read());
    [a.idr(3), a.idr(2), i.idr(14), i.idr(15)].map(|level| level.to_bits() != 0)
}

/// From the interrupt of TIM2: takes what channels 3 and 4 have captured.
pub(crate) fn on_capture(cs: CriticalSection<'_>) {
    let flags = pac::TIM2.sr().read();
    for (index, channel) in CHANNELS.into_iter().enumerate() {
        if flags.ccif(channel) {
            // Reading the capture clears its flag: an edge after the reading calls again.
            let at = pac::TIM2.ccr(channel).read();
            ECHOES.borrow_ref_mut(cs)[index].level(levels()[index], || at);
        }
    }
}

/// From the interrupt of the echo's line: its level is `high`.
pub(crate) fn on_level(cs: CriticalSection<'_>, index: usize, high: bool) {
    ECHOES.borrow_ref_mut(cs)[index].level(high, || pac::TIM2.cnt().read());
}

impl Ranging for Rangers {
    fn trigger(&mut self, index: u8, high: bool) {
        if let Some(trigger) = self.triggers.get_mut(usize::from(index)) {
            trigger.set_level(high.into());
        }
    }

    fn clear(&mut self, index: u8) {
        let index = usize::from(index);
        critical_section::with(|cs| {
            if let Some(echo) = ECHOES.borrow_ref_mut(cs).get_mut(index) {
                *echo = Echo::new(levels()[index], self.clock.now());
            }
        });
    }

    fn echo(&mut self, index: u8) -> EchoState {
        critical_section::with(|cs| {
            let echoes = ECHOES.borrow_ref(cs);
            echoes.get(usize::from(index)).map_or(EchoState::Idle, |echo| echo.state(self.clock.now(), TICKS_PER_US))
        })
    }
}
