"""Solutions under limited sight in files: what was found so far, to go on with."""

from __future__ import annotations

import json
import os
import struct
import zipfile
import zlib
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.mazes.maze import Maze
from scripted_agents.hidden.game import SightRules, hidden_chase
from scripted_agents.hidden.search import HiddenSearch

FORMAT = 1

UNREADABLE = (
    ValueError, KeyError, TypeError, EOFError, NotImplementedError, RuntimeError, struct.error,
    zipfile.BadZipFile, zlib.error,
)  # fmt: skip
"""What reading a damaged .npz raises."""

COUNTED = ("inverse", "value", "first", "vectors", "action", "follow")
"""Arrays of the bounds that end in the number of the point or plan."""


def save_search(
    path: Path, maze: Maze, rules: SightRules, table: NDArray[np.float64], search: HiddenSearch
) -> Path:
    """Write a search and what it is of, beside `path` and renamed; .npz is added where missing."""
    path = path if path.suffix == ".npz" else path.with_name(path.name + ".npz")
    about = {"format": FORMAT, "maze": maze.to_text(), "name": maze.name, "rules": asdict(rules)}
    points, plans = int(search.lower_bound.count.max()), int(search.upper_bound.count.max())
    arrays: dict[str, Any] = {
        "about": np.array(json.dumps(about)),
        "table": table,
        "numbers": np.array([search.seconds, search.looks, search.slack]),
        "roots_low": search.roots.low,
        **_bounds(search, points, plans),
    }
    partial = path.with_name(f".{path.name}.{os.getpid()}.npz")
    try:
        np.savez_compressed(partial, **arrays)
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)
    return path


def load_search(
    path: Path, memory: int
) -> tuple[Maze, SightRules, NDArray[np.float64], HiddenSearch]:
    """The maze, the rules, the opponent's table and the search that `save_search` wrote.

    Raises:
        ValueError: it is no such file, a damaged one, or larger than `memory` allows.
        OSError: it cannot be read.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = dict(file)
        about, table = json.loads(str(arrays["about"])), arrays["table"]
        if about["format"] != FORMAT:
            raise ValueError(f"format {about['format']}; this version reads {FORMAT}")
        maze, rules = Maze.from_text(about["maze"], about["name"]), SightRules(**about["rules"])
        search = HiddenSearch(hidden_chase(maze, table, rules), memory)
        _restore(search, arrays)
    except UNREADABLE as error:
        raise ValueError(
            f"{path}: no solution that can be read ({error}); give a file that "
            "HiddenChaseSolution.save wrote"
        ) from None
    return maze, rules, table, search


def _bounds(search: HiddenSearch, points: int, plans: int) -> dict[str, NDArray[Any]]:
    """Views of both bounds, of so many points and plans of every own cell."""
    sides = (("lower", search.lower_bound, points), ("upper", search.upper_bound, plans))
    return {
        f"{side}_{name}": array[..., :most] if name in COUNTED else array
        for side, bound, most in sides
        for name, array in bound._asdict().items()
    }


def _restore(search: HiddenSearch, state: dict[str, NDArray[Any]]) -> None:
    """Put saved arrays into a new search of the same game.

    Raises:
        ValueError: arrays of another game, or more than the memory of this search holds.
        KeyError: there are fewer.
    """
    lower, upper, actions = search.lower_bound, search.upper_bound, search.game.next_own.shape[1]
    points, plans = state["lower_value"].shape[-1], state["upper_action"].shape[-1]
    if points > lower.value.shape[1] or plans > upper.action.shape[1]:
        raise ValueError(f"{points} points and {plans} plans a cell; give it more memory")
    numbers = np.zeros(3)
    targets = {"numbers": numbers, "roots_low": search.roots.low, **_bounds(search, points, plans)}
    for name, target in targets.items():
        given = state[name]
        if (given.shape, given.dtype) != (target.shape, target.dtype) or (given != given).any():
            raise ValueError(f"{name} is {given.dtype} {given.shape}, not of this game")
    for name, least, most in (
        ("lower_count", 0, points),
        ("upper_count", 1, plans),
        ("upper_action", -1, actions - 1),
        ("upper_seen_action", -1, actions - 1),
    ):
        if state[name].min() < least or state[name].max() > most:
            raise ValueError(f"{name} reaches outside {least} to {most}")
    live = np.arange(plans) < state["upper_count"][:, None]
    for name, there in (("upper_", live), ("upper_seen_", True)):
        action, following = state[f"{name}action"], state[f"{name}follow"]
        after = np.take_along_axis(search.game.next_own, np.maximum(action, 0), axis=1)
        known = (following >= 0) & (following < state["upper_count"][after])
        if (there & (action >= 0) & ~known).any():
            raise ValueError(f"{name}follow names plans that are not there")
    for name, target in targets.items():
        target[...] = state[name]
    search.seconds, search.looks, search.slack = float(numbers[0]), int(numbers[1]), numbers[2]
    search.look_at_starts()
