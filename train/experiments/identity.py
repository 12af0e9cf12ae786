"""Fingerprints of runs: digests of everything that affects their results.

Mazes are compared by their text and opponents by the content of their files, not by path. So a
sweep can be resumed after its files were moved, and a changed file makes a different run. Mazes are
stored as text in `config.json`, and opponents are copied to the folder of the sweep.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from pursuit.validation import check
from scripted_agents.names import AGENTS
from train.files import Plain, write_bytes
from train.kinds import with_mazes
from train.runs.folder import CHECKPOINT, CONFIG
from train.runs.provenance import provenance
from train.runs.stable_baselines import description_of
from train.settings.common import RunSettings
from train.settings.mazes import named_maze, names_in
from train.settings.self_play import OPPOSING_ROLES

WHOLE = ("init_from", "imitate")
"""The settings of runs, beside those of their tasks, that can name the folder of a policy."""
INPUTS = "inputs"
"""Subfolder of a sweep with copies of opponents."""
MODEL = "model"
"""Name of the copy of a model, without its suffix."""


@dataclass(frozen=True)
class Input:
    """A policy that a run loads from files.

    Attributes:
        path: the folder of a run, or a saved model.
        digest: ten hexadecimal digits of its content.
    """

    path: Path
    digest: str


def named_policies(plain: Plain) -> dict[str, str]:
    """The policies in plain settings that are not scripted agents, by the setting's name."""
    named = {name: plain.get(name) for name in OPPOSING_ROLES} | (plain.get("players") or {})
    named["opponent"] = plain["task"].get("opponent")
    named |= {name: plain.get(name) for name in WHOLE}
    return {
        name: value
        for name, value in named.items()
        if isinstance(value, str) and value not in AGENTS
    }


def with_policies(settings: Any, values: Mapping[str, str]) -> Any:
    """Settings with these policies, by the setting's name."""
    own: Plain = dict(values)
    task = {name: own.pop(name) for name in ("opponent",) if name in own}
    whole = {name: own.pop(name) for name in WHOLE if name in own}
    if hasattr(settings, "players"):
        own = {"players": {**settings.players, **own}}
    return replace(settings, **own, **whole, task=replace(settings.task, **task))


def policy_files(path: Path) -> dict[str, bytes]:
    """The files of the policy at `path`: contents by their file names in `INPUTS`."""
    if path.is_dir():
        saved = f"{CHECKPOINT.split('.')[0]}*"
        sides = [*path.glob(f"*/{CONFIG}"), *path.glob(f"*/{saved}")]  # of self-play
        whole = [*sorted(sides), path / CONFIG, *sorted(path.glob(saved))]
        return {
            file.relative_to(path).as_posix(): file.read_bytes() for file in whole if file.is_file()
        }
    described = description_of(path)
    own = {MODEL + path.suffix: path.read_bytes()}
    if described.is_file():
        own[description_of(MODEL).name] = described.read_bytes()
    return own


def digest_of(files: Mapping[str, bytes]) -> str:
    """Ten hexadecimal digits of the files that determine the actions of a policy."""
    deciding = {CONFIG, CHECKPOINT, *(MODEL + own for own in (".json", ".onnx", ".zip"))}
    digest = hashlib.sha256()
    for name in sorted(deciding & set(files)):
        digest.update(f"{name} {len(files[name])}\n".encode() + files[name])
    return digest.hexdigest()[:10]


def inputs_of(settings: Any) -> dict[str, Input]:
    """The policies in settings that are existing files, by the setting's name."""
    named = {name: Path(value) for name, value in named_policies(asdict(settings)).items()}
    return {
        name: Input(path, digest_of(policy_files(path)))
        for name, path in named.items()
        if path.exists()
    }


def fingerprint(kind: str, settings: Any, episodes: int, inputs: Mapping[str, Input]) -> str:
    """Ten hexadecimal digits of everything that affects the results of a run.

    Args:
        kind: of run.
        settings: of the run.
        episodes: of its final evaluation.
        inputs: the policies that it loads from files, by the setting's name.
    """
    named = named_policies(asdict(settings))
    digests = {name: policy.digest for name, policy in inputs.items() if name in named}
    plain = {**settings.REMOVED, **asdict(with_policies(settings, digests))}
    for name in RunSettings.ADDED:  # without effect unless they are given: names stay
        if name == "log" or plain.get(name) == getattr(RunSettings, name):
            plain.pop(name, None)
    if (maze := settings.task.maze_text) is not None:
        plain["task"]["maze"] = maze
    mazes = plain.get("curriculum_settings", {}).get("curriculum_mazes")
    if mazes is not None:
        plain["curriculum_settings"]["curriculum_mazes"] = [
            named_maze(n).to_text() for n in names_in(mazes)
        ]
    plain["parts"] = provenance(settings)  # users' modules count by their source
    whole = json.dumps({"kind": kind, "episodes": episodes, **plain}, sort_keys=True)
    return hashlib.sha256(whole.encode()).hexdigest()[:10]


def frozen_mazes(settings: Any) -> tuple[Any, Plain]:
    """Settings with mazes as text; and the names as given of mazes and policies, for reports."""
    frozen = with_mazes(settings)
    names: Plain = {**named_policies(asdict(settings))}
    if settings.task != frozen.task:
        names["maze"] = settings.task.maze
    before, after = (each.curriculum_settings.curriculum_mazes for each in (settings, frozen))
    if before != after:
        names["curriculum_mazes"] = before
    return frozen, names


# -- copies ----------------------------------------------------------------------------------------


def copied_input(policy: Input, folder: Path) -> Path:
    """The path of the copy of an input in the folder of a sweep; copied if missing or incomplete.

    Runs load the copy, so that an opponent that is still training is the same for all runs.

    Raises:
        ValueError: the input has changed since the sweep file was read.
    """
    own = folder.resolve() / INPUTS / policy.digest
    path = own if policy.path.is_dir() else own / (MODEL + policy.path.suffix)
    if not path.exists() or digest_of(policy_files(path)) != policy.digest:
        files = policy_files(policy.path)
        check(
            digest_of(files) == policy.digest,
            f"{policy.path}: has just changed; run the command again when nothing writes to it",
        )
        for name, content in files.items():
            (own / name).parent.mkdir(parents=True, exist_ok=True)
            write_bytes(own / name, content)
    return path
