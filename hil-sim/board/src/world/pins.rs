//! Devices on the processor's own pins: range sensors, encoder tracks, switches, analog inputs and outputs, connectors.

use std::{cell::RefCell, num::NonZeroU32, rc::Rc, task::Waker};

use r4_boards::{
    BodyReading, RangeView, Robot, SimulatedMotor, SimulatedPulses, SimulatedSensor, SimulatedSwitch, SwitchedBy,
};
use r4_firmware::{
    platform::{
        AnalogInputs, AnalogOutputs, ControlCycles, EchoState, KeptWords, Pulse, PulseInputs, Ranging, SwitchInputs,
    },
    sensing::{
        pulse::Pulses,
        storm::{ECHO_EDGES_PER_MS, EdgeBudget},
    },
};
use r4_protocol::{ChannelId, config::Feedback};

use super::{
    Processor, Rail, World,
    body::Coupling,
    encoders::{US_PER_MS, ticks},
    fields::FieldSensor,
    uarts::Sender,
};
use crate::{
    i2c::I2cBus,
    misuse::Misuse,
    sensors::{
        analog_input::AnalogInput,
        as5600_pwm::As5600Pwm,
        dac_output::DacOutput,
        hc_sr04::HcSr04Array,
        loopback::{Eeprom24c02, UartLoopback},
        normal,
        quadrature::QuadratureSignal,
        switch::{BOUNCE_NS, Contact, Pull, Switch},
    },
};

/// Largest code of the 16-bit converter.
const CODE_MAX: f64 = 65_535.0;
/// Reference of the converter, V.
const REFERENCE_V: f64 = 3.3;
/// Bit rate of the UART connectors, bits/s.
const UART_BAUD: u32 = 115_200;
/// Number of received bytes that the processor's driver buffers.
const UART_BUFFER: usize = 64;
/// Address of the memory on each external I2C connector.
const EEPROM_ADDRESS: u8 = 0x50;
/// Clock of the external I2C connectors, Hz.
const EXTERNAL_I2C_HZ: u32 = 100_000;

/// Devices on the processor's pins, for queries and faults.
pub struct Pins {
    /// Range sensors, by connector.
    pub rangers: HcSr04Array,
    pub(super) echoes: [Echo; HcSr04Array::MODULES],
    /// Angle sensors that send pulses, in place of range sensors.
    pub(super) pulses: Vec<PulseSource>,
    /// Budgets of edges for the interrupts of the echoes; `None` if no device uses one.
    echo_budgets: [Option<EdgeBudget>; HcSr04Array::MODULES],
    /// Encoder tracks, by connector.
    pub encoders: [QuadratureSignal; 4],
    /// Switches with their actuation, by connector.
    pub switches: Vec<SwitchInput>,
    /// Polarity of the index track, by connector: true if it is active low; `None` without one.
    index_lines: [Option<bool>; 4],
    /// Divided inputs with their sources, by input.
    pub analogs: [Option<AnalogSource>; 6],
    dac: DacOutput,
    dac_v: [f64; 2],
    pub(crate) uarts: [UartPort; 2],
    pub(crate) external_buses: [I2cBus; 2],
    eeproms: [Rc<RefCell<Eeprom24c02>>; 2],
    /// Time of the external watchdog's last kick, and its longest wait, ns.
    kicked_ns: u64,
    longest_kick_ns: u64,
}

/// A switch with its actuation.
pub struct SwitchInput {
    /// State of the switch.
    pub switch: Switch,
    spec: SimulatedSwitch,
}

/// A divided analog input with the voltage at it.
#[derive(Clone, Debug)]
pub struct AnalogSource {
    /// Divider, clamp and converter.
    pub input: AnalogInput,
    /// Voltage at the input, V, unless a sensor on the body is connected.
    pub volts: f64,
    /// Sensor on the body whose voltage is connected here.
    pub reads: Option<BodyReading>,
    /// Field sensor that is connected here.
    pub field: Option<FieldSensor>,
}

/// A UART connector, with the task that waits for its bytes.
pub(crate) struct UartPort {
    pub(crate) line: UartLoopback,
    pub(super) sender: Option<Sender>,
    pub(crate) reader: Option<Waker>,
}

impl UartPort {
    /// Sends bytes from the board. A sensor ignores them.
    pub(crate) fn write(&mut self, at_ns: u64, bytes: &[u8]) {
        if self.sender.is_none() {
            self.line.write(at_ns, bytes);
        }
    }
}

/// An angle sensor that sends pulses, and the state of the processor's capture unit for them.
pub(super) struct PulseSource {
    pub(super) sensor: As5600Pwm,
    pub(super) mounting: SimulatedPulses,
    captured: Pulses,
}

/// State of the processor's capture unit for one echo line.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Echo {
    cleared_ns: u64,
    rise_ns: Option<u64>,
    fall_ns: Option<u64>,
}

impl Pins {
    pub(super) fn new(robot: &Robot, seed: u64) -> Self {
        let truth = &robot.simulation;
        let mut rangers = HcSr04Array::new(seed);
        for range in &truth.ranges {
            if let RangeView::Constant { distance_m } = range.sees
                && let Some(module) = rangers.modules.get_mut(usize::from(range.channel.index))
            {
                module.set_distance_m(Some(distance_m));
            }
        }
        let input = |volts_per_code: f64, noise_rms_codes| AnalogInput {
            noise_rms_codes,
            ..AnalogInput::new(volts_per_code * CODE_MAX / REFERENCE_V)
        };
        let mut analogs: [Option<AnalogSource>; 6] = [const { None }; 6];
        for analog in &truth.analogs {
            if let Some(place) = analogs.get_mut(usize::from(analog.channel.index)) {
                let input = input(analog.volts_per_code, analog.noise_rms_codes);
                *place = Some(AnalogSource {
                    input,
                    volts: analog.volts,
                    reads: analog.reads,
                    field: analog.field.clone().map(FieldSensor::new),
                });
            }
        }
        for rail in &truth.rails {
            if let Some(place) = analogs.get_mut(usize::from(rail.analog)) {
                let input = input(rail.volts_per_code, rail.noise_rms_codes);
                *place = Some(AnalogSource { input, volts: rail.emf_v, reads: None, field: None });
            }
        }
        let budget = EdgeBudget::new(ECHO_EDGES_PER_MS, US_PER_MS);
        let echo_budgets = [0, 1, 2, 3].map(|index| robot.config.uses_range(index).then_some(budget));
        let pulse_source = |mounting: &SimulatedPulses| PulseSource {
            sensor: As5600Pwm::new(mounting.frames_hz, seed.wrapping_add(u64::from(mounting.connector) << 8)),
            mounting: *mounting,
            captured: Pulses::new(false),
        };
        let mut encoders = [0, 1, 2, 3].map(|index| QuadratureSignal::new(0.0, seed.wrapping_add(index)));
        for (input, every) in truth.motors.iter().filter_map(|motor| index_of(robot, motor)) {
            if let Some(signal) = encoders.get_mut(usize::from(input)) {
                signal.set_index(every);
            }
        }
        let index_lines = [0, 1, 2, 3].map(|index| {
            let switch = robot.config.switches.iter().find(|switch| switch.id.index == index)?;
            encoders[usize::from(index)].index_every().map(|_| switch.active_low)
        });
        let switch = |spec: &SimulatedSwitch| {
            let seed = seed.wrapping_add(u64::from(spec.channel.index));
            SwitchInput { switch: Switch::new(Contact::NormallyOpen, Pull::Up, BOUNCE_NS, seed), spec: *spec }
        };
        let eeproms = [0, 1].map(|_| Rc::new(RefCell::new(Eeprom24c02::new(EEPROM_ADDRESS))));
        let external_buses = std::array::from_fn(|index: usize| {
            let mut bus = I2cBus::new(EXTERNAL_I2C_HZ);
            bus.attach(eeproms[index].clone());
            bus
        });
        Self {
            rangers,
            echoes: [Echo::default(); HcSr04Array::MODULES],
            pulses: truth.pulses.iter().map(pulse_source).collect(),
            echo_budgets,
            encoders,
            index_lines,
            switches: truth.switches.iter().map(switch).collect(),
            analogs,
            dac: DacOutput::new(false),
            dac_v: [0.0; 2],
            uarts: [0, 1].map(|port| UartPort {
                line: UartLoopback::new(UART_BAUD, UART_BUFFER),
                sender: truth
                    .uarts
                    .iter()
                    .find(|uart| uart.port == port)
                    .map(|uart| Sender::new(uart.device, seed.wrapping_add(port.into()))),
                reader: None,
            }),
            external_buses,
            eeproms,
            kicked_ns: 0,
            longest_kick_ns: 0,
        }
    }

    /// The memory on one of the external I2C connectors; `None` beyond them.
    #[must_use]
    pub fn eeprom(&self, connector: usize) -> Option<&Rc<RefCell<Eeprom24c02>>> {
        self.eeproms.get(connector)
    }

    /// Voltage at one of the processor's analog outputs, V; `None` beyond them.
    #[must_use]
    pub fn dac_v(&self, output: usize) -> Option<f64> {
        self.dac_v.get(output).copied()
    }

    pub(super) fn set_dac_v(&mut self, output: usize, volts: f64) {
        if let Some(place) = self.dac_v.get_mut(output) {
            *place = volts;
        }
    }

    /// The bus at one of the external I2C connectors, at `now_ns`.
    pub(super) fn external_bus(&mut self, connector: usize, now_ns: u64) -> &mut I2cBus {
        // the memory has to detect the end of its write before it is addressed
        self.eeproms[connector].borrow_mut().advance(now_ns);
        &mut self.external_buses[connector]
    }

    pub(super) fn reset_processor(&mut self) {
        self.dac_v = [0.0; 2];
    }

    /// Records an edge of the line to the external watchdog.
    pub(super) fn kick(&mut self, now_ns: u64) {
        self.longest_kick_ns = self.longest_kick_ns.max(now_ns - self.kicked_ns);
        self.kicked_ns = now_ns;
    }

    /// Longest wait of the external watchdog for an edge up to now, ns.
    #[must_use]
    pub fn longest_kick_ns(&self, now_ns: u64) -> u64 {
        self.longest_kick_ns.max(now_ns - self.kicked_ns)
    }

    /// The device at a UART connector, whose output is wired to its input unless a sensor is connected; `None` beyond
    /// them.
    pub fn uart(&mut self, connector: usize) -> Option<&mut UartLoopback> {
        self.uarts.get_mut(connector).map(|port| &mut port.line)
    }

    pub(super) fn misuse(&self) -> Vec<Misuse> {
        let mut all: Vec<_> = self.rangers.modules.iter().flat_map(|module| module.misuse().first()).copied().collect();
        self.external_buses.iter().for_each(|bus| all.extend(bus.misuse().first()));
        self.eeproms.iter().for_each(|eeprom| all.extend(eeprom.borrow().misuse().first()));
        all
    }
}

impl SwitchInput {
    /// Channel that reads the switch.
    #[must_use]
    pub fn channel(&self) -> ChannelId {
        self.spec.channel
    }
}

/// Updates a switch by its actuation, and reads it.
pub(super) fn switch_is_high(world: &mut World, connector: usize) -> bool {
    if let Some(active_low) = world.pins.index_low(connector) {
        return world.pins.encoders[connector].index() != active_low;
    }
    let now_ns = world.clock.now_ns();
    let place = world.pins.switches.iter().position(|input| usize::from(input.spec.channel.index) == connector);
    let Some(place) = place else { return true };
    let closed = match world.pins.switches[place].spec.closed_by {
        SwitchedBy::Nothing => None,
        SwitchedBy::Axis { channel, below } => world.position(channel).map(|position| position < below),
        SwitchedBy::Body(reading) => {
            world.catch_up();
            world.body.as_ref().map(|body| body.measured(reading) > 0.0)
        }
    };
    if let Some(closed) = closed {
        world.pins.switches[place].switch.set_actuated(now_ns, closed);
    }
    world.pins.switches[place].switch.is_high(now_ns)
}

/// Input of a motor's encoder and the true number of counts between its index pulses, if the board is configured for
/// them.
fn index_of(robot: &Robot, motor: &SimulatedMotor) -> Option<(u8, NonZeroU32)> {
    let Some(SimulatedSensor::Encoder { input, lines_per_turn }) = motor.sensor else { return None };
    let config = robot.config.motors.iter().find(|config| config.id == motor.channel)?;
    let Feedback::Encoder { counts_per_turn, counts_per_index, .. } = config.control?.feedback else { return None };
    // a file with wrong lines of the encoder has the same error for a turn of its disc
    let true_counts = f64::from(lines_per_turn) * 4.0 * f64::from(counts_per_index) / f64::from(counts_per_turn);
    Some((input, NonZeroU32::new(true_counts.round() as u32)?))
}

/// Sample of the converter, without rounding, for the potentiometer at `input`, if there is one.
fn potentiometer(world: &mut World, input: usize) -> Option<f64> {
    let (code, noise_rms_codes) = world.motors.iter().find_map(|motor| match motor.sensor {
        Some(SimulatedSensor::Potentiometer { input: of, low, high, noise_rms_codes }) if usize::from(of) == input => {
            let along = (motor.plant.sensed_position() - low.position_m) / (high.position_m - low.position_m);
            let share = low.share() + along * (high.share() - low.share());
            Some((share * CODE_MAX, noise_rms_codes))
        }
        _ => None,
    })?;
    let noise = normal(&mut world.noise);
    Some(code + noise * noise_rms_codes)
}

/// The divider at `input`, and the voltage there, V: that of a rail, a sensor on the body, or a set one.
fn divided<'p>(
    rails: &[Rail],
    body: Option<&Coupling>,
    pins: &'p Pins,
    input: usize,
) -> Option<(&'p AnalogInput, f64)> {
    let rail_v = rails.iter().find(|rail| usize::from(rail.spec.analog) == input).map(|rail| rail.volts);
    let source = pins.analogs.get(input)?.as_ref()?;
    let field_v = || source.field.as_ref().map(FieldSensor::volts);
    let sensor_v = || source.reads.zip(body).map(|(reading, body)| body.measured(reading));
    Some((&source.input, rail_v.or_else(field_v).or_else(sensor_v).unwrap_or(source.volts)))
}

/// Code of the converter at an input.
pub(super) fn analog_code(world: &mut World, input: usize) -> u16 {
    world.catch_up();
    if let Some(code) = potentiometer(world, input) {
        return code.round().clamp(0.0, CODE_MAX) as u16;
    }
    let World { rails, body, pins, noise, .. } = world;
    divided(rails, body.as_ref(), pins, input).map_or(0, |(source, volts)| source.code(volts, noise))
}

/// One sample of the voltage at an input, V.
pub(super) fn analog_v(world: &mut World, input: usize) -> f64 {
    world.catch_up();
    let code = potentiometer(world, input).or_else(|| {
        let World { rails, body, pins, noise, .. } = world;
        divided(rails, body.as_ref(), pins, input).map(|(source, volts)| source.sample(volts, noise))
    });
    code.map_or(0.0, |code| code.clamp(0.0, CODE_MAX) / CODE_MAX * REFERENCE_V)
}

impl AnalogInputs for Processor {
    fn code(&mut self, index: u8) -> u16 {
        self.0.borrow_mut().analog_code(index.into())
    }
}

/// A simulated board has no processor whose cycles could be counted.
impl ControlCycles for Processor {
    const CYCLES_HZ: u32 = 0;

    fn control_cycles(&mut self) -> u32 {
        0
    }
}

impl SwitchInputs for Processor {
    fn is_high(&mut self, index: u8) -> bool {
        self.0.borrow_mut().switch_is_high(index.into())
    }
}

impl KeptWords for Processor {
    fn kept(&mut self, index: usize) -> u32 {
        self.0.borrow().kept_words.get(index).copied().unwrap_or_default()
    }

    fn keep(&mut self, index: usize, word: u32) {
        if let Some(kept) = self.0.borrow_mut().kept_words.get_mut(index) {
            *kept = word;
        }
    }
}

impl AnalogOutputs for Processor {
    fn set(&mut self, index: u8, code: u16) {
        let mut world = self.0.borrow_mut();
        let volts = world.pins.dac.volts(code);
        world.set_dac_v(index.into(), volts);
    }
}

/// Timer 2 of the processor, which captures the edges of the echoes at 1 MHz.
impl Ranging for Processor {
    fn trigger(&mut self, index: u8, high: bool) {
        self.0.borrow_mut().trigger(index.into(), high);
    }

    fn clear(&mut self, index: u8) {
        let mut world = self.0.borrow_mut();
        let now_ns = world.clock.now_ns();
        world.pins.capture(usize::from(index), now_ns);
        if let Some(echo) = world.pins.echoes.get_mut(usize::from(index)) {
            *echo = Echo { cleared_ns: now_ns, ..Echo::default() };
        }
    }

    fn echo(&mut self, index: u8) -> EchoState {
        let mut world = self.0.borrow_mut();
        let now_ns = world.clock.now_ns();
        world.pins.capture(usize::from(index), now_ns)
    }
}

impl PulseInputs for Processor {
    fn pulse(&mut self, index: u8) -> Option<Pulse> {
        let mut world = self.0.borrow_mut();
        world.catch_up();
        let now_ns = world.clock.now_ns();
        let pins = &mut world.pins;
        pins.capture_pulses(usize::from(index));
        pins.pulses_at(index.into())?.captured.newest(tenths(now_ns), 1)
    }
}

/// Time of the capture unit's clock for pulses, which is that of the processor: 10 MHz, 32 bits.
const fn tenths(at_ns: u64) -> u32 {
    (at_ns / 100) as u32
}

impl World {
    /// True if an echo has lost edges by a storm; enables it again when its time is over.
    pub(super) fn echo_storm(&mut self) -> bool {
        let now_ns = self.clock.now_ns();
        let pins = &mut self.pins;
        (0..HcSr04Array::MODULES).fold(false, |storm, index| {
            pins.capture(index, now_ns);
            pins.capture_pulses(index);
            let Some(budget) = &mut pins.echo_budgets[index] else { return storm };
            storm | budget.look(ticks(now_ns)).storm
        })
    }
}

impl Pins {
    /// True if the index track on a switch line is active low; `None` for a line without one.
    pub(super) fn index_low(&self, connector: usize) -> Option<bool> {
        self.index_lines.get(connector).copied().flatten()
    }

    /// The angle sensor that sends pulses to a range connector; `None` if there is none.
    pub(super) fn pulses_at(&mut self, connector: usize) -> Option<&mut PulseSource> {
        self.pulses.iter_mut().find(|source| usize::from(source.mounting.connector) == connector)
    }

    /// Passes the edges of an angle sensor's pulses up to the world's time to the capture unit.
    fn capture_pulses(&mut self, connector: usize) {
        let Some(budget) = self.echo_budgets.get_mut(connector).and_then(Option::as_mut) else { return };
        let source = self.pulses.iter_mut().find(|source| usize::from(source.mounting.connector) == connector);
        let Some(source) = source else { return };
        for edge in source.sensor.take_edges() {
            if budget.is_masked() {
                continue;
            }
            budget.edge(ticks(edge.at_ns));
            source.captured.level(edge.high, tenths(edge.at_ns));
        }
    }

    /// Passes the edges of an echo up to now to the capture unit.
    fn capture(&mut self, index: usize, now_ns: u64) -> EchoState {
        let (Some(module), Some(echo)) = (self.rangers.modules.get_mut(index), self.echoes.get_mut(index)) else {
            return EchoState::Idle;
        };
        let budget = &mut self.echo_budgets[index];
        for edge in module.take_edges(now_ns) {
            let Some(budget) = budget.as_mut().filter(|budget| !budget.is_masked()) else { continue };
            budget.edge(ticks(edge.at_ns));
            match (edge.high, echo.rise_ns, echo.fall_ns) {
                (true, None, _) => echo.rise_ns = Some(edge.at_ns),
                (false, Some(_), None) => echo.fall_ns = Some(edge.at_ns),
                // edges after the first pulse, and a fall before it
                _ => {}
            }
        }
        let us = |ns: u64| u32::try_from(ns / 1000).unwrap_or(u32::MAX);
        match (echo.rise_ns, echo.fall_ns) {
            (Some(rise_ns), Some(fall_ns)) => EchoState::Done { width_us: us(fall_ns - rise_ns) },
            (rise_ns, _) if module.echo_is_high(now_ns) => {
                EchoState::High { since_us: us(now_ns - rise_ns.unwrap_or(echo.cleared_ns)) }
            }
            _ => EchoState::Idle,
        }
    }
}
