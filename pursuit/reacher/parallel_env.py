"""The arm as a PettingZoo parallel environment: every joint is an agent, and all are one team."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray
from pettingzoo import ParallelEnv

from pursuit.declared import as_array, one_of, truth
from pursuit.parallel_env import RENDER_MODES
from pursuit.reacher.observations import ENCODINGS, space_of
from pursuit.reacher.rules import ROUNDING
from pursuit.reacher.simulator import ReacherSimulator
from pursuit.reacher.single_agent import RENDER_FPS, begin, checked_mode, render_arm
from pursuit.reacher.task import ReacherTask
from pursuit.rendering import Window
from pursuit.seeds import some_seed


class ReacherParallelEnv(ParallelEnv[str, NDArray[np.float32], Any]):
    """One arm, a joint of which each agent turns: "joint_0" at the base, "joint_1", ...

    All are paid the reward of the whole arm, and their episodes end together. Each sees the whole
    arm, and which joint it is: the observation of `pursuit.reacher.observations`, and after it
    [joints] numbers, 1 for its own and 0 for the others, so that one network can move all joints.

    Actions are [1] float32 in [-1, 1], or, with `discrete_actions`, 0 (back), 1 (stay) or 2
    (forth). The infos are empty.

    Args:
        task: the rules and settings.
        observation: one of `pursuit.reacher.observations.ENCODINGS`.
        render_mode: None, "ansi", "rgb_array" or "human".
        own_number: False leaves out the numbers that say which joint an agent is.

    Raises:
        ValueError: an unknown observation or render mode.

    Attributes:
        task, simulator: the arm, and what moves it.
        np_random: for wrappers that draw; seeded by `reset`, and never drawn from here.
    """

    metadata: dict[str, Any]

    def __init__(
        self,
        task: ReacherTask,
        observation: str = "positions",
        render_mode: str | None = None,
        own_number: bool = True,
    ) -> None:
        self.observation = one_of("observation", observation, ENCODINGS)
        self.render_mode = checked_mode(render_mode)
        self.own_number = truth("own_number", own_number)
        self.metadata = {
            "name": "reacher_v0",
            "render_modes": list(RENDER_MODES),
            "render_fps": RENDER_FPS,
            "is_parallelizable": True,
        }
        self.simulator = ReacherSimulator(task, auto_restart=False)
        self.task = task
        self.possible_agents = [f"joint_{joint}" for joint in range(task.joints)]
        self.agents: list[str] = []
        seen = space_of(task, observation)
        own = np.ones(task.joints if self.own_number else 0, dtype=np.float32)
        low, high = np.concatenate([seen.low, 0 * own]), np.concatenate([seen.high, own])
        # A space of its own for every agent: spaces carry the random state of their samples.
        self.observation_spaces = {
            name: gymnasium.spaces.Box(low, high, dtype=np.float32) for name in self.possible_agents
        }
        self.action_spaces: dict[str, gymnasium.Space[Any]] = {
            name: gymnasium.spaces.Discrete(3)
            if task.discrete_actions
            else gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float32)
            for name in self.possible_agents
        }
        far = task.joints + task.tolerance
        limits = [np.pi] * task.joints + [far, far, task.max_steps, task.max_steps]
        most = np.array(limits, dtype=np.float32)
        least = np.where(np.arange(len(most)) < task.joints + 2, -most, 0.0).astype(np.float32)
        self.state_space = gymnasium.spaces.Box(least, most, dtype=np.float32)
        self._seen = len(seen.low)
        self._observed = np.zeros((task.joints, len(low)), dtype=np.float32)
        self._observed[:, self._seen :] = np.eye(task.joints)[:, : len(own)]
        self._turns = np.zeros((1, task.joints))
        self._seeded = False
        self.np_random = np.random.default_rng()
        self._window: Window | None = None

    def observation_space(self, agent: str) -> gymnasium.Space[Any]:
        """The space of what `agent` observes; the same object at every call."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> gymnasium.Space[Any]:
        """`Box(-1, 1, [1])`, or `Discrete(3)`; the same object at every call."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, NDArray[np.float32]], dict[str, dict[str, Any]]]:
        """Begin a new episode; seed and options are those of `ReacherEnv.reset`.

        Raises:
            ValueError: a seed out of range, or options that make no start; nothing is changed then.
        """
        if seed is None and not self._seeded:
            seed = some_seed()
        begin(self.simulator, seed, options)
        if seed is not None:
            self.np_random = np.random.default_rng(seed)
        self._seeded = True
        self.agents = self.possible_agents[:]
        if self.render_mode == "human":
            self.render()
        return self._observations(), {agent: {} for agent in self.agents}

    def step(
        self, actions: Mapping[str, Any]
    ) -> tuple[
        dict[str, NDArray[np.float32]],
        dict[str, float],
        dict[str, bool],
        dict[str, bool],
        dict[str, dict[str, Any]],
    ]:
        """Turn all joints at once.

        Raises:
            ValueError: before the first reset; an agent without an action, an action out of range
                or of another shape, or one for somebody who is not playing. Then nothing has moved.
        """
        if not self.agents:
            if not self._seeded:
                raise ValueError("step before reset; call reset() first")
            return {}, {}, {}, {}, {}
        if not isinstance(actions, Mapping):
            raise ValueError(f"actions={actions!r}; give a dict of an action for every agent")
        if len(actions) != len(self.agents) or any(agent not in actions for agent in self.agents):
            raise ValueError(self._who_is_missing(actions))
        for joint, agent in enumerate(self.agents):
            self._turns[0, joint] = self._turn_of(agent, actions[agent])
        simulator, agents = self.simulator, self.agents
        simulator.step(self._turns)
        observations = self._observations()
        terminated, truncated = bool(simulator.terminated[0]), bool(simulator.truncated[0])
        if terminated or truncated:
            self.agents = []
        if self.render_mode == "human":
            self.render()
        return (
            observations,
            dict.fromkeys(agents, float(simulator.rewards[0])),
            dict.fromkeys(agents, terminated),
            dict.fromkeys(agents, truncated),
            {agent: {} for agent in agents},
        )

    def _who_is_missing(self, actions: Mapping[str, Any]) -> str:
        for agent in self.agents:
            if agent not in actions:
                return f"no action for {agent}; every agent in env.agents needs one: {self.agents}"
        stranger = next(name for name in actions if name not in self.agents)
        return f"an action for {stranger!r}, who is not playing; env.agents is {self.agents}"

    def _turn_of(self, agent: str, action: Any) -> float:
        name = f"the action of {agent}"
        if self.task.discrete_actions:
            rule = "0 (back), 1 (stay) or 2 (forth)"
            chosen = as_array(name, action, "iu", rule)
            if chosen.shape != () or not 0 <= chosen <= 2:
                raise ValueError(f"{name}={action!r}; {rule}")
            return float(chosen) - 1.0
        rule = "an array of one float in [-1, 1]"
        turns = as_array(name, action, "fiu", rule)
        turn = float(turns[0]) if turns.shape == (1,) else math.nan
        if not abs(turn) <= 1.0 + ROUNDING:
            raise ValueError(f"{name}={action!r}; {rule}: clip it, or scale it")
        return turn

    def _observations(self) -> dict[str, NDArray[np.float32]]:
        seen = self._observed.copy()
        seen[:, : self._seen] = self.simulator.observe(self.observation)
        return dict(zip(self.agents, seen, strict=True))

    def state(self) -> NDArray[np.float32]:
        """[joints + 4] float32: the angles, x and y of the target, steps held, steps made."""
        simulator = self.simulator
        counts = (simulator.held, simulator.steps)
        return np.concatenate([simulator.angles[0], simulator.targets[0], *counts]).astype(
            np.float32
        )

    def render(self) -> str | NDArray[np.uint8] | None:
        """A text ("ansi"), a picture [height, width, 3] uint8 ("rgb_array"), or a window."""
        if self.render_mode == "human" and self._window is None:
            self._window = Window()
        return render_arm(self.simulator, self.render_mode, self._window)

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._window is not None:
            self._window.close()
            self._window = None
