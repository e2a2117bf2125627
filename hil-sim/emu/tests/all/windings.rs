//! Winding temperatures in the image: hosts are warned, and no kind of reset clears them.

use crate::emulated::{
    Setup,
    harness::{Device, MS, ROTARY, RawHost},
};
use r4_emu::fault::{Fault, Lasting};
use r4_plants::{Effect, effect::friction::CoulombFriction};
use r4_protocol::{Causes, HotWinding, Mode, Request, SafetyState, Setpoint, ToDevice, ToHost};

/// Exchanges one heartbeat. Returns the board's clock, µs, its state and causes, and the heat of the rotary motor's
/// winding, %, if the board warns of it.
async fn beat(host: &mut RawHost, session: u16) -> (u64, SafetyState, Causes, Option<u8>) {
    host.send(&ToDevice::Heartbeat { session, host_us: 0 }).await;
    let heard = host.listen(20).await;
    let answer = heard.iter().find_map(|message| match message {
        ToHost::Heartbeat { device_us, state, causes, hot, .. } => {
            let heat = hot
                .iter()
                .find_map(|HotWinding { channel, heat_percent }| (*channel == ROTARY).then_some(*heat_percent));
            Some((*device_us, *state, *causes, heat))
        }
        _ => None,
    });
    answer.expect("a heartbeat is answered")
}

/// Opens a session; returns its number and the heat in its first heartbeat.
async fn heat_after_start(host: &mut RawHost, device: &Device) -> (u16, Option<u8>) {
    // Bytes on the cable when the processor was reset form a damaged frame.
    host.listen(100).await;
    device.clock.sleep(50 * MS).await;
    let info = host.hello().await;
    (info.session, beat(host, info.session).await.3)
}

/// Load near the stall torque: the motor turns slowly, with more than its rated current, N m.
const LOAD_NM: f64 = 1.8;

#[test]
fn heat_outlives_the_watchdog_a_panic_and_a_restart() {
    let setup = Setup::osmc_bench();
    let (_, misuse) = setup.raw(async |host, device, board| {
        let load = Effect::CoulombFriction(CoulombFriction { level: LOAD_NM });
        device.add_effect(setup.robot(), ROTARY, load);
        let (mut session, cold) = heat_after_start(host, device).await;
        assert_eq!(cold, None, "no warning of what a start assumes");
        host.ask(Request::Arm).await.expect("nothing is wrong");
        let before = loop {
            let (sent_us, state, causes, heat) = beat(host, session).await;
            assert_eq!((state, causes), (SafetyState::Armed, Causes::NONE), "{heat:?} %");
            if let Some(heat @ 90..) = heat {
                break heat;
            }
            assert!(device.clock.now_ns() < 12_000 * MS, "{heat:?} % after 12 s");
            let setpoint = Setpoint { mode: Mode::Duty, value: 0.9 };
            host.ask(Request::Set { channel: ROTARY, setpoint, sent_us, ttl_ms: 500 }).await.expect("armed");
            host.listen(80).await;
        };
        assert!(before < 95, "{before} %: it was to be hot, not to trip");
        eprintln!("{before} % after {} ms", device.clock.now_ns() / MS);
        let mut after = before;
        for ended in [Some(Fault::SupervisorHangs), Some(Fault::Panic), None] {
            match ended {
                Some(fault) => {
                    board.inject(fault, Lasting::UntilReset).expect("the image has it");
                    host.listen(50).await;
                }
                None => {
                    host.ask(Request::Restart).await.expect("it is not armed");
                }
            }
            let (next, heat) = heat_after_start(host, device).await;
            // Each of the three resets takes about 0.3 s, in which a winding with a time constant of 30 s cools by 1 %.
            let heat = heat.unwrap_or_else(|| panic!("{ended:?}: forgotten"));
            eprintln!("{heat} % after {ended:?}");
            assert!((after - 2..=after + 1).contains(&heat), "{ended:?}: {heat} % after {after} %");
            (session, after) = (next, heat);
        }
        // The heat is not frozen either: the same model continues.
        let mut cooled = after;
        for _ in 0..10 {
            cooled = beat(host, session).await.3.expect("it is still hot");
            host.listen(80).await;
        }
        assert!((2..=5).contains(&(after - cooled)), "1 s of 30 s are 3.3 %: {after} % to {cooled} %");
    });
    // A reset in the middle of a read leaves the chip so; the next start frees the bus first.
    let others: Vec<_> = misuse.into_iter().filter(|what| !what.contains("read of no bytes")).collect();
    assert_eq!(others, Vec::<String>::new());
}
