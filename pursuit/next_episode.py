"""What takes effect as the next episode of a game begins: settings, and starts that repeat."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pursuit.rules.layout import NextEpisode
from pursuit.rules.randomness import seed_starts as seed_start_streams
from pursuit.task import Task

LARGEST = 2**31 - 1


def configure(
    task: Task,
    coming: NextEpisode,
    games: NDArray[np.intp],
    *,
    epsilon: ArrayLike | None,
    seat: int | str | None,
    goals_around: str | None,
    **numbers: ArrayLike | None,
) -> None:
    """Write the settings that are given into `coming`; see `Simulator.configure`.

    Raises:
        ValueError: a value out of range; nothing is changed then.
    """
    seats = slice(None) if seat is None else task.seat(seat)
    shares = None if epsilon is None else _shares(epsilon, seat is None)
    if shares is not None:
        np.broadcast_to(shares, coming.epsilon[games, seats].shape)  # or ValueError
    limits = {
        "maze": (-1, len(task.mazes) - 1),
        "num_goals": (-1, task.num_goals),
        "goal_radius": (-1, LARGEST),
        "min_start_distance": (1, LARGEST),
        "max_start_distance": (-1, LARGEST),
    }
    given = {name: value for name, value in numbers.items() if value is not None}
    for name, value in given.items():
        array, (least, most) = np.asarray(value), limits[name]
        if array.dtype.kind not in "iu" or array.min() < least or array.max() > most:
            raise ValueError(f"{name}={value!r}; whole numbers from {least} to {most}")
        np.broadcast_to(array, games.shape)  # or ValueError
    if goals_around not in (None, "start", "marks"):
        raise ValueError(f"goals_around={goals_around!r}; one of start, marks")
    if goals_around == "marks" and not all(maze.goal_marks for maze in task.mazes):
        raise ValueError("goals_around='marks', but a maze of this task has no goal mark 'G'")
    if shares is not None:
        coming.epsilon[games, seats] = shares
    for name, value in given.items():
        getattr(coming, name)[games] = value
    if goals_around is not None:
        coming.goals_around_marks[games] = goals_around == "marks"


def _shares(epsilon: ArrayLike, for_all_seats: bool) -> NDArray[np.float64]:
    shares = np.asarray(epsilon, dtype=np.float64)
    if ((shares < 0) | (shares > 1)).any():
        raise ValueError(f"epsilon={epsilon!r}; a share of random moves lies in [0, 1]")
    return shares[:, None] if shares.ndim == 1 and for_all_seats else shares


def seed_starts(streams: NDArray[np.uint64], games: NDArray[np.intp], seeds: Any) -> None:
    """Make the next starts those of their seeds; see `Simulator.seed_starts`.

    Raises:
        ValueError: a seed out of range, or a wrong number of them.
    """
    array = np.asarray(seeds)
    if array.dtype.kind not in "iu" or (array.size and not 0 <= array.min() <= array.max()):
        raise ValueError(f"seeds={seeds!r}; whole numbers from 0 to 2**63 - 1")
    each = np.broadcast_to(array, games.shape).astype(np.uint64)  # or ValueError
    seed_start_streams(streams, games, each)
