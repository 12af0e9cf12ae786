"""The arm as a PettingZoo parallel environment with one agent per joint."""

from __future__ import annotations

from pursuit.environments.parallel import GameParallelEnv
from pursuit.reacher.interface import JointInterface
from pursuit.reacher.simulator import ReacherSimulator
from pursuit.reacher.task import ReacherTask


class ReacherParallelEnv(GameParallelEnv):
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
        own_number: whether observations end with the one-hot vector of the own joint.

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
        simulator = ReacherSimulator(task, auto_restart=False)
        super().__init__(JointInterface(simulator, observation, own_number), render_mode)
        self.observation, self.own_number = observation, own_number
