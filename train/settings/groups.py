"""The groups of settings in help texts and in the reference, and other names of settings."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from train.settings.common import RunSettings
from train.settings.task_form import TaskForm

GROUPS: dict[str, dict[str, str]] = tomllib.loads(
    Path(__file__).with_name("help.toml").read_text("utf-8")
)
"""By title the settings of a group, with their texts in the short help; "" where it has none."""
OTHER_NAMES = GROUPS.pop("other_names")
"""What other libraries call settings: their names here."""


def group_of(form: type[Any], name: str) -> str:
    """The group of an option; in the table are neither sides of self-play nor a user's games."""
    other = "Game" if issubclass(form, TaskForm) else "Options"
    other = "Opponent" if issubclass(form, RunSettings) else other
    group = next((title for title, names in GROUPS.items() if name in names), other)
    return str(getattr(form, "GROUP", group))
