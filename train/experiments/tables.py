"""The results of a sweep as tidy tables: one row a run, and one row an evaluation."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pursuit.parts import references
from train.experiments.kinds import read_settings
from train.experiments.sweep import ERROR, HINTS, LABEL, status_of
from train.files import read_json, write_beside
from train.runs.folder import CONFIG, METRICS, RESULTS, RUN, read_config, read_metrics
from train.runs.provenance import check_sources
from train.runs.tasks import maze_of
from train.settings.checks import check
from train.settings.task import who_learns

if TYPE_CHECKING:
    import polars

KINDS = {"random": "random_steps", "learned": "greedy_steps", "learned, sampled": "sampled_steps"}
RUNS, CURVES = "results.parquet", "curves.parquet"


def collect(out: Path) -> tuple[polars.DataFrame, polars.DataFrame]:
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
    import polars

    folders = sorted(path.parent for path in out.glob(f"runs/*/{CONFIG}"))
    hints = read_json(out / HINTS) if (out / HINTS).exists() else {}
    if "runs" in hints:  # not those of a plan before this one
        folders = [folder for folder in folders if folder.name in hints["runs"]]
    check(bool(folders), f"{out}: no runs of a sweep here; `pursuit sweep FILE --out {out}` first")
    runs = polars.DataFrame([row_of(folder) for folder in folders], infer_schema_length=None)
    rows = [
        {"run": folder.name, **row}
        for folder in folders
        if (folder / METRICS).exists()
        for row in read_metrics(folder)
    ]
    curves = polars.DataFrame(rows, infer_schema_length=None)
    write_beside(out / RUNS, runs.write_parquet)
    write_beside(out / CURVES, curves.write_parquet)
    return runs, curves


def row_of(folder: Path) -> dict[str, Any]:
    """One run as a flat row."""
    kind, plain = read_config(folder)
    check_sources(folder / CONFIG, plain)
    if not any(references(plain)):  # else it is read as it stands: no user's part is imported
        kind, settings = read_settings(folder)
        plain = asdict(settings)
    task = plain.pop("task")
    task["maze"] = maze_of(task["maze"]).name
    task["role"] = who_learns(task["task"], task["role"]) if kind == RUN else "both"
    for name in ("hyper", "lessons"):
        plain |= {k: v for k, v in plain.pop(name, {}).items() if k not in plain}
    if "members" in plain:
        plain["members"] = " ".join(plain["members"])
    label = read_json(folder / LABEL) if (folder / LABEL).exists() else {}
    row: dict[str, Any] = {"run": folder.name, "kind": kind, "status": status_of(folder)}
    row |= {"variant": label.get("variant"), **task, **plain}
    # What a sweep names is kept as it says it, so that reports can group by `preset`, say.
    row |= {name: value for name, value in label.items() if name not in row}
    row["budget_seconds"], row["budget_frames"] = row.pop("seconds"), row.pop("frames")
    if (folder / RESULTS).exists():
        results = read_json(folder / RESULTS)
        row |= {name: results[name] for name in ("frames", "seconds", "frames_per_second")}
        row |= results["evaluation"]
        row |= {f"{name}_at_start": value for name, value in results.get("at_start", {}).items()}
        for score in results.get("scores", ()):
            if score["name"] in KINDS:
                row[KINDS[score["name"]]] = score["mean_steps"]
            elif not score["name"].startswith(("learned", "optimal")):
                row["scripted"], row["scripted_steps"] = score["name"], score["mean_steps"]
        row["objective"], row["unit"] = (results["objective"][name] for name in ("column", "unit"))
        row |= {f"{name}_version": value for name, value in results["versions"].items()}
        row["commit"] = row.pop("commit_version", None)
        row["machine"] = results["machine"]["processor"]
    elif (folder / METRICS).exists() and (rows := read_metrics(folder)):
        row |= rows[-1]
    error = folder / ERROR
    row["error"] = error.read_text().splitlines()[0] if error.exists() else None
    return row
