"""Channels of a board by kind and number, for both kinds of boards."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Generic, TypeVar

from ._native import Channel as ChannelInfo
from ._native import Info
from .errors import Unsuitable

C = TypeVar("C")

class Channels(Mapping[int, C], Generic[C]):
    """Channels of one kind by their numbers, which are those of the connectors and need not begin at 0."""

    def __init__(self, kind: str, by_number: dict[int, C], info: Info) -> None:
        self._kind, self._by_number, self._info = kind, by_number, info

    def __getitem__(self, number: int) -> C:
        try:
            return self._by_number[number]
        except KeyError:
            name = f"{self._kind}{number}"
            raise unknown(name, self._info) from None

    def __iter__(self) -> Iterator[int]:
        return iter(self._by_number)

    def __len__(self) -> int:
        return len(self._by_number)

    def __repr__(self) -> str:
        return f"Channels({', '.join(f'{self._kind}{number}' for number in self._by_number) or f'no {self._kind}'})"


def unknown(name: str, info: Info) -> Unsuitable:
    known = ", ".join(channel.name for channel in info.channels)
    return Unsuitable(f"{info.robot} has no {name}: it has {known}", channel=name)


def find(name: str, info: Info) -> ChannelInfo:
    for channel in info.channels:
        if channel.name == name:
            return channel
    raise unknown(name, info)


class ByKind(Generic[C]):
    """Channels by their kinds: ``board.osmc[0]``."""

    def _of(self, kind: str) -> Channels[C]:
        raise NotImplementedError

    @property
    def osmc(self) -> Channels[C]:
        """Motors on OSMC bridges."""
        return self._of("osmc")

    @property
    def actuator(self) -> Channels[C]:
        """Linear actuators on OSMC bridges."""
        return self._of("actuator")

    @property
    def dhb(self) -> Channels[C]:
        """Motors on dual H-bridges."""
        return self._of("dhb")

    @property
    def bldc(self) -> Channels[C]:
        """Drives of brushless motors."""
        return self._of("bldc")

    @property
    def servo(self) -> Channels[C]:
        """RC servos."""
        return self._of("servo")

    @property
    def stepper(self) -> Channels[C]:
        """Stepper drives."""
        return self._of("stepper")

    @property
    def relay(self) -> Channels[C]:
        """Relays, which switch on and off."""
        return self._of("relay")

    @property
    def encoder(self) -> Channels[C]:
        """Quadrature encoders."""
        return self._of("encoder")

    @property
    def switch(self) -> Channels[C]:
        """Switches beside encoders."""
        return self._of("switch")

    @property
    def range(self) -> Channels[C]:
        """Ultrasonic range sensors."""
        return self._of("range")

    @property
    def analog(self) -> Channels[C]:
        """Analog inputs."""
        return self._of("analog")

    @property
    def supply(self) -> Channels[C]:
        """Supply rails."""
        return self._of("supply")

    @property
    def dac(self) -> Channels[C]:
        """Digital-to-analog outputs."""
        return self._of("dac")

    @property
    def dead_man(self) -> Channels[C]:
        """Dead-man's handles."""
        return self._of("dead-man")

    @property
    def imu(self) -> Channels[C]:
        """Inertial sensors."""
        return self._of("imu")

    @property
    def current(self) -> Channels[C]:
        """Current monitors."""
        return self._of("current")

    @property
    def angle(self) -> Channels[C]:
        """Absolute angle sensors."""
        return self._of("angle")

    @property
    def force(self) -> Channels[C]:
        """Load cells."""
        return self._of("force")

    @property
    def distance(self) -> Channels[C]:
        """Optical distance sensors."""
        return self._of("distance")
