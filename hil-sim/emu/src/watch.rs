//! Watchers of the machine between its runs: a log, a trace, a debugger.

use std::{cell::RefCell, rc::Rc};

use r4_mcu::{Machine, MachineError, Reason, Stopped, cpu::Core};

use crate::board::BoardSoc;

/// Machine shared with its watchers.
pub type SharedMachine<C> = Rc<RefCell<Machine<C, BoardSoc>>>;

/// Limit that a watcher sets to the next run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Go {
    /// Run to this virtual time at the latest, ns.
    Until(u64),
    /// Run a single instruction.
    Step,
}

/// Watcher of the machine between its runs. Virtual time stands still meanwhile. Passive watchers do not change what
/// the program does, wherever and however often the machine is stopped.
pub trait Watcher<C> {
    /// Appends the addresses of instructions before which the machine must stop.
    fn observed(&self, _addresses: &mut Vec<u32>) {}

    /// Called before each run. The machine is not borrowed.
    fn before(&mut self, _machine: &SharedMachine<C>) -> Go {
        Go::Until(u64::MAX)
    }

    /// Called after each run.
    fn after(&mut self, machine: &SharedMachine<C>, stopped: Stopped);

    /// Called when the machine cannot go on; no further call follows.
    fn failed(&mut self, _machine: &SharedMachine<C>, _error: &MachineError) {}
}

/// All watchers of one machine.
pub(crate) struct Watchers<C> {
    all: Vec<Box<dyn Watcher<C>>>,
    /// Addresses that the machine observes at present.
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

    /// Runs the machine to `limit_ns`, or less far as the watchers request.
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

/// Returns the address if the run ended at an observed instruction.
pub(crate) fn observed_at(stopped: Stopped) -> Option<u32> {
    match stopped.reason {
        Reason::Observed { address } => Some(address),
        _ => None,
    }
}
