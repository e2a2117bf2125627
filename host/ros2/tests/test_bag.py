"""A bag of rosbag2 from a log, read by `rosbags`, an independent implementation, and compared with the log's table and rclpy's messages."""

import csv
import json
import subprocess
from types import SimpleNamespace

import make_cdr
import numpy as np
import pytest
from conftest import DOMAIN, PROGRAM, Peer, Served, simulated_time
from rosbags.interfaces import QosDurability
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

TYPES = {
    "/odom": "nav_msgs/msg/Odometry",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/joint_states": "sensor_msgs/msg/JointState",
    "/imu/data": "sensor_msgs/msg/Imu",
    "/battery_state": "sensor_msgs/msg/BatteryState",
    "/r4/state": "std_msgs/msg/String",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
}
WHEELS = ("dhb0", "dhb1", "dhb2", "dhb3")


def ns(stamp):
    return stamp.sec * 1_000_000_000 + stamp.nanosec


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """Records a session of the node that rclpy drives, and exports its log as a bag and as a table."""
    folder = tmp_path_factory.mktemp("bag")
    log, bag, table = folder / "run.mcap", folder / "run", folder / "run.csv"
    domain = DOMAIN + 47
    served = Served("--board", "sim:openscout", "--record", str(log), "ros2", domain=domain)
    peer = Peer(domain=domain, **simulated_time())
    try:
        assert peer.until(lambda: {"odom", "r4/state"} <= peer.seen.keys()), peer.seen.keys()
        peer.every["odom"], peer.every["imu/data"] = [], []
        assert peer.call("arm").success
        peer.drive(0.3, 0.5, 2.0)
        assert peer.call("estop").success
        peer.spin(0.5)
    finally:
        peer.close()
        assert served.end() == 0
    command = [PROGRAM, "log", "export", log, "--ros2", bag, "--csv", table, "--json"]
    told = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    info = json.loads(subprocess.run([PROGRAM, "log", "info", log, "--json"], check=True, capture_output=True).stdout)
    messages, connections, definitions = {}, {}, get_typestore(Stores.EMPTY)
    with Reader(bag) as reader:
        metadata = reader.storage.metadata
        for connection in reader.connections:
            connections[connection.topic] = connection
            definitions.register(get_types_from_msg(connection.msgdef.data, connection.msgtype))
        last_ns = 0
        for connection, time_ns, raw in reader.messages():
            assert time_ns >= last_ns, "in the order of time"
            last_ns = time_ns
            message = definitions.deserialize_cdr(raw, connection.msgtype)
            messages.setdefault(connection.topic, []).append((time_ns, message))
    with table.open() as file:
        rows = list(csv.DictReader(file))
    return SimpleNamespace(
        bag=bag, told=told, info=info, peer=peer, rows=rows,
        metadata=metadata, connections=connections, messages=messages, definitions=definitions,
    )


def of_table(recorded, column):
    """Returns the times, ns of the board's clock, and the values of a column."""
    rows = [row for row in recorded.rows if row[column] != ""]
    return [round(float(row["time_s"]) * 1e9) for row in rows], [float(row[column]) for row in rows]


def begin_ns(recorded):
    """Returns time 0 of the board's clock in the bag's time, ns."""
    times, _ = of_table(recorded, "dhb0.position_rad")
    return recorded.messages["/joint_states"][0][0] - times[0]


def test_the_bytes_that_rust_is_tested_with_are_those_of_rosbags():
    assert make_cdr.FILE.read_text() == make_cdr.text()


def test_topics_types_and_counts(recorded):
    types = {topic: connection.msgtype for topic, connection in recorded.connections.items()}
    assert TYPES.items() <= types.items(), types
    assert all(types[topic] == "sensor_msgs/msg/Range" for topic in types if topic.startswith("/range"))
    counts = {topic: len(of_topic) for topic, of_topic in recorded.messages.items()}
    assert counts == {topic: connection.msgcount for topic, connection in recorded.connections.items()}
    assert counts == {each["topic"]: each["messages"] for each in recorded.told["ros2"]["topics"]}
    assert sum(counts.values()) == recorded.metadata.message_count
    assert min(counts["/odom"], counts["/joint_states"], counts["/imu/data"]) > 50, counts
    assert counts["/tf"] == counts["/odom"]
    print(f"bag: {len(counts)} topics, {sum(counts.values())} messages")


def test_definitions_are_those_of_ros(recorded):
    """Compares the hashes of REP-2016, which cover names, types and order of all fields, also nested ones."""
    jazzy = get_typestore(Stores.ROS2_JAZZY)
    for connection in recorded.connections.values():
        of_bag = recorded.definitions.hash_rihs01(connection.msgtype)
        assert of_bag == jazzy.hash_rihs01(connection.msgtype), connection.msgtype


def test_the_state_is_latched(recorded):
    for topic, connection in recorded.connections.items():
        (qos,) = connection.ext.offered_qos_profiles
        expected = QosDurability.TRANSIENT_LOCAL if topic == "/r4/state" else QosDurability.VOLATILE
        assert qos.durability == expected, (topic, qos)


def test_stamps_rise_and_are_of_the_recordings_date(recorded):
    for topic, of_topic in recorded.messages.items():
        if topic == "/r4/state":
            continue
        for time_ns, message in of_topic:
            header = message.transforms[0].header if topic == "/tf" else message.header
            # Sensors measure before their sample is sent; the sample of a range sensor that fails becomes old.
            most_ns = 10_000_000_000 if topic.startswith("/range") else 200_000_000
            assert 0 <= time_ns - ns(header.stamp) < most_ns, topic
        stamps = [ns((m.transforms[0] if topic == "/tf" else m).header.stamp) for _, m in of_topic]
        assert stamps == sorted(stamps), topic
    recorded_at = np.datetime64(recorded.info["recorded_at"].removesuffix("Z"), "ns").astype(int)
    # The date has whole seconds.
    assert 0 <= begin_ns(recorded) - recorded_at < 1_000_000_000
    assert recorded.metadata.custom["robot"] == "openscout"


def test_joints_are_those_of_the_table(recorded):
    joints = recorded.messages["/joint_states"]
    for wheel in WHEELS:
        times, positions = of_table(recorded, f"{wheel}.position_rad")
        _, speeds = of_table(recorded, f"{wheel}.speed_rad_s")
        found = [(t, m.position[m.name.index(wheel)], m.velocity[m.name.index(wheel)]) for t, m in joints]
        assert [t for t, _, _ in found] == [begin_ns(recorded) + t for t in times]
        assert [p for _, p, _ in found] == positions
        # Speeds have single precision on the wire.
        assert [np.float32(v) for _, _, v in found] == [np.float32(v) for v in speeds]
    assert max(abs(position) for position in positions) > 1.0, "it has driven"


def test_sensors_are_those_of_the_table(recorded):
    _, volts = of_table(recorded, "supply0.voltage_v")
    found = [message.voltage for _, message in recorded.messages["/battery_state"]]
    assert [np.float32(v) for v in found] == [np.float32(v) for v in volts]
    good = [row for row in recorded.rows if row["imu0.quality"] == "good"]
    imu = [message for _, message in recorded.messages["/imu/data"]]
    assert len(imu) == len(good)
    for column, value in [
        ("imu0.acceleration_z_m_s2", lambda m: m.linear_acceleration.z),
        ("imu0.rate_z_rad_s", lambda m: m.angular_velocity.z),
    ]:
        assert [np.float32(value(m)) for m in imu] == [np.float32(row[column]) for row in good], column
    # No message while a sensor fails; infinite when nothing reflects.
    told = [row for row in recorded.rows if row["range0.quality"] in ("good", "out-of-range")]
    ranges = [message.range for _, message in recorded.messages.get("/range0", [])]
    expected = [row["range0.distance_m"] if row["range0.quality"] == "good" else "inf" for row in told]
    assert [np.float32(r) for r in ranges] == [np.float32(e) for e in expected]


def test_states_are_those_of_the_table(recorded):
    states = [message.data for _, message in recorded.messages["/r4/state"]]
    assert states[0] == "disarmed" and states[1] == "armed" and states[-1].startswith("tripped: host stop"), states
    assert [state.split(":")[0] for state in states] == [row["state"] for row in recorded.rows if row["state"]]
    levels = [message.status[0].level for _, message in recorded.messages["/diagnostics"]]
    assert levels[0] == 0 and levels[-1] == 2


def test_odometry_is_what_the_node_published(recorded):
    def place(odometry):
        pose, twist = odometry.pose.pose, odometry.twist.twist
        covariance = tuple(odometry.pose.covariance) + tuple(odometry.twist.covariance)
        return (pose.position.x, pose.position.y, pose.orientation.z, pose.orientation.w, twist.linear.x, *covariance)

    of_bag = {place(message) for _, message in recorded.messages["/odom"]}
    seen = [place(message) for message in recorded.peer.every["odom"]]
    assert len(seen) > 50 and set(seen) <= of_bag, (len(seen), len(set(seen) - of_bag))
    for (_, odometry), (_, transform) in zip(recorded.messages["/odom"], recorded.messages["/tf"], strict=True):
        (found,) = transform.transforms
        assert found.transform.translation.x == odometry.pose.pose.position.x
        assert found.transform.rotation.z == odometry.pose.pose.orientation.z
