//! The emulated board: a machine that runs as one task of a simulation.

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
use r4_sim::{Clock, SimError, Simulation, Surroundings, VirtualBoard, flash::Flash, link::Receiver};

use crate::{
    flash::Cells,
    watch::{SharedMachine, Watcher, Watchers},
    wiring::{UartEnd, Wiring},
};

/// Sectors of flash for parameters and trips.
const KEPT_SECTORS: usize = 4;
/// Longest stretch in which nobody else is asked, ns: whoever presses a key is noticed after it.
const SLICE_NS: u64 = 10_000_000;

/// A byte at the host's rate, ns: the chip's receiver is told of it when it begins.
const FRAME_NS: u64 = 10_000;

/// The chip with everything around it.
pub type BoardSoc = Soc<Wiring, Cells>;

/// Why a board cannot be emulated.
#[derive(Debug, thiserror::Error)]
pub enum EmuError {
    /// The world around it.
    #[error(transparent)]
    Surroundings(#[from] SimError),
    /// The processor or its program.
    #[error(transparent)]
    Machine(#[from] MachineError),
    /// The program's file.
    #[error(transparent)]
    Load(#[from] LoadError),
}

/// A board whose processor is emulated.
pub struct EmuBoard<C> {
    surroundings: Surroundings,
    machine: Rc<RefCell<Machine<C, BoardSoc>>>,
    failure: Rc<RefCell<Option<MachineError>>>,
    from_host: Rc<RefCell<Receiver>>,
    watchers: Rc<RefCell<Watchers<C>>>,
    pub(crate) segments: Vec<Segment>,
}

impl<C: Core + 'static> EmuBoard<C> {
    /// Powers up a board for `robot` with `image` in its flash and nothing kept, or with what another had kept.
    ///
    /// # Errors
    /// When there is no world to simulate, or the image is not one for this processor.
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
        let surroundings = Surroundings::new(clock.clone(), robot, seed, kept)?;
        let link = surroundings.new_link();
        let wiring = Wiring::new(&surroundings, link.tx);
        let mut soc = Soc::new(wiring, Oscillators::default(), Cells::new(surroundings.shared_flash()));
        if let Some(start) = image.start() {
            soc.set_boot_address(start);
        }
        let mut machine = Machine::new(core, soc, settings)?;
        machine.load_elf(image.elf())?;
        machine.reset(ResetCause::PowerOn)?;
        let board = Self {
            surroundings,
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

    /// The machine, to look into and to break. Must not be kept over an `await`.
    pub fn machine(&self) -> RefMut<'_, Machine<C, BoardSoc>> {
        self.machine.borrow_mut()
    }

    /// The processor's main crystal stops at `at_ns` of virtual time, or at once if that is past. It does not start again.
    pub fn stop_crystal_at(&self, at_ns: u64) {
        self.machine().chip.stop_crystal_at(at_ns);
    }

    /// The processor's 3.3 V fall to `volts` at `at_ns` of virtual time, and are back `for_ns` later. What the chip makes of it
    /// follows from its detectors and option bytes; the other chips of the board do not notice.
    pub fn dip_supply(&self, at_ns: u64, volts: f64, for_ns: u64) {
        let mut machine = self.machine();
        machine.chip.supply_at(at_ns, (volts * 1e3).round().max(0.0) as u32);
        machine.chip.supply_at(at_ns.saturating_add(for_ns), r4_mcu::peripherals::pwr::NOMINAL_MV);
    }

    /// The same, for those who keep it.
    #[must_use]
    pub fn shared_machine(&self) -> SharedMachine<C> {
        self.machine.clone()
    }

    /// Lets somebody look at the machine between its runs, from the next one on.
    pub fn watch(&self, watcher: impl Watcher<C> + 'static) {
        self.watchers.borrow_mut().add(Box::new(watcher));
    }
}

impl<C> Deref for EmuBoard<C> {
    type Target = Surroundings;

    fn deref(&self) -> &Surroundings {
        &self.surroundings
    }
}

/// The machine as a task.
struct Run<C> {
    machine: Rc<RefCell<Machine<C, BoardSoc>>>,
    from_host: Rc<RefCell<Receiver>>,
    clock: Clock,
    watchers: Rc<RefCell<Watchers<C>>>,
}

impl<C: Core> Run<C> {
    /// Runs until it cannot go on.
    async fn forever(self) -> MachineError {
        loop {
            // Whoever is ready at this moment runs before the processor's next instruction.
            self.clock.give_way().await;
            let limit_ns = self.deliver();
            let stopped = match self.watchers.borrow_mut().run(&self.machine, limit_ns) {
                Ok(stopped) => stopped,
                Err(error) => return error,
            };
            if let Reason::Reset(_) = stopped.reason {
                self.machine.borrow_mut().chip.outside().processor_reset();
            }
            // Edges of step lines up to now have been told.
            let now_ns = self.clock.run_ahead(stopped.at_ns);
            self.machine.borrow_mut().chip.outside().settle(now_ns);
        }
    }

    /// Hands over what arrived from outside, and says until when nothing more comes.
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
        let link = self.surroundings.new_link();
        self.from_host.replace(link.rx);
        let mut machine = self.machine.borrow_mut();
        machine.chip.outside().set_host(link.tx);
        let reset = machine.reset(match cause {
            r4_firmware::ResetCause::Normal => ResetCause::Software,
            // What a processor can be told from outside; the image makes the others of what it has noted.
            _ => ResetCause::Watchdog,
        });
        if let Err(error) = reset {
            self.failure.replace(Some(error));
        }
    }
}
