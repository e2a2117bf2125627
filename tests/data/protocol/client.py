#!/usr/bin/env python3
"""A client of R4 boards, written from docs/protocol.md and protocol/schema.json alone. Python 3.10, standard library.

  python3 client.py SCHEMA_JSON vectors   checks the codec against every golden frame of the schema
  python3 client.py SCHEMA_JSON LINK      moves osmc0 by +0.3 rad, waits until it rests there, disarms, says goodbye

LINK is HOST:PORT, serial:PATH or slcan:PATH[#NODE]. What came of it is one JSON object on stdout. Exit code 0 when it
was done, 1 when the board refused something (printed with its fields), 2 when anything else went wrong.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import math
import os
import select
import signal
import socket
import struct
import sys
import termios
import time
import tty
from collections import deque
from collections.abc import Callable
from typing import Any

Value = Any  # What a message holds, as in the vectors of the schema: dict, list, str, int, float, bool or None.

MOTOR, LINK_LOST = {"kind": "Osmc", "index": 0}, 1 << 2  # What is moved; the bit of that cause.
RUN_S, GOODBYE_S = 10.0, 1.0  # No run takes longer; so much of it is kept for making the board safe.
HELLO_WAITS_S = (0.1, 0.2, 0.4, 0.5, 0.5)  # When no answer comes, Hello is said again after each.
ANSWER_WAITS_S = (0.5, 0.5, 0.5)  # So are other requests of this client: none of them does harm when it comes twice.
STEP_RAD, TTL_MS, PERIOD_MS = 0.3, 100, 20  # Of the move; of its set point on the way; of telemetry.


class Refused(Exception):
    """The board refused a request: its name, and the refusal with its fields as in the schema."""


def now_us() -> int:
    """This host's clock, µs; steady."""
    return time.monotonic_ns() // 1000


def variant(value: Value) -> str:
    """The name of an enum's variant, with fields or without."""
    return value if isinstance(value, str) else next(iter(value))


def within(value: int, most: int) -> int:
    """The value, if it is 0 to `most`."""
    if not 0 <= value <= most:
        raise ValueError(f"{value} where 0 to {most} may be")
    return value


def take(data: io.BytesIO, count: int) -> bytes:
    """The next bytes of a message or frame."""
    piece = data.read(count)
    within(count - len(piece), 0)  # None is missing.
    return piece


def read_varint(data: io.BytesIO, bits: int) -> int:
    """An unsigned number of at most `bits` bits: 7 in each byte, the lowest first."""
    value = 0
    for shift in range(0, bits, 7):
        byte = take(data, 1)[0]
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return within(value, (1 << bits) - 1)
    raise ValueError("a varint is too long")


def varint(value: int, bits: int) -> bytes:
    """The bytes of such a number."""
    data, value = bytearray(), within(value, (1 << bits) - 1)
    while value > 0x7F:
        data.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes(data) + bytes([value])


def checksum(told: dict[str, Any], data: bytes) -> bytes:
    """A reflected CRC, as the schema's `framing` tells it, in the order in which it is sent."""
    polynomial = int(f"{int(told['polynomial'], 16):0{8 * told['bytes']}b}"[::-1], 2)
    total = int(told["initial"], 16)
    for byte in data:
        total ^= byte
        for _ in range(8):
            total = total >> 1 ^ (polynomial if total & 1 else 0)
    return (total ^ int(told["final_xor"], 16)).to_bytes(told["bytes"], "little")


def stuff(data: bytes) -> bytes:
    """COBS of at most 254 bytes, without the delimiter."""
    return b"".join(bytes([len(piece) + 1]) + piece for piece in data.split(b"\0"))


def unstuff(frame: bytes) -> bytes:
    """What COBS was made of."""
    stuffed, data = io.BytesIO(frame), b""
    while code := stuffed.read(1):
        data += take(stuffed, within(code[0] - 1, 254)) + (b"" if code == b"\xff" else b"\0")
    return data.removesuffix(b"\0")  # Behind the last piece is none.


class Codec:
    """Frames of messages and messages out of frames, as the schema tells; a direction is `to_device` or `to_host`."""

    def __init__(self, schema: dict[str, Any]) -> None:
        self.schema, self.framing, self.types = schema, schema["framing"], schema["types"]
        enums = ((kind, each) for kind, told in self.types.items() for each in told.get("enum", ()))
        self.variants = {(kind, each[key]): each for kind, each in enums for key in ("number", "name")}

    def frame(self, direction: str, value: Value) -> bytes:
        """A message's frame, delimiter included."""
        message = self.write(self.schema["messages"][direction], value)
        within(len(message), self.framing["max_message"])
        return stuff(message + checksum(self.framing["checksums"][self._kind(direction, value)], message)) + b"\0"

    def message(self, direction: str, frame: bytes) -> Value:
        """The message in a frame without its delimiter; ValueError when there is none."""
        within(len(frame), self.framing["max_frame"] - 1)
        data = unstuff(frame)
        for kind, told in self.framing["checksums"].items():
            message = io.BytesIO(data[: -told["bytes"]])
            if checksum(told, message.getvalue()) == data[-told["bytes"] :]:
                value = self.read(self.schema["messages"][direction], message)
                if not message.read() and self._kind(direction, value) == kind:
                    return value
        raise ValueError("a wrong checksum, or more than a message")

    def _kind(self, direction: str, value: Value) -> str:
        """Which checksum frames of this message have."""
        ((name, told),) = value.items()
        name = f"Request::{variant(told['request'])}" if name == "Request" else f"ToDevice::{name}"
        return "short" if direction == "to_host" or name in self.framing["short_of"] else "long"

    def read(self, kind: Any, data: io.BytesIO) -> Value:
        match kind:
            case "bool":
                return within(take(data, 1)[0], 1) == 1
            case "u8" | "i8":
                return int.from_bytes(take(data, 1), "little", signed=kind == "i8")
            case "f32":
                number = struct.unpack("<f", take(data, 4))[0]
                return number if math.isfinite(number) else str(number).replace("nan", "NaN")
            case "u16" | "u32" | "u64" | "i16" | "i32" | "i64":
                number = read_varint(data, int(kind[1:]))
                return number >> 1 ^ -(number & 1) if kind[0] == "i" else number
            case {"string": {"max": most}}:
                return take(data, within(read_varint(data, 32), most)).decode("utf-8")
            case {"list": {"of": of, "max": most}}:
                return [self.read(of, data) for _ in range(within(read_varint(data, 32), most))]
            case {"array": {"of": of, "length": length}}:
                return [self.read(of, data) for _ in range(length)]
            case {"option": of}:
                return self.read(of, data) if self.read("bool", data) else None
            case {"result": {"ok": ok, "err": err}}:
                return {"Err": self.read(err, data)} if self.read("bool", data) else {"Ok": self.read(ok, data)}
        if "struct" in self.types[kind]:
            return self._read_fields(self.types[kind]["struct"], data)
        told = self.variants[kind, read_varint(data, 32)]
        return {told["name"]: self._read_fields(told["fields"], data)} if "fields" in told else told["name"]

    def write(self, kind: Any, value: Value) -> bytes:
        match kind:
            case "bool" | "u8" | "i8":
                return int(value).to_bytes(1, "little", signed=kind == "i8")
            case "f32":
                return struct.pack("<f", float(value))
            case "u16" | "u32" | "u64" | "i16" | "i32" | "i64":
                bits = int(kind[1:])
                return varint(value << 1 ^ value >> bits - 1 if kind[0] == "i" else value, bits)
            case {"string": {"max": most}}:
                text = value.encode("utf-8")
                return varint(within(len(text), most), 32) + text
            case {"list": {"of": of, "max": most}}:
                return varint(within(len(value), most), 32) + b"".join(self.write(of, element) for element in value)
            case {"array": {"of": of, "length": length}}:
                return b"".join(self.write(of, element) for element, _ in zip(value, range(length), strict=True))
            case {"option": of}:
                return b"\0" if value is None else b"\1" + self.write(of, value)
            case {"result": of}:
                ((name, content),) = value.items()
                return bytes([("Ok", "Err").index(name)]) + self.write(of[name.lower()], content)
        if "struct" in self.types[kind]:
            return self._write_fields(self.types[kind]["struct"], value)
        told = self.variants[kind, variant(value)]
        content = None if isinstance(value, str) else value[told["name"]]
        return varint(told["number"], 32) + self._write_fields(told.get("fields", []), content)

    def _read_fields(self, fields: list[dict[str, Any]], data: io.BytesIO) -> Value:
        if [field["name"] for field in fields] == [None]:
            return self.read(fields[0]["type"], data)
        return {field["name"]: self.read(field["type"], data) for field in fields}

    def _write_fields(self, fields: list[dict[str, Any]], value: Value) -> bytes:
        return b"".join(self.write(f["type"], value if f["name"] is None else value[f["name"]]) for f in fields)


class Link:
    """Bytes to a board and back, over TCP, a serial port, or CAN at 1 Mbit/s by an adapter that speaks slcan."""

    def __init__(self, where: str) -> None:
        host, _, place = where.rpartition(":")
        path, _, node = place.partition("#")
        self.can: tuple[int, int] | None = None  # Identifiers of frames to the board, and to the host.
        self.line = b""
        if host in ("serial", "slcan"):
            self.fd = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
            tty.setraw(self.fd)
            modes = termios.tcgetattr(self.fd)
            modes[2] = modes[2] & ~(termios.CRTSCTS | termios.CSTOPB) | termios.CLOCAL
            modes[4] = modes[5] = termios.B1000000
            termios.tcsetattr(self.fd, termios.TCSAFLUSH, modes)  # Drops what the board told the client before.
        else:
            connection = socket.create_connection((host, int(place)), timeout=2.0)  # And does not block later either.
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self.fd = connection.detach()
        if host == "slcan":
            self.write(b"\rC\rS8\rO\r")  # End half a command, close, 1 Mbit/s, open.
            self.can = (0x200 + within(int(node or 0), 127), 0x280 + int(node or 0))

    def write(self, data: bytes) -> None:
        if self.can:
            parts = (data[at : at + 8] for at in range(0, len(data), 8))
            data = b"".join(b"t%03X%d%s\r" % (self.can[0], len(part), part.hex().upper().encode()) for part in parts)
        while data:
            if not select.select([], [self.fd], [], 0.5)[1]:
                raise TimeoutError("the link takes no more bytes")
            data = data[os.write(self.fd, data) :]

    def read(self, wait_s: float) -> bytes:
        """What has come, after at most `wait_s` seconds; empty when nothing has."""
        if not select.select([self.fd], [], [], max(0.0, wait_s))[0]:
            return b""
        if not (data := os.read(self.fd, 65536)):
            raise ConnectionError("the other side closed the link")
        if not self.can:
            return data
        *lines, self.line = (self.line + data).replace(b"\a", b"\r").split(b"\r")  # The adapter's no and yes.
        ours = (line[4:].decode("ascii", "replace") for line in lines if line.startswith(b"t%03X" % self.can[1]))
        try:
            return b"".join(bytes.fromhex(line[1 : 1 + 2 * int(line[:1])]) for line in ours)
        except ValueError:
            return b""  # Damaged by the adapter's port: the checksum of the frame will tell.


class Session:
    """A conversation with a board; whatever waits here keeps heartbeats going."""

    def __init__(self, codec: Codec, where: str) -> None:
        self.until_s = time.monotonic() + RUN_S - GOODBYE_S  # When all waiting ends.
        self.codec, self.link = codec, Link(where)
        self.seq = now_us() % (1 << 16)  # Unlike that of an answer to the client before this one.
        self.asked: dict[int, Value] = {}  # By seq, the result of what was asked; None until it comes.
        self.info: dict[str, Any] = {}  # The board's DeviceInfo, as soon as there is a session.
        self.round_trips: deque[tuple[int, int]] = deque(maxlen=16)  # Length and clock's offset of the latest, µs.
        self.state, self.causes, self.partial = "", 0, b""
        self.sample: Value = None  # The motor's latest.
        self.refused_versions: list[int] = []
        self.heartbeats = self.telemetry = self.damaged = self.redated = 0
        self.beat_at_us = self.answer_at_us = self.echo_us = 0
        self.link.write(b"\0")  # Ends half a frame of whoever used the link before.

    def hello(self, version: int) -> int:
        """Opens a session in `version`, or in the one that the board offers instead; gives the version."""
        own = {"version": self.codec.schema["version"], "schema": int(self.codec.schema["schema_hash"], 16)}
        hello = own if version == own["version"] else {"version": version, "schema": 0}
        try:
            self.info, self.answer_at_us = self.request({"Hello": hello}, HELLO_WAITS_S)["Hello"], now_us()
        except Refused as refused:
            if hello is own or refused.args[1] != {"ProtocolMismatch": own}:
                raise
            self.refused_versions.append(version)
            return self.hello(own["version"])
        self.beat()
        return version

    def request(self, request: Value, waits_s: tuple[float, ...] = ANSWER_WAITS_S) -> Value:
        """The board's reply to a request, which is sent once for each wait until it is answered; raises Refused."""
        name, self.asked = variant(request), {}
        self.info = {} if name == "Bye" else self.info  # After it no heartbeat is answered.
        for wait_s in waits_s:
            self.seq = (self.seq + 1) % (1 << 16)  # Each Hello opens a session, so that answers to others mean nothing.
            self.asked = {self.seq: None} if name == "Hello" else self.asked | {self.seq: None}
            self.link.write(self.codec.frame("to_device", {"Request": {"seq": self.seq, "request": request}}))
            self._wait(lambda: any(self.asked.values()), wait_s)
            for result in filter(None, self.asked.values()):
                if "Err" in result:
                    raise Refused(name, result["Err"])
                return result["Ok"]
        raise TimeoutError(f"no answer to {name}")

    def set(self, setpoint: Value) -> None:
        """Commands the motor. When the board finds the date wrong, its clock is learnt again, and the date renewed."""
        for last in (False, False, True):
            self.beat()
            sent_us = now_us() + min(self.round_trips)[1]
            fields = {"channel": MOTOR, "setpoint": setpoint, "sent_us": sent_us, "ttl_ms": TTL_MS}
            try:
                self.request({"Set": fields})
                return
            except Refused as refused:
                if last or not {"Expired", "ClockAhead"} & set(refused.args[1]):
                    raise
                self.round_trips.clear()
                self.redated += 1

    def beat(self) -> None:
        """Sends a heartbeat and waits for its answer: state, causes and clock are fresh then."""
        self.beat_at_us, now = 0, now_us()
        self.wait_for(lambda: self.echo_us >= now, "answer to a heartbeat")

    def wait_for(self, done: Callable[[], bool], what: str) -> None:
        if not self._wait(done, RUN_S):
            raise TimeoutError(f"in time came no {what}")

    def fail_when_tripped(self) -> None:
        if self.state == "Tripped":
            told = [f"{c['name']}: {c['advice']}" for c in self.codec.schema["causes"] if self.causes >> c["bit"] & 1]
            raise RuntimeError(f"tripped by {self.causes:#x}: {'; '.join(told)}")

    def _wait(self, done: Callable[[], bool], most_s: float) -> bool:
        """Handles what comes until `done`, and sends heartbeats when they are due; gives whether it was in time."""
        until_s = min(time.monotonic() + most_s, self.until_s)
        while not done():
            if (left_s := until_s - time.monotonic()) <= 0:
                return False
            if self.info and (now := now_us()) >= self.beat_at_us:
                self.beat_at_us = now + self.info["link_timeout_ms"] * 1000 // 4
                heartbeat = {"session": self.info["session"], "host_us": now}
                self.link.write(self.codec.frame("to_device", {"Heartbeat": heartbeat}))
            data = self.link.read(min(left_s, (self.beat_at_us - now_us()) / 1e6) if self.info else left_s)
            *frames, self.partial = (self.partial + data).split(b"\0")
            self.partial = self.partial[: self.codec.framing["max_frame"]]  # So long that it is dropped when it ends.
            for frame in filter(None, frames):
                try:
                    self._handle(self.codec.message("to_host", frame))
                except (ValueError, LookupError):
                    self.damaged += 1
            if self.info and not data and now_us() - self.answer_at_us > self.info["link_timeout_ms"] * 1000:
                raise ConnectionError("the link is lost: heartbeats are not answered")
        return True

    def _handle(self, message: Value) -> None:
        ((name, told),) = message.items()
        if name == "Response" and told["seq"] in self.asked:
            self.asked[told["seq"]] = told["result"]
        elif name == "Heartbeat":
            self.heartbeats, self.state, self.causes = self.heartbeats + 1, told["state"], told["causes"]
            self.echo_us, self.answer_at_us = sent_us, received_us = told["host_us"], now_us()
            length_us, offset_us = received_us - sent_us, told["device_us"] - (sent_us + received_us) // 2
            if any(abs(offset_us - other) > (length_us + length) / 2 + 1000 for length, other in self.round_trips):
                self.round_trips.clear()  # They contradict it: a simulated board's clock stood still meanwhile.
            self.round_trips.append((length_us, offset_us))
        elif name == "Telemetry":
            self.telemetry, self.state, self.causes = self.telemetry + 1, told["state"], told["causes"]
            motors = (sample["Motor"] for sample in told["samples"] if "Motor" in sample)
            self.sample = next((motor for motor in motors if motor["channel"] == MOTOR), self.sample)


def move(session: Session, first_version: int) -> dict[str, Any]:
    """Moves the motor by STEP_RAD and disarms; gives what came of it."""
    version = session.hello(first_version)
    info = session.info
    channels = [session.request({"Describe": {"index": i}})["Channel"] for i in range(info["channels"])]
    motor = next((channel for channel in channels if channel["id"] == MOTOR), None)
    if motor is None:
        raise ValueError("the board has no motor osmc0")
    if session.state == "Tripped" and session.causes == LINK_LOST:
        session.request("Clear")  # The host before went without a word. Other causes are for somebody to look at.
        session.beat()
    session.fail_when_tripped()
    session.request({"Subscribe": {"channel": MOTOR, "period_ms": PERIOD_MS}})
    session.wait_for(lambda: session.sample is not None, "telemetry")
    from_rad = session.sample["position"] * motor["resolution"]
    target_rad = struct.unpack("<f", struct.pack("<f", from_rad + STEP_RAD))[0]  # As the board will show it.
    session.request("Arm")
    session.set(setpoint := {"mode": "Position", "value": target_rad})

    def settled() -> bool:
        session.fail_when_tripped()
        return session.sample["settled"] and session.sample["setpoint"] == setpoint

    session.wait_for(settled, "rest at the set point")
    to_rad = session.sample["position"] * motor["resolution"]
    session.request("Disarm")
    session.beat()
    told = {"robot": info["robot"], "state": session.state, "channels": len(channels), "from_rad": from_rad}
    told |= {"target_rad": target_rad, "to_rad": to_rad, "protocol_version": version}
    session.request("Bye")
    counts = ("telemetry", "heartbeats", "damaged", "redated", "refused_versions")
    return told | {name: getattr(session, name) for name in counts}


def check_vectors(codec: Codec) -> dict[str, Any]:
    """Reads and writes every golden frame."""
    for direction, vectors in codec.schema["vectors"].items():
        for frame, value in ((bytes.fromhex(vector["frame"]), vector["value"]) for vector in vectors):
            if codec.message(direction, frame[:-1]) != value or codec.frame(direction, value) != frame:
                raise ValueError(f"{frame.hex()} is read or written otherwise than as {value}")
    return {"vectors": sum(map(len, codec.schema["vectors"].values()))}


def run(codec: Codec, where: str, first_version: int | None) -> dict[str, Any]:
    """Opens the link and moves the motor; leaves the board disarmed whatever happens."""
    session = Session(codec, where)
    try:
        return move(session, codec.schema["version"] if first_version is None else first_version)
    except BaseException:
        session.until_s = time.monotonic() + GOODBYE_S
        for name in ("Disarm", "Bye") if session.info else ():  # Without a session it may be another host's board.
            with contextlib.suppress(OSError, Refused):
                session.request(name, (GOODBYE_S / 4, GOODBYE_S / 4))
        raise
    finally:
        os.close(session.link.fd)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("schema", help="protocol/schema.json")
    parser.add_argument("link", help="HOST:PORT, serial:PATH, slcan:PATH[#NODE], or `vectors`")
    parser.add_argument("--first-version", type=int, metavar="N", help="say hello in this version first")
    given = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # An exception, so that the board is disarmed.
    try:
        with open(given.schema, encoding="utf-8") as file:
            codec = Codec(json.load(file))
        told = check_vectors(codec) if given.link == "vectors" else run(codec, given.link, given.first_version)
        code = 0
    except Refused as refused:
        code, told = 1, dict(zip(("refused", "refusal"), refused.args))
    except (OSError, ValueError, LookupError, RuntimeError) as error:
        code, told = 2, {"error": str(error)}
    print(json.dumps(told))
    return code


if __name__ == "__main__":
    sys.exit(main())
