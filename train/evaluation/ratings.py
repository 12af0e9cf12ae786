"""Ratings of players: Elo, Nash averaging, and cycles.

Players of one role are compared on the same starts against the same opponents, and the one with the
better result wins the comparison. So ratings need no threshold for winning a chase.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.rules.arrays import Array
from scripted_agents import MatrixGame, solve_matrix_game

BOOTSTRAPS = 200


def pairwise_wins(results: Array) -> NDArray[np.float64]:
    """[players, players, games] float64: the share of opponents with a better result.

    Args:
        results: [players, opponents, games], larger is better; game g has the same start for all.

    Returns:
        In [0, 1]; ties count half. wins[i, k] + wins[k, i] = 1.
    """
    own, other = results[:, None], results[None]
    return ((own > other) + 0.5 * (own == other)).mean(axis=2)


def elo_ratings(wins: NDArray[np.float64], seed: int = 0) -> list[tuple[float, float, float]]:
    """Elo ratings with mean 1500, and their 95 % intervals, by a bootstrap over games.

    The maximum likelihood of P(i beats k) = 1 / (1 + 10 ** ((r_k - r_i) / 400)) (Bradley and Terry,
    1952; Elo, 1978), with half a win added on each side, so that ratings stay finite.

    Args:
        wins: [players, players, games], from `pairwise_wins`.
        seed: of the bootstrap.

    Returns:
        (rating, low, high) for each player.
    """
    if len(wins) == 1:
        return [(1500.0, 1500.0, 1500.0)]
    rng, games = np.random.default_rng(seed), wins.shape[2]
    point = _elo(wins.sum(axis=2))
    draws = [
        _elo(wins[:, :, rng.integers(games, size=games)].sum(axis=2)) for _ in range(BOOTSTRAPS)
    ]
    low, high = np.percentile(draws, [2.5, 97.5], axis=0)
    return [tuple(map(float, row)) for row in zip(point, low, high, strict=True)]  # type: ignore[misc]


def _elo(won: NDArray[np.float64]) -> NDArray[np.float64]:
    from scipy.optimize import minimize  # slow to import

    counts = won + 0.5
    np.fill_diagonal(counts, 0.0)
    scale = np.log(10.0) / 400.0

    def loss(ratings: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        behind = scale * (ratings[None, :] - ratings[:, None])
        expected = 1.0 / (1.0 + np.exp(behind))
        total = float((counts * np.logaddexp(0.0, behind)).sum())
        lost = counts * (1.0 - expected)
        return total, scale * (lost.sum(axis=0) - lost.sum(axis=1))

    found: NDArray[np.float64] = minimize(
        loss, np.zeros(len(won)), jac=True, method="L-BFGS-B", options={"ftol": 1e-14}
    ).x
    return 1500.0 + found - found.mean()


def nash_average(payoff: NDArray[np.float64]) -> MatrixGame:
    """Nash averaging (Balduzzi et al., 2018): opponents count by the maximum entropy equilibrium.

    So copies of an entry do not change the ratings, and weak opponents do not count.

    Args:
        payoff: [chasers, evaders], which the evaders maximise.

    Returns:
        The equilibrium with the greatest entropy; the evaders are its row player.
    """
    game = solve_matrix_game(payoff.T)
    chasers = _widest(-payoff.T, -game.value, game.column)
    return replace(game, row=_widest(payoff, game.value, game.row), column=chasers)


def _widest(
    payoff: NDArray[np.float64], value: float, start: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The maximum entropy strategy over columns that gets at least `value` from every row."""
    span = float(np.ptp(payoff))
    if span <= 1e-9 * max(1.0, abs(value)):
        return np.full_like(start, 1.0 / len(start))
    slack = 1e-9
    limits: Any = [
        {"type": "eq", "fun": lambda p: p.sum() - 1.0, "jac": np.ones_like},
        {
            "type": "ineq",
            "fun": lambda p: (payoff @ p - value) / span + slack,
            "jac": lambda p: payoff / span,
        },
    ]

    def less_even(p: NDArray[np.float64]) -> float:
        return float((p * np.log(np.maximum(p, 1e-300))).sum())

    def slope(p: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.log(np.maximum(p, 1e-12)) + 1.0

    from scipy.optimize import minimize  # slow to import

    found = minimize(
        less_even,
        0.999 * start + 0.001 / len(start),
        jac=slope,
        bounds=[(0.0, 1.0)] * len(start),
        constraints=limits,
        method="SLSQP",
        options={"maxiter": 500, "ftol": 1e-12},
    )
    mixture = np.clip(found.x, 0.0, None)
    mixture /= mixture.sum()
    # If the search ends outside the constraints, the initial equilibrium is still valid.
    good = bool(((payoff @ mixture - value) / span > -1e-6).all())
    return mixture if good else start


def best_response_cycle(
    payoff: NDArray[np.float64], ci95: NDArray[np.float64]
) -> list[tuple[str, int]]:
    """A cycle of best responses, each to the previous one; empty if they reach an equilibrium.

    Args:
        payoff: [chasers, evaders], which the evaders maximise and the chasers minimise.
        ci95: half widths of its entries; equilibria are tested within them.

    Returns:
        ("chaser", i) and ("evader", j) in turn: at least four of them.
    """
    lowest, highest = payoff - ci95, payoff + ci95
    settled = (highest >= lowest.max(axis=1, keepdims=True)) & (lowest <= highest.min(axis=0))
    if settled.any():
        return []
    seen: dict[int, int] = {}
    path: list[tuple[str, int]] = []
    chaser = 0
    while chaser not in seen:
        seen[chaser] = len(path)
        evader = int(payoff[chaser].argmax())
        path += [("chaser", chaser), ("evader", evader)]
        chaser = int(payoff[:, evader].argmin())
    return path[seen[chaser] :]


def preference_cycle(wins: NDArray[np.float64]) -> list[int]:
    """A shortest cycle of players of one role, each better than the next; empty if there is none.

    A player is better if its share of won comparisons has a 95 % interval above half.

    Args:
        wins: [players, players, games], from `pairwise_wins`.
    """
    import networkx

    games = wins.shape[2]
    half = 1.96 * wins.std(axis=2, ddof=1) / games**0.5 if games > 1 else np.inf
    better = wins.mean(axis=2) - half > 0.5
    graph = networkx.DiGraph(np.argwhere(better).tolist())
    shortest: list[int] = []
    for player in graph:
        # A cycle is an edge to a worse player plus a shortest path back: one search per player.
        back = networkx.single_target_shortest_path(graph, player)
        for worse in graph.successors(player):
            if worse in back and (not shortest or len(back[worse]) < len(shortest)):
                shortest = back[worse]
    return shortest
