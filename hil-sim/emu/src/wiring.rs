//! Wiring of the chip's pins: to the simulated world, the lines around the board, and the host's cable.

use std::{
    cell::{RefCell, RefMut},
    collections::{BTreeMap, VecDeque},
    rc::Rc,
};

use r4_boards::Carrier;
use r4_mcu::{CanFrame, CanOutcome, Edge, I2cResponse, Level, Outside, Pin};
use r4_sim::{
    Clock, Environment, Light,
    i2c::Response,
    lines::Line,
    link::Sender,
    sensors::quadrature::Channel,
    world::{Controller, EncoderLine, World},
};

use crate::roles::{Role, Roles};

/// Reference voltage of the converter, which limits the chip's pins, V.
const REFERENCE_V: f64 = 3.3;

/// Number of CAN frames kept until they are taken.
const CAN_FRAMES: usize = 1024;

/// Line driven from outside, with the level last passed to the chip.
struct Watched {
    line: Rc<Line>,
    told: bool,
}

impl Watched {
    fn new(line: Rc<Line>) -> Self {
        let told = line.is_high();
        Self { line, told }
    }
}

/// Other end of one of the chip's UARTs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum UartEnd {
    /// Cable to the host.
    Host,
    /// UART connector, 0 or 1.
    Connector(usize),
}

/// Everything outside the chip that its pins are connected to.
pub struct Wiring {
    world: Rc<RefCell<World>>,
    clock: Clock,
    roles: Roles,
    /// Pins of each encoder's tracks A and B, and of the switch beside it.
    encoders: Vec<[Option<Pin>; 3]>,
    /// Echo pins of the range sensors.
    rangers: Vec<Option<Pin>>,
    dead_man: Watched,
    auxiliary_stop: Watched,
    /// Lights in the order red, green, blue.
    lights: [Box<dyn FnMut(bool)>; 3],
    to_host: Sender,
    uarts: Vec<(u8, UartEnd)>,
    /// Numbers of the I2C controllers: the one for the board's own chips, and those of the external connectors in
    /// order.
    controllers: Vec<(u8, Controller)>,
    /// SCL level of each controller while a program drives it as a GPIO.
    scl_low: Vec<(u8, bool)>,
    /// Number of acknowledged frames on the CAN bus, by identifier.
    can_sent: BTreeMap<u32, u64>,
    /// Newest frames, until they are taken.
    can_frames: VecDeque<CanFrame>,
    /// Outcome of frames that the chip sends.
    can_outcome: CanOutcome,
}

impl Wiring {
    pub(crate) fn new(around: &Environment, to_host: Sender) -> Self {
        let carrier = &around.robot().carrier;
        let light = |light| -> Box<dyn FnMut(bool)> { Box::new(around.light_line(light)) };
        let roles = Roles::new(carrier);
        let encoders = 0..carrier.encoder.connectors.len() as u8;
        let lines = |encoder| {
            let [a, b] = [false, true].map(|b| roles.pin(Role::Track { encoder, b }));
            [a, b, roles.pin(Role::Switch(encoder))]
        };
        let rangers = 0..carrier.range.connectors.len() as u8;
        Self {
            world: around.shared_world(),
            clock: around.clock().clone(),
            encoders: encoders.map(lines).collect(),
            rangers: rangers.map(|sensor| roles.pin(Role::Echo(sensor))).collect(),
            roles,
            dead_man: Watched::new(around.dead_man_line()),
            auxiliary_stop: Watched::new(around.auxiliary_stop_line()),
            lights: [Light::Red, Light::Green, Light::Blue].map(light),
            to_host,
            uarts: uarts(carrier),
            controllers: controllers(carrier),
            scl_low: Vec::new(),
            can_sent: BTreeMap::new(),
            can_frames: VecDeque::new(),
            can_outcome: CanOutcome::Acknowledged,
        }
    }

    /// Borrows the simulated world.
    pub(crate) fn world(&self) -> RefMut<'_, World> {
        self.world.borrow_mut()
    }

    /// Returns the chip's UARTs that are connected, with their other ends.
    pub(crate) fn uarts(&self) -> &[(u8, UartEnd)] {
        &self.uarts
    }

    /// Takes the frames that the board has sent on the CAN connector since the last call, at most the newest
    /// [`CAN_FRAMES`].
    pub(crate) fn take_can_frames(&mut self) -> Vec<CanFrame> {
        self.can_frames.drain(..).collect()
    }

    /// Sets the outcome of frames that the board sends on the CAN connector from now on.
    pub(crate) fn set_can_outcome(&mut self, outcome: CanOutcome) {
        self.can_outcome = outcome;
    }

    /// Returns the number of frames that the chip has sent with a standard identifier.
    pub(crate) fn can_sent(&self, identifier: u16) -> u64 {
        self.can_sent.get(&identifier.into()).copied().unwrap_or(0)
    }

    /// Replaces the cable to the host.
    pub(crate) fn set_host(&mut self, to_host: Sender) {
        self.to_host = to_host;
    }

    /// Handles a reset of the chip: its pins float.
    pub(crate) fn processor_reset(&mut self) {
        self.scl_low.clear();
        self.world.borrow_mut().reset_processor();
    }

    /// Notes that all edges of step and direction lines up to `now_ns` have been reported.
    pub(crate) fn settle(&mut self, now_ns: u64) {
        self.world.borrow_mut().settle_steppers(now_ns);
    }

    /// Takes the next byte that has arrived at a UART connector.
    pub(crate) fn take_uart_arrived(&mut self, connector: usize) -> Option<r4_sim::uart::UartByte> {
        self.world.borrow_mut().take_uart_arrived(connector)
    }

    /// Returns the arrival time of the next byte, ns; `u64::MAX` if none is on its way.
    pub(crate) fn next_uart_arrival_ns(&mut self, connector: usize) -> u64 {
        self.world.borrow_mut().next_uart_arrival_ns(connector)
    }

    fn controller(&self, number: u8) -> Option<Controller> {
        self.controllers.iter().find(|(known, _)| *known == number).map(|(_, controller)| *controller)
    }

    /// Advances the world's clock to the chip's.
    fn follow(&self, now_ns: u64) {
        self.clock.run_ahead(now_ns);
    }

    /// Handles SCL driven by the program as a GPIO: each rising edge is a clock.
    fn scl(&mut self, at_ns: u64, number: u8, low: bool) {
        let was_low = match self.scl_low.iter_mut().find(|(known, _)| *known == number) {
            Some((_, was)) => std::mem::replace(was, low),
            None => {
                self.scl_low.push((number, low));
                false
            }
        };
        if let (true, false, Some(controller)) = (was_low, low, self.controller(number)) {
            self.world.borrow_mut().i2c_clock_pulse(controller, at_ns);
        }
    }
}

impl Outside for Wiring {
    fn drive(&mut self, at_ns: u64, pin: Pin, level: Level) {
        let Some(role) = self.roles.of(pin) else { return };
        self.follow(at_ns);
        // The level of a floating pin follows from the carrier's pull resistors; each role below states its own.
        let or = |floating| match level {
            Level::Low => false,
            Level::High => true,
            Level::Floating(_) => floating,
        };
        match role {
            Role::Step(index) => self.world.borrow_mut().step_line(index.into(), at_ns, or(false)),
            Role::Direction(index) => self.world.borrow_mut().direction_line(index.into(), at_ns, or(false)),
            // A floating enable is pulled to the level at which the drivers are off. The world knows that level and has
            // set it at the reset.
            Role::StepperEnable if matches!(level, Level::Floating(_)) => {}
            Role::StepperEnable => self.world.borrow_mut().set_stepper_enable(or(false)),
            Role::Trigger(index) => self.world.borrow_mut().trigger(index.into(), or(false)),
            Role::OsmcDisable => self.world.borrow_mut().set_osmc_disabled(or(true)),
            Role::PwmDisable => self.world.borrow_mut().set_pwm_outputs_disabled(or(true)),
            Role::LoadDac => self.world.borrow_mut().set_ldac(or(false)),
            Role::Heartbeat => self.world.borrow_mut().set_heartbeat(or(false)),
            Role::Light(index) => {
                if let Some(light) = self.lights.get_mut(usize::from(index)) {
                    light(or(true));
                }
            }
            Role::Scl(controller) => self.scl(at_ns, controller, level == Level::Low),
            // A STOP driven by GPIO is handled by the world with the clocks before it; the other roles are inputs.
            Role::Sda(_)
            | Role::Track { .. }
            | Role::Switch(_)
            | Role::Echo(_)
            | Role::Analog(_)
            | Role::Dac(_)
            | Role::DeadMan
            | Role::AuxiliaryStop
            | Role::Button => {}
        }
    }

    fn poll(&mut self, now_ns: u64, edges: &mut Vec<Edge>) {
        self.follow(now_ns);
        let first = edges.len();
        let mut world = self.world.borrow_mut();
        for (encoder, [a, b, switch]) in self.encoders.iter().enumerate() {
            // Omitted edges are those of a shaft too fast to be counted at all.
            world.take_encoder_edges(encoder, |edge| {
                let pin = match edge.line {
                    EncoderLine::Track(Channel::A) => a,
                    EncoderLine::Track(Channel::B) => b,
                    EncoderLine::Index => switch,
                };
                edges.extend(pin.map(|pin| Edge { at_ns: edge.at_ns, pin, high: edge.high }));
            });
        }
        for (sensor, pin) in self.rangers.iter().enumerate() {
            world.take_echo_edges(sensor, |edge| {
                edges.extend(pin.map(|pin| Edge { at_ns: edge.at_ns, pin, high: edge.high }));
            });
        }
        for (watched, role) in [(&mut self.dead_man, Role::DeadMan), (&mut self.auxiliary_stop, Role::AuxiliaryStop)] {
            let high = watched.line.is_high();
            if std::mem::replace(&mut watched.told, high) != high {
                edges.extend(self.roles.pin(role).map(|pin| Edge { at_ns: now_ns, pin, high }));
            }
        }
        edges[first..].sort_by_key(|edge| edge.at_ns);
    }

    fn next_poll_ns(&mut self, _now_ns: u64, watched: &[Pin]) -> u64 {
        let mut world = self.world.borrow_mut();
        let next = watched.iter().map(|pin| match self.roles.of(*pin) {
            // The switch line may carry the encoder's index track.
            Some(Role::Track { encoder, .. } | Role::Switch(encoder)) => world.next_encoder_change_ns(encoder.into()),
            Some(Role::Echo(sensor)) => world.next_echo_edge_ns(sensor.into()),
            // The other lines change only between runs; the board is polled after each.
            _ => u64::MAX,
        });
        next.min().unwrap_or(u64::MAX)
    }

    fn level(&mut self, now_ns: u64, pin: Pin, pull: Option<bool>) -> bool {
        let pulled = pull.unwrap_or(false);
        let Some(role) = self.roles.of(pin) else { return pulled };
        self.follow(now_ns);
        let mut world = self.world.borrow_mut();
        match role {
            Role::Track { encoder, b } => {
                let levels = world.encoder_levels(encoder.into());
                if b { levels.b } else { levels.a }
            }
            Role::Switch(index) => world.switch_is_high(index.into()),
            Role::Echo(index) => world.echo_is_high(index.into()),
            Role::DeadMan => self.dead_man.line.is_high(),
            Role::AuxiliaryStop => self.auxiliary_stop.line.is_high(),
            Role::Scl(number) | Role::Sda(number) => {
                drop(world);
                let controller = self.controller(number);
                controller.is_none_or(|controller| self.world.borrow_mut().i2c_lines_are_free(controller))
            }
            Role::Button => false,
            Role::Step(_)
            | Role::Direction(_)
            | Role::StepperEnable
            | Role::Trigger(_)
            | Role::Analog(_)
            | Role::Dac(_)
            | Role::OsmcDisable
            | Role::PwmDisable
            | Role::LoadDac
            | Role::Heartbeat
            | Role::Light(_) => pulled,
        }
    }

    fn volts(&mut self, now_ns: u64, pin: Pin) -> f64 {
        let Some(Role::Analog(input)) = self.roles.of(pin) else { return 0.0 };
        self.follow(now_ns);
        self.world.borrow_mut().analog_v(input.into())
    }

    fn set_volts(&mut self, at_ns: u64, pin: Pin, volts: f64) {
        let Some(Role::Dac(output)) = self.roles.of(pin) else { return };
        self.follow(at_ns);
        self.world.borrow_mut().set_dac_v(output.into(), volts.clamp(0.0, REFERENCE_V));
    }

    fn i2c_start(&mut self, controller: u8, at_ns: u64, address: u8, read: bool) -> I2cResponse {
        self.follow(at_ns);
        let Some(controller) = self.controller(controller) else { return I2cResponse::Nack };
        answer(self.world.borrow_mut().i2c_start(controller, at_ns, address, read))
    }

    fn i2c_write(&mut self, controller: u8, at_ns: u64, byte: u8) -> I2cResponse {
        self.follow(at_ns);
        let Some(controller) = self.controller(controller) else { return I2cResponse::Nack };
        answer(self.world.borrow_mut().i2c_write(controller, at_ns, byte))
    }

    fn i2c_read(&mut self, controller: u8, at_ns: u64) -> Option<u8> {
        self.follow(at_ns);
        let controller = self.controller(controller)?;
        self.world.borrow_mut().i2c_read(controller, at_ns)
    }

    fn i2c_stop(&mut self, controller: u8, at_ns: u64) {
        self.follow(at_ns);
        if let Some(controller) = self.controller(controller) {
            self.world.borrow_mut().i2c_stop(controller, at_ns);
        }
    }

    fn i2c_lines(&mut self, controller: u8, now_ns: u64) -> (bool, bool) {
        self.follow(now_ns);
        let Some(controller) = self.controller(controller) else { return (true, true) };
        // The world does not distinguish the two lines, and no controller needs it.
        let free = self.world.borrow_mut().i2c_lines_are_free(controller);
        (free, free)
    }

    fn uart_sent(&mut self, port: u8, at_ns: u64, byte: u8) {
        self.follow(at_ns);
        match self.uarts.iter().find(|(known, _)| *known == port) {
            Some((_, UartEnd::Host)) => self.to_host.push(at_ns, byte),
            Some((_, UartEnd::Connector(connector))) => {
                self.world.borrow_mut().uart_sent(*connector, at_ns, byte);
            }
            None => {}
        }
    }

    fn can_sent(&mut self, _bus: u8, _at_ns: u64, frame: &CanFrame) -> CanOutcome {
        // A host's CAN adapter is on the bus and acknowledges; frames that reach it are counted.
        if self.can_outcome == CanOutcome::Acknowledged {
            *self.can_sent.entry(frame.id).or_default() += 1;
            if self.can_frames.len() == CAN_FRAMES {
                self.can_frames.pop_front();
            }
            self.can_frames.push_back(frame.clone());
        }
        self.can_outcome
    }

    fn wants_to_run(&self) -> bool {
        self.clock.is_anyone_ready()
    }
}

fn answer(response: Response) -> I2cResponse {
    match response {
        Response::Ack => I2cResponse::Ack,
        Response::Nack => I2cResponse::Nack,
        Response::Stuck => I2cResponse::Stuck,
    }
}

/// Parses the number in a signal such as `UART4_TX` or `USART1_TX`.
fn uart_number(carrier: &Carrier, id: &str) -> Option<u8> {
    let signal = carrier.pin(id)?.signal.as_deref()?;
    signal.strip_suffix("_TX")?.trim_start_matches(|letter: char| !letter.is_ascii_digit()).parse().ok()
}

fn uarts(carrier: &Carrier) -> Vec<(u8, UartEnd)> {
    let ends =
        [("uart_dbg_tx", UartEnd::Host), ("uart_a_tx", UartEnd::Connector(0)), ("uart_b_tx", UartEnd::Connector(1))];
    ends.into_iter().filter_map(|(id, end)| Some((uart_number(carrier, id)?, end))).collect()
}

fn controllers(carrier: &Carrier) -> Vec<(u8, Controller)> {
    let number = |id: &str| {
        let signal = carrier.pin(id)?.signal.as_deref()?;
        signal.strip_prefix("I2C")?.split_once('_')?.0.parse().ok()
    };
    let ends = [
        (carrier.i2c.scl.as_str(), Controller::Board),
        ("i2c_ext_scl", Controller::External(0)),
        ("i2c_ext2_scl", Controller::External(1)),
    ];
    ends.into_iter().filter_map(|(id, end)| Some((number(id)?, end))).collect()
}
