//! The safety promises of the firmware, on the simulated board.

mod harness;

use harness::{ROTARY, bench, osmc_bench};
use r4_protocol::{Cause, Causes, Mode, SafetyState};

#[test]
fn releasing_the_dead_mans_handle_stops_a_moving_motor() {
    bench(&osmc_bench(), async |bench| {
        bench.host.arm().await.unwrap();
        bench.set(ROTARY, Mode::Duty, 0.8).await.unwrap();
        bench.sleep_ms(500).await;
        assert!(bench.board.world().speed(ROTARY).unwrap() > 0.5);
        bench.board.dead_man().set(false);
        // The stop line acts in the supervisor's own wake-up: the same instant of virtual time.
        bench.clock.sleep(1).await;
        assert!(bench.is_off(ROTARY));
        assert_eq!(bench.safety().await, (SafetyState::Tripped, Causes::only(Cause::DeadMan)));
    });
}
