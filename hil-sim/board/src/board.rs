//! One simulated board: the firmware's tasks on the world's lines.

use std::{
    cell::{Cell, RefCell, RefMut},
    rc::Rc,
};

use embassy_futures::block_on;
use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use r4_boards::Robot;
use r4_firmware::{
    ResetCause, Shared,
    control::{self, BoardIo},
    link::serve,
    passthrough::PassthroughIo,
    ranging,
    safety::{SafetyPins, supervise},
    screen::{self, ScreenPins},
    storage,
};
use r4_plants::{Effect, Plant, PlantError, PlantSpec, effect::friction::CoulombFriction};
use r4_protocol::ChannelId;

use crate::{
    chips::ili9488::ScreenWiring,
    clock::Clock,
    executor::{Simulation, TaskId},
    flash::Flash,
    io::{BoardBus, FlashPort, UartReceiver, UartTransmitter},
    lines::{InputLine, Line, OutputLine},
    link::{Port, serial},
    world::{Controller, Processor, World},
};

/// Bits per second of the link to the host, as on the board's UART connectors.
const LINK_BAUD: u32 = 1_000_000;

/// Friction that no motor overcomes, N m or N.
const BLOCKED: f64 = 1e3;
/// Clock of the screen's SPI.
const SCREEN_SPI_HZ: u32 = 20_000_000;

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
    robot: Robot,
    world: Rc<RefCell<World>>,
    flash: Rc<RefCell<Flash>>,
    dead_man: Rc<Line>,
    auxiliary_stop: Rc<Line>,
    lights: Rc<Cell<Lights>>,
    host: RefCell<Option<Port>>,
    shared: RefCell<Rc<Shared<NoopRawMutex>>>,
    tasks: RefCell<Vec<TaskId>>,
    screen: RefCell<Option<ScreenWiring>>,
    clock: Clock,
}

/// The lights on the board.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Lights {
    /// Tripped.
    pub red: bool,
    /// Armed.
    pub green: bool,
    /// A host is connected.
    pub blue: bool,
}

impl SimBoard {
    /// Powers up a board for `robot` with nothing saved in its flash, its dead-man's handle held and no stop pressed.
    ///
    /// # Errors
    /// When the robot's file does not describe a world to simulate.
    pub fn start(simulation: &mut Simulation, robot: &Robot, seed: u64) -> Result<Self, SimError> {
        Self::start_with(simulation, robot, seed, Flash::new(storage::SECTORS))
    }

    /// The same with a `flash` that another board has had, or the same one before.
    ///
    /// # Errors
    /// As [`SimBoard::start`].
    pub fn start_with(simulation: &mut Simulation, robot: &Robot, seed: u64, flash: Flash) -> Result<Self, SimError> {
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
        let config = robot.config.clone();
        let board = Self {
            robot: robot.clone(),
            world,
            flash: Rc::new(RefCell::new(flash)),
            dead_man: Line::new(true),
            auxiliary_stop: Line::new(true),
            lights: Rc::default(),
            host: RefCell::new(None),
            shared: RefCell::new(clock.enter(|| Rc::new(Shared::new(config.clone(), config, ResetCause::Normal)))),
            tasks: RefCell::default(),
            screen: RefCell::default(),
            clock,
        };
        board.boot(simulation, ResetCause::Normal);
        Ok(board)
    }

    /// Resets the processor, as a watchdog or a request to restart does: the world and the chips stay as they are, the
    /// firmware starts anew. Hosts have to [`SimBoard::connect`] again.
    pub fn restart(&self, simulation: &mut Simulation, cause: ResetCause) {
        self.tasks.take().into_iter().for_each(|task| simulation.end(task));
        self.world.borrow_mut().reset_processor();
        self.boot(simulation, cause);
    }

    /// Ready when a host has asked for a restart.
    pub async fn restart_requested(&self) {
        let shared = self.shared.borrow().clone();
        shared.restart_requested().await;
    }

    /// Starts the firmware, as the board's binary does.
    fn boot(&self, simulation: &mut Simulation, reset: ResetCause) {
        let (clock, world, built_in) = (&self.clock, &self.world, &self.robot.config);
        // Reading takes no time.
        let mut flash = FlashPort(self.flash.clone());
        let loaded = block_on(storage::parameters::load(&mut flash, built_in));
        let shared = clock.enter(|| Rc::new(Shared::new(loaded.config, built_in.clone(), reset)));
        let (host, device) = serial(clock, LINK_BAUD);

        let drive = |set: fn(&mut World, bool)| {
            let world = world.clone();
            let drive: Box<dyn FnMut(bool)> = Box::new(move |high| set(&mut world.borrow_mut(), high));
            OutputLine::new(drive)
        };
        let light = |set: fn(&mut Lights, bool)| {
            let lights = self.lights.clone();
            let drive: Box<dyn FnMut(bool)> = Box::new(move |high| {
                let mut now = lights.get();
                set(&mut now, !high);
                lights.set(now);
            });
            OutputLine::new(drive)
        };
        let pins = SafetyPins {
            dead_man: InputLine(self.dead_man.clone()),
            auxiliary_stop: InputLine(self.auxiliary_stop.clone()),
            osmc_disable: drive(World::set_osmc_disabled),
            pwm_output_disable: drive(World::set_pwm_outputs_disabled),
            heartbeat: drive(World::set_heartbeat),
            red: light(|lights, on| lights.red = on),
            green: light(|lights, on| lights.green = on),
            blue: light(|lights, on| lights.blue = on),
        };
        let bus = |controller| BoardBus { world: world.clone(), controller };
        let io = BoardIo { bus: bus(Controller::Board), peripherals: Processor(world.clone()) };
        let receiver = |connector| UartReceiver { world: world.clone(), connector };
        let transmitter = |connector| UartTransmitter { world: world.clone(), connector };
        let raw = PassthroughIo {
            i2c: [bus(Controller::External(0)), bus(Controller::External(1))],
            uart_rx: [receiver(0), receiver(1)],
            uart_tx: [transmitter(0), transmitter(1)],
        };
        let hardware = Processor(world.clone());
        // Highest priority first, as the board's interrupt executors have it.
        let mut tasks = Vec::new();
        let of = shared.clone();
        tasks.push(simulation.spawn(async move { supervise(&of, pins).await }));
        let of = shared.clone();
        tasks.push(simulation.spawn(async move { control::run(&of, io).await }));
        if !built_in.ranges.is_empty() {
            let of = shared.clone();
            tasks.push(simulation.spawn(async move {
                let config = of.config();
                let publish = |index, reading| of.publish_range(index, reading);
                ranging::run(&config.ranges, config.air_temperature_c, hardware, publish).await
            }));
        }
        let of = shared.clone();
        tasks.push(simulation.spawn(async move { serve(&of, 0, device.rx, device.tx).await }));
        let of = shared.clone();
        tasks.push(simulation.spawn(async move { of.passthrough.run(raw).await }));
        let (of, robot) = (shared.clone(), built_in.robot.clone());
        tasks.push(simulation.spawn(async move { storage::run(&of.storage, flash, &robot).await }));
        self.tasks.replace(tasks);
        self.shared.replace(shared);
        if self.screen.borrow().is_some() {
            self.start_screen(simulation);
        }
        self.host.replace(Some(host));
    }

    /// The robot that it is.
    #[must_use]
    pub fn robot(&self) -> &Robot {
        &self.robot
    }

    /// Blocks what a motor drives, or gives it the physics of the robot's file again; at rest where it is.
    ///
    /// # Errors
    /// When its plant cannot be blocked.
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

    /// Plugs a screen in, and starts the firmware's task for it. Returns the screen, to look at.
    ///
    /// Not part of every simulated board: most runs look at no screen, and drawing costs them time.
    pub fn plug_screen(&self, simulation: &mut Simulation) -> ScreenWiring {
        let wiring = ScreenWiring::new(self.clock.clone(), SCREEN_SPI_HZ);
        self.screen.replace(Some(wiring.clone()));
        self.start_screen(simulation);
        wiring
    }

    fn start_screen(&self, simulation: &mut Simulation) {
        let Some(wiring) = self.screen.borrow().clone() else { return };
        let pins = ScreenPins {
            spi: wiring.spi(),
            data_command: wiring.data_command(),
            reset: wiring.reset(),
            backlight: wiring.backlight(),
        };
        let shared = self.shared.borrow().clone();
        self.tasks.borrow_mut().push(simulation.spawn(async move { screen::run(&*shared, pins).await }));
    }

    /// The host's end of the link; `None` after the first call since the board started.
    pub fn connect(&self) -> Option<Port> {
        self.host.take()
    }

    /// The world, to look at and to break. Must not be kept over an `await`.
    #[must_use]
    pub fn world(&self) -> RefMut<'_, World> {
        self.world.borrow_mut()
    }

    /// The processor's flash, to look at and to cut the power of. Must not be kept over an `await`.
    #[must_use]
    pub fn flash(&self) -> RefMut<'_, Flash> {
        self.flash.borrow_mut()
    }

    /// The dead-man's handle: high while held.
    #[must_use]
    pub fn dead_man(&self) -> &Line {
        &self.dead_man
    }

    /// The auxiliary stop: high while not pressed.
    #[must_use]
    pub fn auxiliary_stop(&self) -> &Line {
        &self.auxiliary_stop
    }

    /// The lights on the board.
    #[must_use]
    pub fn lights(&self) -> Lights {
        self.lights.get()
    }
}
