//! Virtual time: integer nanoseconds, moved on only by the [`Simulation`](crate::Simulation).

use std::{
    cell::{Cell, RefCell},
    pin::Pin,
    rc::Rc,
    task::{Context, Poll, Waker},
};

/// Nanoseconds in a tick of `embassy-time`.
const NS_PER_TICK: u64 = 1_000_000_000 / embassy_time_driver::TICK_HZ;

/// The clock of one simulation, and what waits for it.
#[derive(Clone, Default)]
pub struct Clock(Rc<Inner>);

#[derive(Default)]
struct Inner {
    now_ns: Cell<u64>,
    timers: RefCell<Vec<Timer>>,
}

/// One sleeping task: the earliest moment at which it asked to be woken.
struct Timer {
    at_ns: u64,
    waker: Waker,
}

/// A timer that waits for nothing; its waker is kept for the task's next sleep.
const IDLE: u64 = u64::MAX;

impl Clock {
    /// Nanoseconds since the simulation started.
    #[must_use]
    pub fn now_ns(&self) -> u64 {
        self.0.now_ns.get()
    }

    /// Ready once the clock shows `at_ns` or later.
    pub fn sleep_until(&self, at_ns: u64) -> Sleep {
        Sleep { clock: self.clone(), at_ns }
    }

    /// Ready after `ns`.
    pub fn sleep(&self, ns: u64) -> Sleep {
        self.sleep_until(self.now_ns().saturating_add(ns))
    }

    /// Wakes `waker` at `at_ns`, or before: a woken task asks again for whatever it still waits for.
    pub(crate) fn wake_at(&self, at_ns: u64, waker: &Waker) {
        let mut timers = self.0.timers.borrow_mut();
        match timers.iter_mut().find(|timer| timer.waker.will_wake(waker)) {
            Some(timer) => timer.at_ns = timer.at_ns.min(at_ns),
            None => timers.push(Timer { at_ns, waker: waker.clone() }),
        }
    }

    /// Drops what a task asked for that has ended.
    pub(crate) fn forget(&self, waker: &Waker) {
        self.0.timers.borrow_mut().retain(|timer| !timer.waker.will_wake(waker));
    }

    /// When the next sleeper wakes, or `None` when nobody sleeps.
    pub(crate) fn next_wake(&self) -> Option<u64> {
        self.0.timers.borrow().iter().map(|timer| timer.at_ns).min().filter(|at_ns| *at_ns != IDLE)
    }

    /// Moves to `to_ns` and wakes whoever is due. Time never goes back.
    pub(crate) fn advance(&self, to_ns: u64) {
        self.0.now_ns.set(to_ns.max(self.now_ns()));
        for timer in self.0.timers.borrow_mut().iter_mut().filter(|timer| timer.at_ns <= to_ns) {
            timer.at_ns = IDLE;
            timer.waker.wake_by_ref();
        }
    }

    /// Runs `f` with this clock behind `embassy-time`.
    pub(crate) fn enter<T>(&self, f: impl FnOnce() -> T) -> T {
        /// Puts the clock of an outer simulation back, also when `f` panics.
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

/// See [`Clock::sleep_until`].
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

thread_local! {
    /// The clock of the simulation that this thread is running.
    static CURRENT: RefCell<Option<Clock>> = const { RefCell::new(None) };
}

/// `embassy-time` on the clock of the running simulation, so that firmware needs no other time than its own.
struct VirtualTime;

impl embassy_time_driver::Driver for VirtualTime {
    fn now(&self) -> u64 {
        CURRENT.with_borrow(|clock| clock.as_ref().map_or(0, |clock| clock.now_ns() / NS_PER_TICK))
    }

    fn schedule_wake(&self, at: u64, waker: &Waker) {
        CURRENT.with_borrow(|clock| match clock {
            Some(clock) => clock.wake_at(at.saturating_mul(NS_PER_TICK), waker),
            // Outside a simulation no time passes: let the caller look again rather than sleep for ever.
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
