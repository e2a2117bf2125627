"""Exceptions: what happened, with the cause as attributes, and what to do next in the message."""

from __future__ import annotations

from typing import Any


class R4Error(Exception):
    """Any failure of a board, a link, a recording or a computation."""


class BadAddress(R4Error, ValueError):
    """The text names no board."""


class BadRobot(R4Error, ValueError):
    """The robot's, world's or plant's file cannot be used, or the call needs a simulated board."""


class BadFile(R4Error, ValueError):
    """A recording or plant file cannot be used."""


class NotIdentified(R4Error, ValueError):
    """Recordings, model and columns do not go together; the message says what to change."""


class NotStudied(R4Error):
    """A study could not be run."""


class LinkError(R4Error, ConnectionError):
    """There is no link, or it was lost, or no answer came in time. Open the board again."""


class SessionEnded(R4Error):
    """The session is closed, or was never opened."""


class Refused(R4Error):
    """The board understood the request and did not carry it out."""

    def __init__(self, message: str, *, reason: str, details: Any = None, causes: list[str] | None = None) -> None:
        super().__init__(message)
        #: Name of the refusal, as in ``"not-armed"`` or ``"out-of-range"``.
        self.reason = reason
        #: Its numbers, as the board sent them.
        self.details: dict[str, Any] = details or {}
        #: Causes that keep the board from arming, as in ``"dead-man released"``.
        self.causes: list[str] = causes or []


class Stopped(R4Error):
    """The board tripped or was disarmed while something was waited for."""

    def __init__(self, message: str, *, causes: list[str]) -> None:
        super().__init__(message)
        #: Causes of the trip; empty when the board was disarmed.
        self.causes = causes


class _OfChannel(R4Error):
    def __init__(self, message: str, *, channel: str) -> None:
        super().__init__(message)
        #: Name of the channel.
        self.channel = channel


class Unsuitable(_OfChannel, ValueError):
    """The channel does not take this; nothing was sent."""


class NotReached(_OfChannel, TimeoutError):
    """The motor did not reach its set point, or not find its home, in time. It still tries: disarm, or command it otherwise."""
