"""Families: kinds of games, each a record of its parts (`family.Family`).

Code above this package asks the family of a task's settings for a part, and never which family it
is.
"""

from __future__ import annotations

from train.families import arm, maze, small_game
from train.families.family import Family
from train.settings.task_form import FAMILIES, TaskForm

__all__ = ["Family", "family_of", "register"]

OURS = {each.settings: each for each in (maze.FAMILY, small_game.FAMILY, arm.FAMILY)}


def family_of(settings: TaskForm) -> Family:
    """The family of the settings of a task; ValueError for an unknown one."""
    for form in type(settings).__mro__:
        if form in OURS:
            return OURS[form]
    found: Family = FAMILIES.get(settings.task)
    return found


register = FAMILIES.register
"""(task, family) registers a user-defined family under the name of its task, and returns it;
ValueError for a name in use. Without it, `module:NAME` of a family names its task."""
