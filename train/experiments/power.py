"""What so few runs can show, said before they are done."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from itertools import count

from train.experiments.statistics import least_p
from train.experiments.sweep import MEASURED, Sweep, SweepRun, flat_settings

LEVEL = 0.05


def power_lines(plan: Sweep) -> list[str]:
    """What the report of a sweep or an ablation can show with this many runs, a line each.

    Of an ablation by the test that its report makes, for every arm that has other numbers of runs;
    a sweep's report makes none, and that is said.
    """
    if not plan.runs:
        return []
    control = plan.report.get("control")
    if control is not None:
        return _ablation(plan, str(control))
    columns = [name for name in (plan.report.get("x"), *plan.report.get("group", ())) if name]
    seeds = Counter(tuple(str(_values(run).get(name)) for name in columns) for run in plan.runs)
    return _sweep(sorted(set(seeds.values())))


def _values(run: SweepRun) -> dict[str, object]:
    label = {MEASURED.get(name, name): value for name, value in run.label.items()}
    return flat_settings(run.settings) | label


def _ablation(plan: Sweep, control: str) -> list[str]:
    x = plan.report.get("x")
    runs = Counter(
        (str(run.label["variant"]), str(_values(run)[x]) if x else "") for run in plan.runs
    )
    tasks = list(dict.fromkeys(task for _, task in runs))
    arms = [arm for arm in dict.fromkeys(arm for arm, _ in runs) if arm != control]
    sizes = [tuple((runs[arm, task], runs[control, task]) for task in tasks) for arm in arms]
    others = len(arms) - (plan.report.get("primary") is not None)
    return [power_line(each, others) for each in dict.fromkeys(sizes)]


def power_line(sizes: Sequence[tuple[int, int]], arms: int = 1) -> str:
    """Whether runs of an arm against the control can show p < 0.05, by the test of the report.

    Args:
        sizes: the runs of both, for each task.
        arms: that are compared, for which p is corrected (Holm): the least p is that of the first.
    """
    told = " and ".join(dict.fromkeys(f"{ours} against {theirs}" for ours, theirs in sizes))
    if min(min(pair) for pair in sizes) == 0:
        return f"{told}: nothing is compared where there is no run"
    if len(sizes) > 1:
        same = len(set(sizes)) == 1
        told += f" in {'each of ' if same else ''}{len(sizes)} tasks"
    least = min(1.0, max(arms, 1) * least_p(sizes))
    test = "the least p of the permutation test (of Mann and Whitney's U)"
    if arms > 1:
        test += f", corrected for {arms} arms,"
    if least < LEVEL:
        return f"{told} can show p < {LEVEL:g}: {test} is {least:.2g}"
    remedy = _remedy(len(sizes), max(arms, 1))
    return f"{told} cannot show p < {LEVEL:g}: {test} is {least:.2f}; {remedy}"


def _remedy(tasks: int, arms: int = 1) -> str:
    def least(runs: int) -> float:
        return arms * least_p([(runs, runs)] * tasks)

    enough = next(n for n in count(1) if least(n) < LEVEL)
    return f"it takes {enough} against {enough} ({least(enough):.2g})"


def _sweep(numbers: Sequence[int]) -> list[str]:
    """Of a sweep whose settings have this many seeds each."""
    told = " or ".join(map(str, numbers))
    least = numbers[0]
    line = "the report of a sweep makes no test; "
    if least == 1:
        line += "of a single seed there is no interval either, and nothing tells chance apart"
    else:
        line += f"it gives Student's 95 % intervals of the mean over {told} seeds"
    p = least_p([(least, least)])
    verb = "could not" if p >= LEVEL else "could"
    line += f". A permutation test of {least} against {least} {verb} show p < {LEVEL:g}: "
    line += f"its least p is {p:.2g}" if p < LEVEL else f"its least p is {p:.2f}; {_remedy(1)}"
    return [line]
