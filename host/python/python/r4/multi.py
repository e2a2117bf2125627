"""Several robots, each on a board of its own, as a PettingZoo environment: ``r4.multi.parallel_env("openscout-goto", 4)``."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.utils import seeding
from numpy.typing import NDArray
from pettingzoo import ParallelEnv

from . import gym
from ._native import GoTo


class ParallelGoTo(ParallelEnv):  # type: ignore[misc]
    """Independent robots: each drives to its own goal on its own plane, all at the same time. An agent leaves at the end of its episode."""

    metadata = {"name": "openscout-goto", "render_modes": []}

    def __init__(self, robots: int, fidelity: gym.Fidelity = "full") -> None:
        self.render_mode = None
        self.possible_agents = [f"scout{number}" for number in range(robots)]
        self.agents: list[str] = []
        self._native = GoTo(robots, gym._is_kinematic(fidelity))
        self._observation_spaces = {agent: gym.observation_space() for agent in self.possible_agents}
        self._action_spaces = {agent: gym.action_space() for agent in self.possible_agents}
        self._random, _ = seeding.np_random(None)

    def observation_space(self, agent: str) -> spaces.Box[np.float32]:
        return self._observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Box[np.float32]:
        return self._action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, NDArray[np.float32]], dict[str, dict[str, Any]]]:
        if seed is not None:
            self._random, _ = seeding.np_random(seed)
        self.agents = list(self.possible_agents)
        episodes = [int(episode) for episode in self._random.integers(gym._SEEDS, size=len(self.agents))]
        seen = self._native.reset(list(episodes))
        return dict(zip(self.agents, seen)), {a: {"episode": e} for a, e in zip(self.agents, episodes)}

    def step(
        self, actions: dict[str, NDArray[np.float32]]
    ) -> tuple[
        dict[str, NDArray[np.float32]], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, Any]]
    ]:
        if not self.agents:
            return {}, {}, {}, {}, {}
        none = np.zeros(2)
        numbers = np.array([actions.get(agent, none) for agent in self.possible_agents], dtype=np.float64)
        seen, reward, terminated, truncated, reached, distance_m = self._native.step(numbers, [None] * len(numbers))
        at = {agent: number for number, agent in enumerate(self.possible_agents)}
        here, self.agents = self.agents, [a for a in self.agents if not (terminated[at[a]] or truncated[at[a]])]
        return (
            {a: seen[at[a]] for a in here},
            {a: float(reward[at[a]]) for a in here},
            {a: bool(terminated[at[a]]) for a in here},
            {a: bool(truncated[at[a]]) for a in here},
            {a: {"reached": bool(reached[at[a]]), "distance_m": float(distance_m[at[a]])} for a in here},
        )

    def render(self) -> None:
        return None

    def close(self) -> None:
        self.agents = []


def parallel_env(task: str, robots: int, fidelity: gym.Fidelity = "full") -> ParallelGoTo:
    """Creates an environment of ``robots`` robots, each with the task on a board of its own."""
    if task not in gym.TASKS:
        raise ValueError(f"no task is called {task!r}: there are {', '.join(gym.TASKS)}")
    return ParallelGoTo(robots, fidelity)
