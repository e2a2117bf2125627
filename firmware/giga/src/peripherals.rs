//! Peripherals of the processor that the control loop uses, in one type.

use r4_firmware::platform::{
    AnalogInputs, AnalogOutputs, ControlCycles, EdgeInputs, Encoders, KeptWords, Pulse, PulseInputs, StepEvent,
    Steppers, SwitchInputs,
};

use crate::{
    analog::{Inputs, Outputs},
    cycles,
    encoders::Counters,
    executors, ranging, reset,
    steppers::Generators,
    switches::Switches,
};

/// Peripherals for the control loop: counters, converters, switches and step generators.
pub(crate) struct Processor {
    pub(crate) encoders: Counters,
    pub(crate) switches: Switches,
    pub(crate) steppers: Generators,
    /// Analog inputs; `None` when the converter did not start: its inputs read 0 V, and supplies that are watched are
    /// out of range.
    pub(crate) inputs: Option<Inputs>,
    pub(crate) outputs: Outputs,
    /// State of each of [`ranging::LINES`] at the last check: true for a storm.
    pub(crate) storms: [bool; ranging::LINES.len()],
}

#[allow(unsafe_code, reason = "the inputs hold a plain pointer")]
// SAFETY: the pointer is to memory that DMA writes and one owner reads, from any priority; nothing else refers to it.
unsafe impl Send for Inputs {}

impl Encoders for Processor {
    fn count(&mut self, index: u8) -> u16 {
        self.encoders.count(index)
    }

    fn illegal(&mut self, index: u8) -> u32 {
        self.encoders.illegal(index)
    }

    fn at_index(&mut self, index: u8) -> Option<u16> {
        self.encoders.at_index(index)
    }
}

impl EdgeInputs for Processor {
    fn storm(&mut self) -> bool {
        let storms = ranging::storms();
        if storms != self.storms {
            for ((line, storm), before) in ranging::LINES.into_iter().zip(storms).zip(self.storms) {
                if storm && !before {
                    defmt::warn!("{}: more edges than a sensor makes, not listened to for a second", line);
                }
            }
            self.storms = storms;
        }
        storms.contains(&true)
    }
}

impl PulseInputs for Processor {
    fn pulse(&mut self, index: u8) -> Option<Pulse> {
        ranging::pulse(index)
    }
}

impl ControlCycles for Processor {
    const CYCLES_HZ: u32 = cycles::RUNNING_MHZ * 1_000_000;

    fn control_cycles(&mut self) -> u32 {
        executors::control_cycles()
    }
}

impl SwitchInputs for Processor {
    fn is_high(&mut self, index: u8) -> bool {
        self.switches.is_high(index)
    }
}

impl AnalogInputs for Processor {
    fn code(&mut self, index: u8) -> u16 {
        self.inputs.as_mut().map_or(0, |inputs| inputs.code(index))
    }
}

impl AnalogOutputs for Processor {
    fn set(&mut self, index: u8, code: u16) {
        self.outputs.set(index, code);
    }
}

impl KeptWords for Processor {
    fn kept(&mut self, index: usize) -> u32 {
        reset::kept(index)
    }

    fn keep(&mut self, index: usize, word: u32) {
        reset::keep(index, word);
    }
}

impl Steppers for Processor {
    const TICK_HZ: u32 = Generators::TICK_HZ;
    const PULSE_TICKS: u32 = Generators::PULSE_TICKS;
    const DIRECTION_LATENCY_TICKS: u32 = Generators::DIRECTION_LATENCY_TICKS;

    fn now(&mut self) -> u32 {
        self.steppers.now()
    }

    fn enable(&mut self, high: bool) {
        self.steppers.enable(high);
    }

    fn queue(&mut self, axis: u8, events: &[StepEvent]) -> usize {
        self.steppers.queue(axis, events)
    }

    fn queued(&mut self) {
        self.steppers.queued();
    }

    fn pending(&mut self, axis: u8) -> u32 {
        self.steppers.pending(axis)
    }

    fn position(&mut self, axis: u8) -> i32 {
        self.steppers.position(axis)
    }

    fn stop(&mut self, axis: u8) {
        self.steppers.stop(axis);
    }
}
