"""The scripted agents that see everything, from settings to actions and tables.

`Scripted` is their common ground; runners are in `runner`.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from pursuit.mazes.maze import MAX_TABLE_CELLS, Maze, load_maze
from pursuit.mazes.maze_arrays import MazeArrays, lay_out
from pursuit.rules import layout
from pursuit.rules.layout import Games
from pursuit.simulator.policy import GameView
from pursuit.tasks.task import Task
from pursuit.validation import check_bool, check_probability, whole
from scripted_agents.agents import kernels, known_kernels


class Scripted:
    """An epsilon-greedy agent: with probability `epsilon` a uniformly random move.

    A random move is one that changes the cell. Greedy moves that are equally good are drawn
    uniformly. An agent keeps no state of the games, so one may fill many seats and batches.

    Args:
        epsilon: share of random moves in [0, 1]; the simulator's own epsilon of a game goes first.

    Raises:
        ValueError: epsilon outside [0, 1].
    """

    kind = kernels.RANDOM
    alert_distance = 0
    look_radius = 0

    def __init__(self, epsilon: float = 0.0) -> None:
        self.epsilon = check_probability("epsilon", epsilon)
        self._scratch = _scratch_for(1)
        self._greedy: dict[tuple[int, bool], tuple[object, NDArray[np.uint8]]] = {}

    def __repr__(self) -> str:
        return f"{type(self).__name__}(epsilon={self.epsilon:g})"

    def __init_subclass__(cls) -> None:
        own_way = cls.act is not Scripted.act  # defined by this or another class
        if own_way and cls.act_together is Scripted.act_together:
            cls.act_together = None  # type: ignore[assignment]  # it would not use that `act`

    def act(self, view: GameView) -> NDArray[np.int32]:
        """[num_games] int32, an action for every game; random numbers from the seat's stream."""
        actions = np.empty((view.num_games, 1), dtype=np.int32)
        self._fill(view, (view.seat,), (0,), actions)
        return actions[:, 0]

    def act_together(
        self, view: GameView, seats: tuple[int, ...], actions: NDArray[np.int32]
    ) -> None:
        """Write into `actions` [num_games, num_agents] what `act` would do in each of `seats`.

        In one pass over the games, in which targets are looked up once for all agents.
        """
        self._fill(view, tuple(seats), tuple(seats), actions)

    def _fill(
        self,
        view: GameView,
        seats: tuple[int, ...],
        columns: tuple[int, ...],
        actions: NDArray[np.int32],
    ) -> None:
        """Write into these columns of `actions` what the agents in `seats` do."""
        task = view.task
        room = max(task.max_cells, task.num_agents, task.num_goals)
        if room > self._scratch.shape[1]:
            self._scratch = _scratch_for(room)
        entry = kernels.ENTRIES[self.kind]
        if is_known_team(self.kind, view, seats):
            entry = known_kernels.team_entry_for(self.kind, len(seats), num_sought(self.kind, task))
        entry(
            *view.games,
            view.streams,
            view.epsilon,
            _numbers(seats),
            _numbers(columns),
            (task.num_chasers, task.num_evaders, task.num_runners, task.num_goals),
            *view.mazes,
            self._greedy_table(view.mazes, task.stay_action),
            self._scratch,
            self._settings(task.stay_action),
            actions,
        )

    def action_probabilities(self, maze: Maze, stay_action: bool = False) -> NDArray[np.float64]:
        """[self cell, other cell, action] float64: the exact distribution in a game of one to one.

        Raises:
            ValueError: the maze has too many cells for a table.
        """
        maze, stay_action = load_maze(maze), check_bool("stay_action", stay_action)
        if maze.num_cells > MAX_TABLE_CELLS:
            raise ValueError(
                f"{maze.name}: {maze.num_cells} cells; tables are made up to {MAX_TABLE_CELLS}"
            )
        arrays = lay_out((maze,))
        greedy = self._greedy_table(arrays, stay_action)
        pairs = (maze.num_cells, maze.num_cells)
        every = np.broadcast_to(arrays.world.moves[:, None], pairs)
        rows = rows_of_moves(self.epsilon, 5 if stay_action else 4)
        return rows[number_of_moves(np.stack([greedy.reshape(pairs), every], axis=-1))]

    def moves(self, task: Task, games: Games, seat: int) -> NDArray[np.uint8]:
        """[games, 2] uint8, bit masks over the actions in `seat` of any games of a task: the greedy
        moves, and all that change the cell.

        Raises:
            ValueError: another role's seat, or a maze that has too many cells for a table.
        """
        if task.max_cells > MAX_TABLE_CELLS:
            raise ValueError(
                f"a maze of {task.max_cells} cells; moves are known up to {MAX_TABLE_CELLS}"
            )
        role = task.seat_roles[seat]
        own = getattr(self, "role", role)
        if own != role and not (own == "runner" and role == "evader" and task.num_goals):
            raise ValueError(
                f"{self!r} is a {own}; this seat is another's: {task.agent_names[seat]}"
            )
        mazes = lay_out(task.mazes)
        moves = np.zeros((len(games.steps), 2), dtype=np.uint8)
        most = max(task.num_agents, task.num_goals)
        kernels.list_moves(
            self.kind,
            games,
            seat,
            tuple(task.teams),
            mazes,
            self._greedy_table(mazes, task.stay_action),
            np.empty(most, dtype=np.int32),
            moves,
        )
        return moves

    def distribution(self, task: Task, games: Games, seat: int) -> NDArray[np.float64]:
        """[games, actions] float64: the exact distribution in any games of a task.

        Raises:
            ValueError: as `moves`.
        """
        rows = rows_of_moves(self.epsilon, task.num_actions)
        return rows[number_of_moves(self.moves(task, games, seat))]

    def _settings(self, stay_action: bool) -> tuple[float, int, int, bool]:
        """As the kernels take them."""
        return self.epsilon, self.alert_distance, self.look_radius, stay_action

    def _greedy_table(self, mazes: MazeArrays, stay_action: bool) -> NDArray[np.uint8]:
        """The greedy moves at every [own, other], laid out as the distance tables, as bit masks."""
        tables = mazes.tables
        key = (id(tables), stay_action)
        if key not in self._greedy or self._greedy[key][0] is not tables:
            greedy = greedy_moves(self.kind, mazes, self._settings(stay_action))
            # Holding on to `tables` keeps its id from being given to another array; only a copied
            # agent holds ids of arrays that it does not have.
            self._greedy[key] = (tables, greedy)
        return self._greedy[key][1]


def draw_actions(view: GameView, masks: NDArray[np.uint8], epsilon: float) -> NDArray[np.int32]:
    """[num_games] int32: one of the moves in `masks` [num_games], of every move where it is 0, and
    with probability `epsilon` (the game's own goes first) of every move; from the seat's stream."""
    actions = np.empty(view.num_games, dtype=np.int32)
    kernels.draw_moves(
        view.games,
        view.streams,
        view.epsilon,
        view.seat,
        view.mazes,
        masks,
        (epsilon, view.task.stay_action),
        actions,
    )
    return actions


def num_sought(kind: int, task: Task) -> int:
    """How many agents or goals an agent of a kind heads for, or keeps away from."""
    counts = {
        kernels.CHASER: task.num_evaders,
        kernels.EVADER: task.num_chasers,
        kernels.RUNNER: task.num_goals,
    }
    return counts.get(kind, 0)


def is_known_team(kind: int, view: GameView, seats: tuple[int, ...]) -> bool:
    """Whether agents of a kind are decided for by a kernel for exactly so many of them.

    Those in neighbouring seats are, few against few, where all mazes have tables. One against one
    is not: the kernel for any number is as quick there.
    """
    first, sought = seats[0], num_sought(kind, view.task)
    if len(seats) * sought <= 1 or seats != tuple(range(first, first + len(seats))):
        return False
    if max(len(seats), sought) > known_kernels.MOST_KNOWN or not all_have_tables(view.mazes):
        return False
    in_rows = layout.named(
        known_kernels.in_rows, view.games.position, view.games.active, view.epsilon
    )
    return bool(in_rows)


def all_have_tables(mazes: MazeArrays) -> bool:
    """Whether no maze is too large for a table of distances."""
    return bool(mazes.mazes[layout.TABLE].min() >= 0)


NUM_MOVES = 32 * 16
"""How many pairs of greedy moves (of 5 actions) and of all moves (4) there are."""


def number_of_moves(moves: NDArray[np.uint8]) -> NDArray[np.int64]:
    """[...] int64, a number below NUM_MOVES for each of `Scripted.moves` [..., 2]."""
    return moves[..., 0].astype(np.int64) * 16 + moves[..., 1]


def rows_of_moves(epsilon: float, num_actions: int) -> NDArray[np.float64]:
    """[NUM_MOVES, actions] float64: the action distribution for each set of moves."""
    greedy, every = np.divmod(np.arange(NUM_MOVES), 16)
    # An enclosed cell has no move: its agent stays, or moves into the north wall.
    nowhere = np.eye(num_actions)[4 if num_actions == 5 else 0]
    rows = np.zeros((NUM_MOVES, num_actions))
    for weight, sets in ((1.0 - epsilon, greedy), (epsilon, every)):
        chosen = (sets[:, None] >> np.arange(num_actions)) & 1
        size = chosen.sum(axis=1, keepdims=True)
        rows += weight * np.where(size == 0, nowhere, chosen / np.maximum(size, 1))
    return rows


def greedy_moves(
    kind: int, mazes: MazeArrays, settings: tuple[float, int, int, bool]
) -> NDArray[np.uint8]:
    """The greedy moves at every [own, other], laid out as the distance tables, as bit masks.

    All moves where any will do; 0 where a cell has none.

    Args:
        kind: of agent, as `kernels` numbers them.
        mazes: the arrays of the mazes.
        settings: epsilon (not looked at), alert distance, look radius, stay action.
    """
    greedy = np.zeros(len(mazes.tables), dtype=np.uint8)
    if kind != kernels.RANDOM:
        kernels.fill_greedy_table(kind, mazes, _scratch_for(len(mazes.neighbors)), settings, greedy)
    return greedy


def _scratch_for(room: int) -> NDArray[np.int32]:
    return np.full((kernels.NUM_SCRATCH, room), -1, dtype=np.int32)


@lru_cache(maxsize=256)
def _numbers(seats: tuple[int, ...]) -> NDArray[np.int64]:
    """Seats as kernels take them."""
    return np.array(seats, dtype=np.int64)


class RandomAgent(Scripted):
    """Uniformly random among the moves that change the cell, for any epsilon."""

    def __init__(self) -> None:
        super().__init__(epsilon=1.0)


class AStarChaser(Scripted):
    """With probability epsilon a random move, else a first step of a shortest path.

    The path leads to the nearest active evader, by path distance; first steps to evaders that are
    equally near, and of paths that are equally short, are drawn uniformly. Not optimal: against an
    evader that flees, cutting off its way catches it sooner (see `best_response`).
    """

    kind, role = kernels.CHASER, "chaser"


class AStarEvader(Scripted):
    """Flees to the cell within `look_radius` that is farthest from the nearest chaser.

    It is alerted when the nearest chaser is nearer than `alert_distance` (path distance); then it
    draws uniformly among the first steps of all shortest paths to all such cells: among steps, not
    among cells. When no cell within reach is farther than its own it stays, if the task has that
    action, and else makes a random move. Not alerted, and with probability epsilon, it makes a
    random move: uniformly one of those that change the cell, never "stay".

    Args:
        epsilon: share of random moves in [0, 1].
        alert_distance: path distance below which a chaser is a threat.
        look_radius: path distance of the farthest cell that it considers.

    Raises:
        ValueError: a value out of range.
    """

    kind, role = kernels.EVADER, "evader"

    def __init__(self, epsilon: float = 0.0, alert_distance: int = 3, look_radius: int = 3) -> None:
        super().__init__(epsilon)
        self.alert_distance = whole("alert_distance", alert_distance, 0)
        self.look_radius = whole("look_radius", look_radius, 1)
