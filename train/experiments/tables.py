"""The results of a sweep as tidy tables: one row per run, and one row per evaluation."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pursuit.files import write_atomically
from pursuit.plugins import references
from train.experiments.forms import Hints, read_hints, read_label
from train.experiments.study import ERROR, status_of
from train.experiments.sweep import MEASURED, flat_plain
from train.kinds import read_settings
from train.runs.folder import CONFIG, METRICS, RESULTS, RUN, load_results, read_config, read_metrics
from train.runs.provenance import check_sources
from train.runs.tasks import maze_called
from train.self_play.names import entry_names
from train.settings.checks import check
from train.settings.self_play import ROLES
from train.settings.task import learning_agent

if TYPE_CHECKING:
    import polars

KINDS = {"random": "random_steps", "learned": "greedy_steps", "learned, sampled": "sampled_steps"}
RUNS, CURVES = "results.parquet", "curves.parquet"


def collect(out: Path | str) -> tuple[polars.DataFrame, polars.DataFrame]:
    """Read all runs in the folder of a sweep, complete or not, and write both Parquet files.

    Returns:
        Runs: "run", "status", "variant" if there are variants, all settings, "frames", "seconds",
        "frames_per_second", the evaluation ("mean_steps", "ci95", "success_rate", "optimal_steps",
        "optimality_gap", "exact", "episodes"), "greedy_steps", "sampled_steps",
        the baselines ("random_steps", "scripted_steps"), versions, "commit", "machine" and "error".
        Curves: "run" and the columns of `metrics.csv`.

    Raises:
        ValueError: no sweep in this folder, or a run of an incompatible version.
    """
    out = Path(out)
    import polars

    folders = sorted(path.parent for path in out.glob(f"runs/*/{CONFIG}"))
    named = read_hints(out).runs
    if named is not None:  # leave out runs of an earlier version of the sweep file
        folders = [folder for folder in folders if folder.name in named]
    check(bool(folders), f"{out}: no runs of a sweep; run `pursuit sweep FILE --out {out}` first")
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
    """The runs of a sweep, of an ablation or of several folders, for a report.

    Attributes:
        hints: layout of the report.
        rows: of the complete runs. "_group" is the label of the curve, "_x" the value on the axis.
        everything: rows of all runs.
        x: the column on the axis; None for none.
        by_run: the evaluations of each run.
        folders: of the complete runs.
    """

    hints: Hints
    rows: list[dict[str, Any]]
    everything: list[dict[str, Any]]
    x: str | None
    by_run: dict[str, list[dict[str, Any]]]
    folders: list[Path]


def read_study(out: Path) -> FinishedStudy:
    """The runs in a folder; ValueError if none is complete."""
    runs, evaluations = collect(out)
    everything, hints = runs.to_dicts(), read_hints(out)
    rows = [row for row in everything if row["status"] == "complete"]
    check(bool(rows), f"{out}: no run is complete; repeat the command of the study to continue")
    by_run: dict[str, list[dict[str, Any]]] = {}
    for row in evaluations.to_dicts():
        by_run.setdefault(row["run"], []).append(row)
    x = hints.x if hints.x in runs.columns else None
    group = [name for name in hints.group if name in runs.columns]
    for row in rows:
        usual = ["algorithm"] if row["kind"] == RUN else ["kind"]
        row["_group"] = ", ".join(in_words(name, row[name]) for name in group or usual)
        row["_x"] = row[x] if x else ""
    folders = [out / "runs" / row["run"] for row in rows]
    return FinishedStudy(hints, rows, everything, x, by_run, folders)


def in_words(name: str, value: Any) -> str:
    """The value of a setting as text, with its name if it is a boolean or a number."""
    if isinstance(value, bool):
        return name if value else f"no {name}"
    return f"{name} {value:g}" if isinstance(value, int | float) else str(value)


def read_several(folders: Sequence[Path]) -> FinishedStudy:
    """Runs, sweeps and ablations as one study, with a group per run and per setting of a sweep.

    Raises:
        ValueError: a folder without complete runs, or runs with different objectives.
    """
    names = entry_names([str(folder) for folder in folders], lambda entry: False)
    whole = FinishedStudy(Hints(", ".join(names)), [], [], None, {}, [])
    for name, folder in zip(names, folders, strict=True):
        if (folder / CONFIG).exists():
            complete = (folder / RESULTS).exists()
            check(complete, f"{folder}: no results yet; continue this run with --resume {folder}")
            run = str(folder)
            whole.rows.append(row_of(folder) | {"run": run, "_group": name, "_x": ""})
            whole.by_run[run] = read_metrics(folder)
            whole.folders.append(folder)
            continue
        study = read_study(folder)
        variants = study.hints.variants
        for row in sorted(
            study.rows, key=lambda row: variants.index(row["variant"]) if variants else 0
        ):
            parts = [row["variant"] if variants else row["_group"]]
            parts += [in_words(str(study.x), row["_x"])] if study.x else []
            run = str(folder / row["run"])
            whole.by_run[run] = study.by_run.get(row["run"], [])
            group = ", ".join(parts) if len(folders) == 1 else f"{name}: {', '.join(parts)}"
            whole.rows.append(row | {"run": run, "_group": group, "_x": ""})
        whole.folders += study.folders
    objectives = sorted({str(row["objective"]) for row in whole.rows})
    check(
        len(objectives) == 1,
        f"these runs have different objectives ({' and '.join(objectives)}); give runs "
        "with the same objective",
    )
    whole.everything = whole.rows
    return whole


def write_parquet(path: Path, frame: polars.DataFrame) -> None:
    """Write `frame` as a Parquet file, atomically; OSError naming `path` if that fails."""
    data = io.BytesIO()  # with a path, polars raises its own exception on a full disk
    frame.write_parquet(data)

    def write(beside: Path) -> None:
        beside.write_bytes(data.getvalue())

    write_atomically(path, write)


def row_of(folder: Path) -> dict[str, Any]:
    """One run as a flat row."""
    kind, plain = read_config(folder)
    check_sources(folder / CONFIG, plain)
    if not any(references(plain)):  # user-defined parts are not imported to read their settings
        kind, settings = read_settings(folder)
        plain = asdict(settings)
    task, label = plain["task"], read_label(folder)
    flat = flat_plain(plain)
    row: dict[str, Any] = {"run": folder.name, "kind": kind, "status": status_of(folder)}
    row |= {name: value for name, value in flat.items() if name not in row}
    row["variant"] = label.get("variant")
    if "maze" in task:
        row["maze"] = maze_called(task["maze"])
        row["role"] = learning_agent(task["task"], task["role"]) if kind == RUN else "both"
    if "members" in row:
        row["members"] = " ".join(row["members"])
    # Labels keep values and file names as the sweep file gives them, so that reports can group by
    # `preset`, for example.
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


def longer_is_better(row: Mapping[str, Any]) -> bool:
    """Whether more steps are better: for "evader" or a single one ("evader_0"), without goals."""
    return str(row.get("role")).startswith("evader") and row.get("num_goals") in (None, 0)


def error_of(folder: Path) -> str | None:
    """The first line of `error.txt`; None if there is none."""
    path = folder / ERROR
    if not path.is_file():
        return None
    return next(iter(path.read_text(encoding="utf-8", errors="replace").splitlines()), "unknown")
