"""The provenance of a run: user-defined parts with hashes of their source, and the command."""

from __future__ import annotations

import shlex
import sys
import warnings
from collections.abc import Collection, Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypedDict

from pursuit.observations.custom import OBSERVATIONS
from pursuit.plugins import (
    OPENSPIEL,
    Registry,
    check_allowed,
    is_reference,
    module_of,
    reading,
    sha256_of,
)
from pursuit.tasks.rewards import REWARDS
from scripted_agents.games.named import GAMES, split_name
from scripted_agents.names import POLICIES
from train.files import Plain, read_json
from train.schemas import read_as
from train.settings.algorithms import LEARNERS
from train.settings.axes import AXIS_PARTS
from train.settings.common import NETWORKS
from train.settings.curricula import CURRICULUM_PARTS
from train.settings.self_play import OPPOSING_ROLES, SAMPLING_PARTS, WholeSettings
from train.settings.task_form import FAMILIES

PARTS, COMMAND = "parts", "command"
"""Keys of `config.json` other than settings."""

REGISTRIES: dict[str, Registry[Any]] = {
    "task": FAMILIES,
    "game": GAMES,
    "rewards": REWARDS,
    "observation": OBSERVATIONS,
    **dict.fromkeys(("opponent", "chaser", "evader", "members", "imitate"), POLICIES),
    "axis": AXIS_PARTS,
    "curriculum": CURRICULUM_PARTS,
    **dict.fromkeys(("algorithm", "contestant"), LEARNERS),
    "sampling": SAMPLING_PARTS,
    "network": NETWORKS,
}
"""The settings that can name user-defined parts, with their registries."""


class Record(TypedDict):
    """A user-defined part: its name, and the hash of its source."""

    name: str
    sha256: str | None


Records = dict[str, Record]


def own_parts(
    settings: WholeSettings | Mapping[str, object], sides: Collection[str] = OPPOSING_ROLES
) -> Iterator[tuple[str, str, str]]:
    """(setting, name, module) of every user-defined part in settings, or in their plain values.

    The settings of one of the `sides` are called "chaser.algorithm", say.
    """
    plain = settings if isinstance(settings, Mapping) else asdict(settings)
    for setting, value in plain.items():
        if isinstance(value, Mapping):
            prefix = f"{setting}." if setting in sides else ""
            within = own_parts(value, tuple(value) if setting == "players" else OPPOSING_ROLES)
            yield from ((prefix + name, part, module) for name, part, module in within)
        elif setting in REGISTRIES or setting in sides:
            names = value if isinstance(value, list | tuple) else [value]
            for number, name in enumerate(names):
                module = origin_of(setting, name) if isinstance(name, str) else None
                if module is not None:
                    yield f"{setting}[{number}]" if names is value else setting, name, module


def origin_of(setting: str, name: str) -> str | None:
    """The module of the part that a setting names; None for built-in parts."""
    if setting == "game":
        name = "" if name.startswith(OPENSPIEL) else split_name(name)[0]
    return REGISTRIES.get(setting, POLICIES).origin(name) if name else None


def check_parts(config: Path, plain: Plain) -> None:
    """ValueError if the settings in a file name parts of modules that are not allowed, also parts
    that are used later."""
    with reading(config):
        for _, name, _ in own_parts(plain):
            check_allowed(name)


def provenance(settings: WholeSettings | Plain) -> Records:
    """{"rewards": {"name": "my_parts:shaped", "sha256": ...}, ...}: every user-defined part.

    The hash is that of the module's source file, or of all files of its package
    (`pursuit.plugins.sha256_of`); None if there is no source. Nothing is imported for it.
    """
    return {
        setting: {"name": name, "sha256": sha256_of(module)}
        for setting, name, module in own_parts(settings)
    }


def command_line() -> str:
    """The command line of this process, quoted for a shell; "Python" if there is none."""
    if not sys.argv or sys.argv[0] in ("", "-c"):
        return "Python"
    return shlex.join(sys.argv)


def recorded_parts(config: Path) -> Records:
    """The user-defined parts recorded in `config.json`; none if there is no such file.

    Raises:
        ValueError: it is damaged.
    """
    content = read_json(config) if config.exists() else {}
    found = content.get(PARTS, {}) if isinstance(content, dict) else {}
    return read_as(Records, found, f"{config}, {PARTS}", "restore it from a copy")


def check_sources(config: Path, settings: WholeSettings | Plain, resuming: bool = False) -> None:
    """Compare the sources of user-defined parts with those at the start of the run.

    Warns if they have changed.

    Raises:
        ValueError: they have changed, and the run is being resumed.
    """
    recorded = recorded_parts(config)
    for setting, now in provenance(settings).items():
        before, name = recorded.get(setting), now["name"]
        if before is None or before["name"] != name or before["sha256"] == now["sha256"]:
            continue
        module = module_of(name) if is_reference(name) else name
        changed = f"{config.parent}: the source of {module} has changed since this run started"
        if resuming:
            raise ValueError(f"{changed}; restore it, or start a new run")
        if now["sha256"] is not None:  # else there is no source to compare
            warnings.warn(f"{changed}; the trained policy may not match it", stacklevel=2)


def allow_options(config: Path) -> str:
    """The options that resuming a run needs: " --allow my_parts", or an empty string."""
    names = [record["name"] for record in recorded_parts(config).values()]
    tops = dict.fromkeys(module_of(name).split(".")[0] for name in filter(is_reference, names))
    return "".join(f" --allow {top}" for top in tops)
