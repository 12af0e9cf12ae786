"""Mazes and their edits: a pool that grows harder, made before the games begin.

A task never changes while it is played, so all edits that may be played are made first, from a
seed: a tree of them for every maze, each a few walls away from its parent.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pursuit.mazes.maze import Maze
from pursuit.mazes.suites import held_out_copies, least_copy
from train.settings.checks import check

BASE = -1
TRIES = 100
"""Draws for one edit that stays in one part; a maze that allows none keeps its last child."""


def edited(maze: Maze, walls: int, rng: np.random.Generator, name: str) -> Maze | None:
    """`maze` with so many of its inner walls toggled, still in one part; None where none is found.

    Every inner wall is as likely, those that are closed and those that are open.
    """
    walkable = maze.cell_numbers >= 0
    south, east = maze.joined_south, maze.joined_east
    places = [(0, *place) for place in np.argwhere(walkable[:-1] & walkable[1:]).tolist()]
    places += [(1, *place) for place in np.argwhere(walkable[:, :-1] & walkable[:, 1:]).tolist()]
    if not places:
        return None
    for _ in range(TRIES):
        tables = (south.copy(), east.copy())
        chosen = rng.choice(len(places), size=min(walls, len(places)), replace=False)
        for table, row, column in (places[number] for number in chosen):
            tables[table][row, column] ^= True
        child = Maze(walkable, *tables, name=name)
        if child.is_connected:
            return child
    return None


def with_edits(
    mazes: Sequence[Maze], children: int, depth: int, walls: int, seed: int
) -> tuple[tuple[Maze, ...], list[int]]:
    """A pool of mazes and their edits, and the parent of each by number.

    Args:
        mazes: the base mazes, which come first; their parent is -1.
        children: edits of each maze.
        depth: generations of edits.
        walls: inner walls that one edit toggles; an edit that is a maze of a validation or test
            suite, turned or mirrored, is left out.
        seed: of what is drawn.

    Raises:
        ValueError: a base maze with marks, which edits do not keep.
    """
    check(
        all(maze.start_mark is None and not maze.goal_marks for maze in mazes),
        "edits are of mazes without marks; take a suite",
    )
    rng = np.random.default_rng([seed, 0xED17])
    pool, parents = list(mazes), [BASE] * len(mazes)
    held_out = held_out_copies()
    first = 0
    for _ in range(depth):
        last = len(pool)
        for number in range(first, last):
            for child in range(children):
                found = edited(pool[number], walls, rng, f"{pool[number].name}.{child}")
                if found is not None and least_copy(found) not in held_out:
                    pool.append(found)
                    parents.append(number)
        first = last
    return tuple(pool), parents
