//! Debugger for the machine with gdb's remote protocol. While gdb has the machine halted, virtual time stands still.
//!
//! Registers are those of the core with floating point and the masks. Memory is RAM and flash, read and written without
//! clocks and side effects; peripherals are refused, because reading one can change it: `monitor read` does so on
//! purpose. In the system control space NVIC, SCB and floating point are readable without side effects. Breakpoints are
//! unlimited in number: the machine keeps them, and flash is unchanged. A step is one instruction, or the entry of a
//! pending exception. Neither breakpoints nor steps change what the program does or when. But a connected gdb does at
//! readout protection level 1 (RM0399, 4.5.3): flash and backup SRAM are refused then, and the program cannot go on
//! from flash either.

mod inferior;
mod monitor;
mod registers;
mod wire;

use std::{cell::Cell, net::TcpListener, rc::Rc, thread, time::Duration};

use gdbstub::{
    common::Signal,
    conn::Connection as _,
    stub::{
        DisconnectReason, GdbStub, SingleThreadStopReason,
        state_machine::GdbStubStateMachine::{self, CtrlCInterrupt, Disconnected, Idle, Running},
    },
};
use r4_mcu::{
    MachineError, Reason, Stopped,
    cpu::{Core, Register},
};

use crate::watch::{Go, SharedMachine, Watcher, observed_at};
use inferior::{Inferior, Resume};
use wire::Wire;

/// Real time between polls for a connection from gdb.
const ACCEPT_EVERY: Duration = Duration::from_millis(20);

/// State of a debugging session.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum State {
    /// No gdb has connected yet.
    Waiting,
    /// A gdb is connected.
    Attached,
    /// The gdb has disconnected; the machine runs freely.
    Detached,
    /// The gdb has requested the end of the program.
    Killed,
}

/// Caller of the server: shows messages to the user, and knows whether the user wants to stop waiting.
pub trait Starter {
    /// Shows a message to the user.
    fn say(&self, text: &str);

    /// Returns true if the user wants to end the wait for gdb; the machine then runs on.
    fn interrupted(&self) -> bool {
        false
    }

    /// Ends the program at gdb's request.
    fn killed(&self) {}
}

type Stub<C> = GdbStubStateMachine<'static, Inferior<C>, Wire>;

/// Server for one gdb.
pub struct Server<C: Core + 'static> {
    listener: TcpListener,
    attach_at_ns: u64,
    starter: Box<dyn Starter>,
    state: Rc<Cell<State>>,
    inferior: Inferior<C>,
    stub: Option<Stub<C>>,
}

impl<C: Core + 'static> Server<C> {
    /// Makes a server that halts the machine at the first instruction at or after `attach_at_ns` and waits there for
    /// gdb.
    pub fn new(
        machine: SharedMachine<C>,
        listener: TcpListener,
        attach_at_ns: u64,
        starter: impl Starter + 'static,
    ) -> Self {
        let inferior =
            Inferior { machine, breakpoints: Vec::new(), resume: Resume::Continue, tracer: None, failure: None };
        let state = Rc::new(Cell::new(State::Waiting));
        Self { listener, attach_at_ns, starter: Box::new(starter), state, inferior, stub: None }
    }

    /// Returns the state of the session, shared with the server.
    pub fn state(&self) -> Rc<Cell<State>> {
        self.state.clone()
    }

    /// Waits for gdb to connect.
    fn accept(&mut self) {
        let address = self.listener.local_addr().map(|address| address.to_string()).unwrap_or_default();
        let (now_ns, location) = {
            let machine = self.inferior.machine.borrow();
            (machine.now_ns(), machine.location())
        };
        self.starter.say(&format!("halted at {now_ns} ns, {location}; waits for gdb: target remote {address}"));
        let connected = self.listener.set_nonblocking(true).and_then(|()| {
            loop {
                match self.listener.accept() {
                    Ok((stream, _)) => return Wire::new(stream).map(Some),
                    Err(error) if error.kind() == std::io::ErrorKind::WouldBlock => {
                        if self.starter.interrupted() {
                            return Ok(None);
                        }
                        thread::sleep(ACCEPT_EVERY);
                    }
                    Err(error) => return Err(error),
                }
            }
        });
        match connected {
            Ok(Some(wire)) => {
                self.state.set(State::Attached);
                self.connect(true);
                let stub = GdbStub::new(wire).run_state_machine(&mut self.inferior);
                self.keep(stub);
            }
            Ok(None) => self.state.set(State::Detached),
            Err(error) => self.end(&error),
        }
    }

    /// Keeps the protocol state, or ends the session after a failure.
    fn keep<E: std::fmt::Display>(&mut self, stub: Result<Stub<C>, E>) {
        match stub {
            Ok(stub) => self.stub = Some(stub),
            Err(error) => self.end(&error),
        }
    }

    /// Makes the chip notice the debugger.
    fn connect(&self, connected: bool) {
        let mut machine = self.inferior.machine.borrow_mut();
        machine.chip.set_debugger(connected);
        if connected && machine.chip.is_closed() {
            let what = "readout protection level 1 (RDP of the option bytes): with a debugger flash and backup SRAM \
                        cannot be accessed, and a program in flash locks up, until the power has been off";
            self.starter.say(what);
        }
    }

    fn end(&mut self, error: &dyn std::fmt::Display) {
        self.connect(false);
        self.starter.say(&format!("gdb: {error}; the machine runs on"));
        self.inferior.breakpoints.clear();
        self.state.set(State::Detached);
    }

    /// Answers gdb until the machine is to run, or the session has ended.
    fn talk(&mut self) {
        while let Some(stub) = self.stub.take() {
            match stub {
                Idle(mut idle) => match idle.borrow_conn().wait() {
                    Ok(Some(byte)) => {
                        let next = idle.incoming_data(&mut self.inferior, byte);
                        self.keep(next);
                    }
                    Ok(None) if self.starter.interrupted() => self.end(&"interrupted"),
                    Ok(None) => self.stub = Some(Idle(idle)),
                    Err(error) => self.end(&error),
                },
                Running(mut running) => match running.borrow_conn().look() {
                    Ok(Some(byte)) => {
                        let next = running.incoming_data(&mut self.inferior, byte);
                        self.keep(next);
                    }
                    Ok(None) => {
                        self.stub = Some(Running(running));
                        return;
                    }
                    Err(error) => self.end(&error),
                },
                CtrlCInterrupt(interrupt) => {
                    let reason = Some(SingleThreadStopReason::Signal(Signal::SIGINT));
                    let next = interrupt.interrupt_handled(&mut self.inferior, reason);
                    self.keep(next);
                }
                Disconnected(mut disconnected) => {
                    // The last answer is still in the buffer.
                    let _ = disconnected.borrow_conn().flush();
                    self.connect(false);
                    self.inferior.breakpoints.clear();
                    self.inferior.resume = Resume::Continue;
                    if disconnected.get_reason() == DisconnectReason::Kill {
                        self.state.set(State::Killed);
                        self.starter.killed();
                    } else {
                        self.state.set(State::Detached);
                    }
                }
            }
        }
    }

    /// Reports the reason of a stop to gdb, if it waits for one.
    fn report(&mut self, reason: SingleThreadStopReason<u32>) {
        match self.stub.take() {
            Some(Running(running)) => {
                let next = running.report_stop(&mut self.inferior, reason);
                self.keep(next);
            }
            other => self.stub = other,
        }
    }

    /// Translates a stop of the machine for gdb; `None` if it does not concern gdb.
    fn reason(&self, stopped: Stopped) -> Option<SingleThreadStopReason<u32>> {
        let at_breakpoint = |address: u32| self.inferior.breakpoints.contains(&address);
        match stopped.reason {
            Reason::Observed { address } => at_breakpoint(address).then_some(SingleThreadStopReason::HwBreak(())),
            Reason::Breakpoint { .. } => Some(SingleThreadStopReason::Signal(Signal::SIGTRAP)),
            Reason::Stepped => {
                let pc = self.inferior.machine.borrow().core.get(Register::Pc);
                match self.inferior.resume {
                    Resume::Range(..) if at_breakpoint(pc) => Some(SingleThreadStopReason::HwBreak(())),
                    Resume::Range(start, end) if (start..end).contains(&pc) => None,
                    _ => Some(SingleThreadStopReason::DoneStep),
                }
            }
            Reason::Time | Reason::Outside | Reason::Reset(_) => None,
        }
    }
}

impl<C: Core + 'static> Watcher<C> for Server<C> {
    fn observed(&self, addresses: &mut Vec<u32>) {
        addresses.extend(&self.inferior.breakpoints);
    }

    fn before(&mut self, machine: &SharedMachine<C>) -> Go {
        if self.state.get() == State::Waiting {
            if machine.borrow().now_ns() < self.attach_at_ns {
                return Go::Until(self.attach_at_ns);
            }
            self.accept();
        }
        self.talk();
        if self.stub.is_none() || self.inferior.resume == Resume::Continue { Go::Until(u64::MAX) } else { Go::Step }
    }

    fn after(&mut self, machine: &SharedMachine<C>, stopped: Stopped) {
        if let Some(tracer) = &mut self.inferior.tracer {
            tracer.collect(machine, observed_at(stopped));
        }
        if let Reason::Reset(cause) = stopped.reason {
            self.starter.say(&format!("the chip was reset at {} ns: {cause}", stopped.at_ns));
        }
        if let Some(reason) = self.reason(stopped) {
            self.report(reason);
        }
    }

    fn failed(&mut self, machine: &SharedMachine<C>, error: &MachineError) {
        if let Some(tracer) = &mut self.inferior.tracer {
            tracer.collect(machine, None);
        }
        self.starter.say(&format!("the machine cannot go on: {error}"));
        if self.state.get() == State::Waiting {
            self.accept();
        }
        self.inferior.failure = Some(error.to_string());
        self.report(SingleThreadStopReason::Signal(Signal::SIGABRT));
        self.talk();
        self.report(SingleThreadStopReason::Terminated(Signal::SIGABRT));
    }
}

impl<C: Core + 'static> Drop for Server<C> {
    fn drop(&mut self) {
        self.report(SingleThreadStopReason::Exited(0));
    }
}
