//! GPIO lines between the processor and the rest of the board.

use std::{
    cell::{Cell, RefCell},
    convert::Infallible,
    future::poll_fn,
    rc::Rc,
    task::{Poll, Waker},
};

use embedded_hal::digital::{ErrorType, InputPin, OutputPin};
use embedded_hal_async::digital::Wait;

/// A line driven from outside and read by the processor.
#[derive(Default)]
pub struct Line {
    high: Cell<bool>,
    edges: Cell<u64>,
    waiting: RefCell<Vec<Waker>>,
}

impl Line {
    /// A line at an initial level.
    #[must_use]
    pub fn new(high: bool) -> Rc<Self> {
        Rc::new(Self { high: Cell::new(high), ..Self::default() })
    }

    /// Drives the line, and wakes all tasks that wait for an edge.
    pub fn set(&self, high: bool) {
        if self.high.replace(high) != high {
            self.edges.set(self.edges.get() + 1);
            self.waiting.take().into_iter().for_each(Waker::wake);
        }
    }

    /// Present level of the line.
    #[must_use]
    pub fn is_high(&self) -> bool {
        self.high.get()
    }

    /// Number of edges since the line was created.
    #[must_use]
    pub fn edges(&self) -> u64 {
        self.edges.get()
    }

    /// Wakes `waker` at the next edge, once; the edge is at the virtual time at which the woken task runs.
    pub fn on_change(&self, waker: &Waker) {
        let mut waiting = self.waiting.borrow_mut();
        if !waiting.iter().any(|known| known.will_wake(waker)) {
            waiting.push(waker.clone());
        }
    }
}

/// The processor's end of an input line.
pub(crate) struct InputLine(pub(crate) Rc<Line>);

impl InputLine {
    /// Waits for the first edge after the call after which `wanted` holds.
    async fn edge(&mut self, wanted: impl Fn(bool) -> bool) {
        let mut seen = self.0.edges.get();
        poll_fn(|context| {
            if self.0.edges.get() != seen {
                seen = self.0.edges.get();
                if wanted(self.0.is_high()) {
                    return Poll::Ready(());
                }
            }
            self.0.on_change(context.waker());
            Poll::Pending
        })
        .await;
    }
}

impl ErrorType for InputLine {
    type Error = Infallible;
}

impl InputPin for InputLine {
    fn is_high(&mut self) -> Result<bool, Infallible> {
        Ok(self.0.is_high())
    }

    fn is_low(&mut self) -> Result<bool, Infallible> {
        Ok(!self.0.is_high())
    }
}

impl Wait for InputLine {
    async fn wait_for_high(&mut self) -> Result<(), Infallible> {
        if !self.0.is_high() {
            self.edge(|high| high).await;
        }
        Ok(())
    }

    async fn wait_for_low(&mut self) -> Result<(), Infallible> {
        if self.0.is_high() {
            self.edge(|high| !high).await;
        }
        Ok(())
    }

    async fn wait_for_rising_edge(&mut self) -> Result<(), Infallible> {
        self.edge(|high| high).await;
        Ok(())
    }

    async fn wait_for_falling_edge(&mut self) -> Result<(), Infallible> {
        self.edge(|high| !high).await;
        Ok(())
    }

    async fn wait_for_any_edge(&mut self) -> Result<(), Infallible> {
        self.edge(|_| true).await;
        Ok(())
    }
}

/// The processor's end of an output line; `drive` is called at each change.
pub(crate) struct OutputLine<F> {
    high: Option<bool>,
    drive: F,
}

impl<F: FnMut(bool)> OutputLine<F> {
    /// A line that is not driven yet.
    pub(crate) fn new(drive: F) -> Self {
        Self { high: None, drive }
    }

    fn set(&mut self, high: bool) -> Result<(), Infallible> {
        if self.high.replace(high) != Some(high) {
            (self.drive)(high);
        }
        Ok(())
    }
}

impl<F> ErrorType for OutputLine<F> {
    type Error = Infallible;
}

impl<F: FnMut(bool)> OutputPin for OutputLine<F> {
    fn set_low(&mut self) -> Result<(), Infallible> {
        self.set(false)
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        self.set(true)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Simulation;

    /// A task that polls, as an emulator does, and one that waits, as the firmware's does: both see each edge at its
    /// time.
    #[test]
    fn an_edge_wakes_all_who_look_at_its_time() {
        let mut simulation = Simulation::default();
        let (line, seen) = (Line::new(true), Rc::new(RefCell::new(Vec::new())));
        let (of, log, clock) = (line.clone(), seen.clone(), simulation.clock());
        simulation.spawn(poll_fn(move |context| {
            log.borrow_mut().push((clock.now_ns(), "polls", of.is_high(), of.edges()));
            of.on_change(context.waker());
            Poll::Pending
        }));
        let (of, log, clock) = (line.clone(), seen.clone(), simulation.clock());
        simulation.spawn(async move {
            loop {
                let Ok(()) = InputLine(of.clone()).wait_for_any_edge().await;
                log.borrow_mut().push((clock.now_ns(), "waits", of.is_high(), of.edges()));
            }
        });
        let clock = simulation.clock();
        simulation.block_on(async {
            for (at_ns, high) in [(100, false), (150, false), (230, true)] {
                clock.sleep_until(at_ns).await;
                line.set(high);
            }
            clock.sleep(1).await;
        });
        let expected = [
            (0, "polls", true, 0),
            (100, "polls", false, 1),
            (100, "waits", false, 1),
            (230, "polls", true, 2),
            (230, "waits", true, 2),
        ];
        assert_eq!(*seen.borrow(), expected);
    }
}
