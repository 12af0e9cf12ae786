"""The power of a study's test with the planned number of runs, printed before they are done."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from itertools import count

from train.experiments.statistics import least_p, power
from train.experiments.study import Study, TrainingRun
from train.experiments.sweep import MEASURED, flat_settings

LEVEL = 0.05
EFFECTS = (0.5, 1.0, 1.5, 2.0)
"""The differences of the means for which the power is given, in standard deviations of the runs."""


def power_lines(plan: Study) -> list[str]:
    """The power of the test that the report of an ablation makes, a line each.

    One line for every arm that has other numbers of runs. The report of a sweep makes no test: its
    line says so, and gives the power of a test of two settings.
    """
    if not plan.runs:
        return []
    control = plan.report.get("control")
    if control is not None:
        return _ablation(plan, str(control))
    columns = [name for name in (plan.report.get("x"), *plan.report.get("group", ())) if name]
    seeds = Counter(tuple(str(_values(run).get(name)) for name in columns) for run in plan.runs)
    return _sweep(sorted(set(seeds.values())))


def _values(run: TrainingRun) -> dict[str, object]:
    label = {MEASURED.get(name, name): value for name, value in run.label.items()}
    return flat_settings(run.settings) | label


def _ablation(plan: Study, control: str) -> list[str]:
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
    """The power of the report's test with so many runs of an arm and of the control.

    Args:
        sizes: the runs of both, for each task.
        arms: that are compared, for which p is corrected (Holm). The power is that of the first
            step, in which p is multiplied by their number: it is no smaller in later steps.
    """
    told = " and ".join(dict.fromkeys(f"{ours} against {theirs}" for ours, theirs in sizes))
    if min(min(pair) for pair in sizes) == 0:
        return f"{told}: nothing is compared where there is no run"
    if len(sizes) > 1:
        same = len(set(sizes)) == 1
        told += f" in {'each of ' if same else ''}{len(sizes)} tasks"
    arms = max(arms, 1)
    least = min(1.0, arms * least_p(sizes))
    test = "permutation test of Mann and Whitney's U"
    corrected = f" corrected for {arms} arms (Holm)" if arms > 1 else ""
    if least >= LEVEL:
        return (
            f"{told}: 0 % at every effect, since the smallest attainable p{corrected} of the "
            f"{test} is {least:.2f}; {_remedy(len(sizes), arms)}"
        )
    found = [f"{100.0 * power(sizes, effect, LEVEL / arms):.0f} %" for effect in EFFECTS]
    return (
        f"{told}: {_listed(found)} at effects of {_listed([f'{e:g}' for e in EFFECTS])} standard "
        f"deviations ({test}, p < {LEVEL:g}{corrected}, normally distributed runs); "
        f"the smallest attainable p is {least:.2g}"
    )


def _listed(words: Sequence[str]) -> str:
    return f"{', '.join(words[:-1])} and {words[-1]}"


def _remedy(tasks: int, arms: int) -> str:
    def least(runs: int) -> float:
        return arms * least_p([(runs, runs)] * tasks)

    enough = next(n for n in count(1) if least(n) < LEVEL)
    return f"p < {LEVEL:g} takes {enough} against {enough} ({least(enough):.2g})"


def _sweep(numbers: Sequence[int]) -> list[str]:
    """Of a sweep whose settings have this many seeds each."""
    told = " or ".join(map(str, numbers))
    least = numbers[0]
    line = "the report of a sweep makes no test; "
    if least == 1:
        line += "of a single seed there is no interval either, and nothing tells chance apart"
    else:
        line += f"it gives Student's 95 % intervals of the mean over {told} seeds"
    return [f"{line}. The power of a test of two settings, {power_line([(least, least)])}"]
