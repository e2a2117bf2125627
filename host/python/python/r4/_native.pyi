from collections.abc import Sequence
from os import PathLike
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "Board",
    "Channel",
    "Cycle",
    "GoTo",
    "Info",
    "Mode",
    "Motion",
    "PathReport",
    "Port",
    "Request",
    "Sample",
    "find",
    "identify",
    "merge",
    "models",
    "read_log",
    "robots",
    "study",
    "systems",
]

_File = str | PathLike[str]

@final
class Mode:
    """A mode in which a channel accepts set points: name, unit of the set points, and their range."""

    @property
    def mode(self) -> str: ...
    @property
    def unit(self) -> str: ...
    @property
    def min(self) -> float: ...
    @property
    def max(self) -> float: ...

@final
class Channel:
    """Description of a channel by the board: unit and range of its measurement, or, for a pure output, of its set points."""

    @property
    def name(self) -> str: ...
    @property
    def kind(self) -> str: ...
    @property
    def index(self) -> int: ...
    @property
    def unit(self) -> str: ...
    @property
    def min(self) -> float: ...
    @property
    def max(self) -> float: ...
    @property
    def rate_hz(self) -> float: ...
    @property
    def resolution(self) -> float: ...
    @property
    def modes(self) -> list[Mode]: ...

@final
class Info:
    """Description of a board, received when its session opens."""

    @property
    def address(self) -> str: ...
    @property
    def robot(self) -> str: ...
    @property
    def firmware(self) -> str: ...
    @property
    def link_timeout_s(self) -> float: ...
    @property
    def channels(self) -> list[Channel]: ...

@final
class Motion:
    """State of a motor in its last sample: rad or m, rad/s or m/s, share of the supply. Position is NaN without a sensor for it."""

    @property
    def position(self) -> float: ...
    @property
    def speed(self) -> float: ...
    @property
    def duty(self) -> float: ...
    @property
    def settled(self) -> bool: ...
    @property
    def homed(self) -> bool: ...
    @property
    def after_s(self) -> float: ...

@final
class Sample:
    """A sample of a channel, with a time of the board's clock. A number that the channel does not have is NaN.

    Motors and encoders have ``position`` and ``speed``, motors ``duty``, ``settled`` and ``homed``; channels with one number have
    ``value``, sensors with several ``values``, by names with units. ``quality`` is ``"good"`` or the reason why a reading is unreliable.
    """

    @property
    def channel(self) -> str: ...
    @property
    def time_s(self) -> float: ...
    @property
    def state(self) -> str: ...
    @property
    def causes(self) -> list[str]: ...
    @property
    def position(self) -> float: ...
    @property
    def speed(self) -> float: ...
    @property
    def duty(self) -> float: ...
    @property
    def value(self) -> float: ...
    @property
    def values(self) -> dict[str, float]: ...
    @property
    def settled(self) -> bool: ...
    @property
    def homed(self) -> bool: ...
    @property
    def quality(self) -> str: ...
    @property
    def age_s(self) -> float: ...

@final
class PathReport:
    """Result of following a path with one motor: largest and RMS distance from the path, rad or m; lag, s."""

    @property
    def channel(self) -> str: ...
    @property
    def points(self) -> int: ...
    @property
    def worst(self) -> float: ...
    @property
    def rms(self) -> float: ...
    @property
    def lag_s(self) -> float: ...
    @property
    def end(self) -> float: ...
    @property
    def settled(self) -> bool: ...

@final
class Cycle:
    """Result of a cycle of set points (``"taken"``, ``"refused"``, ``"stale"``, ``"unbound"``), with the state of its channels."""

    @property
    def number(self) -> int: ...
    @property
    def outcome(self) -> str: ...
    @property
    def time_s(self) -> float: ...
    @property
    def round_trip_s(self) -> float: ...
    @property
    def state(self) -> str: ...
    @property
    def causes(self) -> list[str]: ...
    @property
    def positions(self) -> list[float]: ...
    @property
    def speeds(self) -> list[float]: ...
    @property
    def duties(self) -> list[float]: ...
    @property
    def settled(self) -> list[bool]: ...

@final
class Port:
    """A serial port of this computer: its address for :func:`r4.open`; ``is_board`` is true when its USB device reports a board."""

    @property
    def address(self) -> str: ...
    @property
    def is_board(self) -> bool: ...
    @property
    def product(self) -> str | None: ...
    @property
    def serial(self) -> str | None: ...

@final
class Request:
    """A request to a board. A wrong name or number raises :class:`ValueError` here, before anything is sent."""

    @staticmethod
    def arm() -> Request: ...
    @staticmethod
    def disarm() -> Request: ...
    @staticmethod
    def clear() -> Request: ...
    @staticmethod
    def estop() -> Request: ...
    @staticmethod
    def state() -> Request: ...
    @staticmethod
    def time() -> Request: ...
    @staticmethod
    def sleep(duration_s: float) -> Request: ...
    @staticmethod
    def set(of: str, by: str, value: float) -> Request: ...
    @staticmethod
    def move_to(of: str, position: float, timeout_s: float) -> Request: ...
    @staticmethod
    def home(of: str, speed: float, timeout_s: float) -> Request: ...
    @staticmethod
    def hold(of: str, by: str, value: float, duration_s: float) -> Request: ...
    @staticmethod
    def query(of: str) -> Request: ...
    @staticmethod
    def true_position(of: str) -> Request: ...
    @staticmethod
    def follow(paths: dict[str, list[tuple[float, float, float | None, float]]]) -> Request: ...
    @staticmethod
    def open_stream(number: int, channels: list[tuple[str, str]], ttl_s: float) -> Request: ...
    @staticmethod
    def cycle(number: int, values: list[float]) -> Request: ...
    @staticmethod
    def close_stream(number: int) -> Request: ...

@final
class Board:
    """A board with an open session, on a thread of its own."""

    @staticmethod
    def open(
        address: str,
        *,
        seed: int = 1,
        world: str | None = None,
        plants: dict[str, _File] = ...,
        body: _File | None = None,
        hidden: int | None = None,
        flash: _File | None = None,
        key: _File | None = None,
        log: _File | None = None,
    ) -> Board: ...
    @property
    def info(self) -> Info: ...
    @property
    def is_virtual(self) -> bool: ...
    def call(self, request: Request) -> Any: ...
    def submit(self, requests: list[tuple[int, Request]]) -> None: ...
    def drain(self) -> list[tuple[int, bool, Any]]: ...
    def abort(self, ticket: int) -> None: ...
    def fileno(self) -> int: ...
    def close(self) -> None: ...

def find() -> list[Port]:
    """Serial ports of this computer, boards first."""

def robots() -> list[str]:
    """Names of the built-in robots."""

_Series = tuple[str, str, NDArray[np.float64], Any]

def read_log(path: _File) -> tuple[dict[str, Any], list[_Series], list[str]]:
    """Reads a recording: facts, signals, warnings."""

def identify(
    train: Sequence[_File],
    holdout: Sequence[_File],
    model: str,
    columns: dict[str, str],
    *,
    parameters: dict[str, float],
    time: str | None,
    split: Sequence[str],
    plant: _File | None,
    seed: int,
    budget_s: float | None,
) -> tuple[dict[str, Any], str | None]:
    """Searches recordings for effects that a model lacks: the report, and the text of a plant file."""

def models() -> list[dict[str, Any]]:
    """Base models: name, summary, roles, parameters, effects."""

def study(
    system: str, *, arms: Sequence[str], first_seed: int | None, seeds: int, board: str | None, shard: str | None
) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Runs a study: rows and records."""

def merge(parts: Sequence[str]) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Merges the records of a study's shards, given as JSON: rows and records."""

def systems() -> list[str]:
    """Names of the robot systems."""

_Steps = tuple[
    NDArray[np.float32],
    NDArray[np.float64],
    NDArray[np.bool_],
    NDArray[np.bool_],
    NDArray[np.bool_],
    NDArray[np.float64],
]

@final
class GoTo:
    """Environments that are reset and stepped together, on all cores."""

    def __new__(cls, count: int, kinematic: bool) -> GoTo: ...
    def reset(self, seeds: Sequence[int | None]) -> NDArray[np.float32]: ...
    def step(self, actions: NDArray[np.float64], seeds: Sequence[int | None]) -> _Steps: ...
    @staticmethod
    def bounds() -> list[tuple[float, float]]: ...
    @staticmethod
    def episode_steps() -> int: ...
    @staticmethod
    def step_s() -> float: ...
