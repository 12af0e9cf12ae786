"""The results of a sweep as tidy tables: one row a run, and one row an evaluation."""

from __future__ import annotations

import io
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from pursuit.parts import references
from train.experiments.forms import read_hints, read_label
from train.experiments.kinds import read_settings
from train.experiments.sweep import ERROR, MEASURED, flat_plain, status_of
from train.files import read_json, write_beside
from train.runs.folder import CONFIG, METRICS, RESULTS, RUN, read_config, read_metrics
from train.runs.provenance import check_sources
from train.runs.tasks import maze_called
from train.schemas import read_as
from train.settings.checks import check
from train.settings.self_play import ROLES
from train.settings.task import who_learns

if TYPE_CHECKING:
    import polars

KINDS = {"random": "random_steps", "learned": "greedy_steps", "learned, sampled": "sampled_steps"}
RUNS, CURVES = "results.parquet", "curves.parquet"


class Steps(msgspec.Struct):
    """What somebody needs in the task."""

    name: str
    mean_steps: float | None


class Judged(msgspec.Struct):
    """What a run is judged by."""

    column: str
    unit: str


class Machine(msgspec.Struct):
    """What it ran on."""

    processor: str


class Outcome(msgspec.Struct):
    """What a table takes of `results.json`."""

    frames: int
    seconds: float
    frames_per_second: float
    evaluation: dict[str, bool | int | float | str | None]
    objective: Judged
    versions: dict[str, str | None]
    machine: Machine
    scores: list[Steps] = msgspec.field(default_factory=list)
    at_start: dict[str, float | None] = msgspec.field(default_factory=dict)


def collect(out: Path | str) -> tuple[polars.DataFrame, polars.DataFrame]:
    """Read every run of a sweep's folder, whatever its state, and write both Parquet files.

    Returns:
        Runs: "run", "status", "variant" where there is one, all settings, "frames", "seconds",
        "frames_per_second", the evaluation ("mean_steps", "ci95", "success_rate", "optimal_steps",
        "optimality_gap", "exact", "episodes"), "greedy_steps", "sampled_steps",
        the baselines ("random_steps", "scripted_steps"), versions, "commit", "machine" and "error".
        Curves: "run" and the columns of `metrics.csv`.

    Raises:
        ValueError: no sweep in this folder, or a run that another version wrote.
    """
    out = Path(out)
    import polars

    folders = sorted(path.parent for path in out.glob(f"runs/*/{CONFIG}"))
    named = read_hints(out).runs
    if named is not None:  # not those of a plan before this one
        folders = [folder for folder in folders if folder.name in named]
    check(bool(folders), f"{out}: no runs of a sweep here; `pursuit sweep FILE --out {out}` first")
    runs = polars.DataFrame([row_of(folder) for folder in folders], infer_schema_length=None)
    rows = [
        {"run": folder.name, **row}
        for folder in folders
        if (folder / METRICS).exists()
        for row in read_metrics(folder)
    ]
    curves = polars.DataFrame(rows, infer_schema_length=None)
    write_parquet(out / RUNS, runs)
    write_parquet(out / CURVES, curves)
    return runs, curves


def write_parquet(path: Path, frame: polars.DataFrame) -> None:
    """`frame` as a Parquet file, atomically; OSError naming `path` where it cannot be written."""
    data = io.BytesIO()  # given a path, polars raises an error of its own on a full disk
    frame.write_parquet(data)

    def write(beside: Path) -> None:
        beside.write_bytes(data.getvalue())

    write_beside(path, write)


def row_of(folder: Path) -> dict[str, Any]:
    """One run as a flat row."""
    kind, plain = read_config(folder)
    check_sources(folder / CONFIG, plain)
    if not any(references(plain)):  # else it is read as it stands: no user's part is imported
        kind, settings = read_settings(folder)
        plain = asdict(settings)
    task, label = plain["task"], read_label(folder)
    flat = flat_plain(plain)
    row: dict[str, Any] = {"run": folder.name, "kind": kind, "status": status_of(folder)}
    row |= {name: value for name, value in flat.items() if name not in row}
    row["variant"] = label.get("variant")
    if "maze" in task:
        row["maze"] = maze_called(task["maze"])
        row["role"] = who_learns(task["task"], task["role"]) if kind == RUN else "both"
    if "members" in row:
        row["members"] = " ".join(row["members"])
    # What a sweep names is kept as it says it, so that reports can group by `preset`, say; and
    # files by the names that they were given.
    files = ("maze", "curriculum_mazes", "opponent", *ROLES)
    measured = {MEASURED.get(name, name): value for name, value in label.items()}
    row |= {n: value for n, value in measured.items() if n not in row or n in files}
    if (folder / RESULTS).exists():
        found = read_outcome(folder)
        row |= {n: getattr(found, n) for n in ("frames", "seconds", "frames_per_second")}
        row |= found.evaluation
        row |= {f"{name}_at_start": value for name, value in found.at_start.items()}
        for score in found.scores:
            if score.name in KINDS:
                row[KINDS[score.name]] = score.mean_steps
            elif not score.name.startswith(("learned", "optimal")):
                row["scripted"], row["scripted_steps"] = score.name, score.mean_steps
        row["objective"], row["unit"] = found.objective.column, found.objective.unit
        row |= {f"{name}_version": value for name, value in found.versions.items()}
        row["commit"] = row.pop("commit_version", None)
        row["machine"] = found.machine.processor
    elif (folder / METRICS).exists() and (rows := read_metrics(folder)):
        row |= rows[-1]
    row["error"] = error_of(folder)
    return row


def read_outcome(folder: Path) -> Outcome:
    """What a table takes of `results.json`; ValueError where it is none."""
    remedy = "restore it from a copy, or remove that folder and run the sweep again"
    return read_as(Outcome, read_json(folder / RESULTS), folder / RESULTS, remedy)


def error_of(folder: Path) -> str | None:
    """The first line of `error.txt`, where there is one."""
    path = folder / ERROR
    if not path.is_file():
        return None
    return next(iter(path.read_text(encoding="utf-8", errors="replace").splitlines()), "unknown")
