"""Simulation of games to their end, and exact solutions of duels by the rules of a task."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import lcm
from typing import Any, TypeVar, cast

import numpy as np

from pursuit.mazes.maze import Maze
from pursuit.reacher.simulator import ReacherSimulator
from pursuit.rules.arrays import Array, Flags, Longs, Reals
from pursuit.rules.layout import ESCAPED
from pursuit.simulator.policy import Policy, TabularPolicy
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task
from scripted_agents import (
    BestResponse,
    PairValues,
    best_response,
    evaluate_exactly,
    mean_over_starts,
    table_of,
)
from scripted_agents.exact.duel.best_response import MoveOrder
from scripted_agents.exact.hidden.game import Role

Lengths = Longs | Reals
"""[episodes], played or expected."""
GamesT = TypeVar("GamesT", Simulator, ReacherSimulator)


def play_out(
    games: GamesT,
    step: Callable[[], None],
    over: Callable[[GamesT], Flags],
    won: Callable[[GamesT], Flags],
) -> tuple[Longs, Flags]:
    """Play every game until it is over: lengths [games], and whether it was won [games].

    Lengths count rounds, which in turns are two steps.

    Args:
        games: games at their starts, made with `auto_restart=False`.
        step: plays one step of all of them.
        over: [games] whether a game is over; called after every step.
        won: [games] whether a game is won; called after the step that ends it.
    """
    most, each = games.task.max_steps, games.task.steps_per_round
    lengths = np.full(games.num_games, most, dtype=np.int64)
    running, victories = np.ones(len(lengths), dtype=bool), np.zeros(len(lengths), dtype=bool)
    for number in range(1, most * each + 1):
        step()
        ended = running & over(games)
        if ended.any():
            lengths[ended] = -(-number // each)
            victories[ended] = won(games)[ended]
            running &= ~ended
            if not running.any():
                break
    return lengths, victories


def stepper(
    simulator: Any, policies: Sequence[Any], actions: Array | None = None
) -> Callable[[], None]:
    """A function that plays one step of all games by the agents' policies.

    The actions are in `actions` [games, agents] int32 after every step, if it is given.
    """
    if actions is None:
        actions = np.zeros((simulator.num_games, simulator.task.num_agents), dtype=np.int32)

    def step() -> None:
        simulator.act(policies, actions)
        simulator.step(actions)

    return step


def evader_indices(task: Task) -> slice:
    """The indices of the evaders."""
    return slice(task.num_chasers, task.num_chasers + task.num_evaders)


def escapes_now(simulator: Simulator) -> Flags:
    """[games, evaders] bool: the evaders that escaped in the last step."""
    return np.asarray((simulator.events[:, evader_indices(simulator.task)] & ESCAPED) != 0)


class Escapes:
    """The evaders that have escaped, in games that are played from their starts to their ends.

    Attributes:
        seen: [games, evaders] bool.
    """

    def __init__(self, simulator: Simulator) -> None:
        self.simulator = simulator
        self.seen = np.zeros((simulator.num_games, simulator.task.num_evaders), dtype=bool)

    def after(self, step: Callable[[], None]) -> Callable[[], None]:
        """The same step, noting the evaders that escape in it."""
        if not self.simulator.task.most_exits:
            return step

        def noted() -> None:
            step()
            self.seen |= escapes_now(self.simulator)

        return noted

    @property
    def captured(self) -> Flags:
        """[games, evaders] bool: the evaders that have been captured."""
        gone = self.simulator.active[:, evader_indices(self.simulator.task)] == 0
        return np.asarray(gone & ~self.seen)


def all_caught(simulator: Simulator, escaped: Flags | None = None) -> Flags:
    """[games] bool: no evader is left, and none has escaped (None: in the last step)."""
    task = simulator.task
    gone = np.asarray((simulator.active[:, evader_indices(task)] == 0).all(axis=1))
    if not task.most_exits:
        return gone
    escaped = escapes_now(simulator) if escaped is None else escaped
    return np.asarray(gone & ~escaped.any(axis=1))


def won_by(simulator: Simulator, seat: int, escaped: Flags | None = None) -> Flags:
    """[num_games] bool: whether the agent with index `seat` has won, in games that have just ended.

    Chasers win if all evaders are captured. Evaders win if they escape; in games without exits if
    they are not captured and no goal is left, if there are goals. A single runner wins if no goal
    is left. If several agents collect goals, a runner wins if it has more than each of the others
    (a draw has no winner).

    Args:
        simulator: the games.
        seat: the index of the agent.
        escaped: [games, evaders] of `Escapes`; None for the escapes of the last step, which are
            enough for an evader, and for the chasers of one evader.
    """
    task = simulator.task
    role, own = task.seat_roles[seat], simulator.active[:, seat] != 0
    if role == "runner" and task.num_runners + task.num_evaders > 1:
        # Compared as whole numbers of their smallest part, as sums of thirds are rounded. With more
        # than 28 collectors this part is too small for float64.
        collectors = min(task.num_runners + task.num_evaders, 28)
        parts = np.rint(simulator.collected * lcm(*range(1, collectors + 1)))
        return np.asarray(parts[:, seat] > np.delete(parts, seat, axis=1).max(axis=1))
    if role == "chaser" and task.num_evaders:
        return all_caught(simulator, escaped)
    if role == "evader" and task.most_exits:
        escaped = escapes_now(simulator) if escaped is None else escaped
        return np.asarray(escaped[:, seat - task.num_chasers])
    if role == "evader" and not task.num_goals:
        return own
    return np.asarray(simulator.terminated & own)


USUAL_WORK = 2000
"""Agent steps of an episode, up to which evaluations have their full number of episodes."""


def usual_episodes(task: Any, most: int) -> int:
    """The number of episodes of an evaluation: `most`, down to a tenth of it in games with many
    steps and agents, where it would take longer than the training."""
    share = USUAL_WORK / (task.max_steps * task.num_agents)
    return max(min(most, round(most * share)), most // 10, 2)


def half_width(lengths: Lengths) -> float:
    """Half the width of the 95 % confidence interval of the mean; 0 for a single length."""
    return 1.96 * float(lengths.std(ddof=1)) / len(lengths) ** 0.5 if len(lengths) > 1 else 0.0


def order_of(task: Task) -> MoveOrder:
    """The order of moves of a task, by the type of the solvers."""
    return cast(MoveOrder, task.move_order)


def duel_role(role: str) -> Role:
    """A role by the type of the solvers; a "runner" is solved as a chaser of its goal."""
    return "evader" if role == "evader" else "chaser"


def table_in(task: Task, policy: Policy | None, maze: Maze | None = None) -> Reals:
    """[self cell, other cell, action] of a policy in a maze, by default the first of the task;
    requires `is_solved_duel`."""
    assert isinstance(policy, TabularPolicy)
    return table_of(policy, maze or task.mazes[0], task.stay_action, task.move_order)


def best_reply(
    task: Task,
    role: str,
    table: Reals,
    horizon: int | None,
    discount: float = 1.0,
    maze: Maze | None = None,
    mask_bumps: bool = False,
) -> BestResponse:
    """The exact best response of a role to the table of an opponent, by the rules of a duel.

    Args:
        task: the rules.
        role: as of `duel_role`.
        table: of the opponent, [its cell, other cell, action].
        horizon, discount: as in `best_response`.
        maze: the first of the task if left out.
        mask_bumps: whether moves into walls are forbidden.
    """
    rules = (horizon, discount, task.stay_action, order_of(task), mask_bumps)
    return best_response(duel_role(role), maze or task.mazes[0], table, *rules)


def values_between(
    task: Task,
    role: str,
    tables: tuple[Reals, Reals],
    horizon: int | None,
    discount: float = 1.0,
    maze: Maze | None = None,
) -> PairValues:
    """Expected steps from every pair of cells, by the tables of a role and of its opponent.

    Arguments are those of `best_reply`.
    """
    chaser, evader = tables[::-1] if role == "evader" else tables
    maze = maze or task.mazes[0]
    return evaluate_exactly(maze, chaser, evader, horizon, discount, order_of(task))


def steps_and_ended(
    task: Task, role: str, tables: tuple[Reals, Reals], maze: Maze | None = None
) -> tuple[Reals, Reals]:
    """Expected steps, and probability of a capture within the time limit, from every pair of cells.

    Both are [chaser cell, evader cell]. Arguments are those of `best_reply`.
    """
    steps, longer = (
        values_between(task, role, tables, horizon, maze=maze).values
        for horizon in (task.max_steps, task.max_steps + 1)
    )
    # One more step adds P(no capture before it) to the expected length.
    return steps, 1.0 - (longer - steps)


def mean_steps(
    task: Task, role: str, tables: tuple[Reals, Reals], horizon: int | None, discount: float = 1.0
) -> float:
    """The mean of `values_between` over the starts of a task."""
    values = values_between(task, role, tables, horizon, discount)
    return mean_over_starts(values, task.mazes[0], task.min_start_distance)


def other_role(role: str) -> str:
    """ "evader" for "chaser", else "chaser"."""
    return "evader" if role == "chaser" else "chaser"
