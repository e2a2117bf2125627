//! Tests of the broker with a simulated board and drivers as its clients. All time is virtual.

#[path = "../../../driver/tests/all/simulated/mod.rs"]
mod simulated;

mod guarded;

use std::{
    cell::{Cell, RefCell},
    convert::Infallible,
    pin::pin,
    rc::Rc,
};

use embedded_io_async::{ErrorType, Read, Write};
use futures::{
    StreamExt,
    channel::mpsc::{UnboundedSender, unbounded},
    future::{Either, join, select},
};
use r4_broker::{Broker, Left};
use r4_driver::{Board, Clock, Error, with_board};
use r4_protocol::{
    Cause, ChannelId, ChannelKind, FrameDecoder, Mode, Refusal, Reply, Request, SCHEMA_HASH, SafetyState, Setpoint,
    Spoken, ToDevice, ToHost, VERSION, encode_frame,
    frame::{Check, MAX_FRAME, encode_with},
    version::SPOKEN,
};
use r4_sim::link::{Port, Receiver, Sender, serial};
use simulated::{VirtualClock, simulated_link};

const ROTARY: ChannelId = ChannelId::new(ChannelKind::Osmc, 0);
const LINEAR: ChannelId = ChannelId::new(ChannelKind::Actuator, 1);
/// Link time-out of the simulated board, µs.
const LINK_TIMEOUT_US: u64 = 200_000;
/// Sampling period at which a client watches the board, ms.
const LOOK_MS: u16 = 5;
/// Baud rate of a link between a client and the broker: about that of USB at full speed.
const BAUD: u32 = 12_000_000;

/// The broker's end of a link, which a test can close.
struct End {
    rx: Receiver,
    is_closed: Rc<Cell<bool>>,
}

impl ErrorType for End {
    type Error = Infallible;
}

impl Read for End {
    async fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
        let mut reading = pin!(self.rx.read(buffer));
        std::future::poll_fn(|context| {
            if self.is_closed.get() {
                return std::task::Poll::Ready(Ok(0));
            }
            reading.as_mut().poll(context)
        })
        .await
    }
}

/// Connects clients to the broker under test, over links of virtual time.
struct Door {
    clock: VirtualClock,
    coming: UnboundedSender<(End, Sender)>,
    left: RefCell<Vec<Left>>,
}

impl Door {
    /// Returns a client's end of a link to the broker, and the switch that closes the broker's end at its next byte.
    fn connect(&self) -> (Port, Rc<Cell<bool>>) {
        let (here, there) = serial(&self.clock.0, BAUD);
        let is_closed = Rc::<Cell<bool>>::default();
        self.coming.unbounded_send((End { rx: there.rx, is_closed: is_closed.clone() }, there.tx)).expect("served");
        (here, is_closed)
    }

    /// Runs `work` as a client with a session.
    async fn client<T>(&self, work: impl AsyncFnOnce(&Board<VirtualClock>) -> T) -> T {
        let (port, _) = self.connect();
        with_board(port.rx, port.tx, self.clock.clone(), work).await.expect("a session with the broker")
    }
}

/// Runs `work` beside a broker of a simulated board; `board` is the broker's own session.
fn shared(work: impl AsyncFnOnce(&Door, &Board<VirtualClock>) -> Result<(), Error>) {
    let result = simulated_link(async |rx, tx, clock| {
        with_board(rx, tx, clock.clone(), async |board| serve(&Broker::new(board), board, clock, work).await).await?
    });
    result.expect("the clients' work");
}

async fn serve(
    broker: &Broker<'_, VirtualClock>,
    board: &Board<VirtualClock>,
    clock: VirtualClock,
    work: impl AsyncFnOnce(&Door, &Board<VirtualClock>) -> Result<(), Error>,
) -> Result<(), Error> {
    let (coming, comers) = unbounded();
    let door = Door { clock, coming, left: RefCell::default() };
    let serving = comers.for_each_concurrent(None, |(rx, tx)| async {
        let left = broker.client(rx, tx).await;
        door.left.borrow_mut().push(left);
    });
    let broker = join(broker.run(), serving);
    match select(pin!(work(&door, board)), pin!(broker)).await {
        Either::Left((result, _)) => result,
        Either::Right(((error, ()), _)) => Err(error),
    }
}

/// Waits until a client sees the board in a state. Returns the latched causes.
async fn until(board: &Board<VirtualClock>, state: SafetyState) -> r4_protocol::Causes {
    for _ in 0..400 {
        if board.safety().0 == state {
            return board.safety().1;
        }
        board.sleep_s(0.01).await;
    }
    panic!("the board is {} after 4 s", board.safety().0)
}

#[test]
fn one_commands_while_others_watch() {
    shared(async |door, _| {
        let watching = door.client(async |watcher| {
            let mut seen = watcher.samples(ROTARY, 15).await?;
            let mut dates = Vec::new();
            while seen.next().await.map(|sample| dates.push(sample.device_us)).is_ok() && dates.len() < 100 {
                if dates.len() == 50 {
                    // A refused command of a watcher does not take the command from its holder.
                    let refused = watcher.set(ROTARY, Setpoint { mode: Mode::Position, value: -1.0 }).await;
                    assert_eq!(refused, Err(Error::Refused(Refusal::InUse)));
                    assert_eq!(watcher.disarm().await, Err(Error::Refused(Refusal::InUse)));
                }
            }
            assert!(watcher.stats().await?.ticks > 0);
            Ok::<_, Error>(dates)
        });
        let commanding = door.client(async |commander| {
            commander.arm().await?;
            let reached = commander.move_to(ROTARY, 1.57, 10.0).await?;
            assert!((reached.position - 1.57).abs() < 0.02, "{reached:?}");
            commander.sleep_s(1.0).await;
            assert_eq!(commander.safety().0, SafetyState::Armed);
            commander.disarm().await
        });
        let (dates, commanded) = join(watching, commanding).await;
        commanded?;
        // The commander subscribed to the same channel every 10 ms and ended that: the common period changed twice.
        let dates = dates?;
        let apart: Vec<u64> = dates.windows(2).map(|pair| pair[1] - pair[0]).collect();
        assert!(apart.len() >= 99 && apart.iter().all(|us| us.abs_diff(15_000) <= 5_000), "{apart:?}");
        assert!(dates[99].abs_diff(dates[0] + 99 * 15_000) <= 15_000, "{dates:?}");
        Ok(())
    });
}

#[test]
fn a_stop_is_taken_from_any_client() {
    shared(async |door, _| {
        let watching = door.client(async |watcher| {
            until(watcher, SafetyState::Armed).await;
            watcher.stop().await
        });
        let commanding = door.client(async |commander| {
            commander.arm().await?;
            let stopped = commander.move_to(LINEAR, 0.1, 10.0).await;
            assert!(
                matches!(stopped, Err(Error::Stopped { causes }) if causes.contains(Cause::HostStop)),
                "{stopped:?}"
            );
            Ok::<_, Error>(())
        });
        let (stopped, commanded) = join(watching, commanding).await;
        stopped.and(commanded)
    });
}

/// A client that fails while a motor moves, at twenty moments between its heartbeats: the board trips by itself
/// within its link time-out while another client watches, and another client may command afterwards.
#[test]
fn a_client_that_fails_trips_the_board_as_on_a_link_of_its_own() {
    for moment in 0..20 {
        shared(async |door, board| {
            let watching = door.client(async |watcher| {
                until(watcher, SafetyState::Armed).await;
                let mut samples = watcher.samples(ROTARY, LOOK_MS).await?;
                let tripped = loop {
                    let sample = samples.next().await?;
                    if sample.state == SafetyState::Tripped {
                        break sample;
                    }
                };
                assert!(tripped.causes.contains(Cause::LinkLost), "{}", tripped.causes);
                // The broker gives up the failed client after two link time-outs.
                watcher.sleep_s(0.5).await;
                watcher.clear().await?;
                watcher.arm().await?;
                watcher.move_to(ROTARY, 0.5, 10.0).await?;
                Ok::<_, Error>(tripped.host_us)
            });
            let failing = async {
                let port = door.connect().0;
                let ends = with_board(port.rx, port.tx, door.clock.clone(), async |commander| {
                    commander.arm().await?;
                    commander.set(ROTARY, Setpoint { mode: Mode::Speed, value: 2.0 }).await?;
                    commander.sleep_s(10.0).await;
                    Ok::<_, Error>(())
                });
                let dies_us = board.host_now_us() + 560_000 + moment * 2_500;
                select(pin!(ends), pin!(door.clock.sleep_until(dies_us))).await;
                dies_us
            };
            let (tripped_us, failed_us) = join(watching, failing).await;
            // The last heartbeat was at most a quarter of the time-out earlier. The watcher's samples, the links and
            // the board's supervisor add some ms.
            let after_us = tripped_us?.saturating_sub(failed_us);
            let expected = LINK_TIMEOUT_US * 3 / 4..=LINK_TIMEOUT_US + 5_000 + 1_000 * u64::from(LOOK_MS);
            assert!(expected.contains(&after_us), "{after_us} us");
            Ok(())
        });
    }
}

#[test]
fn a_goodbye_leaves_the_board_disarmed_and_free() {
    shared(async |door, board| {
        for _ in 0..3 {
            door.client(async |commander| commander.arm().await).await?;
            assert_eq!(board.stats().await?.refused, 0);
            let (state, causes) = board.safety();
            assert!(state != SafetyState::Tripped, "{causes}");
        }
        Ok(())
    });
}

/// A client whose link closes without the end of its session while nothing can move.
#[test]
fn who_is_gone_from_a_disarmed_board_trips_nothing() {
    shared(async |door, board| {
        let (port, is_closed) = door.connect();
        with_board(port.rx, port.tx, door.clock.clone(), async |commander| {
            commander.arm().await?;
            commander.disarm().await?;
            commander.sleep_s(1.0).await;
            is_closed.set(true);
            commander.sleep_s(0.3).await;
            Ok::<_, Error>(())
        })
        .await??;
        assert_eq!(door.left.borrow().as_slice(), [Left::Gone]);
        door.client(async |next| next.arm().await).await?;
        assert!(board.safety().0 != SafetyState::Tripped);
        Ok(())
    });
}

#[test]
fn cycles_go_through() {
    shared(async |door, _| {
        door.client(async |commander| {
            commander.arm().await?;
            let mut cycles = commander.stream(&[(ROTARY, Mode::Speed)], 100).await?;
            for _ in 0..200 {
                cycles.set(&[1.0])?;
                cycles.next().await?;
            }
            let counters = cycles.counters();
            assert_eq!((counters.answered, counters.lost), (200, 0), "{counters:?}");
            drop(cycles);
            commander.disarm().await
        })
        .await
    });
}

/// A client that sends and receives single messages, without a driver.
struct Raw {
    port: Port,
    decoder: FrameDecoder,
}

impl Raw {
    fn new(door: &Door) -> Self {
        Self { port: door.connect().0, decoder: FrameDecoder::new() }
    }

    /// Presents a token, as `r4_access::Presenter` does.
    async fn present(&mut self, token: &str) {
        self.port.tx.write_all(format!("{token}\0").as_bytes()).await.expect("never fails");
    }

    async fn send(&mut self, message: &ToDevice) {
        let mut buffer = [0; MAX_FRAME];
        let frame = encode_frame(message, &mut buffer).expect("fits");
        self.port.tx.write_all(frame).await.expect("never fails");
    }

    async fn next(&mut self) -> ToHost {
        loop {
            let mut byte = [0];
            let _ = self.port.rx.read(&mut byte).await;
            if let Some(message) = self.decoder.push(byte[0]) {
                return message.expect("a message");
            }
        }
    }

    async fn request(&mut self, request: Request) -> Result<Reply, Refusal> {
        self.send(&ToDevice::Request { seq: 7, request }).await;
        loop {
            if let ToHost::Response { seq: 7, result } = self.next().await {
                return result;
            }
        }
    }

    async fn hello(&mut self) -> u16 {
        match self.request(Request::Hello { version: VERSION, schema: SCHEMA_HASH }).await {
            Ok(Reply::Hello(info)) => info.session,
            other => panic!("{other:?}"),
        }
    }
}

#[test]
fn sessions_are_each_clients_own() {
    shared(async |door, _| {
        let (mut one, mut other) = (Raw::new(door), Raw::new(door));
        assert_eq!(one.request(Request::Stats).await, Err(Refusal::NoSession));
        let mismatch = Refusal::ProtocolMismatch { version: VERSION, schema: SCHEMA_HASH };
        assert_eq!(one.request(Request::Hello { version: VERSION + 1, schema: 1 }).await, Err(mismatch));
        let (first, second) = (one.hello().await, other.hello().await);
        assert_ne!(first, second);
        // A heartbeat with the number of another session is ignored.
        one.send(&ToDevice::Heartbeat { session: second, host_us: 1 }).await;
        one.send(&ToDevice::Heartbeat { session: first, host_us: 2 }).await;
        assert!(matches!(one.next().await, ToHost::Heartbeat { host_us: 2, .. }));
        assert_eq!(one.request(Request::Bye).await, Ok(Reply::Done));
        assert_eq!(one.request(Request::Stats).await, Err(Refusal::NoSession));
        assert!(other.request(Request::Stats).await.is_ok());
        Ok(())
    });
}

/// Sessions of version 12 have no repeats: the same request with the same number is a new one.
#[test]
fn a_session_of_an_older_version_has_no_repeats() {
    let old = SPOKEN[2];
    assert_eq!(old.version, 12);
    shared(async |door, board| {
        let mut client = Raw::new(door);
        let Spoken { version, schema } = old;
        assert!(matches!(client.request(Request::Hello { version, schema }).await, Ok(Reply::Hello(_))));
        assert_eq!(client.request(Request::Arm).await, Ok(Reply::Done));
        board.stop().await?;
        let refused = client.request(Request::Arm).await;
        assert!(matches!(refused, Err(Refusal::Tripped { .. })), "{refused:?}");
        Ok(())
    });
}

/// A request that the client repeats because it missed the answer.
#[test]
fn a_repeat_is_answered_and_not_passed_on() {
    shared(async |door, _| {
        let mut client = Raw::new(door);
        let session = client.hello().await;
        let steps = [
            (1, Request::Arm, SafetyState::Armed),
            (2, Request::Disarm, SafetyState::Disarmed),
            (1, Request::Arm, SafetyState::Disarmed),
            (3, Request::Arm, SafetyState::Armed),
        ];
        for (step, (seq, request, expected)) in steps.into_iter().enumerate() {
            client.send(&ToDevice::Request { seq, request }).await;
            while client.next().await != (ToHost::Response { seq, result: Ok(Reply::Done) }) {}
            client.send(&ToDevice::Heartbeat { session, host_us: step as u64 }).await;
            let state = loop {
                match client.next().await {
                    ToHost::Heartbeat { host_us, state, .. } if host_us == step as u64 => break state,
                    _ => {}
                }
            };
            assert_eq!(state, expected, "{step}");
        }
        Ok(())
    });
}

/// More requests than the board answers in time: the rest is refused, but not a stop.
#[test]
fn a_flood_of_requests_keeps_no_stop_out() {
    shared(async |door, board| {
        let mut client = Raw::new(door);
        client.hello().await;
        let mut frames = Vec::new();
        let requests = (100..300).map(|seq| (seq, Request::Stats)).chain([(99, Request::Stop)]);
        for (seq, request) in requests {
            let message = ToDevice::Request { seq, request };
            frames.extend_from_slice(encode_frame(&message, &mut [0; MAX_FRAME]).expect("fits"));
        }
        // Written at once, as a client does that waits for no answer.
        let writing = client.port.tx.write_all(&frames);
        writing.await.expect("never fails");
        let (mut answered, mut busy) = (0, 0);
        loop {
            match client.next().await {
                ToHost::Response { seq: 99, result } => {
                    assert_eq!(result, Ok(Reply::Done));
                    break;
                }
                ToHost::Response { result: Ok(_), .. } => answered += 1,
                ToHost::Response { result: Err(Refusal::Busy), .. } => busy += 1,
                _ => {}
            }
        }
        assert!(answered > 0 && busy > 0, "{answered} {busy}");
        board.sleep_s(0.1).await;
        assert_eq!(board.safety().0, SafetyState::Tripped);
        Ok(())
    });
}

/// A commanding client that sends a request of a later protocol version.
#[test]
fn what_is_not_known_leaves_nothing_in_force() {
    shared(async |door, board| {
        let mut client = Raw::new(door);
        let session = client.hello().await;
        assert_eq!(client.request(Request::Arm).await, Ok(Reply::Done));
        client.send(&ToDevice::Heartbeat { session, host_us: 1 }).await;
        while !matches!(client.next().await, ToHost::Heartbeat { state: SafetyState::Armed, .. }) {}
        // Variant 250 of the requests, which does not exist, with sequence number 9.
        let mut buffer = [0; MAX_FRAME];
        let frame = encode_with(&(0_u8, 9_u16, 250_u8, 1_u8), Check::Long, &mut buffer).expect("fits");
        client.port.tx.write_all(frame).await.expect("never fails");
        let refused = ToHost::Response { seq: 9, result: Err(Refusal::UnknownMessage) };
        while client.next().await != refused {}
        client.send(&ToDevice::Heartbeat { session, host_us: 2 }).await;
        while !matches!(client.next().await, ToHost::Heartbeat { host_us: 2, state: SafetyState::Disarmed, .. }) {}
        assert_eq!(board.safety().0, SafetyState::Disarmed);
        Ok(())
    });
}

#[test]
fn who_is_silent_is_dropped() {
    shared(async |door, board| {
        let _silent = door.connect();
        board.sleep_s(1.9).await;
        assert_eq!(door.left.borrow().as_slice(), []);
        board.sleep_s(0.2).await;
        assert_eq!(door.left.borrow().as_slice(), [Left::Silent]);
        Ok(())
    });
}
