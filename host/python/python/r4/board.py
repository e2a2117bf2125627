"""A board for programs with an event loop. Its twin with blocking calls is in :mod:`r4.blocking`; both use one session.

Positions are rad or m at the output, speeds rad/s or m/s, duties shares of the supply in -1..1, times s.
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from types import TracebackType
from typing import TYPE_CHECKING, Any

from . import _channels
from ._channels import ByKind, Channels
from ._native import Channel as ChannelInfo
from ._native import Cycle, Info, Motion, PathReport, Request, Sample
from ._session import Path, Session, points
from .errors import R4Error

if TYPE_CHECKING:
    from .blocking import BlockingBoard


class Channel:
    """A channel of a :class:`Board`. :attr:`info` lists the modes that it accepts; any other raises :class:`r4.Unsuitable`."""

    def __init__(self, board: Board, info: ChannelInfo) -> None:
        self._board = board
        #: Description of the channel by the board: unit, range, resolution and modes.
        self.info = info

    def __repr__(self) -> str:
        return f"<{self.info.name}, takes {', '.join(mode.mode for mode in self.info.modes) or 'nothing'}>"

    async def query(self) -> Sample:
        """Returns the next sample: the state of a motor, the reading of an input. Takes at most 10 ms of the board's time."""
        sample: Sample = await self._board._call(Request.query(self.info.name))
        return sample

    async def move_to(self, position: float, timeout_s: float = 10.0) -> Motion:
        """Moves to a position, rad or m, and waits until the motor has settled there.

        Raises :class:`r4.NotReached` after ``timeout_s``, :class:`r4.Stopped` when the board trips.
        """
        motion: Motion = await self._board._call(Request.move_to(self.info.name, position, timeout_s))
        return motion

    async def home(self, speed: float, timeout_s: float = 30.0) -> Motion:
        """Searches the home switch at this speed, rad/s or m/s, whose sign is the direction, and waits until it is found."""
        motion: Motion = await self._board._call(Request.home(self.info.name, speed, timeout_s))
        return motion

    async def hold_speed(self, speed: float, duration_s: float) -> Motion:
        """Turns at a speed, rad/s or m/s, for a time. The result's speed is the mean of the last 0.1 s. The motor keeps turning."""
        motion: Motion = await self._board._call(Request.hold(self.info.name, "speed", speed, duration_s))
        return motion

    async def hold_duty(self, duty: float, duration_s: float) -> Motion:
        """Applies a duty, -1..1, for a time, otherwise like :meth:`hold_speed`."""
        motion: Motion = await self._board._call(Request.hold(self.info.name, "duty", duty, duration_s))
        return motion

    async def set_position(self, position: float) -> None:
        """Sends a position, rad or m, without waiting for the motor to reach it."""
        await self._set("position", position)

    async def set_speed(self, speed: float) -> None:
        """Sends a speed, rad/s or m/s. The motor turns until the next set point."""
        await self._set("speed", speed)

    async def set_duty(self, duty: float) -> None:
        """Sends a duty: a share of the supply, -1..1."""
        await self._set("duty", duty)

    async def set_voltage(self, voltage_v: float) -> None:
        """Sends the voltage of an output, V."""
        await self._set("voltage", voltage_v)

    async def set_force(self, force_n: float) -> None:
        """Sends the force that a motor presses with, N."""
        await self._set("force", force_n)

    async def set_switch(self, on: bool) -> None:
        """Switches a relay on or off."""
        await self._set("switch", float(on))

    async def set_brake(self, on: bool) -> None:
        """Applies or releases the brake of a drive."""
        await self._set("brake", float(on))

    async def true_position(self) -> float:
        """Returns the true position of a simulated motor's output, rad or m."""
        position: float = await self._board._call(Request.true_position(self.info.name))
        return position

    async def _set(self, mode: str, value: float) -> None:
        await self._board._call(Request.set(self.info.name, mode, value))


class Stream:
    """Set points for up to four channels; each cycle returns the state of the channels. Created by :meth:`Board.stream`."""

    def __init__(self, board: Board, number: int, channels: Sequence[tuple[str, str]], ttl_s: float) -> None:
        self._board, self._number, self._channels, self._ttl_s = board, number, channels, ttl_s

    async def __aenter__(self) -> Stream:
        await self._board._call(Request.open_stream(self._number, list(self._channels), self._ttl_s))
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._board._call(Request.close_stream(self._number))

    async def cycle(self, values: Sequence[float]) -> Cycle:
        """Sends a set point for each channel, in the order of the stream, and waits for the board's answer."""
        report: Cycle = await self._board._call(Request.cycle(self._number, list(values)))
        return report


class Board(ByKind[Channel]):
    """A board, opened by ``async with``; see :func:`r4.open` and :func:`r4.sim`.

    ``board.osmc[0]`` or ``board["osmc0"]`` is a channel. Several tasks may call it concurrently.
    """

    def __init__(self, session: Session) -> None:
        self._session = session

    def __repr__(self) -> str:
        return f"<r4.Board {self._session}>"

    @property
    def blocking(self) -> BlockingBoard:
        """The same board with blocking calls, which open the session by themselves."""
        from .blocking import BlockingBoard

        return BlockingBoard(self._session)

    async def __aenter__(self) -> Board:
        await asyncio.to_thread(self._session.connect)
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        try:
            await self.close()
        except R4Error:
            # An error inside the block takes precedence: it is the first one.
            if error is None:
                raise

    async def close(self) -> None:
        """Closes the session. The board makes its outputs safe."""
        self._session.detach()
        await asyncio.to_thread(self._session.close)

    @property
    def info(self) -> Info:
        """Description of the board and its channels."""
        return self._session.native.info

    async def arm(self) -> None:
        """Arms the board, so that outputs may move. Raises :class:`r4.Refused` while a cause is present or a trip is latched."""
        await self._call(Request.arm())

    async def disarm(self) -> None:
        """Disarms the board, which makes its outputs safe."""
        await self._call(Request.disarm())

    async def clear(self) -> None:
        """Clears a trip once its causes are gone; raises :class:`r4.Refused` before."""
        await self._call(Request.clear())

    async def estop(self) -> None:
        """Trips the board: outputs stop at once, and move again only after :meth:`clear` and :meth:`arm`."""
        await self._call(Request.estop())

    async def state(self) -> tuple[str, list[str]]:
        """Returns ``"disarmed"``, ``"armed"`` or ``"tripped"``, and the latched causes."""
        state: tuple[str, list[str]] = await self._call(Request.state())
        return state

    async def time_s(self) -> float:
        """Returns the time of the session's clock, s. That of a simulated board stands still between calls."""
        time_s: float = await self._call(Request.time())
        return time_s

    async def run_for(self, duration_s: float) -> None:
        """Waits for a duration of the board's time; that of a simulated board passes only during calls."""
        await self._call(Request.sleep(duration_s))

    async def follow(self, paths: Mapping[str, Path]) -> list[PathReport]:
        """Lets motors follow paths together, and waits until they have settled: ``{"osmc0": (times_s, positions[, speeds])}``.

        A motor that is not at its first point moves there first.
        """
        reports: list[PathReport] = await self._call(Request.follow(points(paths)))
        return reports

    def stream(self, channels: Mapping[str, str], ttl_s: float = 0.1) -> Stream:
        """Stream of set points at a high rate: ``async with board.stream({"osmc0": "speed"}) as stream``.

        The channels stop when no cycle arrives for ``ttl_s`` of the board's time.
        """
        return Stream(self, self._session.next_stream(), list(channels.items()), ttl_s)

    def __getitem__(self, name: str) -> Channel:
        return Channel(self, _channels.find(name, self.info))

    def _of(self, kind: str) -> Channels[Channel]:
        info = self.info
        of_kind = {channel.index: Channel(self, channel) for channel in info.channels if channel.kind == kind}
        return Channels(kind, of_kind, info)

    async def _call(self, request: Request) -> Any:
        return await self._session.turns.call(request)
