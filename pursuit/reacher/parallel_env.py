"""The arm as a PettingZoo parallel environment with one agent per joint."""

from __future__ import annotations

import math

import gymnasium
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pursuit.environments.parallel import SimulatorParallelEnv
from pursuit.environments.types import Actions, Space
from pursuit.reacher.observations import ENCODINGS, space_of
from pursuit.reacher.rules import ROUNDING
from pursuit.reacher.simulator import ReacherSimulator
from pursuit.reacher.single_agent import RENDER_FPS, ArmGames
from pursuit.reacher.task import ReacherTask
from pursuit.rules.arrays import Array
from pursuit.validation import as_array, check_bool, one_of


class ReacherParallelEnv(ArmGames, SimulatorParallelEnv):
    """One arm; each agent turns one joint: "joint_0" at the base, "joint_1", ...

    All agents receive the reward of the arm, and their episodes end together. An agent observes the
    whole arm (`pursuit.reacher.observations`), followed by a one-hot vector [joints] of its own
    joint, so that all agents can share one network.

    Actions are [1] float32 in [-1, 1], or, with `discrete_actions`, 0 (back), 1 (stay) or 2
    (forward). The infos are empty.

    Args:
        task: the task.
        observation: one of `pursuit.reacher.observations.ENCODINGS`.
        render_mode: None, "ansi", "rgb_array" or "human".
        own_number: whether observations include the one-hot vector of the own joint.

    Raises:
        ValueError: an unknown observation or render mode.

    Attributes:
        task, simulator: the task and its simulator.
        np_random: a generator for wrappers; seeded by `reset` and not used by the environment.
    """

    simulator: ReacherSimulator
    task: ReacherTask

    def __init__(
        self,
        task: ReacherTask,
        observation: str = "positions",
        render_mode: str | None = None,
        own_number: bool = True,
    ) -> None:
        self.observation = one_of("observation", observation, ENCODINGS)
        self._render_as(render_mode, RENDER_FPS, name="reacher_v0", is_parallelizable=True)
        self.own_number = check_bool("own_number", own_number)
        simulator = ReacherSimulator(task, auto_restart=False)
        seen, joints = space_of(task, observation), task.joints
        own = np.ones(joints if self.own_number else 0, dtype=np.float32)
        low, high = np.concatenate([seen.low, 0 * own]), np.concatenate([seen.high, own])
        action: Space = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float32)
        if task.discrete_actions:
            action = gymnasium.spaces.Discrete(3)
        far = joints + task.tolerance
        most = np.array([np.pi] * joints + [far, far, task.max_steps, task.max_steps], np.float32)
        least = np.where(np.arange(len(most)) < joints + 2, -most, 0.0).astype(np.float32)
        super().__init__(
            simulator,
            [f"joint_{joint}" for joint in range(joints)],
            gymnasium.spaces.Box(low, high, dtype=np.float32),
            action,
            gymnasium.spaces.Box(least, most, dtype=np.float32),
        )
        self._own = np.eye(joints, len(own), dtype=np.float32)
        self._turns = np.zeros((1, joints))

    def _move(self, actions: Actions) -> None:
        for joint, agent in enumerate(self.agents):
            self._turns[0, joint] = self._turn_of(agent, actions[agent])
        self.simulator.step(self._turns)

    def _turn_of(self, agent: str, action: ArrayLike) -> float:
        name = f"the action of {agent}"
        if self.task.discrete_actions:
            rule = "give 0 (back), 1 (stay) or 2 (forward)"
            chosen = as_array(name, action, "iu", rule)
            if chosen.shape != () or not 0 <= chosen <= 2:
                raise ValueError(f"{name}={action!r}; {rule}")
            return float(chosen) - 1.0
        rule = "give an array of one float in [-1, 1]"
        turns = as_array(name, action, "fiu", rule)
        turn = float(turns[0]) if turns.shape == (1,) else math.nan
        if not abs(turn) <= 1.0 + ROUNDING:
            raise ValueError(f"{name}={action!r}; {rule}: clip it, or scale it")
        return turn

    def _observe(self) -> Array:
        seen = self.simulator.observe(self.observation)
        return np.hstack([seen.repeat(len(self._own), axis=0), self._own])

    def state(self) -> NDArray[np.float32]:
        """[joints + 4] float32: angles, x and y of the target, steps held, steps."""
        simulator = self.simulator
        counts = (simulator.held, simulator.steps)
        return np.concatenate([simulator.angles[0], simulator.targets[0], *counts]).astype(
            np.float32
        )
