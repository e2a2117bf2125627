//! Everything of the processor that the control loop uses, in one.

use r4_firmware::platform::{
    AnalogInputs, AnalogOutputs, EchoState, Encoders, Ranging, StepEvent, Steppers, SwitchInputs,
};

/// See the traits. PLACE-HOLDER: reads nothing and drives nothing until the drivers are merged.
pub(crate) struct Processor;

impl Encoders for Processor {
    fn count(&mut self, _: u8) -> u16 {
        0
    }
    fn illegal(&mut self, _: u8) -> u32 {
        0
    }
}

impl SwitchInputs for Processor {
    fn is_high(&mut self, _: u8) -> bool {
        true
    }
}

impl AnalogOutputs for Processor {
    fn set(&mut self, _: u8, _: u16) {}
}

impl AnalogInputs for Processor {
    fn code(&mut self, _: u8) -> u16 {
        0
    }
}

impl Steppers for Processor {
    const TICK_HZ: u32 = 1_000_000;
    const PULSE_TICKS: u32 = 5;
    const DIRECTION_LATENCY_TICKS: u32 = 1;
    fn now(&mut self) -> u32 {
        0
    }
    fn enable(&mut self, _: bool) {}
    fn queue(&mut self, _: u8, _: &[StepEvent]) -> usize {
        0
    }
    fn pending(&mut self, _: u8) -> u32 {
        0
    }
    fn position(&mut self, _: u8) -> i32 {
        0
    }
    fn stop(&mut self, _: u8) {}
}

impl Ranging for Processor {
    fn trigger(&mut self, _: u8, _: bool) {}
    fn clear(&mut self, _: u8) {}
    fn echo(&mut self, _: u8) -> EchoState {
        EchoState::Idle
    }
}
