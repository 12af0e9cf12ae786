"""Keys for `gymnasium.utils.play`: which ones mean which action of a game in a maze."""

from __future__ import annotations

from pursuit.tasks.task import Task

Keys = tuple[int, ...]
"""Codes of keys that are pressed together."""

UP, DOWN, RIGHT, LEFT = 1073741906, 1073741905, 1073741903, 1073741904
"""The arrow keys as SDL, and so pygame, numbers them."""


def maze_keys(task: Task) -> dict[Keys, int]:
    """Arrow keys and w, a, s, d; space stays where the task has that action."""
    moves: dict[Keys, int] = {(key,): move for move, key in enumerate((UP, DOWN, RIGHT, LEFT))}
    moves |= {(ord(key),): move for move, key in enumerate("wsda")}
    return {**moves, (ord(" "),): 4} if task.stay_action else moves
