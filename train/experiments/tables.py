"""The results of a sweep as tidy tables: one row a run, and one row an evaluation."""

from __future__ import annotations

import io
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pursuit.plugins import references
from train.experiments.forms import Hints, read_hints, read_label
from train.experiments.kinds import read_settings
from train.experiments.study import ERROR, status_of
from train.experiments.sweep import MEASURED, flat_plain
from train.files import write_beside
from train.runs.folder import CONFIG, METRICS, RESULTS, RUN, load_results, read_config, read_metrics
from train.runs.provenance import check_sources
from train.runs.tasks import maze_called
from train.settings.checks import check
from train.settings.self_play import ROLES
from train.settings.task import who_learns

if TYPE_CHECKING:
    import polars

KINDS = {"random": "random_steps", "learned": "greedy_steps", "learned, sampled": "sampled_steps"}
RUNS, CURVES = "results.parquet", "curves.parquet"


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


@dataclass
class FinishedStudy:
    """The runs of a sweep or of an ablation, as its report reads them.

    Attributes:
        hints: what the report is to show.
        rows: of the complete runs; `everything` of all.
        columns: the names in them.
        by_run: the evaluations of each run.
    """

    hints: Hints
    rows: list[dict[str, Any]]
    everything: list[dict[str, Any]]
    columns: list[str]
    by_run: dict[str, list[dict[str, Any]]]


def read_study(out: Path) -> FinishedStudy:
    """The runs in a folder, collected; ValueError where none is complete."""
    runs, evaluations = collect(out)
    everything = runs.to_dicts()
    rows = [row for row in everything if row["status"] == "complete"]
    check(bool(rows), f"{out}: no run is complete yet; the command that began it goes on with it")
    by_run: dict[str, list[dict[str, Any]]] = {}
    for row in evaluations.to_dicts():
        by_run.setdefault(row["run"], []).append(row)
    return FinishedStudy(read_hints(out), rows, everything, runs.columns, by_run)


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
        found = load_results(folder)
        row |= {n: found[n] for n in ("frames", "seconds", "frames_per_second")}
        row |= found["evaluation"]
        row |= {f"{name}_at_start": value for name, value in found["at_start"].items()}
        for score in found["scores"]:
            if score["name"] in KINDS:
                row[KINDS[score["name"]]] = score["mean_steps"]
            elif not score["name"].startswith(("learned", "optimal")):
                row["scripted"], row["scripted_steps"] = score["name"], score["mean_steps"]
        row |= {"objective": found["objective"]["column"], "unit": found["objective"]["unit"]}
        row |= {f"{name}_version": value for name, value in found["versions"].items()}
        row["commit"] = row.pop("commit_version", None)
        row["machine"] = found["machine"]["processor"]
    elif (folder / METRICS).exists() and (rows := read_metrics(folder)):
        row |= rows[-1]
    row["error"] = error_of(folder)
    return row


def error_of(folder: Path) -> str | None:
    """The first line of `error.txt`, where there is one."""
    path = folder / ERROR
    if not path.is_file():
        return None
    return next(iter(path.read_text(encoding="utf-8", errors="replace").splitlines()), "unknown")
