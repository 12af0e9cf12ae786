"""Execution of a replication: the search for settings, then the runs of every study."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

import msgspec

from train.experiments.executors import run_locally
from train.experiments.forms import Table, read_label
from train.experiments.replication.plan import (
    SHIPPED,
    Claim,
    Experiment,
    Replication,
    sweep_of,
    tuning_sweep,
)
from train.experiments.replication.rules import Ran
from train.experiments.report import report_on
from train.experiments.search import log_gap
from train.experiments.study import Study, statuses_of
from train.experiments.tables import collect
from train.files import read_json, write_json
from train.settings.checks import check

TUNING, STUDIES, RULES_KEPT = "tuning", "studies", "rules.json"
SETTINGS = "settings"
"""The name of the search."""
Tell = Callable[[str], None]
Watched = Callable[[Study], Callable[[dict[str, str], dict[str, float]], None]]
"""Makes the progress callback of a study."""


def folder_of(study: Experiment, out: Path) -> Path:
    """The folder of a study."""
    return out / STUDIES / study.id


def keep_rules(plan: Replication, out: Path) -> None:
    """Write the rules that decide the claims to a file, before the first run."""
    path = out / RULES_KEPT
    kept = read_json(path) if path.exists() else {}
    now = datetime.now(UTC).isoformat(timespec="seconds")
    for study in plan.studies:
        if study.id not in kept and not study.exact:
            kept[study.id] = {"written": now, "claims": rules_of(study.claims)}
    write_json(path, kept)


def rules_of(claims: Sequence[Claim]) -> list[Table]:
    """Claims as plain values, without the interpretations of their results."""
    plain: list[Table] = msgspec.to_builtins(claims)
    return [{name: value for name, value in claim.items() if name != "cause"} for claim in plain]


def changed_rules(study: Experiment, out: Path) -> str:
    """A note if the rules of a study were changed after its first run; else empty."""
    path = out / RULES_KEPT
    kept = read_json(path).get(study.id) if path.exists() else None
    if kept is None:
        return ""
    with contextlib.suppress(msgspec.ValidationError):  # claims of an older format
        before = msgspec.convert(kept["claims"], list[Claim])
        if rules_of(before) == rules_of(study.claims):
            return ""
    return f"The rules of this study were changed after its first run ({kept['written']})."


def carry_out(plan: Replication, out: Path, workers: int, tell: Tell, watched: Watched) -> bool:
    """Execute all runs that are not complete; returns whether all succeeded.

    Args:
        plan: the replication.
        out: its folder.
        workers: parallel runs, one core each.
        tell: called with the title of the next stage.
        watched: makes the progress callback of a study.

    Raises:
        ValueError: a folder with other contents.
        KeyboardInterrupt: once the runs have saved.
    """
    check(not out.is_file(), f"{out}: a file; give a folder")
    out.mkdir(parents=True, exist_ok=True)
    keep_rules(plan, out)
    well = tuned = True
    for stage in stages(plan, out):
        tell(f"{stage.name}: {stage.title}")
        if stage.tuned and not tuned:
            tell("skipped: trials of the search for its settings have failed")
            continue
        done = do_runs(stage.runs, stage.folder, workers, watched)
        tuned = done if stage.name == SETTINGS else tuned
        well = well and done
    return well


class Stage(NamedTuple):
    """A study of a replication: name, title, whether it needs settings of the search, runs and
    folder."""

    name: str
    title: str
    tuned: bool
    runs: Study
    folder: Path


def stages(plan: Replication, out: Path) -> Iterator[Stage]:
    """The search, then every study, with the settings found so far."""
    if plan.tuning is not None:
        title = "search for the settings of every algorithm"
        yield Stage(SETTINGS, title, False, tuning_sweep(plan), out / TUNING)
    for study in plan.studies:
        if not study.exact:
            runs = planned_sweep(study, plan, out)
            yield Stage(study.id, study.title, study.tuned, runs, folder_of(study, out))


def planned_sweep(study: Experiment, plan: Replication, out: Path) -> Study:
    """The runs of a study with the settings found so far."""
    return sweep_of(study, plan, tuned_settings(plan, out))


def do_runs(runs: Study, folder: Path, workers: int, watched: Watched) -> bool:
    """Execute incomplete runs and write their report; returns whether all are complete."""
    written = (folder / "report" / "report.md").exists()
    if written and {"complete"} == set(statuses_of(runs, folder).values()):
        return True
    statuses = set(run_locally(runs, folder, workers, watched(runs)).values())
    if "complete" in statuses:
        report_on(folder)
    return statuses == {"complete"}


# -- results ---------------------------------------------------------------------------------------


def complete_runs(folder: Path, mazes: Mapping[str, str]) -> list[Ran]:
    """The complete runs in the folder of a sweep.

    Args:
        folder: of the sweep.
        mazes: paths of user-defined mazes, by the names of the mazes that they replace.
    """
    if not (folder / "runs").is_dir():
        return []
    names = {path: name for name, path in mazes.items()}
    runs, curves = collect(folder)
    lengths: dict[str, list[float]] = {}
    for row in curves.to_dicts() if "mean_steps" in curves.columns else ():  # not of self-play
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
    """The mean logarithm of the gap of every complete trial, by algorithm and name."""
    if plan.tuning is None:
        return {}
    found: dict[str, dict[str, list[float]]] = {}
    for run in complete_runs(out / TUNING, {}):
        algorithm, _, name = str(run.row["variant"]).partition(", ")
        score = log_gap(run.distance / 100.0)  # absolute, as evaders have negative gaps
        found.setdefault(algorithm, {}).setdefault(name, []).append(score)
    wanted = len(plan.tuning.mazes)
    return {
        algorithm: {n: sum(g) / len(g) for n, g in trials.items() if len(g) == wanted}
        for algorithm, trials in found.items()
    }


def tuned_settings(plan: Replication, out: Path) -> dict[str, Table]:
    """The settings with the smallest mean logarithm of the gap, by algorithm."""
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
