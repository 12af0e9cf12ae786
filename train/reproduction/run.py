"""Carrying studies out: settings first, then every study's runs; what is done is not done again."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path

import msgspec

from train.experiments.executors import run_locally
from train.experiments.forms import read_label
from train.experiments.report import report
from train.experiments.sweep import Sweep, status_of
from train.experiments.tables import collect
from train.files import read_json, write_json
from train.reproduction.plan import (
    SHIPPED,
    Claim,
    Replication,
    Study,
    Table,
    sweep_of,
    tuning_sweep,
)
from train.reproduction.rules import Ran
from train.settings.checks import check

TUNING, STUDIES, RULES_KEPT = "tuning", "studies", "rules.json"
LEAST_GAP = 1e-3
"""Gaps below this count alike where settings are chosen."""

Tell = Callable[[str], None]
Watched = Callable[[Sweep], Callable[[dict[str, str], dict[str, float]], None]]
"""Makes what is told how far the runs of a sweep are."""


def folder_of(study: Study, out: Path) -> Path:
    """Where the runs of a study are."""
    return out / STUDIES / study.id


def keep_rules(plan: Replication, out: Path) -> None:
    """Write down, before the first run, by which rules the claims are to be decided."""
    path = out / RULES_KEPT
    kept = read_json(path) if path.exists() else {}
    now = datetime.now(UTC).isoformat(timespec="seconds")
    for study in plan.studies:
        if study.id not in kept and not study.exact:
            kept[study.id] = {"written": now, "claims": rules_of(study.claims)}
    write_json(path, kept)


def rules_of(claims: Sequence[Claim]) -> list[Table]:
    """Claims as they are decided: all but our reading of the outcome."""
    plain: list[Table] = msgspec.to_builtins(claims)
    return [{name: value for name, value in claim.items() if name != "cause"} for claim in plain]


def changed_rules(study: Study, out: Path) -> str:
    """What is to be said of a study whose rules are not those that its runs began with."""
    path = out / RULES_KEPT
    kept = read_json(path).get(study.id) if path.exists() else None
    if kept is None:
        return ""
    with contextlib.suppress(msgspec.ValidationError):  # of a form that claims no longer have
        before = msgspec.convert(kept["claims"], list[Claim])
        if rules_of(before) == rules_of(study.claims):
            return ""
    return f"The rules of this study were changed after its runs had begun ({kept['written']})."


def carry_out(plan: Replication, out: Path, workers: int, tell: Tell, watched: Watched) -> bool:
    """Do all that is not done yet; whether everything ended well.

    Args:
        plan: what is to be done.
        out: the folder of the replication.
        workers: runs at a time, each on a core of its own.
        tell: is told what comes next.
        watched: makes the watch of a sweep.

    Raises:
        ValueError: a folder that holds something else.
        KeyboardInterrupt: once the runs have saved.
    """
    check(not out.is_file(), f"{out}: a file; give a folder")
    out.mkdir(parents=True, exist_ok=True)
    keep_rules(plan, out)
    tuned = well = True
    if plan.tuning is not None:
        tell("settings for everybody, as many trials for each")
        tuned = well = do_sweep(tuning_sweep(plan), out / TUNING, workers, watched)
    for number, study in enumerate(plan.studies, 1):
        if study.exact:
            continue
        tell(f"study {number} of {len(plan.studies)}, {study.id}: {study.title}")
        if study.tuned and not tuned:
            tell("left out: trials of the settings that it needs have failed")
            continue
        well = (
            do_sweep(planned_sweep(study, plan, out), folder_of(study, out), workers, watched)
            and well
        )
    return well


def planned_sweep(study: Study, plan: Replication, out: Path) -> Sweep:
    """The runs of a study with the settings that the search has found so far."""
    return sweep_of(study, plan, tuned_settings(plan, out))


def do_sweep(sweep: Sweep, folder: Path, workers: int, watched: Watched) -> bool:
    """Do the runs of a sweep that are not done, and write its report; whether all are complete."""
    folders = [folder / "runs" / run.name for run in sweep.runs]
    if all(status_of(each) == "complete" for each in folders):
        if not (folder / "report" / "report.md").exists():
            report(folder)
        return True
    folder.mkdir(parents=True, exist_ok=True)
    statuses = run_locally(sweep, folder, workers, watched(sweep)).values()
    if "complete" in statuses:
        report(folder)
    return set(statuses) == {"complete"}


# -- what came of it -------------------------------------------------------------------------------


def complete_runs(folder: Path, mazes: Mapping[str, str]) -> list[Ran]:
    """The complete runs of a sweep's folder; a user's mazes under the names that they stand for."""
    if not (folder / "runs").is_dir():
        return []
    names = {path: name for name, path in mazes.items()}
    runs, curves = collect(folder)
    lengths: dict[str, list[float]] = {}
    for row in curves.to_dicts() if "mean_steps" in curves.columns else ():  # of one that learns
        lengths.setdefault(row["run"], []).append(row["mean_steps"])
    found = []
    for row in runs.to_dicts():
        if row["status"] == "complete":
            row["maze"] = names.get(str(row.get("maze")), row.get("maze"))
            label = read_label(folder / "runs" / row["run"])
            label |= {name: row[name] for name in ("maze",) if name in label}
            found.append(Ran(row, tuple(lengths.get(row["run"], ())), label))
    return found


def trial_scores(plan: Replication, out: Path) -> dict[str, dict[str, float]]:
    """For every algorithm the mean logarithm of the gap of each of its settings, where complete."""
    if plan.tuning is None:
        return {}
    found: dict[str, dict[str, list[float]]] = {}
    for run in complete_runs(out / TUNING, {}):
        algorithm, _, name = str(run.row["variant"]).partition(", ")
        gap = max(run.distance / 100.0, LEAST_GAP)  # without its sign: an evader's is negative
        found.setdefault(algorithm, {}).setdefault(name, []).append(math.log(gap))
    wanted = len(plan.tuning.mazes)
    return {
        algorithm: {n: sum(g) / len(g) for n, g in trials.items() if len(g) == wanted}
        for algorithm, trials in found.items()
    }


def tuned_settings(plan: Replication, out: Path) -> dict[str, Table]:
    """The settings of the least mean logarithm of the gap, for every algorithm."""
    best = {
        algorithm: min(scores, key=lambda name: scores[name])
        for algorithm, scores in trial_scores(plan, out).items()
        if scores
    }
    trials = tuning_sweep(plan).runs if best else ()
    labels: dict[str, Table] = {str(run.label["variant"]): run.label for run in trials}
    own = {"variant", "algorithm", "maze"}
    return {
        algorithm: {n: v for n, v in labels[f"{algorithm}, {name}"].items() if n not in own}
        for algorithm, name in best.items()
        if name != SHIPPED
    }
