"""The fewest steps that surely find an evader: against plain sets, known graphs, and in games."""

from __future__ import annotations

from itertools import combinations, product
from typing import Any

import numpy as np
import pytest

from pursuit import Maze, Simulator, generate_maze, load_maze, make_task
from scripted_agents import RandomAgent, fewest_searchers, fewest_steps_to_find

SQUARE = Maze.from_text("+-+-+\n|   |\n+ + +\n|   |\n+-+-+\n")
LADDER = Maze.from_text("+-+-+-+\n|     |\n+ + + +\n|     |\n+-+-+-+\n")
CLAW = Maze.from_text(
    "+-+-+-+-+-+\n|#|#| |#|#|\n+-+-+ +-+-+\n|#|#| |#|#|\n+-+-+ +-+-+\n|         |\n+-+-+-+-+-+\n"
)
"""Three ways of two cells that meet in one."""


def corridor(cells: int) -> Maze:
    line = "+" + "-+" * cells
    return Maze.from_text(f"{line}\n|{' ' * (2 * cells - 1)}|\n{line}\n")


def in_view(maze: Maze, own: int, other: int, radius: int | None, in_line: bool) -> bool:
    near = radius is None or maze.distances[own, other] <= radius
    if not in_line:
        return bool(near)
    for action in range(4):
        here = own
        while here != other and maze.neighbors[here, action] != here:
            here = maze.neighbors[here, action]
        if here == other:
            return bool(near)
    return False


def plain_search(
    maze: Maze, searchers: int, radius: int | None, in_line: bool, fast: bool, stay: bool
) -> int | None:
    """The same number by plain breadth-first search over all states, nothing left out."""
    cells = range(maze.num_cells)
    ways = [set(maze.neighbors[cell, : 5 if stay else 4].tolist()) for cell in cells]

    def found(place: tuple[int, ...]) -> set[int]:
        return {c for c in cells if any(in_view(maze, own, c, radius, in_line) for own in place)}

    def after(place: tuple[int, ...], then: tuple[int, ...], dirty: frozenset[int]) -> Any:
        seen, pairs = found(then), list(zip(place, then, strict=True))
        left = frozenset(
            way
            for cell in dirty
            for way in ways[cell]
            if way not in seen and (way, cell) not in pairs
        )
        while fast:
            more = frozenset(way for cell in left for way in ways[cell]) - seen | left
            if more == left:
                break
            left = more
        return left

    level = {
        (place, frozenset(set(cells) - found(place))) for place in combinations(cells, searchers)
    }
    known, steps = set(level), 0
    while level:
        if any(not dirty for _, dirty in level):
            return steps
        following = {
            (then, after(place, then, dirty))
            for place, dirty in level
            for then in product(*(ways[cell] for cell in place))
        }
        level, steps = following - known, steps + 1
        known |= level
    return None


@pytest.mark.parametrize("maze", [SQUARE, LADDER, corridor(4)])
@pytest.mark.parametrize("fast", [False, True])
def test_it_is_what_a_plain_search_finds(maze: Maze, fast: bool) -> None:
    for searchers, (radius, in_line), stay in product(
        (1, 2), ((None, False), (1, False), (None, True), (1, True)), (False, True)
    ):
        expected = plain_search(
            maze, searchers, 0 if radius is None and not in_line else radius, in_line, fast, stay
        )
        found = fewest_steps_to_find(
            maze, radius, in_line, searchers, None, "unbounded" if fast else "one", stay
        )
        assert found.steps == expected, (searchers, radius, in_line, stay)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_it_is_what_a_plain_search_finds_in_generated_mazes(seed: int) -> None:
    maze = generate_maze("prim", height=3, width=3, loops=0.3, seed=seed)
    for searchers, radius, fast in product((1, 2), (0, 1, 2), (False, True)):
        speed: Any = "unbounded" if fast else "one"
        found = fewest_steps_to_find(maze, radius, searchers=searchers, speed=speed)
        assert found.steps == plain_search(maze, searchers, radius, False, fast, False)


def test_known_graphs() -> None:
    for cells in (2, 5, 30):
        # A corridor is walked from end to end; from its middle first to the nearer end.
        assert fewest_steps_to_find(corridor(cells)).steps == cells - 1
        assert fewest_steps_to_find(corridor(cells), speed="unbounded").steps == cells - 1
        first = (cells - 1) // 2
        assert fewest_steps_to_find(corridor(cells), start=first).steps == first + cells - 1
    # In a ring one searcher runs behind for ever, two close it.
    assert fewest_steps_to_find(SQUARE).steps is None
    assert fewest_searchers(SQUARE).searchers == 2
    # Where three ways of two cells meet, one is searched while another is soiled again (Parsons).
    assert fewest_steps_to_find(CLAW, speed="unbounded").steps is None
    assert fewest_searchers(CLAW, speed="unbounded").searchers == 2
    # Whoever sees everything has found at once.
    assert fewest_steps_to_find("5x5", view_radius=24).steps == 0


def test_what_can_only_help_does() -> None:
    maze = load_maze("4x4")
    never = 10**6

    def steps(**settings: Any) -> int:
        found = fewest_steps_to_find(maze, **settings).steps
        return never if found is None else found

    for searchers in (1, 2):
        by_radius = [steps(view_radius=radius, searchers=searchers) for radius in range(7)]
        assert by_radius == sorted(by_radius, reverse=True)
        for radius in (0, 1, 2):
            slow = steps(view_radius=radius, searchers=searchers)
            assert slow <= steps(view_radius=radius, searchers=searchers, speed="unbounded")
            assert slow >= steps(view_radius=radius, searchers=searchers + 1)


@pytest.mark.parametrize("name, searchers, radius", [("4x4", 2, 0), ("5x5", 2, 1), ("5x5", 3, 0)])
def test_the_plan_finds_every_evader_of_the_game(name: str, searchers: int, radius: int) -> None:
    plan = fewest_steps_to_find(name, radius, searchers=searchers)
    assert plan.steps is not None and plan.cells.shape == (plan.steps + 1, searchers)
    assert not plan.contaminated[-1].any() and plan.contaminated[:-1].any(axis=1).all()
    task = make_task("chase", maze=name, num_chasers=searchers)
    maze = load_maze(name)
    simulator = Simulator(task, 2000, seed=5, auto_restart=False)
    simulator.positions[:, :searchers] = plan.cells[0]
    clean = np.flatnonzero(plan.contaminated[0])
    simulator.positions[:, searchers] = clean[np.arange(2000) % len(clean)]
    found = np.zeros(2000, dtype=bool)
    actions = np.zeros((2000, searchers + 1), dtype=np.int32)
    evader = [None] * searchers + [RandomAgent()]
    for before, now, dirty in zip(plan.cells, plan.cells[1:], plan.contaminated[1:], strict=False):
        assert not found.all()
        simulator.act(evader, actions)
        for searcher in range(searchers):
            ways = maze.neighbors[before[searcher], :4].tolist()
            actions[:, searcher] = ways.index(now[searcher])
        simulator.step(actions)
        running = ~simulator.ended
        assert (simulator.positions[running, :searchers] == now).all()
        theirs = simulator.positions[:, searchers]
        found |= simulator.active[:, searchers] == 0
        found |= (maze.distances[now][:, theirs] <= radius).any(axis=0)
        assert dirty[theirs[~found]].all()
    assert found.all()


@pytest.mark.parametrize(
    "settings, told",
    [
        ({"maze": "9x9"}, "81 cells"),
        ({"maze": "5x5", "searchers": 6}, "places"),
        ({"maze": "5x5", "searchers": 0}, "searchers"),
        ({"maze": "5x5", "start": (1, 2)}, "start"),
        ({"maze": "5x5", "start": 25}, "25"),
        ({"maze": "5x5", "speed": "two"}, "speed"),
        ({"maze": "5x5", "view_radius": -1}, "view_radius"),
        ({"maze": "5x5", "searchers": 3, "max_states": 1000}, "max_states=1000"),
    ],
)
def test_what_cannot_be_searched_is_refused(settings: Any, told: str) -> None:
    with pytest.raises(ValueError, match=told):
        fewest_steps_to_find(**settings)
