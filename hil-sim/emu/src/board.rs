//! Emulated board: a machine that runs as one task of a simulation.

use std::{
    cell::{RefCell, RefMut},
    ops::Deref,
    rc::Rc,
};

use r4_boards::Robot;
use r4_image::{Image, Segment};
use r4_mcu::{
    LoadError, Machine, MachineError, Reason, ResetCause, Settings, UartByte, cpu::Core, peripherals::rcc::Oscillators,
    soc::Soc,
};
use r4_sim::{Clock, Environment, SimError, Simulation, VirtualBoard, flash::Flash, link::Receiver};

use crate::{
    flash::Cells,
    watch::{SharedMachine, Watcher, Watchers},
    wiring::{UartEnd, Wiring},
};

/// Number of flash sectors for parameters and trips.
const KEPT_SECTORS: usize = 4;
/// Longest run of the machine before other tasks get their turn, ns; a key press is noticed within it.
const SLICE_NS: u64 = 10_000_000;

/// Duration of one byte at the host's baud rate, ns: the chip's receiver gets a byte at its start bit.
const FRAME_NS: u64 = 10_000;

/// The chip with its wiring and kept flash cells.
pub type BoardSoc = Soc<Wiring, Cells>;

/// Reason why a board cannot be emulated.
#[derive(Debug, thiserror::Error)]
pub enum EmuError {
    /// The environment cannot be simulated.
    #[error(transparent)]
    Environment(#[from] SimError),
    /// The processor cannot run, or not go on.
    #[error(transparent)]
    Machine(#[from] MachineError),
    /// The program's file cannot be loaded.
    #[error(transparent)]
    Load(#[from] LoadError),
}

/// Board with an emulated processor.
pub struct EmuBoard<C> {
    environment: Environment,
    machine: Rc<RefCell<Machine<C, BoardSoc>>>,
    failure: Rc<RefCell<Option<MachineError>>>,
    from_host: Rc<RefCell<Receiver>>,
    watchers: Rc<RefCell<Watchers<C>>>,
    pub(crate) segments: Vec<Segment>,
}

impl<C: Core + 'static> EmuBoard<C> {
    /// Powers up a board for `robot` with `image` in its flash, and with empty kept sectors or those of another board.
    ///
    /// # Errors
    /// When the world cannot be simulated, or the image is not one for this processor.
    pub fn start(
        simulation: &mut Simulation,
        robot: &Robot,
        seed: u64,
        image: &Image,
        core: C,
        kept: Option<Flash>,
        settings: Settings,
    ) -> Result<Self, EmuError> {
        let clock = simulation.clock();
        let kept = kept.unwrap_or_else(|| Flash::new(KEPT_SECTORS));
        let environment = Environment::new(clock.clone(), robot, seed, kept)?;
        let link = environment.new_link();
        let wiring = Wiring::new(&environment, link.tx);
        let mut soc = Soc::new(wiring, Oscillators::default(), Cells::new(environment.shared_flash()));
        if let Some(start) = image.start() {
            soc.set_boot_address(start);
        }
        let mut machine = Machine::new(core, soc, settings)?;
        machine.load_elf(image.elf())?;
        // After loading, because the reset reads the vector table.
        machine.reset(ResetCause::PowerOn)?;
        let board = Self {
            environment,
            machine: Rc::new(RefCell::new(machine)),
            failure: Rc::default(),
            from_host: Rc::new(RefCell::new(link.rx)),
            watchers: Rc::default(),
            segments: image.segments(),
        };
        let (machine, from_host) = (board.machine.clone(), board.from_host.clone());
        let run = Run { machine, from_host, clock, watchers: board.watchers.clone() };
        let failure = board.failure.clone();
        simulation.spawn(async move {
            let error = run.forever().await;
            failure.replace(Some(error));
        });
        Ok(board)
    }

    /// Borrows the machine, to inspect or break it. The borrow must end before an `await`.
    pub fn machine(&self) -> RefMut<'_, Machine<C, BoardSoc>> {
        self.machine.borrow_mut()
    }

    /// Stops the processor's main crystal at `at_ns` of virtual time, or at once if that is past. It does not start
    /// again.
    pub fn stop_crystal_at(&self, at_ns: u64) {
        self.machine().chip.stop_crystal_at(at_ns);
    }

    /// Lowers the processor's 3.3 V supply to `volts` at `at_ns` of virtual time, and restores it `for_ns` later. The
    /// effect follows from the chip's detectors and option bytes; the other chips of the board do not notice.
    pub fn dip_supply(&self, at_ns: u64, volts: f64, for_ns: u64) {
        let mut machine = self.machine();
        machine.chip.supply_at(at_ns, (volts * 1e3).round().max(0.0) as u32);
        machine.chip.supply_at(at_ns.saturating_add(for_ns), r4_mcu::peripherals::pwr::NOMINAL_MV);
    }

    /// Returns the machine for users that keep it.
    #[must_use]
    pub fn shared_machine(&self) -> SharedMachine<C> {
        self.machine.clone()
    }

    /// Adds a watcher, called before and after each run of the machine from the next one on.
    pub fn watch(&self, watcher: impl Watcher<C> + 'static) {
        self.watchers.borrow_mut().add(Box::new(watcher));
    }
}

impl<C> Deref for EmuBoard<C> {
    type Target = Environment;

    fn deref(&self) -> &Environment {
        &self.environment
    }
}

/// Task that runs the machine.
struct Run<C> {
    machine: Rc<RefCell<Machine<C, BoardSoc>>>,
    from_host: Rc<RefCell<Receiver>>,
    clock: Clock,
    watchers: Rc<RefCell<Watchers<C>>>,
}

impl<C: Core> Run<C> {
    /// Runs until the machine fails; returns that error.
    async fn forever(self) -> MachineError {
        loop {
            // Tasks that are ready at this moment run before the processor's next instruction.
            self.clock.give_way().await;
            let limit_ns = self.deliver();
            let stopped = match self.watchers.borrow_mut().run(&self.machine, limit_ns) {
                Ok(stopped) => stopped,
                Err(error) => return error,
            };
            if let Reason::Reset(_) = stopped.reason {
                self.machine.borrow_mut().chip.outside().processor_reset();
            }
            // All edges of step lines up to now have reached the world.
            let now_ns = self.clock.run_ahead(stopped.at_ns);
            self.machine.borrow_mut().chip.outside().settle(now_ns);
        }
    }

    /// Delivers the bytes that have arrived from outside; returns the time up to which no more arrive, ns.
    fn deliver(&self) -> u64 {
        let now_ns = self.clock.now_ns();
        let mut machine = self.machine.borrow_mut();
        let soc = &mut machine.chip;
        let mut next_ns = now_ns + SLICE_NS;
        let uarts = soc.outside().uarts().to_vec();
        for (port, end) in uarts {
            loop {
                let arrived = match end {
                    UartEnd::Host => self.from_host.borrow_mut().take_arrived(now_ns + FRAME_NS),
                    UartEnd::Connector(connector) => soc.outside().take_uart_arrived(connector),
                };
                let Some(byte) = arrived else { break };
                let r4_sim::uart::UartByte { at_ns, value, framing_error, noise } = byte;
                soc.uart_receive(port, UartByte { at_ns: at_ns.max(now_ns), value, framing_error, noise });
            }
            let arrives_ns = match end {
                UartEnd::Host => {
                    let next_ns = self.from_host.borrow().next_arrival_ns();
                    next_ns.map_or(u64::MAX, |at_ns| at_ns.saturating_sub(FRAME_NS))
                }
                UartEnd::Connector(connector) => soc.outside().next_uart_arrival_ns(connector),
            };
            next_ns = next_ns.min(arrives_ns);
        }
        soc.poll_outside();
        next_ns.min(self.clock.next_wake().unwrap_or(u64::MAX)).max(now_ns)
    }
}

impl<C: Core + 'static> VirtualBoard for EmuBoard<C> {
    fn failure(&self) -> Option<String> {
        self.failure.borrow().as_ref().map(ToString::to_string)
    }

    fn restart(&self, _simulation: &mut Simulation, cause: r4_firmware::ResetCause) {
        let link = self.environment.new_link();
        // The old cable's bytes end with the session that the restart ends.
        self.from_host.replace(link.rx);
        let mut machine = self.machine.borrow_mut();
        machine.chip.outside().set_host(link.tx);
        let reset = machine.reset(match cause {
            r4_firmware::ResetCause::Normal => ResetCause::Software,
            // Only these two causes can be set from outside; the image derives the others from its own record.
            _ => ResetCause::Watchdog,
        });
        if let Err(error) = reset {
            self.failure.replace(Some(error));
        }
    }
}
