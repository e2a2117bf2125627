"""Writes data/cdr.txt: messages encoded as CDR by `rosbags`, whose types and serialisers are independent of ours.

    python3 -m venv /tmp/rosbags && /tmp/rosbags/bin/pip install rosbags==0.11.9
    /tmp/rosbags/bin/python make_cdr.py
"""

from importlib.metadata import version
from pathlib import Path

import numpy as np
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_JAZZY)
FILE = Path(__file__).with_name("data") / "cdr.txt"


def make(kind, *fields):
    return STORE.types[kind](*fields)


def header(frame):
    return make("std_msgs/msg/Header", make("builtin_interfaces/msg/Time", 1_700_000_000, 123_456_789), frame)


def vector(x, y, z):
    return make("geometry_msgs/msg/Vector3", x, y, z)


def planar(first):
    """Returns a 6 x 6 covariance as 36 ascending numbers that start at `first`."""
    return np.arange(first, first + 36, dtype=np.float64)


def texts(*words):
    return list(words)


turned = make("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.6, 0.8)
pose = make("geometry_msgs/msg/Pose", make("geometry_msgs/msg/Point", 1.5, -2.25, 0.0), turned)
twist = make("geometry_msgs/msg/Twist", vector(0.3, 0.0, 0.0), vector(0.0, 0.0, -0.7))
nan = float("nan")
MESSAGES = {
    "sensor_msgs/msg/JointState": make(
        "sensor_msgs/msg/JointState",
        header(""),
        # Lengths that need padding before the numbers that follow.
        texts("dhb0", "encoder10"),
        np.array([0.5, -1.0]),
        np.array([3.25, nan]),
        np.array([], dtype=np.float64),
    ),
    "sensor_msgs/msg/Imu": make(
        "sensor_msgs/msg/Imu",
        header("imu0"),
        make("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0),
        np.array([-1.0, 0, 0, 0, 0, 0, 0, 0, 0]),
        vector(0.01, -0.02, 0.03),
        np.zeros(9),
        vector(0.1, 0.2, 9.81),
        np.zeros(9),
    ),
    "sensor_msgs/msg/Range": make("sensor_msgs/msg/Range", header("range0"), 0, 0.524, 0.02, 4.0, float("inf"), 0.0),
    "sensor_msgs/msg/BatteryState": make(
        "sensor_msgs/msg/BatteryState",
        header("supply0"),
        *(12.25, nan, nan, nan, nan, nan, nan),
        *(0, 0, 0, True),
        np.array([], dtype=np.float32),
        np.array([], dtype=np.float32),
        "supply0",
        "",
    ),
    "nav_msgs/msg/Odometry": make(
        "nav_msgs/msg/Odometry",
        header("odom"),
        "base_link",
        make("geometry_msgs/msg/PoseWithCovariance", pose, planar(0.0)),
        make("geometry_msgs/msg/TwistWithCovariance", twist, planar(100.0)),
    ),
    "tf2_msgs/msg/TFMessage": make(
        "tf2_msgs/msg/TFMessage",
        [
            make(
                "geometry_msgs/msg/TransformStamped",
                header("odom"),
                "base_link",
                make("geometry_msgs/msg/Transform", vector(1.5, -2.25, 0.0), turned),
            )
        ],
    ),
    "std_msgs/msg/String": make("std_msgs/msg/String", "tripped: link lost"),
    "diagnostic_msgs/msg/DiagnosticArray": make(
        "diagnostic_msgs/msg/DiagnosticArray",
        header(""),
        [
            make(
                "diagnostic_msgs/msg/DiagnosticStatus",
                level,
                "openscout: supervisor",
                message,
                "sim:openscout",
                [make("diagnostic_msgs/msg/KeyValue", "state", "armed")] * keys,
            )
            for level, message, keys in [(0, "armed", 1), (2, "", 2)]
        ],
    ),
}


def text():
    """Returns the text of data/cdr.txt."""
    lines = [
        f"# CDR of ROS 2 messages with its encapsulation header, and their definitions, by rosbags {version('rosbags')} (Apache-2.0)",
        "# and its store of ROS 2 Jazzy's types. Made by ../make_cdr.py, which has the values too.",
    ]
    for kind, message in MESSAGES.items():
        definition, _ = STORE.generate_msgdef(kind, ros_version=2)
        lines += [f"type {kind}", f"hash {STORE.hash_rihs01(kind)}"]
        lines.append(f"cdr {bytes(STORE.serialize_cdr(message, kind)).hex()}")
        lines += [f"| {line}" for line in definition.rstrip("\n").split("\n")]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    FILE.write_text(text())
