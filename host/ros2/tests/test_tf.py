"""`/tf` read by Cyclone DDS, a second implementation, since rclpy's wheels lack tf2_msgs. The types follow its interface files."""

import os
import subprocess
import sys
from pathlib import Path

from conftest import DISCOVERY_S, DOMAIN


def test_the_transform_is_where_odometry_says(armed):
    """The reader is a process of its own: two implementations of DDS in one process would share symbols."""
    armed.drive(0.2, 0.5, 1.0)
    script = Path(__file__).with_name("tf_reader.py")
    environment = {**os.environ, "ROS_DOMAIN_ID": str(DOMAIN)}
    command = [sys.executable, script, str(DISCOVERY_S)]
    reader = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)
    armed.every["odom"] = []
    assert armed.until(lambda: reader.poll() is not None, 2 * DISCOVERY_S)
    assert reader.returncode == 0, reader.stdout.read()
    parent, child, sec, nanosec, x, y, z, w = reader.stdout.read().split()
    assert (parent, child) == ("odom", "base_link")
    same = [o for o in armed.every["odom"] if (o.header.stamp.sec, o.header.stamp.nanosec) == (int(sec), int(nanosec))]
    assert same, "no odometry of that moment"
    pose = same[0].pose.pose
    assert (pose.position.x, pose.position.y) == (float(x), float(y))
    assert (pose.orientation.z, pose.orientation.w) == (float(z), float(w))
    assert pose.position.x != 0.0 and pose.orientation.z != 0.0
