"""Learning environments on boards: ``r4.gym.make("openscout-goto")``.

There are two fidelities and one rule: **train on ``"kinematic"``**, a model whose five parameters were identified from full boards,
**and report only results of ``"full"``**, the board's firmware, chips, motors and tyres. :func:`evaluate` uses the full one only.

docs/python.md describes the task (observations, actions, rewards, ends). The same seeds and actions give the same bits at both
fidelities.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Literal, overload

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from ._native import GoTo

Fidelity = Literal["full", "kinematic"]
Observation = NDArray[np.float32]
Action = NDArray[np.float32]

#: Names of the tasks.
TASKS = ("openscout-goto",)
#: Upper bound of sampled episode seeds: so large that two environments practically never get the same one.
_SEEDS = 2**62


def observation_space() -> spaces.Box[np.float32]:
    """Space of observations: distance to the goal, m; cosine and sine of its bearing; forward speed, m/s; yaw rate, rad/s."""
    low, high = np.array(GoTo.bounds(), dtype=np.float32).T
    return spaces.Box(low, high, dtype=np.float32)


def action_space() -> spaces.Box[np.float32]:
    """Space of actions: forward speed and yaw rate, as shares of the robot's limits, -1..1."""
    return spaces.Box(-1.0, 1.0, (2,), dtype=np.float32)


class GoToEnv(gymnasium.Env[Observation, Action]):
    """A single environment. ``reset(options={"episode": n})`` begins the episode of that seed instead of a sampled one."""

    metadata = {"render_modes": []}

    def __init__(self, fidelity: Fidelity = "full") -> None:
        self.fidelity = fidelity
        self.render_mode = None
        self.observation_space = observation_space()
        self.action_space = action_space()
        self._native = GoTo(1, _is_kinematic(fidelity))

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        super().reset(seed=seed)
        episode = (options or {}).get("episode")
        if episode is None:
            episode = self.np_random.integers(_SEEDS)
        seen = self._native.reset([int(episode)])
        return seen[0], {"episode": int(episode), "fidelity": self.fidelity}

    def step(self, action: Action) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        actions = np.asarray(action, dtype=np.float64).reshape(1, -1)
        seen, reward, terminated, truncated, reached, distance_m = self._native.step(actions, [None])
        info = {"reached": bool(reached[0]), "distance_m": float(distance_m[0]), "fidelity": self.fidelity}
        return seen[0], float(reward[0]), bool(terminated[0]), bool(truncated[0]), info


class GoToVectorEnv(VectorEnv[Observation, Action, NDArray[Any]]):
    """Vector of environments, stepped on all cores. One whose episode is over begins the next episode with the next step."""

    metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.NEXT_STEP}

    def __init__(self, num_envs: int, fidelity: Fidelity = "full") -> None:
        super().__init__()
        self.fidelity = fidelity
        self.num_envs = num_envs
        self.render_mode = None
        self.single_observation_space = observation_space()
        self.single_action_space = action_space()
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._native = GoTo(num_envs, _is_kinematic(fidelity))
        self._over = np.ones(num_envs, dtype=bool)

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begins an episode in each environment. ``options={"episodes": [...]}`` sets the seed of each."""
        super().reset(seed=seed if isinstance(seed, int) else None)
        episodes = (options or {}).get("episodes")
        if episodes is None:
            episodes = list(seed) if isinstance(seed, list) else [None] * self.num_envs
        episodes = [self._next() if episode is None else int(episode) for episode in episodes]
        seen = self._native.reset(episodes)
        self._over[:] = False
        return seen, {"episode": np.array(episodes)}

    def step(
        self, actions: Action
    ) -> tuple[Observation, NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        seeds = [self._next() if over else None for over in self._over]
        numbers = np.asarray(actions, dtype=np.float64)
        seen, reward, terminated, truncated, reached, distance_m = self._native.step(numbers, seeds)
        self._over = terminated | truncated
        return seen, reward, terminated, truncated, {"reached": reached, "distance_m": distance_m}

    def _next(self) -> int:
        return int(self.np_random.integers(_SEEDS))


def _is_kinematic(fidelity: str) -> bool:
    if fidelity not in ("full", "kinematic"):
        raise ValueError(f'fidelity={fidelity!r}: "full" to report, "kinematic" to train')
    return fidelity == "kinematic"


@overload
def make(task: str, *, fidelity: Fidelity = "full", num_envs: None = None) -> GoToEnv: ...
@overload
def make(task: str, *, fidelity: Fidelity = "full", num_envs: int) -> GoToVectorEnv: ...
def make(task: str, *, fidelity: Fidelity = "full", num_envs: int | None = None) -> GoToEnv | GoToVectorEnv:
    """Creates an environment of a task, or a vector of ``num_envs`` environments."""
    if task not in TASKS:
        raise ValueError(f"no task is called {task!r}: there are {', '.join(TASKS)}")
    if num_envs is not None:
        return GoToVectorEnv(num_envs, fidelity)
    # Created by the registry, so that it has a spec; without the registry's wrappers.
    env = gymnasium.make("r4/openscout-goto-v0", fidelity=fidelity, disable_env_checker=True).unwrapped
    assert isinstance(env, GoToEnv)
    return env


@dataclass(frozen=True)
class Evaluation:
    """Result of a policy on full boards, with a 95 % interval (Wilson) of the share that reached the goal."""

    episodes: int
    reached: float
    reached_low: float
    reached_high: float
    mean_return: float
    mean_steps: float


def evaluate(policy: Callable[[Observation], Action], episodes: Iterable[int]) -> Evaluation:
    """Runs a policy on full boards, one for each episode's seed. ``policy`` maps all observations to all actions.

    Seeds from 200001 on are report seeds; tune and select policies on those below.
    """
    seeds = [int(episode) for episode in episodes]
    if not seeds:
        raise ValueError("no episodes: give seeds, as in range(200001, 200101)")
    native = GoTo(len(seeds), False)
    seen = native.reset(list(seeds))
    returns, steps = np.zeros(len(seeds)), np.zeros(len(seeds), dtype=int)
    goes_on, has_reached = np.ones(len(seeds), dtype=bool), np.zeros(len(seeds), dtype=bool)
    while goes_on.any():
        actions = np.asarray(policy(seen), dtype=np.float64)
        seen, reward, terminated, truncated, reached, _ = native.step(actions, [None] * len(seeds))
        returns += reward
        steps += goes_on
        has_reached |= reached
        goes_on &= ~(terminated | truncated)
    share = float(has_reached.mean())
    low, high = _wilson(share, len(seeds))
    return Evaluation(len(seeds), share, low, high, float(returns.mean()), float(steps.mean()))


def _wilson(share: float, n: int, z: float = 1.959963984540054) -> tuple[float, float]:
    middle = (share + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * math.sqrt(share * (1 - share) / n + z * z / (4 * n * n))
    return max(0.0, middle - half), min(1.0, middle + half)


gymnasium.register("r4/openscout-goto-v0", entry_point="r4.gym:GoToEnv")
