"""Trajectories on a simulated bench, each sent once by rclpy."""

import math

import pytest
from conftest import DOMAIN, Peer, Served, simulated_time
from rclpy.duration import Duration
from rclpy.time import Time
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

# Amplitude in rad and angular frequency in rad/s of (1 - cos) / 2, which starts and ends at rest. Its highest speed is 1.57 rad/s, below the
# limit of 2.5 rad/s (osmc-bench.toml).
SWING = 1.0
RATE = math.pi
# Limit of the tracking error by the joint's own sensor. In virtual time the largest is 0.036 rad, at a reversal before the friction is
# learned; the node's estimate of the board's clock may add some ms at 1.57 rad/s.
TOLERANCE_RAD = 0.06


@pytest.fixture
def bench():
    domain = DOMAIN + 45
    served = Served("--board", "sim:osmc-bench", "ros2", domain=domain)
    peer = Peer(domain=domain, **simulated_time())
    publisher = peer.node.create_publisher(JointTrajectory, "joint_trajectory", 10)
    try:
        assert peer.until(lambda: {"joint_states", "r4/state"} <= peer.seen.keys()), peer.seen.keys()
        assert peer.until(lambda: publisher.get_subscription_count() > 0)
        assert peer.call("arm").success
        peer.trajectory = publisher
        yield peer
    finally:
        peer.close()
        assert served.end() == 0


def angle(message):
    return message.position[message.name.index("osmc0")]


def rate(message):
    return message.velocity[message.name.index("osmc0")]


def wanted(time_s):
    """Returns the angle (rad) and rate (rad/s) of the trajectory at `time_s`."""
    return SWING * (1.0 - math.cos(RATE * time_s)) / 2.0, SWING * RATE * math.sin(RATE * time_s) / 2.0


def sine(seconds, begin=None, start_rad=0.0):
    message = JointTrajectory(joint_names=["osmc0"])
    if begin:
        message.header.stamp = begin.to_msg()
    for number in range(1, round(seconds / 0.05) + 1):
        at_s = number * 0.05
        position, velocity = wanted(at_s)
        point = JointTrajectoryPoint(positions=[start_rad + position], velocities=[velocity])
        point.time_from_start = Duration(seconds=at_s).to_msg()
        message.points.append(point)
    return message


def test_a_sine_is_followed_and_ends_at_rest(bench):
    bench.every["joint_states"] = []
    begin = bench.node.get_clock().now() + Duration(seconds=1.0)
    bench.trajectory.publish(sine(6.0, begin))
    end = begin + Duration(seconds=7.0)
    assert bench.until(lambda: bench.node.get_clock().now() > end, 60.0)
    worst = squares = count = 0
    for message in bench.every["joint_states"]:
        time_s = (Time.from_msg(message.header.stamp) - begin).nanoseconds * 1e-9
        if 0.0 <= time_s <= 6.0:
            error = angle(message) - wanted(time_s)[0]
            worst, squares, count = max(worst, abs(error)), squares + error * error, count + 1
    print(f"sine followed: worst {worst:.4f} rad, RMS {math.sqrt(squares / count):.4f} rad, {count} samples")
    assert count > 200 and worst < TOLERANCE_RAD, (worst, count)
    last = bench.seen["joint_states"]
    assert abs(rate(last)) < 0.01 and abs(angle(last)) < 0.01
    assert bench.seen["/diagnostics"].status[1].level == b"\0"


def test_what_ends_a_trajectory(bench):
    def moving():
        return abs(rate(bench.seen["joint_states"])) > 0.8

    def resting():
        return abs(rate(bench.seen["joint_states"])) < 0.02

    def start():
        # From where the joint rests: a trajectory that begins elsewhere would be too fast at once.
        bench.trajectory.publish(sine(20.0, start_rad=angle(bench.seen["joint_states"])))
        assert bench.until(moving, 10.0)

    start()
    # An empty trajectory cancels.
    bench.trajectory.publish(JointTrajectory())
    assert bench.until(resting, 5.0)
    bench.spin(1.0)
    assert resting() and bench.state() == "armed"
    # A trajectory that is too fast is refused, and ends the one before.
    start()
    fast = sine(1.0)
    fast.points[0].positions = [30.0]
    bench.trajectory.publish(fast)
    assert bench.until(resting, 5.0)
    assert bench.until(lambda: bench.seen["/diagnostics"].status[1].level == b"\1", 5.0)
    assert "at most" in bench.seen["/diagnostics"].status[1].message
    # Disarming ends a trajectory for good.
    start()
    assert bench.call("disarm").success
    assert bench.until(resting, 5.0)
    assert bench.call("arm").success
    bench.spin(1.0)
    assert resting()
