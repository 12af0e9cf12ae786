"""Ablations: arms against a control, with equal budgets and the same final difficulty.

An ablation is a sweep whose variants are called arms: the runs, executors and folders are those of
`pursuit sweep`; the report is its own.
"""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

from train.experiments.forms import THRESHOLDS, AblationFile, SweepFile
from train.experiments.sweep import (
    Change,
    Sweep,
    choose_version,
    multiply_out,
    read_file,
    read_form,
)
from train.runs.folder import RUN
from train.runs.parts import contest_of
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
) -> Sweep:
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
    file = read_form(AblationFile, content, path)
    try:
        arms, control = file.arms or [], file.control
        check(len(arms) > 1, "give at least two [[arms]], with names")
        names = [arm.get("name") for arm in arms]
        check(control in names, f"control={control!r} is none of the arms {names}; name one")
        others = [name for name in names if name != control]
        primary, margin, threshold = file.primary, file.margin, file.threshold
        check(
            primary in (None, *others),
            f"primary={primary!r} is none of the arms beside the control: {others}; name one",
        )
        check(margin is None or margin > 0, f"margin={margin}; points of the gap, above 0")
        check(
            threshold in THRESHOLDS, f"threshold={threshold:g}; one of the gaps {THRESHOLDS} in %"
        )
        for arm in arms:
            own = sorted(set(EQUAL) & set(arm))
            check(
                not own,
                f"arm {arm.get('name')!r} sets {', '.join(own)}; arms have equal budgets and the "
                "same task and seeds: set it for all, in [settings]",
            )
        shared = {n: getattr(file, n) for n in AblationFile.__struct_fields__}
        for name in ("arms", "control", "primary", "margin", "threshold"):
            del shared[name]
        chosen = change(choose_version(SweepFile(**shared, variants=arms), version))
        for arm in arms:
            if "curriculum" not in (chosen.settings or {}):
                arm.setdefault("curriculum", "none")
        grid, hints = list(chosen.grid or {}), chosen.report
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
        sweep = multiply_out(chosen, path.stem)
        check(sweep.exact is None, "an ablation has no [exact]")
        check(
            all(run.kind == RUN for run in sweep.runs),
            "an ablation compares runs of one agent by their gap to the optimum; compare "
            "self-play in a sweep, with [[variants]]",
        )
        for task, run in {run.settings.task: run for run in sweep.runs}.items():
            contest = contest_of(run.settings.task, 2)
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
        report = {"control": control, "arms": names, "x": sweep.report["x"], "primary": primary}
        return replace(sweep, report=report | {"margin": margin, "threshold": threshold})
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
