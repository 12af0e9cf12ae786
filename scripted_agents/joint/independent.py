"""What a team can do whose members draw on their own, between two proven numbers.

The equilibrium of `solve_chase` lets chasers draw their moves together. Agents that learn, each
with its own network, cannot: given what all of them see, they draw independently. Where optimal
play is random that may cost something, and the best they can do is no equilibrium of two players
any more (von Stengel and Koller, 1997: team-maxmin). But it lies between the value of the game of
the team as one player, and what any one policy of theirs is proven to hold.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.rules.layout import Games
from pursuit.simulator.policy import GameView
from pursuit.tasks.task import Task
from scripted_agents.joint.equilibrium import solve_chase
from scripted_agents.joint.optimal import OptimalChaser
from scripted_agents.joint.policy import drawn
from scripted_agents.joint.teams import best_team_response, mean_over_team_starts


@dataclass(frozen=True, eq=False)
class IndependentTeam:
    """What chasers can hold who see everything and draw on their own, in discounted steps.

    Attributes:
        lower: the value of the game for the team as one player: no team does better.
        upper: what the best evader gets from `policy`: they do so well at least.
        policy: of every chaser: its own part of the equilibrium of the team as one player.
    """

    lower: float
    upper: float
    policy: OwnPart = field(repr=False)


class OwnPart:
    """A chaser that plays its part of the team's equilibrium, whatever the others draw.

    Args:
        discount: of the game that is solved.
    """

    role = "chaser"

    def __init__(self, discount: float = 0.95) -> None:
        self._together = OptimalChaser(discount=discount)

    def __repr__(self) -> str:
        return f"{type(self).__name__}(discount={self._together.discount:g})"

    def act(self, view: GameView) -> NDArray[np.int32]:
        """[num_games] int32, an action for every game; random numbers from the seat's stream.

        Raises:
            ValueError: another role's seat, or a game that is not solved.
        """
        chances = self.distribution(view.task, view.games, view.seat)
        return drawn(view.uniform(), chances.cumsum(axis=1)).astype(np.int32)

    def distribution(self, task: Task, games: Games, seat: int) -> NDArray[np.float64]:
        """[games, actions] float64.

        Raises:
            ValueError: as `act`.
        """
        return self._together.distribution(task, games, seat)


def independent_team(task: Task, discount: float = 0.95) -> IndependentTeam:
    """Bounds of what chasers can hold who draw on their own, and a policy that holds the upper one.

    Of discounted steps until capture, mean over all starts in distinct cells. Where the game has
    pure saddle points alone, nothing is lost and both are the same.

    Args:
        task: a chase of one evader by two or more chasers in one maze, with random starts.
        discount: what a step counts in terms of the one before it, in (0, 1).

    Raises:
        ValueError: another task, a discount outside (0, 1), or a game that does not fit into
            memory.
    """
    if task.num_chasers < 2:
        raise ValueError(f"num_chasers={task.num_chasers}; a team has two or more")
    policy, order = OwnPart(discount), task.move_order
    # Answered first: it says which tasks are none of these.
    answer = best_team_response(task, "evader", {"chaser": policy}, None, discount)
    rest: Any = (discount, task.stay_action, None, order, task.num_chasers)
    game = solve_chase(task.mazes[0], *rest)
    lower = mean_over_team_starts(game.values, task, 1)
    return IndependentTeam(lower, max(lower, mean_over_team_starts(answer.values, task, 1)), policy)
