"""Benchmark: steps of environments per second, against the same kinematic model as a plain Python environment.

Per second of wall time, and per second of CPU time, which does not depend on other load of the computer.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import r4.gym
from numpy.typing import NDArray


class PlainGoTo(gymnasium.Env[NDArray[np.float32], NDArray[np.float32]]):
    """Reference that a user would write: the kinematic model of docs/python.md, a loop in Python, observations in NumPy."""

    GAINS, ACCELERATION, DELAY, TRACK, SPEED, TURN, RIM = (0.990, 0.932), 1.032, 0.022, 0.35, 0.5, 1.5, 0.532

    def __init__(self) -> None:
        self.observation_space, self.action_space = r4.gym.observation_space(), r4.gym.action_space()

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[NDArray[np.float32], dict[str, Any]]:
        super().reset(seed=seed)
        distance, bearing = self.np_random.uniform(1.0, 3.0), self.np_random.uniform(-math.pi, math.pi)
        self.goal = distance * math.cos(bearing), distance * math.sin(bearing)
        self.x = self.y = self.yaw = 0.0
        self.rims, self.asked, self.steps, self.distance = [0.0, 0.0], [0.0, 0.0], 0, distance
        return self.seen(0.0, 0.0), {}

    def seen(self, way: float, turned: float) -> NDArray[np.float32]:
        to_x, to_y = self.goal[0] - self.x, self.goal[1] - self.y
        bearing = math.atan2(to_y, to_x) - self.yaw
        numbers = [math.hypot(to_x, to_y), math.cos(bearing), math.sin(bearing), way / 0.1, turned / 0.1]
        return np.array(numbers, dtype=np.float32)

    def step(self, action: NDArray[np.float32]) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        forward, across = float(action[0]) * self.SPEED, float(action[1]) * self.TURN * self.TRACK / 2.0
        asked = [max(-self.RIM, min(self.RIM, rim)) for rim in (forward - across, forward + across)]
        way, yaw = 0.0, self.yaw
        for tick in range(10):
            before = list(self.rims)
            late = max(0.0, min(1.0, self.DELAY / 0.01 - tick))
            for side in range(2):
                target = late * self.asked[side] + (1.0 - late) * asked[side]
                most = self.ACCELERATION * 0.01
                self.rims[side] += max(-most, min(most, target - self.rims[side]))
            left, right = ((b + r) / 2.0 for b, r in zip(before, self.rims))
            step_way = self.GAINS[0] * (left + right) / 2.0 * 0.01
            turned = self.GAINS[1] * (right - left) / self.TRACK * 0.01
            self.x += step_way * math.cos(self.yaw + turned / 2.0)
            self.y += step_way * math.sin(self.yaw + turned / 2.0)
            self.yaw += turned
            way += step_way
        self.asked = asked
        self.steps += 1
        distance = math.hypot(self.goal[0] - self.x, self.goal[1] - self.y)
        reached = distance < 0.1
        reward, self.distance = self.distance - distance - 0.01 + reached, distance
        return self.seen(way, self.yaw - yaw), reward, reached, not reached and self.steps >= 300, {}


def measured(step: Callable[[], int], seconds: float = 2.0) -> tuple[float, float]:
    """Steps per second of wall time, and per second of CPU time; ``step`` returns its number of steps."""
    steps, wall, processors = 0, time.perf_counter(), time.process_time()
    while time.perf_counter() - wall < seconds:
        steps += step()
    return steps / (time.perf_counter() - wall), steps / (time.process_time() - processors)


def single(env: gymnasium.Env[NDArray[np.float32], NDArray[np.float32]]) -> tuple[float, float]:
    """Measures one environment, including the resets at the ends of its episodes."""
    env.reset(seed=1)
    action = np.array([0.5, 0.1], dtype=np.float32)

    def step() -> int:
        _, _, terminated, truncated, _ = env.step(action)
        if terminated or truncated:
            env.reset()
        return 1

    return measured(step)


def vector(fidelity: r4.gym.Fidelity, count: int) -> tuple[float, float]:
    """Measures a vector of environments; counts the steps of all."""
    envs = r4.gym.make("openscout-goto", fidelity=fidelity, num_envs=count)
    envs.reset(seed=1)
    actions = np.tile(np.array([0.5, 0.1], dtype=np.float32), (count, 1))

    def step() -> int:
        envs.step(actions)
        return count

    return measured(step)


def main() -> None:
    """Prints a row for each kind of environment."""
    cores = len(os.sched_getaffinity(0))
    rows = [
        ("plain Python, kinematic, 1", single(PlainGoTo())),
        ("r4, kinematic, 1", single(r4.gym.make("openscout-goto", fidelity="kinematic"))),
        ("r4, kinematic, 4096", vector("kinematic", 4096)),
        ("r4, full board, 1", single(r4.gym.make("openscout-goto"))),
        (f"r4, full board, {4 * cores}", vector("full", 4 * cores)),
    ]
    plain, plain_worked = rows[0][1]
    print(f"{f'environment, on {cores} cores':<28} {'steps/s':>10} {'of plain':>10} {'steps/CPU s':>12} {'of plain':>10}")
    for name, (rate, worked) in rows:
        print(f"{name:<28} {rate:>10.0f} {rate / plain:>9.2f}x {worked:>12.0f} {worked / plain_worked:>9.2f}x")


if __name__ == "__main__":
    main()
