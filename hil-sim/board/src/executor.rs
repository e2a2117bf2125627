//! A simulation: tasks in order of priority, on one virtual clock.

use std::{
    pin::{Pin, pin},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    task::{Context, Poll, Wake, Waker},
    time::{Duration, Instant},
};

use crate::clock::Clock;

/// How virtual time relates to the clock on the wall.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Pace {
    /// As fast as the machine can.
    Free,
    /// This many virtual seconds in a real one, for a person who watches; slower where the machine cannot.
    RealTime(f64),
}

/// Tasks and their clock. Code takes no virtual time; only waiting does.
///
/// Deterministic: tasks that are ready at the same moment run in order of priority, and the scan starts again from the
/// highest after each, as on a processor whose interrupts preempt. No thread, no wall clock, except for [`Pace`].
pub struct Simulation {
    clock: Clock,
    tasks: Vec<Task>,
    next_id: u64,
    pace: Pace,
}

/// A task of a [`Simulation`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TaskId(u64);

struct Task {
    id: TaskId,
    future: Pin<Box<dyn Future<Output = ()>>>,
    ready: Arc<Ready>,
    waker: Waker,
}

struct Ready(AtomicBool);

impl Wake for Ready {
    fn wake(self: Arc<Self>) {
        self.0.store(true, Ordering::Relaxed);
    }

    fn wake_by_ref(self: &Arc<Self>) {
        self.0.store(true, Ordering::Relaxed);
    }
}

impl Default for Simulation {
    fn default() -> Self {
        Self::new(Pace::Free)
    }
}

impl Simulation {
    /// A simulation at time 0 without tasks.
    #[must_use]
    pub fn new(pace: Pace) -> Self {
        Self { clock: Clock::default(), tasks: Vec::new(), next_id: 0, pace }
    }

    /// The clock, for tasks that wait.
    #[must_use]
    pub fn clock(&self) -> Clock {
        self.clock.clone()
    }

    /// Adds a task below all that are there.
    pub fn spawn(&mut self, future: impl Future<Output = ()> + 'static) -> TaskId {
        let ready = Arc::new(Ready(AtomicBool::new(true)));
        let id = TaskId(self.next_id);
        self.next_id += 1;
        self.tasks.push(Task { id, future: Box::pin(future), waker: Waker::from(ready.clone()), ready });
        id
    }

    /// Drops a task where it stands, as a reset does; one that has ended already is no error.
    pub fn end(&mut self, id: TaskId) {
        if let Some(index) = self.tasks.iter().position(|task| task.id == id) {
            let task = self.tasks.remove(index);
            self.clock.forget(&task.waker);
        }
    }

    /// Runs until `main` is done, as the task of the lowest priority.
    ///
    /// Returns `None` when `main` waits for something that can never happen: nothing is ready and nobody sleeps.
    pub fn block_on<T>(&mut self, main: impl Future<Output = T>) -> Option<T> {
        let mut main = pin!(main);
        let ready = Arc::new(Ready(AtomicBool::new(true)));
        let waker = Waker::from(ready.clone());
        let clock = self.clock.clone();
        let begin = (Instant::now(), clock.now_ns());
        clock.enter(|| {
            loop {
                if self.poll_one() {
                    continue;
                }
                if ready.0.swap(false, Ordering::Relaxed) {
                    match main.as_mut().poll(&mut Context::from_waker(&waker)) {
                        Poll::Ready(value) => {
                            clock.forget(&waker);
                            return Some(value);
                        }
                        Poll::Pending => continue,
                    }
                }
                let next_ns = self.clock.next_wake()?;
                self.keep_pace(begin, next_ns);
                self.clock.advance(next_ns);
            }
        })
    }

    /// Polls the highest task that is ready; false when there is none.
    fn poll_one(&mut self) -> bool {
        let Some(index) = self.tasks.iter().position(|task| task.ready.0.load(Ordering::Relaxed)) else {
            return false;
        };
        let task = &mut self.tasks[index];
        task.ready.0.store(false, Ordering::Relaxed);
        if task.future.as_mut().poll(&mut Context::from_waker(&task.waker)).is_ready() {
            let task = self.tasks.remove(index);
            self.clock.forget(&task.waker);
        }
        true
    }

    fn keep_pace(&self, (wall, begin_ns): (Instant, u64), next_ns: u64) {
        if let Pace::RealTime(factor) = self.pace {
            let due_s = next_ns.saturating_sub(begin_ns) as f64 * 1e-9 / factor;
            let due = Duration::try_from_secs_f64(due_s).unwrap_or(Duration::MAX);
            // Pacing for a person: the only place in the simulator that looks at the wall.
            std::thread::sleep(due.saturating_sub(wall.elapsed()));
        }
    }
}

#[cfg(test)]
mod tests {
    use std::{cell::RefCell, rc::Rc};

    use super::*;

    #[test]
    fn tasks_due_at_once_run_by_priority_and_time_is_exact() {
        let mut simulation = Simulation::default();
        let seen = Rc::new(RefCell::new(Vec::new()));
        for (name, period_ns) in [("a", 300), ("b", 200)] {
            let (clock, seen) = (simulation.clock(), seen.clone());
            simulation.spawn(async move {
                loop {
                    clock.sleep(period_ns).await;
                    seen.borrow_mut().push((clock.now_ns(), name));
                }
            });
        }
        let clock = simulation.clock();
        assert_eq!(simulation.block_on(async { clock.sleep_until(650).await }), Some(()));
        assert_eq!(*seen.borrow(), [(200, "b"), (300, "a"), (400, "b"), (600, "a"), (600, "b")]);
    }

    #[test]
    fn waiting_for_nothing_ends() {
        assert_eq!(Simulation::default().block_on(std::future::pending::<()>()), None);
    }
}
