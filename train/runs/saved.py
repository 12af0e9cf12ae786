"""The settings of saved runs, read back from their folders."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from train.algorithms.registry import entry
from train.runs.folder import CONFIG, RUN, SIDE, load_config
from train.runs.provenance import check_sources
from train.settings.checks import check
from train.settings.curricula import curriculum_form
from train.settings.run import TrainSettings
from train.settings.task import TaskSettings

Form = TypeVar("Form")


def read_plain(make: Callable[[], Form]) -> Form:
    """What `make` makes of plain values; ValueError where names are missing or unknown."""
    try:
        return make()
    except (TypeError, KeyError) as error:
        raise ValueError(f"these are not the settings of a run: {error}") from None


def from_plain(plain: Mapping[str, Any]) -> TrainSettings[Any]:
    """Settings from the plain values of `config.json`.

    Raises:
        ValueError: missing or unknown settings, or values that are not allowed.
    """
    return read_plain(
        lambda: TrainSettings(
            **{
                **plain,
                "task": TaskSettings(**plain["task"]),
                "hyper": entry(plain["algorithm"]).settings(**plain["hyper"]),
                "lessons": curriculum_form(plain["curriculum"])(**plain["lessons"]),
            }
        )
    )


def load_settings(folder: Path) -> TrainSettings[Any]:
    """The settings of the run of one agent, or of the side of self-play, in a folder.

    Raises:
        ValueError: no such run there, or a damaged one.
    """
    kind, plain = load_config(folder)
    check(
        kind in (RUN, SIDE),
        f"{folder}: a run of kind {kind!r}, with a policy for each side; give {folder / 'chaser'} "
        f"or {folder / 'evader'}",
    )
    check_sources(folder / CONFIG, plain)
    return from_plain(plain)
