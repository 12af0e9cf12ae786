"""Gymnasium environments of the arm with one agent for all joints, single and vectorised."""

from __future__ import annotations

from typing import Any

from gymnasium.vector import AutoresetMode

from pursuit.environments.single_env import GameEnv
from pursuit.environments.types import Single, Vector
from pursuit.environments.vector import GameVectorEnv
from pursuit.reacher.interface import ArmInterface
from pursuit.reacher.simulator import ReacherSimulator
from pursuit.reacher.task import ReacherTask, make_reacher_task
from pursuit.rendering.windows import metadata_of
from pursuit.validation import whole

RENDER_FPS = ArmInterface.render_fps


# skrl looks for Gymnasium's class among the direct bases only.
class ReacherEnv(GameEnv, Single):
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
        arm = ArmInterface(ReacherSimulator(task, auto_restart=False), observation)
        super().__init__(arm, 0, {}, render_mode)
        self.observation = observation


class ReacherVectorEnv(GameVectorEnv, Vector):
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
        arms = ArmInterface(ReacherSimulator(task, num_envs, auto_restart=False), observation)
        super().__init__(arms, 0, {}, render_mode, seed, autoreset_mode)
        self.observation = observation


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
