"""Ablations: arms against a control, with equal budgets and the same final difficulty.

An ablation is a sweep whose variants are called arms: the runs, executors and folders are those of
`pursuit sweep`; the report is its own.
"""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

from train.experiments.sweep import Sweep, choose_version, multiply_out, read_file
from train.runs.folder import RUN
from train.runs.parts import contest_of
from train.settings.checks import check
from train.settings.task import TaskSettings

ABLATIONS = Path(__file__).with_name("files") / "ablations"
EQUAL = (
    "seconds",
    "frames",
    "seed",
    "threads",
    "evaluate",
    *(f.name for f in fields(TaskSettings)),
)
"""What no arm may have of its own."""


def load_ablation(name: str, version: str | None = None) -> Sweep:
    """Read an ablation file and multiply it out: arms times seeds (times a grid of tasks).

    Args:
        name: the path of a file, or the name of a shipped one.
        version: "short" or "full", where the file has both; short if left out.

    Raises:
        ValueError: no such file, no arms, an unknown control, arms with budgets of their own, or
            whatever makes a sweep impossible.
    """
    path, content = read_file(name, ABLATIONS, "ablation")
    try:
        check("variants" not in content, "[[variants]] are called [[arms]] in an ablation")
        content["variants"] = arms = content.pop("arms", [])
        check(isinstance(arms, list) and len(arms) > 1, "give at least two [[arms]], with names")
        control = content.pop("control", None)
        names = [arm.get("name") for arm in arms]
        check(control in names, f"control={control!r} is none of the arms {names}; name one")
        for arm in arms:
            own = sorted(set(EQUAL) & set(arm))
            check(
                not own,
                f"arm {arm.get('name')!r} sets {', '.join(own)}; arms have equal budgets and the "
                "same task and seeds: set it for all, in [settings]",
            )
        chosen = choose_version(content, version)
        for arm in arms:
            if "curriculum" not in chosen.get("settings", {}):
                arm.setdefault("curriculum", "none")
        sweep = multiply_out(chosen, path.stem)
        x = sweep.report["x"]
        check(
            x in (None, *content.get("grid", {})),
            f"x={x!r} in [report] is none of the [grid] {list(content.get('grid', {}))}",
        )
        check(
            len(content.get("grid", {})) <= 1 and (x is not None or not content.get("grid")),
            "an ablation has at most one thing in its [grid], named as x in [report]: arms are "
            "compared within each of its values",
        )
        check(not sweep.exact, "an ablation has no [exact]")
        check(
            all(run.kind == RUN for run in sweep.runs),
            "an ablation compares runs of one agent by their gap to the optimum; compare "
            "self-play in a sweep, with [[variants]]",
        )
        for task, run in {run.settings.task: run for run in sweep.runs}.items():
            check(
                contest_of(run.settings.task, 2).optimal() is not None,
                f"the exact optimum of task {task.task!r} with these agents is not known, and an "
                "ablation is measured against it; take a runner alone, or one chaser against one "
                "evader",
            )
        return replace(sweep, report={"control": control, "arms": names, "x": sweep.report["x"]})
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
