"""A managed node, `r4 ros2 --lifecycle`, with rclpy as its peer."""

import pytest
from conftest import DISCOVERY_S, DOMAIN, Peer, Served, simulated_time
from lifecycle_msgs.msg import State, Transition, TransitionEvent
from lifecycle_msgs.srv import ChangeState, GetAvailableStates, GetAvailableTransitions, GetState
from std_msgs.msg import Bool


class Managed:
    def __init__(self, served, peer):
        self.served, self.peer, self.events = served, peer, []
        peer.node.create_subscription(TransitionEvent, "r4/transition_event", self.events.append, 10)
        self.clients = {
            name: peer.node.create_client(kind, f"r4/{name}")
            for name, kind in [
                ("get_state", GetState),
                ("change_state", ChangeState),
                ("get_available_states", GetAvailableStates),
                ("get_available_transitions", GetAvailableTransitions),
            ]
        }

    def ask(self, name, request):
        client = self.clients[name]
        assert client.wait_for_service(timeout_sec=DISCOVERY_S), f"no service {name}"
        future = client.call_async(request)
        assert self.peer.until(future.done), f"no answer of {name}"
        return future.result()

    def state(self):
        return self.ask("get_state", GetState.Request()).current_state

    def change(self, number=0, label=""):
        return self.ask("change_state", ChangeState.Request(transition=Transition(id=number, label=label))).success


@pytest.fixture
def managed():
    domain = DOMAIN + 46
    served = Served("--board", "sim:openscout", "ros2", "--lifecycle", domain=domain)
    assert "managed, unconfigured" in served.first_line, served.first_line
    peer = Peer(domain=domain, **simulated_time())
    yield Managed(served, peer)
    peer.close()
    if served.process.poll() is None:
        served.end()


def test_it_is_configured_activated_and_back(managed):
    peer = managed.peer
    assert (managed.state().id, managed.state().label) == (State.PRIMARY_STATE_UNCONFIGURED, "unconfigured")
    states = managed.ask("get_available_states", GetAvailableStates.Request()).available_states
    assert [state.label for state in states] == ["unconfigured", "inactive", "active", "finalized"]
    # An unconfigured node has no topics of the board and cannot be activated.
    assert not managed.change(Transition.TRANSITION_ACTIVATE)
    assert "joint_states" not in peer.seen
    assert managed.change(Transition.TRANSITION_CONFIGURE)
    assert managed.state().label == "inactive"
    assert peer.until(lambda: {"joint_states", "odom", "r4/state"} <= peer.seen.keys()), peer.seen.keys()
    assert not peer.call("arm").success, "it is armed by activating"
    offered = managed.ask("get_available_transitions", GetAvailableTransitions.Request()).available_transitions
    assert {each.transition.label for each in offered} == {"cleanup", "activate", "shutdown"}
    assert managed.change(label="activate") and managed.state().label == "active"
    peer.drive(0.2, 0.0, 1.0)
    assert peer.seen["odom"].twist.twist.linear.x > 0.1
    assert managed.change(Transition.TRANSITION_DEACTIVATE)
    assert peer.until(lambda: peer.state() == "disarmed", 5.0), peer.state()
    assert managed.change(Transition.TRANSITION_CLEANUP) and managed.state().label == "unconfigured"
    # Configure again and shut down.
    peer.seen.clear()
    assert managed.change(Transition.TRANSITION_CONFIGURE)
    assert peer.until(lambda: "joint_states" in peer.seen)
    assert managed.change(Transition.TRANSITION_INACTIVE_SHUTDOWN)
    assert managed.served.process.wait(timeout=30) == 0
    peer.spin(0.2)
    told = [(event.start_state.label, event.goal_state.label) for event in managed.events]
    assert told[:2] == [("unconfigured", "configuring"), ("configuring", "inactive")]
    assert ("activating", "active") in told and ("deactivating", "inactive") in told and ("cleaningup", "unconfigured") in told


def test_the_estop_keeps_it_from_being_activated_and_ends_that(managed):
    peer = managed.peer
    assert managed.change(Transition.TRANSITION_CONFIGURE)
    assert peer.until(lambda: "r4/state" in peer.seen)
    peer.estop.publish(Bool(data=True))
    assert peer.until(lambda: (peer.state() or "").startswith("tripped"), 5.0), peer.state()
    assert not managed.change(Transition.TRANSITION_ACTIVATE) and managed.state().label == "inactive"
    peer.estop.publish(Bool(data=False))
    peer.spin(0.2)
    assert not managed.change(Transition.TRANSITION_ACTIVATE), "it is tripped"
    assert peer.call("clear").success
    assert managed.change(Transition.TRANSITION_ACTIVATE)
    peer.drive(0.2, 0.0, 0.5)
    managed.events.clear()
    peer.estop.publish(Bool(data=True))
    assert peer.until(lambda: managed.state().label == "inactive", 5.0), "it tripped"
    assert peer.until(lambda: len(managed.events) == 2, 5.0), managed.events
    assert managed.events[1].goal_state.label == "inactive"
    peer.estop.publish(Bool(data=False))


def test_ctrl_c_ends_it_in_any_state(managed):
    assert managed.state().label == "unconfigured"
    assert managed.served.end() == 0
