"""Encodings: each lies in its space and equals a plain construction from the state."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from pursuit.maze import Maze
from pursuit.observations import ENCODINGS, PLANES
from pursuit.rules import COLLECTED
from pursuit.simulator import Simulator
from pursuit.task import Task, make_task

HOLES = Maze.from_text(
    "+-+-+-+-+\n|   |   |\n+ +-+ + +\n| |#|   |\n+ +-+ + +\n|       |\n+-+-+-+-+"
)
TASKS = {
    "1v1": make_task("chase", maze="3x3", max_steps=20),
    "2v3": Task(maze=HOLES, num_chasers=2, num_evaders=3, max_steps=20),
    "maze": Task(maze=HOLES, num_runners=1, num_goals=4, max_steps=20),
    "race": Task(maze="3x3", num_runners=3, num_goals=3, max_steps=20),
    "heist": Task(maze="3x3", num_chasers=1, num_evaders=2, num_goals=2, max_steps=20),
    "all, in two mazes": Task(
        maze=("5x5", HOLES), num_chasers=2, num_evaders=2, num_runners=2, num_goals=2, max_steps=20
    ),
}


def played(task: Task, games: int = 24, steps: int = 40) -> Any:
    """A simulator in each of the states that random play comes through."""
    simulator = Simulator(task, games, seed=1, auto_restart=False)
    rng = np.random.default_rng(2)
    for _ in range(steps):
        yield simulator
        simulator.reset(games=simulator.ended)
        simulator.step(rng.integers(task.num_actions, size=(games, task.num_agents)))


class Seen:
    """What one agent sees of one game, by the plainest means."""

    def __init__(self, simulator: Simulator, game: int, seat: int) -> None:
        task, roles = simulator.task, simulator.task.seat_roles
        self.maze: Maze = task.mazes[simulator.maze_index[game]]
        cells = [
            int(cell) if active else None
            for cell, active in zip(simulator.positions[game], simulator.active[game], strict=True)
        ]
        others = [other for other in range(task.num_agents) if other != seat]
        self.own = cells[seat]
        self.team = [cells[other] for other in others if roles[other] == roles[seat]]
        self.opponents = [cells[other] for other in others if roles[other] != roles[seat]]
        left = sorted(int(goal) for goal in simulator.goals[game] if goal >= 0)
        self.goals = [None] * (task.num_goals - len(left)) + left
        self.collected = bool(simulator.events[game, seat] & COLLECTED)
        self.entities = [self.own, *self.team, *self.opponents, *self.goals]
        self.size = max(maze.num_cells for maze in task.mazes)
        self.height = max(maze.height for maze in task.mazes)
        self.width = max(maze.width for maze in task.mazes)

    def one_hot(self) -> NDArray[np.float32]:
        rows = np.zeros((len(self.entities) + 1, self.size), dtype=np.float32)
        cells = [*self.entities, self.own if self.collected else None]
        for row, cell in zip(rows, cells, strict=True):
            if cell is not None:
                row[cell] = 1.0
        return rows.reshape(-1)

    def positions(self) -> NDArray[np.int32]:
        numbers = [0 if cell is None else cell + 1 for cell in self.entities]
        return np.array([*numbers, self.collected], dtype=np.int32)

    def index(self) -> NDArray[np.int32]:
        ones = self.one_hot().reshape(-1, self.size)
        padding = ones.size
        places = [np.flatnonzero(row) + i * self.size for i, row in enumerate(ones)]
        return np.array([p[0] if len(p) else padding for p in places], dtype=np.int32)

    def place(self, cell: int) -> tuple[int, int]:
        return int(self.maze.rows[cell]), int(self.maze.columns[cell])

    def draw(self, grid: NDArray[np.uint8], stride: int) -> NDArray[np.uint8]:
        """The entities over a grid whose cells lie `stride` apart; the last drawn is on top."""
        ranks = ((4, self.goals), (2, self.team), (3, self.opponents), (1, [self.own]))
        for code, cells in ranks:
            for cell in cells:
                if cell is not None:
                    row, column = self.place(cell)
                    grid[stride * row + stride - 1, stride * column + stride - 1] = code
        return grid

    def cells(self) -> NDArray[np.uint8]:
        grid = np.full((self.height, self.width), 5, dtype=np.uint8)
        for cell in range(self.maze.num_cells):
            grid[self.place(cell)] = 0
        return self.draw(grid, 1)

    def walls(self) -> NDArray[np.uint8]:
        grid = np.full((2 * self.height + 1, 2 * self.width + 1), 5, dtype=np.uint8)
        marks = str.maketrans("SG", "  ")
        lines = self.maze.to_text().translate(marks).splitlines()
        for row, line in enumerate(lines):
            for column, character in enumerate(line):
                if character == " ":
                    grid[row, column] = 0
        return self.draw(grid, 2)

    def planes(self) -> NDArray[np.float32]:
        planes = {name: np.zeros((self.height, self.width), dtype=np.float32) for name in PLANES}
        marked = {
            "self": [self.own],
            "team": self.team,
            "others": self.opponents,
            "goals": self.goals,
            "just collected": [self.own if self.collected else None],
            "walkable": range(self.maze.num_cells),
        }
        for name, cells in marked.items():
            for cell in cells:
                if cell is not None:
                    planes[name][self.place(cell)] = 1.0
        for action, side in enumerate(("north", "south", "east", "west")):
            for cell in range(self.maze.num_cells):
                if self.maze.neighbors[cell, action] == cell:
                    planes[f"wall {side}"][self.place(cell)] = 1.0
        return np.stack([planes[name] for name in PLANES])


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("name", TASKS)
def test_observations_are_those_of_the_plain_construction(name: str, encoding: str) -> None:
    gone = collected = 0
    for simulator in played(TASKS[name], games=8, steps=30):
        observed = simulator.observe(encoding)
        for game in range(simulator.num_games):
            for seat in range(simulator.num_agents):
                seen = Seen(simulator, game, seat)
                gone += None in seen.entities
                collected += seen.collected
                expected = getattr(seen, encoding)()
                assert observed[game, seat].dtype == expected.dtype
                np.testing.assert_array_equal(observed[game, seat], expected)
    assert gone > 0  # captures or collected goals were among them
    assert collected > 0 or not TASKS[name].num_goals


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("name", TASKS)
def test_observations_lie_in_their_space(name: str, encoding: str) -> None:
    for simulator in played(TASKS[name], games=5):
        encoder = simulator.encoder(encoding)
        for own in simulator.observe(encoding).reshape(-1, *encoder.shape):
            assert encoder.space.contains(own)
    assert simulator.encoder(encoding).space is encoder.space


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_one_seat_and_given_arrays_hold_the_same(encoding: str) -> None:
    *_, simulator = played(TASKS["all, in two mazes"])
    every = simulator.observe(encoding)
    for seat, name in enumerate(simulator.task.agent_names):
        np.testing.assert_array_equal(simulator.observe(encoding, seat), every[:, seat])
        np.testing.assert_array_equal(simulator.observe(encoding, name), every[:, seat])
    out = np.full_like(every, 1)
    assert simulator.observe(encoding, out=out) is out
    np.testing.assert_array_equal(out, every)
    out = np.full_like(every, 1)
    for seat in range(simulator.num_agents):
        simulator.observe(encoding, seat, out=out[:, seat])  # not contiguous
    np.testing.assert_array_equal(out, every)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_an_array_that_does_not_fit_is_refused(encoding: str) -> None:
    *_, simulator = played(TASKS["race"])
    every = simulator.observe(encoding)
    for out in (every[1:], every[..., :-1], every.astype(np.float64)):
        with pytest.raises(ValueError, match="out of shape"):
            simulator.observe(encoding, out=out.copy())


@pytest.mark.parametrize("name", TASKS)
def test_index_scattered_is_one_hot(name: str) -> None:
    for simulator in played(TASKS[name], steps=20):
        one_hot, index = simulator.observe("one_hot"), simulator.observe("index")
        size = one_hot.shape[-1]
        scattered = np.zeros((*index.shape[:2], size + 1), dtype=np.float32)
        np.put_along_axis(scattered, index.astype(np.int64), 1.0, axis=-1)
        np.testing.assert_array_equal(scattered[..., :size], one_hot)


@pytest.mark.parametrize("name", TASKS)
def test_an_embedding_bag_of_index_is_a_linear_layer_of_one_hot(name: str) -> None:
    *_, simulator = played(TASKS[name])
    one_hot = torch.from_numpy(simulator.observe("one_hot")).flatten(0, 1).double()
    index = torch.from_numpy(simulator.observe("index")).flatten(0, 1).long()
    size = one_hot.shape[-1]
    torch.manual_seed(0)
    linear = torch.nn.Linear(size, 16, bias=False, dtype=torch.float64)
    bag = torch.nn.EmbeddingBag(size + 1, 16, mode="sum", padding_idx=size, dtype=torch.float64)
    with torch.no_grad():
        bag.weight[:size] = linear.weight.T
    torch.testing.assert_close(bag(index), linear(one_hot))


def test_an_unknown_encoding_is_named() -> None:
    with pytest.raises(ValueError, match="unknown observation 'onehot'; one of one_hot, positions"):
        Simulator(TASKS["1v1"]).observe("onehot")
