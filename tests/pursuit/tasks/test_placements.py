"""Start distances: limits hold exactly, and placements are uniform."""

from __future__ import annotations

from itertools import permutations
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chisquare
from simulated import MARKED, play, refused

from pursuit.mazes.generation import generate_maze
from pursuit.mazes.maze import UNREACHABLE, Maze, load_maze
from pursuit.rules.layout import Teams
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.placements import StartConstraint, check_placeable
from pursuit.tasks.task import Task, make_task

PARTS = Maze.from_text("+-+-+-+\n|   | |\n+-+-+-+", name="two parts")
BLOCKED = Maze.from_text("+-+-+-+\n|S  |G|\n+ +-+ +\n| |G  |\n+ + + +\n|    #|\n+-+-+-+")
LONG = Maze.from_text("+" + "-+" * 100 + "\n|" + "  " * 99 + " |\n+" + "-+" * 100, name="long")


def all_placements(asked: StartConstraint) -> list[tuple[int, ...]]:
    """Every placement of chasers and evaders that holds, by brute force."""
    maze, (chasers, evaders) = asked.maze, asked.teams[:2]
    cells = np.array(list(permutations(range(maze.num_cells), chasers + evaders)))
    away = maze.distances[cells[:, :chasers, None], cells[:, None, chasers:]]
    holds = away >= asked.least
    if asked.most >= 0:
        holds &= (away <= asked.most) & (away != UNREACHABLE)
    right = holds.all(axis=(1, 2))
    if asked.marked:
        right &= cells[:, 0] == (cells[:, 0] if maze.start_mark is None else maze.start_mark)
        if asked.teams.goals == 0:
            for agent, mark in zip(
                range(chasers, chasers + evaders), maze.goal_marks, strict=False
            ):
                right &= cells[:, agent] == mark
        right &= ~np.isin(cells, maze.goal_marks[: asked.num_goals]).any(axis=1)
    return [tuple(row) for row in cells[right].tolist()]


@pytest.mark.parametrize(
    ("maze", "teams", "marked", "least", "most"),
    [
        ("3x3", (1, 1, 0, 0), False, 3, -1),
        ("3x3", (1, 1, 0, 0), False, 1, 2),
        ("3x3", (1, 3, 0, 0), False, 2, -1),
        ("3x3", (2, 1, 0, 0), False, 2, 3),
        ("3x3-open", (2, 2, 0, 0), False, 2, -1),
        ("2x2-tree", (1, 2, 0, 0), False, 1, 2),
        ("3x3-tree", (2, 2, 0, 0), False, 1, 3),
        (Maze.from_text("+-+-+-+\n|     |\n+-+-+-+\n|     |\n+-+-+-+"), (3, 3, 0, 0), False, 9, -1),
        (PARTS, (1, 1, 0, 0), False, 2, -1),
        (PARTS, (1, 1, 0, 0), False, 1, 1),
        (MARKED, (1, 3, 0, 0), True, 2, -1),
        (MARKED, (2, 1, 0, 0), True, 2, -1),
        (MARKED, (2, 2, 0, 0), True, 2, 5),
        (BLOCKED, (1, 1, 0, 2), True, 3, -1),
        (BLOCKED, (2, 2, 0, 2), True, 2, -1),
    ],
    ids=str,
)
def test_placements_are_uniform_over_all_that_hold(
    maze: Any, teams: tuple[int, int, int, int], marked: bool, least: int, most: int
) -> None:
    """Against an enumeration, for duels, teams and marks."""
    start = "marks" if marked else "random"
    numbers = dict(
        zip(("num_chasers", "num_evaders", "num_runners", "num_goals"), teams, strict=True)
    )
    task = Task(maze=maze, start=start, min_start_distance=least, **numbers)  # type: ignore[arg-type]
    asked = task.apart(0, -1, least, most)
    expected = all_placements(asked)
    simulator = Simulator(task, 10 * len(expected) + 200, seed=7)
    simulator.configure(max_start_distance=most)
    simulator.reset()
    cells, counts = np.unique(simulator.positions, axis=0, return_counts=True)
    assert [tuple(row) for row in cells.tolist()] == sorted(expected)
    assert len(expected) == 1 or chisquare(counts).pvalue > 1e-4


@pytest.mark.parametrize(
    ("maze", "teams", "least", "most"),
    [
        ("3x3", (3, 3, 0, 0), 1, 1),
        ("3x3-open", (3, 3, 0, 0), 1, 2),
        ("4x4-tree", (2, 2, 0, 0), 9, -1),
        ("4x4", (2, 2, 0, 0), 8, -1),
        (PARTS, (1, 2, 0, 0), 3, -1),
        (PARTS, (2, 1, 0, 0), 3, -1),
    ],
    ids=str,
)
def test_existing_placements_match_an_enumeration(
    maze: Any, teams: tuple[int, int, int, int], least: int, most: int
) -> None:
    asked = StartConstraint(load_maze(maze), Teams(*teams), False, 0, least, most)
    if all_placements(asked):
        check_placeable(asked)
    else:
        with pytest.raises(ValueError, match="no random placement of"):
            check_placeable(asked)


@pytest.mark.parametrize(("maze", "least"), [("15x15", 28), ("9x9", 18), (LONG, 99)], ids=str)
def test_the_rarest_start_that_is_legal_never_fails(maze: Any, least: int) -> None:
    for seed in range(8):
        simulator = Simulator(make_task("chase", maze=maze, min_start_distance=least), 20, seed)
        assert (distances(simulator) >= least).all()


def distances(simulator: Simulator) -> NDArray[np.int32]:
    """[games] between the first chaser and the first evader."""
    task, positions = simulator.task, simulator.positions
    return task.mazes[0].distances[positions[:, 0], positions[:, task.num_chasers]]


def test_rare_starts_of_whole_games_are_uniform_and_belong_to_the_game() -> None:
    """Six of 9900 pairs hold."""
    task = Task(maze=LONG, num_chasers=1, num_evaders=1, num_runners=1, min_start_distance=98,
                num_goals=1, max_steps=2)  # fmt: skip
    simulator = Simulator(task, 400, seed=3)
    pairs, counts = np.unique(simulator.positions[:, :2], axis=0, return_counts=True)
    assert [tuple(pair) for pair in pairs.tolist()] == [
        (0, 98), (0, 99), (1, 99), (98, 0), (99, 0), (99, 1),
    ]  # fmt: skip
    assert chisquare(counts).pvalue > 1e-4
    cells = np.c_[simulator.positions, simulator.goals]
    assert all(len(set(row)) == 4 for row in cells.tolist())
    assert len(np.unique(simulator.positions[:, 2])) > 80
    alone = Simulator(task, seed=3, first_game=7)
    for _ in range(6):  # and restarts in steps of their own
        np.testing.assert_array_equal(alone.positions[0], simulator.positions[7])
        np.testing.assert_array_equal(alone.goals[0], simulator.goals[7])
        np.testing.assert_array_equal(alone.streams[0], simulator.streams[7])
        alone.step(np.zeros((1, 3), dtype=np.int32))
        simulator.step(np.zeros((400, 3), dtype=np.int32))


def test_impossible_placements_are_refused() -> None:
    ring = Maze.from_text("+-+-+-+\n|     |\n+ +-+ +\n| |#| |\n+ +-+ +\n|     |\n+-+-+-+")
    simulator = Simulator(Task(maze=ring, num_chasers=2, num_evaders=2), 2)
    with pytest.raises(ValueError, match=r"no random placement of 2 chaser.*Lower the min"):
        simulator.configure(min_start_distance=3, max_start_distance=3)


def test_large_mazes_without_tables_are_searched_too() -> None:
    maze = generate_maze("prim", 70, 70, seed=1)
    longest = maze.longest_distance
    task = Task(maze=maze, num_chasers=1, num_evaders=1, min_start_distance=longest // 2)
    simulator = Simulator(task, 6)
    for chaser, evader in simulator.positions.tolist():
        assert maze.distances_from(chaser)[evader] >= longest // 2
    with pytest.raises(ValueError, match=f"min_start_distance={longest + 1}: no random placement"):
        simulator.configure(min_start_distance=longest + 1)
    simulator.configure(min_start_distance=1, max_start_distance=1)
    simulator.reset()
    for chaser, evader in simulator.positions.tolist():
        assert maze.distances_from(chaser)[evader] == 1


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (
            {"min_start_distance": 11},
            "min_start_distance=11: no .* 1 chaser.*5x5.*10\\). Lower the minimum",
        ),
        ({"min_start_distance": 10, "num_chasers": 3}, "3 chaser.*5x5.*Lower"),
        (
            {"min_start_distance": 9, "start": "marks", "maze": MARKED},
            "with marks .*Lower the minimum",
        ),
        ({"min_start_distance": 7, "maze": ("9x9", "3x3")}, "in 3x3"),
    ],
    ids=str,
)
def test_tasks_without_valid_placements_are_refused(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make_task("chase", **settings)


def test_settings_without_valid_placements_are_refused() -> None:
    simulator = Simulator(make_task("chase", maze=("9x9", "3x3"), min_start_distance=2), 4)
    for wrong, message in (
        ({"min_start_distance": 7}, "in 3x3.*Lower"),
        ({"min_start_distance": [2, 2, 7, 2], "maze": [0, 0, 1, 1]}, "in 3x3"),
        ({"max_start_distance": 1}, "=2 and max_start_distance=1.*Lower the minimum, raise"),
    ):
        with pytest.raises(ValueError, match=message):
            simulator.configure(**wrong)
    simulator.configure(min_start_distance=[2, 7, 2, 2], maze=[1, 0, 1, -1])
    with pytest.raises(ValueError, match=r"min_start_distance=7.*in 3x3"):
        simulator.configure([1], maze=-1)
    simulator.reset()
    simulator.configure(min_start_distance=1, max_start_distance=1)
    simulator.reset()
    play(simulator, 50)


ONE_SIDE: dict[str, dict[str, Any]] = {
    "maze": {"num_runners": 1, "num_goals": 1},
    "race": {"num_runners": 2, "num_goals": 3},
    "evaders": {"num_evaders": 2, "num_goals": 2},
    "chasers": {"num_chasers": 1, "num_runners": 1, "num_goals": 1},
}


@pytest.mark.parametrize("teams", ONE_SIDE.values(), ids=ONE_SIDE)
def test_start_distances_are_refused_without_chasers_or_without_evaders(
    teams: dict[str, Any],
) -> None:
    """Means over starts would leave out starts that the games draw."""
    with pytest.raises(ValueError, match=r"min_start_distance=4: .* num_evaders=\d; leave it out"):
        Task(maze="5x5", min_start_distance=4, **teams)
    assert Task(maze="5x5", min_start_distance=1, **teams).min_start_distance == 1


def test_cells_that_no_path_joins_are_infinitely_far_apart() -> None:
    """For the task and for `configure`, in mazes with a table and without one."""
    for maze in (PARTS, split(70)):
        far = 10 * maze.num_cells
        task = Task(maze=maze, num_chasers=1, num_evaders=1, min_start_distance=far)
        simulator = Simulator(task, 30, seed=1)
        for chaser, evader in simulator.positions.tolist():
            assert maze.distances_from(chaser)[evader] == UNREACHABLE
        simulator.configure(min_start_distance=1, max_start_distance=far)
        simulator.reset()
        for chaser, evader in simulator.positions.tolist():
            assert maze.distances_from(chaser)[evader] < UNREACHABLE
        with pytest.raises(ValueError, match=r"min_start_distance=.* and max_start_distance="):
            simulator.configure(min_start_distance=far, max_start_distance=far)


def split(size: int) -> Maze:
    """Two halves of an open square, without a way between them."""
    south = np.ones((size - 1, size), dtype=bool)
    south[size // 2 - 1] = False
    return Maze(np.ones((size, size), dtype=bool), south, np.ones((size, size - 1), dtype=bool))


# -- given cells -----------------------------------------------------------------------------------


def test_place_starts_an_episode_in_the_given_cells() -> None:
    task = make_task("heist", maze="5x5")
    simulator = Simulator(task, 3, seed=0)
    play(simulator, 5)
    simulator.place([[0, 1], [2, 3], [4, 5]], [6, 7, -1])
    assert simulator.positions.tolist() == [[0, 1], [2, 3], [4, 5]]
    assert simulator.goals.tolist() == [[6, 7, -1]] * 3
    assert not simulator.steps.any() and simulator.active.all()


@pytest.mark.parametrize(
    ("positions", "goals"),
    [
        ([0, 25], [1, 2, 3]),
        ([0, -1], [1, 2, 3]),
        ([0, 1], [2, 3, 25]),
        ([0, 1], [2, 3, -2]),
        ([0, 0], [1, 2, 3]),
        ([0, 1], [2, 2, 3]),
        ([0, 1], [1, 2, 3]),
        ([0, 1], None),
        ([0.5, 1], [2, 3, 4]),
        ([0, 1, 2], [3, 4, 5]),
        ([], [3, 4, 5]),
        (None, [3, 4, 5]),
        ("ab", [3, 4, 5]),
        ([[0], [1, 2]], [3, 4, 5]),
        ([0, 2**70], [3, 4, 5]),
    ],
)
def test_place_refuses_invalid_starts_and_changes_nothing(positions: Any, goals: Any) -> None:
    simulator = Simulator(make_task("heist", maze="5x5"), 2, auto_restart=False)
    play(simulator, 3)
    with refused(simulator):
        simulator.place(positions, goals)
    with refused(simulator, "seed"):
        simulator.place([0, 1], [2, 3, 4], seed=-1)


def test_place_needs_a_maze_if_there_are_several() -> None:
    simulator = Simulator(make_task("chase", maze=("3x3", "5x5")), 40)
    for wrong in (None, 2, -1, 0.5, [0, 1]):
        with pytest.raises(ValueError, match="maze"):
            simulator.place([0, 8], maze=wrong)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"cell 9.*maze 3x3 are 0 to 8"):
        simulator.place([0, 9], maze=[0] + [1] * 39)
    for _ in range(5):
        simulator.place([0, 24], maze=1)
        assert (simulator.maze_index == 1).all() and (simulator.positions == [0, 24]).all()
    simulator.configure(maze=0)
    simulator.place([0, 8])
    assert (simulator.maze_index == 0).all()


def test_place_needs_no_goals_where_there_are_none() -> None:
    simulator = Simulator(make_task("chase"), 2)
    simulator.place([0, 8], [])
    with pytest.raises(ValueError, match="this task has no goals"):
        simulator.place([0, 8], [3])
