"""The team that gathers, beside the same rule in plain Python, and what a chaser may know."""

from __future__ import annotations

from collections import deque
from typing import Any

import gymnasium
import numpy as np
import pytest

from pursuit.mazes.generation import generate_maze
from pursuit.mazes.maze import Maze, load_maze
from pursuit.rules.layout import Games, copied_games, empty_games
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task
from scripted_agents import (
    GatheringTeam,
    RandomAgent,
    UniformAgent,
    evaluate_joint,
)
from scripted_agents.agents.gathering import closed_walk
from scripted_agents.environments import scripted_policy
from scripted_agents.exact.references import is_table_in
from scripted_agents.names import plays
from train.settings.presets import preset_task
from train.settings.task import TaskSettings

NORTH, SOUTH, EAST, WEST = range(4)
ROUND = (NORTH, EAST, SOUTH, WEST)


def holes(seed: int) -> Maze:
    """A maze with blocked cells, in which some cells may be out of reach."""
    walkable = np.random.default_rng(seed).random((8, 9)) < 0.8
    return Maze(walkable, np.ones((7, 9), dtype=bool), np.ones((8, 8), dtype=bool), name="holes")


MAZES = [
    load_maze("pursuit_v5"),
    load_maze("9x9-tree"),
    load_maze("7x7-open"),
    generate_maze("prim", height=8, width=11, loops=0.3, seed=1),
    holes(1),
    holes(2),
]


# -- the rule in plain Python ----------------------------------------------------------------------


def steps_to(maze: Maze, goal: int) -> dict[int, int]:
    """The steps from every cell to a goal; cells without a path are missing."""
    found, queue = {goal: 0}, deque([goal])
    while queue:
        cell = queue.popleft()
        for after in maze.neighbors[cell, :4].tolist():
            if after not in found:
                found[after] = found[cell] + 1
                queue.append(after)
    return found


class Rule:
    """The moves of the team in one maze."""

    def __init__(self, maze: Maze, reach: int, surround: bool, stay: bool) -> None:
        self.maze, self.reach, self.surround, self.stay = maze, reach, surround, stay
        self.steps = [steps_to(maze, goal) for goal in range(maze.num_cells)]
        self.walk = closed_walk(maze, reach)
        self.place = list(zip(maze.rows.tolist(), maze.columns.tolist(), strict=True))

    def sees(self, own: int, other: int) -> bool:
        (row, column), (there, across) = self.place[own], self.place[other]
        return abs(row - there) <= self.reach and abs(column - across) <= self.reach

    def beside(self, cell: int, side: int) -> int:
        return int(self.maze.neighbors[cell, ROUND[side % 4]])

    def action(self, own: int, goal: int) -> int:
        after = self.maze.neighbors[own, :4].tolist()
        far = self.steps[goal]
        nearer = [a for a in range(4) if far.get(after[a], 999) < far.get(own, 999)]
        walls = [a for a in range(4) if after[a] == own]
        if nearer:
            return nearer[0]
        if self.stay:
            return 4
        return (walls or [0])[0]

    def target(self, team: list[int], evaders: list[int]) -> int | None:
        rated = []
        for cell in evaders:
            if all(self.sees(own, cell) for own in team):
                total = 0
                for number, own in enumerate(team):
                    end = self.beside(cell, number) if self.surround else cell
                    total += self.steps[end].get(own, 65535)
                rated.append((total, cell))
        return min(rated)[1] if rated else None

    def side(self, target: int, number: int, team: list[int]) -> int:
        open_sides = [s for s in range(4) if self.beside(target, s) != target]
        if not open_sides:
            return target
        if len(team) < 4:
            return self.beside(target, open_sides[number % len(open_sides)])
        if number % 4 in open_sides:
            return self.beside(target, number)
        begin = number + 1 + 2 * (number // 4)
        order = [s % 4 for s in range(begin, begin + 4) if s % 4 in open_sides]
        far = [self.steps[self.beside(target, s)].get(team[number], 65535) for s in order]
        return self.beside(target, order[far.index(min(far))])

    def patrol(self, number: int, team: list[int], step: int) -> int:
        places = [self.place[own] for own in team]
        middle = [int(np.floor(np.mean(axis) + 0.5)) for axis in zip(*places, strict=True)]
        centre = team[number]
        if tuple(middle) in self.place:
            centre = self.place.index((middle[0], middle[1]))
        if len(set(self.walk)) < len(self.walk):
            ahead = self.walk[step % len(self.walk)]
        else:
            far = [self.steps[cell].get(centre, 99999) for cell in self.walk]
            ahead = self.walk[(far.index(min(far)) + 1) % len(self.walk)]
        after = self.maze.neighbors[centre, :4].tolist()
        to = self.steps[ahead]
        nearer = [cell for cell in after if to.get(cell, 999) < to.get(centre, 999)]
        goal = nearer[0] if nearer else centre
        return self.beside(goal, number) if self.surround else goal

    def __call__(self, number: int, team: list[int], evaders: list[int], step: int) -> int:
        own = team[number]
        if not all(self.sees(own, other) for other in team):
            return self.action(own, self.walk[0])
        target = self.target(team, evaders)
        if target is None:
            return self.action(own, self.patrol(number, team, step))
        return self.action(own, self.side(target, number, team) if self.surround else target)


def states(task: Task, count: int, rng: np.random.Generator) -> Games:
    """Random states, most of them with the chasers, and some evaders, near one cell."""
    games = empty_games(count, task.num_agents, 0)
    for game in range(count):
        maze = int(rng.integers(len(task.mazes)))
        grid = task.mazes[maze]
        centre, size = rng.integers(grid.num_cells), int(rng.choice([1, 2, 3, 20]))
        away = np.maximum(
            abs(grid.rows - grid.rows[centre]), abs(grid.columns - grid.columns[centre])
        )
        games.maze[game] = maze
        games.position[game] = rng.integers(grid.num_cells, size=task.num_agents)
        games.position[game, : task.num_chasers] = rng.choice(
            np.flatnonzero(away <= size), size=task.num_chasers
        )
    games.active[:] = rng.random(games.active.shape) < 0.5
    games.active[:, : task.num_chasers] = 1
    games.steps[:] = rng.integers(500, size=count)
    return games


@pytest.mark.parametrize(
    ("chasers", "capture", "stay", "obs_range"),
    [(8, "surround", True, 7), (4, "surround", False, 5), (2, "surround", True, 7),
     (1, "surround", True, 9), (12, "surround", True, 7), (3, "cell", False, 7),
     (2, "adjacent", True, 3), (1, "cell", False, 1)],
)  # fmt: skip
def test_it_moves_as_the_rule_says(chasers: int, capture: Any, stay: bool, obs_range: int) -> None:
    task = Task(MAZES, num_chasers=chasers, num_evaders=4, capture=capture, stay_action=stay)
    games = states(task, 600, np.random.default_rng(chasers))
    rules = [Rule(maze, obs_range // 2, capture == "surround", stay) for maze in task.mazes]
    agent = GatheringTeam(obs_range=obs_range)
    for seat in range(chasers):
        moves = agent.moves(task, games, seat)
        for game in range(len(moves)):
            cells, free = games.position[game].tolist(), games.active[game]
            evaders = [cells[i] for i in range(chasers, chasers + 4) if free[i]]
            rule = rules[games.maze[game]]
            action = rule(seat, cells[:chasers], evaders, int(games.steps[game]))
            changes = rule.maze.neighbors[cells[seat], :4] != cells[seat]
            every = int(changes @ (1 << np.arange(4)))
            assert moves[game].tolist() == [1 << action, every], (game, seat)


def test_only_the_own_window_counts() -> None:
    """Agents out of the window of a chaser are moved to other cells out of it."""
    task = Task(MAZES, num_chasers=4, num_evaders=6, capture="surround", stay_action=True)
    rng, agent = np.random.default_rng(7), GatheringTeam()
    games = states(task, 2000, rng)
    moved, kept = 0, 0
    for seat in range(4):
        other = copied_games(games, np.arange(2000))
        for game in range(2000):
            grid = task.mazes[games.maze[game]]
            own = games.position[game, seat]
            away = np.maximum(
                abs(grid.rows - grid.rows[own]), abs(grid.columns - grid.columns[own])
            )
            outside = np.flatnonzero(away > 3)
            hidden = np.flatnonzero(away[games.position[game]] > 3)
            if len(outside):
                other.position[game, hidden] = rng.choice(outside, size=len(hidden))
                moved += len(hidden)
                kept += bool((hidden >= 4).any() and (hidden >= 4).all())
        np.testing.assert_array_equal(
            agent.moves(task, games, seat), agent.moves(task, other, seat)
        )
    assert moved > 5000 and kept > 500  # in `kept` states it sees all chasers and not all evaders


# -- where it goes ---------------------------------------------------------------------------------


@pytest.mark.parametrize("maze", MAZES, ids=lambda maze: maze.name)
def test_the_walk_is_closed_and_sees_all_cells(maze: Maze) -> None:
    walk = closed_walk(maze, 3)
    assert len(walk) == 1 or all(
        after in maze.neighbors[cell, :4]
        for cell, after in zip(walk, walk[1:] + walk[:1], strict=True)
    )
    parts = [set(steps_to(maze, cell)) for cell in range(maze.num_cells)]
    for cell in max(parts, key=len):
        away = np.maximum(
            abs(maze.rows[walk] - maze.rows[cell]), abs(maze.columns[walk] - maze.columns[cell])
        )
        assert away.min() <= 3


def preset() -> Task:
    return TaskSettings(**preset_task("sisl-pursuit", TaskSettings)).build()


def played(task: Task, evader: Any, games: int, agent: Any = None) -> Simulator:
    """Games that are played to their ends."""
    simulator = Simulator(task, games, 1, auto_restart=False)
    policies = [agent or GatheringTeam()] * task.num_chasers + [evader] * task.num_evaders
    actions = np.zeros((games, task.num_agents), dtype=np.int32)
    while not (simulator.terminated | simulator.truncated).all():
        simulator.act(policies, actions)
        simulator.step(actions)
    return simulator


def test_its_return_in_pursuit_v5() -> None:
    simulator = played(preset(), UniformAgent(), 60)
    assert simulator.returns[:, :8].mean() > 120
    assert simulator.terminated.all()
    assert not GatheringTeam().uses_clock(simulator.task)


@pytest.mark.parametrize(
    ("maze", "settings"),
    [
        ("7x7-open", {"num_chasers": 2, "num_evaders": 1, "n_catch": 2}),
        ("9x9-open", {"num_chasers": 4, "num_evaders": 2, "capture": "surround"}),
        ("9x9", {"num_chasers": 3, "num_evaders": 2, "capture": "adjacent", "n_catch": 2}),
        ("15x15-tree", {"num_chasers": 1, "num_evaders": 3}),
    ],
)
def test_it_catches_in_other_tasks(maze: str, settings: dict[str, Any]) -> None:
    task = Task(maze, stay_action=True, max_steps=500, **settings)
    assert played(task, UniformAgent(), 50).terminated.mean() > 0.9


# -- as other scripted agents ----------------------------------------------------------------------


def test_epsilon_mixes_random_moves() -> None:
    task = preset()
    simulator = Simulator(task, 300, seed=2)
    rows = [
        agent.distribution(task, simulator.games, 5)
        for agent in (GatheringTeam(0.25), GatheringTeam(), RandomAgent())
    ]
    np.testing.assert_allclose(rows[0], 0.75 * rows[1] + 0.25 * rows[2])
    actions = np.zeros((300, 38), dtype=np.int32)
    simulator.act([GatheringTeam()] * 8 + [None] * 30, actions)
    np.testing.assert_array_equal(rows[1].argmax(axis=1), actions[:, 5])
    alone = GatheringTeam().act(simulator.view(5))
    np.testing.assert_array_equal(alone, actions[:, 5])


def test_exact_solutions_know_it_without_a_clock() -> None:
    agent, evader = GatheringTeam(0.1, obs_range=3), UniformAgent()
    task = Task("3x3-open", num_chasers=2, num_evaders=1, n_catch=2, max_steps=1000)
    exact = evaluate_joint(task, {"chaser": agent, "evader": evader})
    numbers = exact.states.numbers(Simulator(task, 4000, seed=1).games)
    lengths = played(task, evader, 4000, agent=agent).steps
    error = lengths.std() / len(lengths) ** 0.5
    assert exact.values["length"][numbers].mean() == pytest.approx(lengths.mean(), abs=4 * error)
    tree = Task("9x9-tree", num_chasers=1, num_evaders=1)
    assert agent.uses_clock(tree)
    with pytest.raises(ValueError, match=r"GatheringTeam\(.*\) of chaser_0 depends on the step"):
        evaluate_joint(tree, {"chaser": agent, "evader": evader})
    assert not is_table_in(tree, agent)


def test_it_is_an_opponent_by_name() -> None:
    assert repr(scripted_policy("gathering", "chaser", 0.3)) == (
        "GatheringTeam(epsilon=0.3, obs_range=7)"
    )
    with pytest.raises(ValueError, match="gathering plays chaser; 'evader' is needed"):
        scripted_policy("gathering", "evader")
    env = gymnasium.make("pursuit/Evader-v0", maze="7x7", num_chasers=3, opponent="gathering")
    env.reset(seed=1)
    env.step(0)
    with pytest.raises(ValueError, match="gathering in task 'chase': roads-8x8 is a graph"):
        gymnasium.make("pursuit/Evader-v0", maze="roads-8x8", opponent="gathering")


@pytest.mark.parametrize(
    ("maze", "settings", "seat", "message"),
    [
        ("5x5", {}, 1, "policy of the chaser; evader_0 needs one"),
        ("roads-8x8", {}, 0, "roads-8x8 is a graph, and its window has rows"),
        ("5x5", {"view_radius": 2}, 0, "view of the chasers is limited.*Leave out view_radius"),
        ("5x5", {"line_of_sight": "chaser"}, 0, "view of the chasers is limited"),
        ("5x5", {"unknown_maze": True, "view_radius": 2}, 0, "view of the chasers is limited"),
    ],
)
def test_what_it_cannot_play(maze: str, settings: Any, seat: int, message: str) -> None:
    task = Task(maze, num_chasers=1, num_evaders=1, **settings)
    with pytest.raises(ValueError, match=message):
        GatheringTeam().act(Simulator(task, 2).view(seat))
    assert seat == 1 or not plays("gathering", task, "chaser")


def test_a_limit_of_the_evaders_is_none_of_the_chasers() -> None:
    task = Task("5x5", num_chasers=1, num_evaders=1, view_radius={"evader": 2})
    assert plays("gathering", task, "chaser")


def test_large_mazes_and_wrong_settings_are_refused() -> None:
    task = Task(generate_maze("open", height=80, width=80, seed=0), num_chasers=1, num_evaders=1)
    with pytest.raises(ValueError, match=r"has 6400 cells. Use a maze of up to"):
        GatheringTeam().act(Simulator(task).view(0))
    with pytest.raises(ValueError, match="obs_range=4: the agent is in the centre; give an odd"):
        GatheringTeam(obs_range=4)
    with pytest.raises(ValueError, match="epsilon"):
        GatheringTeam(epsilon=2)
