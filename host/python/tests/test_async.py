"""Tests of a board in event loops."""

from __future__ import annotations

import asyncio
import time

import pytest
import r4


def test_tasks_move_side_by_side_and_time_does_not_depend_on_the_machine() -> None:
    async def run(delay_s: float) -> tuple[float, ...]:
        async with r4.sim("osmc-bench", seed=2) as board:
            await board.arm()
            # Simulates a slow computer, or a slow user.
            time.sleep(delay_s)

            async def back_and_forth() -> float:
                await board.osmc[0].move_to(1.0)
                await board.osmc[0].move_to(0.5)
                return (await board.osmc[0].query()).position

            motor, rod = await asyncio.gather(back_and_forth(), board.actuator[1].move_to(0.03))
            return motor, rod.position, rod.after_s, await board.time_s()

    quick, slow = asyncio.run(run(0.0)), asyncio.run(run(0.2))
    assert quick == slow
    assert quick[0] == pytest.approx(0.5, abs=0.005) and quick[1] == pytest.approx(0.03, abs=0.001)
    # The moves run concurrently: the session takes no longer than the longer one, and arming.
    assert quick[3] < quick[2] + 0.2


def test_task_groups_two_deep_are_one_moment() -> None:
    async def run() -> list[float]:
        async with r4.sim("osmc-bench") as board:
            await board.arm()
            times: list[float] = []

            async def at() -> None:
                await board.run_for(0.1)
                times.append(await board.time_s())

            async def pair() -> None:
                await asyncio.gather(at(), at())

            async with asyncio.TaskGroup() as group:
                for _ in range(3):
                    group.create_task(pair())
            return times

    times = asyncio.run(run())
    assert len(times) == 6 and max(times) == min(times)


def test_cancelling_ends_waiting_for_one_call_only() -> None:
    async def run() -> None:
        async with r4.sim("osmc-bench") as board:
            await board.arm()
            far = asyncio.create_task(board.osmc[0].move_to(60.0, timeout_s=1e6))
            near = asyncio.create_task(board.run_for(0.2))
            await near
            far.cancel()
            with pytest.raises(asyncio.CancelledError):
                await far
            # The motor still moves: cancelling a call does not stop it.
            assert (await board.osmc[0].query()).speed > 0.1
            await board.disarm()

    asyncio.run(run())


def test_closing_ends_what_still_waits() -> None:
    async def run() -> None:
        board = r4.sim("osmc-bench")
        async with board:
            far = asyncio.create_task(board.run_for(1e6))
            await board.run_for(0.1)
        with pytest.raises(r4.SessionEnded, match="closed while this call waited"):
            await far

    asyncio.run(run())


def test_errors_reach_the_task_that_asked() -> None:
    async def run() -> None:
        async with r4.sim("osmc-bench") as board:
            results = await asyncio.gather(board.osmc[0].set_speed(1.0), board.time_s(), return_exceptions=True)
            assert isinstance(results[0], r4.Refused) and results[0].reason == "not-armed"
            assert isinstance(results[1], float)
            with pytest.raises(r4.Unsuitable):
                await board.relay[0].set_speed(1.0)

    asyncio.run(run())


def test_both_twins_talk_to_one_session() -> None:
    async def run() -> None:
        async with r4.sim("osmc-bench") as board:
            await board.arm()
            assert board.blocking.state()[0] == "armed"
            motion = await asyncio.to_thread(board.blocking.osmc[0].move_to, 0.5)
            assert (await board.osmc[0].query()).position == pytest.approx(motion.position, abs=0.001)
        with pytest.raises(r4.SessionEnded):
            await board.arm()

    asyncio.run(run())


def test_a_board_goes_on_in_another_event_loop() -> None:
    board = r4.sim("osmc-bench")

    async def arm() -> None:
        await board.__aenter__()
        await board.arm()

    async def state() -> tuple[str, list[str]]:
        return await board.state()

    asyncio.run(arm())
    assert asyncio.run(state()) == ("armed", [])
    asyncio.run(board.close())


def test_streams_in_an_event_loop() -> None:
    async def run() -> list[float]:
        async with r4.sim("osmc-bench") as board:
            await board.arm()
            await board.run_for(0.1)
            async with board.stream({"osmc0": "speed"}) as stream:
                for _ in range(50):
                    report = await stream.cycle([2.0])
                    await board.run_for(0.01)
            return report.speeds

    assert asyncio.run(run())[0] == pytest.approx(2.0, rel=0.1)
