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
