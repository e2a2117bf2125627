"""Calls from an event loop to a board's thread.

A result writes to a socket that the event loop watches. The clock of a virtual board runs in turns: it stands still until all ready
tasks of the loop have made their calls, then runs until the first call has its result, then stands still again. The results of a
program therefore do not depend on the speed of the computer or of a typing user.
"""

from __future__ import annotations

import asyncio
import contextlib
from typing import Any

from . import _native
from .errors import SessionEnded

#: Turns of the event loop without a new call before a virtual board's clock runs. A result reaches its waiting task after one turn,
#: and through ``gather`` or a task group after two more for each level: eight are enough for three levels. Four would be enough for
#: one; each turn takes about 10 us.
_QUIET_TURNS = 8


class Turns:
    """Calls to one board from event loops, one loop at a time."""

    def __init__(self, board: _native.Board) -> None:
        self._board = board
        self._loop: asyncio.AbstractEventLoop | None = None
        self._waiting: dict[int, asyncio.Future[Any]] = {}
        self._requests: list[tuple[int, _native.Request]] = []
        self._next_ticket = 0
        self._quiet = 0
        self._is_counting = False

    async def call(self, request: _native.Request) -> Any:
        """Carries out a request and returns its result. A cancelled call is aborted; a motion that it started continues."""
        loop = self._attach()
        ticket, self._next_ticket = self._next_ticket, self._next_ticket + 1
        future: asyncio.Future[Any] = loop.create_future()
        self._waiting[ticket] = future
        self._requests.append((ticket, request))
        self._count(loop)
        try:
            return await future
        except asyncio.CancelledError:
            self._waiting.pop(ticket, None)
            self._requests = [one for one in self._requests if one[0] != ticket]
            self._board.abort(ticket)
            # After the end of the session there is no clock to release.
            with contextlib.suppress(SessionEnded):
                if self._waiting:
                    self._count(loop)
                else:
                    self._board.submit([])
            raise

    def detach(self) -> None:
        """Stops watching for results: waiting calls end with :class:`SessionEnded`."""
        if self._loop is not None and not self._loop.is_closed():
            self._loop.remove_reader(self._board.fileno())
            for ticket in list(self._waiting):
                self._settle(ticket, False, SessionEnded("the session was closed while this call waited"))
        self._loop = None

    def detach_from_any_thread(self) -> None:
        """Detaches from a loop that may run in another thread."""
        if self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self.detach)

    def _attach(self) -> asyncio.AbstractEventLoop:
        loop = asyncio.get_running_loop()
        if loop is not self._loop:
            self.detach()
            loop.add_reader(self._board.fileno(), self._rung)
            self._loop, self._is_counting = loop, False
            self._waiting.clear()
            self._requests.clear()
        return loop

    def _count(self, loop: asyncio.AbstractEventLoop) -> None:
        """Counts turns without a new call; the last one submits the collected requests."""
        self._quiet = _QUIET_TURNS if self._board.is_virtual else 1
        if not self._is_counting:
            self._is_counting = True
            loop.call_soon(self._turn, loop)

    def _turn(self, loop: asyncio.AbstractEventLoop) -> None:
        if loop is not self._loop:
            return
        self._quiet -= 1
        if self._quiet > 0:
            loop.call_soon(self._turn, loop)
            return
        self._is_counting = False
        requests, self._requests = self._requests, []
        try:
            self._board.submit(requests)
        except Exception as error:
            for ticket, _ in requests:
                self._settle(ticket, False, error)

    def _rung(self) -> None:
        for ticket, succeeded, result in self._board.drain():
            self._settle(ticket, succeeded, result)
        if self._waiting and self._loop is not None:
            self._count(self._loop)

    def _settle(self, ticket: int, succeeded: bool, result: Any) -> None:
        future = self._waiting.pop(ticket, None)
        if future is None or future.done():
            return
        if succeeded:
            future.set_result(result)
        else:
            future.set_exception(result)
