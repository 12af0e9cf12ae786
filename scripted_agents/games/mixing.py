"""How much the equilibrium of a game mixes actions: the share of visits where pure play loses."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scripted_agents.games.episodes import return_range
from scripted_agents.games.small_game import SmallGame, longest_play
from scripted_agents.games.solve import Policies, SmallEquilibrium, chain_of, equilibrium, iterate

LEAST_APART = 1e-6
"""Share of the range of returns above which a difference between minimax and maximin counts."""


def mixed_share(
    game: SmallGame,
    discount: float = 0.95,
    horizon: int | None = None,
    solution: SmallEquilibrium | None = None,
) -> float:
    """The share of the visits of equilibrium play in states where optimal play must be random.

    Visits are those from the starts under the policies of `equilibrium`, the one at step t counts
    discount**t, and they are normalised to 1. A state counts if the minimax over pure actions is
    above the maximin by more than `LEAST_APART` of the range of returns (`return_range`).

    Args:
        game: zero-sum, of two players.
        discount: of each step.
        horizon: number of steps, or None for infinitely many. Policies are those of the first step.
        solution: the equilibrium of this game, if it is known.

    Raises:
        ValueError: as `equilibrium`.
    """
    found = equilibrium(game, discount, horizon) if solution is None else solution
    low, high = return_range(game, game.players[0], discount, horizon)
    later = found.values
    if horizon is not None and (longest_play(game) or horizon + 1) > horizon:
        shorter = horizon > 1  # values of the steps after the first
        later = equilibrium(game, discount, horizon - 1).values if shorter else 0.0 * later
    mixed = apart(game, later, discount) > LEAST_APART * (high - low)
    return float(visits_of(game, found.policies, discount, horizon)[mixed].sum())


def visits_of(
    game: SmallGame, policies: Policies, discount: float, horizon: int | None = None
) -> NDArray[np.float64]:
    """[states] float64 with sum 1: the share of discounted visits from the starts when all play
    these policies; arguments and errors are those of `returns_of`."""
    from scipy.sparse import csc_array, eye_array  # slow to import
    from scipy.sparse.linalg import splu

    step, _ = chain_of(game, policies)
    back = step.T

    def visits_after(visits: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(game.start + discount * (back @ visits))

    def solved(visits: NDArray[np.float64]) -> NDArray[np.float64]:

        system = csc_array(eye_array(game.num_states) - discount * back)
        return np.asarray(splu(system).solve(game.start))

    visits = iterate(visits_after, game.start, discount, horizon, solved)
    return np.asarray(visits / visits.sum())


def apart(game: SmallGame, values: NDArray[np.float64], discount: float) -> NDArray[np.float64]:
    """[states] float64: by how much the minimax over pure actions exceeds the maximin, for the
    first player, when `values` [states] follow."""
    worth = game.rewards[:, 0] + discount * (game.following @ values)
    rows = np.flatnonzero(np.diff(game.choices[:, 0], prepend=-1) | (game.choices[:, 1] == 0))
    row_of = game.offsets(0)[:-1]
    maximin = np.maximum.reduceat(np.minimum.reduceat(worth, rows), row_of)
    order = np.lexsort((game.choices[:, 1], game.owners))
    sizes = np.diff(game.offsets(1))
    columns = np.flatnonzero(
        np.diff(game.owners[order] * (sizes.max() + 1) + game.choices[order, 1], prepend=-1)
    )
    minimax = np.minimum.reduceat(np.maximum.reduceat(worth[order], columns), game.offsets(1)[:-1])
    return np.asarray(minimax - maximin)
