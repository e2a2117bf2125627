//! Range sensors: trigger outputs, and the echoes' edges timed by the steppers' clock.
//!
//! Channels 4 and 3 of TIM2, which is the clock of [`crate::steppers`] (10 MHz, 32 bits), capture echoes 0 and 1 on
//! both edges; its interrupt must read a capture before the next edge, and an echo lasts at least 116 µs. Echoes 2 and
//! 3 have no timer: the interrupt of their lines reads the clock, so that their edges are late by its latency.
//!
//! An edge is a level that differs from the previous one. A pulse that is over before its interrupt (less than the
//! latency, some µs) is not seen.
//!
//! The interrupts of all echoes are above the supervisor, so each has an [`EdgeBudget`]; an unused echo is not
//! captured.

use core::{
    cell::RefCell,
    sync::atomic::{AtomicBool, Ordering},
};

use critical_section::{CriticalSection, Mutex};
use embassy_stm32::{
    Peri,
    gpio::{AfType, AnyPin, Flex, Level, Output, Pin, Pull, Speed},
    pac::{self, timer::vals},
    peripherals,
};
use r4_firmware::{
    platform::{EchoState, Pulse, Ranging},
    sensing::{
        echo::Echo,
        storm::{ECHO_EDGES_PER_MS, EdgeBudget},
    },
};

use crate::{
    encoders::lines,
    steppers::{self, Clock},
};

/// Ticks of the clock per µs.
const TICKS_PER_US: u32 = crate::steppers::TICK_HZ / 1_000_000;
/// Capture channels of echoes 0 and 1, counted from 0.
const CHANNELS: [usize; 2] = [3, 2];

static ECHOES: Mutex<RefCell<[Echo; 4]>> = Mutex::new(RefCell::new([Echo::new(false, 0); 4]));

/// Edge budgets of echoes 0 and 1; `None` for an unused one.
static BUDGETS: Mutex<RefCell<[Option<EdgeBudget>; 2]>> = Mutex::new(RefCell::new([None; 2]));
/// True if the interrupt of any line has been masked, here or in [`lines`], so that the control loop must handle it.
pub(crate) static STORM: AtomicBool = AtomicBool::new(false);

/// Names of the lines with a budget of edges: first those of [`lines`].
pub(crate) const LINES: [&str; 5] = ["encoder 3", "echo 2", "echo 3", "echo 0", "echo 1"];

/// Trigger and capture pins, by connector. Echoes 2 and 3 belong to [`crate::encoders::lines`].
pub struct Pins {
    /// Pin `us0_trig` of the carrier.
    pub trigger0: Peri<'static, peripherals::PK4>,
    /// Pin `us1_trig` of the carrier.
    pub trigger1: Peri<'static, peripherals::PK5>,
    /// Pin `us2_trig` of the carrier.
    pub trigger2: Peri<'static, peripherals::PK6>,
    /// Pin `us3_trig` of the carrier.
    pub trigger3: Peri<'static, peripherals::PJ7>,
    /// Pin `us0_echo` of the carrier.
    pub echo0: Peri<'static, peripherals::PA3>,
    /// Pin `us1_echo` of the carrier.
    pub echo1: Peri<'static, peripherals::PA2>,
}

/// Driver of the four range sensors.
pub struct Rangers {
    clock: Clock,
    triggers: [Output<'static>; 4],
    _echoes: [Flex<'static>; 2],
}

impl Rangers {
    /// Starts the capture, on the clock that already runs. `used` selects echoes 0 and 1.
    #[must_use]
    pub fn new(pins: Pins, used: [bool; 2], clock: Clock) -> Self {
        let echoes = [echo_pin(pins.echo0), echo_pin(pins.echo1)];
        critical_section::with(|cs| {
            let budget = || EdgeBudget::new(ECHO_EDGES_PER_MS, steppers::TICK_HZ / 1000);
            *BUDGETS.borrow_ref_mut(cs) = used.map(|used| used.then(budget));
            pac::TIM2.ccmr_input(1).modify(|w| {
                for channel in CHANNELS {
                    w.set_ccs(channel - 2, vals::CcmrInputCcs::TI4);
                    w.set_icf(channel - 2, vals::FilterValue::FDTS_DIV8_N8);
                }
            });
            pac::TIM2.ccer().modify(|w| {
                for channel in CHANNELS {
                    // Both edges (RM0399, TIMx_CCER: CCxP and CCxP both set).
                    w.set_ccp(channel, true);
                    w.set_ccnp(channel, true);
                    w.set_cce(channel, true);
                }
            });
            CHANNELS.into_iter().zip(used).for_each(|(channel, used)| set_interrupt(channel, used));
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
    // Pulled down: an echo without a sensor must not look like one that does not end.
    pin.set_as_af_unchecked(1, AfType::input(Pull::Down));
    pin
}

/// Levels of the four echo inputs.
fn levels() -> [bool; 4] {
    let (a, i) = (pac::GPIOA.idr().read(), pac::GPIOI.idr().read());
    [a.idr(3), a.idr(2), i.idr(14), i.idr(15)].map(|level| level.to_bits() != 0)
}

/// Enables or disables a capture interrupt. The timer's interrupt handler changes that register too.
fn set_interrupt(channel: usize, on: bool) {
    pac::TIM2.dier().modify(|w| w.set_ccie(channel, on));
}

/// Takes the captures of channels 3 and 4, from the interrupt of TIM2.
pub(crate) fn on_capture(cs: CriticalSection<'_>) {
    let flags = pac::TIM2.sr().read();
    let mut budgets = BUDGETS.borrow_ref_mut(cs);
    for ((index, channel), budget) in CHANNELS.into_iter().enumerate().zip(budgets.iter_mut()) {
        let Some(budget) = budget.as_mut().filter(|budget| flags.ccif(channel) && !budget.is_masked()) else {
            continue;
        };
        // Reading the capture clears its flag: an edge after the reading calls again.
        let at = pac::TIM2.ccr(channel).read();
        ECHOES.borrow_ref_mut(cs)[index].level(levels()[index], || at);
        if budget.edge(Clock::ticks()) {
            set_interrupt(channel, false);
            STORM.store(true, Ordering::Relaxed);
        }
    }
}

/// Returns which of [`LINES`] have lost edges by a storm, and unmasks them when it is time. Called by the control loop
/// every period.
pub(crate) fn storms() -> [bool; LINES.len()] {
    if !STORM.load(Ordering::Relaxed) {
        return [false; LINES.len()];
    }
    critical_section::with(|cs| {
        let now = Clock::ticks();
        let [encoder, echo2, echo3] = lines::storms(cs, now);
        let mut budgets = BUDGETS.borrow_ref_mut(cs);
        let [echo0, echo1] = core::array::from_fn(|index| {
            let Some(budget) = &mut budgets[index] else { return false };
            let verdict = budget.look(now);
            if verdict.unmask {
                // A capture from meanwhile is not a present edge.
                let _ = pac::TIM2.ccr(CHANNELS[index]).read();
                set_interrupt(CHANNELS[index], true);
            }
            verdict.storm
        });
        let storms = [encoder, echo2, echo3, echo0, echo1];
        STORM.store(storms.contains(&true), Ordering::Relaxed);
        storms
    })
}

/// Newest pulse at an echo input.
pub(crate) fn pulse(index: u8) -> Option<Pulse> {
    critical_section::with(|cs| ECHOES.borrow_ref(cs).get(usize::from(index))?.pulse(Clock::ticks(), TICKS_PER_US))
}

/// Takes the level of an echo's line, from the interrupt of that line.
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
