//! One simulated board: the firmware's tasks on the world's lines.

use std::{
    cell::{RefCell, RefMut},
    rc::Rc,
};

use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use r4_boards::Robot;
use r4_firmware::{
    ResetCause, Shared,
    control::{self, BoardIo},
    link::serve,
    safety::{SafetyPins, supervise},
};
use r4_plants::PlantError;
use r4_protocol::ChannelId;

use crate::{
    executor::Simulation,
    io::BoardBus,
    lines::{InputLine, Line, OutputLine},
    link::{Port, serial},
    world::{Processor, World},
};

/// Bits per second of the link to the host, as on the board's UART connectors.
const LINK_BAUD: u32 = 1_000_000;

/// Why a board cannot be simulated.
#[derive(Debug, thiserror::Error)]
pub enum SimError {
    /// Its file does not say what is true.
    #[error("{file} has no [simulation] part, so there is no world to simulate: add one")]
    NoSimulation {
        /// Of the robot.
        file: String,
    },
    /// A motor starts where it cannot be.
    #[error("{file}: {channel} starts at {start}, beyond its end stop at {stop}: correct its start in [simulation]")]
    StartBeyondStop {
        /// Of the robot.
        file: String,
        /// Which motor.
        channel: ChannelId,
        /// rad or m
        start: f64,
        /// rad or m
        stop: f64,
    },
    /// A plant's file is wrong.
    #[error(transparent)]
    Plant(#[from] PlantError),
}

/// A board that runs in a [`Simulation`].
pub struct SimBoard {
    world: Rc<RefCell<World>>,
    dead_man: Rc<Line>,
    host: RefCell<Option<Port>>,
}

impl SimBoard {
    /// Powers up a board for `robot`, with its dead-man's handle held.
    ///
    /// # Errors
    /// When the robot's file does not describe a world to simulate.
    pub fn start(simulation: &mut Simulation, robot: &Robot, seed: u64) -> Result<Self, SimError> {
        if robot.simulation.is_empty() {
            return Err(SimError::NoSimulation { file: robot.file.clone() });
        }
        let clock = simulation.clock();
        let world = Rc::new(RefCell::new(World::new(robot, clock.clone(), seed)?));
        for motor in &robot.simulation.motors {
            let stop = world.borrow_mut().position(motor.channel).unwrap_or(motor.start);
            if stop != motor.start {
                let (file, channel, start) = (robot.file.clone(), motor.channel, motor.start);
                return Err(SimError::StartBeyondStop { file, channel, start, stop });
            }
        }
        let dead_man = Line::new(true);
        let shared: Rc<Shared<NoopRawMutex>> =
            clock.enter(|| Rc::new(Shared::new(robot.config.clone(), ResetCause::Normal)));
        let (host, device) = serial(&clock, LINK_BAUD);

        let drive = |set: fn(&mut World, bool)| {
            let world = world.clone();
            OutputLine::new(move |high| set(&mut world.borrow_mut(), high))
        };
        let pins = SafetyPins {
            dead_man: InputLine(dead_man.clone()),
            osmc_disable: drive(World::set_osmc_disabled),
            pwm_output_disable: drive(World::set_pwm_outputs_disabled),
            // No external watchdog on this board yet.
            heartbeat: drive(|_, _| {}),
        };
        let io = BoardIo { bus: BoardBus(world.clone()), peripherals: Processor(world.clone()) };
        // Highest priority first, as the board's interrupt executors have it.
        let of_supervisor = shared.clone();
        simulation.spawn(async move { supervise(&of_supervisor, pins).await });
        let of_control = shared.clone();
        simulation.spawn(async move { control::run(&of_control, io).await });
        simulation.spawn(async move { serve(&shared, 0, device.rx, device.tx).await });
        Ok(Self { world, dead_man, host: RefCell::new(Some(host)) })
    }

    /// The host's end of the link; `None` after the first call.
    pub fn connect(&self) -> Option<Port> {
        self.host.take()
    }

    /// The world, to look at and to break. Must not be kept over an `await`.
    #[must_use]
    pub fn world(&self) -> RefMut<'_, World> {
        self.world.borrow_mut()
    }

    /// The dead-man's handle: high while held.
    #[must_use]
    pub fn dead_man(&self) -> &Line {
        &self.dead_man
    }
}
