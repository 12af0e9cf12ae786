"""A learned policy that chooses the actions of all agents of a role together."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.rules.layout import Games
from pursuit.simulator.policy import GameView
from pursuit.tasks.task import Task
from scripted_agents.agents.table_kernels import draw_together
from train.networks.recurrent_policy import chosen_from


class JointPolicy:
    """A team as one player: a distribution over joint actions, of which each agent plays its part.

    The agents draw together: all find the same random number (`draw_together`).

    Args:
        joint: a `LearnedPolicy` of joint actions, in which the last agent counts fastest.

    Attributes:
        network, seat, greedy, task, agent, encoding: of `joint`.
    """

    def __init__(self, joint: Any) -> None:
        self.joint, self.network = joint, joint.network
        self.seat, self.greedy = joint.seat, joint.greedy
        self.task, self.agent, self.encoding = joint.task, joint.agent, joint.encoding

    def joint_distribution(self, task: Task, games: Games) -> NDArray[np.float64]:
        """[games, joint actions] float64; ValueError as `LearnedPolicy.distribution`."""
        return self.joint.distribution(task, games, task.seat(self.agent))

    def distribution(self, task: Task, games: Games, seat: int) -> NDArray[np.float64]:
        """[games, actions] float64: what one agent plays; ValueError as `joint_distribution`."""
        count = task.count(self.agent)
        whole = self.joint_distribution(task, games).reshape(-1, *(task.num_actions,) * count)
        own = 1 + seat - task.seat(self.agent)
        return whole.sum(axis=tuple(axis for axis in range(1, count + 1) if axis != own))

    def act(self, view: GameView) -> NDArray[np.int32]:
        """[num_games] int32: the part of the agent of the view in the joint actions."""
        task, draws, first = view.task, None, view.task.seat(self.agent)
        if not self.greedy:
            draws = np.empty(view.num_games)
            draw_together(view.streams, task.num_agents, view.steps, first, draws)
        chosen = chosen_from(self.joint.probabilities_in(task, view.games, first), draws)
        return member_actions(chosen, task, self.agent)[:, view.seat - first]


def member_actions(joint: NDArray[Any], task: Task, role: str) -> NDArray[np.int32]:
    """[games, agents] int32: the actions of all agents of a role in joint actions [games]."""
    powers = task.num_actions ** np.arange(task.count(role))[::-1]
    return (joint[:, None] // powers % task.num_actions).astype(np.int32)
