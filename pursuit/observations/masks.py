"""Optional action masks (`mask_bumps=True`), which forbid moves into walls.

Every action is legal: a move into a wall leaves the agent in place. Without the stay action it is
the only way to wait, which optimal chasers and evaders do. So nothing is masked by default, but in
turns (`Task.move_order`), where the side that waits can only stay. Masks also forbid moves that
another agent certainly blocks (`Task.collisions`). The masks of infos, of TorchRL's specs, of
`action_masks()`, of the learners and of the exact solvers are all computed here.
"""

from __future__ import annotations

import warnings
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from pursuit.mazes.maze import Maze
from pursuit.mazes.maze_arrays import lay_out
from pursuit.rules.layout import FIRST_CELL, MOVES, Games, World
from pursuit.tasks.task import Task

ACTION_MASK = "action_mask"
"""The key of a mask in infos and in tensordicts."""
EVERY_SEAT = slice(None)


def bump_masks(maze: Maze, num_actions: int) -> NDArray[np.bool_]:
    """[cells, actions] bool: True if an action changes the cell, or is stay.

    All are True in an enclosed cell without stay.
    """
    masks = _masks_of(lay_out((maze,)).facts[MOVES], maze.num_moves, num_actions)
    return masks | ~masks.any(axis=1, keepdims=True)


def task_has_masks(task: Task, mask_bumps: bool) -> bool:
    """Whether the agents of a task get masks: asked for by `mask_bumps`, or in turns."""
    return mask_bumps or task.options.turns


def action_masks(
    games: Games,
    world: World,
    task: Task,
    seats: slice = EVERY_SEAT,
    terminated: NDArray[np.bool_] | None = None,
) -> NDArray[np.bool_]:
    """[games, seats, actions] bool, a new array: the actions that are not moves into a wall.

    Nor are they moves into a cell that is certainly blocked, of what the agent sees; in turns the
    side that is not to move can only stay. All are True for captured agents, in games that are
    `terminated`, and without stay for agents that cannot move. A truncated game keeps its masks, as
    learners evaluate the actions of its last state.

    Args:
        games: the games.
        world: their mazes, `lay_out(task.mazes)`.
        task: of the games.
        seats: the indices of the agents.
        terminated: [games] bool.
    """
    free = world.facts[
        MOVES, world.mazes[FIRST_CELL, games.maze][:, None] + games.position[:, seats]
    ]
    if task.options.block:
        for column, seat in enumerate(range(task.num_agents)[seats]):
            free[:, column] &= ~_blocked_moves(games, world, task, seat)
    masks = _masks_of(free, task.num_moves, task.num_actions)
    if task.options.turns:
        chases = np.arange(task.num_agents)[seats] < task.num_chasers
        masks[(games.steps[:, None] & 1) == chases, : task.num_moves] = False
    over = (games.active[:, seats] == 0) | ~masks.any(axis=2)
    masks[over if terminated is None else over | terminated[:, None]] = True
    return masks


def _blocked_moves(games: Games, world: World, task: Task, seat: int) -> NDArray[np.int32]:
    """[games] int32: the bit mask of the moves into cells of solid agents that the agent sees.

    Where chasers move first, they may leave their cells before an evader moves, and other evaders
    may be captured; only those are certain to be there that too few chasers can reach.
    """
    seen, blocked = task.sight.observed_games(games, seat), np.zeros_like(games.steps)
    here = world.mazes[FIRST_CELL, games.maze] + games.position[:, seat]
    role, chasers_first = task.seat_roles[seat], task.move_order == "chasers_first"
    for other, its in enumerate(task.seat_roles):
        across = task.capture != "cell" and {role, its} == {"chaser", "evader"}
        gone = across and role == "evader" and chasers_first
        if other == seat or gone or not (its == role or across):
            continue
        present = seen.active[:, other] != 0
        if role == "evader" and chasers_first:
            present &= ~_can_be_captured(seen, world, task, other)
        for action in range(task.num_moves):
            held = present & (world.neighbors[here, action] == seen.position[:, other])
            blocked |= held.astype(np.int32) << action
    return blocked


def _can_be_captured(seen: Games, world: World, task: Task, evader: int) -> NDArray[np.bool_]:
    """[games] bool: whether enough chasers may capture an evader by their next move; those out of
    view may."""
    first, target = world.mazes[FIRST_CELL, seen.maze][:, None], seen.position[:, evader, None]
    near = np.zeros(len(seen.steps), dtype=np.int64)
    for chaser in range(task.num_chasers):
        cells = np.maximum(seen.position[:, chaser, None], 0)
        steps = 1 if task.capture == "cell" else 2
        for _ in range(steps):
            after = world.neighbors[first + cells].reshape(len(cells), -1)
            cells = np.concatenate([cells, after], axis=1)
        near += (seen.active[:, chaser] == 0) | (cells == target).any(axis=1)
    return near >= (1 if task.capture == "surround" else task.n_catch)


def _masks_of(moves: NDArray[np.int32], num_moves: int, num_actions: int) -> NDArray[np.bool_]:
    """[..., actions] bool: the masks of sets of moves that change the cell; stay is True."""
    masks = (moves[..., None] >> np.arange(num_actions) & 1).astype(bool)
    masks[..., num_moves:] = True
    return masks


def masked_space(observed: gymnasium.Space[Any], num_actions: int) -> gymnasium.spaces.Dict:
    """The space of {"observation", "action_mask"}, for libraries that expect the mask there."""
    mask = gymnasium.spaces.Box(0, 1, (num_actions,), np.int8)
    return gymnasium.spaces.Dict({"observation": observed, ACTION_MASK: mask})


def warn_of_masks(task: Task) -> None:
    """Warn if `mask_bumps` changes optimal play; Python shows the warning once for each task."""
    if not task.stay_action and (task.num_chasers or task.num_evaders):  # no runner has to wait
        warnings.warn(
            f"mask_bumps=True in task {task.name!r} without stay_action forbids waiting (a move "
            "into a wall), which is part of optimal play: the optimality gap can become large. "
            "Give stay_action=True, or leave mask_bumps out",
            stacklevel=2,  # the same location for all environments, so shown once
        )
