"""Scripted: the common ground of the heuristic agents, from settings to actions and tables."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from pursuit.declared import share, truth
from pursuit.device.calls import Call
from pursuit.maze import MAX_TABLE_CELLS, Maze, load_maze
from pursuit.maze_arrays import MazeArrays, lay_out
from pursuit.policy import GameView
from pursuit.rules.layout import Games
from pursuit.task import Task
from scripted_agents import kernels


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
        self.epsilon = share("epsilon", epsilon)
        self._scratch = _scratch_for(1)
        self._greedy: dict[tuple[int, bool], tuple[object, NDArray[np.uint8]]] = {}

    def __repr__(self) -> str:
        return f"{type(self).__name__}(epsilon={self.epsilon:g})"

    def __init_subclass__(cls) -> None:
        own_way = cls.act is not Scripted.act  # its own, or of whatever else it inherits
        if own_way and cls.act_together is Scripted.act_together:
            cls.act_together = None  # type: ignore[assignment]  # nobody else knows that way

    def act(self, view: GameView) -> NDArray[np.int32]:
        """[num_games] int32, an action for every game; random numbers from the seat's stream."""
        actions = np.empty((view.num_games, 1), dtype=np.int32)
        self._fill(view, _numbers((view.seat,)), _numbers((0,)), actions)
        return actions[:, 0]

    def act_together(
        self, view: GameView, seats: tuple[int, ...], actions: NDArray[np.int32]
    ) -> None:
        """Write into `actions` [num_games, num_agents] what `act` would do in each of `seats`.

        In one pass over the games, and with one look at whom they all seek.
        """
        self._fill(view, _numbers(seats), _numbers(seats), actions)

    def _fill(
        self,
        view: GameView,
        seats: NDArray[np.int64],
        columns: NDArray[np.int64],
        actions: NDArray[np.int32],
    ) -> None:
        """Write into these columns of `actions` what the agents in `seats` do."""
        task = view.task
        room = max(task.max_cells, task.num_agents, task.num_goals)
        if room > self._scratch.shape[1]:
            self._scratch = _scratch_for(room)
        kernels.ENTRIES[self.kind](
            *view.games,
            view.streams,
            view.epsilon,
            seats,
            columns,
            (task.num_chasers, task.num_evaders, task.num_runners, task.num_goals),
            *view.mazes,
            self._greedy_table(view.mazes, task.stay_action),
            self._scratch,
            self._settings(task.stay_action),
            actions,
        )

    def on_device(self, task: Task, seat: int, mazes: MazeArrays) -> Call:
        """The same on a GPU: the kernel, and what it is given."""
        given = {
            "seats": _numbers((seat,)),
            "columns": _numbers((seat,)),
            "counts": tuple(task.teams),
            "greedy": self._greedy_table(mazes, task.stay_action),
            "settings": self._settings(task.stay_action),
        }
        return Call(kernels.ENTRIES[self.kind], given, work=("scripted", kernels.NUM_SCRATCH))

    def action_probabilities(self, maze: Maze, stay_action: bool = False) -> NDArray[np.float64]:
        """[self cell, other cell, action] float64: the exact distribution in a game of one to one.

        Raises:
            ValueError: the maze has too many cells for a table.
        """
        maze, stay_action = load_maze(maze), truth("stay_action", stay_action)
        if maze.num_cells > MAX_TABLE_CELLS:
            raise ValueError(
                f"{maze.name}: {maze.num_cells} cells; tables are made up to {MAX_TABLE_CELLS}"
            )
        arrays = lay_out((maze,))
        greedy = self._greedy_table(arrays, stay_action)
        pairs = (maze.num_cells, maze.num_cells)
        every = np.broadcast_to(arrays.world.moves[:, None], pairs)
        masks = greedy.reshape(pairs)
        actions = 5 if stay_action else 4
        # An enclosed cell has no move: whoever is there stays, or bumps into the north wall.
        nowhere = np.eye(actions)[4 if stay_action else 0]
        table = np.zeros((*pairs, actions))
        for weight, sets in ((1.0 - self.epsilon, masks), (self.epsilon, every)):
            chosen = (sets[..., None] >> np.arange(actions)) & 1
            size = chosen.sum(axis=-1, keepdims=True)
            table += weight * np.where(size == 0, nowhere, chosen / np.maximum(size, 1))
        return table

    def distribution(self, task: Task, games: Games, seat: int) -> NDArray[np.float64]:
        """[games, actions] float64: the exact distribution in chases of one evader by a team.

        Raises:
            ValueError: other games, another role's seat, or several mazes.
        """
        role = task.seat_roles[seat]
        own = getattr(self, "role", role)
        if own != role or task.num_evaders != 1 or task.num_goals or len(task.mazes) > 1:
            raise ValueError(
                f"{self!r} in the seat of {task.agent_names[seat]} of task {task.name!r}: its "
                "distribution is known in chases of one evader without goals, in one maze"
            )
        maze, cells = task.mazes[0], games.position
        table = self.action_probabilities(maze, task.stay_action)
        if role == "chaser":
            other = cells[:, task.num_chasers]
        else:  # of several the first that is nearest
            chasers = cells[:, : task.num_chasers]
            nearest = maze.distances[cells[:, seat, None], chasers].argmin(axis=1)
            other = np.take_along_axis(chasers, nearest[:, None], axis=1)[:, 0]
        return table[cells[:, seat], other]

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
        kernels.fill_greedy_table(
            kind, *mazes, _scratch_for(len(mazes.neighbors)), settings, greedy
        )
    return greedy


def _scratch_for(room: int) -> NDArray[np.int32]:
    return np.full((kernels.NUM_SCRATCH, room), -1, dtype=np.int32)


@lru_cache(maxsize=256)
def _numbers(seats: tuple[int, ...]) -> NDArray[np.int64]:
    """Seats as kernels take them."""
    return np.array(seats, dtype=np.int64)


class RandomAgent(Scripted):
    """Uniformly random among the moves that change the cell, whatever its epsilon."""

    def __init__(self) -> None:
        super().__init__(epsilon=1.0)
