"""R4 robotics boards, real and simulated.

>>> import r4
>>> board = r4.sim("osmc-bench", seed=1).blocking
>>> board.arm()
>>> round(board.osmc[0].move_to(1.57).position, 2)
1.57
>>> board.close()
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

from ._channels import Channels
from ._native import Channel as ChannelInfo
from ._native import Cycle, Info, Mode, Motion, PathReport, Port, Sample, find, robots
from ._session import Session
from .analysis import Identified, Log, Signal, Study, identify, merge, models, read_log, read_study, study, systems
from .blocking import BlockingBoard, BlockingChannel
from .board import Board, Channel
from .errors import (
    BadAddress,
    BadFile,
    BadRobot,
    LinkError,
    NotIdentified,
    NotReached,
    NotStudied,
    R4Error,
    Refused,
    SessionEnded,
    Stopped,
    Unsuitable,
)

__all__ = [
    "BadAddress",
    "BadFile",
    "BadRobot",
    "BlockingBoard",
    "BlockingChannel",
    "Board",
    "Channel",
    "ChannelInfo",
    "Channels",
    "Cycle",
    "Identified",
    "Info",
    "LinkError",
    "Log",
    "Mode",
    "Motion",
    "NotIdentified",
    "NotReached",
    "NotStudied",
    "PathReport",
    "Port",
    "R4Error",
    "Refused",
    "Sample",
    "SessionEnded",
    "Signal",
    "Stopped",
    "Study",
    "Unsuitable",
    "find",
    "identify",
    "merge",
    "models",
    "open",
    "read_log",
    "read_study",
    "robots",
    "sim",
    "study",
    "systems",
]


def open(
    address: str, *, key: str | os.PathLike[str] | None = None, log: str | os.PathLike[str] | None = None
) -> Board:
    """Board at an address: ``serial:auto``, ``serial:/dev/ttyACM0``, ``tcp:HOST:PORT``, ``can:can0#NODE``, ``sim:osmc-bench``.

    The session opens with ``async with``, or with the first call of :attr:`Board.blocking`. ``key`` is a file with the key of
    the link; ``log`` is a file that the session is recorded into, for :func:`read_log`.
    """
    return Board(Session(address, {"key": key, "log": log}))


def sim(
    robot: str,
    *,
    seed: int = 1,
    world: str | None = None,
    plants: Mapping[str, str | os.PathLike[str]] | None = None,
    body: str | os.PathLike[str] | None = None,
    hidden: int | None = None,
    flash: str | os.PathLike[str] | None = None,
    log: str | os.PathLike[str] | None = None,
) -> Board:
    """Simulated board of a robot: the name of a built-in one (:func:`robots`), or a TOML file.

    The same seed and calls give the same results, bit for bit: its clock runs only while a call waits.

    ``world`` is the name or file of the world that it stands in; ``plants`` are plant files of motors, as in
    ``{"osmc0": "plant.toml"}``; ``body`` is a body file; ``hidden`` is the seed of an effect hidden in its physics; ``flash`` is
    a file that holds its flash memory between sessions.
    """
    settings: dict[str, Any] = {
        "seed": seed,
        "world": world,
        "plants": dict(plants or {}),
        "body": body,
        "hidden": hidden,
        "flash": flash,
        "log": log,
    }
    return Board(Session(f"sim:{robot}", settings))
