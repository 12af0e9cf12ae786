"""The fewest steps, and the fewest searchers, that surely find an evader who is never seen before.

The evader knows everything and moves as it likes: what matters is only where it may be still, the
*contaminated* cells. Parsons (1976); LaValle, Lin, Guibas, Latombe and Motwani (1997); Isler,
Kannan and Khanna (2006).

A step is one of the game: all move at once. The evader is found when it is captured (it stands in a
searcher's cell after the moves, or has swapped cells with one) or when it is in a searcher's view
after the moves, or at the start.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations, product
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from pursuit.mazes.maze import Maze, load_maze
from pursuit.memory import check_memory
from pursuit.tasks.sight import visible_cells
from pursuit.validation import one_of, truth, whole
from scripted_agents.graphs import worst_case_kernels as kernels

MAX_CELLS = 64
"""The cells of a set lie in one word."""

MAX_PLACES = 10_000_000
"""Bound on cells ** searchers."""

MAX_STATES = 5_000_000
"""States that are kept before a search is given up: 20 bytes each."""

Speed = Literal["one", "unbounded"]


@dataclass(frozen=True, eq=False)
class SearchPlan:
    """What `fewest_steps_to_find` found.

    Attributes:
        steps: the fewest steps after which the evader is found for certain; None where searchers so
            few never find it for certain.
        searchers: how many there are.
        cells: [steps + 1, searchers] int, the cell of every searcher from the start on; no rows
            where there is no plan.
        contaminated: [steps + 1, maze cells] bool, where the evader may be still.
        states: how many states were kept.
    """

    steps: int | None
    searchers: int
    cells: NDArray[np.int64] = field(repr=False)
    contaminated: NDArray[np.bool_] = field(repr=False)
    states: int


def fewest_steps_to_find(
    maze: Maze | str,
    view_radius: int | None = None,
    line_of_sight: bool = False,
    searchers: int = 1,
    start: Sequence[int] | int | None = None,
    speed: Speed = "one",
    stay_action: bool = False,
    max_states: int = MAX_STATES,
) -> SearchPlan:
    """The fewest steps in which searchers surely find an evader, and a plan that does.

    Exact, by breadth-first search over (cells of the searchers, contaminated cells), without what
    another state is at least as good as.

    Args:
        maze: of at most MAX_CELLS cells; 25 are easy.
        view_radius, line_of_sight: what every searcher sees, as in `Task`. With neither it sees its
            own cell only: the evader must be captured.
        searchers: how many.
        start: a cell for each of them; left out they choose the best, each its own.
        speed: of the evader: "one" cell a step, as in the game; or "unbounded": it moves as in
            the game, and then runs on along any path that is out of view of all.
        stay_action: whether both have the action to stay. Without it only a move into a wall is.
        max_states: give up beyond so many states.

    Raises:
        ValueError: a maze too large, too many searchers, settings outside these limits, or more
            states than `max_states`.
    """
    maze = load_maze(maze)
    size, searchers = maze.num_cells, whole("searchers", searchers, 1)
    max_states = whole("max_states", max_states, 1)
    fast = one_of("speed", speed, ("one", "unbounded")) == "unbounded"
    _check_size(maze, searchers)
    starts = _starts(maze, searchers, start)
    seeing: dict[str, Any] = {"view_radius": view_radius, "line_of_sight": line_of_sight}
    if view_radius is None and not truth("line_of_sight", line_of_sight):
        seeing["view_radius"] = 0
    sight = visible_cells(maze, **seeing)
    world = _world(maze, truth("stay_action", stay_action), sight, fast)
    capacity = min(max_states, 1 << 12) + len(starts) + 5**searchers
    check_memory(f"{maze.name}, {searchers} searchers,", 4 * size**searchers, "take fewer")
    heads = np.full(size**searchers, kernels.END, dtype=np.int32)
    links, places, parents = (np.zeros(capacity, dtype=np.int32) for _ in range(3))
    sets = np.zeros(capacity, dtype=np.uint64)
    room, answer = np.zeros((4, searchers), dtype=np.int64), np.zeros(3, dtype=np.int64)
    every = np.uint64((1 << size) - 1)
    states = kernels.States(heads, links, places, sets, parents)
    count = kernels.begin(starts, every, world, states, room[3])
    first, last = 0, int(count)
    if (sets[:count] == 0).any():
        return _plan(world, int(np.argmax(sets[:count] == 0)), states, searchers, count)
    while first < last:
        states = kernels.States(heads, links, places, sets, parents)
        kernels.expand(first, last, count, world, states, room, answer)
        outcome, first, count = answer.tolist()
        if outcome == kernels.FOUND:
            return _plan(world, count - 1, states, searchers, count)
        if count > max_states:
            raise ValueError(
                f"{maze.name}, {searchers} searchers: more than max_states={max_states} states; "
                "take a smaller maze, fewer searchers or another sight, or allow more"
            )
        if outcome == kernels.FULL:
            links, places, sets, parents = (
                np.concatenate([array, np.zeros_like(array)])
                for array in (links, places, sets, parents)
            )
        else:
            first, last = last, count
    nothing = np.zeros((0, searchers), dtype=np.int64)
    return SearchPlan(None, searchers, nothing, np.zeros((0, size), dtype=bool), count)


def fewest_searchers(
    maze: Maze | str,
    view_radius: int | None = None,
    line_of_sight: bool = False,
    speed: Speed = "one",
    stay_action: bool = False,
    max_states: int = MAX_STATES,
) -> SearchPlan:
    """The fewest searchers that surely find the evader from a start that they choose.

    Its `.searchers` is their number, its `.steps` the fewest steps that so many need. Arguments and
    errors as of `fewest_steps_to_find`.
    """
    maze = load_maze(maze)
    for searchers in range(1, maze.num_cells + 1):
        plan = fewest_steps_to_find(
            maze, view_radius, line_of_sight, searchers, None, speed, stay_action, max_states
        )
        if plan.steps is not None:
            return plan
    raise AssertionError("as many searchers as cells leave nothing contaminated")


# -- inside ----------------------------------------------------------------------------------------


def _world(maze: Maze, stay_action: bool, sight: NDArray[np.bool_], fast: bool) -> kernels.World:
    """The maze as the kernels need it."""
    size, actions = maze.num_cells, 5 if stay_action else 4
    ways = [list(dict.fromkeys(row[:actions])) for row in maze.neighbors.tolist()]
    joined = np.zeros((size, size), dtype=bool)
    joined[np.arange(size)[:, None], maze.neighbors[:, :actions]] = True
    return kernels.World(
        moves=np.array([(cells * 5)[:5] for cells in ways]),
        num_moves=np.array([len(cells) for cells in ways]),
        reach=_as_bits(joined),
        came_from=_as_bits(joined.T),
        sight=_as_bits(sight),
        fast=fast,
    )


def _as_bits(member: NDArray[np.bool_]) -> NDArray[np.uint64]:
    """[sets] uint64 of [sets, cells]."""
    bits = np.uint64(1) << np.arange(member.shape[1], dtype=np.uint64)
    return np.bitwise_or.reduce(np.where(member, bits, np.uint64(0)), axis=1)


def _check_size(maze: Maze, searchers: int) -> None:
    if maze.num_cells > MAX_CELLS:
        raise ValueError(
            f"{maze.name}: {maze.num_cells} cells; worst cases are searched up to {MAX_CELLS}, and "
            "25 are easy. Take a smaller maze"
        )
    if maze.num_cells**searchers > MAX_PLACES:
        raise ValueError(
            f"searchers={searchers} on {maze.num_cells} cells have {maze.num_cells**searchers:,} "
            f"places; at most {MAX_PLACES:,} are searched. Take fewer, or a smaller maze"
        )


def _starts(maze: Maze, searchers: int, start: Sequence[int] | int | None) -> NDArray[np.int64]:
    """[places, searchers], where the searchers may begin."""
    if start is None:
        if searchers > maze.num_cells:
            raise ValueError(
                f"searchers={searchers}; {maze.name} has {maze.num_cells} cells, one for each"
            )
        return np.array(list(combinations(range(maze.num_cells), searchers)), dtype=np.int64)
    given = [start] if isinstance(start, (int, np.integer)) else list(start)
    if len(given) != searchers:
        raise ValueError(f"start={start!r}; give {searchers} cell(s), one for each searcher")
    return np.array([[maze.check_cell(cell) for cell in given]], dtype=np.int64)


def _plan(
    world: kernels.World, last: int, states: kernels.States, searchers: int, count: int
) -> SearchPlan:
    """The plan that ends in the state `last`."""
    places, sets, parents = states.places, states.sets, states.parents
    size, chain = len(world.sight), [last]
    while parents[chain[-1]] >= 0:
        chain.append(int(parents[chain[-1]]))
    chain.reverse()
    sorted_cells = [_digits(int(places[state]), size, searchers) for state in chain]
    cells = [sorted_cells[0]]
    # A state has forgotten who stands where: any joint move that leads to the next one will do.
    for state, following, target in zip(chain, chain[1:], sorted_cells[1:], strict=False):
        cells.append(
            next(
                now
                for now in product(
                    *(world.moves[c, : world.num_moves[c]].tolist() for c in cells[-1])
                )
                if tuple(sorted(now)) == target
                and kernels.leads_to(
                    sets[state], np.array(cells[-1]), np.array(now), world, sets[following]
                )
            )
        )
    dirty = sets[chain, None] >> np.arange(size, dtype=np.uint64) & np.uint64(1)
    return SearchPlan(len(chain) - 1, searchers, np.array(cells), dirty.astype(bool), count)


def _digits(place: int, size: int, searchers: int) -> tuple[int, ...]:
    """The cells of a place."""
    return tuple(place // size**i % size for i in range(searchers))
