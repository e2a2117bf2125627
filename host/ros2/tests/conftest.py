"""Fixtures: `r4 ros2` as a process for the whole test session, and stock rclpy nodes as its peers."""

import os
import re
import signal
import subprocess
import threading
import time

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Twist, TwistStamped
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import BatteryState, Imu, JointState, Range
from std_msgs.msg import Bool, String
from std_srvs.srv import Trigger

PROGRAM = os.environ["R4_PROGRAM"]
# Time limit for discovery between two processes on one machine under load.
DISCOVERY_S = 30.0
# ROS domain that other runs on this machine are unlikely to use. Domains above 101 collide with the ephemeral ports of Linux.
DOMAIN = 20 + os.getpid() % 30

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL, reliability=ReliabilityPolicy.RELIABLE)


class Served:
    """`r4 ros2` as a process, with its first line of output."""

    def __init__(self, *arguments, domain, **variables):
        environment = {**os.environ, "ROS_DOMAIN_ID": str(domain), **variables}
        self.process = subprocess.Popen(
            [PROGRAM, *arguments], env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        self.first_line = self.process.stdout.readline()
        threading.Thread(target=self.process.stdout.read, daemon=True).start()

    def end(self):
        self.process.send_signal(signal.SIGINT)
        return self.process.wait(timeout=30)


class Peer:
    """A node of rclpy with readers, publishers and clients for the topics and services of `r4 ros2`."""

    def __init__(self, namespace="", **options):
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=options.pop("domain", DOMAIN))
        self.node = rclpy.create_node("peer", context=self.context, **options)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.seen = {}
        self.arrived = {}
        self.every = {}
        for topic, kind, qos in [
            ("odom", Odometry, 10),
            ("joint_states", JointState, 10),
            ("imu/data", Imu, 10),
            ("range0", Range, 10),
            ("battery_state", BatteryState, 10),
            ("/diagnostics", DiagnosticArray, 10),
            ("r4/state", String, LATCHED),
            ("r4/cmd_vel_out", TwistStamped, 10),
        ]:
            name = topic if topic.startswith("/") else f"{namespace}/{topic}"
            self.node.create_subscription(kind, name, self._take(topic), qos)
        self.cmd_vel = self.node.create_publisher(TwistStamped, f"{namespace}/cmd_vel", 10)
        self.unstamped = self.node.create_publisher(Twist, f"{namespace}/cmd_vel_unstamped", 10)
        self.joints = self.node.create_publisher(JointState, f"{namespace}/joint_commands", 10)
        self.estop = self.node.create_publisher(Bool, f"{namespace}/estop", LATCHED)
        self.estop_volatile = self.node.create_publisher(Bool, f"{namespace}/estop", 1)
        self.services = {
            name: self.node.create_client(Trigger, f"{namespace}/r4/{name}")
            for name in ("arm", "disarm", "clear", "estop")
        }

    def _take(self, topic):
        def take(message):
            self.seen[topic] = message
            self.arrived[topic] = time.monotonic()
            if topic in self.every:
                self.every[topic].append(message)

        return take

    def until(self, holds, timeout_s=DISCOVERY_S):
        """Spins until `holds()` is true; returns False after `timeout_s`."""
        end = time.monotonic() + timeout_s
        while not holds():
            if time.monotonic() > end:
                return False
            self.executor.spin_once(timeout_sec=0.02)
        return True

    def spin(self, seconds):
        self.until(lambda: False, seconds)

    def call(self, name):
        client = self.services[name]
        assert client.wait_for_service(timeout_sec=DISCOVERY_S), f"no service {name}"
        future = client.call_async(Trigger.Request())
        assert self.until(future.done), f"no answer of {name}"
        return future.result()

    def state(self):
        message = self.seen.get("r4/state")
        return message.data if message else None

    def twist(self, forward_m_s, yaw_rad_s, stamp=None):
        message = TwistStamped()
        message.header.stamp = stamp or self.node.get_clock().now().to_msg()
        message.header.frame_id = "base_link"
        message.twist.linear.x = forward_m_s
        message.twist.angular.z = yaw_rad_s
        return message

    def drive(self, forward_m_s, yaw_rad_s, seconds, every_s=0.02):
        """Publishes a velocity every `every_s` for `seconds` of simulated time."""
        begin = self.node.get_clock().now()
        while (self.node.get_clock().now() - begin).nanoseconds * 1e-9 < seconds:
            self.cmd_vel.publish(self.twist(forward_m_s, yaw_rad_s))
            self.spin(every_s)

    def close(self):
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)


def simulated_time():
    """Returns the options of a node that uses the time of /clock."""
    return {"parameter_overrides": [rclpy.parameter.Parameter("use_sim_time", value=True)]}


@pytest.fixture(scope="session")
def served():
    served = Served("--board", "sim:openscout", "ros2", domain=DOMAIN)
    assert re.match(rf"node /r4 for sim:openscout \(simulated\); ROS domain {DOMAIN}, ", served.first_line), (
        served.first_line
    )
    yield served
    assert served.end() == 0


@pytest.fixture
def peer(served):
    peer = Peer(**simulated_time())
    assert peer.until(lambda: {"odom", "r4/state"} <= peer.seen.keys()), f"nothing seen: {peer.seen.keys()}"
    yield peer
    peer.estop.publish(Bool(data=False))
    if peer.state().startswith("tripped"):
        peer.call("clear")
    peer.call("disarm")
    peer.close()


@pytest.fixture
def armed(peer):
    if peer.state().startswith("tripped"):
        assert peer.call("clear").success
    answer = peer.call("arm")
    assert answer.success, answer.message
    assert peer.until(lambda: peer.state() == "armed", 5.0), peer.state()
    return peer
