"""`r4 serve --foxglove` seen by a client that is not ours: `websockets` from PyPI, and Foxglove's protocol from its specification.

The protocol: https://github.com/foxglove/ws-protocol, docs/spec.md. `r4` is the program that R4_PROGRAM names, built with the feature `live`.
"""

import contextlib
import datetime
import json
import os
import pathlib
import re
import signal
import struct
import subprocess
import threading
import time

import pytest
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf import json_format
from websockets.sync.client import connect

PROGRAM = os.environ["R4_PROGRAM"]
LAYOUTS = pathlib.Path(__file__).parents[2] / "docs/foxglove"
SUBPROTOCOL = "foxglove.sdk.v1"
# Operation code of a binary frame with a message: then subscription, log time in ns, payload.
MESSAGE_DATA = 1
# For processes that start and messages that come, on a machine that does other things too.
PATIENCE_S = 30.0


class Served:
    """`r4 serve BOARD --foxglove` as a process."""

    def __init__(self, board):
        self.process = subprocess.Popen(
            [PROGRAM, "serve", board, "--tcp=127.0.0.1:0", "--foxglove=127.0.0.1:0"],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self.board = "tcp:" + json.loads(self.process.stdout.readline())["tcp"]
        for line in self.process.stderr:
            if found := re.search(r"ws://127\.0\.0\.1:\d+", line):
                self.url = found[0]
                break
        threading.Thread(target=self.process.stderr.read, daemon=True).start()

    def end(self):
        self.process.send_signal(signal.SIGINT)
        return self.process.wait(timeout=PATIENCE_S)


class Viewer:
    """A client that subscribes to topics by their names."""

    def __init__(self, socket):
        self.socket = socket
        self.info = None
        self.channels = {}
        self.topics = {}
        self.messages = {}

    def subscribe(self, *topics):
        self.read_until(lambda: all(topic in self.channels for topic in topics))
        subscriptions = []
        for topic in topics:
            number = len(self.topics) + 1
            self.topics[number] = topic
            self.messages[topic] = []
            subscriptions.append({"id": number, "channelId": self.channels[topic]["id"]})
        self.socket.send(json.dumps({"op": "subscribe", "subscriptions": subscriptions}))

    def read_until(self, is_done):
        end = time.monotonic() + PATIENCE_S
        while not is_done():
            self._take(self.socket.recv(timeout=end - time.monotonic()))

    def read_for(self, seconds):
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            try:
                self._take(self.socket.recv(timeout=left))
            except TimeoutError:
                return

    def _take(self, frame):
        if isinstance(frame, str):
            said = json.loads(frame)
            if said["op"] == "serverInfo":
                self.info = said
            elif said["op"] == "advertise":
                self.channels |= {channel["topic"]: channel for channel in said["channels"]}
            return
        code, number, time_ns = struct.unpack_from("<BIQ", frame)
        if code == MESSAGE_DATA:
            self.messages[self.topics[number]].append((time_ns, json.loads(frame[13:])))


@pytest.fixture(scope="module")
def served():
    served = Served("sim:openscout")
    yield served
    assert served.end() == 0


@contextlib.contextmanager
def viewing(served):
    with connect(served.url, subprotocols=[SUBPROTOCOL]) as socket:
        yield Viewer(socket)


def drives(served, seconds):
    """Starts another program, which drives a wheel."""
    arguments = [PROGRAM, "--board", served.board, "duty", "dhb0", "40%", "--for", seconds]
    return subprocess.Popen(arguments, stdout=subprocess.DEVNULL)


def test_topics_come_with_schemas_that_their_messages_keep(served):
    with viewing(served) as viewer:
        viewer.subscribe("/state", "/dhb0")
        assert viewer.info["name"].startswith("r4 ")
        for channel in viewer.channels.values():
            assert (channel["encoding"], channel["schemaEncoding"]) == ("json", "jsonschema"), channel
        # A topic that is sent on change only comes again for viewers that connect later.
        viewer.read_until(lambda: len(viewer.messages["/state"]) >= 2 and len(viewer.messages["/dhb0"]) >= 10)
        assert viewer.messages["/state"][0][1]["state"] == "disarmed"
        for topic, messages in viewer.messages.items():
            fields = json.loads(viewer.channels[topic]["schema"])["properties"]
            for _, message in messages:
                assert message.keys() <= fields.keys(), topic
            times = [time_ns for time_ns, _ in messages]
            assert times == sorted(times), topic


def test_a_viewer_sees_what_another_program_commands(served):
    # Topics of commands are offered from the first command on.
    assert drives(served, "0.1").wait(timeout=PATIENCE_S) == 0
    with viewing(served) as viewer:
        viewer.subscribe("/state", "/dhb0", "/command", "/request")
        mover = drives(served, "1")

        def states():
            return [message["state"] for _, message in viewer.messages["/state"]]

        viewer.read_until(lambda: "armed" in states() and states()[-1] == "disarmed")
        assert mover.wait(timeout=PATIENCE_S) == 0
        assert max(message["speed_rad_s"] for _, message in viewer.messages["/dhb0"]) > 0.5
        commanded = [message["setpoint_duty"] for _, message in viewer.messages["/command"]]
        assert commanded == pytest.approx([0.4] * len(commanded)) and commanded
        requests = [message["request"] for _, message in viewer.messages["/request"]]
        assert requests.index("arm") < requests.index("disarm"), requests


def test_two_viewers_have_the_same(served):
    with viewing(served) as first, viewing(served) as second:
        for viewer in (first, second):
            viewer.subscribe("/dhb0")
        # Turn by turn: what one has while the other is read waits in its socket.
        for viewer in (first, second):
            viewer.read_for(1.0)
        both = [dict(viewer.messages["/dhb0"]) for viewer in (first, second)]
    common = both[0].keys() & both[1].keys()
    assert len(common) >= 5, [len(seen) for seen in both]
    assert all(both[0][time_ns] == both[1][time_ns] for time_ns in common)


def as_protobuf(kind, message):
    """Reads a JSON message as Foxglove's own definition of it: unknown fields and wrong types raise."""

    def times(value):
        # protobuf writes times as text in JSON, Foxglove as two numbers.
        if isinstance(value, list):
            return [times(item) for item in value]
        if not isinstance(value, dict):
            return value
        fields = {key: times(item) for key, item in value.items()}
        for key in fields.keys() & {"timestamp", "lifetime"}:
            seconds, nanoseconds = value[key]["sec"], value[key]["nsec"]
            if key == "lifetime":
                fields[key] = f"{seconds}.{nanoseconds:09d}s"
            else:
                moment = datetime.datetime.fromtimestamp(seconds, datetime.UTC)
                fields[key] = f"{moment:%Y-%m-%dT%H:%M:%S}.{nanoseconds:09d}Z"
        return fields

    return json_format.ParseDict(times(message), kind())


def test_the_view_keeps_the_definitions_of_foxglove(served):
    kinds = {"/tf": FrameTransforms, "/path": PosesInFrame, "/scene": SceneUpdate}
    with viewing(served) as viewer:
        viewer.subscribe(*kinds)
        mover = drives(served, "1")
        viewer.read_until(lambda: all(len(viewer.messages[topic]) >= 3 for topic in kinds))
        assert mover.wait(timeout=PATIENCE_S) == 0
        for topic, kind in kinds.items():
            assert viewer.channels[topic]["schemaName"] == f"foxglove.{kind.DESCRIPTOR.name}"
            for time_ns, message in viewer.messages[topic]:
                read = as_protobuf(kind, message)
                if topic == "/tf":
                    frames = [(one.parent_frame_id, one.child_frame_id) for one in read.transforms]
                    assert frames == [("odom", "base_link"), ("world", "odom")]
                    assert read.transforms[0].timestamp.ToNanoseconds() == time_ns
        # A viewer that has just connected gets all entities within a second.
        entities = {entity["id"] for _, message in viewer.messages["/scene"] for entity in message["entities"]}
        assert {"robot", "ranges", "movable"} <= entities


def paths_of(layout):
    """Message paths of all panels."""
    for panel in layout["configById"].values():
        yield from (path["value"] for path in panel.get("paths", []))
        yield from panel.get("topics", {})


@pytest.mark.parametrize("robot", ["openscout", "osmc-bench"])
def test_layouts_show_what_their_board_sends(robot):
    layout = json.loads((LAYOUTS / f"{robot}.json").read_text())

    def leaves(node):
        return [node] if isinstance(node, str) else leaves(node["first"]) + leaves(node["second"])

    assert sorted(leaves(layout["layout"])) == sorted(layout["configById"])
    served = Served(f"sim:{robot}")
    with viewing(served) as viewer:
        topics = {path.split(".")[0] for path in paths_of(layout)}
        viewer.read_until(lambda: topics <= viewer.channels.keys())
        for path in paths_of(layout):
            topic, _, field = path.partition(".")
            fields = json.loads(viewer.channels[topic]["schema"])["properties"]
            assert not field or field in fields, path
    assert served.end() == 0


def test_only_this_machine_is_served():
    refused = subprocess.run(
        [PROGRAM, "serve", "sim:openscout", "--tcp=127.0.0.1:0", "--foxglove=0.0.0.0:0"], capture_output=True, text=True
    )
    assert refused.returncode == 1, refused
    assert "ssh -L" in refused.stderr
