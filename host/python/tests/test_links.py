"""Tests of boards on a link, served by the program `r4` in real time."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
import r4
from conftest import ROOT

PROGRAM = Path(os.environ.get("R4_PROGRAM", ROOT / "target" / "debug" / "r4"))

pytestmark = pytest.mark.skipif(not PROGRAM.exists(), reason=f"not run: no program {PROGRAM}; `cargo build -p r4` makes it")


SHARED = "shared"


@contextlib.contextmanager
def served(how: str) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """Serves a simulated bench, as a board for one program or ``SHARED``; yields its address and the process."""
    command: list[str | Path] = [PROGRAM, "sim", "serve", "osmc-bench", how]
    if how == SHARED:
        how = "--tcp=127.0.0.1:0"
        command = [PROGRAM, "serve", "sim:osmc-bench", how]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as program:
        try:
            assert program.stdout is not None
            place = json.loads(program.stdout.readline())
            kind = how.split("=")[0].removeprefix("--")
            yield {"tcp": "tcp:", "pty": "serial:", "slcan": "can:slcan:"}[kind] + place[kind], program
        finally:
            program.terminate()


@pytest.fixture(params=["--tcp=127.0.0.1:0", "--pty", "--slcan", SHARED])
def address(request: pytest.FixtureRequest) -> Iterator[str]:
    """Address of a served simulated bench."""
    with served(request.param) as (address, _):
        yield address


def test_the_same_calls_drive_a_board_behind_a_link(address: str, tmp_path: Path) -> None:
    with r4.open(address, log=tmp_path / "run.mcap").blocking as board:
        assert board.info.address.startswith(address) and board.info.robot == "osmc-bench"
        with pytest.raises(r4.Refused) as refused:
            board.osmc[0].set_speed(1.0)
        assert refused.value.reason == "not-armed"
        board.arm()
        # 0.3 rad at 1 rad/s to 2 rad/s in real time; the tolerance is two counts of 2.6 mrad.
        assert board.osmc[0].move_to(0.3).position == pytest.approx(0.3, abs=0.0065)
        with pytest.raises(r4.R4Error, match="simulated"):
            board.osmc[0].true_position()
    log = r4.read_log(tmp_path / "run.mcap")
    assert log.seed is None and log["osmc0.position_rad"].value.max() > 0.29


def test_an_event_loop_drives_it_too(address: str) -> None:
    async def run() -> None:
        async with r4.open(address) as board:
            await board.arm()
            motor, rod = await asyncio.gather(board.osmc[0].move_to(0.3), board.actuator[1].query())
            assert motor.settled and rod.state == "armed"

    asyncio.run(run())


def test_a_board_has_one_host_and_a_lost_link_is_an_error_of_the_call() -> None:
    with served("--tcp=127.0.0.1:0") as (address, program), r4.open(address).blocking as board:
        with pytest.raises(r4.Refused, match="another host") as refused:
            r4.open(address).blocking.arm()
        assert refused.value.reason == "in-use"
        program.kill()
        with pytest.raises(r4.LinkError, match="connect again"):
            board.run_for(1.0)
            board.arm()


def test_one_commands_a_shared_board_while_another_watches() -> None:
    with served(SHARED) as (address, _), r4.open(address).blocking as first, r4.open(address).blocking as second:
        first.arm()
        # Four heartbeats, with which each learns the state.
        second.run_for(0.2)
        assert second.state()[0] == "armed"
        with pytest.raises(r4.Refused) as refused:
            second.osmc[0].set_speed(1.0)
        assert refused.value.reason == "in-use"
        moved = first.osmc[0].move_to(0.3)
        # The motor rests: both see it within two counts of 2.6 mrad.
        assert second.osmc[0].query().position == pytest.approx(moved.position, abs=0.0065)
        second.estop()
        first.run_for(0.2)
        assert first.state() == ("tripped", ["host stop"])
