"""Tests of a board with blocking calls."""

from __future__ import annotations

import _thread
import math
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
import r4


def test_three_lines_move_a_motor() -> None:
    board = r4.sim("osmc-bench", seed=1).blocking
    board.arm()
    # Settle error of the bench's motor in its file: 0.005 rad.
    assert board.osmc[0].move_to(1.57).position == pytest.approx(1.57, abs=0.005)


def test_a_board_says_what_it_is(bench: r4.BlockingBoard) -> None:
    info = bench.info
    assert (info.address, info.robot, info.link_timeout_s) == ("sim:osmc-bench", "osmc-bench", 0.2)
    assert [channel.name for channel in info.channels][:2] == ["osmc0", "actuator1"]
    modes = {mode.mode: mode.unit for mode in bench.osmc[0].info.modes}
    assert modes["position"] == "rad" and modes["speed"] == "rad/s"
    assert {mode.mode: mode.unit for mode in bench["actuator1"].info.modes}["position"] == "m"
    assert list(bench.osmc) == [0] and list(bench.actuator) == [1] and len(bench.servo) == 0


def test_refusals_have_their_cause(bench: r4.BlockingBoard) -> None:
    with pytest.raises(r4.Refused, match="arm it first") as refused:
        bench.osmc[0].set_speed(1.0)
    assert (refused.value.reason, refused.value.details) == ("not-armed", {"state": "Disarmed"})
    bench.estop()
    with pytest.raises(r4.Refused, match="clear it first") as refused:
        bench.arm()
    assert (refused.value.reason, refused.value.causes) == ("tripped", ["host stop"])
    assert bench.state() == ("tripped", ["host stop"])
    bench.clear()
    bench.arm()
    assert bench.state() == ("armed", [])


def test_what_a_channel_does_not_take_is_not_sent(armed: r4.BlockingBoard) -> None:
    with pytest.raises(r4.Unsuitable, match="takes a position from -3600.00 deg to 3600.00 deg") as unsuitable:
        armed.osmc[0].move_to(1e6)
    assert unsuitable.value.channel == "osmc0"
    for wrong in (lambda: armed.relay[0].set_speed(1.0), lambda: armed.supply[0].set_voltage(1.0)):
        with pytest.raises(r4.Unsuitable):
            wrong()
    with pytest.raises(r4.Unsuitable, match="has no osmc7: it has osmc0"):
        armed.osmc[7]
    with pytest.raises(r4.Unsuitable, match="has no wheel0"):
        armed["wheel0"]
    with pytest.raises(r4.Unsuitable):
        armed.osmc[0].move_to(math.nan)
    with pytest.raises(ValueError, match="seconds from 0 on"):
        armed.run_for(-1.0)
    assert armed.osmc[0].query().duty == 0.0


def test_addresses_and_robots_that_are_none() -> None:
    with pytest.raises(r4.BadAddress, match="names no board"):
        r4.open("nowhere").blocking.arm()
    with pytest.raises(r4.BadRobot, match="no-such-robot"):
        r4.sim("no-such-robot").blocking.arm()
    with pytest.raises(r4.LinkError):
        r4.open("tcp:127.0.0.1:1").blocking.arm()
    assert "openscout" in r4.robots()
    assert all(port.address.startswith("serial:") for port in r4.find())


def test_a_motor_that_needs_longer(armed: r4.BlockingBoard) -> None:
    with pytest.raises(r4.NotReached, match="was not settled after 0.1 s") as late:
        armed.osmc[0].move_to(3.0, timeout_s=0.1)
    assert late.value.channel == "osmc0" and isinstance(late.value, TimeoutError)


def test_time_goes_on_by_calls_only(armed: r4.BlockingBoard) -> None:
    armed.osmc[0].set_speed(2.0)
    armed.run_for(0.5)
    before = armed.time_s()
    # Longer than the link's timeout of 0.2 s: a board whose clock ran meanwhile would trip.
    time.sleep(0.3)
    assert armed.time_s() == before
    assert armed.state()[0] == "armed"
    armed.run_for(0.25)
    assert armed.time_s() - before == pytest.approx(0.25, abs=0.02)
    assert armed.osmc[0].query().speed == pytest.approx(2.0, rel=0.1)


def test_the_same_seed_gives_the_same_bits() -> None:
    def run(seed: int) -> list[float]:
        with r4.sim("field-rover", seed=seed).blocking as board:
            board.run_for(0.3)
            return list(board.imu[0].query().values.values())

    assert run(3) == run(3)
    # The tolerance is the noise of the inertial sensor.
    assert run(3) != run(4)


def test_paths_are_followed_together(armed: r4.BlockingBoard) -> None:
    time_s = np.linspace(0.0, 2.0, 101)
    turn = 1.0 - np.cos(np.pi * time_s / 2.0)
    reports = armed.follow({"osmc0": (time_s, turn), "actuator1": (time_s, 0.03 + 0.005 * turn)})
    by_channel = {report.channel: report for report in reports}
    motor, rod = by_channel["osmc0"], by_channel["actuator1"]
    # The motor rests at most two counts of 2.6 mrad, plus their rounding, from the last point.
    assert motor.settled and motor.end == pytest.approx(2.0, abs=0.0065)
    # Limits: 1.6 rad/s, and 1 % of the range of the rod.
    assert motor.worst < 0.05 and rod.worst < 0.001
    with pytest.raises(ValueError, match="not later than the one before"):
        armed.follow({"osmc0": ([0.0, 0.0], [0.0, 1.0])})
    with pytest.raises(ValueError, match="2 times, 1 positions"):
        armed.follow({"osmc0": ([0.0, 1.0], [0.0])})


def test_cycles_are_answered_by_what_the_channels_do(armed: r4.BlockingBoard) -> None:
    armed.run_for(0.1)
    with armed.stream({"osmc0": "speed", "actuator1": "position"}, ttl_s=0.05) as stream:
        for _ in range(100):
            report = stream.cycle([2.0, 0.02])
            armed.run_for(0.01)
    assert report.outcome == "taken" and report.state == "armed" and report.number == 99
    assert report.speeds[0] == pytest.approx(2.0, rel=0.1)
    assert report.positions[1] == pytest.approx(armed.actuator[1].query().position, abs=0.002)
    # Without cycles the set points exceed their time to live.
    armed.run_for(1.0)
    assert armed.osmc[0].query().speed == pytest.approx(0.0, abs=0.05)


def test_a_stop_ends_what_is_waited_for(armed: r4.BlockingBoard) -> None:
    stopped: list[r4.Stopped] = []

    def moving() -> None:
        with pytest.raises(r4.Stopped) as error:
            armed.osmc[0].move_to(60.0, timeout_s=1000.0)
        stopped.append(error.value)

    thread = threading.Thread(target=moving)
    thread.start()
    armed.run_for(0.5)
    armed.estop()
    thread.join()
    assert stopped[0].causes == ["host stop"]


def test_ctrl_c_ends_waiting_and_the_board_goes_on(bench: r4.BlockingBoard) -> None:
    # Python keeps SIGINT ignored when it was started so, as in the background of a shell.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    timer = threading.Timer(0.3, _thread.interrupt_main)
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        bench.run_for(1e7)
    signal.signal(signal.SIGINT, before)
    assert bench.state()[0] == "disarmed"


def test_a_closed_session_says_so() -> None:
    board = r4.sim("osmc-bench")
    with pytest.raises(r4.SessionEnded, match="no session with sim:osmc-bench"):
        board.info
    blocking = board.blocking
    first = blocking.info.robot
    blocking.close()
    blocking.close()
    # Each session powers up a new board.
    assert blocking.info.robot == first and blocking.time_s() < 0.1
    blocking.close()


def test_hidden_effects_and_plants_change_the_motor(tmp_path: Path) -> None:
    def end(**settings: int) -> float:
        with r4.sim("osmc-bench", **settings).blocking as board:
            board.arm()
            return board.osmc[0].hold_duty(0.8, 1.0).speed

    assert end(hidden=5) != end() == end(seed=1)
    with pytest.raises(r4.BadRobot):
        r4.sim("osmc-bench", plants={"osmc0": tmp_path / "none.toml"}).blocking.arm()
    with pytest.raises(ValueError, match="not a channel name"):
        r4.sim("osmc-bench", plants={"motor": tmp_path / "none.toml"}).blocking.arm()


def test_a_program_that_forgets_its_board_closes_the_session(tmp_path: Path) -> None:
    program = f"""
import r4
board = r4.sim("osmc-bench", log={str(tmp_path / "run.mcap")!r}).blocking
board.arm()
board.run_for(0.2)
"""
    subprocess.run([sys.executable, "-c", program], check=True, timeout=60)
    # The recording is complete.
    assert r4.read_log(tmp_path / "run.mcap").warnings == []
