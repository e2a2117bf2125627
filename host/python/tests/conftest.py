"""Fixtures that the tests share."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
import r4

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture
def bench() -> Iterator[r4.BlockingBoard]:
    """A simulated bench with a motor and an actuator, disarmed."""
    with r4.sim("osmc-bench", seed=1).blocking as board:
        yield board


@pytest.fixture
def armed(bench: r4.BlockingBoard) -> r4.BlockingBoard:
    """The simulated bench, armed."""
    bench.arm()
    return bench
