"""A team of chasers with local views that moves as one formation, and where it patrols."""

from __future__ import annotations

from functools import lru_cache
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pursuit.compilation.compiled import compiled, inlined
from pursuit.mazes.maze import MAX_TABLE_CELLS, Maze
from pursuit.mazes.maze_arrays import grids_of, lay_out
from pursuit.rules.arrays import Ints
from pursuit.rules.distances import FAR, moves_of, table_distance
from pursuit.rules.layout import (
    COLUMN,
    EAST,
    FIRST_CELL,
    NORTH,
    ROW,
    SOUTH,
    UNREACHABLE,
    WEST,
    Games,
    Teams,
    World,
    chasers_of,
    evaders_of,
    stay_of,
)
from pursuit.rules.turn import legal_moves
from pursuit.simulator.policy import check_plays
from pursuit.tasks.task import Task
from pursuit.validation import check, whole
from scripted_agents.agents.option_kernels import waiting
from scripted_agents.agents.scripted import Scripted

SIDES = (NORTH, EAST, SOUTH, WEST)
"""The sides of a cell, by number, as moves from it."""


class GatheringTeam(Scripted):
    """Chasers that gather and then move as one formation; each sees only a window around itself.

    With probability epsilon a chaser makes a random move. Else chaser i knows the maze, i, its
    cell, and the chasers and free evaders in the window of `obs_range` x `obs_range` cells around
    it, walls or not. It has no memory. Ties are broken by the order of actions, not at random. It
    heads for

    1. the gathering cell, while it does not see all chasers.
    2. Else for an evader that all chasers see: the one with the least sum of path distances of all
       chasers, of several that in the first cell. With the capture rule "surround" the distance of
       chaser i, and its way, is to side i mod 4 of the evader (north, east, south, west); for a
       closed side the distance is to the evader, and the way to the nearest open side, of several
       the first from side i + 1 + 2 (i // 4) on. Of fewer than four chasers, i goes to open side i
       modulo the number of open sides. With other rules all go to the cell of the evader.
    3. Without such an evader the team patrols: the centre of the team (its mean row and column,
       rounded to the nearest, halves up; the own cell, if that is no cell) heads for a cell of
       `closed_walk`, and chaser i for side i mod 4 of where that step leads with "surround" (a
       closed side: there), else for where it leads. That cell is the one after the nearest of the
       walk (of several the first). If the walk visits a cell twice, as in dead ends, it is cell
       number t of the walk (modulo its length, from 0) after t steps of the episode.

    The gathering cell is the first of the walk, and each cell is in the window of a cell of the
    walk. Where a chaser cannot come nearer it stays, or without the stay action makes the first
    move into a wall, or its first move.

    As all move alike, an evader one move from the centre of eight chasers is captured by all eight
    in the next step. A formation of "surround" needs an `obs_range` of 5 or more, and chasers that
    may share a cell (`collisions`). It may never see an evader that does not move.

    Args:
        epsilon: share of random moves in [0, 1]; an epsilon set in the simulator has priority.
        obs_range: rows and columns of the window, an odd number.

    Raises:
        ValueError: a value out of range, or an even `obs_range`.
    """

    role = "chaser"
    action_probabilities = None  # type: ignore[assignment]  # a team is no table of two cells

    def __init__(self, epsilon: float = 0.0, obs_range: int = 7) -> None:
        super().__init__(epsilon)
        self.obs_range = whole("obs_range", obs_range, 1)
        check(
            obs_range % 2 == 1,
            f"obs_range={obs_range}: the agent is in the centre; give an odd number",
        )
        self._known: tuple[Task, Patrols] | None = None

    def __repr__(self) -> str:
        return f"{type(self).__name__}(epsilon={self.epsilon:g}, obs_range={self.obs_range})"

    def moves(self, task: Task, games: Games, seat: int) -> NDArray[np.int64]:
        """As `Scripted.moves`, with one greedy move.

        Raises:
            ValueError: an agent that is no chaser; a graph, a limited view of the chasers, or a
                maze with too many cells for a table.
        """
        check_plays(self, task, seat)
        moves = np.empty((len(games.steps), 2), dtype=np.int64)
        settings = (self.obs_range // 2, task.capture == "surround", task.stay_action)
        counts, patrols = tuple(task.teams), self._patrols(task)
        list_formation_moves(games, seat, counts, lay_out(task.mazes), patrols, settings, moves)
        return moves

    def uses_clock(self, task: Task) -> bool:
        """Whether its patrols in a task depend on the steps of the episode; raises as `moves`."""
        return bool(self._patrols(task).period.any())

    def _heeds_options(self, task: Task) -> bool:
        return True  # all moves are those of `moves`

    def _patrols(self, task: Task) -> Patrols:
        if self._known is None or self._known[0] is not task:
            check_gathers(task)
            self._known = task, patrols_of(task.mazes, self.obs_range // 2)
        return self._known[1]


def check_gathers(task: Task) -> None:
    """ValueError, with the reason, unless the chasers of a task can be a `GatheringTeam`."""
    reason = None
    for maze in task.mazes:
        if not maze.is_grid:
            reason = f"{maze.name} is a graph, and its window has rows and columns. Use a maze"
        elif maze.num_cells > MAX_TABLE_CELLS:
            reason = (
                f"{maze.name} has {maze.num_cells} cells. Use a maze of up to {MAX_TABLE_CELLS}"
            )
    if reason is None and any(map(task.hides_from, range(task.num_chasers))):
        reason = (
            "the view of the chasers is limited, and it has a window of its own. Leave out "
            "view_radius, line_of_sight and unknown_maze of chasers, or use searching"
        )
    check(reason is None, f"gathering in task {task.name!r}: {reason}")


class Patrols(NamedTuple):
    """Where the team gathers and patrols in each maze of a task.

    Attributes:
        cells: [mazes, height, width] int32, the number of each cell; -1 if there is none.
        gathering: [mazes] int32, the cell to gather in.
        period: [mazes] int32, the length of the walk if it is followed by the clock, else 0.
        goals: [mazes, ...] int32, where the centre heads from each cell, or at each step modulo
            the period.
    """

    cells: Ints
    gathering: Ints
    period: Ints
    goals: Ints


@lru_cache(maxsize=16)
def patrols_of(mazes: tuple[Maze, ...], reach: int) -> Patrols:
    """The patrols in mazes of chasers that see `reach` rows and columns to each side."""
    walks = [closed_walk(maze, reach) for maze in mazes]
    period = [len(walk) if len(set(walk)) < len(walk) else 0 for walk in walks]
    goals = np.zeros((len(mazes), max(*period, *(maze.num_cells for maze in mazes))), np.int32)
    for row, maze, walk, clock in zip(goals, mazes, walks, period, strict=True):
        after = np.roll(walk, -1)
        own = walk if clock else after[maze.distances[:, walk].argmin(axis=1)]
        row[: len(own)] = own
    gathering = np.array([walk[0] for walk in walks], dtype=np.int32)
    return Patrols(grids_of(mazes)[0], gathering, np.array(period, dtype=np.int32), goals)


def closed_walk(maze: Maze, reach: int) -> list[int]:
    """The cells of a closed walk through waypoints that have all cells in their windows.

    A waypoint is the cell with the most cells in its window that are in no other one yet. The walk
    begins at the waypoint nearest to all cells. It visits them in the order of a local optimum, of
    which no part can be reversed for a shorter walk (2-opt). In a maze of several parts without a
    path between them only the largest one counts.
    """
    distances, points = maze.distances, list[int]()
    connected = distances < UNREACHABLE
    inside = connected[connected.sum(axis=1).argmax()]
    away = [abs(axis[:, None] - axis) for axis in (maze.rows, maze.columns)]
    window = (np.maximum(*away) <= reach).astype(np.float32)  # products of floats are fast
    left = inside.astype(np.float32)
    while left.any():
        points.append(int(np.where(inside, window @ left, -1).argmax()))
        left *= 1 - window[points[-1]]
    points.sort(key=lambda cell: (distances[cell, inside].sum(), cell))

    def length(order: list[int]) -> int:
        return int(distances[order, np.roll(order, -1)].sum())

    improved = True
    while improved:
        improved = False
        for i, j in combinations(range(1, len(points) + 1), 2):
            other = [*points[:i], *points[i:j][::-1], *points[j:]]
            if length(other) < length(points):
                points, improved = other, True
    walk = [points[0]]
    for goal in [*points[1:], points[0]]:
        while walk[-1] != goal:
            around = maze.neighbors[walk[-1]]
            walk.append(int(around[distances[around, goal].argmin()]))
    return walk[:-1] if len(walk) > 1 else walk


@compiled
def list_formation_moves(
    games: Games, seat: int, counts: Any, world: World, patrols: Any, settings: Any, moves: Any
) -> None:
    """Fill `moves` [games, 2] with the masks of the greedy move of a chaser, and of every move.

    `patrols` is `Patrols`; `settings` is (rows and columns seen to each side, whether captures need
    all sides, stay action).
    """
    reach, surround, stay_action = settings
    teams, facts = Teams(counts[0], counts[1], counts[2], counts[3]), world.facts
    team, stay = teams.chasers, stay_of(world.neighbors)
    for game in range(moves.shape[0]):
        maze: Any = np.int64(games.maze[game])
        own: Any = np.int64(games.position[game, seat])
        first = world.mazes[FIRST_CELL, maze]
        low: Any = (FAR, FAR)
        high: Any = (0, 0)
        total: Any = (0, 0)
        for chaser in chasers_of(teams):
            cell: Any = first + np.int64(games.position[game, chaser])
            row, column = np.int64(facts[ROW, cell]), np.int64(facts[COLUMN, cell])
            low = min(low[0], row), min(low[1], column)
            high = max(high[0], row), max(high[1], column)
            total = total[0] + row, total[1] + column
        window = (high[0] - reach, low[0] + reach, high[1] - reach, low[1] + reach)  # of all
        goal: Any = np.int64(patrols.gathering[maze])
        if is_inside(window, facts, first + own):
            target: Any = common_evader(world, games, game, teams, window, surround)
            if target >= 0 and surround:
                goal = side_for(world, maze, target, seat, team, own)
            elif target >= 0:
                goal = target
            else:
                middle = (2 * total[0] + team) // (2 * team), (2 * total[1] + team) // (2 * team)
                centre: Any = np.int64(patrols.cells[maze, middle[0], middle[1]])
                centre = own if centre < 0 else centre
                period = np.int64(patrols.period[maze])
                at = np.int64(games.steps[game]) % period if period > 0 else centre
                ahead: Any = np.int64(patrols.goals[maze, at])
                step = first_step(world, maze, centre, ahead)
                goal = np.int64(world.neighbors[first + centre, step])
                if surround:
                    goal = np.int64(world.neighbors[first + goal, SIDES[seat % 4]])
        every = legal_moves(world, maze, own)
        action = first_step(world, maze, own, goal)
        mask = 1 << action if action < stay else waiting(world, maze, own, stay_action)
        mask = mask if mask > 0 else every
        moves[game, 0], moves[game, 1] = mask & -mask, every


@inlined
def is_inside(window: Any, facts: Ints, place: Any) -> Any:
    """Whether the cell with an index in `facts` is in a window of first and last row and column."""
    row, column = facts[ROW, place], facts[COLUMN, place]
    return window[0] <= row <= window[1] and window[2] <= column <= window[3]


@inlined
def first_step(world: World, maze: Any, own: Any, goal: Any) -> Any:
    """The first action that leads nearer to a goal; stay if there is none."""
    for action in moves_of(world.neighbors):
        after: Any = np.int64(world.neighbors[world.mazes[FIRST_CELL, maze] + own, action])
        if table_distance(world, maze, after, goal) < table_distance(world, maze, own, goal):
            return action
    return stay_of(world.neighbors)


@inlined
def common_evader(
    world: World, games: Games, game: int, teams: Teams, window: Any, surround: bool
) -> Any:
    """The cell of the evader in the window of all chasers that is nearest to them; -1 for none."""
    maze: Any = np.int64(games.maze[game])
    first = world.mazes[FIRST_CELL, maze]
    best, least = np.int64(-1), np.int64(FAR)
    for evader in evaders_of(teams):
        cell: Any = np.int64(games.position[game, evader])
        if games.active[game, evader] == 0 or not is_inside(window, world.facts, first + cell):
            continue
        total = np.int64(0)
        for chaser in chasers_of(teams):
            start: Any = np.int64(games.position[game, chaser])
            side: Any = world.neighbors[first + cell, SIDES[chaser % 4]]
            end: Any = np.int64(side) if surround else cell
            total += table_distance(world, maze, start, end)
        if total < least or (total == least and cell < best):
            best, least = cell, total
    return best


@inlined
def side_for(world: World, maze: Any, target: Any, chaser: Any, team: Any, own: Any) -> Any:
    """The cell next to a target that a chaser heads for; the target if it is enclosed."""
    around = world.neighbors[world.mazes[FIRST_CELL, maze] + target]
    best, least, wanted = target, np.int64(FAR), chaser
    if team < 4:
        sides = 0
        for side in SIDES:
            sides += around[side] != target
        for side in SIDES:
            if around[side] != target:
                if wanted % sides == 0:
                    best = np.int64(around[side])
                wanted -= 1
        return best
    if around[SIDES[chaser % 4]] != target:
        return np.int64(around[SIDES[chaser % 4]])
    for turn in range(4):  # from other sides on, so that chasers of one side spread
        cell: Any = np.int64(around[SIDES[(chaser + 1 + 2 * (chaser // 4) + turn) % 4]])
        away: Any = table_distance(world, maze, own, cell)
        if cell != target and away < least:
            best, least = cell, away
    return best
