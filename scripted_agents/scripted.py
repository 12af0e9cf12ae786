"""Scripted: the common ground of the heuristic agents, from settings to actions and tables."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pursuit import rules
from pursuit.maze import MAX_TABLE_CELLS, Maze
from pursuit.policy import GameView
from pursuit.simulator import lay_out
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
        if not 0.0 <= epsilon <= 1.0:
            raise ValueError(f"epsilon={epsilon}; a share of random moves lies in [0, 1]")
        self.epsilon = float(epsilon)
        self._scratch = np.full((4, 1), -1, dtype=np.int32)
        self._targets = np.zeros(1, dtype=np.int32)
        self._greedy: dict[tuple[int, bool], tuple[object, NDArray[np.uint8]]] = {}

    def __repr__(self) -> str:
        return f"{type(self).__name__}(epsilon={self.epsilon:g})"

    def act(self, view: GameView) -> NDArray[np.int32]:
        """[num_games] int32, an action for every game; random numbers from the seat's stream."""
        task = view.task
        if view.cells.shape[0] > self._scratch.shape[1]:
            self._scratch = np.full((4, view.cells.shape[0]), -1, dtype=np.int32)
        if task.num_agents + task.num_goals > len(self._targets):
            self._targets = np.zeros(task.num_agents + task.num_goals, dtype=np.int32)
        actions = np.empty(view.num_games, dtype=np.int32)
        kernels.choose_actions(
            self.kind,
            view.rows,
            view.streams,
            view.epsilons,
            view.seat,
            (task.num_chasers, task.num_evaders, task.num_runners, task.num_goals),
            view.mazes,
            view.cells,
            view.tables,
            self._greedy_table(view.mazes, view.cells, view.tables, task.stay_action),
            self._scratch,
            self._targets,
            (self.epsilon, self.alert_distance, self.look_radius, task.stay_action),
            actions,
        )
        return actions

    def action_probabilities(self, maze: Maze, stay_action: bool = False) -> NDArray[np.float64]:
        """[self cell, other cell, action] float64: the exact distribution in a game of one to one.

        Raises:
            ValueError: the maze has too many cells for a table.
        """
        if maze.num_cells > MAX_TABLE_CELLS:
            raise ValueError(
                f"{maze.name}: {maze.num_cells} cells; tables are made up to {MAX_TABLE_CELLS}"
            )
        arrays = lay_out((maze,))
        greedy = self._greedy_table(arrays.mazes, arrays.cells, arrays.tables, stay_action)
        pairs = (maze.num_cells, maze.num_cells)
        every = np.broadcast_to(arrays.cells[:, None, rules.MOVE_MASK], pairs)
        masks = np.where(greedy.reshape(pairs) == 0, every, greedy.reshape(pairs))
        actions = 5 if stay_action else 4
        # An enclosed cell has no move: whoever is there stays, or bumps into the north wall.
        nowhere = np.eye(actions)[4 if stay_action else 0]
        table = np.zeros((*pairs, actions))
        for share, sets in ((1.0 - self.epsilon, masks), (self.epsilon, every)):
            chosen = (sets[..., None] >> np.arange(actions)) & 1
            size = chosen.sum(axis=-1, keepdims=True)
            table += share * np.where(size == 0, nowhere, chosen / np.maximum(size, 1))
        return table

    def _greedy_table(
        self,
        mazes: NDArray[np.int64],
        cells: NDArray[np.int32],
        tables: NDArray[np.uint16],
        stay_action: bool,
    ) -> NDArray[np.uint8]:
        """The greedy moves at every [own, other], laid out as the distance tables, as bit masks."""
        key = (id(tables), stay_action)
        if key not in self._greedy or self._greedy[key][0] is not tables:
            greedy = np.zeros(len(tables), dtype=np.uint8)
            if self.kind != kernels.RANDOM:
                scratch = np.full((4, len(cells)), -1, dtype=np.int32)
                settings = (self.alert_distance, self.look_radius, stay_action)
                kernels.fill_greedy_table(
                    self.kind, mazes, cells, tables, scratch, *settings, greedy
                )
            # Holding on to `tables` keeps its id from being given to another array; only a copied
            # agent holds ids of arrays that it does not have.
            self._greedy[key] = (tables, greedy)
        return self._greedy[key][1]


class RandomAgent(Scripted):
    """Uniformly random among the moves that change the cell, whatever its epsilon."""

    def __init__(self) -> None:
        super().__init__(epsilon=1.0)
