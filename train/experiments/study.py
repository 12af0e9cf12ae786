"""Studies: sets of jobs with a folder each, executed locally or on a Ray cluster.

Sweeps, ablations, comparisons of libraries and replications are expanded to studies.
`train.experiments.executors` executes their jobs: complete ones are skipped, interrupted ones are
resumed. Reports read the folders.
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
from train.files import LOCK, write_json
from train.kinds import read_settings, write_config
from train.runs.folder import CHECKPOINT, CONFIG, is_complete
from train.runs.forms import Final
from train.settings.checks import check

ERROR, PROGRESS = "error.txt", "progress.txt"
FORMAT = 2
"""Version of the folder layout; increased when the names of jobs change."""
CALL, OUTCOME = "call.json", "outcome.json"
"""Files of a `Call`: its function and arguments, and its return value."""

Watch = Callable[[dict[str, str], dict[str, float]], None]
"""Called repeatedly with the status of every job by name, and the progress of running jobs."""


@dataclass(frozen=True)
class TrainingRun:
    """A run of a learner.

    Attributes:
        name: of its folder: readable, with a fingerprint of everything that affects the result.
        kind: of run, one of `KINDS`.
        settings: all settings; maze files are replaced by their text.
        episodes: of the final evaluation.
        label: the varying settings of this run, and `variant`.
        given: names in reports of mazes and opponents given as files.
        inputs: the policies that it loads, by name of the setting.
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
        """The seed of the settings."""
        return int(self.settings.seed)

    @property
    def seconds(self) -> float | None:
        """The budget in seconds; None for a budget in frames."""
        seconds: float | None = self.settings.seconds
        return seconds

    def write(self, folder: Path, study: Path) -> None:
        """Write `config.json` and `run.json`, and copy the policies that it loads.

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
                f"{folder}: contains a run with other settings than its name; remove that folder",
            )
        folder.mkdir(parents=True, exist_ok=True)
        copies = {name: str(copy_of(given, study)) for name, given in self.inputs.items()}
        settings = with_policies(self.settings, copies)
        if before != settings:  # new, or the folder of the study was moved
            write_config(self.kind, settings, folder, Final(self.episodes))
        write_json(folder / LABEL, {**self.given, **self.label})


@dataclass(frozen=True)
class Call:
    """A job that calls a function of plain values; the result is written to `outcome.json`.

    Attributes:
        function: "module:name".
        given: its arguments.
        label: distinguishes it from the other jobs of the study.
        seed: its seed.
        seconds: its duration, if known.
    """

    function: str
    given: dict[str, Any]
    label: dict[str, Any]
    seed: int
    seconds: float | None = None

    @property
    def name(self) -> str:
        """As in `TrainingRun`; includes the version of Pursuit."""
        print_ = digest_of_plain([pursuit.__version__, self.function, self.given])
        return job_name(self.label, self.seed, print_)

    def write(self, folder: Path, study: Path) -> None:
        """Write `call.json`."""
        folder.mkdir(parents=True, exist_ok=True)
        write_json(folder / CALL, {"function": self.function, "given": self.given})


@dataclass(frozen=True)
class Study:
    """A set of jobs, and the layout of their report.

    Attributes:
        title: of the report.
        runs: the jobs, each a `TrainingRun` or a `Call`, in order of execution.
        report: layout of the report: "x", "group"; of an ablation "control" and more.
        pinned: whether every process is pinned to one core, for jobs whose speed is compared.
    """

    title: str
    runs: tuple[Any, ...]
    report: dict[str, Any] = field(default_factory=dict)
    pinned: bool = False


def job_name(label: Mapping[str, Any], seed: int, print_: str, without: str = "job") -> str:
    """A readable and unique folder name; `without` replaces an empty label."""
    parts = [str(value) for value in label.values()] or [without]
    text = "-".join([*parts, f"seed{seed}"])
    return re.sub(r"[^A-Za-z0-9_.+-]+", "_", text)[:80] + "-" + print_


def folder_of(study_folder: Path, name: str) -> Path:
    """The folder of a job."""
    return study_folder / "runs" / name


def prepare(study: Study, out: Path | str) -> list[tuple[Any, Path]]:
    """Create the folders of all jobs with their files, and check existing ones.

    Returns:
        Every job with its folder.

    Raises:
        ValueError: `out` is not a study, or has runs of other settings or of another version.
    """
    out = Path(out)
    check(not out.is_file(), f"{out}: a file; give a folder")
    there = {path.name for path in out.iterdir()} if out.is_dir() else set[str]()
    if there - {LOCK, INPUTS} and "runs" not in there:
        raise ValueError(f"{out}: not empty, and not a sweep; give a new folder")
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
    """ValueError if the study in a folder has another format.

    A damaged `sweep.json` is ignored, because it is written again.
    """
    try:
        found = read_hints(out).format if (out / HINTS).exists() else FORMAT
    except ValueError:
        return
    check(
        found == FORMAT,
        f"{out}: has format {found}, this version of pursuit needs {FORMAT}; use the version that "
        "made it, or a new folder",
    )


def is_folder_of(study: Study, out: Path) -> bool:
    """Whether `out` is the folder of this study, or of one with the same title."""
    if not (out / HINTS).exists():  # interrupted before the first job
        return {path.name for path in out.iterdir()} <= {LOCK, INPUTS}
    hints = read_hints(out)
    return (hints.title, hints.control) == (study.title, study.report.get("control"))


def status_of(folder: Path) -> str:
    """The status of a job: complete, failed, interrupted or new."""
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
