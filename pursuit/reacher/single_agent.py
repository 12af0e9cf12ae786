"""Gymnasium environments of the arm with one agent for all joints, single and vectorised."""

from __future__ import annotations

from copy import deepcopy
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import ArrayLike, NDArray

from pursuit.environments.single_env import SingleEnv, checked_actions
from pursuit.environments.types import Options, Single, Space, Vector
from pursuit.environments.vector import LockstepVectorEnv
from pursuit.reacher.observations import ENCODINGS, space_of
from pursuit.reacher.rendering import ArmScene, scene_of
from pursuit.reacher.simulator import ReacherSimulator
from pursuit.reacher.task import ReacherTask, make_reacher_task
from pursuit.rendering.windows import metadata_of
from pursuit.rules.arrays import Array
from pursuit.validation import one_of, reset_options, whole

RENDER_FPS = 20


def action_space_of(task: ReacherTask) -> Space:
    """Box(-1, 1, [joints]), or MultiDiscrete with 3 actions per joint."""
    if task.discrete_actions:
        return gymnasium.spaces.MultiDiscrete([3] * task.joints)
    return gymnasium.spaces.Box(-1.0, 1.0, (task.joints,), np.float32)


class ArmGames:
    """Starts and scenes of arms, for all kinds of environments."""

    simulator: ReacherSimulator

    def _begin(
        self, seed: int | None, options: Options, games: NDArray[np.bool_] | None = None
    ) -> None:
        given = reset_options(options, ("angles", "target"))
        if given:
            self.simulator.place(given["angles"], given["target"], seed, games)
        else:
            self.simulator.reset(seed, games)

    def _scene(self, game: int = 0) -> ArmScene:
        return scene_of(self.simulator, game)


class ArmsOfEnv(ArmGames):
    """A batch of arms: the methods that `SingleEnv` and `LockstepVectorEnv` need."""

    observation: str
    action_space: Space

    def _checked(self, actions: ArrayLike) -> Array:
        shape = self.action_space.shape or ()
        if not self.simulator.task.discrete_actions:
            return checked_actions(actions, "fiu", shape, "floats in [-1, 1]", None)
        rule = "integers 0 (back), 1 (stay) and 2 (forward)"
        return checked_actions(actions, "iu", shape, rule, (0, 2)) - 1.0

    def _advance(self, actions: Array | int) -> tuple[Array, NDArray[np.bool_], NDArray[np.bool_]]:
        simulator = self.simulator
        try:
            simulator.step(np.reshape(actions, (simulator.num_games, -1)))
        except ValueError as error:  # the shape is valid, so a number is out of range
            raise ValueError(
                f"{error}, as gymnasium.wrappers.ClipAction and RescaleAction do"
            ) from None
        return simulator.rewards, simulator.terminated, simulator.truncated

    def _observe(self) -> NDArray[np.float32]:
        return self.simulator.observe(self.observation)

    def _returns(self) -> NDArray[np.float64]:
        return self.simulator.returns


# skrl looks for Gymnasium's class among the direct bases only.
class ReacherEnv(ArmsOfEnv, SingleEnv, Single):
    """One arm as a Gymnasium environment.

    The action is [joints] float32 in [-1, 1], the turn of each joint in units of `max_turn`; with
    `discrete_actions` [joints] integers: 0 back, 1 stay, 2 forward. Actions out of range raise an
    error; see `gymnasium.wrappers.ClipAction` and `RescaleAction`. The info of the last step holds
    "episode_return" and "episode_length".

    Args:
        task: the task.
        observation: one of `pursuit.reacher.observations.ENCODINGS`.
        render_mode: None, "ansi", "rgb_array" or "human".

    Raises:
        ValueError: an unknown observation or render mode.
    """

    simulator: ReacherSimulator
    task: ReacherTask

    def __init__(
        self, task: ReacherTask, observation: str = "positions", render_mode: str | None = None
    ) -> None:
        self.observation = one_of("observation", observation, ENCODINGS)
        self._render_as(render_mode, RENDER_FPS)
        # A copy, as spaces hold the random state of their samples.
        seen = deepcopy(space_of(task, observation))
        super().__init__(ReacherSimulator(task, auto_restart=False), seen, action_space_of(task))


class ReacherVectorEnv(ArmsOfEnv, LockstepVectorEnv, Vector):
    """Many arms as a Gymnasium vector environment over a `ReacherSimulator`.

    For restarts and infos see `pursuit.environments.vector`. Actions are [num_envs, joints], as for
    `ReacherEnv`.

    Args:
        task: the task.
        num_envs: number of arms in the batch.
        observation: one of `pursuit.reacher.observations.ENCODINGS`.
        render_mode: None, "ansi" or "rgb_array".
        seed: seed of the first reset, if `reset` gets none.
        autoreset_mode: one of `gymnasium.vector.AutoresetMode`, or its name.

    Raises:
        ValueError: an unknown observation or mode, or an invalid number of arms.
    """

    simulator: ReacherSimulator
    task: ReacherTask

    def __init__(
        self,
        task: ReacherTask,
        num_envs: int = 1,
        observation: str = "positions",
        render_mode: str | None = None,
        seed: int | None = None,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
    ) -> None:
        num_envs = whole("num_envs", num_envs, 1, 2**63 - 1)
        self.observation = one_of("observation", observation, ENCODINGS)
        simulator = ReacherSimulator(task, num_envs, auto_restart=False)
        seen, actions = deepcopy(space_of(task, observation)), action_space_of(task)
        super().__init__(simulator, seen, actions, render_mode, RENDER_FPS, seed, autoreset_mode)


def reacher_env(
    observation: str = "positions", render_mode: str | None = None, **settings: Any
) -> ReacherEnv:
    """`pursuit/Reacher-v0`: move the tip of an arm to a target; settings of `ReacherTask`."""
    return ReacherEnv(make_reacher_task(**settings), observation, render_mode)


# `gymnasium.make` reads there which render modes need a wrapper of its own.
reacher_env.metadata = metadata_of(RENDER_FPS)  # type: ignore[attr-defined]


def reacher_vector_env(
    num_envs: int = 1,
    observation: str = "positions",
    render_mode: str | None = None,
    seed: int | None = None,
    autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
    max_episode_steps: int | None = None,
    **settings: Any,
) -> ReacherVectorEnv:
    """`pursuit/Reacher-v0`, vectorised over the `ReacherSimulator`.

    Args:
        max_episode_steps: truncates earlier than the task, as a TimeLimit; -1 for no limit.
    """
    task = make_reacher_task(**settings)
    envs = ReacherVectorEnv(task, num_envs, observation, render_mode, seed, autoreset_mode)
    envs.limit_episodes(max_episode_steps)
    return envs
