"""The results of exact solvers, which have one form: of best responses, equilibria and NashConv.

Teams, whole games, small games (`games`) and zero-sum duels have the classes of this file. The best
response of a duel, `duel.best_response.BestResponse`, has the same attributes and stores tables.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.mazes.maze import Maze
from pursuit.rules.layout import Games
from pursuit.tasks.task import Task
from scripted_agents.exact.joint.policy import JointPlan, check_game
from scripted_agents.exact.joint.states import JointStates


@dataclass(frozen=True, eq=False, kw_only=True)
class SolvedGame:
    """A best response, or an equilibrium.

    Attributes:
        values: float64, by state: what is expected from it on.
        mean_over_starts: the mean of `values` over the starts of the game.
        policies: by agent, role or player, what attains the values.
    """

    values: NDArray[np.float64] = field(repr=False)
    mean_over_starts: float
    policies: dict[str, Any] = field(repr=False)


@dataclass(frozen=True, eq=False, kw_only=True)
class Equilibrium(SolvedGame):
    """An equilibrium of a zero-sum game of two players.

    Attributes:
        values, mean_over_starts, policies: as of `SolvedGame`, for the first player.
        mixed: of the shape of `values`, bool: whether the matrix game there has no pure saddle
            point, so that optimal play must be random.
    """

    mixed: NDArray[np.bool_] = field(repr=False)


@dataclass(frozen=True, eq=False, kw_only=True)
class JointResponse(SolvedGame):
    """The result of `solve_joint`, and with values by cells of `best_team_response`.

    Attributes:
        agents: the names of the responding agents, which act jointly.
        objective: "steps", "return" or "lead".
        states: of the game; `states.numbers(games)` returns those of games.
        values: [states] float64, expected steps from each state until the game is over (or no
            responding agent is free), the last included, or the sum of the responders' returns; up
            to the horizon. With a discount the step t = 0, 1, ... counts discount**t. 0 in states
            that cannot occur between steps. Of a team chase [chaser cell, ..., evader cell]: steps
            until capture, 0 if a chaser is on the evader.
        mean_over_starts: the mean of `values` over the starts that the task draws.
        policies: by agent, `policy`.
        reaches_values: whether the policy attains the values exactly; False if a plan for every
            step does not fit into MAX_PLAN_BYTES, so that the plan of the first step is used.
        horizon, discount: of the problem.
        optimal: [states, actions] bool, all optimal actions of the first step of a single responder
            (in turns of both halves of a round, with as many steps left); of those that keep the
            cell only one. None for several responders.
    """

    agents: tuple[str, ...]
    objective: str
    states: JointStates = field(repr=False)
    reaches_values: bool
    horizon: int | None
    discount: float
    optimal: NDArray[np.bool_] | None = field(repr=False)

    @property
    def policy(self) -> JointPlan:
        """A `Policy` for all of `agents`."""
        return self.policies[self.agents[0]]

    @property
    def role(self) -> str:
        """The role of the responders, if they are all of its agents; else their names."""
        task = self.states.task
        seats = [task.seat(agent) for agent in self.agents]
        role = task.seat_roles[seats[0]]
        every = [seat for seat, own in enumerate(task.seat_roles) if own == role]
        return role if seats == every else ", ".join(self.agents)

    def values_of(self, games: Games) -> NDArray[np.float64]:
        """[games] float64, the values of games of the task, such as `Simulator.games`; 0 for games
        that are over."""
        numbers = self.states.numbers(games)
        return np.where(numbers < 0, 0.0, self.values.ravel()[np.maximum(numbers, 0)])

    def optimal_actions(self, task: Task, games: Games, seat: int) -> NDArray[Any]:
        """[games, actions], above 0 for the actions of `optimal`, none in games that are over.

        Of several responders as one player those of the plan's first step, one for each: if they
        drew independently from the actions in all optimal joint actions, they would also play joint
        actions that are not optimal.

        Raises:
            ValueError: games of another task, or another seat.
        """
        check_game(self.policy, task, seat)
        if self.optimal is None:
            plan = JointPlan(self.states, self.policy.seats, self.policy.choices[:1])
            return plan.distribution(task, games, seat)
        numbers = self.states.numbers(games)
        return self.optimal[numbers] & (numbers >= 0)[:, None]


TeamResponse = JointResponse
"""The result of `best_team_response`."""


@dataclass(frozen=True, eq=False)
class JointValues:
    """The result of `evaluate_joint`, with discount and horizon as in `JointResponse`.

    Attributes:
        states: of the game.
        length: the mean over starts of the steps until the game is over.
        ended: the mean probability that it terminates within the horizon (discounted by its step).
        steps: by agent, the mean steps until it is captured or the game is over.
        returns: by agent, its mean return; empty with a custom reward function.
        values: [states] float64 of each of "length", "ended", "steps of NAME", "return of NAME".
    """

    states: JointStates = field(repr=False)
    length: float
    ended: float
    steps: dict[str, float]
    returns: dict[str, float]
    values: dict[str, NDArray[np.float64]] = field(repr=False)


@dataclass(frozen=True, eq=False, kw_only=True)
class ChaseSolution(Equilibrium):
    """The result of `solve_chase`; arrays are read-only, as solutions are cached.

    Attributes:
        maze: where it is played.
        values: [chaser cell, evader cell] float64 (with two chasers [chaser cell, chaser cell,
            evader cell], and so on): the value of the game, 0 if both are in one cell.
        mean_over_starts: the mean of `values` over all placements in different cells.
        policies: by role, `chaser_policy` and `evader_policy`.
        mixed: of the shape of `values`, bool: whether the matrix game there has no pure saddle
            point, so that optimal play must be random.
        discount: of each step; 1 with a horizon.
        horizon: the number of steps, or None. The policies are those of the first step.
        sweeps: of Shapley's iteration.
    """

    maze: Maze
    discount: float
    horizon: int | None
    stay_action: bool
    move_order: str
    num_chasers: int
    sweeps: int

    @property
    def chaser_policy(self) -> NDArray[np.float64]:
        """[self, other, action] float64, an optimal policy of the chaser. With several chasers
        [chaser cell, ..., evader cell, joint action], the joint action counting the last chaser's
        fastest."""
        return self.policies["chaser"]

    @property
    def evader_policy(self) -> NDArray[np.float64]:
        """[self, other, action] float64, an optimal policy of the evader; with several chasers
        [evader cell, chaser cell, ..., action]."""
        return self.policies["evader"]


@dataclass(frozen=True, eq=False, kw_only=True)
class JointGame(Equilibrium):
    """The result of `solve_joint_game`.

    Attributes:
        states: of the game.
        values: [states] float64, the discounted lead of the first agent from each state on, when
            both play an equilibrium; 0 in states that cannot be.
        mean_over_starts: the mean of `values` over the starts that the task draws.
        policies: by agent name, the policy in this equilibrium.
        mixed: [states] bool, whether no pure strategies are optimal.
        discount: of the game.
    """

    states: JointStates = field(repr=False)
    discount: float


@dataclass(frozen=True)
class JointNashConv:
    """NashConv of any game (`joint_nash_conv`, `games.nash_conv`), in returns or leads: means over
    the starts.

    Attributes:
        returns: by player, its return when all play the policies.
        best: by player, its best response return while the others play them.
    """

    returns: dict[str, float]
    best: dict[str, float]

    @property
    def gains(self) -> dict[str, float]:
        """By player, what it could gain, >= 0; 0 for all of them in a Nash equilibrium."""
        return {
            player: max(self.best[player] - achieved, 0.0)  # below 0: the error of the solver
            for player, achieved in self.returns.items()
        }

    @property
    def nash_conv(self) -> float:
        """The sum of the gains (Lanctot et al., 2017)."""
        return sum(self.gains.values())
