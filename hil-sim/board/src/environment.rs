//! Environment of a board's processor, independent of what runs on it: the world, stop lines, lights, flash and the
//! link to the host.

use std::{
    cell::{Cell, RefCell, RefMut},
    future::pending,
    ops::Deref,
    pin::Pin,
    rc::Rc,
};

use r4_boards::Robot;
use r4_firmware::ResetCause;
use r4_plants::{Effect, Plant, PlantError, PlantSpec, effect::friction::CoulombFriction};
use r4_protocol::ChannelId;

use crate::{
    clock::Clock,
    executor::Simulation,
    flash::Flash,
    lines::Line,
    link::{Cable, Port, serial},
    uart::LineNoise,
    world::World,
};

/// Bit rate of the link to the host, bits/s, as on the board's UART connectors.
const LINK_BAUD: u32 = 1_000_000;
/// Friction of a blocked motor, which none overcomes, N m or N.
const BLOCKED: f64 = 1e3;

/// Reasons why a board cannot be simulated.
#[derive(Debug, thiserror::Error)]
pub enum SimError {
    /// File without a description of the simulated world.
    #[error("{file} has no [simulation] part, so there is no world to simulate: add one")]
    NoSimulation {
        /// Name of the robot's file.
        file: String,
    },
    /// Motor that starts beyond an end stop.
    #[error("{file}: {channel} starts at {start}, beyond its end stop at {stop}: correct its start in [simulation]")]
    StartBeyondStop {
        /// Name of the robot's file.
        file: String,
        /// Channel of the motor.
        channel: ChannelId,
        /// Start position, rad or m.
        start: f64,
        /// Position of the end stop, rad or m.
        stop: f64,
    },
    /// Error in a plant's file.
    #[error(transparent)]
    Plant(#[from] PlantError),
}

/// A board in a [`Simulation`], for programs and tests that do not depend on what runs on its processor: the firmware's
/// own tasks ([`SimBoard`](crate::SimBoard)) or an emulated chip.
pub trait VirtualBoard: Deref<Target = Environment> {
    /// Resets the processor, as a watchdog or a request to restart does: the world and the chips keep their state, the
    /// firmware starts anew. Hosts have to connect again.
    fn restart(&self, simulation: &mut Simulation, cause: ResetCause);

    /// Ready when a host has requested a restart that the caller has to execute: see [`VirtualBoard::restart`]. An
    /// emulated processor resets itself.
    fn restart_requested(&self) -> Pin<Box<dyn Future<Output = ()> + '_>> {
        Box::pin(pending())
    }

    /// Reason why the board has stopped permanently, if it has: an emulated processor reached something that its models
    /// lack.
    fn failure(&self) -> Option<String> {
        None
    }
}

/// State of the lights on the board.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Lights {
    /// Red light, on while tripped.
    pub red: bool,
    /// Green light, on while armed.
    pub green: bool,
    /// Blue light, on while a host is connected.
    pub blue: bool,
}

/// One of the lights on the board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Light {
    /// The red light, [`Lights::red`].
    Red,
    /// The green light, [`Lights::green`].
    Green,
    /// The blue light, [`Lights::blue`].
    Blue,
}

/// Environment of a processor, see the module. A board owns one, and shares parts of it with its processor.
pub struct Environment {
    robot: Robot,
    clock: Clock,
    world: Rc<RefCell<World>>,
    flash: Rc<RefCell<Flash>>,
    dead_man: Rc<Line>,
    auxiliary_stop: Rc<Line>,
    lights: Rc<Cell<Lights>>,
    host: RefCell<Option<Port>>,
    cable: RefCell<Option<Cable>>,
    link_baud: Cell<u32>,
}

impl Environment {
    /// The environment of a board for `robot`, on `clock`, which must be at 0: the dead-man's handle is held, no stop
    /// is pressed, lights are off, no host is connected.
    ///
    /// # Errors
    /// [`SimError`] if the robot's file does not describe a world to simulate.
    pub fn new(clock: Clock, robot: &Robot, seed: u64, flash: Flash) -> Result<Self, SimError> {
        if robot.simulation.is_empty() {
            return Err(SimError::NoSimulation { file: robot.file.clone() });
        }
        let mut world = World::new(robot, clock.clone(), seed)?;
        for motor in &robot.simulation.motors {
            let stop = world.position(motor.channel).unwrap_or(motor.start);
            if stop != motor.start {
                let (file, channel, start) = (robot.file.clone(), motor.channel, motor.start);
                return Err(SimError::StartBeyondStop { file, channel, start, stop });
            }
        }
        Ok(Self {
            robot: robot.clone(),
            clock,
            world: Rc::new(RefCell::new(world)),
            flash: Rc::new(RefCell::new(flash)),
            dead_man: Line::new(true),
            auxiliary_stop: Line::new(true),
            lights: Rc::default(),
            host: RefCell::new(None),
            cable: RefCell::new(None),
            link_baud: Cell::new(LINK_BAUD),
        })
    }

    // interface for programs and tests

    /// Robot that the board belongs to.
    #[must_use]
    pub fn robot(&self) -> &Robot {
        &self.robot
    }

    /// The world, for queries and faults. Must not be kept over an `await`.
    #[must_use]
    pub fn world(&self) -> RefMut<'_, World> {
        self.world.borrow_mut()
    }

    /// The processor's flash, for inspection and power cuts. Must not be kept over an `await`.
    #[must_use]
    pub fn flash(&self) -> RefMut<'_, Flash> {
        self.flash.borrow_mut()
    }

    /// Line of the dead-man's handle: high while held.
    #[must_use]
    pub fn dead_man(&self) -> &Line {
        &self.dead_man
    }

    /// Line of the auxiliary stop: high while not pressed.
    #[must_use]
    pub fn auxiliary_stop(&self) -> &Line {
        &self.auxiliary_stop
    }

    /// Present state of the lights.
    #[must_use]
    pub fn lights(&self) -> Lights {
        self.lights.get()
    }

    /// The host's end of the link; `None` after the first call since the board started.
    pub fn connect(&self) -> Option<Port> {
        self.host.take()
    }

    /// Sets the bit rate of the link from now on, bits/s; 1 Mbit/s before. The link of a simulated board can be as fast
    /// as USB, or take no time at all; that of an emulated one has the rate of the UART that its firmware has set up.
    pub fn set_link_baud(&self, baud: u32) {
        self.link_baud.set(baud);
        if let Some(cable) = &*self.cable.borrow() {
            cable.set_baud(baud);
        }
    }

    /// Disturbs the link from now on, to the device and to the host; `None` is a quiet line. Ends with the next start
    /// of the processor.
    pub fn disturb_link(&self, to_device: Option<LineNoise>, to_host: Option<LineNoise>) {
        if let Some(cable) = &*self.cable.borrow() {
            cable.disturb_to_device(to_device);
            cable.disturb_to_host(to_host);
        }
    }

    /// Blocks the load of a motor, or restores the physics of the robot's file; at rest at the present position.
    ///
    /// # Errors
    /// [`PlantError`] if its plant cannot be blocked.
    pub fn block_motor(&self, channel: ChannelId, blocked: bool) -> Result<(), PlantError> {
        let Some(motor) = self.robot.simulation.motors.iter().find(|motor| motor.channel == channel) else {
            return Ok(());
        };
        let mut spec = PlantSpec::from_toml(&motor.plant.name, &motor.plant.text)?;
        if blocked {
            let pushed = spec.push_effect(Effect::CoulombFriction(CoulombFriction { level: BLOCKED }));
            pushed.map_err(|error| PlantError::Field { source_name: motor.plant.name.clone(), line: 0, error })?;
        }
        self.world().set_plant(channel, Plant::new(&spec, 1));
        Ok(())
    }

    // interface for the implementation of a board

    /// The clock of the environment.
    #[must_use]
    pub fn clock(&self) -> &Clock {
        &self.clock
    }

    /// The world, shared with the processor.
    #[must_use]
    pub fn shared_world(&self) -> Rc<RefCell<World>> {
        self.world.clone()
    }

    /// The flash, shared with the processor.
    #[must_use]
    pub fn shared_flash(&self) -> Rc<RefCell<Flash>> {
        self.flash.clone()
    }

    /// The dead-man's line, shared with the processor.
    #[must_use]
    pub fn dead_man_line(&self) -> Rc<Line> {
        self.dead_man.clone()
    }

    /// The auxiliary stop's line, shared with the processor.
    #[must_use]
    pub fn auxiliary_stop_line(&self) -> Rc<Line> {
        self.auxiliary_stop.clone()
    }

    /// Function for the processor's line to a light, which is on while the line is low.
    pub fn light_line(&self, light: Light) -> impl FnMut(bool) + use<> {
        let lights = self.lights.clone();
        move |high| {
            let mut now = lights.get();
            let place = match light {
                Light::Red => &mut now.red,
                Light::Green => &mut now.green,
                Light::Blue => &mut now.blue,
            };
            *place = !high;
            lights.set(now);
        }
    }

    /// Creates a new link for a processor that starts, and returns its end; the other end waits for
    /// [`connect`](Self::connect).
    #[must_use]
    pub fn new_link(&self) -> Port {
        let (host, device) = serial(&self.clock, self.link_baud.get());
        self.cable.replace(Some(Cable::of(&device)));
        self.host.replace(Some(host));
        device
    }
}
