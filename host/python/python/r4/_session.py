"""Session that both kinds of boards share: it is opened once."""

from __future__ import annotations

import itertools
import threading
import weakref
from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias, Union

from . import _native
from ._turns import Turns
from .errors import SessionEnded

#: Times in s, positions in rad or m, and optionally speeds in rad/s or m/s: sequences or arrays.
Path: TypeAlias = Union[
    tuple[Sequence[float], Sequence[float]],
    tuple[Sequence[float], Sequence[float], Sequence[float]],
]


class Session:
    """Session that opens its board at the first use."""

    def __init__(self, address: str, settings: dict[str, Any]) -> None:
        self._address, self._settings = address, settings
        self._lock = threading.Lock()
        self._native: _native.Board | None = None
        self._turns: Turns | None = None
        self._at_end: weakref.finalize[[], Session] | None = None
        self._streams = itertools.count()

    def __str__(self) -> str:
        return self._address

    def connect(self) -> _native.Board:
        """Opens the session unless it is open already, and returns the native board."""
        with self._lock:
            if self._native is None:
                self._native = _native.Board.open(self._address, **self._settings)
                self._turns = Turns(self._native)
                # The session also closes when the program ends or drops its last reference to the board.
                self._at_end = weakref.finalize(self, self._native.close)
            return self._native

    def close(self) -> None:
        """Closes the session unless it is closed already."""
        with self._lock:
            native, turns = self._native, self._turns
            self._native = self._turns = None
            if self._at_end is not None:
                self._at_end.detach()
        if native is not None and turns is not None:
            turns.detach_from_any_thread()
            native.close()

    def detach(self) -> None:
        """Stops this thread's event loop from watching for results."""
        if self._turns is not None:
            self._turns.detach()

    @property
    def native(self) -> _native.Board:
        """Native board of the open session. Raises :class:`SessionEnded` without one."""
        if self._native is None:
            raise SessionEnded(f"no session with {self._address}: open it by `async with`, or use `.blocking`")
        return self._native

    @property
    def turns(self) -> Turns:
        """Calls from event loops. Raises :class:`SessionEnded` without a session."""
        self.native  # noqa: B018 - raises when there is no session
        assert self._turns is not None
        return self._turns

    def next_stream(self) -> int:
        """Returns a number that no other stream of the session has."""
        return next(self._streams)


def points(paths: Mapping[str, Path]) -> dict[str, list[tuple[float, float, float | None, float]]]:
    """Converts paths to the points that the board's thread expects."""
    made = {}
    for name, path in paths.items():
        times, positions = path[0], path[1]
        speeds: Sequence[float | None] = path[2] if len(path) == 3 else [None] * len(times)
        if not len(times) == len(positions) == len(speeds):
            raise ValueError(f"{name}: {len(times)} times, {len(positions)} positions, {len(speeds)} speeds")
        made[name] = [(t, p, s, 0.0) for t, p, s in zip(times, positions, speeds)]
    return made
