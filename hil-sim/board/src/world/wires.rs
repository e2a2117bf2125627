//! Wiring of the processor's pins, by connector: levels, volts and bytes, each with its time.
//!
//! This is the interface for a processor that drives its pins itself, such as an emulated one. A call without a time
//! acts at the time of the world's clock. The simulated firmware's traits, in [`pins`](super::pins) and
//! [`stepping`](super::stepping), access the same devices.

use r4_protocol::ChannelId;

use super::{StepPulses, World, pins, stepping};
use crate::{
    i2c::{I2cBus, Response},
    sensors::hc_sr04::EchoEdge,
};

/// One of the processor's I2C controllers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Controller {
    /// Controller of the board's own chips.
    Board,
    /// Controller of an external connector, 0 or 1.
    External(usize),
}

/// A chip on the board's I2C bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BoardChip {
    /// The PCA9685 behind the OSMC bridges.
    OsmcPwm,
    /// The PCA9685 behind the DHB bridges.
    DhbPwm,
    /// The PCA9685 behind the servos.
    ServoPwm,
    /// The MCP4728 behind the brushless drives.
    BldcDac,
    /// The MCP23017 behind relays, directions and brakes.
    Expander,
}

/// Lines that stop outputs.
impl World {
    /// Sets the DISABLE line of the OSMC bridges: high is off.
    pub fn set_osmc_disabled(&mut self, high: bool) {
        self.catch_up();
        self.osmc_disabled = high;
        self.stale = true;
        self.look_at_lines();
    }

    /// Sets the output-enable line of the motor PWM chips, as the board wires it: high is off.
    pub fn set_pwm_outputs_disabled(&mut self, high: bool) {
        self.catch_up();
        self.chips.set_bridge_outputs_enabled(self.clock.now_ns(), !high);
        self.look_at_lines();
    }

    /// Sets the line to an external watchdog, which every edge kicks; see [`pins::Pins::longest_kick_ns`].
    pub fn set_heartbeat(&mut self, _high: bool) {
        self.pins.kick(self.clock.now_ns());
    }

    /// Sets the LDAC line of the brushless drives' DAC; low while it is not driven.
    pub fn set_ldac(&mut self, high: bool) {
        self.catch_up();
        if let Some(chip) = &self.chips.bldc_dac {
            chip.borrow_mut().set_ldac(self.clock.now_ns(), high);
        }
        self.look_at_lines();
    }

    /// A word that the processor keeps over its resets, by index, for inspection and faults; `None` past the last.
    pub fn kept_word(&mut self, index: usize) -> Option<&mut u32> {
        self.kept_words.get_mut(index)
    }

    /// Resets the processor: its lines float, to levels at which nothing moves, until it drives them again; its counts
    /// are lost. A bus transfer in progress stays as it is, without STOP. Trigger lines keep their level.
    pub fn reset_processor(&mut self) {
        // the words that the processor keeps over a reset stay
        self.catch_up();
        self.set_osmc_disabled(true);
        self.set_pwm_outputs_disabled(true);
        self.set_ldac(false);
        self.steppers.iter_mut().for_each(stepping::Axis::reset);
        self.pins.reset_processor();
        self.counters = super::encoders::counters(&self.pins.encoders, self.encoder_3);
    }
}

/// Stepper drivers, by connector. A driver follows its lines edge by edge, with the reported times; its state is known
/// up to the time that [`World::settle_steppers`] declares complete. Lines of a connector without a driver are ignored.
impl World {
    /// Sets the step line of a connector from `at_ns` on; its rising edge is a step.
    pub fn step_line(&mut self, connector: usize, at_ns: u64, high: bool) {
        if let Some(axis) = self.axis_at(connector) {
            axis.step_line(at_ns, high);
        }
    }

    /// Sets the direction line of a connector from `at_ns` on; high is forward.
    pub fn direction_line(&mut self, connector: usize, at_ns: u64, high: bool) {
        if let Some(axis) = self.axis_at(connector) {
            axis.direction_line(at_ns, high);
        }
    }

    /// Sets the enable line of all drivers from now on.
    pub fn set_stepper_enable(&mut self, high: bool) {
        let now_ns = self.clock.now_ns();
        self.steppers.iter_mut().for_each(|axis| axis.enable(now_ns, high));
    }

    /// Declares that all edges of step and direction lines up to `up_to_ns` have been reported, so that drivers and
    /// motors advance to it. Edges reported later for an earlier time count as at `up_to_ns`.
    ///
    /// Has to be called before a stepper is queried: whenever the clock is released, with its time. A processor that
    /// queues its steps must not call it.
    pub fn settle_steppers(&mut self, up_to_ns: u64) {
        self.catch_up();
        self.steppers.iter_mut().for_each(|axis| axis.settle(up_to_ns));
    }

    /// Number of pulses that a stepper's driver received; `None` for other channels.
    pub fn step_pulses(&mut self, channel: ChannelId) -> Option<StepPulses> {
        self.catch_up();
        self.steppers.iter().find(|axis| axis.channel == channel).map(stepping::Axis::pulses)
    }

    fn axis_at(&mut self, connector: usize) -> Option<&mut stepping::Axis> {
        self.steppers.iter_mut().find(|axis| usize::from(axis.channel.index) == connector)
    }
}

/// Range sensors, switches and analog lines, by connector.
impl World {
    /// Sets the trigger line of a range sensor from now on.
    pub fn trigger(&mut self, connector: usize, high: bool) {
        if !high {
            // the sound leaves at the falling edge
            self.look_ahead(connector);
        }
        self.pins.rangers.trigger(connector, self.clock.now_ns(), high);
    }

    /// Level of the echo line of a range connector.
    pub fn echo_is_high(&mut self, connector: usize) -> bool {
        self.catch_up();
        let now_ns = self.clock.now_ns();
        if let Some(source) = self.pins.pulses_at(connector) {
            return source.sensor.is_high();
        }
        self.pins.rangers.modules.get_mut(connector).is_some_and(|module| module.echo_is_high(now_ns))
    }

    /// Passes the edges of a range sensor's echo line up to now that were not passed before, in order of time.
    pub fn take_echo_edges(&mut self, connector: usize, sink: impl FnMut(EchoEdge)) {
        self.catch_up();
        let now_ns = self.clock.now_ns();
        if let Some(source) = self.pins.pulses_at(connector) {
            source.sensor.take_edges().for_each(sink);
            return;
        }
        if let Some(module) = self.pins.rangers.modules.get_mut(connector) {
            module.take_edges(now_ns).for_each(sink);
        }
    }

    /// Time of the next known change of a range sensor's echo line, ns; `u64::MAX` for none. A trigger of any sensor
    /// can change it, because the others hear its sound.
    #[must_use]
    pub fn next_echo_edge_ns(&self, connector: usize) -> u64 {
        let pulses = self.pins.pulses.iter().find(|source| usize::from(source.mounting.connector) == connector);
        if let Some(source) = pulses {
            return source.sensor.next_edge_ns();
        }
        let module = self.pins.rangers.modules.get(connector);
        module.and_then(|module| module.next_edge_ns()).unwrap_or(u64::MAX)
    }

    /// Level of a switch's line, which a resistor pulls high if there is no switch.
    pub fn switch_is_high(&mut self, connector: usize) -> bool {
        pins::switch_is_high(self, connector)
    }

    /// Voltage at an analog input of the processor, 0 to 3.3 V, as one sample of an ideal converter: with the noise and
    /// the errors of the input. Noise is sampled at each call.
    pub fn analog_v(&mut self, input: usize) -> f64 {
        pins::analog_v(self, input)
    }

    /// Code of the processor's 16-bit converter at an analog input, as the simulated firmware gets it.
    pub fn analog_code(&mut self, input: usize) -> u16 {
        pins::analog_code(self, input)
    }

    /// Sets the voltage of the processor's analog output from now on, V; 0 while it drives nothing.
    pub fn set_dac_v(&mut self, output: usize, volts: f64) {
        self.catch_up();
        self.pins.set_dac_v(output, volts);
    }
}

/// I2C controllers with their own timing: they use the bus's own [`start`](I2cBus::start) and so on, and the world
/// follows. Times are at most the clock's.
impl World {
    /// Sends START and an address; see [`I2cBus::start`].
    pub fn i2c_start(&mut self, controller: Controller, at_ns: u64, address: u8, read: bool) -> Response {
        self.on_bus(controller, |bus| bus.start(at_ns, address, read))
    }

    /// Sends a byte; see [`I2cBus::write`].
    pub fn i2c_write(&mut self, controller: Controller, at_ns: u64, byte: u8) -> Response {
        self.on_bus(controller, |bus| bus.write(at_ns, byte))
    }

    /// Reads a byte; see [`I2cBus::read`].
    pub fn i2c_read(&mut self, controller: Controller, at_ns: u64) -> Option<u8> {
        self.on_bus(controller, |bus| bus.read(at_ns))
    }

    /// Sends STOP; see [`I2cBus::stop`].
    pub fn i2c_stop(&mut self, controller: Controller, at_ns: u64) {
        self.on_bus(controller, |bus| bus.stop(at_ns));
    }

    /// Sends a clock pulse; see [`I2cBus::clock_pulse`].
    pub fn i2c_clock_pulse(&mut self, controller: Controller, at_ns: u64) {
        self.on_bus(controller, |bus| bus.clock_pulse(at_ns));
    }

    /// True if both lines are free now; see [`I2cBus::lines_are_free`].
    pub fn i2c_lines_are_free(&mut self, controller: Controller) -> bool {
        let now_ns = self.clock.now_ns();
        self.bus_of(controller).lines_are_free(now_ns)
    }

    /// The bus of one of the processor's controllers.
    ///
    /// # Panics
    /// For an external connector that the board does not have.
    pub fn bus_of(&mut self, controller: Controller) -> &mut I2cBus {
        match controller {
            Controller::Board => &mut self.bus,
            Controller::External(connector) => self.pins.external_bus(connector, self.clock.now_ns()),
        }
    }

    /// Executes `work` on a bus, and updates the expander's pins and the DAC's outputs; PWM chips change theirs at the
    /// end of their cycle.
    pub(crate) fn on_bus<T>(&mut self, controller: Controller, work: impl FnOnce(&mut I2cBus) -> T) -> T {
        self.catch_up();
        let result = work(self.bus_of(controller));
        self.look_at_lines();
        result
    }
}

/// Faults of single chips.
impl World {
    /// Interrupts the supply of one chip for a moment, while the bus and all others continue: its registers are as
    /// after power-on, a transfer with it is not acknowledged further. False if the robot has no such chip.
    pub fn brown_out(&mut self, chip: BoardChip) -> bool {
        self.catch_up();
        let known = self.chips.power_cycle(chip, self.clock.now_ns());
        self.look_at_lines();
        known
    }
}
