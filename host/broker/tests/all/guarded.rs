//! Tests of a guarded broker: which requests pass, and what a denied one leaves at the board. All time is virtual.

use std::{cell::RefCell, rc::Rc};

use ed25519_dalek::SigningKey;
use futures::future::join;
use r4_access::{
    Credential, Guard, Policy, Presenter, Source,
    chain::{Verified, verify},
    log::{Event, Memory},
};
use r4_broker::{Broker, Guarded};
use r4_driver::{Board, Clock, Error, with_board};
use r4_protocol::{Mode, Refusal, Reply, Request, SafetyState, Sample, Setpoint, ToDevice, ToHost};

use super::{Door, LINEAR, ROTARY, Raw, VirtualClock, serve, simulated_link, until};

/// Unix time at virtual time 0, ms: 2026-11-28.
const BEGIN_MS: u64 = 1_795_824_000_000;
/// Life of a token, s: the shortest that a policy allows.
const LIFE_S: u64 = 10;
/// Private key of the log.
const LOG_KEY: [u8; 32] = [5; 32];

fn operator() -> Credential {
    let key = SigningKey::from_bytes(&[1; 32]);
    Credential::with_key("alice", "bench", "operation", LIFE_S, key).expect("names")
}

/// Policy in which the operator may arm, watch everything, and move the rotary motor only.
fn policy() -> Policy {
    let text = format!(
        r#"
        name = "bench"
        [token]
        life_s = 10
        skew_s = 0
        [[subject]]
        name = "alice"
        key = "{}"
        roles = ["operator"]
        [[item]]
        resource = "board"
        purposes = ["operation"]
        [[item]]
        resource = "channel"
        purposes = ["operation"]
        [[item]]
        resource = "configuration"
        purposes = ["service"]
        [[rule]]
        roles = ["operator"]
        actions = ["arm", "read"]
        resources = ["board", "channel"]
        [[rule]]
        roles = ["operator"]
        actions = ["set"]
        resources = ["channel/osmc0"]
        "#,
        operator().public_key()
    );
    Policy::parse(&text).expect("valid")
}

fn now_ms(clock: &VirtualClock) -> u64 {
    BEGIN_MS + clock.now_us() / 1000
}

/// Token of the operator, valid from now on.
fn token(door: &Door) -> String {
    operator().token(false, now_ms(&door.clock)).expect("random")
}

/// Speed of a motor's sample, rad/s, without its sign.
fn speed_rad_s(sample: Sample) -> f64 {
    let Sample::Motor { speed, .. } = sample else { panic!("{sample:?} of a motor") };
    f64::from(speed).abs()
}

/// Runs `work` beside a guarded broker of a simulated board. Returns the events of the guard's log.
fn guarded(work: impl AsyncFnOnce(&Door, &Board<VirtualClock>) -> Result<(), Error>) -> Vec<Event> {
    let memory = Rc::<RefCell<Memory>>::default();
    let store = Box::new(memory.clone());
    let result = simulated_link(async |rx, tx, clock| {
        with_board(rx, tx, clock.clone(), async |board| {
            let key = SigningKey::from_bytes(&LOG_KEY);
            let guard = Guard::new(policy(), store, key, &Verified::default(), now_ms(&clock));
            let of_guard = clock.clone();
            let broker = Broker::guarded(board, Rc::new(Guarded::new(guard, move || now_ms(&of_guard))));
            serve(&broker, board, clock, work).await
        })
        .await?
    });
    result.expect("the clients' work");
    let memory = memory.borrow();
    let head = memory.head.as_ref().expect("written");
    let log = verify(&memory.text, head, &SigningKey::from_bytes(&LOG_KEY).verifying_key()).expect("intact");
    log.entries.into_iter().map(|entry| entry.event).collect()
}

/// Runs `work` as a client that presents tokens of the operator and renews them.
async fn operating<T>(door: &Door, work: impl AsyncFnOnce(&Board<VirtualClock>) -> T) -> T {
    let (port, _) = door.connect();
    let clock = door.clock.clone();
    let source = Some(Source::Key(Box::new(operator())));
    let tx = Presenter::new(port.tx, source, move || now_ms(&clock));
    with_board(port.rx, tx, door.clock.clone(), work).await.expect("a session with the broker")
}

const DENIED: Error = Error::Refused(Refusal::Denied);

#[test]
fn without_a_token_a_client_may_stop_and_disarm_only() {
    let events = guarded(async |door, board| {
        door.client(async |guest| {
            assert_eq!(guest.arm().await, Err(DENIED));
            assert_eq!(guest.set(ROTARY, Setpoint { mode: Mode::Speed, value: 1.0 }).await, Err(DENIED));
            assert_eq!(guest.stats().await, Err(DENIED));
            assert_eq!(guest.subscribe(ROTARY, 10).await, Err(DENIED));
            guest.disarm().await?;
            // By none of this the guest got the command: the operator arms beside it.
            operating(door, async |operator| {
                operator.arm().await?;
                until(guest, SafetyState::Armed).await;
                // A board that another client commands is stopped by anybody, but disarmed by its commander.
                assert_eq!(guest.disarm().await, Err(Error::Refused(Refusal::InUse)));
                guest.stop().await
            })
            .await?;
            assert_eq!(until(guest, SafetyState::Tripped).await, board.safety().1);
            assert_eq!(guest.clear().await, Err(DENIED));
            Ok::<_, Error>(())
        })
        .await
    });
    let denied = |event: &&Event| matches!(event, Event::Decided { basis: None, subject, .. } if subject.is_empty());
    // Arming, set point, counters, samples, clearing.
    assert_eq!(events.iter().filter(denied).count(), 5, "{events:?}");
}

#[test]
fn a_denial_does_not_say_what_exists() {
    guarded(async |door, _| {
        let mut client = Raw::new(door);
        client.hello().await;
        client.present(&token(door)).await;
        let none = r4_protocol::ChannelId::new(r4_protocol::ChannelKind::Servo, 200);
        let setpoint = Setpoint { mode: Mode::Speed, value: f32::NAN };
        for channel in [LINEAR, none] {
            let set = Request::Set { channel, setpoint, sent_us: 0, ttl_ms: 0 };
            assert_eq!(client.request(set).await, Err(Refusal::Denied), "{channel}");
        }
        for index in [0, 60_000] {
            assert_eq!(client.request(Request::DescribeParameter { index }).await, Err(Refusal::Denied));
        }
        Ok(())
    });
}

#[test]
fn a_client_that_renews_its_tokens_works_as_long_as_it_likes() {
    let events = guarded(async |door, _| {
        operating(door, async |operator| {
            operator.arm().await?;
            // Three lives of a token.
            for round in 0..6 {
                operator.move_to(ROTARY, f64::from(round % 2), 10.0).await?;
                operator.sleep_s(5.0).await;
            }
            operator.disarm().await
        })
        .await
    });
    let presented = events.iter().filter(|event| matches!(event, Event::Presented { .. })).count();
    // Every 5 s of at least 30 s.
    assert!(presented >= 7, "{presented}");
    assert!(!events.iter().any(|event| matches!(event, Event::Decided { basis: None, .. })), "{events:?}");
}

#[test]
fn a_denied_set_point_stops_its_channel() {
    guarded(async |door, board| {
        let mut client = Raw::new(door);
        let session = client.hello().await;
        client.present(&token(door)).await;
        assert_eq!(client.request(Request::Arm).await, Ok(Reply::Done));
        let mut seen = board.samples(ROTARY, 5).await?;
        let set = |board: &Board<VirtualClock>, value| Request::Set {
            channel: ROTARY,
            setpoint: Setpoint { mode: Mode::Speed, value },
            sent_us: board.device_us(),
            ttl_ms: 100,
        };
        // Speed is held until another set point comes. A token of another policy takes the client's rights away.
        assert_eq!(client.request(set(board, 2.0)).await, Ok(Reply::Done));
        let mut fastest = 0.0_f64;
        // A second: the motor first has to overcome its static friction.
        for beat in 0..200 {
            client.send(&ToDevice::Heartbeat { session, host_us: beat }).await;
            fastest = fastest.max(speed_rad_s(seen.next().await?.sample));
        }
        assert!(fastest > 0.5, "{fastest} rad/s");
        client.present("r4-token-1.AA.AA").await;
        assert_eq!(client.request(set(board, 1.0)).await, Err(Refusal::Denied));
        let mut slowest = f64::INFINITY;
        for beat in 200..400 {
            client.send(&ToDevice::Heartbeat { session, host_us: beat }).await;
            slowest = slowest.min(speed_rad_s(seen.next().await?.sample));
        }
        assert!(slowest < 0.1, "{slowest} rad/s");
        Ok(())
    });
}

#[test]
fn the_end_of_a_token_ends_motion_and_samples() {
    guarded(async |door, board| {
        let mut client = Raw::new(door);
        let session = client.hello().await;
        client.present(&token(door)).await;
        assert_eq!(client.request(Request::Arm).await, Ok(Reply::Done));
        assert_eq!(client.request(Request::Subscribe { channel: ROTARY, period_ms: 50 }).await, Ok(Reply::Done));
        let (mut samples, mut late_samples, mut armed_s) = (0, 0, 0.0_f64);
        for beat in 0..240 {
            client.send(&ToDevice::Heartbeat { session, host_us: beat }).await;
            loop {
                match client.next().await {
                    ToHost::Heartbeat { host_us, state, .. } if host_us == beat => {
                        if state == SafetyState::Armed {
                            armed_s = board.now_s();
                        }
                        break;
                    }
                    ToHost::Telemetry(_) if board.now_s() > LIFE_S as f64 + 0.1 => late_samples += 1,
                    ToHost::Telemetry(_) => samples += 1,
                    _ => {}
                }
            }
            board.sleep_s(0.05).await;
        }
        // Disarmed by the first heartbeat after the end, and not tripped: heartbeats went on.
        assert!((LIFE_S as f64 - 0.2..LIFE_S as f64 + 0.2).contains(&armed_s), "{armed_s}");
        assert_eq!(board.safety().0, SafetyState::Disarmed);
        assert!(samples > 150 && late_samples == 0, "{samples} {late_samples}");
        // The client goes on beating and does not keep others out.
        client.send(&ToDevice::Heartbeat { session, host_us: 240 }).await;
        let mut next = Raw::new(door);
        next.hello().await;
        next.present(&token(door)).await;
        assert_eq!(next.request(Request::Arm).await, Ok(Reply::Done));
        Ok(())
    });
}

#[test]
fn a_token_opens_one_link() {
    guarded(async |door, _| {
        let token = token(door);
        let (mut first, mut second) = (Raw::new(door), Raw::new(door));
        for client in [&mut first, &mut second] {
            client.hello().await;
            client.present(&token).await;
        }
        assert_eq!(second.request(Request::Arm).await, Err(Refusal::Denied));
        assert_eq!(first.request(Request::Arm).await, Ok(Reply::Done));
        Ok(())
    });
}

#[test]
fn cycles_need_the_permission_of_their_channels_each() {
    guarded(async |door, board| {
        operating(door, async |operator| {
            operator.arm().await?;
            assert!(operator.stream(&[(ROTARY, Mode::Speed), (LINEAR, Mode::Speed)], 100).await.is_err());
            let mut cycles = operator.stream(&[(ROTARY, Mode::Speed)], 100).await?;
            for _ in 0..100 {
                cycles.set(&[1.0])?;
                cycles.next().await?;
            }
            drop(cycles);
            Ok::<_, Error>(())
        })
        .await?;
        // A stream goes on after its client has lost its rights: the next cycle disarms.
        let mut client = Raw::new(door);
        let session = client.hello().await;
        client.present(&token(door)).await;
        assert_eq!(client.request(Request::Arm).await, Ok(Reply::Done));
        let channel =
            r4_protocol::CycleChannel { channel: ROTARY, mode: Mode::Speed, position_scale: 1e-3, speed_scale: 1e-3 };
        let bind = Request::Bind { channels: [channel].into_iter().collect(), ttl_ms: 100 };
        let bound = client.request(bind).await;
        assert_eq!(bound, Ok(Reply::Done));
        client.present("r4-token-1.AA.AA").await;
        let cycle = r4_protocol::Cycle::new(1, None, Some(board.device_us()), [500, 0, 0, 0]);
        client.send(&ToDevice::Cycle(cycle)).await;
        while !matches!(client.next().await, ToHost::Cycle(_)) {}
        client.send(&ToDevice::Heartbeat { session, host_us: 1 }).await;
        until(board, SafetyState::Disarmed).await;
        Ok(())
    });
}

/// Guests that send whatever they can keep no stop of theirs and no motion of the operator out.
#[test]
fn denied_requests_do_not_disturb_the_operator() {
    guarded(async |door, _| {
        let guest = door.client(async |guest| {
            for _ in 0..200 {
                assert_eq!(guest.arm().await, Err(DENIED));
                assert_eq!(guest.set(ROTARY, Setpoint { mode: Mode::Speed, value: -1.0 }).await, Err(DENIED));
            }
            Ok::<_, Error>(())
        });
        let operator = operating(door, async |operator| {
            operator.arm().await?;
            let reached = operator.move_to(ROTARY, 1.0, 10.0).await?;
            assert!((reached.position - 1.0).abs() < 0.02, "{reached:?}");
            operator.disarm().await
        });
        let (guest, operator) = join(guest, operator).await;
        guest.and(operator)
    });
}
