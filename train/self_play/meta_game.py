"""The meta-game of self-play: payoffs between snapshots, and their Nash mixtures."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from pursuit.simulator.policy import Policy
from pursuit.validation import check, unknown
from scripted_agents import solve_matrix_game
from train.self_play.pool import LATEST, OpponentPool


class Payoffs:
    """Payoffs between the members of two pools, computed when first asked for, then kept.

    Args:
        pools: the members of each role; the second role maximises the payoff.
        learning: the roles that learn; their member "latest" has no payoffs, as it changes.
        payoff: computes that of two policies, as in training and in NashConv.

    Attributes:
        known: those computed so far, by the names of both members.
    """

    def __init__(
        self,
        pools: Mapping[str, OpponentPool],
        learning: Sequence[str],
        payoff: Callable[[Policy, Policy], float],
    ) -> None:
        self.pools, self._payoff = pools, payoff
        self._learning = set(learning)
        self.known: dict[tuple[str, str], float] = {}

    def names(self, role: str) -> list[str]:
        """The members of a role that have payoffs: snapshots, scripted and frozen policies.

        ValueError for more than two roles.
        """
        count = len(self.pools)
        check(count == 2, f"payoffs are those of two players, but {count} play; do not ask for any")
        names = self.pools[role].names
        return [name for name in names if name != LATEST or role not in self._learning]

    def __call__(self, chaser: str, evader: str) -> float:
        """The payoff of two members by name; ValueError for a name that is not in `names`."""
        if (chaser, evader) not in self.known:
            pair = []
            for role, name in zip(self.pools, (chaser, evader), strict=True):
                names = self.names(role)
                check(name in names, unknown(f"{role} with payoffs", name, names))
                pair += [m.policy for m in self.pools[role].members if m.name == name]
            self.known[chaser, evader] = self._payoff(pair[0], pair[1])
        return self.known[chaser, evader]

    def matrix(self) -> NDArray[np.float64]:
        """[members, members of the second role] the payoffs of all `names`."""
        chasers, evaders = map(self.names, self.pools)
        rows = [[self(chaser, evader) for evader in evaders] for chaser in chasers]
        return np.array(rows, dtype=np.float64).reshape(-1, len(evaders))

    def forget(self) -> None:
        """Remove the payoffs of members that were dropped from their pools."""
        if len(self.pools) != 2:
            return
        chasers, evaders = (set(pool.names) for pool in self.pools.values())
        self.known = {p: v for p, v in self.known.items() if p[0] in chasers and p[1] in evaders}

    def mixtures(self) -> dict[str, dict[str, float]]:
        """The Nash mixture of each role: shares by name."""
        game = solve_matrix_game(self.matrix().T)  # the second role maximises
        found = zip(self.pools, (game.column, game.row), strict=True)
        return {r: dict(zip(self.names(r), mix.tolist(), strict=True)) for r, mix in found}
