//! Quadrature counters: three timers in encoder mode, and interrupts for the fourth encoder.
//!
//! The timers count every edge of both tracks (encoder mode 3, RM0399 "Encoder interface mode": SMS = 011), up while track A
//! leads, 16 bits wide. Their inputs are filtered: a level counts when 8 samples in a row show it (IC1F = IC2F = 1001,
//! samples at f_DTS/8, CKD = 00 so that f_DTS is the timer's clock). At 240 MHz that is 8 / 30 MHz = 267 ns, so that edges
//! of one track must be at least that far apart: well beyond the 1000 counts in a millisecond that a control period copes with.
//! embassy's driver for encoder mode has no filter, so the registers are written here.
//!
//! Encoder 3 has no timer: [`lines`] decodes it on both edges of both tracks. Index pulses of all four latch the counters: [`index`].

use embassy_stm32::{
    Peri,
    gpio::{AfType, Flex, Pin, Pull},
    pac::{
        self,
        timer::{TimGp16, vals},
    },
    peripherals, rcc,
};
use r4_firmware::platform::Encoders;

pub mod index;
pub mod lines;

/// Input filter: 8 samples at f_DTS/8.
const FILTER: vals::FilterValue = vals::FilterValue::FDTS_DIV8_N8;

/// Timers and pins of the encoders, by connector.
pub struct Parts {
    /// Timer that counts encoder 0.
    #[expect(dead_code, reason = "whoever gives it away cannot use it")]
    pub timer0: Peri<'static, peripherals::TIM8>,
    /// Pins `enc0_a` and `enc0_b`.
    pub tracks0: (Peri<'static, peripherals::PJ8>, Peri<'static, peripherals::PJ6>),
    /// Timer that counts encoder 1.
    #[expect(dead_code, reason = "whoever gives it away cannot use it")]
    pub timer1: Peri<'static, peripherals::TIM3>,
    /// Pins `enc1_a` and `enc1_b`.
    pub tracks1: (Peri<'static, peripherals::PB4>, Peri<'static, peripherals::PC7>),
    /// Timer that counts encoder 2.
    #[expect(dead_code, reason = "whoever gives it away cannot use it")]
    pub timer2: Peri<'static, peripherals::TIM1>,
    /// Pins `enc2_a` and `enc2_b`.
    pub tracks2: (Peri<'static, peripherals::PK1>, Peri<'static, peripherals::PJ11>),
}

/// Driver of the four encoders.
pub struct Counters {
    timers: [TimGp16; 3],
    lines: lines::Lines,
    _pins: [Flex<'static>; 6],
}

impl Counters {
    /// Starts the timers at 0. [`lines::Lines`] must exist already, and the switch pins must be inputs. `index_low` has
    /// for each encoder with an index pulse whether its line is low during the pulse.
    #[must_use]
    pub fn new(parts: Parts, lines: lines::Lines, index_low: [Option<bool>; 4]) -> Self {
        rcc::enable_and_reset::<peripherals::TIM8>();
        rcc::enable_and_reset::<peripherals::TIM3>();
        rcc::enable_and_reset::<peripherals::TIM1>();
        let pins = [
            track(parts.tracks0.0, 3),
            track(parts.tracks0.1, 3),
            track(parts.tracks1.0, 2),
            track(parts.tracks1.1, 2),
            track(parts.tracks2.0, 1),
            track(parts.tracks2.1, 1),
        ];
        let timers = timers();
        timers.into_iter().for_each(start);
        index::start(index_low);
        Self { timers, lines, _pins: pins }
    }
}

/// Timers of encoders 0 to 2.
fn timers() -> [TimGp16; 3] {
    #[allow(unsafe_code, reason = "TIM1 and TIM8 have the registers of a general-purpose timer, and more")]
    // SAFETY: addresses of timers that only this module uses; the registers used here have the same layout (RM0399).
    unsafe {
        [TimGp16::from_ptr(pac::TIM8.as_ptr()), pac::TIM3, TimGp16::from_ptr(pac::TIM1.as_ptr())]
    }
}

/// Configures a pin as a timer's input, pulled up so that an open one is at rest.
fn track(pin: Peri<'static, impl Pin>, function: u8) -> Flex<'static> {
    let mut pin = Flex::new(pin);
    pin.set_as_af_unchecked(function, AfType::input(Pull::Up));
    pin
}

fn start(timer: TimGp16) {
    timer.ccmr_input(0).write(|w| {
        for channel in 0..2 {
            w.set_ccs(channel, vals::CcmrInputCcs::TI4);
            w.set_icf(channel, FILTER);
        }
    });
    // Neither track is inverted.
    timer.ccer().write(|_| {});
    timer.smcr().write(|w| w.set_sms(vals::Sms::ENCODER_MODE_3));
    timer.psc().write_value(0);
    timer.arr().write(|w| w.set_arr(u16::MAX));
    timer.cr1().write(|w| w.set_cen(true));
}

impl Encoders for Counters {
    fn count(&mut self, index: u8) -> u16 {
        match self.timers.get(usize::from(index)) {
            Some(timer) => timer.cnt().read().cnt(),
            None if index == 3 => self.lines.encoder().count(),
            None => 0,
        }
    }

    fn illegal(&mut self, index: u8) -> u32 {
        if index == 3 { self.lines.encoder().illegal() } else { 0 }
    }

    fn at_index(&mut self, index: u8) -> Option<u16> {
        index::take(index.into())
    }
}
