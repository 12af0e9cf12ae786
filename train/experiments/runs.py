"""The runs of a study, each in a folder of its own, and their status.

`train.experiments.executors` executes them: complete ones are skipped, interrupted ones are
resumed. Reports read the folders.
"""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec

from pursuit.validation import check
from train.experiments import library_runs  # noqa: F401 (adds its kind of run)
from train.experiments.identity import INPUTS, Input, copied_input, fingerprint, with_policies
from train.experiments.recorded import MEASURED, Cells, complete_in
from train.experiments.shards import Shard
from train.experiments.study import Layout, Table
from train.files import LOCK, PART, read_json, write_json
from train.kinds import read_settings, write_config
from train.runs.folder import CHECKPOINT, CONFIG, is_complete
from train.runs.forms import Final
from train.schemas import read_as

LAYOUT, LABEL = "sweep.json", "run.json"
ERROR, PROGRESS = "error.txt", "progress.txt"
TUNING = "tuning"
"""Subfolder with the search for settings."""
FORMAT = 2
"""Version of the folder layout; increased when the names of runs change."""
ANEW = "remove that file; the next `pursuit sweep` writes it again"

Watch = Callable[[dict[str, str], dict[str, float]], None]
"""Called repeatedly with the status of every run by name, and the progress of running ones."""
Label = dict[str, bool | int | float | str | list[str] | None]
"""`run.json`: the values of the study file for one run."""


@dataclass(frozen=True)
class TrainingRun:
    """A run of a learner.

    Attributes:
        name: of its folder: readable, with a fingerprint of everything that affects the result.
        kind: of run, one of `KINDS`.
        settings: all settings; maze files are replaced by their text.
        episodes: of the final evaluation.
        label: the varying settings of this run, and `variant`.
        files: names in reports of mazes and opponents that are files.
        inputs: the policies that it loads, by name of the setting.
    """

    name: str
    kind: str
    settings: Any
    episodes: int
    label: Table
    files: Table = field(default_factory=dict)
    inputs: dict[str, Input] = field(default_factory=dict)

    @property
    def seed(self) -> int:
        """The seed of the settings."""
        return int(self.settings.seed)

    @property
    def cost(self) -> float:
        """Its budget in seconds, or in 100,000 frames, which take about as long."""
        seconds, frames = self.settings.seconds, self.settings.frames
        return float(frames / 1e5 if seconds is None else seconds)

    @property
    def cells(self) -> Table:
        """What the row of the run says of its game, budget and seed; its name has a fingerprint of
        all settings."""
        budget = {column: getattr(self.settings, name) for name, column in MEASURED.items()}
        game = self.settings.task.game
        own = {} if game is None else {"game": game}
        named = {"variant": self.label["variant"]} if "variant" in self.label else {}
        return {**own, **budget, **named, "kind": self.kind, "seed": self.seed}

    def write(self, folder: Path, study: Path) -> None:
        """Write `config.json` and `run.json`, and copy the policies that it loads.

        Args:
            folder: of the run.
            study: the folder of the study.

        Raises:
            ValueError: the folder holds another run.
        """
        before = None
        if (folder / CONFIG).exists():
            kind, before = read_settings(folder)
            check(
                self.name.endswith(fingerprint(kind, before, self.episodes, self.inputs)),
                f"{folder}: contains a run with other settings than its name; remove that folder",
            )
        folder.mkdir(parents=True, exist_ok=True)
        copies = {name: str(copied_input(policy, study)) for name, policy in self.inputs.items()}
        settings = with_policies(self.settings, copies)
        if before != settings:  # new, or the folder of the study was moved
            write_config(self.kind, settings, folder, Final(self.episodes))
        write_json(folder / LABEL, {**self.files, **self.label})


@dataclass(frozen=True)
class Study:
    """Runs, and the layout of their report.

    Attributes:
        layout: of the report.
        runs: in order of execution.
        pinned: whether every process is pinned to one core, for runs whose speed is compared.
        rows: the file with the rows of finished runs; None for none. See `recorded`.
        shard: the part of the runs that this process executes; None for all. It needs `rows`.
    """

    layout: Layout
    runs: tuple[TrainingRun, ...]
    pinned: bool = False
    rows: Path | None = None
    shard: Shard | None = None

    @property
    def own(self) -> tuple[TrainingRun, ...]:
        """The runs that this process executes."""
        if self.shard is None:
            return self.runs
        chosen = self.shard.chosen({run.name: run.cost for run in self.runs})
        return tuple(run for run in self.runs if run.name in chosen)

    @property
    def planned(self) -> Cells:
        """By run, what its row says of its settings."""
        return {run.name: run.cells for run in self.runs}


def job_name(label: Table, seed: int, print_: str, without: str) -> str:
    """A readable and unique folder name; `without` replaces an empty label."""
    parts = [str(value) for value in label.values()] or [without]
    text = "-".join([*parts, f"seed{seed}"])
    return re.sub(r"[^A-Za-z0-9_.+-]+", "_", text)[:80] + "-" + print_


def folder_of(study_folder: Path, name: str) -> Path:
    """The folder of a run."""
    return study_folder / "runs" / name


def prepare(study: Study, out: Path | str) -> list[tuple[TrainingRun, Path]]:
    """Create the folders of the study's own runs with their files, and check existing ones.

    Returns:
        Every such run with its folder, but those that are complete by the rows of the study.

    Raises:
        ValueError: `out` is not a study, or has runs of other settings or of another version.
    """
    out = Path(out)
    check(not out.is_file(), f"{out}: a file; give a folder")
    there = others_in(out) if out.is_dir() else set[str]()
    if there and not there & {"runs", LAYOUT}:
        raise ValueError(f"{out}: not empty, and not a sweep; give a new folder")
    found = FORMAT
    with contextlib.suppress(ValueError):  # a damaged `sweep.json` is written again
        found = read_layout(out).format if (out / LAYOUT).exists() else FORMAT
    check(
        found == FORMAT,
        f"{out}: has format {found}, this version of pursuit needs {FORMAT}; use the version that "
        "made it, or a new folder",
    )
    out.mkdir(parents=True, exist_ok=True)
    names = [run.name for run in study.runs]
    planned = study.planned
    done = complete_in(study.rows, planned)
    layout = msgspec.structs.replace(study.layout, format=FORMAT, runs=names)
    if study.rows is not None:
        layout.rows, layout.planned = os.path.relpath(study.rows.resolve(), out.resolve()), planned
    write_json(out / LAYOUT, msgspec.to_builtins(layout))
    folders = [(run, folder_of(out, run.name)) for run in study.own if run.name not in done]
    for run, folder in folders:
        run.write(folder, out)
    return folders


def is_folder_of(study: Study, out: Path) -> bool:
    """Whether `out` is the folder of this study, or of one with the same title."""
    if not (out / LAYOUT).exists():  # interrupted before the first run, or removed by its user
        own = any(folder_of(out, run.name).is_dir() for run in study.runs)
        return own or not others_in(out)
    layout = read_layout(out)
    return (layout.title, layout.control) == (study.layout.title, study.layout.control)


def others_in(out: Path) -> set[str]:
    """The names in a folder, but those of what a study writes before `sweep.json`, and of files
    that another shard is writing."""
    known = (LOCK, INPUTS, TUNING)
    return {p.name for p in out.iterdir() if p.name not in known and not PART.match(p.name)}


def read_layout(out: Path) -> Layout:
    """`sweep.json` of a folder, or a default if there is none."""
    path = out / LAYOUT
    if not path.exists():
        return Layout(title=out.name)
    return read_as(Layout, read_json(path), path, ANEW)


def read_label(folder: Path) -> Label:
    """`run.json` of a run; empty if there is none."""
    path = folder / LABEL
    return read_as(Label, read_json(path), path, ANEW) if path.exists() else {}


def status_of(folder: Path) -> str:
    """The status of a run: complete, failed, interrupted or new."""
    if is_complete(folder):
        return "complete"
    if (folder / ERROR).exists():
        return "failed"
    return "interrupted" if (folder / CHECKPOINT).exists() else "new"


def statuses_of(study: Study, out: Path) -> dict[str, str]:
    """The status of every run that this process executes, by name."""
    done = complete_in(study.rows, study.planned)
    return {
        run.name: "complete" if run.name in done else status_of(folder_of(out, run.name))
        for run in study.own
    }
