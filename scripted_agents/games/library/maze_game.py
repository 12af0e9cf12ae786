"""Tasks in mazes as zero-sum small games of two sides."""

from __future__ import annotations

from typing import Any

from pursuit.tasks.task import make_task
from pursuit.validation import check
from scripted_agents.games.small_game import SmallGame
from scripted_agents.games.tasks import game_of_sides


def maze_game(task: str = "chase", **settings: Any) -> SmallGame:
    """A task as a small game of two sides, with equal transitions; see `game_of_sides`.

    Args:
        task: its name: chase, escape, heist or race.
        settings: of `pursuit.make_task`, such as maze, num_chasers, capture, slip, rewards. The
            rewards are zero_sum by default in chases, win_loss in escapes. There is no max_steps.

    Raises:
        ValueError: a setting that the task does not have, or no two sides.
    """
    for limit in ("max_steps", "max_cycles"):
        check(
            limit not in settings,
            f"{limit}={settings.get(limit)!r}: a small game has no limit on steps; give it to what "
            "solves or plays the game, as --horizon or --max-steps",
        )
    rewards = {"chase": "zero_sum", "escape": "win_loss"}
    if task in rewards:
        settings = {"rewards": rewards[task], **settings}
    return game_of_sides(make_task(task, **settings))
