"""A client of an R4 board, written from docs/protocol.md and protocol/schema.json alone. Python 3.9 or later, nothing else.

    client.py SCHEMA vectors            reads and writes every test vector of the schema
    client.py SCHEMA HOST:PORT          moves osmc0 by 0.3 rad over TCP
    client.py SCHEMA /dev/pts/N         the same over a serial port or pseudo-terminal

Prints one line of JSON; an error goes to stderr, with exit code 1.
"""

import json
import math
import os
import select
import socket
import struct
import sys
import time

MOVE_RAD = 0.3
TIMEOUT_S = 20.0
TTL_MS = 100


class ProtocolError(Exception):
    pass


class Checksum:
    """Page: Frames."""

    def __init__(self, of):
        self.bytes = of["bytes"]
        width = 8 * self.bytes
        self.polynomial = int(format(int(of["polynomial"], 16), "0{}b".format(width))[::-1], 2)
        self.initial, self.final = int(of["initial"], 16), int(of["final_xor"], 16)
        if self.of(b"123456789") != int(of["check_of_123456789"], 16).to_bytes(self.bytes, "little"):
            raise ProtocolError("the checksum is not that of the schema")

    def of(self, data):
        total = self.initial
        for byte in data:
            total ^= byte
            for _ in range(8):
                total = (total >> 1) ^ (self.polynomial if total & 1 else 0)
        return (total ^ self.final).to_bytes(self.bytes, "little")


class Codec:
    """Frames (page: Frames) and values (page: Encoding), by the types of the schema."""

    def __init__(self, schema):
        self.types = schema["types"]
        self.version = schema["version"]
        self.schema_hash = int(schema["schema_hash"], 16)
        self.max_frame = schema["framing"]["max_frame"]
        self.checks = {name: Checksum(of) for name, of in schema["framing"]["checksums"].items()}
        self.short_of = set(schema["framing"]["short_of"])

    def check(self, kind, value):
        """The checksum that a message of this direction has."""
        if kind == "ToHost":
            return self.checks["short"]
        name, inner = (value, None) if isinstance(value, str) else next(iter(value.items()))
        whole = "ToDevice::" + name
        if name == "Request":
            request = inner["request"]
            whole = "Request::" + (request if isinstance(request, str) else next(iter(request)))
        return self.checks["short" if whole in self.short_of else "long"]

    def frame(self, kind, value):
        """One message as a frame, with its delimiter."""
        message = self.encode(kind, value)
        pieces = (message + self.check(kind, value).of(message)).split(b"\0")
        out = b""
        for number, piece in enumerate(pieces):
            while len(piece) >= 254:
                out, piece = out + b"\xff" + piece[:254], piece[254:]
                if not piece and number == len(pieces) - 1:
                    return out + b"\0"
            out += bytes([len(piece) + 1]) + piece
        return out + b"\0"

    def unframe(self, kind, frame):
        """The message in a frame without its delimiter."""
        plain, at = b"", 0
        while at < len(frame):
            code = frame[at]
            if code == 0 or at + code > len(frame):
                raise ProtocolError("not COBS")
            plain += frame[at + 1 : at + code]
            at += code
            if code != 0xFF and at < len(frame):
                plain += b"\0"
        for check in self.checks.values():
            if len(plain) >= check.bytes and check.of(plain[: -check.bytes]) == plain[-check.bytes :]:
                value = self.decode(kind, plain[: -check.bytes])
                if self.check(kind, value) is check:
                    return value
        raise ProtocolError("wrong checksum")

    def encode(self, kind, value):
        if kind == "bool":
            return bytes([value])
        if kind == "u8":
            return bytes([value])
        if kind == "i8":
            return struct.pack("<b", value)
        if kind in ("u16", "u32", "u64"):
            return self.varint(value)
        if kind in ("i16", "i32", "i64"):
            return self.varint(value << 1 if value >= 0 else (-value << 1) - 1)
        if kind == "f32":
            return struct.pack("<f", float(value))
        if isinstance(kind, str):
            return self.encode_named(self.types[kind], value)
        ((form, of),) = kind.items()
        if form == "string":
            text = value.encode()
            return self.varint(len(text)) + text
        if form == "list":
            return self.varint(len(value)) + b"".join(self.encode(of["of"], one) for one in value)
        if form == "array":
            return b"".join(self.encode(of["of"], one) for one in value)
        if form == "option":
            return b"\0" if value is None else b"\1" + self.encode(of, value)
        if form == "result":
            ((which, inner),) = value.items()
            return b"\0" + self.encode(of["ok"], inner) if which == "Ok" else b"\1" + self.encode(of["err"], inner)
        raise ProtocolError("unknown form " + form)

    def encode_named(self, of, value):
        if "struct" in of:
            return self.encode_fields(of["struct"], value)
        name, inner = (value, {}) if isinstance(value, str) else next(iter(value.items()))
        variant = next(row for row in of["enum"] if row["name"] == name)
        return self.varint(variant["number"]) + self.encode_fields(variant.get("fields", []), inner)

    def encode_fields(self, fields, value):
        if len(fields) == 1 and fields[0]["name"] is None:
            return self.encode(fields[0]["type"], value)
        return b"".join(self.encode(field["type"], value[field["name"]]) for field in fields)

    @staticmethod
    def varint(number):
        out = b""
        while number >= 0x80:
            out, number = out + bytes([number & 0x7F | 0x80]), number >> 7
        return out + bytes([number])

    def decode(self, kind, data):
        """The value that is all of `data`."""
        value, rest = self.take(kind, data)
        if rest:
            raise ProtocolError("bytes are left")
        return value

    def take(self, kind, data):
        if kind in ("bool", "u8", "i8"):
            number = struct.unpack("<b" if kind == "i8" else "<B", data[:1])[0]
            return (bool(number) if kind == "bool" else number), data[1:]
        if kind in ("u16", "u32", "u64"):
            return self.take_varint(data)
        if kind in ("i16", "i32", "i64"):
            number, data = self.take_varint(data)
            return (number >> 1) ^ -(number & 1), data
        if kind == "f32":
            return struct.unpack("<f", data[:4])[0], data[4:]
        if isinstance(kind, str):
            return self.take_named(self.types[kind], data)
        ((form, of),) = kind.items()
        if form == "string":
            length, data = self.take_varint(data)
            return data[:length].decode(), data[length:]
        if form in ("list", "array"):
            length, data = self.take_varint(data) if form == "list" else (of["length"], data)
            values = []
            for _ in range(length):
                value, data = self.take(of["of"], data)
                values.append(value)
            return values, data
        if form == "option":
            return self.take(of, data[1:]) if data[0] else (None, data[1:])
        if form == "result":
            value, rest = self.take(of["err" if data[0] else "ok"], data[1:])
            return {"Err" if data[0] else "Ok": value}, rest
        raise ProtocolError("unknown form " + form)

    def take_named(self, of, data):
        if "struct" in of:
            return self.take_fields(of["struct"], data)
        number, data = self.take_varint(data)
        variant = of["enum"][number]
        if "fields" not in variant:
            return variant["name"], data
        value, data = self.take_fields(variant["fields"], data)
        return {variant["name"]: value}, data

    def take_fields(self, fields, data):
        if len(fields) == 1 and fields[0]["name"] is None:
            return self.take(fields[0]["type"], data)
        values = {}
        for field in fields:
            values[field["name"]], data = self.take(field["type"], data)
        return values, data

    @staticmethod
    def take_varint(data):
        number = 0
        for place, byte in enumerate(data):
            number |= (byte & 0x7F) << 7 * place
            if byte < 0x80:
                return number, data[place + 1 :]
        raise ProtocolError("the message ends early")


def same(ours, told):
    """JSON has no NaN and no infinity: the schema writes those as text."""
    if isinstance(ours, dict):
        return isinstance(told, dict) and ours.keys() == told.keys() and all(same(ours[k], told[k]) for k in ours)
    if isinstance(ours, list):
        return isinstance(told, list) and len(ours) == len(told) and all(map(same, ours, told))
    if isinstance(ours, float):
        return math.isnan(float(told)) if math.isnan(ours) else ours == float(told)
    return ours == told


def vectors(codec, schema):
    checked = 0
    for direction, kind in schema["messages"].items():
        for vector in schema["vectors"][direction]:
            frame, message = bytes.fromhex(vector["frame"]), bytes.fromhex(vector["message"])
            value = codec.unframe(kind, frame[:-1])
            if not same(value, vector["value"]):
                raise ProtocolError("{} is read as {}".format(vector["name"], value))
            if codec.encode(kind, vector["value"]) != message or codec.frame(kind, vector["value"]) != frame:
                raise ProtocolError("{} is written otherwise".format(vector["name"]))
            checked += 1
    return {"vectors": checked}


def open_link(address):
    """A file descriptor that carries bytes as they are."""
    if address.startswith("/"):
        import termios
        import tty

        port = os.open(address, os.O_RDWR | os.O_NOCTTY)
        tty.setraw(port, termios.TCSANOW)
        return port
    host, port = address.rsplit(":", 1)
    link = socket.create_connection((host, int(port)), timeout=5)
    link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    link.setblocking(True)
    return link.detach()


class Board:
    """One session, kept by heartbeats while anything is waited for."""

    def __init__(self, codec, link):
        self.codec, self.link = codec, link
        self.received, self.seq, self.session = b"", 0, None
        self.answers, self.samples = {}, {}
        self.offset_us, self.round_trip_us, self.dated_us = 0, None, 0
        self.state, self.causes, self.heard, self.telemetry = None, 0, 0, 0
        self.next_beat = self.period = None
        os.write(link, b"\0")

    @staticmethod
    def now_us():
        return time.monotonic_ns() // 1000

    def send(self, message):
        frame = self.codec.frame("ToDevice", message)
        while frame:
            frame = frame[os.write(self.link, frame) :]

    def turn(self, until):
        """Sends a heartbeat that is due, and takes what comes by then, or by its time."""
        now = time.monotonic()
        if self.next_beat is not None and now >= self.next_beat:
            self.next_beat = now + self.period
            self.send({"Heartbeat": {"session": self.session, "host_us": self.now_us()}})
        wake = until if self.next_beat is None else min(until, self.next_beat)
        if not select.select([self.link], [], [], max(0.0, wake - time.monotonic()))[0]:
            return
        data = os.read(self.link, 4096)
        if not data:
            raise ProtocolError("the link was closed")
        *frames, self.received = (self.received + data).split(b"\0")
        for frame in filter(None, frames):
            self.take(self.codec.unframe("ToHost", frame))

    def take(self, message):
        ((kind, value),) = message.items()
        if kind == "Response":
            self.answers[value["seq"]] = value["result"]
        elif kind == "Heartbeat":
            self.heard += 1
            self.state, self.causes = value["state"], value["causes"]
            self.clock(value["host_us"], value["device_us"])
        elif kind == "Telemetry":
            self.telemetry += 1
            self.state, self.causes = value["state"], value["causes"]
            for sample in value["samples"]:
                ((_, of),) = sample.items()
                self.samples[of["channel"]["kind"], of["channel"]["index"]] = of

    def clock(self, sent_us, device_us):
        received_us = self.now_us()
        round_trip_us = received_us - sent_us
        if self.round_trip_us is None or round_trip_us <= self.round_trip_us:
            self.round_trip_us = round_trip_us
            self.offset_us = device_us - (sent_us + received_us) // 2

    def ask(self, request, within=0.5):
        """The reply; None when none came. A refusal is an error."""
        self.seq += 1
        seq, until = self.seq, time.monotonic() + within
        self.send({"Request": {"seq": seq, "request": request}})
        while seq not in self.answers:
            if time.monotonic() >= until:
                return None
            self.turn(until)
        ((which, value),) = self.answers.pop(seq).items()
        if which == "Err":
            raise ProtocolError("{} was refused: {}".format(request, value))
        return value

    def want(self, request):
        reply = self.ask(request, within=5.0)
        if reply is None:
            raise ProtocolError("no answer to {}".format(request))
        return reply

    def hello(self):
        for within in (0.1, 0.2, 0.4, 0.5, 0.5, 2.0):
            sent_us = self.now_us()
            reply = self.ask({"Hello": {"version": self.codec.version, "schema": self.codec.schema_hash}}, within)
            if reply is not None:
                info = reply["Hello"]
                self.session, self.state, self.causes = info["session"], info["state"], info["causes"]
                self.clock(sent_us, info["device_us"])
                self.period = info["link_timeout_ms"] / 4000
                self.next_beat = time.monotonic()
                return info
        raise ProtocolError("the board does not answer Hello")

    def date_us(self):
        self.dated_us = max(self.now_us() + self.offset_us, self.dated_us + 1)
        return self.dated_us


def drive(codec, address):
    board = Board(codec, open_link(address))
    info = board.hello()
    channels = [board.want({"Describe": {"index": index}})["Channel"] for index in range(info["channels"])]
    motor = next(one for one in channels if one["id"] == {"kind": "Osmc", "index": 0})
    limits = next(mode["range"] for mode in motor["modes"] if mode["mode"] == "Position")
    board.want({"Subscribe": {"channel": motor["id"], "period_ms": 20}})
    until = time.monotonic() + TIMEOUT_S

    def sample():
        return board.samples.get(("Osmc", 0))

    def wait(what, done):
        while not done():
            if time.monotonic() >= until:
                raise ProtocolError("{}: not within {} s; last seen {}".format(what, TIMEOUT_S, sample()))
            board.turn(until)

    wait("a sample", lambda: sample() is not None)
    begin_rad = sample()["position"] * motor["resolution"]
    target_rad = min(begin_rad + MOVE_RAD, limits["max"])
    if board.state == "Tripped":
        board.want("Clear")
    board.want("Arm")
    setpoint = {"mode": "Position", "value": target_rad}
    board.want({"Set": {"channel": motor["id"], "setpoint": setpoint, "sent_us": board.date_us(), "ttl_ms": TTL_MS}})
    wait("the motor rests at {} rad".format(target_rad), lambda: sample()["settled"] and sample()["setpoint"]["mode"] == "Position")
    end_rad = sample()["position"] * motor["resolution"]
    board.want("Disarm")
    seen = board.heard
    wait("a heartbeat after disarming", lambda: board.heard > seen and board.state == "Disarmed")
    board.want("Bye")
    os.close(board.link)
    return {
        "robot": info["robot"],
        "channels": len(channels),
        "from_rad": begin_rad,
        "target_rad": target_rad,
        "to_rad": end_rad,
        "heartbeats": board.heard,
        "telemetry": board.telemetry,
        "state": board.state,
    }


def main():
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    with open(sys.argv[1], encoding="utf-8") as file:
        schema = json.load(file)
    codec = Codec(schema)
    result = vectors(codec, schema) if sys.argv[2] == "vectors" else drive(codec, sys.argv[2])
    print(json.dumps(result))


if __name__ == "__main__":
    try:
        main()
    except (ProtocolError, OSError) as error:
        sys.exit("error: {}".format(error))
