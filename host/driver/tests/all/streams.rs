//! Tests of cycles, repeats, streams and the clock map, on a link to a simulated board that drops frames on demand.

use std::{cell::Cell, convert::Infallible, rc::Rc};

use crate::simulated::{VirtualClock, simulated, simulated_link};
use embedded_io_async::{ErrorType, Write};
use futures::future::{join, select};
use r4_driver::{Board, Clock, CycleCounters, Error, with_board};
use r4_protocol::{
    Causes, ChannelId, ChannelKind, CycleOutcome, Mode, Refusal, Request, SafetyState, Setpoint, ToDevice,
};
use r4_sim::link::Sender;

const ROTARY: ChannelId = ChannelId::new(ChannelKind::Osmc, 0);
const LINEAR: ChannelId = ChannelId::new(ChannelKind::Actuator, 1);

/// Transmitting half of the link, which drops the next n frames.
struct Lossy {
    tx: Sender,
    lose: Rc<Cell<u32>>,
}

impl ErrorType for Lossy {
    type Error = Infallible;
}

impl Write for Lossy {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        // One call is one frame, because the driver writes frames one at a time.
        match self.lose.get().checked_sub(1) {
            Some(left) => {
                self.lose.set(left);
                Ok(bytes.len())
            }
            None => self.tx.write(bytes).await,
        }
    }

    async fn flush(&mut self) -> Result<(), Infallible> {
        self.tx.flush().await
    }
}

/// Runs a session in which the cell `lose` holds the number of next frames to drop.
fn lossy(work: impl AsyncFnOnce(&Board<VirtualClock>, &Cell<u32>) -> Result<(), Error>) {
    let lose = Rc::new(Cell::new(0));
    let result = simulated_link(async |rx, tx, clock| {
        let tx = Lossy { tx, lose: lose.clone() };
        with_board(rx, tx, clock, async |board| work(board, &lose).await).await?
    });
    result.expect("a session");
}

/// Waits until just after a heartbeat, so that the next frame is the test's.
async fn after_a_heartbeat(board: &Board<VirtualClock>) {
    let mut last_us = board.device_us();
    // Heartbeats have a period of 50 ms; the first one leaves with the hello's answer.
    board.sleep_s(0.05 - (last_us % 50_000) as f64 * 1e-6).await;
    last_us = board.device_us();
    assert!(last_us > 0);
    board.stats().await.expect("answered");
}

#[test]
fn a_lost_request_is_sent_again_if_doing_it_twice_is_doing_it_once() {
    lossy(async |board, lose| {
        after_a_heartbeat(board).await;
        let mut sent = board.sent();
        lose.set(1);
        board.stats().await?;
        let repeats = std::iter::from_fn(|| sent.try_next()).collect::<Vec<_>>();
        assert_eq!(repeats.len(), 2, "{repeats:?}");
        assert_eq!(repeats[0].message, repeats[1].message);

        after_a_heartbeat(board).await;
        while sent.try_next().is_some() {}
        lose.set(1);
        // The board carries out the repeated request only once; a set point is too old by then.
        board.arm().await?;
        let tries = std::iter::from_fn(|| sent.try_next())
            .filter(|sent| matches!(sent.message, ToDevice::Request { request: Request::Arm, .. }));
        assert_eq!(tries.count(), 2);
        after_a_heartbeat(board).await;
        while sent.try_next().is_some() {}
        lose.set(1);
        let setpoint = Setpoint { mode: Mode::Speed, value: 0.1 };
        assert_eq!(board.set(ROTARY, setpoint).await, Err(Error::TimedOut { request: "set", after_ms: 500 }));
        let tries = std::iter::from_fn(|| sent.try_next())
            .filter(|sent| matches!(sent.message, ToDevice::Request { request: Request::Set { .. }, .. }));
        assert_eq!(tries.count(), 1);
        Ok(())
    });
}

#[test]
fn an_armed_board_is_armed_before_its_next_heartbeat() {
    simulated(async |board| {
        after_a_heartbeat(board).await;
        assert_eq!(board.safety().0, SafetyState::Disarmed);
        board.arm().await?;
        assert_eq!(board.safety(), (SafetyState::Armed, Causes::NONE));
        Ok(())
    })
    .expect("a session");
}

#[test]
fn the_newest_set_points_win_and_what_is_not_sent_is_counted() {
    simulated(async |board| {
        board.arm().await?;
        let mut cycles = board.stream(&[(ROTARY, Mode::Duty), (LINEAR, Mode::Position)], 100).await?;
        // No message leaves in between, because the test does not yield.
        cycles.set(&[0.1, 0.01])?;
        cycles.set(&[0.2, 0.02])?;
        let report = cycles.cycle(&[0.3, 0.03]).await?;
        assert_eq!((report.number, report.outcome), (2, CycleOutcome::Taken));
        let counters = CycleCounters { sent: 1, answered: 1, replaced: 2, ..CycleCounters::default() };
        assert_eq!(cycles.counters(), counters);
        let mut rod = board.samples(LINEAR, 1).await?;
        board.sleep_s(0.005).await;
        let sample = loop {
            let sample = rod.next().await?;
            if sample.device_us > report.device_us + 2000 {
                break sample;
            }
        };
        let r4_protocol::Sample::Motor { setpoint, .. } = sample.sample else { panic!("{sample:?}") };
        assert!(setpoint.mode == Mode::Position && (setpoint.value - 0.03).abs() < 2e-6, "{setpoint:?}");

        // A value outside the channel's range is not sent.
        let refused = cycles.cycle(&[0.3, 0.2]).await;
        assert!(matches!(refused, Err(Error::Refused(Refusal::OutOfRange { channel: LINEAR, .. }))), "{refused:?}");
        assert_eq!(cycles.set(&[0.3]), Err(Error::CycleLength { asked: 1, expected: 2 }));
        assert_eq!(cycles.counters().sent, 1);

        // A board has one stream; another can be opened after it is dropped.
        assert!(matches!(board.stream(&[(ROTARY, Mode::Speed)], 100).await, Err(Error::StreamOpen)));
        drop(cycles);
        let home = board.stream(&[(ROTARY, Mode::Home)], 100).await;
        assert!(matches!(home, Err(Error::Refused(Refusal::WrongMode { .. }))));
        let mut cycles = board.stream(&[(ROTARY, Mode::Speed)], 100).await?;
        let report = cycles.ask().await?;
        assert_eq!((report.number, report.motors.len()), (0, 1));
        assert_eq!(report.state, SafetyState::Armed);
        Ok(())
    })
    .unwrap();
}

#[test]
fn a_lost_cycle_is_counted_and_told() {
    lossy(async |board, lose| {
        let mut cycles = board.stream(&[(ROTARY, Mode::Speed)], 100).await?;
        cycles.ask().await?;
        after_a_heartbeat(board).await;
        lose.set(1);
        for _ in 0..3 {
            cycles.send(&[0.0]).await?;
        }
        // The board is not armed, so it refuses the other two, which is an answer.
        for number in [2, 3] {
            let report = cycles.next().await?;
            assert_eq!((report.number, report.outcome), (number, CycleOutcome::Refused));
        }
        let counters = CycleCounters { sent: 4, answered: 3, lost: 1, ..CycleCounters::default() };
        assert_eq!(cycles.counters(), counters);
        after_a_heartbeat(board).await;
        lose.set(1);
        assert_eq!(cycles.ask().await, Err(Error::TimedOut { request: "cycle", after_ms: 500 }));
        board.sleep_s(0.1).await;
        assert_eq!(cycles.counters(), CycleCounters { sent: 5, lost: 2, ..counters });
        Ok(())
    });
}

/// Cycles as fast as the link carries them leave heartbeats, requests and telemetry their share, and none is lost.
#[test]
fn cycles_at_full_rate_starve_nobody() {
    simulated(async |board| {
        board.arm().await?;
        let channels = [(ROTARY, Mode::Speed), (LINEAR, Mode::Duty)];
        let mut cycles = board.stream(&channels, 100).await?;
        let mut samples = board.samples(LINEAR, 20).await?;
        let begin_us = board.device_us();
        let cycling = async {
            for _ in 0..8 {
                cycles.send(&[1.0, 0.0]).await?;
            }
            while board.device_us() - begin_us < 1_000_000 {
                assert_eq!(cycles.next().await?.outcome, CycleOutcome::Taken);
                cycles.send(&[1.0, 0.0]).await?;
            }
            for _ in 0..8 {
                cycles.next().await?;
            }
            Ok::<_, Error>(())
        };
        let asking = async {
            for _ in 0..20 {
                board.stats().await?;
                board.sleep_s(0.04).await;
            }
            Ok::<_, Error>(())
        };
        let (cycled, asked) = join(cycling, asking).await;
        cycled.and(asked)?;
        let CycleCounters { sent, answered, lost, replaced, dropped } = cycles.counters();
        // A frame of 45 bytes with 10 bits each takes 450 µs at 1 Mbaud.
        assert!(sent > 1800, "{sent} in a second");
        assert_eq!((answered, lost, replaced, dropped), (sent, 0, 0, 0));
        let told = std::iter::from_fn(|| samples.try_next()).count();
        assert!(told >= 45, "{told} samples, one each 20 ms");
        assert_eq!(board.safety().0, SafetyState::Armed);
        assert_eq!(board.stats().await?.cycles_refused, 0);
        Ok(())
    })
    .unwrap();
}

#[test]
fn a_future_that_is_dropped_leaves_nothing_behind() {
    simulated(async |board| {
        for _ in 0..3 {
            // The future is dropped before the board can have answered.
            let opening = std::pin::pin!(board.stream(&[(ROTARY, Mode::Speed)], 100));
            let soon = std::pin::pin!(board.sleep_s(50e-6));
            assert!(matches!(select(opening, soon).await, futures::future::Either::Right(_)));
        }
        let mut cycles = board.stream(&[(ROTARY, Mode::Speed)], 100).await?;
        {
            let turn = std::pin::pin!(cycles.ask());
            let soon = std::pin::pin!(board.sleep_s(50e-6));
            assert!(matches!(select(turn, soon).await, futures::future::Either::Right(_)));
        }
        let report = cycles.ask().await?;
        assert_eq!((report.number, cycles.counters().lost), (1, 0));
        Ok(())
    })
    .unwrap();
}

#[test]
fn what_is_sent_and_subscribed_to_is_told() {
    simulated(async |board| {
        let mut sent = board.sent();
        board.arm().await?;
        let duty = Setpoint { mode: Mode::Duty, value: 0.25 };
        board.set(LINEAR, duty).await?;
        let mut cycles = board.stream(&[(ROTARY, Mode::Duty)], 100).await?;
        let report = cycles.cycle(&[1.0 / 4.0]).await?;
        drop(cycles);
        board.disarm().await?;
        let sent: Vec<_> = std::iter::from_fn(|| sent.try_next()).collect();
        let of = |request: fn(&ToDevice) -> bool| sent.iter().find(|sent| request(&sent.message)).unwrap();
        of(|message| matches!(message, ToDevice::Request { request: Request::Arm, .. }));
        let set = of(|message| matches!(message, ToDevice::Request { request: Request::Set { .. }, .. }));
        assert_eq!(set.setpoints, [(LINEAR, duty)]);
        let cycle = of(|message| matches!(message, ToDevice::Cycle(_)));
        let [(ROTARY, Setpoint { mode: Mode::Duty, value })] = cycle.setpoints[..] else { panic!("{cycle:?}") };
        assert!((value - 0.25).abs() < 2e-5, "{value}");
        assert!((report.device_us - 1000..=report.device_us).contains(&cycle.device_us));

        board.subscribe(ROTARY, 10).await?;
        board.subscribe(LINEAR, 20).await?;
        board.subscribe(ROTARY, 30).await?;
        assert_eq!(board.subscriptions(), [(LINEAR, 20), (ROTARY, 30)]);
        board.subscribe(LINEAR, 0).await?;
        let supply = ChannelId::new(ChannelKind::Supply, 9);
        board.subscribe(supply, 5).await.unwrap_err();
        assert_eq!(board.subscriptions(), [(ROTARY, 30)], "what was refused is not remembered");
        Ok(())
    })
    .unwrap();
}

/// Board and driver share the simulation's clock, so the map must be the identity.
#[test]
fn the_boards_clock_is_known_both_ways() {
    simulated_link(async |rx, tx, clock| {
        with_board(rx, tx, clock.clone(), async |board| {
            for _ in 0..40 {
                board.sleep_s(0.05).await;
                let now_us = clock.now_us();
                let uncertainty_us = board.clock_uncertainty_us();
                assert!(uncertainty_us < 400.0, "{uncertainty_us} us");
                assert!((board.device_us() as f64 - now_us as f64).abs() <= uncertainty_us);
                assert!((board.host_us(now_us) as f64 - now_us as f64).abs() <= uncertainty_us);
            }
        })
        .await
    })
    .unwrap();
}
