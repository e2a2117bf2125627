"""Exceptions. The message says what happened and the next step; causes are attributes."""

from __future__ import annotations

from typing import Any


class R4Error(Exception):
    """Base class: failure of a board, a link, a recording or a computation."""


class BadAddress(R4Error, ValueError):
    """The address does not name a board."""


class BadRobot(R4Error, ValueError):
    """The robot's, world's or plant's file cannot be used, or the call needs a simulated board."""


class BadFile(R4Error, ValueError):
    """A recording or plant file cannot be used."""


class NotIdentified(R4Error, ValueError):
    """Recordings, model and columns do not fit together; the message says what to change."""


class NotStudied(R4Error):
    """A study could not be run."""


class LinkError(R4Error, ConnectionError):
    """The link cannot be opened or was lost, or an answer timed out. Open the board again."""


class SessionEnded(R4Error):
    """The session is closed, or was never opened."""


class Refused(R4Error):
    """The board understood the request and refused it."""

    def __init__(self, message: str, *, reason: str, details: Any = None, causes: list[str] | None = None) -> None:
        super().__init__(message)
        #: Name of the refusal, as in ``"not-armed"`` or ``"out-of-range"``.
        self.reason = reason
        #: Fields of the refusal, such as the limits, as the board sent them.
        self.details: dict[str, Any] = details or {}
        #: Causes that prevent the board from arming, as in ``"dead-man released"``.
        self.causes: list[str] = causes or []


class Stopped(R4Error):
    """The board tripped or was disarmed while a call waited."""

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
    """The channel does not accept the request; nothing was sent."""


class NotReached(_OfChannel, TimeoutError):
    """The motor did not reach its set point, or did not find its home, in time. It still tries: disarm, or send another set point."""
