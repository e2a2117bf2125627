"""Files for ros2_control compared with the node and the robot's file: names, topics, geometry. ros2_control itself is not run."""

import math
import tomllib
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
from conftest import DOMAIN, Peer, Served, simulated_time
from ruamel.yaml import YAML
from sensor_msgs.msg import JointState

HERE = Path(__file__).parent
FILES = HERE.parent / "ros2_control"
ROBOT = tomllib.loads((HERE.parents[2] / "boards" / "openscout.toml").read_text())


@pytest.fixture(scope="module")
def control():
    return ET.parse(FILES / "openscout.urdf").getroot()


@pytest.fixture(scope="module")
def controllers():
    return YAML(typ="safe").load((FILES / "controllers.yaml").read_text())


def parameter(control, name):
    (value,) = [p.text for p in control.findall("ros2_control/hardware/param") if p.get("name") == name]
    return value


def test_geometry_and_limits_are_the_robots(control, controllers):
    drive = ROBOT["drive"]["skid-steer"]
    settings = controllers["diff_drive_controller"]["ros__parameters"]
    assert settings["left_wheel_names"] == drive["left"] and settings["right_wheel_names"] == drive["right"]
    assert settings["wheel_radius"] == drive["wheel_radius_m"] and settings["wheel_separation"] == drive["track_m"]
    assert settings["linear"]["x"]["max_velocity"] == drive["speed_max_m_s"] == -settings["linear"]["x"]["min_velocity"]
    assert settings["angular"]["z"]["max_velocity"] == drive["turn_rate_max_rad_s"]
    assert settings["cmd_vel_timeout"] == ROBOT["link_timeout_ms"] * 1e-3
    fastest = {motor["channel"]: motor["speed_max_rad_s"] for motor in ROBOT["dhb"]}
    for joint in control.findall("joint"):
        assert float(joint.find("limit").get("velocity")) == fastest[joint.get("name")]
    commanded = [joint.get("name") for joint in control.findall("ros2_control/joint")]
    assert sorted(commanded) == sorted(drive["left"] + drive["right"])
    assert sorted(joint.get("name") for joint in control.findall("joint")) == sorted(commanded)
    links = {link.get("name") for link in control.findall("link")}
    assert {joint.find(end).get("link") for joint in control.findall("joint") for end in ("parent", "child")} == links
    # Commands are leased, so the interface must publish each of them, also an unchanged one.
    assert float(parameter(control, "trigger_joint_command_threshold")) < 0
    rate = controllers["controller_manager"]["ros__parameters"]["update_rate"]
    assert 1.0 / rate < ROBOT["link_timeout_ms"] * 1e-3 / 2


def test_the_interface_finds_its_topics_and_turns_the_wheels(control):
    domain = DOMAIN + 44
    served = Served("--board", "sim:openscout", "ros2", "--namespace", "board", "--no-tf", domain=domain)
    peer = Peer(namespace="/board", domain=domain, **simulated_time())
    try:
        assert peer.until(lambda: {"joint_states", "r4/state"} <= peer.seen.keys()), peer.seen.keys()
        topics = dict(peer.node.get_topic_names_and_types())
        for name in ("joint_commands_topic", "joint_states_topic"):
            assert topics[parameter(control, name)] == ["sensor_msgs/msg/JointState"]
        joints = [joint.get("name") for joint in control.findall("ros2_control/joint")]
        assert set(joints) <= set(peer.seen["joint_states"].name)
        interfaces = {i.get("name") for i in control.findall("ros2_control/joint/command_interface")}
        assert interfaces == {"velocity"}
        assert peer.call("arm").success
        commands = peer.node.create_publisher(JointState, parameter(control, "joint_commands_topic"), 1)

        def command(velocity):
            message = JointState(name=joints, velocity=[velocity] * len(joints))
            message.header.stamp = peer.node.get_clock().now().to_msg()
            commands.publish(message)

        def turn():
            command(3.0)
            states = peer.seen["joint_states"]
            return all(states.velocity[states.name.index(joint)] > 2.0 for joint in joints)

        # Before a controller is active its commands are NaN: no set point, and no error.
        for _ in range(10):
            command(math.nan)
            peer.spin(0.02)
        assert peer.seen["/diagnostics"].status[1].level == b"\0", peer.seen["/diagnostics"].status[1].message
        assert peer.until(turn, 10.0), peer.seen["joint_states"].velocity
    finally:
        peer.close()
        assert served.end() == 0
