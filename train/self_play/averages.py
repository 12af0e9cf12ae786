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

from pursuit.task import Task
from scripted_agents import (
    best_response,
    evaluate_exactly,
    mean_over_starts,
    solve_chase,
)
from train.self_play.standing import other_role
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


def told_averages(convs: Mapping[str, Sequence[float]]) -> str:
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
        self.maze, self.role, self.discount = task.mazes[0], role, discount
        self.order: Any = task.move_order
        self.rest: Any = (None, discount, task.stay_action, self.order)
        self.sign = 1.0 if role == "chaser" else -1.0
        game = solve_chase(self.maze, discount, task.stay_action, None, self.order)  # type: ignore[arg-type]
        self.value = mean_over_starts(game.values, self.maze)

    def best(self, table: Table) -> tuple[float, Table]:
        """The exploitability of a table, and the response that shows it."""
        responder: Any = other_role(self.role)
        found = best_response(responder, self.maze, table, *self.rest)
        mean = mean_over_starts(found.values, self.maze)
        return self.sign * (mean - self.value), found.policy

    def gained(self, table: Table, response: Table) -> float:
        """What a given response gets against a table, over the value of the game."""
        pair = (table, response) if self.role == "chaser" else (response, table)
        met = evaluate_exactly(self.maze, *pair, None, self.discount, self.order).values
        return self.sign * (mean_over_starts(met, self.maze) - self.value)

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
