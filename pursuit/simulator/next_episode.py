"""Checks of the settings of the next episode, before anything is changed."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pursuit.rules.arrays import Array
from pursuit.rules.layout import NextEpisode
from pursuit.tasks.placements import check_placeable
from pursuit.tasks.task import Task
from pursuit.validation import as_array, whole_numbers

LARGEST = 2**31 - 1


def setting_limits(task: Task) -> dict[str, tuple[int, int]]:
    """The smallest and largest values of the integer settings."""
    return {
        "maze": (-1, len(task.mazes) - 1),
        "num_goals": (-1, task.num_goals),
        "goal_radius": (-1, LARGEST),
        "goals_around_marks": (-1, 1),
        "min_start_distance": (1, LARGEST),
        "max_start_distance": (-1, LARGEST),
    }


def check_waiting(task: Task, waiting: NextEpisode) -> None:
    """Check that an episode can start with these settings, in all mazes that can be drawn.

    Raises:
        ValueError: goals around missing marks, or distances that no placement satisfies.
    """
    if (waiting.goals_around_marks > 0).any() and not all(m.goal_marks for m in task.mazes):
        raise ValueError("goals_around='marks', but a maze of this task has no goal mark 'G'")
    least, most = waiting.min_start_distance, waiting.max_start_distance
    if (least <= 1).all() and (most < 0).all():
        return
    columns = (waiting.maze, waiting.num_goals, least, most)
    for maze, *numbers in np.unique(np.stack(columns, axis=1), axis=0).tolist():
        for number in range(len(task.mazes)) if maze < 0 else (maze,):
            check_placeable(task.apart(number, *numbers))


def fill_epsilon(array: NDArray[np.float64], epsilon: ArrayLike, name: str = "epsilon") -> None:
    """Write probabilities of random moves into `array` [games, agents], or [games] of one agent.

    Args:
        array: the array to fill.
        epsilon: a number, [games] (for all agents of a game), or the shape of `array`.
        name: of the setting: "epsilon", or "slip" for probabilities of slips.

    Raises:
        ValueError: a value outside [0, 1], or a wrong shape.
    """
    rule = "give probabilities from 0 to 1"
    rule += "; NaN uses the epsilon of the agent" if name == "epsilon" else ""
    shares = as_array(name, epsilon, "iuf", rule).astype(np.float64)
    missing = name != "epsilon" and np.isnan(shares).any()
    if ((shares < 0) | (shares > 1)).any() or missing:
        raise ValueError(f"{name}={epsilon!r}; {rule}")
    fits = shares.ndim == 0 or shares.shape in (array.shape[:1], array.shape)
    if not fits and shares.size != 1:
        rest = "" if array.ndim == 1 else f", or {array.shape}, games by agents"
        raise ValueError(
            f"{name} of shape {shares.shape}; give one number, {array.shape[:1]} for one per "
            f"game{rest}"
        )
    array[:] = shares[:, None] if shares.ndim == 1 and array.ndim == 2 else shares


def fill(name: str, array: Array, values: Array) -> None:
    """Fill the array with one value for all games, or with one per game.

    Raises:
        ValueError: another number of values. Nothing is written then.
    """
    if values.size == 0 < array.size:
        raise ValueError(f"{name}: no value for {len(array)} games; give one, or one per game")
    if values.size == 0 or array.size == 0:
        return
    try:
        array[:] = values
    except ValueError:
        raise ValueError(
            f"{name} of shape {values.shape} for games of shape {array.shape}; give one for all, "
            "or one per game"
        ) from None


def placed_exits(
    task: Task,
    exits: ArrayLike | None,
    mazes: NDArray[np.int32],
    agents: NDArray[np.int32],
    goals: NDArray[np.int32],
) -> NDArray[np.int32]:
    """[games, exits] int32: given exits of games in these mazes, or the fixed ones of the mazes.

    Raises:
        ValueError: missing exits, or some of a task with fixed ones; a cell out of range or twice;
            an evader (of `agents` [games, agents]) or one of `goals` [games, goals] on an exit.
    """
    count, size = task.num_exits, task.most_exits
    places = np.full((len(mazes), size), -1, dtype=np.int32)
    if not count:
        if exits is not None:
            raise ValueError(f"exits={exits!r}; the exits of this task are fixed: leave them out")
        for game, maze in enumerate(mazes.tolist() if size else []):
            places[game, : len(task.fixed_exits[maze])] = task.fixed_exits[maze]
    else:
        if exits is None:
            raise ValueError(f"exits are missing; give cells for {count} exits")
        fill("exits", places, whole_numbers("exits", exits, 0, task.max_cells - 1))
        sizes = np.array([maze.num_cells for maze in task.mazes])[mazes]
        ordered = np.sort(places, axis=1)
        if (ordered[:, -1] >= sizes).any() or (ordered[:, 1:] == ordered[:, :-1]).any():
            raise ValueError(f"exits={exits!r}; give different cells of the maze")
    evaders = agents[:, task.num_chasers : task.num_chasers + task.num_evaders]
    if (evaders[:, :, None] == places[:, None]).any():
        raise ValueError("an evader starts on an exit; give another cell")
    if ((goals[:, :, None] == places[:, None]) & (goals[:, :, None] >= 0)).any():
        raise ValueError("a goal is on an exit; give another cell")
    return places


def game_indices(games: ArrayLike | None, num_games: int) -> NDArray[np.intp]:
    """The indices of `games`, a bool mask or indices below `num_games`; all for None.

    Raises:
        ValueError: neither a mask nor indices, or an index out of range.
    """
    every = np.arange(num_games)
    if games is None:
        return every
    rule = f"give a mask of {num_games} bools, or indices"
    array = as_array("games", games, "biu", rule)
    if array.size == 0:
        return every[:0]
    if array.ndim > 1 or (array.ndim == 0 and array.dtype.kind == "b"):
        raise ValueError(f"games={games!r}; {rule}")
    try:
        return np.atleast_1d(every[array])
    except IndexError as error:
        raise ValueError(f"games={games}: {error}; {rule}") from None
