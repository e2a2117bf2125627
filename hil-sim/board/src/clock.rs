//! Virtual time: integer nanoseconds, advanced only by the [`Simulation`](crate::Simulation).

use std::{
    cell::{Cell, RefCell},
    pin::Pin,
    rc::Rc,
    sync::{
        Arc,
        atomic::{AtomicUsize, Ordering},
    },
    task::{Context, Poll, Waker},
};

/// Nanoseconds per tick of `embassy-time`.
const NS_PER_TICK: u64 = 1_000_000_000 / embassy_time_driver::TICK_HZ;

/// The clock of one simulation, with the tasks that wait for it.
#[derive(Clone, Default)]
pub struct Clock(Rc<Inner>);

#[derive(Default)]
struct Inner {
    now_ns: Cell<u64>,
    timers: RefCell<Vec<Timer>>,
    /// Number of tasks to be polled. Wakers can be sent to other threads, so this counter can too.
    ready: Arc<AtomicUsize>,
}

/// A sleeping task, with the earliest time at which it asked to be woken.
struct Timer {
    at_ns: u64,
    waker: Waker,
}

/// Time of a timer that waits for nothing; its waker is kept for the task's next sleep.
const IDLE: u64 = u64::MAX;

impl Clock {
    /// Time since the simulation started, ns.
    #[must_use]
    pub fn now_ns(&self) -> u64 {
        self.0.now_ns.get()
    }

    /// Future that is ready once the clock shows `at_ns` or later.
    pub fn sleep_until(&self, at_ns: u64) -> Sleep {
        Sleep { clock: self.clone(), at_ns }
    }

    /// Future that is ready after `ns`.
    pub fn sleep(&self, ns: u64) -> Sleep {
        self.sleep_until(self.now_ns().saturating_add(ns))
    }

    /// Wakes `waker` at `at_ns`, or before: a woken task asks again for everything it still waits for.
    pub(crate) fn wake_at(&self, at_ns: u64, waker: &Waker) {
        let mut timers = self.0.timers.borrow_mut();
        match timers.iter_mut().find(|timer| timer.waker.will_wake(waker)) {
            Some(timer) => timer.at_ns = timer.at_ns.min(at_ns),
            None => timers.push(Timer { at_ns, waker: waker.clone() }),
        }
    }

    /// Drops the timers of a task that has ended.
    pub(crate) fn forget(&self, waker: &Waker) {
        self.0.timers.borrow_mut().retain(|timer| !timer.waker.will_wake(waker));
    }

    /// Time at which the next sleeper wakes, ns; `None` if no task sleeps.
    #[must_use]
    pub fn next_wake(&self) -> Option<u64> {
        self.0.timers.borrow().iter().map(|timer| timer.at_ns).min().filter(|at_ns| *at_ns != IDLE)
    }

    /// Lets time pass while a task runs: to `to_ns`, but not beyond the next sleeper's wake time, which wakes it.
    /// Returns the present time; time never goes back.
    ///
    /// This is for a task that is a processor of its own, an emulator: it moves the clock to the time of each of its
    /// steps, and [gives way](Clock::give_way) before each such step while [`Clock::is_anyone_ready`]. So every task
    /// still runs at the time at which it asked to, and order and times depend on virtual time only. The pace of a
    /// [`Simulation`](crate::Simulation) is kept when a task gives way.
    ///
    /// ```
    /// use r4_sim::{Clock, Simulation};
    ///
    /// async fn processor(clock: Clock) {
    ///     while clock.now_ns() < 1_000_000 {
    ///         while clock.is_anyone_ready() {
    ///             clock.give_way().await;
    ///         }
    ///         let now_ns = clock.run_ahead(clock.now_ns() + 300);
    ///         // … whatever the program does up to now_ns
    ///     }
    /// }
    ///
    /// let mut simulation = Simulation::default();
    /// simulation.spawn(processor(simulation.clock()));
    /// let clock = simulation.clock();
    /// simulation.block_on(clock.sleep_until(12_345));
    /// assert_eq!(clock.now_ns(), 12_345);
    /// ```
    pub fn run_ahead(&self, to_ns: u64) -> u64 {
        self.advance(self.next_wake().map_or(to_ns, |wake_ns| to_ns.min(wake_ns)));
        self.now_ns()
    }

    /// True if a task of the simulation, or its main one, waits to be polled; one that is being polled does not count.
    #[must_use]
    pub fn is_anyone_ready(&self) -> bool {
        self.0.ready.load(Ordering::Relaxed) > 0
    }

    /// Counter of the tasks to be polled, which the tasks update.
    pub(crate) fn ready_counter(&self) -> Arc<AtomicUsize> {
        self.0.ready.clone()
    }

    /// Future that lets all other ready tasks run, those of lower priority too, at the same virtual time.
    pub fn give_way(&self) -> GiveWay {
        GiveWay { clock: self.clone(), given: false }
    }

    /// Moves to `to_ns` and wakes all sleepers that are due. Time never goes back.
    pub(crate) fn advance(&self, to_ns: u64) {
        self.0.now_ns.set(to_ns.max(self.now_ns()));
        for timer in self.0.timers.borrow_mut().iter_mut().filter(|timer| timer.at_ns <= to_ns) {
            timer.at_ns = IDLE;
            timer.waker.wake_by_ref();
        }
    }

    /// Runs `f` with `embassy-time` on this clock.
    pub(crate) fn enter<T>(&self, f: impl FnOnce() -> T) -> T {
        /// Restores the clock of an outer simulation, also if `f` panics.
        struct Restore(Option<Clock>);
        impl Drop for Restore {
            fn drop(&mut self) {
                CURRENT.set(self.0.take());
            }
        }
        let _restore = Restore(CURRENT.replace(Some(self.clone())));
        f()
    }
}

/// Future of [`Clock::sleep_until`] and [`Clock::sleep`].
pub struct Sleep {
    clock: Clock,
    at_ns: u64,
}

impl Future for Sleep {
    type Output = ();

    fn poll(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<()> {
        if self.clock.now_ns() >= self.at_ns {
            return Poll::Ready(());
        }
        self.clock.wake_at(self.at_ns, context.waker());
        Poll::Pending
    }
}

/// Future of [`Clock::give_way`], ready at its second poll.
pub struct GiveWay {
    clock: Clock,
    given: bool,
}

impl Future for GiveWay {
    type Output = ();

    fn poll(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<()> {
        if std::mem::replace(&mut self.given, true) {
            return Poll::Ready(());
        }
        // time stands still until no other task is ready; then this timer is due
        self.clock.wake_at(self.clock.now_ns(), context.waker());
        Poll::Pending
    }
}

thread_local! {
    /// Clock of the simulation that this thread is running.
    static CURRENT: RefCell<Option<Clock>> = const { RefCell::new(None) };
}

/// Driver of `embassy-time` on the clock of the running simulation, so that firmware needs no other time than its own.
struct VirtualTime;

impl embassy_time_driver::Driver for VirtualTime {
    fn now(&self) -> u64 {
        CURRENT.with_borrow(|clock| clock.as_ref().map_or(0, |clock| clock.now_ns() / NS_PER_TICK))
    }

    fn schedule_wake(&self, at: u64, waker: &Waker) {
        CURRENT.with_borrow(|clock| match clock {
            Some(clock) => clock.wake_at(at.saturating_mul(NS_PER_TICK), waker),
            // outside a simulation no time passes: the caller polls again rather than sleeping indefinitely
            None => waker.wake_by_ref(),
        });
    }
}

embassy_time_driver::time_driver_impl!(static DRIVER: VirtualTime = VirtualTime);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clocks_of_nested_simulations_do_not_mix() {
        let (outer, inner) = (Clock::default(), Clock::default());
        outer.advance(5_000_000);
        inner.advance(7_000_000);
        let ticks = || embassy_time_driver::now();
        outer.enter(|| {
            assert_eq!(ticks(), 5_000);
            inner.enter(|| assert_eq!(ticks(), 7_000));
            assert_eq!(ticks(), 5_000);
        });
        assert_eq!(ticks(), 0);
    }
}
