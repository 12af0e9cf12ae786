"""Solutions under limited sight in files: what was found so far, to go on with."""

from __future__ import annotations

import json
import os
import struct
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.maze import Maze
from scripted_agents.hidden_search import HiddenSearch

FORMAT = 1

UNREADABLE = (
    ValueError, KeyError, TypeError, EOFError, NotImplementedError, RuntimeError, struct.error,
    zipfile.BadZipFile, zlib.error,
)  # fmt: skip
"""What reading a damaged .npz raises."""
REMEDY = "give a file that HiddenChaseSolution.save wrote"


def save_search(
    path: Path, maze: Maze, rules: Any, table: NDArray[np.float64], search: HiddenSearch
) -> Path:
    """Write a search and what it is of, beside `path` and renamed; .npz is added where missing."""
    path = path if path.suffix == ".npz" else path.with_name(path.name + ".npz")
    about = {"format": FORMAT, "maze": maze.to_text(), "name": maze.name, "rules": asdict(rules)}
    partial = path.with_name(f".{path.name}.{os.getpid()}.npz")
    try:
        arrays: dict[str, Any] = {"about": np.array(json.dumps(about)), "table": table}
        arrays |= state_of(search)
        np.savez_compressed(partial, **arrays)
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)
    return path


def load_search(
    path: Path,
) -> tuple[Maze, dict[str, Any], NDArray[np.float64], Callable[[HiddenSearch], None]]:
    """The maze, the rules, the opponent's table, and what puts the bounds into a new search.

    Raises:
        ValueError: it is no such file, or a damaged one.
        OSError: it cannot be read.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        about = json.loads(str(arrays.pop("about")))
        if about["format"] != FORMAT:
            raise ValueError(f"format {about['format']}; this version reads {FORMAT}")
        maze = Maze.from_text(about["maze"], about["name"])
        table = arrays.pop("table")
        rules = dict(about["rules"])
    except UNREADABLE as error:
        raise ValueError(f"{path}: no solution that can be read ({error}); {REMEDY}") from None

    def put(search: HiddenSearch) -> None:
        try:
            restore(search, arrays)
        except (ValueError, KeyError, TypeError) as error:
            raise ValueError(f"{path}: {error}; {REMEDY}") from None

    return maze, rules, table, put


def state_of(search: HiddenSearch) -> dict[str, NDArray[Any]]:
    """All that a search has found, as plain arrays; views of its own."""
    points, plans = int(search.lower_bound.count.max()), int(search.upper_bound.count.max())
    return {
        "numbers": np.array([search.seconds, search.looks, search.slack]),
        "roots_low": search.roots.low,
        **_views(search, points, plans),
    }


def _views(search: HiddenSearch, points: int, plans: int) -> dict[str, NDArray[Any]]:
    lower, upper = search.lower_bound, search.upper_bound
    return {
        "lower_seen": lower.seen,
        "lower_inverse": lower.inverse[..., :points],
        "lower_value": lower.value[:, :points],
        "lower_count": lower.count,
        "upper_seen": upper.seen,
        "upper_seen_action": upper.seen_action,
        "upper_seen_follow": upper.seen_follow,
        "upper_vectors": upper.vectors[..., :plans],
        "upper_action": upper.action[:, :plans],
        "upper_follow": upper.follow[:, :plans],
        "upper_count": upper.count,
    }


def restore(search: HiddenSearch, state: dict[str, NDArray[Any]]) -> None:
    """Put what `state_of` gave into a new search of the same game.

    Raises:
        ValueError: arrays of another game, or more than the memory of this search holds.
        KeyError: there are fewer.
    """
    lower, upper, actions = search.lower_bound, search.upper_bound, search.game.next_own.shape[1]
    points, plans = state["lower_value"].shape[-1], state["upper_action"].shape[-1]
    if points > lower.value.shape[1] or plans > upper.action.shape[1]:
        raise ValueError(f"{points} points and {plans} plans a cell; give it more memory")
    numbers, low = state["numbers"], state["roots_low"]
    targets = _views(search, points, plans)
    for name, target in {**targets, "roots_low": search.roots.low, "numbers": np.zeros(3)}.items():
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
    for name, there in (("upper_", live), ("upper_seen_", ~np.zeros_like(search.game.visible))):
        action, following = state[f"{name}action"], state[f"{name}follow"]
        after = np.take_along_axis(search.game.next_own, np.maximum(action, 0), axis=1)
        known = (following >= 0) & (following < state["upper_count"][after])
        if (there & (action >= 0) & ~known).any():
            raise ValueError(f"{name}follow names plans that are not there")
    for name, target in targets.items():
        target[...] = state[name]
    inverse = lower.inverse[..., :points]
    weights = np.where((inverse > 0.0) & (inverse < 1e299), 1.0 / np.maximum(inverse, 1e-9), 0.0)
    lower.first[..., :points] = np.einsum("oas,osp->oap", lower.informed, weights)
    search.roots.low[:] = low
    search.seconds, search.looks, search.slack = float(numbers[0]), int(numbers[1]), numbers[2]
    search.look_at_starts()
