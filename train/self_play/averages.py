"""Exploitability of averages and mixtures of the snapshots of self-play.

In fictitious play and double oracle the mixture of past policies approaches an equilibrium, not
the last policy. A mixture draws one snapshot per game, which the opponent does not observe. Its
exploitability is bounded from above by responses that know the snapshot, and from below by
responses that do not. A policy averaged in every state is a table with exact exploitability.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.tasks.task import Task
from scripted_agents import PairValues, mean_over_starts, solve_chase
from train.evaluation.games import best_reply, is_exact, other_role, table_in, values_between
from train.networks.recurrent_policy import without_improbable
from train.self_play.pool import Member
from train.settings.self_play import ROLES

RESPONSES = 8
"""Best responses to single snapshots that are played against a whole mixture; each takes an exact
evaluation for every snapshot."""
Table = NDArray[np.float64]


@dataclass(frozen=True)
class Average:
    """The exploitability of one average, in discounted steps above the game's value.

    Attributes:
        role: of the policies.
        what: the last snapshot, or the kind of average.
        snapshots: their number.
        lower, upper: bounds of the mean exploitability over all starts in distinct cells; equal if
            it is exact.
    """

    role: str
    what: str
    snapshots: int
    lower: float
    upper: float


def averages(
    task: Task,
    discount: float,
    snapshots: Mapping[str, Mapping[str, Table]],
    mixtures: Mapping[str, Mapping[str, float]] | None = None,
) -> list[Average]:
    """The last snapshot of each side, averages of all and of the later half, and mixtures.

    Args:
        task: a duel in one maze.
        discount: of the exact game.
        snapshots: by role and name, the oldest first: [own cell, other cell, action] of each.
        mixtures: by role, shares of snapshots by their names: the Nash mixture of double oracle.
            Mixtures that include other policies than snapshots are skipped.
    """
    found = []
    for role, own in snapshots.items():
        tables, side = np.stack(list(own.values())), _Side(task, role, discount)
        found.append(Average(role, "last snapshot", 1, *2 * (side.best(tables[-1])[0],)))
        for which, part in (("all", tables), ("later half", tables[len(tables) // 2 :])):
            count = len(part)
            exact, even = side.best(part.mean(axis=0))[0], np.full(count, 1.0 / count)
            found.append(Average(role, f"{which} averaged", count, exact, exact))
            found.append(Average(role, f"{which} mixed", count, *side.mixture(part, even)))
        shares = np.array([(mixtures or {}).get(role, {}).get(name, 0.0) for name in own])
        if shares.sum() > 1.0 - 1e-6:
            some = shares > 0.0
            bounds = side.mixture(tables[some], shares[some] / shares.sum())
            found.append(Average(role, "Nash mixture", int(some.sum()), *bounds))
    return found


def nash_convs(found: Sequence[Average]) -> dict[str, tuple[float, float]]:
    """Bounds of NashConv, the sum over both sides, by kind of average."""
    by_role: list[dict[str, Average]] = [
        {one.what: one for one in found if one.role == role} for role in ROLES
    ]
    both = [what for what in by_role[0] if what in by_role[1]]
    return {
        what: (
            sum(sides[what].lower for sides in by_role),
            sum(sides[what].upper for sides in by_role),
        )
        for what in both
    }


def averages_of(
    task: Task,
    discount: float,
    kept: Mapping[str, Sequence[Member]],
    mixtures: Mapping[str, Mapping[str, float]],
    min_probability: float = 0.0,
) -> dict[str, tuple[float, float]]:
    """Bounds of NashConv of averages and mixtures of the snapshots in the pools, by kind.

    Snapshots do not play actions below `min_probability`, as the policies that are evaluated. {} if
    a side does not learn, or has fewer than two snapshots that are tables.
    """
    tables: dict[str, dict[str, Table]] = {role: {} for role in kept}
    if len(kept) < 2 or min(map(len, kept.values())) < 2:
        return {}
    for role, members in kept.items():
        for member in members:
            policy = member.policy_once()
            if not is_exact(task, policy):
                return {}
            table = table_in(task, policy)
            tables[role][member.name] = without_improbable(table, min_probability)
    return nash_convs(averages(task, discount, tables, mixtures))


def describe_averages(convs: Mapping[str, Sequence[float]]) -> str:
    """One line of text, with both bounds if they differ."""
    parts = []
    for what, (lower, upper) in convs.items():
        exact = upper - lower < 5e-4
        parts.append(f"{what} {upper:.3f}" if exact else f"{what} {lower:.3f} to {upper:.3f}")
    return f"NashConv of the snapshots in the pools: {'; '.join(parts)}"


class _Side:
    """Best responses to one side of a duel.

    Args:
        task: the duel.
        role: of the side.
        discount: of the exact game.
    """

    def __init__(self, task: Task, role: str, discount: float) -> None:
        self.task, self.role, self.discount = task, role, discount
        self.sign = 1.0 if role == "chaser" else -1.0
        rules: Any = (discount, task.stay_action, None, task.move_order)
        game = solve_chase(task.mazes[0], *rules)
        self.value = mean_over_starts(game.values, task.mazes[0])

    def _gain(self, values: Table | PairValues) -> float:
        """The mean of values over all starts, minus the value of the game."""
        return self.sign * (mean_over_starts(values, self.task.mazes[0]) - self.value)

    def best(self, table: Table) -> tuple[float, Table]:
        """The exploitability of a table, and its best response."""
        found = best_reply(self.task, other_role(self.role), table, None, self.discount)
        return self._gain(found.values), found.policy

    def gained(self, table: Table, response: Table) -> float:
        """The gain of a given response against a table."""
        pair = (table, response)
        return self._gain(values_between(self.task, self.role, pair, None, self.discount))

    def mixture(self, tables: Table, shares: NDArray[np.float64]) -> tuple[float, float]:
        """Bounds of the exploitability of a mixture that draws one table per game.

        Upper: the opponent knows the table. Lower: the best single response, among those to their
        average in every state and to `RESPONSES` of the tables, the most probable ones.
        """
        each = [self.best(table) for table in tables]
        average = np.tensordot(shares, tables, axes=1)
        likely = np.argsort(-shares, kind="stable")[:: max(len(shares) // RESPONSES, 1)]
        responses = [each[number][1] for number in likely] + [self.best(average)[1]]
        upper = float(shares @ [gain for gain, _ in each])
        lower = max(
            float(shares @ [self.gained(table, response) for table in tables])
            for response in responses
        )
        lower = max(lower, 0.0)  # exploitability is never negative
        return lower, max(lower, upper)
