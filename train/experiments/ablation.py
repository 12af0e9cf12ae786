"""Ablations: arms against a control, with equal budgets and the same final difficulty.

An ablation is a sweep whose variants are called arms: the runs, executors and folders are those of
`pursuit sweep`; the report is its own.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import fields, replace
from pathlib import Path

from train.experiments.forms import REMEDY, THRESHOLDS, AblationFile, SweepFile, Table
from train.experiments.study import Study, TrainingRun
from train.experiments.sweep import Change, choose_version, multiply_out, read_file
from train.runs.folder import RUN
from train.runs.parts import contest_of
from train.schemas import read_as
from train.settings.checks import check
from train.settings.task import TaskSettings

ABLATIONS = Path(__file__).with_name("files") / "ablations"
EQUAL = (
    "seconds",
    "clock",
    "frames",
    "seed",
    "threads",
    "processes",
    "evaluate",
    *(f.name for f in fields(TaskSettings)),
)
"""What no arm may have of its own."""


def load_ablation(
    name: str, version: str | None = None, change: Change = lambda file: file
) -> Study:
    """Read an ablation file and multiply it out: arms times seeds (times a grid of tasks).

    Args:
        name: the path of a file, or the name of a shipped one.
        version: "short" or "full", where the file has both; short if left out.
        change: what is to be another in the file than what it says.

    Raises:
        ValueError: no such file, no arms, an unknown control, arms with budgets of their own, or
            whatever makes a sweep impossible.
    """
    path, content = read_file(name, ABLATIONS, "ablation")
    check("variants" not in content, f"{path}: [[variants]] are called [[arms]] in an ablation")
    file = read_as(AblationFile, content, path, REMEDY)
    try:
        arms = check_arms(file)
        shared = {n: getattr(file, n) for n in SweepFile.__struct_fields__} | {"variants": arms}
        chosen = change(choose_version(SweepFile(**shared), version))
        for arm in arms:
            if "curriculum" not in (chosen.settings or {}):
                arm.setdefault("curriculum", "none")
        check_hints(chosen)
        study = multiply_out(chosen, path.stem)
        check_runs(study.runs)
        report = {"arms": [arm["name"] for arm in arms], "x": study.report["x"]}
        report |= {n: getattr(file, n) for n in ("control", "primary", "margin", "threshold")}
        return replace(study, report=report)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def check_arms(file: AblationFile) -> list[Table]:
    """The arms of a file; ValueError for those that cannot be compared."""
    arms, control, primary, margin = file.arms or [], file.control, file.primary, file.margin
    check(len(arms) > 1, "give at least two [[arms]], with names")
    names = [arm.get("name") for arm in arms]
    check(control in names, f"control={control!r} is none of the arms {names}; name one")
    others = [name for name in names if name != control]
    check(
        primary in (None, *others),
        f"primary={primary!r} is none of the arms beside the control: {others}; name one",
    )
    check(margin is None or margin > 0, f"margin={margin}; points of the gap, above 0")
    check(
        file.threshold in THRESHOLDS,
        f"threshold={file.threshold:g}; one of the gaps {THRESHOLDS} in %",
    )
    for arm in arms:
        own = sorted(set(EQUAL) & set(arm))
        check(
            not own,
            f"arm {arm.get('name')!r} sets {', '.join(own)}; arms have equal budgets and the "
            "same task and seeds: set it for all, in [settings]",
        )
    return arms


def check_hints(file: SweepFile) -> None:
    """ValueError for a grid or a [report] that an ablation cannot have."""
    grid, hints = list(file.grid or {}), file.report
    check(
        hints is None or hints.group is None,
        "group in [report]: the curves of an ablation are its arms; leave it out",
    )
    x = None if hints is None else hints.x
    check(x in (None, *grid), f"x={x!r} in [report] is none of the [grid] {grid}")
    check(
        len(grid) <= 1 and (x is not None or not grid),
        "an ablation has at most one thing in its [grid], named as x in [report]: arms are "
        "compared within each of its values",
    )


def check_runs(runs: Iterable[TrainingRun]) -> None:
    """ValueError for runs that have no gap to an exact optimum in steps."""
    check(
        all(run.kind == RUN for run in runs),
        "an ablation compares runs of one agent by their gap to the optimum; compare "
        "self-play in a sweep, with [[variants]]",
    )
    for task in dict.fromkeys(run.settings.task for run in runs):
        contest = contest_of(task, 2)
        check(
            contest.optimal() is not None,
            f"the exact optimum of task {task.task!r} with these agents is not known, and an "
            "ablation is measured against it; take a runner alone, one chaser against one "
            "evader, or a smaller game without a hunt for goals",
        )
        check(
            contest.measure.name == "steps",
            f"task {task.task!r} is judged by {contest.measure.name}, and an ablation by the "
            "gap in steps; take a runner alone, or a chase",
        )
