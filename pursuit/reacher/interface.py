"""Arms as the environments use them: one agent for all joints, or one for each."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.spaces import Box, Discrete, MultiDiscrete
from numpy.typing import ArrayLike, NDArray

from pursuit.environments.interface import GameInterface, checked_actions
from pursuit.environments.types import Options, Space
from pursuit.reacher.observations import space_of
from pursuit.reacher.rendering import ArmScene, scene_of
from pursuit.reacher.rules import ROUNDING
from pursuit.reacher.simulator import ReacherSimulator
from pursuit.rules.arrays import Array
from pursuit.validation import as_array, check_bool, reset_options


class ArmInterface(GameInterface):
    """A batch of arms with one agent for all joints.

    Args:
        simulator: a simulator with `auto_restart=False`.
        observation: one of `pursuit.reacher.observations.ENCODINGS`.

    Raises:
        ValueError: an unknown observation.
    """

    simulator: ReacherSimulator
    render_fps = 20

    def __init__(
        self, simulator: ReacherSimulator, observation: str, agents: Sequence[str] | None = None
    ) -> None:
        super().__init__(simulator, agents)
        self.task, self.observation = simulator.task, observation
        self._space = space_of(self.task, observation)

    def observation_space(self, seat: int) -> Space:
        """That of the encoding."""
        return self._space

    def action_space(self, seat: int) -> Space:
        """Box(-1, 1, [joints]), or MultiDiscrete with 3 actions per joint."""
        if self.task.discrete_actions:
            return MultiDiscrete([3] * self.task.joints)
        return Box(-1.0, 1.0, (self.task.joints,), np.float32)

    def start(self, seed: int | None, options: Options, games: ArrayLike | None = None) -> None:
        """Start new episodes; the options are "angles" and "target"."""
        given = reset_options(options, ("angles", "target"))
        if given:
            self.simulator.place(given["angles"], given["target"], seed, games)
        else:
            self.simulator.reset(seed, games)

    def _turns(self, actions: ArrayLike, shape: tuple[int, ...]) -> Array:
        if not self.task.discrete_actions:
            return checked_actions(actions, "fiu", shape, "floats in [-1, 1]", None)
        rule = "integers 0 (back), 1 (stay) and 2 (forward)"
        return checked_actions(actions, "iu", shape, rule, (0, 2)) - 1.0

    def check_action(self, seat: int, action: Any) -> Any:
        """[joints] the turns; the simulator refuses numbers out of range."""
        return self._turns(action, (self.task.joints,))

    def check_actions(self, seat: int, actions: ArrayLike, over: NDArray[np.bool_]) -> Array:
        """[num_games, joints] the turns; the simulator refuses numbers out of range."""
        return self._turns(actions, (self.simulator.num_games, self.task.joints))

    def step(self, seat: int, actions: Array) -> None:
        """As `GameInterface.step`."""
        try:
            self.simulator.step(np.reshape(actions, (self.simulator.num_games, -1)))
        except ValueError as error:  # the shape is valid, so a number is out of range
            raise ValueError(
                f"{error}, as gymnasium.wrappers.ClipAction and RescaleAction do"
            ) from None

    def observe(self, seat: int) -> NDArray[np.float32]:
        """The encoding of the arms."""
        return self.simulator.observe(self.observation)

    def scene(self, game: int) -> ArmScene:
        """The arm and its target."""
        return scene_of(self.simulator, game)


class JointInterface(ArmInterface):
    """One arm with an agent for each joint: "joint_0" at the base, "joint_1", ...

    Args:
        simulator, observation: as of `ArmInterface`.
        own_number: whether observations include the one-hot vector of the own joint.
    """

    def __init__(self, simulator: ReacherSimulator, observation: str, own_number: bool) -> None:
        joints = simulator.task.joints
        super().__init__(simulator, observation, [f"joint_{joint}" for joint in range(joints)])
        own = joints if check_bool("own_number", own_number) else 0
        self._own = np.eye(joints, own, dtype=np.float32)
        self.actions = np.zeros((1, joints))

    def observation_space(self, seat: int) -> Space:
        """That of the encoding, and the number of the joint."""
        seen, own = self._space, np.ones(self._own.shape[1], dtype=np.float32)
        low, high = np.concatenate([seen.low, 0 * own]), np.concatenate([seen.high, own])
        return Box(low, high, dtype=np.float32)

    def action_space(self, seat: int) -> Space:
        """Box(-1, 1, [1]), or `Discrete` with 3 actions."""
        return Discrete(3) if self.task.discrete_actions else Box(-1.0, 1.0, (1,), np.float32)

    def check_action(self, seat: int, action: Any) -> float:
        """The turn of a joint."""
        name = f"the action of {self.agents[seat]}"
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

    def observe(self, seat: int) -> NDArray[np.float32]:
        """[1, numbers] what a joint observes."""
        return np.hstack([self.simulator.observe(self.observation), self._own[seat : seat + 1]])

    def observe_all(self) -> Array:
        """As `observe`, for all joints at once."""
        seen = self.simulator.observe(self.observation)
        return np.hstack([seen.repeat(len(self._own), axis=0), self._own])

    @property
    def state_space(self) -> Space:
        """See `state`."""
        task, joints = self.task, self.task.joints
        far = joints + task.tolerance
        most = np.array([np.pi] * joints + [far, far, task.max_steps, task.max_steps], np.float32)
        least = np.where(np.arange(len(most)) < joints + 2, -most, 0.0).astype(np.float32)
        return Box(least, most, dtype=np.float32)

    def state(self) -> NDArray[np.float32]:
        """[joints + 4] float32: angles, x and y of the target, steps held, steps."""
        simulator = self.simulator
        counts = (simulator.held, simulator.steps)
        return np.concatenate([simulator.angles[0], simulator.targets[0], *counts]).astype(
            np.float32
        )
