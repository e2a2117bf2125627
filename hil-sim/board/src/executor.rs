//! Simulation: tasks in order of priority, on one virtual clock.

use std::{
    pin::{Pin, pin},
    sync::{
        Arc,
        atomic::{AtomicU8, AtomicUsize, Ordering},
    },
    task::{Context, Poll, Wake, Waker},
    time::{Duration, Instant},
};

use crate::clock::Clock;

/// Relation between virtual time and real time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Pace {
    /// Virtual time passes as fast as the machine can compute it.
    Free,
    /// Virtual seconds per real second, for a person who watches; slower if the machine cannot keep up.
    RealTime(f64),
}

/// Tasks and their clock. Code takes no virtual time; only waiting does.
///
/// Deterministic: tasks that are ready at the same time run in order of priority, and the scan restarts from the
/// highest after each, as on a processor whose interrupts preempt. No thread and no real time, except for [`Pace`].
pub struct Simulation {
    clock: Clock,
    tasks: Vec<Task>,
    next_id: u64,
    pace: Pace,
}

/// Identifier of a task of a [`Simulation`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TaskId(u64);

struct Task {
    id: TaskId,
    future: Pin<Box<dyn Future<Output = ()>>>,
    ready: Arc<Ready>,
    waker: Waker,
}

/// Flag that a task is to be polled.
struct Ready {
    state: AtomicU8,
    /// Number of such tasks in the simulation.
    count: Arc<AtomicUsize>,
}

impl Ready {
    const WAITING: u8 = 0;
    const READY: u8 = 1;
    /// The task has ended; wakers that still exist have no effect.
    const ENDED: u8 = 2;

    /// A flag already set, for a task that has to be polled a first time.
    fn new(clock: &Clock) -> Arc<Self> {
        let ready = Arc::new(Self { state: AtomicU8::new(Self::WAITING), count: clock.ready_counter() });
        ready.wake_by_ref();
        ready
    }

    fn is_ready(&self) -> bool {
        self.state.load(Ordering::Relaxed) == Self::READY
    }

    /// Clears the flag, and returns true if it was set.
    fn take(&self) -> bool {
        self.leave(Self::WAITING)
    }

    fn end(&self) {
        self.leave(Self::ENDED);
    }

    fn leave(&self, state: u8) -> bool {
        let was_ready = self.state.swap(state, Ordering::Relaxed) == Self::READY;
        if was_ready {
            self.count.fetch_sub(1, Ordering::Relaxed);
        }
        was_ready
    }
}

impl Wake for Ready {
    fn wake(self: Arc<Self>) {
        self.wake_by_ref();
    }

    fn wake_by_ref(self: &Arc<Self>) {
        let was = self.state.compare_exchange(Self::WAITING, Self::READY, Ordering::Relaxed, Ordering::Relaxed);
        if was.is_ok() {
            self.count.fetch_add(1, Ordering::Relaxed);
        }
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

    /// Adds a task with the lowest priority so far.
    pub fn spawn(&mut self, future: impl Future<Output = ()> + 'static) -> TaskId {
        let ready = Ready::new(&self.clock);
        let id = TaskId(self.next_id);
        self.next_id += 1;
        self.tasks.push(Task { id, future: Box::pin(future), waker: Waker::from(ready.clone()), ready });
        id
    }

    /// Drops a task in its present state, as a reset does; a task that has already ended is ignored.
    pub fn end(&mut self, id: TaskId) {
        if let Some(index) = self.tasks.iter().position(|task| task.id == id) {
            self.remove(index);
        }
    }

    /// Runs until `main` is done, as the task of the lowest priority.
    ///
    /// Returns `None` if `main` waits for something that can never happen: no task is ready and none sleeps.
    pub fn block_on<T>(&mut self, main: impl Future<Output = T>) -> Option<T> {
        let mut value = None;
        self.run(pin!(async { value = Some(main.await) }));
        value
    }

    /// Runs until `main` is done, or waits for something that can never happen. Compiled here, once for all programs.
    fn run(&mut self, mut main: Pin<&mut dyn Future<Output = ()>>) {
        let ready = Ready::new(&self.clock);
        let waker = Waker::from(ready.clone());
        let clock = self.clock.clone();
        let begin = (Instant::now(), clock.now_ns());
        clock.enter(|| {
            loop {
                if self.poll_one() {
                    continue;
                }
                if ready.take() {
                    match main.as_mut().poll(&mut Context::from_waker(&waker)) {
                        Poll::Ready(()) => {
                            ready.end();
                            clock.forget(&waker);
                            return;
                        }
                        Poll::Pending => continue,
                    }
                }
                // nothing is ready, so time advances to the next wake
                let Some(next_ns) = self.clock.next_wake() else {
                    ready.end();
                    return;
                };
                self.keep_pace(begin, next_ns);
                self.clock.advance(next_ns);
            }
        });
    }

    /// Polls the ready task of the highest priority; false if there is none.
    fn poll_one(&mut self) -> bool {
        let Some(index) = self.tasks.iter().position(|task| task.ready.is_ready()) else {
            return false;
        };
        let task = &mut self.tasks[index];
        task.ready.take();
        if task.future.as_mut().poll(&mut Context::from_waker(&task.waker)).is_ready() {
            self.remove(index);
        }
        true
    }

    fn remove(&mut self, index: usize) {
        let task = self.tasks.remove(index);
        task.ready.end();
        self.clock.forget(&task.waker);
    }

    fn keep_pace(&self, (wall, begin_ns): (Instant, u64), next_ns: u64) {
        if let Pace::RealTime(factor) = self.pace {
            let due_s = next_ns.saturating_sub(begin_ns) as f64 * 1e-9 / factor;
            let due = Duration::try_from_secs_f64(due_s).unwrap_or(Duration::MAX);
            // pacing for a person: the only place in the simulator that uses real time
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

    /// A task that advances time by itself stops when others are due, so that no task is late, even one of lower
    /// priority.
    #[test]
    fn who_runs_ahead_stops_at_the_next_sleeper_and_gives_way() {
        let mut simulation = Simulation::default();
        let seen = Rc::new(RefCell::new(Vec::new()));
        let (clock, log) = (simulation.clock(), seen.clone());
        simulation.spawn(async move {
            loop {
                while clock.is_anyone_ready() {
                    clock.give_way().await;
                }
                let now_ns = clock.run_ahead(clock.now_ns() + 70);
                log.borrow_mut().push((now_ns, "ahead"));
            }
        });
        let (clock, log) = (simulation.clock(), seen.clone());
        let below = simulation.spawn(async move {
            clock.sleep_until(100).await;
            log.borrow_mut().push((clock.now_ns(), "below"));
        });
        let (clock, log) = (simulation.clock(), seen.clone());
        let main = async move {
            for at_ns in [100, 100, 250] {
                clock.sleep_until(at_ns).await;
                log.borrow_mut().push((clock.now_ns(), "main"));
            }
        };
        assert_eq!(simulation.block_on(main), Some(()));
        let (ahead, main) = (|at_ns| (at_ns, "ahead"), |at_ns| (at_ns, "main"));
        let expected =
            [ahead(70), ahead(100), (100, "below"), main(100), main(100), ahead(170), ahead(240), ahead(250)];
        assert_eq!(seen.borrow()[..8], expected);
        assert_eq!(seen.borrow()[8..], [main(250)]);
        // an ended task is not counted, even if its waker is called once more
        simulation.end(below);
        assert!(!simulation.clock().is_anyone_ready());
    }

    #[test]
    fn waiting_for_nothing_ends() {
        assert_eq!(Simulation::default().block_on(std::future::pending::<()>()), None);
    }
}
