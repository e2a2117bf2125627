"""Tests of the learning environments."""

from __future__ import annotations

import sys
import threading
import time

import gymnasium
import numpy as np
import pytest
import r4.gym
import r4.multi
from gymnasium.utils.env_checker import check_env
from numpy.typing import NDArray
from pettingzoo.test import parallel_api_test

FIDELITIES = ("full", "kinematic")


def towards(seen: NDArray[np.float32]) -> NDArray[np.float32]:
    """Proportional controller that turns to the goal, then drives."""
    bearing = np.arctan2(seen[:, 2], seen[:, 1])
    forward = np.where(np.abs(bearing) < 0.5, np.clip(2.0 * seen[:, 0], 0.2, 1.0), 0.0)
    return np.stack([forward, np.clip(2.0 * bearing, -1.0, 1.0)], axis=1).astype(np.float32)


@pytest.mark.parametrize("fidelity", FIDELITIES)
def test_gymnasium_has_nothing_against_it(fidelity: r4.gym.Fidelity) -> None:
    # pytest turns warnings of the checker into errors.
    check_env(r4.gym.make("openscout-goto", fidelity=fidelity))


def test_it_is_registered() -> None:
    env = gymnasium.make("r4/openscout-goto-v0", fidelity="kinematic")
    seen, info = env.reset(seed=1)
    assert seen in env.observation_space and info["fidelity"] == "kinematic"


@pytest.mark.parametrize("fidelity", FIDELITIES)
def test_pettingzoo_has_nothing_against_it(fidelity: r4.gym.Fidelity) -> None:
    parallel_api_test(r4.multi.parallel_env("openscout-goto", 3, fidelity), num_cycles=400)


@pytest.mark.parametrize("fidelity", FIDELITIES)
def test_a_vector_is_its_environments_side_by_side(fidelity: r4.gym.Fidelity) -> None:
    episodes = [11, 12, 13]
    vector = r4.gym.make("openscout-goto", fidelity=fidelity, num_envs=3)
    seen, _ = vector.reset(options={"episodes": episodes})
    singles = [r4.gym.make("openscout-goto", fidelity=fidelity) for _ in episodes]
    for number, (single, episode) in enumerate(zip(singles, episodes)):
        np.testing.assert_array_equal(single.reset(options={"episode": episode})[0], seen[number])
    for _ in range(5):
        actions = towards(seen)
        seen, reward, *_ = vector.step(actions)
        for number, single in enumerate(singles):
            alone, alone_reward, *_ = single.step(actions[number])
            np.testing.assert_array_equal(alone, seen[number])
            assert alone_reward == reward[number]


def test_other_threads_run_while_boards_do() -> None:
    vector = r4.gym.make("openscout-goto", num_envs=16)
    vector.reset(seed=1)
    actions = np.zeros((16, 2), dtype=np.float32)
    ran, over = [0], threading.Event()

    def other() -> None:
        while not over.is_set():
            ran[0] += 1
            time.sleep(0.0)

    interval = sys.getswitchinterval()
    # Longer than the test: a thread gets the interpreter only where another one gives it away.
    sys.setswitchinterval(1000.0)
    thread = threading.Thread(target=other)
    thread.start()
    try:
        # A step is 1.6 s of simulated boards: several turns of the system's scheduler, even on a busy machine.
        for _ in range(20):
            before = ran[0]
            vector.step(actions)
            if ran[0] > before:
                break
        assert ran[0] > before
    finally:
        sys.setswitchinterval(interval)
        over.set()
        thread.join()


def test_an_environment_of_a_vector_begins_anew_after_its_end() -> None:
    vector = r4.gym.make("openscout-goto", fidelity="kinematic", num_envs=2)
    seen, _ = vector.reset(seed=3)
    ends = np.zeros(2, dtype=int)
    over = np.zeros(2, dtype=bool)
    for _ in range(700):
        seen, reward, terminated, truncated, _ = vector.step(towards(seen))
        # The step after an end begins an episode: a reward of 0, a goal at 1 m to 3 m.
        assert (reward[over] == 0.0).all() and (seen[over, 0] > 0.99).all()
        over = terminated | truncated
        ends += over
    assert (ends >= 2).all()


@pytest.mark.parametrize("action", [np.array([[np.nan, 0.0]]), np.array([[0.0, 1.5]]), np.zeros((1, 3)), np.zeros((2, 2))])
def test_actions_that_are_none(action: NDArray[np.float64]) -> None:
    vector = r4.gym.make("openscout-goto", fidelity="kinematic", num_envs=1)
    vector.reset(seed=1)
    with pytest.raises(ValueError):
        vector.step(action.astype(np.float32))


def test_policies_are_evaluated_on_full_boards() -> None:
    good = r4.gym.evaluate(towards, range(31, 35))
    assert good.reached == 1.0 and good.episodes == 4 and 0.3 < good.reached_low < 1.0 == good.reached_high
    idle = r4.gym.evaluate(lambda seen: np.zeros((len(seen), 2), np.float32), [31])
    # Cost of the time: 300 steps at 0.01 each.
    assert idle.reached == 0.0 and idle.mean_steps == 300 and idle.mean_return == pytest.approx(-3.0, abs=0.01)


def test_names_that_are_none() -> None:
    with pytest.raises(ValueError, match="openscout-goto"):
        r4.gym.make("openscout-fly")
    with pytest.raises(ValueError, match="to report"):
        r4.gym.make("openscout-goto", fidelity="perfect")  # type: ignore[call-overload]
