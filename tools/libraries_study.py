"""Our PPO against that of each other library: tables of docs/results/libraries.md.

    python tools/libraries_study.py

It reads seconds.csv and frames.csv in docs/results/data/libraries/, the runs.csv in the reports of
`pursuit compare --version full` and `pursuit compare ppo-frames --version full`.
"""

from __future__ import annotations

import csv
from itertools import product
from pathlib import Path
from statistics import fmean, median
from typing import Any

from train.experiments.statistics import holm, permutation_p
from train.reports.tables import plain_table

DATA = Path(__file__).parents[1] / "docs" / "results" / "data" / "libraries"
OURS, LIBRARIES = "ours", ("stable-baselines3", "cleanrl")
GAPS = (5, 2, 1)
"""In per cent."""
NEVER = 1e18
"""The time to a gap that a run, also one that failed, does not reach."""
Row = dict[str, Any]


def rows_of(unit: str) -> list[Row]:
    """The runs of the comparison with budgets in seconds or frames; nothing if there is no file."""
    path = DATA / f"{unit}.csv"
    if not path.exists():
        return []
    with path.open(encoding="utf-8", newline="") as file:
        return [dict(row) for row in csv.DictReader(file)]


def times(rows: list[Row], task: str, contestant: str, column: str) -> list[float]:
    """A column of the runs of a contestant in a task."""
    own = [row for row in rows if (row["variant"], row["contestant"]) == (task, contestant)]
    return [float(row.get(column) or NEVER) for row in own]


def tests(unit: str) -> list[Row]:
    """Of every task and gap the p of ours against each library, the largest of these, corrected for
    all tasks and gaps (Holm)."""
    rows, found = rows_of(unit), list[Row]()
    for task, gap in product(dict.fromkeys(row["variant"] for row in rows), GAPS):
        column = f"sampled_{unit}_to_{gap}"
        ours = times(rows, task, OURS, column)
        others = {name: times(rows, task, name, column) for name in LIBRARIES}
        p = max(permutation_p([ours], [other]) for other in others.values())
        middles = [median(ours), *map(median, others.values())]
        found.append({"task": task, "gap": gap, "first": middles[0] < min(middles[1:]), "p": p})
    for row, p in zip(found, holm([row["p"] for row in found]), strict=True):
        row["p_holm"] = p
    return found


def shown(values: list[float], unit: str) -> str:
    """The median and how many runs arrived."""
    arrived, middle = sum(value < NEVER for value in values), median(values)
    text = (
        "–"
        if middle >= NEVER
        else f"{middle:.0f}"
        if unit == "seconds"
        else f"{middle / 1e6:.2f} M"
    )
    return f"{text} ({arrived})"


def table(unit: str) -> str:
    """The table of a comparison as Markdown."""
    rows, lines = rows_of(unit), []
    pairs = dict.fromkeys((row["variant"], row["contestant"]) for row in rows)
    for task, name in pairs:
        own = [row for row in rows if (row["variant"], row["contestant"]) == (task, name)]
        ended = [row for row in own if row["status"] == "complete"]
        speeds = [float(row["frames"]) / float(row["seconds"]) / 1e3 for row in ended]
        gaps = sorted(100.0 * float(row["sampled"]) for row in ended)
        line = {"task": task, "contestant": name, "thousand frames/s": f"{median(speeds):.0f}"}
        for gap in GAPS:
            values = times(rows, task, name, f"sampled_{unit}_to_{gap}")
            line[f"{unit} to {gap} %"] = shown(values, unit)
        line["gap at the end, mean, least to most"] = (
            f"{fmean(gaps):.2f}, {gaps[0]:.2f} to {gaps[-1]:.2f} %"
        )
        lines.append(line)
    return plain_table(lines).markdown()


def tables() -> list[str]:
    """All tables of the page: runs and tests by unit."""
    found = []
    for unit in ("seconds", "frames"):
        found.append(table(unit))
        lines = []
        for row in tests(unit):
            line = {"task": row["task"], "gap": f"{row['gap']} %"}
            line["ours has the least median"] = "yes" if row["first"] else "no"
            line["largest p"] = f"{row['p']:.2g}"
            lines.append(line | {"corrected": f"{row['p_holm']:.2g}"})
        found.append(plain_table(lines).markdown())
    return found


def main() -> None:
    """Print the tables."""
    print("\n\n".join(tables()))


if __name__ == "__main__":
    main()
