"""Studies: jobs with a folder each, done by processes here or on a Ray cluster, each of them once.

A sweep, an ablation, a comparison of libraries and a replication are descriptions that make
studies. `train.experiments.executors` does the jobs of one: those that are complete are skipped,
those that were interrupted go on. What they leave in their folders is reported.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pursuit
from train.experiments.forms import HINTS, LABEL, read_hints
from train.experiments.identity import (
    INPUTS,
    Input,
    copy_of,
    digest_of_plain,
    fingerprint,
    with_policies,
)
from train.experiments.kinds import is_complete, read_settings, write_config
from train.files import LOCK, write_json
from train.runs.folder import CHECKPOINT, CONFIG
from train.runs.forms import Final
from train.settings.checks import check

ERROR, PROGRESS = "error.txt", "progress.txt"
FORMAT = 2
"""Of the folder of a study: raised whenever its jobs get other names."""
CALL, OUTCOME = "call.json", "outcome.json"
"""Of a job that is a function: its name and arguments, and what it returned."""

Watch = Callable[[dict[str, str], dict[str, float]], None]
"""Called now and then with the status of every job by name, and the progress of those running."""


@dataclass(frozen=True)
class TrainingRun:
    """A run of a learner.

    Attributes:
        name: of its folder: readable, and at its end a fingerprint of all that decides the outcome.
        kind: of run, one of `KINDS`.
        settings: all of them; mazes that were files are texts.
        episodes: of the final evaluation.
        label: what the sweep file says of this run: the names that vary, and `variant`.
        given: what reports call mazes and opponents that were files: as the sweep file does.
        inputs: the policies that it reads, by the setting's name.
    """

    name: str
    kind: str
    settings: Any
    episodes: int
    label: dict[str, Any]
    given: dict[str, Any] = field(default_factory=dict)
    inputs: dict[str, Input] = field(default_factory=dict)

    @property
    def seed(self) -> int:
        """That of the settings."""
        return int(self.settings.seed)

    @property
    def seconds(self) -> float | None:
        """How long it takes, where that is known before."""
        seconds: float | None = self.settings.seconds
        return seconds

    def write(self, folder: Path, study: Path) -> None:
        """Write `config.json` and `run.json`; the policies that it reads are copied.

        Args:
            folder: of the job.
            study: the folder of the study.

        Raises:
            ValueError: the folder holds another job.
        """
        before = None
        if (folder / CONFIG).exists():
            kind, before = read_settings(folder)
            check(
                self.name.endswith(fingerprint(kind, before, self.episodes, self.inputs)),
                f"{folder}: holds a run of other settings than its name says; remove that folder",
            )
        folder.mkdir(parents=True, exist_ok=True)
        copies = {name: str(copy_of(given, study)) for name, given in self.inputs.items()}
        settings = with_policies(self.settings, copies)
        if before != settings:  # new, or the folder of the study was moved
            write_config(self.kind, settings, folder, Final(self.episodes))
        write_json(folder / LABEL, {**self.given, **self.label})


@dataclass(frozen=True)
class Call:
    """A function of plain values; what it returns, plain values too, is kept in `outcome.json`.

    Attributes:
        function: "module:name".
        given: its arguments.
        label: what tells it from the other jobs of the study.
        seed: its seed.
        seconds: how long it takes, where that is known before.
    """

    function: str
    given: dict[str, Any]
    label: dict[str, Any]
    seed: int
    seconds: float | None = None

    @property
    def name(self) -> str:
        """As of a `TrainingRun`; another version of Pursuit does it anew."""
        print_ = digest_of_plain([pursuit.__version__, self.function, self.given])
        return job_name(self.label, self.seed, print_)

    def write(self, folder: Path, study: Path) -> None:
        """Write `call.json`."""
        folder.mkdir(parents=True, exist_ok=True)
        write_json(folder / CALL, {"function": self.function, "given": self.given})


@dataclass(frozen=True)
class Study:
    """Jobs, and what a report is to make of them.

    Attributes:
        title: of the report.
        runs: the jobs, each a `TrainingRun` or a `Call`, in the order in which they are done.
        report: hints for the report: "x", "group"; of an ablation "control" and more.
        pinned: whether every process stays on a core of its own, for jobs whose speed is compared.
    """

    title: str
    runs: tuple[Any, ...]
    report: dict[str, Any] = field(default_factory=dict)
    pinned: bool = False


def job_name(label: Mapping[str, Any], seed: int, print_: str, without: str = "job") -> str:
    """A readable folder name that no other job has; `without` stands for an empty label."""
    parts = [str(value) for value in label.values()] or [without]
    text = "-".join([*parts, f"seed{seed}"])
    return re.sub(r"[^A-Za-z0-9_.+-]+", "_", text)[:80] + "-" + print_


def folder_of(study_folder: Path, name: str) -> Path:
    """The folder of a job."""
    return study_folder / "runs" / name


def prepare(study: Study, out: Path | str) -> list[tuple[Any, Path]]:
    """Make the folders of all jobs with what they need; those there already are checked.

    Returns:
        Every job with its folder.

    Raises:
        ValueError: `out` is something else, or holds a run of other settings or another version.
    """
    out = Path(out)
    check(not out.is_file(), f"{out}: a file; give a folder")
    there = {path.name for path in out.iterdir()} if out.is_dir() else set[str]()
    if there - {LOCK, INPUTS} and "runs" not in there:
        raise ValueError(f"{out}: not empty, and no sweep; give a new folder")
    check_format(out)
    out.mkdir(parents=True, exist_ok=True)
    names = [run.name for run in study.runs]
    hints = {"format": FORMAT, "title": study.title, **study.report, "runs": names}
    write_json(out / HINTS, hints)
    folders = [(run, folder_of(out, run.name)) for run in study.runs]
    for run, folder in folders:
        run.write(folder, out)
    return folders


def check_format(out: Path) -> None:
    """ValueError where the study in a folder was begun by another version; a damaged plan is not:
    it is written anew."""
    try:
        found = read_hints(out).format if (out / HINTS).exists() else FORMAT
    except ValueError:
        return
    check(
        found == FORMAT,
        f"{out}: begun by another version of pursuit (format {FORMAT} needed); use that version, "
        "or a new folder",
    )


def is_folder_of(study: Study, out: Path) -> bool:
    """Whether `out` was begun for this study, or for one of the same title."""
    if not (out / HINTS).exists():  # begun, and interrupted before any job
        return {path.name for path in out.iterdir()} <= {LOCK, INPUTS}
    hints = read_hints(out)
    return (hints.title, hints.control) == (study.title, study.report.get("control"))


def status_of(folder: Path) -> str:
    """complete, failed, interrupted or new."""
    if (folder / OUTCOME).exists() or is_complete(folder):
        return "complete"
    if (folder / ERROR).exists():
        return "failed"
    return "interrupted" if (folder / CHECKPOINT).exists() else "new"


def statuses_of(study: Study, out: Path) -> dict[str, str]:
    """The status of every job by name."""
    return {run.name: status_of(folder_of(out, run.name)) for run in study.runs}


def to_do(folders: Mapping[str, Path]) -> list[str]:
    """The jobs that are not complete, by name."""
    return [name for name, folder in folders.items() if status_of(folder) != "complete"]
