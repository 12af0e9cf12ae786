"""The settings of saved runs, read back from their folders."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any, get_type_hints

import msgspec

from train.algorithms.registry import entry
from train.runs.folder import CONFIG, RUN, SIDE, load_config
from train.runs.forms import RESTORE
from train.runs.provenance import check_sources
from train.runs.tasks import player_of
from train.schemas import read_as
from train.settings.checks import check
from train.settings.curricula import curriculum_form
from train.settings.run import TrainSettings
from train.settings.task import task_form

ADDED = {"clock": "wall", "processes": 1}
"""Settings that came after folders had been written without them, and what they were there."""

REMOVED = {"graphs"}
"""Settings that older folders have, and that are ignored."""

ADDED_HYPER = {"gamma_end": None}
"""Those of algorithms."""


def read_own(form: type[Any], plain: Mapping[str, Any], where: str, inner: set[str]) -> Any:
    """The fields of the dataclass `form` but for those in `inner`, as attributes, checked.

    Raises:
        ValueError: a field missing, unknown or of another type.
    """
    hints = get_type_hints(form)
    own = [(field.name, hints[field.name]) for field in fields(form) if field.name not in inner]
    shape = msgspec.defstruct(form.__name__, own, forbid_unknown_fields=True, kw_only=True)
    there = {name: value for name, value in ADDED.items() if name in hints}
    content = there | {k: v for k, v in plain.items() if k not in inner | REMOVED}
    return read_as(shape, content, where, RESTORE)


def read_part(form: type[Any], plain: Mapping[str, Any], name: str, where: str) -> Any:
    """The dataclass `form` from the part `name` of plain values; ValueError where it is none."""
    check(name in plain, f"{where}: field {name!r} is missing; {RESTORE}")
    part = plain[name]
    if name == "hyper" and isinstance(part, dict):
        part = {f.name: ADDED_HYPER[f.name] for f in fields(form) if f.name in ADDED_HYPER} | part
    missing = [f.name for f in fields(form) if isinstance(part, dict) and f.name not in part]
    check(not missing, f"{where}: field {name}.{'.'.join(missing[:1])} is missing; {RESTORE}")
    return read_as(form, part, f"{where}: {name}", RESTORE)


def from_plain(plain: Mapping[str, Any], where: str) -> TrainSettings[Any]:
    """Settings from the plain values of `config.json`, which is at `where`.

    Raises:
        ValueError: missing or unknown settings, or values that are not allowed.
    """
    own = read_own(TrainSettings, plain, where, {"task", "hyper", "lessons"})
    try:
        forms: tuple[type[Any], ...] = (
            task_form(plain.get("task", {}).get("task")),
            entry(own.algorithm).settings,
            curriculum_form(own.curriculum),
        )
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from None
    parts = {
        name: read_part(form, plain, name, where)
        for name, form in zip(("task", "hyper", "lessons"), forms, strict=True)
    }
    try:
        settings = TrainSettings(**parts, **msgspec.structs.asdict(own))
        player_of(settings)
    except ValueError as error:
        raise ValueError(f"{where}: {error}; {RESTORE}") from None
    return settings


def load_settings(folder: Path | str) -> TrainSettings[Any]:
    """The settings of the run of one agent, or of the side of self-play, in a folder.

    Raises:
        ValueError: no such run there, or a damaged one.
    """
    folder = Path(folder)
    kind, plain = load_config(folder)
    check(
        kind in (RUN, SIDE),
        f"{folder}: a run of kind {kind!r}, with a policy for each side; give {folder / 'chaser'} "
        f"or {folder / 'evader'}",
    )
    check_sources(folder / CONFIG, plain)
    return from_plain(plain, str(folder / CONFIG))
