"""The scripted agents with a full view: their base class, random, A* chaser and A* evader.

Runners are in `runner`.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.mazes.maze import MAX_TABLE_CELLS, Maze, load_maze
from pursuit.mazes.maze_arrays import lay_out
from pursuit.rules import layout
from pursuit.rules.layout import MOVES, Games, World
from pursuit.rules.randomness import PACKED_BITS
from pursuit.simulator.policy import GameView
from pursuit.tasks.task import Task
from pursuit.validation import check_bool, check_probability, whole
from scripted_agents.agents import kernels, known_kernels, option_kernels


class Scripted:
    """An epsilon-greedy agent: with probability `epsilon` a uniformly random move.

    A random move is one that changes the cell. Ties between greedy moves are broken uniformly. An
    agent has no state of games, so one object can be used for several agents and batches.

    Args:
        epsilon: share of random moves in [0, 1]; an epsilon set in the simulator has priority.

    Raises:
        ValueError: epsilon outside [0, 1].
    """

    kind = kernels.RANDOM
    alert_distance = 0
    look_radius = 0

    def __init__(self, epsilon: float = 0.0) -> None:
        self.epsilon = check_probability("epsilon", epsilon)
        self._scratch = _scratch_for(1)
        self._greedy: dict[tuple[int, bool], tuple[object, NDArray[Any]]] = {}

    def __repr__(self) -> str:
        return f"{type(self).__name__}(epsilon={self.epsilon:g})"

    def __init_subclass__(cls) -> None:
        overridden = cls.act is not Scripted.act
        if overridden and cls.act_together is Scripted.act_together:
            cls.act_together = None  # type: ignore[assignment]  # it would not call the new `act`

    def act(self, view: GameView) -> NDArray[np.int32]:
        """[num_games] int32, an action for every game; random numbers from the agent's stream."""
        actions = np.empty((view.num_games, 1), dtype=np.int32)
        self._fill(view, (view.seat,), (0,), actions)
        return actions[:, 0]

    def act_together(
        self, view: GameView, seats: tuple[int, ...], actions: NDArray[np.int32]
    ) -> None:
        """Write the actions of several agents, by index, into `actions` [num_games, num_agents].

        The same actions as by `act`, in one pass over the games.
        """
        self._fill(view, tuple(seats), tuple(seats), actions)

    def _fill(
        self,
        view: GameView,
        seats: tuple[int, ...],
        columns: tuple[int, ...],
        actions: NDArray[np.int32],
    ) -> None:
        """Write the actions of the agents `seats` into these columns of `actions`."""
        task = view.task
        if self._heeds_options(task):
            for seat, column in zip(seats, columns, strict=True):
                greedy = self.moves(task, view.games, seat)[:, 0]
                actions[:, column] = draw_actions(replace(view, seat=seat), greedy, self.epsilon)
            return
        room = max(task.max_cells, task.num_agents, task.num_goals)
        if room > self._scratch.shape[1]:
            self._scratch = _scratch_for(room)
        entry = kernels.ENTRIES[self.kind]
        if is_known_team(self.kind, view, seats):
            entry = known_kernels.team_entry_for(
                self.kind, len(seats), num_targets(self.kind, task)
            )
        entry(
            *view.games, view.streams, view.epsilon, _numbers(seats), _numbers(columns),
            (task.num_chasers, task.num_evaders, task.num_runners, task.num_goals), *view.mazes,
            self._greedy_table(view.mazes, task.stay_action), self._scratch,
            self._settings(task.stay_action), actions,
        )  # fmt: skip

    def action_probabilities(self, maze: Maze, stay_action: bool = False) -> NDArray[np.float64]:
        """[self cell, other cell, action] float64: the exact distribution with one target.

        Raises:
            ValueError: the maze has too many cells for a table.
        """
        maze, stay_action = load_maze(maze), check_bool("stay_action", stay_action)
        if maze.num_cells > MAX_TABLE_CELLS:
            raise ValueError(
                f"{maze.name}: {maze.num_cells} cells; tables have at most {MAX_TABLE_CELLS}"
            )
        arrays = lay_out((maze,))
        greedy = self._greedy_table(arrays, stay_action)
        pairs = (maze.num_cells, maze.num_cells)
        every = np.broadcast_to(arrays.facts[MOVES, :, None], pairs)
        known = MoveSets(maze.num_moves, stay_action)
        numbers = known.numbers(greedy.reshape(pairs), every)
        return known.rows(self.epsilon)[numbers]

    def moves(self, task: Task, games: Games, seat: int) -> NDArray[np.int64]:
        """[games, 2] int64, bit masks over the actions of the agent `seat` in games of a task: the
        greedy moves, and all moves that change the cell.

        Raises:
            ValueError: an agent of another role, or a maze with too many cells for a table.
        """
        if task.max_cells > MAX_TABLE_CELLS:
            raise ValueError(
                f"a maze of {task.max_cells} cells; moves are computed for up to {MAX_TABLE_CELLS}"
            )
        role = task.seat_roles[seat]
        own = getattr(self, "role", role)
        if own != role and not (own == "runner" and role == "evader" and task.num_goals):
            raise ValueError(
                f"{self!r} is a {own}, and the agent is {task.agent_names[seat]}; use it for {own}s"
            )
        mazes = lay_out(task.mazes)
        moves = np.zeros((len(games.steps), 2), dtype=np.int64)
        most = max(task.num_agents, task.num_goals)
        targets, counts = np.empty(most, dtype=np.int32), tuple(task.teams)
        table = self._greedy_table(mazes, task.stay_action)
        kernels.list_moves(self.kind, games, seat, counts, mazes, table, targets, moves)
        if self._heeds_options(task):
            greedy, every = moves[:, 0], moves[:, 1]
            if self.kind == kernels.EVADER:
                option_kernels.list_escaping_moves(games, seat, counts, mazes, greedy)
            else:
                stay = task.stay_action
                option_kernels.list_surrounding_moves(
                    games, seat, counts, mazes, stay, targets, greedy
                )
                np.copyto(greedy, every, where=greedy == 0)
        return moves

    def _heeds_options(self, task: Task) -> bool:
        """Whether the greedy moves follow from options of the rules: captures, or exits."""
        surrounds = self.kind == kernels.CHASER and task.capture != "cell"
        return surrounds or (self.kind == kernels.EVADER and task.most_exits > 0)

    def distribution(self, task: Task, games: Games, seat: int) -> NDArray[np.float64]:
        """[games, actions] float64: the exact distribution in any games of a task.

        Raises:
            ValueError: as `moves`.
        """
        known, moves = MoveSets(task.num_moves, task.stay_action), self.moves(task, games, seat)
        numbers = known.numbers(moves[:, 0], moves[:, 1])
        return known.rows(self.epsilon)[numbers]

    def _settings(self, stay_action: bool) -> tuple[float, int, int, bool]:
        """The settings as arguments of kernels."""
        return self.epsilon, self.alert_distance, self.look_radius, stay_action

    def _greedy_table(self, mazes: World, stay_action: bool) -> NDArray[Any]:
        """The bit masks of greedy moves at [own, other], in the layout of the distance tables."""
        tables = mazes.tables
        key = (id(tables), stay_action)
        if key not in self._greedy or self._greedy[key][0] is not tables:
            greedy = greedy_moves(self.kind, mazes, self._settings(stay_action))
            # The reference to `tables` prevents reuse of its id; only in a copied agent ids may
            # belong to other arrays.
            self._greedy[key] = (tables, greedy)
        return self._greedy[key][1]


def draw_actions(view: GameView, masks: NDArray[Any], epsilon: float) -> NDArray[np.int32]:
    """[num_games] int32: draws from `masks` [num_games], or from all moves if a mask is 0 and with
    probability `epsilon` (that of the game has priority); from the random stream of the agent."""
    actions = np.empty(view.num_games, dtype=np.int32)
    kernels.draw_moves(
        view.games, view.streams, view.epsilon, view.seat, view.mazes, masks,
        (epsilon, view.task.stay_action), actions,
    )  # fmt: skip
    return actions


def num_targets(kind: int, task: Task) -> int:
    """The number of targets of an agent of a kind: agents or goals that it approaches or avoids."""
    targets_of_kinds = task.num_evaders, task.num_chasers, task.num_goals, 0
    return targets_of_kinds[kind]


def is_known_team(kind: int, view: GameView, seats: tuple[int, ...]) -> bool:
    """Whether these agents use a kernel that is compiled for their number.

    That is for few agents with consecutive indices, targets and moves, in mazes with tables. For
    one agent with one target the general kernel is as fast.
    """
    first, targets = seats[0], num_targets(kind, view.task)
    if len(seats) * targets <= 1 or seats != tuple(range(first, first + len(seats))):
        return False
    if max(len(seats), targets) > known_kernels.MOST_KNOWN:
        return False
    mazes = view.mazes
    if mazes.mazes[layout.TABLE].min() < 0 or mazes.neighbors.shape[1] > PACKED_BITS:
        return False
    in_rows = layout.named_views(
        known_kernels.in_rows, view.games.position, view.games.active, view.epsilon
    )
    return bool(in_rows)


MOST_NUMBERED = 5
"""With more moves there are too many pairs of sets to number them all."""


class MoveSets:
    """The action distributions of pairs of sets of moves: the greedy ones, and all.

    With few moves every pair has its number; else pairs are numbered as they are first seen.
    """

    def __init__(self, num_moves: int, stay_action: bool) -> None:
        self.num_moves, self.num_actions = num_moves, num_moves + stay_action
        self._all = num_moves <= MOST_NUMBERED
        self._pairs = np.arange(2 << 2 * num_moves if self._all else 0)

    def numbers(self, greedy: NDArray[Any], every: NDArray[Any]) -> NDArray[np.int64]:
        """[...] int64, the number of each pair of bit masks."""
        pairs = (greedy.astype(np.int64) << self.num_moves) | every
        if self._all:
            return pairs
        new = np.setdiff1d(pairs, self._pairs)
        self._pairs = np.concatenate([self._pairs, new])
        order = np.argsort(self._pairs)
        return order[np.searchsorted(self._pairs, pairs, sorter=order)]

    def rows(self, epsilon: float, slip: float = 0.0) -> NDArray[np.float64]:
        """[pairs, actions] float64: the distribution of each pair that was numbered so far; of the
        moves, if these slip."""
        # In an enclosed cell the agent stays, or moves into the north wall.
        stays = self.num_actions > self.num_moves
        nowhere = np.eye(self.num_actions)[self.num_moves if stays else 0]
        rows = np.zeros((len(self._pairs), self.num_actions))
        greedy, every = np.divmod(self._pairs, 1 << self.num_moves)
        at_random = epsilon + (1.0 - epsilon) * slip if slip else epsilon
        for weight, sets in ((1.0 - at_random, greedy), (at_random, every)):
            chosen = (sets[:, None] >> np.arange(self.num_actions)) & 1
            size = chosen.sum(axis=1, keepdims=True)
            rows += weight * np.where(size == 0, nowhere, chosen / np.maximum(size, 1))
        return rows


def greedy_moves(kind: int, mazes: World, settings: tuple[float, int, int, bool]) -> NDArray[Any]:
    """The bit masks of greedy moves at [own, other], in the layout of the distance tables.

    They are uint8 where eight bits are enough, else uint32. All moves if none is preferred; 0 for
    cells without moves.

    Args:
        kind: CHASER, EVADER, RUNNER or RANDOM of `kernels`.
        mazes: the arrays of the mazes.
        settings: epsilon (ignored), alert distance, look radius, stay action.
    """
    few = mazes.neighbors.shape[1] <= 8
    greedy = np.zeros(len(mazes.tables), dtype=np.uint8 if few else np.uint32)
    if kind != kernels.RANDOM:
        kernels.fill_greedy_table(kind, mazes, _scratch_for(len(mazes.neighbors)), settings, greedy)
    return greedy


def _scratch_for(room: int) -> NDArray[np.int32]:
    return np.full((kernels.NUM_SCRATCH, room), -1, dtype=np.int32)


@lru_cache(maxsize=256)
def _numbers(seats: tuple[int, ...]) -> NDArray[np.int64]:
    """Agent indices as an argument of kernels."""
    return np.array(seats, dtype=np.int64)


class RandomAgent(Scripted):
    """Uniformly random among the moves that change the cell, for any epsilon."""

    def __init__(self) -> None:
        super().__init__(epsilon=1.0)


class AStarChaser(Scripted):
    """With probability epsilon a random move, else a first step of a shortest path.

    The path leads to the nearest active evader by path distance. Ties between evaders and between
    paths are broken uniformly over first steps. It is not optimal: intercepting a fleeing evader is
    faster (see `best_response`).

    Where chasers capture from cells next to an evader (`capture` "adjacent" and "surround"), each
    heads for its own such cell, and waits there. The team picks the evader with the least sum of
    distances; then the nearest pairs of a chaser and a free cell are assigned one after the other.
    """

    kind, role = kernels.CHASER, "chaser"


class AStarEvader(Scripted):
    """Flees to the cell within `look_radius` that is farthest from the nearest chaser.

    It is alerted if the nearest chaser is nearer than `alert_distance` (path distance from the
    chaser; of several equally near ones the first in the order of agents counts). Then its move is
    uniform over the first steps of all shortest paths to all such cells. If no cell within reach is
    farther than its own cell it stays, or makes a random move if the task has no stay action. If it
    is not alerted, and with probability epsilon, it makes a random move, which is uniform over
    the moves that change the cell, never "stay".

    With exits it heads for the nearest exit that it reaches before any chaser; only without such an
    exit it moves as above.

    Args:
        epsilon: share of random moves in [0, 1].
        alert_distance: path distance below which a chaser is a threat.
        look_radius: path distance of the farthest cells that it considers.

    Raises:
        ValueError: a value out of range.
    """

    kind, role = kernels.EVADER, "evader"

    def __init__(self, epsilon: float = 0.0, alert_distance: int = 3, look_radius: int = 3) -> None:
        super().__init__(epsilon)
        self.alert_distance = whole("alert_distance", alert_distance, 0)
        self.look_radius = whole("look_radius", look_radius, 1)
