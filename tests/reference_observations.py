"""What one agent observes, by the plainest means: the truth that the encodings are held against."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pursuit.mazes.maze import Maze
from pursuit.observations.observations import ENCODINGS, PLANES
from pursuit.rules import COLLECTED
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task


def cells_seen(maze: Maze, own: int, radius: int | None, in_line: bool) -> set[int]:
    """The cells within sight of one, by a flood from it, and by walks away from it."""
    seen = set(range(maze.num_cells))
    if radius is not None:
        seen, edge = {own}, {own}
        for _ in range(radius):
            edge = {int(after) for cell in edge for after in maze.neighbors[cell, :4]} - seen
            seen |= edge
    if in_line:
        walked = {own}
        for action in range(4):
            cell = own
            while (after := int(maze.neighbors[cell, action])) != cell:
                walked.add(cell := after)
        seen &= walked
    return seen


class Seen:
    """What one agent sees of one game, by the plainest means."""

    def __init__(self, simulator: Simulator, game: int, seat: int) -> None:
        task, roles = simulator.task, simulator.task.seat_roles
        self.maze: Maze = task.mazes[simulator.maze_index[game]]
        radius, in_line, unknown = task.sight.limits[seat]
        self.unknown = unknown and (radius is not None or in_line)
        self.limited = task.sight.limited
        self.at = int(simulator.positions[game, seat])
        radii = [limit.view_radius for limit in task.sight.limits]
        whole = max(max(each.height, each.width) for each in task.mazes) - 1
        self.radius = max((r for r in radii if r is not None), default=whole)
        self.view = cells_seen(self.maze, self.at, radius, in_line)
        cells = [
            int(cell) if active and cell in self.view else None
            for cell, active in zip(simulator.positions[game], simulator.active[game], strict=True)
        ]
        others = [other for other in range(task.num_agents) if other != seat]
        self.own = cells[seat]
        self.team = [cells[other] for other in others if roles[other] == roles[seat]]
        self.opponents = [cells[other] for other in others if roles[other] != roles[seat]]
        left = sorted(int(goal) for goal in simulator.goals[game] if goal in self.view)
        self.goals = [None] * (task.num_goals - len(left)) + left
        there = sorted(int(cell) for cell in simulator.exits[game] if cell in self.view)
        self.exits = [None] * (task.most_exits - len(there)) + there
        self.collected = bool(simulator.events[game, seat] & COLLECTED)
        self.entities = [self.own, *self.team, *self.opponents, *self.goals, *self.exits]
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
        ranks = (
            (7, self.exits),
            (4, self.goals),
            (2, self.team),
            (3, self.opponents),
            (1, [self.own]),
        )
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
        if self.unknown:
            for place in np.ndindex(*grid.shape):
                if place not in {self.place(cell) for cell in self.view}:
                    grid[place] = 6
        return self.draw(grid, 1)

    def walls(self) -> NDArray[np.uint8]:
        grid = np.full((2 * self.height + 1, 2 * self.width + 1), 5, dtype=np.uint8)
        marks = str.maketrans("SG", "  ")
        lines = self.maze.to_text().translate(marks).splitlines()
        for row, line in enumerate(lines):
            for column, character in enumerate(line):
                if character == " ":
                    grid[row, column] = 0
        if self.unknown:
            centres = [self.place(cell) for cell in self.view]
            for row, column in np.ndindex(*grid.shape):
                beside = (
                    abs(2 * r + 1 - row) < 2 and abs(2 * c + 1 - column) < 2 for r, c in centres
                )
                if not any(beside):
                    grid[row, column] = 6
        return self.draw(grid, 2)

    def planes(self) -> NDArray[np.float32]:
        names = [*PLANES, *["in view"] * self.limited, *["exits"] * bool(self.exits)]
        planes = {name: np.zeros((self.height, self.width), dtype=np.float32) for name in names}
        known = self.view if self.unknown else range(self.maze.num_cells)
        marked = {
            "self": [self.own],
            "team": self.team,
            "others": self.opponents,
            "goals": self.goals,
            "exits": self.exits,
            "just collected": [self.own if self.collected else None],
            "walkable": known,
            "in view": self.view if self.limited else [],
        }
        for name in names:
            for cell in marked.get(name, []):
                if cell is not None:
                    planes[name][self.place(cell)] = 1.0
        for action, side in enumerate(("north", "south", "east", "west")):
            for cell in known:
                if self.maze.neighbors[cell, action] == cell:
                    planes[f"wall {side}"][self.place(cell)] = 1.0
        return np.stack(list(planes.values()))

    def window(self, radius: int | None = None) -> NDArray[np.float32]:
        """Cut out of the planes, laid in the middle of a large empty field."""
        planes, radius = self.planes(), self.radius if radius is None else radius
        field = np.pad(planes, ((0, 0), (radius, radius), (radius, radius)))
        row, column = self.place(self.at)
        return field[:, row : row + 2 * radius + 1, column : column + 2 * radius + 1]


def check_observations(task: Task, seed: int, games: int, steps: int) -> tuple[int, int, int]:
    """Every observation in random play, in all encodings.

    Returns how many entities were out of view, how many were absent, and how often an agent had
    just collected a goal.
    """
    simulator = Simulator(task, games, seed=seed, auto_restart=False)
    rng, hidden, gone, collected = np.random.default_rng(seed), 0, 0, 0
    spaces = {name: simulator.encoder(name).space for name in ENCODINGS}
    for _ in range(steps):
        observed = {name: simulator.observe(name) for name in ENCODINGS}
        for game, seat in np.ndindex(games, task.num_agents):
            seen = Seen(simulator, game, seat)
            left = simulator.active[game].sum() + (simulator.goals[game] >= 0).sum()
            hidden += left - sum(cell is not None for cell in seen.entities)
            gone += None in seen.entities
            collected += seen.collected
            for name in ENCODINGS:
                found, expected = observed[name][game, seat], getattr(seen, name)()
                assert found.dtype == expected.dtype
                np.testing.assert_array_equal(found, expected)
                assert spaces[name].contains(found)
        simulator.reset(games=simulator.ended)
        simulator.step(rng.integers(task.num_actions, size=(games, task.num_agents)))
    assert all(simulator.encoder(name).space is space for name, space in spaces.items())
    return hidden, gone, collected
