//! Who looks at the machine between its runs: a log, a trace, a debugger.

use std::{cell::RefCell, rc::Rc};

use r4_mcu::{Machine, MachineError, Reason, Stopped, cpu::Core};

use crate::board::BoardSoc;

/// The machine, shared with those who watch it.
pub type SharedMachine<C> = Rc<RefCell<Machine<C, BoardSoc>>>;

/// How a watcher wants the machine to go on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Go {
    /// To this moment at the latest, in virtual nanoseconds.
    Until(u64),
    /// By one instruction.
    Step,
}

/// Looks at the machine between its runs. Virtual time stands still meanwhile, and nothing a watcher only looks at changes
/// what the program does: neither where the machine is stopped, nor how often.
pub trait Watcher<C> {
    /// Appends the addresses of instructions before which it wants the machine to be stopped.
    fn observed(&self, _addresses: &mut Vec<u32>) {}

    /// Before each run. The machine is not borrowed.
    fn before(&mut self, _machine: &SharedMachine<C>) -> Go {
        Go::Until(u64::MAX)
    }

    /// After each run.
    fn after(&mut self, machine: &SharedMachine<C>, stopped: Stopped);

    /// The machine cannot go on; nothing follows.
    fn failed(&mut self, _machine: &SharedMachine<C>, _error: &MachineError) {}
}

/// All watchers of a machine.
pub(crate) struct Watchers<C> {
    all: Vec<Box<dyn Watcher<C>>>,
    /// What the machine was told to observe.
    observed: Vec<u32>,
}

impl<C> Default for Watchers<C> {
    fn default() -> Self {
        Self { all: Vec::new(), observed: Vec::new() }
    }
}

impl<C: Core> Watchers<C> {
    pub(crate) fn add(&mut self, watcher: Box<dyn Watcher<C>>) {
        self.all.push(watcher);
    }

    /// Runs the machine to a moment, or as the watchers want it.
    pub(crate) fn run(&mut self, machine: &SharedMachine<C>, limit_ns: u64) -> Result<Stopped, MachineError> {
        if self.all.is_empty() {
            return machine.borrow_mut().run_until(limit_ns);
        }
        let mut until_ns = limit_ns;
        let mut step = false;
        for watcher in &mut self.all {
            match watcher.before(machine) {
                Go::Until(at_ns) => until_ns = until_ns.min(at_ns),
                Go::Step => step = true,
            }
        }
        let stopped = self.observe(machine).and_then(|()| {
            let mut machine = machine.borrow_mut();
            if step { machine.step_until(until_ns) } else { machine.run_until(until_ns) }
        });
        for watcher in &mut self.all {
            match &stopped {
                Ok(stopped) => watcher.after(machine, *stopped),
                Err(error) => watcher.failed(machine, error),
            }
        }
        stopped
    }

    fn observe(&mut self, machine: &SharedMachine<C>) -> Result<(), MachineError> {
        let mut wanted = Vec::new();
        self.all.iter().for_each(|watcher| watcher.observed(&mut wanted));
        wanted.sort_unstable();
        wanted.dedup();
        if wanted != self.observed {
            machine.borrow_mut().observe(&wanted)?;
            self.observed = wanted;
        }
        Ok(())
    }
}

/// The address, where a run ended at an observed instruction.
pub(crate) fn observed_at(stopped: Stopped) -> Option<u32> {
    match stopped.reason {
        Reason::Observed { address } => Some(address),
        _ => None,
    }
}
