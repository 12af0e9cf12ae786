"""Action masks for whoever asks for them (`mask_bumps=True`): they forbid moves into walls.

Every action is legal: a move into a wall leaves the agent in place, and without the stay action it
is the only way to wait, which the best chasers and evaders do. So nothing is masked by default.
All masks come from here: those of infos, of TorchRL's specs, of `action_masks()`, of our learners
and of the exact solvers.
"""

from __future__ import annotations

import warnings
from functools import cache
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from pursuit.mazes.maze import Maze
from pursuit.mazes.maze_arrays import lay_out
from pursuit.rules.layout import Games, World
from pursuit.tasks.task import Task

ACTION_MASK = "action_mask"
"""What libraries call a mask, in infos and in tensordicts."""
EVERY_SEAT = slice(None)


def bump_masks(maze: Maze, num_actions: int) -> NDArray[np.bool_]:
    """[cells, actions] bool: True where an action changes the cell, or is stay.

    In an enclosed cell, where no action is either, all are True.
    """
    return _masks_by_moves(num_actions)[lay_out((maze,)).world.moves]


def action_masks(
    games: Games,
    world: World,
    num_actions: int,
    seats: slice = EVERY_SEAT,
    terminated: NDArray[np.bool_] | None = None,
) -> NDArray[np.bool_]:
    """[games, seats, actions] bool, a fresh array: what the agents may do that bumps into no wall.

    All are True for agents that are captured, in enclosed cells and in games that are `terminated`.
    A game that was cut off keeps its masks: learners value the actions of its last state.

    Args:
        games: the games.
        world: their mazes, as `lay_out(task.mazes).world` has them.
        num_actions: 4, or 5 with the stay action.
        seats: whose masks.
        terminated: [games] bool.
    """
    cells = world.first_cell[games.maze][:, None] + games.position[:, seats]
    moves = world.moves[cells] * games.active[:, seats]
    if terminated is not None:
        moves[terminated] = 0
    return _masks_by_moves(num_actions)[moves]


@cache
def _masks_by_moves(num_actions: int) -> NDArray[np.bool_]:
    """[16, actions] bool: the mask of every set of moves that change the cell; all for none."""
    moves = np.arange(16)[:, None]
    masks = (moves >> np.arange(num_actions) & 1).astype(bool)
    masks[:, 4:] = True
    masks[0] = True
    return masks


def masked_space(observed: gymnasium.Space[Any], num_actions: int) -> gymnasium.spaces.Dict:
    """The space of {"observation", "action_mask"}, for libraries that want the mask in there."""
    mask = gymnasium.spaces.Box(0, 1, (num_actions,), np.int8)
    return gymnasium.spaces.Dict({"observation": observed, ACTION_MASK: mask})


def forbids_waiting(task: Task) -> bool:
    """Whether masks take from chasers or evaders the only way to wait.

    A runner in a maze gains nothing by waiting.
    """
    return not task.stay_action and bool(task.num_chasers or task.num_evaders)


def warn_of_masks(task: Task) -> None:
    """Warn where `mask_bumps` changes what the best play is; Python shows it once a task."""
    if forbids_waiting(task):
        warnings.warn(
            f"mask_bumps=True in task {task.name!r} without stay_action forbids waiting, which is "
            "a move into a wall here and part of optimal play: what is learned can fall far short "
            "of the optimum. Give stay_action=True, or leave mask_bumps out",
            stacklevel=2,  # one place for all environments of a kind: shown once
        )
