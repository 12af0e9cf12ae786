"""Reading and validation of ablation files.

An ablation is a sweep of variants with equal budgets on the same task. Its report tests every
variant against a control. Runs, executors and folders are those of `pursuit sweep`.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import fields, replace
from pathlib import Path

from train.experiments.forms import REMEDY, THRESHOLDS, AblationFile, SweepFile, Table
from train.experiments.study import Study, TrainingRun
from train.experiments.sweep import Change, choose_version, multiply_out, read_file
from train.runs.folder import SELF_PLAY
from train.runs.parts import contest_of
from train.runs.tasks import task_of
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
"""Settings that all variants share."""


def load_ablation(
    name: str, version: str | None = None, change: Change = lambda file: file
) -> Study:
    """Read an ablation file and expand it: variants times seeds (times a grid of tasks).

    Args:
        name: the path of a file, or the name of a shipped one.
        version: "short" or "full" of a file that has both; short by default.
        change: modifies the contents of the file.

    Raises:
        ValueError: no such file, no variants, an unknown control, variants with different budgets,
            or an invalid sweep.
    """
    path, content = read_file(name, ABLATIONS, "ablation")
    check("arms" not in content, f"{path}: [[arms]] was renamed; give [[variants]]")
    file = read_as(AblationFile, content, path, REMEDY)
    try:
        variants = check_variants(file)
        shared = {n: getattr(file, n) for n in SweepFile.__struct_fields__}
        chosen = change(choose_version(SweepFile(**shared), version))
        for variant in variants:
            if chosen.kind != SELF_PLAY and "curriculum" not in (chosen.settings or {}):
                variant.setdefault("curriculum", "none")
        check_hints(chosen)
        study = multiply_out(chosen, path.stem)
        check_self_play(file, study) if file.kind == SELF_PLAY else check_runs(study.runs)
        report = {"variants": [each["name"] for each in variants], "x": study.report["x"]}
        report |= {n: getattr(file, n) for n in ("control", "primary", "margin", "threshold")}
        return replace(study, report=report)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def check_variants(file: AblationFile) -> list[Table]:
    """The variants of a file; ValueError if they cannot be compared."""
    variants, control, primary, margin = (
        file.variants or [],
        file.control,
        file.primary,
        file.margin,
    )
    check(len(variants) > 1, "give at least two [[variants]], with names")
    names = [variant.get("name") for variant in variants]
    check(control in names, f"control={control!r} is not a variant; give one of {names}")
    others = [name for name in names if name != control]
    check(
        primary in (None, *others),
        f"primary={primary!r} is not a variant other than the control; give one of {others}",
    )
    check(margin is None or margin > 0, f"margin={margin}; give points of the gap, above 0")
    check(
        file.threshold in THRESHOLDS,
        f"threshold={file.threshold:g}; give one of the gaps {THRESHOLDS} in %",
    )
    for variant in variants:
        own = sorted(set(EQUAL) & set(variant))
        check(
            not own,
            f"variant {variant.get('name')!r} sets {', '.join(own)}; all variants have the same "
            "budget, task and seeds, so set it in [settings]",
        )
    return variants


def check_hints(file: SweepFile) -> None:
    """ValueError for a grid or a [report] that is not allowed in an ablation."""
    grid, hints = list(file.grid or {}), file.report
    check(
        hints is None or hints.group is None,
        "group in [report]: an ablation draws one curve per variant; leave it out",
    )
    x = None if hints is None else hints.x
    check(x in (None, *grid), f"x={x!r} in [report] is not in [grid]; give one of {grid}")
    check(
        len(grid) <= 1 and (x is not None or not grid),
        f"[grid] {grid} and x={x!r} in [report]; give at most one setting in [grid], and name it "
        "as x in [report]: variants are compared for each of its values",
    )


def check_self_play(file: AblationFile, study: Study) -> None:
    """ValueError for self-play that this ablation cannot compare by exact NashConv."""
    for name in ("primary", "margin"):
        given = getattr(file, name)
        check(given is None, f"{name}={given!r} is for single-agent runs; leave it out")
    x = study.report["x"]
    check(x in (None, "maze"), f"x={x!r} in [report]; in self-play give [grid] maze = [...]")
    for task in dict.fromkeys(run.settings.task for run in study.runs):
        check(
            task_of(task).is_duel,
            f"task {task.task!r} with these agents has no exact NashConv for every run; use one "
            "chaser against one evader",
        )


def check_runs(runs: Iterable[TrainingRun]) -> None:
    """ValueError for single-agent runs without a gap in steps to an exact optimum."""
    for task in dict.fromkeys(run.settings.task for run in runs):
        contest = contest_of(task, 2)
        check(
            contest.optimal() is not None,
            f"the exact optimum of task {task.task!r} with these agents is not known, but an "
            "ablation needs it; use a single runner, one chaser against one evader, or a smaller "
            "game without goals for evaders",
        )
        check(
            contest.measure.name == "steps",
            f"task {task.task!r} is scored by {contest.measure.name}, but an ablation needs the "
            "gap in steps; use a single runner, or a chase",
        )
