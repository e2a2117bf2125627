//! Simulated board: the firmware's tasks on the world's lines.

use std::{cell::RefCell, ops::Deref, pin::Pin, rc::Rc};

use embassy_futures::block_on;
use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use r4_boards::Robot;
use r4_firmware::{
    ResetCause, Shared,
    control::{self, BoardIo},
    link::serve,
    passthrough::PassthroughIo,
    ranging,
    screen::{self, ScreenPins},
    storage,
    supervisor::{SafetyPins, supervise},
};

use crate::{
    chips::ili9488::ScreenWiring,
    environment::{Environment, Light, SimError, VirtualBoard},
    executor::{Simulation, TaskId},
    flash::Flash,
    io::{BoardBus, FlashPort, UartReceiver, UartTransmitter},
    lines::{InputLine, OutputLine},
    world::{Controller, Processor, World},
};

/// Clock frequency of the screen's SPI, Hz.
const SCREEN_SPI_HZ: u32 = 20_000_000;

/// A board that runs the firmware's own tasks in a [`Simulation`].
pub struct SimBoard {
    environment: Environment,
    shared: RefCell<Rc<Shared<NoopRawMutex>>>,
    tasks: RefCell<Vec<TaskId>>,
    screen: RefCell<Option<ScreenWiring>>,
}

impl Deref for SimBoard {
    type Target = Environment;

    fn deref(&self) -> &Environment {
        &self.environment
    }
}

impl VirtualBoard for SimBoard {
    fn restart(&self, simulation: &mut Simulation, cause: ResetCause) {
        self.tasks.take().into_iter().for_each(|task| simulation.end(task));
        self.world().reset_processor();
        self.boot(simulation, cause);
    }

    fn restart_requested(&self) -> Pin<Box<dyn Future<Output = ()> + '_>> {
        let shared = self.shared.borrow().clone();
        // a simulated board has no bootloader, so both kinds of restart are the same
        Box::pin(async move {
            shared.restart_requested().await;
        })
    }
}

impl SimBoard {
    /// Powers up a board for `robot` with nothing saved in its flash, its dead-man's handle held and no stop pressed.
    ///
    /// # Errors
    /// [`SimError`] if the robot's file does not describe a world to simulate.
    pub fn start(simulation: &mut Simulation, robot: &Robot, seed: u64) -> Result<Self, SimError> {
        Self::start_with(simulation, robot, seed, Flash::new(storage::SECTORS))
    }

    /// As [`SimBoard::start`], with a `flash` of an earlier board.
    ///
    /// # Errors
    /// As [`SimBoard::start`].
    pub fn start_with(simulation: &mut Simulation, robot: &Robot, seed: u64, flash: Flash) -> Result<Self, SimError> {
        let environment = Environment::new(simulation.clock(), robot, seed, flash)?;
        let config = robot.config.clone();
        let shared = || Rc::new(Shared::new(config.clone(), config.clone(), ResetCause::Normal));
        let board = Self {
            shared: RefCell::new(environment.clock().enter(shared)),
            environment,
            tasks: RefCell::default(),
            screen: RefCell::default(),
        };
        board.boot(simulation, ResetCause::Normal);
        Ok(board)
    }

    /// Starts the firmware's tasks, as the board's binary does.
    fn boot(&self, simulation: &mut Simulation, reset: ResetCause) {
        let (clock, world, built_in) = (self.clock(), self.shared_world(), &self.robot().config);
        // reading the flash takes no time
        let mut flash = FlashPort(self.shared_flash());
        let loaded = block_on(storage::parameters::load(&mut flash, built_in));
        let shared = clock.enter(|| Rc::new(Shared::new(loaded.config, built_in.clone(), reset)));
        let device = self.new_link();

        let drive = |set: fn(&mut World, bool)| {
            let world = world.clone();
            let drive: Box<dyn FnMut(bool)> = Box::new(move |high| set(&mut world.borrow_mut(), high));
            OutputLine::new(drive)
        };
        let light = |light| {
            let drive: Box<dyn FnMut(bool)> = Box::new(self.light_line(light));
            OutputLine::new(drive)
        };
        let pins = SafetyPins {
            dead_man: InputLine(self.dead_man_line()),
            auxiliary_stop: InputLine(self.auxiliary_stop_line()),
            osmc_disable: drive(World::set_osmc_disabled),
            pwm_output_disable: drive(World::set_pwm_outputs_disabled),
            heartbeat: drive(World::set_heartbeat),
            red: light(Light::Red),
            green: light(Light::Green),
            blue: light(Light::Blue),
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
        // highest priority first, as in the board's interrupt executors
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
    }

    /// Connects a screen, and starts the firmware's task for it. Returns the screen, for queries.
    ///
    /// Not part of every simulated board: most runs do not query a screen, and drawing costs them time.
    pub fn plug_screen(&self, simulation: &mut Simulation) -> ScreenWiring {
        let wiring = ScreenWiring::new(self.clock().clone(), SCREEN_SPI_HZ);
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
}
