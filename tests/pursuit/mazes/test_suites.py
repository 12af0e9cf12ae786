"""Maze suites: contents, no duplicates, and reproducible files."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from shipped_mazes import suite_tables, sums_text

import pursuit
from pursuit import chase_v0
from pursuit.mazes.generation import generate_maze
from pursuit.mazes.maze import Maze, load_maze
from pursuit.mazes.suite_files import SIZES, SPLITS, SUITES, SUMS, read_rows, suite_names
from pursuit.mazes.suites import least_copy, load_mazes, load_suite
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task, make_task
from scripted_agents import shortest_path


@pytest.mark.parametrize("size", SIZES)
def test_suites_contain_no_duplicates_or_symmetric_copies(size: int) -> None:
    copies = []
    for split, number in SPLITS.items():
        suite = load_suite(f"{size}x{size}-{split}")
        assert len(suite) == number
        assert all(
            (maze.height, maze.width, maze.is_connected) == (size, size, True) for maze in suite
        )
        copies += [least_copy(maze) for maze in suite]
    assert len(set(copies)) == len(copies) == sum(SPLITS.values())


def test_copies_are_the_eight_turns_and_mirrors() -> None:
    maze = generate_maze("wilson", 4, 3, seed=3)
    other = generate_maze("wilson", 4, 3, seed=4)
    grid = np.array([list(line) for line in maze.to_text().splitlines()])
    turned = [np.rot90(side, turns) for side in (grid, grid[::-1]) for turns in range(4)]
    swap = {"-": "|", "|": "-"}
    for number, each in enumerate(turned):
        lines = ["".join(swap.get(c, c) if number % 2 else c for c in line) for line in each]
        assert least_copy(Maze.from_text("\n".join(lines))) == least_copy(maze)
    assert least_copy(maze) != least_copy(other)


def test_every_kind_is_spread_evenly_and_is_what_its_row_says() -> None:
    rows = read_rows("7x7-test")
    assert set(Counter(row.kind for row in rows).values()) == {16, 17}
    assert len({row.kind for row in rows}) == 12
    for row, maze in zip(rows[::17], load_suite("7x7-test")[::17], strict=True):
        made = generate_maze(
            row.generator, 7, loops=row.loops, no_dead_ends=row.no_dead_ends, seed=row.seed
        )
        assert made == maze and row.name == maze.name


@pytest.mark.slow
def test_the_files_are_what_the_generators_make() -> None:
    for name, content in suite_tables().items():
        assert (SUITES / name).read_bytes() == content


def test_the_files_match_the_shipped_checksums() -> None:
    tables = {path.name: path.read_bytes() for path in SUITES.glob("*.csv")}
    assert (SUITES / SUMS).read_text() == sums_text(tables)


def test_suite_names_are_accepted_as_mazes() -> None:
    suite = pursuit.load_suite("5x5-test")
    assert pursuit.suite_names() == suite_names() and len(suite_names()) == 18
    assert load_maze("suite:5x5-test/017") == suite[17] and suite[17].name == "5x5-test/017"
    assert load_suite("suite:5x5-test/3-5") == suite[3:6] == load_mazes("suite:5x5-test/3-5")
    assert load_mazes(["3x3", "suite:5x5-test/3-5"]) == (load_maze("3x3"), *suite[3:6])
    assert shortest_path("suite:5x5-test/017", 0, 24)[0] == 0
    task = make_task("maze", maze="suite:5x5-test")
    assert task.mazes == suite and hash(task) == hash(make_task("maze", maze="suite:5x5-test"))
    env = chase_v0.parallel_env(maze="suite:5x5-test/0-9", observation="planes")
    drawn = set()
    for seed in range(40):
        observations, _ = env.reset(seed=seed)
        drawn.add(observations["chaser_0"][6:].tobytes())
    assert len(drawn) == 10


@pytest.mark.parametrize(
    ("name", "remedy"),
    [
        ("suite:6x6-train", "unknown suite .* suites: 5x5-train, 5x5-validation"),
        ("suite:5x5-test/200", "the mazes of suite 5x5-test are 0 to 199"),
        ("suite:5x5-test/5-3", "the mazes of suite 5x5-test are 0 to 199"),
        ("suite:5x5-test/x", "unknown suite"),
        (
            "suite:5x5-test",
            "is 200 mazes, but one is needed; give one of them, such as suite:5x5-test/000",
        ),
    ],
)
def test_unknown_suites_are_refused_with_the_remedy(name: str, remedy: str) -> None:
    with pytest.raises(ValueError, match=remedy):
        load_maze(name)


def test_games_in_a_thousand_mazes_equal_games_in_single_mazes() -> None:
    together = Simulator(make_task("chase", maze="suite:5x5-train"), 1000, seed=3)
    together.configure(maze=np.arange(1000))
    together.reset()
    mazes, rng = load_suite("5x5-train"), np.random.default_rng(0)
    alone = {n: Simulator(make_task("chase", maze=mazes[n]), 1) for n in (0, 499, 999)}
    for number, simulator in alone.items():
        simulator.place(together.positions[number])
    for _ in range(20):
        actions = rng.integers(0, 4, (1000, 2))
        running = {n for n in alone if not together.ended[n]}
        together.step(actions)
        for number in list(alone):
            if number in running:
                alone[number].step(actions[[number]])
            if together.ended[number]:
                alone.pop(number)
        for number, simulator in alone.items():
            assert (simulator.positions[0] == together.positions[number]).all()


def test_the_task_counts_its_largest_maze() -> None:
    task = Task(maze=("suite:5x5-test/0-3", "7x7"), num_runners=1, num_goals=1)
    assert [maze.num_cells for maze in task.mazes] == [25, 25, 25, 25, 49]
    assert task.max_cells == 49
