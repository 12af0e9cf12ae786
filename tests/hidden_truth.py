"""Games in which one cell is hidden, once more: plain rules, plain beliefs, exact value iteration.

Nothing here is shared with the solver: states and chances are written down in plain Python, and
vectors are pruned by linear programs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog

from pursuit.mazes.maze import Maze

Numbers = NDArray[np.float64]


@dataclass(frozen=True)
class Game:
    """after(own, action, hidden) -> own cell, cost, and {hidden cell: chance} of what goes on."""

    cells: int
    actions: int
    after: Callable[[int, int, int], tuple[int, float, dict[int, float]]]
    sees: Callable[[int, int], bool]
    discount: float


def chase(
    maze: Maze, table: Numbers, radius: int, role: str, order: str, discount: float = 0.95
) -> Game:
    """The chase by the rules of the design: all move at once, or the chaser first."""

    def after(own: int, action: int, hidden: int) -> tuple[int, float, dict[int, float]]:
        mine = int(maze.neighbors[own, action])
        chances: dict[int, float] = {}
        for move, chance in enumerate(table[hidden, own]):
            theirs = int(maze.neighbors[hidden, move])
            if order == "simultaneous":
                caught = mine == theirs or (mine, theirs) == (hidden, own)
            elif role == "chaser":
                caught = mine in (hidden, theirs)
            else:
                caught = theirs in (own, mine)
            if chance > 0.0 and not caught:
                chances[theirs] = chances.get(theirs, 0.0) + float(chance)
        return mine, 1.0 if role == "chaser" else -1.0, chances

    def sees(own: int, hidden: int) -> bool:
        return own == hidden or bool(maze.distances[own, hidden] <= radius)

    return Game(maze.num_cells, table.shape[2], after, sees, discount)


def step(game: Game, own: int, action: int, belief: Numbers) -> tuple[int, float, Numbers]:
    """The own cell after it, the expected cost, and the weights of the hidden cells after it."""
    weights, cost, mine = np.zeros(game.cells), 0.0, own
    for hidden in np.flatnonzero(belief):
        mine, price, chances = game.after(own, action, int(hidden))
        cost += belief[hidden] * price
        for cell, chance in chances.items():
            weights[cell] += belief[hidden] * chance
    return mine, cost, weights


def exact_values(game: Game, steps: int, begin: float, slack: float = 1e-7) -> list[Numbers]:
    """[own] of vectors [vectors, hidden]: after so many sweeps from `begin` the least
    cost of a belief out of view is the least of its products with them. Each vector is the cost of
    one way to act while nothing is seen; Monahan (1982), with pruning by linear programs.
    """
    rows = [np.full((1, game.cells), begin) for _ in range(game.cells)]
    for _ in range(steps):
        known = np.zeros((game.cells, game.cells))
        for own in range(game.cells):
            known[own] = rows[own].min(axis=0)
        following = []
        for own in range(game.cells):
            candidates = []
            for action in range(game.actions):
                options = np.zeros((len(rows[int(game.after(own, action, own)[0])]), game.cells))
                for hidden in range(game.cells):
                    if hidden == own:
                        continue
                    mine, cost, chances = game.after(own, action, hidden)
                    options[:, hidden] = cost
                    for cell, chance in chances.items():
                        later = known[mine, cell] if game.sees(mine, cell) else rows[mine][:, cell]
                        options[:, hidden] += game.discount * chance * later
                candidates.append(options)
            following.append(_pruned(np.concatenate(candidates), game, own, slack))
        rows = following
    return rows


def _pruned(vectors: Numbers, game: Game, own: int, slack: float) -> Numbers:
    """Those that are least by more than the slack at some belief out of view, and those that are
    least where the other is seen.
    """
    vectors = np.unique(vectors.round(12), axis=0)
    order = vectors.sum(axis=1).argsort(kind="stable")
    undominated: list[int] = []
    for i in order:
        if not (vectors[undominated] <= vectors[i] + slack).all(axis=1).any():
            undominated.append(int(i))
    vectors = vectors[undominated]
    out = np.array([not game.sees(own, cell) for cell in range(game.cells)])
    size = int(out.sum())
    keep = {int(vectors[:, cell].argmin()) for cell in range(game.cells)}
    if size:  # those that are least at drawn beliefs need no linear program
        drawn = np.random.default_rng(0).dirichlet(np.full(size, 0.5), 5000)
        keep |= set((drawn @ vectors[:, out].T).argmin(axis=1).tolist())
    candidates = [i for i in range(len(vectors)) if i not in keep]
    kept = sorted(keep)
    while candidates and size:
        others = vectors[kept][:, out]
        # A belief at which the first is less than all that are kept, by as much as can be.
        found = linprog(
            np.append(np.zeros(size), -1.0),
            A_ub=np.column_stack([vectors[candidates[0]][out] - others, np.ones(len(others))]),
            b_ub=np.zeros(len(others)),
            A_eq=np.append(np.ones(size), 0.0)[None],
            b_eq=[1.0],
            bounds=[(0.0, None)] * size + [(None, None)],
        )
        least = 0
        if -found.fun > slack:  # Lark's order: the one that is least there is kept
            least = int((vectors[candidates][:, out] @ found.x[:size]).argmin())
            kept.append(candidates[least])
        del candidates[least]
    return vectors[kept]
