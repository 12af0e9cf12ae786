"""Averages of self-play's snapshots, scored as its last policies are.

The theory of fictitious play and of double oracles says that the mixture of all past policies comes
near an equilibrium, not the last one of them. A mixture draws one snapshot for a whole game. An
opponent who cannot see which gains no more than one who is told, and no less than by any response
that plays alike against all: so its exploitability lies between two numbers. Policies averaged in
every state are a table, and its exploitability is exact.
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
from train.self_play.pool import Member
from train.settings.self_play import ROLES

Table = NDArray[np.float64]


@dataclass(frozen=True)
class Average:
    """How far a best response to one side gets beyond the value of the game, in discounted steps.

    Attributes:
        role: whose policies.
        what: the last snapshot, or an average of which and how.
        snapshots: that count in it.
        lower, upper: of exploitability, mean over all starts in distinct cells; the same where it
            is known exactly.
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
            Left out where it gives anything to players that are no snapshots.
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
    """Bounds of NashConv, the sum over both sides, by what is averaged on both."""
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
) -> dict[str, tuple[float, float]]:
    """Bounds of NashConv of averages and mixtures of the snapshots that pools kept, by which.

    {} where a side does not learn, or has fewer than two snapshots that are tables.
    """
    policies = [member.policy for members in kept.values() for member in members]
    if len(kept) < 2 or min(map(len, kept.values())) < 2 or not is_exact(task, *policies):
        return {}
    tables = {
        role: {member.name: table_in(task, member.policy) for member in members}
        for role, members in kept.items()
    }
    return nash_convs(averages(task, discount, tables, mixtures))


def describe_averages(convs: Mapping[str, Sequence[float]]) -> str:
    """In words, with the bounds where they are not one number."""
    parts = []
    for what, (lower, upper) in convs.items():
        exact = upper - lower < 5e-4
        parts.append(f"{what} {upper:.3f}" if exact else f"{what} {lower:.3f} to {upper:.3f}")
    return f"NashConv of the snapshots that are kept: {'; '.join(parts)}"


class _Side:
    """What best responses get from one side of a duel.

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
        """How far values from all pairs of cells lie beyond the value of the game."""
        return self.sign * (mean_over_starts(values, self.task.mazes[0]) - self.value)

    def best(self, table: Table) -> tuple[float, Table]:
        """The exploitability of a table, and the response that shows it."""
        found = best_reply(self.task, other_role(self.role), table, None, self.discount)
        return self._gain(found.values), found.policy

    def gained(self, table: Table, response: Table) -> float:
        """What a given response gets against a table, over the value of the game."""
        pair = (table, response)
        return self._gain(values_between(self.task, self.role, pair, None, self.discount))

    def mixture(self, tables: Table, shares: NDArray[np.float64]) -> tuple[float, float]:
        """Bounds of the exploitability of a mixture: one table is drawn for each whole game.

        From above: the opponent is told which. From below: the best of the responses to each table
        and to their average in every state, against all.
        """
        each = [self.best(table) for table in tables]
        average = np.tensordot(shares, tables, axes=1)
        responses = [response for _, response in each] + [self.best(average)[1]]
        upper = float(shares @ [gain for gain, _ in each])
        lower = max(
            float(shares @ [self.gained(table, response) for table in tables])
            for response in responses
        )
        lower = max(lower, 0.0)  # nothing is exploitable by less than what the game is worth
        return lower, max(lower, upper)
