"""Optional action masks (`mask_bumps=True`), which forbid moves into walls.

Every action is legal: a move into a wall leaves the agent in place. Without the stay action it is
the only way to wait, which optimal chasers and evaders do. So nothing is masked by default. The
masks of infos, of TorchRL's specs, of `action_masks()`, of the learners and of the exact solvers
are all computed here.
"""

from __future__ import annotations

import warnings
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from pursuit.mazes.maze import Maze
from pursuit.mazes.maze_arrays import lay_out
from pursuit.rules import layout
from pursuit.rules.layout import Games, World
from pursuit.tasks.task import Task

ACTION_MASK = "action_mask"
"""The key of a mask in infos and in tensordicts."""
EVERY_SEAT = slice(None)


def bump_masks(maze: Maze, num_actions: int) -> NDArray[np.bool_]:
    """[cells, actions] bool: True if an action changes the cell, or is stay.

    All are True in an enclosed cell without such an action.
    """
    return _masks_of(lay_out((maze,)).world.moves, maze.num_moves, num_actions)


def action_masks(
    games: Games,
    world: World,
    num_actions: int,
    seats: slice = EVERY_SEAT,
    terminated: NDArray[np.bool_] | None = None,
) -> NDArray[np.bool_]:
    """[games, seats, actions] bool, a new array: the actions that are not moves into a wall.

    All are True for captured agents, in enclosed cells and in games that are `terminated`. A
    truncated game keeps its masks, as learners evaluate the actions of its last state.

    Args:
        games: the games.
        world: their mazes, `lay_out(task.mazes).world`.
        num_actions: the moves, and the stay action if there is one.
        seats: the indices of the agents.
        terminated: [games] bool.
    """
    cells = world.first_cell[games.maze][:, None] + games.position[:, seats]
    moves = world.moves[cells] * games.active[:, seats]
    if terminated is not None:
        moves[terminated] = 0
    return _masks_of(moves, layout.named_views(layout.stay_of, world), num_actions)


def _masks_of(moves: NDArray[np.int32], num_moves: int, num_actions: int) -> NDArray[np.bool_]:
    """[..., actions] bool: the masks of sets of moves that change the cell; all True if empty."""
    masks = (moves[..., None] >> np.arange(num_actions) & 1).astype(bool)
    masks[..., num_moves:] = True
    masks |= moves[..., None] == 0
    return masks


def masked_space(observed: gymnasium.Space[Any], num_actions: int) -> gymnasium.spaces.Dict:
    """The space of {"observation", "action_mask"}, for libraries that expect the mask there."""
    mask = gymnasium.spaces.Box(0, 1, (num_actions,), np.int8)
    return gymnasium.spaces.Dict({"observation": observed, ACTION_MASK: mask})


def forbids_waiting(task: Task) -> bool:
    """Whether masks forbid chasers or evaders to wait.

    Waiting is never optimal for a runner.
    """
    return not task.stay_action and bool(task.num_chasers or task.num_evaders)


def warn_of_masks(task: Task) -> None:
    """Warn if `mask_bumps` changes optimal play; Python shows the warning once for each task."""
    if forbids_waiting(task):
        warnings.warn(
            f"mask_bumps=True in task {task.name!r} without stay_action forbids waiting (a move "
            "into a wall), which is part of optimal play: the optimality gap can become large. "
            "Give stay_action=True, or leave mask_bumps out",
            stacklevel=2,  # the same location for all environments, so shown once
        )
