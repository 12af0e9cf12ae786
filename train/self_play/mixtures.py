"""Exploitability of mixtures of snapshots.

Fictitious play and double oracle converge in a mixture of past policies, not in the last policy. A
mixture draws one snapshot per game, which the opponent does not observe. Its exploitability is
bounded from above by responses that know the snapshot, and from below by responses that do not.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.simulator.policy import Policy
from pursuit.tasks.task import Task
from scripted_agents import PairValues, mean_over_starts, solve_chase
from scripted_agents.games.simulator import GameTask
from scripted_agents.games.solve import SmallEquilibrium, equilibrium, respond, returns_of
from scripted_agents.references import is_table_duel
from train.evaluation.games import best_reply, order_of, other_role, table_in, values_between
from train.files import Plain
from train.networks.recurrent_policy import without_improbable
from train.self_play.diversity import diversity_of
from train.self_play.pool import Member
from train.self_play.side import Side, usual_least
from train.settings.self_play import NASH_SAMPLING

RESPONSES = 8
"""Best responses to single snapshots that are played against a whole mixture; each takes an exact
evaluation for every snapshot."""
MIXED = ("uniform", *NASH_SAMPLING)
"""Sampling rules that play a mixture of snapshots: all equally likely, or the Nash mixture; with
others the last policies are played."""
MOST_MIXED = 50_000
"""Joint actions of a small game up to which bounds of mixtures are computed: minutes at most."""
Table = NDArray[np.float64]


def mixture_bounds(
    task: Task | GameTask, role: str, tables: Table, shares: NDArray[np.float64], discount: float
) -> tuple[float, float]:
    """Bounds of the exploitability of a mixture that draws one table per game.

    Upper: the opponent knows the table. Lower: the best single response, among those to their
    average in every state and to `RESPONSES` of the tables, the most probable ones.

    Args:
        task: a duel in one maze, or a zero-sum small game of two.
        role: of the mixture.
        tables: [n, own cell, other cell, action] action probabilities; in a small game [n, pairs]
            of a state and an action, as of `SmallGame.table`.
        shares: [n] probabilities of the tables.
        discount: of the exact game; 1 in a small game with its time limit.

    Returns:
        Lower and upper bound of the mean over all starts, in discounted steps (of duels, in
        distinct cells) or returns.
    """
    if isinstance(task, GameTask):
        reply, gain = _replies_in_game(task, role, discount)
    else:
        reply, gain = _replies_in_duel(task, role, discount)
    each = [reply(table) for table in tables]
    upper = float(shares @ [gained for _, gained in each])
    average, _ = reply(np.tensordot(shares, tables, axes=1))
    likely = np.argsort(-shares, kind="stable")[:: max(len(shares) // RESPONSES, 1)]
    responses = [each[number][0] for number in likely] + [average]
    gains = [float(shares @ [gain(table, one) for table in tables]) for one in responses]
    lower = max(0.0, *gains)  # exploitability is never negative
    return lower, max(lower, upper)


Reply = Callable[[Table], tuple[Table, float]]
"""The best response to a table, and what it gains over the value of the game."""
Gain = Callable[[Table, Table], float]
"""What a response to a table gains over the value of the game."""


def _replies_in_duel(task: Task, role: str, discount: float) -> tuple[Reply, Gain]:
    maze, sign, other = task.mazes[0], 1.0 if role == "chaser" else -1.0, other_role(role)
    game = solve_chase(maze, discount, task.stay_action, None, order_of(task))
    value = mean_over_starts(game.values, maze)

    def gained(values: Table | PairValues) -> float:
        return sign * (mean_over_starts(values, maze) - value)

    def reply(table: Table) -> tuple[Table, float]:
        best = best_reply(task, other, table, None, discount)
        return best.policy, gained(best.values)

    def gain(table: Table, response: Table) -> float:
        return gained(values_between(task, role, (table, response), None, discount))

    return reply, gain


def _replies_in_game(task: GameTask, role: str, discount: float) -> tuple[Reply, Gain]:
    game, horizon = task.game, task.horizon(discount)
    other = next(name for name in game.players if name != role)
    seat, value = game.player(other), value_in(task, discount)
    value = value if seat == 0 else -value

    def reply(table: Table) -> tuple[Table, float]:
        best = respond(game, other, {role: table}, discount, horizon)
        return best.policies[other], best.mean_over_starts - value

    def gain(table: Table, response: Table) -> float:
        found = returns_of(game, {role: table, other: response}, discount, horizon)
        return float(game.start @ found[:, seat]) - value

    return reply, gain


def _table_of(task: Task | GameTask, policy: Any, least: float) -> Table:
    """The table of a policy, without actions of a probability below `least`."""
    if isinstance(task, GameTask):
        return task.flat(policy.agent, without_improbable(policy.state_probabilities(), least))
    return without_improbable(table_in(task, policy), least)


def value_in(task: GameTask, discount: float) -> float:
    """The value of a zero-sum small game for the first player."""
    return solved(task, discount).mean_over_starts


@lru_cache(maxsize=4)
def solved(task: GameTask, discount: float) -> SmallEquilibrium:
    """The equilibrium of a zero-sum small game, computed once."""
    return equilibrium(task.game, discount, task.horizon(discount))


def mixture_nash_conv(
    task: Task | GameTask,
    discount: float,
    kept: Mapping[str, Sequence[Member]],
    mixtures: Mapping[str, Mapping[str, float]] | None,
    min_probability: float = 0.0,
) -> tuple[float, float] | None:
    """Bounds of NashConv of mixtures of the snapshots in the pools.

    Args:
        task: a game in a maze, or a zero-sum small game of two.
        discount: of the exact game.
        kept: the snapshots of each role.
        mixtures: shares of the snapshots by role and name; None for equal shares.
        min_probability: snapshots do not play actions below it, as the policies that are evaluated.

    Returns:
        None if a role does not learn or has no snapshot, if a snapshot is no table, or if a mixture
        has other policies than snapshots.
    """
    game = task.game if isinstance(task, GameTask) else None
    able = game is None or (game.zero_sum and len(game.choices) <= MOST_MIXED)
    if len(kept) < 2 or not all(kept.values()) or not able:
        return None
    bounds = []
    for role, members in kept.items():
        equal = {member.name: 1.0 / len(members) for member in members}
        by_name = equal if mixtures is None else mixtures.get(role, {})
        shares = np.array([by_name.get(member.name, 0.0) for member in members])
        policies = [member.policy_once() for member in members]
        tabular = isinstance(task, GameTask) or is_table_duel(task, *policies)
        if shares.sum() < 1.0 - 1e-6 or not tabular:
            return None
        tables = np.stack([_table_of(task, policy, min_probability) for policy in policies])
        drawn = shares > 0.0
        drawn_shares = shares[drawn] / shares.sum()
        bounds.append(mixture_bounds(task, role, tables[drawn], drawn_shares, discount))
    lower, upper = (sum(ends) for ends in zip(*bounds, strict=True))
    return lower, upper


def nash_convs_of(
    sides: Mapping[str, Side], nash_conv: Callable[[dict[str, Policy]], float]
) -> dict[str, float]:
    """NashConv of the learned sides with their last and with their averaged weights, also without
    the actions below `usual_least`: "last", "average", "last_likely" and "average_likely".

    Args:
        sides: those that learn.
        nash_conv: of policies of these.
    """
    found = {}
    for name, average in (("last", False), ("average", True)):
        for suffix, share in (("", 0.0), ("_likely", 1.0)):
            policies = {}
            for role, side in sides.items():
                least = share * usual_least(side.parts.seat.num_actions)
                policies[role] = side.policy_with(average, least)
            found[name + suffix] = nash_conv(policies)
    return found


def snapshot_results(
    task: Task | GameTask,
    sampling: str,
    discount: float,
    kept: Mapping[str, Sequence[Member]],
    mixtures: Mapping[str, Mapping[str, float]] | None,
    min_probability: float,
) -> Plain:
    """ "diversity" of the snapshots in the pools, but in small games, and "mixture_nash_conv" where
    it is known.

    Arguments as in `mixture_nash_conv`, and the sampling rule; `mixtures` are the Nash mixtures of
    the run, if it has any.
    """
    results: Plain = {}
    if sampling in MIXED:
        shares = mixtures if sampling in NASH_SAMPLING else None
        bounds = mixture_nash_conv(task, discount, kept, shares, min_probability)
        results |= {} if bounds is None else {"mixture_nash_conv": bounds}
    if isinstance(task, GameTask):
        return results
    return {**results, "diversity": diversity_of(task, discount, kept)}
