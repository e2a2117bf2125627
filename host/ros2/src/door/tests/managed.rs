//! Tests of a managed node's session in virtual time.

use super::*;
use crate::lifecycle::{Change, Transition};

impl Ros<'_> {
    async fn change(&self, transition: Transition) -> bool {
        let (answer, answered) = oneshot::channel();
        self.send(Order::Change(Change { transition, answer }));
        answered.await.expect("an answer")
    }

    fn was_deactivated(&self) -> bool {
        self.reports.borrow().contains(&Report::Deactivated)
    }
}

#[test]
fn an_active_node_is_armed_and_an_inactive_one_is_not() {
    beside_node("sim:openscout", true, async |ros| {
        let refused = ros.call(Request::Arm).await;
        assert!(!refused.success && refused.message.contains("activate"), "{refused:?}");
        assert!(ros.change(Transition::Activate).await);
        ros.drive(0.3, 1.0).await;
        assert!((ros.speed_m_s() - 0.3).abs() < 0.05, "{}", ros.speed_m_s());
        assert!(ros.change(Transition::Deactivate).await);
        ros.sleep_s(0.2).await;
        assert_eq!(ros.state(), "disarmed");
        assert!(!ros.was_deactivated(), "it was asked for");
    });
}

#[test]
fn a_trip_and_a_disarming_make_it_inactive() {
    for request in [Request::Stop, Request::Disarm] {
        beside_node("sim:openscout", true, async |ros| {
            assert!(ros.change(Transition::Activate).await);
            ros.sleep_s(0.2).await;
            assert!(ros.call(request).await.success);
            ros.sleep_s(0.2).await;
            assert!(ros.was_deactivated(), "{request:?}");
            if request == Request::Stop {
                assert!(!ros.change(Transition::Activate).await, "it is tripped");
                assert!(ros.of_commands().contains("not activated"), "{}", ros.of_commands());
                assert!(ros.call(Request::Clear).await.success);
            }
            assert!(ros.change(Transition::Activate).await);
        });
    }
}

/// A heartbeat that is due when the board is to be armed is sent just before that request, and the two answers arrive together: the
/// heartbeat's, disarmed, is the first news since the trip was cleared.
#[test]
fn a_node_activated_together_with_a_heartbeat_stays_active() {
    beside_node("sim:openscout", true, async |ros| {
        let board = ros.session.board;
        let mut answers = board.heartbeat_answers();
        let mut sent_us = 0;
        let mut period_us = 0;
        for _ in 0..3 {
            let answer = answers.next().await.expect("a heartbeat");
            period_us = answer.host_us - sent_us;
            sent_us = answer.host_us;
        }
        for ahead_us in (1..10).map(|nth| nth * 200) {
            assert!(ros.call(Request::Stop).await.success);
            ros.sleep_s(0.2).await;
            let periods = (board.host_now_us() - sent_us) / period_us + 2;
            let due_us = sent_us + periods * period_us;
            ros.sleep_s((due_us - ahead_us - board.host_now_us()) as f64 * 1e-6).await;
            assert!(ros.call(Request::Clear).await.success);
            ros.sleep_s((due_us - board.host_now_us()) as f64 * 1e-6).await;
            ros.reports.borrow_mut().clear();
            assert!(ros.change(Transition::Activate).await);
            ros.sleep_s(0.2).await;
            assert!(!ros.was_deactivated(), "cleared {ahead_us} us before the heartbeat");
        }
    });
}

#[test]
fn nothing_is_activated_while_the_estop_topic_is_engaged() {
    beside_node("sim:openscout", true, async |ros| {
        ros.send(Order::Estop(true));
        ros.sleep_s(0.2).await;
        assert!(!ros.change(Transition::Activate).await);
        ros.send(Order::Estop(false));
        assert!(ros.call(Request::Clear).await.success);
        assert!(ros.change(Transition::Activate).await);
    });
}

#[test]
fn a_clean_up_ends_the_session_disarmed() {
    let rig = Rig::new("sim:openscout".parse().expect("a board"));
    let served = rig.run(None, async |session| {
        let (orders, queue) = futures::channel::mpsc::unbounded();
        let door =
            Door { clock: RosClock::Simulated { start: Stamp::default() }, has_transform: true, is_managed: true };
        let (answer, _active) = oneshot::channel();
        orders.unbounded_send(Order::Change(Change { transition: Transition::Activate, answer })).expect("a queue");
        let (answer, cleaned) = oneshot::channel();
        orders.unbounded_send(Order::Change(Change { transition: Transition::Cleanup, answer })).expect("a queue");
        let ended = door.serve(session, queue, |_| true).await?;
        let Ended::Session(Change { transition, answer }) = ended else { panic!("{ended:?}") };
        assert_eq!(transition, Transition::Cleanup);
        assert_ne!(session.board.safety().0, SafetyState::Armed);
        answer.send(true).expect("somebody asked");
        assert_eq!(cleaned.await, Ok(true));
        Ok::<_, Error>(())
    });
    served.expect("a session");
}
