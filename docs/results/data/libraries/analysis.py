"""Tables and figure of docs/results/libraries.md: our PPO beside that of other libraries.

Those of the next comparison need seconds.csv and frames.csv: the runs.csv in the reports of
`pursuit compare --version full` and `pursuit compare ppo-frames --version full`.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from statistics import fmean, median
from typing import Any

from train.experiments.committed import grouped, read_table
from train.experiments.recorded import read_recorded
from train.experiments.statistics import holm, permutation_p
from train.reports.figures import PALETTE, legend_beside, log_axis, pyplot, save, tidy
from train.reports.tables import plain_table

NAMES = {
    "ours": "Pursuit",
    "stable-baselines3": "Stable-Baselines3",
    "cleanrl": "CleanRL, rewritten",
    "torchrl": "TorchRL, script form",
}
RIVALS = ("stable-baselines3", "cleanrl")
"""The libraries of the next comparison."""
GAPS = (5, 2, 1)
"""In per cent."""
NEVER = 1e18
"""The time to a gap that a run, also one that failed, does not reach."""
Row = dict[str, Any]


def two_digits(value: float) -> str:
    """A number with two digits, or without a fraction."""
    return f"{value:.1f}" if value < 9.95 else f"{value:.0f}"


def column(unit: str, gap: int) -> str:
    """The name of the column of the times of the sampled policy to a gap."""
    return f"{unit}_to_{gap}_percent_sampled"


def times(rows: Sequence[Row], column: str) -> list[float]:
    """The times of runs to a gap."""
    return [NEVER if row.get(column) is None else row[column] for row in rows]


def shown(values: Sequence[float], unit: str = "seconds") -> str:
    """The median and how many runs arrived."""
    arrived, middle = sum(value < NEVER for value in values), median(values)
    text = two_digits(middle) if unit == "seconds" else f"{middle / 1e6:.2f} M"
    return f"{text if middle < NEVER else '–'} ({arrived})"


def contestants(data: Path) -> str:
    """A row for every library, with its times and gaps in the three tasks."""
    found, rows = list[Row](), read_table(data / "runs.csv")
    for name, own in grouped(rows, "contestant").items():
        one, three, chaser = grouped(own, "task").values()
        speeds = [[row["frames"] / row["seconds"] / 1e3 for row in t] for t in (one, three, chaser)]
        line: Row = {"": NAMES[name]}
        line["thousand frames/s (1 goal, 3 goals, chaser)"] = ", ".join(
            f"{median(values):.0f}" for values in speeds
        )
        for task, runs, gaps in (
            ("1 goal", one, (1,)), ("3 goals", three, GAPS), ("chaser 7x7", chaser, (5, 1))
        ):  # fmt: skip
            for gap in gaps:
                values = times(runs, column("seconds", gap))
                line[f"{task}: to {gap} %"] = shown(values)
            if runs is not one:
                ends = [two_digits(100.0 * each(r["sampled"] for r in runs)) for each in (min, max)]
                line[f"{task}: gaps at the end"] = f"{' to '.join(ends)} %"
        found.append(line)
    first = ("1 goal: to 1 %", "3 goals: to 5 %", "chaser 7x7: to 5 %")
    heads = {n: n.partition(": ")[2] for n in found[0] if ": " in n and n not in first}
    return plain_table(found, heads).markdown()


def next_runs(rows: Sequence[Row], unit: str) -> str:
    """The runs of the next comparison with budgets in a unit."""
    lines = []
    for (task, name), own in grouped(rows, "variant", "contestant").items():
        ended = [row for row in own if row["status"] == "complete"]
        gaps = [100.0 * row["sampled"] for row in ended]
        speed = median(row["frames"] / row["seconds"] / 1e3 for row in ended)
        line: Row = {"task": task, "contestant": name, "thousand frames/s": f"{speed:.0f}"}
        for gap in GAPS:
            values = times(own, f"sampled_{unit}_to_{gap}")
            line[f"{unit} to {gap} %"] = shown(values, unit)
        ends = f"{fmean(gaps):.2f}, {min(gaps):.2f} to {max(gaps):.2f} %"
        lines.append(line | {"gap at the end, mean, least to most": ends})
    return plain_table(lines).markdown()


def next_tests(rows: Sequence[Row], unit: str) -> str:
    """Of every task and gap the p of ours against each library, the largest of these, corrected for
    all tasks and gaps (Holm)."""
    lines = []
    for task, own in grouped(rows, "variant").items():
        runs = grouped(own, "contestant")
        for gap in GAPS:
            column = f"sampled_{unit}_to_{gap}"
            ours, others = times(runs["ours"], column), [times(runs[n], column) for n in RIVALS]
            first = median(ours) < min(map(median, others))
            line: Row = {"task": task, "gap": f"{gap} %"}
            line["ours has the least median"] = "yes" if first else "no"
            p = max(permutation_p([ours], [other]) for other in others)
            lines.append(line | {"largest p": p})
    for line, p in zip(lines, holm([line["largest p"] for line in lines]), strict=True):
        line["corrected"] = p
    return plain_table(lines).markdown()


def tables(data: Path) -> dict[str, str]:
    """The tables by title."""
    found = {"PPO of four libraries": contestants(data)}
    for unit in ("seconds", "frames"):
        if (path := data / f"{unit}.csv").exists():
            rows = [*read_recorded(path).values()]
            found[f"next comparison, {unit}"] = next_runs(rows, unit)
            found[f"next comparison, tests in {unit}"] = next_tests(rows, unit)
    return found


def figures(data: Path, out: Path) -> None:
    """Of every task the seconds and the frames of runs to a gap, and their median where it is one
    of a run that arrived."""
    tasks = {
        task: grouped(rows, "contestant")
        for task, rows in grouped(read_table(data / "runs.csv"), "task").items()
    }
    size = {"figsize": (10.5, 5.6), "sharex": True, "sharey": "row", "layout": "constrained"}
    figure, axes = pyplot().subplots(2, len(tasks), **size)
    for axis, task in zip(axes[0], tasks, strict=True):
        axis.set_title(task, fontsize=11)
    for unit, line in zip(("seconds", "frames"), axes, strict=True):
        scale = 1e-6 if unit == "frames" else 1.0
        for axis, own in zip(line, tasks.values(), strict=True):
            for place, (name, label) in enumerate(NAMES.items()):
                found: list[tuple[float, float]] = []
                for number, gap in enumerate(GAPS):
                    at, runs = number + 0.14 * (place - 1.5), times(own[name], column(unit, gap))
                    reached = [scale * time for time in runs if time < NEVER]
                    style: Row = {"color": PALETTE[place], "alpha": 0.5, "ms": 3}
                    axis.plot([at] * len(reached), reached, "o", **style)
                    if median(runs) < NEVER:
                        found.append((at, scale * median(runs)))
                ends = zip(*found, strict=True) if found else ([], [])
                axis.plot(*ends, "-D", ms=6, color=PALETTE[place], label=label)
            axis.set_xticks(range(len(GAPS)), [f"{gap} %" for gap in GAPS])
            tidy(axis)
        log_axis(line[0], "y")
    for axis in axes[1]:
        axis.set_xlabel("gap to the optimum")
    axes[0, 0].set_ylabel("processor seconds to the gap")
    axes[1, 0].set_ylabel("million frames to the gap")
    legend_beside(figure, axes.flat)
    save(figure, out / "to_gaps.png", dpi=110)
