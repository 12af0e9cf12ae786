"""Settings, start cells and seeds of the next episode, checked before anything is changed."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pursuit.rules.layout import NextEpisode
from pursuit.rules.randomness import seed_starts as seed_start_streams
from pursuit.tasks.placements import check_placeable
from pursuit.tasks.task import Task
from pursuit.validation import as_array, one_of, whole_numbers

LARGEST = 2**31 - 1


def configure(
    task: Task,
    pending: NextEpisode,
    games: NDArray[np.intp],
    *,
    epsilon: ArrayLike | None,
    seat: int | str | None,
    goals_around: str | None,
    **numbers: ArrayLike | None,
) -> None:
    """Write settings into `pending`; see `Simulator.configure`.

    Raises:
        ValueError: a value out of range, or an impossible start. Nothing is changed then.
    """
    seats = slice(None) if seat is None else task.seat(seat)
    changed: dict[str, Any] = {}
    if epsilon is not None:
        changed["epsilon"] = pending.epsilon[games]
        fill_epsilon(changed["epsilon"][:, seats], epsilon)
    given = {name: value for name, value in numbers.items() if value is not None}
    limits = limits_of(task) if given else {}
    for name, value in given.items():
        changed[name] = np.empty(len(games), dtype=np.int32)
        fill(name, changed[name], whole_numbers(name, value, *limits[name]))
    if goals_around is not None:
        one_of("goals_around", goals_around, ("start", "marks"))
        changed["goals_around_marks"] = np.int32(goals_around == "marks")
    if changed.keys() - {"epsilon", "goal_radius"}:
        waiting = {name: array[games] for name, array in pending._asdict().items()}
        check_waiting(task, NextEpisode(**waiting | changed))
    for name, values in changed.items():
        getattr(pending, name)[games] = values


def limits_of(task: Task) -> dict[str, tuple[int, int]]:
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


def checked_shares(epsilon: ArrayLike) -> NDArray[np.float64]:
    """Probabilities of random moves as float64; NaN uses the epsilon of the agent.

    Raises:
        ValueError: not a number, or outside [0, 1].
    """
    rule = "give probabilities from 0 to 1; NaN uses the epsilon of the agent"
    shares = as_array("epsilon", epsilon, "iuf", rule).astype(np.float64)
    if ((shares < 0) | (shares > 1)).any():
        raise ValueError(f"epsilon={epsilon!r}; {rule}")
    return shares


def fill_epsilon(array: NDArray[np.float64], epsilon: ArrayLike) -> None:
    """Write probabilities of random moves into `array` [games, agents], or [games] of one agent.

    Args:
        array: the array to fill.
        epsilon: a number, [games] (for all agents of a game), or the shape of `array`.

    Raises:
        ValueError: a value outside [0, 1], or a wrong shape.
    """
    shares = checked_shares(epsilon)
    fits = shares.ndim == 0 or shares.shape in (array.shape[:1], array.shape)
    if not fits and shares.size != 1:
        rest = "" if array.ndim == 1 else f", or {array.shape}, games by agents"
        raise ValueError(
            f"epsilon of shape {shares.shape}; give one number, {array.shape[:1]} for one per "
            f"game{rest}"
        )
    array[:] = shares[:, None] if shares.ndim == 1 and array.ndim == 2 else shares


def fill(name: str, array: NDArray[Any], values: NDArray[Any]) -> None:
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


def start_at(
    task: Task,
    pending: NextEpisode,
    positions: ArrayLike,
    goals: ArrayLike | None,
    maze: ArrayLike | None,
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]:
    """The cells of all agents and goals, and the mazes, of every game; see `Simulator.place`.

    Raises:
        ValueError: invalid cells or mazes.
    """
    games = len(pending.maze)
    agents = np.empty((games, task.num_agents), dtype=np.int32)
    wanted = np.empty((games, task.num_goals), dtype=np.int32)
    mazes = pending.maze.copy() if len(task.mazes) > 1 else np.zeros(games, dtype=np.int32)
    if maze is not None:
        fill("maze", mazes, whole_numbers("maze", maze, 0, len(task.mazes) - 1))
    if (mazes < 0).any():
        raise ValueError(
            f"maze is missing; this task has {len(task.mazes)}: give the index of one, or one per "
            "game"
        )
    fill("positions", agents, whole_numbers("positions", positions, 0, task.max_cells - 1))
    if goals is None and task.num_goals:
        raise ValueError(f"goals are missing; give cells for {task.num_goals} goals")
    if goals is not None:
        cells = whole_numbers("goals", goals, -1, task.max_cells - 1)
        if cells.size and not task.num_goals:
            raise ValueError(f"goals={goals!r}; this task has no goals, leave them out")
        fill("goals", wanted, cells)
    sizes = np.array([each.num_cells for each in task.mazes])[mazes][:, None]
    both = np.concatenate([agents, wanted], axis=1)
    if (both >= sizes).any():
        game, place = np.argwhere(both >= sizes)[0]
        raise ValueError(
            f"cell {both[game, place]} in positions or goals; the cells of maze "
            f"{task.mazes[mazes[game]].name} are 0 to {sizes[game, 0] - 1}"
        )
    ordered = np.sort(both, axis=1)
    if ((ordered[:, 1:] == ordered[:, :-1]) & (ordered[:, 1:] >= 0)).any():
        raise ValueError("two agents or goals start in the same cell; give different cells")
    return agents, wanted, mazes


def seed_starts(streams: NDArray[np.uint64], games: NDArray[np.intp], seeds: Any) -> None:
    """Seed the next starts; see `Simulator.seed_starts`.

    Raises:
        ValueError: a seed out of range, or a wrong number of them.
    """
    each = np.zeros(len(games), dtype=np.uint64)
    fill("seeds", each, whole_numbers("seeds", seeds, 0, 2**63 - 1))
    seed_start_streams(streams, games, each)


def slots(games: ArrayLike | None, num_games: int) -> NDArray[np.intp]:
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
