"""Where episodes begin: settings of the next one, starts, large mazes."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chisquare
from simulated import (
    CROWD,
    MARKED,
    MAZES,
    TASKS,
    assert_equal,
    assert_same,
    play,
    refused,
    snapshot,
)

from pursuit.mazes.generation import generate_maze
from pursuit.mazes.maze import MAX_TABLE_CELLS, Maze, load_maze
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task, make_task
from scripted_agents import (
    AStarChaser,
)

# -- settings --------------------------------------------------------------------------------------


def test_epsilon_takes_effect_at_the_next_restart_of_each_game_and_agent() -> None:
    simulator = Simulator(CROWD, 4)
    simulator.configure(epsilon=0.5)
    simulator.configure([1, 2], epsilon=[0.1, 0.2], seat="evader_1")
    assert np.isnan(simulator.epsilon).all()
    simulator.reset(games=[0, 1])
    assert np.isnan(simulator.epsilon[2:]).all()
    simulator.reset()
    evader = CROWD.seat("evader_1")
    assert simulator.epsilon[:, evader].tolist() == [0.5, 0.1, 0.2, 0.5]
    assert (np.delete(simulator.epsilon, evader, axis=1) == 0.5).all()
    simulator.configure(epsilon=[0.1, 0.2, 0.3, 0.4])  # one for each game
    simulator.configure([3], epsilon=np.nan, seat=0)  # the agent's own again
    simulator.reset()
    expected = np.repeat([[0.1], [0.2], [0.3], [0.4]], 6, axis=1)
    expected[3, 0] = np.nan
    np.testing.assert_array_equal(simulator.epsilon, expected)


def test_epsilon_lasts_until_it_is_configured_again() -> None:
    simulator = Simulator(CROWD, 3)
    simulator.epsilon[:] = 0.5
    simulator.epsilon[1, 2] = np.nan
    expected = np.full((3, 6), 0.5)
    expected[1, 2] = np.nan
    simulator.configure([2], epsilon=0.1, seat=0)
    for _ in range(2):
        np.testing.assert_array_equal(simulator.epsilon, expected)
        simulator.reset()
        expected[2, 0] = 0.1
    assert (simulator.next_epsilon == -1).all()
    simulator.epsilon = 0.25  # type: ignore[assignment]
    simulator.epsilon[:, 1] += 0.25
    play(simulator, 30)  # restarts by itself
    assert (simulator.epsilon[:, 1] == 0.5).all() and simulator.epsilon[0, 0] == 0.25


def test_one_number_per_game_has_the_same_effect_in_epsilon_and_configure() -> None:
    """With as many games as agents, a vector means one number per game."""
    now, later = Simulator(TASKS["chase"], 2), Simulator(TASKS["chase"], 2)
    assert now.num_agents == 2
    now.epsilon = [0.1, 0.9]  # type: ignore[assignment]
    later.configure(epsilon=[0.1, 0.9])
    later.reset()
    assert now.epsilon.tolist() == later.epsilon.tolist() == [[0.1, 0.1], [0.9, 0.9]]
    both = [[0.1, 0.2], [0.3, 0.4]]
    now.epsilon = both  # type: ignore[assignment]
    later.configure(epsilon=both)
    later.reset()
    assert now.epsilon.tolist() == later.epsilon.tolist() == both
    many = Simulator(TASKS["chase"], 3)
    for write in (
        lambda: setattr(many, "epsilon", [0.1, 0.9]),
        lambda: many.configure(epsilon=[0.1, 0.9]),
    ):
        with pytest.raises(ValueError, match=r"epsilon of shape \(2,\); give one number, \(3,\)"):
            write()
    assert np.isnan(many.epsilon).all()


@pytest.mark.parametrize("wrong", [np.inf, -0.1, 1.5, "much", None, [0.5, 2.0], {}, 1j])
def test_epsilon_is_a_probability(wrong: Any) -> None:
    simulator = Simulator(TASKS["chase"], 2)
    with pytest.raises(ValueError, match="epsilon"):
        simulator.epsilon = wrong
    with pytest.raises(ValueError, match="epsilon"):
        simulator.configure(epsilon=wrong if wrong is not None else "none")
    assert np.isnan(simulator.epsilon).all()


def test_settings_of_no_games_change_nothing() -> None:
    simulator = Simulator(CROWD, 3)
    before = snapshot(simulator)
    for value in ([], 1):
        simulator.configure([], maze=value, num_goals=value, epsilon=value, goal_radius=value)
        simulator.configure(np.zeros(3, dtype=bool), max_start_distance=value or [])
    assert_equal(snapshot(simulator), before)
    with pytest.raises(ValueError, match="maze: no value for 3 games"):
        simulator.configure(maze=[])


def collected_distances(simulator: Simulator, origin: Any) -> NDArray[np.int32]:
    """[games, goals]: the distance of every goal from the origin of its game."""
    maze = simulator.task.mazes[0]
    return np.stack(
        [maze.distances[cell][goals] for cell, goals in zip(origin, simulator.goals, strict=True)]
    )


@pytest.mark.parametrize(
    ("task", "collector"),
    [
        (Task(maze="6x6", num_runners=1, num_goals=3), 0),
        (Task(maze="6x6", num_chasers=1, num_evaders=2, num_goals=3), 1),
        (Task(maze="6x6", num_chasers=1, num_evaders=1, num_runners=2, num_goals=3), 2),
    ],
)
def test_goals_lie_within_the_radius_around_the_first_collector(task: Task, collector: int) -> None:
    simulator = Simulator(task, 400, seed=1)
    simulator.configure(goal_radius=4)
    simulator.reset()
    away = collected_distances(simulator, simulator.positions[:, collector])
    assert away.max() == 4 and away.min() >= 1
    assert_all_apart(simulator)
    simulator.configure(goal_radius=-1)
    simulator.reset()
    away = collected_distances(simulator, simulator.positions[:, collector])
    assert away.max() > 4


def assert_all_apart(simulator: Simulator) -> None:
    """Agents and present goals are on different cells."""
    for positions, goals in zip(simulator.positions, simulator.goals, strict=True):
        cells = [*positions, *goals[goals >= 0]]
        assert len(set(cells)) == len(cells)


def test_goals_lie_within_the_radius_around_a_mark() -> None:
    simulator = Simulator(Task(maze=MARKED, num_runners=1, num_goals=2), 400, seed=1)
    simulator.configure(goal_radius=1, goals_around="marks")
    simulator.reset()
    nearest = MARKED.distances[list(MARKED.goal_marks)].min(axis=0)
    assert (nearest[simulator.goals] <= 1).all()
    assert set(np.unique(simulator.goals)) == set(np.flatnonzero(nearest <= 1))
    simulator.configure(goals_around="start")
    simulator.reset()
    # A corridor's end has one neighbour only: there the second goal lies one step further.
    away = np.sort(collected_distances(simulator, simulator.positions[:, 0]), axis=1)
    degrees = MARKED.degrees[simulator.positions[:, 0]]
    assert (away[:, 0] == 1).all() and (away[:, 1] == np.where(degrees == 1, 2, 1)).all()


def test_a_radius_with_too_few_free_cells_grows() -> None:
    corridor = Maze.from_text("+-+-+-+-+-+-+\n|S          |\n+-+-+-+-+-+-+")
    simulator = Simulator(Task(maze=corridor, num_runners=1, num_goals=4, start="marks"), 50)
    for radius in (0, 1, 2, 4):
        simulator.configure(goal_radius=radius)
        simulator.reset()
        assert (np.sort(simulator.goals, axis=1) == [1, 2, 3, 4]).all()


def test_goals_within_the_radius_are_uniform() -> None:
    simulator = Simulator(Task(maze="5x5", num_runners=1, num_goals=1), 20_000, seed=5)
    simulator.configure(goal_radius=3)
    simulator.reset()
    maze = simulator.task.mazes[0]
    here = simulator.positions[:, 0] == 7
    around = np.flatnonzero((maze.distances[7] <= 3) & (np.arange(25) != 7))
    counts = np.bincount(simulator.goals[here, 0], minlength=25)
    assert counts.sum() == counts[around].sum() > 500
    assert chisquare(counts[around]).pvalue > 1e-4


def test_fewer_goals_can_be_configured() -> None:
    simulator = Simulator(make_task("maze"), 4)
    simulator.configure([0, 1, 2], num_goals=[0, 1, 2])
    simulator.reset()
    assert (simulator.goals >= 0).sum(axis=1).tolist() == [0, 1, 2, 3]
    simulator.configure(num_goals=-1)
    simulator.reset()
    assert (simulator.goals >= 0).all()


def test_start_distances_hold_between_every_chaser_and_every_evader() -> None:
    task = Task(maze="6x6", num_chasers=2, num_evaders=2, min_start_distance=3)
    simulator = Simulator(task, 500, seed=1)
    maze = task.mazes[0]
    for least, most in ((3, -1), (1, 2), (2, 5)):
        if (least, most) != (3, -1):
            simulator.configure(min_start_distance=least, max_start_distance=most)
        simulator.reset()
        away = maze.distances[simulator.positions[:, :2, None], simulator.positions[:, None, 2:]]
        assert away.min() == least
        assert away.max() == most if most >= 0 else away.max() > 6
        assert_all_apart(simulator)


def test_each_game_can_have_its_maze() -> None:
    simulator = Simulator(make_task("chase", maze=MAZES), 300, seed=0)
    counts = np.bincount(simulator.maze_index, minlength=3)
    assert chisquare(counts).pvalue > 1e-4
    simulator.configure(maze=1)
    simulator.configure([5], maze=2)
    before = simulator.maze_index.copy()
    play(simulator, 1)
    running = ~simulator.ended
    np.testing.assert_array_equal(simulator.maze_index[running], before[running])
    simulator.reset()
    assert (np.delete(simulator.maze_index, 5) == 1).all() and simulator.maze_index[5] == 2
    assert (simulator.positions[:5] < 16).all()
    simulator.configure(maze=-1)
    simulator.reset()
    assert set(simulator.maze_index) == {0, 1, 2}


@pytest.mark.parametrize(
    "bad",
    [
        {"epsilon": 1.5},
        {"epsilon": -0.1},
        {"epsilon": [0.1, 0.2]},
        {"epsilon": "much"},
        {"epsilon": 0.5, "seat": "runner"},
        {"epsilon": 0.5, "seat": 2},
        {"games": [4], "epsilon": 0.5},
        {"games": [True, False], "epsilon": 0.5},
        {"games": ["first"], "epsilon": 0.5},
        {"maze": 1},
        {"maze": -2},
        {"maze": 0.0},
        {"num_goals": 3},
        {"num_goals": -2},
        {"num_goals": 1.5},
        {"goal_radius": -2},
        {"goal_radius": 2**40},
        {"goal_radius": [1, 2, 3]},
        {"goals_around": "walls"},
        {"goals_around": "marks"},
        {"min_start_distance": 0},
        {"max_start_distance": -2},
        {"max_start_distance": np.nan},
        {"max_start_distance": 0},
        {"max_start_distance": 1},
        {"min_start_distance": 24},
        {"min_start_distance": []},
        {"num_goals": "two"},
        {"num_goals": {}},
        {"maze": [[0], [0, 0]]},
        {"goals_around": 5},
        {"goals_around": []},
        {"epsilon": {}},
        {"epsilon": 1j},
        {"epsilon": 0.5, "seat": 1.5},
        {"epsilon": 0.5, "seat": []},
    ],
    ids=str,
)
def test_a_bad_setting_is_refused_and_changes_nothing(bad: dict[str, Any]) -> None:
    without_marks = generate_maze("open", 5, 5)
    task = Task(maze=without_marks, num_chasers=1, num_evaders=1, num_goals=2)
    simulator = Simulator(task, 4)
    good = {"epsilon": 0.7, "num_goals": 1, "maze": 0, "min_start_distance": 2}
    with refused(simulator):
        simulator.configure(**{**good, **bad})


# -- starts ----------------------------------------------------------------------------------------


def test_starts_are_uniform_over_all_placements() -> None:
    task = Task(maze="2x2", num_chasers=1, num_evaders=1, num_runners=1, num_goals=1)
    simulator = Simulator(task, 24_000, seed=3)
    assert_all_apart(simulator)
    placements = np.c_[simulator.positions, simulator.goals]
    _, counts = np.unique(placements, axis=0, return_counts=True)
    assert len(counts) == 24 and chisquare(counts).pvalue > 1e-4


def test_starts_that_are_kept_apart_are_uniform_over_those_that_are() -> None:
    task = Task(maze="3x3", num_chasers=1, num_evaders=1, min_start_distance=3)
    simulator = Simulator(task, 20_000, seed=3)
    pairs, counts = np.unique(simulator.positions, axis=0, return_counts=True)
    np.testing.assert_array_equal(pairs, np.argwhere(task.mazes[0].distances >= 3))
    assert chisquare(counts).pvalue > 1e-4


def test_starts_of_later_episodes_are_uniform_too() -> None:
    task = Task(maze="2x2", num_chasers=1, num_evaders=1, max_steps=3)
    simulator = Simulator(task, 2000, seed=3)
    counts = np.zeros(16)
    for _ in range(30):
        simulator.step(np.zeros((2000, 2), dtype=np.int32))
        fresh = simulator.ended
        counts += np.bincount(simulator.positions[fresh] @ [4, 1], minlength=16)
    assert (counts[[0, 5, 10, 15]] == 0).all()
    assert chisquare(counts[counts > 0]).pvalue > 1e-4


def test_starts_on_marks() -> None:
    first, second = MARKED.goal_marks
    chase = Task(maze=MARKED, num_chasers=1, num_evaders=3, start="marks")
    simulator = Simulator(chase, 200)
    assert (simulator.positions[:, :3] == [MARKED.start_mark, first, second]).all()
    assert len(np.unique(simulator.positions[:, 3])) == MARKED.num_cells - 3
    race = Task(maze=MARKED, num_runners=2, num_goals=3, start="marks")
    simulator = Simulator(race, 200)
    assert (simulator.positions[:, 0] == MARKED.start_mark).all()
    assert (simulator.goals[:, :2] == [first, second]).all()
    assert_all_apart(simulator)  # agents without a mark avoid the marked goals
    assert len(np.unique(simulator.positions[:, 1])) == MARKED.num_cells - 3
    simulator.configure(num_goals=1)
    simulator.reset()
    assert_all_apart(simulator)
    assert (simulator.goals == [first, -1, -1]).all() and second in simulator.positions[:, 1]


# -- large mazes -----------------------------------------------------------------------------------


@cache
def large() -> Maze:
    return generate_maze("prim", 70, 70, loops=0.1, seed=1)


def test_settings_apply_in_mazes_without_a_distance_table() -> None:
    maze = large()
    assert maze.num_cells > MAX_TABLE_CELLS
    task = Task(
        maze=maze, num_chasers=1, num_evaders=1, num_runners=1, num_goals=3, min_start_distance=30
    )
    simulator = Simulator(task, 40, seed=2)
    simulator.configure(goal_radius=5, max_start_distance=60)
    simulator.reset()
    assert_all_apart(simulator)
    spread = []
    for (chaser, evader, runner), goals in zip(simulator.positions, simulator.goals, strict=True):
        spread.append(maze.distances_from(int(chaser))[evader])
        assert maze.distances_from(int(runner))[goals].min() >= 1
        assert maze.distances_from(int(runner))[goals].max() <= 5
    assert min(spread) >= 30 and max(spread) <= 60
    assert maze.num_cells / 4 < simulator.positions.mean() < maze.num_cells * 3 / 4


def test_mazes_without_a_distance_table_are_played_and_deterministic() -> None:
    task = Task(
        maze=(large(), load_maze("5x5")),
        num_chasers=1,
        num_evaders=1,
        num_runners=1,
        num_goals=2,
        max_steps=20,
    )

    def near(first_game: int, num_games: int) -> Simulator:
        simulator = Simulator(task, num_games, seed=4, first_game=first_game)
        simulator.configure(goal_radius=4, max_start_distance=4)
        simulator.configure(maze=np.arange(first_game, first_game + num_games) % 3 - 1)
        return simulator

    # Draws until chaser and evader are that near, which few of the random starts are.
    batch = play(near(0, 4), 40)
    for game in range(4):
        assert_same(batch, game, play(near(game, 1), 40), 0)
    assert any(moment["ended"].any() for moment in batch)


def test_a_chaser_walks_a_shortest_path_in_a_large_maze() -> None:
    maze = large()
    simulator = Simulator(Task(maze=maze, num_chasers=1, num_evaders=1, max_steps=10_000), 8)
    simulator.configure(min_start_distance=20)
    simulator.reset()
    starts, still = simulator.positions.copy(), np.zeros((8, 2), dtype=np.int32)
    distances = [maze.distances_from(int(evader))[chaser] for chaser, evader in starts]
    walls = [np.flatnonzero(maze.neighbors[e, :4] == e)[:1].tolist() for e in starts[:, 1]]
    simulator = Simulator(simulator.task, 8, auto_restart=False)
    simulator.place(starts)
    still[:, 1] = [wall[0] if wall else 0 for wall in walls]
    while not (
        simulator.terminated.all() or simulator.truncated.all()
    ) and simulator.steps.max() < max(distances):
        simulator.act([AStarChaser(), None], still)
        simulator.step(still)
    bumping = [bool(wall) for wall in walls]
    assert sum(bumping) > 4
    np.testing.assert_array_equal(simulator.steps[bumping], np.array(distances)[bumping])
