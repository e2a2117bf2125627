//! Test of one cause on a board with a running motor: off in time, tripped, latched, and afterwards as new.

use r4_boards::Robot;
use r4_driver::Error;
use r4_protocol::{Cause, Causes, Mode, Refusal, SafetyState};
use r4_sim::{Pace, Simulation};

use super::{Bench, Device, MS, PowerUp, ROTARY, US, bench_of, osmc_bench, power_up};

/// Period of the bench's control loop, ns.
pub(crate) const PERIOD_NS: u64 = MS;
/// Number of periods from one read-back of the chip to the next on a steadily driven bench.
pub(crate) const CHECK_EVERY: u64 = 4;
/// Number of read-backs for one round: the mode, the relays, and four lines of each of two bridges.
pub(crate) const CHECKS: u64 = 10;
/// Time in which everything has settled, ms: contact bounce (20 ms), the supply's filter, the set-up of the chip.
pub(crate) const SETTLED_MS: u64 = 150;

/// A cause, its injection, and the expected reaction.
pub(crate) struct Trip<I: AsyncFn(&Bench<'_>, &Robot)> {
    pub(crate) cause: Cause,
    /// Injects the cause on a board with a running motor; its own time counts.
    pub(crate) inject: I,
    /// True if the cause is present until removed, false if it is over at once.
    pub(crate) stays: bool,
    /// Removes the cause again.
    pub(crate) remedy: fn(&Device, &Robot),
    /// Longest time from the injection until the bridges are off, ns.
    pub(crate) off_ns: u64,
    /// Longest time from the injection until all outputs of the chip are written off, ns; `None` while the bus does not
    /// work.
    pub(crate) written_ns: Option<u64>,
    /// Number of injection times, spread over the 72 ms of one complete round of the firmware's checks.
    pub(crate) moments: u64,
}

/// The bench with its rod at a position of its stroke, m.
pub(crate) fn bench_with_rod_at(start_m: f64) -> Robot {
    let mut robot = osmc_bench();
    robot.simulation.motors[1].start = start_m;
    robot
}

/// Remedy for causes that are over at once.
pub(crate) fn nothing(_: &Device, _: &Robot) {}

impl<I: AsyncFn(&Bench<'_>, &Robot)> Trip<I> {
    /// Runs the test: off in time, tripped, latched, and afterwards as new.
    pub(crate) fn check(&self, name: &str) {
        self.check_on(&power_up, name);
    }

    /// Runs the test on any board for the bench.
    pub(crate) fn check_on(&self, power_up: PowerUp<'_>, name: &str) {
        let robot = bench_with_rod_at(0.010);
        let (mut worst_off_ns, mut worst_written_ns) = (0, None);
        for moment in 0..self.moments {
            let phase_ns = moment * CHECKS * CHECK_EVERY * PERIOD_NS / self.moments + moment * 137 * US;
            bench_of(power_up, Simulation::new(Pace::Free), &robot, async |bench| {
                bench.run_rotary(phase_ns).await;
                let device = bench.device();
                device.record_wire();
                let at_ns = device.clock.now_ns();
                (self.inject)(bench, &robot).await;
                let off_ns = device.wait_off(at_ns, self.off_ns).await;
                let off_ns = off_ns.unwrap_or_else(|| panic!("{name}: not off after {} us", self.off_ns / US));
                worst_off_ns = worst_off_ns.max(off_ns);
                if let Some(limit_ns) = self.written_ns {
                    let written_ns = device.wait_all_off_written(at_ns, limit_ns).await;
                    let written_ns = written_ns.filter(|after_ns| *after_ns <= limit_ns);
                    assert!(written_ns.is_some(), "{name}: not written off after {} us", limit_ns / US);
                    worst_written_ns = worst_written_ns.max(written_ns);
                }
                self.check_latch(bench, &robot).await;
            });
        }
        eprintln!(
            "{name}: off after at most {} us, written off after at most {:?} us",
            worst_off_ns / US,
            worst_written_ns.map(|ns| ns / US)
        );
    }

    /// Checks that a trip ends only by clearing and then arming, with the cause gone.
    async fn check_latch(&self, bench: &Bench<'_>, robot: &Robot) {
        let (device, cause) = (bench.device(), self.cause);
        let (state, causes) = bench.safety().await;
        assert!(state == SafetyState::Tripped && causes.contains(cause), "{state}: {causes}");
        if self.stays {
            for refused in [bench.host.clear().await, bench.host.arm().await] {
                let present =
                    matches!(refused, Err(Error::Refused(Refusal::CausesPresent { causes })) if causes.contains(cause));
                assert!(present, "{cause}: {refused:?} while it is present");
            }
        }
        (self.remedy)(&device, robot);
        bench.sleep_ms(SETTLED_MS).await;
        let refused = bench.host.arm().await;
        assert!(
            matches!(refused, Err(Error::Refused(Refusal::Tripped { causes })) if causes.contains(cause)),
            "{refused:?}"
        );
        assert_eq!(bench.host.safety().0, SafetyState::Tripped);
        bench.host.clear().await.expect("the cause is gone");
        assert_eq!(bench.safety().await, (SafetyState::Disarmed, Causes::NONE));
        bench.host.arm().await.expect("cleared");
        bench.sleep_ms(200).await;
        assert_eq!(bench.host.safety().0, SafetyState::Armed, "{}", bench.host.safety().1);
        assert_eq!(device.duty(ROTARY), 0.0, "the command from before the trip is not resumed");
        bench.set(ROTARY, Mode::Duty, 0.8).await.expect("armed");
        bench.sleep_ms(300).await;
        assert!(
            bench.board.world().speed(ROTARY).expect("the bench has the channel") > 0.5,
            "a new command moves the motor"
        );
    }
}
