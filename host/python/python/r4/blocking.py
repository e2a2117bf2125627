"""A board with blocking calls: the twin of :mod:`r4.board`. A waiting call releases the interpreter for other threads."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import TracebackType
from typing import Any

from . import _channels
from ._channels import ByKind, Channels
from ._native import Channel as ChannelInfo
from ._native import Cycle, Info, Motion, PathReport, Request, Sample
from ._session import Path, Session, points
from .errors import R4Error


class BlockingChannel:
    """A channel of a :class:`BlockingBoard`; its methods are those of :class:`r4.Channel`, as blocking calls."""

    def __init__(self, board: BlockingBoard, info: ChannelInfo) -> None:
        self._board = board
        #: Description of the channel by the board: unit, range, resolution and modes.
        self.info = info

    def __repr__(self) -> str:
        return f"<{self.info.name}, takes {', '.join(mode.mode for mode in self.info.modes) or 'nothing'}>"

    def query(self) -> Sample:
        """Blocking version of :meth:`r4.Channel.query`."""
        sample: Sample = self._board._call(Request.query(self.info.name))
        return sample

    def move_to(self, position: float, timeout_s: float = 10.0) -> Motion:
        """Blocking version of :meth:`r4.Channel.move_to`."""
        motion: Motion = self._board._call(Request.move_to(self.info.name, position, timeout_s))
        return motion

    def home(self, speed: float, timeout_s: float = 30.0) -> Motion:
        """Blocking version of :meth:`r4.Channel.home`."""
        motion: Motion = self._board._call(Request.home(self.info.name, speed, timeout_s))
        return motion

    def hold_speed(self, speed: float, duration_s: float) -> Motion:
        """Blocking version of :meth:`r4.Channel.hold_speed`."""
        motion: Motion = self._board._call(Request.hold(self.info.name, "speed", speed, duration_s))
        return motion

    def hold_duty(self, duty: float, duration_s: float) -> Motion:
        """Blocking version of :meth:`r4.Channel.hold_duty`."""
        motion: Motion = self._board._call(Request.hold(self.info.name, "duty", duty, duration_s))
        return motion

    def set_position(self, position: float) -> None:
        """Blocking version of :meth:`r4.Channel.set_position`."""
        self._set("position", position)

    def set_speed(self, speed: float) -> None:
        """Blocking version of :meth:`r4.Channel.set_speed`."""
        self._set("speed", speed)

    def set_duty(self, duty: float) -> None:
        """Blocking version of :meth:`r4.Channel.set_duty`."""
        self._set("duty", duty)

    def set_voltage(self, voltage_v: float) -> None:
        """Blocking version of :meth:`r4.Channel.set_voltage`."""
        self._set("voltage", voltage_v)

    def set_force(self, force_n: float) -> None:
        """Blocking version of :meth:`r4.Channel.set_force`."""
        self._set("force", force_n)

    def set_switch(self, on: bool) -> None:
        """Blocking version of :meth:`r4.Channel.set_switch`."""
        self._set("switch", float(on))

    def set_brake(self, on: bool) -> None:
        """Blocking version of :meth:`r4.Channel.set_brake`."""
        self._set("brake", float(on))

    def true_position(self) -> float:
        """Blocking version of :meth:`r4.Channel.true_position`."""
        position: float = self._board._call(Request.true_position(self.info.name))
        return position

    def _set(self, mode: str, value: float) -> None:
        self._board._call(Request.set(self.info.name, mode, value))


class BlockingStream:
    """Blocking version of :class:`r4.board.Stream`, created by :meth:`BlockingBoard.stream`."""

    def __init__(self, board: BlockingBoard, number: int, channels: Sequence[tuple[str, str]], ttl_s: float) -> None:
        self._board, self._number, self._channels, self._ttl_s = board, number, channels, ttl_s

    def __enter__(self) -> BlockingStream:
        self._board._call(Request.open_stream(self._number, list(self._channels), self._ttl_s))
        return self

    def __exit__(self, *_: object) -> None:
        self._board._call(Request.close_stream(self._number))

    def cycle(self, values: Sequence[float]) -> Cycle:
        """Blocking version of :meth:`r4.board.Stream.cycle`."""
        report: Cycle = self._board._call(Request.cycle(self._number, list(values)))
        return report


class BlockingBoard(ByKind[BlockingChannel]):
    """A board whose calls are those of :class:`r4.Board`, as blocking calls.

    The session opens with ``with`` or the first call, and closes at the end of ``with``, by :meth:`close`, or with the program.
    """

    def __init__(self, session: Session) -> None:
        self._session = session

    def __repr__(self) -> str:
        return f"<r4.BlockingBoard {self._session}>"

    def __enter__(self) -> BlockingBoard:
        self._session.connect()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        try:
            self.close()
        except R4Error:
            # An error inside the block takes precedence: it is the first one.
            if error is None:
                raise

    def close(self) -> None:
        """Blocking version of :meth:`r4.Board.close`."""
        self._session.close()

    @property
    def info(self) -> Info:
        """Blocking version of :attr:`r4.Board.info`."""
        return self._session.connect().info

    def arm(self) -> None:
        """Blocking version of :meth:`r4.Board.arm`."""
        self._call(Request.arm())

    def disarm(self) -> None:
        """Blocking version of :meth:`r4.Board.disarm`."""
        self._call(Request.disarm())

    def clear(self) -> None:
        """Blocking version of :meth:`r4.Board.clear`."""
        self._call(Request.clear())

    def estop(self) -> None:
        """Blocking version of :meth:`r4.Board.estop`."""
        self._call(Request.estop())

    def state(self) -> tuple[str, list[str]]:
        """Blocking version of :meth:`r4.Board.state`."""
        state: tuple[str, list[str]] = self._call(Request.state())
        return state

    def time_s(self) -> float:
        """Blocking version of :meth:`r4.Board.time_s`."""
        time_s: float = self._call(Request.time())
        return time_s

    def run_for(self, duration_s: float) -> None:
        """Blocking version of :meth:`r4.Board.run_for`."""
        self._call(Request.sleep(duration_s))

    def follow(self, paths: Mapping[str, Path]) -> list[PathReport]:
        """Blocking version of :meth:`r4.Board.follow`."""
        reports: list[PathReport] = self._call(Request.follow(points(paths)))
        return reports

    def stream(self, channels: Mapping[str, str], ttl_s: float = 0.1) -> BlockingStream:
        """Blocking version of :meth:`r4.Board.stream`: ``with board.stream({"osmc0": "speed"}) as stream``."""
        return BlockingStream(self, self._session.next_stream(), list(channels.items()), ttl_s)

    def __getitem__(self, name: str) -> BlockingChannel:
        return BlockingChannel(self, _channels.find(name, self.info))

    def _of(self, kind: str) -> Channels[BlockingChannel]:
        info = self.info
        of_kind = {channel.index: BlockingChannel(self, channel) for channel in info.channels if channel.kind == kind}
        return Channels(kind, of_kind, info)

    def _call(self, request: Request) -> Any:
        return self._session.connect().call(request)
