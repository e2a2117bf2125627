//! Switches beside the encoders: inputs with the processor's pull-up, which close to ground.

use embassy_stm32::{
    Peri,
    gpio::{Input, Pull},
    peripherals,
};
use r4_firmware::platform::SwitchInputs;

/// Pins of the switches, in the order of the inputs.
pub struct Pins {
    /// Pin `enc0_sw` of the carrier.
    pub switch0: Peri<'static, peripherals::PJ0>,
    /// Pin `enc1_sw` of the carrier.
    pub switch1: Peri<'static, peripherals::PJ1>,
    /// Pin `enc2_sw` of the carrier.
    pub switch2: Peri<'static, peripherals::PJ2>,
    /// Pin `enc3_sw` of the carrier.
    pub switch3: Peri<'static, peripherals::PJ5>,
}

/// Driver of the four switch inputs.
pub struct Switches([Input<'static>; 4]);

impl Switches {
    /// Creates the driver and enables the pull-ups.
    #[must_use]
    pub fn new(pins: Pins) -> Self {
        let Pins { switch0, switch1, switch2, switch3 } = pins;
        Self([
            Input::new(switch0, Pull::Up),
            Input::new(switch1, Pull::Up),
            Input::new(switch2, Pull::Up),
            Input::new(switch3, Pull::Up),
        ])
    }
}

impl SwitchInputs for Switches {
    fn is_high(&mut self, index: u8) -> bool {
        self.0.get(usize::from(index)).is_none_or(Input::is_high)
    }
}
