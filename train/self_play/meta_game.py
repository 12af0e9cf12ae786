"""The meta-game of self-play: payoffs between snapshots, and their Nash mixtures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from pursuit.tasks.task import Task
from pursuit.validation import check, unknown
from scripted_agents import solve_matrix_game
from train.evaluation.matchups import discounted_steps
from train.self_play.pool import LATEST, OpponentPool
from train.settings.checks import evaluation_seed
from train.settings.self_play import ROLES

PAIR_EPISODES = 200
"""Games per payoff without an exact value."""


class Payoffs:
    """Payoffs between the members of both pools, computed when first asked for, then kept.

    A payoff is the expected number of discounted steps until the game ends, as in training and in
    NashConv (`discounted_steps`). Chasers minimise it, evaders maximise it.

    Args:
        task: the game.
        pools: the members of each role.
        learning: the roles that learn; their member "latest" has no payoffs, as it changes.
        discount: of the game.
        seed: of the run, for payoffs without an exact value.

    Attributes:
        known: those computed so far, by the names of chaser and evader.
    """

    def __init__(
        self,
        task: Task,
        pools: Mapping[str, OpponentPool],
        learning: Sequence[str],
        discount: float,
        seed: int,
    ) -> None:
        self.task, self.pools, self.discount, self.seed = task, pools, discount, seed
        self._learning = set(learning)
        self.known: dict[tuple[str, str], float] = {}

    def names(self, role: str) -> list[str]:
        """The members of a role that have payoffs: snapshots, scripted and frozen policies."""
        names = self.pools[role].names
        return [name for name in names if name != LATEST or role not in self._learning]

    def __call__(self, chaser: str, evader: str) -> float:
        """The payoff of two members by name; ValueError for a name that is not in `names`."""
        if (chaser, evader) not in self.known:
            pair = []
            for role, name in zip(ROLES, (chaser, evader), strict=True):
                names = self.names(role)
                check(name in names, unknown(f"{role} with payoffs", name, names))
                pair += [m.policy for m in self.pools[role].members if m.name == name]
            how = (self.discount, PAIR_EPISODES, evaluation_seed(self.seed))
            self.known[chaser, evader] = discounted_steps(self.task, pair[0], pair[1], *how)
        return self.known[chaser, evader]

    def matrix(self) -> NDArray[np.float64]:
        """[chasers, evaders] the payoffs of all `names`."""
        evaders = self.names("evader")
        rows = [[self(chaser, evader) for evader in evaders] for chaser in self.names("chaser")]
        return np.array(rows, dtype=np.float64).reshape(-1, len(evaders))

    def forget(self) -> None:
        """Remove the payoffs of members that were dropped from their pools."""
        chasers, evaders = (set(self.pools[role].names) for role in ROLES)
        self.known = {p: v for p, v in self.known.items() if p[0] in chasers and p[1] in evaders}

    def mixtures(self) -> dict[str, dict[str, float]]:
        """The Nash mixture of each role: shares by name."""
        found = zip(ROLES, nash_mixtures(self.matrix()), strict=True)
        return {r: dict(zip(self.names(r), mix.tolist(), strict=True)) for r, mix in found}


def nash_mixtures(payoff: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The equilibrium of a payoff matrix [chasers, evaders] that the evaders maximise.

    Returns:
        The mixtures of the chasers and of the evaders.
    """
    game = solve_matrix_game(payoff.T)
    return game.column, game.row
